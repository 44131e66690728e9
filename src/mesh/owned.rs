//! The tetrahedra that a chunk keeps, put in the order of their first vertices by counting.

use super::tet::Tet;

/// Tetrahedra in no particular order, the least number first in each, counted by it. Kept from chunk to chunk, so that its pages are not
/// asked for again.
#[derive(Debug, Default)]
pub(super) struct Owned {
    pub(super) tets: Vec<Tet>,
    /// By number: how many have it first. One more at the end, for none.
    counts: Vec<u32>,
}

impl Owned {
    /// Prepares for tetrahedra between so many positions.
    pub(super) fn clear(&mut self, positions: usize) {
        self.tets.clear();
        self.counts.clear();
        self.counts.resize(positions + 1, 0);
    }

    /// Adds a tetrahedron, turned so that its least number comes first.
    #[inline]
    pub(super) fn push(&mut self, t: Tet) {
        let t = least_first(t);
        self.counts[t[0] as usize] += 1;
        self.tets.push(t);
    }

    /// All of them, ascending by their first numbers, in memory that may hold others.
    pub(super) fn sorted(&mut self, mut all: Vec<Tet>) -> Vec<Tet> {
        let mut sum = 0;
        for n in &mut self.counts {
            // Each count becomes its run's start; placing the tetrahedra moves it to the run's end.
            sum += std::mem::replace(n, sum);
        }
        if all.capacity() < self.tets.len() {
            // Grown, it would be copied.
            all = Vec::with_capacity(self.tets.len() + self.tets.len() / 8);
        }
        // Whatever is there is written over.
        all.resize(self.tets.len(), [0; 4]);
        for &t in &self.tets {
            let place = &mut self.counts[t[0] as usize];
            all[*place as usize] = t;
            *place += 1;
        }
        all
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
        let mut owned = Owned::default();
        let mut all = vec![[9; 4]; 3];
        for n in [7u32, 200, 3] {
            owned.clear(n as usize + 3);
            (0..n).map(|i| i * 11 % n).for_each(|i| owned.push([i + 1, i + 2, i, i + 3]));
            all = owned.sorted(all);
            assert!(all.iter().map(|t| t[0]).eq(0..n), "{all:?}");
        }
    }
}
