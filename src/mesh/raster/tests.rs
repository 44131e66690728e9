//! Each sample in exactly one tetrahedron; weights that reproduce linear fields; rows and single
//! samples agree.

use super::planes::{Planes, bounds};
use super::*;
use crate::mesh::tet::Tet;
use crate::predicates::signed_volume6;
use crate::simd::Avx2;
use isospan_io::geom::{Lattice, LatticeBox, LatticePos};
use isospan_io::grid::IndexBox;
use proptest::prelude::*;

/// The six tetrahedra of each cell of a grid of planes: many samples lie on faces, edges and
/// corners.
fn kuhn(planes: &[Vec<u32>; 3]) -> Vec<[LatticePos; 4]> {
    let mut tets = vec![];
    let cells = |a: usize| 0..planes[a].len() - 1;
    for z in cells(2) {
        for y in cells(1) {
            for x in cells(0) {
                for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
                    let mut at = [x, y, z];
                    let mut corners = vec![at];
                    for axis in order {
                        at[axis] += 1;
                        corners.push(at);
                    }
                    let pos = |c: [usize; 3]| std::array::from_fn(|a| planes[a][c[a]]);
                    let mut tet: [LatticePos; 4] = std::array::from_fn(|i| pos(corners[i]));
                    if signed_volume6(tet[0], tet[1], tet[2], tet[3]) < 0 {
                        tet.swap(2, 3);
                    }
                    tets.push(tet);
                }
            }
        }
    }
    tets
}

/// How often each sample is visited, and the value of a linear field there.
fn scan_all(
    grid: &SampleGrid,
    tets: &[[LatticePos; 4]],
    f: impl Fn(LatticePos) -> f32,
) -> (Vec<u8>, Vec<f32>) {
    let whole = IndexBox::whole(grid.dims());
    let (mut hits, mut values) = (vec![0; whole.len()], vec![f32::NAN; whole.len()]);
    for &tet in tets {
        each_sample(grid, &whole, tet, |at, w| {
            hits[at] += 1;
            values[at] = interpolate(w, tet.map(&f));
        });
    }
    (hits, values)
}

fn samples(grid: &SampleGrid) -> impl Iterator<Item = LatticePos> + '_ {
    let d = grid.dims();
    let [xs, ys, zs] = grid.axes();
    (0..d[2] as usize).flat_map(move |z| {
        (0..d[1] as usize).flat_map(move |y| {
            (0..d[0] as usize).map(move |x| [xs.position(x), ys.position(y), zs.position(z)])
        })
    })
}

/// Coordinates within 12 voxels of 2^16 steps, most within 3; many on voxels or halfway between.
fn corner() -> impl Strategy<Value = u32> {
    prop_oneof![
        4 => (12u32..=24).prop_map(|n| n << 15),
        4 => (6u32 << 16)..=(9 << 16),
        1 => 0u32..=(12 << 16),
        1 => 0u32..=(24 << 16),
    ]
}

/// Planes at random places, the domain's faces included.
fn cuts(far: u32) -> impl Strategy<Value = Vec<u32>> {
    prop::collection::btree_set(1..far, 0..4)
        .prop_map(move |inner| std::iter::once(0).chain(inner).chain([far]).collect())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn every_sample_is_in_one_tetrahedron_with_its_linear_value(
        dims in prop::array::uniform3(2u64..7),
        n in prop::array::uniform3(1u64..12),
        seed in any::<u32>(),
        planes in (cuts(64), cuts(64), cuts(64)),
    ) {
        let lattice = Lattice::new(dims).unwrap();
        let far = lattice.max();
        // Cuts in 64ths of an axis fall on voxels or between them.
        let scaled = |p: &[u32], a: usize| p.iter().map(|&x| (u64::from(x) * u64::from(far[a]) / 64) as u32).collect();
        let tets = kuhn(&[scaled(&planes.0, 0), scaled(&planes.1, 1), scaled(&planes.2, 2)]);
        let g = [0, 8, 16].map(|s| f64::from((seed >> s) as u8) / 64.0 - 2.0);
        let f = |p: LatticePos| {
            let u: [f64; 3] = std::array::from_fn(|a| f64::from(p[a]) / f64::from(far[a]));
            (g[0] * u[0] + g[1] * u[1] + g[2] * u[2] + 1.0) as f32
        };
        let even = |a: usize| Axis::even(0, far[a], n[a]).unwrap();
        for grid in [SampleGrid::voxels(&lattice), SampleGrid::new(&lattice, [even(0), even(1), even(2)]).unwrap()] {
            let (hits, values) = scan_all(&grid, &tets, f);
            prop_assert!(hits.iter().all(|&h| h == 1), "{hits:?}");
            for (p, v) in samples(&grid).zip(values) {
                prop_assert!((v - f(p)).abs() <= 1e-6, "{v} at {p:?}, not {}", f(p));
            }
        }
    }

    #[test]
    fn rows_samples_and_points_agree_on_any_tetrahedron(
        corners in prop::array::uniform4(prop::array::uniform3(0u32..=40)),
        pitch in 1u32..5,
    ) {
        let [a, b, c, d] = corners;
        let volume = signed_volume6(a, b, c, d);
        prop_assume!(volume != 0);
        let tet = if volume > 0 { corners } else { [a, b, d, c] };
        let lattice = Lattice::new([5, 5, 5]).unwrap();
        let axis = Axis::even(0, 40 / pitch * pitch, u64::from(40 / pitch) + 1).unwrap();
        let grid = SampleGrid::new(&lattice, [axis.clone(), axis.clone(), axis]).unwrap();
        let window = IndexBox { lo: [1, 0, 2], hi: grid.dims() };
        let mut found = vec![];
        each_sample(&grid, &window, tet, |at, w| found.push((at, w)));
        let [xs, ys, zs] = grid.axes();
        let mut wanted = vec![];
        let mut places = vec![];
        for z in window.lo[2]..window.hi[2] {
            for y in window.lo[1]..window.hi[1] {
                for x in window.lo[0]..window.hi[0] {
                    let p = [xs.position(x as usize), ys.position(y as usize), zs.position(z as usize)];
                    places.push((p, places.len() as u32));
                    if let Some(w) = Planes::<i128>::new(tet).weights(p, lattice.max()) {
                        wanted.push((window.offset([x, y, z]), w));
                    }
                }
            }
        }
        prop_assert_eq!(&found, &wanted);
        let locator = PointLocator::new(lattice.domain(), lattice.max(), places.into_iter());
        let mut located = vec![];
        locator.each_in(tet, |n, w| located.push((n as usize, w)));
        located.sort_by_key(|l| l.0);
        prop_assert_eq!(&located, &wanted);
    }

    #[test]
    fn tetrahedra_scanned_together_have_the_samples_of_each(
        corners in prop::collection::vec(prop::array::uniform3(corner()), 4..40),
        picks in prop::collection::vec(prop::array::uniform4(any::<prop::sample::Index>()), 1..300),
        far in any::<bool>(),
        cut in any::<bool>(),
        finer in prop::sample::select(vec![[0u32, 0, 0], [0, 2, 1]]),
    ) {
        // 2^16 steps a voxel, or also 2^15 and 2^14; at the near end of the domain, or at the far
        // one.
        let dims = finer.map(|f| (1 << (8 + finer[1] - f)) + 1);
        let lattice = Lattice::stretched(dims, finer).unwrap();
        assert_eq!((lattice.log2_steps[1], lattice.max()), (16, [1 << 24; 3]));
        let base = if far { lattice.max()[0] - (24 << 16) } else { 0 };
        let positions: Vec<LatticePos> = corners.iter().map(|p| p.map(|c| base + c)).collect();
        let tets: Vec<Tet> = picks.iter().filter_map(|pick| {
            let [a, b, c, d] = pick.map(|i| i.index(positions.len()) as u32);
            let at = |v: u32| positions[v as usize];
            match signed_volume6(at(a), at(b), at(c), at(d)) {
                0 => None,
                v if v > 0 => Some([a, b, c, d]),
                _ => Some([a, b, d, c]),
            }
        }).collect();
        let whole = IndexBox::whole(lattice.dims);
        let window = |less: u64| lattice.log2_steps.map(|s| u64::from(base >> s) + (less << (16 - s)));
        let window = IndexBox { lo: window(3), hi: window(8) };
        let even = Axis::even(0, lattice.max()[0], 400).unwrap();
        let grids = [SampleGrid::voxels(&lattice), SampleGrid::new(&lattice, [even.clone(), even.clone(), even]).unwrap()];
        for grid in grids {
            let window = if cut { window } else { whole }.intersect(&IndexBox::whole(grid.dims()));
            let scanner = Scanner::new(&grid, &window);
            let (mut found, mut wanted) = (vec![], vec![]);
            BatchScan::default().each_member(&scanner, &positions, &tets, |m| found.extend(listed(m)));
            for vectors in [None, Avx2::found()] {
                if scanner.even_shifts().is_some() {
                    let (mut batch, mut same) = (BatchScan::default(), vec![]);
                    batch.each_member_with(vectors, &scanner, &positions, &tets, |m| same.extend(listed(m)));
                    prop_assert_eq!(&found, &same);
                }
            }
            for (t, tet) in (0..).zip(&tets) {
                let corners = tet.map(|v| positions[v as usize]);
                scanner.each_sample(corners, |place, w| wanted.push((t, place, w.map(f64::to_bits))));
            }
            found.sort_unstable();
            prop_assert_eq!(found, wanted);
        }
    }

    #[test]
    fn the_order_of_corners_does_not_show(
        lambda in prop::array::uniform4(1u32..1000), values in prop::array::uniform4(-1e3f32..1e3), turn in 0usize..4,
    ) {
        let sum: u32 = lambda.iter().sum();
        let mut weights = lambda.map(|l| f64::from(l) / f64::from(sum));
        let mut turned = values;
        let before = interpolate(weights, values);
        weights.rotate_left(turn);
        turned.rotate_left(turn);
        weights.swap(0, 1);
        turned.swap(0, 1);
        prop_assert_eq!(before.to_bits(), interpolate(weights, turned).to_bits());
    }
}

/// Tetrahedron, place and bits of the weights of each.
fn listed(members: &Members) -> Vec<(u32, usize, [u64; 4])> {
    let [a, b, c, d] = members.weights();
    let places = members.tets().iter().zip(members.places()).enumerate();
    places.map(|(i, (&tet, &at))| (tet, at as usize, [a[i], b[i], c[i], d[i]].map(f64::to_bits))).collect()
}

#[test]
fn the_longest_tetrahedron_of_the_row_scan_does_not_overflow() {
    let lattice = Lattice::new([33, 33, 33]).unwrap();
    let m = super::planes::LONGEST_64;
    assert!(m >= lattice.of_voxel([2, 2, 2])[0]);
    let tet = [[0, 0, 0], [m, 0, 0], [0, m, 0], [0, 0, m]];
    let grid = SampleGrid::voxels(&lattice);
    let mut found = vec![];
    each_sample(&grid, &IndexBox::whole([33; 3]), tet, |at, w| found.push((at, w)));
    let wanted: Vec<_> = samples(&grid)
        .enumerate()
        .filter_map(|(at, p)| Some((at, Planes::<i128>::new(tet).weights(p, lattice.max())?)))
        .collect();
    assert_eq!(found, wanted);
    assert_eq!(bounds(&tet), ([0; 3], [m; 3]));
}

#[test]
fn no_points_are_found_nowhere() {
    let b = LatticeBox { lo: [5; 3], hi: [5; 3] };
    let locator = PointLocator::new(b, [9; 3], [([5, 5, 5], 0)].into_iter());
    assert!(locator.is_empty());
    locator.each_in([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], |_, _| panic!("there is none"));
}

#[test]
fn axes_count_what_is_below() {
    for (lo, hi, n) in
        [(0, 1 << 24, 7), (5, 100, 96), (5, 100, 200), (3, 3, 1), (0, 9, 1), (1, 1 << 20, 1000)]
    {
        let axis = Axis::even(lo, hi, n).unwrap();
        let positions: Vec<u32> = (0..axis.len()).map(|i| axis.position(i)).collect();
        assert_eq!(positions.len() as u64, n);
        assert!(positions.is_sorted() && positions[0] >= lo && *positions.last().unwrap() <= hi);
        for c in positions.iter().flat_map(|&p| [p.saturating_sub(1), p, p + 1]).chain([0, 1 << 24]) {
            assert_eq!(axis.below(c), positions.partition_point(|&p| p < c), "{c}");
        }
    }
    assert!(
        Axis::even(0, 9, 0).is_err() && Axis::even(9, 0, 2).is_err() && Axis::even(0, 9, 1 << 25).is_err()
    );
}
