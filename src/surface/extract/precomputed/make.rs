//! Numbers the corners and edges of a block, and sums up the gradients around its edges.

use super::super::cases::EDGES;
use super::super::cells::{CellSource, along_edge, in_order};
use super::super::fours::{self, Corner, Gradient};
use super::super::numbering::{Ring, code_of};
use super::super::ordered::{EDGE_SLOTS, Order, slot_of};
use super::super::patch::{CORNERS, NO_EDGE, add_term, up};
use super::{
    EDGES_MOST, GROUP, Group, OPEN, PrecomputedBlock, SLOTS_BEHIND, SLOTS_MOST, SUM, Shape, TURNED, TetEdges,
    is_void,
};
use crate::mesh::tet::range;
use crate::simd::{Avx2, F64x4s, Plain, on_avx2_or_plain};
use crate::surface::world_map::WorldMap;

/// Buffers in which blocks are numbered, some hundred kilobytes.
#[derive(Debug, Default)]
pub(in super::super) struct Maker {
    /// For each pair of corners the number of its edge, while edges are listed.
    numbers: Vec<u16>,
    at: Vec<Corner>,
    tets: Vec<[u8; 4]>,
    tet_edges: Vec<TetEdges>,
    groups: Vec<Group>,
    edges: Vec<[u8; 2]>,
    slots_of_edges: Vec<u16>,
    rings: Vec<Ring>,
    gradients: Vec<Gradient>,
    units: Vec<f64>,
    sums: Vec<[i64; 4]>,
    slots: Vec<u32>,
}

/// Edges while they are numbered, in the order in which they are met, without a branch for each.
struct EdgeList<'a> {
    /// The number of each edge that was met.
    numbers: &'a mut [u16; EDGE_SLOTS],
    edges: &'a mut [[u8; 2]],
    rings: &'a mut [Ring],
    count: usize,
}

impl<'a> EdgeList<'a> {
    /// An empty list with room for the edges of `tets` tetrahedra.
    fn new(
        tets: usize,
        numbers: &'a mut Vec<u16>,
        edges: &'a mut Vec<[u8; 2]>,
        rings: &'a mut Vec<Ring>,
    ) -> Self {
        numbers.resize(EDGE_SLOTS, NO_EDGE);
        edges.resize(6 * tets + 1, [0; 2]);
        rings.resize(6 * tets + 1, Ring::default());
        let numbers = numbers.as_mut_slice().try_into().expect("it was made so long just now");
        Self { numbers, edges, rings, count: 0 }
    }

    /// The edges of a tetrahedron.
    #[inline(always)]
    fn number(&mut self, corners: [u8; 4]) -> [u16; 6] {
        let code = code_of(corners);
        EDGES.map(|edge| {
            let ends = edge.map(|i| corners[usize::from(i) % 4]);
            let slot = &mut self.numbers[slot_of(ends)];
            let is_new = *slot == NO_EDGE;
            let number = if is_new { self.count as u16 } else { *slot };
            *slot = number;
            self.edges[self.count] = ends;
            self.count += usize::from(is_new);
            let ring = &mut self.rings[usize::from(number)];
            *ring = if is_new { Ring::default() } else { *ring };
            ring.add(code);
            number
        })
    }

    /// Forgets the numbers; returns how many there were.
    fn end(self) -> usize {
        for &edge in &self.edges[..self.count] {
            self.numbers[slot_of(edge)] = NO_EDGE;
        }
        self.count
    }
}

impl Maker {
    /// Finds out about a block. `None` of one with too many corners or edges, which is rare, or of
    /// corners without numbers in a chunk.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(in super::super) fn make(
        &mut self,
        cells: &CellSource<'_>,
        world: &WorldMap,
    ) -> Option<PrecomputedBlock> {
        self.make_on(cells, world, Avx2::found())
    }

    /// With vectors of AVX2, or without: the same bits.
    pub(super) fn make_on(
        &mut self,
        cells: &CellSource<'_>,
        world: &WorldMap,
        avx2: Option<Avx2>,
    ) -> Option<PrecomputedBlock> {
        let (order, corners, tets) = (Order::of(cells)?, cells.ids.len(), cells.tets.len());
        self.at.clear();
        self.at.extend(order.corners(cells));
        if !self.list(cells, &order.ranks()) {
            return None;
        }
        on_avx2_or_plain!(avx2, F64x4, Plain<f64, 4>, |W, token| self.know_edges::<W>(token, world));
        if self.slots.len() > SLOTS_MOST {
            return None;
        }
        let [groups, edges, slots] = [self.groups.len(), self.edges.len(), self.slots.len()];
        let mut words = Vec::with_capacity(3 * groups + 7 * corners + edges + 4 * tets + slots);
        words.extend_from_slice(bytemuck::cast_slice(&self.groups));
        words.extend(order.numbers(cells));
        words.extend_from_slice(bytemuck::cast_slice(&self.at));
        let begin = words.len();
        words.resize(begin + edges, 0);
        let (ends, slots_of_edges) =
            bytemuck::cast_slice_mut::<u32, [u8; 2]>(&mut words[begin..]).split_at_mut(edges);
        ends.copy_from_slice(&self.edges);
        bytemuck::cast_slice_mut(slots_of_edges).copy_from_slice(&self.slots_of_edges);
        let begin = words.len();
        words.resize(begin + 4 * tets, 0);
        let (of_corners, of_edges) = words[begin..].split_at_mut(tets);
        bytemuck::cast_slice_mut(of_corners).copy_from_slice(&self.tets);
        bytemuck::cast_slice_mut(of_edges).copy_from_slice(&self.tet_edges);
        words.extend_from_slice(&self.slots);
        words.extend(order.ids(cells));
        let has_void = self.tet_edges.iter().any(is_void);
        let shape = Shape { corners, edges, tets, slots, has_void };
        Some(PrecomputedBlock { words: words.into(), shape })
    }

    /// Lists tetrahedra, groups and edges. False if there are too many.
    fn list(&mut self, cells: &CellSource<'_>, rank: &[u8; CORNERS]) -> bool {
        self.tets.clear();
        self.tet_edges.clear();
        self.groups.clear();
        let mut list = EdgeList::new(cells.tets.len(), &mut self.numbers, &mut self.edges, &mut self.rings);
        for group in cells.tets.chunks(GROUP) {
            let none = [f32::INFINITY, f32::NEG_INFINITY];
            let mut ends = none;
            for tet in group {
                let values = range(tet.map(|v| cells.values[v as usize]));
                ends = values.map_or(ends, |(lo, hi)| [ends[0].min(lo), ends[1].max(hi)]);
                let [a, b, c, d] = in_order(cells.ids, tet).map(|v| rank[v as usize]);
                let (corners, turned) = ([a, b, c.min(d), c.max(d)], if d < c { TURNED } else { 0 });
                let mut edges = if values.is_some() { list.number(corners) } else { [0; 6] };
                edges[0] |= turned;
                self.tets.push(corners);
                self.tet_edges.push(edges);
            }
            // Less than 2^15 where the block is not refused below.
            let edges_end = list.count as u16;
            self.groups.push(Group { least: ends[0], most: ends[1], edges_end, slots_end: 0 });
        }
        let count = list.end();
        self.edges.truncate(count);
        self.rings.truncate(count);
        count <= EDGES_MOST
    }

    /// Finds what is known of edges: the normals of those with all their tetrahedra here, of others
    /// the part of the sum.
    #[inline(always)]
    fn know_edges<W: F64x4s>(&mut self, token: W::Token, world: &WorldMap) {
        self.find_gradients::<W>(token);
        self.sum_up::<W>(token);
        self.slots.clear();
        self.slots_of_edges.clear();
        let known = self.sums.chunks(4).zip(self.rings.chunks(4));
        for (edges, (sums, rings)) in self.edges.chunks(4).zip(known) {
            let mut four = [[0; 3]; 4];
            for (to, &[x, y, z, _]) in four.iter_mut().zip(sums) {
                *to = [x, y, z];
            }
            let normals = fours::normals::<W>(token, &four, world);
            for (((&ends, sum), normal), ring) in edges.iter().zip(four).zip(normals).zip(rings) {
                if ring.is_closed(ends) {
                    let at = || ends.map(|corner| &self.at[usize::from(corner)]);
                    let normal = normal.unwrap_or_else(|| along_edge(up(at()), world));
                    self.slots_of_edges.push(self.slots.len() as u16);
                    self.slots.extend(normal.map(f32::to_bits));
                } else {
                    self.slots.push(SUM);
                    self.slots_of_edges.push(self.slots.len() as u16 | OPEN);
                    self.slots.extend(sum.iter().flat_map(|&x| [x as u32, (x >> 32) as u32]));
                }
            }
        }
        close_groups(&mut self.groups, &self.slots_of_edges, self.slots.len());
        self.slots.extend([0; SLOTS_BEHIND]);
    }

    #[inline(always)]
    fn find_gradients<W: F64x4s>(&mut self, token: W::Token) {
        self.gradients.clear();
        for (tets, edges) in self.tets.chunks(4).zip(self.tet_edges.chunks(4)) {
            let four = tets.iter().zip(edges);
            let (mut corners, mut signs) = ([[&self.at[0]; 4]; 4], [1.0; 4]);
            for (((tet, edges), corners), sign) in four.zip(&mut corners).zip(&mut signs) {
                *corners = tet.map(|corner| &self.at[usize::from(corner)]);
                *sign = if edges[0] & TURNED == 0 { 1.0 } else { -1.0 };
            }
            self.gradients.extend_from_slice(&fours::gradients::<W>(token, corners, &signs));
        }
    }

    /// Sums up the gradients around edges.
    #[inline(always)]
    fn sum_up<W: F64x4s>(&mut self, token: W::Token) {
        self.units.clear();
        for four in self.edges.chunks(4) {
            let mut ends = [[&self.at[0]; 2]; 4];
            for (ends, edge) in ends.iter_mut().zip(four) {
                *ends = edge.map(|corner| &self.at[usize::from(corner)]);
            }
            self.units.extend_from_slice(&fours::units::<W>(token, ends));
        }
        self.sums.clear();
        self.sums.resize(self.edges.len(), [0; 4]);
        let live = self.tet_edges.iter().zip(&self.gradients).filter(|(edges, _)| !is_void(edges));
        for (edges, gradient) in live {
            for &edge in edges {
                let edge = usize::from(edge & !TURNED);
                add_term(&mut self.sums[edge], gradient.map(|x| x * self.units[edge]));
            }
        }
    }
}

/// Sets where the slots of each group's edges end; the slots of all edges take so many words.
pub(super) fn close_groups(groups: &mut [Group], slots_of_edges: &[u16], words: usize) {
    for group in groups {
        let next = slots_of_edges.get(usize::from(group.edges_end));
        // The word that says what a slot is belongs to it.
        group.slots_end = next.map_or(words as u16, |slot| (slot & !OPEN) - (slot >> 15));
    }
}
