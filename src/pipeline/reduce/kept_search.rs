//! A search for a target on disk: a run that was stopped or killed goes on at the try that it was
//! in.
//!
//! ```text
//!  tooth.isospan.work/
//!      search.json       what was asked, and what the next try follows from
//!      try-3.isospan/    the best try so far
//!      try-5.isospan/    the one that is being made
//! ```
//!
//! The file is written before the first try, and replaced after each. A try that is complete but
//! not noted yet is found complete, and one that is not is continued chunk by chunk, as any archive
//! is. Tries of another question, or of inputs that have changed since, are removed.

use super::existing::lacks_files;
use super::job::Job;
use super::plan_file::work_folder;
use super::report::ReduceReport;
use super::series::SkippedStep;
use super::tries::{remove_tries, tries_in};
use crate::archive::manifest::{Manifest, check_sum, mesh_folder, sealed_text, steps_folder};
use crate::archive::segment::PlanHash;
use crate::domain::store::MeshCensus;
use crate::pipeline::plan::Inputs;
use isospan_io::bytes::publish::Unpublished;
use isospan_io::bytes::read_whole;
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::formats::{Input, StepSource};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};

const FORMAT: &str = "isospan search";
/// The most bytes of the file: tries, settings, and a record for each step.
const LARGEST: u64 = 1 << 28;
/// How the names of tries begin.
const TRY: &str = "try-";

/// What a step is made of: a search goes on only where all of this is as it was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct StepInput {
    pub(super) number: u64,
    pub(super) time: Option<f64>,
    pub(super) field: String,
    pub(super) fingerprint: String,
}

impl StepInput {
    pub(super) fn of(
        (number, source): &(u64, StepSource),
        inputs: &mut Inputs<'_>,
        cancel: &CancelToken,
    ) -> Result<Self> {
        let (files, field) = match source.open()? {
            Input::Volume(volume) => (volume.info().files(), volume.info().field.name.clone()),
            Input::Mesh(mesh) => (mesh.info().files(), mesh.field()?.name.clone()),
        };
        let fingerprint = inputs.of_source(*number, source, &files, cancel)?;
        Ok(Self { number: *number, time: source.time, field, fingerprint })
    }
}

/// What was asked of a search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Asked {
    format: String,
    /// Versions may write different bytes.
    isospan_version: String,
    settings: PlanHash,
    /// Bytes of the source, if known: a share of them may be the target.
    source_bytes: Option<u64>,
    /// None of a step that cannot be used: a try says why, or leaves it out.
    inputs: Vec<Option<StepInput>>,
}

impl Asked {
    fn by(job: &Job<'_>, source_bytes: Option<u64>) -> Result<Self> {
        let mut inputs = Inputs::default();
        let mut input = |source| match StepInput::of(source, &mut inputs, &job.run.resources.cancel) {
            Err(Error::Cancelled) => Err(Error::Cancelled),
            found => Ok(found.ok()),
        };
        Ok(Self {
            format: FORMAT.into(),
            isospan_version: env!("CARGO_PKG_VERSION").into(),
            settings: job.settings.hash(),
            source_bytes,
            inputs: job.sources.iter().map(&mut input).collect::<Result<_>>()?,
        })
    }
}

/// The contents of the file.
#[derive(Serialize, Deserialize)]
struct Noted<S> {
    asked: Asked,
    state: S,
}

/// What a report has of a try besides what the manifest says.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct MadeTry {
    samples: u64,
    inner_points: u64,
    halo_retries: u64,
    mesh: Option<MeshCensus>,
    skipped: Vec<SkippedStep>,
}

impl MadeTry {
    pub(super) fn of(report: &ReduceReport) -> Self {
        let ReduceReport { samples, inner_points, halo_retries, mesh, ref skipped, .. } = *report;
        Self { samples, inner_points, halo_retries, mesh, skipped: skipped.clone() }
    }

    /// The report of the try, which lies in this folder.
    pub(super) fn report(self, archive: &Path) -> Result<ReduceReport> {
        let Self { samples, inner_points, halo_retries, mesh, skipped } = self;
        let report =
            ReduceReport { samples, inner_points, halo_retries, mesh, skipped, ..ReduceReport::default() };
        report.of_archive(archive, &Manifest::read(archive)?, 0)
    }
}

/// A search and its folder.
pub(super) struct KeptSearch<'a> {
    out: &'a Path,
    asked: Asked,
}

impl<'a> KeptSearch<'a> {
    /// Takes up the search of a job: what it had come to, if it is there. One that asks for
    /// something else is dropped.
    ///
    /// # Errors
    /// When files cannot be removed; [`Error::Cancelled`].
    pub(super) fn open<S: DeserializeOwned>(
        job: &Job<'a>,
        source_bytes: Option<u64>,
    ) -> Result<(Self, Option<S>)> {
        let kept = Self { out: job.out, asked: Asked::by(job, source_bytes)? };
        let (file, found) = (search_file(job.out), read::<S>(job.out));
        let state = found.filter(|noted| noted.asked == kept.asked).map(|noted| noted.state);
        if state.is_none() && file.exists() {
            let text = "the unfinished search there asks for something else, and is dropped";
            job.progress.notice(&format!("{}: {text}", file.display()));
        }
        if state.is_none() {
            kept.keep(&[])?;
        }
        Ok((kept, state))
    }

    /// The folder of a try.
    pub(super) fn try_path(&self, number: u32) -> PathBuf {
        work_folder(self.out).join(format!("{TRY}{number}.isospan"))
    }

    /// Whether a try that was noted is there.
    pub(super) fn has(&self, number: u32) -> bool {
        let path = self.try_path(number);
        Manifest::read(&path).is_ok_and(|manifest| !lacks_files(&path, &manifest))
    }

    /// Notes how far the search is.
    pub(super) fn note(&self, state: &impl Serialize) -> Result<()> {
        let folder = work_folder(self.out);
        fs::create_dir_all(&folder).map_err(|e| Error::io("create the folder", &folder, e))?;
        let mut file = Unpublished::create(&search_file(self.out))?;
        file.write(sealed_text(&Noted { asked: self.asked.clone(), state }).as_bytes())?;
        file.publish()
    }

    /// Removes all tries but some.
    pub(super) fn keep(&self, kept: &[Option<u32>]) -> Result<()> {
        remove_tries(self.out, TRY, kept)
    }
}

fn search_file(archive: &Path) -> PathBuf {
    work_folder(archive).join("search.json")
}

/// The search that is noted, if that can be read.
fn read<S: DeserializeOwned>(archive: &Path) -> Option<Noted<S>> {
    let path = search_file(archive);
    let bytes = read_whole(&path, LARGEST).ok()?;
    check_sum(&bytes, &path, "").ok()?;
    serde_json::from_slice(&bytes).ok()
}

/// Removes a search of which no try has made anything: it was refused. Folders of tries that are
/// empty go as well.
pub(super) fn forget_unbegun(archive: &Path) {
    let folder = work_folder(archive);
    let tries: Vec<PathBuf> = tries_in(&folder, TRY).into_iter().map(|(_, path)| path).collect();
    for made in &tries {
        for inner in [mesh_folder(made), steps_folder(made), made.clone()] {
            // One with a file in it stays: the same call goes on with that.
            let _ = fs::remove_dir(inner);
        }
    }
    if !tries.iter().any(|made| made.exists()) && read::<IgnoredAny>(archive).is_some() {
        let _ = fs::remove_file(search_file(archive));
        let _ = fs::remove_dir(folder);
    }
}

/// Removes a search that is over, or that an archive makes needless.
pub(super) fn forget_search(archive: &Path) -> Result<()> {
    let file = search_file(archive);
    if !file.exists() {
        return Ok(());
    }
    remove_tries(archive, TRY, &[])?;
    match fs::remove_file(&file) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::io("remove", &file, e)),
        _ => {}
    }
    // There may be a plan, or logs.
    let _ = fs::remove_dir(work_folder(archive));
    Ok(())
}
