//! From a volume to an archive: plan, work, commit.
//!
//! The archive's folder is filled segment by segment; the manifest comes last. A folder without a manifest is no
//! archive: it is work that the same command continues. A folder with one is never touched unless asked to.

use super::chunk::Recipe;
use super::field::{Field, NanPolicy};
use super::grid_field::GridField;
use super::layout::Layout;
use super::measure::{MeasureSettings, Originals, field_error, reopened_error};
use super::need::{self, Estimate, Need, Question, Shares};
use super::open::OpenArchive;
use super::placed::write_coordinates;
use super::plan::{MeshParts, Plan, ReduceSettings, parts};
use super::reduce_mesh;
use super::scan::value_range;
use super::shard::Shard;
use super::spectrum::{Meter, stored_part};
use super::work::{self, StageTimes, Work};
use crate::archive::chunked::ChunkSegment;
use crate::archive::coordinates::CellCount;
use crate::archive::explicit::write_explicit;
use crate::archive::manifest::{CoordinateRecord, Counts, MANIFEST_NAME, Manifest, SegmentRecord, Step};
use crate::archive::segment::{SegmentInfo, SegmentKind};
use crate::archive::summary::{BlockRange, MeshSummary, ValueSummary};
use crate::archive::values::Quantiser;
use crate::archive::{Malformed, TEMPORARY_MARK, publish};
use crate::domain::store::MeshCensus;
use crate::error::{Error, Result};
use crate::exec::{CancelToken, Progress, available_threads, pool};
use crate::formats::{self, Input, OpenOptions};
use crate::geom::Lattice;
use crate::grid::{ChunkId, IndexBox};
use crate::index::{BuildSettings, Entry, IndexBuilder};
use crate::measure::FieldError;
use crate::spectrum::{Design, Limits, SpectrumBuilder};
use crate::volume::bricked::BrickedVolume;
use crate::volume::{SlabStream, VolumeInfo, VolumeReader, VolumeSource};
use serde::Serialize;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// What decides how a run uses the machine, and not what it makes.
#[derive(Clone, Debug)]
pub struct RunSettings {
    /// Threads; 0 means as many as the process may use.
    pub threads: usize,
    /// Bytes for everything that grows; see [`Estimate`] for what it must be at least.
    pub memory: u64,
    /// Folder for the uncompressed copy of a compressed input; the system's temporary folder if not given.
    pub scratch: Option<PathBuf>,
    /// Whether an archive that is already there is replaced.
    pub replace: bool,
    /// Stops the run at the next chunk.
    pub cancel: CancelToken,
}

impl Default for RunSettings {
    fn default() -> Self {
        Self {
            threads: 0,
            memory: crate::exec::usable_memory() / 2,
            scratch: None,
            replace: false,
            cancel: CancelToken::new(),
        }
    }
}

/// What a reduction made.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ReduceReport {
    /// Samples of the volume; vertices of a mesh.
    pub samples: u64,
    /// Of a mesh: what was found in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mesh: Option<MeshCensus>,
    /// Points of the archive.
    pub points: u64,
    /// Of these, points without a value.
    pub void_points: u64,
    /// Tetrahedra.
    pub tetrahedra: u64,
    /// Chunks.
    pub chunks: u64,
    /// Tetrahedron blocks.
    pub blocks: u64,
    /// How often a chunk's halo had to be widened.
    pub halo_retries: u64,
    /// Of a rectilinear or curvilinear grid: its bad cells.
    pub grid_cells: Option<CellCount>,
    /// Least and largest value.
    pub range: Option<[f32; 2]>,
    /// How values were rounded, if they were.
    pub quantiser: Option<Quantiser>,
    /// How far the reduced field is from the samples, if that was measured.
    pub error: Option<FieldError>,
    /// Bytes of all files of the archive.
    pub archive_bytes: u64,
    /// Seconds of each stage: the wall time of those that run alone; the sum over threads of those that run side by side.
    pub seconds: Vec<(String, f64)>,
}

/// Copies a volume into bricks at `out`, using about `memory` bytes.
///
/// # Errors
/// Those of reading the volume and of writing the file; nothing is left under the name then.
pub fn brick(
    source: VolumeSource,
    out: &Path,
    memory: u64,
    cancel: &CancelToken,
    progress: &dyn Progress,
) -> Result<()> {
    let dims = source.info().dims;
    progress.begin("brick", dims.iter().product(), "samples");
    let mut before = 0;
    let memory = usize::try_from(memory).unwrap_or(usize::MAX);
    let stream = Box::new(Stoppable { stream: source.into_stream(), cancel: cancel.clone() });
    BrickedVolume::build(stream, out, memory, &mut |done| {
        progress.advance(done - before);
        before = done;
    })
}

/// A stream that ends with [`Error::Cancelled`] when somebody asks to stop.
struct Stoppable {
    stream: Box<dyn SlabStream>,
    cancel: CancelToken,
}

impl SlabStream for Stoppable {
    fn info(&self) -> &VolumeInfo {
        self.stream.info()
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        self.cancel.check()?;
        self.stream.next_slab(out)
    }
}

/// Reduces the volume `input` to the archive `out`.
///
/// # Errors
/// [`Error::Usage`] when there is an archive already, [`Error::BadInput`] for a volume that cannot be used,
/// [`Error::Budget`] when the memory does not suffice for one chunk, [`Error::Cancelled`] when stopped: the same call continues.
pub fn reduce(
    input: &Path,
    options: &OpenOptions,
    settings: &ReduceSettings,
    out: &Path,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<ReduceReport> {
    let started = Instant::now();
    refuse_overwriting(out, run)?;
    let job = Job { input, options, settings, out, run, progress, started, part: Part::Whole };
    make(&job)
}

/// Opens the input of a job and does its part.
pub(super) fn make(job: &Job<'_>) -> Result<ReduceReport> {
    match formats::open_input(job.input, job.options)? {
        Input::Volume(source) => reduce_volume(source, job),
        Input::Mesh(mesh) => reduce_mesh::reduce_mesh(&mesh, job),
    }
}

/// What a reduction is told.
pub(super) struct Job<'a> {
    pub(super) input: &'a Path,
    pub(super) options: &'a OpenOptions,
    pub(super) settings: &'a ReduceSettings,
    pub(super) out: &'a Path,
    pub(super) run: &'a RunSettings,
    pub(super) progress: &'a dyn Progress,
    pub(super) started: Instant,
    pub(super) part: Part<'a>,
}

/// What of a reduction a job does.
#[derive(Clone, Copy)]
pub(super) enum Part<'a> {
    /// All of it: plan, segments, manifest.
    Whole,
    /// The segments of a shard, of the plan that was made before.
    Shard(&'a Plan, Shard),
    /// The manifest, of segments that were made before.
    Commit,
}

impl Part<'_> {
    /// How values are rounded, where that was decided before.
    pub(super) fn quantiser(&self) -> Option<Option<Quantiser>> {
        match self {
            Self::Whole | Self::Commit => None,
            Self::Shard(planned, _) => Some(planned.step.quantiser),
        }
    }

    /// Refuses a source that is not the one that was planned for.
    pub(super) fn expect_planned(&self, plan: &Plan, input: &Path) -> Result<()> {
        match self {
            Self::Shard(planned, _) if **planned != *plan => {
                let text = |p: &Plan| {
                    let source = &p.step.source;
                    format!(
                        "{} {} {:?}, plan {}",
                        source.format,
                        source.fingerprint,
                        source.dims,
                        p.step_hash()
                    )
                };
                Err(Error::bad_input(input, "fingerprint and header", text(planned), text(plan)).with_help(
                    "the file is not what it was when the plan was made: restore it, or plan again with --force",
                ))
            }
            _ => Ok(()),
        }
    }

    fn segments(&self, layout: &Layout) -> Range<u64> {
        match self {
            Self::Whole | Self::Commit => 0..layout.segment_count(),
            Self::Shard(_, shard) => shard.range(layout.segment_count()),
        }
    }
}

/// Makes the plan of a job, and of the mesh what follows from it; tells what the job needs. Makes no segment.
pub(super) fn make_plan(job: &Job<'_>) -> Result<(Plan, MeshParts, Estimate)> {
    let source = match formats::open_input(job.input, job.options)? {
        Input::Volume(source) => source,
        Input::Mesh(mesh) => return reduce_mesh::plan_mesh(&mesh, job),
    };
    let mut plan = Plan::new(source.info(), job.settings)?;
    let mesh = parts(&plan.mesh, None)?;
    let estimate = estimate_of(&source, &plan, &Need::of(&mesh), job.out, job.run)?;
    if let Some(bits) = job.settings.value_bits {
        estimate.check()?;
        let (reader, _scratch) = random_access(source, job.run, job.progress)?;
        plan.step.quantiser = Some(quantiser(&*reader, bits, job.settings, &job.run.cancel)?);
    }
    Ok((plan, mesh, estimate))
}

fn reduce_volume(source: VolumeSource, job: &Job<'_>) -> Result<ReduceReport> {
    let mut plan = Plan::new(source.info(), job.settings)?;
    plan.step.quantiser = job.part.quantiser().flatten();
    job.part.expect_planned(&plan, job.input)?;
    let mesh = parts(&plan.mesh, None)?;
    let need = Need::of(&mesh);
    estimate_of(&source, &plan, &need, job.out, job.run)?.check()?;
    let shares = need.shares(job.run.memory, threads(job.run))?;
    let mut seconds = vec![];
    let copying = Instant::now();
    // The copy is removed when `scratch` is dropped, whatever happens.
    let (reader, _scratch) = random_access(source, job.run, job.progress)?;
    if _scratch.is_some() {
        seconds.push(("brick".to_owned(), copying.elapsed().as_secs_f64()));
    }
    if let (Some(bits), None) = (job.settings.value_bits, job.part.quantiser()) {
        let reading = Instant::now();
        plan.step.quantiser = Some(quantiser(&*reader, bits, job.settings, &job.run.cancel)?);
        seconds.push(("range".to_owned(), reading.elapsed().as_secs_f64()));
    }
    let field = GridField {
        reader: &*reader,
        bricks: plan.mesh.bricks(),
        interpolation: plan.step.interpolation,
        nan: job.settings.nan,
        missing: job.settings.missing,
        released: AtomicU64::new(0),
    };
    let samples = plan.step.source.dims.iter().product();
    produce(job, &plan, &mesh, &field, shares, ReduceReport { samples, seconds, ..ReduceReport::default() })
}

/// Makes the archive of a plan, or the job's part of it: its segments, then the manifest. Completes the report.
pub(super) fn produce(
    job: &Job<'_>,
    plan: &Plan,
    mesh: &MeshParts,
    field: &dyn Field,
    shares: Shares,
    mut report: ReduceReport,
) -> Result<ReduceReport> {
    let layout = Layout::new(job.out, mesh.chunks.len(), plan.step.number);
    prepare_folder(&layout, job.run)?;
    if let Some(points) = mesh.points.explicit() {
        write_explicit(job.out, plan.mesh_hash(), points)?;
    }
    let coordinates = grid_coordinates(job, plan, &layout)?;
    let meter = Meter::of_plan(plan, mesh.points.len(), &layout, coordinates.is_some());
    let recipe = Recipe { points: &mesh.points, bricks: plan.mesh.bricks(), order: mesh.order };
    let segments = job.part.segments(&layout);
    let chunks = segments.clone().flat_map(|s| layout.chunks_of(s));
    let points = chunks.map(|c| mesh.points.count_in(&mesh.chunks.chunk(ChunkId(c)).core)).sum();
    job.progress.begin("reduce", points, "points");
    let times = work::make_segments(&Work {
        plan,
        recipe: &recipe,
        chunks: &mesh.chunks,
        layout: &layout,
        segments,
        field,
        meter: &meter,
        pool: &pool(shares.workers)?,
        shares,
        rooms: &work::Rooms::default(),
        cancel: &job.run.cancel,
        progress: job.progress,
    })?;
    push_times(&mut report.seconds, &times);
    match job.part {
        Part::Shard(..) => Ok(ReduceReport { points, quantiser: plan.step.quantiser, ..report }),
        Part::Whole | Part::Commit => {
            let made = Made { plan, mesh, layout: &layout, coordinates, originals: Some(&field.originals()) };
            publish_archive(job, &made, shares.workers, report)
        }
    }
}

/// Copies the coordinates that a grid has of its own into the archive; a mesh has its positions in the world by itself.
pub(super) fn grid_coordinates(
    job: &Job<'_>,
    plan: &Plan,
    layout: &Layout,
) -> Result<Option<CoordinateRecord>> {
    match plan.step.source.mesh {
        Some(_) => Ok(None),
        None => write_coordinates(job.input, job.options, plan, layout),
    }
}

/// Segments that are all there.
pub(super) struct Made<'a> {
    pub(super) plan: &'a Plan,
    pub(super) mesh: &'a MeshParts,
    pub(super) layout: &'a Layout,
    /// What [`grid_coordinates`] has written.
    pub(super) coordinates: Option<CoordinateRecord>,
    /// The samples that they were made from, where these are at hand; else the input is opened again.
    pub(super) originals: Option<&'a Originals<'a>>,
}

/// Makes an archive of segments that are all there: index, spectrum, error, manifest. Completes the report.
pub(super) fn publish_archive(
    job: &Job<'_>,
    made: &Made<'_>,
    workers: usize,
    mut report: ReduceReport,
) -> Result<ReduceReport> {
    let Made { plan, mesh, layout, coordinates, originals } = *made;
    let committing = Instant::now();
    let limits = Meter::of_plan(plan, mesh.points.len(), layout, coordinates.is_some()).limits();
    let (mut archive, halo_retries) = commit(plan, mesh, layout, coordinates, limits, job.run)?;
    report.seconds.push(("commit".into(), committing.elapsed().as_secs_f64()));
    if job.settings.measure {
        let measuring = Instant::now();
        let settings = MeasureSettings::of_run(job.run, workers);
        let error = match originals {
            Some(originals) => field_error(&archive, originals, &settings, job.progress)?,
            None => reopened_error(&archive, job.input, job.options, &settings, job.progress)?,
        };
        archive.manifest.steps[0].error = Some(error);
        report.seconds.push(("measure".into(), measuring.elapsed().as_secs_f64()));
    }
    archive.manifest.write(layout.root())?;
    let manifest = archive.manifest;
    if let Part::Whole = job.part {
        // What earlier runs that were killed have left. Where others may be at work, gc removes it.
        for file in [layout.mesh(0), layout.index(), layout.root().join(MANIFEST_NAME)] {
            publish::sweep(file.parent().expect("a file of an archive lies in a folder"));
        }
    }
    report.seconds.push(("total".into(), job.started.elapsed().as_secs_f64()));
    let (counts, step) = (&manifest.counts, &manifest.steps[0]);
    Ok(ReduceReport {
        points: counts.points,
        void_points: step.void_points,
        tetrahedra: counts.tetrahedra,
        chunks: counts.chunks,
        blocks: counts.blocks,
        halo_retries,
        grid_cells: step.coordinates.map(|c| c.cells),
        range: step.value_range,
        quantiser: plan.step.quantiser,
        error: step.error.clone(),
        archive_bytes: folder_bytes(job.out)?,
        ..report
    })
}

/// Steps of the source's range, which is read for that: the same everywhere, so that what chunks share stays equal.
fn quantiser(
    reader: &dyn VolumeReader,
    bits: u8,
    settings: &ReduceSettings,
    cancel: &CancelToken,
) -> Result<Quantiser> {
    let missing = settings.missing.or(reader.info().missing);
    let found = value_range(reader, missing, cancel)?;
    let stand_in = match settings.nan {
        NanPolicy::Value(v) => Some([v, v]),
        NanPolicy::Error | NanPolicy::Mask => None,
    };
    let range = [found, stand_in].into_iter().flatten().reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    Ok(Quantiser::new(bits, range.unwrap_or_default()))
}

/// Tells what a reduction would need, without beginning it.
///
/// # Errors
/// As [`reduce`], but a budget that does not suffice is only told of: see [`Estimate::check`].
pub fn estimate(
    input: &Path,
    options: &OpenOptions,
    settings: &ReduceSettings,
    out: &Path,
    run: &RunSettings,
) -> Result<Estimate> {
    refuse_overwriting(out, run)?;
    let source = match formats::open_input(input, options)? {
        Input::Volume(source) => source,
        Input::Mesh(mesh) => return reduce_mesh::estimate_mesh(&mesh, settings, out, run),
    };
    let plan = Plan::new(source.info(), settings)?;
    estimate_of(&source, &plan, &Need::of(&parts(&plan.mesh, None)?), out, run)
}

fn estimate_of(
    source: &VolumeSource,
    plan: &Plan,
    need: &Need,
    out: &Path,
    run: &RunSettings,
) -> Result<Estimate> {
    let (copied, copying) = match source {
        VolumeSource::Random(_) => (0, 0),
        VolumeSource::Stream(stream) => {
            let info = stream.info();
            // Bricks at the border are padded, and each has a checksum.
            let samples = info.dims.iter().map(|&d| d as f64).product::<f64>();
            let bytes = (samples * info.field.scalar.bytes() as f64 * 1.1) as u64 + (1 << 20);
            (bytes, copying_bytes(&**stream) + COPY_BUFFER)
        }
    };
    let scratch = scratch_folder(run);
    Ok(Estimate::new(&Question {
        plan,
        need,
        memory: run.memory,
        threads: threads(run),
        out,
        there: if out.is_dir() { folder_bytes(out)? } else { 0 },
        scratch: (&scratch, copied),
        copying,
    }))
}

/// The least that slices are collected in while a stream is copied into bricks.
const COPY_BUFFER: u64 = 8 << 20;

/// Memory that copying a stream into bricks takes, beside the slices that are collected: the decoder, a checksum a brick.
fn copying_bytes(stream: &dyn SlabStream) -> u64 {
    let bricks = stream.info().dims.iter().map(|d| d.div_ceil(32)).fold(1, u64::saturating_mul);
    need::BASE.saturating_add(stream.working_bytes()).saturating_add(bricks.saturating_mul(8))
}

pub(super) fn threads(run: &RunSettings) -> usize {
    if run.threads == 0 { available_threads() } else { run.threads }
}

pub(super) fn scratch_folder(run: &RunSettings) -> PathBuf {
    run.scratch.clone().unwrap_or_else(std::env::temp_dir)
}

fn push_times(seconds: &mut Vec<(String, f64)>, times: &StageTimes) {
    let rows =
        [("mesh", times.mesh), ("sample", times.sample), ("encode", times.encode), ("write", times.write)];
    seconds.extend(rows.map(|(name, time)| (name.to_owned(), time.as_secs_f64())));
}

/// Folders and files that are not ours are never touched; an archive only when asked to.
pub(super) fn refuse_overwriting(out: &Path, run: &RunSettings) -> Result<()> {
    let shown = out.display();
    if out.extension().is_none_or(|e| e != "isospan") {
        return Err(Error::usage(format!("{shown}: an archive's name ends in .isospan")));
    }
    match fs::metadata(out) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(Error::io("look at", out, e)),
        Ok(m) if !m.is_dir() => {
            Err(Error::usage(format!("{shown} exists and is not an archive; choose another name")))
        }
        Ok(_) if out.join(MANIFEST_NAME).exists() && !run.replace => {
            Err(Error::usage(format!("{shown} exists; choose another name, or --force to replace it")))
        }
        Ok(_) if !is_ours(out)? => {
            Err(Error::usage(format!("{shown} exists and holds other files; choose another name")))
        }
        Ok(_) => Ok(()),
    }
}

fn is_ours(out: &Path) -> Result<bool> {
    let ours = ["mesh", "steps", MANIFEST_NAME];
    for entry in fs::read_dir(out).map_err(|e| Error::io("list", out, e))? {
        let name = entry.map_err(|e| Error::io("list", out, e))?.file_name();
        let name = name.to_string_lossy();
        if !ours.contains(&&*name) && !name.contains(TEMPORARY_MARK) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Without its manifest the old archive is no archive any more; then segments of this plan are kept and others replaced.
pub(super) fn prepare_folder(layout: &Layout, run: &RunSettings) -> Result<()> {
    let old = layout.root().join(MANIFEST_NAME);
    if old.exists() && run.replace {
        fs::remove_file(&old).map_err(|e| Error::io("remove", &old, e))?;
        for folder in ["mesh", "steps"].map(|f| layout.root().join(f)).iter().filter(|f| f.exists()) {
            fs::remove_dir_all(folder).map_err(|e| Error::io("remove", folder, e))?;
        }
    }
    for file in [layout.mesh(0), layout.index()] {
        let folder = file.parent().expect("a segment lies in a folder of the archive");
        fs::create_dir_all(folder).map_err(|e| Error::io("create the folder", folder, e))?;
    }
    Ok(())
}

/// A stream is copied into bricks first; the copy is removed when the second value is dropped.
pub(super) fn random_access(
    source: VolumeSource,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<(Box<dyn VolumeReader>, Option<Scratch>)> {
    let room = match source {
        VolumeSource::Random(reader) => return Ok((reader, None)),
        VolumeSource::Stream(ref stream) => run.memory.saturating_sub(copying_bytes(&**stream)),
    };
    let folder = scratch_folder(run);
    // What runs that were killed while they copied have left.
    publish::sweep(&folder);
    let scratch = Scratch::new(&folder);
    brick(source, &scratch.0, room / 2, &run.cancel, progress)?;
    let reader = BrickedVolume::open(&scratch.0)?;
    // An open file without a name is gone with the process, however that ends.
    #[cfg(unix)]
    scratch.remove();
    Ok((Box::new(reader), Some(scratch)))
}

/// A file that is removed in the end.
pub(super) struct Scratch(PathBuf);

impl Scratch {
    fn new(folder: &Path) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Self(folder.join(format!(
            "isospan-scratch-{}-{}-{number}.bricks",
            publish::host(),
            std::process::id()
        )))
    }

    fn remove(&self) {
        // Not there: removed before, or never made.
        let _ = fs::remove_file(&self.0);
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        self.remove();
    }
}

/// Reads the summaries of all chunks, builds the index, puts the spectrum together: the archive, but for its manifest, which is not
/// published. Also tells how often halos were widened.
fn commit(
    plan: &Plan,
    parts: &MeshParts,
    layout: &Layout,
    coordinates: Option<CoordinateRecord>,
    limits: Limits,
    run: &RunSettings,
) -> Result<(OpenArchive, u64)> {
    let mut counts = Counts { chunks: parts.chunks.len(), ..Counts::default() };
    let (mut mesh_segments, mut value_segments) = (vec![], vec![]);
    let (mut void_points, mut halo_retries, mut volume6) = (0, 0, 0i128);
    // Of all points, and of the tetrahedra that are not void.
    let mut value_range = [f32::INFINITY, f32::NEG_INFINITY];
    let mut range = value_range;
    let mut index = IndexBuilder::new(&BuildSettings {
        memory: run.memory.saturating_sub(need::BASE),
        scratch: Some(scratch_folder(run)),
    });
    for number in 0..layout.segment_count() {
        let mesh = ChunkSegment::open(layout.mesh(number), SegmentKind::Mesh, Some(plan.mesh_hash()))?;
        let values = ChunkSegment::open(layout.values(number), SegmentKind::Values, Some(plan.step_hash()))?;
        for chunk in layout.chunks_of(number) {
            let (mesh, values) =
                (mesh_summary(&mesh, ChunkId(chunk))?, value_summary(&values, ChunkId(chunk))?);
            counts.points += u64::from(mesh.core);
            counts.tetrahedra += mesh.tets;
            counts.blocks += u64::from(mesh.tet_blocks);
            halo_retries += u64::from(mesh.retries);
            volume6 += mesh.volume6 + mesh.outside6;
            void_points += u64::from(values.void);
            value_range = [value_range[0].min(values.min), value_range[1].max(values.max)];
            for entry in index_entries(chunk, &values.ranges) {
                range = [range[0].min(entry.min), range[1].max(entry.max)];
                index.push(entry)?;
            }
        }
        for (records, file) in [(&mut mesh_segments, &mesh), (&mut value_segments, &values)] {
            let chunks = file.chunks();
            let (first_chunk, chunks) = (chunks.start, chunks.end - chunks.start);
            records.push(SegmentRecord { first_chunk, chunks, info: file.segment().info() });
        }
    }
    check_volume(plan, volume6, layout.root())?;
    let spectrum =
        (range[0] <= range[1]).then(|| sum_spectrum(plan, layout, Design::new(range, limits), limits));
    let step = Step {
        plan: plan.step.clone(),
        value_range: (value_range[0] <= value_range[1]).then_some(value_range),
        void_points,
        values: value_segments,
        index: index.finish(layout.index(), plan.step_hash())?,
        spectrum: spectrum.transpose()?,
        coordinates,
        error: None,
    };
    let manifest = Manifest::new(plan.mesh.clone(), counts, mesh_segments, vec![step]);
    Ok((OpenArchive::of(layout.root(), manifest)?, halo_retries))
}

/// Adds up what all chunks have measured, and writes it.
fn sum_spectrum(plan: &Plan, layout: &Layout, design: Design, limits: Limits) -> Result<SegmentInfo> {
    let mut builder = SpectrumBuilder::new(design);
    for number in 0..layout.segment_count() {
        let values = ChunkSegment::open(layout.values(number), SegmentKind::Values, Some(plan.step_hash()))?;
        for chunk in layout.chunks_of(number) {
            builder.add(&stored_part(&values, ChunkId(chunk), limits)?);
        }
    }
    builder.finish(layout.spectrum(), plan.step_hash())
}

/// The entries of the index that a chunk's blocks have: one each, none for blocks of void tetrahedra alone.
pub(super) fn index_entries(chunk: u64, ranges: &[BlockRange]) -> impl Iterator<Item = Entry> {
    let entry = move |(block, r): (usize, &BlockRange)| {
        (r.tets > 0).then_some(Entry { min: r.min, max: r.max, chunk, block: block as u32, tets: r.tets })
    };
    ranges.iter().enumerate().filter_map(entry)
}

/// The last block of a chunk in a mesh segment.
pub(super) fn mesh_summary(segment: &ChunkSegment, chunk: ChunkId) -> Result<MeshSummary> {
    last_block(segment, chunk, MeshSummary::decode)
}

/// The last block of a chunk in a value segment.
pub(super) fn value_summary(segment: &ChunkSegment, chunk: ChunkId) -> Result<ValueSummary> {
    last_block(segment, chunk, ValueSummary::decode)
}

fn last_block<T>(
    segment: &ChunkSegment,
    chunk: ChunkId,
    decode: fn(&[u8]) -> std::result::Result<T, Malformed>,
) -> Result<T> {
    let last = segment.block_count(chunk).checked_sub(1).ok_or_else(|| {
        Error::bad_input(
            segment.segment().path(),
            format!("chunk {}", chunk.0),
            "a summary block",
            "no blocks",
        )
    })?;
    let mut bytes = vec![];
    segment.block(chunk, last, &mut bytes)?;
    decode(&bytes).map_err(|m| segment.blame(chunk, last, m))
}

/// The owned tetrahedra of all chunks tile the box: their volumes add up to its volume, exactly.
fn check_volume(plan: &Plan, volume6: i128, out: &Path) -> Result<()> {
    let whole = domain_volume6(&plan.mesh.lattice);
    if volume6 == whole {
        return Ok(());
    }
    let text = format!("internal error: the tetrahedra fill {volume6} of the domain's {whole} sixths");
    Err(Error::io("commit", out, std::io::Error::other(text)))
}

/// Six times the volume of the domain, in lattice steps.
pub(super) fn domain_volume6(lattice: &Lattice) -> i128 {
    6 * lattice.max().iter().map(|&m| i128::from(m)).product::<i128>()
}

/// Bytes of all files below a folder.
pub(super) fn folder_bytes(folder: &Path) -> Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder).map_err(|e| Error::io("list", folder, e))? {
        let entry = entry.map_err(|e| Error::io("list", folder, e))?;
        let meta = entry.metadata().map_err(|e| Error::io("look at", entry.path(), e))?;
        bytes += if meta.is_dir() { folder_bytes(&entry.path())? } else { meta.len() };
    }
    Ok(bytes)
}
