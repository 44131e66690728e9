//! Which edges and tetrahedra of a precomputed block does an isovalue cross?

use super::super::cases::CASES;
use super::sides::SPARE;
use super::{ByteTables, EDGES_MOST, GROUP, Precomputed, TURNED};
use crate::mesh::tet::is_active;

/// No vertex yet.
pub(in super::super) const NEW: u32 = u32::MAX;

/// Buffers for what an isovalue crosses.
#[derive(Debug, Default)]
pub(in super::super) struct Crossed {
    pub(in super::super) edges: Vec<u16>,
    /// The crossed edges that other blocks may have too.
    pub(in super::super) open: Vec<u16>,
    /// Active tetrahedra, and the corners inside of each.
    tets: Vec<[u16; 2]>,
    /// How many there are of each of these.
    pub(in super::super) counts: [usize; 3],
    /// The vertex of each crossed edge.
    pub(in super::super) vertices: Vec<u32>,
    /// The edges whose vertices are new; those of them that others may look for.
    pub(in super::super) new: Vec<u16>,
    pub(in super::super) first: Vec<u16>,
    /// The edges with a number in the chunk whose vertices are new.
    pub(in super::super) numbered: Vec<(u16, u32)>,
    triangles: Vec<[u32; 3]>,
}

impl Crossed {
    /// Room for all of a block.
    fn make_room(&mut self, block: Precomputed<'_>) {
        let grow = |list: &mut Vec<u16>, most: usize| list.resize(most.max(list.len()), 0);
        grow(&mut self.edges, block.shape.edges + SPARE);
        grow(&mut self.open, block.shape.edges + SPARE);
        grow(&mut self.new, block.shape.edges + SPARE);
        self.tets.resize((block.shape.tets + SPARE).max(self.tets.len()), [0; 2]);
        self.triangles.resize((2 * block.shape.tets + 2).max(self.triangles.len()), [0; 3]);
        self.vertices.resize(EDGES_MOST, NEW);
    }

    #[inline(always)]
    pub(in super::super) fn tets(&self) -> &[[u16; 2]] {
        &self.tets[..self.counts[2]]
    }

    /// Looks what is crossed, 64 corners at a time, in a block without void tetrahedra.
    #[inline(always)]
    pub(in super::super) fn find_at_once(
        &mut self,
        block: Precomputed<'_>,
        isovalue: f32,
        tables: ByteTables,
    ) {
        self.make_room(block);
        let table = block.sides(isovalue);
        // Neither end of an edge is a NaN.
        let lists = [&mut self.edges[..], &mut self.open];
        let [crossed, open] = tables.edges(&table, block.edges(), block.slots_of_edges(), lists);
        self.counts = [crossed, open, tables.tets(&table, block.tets(), &mut self.tets)];
    }

    /// Finds what is crossed.
    #[inline(always)]
    pub(in super::super) fn find(&mut self, block: Precomputed<'_>, isovalue: f32) {
        self.make_room(block);
        let sides = block.sides(isovalue);
        let (edges, slots, tets) = (block.edges(), block.slots_of_edges(), block.tets());
        let Self { edges: list, open: open_list, tets: active_list, .. } = self;
        let (list, open_list, active_list) = (&mut list[..], &mut open_list[..], &mut active_list[..]);
        let ([mut crossed, mut open, mut active], mut first) = ([0; 3], 0);
        for (group, n) in block.groups().iter().zip((0..tets.len()).step_by(GROUP)) {
            // The ends in a block of a file that is cut short meanwhile may be 0.
            let (begin, end) = (first, first.max(group.edges_end.into()).min(edges.len()));
            first = end;
            if !is_active(group.least, group.most, isovalue) {
                continue;
            }
            let slots = &slots[begin..end];
            for ((edge, slot), n) in edges[begin..end].iter().zip(slots).zip(begin as u16..) {
                // Neither end is a NaN.
                let [a, b] = edge.map(|corner| sides[usize::from(corner)]);
                let is_crossed = u16::from((a ^ b) & 1);
                (list[crossed], open_list[open]) = (n, n);
                crossed += usize::from(is_crossed);
                open += usize::from(is_crossed & slot >> 15);
            }
            for (tet, n) in tets[n..].iter().take(GROUP).zip(n as u16..) {
                let [a, b, c, d] = tet.map(|corner| sides[usize::from(corner)]);
                let inside = (a & 1) | (b & 1) << 1 | (c & 1) << 2 | (d & 1) << 3;
                active_list[active] = [n, inside.into()];
                active += usize::from(is_crossed(a + b + c + d));
            }
        }
        self.counts = [crossed, open, active];
    }

    /// Numbers the vertices that no other block has made, from the next one on, in the order of
    /// their edges; returns how many there are.
    #[inline(always)]
    pub(in super::super) fn number_new(&mut self, next: u32) -> usize {
        let mut count = 0;
        for &edge in &self.edges[..self.counts[0]] {
            let vertex = &mut self.vertices[usize::from(edge)];
            let is_new = *vertex == NEW;
            *vertex = if is_new { next + count as u32 } else { *vertex };
            self.new[count] = edge;
            count += usize::from(is_new);
        }
        count
    }

    /// Makes the triangles.
    #[inline(always)]
    pub(in super::super) fn list_triangles(&mut self, block: Precomputed<'_>) -> &[[u32; 3]] {
        let (tets, mut end) = (block.edges_of_tets(), 0);
        let vertices: &[u32; EDGES_MOST] =
            self.vertices.as_slice().try_into().expect("it was made so long before");
        for &[n, inside] in &self.tets[..self.counts[2]] {
            let edges = tets[usize::from(n)];
            let case = &CASES[usize::from(inside | (edges[0] & TURNED) >> 11) % CASES.len()];
            let at = |place: u8| vertices[usize::from(edges[usize::from(place) % 6]) % EDGES_MOST];
            // The second one is written even where there is none, and then ignored.
            for (triangle, corners) in self.triangles[end..end + 2].iter_mut().zip(case.sides) {
                *triangle = corners.map(at);
            }
            end += usize::from(case.triangles);
        }
        &self.triangles[..end]
    }
}

/// Whether of four sides some are inside and all others outside.
#[inline(always)]
fn is_crossed(sum: u8) -> bool {
    const CROSSED: u64 = 1 << (1 + 3 * 16) | 1 << (2 + 2 * 16) | 1 << (3 + 16);
    // Four outside are 64, which counts as 0: not crossed either.
    CROSSED >> (sum % 64) & 1 != 0
}

/// A sum, of its words.
#[inline(always)]
pub(in super::super) fn sum_of(&[a, b, c, d, e, f]: &[u32; 6]) -> [i64; 3] {
    [[a, b], [c, d], [e, f]].map(|[low, high]| (u64::from(low) | u64::from(high) << 32) as i64)
}
