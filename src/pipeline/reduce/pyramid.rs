//! Makes the segments of a pyramid: the details of all chunks, the coarse levels, then ranges.
//!
//! ```text
//!  samples of a chunk, with a halo ─▶ tiles of three levels ─▶ values-*.seg
//!                                  ╲▶ low coefficients ─▶ low-*.seg ─▶ all of them ─▶ coarse.seg
//!  all tiles, decoded as a reader does; samples of a chunk ─▶ ranges, corrections ─▶ ranges-*.seg
//!                                                          ╲▶ errors ─▶ sums-*.seg
//! ```
//!
//! Values that cost little stand for missing samples while these are transformed; which they are is
//! told by masks, with the tiles and with the coarse levels.
//!
//! Each arrow is a pass over chunks that goes on where a run was killed. The source is read twice.
//! Memory decides in which parts a chunk is made, and that changes no byte.

use super::build::{Build, SegmentSource, Segments};
use super::coarse::{BaseTileError, BaseTiles, make_coarse, mask_of_nodes, too_fine};
use super::encode::BadSteps;
use super::encoded::EncodedChunk;
use super::labels::LabelMaker;
use super::series::SeriesPlan;
use super::sink::{SegmentFiles, is_whole};
use super::source::Work;
use super::sums::FinishedSteps;
use super::workers::MakeChunks;
use crate::archive::chunked::{BlockRange, ValueSummary};
use crate::archive::manifest::StepPlan;
use crate::archive::segment::{PlanHash, Segment, SegmentKind};
use crate::archive::tables::{ChunkErrors, encode_errors};
use crate::measure::{BrickErrors, ErrorSums, Squares};
use crate::pipeline::chunk::Field;
use crate::pipeline::plan::{Layout, part_edge};
use crate::pipeline::read::{
    Brick, LevelNodes, StepView, box3, bricks_of, cells_in, index_box, pyramid_of, range_of_cells,
    samples_of_level, scale_of,
};
use crate::pipeline::settings::NanPolicy;
use crate::pipeline::stage::StageTimes;
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::grid::{Chunk, IndexBox};
use isospan_wavelet::{Box3, Correction, Mask, MaskBuilder, blocks_of, encode_corrections, encode_part};
use std::collections::HashMap;
use std::path::PathBuf;
use std::time::Instant;

/// Makes tiles and low coefficients.
struct DetailMaker<'a> {
    work: Work<'a>,
    /// The step that tiles may refer to.
    base: Option<&'a StepView>,
}

impl MakeChunks for DetailMaker<'_> {
    fn make(&self, chunk: &Chunk) -> Result<EncodedChunk> {
        let (work, mut times) = (&self.work, StageTimes::default());
        let at = chunk.brick_lo.map(|n| n as usize);
        let place = work.samples(chunk);
        let whole = work.pyramid.low_box(&place);
        let (mut tiles, mut low) = (HashMap::new(), vec![0.0f32; whole.len()]);
        let mut mask = MaskBuilder::new(place);
        for part in work.pyramid.parts(at, work.edge) {
            work.cancel.check()?;
            let start = Instant::now();
            let window = work.pyramid.window(&part);
            let mut samples = work.read(&index_box(&window))?;
            if work.field.nan == NanPolicy::Mask {
                mask.add(&part, &window, &samples);
                work.fill(&window, &mut samples)?;
            }
            times.sample += start.elapsed();
            let start = Instant::now();
            samples.iter_mut().for_each(|v| *v = work.scale.enter(f64::from(*v)));
            let mut base = BaseTiles(self.base);
            let made = encode_part(work.pyramid, work.scale, &part, samples, &mut base);
            let made = made.map_err(|BaseTileError(e)| e)?;
            whole.copy_common(&mut low, &work.pyramid.low_box(&part), &made.low);
            tiles.extend(made.tiles);
            times.encode += start.elapsed();
        }
        let (mut blocks, mut low_blocks) = (blocks_of(work.pyramid, at, &tiles), vec![]);
        let mask = mask.finish();
        if !mask.is_empty() {
            let stride = work.pyramid.stride(work.pyramid.details());
            let known = Mask::new(place, mask.clone()).map_err(|e| too_fine(&e))?;
            low_blocks.extend(Some(mask_of_nodes(&known, &whole, stride)?).filter(|m| !m.is_empty()));
            blocks.push(mask);
        }
        low_blocks.push(low.iter().flat_map(|v| v.to_le_bytes()).collect());
        Ok(EncodedChunk {
            points: place.len() as u64,
            mesh_blocks: vec![],
            value_blocks: vec![blocks],
            sum_blocks: vec![low_blocks],
            times,
        })
    }

    fn points(&self, chunk: &Chunk) -> u64 {
        self.work.samples(chunk).len() as u64
    }

    fn product_bytes(&self, chunk: &Chunk, _: u64) -> u64 {
        self.points(chunk) + (64 << 10)
    }

    fn will_need(&self, chunk: &Chunk) {
        let window = self.work.pyramid.window(&self.work.samples(chunk));
        self.work.field.reader.will_need(index_box(&window));
    }

    fn pass(&self, chunk: &Chunk) {
        self.work.field.pass(chunk);
    }

    fn queue(&self) -> u64 {
        self.work.shares.queue
    }

    fn cancel(&self) -> &CancelToken {
        self.work.cancel
    }
}

/// Decodes what was made, compares it with the source, and says where which values are.
struct RangeMaker<'a> {
    work: Work<'a>,
    view: &'a StepView,
    /// Whether errors are measured.
    measured: bool,
    /// The range of the samples.
    range: f64,
    /// Levels from 1 on that are small enough to be held as a whole.
    levels: Vec<Option<LevelNodes>>,
}

impl<'a> RangeMaker<'a> {
    /// `held` bytes are for nodes of coarse levels, which chunk after chunk needs.
    fn new(work: Work<'a>, view: &'a StepView, step: &StepPlan, held: u64) -> Result<Self> {
        let (mut levels, mut left) = (vec![], held / 4);
        if step.measured {
            levels.resize_with(work.pyramid.coarsest(), || None);
            for level in (1..=work.pyramid.coarsest()).rev() {
                left = left.saturating_sub(work.pyramid.nodes(level).map(|n| n as u64).iter().product());
                if left == 0 {
                    break;
                }
                let all = IndexBox { lo: [0; 3], hi: samples_of_level(work.pyramid, level) };
                levels[level - 1] = Some(view.nodes_around(level, &all)?);
            }
        }
        let [lo, hi] = step.wavelet.map_or([0.0; 2], |wavelet| wavelet.range);
        Ok(Self { work, view, measured: step.measured, range: hi - lo, levels })
    }

    /// Widens the ranges of the bricks of coarse levels by the cells that begin in a part, and adds
    /// the errors of these levels at its samples, if they are measured.
    fn look_at_levels(
        &self,
        samples: &[f32],
        place: &IndexBox,
        part: &Box3,
        seen: &mut ChunkStatistics,
    ) -> Result<()> {
        let pyramid = self.work.pyramid;
        let ChunkStatistics { bricks, ranges, levels: sums, .. } = seen;
        let samples_of_volume = pyramid.nodes(0).iter().map(|n| *n as u64).product();
        for level in 1..=pyramid.details().max(sums.len()) {
            let ends = samples_of_level(pyramid, level);
            let here = index_box(part).intersect(&IndexBox { lo: [0; 3], hi: ends });
            if here.is_empty() {
                continue;
            }
            let read;
            let nodes = match self.levels.get(level - 1).and_then(Option::as_ref) {
                Some(nodes) => nodes,
                None => {
                    read = self.view.nodes_around(level, &here)?;
                    &read
                }
            };
            let own = cells_in(pyramid, part, level);
            for (brick, range) in
                bricks.iter().zip(ranges.iter_mut()).filter(|(brick, _)| brick.level == level)
            {
                let common = |a: usize| {
                    let (own, cells) = (&own[a], &brick.cells[a]);
                    own.start.max(cells.start)..own.end.min(cells.end)
                };
                let cells = [common(0), common(1), common(2)];
                if cells.iter().all(|cells| !cells.is_empty()) {
                    *range = range.and(nodes.range_of(&cells));
                }
            }
            if let Some(sums) = sums.get_mut(level - 1) {
                nodes.each_row(&here, rows_of(level, samples_of_volume), |[y, z], row| {
                    let at = place.offset([here.lo[0], y, z]);
                    sums.add_row(&samples[at..at + row.len()], row);
                });
            }
        }
        Ok(())
    }

    /// The corrections of a box of decoded samples, which become what readers get.
    fn correct(&self, place: &IndexBox, decoded: &mut [f32], samples: &[f32]) -> Result<Vec<i32>> {
        let Work { correction, path, .. } = &self.work;
        let bound = match correction {
            Correction::Quanta(quantum) => quantum / 2.0,
            Correction::None | Correction::Whole => 0.0,
        };
        let mut numbers = vec![0; decoded.len()];
        for (i, (value, sample)) in decoded.iter_mut().zip(samples).enumerate() {
            if sample.is_nan() {
                continue;
            }
            if *correction == Correction::Whole && (sample.fract() != 0.0 || sample.abs() > WHOLE) {
                let ([nx, ny, _], i) = (place.dims(), i as u64);
                let at = [i % nx, i / nx % ny, i / nx / ny];
                let [x, y, z] = [0, 1, 2].map(|a| place.lo[a] + at[a]);
                return Err(Error::bad_input(
                    path,
                    format!("sample ({x}, {y}, {z})"),
                    "whole numbers of at most 2^24, which alone are kept without loss",
                    sample.to_string(),
                )
                .with_help("give the largest error instead: `target_max`"));
            }
            numbers[i] = correction.number(*sample, *value, bound);
            *value = correction.correct(*value, numbers[i]);
        }
        Ok(numbers)
    }
}

/// Samples of a volume that is measured in every row at all levels.
const MEASURED_WHOLE: u64 = 1 << 20;

/// One row in how many a level is measured in. A coarse field is smooth, so few rows tell its
/// error; all levels together then take the time of one.
fn rows_of(level: usize, samples: u64) -> u64 {
    if samples > MEASURED_WHOLE { 1 << (level - 1).clamp(1, 3) } else { 1 }
}

/// Magnitudes of whole numbers of which `f32` has each.
const WHOLE: f32 = 16_777_216.0;

impl RangeMaker<'_> {
    /// Adds the errors of the samples of a part, `own`, of which samples and decoded values are
    /// those of `nodes`.
    fn add_errors(
        &self,
        nodes: &IndexBox,
        own: &IndexBox,
        [samples, decoded]: [&[f32]; 2],
        sums: &mut ErrorSums,
    ) {
        let [sx, sy, _] = self.work.pyramid.nodes(0).map(|n| n as u64);
        for z in own.lo[2]..own.hi[2] {
            for y in own.lo[1]..own.hi[1] {
                let first = [own.lo[0], y, z];
                let (at, number) = (nodes.offset(first), (z * sy + y) * sx + first[0]);
                let row = at..at + (own.hi[0] - own.lo[0]) as usize;
                for ((original, value), x) in samples[row.clone()].iter().zip(&decoded[row]).zip(0..) {
                    sums.add(*original, *value, || number + x);
                }
            }
        }
    }
}

/// What a chunk's decoded samples tell, part after part.
struct ChunkStatistics {
    /// The samples of the chunk.
    place: Box3,
    bricks: Vec<Brick>,
    /// Those of the bricks.
    ranges: Vec<BlockRange>,
    /// The least and the largest known sample.
    bounds: [f32; 2],
    /// How many samples are missing.
    void: usize,
    /// Numbers of quanta, of each sample if there are corrections.
    corrections: Vec<i32>,
    sums: ErrorSums,
    /// Errors of the levels from 1 on, if they are measured.
    levels: Vec<Squares>,
}

impl ChunkStatistics {
    fn nothing(maker: &RangeMaker<'_>, chunk: &Chunk) -> Self {
        let (work, pyramid) = (&maker.work, maker.work.pyramid);
        let (place, bricks) = (work.samples(chunk), bricks_of(pyramid, chunk.brick_lo.map(|n| n as usize)));
        let corrected = if work.correction == Correction::None { 0 } else { place.len() };
        let measured = if maker.measured { pyramid.coarsest() } else { 0 };
        Self {
            ranges: vec![BlockRange::NONE; bricks.len()],
            bounds: [f32::INFINITY, f32::NEG_INFINITY],
            void: 0,
            corrections: vec![0; corrected],
            sums: ErrorSums::default(),
            levels: vec![Squares::of_range(maker.range); measured],
            place,
            bricks,
        }
    }

    /// Sets the ranges of the finest bricks that begin in a part, of which the decoded values are
    /// those of `nodes`.
    fn look_at_bricks(&mut self, part: &Box3, nodes: &IndexBox, decoded: &[f32]) {
        let end = part.end();
        let finest = self.bricks.iter().take_while(|brick| brick.level == 0);
        for (range, Brick { cells, .. }) in self.ranges.iter_mut().zip(finest) {
            // A brick lies in one part, but for cells at the end of one.
            let begins = (0..3).all(|a| (part.start[a]..end[a]).contains(&cells[a].start));
            if begins {
                let known;
                (*range, known) = range_of_cells(decoded, nodes, cells);
                self.bounds = [self.bounds[0].min(known[0]), self.bounds[1].max(known[1])];
            }
        }
    }

    fn finish(mut self, measured: bool, times: StageTimes) -> Result<EncodedChunk> {
        let [min, max] = self.bounds;
        BlockRange::round(&mut self.ranges);
        let summary = ValueSummary { void: self.void as u32, min, max, ranges: self.ranges };
        let corrections = encode_corrections(&self.place, &self.corrections)
            .map_err(|e| Error::usage(format!("the error that is asked for: {e}")))?;
        let levels: Vec<BrickErrors> = self.levels.iter().map(Squares::errors).collect();
        let errors = measured.then(|| encode_errors(&ChunkErrors { sums: self.sums, levels }));
        Ok(EncodedChunk {
            points: self.place.len() as u64,
            mesh_blocks: vec![],
            value_blocks: vec![vec![corrections, summary.encode()]],
            sum_blocks: vec![errors.into_iter().collect()],
            times,
        })
    }
}

impl RangeMaker<'_> {
    /// Adds what the decoded samples of a part tell.
    fn look_at(&self, part: &Box3, seen: &mut ChunkStatistics, times: &mut StageTimes) -> Result<()> {
        let (work, dims) = (&self.work, self.work.pyramid.nodes(0));
        let corrects = work.correction != Correction::None;
        // The nodes of all cells that begin in the part.
        let end = part.end();
        let nodes = IndexBox {
            lo: part.start.map(|n| n as u64),
            hi: std::array::from_fn(|a| (end[a] + 1).min(dims[a]) as u64),
        };
        let start = Instant::now();
        let mut decoded = self.view.uncorrected(0, &nodes)?;
        times.encode += start.elapsed();
        let start = Instant::now();
        let around = box3(&nodes);
        let samples = match corrects || self.measured {
            true => work.read_into(&nodes, self.view.spare.nodes(nodes.len()))?,
            false => vec![],
        };
        if corrects {
            let corrected = self.correct(&nodes, &mut decoded, &samples);
            let numbers = work.bad.note(0, work.number, corrected)?;
            seen.place.copy_common(&mut seen.corrections, part, &around.values_of(&numbers, part));
        }
        if self.view.leave_out_missing(0, &nodes, &mut decoded)? {
            seen.void += around.values_of(&decoded, part).iter().filter(|v| v.is_nan()).count();
        }
        if self.measured {
            self.add_errors(&nodes, &index_box(part), [&samples, &decoded], &mut seen.sums);
        }
        self.look_at_levels(&samples, &nodes, part, seen)?;
        times.measure += start.elapsed();
        seen.look_at_bricks(part, &nodes, &decoded);
        [decoded, samples].into_iter().for_each(|nodes| self.view.spare.give_nodes(nodes));
        Ok(())
    }
}

impl MakeChunks for RangeMaker<'_> {
    fn make(&self, chunk: &Chunk) -> Result<EncodedChunk> {
        let (work, mut times) = (&self.work, StageTimes::default());
        let mut seen = ChunkStatistics::nothing(self, chunk);
        for part in work.pyramid.parts(chunk.brick_lo.map(|n| n as usize), work.edge) {
            work.cancel.check()?;
            self.look_at(&part, &mut seen, &mut times)?;
        }
        seen.finish(self.measured, times)
    }

    fn points(&self, chunk: &Chunk) -> u64 {
        self.work.samples(chunk).len() as u64
    }

    fn product_bytes(&self, chunk: &Chunk, _: u64) -> u64 {
        self.points(chunk) / 4 + (64 << 10)
    }

    fn will_need(&self, chunk: &Chunk) {
        if self.measured || self.work.correction != Correction::None {
            self.work.field.reader.will_need(index_box(&self.work.samples(chunk)));
        }
    }

    fn pass(&self, chunk: &Chunk) {
        self.work.field.pass(chunk);
    }

    fn queue(&self) -> u64 {
        self.work.shares.queue
    }

    fn cancel(&self) -> &CancelToken {
        self.work.cancel
    }
}

/// Which files of a step are whole, of those that a run before has left.
struct WholeFiles {
    /// Its coefficients or labels, and the coarse part.
    values: bool,
    ranges: bool,
}

impl WholeFiles {
    fn of(layout: &Layout, hash: PlanHash, needs_sums: bool, has_labels: bool) -> Self {
        let whole =
            |kind, path: PathBuf, segment: u64| is_whole(&path, kind, hash, &layout.chunks_of(segment));
        let mut all = 0..layout.segment_count();
        let ranges = all.clone().all(|s| {
            whole(SegmentKind::Ranges, layout.ranges(s), s)
                && (!needs_sums || whole(SegmentKind::Sums, layout.sums(s), s))
        });
        let has_coarse = has_labels
            || Segment::open(layout.coarse(), SegmentKind::Coarse, Some(hash))
                .is_ok_and(|s| s.verify().is_ok());
        let values = has_coarse && all.all(|s| whole(SegmentKind::Values, layout.values(s), s));
        Self { values, ranges }
    }
}

/// What the steps of a pyramid are made of.
#[derive(Clone, Copy)]
struct StepPass<'a> {
    series: &'a SeriesPlan,
    source: &'a SegmentSource<'a>,
    finished: &'a FinishedSteps,
    /// Gets the steps that cannot be read.
    bad: &'a BadSteps,
}

impl Build<'_> {
    /// Makes all segments of a pyramid that are not there yet.
    pub(super) fn run_pyramid(
        &self,
        series: &mut SeriesPlan,
        source: &SegmentSource<'_>,
    ) -> Result<Segments> {
        let mut made = Segments { coordinates: self.coordinates(series)?, ..Segments::default() };
        let finished = FinishedSteps::of(self.layout, &series.plan);
        let (mut n, mut before) = (0, None);
        while n < series.plan.steps.len() {
            let bad = BadSteps::new(series.is_several());
            let pass = StepPass { series, source, finished: &finished, bad: &bad };
            let done = self.pyramid_step(&pass, n, &mut before, &mut made);
            match done {
                Ok(()) => n += 1,
                Err(e) => {
                    let found = bad.into_inner();
                    let reason = found.into_values().next();
                    let Some(reason) = reason.filter(|_| self.run.keep_going && series.plan.steps.len() > 1)
                    else {
                        return Err(e);
                    };
                    series.leave_out([(n, reason)].into(), self.layout)?;
                    made.coordinates = self.coordinates(series)?;
                }
            }
        }
        Ok(made)
    }

    /// Makes a step. `before` is the one before, whose tiles may be in its cache; it becomes this
    /// one.
    fn pyramid_step(
        &self,
        pass: &StepPass<'_>,
        n: usize,
        before: &mut Option<StepView>,
        made: &mut Segments,
    ) -> Result<()> {
        let StepPass { series, source, finished, bad } = *pass;
        let (plan, step) = (&series.plan, &series.plan.steps[n]);
        let (hash, layout) = (plan.step_hash(n), self.layout.at(step.number));
        let needs_sums = finished.needs_sums(step);
        let has_labels = plan.mesh.has_labels();
        let there = WholeFiles::of(&layout, hash, needs_sums, has_labels);
        let before_step = before.take().map(StepView::without_base);
        if there.values && there.ranges {
            return Ok(());
        }
        let opened = source.fields.open(series, n);
        let opened = opened.map_err(|e| if series.is_several() { e.at_step(step.number) } else { e });
        let Field::Grid(field) = bad.note(0, step.number, opened)? else {
            return Err(Error::usage("only volumes are pyramids"));
        };
        let pyramid = pyramid_of(plan.mesh.points).expect("the plan is one of a pyramid");
        let wavelet = step.wavelet.expect("a step of a pyramid has a scale");
        let (scale, correction) = scale_of(&wavelet).map_err(|e| too_fine(&e))?;
        let work = Work {
            pyramid: &pyramid,
            scale: &scale,
            correction,
            field: &field,
            bad,
            number: step.number,
            path: &series.sources[n].source.path,
            edge: part_edge(plan.mesh.lattice.dims, self.shares.chunk),
            shares: self.shares,
            cancel: &self.run.resources.cancel,
        };
        let making = PyramidStep { build: self, series, source, step, hash, layout, work };
        let base = match (step.base, before_step.filter(|before| before.is_base_of(step))) {
            (Some(base), None) => Some(making.view(base.number)?),
            (_, known) => known,
        };
        if !there.values {
            making.values(base.as_ref(), made)?;
            // Each worker leaves low coefficients, and the last one makes the levels above.
            if source.segments != (0..making.layout.segment_count()) {
                return Ok(());
            }
            if !has_labels {
                let memory = self.run.resources.memory;
                make_coarse(&making.layout, hash, &pyramid, &scale, base.as_ref(), memory)?;
            }
        }
        *before = Some(making.ranges(base, needs_sums, made)?);
        Ok(())
    }
}

/// A step of a pyramid, as its segments are made.
struct PyramidStep<'a> {
    build: &'a Build<'a>,
    series: &'a SeriesPlan,
    source: &'a SegmentSource<'a>,
    step: &'a StepPlan,
    hash: PlanHash,
    layout: Layout,
    work: Work<'a>,
}

impl PyramidStep<'_> {
    /// Makes the labels, or the tiles and low coefficients.
    fn values(&self, base: Option<&StepView>, made: &mut Segments) -> Result<()> {
        let Self { step, hash, layout, work, .. } = self;
        if self.series.plan.mesh.has_labels() {
            self.begin("encode");
            let files = SegmentFiles::of_labels(step.number, *hash, layout);
            self.chunks(&LabelMaker(*work), &files, made)
        } else {
            self.begin("transform");
            let files = SegmentFiles::of_details(step.number, *hash, layout);
            self.chunks(&DetailMaker { work: *work, base }, &files, made)
        }
    }

    /// Makes ranges, corrections and errors, of values that are there; gives a view of the step.
    fn ranges(&self, base: Option<StepView>, needs_sums: bool, made: &mut Segments) -> Result<StepView> {
        let Self { build, step, hash, layout, work, .. } = self;
        self.begin(if step.measured { "measure" } else { "look" });
        let view = self.view(step.number)?.after(base);
        let files = SegmentFiles::of_ranges(step.number, *hash, needs_sums, layout);
        let ranges = RangeMaker::new(*work, &view, step, build.run.resources.memory / 16)?;
        self.chunks(&ranges, &files, made)?;
        view.spare.trim(0);
        Ok(view)
    }

    /// A view of the step of a number. Its decoded tiles, and those of the one before, have an
    /// eighth of the memory of all chunks.
    fn view(&self, number: u64) -> Result<StepView> {
        let cached = usize::try_from(self.build.shares.all_chunks() / 8).unwrap_or(usize::MAX);
        Ok(self.build.pyramid_view(&self.series.plan, self.source, number)?.keeping(cached))
    }

    /// Tells that a pass over all samples begins.
    fn begin(&self, what: &str) {
        let name = match self.series.is_several() {
            true => format!("step {}: {what}", self.step.number),
            false => what.to_owned(),
        };
        let samples = self.series.plan.mesh.lattice.dims.iter().product();
        self.build.progress.begin(&name, samples, "samples");
    }

    /// Makes the segments of one pass.
    fn chunks(&self, maker: &dyn MakeChunks, files: &SegmentFiles<'_>, made: &mut Segments) -> Result<()> {
        made.times.add(&self.build.make_segments(maker, files, self.series, self.source)?);
        Ok(())
    }
}
