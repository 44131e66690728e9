//! Against brute force: every tetrahedron cut by itself, with other formulas.

use super::measure::Vectors;
use super::*;
use crate::archive::segment::PlanHash;
use isospan_mesh::mesh::tet::{Tet, is_active, range};
use isospan_mesh::simd::{Avx2, Avx512};
use proptest::prelude::*;
use std::path::Path;

const PLAN: PlanHash = PlanHash(4);

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn triangle(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> f64 {
    let (u, v) = (sub(b, a), sub(c, a));
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt() / 2.0
}

fn volume(p: [[f64; 3]; 4]) -> f64 {
    let [u, v, w] = [1, 2, 3].map(|i| sub(p[i], p[0]));
    (u[0] * (v[1] * w[2] - v[2] * w[1])
        + u[1] * (v[2] * w[0] - v[0] * w[2])
        + u[2] * (v[0] * w[1] - v[1] * w[0]))
        .abs()
        / 6.0
}

/// Area of the cut, and volume at or above v, by marching: corners inside are those `>= v`.
fn cut(p: [[f64; 3]; 4], f: [f64; 4], v: f64) -> (f64, f64) {
    let (inside, outside): (Vec<usize>, Vec<usize>) = (0..4).partition(|&i| f[i] >= v);
    let on = |i: usize, o: usize| {
        let t = (v - f[o]) / (f[i] - f[o]);
        [0, 1, 2].map(|k| p[o][k] + t * (p[i][k] - p[o][k]))
    };
    match (&inside[..], &outside[..]) {
        ([], _) => (0.0, 0.0),
        (_, []) => (0.0, volume(p)),
        (&[a], &[b, c, d]) => {
            let q = [on(a, b), on(a, c), on(a, d)];
            (triangle(q[0], q[1], q[2]), volume([p[a], q[0], q[1], q[2]]))
        }
        (&[b, c, d], &[a]) => {
            let q = [on(b, a), on(c, a), on(d, a)];
            (triangle(q[0], q[1], q[2]), volume(p) - volume([p[a], q[0], q[1], q[2]]))
        }
        (&[a, b], &[c, d]) => {
            let (ac, ad, bc, bd) = (on(a, c), on(a, d), on(b, c), on(b, d));
            let area = triangle(ac, ad, bd) + triangle(ac, bd, bc);
            (area, volume([p[a], ac, ad, bd]) + volume([p[a], ac, bd, bc]) + volume([p[a], p[b], bc, bd]))
        }
        _ => unreachable!("four corners"),
    }
}

/// Some tetrahedra on shared corners, with few distinct values among many, and void ones.
fn soup() -> impl Strategy<Value = Soup> {
    soup_of(
        prop_oneof![4 => -40f32..60.0, 3 => (-4i8..6).prop_map(|v| f32::from(v) * 10.0), 1 => Just(f32::NAN)],
    )
}

/// The same with values that are equal, nearly so, huge or next to nothing.
fn odd_soup() -> impl Strategy<Value = Soup> {
    let few = [0.0, -0.0, 1.0, 1f32.next_up(), 1f32.next_down(), 1e-45, -1e-45, 1e-30, 3e37, -3e37, f32::NAN];
    soup_of(prop_oneof![prop::sample::select(few.to_vec()), -2f32..2.0])
}

/// Values, places, tetrahedra.
type Soup = (Vec<f32>, Vec<[f64; 3]>, Vec<Tet>);

fn soup_of(value: impl Strategy<Value = f32>) -> impl Strategy<Value = Soup> {
    let corner = (value, prop::array::uniform3(-3f64..3.0));
    prop::collection::vec(corner, 8..60).prop_flat_map(|corners| {
        let n = corners.len() as u32;
        let (values, places): (Vec<f32>, Vec<[f64; 3]>) = corners.into_iter().unzip();
        let tet = prop::array::uniform4(0..n);
        (Just(values), Just(places), prop::collection::vec(tet, 1..80))
    })
}

fn vectors(places: &[[f64; 3]]) -> Vec<[f64; 4]> {
    places.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect()
}

/// Chunks of seven tetrahedra, each through its bytes.
fn built(values: &[f32], places: &[[f64; 3]], tets: &[Tet], points: u64) -> Option<SpectrumBuilder> {
    let limits = Limits::of_mesh(points);
    let range_of = |tets: &[Tet]| {
        let ranges = tets.iter().filter_map(|t| range(t.map(|v| values[v as usize])));
        ranges.fold([f32::INFINITY, f32::NEG_INFINITY], |r, (lo, hi)| [r[0].min(lo), r[1].max(hi)])
    };
    let all = range_of(tets);
    if all[0] > all[1] {
        return None;
    }
    let mut builder = SpectrumBuilder::new(Design::new(all, limits));
    for tets in tets.chunks(7) {
        let step = Vertices { values, range: range_of(tets) };
        let part = ChunkPart::of_steps(limits, &vectors(places), tets, &[step], &mut LaneBuffers::default())
            .pop()
            .unwrap();
        let bytes = part.encode(Digits::All);
        let back = ChunkPart::decode(&bytes, limits, Digits::All).unwrap();
        assert_eq!(back, part);
        builder.add(&back);
    }
    Some(builder)
}

/// A series: values that change from step to step, each its own way; at the last step all are void.
fn series(values: &[f32], steps: usize) -> Vec<Vec<f32>> {
    let at = |t: usize| values.iter().map(|v| v * (1.0 + t as f32) - t as f32).collect();
    let mut all: Vec<Vec<f32>> = (0..steps).map(at).collect();
    all.push(vec![f32::NAN; values.len()]);
    all
}

proptest! {
    #[test]
    fn vectors_and_other_steps_change_no_bit(
        (values, places, tets) in prop_oneof![soup(), odd_soup()], steps in 1usize..10,
    ) {
        let (places, limits) = (vectors(&places), Limits::of_mesh(100_000));
        let all = series(&values, steps);
        let ranges = all.iter().map(|values| {
            let range = |t: &Tet| range(t.map(|v| values[v as usize]));
            let none = [f32::INFINITY, f32::NEG_INFINITY];
            tets.iter().filter_map(range).fold(none, |r, (lo, hi)| [r[0].min(lo), r[1].max(hi)])
        });
        let all: Vec<Vertices<'_>> = all.iter().zip(ranges).map(|(values, range)| Vertices { values, range }).collect();
        let mut buffers = LaneBuffers::default();
        let mut made = |steps: &[Vertices<'_>], vectors| -> Vec<Vec<u8>> {
            ChunkPart::of_with(limits, &places, &tets, steps, vectors, &mut buffers).iter().map(|part| part.encode(Digits::All)).collect()
        };
        let plain = made(&all, Vectors::Plain);
        prop_assert_eq!(plain.len(), steps + 1);
        let parts: Vec<ChunkPart> = plain.iter().map(|part| ChunkPart::decode(part, limits, Digits::All).unwrap()).collect();
        let sums = parts.iter().filter_map(|part| part.measured.as_ref()).flat_map(|m| m.sums.as_flattened());
        prop_assert!(sums.into_iter().all(|sum| !sum.is_nan()));
        let vectors = [Avx2::found().map(Vectors::Avx2), Avx512::found().map(Vectors::Avx512)];
        for vectors in vectors.into_iter().flatten().chain([Vectors::Plain]) {
            prop_assert_eq!(&made(&all, vectors), &plain);
            for (n, alone) in plain.iter().enumerate() {
                prop_assert_eq!(&made(&all[n..=n], vectors)[0], alone);
            }
        }
    }
}

#[test]
fn damaged_parts_are_refused_or_harmless() {
    let places: Vec<[f64; 3]> = (0..60).map(|i| [i, i * i % 37, i * i * i % 41].map(f64::from)).collect();
    let values: Vec<f32> = (0..60u16).map(|i| f32::from(i * 61 % 199)).collect();
    let tets: Vec<Tet> = (0..50).map(|i| [i, i + 1, i + 2, i + 9]).collect();
    let limits = Limits::of_mesh(100);
    let step = Vertices { values: &values, range: [0.0, 198.0] };
    let part = ChunkPart::of_steps(limits, &vectors(&places), &tets, &[step], &mut LaneBuffers::default())
        .pop()
        .unwrap();
    let design = Design::new([-1e9, 1e9], limits);
    for digits in [Digits::All, Digits::Few] {
        let good = part.encode(digits);
        for i in 0..good.len() {
            assert!(ChunkPart::decode(&good[..i], limits, digits).is_err(), "cut at {i}");
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[i] ^= 1 << bit;
                if let Ok(bad) = ChunkPart::decode(&bad, limits, digits) {
                    SpectrumBuilder::new(design).add(&bad);
                }
            }
        }
    }
    let nothing = Vertices { values: &[], range: [f32::INFINITY, f32::NEG_INFINITY] };
    let void = ChunkPart::of_steps(limits, &[], &[], &[nothing], &mut LaneBuffers::default()).pop().unwrap();
    assert_eq!(ChunkPart::decode(&void.encode(Digits::Few), limits, Digits::Few).unwrap(), void);
}

fn near(a: f64, b: f64, of: f64) -> bool {
    (a - b).abs() <= 3e-9 * of.max(1e-3)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn a_spectrum_is_a_sum_over_all_tetrahedra((values, places, tets) in soup()) {
        let Some(builder) = built(&values, &places, &tets, 4000) else { return Ok(()) };
        let s = builder.spectrum();
        let live: Vec<&Tet> = tets.iter().filter(|t| t.iter().all(|&v| !values[v as usize].is_nan())).collect();
        prop_assert_eq!(s.tetrahedra, live.len() as u64);
        let at = |t: &Tet| t.map(|v| places[v as usize]);
        let all: f64 = live.iter().map(|t| volume(at(t))).sum();
        prop_assert!(near(s.volume, all, all));
        let active = |v: f32| live.iter().filter(|t| {
            let (lo, hi) = range(t.map(|c| values[c as usize])).unwrap();
            is_active(lo, hi, v)
        }).count() as u64;
        for k in &s.knots {
            let f = |t: &Tet| t.map(|c| f64::from(values[c as usize]));
            let brute: Vec<(f64, f64)> = live.iter().map(|t| cut(at(t), f(t), f64::from(k.isovalue))).collect();
            let (area, inside) = brute.iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
            prop_assert_eq!(k.active_cells, active(k.isovalue));
            prop_assert!(near(k.volume, inside, all), "volume {} {inside} at {}", k.volume, k.isovalue);
            prop_assert!(near(k.area, area, area), "area {} {area} at {}", k.area, k.isovalue);
        }
        // Every level, every corner value, and between: exact, or not stored.
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("spectrum.seg");
        builder.finish(&path, PLAN).unwrap();
        let file = SpectrumFile::open(&path, Some(PLAN), Limits::of_mesh(4000)).unwrap();
        file.verify(&builder).unwrap();
        let stored = file.spectrum();
        prop_assert_eq!((stored.range, stored.tetrahedra, stored.volume, stored.levels), (s.range, s.tetrahedra, s.volume, s.levels));
        for (a, b) in stored.knots.iter().zip(&s.knots) {
            prop_assert_eq!((a.isovalue, a.active_cells), (b.isovalue, b.active_cells));
            for (a, b) in [(a.area, b.area), (a.volume, b.volume), (a.gradient, b.gradient)] {
                prop_assert!((a - b).abs() <= 5e-7 * b.abs(), "{} {}", a, b);
            }
        }
        for n in 0..s.levels.count {
            let v = s.levels.value(n);
            prop_assert_eq!(file.active(v), Some(active(v)), "level {}", v);
        }
        for v in values.iter().copied().chain([f32::NEG_INFINITY, f32::INFINITY, -1e-30, 0.123_456_7]).filter(|v| !v.is_nan()) {
            if let Some(found) = file.active(v) {
                prop_assert_eq!(found, active(v), "value {}", v);
            }
        }
    }
}

/// One tetrahedron of gradient (2, 0, 0): the gradient integral is twice the area.
#[test]
fn the_gradient_is_that_of_the_field() {
    let places = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.2, 1.0, 0.0], [0.5, 0.3, 1.0]];
    let values = places.map(|p: [f64; 3]| (2.0 * p[0]) as f32);
    let s = built(&values, &places, &[[0, 1, 2, 3]], 4000).unwrap().spectrum();
    assert!(s.knots.len() >= 15);
    for k in s.knots.iter().filter(|k| k.area > 0.0) {
        assert!((k.gradient / k.area - 2.0).abs() < 1e-6, "{k:?}");
    }
}

#[test]
fn a_constant_field_has_no_isosurface() {
    let places = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let builder = built(&[7.0; 4], &places, &[[0, 1, 2, 3]], 100).unwrap();
    let s = builder.spectrum();
    assert_eq!((s.knots.len(), s.levels.count, s.tetrahedra), (0, 0, 1));
    let dir = tempfile::tempdir().unwrap();
    builder.finish(dir.path().join("s.seg"), PLAN).unwrap();
    let file = SpectrumFile::open(dir.path().join("s.seg"), None, Limits::of_mesh(100)).unwrap();
    assert_eq!((file.active(7.0), file.active(6.0)), (Some(0), Some(0)));
}

fn small(dir: &Path) -> SpectrumBuilder {
    let places: Vec<[f64; 3]> = (0..200).map(|i| [i, i * i % 37, i * i * i % 41].map(f64::from)).collect();
    let values: Vec<f32> = (0..200u16).map(|i| f32::from(i * 61 % 199)).collect();
    let tets: Vec<Tet> = (0..190).map(|i| [i, i + 1, i + 2, i + 9]).collect();
    let builder = built(&values, &places, &tets, 20_000).unwrap();
    builder.finish(dir.join("s.seg"), PLAN).unwrap();
    builder
}

#[test]
fn damage_is_an_error_or_the_right_answer() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s.seg");
    let builder = small(dir.path());
    let answers = |f: &SpectrumFile| [1.0, 50.0, 198.0].map(|v| f.active(v));
    let limits = Limits::of_mesh(20_000);
    let right = answers(&SpectrumFile::open(&path, None, limits).unwrap());
    assert!(right.iter().all(|a| a.is_some_and(|n| n > 0)));
    let good = std::fs::read(&path).unwrap();
    for i in (0..good.len()).step_by(3) {
        let mut bad = good.clone();
        bad[i] ^= 0x11;
        std::fs::write(&path, &bad).unwrap();
        if let Ok(file) = SpectrumFile::open(&path, Some(PLAN), limits) {
            assert!(file.verify(&builder).is_err(), "byte {i}");
            assert_eq!(answers(&file), right, "byte {i}");
        }
        std::fs::write(&path, &good[..i]).unwrap();
        assert!(SpectrumFile::open(&path, None, limits).is_err(), "cut at {i}");
    }
}

#[test]
fn blocks_that_lie_behind_a_good_checksum_never_panic() {
    use crate::archive::segment::{Segment, SegmentKind, SegmentWriter};
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s.seg");
    let builder = small(dir.path());
    let segment = Segment::open(&path, SegmentKind::Spectrum, None).unwrap();
    let mut blocks = vec![vec![]; segment.block_count() as usize];
    (0..).zip(&mut blocks).for_each(|(n, b)| segment.block(n, b).unwrap());
    for block in 0..blocks.len() {
        for at in 0..blocks[block].len().min(80) {
            for with in [0x01, 0x80, 0xff] {
                let mut bad = blocks.clone();
                bad[block][at] ^= with;
                let mut w = SegmentWriter::create(&path, SegmentKind::Spectrum, PLAN).unwrap();
                bad.iter().for_each(|b| _ = w.push_block(b).unwrap());
                w.finish().unwrap();
                if let Ok(file) = SpectrumFile::open(&path, None, Limits::of_mesh(20_000)) {
                    assert!(file.verify(&builder).is_err());
                    let _ = [1.0, 50.0, 198.0].map(|v| file.active(v));
                }
            }
        }
    }
}
