//! The bricked copy of a volume: random access to a volume that came as a stream, or faster access
//! to a slow one.
//!
//! The volume is cut into bricks of 32³ samples, of the stored type, little-endian and
//! uncompressed, so that the file is mapped and read in place: a box of samples of any shape
//! touches the pages of the bricks that it meets, and no others. Bricks at the far faces have only
//! the samples that exist, so no byte is padding. A brick's place needs no table: the samples
//! before brick (bx, by, bz), whose first sample is (x0, y0, z0) and which has hy rows and hz
//! slices, are `dx·dy·z0 + hz·(dx·y0 + hy·x0)`.
//!
//! ```text
//!      0   8  magic 89 49 73 70 42 0d 0a 1a ("\x89IspB\r\n\x1a": shows text-mode damage, as PNG's does)
//!      8   4  version, 1
//!     12   4  H, bytes of the JSON header
//!     16   4  CRC32C of the JSON header
//!     20   4  0
//!     24   H  JSON header: `BrickedHeader`
//!  24+H       zeros up to D, the next multiple of 4096
//!      D      bricks, x fastest; in a brick samples, x fastest: a range of slices of a brick is contiguous
//!    D+B  4n  CRC32C of each of the n bricks
//!         40  footer: 8 n | 8 B | 8 length of the file | 4 CRC32C of the table | 4 of the JSON header
//!                     | 4 of the 32 footer bytes before | 4 "IspE"
//! ```
//!
//! All numbers are little-endian. A reader rejects another magic, version or length of file, wrong
//! checksums of header and footer, and dimensions that do not give B and n. The bricks' own
//! checksums are read by [`BrickedVolume::verify`] alone: opening costs O(1).
//!
//! Writing takes the slabs of a stream and O(buffer) memory, plus 8 bytes a brick for running
//! checksums, never the volume. As many slices as the buffer holds are collected, then each brick's
//! part is written at its place. The file gets its name when it is complete and on disk; what a
//! killed run leaves behind has a temporary name.

mod build;

use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Fault, Result};
use crate::grid::{Geometry, IndexBox};
use crate::volume::convert::convert_row;
use crate::volume::units::Units;
use crate::volume::{Assumed, FieldInfo, SlabStream, VolumeInfo, VolumeReader};
use byteorder::{ByteOrder, LE};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// The first bytes of a bricked file.
pub const MAGIC: [u8; 8] = *b"\x89IspB\r\n\x1a";
/// Samples along each edge of a brick.
pub const EDGE: u64 = 32;
const VERSION: u32 = 1;
const PREFIX: u64 = 24;
const FOOTER: u64 = 40;
const END: [u8; 4] = *b"IspE";
/// Bricks start at a multiple of this: a page, so that the mapping of a brick starts where its
/// bytes do.
const ALIGN: u64 = 4096;

/// The JSON header.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct BrickedHeader {
    dims: [u64; 3],
    /// [`EDGE`]; room for other versions.
    brick_edge: u64,
    field: FieldInfo,
    geometry: Geometry,
    slope: f64,
    intercept: f64,
    missing: Option<f64>,
    /// File name, without folder, and format of what was copied.
    source: String,
    source_format: String,
    #[serde(default, skip_serializing_if = "Units::are_unknown")]
    units: Units,
}

/// Sizes and places, all derived from dimensions and sample size.
#[derive(Clone, Copy, Debug)]
struct BrickedLayout {
    dims: [u64; 3],
    sample_bytes: u64,
    data_at: u64,
    data_bytes: u64,
    bricks: u64,
}

impl BrickedLayout {
    /// `None` for dimensions of 0 or too large for a file.
    fn new(dims: [u64; 3], sample_bytes: usize, header_bytes: u64) -> Option<Self> {
        let sample_bytes = sample_bytes as u64;
        let data_bytes = IndexBox::whole(dims).checked_len()?.checked_mul(sample_bytes)?;
        let data_at = (PREFIX + header_bytes).next_multiple_of(ALIGN);
        let bricks = dims.iter().map(|d| d.div_ceil(EDGE)).product();
        // Fewer than 2^60 bytes: then no sum below overflows.
        let fits = (1..1 << 60).contains(&data_bytes);
        fits.then_some(Self { dims, sample_bytes, data_at, data_bytes, bricks })
    }

    fn file_bytes(&self) -> u64 {
        self.data_at + self.data_bytes + 4 * self.bricks + FOOTER
    }

    /// The samples of a brick by its number.
    fn brick(&self, number: u64) -> IndexBox {
        let n = self.dims.map(|d| d.div_ceil(EDGE));
        let lo = [number % n[0] * EDGE, number / n[0] % n[1] * EDGE, number / n[0] / n[1] * EDGE];
        IndexBox { lo, hi: std::array::from_fn(|a| self.dims[a].min(lo[a] + EDGE)) }
    }

    /// The number of the brick with a sample.
    fn number(&self, ijk: [u64; 3]) -> u64 {
        let n = self.dims.map(|d| d.div_ceil(EDGE));
        (ijk[2] / EDGE * n[1] + ijk[1] / EDGE) * n[0] + ijk[0] / EDGE
    }

    /// The bytes of a brick in the file.
    fn bytes_of(&self, brick: &IndexBox) -> Range<u64> {
        let ([x0, y0, z0], [dx, dy, _]) = (brick.lo, self.dims);
        let [hx, hy, hz] = brick.dims();
        let before = dx * dy * z0 + hz * (dx * y0 + hy * x0);
        let at = self.data_at + before * self.sample_bytes;
        at..at + hx * hy * hz * self.sample_bytes
    }

    /// The bricks that a box meets, x fastest.
    fn bricks_of(&self, voxels: IndexBox) -> impl Iterator<Item = IndexBox> + use<> {
        let layout = *self;
        let range = move |a: usize| voxels.lo[a] / EDGE..voxels.hi[a].div_ceil(EDGE);
        range(2).flat_map(move |z| {
            range(1).flat_map(move |y| {
                range(0).map(move |x| layout.brick(layout.number([x, y, z].map(|c| c * EDGE))))
            })
        })
    }
}

/// A bricked file, mapped.
#[derive(Debug)]
pub struct BrickedVolume {
    info: VolumeInfo,
    source: Arc<ByteSource>,
    layout: BrickedLayout,
}

impl BrickedVolume {
    /// Copies a stream into a bricked file at `out`, which is replaced if it exists.
    /// `max_buffer_bytes` is what the samples being collected may take (one row at the least); the
    /// fewer, the more and smaller the writes. `progress` gets the number of samples done so far.
    ///
    /// # Errors
    /// Those of the stream; [`Error::Io`] when the file cannot be written. Nothing is left under
    /// the name `out` then.
    pub fn build(
        stream: Box<dyn SlabStream>,
        out: &Path,
        max_buffer_bytes: usize,
        progress: &mut dyn FnMut(u64),
    ) -> Result<()> {
        build::build(stream, out, max_buffer_bytes, build::Lasting::Kept, progress)
    }

    /// As [`BrickedVolume::build`], for a copy that this process reads and removes: the disk is not
    /// waited for.
    ///
    /// # Errors
    /// Those of [`BrickedVolume::build`].
    pub fn build_scratch(
        stream: Box<dyn SlabStream>,
        out: &Path,
        max_buffer_bytes: usize,
        progress: &mut dyn FnMut(u64),
    ) -> Result<()> {
        build::build(stream, out, max_buffer_bytes, build::Lasting::Scratch, progress)
    }

    /// Whether this is the bricked copy of what a stream reads: the same header, the same samples.
    /// Cost: reading both.
    ///
    /// # Errors
    /// Those of the stream, and of reading this file.
    pub fn is_copy_of(&self, mut stream: Box<dyn SlabStream>, progress: &mut dyn FnMut(u64)) -> Result<bool> {
        if build::header_of(stream.info()) != read_header(&self.source)?.0 {
            return Ok(false);
        }
        let (mut theirs, mut ours, mut done) = (vec![], vec![], 0);
        while let Some(voxels) = stream.next_slab(&mut theirs)? {
            ours.resize(theirs.len(), 0);
            self.read_stored(voxels, &mut ours)?;
            if ours != theirs {
                return Ok(false);
            }
            done += voxels.len() as u64;
            progress(done);
        }
        Ok(true)
    }

    /// Opens a bricked file in the I/O mode that suits its file system. Reads header and footer, no
    /// samples.
    ///
    /// # Errors
    /// [`Error::BadInput`] when it is not a bricked file, of another version, cut short, or its
    /// header is damaged.
    pub fn open(path: &Path) -> Result<Self> {
        Self::open_with(path, IoMode::Auto)
    }

    /// [`BrickedVolume::open`] in a given I/O mode.
    ///
    /// # Errors
    /// Those of [`BrickedVolume::open`].
    pub fn open_with(path: &Path, io: IoMode) -> Result<Self> {
        Self::of(&Arc::new(ByteSource::open(path, io)?))
    }

    /// The bricks of a file that is open.
    ///
    /// # Errors
    /// Those of [`BrickedVolume::open`].
    pub(crate) fn of(source: &Arc<ByteSource>) -> Result<Self> {
        let path = source.path();
        let (header, layout) = read_header(source)?;
        check_footer(source, &layout)?;
        let info = VolumeInfo {
            path: path.to_path_buf(),
            format: format!("isospan bricks of {} ({})", header.source, header.source_format),
            dims: header.dims,
            fields: vec![header.field.clone()],
            field: header.field,
            geometry: header.geometry,
            slope: header.slope,
            intercept: header.intercept,
            missing: header.missing,
            units: header.units,
            notes: vec![],
            data_files: vec![],
            assumed: Assumed::default(),
            is_labels: false,
        };
        Ok(Self { info, source: Arc::clone(source), layout })
    }

    /// Number of bricks.
    pub fn brick_count(&self) -> u64 {
        self.layout.bricks
    }

    /// Reads every brick and compares its checksum.
    ///
    /// # Errors
    /// [`Error::BadInput`] naming the first damaged brick.
    pub fn verify(&self) -> Result<()> {
        let table_at = self.layout.data_at + self.layout.data_bytes;
        let table = self.source.slice(table_at..table_at + 4 * self.layout.bricks)?;
        for (number, stored) in table.chunks_exact(4).enumerate() {
            let range = self.layout.bytes_of(&self.layout.brick(number as u64));
            let mut buffer = vec![];
            let (expected, got) =
                (le32(stored), crc32c::crc32c(self.source.view(range.clone(), &mut buffer)?));
            if expected != got {
                let at = format!("brick {number} at byte {}", range.start);
                self.source.check()?;
                return Err(damaged(self.source.path(), at, expected, got));
            }
        }
        self.source.check()
    }

    /// Calls `take(position in the box's x-fastest array, stored bytes)` for each row of each brick
    /// in the box.
    fn for_each_row(&self, voxels: IndexBox, mut take: impl FnMut(usize, &[u8])) -> Result<()> {
        let d = self.info.dims;
        assert!((0..3).all(|a| voxels.hi[a] <= d[a]), "box {voxels:?} lies in a volume of {d:?} samples");
        if voxels.is_empty() {
            return Ok(());
        }
        let (size, mut buffer) = (self.layout.sample_bytes as usize, vec![]);
        for brick in self.layout.bricks_of(voxels) {
            let part = brick.intersect(&voxels);
            // The slices that are needed lie together.
            let slice = brick.dims()[0] * brick.dims()[1] * self.layout.sample_bytes;
            let first = self.layout.bytes_of(&brick).start + (part.lo[2] - brick.lo[2]) * slice;
            let bytes = self.source.view(first..first + part.dims()[2] * slice, &mut buffer)?;
            let brick = IndexBox {
                lo: [brick.lo[0], brick.lo[1], part.lo[2]],
                hi: [brick.hi[0], brick.hi[1], part.hi[2]],
            };
            for (z, y) in (part.lo[2]..part.hi[2]).flat_map(|z| (part.lo[1]..part.hi[1]).map(move |y| (z, y)))
            {
                let start = [part.lo[0], y, z];
                let row = &bytes[brick.offset(start) * size..][..part.dims()[0] as usize * size];
                take(voxels.offset(start), row);
            }
        }
        self.source.check()
    }
}

impl VolumeReader for BrickedVolume {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()> {
        assert_eq!(out.len(), voxels.len(), "the output has the size of the box");
        let VolumeInfo { slope, intercept, missing, .. } = self.info;
        let (scalar, size) = (self.info.field.scalar, self.layout.sample_bytes as usize);
        self.for_each_row(voxels, |at, row| {
            convert_row(row, scalar, false, slope, intercept, missing, &mut out[at..at + row.len() / size]);
        })
    }

    fn stored_info(&self) -> VolumeInfo {
        self.info.clone()
    }

    fn read_stored(&self, voxels: IndexBox, out: &mut [u8]) -> Result<()> {
        let size = self.layout.sample_bytes as usize;
        assert_eq!(out.len(), voxels.len() * size, "the output has the size of the box");
        self.for_each_row(voxels, |at, row| out[at * size..][..row.len()].copy_from_slice(row))
    }

    fn will_need(&self, voxels: IndexBox) {
        if voxels.is_empty() {
            return;
        }
        for brick in self.layout.bricks_of(voxels) {
            let slice = brick.dims()[0] * brick.dims()[1] * self.layout.sample_bytes;
            let (part, at) = (brick.intersect(&voxels), self.layout.bytes_of(&brick).start);
            let slices = part.lo[2] - brick.lo[2]..part.hi[2] - brick.lo[2];
            self.source.advise_will_need(at + slices.start * slice..at + slices.end * slice);
        }
    }

    fn release(&self, slices: Range<u64>) {
        // Whole layers of bricks, each contiguous; a layer that began before was not given up
        // before.
        let (first, last) = (slices.start / EDGE * EDGE, slices.end / EDGE * EDGE);
        let last = if slices.end >= self.info.dims[2] { self.info.dims[2] } else { last };
        if first < last {
            let slice = self.info.dims[0] * self.info.dims[1] * self.layout.sample_bytes;
            self.source.release(self.layout.data_at + first * slice..self.layout.data_at + last * slice);
        }
    }
}

fn read_header(source: &ByteSource) -> Result<(BrickedHeader, BrickedLayout)> {
    let path = source.path();
    let prefix = source.slice(0..PREFIX)?;
    if prefix[..8] != MAGIC {
        return Err(Error::bad_input(path, "byte 0", "the magic of a .bricks file", "other bytes"));
    }
    let version = le32(&prefix[8..]);
    if version != VERSION {
        return Err(Error::bad_input(
            path,
            "byte 8",
            format!("version {VERSION}"),
            format!("version {version}"),
        )
        .with_help("make it again with `isospan brick`"));
    }
    let (length, expected) = (u64::from(le32(&prefix[12..])), le32(&prefix[16..]));
    let json = source.slice(PREFIX..PREFIX + length)?;
    let got = crc32c::crc32c(json);
    if got != expected {
        return Err(damaged(path, "header".into(), expected, got));
    }
    let wrong = |got: String| Error::bad_input(path, "header", "a description of a volume", got);
    let header: BrickedHeader = serde_json::from_slice(json).map_err(|e| wrong(e.to_string()))?;
    let layout = BrickedLayout::new(header.dims, header.field.scalar.bytes(), length);
    let layout = layout.ok_or_else(|| wrong("dimensions of 0 or too large".into()))?;
    if header.brick_edge != EDGE || header.field.components != 1 || !header.geometry.is_valid() {
        return Err(wrong("another brick edge, a vector field or axes that do not span space".into()));
    }
    Ok((header, layout))
}

fn check_footer(source: &ByteSource, layout: &BrickedLayout) -> Result<()> {
    let (path, len) = (source.path(), source.len());
    if len != layout.file_bytes() {
        let expected = format!("{} bytes", layout.file_bytes());
        return Err(Error::bad_input(path, "length of the file", expected, format!("{len} bytes"))
            .with_help("the file is cut short; make it again with `isospan brick`"));
    }
    let found = source.slice(len - FOOTER..len)?;
    let table_at = layout.data_at + layout.data_bytes;
    let table = source.slice(table_at..table_at + 4 * layout.bricks)?;
    let header_crc = le32(source.slice(16..20)?);
    let expected = footer(layout, crc32c::crc32c(table), header_crc);
    if found == expected {
        return Ok(());
    }
    Err(damaged(path, "footer".into(), le32(&expected[32..]), le32(&found[32..])))
}

/// The bytes of the footer; see the module's head.
fn footer(layout: &BrickedLayout, table_crc: u32, header_crc: u32) -> [u8; FOOTER as usize] {
    let mut bytes = Vec::with_capacity(FOOTER as usize);
    for number in [layout.bricks, layout.data_bytes, layout.file_bytes()] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend(table_crc.to_le_bytes());
    bytes.extend(header_crc.to_le_bytes());
    bytes.extend(crc32c::crc32c(&bytes).to_le_bytes());
    bytes.extend(END);
    bytes.try_into().expect("3 x 8 + 4 x 4 bytes")
}

fn damaged(path: &Path, at: String, expected: u32, got: u32) -> Error {
    Error::bad_input(path, at, format!("checksum {expected:08x}"), format!("{got:08x}"))
        .of_fault(Fault::Checksum)
        .with_help("the file is damaged; make it again with `isospan brick`")
}

fn le32(bytes: &[u8]) -> u32 {
    LE::read_u32(bytes)
}

#[cfg(test)]
mod tests;
