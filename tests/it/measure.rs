//! An archive carries its error against the samples that it was made from, and it is the one that
//! anybody can work out.

use crate::common::{measurement, reduce, settings, summarize, waves, write_npy};
use isospan::formats::{OpenOptions, open_volume};
use isospan::grid::IndexBox;
use isospan::measure::FieldError;
use isospan::pipeline::{Amount, MeasureReport, NanPolicy, ReduceSettings};
use isospan::points::SetKind;
use isospan::sample::Values;
use isospan::volume::VolumeSource;
use isospan::{Archive, Error, Resources};
use std::path::Path;

fn measured(archive: &Path, input: &Path, threads: usize, map: Option<&Path>) -> MeasureReport {
    let resources = Resources::default().with_threads(threads).with_memory(1 << 30);
    measurement(archive, input).map(map.map(Path::to_path_buf)).resources(resources).run().unwrap()
}

fn stored(archive: &Path) -> FieldError {
    summarize(archive).unwrap().error.expect("it was measured")
}

/// The errors of all samples, by the archive's field at the places of the samples.
fn errors(archive: &Path, input: &Path, dims: [u64; 3]) -> Vec<f64> {
    let VolumeSource::Random(reader) = open_volume(input, &OpenOptions::default()).unwrap() else {
        panic!("mapped")
    };
    let mut originals = vec![0.0; dims.iter().product::<u64>() as usize];
    reader.read_box(IndexBox::whole(dims), &mut originals).unwrap();
    let reduced = Archive::open(archive).unwrap().sample(dims).unwrap();
    reduced.iter().zip(&originals).map(|(r, o)| f64::from(*r as f32 - o)).collect()
}

#[test]
fn the_error_is_that_of_the_probed_field() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("waves.npy"), dir.path().join("waves.isospan"));
    write_npy(&input, [31, 28, 25], waves);
    for (kind, bits) in [(SetKind::Hammersley, None), (SetKind::Regular, Some(6.0))] {
        let settings = ReduceSettings { value_bits: bits, ..settings(kind, Amount::Fraction(0.2), 1_000) };
        let _ = std::fs::remove_dir_all(&out);
        reduce(&input, &settings, &out, 2);
        let e = stored(&out);
        let errors = errors(&out, &input, [31, 28, 25]);
        let n = errors.len() as f64;
        assert_eq!((e.samples, e.measured), (errors.len() as u64, errors.len() as u64));
        let near = |told: f64, sum: f64| {
            assert!((told - sum / n).abs() <= 1e-6 * told.abs().max(1e-4), "{told} {}", sum / n)
        };
        near(e.rms * e.rms, errors.iter().map(|x| x * x).sum());
        near(e.mean, errors.iter().map(|x| x.abs()).sum());
        near(e.bias, errors.iter().sum());
        let max = errors.iter().map(|x| x.abs()).max_by(f64::total_cmp).unwrap();
        let worst = e.worst.unwrap();
        // Symmetric samples may have errors that differ by rounding alone.
        let at = worst.sample as usize;
        assert!((errors[at].abs() - max).abs() <= 1e-6 * max, "{} {max}", errors[at]);
        assert!((e.max - max).abs() <= 1e-6 * max && e.max > 0.01, "{} {max}", e.max);
        assert_eq!(worst.index, Some([at as u64 % 31, at as u64 / 31 % 28, at as u64 / 31 / 28]));
        assert_eq!(worst.world, worst.index.unwrap().map(|i| i as f64), "the file has no geometry");
        assert!(((worst.reduced - worst.original).abs() - max).abs() < 1e-6);
    }
}

#[test]
fn measuring_again_gives_the_same_bits_for_any_threads_and_chunks() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [40, 33, 29], waves);
    let mut all = vec![];
    for (threads, chunk) in [(1, 500), (2, 2_000), (2, 100_000)] {
        let out = dir.path().join(format!("{chunk}.isospan"));
        let report =
            reduce(&input, &settings(SetKind::Halton, Amount::Fraction(0.125), chunk), &out, threads);
        let again = measured(&out, &input, 3 - threads, None);
        assert!(again.same_source && report.error.as_ref() == Some(&again.error));
        all.push(stored(&out));
        assert_eq!(all[0], again.error);
    }
    assert!(all.iter().all(|e| *e == all[0]), "{all:?}");
}

#[test]
fn a_linear_field_has_no_error_and_none_is_stored_when_not_wanted() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("plane.npy"), dir.path().join("plane.isospan"));
    write_npy(&input, [20, 21, 22], |x, y, z| 3.0 + x - 2.0 * y + 0.5 * z);
    reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(0.1), 5_000), &out, 1);
    let e = stored(&out);
    assert!(e.max < 2e-6 && e.percentiles[5].error <= e.max, "{e:?}");
    let quiet = dir.path().join("quiet.isospan");
    let exact = ReduceSettings::exact(SetKind::Hammersley);
    reduce(&input, &ReduceSettings { measure: false, ..exact }, &quiet, 1);
    assert!(summarize(&quiet).unwrap().error.is_none());
    assert!(measured(&quiet, &input, 1, None).error.max < 2e-6);
    // Another field on the same grid can be measured too, and is distinguished from the source.
    let other = dir.path().join("other.npy");
    write_npy(&other, [20, 21, 22], |x, y, z| 3.25 + x - 2.0 * y + 0.5 * z);
    let report = measured(&quiet, &other, 1, None);
    assert!(!report.same_source && (report.error.bias + 0.25).abs() < 1e-6, "{:?}", report.error);
}

#[test]
fn missing_samples_and_void_tetrahedra_are_counted_apart() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("hole.npy"), dir.path().join("hole.isospan"));
    let hole = |x: f64, y: f64, z: f64| if x * x + y * y + z * z < 0.1 { f64::NAN } else { waves(x, y, z) };
    write_npy(&input, [24, 24, 24], hole);
    let masked = ReduceSettings {
        nan: NanPolicy::Mask,
        ..settings(SetKind::Hammersley, Amount::Fraction(0.25), 2_000)
    };
    reduce(&input, &masked, &out, 2);
    let e = stored(&out);
    let unit = |i: u64| 2.0 * i as f64 / 23.0 - 1.0;
    let missing =
        (0..24u64.pow(3)).filter(|n| hole(unit(n % 24), unit(n / 24 % 24), unit(n / 576)).is_nan()).count();
    assert_eq!((e.missing, e.missing + e.void + e.measured), (missing as u64, 24 * 24 * 24));
    assert!(e.void > 0 && e.outside == 0);
    // A value that stands for missing samples is what the field was taken to be there.
    let filled = dir.path().join("filled.isospan");
    reduce(&input, &ReduceSettings { nan: NanPolicy::Value(7.0), ..masked }, &filled, 2);
    let e = stored(&filled);
    assert_eq!((e.missing, e.void, e.measured), (0, 0, 24 * 24 * 24));
    assert_eq!(measured(&filled, &input, 2, None).error, e);
    assert!(e.max > 1.0, "the edge of the hole is not reproduced");
}

#[test]
fn a_map_has_the_errors_of_all_bricks() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("waves.npy"), dir.path().join("waves.isospan"));
    write_npy(&input, [45, 40, 35], waves);
    reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(0.3), 3_000), &out, 2);
    let maps = ["a.vti", "b.vti"].map(|name| dir.path().join(name));
    let report = measured(&out, &input, 1, Some(&maps[0]));
    measured(&out, &input, 2, Some(&maps[1]));
    let [a, b] = maps.map(|m| std::fs::read(m).unwrap());
    assert!(a == b, "the same bytes for any threads");
    let bricks = report.map_bricks.unwrap().iter().product::<u64>() as usize;
    assert!(bricks > 8);
    let data = &a[a.windows(4).position(|w| w == b"   _").unwrap() + 4..];
    let f32s = |at: usize| {
        data[at..at + 4 * bricks].chunks(4).map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap())))
    };
    let rms: Vec<f64> = f32s(8).collect();
    let max = f32s(16 + 4 * bricks).fold(0.0, f64::max);
    let counts: Vec<u64> = data[24 + 8 * bricks..][..8 * bricks]
        .chunks(8)
        .map(|b| u64::from_le_bytes(b.try_into().unwrap()))
        .collect();
    assert_eq!((counts.iter().sum::<u64>(), max), (report.error.measured, report.error.max));
    let squares: f64 = rms.iter().zip(&counts).map(|(r, &n)| r * r * n as f64).sum();
    assert!(((squares / report.error.measured as f64).sqrt() / report.error.rms - 1.0).abs() < 1e-5);
}

#[test]
fn another_input_is_refused_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let (input, other) = (dir.path().join("a.npy"), dir.path().join("b.npy"));
    write_npy(&input, [12, 12, 12], waves);
    write_npy(&other, [12, 12, 13], waves);
    let out = dir.path().join("a.isospan");
    reduce(&input, &ReduceSettings::exact(SetKind::Regular), &out, 1);
    let refused = |input: &Path, memory: u64| {
        measurement(&out, input).resources(Resources::default().with_memory(memory)).run().unwrap_err()
    };
    let e = refused(&other, 1 << 30).to_string();
    assert!(
        e.contains("expected a volume of 12 x 12 x 12 samples, got a volume of 12 x 12 x 13 samples"),
        "{e}"
    );
    assert!(matches!(refused(&input, 1 << 20), Error::Budget { .. }));
}

#[test]
fn the_range_is_that_of_the_source() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("peak.npy"), dir.path().join("peak.isospan"));
    // A peak that few points see, and a sample next to it that is missing.
    let is_at = |a: f64, b: f64| (a - b).abs() < 1e-9;
    write_npy(&input, [21, 19, 23], |x, y, z| {
        if is_at(x, 0.0) && is_at(y, 0.0) && is_at(z, 0.0) {
            100.0
        } else if is_at(x, -1.0) && is_at(y, 0.0) {
            f64::NAN
        } else {
            -(x * y)
        }
    });
    for values in [Values::Sample, Values::Fit] {
        for chunk_points in [300, 100_000] {
            let base = settings(SetKind::Hammersley, Amount::Fraction(0.05), chunk_points);
            let settings = ReduceSettings { values: Some(values), nan: NanPolicy::Mask, ..base };
            let _ = std::fs::remove_dir_all(&out);
            reduce(&input, &settings, &out, 2);
            let report = measured(&out, &input, 2, None);
            assert_eq!(report.error.source_range, Some([-1.0, 100.0]));
            assert!(report.range.unwrap()[1] < 50.0, "the reduced field has another one: {:?}", report.range);
            assert_eq!(stored(&out), report.error);
        }
    }
}
