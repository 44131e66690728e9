//! A block of tetrahedra whose corners and edges have been numbered once, for many isovalues, or
//! for the values of one step after another.
//!
//! Corners are in the order of their ids. A tetrahedron of 16 bytes has the numbers of its corners
//! and of its six edges, so that nothing is looked up when a surface is extracted. Edges with all
//! their tetrahedra in the block ([`super::numbering`] finds them) come first, so that the number
//! of an edge shows that too. Groups of consecutive tetrahedra have a common range of values, so
//! that an isovalue passes over most of them. All of it is in one piece, in the order in which it
//! is looked at:
//!
//! ```text
//!  ranges of groups │ numbers of corners in the chunk │ corners: position, value │ tetrahedra │ ids of corners
//! ```
//!
//! About 28 bytes a tetrahedron.

use super::cases::{EDGES, ODD};
use super::cells::{CellSource, in_order};
use super::fours::Corner;
use super::numbering::{Ring, code_of};
use super::ordered::{EDGE_SLOTS, Order, SHARED, Unpacked, shared_ids, sides_of, slot_of};
use super::patch::{ActiveTet, CORNERS, Corners, NO_EDGE, Patch};
use isospan_io::exec::will_read;
use isospan_io::geom::PointId;
use isospan_mesh::mesh::tet::{Tet, is_active, range};

/// Tetrahedra that have a range of values together.
const GROUP: usize = 16;
/// A tetrahedron, its last two corners swapped where the order of its ids is an odd permutation of
/// a positively oriented one.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct NumberedTet {
    corners: [u8; 4],
    /// In the order of [`EDGES`], of the corners in the order of their ids.
    edges: [u16; 6],
}

/// A block, numbered.
#[derive(Debug)]
pub(crate) struct NumberedBlock {
    words: Box<[u32]>,
    tets: usize,
    corners: usize,
    /// Edges with numbers below this have all their tetrahedra here.
    alone: u16,
}

/// Buffers in which blocks are numbered and worked on.
#[derive(Debug, Default)]
pub(super) struct BlockBuffers {
    slots: Vec<u16>,
    active: Vec<u16>,
    tets: Vec<NumberedTet>,
    ends: Vec<[u8; 2]>,
    rings: Vec<Ring>,
    renumbered: Vec<u16>,
}

impl BlockBuffers {
    /// A slot for each edge, empty.
    fn slots(slots: &mut Vec<u16>) -> &mut [u16; EDGE_SLOTS] {
        slots.resize(EDGE_SLOTS, NO_EDGE);
        slots.as_mut_slice().try_into().expect("it was made so long just now")
    }

    /// Replaces `tets` by some, their edges numbered, those with all tetrahedra around them first;
    /// returns how many these are.
    fn number(&mut self, tets: impl ExactSizeIterator<Item = [u8; 4]>) -> u16 {
        let Self { ends, rings, .. } = self;
        ends.resize((6 * tets.len() + 1).max(ends.len()), [0; 2]);
        rings.resize((6 * tets.len() + 1).max(rings.len()), Ring::default());
        let count = self.list_edges(tets);
        let slots = Self::slots(&mut self.slots);
        let (ends, rings) = (&self.ends[..count], &self.rings[..count]);
        ends.iter().for_each(|&edge| slots[slot_of(edge)] = NO_EDGE);
        let is_alone = || rings.iter().zip(ends).map(|(ring, &ends)| ring.is_closed(ends));
        let alone = is_alone().filter(|&alone| alone).count() as u16;
        let mut next = [alone, 0];
        self.renumbered.clear();
        self.renumbered.extend(is_alone().map(|alone| {
            let next = &mut next[usize::from(alone)];
            *next += 1;
            *next - 1
        }));
        for edge in self.tets.iter_mut().flat_map(|tet| &mut tet.edges) {
            *edge = self.renumbered[usize::from(*edge)];
        }
        alone
    }

    /// Numbers edges in the order in which they are met, without a branch for each; returns how
    /// many there are.
    fn list_edges(&mut self, tets: impl Iterator<Item = [u8; 4]>) -> usize {
        let (slots, mut count) = (Self::slots(&mut self.slots), 0);
        self.tets.clear();
        self.tets.extend(tets.map(|corners| {
            let [a, b, c, d] = corners;
            let (sorted, code) = ([a, b, c.min(d), c.max(d)], code_of(corners));
            let edges = EDGES.map(|edge| {
                let edge = edge.map(|i| sorted[usize::from(i) % 4]);
                let slot = &mut slots[slot_of(edge)];
                let is_new = *slot == NO_EDGE;
                let number = if is_new { count as u16 } else { *slot };
                *slot = number;
                self.ends[count] = edge;
                count += usize::from(is_new);
                let ring = &mut self.rings[usize::from(number)];
                *ring = if is_new { Ring::default() } else { *ring };
                ring.add(code);
                number
            });
            NumberedTet { corners, edges }
        }));
        count
    }
}

impl NumberedBlock {
    /// Numbers a block. `None` if it has too many corners or tetrahedra, which is rare, or corners
    /// without numbers in a chunk.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(super) fn of(cells: &CellSource<'_>, buffers: &mut BlockBuffers) -> Option<Self> {
        let (order, corners, tets) = (Order::of(cells)?, cells.ids.len(), cells.tets.len());
        let rank = order.ranks();
        let ordered = |t: &Tet| in_order(cells.ids, t).map(|v| rank[v as usize]);
        let alone = buffers.number(cells.tets.iter().map(ordered));
        let mut words = Vec::with_capacity(2 * tets.div_ceil(GROUP) + 7 * corners + 4 * tets);
        for group in cells.tets.chunks(GROUP) {
            words.extend_from_slice(&range_of(group, cells.values));
        }
        words.extend(order.numbers(cells));
        words.extend(order.corners(cells).flat_map(|corner| corner.map(f32::to_bits)));
        for tet in &buffers.tets {
            words.extend_from_slice(&bytemuck::cast::<NumberedTet, [u32; 4]>(*tet));
        }
        words.extend(order.ids(cells));
        Some(Self { words: words.into(), tets, corners, alone })
    }

    /// Bytes of memory.
    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.words)
    }

    /// Asks the processor for what shows which tetrahedra are active.
    pub(crate) fn will_be_read(&self) {
        will_read(&self.words[..self.starts()[2]]);
    }

    /// Where corners' numbers, corners, tetrahedra and ids begin.
    #[inline(always)]
    fn starts(&self) -> [usize; 4] {
        let numbers = 2 * self.tets.div_ceil(GROUP);
        let corners = numbers + self.corners;
        let tets = corners + 4 * self.corners;
        [numbers, corners, tets, tets + 4 * self.tets]
    }

    #[inline(always)]
    fn ranges(&self) -> &[[f32; 2]] {
        bytemuck::cast_slice(&self.words[..self.starts()[0]])
    }

    #[inline(always)]
    fn numbers(&self) -> &[u32] {
        let [numbers, corners, ..] = self.starts();
        &self.words[numbers..corners]
    }

    #[inline(always)]
    fn tets(&self) -> &[NumberedTet] {
        let [.., tets, ids] = self.starts();
        bytemuck::cast_slice(&self.words[tets..ids])
    }

    #[inline(always)]
    fn ids(&self) -> &[u32] {
        &self.words[self.starts()[3]..]
    }

    /// Gives the corners other values: those that `values` has at their numbers in the chunk.
    pub(crate) fn set_values(&mut self, values: &[f32]) {
        let [numbers, corners, tets, _] = self.starts();
        // The ranges have not been asked for yet, and a look at all tetrahedra costs less than they
        // would.
        bytemuck::cast_slice_mut(&mut self.words[..numbers]).fill([f32::NEG_INFINITY, f32::INFINITY]);
        let (numbers, at) = self.words[numbers..tets].split_at_mut(corners - numbers);
        for (n, at) in numbers.iter().zip(at.chunks_exact_mut(4)) {
            at[3] = values[(n & !SHARED) as usize].to_bits();
        }
    }

    /// Lists the active tetrahedra; returns how many there are.
    #[inline(always)]
    pub(super) fn list(&self, isovalue: f32, buffers: &mut BlockBuffers, patch: &mut Patch) -> usize {
        let sides = sides_of(self.at(), isovalue);
        let (tets, active) = (self.tets(), self.active(isovalue, &sides, &mut buffers.active));
        let mut list = patch.list(active.len(), BlockBuffers::slots(&mut buffers.slots));
        for &n in active {
            let tet = &tets[usize::from(n)];
            let [a, b, c, d] = tet.corners;
            let corners = [a, b, c.min(d), c.max(d)];
            let inside = |i: usize| (sides[usize::from(corners[i])] & 1) << i;
            let odd = if d < c { ODD } else { 0 };
            let case = odd | inside(0) | inside(1) | inside(2) | inside(3);
            list.add(ActiveTet { corners, case }, |case, k| tet.edges[usize::from(case.numbers[k]) % 6]);
        }
        list.end();
        patch.alone_are(|edge| edge < self.alone);
        active.len()
    }

    /// The numbers of the active tetrahedra, found without a branch for each.
    #[inline(always)]
    fn active<'a>(&self, isovalue: f32, sides: &[u8; CORNERS], buffer: &'a mut Vec<u16>) -> &'a [u16] {
        if buffer.len() <= self.tets {
            buffer.resize(self.tets + 1, 0);
        }
        let mut end = 0;
        for ((group, &[lo, hi]), first) in
            self.tets().chunks(GROUP).zip(self.ranges()).zip((0u16..).step_by(GROUP))
        {
            if is_active(lo, hi, isovalue) {
                for (tet, n) in group.iter().zip(first..) {
                    let [a, b, c, d] = tet.corners.map(|c| sides[usize::from(c)]);
                    buffer[end] = n;
                    end += usize::from(is_crossed(a + b + c + d));
                }
            }
        }
        &buffer[..end]
    }

    /// All of the block as it was: its corners in the order of their ids.
    pub(crate) fn unpack(&self, out: &mut Unpacked<'_>) {
        let tets = self.tets().iter().map(|t| t.corners.map(u32::from));
        out.put(self.numbers(), self.at(), self.ids(), tets);
    }
}

impl Corners for NumberedBlock {
    #[inline(always)]
    fn at(&self) -> &[Corner] {
        let [_, corners, tets, _] = self.starts();
        bytemuck::cast_slice(&self.words[corners..tets])
    }

    #[inline(always)]
    fn number(&self, corner: u8) -> u32 {
        self.numbers()[usize::from(corner)] & !SHARED
    }

    #[inline(always)]
    fn shared(&self, ends: [u8; 2]) -> Option<(PointId, PointId)> {
        shared_ids(self.numbers(), self.ids(), ends)
    }
}

/// Whether of four sides some are inside and all others outside.
#[inline(always)]
fn is_crossed(sum: u8) -> bool {
    const CROSSED: u64 = 1 << (1 + 3 * 16) | 1 << (2 + 2 * 16) | 1 << (3 + 16);
    // Four outside are 64, which counts as 0: not crossed either.
    CROSSED >> (sum % 64) & 1 != 0
}

/// Least and largest value of tetrahedra, void ones left out, as bits.
fn range_of(tets: &[Tet], values: &[f32]) -> [u32; 2] {
    let ranges = tets.iter().filter_map(|t| range(t.map(|v| values[v as usize])));
    let none = [f32::INFINITY, f32::NEG_INFINITY];
    ranges.fold(none, |[lo, hi], (least, most)| [lo.min(least), hi.max(most)]).map(f32::to_bits)
}

#[cfg(test)]
pub(super) mod tests;
