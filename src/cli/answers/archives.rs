//! The archives that are shown, and the steps of them that are in use.

use isospan::pipeline::{ArchiveSummary, Step, StepChoice};
use isospan::{Archive, Error, Result};
use serde::Serialize;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// Steps in use at one time, at most. Each holds decoded blocks for the next isovalue.
const STEPS: usize = 4;

/// A step of an archive.
#[derive(Clone, PartialEq)]
struct Key {
    archive: usize,
    step: StepChoice,
}

/// The archives that are shown.
pub struct Archives {
    archives: Vec<Archive>,
    /// Milliseconds on the clock of the host, which never goes back.
    clock: fn() -> f64,
    /// The step used last comes last.
    steps: Mutex<VecDeque<(Key, Step)>>,
}

/// An archive, for the page.
#[derive(Serialize)]
pub struct Description {
    /// The name of its folder.
    name: String,
    /// The corners of the domain in the world, x fastest; none where the grid has coordinates of
    /// its own.
    corners: Option<[[f64; 3]; 8]>,
    #[serde(flatten)]
    summary: ArchiveSummary,
}

impl Archives {
    /// Opens archives, which hold so many bytes of decoded blocks together.
    ///
    /// `clock` gives milliseconds: a page has a clock of its own.
    ///
    /// # Errors
    /// When one cannot be opened.
    pub fn open(paths: &[PathBuf], memory: u64, clock: fn() -> f64) -> Result<Self> {
        let archives = paths.iter().map(Archive::open).collect::<Result<Vec<_>>>()?;
        // Between two steps there are as many as a user asks for.
        let steps = |archive: &Archive| Ok(if archive.info()?.steps.len() == 1 { 1 } else { STEPS });
        let in_use = archives.iter().map(steps).sum::<Result<usize>>()?.clamp(1, STEPS);
        let cache = usize::try_from(memory / in_use as u64).unwrap_or(usize::MAX);
        let archives = archives.into_iter().map(|archive| archive.keeping(cache)).collect();
        Ok(Self { archives, clock, steps: Mutex::default() })
    }

    /// A step of an archive: the same one as before, while it is among those used last.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is no such archive or step; those of opening the step.
    pub fn at(&self, archive: usize, step: StepChoice) -> Result<Step> {
        let none =
            || Error::usage(format!("there is no archive {archive}; there are {}", self.archives.len()));
        let key = Key { archive, step: step.clone() };
        let mut steps = self.steps.lock().unwrap_or_else(PoisonError::into_inner);
        let at = steps.iter().position(|(k, _)| *k == key);
        let found = match at.and_then(|at| steps.remove(at)) {
            Some((_, step)) => step,
            None => self.archives.get(archive).ok_or_else(none)?.at(step)?,
        };
        steps.push_back((key, found.clone()));
        while steps.len() > STEPS {
            steps.pop_front();
        }
        Ok(found)
    }

    /// Milliseconds on the host's clock.
    pub(super) fn milliseconds(&self) -> f64 {
        (self.clock)()
    }

    /// What the page shows of each.
    ///
    /// # Errors
    /// When one cannot be read.
    pub fn describe(&self) -> Result<Vec<Description>> {
        self.archives.iter().map(Description::of).collect()
    }
}

impl Description {
    fn of(archive: &Archive) -> Result<Self> {
        let summary = archive.info()?;
        let ends = summary.dims.map(|d| d.saturating_sub(1) as f64);
        let corner = |n: usize| {
            let at = [0, 1, 2].map(|a| if n >> a & 1 == 1 { ends[a] } else { 0.0 });
            summary.geometry.to_world(at)
        };
        let corners = summary.grid_cells.is_none().then(|| std::array::from_fn(corner));
        let path = archive.path();
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { name, corners, summary })
    }
}
