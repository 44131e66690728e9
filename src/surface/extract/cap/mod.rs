//! Closing a surface where the domain ends.
//!
//! # How does it work?
//!
//! The inside of a surface also ends at the domain's faces. There the tetrahedra have boundary
//! triangles: three corners on one face of the box, exactly, as positions are integers. The inside
//! part of each of them is added, clipped at the crossings that the surface has on the same edges.
//! So caps and surface share vertices, and every rim edge of the surface gets its second triangle:
//!
//! ```text
//!      inside c                 1 corner inside:  (c, ca, bc)
//!            /\                 2 inside:         a quadrilateral, cut at its smallest key
//!       ca  x--x  bc            3 inside:         the triangle itself
//!          /    \
//!  outside a----b  outside      a corner's key is the pair of its id with itself, a crossing's that of its edge
//! ```
//!
//! Surface and caps together are the boundary of the inside of the tetrahedra: closed, oriented
//! outwards. A void tetrahedron has no inside: around missing samples the surface stays open, and
//! its boundary triangles get no cap.
//!
//! The normal of a cap's corner is that of the face; on an edge of the box it is the mean of two. A
//! vertex of the rim gets the same normal, though the surface has it too: a cap is flat, and
//! decimation leaves few of its corners besides those of the rim.

use super::cells::{CellSource, in_order};
use super::chunk_surface::ChunkSurface;
use crate::surface::world_map::WorldMap;
use isospan_io::geom::{LatticePos, PointId};
use isospan_mesh::mesh::tet::Tet;

/// The faces of a positively oriented tetrahedron, counter-clockwise seen from outside.
const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
/// The amount that a cap's triangle adds to the gradient at its corners: far more than tetrahedra
/// do at a crossing (about 2^30), far from overflow.
const PULL: i64 = 1 << 45;

/// The side of the box `0 ..= top` that three points lie on: its axis, and whether it is the upper
/// one.
fn side_of(corners: [LatticePos; 3], top: LatticePos) -> Option<(usize, bool)> {
    (0..3).find_map(|axis| {
        let at = |x: u32| corners.iter().all(|c| c[axis] == x);
        if at(0) { Some((axis, false)) } else { at(top[axis]).then_some((axis, true)) }
    })
}

/// Whether some face of a tetrahedron lies on the boundary of the box: three corners on one side.
fn has_boundary_face(corners: [LatticePos; 4], top: LatticePos) -> bool {
    FACES.iter().any(|face| side_of(face.map(|i| corners[i]), top).is_some())
}

impl ChunkSurface {
    /// Adds the caps of tetrahedra of a block: the inside parts of their faces on the boundary of
    /// the box from 0 to `top`. Active or not, each tetrahedron of the mesh at the boundary is to
    /// be given once; void ones are passed over.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub fn add_caps(&mut self, cells: &CellSource<'_>, world: &WorldMap, top: LatticePos) {
        for tet in cells.tets {
            // However its corners are listed, the same triangles in the same order.
            let tet = in_order(cells.ids, tet);
            let values = tet.map(|v| cells.values[v as usize]);
            if values.iter().any(|v| v.is_nan()) {
                continue;
            }
            for face in FACES {
                let corners = face.map(|i| tet[i]);
                if let Some((axis, upper)) = side_of(corners.map(|v| cells.positions[v as usize]), top) {
                    self.add_cap(cells, world, corners, axis, upper);
                }
            }
        }
    }

    /// Adds the inside part of a boundary triangle.
    fn add_cap(
        &mut self,
        cells: &CellSource<'_>,
        world: &WorldMap,
        corners: [u32; 3],
        axis: usize,
        upper: bool,
    ) {
        let inside = corners.map(|v| cells.values[v as usize] >= self.isovalue());
        let (mut polygon, mut keys, mut count) = ([0usize; 4], [(PointId(0), PointId(0)); 4], 0);
        for i in 0..3 {
            let j = (i + 1) % 3;
            let (a, b) = (corners[i], corners[j]);
            if inside[i] {
                polygon[count] = self.open_vertex(cells, world, [a, a]);
                keys[count] = (cells.ids[a as usize], cells.ids[a as usize]);
                count += 1;
            }
            if inside[i] != inside[j] {
                let (low, high) = if cells.ids[a as usize] < cells.ids[b as usize] { (a, b) } else { (b, a) };
                polygon[count] = self.open_vertex(cells, world, [low, high]);
                keys[count] = (cells.ids[low as usize], cells.ids[high as usize]);
                count += 1;
            }
        }
        let Some(first) = (0..count).min_by_key(|&i| keys[i]) else { return };
        for &vertex in &polygon[..count] {
            // The gradient is what the normal points away from.
            self.pull(vertex, axis, if upper { -PULL } else { PULL });
        }
        let corner = |i: usize| polygon[(first + i) % count];
        for i in 1..count - 1 {
            self.push_triangle([corner(0), corner(i), corner(i + 1)]);
        }
    }
}

/// The tetrahedra with a face on the boundary of the box and a corner inside.
///
/// # Panics
/// When a tetrahedron names a corner that is not there.
pub fn select_boundary(cells: &CellSource<'_>, top: LatticePos, isovalue: f32, out: &mut Vec<Tet>) {
    let wanted = |t: &&Tet| {
        t.iter().any(|&v| cells.values[v as usize] >= isovalue)
            && has_boundary_face(t.map(|v| cells.positions[v as usize]), top)
    };
    out.extend(cells.tets.iter().filter(wanted));
}

#[cfg(test)]
mod tests;
