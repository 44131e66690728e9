//! Point sets, enumerated box by box.
//!
//! | set | points of the unit cube | module |
//! |---|---|---|
//! | Hammersley | ((k+t)/n, Φ₂(k), Φ₃(k)), k = 0 … n-1 | `net` |
//! | Halton | (Φ₂(k), Φ₃(k), Φ₅(k)), k = 1 … n | `net` |
//! | hyperbolic cross | union of dyadic grids whose levels satisfy an inequality | `grids` |
//! | regular | a sub-grid of the voxels, faces included | `grids` |
//!
//! scaled to the domain box and rounded to its [`Lattice`], halves up, in integers throughout. All
//! but the regular set get samples of the domain's boundary besides (`boundary`),
//! and a set may have a list of points that follow no formula ([`ExplicitPoints`]). The own
//! vertices of a mesh are such a list and nothing else ([`PointSpec::Own`]). A Halton set may be
//! denser in some places than in others ([`Levels`], `graded`).
//!
//! A point is its [`PointId`]: [`PointSet::position`] is a formula, so positions need not be
//! stored. And a box finds its own points ([`PointSet::sites_in`]) from the formula, in a set of
//! any size: no pass over all points, nothing shared between boxes, the same answer in any order
//! and on any machine. The union over boxes that tile the domain is the whole set, each position
//! once; where two points round to one position, the lower id stays.
//!
//! ```
//! use isospan_io::geom::Lattice;
//! use isospan_mesh::points::{PointSet, PointSpec};
//!
//! let lattice = Lattice::new([128, 128, 64])?;
//! let set = PointSet::new(PointSpec::Hammersley { n: 10_000, shift: 0.5 }, lattice)?;
//! let mut sites = vec![];
//! set.sites_in(&lattice.domain(), &mut sites);
//! assert!(sites.iter().all(|s| set.position(s.id) == Some(s.pos)));
//! # Ok::<(), isospan_io::Error>(())
//! ```
//!
//! Cost of [`PointSet::sites_in`] for a box of a thousand points: about 10 ns a point to find it,
//! as much to sort; memory for the answer and its sort. References: Hammersley (1960); Halton
//! (1960); Temlyakov (1987); Niederreiter (1992).

mod boundary;
mod explicit;
mod graded;
mod grids;
mod levels;
mod net;
mod order;
mod radical_inverse;
mod spec;

pub use explicit::ExplicitPoints;
pub use levels::Levels;
pub use levels::cell_voxels;
pub use radical_inverse::{RadicalInverse, radical_inverse};
pub use spec::{PointSpec, SetKind, SetSettings};

use boundary::Boundary;
use graded::Graded;
use grids::Grids;
use isospan_io::error::{Error, Result};
use isospan_io::geom::{Lattice, LatticeBox, LatticePos, PointClass, PointId, Site};
use net::{Net, NetAxis};
use radical_inverse::Base;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// The most interior points a set may have: 2^59.
pub const MOST_POINTS: u64 = 1 << 59;

/// A point set on a lattice. Small, and immutable: share it between threads.
#[derive(Clone, Debug)]
pub struct PointSet {
    spec: PointSpec,
    lattice: Lattice,
    interior: Interior,
    boundary: Option<Boundary>,
    explicit: Option<Arc<ExplicitPoints>>,
    /// Where the density differs from place to place: then the rest is that of the highest level.
    graded: Option<Arc<Graded>>,
    /// (V/n)^(1/3) in 2^-16 lattice steps.
    spacing_q16: u64,
    order_bits: u32,
}

#[derive(Clone, Debug)]
enum Interior {
    Net(Net),
    Grids(Grids),
    /// All points are listed.
    Nothing,
}

impl PointSet {
    /// The set of a specification on a lattice.
    ///
    /// # Errors
    /// As [`PointSpec::check`].
    pub fn new(spec: PointSpec, lattice: Lattice) -> Result<Self> {
        spec.check(&lattice)?;
        let spec = spec.canonical();
        let interior = Interior::new(&spec, &lattice)
            .ok_or_else(|| Error::usage(format!("a {} set has at most {MOST_POINTS} points", spec.kind())))?;
        let points = if let PointSpec::Own { n } = spec { n } else { interior.len() };
        let spacing_q16 = mean_spacing_q16(&lattice, points);
        let boundary = match spec {
            PointSpec::Regular { .. }
            | PointSpec::Pyramid { .. }
            | PointSpec::Labels { .. }
            | PointSpec::Own { .. } => None,
            PointSpec::Halton { .. } => Some(Boundary::new(lattice.max(), spacing_q16, true)),
            PointSpec::Hammersley { .. } | PointSpec::HyperbolicCross { .. } => {
                Some(Boundary::new(lattice.max(), spacing_q16, false))
            }
        };
        let order_bits = order_bits(spacing_q16);
        Ok(Self { spec, lattice, interior, boundary, explicit: None, graded: None, spacing_q16, order_bits })
    }

    /// The Halton set that has, where the levels say l, the points of the first n·2^l that lie
    /// there; n is that of `spec`.
    ///
    /// # Errors
    /// [`Error::Usage`] for a set of another kind, for levels of another lattice, and for more than
    /// [`MOST_POINTS`].
    pub fn graded(spec: PointSpec, lattice: Lattice, levels: Arc<Levels>) -> Result<Self> {
        let graded = Graded::new(spec, lattice, levels)?;
        Ok(Self { spec, graded: Some(Arc::new(graded.clone())), ..graded.finest().clone() })
    }

    /// The levels of a set whose density differs from place to place.
    pub fn levels(&self) -> Option<&Arc<Levels>> {
        self.graded.as_ref().map(|g| g.levels())
    }

    /// The same set and a list of points besides, without the points that are too near to those:
    /// [`ExplicitPoints::clearing`].
    #[must_use]
    pub fn with_explicit(self, points: Arc<ExplicitPoints>) -> Self {
        Self { explicit: Some(points), ..self }
    }

    /// The points that are listed, if any.
    pub fn explicit(&self) -> Option<&ExplicitPoints> {
        self.explicit.as_deref()
    }

    /// Whether its points lie as dense everywhere, and no more of them than by chance on a plane or
    /// a sphere, but for the domain's faces.
    pub fn is_even(&self) -> bool {
        matches!(self.spec, PointSpec::Hammersley { .. } | PointSpec::Halton { .. })
            && self.graded.is_none()
            && self.explicit.is_none()
    }

    /// Whether its points are the own vertices of a mesh.
    pub fn is_own(&self) -> bool {
        matches!(self.spec, PointSpec::Own { .. })
    }

    /// The specification that the set was made from.
    pub fn spec(&self) -> &PointSpec {
        &self.spec
    }

    /// The lattice of its positions.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Number of points, interior and boundary, before those that round to one position become one;
    /// about that number where the density differs from place to place.
    pub fn len(&self) -> u64 {
        let listed = self.explicit.as_ref().map_or(0, |e| e.len());
        if let Some(graded) = &self.graded {
            return graded.len() + listed;
        }
        self.interior.len() + self.boundary.as_ref().map_or(0, Boundary::len) + listed
    }

    /// Number of points that are no boundary samples.
    pub fn interior_len(&self) -> u64 {
        self.graded.as_ref().map_or(self.interior.len(), |g| g.interior_len())
    }

    /// Never true: a set has at least one point, once the listed ones are there.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The number of points in a box, without enumerating them. Interior points of the three kinds
    /// of grids are counted exactly (before duplicates), all others by their share of the domain's
    /// volume, area or length, which for a low-discrepancy set is right to a few points. The same
    /// answer always.
    pub fn count_in(&self, b: &LatticeBox) -> u64 {
        let b = b.intersect(&self.lattice.domain());
        if b.is_empty() {
            return 0;
        }
        let listed = self.explicit.as_ref().map_or(0, |e| e.count_in(&b));
        if let Some(graded) = &self.graded {
            return graded.count_in(&b) + listed;
        }
        let interior = match &self.interior {
            Interior::Net(net) => net.count_in(&b),
            Interior::Grids(grids) => grids.count_in(&b),
            Interior::Nothing => 0,
        };
        interior + self.boundary.as_ref().map_or(0, |s| s.count_in(&b)) + listed
    }

    /// Replaces `out` by all sites whose position lies in the box: each position once, with the
    /// lowest of its ids (of own vertices all), sorted along a Hilbert curve through the box, with
    /// cells at most as wide as [`PointSet::order_bits`] says, then by x, y, z.
    pub fn sites_in(&self, b: &LatticeBox, out: &mut Vec<Site>) {
        self.candidates_in(b, out);
        let repeats = self.is_own();
        order::sort_and_dedup(out, &b.intersect(&self.lattice.domain()), self.order_bits(), repeats);
    }

    /// As [`PointSet::sites_in`], but in no particular order and with duplicate positions: for a
    /// caller that merges several boxes, and to measure the enumeration alone.
    pub fn candidates_in(&self, b: &LatticeBox, out: &mut Vec<Site>) {
        out.clear();
        let b = b.intersect(&self.lattice.domain());
        if b.is_empty() {
            return;
        }
        if let Some(graded) = &self.graded {
            graded.append_in(&b, &mut vec![], out);
        } else {
            self.append_even(&b, out);
        }
        if let Some(explicit) = &self.explicit {
            let level = |pos| self.levels().map_or(0, |levels| levels.at(pos));
            explicit.drop_near(&self.lattice.domain(), &b, out, level);
            explicit.sites_in(&b, out);
        }
    }

    /// Appends the points in a box of the domain that follow a formula, of a set whose density is
    /// the same everywhere.
    fn append_even(&self, b: &LatticeBox, out: &mut Vec<Site>) {
        match &self.interior {
            Interior::Net(net) => net.sites_in(b, out),
            Interior::Grids(grids) => grids.sites_in(b, out),
            Interior::Nothing => {}
        }
        if let Some(boundary) = &self.boundary {
            boundary.sites_in(b, out);
        }
    }

    /// Whether a set whose density is the same everywhere has a point with this id, which follows a
    /// formula.
    fn has_id(&self, id: PointId) -> bool {
        match (id.class(), &self.boundary) {
            (Some(PointClass::Interior), _) => id.index() < self.interior.len(),
            (Some(class), Some(boundary)) => boundary.has(class, id.index()),
            _ => false,
        }
    }

    /// About the number of boundary samples in a box of the domain.
    fn boundary_share_in(&self, b: &LatticeBox) -> f64 {
        self.boundary.as_ref().map_or(0.0, |s| s.share_in(b))
    }

    /// The position of a point; `None` for an id that the set does not have (from a damaged file).
    pub fn position(&self, id: PointId) -> Option<LatticePos> {
        if let (Some(graded), true) = (&self.graded, id.class()? != PointClass::Explicit) {
            return graded.position(id);
        }
        match id.class()? {
            PointClass::Interior => match &self.interior {
                Interior::Net(net) => net.position(id.index()),
                Interior::Grids(grids) => grids.position(id.index()),
                Interior::Nothing => None,
            },
            PointClass::Explicit => self.explicit.as_ref()?.position(id.index()),
            class => self.boundary.as_ref()?.position(class, id.index()),
        }
    }

    /// The mean distance of interior points along each axis, in lattice steps, rounded up:
    /// (V/n)^(1/3), or the pitch of a regular set; where the density differs, that of its highest
    /// level.
    pub fn mean_spacing(&self) -> [u32; 3] {
        match self.spec {
            PointSpec::Regular { counts }
            | PointSpec::Pyramid { dims: counts, .. }
            | PointSpec::Labels { dims: counts } => {
                let max = self.lattice.max();
                std::array::from_fn(|a| u64::from(max[a]).div_ceil(counts[a] - 1) as u32)
            }
            PointSpec::Hammersley { .. }
            | PointSpec::Halton { .. }
            | PointSpec::HyperbolicCross { .. }
            | PointSpec::Own { .. } => [self.spacing_q16.div_ceil(1 << 16) as u32; 3],
        }
    }

    /// [`PointSet::mean_spacing`] on each side of a box, low sides first: where the density
    /// differs, that of the coarsest cells at the face. For choosing halos.
    pub fn spacing_around(&self, b: &LatticeBox) -> [[u32; 3]; 2] {
        match &self.graded {
            Some(graded) => graded.spacing_around(b),
            None => [self.mean_spacing(); 2],
        }
    }

    /// Bits an axis of a Hilbert curve through the whole lattice with cells as wide as those of the
    /// curves that order sites, at most: a quarter to a half of the mean spacing, so that few
    /// points share one and keys are short.
    pub fn order_bits(&self) -> u32 {
        self.order_bits
    }

    /// The same set, with its sites ordered by curves of `bits` bits: to order them as those of
    /// another set.
    ///
    /// # Errors
    /// [`Error::Usage`] for none, or more than a position has.
    pub fn ordered_by(self, bits: u32) -> Result<Self> {
        if !ORDER_BITS.contains(&bits) {
            return Err(Error::usage(format!("sites are ordered by 1 to 21 bits an axis, not {bits}")));
        }
        Ok(Self { order_bits: bits, ..self })
    }
}

/// Bits that a key can have, an axis.
const ORDER_BITS: RangeInclusive<u32> = 1..=21;

fn order_bits(spacing_q16: u64) -> u32 {
    let log2_spacing = (spacing_q16 >> 16).max(1).ilog2();
    (24 + 1u32).saturating_sub(log2_spacing).clamp(*ORDER_BITS.start(), *ORDER_BITS.end())
}

impl Interior {
    /// `None` when there are more points than [`MOST_POINTS`].
    fn new(spec: &PointSpec, lattice: &Lattice) -> Option<Self> {
        let max = lattice.max();
        let [two, three, five] = [Base::Two, Base::Three, Base::Five].map(NetAxis::Radical);
        Some(match *spec {
            PointSpec::Hammersley { n, shift } => {
                Self::Net(Net::new([NetAxis::Even, two, three], max, 0, n, spec::shift_q32(shift)))
            }
            PointSpec::Halton { n } => Self::Net(Net::new([two, three, five], max, 1, n, 0)),
            PointSpec::HyperbolicCross { m, k, r } => Self::Grids(Grids::hyperbolic_cross(m, k, r, lattice)?),
            PointSpec::Regular { counts }
            | PointSpec::Pyramid { dims: counts, .. }
            | PointSpec::Labels { dims: counts } => Self::Grids(Grids::regular(counts, lattice)?),
            PointSpec::Own { .. } => Self::Nothing,
        })
    }

    /// The number of points by the share of the volume.
    fn share_in(&self, b: &LatticeBox) -> f64 {
        match self {
            Self::Net(net) => net.share_in(b),
            Self::Grids(grids) => grids.count_in(b) as f64,
            Self::Nothing => 0.0,
        }
    }

    fn len(&self) -> u64 {
        match self {
            Self::Net(net) => net.len(),
            Self::Grids(grids) => grids.len(),
            Self::Nothing => 0,
        }
    }
}

/// (V/n)^(1/3) in 2^-16 lattice steps, in integers because the number of boundary samples depends
/// on it; at least a step.
fn mean_spacing_q16(lattice: &Lattice, n: u64) -> u64 {
    let volume: u128 = lattice.max().iter().map(|&m| u128::from(m)).product();
    // V has 72 bits, (V·2^48)/n at most 120.
    cube_root((volume << 48) / u128::from(n)).max(1 << 16)
}

/// ⌊x^(1/3)⌋ for x < 2^123, bit by bit.
fn cube_root(x: u128) -> u64 {
    let mut root = 0u128;
    for bit in (0..41).rev() {
        let next = root | 1 << bit;
        if next * next * next <= x {
            root = next;
        }
    }
    root as u64
}

#[cfg(test)]
mod tests;
