//! Cells into tetrahedra, so that neighbours agree on the faces that they share.
//!
//! A four-sided face can be cut along either diagonal, and both cells must choose the same one.
//! They do when the choice depends on the face's vertices alone: here the cut starts at
//! the **smallest vertex number** of the face. A convex cell is then filled by the *star* of its
//! smallest vertex v: every face that does not have v is cut into triangles, each of which makes a
//! tetrahedron with v. The faces that have v are covered as a by-product, by triangles that start
//! at v, which is their smallest vertex too (Dompierre, Labbé, Vallet, Camarero, "How to subdivide
//! pyramids, prisms and hexahedra into tetrahedra", 1999, have the rule). A hexahedron gives 6
//! tetrahedra, a wedge 3, a pyramid 2.
//!
//! Quadratic cells: see [`super::quadratic`]. Polyhedra, which need vertices of their own: see
//! [`super::polyhedron`].
//!
//! The rule knows numbers, not positions. So pieces of a mesh that store a shared point twice,
//! under two numbers, can cut a shared four-sided face differently; the field then has a kink
//! there, no gap.

use super::kind::CellKind;
use super::quadratic;
use super::star::{CellTet, drop_collapsed, star};

/// The most tetrahedra that a cell is split into.
pub const MOST_TETS: usize = 48;

/// Appends the tetrahedra of a cell, positively oriented where the cell is, to `out`. Gives the
/// number of those that were left out because the cell names a vertex more than once (a hexahedron
/// that was collapsed to a wedge, say). A cell without a volume gives none.
///
/// # Panics
/// When the number of vertices is not that of the kind, or the kind is a polyhedron, or one that is
/// given vertices first ([`CellKind::middles`]).
pub fn split(kind: CellKind, vertices: &[u64], out: &mut Vec<CellTet>) -> usize {
    assert_ne!(kind, CellKind::Polyhedron, "a polyhedron is split with vertices of its own");
    assert_eq!(vertices.len(), kind.vertices(), "readers count vertices");
    assert!(kind.middles().is_none(), "its faces have vertices in their middle");
    let start = out.len();
    match kind {
        CellKind::Flat => {}
        CellKind::Tetrahedron => out.push(std::array::from_fn(|i| vertices[i])),
        CellKind::Voxel => {
            // x fastest to around.
            let v = vertices;
            star(kind.shape().faces.iter().copied(), &[v[0], v[1], v[3], v[2], v[4], v[5], v[7], v[6]], out);
        }
        CellKind::Hexahedron | CellKind::Wedge | CellKind::Pyramid => {
            star(kind.shape().faces.iter().copied(), vertices, out);
        }
        _ => quadratic::split(kind, vertices, out),
    }
    drop_collapsed(start, out)
}

#[cfg(test)]
mod tests;
