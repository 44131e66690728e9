//! Plan, work and commit give the bytes of `reduce`, however the work is cut, repeated, killed or
//! damaged on the way.
#![cfg(unix)]

use crate::common::*;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::LazyLock;

fn command(dir: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
    command.current_dir(dir).args(args).args(["-q"]).stdin(Stdio::null());
    command
}

fn run(dir: &Path, args: &[&str]) -> (i32, String, String) {
    let Output { status, stdout, stderr } = command(dir, args).output().unwrap();
    let text = |b| String::from_utf8(b).unwrap();
    (status.code().expect("ended by itself"), text(stdout), text(stderr))
}

fn ok(dir: &Path, args: &[&str]) -> String {
    let (code, out, err) = run(dir, args);
    assert!(code == 0 && err.is_empty(), "{args:?}: {code}: {err}");
    out
}

/// The exit code and the one line of the error.
fn fails(dir: &Path, args: &[&str]) -> (i32, String) {
    let (code, out, err) = run(dir, args);
    assert!(code != 0 && out.is_empty() && err.trim_end().lines().count() == 1, "{args:?}: {out}{err}");
    (code, err)
}

/// As many segments as such a small volume can have: a chunk is a brick, of about a thousand
/// points.
const SEGMENTS: usize = 4;
const CHOICES: [&str; 6] = ["--points", "hammersley", "--fraction", "1/2", "--chunk-points", "120"];

fn plan(dir: &Path, input: &str, out: &str, shards: &str, more: &[&str]) -> String {
    ok(dir, &[&["plan", input, "-o", out, "--shards", shards, "--json"], &CHOICES[..], more].concat())
}

fn work(dir: &Path, out: &str, shard: &str) -> String {
    ok(dir, &["work", out, "--shard", shard, "--memory", "256MiB"])
}

/// A volume in a folder of the test's own, and what `reduce` makes of it.
struct Case {
    dir: tempfile::TempDir,
    expected: &'static BTreeMap<PathBuf, Vec<u8>>,
}

impl Case {
    fn new() -> Self {
        static EXPECTED: LazyLock<BTreeMap<PathBuf, Vec<u8>>> = LazyLock::new(|| {
            let dir = Case::volume();
            let args = [&["reduce", "v.npy", "-o", "whole.isospan"], &CHOICES[..]].concat();
            ok(dir.path(), &args);
            let files = folder(&dir.path().join("whole.isospan"));
            assert_eq!(files.len(), 2 * SEGMENTS + 3, "{:?}", files.keys());
            files
        });
        Self { dir: Self::volume(), expected: &EXPECTED }
    }

    fn volume() -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        write_npy(&dir.path().join("v.npy"), [46, 46, 44], waves);
        dir
    }

    fn path(&self) -> &Path {
        self.dir.path()
    }

    fn same(&self, out: &str) {
        let got = folder(&self.path().join(out));
        assert!(got == *self.expected, "{out}: {:?}", got.keys());
    }
}

#[test]
fn any_number_of_shards_gives_the_bytes_of_reduce() {
    let case = Case::new();
    for shards in [1u64, 3, 16] {
        let out = format!("s{shards}.isospan");
        let report: serde_json::Value =
            serde_json::from_str(&plan(case.path(), "v.npy", &out, &shards.to_string(), &[])).unwrap();
        assert!(
            report["memory_least"].as_u64().unwrap() > 0
                && report["estimated_shard_seconds"].as_f64().unwrap() > 0.0
        );
        // In another order, and with another number than planned.
        for i in (0..shards).rev() {
            work(case.path(), &out, &format!("{i}/{shards}"));
        }
        assert!(ok(case.path(), &["work", &out]).contains("nothing left to do"));
        // Which reads no sample: errors were measured by the workers.
        let volume = case.path().join("v.npy");
        let bytes = fs::read(&volume).unwrap();
        fs::write(&volume, &bytes[..bytes.len() / 2]).unwrap();
        ok(case.path(), &["commit", &out]);
        case.same(&out);
        fs::write(&volume, &bytes).unwrap();
        ok(case.path(), &["commit", &out]);
        case.same(&out);
        ok(case.path(), &["check", &out]);
    }
}

/// Rounded values (the range is read by the plan alone), a compressed volume, a curvilinear grid
/// and a mesh.
#[test]
fn every_kind_of_input_is_done_in_shards() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [30, 24, 20], waves);
    let packed = Command::new("gzip").args(["-k", "v.npy"]).current_dir(d).status().unwrap();
    assert!(packed.success());
    write_vts(&d.join("g.vts"));
    write_hexahedra(&d.join("m.vtk"), waves);
    let raw = ["--dims", "30,24,20", "--type", "float32", "--offset", "128"];
    fs::rename(d.join("v.npy.gz"), d.join("v.raw.gz")).unwrap();
    let cases: [(&str, &str, &[&str]); 6] = [
        ("v.npy", "bits", &["--value-bits", "9"]),
        ("v.npy", "exact", &[]),
        ("v.npy", "sampled", &["--values", "sample"]),
        ("v.raw.gz", "packed", &raw),
        ("g.vts", "grid", &[]),
        ("m.vtk", "mesh", &["--interp", "quadratic"]),
    ];
    for (input, name, more) in cases {
        let (whole, out) = (format!("{name}-whole.isospan"), format!("{name}.isospan"));
        ok(d, &[&["reduce", input, "-o", &whole], &CHOICES[..], more].concat());
        plan(d, input, &out, "2", more);
        for shard in ["1/2", "0/2"] {
            work(d, &out, shard);
        }
        ok(d, &["commit", &out]);
        let (got, expected) = (folder(&d.join(&out)), folder(&d.join(&whole)));
        assert!(got == expected, "{name}: {:?} {:?}", got.keys(), expected.keys());
    }
}

/// Steps are made by each shard for its own chunks, a few at a time, some after a keyframe.
#[test]
fn a_series_is_done_in_shards() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for t in 0..5 {
        let drift = 0.02 * f64::from(t);
        write_npy(&d.join(format!("v{t}.npy")), [34, 30, 26], |x, y, z| waves(x + drift, y, z));
        write_hexahedra(&d.join(format!("m{t}.vtk")), |x, y, z| waves(x + drift, y, z));
    }
    let cases: [(&str, &[&str]); 4] = [
        ("v*.npy", &["--keyframes", "3", "--times", "0,0.5,..."]),
        ("v*.npy", &["--keyframes", "3"]),
        ("v?.npy", &["--keyframes", "2", "--value-bits", "10"]),
        ("m*.vtk", &["--keyframes", "3"]),
    ];
    for (n, (input, more)) in (0..).zip(cases) {
        let whole = format!("{n}-whole.isospan");
        ok(d, &[&["reduce", input, "-o", &whole], &CHOICES[..], more].concat());
        let expected = folder(&d.join(&whole));
        for (shards, memory) in [(1, "40MiB"), (3, "256MiB")] {
            let out = format!("{n}-{shards}.isospan");
            plan(d, input, &out, &shards.to_string(), more);
            for shard in (0..shards).rev() {
                ok(d, &["work", &out, "--shard", &format!("{shard}/{shards}"), "--memory", memory]);
            }
            ok(d, &["commit", &out]);
            let got = folder(&d.join(&out));
            assert!(got == expected, "{input}, {shards} shards: {:?} {:?}", got.keys(), expected.keys());
        }
    }
}

/// Does the shards of a plan with a target and commits it, until the archive is there; returns how
/// often, and the last exit code.
fn tries(d: &Path, out: &str) -> (u32, i32) {
    tries_from(d, out, 1)
}

fn tries_from(d: &Path, out: &str, first: u32) -> (u32, i32) {
    for tries in first.. {
        let status: serde_json::Value = serde_json::from_str(&ok(d, &["status", out, "--json"])).unwrap();
        assert_eq!((&status["try"], &status["committed"]), (&tries.into(), &false.into()));
        for n in status["missing_shards"].as_array().unwrap().iter().rev() {
            work(d, out, &format!("{n}/{}", status["shards"]));
        }
        let (code, text, _) = run(d, &["commit", out]);
        if code != 7 {
            return (tries, code);
        }
        assert!(
            text.contains(&format!("try {}", tries + 1)) && text.contains("next: isospan work"),
            "{text}"
        );
        assert!(!d.join(out).exists());
    }
    unreachable!()
}

/// An error, a size, points that adapt, a mesh, a series, and what cannot be met.
#[test]
fn a_target_is_met_by_shards_as_by_one_process() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v0.npy"), [30, 24, 20], waves);
    write_npy(&d.join("v1.npy"), [30, 24, 20], ball);
    write_hexahedra(&d.join("m.vtk"), waves);
    let cases: [(&str, &[&str], &[&str], i32); 7] = [
        ("rms", &["v0.npy"], &["--target-rms", "2%", "--points", "regular"], 0),
        ("max", &["v0.npy"], &["--target-max", "20%", "--points", "regular"], 0),
        ("size", &["v0.npy"], &["--size", "80KiB", "--points", "regular"], 0),
        ("adapted", &["v0.npy"], &["--target-rms", "3%", "--adapt"], 0),
        ("mesh", &["m.vtk"], &["--target-rms", "8%"], 0),
        ("series", &["v0.npy", "v1.npy"], &["--target-rms", "4%", "--points", "hammersley"], 0),
        ("unmet", &["v0.npy"], &["--target-rms", "0.0001%", "--points", "hammersley"], 6),
    ];
    let mut most = 0;
    for (name, inputs, target, expected) in cases {
        let (whole, out) = (format!("{name}-whole.isospan"), format!("{name}.isospan"));
        let rest = [target, &["--chunk-points", "120"]].concat();
        let (code, ..) = run(d, &[&["reduce"], inputs, &["-o", &whole], &rest[..]].concat());
        assert_eq!(code, expected, "{name}");
        let args = [&["plan"], inputs, &["-o", &out, "--shards", "3"], &rest[..]].concat();
        ok(d, &args);
        let (tries, code) = tries(d, &out);
        assert_eq!(code, expected, "{name}");
        assert!(folder(&d.join(&out)) == folder(&d.join(&whole)), "{name}");
        most = most.max(tries);
        // The tries are gone; what is committed stays, and the same commands find it.
        let work = fs::read_dir(d.join(format!("{out}.work"))).unwrap();
        assert_eq!(work.map(|e| e.unwrap().file_name()).collect::<Vec<_>>(), ["plan.json"], "{name}");
        run(d, &["commit", &out]);
        assert!(folder(&d.join(&out)) == folder(&d.join(&whole)), "{name}");
        ok(d, &["check", &out]);
        assert!(ok(d, &["status", &out]).contains("committed"), "{name}");
        let (code, error) = fails(d, &args);
        assert!(code == 2 && error.contains("--force"), "{name}: {error}");
    }
    assert!(most > 2, "{most} tries");
    let (code, error) = fails(d, &["plan", "v0.npy", "-o", "a.isospan", "--target-max", "9%", "--adapt"]);
    assert!(code == 2 && error.contains("isospan reduce"), "{error}");
}

/// A commit that stops at any point goes on, and the same plan again leaves the search as it is.
#[test]
fn a_planned_search_goes_on_where_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [30, 24, 20], waves);
    let target = ["--target-rms", "2%", "--points", "regular", "--chunk-points", "120"];
    ok(d, &[&["reduce", "v.npy", "-o", "whole.isospan"], &target[..]].concat());
    let planned = [&["plan", "v.npy", "-o", "a.isospan", "--shards", "2"], &target[..]].concat();
    ok(d, &planned);
    let plan_file = d.join("a.isospan.work/plan.json");
    let first = fs::read(&plan_file).unwrap();
    assert_eq!(fails(d, &["commit", "a.isospan"]).0, 3);
    work(d, "a.isospan", "0/1");
    assert_eq!(run(d, &["commit", "a.isospan"]).0, 7);
    let second = fs::read(&plan_file).unwrap();
    assert!(first != second);
    // The same plan is no new beginning; another one is refused, and --force begins anew.
    ok(d, &planned);
    assert!(fs::read(&plan_file).unwrap() == second);
    let other = [&planned[..3], &["a.isospan", "--target-rms", "3%"]].concat();
    assert_eq!(fails(d, &other).0, 2);
    ok(d, &[&planned[..], &["--force"]].concat());
    assert!(fs::read(&plan_file).unwrap() == first);
    work(d, "a.isospan", "0/1");
    // As if the commit had been killed when the try was complete, but the next one not planned.
    assert_eq!(run(d, &["commit", "a.isospan"]).0, 7);
    fs::write(&plan_file, &first).unwrap();
    work(d, "a.isospan", "0/1");
    assert_eq!(run(d, &["commit", "a.isospan"]).0, 7);
    assert!(fs::read(&plan_file).unwrap() == second);
    let (_, code) = tries_from(d, "a.isospan", 2);
    assert_eq!(code, 0);
    assert!(folder(&d.join("a.isospan")) == folder(&d.join("whole.isospan")));
    // As if it had been killed before the best try was moved.
    fs::remove_file(d.join("a.isospan/manifest.zst")).unwrap();
    let number: serde_json::Value = serde_json::from_str(&ok(d, &["status", "a.isospan", "--json"])).unwrap();
    let best = d.join(format!("a.isospan.work/planned-{}.isospan", number["try"]));
    fs::rename(d.join("a.isospan"), &best).unwrap();
    fs::copy(d.join("whole.isospan/manifest.zst"), best.join("manifest.zst")).unwrap();
    assert!(ok(d, &["status", "a.isospan"]).contains("commit it"));
    ok(d, &["commit", "a.isospan"]);
    assert!(folder(&d.join("a.isospan")) == folder(&d.join("whole.isospan")));
}

/// A file of the name alone is no manifest.
#[test]
fn a_damaged_manifest_is_told_by_status() {
    let case = Case::new();
    let d = case.dir.path();
    plan(d, "v.npy", "a.isospan", "1", &[]);
    work(d, "a.isospan", "0/1");
    assert!(ok(d, &["status", "a.isospan"]).contains("commit it"));
    ok(d, &["commit", "a.isospan"]);
    assert!(ok(d, &["status", "a.isospan"]).contains("committed"));
    let manifest = d.join("a.isospan/manifest.zst");
    for damaged in ["{}", "", r#"{"format": "other"}"#] {
        fs::write(&manifest, damaged).unwrap();
        for more in [&[][..], &["--quick"], &["--json"], &["--missing"]] {
            let (code, error) = fails(d, &[&["status", "a.isospan"][..], more].concat());
            assert!(code == 5 && error.contains("manifest.zst"), "{damaged} {more:?}: {code} {error}");
            assert!(error.contains("the manifest is damaged"), "{error}");
        }
    }
    // What it says helps.
    fs::remove_file(&manifest).unwrap();
    work(d, "a.isospan", "0/1");
    ok(d, &["commit", "a.isospan"]);
    assert!(ok(d, &["status", "a.isospan"]).contains("committed"));
}

fn write_vts(path: &Path) {
    let (n, mut points, mut values) = ([16, 14, 12], String::new(), String::new());
    for z in 0..n[2] {
        for y in 0..n[1] {
            for x in 0..n[0] {
                let bend = 0.02 * f64::from(x * y);
                points += &format!("{x} {} {} ", f64::from(y) + bend, f64::from(z) * 1.5);
                values += &format!("{} ", waves(f64::from(x) / 8.0, f64::from(y) / 7.0, f64::from(z) / 6.0));
            }
        }
    }
    let extent = format!("0 {} 0 {} 0 {}", n[0] - 1, n[1] - 1, n[2] - 1);
    let text = format!(
        "<VTKFile type=\"StructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\">\n<StructuredGrid WholeExtent=\"{extent}\">\n\
         <Piece Extent=\"{extent}\"><PointData Scalars=\"f\"><DataArray type=\"Float32\" Name=\"f\" format=\"ascii\">{values}</DataArray></PointData>\n\
         <Points><DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">{points}</DataArray></Points></Piece>\n\
         </StructuredGrid>\n</VTKFile>\n"
    );
    fs::write(path, text).unwrap();
}

#[test]
fn workers_of_the_same_shard_do_not_disturb_each_other() {
    let case = Case::new();
    let d = case.path();
    plan(d, "v.npy", "t.isospan", "2", &[]);
    let spawn = |shard: &str| -> Child {
        let mut c =
            command(d, &["work", "t.isospan", "--shard", shard, "--threads", "1", "--memory", "64MiB"]);
        c.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    for round in 0..3u64 {
        // The same shard, and an overlapping one of another number.
        let mut workers = [spawn("0/2"), spawn("0/2"), spawn("0/1"), spawn("1/3")];
        if round < 2 {
            std::thread::sleep(std::time::Duration::from_millis(60 * (round + 1)));
            workers[0].kill().unwrap();
            workers[2].kill().unwrap();
        }
        for worker in workers {
            let out = worker.wait_with_output().unwrap();
            let killed = out.status.code().is_none();
            assert!(out.status.success() || killed, "{}", String::from_utf8_lossy(&out.stderr));
        }
    }
    ok(d, &["commit", "t.isospan"]);
    // A killed worker's segment may have been finished by another: its leftover stays for gc, and
    // is no part of the archive.
    ok(d, &["gc", "t.isospan", "--older-than", "0s"]);
    case.same("t.isospan");
}

#[test]
fn a_terminated_worker_continues() {
    let case = Case::new();
    let d = case.path();
    plan(d, "v.npy", "t.isospan", "1", &[]);
    let mut stopped = 0;
    for n in 0..40u64 {
        let mut c = command(d, &["work", "t.isospan", "--threads", "1"]);
        let worker = c.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(20 + 7 * n));
        send_signal(worker.id(), rustix::process::Signal::TERM);
        let out = worker.wait_with_output().unwrap();
        match out.status.code() {
            Some(75) => stopped += 1,
            // Done, or ended before the program was set up.
            Some(0) => break,
            other => assert_eq!(other, None, "{}", String::from_utf8_lossy(&out.stderr)),
        }
    }
    assert!(stopped > 0);
    ok(d, &["work", "t.isospan"]);
    ok(d, &["commit", "t.isospan"]);
    case.same("t.isospan");
}

#[test]
fn commit_refuses_what_is_missing_damaged_or_foreign_and_deletes_nothing() {
    let case = Case::new();
    let d = case.path();
    plan(d, "v.npy", "t.isospan", "4", &[]);
    assert_eq!(fails(d, &["commit", "t.isospan"]).0, 3);
    ok(d, &["work", "t.isospan"]);
    ok(
        d,
        &[
            "plan",
            "v.npy",
            "-o",
            "u.isospan",
            "--points",
            "regular",
            "--fraction",
            "1/2",
            "--chunk-points",
            "121",
        ],
    );
    ok(d, &["work", "u.isospan", "--shard", "0/2"]);
    let archive = d.join("t.isospan");
    fs::remove_file(archive.join("steps/000000-sums-000003.seg")).unwrap();
    let cut = archive.join("steps/000000-values-000000.seg");
    fs::write(&cut, &fs::read(&cut).unwrap()[..1000]).unwrap();
    let foreign = "steps/000000-values-000001.seg";
    fs::copy(d.join("u.isospan").join(foreign), archive.join(foreign)).unwrap();
    let flipped = archive.join("steps/000000-values-000002.seg");
    let mut bytes = fs::read(&flipped).unwrap();
    bytes[700] ^= 4;
    fs::write(&flipped, bytes).unwrap();
    let before = folder(&archive);
    let (code, text) = fails(d, &["commit", "t.isospan"]);
    assert_eq!(code, 3, "{text}");
    for part in ["4 missing", "values-000001.seg (of another plan)", "sums-000003.seg (not there)"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(folder(&archive) == before, "nothing is deleted and nothing published");
    let files = ok(d, &["status", "t.isospan", "--missing", "--as", "files"]);
    for part in ["values-000000.seg (damaged", "values-000002.seg (damaged"] {
        assert!(files.contains(part) && files.lines().count() == 4, "{part}: {files}");
    }
    let status: serde_json::Value = serde_json::from_str(&ok(d, &["status", "t.isospan", "--json"])).unwrap();
    let missing: Vec<u64> =
        status["missing_shards"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).collect();
    let array = ok(d, &["status", "t.isospan", "--missing", "--as", "slurm-array"]);
    let lines = ok(d, &["status", "t.isospan", "--missing"]);
    assert_eq!(lines, missing.iter().map(|n| format!("{n}\n")).collect::<String>());
    assert!(missing == [0, 1, 2, 3] && array == "0-3\n", "{array}");
    // A flipped bit is found by reading all, and not by a quick look.
    assert_eq!(ok(d, &["status", "t.isospan", "--missing", "--as", "files", "--quick"]).lines().count(), 3);
    for shard in missing {
        work(d, "t.isospan", &format!("{shard}/4"));
    }
    assert_eq!(ok(d, &["status", "t.isospan", "--missing"]), "");
    ok(d, &["commit", "t.isospan"]);
    case.same("t.isospan");
}

#[test]
fn a_plan_is_immutable_and_binds_the_input() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [20, 20, 20], waves);
    plan(d, "v.npy", "t.isospan", "2", &[]);
    let file = d.join("t.isospan.work/plan.json");
    let first = fs::read(&file).unwrap();
    plan(d, "v.npy", "t.isospan", "2", &[]);
    assert!(fs::read(&file).unwrap() == first, "the same plan again");
    let other =
        ["plan", "v.npy", "-o", "t.isospan", "--shards", "2", "--points", "regular", "--fraction", "1/4"];
    let (code, text) = fails(d, &other);
    assert!(code == 2 && text.contains("another plan"), "{text}");
    ok(d, &[&other[..], &["--force"]].concat());
    ok(d, &["work", "t.isospan", "--shard", "0/2"]);
    // A damaged plan, a missing one, and one of another version.
    let good = fs::read_to_string(&file).unwrap();
    fs::write(&file, good.replace("\"shards\":1", "\"shards\":3")).unwrap();
    let (code, text) = fails(d, &["work", "t.isospan"]);
    assert!(code == 5 && text.contains("checksum"), "{text}");
    let version = format!("\"isospan_version\":\"{}\"", env!("CARGO_PKG_VERSION"));
    fs::write(&file, good.replace(&version, "\"isospan_version\":\"99.0.0\"")).unwrap();
    let (code, text) = fails(d, &["commit", "t.isospan"]);
    assert!(code == 5 && text.contains("99.0.0"), "{text}");
    fs::remove_file(&file).unwrap();
    let (code, text) = fails(d, &["status", "t.isospan"]);
    assert!(code == 5 && text.contains("isospan plan"), "{text}");
    fs::write(&file, good).unwrap();
    // Another input under the same name.
    let input = fs::read(d.join("v.npy")).unwrap();
    write_npy(&d.join("v.npy"), [20, 20, 20], ball);
    let (code, text) = fails(d, &["work", "t.isospan"]);
    assert!(code == 5 && text.contains("fingerprint") && text.contains("plan again"), "{text}");
    fs::write(d.join("v.npy"), input).unwrap();
    ok(d, &["work", "t.isospan"]);
    ok(d, &["commit", "t.isospan"]);
    // A plan for a finished archive of another kind replaces it only when asked to.
    let (code, _) = fails(d, &[&other[..], &["--points", "regular", "--interp", "cubic"]].concat());
    assert_eq!(code, 2);
    assert_eq!(run(d, &["work", "t.isospan", "--shard", "2/2"]).0, 2);
    assert_eq!(fails(d, &["work", "none.isospan"]).0, 5);
}

#[test]
fn gc_removes_old_temporaries_and_nothing_else() {
    let case = Case::new();
    let d = case.path();
    plan(d, "v.npy", "t.isospan", "1", &[]);
    ok(d, &["work", "t.isospan"]);
    let left = [".000001.seg.tmp-elsewhere-12-ab", ".000001.seg.chunks.tmp-elsewhere-12-ab"];
    for name in left {
        fs::write(d.join("t.isospan/mesh").join(name), "left").unwrap();
    }
    assert!(ok(d, &["status", "t.isospan"]).contains("2 files"));
    assert!(ok(d, &["gc", "t.isospan", "--older-than", "1h"]).contains("0 files"));
    assert!(ok(d, &["gc", "t.isospan", "--older-than", "0s", "--dry-run"]).contains("2 files"));
    ok(d, &["commit", "t.isospan"]);
    assert_eq!(folder(&d.join("t.isospan")).len(), case.expected.len() + 2, "commit deletes nothing");
    assert!(ok(d, &["gc", "t.isospan", "--older-than", "0s"]).contains("2 files, 8 B removed"));
    case.same("t.isospan");
    assert_eq!(fails(d, &["gc", "none.isospan", "--older-than", "2d"]).0, 5);
}

#[test]
fn gc_touches_no_other_folder() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let name = ".000001.seg.tmp-elsewhere-12-ab";
    let put = |folder: &str, name: &str| {
        fs::create_dir_all(d.join(folder)).unwrap();
        fs::write(d.join(folder).join(name), "mine").unwrap();
    };
    // No archive: its folder `mesh` is another program's.
    put("photos/mesh", name);
    put("photos", "holiday.jpg");
    let (code, text) = fails(d, &["gc", "photos", "--older-than", "0s"]);
    assert!(code == 5 && text.contains("nothing was removed"), "{text}");
    // Of an archive: folders that are not its own, those behind links, and other names.
    write_npy(&d.join("v.npy"), [20, 18, 16], waves);
    plan(d, "v.npy", "t.isospan", "1", &[]);
    put("t.isospan/mine", name);
    put("t.isospan/mesh", ".notes.tmp-1");
    put("t.isospan/mesh", ".notes.txt.tmp-elsewhere-12-ab");
    put("elsewhere", name);
    fs::remove_dir(d.join("t.isospan/steps")).unwrap();
    std::os::unix::fs::symlink(d.join("elsewhere"), d.join("t.isospan/steps")).unwrap();
    let before = folder(d);
    assert!(ok(d, &["gc", "t.isospan", "--older-than", "0s"]).contains("0 files"));
    assert_eq!(folder(d), before);
    put("t.isospan/mesh", name);
    assert!(ok(d, &["gc", "t.isospan", "--older-than", "0s"]).contains("1 file,"));
}

/// Scripts for Slurm run nothing that a name says. Here `sbatch` is a stub, which runs what it is
/// given as Slurm would, without an array.
#[test]
fn no_name_of_an_archive_is_a_command_in_the_scripts_for_slurm() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let stub = d.join("bin/sbatch");
    fs::create_dir(d.join("bin")).unwrap();
    fs::write(&stub, "#!/bin/bash\nprintf '%s\\n' \"$@\" >>\"$SEEN\"; echo 7\n").unwrap();
    fs::set_permissions(&stub, fs::Permissions::from_mode(0o755)).unwrap();
    write_npy(&d.join("v.npy"), [20, 20, 20], waves);
    let path = format!("{}:{}", d.join("bin").display(), std::env::var("PATH").unwrap());
    let names = [
        "@QUOTED_FOLDER@;touch pwned;x",
        "@QUOTED@;touch pwned;@PROGRAM@",
        "@ARCHIVE@@OPTIONS@@SCRATCH@",
        "'; touch pwned; '",
        "$(touch pwned)`touch pwned`",
        "a & touch pwned & b | c > pwned",
        "-rf * ~ #! {a,b} [x]",
        "@",
        "a@b@@",
    ];
    for (n, name) in names.iter().enumerate() {
        let home = d.join(format!("{n}"));
        fs::create_dir(&home).unwrap();
        let out = format!("./{name}.isospan");
        ok(&home, &[&["plan", "../v.npy", "-o", &out, "--shards", "1"], &CHOICES[..]].concat());
        ok(&home, &["slurm", &out, "--scratch", &format!("./{name}.scratch")]);
        let scripts = home.join(format!("{name}.isospan.work/slurm"));
        let run = |script: &str| {
            let mut command = Command::new("bash");
            command
                .arg(scripts.join(script))
                .current_dir(&home)
                .env("PATH", &path)
                .env("SEEN", home.join("seen"));
            let out = command.env("SLURM_ARRAY_TASK_ID", "0").stdin(Stdio::null()).output().unwrap();
            (out.status.code(), String::from_utf8(out.stderr).unwrap())
        };
        fs::create_dir(home.join(format!("{name}.scratch"))).unwrap();
        assert_eq!(run("submit.sh"), (Some(0), String::new()), "{name}");
        // Nothing is there to commit: what is missing is submitted again, under the script's own
        // name.
        assert_eq!(run("commit.sh").0, Some(3), "{name}");
        let seen = fs::read_to_string(home.join("seen")).unwrap();
        let submitted =
            |script: &str| seen.lines().filter(|l| *l == scripts.join(script).to_str().unwrap()).count();
        assert_eq!((submitted("work.sh"), submitted("commit.sh")), (2, 2), "{name}: {seen}");
        let (code, text) = run("work.sh");
        assert_eq!(code, Some(0), "{name}: {text}");
        let (code, text) = run("commit.sh");
        assert_eq!(code, Some(0), "{name}: {text}");
        let mut left: Vec<String> =
            fs::read_dir(&home).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        left.retain(|f| f != "seen" && !f.starts_with(name));
        assert!(left.is_empty(), "{name}: {left:?}");
    }
}
