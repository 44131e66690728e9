//! Star by star, a chunk's mesh is what insertion makes of it.

use super::*;
use crate::mesh::chunk::{Border, ChunkOutcome, Manner, mesh_widening};
use crate::mesh::mesher::Mesher;
use crate::points::{PointSet, PointSpec, SetKind, SetSettings};
use isospan_io::geom::{Lattice, Site};
use proptest::prelude::*;

fn set(kind: SetKind, dims: [u64; 3], count: u64) -> PointSet {
    let lattice = Lattice::new(dims).unwrap();
    let spec = PointSpec::with_count(kind, &lattice, count, &SetSettings::default()).unwrap();
    PointSet::new(spec, lattice).unwrap()
}

fn positions_in(set: &PointSet, b: &LatticeBox) -> Vec<LatticePos> {
    let mut sites: Vec<Site> = vec![];
    set.sites_in(b, &mut sites);
    sites.iter().map(|s| s.pos).collect()
}

/// A core, and the region `quarters` quarters of a spacing around it.
fn boxes(domain: LatticeBox, core: LatticeBox, spacing: u32, quarters: u32) -> ChunkRegion {
    let region = core.grow_within([spacing * quarters / 4; 3], &domain);
    ChunkRegion { core, near: core.grow_within([spacing * quarters / 8; 3], &domain), region, domain }
}

/// The positions of a region.
fn local(boxes: &ChunkRegion, all: &[LatticePos]) -> Vec<LatticePos> {
    let mut local: Vec<LatticePos> = all.iter().copied().filter(|p| boxes.region.contains(*p)).collect();
    // Each part in the order in which it was.
    local.sort_by_key(|p| (!boxes.core.contains(*p), !boxes.near.contains(*p)));
    local
}

/// The tetrahedra around those of a mesh, found from the latter, as far as possible, with the
/// vectors that the machine has.
fn around_again(
    boxes: &ChunkRegion,
    all: &[LatticePos],
    order: &Order,
    mesh: &ChunkMesh,
) -> Vec<Option<Vec<Tet>>> {
    let local = local(boxes, all);
    let mut points = vec![false; local.len()];
    mesh.tets.iter().flatten().for_each(|&v| points[v as usize] = mesh.shared[v as usize]);
    let border = Border { tets: &mesh.tets, points: &points };
    let mut stars = Stars::default();
    stars.slow.patience = Patience(200);
    let mut kernel = Kernel::default();
    let mut around = |vectors| stars.around_with(vectors, &mut kernel, boxes, &local, order, border).unwrap();
    Vectors::all().into_iter().flatten().map(&mut around).collect()
}

/// Meshes by stars, if they do, with what vectors the machine has, and the mesh by insertion.
fn both(
    boxes: &ChunkRegion,
    all: &[LatticePos],
    order: &Order,
    around: bool,
) -> (Vec<Option<ChunkMesh>>, Option<ChunkMesh>) {
    let mut local = local(boxes, all);
    let mut kernel = Kernel::default();
    let mut stars = Stars::default();
    stars.slow.patience = Patience(200);
    let mut meshed = vec![];
    for vectors in Vectors::all().into_iter().flatten() {
        meshed.push(stars.mesh_with(vectors, &mut kernel, boxes, &local, order, around).unwrap());
    }
    // Each vector does the same.
    assert!(meshed.windows(2).all(|two| two[0] == two[1]));
    let manner = Manner { around, even: false };
    let mut widen = |_: &mut Vec<LatticePos>| Ok(None);
    match mesh_widening(&mut Mesher::new(), boxes, &mut local, order, manner, &mut widen).unwrap() {
        ChunkOutcome::Done(mesh) => (meshed, Some(mesh)),
        ChunkOutcome::WidenHalo { .. } => (meshed, None),
    }
}

/// The tetrahedra as they come, but those of one first vertex in an order that does not depend on
/// how they were found.
fn canonical(mesh: &ChunkMesh) -> Vec<Tet> {
    assert!(mesh.tets.iter().all(|t| t[0] < t[1].min(t[2]).min(t[3])));
    assert!(mesh.tets.is_sorted_by_key(|t| t[0]));
    let mut tets = mesh.tets.to_vec();
    super::super::owned::sort_around(&mut tets);
    tets
}

fn assert_same(stars: &ChunkMesh, insertion: &ChunkMesh) {
    assert_eq!(canonical(stars), canonical(insertion));
    assert_eq!(stars.tets.around(), insertion.tets.around());
    assert_eq!(stars.shared, insertion.shared);
}

#[test]
fn chunks_of_even_sets_are_those_of_insertion() {
    for (kind, dims, count) in [
        (SetKind::Hammersley, [40, 40, 40], 9000),
        (SetKind::Halton, [40, 40, 40], 9000),
        (SetKind::Halton, [90, 33, 21], 9000),
        (SetKind::Hammersley, [20, 200, 17], 9000),
    ] {
        let set = set(kind, dims, count);
        assert!(set.is_even());
        let domain = set.lattice().domain();
        let order = Order::for_count(set.len());
        let all = positions_in(&set, &domain);
        let spacing = (set.spacing_around(&domain)[0][0]).max(1);
        let middle: LatticePos = std::array::from_fn(|a| domain.hi[a] / 2);
        for corner in [0u32, 3, 6, 7] {
            let side = |a: usize| corner >> a & 1 == 1;
            let core = LatticeBox {
                lo: std::array::from_fn(|a| if side(a) { middle[a] } else { 0 }),
                hi: std::array::from_fn(|a| if side(a) { domain.hi[a] } else { middle[a] }),
            };
            for around in [false, true] {
                let boxes = boxes(domain, core, spacing, if around { 18 } else { 12 });
                let (stars, insertion) = both(&boxes, &all, &order, around);
                let insertion = insertion.unwrap();
                for stars in stars {
                    assert_same(&stars.unwrap(), &insertion);
                }
                if around {
                    assert!(!insertion.tets.around().is_empty());
                    for again in around_again(&boxes, &all, &order, &insertion) {
                        assert_eq!(again.as_deref(), Some(insertion.tets.around()));
                    }
                }
            }
        }
        let whole = boxes(domain, domain, spacing, 12);
        let (stars, insertion) = both(&whole, &all, &order, true);
        let insertion = insertion.unwrap();
        for stars in stars {
            let stars = stars.unwrap();
            assert_same(&stars, &insertion);
            assert!(stars.tets.around().is_empty() && stars.shared.iter().all(|&shared| !shared));
        }
    }
}

#[test]
fn a_lattice_is_left_to_insertion() {
    let set = set(SetKind::Regular, [30, 30, 30], 27_000);
    assert!(!set.is_even());
    let domain = set.lattice().domain();
    let all = positions_in(&set, &domain);
    let whole = ChunkRegion { core: domain, near: domain, region: domain, domain };
    let mut stars = Stars::default();
    let found =
        stars.mesh(&mut Kernel::default(), &whole, &all, &Order::for_count(set.len()), false).unwrap();
    assert!(found.is_none());
    assert!(stars.slow.stars > SLOW.0, "{}", stars.slow.stars);
}

#[test]
fn memory_is_used_again() {
    let set = set(SetKind::Halton, [40, 40, 40], 5000);
    let domain = set.lattice().domain();
    let (all, order) = (positions_in(&set, &domain), Order::for_count(set.len()));
    let whole = ChunkRegion { core: domain, near: domain, region: domain, domain };
    let manner = Manner { around: false, even: true };
    let (mut mesher, mut meshes) = (Mesher::new(), vec![]);
    for _ in 0..3 {
        let mut widen = |_: &mut Vec<LatticePos>| Ok(None);
        let outcome = mesh_widening(&mut mesher, &whole, &mut all.clone(), &order, manner, &mut widen);
        let ChunkOutcome::Done(mesh) = outcome.unwrap() else { panic!("the whole domain") };
        meshes.push(mesh.clone());
        mesher.reuse(mesh.tets);
    }
    assert!(meshes[0].tets.len() > 5 * all.len() && meshes.iter().all(|mesh| *mesh == meshes[0]));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Points at random, those of faces of the domain among them, in coarse steps too, which puts
    /// many on one sphere; some twice; also where the region is too narrow.
    #[test]
    fn whatever_comes_is_meshed_as_by_insertion(
        seed in any::<u64>(),
        n in 300usize..1500,
        log2_step in 0u32..21,
        quarters in 3u32..16,
        around in any::<bool>(),
        from in 0u32..3,
    ) {
        let mut state = seed;
        let mut below = |n: u32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % u64::from(n)) as u32
        };
        let steps = (1u32 << 24) >> log2_step;
        let mut all: Vec<LatticePos> =
            (0..8u32).map(|i| std::array::from_fn(|k| (i >> k & 1) << 24)).collect();
        for i in 0..n {
            let mut p: LatticePos = std::array::from_fn(|_| below(steps + 1) << log2_step);
            if i % 4 == 0 {
                p[i / 4 % 3] = below(2) << 24;
            }
            all.push(p);
        }
        all.sort_unstable();
        all.dedup();
        let domain = LatticeBox { lo: [0; 3], hi: [(1 << 24) + 1; 3] };
        let core = LatticeBox { lo: [from << 22, 1 << 22, 0], hi: [(from + 2) << 22, 3 << 22, (1 << 24) + 1] };
        // Twice, but not in the core.
        let twice: Vec<_> = all.iter().copied().filter(|p| !core.contains(*p)).step_by(97).collect();
        all.extend(twice);
        let spacing = ((1u64 << 24) as f64 / (n as f64).cbrt()) as u32;
        let order = Order::for_count(n as u64);
        let boxes = boxes(domain, core, spacing, quarters);
        let (stars, insertion) = both(&boxes, &all, &order, around);
        // Where insertion wants a wider region, stars cannot be certified either.
        for stars in stars.into_iter().flatten() {
            assert_same(&stars, insertion.as_ref().expect("a mesh as certain"));
        }
        if let Some(insertion) = insertion.filter(|_| around) {
            for again in around_again(&boxes, &all, &order, &insertion).into_iter().flatten() {
                prop_assert_eq!(&*again, insertion.tets.around());
            }
        }
    }
}
