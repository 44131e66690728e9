use super::odds::SET;
use super::write::Truth;
use super::write::even::Luck;
use super::*;
use crate::archive::mesh::chunk::tests::{corners, cubes, sorted};
use crate::archive::mesh::heads::BlockHead;
use crate::archive::wire::Malformed;
use isospan_io::geom::Lattice;
use isospan_io::geom::curve::{Order, hilbert_key};
use isospan_io::grid::{BrickGrid, BrickId};
use isospan_mesh::mesh::mesher::Mesher;
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::points::{PointSet, PointSpec, SetKind, SetSettings};

/// The head of a block of tetrahedra that ascend by their first vertices.
fn head_of(tets: &[Tet]) -> BlockHead {
    let (first, last) = (tets[0][0], tets[tets.len() - 1][0]);
    BlockHead { first, own: last - first + 1, tets: tets.len() as u32 }
}

/// Encodes a block whose own vertices begin with the first that has a tetrahedron.
fn put(writer: &mut Writer, tets: &[Tet], positions: &[LatticePos], out: &mut Vec<u8>) -> bool {
    writer.encode(tets, tets.first().map_or(0, |t| t[0]), positions, out)
}

fn open<'a>(
    bytes: &'a [u8],
    head: &BlockHead,
    positions: &[LatticePos],
    ids: &mut Vec<u32>,
) -> Result<Reader<'a>, Malformed> {
    let (&size, rest) = bytes.split_first().ok_or_else(|| Malformed::new("size", "a byte", "none"))?;
    Reader::open(rest, size, head, positions.len() as u32, ids)
}

fn decode(
    bytes: &[u8],
    head: &BlockHead,
    positions: &[LatticePos],
    out: &mut Vec<Tet>,
) -> Result<(), Malformed> {
    let (mut scratch, mut ids) = (Scratch::default(), vec![]);
    let reader = open(bytes, head, positions, &mut ids)?;
    assert!(ids.is_sorted() && ids.iter().all(|&v| (v as usize) < positions.len()));
    let here: Vec<LatticePos> = ids.iter().map(|&v| positions[v as usize]).collect();
    reader.decode(&mut scratch, &ids, &here, out)
}

fn encode(tets: &[Tet], positions: &[LatticePos]) -> Option<Vec<u8>> {
    let mut bytes = vec![];
    put(&mut Writer::default(), &sorted(tets), positions, &mut bytes).then_some(bytes)
}

fn round_trip(tets: &[Tet], positions: &[LatticePos]) -> usize {
    let bytes = encode(tets, positions).unwrap();
    let mut back = vec![[9; 4]];
    decode(&bytes, &head_of(&sorted(tets)), positions, &mut back).unwrap();
    assert_eq!(back.remove(0), [9; 4], "appended");
    assert!(sorted(&back) == sorted(tets));
    bytes.len()
}

/// A fixed sequence without pattern.
fn noise() -> impl FnMut(u32) -> u32 {
    let mut state = 1u64;
    move |below| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) % u64::from(below)) as u32
    }
}

fn anywhere(n: usize) -> Vec<LatticePos> {
    let mut next = noise();
    (0..n).map(|_| [0; 3].map(|_: u32| next(1 << 24))).collect()
}

/// Random points and points on the faces of a box, along the Hilbert curve, and their mesh.
fn delaunay(n: usize) -> (Vec<LatticePos>, Vec<Tet>) {
    let mut positions = anywhere(n);
    let along = |i: u32| (i * (1 << 24)) / 12;
    let sides = (0..13 * 13).flat_map(|i| [0, 12].map(|w| [i % 13, i / 13, w].map(along)));
    positions.extend(sides.flat_map(|[a, b, c]| [[a, b, c], [b, c, a], [c, a, b]]));
    positions.sort_by_cached_key(|&p| hilbert_key(p, 8));
    let mut mesher = Mesher::new();
    mesher.delaunay(&positions, &Order::for_count(n as u64)).unwrap();
    let mut tets = vec![];
    mesher.for_each_tet(|t| tets.push(t));
    (positions, sorted(&tets))
}

fn runs(tets: &[Tet], own: u32) -> impl Iterator<Item = &[Tet]> {
    tets.chunk_by(move |a, b| a[0] / own == b[0] / own)
}

#[test]
fn grids_come_back_whole_and_with_holes() {
    round_trip(&[[0, 1, 2, 3]], &anywhere(4));
    round_trip(&[[3, 1, 70_000, 900]], &anywhere(70_001));
    for n in [[1, 1, 1], [4, 1, 1], [3, 3, 3], [12, 11, 7]] {
        let (tets, positions) = (cubes(n), corners(n));
        let bytes = round_trip(&tets, &positions);
        assert!(tets.len() < 500 || bytes * 8 < tets.len() * 9 / 4, "{bytes} bytes for {}", tets.len());
        let holes: Vec<Tet> = (0..).zip(&tets).filter(|(i, _)| i * 7 % 5 != 0).map(|(_, &t)| t).collect();
        if !holes.is_empty() {
            round_trip(&holes, &positions);
        }
    }
}

#[test]
fn blocks_of_a_delaunay_mesh_are_small() {
    let (positions, tets) = delaunay(6000);
    let bytes: usize = runs(&tets, 150).map(|run| round_trip(run, &positions)).sum();
    assert!(bytes * 8 < tets.len() * 9 / 4, "{bytes} bytes for {}", tets.len());
}

#[test]
fn all_paths_write_and_read_the_same_bytes() {
    let (positions, tets) = delaunay(3000);
    assert_eq!(paths_agree(&positions, &tets), runs(&tets, 300).count());
}

/// As bodies of a mesh that touch: two copies of a mesh in one place, which have some vertices in
/// common.
#[test]
fn all_paths_agree_where_vertices_share_positions() {
    let (positions, tets) = delaunay(1500);
    let twice: Vec<LatticePos> = positions.iter().flat_map(|&p| [p, p]).collect();
    let copy = |of: u32| move |v: u32| if v.is_multiple_of(50) { 2 * v } else { 2 * v + of };
    let both: Vec<Tet> =
        [0, 1].into_iter().flat_map(|of| tets.iter().map(move |t| t.map(copy(of)))).collect();
    let mut both = sorted(&both);
    // Where all corners are common, the copies are one.
    both.dedup();
    assert!(paths_agree(&twice, &both) > 10);
}

/// Gives the number of blocks that the coder has taken.
fn paths_agree(positions: &[LatticePos], tets: &[Tet]) -> usize {
    let mut taken = 0;
    for run in runs(tets, 300) {
        let mut writer = Writer::default();
        let mut bytes = vec![];
        let takes = put(&mut writer, run, positions, &mut bytes);
        taken += usize::from(takes);
        for path in [Paths::All, Paths::Narrow, Paths::Plain] {
            let mut other = vec![];
            writer.stars.path = path;
            assert_eq!(put(&mut writer, run, positions, &mut other), takes);
            assert!(bytes == other);
            if !takes {
                continue;
            }
            let (mut scratch, mut ids, mut back) = (Scratch::default(), vec![], vec![]);
            scratch.stars.path = path;
            let reader = open(&bytes, &head_of(run), positions, &mut ids).unwrap();
            let here: Vec<LatticePos> = ids.iter().map(|&v| positions[v as usize]).collect();
            reader.decode(&mut scratch, &ids, &here, &mut back).unwrap();
            assert!(back == writer.decoded());
        }
    }
    taken
}

#[test]
fn an_even_star_is_coded_as_an_odd_one_would_be() {
    let (positions, mut tets) = delaunay(3000);
    // Also where many tries fail.
    let grid: Vec<LatticePos> = (0..1000).map(|i| [i % 10 * 50, i / 10 % 10 * 50, i / 100 * 50]).collect();
    let offset = positions.len() as u32;
    let both = [&*positions, &grid].concat();
    tets.extend(cubes([9, 9, 9]).iter().map(|t| t.map(|v| v + offset)));
    for run in runs(&sorted(&tets), 200) {
        let (mut bytes, mut others) = (vec![], vec![]);
        let (mut tries, mut never) = (Writer::default(), Writer::default());
        never.truth.luck = Luck::none();
        assert!(put(&mut tries, run, &both, &mut bytes) == put(&mut never, run, &both, &mut others));
        assert!(bytes == others && tries.decoded() == never.decoded());
    }
}

/// A mesh in which tetrahedra are missing, there twice, turned over, or have another vertex is
/// refused, or comes back.
#[test]
fn what_is_almost_a_mesh_comes_back_or_is_refused() {
    let (positions, tets) = delaunay(1000);
    let (mut next, mut writer, mut taken) = (noise(), Writer::default(), 0);
    for n in 0..600 {
        let start = next(tets.len() as u32 - 400) as usize;
        let mut some = vec![];
        for &t in &tets[start..start + 400] {
            if next(100) < n % 4 * 10 {
                continue;
            }
            some.push(t);
            match next(600) {
                0 => some.push(t),
                1 => some.push([t[0], t[2], t[1], t[3]]),
                2 => some.push([t[0], t[1], t[2], next(positions.len() as u32)]),
                _ => {}
            }
        }
        some.retain(|t| (1..4).all(|i| !t[..i].contains(&t[i])));
        let (some, mut bytes, mut back) = (sorted(&some), vec![], vec![]);
        if put(&mut writer, &some, &positions, &mut bytes) {
            taken += 1;
            decode(&bytes, &head_of(&some), &positions, &mut back).unwrap();
            assert!(back == writer.decoded() && sorted(&back) == some, "{n}");
        }
    }
    assert!((50..550).contains(&taken), "{taken} of 600");
}

/// The mesher's order within a star depends on the instructions that it may use.
#[test]
fn the_order_within_stars_decides_no_byte() {
    let (positions, tets) = delaunay(3000);
    for run in runs(&tets, 40) {
        let mut other = run.to_vec();
        for star in other.chunk_by_mut(|a, b| a[0] == b[0]) {
            star.reverse();
            star.rotate_left(star.len() / 3);
            star.iter_mut().for_each(|t| t[1..].rotate_left(1));
        }
        let mut writer = Writer::default();
        let [mut bytes, mut others] = [vec![], vec![]];
        assert!(
            put(&mut writer, run, &positions, &mut bytes)
                && put(&mut writer, &other, &positions, &mut others)
        );
        assert!(bytes == others);
    }
}

#[test]
fn positions_that_foretell_nothing_cost_bytes_only() {
    let tets = cubes([6, 5, 4]);
    let right = round_trip(&tets, &corners([6, 5, 4]));
    for positions in [anywhere(210), vec![[7; 3]; 210], (0..210).map(|i| [i, 0, 0]).collect()] {
        assert!(encode(&tets, &positions).is_none_or(|_| round_trip(&tets, &positions) > right));
    }
}

#[test]
fn what_does_not_fit_is_left_to_another_coder() {
    let mut writer = Writer::default();
    let (mut out, positions) = (vec![], anywhere(100_004));
    assert!(!put(&mut writer, &[], &positions, &mut out));
    assert!(!put(&mut writer, &[[0, 1, 2, 3], [100_000, 100_001, 100_002, 100_003]], &positions, &mut out));
    assert!(!put(&mut writer, &[[0, 1, 2, 2]], &positions, &mut out));
    // A star of too many vertices.
    let many: Vec<Tet> = (0..1000).map(|i| [0, 3 * i + 1, 3 * i + 2, 3 * i + 3]).collect();
    assert!(!put(&mut writer, &many, &positions, &mut out));
    assert!(out.is_empty());
    assert!(put(&mut writer, &[[0, 1, 2, 3]], &positions, &mut out), "what came before does no harm");
    decode(&out, &head_of(&[[0, 1, 2, 3]]), &positions, &mut vec![]).unwrap();
}

/// Opens and decodes with memory that is in use already.
fn decode_again(
    scratch: &mut Scratch,
    bytes: &[u8],
    head: &BlockHead,
    positions: &[LatticePos],
) -> Result<Vec<Tet>, Malformed> {
    let (mut ids, mut out) = (vec![], vec![]);
    let reader = open(bytes, head, positions, &mut ids)?;
    let here: Vec<LatticePos> = ids.iter().map(|&v| positions[v as usize]).collect();
    reader.decode(scratch, &ids, &here, &mut out).map(|()| out)
}

#[test]
fn a_damaged_block_does_the_next_one_no_harm() {
    let (positions, tets) = delaunay(600);
    let run = runs(&tets, 60).next().unwrap();
    let (good, head) = (encode(run, &positions).unwrap(), head_of(&sorted(run)));
    let (mut scratch, mut next, mut refused) = (Scratch::default(), noise(), 0);
    for _ in 0..200 {
        let mut bad = good.clone();
        (0..3).for_each(|_| bad[next(good.len() as u32) as usize] ^= 1 << next(8));
        refused += u32::from(decode_again(&mut scratch, &bad, &head, &positions).is_err());
        let back = decode_again(&mut scratch, &good, &head, &positions).unwrap();
        assert!(sorted(&back) == sorted(run));
    }
    assert!(refused > 100, "{refused}");
}

#[test]
fn no_damage_panics_or_gives_a_vertex_that_is_not_there() {
    let (tets, positions) = (cubes([4, 3, 3]), corners([4, 3, 3]));
    let good = encode(&tets, &positions).unwrap();
    let head = head_of(&sorted(&tets));
    assert!(decode(&good, &head, &positions[..79], &mut vec![]).is_err(), "vertex 79 is in use");
    for i in 0..good.len() {
        assert!(decode(&good[..i], &head, &positions, &mut vec![]).is_err());
        for bit in 0..8 {
            let mut bad = good.clone();
            bad[i] ^= 1 << bit;
            for bytes in [&bad[..], &[&bad[..5], &[0x55; 90]].concat()] {
                let mut out = vec![];
                if decode(bytes, &head, &positions, &mut out).is_ok() {
                    assert!(out.iter().flatten().all(|&v| v < 80));
                }
            }
        }
    }
}

impl Truth {
    pub(super) fn count(&mut self, at: usize, truth: bool) {
        let [all, set] = self.counts.entry(at).or_default();
        *all += 1.0;
        *set += f64::from(u8::from(truth));
    }
}

/// Blocks of a point set as a reduction makes them: brick after brick.
fn mesh_of(kind: SetKind, count: u64) -> (Vec<LatticePos>, Vec<Tet>) {
    let lattice = Lattice::new([101; 3]).unwrap();
    let points = PointSet::new(
        PointSpec::with_count(kind, &lattice, count, &SetSettings::default()).unwrap(),
        lattice,
    )
    .unwrap();
    let edge = (101.0 * (1024.0 / points.len() as f64).cbrt()).round() as u64;
    let bricks = BrickGrid::new(lattice, [edge; 3]);
    let (mut positions, mut sites): (Vec<LatticePos>, _) = (vec![], vec![]);
    for brick in 0..bricks.len() {
        points.sites_in(&bricks.brick(BrickId(brick)), &mut sites);
        positions.extend(sites.iter().map(|s| s.pos));
    }
    let mut mesher = Mesher::new();
    mesher.delaunay(&positions, &Order::for_count(points.len())).unwrap();
    let mut tets = vec![];
    mesher.for_each_tet(|t| tets.push(t));
    (positions, sorted(&tets))
}

/// The odds that a block begins with: Hammersley and Halton points count most, since they are used
/// most.
#[test]
#[ignore = "makes the table of odds.rs: run it with --ignored after a change of the coder"]
fn the_first_odds_are_those_of_the_point_sets() {
    let sets = [
        (SetKind::Hammersley, 0.5),
        (SetKind::Halton, 0.3),
        (SetKind::HyperbolicCross, 0.05),
        (SetKind::Regular, 0.05),
    ];
    let mut sums = [[0.0; 2]; DECISIONS];
    for (kind, weight) in sets {
        let (positions, tets) = mesh_of(kind, 60_000);
        let mut writer = Writer::default();
        for run in runs(&tets, 40) {
            put(&mut writer, run, &positions, &mut vec![]);
        }
        for (&at, [all, set]) in &writer.truth.counts {
            let share = weight / tets.len() as f64;
            sums[at] = [sums[at][0] + share * all, sums[at][1] + share * set];
        }
    }
    let odds = |[all, set]: [f64; 2]| {
        if all > 0.0 { (set / all * 65_536.0).round().min(65_535.0) } else { 32_768.0 }
    };
    let table: Vec<u16> = sums.iter().map(|&s| odds(s) as u16).collect();
    assert_eq!(table, SET, "put the left table into odds.rs");
}
