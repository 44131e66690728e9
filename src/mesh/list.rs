//! The tetrahedra of a chunk, in the memory in which they were meshed.
//!
//! A record of the mesher has 64 bytes, its vertices are 16 of them. When nothing else of the records is needed any more, there is room among them
//! for the vertices twice: as they are found, and in their final order. So a chunk takes 64 bytes a tetrahedron and no more, from its first point to
//! its last block; then the memory goes back to the mesher ([`Mesher::reuse`](super::delaunay::Mesher::reuse)), its pages warm.

use super::delaunay::Tetra;
use super::tet::Tet;
use std::fmt;
use std::ops::{Deref, DerefMut, Range};

/// A list of tetrahedra, used as a slice.
#[derive(Clone)]
pub struct TetList(Memory);

#[derive(Clone)]
enum Memory {
    Listed(Vec<Tet>),
    /// Records, as rows of four numbers, of which some are the list.
    Among(Vec<Tetra>, Range<usize>),
}

impl TetList {
    /// Some of the rows that the memory of the records has.
    pub(super) fn among(records: Vec<Tetra>, rows: Range<usize>) -> Self {
        Self(Memory::Among(records, rows))
    }

    /// The memory of the records, where the list is in such.
    pub(super) fn into_records(self) -> Option<Vec<Tetra>> {
        match self.0 {
            Memory::Among(records, _) => Some(records),
            Memory::Listed(_) => None,
        }
    }

    /// Keeps those of which `stays` is true, in their order.
    pub fn retain(&mut self, mut stays: impl FnMut(&Tet) -> bool) {
        let (mut kept, all) = (0, &mut **self);
        for i in 0..all.len() {
            let tet = all[i];
            if stays(&tet) {
                all[kept] = tet;
                kept += 1;
            }
        }
        match &mut self.0 {
            Memory::Listed(tets) => tets.truncate(kept),
            Memory::Among(_, rows) => rows.end = rows.start + kept,
        }
    }
}

impl Deref for TetList {
    type Target = [Tet];

    fn deref(&self) -> &[Tet] {
        match &self.0 {
            Memory::Listed(tets) => tets,
            Memory::Among(records, rows) => &bytemuck::cast_slice(records)[rows.clone()],
        }
    }
}

impl DerefMut for TetList {
    fn deref_mut(&mut self) -> &mut [Tet] {
        match &mut self.0 {
            Memory::Listed(tets) => tets,
            Memory::Among(records, rows) => &mut bytemuck::cast_slice_mut(records)[rows.clone()],
        }
    }
}

impl From<Vec<Tet>> for TetList {
    fn from(tets: Vec<Tet>) -> Self {
        Self(Memory::Listed(tets))
    }
}

impl Default for TetList {
    fn default() -> Self {
        vec![].into()
    }
}

impl PartialEq for TetList {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
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
        let (mut among, mut listed) = (TetList::among(records, 7..16), TetList::from(tets));
        for stays in [|t: &Tet| t[0] != 4, |t: &Tet| t[0] & 3 != 1, |_: &Tet| false] {
            assert_eq!(format!("{among:?}"), format!("{listed:?}"));
            assert!(among == listed && among.len() == listed.len());
            among.retain(stays);
            listed.retain(stays);
        }
        assert_eq!((among.len(), listed.len()), (0, 0));
        assert_eq!(among.into_records().map(|r| r.len()), Some(5));
        assert!(listed.into_records().is_none());
    }
}
