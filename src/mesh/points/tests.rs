//! The promises of a point set, for every kind: boxes agree with the plain sequence.

use super::*;
use isospan_io::grid::BrickGrid;
use proptest::prelude::*;
use std::collections::BTreeMap;

const SPECS: [PointSpec; 8] = [
    PointSpec::Hammersley { n: 3000, shift: 0.5 },
    PointSpec::Hammersley { n: 1024, shift: 0.0 },
    PointSpec::Hammersley { n: 1, shift: 0.3 },
    PointSpec::Halton { n: 3000 },
    PointSpec::Halton { n: 2 },
    PointSpec::HyperbolicCross { m: 3, k: 2, r: [1; 3] },
    PointSpec::HyperbolicCross { m: 2, k: 3, r: [1, 2, 4] },
    PointSpec::Regular { counts: [9, 5, 7] },
];

fn lattices() -> [Lattice; 4] {
    [
        Lattice::new([17, 17, 17]).unwrap(),
        Lattice::new([103, 30, 61]).unwrap(),
        Lattice::new([9, 200, 7]).unwrap(),
        // As coarse as a lattice gets: here many points round to one position, and onto the faces.
        Lattice { dims: [12, 13, 14], log2_steps: [0; 3] },
    ]
}

/// The specification, or one like it that fits the lattice.
fn fitted(spec: PointSpec, lattice: &Lattice) -> PointSpec {
    match spec {
        PointSpec::Regular { counts } => {
            PointSpec::Regular { counts: std::array::from_fn(|a| counts[a].min(lattice.dims[a])) }
        }
        other => other,
    }
}

fn sets() -> impl Iterator<Item = PointSet> {
    lattices().into_iter().flat_map(|l| SPECS.map(|s| PointSet::new(fitted(s, &l), l).unwrap()))
}

/// Every id of a set, asked one by one, the lowest of each position: what enumeration must
/// reproduce.
fn plain_sequence(set: &PointSet) -> BTreeMap<LatticePos, PointId> {
    let mut by_position = BTreeMap::new();
    let mut points = 0;
    for class in [PointClass::Interior, PointClass::Edge, PointClass::Face, PointClass::Corner] {
        for id in (0..40_000).map(|i| PointId::new(class, i)) {
            if let Some(pos) = set.position(id) {
                by_position.entry(pos).or_insert(id);
                points += 1;
            }
        }
    }
    assert_eq!(points, set.len(), "{:?}", set.spec());
    by_position
}

fn sites(set: &PointSet, b: &LatticeBox) -> Vec<Site> {
    let mut out = vec![Site { id: PointId(7), pos: [0; 3] }];
    set.sites_in(b, &mut out);
    out
}

/// The fractions, by definition.
fn defined(spec: &PointSpec, lattice: &Lattice, index: u64) -> LatticePos {
    let max = lattice.max();
    let phi = |base, k, a: usize| radical_inverse(base, k).round(max[a]);
    match *spec {
        PointSpec::Hammersley { n, shift } => {
            let (num, den) =
                (u128::from(index) * (1 << 32) + (shift * 4294967296.0).round() as u128, u128::from(n) << 32);
            let x = (2 * num * u128::from(max[0]) + den) / (2 * den);
            [x as u32, phi(2, index, 1), phi(3, index, 2)]
        }
        PointSpec::Halton { .. } => [phi(2, index + 1, 0), phi(3, index + 1, 1), phi(5, index + 1, 2)],
        _ => unreachable!("only for sequences"),
    }
}

#[test]
fn positions_are_those_of_the_definition() {
    for set in sets() {
        if let Interior::Net(_) = set.interior {
            for i in 0..set.interior_len() {
                let pos = set.position(PointId::new(PointClass::Interior, i));
                assert_eq!(pos, Some(defined(set.spec(), set.lattice(), i)), "{:?} {i}", set.spec());
            }
        }
    }
}

#[test]
fn bricks_together_are_the_plain_sequence() {
    for set in sets() {
        let plain = plain_sequence(&set);
        for edge in [[300, 300, 300], [5, 5, 5], [1, 40, 6], [7, 3, 11]] {
            let bricks = BrickGrid::new(*set.lattice(), edge);
            let mut union = BTreeMap::new();
            for brick in (0..bricks.len()).map(|i| bricks.brick(isospan_io::grid::BrickId(i))) {
                for s in sites(&set, &brick) {
                    assert!(brick.contains(s.pos));
                    assert_eq!(union.insert(s.pos, s.id), None, "a position twice");
                }
            }
            assert_eq!(union, plain, "{:?} {edge:?}", set.spec());
        }
    }
}

#[test]
fn sites_are_sorted_along_the_curve() {
    for set in sets() {
        let all = sites(&set, &set.lattice().domain());
        let cells = order::CurveCells::new(&set.lattice().domain(), set.order_bits());
        let key = |s: &Site| (cells.key(s.pos), s.pos);
        assert!(all.windows(2).all(|w| key(&w[0]) < key(&w[1])));
        assert_eq!(all, sites(&set, &set.lattice().domain()), "the same again");
    }
}

#[test]
fn the_hull_is_sampled() {
    for set in sets() {
        let max = set.lattice().max();
        let all = plain_sequence(&set);
        for c in 0..8 {
            let corner = std::array::from_fn(|a| if c >> a & 1 == 1 { max[a] } else { 0 });
            assert!(all.contains_key(&corner), "{:?}", set.spec());
        }
        for (pos, id) in all {
            let on = (0..3).filter(|&a| pos[a] == 0 || pos[a] == max[a]).count();
            let least = match id.class().unwrap() {
                PointClass::Interior | PointClass::Explicit => 0,
                PointClass::Face => 1,
                PointClass::Edge => 2,
                PointClass::Corner => 3,
            };
            assert!(on >= least, "{pos:?} {id:?}");
        }
    }
}

#[test]
fn boundary_density_matches_the_interior() {
    let lattice = Lattice::new([101, 101, 101]).unwrap();
    for spec in [PointSpec::Hammersley { n: 125_000, shift: 0.5 }, PointSpec::Halton { n: 125_000 }] {
        let set = PointSet::new(spec, lattice).unwrap();
        // 50 points along an edge.
        assert_eq!(set.len(), 125_000 + 6 * 2500 + 12 * 50 + 8);
        let step = lattice.max()[0] / 50;
        assert!(set.mean_spacing().iter().all(|&h| h.abs_diff(step) <= 1));
    }
}

#[test]
fn longer_halton_sets_contain_shorter_ones() {
    let lattice = Lattice::new([50, 60, 70]).unwrap();
    let [short, long] = [700, 5000].map(|n| PointSet::new(PointSpec::Halton { n }, lattice).unwrap());
    for s in sites(&short, &lattice.domain()) {
        assert_eq!(long.position(s.id), Some(s.pos));
    }
}

#[test]
fn unknown_ids_have_no_position() {
    for set in sets() {
        for id in [set.interior_len(), u64::MAX, 1 << 60 | 1 << 59, 2 << 60 | 1 << 58, 3 << 60 | 8, 4 << 60] {
            assert_eq!(set.position(PointId(id)), None, "{id:x}");
        }
    }
}

#[test]
fn counts_are_near_the_truth() {
    for set in sets() {
        let domain = set.lattice().domain();
        assert!(set.count_in(&domain).abs_diff(set.len()) <= 8, "{:?}", set.spec());
        let bricks = BrickGrid::new(*set.lattice(), [6, 6, 6]);
        for brick in (0..bricks.len()).map(|i| bricks.brick(isospan_io::grid::BrickId(i))) {
            let mut out = vec![];
            set.candidates_in(&brick, &mut out);
            let (count, truth) = (set.count_in(&brick), out.len() as u64);
            let allowed = if let Interior::Net(_) = set.interior { 12 + truth / 5 } else { 6 + truth / 10 };
            assert!(count.abs_diff(truth) <= allowed, "{:?} {brick:?}: {count}, is {truth}", set.spec());
        }
    }
}

#[test]
fn a_trillion_points_on_a_large_volume() {
    let lattice = Lattice::new([10_000; 3]).unwrap();
    let n = 1_000_000_000_000;
    for spec in [PointSpec::Hammersley { n, shift: 0.5 }, PointSpec::Halton { n }] {
        let set = PointSet::new(spec, lattice).unwrap();
        let size = 10 << lattice.log2_steps[0];
        let mut largest = 0;
        for lo in [[0; 3], [9_000_001, 5_000_000, 1_234_567], lattice.max().map(|m| m - size + 1)] {
            let b = LatticeBox { lo, hi: lo.map(|x| x + size) };
            let found = sites(&set, &b);
            let truth = set.count_in(&b);
            assert!((found.len() as u64).abs_diff(truth) < 120, "{} {truth}", found.len());
            for s in &found {
                assert!(b.contains(s.pos));
                assert_eq!(set.position(s.id), Some(s.pos));
                if s.id.class() == Some(PointClass::Interior) {
                    assert_eq!(defined(&spec, &lattice, s.id.index()), s.pos);
                    largest = largest.max(s.id.index());
                }
            }
            // Two halves find what the whole finds.
            let mut halves = b;
            halves.hi[1] = lo[1] + size / 3;
            let mut parts = sites(&set, &halves);
            (halves.lo[1], halves.hi[1]) = (halves.hi[1], b.hi[1]);
            parts.extend(sites(&set, &halves));
            assert_eq!(parts.len(), found.len());
        }
        assert!(largest > n / 2, "{largest}");
    }
}

#[test]
fn the_largest_set_does_not_overflow() {
    let lattice = Lattice::new([(1 << 24) + 1; 3]).unwrap();
    for spec in [PointSpec::Hammersley { n: MOST_POINTS, shift: 0.5 }, PointSpec::Halton { n: MOST_POINTS }] {
        let set = PointSet::new(spec, lattice).unwrap();
        let lo = [11_000_000, 7_000_000, 16_000_000];
        let b = LatticeBox { lo, hi: lo.map(|x| x + 40) };
        // A point in 2^13 positions.
        let found = sites(&set, &b);
        assert!((2..=16).contains(&found.len()), "{}", found.len());
        for s in found {
            assert_eq!(defined(&spec, &lattice, s.id.index()), s.pos);
        }
    }
}

#[test]
fn roots() {
    for x in [0u64, 1, 2, 77, 1 << 24, (1 << 41) - 1] {
        let cube = u128::from(x).pow(3);
        assert_eq!((cube_root(cube), cube_root(cube + u128::from(x > 0))), (x, x));
        assert!(x == 0 || cube_root(cube - 1) == x - 1);
    }
}

/// Values that `tools/make_golden_points.py` computed with SciPy's `qmc`.
#[test]
fn sequences_agree_with_scipy() {
    let text = include_str!("../../../tests/data/points_scipy.json");
    let golden: serde_json::Value = serde_json::from_str(text).unwrap();
    let mut compared = 0;
    for run in golden["halton"].as_array().unwrap() {
        let first = run["first"].as_u64().unwrap();
        for (k, row) in (first..).zip(run["points"].as_array().unwrap()) {
            for (a, base) in [2, 3, 5].into_iter().enumerate() {
                let (ours, theirs) = (radical_inverse(base, k).to_f64(), row[a].as_f64().unwrap());
                assert!((ours - theirs).abs() < 1e-14, "{k} {base}: {ours} {theirs}");
                compared += 1;
            }
        }
    }
    let lattice = Lattice::new([(1 << 24) + 1; 3]).unwrap();
    for run in golden["hammersley"].as_array().unwrap() {
        let (n, shift) = (run["n"].as_u64().unwrap(), run["shift"].as_f64().unwrap());
        let set = PointSet::new(PointSpec::Hammersley { n, shift }, lattice).unwrap();
        for (k, row) in (0..).zip(run["points"].as_array().unwrap()) {
            let pos = set.position(PointId::new(PointClass::Interior, k)).unwrap();
            for a in 0..3 {
                let scaled = row[a].as_f64().unwrap() * f64::from(Lattice::LARGEST);
                assert!((f64::from(pos[a]) - scaled).abs() <= 0.5 + 1e-6, "{n} {k}: {pos:?} {row}");
                compared += 1;
            }
        }
    }
    assert!(compared > 1000, "{compared}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    /// Any box of any set on any lattice finds what a scan of all points finds there.
    #[test]
    fn any_box_finds_its_points(
        spec in 0..SPECS.len(),
        dims in prop::array::uniform3(2u64..40),
        n in 1u64..3000,
        ends in prop::array::uniform3((0.0f64..1.0, 0.0f64..1.0)),
        fine in any::<bool>(),
    ) {
        let mut lattice = Lattice::new(dims).unwrap();
        lattice.log2_steps = if fine { lattice.log2_steps } else { [1; 3] };
        let spec = match SPECS[spec] {
            PointSpec::Hammersley { shift, .. } => PointSpec::Hammersley { n, shift },
            PointSpec::Halton { .. } => PointSpec::Halton { n },
            other => fitted(other, &lattice),
        };
        let set = PointSet::new(spec, lattice).unwrap();
        let max = lattice.max();
        let at = |f: f64, a: usize| (f * f64::from(max[a] + 2)) as u32;
        let b = LatticeBox {
            lo: std::array::from_fn(|a| at(ends[a].0.min(ends[a].1), a)),
            hi: std::array::from_fn(|a| at(ends[a].0.max(ends[a].1), a)),
        };
        let found: BTreeMap<_, _> = sites(&set, &b).iter().map(|s| (s.pos, s.id)).collect();
        let mut plain = plain_sequence(&set);
        plain.retain(|&pos, _| b.contains(pos));
        prop_assert_eq!(found, plain);
    }
}
