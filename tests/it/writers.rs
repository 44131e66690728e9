//! One writer of an archive at a time, and no archive lost: what is there stays whole until another
//! one is complete.
#![cfg(unix)]

use crate::common::*;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

const CHOICES: [&str; 8] =
    ["--points", "regular", "--fraction", "1/3", "--chunk-points", "400", "--threads", "1"];

fn spawn(dir: &Path, args: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
    command.current_dir(dir).args(args).arg("-q").stdin(Stdio::null());
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn end(child: Child) -> (Option<i32>, String) {
    let Output { status, stdout, stderr } = child.wait_with_output().unwrap();
    (status.code(), String::from_utf8([stdout, stderr].concat()).unwrap())
}

fn run(dir: &Path, args: &[&str]) -> (Option<i32>, String) {
    end(spawn(dir, args))
}

fn ok(dir: &Path, args: &[&str]) -> String {
    let (code, text) = run(dir, args);
    assert_eq!(code, Some(0), "{args:?}: {text}");
    text
}

fn reduce_args<'a>(input: &'a str, out: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["reduce", input, "-o", out], &CHOICES[..], more].concat()
}

/// Two volumes of one shape, and their archives.
fn volumes() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("a.npy"), [46, 44, 42], waves);
    write_npy(&d.join("b.npy"), [46, 44, 42], |x, y, z| waves(y, z, x) + 3.0);
    ok(d, &reduce_args("a.npy", "a.isospan", &[]));
    ok(d, &reduce_args("b.npy", "b.isospan", &[]));
    dir
}

fn names(dir: &Path) -> Vec<String> {
    let entries = fs::read_dir(dir).unwrap();
    let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn unfinished_work_on_another_volume_is_not_overwritten() {
    let dir = volumes();
    let d = dir.path();
    let (a, b) = (folder(&d.join("a.isospan")), folder(&d.join("b.isospan")));
    let begin = || {
        fs::remove_file(d.join("a.isospan/manifest.zst")).unwrap();
        folder(&d.join("a.isospan"))
    };
    let before = begin();
    for command in [&["reduce"][..], &["plan", "--shards", "2"]] {
        let rest = [&["b.npy", "-o", "a.isospan"], &CHOICES[..]].concat();
        let (code, text) = run(d, &[command, &rest].concat());
        assert!(code == Some(2) && text.contains("unfinished work of another input"), "{code:?} {text}");
        assert!(folder(&d.join("a.isospan")) == before, "nothing was touched");
    }
    // Other settings are other work too.
    let (code, text) = run(d, &reduce_args("a.npy", "a.isospan", &["--values", "sample"]));
    assert!(code == Some(2) && text.contains("unfinished work"), "{text}");
    ok(d, &reduce_args("a.npy", "a.isospan", &[]));
    assert!(folder(&d.join("a.isospan")) == a, "its own command continues it");
    begin();
    ok(d, &reduce_args("b.npy", "a.isospan", &["--force"]));
    let now = folder(&d.join("a.isospan"));
    assert!(now == b, "and nothing of the other stays: {:?}", now.keys());
}

#[test]
fn an_archive_stays_until_its_replacement_is_complete() {
    let dir = volumes();
    let d = dir.path();
    let (a, b) = (folder(&d.join("a.isospan")), folder(&d.join("b.isospan")));
    let bytes = fs::read(d.join("b.npy")).unwrap();
    fs::write(d.join("bad.npy"), &bytes[..bytes.len() / 2]).unwrap();
    let (code, text) = run(d, &reduce_args("bad.npy", "a.isospan", &["--force"]));
    assert!(code == Some(5) && folder(&d.join("a.isospan")) == a, "{text}");
    // Killed again and again, later each time.
    let mut kills = 0;
    for tries in 0.. {
        let mut child = spawn(d, &reduce_args("b.npy", "a.isospan", &["--force"]));
        std::thread::sleep(std::time::Duration::from_millis(60 * tries));
        let is_done = child.try_wait().unwrap().is_some();
        let _ = child.kill();
        let (code, text) = end(child);
        assert!(matches!(code, None | Some(0)), "{code:?} {text}");
        kills += u32::from(code.is_none());
        let now = folder(&d.join("a.isospan"));
        assert!(now == a || now == b, "{:?}", now.keys());
        if is_done {
            break;
        }
    }
    assert!(kills > 0);
    ok(d, &reduce_args("b.npy", "a.isospan", &["--force"]));
    assert!(folder(&d.join("a.isospan")) == b);
    let left = names(d);
    assert_eq!(left, ["a.isospan", "a.npy", "b.isospan", "b.npy", "bad.npy"], "no work and no lock");
}

#[test]
fn a_plan_replaces_an_archive_when_it_is_committed() {
    let dir = volumes();
    let d = dir.path();
    let (a, b) = (folder(&d.join("a.isospan")), folder(&d.join("b.isospan")));
    ok(d, &[&["plan", "b.npy", "-o", "a.isospan", "--shards", "2", "--force"], &CHOICES[..]].concat());
    assert!(folder(&d.join("a.isospan")) == a);
    ok(d, &["work", "a.isospan", "--shard", "0/2"]);
    assert!(folder(&d.join("a.isospan")) == a);
    let (code, text) = run(d, &["commit", "a.isospan"]);
    assert!(code == Some(3) && folder(&d.join("a.isospan")) == a, "{text}");
    assert!(ok(d, &["status", "a.isospan", "--json"]).contains("\"committed\":false"));
    ok(d, &["work", "a.isospan", "--shard", "1/2"]);
    ok(d, &["commit", "a.isospan"]);
    assert!(folder(&d.join("a.isospan")) == b);
    // Once more: all is there.
    ok(d, &["work", "a.isospan"]);
    ok(d, &["commit", "a.isospan"]);
    assert!(folder(&d.join("a.isospan")) == b);
    assert!(ok(d, &["status", "a.isospan", "--json"]).contains("\"committed\":true"));
}

/// Two commands at once: each is done, or refused because the other one writes.
fn race(dir: &Path, commands: [&[&str]; 2]) -> u32 {
    let children = commands.map(|args| spawn(dir, args));
    let mut refused = 0;
    for child in children {
        let (code, text) = end(child);
        let busy = code == Some(75) && text.contains("is being written by");
        // The slower one may find the archive that the faster one has finished.
        let late = code == Some(2) && text.contains("exists");
        assert!(code == Some(0) || busy || late, "{code:?} {text}");
        refused += u32::from(busy);
    }
    refused
}

#[test]
fn writers_at_the_same_time_leave_a_sound_archive() {
    let dir = volumes();
    let d = dir.path();
    let (a, b) = (folder(&d.join("a.isospan")), folder(&d.join("b.isospan")));
    let mut refused = 0;
    for n in 0..4 {
        let out = format!("x{n}.isospan");
        refused += race(d, [&reduce_args("a.npy", &out, &[]), &reduce_args("b.npy", &out, &[])]);
        let now = folder(&d.join(&out));
        assert!(now == a || now == b, "{:?}", now.keys());
        refused += race(d, [&["append", &out, "a.npy"], &["append", &out, "b.npy"]]);
        let text = ok(d, &["check", &out]);
        assert!(!text.contains("stray"), "{text}");
        // Who was refused is not, when asked again.
        ok(d, &["append", &out, "b.npy"]);
        ok(d, &["check", &out]);
    }
    assert!(refused > 0, "no two of them ever met");
}

#[test]
fn files_that_are_no_part_of_an_archive_are_named_and_swept_by_its_next_writer() {
    let dir = volumes();
    let d = dir.path();
    let stray = d.join("a.isospan/steps/000007-values-000000.seg");
    fs::copy(d.join("a.isospan/steps/000000-values-000000.seg"), &stray).unwrap();
    let text = ok(d, &["check", "a.isospan"]);
    assert!(text.contains("sound") && text.contains("stray       steps/000007-values-000000.seg is no part"));
    assert!(!ok(d, &["check", "b.isospan"]).contains("stray"));
    ok(d, &["append", "a.isospan", "b.npy"]);
    assert!(!stray.exists());
    assert!(!ok(d, &["check", "a.isospan"]).contains("stray"));
}
