//! Which tetrahedron of an unstructured mesh holds a point, and with which weights?
//!
//! A reduction asks for few points among many cells (a cell is asked for about 0.02 points at the
//! usual densities), so the cells are not indexed: the **points** are, in a grid of about one point
//! a cell of it, and each tetrahedron looks up the points near it ([`PointGrid`]). Cells stream
//! past once, in any order, and nothing is built for them. The thesis's search (section 4.3), a
//! six-dimensional kd-tree over the cells' bounding boxes, is [`KdTree`]; both give the same
//! answers, which is tested, and `benches/compare_locate` says what each costs.
//!
//! # Exact
//!
//! Vertices of the mesh are rounded to **fine steps**, 2^-14 of a lattice step ([`FINE_BITS`]): 38
//! bits a coordinate, 2^-38 of the longest side of the domain. The four orientations that tell
//! inside from outside are then integers below 2^120, evaluated in `f64` with a proven margin first
//! and in `i128` where that does not decide.
//!
//! A point on a face, an edge or a vertex lies in several closed tetrahedra; the answer is the one
//! of the **lowest id**. So it does not depend on the order of cells or points, nor on how cells
//! were bucketed, and tetrahedra that overlap by rounding do no harm.
//!
//! # Weights
//!
//! The orientations of the point with three corners each are six times the volumes V_i of the
//! thesis's natural coordinates λ_i = V_i/V (its equation 4.1 and Figure 4.2), V their sum. A
//! weight that is exactly zero is 0.0.

mod interpolate;
mod kd_tree;
mod point_grid;

pub use interpolate::{Corner, linear, quadratic, quadratic_thesis};
pub use kd_tree::KdTree;
pub use point_grid::PointGrid;

use isospan_io::geom::LatticePos;
use isospan_io::geom::vec3::minus;

/// A lattice step is 2^14 fine steps.
pub const FINE_BITS: u32 = 14;

/// A position in fine steps; a coordinate is 0 to 2^38.
pub type FinePos = [i64; 3];

/// A lattice position in fine steps.
#[inline]
pub fn fine(pos: LatticePos) -> FinePos {
    pos.map(|p| i64::from(p) << FINE_BITS)
}

/// The lattice position nearest to one in fine steps.
#[inline]
pub fn rounded(p: FinePos) -> LatticePos {
    p.map(|c| ((c + (1 << (FINE_BITS - 1))) >> FINE_BITS) as u32)
}

/// Some tetrahedra of a mesh with their vertices.
#[derive(Clone, Debug, Default)]
pub struct CellBatch {
    /// Positions of the vertices.
    pub positions: Vec<FinePos>,
    /// Corners of each tetrahedron, as numbers into `positions`; positively oriented
    /// ([`is_positive`]).
    pub corners: Vec<[u32; 4]>,
    /// The id of each tetrahedron in the whole mesh.
    pub ids: Vec<u64>,
}

impl CellBatch {
    /// Positions of the corners of a tetrahedron.
    #[inline]
    pub fn corners_of(&self, cell: usize) -> [FinePos; 4] {
        self.corners[cell].map(|v| self.positions[v as usize])
    }

    /// Forgets the cells and keeps the memory.
    pub fn clear(&mut self) {
        self.positions.clear();
        self.corners.clear();
        self.ids.clear();
    }
}

/// Where a point lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellHit {
    /// Id of the tetrahedron; [`CellHit::NOWHERE`] of a point in none.
    pub id: u64,
    /// Its number in the batch in which it was found.
    pub cell: u32,
    /// Weights of its corners: at least 0, their sum 1 up to rounding.
    pub weights: [f64; 4],
}

impl CellHit {
    /// The id of no tetrahedron.
    pub const NOWHERE: u64 = u64::MAX;
}

impl Default for CellHit {
    fn default() -> Self {
        Self { id: Self::NOWHERE, cell: 0, weights: [0.0; 4] }
    }
}

/// Six times the volume of a tetrahedron in fine steps, exactly.
pub fn volume6([a, b, c, d]: [FinePos; 4]) -> i128 {
    det_exact(minus(b, a), minus(c, a), minus(d, a))
}

/// Whether `det(b - a, c - a, d - a) > 0`.
pub fn is_positive(corners: [FinePos; 4]) -> bool {
    volume6(corners) > 0
}

/// Differences are at most 2^38: a product of three is at most 2^114, the sum of six below 2^117.
fn det_exact(u: [i64; 3], v: [i64; 3], w: [i64; 3]) -> i128 {
    let minor =
        |p: [i64; 3], q: [i64; 3]| i128::from(p[0]) * i128::from(q[1]) - i128::from(p[1]) * i128::from(q[0]);
    i128::from(u[2]) * minor(v, w) - i128::from(v[2]) * minor(u, w) + i128::from(w[2]) * minor(u, v)
}

/// The weights of a point in a positively oriented tetrahedron; `None` of one outside. Faces belong
/// to it.
///
/// # The margin
/// Differences to the point are integers up to 2^38, exact in `f64`. With M the product of the
/// largest absolute differences by axis and u = 2^-53, a 2×2 minor has an error of at most
/// 4u·mx·my, its product with the third coordinate 6u·M, and the sum of three of those 18u·M +
/// 10u·M; the margin is 40u·M, which covers terms of second order and the roundings of the margin
/// itself. Fused multiply-adds only make the error less.
#[inline]
pub fn weights(corners: [FinePos; 4], point: FinePos) -> Option<[f64; 4]> {
    const U: f64 = 1.0 / (1u64 << 53) as f64;
    let rows = corners.map(|c| minus(c, point));
    let [a, b, c, d] = rows.map(|r| r.map(|x| x as f64));
    let minor = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
    let (ab, ac, ad) = (minor(a, b), minor(a, c), minor(a, d));
    let (bc, bd, cd) = (minor(b, c), minor(b, d), minor(c, d));
    // With the point p as origin: det(b, c, d), and so on, signed so that all are positive inside.
    let mut dets = [
        b[2] * cd - c[2] * bd + d[2] * bc,
        -(a[2] * cd - c[2] * ad + d[2] * ac),
        a[2] * bd - b[2] * ad + d[2] * ab,
        -(a[2] * bc - b[2] * ac + c[2] * ab),
    ];
    let most = |k: usize| a[k].abs().max(b[k].abs()).max(c[k].abs().max(d[k].abs()));
    let margin = 40.0 * U * most(0) * most(1) * most(2);
    if dets.iter().any(|&v| v < -margin) {
        return None;
    }
    if dets.iter().any(|&v| v <= margin) {
        let [a, b, c, d] = rows;
        let exact = [det_exact(b, c, d), -det_exact(a, c, d), det_exact(a, b, d), -det_exact(a, b, c)];
        if exact.iter().any(|&v| v < 0) {
            return None;
        }
        dets = exact.map(|v| v as f64);
    }
    let sum = (dets[0] + dets[1]) + (dets[2] + dets[3]);
    Some(dets.map(|v| v / sum))
}

/// Keeps of two answers the one of the lower id.
#[inline]
fn keep(found: &mut CellHit, id: u64, cell: usize, weights: [f64; 4]) {
    if id < found.id {
        *found = CellHit { id, cell: cell as u32, weights };
    }
}

#[cfg(test)]
mod tests;
