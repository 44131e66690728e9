//! The chunks of a dataset: where they lie in the file, and their samples.
//!
//! The question: a reduction asks for chunks in any order, and a file may have millions. The crate
//! that reads HDF5 walks the whole index (a B-tree, mostly) for each box that is asked for, so the
//! cost would grow with the square of their number.
//!
//! The method: the index is read once for a group of chunks, a box of at most 65 536 of them. Most
//! files are one group. An entry takes 24 bytes. At most 16 groups are held; beyond that, the least
//! recently used one is dropped, and read again where it is needed again.

use super::MOST_CHUNK;
use super::filters::registry;
use crate::grid::IndexBox;
use crate::volume::strided::swap_bytes;
use hdf5_reader::btree_v1::{BTreeV1Key, collect_btree_v1_leaves_storage};
use hdf5_reader::chunk_index::{
    ChunkEntry, collect_implicit_chunk_entries, collect_v2_chunk_entries_storage, single_chunk_entry,
};
use hdf5_reader::error::{Error, Result};
use hdf5_reader::extensible_array::collect_extensible_array_chunk_entries_storage;
use hdf5_reader::filters::apply_pipeline_with_limit;
use hdf5_reader::fixed_array::collect_fixed_array_chunk_entries_storage;
use hdf5_reader::io::Cursor;
use hdf5_reader::messages::HdfMessage;
use hdf5_reader::messages::filter_pipeline::FilterDescription;
use hdf5_reader::messages::layout::{ChunkIndexing, DataLayout};
use hdf5_reader::{Dataset, FilterRegistry, Hdf5File};
use std::sync::{Arc, Mutex, PoisonError};

/// Chunks of a group.
const MOST_TOGETHER: u64 = 1 << 16;
/// Groups that are held.
const MOST_GROUPS: usize = 16;
/// Bytes of an entry while its group is read.
const READING_BYTES: u64 = 200;

/// The chunks of a dataset of at least three axes.
pub(super) struct Chunks {
    file: Hdf5File,
    /// Samples of the dataset and of a chunk along each axis, slowest first.
    shape: Vec<u64>,
    chunk: Vec<u32>,
    /// The axes of the volume, the last one first.
    axes: [usize; 3],
    most_dims: Option<Vec<u64>>,
    /// Where the index begins, or the only chunk; `None` where nothing was ever written.
    address: Option<u64>,
    indexing: Option<ChunkIndexing>,
    filters: Vec<FilterDescription>,
    registry: FilterRegistry,
    /// The bytes of a sample that was never written.
    fill: Vec<u8>,
    big_endian: bool,
    /// Chunks of a group, at most.
    most_together: u64,
    /// The groups that are held, the one used last at the end.
    groups: Mutex<Vec<(ChunkGroup, Arc<[StoredChunk]>)>>,
}

/// A box of chunks: its place along all axes, 0 along those of the volume, and its first chunk
/// along these.
type ChunkGroup = (Vec<u64>, [u64; 3]);

/// A chunk in the file, and its number in its group.
#[derive(Clone, Copy)]
struct StoredChunk {
    number: u64,
    address: u64,
    /// Bytes in the file; 0 where they are those of a decoded chunk.
    size: u32,
    /// The filters that were left out, a bit each.
    left_out: u32,
}

impl Chunks {
    /// The chunks of a dataset whose samples have `size` bytes, for volumes of three of its axes,
    /// the last one first; `None` where it has none.
    pub(super) fn of(
        file: &Hdf5File,
        dataset: &Dataset,
        axes: [usize; 3],
        size: usize,
        big_endian: bool,
    ) -> Result<Option<Self>> {
        let Some(chunk) = dataset.chunks() else { return Ok(None) };
        let shape = dataset.shape().to_vec();
        let bytes = chunk.iter().try_fold(size as u64, |n, &c| n.checked_mul(u64::from(c)));
        if chunk.len() != shape.len() || !bytes.is_some_and(|b| b > 0 && b <= MOST_CHUNK) {
            return Err(Error::InvalidData(format!("{chunk:?} samples of {size} bytes")));
        }
        let header = file.get_or_parse_header(dataset.address())?;
        let mut place = (None, None);
        let mut filters = vec![];
        for message in &header.messages {
            match message {
                HdfMessage::DataLayout(message) => {
                    if let DataLayout::Chunked { address, chunk_indexing, .. } = &message.layout {
                        place = (Some(*address), chunk_indexing.clone());
                    }
                }
                HdfMessage::FilterPipeline(message) => filters.clone_from(&message.filters),
                _ => {}
            }
        }
        let (address, indexing) = place;
        let offset_size = file.superblock().offset_size;
        let fill = dataset.fill_value().and_then(|f| f.value.clone()).unwrap_or_default();
        let fill = if fill.is_empty() { vec![0; size] } else { fill };
        if fill.len() != size {
            return Err(Error::InvalidData(format!("a fill value of {} bytes, not {size}", fill.len())));
        }
        Ok(Some(Self {
            file: file.clone(),
            most_dims: dataset.max_dims().map(<[u64]>::to_vec),
            address: address.filter(|&a| !Cursor::is_undefined_offset(a, offset_size)),
            registry: registry(bytes.unwrap_or(0)),
            most_together: MOST_TOGETHER,
            groups: Mutex::default(),
            shape,
            chunk,
            axes,
            indexing,
            filters,
            fill,
            big_endian,
        }))
    }

    /// Samples of a chunk along x, y, z.
    pub(super) fn dims(&self) -> [u64; 3] {
        self.axes.map(|axis| u64::from(self.chunk[axis]))
    }

    /// Bytes of a decoded chunk.
    pub(super) fn chunk_bytes(&self) -> u64 {
        self.chunk.iter().fold(self.fill.len() as u64, |n, &c| n * u64::from(c))
    }

    /// Bytes that places of chunks take, at most.
    pub(super) fn index_bytes(&self) -> u64 {
        let product = |n: [u64; 3]| n.into_iter().fold(1, u64::saturating_mul);
        let group = product(self.group_dims());
        let held = product(self.grid()).min(group.saturating_mul(MOST_GROUPS as u64));
        held.saturating_mul(size_of::<StoredChunk>() as u64)
            .saturating_add(group.saturating_mul(READING_BYTES))
    }

    /// Chunks along x, y, z.
    fn grid(&self) -> [u64; 3] {
        self.axes.map(|axis| self.shape[axis].div_ceil(u64::from(self.chunk[axis])))
    }

    /// Chunks of a group along x, y, z.
    fn group_dims(&self) -> [u64; 3] {
        let mut left = self.most_together;
        self.grid().map(|count| {
            let here = count.clamp(1, left);
            left /= here;
            here
        })
    }

    /// The samples of a box at some entries of the other axes: little-endian, x fastest, in `out`.
    pub(super) fn read(&self, entries: &[u64], part: IndexBox, out: &mut Vec<u8>) -> Result<()> {
        let (size, dims) = (self.fill.len(), self.dims());
        out.clear();
        out.resize(part.len() * size, 0);
        let range = |a: usize| part.lo[a] / dims[a]..part.hi[a].div_ceil(dims[a]);
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    self.add_chunk(entries, [x, y, z], part, out)?;
                }
            }
        }
        if self.big_endian {
            swap_bytes(out, size);
        }
        Ok(())
    }

    /// Copies the samples of a chunk that lie in a box to it.
    fn add_chunk(&self, entries: &[u64], at: [u64; 3], part: IndexBox, out: &mut [u8]) -> Result<()> {
        let (size, dims) = (self.fill.len(), self.dims());
        let sizes = self.chunk.iter().map(|&c| u64::from(c));
        let outer: Vec<u64> = entries.iter().zip(sizes.clone()).map(|(&b, c)| b / c).collect();
        // The number, in the chunk, of the first sample at these entries.
        let within = entries.iter().zip(sizes).fold(0, |n, (&b, c)| n * c + b % c);
        let [step_x, step_y, step_z] = self.axes.map(|axis| self.step(axis));
        let bytes = self.entry(&outer, at)?.map(|entry| self.decoded(entry)).transpose()?;
        let first: [u64; 3] = std::array::from_fn(|a| at[a] * dims[a]);
        let lo: [u64; 3] = std::array::from_fn(|a| first[a].max(part.lo[a]));
        let hi: [u64; 3] = std::array::from_fn(|a| (first[a] + dims[a]).min(part.hi[a]));
        let [nx, ny, _] = part.dims();
        let row = hi[0].saturating_sub(lo[0]) as usize * size;
        for z in lo[2]..hi[2] {
            for y in lo[1]..hi[1] {
                let to = ((z - part.lo[2]) * ny + y - part.lo[1]) * nx + lo[0] - part.lo[0];
                let to = &mut out[to as usize * size..][..row];
                let from = within + (z - first[2]) * step_z + (y - first[1]) * step_y;
                let from = from + (lo[0] - first[0]) * step_x;
                match &bytes {
                    Some(bytes) if step_x == 1 => to.copy_from_slice(&bytes[from as usize * size..][..row]),
                    Some(bytes) => {
                        let samples = bytes[from as usize * size..].chunks(size * step_x as usize);
                        to.chunks_exact_mut(size)
                            .zip(samples)
                            .for_each(|(s, of)| s.copy_from_slice(&of[..size]));
                    }
                    None => to.chunks_exact_mut(size).for_each(|s| s.copy_from_slice(&self.fill)),
                }
            }
        }
        Ok(())
    }

    /// Samples of a chunk from one entry of an axis to the next.
    fn step(&self, axis: usize) -> u64 {
        self.chunk[axis + 1..].iter().map(|&c| u64::from(c)).product()
    }

    /// The bytes of a chunk, as many as its samples take.
    fn decoded(&self, entry: StoredChunk) -> Result<Vec<u8>> {
        let expected = self.chunk_bytes();
        let stored = if entry.size == 0 { expected } else { u64::from(entry.size) };
        if stored > 2 * expected + (1 << 16) {
            let got = format!("a chunk of {stored} bytes in the file and {expected} bytes of samples");
            return Err(Error::InvalidData(got));
        }
        let stored = self.file.storage().read_range(entry.address, stored as usize)?;
        let bytes = apply_pipeline_with_limit(
            stored.as_ref(),
            &self.filters,
            entry.left_out,
            self.fill.len(),
            Some(&self.registry),
            Some(expected as usize + 1),
        )?;
        if bytes.len() as u64 != expected {
            let got = format!("a chunk that decodes to {} bytes, not {expected}", bytes.len());
            return Err(Error::InvalidData(got));
        }
        Ok(bytes)
    }

    /// Where the chunk lies that is at a place of the grid; `None` where it was never written.
    fn entry(&self, before: &[u64], at: [u64; 3]) -> Result<Option<StoredChunk>> {
        let dims = self.group_dims();
        let first: [u64; 3] = std::array::from_fn(|a| at[a] - at[a] % dims[a]);
        let group: ChunkGroup = (before.to_vec(), first);
        // The lock is held while the index is read, so that no two threads read it together.
        let mut groups = self.groups.lock().unwrap_or_else(PoisonError::into_inner);
        let found = match groups.iter().position(|(g, _)| *g == group) {
            Some(place) => groups.remove(place).1,
            None => self.entries(&group)?,
        };
        if groups.len() == MOST_GROUPS {
            groups.remove(0);
        }
        groups.push((group, Arc::clone(&found)));
        drop(groups);
        let number = number_in(first, dims, at);
        let place = found.binary_search_by_key(&number, |e| e.number);
        Ok(place.ok().map(|place| found[place]))
    }

    /// The chunks of a group, by their numbers.
    fn entries(&self, (before, lo): &ChunkGroup) -> Result<Arc<[StoredChunk]>> {
        let (grid, dims) = (self.grid(), self.group_dims());
        let hi: [u64; 3] = std::array::from_fn(|a| (lo[a] + dims[a]).min(grid[a]));
        let place = |of_volume: [u64; 3]| {
            let mut place = before.clone();
            self.axes.into_iter().zip(of_volume).for_each(|(axis, at)| place[axis] = at);
            place
        };
        let (first, last) = (place(*lo), place(hi.map(|h| h - 1)));
        let mut entries = vec![];
        for found in self.listed(&first, &last)? {
            let mut outer = self.place(&found.offsets)?;
            let at = self.axes.map(|axis| std::mem::take(&mut outer[axis]));
            if outer != *before || (0..3).any(|a| !(lo[a]..hi[a]).contains(&at[a])) {
                // Another group, or beyond the end of a dataset that was made smaller.
                continue;
            }
            let size = u32::try_from(found.size)
                .map_err(|_| Error::InvalidData(format!("a chunk of {} bytes", found.size)))?;
            let number = number_in(*lo, dims, at);
            entries.push(StoredChunk { number, address: found.address, size, left_out: found.filter_mask });
        }
        entries.sort_unstable_by_key(|e| e.number);
        if entries.windows(2).any(|e| e[0].number == e[1].number) {
            return Err(Error::InvalidData(format!("two chunks at one place, after chunk {lo:?}")));
        }
        Ok(entries.into())
    }

    /// The place in the grid of the chunk that begins at a sample.
    fn place(&self, offsets: &[u64]) -> Result<Vec<u64>> {
        let aligned = |(&at, &c): (&u64, &u32)| at.is_multiple_of(u64::from(c));
        if offsets.len() != self.shape.len() || !offsets.iter().zip(&self.chunk).all(aligned) {
            return Err(Error::InvalidData(format!("a chunk that begins at sample {offsets:?}")));
        }
        Ok(offsets.iter().zip(&self.chunk).map(|(&at, &c)| at / u64::from(c)).collect())
    }

    /// What the index lists from a first to a last place of the grid.
    fn listed(&self, first: &[u64], last: &[u64]) -> Result<Vec<ChunkEntry>> {
        let Some(address) = self.address else { return Ok(vec![]) };
        let (storage, superblock) = (self.file.storage(), self.file.superblock());
        let (offset_size, length_size) = (superblock.offset_size, superblock.length_size);
        let (rank, chunk, shape) = (self.shape.len(), &self.chunk, &self.shape);
        let bounds = Some((first, last));
        match &self.indexing {
            None => {
                let leaves = collect_btree_v1_leaves_storage(
                    storage,
                    address,
                    offset_size,
                    length_size,
                    Some(rank as u32),
                    chunk,
                    bounds,
                )?;
                leaves.into_iter().map(|(key, address)| leaf(key, address, rank)).collect()
            }
            Some(ChunkIndexing::SingleChunk { filtered_size, filters }) => {
                Ok(vec![single_chunk_entry(address, *filtered_size, *filters, rank)])
            }
            Some(ChunkIndexing::BTreeV2) => collect_v2_chunk_entries_storage(
                storage,
                address,
                offset_size,
                length_size,
                rank as u32,
                chunk,
                bounds,
            ),
            Some(ChunkIndexing::Implicit) => {
                collect_implicit_chunk_entries(address, shape, chunk, self.fill.len(), bounds, storage.len())
            }
            Some(ChunkIndexing::FixedArray { .. }) => collect_fixed_array_chunk_entries_storage(
                storage,
                address,
                offset_size,
                length_size,
                shape,
                chunk,
                bounds,
            ),
            Some(ChunkIndexing::ExtensibleArray { .. }) => collect_extensible_array_chunk_entries_storage(
                storage,
                address,
                offset_size,
                length_size,
                shape,
                self.most_dims.as_deref(),
                chunk,
                bounds,
            ),
        }
    }
}

/// The number of a chunk in the group of `dims` chunks that begins at `first`.
fn number_in(first: [u64; 3], dims: [u64; 3], at: [u64; 3]) -> u64 {
    let [x, y, z] = std::array::from_fn(|a| at[a] - first[a]);
    (z * dims[1] + y) * dims[0] + x
}

/// A leaf of a version 1 B-tree.
fn leaf(key: BTreeV1Key, address: u64, rank: usize) -> Result<ChunkEntry> {
    match key {
        BTreeV1Key::RawData { chunk_size, filter_mask, mut offsets } if offsets.len() >= rank => {
            offsets.truncate(rank);
            Ok(ChunkEntry { address, size: u64::from(chunk_size), filter_mask, offsets })
        }
        _ => Err(Error::InvalidData("a B-tree of chunks with other keys".into())),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{little_endian, scalar_of};
    use super::*;
    use hdf5_reader::SliceInfo;
    use std::path::Path;

    #[test]
    fn groups_of_any_size_give_what_the_reader_gives() {
        let names = [
            "types_latest.h5",
            "layouts_earliest.h5",
            "layouts_latest.h5",
            "filters.h5",
            "filter_blosc.h5",
            "filter_lz4.h5",
        ];
        let mut compared = 0;
        for name in names {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(name);
            let limits = hdf5_reader::OpenOptions::default().with_filter_registry(registry(MOST_CHUNK));
            let file = Hdf5File::open_with_options(&path, limits).unwrap();
            for dataset in file.root_group().unwrap().datasets().unwrap() {
                let Ok((scalar, big_endian)) = scalar_of(&path, "", &dataset) else { continue };
                if dataset.ndim() < 3 {
                    continue;
                }
                let rank = dataset.ndim();
                let axes = [rank - 1, rank - 2, rank - 3];
                let chunks = Chunks::of(&file, &dataset, axes, scalar.bytes(), big_endian).unwrap();
                let Some(mut chunks) = chunks else { continue };
                let mut expected = vec![];
                let all = SliceInfo::all(dataset.ndim());
                let is_read = little_endian(&dataset, scalar, &all, &mut expected).is_ok();
                let (outer, inner) = dataset.shape().split_at(dataset.ndim() - 3);
                let whole = IndexBox::whole([inner[2], inner[1], inner[0]]);
                for most_together in [1, 2, 5, MOST_TOGETHER] {
                    chunks.most_together = most_together;
                    chunks.groups = Mutex::default();
                    let (mut got, mut part) = (vec![], vec![]);
                    for number in 0..outer.iter().product() {
                        let mut rest = number;
                        let mut before: Vec<u64> = outer
                            .iter()
                            .rev()
                            .map(|&n| {
                                let at = rest % n;
                                rest /= n;
                                at
                            })
                            .collect();
                        before.reverse();
                        before.extend([0; 3]);
                        let read = chunks.read(&before, whole, &mut part);
                        assert_eq!(read.is_ok(), is_read, "{name} {}: {read:?}", dataset.name());
                        if !is_read {
                            part.clear();
                        }
                        got.extend_from_slice(&part);
                    }
                    assert_eq!(got, expected, "{name} {}, {most_together}", dataset.name());
                    compared += usize::from(is_read);
                }
            }
        }
        assert!(compared > 60, "{compared}");
    }
}
