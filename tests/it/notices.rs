//! What `info`, `reduce`, `plan` and `append` say of their input before they work: one line each,
//! and nothing of ordinary data.

use crate::common::*;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Standard output and the notices on standard error of a run that succeeds.
fn run(dir: &Path, args: &[&str]) -> (String, Vec<String>) {
    run_to(dir, args, 0)
}

/// The same of a run that ends with an exit code.
fn run_to(dir: &Path, args: &[&str], code: i32) -> (String, Vec<String>) {
    let program = env!("CARGO_BIN_EXE_isospan");
    let out = Command::new(program).current_dir(dir).args(args).output().unwrap();
    let (stdout, stderr) = (String::from_utf8(out.stdout).unwrap(), String::from_utf8(out.stderr).unwrap());
    assert_eq!(out.status.code(), Some(code), "{args:?}: {stderr}");
    // A slow machine reports progress after ten seconds.
    let is_progress = |l: &str| l.starts_with("isospan: --memory ") || l.contains(" a second, ");
    // NPY never says how far samples lie apart; one test is about that.
    let is_npy = |l: &str| l.contains(".npy: it does not say how far samples lie apart");
    let lines = stderr.lines().filter(|l| !is_progress(l) && !is_npy(l));
    (stdout, lines.map(str::to_owned).collect())
}

fn notices(dir: &Path, args: &[&str]) -> Vec<String> {
    run(dir, args).1
}

/// A smooth field in 0.1 to 3.2.
fn smooth(x: f64, y: f64, z: f64) -> f64 {
    1.65 + 1.55 * (2.0 * x + y).sin() * (y - z).cos()
}

fn bytes(path: &Path, dims: [usize; 3], value: impl Fn(usize, usize, usize) -> u8) {
    let [nx, ny, nz] = dims;
    let header = format!(
        "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {nx} {ny} {nz}\nspacings: 1 1 1\nencoding: raw\n\n"
    );
    let samples = (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])));
    let samples = samples.map(|[x, y, z]| value(x, y, z));
    fs::write(path, header.into_bytes().into_iter().chain(samples).collect::<Vec<u8>>()).unwrap();
}

#[test]
fn fill_values_are_named_by_every_door() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let filled = |x: f64, y: f64, z: f64| if x < 0.0 { -1e34 } else { smooth(x, y, z) };
    write_npy(&d.join("a.npy"), [20, 20, 20], filled);
    let line = "isospan: a.npy: 50 % of the samples are exactly -1e34, far from the others (0.4409311 .. 3.198467): \
                if that means \"no data\", give --missing -1e34 --nan mask";
    let reduce = ["reduce", "a.npy", "-o", "a.isospan"];
    assert_eq!(notices(d, &["info", "a.npy"]), [line]);
    assert_eq!(notices(d, &[&reduce[..], &["--dry-run"]].concat()), [line]);
    assert_eq!(notices(d, &["plan", "a.npy", "-o", "p.isospan"]), [line]);
    assert_eq!(notices(d, &reduce), [line]);
    assert_eq!(notices(d, &[&reduce[..], &["--force", "--progress", "none"]].concat()), [line]);
    // What was asked for, and what was answered, is not said.
    assert_eq!(notices(d, &[&reduce[..], &["--force", "-q"]].concat()), [""; 0]);
    let masked = ["--missing", "-1e34", "--nan", "mask"];
    assert_eq!(
        notices(d, &[&["reduce", "a.npy", "-o", "m.isospan", "--points", "regular"], &masked[..]].concat()),
        [""; 0]
    );
    // Further steps, and a report for programs.
    write_npy(&d.join("b.npy"), [20, 20, 20], |x, y, z| filled(x, y, z) * 2.0);
    let (json, said) = run(d, &["append", "m.isospan", "b.npy", "--json", "--progress", "json"]);
    let said: Vec<_> = said.iter().filter(|l| l.contains("b.npy")).collect();
    assert!(said[0].contains("b.npy: 50 % of the samples are exactly -2e34, far"), "{said:?}");
    assert!(said[0].starts_with("{\"event\":\"note\""), "{said:?}");
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (&report["notices"][0]["kind"], &report["notices"][0]["share"]),
        (&"fill".into(), &0.5.into())
    );
}

#[test]
fn ordinary_data_are_silent() {
    let dir = tempfile::tempdir().unwrap();
    let data = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("datasets");
    for name in ["tooth/tooth.nhdr", "ironprot.vtk"] {
        let input = data.join(name).display().to_string();
        assert_eq!(notices(dir.path(), &["info", &input]), [""; 0]);
        assert_eq!(notices(dir.path(), &["reduce", &input, "-o", "a.isospan", "--dry-run"]), [""; 0]);
    }
    // A series may begin with nothing.
    write_npy(&dir.path().join("a.npy"), [20, 20, 20], |_, _, _| 0.0);
    write_npy(&dir.path().join("b.npy"), [20, 20, 20], smooth);
    assert_eq!(notices(dir.path(), &["reduce", "a.npy", "b.npy", "-o", "s.isospan"]), [""; 0]);
}

/// A report beside a series of pydicom's is no slice, and is not lost without a word.
#[test]
fn files_that_are_no_slices_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let data = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("tests/data/dicom");
    fs::create_dir(d.join("scan")).unwrap();
    for slice in ["a", "b", "c", "d", "e"] {
        fs::copy(data.join("series").join(slice), d.join("scan").join(slice)).unwrap();
    }
    let reduce = ["reduce", "scan", "-o", "a.isospan"];
    assert_eq!(notices(d, &["info", "scan"]), [""; 0]);
    fs::copy(data.join("report"), d.join("scan/report")).unwrap();
    fs::write(d.join("scan/notes.txt"), "a text").unwrap();
    let line = "isospan: scan: 2 files of the folder are no slices, and passed over: notes.txt, report";
    assert_eq!(notices(d, &["info", "scan"]), [line]);
    assert_eq!(notices(d, &[&reduce[..], &["--dry-run"]].concat()), [line]);
    assert_eq!(notices(d, &reduce), [line]);
}

#[test]
fn a_spacing_that_is_assumed_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("p.npy"), [9, 8, 7], smooth);
    let header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 9 8 7\nspacings: 1 nan 1\nencoding: raw\n\n";
    let samples: Vec<u8> = (0..504usize).map(|n| (n * n % 251) as u8).collect();
    fs::write(d.join("p.nrrd"), [header.as_bytes(), &samples].concat()).unwrap();
    let said = |args: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(d).args(args).output().unwrap();
        assert_eq!(out.status.code(), Some(0), "{args:?}");
        String::from_utf8(out.stderr).unwrap()
    };
    let npy = "isospan: p.npy: it does not say how far samples lie apart: a spacing of 1 is assumed; \
               --spacing X,Y,Z gives another\n";
    let nrrd = "isospan: p.nrrd: it does not say how far samples lie apart along y: a spacing of 1 is assumed; \
                write it into the file\n";
    for (input, line) in [("p.npy", npy), ("p.nrrd", nrrd)] {
        let out = format!("{input}.isospan");
        assert_eq!(said(&["info", input]), line);
        assert_eq!(said(&["info", input, "--no-scan"]), line);
        assert_eq!(said(&["reduce", input, "-o", &out, "--progress", "none"]), line);
        // The archive has one already.
        assert_eq!(said(&["append", &out, input, "--progress", "none"]), "");
    }
    let given = ["--spacing", "2,2,2", "--progress", "none"];
    assert_eq!(said(&[&["info", "p.npy"][..], &given[..2]].concat()), "");
    assert_eq!(said(&[&["reduce", "p.npy", "-o", "g.isospan"][..], &given].concat()), "");
    let json: serde_json::Value = serde_json::from_str(&run(d, &["info", "p.nrrd", "--json"]).0).unwrap();
    assert_eq!(json["notices"][0]["kind"], "assumed-spacing");
    assert_eq!(json["notices"][0]["axes"], serde_json::json!([false, true, false]));
}

#[test]
fn a_constant_field_and_a_stretched_range_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("c.npy"), [20, 20, 20], |_, _, _| 5.0);
    let line =
        "isospan: c.npy: all samples are 5: no isovalue has a surface; is it the right field (--field)?";
    assert_eq!(notices(d, &["info", "c.npy"]), [line]);
    assert_eq!(notices(d, &["reduce", "c.npy", "-o", "c.isospan"]), [line]);
    write_npy(&d.join("s.npy"), [21, 21, 21], |x, y, z| {
        if [x, y, z] == [0.5, 0.0, -0.5] { 1e10 } else { smooth(x, y, z) }
    });
    let said = notices(d, &["reduce", "s.npy", "-o", "s.isospan", "--dry-run"]);
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(
        said[0].starts_with("isospan: s.npy: ")
            && said[0].contains(" 1 of 9 261 samples is 1e10, the others 0."),
        "{said:?}"
    );
    let help = ": % and --value-bits count from the whole range; if 1e10 means \"no data\", \
                give --missing 1e10 --nan mask; else give errors in units of the field";
    assert!(said[0].ends_with(help), "{said:?}");
    assert_eq!(notices(d, &["info", "s.npy"]), said);
}

#[test]
fn labels_are_pointed_to_nearest() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    bytes(&d.join("l.nrrd"), [30, 30, 30], |x, y, z| [0, 7, 3, 200][(x / 15 + 2 * (y / 12) + z / 20).min(3)]);
    let line = "isospan: l.nrrd: the samples have 4 different values (0 .. 200), as labels do: \
                --labels keeps them, in the fewest bytes; so do --lossless, and --interp nearest at points";
    assert_eq!(notices(d, &["info", "l.nrrd"]), [line]);
    assert_eq!(notices(d, &["reduce", "l.nrrd", "-o", "l.isospan", "--dry-run"]), [line]);
    assert_eq!(
        notices(d, &["reduce", "l.nrrd", "-o", "l.isospan", "--points", "regular", "--interp", "nearest"]),
        [""; 0]
    );
}

#[test]
fn more_points_than_samples_and_a_large_archive_are_named_before_work() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let wave = |x: usize, y: usize, z: usize| {
        (100.0 + 90.0 * (x as f64 * 0.11).sin() * (0.07 * (y + z) as f64).cos()) as u8
    };
    bytes(&d.join("u.nrrd"), [64, 64, 64], wave);
    let dry = |more: &[&str]| {
        notices(
            d,
            &[&["reduce", "u.nrrd", "-o", "u.isospan", "--points", "regular", "--dry-run"], more].concat(),
        )
    };
    let larger = "isospan: u.nrrd: the archive takes about 1.5 MiB (48.0 bits a sample), more than its source, \
                  256.0 KiB (8.0 bits a sample): --fraction 1/8 or --value-bits makes it smaller";
    assert_eq!(dry(&["--fraction", "100%"]), [larger]);
    assert_eq!(dry(&["--fraction", "12.5%"]), [""; 0]);
    let said = dry(&["--fraction", "200%"]);
    let more = "isospan: u.nrrd: --fraction 2 asks for 524 288 points, more than its 262 144 samples: \
                --points regular --fraction 1 has a point at each sample";
    assert_eq!((said.len(), said[0].as_str()), (2, more));
    let more = "isospan: u.nrrd: --count 300000 asks for 300 000 points, more than its 262 144 samples: \
                --points regular --fraction 1 has a point at each sample";
    assert_eq!(dry(&["--count", "300000"])[0], more);
    // What is said to help: a point at each sample has its value.
    bytes(&d.join("v.nrrd"), [20, 20, 20], wave);
    let exact = ["reduce", "v.nrrd", "-o", "v.isospan", "--points", "regular", "--fraction", "1", "--json"];
    let report: serde_json::Value = serde_json::from_str(&run(d, &exact).0).unwrap();
    assert_eq!((&report["points"], &report["error"]["max"]), (&8000.into(), &0.0.into()), "{report}");
}

#[test]
fn an_archive_larger_than_its_source_is_told_after_a_search() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let noise = |x: usize, y: usize, z: usize| {
        ((x * 7919 + y * 104_729 + z * 1_299_709) as u32).wrapping_mul(2_654_435_761).to_be_bytes()[0]
    };
    bytes(&d.join("n.nrrd"), [40, 40, 40], noise);
    let target = ["--target-rms", "1%", "--points", "halton"];
    let args = ["reduce", "n.nrrd", "-o", "n.isospan", "--json", "--progress", "none"];
    let args = [&args[..], &target[..]].concat();
    let (json, said) = run_to(d, &args, 6);
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    let [archive, source] = ["archive_bytes", "source_bytes"].map(|name| report[name].as_u64().unwrap());
    assert_eq!(source, 64_000);
    assert!(archive > 300_000, "{archive}");
    let [kib, bits] = [archive as f64 / 1024.0, archive as f64 * 8.0 / 64_000.0];
    let line = format!(
        "isospan: n.nrrd: the archive takes {kib:.1} KiB ({bits:.1} bits a sample), more than its source, 62.5 KiB (8.0 bits a sample): \
         a larger error or --value-bits makes it smaller"
    );
    assert_eq!((said.len(), &said[0]), (2, &line));
    assert!(said[1].contains("the target is not met: "), "{}", said[1]);
    assert_eq!(report["notices"][0]["text"], line["isospan: ".len()..]);
    assert_eq!(report["notices"][0]["estimated"], false);
    // The report for a person always has both sizes.
    let exact = ["--points", "hammersley", "--fraction", "1/16"];
    let (text, said) = run(d, &[&["reduce", "n.nrrd", "-o", "m.isospan"][..], &exact].concat());
    assert_eq!(said, [""; 0]);
    assert!(text.contains("  ratio       1/2.") && text.contains(" of the source (62.5 KiB): "), "{text}");
    assert!(text.contains(" bits a sample, the source 8.00\n"), "{text}");
}

/// Where the mesh itself would be the better archive, that is said once: before work by its size,
/// or after it by the error.
#[test]
fn a_mesh_that_would_better_be_kept_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let noise = |p: [f64; 3]| (1e4 * (p[0] * 12.9898 + p[1] * 78.233 + p[2] * 37.719).sin()).fract();
    write_mesh(&d.join("small.vtk"), 8, |_| true, |p| p, |p| p[0]);
    write_mesh(&d.join("large.vtk"), 26, |_| true, |p| p, noise);
    let asked = |input: &str, more: &[&str]| {
        notices(d, &[&["reduce", input, "-o", "m.isospan", "--force"], more].concat())
    };
    let small = "isospan: small.vtk: 91 points of its 729 vertices take about 5.7 KiB, and have an error: \
                 --fraction 1 keeps the mesh itself, with no error, in about 15.6 KiB";
    assert_eq!(asked("small.vtk", &["--dry-run"]), [small]);
    assert_eq!(asked("small.vtk", &[]), [small]);
    let rounded = asked("small.vtk", &["--dry-run", "--value-bits", "8"]);
    assert!(rounded.len() == 1 && rounded[0].contains("no error but that of --value-bits"), "{rounded:?}");
    for kept in [&["--fraction", "1"][..], &["--count", "729"]] {
        assert_eq!(asked("small.vtk", kept), [""; 0]);
    }
    let more = "isospan: small.vtk: --count 800 asks for 800 points, more than its 729 vertices: \
                the mesh itself is kept, as by --fraction 1";
    assert_eq!(asked("small.vtk", &["--count", "800"]), [more]);
    let more = "isospan: small.vtk: --fraction 2 asks for 1 458 points, more than its 729 vertices: \
                --fraction 1 keeps the mesh itself, with no error";
    assert_eq!(asked("small.vtk", &["--fraction", "2", "--dry-run"]), [more]);
    // Other points were asked for by name.
    assert_eq!(asked("small.vtk", &["--points", "halton", "--dry-run"]), [""; 0]);
    // A large mesh: nothing is known before its error is.
    assert_eq!(asked("large.vtk", &["--dry-run"]), [""; 0]);
    let said = asked("large.vtk", &[]);
    assert!(said.len() == 1 && said[0].contains("large.vtk: the RMS error is "), "{said:?}");
    assert!(
        said[0].ends_with("--fraction 1 keeps the mesh itself, with no error, in about 293.2 KiB"),
        "{said:?}"
    );
    let nearly = asked("large.vtk", &["--fraction", "0.7"]);
    assert!(
        nearly.len() == 1 && nearly[0].contains("13 778 points of its 19 683 vertices take"),
        "{nearly:?}"
    );
}
