//! Isosurfaces of many steps: one file for each, and a list of the files with their times.
//!
//! VTKHDF whose name has no place for the number has all steps in one file ([`super::one_file`]).
//! `out_%04d.vtp` gives `out_0000.vtp`, `out_0001.vtp`, … and `out.pvd`; for other formats the list
//! is ParaView's JSON, `out.ply.series`. ParaView and [`isospan_io::formats::steps_of`] read both.
//! A list that is there already keeps its other files, so that a series can be made in parts.
//! Several steps are extracted in one pass ([`super::pass`]). A step whose values all lie on one
//! side of the isovalues is not read: its file is an empty surface, so that the list has all steps.

use super::one_file::write_in_one;
use super::query::{FinishedSurfaces, write_made};
use super::settings::{SurfaceSettings, file_of, is_each_alone};
use super::steps::{SeriesReport, StepSurfaces, for_each_step};
use crate::archive::manifest::StoredStep;
use crate::files::surface::SurfaceFormat;
use crate::pipeline::read::{OpenArchive, StepView};
use crate::surface::TriMesh;
use isospan_io::bytes::publish::{Unpublished, folder_of};
use isospan_io::error::{Error, Result};
use isospan_io::exec::Progress;
use isospan_io::formats::listed_files;
use std::fmt::Write as _;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The files that [`write_series`] writes, the lists included.
pub(in crate::pipeline) fn series_files(
    archive: &OpenArchive,
    steps: Range<usize>,
    settings: &SurfaceSettings,
    out: &Path,
    format: SurfaceFormat,
) -> Result<Vec<PathBuf>> {
    expect_steps(format)?;
    if is_in_one(out, format) {
        return Ok(settings.files(out));
    }
    let place = StepDigits::in_name(out)?;
    let of_step = |step: &StoredStep| settings.files(&place.name(step.number()));
    let mut files: Vec<PathBuf> = archive.manifest.steps[steps].iter().flat_map(of_step).collect();
    files.extend(settings.files(&place.list(format)));
    Ok(files)
}

/// Writes isosurfaces of many steps: see
/// [`SurfaceQuery::write`](crate::pipeline::SurfaceQuery::write).
pub(in crate::pipeline) fn write_series(
    archive: &Arc<OpenArchive>,
    steps: Range<usize>,
    settings: &SurfaceSettings,
    out: &Path,
    format: SurfaceFormat,
    progress: &dyn Progress,
) -> Result<SeriesReport> {
    settings.check()?;
    settings.check_colours(format)?;
    expect_steps(format)?;
    if is_in_one(out, format) {
        return write_in_one(archive, steps, settings, out, progress);
    }
    let place = StepDigits::in_name(out)?;
    let scratch = settings.scratch_of(out);
    let mut made: Vec<StepSurfaces> = vec![];
    let mut write = |archive: &StepView, surfaces| {
        let (step, time) = (archive.step().number(), archive.step().time_or_number());
        let (report, surfaces) = write_made(archive, settings, surfaces, &place.name(step), format)?;
        made.push(StepSurfaces { step, time, skipped: !settings.can_answer(archive), report });
        Ok(surfaces.into_iter().map(|s| s.surface.into_memory()).collect())
    };
    for_each_step(archive, steps, settings, &scratch, progress, &mut write)?;
    let lists = if is_each_alone(out) { settings.isovalues.len() } else { 1 };
    let mut listed_before = 0;
    let mut list = |n: usize| {
        let mut files: Vec<(f64, PathBuf)> =
            made.iter().map(|s| (s.time, s.report.surfaces[n].file.clone())).collect();
        let name = file_of(&place.list(format), settings.isovalues[n]);
        let before = listed_before_in(&name, &files);
        listed_before += before.len() as u64;
        files.extend(before);
        files.sort_by(|a, b| a.0.total_cmp(&b.0));
        write_list(&name, &files)?;
        Ok(name)
    };
    let lists = (0..lists).map(&mut list).collect::<Result<_>>()?;
    let skipped = made.iter().filter(|s| s.skipped).count() as u64;
    Ok(SeriesReport { skipped, steps: made, lists, listed_before, file_bytes: None })
}

/// Refuses a format that has no steps.
fn expect_steps(format: SurfaceFormat) -> Result<()> {
    if format.is_folder() {
        return Err(Error::usage(
            "meshes of neuroglancer have no steps: write them of one step, or write .vtkhdf, .vtp or .glb",
        ));
    }
    Ok(())
}

/// Whether all steps go to one file: VTKHDF, whose name has no place for a number.
fn is_in_one(out: &Path, format: SurfaceFormat) -> bool {
    format == SurfaceFormat::VtkHdf && StepDigits::in_name(out).is_err()
}

/// The other files that a list names and that are still there, with their times. What is no list
/// names none: it is replaced.
fn listed_before_in(list: &Path, new: &[(f64, PathBuf)]) -> Vec<(f64, PathBuf)> {
    let named = listed_files(list).unwrap_or_default();
    let is_other = |file: &Path| new.iter().all(|(_, path)| path.file_name() != file.file_name());
    let is_beside = |file: &Path| folder_of(file) == folder_of(list) && file.is_file();
    let found = named.into_iter().filter(|(file, _)| is_beside(file) && is_other(file));
    found.filter_map(|(file, time)| Some((time?, file))).collect()
}

/// What is done with the surfaces of a step, given its number and time.
pub(super) type EachStep<'a> = dyn FnMut(u64, f64, &mut Vec<TriMesh>) -> Result<()> + 'a;

/// Hands out the isosurfaces of many steps, in memory: the number and the time of each, and its
/// surfaces. Memory of surfaces that is not taken is reused for later steps.
pub(in crate::pipeline) fn surfaces_of_steps(
    archive: &Arc<OpenArchive>,
    steps: Range<usize>,
    settings: &SurfaceSettings,
    progress: &dyn Progress,
    each: &mut EachStep<'_>,
) -> Result<()> {
    settings.check()?;
    let scratch = settings.resources.scratch.clone().unwrap_or_else(std::env::temp_dir);
    let mut hand_out = |archive: &StepView, made: FinishedSurfaces| {
        let step = archive.step();
        let surfaces = made.surfaces.into_iter().map(|found| found.into_mesh(archive));
        let mut surfaces = surfaces.collect::<Result<Vec<_>>>()?;
        each(step.number(), step.time_or_number(), &mut surfaces)?;
        Ok(surfaces)
    };
    for_each_step(archive, steps, settings, &scratch, progress, &mut hand_out)
}

/// Where the number of a step is in a file's name: `before`, digits, `after`.
struct StepDigits {
    folder: PathBuf,
    before: String,
    after: String,
    digits: usize,
}

impl StepDigits {
    fn in_name(out: &Path) -> Result<Self> {
        let name = out.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        let found = name.match_indices('%').find_map(|(at, _)| {
            let rest = &name[at + 1..];
            let d = rest.find(|c: char| !c.is_ascii_digit())?;
            // As in C: %d, %4d and %04d; blanks do not belong into names.
            let digits = if d == 0 { 0 } else { rest[..d].parse().ok().filter(|n| *n <= 20)? };
            rest[d..].starts_with('d').then(|| (name[..at].to_owned(), digits, rest[d + 1..].to_owned()))
        });
        let (before, digits, after) = found.ok_or_else(|| {
            Error::usage(format!(
                "{}: of several steps, the name of the file has a place for the step's number, as in out_%04d.ply; \
                 .vtkhdf alone has all of them in one file",
                out.display()
            ))
        })?;
        Ok(Self { folder: out.parent().unwrap_or(Path::new("")).to_path_buf(), before, after, digits })
    }

    fn name(&self, step: u64) -> PathBuf {
        self.folder.join(format!("{}{step:0width$}{}", self.before, self.after, width = self.digits))
    }

    /// The name of the list: without the number, and what joins it to the rest.
    fn list(&self, format: SurfaceFormat) -> PathBuf {
        let before = self.before.trim_end_matches(['_', '-', '.', ' ']);
        let after =
            if before.is_empty() { self.after.trim_start_matches(['_', '-', ' ']) } else { &self.after };
        let name = format!("{before}{after}");
        let name = if name.starts_with('.') { format!("surface{name}") } else { name };
        let file = self.folder.join(name);
        match format {
            SurfaceFormat::Vtp => file.with_extension("pvd"),
            _ => {
                let mut name = file.into_os_string();
                name.push(".series");
                name.into()
            }
        }
    }
}

/// Writes a list of files that lie next to it.
fn write_list(list: &Path, files: &[(f64, PathBuf)]) -> Result<()> {
    let name = |p: &Path| p.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let text = if list.extension().is_some_and(|e| e == "pvd") {
        let mut text = String::from(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\" byte_order=\"LittleEndian\">\n  <Collection>\n",
        );
        for (time, file) in files {
            let name = name(file);
            let file = quick_xml::escape::escape(&*name);
            let _ =
                writeln!(text, "    <DataSet timestep=\"{time}\" group=\"\" part=\"0\" file=\"{file}\"/>");
        }
        text + "  </Collection>\n</VTKFile>\n"
    } else {
        let files: Vec<_> = files
            .iter()
            .map(|(time, file)| serde_json::json!({ "name": name(file), "time": time }))
            .collect();
        let list = serde_json::json!({ "file-series-version": "1.0", "files": files });
        format!("{list:#}\n")
    };
    let mut out = Unpublished::create(list)?;
    out.write(text.as_bytes())?;
    out.publish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_a_place_for_the_number() {
        let of = |name: &str, format| {
            let place = StepDigits::in_name(Path::new(name)).unwrap();
            (place.name(7).display().to_string(), place.list(format).display().to_string())
        };
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        assert_eq!(of("a/out_%04d.ply", SurfaceFormat::Ply), pair("a/out_0007.ply", "a/out.ply.series"));
        assert_eq!(of("out%d.vtp", SurfaceFormat::Vtp), pair("out7.vtp", "out.pvd"));
        assert_eq!(of("%03d_{}.vtp", SurfaceFormat::Vtp), pair("007_{}.vtp", "{}.pvd"));
        assert_eq!(of("%d.stl", SurfaceFormat::Stl), pair("7.stl", "surface.stl.series"));
        assert_eq!(of("50%_%2d.obj", SurfaceFormat::Obj).0, "50%_07.obj");
        for bad in ["out.ply", "out_%.ply", "out_%s.ply", "%99d.ply"] {
            assert_eq!(StepDigits::in_name(Path::new(bad)).err().unwrap().exit_code(), 2, "{bad}");
        }
    }
}
