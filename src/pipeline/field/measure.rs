//! `measure`: compares the reduced field with every sample of its source.
//!
//! Chunk after chunk is decoded and measured as `reduce` does it while it makes one
//! ([`errors`](crate::pipeline::chunk::errors)). All sums are integers ([`crate::measure`]), so the
//! results do not depend on threads or chunks, and are those that `reduce` has stored. The vertices
//! of a mesh are located as `probe` locates points, in batches.
//!
//! Cost: decoding the archive and reading the source once, and the scan conversion. Memory: some
//! chunks; with a map of bricks, a record for each brick of a chunk, sorted on disk where memory
//! does not hold them.

use super::at_vertices::AtVertices;
use super::error_map::{Map, map_bytes};
use super::levels::errors_of;
use super::own_errors::own_errors;
use super::source_samples::{Also, SourceSamples, SurfaceErrors};
use super::vertex_errors::{StepErrors, reported_errors};
use crate::archive::manifest::Source;
use crate::domain::column::Column;
use crate::domain::merge::Firsts;
use crate::domain::settings::{BadValue, StoreSettings};
use crate::domain::store::CellStore;
use crate::measure::{BrickErrors, ErrorSums, FieldError, Tally};
use crate::pipeline::chunk::{
    ChunkTets, Originals, SampleErrors, Samples, StepLanes, errors, field_error_of, field_error_within,
};
use crate::pipeline::inputs::{ChunkCache, Reading, boxes_of_chunks, random_access};
use crate::pipeline::plan::{Attachments, Halo, Inputs, MOST_STEPS_AT_ONCE, estimate, fingerprint};
use crate::pipeline::read::{
    Blocks, DecodedChunk, LevelChoice, OpenArchive, StepChoice, StepView, Visit, samples_of_level,
};
use crate::pipeline::settings::RunSettings;
use isospan_io::cells::CellMesh;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Resources};
use isospan_io::formats::{Input, OpenOptions, StepSource, without_frame};
use isospan_io::volume::{VolumeReader, VolumeSource};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// How a field is measured.
#[derive(Clone, Debug, Default)]
pub(in crate::pipeline) struct MeasureSettings {
    /// The level of a pyramid; the finest if not given. Samples beyond its last node are outside.
    pub(in crate::pipeline) level: Option<LevelChoice>,
    /// The number of the step in a series; the first one if not given.
    pub(in crate::pipeline) step: Option<u64>,
    /// A VTI file for the errors of each brick.
    pub(in crate::pipeline) map: Option<PathBuf>,
    /// Threads, memory, scratch folder, and what stops it.
    pub(in crate::pipeline) resources: Resources,
}

impl MeasureSettings {
    /// The settings of a reduction's run, with as many threads as chunks were at work, because the
    /// memory suffices for these.
    pub(in crate::pipeline) fn of_run(run: &RunSettings, workers: usize) -> Self {
        let resources = run.resources.clone().with_threads(workers);
        Self { resources, ..Self::default() }
    }

    fn scratch(&self) -> PathBuf {
        self.resources.scratch_folder()
    }
}

/// What was measured.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct MeasureReport {
    /// The errors.
    #[serde(flatten)]
    pub error: FieldError,
    /// Least and largest value of the archive.
    pub range: Option<[f64; 2]>,
    /// Whether the input has the fingerprint of the one that the archive was made from.
    pub same_source: bool,
    /// The level of a pyramid that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub level: Option<usize>,
    /// Bricks of the map along each axis, if one was written.
    pub map_bricks: Option<[u64; 3]>,
    /// Surfaces against those of the samples, in the order of the isovalues that were given.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub surfaces: Vec<SurfaceErrors>,
    /// Seconds of wall time.
    #[serde(rename = "wall_seconds")]
    pub seconds: f64,
}

/// Measures an archive against a source: see
/// [`Measurement::run`](crate::pipeline::Measurement::run).
pub(in crate::pipeline) fn measure(
    archive: &Arc<OpenArchive>,
    source: &StepSource,
    settings: &MeasureSettings,
    progress: &dyn Progress,
    also: Option<Also<'_>>,
) -> Result<MeasureReport> {
    let start = Instant::now();
    let choice = choice_of(archive, settings.step, source);
    let archive = archive.at(choice)?;
    let level = archive.level(settings.level)?;
    let (error, same_source) = against(&archive, source, settings, progress, also)?;
    Ok(MeasureReport {
        error,
        range: archive.step().file_range(),
        same_source,
        level: archive.is_pyramid().then_some(level),
        map_bricks: settings.map.as_ref().map(|_| archive.chunks.bricks().dims()),
        surfaces: vec![],
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// The step that is measured: where each has several fields, of the field that the source is read
/// for.
fn choice_of(archive: &OpenArchive, step: Option<u64>, source: &StepSource) -> StepChoice {
    let has_fields = archive.manifest.steps[0].series.is_some();
    let field = source.options.field.as_deref().filter(|_| has_fields);
    match (step, field.map(|name| without_frame(name).to_owned())) {
        (None, None) => StepChoice::First,
        (Some(step), None) => StepChoice::Number(step),
        (None, Some(field)) => StepChoice::Field(field),
        (Some(step), Some(field)) => StepChoice::NumberOf(step, field),
    }
}

/// Measures steps of an archive, by ascending positions in the manifest, whose inputs are not open
/// any more. A mesh is laid out once for all of them.
pub(in crate::pipeline) fn reopened_errors(
    archive: &Arc<OpenArchive>,
    steps: &[(usize, &StepSource)],
    settings: &MeasureSettings,
    progress: &dyn Progress,
) -> Result<Vec<StepErrors>> {
    let (mut errors, mut store) = (vec![], None);
    for group in steps.chunks(MOST_STEPS_AT_ONCE as usize) {
        let mut columns = vec![];
        for &(position, source) in group {
            let view = archive.step_at(position);
            match open_field(&view, source)? {
                Input::Volume(volume) => {
                    let samples = source_samples(&view, volume, source, settings, progress)?.0;
                    let error = against_samples(&view, &samples, settings, progress)?;
                    errors.push((error, vec![]));
                }
                Input::Mesh(mesh) => {
                    let values = reopened_values(&view, &mesh, &source.path, &mut store, settings)?;
                    columns.push((position, values));
                }
            }
        }
        if let Some(store) = &store {
            let columns: Vec<_> = columns.iter().map(|(position, values)| (*position, values)).collect();
            let view = archive.step_at(columns[0].0);
            errors.extend(vertex_errors(&view, store, &columns, settings, progress)?);
        }
    }
    Ok(errors)
}

/// The values of a step on the mesh of a series, which the first of them lays out.
pub(in crate::pipeline) fn reopened_values(
    archive: &StepView,
    mesh: &CellMesh,
    input: &Path,
    store: &mut Option<CellStore>,
    settings: &MeasureSettings,
) -> Result<Column<f32>> {
    let plan = &archive.manifest.plan;
    let (how, vertices) = (store_settings(archive, settings), mesh.info().points);
    if store.as_ref().is_some_and(|store| store.census.vertices != vertices) {
        return Err(other_input(input, &archive.step().plan.source, format!("{vertices} vertices")));
    }
    let store = match store {
        Some(store) => store,
        none => {
            let firsts = Attachments::repeated(archive.path(), plan, vertices, &how)?;
            none.insert(mesh_store(archive, mesh, Some(firsts), input, &how)?)
        }
    };
    store.values_of(mesh, &how)
}

/// The error, and whether the input is the one that the archive was made from.
fn against(
    archive: &StepView,
    source: &StepSource,
    settings: &MeasureSettings,
    progress: &dyn Progress,
    also: Option<Also<'_>>,
) -> Result<(FieldError, bool)> {
    match open_field(archive, source)? {
        Input::Volume(volume) => {
            let (samples, same) = source_samples(archive, volume, source, settings, progress)?;
            let error = against_samples(archive, &samples, settings, progress)?;
            also.map_or(Ok(()), |also| also(archive, &samples))?;
            Ok((error, same))
        }
        Input::Mesh(_) if also.is_some() => Err(no_samples()),
        Input::Mesh(mesh) => against_mesh(archive, &mesh, &source.path, settings, progress),
    }
}

/// Does something with a step and the samples of a volume, and measures nothing else.
///
/// # Errors
/// [`Error::Usage`] for a mesh; those of [`measure`], and of what is done.
#[cfg(feature = "compare")]
pub(in crate::pipeline) fn with_samples(
    archive: &StepView,
    source: &StepSource,
    resources: &Resources,
    progress: &dyn Progress,
    also: Also<'_>,
) -> Result<()> {
    let Input::Volume(volume) = open_field(archive, source)? else { return Err(no_samples()) };
    let settings = MeasureSettings { resources: resources.clone(), ..MeasureSettings::default() };
    let (samples, _) = source_samples(archive, volume, source, &settings, progress)?;
    also(archive, &samples)
}

/// The error of a mesh whose surfaces are to be measured.
pub(in crate::pipeline) fn no_samples() -> Error {
    Error::usage("surfaces are measured against the samples of a volume: the source is a mesh")
}

/// Opens the input. Where no field of a file is named, the one that the archive names is read.
fn open_field(archive: &StepView, source: &StepSource) -> Result<Input> {
    let options = &source.options;
    if source.is_given() || options.field.is_some() {
        return source.open();
    }
    let named = OpenOptions { field: Some(archive.step().plan.source.field.clone()), ..options.clone() };
    // A format without names of fields refuses any, and has one field only.
    source.with_options(&named).open().or_else(|_| source.with_options(options).open())
}

/// The samples of a volume that is a step's source, and whether it is the one that was reduced.
fn source_samples(
    archive: &StepView,
    volume: VolumeSource,
    source: &StepSource,
    settings: &MeasureSettings,
    progress: &dyn Progress,
) -> Result<(SourceSamples, bool)> {
    let recorded = &archive.step().plan.source;
    let dims = volume.info().dims;
    if recorded.mesh.is_some() || dims != recorded.dims {
        return Err(other_input(&source.path, recorded, format!("a volume of {} samples", triple(dims))));
    }
    // Of a run that has just hashed the same files, they are not read again.
    let files = volume.info().files();
    let hash = Inputs::default().of_source(0, source, &files, &settings.resources.cancel)?;
    let same = hash == recorded.fingerprint;
    let resources = &settings.resources;
    let run = RunSettings { resources: resources.clone(), ..RunSettings::default() };
    let of_map = if settings.map.is_some() { map_bytes(resources.memory) } else { 0 };
    let least = match archive.is_pyramid() {
        true => 2 * estimate::BASE + of_map,
        false => Visit::new(archive, Blocks::All, resources, |_| 0)?.least(EXTRA) + estimate::BASE + of_map,
    };
    let boxes = boxes_of_chunks(&archive.points, &archive.chunks, Halo::of(&archive.manifest.plan));
    let cache = ChunkCache::fitting(&volume, boxes, true, least, &run);
    let (reader, scratch) = random_access(volume, cache.map(|c| c.size), &run, progress)?;
    let held = cache.map_or(0, |c| c.held);
    let resources = resources.clone().with_memory(resources.memory - held);
    let reading = Reading::of(&archive.step().plan);
    let (reader, missing, stand_in) = (reading.reader(reader), reading.missing(), reading.stand_in());
    Ok((SourceSamples { reader, missing, stand_in, resources, _scratch: scratch }, same))
}

fn against_samples(
    archive: &StepView,
    samples: &SourceSamples,
    settings: &MeasureSettings,
    progress: &dyn Progress,
) -> Result<FieldError> {
    let settings = &MeasureSettings { resources: samples.resources.clone(), ..settings.clone() };
    let SourceSamples { reader, missing, stand_in, .. } = samples;
    let originals = Originals::Volume { reader: &**reader, missing: *missing, stand_in: *stand_in };
    field_error(archive, &originals, settings, progress)
}

fn against_mesh(
    archive: &StepView,
    mesh: &CellMesh,
    input: &Path,
    settings: &MeasureSettings,
    progress: &dyn Progress,
) -> Result<(FieldError, bool)> {
    let recorded = &archive.step().plan.source;
    progress.begin("read the mesh", 0, "points");
    let store = mesh_store(archive, mesh, None, input, &store_settings(archive, settings))?;
    let same = fingerprint(&mesh.info().files())? == recorded.fingerprint;
    Ok((field_error(archive, &Originals::Mesh(&store, &store.values), settings, progress)?, same))
}

/// How a mesh is read whose field at its vertices is measured.
pub(in crate::pipeline) fn store_settings(archive: &StepView, settings: &MeasureSettings) -> StoreSettings {
    let step = &archive.step().plan;
    StoreSettings {
        memory: settings.resources.memory / 4,
        scratch: settings.scratch(),
        bad_value: Reading::of(step).stand_in().map_or(BadValue::Void, BadValue::Use),
        offset: step.source.offset,
        missing: step.missing,
        cancel: settings.resources.cancel.clone(),
    }
}

/// A mesh on disk, which must be of the size of the archive's.
fn mesh_store(
    archive: &StepView,
    mesh: &CellMesh,
    firsts: Option<Firsts>,
    input: &Path,
    how: &StoreSettings,
) -> Result<CellStore> {
    let recorded = &archive.step().plan.source;
    let store = CellStore::build_with(mesh, firsts, how)?;
    let found = [store.census.vertices, store.census.tetrahedra];
    let expected = recorded.mesh.map(|m| [m.vertices, m.tetrahedra]);
    if expected != Some(found) || store.frame.lattice != archive.manifest.plan.lattice {
        let got = format!("a mesh of {} vertices and {} tetrahedra", found[0], found[1]);
        return Err(other_input(input, recorded, got));
    }
    Ok(store)
}

fn triple([x, y, z]: [u64; 3]) -> String {
    format!("{x} x {y} x {z}")
}

/// The error of an input that cannot be what the archive was made from.
fn other_input(input: &Path, recorded: &Source, got: String) -> Error {
    let expected = match recorded.mesh {
        None => format!("a volume of {} samples", triple(recorded.dims)),
        Some(m) => format!("a mesh of {} vertices and {} tetrahedra", m.vertices, m.tetrahedra),
    };
    Error::bad_input(input, "size", expected, got)
        .with_help(format!("the archive was made from {}", recorded.path))
}

/// Measures an archive, published or not.
pub(super) fn field_error(
    archive: &StepView,
    originals: &Originals<'_>,
    settings: &MeasureSettings,
    progress: &dyn Progress,
) -> Result<FieldError> {
    if settings.map.is_some() {
        archive.refuse_coordinates("a map of bricks")?;
    }
    let map = settings.map.as_deref().map(|path| Map::new(archive, path, &settings.resources)).transpose()?;
    match originals {
        Originals::Volume { reader, .. } => {
            let samples = Samples::of(originals).expect("those of a volume");
            let sample_errors = SampleErrors::new(&archive.manifest.plan.lattice);
            let against =
                AgainstSamples { archive, samples, reader: *reader, sample_errors, mapped: map.is_some() };
            against.measure(map, settings, progress)
        }
        Originals::Mesh(store, values) => {
            let step = [(archive.position(), *values)];
            let mut errors = measure_vertices(archive, store, &step, map, settings, progress)?;
            Ok(errors.pop().expect("of one step").0)
        }
    }
}

/// Measures steps of an archive, published or not, from a position in the manifest on.
pub(in crate::pipeline) fn field_errors(
    archive: &Arc<OpenArchive>,
    first: usize,
    originals: &[Originals<'_>],
    settings: &MeasureSettings,
    progress: &dyn Progress,
) -> Result<Vec<StepErrors>> {
    let (mut errors, mut on_mesh, mut store) = (vec![], vec![], None);
    for (position, original) in (first..).zip(originals) {
        match original {
            Originals::Volume { .. } => {
                let view = archive.step_at(position);
                errors.push((field_error(&view, original, settings, progress)?, vec![]));
            }
            Originals::Mesh(mesh, values) => {
                store = Some(*mesh);
                on_mesh.push((position, *values));
            }
        }
    }
    // The steps of a series are on one mesh, or on none.
    match store {
        Some(store) => vertex_errors(&archive.step_at(first), store, &on_mesh, settings, progress),
        None => Ok(errors),
    }
}

/// Measures steps at the vertices of a mesh, which are located once for as many steps as the memory
/// allows.
fn vertex_errors(
    archive: &StepView,
    store: &CellStore,
    steps: &[(usize, &Column<f32>)],
    settings: &MeasureSettings,
    progress: &dyn Progress,
) -> Result<Vec<StepErrors>> {
    match measure_vertices(archive, store, steps, None, settings, progress) {
        // Refused before anything was read: fewer steps take less.
        Err(Error::Budget { .. }) if steps.len() > 1 => {
            let (some, others) = steps.split_at(steps.len() / 2);
            let mut errors = vertex_errors(archive, store, some, settings, progress)?;
            errors.extend(vertex_errors(archive, store, others, settings, progress)?);
            Ok(errors)
        }
        other => other,
    }
}

/// The samples of a volume, against an archive.
struct AgainstSamples<'a> {
    archive: &'a StepView,
    samples: Samples<'a>,
    reader: &'a dyn VolumeReader,
    sample_errors: SampleErrors,
    /// Whether errors are wanted brick by brick.
    mapped: bool,
}

/// What a chunk contributes.
#[derive(Default)]
struct ChunkMeasure {
    sums: ErrorSums,
    bricks: BTreeMap<u64, BrickErrors>,
}

/// Bytes of a job in addition to its chunk: samples, sums, bricks.
const EXTRA: u64 = estimate::error_bytes(1) + (1 << 19);

impl AgainstSamples<'_> {
    fn measure(
        &self,
        mut map: Option<Map>,
        settings: &MeasureSettings,
        progress: &dyn Progress,
    ) -> Result<FieldError> {
        let archive = self.archive;
        let mapped = map.is_some();
        if archive.is_pyramid() {
            return self.measure_levels(map, settings, progress);
        }
        let of_map = |memory: u64| if mapped { map_bytes(memory) } else { 0 };
        let share = |memory: u64| memory.saturating_sub(estimate::BASE + of_map(memory));
        let visit = Visit::new(archive, Blocks::All, &settings.resources, share)?;
        visit.check_memory(EXTRA)?;
        progress.begin("measure", visit.chunks.len() as u64, "chunks");
        let (mut sums, mut released) = (ErrorSums::default(), 0);
        let job = |_, chunk: DecodedChunk| self.part(&chunk);
        visit.each(EXTRA, progress, job, |n, part: ChunkMeasure| {
            sums.merge(&part.sums);
            let chunk = archive.chunks.chunk(visit.chunks[n]);
            if let Some(map) = &mut map {
                map.add(chunk.id.0, &part.bricks)?;
            }
            // Samples below the layer of chunks before this one are done with: no halo reaches that
            // far.
            let slice = |z: u32| u64::from(z >> archive.manifest.plan.lattice.log2_steps[2]);
            let keep = slice(chunk.core.lo[2]).saturating_sub(slice(chunk.core.hi[2] - chunk.core.lo[2]));
            if keep > released {
                self.reader.release(released..keep);
                released = keep;
            }
            Ok(())
        })?;
        if let Some(map) = map {
            map.finish()?;
        }
        field_error_of(archive, &sums)
    }

    /// Measures the samples of a pyramid.
    fn measure_levels(
        &self,
        mut map: Option<Map>,
        settings: &MeasureSettings,
        progress: &dyn Progress,
    ) -> Result<FieldError> {
        let (bricks, lattice) = (self.archive.chunks.bricks(), self.archive.manifest.plan.lattice);
        let brick_of = |sample: [u64; 3]| bricks.id(bricks.brick_at(lattice.of_voxel(sample))).0;
        let brick: Option<&(dyn Fn([u64; 3]) -> u64 + Sync)> = map.as_ref().map(|_| &brick_of as _);
        let originals = |window, out: &mut [f32]| self.samples.read(window, out);
        let level = self.archive.level(settings.level)?;
        let each = |chunk, bricks: BTreeMap<u64, BrickErrors>| {
            map.as_mut().map_or(Ok(()), |map| map.add(chunk, &bricks))
        };
        let sums = errors_of(self.archive, level, &settings.resources, progress, originals, brick, each)?;
        map.map(Map::finish).transpose()?;
        let ends = samples_of_level(&self.archive.pyramid()?.pyramid, level);
        field_error_within(self.archive, ends, &sums)
    }

    /// Measures the samples in the tetrahedra of a chunk.
    fn part(&self, chunk: &DecodedChunk) -> Result<ChunkMeasure> {
        let DecodedChunk { positions, tets, block_ends, values, .. } = chunk;
        let cells = ChunkTets { positions, tets, block_ends };
        let read = |_, window, out: &mut [f32]| self.samples.read(window, out);
        if !self.mapped {
            let mut sums = self.sample_errors.errors(&cells, &StepLanes::one(values), read)?;
            return Ok(ChunkMeasure { sums: sums.pop().expect("of one step"), ..ChunkMeasure::default() });
        }
        let (bricks, lattice) = (self.archive.chunks.bricks(), self.archive.manifest.plan.lattice);
        let (mut part, mut sums, dims) =
            (ChunkMeasure::default(), Tally::default(), self.sample_errors.dims());
        self.sample_errors.each_sample(&cells, &StepLanes::one(values), read, |m| {
            errors::add(&mut sums, &m, dims);
            for (n, (original, reduced)) in m.compared.pairs().enumerate() {
                let brick = bricks.id(bricks.brick_at(lattice.of_voxel(m.place(n))));
                part.bricks.entry(brick.0).or_default().add(original, reduced);
            }
        })?;
        part.sums = sums.finish();
        Ok(part)
    }
}

/// Positions of steps, and their values at the vertices; a map is of one step.
fn measure_vertices(
    archive: &StepView,
    store: &CellStore,
    steps: &[(usize, &Column<f32>)],
    mut map: Option<Map>,
    settings: &MeasureSettings,
    progress: &dyn Progress,
) -> Result<Vec<StepErrors>> {
    if archive.manifest.plan.own.is_some() {
        let (how, memory) = (store_settings(archive, settings), settings.resources.memory);
        let of_map = if map.is_some() { map_bytes(memory) } else { 0 };
        let rest = memory.saturating_sub(of_map);
        return own_errors(archive, store, steps, map, &how, rest, progress).map_err(|e| e.plus_held(of_map));
    }
    let columns = steps.iter().map(|(_, values)| values.get()).collect::<Result<Vec<_>>>()?;
    let steps: Vec<usize> = steps.iter().map(|step| step.0).collect();
    let levels = archive.points.levels();
    let none = vec![ErrorSums::default(); levels.map_or(0, |levels| usize::from(levels.top()) + 1)];
    let sums_bytes = (steps.len() * (none.len() + 1)) as u64 * ErrorSums::BYTES;
    let mapped = map.is_some();
    let of_map = |memory: u64| if mapped { map_bytes(memory) } else { 0 };
    let rest = |memory: u64| memory.saturating_sub(estimate::BASE + of_map(memory) + sums_bytes);
    let how = store_settings(archive, settings);
    let mut vertices = AtVertices::new(archive, store, &steps, &settings.resources, &rest, &how)?;
    let bricks = archive.chunks.bricks();
    let mut beyond = vec![0u64; steps.len()];
    let mut sums: Vec<_> = steps.iter().map(|_| (ErrorSums::default(), none.clone())).collect();
    for batch in vertices.batches() {
        let mut errors = BTreeMap::<u64, BrickErrors>::new();
        let first = batch.start;
        vertices.each_in(batch, progress, |number, at, reduced, is_inside| {
            let level = levels.map(|levels| usize::from(levels.at(at)));
            for ((((sums, of_levels), values), &reduced), beyond) in
                sums.iter_mut().zip(&columns).zip(reduced).zip(&mut beyond)
            {
                let is_measured = !reduced.is_nan() && !values[number as usize].is_nan();
                *beyond += u64::from(!is_inside && is_measured);
                sums.add(values[number as usize], reduced, || number);
                if let Some(level) = level {
                    of_levels[level].add(values[number as usize], reduced, || number);
                }
            }
            if mapped {
                let brick = bricks.id(bricks.brick_at(at));
                errors.entry(brick.0).or_default().add(columns[0][number as usize], reduced[0]);
            }
        })?;
        if let Some(map) = &mut map {
            map.add(first, &errors)?;
        }
    }
    if let Some(map) = map {
        map.finish()?;
    }
    reported_errors(archive, store, &steps, &columns, &sums, &beyond)
}
