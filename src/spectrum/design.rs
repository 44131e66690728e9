//! At which isovalues a spectrum is measured: grids that follow from the range of the values.

use super::grid::{Family, IsovalueGrid};

/// How many isovalues a grid may have, at most. The same for all chunks of an archive, lest one be
/// coarser than the whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    knots: u32,
    levels: u32,
}

/// The most and the fewest knots: about 10 bytes each.
pub(super) const MOST_KNOTS: u64 = 128;
const FEWEST_KNOTS: u64 = 48;
/// The most and the fewest levels: about a byte each.
pub(crate) const MOST_LEVELS: u64 = 8192;
const FEWEST_LEVELS: u64 = 256;

/// How many knots are at or below a void value: more than there are.
pub(super) const VOID: u8 = u8::MAX;

impl Limits {
    /// For a mesh of about `points` points: a spectrum is about a hundredth of a step's bytes.
    pub fn of_mesh(points: u64) -> Self {
        Self {
            knots: (points / 1024).clamp(FEWEST_KNOTS, MOST_KNOTS) as u32,
            levels: (points / 32).clamp(FEWEST_LEVELS, MOST_LEVELS) as u32,
        }
    }
}

/// What a spectrum, or a chunk's part of one, is measured at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Design {
    /// Least and largest value.
    pub range: [f32; 2],
    /// Isovalues of area, volume and gradient.
    pub knots: IsovalueGrid,
    /// Isovalues of the number of active tetrahedra alone.
    pub levels: IsovalueGrid,
}

impl Design {
    /// For values in `range`.
    pub fn new(range: [f32; 2], limits: Limits) -> Self {
        let knots = IsovalueGrid::new(Family::Binary, range, limits.knots);
        Self { range, knots, levels: IsovalueGrid::new(Family::Decimal, range, limits.levels) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_as_many_isovalues_as_a_mesh_has_points_for() {
        let design = Design::new([0.0, 1.0], Limits::of_mesh(250_000));
        assert_eq!((design.knots.count, design.levels.count), (128, 5000));
        assert_eq!((design.knots.value(63), design.levels.value(249)), (0.5, 0.05));
        let few = Design::new([0.0, 1.0], Limits::of_mesh(10));
        assert_eq!((few.knots.count, few.levels.count), (32, 100));
        let none = Design::new([2.0, 2.0], Limits::of_mesh(10));
        assert_eq!((none.knots.count, none.levels.count), (0, 0));
    }
}
