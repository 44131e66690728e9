//! The sums of a step, while they are made.
//!
//! Knots are looked at eight by eight, from the first one in a tetrahedron's range: most ranges
//! have no more, so that the machine can predict what comes next. Eights that begin at different
//! knots overlap; each has sums of its own, so that what is read is what was written, and the
//! processor need not wait for parts of two writes. In the end the eight sums of a knot are added
//! up.
//!
//! Active tetrahedra are counted at their corners: one more at the least, one less at the largest.
//! Only when all have been counted it is asked where the corners lie among the isovalues; a vertex
//! has some two dozen tetrahedra.

use super::design::{Design, MOST_KNOTS, VOID};
use super::grid::{BinaryPlaces, Places};
use super::part::{ChunkPart, Measured};
use super::tetra::{KNOTS, KnotPieces, KnotSums, PiecesOf};
use isospan_mesh::simd::F64s;

const CUTS: usize = MOST_KNOTS as usize;
const _: () = assert!(CUTS.is_power_of_two() && CUTS < VOID as usize);

/// The sums of a step, in one piece: so those of the next one are found without a look elsewhere.
#[repr(C, align(64))]
pub(super) struct Sums {
    /// The sums at the knots from each one on, of tetrahedra whose least value has this many knots
    /// at or below it.
    cuts: [KnotSums; CUTS],
    /// Isovalues, and behind the last one those that would follow.
    knots: [f64; CUTS + KNOTS],
    /// Volume of tetrahedra whose least value has this many knots at or below it; the last is that
    /// of void ones.
    whole: [f64; VOID as usize + 1],
}

impl Sums {
    /// Empty sums, at isovalues, if there are any.
    pub(super) fn new(design: Option<&Design>) -> Self {
        let mut knots = [0.0; CUTS + KNOTS];
        if let Some(design) = design {
            let (mut last, step) = (0.0, design.knots.step.size());
            for (n, knot) in knots.iter_mut().enumerate() {
                let is_there = n < design.knots.count as usize;
                last = if is_there { f64::from(design.knots.value(n as u32)) } else { last + step };
                *knot = last;
            }
        }
        Self { cuts: [KnotSums::default(); CUTS], knots, whole: [0.0; VOID as usize + 1] }
    }

    /// Adds a tetrahedron of this volume: one of some.
    #[inline(always)]
    pub(super) fn add<W: F64s>(&mut self, token: W::Token, of: &PiecesOf, lane: usize, volume: f64) {
        let below = usize::from(of.below(lane));
        self.whole[below] += volume;
        if of.flat >> lane & 1 != 0 {
            return;
        }
        let from = below % CUTS;
        let knots = self.knots[from..].first_chunk().expect("there are more behind the last");
        let most = of.most(lane);
        KnotPieces::<W>::new(token, of, lane).add(token, volume, most, knots, &mut self.cuts[from]);
        if of.steep >> lane & 1 != 0 {
            let pieces = KnotPieces::<W>::new(token, of, lane);
            for from in (from + KNOTS..CUTS).step_by(KNOTS) {
                if self.knots[from] > most {
                    break;
                }
                let knots = self.knots[from..].first_chunk().expect("there are more behind the last");
                pieces.add(token, volume, most, knots, &mut self.cuts[from]);
            }
        }
    }

    /// The part of the chunk when all tetrahedra have been added; `tetrahedra` of them are not
    /// void.
    pub(super) fn finish(&self, tetrahedra: u64, design: Design, ends: &Ends) -> ChunkPart {
        let count = design.knots.count as usize;
        let at = |k: usize| {
            let first = (k + 1).saturating_sub(KNOTS);
            self.cuts[first..=k].iter().enumerate().fold([0.0; 3], |[area, inside, slope], (n, cut)| {
                let lane = k - first - n;
                [area + cut.area[lane], inside + cut.inside[lane], slope + cut.slope[lane]]
            })
        };
        let mut sums: Vec<[f64; 3]> = (0..count).map(at).collect();
        // Tetrahedra that lie inside as a whole: those whose least value is at or above the knot.
        let mut whole = 0.0;
        for (sum, volume) in sums.iter_mut().zip(&self.whole[1..=count]).rev() {
            whole += volume;
            sum[1] += whole;
        }
        let (active, levels) = (counts(&ends.knots), counts(&ends.levels));
        let measured = Measured { design, active, sums, levels };
        ChunkPart { tetrahedra, volume: whole + self.whole[0], measured: Some(measured) }
    }
}

/// Minima less maxima of tetrahedra, by the number of knots, and of levels, at or below them.
pub(super) struct Ends {
    knots: Vec<i64>,
    levels: Vec<i64>,
    knot_places: BinaryPlaces,
    level_places: Places,
}

impl Ends {
    pub(super) fn new(design: &Design) -> Self {
        let none = |count: u32| vec![0; count as usize + 1];
        Self {
            knots: none(design.knots.count),
            levels: none(design.levels.count),
            knot_places: BinaryPlaces::new(&design.knots),
            level_places: Places::new(&design.levels),
        }
    }

    /// Adds those at a vertex.
    #[inline(always)]
    pub(super) fn add(&mut self, value: f32, ends: i32) {
        // A vertex of void tetrahedra alone may have any value.
        if ends != 0 {
            self.knots[self.knot_places.of(value) as usize] += i64::from(ends);
            self.levels[self.level_places.of(value) as usize] += i64::from(ends);
        }
    }
}

/// How many tetrahedra are active at each isovalue.
pub(super) fn counts(ends: &[i64]) -> Vec<u64> {
    let mut active = 0;
    let count = |n: &i64| {
        active += n;
        u64::try_from(active).expect("a tetrahedron's minimum is not above its maximum")
    };
    // A value above all isovalues does not count for any.
    ends[..ends.len() - 1].iter().map(count).collect()
}
