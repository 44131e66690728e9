//! Values fitted to those at the vertices of a mesh: less error at the same points, the same bytes
//! however the work is done, and nothing from beyond a boundary.

use crate::common::*;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{Amount, NanPolicy, ReduceReport, ReduceSettings};
use isospan::sample::Values;
use std::fs;
use std::path::Path;

fn fitted(fraction: f64) -> ReduceSettings {
    ReduceSettings {
        values: Some(Values::Fit),
        amount: Amount::Fraction(fraction),
        chunk_points: 600,
        ..ReduceSettings::default()
    }
}

/// Reduces, replacing what was there.
fn made(input: &Path, settings: &ReduceSettings) -> ReduceReport {
    let out = input.with_extension("isospan");
    let _ = fs::remove_dir_all(&out);
    let report = reduce(input, settings, &out, 2);
    check_archive(&out).unwrap();
    report
}

fn area(archive: &Path, isovalue: f32) -> f64 {
    let out = archive.with_extension("ply");
    surface(archive, isovalue, &out, 1);
    isospan::surface::check::check(&read(&out)).area
}

/// A ball with a hole and a field that bends.
fn write_ball(path: &Path) {
    let radius = |p: [f64; 3]| p.iter().map(|c| (c - 0.5) * (c - 0.5)).sum::<f64>().sqrt();
    write_mesh(
        path,
        18,
        |p| (0.1..0.48).contains(&radius(p)),
        |p| p,
        |p| (7.0 * p[0]).sin() * (6.0 * p[1]).cos() + p[2] * p[2],
    );
}

#[test]
fn the_error_falls() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.vtk");
    write_ball(&input);
    for fraction in [0.5, 0.125] {
        let fit = made(&input, &fitted(fraction)).error.unwrap();
        let sampled =
            made(&input, &ReduceSettings { values: Some(Values::Sample), ..fitted(fraction) }).error.unwrap();
        assert_eq!(fit.measured, sampled.measured, "the same tetrahedra");
        assert!(fit.rms < 0.85 * sampled.rms, "{fraction}: {} {}", fit.rms, sampled.rms);
    }
}

#[test]
fn constants_stay_and_linear_fields_stay_linear() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("shell.vtk");
    let keep = |p: [f64; 3]| (p[0] - 0.5).hypot(p[1] - 0.5) > 0.2;
    write_mesh(&input, 14, keep, |p| [2.0 * p[0], p[1], p[2]], |_| 0.1);
    assert_eq!(made(&input, &fitted(0.3)).range, Some([0.1; 2]));
    write_mesh(&input, 14, keep, |p| p, |p| 100.0 + 3.0 * p[0] - 2.0 * p[1] + p[2]);
    // Values outside of the mesh are those of the boundary there, and a field that goes on flat is
    // not linear.
    let inside = |report: ReduceReport| {
        report.error.unwrap().percentiles.iter().find(|p| p.percent == 50.0).unwrap().error
    };
    assert!(inside(made(&input, &fitted(0.3))) < 1e-4);
    // A box has no such places.
    write_mesh(&input, 14, |_| true, |p| p, |p| 100.0 + 3.0 * p[0] - 2.0 * p[1] + p[2]);
    assert!(made(&input, &fitted(0.3)).error.unwrap().max < 2e-5);
}

#[test]
fn neither_bodies_nor_holes_leak() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("two.vtk");
    let out = input.with_extension("isospan");
    let keep = |p: [f64; 3]| (p[0] - 0.5).abs() > 0.5 / 17.0;
    // In one place, a small gap, an overlap.
    for gap in [0.0, 0.01, -0.1] {
        let place = |p: [f64; 3]| {
            let x = if p[0] < 0.5 { p[0] * 17.0 / 16.0 } else { 1.0 - (1.0 - p[0]) * 17.0 / 16.0 + gap };
            ([x, p[1], p[2]], if p[0] > 0.5 { 11.0 } else { 1.0 })
        };
        write_placed(&input, 17, keep, place);
        let report = made(&input, &fitted(0.4));
        assert_eq!((report.mesh.unwrap().bodies, report.range), (2, Some([1.0, 11.0])), "{gap}");
        assert!([1.01, 5.0, 10.99].iter().all(|&v| area(&out, v) == 0.0), "{gap}: a value between");
        // Each vertex is compared with its own body, but for those deep in another one.
        let error = report.error.unwrap();
        assert_eq!(
            (error.samples, error.max),
            (2 * 18 * 18 * 9, if gap < 0.0 { 10.0 } else { 0.0 }),
            "{gap}"
        );
        let again = measurement(&out, &input).run().unwrap();
        assert_eq!(again.error, error, "{gap}");
    }
    write_mesh(&input, 12, |_| true, |p| p, |p| if p[0] > 0.7 { f64::NAN } else { 7.5 });
    let masked = ReduceSettings { nan: NanPolicy::Mask, ..fitted(0.5) };
    assert_eq!(made(&input, &masked).range, Some([7.5; 2]));
}

#[test]
fn chunks_threads_memory_restarts_and_shards_do_not_show() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.vtk");
    write_ball(&input);
    let mut sets = vec![];
    for chunk_points in [300, 1_000, u64::MAX >> 20] {
        let settings = ReduceSettings { chunk_points, ..fitted(1.6) };
        let out = dir.path().join(format!("{chunk_points}.isospan"));
        let report = reduce(&input, &settings, &out, 2);
        assert!(report.chunks > 4 || chunk_points > 1_000, "{} chunks", report.chunks);
        let file = dir.path().join("s.ply");
        surface(&out, 0.4, &file, 2);
        sets.push((triangle_set(&read(&file)), report.range, report.error));
    }
    assert!(sets[0].0.len() > 500 && sets.iter().all(|s| *s == sets[0]), "chunks");

    let (settings, out) =
        (ReduceSettings { chunk_points: 300, ..fitted(1.6) }, dir.path().join("300.isospan"));
    let expected = folder(&out);
    let [again, shards] = ["again", "shards"].map(|n| dir.path().join(format!("{n}.isospan")));
    let small =
        isospan::pipeline::RunSettings { resources: run(1).resources.with_memory(64 << 20), ..run(1) };
    isospan::pipeline::reduce_series(
        &[StepSource::new(&input, &OpenOptions::default())],
        &settings,
        &again,
        &small,
        &Silent,
    )
    .unwrap();
    assert_eq!(folder(&again), expected, "threads and memory");
    // Killed when the mesh was whole and values were not: what is around each chunk is made again.
    fs::remove_file(again.join("manifest.zst")).unwrap();
    let values = expected.keys().filter(|p| p.to_string_lossy().contains("values-"));
    values.for_each(|p| fs::remove_file(again.join(p)).unwrap());
    reduce(&input, &settings, &again, 2);
    assert_eq!(folder(&again), expected, "restart");
    reduce_in_shards(&input, &settings, &shards);
    assert_eq!(folder(&shards), expected, "shards");
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn real_meshes() {
    let data = shared_data();
    let dir = tempfile::tempdir().unwrap();
    for (name, field) in [("kit_heart_inflation.vtu", "inflation_mm"), ("fim_activation_196k.vtu", "seed1")] {
        let options = OpenOptions { field: Some(field.into()), ..OpenOptions::default() };
        let rms = [Values::Sample, Values::Fit].map(|values| {
            let settings = ReduceSettings {
                values: Some(values),
                amount: Amount::Fraction(0.125),
                ..ReduceSettings::default()
            };
            let out = dir.path().join(format!("{name}-{values:?}.isospan"));
            let input = data.join("meshes").join(name);
            let report = isospan::pipeline::reduce_series(
                &[StepSource::new(&input, &options)],
                &settings,
                &out,
                &run(2),
                &Silent,
            );
            report.unwrap().error.unwrap().rms
        });
        assert!(rms[1] < rms[0], "{name}: {rms:?}");
    }
}
