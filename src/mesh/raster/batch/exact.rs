//! Exact weights of candidates, and the tie rule.

use super::MEMBERS;
use super::boxes::Scene;
use crate::raster::planes::Planes;

/// Positions are cut into a high and a low part at multiples of this.
const CUT: f64 = 1024.0;
/// Added to a number below 2^51 and taken away, it rounds to an integer.
const ROUND: f64 = 1.5 * (1u64 << 52) as f64;

/// Samples that may be members: what decides it.
pub(super) struct Candidates {
    pub(super) edges: [[[f32; MEMBERS]; 3]; 3],
    /// From corner a.
    pub(super) at: [[f32; MEMBERS]; 3],
    /// The least of the four exact λ.
    pub(super) least: [f64; MEMBERS],
}

impl Candidates {
    /// Computes the weights of the first ones, and the least λ of each.
    #[inline(always)]
    pub(super) fn decide(&mut self, weights: &mut [[f64; MEMBERS]; 4], count: usize) {
        let [b, c, d] = &self.edges;
        for i in 0..count.next_multiple_of(8).min(MEMBERS) {
            let [b, c, d] = [b, c, d].map(|e| [0, 1, 2].map(|k| f64::from(e[k][i])));
            let r = [0, 1, 2].map(|k| f64::from(self.at[k][i]));
            let (gb, gc, gd) = (cross_of(c, d), cross_of(d, b), cross_of(b, c));
            let cut = |p: [f64; 3]| {
                let high = p.map(|x| (x * (1.0 / CUT) + ROUND) - ROUND);
                (high, [0, 1, 2].map(|k| p[k] - high[k] * CUT))
            };
            let ((rh, rl), (eh, el)) = (cut(r), cut(b));
            let parts = |g: [f64; 3]| (dot_of(g, rh), dot_of(g, rl));
            let (pb, pc, pd) = (parts(gb), parts(gc), parts(gd));
            let whole = (dot_of(gb, eh), dot_of(gb, el));
            let pa = (whole.0 - (pb.0 + pc.0 + pd.0), whole.1 - (pb.1 + pc.1 + pd.1));
            let joined = |(high, low): (f64, f64)| high * CUT + low;
            let unit = 1.0 / joined(whole);
            let lambda = [joined(pa), joined(pb), joined(pc), joined(pd)];
            for (weights, lambda) in weights.iter_mut().zip(lambda) {
                weights[i] = lambda * unit;
            }
            let [la, lb, lc, ld] = lambda;
            let order = |x: f64, y: f64| if x < y { x } else { y };
            self.least[i] = order(order(la, lb), order(lc, ld));
        }
    }

    /// Where a candidate is from corner a, in lattice steps.
    pub(super) fn place(&self, i: usize) -> [i32; 3] {
        [0, 1, 2].map(|k| self.at[k][i] as i32)
    }
}

/// The tie rule, in integers.
#[inline(never)]
pub(super) fn wins_tie(scene: &Scene<'_>, tet: u32, from_a: [i32; 3]) -> bool {
    let corners = scene.corners(tet);
    let p = std::array::from_fn(|k| (corners[0][k] as i32 + from_a[k]) as u32);
    let planes = Planes::<i64>::new(corners);
    planes.has(planes.at(p), p, scene.scanner.far())
}

#[inline(always)]
fn cross_of(u: [f64; 3], v: [f64; 3]) -> [f64; 3] {
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

#[inline(always)]
fn dot_of(u: [f64; 3], v: [f64; 3]) -> f64 {
    u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
}
