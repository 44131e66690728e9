//! Levels for a volume, or for a series of them: one pass over the samples of each step
//! ([`crate::density`]).

use super::access::{ChunkCache, ReadBox, random_access};
use super::shift::{Reading, treat_missing};
use crate::density::{Bend, BlockErrors, Choice, ErrorCurves};
use crate::error::{Error, Result};
use crate::exec::{Silent, pool};
use crate::geom::Lattice;
use crate::grid::{BrickGrid, BrickId};
use crate::pipeline::plan::estimate;
use crate::pipeline::settings::{Adapt, RunSettings};
use crate::volume::{VolumeReader, VolumeSource};
use rayon::prelude::*;

/// Blocks that are read and measured before their errors are added, in order.
const BLOCKS_AT_ONCE: u64 = 64;
/// Bytes of a block's samples and of its errors.
const BLOCK_BYTES: u64 = 33 * 33 * 33 * 4 + 17 * 17 * 17 * 48;

/// Measures the errors of steps.
pub(in crate::pipeline) struct Errors<'a> {
    adapt: &'a Adapt,
    run: &'a RunSettings,
    curves: ErrorCurves,
    bend: Bend,
    range: Option<[f32; 2]>,
}

/// What is found in a block.
struct BlockFindings {
    errors: BlockErrors,
    bend: Bend,
    /// The range of its samples.
    range: Option<[f32; 2]>,
}

/// Memory to find errors in.
fn needed(lattice: Lattice) -> u64 {
    estimate::BASE + ErrorCurves::bytes_for(lattice) + BLOCKS_AT_ONCE * BLOCK_BYTES
}

/// The most blocks that are checked to find how many chunks of a source meet one.
const MOST_LOOKED_AT: u64 = 1 << 16;

/// The samples of all blocks, or of some that stand for all.
fn boxes_of(blocks: &BrickGrid) -> impl Iterator<Item = ReadBox> + use<'_> {
    let step = blocks.len().div_ceil(MOST_LOOKED_AT).max(1);
    (0..blocks.len()).step_by(step as usize).map(|block| {
        let samples = BlockErrors::samples_of(blocks, BrickId(block));
        ReadBox { samples, own: samples }
    })
}

impl<'a> Errors<'a> {
    /// # Errors
    /// [`Error::Budget`] when the memory does not hold the curves.
    pub(in crate::pipeline) fn new(lattice: Lattice, adapt: &'a Adapt, run: &'a RunSettings) -> Result<Self> {
        let needed = needed(lattice);
        if run.resources.memory < needed {
            let purpose = "to find where points are needed";
            return Err(Error::memory(purpose, needed, run.resources.memory));
        }
        Ok(Self { adapt, run, curves: ErrorCurves::new(lattice), bend: Bend::default(), range: None })
    }

    /// Adds the errors of a step.
    pub(in crate::pipeline) fn add(&mut self, source: VolumeSource, reading: Reading) -> Result<()> {
        let blocks = BlockErrors::blocks(self.curves.cells());
        let cache = ChunkCache::fitting(&source, boxes_of(&blocks), false, needed(blocks.lattice), self.run);
        let (reader, _copy) = random_access(source, cache.map(|c| c.size), self.run, &Silent)?;
        let reader = reading.reader(reader);
        let pool = pool(self.run.resources.worker_threads())?;
        for first in (0..blocks.len()).step_by(BLOCKS_AT_ONCE as usize) {
            self.run.resources.cancel.check()?;
            let run = first..(first + BLOCKS_AT_ONCE).min(blocks.len());
            let found: Result<Vec<_>> = pool.install(|| {
                run.into_par_iter()
                    .map(|block| self.block(&*reader, reading, &blocks, BrickId(block)))
                    .collect()
            });
            for BlockFindings { errors, bend, range } in found? {
                self.curves.add(&errors);
                self.bend.add(&bend);
                let ranges = [self.range, range].into_iter().flatten();
                self.range = ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
            }
        }
        Ok(())
    }

    fn block(
        &self,
        reader: &dyn VolumeReader,
        reading: Reading,
        blocks: &BrickGrid,
        block: BrickId,
    ) -> Result<BlockFindings> {
        let samples = BlockErrors::samples_of(blocks, block);
        let mut values = vec![0.0; samples.len()];
        reader.read_box(samples, &mut values)?;
        treat_missing(reading.missing(), reading.stand_in().unwrap_or(f32::NAN), &mut values);
        let seen = values.iter().filter(|v| !v.is_nan()).map(|&v| [v, v]);
        let range = seen.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        if let Some([lo, hi]) = self.adapt.focus.map(|f| f.map(|v| (v - reading.offset()) as f32)) {
            values.iter_mut().for_each(|v| *v = v.clamp(lo, hi));
        }
        let errors = BlockErrors::measure(self.curves.cells(), &samples, &values);
        Ok(BlockFindings { errors, bend: Bend::of(&samples, &values), range })
    }

    /// The range of the samples that were seen.
    pub(in crate::pipeline) fn range(&self) -> [f32; 2] {
        self.range.unwrap_or_default()
    }

    /// The number of points with which the error is about this.
    pub(in crate::pipeline) fn count_of_rms(&self, rms: f64) -> Result<u64> {
        Ok(pool(self.run.resources.worker_threads())?.install(|| Choice::count_of_rms(&self.curves, rms)))
    }

    /// Levels at which errors are about `bound` everywhere, with at most `most` points.
    pub(in crate::pipeline) fn choice_of_bound(&self, bound: f64, most: u64) -> Result<Choice> {
        let choice = pool(self.run.resources.worker_threads())?
            .install(|| Choice::of_bound(&self.curves, bound, most))?;
        Ok(choice.stretched(&self.bend))
    }

    /// The levels of `count` points.
    pub(in crate::pipeline) fn choice(&self, count: u64) -> Result<Choice> {
        let choice =
            pool(self.run.resources.worker_threads())?.install(|| Choice::of_count(&self.curves, count))?;
        Ok(choice.stretched(&self.bend))
    }
}
