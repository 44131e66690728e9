//! The same input and parameters give the same bytes: for any number of threads and any restart;
//! and for any chunk size the same triangles.

use crate::common::*;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::measure::FieldError;
use isospan::pipeline::{self, Amount, ReduceSettings, RunSettings};
use isospan::points::SetKind;
use isospan::sample::Values;
use std::fs;

const AMOUNT: Amount = Amount::Fraction(0.5);

#[test]
fn threads_do_not_show_in_the_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [50, 40, 30], waves);
    let settings = settings(SetKind::Halton, AMOUNT, 4_000);
    let mut archives = vec![];
    let mut surfaces = vec![];
    for threads in [1, 2, 5] {
        let out = dir.path().join(format!("t{threads}.isospan"));
        let report = reduce(&input, &settings, &out, threads);
        assert!(report.chunks > 5, "several chunks");
        let file = dir.path().join(format!("t{threads}.ply"));
        surface(&out, 0.2, &file, threads);
        archives.push(folder(&out));
        surfaces.push(fs::read(&file).unwrap());
    }
    assert!(archives.iter().all(|a| *a == archives[0]));
    assert!(surfaces.iter().all(|s| *s == surfaces[0]));
}

#[test]
fn chunk_sizes_do_not_show_in_the_triangles() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [44, 52, 36], waves);
    for kind in SetKind::ALL {
        let mut sets = vec![];
        for chunk_points in [1_000, 7_000, u64::MAX >> 20] {
            let out = dir.path().join(format!("{kind}-{chunk_points}.isospan"));
            reduce(&input, &settings(kind, AMOUNT, chunk_points), &out, 2);
            let file = dir.path().join("s.ply");
            surface(&out, -0.1, &file, 2);
            sets.push(triangle_set(&read(&file)));
        }
        assert!(sets[0].len() > 1000, "{kind}");
        assert!(sets.iter().all(|s| *s == sets[0]), "{kind}");
    }
}

#[test]
fn neither_threads_nor_chunks_show_in_fitted_values() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [44, 52, 36], waves);
    for kind in [SetKind::Hammersley, SetKind::Regular, SetKind::HyperbolicCross] {
        let sampled = settings(kind, Amount::Fraction(0.2), 1_000);
        let mut sets = vec![];
        for chunk_points in [1_000, 4_000, u64::MAX >> 20] {
            let fit = ReduceSettings { values: Some(Values::Fit), chunk_points, ..sampled.clone() };
            let out = dir.path().join(format!("{kind}-{chunk_points}.isospan"));
            let report = reduce(&input, &fit, &out, 2);
            let again = dir.path().join("again.isospan");
            reduce(&input, &fit, &again, 1);
            assert_eq!(folder(&out), folder(&again), "{kind}: threads");
            fs::remove_dir_all(&again).unwrap();
            let file = dir.path().join("s.ply");
            surface(&out, -0.1, &file, 2);
            sets.push((triangle_set(&read(&file)), report.range, report.error));
        }
        let error = reduce(&input, &sampled, &dir.path().join(format!("{kind}.isospan")), 2).error;
        let rms = |e: &Option<FieldError>| e.as_ref().unwrap().rms;
        assert!(rms(&sets[0].2) < 0.85 * rms(&error), "{kind}: {:?} {error:?}", sets[0].2);
        assert!(sets[0].0.len() > 1000 && sets.iter().all(|s| *s == sets[0]), "{kind}: chunks");
    }
}

#[test]
fn an_interrupted_reduction_continues_to_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [60, 50, 40], waves);
    let settings = settings(SetKind::Hammersley, AMOUNT, 2_000);
    let whole = dir.path().join("whole.isospan");
    reduce(&input, &settings, &whole, 2);
    let expected = folder(&whole);
    assert!(expected.len() > 6, "several segments");
    for lost in [0, 2, 4] {
        // What a kill leaves: no manifest, a segment missing, another one cut short, a temporary
        // file.
        let out = dir.path().join(format!("lost{lost}.isospan"));
        reduce(&input, &settings, &out, 1);
        fs::remove_file(out.join("manifest.zst")).unwrap();
        let files: Vec<_> =
            folder(&out).into_keys().filter(|f| f.extension().is_some_and(|e| e == "seg")).collect();
        fs::remove_file(out.join(&files[lost])).unwrap();
        let cut = out.join(&files[lost + 1]);
        fs::write(&cut, &fs::read(&cut).unwrap()[..100]).unwrap();
        reduce(&input, &settings, &out, 2);
        assert_eq!(folder(&out), expected);
    }
}

#[test]
fn segments_of_another_plan_are_not_taken() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [30, 30, 30], waves);
    let out = dir.path().join("a.isospan");
    reduce(&input, &settings(SetKind::Halton, AMOUNT, 5_000), &out, 2);
    fs::remove_file(out.join("manifest.zst")).unwrap();
    let other = settings(SetKind::Halton, Amount::Fraction(0.4), 5_000);
    let anew = |replace| {
        let run = RunSettings { replace, ..run(2) };
        pipeline::reduce_series(
            &[StepSource::new(&input, &OpenOptions::default())],
            &other,
            &out,
            &run,
            &Silent,
        )
    };
    let error = anew(false).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("unfinished work"), "{error}");
    anew(true).unwrap();
    let fresh = dir.path().join("b.isospan");
    reduce(&input, &other, &fresh, 2);
    assert_eq!(folder(&out), folder(&fresh));
}

#[test]
fn rounded_values_are_the_same_in_all_chunks_and_smaller() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [44, 52, 36], waves);
    let mut sets = vec![];
    for chunk_points in [1_000, 7_000] {
        let lossless = settings(SetKind::Halton, AMOUNT, chunk_points);
        let rounded = ReduceSettings { value_bits: Some(10.0), ..lossless.clone() };
        let out = dir.path().join(format!("{chunk_points}.isospan"));
        let report = reduce(&input, &rounded, &out, 2);
        let quantiser = report.quantiser.unwrap();
        // Waves have a range of about 4.
        assert!(quantiser.bits == 10.0 && (0.001..0.003).contains(&quantiser.bound), "{quantiser:?}");
        check_archive(&out).unwrap();
        let whole = reduce(&input, &lossless, &dir.path().join(format!("{chunk_points}-whole.isospan")), 2);
        assert!(report.archive_bytes * 10 < whole.archive_bytes * 9);
        assert_eq!(whole.quantiser, None);
        let file = dir.path().join("s.ply");
        surface(&out, -0.1, &file, 2);
        sets.push(triangle_set(&read(&file)));
    }
    assert!(sets[0].len() > 1000 && sets[0] == sets[1]);
}

#[test]
fn zeros_have_no_sign() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("zeros.npy");
    // The largest values are zeros of both signs: which of them is the largest one differs from
    // machine to machine.
    write_npy(&input, [24, 22, 20], |x, y, z| if x > y { -0.5 - x.abs() } else { 0f64.copysign(z) });
    let out = dir.path().join("zeros.isospan");
    let report = reduce(&input, &settings(SetKind::Regular, Amount::Fraction(1.0), 2_000), &out, 2);
    assert_eq!(report.range.map(|range| range.map(f64::to_bits)), Some([-1.5f64, 0.0].map(f64::to_bits)));
    check_archive(&out).unwrap();
}
