//! Exit codes: 0 where what was asked for is there, and another one where it is not.

use crate::common::*;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn isospan(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap()
}

fn ok(dir: &Path, args: &[&str]) -> String {
    let out = isospan(dir, args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

/// The exit code and the error of a command that fails.
fn fails(dir: &Path, args: &[&str]) -> (i32, String) {
    let out = isospan(dir, args);
    (out.status.code().unwrap(), String::from_utf8(out.stderr).unwrap())
}

/// An archive of a ball, `v.isospan`.
fn archive(d: &Path) {
    write_npy(&d.join("v.npy"), [24, 22, 20], ball);
    ok(d, &["reduce", "v.npy", "-o", "v.isospan", "--points", "regular", "--fraction", "1/2", "-q"]);
}

/// A surface for standard output that nobody takes is not delivered.
#[test]
#[cfg(target_os = "linux")]
fn a_surface_for_a_closed_standard_output_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    archive(d);
    let program = env!("CARGO_BIN_EXE_isospan");
    let script = format!("{program} surface v.isospan -i 0.3 -o - >&-");
    let closed = Command::new("bash").args(["-c", &script]).current_dir(d).output().unwrap();
    let error = String::from_utf8(closed.stderr).unwrap();
    assert!(closed.status.code() == Some(2) && error.contains("standard output is closed"), "{error}");
    // A reader that ends at once.
    let mut child = Command::new(program)
        .args(["surface", "v.isospan", "-i", "0.3", "-o", "-"])
        .current_dir(d)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let out = child.wait_with_output().unwrap();
    let error = String::from_utf8(out.stderr).unwrap();
    assert!(!out.status.success() && error.contains("the whole surface"), "{error}");
    // Of a report, a part is what was asked for; and a file is written all the same.
    let script = format!("{program} surface v.isospan -i 0.3 -o v.ply >&-");
    assert!(Command::new("bash").args(["-c", &script]).current_dir(d).status().unwrap().success());
    assert!(d.join("v.ply").exists());
}

#[test]
fn gc_takes_a_manifest_for_what_it_says() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for name in ["manifest.zst", "x.isospan.work/plan.json"] {
        let folder = d.join("x.isospan");
        let file = if name.contains('/') { d.join(name) } else { folder.join(name) };
        fs::create_dir_all(&folder).unwrap();
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(&file, "{}").unwrap();
        let left = folder.join(".000000.seg.tmp-host-1-ab");
        fs::write(&left, "of somebody").unwrap();
        let (code, error) = fails(d, &["gc", "x.isospan", "--older-than", "0s"]);
        assert!(code == 5 && left.exists(), "{name}: {code} {error}");
        fs::remove_file(file).unwrap();
    }
}

#[test]
fn nothing_is_added_to_an_archive_that_has_lost_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    archive(d);
    write_npy(&d.join("w.npy"), [24, 22, 20], waves);
    let values = fs::read_dir(d.join("v.isospan/steps")).unwrap().map(|entry| entry.unwrap().path());
    let lost = values.into_iter().find(|path| path.extension().is_some_and(|e| e == "seg")).unwrap();
    let bytes = fs::read(&lost).unwrap();
    let manifest = fs::read(d.join("v.isospan/manifest.zst")).unwrap();
    fs::remove_file(&lost).unwrap();
    let (code, error) = fails(d, &["append", "v.isospan", "w.npy"]);
    let name = lost.file_name().unwrap().to_string_lossy().into_owned();
    assert!(code != 0 && error.contains(&name), "{code}: {error}");
    assert!(fs::read(d.join("v.isospan/manifest.zst")).unwrap() == manifest);
    fs::write(&lost, bytes).unwrap();
    ok(d, &["append", "v.isospan", "w.npy"]);
}

/// A target that cannot be met in the memory is refused in a try, whose folder was there.
#[test]
fn a_refused_reduction_leaves_no_folder() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [24, 22, 20], ball);
    write_npy(&d.join("n.npy"), [24, 22, 20], |x, y, z| if x > 0.5 { f64::NAN } else { ball(x, y, z) });
    let names = || {
        let mut names: Vec<_> = fs::read_dir(d).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = names();
    for more in [
        &["v.npy", "--target-rms", "1%", "--memory", "1MiB"][..],
        &["v.npy", "--memory", "1MiB"],
        &["n.npy", "--nan", "error"],
        &["n.npy", "--nan", "error", "--target-rms", "1%"],
    ] {
        let (code, error) = fails(d, &[&["reduce", "-o", "o.isospan"], more].concat());
        assert!(code != 0, "{more:?}: {error}");
        assert_eq!(names(), before, "{more:?}: {error}");
    }
}
