//! Volumes whose samples lie in a file at regular steps: what raw, NRRD, MetaImage, NPY, NIfTI, VTI
//! appended raw and binary legacy VTK have in common once their headers are read.
//!
//! The sample (x, y, z) is at byte `offset + x·strides[0] + y·strides[1] + z·strides[2]`. Steps may
//! be negative (a flipped axis) or in any order (a Fortran-ordered array has z fastest). A volume
//! may also be a stack of files, each with the same number of slices along z.
//!
//! Reading goes along the axis with the smallest step, so that a box of a z-fastest array is read
//! in runs along z and scattered, not gathered sample by sample; in the usual case that axis is x
//! and a run is a row of the output. Cost: O(samples of the box), no memory beyond a run. A file
//! that is read and not mapped is read plane by plane, the samples between two runs included, as
//! long as these are few.

use super::convert::convert_row;
use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::exec::will_read;
use crate::grid::{Geometry, IndexBox};
use crate::volume::chunked::{ChunkSource, chunk_voxels};
use crate::volume::{ScalarType, VolumeInfo, VolumeReader, VolumeSource};
use std::ops::Range;
use std::sync::Arc;

/// A volume whose samples lie at regular steps in one file, or in a stack of files.
#[derive(Debug)]
pub struct StridedVolume {
    info: VolumeInfo,
    /// One file for each `slices_per_part` slices.
    parts: Vec<Arc<ByteSource>>,
    slices_per_part: u64,
    /// The byte of the first sample in each part.
    offsets: Vec<u64>,
    big_endian: bool,
    strides: [i64; 3],
}

impl StridedVolume {
    /// A volume in one file. `offset`: the byte of sample (0, 0, 0); `strides`: bytes a step along
    /// x, y, z.
    ///
    /// # Errors
    /// [`Error::BadInput`] when a dimension is 0 or a sample would lie outside the file.
    pub fn new(
        info: VolumeInfo,
        source: Arc<ByteSource>,
        offset: u64,
        big_endian: bool,
        strides: [i64; 3],
    ) -> Result<Self> {
        let slices_per_part = info.dims[2];
        Self::stacked(info, vec![source], slices_per_part, offset, big_endian, strides)
    }

    /// A volume in a stack of files along z, `slices_per_part` slices each; `offset` is the same in
    /// all of them.
    ///
    /// # Errors
    /// [`Error::BadInput`] when a dimension is 0, the files do not make up the volume, or a sample
    /// lies outside its file.
    pub fn stacked(
        info: VolumeInfo,
        parts: Vec<Arc<ByteSource>>,
        slices_per_part: u64,
        offset: u64,
        big_endian: bool,
        strides: [i64; 3],
    ) -> Result<Self> {
        let parts = parts.into_iter().map(|p| (p, offset)).collect();
        Self::stacked_at(info, parts, slices_per_part, big_endian, strides)
    }

    /// Like [`StridedVolume::stacked`], where each part has its own byte of its first sample. Parts
    /// may lie in one file.
    ///
    /// # Errors
    /// Those of [`StridedVolume::stacked`].
    pub fn stacked_at(
        info: VolumeInfo,
        parts: Vec<(Arc<ByteSource>, u64)>,
        slices_per_part: u64,
        big_endian: bool,
        strides: [i64; 3],
    ) -> Result<Self> {
        let (d, stored) = (info.dims, (parts.len() as u64).checked_mul(slices_per_part));
        if d.contains(&0) || stored != Some(d[2]) {
            return Err(Error::bad_input(
                &info.path,
                "dimensions",
                "at least one sample along each axis and as many slices as the files hold",
                format!(
                    "{} x {} x {} in {} files of {slices_per_part} slices",
                    d[0],
                    d[1],
                    d[2],
                    parts.len()
                ),
            ));
        }
        for (part, offset) in &parts {
            check_extent(&info, part, [d[0], d[1], slices_per_part], *offset, strides)?;
        }
        let (parts, offsets) = parts.into_iter().unzip();
        Ok(Self { info, parts, slices_per_part, offsets, big_endian, strides })
    }

    /// The same samples at other places in the world.
    #[must_use]
    pub fn placed(mut self, geometry: Geometry) -> Self {
        self.info.geometry = geometry;
        self
    }

    /// The volume as a source: of files on servers one of pieces that are fetched and cached, each
    /// of them rows that follow each other in a file.
    pub fn source(self) -> VolumeSource {
        /// Bytes of a piece, at most, unless one row has more.
        const PIECE: u64 = 512 << 10;
        if !self.parts.iter().any(|part| part.is_remote()) {
            return VolumeSource::Random(Box::new(self));
        }
        let ([axis, next, _], d) = (self.axes_by_step(), self.info.dims);
        let step = |a: usize| self.strides[a].unsigned_abs();
        let row = step(axis).saturating_mul(d[axis]).max(step(next)).max(1);
        let mut piece = [1; 3];
        (piece[axis], piece[next]) = (d[axis], (PIECE / row).clamp(1, d[next]));
        VolumeSource::Chunked(Arc::new(StridedPieces { volume: self, piece }))
    }

    /// The steps of samples stored without gaps, x fastest, then y, then z; `None` where they do
    /// not fit 63 bits.
    pub fn packed_strides(dims: [u64; 3], scalar: ScalarType) -> Option<[i64; 3]> {
        let x = scalar.bytes() as i64;
        let y = x.checked_mul(i64::try_from(dims[0]).ok()?)?;
        Some([x, y, y.checked_mul(i64::try_from(dims[1]).ok()?)?])
    }

    /// Calls `take(axis, position in the box's x-fastest array, stored bytes of a run along axis)`
    /// for every run of the box. A run is contiguous: gathered first where the steps leave gaps.
    fn for_each_run(&self, voxels: IndexBox, mut take: impl FnMut(usize, usize, &[u8])) -> Result<()> {
        let d = self.info.dims;
        assert!((0..3).all(|a| voxels.hi[a] <= d[a]), "box {voxels:?} lies in a volume of {d:?} samples");
        if voxels.is_empty() {
            return Ok(());
        }
        let mut buffers = Buffers::default();
        let first = voxels.lo[2] / self.slices_per_part;
        let last = (voxels.hi[2] - 1) / self.slices_per_part;
        for part in first..=last {
            let z0 = part * self.slices_per_part;
            let mut inside = voxels;
            inside.lo[2] = voxels.lo[2].max(z0);
            inside.hi[2] = voxels.hi[2].min(z0 + self.slices_per_part);
            self.runs_of_part(part as usize, &voxels, inside, z0, &mut buffers, &mut take)?;
            self.parts[part as usize].check()?;
        }
        Ok(())
    }

    /// The runs of a box, as far as it lies in one part (`inside`), whose first slice is `z0`. The
    /// box is viewed piece by piece, and a piece is a plane of the two axes of least step where
    /// that reads little that is not used, else a run.
    fn runs_of_part(
        &self,
        part: usize,
        voxels: &IndexBox,
        inside: IndexBox,
        z0: u64,
        buffers: &mut Buffers,
        take: &mut impl FnMut(usize, usize, &[u8]),
    ) -> Result<()> {
        let source = &self.parts[part];
        let (size, [axis, next, slow]) = (self.info.field.scalar.bytes(), self.axes_by_step());
        let (count, dims) = (inside.dims()[axis] as usize, inside.dims());
        let reach = |a: usize| self.strides[a].unsigned_abs() * (dims[a] - 1);
        let gap = self.strides[next].unsigned_abs().saturating_sub(reach(axis));
        let whole = gap <= LARGEST_GAP && reach(axis) + reach(next) <= LARGEST_PIECE;
        let rows = if whole { dims[next] } else { 1 };
        let to_next_row = steps_of(*voxels)[next];
        let ahead = whole && self.strides[axis] == size as i64 && (count * size) as u64 * rows <= MOST_AHEAD;
        for s in inside.lo[slow]..inside.hi[slow] {
            for first in (inside.lo[next]..inside.hi[next]).step_by(rows as usize) {
                let mut start = inside.lo;
                (start[slow], start[next]) = (s, first);
                let corner = self.byte_of(part, [start[0], start[1], start[2] - z0]);
                let piece = self.piece(corner, (axis, dims[axis]), (next, rows), size);
                if ahead && s + 1 < inside.hi[slow] {
                    let corner = corner.wrapping_add_signed(self.strides[slow]);
                    let piece = self.piece(corner, (axis, dims[axis]), (next, rows), size);
                    if let Some(bytes) = source.at_hand(piece.clone()) {
                        for row in 0..rows {
                            let at = self.row_at(corner, next, row) - piece.start;
                            will_read(run(bytes, at, size as i64, count, size, &mut buffers.gathered));
                        }
                    }
                }
                let bytes = source.view(piece.clone(), &mut buffers.piece)?;
                let mut place = voxels.offset(start);
                for row in 0..rows {
                    let at = self.row_at(corner, next, row) - piece.start;
                    take(axis, place, run(bytes, at, self.strides[axis], count, size, &mut buffers.gathered));
                    place += to_next_row;
                }
            }
        }
        Ok(())
    }

    /// Where a row begins, counted from one that begins at byte `corner` along an axis.
    fn row_at(&self, corner: u64, axis: usize, row: u64) -> u64 {
        corner.wrapping_add_signed(self.strides[axis].wrapping_mul(row as i64))
    }

    /// The axes, that of the least step first. Equal steps, as where a dimension is 1, are in the
    /// order x, y, z.
    fn axes_by_step(&self) -> [usize; 3] {
        let mut axes = [0, 1, 2];
        axes.sort_by_key(|&a| self.strides[a].unsigned_abs());
        axes
    }

    /// The bytes from the first to the last sample of a plane whose sample of least index is at
    /// byte `corner`, given its axes and sizes. Steps may be negative.
    fn piece(&self, corner: u64, a: (usize, u64), b: (usize, u64), size: usize) -> Range<u64> {
        let (mut lo, mut hi) = (corner, corner + size as u64);
        for (axis, count) in [a, b] {
            let reach = self.strides[axis].unsigned_abs() * (count - 1);
            if self.strides[axis] < 0 { lo -= reach } else { hi += reach }
        }
        lo..hi
    }

    /// Byte of a sample within its part. Cannot overflow: `check_extent` has seen the extreme
    /// samples.
    fn byte_of(&self, part: usize, ijk: [u64; 3]) -> u64 {
        let step = |a: usize| self.strides[a].wrapping_mul(ijk[a] as i64);
        self.offsets[part].wrapping_add_signed(step(0).wrapping_add(step(1)).wrapping_add(step(2)))
    }
}

/// A volume in pieces that are read each by itself.
struct StridedPieces {
    volume: StridedVolume,
    piece: [u64; 3],
}

impl ChunkSource for StridedPieces {
    fn info(&self) -> &VolumeInfo {
        &self.volume.info
    }

    fn chunk_dims(&self) -> [u64; 3] {
        self.piece
    }

    fn decoding_bytes(&self) -> u64 {
        let piece = IndexBox::whole(self.piece).len() as u64;
        // As it is fetched, and as it is given out.
        piece.saturating_mul(2 * self.volume.info.field.scalar.bytes() as u64)
    }

    fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        let voxels = chunk_voxels(self, at);
        out.resize(voxels.len() * self.volume.info.field.scalar.bytes(), 0);
        self.volume.read_stored(voxels, out)
    }
}

/// The buffers through which a box is read; empty while files are mapped and samples lie without
/// gaps.
#[derive(Default)]
struct Buffers {
    piece: Vec<u8>,
    gathered: Vec<u8>,
}

/// Bytes between two runs that are read along with them: a read of its own costs about as much as
/// copying these.
const LARGEST_GAP: u64 = 8 << 10;
/// Bytes between two slices that are asked for with them.
const BETWEEN: u64 = 256 << 10;
/// Bytes of a plane that is read at once.
const LARGEST_PIECE: u64 = 4 << 20;

/// Bytes of a plane that are prefetched while the one before is read: half of the processor's
/// nearest cache. It detects longer rows by itself.
const MOST_AHEAD: u64 = 16 << 10;

/// `count` samples from byte `at` of a piece on, `stride` apart.
fn run<'a>(
    piece: &'a [u8],
    at: u64,
    stride: i64,
    count: usize,
    size: usize,
    gathered: &'a mut Vec<u8>,
) -> &'a [u8] {
    if stride == size as i64 || count == 1 {
        return &piece[at as usize..][..count * size];
    }
    gathered.clear();
    for i in 0..count as i64 {
        gathered.extend_from_slice(&piece[at.wrapping_add_signed(i * stride) as usize..][..size]);
    }
    gathered
}

impl VolumeReader for StridedVolume {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()> {
        assert_eq!(out.len(), voxels.len(), "the output has the size of the box");
        let VolumeInfo { slope, intercept, missing, .. } = self.info;
        let (scalar, big) = (self.info.field.scalar, self.big_endian);
        let step = steps_of(voxels);
        let mut values = vec![];
        self.for_each_run(voxels, |axis, at, bytes| {
            let n = bytes.len() / scalar.bytes();
            if axis == 0 {
                return convert_row(bytes, scalar, big, slope, intercept, missing, &mut out[at..at + n]);
            }
            values.resize(n, 0.0);
            convert_row(bytes, scalar, big, slope, intercept, missing, &mut values);
            for (i, &v) in values.iter().enumerate() {
                out[at + i * step[axis]] = v;
            }
        })
    }

    fn stored_info(&self) -> VolumeInfo {
        self.info.clone()
    }

    fn read_stored(&self, voxels: IndexBox, out: &mut [u8]) -> Result<()> {
        let size = self.info.field.scalar.bytes();
        assert_eq!(out.len(), voxels.len() * size, "the output has the size of the box");
        let step = steps_of(voxels);
        self.for_each_run(voxels, |axis, at, bytes| {
            if axis == 0 {
                out[at * size..][..bytes.len()].copy_from_slice(bytes);
            } else {
                for (i, sample) in bytes.chunks_exact(size).enumerate() {
                    out[(at + i * step[axis]) * size..][..size].copy_from_slice(sample);
                }
            }
        })?;
        if self.big_endian {
            swap_bytes(out, size);
        }
        Ok(())
    }

    fn will_need(&self, voxels: IndexBox) {
        // The rows between the first and the last of each slice; slices of a large volume are far
        // apart. Others are asked for together.
        let slowest_is_z = self.strides[2].unsigned_abs() >= self.strides[1].unsigned_abs();
        if voxels.is_empty() || !slowest_is_z || self.strides.iter().any(|&s| s < 0) {
            return;
        }
        let size = self.info.field.scalar.bytes() as u64;
        let mut asked: Option<(usize, Range<u64>)> = None;
        for z in voxels.lo[2]..voxels.hi[2] {
            let (part, z) = ((z / self.slices_per_part) as usize, z % self.slices_per_part);
            let lo = self.byte_of(part, [voxels.lo[0], voxels.lo[1], z]);
            let hi = self.byte_of(part, [voxels.hi[0] - 1, voxels.hi[1] - 1, z]) + size;
            match &mut asked {
                Some((before, range)) if *before == part && lo <= range.end.saturating_add(BETWEEN) => {
                    range.end = hi
                }
                _ => {
                    let before = asked.replace((part, lo..hi));
                    before.into_iter().for_each(|(part, range)| self.parts[part].advise_will_need(range));
                }
            }
        }
        asked.into_iter().for_each(|(part, range)| self.parts[part].advise_will_need(range));
    }

    fn release(&self, slices: Range<u64>) {
        // Only where the bytes of a slice lie together are they those of these slices alone.
        let [x, y, z] = self.strides;
        let (row, slice) =
            (x.saturating_mul(self.info.dims[0] as i64), y.saturating_mul(self.info.dims[1] as i64));
        if x <= 0 || row > y || slice > z || slices.is_empty() {
            return;
        }
        let per = self.slices_per_part;
        for part in slices.start / per..=(slices.end - 1) / per {
            let lo = slices.start.max(part * per) - part * per;
            let hi = slices.end.min((part + 1) * per) - part * per;
            let part = part as usize;
            self.parts[part].release(self.byte_of(part, [0, 0, lo])..self.byte_of(part, [0, 0, hi]));
        }
    }
}

/// Steps along x, y, z in the x-fastest array of a box.
fn steps_of(voxels: IndexBox) -> [usize; 3] {
    let d = voxels.dims().map(|n| n as usize);
    [1, d[0], d[0] * d[1]]
}

/// Refuses a layout whose first or last byte lies outside the file. All in `i128`, where nothing of
/// a header overflows unseen.
fn check_extent(
    info: &VolumeInfo,
    source: &ByteSource,
    dims: [u64; 3],
    offset: u64,
    strides: [i64; 3],
) -> Result<()> {
    let scalar = info.field.scalar;
    let reach = |a: usize| i128::from(dims[a] - 1).checked_mul(i128::from(strides[a]));
    let (mut lo, mut hi) = (i128::from(offset), i128::from(offset) + scalar.bytes() as i128);
    let mut fits = true;
    for a in 0..3 {
        match reach(a) {
            Some(r) if r < 0 => lo = lo.saturating_add(r),
            Some(r) => hi = hi.saturating_add(r),
            None => fits = false,
        }
    }
    if fits && lo >= 0 && hi <= i128::from(source.len()) {
        return Ok(());
    }
    let [x, y, z] = dims;
    let expected =
        format!("{x} x {y} x {z} samples of {} from byte {offset} on, to byte {hi}", scalar.name());
    let got = format!("a file of {} bytes", source.len());
    Err(Error::bad_input(source.path(), "samples", expected, got)
        .with_help("the file is cut short, or its dimensions or type are wrong"))
}

/// Reverses the bytes of each sample of `size` bytes.
pub fn swap_bytes(samples: &mut [u8], size: usize) {
    match size {
        1 => {}
        2 => samples.chunks_exact_mut(2).for_each(|s| s.swap(0, 1)),
        _ => samples.chunks_exact_mut(size).for_each(<[u8]>::reverse),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Geometry;
    use crate::volume::FieldInfo;
    use crate::volume::units::Units;

    fn info(dims: [u64; 3], scalar: ScalarType) -> VolumeInfo {
        let field = FieldInfo { name: "data".into(), scalar, components: 1 };
        VolumeInfo {
            path: "test.raw".into(),
            format: "test".into(),
            dims,
            fields: vec![field.clone()],
            field,
            geometry: Geometry::default(),
            slope: 1.0,
            intercept: 0.0,
            missing: None,
            units: Units::default(),
            notes: vec![],
            data_files: vec![],
            assumed: crate::volume::Assumed::default(),
            is_labels: false,
        }
    }

    /// A 4 x 3 x 2 volume whose sample is 100 z + 10 y + x, stored as u16 with the given order of
    /// axes, fastest first.
    fn ordered(order: [usize; 3], big_endian: bool) -> StridedVolume {
        let dims = [4u64, 3, 2];
        let mut strides = [0i64; 3];
        let mut step = 2;
        for a in order {
            strides[a] = step;
            step *= dims[a] as i64;
        }
        let mut bytes = vec![9u8; 5 + 48];
        for (z, y, x) in (0..2).flat_map(|z| (0..3).flat_map(move |y| (0..4).map(move |x| (z, y, x)))) {
            let v = (100 * z + 10 * y + x) as u16;
            let at = 5 + (x * strides[0] + y * strides[1] + z * strides[2]) as usize;
            let b = if big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
            bytes[at..at + 2].copy_from_slice(&b);
        }
        let source = Arc::new(ByteSource::from_vec("test.raw", bytes));
        StridedVolume::new(info(dims, ScalarType::U16), source, 5, big_endian, strides).unwrap()
    }

    #[test]
    fn every_axis_order_reads_alike() {
        for order in [[0, 1, 2], [2, 1, 0], [1, 0, 2], [1, 2, 0], [0, 2, 1], [2, 0, 1]] {
            for big in [false, true] {
                let v = ordered(order, big);
                let part = IndexBox { lo: [1, 0, 1], hi: [4, 2, 2] };
                let (mut out, mut stored) = (vec![0.0; 6], vec![0; 12]);
                v.read_box(part, &mut out).unwrap();
                assert_eq!(out, [101.0, 102.0, 103.0, 111.0, 112.0, 113.0]);
                v.read_stored(part, &mut stored).unwrap();
                assert_eq!(stored, [101, 0, 102, 0, 103, 0, 111, 0, 112, 0, 113, 0]);
                v.will_need(part);
                v.read_box(IndexBox { lo: [2; 3], hi: [2; 3] }, &mut []).unwrap();
            }
        }
    }

    #[test]
    fn negative_steps_and_stacks() {
        let source = Arc::new(ByteSource::from_vec("f", (0..24).collect()));
        let v = StridedVolume::new(info([4, 3, 2], ScalarType::U8), source, 3, false, [-1, 4, 12]).unwrap();
        let mut out = [0.0; 4];
        v.read_box(IndexBox { lo: [0, 1, 1], hi: [4, 2, 2] }, &mut out).unwrap();
        assert_eq!(out, [19.0, 18.0, 17.0, 16.0]);
        let parts =
            (0..3u8).map(|p| Arc::new(ByteSource::from_vec("p", (0..9).map(|i| 10 * p + i).collect())));
        let v =
            StridedVolume::stacked(info([2, 2, 6], ScalarType::U8), parts.collect(), 2, 1, false, [1, 2, 4])
                .unwrap();
        let mut out = [0.0; 4];
        v.read_box(IndexBox { lo: [1, 1, 1], hi: [2, 2, 5] }, &mut out).unwrap();
        assert_eq!(out, [8.0, 14.0, 18.0, 24.0]);
    }

    #[test]
    fn layouts_outside_the_file_are_refused() {
        let source = Arc::new(ByteSource::from_vec("f", vec![0; 24]));
        let open = |dims, offset, strides| {
            StridedVolume::new(info(dims, ScalarType::U8), Arc::clone(&source), offset, false, strides)
        };
        assert!(open([4, 3, 2], 0, [1, 4, 12]).is_ok());
        let big = u64::MAX;
        for (dims, offset, strides) in [
            ([4, 3, 2], 1, [1, 4, 12]),
            ([0, 3, 2], 0, [1, 4, 12]),
            ([4, 3, 2], 0, [-1, 4, 12]),
            ([5, 3, 2], 0, [1, 4, 12]),
            ([big; 3], big, [i64::MAX; 3]),
            ([big; 3], 0, [i64::MIN; 3]),
            ([1, 1, 2], 0, [1, 1, i64::MAX]),
            ([1, 1, 1], 24, [1, 1, 1]),
        ] {
            let error = open(dims, offset, strides).unwrap_err();
            assert_eq!(error.exit_code(), 5, "{error}");
        }
        assert_eq!(StridedVolume::packed_strides([big, 1, 1], ScalarType::U8), None);
        assert_eq!(StridedVolume::packed_strides([1 << 40, 1 << 40, 1], ScalarType::U8), None);
    }

    #[test]
    fn values_of_every_type() {
        let mut out = [0.0f32; 2];
        macro_rules! check {
            ($t:ty, $scalar:expr, $a:expr, $b:expr) => {
                let (a, b): ($t, $t) = ($a, $b);
                for big in [false, true] {
                    let pair = if big {
                        [a.to_be_bytes(), b.to_be_bytes()]
                    } else {
                        [a.to_le_bytes(), b.to_le_bytes()]
                    };
                    convert_row(&pair.concat(), $scalar, big, 1.0, 0.0, None, &mut out);
                    assert_eq!(out, [(a as f64) as f32, (b as f64) as f32]);
                    convert_row(&pair.concat(), $scalar, big, 2.5, -1.0, Some(a as f64), &mut out);
                    assert!(out[0].is_nan());
                    assert_eq!(out[1], (2.5 * (b as f64) - 1.0) as f32);
                    convert_row(&pair.concat(), $scalar, big, 2.5, -1.0, Some(f64::NAN), &mut out);
                    assert_eq!(out[0], (2.5 * (a as f64) - 1.0) as f32);
                }
            };
        }
        check!(u8, ScalarType::U8, 3, 255);
        check!(i8, ScalarType::I8, -3, 127);
        check!(u16, ScalarType::U16, 3, 65535);
        check!(i16, ScalarType::I16, -300, 32767);
        check!(u32, ScalarType::U32, 3, u32::MAX);
        check!(i32, ScalarType::I32, -70000, i32::MAX);
        check!(u64, ScalarType::U64, 3, u64::MAX);
        check!(i64, ScalarType::I64, i64::MIN, 1 << 40);
        check!(f32, ScalarType::F32, -1e20, 1.5);
        // 0.1 is no half: it is compared as the nearest one.
        for (big, pair) in [(false, [0x66, 0x2e, 0x00, 0xfc]), (true, [0x2e, 0x66, 0xfc, 0x00])] {
            convert_row(&pair, ScalarType::F16, big, 1.0, 0.0, None, &mut out);
            assert_eq!(out, [0.099_975_586, f32::NEG_INFINITY]);
            convert_row(&pair, ScalarType::F16, big, 2.0, 1.0, Some(0.1), &mut out);
            assert!(out[0].is_nan() && out[1] == f32::NEG_INFINITY);
        }
        check!(f64, ScalarType::F64, -1e300, 1.1);
        // A missing value written as decimal text is no f32; it is compared as one.
        convert_row(&1e20f32.to_le_bytes(), ScalarType::F32, false, 1.0, 0.0, Some(1e20), &mut out[..1]);
        assert!(out[0].is_nan());
    }
}
