//! The tetrahedra of a chunk, in the memory in which they were meshed.
//!
//! A record of the mesher has 64 bytes, and its vertices are 16 of them. When nothing else of the
//! records is needed any more, there is room among them for the vertices twice: as they are found,
//! and in their final order. So a chunk takes 64 bytes a tetrahedron and no more, from its first
//! point to its last block. Then the memory goes back to the mesher
//! ([`Mesher::reuse`](super::mesher::Mesher::reuse)), whose pages need not be asked for again.
//!
//! Tetrahedra made star by star are in that order already: a plain list, 16 bytes each. Where the
//! tetrahedra around the chunk's own are wanted too, they lie behind those:
//!
//! ```text
//!  records   │ as found │ own, in order        │ around   │ free   │
//!                       └───────── whole ─────────────────┘
//! ```

use super::delaunay::Tetra;
use super::tet::Tet;
use std::fmt;
use std::ops::{Deref, DerefMut, Range};

/// A list of tetrahedra, used as a slice; behind it there may be those around them
/// ([`TetList::around`]).
#[derive(Clone)]
pub struct TetList {
    memory: Memory,
    /// How many are in the list; those that follow are around.
    own: usize,
}

#[derive(Clone)]
pub(super) enum Memory {
    Listed(Vec<Tet>),
    /// Records, as rows of four numbers; some of these rows are the list.
    Among(Vec<Tetra>, Range<usize>),
}

impl TetList {
    /// Some of the rows in the memory of the records; the first `own` of them are the chunk's own.
    pub(super) fn among(records: Vec<Tetra>, rows: Range<usize>, own: usize) -> Self {
        Self { memory: Memory::Among(records, rows), own }
    }

    /// Its memory.
    pub(super) fn into_memory(self) -> Memory {
        self.memory
    }

    /// From here on the tetrahedra are around the list.
    pub(super) fn split_at(&mut self, own: usize) {
        self.own = own;
    }

    /// Puts others around the list, in place of those that were.
    pub fn put_around(&mut self, around: &[Tet]) {
        match &mut self.memory {
            Memory::Listed(tets) => {
                tets.truncate(self.own);
                tets.extend_from_slice(around);
            }
            Memory::Among(..) => self.memory = Memory::Listed([&**self, around].concat()),
        }
    }

    /// The list, then those around.
    pub fn whole(&self) -> &[Tet] {
        match &self.memory {
            Memory::Listed(tets) => tets,
            Memory::Among(records, rows) => &bytemuck::cast_slice(records)[rows.clone()],
        }
    }

    /// As [`TetList::whole`].
    pub fn whole_mut(&mut self) -> &mut [Tet] {
        match &mut self.memory {
            Memory::Listed(tets) => tets,
            Memory::Among(records, rows) => &mut bytemuck::cast_slice_mut(records)[rows.clone()],
        }
    }

    /// The tetrahedra outside the list that have a vertex of one in it, if they were asked for; in
    /// no particular order.
    pub fn around(&self) -> &[Tet] {
        &self.whole()[self.own..]
    }

    /// As [`TetList::around`].
    pub fn around_mut(&mut self) -> &mut [Tet] {
        let own = self.own;
        &mut self.whole_mut()[own..]
    }

    /// As [`TetList::whole`], with the unused memory behind it.
    pub fn with_room(&mut self) -> (&[Tet], &mut [u64]) {
        match &mut self.memory {
            Memory::Listed(tets) => (tets, &mut []),
            Memory::Among(records, rows) => {
                let (tets, room) = bytemuck::cast_slice_mut::<Tetra, Tet>(records).split_at_mut(rows.end);
                (&tets[rows.start..], bytemuck::cast_slice_mut(room))
            }
        }
    }

    /// Keeps those for which `stays` is true, in their order; it is called last for those around.
    pub fn retain(&mut self, mut stays: impl FnMut(&Tet) -> bool) {
        let before = self.own;
        let (mut own, mut kept) = (0, 0);
        let whole = self.whole_mut();
        for i in 0..whole.len() {
            let tet = whole[i];
            if stays(&tet) {
                whole[kept] = tet;
                kept += 1;
                own += usize::from(i < before);
            }
        }
        self.own = own;
        match &mut self.memory {
            Memory::Listed(tets) => tets.truncate(kept),
            Memory::Among(_, rows) => rows.end = rows.start + kept,
        }
    }
}

impl Deref for TetList {
    type Target = [Tet];

    fn deref(&self) -> &[Tet] {
        &self.whole()[..self.own]
    }
}

impl DerefMut for TetList {
    fn deref_mut(&mut self) -> &mut [Tet] {
        let own = self.own;
        &mut self.whole_mut()[..own]
    }
}

impl From<Vec<Tet>> for TetList {
    fn from(tets: Vec<Tet>) -> Self {
        Self { own: tets.len(), memory: Memory::Listed(tets) }
    }
}

impl Default for TetList {
    fn default() -> Self {
        vec![].into()
    }
}

impl PartialEq for TetList {
    fn eq(&self, other: &Self) -> bool {
        **self == **other && self.around() == other.around()
    }
}

impl Eq for TetList {}

impl fmt::Debug for TetList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_the_same_wherever_it_is() {
        let tets: Vec<Tet> = (0..9).map(|i| [i, i + 1, i + 2, i + 3]).collect();
        let mut records = vec![Tetra::NONE; 5];
        bytemuck::cast_slice_mut(&mut records)[7..16].copy_from_slice(&tets);
        let (mut among, mut listed) = (TetList::among(records, 7..16, 6), TetList::from(tets[..6].to_vec()));
        assert!(among != listed && listed.around().is_empty() && listed.with_room().1.is_empty());
        let (mut lengths, mut all) = (vec![], tets);
        for stays in [|t: &Tet| t[0] != 4, |t: &Tet| t[0] & 3 != 3, |_: &Tet| false] {
            assert_eq!(format!("{among:?}"), format!("{listed:?}"));
            assert!(*among == *listed && among.whole() == all);
            lengths.push((among.len(), among.around().len()));
            let (whole, room) = among.with_room();
            assert_eq!((whole, room.len()), (&*all, 2 * (20 - 7 - all.len())));
            room.fill(u64::MAX);
            assert_eq!(among.whole(), all);
            among.retain(stays);
            listed.retain(stays);
            all.retain(stays);
        }
        assert_eq!(lengths, [(6, 3), (5, 3), (4, 2)]);
        assert!(among.whole().is_empty() && listed.whole().is_empty());
        assert!(matches!(among.into_memory(), Memory::Among(records, _) if records.len() == 5));
        assert!(matches!(listed.into_memory(), Memory::Listed(_)));
    }
}
