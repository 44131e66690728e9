//! Points that are dense where the field needs them: the same mesh for any chunks, threads,
//! restarts and shards, and less error for as many points.

use crate::common::*;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{self, Amount, Bound, LevelSummary, NanPolicy, ReduceSettings, RunSettings, Target};
use isospan::points::SetKind;
use isospan::sample::Values;
use std::fs;
use std::path::Path;

const DIMS: [usize; 3] = [60, 44, 38];

/// A ball with a soft edge off the middle, in a field that is nearly flat; coordinates are -1 to 1.
fn ball(x: f64, y: f64, z: f64) -> f64 {
    let [x, y, z] = [(x, 59.0), (y, 43.0), (z, 37.0)].map(|(unit, last)| (unit + 1.0) / 2.0 * last);
    let d = ((x - 20.0).powi(2) + (y - 22.0).powi(2) + (z - 15.0).powi(2)).sqrt();
    10.0 / (1.0 + ((d - 9.0) / 0.8).exp()) + 0.001 * x
}

fn adapted(fraction: f64, chunk_points: u64) -> ReduceSettings {
    let even = settings(SetKind::Halton, Amount::Fraction(fraction), chunk_points);
    ReduceSettings { adapt: true, ..even }
}

fn rms(archive: &Path) -> f64 {
    summarize(archive).unwrap().error.expect("it was measured").rms
}

#[test]
fn neither_chunks_nor_threads_show_where_the_density_differs() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.npy");
    write_npy(&input, DIMS, ball);
    for values in [Values::Sample, Values::Fit] {
        let mut sets = vec![];
        for chunk_points in [400, 2_500, u64::MAX >> 20] {
            let settings = ReduceSettings { values: Some(values), ..adapted(0.06, chunk_points) };
            let out = dir.path().join(format!("{values:?}-{chunk_points}.isospan"));
            let report = reduce(&input, &settings, &out, 2);
            assert!(report.chunks > 3 || chunk_points > 400, "{} chunks", report.chunks);
            assert!(check_archive(&out).is_ok(), "sound");
            let again = dir.path().join("again.isospan");
            reduce(&input, &settings, &again, 1);
            assert_eq!(folder(&out), folder(&again), "threads");
            fs::remove_dir_all(&again).unwrap();
            let file = dir.path().join("s.ply");
            surface(&out, 5.0, &file, 2);
            sets.push((triangle_set(&read(&file)), report.points, report.tetrahedra, report.error));
        }
        assert!(sets[0].0.len() > 1000 && sets.iter().all(|s| *s == sets[0]), "chunks");
    }
}

#[test]
fn shards_and_restarts_make_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.npy");
    write_npy(&input, DIMS, ball);
    let settings = adapted(0.2, 150);
    let [whole, parts] = ["whole", "parts"].map(|n| dir.path().join(format!("{n}.isospan")));
    reduce(&input, &settings, &whole, 2);
    let expected = folder(&whole);
    reduce_in_shards(&input, &settings, &parts);
    assert_eq!(folder(&parts), expected, "shards");
    // Killed before the manifest, and with a segment missing: the same command continues.
    let segments =
        expected.keys().filter(|p| p.starts_with("mesh/000000.seg") || p.ends_with("manifest.zst"));
    segments.for_each(|p| fs::remove_file(whole.join(p)).unwrap());
    reduce(&input, &settings, &whole, 1);
    assert_eq!(folder(&whole), expected, "restart");
    // Without its levels an archive cannot be read; with damaged ones neither.
    let summary = summarize(&whole).unwrap();
    let [voxels, points] = [|l: &LevelSummary| l.voxels, |l: &LevelSummary| l.points]
        .map(|of| summary.levels.iter().map(of).sum::<u64>());
    assert_eq!(voxels, 59 * 43 * 37);
    assert!(points < summary.points && points * 3 > summary.points * 2, "{points} of {}", summary.points);
    // The errors of all levels are those of the field.
    let (error, errors) = (summary.error.unwrap(), summary.levels.iter().map(|l| l.error.unwrap()));
    let (samples, squares, max) = errors.fold((0, 0.0, 0.0), |(n, sum, max), e| {
        (n + e.samples, sum + e.rms * e.rms * e.samples as f64, f64::max(max, e.max))
    });
    assert_eq!((samples, max), (error.measured, error.max));
    assert!(((squares / samples as f64).sqrt() / error.rms - 1.0).abs() < 1e-9, "{squares} {error:?}");
    let bytes = summary.levels.iter().map(|l| l.bytes).sum::<u64>();
    assert!(bytes < summary.bytes && bytes * 2 > summary.bytes, "{bytes} of {}", summary.bytes);
    let levels = whole.join("mesh/levels.seg");
    let mut bytes = fs::read(&levels).unwrap();
    bytes[60] ^= 1;
    fs::write(&levels, bytes).unwrap();
    let error = check_archive(&whole).unwrap_err().to_string();
    assert!(error.contains("levels.seg"), "{error}");
    fs::remove_file(&levels).unwrap();
    let error = check_archive(&whole).unwrap_err().to_string();
    assert!(error.contains("levels.seg"), "{error}");
}

#[test]
fn fewer_points_do_where_the_field_is_flat() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("ball.npy"), dir.path().join("a.isospan"));
    write_npy(&input, DIMS, ball);
    let made = |settings: &ReduceSettings| {
        let _ = fs::remove_dir_all(&out);
        let report = reduce(&input, settings, &out, 2);
        (report.points, rms(&out))
    };
    let (points, error) = made(&adapted(1.0 / 64.0, 50_000));
    let (many, even) = made(&settings(SetKind::Hammersley, Amount::Fraction(1.0 / 16.0), 50_000));
    assert!(error < even && points * 4 < many, "{error} with {points}, {even} with {many}");
    // Only the outer part of the edge is looked at: it is met better, by the same number of points.
    let focus = Some([0.2, 2.0].into());
    let focused = |s: ReduceSettings| ReduceSettings { focus, ..s };
    let (near, error_of_all) = made(&focused(adapted(1.0 / 64.0, 50_000)));
    assert!(error_of_all > error, "what is out of focus is paid for: {error_of_all} {error}");
    assert!(near.abs_diff(points) * 3 < points, "{near} {points}");
}

#[test]
fn a_hole_in_the_data_does_not_grow() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("hole.npy"), dir.path().join("hole.isospan"));
    write_npy(&input, DIMS, |x, y, z| if x > 0.36 { f64::NAN } else { ball(x, y, z) });
    let even =
        ReduceSettings { nan: NanPolicy::Mask, ..settings(SetKind::Halton, Amount::Fraction(0.1), 50_000) };
    let measured = |settings: &ReduceSettings| {
        let _ = fs::remove_dir_all(&out);
        reduce(&input, settings, &out, 2).error.expect("it was measured").measured
    };
    let [before, after] = [&even, &ReduceSettings { adapt: true, ..even.clone() }].map(measured);
    assert!(after * 20 > before * 19, "{after} of {before} samples have a value");
}

#[test]
fn targets_are_met_by_few_points_and_measured() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.npy");
    write_npy(&input, DIMS, ball);
    let targets = [
        (Target::Rms(Bound::Value(0.05)), Values::Sample),
        (Target::Rms(Bound::OfRange(0.005)), Values::Fit),
        (Target::Max(Bound::Value(2.0)), Values::Fit),
    ];
    for (n, (target, values)) in targets.into_iter().enumerate() {
        let settings = ReduceSettings { target: Some(target), values: Some(values), ..adapted(0.1, 2_500) };
        let outs = [2, 1].map(|threads| dir.path().join(format!("{n}-{threads}.isospan")));
        let reports = [(0, 2), (1, 1)].map(|(i, threads)| reduce(&input, &settings, &outs[i], threads));
        assert_eq!(folder(&outs[0]), folder(&outs[1]), "threads");
        assert!(!dir.path().join(format!("{n}-2.isospan.work")).exists(), "tries are gone");
        let told = reports[0].target.expect("it had a target");
        let error = summarize(&outs[0]).unwrap().error.expect("it was measured");
        let measured = if matches!(target, Target::Max(_)) { error.max } else { error.rms };
        assert!(told.met && measured <= told.bound && measured == told.reached, "{told:?}");
        // Fewer than the best even density that does as well.
        let even = |fraction: f64| {
            let out = dir.path().join("even.isospan");
            let _ = fs::remove_dir_all(&out);
            let even = settings_of(fraction, values);
            let report = reduce(&input, &even, &out, 2);
            let error = report.error.unwrap();
            (report.points, if matches!(target, Target::Max(_)) { error.max } else { error.rms })
        };
        let (points, error) = even(reports[0].points as f64 / 100_000.0);
        assert!(error > told.bound, "{} points do; {points} even ones: {error} {told:?}", reports[0].points);
    }
}

#[test]
fn a_peak_is_met_where_a_point_a_sample_does_not_do() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("peak.npy");
    let peak = |x: f64, y: f64, z: f64| (-9.0 * ((x - 0.1).powi(2) + y * y + (z + 0.2).powi(2)).sqrt()).exp();
    write_npy(&input, [45, 41, 43], peak);
    let made = |settings: &ReduceSettings, name: &str| reduce(&input, settings, &dir.path().join(name), 2);
    let most = made(&settings(SetKind::Halton, Amount::Fraction(1.0), 50_000), "most.isospan");
    let bound = most.error.unwrap().max / 2.0;
    let target = Some(Target::Max(Bound::Value(bound)));
    let report = made(&ReduceSettings { target, ..adapted(0.1, 2_500) }, "peak.isospan");
    let told = report.target.unwrap();
    assert!(told.met && told.reached <= bound && report.error.unwrap().max == told.reached, "{told:?}");
    assert!(report.points * 2 < most.points, "{} points of {}", report.points, most.points);
}

fn settings_of(fraction: f64, values: Values) -> ReduceSettings {
    ReduceSettings {
        values: Some(values),
        ..settings(SetKind::Hammersley, Amount::Fraction(fraction), 50_000)
    }
}

#[test]
fn what_cannot_be_met_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("noise.npy"), dir.path().join("a.isospan"));
    let noise = |x: f64, y: f64, z: f64| (x * 7919.0 + y * 104_729.0 + z * 1_299_709.0).sin();
    write_npy(&input, [16, 14, 12], noise);
    let target = Some(Target::Rms(Bound::Value(1e-4)));
    let report = reduce(&input, &ReduceSettings { target, ..adapted(0.1, 2_500) }, &out, 2);
    let told = report.target.unwrap();
    assert!(
        !told.met && told.reached > 0.01 && told.full_cells.unwrap()[0] == told.full_cells.unwrap()[1],
        "{told:?}"
    );
    assert!(check_archive(&out).is_ok());
}

#[test]
fn what_cannot_be_is_a_usage_error() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("ball.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [20, 20, 20], ball);
    let refused = |settings: ReduceSettings, word: &str| {
        let run = RunSettings::default();
        let error = pipeline::reduce_series(
            &[StepSource::new(&input, &OpenOptions::default())],
            &settings,
            &out,
            &run,
            &Silent,
        )
        .unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains(word), "{error}");
    };
    refused(ReduceSettings { points: Some(SetKind::Regular), ..adapted(0.1, 1_000) }, "halton");
    let focus = Some([3.0, 3.0].into());
    refused(ReduceSettings { focus, ..adapted(0.1, 1_000) }, "focus");
    let target = Some(Target::Rms(Bound::Value(0.0)));
    refused(ReduceSettings { target, ..adapted(0.1, 1_000) }, "above 0");
}

/// How finely a spectrum is measured follows from the set's number of points, which is that of an
/// archive only nearly: on this way the two were a step of the grid apart, and chunks could not be
/// added up.
#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn spectra_are_added_up_as_chunks_were_measured() {
    let shared = shared_data();
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (shared.join("volumes/brain_mr_i16_gzip.nrrd"), dir.path().join("brain.isospan"));
    let target = Some(Target::Rms(Bound::Value(136.43)));
    let settings = ReduceSettings {
        target,
        nan: NanPolicy::Value(0.0),
        values: Some(Values::Fit),
        ..adapted(0.1, 250_000)
    };
    let report = reduce(&input, &settings, &out, 2);
    assert!(report.target.unwrap().met && report.points * 9 < 245_800, "{} points", report.points);
    assert!(check_archive(&out).is_ok());
}
