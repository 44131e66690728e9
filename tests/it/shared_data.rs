//! Real volumes, where there are some: the folder that `ISOSPAN_SHARED_DATA` names, with its
//! `MANIFEST.tsv`.

use crate::common::*;
use isospan::formats::{OpenOptions, StepSource, open_volume};
use isospan::pipeline::{self, Amount, NanPolicy, ReduceSettings};
use isospan::surface::check::{boundary_outside, check};
use std::fs;
use std::path::Path;

struct Entry {
    file: String,
    dims: [u64; 3],
    scalar: String,
    range: [f64; 2],
    isovalue: f32,
}

/// The volumes of the manifest in formats that are read.
fn volumes(folder: &Path) -> Vec<Entry> {
    let text = fs::read_to_string(folder.join("MANIFEST.tsv")).unwrap();
    text.lines().filter_map(entry).collect()
}

fn entry(line: &str) -> Option<Entry> {
    let c: Vec<&str> = line.split('\t').collect();
    let file = c.first()?;
    let known = ["nii.gz", "nhdr", "nrrd", "mha", "vtk", "vti"];
    let volume = file.starts_with("volumes/") || file.starts_with("series/viscous");
    if !volume || !known.iter().any(|e| file.ends_with(e)) {
        return None;
    }
    let dims: Vec<u64> = c.get(4)?.split('x').filter_map(|n| n.parse().ok()).collect();
    let (lo, hi) = c.get(6)?.split_once("..")?;
    Some(Entry {
        file: (*file).to_owned(),
        dims: dims.try_into().ok()?,
        scalar: numpy_name(c.get(5)?)?,
        range: [lo.parse().ok()?, hi.parse().ok()?],
        isovalue: c.get(8)?.split(';').next()?.trim().parse().ok()?,
    })
}

/// NumPy's name of a type that the manifest calls `u8`, `i16` or `f32`.
fn numpy_name(name: &str) -> Option<String> {
    let (kind, bits) = name.split_at_checked(1)?;
    let kind = [("u", "uint"), ("i", "int"), ("f", "float")].into_iter().find(|k| k.0 == kind)?.1;
    Some(format!("{kind}{bits}"))
}

/// The file's only scalar field, or the one that its active attribute names, is what is read.
fn options(_: &Entry) -> OpenOptions {
    OpenOptions::default()
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn volumes_are_what_the_manifest_says() {
    let folder = shared_data();
    let entries = volumes(&folder);
    assert!(entries.len() >= 10, "{} volumes", entries.len());
    for e in entries {
        let source = open_volume(&folder.join(&e.file), &options(&e)).unwrap();
        let (info, scan) = pipeline::scan(source).unwrap();
        assert_eq!((info.dims, info.field.scalar.name()), (e.dims, e.scalar.as_str()), "{}", e.file);
        // The manifest gives stored values.
        let stored = [scan.min, scan.max].map(|v| (v.unwrap() - info.intercept) / info.slope);
        for (got, expected) in stored.iter().zip(e.range) {
            assert!((got - expected).abs() <= 1e-5 * expected.abs().max(1.0), "{}: {got} {expected}", e.file);
        }
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn each_volume_reduces_to_a_sound_surface() {
    let folder = shared_data();
    let dir = tempfile::tempdir().unwrap();
    for e in volumes(&folder) {
        let input = folder.join(&e.file);
        let info = open_volume(&input, &options(&e)).unwrap().info().clone();
        let out = dir.path().join("v.isospan");
        let settings = ReduceSettings { amount: Amount::Fraction(0.125), ..ReduceSettings::default() };
        let report = pipeline::reduce_series(
            &[StepSource::new(&input, &options(&e))],
            &settings,
            &out,
            &run(2),
            &isospan::exec::Silent,
        )
        .unwrap();
        let per_point = report.archive_bytes as f64 / report.points as f64;
        assert!(per_point <= 20.0, "{}: {per_point} bytes a point", e.file);
        // The manifest's isovalues are stored values too.
        let isovalue = (f64::from(e.isovalue) * info.slope + info.intercept) as f32;
        let file = dir.path().join("v.ply");
        let report = surface(&out, isovalue, &file, 2);
        let mesh = read(&file);
        let sound = check(&mesh);
        assert!(report.triangles > 1000, "{}: {report:?}", e.file);
        assert!(
            sound.is_manifold() && sound.is_oriented() && sound.zero_area_triangles == 0,
            "{}: {sound:?}",
            e.file
        );
        assert_eq!(boundary_outside(&mesh, &info.geometry, info.dims, 1e-2), 0, "{}", e.file);
        fs::remove_dir_all(&out).unwrap();
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn samples_that_are_no_numbers_are_refused_or_masked() {
    let folder = shared_data();
    let input = folder.join("variants/nan_inf_f32.mha");
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("v.isospan");
    let reduce = |nan| {
        let settings = ReduceSettings { nan, amount: Amount::Fraction(0.5), ..ReduceSettings::default() };
        pipeline::reduce_series(
            &[StepSource::new(&input, &OpenOptions::default())],
            &settings,
            &out,
            &run(2),
            &isospan::exec::Silent,
        )
    };
    let error = reduce(NanPolicy::Error).unwrap_err();
    assert!(error.exit_code() == 5 && error.to_string().contains("nan_inf_f32.mha"), "{error}");
    let report = reduce(NanPolicy::Mask).unwrap();
    assert!(report.void_points > 0 && report.range.is_some_and(|r| r[1].is_finite()), "{report:?}");
    check_archive(&out).unwrap();
}

/// What `info --json` says of a file: its exit code, standard output, and lines on standard error.
fn told(file: &Path) -> (Option<i32>, Vec<u8>, String) {
    let program = env!("CARGO_BIN_EXE_isospan");
    let out = std::process::Command::new(program).args(["info", "--json"]).arg(file).output().unwrap();
    (out.status.code(), out.stdout, String::from_utf8(out.stderr).unwrap())
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn meshes_are_what_the_manifest_says_and_other_files_take_one_line() {
    let folder = shared_data();
    let text = fs::read_to_string(folder.join("MANIFEST.tsv")).unwrap();
    let (mut good, mut refused) = (0, 0);
    for c in text.lines().map(|line| line.split('\t').collect::<Vec<_>>()) {
        let file = folder.join(c[0]);
        let ends = |list: &[&str]| list.iter().any(|e| c[0].ends_with(e));
        let mesh =
            ends(&[".vtu", ".pvtu", ".ele"]) || c[0].starts_with("variants/") && c[0].ends_with(".vtk");
        if !(c[0].starts_with("meshes/") || c[0].starts_with("variants/")) || !mesh {
            continue;
        }
        let (code, out, error) = told(&file);
        if code == Some(0) {
            let found: serde_json::Value = serde_json::from_slice(&out).unwrap();
            // "8 points; 1 cells", "32505 vertices; 128976 tet"; volumes have "3x4x6", pairs of
            // files nothing.
            let counts: Vec<u64> =
                c[4].split(';').filter_map(|n| n.trim().split(' ').next()?.parse().ok()).collect();
            if let ([points, cells], Some("mesh")) = (&counts[..], found["kind"].as_str()) {
                assert_eq!(
                    (&found["info"]["points"], &found["info"]["cells"]),
                    (&serde_json::json!(points), &serde_json::json!(cells)),
                    "{}",
                    c[0]
                );
                good += 1;
            }
        } else {
            assert_eq!(code, Some(5), "{}: {error}", c[0]);
            assert_eq!(error.lines().count(), 1, "{}: {error}", c[0]);
            assert!(error.contains("expected") && error.contains("got"), "{}: {error}", c[0]);
            refused += 1;
        }
    }
    assert!(good >= 30 && refused >= 15, "{good} meshes, {refused} refused");
}
