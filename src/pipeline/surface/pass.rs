//! Steps that are extracted together.
//!
//! Each step has a weld of its own, so each surface is, byte by byte, the one that a single
//! extraction gives.
//!
//! A chunk at work needs memory for its values and its surfaces at all steps. So a pass takes as
//! many steps as fit into memory ([`Pass::next`]). Finished surfaces that exceed their share of it
//! wait in the scratch folder. Where there is a choice, a pass ends before a keyframe, so that no
//! values are decoded only for the differences to them.

use super::extract::Extraction;
use super::query::{FinishedSurfaces, Prepared, extract};
use super::settings::SurfaceSettings;
use super::weld::SurfaceStorage;
use crate::pipeline::read::StepView;
use crate::surface::TriMesh;
use isospan_io::error::{Error, Result};
use isospan_io::exec::Progress;
use std::path::{Path, PathBuf};

/// Steps that are extracted together, at most: what is done once for all of them is then a tenth of
/// the work.
pub(super) const MOST_STEPS: usize = 32;

/// Steps that are extracted together, and where surfaces are kept meanwhile.
pub(super) struct Pass<'a> {
    steps: Vec<Prepared<'a>>,
    scratch: PathBuf,
}

impl<'a> Pass<'a> {
    /// The first ones of some consecutive steps, as many as are extracted together.
    pub(super) fn next(views: &'a [StepView], settings: &SurfaceSettings, scratch: &Path) -> Result<Self> {
        let count = views.len().min(MOST_STEPS);
        let is_key = |n: &usize| {
            let next = views[0].manifest.steps.get(views[0].position() + n);
            next.is_none_or(|step| step.plan.base.is_none())
        };
        let count = (count / 2 + 1..=count).rev().find(is_key).unwrap_or(count);
        let prepare = |view| {
            settings.resources.cancel.check()?;
            Prepared::new(view, settings)
        };
        let mut steps = views[..count].iter().map(prepare).collect::<Result<Vec<_>>>()?;
        while steps.len() > 1 && !fits(&steps, settings, scratch) {
            steps.truncate(steps.len() / 2);
        }
        Ok(Self { steps, scratch: scratch.to_path_buf() })
    }

    /// The surfaces of each step. What was read for all of them is reported with the first. The
    /// memory of surfaces that are no longer needed is taken from `reused`.
    ///
    /// Where chunks share too many edges for several steps, fewer steps are taken. The number of
    /// results says how many.
    pub(super) fn extract(
        mut self,
        settings: &SurfaceSettings,
        reused: &mut Vec<Vec<TriMesh>>,
        progress: &dyn Progress,
    ) -> Result<Vec<FinishedSurfaces>> {
        loop {
            let storage = |_: &Prepared<'_>| SurfaceStorage {
                scratch: self.scratch.clone(),
                reused: reused.pop().unwrap_or_default(),
            };
            let storages = self.steps.iter().map(storage).collect();
            match extract(&self.steps, settings, storages, None, progress) {
                Err(Error::Budget { .. }) if self.steps.len() > 1 => {
                    self.steps.truncate(self.steps.len() / 2);
                }
                made => return made,
            }
        }
    }
}

fn fits(steps: &[Prepared<'_>], settings: &SurfaceSettings, scratch: &Path) -> bool {
    let questions: Vec<_> = steps.iter().map(|step| step.question(settings)).collect();
    Extraction::new(&questions).fits(settings.resources.memory, scratch)
}
