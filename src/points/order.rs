//! The order of sites: Hilbert key, then coordinates; each position once.

use crate::geom::{LatticePos, Site};

/// The Hilbert key of the highest `bits` of 24 bits an axis (Skilling 2004, "Programming the Hilbert curve").
pub(super) fn hilbert_key(pos: LatticePos, bits: u32) -> u64 {
    let mut x = pos.map(|p| p.min((1 << 24) - 1) >> (24 - bits));
    for bit in (1..bits).rev().map(|b| 1u32 << b) {
        for a in 0..3 {
            if x[a] & bit != 0 {
                x[0] ^= bit - 1;
            } else {
                let t = (x[0] ^ x[a]) & (bit - 1);
                x[0] ^= t;
                x[a] ^= t;
            }
        }
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let mut t = 0;
    for bit in (1..bits).map(|b| 1u32 << b) {
        if x[2] & bit != 0 {
            t ^= bit - 1;
        }
    }
    let x = x.map(|x| x ^ t);
    (0..bits).rev().fold(0, |key, b| (0..3).fold(key, |key, a| key << 1 | u64::from(x[a] >> b & 1)))
}

/// A site with its key; what is sorted.
#[derive(Clone, Copy)]
struct Keyed {
    key: u64,
    site: Site,
}

/// Sorts by (Hilbert key at `bits`, x, y, z) and keeps the lowest id of each position.
///
/// Keys are nearly distinct, so the sort looks at them alone, and a pass over its result orders the few equal ones.
pub(super) fn sort_and_dedup(sites: &mut Vec<Site>, bits: u32) {
    let mut keyed: Vec<Keyed> =
        sites.iter().map(|&site| Keyed { key: hilbert_key(site.pos, bits), site }).collect();
    keyed.sort_unstable_by_key(|k| k.key);
    sites.clear();
    let mut last: Option<LatticePos> = None;
    for run in keyed.chunk_by_mut(|a, b| a.key == b.key) {
        if run.len() > 1 {
            run.sort_unstable_by_key(|k| (k.site.pos, k.site.id));
        }
        for k in run {
            if last != Some(k.site.pos) {
                last = Some(k.site.pos);
                sites.push(k.site);
            }
        }
    }
}
