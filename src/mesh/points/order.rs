//! The order of sites: along a Hilbert curve through their box, then by coordinates; each position
//! once.
//!
//! The curve always fills the cube that the box's longest side spans. So a run of sites is as
//! compact as it can be, and an eighth of them, or a sixty-fourth, is a cube. (Along one curve for
//! all boxes it would be in several pieces, for boxes are not cells of that.)

use isospan_io::geom::curve::{hilbert_number, radix_sort};
use isospan_io::geom::{LatticeBox, LatticePos, Site};

/// Bits of the coordinates of a box: the lattice ends at 2^24.
const COORDINATE_BITS: u32 = 24;
/// The most bits an axis of keys that are sorted in one word with the number of their site.
const SHORT: u32 = 10;

/// The cells of a curve through a box.
pub(super) struct CurveCells {
    lo: LatticePos,
    bits: u32,
    /// Cells a lattice step along each axis, in 2^-32.
    scale: u64,
}

impl CurveCells {
    /// Cells at most as wide as those of a curve of `bits` an axis through the whole lattice.
    pub(super) fn new(b: &LatticeBox, bits: u32) -> Self {
        let longest = (0..3).map(|a| b.hi[a].saturating_sub(b.lo[a])).max().unwrap_or(0).max(1);
        let levels = longest.next_power_of_two().ilog2() + bits;
        let bits = levels.saturating_sub(COORDINATE_BITS).clamp(1, *super::ORDER_BITS.end());
        Self { lo: b.lo, bits, scale: (1 << (32 + bits)) / u64::from(longest) }
    }

    #[inline(always)]
    pub(super) fn key(&self, pos: LatticePos) -> u64 {
        let cell = std::array::from_fn(|a| ((u64::from(pos[a] - self.lo[a]) * self.scale) >> 32) as u32);
        hilbert_number(cell, self.bits)
    }
}

/// Sorts the sites of a box by (Hilbert key, x, y, z, id) and keeps the lowest id of each position;
/// all, where `repeats` are points.
///
/// Keys and numbers of sites are sorted, by radix. Keys are nearly distinct; sites of equal keys
/// are put in order afterwards.
pub(super) fn sort_and_dedup(sites: &mut Vec<Site>, b: &LatticeBox, bits: u32, repeats: bool) {
    let (cells, number) =
        (CurveCells::new(b, bits), |i| u32::try_from(i).expect("fewer sites than 2^32 fit in memory"));
    let mut sorted: Vec<Site> = Vec::with_capacity(sites.len());
    if cells.bits <= SHORT {
        let mut keys: Vec<u64> =
            sites.iter().enumerate().map(|(i, s)| cells.key(s.pos) << 32 | u64::from(number(i))).collect();
        sort_short(&mut keys, 3 * cells.bits);
        append(keys.iter().map(|&k| (k >> 32, k as u32)), sites, &mut sorted, repeats);
    } else {
        let mut keys: Vec<(u64, u32)> =
            sites.iter().enumerate().map(|(i, s)| (cells.key(s.pos), number(i))).collect();
        radix_sort(&mut keys, &mut vec![]);
        append(keys.into_iter(), sites, &mut sorted, repeats);
    }
    *sites = sorted;
}

/// Sorts by the upper halves, of `bits` bits, eight bits a pass.
fn sort_short(keys: &mut Vec<u64>, bits: u32) {
    let mut spare = vec![0; keys.len()];
    for pass in 0..bits.div_ceil(8) {
        let digit = |key: u64| (key >> (32 + 8 * pass)) as usize & 255;
        let (mut places, mut sum) = ([0u32; 256], 0);
        keys.iter().for_each(|&key| places[digit(key)] += 1);
        places.iter_mut().for_each(|n| sum += std::mem::replace(n, sum));
        for &key in &*keys {
            let place = &mut places[digit(key)];
            spare[*place as usize] = key;
            *place += 1;
        }
        std::mem::swap(keys, &mut spare);
    }
}

/// Appends sites in the order of their keys, those of equal keys by position, each position once
/// unless there are `repeats`.
#[inline(always)]
fn append(keys: impl Iterator<Item = (u64, u32)>, sites: &[Site], sorted: &mut Vec<Site>, repeats: bool) {
    let (mut last, mut start) = (u64::MAX, 0);
    for (key, i) in keys {
        if key != last {
            if sorted.len() - start > 1 {
                end_run(start, sorted, repeats);
            }
            (last, start) = (key, sorted.len());
        }
        sorted.push(sites[i as usize]);
    }
    end_run(start, sorted, repeats);
}

/// Orders the last sites, which have one key.
#[cold]
fn end_run(start: usize, sorted: &mut Vec<Site>, repeats: bool) {
    sorted[start..].sort_unstable_by_key(|s| (s.pos, s.id));
    if repeats {
        return;
    }
    let mut kept = start;
    for i in start + 1..sorted.len() {
        if sorted[i].pos != sorted[kept].pos {
            kept += 1;
            sorted[kept] = sorted[i];
        }
    }
    sorted.truncate(kept + 1);
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan_io::geom::PointId;

    #[test]
    fn keys_of_any_width_sort_alike() {
        let site = |i: u64| {
            let pos = [5, 11, 17].map(|s| ((i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> s) as u32 % 40) << 18);
            Site { id: PointId(i), pos }
        };
        for hi in [[1 << 24; 3], [10 << 20; 3], [(10 << 20) - 1, 10 << 20, (1 << 24) + 1]] {
            let b = LatticeBox { lo: [0; 3], hi };
            for bits in [1, 3, 6, 9, 10, 11, 17, 20, 21] {
                let mut sites: Vec<Site> = (0..3000).rev().chain(0..50).map(site).collect();
                let cells = CurveCells::new(&b, bits);
                assert!(cells.key(b.hi.map(|x| x - 1)) < 1 << (3 * cells.bits));
                let mut expected = sites.clone();
                expected.sort_by_key(|s| (cells.key(s.pos), s.pos, s.id));
                let mut all = sites.clone();
                sort_and_dedup(&mut all, &b, bits, true);
                assert_eq!(all, expected, "{bits}");
                expected.dedup_by_key(|s| s.pos);
                sort_and_dedup(&mut sites, &b, bits, false);
                assert_eq!(sites, expected, "{bits}");
            }
        }
    }

    #[test]
    fn an_eighth_of_a_box_is_a_run() {
        let (lo, edge) = ([3 << 18, 5 << 17, 77], 1_000_003);
        let b = LatticeBox { lo, hi: lo.map(|x| x + edge) };
        let at = |i: u32, a: usize| lo[a] + ((u64::from(i % 24) * u64::from(edge)) / 24) as u32;
        let mut sites: Vec<Site> = (0..24 * 24 * 24)
            .map(|i| Site { id: PointId(i.into()), pos: [at(i, 0), at(i / 24, 1), at(i / 576, 2)] })
            .collect();
        sort_and_dedup(&mut sites, &b, 9, false);
        let octant = |s: &Site| (0..3).map(|a| u32::from(2 * (s.pos[a] - lo[a]) >= edge) << a).sum::<u32>();
        assert_eq!(sites.chunk_by(|s, t| octant(s) == octant(t)).count(), 8);
    }

    #[test]
    fn nothing_and_one() {
        for n in [0, 1] {
            let mut sites = vec![Site { id: PointId(3), pos: [1, 2, 3] }; n];
            sort_and_dedup(&mut sites, &LatticeBox { lo: [0; 3], hi: [1 << 24; 3] }, 21, false);
            assert_eq!(sites.len(), n);
        }
    }
}
