//! The electric potential of a current dipole in a conducting body, by finite elements.
//!
//! In a body of conductivity σ(x) that lies in air, a source of impressed current with dipole
//! moment p at x₀ makes a potential u (Geselowitz 1967, "On bioelectric potentials in an
//! inhomogeneous volume conductor"):
//!
//! ```text
//! ∇·(σ ∇u) = ∇·(p δ(x - x₀)) inside,     σ ∂u/∂n = 0 on the skin
//! ```
//!
//! Multiplied by a test function φ_i and integrated by parts, with u = Σ u_j φ_j, linear in each
//! tetrahedron:
//!
//! ```text
//! Σ_j K_ij u_j = p · ∇φ_i(x₀),    K_ij = Σ_T σ_T V_T ∇φ_i · ∇φ_j
//! ```
//!
//! The right-hand side has four entries, at the corners of the tetrahedron that holds x₀ ("partial
//! integration", the direct method of Weinstein, Zhukov and Johnson 2000). K is symmetric and
//! positive but for constants; the right-hand side sums to zero, so conjugate gradients converge,
//! and the mean of u is set to zero at the end (a common average reference).
//!
//! The matrix is assembled and multiplied by the `sprs` crate. Its own iterative solver multiplies
//! sparse vectors, far too slow for dense ones, so the conjugate gradients (Hestenes and
//! Stiefel 1952), with the diagonal as preconditioner, are ours: one thread, plain sums, the same
//! bits everywhere.

use super::tets::{TetMesh, cross, dot, minus, volume6};
use isospan::{Error, Result};
use sprs::{CsMat, TriMat};

/// A current dipole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Dipole {
    /// Where, in millimetres.
    pub(crate) position: [f64; 3],
    /// Its moment in nanoampere metres.
    pub(crate) moment: [f64; 3],
}

/// What came of a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Solved {
    pub(crate) iterations: usize,
    /// |b - K u| / |b|.
    pub(crate) residual: f64,
}

/// Residual at which the iteration ends.
const TOLERANCE: f64 = 1e-9;

/// Fills the mesh's values with the potential in microvolts; `conductivities` (S/m) are by region.
///
/// Lengths are millimetres: K is in S/m · mm and the right-hand side in nA·m / mm, so u is in
/// millivolts.
pub(crate) fn solve(mesh: &mut TetMesh, conductivities: &[f64], dipole: &Dipole) -> Result<Solved> {
    let matrix = stiffness(mesh, conductivities);
    let rhs = source(mesh, dipole)?;
    let mut u = vec![0.0; rhs.len()];
    let solved = conjugate_gradients(&matrix, &rhs, &mut u);
    if solved.residual > TOLERANCE {
        return Err(Error::usage(format!(
            "the field of a dipole at {:?} does not converge: residual {:.1e} after {} iterations",
            dipole.position, solved.residual, solved.iterations
        )));
    }
    let mean = u.iter().sum::<f64>() / u.len() as f64;
    // (nA m / mm) / (S/m mm) = 1e-9 / 1e-6 V = mV.
    mesh.values = u.iter().map(|v| ((v - mean) * 1e3) as f32).collect();
    Ok(solved)
}

/// Gradients of the four barycentric coordinates, and the volume.
fn gradients(corners: [[f64; 3]; 4]) -> ([[f64; 3]; 4], f64) {
    let [a, b, c, d] = corners;
    let six = volume6(corners);
    let over = |v: [f64; 3]| v.map(|x| x / six);
    let at_b = over(cross(minus(c, a), minus(d, a)));
    let at_c = over(cross(minus(d, a), minus(b, a)));
    let at_d = over(cross(minus(b, a), minus(c, a)));
    let at_a = std::array::from_fn(|k| -(at_b[k] + at_c[k] + at_d[k]));
    ([at_a, at_b, at_c, at_d], six / 6.0)
}

fn stiffness(mesh: &TetMesh, conductivities: &[f64]) -> CsMat<f64> {
    let n = mesh.points.len();
    let mut entries = TriMat::with_capacity((n, n), 16 * mesh.tets.len());
    for (t, tet) in mesh.tets.iter().enumerate() {
        let (g, volume) = gradients(mesh.corners(t));
        let sigma = conductivities[usize::from(mesh.regions[t])];
        for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
            entries.add_triplet(tet[i] as usize, tet[j] as usize, sigma * volume * dot(g[i], g[j]));
        }
    }
    entries.to_csr()
}

fn source(mesh: &TetMesh, dipole: &Dipole) -> Result<Vec<f64>> {
    let inside = |t: &usize| {
        let (g, _) = gradients(mesh.corners(*t));
        let from = minus(dipole.position, mesh.corners(*t)[0]);
        let others = [1, 2, 3].map(|i| dot(g[i], from));
        others.iter().all(|&l| l >= 0.0) && others.iter().sum::<f64>() <= 1.0
    };
    let t = (0..mesh.tets.len())
        .find(inside)
        .ok_or_else(|| Error::usage(format!("no tetrahedron holds the dipole at {:?}", dipole.position)))?;
    let mut rhs = vec![0.0; mesh.points.len()];
    let (g, _) = gradients(mesh.corners(t));
    for (v, g) in mesh.tets[t].iter().zip(g) {
        rhs[*v as usize] = dot(dipole.moment, g);
    }
    Ok(rhs)
}

fn inner(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Solves `matrix x = rhs` from `x` on.
fn conjugate_gradients(matrix: &CsMat<f64>, rhs: &[f64], x: &mut [f64]) -> Solved {
    let n = rhs.len();
    let diagonal: Vec<f64> = matrix.diag().to_dense().to_vec();
    let times = |x: &[f64], out: &mut Vec<f64>| {
        out.clear();
        out.resize(n, 0.0);
        sprs::prod::mul_acc_mat_vec_csr(matrix.view(), x, &mut out[..]);
    };
    let mut product = vec![];
    times(x, &mut product);
    let mut r: Vec<f64> = rhs.iter().zip(&product).map(|(b, a)| b - a).collect();
    let mut z: Vec<f64> = r.iter().zip(&diagonal).map(|(r, d)| r / d).collect();
    let mut direction = z.clone();
    let (mut rz, scale) = (inner(&r, &z), inner(rhs, rhs).sqrt());
    let mut solved = Solved { iterations: 0, residual: inner(&r, &r).sqrt() / scale };
    while solved.residual > TOLERANCE && solved.iterations < 20_000 {
        times(&direction, &mut product);
        let step = rz / inner(&direction, &product);
        for i in 0..n {
            x[i] += step * direction[i];
            r[i] -= step * product[i];
            z[i] = r[i] / diagonal[i];
        }
        let before = std::mem::replace(&mut rz, inner(&r, &z));
        direction.iter_mut().zip(&z).for_each(|(d, z)| *d = z + rz / before * *d);
        solved = Solved { iterations: solved.iterations + 1, residual: inner(&r, &r).sqrt() / scale };
    }
    solved
}

#[cfg(test)]
mod tests {
    use super::super::bisect::refine;
    use super::super::tets::tests::cube;
    use super::*;

    /// A linear potential has no source inside, in any mesh: K u is zero at inner vertices.
    #[test]
    fn a_uniform_field_needs_no_source() {
        let mut mesh = cube();
        refine(&mut mesh, 200);
        let matrix = stiffness(&mesh, &[0.3]);
        let u: Vec<f64> = mesh.points.iter().map(|p| p[0] - 2.0 * p[1] + 0.5 * p[2]).collect();
        let mut flux = vec![0.0; u.len()];
        sprs::prod::mul_acc_mat_vec_csr(matrix.view(), &u[..], &mut flux[..]);
        let on_side = |p: &[f64; 3]| p.iter().any(|&x| x == 0.0 || x == 1.0);
        for (p, f) in mesh.points.iter().zip(&flux) {
            assert!(on_side(p) || f.abs() < 1e-12, "{p:?}: {f}");
        }
        // What enters leaves.
        assert!(flux.iter().sum::<f64>().abs() < 1e-12);
    }

    /// In a ball of radius R about the origin a dipole p in the middle has u = p·x / 4πσ (1/r³ +
    /// 2/R³) (Frank 1952).
    #[test]
    fn a_dipole_in_the_middle_of_a_ball() {
        use super::super::ellipsoids::{Layer, mesh_body};
        let ball = Layer { centre: [0.0; 3], axes: [50.0; 3], region: Some(0) };
        let mut mesh = mesh_body(&[ball], 4_000).unwrap();
        let dipole = Dipole { position: [0.3, 0.2, 0.1], moment: [0.0, 0.0, 10.0] };
        let solved = solve(&mut mesh, &[0.33], &dipole).unwrap();
        assert!(solved.residual <= TOLERANCE);
        let exact = |p: [f64; 3]| {
            let r = dot(p, p).sqrt() / 1e3;
            let along = 10e-9 * p[2] / 1e3;
            along / (4.0 * std::f64::consts::PI * 0.33)
                * (1.0 / (r * r * r) + 2.0 / (0.05f64 * 0.05 * 0.05))
                * 1e6
        };
        let far = |p: &[f64; 3]| dot(*p, *p) > 25.0 * 25.0;
        let (mut wrong, mut all) = (0.0, 0.0);
        for (p, &u) in mesh.points.iter().zip(&mesh.values).filter(|(p, _)| far(p)) {
            wrong += (f64::from(u) - exact(*p)).powi(2);
            all += exact(*p).powi(2);
        }
        let relative = (wrong / all).sqrt();
        assert!(relative < 0.15, "{relative}");
    }
}
