//! The plan of a reduction as a file, for work that is spread over processes and machines.
//!
//! ```text
//!  tooth.isospan/               the archive: segments as they are done, in the end the manifest
//!  tooth.isospan.work/          what makes it, and is no part of it
//!      plan.json                this file
//!      new.isospan/             the archive, where it replaces a finished one (replace)
//!      planned-1.isospan/ …     a try, where a target is searched for
//!      slurm/                   job scripts and logs, where Slurm runs it
//! ```
//!
//! It holds the paths of the steps, the settings, and the [`Plan`] that follows from both, whose
//! hashes every segment carries. A worker makes the plan again from the input that it finds and
//! refuses to work when the two differ: then the input has changed, or is another. It also refuses
//! a plan of another version of the program, because versions may write different bytes.
//!
//! The file also records the lengths and times of change of the input files. A worker that finds
//! the same ones need not read the whole input to hash it.
//!
//! The file is written once and never changed: JSON, its last member a checksum of all bytes before
//! it, as in a manifest.
//!
//! A target takes several tries, and each is a plan of its own, one after another:
//!
//! ```text
//!  plan of a target ─▶ plan.json (try 1) ─▶ work ─▶ commit ─▶ plan.json (try 2) ─▶ work ─▶ …
//!                                                      └─ the last one publishes the best try
//! ```
//!
//! A try is made in `planned-1.isospan`, `planned-2.isospan`, … in the same folder. So a worker
//! that is late writes nothing into the next try.

use super::order::Order;
use super::report::ReduceReport;
use super::search::TargetSearch;
use super::series::{PlannedSource, SeriesPlan, SkippedStep};
use crate::archive::manifest::{Manifest, check_sum, sealed_text};
use crate::archive::segment::PlanHash;
use crate::pipeline::plan::{Attachments, Inputs, Plan, RecordedFile, Watch};
use crate::pipeline::settings::{CompleteSettings, FieldValue, RunSettings};
use isospan_io::bytes::publish::Unpublished;
use isospan_io::bytes::{place, read_whole};
use isospan_io::error::{Error, Result};
use isospan_io::formats::{Input, OpenOptions, StepSource};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

const FORMAT: &str = "isospan plan";
const FORMAT_VERSION: u16 = 4;
/// The most bytes of a plan: paths, settings, and a record for each step.
const LARGEST_PLAN: u64 = 1 << 28;
/// How the names of planned tries begin.
pub(in crate::pipeline) const PLANNED_TRY: &str = "planned-";
const HELP: &str = "the plan was damaged or edited: make it again with isospan plan `replace=true`";

/// The folder of a plan, its job scripts and logs, next to the archive.
pub fn work_folder(archive: &Path) -> PathBuf {
    let mut name = archive.as_os_str().to_owned();
    name.push(".work");
    name.into()
}

/// Where an archive is made that is to replace a finished one.
pub(super) fn new_archive(archive: &Path) -> PathBuf {
    work_folder(archive).join("new.isospan")
}

/// Where the one that was replaced is until it is removed.
pub(super) fn old_archive(archive: &Path) -> PathBuf {
    work_folder(archive).join("old.isospan")
}

/// Where a try of a planned search for a target is made.
pub(in crate::pipeline) fn planned_try(archive: &Path, number: u32) -> PathBuf {
    work_folder(archive).join(format!("{PLANNED_TRY}{number}.isospan"))
}

/// Path of the plan of an archive.
pub fn plan_path(archive: &Path) -> PathBuf {
    work_folder(archive).join("plan.json")
}

/// The plan as workers read it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::pipeline) struct PlanFile {
    format: String,
    format_version: u16,
    isospan_version: String,
    /// Where each step of the plan comes from; paths are absolute.
    sources: Vec<StepSource>,
    /// The files of all steps, by ascending paths.
    pub(super) files: Vec<RecordedFile>,
    /// Steps that could not be used when the plan was made.
    skipped: Vec<SkippedStep>,
    pub(in crate::pipeline) settings: CompleteSettings,
    /// Whose surfaces are measured when the archive is there.
    pub(in crate::pipeline) isovalues: Vec<FieldValue>,
    pub(in crate::pipeline) plan: Plan,
    pub(in crate::pipeline) mesh_hash: PlanHash,
    pub(in crate::pipeline) steps_hash: PlanHash,
    pub(in crate::pipeline) chunks: u64,
    /// Shards that work is meant to be cut into.
    pub(in crate::pipeline) shards: u64,
    /// The least memory of a worker.
    pub(in crate::pipeline) memory_least: u64,
    /// Whether a finished archive was there, which stays until this one is committed.
    pub(in crate::pipeline) replaces: bool,
    /// The search of which this plan is a try.
    pub(in crate::pipeline) search: Option<PlannedSearch>,
}

/// A search for a target, a plan for each try.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::pipeline) struct PlannedSearch {
    /// How far it is.
    pub(in crate::pipeline) search: TargetSearch,
    /// Shards that were asked for.
    pub(in crate::pipeline) shards: u64,
    /// Points of this try that are no samples of the boundary, or that a mesh was asked for.
    pub(in crate::pipeline) inner_points: u64,
}

impl PlannedSearch {
    /// A search whose next try is planned, as its report says so far.
    pub(in crate::pipeline) fn new(search: TargetSearch, shards: u64, planned: &ReduceReport) -> Self {
        Self { search, shards, inner_points: planned.inner_points }
    }
}

/// How the work is cut.
pub(in crate::pipeline) struct Cut {
    pub(in crate::pipeline) chunks: u64,
    pub(in crate::pipeline) shards: u64,
    pub(in crate::pipeline) memory_least: u64,
    /// Whether it replaces a finished archive.
    pub(in crate::pipeline) replaces: bool,
    /// The search of which it is a try.
    pub(in crate::pipeline) search: Option<PlannedSearch>,
    /// Whose surfaces are measured when the archive is there.
    pub(in crate::pipeline) isovalues: Vec<FieldValue>,
}

impl PlanFile {
    /// The plan of a series, whose sources are at any paths.
    pub(in crate::pipeline) fn new(
        settings: &CompleteSettings,
        series: &SeriesPlan,
        cut: Cut,
    ) -> Result<Self> {
        if settings.missing.is_some_and(|m| !m.is_finite()) {
            return Err(Error::usage("`missing` of a plan is a finite number; NaN is always missing"));
        }
        let SeriesPlan { plan, sources, skipped, watch, .. } = series;
        watch.check()?;
        let sources = sources.iter().map(|s| with_absolute_paths(&s.source)).collect::<Result<_>>()?;
        Ok(Self {
            format: FORMAT.into(),
            format_version: FORMAT_VERSION,
            isospan_version: env!("CARGO_PKG_VERSION").into(),
            sources,
            files: watch.records(),
            skipped: skipped.clone(),
            settings: settings.clone(),
            isovalues: cut.isovalues,
            mesh_hash: plan.mesh_hash(),
            steps_hash: plan.steps_hash(),
            plan: plan.clone(),
            chunks: cut.chunks,
            shards: cut.shards,
            memory_least: cut.memory_least,
            replaces: cut.replaces,
            search: cut.search,
        })
    }

    /// The plan of the best try, when the search is over; `settings` are those of that try.
    pub(in crate::pipeline) fn of_best(
        &self,
        search: PlannedSearch,
        settings: CompleteSettings,
        best: &Manifest,
    ) -> Self {
        let steps = best.steps.iter().map(|step| step.plan.clone()).collect();
        let plan = Plan { mesh: best.plan.clone(), steps };
        Self {
            mesh_hash: plan.mesh_hash(),
            steps_hash: plan.steps_hash(),
            plan,
            chunks: best.counts.chunks,
            settings,
            search: Some(search),
            ..self.clone()
        }
    }

    /// The folder in which the archive `out` is made: its own folder, or one next to it while its
    /// own has a finished archive, or while a target is searched for.
    pub(in crate::pipeline) fn root(&self, out: &Path) -> PathBuf {
        match &self.search {
            Some(PlannedSearch { search, .. }) => {
                let made = planned_try(out, search.this_try());
                if search.is_over() && !made.exists() { out.to_path_buf() } else { made }
            }
            None if self.replaces && !self.is_committed(out) => new_archive(out),
            None => out.to_path_buf(),
        }
    }

    fn is_committed(&self, out: &Path) -> bool {
        Manifest::read(out).is_ok_and(|manifest| self.plan.is_of(&manifest))
    }

    /// The sources with the numbers of their steps.
    pub(in crate::pipeline) fn numbered(&self) -> Vec<(u64, StepSource)> {
        self.plan.steps.iter().map(|s| s.number).zip(self.sources.iter().cloned()).collect()
    }

    /// The series that was planned, with a watch over its files.
    pub(in crate::pipeline) fn series(&self, watch: Watch) -> SeriesPlan {
        SeriesPlan {
            plan: self.plan.clone(),
            sources: self.sources.iter().cloned().map(PlannedSource::in_place).collect(),
            skipped: self.skipped.clone(),
            order: Order::default(),
            is_there: false,
            keyframes: self.settings.keyframes,
            attachments: Attachments::default(),
            watch,
        }
    }

    /// Refuses inputs that are not those of the plan; the watch is of their files.
    ///
    /// # Errors
    /// [`Error::BadInput`] that names one.
    pub(in crate::pipeline) fn expect_same_inputs(&self, run: &RunSettings) -> Result<Watch> {
        let mut inputs = Inputs::planned(&self.files, self.plan.fingerprints());
        for (step, source) in self.plan.steps.iter().zip(&self.sources) {
            let files = match source.open()? {
                Input::Volume(volume) => volume.info().files(),
                Input::Mesh(mesh) => mesh.info().files(),
            };
            let found = inputs.fingerprint(step.number, &files, &run.resources.cancel)?;
            if found != step.source.fingerprint {
                let expected = format!("fingerprint {}", step.source.fingerprint);
                return Err(Error::bad_input(&source.path, "file", expected, found).with_help(
                    "the file is not what it was when the plan was made: restore it, or plan again with `replace=true`",
                ));
            }
        }
        Ok(inputs.watch)
    }

    /// Writes the plan of an archive. One that is there stays what it is, unless it is to be
    /// replaced.
    ///
    /// # Errors
    /// [`Error::Usage`] when another one is there.
    pub(in crate::pipeline) fn write(&self, archive: &Path, replace: bool) -> Result<()> {
        let path = plan_path(archive);
        if !replace && path.exists() {
            return match Self::read(archive) {
                Ok(there) if self.is_alike(&there) => Ok(()),
                _ => Err(Error::usage(format!(
                    "{} is another plan; choose another name, or `replace=true` to replace it",
                    path.display()
                ))),
            };
        }
        let folder = work_folder(archive);
        std::fs::create_dir_all(&folder).map_err(|e| Error::io("create the folder", &folder, e))?;
        let mut out = Unpublished::create(&path)?;
        out.write(sealed_text(self).as_bytes())?;
        out.publish()
    }

    /// Whether two plans differ at most in the times of change of their files, which a copy has
    /// anew, and in how far the search for a target is.
    pub(in crate::pipeline) fn is_alike(&self, other: &Self) -> bool {
        if let (Some(ours), Some(theirs)) = (&self.search, &other.search) {
            let inputs = |plan: &Self| (plan.sources.clone(), plan.skipped.clone(), plan.replaces);
            return ours.search.asks_as(&theirs.search)
                && ours.shards == theirs.shards
                && self.isovalues == other.isovalues
                && inputs(self) == inputs(other)
                && self.plan.fingerprints() == other.plan.fingerprints();
        }
        Self { files: self.files.clone(), ..other.clone() } == *self
    }

    /// Reads the plan of an archive.
    ///
    /// # Errors
    /// [`Error::BadInput`] when there is none, or it is damaged, edited, or of another version of
    /// the program.
    pub(in crate::pipeline) fn read(archive: &Path) -> Result<Self> {
        let path = plan_path(archive);
        let bad = |at: &str, expected: String, got: String, help: &str| {
            Err(Error::bad_input(&path, at, expected, got).with_help(help))
        };
        let bytes = match read_whole(&path, LARGEST_PLAN) {
            Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                let help = "make one: isospan plan INPUT -o NAME.isospan `shards=N`";
                return bad("file", format!("the plan of {}", archive.display()), "nothing".into(), help);
            }
            bytes => bytes.map_err(|e| e.with_help(HELP))?,
        };
        let json = |e: serde_json::Error| {
            let at = format!("line {} column {}", e.line(), e.column());
            Error::bad_input(&path, at, "the plan of a reduction", e.to_string()).with_help(HELP)
        };
        let version: Version = serde_json::from_slice(&bytes).map_err(json)?;
        let ours = (FORMAT, FORMAT_VERSION, env!("CARGO_PKG_VERSION"));
        let found = (&*version.format, version.format_version, &*version.isospan_version);
        if found != ours {
            let text = |v: (&str, u16, &str)| format!("{} {} of version {}", v.0, v.1, v.2);
            let help = "all of a plan is done by one version of isospan: use that one, or plan again";
            return bad("version", text(ours), text(found), help);
        }
        check_sum(&bytes, &path, HELP)?;
        let mut plan: Self = serde_json::from_slice(&bytes).map_err(json)?;
        plan.sources = StepSource::holding_together(plan.sources);
        let as_many = plan.sources.len() == plan.plan.steps.len() && !plan.sources.is_empty();
        let hashes = (plan.plan.mesh_hash(), plan.plan.steps_hash());
        if hashes != (plan.mesh_hash, plan.steps_hash) || plan.shards == 0 || !as_many {
            return bad("hashes", format!("{} {}", hashes.0, hashes.1), "others".into(), HELP);
        }
        Ok(plan)
    }
}

/// What a plan of any version has.
#[derive(Deserialize)]
struct Version {
    format: String,
    format_version: u16,
    isospan_version: String,
}

fn with_absolute_paths(source: &StepSource) -> Result<StepSource> {
    let absolute = |p: &Path| {
        let path = place::absolute(p).map_err(|e| Error::io("find", p, e))?;
        match path.to_str() {
            Some(_) => Ok(path),
            None => Err(Error::usage(format!("{}: a plan needs paths in UTF-8", path.display()))),
        }
    };
    if source.is_given() {
        let name = source.path.display();
        return Err(Error::usage(format!(
            "{name} is in memory, or in an archive: other processes cannot read it; write it to a file, of an archive \
             with isospan brick"
        )));
    }
    let values = source.options.values.as_deref().map(absolute).transpose()?;
    let options = OpenOptions { values, ..source.options.clone() };
    Ok(StepSource::new(&absolute(&source.path)?, &options).at(source.time))
}
