//! The surface in a precomputed block, added to that of its chunk.
//!
//! ```text
//!  crossed edges, active tetrahedra ─▶ vertices of edges, numbered ─▶ new vertices ─▶ triangles
//! ```
//!
//! Each step is taken for the whole block before the next one, without branches that depend on a
//! single edge or tetrahedron, but for the edges that other blocks may have too: those are looked
//! for in the chunk.

use super::chunk_surface::{ChunkSurface, OpenVertex, SharedEdge};
use super::edges::EdgeLookup;
use super::fours;
use super::ordered::SHARED;
use super::patch::up;
use super::precomputed::{ByteTables, Crossed, FIRST, NEW, Normal, OPEN, Precomputed, SUM, sum_of};
use super::workbench::Workbench;
use crate::simd::{Avx2, F64x4s, Plain, on_avx2_or_plain};
use crate::surface::model::Vertex;
use crate::surface::world_map::WorldMap;

impl ChunkSurface {
    /// Adds the active tetrahedra of a precomputed block, whose numbers in the chunk are below that
    /// of its corners. `world` is that of the block. False if a triangle has no vertex: then the
    /// edges of a tetrahedron are not those between its corners, and the surface is of no use.
    #[must_use]
    pub(crate) fn add_precomputed(
        &mut self,
        block: Precomputed<'_>,
        world: &WorldMap,
        bench: &mut Workbench,
    ) -> bool {
        self.add_known_on(block, world, &mut bench.crossed, (Avx2::found(), ByteTables::found()))
    }

    /// With vectors of AVX2, with tables, or without: the same bits.
    pub(super) fn add_known_on(
        &mut self,
        block: Precomputed<'_>,
        world: &WorldMap,
        crossed: &mut Crossed,
        (avx2, tables): (Option<Avx2>, Option<ByteTables>),
    ) -> bool {
        match tables.filter(|_| !block.has_void()) {
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
        block: Precomputed<'_>,
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
    fn join_open(&mut self, block: Precomputed<'_>, crossed: &mut Crossed) -> bool {
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
                EdgeLookup::Known(number) => {
                    let known = &mut self.open[number as usize];
                    vertices[usize::from(n)] = known.vertex;
                    for (sum, part) in known.gradient.iter_mut().zip(gradient) {
                        *sum = sum.wrapping_add(part);
                    }
                }
                EdgeLookup::New(_) => {
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
    fn note_first(&mut self, block: Precomputed<'_>, crossed: &Crossed, before: usize) -> bool {
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
    fn append_new<W: F64x4s>(
        &mut self,
        token: W::Token,
        block: Precomputed<'_>,
        world: &WorldMap,
        new: &[u16],
    ) {
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
