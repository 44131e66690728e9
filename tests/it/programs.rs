//! Tests need no program that README does not name: what they call is listed here, with where it
//! comes from.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Programs of packages that every Debian has ("Essential: yes").
const EVERYWHERE: [&str; 6] = ["bash", "gzip", "mkfifo", "setpriv", "timeout", "unshare"];
/// Programs of tests that do without them, or are ignored unless asked for, which CI does, and of
/// the program itself, which goes on without them.
const ASKED_FOR: [&str; 4] = ["fincore", "groff", "sbatch", "scontrol"];
/// What is no literal: the program under test, and a script or a program of Slurm that the caller
/// names.
const NO_LITERALS: [&str; 4] = ["env!(\"CARGO_BIN_EXE_isospan\")", "program", "script", "PROGRAM"];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => sources(&path, found),
            false if path.extension().is_some_and(|e| e == "rs") => found.push(path),
            false => {}
        }
    }
}

#[test]
fn tests_call_programs_that_every_debian_has() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let (mut files, mut seen) = (vec![], BTreeSet::new());
    ["src", "tests", "tools", "benches"].iter().for_each(|f| sources(&root.join(f), &mut files));
    files.retain(|f| !f.ends_with("tests/it/programs.rs"));
    for file in &files {
        let text = fs::read_to_string(file).unwrap();
        for called in text.split("Command::new(").skip(1) {
            let called = called.trim_start();
            let program = match called.strip_prefix('"') {
                Some(literal) => literal.split('"').next().unwrap(),
                None => called.split([',', ';', '.', ' ']).next().unwrap().trim_end().trim_end_matches(')'),
            };
            let known = match called.starts_with('"') {
                true => EVERYWHERE.contains(&program) || ASKED_FOR.contains(&program),
                false => NO_LITERALS.iter().any(|n| n.trim_end_matches(')') == program),
            };
            assert!(known, "{}: {program}: add it to a list of tests/it/programs.rs", file.display());
            seen.insert(program.to_owned());
        }
    }
    for listed in EVERYWHERE.iter().chain(&ASKED_FOR) {
        assert!(seen.contains(*listed), "{listed} is called no more: remove it from the list");
    }
}

/// A test that returns early because something is missing would be reported as passed: it is to be
/// `#[ignore = "why"]`.
#[test]
fn no_test_passes_by_skipping() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let mut files = vec![];
    ["src", "tests", "tools"].iter().for_each(|f| sources(&root.join(f), &mut files));
    files.retain(|f| !f.ends_with("tests/it/programs.rs"));
    for file in &files {
        let text = fs::read_to_string(file).unwrap();
        let says = text.lines().find(|l| l.contains("println!(\"skipped"));
        assert!(says.is_none(), "{}: {says:?}", file.display());
    }
}
