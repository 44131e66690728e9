//! The steps of a series in an archive: how the values of one are read, or those between two.
//!
//! All steps have one mesh. A step has its own values, index and spectrum; a block of values may
//! hold differences to the same block of the step before, back to a keyframe:
//!
//! ```text
//!  step        0        1        2    …   16       17
//!  block n  values ◀─ diff. ◀─ diff.    values ◀─ diff.     a block of step 2: three blocks are read
//! ```
//!
//! Between two steps the field is linear in time. Then no index says which blocks have an answer: a
//! block where one step lies below an isovalue and the other above is active between them, and in
//! neither. So the ranges of all blocks of both are read. The range of a mean is the mean of the
//! ranges, or within it. This is true in rounded arithmetic too, because rounding keeps the order.

use super::choice::Moment;
use super::chunk_mesh::MeshedChunk;
use super::chunk_reader::ChunkReader;
use super::damaged::damaged;
use super::reader_memory::ReaderMemory;
use super::step_view::StepView;
use super::stored_values::{BlockAt, KnownValues};
use crate::archive::chunked::BlockRange;
use crate::archive::values::ValueBlocks;
use crate::index::{Entry, SpanIndex, index_entries};
use isospan_io::error::{Error, Result};
use isospan_io::grid::ChunkId;
use isospan_mesh::mesh::tet::is_active;

/// A value between two, `share` of the way from the first; void where one of them is. Monotonic in
/// both; a zero has no sign.
pub(super) fn mean(a: f32, b: f32, share: f64) -> f32 {
    (f64::from(a) * (1.0 - share) + f64::from(b) * share) as f32 + 0.0
}

impl StepView {
    /// Appends the values of a block of a chunk at this moment, and returns the bytes read.
    pub(super) fn values_block(&self, id: ChunkId, at: BlockAt<'_>, out: &mut Vec<f32>) -> Result<u64> {
        let Moment { step, beyond } = self.moment;
        let first = out.len();
        let mut bytes = self.stored_block(step, id, at, None, out)?;
        if let Some(share) = beyond {
            let mut next = vec![];
            bytes += self.stored_block(step + 1, id, at, None, &mut next)?;
            out[first..].iter_mut().zip(next).for_each(|(a, b)| *a = mean(*a, b, share));
        }
        Ok(bytes)
    }

    /// The values of all `vertices` of a chunk, at the step at a position in the manifest.
    pub(in crate::pipeline) fn chunk_values(
        &self,
        step: usize,
        id: ChunkId,
        vertices: usize,
    ) -> Result<Vec<f32>> {
        self.chunk_values_after(step, id, vertices, None)
    }

    /// As [`StepView::chunk_values`], at steps by ascending positions.
    pub(in crate::pipeline) fn chunk_values_of(
        &self,
        steps: &[usize],
        id: ChunkId,
        vertices: usize,
    ) -> Result<Vec<Vec<f32>>> {
        let mut out: Vec<Vec<f32>> = vec![];
        for (n, &step) in steps.iter().enumerate() {
            let before = n.checked_sub(1).map(|before| (steps[before], &*out[before]));
            let values = self.chunk_values_after(step, id, vertices, before)?;
            out.push(values);
        }
        Ok(out)
    }

    fn chunk_values_after(
        &self,
        step: usize,
        id: ChunkId,
        vertices: usize,
        before: Option<(usize, &[f32])>,
    ) -> Result<Vec<f32>> {
        let mut out = Vec::with_capacity(vertices);
        let blocks = &ValueBlocks::new(vertices);
        for block in 0..blocks.count() {
            let known =
                before.map(|(step, values)| KnownValues { step, values: &values[blocks.range(block)] });
            self.stored_block(step, id, BlockAt { block, blocks }, known, &mut out)?;
        }
        Ok(out)
    }

    /// The mesh of a chunk as it is stored: all its vertices, the tetrahedra block after block, and
    /// the end of each block.
    pub(in crate::pipeline) fn stored_mesh(&self, id: ChunkId) -> Result<(MeshedChunk, Vec<usize>)> {
        let mut reader = ChunkReader::open(self, id, ReaderMemory::default())?;
        let (mut tets, mut ends) = (vec![], vec![]);
        let blocks = self.mesh_sizes(id)?.tet_blocks;
        reader.expect(0..blocks);
        for block in 0..blocks {
            reader.tets(block, &mut tets)?;
            ends.push(tets.len());
        }
        reader.place_all()?;
        Ok((reader.into_mesh(tets), ends))
    }

    /// Least and largest value; between two steps, what bounds them.
    pub(in crate::pipeline) fn file_range(&self) -> Option<[f64; 2]> {
        self.value_range().map(|range| range.map(|v| self.step().plan.source.in_file(v)))
    }

    /// The same, less the archive's offset.
    pub(in crate::pipeline) fn value_range(&self) -> Option<[f32; 2]> {
        let Moment { step, beyond } = self.moment;
        let range = self.manifest.steps[step].value_range?;
        match beyond {
            None => Some(range),
            Some(share) => {
                let next = self.manifest.steps[step + 1].value_range?;
                Some([0, 1].map(|i| mean(range[i], next[i], share)))
            }
        }
    }

    /// The ranges by which blocks that can hold an answer are found.
    pub(in crate::pipeline) fn ranges(&self) -> Result<Ranges<'_>> {
        Ok(match self.moment.beyond {
            None => Ranges::Index(self.index()?),
            Some(share) => Ranges::Between(self, share),
        })
    }

    /// The blocks of all chunks whose range between two steps `wanted` accepts, in order.
    fn blocks_between(&self, share: f64, wanted: impl Fn(&Entry) -> bool) -> Result<Vec<Entry>> {
        let mut found = vec![];
        for id in (0..self.chunks.len()).map(ChunkId) {
            self.close_before(id);
            let [a, b] = [self.moment.step, self.moment.step + 1].map(|step| match self.is_pyramid() {
                true => self.archive().step_at(step).ranges_of(id)?.value_summary(id).map(|s| s.ranges),
                false => self.values_of(step, id)?.value_summary(id).map(|s| s.ranges),
            });
            let (a, b) = (a?, b?);
            if a.len() != b.len() {
                let what = format!("{} and {} ranges of blocks at two steps", a.len(), b.len());
                return Err(damaged(&*self.values_of(self.moment.step, id)?, id, "summary", &what));
            }
            let between = |(a, b): (&BlockRange, &BlockRange)| BlockRange {
                min: mean(a.min, b.min, share),
                max: mean(a.max, b.max, share),
                tets: a.tets.min(b.tets),
            };
            let ranges: Vec<BlockRange> = a.iter().zip(&b).map(between).collect();
            found.extend(index_entries(id.0, &ranges).filter(&wanted));
        }
        Ok(found)
    }
}

/// Answers the questions of a [`SpanIndex`] at a step, or between two.
pub(in crate::pipeline) enum Ranges<'a> {
    Index(SpanIndex),
    /// How far the next step is.
    Between(&'a StepView, f64),
}

impl Ranges<'_> {
    /// [`SpanIndex::query_any`].
    pub(in crate::pipeline) fn query_any(&self, isovalues: &[f32]) -> Result<Vec<Entry>> {
        match self {
            Self::Index(index) => index.query_any(isovalues),
            Self::Between(archive, share) => {
                let active = |e: &Entry| isovalues.iter().any(|&v| is_active(e.min, e.max, v));
                archive.blocks_between(*share, active)
            }
        }
    }

    /// [`SpanIndex::query_inside`].
    pub(in crate::pipeline) fn query_inside(
        &self,
        isovalue: f32,
        wanted: impl Fn(u64) -> bool,
    ) -> Result<Vec<Entry>> {
        match self {
            Self::Index(index) => index.query_inside(isovalue, wanted),
            Self::Between(archive, share) => {
                archive.blocks_between(*share, |e| isovalue <= e.max && wanted(e.chunk))
            }
        }
    }

    /// [`SpanIndex::query_values`].
    pub(in crate::pipeline) fn query_values(&self, low: f32, high: f32) -> Result<Vec<Entry>> {
        match self {
            Self::Index(index) => index.query_values(low, high),
            Self::Between(..) if low.is_nan() || high.is_nan() || low > high => {
                Err(Error::usage(format!("the range {low} to {high} is empty: give the lower value first")))
            }
            Self::Between(archive, share) => {
                archive.blocks_between(*share, |e| e.min <= high && low <= e.max)
            }
        }
    }

    /// Bytes read for the answers; those of value segments are counted by the archive.
    pub(in crate::pipeline) fn bytes_read(&self) -> u64 {
        match self {
            Self::Index(index) => index.bytes_read(),
            Self::Between(..) => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::archive::OpenArchive;
    use super::super::choice::StepChoice;
    use super::*;
    use crate::pipeline::{Amount, ReduceSettings, RunSettings, reduce_series};
    use isospan_io::exec::{Resources, Silent};
    use isospan_io::formats::RawLayout;
    use isospan_io::formats::{OpenOptions, StepSource};
    use isospan_io::volume::ScalarType;
    use isospan_mesh::points::SetKind;
    use std::path::Path;

    const DIMS: [u64; 3] = [14, 13, 12];

    /// Waves, and those of the next step, which lie elsewhere and higher.
    fn archive(dir: &Path) -> StepView {
        let raw = RawLayout { dims: DIMS, scalar: ScalarType::F32, big_endian: false, offset: 0 };
        let options = OpenOptions { raw: Some(raw), ..OpenOptions::default() };
        let step = |t: usize| {
            let wave =
                |i: u64| ((i % 14) as f32 * 0.7 + t as f32).sin() + (i / 182) as f32 * 0.2 + 3.0 * t as f32;
            let bytes: Vec<u8> = (0..DIMS.iter().product()).flat_map(|i| wave(i).to_le_bytes()).collect();
            let path = dir.join(format!("{t}.raw"));
            std::fs::write(&path, bytes).unwrap();
            StepSource::new(&path, &options)
        };
        let settings = ReduceSettings {
            amount: Amount::Count(900),
            chunk_points: 300,
            ..ReduceSettings::exact(SetKind::Regular)
        };
        let out = dir.join("a.isospan");
        let run =
            RunSettings { resources: Resources::default().with_memory(1 << 30), ..RunSettings::default() };
        reduce_series(&[step(0), step(1)], &settings, &out, &run, &Silent).unwrap();
        OpenArchive::open(&out).unwrap().at(StepChoice::Time(0.4)).unwrap()
    }

    /// By brute force over all blocks.
    #[test]
    fn between_two_steps_all_blocks_with_an_answer_are_found() {
        let dir = tempfile::tempdir().unwrap();
        let archive = archive(dir.path());
        let mut answers = 0;
        for isovalue in [-0.9, 0.5, 1.5, 2.5, 4.0] {
            let found: Vec<_> = archive.ranges().unwrap().query_any(&[isovalue]).unwrap();
            for id in (0..archive.chunks.len()).map(ChunkId) {
                let (mesh, ends) = archive.stored_mesh(id).unwrap();
                let mut values = vec![];
                let blocks = &mesh.value_blocks();
                for block in 0..blocks.count() {
                    archive.values_block(id, BlockAt { block, blocks }, &mut values).unwrap();
                }
                for (block, &end) in ends.iter().enumerate() {
                    let start = if block == 0 { 0 } else { ends[block - 1] };
                    let range = BlockRange::of(&mesh.tets[start..end], &values);
                    if is_active(range.min, range.max, isovalue) {
                        answers += 1;
                        assert!(found.iter().any(|e| e.chunk == id.0 && e.block as usize == block));
                    }
                }
            }
        }
        assert!(answers > 0);
        let [lo, hi] = archive.value_range().unwrap();
        assert!(lo < hi && hi < 6.0);
    }
}
