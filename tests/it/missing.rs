//! Pyramids of volumes with missing samples: known ones are kept as if none were missing, and
//! nothing is made up where they are.

use crate::common::*;
use isospan::Archive;
use isospan::exec::Silent;
use isospan::formats::StepSource;
use isospan::pipeline::{
    self, Bound, LevelChoice, NanPolicy, ReduceReport, ReduceSettings, RunSettings, StepChoice, Target,
};
use isospan::points::SetKind;
use isospan::surface::TriMesh;
use std::path::Path;

fn masked(target: Target) -> ReduceSettings {
    ReduceSettings {
        points: Some(SetKind::Pyramid),
        target: Some(target),
        nan: NanPolicy::Mask,
        ..ReduceSettings::default()
    }
}

/// A wave with noise and an edge, without a ball and without some samples everywhere.
fn holes(x: f64, y: f64, z: f64) -> f64 {
    let noise = (1e4 * (x + 3.7 * y + 9.1 * z).sin()).rem_euclid(1.0);
    let is_missing = noise < 0.004 || ball(x + 0.4, y, z - 0.2) > 0.4 || x > 0.9;
    if is_missing { f64::NAN } else { waves(x, y, z) + 0.05 * noise }
}

/// The samples of a volume, as the file has them.
fn source(dims: [usize; 3], f: impl Fn(f64, f64, f64) -> f64) -> Vec<f64> {
    let unit = |i: usize, n: usize| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
    let one = |i: usize| {
        let [x, y, z] = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
        f64::from(f(unit(x, dims[0]), unit(y, dims[1]), unit(z, dims[2])) as f32)
    };
    (0..dims.iter().product()).map(one).collect()
}

fn make(inputs: &[&Path], settings: &ReduceSettings, out: &Path, run: &RunSettings) -> ReduceReport {
    let sources: Vec<StepSource> = inputs.iter().map(|path| StepSource::from(*path)).collect();
    pipeline::reduce_series(&sources, settings, out, run, &Silent).unwrap()
}

/// The largest error of known samples, and their RMS error. The missing ones are the same.
fn compared(found: &[f64], source: &[f64]) -> (f64, f64) {
    let (mut most, mut sum, mut count) = (0.0f64, 0.0, 0.0);
    for (i, (a, b)) in found.iter().zip(source).enumerate() {
        assert_eq!(a.is_nan(), b.is_nan(), "sample {i}: {a} {b}");
        if !b.is_nan() {
            most = most.max((a - b).abs());
            sum += (a - b).powi(2);
            count += 1.0;
        }
    }
    (most, (sum / count).sqrt())
}

#[test]
fn known_samples_meet_an_error_with_the_same_bytes_for_any_threads_and_memory() {
    let dir = tempfile::tempdir().unwrap();
    for (n, dims) in [[300, 40, 34], [257, 30, 20], [20, 2, 600], [7, 6, 5]].into_iter().enumerate() {
        let input = dir.path().join(format!("{n}.npy"));
        write_npy(&input, dims, holes);
        let source = source(dims, holes);
        let missing = source.iter().filter(|v| v.is_nan()).count() as u64;
        for (m, target) in
            [Target::Rms(Bound::OfRange(0.02)), Target::Max(Bound::OfRange(0.03))].into_iter().enumerate()
        {
            let mut archives = vec![];
            for (threads, memory) in [(1, 1 << 30), (2, 1 << 30), (2, 110 << 20)] {
                let out = dir.path().join(format!("{n}-{m}-{threads}-{memory}.isospan"));
                let run =
                    RunSettings { resources: run(threads).resources.with_memory(memory), ..run(threads) };
                let report = make(&[&input], &masked(target), &out, &run);
                let (error, reached) = (report.error.clone().unwrap(), report.target.unwrap());
                assert!(reached.met, "{dims:?}: {reached:?}");
                assert_eq!((error.missing, error.void), (missing, 0), "{dims:?}");
                assert_eq!(report.void_points, missing);
                let again = error_of(&out, &input);
                assert_eq!((again.rms, again.max), (error.rms, error.max), "the error that is stored");
                let found = samples(&Archive::open(&out).unwrap(), StepChoice::First);
                let (most, rms) = compared(&found, &source);
                assert!((most - error.max).abs() < 1e-6 && (rms - error.rms).abs() < 1e-6, "{dims:?}");
                check_archive(&out).unwrap();
                archives.push(folder(&out));
            }
            assert!(archives.iter().all(|a| *a == archives[0]), "{dims:?}");
        }
    }
}

#[test]
fn shards_have_the_bytes_of_one_run_with_holes() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("a.npy");
    // More chunks than a segment has; some chunks have no sample.
    write_npy(&input, [4400, 12, 9], |x, y, z| if x > 0.3 && x < 0.6 { f64::NAN } else { holes(x, y, z) });
    let [whole, shards] = ["whole", "shards"].map(|name| dir.path().join(format!("{name}.isospan")));
    let settings = masked(Target::Max(Bound::OfRange(0.01)));
    make(&[&input], &settings, &whole, &run(2));
    reduce_in_shards(&input, &settings, &shards);
    let [a, b] = [&whole, &shards].map(|out| folder(out));
    assert!(a.keys().eq(b.keys()) && a == b, "{:?}", b.keys());
    check_archive(&whole).unwrap();
}

/// The samples at the nodes of a level.
fn thinned(values: &[f64], dims: [usize; 3], stride: [usize; 3]) -> (Vec<f64>, [usize; 3]) {
    let nodes: [usize; 3] = std::array::from_fn(|a| dims[a].div_ceil(stride[a]));
    let [nx, ny, nz] = nodes;
    let one = |i: usize| {
        let node = [i % nx, i / nx % ny, i / nx / ny];
        let [x, y, z] = std::array::from_fn(|a| node[a] * stride[a]);
        values[(z * dims[1] + y) * dims[0] + x]
    };
    ((0..nx * ny * nz).map(one).collect(), nodes)
}

/// The values at the corners of a cell.
fn corners(values: &[f64], dims: [usize; 3], [x, y, z]: [usize; 3]) -> [f64; 8] {
    [0, 1, 2, 3, 4, 5, 6, 7]
        .map(|c| values[((z + (c >> 2)) * dims[1] + y + (c >> 1 & 1)) * dims[0] + x + (c & 1)])
}

/// The cell of a level in which a triangle lies, if it is no cap at the domain's end.
fn cell_of(mesh: &TriMesh, triangle: [u32; 3], stride: [usize; 3], dims: [usize; 3]) -> [usize; 3] {
    std::array::from_fn(|a| {
        let sum: f64 = triangle.iter().map(|v| f64::from(mesh.vertices[*v as usize].position[a])).sum();
        ((sum / 3.0 / stride[a] as f64) as usize).min(dims[a] - 2)
    })
}

#[test]
fn no_surface_and_no_cap_lies_in_a_cell_with_a_missing_sample() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    let dims = [300, 40, 34];
    write_npy(&input, dims, holes);
    make(&[&input], &masked(Target::Rms(Bound::OfRange(0.01))), &out, &run(2));
    let archive = Archive::open(&out).unwrap();
    let (values, levels) = (samples(&archive, StepChoice::First), archive.info().unwrap().pyramid);
    for isovalue in [-0.5, 0.1, 0.4] {
        let mut crossed = 0;
        for i in 0..(dims[0] - 1) * (dims[1] - 1) * (dims[2] - 1) {
            let cell =
                [i % (dims[0] - 1), i / (dims[0] - 1) % (dims[1] - 1), i / (dims[0] - 1) / (dims[1] - 1)];
            let nodes = corners(&values, dims, cell);
            let inside = nodes.iter().filter(|v| **v >= isovalue).count();
            crossed += u64::from((1..8).contains(&inside) && !nodes.iter().any(|v| v.is_nan()));
        }
        assert_eq!(archive.count(isovalue).unwrap().active_cells, crossed, "{isovalue}");
        for (level, cap) in [(0, false), (0, true), (1, true), (2, true), (3, true), (4, false)] {
            let stride = levels[level].stride.map(|n| n as usize);
            let (nodes, size) = thinned(&values, dims, stride);
            let choice = LevelChoice::Level(level as u32);
            let mesh = archive.query(isovalue).level(choice).cap(cap).mesh().unwrap();
            assert!(mesh.triangles.len() > 10, "level {level}");
            for &triangle in &mesh.triangles {
                let cell = cell_of(&mesh, triangle, stride, size);
                let nodes = corners(&nodes, size, cell);
                assert!(!nodes.iter().any(|v| v.is_nan()), "level {level}: {cell:?} {nodes:?}");
            }
        }
    }
    // Half way to a missing sample there is no value.
    let at = values.iter().position(|v| v.is_nan()).unwrap();
    let place = [at % dims[0], at / dims[0] % dims[1], at / dims[0] / dims[1]].map(|n| n as f64);
    let beside = [(place[0] - 0.5).max(0.5), place[1], place[2]];
    assert!(archive.probe(&[place, beside]).unwrap().iter().all(|v| v.is_nan()));
    let knots = archive.spectrum().unwrap().knots;
    let knot = &knots[knots.len() / 2];
    assert_eq!(knot.active_cells, archive.count(knot.isovalue).unwrap().active_cells);
}

#[test]
fn steps_have_masks_of_their_own_and_can_be_added() {
    let dir = tempfile::tempdir().unwrap();
    let dims = [60, 40, 34];
    let inputs: Vec<_> = (0..3).map(|t| dir.path().join(format!("{t}.npy"))).collect();
    let field = |t: usize| {
        move |x: f64, y: f64, z: f64| match t {
            1 => waves(x, y, z),
            _ => holes(x - 0.2 * t as f64, y, z) + 0.1 * t as f64,
        }
    };
    inputs.iter().enumerate().for_each(|(t, input)| write_npy(input, dims, field(t)));
    let paths: Vec<&Path> = inputs.iter().map(|path| &**path).collect();
    let [together, grown] = ["together", "grown"].map(|name| dir.path().join(format!("{name}.isospan")));
    let settings = masked(Target::Max(Bound::Value(0.02)));
    make(&paths, &settings, &together, &run(2));
    make(&paths[..1], &settings, &grown, &run(1));
    let added: Vec<StepSource> = paths[1..].iter().map(|path| StepSource::from(*path)).collect();
    addition(&added, &run(2)).append_to(&grown).unwrap();
    assert!(folder(&together) == folder(&grown));
    check_archive(&together).unwrap();
    let archive = Archive::open(&together).unwrap();
    let steps: Vec<Vec<f64>> = (0..3).map(|n| samples(&archive, StepChoice::Number(n))).collect();
    for (t, found) in steps.iter().enumerate() {
        assert!(compared(found, &source(dims, field(t))).0 <= 0.02 + 1e-6, "{t}");
    }
    let between = samples(&archive, StepChoice::Time(1.25));
    for i in 0..between.len() {
        let (a, b) = (steps[1][i], steps[2][i]);
        assert_eq!(between[i].is_nan(), b.is_nan());
        assert!(b.is_nan() || (between[i] - (0.75 * a + 0.25 * b)).abs() < 1e-6);
    }
    let surface = archive.at(StepChoice::Time(1.25)).unwrap().surface(0.1).unwrap();
    assert!(!surface.triangles.is_empty());
}

#[test]
fn whole_numbers_and_declared_values_are_kept_without_loss() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    let dims = [70, 33, 20];
    let whole = |x: f64, y: f64, z: f64| {
        let v = holes(x, y, z);
        if v.is_nan() { -9999.0 } else { (100.0 * v).round() }
    };
    write_npy(&input, dims, whole);
    let settings = ReduceSettings { missing: Some(-9999.0), ..masked(Target::Lossless) };
    let report = make(&[&input], &settings, &out, &run(2));
    assert_eq!(report.error.unwrap().max, 0.0);
    let expected = |v: f64| if v == -9999.0 { f64::NAN } else { v };
    let source: Vec<f64> = source(dims, whole).into_iter().map(expected).collect();
    assert_eq!(compared(&samples(&Archive::open(&out).unwrap(), StepChoice::First), &source).0, 0.0);
    check_archive(&out).unwrap();
}

#[test]
fn a_volume_without_missing_samples_has_the_values_of_one_without_a_mask() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("a.npy");
    write_npy(&input, [300, 20, 17], waves);
    let [with, without] = ["with", "without"].map(|name| dir.path().join(format!("{name}.isospan")));
    let settings = masked(Target::Max(Bound::OfRange(0.02)));
    make(&[&input], &settings, &with, &run(2));
    make(&[&input], &ReduceSettings { nan: NanPolicy::Error, ..settings }, &without, &run(2));
    // Headers have the hash of the step, which tells the policy.
    let sizes = |out: &Path| {
        let files = folder(out).into_iter().filter(|(name, _)| name.extension().is_some_and(|e| e == "seg"));
        files.map(|(name, bytes)| (name, bytes[40..bytes.len() - 48].to_vec())).collect::<Vec<_>>()
    };
    assert!(sizes(&with) == sizes(&without));
}

#[test]
fn a_volume_without_a_sample_is_an_archive_without_a_value() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("a.npy");
    write_npy(&input, [40, 30, 20], |_, _, _| f64::NAN);
    let [pyramid, regular] = ["pyramid", "regular"].map(|name| dir.path().join(format!("{name}.isospan")));
    let settings = masked(Target::Lossless);
    let points = Some(SetKind::Regular);
    make(&[&input], &ReduceSettings { points, target: None, ..settings.clone() }, &regular, &run(2));
    make(&[&input], &settings, &pyramid, &run(2));
    for out in [&pyramid, &regular] {
        check_archive(out).unwrap();
        let archive = Archive::open(out).unwrap();
        assert!(archive.surface(0.0).unwrap().triangles.is_empty());
        assert!(samples(&archive, StepChoice::First).iter().all(|v| v.is_nan()));
        assert_eq!(archive.count(0.0).unwrap().active_cells, 0);
        assert!(archive.spectrum().unwrap().range.is_none());
    }
}

#[test]
fn missing_samples_are_refused_where_nobody_has_said_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("a.npy");
    write_npy(&input, [40, 30, 20], holes);
    let refused = |points| {
        let settings = ReduceSettings { points: Some(points), ..ReduceSettings::default() };
        let sources = [StepSource::from(&*input)];
        let out = dir.path().join("no.isospan");
        let error = pipeline::reduce_series(&sources, &settings, &out, &run(2), &Silent).unwrap_err();
        assert!(!out.join("manifest.zst").exists());
        error.to_string()
    };
    let [pyramid, regular] = [SetKind::Pyramid, SetKind::Regular].map(refused);
    for error in [pyramid, regular] {
        assert!(error.contains("NaN, infinity or a missing value"), "{error}");
        assert!(error.contains("`nan=mask`"), "{error}");
    }
}

#[test]
fn lost_and_damaged_files_are_found_out() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [40, 30, 20], holes);
    let settings = masked(Target::Max(Bound::OfRange(0.05)));
    make(&[&input], &settings, &out, &run(2));
    let before = folder(&out);
    let answer = |out: &Path| -> isospan::Result<(TriMesh, TriMesh)> {
        let archive = Archive::open(out)?;
        Ok((archive.surface(0.1)?, archive.query(0.1).level(LevelChoice::Level(3)).mesh()?))
    };
    let right = answer(&out).unwrap();
    let mut errors = 0;
    for (name, bytes) in &before {
        for at in (0..bytes.len()).step_by(11) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1 << (at % 8);
            std::fs::write(out.join(name), &damaged).unwrap();
            match answer(&out) {
                Ok(found) => assert!(found == right, "{name:?} byte {at}"),
                Err(_) => errors += 1,
            }
        }
        std::fs::write(out.join(name), &bytes[..bytes.len() / 2]).unwrap();
        assert!(answer(&out).is_err(), "{name:?}");
        if name.extension().is_some_and(|e| e == "seg") {
            std::fs::remove_file(out.join(name)).unwrap();
            make(&[&input], &settings, &out, &run(2));
            assert!(folder(&out) == before, "{name:?}");
        }
        std::fs::write(out.join(name), bytes).unwrap();
    }
    assert!(errors > 100 && answer(&out).unwrap() == right);
}
