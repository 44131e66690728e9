//! Questions to an archive: the index names the blocks that can hold an answer, and only those are
//! read.

use super::active::{ActiveWork, cut_of, work_of};
use super::colours::colours;
use super::cubes::crossed_cells;
use super::extract::Extraction;
use super::level::level_of;
use super::parts::{Parts, SurfaceSink};
use super::question::{ChunkWork, Question};
use super::refine::{RefineMeans, RefineReport};
use super::settings::{
    CountReport, OneSurface, SurfaceReport, SurfaceSettings, file_of, finite, is_each_alone,
};
use super::weld::{Extracted, SurfaceStorage};
use crate::files::surface::{self, SurfaceFormat, SurfaceMeta, write_surface};
use crate::pipeline::read::{
    Block, ChunkReader, CornerValues, Cut, Needed, ReaderMemory, Roi, RoiSpace, StepView, ValuesMemory,
    WantedBlocks, expect_in_f32, in_memory, in_world, world_map,
};
use crate::pipeline::stage::Stage;
use crate::surface::check::zero_area_triangles;
use crate::surface::edit::clip::{HalfSpace, clip};
use crate::surface::edit::faces::Faces;
use crate::surface::extract::Sides;
use crate::surface::weld::{BuilderSettings, StoredSurface};
use crate::surface::{Joined, SurfaceSource, TriMesh, WorldMap};
use isospan_io::bytes::remote::{traffic, traffic_since};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Clock, Progress, pool};
use rayon::prelude::*;
use std::path::Path;
use std::time::Duration;

/// Counts the active tetrahedra of an isovalue, exactly: from the spectrum where it is stored
/// ([`crate::spectrum`]: at any isovalue of a few digits), else by decoding the active blocks.
pub(in crate::pipeline) fn count(
    archive: &StepView,
    wanted: f64,
    settings: &SurfaceSettings,
) -> Result<CountReport> {
    finite(wanted)?;
    archive.expect_values()?;
    let isovalue = archive.step().plan.source.kept(wanted);
    let read_before = archive.bytes_read();
    let level = level_of(archive, settings)?;
    let has_spectrum = level == 0 && !archive.is_between();
    let spectrum = if has_spectrum { archive.stored_spectrum()? } else { None };
    let stored = spectrum.as_ref().and_then(|file| file.active(isovalue));
    let mut bytes_read = spectrum.map_or(0, |f| f.bytes_read()) + archive.bytes_read() - read_before;
    let active_cells = match stored {
        Some(n) => n,
        None => {
            let (n, bytes) = decoded_count(archive, level, isovalue, settings)?;
            bytes_read += bytes;
            n
        }
    };
    Ok(CountReport {
        isovalue: wanted,
        active_cells,
        tetrahedra: archive.manifest.counts.tetrahedra,
        level: archive.is_pyramid().then_some(level),
        stored: stored.is_some(),
        bytes_read,
    })
}

/// Decodes the active blocks, and counts their active tetrahedra; also returns the bytes read.
fn decoded_count(
    archive: &StepView,
    level: usize,
    isovalue: f32,
    settings: &SurfaceSettings,
) -> Result<(u64, u64)> {
    let read_before = archive.bytes_read();
    let ActiveWork { work, index_bytes } = work_of(archive, settings, level, None)?;
    let count = |work: &ChunkWork| {
        settings.resources.cancel.check()?;
        match work.cells {
            Some(_) => crossed_cells(archive, level, work, isovalue),
            None => count_in_chunk(archive, work, isovalue),
        }
    };
    let active =
        pool(settings.resources.threads)?.install(|| work.par_iter().map(count).sum::<Result<u64>>())?;
    Ok((active, index_bytes + archive.bytes_read() - read_before))
}

fn count_in_chunk(archive: &StepView, work: &ChunkWork, isovalue: f32) -> Result<u64> {
    let mut reader = ChunkReader::open(archive, work.chunk, ReaderMemory::default())?;
    reader.expect(work.blocks.iter().map(|b| b.block));
    let mut values = CornerValues::new(archive, work.chunk, reader.vertices(), ValuesMemory::default())?;
    let (mut block, mut sides, mut active, mut count) = (Block::default(), Sides::default(), vec![], 0);
    for entry in &work.blocks {
        reader.block(entry.block, &WantedBlocks::All, &mut block)?;
        values.take(&Needed::ForActive(&[isovalue]), &mut block)?;
        active.clear();
        sides.select(&block.tets, &block.corners.values, isovalue, &mut active);
        count += active.len() as u64;
    }
    Ok(count)
}

/// Extracts isosurfaces to a file: see
/// [`SurfaceQuery::write`](crate::pipeline::SurfaceQuery::write).
pub(in crate::pipeline) fn write_surfaces(
    archive: &StepView,
    settings: &SurfaceSettings,
    out: &Path,
    format: SurfaceFormat,
    progress: &dyn Progress,
) -> Result<SurfaceReport> {
    settings.check_colours(format)?;
    let (scratch, before) = (settings.scratch_of(out), traffic(archive.path()));
    let made = make(archive, settings, SurfaceStorage { scratch, reused: vec![] }, None, progress)?;
    let report = write_made(archive, settings, made, out, format)?.0;
    Ok(SurfaceReport { remote: traffic_since(archive.path(), before), ..report })
}

/// Writes surfaces of a step; they come back with the report.
pub(super) fn write_made(
    archive: &StepView,
    settings: &SurfaceSettings,
    mut made: FinishedSurfaces,
    out: &Path,
    format: SurfaceFormat,
) -> Result<(SurfaceReport, Vec<Extracted>)> {
    let (start, mut origin, mut without_area) = (Clock::start(), [0.0; 3], 0);
    let held = usize::try_from(settings.resources.memory / 16).unwrap_or(usize::MAX);
    let scratch = settings.scratch_of(out);
    let resources = settings.resources.clone().with_scratch(scratch.clone());
    let mut write = |s: &dyn SurfaceSource, path: &Path, meta: &SurfaceMeta| {
        origin = s.origin();
        without_area += zero_area_triangles(s, held, &scratch)?;
        write_surface(s, path, format, meta, &resources)
    };
    let (file_bytes, without_value) = write_all(archive, &made.surfaces, settings, out, &mut write)?;
    made.seconds.push((Stage::Write, start.elapsed()));
    let shift = shift_of(format, origin);
    let report = report_of(archive, settings, &made, out)?;
    let report = SurfaceReport { file_bytes, without_value, without_area, shift, ..report };
    Ok((report, made.surfaces))
}

/// What coordinates in a file of a surface of this origin are less.
fn shift_of(format: SurfaceFormat, origin: [f64; 3]) -> Option<[f64; 3]> {
    (format.shifts() && origin != [0.0; 3]).then_some(origin)
}

/// What was found and read; no file is written yet.
pub(super) fn report_of(
    archive: &StepView,
    settings: &SurfaceSettings,
    made: &FinishedSurfaces,
    out: &Path,
) -> Result<SurfaceReport> {
    let totals = &archive.manifest.counts;
    let surfaces = describe(archive, &made.surfaces, &made.refined, &settings.isovalues, out);
    Ok(SurfaceReport {
        range: archive.file_range(),
        level: archive.is_pyramid().then_some(made.level),
        roi: settings.roi,
        vertices: surfaces.iter().map(|s| s.vertices).sum(),
        triangles: surfaces.iter().map(|s| s.triangles).sum(),
        without_value: None,
        without_area: 0,
        shift: None,
        file_bytes: 0,
        points: totals.points,
        tetrahedra: totals.tetrahedra,
        active_cells: surfaces.iter().map(|s| s.active_cells).sum(),
        surfaces,
        blocks: archive.manifest.counts.blocks,
        active_blocks: made.active_blocks,
        chunks: totals.chunks,
        active_chunks: made.active_chunks,
        bytes_read: made.bytes_read,
        active_bytes: made.active_bytes,
        archive_bytes: archive.bytes()?,
        remote: None,
        seconds: made.seconds.iter().map(|&(stage, time)| (stage, time.as_secs_f64())).collect(),
    })
}

/// Hands on the bytes of the file that [`write_surfaces`] writes.
pub(in crate::pipeline) fn stream_file(
    archive: &StepView,
    settings: &SurfaceSettings,
    format: SurfaceFormat,
    progress: &dyn Progress,
    each: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<SurfaceReport> {
    settings.check_colours(format)?;
    let scratch = settings.resources.scratch_folder();
    let resources = settings.resources.clone().with_scratch(scratch.clone());
    let settings = &SurfaceSettings { resources, ..settings.clone() };
    let storage = SurfaceStorage { scratch: scratch.clone(), reused: vec![] };
    let made = make(archive, settings, storage, None, progress)?;
    let memory_bytes = usize::try_from(settings.resources.memory / 16).unwrap_or(usize::MAX);
    let beside = BuilderSettings { memory_bytes, scratch };
    let mut origin = [0.0; 3];
    let mut write = |s: &dyn SurfaceSource, _: &Path, meta: &SurfaceMeta| {
        origin = s.origin();
        surface::stream_surface(s, format, meta, &beside, each)
    };
    let out = Path::new("");
    let (file_bytes, without_value) = write_all(archive, &made.surfaces, settings, out, &mut write)?;
    let shift = shift_of(format, origin);
    Ok(SurfaceReport { file_bytes, without_value, shift, ..report_of(archive, settings, &made, out)? })
}

/// Hands on surfaces part by part while they are extracted, then each as a whole, in the order of
/// the isovalues, in the world.
///
/// Memory does not grow with the surfaces: what the settings do not allow for is in their scratch
/// folder.
pub(in crate::pipeline) fn stream_surfaces(
    archive: &StepView,
    settings: &SurfaceSettings,
    progress: &dyn Progress,
    sink: &mut dyn SurfaceSink,
) -> Result<SurfaceReport> {
    let scratch = settings.resources.scratch_folder();
    let mut parts = Parts::new(archive, settings, sink)?;
    let storage = SurfaceStorage { scratch, reused: vec![] };
    let made = make(archive, settings, storage, Some(&mut parts), progress)?;
    for (isovalue, found) in made.surfaces.iter().enumerate() {
        found.in_world(archive, &found.surface, |surface| {
            parts.take_whole(surface, isovalue, archive.chunks.len())
        })?;
    }
    report_of(archive, settings, &made, Path::new(""))
}

/// Surfaces, cut and refined, and what was read for them.
pub(super) struct FinishedSurfaces {
    pub(super) surfaces: Vec<Extracted>,
    level: usize,
    refined: Vec<RefineReport>,
    active_blocks: u64,
    active_chunks: u64,
    bytes_read: u64,
    active_bytes: u64,
    seconds: Vec<(Stage, Duration)>,
}

/// A question about a step, and the blocks that can hold an answer.
pub(super) struct Prepared<'a> {
    pub(super) view: &'a StepView,
    pub(super) work: Vec<ChunkWork>,
    /// The level of a pyramid.
    level: usize,
    /// The isovalues, as the archive has values.
    isovalues: Vec<f32>,
    cut: Option<Cut>,
    /// Where surfaces are cut in the world, after they are placed.
    half_spaces: Option<Vec<HalfSpace>>,
    world: WorldMap,
    /// Bytes that the view had read before, and those of values.
    read_before: u64,
    values_before: u64,
    /// Bytes of the index that were read, and the time that it took.
    index_bytes: u64,
    opened: Duration,
}

/// What extraction has read, and its time.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Effort {
    pub(super) bytes_read: u64,
    pub(super) active_bytes: u64,
    pub(super) time: Duration,
}

impl<'a> Prepared<'a> {
    pub(super) fn new(archive: &'a StepView, settings: &SurfaceSettings) -> Result<Self> {
        let (start, read_before) = (Clock::start(), archive.bytes_read());
        let values_before = archive.value_bytes_read();
        expect_in_f32(archive)?;
        archive.expect_values()?;
        expect_smoothable(archive, settings)?;
        let level = level_of(archive, settings)?;
        let (cut, half_spaces) = cut_of(archive, settings)?;
        if settings.cap {
            expect_full_box(archive)?;
        }
        // Where the range of all values gives the answer, no index is needed.
        let found = settings.can_answer(archive).then(|| work_of(archive, settings, level, cut.as_ref()));
        let ActiveWork { work, index_bytes } = found.transpose()?.unwrap_or_default();
        Ok(Self {
            view: archive,
            work,
            level,
            isovalues: settings.kept(archive),
            cut,
            half_spaces,
            world: world_map(archive),
            read_before,
            values_before,
            index_bytes,
            opened: start.elapsed(),
        })
    }

    pub(super) fn question(&'a self, settings: &SurfaceSettings) -> Question<'a> {
        Question {
            archive: self.view,
            isovalues: &self.isovalues,
            cut: self.cut.as_ref(),
            world: self.world,
            level: self.level,
            caps: settings.cap.then(|| self.view.manifest.plan.lattice.max()),
            work: &self.work,
        }
    }

    /// Cuts and refines what was extracted.
    pub(super) fn finish(
        &self,
        settings: &SurfaceSettings,
        mut surfaces: Vec<Extracted>,
        effort: Effort,
        scratch: &Path,
    ) -> Result<FinishedSurfaces> {
        let start = Clock::start();
        let half_spaces = self.cut.as_ref().map(|cut| &cut.half_spaces).or(self.half_spaces.as_ref());
        if let Some(half_spaces) = half_spaces {
            if self.half_spaces.is_some() {
                place_all(self.view, &mut surfaces, settings.resources.memory, scratch)?;
            }
            cut_all(&mut surfaces, half_spaces, settings.resources.memory, scratch)?;
        }
        let extracted = effort.time + start.elapsed();
        let start = Clock::start();
        let (surfaces, refined) = self.refine_all(surfaces, settings, scratch)?;
        Ok(FinishedSurfaces {
            surfaces,
            level: self.level,
            refined,
            active_blocks: self.work.iter().map(|w| w.blocks.len() as u64).sum(),
            // A chunk may be several parts, one after another.
            active_chunks: self.work.chunk_by(|a, b| a.chunk == b.chunk).count() as u64,
            bytes_read: self.index_bytes + effort.bytes_read,
            active_bytes: effort.active_bytes,
            seconds: vec![
                (Stage::Open, self.opened),
                (Stage::Extract, extracted),
                (Stage::Refine, start.elapsed()),
            ],
        })
    }

    /// Refines the surfaces, one after another.
    fn refine_all(
        &self,
        surfaces: Vec<Extracted>,
        settings: &SurfaceSettings,
        scratch: &Path,
    ) -> Result<(Vec<Extracted>, Vec<RefineReport>)> {
        let (faces, voxel) = (self.faces(settings), self.voxel()?);
        let means = RefineMeans {
            memory: settings.resources.memory,
            surfaces: surfaces.len() as u64,
            threads: settings.resources.threads,
            faces: &faces,
            voxel,
            scratch,
            cancel: &settings.resources.cancel,
        };
        let refine = |e: Extracted| {
            let (surface, report) = settings.refine.apply(e.surface, &means)?;
            Ok((Extracted { surface, ..e }, report))
        };
        surfaces.into_iter().map(refine).collect()
    }

    /// The faces of the domain, where caps lie on them.
    fn faces(&self, settings: &SurfaceSettings) -> Faces {
        let source = &self.view.step().plan.source;
        if !settings.cap {
            return Faces::default();
        }
        let last = source.dims.map(|n| (n - 1) as f64);
        let all = Roi { space: RoiSpace::Index, lo: [0.0; 3], hi: last };
        Faces::new(all.half_spaces(&source.geometry, source.dims, self.world.origin()))
    }

    /// The shortest edge of a voxel of the level, in world units.
    fn voxel(&self) -> Result<f64> {
        let stride = match self.view.is_pyramid() {
            true => self.view.pyramid()?.pyramid.stride(self.level),
            false => [1; 3],
        };
        let spacing = self.view.step().plan.source.geometry.spacing;
        Ok((0..3).map(|a| spacing[a].abs() * stride[a] as f64).fold(f64::INFINITY, f64::min))
    }
}

/// Answers a question about one step.
pub(super) fn make(
    archive: &StepView,
    settings: &SurfaceSettings,
    storage: SurfaceStorage,
    parts: Option<&mut Parts<'_>>,
    progress: &dyn Progress,
) -> Result<FinishedSurfaces> {
    settings.check()?;
    let prepared = [Prepared::new(archive, settings)?];
    let mut made = extract(&prepared, settings, vec![storage], parts, progress)?;
    Ok(made.swap_remove(0))
}

/// Answers prepared questions about steps of one archive together. What was read for all of them is
/// reported with the first.
pub(super) fn extract(
    steps: &[Prepared<'_>],
    settings: &SurfaceSettings,
    storages: Vec<SurfaceStorage>,
    parts: Option<&mut Parts<'_>>,
    progress: &dyn Progress,
) -> Result<Vec<FinishedSurfaces>> {
    let (start, scratch) = (Clock::start(), storages[0].scratch.clone());
    let questions: Vec<Question<'_>> = steps.iter().map(|step| step.question(settings)).collect();
    let extraction = Extraction::new(&questions);
    let surfaces = extraction.surfaces(settings, storages, parts, progress)?;
    // The first view reads blocks for all; others may have read summaries.
    let of_others = steps[1..].iter().map(|step| step.view.value_bytes_read() - step.values_before);
    let mut effort = Effort {
        bytes_read: steps[0].view.bytes_read() - steps[0].read_before + of_others.sum::<u64>(),
        active_bytes: extraction.active_bytes(),
        time: start.elapsed(),
    };
    let finish = |(step, surfaces): (&Prepared<'_>, _)| {
        step.finish(settings, surfaces, std::mem::take(&mut effort), &scratch)
    };
    steps.iter().zip(surfaces).map(finish).collect()
}

/// Refuses smoothing where lengths are not those of the world, or no voxel says how far.
fn expect_smoothable(archive: &StepView, settings: &SurfaceSettings) -> Result<()> {
    if settings.refine.smooth.is_none() {
        return Ok(());
    }
    archive.refuse_coordinates("smoothing")?;
    if archive.step().plan.source.mesh.is_some() && settings.refine.smooth_limit.is_none() {
        return Err(Error::usage(format!(
            "{}: a mesh has no voxels to tell how far smoothing may move a vertex: give `smooth_limit`",
            archive.path().display()
        )));
    }
    Ok(())
}

/// Refuses caps of a mesh that does not fill its box: they close a surface at the faces of the box
/// alone.
fn expect_full_box(archive: &StepView) -> Result<()> {
    let (plan, step) = (&archive.manifest.plan, archive.step());
    let is_full = match (plan.own, step.plan.source.mesh) {
        (Some(_), _) => plan.volume6() == plan.lattice.volume6(),
        (None, Some(_)) => step.void_points == 0,
        (None, None) => true,
    };
    if is_full {
        return Ok(());
    }
    Err(Error::usage(format!(
        "{}: caps close a surface at the faces of a box, and this mesh does not fill its box: leave caps out",
        archive.path().display()
    )))
}

/// Isosurfaces in memory, in the order of the isovalues. They use the memory of `reused`, as far as
/// it goes.
pub(in crate::pipeline) fn surfaces_in_memory(
    archive: &StepView,
    settings: &SurfaceSettings,
    progress: &dyn Progress,
    reused: Vec<TriMesh>,
) -> Result<Vec<TriMesh>> {
    let scratch = settings.resources.scratch.clone().unwrap_or_else(std::env::temp_dir);
    let made = make(archive, settings, SurfaceStorage { scratch, reused }, None, progress)?;
    let in_memory = |found: Extracted| match found.is_placed {
        true => found.surface.into_mesh(),
        false => in_memory(archive, found.surface),
    };
    made.surfaces.into_iter().map(in_memory).collect()
}

/// Where surfaces are stored that are made from others. An eighth of the memory holds finished
/// surfaces, as while they were extracted; another those that are made from them.
fn beside(surfaces: usize, memory: u64, scratch: &Path) -> BuilderSettings {
    let memory_bytes = usize::try_from(memory / 8 / surfaces as u64).unwrap_or(usize::MAX);
    BuilderSettings { memory_bytes, scratch: scratch.to_path_buf() }
}

/// Moves the surfaces of a grid with coordinates to the world, one after another.
fn place_all(archive: &StepView, surfaces: &mut [Extracted], memory: u64, scratch: &Path) -> Result<()> {
    let settings = beside(surfaces.len(), memory, scratch);
    for extracted in surfaces {
        extracted.surface =
            in_world(archive, &extracted.surface, |surface| StoredSurface::of(surface, &settings))?;
        extracted.is_placed = true;
    }
    Ok(())
}

/// Cuts the surfaces, one after another.
fn cut_all(surfaces: &mut [Extracted], half_spaces: &[HalfSpace], memory: u64, scratch: &Path) -> Result<()> {
    let settings = beside(surfaces.len(), memory, scratch);
    for extracted in surfaces {
        extracted.surface = clip(&extracted.surface, half_spaces, &settings, memory / 2)
            .map_err(|e| e.of_share(memory / 2, memory))?;
    }
    Ok(())
}

/// Writes a surface to a file, and returns its bytes.
type WriteFile<'a> = &'a mut dyn FnMut(&dyn SurfaceSource, &Path, &SurfaceMeta) -> Result<u64>;

/// Writes one file, or a file each. Returns the bytes of all, and at how many vertices the field of
/// the colours has no value, where there are colours.
fn write_all(
    archive: &StepView,
    surfaces: &[Extracted],
    settings: &SurfaceSettings,
    out: &Path,
    write: WriteFile<'_>,
) -> Result<(u64, Option<u64>)> {
    let comment = format!("isospan {} of {}", env!("CARGO_PKG_VERSION"), archive.step().plan.source.path);
    let (isovalues, scratch) = (&settings.isovalues, settings.scratch_of(out));
    let counts: Vec<(f64, u64)> =
        isovalues.iter().zip(surfaces).map(|(&v, s)| (v, s.surface.vertex_count())).collect();
    let mut without_value = settings.colour_by.as_ref().map(|_| 0);
    let mut meta = |isovalue: Option<f64>, surface: &dyn SurfaceSource, counts: &[(f64, u64)]| {
        let comments = vec![comment.clone()];
        let values = colours(archive, settings, surface, counts, &scratch)?;
        if let (Some(sum), Some(values)) = (&mut without_value, &values) {
            *sum += values.without_value();
        }
        let (units, time) = (archive.step().plan.source.units.clone(), archive.time());
        let compress = settings.compress;
        Ok(SurfaceMeta { isovalue, comments, parts: vec![], values, units, time, compress })
    };
    let bytes = if is_each_alone(out) || surfaces.len() == 1 {
        let mut one = |(s, count): (&Extracted, &(f64, u64))| {
            let (v, counts) = (count.0, std::slice::from_ref(count));
            s.in_world(archive, &s.surface, |s| write(s, &file_of(out, v), &meta(Some(v), s, counts)?))
        };
        surfaces.iter().zip(&counts).map(&mut one).sum::<Result<u64>>()?
    } else {
        let part = |(s, &v): (&Extracted, &f64)| surface::SurfacePart {
            isovalue: v,
            vertices: s.surface.vertex_count(),
            triangles: s.surface.triangle_count(),
            label: None,
        };
        let parts = surfaces.iter().zip(isovalues).map(part).collect();
        let joined = Joined::new(surfaces.iter().map(|s| &s.surface as &dyn SurfaceSource).collect());
        surfaces[0].in_world(archive, &joined, |s| {
            write(s, out, &SurfaceMeta { parts, ..meta(None, s, &counts)? })
        })?
    };
    Ok((bytes, without_value))
}

fn describe(
    archive: &StepView,
    surfaces: &[Extracted],
    refined: &[RefineReport],
    isovalues: &[f64],
    out: &Path,
) -> Vec<OneSurface> {
    let (range, source) = (archive.value_range(), &archive.step().plan.source);
    let is_outside = |v: f32| range.is_none_or(|[lo, hi]| v <= lo || v > hi);
    let one = |((s, &isovalue), refined): ((&Extracted, &f64), &RefineReport)| OneSurface {
        isovalue,
        file: file_of(out, isovalue),
        outside_range: is_outside(source.kept(isovalue)),
        vertices: s.surface.vertex_count(),
        triangles: s.surface.triangle_count(),
        active_cells: s.active_cells,
        refined: refined.clone(),
    };
    surfaces.iter().zip(isovalues).zip(refined).map(one).collect()
}
