//! Archives of lattices: their mesh follows by formula, so all that other archives answer must hold
//! without it.

use crate::common::*;
use isospan::Archive;
use isospan::archive::manifest::Manifest;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{
    self, Amount, AppendSettings, Bound, NanPolicy, ReduceSettings, Target, UnpackSettings, ValueBits, unpack,
};
use isospan::points::SetKind;
use isospan::sample::Values;
use std::fs;

fn lattice(amount: Amount, chunk_points: u64) -> ReduceSettings {
    settings(SetKind::Bcc, amount, chunk_points)
}

#[test]
fn a_linear_field_comes_back_up_to_the_faces() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("ramp.npy"), dir.path().join("ramp.isospan"));
    write_npy(&input, [33, 20, 47], |x, y, z| 2.0 * x + 3.0 * y - z);
    for values in [Values::Sample, Values::Fit] {
        for count in [40, 700, 9_000] {
            let settings = ReduceSettings { values, ..lattice(Amount::Count(count), 2_000) };
            let report = reduce(&input, &settings, &out, 2);
            let error = report.error.unwrap();
            assert_eq!((error.samples, error.measured), (33 * 20 * 47, 33 * 20 * 47), "all lie in the mesh");
            assert!(error.max < 1e-5, "{values:?} {count}: {}", error.max);
            assert_eq!(report.range, Some([-6.0, 6.0]), "the corners are points");
            check_archive(&out).unwrap();
            fs::remove_dir_all(&out).unwrap();
        }
    }
}

#[test]
fn cells_of_any_size_are_sound() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [150, 9, 140], waves);
    // Bricks of 8, 4 and 2 cells; cells longer than 64 voxels, whose mesh is stored.
    for (count, stored) in [(20_000, false), (600, false), (120, false), (15, true)] {
        let out = dir.path().join(format!("{count}.isospan"));
        let fitted = ReduceSettings { values: Values::Fit, ..lattice(Amount::Count(count), 250_000) };
        reduce(&input, &fitted, &out, 2);
        assert_eq!(Manifest::read(&out).unwrap().plan.lattice_cells().is_none(), stored, "{count}");
        check_archive(&out).unwrap();
    }
}

#[test]
fn rounded_steps_with_holes_are_the_same_however_they_are_made() {
    let dir = tempfile::tempdir().unwrap();
    let steps: Vec<StepSource> = (0..4)
        .map(|t| {
            let path = dir.path().join(format!("{t}.npy"));
            let moved = 0.05 * f64::from(t);
            write_npy(&path, [40, 36, 34], |x, y, z| {
                if x * x + y * y < 0.02 { f64::NAN } else { waves(x + moved, y, z) }
            });
            StepSource::new(&path, &OpenOptions::default()).at(Some(f64::from(t)))
        })
        .collect();
    let settings = ReduceSettings {
        values: Values::Fit,
        value_bits: ValueBits::Bits(7.0),
        nan: NanPolicy::Mask,
        ..lattice(Amount::Fraction(0.3), 4_000)
    };
    let out = |name: &str| dir.path().join(name);
    let make = |steps: &[StepSource], name: &str, threads| {
        pipeline::reduce_series(steps, &settings, &out(name), &run(threads), &Silent).unwrap()
    };
    make(&steps, "all.isospan", 2);
    make(&steps, "one.isospan", 1);
    assert!(folder(&out("all.isospan")) == folder(&out("one.isospan")), "threads");
    make(&steps[..2], "grown.isospan", 2);
    let more = AppendSettings::default();
    pipeline::append(&steps[2..], &more, &out("grown.isospan"), &run(2), &Silent).unwrap();
    assert!(folder(&out("all.isospan")) == folder(&out("grown.isospan")), "appended");
    check_archive(&out("all.isospan")).unwrap();

    // Packed, unpacked and asked again, in one chunk and in many.
    let (all, large) = (out("all.isospan"), out("large.isospan"));
    let in_one = ReduceSettings { chunk_points: 1_000_000, ..settings.clone() };
    pipeline::reduce_series(&steps, &in_one, &large, &run(2), &Silent).unwrap();
    for step in [0.0, 1.5, 3.0] {
        let choice = pipeline::StepChoice::Time(step);
        let ask = |path: &std::path::Path| {
            let archive = Archive::open(path).unwrap().at(choice.clone()).unwrap();
            [archive.surface(0.1).unwrap(), archive.surface(0.1).unwrap()]
        };
        let [packed, kept] = ask(&all);
        assert!(packed.triangles.len() > 1_000);
        assert_eq!(packed, kept, "kept blocks");
        assert_eq!(triangle_set(&packed), triangle_set(&ask(&large)[0]), "chunks");
        if step == 3.0 {
            let settings = UnpackSettings { step: choice.clone(), ..UnpackSettings::default() };
            assert!(unpack(&all, &settings, &Silent).unwrap().files[0].blocks > 0);
            assert_eq!(packed, ask(&all)[0], "unpacked");
            check_archive(&all).unwrap();
        }
    }
}

#[test]
fn a_surface_of_a_lattice_reads_the_bricks_that_it_crosses() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("ball.npy"), dir.path().join("ball.isospan"));
    write_npy(&input, [90, 90, 90], |x, y, z| (x * x + y * y + z * z).sqrt());
    let rounded =
        ReduceSettings { value_bits: ValueBits::Bits(8.0), ..lattice(Amount::Fraction(0.5), 20_000) };
    let report = reduce(&input, &rounded, &out, 2);
    let small = surface(&out, 0.1, &dir.path().join("s.ply"), 1);
    let large = surface(&out, 0.9, &dir.path().join("l.ply"), 1);
    let read = [&small, &large].map(|r| r.bytes_read as f64 / report.archive_bytes as f64);
    assert!(small.triangles > 500 && read[0] < 0.1 && read[1] < 0.9, "{read:?}");
}

#[test]
fn active_tetrahedra_are_counted_at_any_isovalue() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("waves.npy"), dir.path().join("waves.isospan"));
    write_npy(&input, [50, 46, 40], waves);
    for bits in [ValueBits::Exact, ValueBits::Bits(8.0)] {
        // A small archive has no spectrum.
        for (chunk_points, has_spectrum) in [(5_000, false), (1_000, true)] {
            let settings =
                ReduceSettings { value_bits: bits, ..lattice(Amount::Fraction(0.2), chunk_points) };
            let _ = fs::remove_dir_all(&out);
            reduce(&input, &settings, &out, 2);
            let archive = Archive::open(&out).unwrap();
            // Of these isovalues the spectrum has the first one.
            for (isovalue, is_known) in [(0.5, true), (0.512_345, false), (-1.234_567, false)] {
                let count = archive.count(isovalue).unwrap();
                let made = surface(&out, isovalue, &dir.path().join("s.ply"), 2);
                assert_eq!(count.stored, is_known && has_spectrum, "{isovalue}");
                assert_eq!(count.active_tetrahedra, made.active_tetrahedra, "{isovalue}");
                assert!(made.active_tetrahedra > 500, "{isovalue}");
            }
        }
    }
}

#[test]
fn errors_and_sizes_are_met_by_even_sets() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [70, 60, 50], waves);
    let targets = [
        (SetKind::Bcc, Target::Rms(Bound::OfRange(0.01))),
        (SetKind::Bcc, Target::Rms(Bound::Value(0.02))),
        (SetKind::Bcc, Target::Max(Bound::Value(0.3))),
        (SetKind::Hammersley, Target::Rms(Bound::OfRange(0.01))),
        (SetKind::Bcc, Target::Size(24_000)),
        (SetKind::Bcc, Target::Ratio(60.0)),
        (SetKind::Hammersley, Target::Size(60_000)),
    ];
    for (n, (points, target)) in targets.into_iter().enumerate() {
        // An index more in an archive of several chunks is a step, larger than a size can be near
        // to.
        let is_size = matches!(target, Target::Size(_) | Target::Ratio(_));
        let (target, chunk) = (Some(target), if is_size { 50_000 } else { 5_000 });
        let settings = ReduceSettings {
            target,
            values: Values::Fit,
            ..settings(points, Amount::Fraction(0.125), chunk)
        };
        let outs = [2, 1].map(|threads| dir.path().join(format!("{n}-{threads}.isospan")));
        let [report, again] =
            [(0, 2), (1, 1)].map(|(i, threads)| reduce(&input, &settings, &outs[i], threads));
        assert_eq!(folder(&outs[0]), folder(&outs[1]), "threads");
        let told = report.target.unwrap();
        assert_eq!(again.target, Some(told));
        assert!(told.met && told.reached <= told.bound && told.full_cells.is_none(), "{told:?}");
        let (error, bytes) =
            (report.error.unwrap(), folder(&outs[0]).values().map(|f| f.len() as u64).sum::<u64>());
        assert_eq!(bytes, report.archive_bytes);
        match told.target {
            Target::Rms(_) => assert!(told.reached == error.rms && error.rms > 0.7 * told.bound, "{told:?}"),
            Target::Max(_) => assert!(told.reached == error.max && error.max > 0.5 * told.bound, "{told:?}"),
            Target::Lossless => unreachable!("a lattice has no such target"),
            Target::Size(most) => assert_eq!((told.bound, told.reached), (most as f64, bytes as f64)),
            Target::Ratio(ratio) => assert_eq!(told.bound, report.source_bytes.unwrap() as f64 / ratio),
        }
        if is_size {
            assert!(told.reached > 0.9 * told.bound && error.rms < 0.2, "{told:?} {}", error.rms);
        }
        // Asked again, it is there.
        assert!(reduce(&input, &settings, &outs[0], 2).made_before);
        check_archive(&outs[0]).unwrap();
    }
}

/// Noise has no fewer points than samples: nodes at all of them leave the error of rounding.
#[test]
fn an_error_below_noise_takes_nodes_at_all_samples() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("noise.npy");
    let noise = |x: f64, y: f64, z: f64| (1e4 * (x + 3.7 * y + 9.1 * z).sin()).rem_euclid(1.0);
    write_npy(&input, [20, 18, 16], noise);
    for (n, target) in
        [Target::Rms(Bound::OfRange(0.02)), Target::Max(Bound::Value(0.01))].into_iter().enumerate()
    {
        let out = dir.path().join(format!("{n}.isospan"));
        let settings = ReduceSettings { target: Some(target), ..lattice(Amount::Fraction(0.125), 5_000) };
        let settings = ReduceSettings { value_bits: ValueBits::Usual, ..settings };
        let report = reduce(&input, &settings, &out, 2);
        let told = report.target.unwrap();
        assert!(told.met && told.reached > 0.4 * told.bound, "{told:?}");
        let cells = Manifest::read(&out).unwrap().plan.lattice_cells();
        assert_eq!(cells, Some([19, 17, 15]));
        check_archive(&out).unwrap();
    }
}

#[test]
fn a_size_below_any_archive_is_not_met_and_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("waves.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [20, 20, 20], waves);
    let settings =
        |target| ReduceSettings { target: Some(target), ..lattice(Amount::Fraction(0.125), 5_000) };
    let told = reduce(&input, &settings(Target::Size(100)), &out, 2).target.unwrap();
    assert!(!told.met && told.reached > 100.0, "{told:?}");
    let reduce = |target| {
        let (options, out) = (OpenOptions::default(), dir.path().join("no.isospan"));
        pipeline::reduce_series(
            &[StepSource::new(&input, &options)],
            &settings(target),
            &out,
            &run(2),
            &Silent,
        )
        .unwrap_err()
        .to_string()
    };
    for target in
        [Target::Size(0), Target::Ratio(0.0), Target::Ratio(f64::NAN), Target::Rms(Bound::Value(0.0))]
    {
        let e = reduce(target);
        assert!(e.contains("above 0"), "{e}");
    }
    assert!(!dir.path().join("no.isospan").exists());
}
