//! The surface in a known block, added to that of its chunk.
//!
//! ```text
//!  crossed edges, active tetrahedra ─▶ vertices of edges, numbered ─▶ new vertices ─▶ triangles
//! ```
//!
//! Each step is taken for the whole block before the next one, without branches that depend on a single edge or tetrahedron, but for the
//! edges that other blocks may have too: those are looked for in the chunk.

use super::super::cases::CASES;
use super::super::edges::Found;
use super::super::fours;
use super::super::marching_tets::{ChunkSurface, OpenVertex, SharedEdge, Workbench, on_lanes};
use super::super::patch::up;
use super::super::{Vertex, WorldMap};
use super::sides::SPARE;
use super::{ByteTables, EDGES_MOST, GROUP, KnownBlock, OPEN, SHARED, TURNED};
#[cfg(target_arch = "x86_64")]
use crate::exec::lanes::Vector;
use crate::exec::lanes::{Four, Plain};
use crate::exec::{Avx2, with_vectors};
use crate::mesh::tet::is_active;

/// No vertex yet.
const NEW: u32 = u32::MAX;

/// What an isovalue crosses: buffers.
#[derive(Debug, Default)]
pub(in super::super) struct Crossed {
    edges: Vec<u16>,
    /// Those of the edges that other blocks may have too.
    open: Vec<u16>,
    /// Active tetrahedra, and the corners inside of each.
    tets: Vec<[u16; 2]>,
    /// How many there are of each of these.
    counts: [usize; 3],
    /// The vertex of each crossed edge.
    vertices: Vec<u32>,
    /// The edges whose vertices are new; those of them that others may look for.
    new: Vec<u16>,
    first: Vec<u16>,
    triangles: Vec<[u32; 3]>,
}

impl Crossed {
    pub(in super::super) fn bytes(&self) -> usize {
        2 * (self.edges.capacity() + self.open.capacity() + self.new.capacity() + self.first.capacity())
            + 4 * (self.tets.capacity() + self.vertices.capacity())
            + 12 * self.triangles.capacity()
    }

    /// Room for all of a block.
    fn make_room(&mut self, block: &KnownBlock) {
        let grow = |list: &mut Vec<u16>, most: usize| list.resize(most.max(list.len()), 0);
        grow(&mut self.edges, block.edges + SPARE);
        grow(&mut self.open, block.edges + SPARE);
        grow(&mut self.new, block.edges + SPARE);
        self.tets.resize((block.tets + SPARE).max(self.tets.len()), [0; 2]);
        self.triangles.resize((2 * block.tets + 2).max(self.triangles.len()), [0; 3]);
        self.vertices.resize(EDGES_MOST, NEW);
    }

    #[inline(always)]
    fn tets(&self) -> &[[u16; 2]] {
        &self.tets[..self.counts[2]]
    }

    /// Looks what is crossed, 64 corners at a time, in a block without void tetrahedra.
    #[inline(always)]
    fn find_at_once(&mut self, block: &KnownBlock, isovalue: f32, tables: ByteTables) {
        self.make_room(block);
        let table = block.sides(isovalue);
        // Neither end of an edge is a NaN.
        let lists = [&mut self.edges[..], &mut self.open];
        let [crossed, open] = tables.edges(&table, block.edges(), block.slots_of_edges(), lists);
        self.counts = [crossed, open, tables.tets(&table, block.tets(), &mut self.tets)];
    }

    /// Looks what is crossed.
    #[inline(always)]
    fn find(&mut self, block: &KnownBlock, isovalue: f32) {
        self.make_room(block);
        let sides = block.sides(isovalue);
        let (edges, slots, tets) = (block.edges(), block.slots_of_edges(), block.tets());
        let Self { edges: list, open: open_list, tets: active_list, .. } = self;
        let (list, open_list, active_list) = (&mut list[..], &mut open_list[..], &mut active_list[..]);
        let ([mut crossed, mut open, mut active], mut first) = ([0; 3], 0);
        for (group, n) in block.groups().iter().zip((0..tets.len()).step_by(GROUP)) {
            let (begin, end) = (first, usize::from(group.edges_end));
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

    /// Numbers the vertices that no other block has made, from the next one on, in the order of their edges; tells how many.
    #[inline(always)]
    fn number_new(&mut self, next: u32) -> usize {
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
    fn list_triangles(&mut self, block: &KnownBlock) -> &[[u32; 3]] {
        let (tets, mut end) = (block.edges_of_tets(), 0);
        let vertices: &[u32; EDGES_MOST] =
            self.vertices.as_slice().try_into().expect("it was made so long before");
        for &[n, inside] in &self.tets[..self.counts[2]] {
            let edges = tets[usize::from(n)];
            let case = &CASES[usize::from(inside | (edges[0] & TURNED) >> 11) % CASES.len()];
            let at = |place: u8| vertices[usize::from(edges[usize::from(place) % 6]) % EDGES_MOST];
            // The second one is written where there is none too, and ignored.
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

impl ChunkSurface {
    /// Adds the active tetrahedra of a known block, whose numbers in the chunk are below that of its corners. `world` is that of the block.
    pub(crate) fn add_known(&mut self, block: &KnownBlock, world: &WorldMap, bench: &mut Workbench) {
        self.add_known_on(block, world, &mut bench.crossed, (Avx2::found(), ByteTables::found()));
    }

    /// With vectors of AVX2, with tables, or without: the same bits.
    pub(super) fn add_known_on(
        &mut self,
        block: &KnownBlock,
        world: &WorldMap,
        crossed: &mut Crossed,
        (avx2, tables): (Option<Avx2>, Option<ByteTables>),
    ) {
        match tables.filter(|_| !block.has_void) {
            Some(tables) => crossed.find_at_once(block, self.isovalue, tables),
            None => crossed.find(block, self.isovalue),
        }
        if !crossed.tets().is_empty() {
            on_lanes!(avx2, self.add_found(block, world, crossed));
        }
    }

    /// Adds what was found to be crossed.
    #[inline(always)]
    fn add_found<W: Four>(
        &mut self,
        proof: W::Proof,
        block: &KnownBlock,
        world: &WorldMap,
        crossed: &mut Crossed,
    ) {
        self.active_cells += crossed.tets().len() as u64;
        let before = self.open.len();
        self.join_open(block, crossed);
        let count = crossed.number_new(self.vertices.len() as u32);
        self.append_new::<W>(proof, block, world, &crossed.new[..count]);
        self.note_first(block, crossed, before);
        self.triangles.extend_from_slice(crossed.list_triangles(block));
    }

    /// Looks for the edges that other blocks may have too, and adds this block's part of their sums.
    #[inline(always)]
    fn join_open(&mut self, block: &KnownBlock, crossed: &mut Crossed) {
        let (edges, of_edges, slots) = (block.edges(), block.slots_of_edges(), block.slots());
        let Crossed { edges: list, open, counts, vertices, first, .. } = crossed;
        for &n in &list[..counts[0]] {
            vertices[usize::from(n)] = NEW;
        }
        let of_corners = block.numbers();
        let numbers = |n: u16| edges[usize::from(n)].map(|corner| of_corners[usize::from(corner)] & !SHARED);
        let open = &open[..counts[1]];
        for &n in open {
            self.edges.will_be_looked_for(numbers(n));
        }
        first.clear();
        for &n in open {
            let slot = usize::from(of_edges[usize::from(n)] & !OPEN);
            let gradient: [i64; 3] = sum_of(slots[slot], slots[slot + 1]);
            match self.edges.find_or_add(numbers(n)) {
                Found::Known(number) => {
                    let known = &mut self.open[number as usize];
                    vertices[usize::from(n)] = known.vertex;
                    for (sum, part) in known.gradient.iter_mut().zip(gradient) {
                        *sum = sum.wrapping_add(part);
                    }
                }
                Found::New(_) => {
                    self.open.push(OpenVertex { gradient, vertex: NEW });
                    first.push(n);
                }
            }
        }
    }

    /// Notes what others may ask of new vertices: `before` is the number of open ones before.
    #[inline(always)]
    fn note_first(&mut self, block: &KnownBlock, crossed: &Crossed, before: usize) {
        let at = block.at();
        for (&n, open) in crossed.first.iter().zip(&mut self.open[before..]) {
            let (vertex, ends) = (crossed.vertices[usize::from(n)], block.edges()[usize::from(n)]);
            open.vertex = vertex;
            self.vertices[vertex as usize].normal = up(ends.map(|corner| &at[usize::from(corner)]));
            let key = block.shared(ends);
            self.shared.extend(key.map(|key| SharedEdge { key, vertex, gradient: [0; 3] }));
        }
    }

    /// Appends vertices; the normals of open ones mean nothing yet.
    #[inline(always)]
    fn append_new<W: Four>(&mut self, proof: W::Proof, block: &KnownBlock, world: &WorldMap, new: &[u16]) {
        let (edges, of_edges) = (block.edges(), block.slots_of_edges());
        let (slots, at) = (block.slots(), block.at());
        for four in new.chunks(4) {
            let mut ends = [[&at[0]; 2]; 4];
            let mut vertices = [Vertex::default(); 4];
            for ((&n, ends), vertex) in four.iter().zip(&mut ends).zip(&mut vertices) {
                *ends = edges[usize::from(n)].map(|corner| &at[usize::from(corner)]);
                vertex.normal = slots[usize::from(of_edges[usize::from(n)] & !OPEN)].map(f32::from_bits);
            }
            let positions = fours::crossings::<W>(proof, ends, self.isovalue, world);
            for (vertex, position) in vertices.iter_mut().zip(positions) {
                vertex.position = position;
            }
            match four.len() {
                4 => self.vertices.extend_from_slice(&vertices),
                n => self.vertices.extend_from_slice(&vertices[..n]),
            }
        }
    }
}

/// A sum, of its two slots.
#[inline(always)]
fn sum_of(low: super::Slot, high: super::Slot) -> [i64; 3] {
    let [a, b, c, d, e, f] = bytemuck::cast::<[super::Slot; 2], [u32; 6]>([low, high]);
    [[a, b], [c, d], [e, f]].map(|[low, high]| (u64::from(low) | u64::from(high) << 32) as i64)
}
