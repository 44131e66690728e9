//! Halton sets whose density differs from place to place.
//!
//! A Halton sequence can be cut off anywhere: its first n points are evenly spread, and so are its
//! first 2n, which contain them. So where the [`Levels`] say l, the points are those k < n·2^l:
//!
//! ```text
//!  level 0   ·     ·        ·     k = 1 … n
//!  level 1   · ∘   ·   ∘    · ∘   k = 1 … 2n, in the cells of this level alone
//! ```
//!
//! A point is in the set or not by its own position, so nothing is shared between cells, and no
//! position occurs twice. Samples of the boundary follow: each edge and face has a Halton set of
//! its own, which a level cuts at the length that its density asks for.
//!
//! A box whose cells are of several levels is enumerated at the highest and sieved, or, where that
//! would find far too many, halved.

use super::levels::Levels;
use super::{PointSet, PointSpec};
use isospan_io::error::{Error, Result};
use isospan_io::geom::{Lattice, LatticeBox, PointId, Site};
use std::sync::Arc;

/// A set for each level, and where each is used.
#[derive(Clone, Debug)]
pub(super) struct Graded {
    levels: Arc<Levels>,
    /// For each level, the whole domain at its density.
    sets: Vec<PointSet>,
    len: u64,
    interior: u64,
}

/// More points at the highest level than this times those that are wanted: better halve the box.
const SIEVE: f64 = 1.8;
/// A box of fewer is not halved.
const FEW: f64 = 100.0;

impl Graded {
    pub(super) fn new(spec: PointSpec, lattice: Lattice, levels: Arc<Levels>) -> Result<Self> {
        let PointSpec::Halton { n } = spec else {
            return Err(Error::usage(format!(
                "only the Halton set can be denser in some places: a {} set has no such sequence",
                spec.kind()
            )));
        };
        if levels.cells().lattice != lattice {
            return Err(Error::usage("the levels are those of another lattice"));
        }
        let at = |level: u8| {
            let all = n.checked_mul(1 << level).filter(|&all| all <= super::MOST_POINTS);
            let many = || Error::usage(format!("{n} points at level 0 are too many at level {level}"));
            PointSet::new(PointSpec::Halton { n: all.ok_or_else(many)? }, lattice)
        };
        let sets = (0..=levels.top()).map(at).collect::<Result<_>>()?;
        let mut graded = Self { levels, sets, len: 0, interior: 0 };
        let (interior, boundary) = graded.shares(&lattice.domain());
        (graded.len, graded.interior) = ((interior + boundary).round() as u64, interior.round() as u64);
        Ok(graded)
    }

    pub(super) fn levels(&self) -> &Arc<Levels> {
        &self.levels
    }

    /// Number of points, by the volume of each level.
    pub(super) fn len(&self) -> u64 {
        self.len
    }

    pub(super) fn interior_len(&self) -> u64 {
        self.interior
    }

    /// About the number of points in a box of the domain.
    pub(super) fn count_in(&self, b: &LatticeBox) -> u64 {
        let (interior, boundary) = self.shares(b);
        (interior + boundary).round() as u64
    }

    /// About the numbers of interior points and of boundary samples in a box. Sums of
    /// floating-point numbers, in one order.
    fn shares(&self, b: &LatticeBox) -> (f64, f64) {
        let (mut interior, mut boundary) = (0.0, 0.0);
        self.levels.runs(b, |level, run| interior += self.set(level).interior.share_in(run));
        for side in self.finest().boundary.iter().flat_map(|s| s.sides_in(b)) {
            self.levels.runs(&side, |level, run| boundary += self.set(level).boundary_share_in(run));
        }
        (interior, boundary)
    }

    fn set(&self, level: u8) -> &PointSet {
        &self.sets[usize::from(level)]
    }

    pub(super) fn finest(&self) -> &PointSet {
        self.sets.last().expect("there is a level")
    }

    /// Whether the set has a point of the finest one.
    #[inline]
    pub(super) fn has(&self, site: &Site) -> bool {
        self.set(self.levels.at(site.pos)).has_id(site.id)
    }

    /// Appends the points in a box of the domain, in no particular order and with duplicate
    /// positions.
    pub(super) fn append_in(&self, b: &LatticeBox, found: &mut Vec<Site>, out: &mut Vec<Site>) {
        if b.is_empty() {
            return;
        }
        let spread = self.levels.spread(b);
        let set = self.set(spread.top);
        if spread.least < spread.top {
            let dense = set.interior.share_in(b);
            let mut wanted = 0.0;
            self.levels.runs(b, |level, run| wanted += self.set(level).interior.share_in(run));
            if let Some((low, high)) = self.halves(b).filter(|_| dense > FEW && dense > SIEVE * wanted) {
                self.append_in(&low, found, out);
                return self.append_in(&high, found, out);
            }
        }
        set.candidates_in(b, found);
        out.extend(found.iter().filter(|s| spread.least == spread.top || self.has(s)));
    }

    /// A box of several cells cut between two of them.
    fn halves(&self, b: &LatticeBox) -> Option<(LatticeBox, LatticeBox)> {
        let (lo, hi) = self.levels.cells_of(b);
        let axis = (0..3).max_by_key(|&a| hi[a] - lo[a]).filter(|&a| hi[a] - lo[a] > 1)?;
        let mut middle = lo;
        middle[axis] = lo[axis].midpoint(hi[axis]);
        let cut = self.levels.cells().lattice_box(middle, middle.map(|c| c + 1)).lo[axis];
        let (mut low, mut high) = (*b, *b);
        (low.hi[axis], high.lo[axis]) = (cut, cut);
        Some((low, high))
    }

    /// The mean spacing at the coarsest cells on each side of a box, low sides first.
    pub(super) fn spacing_around(&self, b: &LatticeBox) -> [[u32; 3]; 2] {
        let least = self.levels.least_at_faces(b);
        least.map(|side| std::array::from_fn(|a| self.set(side[a]).mean_spacing()[a]))
    }

    /// The position of a point, if the set has it.
    pub(super) fn position(&self, id: PointId) -> Option<isospan_io::geom::LatticePos> {
        let pos = self.finest().position(id)?;
        self.has(&Site { id, pos }).then_some(pos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan_io::grid::BrickGrid;
    use std::collections::BTreeSet;

    fn graded(dims: [u64; 3], n: u64, peaks: &[(u64, u8)]) -> PointSet {
        let lattice = Lattice::new(dims).unwrap();
        let cells = BrickGrid::new(lattice, [4; 3]);
        let mut levels = vec![0u8; cells.len() as usize];
        peaks.iter().for_each(|&(c, l)| levels[c as usize] = l);
        Levels::grade(&cells, &mut levels);
        let levels = Arc::new(Levels::new(cells, levels).unwrap());
        PointSet::graded(PointSpec::Halton { n }, lattice, levels).unwrap()
    }

    /// The set by its definition: the points of each level's set that lie in its cells.
    fn by_the_definition(set: &PointSet, n: u64, b: &LatticeBox) -> BTreeSet<(u64, [u32; 3])> {
        let levels = set.levels().unwrap();
        let mut all = BTreeSet::new();
        for level in 0..=levels.top() {
            let whole = PointSet::new(PointSpec::Halton { n: n << level }, *set.lattice()).unwrap();
            let mut sites = vec![];
            whole.candidates_in(b, &mut sites);
            all.extend(sites.iter().filter(|s| levels.at(s.pos) == level).map(|s| (s.id.0, s.pos)));
        }
        all
    }

    #[test]
    fn boxes_find_the_points_of_their_cells_levels() {
        for (n, peaks) in [(3, vec![(0, 8), (290, 6)]), (400, vec![(77, 3)]), (20, vec![])] {
            let set = graded([33, 30, 27], n, &peaks);
            let domain = set.lattice().domain();
            let s = set.lattice().log2_steps[0];
            let boxes = [
                domain,
                LatticeBox { lo: [3 << s, 5 << s, 0], hi: [19 << s, 20 << s, 9 << s] },
                LatticeBox { lo: [0, 0, 0], hi: [1, 30 << s, 30 << s] },
                LatticeBox { lo: [12 << s; 3], hi: [(12 << s) + 5; 3] },
            ];
            for b in boxes.map(|b| b.intersect(&domain)) {
                let mut sites = vec![];
                set.candidates_in(&b, &mut sites);
                let found: BTreeSet<_> = sites.iter().map(|s| (s.id.0, s.pos)).collect();
                assert_eq!(found.len(), sites.len(), "each once");
                assert_eq!(found, by_the_definition(&set, n, &b), "{n} {b:?}");
                let (count, found) = (set.count_in(&b) as f64, found.len() as f64);
                assert!((count - found).abs() <= 12.0 + 0.2 * found, "{count} {found}");
            }
        }
    }

    #[test]
    fn positions_are_those_of_points_that_are_there() {
        let set = graded([33, 30, 27], 20, &[(100, 6)]);
        let mut sites = vec![];
        set.sites_in(&set.lattice().domain(), &mut sites);
        assert!(sites.iter().all(|s| set.position(s.id) == Some(s.pos)));
        let ids: BTreeSet<u64> = sites.iter().map(|s| s.id.0).collect();
        let others =
            (0..20 << 6).filter(|i| !ids.contains(i)).filter(|&i| set.position(PointId(i)).is_some());
        assert_eq!(others.count(), 0, "no two of so few points are on one position");
        assert!((set.len() as f64 / sites.len() as f64 - 1.0).abs() < 0.1, "{} {}", set.len(), sites.len());
    }

    #[test]
    fn halos_are_as_wide_as_the_coarsest_cells_ask() {
        let set = graded([65, 65, 65], 8, &[(0, 9)]);
        let s = set.lattice().log2_steps[0];
        let whole = set.spacing_around(&set.lattice().domain());
        let corner = set.spacing_around(&LatticeBox { lo: [0; 3], hi: [4 << s; 3] });
        assert_eq!(whole[0], whole[1]);
        assert!((0..3).all(|a| corner[1][a] < whole[1][a] / 3), "{corner:?} {whole:?}");
    }

    #[test]
    fn other_sets_are_refused() {
        let lattice = Lattice::new([9, 9, 9]).unwrap();
        let cells = BrickGrid::new(lattice, [4; 3]);
        let levels = Arc::new(Levels::new(cells, vec![0; 8]).unwrap());
        let other = PointSpec::Hammersley { n: 9, shift: 0.5 };
        let error = PointSet::graded(other, lattice, levels).unwrap_err();
        assert!(error.to_string().contains("Halton"), "{error}");
    }
}
