//! Meshes with more points where their fields need them: less error, the same bytes however the
//! work is done, a target that is met.

use crate::common::*;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{self, Amount, Bound, ReduceReport, ReduceSettings, RunSettings, Target};
use isospan::points::SetKind;
use std::fs;
use std::path::Path;

fn even(fraction: f64) -> ReduceSettings {
    ReduceSettings {
        points: Some(SetKind::Halton),
        amount: Amount::Fraction(fraction),
        chunk_points: 400,
        ..ReduceSettings::default()
    }
}

fn adapted(fraction: f64) -> ReduceSettings {
    ReduceSettings { adapt: true, ..even(fraction) }
}

/// A ball with a bump of its field near one side.
fn write_ball(path: &Path) {
    let from = |p: [f64; 3], c: [f64; 3]| (0..3).map(|a| (p[a] - c[a]).powi(2)).sum::<f64>();
    let field = move |p: [f64; 3]| 5.0 * (-60.0 * from(p, [0.3, 0.5, 0.5])).exp() + 0.1 * p[0];
    write_mesh(path, 20, |p| from(p, [0.5; 3]) < 0.22, |p| p, field);
}

fn made(input: &Path, settings: &ReduceSettings, name: &str) -> ReduceReport {
    let out = input.with_file_name(name);
    let report = reduce(input, settings, &out, 2);
    check_archive(&out).unwrap();
    report
}

#[test]
fn points_go_where_the_field_bends() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.vtk");
    write_ball(&input);
    let [same, dense] =
        [(even(0.2), "even.isospan"), (adapted(0.2), "dense.isospan")].map(|(s, n)| made(&input, &s, n));
    let filled = |r: &ReduceReport| (r.points - r.void_points) as f64;
    assert!(filled(&dense) < 1.2 * filled(&same), "{} {}", filled(&dense), filled(&same));
    let rms = |r: &ReduceReport| r.error.as_ref().unwrap().rms;
    assert!(rms(&dense) < 0.7 * rms(&same), "{} {}", rms(&dense), rms(&same));
    let summary = summarize(&dir.path().join("dense.isospan")).unwrap();
    assert!(summary.levels.len() > 2, "{:?}", summary.levels);
    // The errors of all levels are those of the field.
    let (error, errors) = (summary.error.unwrap(), summary.levels.iter().map(|l| l.error.unwrap()));
    let (vertices, squares, max) = errors.fold((0, 0.0, 0.0), |(n, sum, max), e| {
        (n + e.samples, sum + e.rms * e.rms * e.samples as f64, f64::max(max, e.max))
    });
    assert_eq!((vertices, max), (error.measured, error.max));
    assert!(((squares / vertices as f64).sqrt() / error.rms - 1.0).abs() < 1e-9, "{squares} {error:?}");
    let file = dir.path().join("s.ply");
    surface(&dir.path().join("dense.isospan"), 2.0, &file, 2);
    let report = isospan::surface::check::check(&read(&file));
    assert!(report.is_oriented() && report.is_manifold() && report.boundary_edges == 0, "{report:?}");
}

#[test]
fn chunks_threads_memory_restarts_and_shards_do_not_show() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.vtk");
    write_ball(&input);
    let mut sets = vec![];
    for chunk_points in [200, u64::MAX >> 20] {
        let settings = ReduceSettings { chunk_points, ..adapted(0.5) };
        let out = dir.path().join(format!("{chunk_points}.isospan"));
        let report = reduce(&input, &settings, &out, 2);
        assert!(report.chunks > 4 || chunk_points > 200, "{} chunks", report.chunks);
        let file = dir.path().join("s.ply");
        surface(&out, 1.0, &file, 2);
        sets.push((triangle_set(&read(&file)), report.range, report.error));
    }
    assert!(sets[0].0.len() > 300 && sets[0] == sets[1], "chunks");
    let (settings, out) =
        (ReduceSettings { chunk_points: 200, ..adapted(0.5) }, dir.path().join("200.isospan"));
    let expected = folder(&out);
    let [again, shards] = ["again", "shards"].map(|n| dir.path().join(format!("{n}.isospan")));
    let small = RunSettings { resources: run(1).resources.with_memory(64 << 20), ..run(1) };
    pipeline::reduce_series(
        &[StepSource::new(&input, &OpenOptions::default())],
        &settings,
        &again,
        &small,
        &Silent,
    )
    .unwrap();
    assert_eq!(folder(&again), expected, "threads and memory");
    fs::remove_file(again.join("manifest.zst")).unwrap();
    fs::remove_file(again.join("mesh/000000.seg")).unwrap();
    reduce(&input, &settings, &again, 2);
    assert_eq!(folder(&again), expected, "restart");
    reduce_in_shards(&input, &settings, &shards);
    assert_eq!(folder(&shards), expected, "shards");
    // Further steps lie on the same points.
    let second = dir.path().join("second.vtk");
    fs::copy(&input, &second).unwrap();
    let sources = [StepSource::new(&second, &OpenOptions::default())];
    addition(&sources, &run(1)).append_to(&out).unwrap();
    check_archive(&out).unwrap();
    let summary = summarize(&out).unwrap();
    let errors: Vec<_> = summary.steps.iter().map(|s| s.error.unwrap()).collect();
    assert_eq!((errors.len(), errors[0]), (2, errors[1]));
}

#[test]
fn a_target_is_met() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.vtk");
    write_ball(&input);
    let with = |target| ReduceSettings { target: Some(target), ..adapted(0.1) };
    let report = made(&input, &with(Target::Rms(Bound::OfRange(0.01))), "rms.isospan");
    let told = report.target.unwrap();
    assert!(told.met && told.reached <= told.bound && told.reached == report.error.unwrap().rms, "{told:?}");
    assert!((told.bound - 0.05).abs() < 0.005 && report.points < report.samples, "{told:?}");
    // The largest error: more points where it is, by any number of threads the same.
    let settings = with(Target::Max(Bound::Value(0.4)));
    let report = made(&input, &settings, "max.isospan");
    let told = report.target.unwrap();
    assert!(told.met && told.reached <= 0.4 && told.reached == report.error.unwrap().max, "{told:?}");
    let again = dir.path().join("again.isospan");
    reduce(&input, &settings, &again, 1);
    assert_eq!(folder(&again), folder(&dir.path().join("max.isospan")), "threads");
    let first = ReduceSettings { target: None, ..settings.clone() };
    let even = made(&input, &ReduceSettings { adapt: false, ..first }, "even.isospan");
    assert!(even.error.unwrap().max > 0.4, "the even points of the fraction do not do");
    let told = made(&input, &with(Target::Max(Bound::Value(1e-7))), "no.isospan").target.unwrap();
    assert!(!told.met && told.reached > told.bound && told.full_cells.unwrap()[0] > 0, "{told:?}");
}
