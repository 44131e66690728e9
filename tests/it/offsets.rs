//! Values that `f32` does not hold: they are counted from an offset, which is not visible to the
//! user. What is lost all the same is reported.

use crate::common::*;
use isospan::archive::manifest::Manifest;
use isospan::exec::Silent;
use isospan::formats::samples::SampleFormat;
use isospan::formats::{Input, OpenOptions, StepSource, open_input, open_mesh};
use isospan::pipeline::{self, Amount, ExportSettings, NanPolicy, ProbeSettings, ReduceSettings};
use isospan::points::SetKind;
use isospan::sample::{Interpolation, Values};
use isospan::surface::TriMesh;
use isospan::{Archive, Resources};
use std::fs;
use std::path::Path;

const DIMS: [usize; 3] = [24, 22, 20];
const PASCAL: f64 = 101_325_000.0;

/// A field as an NPY file of 8-byte samples, by the number of the sample and its place in [0, 1]^3.
fn write_wide<T>(path: &Path, kind: &str, bytes: fn(T) -> [u8; 8], field: impl Fn(usize, [f64; 3]) -> T) {
    let [x, y, z] = DIMS;
    let mut head = format!("{{'descr': '<{kind}', 'fortran_order': False, 'shape': ({z}, {y}, {x}), }}");
    head += &" ".repeat(63 - (10 + head.len()) % 64);
    let mut out =
        [b"\x93NUMPY\x01\x00", &(head.len() as u16 + 1).to_le_bytes()[..], head.as_bytes(), b"\n"].concat();
    for n in 0..x * y * z {
        let at = [n % x, n / x % y, n / x / y];
        out.extend(bytes(field(n, std::array::from_fn(|a| at[a] as f64 / (DIMS[a] - 1) as f64))));
    }
    fs::write(path, out).unwrap();
}

fn wave([x, y, z]: [f64; 3]) -> f64 {
    3.0 * (4.0 * x + 1.0).sin() * (3.0 * y).cos() * (2.0 * z + 0.3).cos()
}

fn write_pressure(path: &Path, base: f64, drift: f64) {
    write_wide(path, "f8", f64::to_le_bytes, |_, p| base + drift + wave(p));
}

fn quarter() -> ReduceSettings {
    ReduceSettings { keyframes: 16, ..settings(SetKind::Halton, Amount::Fraction(0.25), 900) }
}

fn area(mesh: &TriMesh) -> f64 {
    let at = |v: u32| mesh.vertices[v as usize].position.map(f64::from);
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(at);
        let [u, v]: [[f64; 3]; 2] = [b, c].map(|p| std::array::from_fn(|i| p[i] - a[i]));
        let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        cross.iter().map(|c| c * c).sum::<f64>().sqrt() / 2.0
    };
    mesh.triangles.iter().map(of).sum()
}

#[test]
fn a_small_wave_on_a_large_number_is_all_there() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| dir.path().join(name);
    write_pressure(&out("p.npy"), PASCAL, 0.0);
    write_pressure(&out("small.npy"), 0.0, 0.0);
    let info = open_input(&out("p.npy"), &OpenOptions::default()).unwrap();
    let Input::Volume(volume) = info else { panic!("a volume") };
    let scan = pipeline::scan(volume).unwrap().1;
    let width = scan.max.unwrap() - scan.min.unwrap();
    assert!(
        (5.0..6.0).contains(&width) && scan.histogram.iter().filter(|n| **n > 0).count() > 50,
        "{scan:?}"
    );

    let report = reduce(&out("p.npy"), &quarter(), &out("p.isospan"), 2);
    let small = reduce(&out("small.npy"), &quarter(), &out("small.isospan"), 2);
    let [lo, hi] = report.range.unwrap();
    assert!(lo > PASCAL - 3.5 && hi < PASCAL + 3.5 && hi - lo > 5.0, "{lo} {hi}");
    let [archive, same] = ["p.isospan", "small.isospan"].map(|name| Archive::open(out(name)).unwrap());
    assert_eq!(
        (same.offset(), Manifest::read(&out("small.isospan")).unwrap().steps[0].plan.source.offset),
        (0.0, 0.0)
    );
    assert!((archive.offset() - PASCAL).abs() < 1.0);
    // The error is that of the samples as they are in the file, in f64.
    let found = archive.sample(DIMS.map(|d| d as u64)).unwrap();
    let mut sum = 0.0;
    for (n, v) in found.iter().enumerate() {
        let at = [n % DIMS[0], n / DIMS[0] % DIMS[1], n / DIMS[0] / DIMS[1]];
        let true_value = PASCAL + wave(std::array::from_fn(|a| at[a] as f64 / (DIMS[a] - 1) as f64));
        sum += (v - true_value) * (v - true_value);
    }
    let (rms, error) = ((sum / found.len() as f64).sqrt(), report.error.unwrap());
    assert!((error.rms - rms).abs() < 1e-6 * rms && (0.001..0.5).contains(&rms), "{} {rms}", error.rms);
    assert!((error.rms - small.error.unwrap().rms).abs() < 1e-4 * rms);
    let worst = error.worst.as_ref().unwrap();
    assert!(
        (worst.original - PASCAL).abs() < 3.5
            && ((worst.reduced - worst.original).abs() - error.max).abs() < 1e-6
    );
    let little = Resources::default().with_memory(1 << 28);
    let measured = measurement(&out("p.isospan"), &out("p.npy")).resources(little).run();
    assert_eq!(measured.unwrap().error, error);
    check_archive(&out("p.isospan")).unwrap();

    // Isovalues are the file's.
    for iso in [0.5, -1.25] {
        let [a, b] = [archive.surface(PASCAL + iso).unwrap(), same.surface(iso).unwrap()];
        assert_eq!(a.triangles.len(), b.triangles.len());
        assert!((area(&a) - area(&b)).abs() < 1e-3 * area(&b) && area(&b) > 100.0);
        assert_eq!(archive.count(PASCAL + iso).unwrap().active_cells, same.count(iso).unwrap().active_cells);
        let at: Vec<[f64; 3]> = a.vertices.iter().map(|v| v.position.map(f64::from)).collect();
        assert!(archive.probe(&at).unwrap().iter().all(|v| v.is_nan() || (v - PASCAL - iso).abs() < 1e-3));
    }
    assert!(archive.surface(0.5).unwrap().triangles.is_empty());
    let file = out("two.ply");
    let told = archive.query([PASCAL + 0.5, PASCAL + 0.75]).write(&file).unwrap();
    assert_eq!(told.surfaces[1].isovalue, PASCAL + 0.75);
    assert!(String::from_utf8_lossy(&fs::read(&file).unwrap()).contains("property double isovalue"));
    let spectrum = archive.spectrum().unwrap();
    assert!(
        spectrum.knots.iter().all(|k| (k.isovalue - PASCAL).abs() < 3.5) && !spectrum.suggestions.is_empty()
    );
    assert!(spectrum.suggestions.iter().all(|s| (s.isovalue - PASCAL).abs() < 3.5));

    // Files for other programs have f64.
    let probed = out("q.npy");
    archive.write_samples([9, 9, 9], &ProbeSettings::default(), &probed, SampleFormat::Npy, &Silent).unwrap();
    let Input::Volume(volume) = open_input(&probed, &OpenOptions::default()).unwrap() else {
        panic!("a volume")
    };
    let (info, scan) = pipeline::scan(volume).unwrap();
    assert_eq!((info.field.scalar.name(), scan.nan), ("float64", 0));
    assert!(scan.max.unwrap() - scan.min.unwrap() > 4.0 && scan.min.unwrap() > PASCAL - 3.5);
    archive
        .write_samples([5; 3], &ProbeSettings::default(), &out("q.vti"), SampleFormat::Vti, &Silent)
        .unwrap();
    assert!(open_input(&out("q.vti"), &OpenOptions::default()).is_ok());
    fs::write(out("at.csv"), "x,y,z\n3,4,5\n").unwrap();
    archive.write_probed(&out("at.csv"), &ProbeSettings::default(), &out("q.csv"), &Silent).unwrap();
    let row = fs::read_to_string(out("q.csv")).unwrap();
    let value: f64 = row.trim().rsplit(',').next().unwrap().parse().unwrap();
    assert!(
        (value - archive.probe(&[[3.0, 4.0, 5.0]]).unwrap()[0]).abs() < 1e-6 && value > PASCAL - 3.5,
        "{row}"
    );
    let range = Some([PASCAL + 1.0, f64::INFINITY]);
    archive
        .write_tetrahedra(&ExportSettings { range, ..ExportSettings::default() }, &out("t.vtu"), &Silent)
        .unwrap();
    let mesh = open_mesh(&out("t.vtu"), &OpenOptions::default()).unwrap();
    let (mut values, mut block) = (mesh.values(1 << 20, |_| false).unwrap(), vec![]);
    assert!(values.next_block(&mut block).unwrap());
    assert!(
        block.iter().all(|v| (PASCAL + 1.0..PASCAL + 3.0).contains(v))
            && block.iter().any(|v| v.fract() != 0.0)
    );
}

/// In shards, appended, adapted, with bits and missing samples: one offset, the same bytes.
#[test]
fn every_way_to_make_an_archive_has_the_offset() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| dir.path().join(name);
    write_pressure(&out("a.npy"), PASCAL, 0.0);
    write_pressure(&out("b.npy"), PASCAL, 1.5);
    // Some samples mean "no data", and one is none.
    let fill = f64::from(-999.9f32);
    let hole = |n: usize, p| if n.is_multiple_of(7) { fill } else { PASCAL + wave(p) };
    write_wide(&out("c.npy"), "f8", f64::to_le_bytes, |n, p| if n == 5 { f64::NAN } else { hole(n, p) });
    let step = |name: &str| StepSource::new(&out(name), &OpenOptions::default());
    let with = ReduceSettings { value_bits: Some(16.0), ..quarter() };
    for (n, settings) in [quarter(), with].iter().enumerate() {
        let name = |what: &str| out(&format!("{what}{n}.isospan"));
        reduce(&out("a.npy"), settings, &name("one"), 2);
        reduce_in_shards(&out("a.npy"), settings, &name("shards"));
        assert!(folder(&name("one")) == folder(&name("shards")), "{n}");
        addition(&[step("b.npy")], &run(2)).append_to(name("one")).unwrap();
        let steps = [step("a.npy"), step("b.npy")];
        let report = pipeline::reduce_series(&steps, settings, &name("two"), &run(1), &Silent).unwrap();
        assert!(folder(&name("one")) == folder(&name("two")), "{n}");
        let [first, second] = [0, 1].map(|s: usize| report.steps[s].range.unwrap());
        assert!((second[0] - first[0] - 1.5).abs() < 0.2 && second[0] > PASCAL - 3.0, "{first:?} {second:?}");
    }
    let settings = ReduceSettings { nan: NanPolicy::Value(PASCAL + 0.5), missing: Some(-999.9), ..quarter() };
    let report = reduce(&out("c.npy"), &settings, &out("c.isospan"), 2);
    assert!(report.range.unwrap()[0] > PASCAL - 5.0 && report.void_points == 0, "{:?}", report.range);
    let focus = Some([PASCAL - 1.0, PASCAL + 1.0].into());
    let report = reduce(&out("a.npy"), &ReduceSettings { focus, ..quarter() }, &out("d.isospan"), 2);
    assert!(report.error.unwrap().rms < 0.5);
    // A step that the offset does not suit says what it loses.
    write_pressure(&out("far.npy"), 1e12, 0.0);
    let report = addition(&[step("far.npy")], &run(2)).append_to(out("one0.isospan"));
    let report = report.unwrap();
    let lost = report.steps[0].rounding.unwrap();
    assert!(lost > 3.0 && report.error.unwrap().max >= lost, "{lost}");
}

#[test]
fn whole_numbers_are_exact_where_they_can_be() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| dir.path().join(name);
    let nearest = ReduceSettings {
        interpolation: Interpolation::Nearest,
        values: Some(Values::Sample),
        ..settings(SetKind::Regular, Amount::Fraction(1.0), 900)
    };
    let id = |n: usize| (n as u64).wrapping_mul(2_654_435_761) % 5000;
    let cases = [("near", 2_000_000_000), ("huge", 1 << 60)];
    for (name, first) in cases {
        write_wide(&out("ids.npy"), "u8", u64::to_le_bytes, |n, _| first + id(n));
        let report = reduce(&out("ids.npy"), &nearest, &out(&format!("{name}.isospan")), 2);
        assert_eq!(report.steps[0].rounding, None);
        let archive = Archive::open(out(&format!("{name}.isospan"))).unwrap();
        assert_eq!(archive.offset().fract(), 0.0);
        let manifest = Manifest::read(&out(&format!("{name}.isospan"))).unwrap();
        let [lo, hi] = manifest.steps[0].value_range.unwrap();
        // The same ids, counted from elsewhere.
        let back = |v: f32| (i128::from(v as i64) + archive.offset() as i128 - i128::from(first)) as u64;
        assert_eq!((back(lo), back(hi)), (0, 4999), "{name}");
        if name == "near" {
            let error = report.error.unwrap();
            let found = archive.sample(DIMS.map(|d| d as u64)).unwrap();
            let off = found.iter().enumerate().filter(|(n, v)| **v != (first + id(*n)) as f64).count();
            assert_eq!(off == 0, error.max == 0.0, "{off}");
            assert!(off * 10 < found.len(), "{off}");
        }
    }
    // Over all of 32 bits no offset helps: what is lost is reported, and the error is not 0.
    write_wide(
        &out("wide.npy"),
        "u8",
        u64::to_le_bytes,
        |n, _| if n.is_multiple_of(2) { 7 } else { 4_000_000_063 },
    );
    let report = reduce(&out("wide.npy"), &nearest, &out("wide.isospan"), 2);
    assert_eq!(report.steps[0].rounding, Some(63.0));
    assert!(report.error.unwrap().max >= 63.0);
    let estimate = pipeline::estimate_series(
        &[StepSource::new(&out("wide.npy"), &OpenOptions::default())],
        &nearest,
        &out("w.isospan"),
        &run(1),
    )
    .unwrap();
    assert_eq!(estimate.rounding, Some(63.0));
    check_archive(&out("wide.isospan")).unwrap();
    assert_eq!(summarize(&out("wide.isospan")).unwrap().rounding, Some(63.0));
    // And what f32 cannot hold at all is refused.
    for scale in [1e300, 1e-300] {
        write_wide(&out("x.npy"), "f8", f64::to_le_bytes, |_, p| scale * wave(p));
        let input = out("x.npy");
        let made = pipeline::reduce_series(
            &[StepSource::new(&input, &OpenOptions::default())],
            &quarter(),
            &out("x.isospan"),
            &run(1),
            &Silent,
        );
        let error = made.unwrap_err();
        assert!(error.exit_code() == 5 && error.to_string().contains("values that f32 holds"), "{error}");
        assert!(!out("x.isospan").exists());
    }
}

/// Hexahedra whose 64 points have the whole numbers from `first` on.
fn write_ids(path: &Path, first: u64) {
    let at = |n: u64| [n % 4, n / 4 % 4, n / 16];
    let point = |n: u64| at(n).map(|x| x.to_string()).join(" ");
    let corner = |cell: [u64; 3], [x, y, z]: [u64; 3]| {
        let n = cell[0] + x + 4 * (cell[1] + y) + 16 * (cell[2] + z);
        n.to_string()
    };
    let square = [[0, 0], [1, 0], [1, 1], [0, 1]];
    let cube: Vec<[u64; 3]> = (0..2).flat_map(|z| square.map(|[x, y]| [x, y, z])).collect();
    let cell = |n: u64| -> String {
        let at = [n % 3, n / 3 % 3, n / 9];
        format!("8 {}\n", cube.iter().map(|&c| corner(at, c)).collect::<Vec<_>>().join(" "))
    };
    let lines =
        |count: u64, line: &dyn Fn(u64) -> String| -> String { (0..count).map(|n| line(n) + "\n").collect() };
    let text = format!(
        "# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 64 float\n{}CELLS 27 243\n{}\
         CELL_TYPES 27\n{}POINT_DATA 64\nSCALARS id vtktypeint64 1\nLOOKUP_TABLE default\n{}",
        lines(64, &point),
        lines(27, &cell),
        lines(27, &|_| "12".into()),
        lines(64, &|n| (first + n).to_string()),
    );
    fs::write(path, text).unwrap();
}

#[test]
fn what_f64_loses_of_a_mesh_is_reported() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| dir.path().join(name);
    let settings = settings(SetKind::Halton, Amount::Count(200), 900);
    for (name, first, lost) in [("a", 1 << 52, None), ("b", 1 << 60, Some(128.0))] {
        write_ids(&out(&format!("{name}.vtk")), first);
        let report = reduce(&out(&format!("{name}.vtk")), &settings, &out(&format!("{name}.isospan")), 2);
        assert_eq!(report.steps[0].rounding, lost, "{name}");
        assert_eq!(report.error.unwrap().max >= 128.0, lost.is_some(), "{name}");
    }
}

#[test]
fn a_mesh_has_an_offset_too() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| dir.path().join(name);
    let field = |base: f64| move |p: [f64; 3]| base + wave(p);
    for (name, base) in [("a", PASCAL), ("small", 0.0), ("later", PASCAL + 0.5)] {
        write_mesh(&out(&format!("{name}.vtk")), 10, |_| true, |p| p, field(base));
    }
    for fit in [Values::Sample, Values::Fit] {
        let settings =
            ReduceSettings { values: Some(fit), ..settings(SetKind::Halton, Amount::Count(1500), 900) };
        let name = |what: &str| out(&format!("{what}-{fit:?}.isospan"));
        let [report, small] =
            ["a", "small"].map(|what| reduce(&out(&format!("{what}.vtk")), &settings, &name(what), 2));
        let [lo, hi] = report.range.unwrap();
        assert!(lo > PASCAL - 3.5 && hi < PASCAL + 3.5 && hi - lo > 4.0, "{lo} {hi}");
        let (error, wanted) = (report.error.unwrap(), small.error.unwrap());
        assert!((error.rms - wanted.rms).abs() < 1e-3 * wanted.rms, "{} {}", error.rms, wanted.rms);
        let little = Resources::default().with_memory(1 << 28);
        let measured = measurement(&name("a"), &out("a.vtk")).resources(little).run();
        assert_eq!(measured.unwrap().error, error);
        let [a, b] = [("a", PASCAL), ("small", 0.0)]
            .map(|(what, base)| area(&Archive::open(name(what)).unwrap().surface(base + 0.5).unwrap()));
        assert!((a - b).abs() < 1e-3 * b && b > 0.1, "{a} {b}");
        let later = StepSource::new(&out("later.vtk"), &OpenOptions::default());
        let report = addition(&[later], &run(2)).append_to(name("a")).unwrap();
        let [low, _] = report.range.unwrap();
        assert!((low - lo - 0.5).abs() < 0.2, "{low} {lo}");
        check_archive(&name("a")).unwrap();
    }
}
