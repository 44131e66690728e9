//! A series: what its steps are, and how they are made.
//!
//! ```text
//!  steps   0 1 2 … 15 │ 16 … 31 │ …           as many at a time as memory and open files allow
//!  pass    mesh each chunk; sample, encode    │ decode each chunk; sample, encode    │ …
//! ```
//!
//! Chunks of sources are read through caches ([`super::cached`]). Other sources without random access are copied into bricks, small ones
//! together: the copies that are on the disk at a time take no more than 256 MiB, or there is one.
//!
//! How steps are taken together decides no byte: a step refers to the one before, whichever pass has made that.
//! A step that turns out to be bad in the middle of its pass is left out where that is wanted: the steps that refer to it have another hash then and are
//! made again; all else is found there and kept.

use super::encode::Workspaces;
use super::reuse::ReusedChunks;
use super::workers::{StageTimes, StepWork, Stored, Work};
use super::{sink, workers};
use crate::archive::chunked::ChunkSegment;
use crate::archive::manifest::{CoordinateRecord, Counts, Manifest, SegmentRecord, Step, StepPlan};
use crate::archive::segment::{PlanHash, SegmentInfo, SegmentKind};
use crate::error::{Error, Result};
use crate::exec::{Progress, pool};
use crate::formats::StepSource;
use crate::grid::ChunkId;
use crate::pipeline::chunk::{Field, OwnMesh, Recipe, SampleErrors, Samples};
use crate::pipeline::field::{MeasureSettings, StepErrors, field_errors};
use crate::pipeline::plan::{Attachments, Layout, MeshParts, Plan, Shares, Watch};
use crate::pipeline::read::{Meter, OpenArchive, StepView, write_coordinates};
use crate::pipeline::settings::RunSettings;
use crate::volume::chunked::ChunkShape;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A step that was left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct SkippedStep {
    /// The number that it would have had.
    pub number: u64,
    /// Its file.
    pub source: String,
    /// What is wrong with it.
    pub reason: String,
}

/// Where a step comes from.
#[derive(Clone)]
pub(in crate::pipeline) struct PlannedSource {
    pub(super) source: StepSource,
    /// Of one that is read by chunks.
    pub(super) chunks: Option<ChunkShape>,
    /// Bytes of decoded chunks in its cache, where it is read through one.
    pub(super) cached: Option<u64>,
    /// Bytes of the copy that is made of it alone; 0 where none is needed.
    pub(super) copied: u64,
    /// Bytes of a copy that is made of its file, once for all steps in that; 0 where none is needed.
    pub(super) shared_copy: u64,
    /// Memory to make that copy in, or to read its chunks one after another.
    pub(super) copying: u64,
}

/// Bytes of a copy that is made in memory, at most, where there is enough of that.
const SMALL_COPY: u64 = 4 << 20;
/// Bytes of copies that are on the disk at a time, where there is more than one.
const COPIES_TOGETHER: u64 = 256 << 20;

impl PlannedSource {
    /// One that is read where it lies.
    pub(super) fn in_place(source: StepSource) -> Self {
        Self { source, chunks: None, cached: None, copied: 0, shared_copy: 0, copying: 0 }
    }

    /// Whether these may be made in one pass.
    fn fit_together(sources: &[Self]) -> bool {
        sources.len() == 1 || sources.iter().map(|s| s.copied).fold(0, u64::saturating_add) <= COPIES_TOGETHER
    }

    /// Whether its copy is small.
    pub(super) fn is_small(&self) -> bool {
        self.copied <= SMALL_COPY
    }

    /// Bytes of the small copies of so many steps at a time, at most.
    pub(super) fn small_copies(sources: &[Self], at_once: usize) -> u64 {
        let largest = sources.iter().filter(|s| s.is_small()).map(|s| s.copied).max().unwrap_or(0);
        largest * at_once.min(sources.len()) as u64
    }

    /// Bytes of the copies that are on the disk at a time, at most.
    pub(super) fn copied_at_a_time(sources: &[Self]) -> u64 {
        let all = sources.iter().map(|s| s.copied).fold(0, u64::saturating_add);
        let largest = sources.iter().map(|s| s.copied.max(s.shared_copy)).max().unwrap_or(0);
        largest.max(all.min(COPIES_TOGETHER))
    }
}

/// The plan of a series, and where its steps come from.
pub(in crate::pipeline) struct SeriesPlan {
    pub(in crate::pipeline) plan: Plan,
    /// Of each step of the plan.
    pub(in crate::pipeline) sources: Vec<PlannedSource>,
    pub(in crate::pipeline) skipped: Vec<SkippedStep>,
    /// The last step that the archive has already.
    pub(in crate::pipeline) before: Option<StepPlan>,
    pub(in crate::pipeline) keyframes: u64,
    /// What is stored beside the plan.
    pub(in crate::pipeline) attachments: Attachments,
    /// The error that is wanted, in units of the field.
    pub(in crate::pipeline) bound: Option<f64>,
    /// The files of all steps, which must not change until all is made.
    pub(in crate::pipeline) watch: Watch,
}

impl SeriesPlan {
    /// Gives each step its base, and checks that times ascend.
    pub(super) fn connect(&mut self) -> Result<()> {
        self.plan.set_bases(self.before.as_ref(), self.keyframes);
        let all: Vec<&StepPlan> = self.before.iter().chain(&self.plan.steps).collect();
        for pair in all.windows(2) {
            let [a, b] = [pair[0], pair[1]].map(StepPlan::time_or_number);
            if a >= b || a.is_nan() || !b.is_finite() {
                return Err(Error::usage(format!(
                    "times must ascend: step {} is at {a}, step {} at {b} (give them with --times)",
                    pair[0].number, pair[1].number
                )));
            }
        }
        Ok(())
    }

    /// Whether errors tell the step.
    fn is_several(&self) -> bool {
        self.plan.steps.len() + self.skipped.len() > 1 || self.before.is_some()
    }

    /// Notes that a step is not made.
    pub(super) fn skip(&mut self, number: u64, source: &StepSource, reason: String) {
        let source = source.path.display().to_string();
        self.skipped.push(SkippedStep { number, source, reason });
        self.skipped.sort_by_key(|s| s.number);
    }

    /// Goes on without the steps that have failed.
    fn leave_out(&mut self, failed: Failed, keep_going: bool, layout: &Layout) -> Result<()> {
        let Failed { error, bad } = failed;
        if !keep_going || bad.is_empty() || bad.len() == self.plan.steps.len() {
            return Err(*error);
        }
        for (n, reason) in bad.into_iter().rev() {
            let (step, source) = (self.plan.steps.remove(n), self.sources.remove(n));
            self.skip(step.number, &source.source, reason);
            layout.at(step.number).remove_step()?;
        }
        self.connect()
    }
}

/// Whether an archive ends with these very steps: a run that was killed after it had added them is asked to continue.
pub(super) fn are_there(archive: &OpenArchive, steps: &[StepPlan]) -> bool {
    let mut there = archive.manifest.steps.iter().rev().zip(steps.iter().rev());
    steps.len() <= archive.manifest.steps.len()
        && there
            .all(|(a, b)| a.plan.source == b.source && a.plan.time == b.time && a.plan.missing == b.missing)
}

/// The field of the first step of a series. Files whose only field has another name need a choice.
pub(super) struct FieldOfSeries {
    step: u64,
    name: String,
}

/// The name that readers give to the field of a format without names.
const NAMELESS: &str = "data";

impl FieldOfSeries {
    pub(super) fn new(step: u64, name: &str) -> Self {
        Self { step, name: name.to_owned() }
    }

    /// Whether the field that a reader chose is the one of the series.
    ///
    /// # Errors
    /// [`Error::Usage`] if its name is another one and no `--field` asked for it.
    pub(super) fn check(&self, source: &StepSource, name: &str) -> Result<()> {
        let is_chosen = source.options.field.is_some();
        if is_chosen || name == self.name || [name, &self.name[..]].contains(&NAMELESS) {
            return Ok(());
        }
        Err(Error::usage(format!(
            "{}: its field is {name}, the field of step {} is {}; if both are meant, say so with --field PATTERN",
            source.path.display(),
            self.step,
            self.name
        )))
    }
}

/// Copies the coordinates that a grid has of its own into the archive; a mesh has its positions in the world by itself.
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

/// Whether an error is one of a step's data, and other steps may be better.
pub(super) fn is_of_data(error: &Error) -> bool {
    matches!(error, Error::BadInput(_) | Error::Io { .. } | Error::Usage(_)) && error.exit_code() != 4
}

/// Opens the data of steps.
pub(super) trait Fields {
    /// That of the `n`-th step of the plan.
    fn open<'a>(&'a self, series: &SeriesPlan, n: usize) -> Result<Box<dyn Field + 'a>>;

    /// The mesh whose own tetrahedra are kept, where they are.
    fn own(&self) -> Option<OwnMesh<'_>> {
        None
    }
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

/// What a series is made with.
pub(super) struct Means<'a> {
    pub(super) parts: &'a MeshParts,
    pub(super) fields: &'a dyn Fields,
    pub(super) shares: Shares,
    /// Steps made at a time, at most.
    pub(super) at_once: usize,
}

/// How the steps of a series are made.
pub(super) struct Making<'a> {
    pub(super) means: &'a Means<'a>,
    pub(super) layout: &'a Layout,
    /// Which segments, of all.
    pub(super) segments: Range<u64>,
    /// The archive that has the mesh, and to which the steps are added.
    pub(super) old: Option<&'a Manifest>,
    /// The try before, in a search: what did not change is taken over.
    pub(super) before: Option<&'a StepView>,
    /// Whether each step is measured against its source.
    pub(super) measure: bool,
    pub(super) run: &'a RunSettings,
    pub(super) progress: &'a dyn Progress,
}

/// What came of it.
#[derive(Default)]
pub(in crate::pipeline) struct Outcome {
    pub(in crate::pipeline) times: StageTimes,
    /// Chunks that were taken over from an earlier try.
    pub(in crate::pipeline) taken: u64,
    /// Wall time of measuring.
    pub(in crate::pipeline) measuring: Duration,
    /// Errors by the number of the step; not of steps that were there before.
    pub(in crate::pipeline) errors: BTreeMap<u64, StepErrors>,
    /// The coordinates of a grid that has its own, which are in the archive.
    pub(in crate::pipeline) coordinates: Option<CoordinateRecord>,
}

impl Making<'_> {
    /// Makes all segments that are not there yet.
    pub(super) fn make(&self, series: &mut SeriesPlan) -> Result<Outcome> {
        let (mut made, mut next) = (Outcome::default(), 0);
        made.coordinates = self.coordinates(series)?;
        let hash = series.plan.mesh_hash();
        let mut has_mesh = self.old.is_some() || sink::has_mesh(hash, self.layout, &self.segments);
        while next < series.plan.steps.len() {
            let is_there = |series: &SeriesPlan, n: usize| {
                let (step, hash) = (&series.plan.steps[n], series.plan.step_hash(n));
                has_mesh && sink::has_values(step, hash, self.layout, &self.segments)
            };
            if is_there(series, next) {
                next += 1;
                continue;
            }
            let mut end = next + 1;
            while end < series.plan.steps.len().min(next + self.means.at_once)
                && PlannedSource::fit_together(&series.sources[next..=end])
                && !is_there(series, end)
            {
                end += 1;
            }
            match self.pass(series, next..end, has_mesh, &mut made) {
                Ok(()) => (next, has_mesh) = (end, true),
                Err(failed) => {
                    series.leave_out(failed, self.run.keep_going, self.layout)?;
                    // Where it was the first that is left out, another one is that.
                    made.coordinates = self.coordinates(series)?;
                }
            }
        }
        Ok(made)
    }

    /// Copies the coordinates that a grid has of its own into the archive, with its first step; a mesh has its positions in the world
    /// by itself.
    fn coordinates(&self, series: &SeriesPlan) -> Result<Option<CoordinateRecord>> {
        match self.old {
            Some(old) => Ok(old.steps[0].coordinates),
            None => grid_coordinates(series, self.layout),
        }
    }

    /// Points of the chunks that are made.
    pub(super) fn points(&self) -> u64 {
        let (points, chunks) = (&self.means.parts.points, &self.means.parts.chunks);
        let all = self.segments.clone().flat_map(|s| self.layout.chunks_of(s));
        all.map(|c| points.count_in(&chunks.chunk(ChunkId(c)).core)).sum()
    }

    /// Makes the values of some steps, and the mesh where it is not there.
    fn pass(
        &self,
        series: &SeriesPlan,
        steps: Range<usize>,
        has_mesh: bool,
        made: &mut Outcome,
    ) -> std::result::Result<(), Failed> {
        let (plan, several) = (&series.plan, series.is_several());
        let mut fields = vec![];
        for n in steps.clone() {
            let number = plan.steps[n].number;
            let opened = self.means.fields.open(series, n);
            let field = opened.map_err(|e| if several { e.at_step(number) } else { e });
            fields.push(field.map_err(|error| {
                let bad = is_of_data(&error).then(|| (n, error.to_string()));
                Failed { bad: bad.into_iter().collect(), error: Box::new(error) }
            })?);
        }
        let steps_work: Vec<StepWork<'_>> = steps
            .clone()
            .zip(&fields)
            .map(|(n, field)| StepWork { plan: &plan.steps[n], hash: plan.step_hash(n), field: &**field })
            .collect();
        let archive =
            if has_mesh { self.archive(plan, steps.start..steps.start, made.coordinates)? } else { None };
        let archive = archive.map(|archive| archive.step_at(0));
        let stored = archive.as_ref().map(|archive| {
            let last = archive.manifest.steps.len() - 1;
            Stored { archive, base: plan.steps[steps.start].base.map(|_| last) }
        });
        let taken = self.before.map(|before| ReusedChunks::new(before, plan, self.means.parts, steps.end));
        let taken = taken.transpose()?.flatten();
        let (taken_chunks, chunks) =
            (taken.as_ref().map_or(0, ReusedChunks::count), self.means.parts.chunks.len());
        let stage = match stored {
            None if taken_chunks > 0 => format!("reduce {} of {chunks} chunks", chunks - taken_chunks),
            None => "reduce".to_owned(),
            Some(_) => {
                let [first, last] = [steps.start, steps.end - 1].map(|n| plan.steps[n].number);
                format!("steps {first} to {last}")
            }
        };
        self.progress.begin(&stage, self.points(), "points");
        let Means { parts, fields: source, shares, .. } = self.means;
        let recipe = Recipe {
            points: &parts.points,
            bricks: plan.mesh.bricks(),
            order: parts.order,
            halo: parts.halo,
            bcc: parts.bcc,
            own: source.own(),
        };
        let (rooms, bad) = (Workspaces::default(), Mutex::default());
        let first = self.old.map_or(plan.first(), |old| &old.steps[0].plan);
        let file = (self.layout.at(first.number).coordinates(), first.hash(plan.mesh_hash()));
        let coordinates = made.coordinates.map(|_| file);
        let meter = Meter::new(&plan.mesh, parts.points.len(), &first.source, coordinates);
        // All steps of a run are measured, or none.
        let samples: Option<Vec<Samples<'_>>> =
            fields.iter().map(|field| Samples::of(&field.originals())).collect();
        let samples = samples.filter(|_| plan.steps[steps.start].measured);
        let sample_errors = samples.map(|samples| (SampleErrors::new(&plan.mesh.lattice), samples));
        let done = workers::make_segments(&Work {
            plan: &plan.mesh,
            mesh_hash: plan.mesh_hash(),
            steps: &steps_work,
            stored,
            taken: taken.as_ref().map(|taken| (taken, steps.clone())),
            meter: &meter,
            sample_errors,
            bad_steps: &bad,
            several,
            recipe: &recipe,
            chunks: &parts.chunks,
            layout: self.layout,
            segments: self.segments.clone(),
            pool: &pool(shares.workers)?,
            shares: *shares,
            rooms: &rooms,
            watch: &series.watch,
            cancel: &self.run.resources.cancel,
            progress: self.progress,
        });
        let bad = bad.into_inner().unwrap_or_else(PoisonError::into_inner);
        let bad = bad.into_iter().map(|(n, reason)| (steps.start + n, reason)).collect();
        if !has_mesh {
            made.taken = taken_chunks;
        }
        made.times.add(&done.map_err(|error| Failed { error: Box::new(error), bad })?);
        if self.measure && !plan.steps[steps.start].measured {
            self.measure(plan, steps, &fields, made)?;
        }
        Ok(())
    }

    /// Measures steps of a mesh that were just made, whose data are still open. Those of a volume were, chunk by chunk.
    fn measure(
        &self,
        plan: &Plan,
        steps: Range<usize>,
        fields: &[Box<dyn Field + '_>],
        made: &mut Outcome,
    ) -> Result<()> {
        let start = Instant::now();
        let settings = MeasureSettings::of_run(self.run, self.means.shares.workers);
        let archive = self.archive(plan, steps.clone(), made.coordinates)?;
        let archive = archive.expect("there are steps before the end");
        let first = archive.manifest.steps.len() - steps.len();
        let originals: Vec<_> = fields.iter().map(|field| field.originals()).collect();
        let errors = field_errors(&archive, first, &originals, &settings, self.progress)?;
        made.errors.extend(steps.map(|n| plan.steps[n].number).zip(errors));
        made.measuring += start.elapsed();
        Ok(())
    }

    /// The segments that are made as an archive: the mesh, some steps, and those before them back to a keyframe. None when there is
    /// no such step.
    fn archive(
        &self,
        plan: &Plan,
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
            None => (self.records(plan.mesh_hash(), SegmentKind::Mesh, |n| self.layout.mesh(n))?, vec![]),
        };
        for n in first..wanted.end {
            let layout = self.layout.at(plan.steps[n].number);
            steps.push(Step {
                plan: plan.steps[n].clone(),
                value_range: None,
                void_points: 0,
                values: self.records(plan.step_hash(n), SegmentKind::Values, |n| layout.values(n))?,
                index: None,
                spectrum: None,
                coordinates: None,
                error: None,
                level_errors: vec![],
            });
        }
        if self.old.is_none() {
            // Which are looked for with the first step.
            steps[0].coordinates = coordinates;
        }
        let counts = Counts { chunks: self.means.parts.chunks.len(), ..Counts::default() };
        let manifest = Manifest::new(plan.mesh.clone(), counts, mesh, steps);
        OpenArchive::of(self.layout.root(), manifest).map(Some)
    }

    /// Records of the segments that are made; of others their place alone: they are not looked at.
    fn records(
        &self,
        hash: PlanHash,
        kind: SegmentKind,
        path: impl Fn(u64) -> PathBuf,
    ) -> Result<Vec<SegmentRecord>> {
        let of = |n: u64| {
            if self.segments.contains(&n) {
                return Ok(ChunkSegment::open(path(n), kind, Some(hash))?.record());
            }
            let chunks = self.layout.chunks_of(n);
            let (first_chunk, chunks) = (chunks.start, chunks.end - chunks.start);
            Ok(SegmentRecord { first_chunk, chunks, info: SegmentInfo::default() })
        };
        (0..self.layout.segment_count()).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::OpenOptions;

    #[test]
    fn small_copies_are_on_the_disk_together_and_large_ones_alone() {
        let step = StepSource::new(std::path::Path::new("a"), &OpenOptions::default());
        let source = |copied: u64| PlannedSource { copied, ..PlannedSource::in_place(step.clone()) };
        let all: Vec<PlannedSource> = [0, 200 << 20, 56 << 20, 1, 300 << 20].map(source).into();
        assert!(PlannedSource::fit_together(&all[..3]) && !PlannedSource::fit_together(&all[..4]));
        assert!(PlannedSource::fit_together(&all[4..]) && !PlannedSource::fit_together(&all[3..]));
        assert_eq!(PlannedSource::copied_at_a_time(&all), 300 << 20);
        assert_eq!(PlannedSource::copied_at_a_time(&all[..4]), 256 << 20);
        assert_eq!(PlannedSource::copied_at_a_time(&all[..2]), 200 << 20);
    }
}
