//! The surface in a known block, added to that of its chunk.
//!
//! ```text
//!  crossed edges, active tetrahedra ─▶ vertices of edges, numbered ─▶ new vertices ─▶ triangles
//! ```
//!
//! Each step is taken for the whole block before the next one, without branches that depend on a
//! single edge or tetrahedron, but for the edges that other blocks may have too: those are looked
//! for in the chunk.

use super::super::cases::CASES;
use super::super::edges::Found;
use super::super::fours;
use super::super::marching_tets::{ChunkSurface, OpenVertex, SharedEdge, Workbench};
use super::super::patch::up;
use super::super::{Vertex, WorldMap};
use super::sides::SPARE;
use super::{ByteTables, EDGES_MOST, FIRST, GROUP, Known, Normal, OPEN, SHARED, SUM, TURNED};
use crate::mesh::tet::is_active;
use crate::simd::{Avx2, F64x4s, Plain, on_avx2_or_plain};

/// No vertex yet.
const NEW: u32 = u32::MAX;

/// Buffers for what an isovalue crosses.
#[derive(Debug, Default)]
pub(in super::super) struct Crossed {
    edges: Vec<u16>,
    /// The crossed edges that other blocks may have too.
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
    /// The edges with a number in the chunk whose vertices are new.
    numbered: Vec<(u16, u32)>,
    triangles: Vec<[u32; 3]>,
}

impl Crossed {
    pub(in super::super) fn bytes(&self) -> usize {
        2 * (self.edges.capacity() + self.open.capacity() + self.new.capacity() + self.first.capacity())
            + 4 * (self.tets.capacity() + self.vertices.capacity())
            + 12 * self.triangles.capacity()
            + 8 * self.numbered.capacity()
    }

    /// Room for all of a block.
    fn make_room(&mut self, block: Known<'_>) {
        let grow = |list: &mut Vec<u16>, most: usize| list.resize(most.max(list.len()), 0);
        grow(&mut self.edges, block.shape.edges + SPARE);
        grow(&mut self.open, block.shape.edges + SPARE);
        grow(&mut self.new, block.shape.edges + SPARE);
        self.tets.resize((block.shape.tets + SPARE).max(self.tets.len()), [0; 2]);
        self.triangles.resize((2 * block.shape.tets + 2).max(self.triangles.len()), [0; 3]);
        self.vertices.resize(EDGES_MOST, NEW);
    }

    #[inline(always)]
    fn tets(&self) -> &[[u16; 2]] {
        &self.tets[..self.counts[2]]
    }

    /// Looks what is crossed, 64 corners at a time, in a block without void tetrahedra.
    #[inline(always)]
    fn find_at_once(&mut self, block: Known<'_>, isovalue: f32, tables: ByteTables) {
        self.make_room(block);
        let table = block.sides(isovalue);
        // Neither end of an edge is a NaN.
        let lists = [&mut self.edges[..], &mut self.open];
        let [crossed, open] = tables.edges(&table, block.edges(), block.slots_of_edges(), lists);
        self.counts = [crossed, open, tables.tets(&table, block.tets(), &mut self.tets)];
    }

    /// Finds what is crossed.
    #[inline(always)]
    fn find(&mut self, block: Known<'_>, isovalue: f32) {
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
    fn list_triangles(&mut self, block: Known<'_>) -> &[[u32; 3]] {
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

impl ChunkSurface {
    /// Adds the active tetrahedra of a known block, whose numbers in the chunk are below that of
    /// its corners. `world` is that of the block. False if a triangle has no vertex: then the edges
    /// of a tetrahedron are not those between its corners, and the surface is of no use.
    #[must_use]
    pub(crate) fn add_known(&mut self, block: Known<'_>, world: &WorldMap, bench: &mut Workbench) -> bool {
        self.add_known_on(block, world, &mut bench.crossed, (Avx2::found(), ByteTables::found()))
    }

    /// With vectors of AVX2, with tables, or without: the same bits.
    pub(super) fn add_known_on(
        &mut self,
        block: Known<'_>,
        world: &WorldMap,
        crossed: &mut Crossed,
        (avx2, tables): (Option<Avx2>, Option<ByteTables>),
    ) -> bool {
        match tables.filter(|_| !block.shape.has_void) {
            Some(tables) => crossed.find_at_once(block, self.isovalue, tables),
            None => crossed.find(block, self.isovalue),
        }
        crossed.tets().is_empty()
            || on_avx2_or_plain!(avx2, F64x4, Plain<f64, 4>, |W, token| self.add_found::<W>(token, block, world, crossed))
    }

    /// Adds what was found to be crossed. False if a triangle has no vertex.
    #[inline(always)]
    fn add_found<W: F64x4s>(
        &mut self,
        token: W::Token,
        block: Known<'_>,
        world: &WorldMap,
        crossed: &mut Crossed,
    ) -> bool {
        self.active_cells += crossed.tets().len() as u64;
        let before = self.open.len();
        let mut is_sound = self.join_open(block, crossed);
        let count = crossed.number_new(self.vertices.len() as u32);
        self.append_new::<W>(token, block, world, &crossed.new[..count]);
        is_sound &= self.note_first(block, crossed, before);
        let triangles = crossed.list_triangles(block);
        self.triangles.extend_from_slice(triangles);
        let most = triangles.as_flattened().iter().fold(0, |most: u32, &vertex| most.max(vertex));
        is_sound && (most as usize) < self.vertices.len()
    }

    /// Looks for the edges that other blocks may have too, and adds this block's part of their
    /// sums. False if a slot is not there.
    #[inline(always)]
    fn join_open(&mut self, block: Known<'_>, crossed: &mut Crossed) -> bool {
        let (edges, of_edges, slots) = (block.edges(), block.slots_of_edges(), block.slots());
        let Crossed { edges: list, open, counts, vertices, first, numbered, .. } = crossed;
        for &n in &list[..counts[0]] {
            vertices[usize::from(n)] = NEW;
        }
        let of_corners = block.numbers();
        let numbers = |n: u16| edges[usize::from(n)].map(|corner| of_corners[usize::from(corner)] & !SHARED);
        let slot_of = |n: u16| usize::from(of_edges[usize::from(n)] & !OPEN);
        first.clear();
        numbered.clear();
        let (mut is_sound, mut sums) = (true, 0);
        let list = &mut open[..counts[1]];
        for at in 0..list.len() {
            let n = list[at];
            let kind = slot_of(n).checked_sub(1).and_then(|at| slots.get(at)).copied();
            let Some(kind) = kind else {
                is_sound = false;
                continue;
            };
            if kind & SUM != 0 {
                self.edges.will_be_looked_for(numbers(n));
                list[sums] = n;
                sums += 1;
            } else if kind & FIRST != 0 {
                numbered.push((n, kind & !FIRST));
            } else {
                match self.of_numbers.get(kind as usize) {
                    Some(&vertex) => vertices[usize::from(n)] = vertex,
                    None => is_sound = false,
                }
            }
        }
        for &n in &list[..sums] {
            let Some(sum) = slots[slot_of(n)..].first_chunk() else {
                is_sound = false;
                continue;
            };
            let gradient = sum_of(sum);
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
        is_sound
    }

    /// Notes what others may ask of new vertices: `before` is the number of open ones before. False
    /// if an edge has no length, or its number is not one of the chunk's.
    #[inline(always)]
    fn note_first(&mut self, block: Known<'_>, crossed: &Crossed, before: usize) -> bool {
        let (at, mut is_sound) = (block.at(), true);
        for (&n, open) in crossed.first.iter().zip(&mut self.open[before..]) {
            let (vertex, ends) = (crossed.vertices[usize::from(n)], block.edges()[usize::from(n)]);
            open.vertex = vertex;
            let up = up(ends.map(|corner| &at[usize::from(corner)]));
            is_sound &= up != [0.0; 3];
            self.vertices[vertex as usize].normal = up;
            let key = block.shared(ends);
            self.shared.extend(key.map(|key| SharedEdge { key, vertex, gradient: [0; 3] }));
        }
        for &(n, number) in &crossed.numbered {
            match self.of_numbers.get_mut(number as usize) {
                Some(vertex) => *vertex = crossed.vertices[usize::from(n)],
                None => is_sound = false,
            }
        }
        is_sound
    }

    /// Appends vertices; the normals of open ones mean nothing yet.
    #[inline(always)]
    fn append_new<W: F64x4s>(&mut self, token: W::Token, block: Known<'_>, world: &WorldMap, new: &[u16]) {
        let (edges, of_edges) = (block.edges(), block.slots_of_edges());
        let (slots, at) = (block.slots(), block.at());
        for four in new.chunks(4) {
            let mut ends = [[&at[0]; 2]; 4];
            let mut vertices = [Vertex::default(); 4];
            for ((&n, ends), vertex) in four.iter().zip(&mut ends).zip(&mut vertices) {
                *ends = edges[usize::from(n)].map(|corner| &at[usize::from(corner)]);
                let slot = usize::from(of_edges[usize::from(n)] & !OPEN);
                let normal: Normal = slots[slot..slot + 3].try_into().expect("three words");
                vertex.normal = normal.map(f32::from_bits);
            }
            let positions = fours::crossings::<W>(token, ends, self.isovalue, world);
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

/// A sum, of its words.
#[inline(always)]
pub(super) fn sum_of(&[a, b, c, d, e, f]: &[u32; 6]) -> [i64; 3] {
    [[a, b], [c, d], [e, f]].map(|[low, high]| (u64::from(low) | u64::from(high) << 32) as i64)
}
