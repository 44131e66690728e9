//! How the tetrahedra of a chunk, in the order of their first vertices, are cut into blocks.
//!
//! A question about an isovalue decodes the blocks that the surface may cross. A flat surface at
//! any place crosses a box in proportion to its mean width (Crofton's formula), which is half the
//! sum of its three edges. So the cuts are those with the least
//!
//! ```text
//!  sum over blocks of   (sum of the edges of the box around it)  ·  (its tetrahedra + what a block costs by itself, in tetrahedra)
//! ```
//!
//! They are found by dynamic programming, in steps of a few vertices. Such blocks are eighths and
//! quarters of cubes rather than equal lengths of the curve along which vertices are sorted. So
//! fewer blocks are read, less of them in vain, and they have fewer vertices of others.

use glam::{UVec3, Vec4};
use isospan_io::geom::LatticePos;
use isospan_mesh::mesh::tet::Tet;

/// Steps in a block of the size asked for.
const STEPS: u32 = 16;
/// The cost of a block by itself, as a part of the tetrahedra asked for: its head, its entry in the
/// index, a vertex of others for each second tetrahedron.
const BLOCK_COST: u64 = 2;

/// Some tetrahedra that follow each other.
#[derive(Clone, Copy)]
struct Step {
    end: u32,
    lo: LatticePos,
    hi: LatticePos,
}

impl Step {
    /// Around nothing.
    const NONE: Self = Self { end: 0, lo: [u32::MAX; 3], hi: [0; 3] };

    #[inline(always)]
    fn between(end: u32, lo: Vec4, hi: Vec4) -> Self {
        Self { end, lo: lo.truncate().as_uvec3().into(), hi: hi.truncate().as_uvec3().into() }
    }

    #[inline(always)]
    fn around(&self, end: u32, lo: LatticePos, hi: LatticePos) -> Self {
        Self {
            end,
            lo: std::array::from_fn(|a| self.lo[a].min(lo[a])),
            hi: std::array::from_fn(|a| self.hi[a].max(hi[a])),
        }
    }

    #[inline(always)]
    fn edges(&self) -> u64 {
        (0..3).map(|a| u64::from(self.hi[a].saturating_sub(self.lo[a]))).sum()
    }
}

/// The first tetrahedron of each block, and the number of all: blocks are cut between tetrahedra of
/// different first vertices, by which all ascend, and have about `block_tets`, a quarter more at
/// most if a vertex has not more.
pub(super) fn block_starts(tets: &[Tet], positions: &[LatticePos], block_tets: u32) -> Vec<u32> {
    let steps = steps(tets, positions, block_tets.div_ceil(STEPS));
    let most = block_tets.saturating_add(block_tets / 4);
    let alone = u64::from(block_tets) / BLOCK_COST;
    // The least cost of all up to the end of each step, and how many steps its last block has.
    let mut least = vec![(u64::MAX, 0u32); steps.len() + 1];
    least[0].0 = 0;
    for first in 0..steps.len() {
        let start = if first == 0 { 0 } else { steps[first - 1].end };
        let (before, mut block) = (least[first].0, Step::NONE);
        for (step, n) in steps[first..].iter().zip(1..) {
            block = block.around(step.end, step.lo, step.hi);
            let tets = step.end - start;
            if tets > most && n > 1 {
                break;
            }
            let cost = before.saturating_add(block.edges() * (u64::from(tets) + alone));
            let known = &mut least[first + n as usize];
            if cost < known.0 {
                *known = (cost, n);
            }
        }
    }
    let mut starts = vec![tets.len() as u32];
    let mut at = steps.len();
    while at > 0 {
        at -= least[at].1 as usize;
        starts.push(if at == 0 { 0 } else { steps[at - 1].end });
    }
    starts.reverse();
    starts
}

/// Steps with the tetrahedra of some vertices each, at least `least` tetrahedra a step, except in
/// the last one.
fn steps(tets: &[Tet], positions: &[LatticePos], least: u32) -> Vec<Step> {
    // Exact: 24 bits. The least and the greatest of such vectors take one instruction each.
    let rows: Vec<Vec4> = positions.iter().map(|&p| UVec3::from(p).as_vec3().extend(0.0)).collect();
    let mut steps = Vec::with_capacity(tets.len() / least as usize + 1);
    let (mut lo, mut hi) = (Vec4::INFINITY, Vec4::ZERO);
    let (mut start, mut before) = (0, None);
    for (n, &[own, others @ ..]) in (0..).zip(tets) {
        if before != Some(own) {
            if n - start >= least {
                steps.push(Step::between(n, lo, hi));
                (start, lo, hi) = (n, Vec4::INFINITY, Vec4::ZERO);
            }
            before = Some(own);
            let row = rows[own as usize];
            (lo, hi) = (lo.min(row), hi.max(row));
        }
        let [b, c, d] = others.map(|v| rows[v as usize]);
        (lo, hi) = (lo.min(b).min(c.min(d)), hi.max(b).max(c.max(d)));
    }
    if before.is_some() {
        steps.push(Step::between(tets.len() as u32, lo, hi));
    }
    steps
}

#[cfg(test)]
mod tests {
    use super::super::chunk::tests::{corners, cubes};
    use super::*;

    /// All ways to cut, tried.
    fn best(steps: &[Step], start: u32, most: u32, alone: u64) -> u64 {
        if steps.is_empty() {
            return 0;
        }
        let mut block = Step::NONE;
        let blocks = steps.iter().enumerate().map(|(n, step)| {
            block = block.around(step.end, step.lo, step.hi);
            let tets = step.end - start;
            let fits = n == 0 || tets <= most;
            fits.then(|| {
                block.edges() * (u64::from(tets) + alone) + best(&steps[n + 1..], step.end, most, alone)
            })
        });
        blocks.flatten().min().unwrap()
    }

    #[test]
    fn the_cuts_are_the_best() {
        let (mut tets, positions) = (cubes([3, 4, 1]), corners([3, 4, 1]));
        tets.sort_unstable();
        for block_tets in [1, 7, 20, 64, 200] {
            let starts = block_starts(&tets, &positions, block_tets);
            assert_eq!((starts[0], starts[starts.len() - 1]), (0, tets.len() as u32));
            let (most, alone) = (block_tets + block_tets / 4, u64::from(block_tets / 2));
            let cost = |block: &[u32]| {
                let tets = &tets[block[0] as usize..block[1] as usize];
                let all = steps(tets, &positions, u32::MAX);
                assert_eq!(all.len(), 1);
                all[0].edges() * (tets.len() as u64 + alone)
            };
            let steps = steps(&tets, &positions, block_tets.div_ceil(STEPS));
            assert_eq!(starts.windows(2).map(cost).sum::<u64>(), best(&steps, 0, most, alone));
            assert!(starts.windows(2).all(|w| w[0] < w[1]));
            let is_cut = |&at: &u32| tets[at as usize - 1][0] != tets[at as usize][0];
            assert!(starts[1..starts.len() - 1].iter().all(is_cut));
        }
        assert_eq!(block_starts(&[], &positions, 100), [0]);
    }
}
