//! Quadratic cells into linear tetrahedra, on all of their own vertices.
//!
//! The vertices in the middle of the edges carry positions and values of their own: a quadratic
//! cell becomes a finer mesh of linear ones, curved edges follow their middle, and nothing is
//! interpolated.
//!
//! Cells with vertices on edges only are cut in two steps. Each corner is cut off, up to the
//! middles of its edges; what is left is a convex body of middles alone (of a tetrahedron an
//! octahedron, of a hexahedron a cuboctahedron), filled by the star of its smallest vertex. On a
//! face this leaves a triangle at each corner and one inner polygon, cut from its smallest vertex:
//! again a rule of the face's vertices alone.
//!
//! ```text
//!   3----6----2        3-----10----2
//!   | a / \ b |        |  /      \ |        a triangle at each corner, the polygon of middles within
//!   7 /     \ 5       11           9
//!   | \     / |        | \       / |
//!   0----4----1        0-----8-----1
//! ```
//!
//! Cells with vertices in the middle of their four-sided faces too are cut into smaller linear
//! cells: a hexahedron into 8, a wedge into 8, a pyramid into 6 pyramids and 4 tetrahedra; those
//! are split by the rule for linear cells.

use super::kind::{CellKind, HEXAHEDRON, PYRAMID, Shape, WEDGE};
use super::split::{CellTet, fan, star};

/// Appends the tetrahedra of a quadratic cell.
pub(super) fn split(kind: CellKind, vertices: &[u64], out: &mut Vec<CellTet>) {
    let parts = |shape: &Shape, cells: &[&[u8]], out: &mut Vec<CellTet>| {
        for cell in cells {
            let part: Vec<u64> = cell.iter().map(|&i| vertices[usize::from(i)]).collect();
            star(shape.faces.iter().copied(), &part, out);
        }
    };
    match kind {
        CellKind::TriquadraticHexahedron => parts(&HEXAHEDRON, &HEXAHEDRA_OF_27, out),
        CellKind::BiquadraticWedge => parts(&WEDGE, &WEDGES_OF_18, out),
        CellKind::BiquadraticPyramid => {
            parts(&PYRAMID, &PYRAMIDS_OF_14, out);
            out.extend(TETRAHEDRA_OF_14.map(|tet| tet.map(|i| vertices[usize::from(i)])));
        }
        _ => cut_corners(kind.shape(), vertices, out),
    }
}

/// The vertex on the edge between two corners.
fn middle(shape: &Shape, a: u8, b: u8) -> u8 {
    let edge = shape.edges.iter().position(|e| *e == [a, b] || *e == [b, a]);
    (shape.corners + edge.expect("neighbours around a face are joined by an edge")) as u8
}

/// Corners, then the body of middles.
fn cut_corners(shape: &Shape, vertices: &[u64], out: &mut Vec<CellTet>) {
    // Inner polygons of the faces, then one polygon a corner; all anticlockwise from outside the
    // body of middles.
    let mut body: Vec<Vec<u8>> = vec![];
    // For each corner, the sides of inner polygons that cut it off, as seen from the corner's
    // polygon.
    let mut sides: Vec<Vec<[u8; 2]>> = vec![vec![]; shape.corners];
    for face in shape.faces {
        let n = face.len();
        let inner: Vec<u8> = (0..n).map(|i| middle(shape, face[i], face[(i + 1) % n])).collect();
        for i in 0..n {
            sides[usize::from(face[(i + 1) % n])].push([inner[(i + 1) % n], inner[i]]);
        }
        body.push(inner);
    }
    for (corner, sides) in sides.iter().enumerate() {
        let mut polygon = vec![sides[0][0]];
        while polygon.len() < sides.len() {
            let last = polygon[polygon.len() - 1];
            let next = sides.iter().find(|s| s[0] == last).expect("the faces at a corner close around it");
            polygon.push(next[1]);
        }
        // The corner lies outside: seen from it the polygon is anticlockwise.
        fan(&polygon, vertices, |[a, b, c]| out.push([vertices[corner], a, c, b]));
        body.push(polygon);
    }
    star(body.iter().map(Vec::as_slice), vertices, out);
}

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
