//! Names that are no regular file: ten kinds, as input, as output and as what a command makes
//! beside its output. A command ends within its time, and what a name leads to stays as it was.

use crate::common::*;
use isospan::pipeline::Amount;
use isospan::points::SetKind;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Makes a file of a kind, which may lead to another one.
type Make = fn(&Path, &Path);

/// Ways to take a name; `letter` is a user's file beside it.
const KINDS: [(&str, Make); 10] = [
    ("a link to a file", |at, letter| symlink(letter, at).unwrap()),
    ("a link to nothing", |at, _| symlink(at.with_extension("none"), at).unwrap()),
    ("a link to itself", |at, _| symlink(at, at).unwrap()),
    ("another name of a file", |at, letter| fs::hard_link(letter, at).unwrap()),
    ("a pipe", |at, _| assert!(Command::new("mkfifo").arg(at).status().unwrap().success())),
    ("an endless device", |at, _| symlink("/dev/zero", at).unwrap()),
    ("a full device", |at, _| symlink("/dev/full", at).unwrap()),
    ("a socket", |at, _| drop(std::os::unix::net::UnixListener::bind(at).unwrap())),
    ("a folder", |at, _| {
        fs::create_dir(at).unwrap();
        fs::write(at.join("photo"), "photo").unwrap();
    }),
    ("a file of nobody", |at, letter| {
        fs::copy(letter, at).unwrap();
        fs::set_permissions(at, fs::Permissions::from_mode(0o0)).unwrap();
    }),
];

/// A folder with a volume, an archive, a plan and a user's letter.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let d = dir.path();
        write_npy(&d.join("v.npy"), [20, 18, 16], waves);
        let few = settings(SetKind::Halton, Amount::Fraction(0.25), 3_000);
        crate::common::reduce(&d.join("v.npy"), &few, &d.join("a.isospan"), 1);
        let place = Self(dir);
        place.letter();
        for command in ["plan v.npy -o p.isospan -q", "surface a.isospan -i 0.1 -o s.ply -q"] {
            let done = place.run(command);
            assert!(done.status.success(), "{command}: {}", String::from_utf8_lossy(&done.stderr));
        }
        place
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn letter(&self) {
        fs::write(self.at("letter"), "dear reader").unwrap();
    }

    /// Runs a command, which is stopped after a minute.
    fn run(&self, command: &str) -> Output {
        Command::new("timeout")
            .args(["-s", "KILL", "60", env!("CARGO_BIN_EXE_isospan")])
            .args(command.split(' '))
            .current_dir(self.0.path())
            .output()
            .unwrap()
    }

    /// Runs a command where a name is taken. Returns whether it was done.
    fn try_with(&self, name: &str, kind: (&str, fn(&Path, &Path)), command: &str) -> Result<bool, String> {
        let (at, letter) = (self.at(name), self.at("letter"));
        kind.1(&at, &letter);
        let out = self.run(command);
        let words = String::from_utf8_lossy(&out.stderr).into_owned();
        let wrong = |why: &str| Err(format!("{command}, {name} is {}: {why}: {words}", kind.0));
        match out.status.code() {
            None | Some(101 | 137) => return wrong("it did not end by itself"),
            Some(0) => {}
            Some(_) if words.contains("panicked") || words.trim().is_empty() => {
                return wrong("no clear line");
            }
            Some(_) => {}
        }
        // A link that the user names as the output is followed, where a file is to be replaced.
        let is_followed = kind.0 == "a link to a file" && command.ends_with("-q --force");
        if is_followed && out.status.success() {
            self.letter();
        }
        if fs::read_to_string(&letter).ok().as_deref() != Some("dear reader") {
            self.letter();
            return wrong("the letter is gone");
        }
        if kind.0 == "a folder" && fs::read_to_string(at.join("photo")).ok().as_deref() != Some("photo") {
            return wrong("the photo is gone");
        }
        if at.with_extension("none").exists() {
            return wrong("a link was followed");
        }
        Ok(out.status.success())
    }

    fn free(&self, name: &str) {
        let at = self.at(name);
        match fs::symlink_metadata(&at) {
            Ok(about) if about.is_dir() => fs::remove_dir_all(at).unwrap(),
            Ok(_) => fs::remove_file(at).unwrap(),
            Err(_) => {}
        }
    }
}

/// Tries commands at a name that is taken in all ways; `may` says which of them may be done.
fn try_all(place: &Place, cases: &[(&str, &str)], may: impl Fn(&str, &str) -> bool) {
    let mut failures = vec![];
    for (name, command) in cases {
        for kind in KINDS {
            match place.try_with(name, kind, command) {
                Ok(true) if !may(kind.0, command) => {
                    failures.push(format!("{command}, {name} is {}: it was done", kind.0));
                }
                Err(why) => failures.push(why),
                Ok(_) => {}
            }
            place.free(name);
        }
    }
    assert!(failures.is_empty(), "{} of them:\n{}", failures.len(), failures.join("\n"));
}

#[test]
fn inputs_that_are_no_regular_files_are_refused() {
    let place = Place::new();
    let cases = [
        ("x.nrrd", "info x.nrrd"),
        ("x.nrrd", "reduce x.nrrd -o n.isospan -q"),
        ("x.nrrd", "plan x.nrrd -o n.isospan -q"),
        ("x.nrrd", "append a.isospan x.nrrd -q"),
        ("x.nrrd", "brick x.nrrd -o n.bricks -q"),
        ("x.nrrd", "measure a.isospan --against x.nrrd -q"),
        ("x.csv", "probe a.isospan --at x.csv -o n.csv -q"),
        ("x.ply", "check x.ply"),
        ("x.ply", "compare x.ply s.ply"),
        ("x.ply", "render x.ply -o n.png -q"),
    ];
    try_all(&place, &cases, |_, _| false);
    assert!(["n.isospan", "n.bricks", "n.csv", "n.png"].iter().all(|n| !place.at(n).exists()));
    let archives = [
        "info",
        "check",
        "count -i 0.1",
        "export -o n.vtu",
        "probe --grid 4,4,4 -o n.vti",
        "publish -o n",
        "render -i 0.1 -o n.png",
        "spectrum",
        "surface -i 0.1 -o n.ply",
        "view",
        "append v.npy",
        "measure --against v.npy",
        "status",
        "work",
        "commit",
        "slurm",
        "gc --older-than 1d",
    ];
    let commands: Vec<String> = archives
        .iter()
        .map(|words| {
            let (command, rest) = words.split_once(' ').unwrap_or((words, ""));
            format!("{command} x.isospan {rest}").trim().to_owned()
        })
        .collect();
    let cases: Vec<_> = commands.iter().map(|command| ("x.isospan", command.as_str())).collect();
    // A folder that is no archive is not made one, either.
    try_all(&place, &cases, |_, _| false);
}

#[test]
fn outputs_never_lead_elsewhere() {
    let place = Place::new();
    let commands = [
        ("o.ply", "surface a.isospan -i 0.1 -o o.ply -q"),
        ("o.glb", "surface a.isospan -i 0.1 -o o.glb -q"),
        ("o.vtu", "export a.isospan -o o.vtu -q"),
        ("o.npy", "probe a.isospan --grid 4,4,4 -o o.npy -q"),
        ("o.png", "render a.isospan -i 0.1 -o o.png --size 40,30 -q"),
        ("o.svg", "spectrum a.isospan --plot o.svg -q"),
        ("o.bricks", "brick v.npy -o o.bricks -q"),
    ];
    let forced: Vec<_> =
        commands.iter().map(|(name, command)| (*name, format!("{command} --force"))).collect();
    let forced: Vec<_> = forced.iter().map(|(name, command)| (*name, command.as_str())).collect();
    // A link to nothing may be replaced by a file; with --force a file and a link to one, too.
    try_all(&place, &commands, |kind, _| kind == "a link to nothing" || kind == "a link to itself");
    try_all(&place, &forced, |kind, _| {
        !["a pipe", "an endless device", "a full device", "a socket", "a folder"].contains(&kind)
    });
    // Folders: an archive and a page.
    let folders = [
        ("o.isospan", "reduce v.npy -o o.isospan -q"),
        ("o.isospan", "reduce v.npy -o o.isospan --force -q"),
        ("o.isospan", "plan v.npy -o o.isospan --force -q"),
        ("viewer", "publish a.isospan -o viewer -q"),
        ("viewer", "publish a.isospan -o viewer --force -q"),
    ];
    try_all(&place, &folders, |_, command| command.starts_with("plan"));
}

#[test]
fn names_beside_an_output_that_are_taken_are_left_alone() {
    let place = Place::new();
    let locks = [
        (".o.isospan.lock", "reduce v.npy -o o.isospan -q"),
        (".a.isospan.lock", "append a.isospan v.npy -q --times 7"),
        (".p.isospan.lock", "commit p.isospan -q"),
        (".viewer.lock", "publish a.isospan -o viewer -q"),
    ];
    try_all(&place, &locks, |_, _| false);
    let others = [
        ("p.isospan.work/plan.json", "plan v.npy -o p.isospan --force -q"),
        ("p.isospan.work/plan.json", "work p.isospan -q"),
        ("p.isospan.work/plan.json", "status p.isospan"),
        ("p.isospan.work/slurm", "slurm p.isospan --force"),
        ("p.isospan.work/slurm/work.sh", "slurm p.isospan"),
        ("p.isospan.work/slurm/work.sh", "slurm p.isospan --force"),
        ("a.isospan/stray", "gc a.isospan --older-than 0d"),
        ("a.isospan/mesh/stray", "gc a.isospan --older-than 0d"),
        ("a.isospan/mesh/stray", "check a.isospan"),
        ("q.isospan.work", "reduce v.npy -o q.isospan -q --target-rms 5%"),
    ];
    for (name, command) in others {
        if name.ends_with("plan.json") {
            place.free(name);
        }
        if name.ends_with("work.sh") {
            let _ = fs::create_dir(place.at("p.isospan.work/slurm"));
        }
        try_all(&place, &[(name, command)], |_, _| true);
        place.free("q.isospan");
    }
}

#[test]
fn an_archive_with_a_file_of_another_program_is_not_replaced() {
    let place = Place::new();
    for name in ["notes.txt", "mesh/photo.jpg", "steps/.git", "mesh/000000.seg.backup", "steps/old"] {
        if name.ends_with("old") {
            fs::create_dir(place.at("a.isospan/steps/old")).unwrap();
        } else {
            fs::write(place.at("a.isospan").join(name), "mine").unwrap();
        }
        for command in ["reduce v.npy -o a.isospan -q --force", "plan v.npy -o a.isospan -q --force"] {
            let out = place.run(command);
            let words = String::from_utf8_lossy(&out.stderr).into_owned();
            assert!(out.status.code() == Some(2) && words.lines().count() == 1, "{name}, {command}: {words}");
            assert!(place.at("a.isospan").join(name).exists(), "{name}, {command}");
            assert!(place.at("a.isospan/manifest.zst").exists(), "{name}, {command}");
        }
        place.free(&format!("a.isospan/{name}"));
    }
    assert!(place.run("reduce v.npy -o a.isospan -q --force").status.success());
    // A link in the place of the folder in which it works.
    fs::create_dir_all(place.at("elsewhere/old.isospan")).unwrap();
    symlink("elsewhere", place.at("b.isospan.work")).unwrap();
    assert_eq!(place.run("reduce v.npy -o b.isospan -q").status.code(), Some(2));
    assert!(place.at("elsewhere/old.isospan").exists());
}
