//! The archives that are shown, and those of their steps that are open.

use isospan::pipeline::{ArchiveSummary, StepChoice, contour_spectrum_at, summarize_at};
use isospan::{Archive, Error, Result};
use serde::Serialize;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// Steps that are open at one time. Each holds decoded blocks for the next isovalue.
const OPEN: usize = 4;

/// A step of an archive: what [`Archives::at`] opens.
#[derive(Clone, Copy, PartialEq)]
struct Key {
    archive: usize,
    step: StepChoice,
}

pub(super) struct Archives {
    paths: Vec<PathBuf>,
    /// Bytes of decoded blocks of an open step.
    cache: usize,
    /// The step used last comes last.
    open: Mutex<VecDeque<(Key, Arc<Archive>)>>,
}

/// An archive, for the page.
#[derive(Serialize)]
pub(super) struct Description {
    /// The name of its folder.
    name: String,
    /// The corners of the domain in the world, x fastest; none where the grid has coordinates of its own.
    corners: Option<[[f64; 3]; 8]>,
    #[serde(flatten)]
    summary: ArchiveSummary,
}

impl Archives {
    /// # Errors
    /// Those of opening each, so that a wrong path is found before a browser is.
    pub(super) fn open(paths: &[PathBuf], memory: u64) -> Result<Self> {
        let cache = usize::try_from(memory / 4 / OPEN as u64).unwrap_or(usize::MAX);
        let all = Self { paths: paths.to_vec(), cache, open: Mutex::default() };
        (0..paths.len()).try_for_each(|n| all.at(n, StepChoice::First).map(|_| ()))?;
        Ok(all)
    }

    pub(super) fn len(&self) -> usize {
        self.paths.len()
    }

    fn path(&self, n: usize) -> Result<&PathBuf> {
        let none = || Error::usage(format!("there is no archive {n}; there are {}", self.paths.len()));
        self.paths.get(n).ok_or_else(none)
    }

    /// A step of an archive, opened where it is not open yet.
    pub(super) fn at(&self, archive: usize, step: StepChoice) -> Result<Arc<Archive>> {
        let key = Key { archive, step };
        let found = {
            let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
            let at = open.iter().position(|(k, _)| *k == key);
            at.and_then(|at| open.remove(at)).inspect(|found| open.push_back(found.clone()))
        };
        if let Some((_, archive)) = found {
            return Ok(archive);
        }
        let opened = Arc::new(Archive::open_at(self.path(archive)?, step)?.keeping(self.cache));
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.push_back((key, opened.clone()));
        while open.len() > OPEN {
            open.pop_front();
        }
        Ok(opened)
    }

    pub(super) fn describe(&self, n: usize) -> Result<Description> {
        let path = self.path(n)?;
        let summary = summarize_at(path, StepChoice::First)?;
        let ends = summary.dims.map(|d| d.saturating_sub(1) as f64);
        let corner = |n: usize| {
            let at = [0, 1, 2].map(|a| if n >> a & 1 == 1 { ends[a] } else { 0.0 });
            summary.geometry.to_world(at)
        };
        let corners = summary.grid_cells.is_none().then(|| std::array::from_fn(corner));
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        Ok(Description { name, corners, summary })
    }

    pub(super) fn spectrum(&self, n: usize, step: StepChoice) -> Result<isospan::pipeline::SpectrumReport> {
        contour_spectrum_at(self.path(n)?, step)
    }
}
