//! The labels of a step: nodes of the one level that there is.

use super::nodes::damaged;
use super::pyramid::{PyramidStep, box3, chunk_number, lock};
use super::step_view::StepView;
use isospan_io::error::{Error, Result};
use isospan_io::grid::IndexBox;
use isospan_io::setting::Setting;
use isospan_wavelet::{Box3, TILE, TileId, decode_labels};
use std::sync::Arc;

impl StepView {
    /// Whether samples are labels: names, of which none is between two others.
    pub(in crate::pipeline) fn has_labels(&self) -> bool {
        self.manifest.plan.has_labels()
    }

    /// Refuses labels where values are ordered: at an isovalue, and in a spectrum.
    ///
    /// # Errors
    /// [`Error::Usage`].
    pub(in crate::pipeline) fn expect_values(&self) -> Result<()> {
        match self.has_labels() {
            true => Err(Error::usage(format!(
                "{} has labels, which are names: none is above another, so there is no isovalue. Surfaces \
                 of labels are asked for with {}",
                self.path().display(),
                Setting::LabelSurface
            ))),
            false => Ok(()),
        }
    }

    /// Refuses a coarse level of labels.
    ///
    /// # Errors
    /// [`Error::Usage`].
    pub(in crate::pipeline) fn expect_level_of_labels(&self, level: usize) -> Result<()> {
        match self.has_labels() && level > 0 {
            true => Err(Error::usage(format!(
                "{} has no level {level}: labels have level 0 alone, as there is no mean of two names",
                self.path().display()
            ))),
            false => Ok(()),
        }
    }

    /// The labels of a box, x fastest.
    pub(super) fn labels(&self, of: &PyramidStep, level: usize, wanted: &IndexBox) -> Result<Vec<f32>> {
        self.expect_level_of_labels(level)?;
        let wanted = box3(wanted);
        let all = Box3::all(of.pyramid.nodes(0));
        if wanted.is_empty() || wanted.cut(&all) != wanted {
            return Err(Error::usage("a box of labels that is empty, or not within the volume"));
        }
        let mut values = self.spare.nodes(wanted.len());
        values.clear();
        values.resize(wanted.len(), 0.0);
        let (first, last) = (wanted.start.map(|n| n / TILE), wanted.end().map(|n| (n - 1) / TILE));
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let id = TileId { level: 0, at: [x, y, z] };
                    // No labels are zeros.
                    if let Some(labels) = self.label_tile(of, id)? {
                        copy_common(&wanted, &mut values, &of.pyramid.label_box(id.at), &labels);
                    }
                }
            }
        }
        Ok(values)
    }

    /// A decoded tile of labels; none of zeros.
    fn label_tile(&self, of: &PyramidStep, id: TileId) -> Result<Option<Arc<Vec<i32>>>> {
        if let Some(known) = lock(&of.labels).get(&id) {
            return Ok(Some(known));
        }
        let at = of.pyramid.chunk_of(id);
        let chunk = chunk_number(&of.pyramid, at);
        let (number, block) = of.pyramid.block_of(at, id);
        let stored = self.tile_block(of, chunk, number, &block)?;
        let Some(place) = stored.places.get(&id) else { return Ok(None) };
        let size = of.pyramid.label_box(id.at).size;
        let labels = decode_labels(&stored.bytes[place.clone()], size);
        let labels = Arc::new(labels.or_else(|e| {
            let file = self.values_of(self.position(), chunk)?;
            Err(damaged(file.segment().path(), file.block_number(chunk, number as u64), &e))
        })?);
        lock(&of.labels).put(id, Arc::clone(&labels), 64 + 4 * labels.len());
        Ok(Some(labels))
    }
}

/// Copies what a tile has of a box.
fn copy_common(wanted: &Box3, values: &mut [f32], tile: &Box3, labels: &[i32]) {
    let common = wanted.cut(tile);
    let row_of = |b: &Box3, y: usize, z: usize| {
        ((z - b.start[2]) * b.size[1] + y - b.start[1]) * b.size[0] + common.start[0] - b.start[0]
    };
    for z in common.start[2]..common.end()[2] {
        for y in common.start[1]..common.end()[1] {
            let (to, from) = (row_of(wanted, y, z), row_of(tile, y, z));
            let labels = &labels[from..from + common.size[0]];
            let values = &mut values[to..to + common.size[0]];
            values.iter_mut().zip(labels).for_each(|(value, label)| *value = *label as f32);
        }
    }
}
