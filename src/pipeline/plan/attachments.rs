//! What a plan of a mesh refers to but does not contain: listed points, refinement levels, and
//! duplicate vertices of the source. In an archive these are files of their own. The first two are
//! read before anything else, the last only when a step is added.

use crate::archive::manifest::MeshPlan;
use crate::archive::segment::PlanHash;
use crate::archive::tables::{
    RepeatedReader, explicit_path, levels_path, read_explicit, read_levels, repeated_path, write_explicit,
    write_levels, write_repeated,
};
use crate::domain::merge::Firsts;
use crate::domain::settings::StoreSettings;
use isospan_io::error::Result;
use isospan_mesh::points::{ExplicitPoints, Levels, SetKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Points and levels that belong to a plan.
#[derive(Clone, Default)]
pub(in crate::pipeline) struct Attachments {
    pub(in crate::pipeline) explicit: Option<Arc<ExplicitPoints>>,
    pub(in crate::pipeline) levels: Option<Arc<Levels>>,
    /// The duplicate vertices of a mesh that is being reduced; not read with the others.
    pub(in crate::pipeline) repeated: Option<Arc<Firsts>>,
}

impl Attachments {
    /// The attachments of an archive, if it has some.
    ///
    /// # Errors
    /// [`crate::Error::BadInput`] when they are damaged or others; [`crate::Error::Io`] when they
    /// are not there.
    pub(in crate::pipeline) fn read(archive: &Path, plan: &MeshPlan) -> Result<Self> {
        Self::read_of(archive, plan.hash(), plan)
    }

    /// As [`Attachments::read`], of files that carry a hash.
    pub(in crate::pipeline) fn read_of(archive: &Path, hash: PlanHash, plan: &MeshPlan) -> Result<Self> {
        let own = plan.points.kind() == SetKind::Own;
        let explicit = plan.explicit.as_ref().map(|r| read_explicit(archive, hash, &plan.lattice, r, own));
        let levels = plan.levels.as_ref().map(|r| read_levels(archive, hash, &plan.lattice, r));
        let (explicit, levels) = (explicit.transpose()?.map(Arc::new), levels.transpose()?.map(Arc::new));
        Ok(Self { explicit, levels, repeated: None })
    }

    /// The vertices of its source that an archive merges.
    ///
    /// # Errors
    /// As [`Attachments::read`]; when the scratch folder cannot be written.
    pub(in crate::pipeline) fn repeated(
        archive: &Path,
        plan: &MeshPlan,
        vertices: u64,
        how: &StoreSettings,
    ) -> Result<Firsts> {
        let reader = plan.repeated.as_ref().map(|r| RepeatedReader::open(archive, plan.hash(), r));
        let mut reader = reader.transpose()?;
        Firsts::known(|| reader.as_mut().map_or(Ok(None), RepeatedReader::next), vertices, how)
    }

    /// Writes all into an archive.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub(in crate::pipeline) fn write(&self, archive: &Path, hash: PlanHash) -> Result<()> {
        if let Some(listed) = &self.explicit {
            write_explicit(archive, hash, listed)?;
        }
        if let Some(levels) = &self.levels {
            write_levels(archive, hash, levels)?;
        }
        self.repeated.as_ref().map_or(Ok(()), |firsts| write_repeated(archive, hash, firsts.pairs()?))
    }

    /// The files that a plan speaks of.
    pub(in crate::pipeline) fn files(archive: &Path, plan: &MeshPlan) -> Vec<PathBuf> {
        let explicit = plan.explicit.is_some().then(|| explicit_path(archive));
        let levels = plan.levels.is_some().then(|| levels_path(archive));
        let repeated = plan.repeated.is_some().then(|| repeated_path(archive));
        explicit.into_iter().chain(levels).chain(repeated).collect()
    }

    /// The files that are missing.
    pub(in crate::pipeline) fn missing(archive: &Path, plan: &MeshPlan) -> Vec<PathBuf> {
        Self::files(archive, plan).into_iter().filter(|p| !p.exists()).collect()
    }
}
