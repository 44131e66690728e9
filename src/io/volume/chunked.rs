//! Volumes of separately compressed chunks: random access through a cache of decoded chunks.
//!
//! The question: a reduction reads boxes in any order, but a chunk can be decoded only as a whole.
//! A copy of the volume on disk would solve this, at the cost of a pass and of disk space. Instead,
//! the chunks that were decoded last stay in memory, and the samples of a box are gathered from
//! them.
//!
//! The method: chunks lie on a regular grid, the last ones are cut. [`ChunkedVolume`] holds a given
//! number of bytes of them; beyond that, the least recently used chunk is dropped. Two threads
//! never decode one chunk at the same time: the second one waits for the first. Of a source on a
//! server, the chunks that follow are decoded ahead, many at a time (see `ahead`).
//!
//! The cost: that number of bytes of chunks and, for each thread that reads, what decoding takes
//! ([`ChunkSource::decoding_bytes`]). How often a chunk is decoded depends on the order of boxes
//! and on these bytes: once where all chunks that a later box needs are cached. It does not promise
//! good use of too few bytes; the caller chooses enough of them. [`DecodeCount`] shows the figure.

use super::ahead::{Ahead, most_ahead};
use crate::bytes::remote::{PAGES_BYTES, is_remote};
use crate::error::{Error, Result};
use crate::grid::IndexBox;
use crate::volume::convert::convert_row;
use crate::volume::slabs::{CHUNK_SLAB_BYTES, cut_slab};
use crate::volume::{SlabStream, VolumeInfo, VolumeReader};
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// A volume in chunks on a regular grid, which are decoded separately.
pub trait ChunkSource: Send + Sync {
    /// What is read.
    fn info(&self) -> &VolumeInfo;

    /// Samples of a chunk along x, y, z. The last ones along an axis may have fewer.
    fn chunk_dims(&self) -> [u64; 3];

    /// Chunks along x, y, z that lie in one file: cheaper to read one after another.
    fn together(&self) -> [u64; 3] {
        [1; 3]
    }

    /// Bytes that decoding takes, at most, what comes out included.
    fn decoding_bytes(&self) -> u64;

    /// Bytes of what all threads share, at most: where chunks lie in the file.
    fn index_bytes(&self) -> u64 {
        0
    }

    /// Gives the samples of the chunk at this place of the grid, as far as they lie in the volume:
    /// stored ones, little-endian, x fastest, in `out` (cleared first).
    ///
    /// # Errors
    /// When the file cannot be read or decoded.
    fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()>;
}

/// The most chunks of a volume: opening so many files takes days.
const MOST_CHUNKS: u64 = 1 << 32;

/// Refuses a volume of so many chunks that reading it does not end.
///
/// # Errors
/// [`Error::BadInput`].
pub(crate) fn refuse_many_chunks(path: &Path, dims: [u64; 3], chunk: [u64; 3]) -> Result<()> {
    let grid: [u64; 3] = std::array::from_fn(|a| dims[a].div_ceil(chunk[a].max(1)));
    let count = grid.into_iter().fold(1, u64::saturating_mul);
    if count <= MOST_CHUNKS {
        return Ok(());
    }
    let list = |[x, y, z]: [u64; 3]| format!("{x} x {y} x {z}");
    let got = format!("{} of {} samples each", list(grid), list(chunk));
    Err(Error::bad_input(path, "chunks", format!("at most {MOST_CHUNKS} of them"), got)
        .with_help("write the array again in larger chunks"))
}

/// What decides how many chunks are cached, known without the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkShape {
    /// Samples of the volume along x, y, z.
    pub dims: [u64; 3],
    /// Samples of a chunk, not more than the volume has.
    pub chunk: [u64; 3],
    sample_bytes: u64,
    /// See [`ChunkSource::decoding_bytes`].
    pub decoding_bytes: u64,
    /// See [`ChunkSource::index_bytes`].
    index_bytes: u64,
    /// Whether it is on a server.
    is_remote: bool,
}

impl ChunkShape {
    /// The shape of a source.
    pub fn of(source: &dyn ChunkSource) -> Self {
        let (info, chunk) = (source.info(), source.chunk_dims());
        Self {
            dims: info.dims,
            chunk: std::array::from_fn(|a| chunk[a].min(info.dims[a])),
            sample_bytes: info.field.scalar.bytes() as u64,
            decoding_bytes: source.decoding_bytes(),
            index_bytes: source.index_bytes(),
            is_remote: is_remote(&info.path),
        }
    }

    /// Chunks that are decoded before they are asked for; none of files on this machine.
    fn ahead(&self) -> u64 {
        if self.is_remote { most_ahead(self.bytes_ahead()) } else { 0 }
    }

    /// Bytes that a chunk takes while it is decoded ahead, and then.
    fn bytes_ahead(&self) -> u64 {
        self.decoding_bytes.saturating_add(self.cached_bytes([1; 3]))
    }

    /// Bytes that all threads share: chunks that are decoded ahead, pages of their file, its index.
    pub fn shared_bytes(&self) -> u64 {
        let pages = if self.is_remote { PAGES_BYTES } else { 0 };
        let ahead = self.ahead().saturating_mul(self.bytes_ahead());
        ahead.saturating_add(pages).saturating_add(self.index_bytes)
    }

    /// Chunks along x, y, z.
    pub fn grid(&self) -> [u64; 3] {
        std::array::from_fn(|a| self.dims[a].div_ceil(self.chunk[a]))
    }

    /// Bytes that `count` chunks along x, y, z take in the cache.
    pub fn cached_bytes(&self, count: [u64; 3]) -> u64 {
        let one = self.chunk.iter().fold(self.sample_bytes, |n, &c| n.saturating_mul(c));
        count.into_iter().fold(one.saturating_add(ENTRY_BYTES), u64::saturating_mul)
    }

    /// Bytes that reading chunk after chunk takes.
    pub fn stream_bytes(&self) -> u64 {
        self.decoding_bytes.saturating_add(2 * CHUNK_SLAB_BYTES).saturating_add(self.shared_bytes())
    }
}

/// How many chunks the sources of some steps have, and how often one was decoded.
#[derive(Clone, Debug, Default)]
pub struct DecodeCount(Arc<Counts>);

#[derive(Debug, Default)]
struct Counts {
    chunks: AtomicU64,
    decodes: AtomicU64,
}

impl DecodeCount {
    /// The same source, whose decoded chunks are counted here.
    pub fn counting(&self, source: Arc<dyn ChunkSource>) -> Arc<dyn ChunkSource> {
        let chunks = ChunkShape::of(&*source).grid().into_iter().fold(1, u64::saturating_mul);
        self.0.chunks.store(chunks, Ordering::Relaxed);
        Arc::new(Counted { source, counts: self.clone() })
    }

    /// Chunks of the source that was opened last; 0 where none was.
    pub fn chunks(&self) -> u64 {
        self.0.chunks.load(Ordering::Relaxed)
    }

    /// How often one of them was decoded, all in all.
    pub fn decodes(&self) -> u64 {
        self.0.decodes.load(Ordering::Relaxed)
    }
}

/// A source whose decoded chunks are counted.
struct Counted {
    source: Arc<dyn ChunkSource>,
    counts: DecodeCount,
}

impl ChunkSource for Counted {
    fn info(&self) -> &VolumeInfo {
        self.source.info()
    }

    fn chunk_dims(&self) -> [u64; 3] {
        self.source.chunk_dims()
    }

    fn together(&self) -> [u64; 3] {
        self.source.together()
    }

    fn decoding_bytes(&self) -> u64 {
        self.source.decoding_bytes()
    }

    fn index_bytes(&self) -> u64 {
        self.source.index_bytes()
    }

    fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        self.counts.0.decodes.fetch_add(1, Ordering::Relaxed);
        self.source.decode(at, out)
    }
}

/// The samples of a chunk that lie in the volume; none of a chunk beyond its end.
pub(super) fn chunk_voxels(source: &dyn ChunkSource, at: [u64; 3]) -> IndexBox {
    let (d, c) = (source.info().dims, source.chunk_dims());
    let lo: [u64; 3] = std::array::from_fn(|a| at[a].saturating_mul(c[a]).min(d[a]));
    IndexBox { lo, hi: std::array::from_fn(|a| lo[a].saturating_add(c[a]).min(d[a])) }
}

fn decode(source: &dyn ChunkSource, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
    out.clear();
    source.decode(at, out)?;
    let (info, needed) = (source.info(), chunk_voxels(source, at).len() * source.info().field.scalar.bytes());
    if out.len() == needed {
        return Ok(());
    }
    let got = format!("{} bytes", out.len());
    Err(Error::bad_input(&info.path, format!("chunk {at:?}"), format!("{needed} bytes"), got))
}

/// The next place of a grid, x fastest; `false` after the last.
pub(crate) fn step(at: &mut [u64; 3], grid: [u64; 3]) -> bool {
    for a in 0..3 {
        at[a] += 1;
        if at[a] < grid[a] {
            return true;
        }
        at[a] = 0;
    }
    false
}

/// The places of all chunks, those of a file together.
struct Order {
    source: Arc<dyn ChunkSource>,
    /// The next file, by its place among them, and the next chunk in it.
    file: Option<[u64; 3]>,
    inner: [u64; 3],
}

impl Order {
    fn new(source: &Arc<dyn ChunkSource>) -> Self {
        Self { source: Arc::clone(source), file: Some([0; 3]), inner: [0; 3] }
    }

    /// Moves to the next chunk of this file, or to the first of the next file.
    fn advance(&mut self, file: [u64; 3]) {
        let (together, c, d) = (self.source.together(), self.source.chunk_dims(), self.source.info().dims);
        if step(&mut self.inner, together) {
            return;
        }
        self.inner = [0; 3];
        let grid = std::array::from_fn(|a| d[a].div_ceil(c[a]).div_ceil(together[a]));
        let mut next = file;
        self.file = step(&mut next, grid).then_some(next);
    }
}

impl Iterator for Order {
    type Item = [u64; 3];

    fn next(&mut self) -> Option<[u64; 3]> {
        loop {
            let file = self.file?;
            let together = self.source.together();
            let at = std::array::from_fn(|a| file[a] * together[a] + self.inner[a]);
            self.advance(file);
            if !chunk_voxels(&*self.source, at).is_empty() {
                return Some(at);
            }
        }
    }
}

/// The chunks of a volume one after the other, those of a file together: each is decoded once.
pub struct ChunkSlabs {
    source: Arc<dyn ChunkSource>,
    order: Order,
    /// Those that are decoded ahead of the order, how many, and which follow.
    ahead: Option<(Ahead, usize, Order)>,
    /// What is left of the chunk decoded last, and all its bytes.
    left: IndexBox,
    bytes: Vec<u8>,
}

impl ChunkSlabs {
    /// All chunks.
    pub fn new(source: Arc<dyn ChunkSource>) -> Self {
        let left = IndexBox { lo: [0; 3], hi: [0; 3] };
        let (order, ahead) = (Order::new(&source), ahead(&source).map(|a| (a, 0, Order::new(&source))));
        Self { source, order, ahead, left, bytes: vec![] }
    }

    /// Decodes the next chunk; `None` after the last.
    fn next_chunk(&mut self) -> Result<Option<[u64; 3]>> {
        if let Some((ahead, count, order)) = &mut self.ahead {
            let next: Vec<[u64; 3]> = order.take(ahead.most() - *count).collect();
            *count += next.len();
            ahead.will_need(next.into_iter(), false);
        }
        let Some(at) = self.order.next() else { return Ok(None) };
        // Not cleared: what it holds would be there while the next chunk is decoded.
        self.bytes = vec![];
        if let Some((ahead, count, _)) = &mut self.ahead {
            *count -= 1;
            if let Some(decoded) = ahead.take(at) {
                self.bytes = decoded?;
                return Ok(Some(at));
            }
        }
        decode(&*self.source, at, &mut self.bytes)?;
        Ok(Some(at))
    }
}

/// What decodes the chunks of a source ahead, where that is of use.
fn ahead(source: &Arc<dyn ChunkSource>) -> Option<Ahead> {
    let most = ChunkShape::of(&**source).ahead();
    let source = Arc::clone(source);
    let decoded = move |at| {
        let mut bytes = vec![];
        decode(&*source, at, &mut bytes).map(|()| bytes)
    };
    (most > 0).then(|| Ahead::new(most, decoded))
}

impl SlabStream for ChunkSlabs {
    fn info(&self) -> &VolumeInfo {
        self.source.info()
    }

    fn working_bytes(&self) -> u64 {
        ChunkShape::of(&*self.source).stream_bytes()
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        out.clear();
        if self.left.is_empty() {
            let Some(at) = self.next_chunk()? else { return Ok(None) };
            self.left = chunk_voxels(&*self.source, at);
        }
        let size = self.source.info().field.scalar.bytes();
        Ok(Some(cut_slab(&mut self.left, &self.bytes, size, out)))
    }
}

/// Bytes of a chunk's entries in the cache, besides its samples.
const ENTRY_BYTES: u64 = 192;

/// Chunks of a box that are announced, at most.
const MOST_ANNOUNCED: usize = 4096;

/// Random access to a volume of chunks.
pub struct ChunkedVolume {
    source: Arc<dyn ChunkSource>,
    /// Bytes of chunks that are cached, at most; one chunk at the least.
    most: u64,
    cache: Mutex<Cache>,
    decoded: Condvar,
    ahead: Option<Ahead>,
}

/// Chunks that are cached or being decoded.
#[derive(Default)]
struct Cache {
    chunks: HashMap<[u64; 3], Slot>,
    /// The cached ones by the time of their last use, counted in uses.
    by_use: BTreeMap<u64, [u64; 3]>,
    uses: u64,
    bytes: u64,
}

fn cached_bytes(chunk: &[u8]) -> u64 {
    chunk.len() as u64 + ENTRY_BYTES
}

enum Slot {
    /// By another thread.
    Decoding,
    Cached {
        bytes: Arc<Vec<u8>>,
        used: u64,
    },
}

impl Cache {
    fn remove(&mut self, at: [u64; 3]) {
        if let Some(Slot::Cached { bytes, used }) = self.chunks.remove(&at) {
            self.by_use.remove(&used);
            self.bytes -= cached_bytes(&bytes);
        }
    }

    fn insert(&mut self, at: [u64; 3], bytes: Arc<Vec<u8>>, most: u64) {
        while self.bytes + cached_bytes(&bytes) > most
            && let Some((_, &oldest)) = self.by_use.first_key_value()
        {
            self.remove(oldest);
        }
        self.uses += 1;
        self.bytes += cached_bytes(&bytes);
        self.by_use.insert(self.uses, at);
        self.chunks.insert(at, Slot::Cached { bytes, used: self.uses });
    }

    /// A cached chunk, as the one used last.
    fn use_cached(&mut self, at: [u64; 3]) -> Option<Arc<Vec<u8>>> {
        let Some(Slot::Cached { bytes, used }) = self.chunks.get_mut(&at) else { return None };
        self.by_use.remove(used);
        self.uses += 1;
        *used = self.uses;
        self.by_use.insert(self.uses, at);
        Some(Arc::clone(bytes))
    }
}

/// Gives up the place of a chunk that could not be decoded, so that no thread waits for it.
struct Claim<'a> {
    volume: &'a ChunkedVolume,
    at: [u64; 3],
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        let mut cache = self.volume.lock();
        if matches!(cache.chunks.get(&self.at), Some(Slot::Decoding)) {
            cache.chunks.remove(&self.at);
        }
        drop(cache);
        self.volume.decoded.notify_all();
    }
}

impl ChunkedVolume {
    /// Caches up to `most` bytes of decoded chunks.
    pub fn new(source: Arc<dyn ChunkSource>, most: u64) -> Self {
        let ahead = ahead(&source);
        Self { source, most, cache: Mutex::default(), decoded: Condvar::new(), ahead }
    }

    fn lock(&self) -> MutexGuard<'_, Cache> {
        self.cache.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn chunk(&self, at: [u64; 3]) -> Result<Arc<Vec<u8>>> {
        let mut cache = self.lock();
        loop {
            if let Some(bytes) = cache.use_cached(at) {
                return Ok(bytes);
            }
            if !cache.chunks.contains_key(&at) {
                break;
            }
            cache = self.decoded.wait(cache).unwrap_or_else(PoisonError::into_inner);
        }
        cache.chunks.insert(at, Slot::Decoding);
        drop(cache);
        let _claim = Claim { volume: self, at };
        let mut bytes = vec![];
        match self.ahead.as_ref().and_then(|ahead| ahead.take(at)) {
            Some(decoded) => bytes = decoded?,
            None => decode(&*self.source, at, &mut bytes)?,
        }
        let bytes = Arc::new(bytes);
        self.lock().insert(at, Arc::clone(&bytes), self.most);
        Ok(bytes)
    }

    /// The chunks that meet a box: the first, and how many along each axis.
    fn met(&self, wanted: IndexBox) -> ([u64; 3], [u64; 3]) {
        let c = self.source.chunk_dims();
        let first: [u64; 3] = std::array::from_fn(|a| wanted.lo[a] / c[a]);
        (first, std::array::from_fn(|a| wanted.hi[a].div_ceil(c[a]) - first[a]))
    }

    /// Has the chunks of a box decoded ahead that are not there; `soon` before others.
    fn announce(&self, wanted: IndexBox, soon: bool) {
        let Some(ahead) = self.ahead.as_ref().filter(|_| !wanted.is_empty()) else { return };
        let (first, grid) = self.met(wanted);
        let (mut place, mut missing, cache) = ([0; 3], vec![], self.lock());
        loop {
            let at = std::array::from_fn(|a| first[a] + place[a]);
            if !cache.chunks.contains_key(&at) {
                missing.push(at);
            }
            if missing.len() > MOST_ANNOUNCED || !step(&mut place, grid) {
                break;
            }
        }
        drop(cache);
        // A single one is decoded by whoever needs it now.
        if missing.len() > usize::from(soon) {
            ahead.will_need(missing.into_iter(), soon);
        }
    }

    /// Calls `take` with each row of a box: where it starts in the box, and its bytes.
    fn each_row(&self, wanted: IndexBox, mut take: impl FnMut(usize, &[u8])) -> Result<()> {
        if wanted.is_empty() {
            return Ok(());
        }
        self.announce(wanted, true);
        let (size, (first, grid)) = (self.source.info().field.scalar.bytes(), self.met(wanted));
        let mut place = [0; 3];
        loop {
            let at = std::array::from_fn(|a| first[a] + place[a]);
            let (whole, bytes) = (chunk_voxels(&*self.source, at), self.chunk(at)?);
            let part = whole.intersect(&wanted);
            let row = part.dims()[0] as usize * size;
            for z in part.lo[2]..part.hi[2] {
                for y in part.lo[1]..part.hi[1] {
                    let from = whole.offset([part.lo[0], y, z]) * size;
                    take(wanted.offset([part.lo[0], y, z]), &bytes[from..from + row]);
                }
            }
            if !step(&mut place, grid) {
                return Ok(());
            }
        }
    }
}

impl VolumeReader for ChunkedVolume {
    fn info(&self) -> &VolumeInfo {
        self.source.info()
    }

    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()> {
        let info = self.source.info();
        let (scalar, slope, intercept) = (info.field.scalar, info.slope, info.intercept);
        self.each_row(voxels, |at, row| {
            let out = &mut out[at..at + row.len() / scalar.bytes()];
            convert_row(row, scalar, false, slope, intercept, info.missing, out);
        })
    }

    fn will_need(&self, voxels: IndexBox) {
        self.announce(voxels, false);
    }

    /// Chunks that lie before the end of `slices` are given up.
    fn release(&self, slices: Range<u64>) {
        let mut cache = self.lock();
        let cached = cache.by_use.values().copied();
        let is_gone = |at| chunk_voxels(&*self.source, at).hi[2] <= slices.end;
        let gone: Vec<_> = cached.filter(|&at| is_gone(at)).collect();
        gone.into_iter().for_each(|at| cache.remove(at));
        drop(cache);
        if let Some(ahead) = &self.ahead {
            ahead.forget(is_gone);
        }
    }

    fn stored_info(&self) -> VolumeInfo {
        self.source.info().clone()
    }

    fn read_stored(&self, voxels: IndexBox, out: &mut [u8]) -> Result<()> {
        let size = self.source.info().field.scalar.bytes();
        self.each_row(voxels, |at, row| out[at * size..at * size + row.len()].copy_from_slice(row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Geometry;
    use crate::volume::units::Units;
    use crate::volume::{FieldInfo, ScalarType};

    /// The sample (x, y, z) of 7 x 5 x 6 is x + 10 y + 100 z, in chunks of 4 x 3 x 2.
    struct Made(VolumeInfo);

    const DIMS: [u64; 3] = [7, 5, 6];

    impl ChunkSource for Made {
        fn info(&self) -> &VolumeInfo {
            &self.0
        }

        fn chunk_dims(&self) -> [u64; 3] {
            [4, 3, 2]
        }

        fn together(&self) -> [u64; 3] {
            [2, 1, 2]
        }

        fn decoding_bytes(&self) -> u64 {
            48
        }

        fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
            if at == [1, 1, 2] && self.0.format == "bad" {
                return Err(Error::usage("bad"));
            }
            let b = chunk_voxels(self, at);
            for (z, y) in (b.lo[2]..b.hi[2]).flat_map(|z| (b.lo[1]..b.hi[1]).map(move |y| (z, y))) {
                (b.lo[0]..b.hi[0]).for_each(|x| out.extend(value(x, y, z).to_le_bytes()));
            }
            Ok(())
        }
    }

    fn value(x: u64, y: u64, z: u64) -> u16 {
        (x + 10 * y + 100 * z) as u16
    }

    fn made(format: &str) -> Arc<dyn ChunkSource> {
        let field = FieldInfo { name: "data".into(), scalar: ScalarType::U16, components: 1 };
        Arc::new(Made(VolumeInfo {
            path: "made".into(),
            format: format.into(),
            dims: DIMS,
            fields: vec![field.clone()],
            field,
            geometry: Geometry::default(),
            slope: 0.5,
            intercept: 1.0,
            missing: Some(203.0),
            units: Units::default(),
            notes: vec![],
            data_files: vec![],
            assumed: crate::volume::Assumed::default(),
            is_labels: false,
        }))
    }

    #[test]
    fn boxes_come_back_however_many_chunks_are_cached() {
        for most in [0, 48 + ENTRY_BYTES, 1000, 1 << 20] {
            let volume = ChunkedVolume::new(made(""), most);
            for wanted in [
                IndexBox::whole(DIMS),
                IndexBox { lo: [3, 2, 1], hi: [5, 4, 3] },
                IndexBox { lo: [6, 4, 5], hi: DIMS },
                IndexBox { lo: [2; 3], hi: [2; 3] },
            ] {
                let (mut values, mut stored) = (vec![0.0; wanted.len()], vec![0; 2 * wanted.len()]);
                volume.read_box(wanted, &mut values).unwrap();
                volume.read_stored(wanted, &mut stored).unwrap();
                for i in 0..wanted.len() as u64 {
                    let d = wanted.dims();
                    let at = [i % d[0], i / d[0] % d[1], i / d[0] / d[1]];
                    let v = value(wanted.lo[0] + at[0], wanted.lo[1] + at[1], wanted.lo[2] + at[2]);
                    let n = i as usize;
                    assert_eq!(stored[2 * n..2 * n + 2], v.to_le_bytes());
                    match v {
                        203 => assert!(values[n].is_nan()),
                        v => assert_eq!(values[n], 0.5 * f32::from(v) + 1.0),
                    }
                }
            }
            assert!(volume.lock().bytes <= most.max(48 + ENTRY_BYTES));
        }
    }

    #[test]
    fn where_all_are_cached_each_chunk_is_decoded_once_by_any_number_of_threads() {
        let count = DecodeCount::default();
        let volume = ChunkedVolume::new(count.counting(made("")), 1 << 20);
        std::thread::scope(|threads| {
            for _ in 0..4 {
                threads.spawn(|| {
                    let mut out = vec![0.0; IndexBox::whole(DIMS).len()];
                    volume.read_box(IndexBox::whole(DIMS), &mut out).unwrap();
                });
            }
        });
        assert_eq!([count.chunks(), count.decodes()], [2 * 2 * 3; 2]);
        volume.release(0..5);
        assert_eq!(volume.lock().chunks.len(), 4, "those of the last two slices");
    }

    #[test]
    fn a_damaged_chunk_is_an_error_each_time_and_hangs_nobody() {
        let volume = ChunkedVolume::new(made("bad"), 1 << 20);
        let read = || volume.read_box(IndexBox::whole(DIMS), &mut vec![0.0; IndexBox::whole(DIMS).len()]);
        std::thread::scope(|threads| {
            let readers: Vec<_> = (0..3).map(|_| threads.spawn(read)).collect();
            readers.into_iter().for_each(|r| assert!(r.join().unwrap().is_err()));
        });
    }

    #[test]
    fn slabs_give_each_sample_once() {
        let (mut slabs, mut bytes, mut seen) = (ChunkSlabs::new(made("")), vec![], 0);
        while let Some(slab) = slabs.next_slab(&mut bytes).unwrap() {
            assert_eq!(bytes[..2], value(slab.lo[0], slab.lo[1], slab.lo[2]).to_le_bytes());
            assert_eq!(bytes.len(), 2 * slab.len());
            seen += slab.len();
        }
        assert_eq!(seen, IndexBox::whole(DIMS).len());
    }
}
