//! Levels for a volume, or for a series of them: one pass over the samples of each step
//! ([`crate::density`]).
//!
//! Errors of several fields are added as parts of the range of each, since kelvins and pascals
//! cannot be added. The range is known when all steps of a field were read; these come field after
//! field.

use super::access::{ChunkCache, ReadBox, random_access};
use super::shift::{Reading, treat_missing};
use crate::density::{Bend, BlockErrors, Choice, ErrorCurves};
use crate::pipeline::plan::estimate;
use crate::pipeline::settings::{Adapt, RunSettings};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Silent, pool};
use isospan_io::geom::Lattice;
use isospan_io::grid::{BrickGrid, BrickId};
use isospan_io::volume::{VolumeReader, VolumeSource};
use rayon::prelude::*;

/// Blocks that are read and measured before their errors are added, in order.
const BLOCKS_AT_ONCE: u64 = 64;
/// Bytes of a block's samples and of its errors.
const BLOCK_BYTES: u64 = 33 * 33 * 33 * 4 + 17 * 17 * 17 * 48;

/// Measures the errors of steps.
pub(in crate::pipeline) struct Errors<'a> {
    adapt: &'a Adapt,
    run: &'a RunSettings,
    /// Whether steps have several fields.
    of_fields: bool,
    /// The name of the field whose steps are read, and its errors in its own units.
    field: Option<String>,
    here: FieldErrors,
    /// The errors of the fields before it, as parts of their ranges.
    before: Option<FieldErrors>,
}

/// The errors of a field.
struct FieldErrors {
    curves: ErrorCurves,
    bend: Bend,
    range: Option<[f32; 2]>,
}

impl FieldErrors {
    fn new(lattice: Lattice) -> Self {
        Self { curves: ErrorCurves::new(lattice), bend: Bend::default(), range: None }
    }

    /// Adds those of another field, as parts of its range.
    fn add_field(&mut self, other: &Self) {
        let range = other.range.map_or(0.0, |[lo, hi]| f64::from(hi) - f64::from(lo));
        // A constant has no errors.
        if range > 0.0 {
            let scale = 1.0 / (range * range);
            self.curves.add_field(&other.curves, scale);
            self.bend.add(&other.bend.scaled(scale));
        }
    }
}

/// What is found in a block.
struct BlockFindings {
    errors: BlockErrors,
    bend: Bend,
    /// The range of its samples.
    range: Option<[f32; 2]>,
}

/// Memory to find errors in: those of the field that is read, and those of others.
fn needed(lattice: Lattice, of_fields: bool) -> u64 {
    let curves = ErrorCurves::bytes_for(lattice) * if of_fields { 2 } else { 1 };
    estimate::BASE + curves + BLOCKS_AT_ONCE * BLOCK_BYTES
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
    pub(in crate::pipeline) fn new(
        lattice: Lattice,
        adapt: &'a Adapt,
        run: &'a RunSettings,
        of_fields: bool,
    ) -> Result<Self> {
        let needed = needed(lattice, of_fields);
        if run.resources.memory < needed {
            let purpose = "to find where points are needed";
            return Err(Error::memory(purpose, needed, run.resources.memory));
        }
        let here = FieldErrors::new(lattice);
        Ok(Self { adapt, run, of_fields, field: None, here, before: None })
    }

    /// Adds the errors of a step, of a field where each step has several: field after field.
    pub(in crate::pipeline) fn add(
        &mut self,
        source: VolumeSource,
        reading: Reading,
        field: Option<&str>,
    ) -> Result<()> {
        if self.of_fields && self.field.as_deref() != field {
            self.end_field();
            self.field = field.map(str::to_owned);
        }
        let blocks = BlockErrors::blocks(self.here.curves.cells());
        let held = needed(blocks.lattice, self.of_fields);
        let cache = ChunkCache::fitting(&source, boxes_of(&blocks), false, held, self.run);
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
                let here = &mut self.here;
                here.curves.add(&errors);
                here.bend.add(&bend);
                let ranges = [here.range, range].into_iter().flatten();
                here.range = ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
            }
        }
        Ok(())
    }

    /// Adds the errors of the field that was read to those of the fields before it.
    fn end_field(&mut self) {
        let lattice = self.here.curves.cells().lattice;
        let read = std::mem::replace(&mut self.here, FieldErrors::new(lattice));
        self.before.get_or_insert_with(|| FieldErrors::new(lattice)).add_field(&read);
    }

    /// The errors of all steps, once all were added.
    pub(in crate::pipeline) fn finished(mut self) -> Self {
        if self.of_fields {
            self.end_field();
            self.here = self.before.take().expect("a field has ended");
            // Parts of the range.
            self.here.range = Some([0.0, 1.0]);
        }
        self
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
        let errors = BlockErrors::measure(self.here.curves.cells(), &samples, &values);
        Ok(BlockFindings { errors, bend: Bend::of(&samples, &values), range })
    }

    /// The range of the samples that were seen; of several fields, that of the parts of it.
    pub(in crate::pipeline) fn range(&self) -> [f64; 2] {
        self.here.range.unwrap_or_default().map(f64::from)
    }

    /// The number of points with which the error is about this.
    pub(in crate::pipeline) fn count_of_rms(&self, rms: f64) -> Result<u64> {
        Ok(pool(self.run.resources.worker_threads())?
            .install(|| Choice::count_of_rms(&self.here.curves, rms)))
    }

    /// Levels at which errors are about `bound` everywhere, with at most `most` points.
    pub(in crate::pipeline) fn choice_of_bound(&self, bound: f64, most: u64) -> Result<Choice> {
        let choice = pool(self.run.resources.worker_threads())?
            .install(|| Choice::of_bound(&self.here.curves, bound, most))?;
        Ok(choice.stretched(&self.here.bend))
    }

    /// The levels of `count` points.
    pub(in crate::pipeline) fn choice(&self, count: u64) -> Result<Choice> {
        let choice = pool(self.run.resources.worker_threads())?
            .install(|| Choice::of_count(&self.here.curves, count))?;
        Ok(choice.stretched(&self.here.bend))
    }
}
