//! [`Steps`]: some steps of an archive, and the questions that are asked of all of them.

use crate::pipeline::field::{GridReport, GridSettings, Moments, export_zarr};
use crate::pipeline::read::{OpenArchive, StepSpectrum};
use isospan_io::error::Result;
use isospan_io::exec::Progress;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// Some steps of an archive, in their order: see [`Archive::steps`](super::Archive::steps). There
/// is at least one.
///
/// [`query`](Self::query) asks for surfaces of each of them.
#[derive(Clone)]
pub struct Steps {
    pub(super) open: Arc<OpenArchive>,
    pub(super) positions: Range<usize>,
}

impl Steps {
    /// The contour spectrum of each step. The bytes read are those of each spectrum, and of the
    /// manifest with each.
    ///
    /// # Errors
    /// As [`Step::spectrum`](super::Step::spectrum).
    pub fn spectra(&self) -> Result<Vec<StepSpectrum>> {
        self.positions.clone().map(|n| StepSpectrum::of(&self.open.step_at(n))).collect()
    }

    /// Writes the levels of a pyramid as one OME-Zarr image with an axis of time: see
    /// [`Step::write_ome_zarr`](super::Step::write_ome_zarr).
    ///
    /// # Errors
    /// Those of [`Step::write_ome_zarr`](super::Step::write_ome_zarr).
    pub fn write_ome_zarr(
        &self,
        settings: &GridSettings,
        out: &Path,
        replace: bool,
        progress: &dyn Progress,
    ) -> Result<GridReport> {
        let moments = Moments::Steps(&self.open, self.positions.clone());
        export_zarr(&moments, settings, out, replace, progress)
    }
}
