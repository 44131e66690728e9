//! The kernel against its invariants, against brute force, and its code paths against each other.

use super::*;
use crate::mesh::check::{Summary, box_volume6, check, ranks};
use crate::predicates::insphere_perturbed;
use proptest::prelude::*;
use std::collections::BTreeSet;

const FULL: u32 = 1 << 24;

struct Lcg(u64);

impl Lcg {
    fn below(&mut self, n: u64) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % n) as u32
    }
    fn pos(&mut self, n: u64) -> LatticePos {
        [self.below(n), self.below(n), self.below(n)]
    }
}

fn radical_inverse(base: u64, mut k: u64) -> u32 {
    let (mut digits, mut scale) = (0u64, 1u64);
    while k > 0 {
        (digits, scale, k) = (digits * base + k % base, scale * base, k / base);
    }
    ((u128::from(digits) << 24) / u128::from(scale)) as u32
}

fn hammersley(n: u64) -> Vec<LatticePos> {
    let x = |k: u64| (((2 * k + 1) << 23) / n) as u32;
    (0..n).map(|k| [x(k), radical_inverse(2, k), radical_inverse(3, k)]).collect()
}

fn random(n: usize, range: u64, seed: u64) -> Vec<LatticePos> {
    let mut r = Lcg(seed);
    (0..n).map(|_| r.pos(range)).collect()
}

fn grid(n: u32, step: u32) -> Vec<LatticePos> {
    (0..n * n * n).map(|i| [i % n, i / n % n, i / n / n].map(|c| c * step)).collect()
}

/// A body-centred cubic lattice.
fn bcc(n: u32, step: u32) -> Vec<LatticePos> {
    let mut all = grid(n, 2 * step);
    all.extend(grid(n - 1, 2 * step).into_iter().map(|p| p.map(|c| c + step)));
    all
}

/// A sparse grid like a hyperbolic cross: points odd/2^t by axis with the levels' sum bounded.
fn cross(levels: u32, base: u32) -> Vec<LatticePos> {
    let mut all = BTreeSet::new();
    for sx in 0..=levels {
        for sy in 0..=levels - sx {
            let t = [sx + base, sy + base, levels - sx - sy + base];
            let n = t.map(|t| (1u32 << t) - 1);
            for i in 0..n[0] * n[1] * n[2] {
                let l = [i % n[0] + 1, i / n[0] % n[1] + 1, i / n[0] / n[1] + 1];
                all.insert(std::array::from_fn::<u32, 3, _>(|k| l[k] << (24 - t[k])));
            }
        }
    }
    all.into_iter().collect()
}

/// Integer points on a sphere of squared radius 2_030_625 = 1425² around the middle of a small
/// cube.
fn sphere() -> Vec<LatticePos> {
    let mut all = vec![];
    for x in -1425i64..=1425 {
        for y in (-1425i64..=1425).step_by(5) {
            let zz = 2_030_625 - x * x - y * y;
            let z = if zz < 0 { continue } else { (zz as f64).sqrt() as i64 };
            if z * z == zz {
                all.push([x, y, z].map(|c| (c + 2000) as u32));
                all.push([x, y, -z].map(|c| (c + 2000) as u32));
            }
        }
    }
    all
}

fn order_of(positions: &[LatticePos]) -> Order {
    Order::for_count(positions.len() as u64)
}

/// Meshes by all paths that this machine has: the same tetrahedra.
fn tets(positions: &[LatticePos]) -> Vec<Tet> {
    let plain = tets_by(Path::Plain, positions);
    let expected = as_set(positions, &plain);
    for path in Path::available() {
        assert!(
            as_set(positions, &tets_by(path, positions)) == expected,
            "{path:?} agrees with the plain path"
        );
    }
    plain
}

fn tets_by(path: Path, positions: &[LatticePos]) -> Vec<Tet> {
    let mut kernel = Kernel { path, ..Kernel::default() };
    kernel.delaunay(positions, &order_of(positions)).unwrap();
    let mut all = vec![];
    kernel.for_each_tet(|t| all.push(t));
    all
}

fn distinct(positions: &[LatticePos]) -> usize {
    positions.iter().collect::<BTreeSet<_>>().len()
}

/// The mesh is sound and every distinct position is a vertex.
fn sound(name: &str, positions: &[LatticePos]) -> Summary {
    let t = tets(positions);
    let summary = check(positions, &t, &order_of(positions)).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert_eq!(summary.vertices, distinct(positions), "{name}: vertices");
    summary
}

/// Every positively oriented quadruple with an empty (perturbed) sphere, by trying all.
fn brute_force(positions: &[LatticePos]) -> BTreeSet<[LatticePos; 4]> {
    let set: BTreeSet<_> = positions.iter().copied().collect();
    let p: Vec<_> = set.into_iter().collect();
    let order = order_of(positions);
    let mut all = BTreeSet::new();
    for i in 0..p.len() {
        for j in 0..i {
            for k in 0..j {
                for l in 0..k {
                    let four = match orient3d(p[i], p[j], p[k], p[l]) {
                        0 => continue,
                        1 => [p[i], p[j], p[k], p[l]],
                        _ => [p[j], p[i], p[k], p[l]],
                    };
                    let empty = p.iter().filter(|q| !four.contains(q)).all(|&q| {
                        let five = [four[0], four[1], four[2], four[3], q];
                        insphere_perturbed(&five, &ranks(&five, &order)) < 0
                    });
                    if empty {
                        all.insert([p[l], p[k], p[j], p[i]]);
                    }
                }
            }
        }
    }
    all
}

fn as_set(positions: &[LatticePos], tets: &[Tet]) -> BTreeSet<[LatticePos; 4]> {
    let set: BTreeSet<_> = tets
        .iter()
        .map(|t| {
            let mut four = t.map(|v| positions[v as usize]);
            four.sort_unstable();
            four
        })
        .collect();
    assert_eq!(set.len(), tets.len(), "a tetrahedron occurs twice");
    set
}

#[test]
fn generic_sets_are_delaunay() {
    sound("random", &random(4000, 1 << 24, 1));
    sound("hammersley", &hammersley(5000));
    sound("tiny cube", &random(3000, 40, 2));
    sound("clustered", &[random(1500, 1 << 24, 3), random(1500, 1 << 10, 4)].concat());
}

#[test]
fn lattices_are_delaunay_and_fill_their_box() {
    for step in [1, 7, 1 << 19] {
        let s = sound("grid", &grid(13, step));
        assert_eq!(s.volume6, box_volume6([0; 3], [12 * step; 3]));
        let s = sound("bcc", &bcc(10, step));
        assert_eq!(s.volume6, box_volume6([0; 3], [18 * step; 3]));
    }
    sound("cross", &cross(5, 2));
    sound("cross", &cross(8, 1));
    let mut mixed = grid(9, 1 << 18);
    mixed.extend(random(800, 1 << 21, 5));
    sound("grid and random", &mixed);
}

#[test]
fn points_on_the_faces_of_a_box_fill_it() {
    let mut r = Lcg(6);
    let mut p: Vec<LatticePos> = (0..8u32).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|b| b * FULL)).collect();
    for i in 0..1200usize {
        let mut q = r.pos(u64::from(FULL) + 1);
        q[i % 3] = FULL * (r.below(2));
        p.push(q);
    }
    p.extend(random(1500, 1 << 24, 7));
    assert_eq!(sound("box", &p).volume6, box_volume6([0; 3], [FULL; 3]));
}

#[test]
fn cospherical_points_are_no_exception() {
    let p = sphere();
    assert!(p.len() > 200);
    sound("sphere", &p);
    let mut with_centre = p;
    with_centre.push([2000; 3]);
    sound("sphere and centre", &with_centre);
}

#[test]
fn a_cavity_of_thousands_of_vertices_is_joined() {
    // Far from a curved front all of it is seen: the last points' cavities hold thousands of
    // facets.
    let mut p: Vec<LatticePos> = vec![];
    for i in 0..60u32 {
        for k in 0..60u32 {
            let (x, y) = (i * 1000, k * 1000);
            let (dx, dy) = (i64::from(x) - 30_000, i64::from(y) - 30_000);
            p.push([x, y, 8_000_000 - ((dx * dx + dy * dy) / 3000) as u32]);
        }
    }
    // The latest position in the order goes in last.
    let order = order_of(&p);
    let far = (0..4000u32).map(|i| [30_000 + i, 30_000, FULL]).max_by(|&a, &b| order.compare(a, b)).unwrap();
    p.push(far);
    sound("front", &p);
}

#[test]
fn sets_without_volume_have_no_tetrahedra() {
    let line: Vec<LatticePos> = (0..50).map(|i| [3 * i, 5 * i, 7 * i]).collect();
    let plane: Vec<LatticePos> = (0..400).map(|i| [i % 20, i / 20, i % 20 + i / 20]).collect();
    for n in 0..5 {
        assert!(tets(&random(n.min(3), 1 << 24, 8)).is_empty());
        assert!(tets(&line[..n]).is_empty());
        assert!(tets(&vec![[5, 5, 5]; n]).is_empty());
    }
    assert!(tets(&line).is_empty() && tets(&plane).is_empty());
    assert_eq!(tets(&random(4, 1 << 24, 9)).len(), 1);
    assert!(matches!(tets(&random(5, 1 << 24, 9)).len(), 2..=4));
}

#[test]
fn one_point_off_a_plane_may_come_last() {
    for seed in 0..20 {
        let mut r = Lcg(seed);
        let mut p: Vec<LatticePos> = (0..60).map(|_| [r.below(9), r.below(9), 4]).collect();
        p.push([r.below(9), r.below(9), 4 + r.below(5) + 1]);
        let t = tets(&p);
        check(&p, &t, &order_of(&p)).unwrap();
        let small = &p[p.len() - 16..];
        assert_eq!(as_set(small, &tets(small)), brute_force(small));
    }
}

#[test]
fn of_duplicates_the_first_stays() {
    let mut p = random(300, 1 << 24, 10);
    let once = tets(&p);
    p.extend_from_within(..);
    let twice = tets(&p);
    assert!(twice.iter().flatten().all(|&v| v < 300));
    assert_eq!(as_set(&p, &once), as_set(&p, &twice));
}

#[test]
fn the_result_is_a_function_of_the_set() {
    for mut p in [grid(8, 3), random(900, 12, 11), hammersley(1500), cross(4, 2)] {
        let before = as_set(&p, &tets(&p));
        p.reverse();
        p.rotate_left(100);
        assert_eq!(before, as_set(&p, &tets(&p)));
    }
}

#[test]
fn bad_input_is_refused() {
    let mut kernel = Kernel::default();
    let off = [[0, 0, FULL + 1], [1, 2, 3]];
    assert!(kernel.delaunay(&off, &Order { bits: 5 }).unwrap_err().to_string().contains("off the lattice"));
    assert!(kernel.delaunay(&off[1..], &Order { bits: 21 }).is_err());
    kernel.for_each_tet(|_| panic!("a refused set has no tetrahedra"));
}

#[test]
fn an_arena_is_reused_without_a_trace() {
    let mut kernel = Kernel::default();
    for p in [hammersley(2000), random(500, 9, 12), vec![[1, 2, 3]], grid(7, 2), hammersley(100)] {
        kernel.delaunay(&p, &order_of(&p)).unwrap();
        let mut all = vec![];
        kernel.for_each_tet(|t| all.push(t));
        assert_eq!(as_set(&p, &all), as_set(&p, &tets(&p)));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn tiny_grids_equal_brute_force(p in prop::collection::vec(prop::array::uniform3(0u32..4), 1..15)) {
        prop_assert_eq!(as_set(&p, &tets(&p)), brute_force(&p));
    }

    #[test]
    fn small_sets_equal_brute_force(p in prop::collection::vec(prop::array::uniform3(0u32..=FULL), 1..15)) {
        prop_assert_eq!(as_set(&p, &tets(&p)), brute_force(&p));
    }

    #[test]
    fn tiny_grids_are_delaunay(p in prop::collection::vec(prop::array::uniform3(0u32..4), 1..70)) {
        let t = tets(&p);
        let summary = check(&p, &t, &order_of(&p));
        prop_assert!(summary.is_ok(), "{:?}", summary);
        if !t.is_empty() {
            prop_assert_eq!(summary.unwrap().vertices, distinct(&p));
        }
    }
}

#[test]
fn a_lattice_is_recognised_wherever_its_origin_is() {
    let points = |positions: &[LatticePos]| -> Vec<Point> {
        let frame = LocalFrame::around(positions);
        positions.iter().map(|p| frame.point(*p)).collect()
    };
    let mut some = bcc(12, 1 << 10);
    // The least coordinates are those of points off the lattice.
    some.iter_mut().flatten().for_each(|c| *c += 1 << 12);
    some.extend(random(some.len() / 2, 1 << 15, 3).into_iter().map(|p| p.map(|c| c + 77)));
    assert!(mostly_coarse(&points(&some)));
    assert!(!mostly_coarse(&points(&random(3000, 1 << 24, 4))));
}
