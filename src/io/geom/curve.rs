//! The order in which points are inserted: rounds by a hash of the position, Hilbert order within a
//! round.
//!
//! A Delaunay insertion is cheap when each point lies near the one before it (a space-filling
//! curve) and when the early points are a random sample of all (a biased randomized insertion
//! order: Amenta, Choi, Rote, "Incremental constructions con BRIO", 2003). Here the round of a
//! point is decided by a hash of its position: each round holds an eighth of what is left, the
//! smallest round goes first. Within a round the points follow a Hilbert curve, and where the
//! curve's cells are too coarse to tell two points apart, their coordinates decide.
//!
//! So the order is a **total order of positions** and a function of nothing else: not of the
//! input's order, not of the chunk. The mesh breaks its ties by this order (see
//! `isospan_mesh::predicates`), which is why chunks that overlap agree.
//!
//! # The Hilbert curve
//!
//! A cell is cut into 8 octants that the curve visits along a Gray code, rotated and reflected so
//! that it enters the cell at a corner `e` and leaves it along an axis `d` (Hamilton and
//! Rau-Chaplin, "Compact Hilbert indices", 2008):
//!
//! ```text
//! octant of step w:  rotate_left(gray(w), d + 1) ^ e        within that octant:  e' = e ^ rotate_left(entry(w), d + 1)
//! entry(w) = gray(2·floor((w - 1) / 2)), entry(0) = 0                            d' = d + direction(w) + 1 (mod 3)
//! ```
//!
//! The 8 × 3 states are tabulated at compile time, one table for one level and one for two levels
//! at a step.

use super::{Lattice, LatticePos};
use std::cmp::Ordering;

/// States of the curve: 8 entry corners times 3 directions.
const STATES: usize = 24;
/// Rows of a table, so that a remainder is within it.
const ROWS: usize = 32;

/// Coordinates carry 24 bits; the value 2^24 itself is in the cell of 2^24 - 1.
const COORDINATE_BITS: u32 = 24;

const fn gray(w: u32) -> u32 {
    w ^ (w >> 1)
}

const fn rotate_left3(x: u32, by: u32) -> u32 {
    let by = by % 3;
    ((x << by) | (x >> (3 - by))) & 7
}

/// One level: `[state][octant] -> step << 8 | next state`; an octant is `x << 2 | y << 1 | z`.
const fn one_level() -> [[u16; 8]; STATES] {
    let mut table = [[0u16; 8]; STATES];
    let mut state = 0;
    while state < STATES {
        let (e, d) = (state as u32 / 3, state as u32 % 3);
        let mut w = 0u32;
        while w < 8 {
            let octant = rotate_left3(gray(w), d + 1) ^ e;
            let entry = if w == 0 { 0 } else { gray(2 * ((w - 1) / 2)) };
            let direction = match w {
                0 => 0,
                w if w % 2 == 0 => (w - 1).trailing_ones() % 3,
                w => w.trailing_ones() % 3,
            };
            let next_e = e ^ rotate_left3(entry, d + 1);
            let next_d = (d + direction + 1) % 3;
            table[state][octant as usize] = ((w << 8) | (next_e * 3 + next_d)) as u16;
            w += 1;
        }
        state += 1;
    }
    table
}

/// Two levels: `[state][xx yy zz] -> steps << 8 | next state`, two bits of each coordinate.
const fn two_levels() -> [[u16; 64]; ROWS] {
    let mut table = [[0u16; 64]; ROWS];
    let mut state = 0;
    while state < STATES {
        let mut cell = 0;
        while cell < 64 {
            let (x, y, z) = (cell >> 4, cell >> 2 & 3, cell & 3);
            let upper = ONE[state][(x >> 1) << 2 | (y >> 1) << 1 | z >> 1];
            let lower = ONE[(upper & 255) as usize][(x & 1) << 2 | (y & 1) << 1 | z & 1];
            table[state][cell] = ((upper >> 8) << 3 | lower >> 8) << 8 | lower & 255;
            cell += 1;
        }
        state += 1;
    }
    table
}

static ONE_LEVEL: [[u16; 8]; STATES] = ONE;
const ONE: [[u16; 8]; STATES] = one_level();
static TWO_LEVELS: [[u16; 64]; ROWS] = two_levels();

/// The number of a position's cell along a Hilbert curve through the cube of 2^24 lattice steps,
/// cut into `2^bits_per_axis` cells along each axis.
///
/// Consecutive numbers belong to cells that share a face.
///
/// # Panics
/// When `bits_per_axis` exceeds 21 (the number would not fit 64 bits).
#[inline]
pub fn hilbert_key(pos: LatticePos, bits_per_axis: u32) -> u64 {
    assert!(bits_per_axis <= 21, "a key of {bits_per_axis} bits an axis does not fit 64 bits");
    hilbert_number(
        pos.map(|c| c.min(Lattice::LARGEST - 1) >> (COORDINATE_BITS - bits_per_axis)),
        bits_per_axis,
    )
}

/// The number of a cell along the curve through a cube of `2^bits` cells along each axis, at
/// most 21.
#[inline(always)]
pub fn hilbert_number([x, y, z]: [u32; 3], bits: u32) -> u64 {
    let (mut key, mut state, mut level) = (0u64, 0usize, bits);
    if level % 2 == 1 {
        level -= 1;
        let octant = (x >> level & 1) << 2 | (y >> level & 1) << 1 | z >> level & 1;
        let step = ONE_LEVEL[0][octant as usize];
        (key, state) = (u64::from(step >> 8), usize::from(step & 255));
    }
    while level > 0 {
        level -= 2;
        let cell = (x >> level & 3) << 4 | (y >> level & 3) << 2 | z >> level & 3;
        let step = TWO_LEVELS[state % ROWS][cell as usize];
        (key, state) = (key << 6 | u64::from(step >> 8), usize::from(step & 255));
    }
    key
}

/// The insertion order: a total order of lattice positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Order {
    /// Hilbert cells along each axis, as a power of two; at most [`Order::MOST_BITS`]. All chunks
    /// of one archive use the same value.
    pub bits: u32,
}

impl Order {
    /// The finest curve that an order can use: with the round it fills 63 bits.
    pub const MOST_BITS: u32 = 20;

    /// Rounds: the first holds one point in 8^7.
    const ROUNDS: u32 = 8;

    /// An order whose cells hold a point or less on average when `n` points fill the whole cube.
    pub fn for_count(n: u64) -> Self {
        // ceil(log2(n) / 3) levels give a cell per point; three more tell most neighbours apart.
        let levels = (u64::BITS - n.saturating_sub(1).leading_zeros()).div_ceil(3);
        Self { bits: (levels + 3).min(Self::MOST_BITS) }
    }

    /// The sort key of a position: round, then Hilbert cell. Equal keys are ordered by the
    /// coordinates.
    #[inline]
    pub fn key(&self, pos: LatticePos) -> u64 {
        u64::from(round(pos)) << (3 * self.bits) | hilbert_key(pos, self.bits)
    }

    /// Compares two positions; equal only if they are the same.
    pub fn compare(&self, a: LatticePos, b: LatticePos) -> Ordering {
        (self.key(a), a).cmp(&(self.key(b), b))
    }

    /// Fills `sorted` with (key, index into `positions`) in order; of equal positions the lower
    /// index comes first. `spare` is scratch. Time: linear, three or four passes.
    pub fn sort(&self, positions: &[LatticePos], sorted: &mut Vec<(u64, u32)>, spare: &mut Vec<(u64, u32)>) {
        sorted.clear();
        sorted.extend(positions.iter().zip(0u32..).map(|(&p, i)| (self.key(p), i)));
        radix_sort(sorted, spare);
        let mut rest = &mut sorted[..];
        while let Some(first) = rest.first() {
            let same = rest.iter().take_while(|e| e.0 == first.0).count();
            let (run, after) = rest.split_at_mut(same);
            if same > 1 {
                run.sort_unstable_by_key(|e| (positions[e.1 as usize], e.1));
            }
            rest = after;
        }
    }
}

/// The round of a position, 0 first: 7 minus the number of leading octal zeros of a hash.
#[inline]
fn round(pos: LatticePos) -> u32 {
    let mut h =
        u64::from(pos[0]) ^ u64::from(pos[1]) << 25 ^ u64::from(pos[2]).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    // Two rounds of multiply and xor-shift, as in SplitMix64's finalizer.
    h = (h ^ h >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ h >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    Order::ROUNDS - 1 - (h.leading_zeros() / 3).min(Order::ROUNDS - 1)
}

/// Sorts by key, stable, 11 bits a pass; passes in which all keys agree are left out.
pub fn radix_sort(items: &mut Vec<(u64, u32)>, spare: &mut Vec<(u64, u32)>) {
    const BITS: u32 = 11;
    let Some(first) = items.first().map(|e| e.0) else { return };
    let differ = items.iter().fold(0, |bits, e| bits | (e.0 ^ first));
    spare.resize(items.len(), (0, 0));
    let mut shift = differ.trailing_zeros();
    while shift < u64::BITS && differ >> shift != 0 {
        if (differ >> shift) & ((1 << BITS) - 1) != 0 {
            radix_pass(items, spare, shift, BITS);
            std::mem::swap(items, spare);
        }
        shift += BITS;
    }
}

fn radix_pass(from: &[(u64, u32)], to: &mut [(u64, u32)], shift: u32, bits: u32) {
    let digit = |e: &(u64, u32)| (e.0 >> shift) as usize & ((1 << bits) - 1);
    let mut place = vec![0u32; 1 << bits];
    for e in from {
        place[digit(e)] += 1;
    }
    let mut sum = 0;
    for p in &mut place {
        sum += std::mem::replace(p, sum);
    }
    for e in from {
        let p = &mut place[digit(e)];
        to[*p as usize] = *e;
        *p += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn consecutive_cells_share_a_face_and_every_cell_is_visited() {
        for bits in 1..=5u32 {
            let n = 1u32 << bits;
            let step = Lattice::LARGEST >> bits;
            let mut at = vec![None; 1 << (3 * bits)];
            for i in 0..n * n * n {
                let cell = [i % n, i / n % n, i / n / n];
                let key = hilbert_key(cell.map(|c| c * step + step / 2), bits);
                assert!(at[key as usize].replace(cell).is_none(), "two cells at {key}");
            }
            for pair in at.windows(2) {
                let (a, b) = (pair[0].unwrap(), pair[1].unwrap());
                assert_eq!((0..3).map(|k| a[k].abs_diff(b[k])).sum::<u32>(), 1, "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn a_coarser_key_is_a_prefix_and_the_far_corner_has_a_key() {
        let p = [1 << 24, 12_345_678, (1 << 24) - 1];
        let fine = hilbert_key(p, 21);
        for bits in 0..=21 {
            assert_eq!(hilbert_key(p, bits), fine >> (3 * (21 - bits)), "{bits}");
        }
        assert_eq!(hilbert_key([1 << 24; 3], 9), hilbert_key([(1 << 24) - 1; 3], 9));
    }

    #[test]
    fn sort_agrees_with_compare() {
        let mut seed = 1u64;
        let mut next = |n: u64| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((seed >> 33) % n) as u32
        };
        for (range, n) in [(4u64, 500), (1 << 24, 3000), (1 << 12, 3000)] {
            let positions: Vec<LatticePos> =
                (0..n).map(|_| [next(range), next(range), next(range)]).collect();
            let order = Order::for_count(300);
            let (mut sorted, mut spare) = (vec![], vec![]);
            order.sort(&positions, &mut sorted, &mut spare);
            let mut expected: Vec<u32> = (0..n).collect();
            expected.sort_by(|&a, &b| order.compare(positions[a as usize], positions[b as usize]));
            assert_eq!(sorted.iter().map(|e| e.1).collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn rounds_shrink_by_eight() {
        let mut counts = [0u32; 8];
        for i in 0..40_000u32 {
            counts[round([i * 419, i % 200 * 83_000, i / 200 * 83_000]) as usize] += 1;
        }
        assert!((34_000..36_000).contains(&counts[7]), "{counts:?}");
        assert!((4_000..4_800).contains(&counts[6]), "{counts:?}");
    }
}
