//! A block of tetrahedra whose corners and edges have been numbered once, for one isovalue after another.
//!
//! Corners are in the order of their ids. A tetrahedron of 16 bytes has the numbers of its corners and of its six edges, so that
//! nothing is looked up when a surface is extracted, and edges with all their tetrahedra in the block ([`super::numbering`] tells which)
//! come first, so that a number tells that too. Tetrahedra that follow each other have a range of values together, so that an
//! isovalue passes over most of them. All of it is in one piece, in the order in which it is looked at:
//!
//! ```text
//!  ranges of groups │ numbers of corners in the chunk │ corners: position, value │ tetrahedra │ ids of corners
//! ```
//!
//! About 28 bytes a tetrahedron.

use super::cases::{EDGES, ODD};
use super::fours::Corner;
use super::marching_tets::{CellSource, in_order};
use super::numbering::{Numbering, Ring, code_of, empty_slots, join};
use super::patch::{CORNERS, Corners, Member, NO_EDGE, Patch};
use crate::exec::will_read;
use crate::geom::{LatticePos, PointId};
use crate::mesh::tet::{Tet, is_active, range};

/// Tetrahedra that have a range of values together.
const GROUP: usize = 16;
/// Edges between as many corners as there may be: the next power of two.
const EDGE_SLOTS: usize = 1 << 15;
/// In the number of a corner: other chunks may have it.
const SHARED: u32 = 1 << 31;

/// A tetrahedron, its last two corners swapped where the order of its ids is an odd permutation of a positively oriented one.
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
    /// The edges below have all their tetrahedra here.
    alone: u16,
}

/// What a block is numbered and worked on in: buffers.
#[derive(Debug, Default)]
pub(super) struct BlockBuffers {
    slots: Vec<u16>,
    active: Vec<u16>,
}

impl BlockBuffers {
    pub(super) fn bytes(&self) -> usize {
        2 * (self.slots.capacity() + self.active.capacity())
    }
}

impl NumberedBlock {
    /// Numbers a block. `None` of one with too many corners or tetrahedra, which is rare, or of corners without numbers in a chunk.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(super) fn of(cells: &CellSource<'_>, numbering: &mut Numbering) -> Option<Self> {
        let (numbers, count) = (cells.numbers?, cells.ids.len());
        if count > CORNERS
            || cells.tets.len() >= usize::from(u16::MAX)
            || numbers.iter().any(|&n| n >= SHARED)
        {
            return None;
        }
        let mut order: Vec<u8> = (0..count).map(|i| i as u8).collect();
        order.sort_unstable_by_key(|&i| cells.ids[usize::from(i)]);
        let mut rank = [0; CORNERS];
        (0..=255).zip(&order).for_each(|(r, &i)| rank[usize::from(i)] = r);
        let ordered = |t: &Tet| in_order(cells.ids, t).map(|v| rank[v as usize]);
        let (tets, alone) = number_edges(cells.tets.iter().map(ordered), numbering);
        let mut words = vec![];
        let corners = order.iter().map(|&i| usize::from(i));
        words.extend(cells.tets.chunks(GROUP).flat_map(|group| range_of(group, cells.values)));
        words.extend(corners.clone().map(|i| numbers[i] | if cells.shared[i] { SHARED } else { 0 }));
        words.extend(corners.clone().flat_map(|i| {
            // At most 2^24: exact.
            let [x, y, z] = cells.positions[i].map(|x| (x as f32).to_bits());
            [x, y, z, cells.values[i].to_bits()]
        }));
        words.extend(tets.iter().flat_map(|tet| bytemuck::cast::<NumberedTet, [u32; 4]>(*tet)));
        words.extend(corners.flat_map(|i| [cells.ids[i].0 as u32, (cells.ids[i].0 >> 32) as u32]));
        Some(Self { words: words.into(), tets: tets.len(), corners: count, alone })
    }

    /// Bytes of memory.
    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.words)
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
    fn id(&self, corner: usize) -> PointId {
        let at = self.starts()[3] + 2 * corner;
        PointId(u64::from(self.words[at]) | u64::from(self.words[at + 1]) << 32)
    }

    /// Asks the processor for what is looked at of any block.
    pub(crate) fn corners_will_be_read(&self) {
        will_read(&self.words[..self.starts()[2]]);
    }

    /// Asks the processor for tetrahedra that may be active, of a block whose ranges are at hand.
    pub(crate) fn tets_will_be_read(&self, isovalues: &[f32]) {
        for (group, &[lo, hi]) in self.tets().chunks(GROUP).zip(self.ranges()) {
            if isovalues.iter().any(|&v| is_active(lo, hi, v)) {
                will_read(group);
            }
        }
    }

    /// Lists the active tetrahedra; tells how many.
    #[inline(always)]
    pub(super) fn list(&self, isovalue: f32, buffers: &mut BlockBuffers, patch: &mut Patch) -> usize {
        let sides = self.sides(isovalue);
        let (tets, active) = (self.tets(), self.active(isovalue, &sides, &mut buffers.active));
        buffers.slots.resize(EDGE_SLOTS, NO_EDGE);
        let slots: &mut [u16; EDGE_SLOTS] =
            buffers.slots.as_mut_slice().try_into().expect("it was made so long just now");
        let mut list = patch.list(active.len(), slots);
        for &n in active {
            let tet = &tets[usize::from(n)];
            let [a, b, c, d] = tet.corners;
            let corners = [a, b, c.min(d), c.max(d)];
            let inside = |i: usize| (sides[usize::from(corners[i])] & 1) << i;
            let odd = if d < c { ODD } else { 0 };
            let case = odd | inside(0) | inside(1) | inside(2) | inside(3);
            list.add(Member { corners, case }, |case, k| tet.edges[usize::from(case.numbers[k]) % 6]);
        }
        list.end();
        patch.alone_are(|edge| edge < self.alone);
        active.len()
    }

    /// On which side each corner is: inside 1, outside 16, a NaN 0.
    #[inline(always)]
    fn sides(&self, isovalue: f32) -> [u8; CORNERS] {
        let mut sides = [0; CORNERS];
        for (side, corner) in sides.iter_mut().zip(self.at()) {
            let v = corner[3];
            *side = u8::from(v >= isovalue) | u8::from(v < isovalue) << 4;
        }
        sides
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
        let whole = |x: f32| x as u32;
        out.numbers.clear();
        out.numbers.extend(self.numbers().iter().map(|n| n & !SHARED));
        out.shared.clear();
        out.shared.extend(self.numbers().iter().map(|n| n & SHARED != 0));
        out.positions.clear();
        out.positions.extend(self.at().iter().map(|&[x, y, z, _]| [whole(x), whole(y), whole(z)]));
        out.values.clear();
        out.values.extend(self.at().iter().map(|at| at[3]));
        out.ids.clear();
        out.ids.extend((0..self.corners).map(|i| self.id(i)));
        out.tets.clear();
        out.tets.extend(self.tets().iter().map(|t| t.corners.map(u32::from)));
    }
}

/// Where a block is unpacked.
pub(crate) struct Unpacked<'a> {
    pub(crate) numbers: &'a mut Vec<u32>,
    pub(crate) positions: &'a mut Vec<LatticePos>,
    pub(crate) ids: &'a mut Vec<PointId>,
    pub(crate) values: &'a mut Vec<f32>,
    pub(crate) shared: &'a mut Vec<bool>,
    pub(crate) tets: &'a mut Vec<Tet>,
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
    fn shared(&self, [a, b]: [u8; 2]) -> Option<(PointId, PointId)> {
        let [a, b] = [usize::from(a), usize::from(b)];
        let is_shared = self.numbers()[a] & self.numbers()[b] & SHARED != 0;
        is_shared.then(|| (self.id(a), self.id(b)))
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

/// Numbers the edges of tetrahedra, those with all tetrahedra around them first, and tells how many these are.
fn number_edges(tets: impl Iterator<Item = [u8; 4]>, numbering: &mut Numbering) -> (Vec<NumberedTet>, u16) {
    let (slots, mut ends, mut rings) = (empty_slots(numbering.slots()), vec![], vec![]);
    let number = |corners: [u8; 4]| {
        let [a, b, c, d] = corners;
        let (sorted, code) = ([a, b, c.min(d), c.max(d)], code_of(corners));
        let edges = EDGES.map(|edge| {
            let edge = edge.map(|i| sorted[usize::from(i)]);
            let slot = &mut slots[usize::from(join(edge))];
            if *slot == NO_EDGE {
                *slot = ends.len() as u16;
                ends.push(edge);
                rings.push(Ring::default());
            }
            rings[usize::from(*slot)].add(code);
            *slot
        });
        NumberedTet { corners, edges }
    };
    let mut tets: Vec<NumberedTet> = tets.map(number).collect();
    ends.iter().for_each(|&edge| slots[usize::from(join(edge))] = NO_EDGE);
    let is_alone: Vec<bool> = rings.iter().zip(&ends).map(|(ring, &ends)| ring.is_closed(ends)).collect();
    let alone = is_alone.iter().filter(|&&alone| alone).count() as u16;
    let mut next = [alone, 0];
    let renumbered: Vec<u16> = is_alone
        .iter()
        .map(|&alone| {
            let next = &mut next[usize::from(alone)];
            *next += 1;
            *next - 1
        })
        .collect();
    for edge in tets.iter_mut().flat_map(|tet| &mut tet.edges) {
        *edge = renumbered[usize::from(*edge)];
    }
    (tets, alone)
}

#[cfg(test)]
#[path = "numbered_tests.rs"]
mod tests;
