//! Writes a bricked file from a stream.

use super::{ALIGN, BrickedHeader, BrickedLayout, EDGE, MAGIC, PREFIX, VERSION, footer};
use crate::bytes::publish::Unpublished;
use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::grid::IndexBox;
use crate::volume::{SlabStream, VolumeInfo};
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// How long a file is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lasting {
    /// It is synced.
    Kept,
    /// As long as the process runs.
    Scratch,
}

/// See [`super::BrickedVolume::build`].
pub(super) fn build(
    mut stream: Box<dyn SlabStream>,
    out: &Path,
    max_buffer_bytes: usize,
    lasting: Lasting,
    progress: &mut dyn FnMut(u64),
) -> Result<()> {
    let info = stream.info().clone();
    let json = serde_json::to_vec(&header_of(&info)).expect("plain numbers and strings are JSON");
    let size = info.field.scalar.bytes();
    let layout = BrickedLayout::new(info.dims, size, json.len() as u64).ok_or_else(|| no_volume(&info))?;
    let temporary = match lasting {
        Lasting::Kept => Unpublished::create(out)?,
        Lasting::Scratch => Unpublished::create_private(out)?,
    };
    let mut bricks = Bricks::new(out, temporary.file(), layout)?;
    let mut raster = Raster::new(&layout, max_buffer_bytes);
    let mut slab = vec![];
    while let Some(voxels) = stream.next_slab(&mut slab)? {
        if raster.continues(voxels) {
            raster.push(&slab, &mut bricks)?;
        } else {
            raster.flush(&mut bricks)?;
            bricks.write_box(voxels, &slab)?;
        }
        progress(bricks.written + raster.samples());
    }
    raster.flush(&mut bricks)?;
    if bricks.written != IndexBox::whole(info.dims).len() as u64 {
        let expected = format!("{} samples", IndexBox::whole(info.dims).len());
        return Err(Error::bad_input(&info.path, "samples", expected, format!("{}", bricks.written)));
    }
    bricks.finish(&json)?;
    match lasting {
        Lasting::Kept => temporary.publish(),
        Lasting::Scratch => temporary.publish_for_now(),
    }
}

pub(super) fn header_of(info: &VolumeInfo) -> BrickedHeader {
    let name = info.path.file_name().map(|n| n.to_string_lossy().into_owned());
    BrickedHeader {
        dims: info.dims,
        brick_edge: EDGE,
        field: info.field.clone(),
        geometry: info.geometry,
        slope: info.slope,
        intercept: info.intercept,
        missing: info.missing.filter(|m| m.is_finite()),
        source: name.unwrap_or_default(),
        source_format: info.format.clone(),
        units: info.units.clone(),
    }
}

fn no_volume(info: &VolumeInfo) -> Error {
    let [x, y, z] = info.dims;
    let expected = "at least one sample along each axis, fewer than 2^60 bytes";
    Error::bad_input(&info.path, "dimensions", expected, format!("{x} x {y} x {z}"))
}

/// The bricks of a file being written, and their running checksums.
struct Bricks<'a> {
    out: PathBuf,
    file: &'a File,
    layout: BrickedLayout,
    /// Samples written.
    written: u64,
    /// For each brick the checksum of its first bytes, and how many they are; [`UNORDERED`] when
    /// its parts came in another order and it must be read again.
    sums: Vec<(u32, u32)>,
    /// A brick's part, gathered.
    part: Vec<u8>,
}

/// More bytes than a brick has: 32³ samples of 8 bytes.
const UNORDERED: u32 = u32::MAX;

impl<'a> Bricks<'a> {
    fn new(out: &Path, file: &'a File, layout: BrickedLayout) -> Result<Self> {
        file.set_len(layout.file_bytes()).map_err(|e| Error::io("make room for", out, e))?;
        let sums = vec![(0, 0); layout.bricks as usize];
        Ok(Self { out: out.to_path_buf(), file, layout, written: 0, sums, part: vec![] })
    }

    fn write_at(&mut self, at: u64, bytes: &[u8]) -> Result<()> {
        let mut file = self.file;
        let done = file.seek(SeekFrom::Start(at)).and_then(|_| file.write_all(bytes));
        done.map_err(|e| Error::io("write", &self.out, e))
    }

    /// Writes a box of samples, x fastest, to the bricks that it meets.
    fn write_box(&mut self, voxels: IndexBox, samples: &[u8]) -> Result<()> {
        let size = self.layout.sample_bytes as usize;
        assert_eq!(samples.len(), voxels.len() * size, "a stream gives the samples of its box");
        for brick in self.layout.bricks_of(voxels) {
            let part = brick.intersect(&voxels);
            for run in contiguous(&brick, part) {
                let mut bytes = std::mem::take(&mut self.part);
                bytes.clear();
                for (z, y) in (run.lo[2]..run.hi[2]).flat_map(|z| (run.lo[1]..run.hi[1]).map(move |y| (z, y)))
                {
                    let at = voxels.offset([run.lo[0], y, z]) * size;
                    bytes.extend_from_slice(&samples[at..at + run.dims()[0] as usize * size]);
                }
                let within = brick.offset(run.lo) * size;
                self.write_at(self.layout.bytes_of(&brick).start + within as u64, &bytes)?;
                self.sum(self.layout.number(brick.lo), within as u32, &bytes);
                self.part = bytes;
            }
        }
        self.written += voxels.len() as u64;
        Ok(())
    }

    fn sum(&mut self, brick: u64, at: u32, bytes: &[u8]) {
        let (sum, done) = &mut self.sums[brick as usize];
        if *done == at {
            *sum = crc32c::crc32c_append(*sum, bytes);
            *done += bytes.len() as u32;
        } else {
            *done = UNORDERED;
        }
    }

    /// Writes everything but the bricks.
    fn finish(&mut self, json: &[u8]) -> Result<()> {
        self.sum_unordered()?;
        let mut head = MAGIC.to_vec();
        let header_crc = crc32c::crc32c(json);
        for number in [VERSION, json.len() as u32, header_crc, 0] {
            head.extend(number.to_le_bytes());
        }
        head.extend(json);
        debug_assert!(
            head.len() as u64 == PREFIX + json.len() as u64 && self.layout.data_at.is_multiple_of(ALIGN)
        );
        let table: Vec<u8> = self.sums.iter().flat_map(|(sum, _)| sum.to_le_bytes()).collect();
        let end = footer(&self.layout, crc32c::crc32c(&table), header_crc);
        self.write_at(0, &head)?;
        self.write_at(self.layout.data_at + self.layout.data_bytes, &[&table[..], &end].concat())
    }

    /// Reads again the bricks whose parts came out of order.
    fn sum_unordered(&mut self) -> Result<()> {
        let mut source = None;
        for number in 0..self.sums.len() {
            if self.sums[number].1 != UNORDERED {
                continue;
            }
            let source = match &mut source {
                Some(source) => source,
                None => {
                    let file = self.file.try_clone().map_err(|e| Error::io("reopen", &self.out, e))?;
                    source.insert(ByteSource::of_file(&self.out, file, IoMode::Auto)?)
                }
            };
            let range = self.layout.bytes_of(&self.layout.brick(number as u64));
            self.sums[number].0 = crc32c::crc32c(source.view(range, &mut self.part)?);
        }
        Ok(())
    }
}

/// A part of a brick as boxes that are contiguous in it: all of it where it has the brick's full
/// width and depth, else its slices where it has the full width, else its rows.
fn contiguous(brick: &IndexBox, part: IndexBox) -> Vec<IndexBox> {
    let full = |a: usize| part.lo[a] == brick.lo[a] && part.hi[a] == brick.hi[a];
    let slices = (part.lo[2]..part.hi[2])
        .map(|z| IndexBox { lo: [part.lo[0], part.lo[1], z], hi: [part.hi[0], part.hi[1], z + 1] });
    if full(0) && full(1) {
        vec![part]
    } else if full(0) {
        slices.collect()
    } else {
        let row = |s: IndexBox, y: u64| IndexBox { lo: [s.lo[0], y, s.lo[2]], hi: [s.hi[0], y + 1, s.hi[2]] };
        slices.flat_map(|s| (s.lo[1]..s.hi[1]).map(move |y| row(s, y))).collect()
    }
}

/// Collects samples that arrive in the order of the volume, to write them in large parts: up to a
/// boundary that is a whole layer of bricks where the buffer allows, else some slices of a layer,
/// else some rows of a slice.
struct Raster {
    dims: [u64; 3],
    row_bytes: usize,
    /// Slices between boundaries, a multiple or a part of a layer; 0 when not even one slice fits.
    slices: u64,
    /// Rows between boundaries when no slice fits.
    rows: u64,
    /// Rows of the volume, counted over all slices: the first one collected, and the next one
    /// expected.
    first: u64,
    next: u64,
    bytes: Vec<u8>,
}

impl Raster {
    fn new(layout: &BrickedLayout, max_buffer_bytes: usize) -> Self {
        let row = layout.dims[0] * layout.sample_bytes;
        let fit = (max_buffer_bytes as u64 / row).max(1);
        let whole = |n: u64| if n >= EDGE { n / EDGE * EDGE } else { n };
        let (slices, rows) = (whole(fit / layout.dims[1]), whole(fit));
        Self { dims: layout.dims, row_bytes: row as usize, slices, rows, first: 0, next: 0, bytes: vec![] }
    }

    /// Samples collected.
    fn samples(&self) -> u64 {
        (self.next - self.first) * self.dims[0]
    }

    /// Whether a box continues where the last one ended, in the order of the volume. If the buffer
    /// is empty, it starts there.
    fn continues(&mut self, voxels: IndexBox) -> bool {
        let ([dx, dy, _], d) = (self.dims, voxels.dims());
        let first = voxels.lo[2] * dy + voxels.lo[1];
        let whole_rows = d[0] == dx && (d[1] == dy || d[2] == 1);
        if whole_rows && self.bytes.is_empty() {
            (self.first, self.next) = (first, first);
        }
        whole_rows && first == self.next
    }

    /// The row at which what is collected from `row` on must be written.
    fn boundary(&self, row: u64) -> u64 {
        let (dy, z) = (self.dims[1], row / self.dims[1]);
        let next = |at: u64, step: u64| {
            if step >= EDGE { (at / step + 1) * step } else { (at % EDGE / step + 1) * step }
        };
        if self.slices > 0 {
            let layer = if self.slices < EDGE { z / EDGE * EDGE } else { 0 };
            let most = if self.slices < EDGE { layer + EDGE } else { self.dims[2] };
            (layer + next(z, self.slices)).min(most).min(self.dims[2]) * dy
        } else {
            let y = row % dy;
            let layer = if self.rows < EDGE { y / EDGE * EDGE } else { 0 };
            let most = if self.rows < EDGE { layer + EDGE } else { dy };
            z * dy + (layer + next(y, self.rows)).min(most).min(dy)
        }
    }

    fn push(&mut self, mut samples: &[u8], bricks: &mut Bricks<'_>) -> Result<()> {
        while !samples.is_empty() {
            let room = (self.boundary(self.first) - self.next) as usize * self.row_bytes;
            let (now, later) = samples.split_at(room.min(samples.len()));
            self.bytes.extend_from_slice(now);
            self.next += (now.len() / self.row_bytes) as u64;
            samples = later;
            if now.len() == room {
                self.flush(bricks)?;
            }
        }
        Ok(())
    }

    /// Writes what is collected: the rest of a slice, whole slices, the start of a slice.
    fn flush(&mut self, bricks: &mut Bricks<'_>) -> Result<()> {
        let (dx, dy) = (self.dims[0], self.dims[1]);
        let mut row = self.first;
        while row < self.next {
            let (y, z) = (row % dy, row / dy);
            let hi = if y == 0 && self.next - row >= dy {
                [dx, dy, self.next / dy]
            } else {
                [dx, dy.min(y + self.next - row), z + 1]
            };
            let voxels = IndexBox { lo: [0, y, z], hi };
            let at = (row - self.first) as usize * self.row_bytes;
            let rows = voxels.dims()[1] * voxels.dims()[2];
            bricks.write_box(voxels, &self.bytes[at..at + rows as usize * self.row_bytes])?;
            row += rows;
        }
        self.first = self.next;
        self.bytes.clear();
        Ok(())
    }
}
