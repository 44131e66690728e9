//! The order of sites: Hilbert key, then coordinates; each position once.

use crate::geom::Site;
use crate::geom::curve::{hilbert_key, radix_sort};

/// Sorts by (Hilbert key at `bits`, x, y, z) and keeps the lowest id of each position.
///
/// What is sorted is the key and the index in `sites`, by radix: the keys of a box have few bits that differ. Keys are nearly
/// distinct; sites of equal keys are put in order afterwards.
pub(super) fn sort_and_dedup(sites: &mut Vec<Site>, bits: u32) {
    let index = |i: usize| u32::try_from(i).expect("fewer sites than 2^32 fit in memory");
    let mut keys: Vec<(u64, u32)> =
        sites.iter().enumerate().map(|(i, s)| (hilbert_key(s.pos, bits), index(i))).collect();
    radix_sort(&mut keys, &mut vec![]);
    let mut sorted: Vec<Site> = Vec::with_capacity(sites.len());
    for run in keys.chunk_by(|a, b| a.0 == b.0) {
        append_run(run.iter().map(|&(_, i)| sites[i as usize]), &mut sorted);
    }
    *sites = sorted;
}

/// Appends sites of one key, ordered, each position once.
#[inline]
fn append_run(run: impl Iterator<Item = Site>, sorted: &mut Vec<Site>) {
    let start = sorted.len();
    sorted.extend(run);
    if sorted.len() - start < 2 {
        return;
    }
    sorted[start..].sort_unstable_by_key(|s| (s.pos, s.id));
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
    use crate::geom::PointId;

    #[test]
    fn keys_of_any_width_sort_alike() {
        let site = |i: u64| {
            let pos = [5, 11, 17].map(|s| ((i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> s) as u32 % 40) << 18);
            Site { id: PointId(i), pos }
        };
        for bits in [1, 6, 17, 18, 19, 20, 21] {
            let mut sites: Vec<Site> = (0..3000).rev().chain(0..50).map(site).collect();
            let mut expected = sites.clone();
            expected.sort_by_key(|s| (hilbert_key(s.pos, bits), s.pos, s.id));
            expected.dedup_by_key(|s| s.pos);
            sort_and_dedup(&mut sites, bits);
            assert_eq!(sites, expected, "{bits}");
        }
    }

    #[test]
    fn nothing_and_one() {
        for n in [0, 1] {
            let mut sites = vec![Site { id: PointId(3), pos: [1, 2, 3] }; n];
            sort_and_dedup(&mut sites, 21);
            assert_eq!(sites.len(), n);
        }
    }
}
