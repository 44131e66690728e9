use super::*;
use proptest::prelude::*;

/// A cube of n³ cells of six tetrahedra each, its inner vertices moved a little, in fine steps.
fn cube(n: u32, edge: u32, jitter: i64) -> CellBatch {
    let m = n + 1;
    let vertex = |x: u32, y: u32, z: u32| (z * m + y) * m + x;
    let mut batch = CellBatch::default();
    let mut state = 1u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as i64
    };
    for z in 0..m {
        for y in 0..m {
            for x in 0..m {
                let p = fine([x * edge, y * edge, z * edge]);
                let inner = [x, y, z].iter().all(|&c| c > 0 && c < n);
                let mut off = || if inner && jitter > 0 { random() % (2 * jitter + 1) - jitter } else { 0 };
                batch.positions.push([p[0] + off(), p[1] + off(), p[2] + off()]);
            }
        }
    }
    // Kuhn's six tetrahedra: the paths from corner 000 to corner 111.
    const PATHS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    for z in 0..n {
        for y in 0..n {
            for x in 0..n {
                for path in PATHS {
                    let mut at = [x, y, z];
                    let mut tet = [vertex(x, y, z); 4];
                    for (i, axis) in path.into_iter().enumerate() {
                        at[axis] += 1;
                        tet[i + 1] = vertex(at[0], at[1], at[2]);
                    }
                    let corners = tet.map(|v| batch.positions[v as usize]);
                    if !is_positive(corners) {
                        tet.swap(2, 3);
                    }
                    batch.corners.push(tet);
                    batch.ids.push(batch.ids.len() as u64);
                }
            }
        }
    }
    batch
}

fn by_grid(cells: &CellBatch, points: &[LatticePos]) -> Vec<CellHit> {
    let mut found = vec![CellHit::default(); points.len()];
    PointGrid::new(&points.iter().map(|&p| fine(p)).collect::<Vec<_>>()).locate(cells, &mut found);
    found
}

fn by_tree(cells: &CellBatch, points: &[LatticePos]) -> Vec<CellHit> {
    let mut found = vec![CellHit::default(); points.len()];
    KdTree::new(cells).locate(&points.iter().map(|&p| fine(p)).collect::<Vec<_>>(), &mut found);
    found
}

fn by_all(cells: &CellBatch, points: &[LatticePos]) -> Vec<CellHit> {
    let mut found = vec![CellHit::default(); points.len()];
    for (p, found) in points.iter().zip(&mut found) {
        for cell in 0..cells.ids.len() {
            if let Some(w) = weights(cells.corners_of(cell), fine(*p)) {
                keep(found, cells.ids[cell], cell, w);
            }
        }
    }
    found
}

#[test]
fn every_point_of_the_domain_is_found_and_none_beyond() {
    let cells = cube(4, 1000, 200 << FINE_BITS);
    let inside: Vec<LatticePos> =
        (0..2000u32).map(|i| [i * 7919 % 4001, i * 104_729 % 4001, i * 1301 % 4001]).collect();
    assert!(by_grid(&cells, &inside).iter().all(|f| f.id != CellHit::NOWHERE));
    let beyond = [[4001, 5, 5], [5, 5, 4001], [90_000, 90_000, 90_000]];
    assert!(by_grid(&cells, &beyond).iter().all(|f| f.id == CellHit::NOWHERE));
}

#[test]
fn a_point_on_a_face_edge_or_vertex_is_in_the_tetrahedron_of_the_lowest_id() {
    let cells = cube(2, 64, 0);
    let mut points = vec![];
    for x in (0..=128).step_by(16) {
        for y in (0..=128).step_by(16) {
            for z in (0..=128).step_by(16) {
                points.push([x, y, z]);
            }
        }
    }
    let expected = by_all(&cells, &points);
    assert_eq!(by_grid(&cells, &points), expected);
    assert_eq!(by_tree(&cells, &points), expected);
    // Another order of cells: the same answers but for the numbers in the batch.
    let mut turned = cells.clone();
    turned.corners.reverse();
    turned.ids.reverse();
    let ids = |found: &[CellHit]| found.iter().map(|f| f.id).collect::<Vec<_>>();
    assert_eq!(ids(&by_grid(&turned, &points)), ids(&expected));
}

#[test]
fn a_zero_weight_is_zero() {
    let tet = [fine([0; 3]), fine([8, 0, 0]), fine([0, 8, 0]), fine([0, 0, 8])];
    assert_eq!(weights(tet, fine([2, 2, 0])), Some([0.5, 0.25, 0.25, 0.0]));
    assert_eq!(weights(tet, fine([0, 0, 8])), Some([0.0, 0.0, 0.0, 1.0]));
    // A fine step outside the slanted face, at coordinates where the margin cannot decide.
    let far = 1 << 24;
    let tet = [fine([0; 3]), fine([far, 0, 0]), fine([0, far, 0]), fine([0, 0, far])];
    let on = [fine([far / 2, far / 4, far / 4])[0], fine([0, far / 4, 0])[1], fine([0, 0, far / 4])[2]];
    assert!(weights(tet, on).is_some_and(|w| w[0] == 0.0));
    assert_eq!(weights(tet, [on[0] + 1, on[1], on[2]]), None);
    assert!(weights(tet, [on[0] - 1, on[1], on[2]]).is_some_and(|w| w[0] > 0.0));
}

#[test]
fn nothing_to_locate_and_nothing_to_locate_in() {
    assert!(by_grid(&cube(1, 4, 0), &[]).is_empty());
    assert_eq!(by_grid(&CellBatch::default(), &[[1; 3]]), [CellHit::default()]);
    assert_eq!(by_tree(&CellBatch::default(), &[[1; 3]]), [CellHit::default()]);
    let one = [[3, 3, 3]; 5];
    assert!(by_grid(&cube(1, 4, 0), &one).iter().all(|f| f.id != CellHit::NOWHERE), "equal points");
}

/// The error of an interpolation of x² + yz at points of the cube refined `level` times.
fn error(level: u32, how: impl Fn(&[f64; 4], &[Corner; 4]) -> f64) -> f64 {
    let n = 1 << level;
    let cells = cube(n, 4096 >> level, 0);
    let points: Vec<LatticePos> =
        (0..500u32).map(|i| [i * 7919 % 4097, i * 104_729 % 4097, i * 1301 % 4097]).collect();
    let unit = |p: FinePos| p.map(|c| c as f64 / f64::from(4096u32 << FINE_BITS));
    let value = |p: [f64; 3]| p[0] * p[0] + p[1] * p[2];
    let gradient = |p: [f64; 3]| [2.0 * p[0], p[2], p[1]];
    let found = by_grid(&cells, &points);
    points.iter().zip(&found).fold(0.0f64, |worst, (p, found)| {
        let corners = cells.corners_of(found.cell as usize).map(unit);
        let corners = corners.map(|p| Corner { position: p, value: value(p), gradient: gradient(p) });
        worst.max((how(&found.weights, &corners) - value(unit(fine(*p)))).abs())
    })
}

#[test]
fn orders_of_convergence() {
    let of_linear = |level| error(level, |w, c| linear(w, &c.map(|c| c.value)));
    let (coarse, fine) = (of_linear(1), of_linear(3));
    let order = (coarse / fine).log2() / 2.0;
    assert!((1.8..2.2).contains(&order), "linear: {coarse} {fine}");
    assert!(error(1, quadratic) < 1e-12, "a quadratic field with its gradients is met exactly");
    let thesis = error(2, |w, c| quadratic_thesis(w, &c.map(|c| c.value)));
    assert!((thesis - of_linear(2)).abs() < 1e-12, "the thesis's quadratic is linear");
}

#[test]
fn a_void_corner_counts_only_with_a_weight() {
    let values = [1.0, 2.0, 3.0, f64::NAN];
    assert_eq!(linear(&[0.25, 0.25, 0.5, 0.0], &values), 2.25);
    assert!(linear(&[0.25, 0.25, 0.25, 0.25], &values).is_nan());
    assert_eq!(quadratic_thesis(&[0.25, 0.25, 0.5, 0.0], &values), 2.25);
    assert!(quadratic_thesis(&[0.25, 0.25, 0.25, 0.25], &values).is_nan());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn grid_and_tree_agree_with_trying_all(
        n in 1u32..5,
        jitter in 0i64..100 << FINE_BITS,
        points in prop::collection::vec([0u32..2100, 0u32..2100, 0u32..2100], 0..200),
    ) {
        let cells = cube(n, 2000 / n, jitter);
        let expected = by_all(&cells, &points);
        prop_assert_eq!(&by_grid(&cells, &points), &expected);
        prop_assert_eq!(&by_tree(&cells, &points), &expected);
    }

    #[test]
    fn linear_fields_are_exact(point in [0u32..=3000, 0u32..=3000, 0u32..=3000]) {
        let cells = cube(3, 1000, 150 << FINE_BITS);
        let found = by_grid(&cells, &[point])[0];
        let field = |p: FinePos| 3.0 * p[0] as f64 - 2.0 * p[1] as f64 + 0.5 * p[2] as f64 + 7.0;
        let values = cells.corners_of(found.cell as usize).map(field);
        let expected = field(fine(point));
        prop_assert!((linear(&found.weights, &values) - expected).abs() <= 1e-12 * (expected.abs() + 1e9));
    }
}
