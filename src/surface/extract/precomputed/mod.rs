//! A precomputed block: everything about its tetrahedra that does not depend on the isovalue.
//!
//! Much of a surface does not depend on the isovalue. All tetrahedra around a crossed edge are
//! active, so the sum of their gradients, and the normal of the vertex, belongs to the edge,
//! wherever it is crossed. A cached block stores it. For an edge with all its tetrahedra in the
//! block ([`super::numbering`] finds them) it stores the normal, for others the block's part of the
//! sum. Where all blocks of a chunk are at hand, most of those sums can be added up too ([`join`]).
//! What is left to do is to find which edges are crossed, and where ([`crossed`]).
//!
//! Corners are in the order of their ids, edges in the order in which tetrahedra first have them. A
//! surface numbers its vertices in both orders. So a group of consecutive tetrahedra has a run of
//! edges of its own. It also has a range of values, so that an isovalue skips most groups. All of
//! it is in one piece, in the order in which it is read:
//!
//! ```text
//!  groups │ numbers of corners in the chunk │ corners: position, value │ ends of edges │ their slots │ corners of tetrahedra
//!  │ edges of tetrahedra │ slots of edges │ ids of corners
//! ```
//!
//! The slot of an edge with all its tetrahedra in the block is the normal, three words. Any other
//! slot begins with a word that says its kind:
//!
//! ```text
//!  SUM │ three sums, two words each      blocks that are not at hand may have the edge: it is looked for in the chunk
//!  FIRST + number │ normal               the first block of the chunk that has the edge, with all about it
//!  number                                a later block: the vertex is that which the first has made
//! ```
//!
//! About 70 bytes per tetrahedron. (Blocks that get other values step by step are only numbered:
//! [`super::numbered`].) Void tetrahedra have no edges, and edges between them belong to none.

mod crossed;
mod join;
mod make;
mod sides;
mod stored;

use super::fours::Corner;
use super::ordered::{SHARED, Unpacked, shared_ids, sides_of};
use crate::exec::will_read;
use crate::geom::PointId;
use crate::mesh::tet::is_active;
pub(super) use crossed::{Crossed, NEW, sum_of};
pub(crate) use join::Joiner;
pub(super) use make::Maker;
pub(super) use sides::ByteTables;
use sides::Table;
pub(crate) use stored::Flaw;

/// Tetrahedra that have a common range of values, and a common run of edges.
const GROUP: usize = 16;
/// The most edges of a block; this many have less than 2^15 slots for what is stored of them.
const EDGES_MOST: usize = 1 << 14;
/// In the first edge of a tetrahedron: the order of its ids is an odd permutation of a positively
/// oriented one.
const TURNED: u16 = 1 << 15;
/// In the slot of an edge: other blocks may have tetrahedra around it.
pub(super) const OPEN: u16 = 1 << 15;
/// Before the slot of such an edge: what is in it. Else it is an edge of the chunk with a number,
/// and nothing is.
pub(super) const SUM: u32 = 1 << 31;
pub(super) const FIRST: u32 = 1 << 30;
/// The most words of slots, so that the place of each has 15 bits.
const SLOTS_MOST: usize = (1 << 15) - 8;
/// Words behind the last slot, so that each can be read as a normal, whether it is one or not.
const SLOTS_BEHIND: usize = 3;

/// Some tetrahedra: least and greatest value, and where what belongs to the edges ends that they
/// are the first to have.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Group {
    least: f32,
    most: f32,
    edges_end: u16,
    slots_end: u16,
}

/// The edges of a tetrahedron, its corners in the order of their ids, in the order of
/// [`super::cases::EDGES`]; the first with [`TURNED`].
type TetEdges = [u16; 6];

/// Whether a tetrahedron has no edges: those of others differ.
#[inline(always)]
fn is_void(edges: &TetEdges) -> bool {
    edges[1] == edges[2]
}

/// A normal, its bits.
pub(super) type Normal = [u32; 3];

/// A precomputed block in memory.
#[derive(Debug)]
pub(crate) struct PrecomputedBlock {
    words: Box<[u32]>,
    shape: Shape,
}

/// How long the lists of a block are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shape {
    corners: usize,
    edges: usize,
    tets: usize,
    slots: usize,
    /// Whether some tetrahedron has no edges.
    has_void: bool,
}

impl Shape {
    /// Where the lists end, in their order; behind the last are the ids.
    #[inline(always)]
    fn ends(&self) -> [usize; 7] {
        let groups = 3 * self.tets.div_ceil(GROUP);
        let numbers = groups + self.corners;
        let corners = numbers + 4 * self.corners;
        let edges = corners + self.edges;
        let tets = edges + self.tets;
        let tet_edges = tets + 3 * self.tets;
        [groups, numbers, corners, edges, tets, tet_edges, tet_edges + self.slots]
    }
}

impl PrecomputedBlock {
    /// Bytes of memory.
    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.words)
    }

    /// A view of the block.
    #[inline]
    pub(crate) fn view(&self) -> Precomputed<'_> {
        Precomputed { words: &self.words, shape: self.shape }
    }
}

/// A precomputed block, in memory or in a file that is mapped.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Precomputed<'a> {
    words: &'a [u32],
    shape: Shape,
}

impl<'a> Precomputed<'a> {
    /// Where the lists end, in their order; the slots of edges are in the same words as their ends.
    #[inline(always)]
    fn ends(&self) -> [usize; 7] {
        self.shape.ends()
    }

    #[inline(always)]
    fn groups(&self) -> &'a [Group] {
        bytemuck::cast_slice(&self.words[..self.ends()[0]])
    }

    #[inline(always)]
    pub(super) fn numbers(&self) -> &'a [u32] {
        let [groups, numbers, ..] = self.ends();
        &self.words[groups..numbers]
    }

    /// The positions and values of the corners.
    #[inline(always)]
    pub(super) fn at(&self) -> &'a [Corner] {
        let [_, numbers, corners, ..] = self.ends();
        bytemuck::cast_slice(&self.words[numbers..corners])
    }

    /// The ends of edges, the corner of lower id first.
    #[inline(always)]
    pub(super) fn edges(&self) -> &'a [[u8; 2]] {
        let [_, _, corners, edges, ..] = self.ends();
        &bytemuck::cast_slice(&self.words[corners..edges])[..self.shape.edges]
    }

    /// Where in the slots that of each edge begins; with [`OPEN`], behind the word that says what
    /// it is.
    #[inline(always)]
    pub(super) fn slots_of_edges(&self) -> &'a [u16] {
        let [_, _, corners, edges, ..] = self.ends();
        &bytemuck::cast_slice(&self.words[corners..edges])[self.shape.edges..]
    }

    /// The corners of tetrahedra, in the order of their ids.
    #[inline(always)]
    fn tets(&self) -> &'a [[u8; 4]] {
        let [_, _, _, edges, tets, ..] = self.ends();
        bytemuck::cast_slice(&self.words[edges..tets])
    }

    #[inline(always)]
    fn edges_of_tets(&self) -> &'a [TetEdges] {
        let [.., tets, tet_edges, _] = self.ends();
        bytemuck::cast_slice(&self.words[tets..tet_edges])
    }

    #[inline(always)]
    pub(super) fn slots(&self) -> &'a [u32] {
        let [.., tet_edges, slots] = self.ends();
        &self.words[tet_edges..slots]
    }

    #[inline(always)]
    fn ids(&self) -> &'a [u32] {
        &self.words[self.ends()[6]..]
    }

    /// The ids of two corners, if other chunks may have both.
    #[inline(always)]
    pub(super) fn shared(&self, ends: [u8; 2]) -> Option<(PointId, PointId)> {
        shared_ids(self.numbers(), self.ids(), ends)
    }

    /// Whether some tetrahedron has no edges.
    #[inline(always)]
    pub(super) fn has_void(&self) -> bool {
        self.shape.has_void
    }

    /// Asks the processor to load what is needed of any block: all but the edges of tetrahedra,
    /// slots and ids.
    pub(crate) fn corners_will_be_read(&self) {
        will_read(&self.words[..self.ends()[4]]);
    }

    /// Asks the processor to load the rest, for tetrahedra that may be active, of a block whose
    /// groups are at hand.
    pub(crate) fn tets_will_be_read(&self, isovalues: &[f32]) {
        let (tets, slots) = (self.edges_of_tets(), self.slots());
        let mut slot = 0;
        for (tets, group) in tets.chunks(GROUP).zip(self.groups()) {
            let end = slot.max(group.slots_end.into()).min(slots.len());
            if isovalues.iter().any(|&v| is_active(group.least, group.most, v)) {
                will_read(tets);
                will_read(&slots[slot..end]);
            }
            slot = end;
        }
    }

    /// On which side each corner is: inside 1, outside 16, a NaN 0.
    #[inline(always)]
    fn sides(&self, isovalue: f32) -> Table {
        sides_of(self.at(), isovalue)
    }

    /// Whether the corners of each tetrahedron are in different places.
    pub(crate) fn has_whole_tets(&self) -> bool {
        let at = self.at();
        let place = |corner: u8| [0, 1, 2].map(|k| at[usize::from(corner)][k]);
        self.tets().iter().all(|tet| {
            let places = tet.map(place);
            (1..4).all(|i| !places[..i].contains(&places[i]))
        })
    }

    /// All of the block as it was: its corners in the order of their ids.
    pub(crate) fn unpack(&self, out: &mut Unpacked<'_>) {
        let tets = self.tets().iter().zip(self.edges_of_tets()).map(|(tet, edges)| {
            let [a, b, c, d] = tet.map(u32::from);
            if edges[0] & TURNED == 0 { [a, b, c, d] } else { [a, b, d, c] }
        });
        out.put(self.numbers(), self.at(), self.ids(), tets);
    }
}

#[cfg(test)]
mod tests;
