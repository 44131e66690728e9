//! Constants stay, linear fields stay, errors fall, nothing leaks from holes; neither order nor windows show.

use super::*;
use crate::geom::Lattice;
use crate::geom::curve::Order;
use crate::mesh::delaunay::Mesher;
use crate::points::{PointSet, PointSpec};
use crate::raster::interpolate;

const DIMS: [u64; 3] = [21, 17, 38];

/// A mesh of the whole domain, a point for eight samples.
fn mesh() -> (SampleGrid, Vec<LatticePos>, Vec<Tet>) {
    let lattice = Lattice::new(DIMS).unwrap();
    let n = DIMS.iter().product::<u64>() / 8;
    let set = PointSet::new(PointSpec::Hammersley { n, shift: 0.5 }, lattice).unwrap();
    let mut sites = vec![];
    set.sites_in(&lattice.domain(), &mut sites);
    let positions: Vec<LatticePos> = sites.iter().map(|s| s.pos).collect();
    let mut mesher = Mesher::new();
    mesher.delaunay(&positions, &Order::for_count(n)).unwrap();
    let mut tets = vec![];
    mesher.for_each_tet(|t| tets.push(t));
    (SampleGrid::voxels(&lattice), positions, tets)
}

fn at(grid: &SampleGrid, p: LatticePos) -> [f64; 3] {
    std::array::from_fn(|k| f64::from(p[k]) / f64::from(grid.far()[k]))
}

/// The values of a field at all samples of a box.
fn samples(grid: &SampleGrid, window: &IndexBox, f: &dyn Fn([f64; 3]) -> f32) -> Vec<f32> {
    let mut out = vec![];
    let [xs, ys, zs] = grid.axes();
    for z in window.lo[2]..window.hi[2] {
        for y in window.lo[1]..window.hi[1] {
            for x in window.lo[0]..window.hi[0] {
                let p = [xs.position(x as usize), ys.position(y as usize), zs.position(z as usize)];
                out.push(f(at(grid, p)));
            }
        }
    }
    out
}

fn fitted(grid: &SampleGrid, edge: [u64; 3], mesh: &FitMesh<'_>, f: &dyn Fn([f64; 3]) -> f32) -> Vec<f32> {
    let windows = Windows::new(grid, edge, mesh.positions, mesh.tets);
    let mut fit = Fit::new(mesh.positions.len());
    for (window, tets) in windows.iter() {
        fit.add(mesh, grid, &window, &samples(grid, &window, f), tets);
    }
    fit.values(mesh, mesh.positions.len())
}

fn rms(grid: &SampleGrid, mesh: &FitMesh<'_>, values: &[f32], f: &dyn Fn([f64; 3]) -> f32) -> f64 {
    let whole = IndexBox::whole(grid.dims());
    let truth = samples(grid, &whole, f);
    let (mut sum, mut count) = (0.0, 0);
    let scanner = Scanner::new(grid, &whole);
    for tet in mesh.tets {
        scanner.each_run(tet.map(|v| mesh.positions[v as usize]), |place, run| {
            for (i, &w) in run.iter().enumerate() {
                let found = interpolate(w, tet.map(|v| values[v as usize]));
                sum += f64::from(found - truth[place + i]).powi(2);
                count += 1;
            }
        });
    }
    assert_eq!(count, truth.len());
    (sum / count as f64).sqrt()
}

#[test]
fn constants_stay_and_linear_fields_stay_linear() {
    let (grid, positions, tets) = mesh();
    for (f, bound) in [
        (&(|_: [f64; 3]| 0.1f32) as &dyn Fn([f64; 3]) -> f32, 0.0),
        (&|p: [f64; 3]| (100.0 + 3.0 * p[0] - 2.0 * p[1] + p[2]) as f32, 1e-5),
    ] {
        let values: Vec<f32> = positions.iter().map(|&p| f(at(&grid, p))).collect();
        let mesh = FitMesh { positions: &positions, values: &values, tets: &tets };
        for (new, old) in fitted(&grid, [32; 3], &mesh, f).iter().zip(&values) {
            assert!((new - old).abs() <= bound, "{new} {old}");
        }
    }
}

#[test]
fn the_error_falls_on_curved_fields() {
    let (grid, positions, tets) = mesh();
    let f: &dyn Fn([f64; 3]) -> f32 =
        &|p| (9.0 * p[0]).sin() as f32 * (8.0 * p[1]).cos() as f32 + (11.0 * p[2]).sin() as f32;
    let values: Vec<f32> = positions.iter().map(|&p| f(at(&grid, p))).collect();
    let mesh = FitMesh { positions: &positions, values: &values, tets: &tets };
    let (before, after) =
        (rms(&grid, &mesh, &values, f), rms(&grid, &mesh, &fitted(&grid, [32; 3], &mesh, f), f));
    assert!(after < 0.7 * before, "{after} {before}");
}

#[test]
fn the_order_of_tetrahedra_and_corners_does_not_show() {
    let (grid, positions, tets) = mesh();
    let f: &dyn Fn([f64; 3]) -> f32 = &|p| (40.0 * p[0] * p[1]).sin() as f32 + p[2] as f32;
    let values: Vec<f32> = positions.iter().map(|&p| f(at(&grid, p))).collect();
    let bits = |tets: &[Tet]| -> Vec<u32> {
        let mesh = FitMesh { positions: &positions, values: &values, tets };
        fitted(&grid, [8, 16, 8], &mesh, f).iter().map(|v| v.to_bits()).collect()
    };
    let turned: Vec<Tet> = tets.iter().rev().map(|&[a, b, c, d]| [d, c, b, a]).collect();
    assert_eq!(bits(&tets), bits(&turned));
    // Only some tetrahedra: the vertices whose own are all there have the values that they had.
    let (some, others): (Vec<Tet>, Vec<Tet>) =
        tets.iter().partition(|t| positions[t[0] as usize][2] < 1 << 22);
    let mut whole = vec![true; positions.len()];
    others.iter().flatten().for_each(|&v| whole[v as usize] = false);
    assert!(whole.iter().filter(|w| **w).count() > 100 && !others.is_empty());
    for ((new, old), whole) in bits(&some).iter().zip(bits(&tets)).zip(&whole) {
        assert!(!whole || *new == old);
    }
}

#[test]
fn vectors_do_not_show() {
    let (grid, positions, tets) = mesh();
    let f: &dyn Fn([f64; 3]) -> f32 = &|p| (40.0 * p[0] * p[1]).sin() as f32 + p[2] as f32;
    let values: Vec<f32> = positions.iter().map(|&p| f(at(&grid, p))).collect();
    let mesh = FitMesh { positions: &positions, values: &values, tets: &tets };
    let [mut plain, mut vectors] = [0, 1].map(|_| Fit::new(positions.len()));
    for (window, tets) in Windows::new(&grid, [32; 3], &positions, &tets).iter() {
        let samples = samples(&grid, &window, f);
        vectors.add(&mesh, &grid, &window, &samples, tets);
        plain.add_window(&mesh, &Scanner::new(&grid, &window), &samples, tets);
    }
    let bits =
        |fit: &Fit| fit.sums.iter().map(|s| [s.pull.to_bits(), s.weight.to_bits()]).collect::<Vec<_>>();
    assert_eq!(bits(&plain), bits(&vectors));
    assert!(bits(&plain).iter().any(|s| s[0] != 0));
}

#[test]
fn holes_do_not_leak() {
    let (grid, positions, tets) = mesh();
    let hole = |p: [f64; 3]| p[0] > 0.6 && p[2] < 0.4;
    let f: &dyn Fn([f64; 3]) -> f32 = &|p| if hole(p) { f32::NAN } else { 7.5 };
    let values: Vec<f32> = positions.iter().map(|&p| f(at(&grid, p))).collect();
    let mesh = FitMesh { positions: &positions, values: &values, tets: &tets };
    let found = fitted(&grid, [32; 3], &mesh, f);
    assert!(found.iter().any(|v| v.is_nan()));
    assert!(found.iter().zip(&values).all(|(a, b)| a.to_bits() == b.to_bits()));
}

#[test]
fn windows_hold_each_sample_of_each_tetrahedron_once() {
    let (grid, positions, tets) = mesh();
    for edge in [[5, 7, 3], window_edge([3, 20, 64])] {
        let windows = Windows::new(&grid, edge, &positions, &tets);
        let mut count = 0;
        for (window, tets_of) in windows.iter() {
            let scanner = Scanner::new(&grid, &window);
            for &t in tets_of {
                let corners = tets[t as usize].map(|v| positions[v as usize]);
                scanner.each_run(corners, |_, run| count += run.len());
            }
        }
        assert_eq!(count as u64, DIMS.iter().product::<u64>());
    }
    assert_eq!(window_edge([3, 20, 64]), [33, 40, 64]);
    assert_eq!(Windows::new(&grid, [32; 3], &[], &[]).iter().count(), 0);
}
