//! `isospan nightly`: what is new in a folder is in the archive afterwards, and the exit code and a
//! summary report it. As a job of Slurm: see `slurm.rs`.

use crate::common::*;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;

const CHOICES: [&str; 4] = ["--points", "regular", "--fraction", "1/2"];

/// A night in a folder: its exit code, its summary, and what it said on standard error.
fn night(dir: &Path, more: &[&str]) -> (i32, Value, String) {
    let args = ["nightly", "scope", "t*.npy", "scope.isospan", "--settle=0s", "--json", "--quiet"];
    let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
    command.current_dir(dir).args(args).args(CHOICES).args(more).env_remove("SLURM_JOB_ID");
    let out = command.output().unwrap();
    let printed: Value = serde_json::from_slice(&out.stdout).unwrap_or_default();
    (out.status.code().unwrap(), printed, String::from_utf8(out.stderr).unwrap())
}

fn new_file(dir: &Path, name: &str, dims: [usize; 3], drift: f64) {
    write_npy(&dir.join("scope").join(name), dims, |x, y, z| waves(x + drift, y, z));
}

/// What is reported of each step, file or error.
fn names<'a>(summary: &'a Value, list: &str, of: &str) -> Vec<&'a str> {
    let all = summary[list].as_array().unwrap().iter();
    all.map(|v| if of.is_empty() { v } else { &v[of] }.as_str().unwrap()).collect()
}

/// The summaries that lie next to the archive, the files in words too.
fn kept(dir: &Path) -> Vec<Value> {
    let folder = dir.join("scope.isospan.work/nightly");
    let files: Vec<_> = fs::read_dir(folder).unwrap().map(|f| f.unwrap().path()).collect();
    let json = files.iter().filter(|f| f.extension().unwrap() == "json");
    let read = |f: &std::path::PathBuf| {
        let words = fs::read_to_string(f.with_extension("txt")).unwrap();
        assert!(words.starts_with("scope.isospan: exit code "), "{words}");
        serde_json::from_slice(&fs::read(f).unwrap()).unwrap()
    };
    let json: Vec<Value> = json.map(read).collect();
    assert_eq!(files.len(), 2 * json.len(), "nothing else: {files:?}");
    json
}

#[test]
fn new_files_become_steps_night_by_night() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    fs::create_dir(dir.join("scope")).unwrap();
    new_file(dir, "t2.npy", [20, 19, 18], 0.02);
    new_file(dir, "t1.npy", [20, 19, 18], 0.0);
    new_file(dir, "other.npy", [20, 19, 18], 0.0);
    let (code, summary, errors) = night(dir, &[]);
    assert_eq!(code, 0, "{errors}");
    assert_eq!(names(&summary, "added", "source"), ["t1.npy", "t2.npy"], "in the order of names");
    assert_eq!(kept(dir), [summary], "what is printed is what is kept");

    // One more, and two that cannot be used.
    new_file(dir, "t3.npy", [20, 19, 18], 0.04);
    new_file(dir, "t4.npy", [20, 19, 9], 0.06);
    fs::write(dir.join("scope/t5.npy"), "no array").unwrap();
    let (code, summary, errors) = night(dir, &[]);
    assert_eq!(code, 1, "{errors}");
    assert_eq!(names(&summary, "new", ""), ["t3.npy", "t4.npy", "t5.npy"]);
    assert_eq!(names(&summary, "added", "source"), ["t3.npy"]);
    assert_eq!(names(&summary, "skipped", "source"), ["t4.npy", "t5.npy"]);
    assert!(names(&summary, "skipped", "reason")[0].contains("dimensions"), "{summary}");
    assert!(errors.starts_with("isospan: error: cannot use 2 of 3 new files: t4.npy: "), "{errors}");
    assert!(summary["archive_bytes"].as_u64().unwrap() > 0 && summary["code"] == 1, "{summary}");

    // A night without anything that can be used, and one without anything new.
    let (code, summary, _) = night(dir, &[]);
    assert!(code == 5 && summary["error"].as_str().unwrap().contains("dimensions"), "{code} {summary}");
    fs::remove_file(dir.join("scope/t4.npy")).unwrap();
    fs::remove_file(dir.join("scope/t5.npy")).unwrap();
    let (code, summary, _) = night(dir, &[]);
    assert!(code == 0 && names(&summary, "new", "").is_empty() && summary["steps_before"] == 3, "{summary}");

    // A folder that is not there, which a summary reports too.
    fs::rename(dir.join("scope"), dir.join("away")).unwrap();
    let (code, summary, errors) = night(dir, &[]);
    assert!(code == 5 && summary["error"].as_str().unwrap().starts_with("scope: "), "{code} {summary}");
    assert_eq!(errors.lines().count(), 1, "{errors}");
    fs::rename(dir.join("away"), dir.join("scope")).unwrap();
    assert_eq!(kept(dir).len(), 5);

    let all = ["t1.npy", "t2.npy", "t3.npy"].map(|f| format!("scope/{f}"));
    let mut at_once = Command::new(env!("CARGO_BIN_EXE_isospan"));
    at_once.current_dir(dir).args(["reduce", "-o", "at-once.isospan"]).args(all).args(CHOICES);
    assert!(at_once.output().unwrap().status.success());
    assert!(folder(&dir.join("scope.isospan")) == folder(&dir.join("at-once.isospan")));
}

/// A volume with a time, or none.
fn timed_file(dir: &Path, name: &str, time: Option<f64>) {
    let time = time.map_or(String::new(), |t| format!("FIELD f 1\nTIME 1 1 double\n{t}\n"));
    let head = format!("# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\n{time}");
    let samples: String = (0..1000).map(|i| format!("{} ", i * i % 97)).collect();
    let grid = "DIMENSIONS 10 10 10\nORIGIN 0 0 0\nSPACING 1 1 1\nPOINT_DATA 1000\nSCALARS a float 1\n";
    let text = format!("{head}{grid}LOOKUP_TABLE default\n{samples}\n");
    fs::write(dir.join("scope").join(name), text).unwrap();
}

#[test]
fn files_without_times_come_last_and_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    fs::create_dir(dir.join("scope")).unwrap();
    let night = || {
        let args = ["nightly", "scope", "*.vtk", "scope.isospan", "--settle=0s", "--quiet", "--json"];
        let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
        let out = command.current_dir(dir).args(args).args(CHOICES).env_remove("SLURM_JOB_ID").output();
        let out = out.unwrap();
        let summary: Value = serde_json::from_slice(&out.stdout).unwrap();
        assert!(out.status.success(), "{summary}");
        summary
    };
    let words = |summary: &Value| {
        let folder = dir.join("scope.isospan.work/nightly");
        let files = fs::read_dir(folder).unwrap().map(|f| f.unwrap().path());
        let of_it = |f: &std::path::PathBuf| {
            let text = fs::read_to_string(f.with_extension("json")).unwrap();
            f.extension().unwrap() == "txt" && serde_json::from_str::<Value>(&text).unwrap() == *summary
        };
        fs::read_to_string(files.into_iter().find(of_it).unwrap()).unwrap()
    };
    for (name, time) in [("n10", None), ("n9", None), ("p", Some(0.25)), ("q", Some(-1.0))] {
        timed_file(dir, &format!("{name}.vtk"), time);
    }
    let summary = night();
    assert_eq!(names(&summary, "added", "source"), ["q.vtk", "p.vtk", "n9.vtk", "n10.vtk"]);
    assert_eq!(names(&summary, "without_time", ""), ["n9.vtk", "n10.vtk"]);
    let line = "  no times   n9.vtk, n10.vtk: after all others\n";
    assert!(words(&summary).contains(line), "{}", words(&summary));
    timed_file(dir, "n11.vtk", None);
    let summary = night();
    assert_eq!(names(&summary, "without_time", ""), ["n11.vtk"]);
    assert!(words(&summary).contains("n11.vtk: after all others"), "{}", words(&summary));
}

#[test]
fn a_first_file_that_is_damaged_holds_nothing_up() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    fs::create_dir(dir.join("scope")).unwrap();
    fs::write(dir.join("scope/t0.npy"), "no array").unwrap();
    let (code, summary, _) = night(dir, &[]);
    assert!(code == 5 && !dir.join("scope.isospan").exists(), "{code} {summary}");
    new_file(dir, "t1.npy", [20, 19, 18], 0.0);
    let (code, summary, errors) = night(dir, &[]);
    assert_eq!((code, names(&summary, "added", "source")), (1, vec!["t1.npy"]), "{errors}");
}

#[test]
fn files_that_may_still_grow_wait() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    fs::create_dir(dir.join("scope")).unwrap();
    new_file(dir, "t1.npy", [20, 19, 18], 0.0);
    let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
    command.current_dir(dir).args(["nightly", "scope", "t*.npy", "scope.isospan"]);
    let out = command.output().unwrap();
    assert!(out.status.success() && !dir.join("scope.isospan").exists(), "{out:?}");
    assert_eq!(names(&kept(dir)[0], "new", ""), [""; 0]);
}

#[test]
fn wrong_use_is_told_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    fs::create_dir(dir.join("scope")).unwrap();
    for (more, expected) in [
        (["--again", "--no-measure"], "add --submit"),
        (["--option", "x"], "expected an option of sbatch"),
        (["--values", "nothing"], "nothing"),
    ] {
        let (code, _, errors) = night(dir, &more);
        assert!(code == 2 && errors.contains(expected), "{code} {errors}");
    }
    assert!(!dir.join("scope.isospan.work").exists(), "nothing was begun");
}
