//! Makes the segments of an archive, some steps of a series at a time.
//!
//! ```text
//!  steps   0 1 2 … 15 │ 16 … 31 │ …           as many at a time as memory and open files allow
//!  pass    mesh each chunk; sample, encode    │ decode each chunk; sample, encode    │ …
//! ```
//!
//! Chunks of sources are read through caches ([`super::cached`]). Other sources without random
//! access are copied into bricks, small ones together. The copies on disk at a time take no more
//! than 256 MiB, unless a single one is larger.
//!
//! The grouping of steps into passes does not affect any byte: a step refers to the one before,
//! from any pass. A step that turns out to be bad in its pass is left out where that is wanted. The
//! steps that refer to it then have another hash and are made again; all others are kept.

use super::encode::{BadSteps, ChunkMaker, StepInput, StoredMesh, Workspaces};
use super::fields::Fields;
use super::job::Job;
use super::reuse::ReusedChunks;
use super::series::{PlannedSource, SeriesPlan, is_of_data};
use super::sink::{SegmentFiles, has_mesh, has_values};
use super::sums::FinishedSteps;
use super::workers::{MakeChunks, SegmentMaker};
use crate::archive::chunked::ChunkSegment;
use crate::archive::manifest::{CoordinateRecord, Counts, Manifest, SegmentRecord, StepPlan, StoredStep};
use crate::archive::segment::{PlanHash, SegmentInfo, SegmentKind};
use crate::pipeline::chunk::{Field, OwnMesh, Recipe, SampleErrors, Samples};
use crate::pipeline::field::{MeasureSettings, StepErrors, field_errors};
use crate::pipeline::plan::{Layout, MeshParts, Plan, Shares};
use crate::pipeline::read::{Meter, OpenArchive, StepView, write_coordinates};
use crate::pipeline::settings::RunSettings;
use crate::pipeline::stage::StageTimes;
use isospan_io::error::{Error, Result};
use isospan_io::exec::Progress;
use isospan_io::grid::ChunkId;
use isospan_mesh::points::SetKind;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Copies the coordinates that a grid has of its own into the archive; a mesh has its world
/// positions anyway.
pub(in crate::pipeline) fn grid_coordinates(
    series: &SeriesPlan,
    layout: &Layout,
) -> Result<Option<CoordinateRecord>> {
    let (source, step) = (&series.sources[0].source, series.plan.first());
    if step.source.mesh.is_some() {
        return Ok(None);
    }
    write_coordinates(source, &series.plan, layout)
}

/// A pass that did not succeed.
struct Failed {
    error: Box<Error>,
    /// Positions in the plan of steps whose data cannot be used, and why.
    bad: BTreeMap<usize, String>,
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self { error: Box::new(error), bad: BTreeMap::new() }
    }
}

impl Segments {
    /// Segments that others have made.
    pub(in crate::pipeline) fn stored(coordinates: Option<CoordinateRecord>) -> Self {
        Self { coordinates, ..Self::default() }
    }
}

/// An archive that is being made: its place, its parts, its share of the machine.
pub(super) struct Build<'a> {
    pub(super) parts: &'a MeshParts,
    pub(super) layout: &'a Layout,
    /// The archive that has the mesh, and to which the steps are added.
    pub(super) old: Option<&'a Manifest>,
    /// Whether each step is measured against its source.
    pub(super) measure: bool,
    /// Whether what chunks add to sums stays.
    pub(super) keeps_sums: bool,
    pub(super) shares: Shares,
    pub(super) run: &'a RunSettings,
    pub(super) progress: &'a dyn Progress,
}

/// Which segments are made, from what, and by which threads.
pub(super) struct SegmentSource<'a> {
    pub(super) fields: &'a dyn Fields,
    /// Steps made at a time, at most.
    pub(super) at_once: usize,
    /// The segments, of all.
    pub(super) segments: Range<u64>,
    /// The try before, in a search: chunks that did not change are copied from it.
    pub(super) before: Option<&'a StepView>,
    /// One pool for all passes: what threads that end have freed stays with their process.
    pub(super) pool: &'a rayon::ThreadPool,
}

/// Segments that are all there, and what is known of them.
#[derive(Default)]
pub(in crate::pipeline) struct Segments {
    pub(super) times: StageTimes,
    /// Chunks that were copied from an earlier try.
    pub(super) reused_chunks: u64,
    /// Wall time of measuring.
    pub(super) measuring: Duration,
    /// Errors by the number of the step; not of steps that were there before.
    pub(super) errors: BTreeMap<u64, StepErrors>,
    /// The coordinates of a grid that has its own, which are in the archive.
    pub(super) coordinates: Option<CoordinateRecord>,
}

impl<'a> Build<'a> {
    /// The archive of a job.
    pub(super) fn new(job: &Job<'a>, layout: &'a Layout, parts: &'a MeshParts, shares: Shares) -> Self {
        let old = job.basis.archive().map(|archive| &archive.manifest);
        let (measure, run, progress) = (job.settings.measure, job.run, job.progress);
        Self { parts, layout, old, measure, keeps_sums: job.keeps_sums, shares, run, progress }
    }

    /// Makes all segments that are not there yet.
    pub(super) fn run(&self, series: &mut SeriesPlan, source: &SegmentSource<'_>) -> Result<Segments> {
        if series.plan.mesh.points.kind() == SetKind::Pyramid {
            return self.run_pyramid(series, source);
        }
        let (mut made, mut next) = (Segments::default(), 0);
        made.coordinates = self.coordinates(series)?;
        let (hash, segments) = (series.plan.mesh_hash(), &source.segments);
        let finished = FinishedSteps::of(self.layout, &series.plan);
        let mut has_mesh = self.old.is_some() || has_mesh(hash, self.layout, segments);
        while next < series.plan.steps.len() {
            let is_there = |series: &SeriesPlan, n: usize| {
                let (step, hash) = (&series.plan.steps[n], series.plan.step_hash(n));
                has_mesh && has_values(step, hash, self.layout, segments, &finished)
            };
            if is_there(series, next) {
                next += 1;
                continue;
            }
            let mut end = next + 1;
            while end < series.plan.steps.len().min(next + source.at_once)
                && PlannedSource::fit_together(&series.sources[next..=end])
                && series.follows(end)
                && !is_there(series, end)
            {
                end += 1;
            }
            match self.pass(series, source, next..end, has_mesh, &finished, &mut made) {
                Ok(()) => (next, has_mesh) = (end, true),
                Err(Failed { error, bad }) => {
                    if !self.run.keep_going || bad.is_empty() || bad.len() == series.plan.steps.len() {
                        return Err(*error);
                    }
                    series.leave_out(bad, self.layout)?;
                    // Where it was the first that is left out, another one is that.
                    made.coordinates = self.coordinates(series)?;
                }
            }
        }
        Ok(made)
    }

    /// Copies the coordinates that a grid has of its own into the archive, with its first step.
    pub(super) fn coordinates(&self, series: &SeriesPlan) -> Result<Option<CoordinateRecord>> {
        match self.old {
            Some(old) => Ok(old.coordinates().map(|(_, record)| record)),
            None => grid_coordinates(series, self.layout),
        }
    }

    /// Points of the chunks of some segments.
    pub(super) fn points(&self, segments: &Range<u64>) -> u64 {
        let (points, chunks) = (&self.parts.points, &self.parts.chunks);
        let all = segments.clone().flat_map(|s| self.layout.chunks_of(s));
        all.map(|c| points.count_in(&chunks.chunk(ChunkId(c)).core)).sum()
    }

    /// Makes the values of some steps, and the mesh where it is not there.
    fn pass(
        &self,
        series: &SeriesPlan,
        source: &SegmentSource<'_>,
        steps: Range<usize>,
        has_mesh: bool,
        finished: &FinishedSteps,
        made: &mut Segments,
    ) -> std::result::Result<(), Failed> {
        let (plan, parts) = (&series.plan, self.parts);
        let fields = open_fields(series, source.fields, &steps)?;
        let inputs: Vec<StepInput<'_>> =
            steps.clone().zip(&fields).map(|(n, field)| StepInput { plan: &plan.steps[n], field }).collect();
        let archive = match has_mesh {
            true => self.archive(plan, source, steps.start..steps.start, made.coordinates)?,
            false => None,
        };
        let archive = archive.map(|archive| archive.step_at(0));
        let base = plan.steps[steps.start].base;
        let stored = archive.as_ref().map(|archive| StoredMesh {
            archive,
            base: base.and_then(|base| archive.manifest.position(base.number)),
        });
        let reused = source.before.map(|before| ReusedChunks::new(before, plan, parts, steps.end));
        let reused = reused.transpose()?.flatten();
        let reused_chunks = reused.as_ref().map_or(0, ReusedChunks::count);
        let stage = match stored {
            None => self.stage_of_chunks(reused_chunks),
            Some(_) => stage_of_steps(&plan.steps[steps.clone()]),
        };
        self.progress.begin(&stage, self.points(&source.segments), "points");
        let recipe = self.recipe(plan, source.fields.own());
        let files = SegmentFiles::new(plan, &steps, stored.is_none(), self.layout, finished);
        let meter = self.meter(plan, made.coordinates);
        let maker = ChunkMaker {
            recipe: &recipe,
            block_tets: plan.mesh.block_tets,
            steps: &inputs,
            stored,
            reused: reused.as_ref().map(|reused| (reused, steps.clone())),
            meter: meter.as_ref(),
            sample_errors: sample_errors(plan, &fields, &steps),
            bad_steps: BadSteps::new(series.is_several()),
            shares: self.shares,
            workspaces: Workspaces::default(),
            cancel: &self.run.resources.cancel,
        };
        let done = self.make_segments(&maker, &files, series, source);
        let bad = maker.bad_steps.into_inner();
        let bad = bad.into_iter().map(|(n, reason)| (steps.start + n, reason)).collect();
        if !has_mesh {
            made.reused_chunks = reused_chunks;
        }
        made.times.add(&done.map_err(|error| Failed { error: Box::new(error), bad })?);
        if self.measure && !plan.steps[steps.start].measured {
            self.measure_steps(plan, source, steps, &fields, made)?;
        }
        Ok(())
    }

    /// Makes the chunks of some segments, which become files.
    pub(super) fn make_segments(
        &self,
        maker: &dyn MakeChunks,
        files: &SegmentFiles<'_>,
        series: &SeriesPlan,
        source: &SegmentSource<'_>,
    ) -> Result<StageTimes> {
        SegmentMaker {
            maker,
            files,
            chunks: &self.parts.chunks,
            segments: source.segments.clone(),
            pool: source.pool,
            watch: &series.watch,
            progress: self.progress,
        }
        .make()
    }

    fn recipe<'b>(&'b self, plan: &'b Plan, own: Option<OwnMesh<'b>>) -> Recipe<'b> {
        Recipe {
            points: &self.parts.points,
            bricks: plan.mesh.bricks(),
            order: self.parts.order,
            halo: self.parts.halo,
            own,
        }
    }

    /// What progress calls a pass that makes the mesh too.
    fn stage_of_chunks(&self, reused: u64) -> String {
        match (self.parts.chunks.len(), reused) {
            (_, 0) => "reduce".to_owned(),
            (chunks, reused) => format!("reduce {} of {chunks} chunks", chunks - reused),
        }
    }

    /// The meter for the spectrum of a step, where there may be one.
    fn meter(&self, plan: &Plan, coordinates: Option<CoordinateRecord>) -> Option<Meter> {
        let first =
            self.old.map_or(plan.first(), |old| old.coordinates().map_or(&old.steps[0].plan, |c| c.0));
        let file = (self.layout.at(first.number).coordinates(), first.hash(plan.mesh_hash()));
        let coordinates = coordinates.map(|_| file);
        Some(Meter::new(&plan.mesh, self.parts.points.len(), &first.source, coordinates))
    }

    /// Measures steps of a mesh that were just made, while their data are still open. Steps of a
    /// volume have been measured chunk by chunk.
    fn measure_steps(
        &self,
        plan: &Plan,
        source: &SegmentSource<'_>,
        steps: Range<usize>,
        fields: &[Field<'_>],
        made: &mut Segments,
    ) -> Result<()> {
        let start = Instant::now();
        let settings = MeasureSettings::of_run(self.run, self.shares.workers);
        let archive = self.archive(plan, source, steps.clone(), made.coordinates)?;
        let archive = archive.expect("there are steps before the end");
        let first = archive.manifest.steps.len() - steps.len();
        let originals: Vec<_> = fields.iter().map(|field| field.originals()).collect();
        let errors = field_errors(&archive, first, &originals, &settings, self.progress)?;
        made.errors.extend(steps.map(|n| plan.steps[n].number).zip(errors));
        made.measuring += start.elapsed();
        Ok(())
    }

    /// The segments that are made as an archive: the mesh, some steps, and those before them back
    /// to a keyframe. None when there is no such step.
    fn archive(
        &self,
        plan: &Plan,
        source: &SegmentSource<'_>,
        wanted: Range<usize>,
        coordinates: Option<CoordinateRecord>,
    ) -> Result<Option<Arc<OpenArchive>>> {
        // With coordinates of its own, a grid needs the first step, which has them.
        let mut first = if coordinates.is_some() { 0 } else { wanted.start.saturating_sub(1) };
        while first > 0 && plan.steps[first].base.is_some() {
            first -= 1;
        }
        let (mesh, mut steps) = match self.old {
            Some(old) => (old.mesh.clone(), old.steps.clone()),
            None if wanted.end == 0 => return Ok(None),
            None => {
                (self.records(source, plan.mesh_hash(), SegmentKind::Mesh, |n| self.layout.mesh(n))?, vec![])
            }
        };
        for n in first..wanted.end {
            let layout = self.layout.at(plan.steps[n].number);
            steps.push(StoredStep {
                values: self.records(source, plan.step_hash(n), SegmentKind::Values, |n| layout.values(n))?,
                ..StoredStep::of(plan.steps[n].clone())
            });
        }
        if self.old.is_none() {
            // They are expected with the first step.
            steps[0].coordinates = coordinates;
        }
        let counts = Counts { chunks: self.parts.chunks.len(), ..Counts::default() };
        let bases = self.old.map_or(vec![], |old| old.bases.clone());
        let manifest = Manifest::new(plan.mesh.clone(), counts, mesh, steps).with_bases(bases);
        OpenArchive::of(self.layout.root(), manifest).map(Some)
    }

    /// A step of a pyramid, by the number of its files, with those that it goes back to: the
    /// details of the segments that are made, without ranges.
    pub(super) fn pyramid_view(
        &self,
        plan: &Plan,
        source: &SegmentSource<'_>,
        number: u64,
    ) -> Result<StepView> {
        let position = |number: u64| plan.steps.iter().position(|step| step.number == number);
        let mut chain: Vec<usize> = position(number).into_iter().collect();
        while let Some(base) = chain.last().and_then(|&n| plan.steps[n].base)
            && let Some(n) = position(base.number)
        {
            chain.push(n);
        }
        let mut steps = self.old.map_or(vec![], |old| old.steps.clone());
        for n in chain.into_iter().rev() {
            let (layout, hash) = (self.layout.at(plan.steps[n].number), plan.step_hash(n));
            let values = self.records(source, hash, SegmentKind::Values, |s| layout.values(s))?;
            steps.push(StoredStep { values, ..StoredStep::of(plan.steps[n].clone()) });
        }
        let counts = Counts { chunks: self.parts.chunks.len(), ..Counts::default() };
        let bases = self.old.map_or(vec![], |old| old.bases.clone());
        let manifest = Manifest::new(plan.mesh.clone(), counts, vec![], steps).with_bases(bases);
        let at = manifest.position(number).expect("a step of the plan, or one that it refers to");
        Ok(OpenArchive::of(self.layout.root(), manifest)?.step_at(at))
    }

    /// Records of the segments that are made. Other segments have their place alone, because they
    /// are not read.
    fn records(
        &self,
        source: &SegmentSource<'_>,
        hash: PlanHash,
        kind: SegmentKind,
        path: impl Fn(u64) -> PathBuf,
    ) -> Result<Vec<SegmentRecord>> {
        let of = |n: u64| {
            if source.segments.contains(&n) {
                return Ok(ChunkSegment::open(path(n), kind, Some(hash))?.record());
            }
            let chunks = self.layout.chunks_of(n);
            let (first_chunk, chunks) = (chunks.start, chunks.end - chunks.start);
            Ok(SegmentRecord { first_chunk, chunks, info: SegmentInfo::default() })
        };
        (0..self.layout.segment_count()).map(of).collect()
    }
}

/// Opens the data of some steps.
fn open_fields<'a>(
    series: &SeriesPlan,
    fields: &'a dyn Fields,
    steps: &Range<usize>,
) -> std::result::Result<Vec<Field<'a>>, Failed> {
    let open = |n: usize| {
        let number = series.plan.steps[n].number;
        let opened = fields.open(series, n);
        let field = opened.map_err(|e| if series.is_several() { e.at_step(number) } else { e });
        field.map_err(|error| {
            let bad = is_of_data(&error).then(|| (n, error.to_string()));
            Failed { bad: bad.into_iter().collect(), error: Box::new(error) }
        })
    };
    steps.clone().map(open).collect()
}

/// The means to measure errors against the samples of each step; none where errors are not
/// measured.
fn sample_errors<'a>(
    plan: &Plan,
    fields: &'a [Field<'_>],
    steps: &Range<usize>,
) -> Option<(SampleErrors, Vec<Samples<'a>>)> {
    // All steps of a run are measured, or none.
    let samples: Option<Vec<_>> = fields.iter().map(|field| Samples::of(&field.originals())).collect();
    let samples = samples.filter(|_| plan.steps[steps.start].measured);
    samples.map(|samples| (SampleErrors::new(&plan.mesh.lattice), samples))
}

/// What progress calls a pass over steps whose mesh is there.
fn stage_of_steps(steps: &[StepPlan]) -> String {
    let [first, last] = [0, steps.len() - 1].map(|n| steps[n].number);
    format!("steps {first} to {last}")
}
