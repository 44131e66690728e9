//! Constants stay, linear fields stay, errors fall, values stay between samples, nothing leaks from
//! holes; neither order nor windows show.

use super::*;
use isospan_io::geom::Lattice;
use isospan_io::geom::curve::Order;
use isospan_mesh::mesh::mesher::Mesher;
use isospan_mesh::points::{PointSet, PointSpec};
use isospan_mesh::raster::interpolate;
use std::convert::Infallible;

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

/// Adds a window of some steps.
fn add(
    fit: &mut Fit<'_>,
    grid: &SampleGrid,
    window: &IndexBox,
    tets: &[u32],
    steps: &[&dyn Fn([f64; 3]) -> f32],
) {
    fit.add(grid, window, tets, |step, part, out| {
        out.copy_from_slice(&samples(grid, &part, steps[step]));
        Ok::<(), Infallible>(())
    })
    .unwrap();
}

fn fitted(
    grid: &SampleGrid,
    edge: [u64; 3],
    mesh: &FitMesh<'_>,
    values: &[f32],
    f: &dyn Fn([f64; 3]) -> f32,
) -> Vec<f32> {
    fitted_steps(grid, edge, mesh, &[values], &[f]).remove(0)
}

/// The same of some steps together.
fn fitted_steps(
    grid: &SampleGrid,
    edge: [u64; 3],
    mesh: &FitMesh<'_>,
    values: &[&[f32]],
    steps: &[&dyn Fn([f64; 3]) -> f32],
) -> Vec<Vec<f32>> {
    // Some of it fits, some does not.
    let mut memory = vec![u64::MAX; 5 * mesh.positions.len()];
    let room = &mut Room::new(&mut memory);
    let windows = Windows::new(grid, edge, mesh.positions, mesh.tets, room);
    let mut fit = Fit::new(*mesh, values, room);
    for (window, tets) in windows.iter() {
        add(&mut fit, grid, &window, tets, steps);
    }
    fit.values(mesh.positions.len())
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
        let mesh = FitMesh { positions: &positions, tets: &tets };
        for (new, old) in fitted(&grid, [32; 3], &mesh, &values, f).iter().zip(&values) {
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
    let mesh = FitMesh { positions: &positions, tets: &tets };
    let (before, after) =
        (rms(&grid, &mesh, &values, f), rms(&grid, &mesh, &fitted(&grid, [32; 3], &mesh, &values, f), f));
    assert!(after < 0.7 * before, "{after} {before}");
}

#[test]
fn the_order_of_tetrahedra_and_corners_does_not_show() {
    let (grid, positions, tets) = mesh();
    let f: &dyn Fn([f64; 3]) -> f32 = &|p| (40.0 * p[0] * p[1]).sin() as f32 + p[2] as f32;
    let values: Vec<f32> = positions.iter().map(|&p| f(at(&grid, p))).collect();
    let bits = |tets: &[Tet]| -> Vec<u32> {
        let mesh = FitMesh { positions: &positions, tets };
        fitted(&grid, [8, 16, 8], &mesh, &values, f).iter().map(|v| v.to_bits()).collect()
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

/// Steps that differ, in places where some of them have no value.
fn with_holes(step: usize, holes: bool) -> impl Fn([f64; 3]) -> f32 {
    let t = step as f64;
    move |p| {
        let is_hole = (3.0 * p[0] + 2.0 * p[1] + 0.4 * t).sin() > 0.95 || (step == 3 && p[2] < 0.5);
        if holes && is_hole { f32::NAN } else { ((40.0 + t) * p[0] * p[1]).sin() as f32 + (t * p[2]) as f32 }
    }
}

#[test]
fn steps_together_are_what_each_is_alone() {
    let (grid, positions, tets) = mesh();
    let mesh = FitMesh { positions: &positions, tets: &tets };
    for (count, holes) in [(2, false), (3, true), (4, false), (8, true), (13, true), (17, false)] {
        let fields: Vec<_> = (0..count).map(|step| with_holes(step, holes)).collect();
        let values: Vec<Vec<f32>> =
            fields.iter().map(|f| positions.iter().map(|&p| f(at(&grid, p))).collect()).collect();
        let steps: Vec<&dyn Fn([f64; 3]) -> f32> = fields.iter().map(|f| f as _).collect();
        let of_steps: Vec<&[f32]> = values.iter().map(Vec::as_slice).collect();
        let together = fitted_steps(&grid, [8, 16, 8], &mesh, &of_steps, &steps);
        assert_eq!(together.len(), count);
        for (n, found) in together.iter().enumerate() {
            let alone = fitted(&grid, [8, 16, 8], &mesh, of_steps[n], steps[n]);
            assert!(found.iter().zip(&alone).all(|(a, b)| a.to_bits() == b.to_bits()), "step {n} of {count}");
            assert!(found.iter().zip(of_steps[n]).any(|(a, b)| a != b && !b.is_nan()));
        }
        assert_eq!(together.iter().flatten().any(|v| v.is_nan()), holes);
    }
}

#[test]
fn values_stay_between_the_samples_around() {
    let (grid, positions, tets) = mesh();
    let mesh = FitMesh { positions: &positions, tets: &tets };
    let whole = IndexBox::whole(grid.dims());
    for (count, holes) in [(1, false), (1, true), (3, false), (4, true), (8, false), (11, true)] {
        // Steep: an unbounded step leaves the range of the samples.
        let fields: Vec<_> = (0..count)
            .map(|step| {
                let smooth = with_holes(step, holes);
                move |p| (20.0 * smooth(p)).clamp(-9.0, 9.0) + smooth(p)
            })
            .collect();
        let values: Vec<Vec<f32>> =
            fields.iter().map(|f| positions.iter().map(|&p| f(at(&grid, p))).collect()).collect();
        let steps: Vec<&dyn Fn([f64; 3]) -> f32> = fields.iter().map(|f| f as _).collect();
        let of_steps: Vec<&[f32]> = values.iter().map(Vec::as_slice).collect();
        let found = fitted_steps(&grid, [8, 16, 8], &mesh, &of_steps, &steps);
        for (n, values) in values.iter().enumerate() {
            let truth = samples(&grid, &whole, steps[n]);
            let mut bounds: Vec<[f32; 2]> = values.iter().map(|&v| [v, v]).collect();
            let scanner = Scanner::new(&grid, &whole);
            for tet in tets.iter().filter(|tet| tet.iter().all(|&v| !values[v as usize].is_nan())) {
                scanner.each_run(tet.map(|v| positions[v as usize]), |place, run| {
                    for &sample in &truth[place..place + run.len()] {
                        for &v in tet {
                            let [lo, hi] = &mut bounds[v as usize];
                            (*lo, *hi) = (lo.min(sample), hi.max(sample));
                        }
                    }
                });
            }
            let mut at_bound = 0;
            for ((found, [lo, hi]), value) in found[n].iter().zip(&bounds).zip(values) {
                assert_eq!(found.is_nan(), value.is_nan());
                assert!(found.is_nan() || (lo <= found && found <= hi), "{count} {n}: {lo} {found} {hi}");
                at_bound += usize::from(found != value && (found == lo || found == hi));
            }
            assert!(at_bound > 20, "{count} {n}: {at_bound} of {} are bounded", positions.len());
        }
    }
}

#[test]
fn vectors_do_not_show() {
    let (grid, positions, tets) = mesh();
    let mesh = FitMesh { positions: &positions, tets: &tets };
    for count in [1, 4, 7] {
        let fields: Vec<_> = (0..count).map(|step| with_holes(step, true)).collect();
        let values: Vec<Vec<f32>> =
            fields.iter().map(|f| positions.iter().map(|&p| f(at(&grid, p))).collect()).collect();
        let of_steps: Vec<&[f32]> = values.iter().map(Vec::as_slice).collect();
        let [mut plain, mut vectors] = [0, 1].map(|_| Fit::new(mesh, &of_steps, &mut Room::none()));
        for (window, tets) in Windows::new(&grid, [32; 3], &positions, &tets, &mut Room::none()).iter() {
            let samples: Vec<f32> = fields.iter().flat_map(|f| samples(&grid, &window, f)).collect();
            let steps: Vec<&dyn Fn([f64; 3]) -> f32> = fields.iter().map(|f| f as _).collect();
            add(&mut vectors, &grid, &window, tets, &steps);
            plain.scan(&Scanner::new(&grid, &window), window.len(), tets);
            plain.lanes[0].add_plain(&plain.located, &samples, &plain.tets);
        }
        let bits = |fit: &Fit<'_>| fit.lanes[0].bits();
        assert!(bits(&plain) == bits(&vectors));
        assert!(bits(&plain).iter().any(|s| s[0] != 0));
    }
}

#[test]
fn holes_do_not_leak() {
    let (grid, positions, tets) = mesh();
    let hole = |p: [f64; 3]| p[0] > 0.6 && p[2] < 0.4;
    let f: &dyn Fn([f64; 3]) -> f32 = &|p| if hole(p) { f32::NAN } else { 7.5 };
    let values: Vec<f32> = positions.iter().map(|&p| f(at(&grid, p))).collect();
    let mesh = FitMesh { positions: &positions, tets: &tets };
    let found = fitted(&grid, [32; 3], &mesh, &values, f);
    assert!(found.iter().any(|v| v.is_nan()));
    assert!(found.iter().zip(&values).all(|(a, b)| a.to_bits() == b.to_bits()));
}

#[test]
fn windows_hold_each_sample_of_each_tetrahedron_once() {
    let (grid, positions, tets) = mesh();
    for edge in [[5, 7, 3], window_edge([3.0, 20.0, 64.0])] {
        let windows = Windows::new(&grid, edge, &positions, &tets, &mut Room::none());
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
    assert_eq!(window_edge([3.0, 20.0, 64.0]), [33, 40, 64]);
    assert_eq!(Windows::new(&grid, [32; 3], &[], &[], &mut Room::none()).iter().count(), 0);
}
