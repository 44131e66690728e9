//! Gradients at the vertices of a mesh, for quadratic interpolation.
//!
//! A linear field has one gradient in a tetrahedron; that of a vertex is the mean over its
//! tetrahedra, weighted by volume. Each tetrahedron gives volume and gradient to its vertices; the
//! records are sorted by vertex and tetrahedron, and added in that order, so the sum does not
//! depend on memory.

use super::column::{Column, ColumnWriter};
use super::settings::StoreSettings;
use super::store::CellStore;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::error::Result;
use isospan_io::geom::vec3::{cross, dot};
use isospan_mesh::locate::FinePos;

/// Vertex, tetrahedron, then the bits of volume and of the gradient times the volume.
type Record = [u64; 6];

/// The gradient at each vertex, in the value's unit by fine step; zero where no tetrahedron with
/// finite values is.
pub(crate) fn gradients(
    store: &CellStore,
    values: &Column<f32>,
    settings: &StoreSettings,
) -> Result<Column<[f64; 3]>> {
    let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
    let mut sorter: Sorter<Record> = Sorter::new(memory, &settings.scratch);
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
    let mut out = ColumnWriter::new(&settings.scratch)?;
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

/// Six times the volume of a tetrahedron, and the gradient of the linear field in it times that:
/// with edges u, v, w from the first corner and differences f of the values along them, the
/// gradient is (f_u v×w + f_v w×u + f_w u×v) / (u · v×w).
fn of_tet(corners: [FinePos; 4], values: [f64; 4]) -> (f64, [f64; 3]) {
    let edge = |i: usize| -> [f64; 3] { std::array::from_fn(|k| (corners[i][k] - corners[0][k]) as f64) };
    let (u, v, w) = (edge(1), edge(2), edge(3));
    let (vw, wu, uv) = (cross(v, w), cross(w, u), cross(u, v));
    let volume = dot(u, vw);
    let [fu, fv, fw] = [values[1] - values[0], values[2] - values[0], values[3] - values[0]];
    (volume, std::array::from_fn(|k| fu * vw[k] + fv * wu[k] + fw * uv[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::settings::BadValue;
    use isospan_io::exec::CancelToken;
    use isospan_io::formats::{OpenOptions, open_mesh};
    use isospan_mesh::locate::{
        CellBatch, CellHit, Corner, FINE_BITS, PointGrid, fine, linear, quadratic, quadratic_thesis,
    };
    use std::fmt::Write as _;
    use std::path::Path;

    fn field(p: [f64; 3]) -> f64 {
        p[0] * p[0] + p[1] * p[2]
    }

    /// A mesh of n³ cubes of six tetrahedra each, with the field.
    fn write_mesh(path: &Path, n: usize) {
        const PATHS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let m = n + 1;
        let places: Vec<[f64; 3]> =
            (0..m * m * m).map(|v| [v % m, v / m % m, v / m / m].map(|c| c as f64 / n as f64)).collect();
        let mut text = String::from("# vtk DataFile Version 3.0\nmesh\nASCII\nDATASET UNSTRUCTURED_GRID\n");
        writeln!(text, "POINTS {} double", m * m * m).unwrap();
        places.iter().for_each(|[x, y, z]| writeln!(text, "{x} {y} {z}").unwrap());
        let cells = 6 * n * n * n;
        writeln!(text, "CELLS {cells} {}", 5 * cells).unwrap();
        for cube in 0..n * n * n {
            let first = (cube / n / n * m + cube / n % n) * m + cube % n;
            for path in PATHS {
                let step = |axis: usize| [1, m, m * m][path[axis]];
                let (a, b) = (first + step(0), first + step(0) + step(1));
                writeln!(text, "4 {first} {a} {b} {}", b + step(2)).unwrap();
            }
        }
        writeln!(text, "CELL_TYPES {cells}\n{}", "10\n".repeat(cells)).unwrap();
        writeln!(text, "POINT_DATA {}\nSCALARS f double\nLOOKUP_TABLE default", m * m * m).unwrap();
        places.iter().for_each(|&p| writeln!(text, "{}", field(p)).unwrap());
        std::fs::write(path, text).unwrap();
    }

    /// Mean errors of the three interpolations at points all over a mesh, and the largest of the
    /// quadratic one.
    fn errors(n: usize) -> [f64; 4] {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mesh.vtk");
        write_mesh(&path, n);
        let settings = StoreSettings {
            memory: 1 << 20,
            scratch: dir.path().to_path_buf(),
            bad_value: BadValue::Refuse,
            missing: None,
            offset: 0.0,
            cancel: CancelToken::new(),
        };
        let store = CellStore::build(&open_mesh(&path, &OpenOptions::default()).unwrap(), &settings).unwrap();
        let gradients = gradients(&store, &store.values, &settings).unwrap();
        let (positions, tets) = (store.positions.get().unwrap(), store.tets.get().unwrap());
        let cells = CellBatch {
            positions: positions.to_vec(),
            corners: tets.iter().map(|t| t.map(|v| v as u32)).collect(),
            ids: (0..tets.len() as u64).collect(),
        };
        let max = store.frame.lattice.max().map(u64::from);
        let points: Vec<FinePos> = (1..=4000u64)
            .map(|i| {
                fine(std::array::from_fn(|a| (i * [7919, 104_729, 1301][a] * 2_654_435 % max[a]) as u32))
            })
            .collect();
        let mut found = vec![CellHit::default(); points.len()];
        PointGrid::new(&points).locate(&cells, &mut found);
        let side = f64::from(store.frame.lattice.max()[0]) * f64::from(1u32 << FINE_BITS);
        let mut sums = [0.0; 4];
        for (p, found) in points.iter().zip(&found) {
            let corners = tets[found.id as usize].map(|v| Corner {
                position: positions[v as usize].map(|c| c as f64),
                value: f64::from(store.values.get().unwrap()[v as usize]),
                gradient: gradients.get().unwrap()[v as usize],
            });
            let (weights, values) = (&found.weights, &corners.map(|c| c.value));
            let exact = field(p.map(|c| c as f64 / side));
            let of = |value: f64| (value - exact).abs();
            let curved = of(quadratic(weights, &corners));
            for (sum, e) in sums.iter_mut().zip([
                of(linear(weights, values)),
                of(quadratic_thesis(weights, values)),
                curved,
            ]) {
                *sum += e / points.len() as f64;
            }
            sums[3] = f64::max(sums[3], curved);
        }
        sums
    }

    /// On a mesh that looks alike around each inner vertex the estimated gradients are exact there,
    /// for a quadratic field: the error is that of the layer of cells at the boundary, of order 2,
    /// a part h of the volume.
    #[test]
    fn orders_of_convergence_with_estimated_gradients() {
        let (coarse, fine) = (errors(6), errors(12));
        let order: [f64; 4] = std::array::from_fn(|i| (coarse[i] / fine[i]).log2());
        assert!((order[0] - 2.0).abs() < 0.1, "linear: {order:?}");
        assert!((coarse[1] - coarse[0]).abs() < 1e-6, "the thesis's quadratic is linear: {coarse:?}");
        assert!(order[2] > 2.7, "quadratic, mean: {order:?}");
        assert!(order[3] > 1.8, "quadratic, worst: {order:?}");
        assert!(fine[2] < 0.3 * fine[0], "quadratic beats linear: {fine:?}");
    }
}
