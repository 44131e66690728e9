//! How far apart the points inside of a mesh lie.

use isospan_io::error::Result;
use isospan_io::geom::{Lattice, LatticePos};
use isospan_mesh::points::{Levels, PointSet, PointSpec};
use std::sync::Arc;

/// Mean distance of the points inside, in lattice steps.
#[derive(Clone, Debug)]
pub(crate) struct Spacing {
    /// For each level; for one, if there are no levels.
    pub(super) by_level: Vec<u32>,
    levels: Option<Arc<Levels>>,
}

impl Spacing {
    /// The spacing of a set of points, or of each level where its density differs from place to
    /// place.
    ///
    /// # Errors
    /// As [`PointSet::new`].
    pub(crate) fn of(points: PointSpec, lattice: Lattice, levels: Option<Arc<Levels>>) -> Result<Self> {
        let top = levels.as_ref().map_or(0, |levels| levels.top());
        let of = |level: u8| {
            let spec = match points {
                PointSpec::Halton { n } => PointSpec::Halton { n: n << level },
                other => other,
            };
            let spacing = PointSet::new(spec, lattice)?.mean_spacing();
            Ok(spacing.into_iter().max().expect("three axes"))
        };
        Ok(Self { by_level: (0..=top).map(of).collect::<Result<_>>()?, levels })
    }

    /// The mean distance around a position of the domain.
    pub(super) fn at(&self, pos: LatticePos) -> u32 {
        let level = self.levels.as_ref().map_or(0, |levels| levels.at(pos));
        self.by_level[usize::from(level)]
    }

    /// How many times as many samples a place of the boundary has as one of level 0.
    pub(super) fn denser(&self, pos: LatticePos) -> f64 {
        let ratio = f64::from(self.by_level[0]) / f64::from(self.at(pos));
        ratio * ratio
    }

    /// How many times as far apart as here points may lie in the neighbourhood.
    pub(super) fn unevenness(&self) -> f64 {
        // Two levels.
        if self.levels.is_some() { 1.6 } else { 1.0 }
    }
}
