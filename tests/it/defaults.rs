//! What a reduction makes of a volume or a mesh without any choices of the user.

use crate::common::{ball, folder, reduce, reduce_in_shards, run, summarize, waves, write_mesh, write_npy};
use isospan::archive::manifest::Manifest;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{self, Amount, AppendSettings, ReduceSettings, ValueBits};
use isospan::points::{SetKind, SetSettings};
use isospan::sample::{Interpolation, Values};
use std::path::Path;

const USUAL: f64 = ValueBits::USUAL;

fn bits(input: &Path, settings: &ReduceSettings) -> Option<f64> {
    let out = input.with_extension("isospan");
    let _ = std::fs::remove_dir_all(&out);
    reduce(input, settings, &out, 2).quantiser.map(|q| q.bits)
}

#[test]
fn a_volume_becomes_a_lattice_of_rounded_values_that_are_fitted() {
    let dir = tempfile::tempdir().unwrap();
    let [input, usual, named, exact] =
        ["v.npy", "usual.isospan", "named.isospan", "exact.isospan"].map(|n| dir.path().join(n));
    write_npy(&input, [44, 40, 36], waves);
    let report = reduce(&input, &ReduceSettings::default(), &usual, 2);
    assert_eq!(report.quantiser.unwrap().bits, USUAL);
    let all_named = ReduceSettings {
        points: Some(SetKind::Bcc),
        amount: Amount::Fraction(0.125),
        interpolation: Interpolation::Linear,
        values: Values::Fit,
        value_bits: ValueBits::Bits(USUAL),
        ..ReduceSettings::default()
    };
    reduce(&input, &all_named, &named, 2);
    assert!(folder(&usual) == folder(&named));
    // A quarter of a percent of the range is little to what the points leave.
    let not_rounded = reduce(&input, &ReduceSettings { values: Values::Fit, ..lattice() }, &exact, 2);
    let rms = [&report, &not_rounded].map(|r| r.error.as_ref().unwrap().rms);
    assert!(rms[0] < 1.05 * rms[1], "{rms:?}");
    assert!(2 * report.archive_bytes < not_rounded.archive_bytes);
}

fn lattice() -> ReduceSettings {
    ReduceSettings::exact(SetKind::Bcc)
}

#[test]
fn one_value_far_off_leaves_the_others_their_steps() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("v.npy");
    let with = |far: f64| {
        let at_the_middle = |x: f64, y: f64, z: f64| x * x + y * y + z * z < 2e-3;
        let field = |x, y, z| waves(x, y, z) + if at_the_middle(x, y, z) { far } else { 0.0 };
        write_npy(&input, [40, 40, 40], field);
        let out = dir.path().join("v.isospan");
        let _ = std::fs::remove_dir_all(&out);
        reduce(&input, &ReduceSettings::default(), &out, 2).quantiser
    };
    let plain = with(0.0).unwrap();
    for far in [30.0, 1e4, -1e4] {
        let stretched = with(far).unwrap();
        assert!(stretched.bits > USUAL, "{far}: {stretched:?}");
        assert!(
            stretched.step > 0.4 * plain.step && stretched.step < 2.1 * plain.step,
            "{far}: {stretched:?}"
        );
    }
    assert!(with(1e30).is_none());
}

#[test]
fn labels_and_what_is_asked_for_are_exact() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("v.npy");
    write_npy(&input, [24, 22, 20], |x, y, z| (4.0 * waves(x, y, z)).round());
    let usual = ReduceSettings::default();
    assert_eq!(bits(&input, &usual), Some(USUAL));
    let nearest = Interpolation::Nearest;
    let labels = ReduceSettings { interpolation: nearest, values: Values::Sample, ..usual.clone() };
    assert_eq!(bits(&input, &labels), None);
    assert_eq!(bits(&input, &lattice()), None);
    let points = Some(SetKind::Hammersley);
    assert_eq!(bits(&input, &ReduceSettings { points, ..usual.clone() }), None);
    let twelve = ValueBits::Bits(12.0);
    assert_eq!(bits(&input, &ReduceSettings { value_bits: twelve, ..labels }), Some(12.0));
    // One value alone has no range to round in.
    write_npy(&input, [24, 22, 20], |_, _, _| 7.0);
    assert_eq!(bits(&input, &usual), Some(USUAL));
    let error = summarize(&input.with_extension("isospan")).unwrap().error.unwrap();
    assert_eq!(error.max, 0.0);
}

#[test]
fn steps_have_the_bits_of_the_first_however_they_are_made() {
    let dir = tempfile::tempdir().unwrap();
    let steps: Vec<StepSource> = (0..4)
        .map(|t| {
            let path = dir.path().join(format!("{t}.npy"));
            // The first step has a peak that the others lack: it adds bits.
            let peak = if t == 0 { 40.0 } else { 0.0 };
            write_npy(&path, [36, 34, 32], |x, y, z| {
                waves(x + 0.05 * f64::from(t), y, z) + if ball(x, y, z) > 0.48 { peak } else { 0.0 }
            });
            StepSource::new(&path, &OpenOptions::default()).at(Some(f64::from(t)))
        })
        .collect();
    let usual = ReduceSettings { chunk_points: 2_000, ..ReduceSettings::default() };
    let out = |name: &str| dir.path().join(name);
    let make = |steps: &[StepSource], name: &str, threads| {
        pipeline::reduce_series(steps, &usual, &out(name), &run(threads), &Silent).unwrap()
    };
    let report = make(&steps, "all.isospan", 2);
    assert!(report.quantiser.unwrap().bits > USUAL, "{:?}", report.quantiser);
    make(&steps, "one.isospan", 1);
    assert!(folder(&out("all.isospan")) == folder(&out("one.isospan")), "threads");
    make(&steps[..1], "grown.isospan", 2);
    for more in [1..2, 2..4] {
        let settings = AppendSettings::default();
        pipeline::append(&steps[more], &settings, &out("grown.isospan"), &run(2), &Silent).unwrap();
    }
    assert!(folder(&out("all.isospan")) == folder(&out("grown.isospan")), "appended");
    reduce(&dir.path().join("0.npy"), &usual, &out("first.isospan"), 2);
    reduce_in_shards(&dir.path().join("0.npy"), &usual, &out("shards.isospan"));
    assert!(folder(&out("first.isospan")) == folder(&out("shards.isospan")), "shards");
}

#[test]
fn a_mesh_becomes_exact_hammersley_points() {
    let dir = tempfile::tempdir().unwrap();
    let [input, usual, named] = ["m.vtk", "usual.isospan", "named.isospan"].map(|n| dir.path().join(n));
    write_mesh(&input, 10, |_| true, |p| p, |p| waves(p[0], p[1], p[2]));
    let report = reduce(&input, &ReduceSettings::default(), &usual, 2);
    assert!(report.quantiser.is_none());
    reduce(&input, &ReduceSettings::exact(SetKind::Hammersley), &named, 2);
    assert!(folder(&usual) == folder(&named));
}

#[test]
fn cells_are_short_along_the_axis_on_which_the_field_bends() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| dir.path().join(name);
    let (input, packed) = (out("v.npy"), out("v.nrrd"));
    let dims = [62, 58, 44];
    write_npy(&input, dims, |x, y, z| (9.0 * z).sin() + 0.3 * (3.0 * x).sin() * (3.0 * y).cos());
    let samples = std::fs::read(&input).unwrap()[128..].to_vec();
    let head = "NRRD0004\ntype: float\ndimension: 3\nsizes: 62 58 44\nendian: little\nencoding: gzip\n\n";
    let mut body = flate2::write::GzEncoder::new(vec![], flate2::Compression::fast());
    std::io::Write::write_all(&mut body, &samples).unwrap();
    std::fs::write(&packed, [head.as_bytes(), &body.finish().unwrap()].concat()).unwrap();

    let usual = ReduceSettings { chunk_points: 3_000, ..ReduceSettings::default() };
    let cells = |name: &str| Manifest::read(&out(name)).unwrap().plan.lattice_cells().unwrap().map(f64::from);
    let report = reduce(&input, &usual, &out("a.isospan"), 2);
    let edges = cells("a.isospan").iter().zip(dims).map(|(n, d)| (d - 1) as f64 / n).collect::<Vec<_>>();
    assert!(edges[0] > 2.5 * edges[2] && edges[1] > 2.5 * edges[2], "{edges:?}");
    let set = SetSettings { spacing: Some([1.0; 3]), ..SetSettings::default() };
    let even = reduce(&input, &ReduceSettings { set, ..usual.clone() }, &out("even.isospan"), 2);
    let rms = [&report, &even].map(|r| r.error.as_ref().unwrap().rms);
    assert!(rms[0] < 0.5 * rms[1], "{rms:?}");
    assert!(report.points < even.points + even.points / 5 && even.points < report.points + report.points / 5);

    // However the samples are read, and whoever makes the chunks.
    reduce(&packed, &usual, &out("packed.isospan"), 1);
    assert_eq!(cells("packed.isospan"), cells("a.isospan"));
    reduce_in_shards(&input, &usual, &out("shards.isospan"));
    assert!(folder(&out("shards.isospan")) == folder(&out("a.isospan")));
    // Steps that are added have the mesh of the first one, for any field.
    let other = out("w.npy");
    write_npy(&other, dims, |x, y, z| (9.0 * x).sin() + 0.3 * (3.0 * z).sin() * y);
    let steps = [&input, &other].map(|path| StepSource::new(path, &OpenOptions::default()));
    pipeline::reduce_series(&steps, &usual, &out("both.isospan"), &run(2), &Silent).unwrap();
    let settings = AppendSettings::default();
    pipeline::append(&steps[1..], &settings, &out("a.isospan"), &run(2), &Silent).unwrap();
    assert!(folder(&out("both.isospan")) == folder(&out("a.isospan")));
    let exact = ReduceSettings { value_bits: ValueBits::Exact, ..usual };
    reduce(&input, &exact, &out("exact.isospan"), 2);
    assert_eq!(cells("exact.isospan"), cells("a.isospan"));
}
