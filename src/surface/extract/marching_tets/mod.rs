//! Marching tetrahedra on the tetrahedra of one chunk.
//!
//! # How does it work?
//!
//! A corner whose value is `>= isovalue` is *inside*. A tetrahedron with corners on both sides is
//! active, and the surface cuts it in one triangle (one corner against three) or one quadrilateral
//! (two against two). The corners are first sorted by [their ids](isospan_io::geom::PointId), so a
//! tetrahedron gives the same triangles however its corners were listed:
//!
//! ```text
//!          3                         3             corners sorted by id; edges numbered in the
//!         /|\                       /|\            order of their keys (i, j):
//!        / | \                     x-|-x             0: 01   1: 02   2: 03
//!       /  |  \   0 inside:       / \|/ \            3: 12   4: 13   5: 23
//!      x   |   \  one triangle   /   X   \
//!     / \  |    \ (01, 02, 03)  0---/-\---2        0, 1 inside: the quadrilateral (02, 03, 13, 12),
//!    0---x-|-----2               \ x   x /         always cut at its smallest edge key, here 02:
//!     \  x |    /                 \ | | /          (02, 03, 13) and (02, 13, 12)
//!      \ | |   /                   \|/ /
//!          1                         1
//! ```
//!
//! The table of the 16 cases is derived at compile time (`cases.rs`). A tetrahedron with a NaN
//! corner is *void* and gives nothing: no surface is invented across a hole in the data.
//!
//! # Where is a vertex?
//!
//! On the edge (a, b), a the lower id, at `a + t (b - a)`, `t = (isovalue - f_a) / (f_b - f_a)`,
//! computed in `f64` from exact lattice positions in this one order: every tetrahedron and every
//! chunk around the edge computes the same bits.
//!
//! `t` is clamped to [1/1024, 1 - 1/1024]; farther from the ends where positions are so many
//! spacings that `f32` would not resolve that ([`WorldMap::resolving`]). Without that, a corner
//! value equal to the isovalue would put the vertices of all its edges on one point, and zero-area
//! triangles between them. The clamp moves a vertex by at most 1/1024 of its edge, or that more,
//! and cannot open or fold the surface: which edges
//! carry a vertex, and which vertices a triangle joins, depend on inside and outside alone, never
//! on `t`; the clamped surface is that of another field with the same corners inside. Nor can a
//! triangle be degenerate: its three vertices lie strictly inside three edges of a tetrahedron that
//! do not form one of its faces, so their barycentric coordinates are linearly independent.
//! (Rounding to `f32` at the very end may still flatten a triangle that is smaller than the spacing
//! of `f32` numbers at its place.)
//!
//! So the surface of a mesh of a box is a manifold, open only where the box ends. With voids, it
//! also ends at them, and a vertex on an edge where two otherwise separate groups of non-void
//! tetrahedra touch belongs to two sheets.
//!
//! # Which way is its normal?
//!
//! Minus the mean gradient around the edge: the sum over the tetrahedra around it of volume × ∇f of
//! the linear interpolant. With e_i = p_i - p_0 and d_i = f_i - f_0,
//!
//! ```text
//! 6 V ∇f = d_1 (e_2 × e_3) + d_2 (e_3 × e_1) + d_3 (e_1 × e_2)
//! ```
//!
//! All tetrahedra around a crossed edge are active, so all are seen, though maybe by several
//! chunks. To make the sum independent of who adds what first, each term is rounded to integers,
//! and integers are summed. The unit is a power of two made from the edge itself (|f_b - f_a|
//! |p_b - p_a|² is about 2^28 units), so neither the range of the field nor the density of the
//! points matters. A term longer than 2^50 units is shortened, its direction kept. Because the
//! component of every term along the edge is 6 V (f_b - f_a), the terms cannot cancel; only
//! infinite values leave no direction, and then the edge's own is used: the shortest gradient that
//! explains its two values.
//!
//! # Cost
//!
//! The tetrahedra of a block are worked on together (`patch.rs`): their edges are found in a table
//! of their ends, small enough for the nearest cache (`numbering.rs`), or, in a block that is kept,
//! or whose values change, have been numbered before (`numbered/`). Only those around which the
//! block has not all tetrahedra, a third of the edges but most of the look-ups, are then found in
//! their chunk, in a cache line of the edges of their lower corner (`edges.rs`). 4 bytes a corner,
//! 24 a vertex, about 70 more for each of those edges, and 12 a triangle while a chunk is
//! extracted. Buffers are kept for the next chunk.
//!
//! # References
//! Doi, Koide 1991, "An efficient method of triangulating equi-valued surfaces by using tetrahedral
//! cells". The clamp is the symbolic perturbation of a value off the isovalue, made visible enough
//! to leave every triangle an area.

use super::cells::{CellSource, Sorted, along_edge};
use super::chunk_surface::{ChunkSurface, JoinedBlock, SharedEdge, find_or_open};
use super::fours::{self, Corner};
use super::numbered::NumberedBlock;
use super::patch::{Corners, Patch};
use super::workbench::Workbench;
use crate::surface::world_map::WorldMap;
use isospan_mesh::simd::{Avx2, F64x4s, Plain, on_avx2_or_plain};

/// Extracts a chunk whose tetrahedra are all at hand. For several blocks use the three methods that
/// this calls.
///
/// # Panics
/// When a tetrahedron names a corner that is not there.
pub fn extract(
    cells: &CellSource<'_>,
    isovalue: f32,
    world: &WorldMap,
    bench: &mut Workbench,
    out: &mut ChunkSurface,
) {
    out.start(isovalue, cells.ids.len());
    out.add(cells, world, bench);
    out.finish(world);
}

impl ChunkSurface {
    /// Adds the active tetrahedra of a block.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub fn add(&mut self, cells: &CellSource<'_>, world: &WorldMap, bench: &mut Workbench) {
        let mut active = std::mem::take(&mut bench.active);
        active.clear();
        bench.sides.select(cells.tets, cells.values, self.isovalue, &mut active);
        self.add_active(&CellSource { tets: &active, ..*cells }, world, bench);
        bench.active = active;
    }

    /// Adds tetrahedra that are known to be active: those that [`Sides::select`] finds.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(crate) fn add_active(&mut self, cells: &CellSource<'_>, world: &WorldMap, bench: &mut Workbench) {
        self.add_active_on(cells, world, bench, Avx2::found());
    }

    /// With vectors of AVX2, or without: the same bits.
    fn add_active_on(
        &mut self,
        cells: &CellSource<'_>,
        world: &WorldMap,
        bench: &mut Workbench,
        avx2: Option<Avx2>,
    ) {
        on_avx2_or_plain!(avx2, F64x4, Plain<f64, 4>, |W, token| self.add_cells::<W>(token, cells, world, bench));
    }

    #[inline(always)]
    fn add_cells<W: F64x4s>(
        &mut self,
        token: W::Token,
        cells: &CellSource<'_>,
        world: &WorldMap,
        Workbench { numbering, patch, .. }: &mut Workbench,
    ) {
        self.active_cells += cells.tets.len() as u64;
        let mut left = cells.tets;
        while !left.is_empty() {
            let cells = CellSource { tets: left, ..*cells };
            let taken = numbering.list(&cells, self.isovalue, |tet| Sorted::new(cells.ids, tet), patch);
            left = &left[taken..];
            self.add_patch::<W>(token, patch, &numbering.corners(&cells), world);
        }
    }

    /// Adds the active tetrahedra of a numbered block, whose numbers in the chunk are below that of
    /// its corners.
    pub(crate) fn add_numbered(&mut self, block: &NumberedBlock, world: &WorldMap, bench: &mut Workbench) {
        self.add_numbered_on(block, world, bench, Avx2::found());
    }

    /// With vectors of AVX2, or without: the same bits.
    pub(super) fn add_numbered_on(
        &mut self,
        block: &NumberedBlock,
        world: &WorldMap,
        bench: &mut Workbench,
        avx2: Option<Avx2>,
    ) {
        on_avx2_or_plain!(avx2, F64x4, Plain<f64, 4>, |W, token| self.add_block::<W>(token, block, world, bench));
    }

    #[inline(always)]
    fn add_block<W: F64x4s>(
        &mut self,
        token: W::Token,
        block: &NumberedBlock,
        world: &WorldMap,
        Workbench { block: buffers, patch, .. }: &mut Workbench,
    ) {
        let active = block.list(self.isovalue, buffers, patch);
        self.active_cells += active as u64;
        if active > 0 {
            self.add_patch::<W>(token, patch, block, world);
        }
    }

    #[inline(always)]
    fn add_patch<W: F64x4s>(
        &mut self,
        token: W::Token,
        patch: &mut Patch,
        corners: &impl Corners,
        world: &WorldMap,
    ) {
        for (edge, &ends) in patch.edges().iter().enumerate() {
            if !patch.is_alone(edge) {
                self.edges.will_be_looked_for(ends.map(|corner| corners.number(corner)));
            }
        }
        patch.sum_gradients::<W>(token, corners.at());
        self.join_edges(patch, corners);
        self.append_vertices::<W>(token, patch, corners.at(), world);
        let vertex = |edge: u16| self.joined.vertices[usize::from(edge)];
        self.triangles.extend(patch.triangles().iter().map(|t| t.map(vertex)));
    }

    /// Finds the vertex of each edge of the patch, or numbers it. What the patch has alone is not
    /// looked for.
    #[inline(always)]
    fn join_edges(&mut self, patch: &Patch, corners: &impl Corners) {
        let JoinedBlock { vertices, new, alone, first } = &mut self.joined;
        vertices.clear();
        for list in [&mut *new, &mut *alone, &mut *first] {
            list.clear();
        }
        for (edge, &ends) in patch.edges().iter().enumerate() {
            let next = (self.vertices.len() + new.len()) as u32;
            if patch.is_alone(edge) {
                alone.push(edge as u16);
                new.push(edge as u16);
                vertices.push(next);
                continue;
            }
            let numbers = ends.map(|corner| corners.number(corner));
            let (number, is_new) = find_or_open(&mut self.edges, &mut self.open, numbers, next);
            let open = &mut self.open[number];
            vertices.push(open.vertex);
            for (sum, part) in open.gradient.iter_mut().zip(patch.gradient(edge)) {
                *sum = sum.wrapping_add(part);
            }
            if is_new {
                first.push(edge as u16);
                new.push(edge as u16);
                let key = corners.shared(ends);
                self.shared.extend(key.map(|key| SharedEdge { key, vertex: next, gradient: [0; 3] }));
            }
        }
    }

    /// Adds the new vertices, with normals where their gradients are known; until then a normal is
    /// what [`along_edge`] takes.
    #[inline(always)]
    fn append_vertices<W: F64x4s>(
        &mut self,
        token: W::Token,
        patch: &Patch,
        at: &[Corner],
        world: &WorldMap,
    ) {
        let JoinedBlock { vertices, new, alone, first } = &self.joined;
        patch.append_vertices::<W>(token, at, new, self.isovalue, world, &mut self.vertices);
        let vertex = |edge: u16| vertices[usize::from(edge)] as usize;
        for &edge in first {
            self.vertices[vertex(edge)].normal = patch.up(at, edge.into());
        }
        for four in alone.chunks(4) {
            let mut sums = [[0; 3]; 4];
            for (sum, &edge) in sums.iter_mut().zip(four) {
                *sum = patch.gradient(edge.into());
            }
            let normals = fours::normals::<W>(token, &sums, world);
            for (&edge, normal) in four.iter().zip(normals) {
                let normal = normal.unwrap_or_else(|| along_edge(patch.up(at, edge.into()), world));
                self.vertices[vertex(edge)].normal = normal;
            }
        }
    }
}

#[cfg(test)]
mod tests;
