//! The sums of a step, while they are made.
//!
//! Knots are looked at eight by eight, from the first one in a tetrahedron's range: most ranges have no more, so that the machine can foretell what comes next.
//! Eights that begin at different knots overlap; each has sums of its own, so that what is read is what was written, and the processor need
//! not wait for parts of two writes. In the end the eight sums of a knot are added up.

use super::design::Design;
use super::measure::{ChunkPart, Measured};
use super::tetra::{Cut, KNOTS, Pieces, PiecesOfFour, VOLUME};
use crate::exec::lanes::Wide;

/// How many knots, or levels, are at or below a void value: more than there are.
pub(super) const VOID: u16 = u16::MAX;

/// Where the values of a tetrahedron lie, from the least to the largest.
#[derive(Clone, Copy, Default)]
pub(super) struct Span {
    pub(super) knots: [u16; 2],
    pub(super) levels: [u16; 2],
}

/// The sums.
pub(super) struct Sums {
    /// Isovalues, and behind the last one such as would follow.
    knots: Vec<f64>,
    tetrahedra: u64,
    /// At the knots from each one on, of tetrahedra whose least value has so many knots at or below it.
    cuts: Vec<Cut>,
    /// Volume of such tetrahedra.
    whole: Vec<f64>,
    /// Minima less maxima that have so many knots, so many levels at or below them.
    ends: Vec<i64>,
    level_ends: Vec<i64>,
}

impl Sums {
    pub(super) fn new(design: &Design) -> Self {
        let (count, levels) = (design.knots.count as usize, design.levels.count as usize);
        let mut knots: Vec<f64> = design.knots.values().into_iter().map(f64::from).collect();
        if let Some(&last) = knots.last() {
            let step = design.knots.step.size();
            knots.extend((1..=KNOTS).map(|n| last + n as f64 * step));
        }
        Self {
            knots,
            tetrahedra: 0,
            cuts: vec![Cut::default(); count],
            whole: vec![0.0; count + 1],
            ends: vec![0; count + 1],
            level_ends: vec![0; levels + 1],
        }
    }

    /// Adds a tetrahedron, unless it is void: one of four.
    #[inline(always)]
    pub(super) fn add<W: Wide>(&mut self, proof: W::Proof, span: Span, four: &PiecesOfFour, lane: usize) {
        let ([lo, hi], [low, high]) = (span.knots.map(usize::from), span.levels.map(usize::from));
        if hi == usize::from(VOID) {
            return;
        }
        self.tetrahedra += 1;
        self.level_ends[low] += 1;
        self.level_ends[high] -= 1;
        self.ends[lo] += 1;
        self.ends[hi] -= 1;
        self.whole[lo] += four[VOLUME][lane];
        if lo == hi {
            return;
        }
        let pieces = Pieces::<W>::new(proof, four, lane);
        for from in (lo..hi).step_by(KNOTS) {
            let knots = self.knots[from..].first_chunk().expect("there are more behind the last");
            pieces.add(proof, knots, hi - from, &mut self.cuts[from]);
        }
    }

    /// What is known when all tetrahedra have been added.
    pub(super) fn finish(self, design: Design) -> ChunkPart {
        let counts = |ends: &[i64]| {
            let mut active = 0;
            let count = |n: &i64| {
                active += n;
                u64::try_from(active).expect("a tetrahedron's minimum is not above its maximum")
            };
            // What is above all isovalues does not count for any.
            ends[..ends.len() - 1].iter().map(count).collect()
        };
        let at = |k: usize| {
            let first = (k + 1).saturating_sub(KNOTS);
            self.cuts[first..=k].iter().enumerate().fold([0.0; 3], |[area, inside, slope], (n, cut)| {
                let lane = k - first - n;
                [area + cut.area[lane], inside + cut.inside[lane], slope + cut.slope[lane]]
            })
        };
        let mut sums: Vec<[f64; 3]> = (0..self.cuts.len()).map(at).collect();
        // Tetrahedra that lie inside as a whole: those whose least value is at or above the knot.
        let mut whole = 0.0;
        for (sum, volume) in sums.iter_mut().zip(&self.whole[1..]).rev() {
            whole += volume;
            sum[1] += whole;
        }
        let measured =
            Measured { design, active: counts(&self.ends), sums, levels: counts(&self.level_ends) };
        ChunkPart { tetrahedra: self.tetrahedra, volume: whole + self.whole[0], measured: Some(measured) }
    }
}
