//! The program as a user runs it: exit codes, one line an error, results on standard output.

use crate::common::*;
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

/// Standard error without the line that reports the memory a run takes by default, and that of
/// files which do not say how far samples lie apart.
fn without_notes(stderr: &str) -> String {
    let is_note =
        |l: &str| l.starts_with("isospan: --memory ") || l.contains(": a spacing of 1 is assumed; ");
    stderr.lines().filter(|l| !is_note(l)).map(|l| format!("{l}\n")).collect()
}

/// The exit code and the error, which must be one line on standard error and nothing on standard
/// output.
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
    assert!(
        ok(d, &["reduce", "ball.npy", "-o", "ball.isospan", "--points", "regular", "--fraction", "1/2"])
            .contains("tetrahedra")
    );
    assert_eq!(json(&ok(d, &["info", "ball.isospan", "--json"]))["dims"], serde_json::json!([40, 30, 20]));
    assert!(ok(d, &["info", "ball.isospan"]).contains("regular"));
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
    assert!(count["active_cells"].as_u64().unwrap() > 1000);
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
    // Asked again: nothing is left to do. Other bricks stay.
    let again = ["brick", "w.npy", "-o", "w.bricks"];
    assert!(ok(d, &again).contains("finished before"));
    write_npy(&d.join("w.npy"), [37, 45, 34], |x, y, z| waves(x, y, z) + if z > 0.99 { 1.0 } else { 0.0 });
    assert_eq!(fails(d, &again).0, 2);
    write_npy(&d.join("w.npy"), [37, 45, 34], waves);
    fs::write(d.join("other.bricks"), "mine").unwrap();
    assert_eq!(fails(d, &["brick", "w.npy", "-o", "other.bricks"]).0, 2);
    ok(d, &["brick", "w.npy", "-o", "w.bricks", "--force"]);
}

#[test]
fn raw_files_need_their_layout() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let samples: Vec<u8> = (0..5 * 4 * 3u16).flat_map(u16::to_be_bytes).collect();
    fs::write(d.join("v.raw"), [b"HEAD".as_slice(), &samples].concat()).unwrap();
    let layout = ["--dims", "5,4,3", "--type", "uint16", "--endian", "big", "--offset", "4"];
    let info = json(&ok(d, &[&["info", "v.raw", "--json"], &layout[..]].concat()));
    assert_eq!((&info["scan"]["min"], &info["scan"]["max"]), (&0.0.into(), &59.0.into()));
    let (code, text) = fails(d, &["info", "v.raw"]);
    assert!(code == 2 && text.contains("--dims"), "{text}");
    let (code, text) = fails(d, &["info", "v.raw", "--dims", "5,4,4", "--type", "uint16"]);
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
    ok(d, &["reduce", "b.npy", "-o", "b.isospan", "--points", "regular", "--fraction", "1"]);
    let usage: [&[&str]; 13] = [
        &["reduce", "b.npy", "-o", "b.isospan"],
        &["reduce", "b.npy", "-o", "b.zip"],
        &["reduce", "b.npy", "-o", "c.isospan", "--points", "regular", "--count", "0"],
        &["reduce", "b.npy", "-o", "c.isospan", "--cross-m", "3", "--cross-k", "2"],
        &["reduce", "b.npy", "-o", "c.isospan", "--shift", "1.5"],
        // What would change nothing is refused.
        &["reduce", "b.npy", "-o", "c.isospan", "--points", "halton", "--shift", "0.5"],
        &["reduce", "b.npy", "-o", "c.isospan", "--cross-r", "2,1,1"],
        &["reduce", "b.npy", "-o", "c.isospan", "--value-file", "b.npy"],
        &[
            "reduce",
            "b.npy",
            "-o",
            "c.isospan",
            "--interp",
            "nearest",
            "--points",
            "regular",
            "--values",
            "fit",
        ],
        &["surface", "b.isospan", "--isovalue", "0", "-o", "b.xyz"],
        &["surface", "b.isospan", "--isovalue", "nan", "-o", "b.ply"],
        &["count", "b.isospan", "--isovalue", "inf"],
        &["check", "b.isospan", "--within", "b.isospan"],
    ];
    for args in usage {
        assert_eq!(fails(d, args).0, 2, "{args:?}");
    }
    // What the argument parser refuses is one line, too.
    let parser: [&[&str]; 6] = [
        &["reduce", "b.npy", "-o", "c.isospan", "--points", "regular", "--fraction", "1/0"],
        &["reduce", "b.npy", "-o", "c.isospan", "--nan", "perhaps"],
        &["reduce", "b.npy", "-o", "c.isospan", "--memory", "much"],
        &["info", "b.npy", "--dims", "1,2"],
        &["frobnicate"],
        &["surface", "b.isospan", "-o", "b.ply"],
    ];
    for args in parser {
        assert_eq!(fails(d, args).0, 2, "{args:?}");
    }
    let (_, text) = fails(d, parser[0]);
    let end = "for '--fraction <FRACTION>': expected a share, as in 1/8, 0.125 or 12.5%; isospan reduce --help tells more\n";
    assert!(text.ends_with(end), "{text}");
    // Without a command the help is shown.
    let out = isospan(d, &[]);
    assert_eq!((out.status.code(), out.stdout.len()), (Some(2), 0));
    assert!(String::from_utf8(out.stderr).unwrap().contains("Usage: isospan"));
    assert_eq!(fails(d, &["reduce", "b.npy", "-o", "c.isospan", "--memory", "1MiB"]).0, 4);
    assert!(!d.join("c.isospan").exists());
    // An archive is replaced only when asked to; a folder that is no archive never.
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
        let args = [
            "reduce",
            "b.npy",
            "-o",
            "b.isospan",
            "--force",
            "--points",
            "regular",
            "--fraction",
            "1/4",
            "--json",
        ];
        json(&ok(d, &[&args[..], more].concat()))["error"]["rms"].as_f64().unwrap()
    };
    let is_fitted = |archive: &str| ok(d, &["info", archive]).contains("fitted to the samples");
    let (usual, sampled) = (rms(&[]), rms(&["--values", "sample"]));
    assert!(usual < 0.9 * sampled, "{usual} {sampled}");
    assert_eq!(usual, rms(&["--values", "fit"]));
    assert!(is_fitted("b.isospan"));
    // Labels stay labels.
    for interp in ["nearest", "cubic-thesis"] {
        ok(d, &["reduce", "b.npy", "-o", "s.isospan", "--force", "--points", "regular", "--interp", interp]);
        assert!(!is_fitted("s.isospan"), "{interp}");
    }
    ok(
        d,
        &[
            "reduce",
            "b.npy",
            "-o",
            "c.isospan",
            "--interp",
            "cubic",
            "--points",
            "regular",
            "--value-bits",
            "12",
        ],
    );
    assert!(is_fitted("c.isospan"));
}

#[test]
fn percentages_of_errors_are_of_the_source_as_those_of_targets() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    // The reduced field keeps little of the peak: its own range is another one.
    write_npy(&d.join("p.npy"), [21, 21, 21], |x, y, z| if x * x + y * y + z * z < 1e-9 { 100.0 } else { x });
    ok(
        d,
        &[
            "reduce",
            "p.npy",
            "-o",
            "p.isospan",
            "--points",
            "regular",
            "--fraction",
            "1/16",
            "--values",
            "sample",
        ],
    );
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
    ok(d, &["reduce", "b.npy", "-o", "b.isospan", "--points", "regular", "--fraction", "1"]);
    let table = ok(d, &["spectrum", "b.isospan", "--plot", "b.svg"]);
    assert!(table.contains("mean gradient") && table.lines().count() > 20, "{table}");
    assert!(fs::read_to_string(d.join("b.svg")).unwrap().contains("Contour spectrum of b"));
    ok(d, &["spectrum", "b.isospan", "--plot", "b.png", "--json"]);
    assert!(fs::read(d.join("b.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(fails(d, &["spectrum", "b.isospan", "--plot", "b.pdf"]).0, 2);
    assert_eq!(fails(d, &["spectrum", "b.npy"]).0, 5);
    // A small archive has no spectrum where they could be looked up.
    let chunks = ["--points", "halton", "--fraction", "1", "--chunk-points", "3000"];
    ok(d, &[&["reduce", "b.npy", "-o", "chunks.isospan"][..], &chunks].concat());
    for (archive, stored) in [("b.isospan", "\"stored\":false"), ("chunks.isospan", "\"stored\":true")] {
        let counts = ok(d, &["count", archive, "-i", "-0.5,0,9", "--json"]);
        assert_eq!(counts.lines().count(), 3);
        assert!(counts.lines().all(|l| l.contains(stored)), "{counts}");
    }
    assert!(ok(d, &["info", "b.isospan"]).contains("area"));
    assert_eq!(fs::read_dir(d).unwrap().count(), 5, "nothing but what was asked for");
}

#[test]
fn a_damaged_archive_or_surface_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("b.npy"), [16, 16, 16], ball);
    let few = ["--points", "halton", "--fraction", "1", "--chunk-points", "150"];
    ok(d, &[&["reduce", "b.npy", "-o", "b.isospan"][..], &few].concat());
    for file in [
        "mesh/000000.seg",
        "steps/000000-values-000000.seg",
        "steps/000000-index.seg",
        "steps/000000-spectrum.seg",
        "manifest.zst",
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
    let text = ok(d, &["reduce", "s*.npy", "-o", "s.isospan", "--points", "regular", "--fraction", "1/4"]);
    let line = text.lines().find(|l| l.starts_with("  error ")).unwrap();
    assert_eq!(line.matches("in step 2").count(), 2, "{line}");
    let steps = json(&ok(d, &["info", "s.isospan", "--json"]))["steps"].clone();
    assert_eq!(steps[0]["error"][0], 0.0);
    let rms = steps[2]["error"][0].as_f64().unwrap();
    let told: f64 = line.split("RMS at most ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((told / rms - 1.0).abs() < 1e-3, "{line}: {rms}");
    // Of one step it is that one's.
    let text = ok(d, &["reduce", "s1.npy", "-o", "one.isospan", "--points", "regular", "--fraction", "1/4"]);
    assert!(
        text.lines().any(|l| l.starts_with("  error       RMS ") && l.contains(" samples; % of")),
        "{text}"
    );
}

#[test]
fn completions_and_manual() {
    let dir = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        assert!(ok(dir.path(), &["completions", shell]).contains("reduce"));
    }
    assert!(ok(dir.path(), &["man"]).contains("isospan"));
    ok(dir.path(), &["man", "--dir", "pages"]);
    for entry in fs::read_dir(dir.path().join("pages")).unwrap() {
        let page = entry.unwrap().path();
        let text = fs::read_to_string(&page).unwrap();
        assert!(["EXIT STATUS", "ENVIRONMENT", "FILES"].iter().all(|s| text.contains(s)), "{page:?}");
        // Where there is groff, it has nothing to say.
        let checked = Command::new("groff").args(["-ww", "-man", "-Kutf8", "-z"]).arg(&page).output();
        if let Ok(checked) = checked {
            assert_eq!(String::from_utf8_lossy(&checked.stderr), "", "{page:?}");
        }
    }
    assert!(dir.path().join("pages/isospan-reduce.1").exists());
    // Commands come in groups; the short version is a line, the long one names the features.
    let help = ok(dir.path(), &["--help"]);
    for words in
        ["Usage: isospan [OPTIONS] <COMMAND>", "Make archives:", "  surface      Extract", "Clusters:"]
    {
        assert!(help.contains(words), "{words}: {help}");
    }
    assert_eq!((ok(dir.path(), &["help"]), ok(dir.path(), &["-h"])), (help.clone(), help));
    assert_eq!(ok(dir.path(), &["-V"]).lines().count(), 1);
    assert!(ok(dir.path(), &["--version"]).contains("\nfeatures: compare hdf5 remote view"));
}

/// A legacy VTK image of 6 x 6 x 6 samples with arrays of a value that rises along x, and lines
/// before and after them.
fn legacy(names: &[&str], head: &str, tail: &str) -> String {
    let values: String = (0..216).map(|i| format!("{} ", i % 6)).collect();
    let arrays: String =
        names.iter().map(|n| format!("SCALARS {n} float\nLOOKUP_TABLE default\n{values}\n")).collect();
    format!(
        "# vtk DataFile Version 3.0\na\nASCII\nDATASET STRUCTURED_POINTS\n{head}DIMENSIONS 6 6 6\nSPACING 1 1 1\n\
         ORIGIN 0 0 0\nPOINT_DATA 216\n{arrays}{tail}"
    )
}

/// A VTI of 6 x 6 x 6 samples, with elements before its piece, and arrays next to the field.
fn vti(head: &str, points: &str, cells: &str) -> String {
    let values: String = (0..216).map(|i| format!("{} ", i % 6)).collect();
    format!(
        "<VTKFile type=\"ImageData\"><ImageData WholeExtent=\"0 5 0 5 0 5\">{head}<Piece Extent=\"0 5 0 5 0 5\">\
         <PointData><DataArray type=\"Float32\" Name=\"v\">{values}</DataArray>{points}</PointData>\
         <CellData>{cells}</CellData></Piece></ImageData></VTKFile>"
    )
}

#[test]
fn names_from_files_do_not_steer_the_terminal() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    // Names of legacy VTK are percent-encoded: red letters, a bell, a new line, the C1 form of the
    // same, a right-to-left override.
    let evil = "a%1b%5b31mb%07c%0aisospan:%20error:%20d%c2%9b31me%e2%80%ae";
    fs::write(d.join("one.vtk"), legacy(&[evil], "", "")).unwrap();
    fs::write(d.join("two.vtk"), legacy(&[evil, "other"], "", "")).unwrap();
    let series = |more: &[&str]| -> Vec<String> { more.iter().map(|s| s.to_string()).collect() };
    let commands = [
        series(&["info", "one.vtk"]),
        series(&["info", "one.vtk", "--json"]),
        series(&["info", "two.vtk"]),
        series(&["info", "two.vtk", "--field", "none"]),
        series(&["reduce", "two.vtk", "-o", "x.isospan"]),
        series(&["reduce", "one.vtk", "-o", "a.isospan", "--dry-run"]),
        series(&["reduce", "one.vtk", "-o", "a.isospan", "-v"]),
        series(&["reduce", "one.vtk", "one.vtk", "-o", "b.isospan", "--json"]),
        series(&["append", "b.isospan", "one.vtk"]),
        series(&["info", "a.isospan"]),
        series(&["info", "b.isospan"]),
        series(&["info", "b.isospan", "--json"]),
        series(&["surface", "a.isospan", "--isovalue", "2.5", "-o", "a.ply", "--stats"]),
        series(&["count", "a.isospan", "--isovalue", "2.5"]),
        series(&["spectrum", "a.isospan"]),
        series(&["check", "a.isospan"]),
        series(&["check", "a.ply"]),
        series(&["measure", "a.isospan", "--against", "one.vtk"]),
        series(&["export", "a.isospan", "-o", "a.vtu"]),
        series(&["probe", "a.isospan", "--grid", "3,3,3", "-o", "a.vti"]),
        series(&["brick", "one.vtk", "-o", "a.bricks"]),
        series(&["info", "a.bricks"]),
        series(&["plan", "one.vtk", "-o", "p.isospan", "--shards", "2"]),
        series(&["status", "p.isospan"]),
        series(&["work", "p.isospan", "--shard", "1/1"]),
        series(&["commit", "p.isospan"]),
    ];
    for args in &commands {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let out = isospan(d, &args);
        for bytes in [&out.stdout, &out.stderr] {
            let text = std::str::from_utf8(bytes).unwrap();
            let steers = |c: char| c.is_control() && c != '\n' || c == '\u{202e}';
            assert!(!text.contains(steers), "{args:?}: {text:?}");
            assert!(!text.lines().any(|l| l.starts_with("isospan: error: d")), "{args:?}: {text}");
        }
    }
    assert!(ok(d, &["info", "one.vtk"]).contains("a\\u001b[31mb\\u0007c\\nisospan"));
}

#[test]
fn info_lists_fields_and_steps() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    fs::write(d.join("two.vtk"), legacy(&["heat", "speed"], "", "")).unwrap();
    let text = ok(d, &["info", "two.vtk"]);
    assert!(text.contains("heat (float32), speed (float32)") && text.contains("--field NAME"), "{text}");
    let levels = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("tests/data/levels.nc");
    let levels = levels.to_str().unwrap();
    let text = ok(d, &["info", levels, "--field", "temp"]);
    assert!(text.contains("steps      3, of which this is the first; times 0 .. 18"), "{text}");
    assert!(text.contains("placed     by the grid's coordinates"), "{text}");
    ok(d, &["reduce", levels, "--field", "temp", "-o", "t.isospan", "--nan", "mask"]);
    let info = json(&ok(d, &["info", "t.isospan", "--json"]));
    let times: Vec<_> = info["steps"].as_array().unwrap().iter().map(|s| s["time"].as_f64()).collect();
    assert_eq!(times, [Some(0.0), Some(6.0), Some(18.0)]);
    ok(d, &["surface", "t.isospan", "--isovalue", "10.25", "-o", "t.ply"]);
    // Latitude 30 at the first row, pressure 1000 at the lowest level, as the file has them.
    let bounds = json(&ok(d, &["check", "t.ply", "--json"]))["bounds"].clone();
    if !bounds.is_null() {
        assert!(bounds[0][2].as_f64().unwrap() >= 700.0, "{bounds}");
    }
}

#[test]
fn files_tell_their_times_and_an_order_in_doubt_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let time = |t: &str| {
        vti(
            &format!(
                "<FieldData><DataArray type=\"Float64\" Name=\"TimeValue\" NumberOfTuples=\"1\">{t}</DataArray></FieldData>"
            ),
            "",
            "",
        )
    };
    for (name, t) in [("s_1.vti", "0.5"), ("s_2.vti", "0.75"), ("s_10.vti", "2.5")] {
        fs::write(d.join(name), time(t)).unwrap();
    }
    fs::write(d.join("t_1.vtk"), legacy(&["v"], "FIELD FieldData 1\nTIME 1 1 double\n4\n", "")).unwrap();
    let times = |archive: &str| -> Vec<Option<f64>> {
        let info = json(&ok(d, &["info", archive, "--json"]));
        info["steps"].as_array().unwrap().iter().map(|s| s["time"].as_f64()).collect()
    };
    ok(d, &["reduce", "s_*.vti", "t_1.vtk", "--field", "v", "-o", "a.isospan"]);
    assert_eq!(times("a.isospan"), [Some(0.5), Some(0.75), Some(2.5), Some(4.0)]);
    let told = |args: &[&str]| String::from_utf8(isospan(d, args).stderr).unwrap();
    let text = told(&["reduce", "s_1.vti", "s_10.vti", "s_2.vti", "-o", "b.isospan"]);
    assert!(
        text.contains("warning: the times of the steps do not rise (time 0.75 comes after 2.5)"),
        "{text}"
    );
    for n in ["1", "10", "2"] {
        write_npy(&d.join(format!("n_{n}.npy")), [6, 6, 6], ball);
    }
    let text = told(&["reduce", "n_1.npy", "n_10.npy", "n_2.npy", "-o", "c.isospan"]);
    assert!(text.contains("do not rise (n_2.npy comes after n_10.npy): a quoted pattern"), "{text}");
    let text = told(&["reduce", "n_1.npy", "n_10.npy", "n_2.npy", "--times", "0,1,2", "-o", "d.isospan"]);
    assert!(!text.contains("warning"), "{text}");
}

#[test]
fn hidden_points_and_cells_of_images_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let marks = |count: usize, mark: u8| {
        let marks: String = (0..count).map(|i| format!("{} ", if i == 7 { mark } else { 0 })).collect();
        format!("<DataArray type=\"UInt8\" Name=\"vtkGhostType\">{marks}</DataArray>")
    };
    for (text, what) in
        [(vti("", &marks(216, 2), ""), "1 of 216"), (vti("", "", &marks(125, 32)), "1 of 125")]
    {
        fs::write(d.join("a.vti"), text).unwrap();
        let (code, line) = fails(d, &["reduce", "a.vti", "-o", "a.isospan"]);
        assert!(
            code == 5 && line.contains("vtkGhostType") && line.contains(what) && line.contains("--nan"),
            "{line}"
        );
    }
    let cells: String = (0..125).map(|i| format!("{} ", if i == 3 { 32 } else { 0 })).collect();
    let tail = format!("CELL_DATA 125\nSCALARS vtkGhostType unsigned_char\nLOOKUP_TABLE default\n{cells}\n");
    fs::write(d.join("a.vtk"), legacy(&["v"], "", &tail)).unwrap();
    let (code, line) = fails(d, &["info", "a.vtk"]);
    assert!(code == 5 && line.contains("CELL_DATA, vtkGhostType"), "{line}");
    // Copies are data, and no field to choose.
    fs::write(d.join("b.vti"), vti("", &marks(216, 1), &marks(125, 1))).unwrap();
    let text = ok(d, &["info", "b.vti"]);
    assert!(!text.contains("vtkGhostType"), "{text}");
}

/// A pipe without a writer would be waited for, and `/dev/zero` has no end: both are refused at
/// once.
#[test]
#[cfg(unix)]
fn what_is_no_regular_file_is_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [20, 18, 16], waves);
    let planned = ["plan", "v.npy", "-o", "p.isospan", "-q"];
    ok(d, &["reduce", "v.npy", "-o", "a.isospan", "-q", "--points", "halton"]);
    ok(d, &planned);
    let fifo = |name: &str| {
        let made = Command::new("mkfifo").arg(d.join(name)).status().unwrap();
        assert!(made.success());
    };
    let zero = |name: &str| std::os::unix::fs::symlink("/dev/zero", d.join(name)).unwrap();
    let refused = |args: &[&str], file: &str| {
        let out = Command::new("timeout")
            .args(["20", env!("CARGO_BIN_EXE_isospan")])
            .args(args)
            .current_dir(d)
            .output()
            .unwrap();
        let text = without_notes(&String::from_utf8(out.stderr).unwrap());
        assert!(matches!(out.status.code(), Some(2 | 5)), "{args:?}: {}: {text}", out.status);
        assert!(text.trim_end().lines().count() == 1 && text.contains(file), "{args:?}: {text}");
    };
    let surface = ["surface", "a.isospan", "--isovalue", "0.1", "-o", "s.ply", "-q"];
    let reduce = ["reduce", "v.npy", "-o", "a.isospan", "-q", "--points", "halton"];
    for (file, questions) in [
        (
            "a.isospan/manifest.zst",
            vec![&surface[..], &["check", "a.isospan"], &["info", "a.isospan"], &reduce],
        ),
        ("a.isospan/mesh/000000.seg", vec![&surface[..], &["check", "a.isospan"]]),
        ("a.isospan/steps/000000-values-000000.seg", vec![&surface[..], &["check", "a.isospan"]]),
        (
            "p.isospan.work/plan.json",
            vec![
                &["work", "p.isospan", "-q"][..],
                &["commit", "p.isospan", "-q"],
                &["status", "p.isospan"],
                &planned,
            ],
        ),
    ] {
        let (path, aside) = (d.join(file), d.join("aside"));
        fs::rename(&path, &aside).unwrap();
        for make in [&fifo as &dyn Fn(&str), &zero] {
            make(file);
            let name = Path::new(file).components().next_back().unwrap().as_os_str().to_string_lossy();
            let name = if name == "plan.json" { "p.isospan" } else { &*name };
            let name = if name == "manifest.zst" { "a.isospan" } else { name };
            questions.iter().for_each(|args| refused(args, name));
            fs::remove_file(&path).unwrap();
        }
        fs::rename(&aside, &path).unwrap();
    }
    // Inputs of every kind.
    for end in [
        "nrrd", "nhdr", "mha", "mhd", "npy", "npz", "nii", "nii.gz", "hdr", "vti", "vtk", "vtr", "vts",
        "tif", "h5", "nc", "bricks", "vtu", "pvtu", "msh", "node", "ele", "pts", "tet", "raw", "pvd",
        "series", "ply", "stl", "obj", "vtp", "vtkhdf", "glb", "csv",
    ] {
        let file = format!("pipe.{end}");
        fifo(&file);
        match end {
            "ply" | "stl" | "obj" | "vtp" | "vtkhdf" | "glb" => refused(&["check", &file], &file),
            "csv" => refused(&["probe", "a.isospan", "--at", &file, "-o", "o.csv", "-q"], &file),
            _ => refused(&["info", &file, "--dims", "4,4,4", "--type", "uint8"], &file),
        }
        if !matches!(end, "ply" | "stl" | "obj" | "vtp" | "glb" | "csv" | "raw") {
            refused(&["reduce", &file, "-o", "x.isospan", "-q"], &file);
        }
    }
    // Metadata and chunks of a folder.
    fs::create_dir(d.join("z.zarr")).unwrap();
    for name in ["z.zarr/zarr.json", "z.zarr/.zarray"] {
        fifo(name);
        refused(&["info", "z.zarr"], "z.zarr");
        fs::remove_file(d.join(name)).unwrap();
    }
}

#[test]
fn what_exists_is_replaced_with_force_alone() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [20, 18, 16], waves);
    ok(d, &["reduce", "v.npy", "-o", "a.isospan", "--points", "regular", "-q"]);
    ok(d, &["surface", "a.isospan", "-i", "0.1", "-o", "s.ply", "-q"]);
    fs::write(d.join("points.csv"), "x,y,z\n1,2,3\n").unwrap();
    let questions: [(&[&str], &str); 9] = [
        (&["surface", "a.isospan", "-i", "0.1", "-q", "-o", "out.ply"], "out.ply"),
        (&["surface", "a.isospan", "-i", "0.1,0.2", "-q", "-o", "out_{}.ply"], "out_0.2.ply"),
        (&["surface", "a.isospan", "-i", "0.1", "--all-steps", "-q", "-o", "t%d.ply"], "t.ply.series"),
        (&["export", "a.isospan", "-q", "-o", "out.vtu"], "out.vtu"),
        (&["probe", "a.isospan", "--grid", "4,4,4", "-q", "-o", "out.vti"], "out.vti"),
        (&["probe", "a.isospan", "--at", "points.csv", "-q", "-o", "out.csv"], "out.csv"),
        (&["spectrum", "a.isospan", "--plot", "out.svg"], "out.svg"),
        (&["measure", "a.isospan", "--against", "v.npy", "-q", "--map", "map.vti"], "map.vti"),
        (&["render", "s.ply", "--size", "40,40", "--lights", "0", "-q", "-o", "out.png"], "out.png"),
    ];
    for (args, file) in questions {
        fs::write(d.join(file), "mine").unwrap();
        let before = folder(d);
        let (code, text) = fails(d, args);
        assert!(code == 2 && text.contains(&format!("{file} exists")) && text.contains("--force"), "{text}");
        assert!(folder(d) == before, "{args:?}");
        ok(d, &[args, &["--force"]].concat());
        assert_ne!(fs::read(d.join(file)).unwrap(), b"mine");
    }
    // What no file can replace is reported before any work, too.
    let (code, text) = fails(d, &["export", "a.isospan", "-o", "a.isospan/mesh", "--force", "-q"]);
    assert_eq!(code, 2, "{text}");
    fs::create_dir(d.join("here")).unwrap();
    for out in ["here", "none/out.vtu"] {
        let (code, text) = fails(d, &["export", "a.isospan", "-o", out, "--force", "-q"]);
        assert!(code == 2 && text.contains("cannot write"), "{text}");
    }
}

#[test]
fn what_is_something_else_is_told_as_that() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v1.npy"), [20, 18, 16], waves);
    write_npy(&d.join("v2.npy"), [20, 18, 16], waves);
    ok(d, &["reduce", "v1.npy", "-o", "a.isospan", "-q"]);
    ok(d, &["surface", "a.isospan", "-i", "0.1", "-o", "s.ply", "-q"]);
    fs::create_dir_all(d.join("u.isospan/mesh")).unwrap();
    fs::create_dir_all(d.join("u.isospan/steps")).unwrap();
    let cases: [(&[&str], i32, &str); 8] = [
        (&["info", "s.ply"], 5, "a surface; of surfaces, isospan check"),
        (&["info", "u.isospan"], 5, "a finished one"),
        (&["status", "u.isospan"], 5, "an unfinished archive of isospan reduce"),
        (&["status", "a.isospan"], 5, "a finished archive that isospan reduce made"),
        (&["slurm", "a.isospan"], 5, "a finished archive that isospan reduce made"),
        (&["work", "none.isospan"], 5, "one that isospan plan made, got none"),
        (&["measure", "a.isospan", "--against", "v*.npy", "-q"], 5, "slices (*.tif)"),
        (&["probe", "a.isospan", "-o", "p.vti"], 2, "<--grid <NX,NY,NZ>|--at <CSV>>"),
    ];
    for (args, code, words) in cases {
        let (got, text) = fails(d, args);
        assert!(got == code && text.contains(words), "{args:?}: {got}: {text}");
    }
    // A quoted pattern is a series; the first step is shown.
    assert!(ok(d, &["info", "v*.npy"]).contains("steps      2, of which this is the first"));
    // No shard is empty.
    let plan = ok(d, &["plan", "v1.npy", "-o", "p.isospan", "--shards", "4", "-q"]);
    assert!(plan.contains("shards     1, each of 1 segment"), "{plan}");
    assert!(plan.contains("not 4: there is 1 segment, and each is made by one worker"), "{plan}");
    assert!(plan.contains("next: isospan work p.isospan, then"), "{plan}");
}

#[test]
fn what_comes_next_can_be_pasted() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [20, 18, 16], |x, y, z| 50.0 * ball(x, y, z));
    let text = ok(d, &["reduce", "v.npy", "-o", "it's a.isospan"]);
    let next = text.lines().last().unwrap().strip_prefix("next: isospan ").unwrap();
    assert!(next.starts_with(r"surface 'it'\''s a.isospan' --isovalue ") && next.contains(" -o "), "{next}");
    let script = format!("\"$0\" {next}");
    let out = Command::new("bash")
        .args(["-c", &script, env!("CARGO_BIN_EXE_isospan")])
        .current_dir(d)
        .output()
        .unwrap();
    assert!(out.status.success() && d.join("it's a.ply").exists(), "{next}");
    // What a run took is one line, and errors are in % of the range.
    for words in ["% of the source's range", " %), at most ", "\n  time        "] {
        assert!(text.contains(words), "{words}: {text}");
    }
}

#[test]
fn a_surface_goes_to_standard_output() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [20, 18, 16], waves);
    ok(d, &["reduce", "v.npy", "-o", "a.isospan", "-q"]);
    for format in ["ply", "stl", "vtp", "vtkhdf"] {
        let file = format!("s.{format}");
        ok(d, &["surface", "a.isospan", "-i", "0.1", "-o", &file, "-q"]);
        let out = isospan(d, &["surface", "a.isospan", "-i", "0.1", "-o", "-", "--format", format]);
        assert!(out.status.success() && out.stdout == fs::read(d.join(&file)).unwrap(), "{format}");
        let told = String::from_utf8(out.stderr).unwrap();
        assert!(told.contains("standard output: ") && told.contains(" triangles"), "{told}");
    }
    ok(d, &["surface", "a.isospan", "-i", "0.1", "-o", "named", "--format", "stl", "-q"]);
    assert!(fs::read(d.join("named")).unwrap() == fs::read(d.join("s.stl")).unwrap());
    for more in ["--json", "--all-steps"] {
        let (code, text) = fails(d, &["surface", "a.isospan", "-i", "0.1", "-o", "-", "-q", more]);
        assert!(code == 2 && text.contains("-o"), "{text}");
    }
    assert!(!d.join("-").exists());
}

#[test]
fn percentages_stand_for_values() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for (n, most) in [(0, 10.0), (1, 30.0)] {
        write_npy(&d.join(format!("v{n}.npy")), [20, 18, 16], |x, _, _| (x + 1.0) * most / 2.0);
    }
    ok(d, &["reduce", "v?.npy", "-o", "a.isospan", "--points", "regular", "--values", "sample", "-q"]);
    let count = |isovalue: &str, step: &str| {
        json(&ok(d, &["count", "a.isospan", "-i", isovalue, "--step", step, "--json"]))["isovalue"].clone()
    };
    assert_eq!(
        (count("50%", "0"), count("50%", "1"), count("7", "1")),
        (5.0.into(), 15.0.into(), 7.0.into())
    );
    let told = json(&ok(d, &["surface", "a.isospan", "-i", "10%", "-o", "s.ply", "--json", "-q"]));
    assert_eq!(told["surfaces"][0]["isovalue"], 1.0);
    // Of several steps, of their values together.
    let told =
        json(&ok(d, &["surface", "a.isospan", "-i", "50%", "--all-steps", "-o", "s%d.ply", "--json", "-q"]));
    assert!((0..2).all(|n| told["steps"][n]["surfaces"][0]["isovalue"] == 15.0), "{told}");
    let part = |range: &str| {
        let args = ["export", "a.isospan", "-o", "e.vtu", "--force", "--json", "-q", "--range", range];
        json(&ok(d, &args))["tetrahedra"].as_u64().unwrap()
    };
    assert_eq!(part("20%:80%"), part("2:8"));
    assert!(part("20%:80%") < part("10%:"));
    let adapt = |focus: &str, out: &str| {
        let args = ["reduce", "v0.npy", "-o", out, "--adapt", "--focus", focus, "--fraction", "1/4", "-q"];
        ok(d, &args);
        fs::read(d.join(out).join("mesh/000000.seg")).unwrap()
    };
    assert!(adapt("20%:50%", "p.isospan") == adapt("2:5", "q.isospan"));
    let small = json(&ok(d, &["reduce", "v0.npy", "-o", "r.isospan", "--size", "50%", "--json", "-q"]));
    assert!(
        small["archive_bytes"].as_u64().unwrap() <= small["source_bytes"].as_u64().unwrap() / 2,
        "{small}"
    );
    // Two steps have twice the samples of one.
    let samples = |name: &str| json(&ok(d, &["info", name, "--json"]))["sample_bytes"].as_u64().unwrap();
    let source = small["source_bytes"].as_u64().unwrap();
    assert_eq!((samples("r.isospan"), samples("a.isospan")), (source, 2 * source));
    let words = ok(d, &["info", "r.isospan"]);
    assert!(words.contains("  bits        ") && !words.contains("ratio"), "{words}");
}

/// Under any name: a link, a hard link, the raw data of a header, a file in the archive's folder.
#[test]
#[cfg(unix)]
fn an_output_never_replaces_an_input() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [20, 18, 16], waves);
    let samples: Vec<u8> = (0..20 * 18 * 16u32).flat_map(|i| ((i % 97) as f32).to_le_bytes()).collect();
    fs::write(d.join("v.raw"), &samples).unwrap();
    let head = "NRRD0004\ntype: float\ndimension: 3\nsizes: 20 18 16\nencoding: raw\nendian: little\ndata file: v.raw\n";
    fs::write(d.join("v.nhdr"), head).unwrap();
    fs::hard_link(d.join("v.raw"), d.join("hard.bricks")).unwrap();
    std::os::unix::fs::symlink("v.raw", d.join("soft.bricks")).unwrap();
    ok(d, &["reduce", "v.nhdr", "-o", "a.isospan", "-q"]);
    ok(d, &["surface", "a.isospan", "-i", "40", "-o", "s.ply", "-q"]);
    fs::write(d.join("points.csv"), "1,2,3\n").unwrap();
    fs::copy(d.join("s.ply"), d.join("s.png")).unwrap();
    let into = |file: &str| format!("a.isospan/{file}");
    let before = folder(d);
    for args in [
        vec!["brick", "v.nhdr", "--force", "-o", "v.nhdr"],
        vec!["brick", "v.nhdr", "--force", "-o", "v.raw"],
        vec!["brick", "v.nhdr", "--force", "-o", "./hard.bricks"],
        vec!["brick", "v.nhdr", "--force", "-o", "soft.bricks"],
        vec!["surface", "a.isospan", "-i", "40", "-q", "-o", &into("s.ply")],
        vec!["surface", "a.isospan", "-i", "40,41", "-q", "-o", &into("s_{}.ply")],
        vec!["export", "a.isospan", "-q", "-o", &into("mesh/e.vtu")],
        vec!["probe", "a.isospan", "--grid", "4,4,4", "-q", "-o", &into("p.vti")],
        vec!["probe", "a.isospan", "--at", "points.csv", "-q", "-o", "points.csv"],
        vec!["spectrum", "a.isospan", "--plot", &into("p.svg")],
        vec!["render", "s.png", "-q", "-o", "s.png"],
        vec!["render", "a.isospan", "-i", "40", "-q", "-o", &into("r.png")],
        vec!["measure", "a.isospan", "--against", "v.nhdr", "-q", "--map", &into("m.vti")],
        vec!["reduce", "a.isospan/steps/000000-values-000000.seg", "-o", "a.isospan", "--force", "-q"],
        vec!["plan", "a.isospan/steps/000000-values-000000.seg", "-o", "a.isospan", "--force", "-q"],
    ] {
        let (code, text) = fails(d, &args);
        assert!(code == 2 && text.contains("choose another name"), "{args:?}: {code}: {text}");
        assert!(folder(d) == before, "{args:?}");
    }
}

#[test]
fn a_step_of_an_input_is_shown() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for n in 0..3 {
        write_npy(&d.join(format!("v{n}.npy")), [8, 7, 6], |x, _, _| x + f64::from(n));
    }
    let shown = |more: &[&str]| json(&ok(d, &[&["info", "v?.npy", "--json"], more].concat()));
    for (more, step) in [(&[][..], 0), (&["--step", "2"], 2), (&["--time", "1"], 1)] {
        let found = shown(more);
        assert_eq!((&found["step"], &found["scan"]["min"]), (&step.into(), &(f64::from(step) - 1.0).into()));
    }
    assert!(ok(d, &["info", "v?.npy", "--step", "2"]).contains("steps      3, of which this is number 2"));
    for (more, words) in [
        (["--step", "3"], "no step 3; the steps are 0 to 2"),
        (["--time", "0.5"], "no step at time 0.5; the times are 0 to 2"),
    ] {
        let (code, text) = fails(d, &[&["info", "v?.npy"], &more[..]].concat());
        assert!(code == 2 && text.contains(words), "{text}");
    }
    assert_eq!(fails(d, &["info", "v0.npy", "--step", "1"]).0, 2);
}

#[test]
fn spacing_and_origin_are_for_files_without_them() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [8, 7, 6], ball);
    write_hexahedra(&d.join("m.vtk"), waves);
    let place = ["--spacing", "1,2,3", "--origin", "-4,0,0.5"];
    let info = json(&ok(d, &[&["info", "v.npy", "--json"], &place[..]].concat()));
    assert_eq!(info["info"]["geometry"]["spacing"], serde_json::json!([1.0, 2.0, 3.0]));
    assert_eq!(info["info"]["geometry"]["origin"], serde_json::json!([-4.0, 0.0, 0.5]));
    ok(d, &[&["reduce", "v.npy", "-o", "a.isospan", "-q"], &place[..]].concat());
    ok(d, &["probe", "a.isospan", "--grid", "4,4,4", "-o", "p.vti", "-q"]);
    for file in ["p.vti", "m.vtk"] {
        let (code, text) = fails(d, &[&["info", file], &place[..]].concat());
        assert!(code == 2 && text.contains("leave out --spacing and --origin"), "{text}");
    }
    let (code, text) = fails(d, &["info", "v.npy", "--spacing", "1,-1,1"]);
    assert!(code == 2 && text.contains("must be a positive number"), "{text}");
}

#[test]
fn a_target_that_is_not_met_has_an_exit_code() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [20, 18, 16], waves);
    let out = isospan(
        d,
        &["reduce", "v.npy", "-o", "a.isospan", "--points", "hammersley", "--target-rms", "1e-9%", "-q"],
    );
    let told = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(6), "{told}");
    assert!(told.contains("a.isospan: written, but the target is not met: RMS "), "{told}");
    let report = String::from_utf8(out.stdout).unwrap();
    assert!(report.contains("NOT MET") && report.matches("fit ").count() <= 1, "{report}");
    // The times of all tries together, a number for each stage.
    let out = isospan(
        d,
        &[
            "reduce",
            "v.npy",
            "-o",
            "c.isospan",
            "--points",
            "hammersley",
            "--target-rms",
            "1e-9%",
            "--json",
            "-q",
        ],
    );
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((out.status.code(), &report["target"]["met"]), (Some(6), &false.into()), "{report}");
    assert!(report["seconds"]["fit"].as_f64().unwrap() > 0.0, "{report}");
    ok(d, &["check", "a.isospan"]);
    let (code, text) = fails(d, &["reduce", "v.npy", "-o", "b.isospan", "--size", "5"]);
    assert!(code == 2 && text.contains("expected a unit: 5MiB, or 5% of the source"), "{text}");
}

#[test]
fn a_cut_surface_is_checked_with_its_box() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [26, 22, 20], ball);
    let place = ["--spacing", "0.5,2,1", "--origin", "7,-3,100"];
    ok(
        d,
        &[
            &["reduce", "v.npy", "-o", "a.isospan", "--points", "regular", "--fraction", "1/2", "-q"],
            &place[..],
        ]
        .concat(),
    );
    for roi in ["5:14.5,:,8:", "world:10:14,:,-1e3:111"] {
        ok(d, &["surface", "a.isospan", "-i", "0.1", "-o", "s.ply", "--roi", roi, "--force", "-q"]);
        let check = ["check", "s.ply", "--within", "a.isospan"];
        let out = isospan(d, &check);
        assert_eq!(out.status.code(), Some(5), "{roi}");
        assert!(String::from_utf8_lossy(&out.stderr).contains("same --roi BOX"), "{out:?}");
        assert!(ok(d, &[&check[..], &["--roi", roi]].concat()).contains("s.ply: sound"), "{roi}");
        // Another box is none that it was cut at.
        let other = isospan(d, &[&check[..], &["--roi", "6:15,:,7:"]].concat());
        assert_eq!(other.status.code(), Some(5), "{roi}");
    }
}

#[test]
fn caps_are_for_meshes_that_fill_their_box() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let value = |p: [f64; 3]| p[0] + 0.3 * p[1];
    write_mesh(&d.join("full.vtk"), 5, |_| true, |p| p, value);
    write_mesh(&d.join("part.vtk"), 5, |p| p[0] < 0.5 || p[1] < 0.5, |p| p, value);
    for (name, fraction) in [("full", "1"), ("part", "1"), ("part", "1/2")] {
        let input = format!("{name}.vtk");
        ok(d, &["reduce", &input, "-o", "a.isospan", "--fraction", fraction, "--force", "-q"]);
        let surface = ["surface", "a.isospan", "-i", "50%", "-o", "s.ply", "--cap", "--force", "-q"];
        if name == "full" {
            ok(d, &surface);
            assert_eq!(json(&ok(d, &["check", "s.ply", "--json"]))["boundary_edges"], 0);
        } else {
            let (code, text) = fails(d, &surface);
            assert!(code == 2 && text.contains("this mesh does not fill its box"), "{text}");
        }
    }
}

#[test]
fn a_series_of_surfaces_is_made_in_parts() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for n in 0..4 {
        write_npy(&d.join(format!("v{n}.npy")), [12, 11, 10], |x, y, z| ball(x, y, z) + 0.01 * f64::from(n));
    }
    ok(d, &["reduce", "v[0-2].npy", "-o", "a.isospan", "-q"]);
    let added = ok(d, &["append", "a.isospan", "v3.npy", "-q"]);
    assert!(added.contains("  added       step 3: v3.npy: data, "), "{added}");
    for (format, list) in [("ply", "s.ply.series"), ("vtp", "s.pvd")] {
        let out = format!("s%d.{format}");
        let part = |steps: &str| {
            ok(d, &["surface", "a.isospan", "-i", "0", "--steps", steps, "-o", &out, "--force"])
        };
        let files = || fs::read_to_string(d.join(list)).unwrap().matches(&format!(".{format}\"")).count();
        assert!(!part("2:3").contains("listed too") && files() == 2);
        assert!(part("0:2").contains("listed too    1 file of earlier runs"));
        assert_eq!(files(), 4);
        let list = fs::read_to_string(d.join(list)).unwrap();
        assert!(list.find("s0.").unwrap() < list.find("s3.").unwrap(), "{list}");
        fs::remove_file(d.join(format!("s3.{format}"))).unwrap();
        part("0:1");
        assert_eq!(files(), 3, "a file that is gone is no longer listed");
    }
}

#[test]
fn a_surface_never_becomes_nothing_unnoticed() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [14, 13, 12], ball);
    ok(d, &["reduce", "v.npy", "-o", "a.isospan", "--points", "regular", "--fraction", "1/2", "-q"]);
    let surface = |more: &[&'static str]| [&["surface", "a.isospan", "-q", "--force"], more].concat();
    let text = ok(d, &surface(&["-i", "0.1", "-o", "s.ply", "--components"]));
    assert!(text.contains("volume  boundary") && text.contains("closed"), "{text}");
    let before = fs::read(d.join("s.ply")).unwrap();
    let (code, text) = fails(d, &surface(&["-i", "9", "-o", "s.ply"]));
    assert!(code == 2 && text.contains("s.ply stays as it is: no surface has the isovalue 9"), "{text}");
    assert!(fs::read(d.join("s.ply")).unwrap() == before);
    let (code, text) = fails(d, &surface(&["-i", "150%", "-o", "t.ply"]));
    assert!(code == 2 && text.contains("from 0% to 100%"), "{text}");
    let (code, text) = fails(d, &surface(&["-i", "0", "-o", "t.ply", "--decimate", "25"]));
    assert!(code == 2 && text.contains("25 % is written 25%"), "{text}");
    // Formats that join isovalues say so.
    for (file, warns) in
        [("t.stl", true), ("t.glb", false), ("t.vtp", false), ("t.vtkhdf", false), ("t_{}.stl", false)]
    {
        let out = isospan(d, &["surface", "a.isospan", "-i", "0,0.1", "-o", file]);
        let told = String::from_utf8(out.stderr).unwrap();
        assert!(out.status.success() && told.contains("does not keep isovalues apart") == warns, "{told}");
    }
}

#[test]
fn words_of_the_program_fit_what_is_there() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [12, 12, 12], ball);
    fs::create_dir(d.join("empty")).unwrap();
    let (code, text) = fails(d, &["spectrum", "empty"]);
    assert!(code == 5 && text.contains("got an empty folder"), "{text}");
    let (code, text) = fails(d, &["spectrum", "."]);
    assert!(code == 5 && text.contains("got a folder of other files"), "{text}");
    let (code, text) = fails(d, &["brick", "v.npy", "-o", "v.npy"]);
    assert!(code == 2 && text.contains("the output v.npy, which this command reads, too"), "{text}");
    assert!(ok(d, &["man", "surface"]).contains("isospan-surface"));
    assert_eq!(fails(d, &["man", "frobnicate"]).0, 2);
    let plan = ["plan", "v.npy", "-o", "p q.isospan", "-q"];
    ok(d, &plan);
    let next = ok(d, &["slurm", "p q.isospan", "-q"]);
    assert!(next.contains("or isospan slurm 'p q.isospan' --submit"), "{next}");
}
