//! Quadratic cells into linear tetrahedra, on all of their vertices.
//!
//! The vertices in the middle of the edges carry positions and values of their own: a quadratic
//! cell becomes a finer mesh of linear ones, and curved edges follow their middle. Cells with
//! vertices in the middle of their four-sided faces too are cut into smaller linear cells: a
//! hexahedron into 8, a wedge into 8, a pyramid into 6 pyramids and 4 tetrahedra; those are split
//! by the rule for linear cells. Of a thin curved cell these are whole, as its halves are.
//!
//! Cells that have vertices on their edges alone are given those of faces ([`Middles`]), where
//! their shape functions have them: in position and value a quarter of each corner less than the
//! halves of the vertices on edges (Zienkiewicz and Taylor, "The Finite Element Method", the
//! serendipity family). A face is given the same one by both of its cells. Who has positions and
//! values at hand makes them (`domain`).
//!
//! ```text
//!   3----6----2
//!   |    |    |        m = (4 + 5 + 6 + 7) / 2 - (0 + 1 + 2 + 3) / 4
//!   7----m----5
//!   |    |    |
//!   0----4----1
//! ```
//!
//! Of a tetrahedron each corner is cut off, up to the middles of its edges; what is left is an
//! octahedron of middles, filled by the star of its smallest vertex. So on a face there are four
//! triangles, as of wedges and pyramids.

use super::kind::{CellKind, HEXAHEDRON, PYRAMID, Shape, WEDGE};
use super::star::{CellTet, star};

/// The vertices that a quadratic cell lacks in its middle.
#[derive(Debug)]
pub struct Middles {
    /// The kind that has them: behind the vertices of the cell, face by face, then the centre.
    pub kind: CellKind,
    /// Around each face that has one: its corners, then the vertices on its edges.
    pub faces: &'static [[u8; 8]],
    /// Whether the cell has one in its centre.
    pub has_centre: bool,
}

impl Middles {
    /// Of each vertex that a cell lacks, in order, the cell's vertices around it, corners first,
    /// and how many corners these are.
    pub fn around<'a>(&'static self, vertices: &'a [u64]) -> impl Iterator<Item = (Vec<u64>, usize)> + 'a {
        let of_face = |face: &[u8; 8]| (face.iter().map(|&i| vertices[usize::from(i)]).collect(), 4);
        let centre = self.has_centre.then(|| (vertices.to_vec(), self.kind.shape().corners));
        self.faces.iter().map(of_face).chain(centre)
    }
}

/// What a vertex in the middle of a face or cell has, from its corners and from the vertices on its
/// edges. Without corners it is the mean.
pub fn at_middle(corners: impl Iterator<Item = f64>, others: impl Iterator<Item = f64>) -> f64 {
    let sum = |all: (f64, f64), x: f64| (all.0 + x, all.1 + 1.0);
    let (of_corners, count) = corners.fold((0.0, 0.0), sum);
    let (of_others, others) = others.fold((0.0, 0.0), sum);
    (1.0 + 0.25 * count) * of_others / others - 0.25 * of_corners
}

impl CellKind {
    /// The vertices that cells of this kind are given before they are split.
    pub fn middles(self) -> Option<&'static Middles> {
        match self {
            Self::QuadraticHexahedron => Some(&OF_HEXAHEDRON),
            Self::QuadraticWedge => Some(&OF_WEDGE),
            Self::QuadraticPyramid => Some(&OF_PYRAMID),
            _ => None,
        }
    }
}

const OF_HEXAHEDRON: Middles = Middles {
    kind: CellKind::TriquadraticHexahedron,
    faces: &[
        [0, 4, 7, 3, 16, 15, 19, 11],
        [1, 2, 6, 5, 9, 18, 13, 17],
        [0, 1, 5, 4, 8, 17, 12, 16],
        [2, 3, 7, 6, 10, 19, 14, 18],
        [0, 1, 2, 3, 8, 9, 10, 11],
        [4, 5, 6, 7, 12, 13, 14, 15],
    ],
    has_centre: true,
};

const OF_WEDGE: Middles = Middles {
    kind: CellKind::BiquadraticWedge,
    faces: &[[0, 1, 4, 3, 6, 13, 9, 12], [1, 2, 5, 4, 7, 14, 10, 13], [2, 0, 3, 5, 8, 12, 11, 14]],
    has_centre: false,
};

const OF_PYRAMID: Middles =
    Middles { kind: CellKind::BiquadraticPyramid, faces: &[[0, 1, 2, 3, 5, 6, 7, 8]], has_centre: false };

/// A cell with the vertices that it lacks, and where these are: they have the numbers from the
/// largest one downwards.
pub(crate) fn with_middles(
    kind: CellKind,
    vertices: &[u64],
    place: impl Fn(u64) -> [f64; 3],
) -> (CellKind, Vec<u64>, Vec<[f64; 3]>) {
    let Some(middles) = kind.middles() else { return (kind, vertices.to_vec(), vec![]) };
    let added: Vec<[f64; 3]> = middles
        .around(vertices)
        .map(|(around, corners)| {
            let (corners, others) = around.split_at(corners);
            let along = |of: &[u64], a: usize| of.iter().map(|&v| place(v)[a]).collect::<Vec<f64>>();
            std::array::from_fn(|a| at_middle(along(corners, a).into_iter(), along(others, a).into_iter()))
        })
        .collect();
    let numbers = (0..added.len() as u64).map(|n| u64::MAX - n);
    (middles.kind, vertices.iter().copied().chain(numbers).collect(), added)
}

/// Appends the tetrahedra of a quadratic cell that lacks no vertex.
pub(super) fn split(kind: CellKind, vertices: &[u64], out: &mut Vec<CellTet>) {
    let mut parts = |shape: &Shape, cells: &[&[u8]]| {
        for cell in cells {
            let part: Vec<u64> = cell.iter().map(|&i| vertices[usize::from(i)]).collect();
            star(shape.faces.iter().copied(), &part, out);
        }
    };
    match kind {
        CellKind::TriquadraticHexahedron => parts(&HEXAHEDRON, &HEXAHEDRA_OF_27),
        CellKind::BiquadraticWedge => parts(&WEDGE, &WEDGES_OF_18),
        CellKind::BiquadraticPyramid => {
            parts(&PYRAMID, &PYRAMIDS_OF_14);
            out.extend(TETRAHEDRA_OF_14.map(|tet| tet.map(|i| vertices[usize::from(i)])));
        }
        _ => {
            out.extend(CORNERS_OF_10.map(|tet| tet.map(|i| vertices[usize::from(i)])));
            star(OCTAHEDRON_OF_10.iter().map(|face| &face[..]), vertices, out);
        }
    }
}

/// Vertices 4 … 9 lie on the edges 0-1, 1-2, 2-0, 0-3, 1-3, 2-3.
const CORNERS_OF_10: [[u8; 4]; 4] = [[0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3]];

const OCTAHEDRON_OF_10: [[u8; 3]; 8] =
    [[4, 6, 5], [4, 8, 7], [5, 9, 8], [6, 7, 9], [4, 7, 6], [4, 5, 8], [5, 6, 9], [7, 8, 9]];

/// Faces 20 … 25 are x-, x+, y-, y+, z-, z+; 26 is the middle.
const HEXAHEDRA_OF_27: [&[u8]; 8] = [
    &[0, 8, 24, 11, 16, 22, 26, 20],
    &[8, 1, 9, 24, 22, 17, 21, 26],
    &[24, 9, 2, 10, 26, 21, 18, 23],
    &[11, 24, 10, 3, 20, 26, 23, 19],
    &[16, 22, 26, 20, 4, 12, 25, 15],
    &[22, 17, 21, 26, 12, 5, 13, 25],
    &[26, 21, 18, 23, 25, 13, 6, 14],
    &[20, 26, 23, 19, 15, 25, 14, 7],
];

/// Faces 15, 16, 17 are those over the edges 0-1, 1-2, 2-0.
const WEDGES_OF_18: [&[u8]; 8] = [
    &[0, 6, 8, 12, 15, 17],
    &[6, 1, 7, 15, 13, 16],
    &[8, 7, 2, 17, 16, 14],
    &[6, 7, 8, 15, 16, 17],
    &[12, 15, 17, 3, 9, 11],
    &[15, 13, 16, 9, 4, 10],
    &[17, 16, 14, 11, 10, 5],
    &[15, 16, 17, 9, 10, 11],
];

/// 13 is the middle of the base. The fifth stands on the middles of the slanted edges, the sixth
/// hangs from them.
const PYRAMIDS_OF_14: [&[u8]; 6] = [
    &[0, 5, 13, 8, 9],
    &[5, 1, 6, 13, 10],
    &[13, 6, 2, 7, 11],
    &[8, 13, 7, 3, 12],
    &[9, 10, 11, 12, 4],
    &[12, 11, 10, 9, 13],
];

const TETRAHEDRA_OF_14: [[u8; 4]; 4] = [[5, 9, 10, 13], [6, 10, 11, 13], [7, 11, 12, 13], [8, 12, 9, 13]];
