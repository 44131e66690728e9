//! Surfaces of labels: a closed mesh for each, with walls that neighbours share.
//!
//! ```text
//!  index ─▶ bricks of several labels ─▶ sides of quads, part by part ─▶ sorted by label ─▶ meshes ─▶ file
//! ```
//!
//! A quad between two labels has two sides, one for each; a side says all about its corners, in 44
//! bytes. They are sorted on disk where memory does not hold them. Then the mesh of each label is
//! made in turn (`surface/nets`), so that neither their number nor their size needs memory.

mod extract;
mod image;
mod settings;

pub(in crate::pipeline) use settings::LabelSettings;
pub use settings::{LabelMesh, LabelReport, Labels, OneLabel};

use super::settings::{file_of, is_each_alone};
use crate::files::surface::{SurfaceFormat, SurfaceMeta, SurfacePart, write_surface};
use crate::pipeline::read::{StepView, expect_in_f32, world_map};
use crate::pipeline::stage::Stage;
use crate::surface::SurfaceSource;
use crate::surface::check::zero_area_triangles;
use crate::surface::nets::LabelMeshSize;
use crate::surface::weld::{BuilderSettings, StoredSurface};
use extract::LabelMeshes;
use image::LabelImage;
use isospan_io::bytes::remote::{traffic, traffic_since};
use isospan_io::error::Result;
use isospan_io::exec::{Clock, Progress, Resources};
use std::path::{Path, PathBuf};

/// Writes the surfaces of labels: see [`LabelQuery::write`](crate::pipeline::LabelQuery::write).
pub(in crate::pipeline) fn write_labels(
    view: &StepView,
    settings: &LabelSettings,
    out: &Path,
    format: SurfaceFormat,
    progress: &dyn Progress,
) -> Result<LabelReport> {
    let (scratch, before) = (settings.scratch_of(out), traffic(view.path()));
    let mut work = Work::new(view, settings, &scratch, progress)?;
    let start = Clock::start();
    let mut report = std::mem::take(&mut work.report);
    while let Some(label) = work.next_label() {
        let mut surface = work.surface();
        let mut labels = vec![work.add(label, out, &mut surface)?];
        if !is_each_alone(out) {
            while let Some(label) = work.next_label() {
                labels.push(work.add(label, out, &mut surface)?);
            }
        }
        work.write(&surface, &labels, format, &mut report)?;
        report.labels.append(&mut labels);
    }
    if report.labels.is_empty() && !is_each_alone(out) {
        work.write_empty(out, format, &mut report)?;
    }
    report.seconds.push((Stage::Write, start.elapsed().as_secs_f64()));
    report.archive_bytes = view.bytes()?;
    report.remote = traffic_since(view.path(), before);
    Ok(report)
}

/// The surfaces of labels in memory: see
/// [`LabelQuery::meshes`](crate::pipeline::LabelQuery::meshes).
pub(in crate::pipeline) fn label_meshes(
    view: &StepView,
    settings: &LabelSettings,
    progress: &dyn Progress,
) -> Result<Vec<LabelMesh>> {
    let scratch = settings.resources.scratch_folder();
    let mut work = Work::new(view, settings, &scratch, progress)?;
    let mut meshes = vec![];
    while let Some(label) = work.next_label() {
        let mut surface = work.surface();
        let label = work.add(label, Path::new(""), &mut surface)?;
        meshes.push(LabelMesh { label, mesh: surface.into_mesh()? });
    }
    Ok(meshes)
}

/// The labels with the sizes of their surfaces, which are not kept: see
/// [`LabelQuery::sizes`](crate::pipeline::LabelQuery::sizes).
pub(in crate::pipeline) fn label_sizes(
    view: &StepView,
    settings: &LabelSettings,
    progress: &dyn Progress,
) -> Result<Vec<OneLabel>> {
    let scratch = settings.resources.scratch_folder();
    let mut work = Work::new(view, settings, &scratch, progress)?;
    let mut sizes = vec![];
    while let Some(label) = work.next_label() {
        sizes.push(work.add(label, Path::new(""), &mut work.surface())?);
    }
    Ok(sizes)
}

/// The files that surfaces of labels are written to, where they are known before work.
pub(in crate::pipeline) fn label_files(settings: &LabelSettings, out: &Path) -> Vec<PathBuf> {
    match &settings.labels {
        _ if !is_each_alone(out) => vec![out.to_path_buf()],
        Labels::Each(labels) => labels.iter().map(|&label| file_of(out, label as f64)).collect(),
        _ => vec![],
    }
}

/// Meshes of labels while they are made and written.
struct Work<'a> {
    image: LabelImage<'a>,
    settings: &'a LabelSettings,
    scratch: &'a Path,
    meshes: LabelMeshes,
    /// Labels that are asked for by their numbers, descending: those that are still to come.
    asked: Vec<i64>,
    /// What is known of the work so far.
    report: LabelReport,
}

impl<'a> Work<'a> {
    fn new(
        view: &'a StepView,
        settings: &'a LabelSettings,
        scratch: &'a Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        settings.check()?;
        expect_in_f32(view)?;
        let (start, read_before) = (Clock::start(), view.bytes_read());
        let image = LabelImage::of(view)?;
        let wanted = image.wanted(&settings.labels);
        let active = image.active_bricks(&wanted)?;
        let opened = start.elapsed().as_secs_f64();
        let start = Clock::start();
        let bricks = active.places.iter().copied();
        let meshes = LabelMeshes::of(&image, &wanted, bricks, settings, scratch, progress)?;
        let report = LabelReport {
            smooth: settings.smooth,
            bricks: active.of,
            active_bricks: active.places.len() as u64,
            bytes_read: active.index_bytes + view.bytes_read() - read_before,
            seconds: vec![(Stage::Open, opened), (Stage::Extract, start.elapsed().as_secs_f64())],
            ..LabelReport::default()
        };
        let mut asked = match &settings.labels {
            Labels::Each(labels) => labels.clone(),
            _ => vec![],
        };
        asked.sort_unstable_by(|a, b| b.cmp(a));
        Ok(Self { image, settings, scratch, meshes, asked, report })
    }

    /// The next label, ascending: one that is asked for is there without voxels too.
    fn next_label(&self) -> Option<i64> {
        let found = self.meshes.next_label().map(|label| self.image.in_file(label));
        [found, self.asked.last().copied()].into_iter().flatten().min()
    }

    /// An empty surface.
    fn surface(&self) -> StoredSurface {
        let memory_bytes = usize::try_from(self.meshes.shares.finished).unwrap_or(usize::MAX);
        let place = BuilderSettings { memory_bytes, scratch: self.scratch.to_path_buf() };
        let mut surface = StoredSurface::new(&place);
        surface.count_from(world_map(self.image.view).origin());
        surface
    }

    /// Adds the mesh of the next label to a surface.
    fn add(&mut self, label: i64, out: &Path, surface: &mut StoredSurface) -> Result<OneLabel> {
        self.settings.resources.cancel.check()?;
        self.asked.pop_if(|asked| *asked == label);
        let has_voxels = self.meshes.next_label().map(|found| self.image.in_file(found)) == Some(label);
        let size = if has_voxels { self.meshes.add_next(surface)? } else { LabelMeshSize::default() };
        let LabelMeshSize { vertices, triangles, voxels, area, volume } = size;
        let style = self.settings.table.style(label);
        let (name, colour, file) = (style.name, style.colour, file_of(out, label as f64));
        Ok(OneLabel { label, name, colour, file, voxels, vertices, triangles, area, volume })
    }

    /// Writes the surface of some labels.
    fn write(
        &self,
        surface: &StoredSurface,
        labels: &[OneLabel],
        format: SurfaceFormat,
        report: &mut LabelReport,
    ) -> Result<()> {
        let Some(first) = labels.first() else { return Ok(()) };
        let part = |one: &OneLabel| SurfacePart {
            isovalue: one.label as f64,
            vertices: one.vertices,
            triangles: one.triangles,
            label: Some(self.settings.table.style(one.label)),
        };
        let meta = SurfaceMeta { parts: labels.iter().map(part).collect(), ..self.meta() };
        let held = usize::try_from(self.settings.resources.memory / 16).unwrap_or(usize::MAX);
        report.without_area += zero_area_triangles(surface, held, self.scratch)?;
        report.file_bytes += write_surface(surface, &first.file, format, &meta, &self.resources())?;
        report.vertices += surface.vertex_count();
        report.triangles += surface.triangle_count();
        let origin = surface.origin();
        report.shift = (format.shifts() && origin != [0.0; 3]).then_some(origin);
        Ok(())
    }

    /// Writes a file without a surface, of an image without labels.
    fn write_empty(&self, out: &Path, format: SurfaceFormat, report: &mut LabelReport) -> Result<()> {
        report.file_bytes = write_surface(&self.surface(), out, format, &self.meta(), &self.resources())?;
        Ok(())
    }

    fn resources(&self) -> Resources {
        self.settings.resources.clone().with_scratch(self.scratch.to_path_buf())
    }

    fn meta(&self) -> SurfaceMeta {
        let source = &self.image.view.step().plan.source;
        let comment = format!("isospan {} of {}", env!("CARGO_PKG_VERSION"), source.path);
        SurfaceMeta {
            comments: vec![comment],
            units: source.units.clone(),
            time: self.image.view.time(),
            compress: self.settings.compress,
            ..SurfaceMeta::default()
        }
    }
}
