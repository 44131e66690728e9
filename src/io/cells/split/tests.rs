use super::super::quadratic::{at_middle, with_middles};
use super::*;
use std::collections::{BTreeMap, BTreeSet};

/// Corners, then middles, of a cell of each kind, slightly sheared.
pub(crate) fn positions(kind: CellKind) -> Vec<[f64; 3]> {
    let corners: &[[f64; 3]] = match kind.shape().corners {
        4 => &[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]],
        5 => &[[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.], [0.5, 0.5, 1.]],
        6 => &[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.], [1., 0., 1.], [0., 1., 1.]],
        _ => &[
            [0., 0., 0.],
            [1., 0., 0.],
            [1., 1., 0.],
            [0., 1., 0.],
            [0., 0., 1.],
            [1., 0., 1.],
            [1., 1., 1.],
            [0., 1., 1.],
        ],
    };
    if kind == CellKind::Voxel {
        return (0..8).map(|i| [0, 1, 2].map(|a| f64::from(i >> a & 1))).collect();
    }
    let mean = |of: &[u8]| -> [f64; 3] {
        std::array::from_fn(|a| of.iter().map(|&i| corners[usize::from(i)][a]).sum::<f64>() / of.len() as f64)
    };
    let mut out = corners.to_vec();
    if kind.vertices() > corners.len() {
        out.extend(kind.shape().edges.iter().map(|e| mean(e)));
    }
    let faces: &[&[u8]] = match kind {
        CellKind::TriquadraticHexahedron => {
            &[&[0, 3, 4, 7], &[1, 2, 5, 6], &[0, 1, 4, 5], &[2, 3, 6, 7], &[0, 1, 2, 3], &[4, 5, 6, 7]]
        }
        CellKind::BiquadraticWedge => &[&[0, 1, 3, 4], &[1, 2, 4, 5], &[2, 0, 5, 3]],
        CellKind::BiquadraticPyramid => &[&[0, 1, 2, 3]],
        _ => &[],
    };
    out.extend(faces.iter().map(|f| mean(f)));
    if kind == CellKind::TriquadraticHexahedron {
        out.push([0.5; 3]);
    }
    out
}

fn six_volumes(p: [[f64; 3]; 4]) -> f64 {
    let d = |i: usize, a: usize| p[i][a] - p[0][a];
    (0..3)
        .map(|a| {
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            d(1, a) * (d(2, b) * d(3, c) - d(2, c) * d(3, b))
        })
        .sum()
}

/// Different numbers in an order that depends on the seed.
fn numbers(n: usize, seed: u64) -> Vec<u64> {
    let key = |i: usize| {
        (i as u64 + 1).wrapping_mul(seed.wrapping_mul(2) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 20
    };
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by_key(|&i| key(i));
    let mut out = vec![0; n];
    for (rank, i) in order.into_iter().enumerate() {
        out[i] = 10 * rank as u64 + 3;
    }
    out
}

/// Triangles that belong to one tetrahedron only, without their direction.
fn boundary(tets: &[CellTet]) -> BTreeSet<[u64; 3]> {
    let mut count: BTreeMap<[u64; 3], u32> = BTreeMap::new();
    for t in tets {
        for skip in 0..4 {
            let mut face: Vec<u64> = (0..4).filter(|&i| i != skip).map(|i| t[i]).collect();
            face.sort_unstable();
            *count.entry([face[0], face[1], face[2]]).or_default() += 1;
        }
    }
    assert!(count.values().all(|&n| n <= 2));
    count.into_iter().filter(|(_, n)| *n == 1).map(|(face, _)| face).collect()
}

#[test]
fn tetrahedra_fill_every_kind_of_cell_whatever_the_numbers() {
    for kind in CellKind::SOLID.into_iter().filter(|kind| kind.middles().is_none()) {
        let positions = positions(kind);
        assert_eq!(positions.len(), kind.vertices());
        let expected = [1.0, 2.0, 3.0, 6.0][match kind.shape().corners {
            4 => 0,
            5 => 1,
            6 => 2,
            _ => 3,
        }];
        for seed in 0..50 {
            let (numbers, mut tets) = (numbers(positions.len(), seed), vec![]);
            assert_eq!(split(kind, &numbers, &mut tets), 0);
            assert!(tets.len() <= MOST_TETS);
            let place = |v: u64| positions[numbers.iter().position(|&n| n == v).unwrap()];
            let volumes: Vec<f64> = tets.iter().map(|t| six_volumes(t.map(place))).collect();
            assert!(volumes.iter().all(|&v| v > 1e-9), "{kind:?} {seed}: {volumes:?}");
            assert!((volumes.iter().sum::<f64>() - expected).abs() < 1e-12, "{kind:?} {seed}");
            let used: BTreeSet<u64> = tets.iter().flatten().copied().collect();
            assert_eq!(used.len(), positions.len(), "every vertex is used");
            boundary(&tets);
        }
    }
}

/// The triangles on a face of a cell depend on the numbers of the face's vertices alone.
#[test]
fn neighbours_agree_on_faces() {
    for kind in CellKind::SOLID.into_iter().filter(|kind| kind.middles().is_none()) {
        let positions = positions(kind);
        for axis_plane in [(0, 0.0), (1, 0.0), (2, 0.0), (2, 1.0)] {
            let on = |i: usize| positions[i][axis_plane.0] == axis_plane.1;
            for seed in 0..20 {
                let first = numbers(positions.len(), seed);
                // Other numbers off the face: some below, some above those on it.
                let other: Vec<u64> = (0..positions.len())
                    .map(|i| if on(i) { first[i] } else { (first[i] * 7 + seed) % 500 * 10 + 1 })
                    .collect();
                if other.iter().collect::<BTreeSet<_>>().len() < other.len() {
                    continue;
                }
                let face = |numbers: &[u64]| {
                    let mut tets = vec![];
                    split(kind, numbers, &mut tets);
                    let here: BTreeSet<u64> =
                        (0..numbers.len()).filter(|&i| on(i)).map(|i| numbers[i]).collect();
                    let within = |t: &[u64; 3]| t.iter().all(|v| here.contains(v));
                    boundary(&tets).into_iter().filter(within).collect::<Vec<_>>()
                };
                assert_eq!(face(&first), face(&other), "{kind:?} {axis_plane:?} {seed}");
            }
        }
    }
}

#[test]
fn collapsed_cells_lose_their_flat_tetrahedra() {
    // A hexahedron with two pairs of vertices joined is a wedge.
    let mut tets = vec![];
    let dropped = split(CellKind::Hexahedron, &[5, 1, 2, 2, 7, 3, 4, 4], &mut tets);
    assert_eq!((tets.len(), dropped), (3, 3));
    assert_eq!(split(CellKind::Tetrahedron, &[1, 2, 3, 1], &mut tets), 1);
    assert_eq!(split(CellKind::Flat, &[], &mut tets), 0);
    assert_eq!(tets.len(), 3);
}

/// Cells that lack vertices have the places of those that do not, which are means of corners.
#[test]
fn middles_are_where_whole_cells_have_them() {
    for (kind, middles) in CellKind::SOLID.into_iter().filter_map(|kind| Some((kind, kind.middles()?))) {
        let (places, expected) = (positions(kind), positions(middles.kind));
        let numbers: Vec<u64> = (0..places.len() as u64).collect();
        let (whole, all, added) = with_middles(kind, &numbers, |v| places[v as usize]);
        assert_eq!((whole, all.len()), (middles.kind, middles.kind.vertices()));
        let near = |a: &[f64; 3], b: &[f64; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 1e-12);
        assert!(added.iter().zip(&expected[places.len()..]).all(|(a, b)| near(a, b)), "{kind:?}");
        // A quadratic field comes back where it has no term that edges do not show.
        let field = |p: &[f64; 3]| p[0] * p[0] - p[1] * p[1] + p[0] * p[2] + 3.0 * p[1];
        for ((around, corners), place) in middles.around(&numbers).zip(&added) {
            let values: Vec<f64> = around.iter().map(|&v| field(&places[v as usize])).collect();
            let (corners, others) = values.split_at(corners);
            let found = at_middle(corners.iter().copied(), others.iter().copied());
            assert!((found - field(place)).abs() < 1e-12, "{kind:?}");
        }
    }
}
