//! Gradients at the vertices of a mesh, for quadratic interpolation.
//!
//! A linear field has one gradient in a tetrahedron; that of a vertex is the mean over its tetrahedra, weighted by volume. Each tetrahedron tells
//! its vertices volume and gradient; the records are sorted by vertex and tetrahedron, and added in that order, so the sum does not depend
//! on memory.

use super::column::{Column, ColumnWriter};
use super::store::{CellStore, StoreSettings};
use crate::bytes::sorter::Sorter;
use crate::error::Result;
use crate::locate::FinePos;

/// Vertex, tetrahedron, then the bits of volume and of the gradient times the volume.
type Record = [u64; 6];

/// The gradient at each vertex, in the value's unit by fine step; zero where no tetrahedron with finite values is.
pub(crate) fn gradients(
    store: &CellStore,
    values: &Column<f32>,
    settings: &StoreSettings<'_>,
) -> Result<Column<[f64; 3]>> {
    let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
    let mut sorter: Sorter<Record> = Sorter::new(memory, settings.scratch);
    let (positions, values) = (store.positions.get()?, values.get()?);
    for (number, tet) in store.tets.get()?.iter().enumerate() {
        let (volume, weighted) =
            of_tet(tet.map(|v| positions[v as usize]), tet.map(|v| f64::from(values[v as usize])));
        if weighted.iter().all(|g| g.is_finite()) {
            for &v in tet {
                let [x, y, z] = weighted.map(f64::to_bits);
                sorter.push([v, number as u64, volume.to_bits(), x, y, z])?;
            }
        }
    }
    let mut out = ColumnWriter::new(settings.scratch)?;
    let mut sorted = sorter.finish()?;
    let mut next = sorted.next()?;
    for vertex in 0..positions.len() as u64 {
        let (mut volume, mut sum) = (0.0, [0.0; 3]);
        while let Some([_, _, v, x, y, z]) = next.filter(|r| r[0] == vertex) {
            volume += f64::from_bits(v);
            sum = [sum[0] + f64::from_bits(x), sum[1] + f64::from_bits(y), sum[2] + f64::from_bits(z)];
            next = sorted.next()?;
        }
        out.push(&if volume > 0.0 { sum.map(|s| s / volume) } else { [0.0; 3] })?;
    }
    out.finish()
}

/// Six times the volume of a tetrahedron, and the gradient of the linear field in it times that: with edges u, v, w from the first corner and
/// differences f of the values along them, the gradient is (f_u v×w + f_v w×u + f_w u×v) / (u · v×w).
fn of_tet(corners: [FinePos; 4], values: [f64; 4]) -> (f64, [f64; 3]) {
    let edge = |i: usize| -> [f64; 3] { std::array::from_fn(|k| (corners[i][k] - corners[0][k]) as f64) };
    let cross = |p: [f64; 3], q: [f64; 3]| {
        [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
    };
    let (u, v, w) = (edge(1), edge(2), edge(3));
    let (vw, wu, uv) = (cross(v, w), cross(w, u), cross(u, v));
    let volume = u[0] * vw[0] + u[1] * vw[1] + u[2] * vw[2];
    let [fu, fv, fw] = [values[1] - values[0], values[2] - values[0], values[3] - values[0]];
    (volume, std::array::from_fn(|k| fu * vw[k] + fv * wu[k] + fw * uv[k]))
}
