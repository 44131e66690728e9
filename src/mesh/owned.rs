//! The tetrahedra that a chunk keeps, put in the order of their first vertices by counting.
//!
//! Which records they are is a bit each, and another for those around them. In the end their vertices are packed where the first quarter of the records was,
//! which nobody needs any more, and from there go to their places behind it: so tetrahedra take 64 bytes each, and nothing besides.

use super::delaunay::Mesher;
use super::list::TetList;
use super::tet::Tet;

/// Records of a mesher. Kept from chunk to chunk, so that its pages are not asked for again.
#[derive(Debug, Default)]
pub(super) struct Owned {
    bits: Vec<u64>,
    /// Records that are not owned, but have a vertex of one that is.
    around: Vec<u64>,
    /// By the number of a vertex: how many tetrahedra have it first. One more at the end, for none.
    counts: Vec<u32>,
}

impl Owned {
    /// Prepares for so many records.
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
        set(&mut self.bits, id);
    }

    #[inline]
    pub(super) fn has(&self, id: u32) -> bool {
        is_set(&self.bits, id)
    }

    /// Notes a record around, which is not owned.
    #[inline]
    pub(super) fn insert_around(&mut self, id: u32) {
        set(&mut self.around, id);
    }

    /// Those owned, ascending.
    pub(super) fn iter(&self) -> impl Iterator<Item = u32> {
        each_set(self.bits.iter().copied())
    }

    /// Those owned, as indices into so many positions, the least first in each, ascending by that; then those around; in the memory of the mesher,
    /// which has no mesh then.
    pub(super) fn take(&mut self, mesher: &mut Mesher, positions: usize) -> TetList {
        let mut counts = std::mem::take(&mut self.counts);
        counts.clear();
        counts.resize(positions + 1, 0);
        let mut own = 0;
        let all = self.bits.iter().zip(&self.around).map(|(bits, around)| bits | around);
        let (mut records, packed) = mesher.pack(each_set(all), |id, mut t| {
            if is_set(&self.around, id) {
                t[0] |= AROUND;
            } else {
                t = least_first(t);
                counts[t[0] as usize] += 1;
                own += 1;
            }
            t
        });
        let (tets, room) = bytemuck::cast_slice_mut(&mut records).split_at_mut(packed);
        let (sorted, around) = room[..packed].split_at_mut(own);
        sort(tets, &mut counts, sorted, around);
        self.counts = counts;
        TetList::among(records, packed..2 * packed, own)
    }
}

/// Marks the first vertex of a packed tetrahedron around: positions are fewer.
const AROUND: u32 = 1 << 31;

#[inline]
fn set(bits: &mut [u64], id: u32) {
    bits[(id / u64::BITS) as usize] |= 1 << (id % u64::BITS);
}

#[inline]
fn is_set(bits: &[u64], id: u32) -> bool {
    bits[(id / u64::BITS) as usize] >> (id % u64::BITS) & 1 == 1
}

/// The numbers of the bits that are set, ascending.
fn each_set(words: impl Iterator<Item = u64>) -> impl Iterator<Item = u32> {
    let of_word = |(n, mut word): (u32, u64)| {
        std::iter::from_fn(move || {
            let bit = (word != 0).then(|| word.trailing_zeros())?;
            word &= word - 1;
            Some(n * u64::BITS + bit)
        })
    };
    (0..).zip(words).flat_map(of_word)
}

/// Puts tetrahedra into another place, ascending by their first vertices, of which `counts` tells how many have each; those marked as around apart, as they come.
fn sort(tets: &[Tet], counts: &mut [u32], own: &mut [Tet], around: &mut [Tet]) {
    let mut sum = 0;
    for n in &mut *counts {
        // Each count becomes its run's start; placing the tetrahedra moves it to the run's end.
        sum += std::mem::replace(n, sum);
    }
    let mut around = around.iter_mut();
    for &[a, b, c, d] in tets {
        if a & AROUND != 0 {
            *around.next().expect("a place for each that is marked") = [a & !AROUND, b, c, d];
        } else {
            let place = &mut counts[a as usize];
            own[*place as usize] = [a, b, c, d];
            *place += 1;
        }
    }
}

/// An even permutation with the least number first. Without branches: they would be taken at random.
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
    use crate::geom::predicates::orient3d;
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
            sort(&marked, &mut counts, own, around);
            assert!(own.iter().map(|t| t[0]).eq(0..n), "{own:?}");
            assert!(around.iter().map(|&[a, b, c, d]| [a, d, c, b]).eq(tets), "{around:?}");
        }
    }

    #[test]
    fn records_are_listed_as_they_were_noted() {
        let (mut owned, mut noted) = (Owned::default(), BTreeSet::new());
        owned.clear(10);
        assert_eq!(owned.iter().count(), 0);
        owned.grow(1000);
        for id in (0..1000u32).map(|i| i * i % 1000).chain([63, 64, 999]) {
            owned.insert(id);
            noted.insert(id);
        }
        assert!(owned.iter().eq(noted.iter().copied()));
        assert!((0..1000).all(|id| owned.has(id) == noted.contains(&id)));
        owned.clear(5);
        assert_eq!(owned.iter().count(), 0);
    }
}
