//! Makes the segments of a pyramid: the details of all chunks, the coarse levels, then ranges.
//!
//! ```text
//!  samples of a chunk, with a halo ─▶ tiles of three levels ─▶ values-*.seg
//!                                  ╲▶ low coefficients ─▶ low-*.seg ─▶ all of them ─▶ coarse.seg
//!  all tiles, decoded as a reader does; samples of a chunk ─▶ ranges, corrections ─▶ ranges-*.seg
//!                                                          ╲▶ errors ─▶ sums-*.seg
//! ```
//!
//! Each arrow is a pass over chunks that goes on where a run was killed. The source is read twice.
//! Memory decides in which parts a chunk is made, and that changes no byte.

use super::build::{Build, SegmentSource, Segments};
use super::encode::BadSteps;
use super::encoded::EncodedChunk;
use super::series::SeriesPlan;
use super::sink::{SegmentFiles, is_whole};
use super::sums::FinishedSteps;
use super::workers::{MakeChunks, SegmentMaker};
use crate::archive::chunked::{BlockRange, ChunkSegment, ValueSummary};
use crate::archive::manifest::StepPlan;
use crate::archive::segment::{PlanHash, Segment, SegmentKind, SegmentWriter};
use crate::archive::tables::{ChunkErrors, encode_errors};
use crate::error::{Error, Result};
use crate::exec::{CancelToken, pool};
use crate::grid::{Chunk, ChunkId, IndexBox};
use crate::measure::{BrickErrors, ErrorSums, Squares};
use crate::pipeline::chunk::{Field, GridField};
use crate::pipeline::plan::{Layout, Shares, part_edge};
use crate::pipeline::read::{
    LevelNodes, StepView, bricks_of, chunk_place, index_box, pyramid_of, samples_of_level, scale_of,
};
use crate::pipeline::stage::StageTimes;
use isospan_wavelet::{Box3, Coarse, Correction, Pyramid, Scale, blocks_of, encode_corrections, encode_part};
use std::collections::HashMap;
use std::path::Path;
use std::time::Instant;

/// What is made of a step of a pyramid.
struct Work<'a> {
    pyramid: &'a Pyramid,
    scale: &'a Scale,
    correction: Correction,
    field: &'a GridField,
    /// Notes that the data of the step cannot be used.
    bad: &'a BadSteps,
    number: u64,
    /// The source, as messages name it.
    path: &'a Path,
    /// Samples along each axis of the parts of a chunk.
    edge: usize,
    shares: Shares,
    cancel: &'a CancelToken,
}

impl Work<'_> {
    fn samples(&self, chunk: &Chunk) -> Box3 {
        self.pyramid.chunk(chunk.brick_lo.map(|n| n as usize))
    }

    /// Reads samples as they are transformed: a value stands for those that are missing.
    fn read(&self, place: &IndexBox) -> Result<Vec<f32>> {
        let mut values = vec![0.0; place.len()];
        self.bad.note(0, self.number, self.field.read_window(*place, &mut values))?;
        Ok(values)
    }
}

/// Makes tiles and low coefficients.
struct DetailMaker<'a>(Work<'a>);

impl MakeChunks for DetailMaker<'_> {
    fn make(&self, chunk: &Chunk) -> Result<EncodedChunk> {
        let (work, mut times) = (&self.0, StageTimes::default());
        let at = chunk.brick_lo.map(|n| n as usize);
        let place = work.samples(chunk);
        let whole = work.pyramid.low_box(&place);
        let (mut tiles, mut low) = (HashMap::new(), vec![0.0f32; whole.len()]);
        for part in work.pyramid.parts(at, work.edge) {
            work.cancel.check()?;
            let start = Instant::now();
            let mut samples = work.read(&index_box(&work.pyramid.window(&part)))?;
            times.sample += start.elapsed();
            let start = Instant::now();
            samples.iter_mut().for_each(|v| *v = work.scale.enter(f64::from(*v)));
            let made = encode_part(work.pyramid, work.scale, &part, samples).map_err(|e| too_fine(&e))?;
            put(&mut low, &whole, &made.low, &work.pyramid.low_box(&part));
            tiles.extend(made.tiles);
            times.encode += start.elapsed();
        }
        Ok(EncodedChunk {
            points: place.len() as u64,
            mesh_blocks: vec![],
            value_blocks: vec![blocks_of(work.pyramid, at, &tiles)],
            sum_blocks: vec![vec![low.iter().flat_map(|v| v.to_le_bytes()).collect()]],
            times,
        })
    }

    fn points(&self, chunk: &Chunk) -> u64 {
        self.0.samples(chunk).len() as u64
    }

    fn product_bytes(&self, chunk: &Chunk, _: u64) -> u64 {
        self.points(chunk) + (64 << 10)
    }

    fn will_need(&self, chunk: &Chunk) {
        let window = self.0.pyramid.window(&self.0.samples(chunk));
        self.0.field.reader.will_need(index_box(&window));
    }

    fn pass(&self, chunk: &Chunk) {
        self.0.field.pass(chunk);
    }

    fn queue(&self) -> u64 {
        self.0.shares.queue
    }

    fn cancel(&self) -> &CancelToken {
        self.0.cancel
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

    /// Adds the errors of the levels from 1 on at the samples of a part.
    fn measure_levels(
        &self,
        samples: &[f32],
        place: &IndexBox,
        part: &IndexBox,
        sums: &mut [Squares],
    ) -> Result<()> {
        let samples_of_volume = self.work.pyramid.nodes(0).iter().map(|n| *n as u64).product();
        for (level, sums) in (1..).zip(sums) {
            let ends = samples_of_level(self.work.pyramid, level);
            let part = part.intersect(&IndexBox { lo: [0; 3], hi: ends });
            if part.is_empty() {
                continue;
            }
            let read;
            let nodes = match &self.levels[level - 1] {
                Some(nodes) => nodes,
                None => {
                    read = self.view.nodes_around(level, &part)?;
                    &read
                }
            };
            nodes.each_row(&part, rows_of(level, samples_of_volume), |[y, z], row| {
                let at = place.offset([part.lo[0], y, z]);
                sums.add_row(&samples[at..at + row.len()], row);
            });
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
                .with_help("give the largest error instead: --target-max"));
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
/// error; all levels together then take twice the time of one.
fn rows_of(level: usize, samples: u64) -> u64 {
    if samples > MEASURED_WHOLE { 1 << (level - 1).min(3) } else { 1 }
}

/// Magnitudes of whole numbers of which `f32` has each.
const WHOLE: f32 = 16_777_216.0;

impl MakeChunks for RangeMaker<'_> {
    fn make(&self, chunk: &Chunk) -> Result<EncodedChunk> {
        let (work, mut times) = (&self.work, StageTimes::default());
        let (at, place) = (chunk.brick_lo.map(|n| n as usize), work.samples(chunk));
        let (bricks, dims) = (bricks_of(work.pyramid, at), work.pyramid.nodes(0));
        let corrects = work.correction != Correction::None;
        let mut corrections = if corrects { vec![0; place.len()] } else { vec![] };
        let (mut ranges, mut sums) = (vec![BlockRange::NONE; bricks.len()], ErrorSums::default());
        let mut levels = vec![Squares::of_range(self.range); self.levels.len()];
        for part in work.pyramid.parts(at, work.edge) {
            work.cancel.check()?;
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
            let own = index_box(&part);
            let samples = if corrects || self.measured { work.read(&nodes)? } else { vec![] };
            if corrects {
                let corrected = self.correct(&nodes, &mut decoded, &samples);
                let numbers = work.bad.note(0, work.number, corrected)?;
                put(&mut corrections, &place, &cut(&numbers, &nodes, &own), &part);
            }
            if self.measured {
                let originals = cut(&samples, &nodes, &own);
                let found = cut(&decoded, &nodes, &own);
                let [nx, ny, _] = own.dims();
                for (i, (original, value)) in originals.iter().zip(&found).enumerate() {
                    sums.add(*original, *value, || {
                        let i = i as u64;
                        let [x, y, z] = [i % nx, i / nx % ny, i / nx / ny];
                        let [sx, sy] = [dims[0] as u64, dims[1] as u64];
                        ((own.lo[2] + z) * sy + own.lo[1] + y) * sx + own.lo[0] + x
                    });
                }
                self.measure_levels(&samples, &nodes, &own, &mut levels)?;
            }
            times.measure += start.elapsed();
            for (range, cells) in ranges.iter_mut().zip(&bricks) {
                // A brick lies in one part, but for cells at the end of one.
                let begins = (0..3).all(|a| (part.start[a]..end[a]).contains(&cells[a].start));
                if begins {
                    *range = range_of(&decoded, &nodes, cells);
                }
            }
        }
        let [min, max] = BlockRange::bounds(ranges.iter().copied());
        BlockRange::round(&mut ranges);
        let summary = ValueSummary { void: 0, min, max, ranges };
        let corrections = encode_corrections(&place, &corrections)
            .map_err(|e| Error::usage(format!("the error that is asked for: {e}")))?;
        let levels: Vec<BrickErrors> = levels.iter().map(Squares::errors).collect();
        let errors = self.measured.then(|| encode_errors(&ChunkErrors { sums, levels }));
        Ok(EncodedChunk {
            points: place.len() as u64,
            mesh_blocks: vec![],
            value_blocks: vec![vec![corrections, summary.encode()]],
            sum_blocks: vec![errors.into_iter().collect()],
            times,
        })
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

/// The range of the nodes of some cells.
fn range_of(values: &[f32], place: &IndexBox, cells: &[std::ops::Range<usize>; 3]) -> BlockRange {
    let [xs, ys, zs] = cells;
    let (mut min, mut max) = (f32::INFINITY, f32::NEG_INFINITY);
    for z in zs.start..=zs.end {
        for y in ys.start..=ys.end {
            let at = place.offset([xs.start, y, z].map(|n| n as u64));
            for &v in &values[at..=at + xs.len()] {
                min = if v < min { v } else { min };
                max = if v > max { v } else { max };
            }
        }
    }
    let count: usize = cells.iter().map(ExactSizeIterator::len).product();
    BlockRange { min: min + 0.0, max: max + 0.0, tets: count as u32 }
}

/// What a box has of an array over a larger one.
fn cut<T: Copy>(values: &[T], from: &IndexBox, part: &IndexBox) -> Vec<T> {
    let mut found = Vec::with_capacity(part.len());
    let width = part.dims()[0] as usize;
    for z in part.lo[2]..part.hi[2] {
        for y in part.lo[1]..part.hi[1] {
            let at = from.offset([part.lo[0], y, z]);
            found.extend_from_slice(&values[at..at + width]);
        }
    }
    found
}

/// Puts what a part has into an array over a larger box.
fn put<T: Copy>(values: &mut [T], to: &Box3, found: &[T], part: &Box3) {
    let (to, part) = (index_box(to), index_box(part));
    let width = part.dims()[0] as usize;
    let rows = (part.lo[2]..part.hi[2]).flat_map(|z| (part.lo[1]..part.hi[1]).map(move |y| (y, z)));
    for ((y, z), row) in rows.zip(found.chunks(width)) {
        let at = to.offset([part.lo[0], y, z]);
        values[at..at + width].copy_from_slice(row);
    }
}

fn too_fine(e: &isospan_wavelet::Error) -> Error {
    Error::usage(format!("the error that is asked for is below what f32 holds: {e}"))
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
        let mut n = 0;
        while n < series.plan.steps.len() {
            let bad = BadSteps::new(series.is_several());
            let done = self.pyramid_step(series, source, n, &finished, &bad, &mut made);
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

    fn pyramid_step(
        &self,
        series: &SeriesPlan,
        source: &SegmentSource<'_>,
        n: usize,
        finished: &FinishedSteps,
        bad: &BadSteps,
        made: &mut Segments,
    ) -> Result<()> {
        let (plan, step) = (&series.plan, &series.plan.steps[n]);
        let (hash, layout) = (plan.step_hash(n), self.layout.at(step.number));
        let whole = |kind, path: std::path::PathBuf, segment: u64| {
            is_whole(&path, kind, hash, &layout.chunks_of(segment))
        };
        let all = 0..layout.segment_count();
        let needs_sums = finished.needs_sums(step);
        let has_ranges = all.clone().all(|s| {
            whole(SegmentKind::Ranges, layout.ranges(s), s)
                && (!needs_sums || whole(SegmentKind::Sums, layout.sums(s), s))
        });
        let has_values = all.clone().all(|s| whole(SegmentKind::Values, layout.values(s), s));
        let has_coarse =
            Segment::open(layout.coarse(), SegmentKind::Coarse, Some(hash)).is_ok_and(|s| s.verify().is_ok());
        if has_values && has_coarse && has_ranges {
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
        let work = |edge| Work {
            pyramid: &pyramid,
            scale: &scale,
            correction,
            field: &field,
            bad,
            number: step.number,
            path: &series.sources[n].source.path,
            edge,
            shares: self.shares,
            cancel: &self.run.resources.cancel,
        };
        let edge = part_edge(plan.mesh.lattice.dims, self.shares.chunk);
        let samples = plan.mesh.lattice.dims.iter().product::<u64>();
        let name = |what: &str| match series.is_several() {
            true => format!("step {}: {what}", step.number),
            false => what.to_owned(),
        };
        if !(has_values && has_coarse) {
            self.progress.begin(&name("transform"), samples, "samples");
            let files = SegmentFiles::of_details(step.number, hash, &layout);
            self.chunks_of_pyramid(&DetailMaker(work(edge)), &files, source, series, made)?;
            // Each worker leaves low coefficients, and the last one makes the levels above.
            if source.segments != all {
                return Ok(());
            }
            make_coarse(&layout, hash, &pyramid, &scale, self.run.resources.memory)?;
        }
        let measured = step.measured;
        self.progress.begin(&name(if measured { "measure" } else { "look" }), samples, "samples");
        let archive = self.pyramid_archive(plan, n, made.coordinates)?;
        let view = archive.step_at(archive.manifest.steps.len() - 1);
        let view = view.keeping(usize::try_from(self.shares.all_chunks() / 4).unwrap_or(usize::MAX));
        let files = SegmentFiles::of_ranges(step.number, hash, needs_sums, &layout);
        let ranges = RangeMaker::new(work(edge), &view, step, self.run.resources.memory / 16)?;
        self.chunks_of_pyramid(&ranges, &files, source, series, made)
    }

    fn chunks_of_pyramid(
        &self,
        maker: &dyn MakeChunks,
        files: &SegmentFiles<'_>,
        source: &SegmentSource<'_>,
        series: &SeriesPlan,
        made: &mut Segments,
    ) -> Result<()> {
        let times = SegmentMaker {
            maker,
            files,
            chunks: &self.parts.chunks,
            segments: source.segments.clone(),
            pool: &pool(self.shares.workers)?,
            watch: &series.watch,
            progress: self.progress,
        }
        .make()?;
        made.times.add(&times);
        Ok(())
    }
}

/// Puts together the low coefficients of all chunks, and makes the coarse levels of them.
fn make_coarse(layout: &Layout, hash: PlanHash, pyramid: &Pyramid, scale: &Scale, memory: u64) -> Result<()> {
    let all = Box3::all(pyramid.nodes(pyramid.details()));
    let needed = 12 * all.len() as u64;
    if needed > memory {
        return Err(Error::memory("the coarse levels are made in memory", needed, memory));
    }
    let mut low = vec![0.0f32; all.len()];
    for segment in 0..layout.segment_count() {
        let file = ChunkSegment::open(layout.low(segment), SegmentKind::Low, Some(hash))?;
        let mut bytes = vec![];
        for id in layout.chunks_of(segment).map(ChunkId) {
            file.block(id, 0, &mut bytes)?;
            let place = pyramid.low_box(&pyramid.chunk(chunk_place(pyramid, id)));
            let (values, _) = bytes.as_chunks::<4>();
            let values: Vec<f32> = values.iter().map(|b| f32::from_le_bytes(*b)).collect();
            if values.len() != place.len() {
                let (expected, got) = (format!("{} numbers", place.len()), values.len().to_string());
                return Err(Error::bad_input(layout.low(segment), format!("chunk {}", id.0), expected, got));
            }
            put(&mut low, &all, &values, &place);
        }
    }
    let bytes = Coarse::encode(pyramid, scale, low).map_err(|e| too_fine(&e))?;
    let mut file = SegmentWriter::create(layout.coarse(), SegmentKind::Coarse, hash)?;
    file.push_block(&bytes)?;
    file.finish()?;
    Ok(())
}
