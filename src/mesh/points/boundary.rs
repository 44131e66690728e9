//! Samples of the surface of the domain box.
//!
//! Interior points stop short of the faces, and so would every surface. So the box itself is
//! sampled, as densely as its inside. With a mean spacing h = (V/n)^(1/3), V the volume of the box
//! in lattice steps and n the number of interior points (for a hyperbolic cross, whose density
//! varies, that is its average):
//!
//! | part | class | samples on each | positions |
//! |---|---|---|---|
//! | 8 corners | corner | 1 | |
//! | 12 edges | edge | length/h | (i+½)/c, i = 0 … c-1; for a Halton set Φ₂(k), k = 1 … c |
//! | 6 faces | face | area/h² | ((i+½)/c, Φ₂(i+1)); for a Halton set (Φ₂(k), Φ₃(k)), k = 1 … c |
//!
//! Starting at k = 1 keeps the radical inverses off 0: no sample of a face lies on an edge, unless
//! rounding to the lattice puts it there. Then the convex hull of all sites is the box, exactly,
//! and the tetrahedra at the boundary have the shape of all others. The boundary of a longer Halton
//! sequence contains that of a shorter one, ids included: the index of a sample is k - 1 (or i)
//! times the number of parts of its kind plus the number of its part.
//!
//! Numbers of the parts: corner c has x = max if bit 0 of c, y bit 1, z bit 2; face 2a + side is
//! perpendicular to axis a, side 0 at 0; edge 4a + s + 2t runs along a, s being the side on the
//! next axis (cyclically), t on the one after.

use super::net::{Net, NetAxis};
use super::radical_inverse::Base;
use isospan_io::geom::{LatticeBox, LatticePos, PointClass, PointId, Site};

/// The boundary samples of a box.
#[derive(Clone, Debug)]
pub(super) struct Boundary {
    max: LatticePos,
    /// The samples of each edge, by its number.
    edges: Vec<Net>,
    /// The samples of each face, by its number.
    faces: Vec<Net>,
}

/// Half a sample's distance, in 2^-32.
const HALF: u32 = 1 << 31;

impl Boundary {
    /// The boundary of a box with corners 0 and `max`, for a mean spacing in 2^-16 lattice steps;
    /// `nested` as for Halton sets.
    pub(super) fn new(max: LatticePos, spacing_q16: u64, nested: bool) -> Self {
        let h = u128::from(spacing_q16);
        let rounded = |measure: u128, unit: u128| ((2 * measure + unit) / (2 * unit)) as u64;
        let line = if nested { NetAxis::Radical(Base::Two) } else { NetAxis::Even };
        let plane = if nested {
            [Base::Two, Base::Three].map(NetAxis::Radical)
        } else {
            [NetAxis::Even, NetAxis::Radical(Base::Two)]
        };
        let side = |axis: usize, high: u64| NetAxis::Fixed(if high == 1 { max[axis] } else { 0 });
        let (mut edges, mut faces) = (vec![], vec![]);
        for a in 0..3 {
            let (u, v) = ((a + 1) % 3, (a + 2) % 3);
            for part in 0..4 {
                let mut axes = [line; 3];
                (axes[u], axes[v]) = (side(u, part & 1), side(v, part >> 1));
                let n = rounded(u128::from(max[a]) << 16, h);
                edges.push(Net::new(axes, max, 1, n, HALF).named(PointClass::Edge, 12, 4 * a as u64 + part));
            }
            for part in 0..2 {
                let mut axes = [side(a, part); 3];
                (axes[u], axes[v]) = (plane[0], plane[1]);
                let n = rounded((u128::from(max[u]) * u128::from(max[v])) << 32, h * h);
                faces.push(Net::new(axes, max, 1, n, HALF).named(PointClass::Face, 6, 2 * a as u64 + part));
            }
        }
        Self { max, edges, faces }
    }

    fn nets(&self) -> impl Iterator<Item = &Net> {
        self.edges.iter().chain(&self.faces)
    }

    fn corner(&self, c: u64) -> LatticePos {
        std::array::from_fn(|a| if c >> a & 1 == 1 { self.max[a] } else { 0 })
    }

    /// Number of samples, before duplicates.
    pub(super) fn len(&self) -> u64 {
        8 + self.nets().map(Net::len).sum::<u64>()
    }

    /// The position of a sample; `None` when there is no such sample.
    pub(super) fn position(&self, class: PointClass, index: u64) -> Option<LatticePos> {
        match class {
            PointClass::Interior | PointClass::Explicit => None,
            PointClass::Edge => self.edges[(index % 12) as usize].position(index / 12),
            PointClass::Face => self.faces[(index % 6) as usize].position(index / 6),
            PointClass::Corner => (index < 8).then(|| self.corner(index)),
        }
    }

    /// Whether there is such a sample.
    pub(super) fn has(&self, class: PointClass, index: u64) -> bool {
        match class {
            PointClass::Interior | PointClass::Explicit => false,
            PointClass::Edge => index / 12 < self.edges[(index % 12) as usize].len(),
            PointClass::Face => index / 6 < self.faces[(index % 6) as usize].len(),
            PointClass::Corner => index < 8,
        }
    }

    /// The parts of a box of the domain that lie in a face of the domain, each position once.
    pub(super) fn sides_in(&self, b: &LatticeBox) -> Vec<LatticeBox> {
        let (mut rest, mut sides) = (*b, vec![]);
        for a in 0..3 {
            for at in [0, self.max[a]] {
                let mut side = rest;
                (side.lo[a], side.hi[a]) = (side.lo[a].max(at), side.hi[a].min(at + 1));
                if !side.is_empty() {
                    sides.push(side);
                }
            }
            (rest.lo[a], rest.hi[a]) = (rest.lo[a].max(1), rest.hi[a].min(self.max[a]));
        }
        sides
    }

    /// The number of samples in a box by its share of each side.
    pub(super) fn share_in(&self, b: &LatticeBox) -> f64 {
        self.corners_in(b).count() as f64 + self.nets().map(|n| n.share_in(b)).sum::<f64>()
    }

    fn corners_in(&self, b: &LatticeBox) -> impl Iterator<Item = Site> {
        (0..8)
            .map(|c| Site { id: PointId::new(PointClass::Corner, c), pos: self.corner(c) })
            .filter(|s| b.contains(s.pos))
    }

    /// About the number of samples in a box.
    pub(super) fn count_in(&self, b: &LatticeBox) -> u64 {
        self.corners_in(b).count() as u64 + self.nets().map(|n| n.count_in(b)).sum::<u64>()
    }

    /// Appends the samples in a box, in no particular order, duplicates included.
    pub(super) fn sites_in(&self, b: &LatticeBox, out: &mut Vec<Site>) {
        if (0..3).all(|a| b.lo[a] > 0 && b.hi[a] <= self.max[a]) {
            return;
        }
        self.nets().for_each(|n| n.sites_in(b, out));
        out.extend(self.corners_in(b));
    }
}
