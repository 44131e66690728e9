//! What is at the path of an archive before it is made: [`Existing`], found once, at the door: when
//! a command starts.
//!
//! ```text
//!                at the door                     with the plan
//!  Nothing       make it                         Begun
//!  Unfinished    go on                           Begun, or another's work: refuse, or empty (replace)
//!  Finished      may it be this one? else        Complete: nothing to do; Begun: files are lost;
//!                refuse, or replace (replace)    else refuse, or replace (replace)
//!  Foreign       refuse
//! ```
//!
//! Lost files of a finished archive are made again, the others stay. Meanwhile the manifest stays
//! in place, since it shows that this is the same reduction. An equal one replaces it in the end.

use super::job::Job;
use super::plan_file::{new_archive, old_archive, work_folder};
use crate::archive::lock::WriterLock;
use crate::archive::manifest::{
    MANIFEST_NAME, Manifest, StoredStep, coarse_path, coordinates_path, index_path, is_coordinates,
    mesh_folder, mesh_segment_path, ranges_segment_path, spectrum_path, steps_folder, values_segment_path,
};
use crate::archive::segment::{PlanHash, SegmentInfo, segment_plan};
use crate::pipeline::plan::{Attachments, Layout, Plan};
use crate::pipeline::settings::RunSettings;
use isospan_io::bytes::publish::{self, TEMPORARY_MARK};
use isospan_io::bytes::remote::is_remote;
use isospan_io::error::{Error, Result};
use isospan_io::formats::StepSource;
use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The segments that the manifest of an archive names.
pub(super) fn segments(archive: &Path, manifest: &Manifest) -> Vec<(PathBuf, SegmentInfo)> {
    let mesh = (0..).zip(&manifest.mesh).map(|(n, s)| (mesh_segment_path(archive, n), s.info));
    let of_step = |step: &StoredStep| {
        let number = step.plan.number;
        let values = (0..).zip(&step.values);
        let values = values.map(|(n, s)| (values_segment_path(archive, number, n), s.info));
        let ranges = (0..).zip(&step.ranges);
        let ranges = ranges.map(|(n, s)| (ranges_segment_path(archive, number, n), s.info));
        let others = [
            step.coarse.map(|i| (coarse_path(archive, number), i)),
            step.index.map(|i| (index_path(archive, number), i)),
            step.spectrum.map(|i| (spectrum_path(archive, number), i)),
            step.coordinates.map(|c| (coordinates_path(archive, number), c.info)),
        ];
        values.chain(ranges).chain(others.into_iter().flatten()).collect::<Vec<_>>()
    };
    mesh.chain(manifest.all_steps().flat_map(of_step)).collect()
}

/// The files of an archive in a folder, by their names in it, the manifest last.
///
/// # Errors
/// [`Error::BadInput`] when there is no archive, or its manifest is damaged.
pub fn archive_files(archive: &Path) -> Result<Vec<PathBuf>> {
    let manifest = Manifest::read(archive)?;
    let named = segments(archive, &manifest).into_iter().map(|(path, _)| path);
    let files = named.chain(Attachments::files(archive, &manifest.plan)).chain([archive.join(MANIFEST_NAME)]);
    Ok(files
        .map(|file| file.strip_prefix(archive).map_or_else(|_| file.clone(), Path::to_path_buf))
        .collect())
}

/// Whether a file that the manifest of an archive names is not there, or not as long as it was. The
/// contents of files are not checked.
pub(super) fn lacks_files(archive: &Path, manifest: &Manifest) -> bool {
    !lost_files(archive, manifest).is_empty()
}

/// The files that a manifest names, and that are not there or not as long as they were.
fn lost_files(archive: &Path, manifest: &Manifest) -> Vec<PathBuf> {
    let gone = |(path, info): &(PathBuf, SegmentInfo)| {
        fs::metadata(path).map_or(true, |f| !f.is_file() || f.len() != info.bytes)
    };
    let lost = segments(archive, manifest).into_iter().filter(gone).map(|(path, _)| path);
    lost.chain(Attachments::missing(archive, &manifest.plan)).collect()
}

/// Refuses an archive that has lost files: what is added to it would have no use.
///
/// # Errors
/// [`Error::Incomplete`] that names the files.
pub(super) fn expect_files(archive: &Path, manifest: &Manifest) -> Result<()> {
    let lost = lost_files(archive, manifest);
    if lost.is_empty() {
        return Ok(());
    }
    let name = |path: &PathBuf| path.strip_prefix(archive).unwrap_or(path).display().to_string();
    Err(Error::Incomplete { path: archive.to_path_buf(), missing: lost.iter().map(name).collect() })
}

/// Folders that a reduction may make: those that were not there before it.
pub(super) struct NewFolders(Vec<PathBuf>);

impl NewFolders {
    /// Looks before the first of them is made.
    pub(super) fn of(out: &Path) -> Self {
        let work = work_folder(out);
        let archives = [new_archive(out), out.to_path_buf()];
        let inner = |archive: PathBuf| [mesh_folder(&archive), steps_folder(&archive), archive];
        let all = archives.into_iter().flat_map(inner).chain([work]);
        Self(all.filter(|folder| fs::symlink_metadata(folder).is_err()).collect())
    }

    /// Removes those of them that are empty.
    pub(super) fn remove_empty(&self) {
        for folder in &self.0 {
            // One with a file in it stays: the same call goes on with that.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Files of an archive that its manifest does not name, in order of their names. Temporary files,
/// which may belong to a running process, are left out.
///
/// # Errors
/// When a folder cannot be listed.
pub(in crate::pipeline) fn strays(archive: &Path, manifest: &Manifest) -> Result<Vec<PathBuf>> {
    let named: HashSet<PathBuf> = segments(archive, manifest)
        .into_iter()
        .map(|(path, _)| path)
        .chain(Attachments::files(archive, &manifest.plan))
        .collect();
    let mut strays = vec![];
    for folder in [mesh_folder(archive), steps_folder(archive)] {
        let list = |e| Error::io("list", &folder, e);
        let entries = match fs::read_dir(&folder) {
            // A copy of an archive whose mesh is not stored may lack the folder.
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => continue,
            entries => entries.map_err(list)?,
        };
        for entry in entries {
            let path = entry.map_err(list)?.path();
            if !publish::is_temporary(&path) && !named.contains(&path) {
                strays.push(path);
            }
        }
    }
    strays.sort();
    Ok(strays)
}

/// Removes the strays that have the names of segments, but for those that the archive had `before`.
/// The archive's writer calls this while it holds the lock. Files of another, unfinished `append`
/// are among them. A failure costs only disk space.
pub(super) fn remove_strays(archive: &Path, manifest: &Manifest, before: Option<&Manifest>) {
    let before = before.map_or(vec![], |before| segments(archive, before));
    let was_there = |path: &PathBuf| before.iter().any(|(named, _)| named == path);
    let segments =
        |path: &PathBuf| path.extension().is_some_and(|e| e == "seg") && path.is_file() && !was_there(path);
    for path in strays(archive, manifest).unwrap_or_default().iter().filter(|path| segments(path)) {
        let _ = fs::remove_file(path);
    }
}

/// A segment in the folder of an unfinished archive, or the beginning of one, that is not of this
/// plan: the work of another run. `None` where there is none, and where the archive is finished.
fn other_work(archive: &Path, plan: &Plan, keep_going: bool) -> Option<PathBuf> {
    let mesh = plan.mesh_hash();
    let steps: HashSet<PlanHash> = (0..plan.steps.len()).map(|n| plan.step_hash(n)).collect();
    let is_other = |path: &PathBuf, own: &dyn Fn(PlanHash) -> bool| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // A copy of coordinates is made anew in little time.
        !is_coordinates(&name) && segment_plan(path).is_some_and(|plan| !own(plan))
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

/// What is at the path of an archive before it is made.
pub(in crate::pipeline) enum Existing {
    /// No file, or an empty folder.
    Nothing,
    /// Files of an archive without a manifest: the work of a run that did not end.
    Unfinished,
    /// An archive.
    Finished(Box<Manifest>),
    /// An archive whose manifest cannot be read.
    Damaged,
    /// A folder that holds other files, too.
    Foreign,
}

impl Existing {
    /// Looks at the folder of an archive.
    ///
    /// # Errors
    /// [`Error::Usage`] for a name that no archive has, for a file, and for a place on a server.
    pub(in crate::pipeline) fn at(out: &Path) -> Result<Self> {
        refuse_name(out)?;
        match fs::metadata(out) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Self::Nothing),
            Err(e) => return Err(Error::io("look at", out, e)),
            Ok(_) => {}
        }
        let ours = ["mesh", "steps", MANIFEST_NAME];
        let mut is_empty = true;
        for entry in fs::read_dir(out).map_err(|e| Error::io("list", out, e))? {
            let name = entry.map_err(|e| Error::io("list", out, e))?.file_name();
            let name = name.to_string_lossy();
            if !ours.contains(&&*name) && !name.contains(TEMPORARY_MARK) {
                return Ok(Self::Foreign);
            }
            is_empty = false;
        }
        if !out.join(MANIFEST_NAME).exists() {
            return Ok(if is_empty { Self::Nothing } else { Self::Unfinished });
        }
        Ok(Manifest::read(out).map_or(Self::Damaged, |manifest| Self::Finished(Box::new(manifest))))
    }

    /// Whether there is an archive with a manifest.
    pub(in crate::pipeline) fn is_finished(&self) -> bool {
        matches!(self, Self::Finished(_) | Self::Damaged)
    }

    /// Refuses a place where nothing may be written, `replace` or not.
    ///
    /// # Errors
    /// [`Error::Usage`] that says why.
    pub(in crate::pipeline) fn refuse_overwriting(&self, out: &Path, replace: bool) -> Result<()> {
        match self {
            Self::Foreign => Err(foreign(out)),
            Self::Finished(_) | Self::Damaged if !replace => Err(exists(out)),
            _ if replace => refuse_strangers(out),
            _ => Ok(()),
        }
    }

    /// As [`Existing::refuse_overwriting`], but lets an archive pass that may be the one of the
    /// job.
    pub(super) fn refuse_other(&self, job: &Job<'_>) -> Result<()> {
        match self {
            Self::Finished(manifest) if may_be_of(job, manifest) => Ok(()),
            other => other.refuse_overwriting(job.out, job.run.replace),
        }
    }

    /// Compares what there is with the plan of an archive.
    ///
    /// # Errors
    /// [`Error::Usage`] when it is something else that is not to be replaced.
    pub(in crate::pipeline) fn compare(&self, out: &Path, plan: &Plan, run: &RunSettings) -> Result<State> {
        let refused = match self {
            Self::Nothing => return Ok(State::Begun),
            Self::Finished(manifest) if plan.is_of(manifest) => {
                let is_complete = !lacks_files(out, manifest);
                return Ok(if is_complete { State::Complete(manifest.clone()) } else { State::Begun });
            }
            // Its files stay, and a manifest with other units takes the place of its own.
            Self::Finished(manifest) if plan.is_but_for_units(manifest) => return Ok(State::Begun),
            Self::Finished(manifest) if lacks_files(out, manifest) => {
                let text = "lacks files, and was not made by this reduction alone; \
                            choose another name, or `replace=true` to replace it";
                Error::usage(format!("{} {text}", out.display()))
            }
            Self::Finished(_) | Self::Damaged => exists(out),
            Self::Unfinished => match other_work(out, plan, run.keep_going) {
                Some(file) => is_unfinished(out, &file),
                None => return Ok(State::Begun),
            },
            Self::Foreign => return Err(foreign(out)),
        };
        if run.replace { Ok(State::Other) } else { Err(refused) }
    }
}

/// How far the archive of a plan is.
pub(in crate::pipeline) enum State {
    /// It is there, and lacks no file.
    Complete(Box<Manifest>),
    /// Nothing, or some of its files.
    Begun,
    /// Files of something else, which is to be replaced.
    Other,
}

impl State {
    /// Empties the folder where it has files of something else.
    pub(in crate::pipeline) fn make_place(&self, layout: &Layout) -> Result<()> {
        let Self::Other = self else { return Ok(()) };
        refuse_strangers(layout.root())?;
        // First the manifest: from then on it is no archive.
        let manifest = layout.root().join(MANIFEST_NAME);
        match fs::remove_file(&manifest) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                return Err(Error::io("remove", &manifest, e));
            }
            _ => {}
        }
        [layout.mesh_folder(), layout.steps_folder()].iter().try_for_each(|f| publish::remove_folder(f))
    }
}

/// Locks an archive that is to be written. One that a killed run was replacing is there again.
pub(in crate::pipeline) fn lock_for_writing(out: &Path) -> Result<WriterLock> {
    refuse_name(out)?;
    let lock = WriterLock::acquire(out)?;
    let work = work_folder(out);
    if fs::symlink_metadata(&work).is_ok_and(|about| !about.is_dir()) {
        let text = "is no folder, but the name of one in which isospan works: move it away";
        return Err(Error::usage(format!("{} {text}", work.display())));
    }
    publish::restore_folder(out, &old_archive(out))?;
    Ok(lock)
}

/// Puts a new archive in the place of the one of its name, which was whole until then.
pub(in crate::pipeline) fn replace_archive(new: &Path, out: &Path) -> Result<()> {
    refuse_strangers(out)?;
    publish::replace_folder(new, out, &old_archive(out))?;
    // There may be a plan, or logs.
    let _ = fs::remove_dir(work_folder(out));
    Ok(())
}

/// Refuses to remove an archive whose folders hold what no archive has: a user's files. Those
/// beside the folders are found by [`Existing::at`].
fn refuse_strangers(out: &Path) -> Result<()> {
    let refuse = |path: &Path| {
        let (out, path) = (out.display(), path.display());
        Err(Error::usage(format!("cannot replace {out}: {path} is no file of an archive; move it away")))
    };
    for folder in [mesh_folder(out), steps_folder(out)] {
        let list = |e| Error::io("list", &folder, e);
        match fs::symlink_metadata(&folder) {
            Ok(about) if !about.is_dir() => return refuse(&folder),
            Ok(_) => {}
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => continue,
            Err(e) => return Err(list(e)),
        }
        for entry in fs::read_dir(&folder).map_err(list)? {
            let entry = entry.map_err(list)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let is_called = name.ends_with(".seg") || name.contains(TEMPORARY_MARK);
            if !is_called || entry.file_type().map_err(list)?.is_dir() {
                return refuse(&entry.path());
            }
        }
    }
    Ok(())
}

/// Removes what earlier runs that were killed have left.
pub(in crate::pipeline) fn sweep(layout: &Layout) {
    let folders = [layout.root().to_path_buf(), layout.mesh_folder(), layout.steps_folder()];
    folders.iter().for_each(|folder| publish::sweep(folder));
}

/// Refuses a name that no archive has, files, and servers, which are read only.
fn refuse_name(out: &Path) -> Result<()> {
    let refused = |text: &str| Err(Error::usage(format!("{}: {text}", out.display())));
    if is_remote(out) {
        return refused("archives are written on disk; copy the folder to the server afterwards");
    }
    if out.extension().is_none_or(|e| e != "isospan") {
        return refused("an archive's name ends in .isospan");
    }
    if fs::metadata(out).is_ok_and(|about| !about.is_dir()) {
        return refused("exists and is not an archive; choose another name");
    }
    Ok(())
}

/// Whether a finished archive, or one that has lost files, may be that of a job. Its plan decides
/// later.
///
/// Planning may read all samples, or a mesh. So an archive with other settings, or from a file of
/// another name, is recognized without it. The result that meets a target is searched for again
/// each time.
fn may_be_of(job: &Job<'_>, manifest: &Manifest) -> bool {
    let (settings, steps) = (job.settings, job.sources);
    let first = manifest.steps.first().map(|step| &step.plan);
    let name = |step: &StepSource| step.path.file_name().map(|name| name.to_string_lossy().into_owned());
    let is_alike = manifest.steps.len() <= steps.len()
        && manifest.plan.levels.is_some() == settings.adapt.is_some()
        && settings.value_bits == first.and_then(|plan| plan.quantiser).map(|q| q.bits)
        && steps.iter().any(|(_, step)| name(step).as_ref() == first.map(|plan| &plan.source.path));
    // An archive that meets a target names it; the settings do not give its number of points.
    match settings.target.filter(|target| !target.is_met_by_corrections(settings)) {
        Some(_) => manifest.target == Some(settings.hash()),
        None => is_alike || lacks_files(job.out, manifest),
    }
}

/// There is unfinished work of something else; `file` is a file of it.
fn is_unfinished(out: &Path, file: &Path) -> Error {
    let file = file.strip_prefix(out).unwrap_or(file).display();
    Error::usage(format!(
        "{} holds the unfinished work of another input, or of other settings ({file}): \
         continue that, choose another name, or `replace=true` to start anew",
        out.display()
    ))
}

/// There is a folder of this name that is no archive.
fn foreign(out: &Path) -> Error {
    Error::usage(format!("{} exists and holds other files; choose another name", out.display()))
}

/// There is something of this name.
pub(super) fn exists(out: &Path) -> Error {
    Error::usage(format!("{} exists; choose another name, or `replace=true` to replace it", out.display()))
}
