//! The tetrahedra that a chunk keeps, put in the order of their first vertices by counting.
//!
//! A bit marks each of their records, and another each of those around them. In the end their
//! vertices are packed into the first quarter of the records, which is no longer needed. From there
//! they go to their places behind it: so tetrahedra take 64 bytes each, and nothing besides.

use super::delaunay::Kernel;
use super::list::TetList;
use super::tet::{Tet, canonical};

/// Records of a kernel. Kept from chunk to chunk, so that its pages are not asked for again.
#[derive(Debug, Default)]
pub(super) struct Owned {
    bits: Vec<u64>,
    /// Records that are not owned, but have a vertex of one that is.
    around: Vec<u64>,
    /// For each vertex, how many tetrahedra have it first. One more at the end, for none.
    counts: Vec<u32>,
}

impl Owned {
    /// Prepares for this many records.
    pub(super) fn clear(&mut self, records: u32) {
        self.bits.clear();
        self.around.clear();
        self.grow(records);
    }

    /// For more records.
    pub(super) fn grow(&mut self, records: u32) {
        let words = records.div_ceil(u64::BITS) as usize;
        self.bits.resize(words, 0);
        self.around.resize(words, 0);
    }

    #[inline]
    pub(super) fn insert(&mut self, id: u32) {
        self.bits[(id / u64::BITS) as usize] |= 1 << (id % u64::BITS);
    }

    /// Notes which of 64 records are owned; the number of the first is a multiple of 64.
    #[inline]
    pub(super) fn insert_word(&mut self, first: u32, word: u64) {
        self.bits[(first / u64::BITS) as usize] |= word;
    }

    #[inline]
    pub(super) fn has(&self, id: u32) -> bool {
        self.bits[(id / u64::BITS) as usize] >> (id % u64::BITS) & 1 == 1
    }

    /// Which of 64 records are not owned; the number of the first is a multiple of 64.
    #[inline]
    pub(super) fn others(&self, first: u32) -> u64 {
        !self.bits[(first / u64::BITS) as usize]
    }

    /// Notes a record around, which is not owned.
    #[inline]
    pub(super) fn insert_around(&mut self, id: u32) {
        self.around[(id / u64::BITS) as usize] |= 1 << (id % u64::BITS);
    }

    /// The records that are owned, ascending.
    fn iter(&self) -> impl Iterator<Item = u32> {
        (0..).zip(&self.bits).flat_map(|(n, &own)| each_bit(own).map(move |bit| n * u64::BITS + bit))
    }

    /// The records that are owned and those around, ascending, and whether each is around.
    fn iter_all(&self) -> impl Iterator<Item = (u32, bool)> {
        let of_word = |(n, (&own, &around)): (u32, (&u64, &u64))| {
            each_bit(own | around).map(move |bit| (n * u64::BITS + bit, around >> bit & 1 == 1))
        };
        (0..).zip(self.bits.iter().zip(&self.around)).flat_map(of_word)
    }

    /// The owned tetrahedra, as indices into so many positions, the least first in each, ascending
    /// by that; then those around. They are in the memory of the kernel, which has no mesh then.
    pub(super) fn take(&mut self, kernel: &mut Kernel, positions: usize) -> TetList {
        let mut counts = std::mem::take(&mut self.counts);
        counts.clear();
        counts.resize(positions + 1, 0);
        let mut around = 0;
        let mut count = |t: Tet| {
            let t = least_first(t);
            counts[t[0] as usize] += 1;
            t
        };
        let (mut records, packed) = if self.around.iter().all(|&word| word == 0) {
            kernel.pack(self.iter().map(|id| (id, ())), |(), t| count(t))
        } else {
            kernel.pack(self.iter_all(), |is_around, [a, b, c, d]| {
                around += usize::from(is_around);
                if is_around { [a | AROUND, b, c, d] } else { count([a, b, c, d]) }
            })
        };
        let own = packed - around;
        let (tets, room) = bytemuck::cast_slice_mut(&mut records).split_at_mut(packed);
        let (sorted, around) = room[..packed].split_at_mut(own);
        if around.is_empty() {
            sort::<false>(tets, &mut counts, sorted, around);
        } else {
            sort::<true>(tets, &mut counts, sorted, around);
            sort_around(around);
        }
        self.counts = counts;
        TetList::among(records, packed..2 * packed, own)
    }
}

/// Marks the first vertex of a packed tetrahedron around: positions are fewer.
const AROUND: u32 = 1 << 31;

/// The bits that are set, ascending.
#[inline]
pub(super) fn each_bit(mut word: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let bit = (word != 0).then(|| word.trailing_zeros())?;
        word &= word - 1;
        Some(bit)
    })
}

/// Moves tetrahedra to another place, ascending by their first vertices; `counts` says how many
/// have each. Those marked as around are kept separate, in the order in which they come, if there
/// are any (`SOME`).
fn sort<const SOME: bool>(tets: &[Tet], counts: &mut [u32], own: &mut [Tet], around: &mut [Tet]) {
    let mut sum = 0;
    for n in &mut *counts {
        // Each count becomes its run's start; placing the tetrahedra moves it to the run's end.
        sum += std::mem::replace(n, sum);
    }
    let mut around = around.iter_mut();
    for &[a, b, c, d] in tets {
        if SOME && a & AROUND != 0 {
            *around.next().expect("a place for each that is marked") = [a & !AROUND, b, c, d];
        } else {
            let place = &mut counts[a as usize];
            own[*place as usize] = [a, b, c, d];
            *place += 1;
        }
    }
}

/// Puts tetrahedra into an order that does not depend on how they were found.
pub(super) fn sort_around(tets: &mut [Tet]) {
    tets.iter_mut().for_each(|t| *t = canonical(*t));
    tets.sort_unstable();
}

/// An even permutation with the least number first. Without branches: they would be taken at
/// random.
#[inline]
fn least_first(t: Tet) -> Tet {
    /// The others of each place, so that (place, others) is an even permutation.
    const REST: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [3, 0, 1], [2, 1, 0]];
    let (low, high) = (usize::from(t[1] < t[0]), 2 + usize::from(t[3] < t[2]));
    let least = low + (high - low) * usize::from(t[high] < t[low]);
    let [a, b, c] = REST[least].map(|i| t[i]);
    [t[least], a, b, c]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::predicates::orient3d;
    use std::collections::BTreeSet;

    #[test]
    fn the_least_comes_first_and_the_orientation_stays() {
        let p = [[0, 0, 0], [5, 0, 0], [0, 5, 0], [0, 0, 5]];
        let mut forms = BTreeSet::new();
        for i in 0..256u32 {
            let t: Tet = std::array::from_fn(|k| i >> (2 * k) & 3);
            let at = t.map(|v| p[v as usize]);
            if orient3d(at[0], at[1], at[2], at[3]) > 0 {
                forms.insert(least_first(t));
            }
        }
        let turned = [[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2]];
        assert!(forms.iter().all(|t| turned.contains(t)), "{forms:?}");
    }

    #[test]
    fn tetrahedra_come_out_in_order_whatever_the_memory_held() {
        let mut memory = [[9; 4]; 400];
        for n in [7u32, 200, 3] {
            let tets: Vec<Tet> = (0..n).map(|i| [i * 11 % n, i + 2, i + 1, i + 3]).collect();
            let marked = tets.iter().flat_map(|&[a, b, c, d]| [[a, b, c, d], [AROUND | a, d, c, b]]);
            let marked: Vec<Tet> = marked.collect();
            let (mut counts, all) = (vec![1; n as usize], &mut memory[..2 * n as usize]);
            let (own, around) = all.split_at_mut(n as usize);
            sort::<true>(&marked, &mut counts, own, around);
            assert!(own.iter().map(|t| t[0]).eq(0..n), "{own:?}");
            assert!(around.iter().map(|&[a, b, c, d]| [a, d, c, b]).eq(tets), "{around:?}");
        }
    }

    #[test]
    fn records_are_listed_as_they_were_noted() {
        let (mut owned, mut noted) = (Owned::default(), BTreeSet::new());
        owned.clear(10);
        assert_eq!(owned.iter_all().count(), 0);
        owned.grow(1000);
        for id in (0..1000u32).map(|i| i * i % 1000).chain([63, 64, 999]) {
            owned.insert(id);
            noted.insert((id, false));
        }
        owned.insert_word(192, 1 << 63 | 1 << 7);
        noted.extend([(199, false), (255, false)]);
        for id in [2, 198, 257] {
            assert!(!owned.has(id));
            owned.insert_around(id);
            noted.insert((id, true));
        }
        assert!(owned.iter_all().eq(noted.iter().copied()));
        assert!(owned.iter().eq(noted.iter().filter(|(_, around)| !around).map(|&(id, _)| id)));
        assert!((0..1000).all(|id| owned.has(id) == noted.contains(&(id, false))));
        assert!((0..960).all(|id| owned.has(id) == (owned.others(id / 64 * 64) >> (id % 64) & 1 == 0)));
        owned.clear(5);
        assert_eq!(owned.iter_all().count(), 0);
    }
}
