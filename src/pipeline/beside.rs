//! What a plan of a mesh speaks of and does not hold: listed points, and how dense the others are. In an archive these are files of
//! their own, which are read before anything else.

use crate::archive::explicit::{explicit_path, read_explicit, write_explicit};
use crate::archive::levels::{levels_path, read_levels, write_levels};
use crate::archive::manifest::Plan as MeshPlan;
use crate::archive::segment::PlanHash;
use crate::error::Result;
use crate::points::{ExplicitPoints, Levels, PointSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Points and levels that belong to a plan.
#[derive(Clone, Debug, Default)]
pub(crate) struct Beside {
    pub(crate) explicit: Option<Arc<ExplicitPoints>>,
    pub(crate) levels: Option<Arc<Levels>>,
}

impl Beside {
    /// Those of an archive, if it has some.
    ///
    /// # Errors
    /// [`crate::Error::BadInput`] when they are damaged or others; [`crate::Error::Io`] when they are not there.
    pub(crate) fn read(archive: &Path, plan: &MeshPlan) -> Result<Self> {
        Self::read_of(archive, plan.hash(), plan)
    }

    /// As [`Beside::read`], of files that carry a hash.
    pub(crate) fn read_of(archive: &Path, hash: PlanHash, plan: &MeshPlan) -> Result<Self> {
        let explicit = plan.explicit.as_ref().map(|r| read_explicit(archive, hash, &plan.lattice, r));
        let levels = plan.levels.as_ref().map(|r| read_levels(archive, hash, &plan.lattice, r));
        Ok(Self { explicit: explicit.transpose()?.map(Arc::new), levels: levels.transpose()?.map(Arc::new) })
    }

    /// Writes those of a set into an archive.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub(crate) fn write(archive: &Path, hash: PlanHash, points: &PointSet) -> Result<()> {
        if let Some(listed) = points.explicit() {
            write_explicit(archive, hash, listed)?;
        }
        points.levels().map_or(Ok(()), |levels| write_levels(archive, hash, levels))
    }

    /// The files of a plan that are not there.
    pub(crate) fn missing(archive: &Path, plan: &MeshPlan) -> Vec<PathBuf> {
        let explicit = plan.explicit.is_some().then(|| explicit_path(archive));
        let levels = plan.levels.is_some().then(|| levels_path(archive));
        explicit.into_iter().chain(levels).filter(|p| !p.exists()).collect()
    }
}
