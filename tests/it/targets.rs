//! Targets: the same request has the same bytes from Rust and from the program, a target that is
//! not met is said each time, and a search goes on where a kill left it.
#![cfg(unix)]

use crate::common::*;
use isospan::Reduction;
use isospan::pipeline::{Bound, ReduceReport, Target};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

fn command(dir: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
    command.current_dir(dir).args(args).stdin(Stdio::null());
    command
}

fn program(dir: &Path, args: &[&str]) -> (i32, String, String) {
    let Output { status, stdout, stderr } = command(dir, args).output().unwrap();
    let text = |b| String::from_utf8(b).unwrap();
    (status.code().expect("ended by itself"), text(stdout), text(stderr))
}

/// The report of a reduction by the library.
fn library(input: &Path, out: &Path, target: Target) -> ReduceReport {
    Reduction::of(input).target(target).write(out).unwrap()
}

fn points(input: &Path, out: &Path, target: Target) -> ReduceReport {
    let set = isospan::points::SetKind::Hammersley;
    Reduction::of(input).points(set).target(target).write(out).unwrap()
}

#[test]
fn rust_and_the_program_make_the_same_bytes_for_each_target() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [30, 24, 20], waves);
    write_hexahedra(&d.join("m.vtk"), waves);
    let rms = |part| Target::Rms(Bound::OfRange(part));
    let max = |part| Target::Max(Bound::OfRange(part));
    let cases: [(&str, [&str; 2], Target); 8] = [
        ("v.npy", ["--target-rms", "2%"], rms(0.02)),
        ("v.npy", ["--target-max", "20%"], max(0.2)),
        ("v.npy", ["--size", "8KiB"], Target::Size(8 << 10)),
        ("v.npy", ["--ratio", "7"], Target::Ratio(7.0)),
        ("m.vtk", ["--target-rms", "8%"], rms(0.08)),
        ("m.vtk", ["--target-max", "45%"], max(0.45)),
        ("m.vtk", ["--size", "40KiB"], Target::Size(40 << 10)),
        ("m.vtk", ["--ratio", "1.5"], Target::Ratio(1.5)),
    ];
    for (n, (input, flags, target)) in cases.into_iter().enumerate() {
        let [by_program, by_library] = ["p", "r"].map(|name| d.join(format!("{n}-{name}.isospan")));
        let args = [&["reduce", "-q", input, "-o", by_program.to_str().unwrap()], &flags[..]].concat();
        let (code, _, error) = program(d, &args);
        let report = library(&d.join(input), &by_library, target);
        assert!(folder(&by_program) == folder(&by_library), "{input} {flags:?}: {report:?}");
        assert_eq!(code == 0, report.unmet().is_none(), "{input} {flags:?}: {error}");
        assert_eq!(report.unmet(), None, "{input} {flags:?}");
    }
}

/// Also where the archive was made before, and where shards have made it.
#[test]
fn a_target_that_is_not_met_is_said_each_time() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [20, 18, 16], waves);
    let cases: [(&str, Target, &[&str]); 3] = [
        ("rms", Target::Rms(Bound::OfRange(1e-9 / 100.0)), &["--target-rms", "1e-9%"]),
        ("size", Target::Size(100), &["--size", "100B"]),
        ("ratio", Target::Ratio(1e6), &["--ratio", "1e6"]),
    ];
    for (name, target, flags) in cases {
        let out = format!("{name}.isospan");
        let reduce = [&["reduce", "-q", "v.npy", "-o", &out, "--points", "hammersley"], flags].concat();
        let said: Vec<_> = (0..2).map(|_| program(d, &reduce)).collect();
        for (code, text, error) in &said {
            assert!(*code == 6 && text.contains("NOT MET"), "{name}: {code} {text}{error}");
            assert!(error.contains("the target is not met"), "{name}: {error}");
        }
        assert!(said[1].1.contains("nothing left to make"), "{}", said[1].1);
        assert_eq!(said[0].2, said[1].2, "{name}: the same was reached");
        let reports = [&format!("{name}-new.isospan"), &out]
            .map(|archive| points(&d.join("v.npy"), &d.join(archive), target));
        let reached = reports.each_ref().map(|report| report.unmet().map(|t| (t.reached, t.bound)));
        assert!(reached[0].is_some() && reached[0] == reached[1], "{name}: {reached:?}");
        assert!(reports[1].made_before);
    }
    let plan = ["plan", "-q", "v.npy", "-o", "s.isospan", "--target-rms", "1e-9%", "--points", "hammersley"];
    assert_eq!(program(d, &plan).0, 0);
    let mut codes = vec![];
    while codes.last().is_none_or(|code| *code == 7) {
        assert_eq!(program(d, &["work", "-q", "s.isospan"]).0, 0);
        codes.push(program(d, &["commit", "-q", "s.isospan"]).0);
    }
    let (code, text, error) = program(d, &["commit", "-q", "s.isospan"]);
    assert!(code == 6 && text.contains("NOT MET"), "{codes:?} {code}: {text}{error}");
    assert_eq!(codes.last(), Some(&6));
}

/// The numbers of the tries that a run has begun.
fn tries(stderr: &str) -> Vec<u64> {
    let events = stderr.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    events.filter(|e| e["event"] == "try").map(|e| e["try"].as_u64().unwrap()).collect()
}

/// Numbers below `n`, the same in every run of the test.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }
}

fn spawn(dir: &Path, args: &[&str]) -> Child {
    command(dir, args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// A search that is killed at random moments makes no try twice that it has noted, and ends with
/// the bytes of one that is not; returns how many kills left something of a search.
fn killed_search(dir: &Path, flags: &[&str], dice: &mut Dice, enough: u32) {
    let request = |out| [&["reduce", "v.npy", "-o", out, "--progress", "json"], flags].concat();
    let started = Instant::now();
    let (code, _, said) = program(dir, &request("whole.isospan"));
    let (took, all) = (started.elapsed(), tries(&said));
    assert!(code == 0 && all.len() > 2 && all == (1..=all.len() as u64).collect::<Vec<_>>(), "{said}");
    let expected = folder(&dir.join("whole.isospan"));
    let (mut kills, mut last) = (0, 0);
    for run in 0u32.. {
        assert!(run < 400, "{kills} kills");
        let mut child = spawn(dir, &request("k.isospan"));
        std::thread::sleep(Duration::from_micros(dice.roll(took.as_micros() as u64 / 2)));
        let is_killed = kills < enough && child.try_wait().unwrap().is_none();
        if is_killed {
            child.kill().unwrap();
            kills += 1;
        }
        let out = child.wait_with_output().unwrap();
        let begun = tries(&String::from_utf8(out.stderr).unwrap());
        if let Some(&first) = begun.first() {
            // Killed within the try before, or when it was noted.
            assert!(first == last.max(1) || first == last + 1, "{flags:?}: {last}, then {begun:?}");
            assert!(begun.windows(2).all(|pair| pair[1] == pair[0] + 1), "{begun:?}");
            last = *begun.last().unwrap();
        }
        if dir.join("k.isospan/manifest.zst").exists() {
            if !is_killed {
                assert!(out.status.success());
                assert!(!dir.join("k.isospan.work").exists(), "{flags:?}: tries are left");
            }
            assert!(folder(&dir.join("k.isospan")) == expected, "{flags:?}");
            assert_eq!(last, all.len() as u64, "{flags:?}: tries");
            if kills >= enough && !is_killed {
                break;
            }
            fs::remove_dir_all(dir.join("k.isospan")).unwrap();
            last = 0;
        }
    }
    for name in ["k.isospan", "whole.isospan"] {
        fs::remove_dir_all(dir.join(name)).unwrap();
    }
}

#[test]
fn a_killed_search_goes_on_at_its_try() {
    let dir = tempfile::tempdir().unwrap();
    write_npy(&dir.path().join("v.npy"), [24, 22, 20], waves);
    let mut dice = Dice(11);
    killed_search(dir.path(), &["--target-rms", "2%"], &mut dice, 20);
    killed_search(dir.path(), &["--size", "8KiB"], &mut dice, 5);
    killed_search(dir.path(), &["--target-max", "12%", "--adapt"], &mut dice, 10);
}

/// What is found of a search for something else is no part of this one.
#[test]
fn a_search_for_something_else_begins_anew() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [24, 22, 20], waves);
    let request = |target| {
        [
            "reduce",
            "v.npy",
            "-o",
            "a.isospan",
            "--points",
            "regular",
            "--progress",
            "json",
            "--target-rms",
            target,
        ]
    };
    let stopped_in_try = |target, number| {
        let mut wait = Duration::from_millis(60);
        for _ in 0..100 {
            let mut child = spawn(d, &request(target));
            std::thread::sleep(wait);
            let _ = child.kill();
            let begun = tries(&String::from_utf8(child.wait_with_output().unwrap().stderr).unwrap());
            if d.join("a.isospan").exists() {
                // It ended before it was killed.
                fs::remove_dir_all(d.join("a.isospan")).unwrap();
                wait = wait * 2 / 3;
                continue;
            }
            if begun.last().is_some_and(|last| *last >= number) {
                return;
            }
            wait = wait * 3 / 2;
        }
        panic!("no run was killed in try {number}");
    };
    stopped_in_try("2%", 2);
    let (code, _, said) = program(d, &request("3%"));
    assert!(code == 0 && tries(&said)[0] == 1, "{said}");
    assert!(said.contains("asks for something else, and is dropped"), "{said}");
    fs::remove_dir_all(d.join("a.isospan")).unwrap();
    stopped_in_try("2%", 2);
    write_npy(&d.join("v.npy"), [24, 22, 20], |x, y, z| waves(x, y, z) * 1.5);
    let (code, _, said) = program(d, &request("2%"));
    assert!(code == 0 && tries(&said)[0] == 1, "{said}");
    assert_eq!(program(d, &["check", "a.isospan"]).0, 0);
    fs::remove_dir_all(d.join("a.isospan")).unwrap();
    // An archive that is made without a search leaves none behind.
    stopped_in_try("2%", 2);
    assert!(d.join("a.isospan.work/search.json").exists());
    assert_eq!(program(d, &["reduce", "-q", "v.npy", "-o", "a.isospan"]).0, 0);
    assert!(!d.join("a.isospan.work").exists());
}

#[test]
fn a_dry_run_says_what_is_known_of_a_search() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [24, 22, 20], waves);
    let dry = |more: &[&str]| {
        let (code, text, error) = program(
            d,
            &[&["reduce", "v.npy", "-o", "a.isospan", "--points", "halton", "--dry-run"], more].concat(),
        );
        assert_eq!(code, 0, "{more:?}: {error}");
        text
    };
    let text = dry(&["--target-rms", "1%"]);
    assert!(text.contains("about 5 tries") && text.contains("for all tries"), "{text}");
    // Sizes are guesses, unless one is wanted.
    assert!(text.contains(" to about ") && !text.contains("at most 1/"), "{text}");
    assert!(dry(&["--size", "20KiB"]).contains(" to 20.0 KiB"));
    assert!(dry(&[]).lines().any(|line| line.starts_with("  archive    about ")));
    for (flags, most) in [(["--size", "20KiB"], Some(20 << 10)), (["--target-max", "5%"], None)] {
        let report: Value = serde_json::from_str(&dry(&[&flags[..], &["--json"]].concat())).unwrap();
        let bytes = [0, 1].map(|n| report["search"]["archive_bytes"][n].as_u64().unwrap());
        assert!(bytes[0] <= bytes[1] && most.is_none_or(|most| bytes[1] == most), "{report}");
        assert!(report["search"]["tries"].as_u64().unwrap() > 1, "{report}");
    }
    dry(&["--target-max", "5%", "--adapt"]);
    assert!(!d.join("a.isospan").exists() && !d.join("a.isospan.work").exists());
}

/// A part of the range is one of the range of all samples, also of steps behind the first, and not
/// of the values that are left of them.
#[test]
fn a_part_of_the_range_is_that_of_the_samples_of_all_steps() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("a.npy"), [16, 16, 16], waves);
    // A peak of one sample, which fewer points do not have.
    let is_peak = |x: f64, y: f64, z: f64| [x, y, z].iter().all(|c| (c - 1.0 / 15.0).abs() < 1e-9);
    write_npy(
        &d.join("b.npy"),
        [16, 16, 16],
        move |x, y, z| if is_peak(x, y, z) { 64.0 } else { 0.25 * waves(x, y, z) },
    );
    let least = |name: &str| {
        let bytes = fs::read(d.join(name)).unwrap();
        let of = |b: &[u8]| f32::from_le_bytes(b.try_into().unwrap());
        bytes[bytes.len() - 4 * 16 * 16 * 16..].chunks(4).map(of).fold(f32::INFINITY, f32::min)
    };
    let range = 64.0 - f64::from(least("a.npy").min(least("b.npy")));
    for more in [&[][..], &["--points", "halton"], &["--adapt"]] {
        let args =
            ["reduce", "a.npy", "b.npy", "-o", "s.isospan", "--force", "-q", "--json", "--target-rms", "2%"];
        let (code, text, error) = program(d, &[&args[..], more].concat());
        assert!(code == 0 || code == 6, "{more:?}: {error}");
        let report: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(report["target"]["bound"].as_f64().unwrap(), 0.02 * range, "{more:?}");
    }
}

/// Points are chosen by the first night: a later one with another field is told.
#[test]
fn a_night_says_that_its_steps_miss_the_target() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    fs::create_dir(d.join("scope")).unwrap();
    let night = |name: &str, field: fn(f64, f64, f64) -> f64| {
        write_npy(&d.join("scope").join(name), [20, 19, 18], field);
        let args = ["nightly", "scope", "t*.npy", "a.isospan", "--settle=0s", "--json", "--quiet"];
        let out = command(d, &[&args[..], &["--target-rms", "4%"]].concat()).output().unwrap();
        let summary: Value = serde_json::from_slice(&out.stdout).unwrap();
        (out.status.code().unwrap(), summary, String::from_utf8(out.stderr).unwrap())
    };
    assert_eq!(night("t1.npy", waves).0, 0);
    assert_eq!(night("t2.npy", |x, y, z| waves(x + 0.01, y, z)).0, 0);
    let (code, summary, error) =
        night("t3.npy", |x, y, z| (1e4 * (x * 12.9 + y * 78.2 + z * 37.7).sin()).fract());
    assert!(code == 6 && error.contains("the target is not met: RMS"), "{code}: {error}");
    assert_eq!((summary["added"].as_array().unwrap().len(), &summary["code"]), (1, &6.into()));
}
