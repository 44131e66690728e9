//! A finished archive whose reduction is asked for again: the run was killed after all was done, or
//! files got lost.
//!
//! If nothing is missing, nothing is done. Lost files are made again, the others stay. Meanwhile
//! the manifest stays in place, since it shows that this is the same reduction. An equal one
//! replaces it in the end.

use crate::archive::manifest::{
    MANIFEST_NAME, Manifest, Step, coordinates_path, index_path, is_coordinates, mesh_folder,
    mesh_segment_path, spectrum_path, steps_folder, unpacked_path, unpacked_step, values_segment_path,
};
use crate::archive::publish;
use crate::archive::segment::{PlanHash, segment_plan};
use crate::error::{Error, Result};
use crate::formats::StepSource;
use crate::pipeline::plan::{Attachments, Plan};
use crate::pipeline::settings::{ReduceSettings, ValueBits};
use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The segments that the manifest of an archive names, and their lengths.
fn segments(archive: &Path, manifest: &Manifest) -> Vec<(PathBuf, u64)> {
    let mesh = (0..).zip(&manifest.mesh).map(|(n, s)| (mesh_segment_path(archive, n), s.info.bytes));
    let of_step = |step: &Step| {
        let number = step.plan.number;
        let values = (0..).zip(&step.values);
        let values = values.map(|(n, s)| (values_segment_path(archive, number, n), s.info.bytes));
        let others = [
            step.index.map(|i| (index_path(archive, number), i)),
            step.spectrum.map(|i| (spectrum_path(archive, number), i)),
            step.coordinates.map(|c| (coordinates_path(archive, number), c.info)),
        ];
        let others = others.into_iter().flatten().map(|(path, info)| (path, info.bytes));
        values.chain(others).collect::<Vec<_>>()
    };
    mesh.chain(manifest.steps.iter().flat_map(of_step)).collect()
}

/// Whether a file that the manifest of an archive names is not there, or not as long as it was. What a file holds is not looked at.
pub(super) fn lacks_files(archive: &Path, manifest: &Manifest) -> bool {
    let gone = |(path, bytes): &(PathBuf, u64)| fs::metadata(path).map_or(true, |f| f.len() != *bytes);
    segments(archive, manifest).iter().any(gone) || !Attachments::missing(archive, &manifest.plan).is_empty()
}

/// Files of an archive that its manifest does not name, in order of their names. Temporary files, which may
/// belong to a running process, and unpacked blocks of its steps are left out.
///
/// # Errors
/// When a folder cannot be listed.
pub(in crate::pipeline) fn strays(archive: &Path, manifest: &Manifest) -> Result<Vec<PathBuf>> {
    let named: HashSet<PathBuf> = segments(archive, manifest)
        .into_iter()
        .map(|(path, _)| path)
        .chain(Attachments::files(archive, &manifest.plan))
        .chain(manifest.steps.iter().map(|step| unpacked_path(archive, step.plan.number)))
        .collect();
    let mut strays = vec![];
    for folder in [mesh_folder(archive), steps_folder(archive)] {
        let list = |e| Error::io("list", &folder, e);
        for entry in fs::read_dir(&folder).map_err(list)? {
            let path = entry.map_err(list)?.path();
            if !publish::is_temporary(&path) && !named.contains(&path) {
                strays.push(path);
            }
        }
    }
    strays.sort();
    Ok(strays)
}

/// Removes those of them that have the names of segments: the archive's writer calls it, which holds its lock.
/// What another, unfinished `append` made is among them. A failure to do so costs disk space alone.
pub(super) fn remove_strays(archive: &Path, manifest: &Manifest) {
    let segments = |path: &PathBuf| path.extension().is_some_and(|e| e == "seg") && path.is_file();
    for path in strays(archive, manifest).unwrap_or_default().iter().filter(|path| segments(path)) {
        let _ = fs::remove_file(path);
    }
}

/// A segment in the folder of an unfinished archive, or the beginning of one, that is not of this plan: somebody
/// else's work. `None` where there is none, and where the archive is finished.
pub(super) fn other_work(archive: &Path, plan: &Plan, keep_going: bool) -> Option<PathBuf> {
    let mesh = plan.mesh_hash();
    let steps: HashSet<PlanHash> = (0..plan.steps.len()).map(|n| plan.step_hash(n)).collect();
    let is_other = |path: &PathBuf, own: &dyn Fn(PlanHash) -> bool| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // Both are copies, made anew in little time.
        let is_copy = unpacked_step(&name).is_some() || is_coordinates(&name);
        !is_copy && segment_plan(path).is_some_and(|plan| !own(plan))
    };
    let files = |folder: PathBuf| {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        files.sort();
        files
    };
    let in_mesh = files(mesh_folder(archive)).into_iter().find(|f| is_other(f, &|plan| plan == mesh));
    // A step that was left out has changed the hashes of those after it.
    let in_steps = || {
        let mut files = files(steps_folder(archive)).into_iter().filter(|_| !keep_going);
        files.find(|f| is_other(f, &|plan| steps.contains(&plan)))
    };
    in_mesh.or_else(in_steps)
}

/// Whether a manifest is that of a plan: the same mesh, the same steps.
pub(in crate::pipeline) fn is_of(manifest: &Manifest, mesh: PlanHash, plan: &Plan) -> bool {
    manifest.plan_hash == mesh && manifest.steps.iter().map(|s| &s.plan).eq(&plan.steps)
}

/// Whether a finished archive may be that of a reduction of these steps, or one that has lost files: its plan will tell. To plan may take reading all samples, or a mesh; so what has other
/// settings, or was made from a file of another name, is told from it without. What a target is met with is found anew each time.
pub(super) fn may_be_of(archive: &Path, steps: &[StepSource], settings: &ReduceSettings) -> bool {
    // An archive whose manifest cannot be read may be anything.
    let Ok(manifest) = Manifest::read(archive) else { return false };
    let first = manifest.steps.first().map(|step| &step.plan);
    let name = |step: &StepSource| step.path.file_name().map(|name| name.to_string_lossy().into_owned());
    let is_alike = manifest.steps.len() <= steps.len()
        && manifest.plan.levels.is_some() == settings.adapt.is_some()
        && match (settings.value_bits, first.and_then(|plan| plan.quantiser)) {
            (ValueBits::Usual, _) => true,
            (ValueBits::Exact, quantiser) => quantiser.is_none(),
            (ValueBits::Bits(bits), quantiser) => quantiser.is_some_and(|q| q.bits == bits),
        }
        && steps.iter().any(|step| name(step).as_ref() == first.map(|plan| &plan.source.path));
    // What a target is met with tells so; how many points it has is no matter of the settings.
    match settings.target {
        Some(_) => manifest.target == Some(settings.hash()),
        None => is_alike || lacks_files(archive, &manifest),
    }
}

/// The manifest, if there is one: of a finished archive of this very plan.
///
/// # Errors
/// [`Error::Usage`] when there is a finished archive of another plan, or with steps that were appended.
pub(super) fn finished(out: &Path, plan: &Plan) -> Result<Option<Manifest>> {
    if !out.join(MANIFEST_NAME).exists() {
        return Ok(None);
    }
    let manifest = Manifest::read(out)?;
    if is_of(&manifest, plan.mesh_hash(), plan) {
        return Ok(Some(manifest));
    }
    Err(if lacks_files(out, &manifest) {
        let text = "lacks files, and was not made by this reduction alone; choose another name, or --force to replace it";
        Error::usage(format!("{} {text}", out.display()))
    } else {
        exists(out)
    })
}

/// There is unfinished work of something else, of which this is a file.
pub(super) fn is_unfinished(out: &Path, file: &Path) -> Error {
    let file = file.strip_prefix(out).unwrap_or(file).display();
    Error::usage(format!(
        "{} holds the unfinished work of another input, or of other settings ({file}): continue that, choose another name, or --force to start anew",
        out.display()
    ))
}

/// There is something of this name.
pub(super) fn exists(out: &Path) -> Error {
    Error::usage(format!("{} exists; choose another name, or --force to replace it", out.display()))
}
