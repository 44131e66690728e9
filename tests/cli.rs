//! The program as a user runs it: exit codes, one line an error, results on standard output.

mod common;

use common::*;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn isospan(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap()
}

fn ok(dir: &Path, args: &[&str]) -> String {
    let out = isospan(dir, args);
    let (stdout, stderr) = (String::from_utf8(out.stdout).unwrap(), String::from_utf8(out.stderr).unwrap());
    assert!(out.status.success(), "{args:?}: {stderr}");
    assert_eq!(without_notes(&stderr), "", "{args:?}");
    stdout
}

/// Standard error without the line that tells the memory a run takes by default.
fn without_notes(stderr: &str) -> String {
    stderr.lines().filter(|l| !l.starts_with("isospan: --memory ")).map(|l| format!("{l}\n")).collect()
}

/// The exit code and the error, which must be one line on standard error and nothing on standard output.
fn fails(dir: &Path, args: &[&str]) -> (i32, String) {
    let out = isospan(dir, args);
    let stderr = without_notes(&String::from_utf8(out.stderr).unwrap());
    assert_eq!(stderr.trim_end().lines().count(), 1, "{args:?}: {stderr}");
    assert!(stderr.starts_with("isospan: error: "), "{args:?}: {stderr}");
    assert_eq!(out.stdout, b"", "{args:?}");
    (out.status.code().unwrap(), stderr)
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn the_main_job() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("ball.npy"), [40, 30, 20], ball);
    assert!(ok(d, &["info", "ball.npy"]).contains("40 x 30 x 20"));
    let info = json(&ok(d, &["info", "ball.npy", "--json"]));
    assert_eq!(info["info"]["dims"], serde_json::json!([40, 30, 20]));
    assert!(ok(d, &["reduce", "ball.npy", "-o", "ball.isospan", "--fraction", "1/2"]).contains("tetrahedra"));
    assert_eq!(json(&ok(d, &["info", "ball.isospan", "--json"]))["dims"], serde_json::json!([40, 30, 20]));
    assert!(ok(d, &["info", "ball.isospan"]).contains("hammersley"));
    let stats = ok(d, &["surface", "ball.isospan", "--isovalue", "-0.05", "-o", "ball.ply", "--stats"]);
    for word in ["points", "tetrahedra", "blocks", "bytes read", "extract"] {
        assert!(stats.contains(word), "{word}: {stats}");
    }
    let report = json(&ok(d, &["check", "ball.ply", "--within", "ball.isospan", "--json"]));
    assert_eq!(report["boundary_edges_outside"], 0);
    assert_eq!(report["euler"], 2);
    assert!(ok(d, &["check", "ball.ply"]).contains("sound"));
    assert!(ok(d, &["check", "ball.isospan"]).contains("fill the domain exactly"));
    let count = json(&ok(d, &["count", "ball.isospan", "--isovalue", "0.1", "--json"]));
    assert!(count["active_tetrahedra"].as_u64().unwrap() > 1000);
    assert!(ok(d, &["count", "ball.isospan", "--isovalue", "1e3"]).contains(": 0 active"));
    let empty = ok(d, &["surface", "ball.isospan", "--isovalue", "77", "-o", "none.stl"]);
    assert!(empty.contains("does not cut the range") && empty.contains("0 triangles"), "{empty}");
}

#[test]
fn bricks_are_the_same_volume() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("w.npy"), [37, 45, 34], waves);
    ok(d, &["brick", "w.npy", "-o", "w.bricks"]);
    let (a, b) = (json(&ok(d, &["info", "w.npy", "--json"])), json(&ok(d, &["info", "w.bricks", "--json"])));
    assert_eq!(a["scan"], b["scan"]);
    for name in ["w.npy", "w.bricks"] {
        ok(d, &["reduce", name, "-o", &format!("{name}.isospan")]);
        ok(d, &["surface", &format!("{name}.isospan"), "--isovalue", "0.3", "-o", &format!("{name}.vtp")]);
    }
    let surface = |name: &str| triangle_set(&read(&d.join(name)));
    assert_eq!(surface("w.npy.vtp"), surface("w.bricks.vtp"));
    assert_eq!(fails(d, &["brick", "w.npy", "-o", "w.bricks"]).0, 2);
    ok(d, &["brick", "w.npy", "-o", "w.bricks", "--force"]);
}

#[test]
fn raw_files_need_their_layout() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let samples: Vec<u8> = (0..5 * 4 * 3u16).flat_map(u16::to_be_bytes).collect();
    fs::write(d.join("v.raw"), [b"HEAD".as_slice(), &samples].concat()).unwrap();
    let layout =
        ["--dims", "5,4,3", "--type", "u16", "--endian", "big", "--offset", "4", "--spacing", "1,2,3"];
    let info = json(&ok(d, &[&["info", "v.raw", "--json"], &layout[..]].concat()));
    assert_eq!((&info["scan"]["min"], &info["scan"]["max"]), (&0.0.into(), &59.0.into()));
    let (code, text) = fails(d, &["info", "v.raw"]);
    assert!(code == 2 && text.contains("--dims"), "{text}");
    let (code, text) = fails(d, &["info", "v.raw", "--dims", "5,4,4", "--type", "u16"]);
    assert!(code == 5 && text.contains("v.raw"), "{text}");
}

#[test]
fn bad_input_is_one_line_and_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    fs::write(d.join("empty.nrrd"), b"").unwrap();
    fs::write(d.join("noise.vti"), [7u8; 999]).unwrap();
    fs::write(d.join("huge.nrrd"), b"NRRD0004\ntype: float\ndimension: 3\nsizes: 1000000 1000000 1000000\nencoding: raw\nendian: little\n\nxx").unwrap();
    fs::create_dir(d.join("folder.nrrd")).unwrap();
    write_npy(&d.join("flat.npy"), [10, 10, 2], ball);
    let flat = fs::read(d.join("flat.npy")).unwrap();
    fs::write(d.join("cut.npy"), &flat[..flat.len() - 1]).unwrap();
    for (file, code) in [
        ("missing.nrrd", 1),
        ("empty.nrrd", 5),
        ("noise.vti", 5),
        ("huge.nrrd", 5),
        ("folder.nrrd", 5),
        ("cut.npy", 5),
    ] {
        for args in [
            vec!["info", file],
            vec!["reduce", file, "-o", "x.isospan"],
            vec!["brick", file, "-o", "x.bricks"],
        ] {
            let (got, text) = fails(d, &args);
            assert_eq!(got, code, "{text}");
            assert!(text.contains(file), "{text}");
        }
    }
    fs::write(d.join("one.npy"), {
        let mut b = b"\x93NUMPY\x01\x00".to_vec();
        let h = format!("{:<117}\n", "{'descr': '|u1', 'fortran_order': False, 'shape': (1, 4, 4), }");
        b.extend((h.len() as u16).to_le_bytes());
        b.extend(h.as_bytes());
        b.extend([1; 16]);
        b
    })
    .unwrap();
    let (code, text) = fails(d, &["reduce", "one.npy", "-o", "x.isospan"]);
    assert!(code == 5 && text.contains("2"), "{text}");
    assert!(!d.join("x.isospan").exists() && !d.join("x.bricks").exists());
}

#[test]
fn usage_errors() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("b.npy"), [12, 12, 12], ball);
    ok(d, &["reduce", "b.npy", "-o", "b.isospan", "--fraction", "1"]);
    let usage: [&[&str]; 13] = [
        &["reduce", "b.npy", "-o", "b.isospan"],
        &["reduce", "b.npy", "-o", "b.zip"],
        &["reduce", "b.npy", "-o", "c.isospan", "--count", "0"],
        &["reduce", "b.npy", "-o", "c.isospan", "--cross-m", "3", "--cross-k", "2"],
        &["reduce", "b.npy", "-o", "c.isospan", "--shift", "1.5"],
        // What would change nothing is refused.
        &["reduce", "b.npy", "-o", "c.isospan", "--points", "halton", "--shift", "0.5"],
        &["reduce", "b.npy", "-o", "c.isospan", "--cross-r", "2,1,1"],
        &["reduce", "b.npy", "-o", "c.isospan", "--value-file", "b.npy"],
        &["reduce", "b.npy", "-o", "c.isospan", "--interp", "nearest", "--values", "fit"],
        &["surface", "b.isospan", "--isovalue", "0", "-o", "b.xyz"],
        &["surface", "b.isospan", "--isovalue", "nan", "-o", "b.ply"],
        &["count", "b.isospan", "--isovalue", "inf"],
        &["check", "b.isospan", "--within", "b.isospan"],
    ];
    for args in usage {
        assert_eq!(fails(d, args).0, 2, "{args:?}");
    }
    // What the argument parser refuses comes with a hint of the usage, on several lines.
    let parser: [&[&str]; 6] = [
        &["reduce", "b.npy", "-o", "c.isospan", "--fraction", "1/0"],
        &["reduce", "b.npy", "-o", "c.isospan", "--nan", "perhaps"],
        &["reduce", "b.npy", "-o", "c.isospan", "--memory", "much"],
        &["info", "b.npy", "--dims", "1,2"],
        &["frobnicate"],
        &[],
    ];
    for args in parser {
        let out = isospan(d, args);
        assert_eq!(out.status.code(), Some(2), "{args:?}");
        assert!(out.stdout.is_empty() && !out.stderr.is_empty(), "{args:?}");
    }
    assert_eq!(fails(d, &["reduce", "b.npy", "-o", "c.isospan", "--memory", "1MiB"]).0, 4);
    assert!(!d.join("c.isospan").exists());
    // An archive is replaced only when asked to; a folder of somebody else's never.
    ok(d, &["reduce", "b.npy", "-o", "b.isospan", "--force", "--points", "halton"]);
    assert!(ok(d, &["info", "b.isospan"]).contains("halton"));
    fs::create_dir(d.join("mine.isospan")).unwrap();
    fs::write(d.join("mine.isospan/diary.txt"), "dear").unwrap();
    assert_eq!(fails(d, &["reduce", "b.npy", "-o", "mine.isospan", "--force"]).0, 2);
    assert_eq!(fs::read_to_string(d.join("mine.isospan/diary.txt")).unwrap(), "dear");
    assert_eq!(fails(d, &["surface", "mine.isospan", "--isovalue", "0", "-o", "m.ply"]).0, 5);
}

#[test]
fn values_are_fitted_unless_the_very_values_of_samples_are_wanted() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("b.npy"), [20, 20, 20], |x, y, z| (20.0 * ball(x, y, z)).round());
    let rms = |more: &[&str]| {
        let args = ["reduce", "b.npy", "-o", "b.isospan", "--force", "--fraction", "1/4", "--json"];
        json(&ok(d, &[&args[..], more].concat()))["error"]["rms"].as_f64().unwrap()
    };
    let is_fitted = |archive: &str| ok(d, &["info", archive]).contains("fitted to the samples");
    let (usual, sampled) = (rms(&[]), rms(&["--values", "sample"]));
    assert!(usual < 0.9 * sampled, "{usual} {sampled}");
    assert_eq!(usual, rms(&["--values", "fit"]));
    assert!(is_fitted("b.isospan"));
    // Labels stay labels.
    for interp in ["nearest", "cubic-thesis"] {
        ok(d, &["reduce", "b.npy", "-o", "s.isospan", "--force", "--interp", interp]);
        assert!(!is_fitted("s.isospan"), "{interp}");
    }
    ok(d, &["reduce", "b.npy", "-o", "c.isospan", "--interp", "cubic", "--value-bits", "12"]);
    assert!(is_fitted("c.isospan"));
}

#[test]
fn percentages_of_errors_are_of_the_source_as_those_of_targets() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    // The reduced field keeps little of the peak: its own range is another one.
    write_npy(&d.join("p.npy"), [21, 21, 21], |x, y, z| if x * x + y * y + z * z < 1e-9 { 100.0 } else { x });
    ok(d, &["reduce", "p.npy", "-o", "p.isospan", "--fraction", "1/16", "--values", "sample"]);
    let args = ["measure", "p.isospan", "--against", "p.npy"];
    let found = json(&ok(d, &[&args[..], &["--json"]].concat()));
    assert_eq!(found["source_range"], serde_json::json!([-1.0, 100.0]));
    assert!(found["range"][1].as_f64().unwrap() < 60.0, "{found}");
    let expected = format!("({:.3} % of the source's range)", 100.0 * found["rms"].as_f64().unwrap() / 101.0);
    let text = ok(d, &args);
    assert!(text.contains(&expected), "{expected}: {text}");
}

#[test]
fn spectra_are_printed_and_drawn_and_counts_looked_up() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("b.npy"), [24, 24, 24], ball);
    ok(d, &["reduce", "b.npy", "-o", "b.isospan", "--fraction", "1"]);
    let table = ok(d, &["spectrum", "b.isospan", "--plot", "b.svg"]);
    assert!(table.contains("mean gradient") && table.lines().count() > 20, "{table}");
    assert!(fs::read_to_string(d.join("b.svg")).unwrap().contains("Contour spectrum of b"));
    ok(d, &["spectrum", "b.isospan", "--plot", "b.png", "--json"]);
    assert!(fs::read(d.join("b.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(fails(d, &["spectrum", "b.isospan", "--plot", "b.pdf"]).0, 2);
    assert_eq!(fails(d, &["spectrum", "b.npy"]).0, 5);
    let counts = ok(d, &["count", "b.isospan", "-i", "-0.5,0,9", "--json"]);
    assert_eq!(counts.lines().count(), 3);
    assert!(counts.lines().all(|l| l.contains("\"stored\":true")), "{counts}");
    assert!(ok(d, &["info", "b.isospan"]).contains("area"));
    assert_eq!(fs::read_dir(d).unwrap().count(), 4, "nothing but what was asked for");
}

#[test]
fn a_damaged_archive_or_surface_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("b.npy"), [16, 16, 16], ball);
    ok(d, &["reduce", "b.npy", "-o", "b.isospan", "--fraction", "1", "--chunk-points", "1000"]);
    for file in [
        "mesh/000000.seg",
        "steps/000000-values-000000.seg",
        "steps/000000-index.seg",
        "steps/000000-spectrum.seg",
        "manifest.json",
    ] {
        let path = d.join("b.isospan").join(file);
        let good = fs::read(&path).unwrap();
        let mut bad = good.clone();
        let middle = bad.len() / 2;
        bad[middle] ^= 0x10;
        fs::write(&path, &bad).unwrap();
        let (code, text) = fails(d, &["check", "b.isospan"]);
        assert!(code == 5 && text.contains("b.isospan"), "{file}: {text}");
        fs::write(&path, &good[..middle]).unwrap();
        assert_eq!(fails(d, &["check", "b.isospan"]).0, 5, "{file}");
        fs::remove_file(&path).unwrap();
        assert_ne!(fails(d, &["check", "b.isospan"]).0, 0, "{file}");
        fs::write(&path, &good).unwrap();
    }
    ok(d, &["check", "b.isospan"]);
    fs::write(d.join("open.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 1 1 1\nf 1 2 3\nf 1 2 4\nf 1 2 5\n")
        .unwrap();
    let out = isospan(d, &["check", "open.obj"]);
    assert_eq!(out.status.code(), Some(5));
    assert!(String::from_utf8_lossy(&out.stdout).contains("NOT SOUND"));
    assert!(String::from_utf8_lossy(&out.stderr).contains("non-manifold"));
}

#[test]
fn the_report_of_a_series_tells_its_largest_errors() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    // Nothing to get wrong in the first step, most in the third.
    for (step, height) in [(0, 0.0), (1, 1.0), (2, 3.0), (3, 2.0)] {
        write_npy(&d.join(format!("s{step}.npy")), [14, 12, 10], |x, y, z| height * ball(x, y, z));
    }
    let text = ok(d, &["reduce", "s*.npy", "-o", "s.isospan", "--fraction", "1/4"]);
    let line = text.lines().find(|l| l.starts_with("  error ")).unwrap();
    assert_eq!(line.matches("(step 2)").count(), 2, "{line}");
    let steps = json(&ok(d, &["info", "s.isospan", "--json"]))["steps"].clone();
    assert_eq!(steps[0]["error"][0], 0.0);
    let rms = steps[2]["error"][0].as_f64().unwrap();
    let told: f64 = line.split("RMS at most ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((told / rms - 1.0).abs() < 1e-3, "{line}: {rms}");
    // Of one step it is that one's.
    let text = ok(d, &["reduce", "s1.npy", "-o", "one.isospan", "--fraction", "1/4"]);
    assert!(text.lines().any(|l| l.starts_with("  error       RMS ") && l.ends_with(" samples")), "{text}");
}

#[test]
fn completions_and_manual() {
    let dir = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        assert!(ok(dir.path(), &["completions", shell]).contains("reduce"));
    }
    assert!(ok(dir.path(), &["man"]).contains("isospan"));
    ok(dir.path(), &["man", "--dir", "pages"]);
    assert!(dir.path().join("pages/isospan-reduce.1").exists());
    assert!(ok(dir.path(), &["--help"]).contains("surface"));
}
