use crate::cells::{CellKind, CellMesh, Center};
use crate::formats::mesh::tests::{Whole, read_whole, torture_with};
use crate::formats::tests::is_mesh;
use crate::formats::tests::write;
use crate::formats::{OpenOptions, open_mesh, steps_of};
use std::path::{Path, PathBuf};

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/ensight").join(name)
}

fn bytes_of(name: &str) -> Vec<u8> {
    std::fs::read(golden(name)).unwrap()
}

fn with_field(field: &str) -> OpenOptions {
    OpenOptions { field: Some(field.into()), ..OpenOptions::default() }
}

fn read(name: &str, field: &str) -> (CellMesh, Whole) {
    let mesh = open_mesh(&golden(name), &with_field(field)).unwrap_or_else(|e| panic!("{e}"));
    let whole = read_whole(&mesh).unwrap_or_else(|e| panic!("{e}"));
    (mesh, whole)
}

const CASES: [&str; 3] = ["text.case", "little.case", "big.case"];

#[test]
fn every_encoding_gives_the_mesh() {
    for name in CASES {
        assert!(is_mesh(&golden(name), &OpenOptions::default()).unwrap());
        for step in 0..3u8 {
            let (mesh, whole) = read(name, &format!("heat:t{step}"));
            assert_eq!((whole.points.len(), whole.points[9]), (19, [2.0, 0.0, 1.0]), "{name}");
            assert_eq!(
                whole.cells,
                [
                    (CellKind::Hexahedron, vec![0, 1, 2, 3, 4, 5, 6, 7]),
                    (CellKind::Wedge, vec![1, 8, 2, 5, 9, 6]),
                    (CellKind::Flat, vec![]),
                    // The second part begins at point 11.
                    (CellKind::Tetrahedron, vec![11, 12, 13, 14]),
                    (CellKind::Pyramid, vec![15, 16, 17, 13, 18]),
                ],
                "{name}"
            );
            for (p, &value) in whole.points.iter().zip(&whole.values) {
                let expected = p[0] + 10.0 * p[1] + 100.0 * p[2] + 1000.0 * f64::from(step);
                // Text has six digits.
                assert!((f64::from(value) - expected).abs() <= 1e-3, "{name}: {value}, not {expected}");
            }
            assert_eq!(mesh.info().data_files.len(), 6);
        }
        let names: Vec<_> = read(name, "x")
            .0
            .info()
            .fields
            .iter()
            .map(|f| (f.name.clone(), f.components, f.center))
            .collect();
        let point = |name: &str, n| (name.to_string(), n, Center::Point);
        assert_eq!(names[..2], [point("heat:t0", 1), point("speed", 3)]);
        assert_eq!(names[2..], [("mass".into(), 1, Center::Cell), point("heat:t1", 1), point("heat:t2", 1)]);
        // The first part has no speed, and one number of the second is undefined.
        let speed = read(name, "speed.y").1.values;
        assert!(speed[..11].iter().all(|v| v.is_nan()) && speed[13].is_nan(), "{name}: {speed:?}");
        assert_eq!((speed[11], speed[14]), (2.0, 4.0), "{name}");
        let mass = read(name, "mass").1.values;
        assert_eq!((mass[0], mass[8], mass[11], mass[18]), (20.0, 21.0, 51.0, 52.0), "{name}");
        assert_eq!((mass[1], mass[13]), (20.5, 51.5));
    }
    assert_eq!(read("big.case", "mass").0.info().format, "EnSight Gold (C binary, big-endian)");
}

#[test]
fn what_vtk_writes_is_read() {
    let (_, whole) = read("vtk.0.case", "heat_n");
    assert_eq!((whole.points.len(), whole.cells.len()), (12, 4));
    let is_heat = |(p, &v): (&[f64; 3], &f32)| v == (p[0] + 10.0 * p[1] + 100.0 * p[2]) as f32;
    assert!(whole.points.iter().zip(&whole.values).all(is_heat));
    let of = |kind| whole.cells.iter().filter(|c| c.0 == kind).count();
    use CellKind as K;
    assert_eq!([K::Tetrahedron, K::Pyramid, K::Wedge, K::Hexahedron].map(of), [1; 4]);
}

#[test]
fn steps_are_a_series_with_times() {
    let times = |field: &str| -> Vec<Option<f64>> {
        let steps = steps_of(&[golden("big.case")], &with_field(field)).unwrap();
        steps.iter().map(|s| s.time).collect()
    };
    assert_eq!(times("heat"), [Some(0.5), Some(1.5), Some(4.0)]);
    assert_eq!(times("heat:t[02]"), [Some(0.5), Some(4.0)]);
    assert_eq!(times("mass"), [None]);
}

/// A copy of a case and its files.
fn copy(dir: &tempfile::TempDir, name: &str) {
    for entry in std::fs::read_dir(golden("")).unwrap() {
        let path = entry.unwrap().path();
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        if file.starts_with(&format!("{name}.")) {
            write(dir, &file, &std::fs::read(&path).unwrap());
        }
    }
}

#[test]
fn what_is_wrong_is_told() {
    let dir = tempfile::tempdir().unwrap();
    copy(&dir, "text");
    let fails = |file: &str, old: &str, new: &str| {
        let good = String::from_utf8(bytes_of(file)).unwrap();
        assert!(good.contains(old), "{old}");
        write(&dir, file, good.replacen(old, new, 1).as_bytes());
        let path = dir.path().join("text.case");
        let outcome = open_mesh(&path, &with_field("heat:t2")).and_then(|mesh| read_whole(&mesh));
        write(&dir, file, good.as_bytes());
        let error = outcome.err().unwrap_or_else(|| panic!("{new} was read"));
        assert!(error.exit_code() == 5 && !error.to_string().contains('\n'), "{error}");
        error.to_string()
    };
    for (file, old, new, reason) in [
        ("text.case", "ensight gold", "ensight", "expected type: ensight gold, got ensight"),
        ("text.case", "model:   text.geo", "model: 1 text.***.geo", "got a geometry of 3 steps"),
        ("text.case", "1 heat", "1 1 heat", "all steps in one file"),
        ("text.case", "1 heat", "2 heat", "got time set 2"),
        ("text.case", "heat.***", "heat.001", "expected *** for the number of a step"),
        ("text.case", "steps: 3", "steps: 3000000", "at most 2^20 steps"),
        ("text.case", "number of steps: 3", "time steps: 3", "expected the number of steps of its time set"),
        ("text.case", "filename increment", "increment", "a file name number for each step"),
        ("text.case", "time values:", "time values file: a", "got a file of them"),
        ("text.geo", "hexa8", "hexa9", "'hexa9'"),
        ("text.geo", "hexa8", "nfaced", "'nfaced'"),
        ("text.geo", "coordinates", "block", "a structured block"),
        ("text.geo", "         5\npart", "         2\npart", "a second part 2"),
        (
            "text.geo",
            "         1         2         3         4\n",
            "         1         2         0         4\n",
            "part 5, tetra4 1: expected nodes from 1 to 8, got 0",
        ),
        (
            "text.geo",
            "         1         2         3         4\n",
            "         1         2         9         4\n",
            "got 9",
        ),
        ("text.heat.007", "part", "port", "expected part, got 'port'"),
        ("text.heat.007", "         2\n", "         3\n", "expected a part of the geometry, got part 3"),
        ("text.heat.007", "coordinates", "coordinates partial", "'coordinates partial'"),
        ("text.heat.007", " 2.00000e+03", " x", "a number of type float32"),
    ] {
        let line = fails(file, old, new);
        assert!(line.contains(reason), "{line}");
    }
    std::fs::remove_file(dir.path().join("text.heat.007")).unwrap();
    let path = dir.path().join("text.case");
    let outcome = open_mesh(&path, &with_field("heat:t2")).and_then(|mesh| read_whole(&mesh));
    assert!(outcome.expect_err("a missing file").to_string().contains("text.heat.007"));
    copy(&dir, "big");
    for cut in [8, 79, 81, 300] {
        write(&dir, "big.geo", &bytes_of("big.geo")[..cut]);
        let line =
            open_mesh(&dir.path().join("big.case"), &OpenOptions::default()).err().unwrap().to_string();
        assert!(line.contains("big.geo: byte") && line.contains("80 bytes"), "{line}");
    }
    let mut fortran = bytes_of("big.geo");
    fortran[..14].copy_from_slice(b"Fortran Binary");
    write(&dir, "big.geo", &fortran);
    let line = open_mesh(&dir.path().join("big.case"), &OpenOptions::default()).err().unwrap().to_string();
    assert!(line.contains("expected C Binary, or text, got Fortran Binary"), "{line}");
}

#[test]
fn damage_is_survived() {
    for name in ["text", "big"] {
        let files = ["case", "geo", "heat.001", "heat.004", "heat.007", "mass", "speed"];
        let files: Vec<(String, Vec<u8>)> =
            files.iter().map(|end| format!("{name}.{end}")).map(|f| (f.clone(), bytes_of(&f))).collect();
        let all: Vec<(&str, &[u8])> = files.iter().map(|(f, b)| (f.as_str(), &b[..])).collect();
        torture_with(&files[0].0, &files[0].1, &all[1..]);
        // The damaged file is named by the good case.
        let dir = tempfile::tempdir().unwrap();
        copy(&dir, name);
        for (file, bytes) in &all[1..3] {
            for at in 0..bytes.len() {
                let mut bad = bytes.to_vec();
                bad[at] ^= [0x01, 0x10, 0x80, 0xff][at % 4];
                write(&dir, file, &bad);
                let path = dir.path().join(&files[0].0);
                let outcome = open_mesh(&path, &with_field("heat:t0")).and_then(|mesh| read_whole(&mesh));
                if let Err(e) = outcome {
                    let line = e.to_string();
                    assert!(
                        !line.contains('\n') && line.contains(&dir.path().display().to_string()),
                        "{line}"
                    );
                }
            }
            write(&dir, file, bytes);
        }
    }
}
