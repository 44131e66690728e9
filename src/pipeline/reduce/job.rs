//! The job of a reduction. It has the same form for volumes and meshes, for a whole archive, a
//! shard, and further steps.

use super::plan_file::PlanFile;
use super::reuse::Round;
use super::series::Copies;
use crate::pipeline::plan::{Estimate, Inputs, Need, Plan, Question, folder_bytes};
use crate::pipeline::read::OpenArchive;
use crate::pipeline::settings::{CompleteSettings, RunSettings};
use isospan_io::error::Result;
use isospan_io::exec::Progress;
use isospan_io::formats::StepSource;
use std::path::Path;

/// What is asked of a reduction.
#[derive(Clone, Copy)]
pub(in crate::pipeline) struct Job<'a> {
    /// The steps, by ascending numbers.
    pub(in crate::pipeline) sources: &'a [(u64, StepSource)],
    pub(in crate::pipeline) settings: &'a CompleteSettings,
    /// The archive's folder.
    pub(in crate::pipeline) out: &'a Path,
    pub(in crate::pipeline) run: &'a RunSettings,
    pub(in crate::pipeline) progress: &'a dyn Progress,
    pub(in crate::pipeline) basis: Basis<'a>,
    /// Whether what chunks add to sums stays in the finished archive: a search looks at it.
    pub(in crate::pipeline) keeps_sums: bool,
}

/// What a plan is made from besides the sources.
#[derive(Clone, Copy)]
pub(in crate::pipeline) enum Basis<'a> {
    /// Nothing: the archive is new.
    New,
    /// The plan that was made before for all shards.
    Plan(&'a PlanFile),
    /// The plan of the try before, of the same inputs, in a search for a target.
    Try(&'a PlanFile),
    /// The archive to which the steps are added.
    Archive(&'a OpenArchive),
    /// The round before, in a search for a largest error.
    Round(&'a Round),
}

impl Job<'_> {
    /// Whether errors name the step.
    pub(super) fn is_several(&self) -> bool {
        self.sources.len() > 1 || self.basis.archive().is_some()
    }

    /// Whether the sources are several fields of each step.
    pub(in crate::pipeline) fn has_fields(&self) -> bool {
        self.sources.iter().any(|(_, source)| source.part().is_some())
    }

    /// What a plan needs, and what there is.
    pub(super) fn estimate(&self, plan: &Plan, need: &Need, copies: &Copies) -> Result<Estimate> {
        let (out, resources) = (self.out, &self.run.resources);
        Ok(Estimate::new(&Question {
            plan,
            need,
            memory: resources.memory,
            threads: resources.worker_threads(),
            out,
            there: if out.is_dir() { folder_bytes(out)? } else { 0 },
            scratch: (&resources.scratch_folder(), copies.scratch),
            copying: copies.memory,
        }))
    }
}

impl<'a> Basis<'a> {
    /// The plan that was made before.
    pub(super) fn plan(&self) -> Option<&'a Plan> {
        match *self {
            Self::Plan(file) => Some(&file.plan),
            _ => None,
        }
    }

    /// The inputs: those that the plan was made from are not hashed again.
    pub(super) fn inputs(&self) -> Inputs<'a> {
        match *self {
            Self::Plan(file) | Self::Try(file) => Inputs::planned(&file.files, file.plan.fingerprints()),
            _ => Inputs::default(),
        }
    }

    /// The archive to which the steps are added.
    pub(super) fn archive(&self) -> Option<&'a OpenArchive> {
        match *self {
            Self::Archive(archive) => Some(archive),
            _ => None,
        }
    }

    /// The round before.
    pub(super) fn round(&self) -> Option<&'a Round> {
        match *self {
            Self::Round(round) => Some(round),
            _ => None,
        }
    }
}
