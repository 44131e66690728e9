//! k chunks are one chunk, as sets of four positions, for any cut and however degenerate the
//! points.

use super::*;
use crate::mesh::check;
use crate::mesh::tet::Tet;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

const FULL: u32 = 1 << 24;

struct Lcg(u64);

impl Lcg {
    fn below(&mut self, n: u64) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % n) as u32
    }
}

/// Random points in a box with corners, edges and faces, as a reduction has them.
fn with_boundary(n: usize, max: LatticePos, seed: u64) -> Vec<LatticePos> {
    let mut r = Lcg(seed);
    let mut all: BTreeSet<LatticePos> =
        (0..8u32).map(|i| std::array::from_fn(|k| (i >> k & 1) * max[k])).collect();
    for i in 0..n {
        let mut p: LatticePos = max.map(|m| r.below(u64::from(m) + 1));
        // One in five on a face, a few on an edge.
        for k in [[3, 4, 5][i % 3], i % 5, i % 17] {
            if k < 3 {
                p[k] = r.below(2) * max[k];
            }
        }
        all.insert(p);
    }
    all.into_iter().collect()
}

fn grid(n: u32, step: u32) -> Vec<LatticePos> {
    (0..n * n * n).map(|i| [i % n, i / n % n, i / n / n].map(|c| c * step)).collect()
}

fn domain_of(max: LatticePos) -> LatticeBox {
    LatticeBox { lo: [0; 3], hi: max.map(|m| m + 1) }
}

/// Cores that tile the domain, `cuts` along each axis.
fn cores(domain: &LatticeBox, cuts: [u32; 3]) -> Vec<LatticeBox> {
    let edge = |k: usize, i: u32| (u64::from(domain.hi[k]) * u64::from(i) / u64::from(cuts[k])) as u32;
    (0..cuts[0] * cuts[1] * cuts[2])
        .map(|i| {
            let c = [i % cuts[0], i / cuts[0] % cuts[1], i / cuts[0] / cuts[1]];
            LatticeBox {
                lo: std::array::from_fn(|k| edge(k, c[k])),
                hi: std::array::from_fn(|k| edge(k, c[k] + 1)),
            }
        })
        .collect()
}

/// A meshed chunk in terms of the whole set.
struct Part {
    tets: Vec<[LatticePos; 4]>,
    edges: BTreeSet<[LatticePos; 2]>,
    unshared: BTreeSet<LatticePos>,
}

/// Meshes a chunk, its halo at first so wide; counts how often it was widened.
fn chunk(all: &[LatticePos], domain: LatticeBox, core: LatticeBox, halo: u32, retries: &mut u32) -> Part {
    let (mesh, local) = widening(all, domain, core, halo, false, retries);
    part(&local, &mesh)
}

fn widening(
    all: &[LatticePos],
    domain: LatticeBox,
    core: LatticeBox,
    mut halo: u32,
    stars: bool,
    retries: &mut u32,
) -> (ChunkMesh, Vec<LatticePos>) {
    let order = Order::for_count(all.len() as u64);
    let region = core.grow_within([halo; 3], &domain);
    let near = core.grow_within([halo / 3; 3], &domain);
    let mut local: Vec<LatticePos> = all.iter().copied().filter(|p| region.contains(*p)).collect();
    local.sort_by_key(|p| !near.contains(*p));
    let boxes = ChunkRegion { core, near, region, domain };
    let mut widen = |positions: &mut Vec<LatticePos>| {
        let narrow = core.grow_within([halo; 3], &domain);
        assert!(narrow != domain);
        *retries += 1;
        halo = halo * 3 / 2 + 1;
        let wide = core.grow_within([halo; 3], &domain);
        positions.extend(all.iter().filter(|p| wide.contains(**p) && !narrow.contains(**p)));
        Ok(Some(wide))
    };
    match mesh_widening(
        &mut Mesher::new(),
        &boxes,
        &mut local,
        &order,
        Manner { around: stars, even: false },
        &mut widen,
    )
    .unwrap()
    {
        ChunkOutcome::Done(mesh) => (mesh, local),
        ChunkOutcome::WidenHalo { .. } => unreachable!("there is always a wider halo"),
    }
}

/// The tetrahedra around a chunk's own, by the rule and as they come out.
fn stars(
    all: &[LatticePos],
    domain: LatticeBox,
    core: LatticeBox,
    halo: u32,
) -> [BTreeSet<[LatticePos; 4]>; 2] {
    let order = Order::for_count(all.len() as u64);
    let mut mesher = Mesher::new();
    mesher.delaunay(all, &order).unwrap();
    let four = |t: &Tet, of: &[LatticePos]| {
        let mut four = t.map(|v| of[v as usize]);
        four.sort_unstable();
        four
    };
    let mut whole: Vec<[LatticePos; 4]> = vec![];
    mesher.for_each_tet(|t| whole.push(four(&t, all)));
    let used: BTreeSet<LatticePos> =
        whole.iter().filter(|t| core.contains(t[0])).flatten().copied().collect();
    let wanted =
        whole.into_iter().filter(|t| !core.contains(t[0]) && t.iter().any(|p| used.contains(p))).collect();
    let (mesh, local) = widening(all, domain, core, halo, true, &mut 0);
    let found: Vec<_> = mesh.tets.around().iter().map(|t| four(t, &local)).collect();
    let set: BTreeSet<_> = found.iter().copied().collect();
    assert_eq!(set.len(), found.len(), "each once");
    [wanted, set]
}

#[test]
fn all_tetrahedra_at_the_vertices_of_owned_ones_are_known() {
    let max = [1 << 20; 3];
    let domain = domain_of(max);
    for cuts in [[2, 2, 2], [3, 1, 2], [1, 1, 1]] {
        // Scattered, and all cospherical.
        let mut state = 7u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % (1 << 20)) as u32
        };
        let scattered: Vec<LatticePos> = (0..1500).map(|_| [next(), next(), next()]).collect();
        let grid: Vec<LatticePos> =
            (0..1000u32).map(|i| [i % 10, i / 10 % 10, i / 100].map(|c| c * 100_000)).collect();
        for all in [scattered, grid] {
            for core in cores(&domain, cuts) {
                for halo in [50_000, 300_000] {
                    let [wanted, found] = stars(&all, domain, core, halo);
                    assert_eq!(wanted.is_empty(), cuts == [1, 1, 1]);
                    assert!(wanted == found, "{} and {}", wanted.len(), found.len());
                }
            }
        }
    }
}

fn part(local: &[LatticePos], mesh: &ChunkMesh) -> Part {
    let mut out = Part { tets: vec![], edges: BTreeSet::new(), unshared: BTreeSet::new() };
    for pair in mesh.tets.windows(2) {
        assert!(pair[0][0] <= pair[1][0], "sorted by the first");
    }
    for t in mesh.tets.iter() {
        assert!(t[0] < t[1] && t[0] < t[2] && t[0] < t[3]);
        let at = t.map(|v| local[v as usize]);
        assert!(crate::predicates::orient3d(at[0], at[1], at[2], at[3]) > 0);
        let mut four = at;
        four.sort_unstable();
        out.tets.push(four);
        for i in 0..4 {
            out.edges.extend((0..i).map(|j| [four[j], four[i]]));
        }
    }
    assert_eq!(mesh.shared.len(), local.len());
    out.unshared.extend(local.iter().zip(&mesh.shared).filter(|(_, s)| !**s).map(|(p, _)| *p));
    out
}

/// Meshes in chunks, compares with the whole; returns (halo widenings, unshared vertices).
fn same(name: &str, all: &[LatticePos], max: LatticePos, cuts: [u32; 3], halo: u32) -> (u32, usize) {
    let domain = domain_of(max);
    let mut retries = 0;
    let whole = chunk(all, domain, domain, 0, &mut retries);
    assert_eq!(retries, 0, "{name}: a region equal to the domain is certified");
    let expected: BTreeSet<_> = whole.tets.iter().copied().collect();
    let mut union = BTreeSet::new();
    let mut owners: BTreeMap<[LatticePos; 2], u32> = BTreeMap::new();
    let mut parts = vec![];
    for core in cores(&domain, cuts) {
        let part = chunk(all, domain, core, halo, &mut retries);
        for t in &part.tets {
            assert!(core.contains(t[0]), "{name}: owned by its least vertex");
            assert!(union.insert(*t), "{name}: {t:?} occurs twice");
        }
        part.edges.iter().for_each(|e| *owners.entry(*e).or_default() += 1);
        parts.push(part);
    }
    assert!(union == expected, "{name}: {} tetrahedra in chunks, {} in one", union.len(), expected.len());
    for part in &parts {
        for e in &part.edges {
            let unshared = e.iter().any(|p| part.unshared.contains(p));
            assert!(!unshared || owners[e] == 1, "{name}: edge {e:?} has an unshared vertex and two chunks");
        }
    }
    (retries, parts.iter().map(|p| p.unshared.len()).sum())
}

#[test]
fn random_points_with_a_boundary() {
    let max = [FULL; 3];
    let all = with_boundary(2500, max, 1);
    let spacing = (f64::from(FULL) / (all.len() as f64).cbrt()) as u32;
    for (cuts, halo) in [([2, 2, 2], 3 * spacing), ([3, 1, 2], 2 * spacing), ([1, 1, 5], 3 * spacing)] {
        let (retries, unshared) = same("random", &all, max, cuts, halo);
        assert!(retries < 60 && unshared > 50, "{cuts:?}: {retries} retries, {unshared} unshared");
    }
    // A halo that is too narrow is noticed.
    assert!(same("narrow", &all, max, [2, 2, 1], spacing / 3).0 > 0);
}

#[test]
fn a_flat_domain() {
    let max = [FULL, FULL / 4, FULL / 16];
    let all = with_boundary(2000, max, 2);
    same("flat", &all, max, [4, 2, 1], FULL / 10);
}

#[test]
fn regular_and_dyadic_grids() {
    let all = grid(11, 100);
    for cuts in [[2, 2, 2], [3, 2, 1], [10, 1, 1]] {
        same("grid", &all, [1000; 3], cuts, 250);
    }
    let mut centred = grid(8, 128);
    centred.extend(grid(7, 128).into_iter().map(|p| p.map(|c| c + 64)));
    same("bcc", &centred, [7 * 128; 3], [2, 2, 2], 200);
    let mut sparse: BTreeSet<LatticePos> = grid(2, 1024).into_iter().collect();
    for (a, b, c) in [(64, 64, 512), (64, 512, 64), (512, 64, 64), (128, 128, 256), (256, 128, 128)] {
        for x in (0..=1024).step_by(a) {
            for y in (0..=1024).step_by(b) {
                sparse.extend((0..=1024).step_by(c).map(|z| [x, y, z]));
            }
        }
    }
    let sparse: Vec<_> = sparse.into_iter().collect();
    same("dyadic", &sparse, [1024; 3], [2, 2, 2], 300);
}

#[test]
fn points_whose_hull_is_not_the_box_and_points_without_volume() {
    let mut r = Lcg(5);
    let ball: Vec<LatticePos> = (0..3000)
        .map(|_| [r.below(4000), r.below(4000), r.below(4000)])
        .filter(|p| p.iter().map(|&c| (i64::from(c) - 2000).pow(2)).sum::<i64>() < 4_000_000)
        .collect::<BTreeSet<_>>()
        .into_iter()
        .collect();
    same("ball", &ball, [4000; 3], [2, 2, 1], 1200);
    let plane: Vec<LatticePos> = (0..200).map(|i| [i % 20, i / 20, 7]).collect();
    same("plane", &plane, [20; 3], [2, 2, 1], 5);
    same("nothing", &[], [20; 3], [2, 1, 1], 5);
}

#[test]
fn the_sum_of_the_chunks_fills_the_box() {
    let max = [1 << 20, 1 << 19, 1 << 20];
    let all = with_boundary(1200, max, 9);
    let domain = domain_of(max);
    let mut volume = 0;
    for core in cores(&domain, [2, 1, 2]) {
        let part = chunk(&all, domain, core, 1 << 18, &mut 0);
        volume += part
            .tets
            .iter()
            .map(|t| crate::predicates::signed_volume6(t[0], t[1], t[2], t[3]).abs())
            .sum::<i128>();
    }
    assert_eq!(volume, check::box_volume6([0; 3], max));
}

#[test]
fn bad_boxes_and_stray_positions_are_refused() {
    let b = |hi: u32| LatticeBox { lo: [0; 3], hi: [hi; 3] };
    let order = Order { bits: 4 };
    let mut mesher = Mesher::new();
    let bad = ChunkRegion { core: b(9), near: b(8), region: b(8), domain: b(10) };
    assert!(mesh_chunk(&mut mesher, &bad, &[], &order).is_err());
    let good = ChunkRegion { core: b(5), near: b(6), region: b(8), domain: b(10) };
    let stray = mesh_chunk(&mut mesher, &good, &[[1, 1, 9]], &order).unwrap_err();
    assert!(stray.to_string().contains("outside its chunk's region"));
    let late = mesh_chunk(&mut mesher, &good, &[[1, 1, 7], [1, 1, 5]], &order).unwrap_err();
    assert!(late.to_string().contains("must come before"));
}

#[test]
fn where_no_wider_halo_is_given_the_answer_says_so() {
    let all = with_boundary(600, [FULL; 3], 4);
    let domain = domain_of([FULL; 3]);
    let core = cores(&domain, [2, 2, 2])[0];
    let boxes = ChunkRegion { core, near: core, region: core, domain };
    let local: Vec<LatticePos> = all.iter().copied().filter(|p| core.contains(*p)).collect();
    let order = Order::for_count(all.len() as u64);
    let outcome = mesh_chunk(&mut Mesher::new(), &boxes, &local, &order).unwrap();
    assert!(matches!(outcome, ChunkOutcome::WidenHalo { uncertified } if uncertified > 0));
    // Nor may one be no wider, or come with positions that are known.
    let wrong = |region: LatticeBox, more: &[LatticePos]| {
        let mut widen = |positions: &mut Vec<LatticePos>| {
            positions.extend_from_slice(more);
            Ok(Some(region))
        };
        let mut mesher = Mesher::new();
        mesh_widening(&mut mesher, &boxes, &mut local.clone(), &order, Manner::default(), &mut widen)
            .unwrap_err()
            .to_string()
    };
    assert!(wrong(core, &[]).contains("is not widened"));
    assert!(wrong(domain, &local[..1]).contains("lies outside what"));
}

#[test]
fn of_equal_positions_the_first_is_the_vertex_wherever_it_is_asked_for() {
    let all = with_boundary(1500, [FULL; 3], 6);
    let domain = domain_of([FULL; 3]);
    let core = cores(&domain, [2, 2, 2])[0];
    let twice: Vec<LatticePos> = all.iter().flat_map(|&p| [p; 2]).collect();
    let mut widened = 0;
    let (mesh, local) = widening(&twice, domain, core, FULL / 60, false, &mut widened);
    let mut first = BTreeMap::new();
    (0u32..).zip(&local).for_each(|(i, &p)| _ = first.entry(p).or_insert(i));
    assert!(widened > 0 && mesh.tets.iter().flatten().all(|&v| first[&local[v as usize]] == v));
    assert_eq!(mesh.tets.len(), chunk(&all, domain, core, FULL, &mut 0).tets.len());
}

#[test]
fn positions_that_come_later_need_not_fit_the_coordinates_of_the_first() {
    // Inside all are multiples of 2^10; below and between lie others.
    let mut all: BTreeSet<LatticePos> =
        grid(17, 1 << 10).into_iter().map(|p| p.map(|c| c + (1 << 15))).collect();
    let mut r = Lcg(3);
    all.extend(
        (0..2000)
            .map(|_| [r.below(1 << 16), r.below(1 << 16), r.below(1 << 16)])
            .filter(|p| p.iter().any(|&c| !((1 << 15) - 900..(1 << 15) + (17 << 10)).contains(&c))),
    );
    let all: Vec<LatticePos> = all.into_iter().collect();
    let max = [(1 << 16) - 1; 3];
    for halo in [1, 300, 3000] {
        assert!(same("later", &all, max, [2, 2, 2], halo).0 > 0);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn tiny_grids_in_chunks(
        p in prop::collection::btree_set(prop::array::uniform3(0u32..5), 4..60),
        cuts in prop::array::uniform3(1u32..4),
        halo in 1u32..3,
    ) {
        let all: Vec<_> = p.into_iter().collect();
        same("tiny", &all, [4; 3], cuts, halo);
    }
}
