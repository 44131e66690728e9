//! The progress of a planned reduction. Every segment is checked, on several threads; nothing is
//! written.

use crate::archive::manifest::{MANIFEST_NAME, Manifest, mesh_folder, steps_folder};
use crate::archive::segment::{PlanHash, Segment, SegmentKind};
use crate::pipeline::plan::{Attachments, Layout, Shard};
use crate::pipeline::read::{Depth, SegmentState, inspect};
use crate::pipeline::reduce::{Existing, FinishedSteps, PlanFile, plan_path, strays, work_folder};
use crate::pipeline::settings::RunSettings;
use isospan_io::bytes::publish::{final_name, open_own};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{CancelToken, Progress, Resources, Silent, pool};
use rayon::prelude::*;
use serde::Serialize;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// A file that a plan asks for.
pub(super) struct PlannedFile {
    path: PathBuf,
    kind: SegmentKind,
    hash: PlanHash,
    chunks: Range<u64>,
}

/// A file that is not whole.
struct Fault {
    segment: u64,
    state: SegmentState,
    path: PathBuf,
}

/// The files that a plan asks for.
pub(super) struct Inventory<'a> {
    file: &'a PlanFile,
    layout: Layout,
    finished: FinishedSteps,
}

impl<'a> Inventory<'a> {
    pub(super) fn new(out: &Path, file: &'a PlanFile) -> Self {
        let layout = Layout::new(out, file.chunks, 0);
        Self { file, finished: FinishedSteps::of(&layout, &file.plan), layout }
    }

    pub(super) fn segments(&self) -> u64 {
        self.layout.segment_count()
    }

    /// The files of a segment.
    pub(super) fn files_of(&self, segment: u64) -> Vec<PlannedFile> {
        let (layout, file) = (&self.layout, self.file);
        let wanted = |path, kind, hash| PlannedFile { path, kind, hash, chunks: layout.chunks_of(segment) };
        let mut files = vec![];
        // A mesh that follows by formula is not stored.
        if file.plan.mesh.stores_mesh() {
            files.push(wanted(layout.mesh(segment), SegmentKind::Mesh, file.mesh_hash));
        }
        for step in &file.plan.steps {
            let (layout, hash) = (layout.at(step.number), step.hash(file.mesh_hash));
            files.push(wanted(layout.values(segment), SegmentKind::Values, hash));
            if file.plan.mesh.has_labels() {
                continue;
            }
            if file.plan.mesh.is_pyramid() {
                // Of the low coefficients the coarse levels are made.
                if Segment::open(layout.coarse(), SegmentKind::Coarse, Some(hash)).is_ok() {
                    continue;
                }
                files.push(wanted(layout.low(segment), SegmentKind::Low, hash));
            } else if self.finished.needs_sums(step) {
                files.push(wanted(layout.sums(segment), SegmentKind::Sums, hash));
            }
        }
        files
    }

    pub(super) fn look(&self, f: &PlannedFile, depth: Depth) -> SegmentState {
        inspect(&f.path, f.kind, f.hash, &f.chunks, depth)
    }

    /// The files of a segment that are not whole.
    fn faults(&self, segment: u64, depth: Depth) -> Vec<Fault> {
        let look = |f: PlannedFile| Fault { segment, state: self.look(&f, depth), path: f.path };
        self.files_of(segment).into_iter().map(look).filter(|f| f.state != SegmentState::Whole).collect()
    }

    /// The path of a file within the archive.
    fn name(&self, path: &Path) -> String {
        path.strip_prefix(self.layout.root()).unwrap_or(path).display().to_string()
    }

    /// All files that are not whole, in order of segments.
    fn all_faults(&self, depth: Depth, run: &RunSettings, progress: &dyn Progress) -> Result<Vec<Fault>> {
        progress.begin("verify", self.segments(), "segments");
        pool(run.resources.worker_threads())?.install(|| {
            let look = |segment| {
                run.resources.cancel.check()?;
                let faults = self.faults(segment, depth);
                progress.advance(1);
                Ok(faults)
            };
            let found: Result<Vec<_>> = (0..self.segments()).into_par_iter().map(look).collect();
            Ok(found?.into_iter().flatten().collect())
        })
    }

    /// # Errors
    /// [`Error::Incomplete`] when a segment is not whole.
    pub(super) fn expect_whole(&self, run: &RunSettings, progress: &dyn Progress) -> Result<()> {
        let mut faults = self.all_faults(Depth::All, run, progress)?;
        for path in Attachments::missing(self.layout.root(), &self.file.plan.mesh) {
            faults.push(Fault { segment: 0, state: SegmentState::Missing, path });
        }
        // One word for each, so that many fit into a line; `status` says more.
        let missing: Vec<String> =
            faults.iter().map(|f| format!("{} ({})", self.name(&f.path), f.state.name())).collect();
        if missing.is_empty() {
            return Ok(());
        }
        Err(Error::Incomplete { path: self.layout.root().to_path_buf(), missing })
    }
}

/// How far a planned reduction is.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct StatusReport {
    /// The archive.
    pub archive: PathBuf,
    /// Whether it is committed: there is a manifest.
    pub committed: bool,
    /// The number of the try that is planned, where a target is searched for: the first is 1.
    #[serde(rename = "try", skip_serializing_if = "Option::is_none")]
    pub try_number: Option<u32>,
    /// Segments of the plan.
    pub segments: u64,
    /// Those of them that are complete.
    pub done: u64,
    /// Shards that were asked about.
    pub shards: u64,
    /// Numbers of the shards with a segment that is not whole.
    pub missing_shards: Vec<u64>,
    /// What is not whole: a file each, and why.
    pub missing: Vec<String>,
    /// Files of writers that are at work, or were killed.
    pub temporaries: u64,
    /// Their bytes.
    pub temporary_bytes: u64,
}

/// See [`Shards::status`](super::Shards::status).
pub(super) fn shard_status(
    out: &Path,
    shards: Option<u64>,
    quick: bool,
    cancel: &CancelToken,
) -> Result<StatusReport> {
    let file = PlanFile::read(out)?;
    let root = file.root(out);
    let inventory = Inventory::new(&root, &file);
    let depth = if quick { Depth::Frame } else { Depth::All };
    let run = RunSettings {
        resources: Resources::default().with_memory(0).with_cancel(cancel.clone()),
        ..RunSettings::default()
    };
    let faults = inventory.all_faults(depth, &run, &Silent)?;
    let shards = shards.unwrap_or(file.shards).max(1);
    let shard_of = |f: &Fault| Shard::with_segment(f.segment, inventory.segments(), shards);
    let mut missing_shards: Vec<u64> = faults.iter().map(shard_of).collect();
    missing_shards.dedup();
    let left = leftovers(out)?;
    // A file of the name alone makes no archive: what it says does.
    let committed = root == out && out.join(MANIFEST_NAME).exists();
    if committed {
        let help = "the manifest is damaged: remove this file, then isospan work and commit make it again";
        Manifest::read(out).map_err(|e| e.with_help(help))?;
    }
    Ok(StatusReport {
        archive: out.to_path_buf(),
        committed,
        try_number: file.search.as_ref().map(|planned| planned.search.this_try()),
        segments: inventory.segments(),
        done: inventory.segments() - faults.chunk_by(|a, b| a.segment == b.segment).count() as u64,
        shards,
        missing_shards,
        missing: faults.iter().map(|f| format!("{} ({})", inventory.name(&f.path), f.state)).collect(),
        temporaries: left.len() as u64,
        temporary_bytes: left.iter().map(|f| f.bytes).sum(),
    })
}

/// What was removed.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct GcReport {
    /// Files.
    pub files: Vec<PathBuf>,
    /// Their bytes.
    pub bytes: u64,
}

/// Removes temporary files of an archive and of its plan that have not been written to for some
/// time, and that no process of this machine holds. Only files with names that a writer gives are
/// removed, in folders that an archive has. With `dry_run` they are only listed.
///
/// # Errors
/// [`Error::BadInput`] for a folder that is neither an archive, finished or not, nor has a plan,
/// and for a manifest or a plan that is none; when a folder cannot be listed or a file not removed.
pub fn collect_garbage(out: &Path, older_than: Duration, dry_run: bool) -> Result<GcReport> {
    let is_unfinished = || mesh_folder(out).is_dir() && matches!(Existing::at(out), Ok(Existing::Unfinished));
    // A file of the name alone makes no archive: what it says does.
    let (has_manifest, has_plan) = (out.join(MANIFEST_NAME).is_file(), plan_path(out).is_file());
    if has_manifest {
        Manifest::read(out)?;
    }
    if has_plan {
        PlanFile::read(out)?;
    }
    if !has_manifest && !has_plan && !is_unfinished() {
        let expected = "a folder made by isospan reduce or plan";
        let got = if out.exists() { "something else; nothing was removed" } else { "none" };
        return Err(Error::bad_input(out, "archive", expected, got));
    }
    let mut report = GcReport::default();
    let replaced = replaced_files(out, older_than)?;
    let left = leftovers(out)?.into_iter().filter(|f| f.age >= older_than && !is_held(&f.path));
    for file in left.chain(replaced) {
        if !dry_run {
            match fs::remove_file(&file.path) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                    return Err(Error::io("remove", &file.path, e));
                }
                _ => {}
            }
        }
        report.bytes += file.bytes;
        report.files.push(file.path);
    }
    Ok(report)
}

/// Segments of steps that others have replaced so long ago: an archive's manifest does not name
/// them, and steps that are still to be finished have higher numbers than any that it names.
fn replaced_files(out: &Path, older_than: Duration) -> Result<Vec<Leftover>> {
    let Ok(manifest) = Manifest::read(out) else { return Ok(vec![]) };
    let path = out.join(MANIFEST_NAME);
    let age = fs::metadata(&path).and_then(|about| about.modified());
    let age = age.map_err(|e| Error::io("look at", &path, e))?.elapsed().unwrap_or_default();
    if age < older_than {
        return Ok(vec![]);
    }
    let last = manifest.all_steps().map(|step| step.plan.number).max().unwrap_or(0);
    let is_replaced = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let number = name.split_once('-').and_then(|(number, _)| number.parse::<u64>().ok());
        path.parent() == Some(&*steps_folder(out))
            && name.ends_with(".seg")
            && number.is_some_and(|n| n <= last)
    };
    let found = strays(out, &manifest)?.into_iter().filter(is_replaced);
    found
        .map(|path| {
            let bytes = fs::symlink_metadata(&path).map_err(|e| Error::io("look at", &path, e))?.len();
            Ok(Leftover { path, bytes, age })
        })
        .collect()
}

/// Whether a writer on this machine (or on another, where the file system shows that) has the file
/// locked.
fn is_held(path: &Path) -> bool {
    open_own(path).is_some_and(|f| matches!(f.try_lock(), Err(fs::TryLockError::WouldBlock)))
}

struct Leftover {
    path: PathBuf,
    bytes: u64,
    age: Duration,
}

/// The folders that writers of an archive, of its plan, and of tries for a target use. Links to
/// folders are not followed.
fn folders_of(out: &Path) -> Result<Vec<PathBuf>> {
    let work = work_folder(out);
    let mut archives = vec![out.to_path_buf()];
    for entry in entries_of(&work)? {
        let is_archive = entry.path().extension().is_some_and(|e| e == "isospan");
        if is_archive && entry.file_type().is_ok_and(|t| t.is_dir()) {
            archives.push(entry.path());
        }
    }
    let is_folder = |path: &PathBuf| fs::symlink_metadata(path).is_ok_and(|about| about.is_dir());
    let inner = archives.iter().flat_map(|a| [mesh_folder(a), steps_folder(a)]).filter(is_folder);
    let inner: Vec<PathBuf> = inner.collect();
    Ok(archives.into_iter().chain([work]).chain(inner).collect())
}

/// The entries of a folder; none of one that is not there.
fn entries_of(folder: &Path) -> Result<Vec<fs::DirEntry>> {
    let list = |e| Error::io("list", folder, e);
    match fs::read_dir(folder) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(vec![]),
        entries => entries.map_err(list)?.map(|entry| entry.map_err(list)).collect(),
    }
}

/// All temporaries of an archive and of its plan, in order of their paths.
fn leftovers(out: &Path) -> Result<Vec<Leftover>> {
    let (mut found, now) = (vec![], SystemTime::now());
    for folder in folders_of(out)? {
        for entry in entries_of(&folder)? {
            let name = entry.file_name().to_string_lossy().into_owned();
            let ours = final_name(&name).is_some_and(|n| MADE.iter().any(|e| n.ends_with(e)));
            // Published or removed meanwhile: no leftover.
            let Ok(about) = entry.metadata() else { continue };
            if ours && about.is_file() {
                let age = about.modified().ok().and_then(|m| now.duration_since(m).ok()).unwrap_or_default();
                found.push(Leftover { path: entry.path(), bytes: about.len(), age });
            }
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(found)
}

/// How the names of the files end that writers make: segments, their journals, manifests and plans.
const MADE: [&str; 3] = [".seg", ".seg.chunks", ".json"];
