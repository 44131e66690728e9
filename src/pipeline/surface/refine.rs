//! Refines a welded surface before it is written: components are chosen, vertices are smoothed, and
//! triangles are decimated.

use crate::surface::SurfaceSource;
use crate::surface::edit::{
    components::{ComponentFilter, ComponentReport, components},
    decimate::{Decimation, DecimationReport, decimate},
    faces::Faces,
    smooth::{Smoothing, SmoothingReport, smooth},
};
use crate::surface::weld::{BuilderSettings, StoredSurface};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{CancelToken, pool};
use serde::Serialize;
use std::path::Path;

/// What is done to a surface after its extraction, in the order of the fields.
#[derive(Clone, Debug, Default)]
pub struct Refine {
    /// Measure the connected components, and keep those that pass.
    pub components: Option<ComponentFilter>,
    /// Smooth the surface: so many times each vertex moves to and fro.
    pub smooth: Option<u32>,
    /// The length by which smoothing may move a vertex, in world units; half of the shortest edge
    /// of a voxel if not given.
    pub smooth_limit: Option<f64>,
    /// Make do with fewer triangles.
    pub decimate: Option<Decimation>,
}

/// The result of a refinement.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct RefineReport {
    /// The components, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub components: Option<ComponentReport>,
    /// The smoothing, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smoothing: Option<SmoothingReport>,
    /// The decimation, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decimation: Option<DecimationReport>,
}

/// What a refinement may use.
pub(super) struct RefineMeans<'a> {
    /// All that the run may use.
    pub(super) memory: u64,
    /// Surfaces that are kept while they are refined one after another.
    pub(super) surfaces: u64,
    pub(super) threads: usize,
    /// The faces of the domain, where caps lie on them.
    pub(super) faces: &'a Faces,
    /// The shortest edge of a voxel, in world units.
    pub(super) voxel: f64,
    pub(super) scratch: &'a Path,
    pub(super) cancel: &'a CancelToken,
}

impl Refine {
    /// Whether a surface stays as it is.
    pub(super) fn changes_nothing(&self) -> bool {
        self.components.is_none() && self.smooth.is_none() && self.decimate.is_none()
    }

    /// Whether the settings can be carried out; before anything is read.
    pub(super) fn check(&self) -> Result<()> {
        if let Some(filter) = &self.components
            && !(filter.min_volume.is_finite() && filter.min_volume >= 0.0)
        {
            return Err(Error::usage("the least volume of a component must be a number, and not negative"));
        }
        self.smoothing(1.0).map_or(Ok(()), |s| s.check())?;
        self.decimate.map_or(Ok(()), |d| d.check())
    }

    /// How the surface is smoothed, of voxels whose shortest edge is this long.
    fn smoothing(&self, voxel: f64) -> Option<Smoothing> {
        let max_distance = self.smooth_limit.unwrap_or(voxel / 2.0);
        self.smooth.map(|iterations| Smoothing { iterations, max_distance })
    }

    /// Refines a surface, within the half of the memory that its extraction no longer needs.
    pub(super) fn apply(
        &self,
        surface: StoredSurface,
        means: &RefineMeans<'_>,
    ) -> Result<(StoredSurface, RefineReport)> {
        let share = 2 * means.surfaces.max(1);
        let memory_bytes = usize::try_from(means.memory / share).unwrap_or(usize::MAX);
        let settings = BuilderSettings { memory_bytes, scratch: means.scratch.to_path_buf() };
        let (mut surface, mut report) = (surface, RefineReport::default());
        if let Some(filter) = &self.components {
            means.cancel.check()?;
            let (kept, found) = components(surface, filter, &settings)
                .map_err(|e| e.of_share(means.memory / share, means.memory))?;
            (surface, report.components) = (kept, Some(found));
        }
        if let Some(how) = self.smoothing(means.voxel) {
            let (smoothed, done) = smooth(&surface, &how, means.faces, &settings, means.cancel)?;
            (surface, report.smoothing) = (smoothed, Some(done));
        }
        if let Some(goal) = &self.decimate {
            let needed = share.saturating_mul(Decimation::least_memory(surface.triangle_count()));
            if means.memory < needed {
                return Err(Error::memory("to decimate", needed, means.memory));
            }
            let pool = pool(means.threads)?;
            let (fewer, done) =
                pool.install(|| decimate(surface, goal, means.faces, &settings, means.cancel))?;
            (surface, report.decimation) = (fewer, Some(done));
        }
        Ok((surface, report))
    }
}
