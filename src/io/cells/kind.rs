//! The kinds of cells that are read, and their vertices, edges and faces in VTK's order.
//!
//! ```text
//!      3                 7------6            3                4
//!     /|\               /|     /|           /|\              /|\
//!    / | \             4------5 |          4---5            / | \
//!   0--|--2            | 3----|-2          | 0 |           3--|--2
//!    \ | /             |/     |/           |/ \|          /   | /
//!     \|/              0------1            1---2         0------1
//!      1
//!  tetrahedron        hexahedron           wedge           pyramid
//! ```
//!
//! Quadratic kinds have a vertex on each edge after the corners, then (some) one on each four-sided
//! face, then (one) one in the middle.

use serde::{Deserialize, Serialize};

/// A kind of cell. Their order decides hashes of meshes that archives hold: new ones come before
/// the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CellKind {
    /// 4 vertices.
    Tetrahedron,
    /// 8 vertices of a box, x fastest.
    Voxel,
    /// 8 vertices: the bottom around, then the top around.
    Hexahedron,
    /// 6 vertices: two triangles.
    Wedge,
    /// 5 vertices: a base of four, and the apex.
    Pyramid,
    /// 10 vertices.
    QuadraticTetrahedron,
    /// 20 vertices.
    QuadraticHexahedron,
    /// 15 vertices.
    QuadraticWedge,
    /// 13 vertices.
    QuadraticPyramid,
    /// 27 vertices: with those in the middle of the faces and of the cell.
    TriquadraticHexahedron,
    /// 18 vertices: with those in the middle of the four-sided faces.
    BiquadraticWedge,
    /// 14 vertices: with the one in the middle of the base.
    BiquadraticPyramid,
    /// Any number of faces of any number of vertices: see [`polyhedron`](super::polyhedron).
    Polyhedron,
    /// A vertex, line, triangle or another cell without a volume; its vertices are not kept.
    Flat,
}

/// The corners, edges and faces of a linear kind. Faces are seen anticlockwise from outside.
#[derive(Debug)]
pub(super) struct Shape {
    pub(super) corners: usize,
    /// In the order in which quadratic kinds have their vertices on them.
    pub(super) edges: &'static [[u8; 2]],
    pub(super) faces: &'static [&'static [u8]],
}

pub(super) const TETRAHEDRON: Shape = Shape {
    corners: 4,
    edges: &[[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]],
    faces: &[&[0, 2, 1], &[0, 1, 3], &[1, 2, 3], &[0, 3, 2]],
};

pub(super) const HEXAHEDRON: Shape = Shape {
    corners: 8,
    edges: &[[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]],
    faces: &[&[0, 3, 2, 1], &[4, 5, 6, 7], &[0, 1, 5, 4], &[1, 2, 6, 5], &[2, 3, 7, 6], &[3, 0, 4, 7]],
};

pub(super) const WEDGE: Shape = Shape {
    corners: 6,
    edges: &[[0, 1], [1, 2], [2, 0], [3, 4], [4, 5], [5, 3], [0, 3], [1, 4], [2, 5]],
    faces: &[&[0, 2, 1], &[3, 4, 5], &[0, 1, 4, 3], &[1, 2, 5, 4], &[2, 0, 3, 5]],
};

pub(super) const PYRAMID: Shape = Shape {
    corners: 5,
    edges: &[[0, 1], [1, 2], [2, 3], [3, 0], [0, 4], [1, 4], [2, 4], [3, 4]],
    faces: &[&[0, 3, 2, 1], &[0, 1, 4], &[1, 2, 4], &[2, 3, 4], &[3, 0, 4]],
};

impl CellKind {
    /// All kinds that have a volume and a certain number of vertices.
    pub const SOLID: [Self; 12] = [
        Self::Tetrahedron,
        Self::Voxel,
        Self::Hexahedron,
        Self::Wedge,
        Self::Pyramid,
        Self::QuadraticTetrahedron,
        Self::QuadraticHexahedron,
        Self::QuadraticWedge,
        Self::QuadraticPyramid,
        Self::TriquadraticHexahedron,
        Self::BiquadraticWedge,
        Self::BiquadraticPyramid,
    ];

    /// Whether cells of this kind have a volume.
    pub fn is_solid(self) -> bool {
        self != Self::Flat
    }

    /// Vertices of a cell, as they are kept: none of [`CellKind::Flat`]. Of a polyhedron, whose
    /// number differs from cell to cell, 0.
    pub fn vertices(self) -> usize {
        match self {
            Self::Tetrahedron => 4,
            Self::Voxel | Self::Hexahedron => 8,
            Self::Wedge => 6,
            Self::Pyramid => 5,
            Self::QuadraticTetrahedron => 10,
            Self::QuadraticHexahedron => 20,
            Self::QuadraticWedge => 15,
            Self::QuadraticPyramid => 13,
            Self::TriquadraticHexahedron => 27,
            Self::BiquadraticWedge => 18,
            Self::BiquadraticPyramid => 14,
            Self::Polyhedron | Self::Flat => 0,
        }
    }

    /// The kind's name, in the plural.
    pub fn plural(self) -> &'static str {
        match self {
            Self::Tetrahedron => "tetrahedra",
            Self::Voxel => "voxels",
            Self::Hexahedron => "hexahedra",
            Self::Wedge => "wedges",
            Self::Pyramid => "pyramids",
            Self::QuadraticTetrahedron => "quadratic tetrahedra",
            Self::QuadraticHexahedron => "quadratic hexahedra",
            Self::QuadraticWedge => "quadratic wedges",
            Self::QuadraticPyramid => "quadratic pyramids",
            Self::TriquadraticHexahedron => "triquadratic hexahedra",
            Self::BiquadraticWedge => "biquadratic wedges",
            Self::BiquadraticPyramid => "biquadratic pyramids",
            Self::Polyhedron => "polyhedra",
            Self::Flat => "cells without a volume",
        }
    }

    /// The linear kind with the same corners; of a voxel, that of the hexahedron that it is
    /// renumbered to.
    pub(super) fn shape(self) -> &'static Shape {
        match self {
            Self::Tetrahedron | Self::QuadraticTetrahedron => &TETRAHEDRON,
            Self::Voxel | Self::Hexahedron | Self::QuadraticHexahedron | Self::TriquadraticHexahedron => {
                &HEXAHEDRON
            }
            Self::Wedge | Self::QuadraticWedge | Self::BiquadraticWedge => &WEDGE,
            Self::Pyramid | Self::QuadraticPyramid | Self::BiquadraticPyramid => &PYRAMID,
            Self::Polyhedron | Self::Flat => &Shape { corners: 0, edges: &[], faces: &[] },
        }
    }

    /// The faces of four vertices of a linear cell, as those are numbered around a cell of this
    /// kind. None of quadratic ones, whose faces have more.
    pub fn four_sided(self, vertices: &[u64]) -> impl Iterator<Item = [u64; 4]> + '_ {
        let is_voxel = self == Self::Voxel;
        let shape = self.shape();
        let is_linear = shape.corners == self.vertices();
        let faces = shape.faces.iter().filter(move |face| is_linear && face.len() == 4);
        // x fastest to around.
        let around = |i: usize| if i % 4 > 1 { i ^ 1 } else { i };
        faces.map(move |face| {
            std::array::from_fn(|i| {
                let corner = usize::from(face[i]);
                vertices[if is_voxel { around(corner) } else { corner }]
            })
        })
    }

    /// The kind of a VTK cell type, or the name of one that is not read. Polyhedra (42) are among
    /// these: their faces are told in a way of their own by each format.
    ///
    /// # Errors
    /// A name for the user.
    pub fn from_vtk(number: u64) -> std::result::Result<Self, String> {
        Ok(match number {
            0..=9 | 21..=23 | 28 | 30 | 34..=36 => Self::Flat,
            10 => Self::Tetrahedron,
            11 => Self::Voxel,
            12 => Self::Hexahedron,
            13 => Self::Wedge,
            14 => Self::Pyramid,
            24 => Self::QuadraticTetrahedron,
            25 => Self::QuadraticHexahedron,
            26 => Self::QuadraticWedge,
            27 => Self::QuadraticPyramid,
            29 => Self::TriquadraticHexahedron,
            32 => Self::BiquadraticWedge,
            other => return Err(vtk_name(other)),
        })
    }
}

/// A VTK cell type that is not read, for people.
fn vtk_name(number: u64) -> String {
    let name = match number {
        15 => "pentagonal prism",
        16 => "hexagonal prism",
        31 => "quadratic linear wedge",
        33 => "biquadratic quadratic hexahedron",
        37 => "triquadratic pyramid",
        41 => "convex point set",
        42 => "polyhedron",
        51..=56 => "parametric cell",
        60..=67 => "higher-order cell",
        68..=74 => "Lagrange cell",
        75..=81 => "Bezier cell",
        _ => return format!("cell type {number}"),
    };
    format!("cell type {number} ({name})")
}
