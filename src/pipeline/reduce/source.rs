//! The samples of a step of a pyramid, as those who make its chunks need them.

use super::encode::BadSteps;
use crate::pipeline::chunk::GridField;
use crate::pipeline::plan::Shares;
use crate::pipeline::read::index_box;
use isospan_io::error::Result;
use isospan_io::exec::CancelToken;
use isospan_io::grid::{Chunk, IndexBox};
use isospan_wavelet::{Box3, Correction, Pyramid, Scale, fill};
use std::path::Path;

/// What is made of a step of a pyramid.
#[derive(Clone, Copy)]
pub(super) struct Work<'a> {
    pub(super) pyramid: &'a Pyramid,
    pub(super) scale: &'a Scale,
    pub(super) correction: Correction,
    pub(super) field: &'a GridField,
    /// Notes that the data of the step cannot be used.
    pub(super) bad: &'a BadSteps,
    pub(super) number: u64,
    /// The source, as messages name it.
    pub(super) path: &'a Path,
    /// Samples along each axis of the parts of a chunk.
    pub(super) edge: usize,
    pub(super) shares: Shares,
    pub(super) cancel: &'a CancelToken,
}

impl Work<'_> {
    pub(super) fn samples(&self, chunk: &Chunk) -> Box3 {
        self.pyramid.chunk(chunk.brick_lo.map(|n| n as usize))
    }

    /// Reads samples; NaN where they are missing.
    pub(super) fn read(&self, place: &IndexBox) -> Result<Vec<f32>> {
        self.read_into(place, vec![])
    }

    /// As [`Work::read`], in the memory of a vector.
    pub(super) fn read_into(&self, place: &IndexBox, mut values: Vec<f32>) -> Result<Vec<f32>> {
        values.clear();
        values.resize(place.len(), 0.0);
        self.bad.note(0, self.number, self.field.read_window(*place, &mut values))?;
        Ok(values)
    }

    /// Puts values in the place of the missing samples of a window.
    pub(super) fn fill(&self, window: &Box3, samples: &mut [f32]) -> Result<()> {
        let [min, max] = self.scale.range;
        let middle = (min / 2.0 + max / 2.0) as f32;
        fill(self.pyramid.nodes(0), window, samples, middle, |place| self.read(&index_box(place)))
    }
}
