//! One door for settings: the same request has the same bytes, and the same refusal, from Rust and
//! from the program; and the library names settings, not flags.

use crate::common::*;
use isospan::Reduction;
use isospan::pipeline::{Amount, FieldValue, Focus, NanPolicy, ReduceSettings, SetChoice, Target};
use isospan::points::SetKind;
use isospan::sample::{Interpolation, Values};
use isospan::setting::{Setting, worded};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Runs `isospan reduce`; the error that it ends with, if it does.
fn by_program(dir: &Path, input: &str, out: &str, flags: &str) -> Option<String> {
    let flags = flags.split(' ').filter(|flag| !flag.is_empty());
    let args = ["reduce", "-q", input, "-o", out].into_iter().chain(flags);
    let done = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap();
    let text = String::from_utf8(done.stderr).unwrap();
    (!done.status.success()).then(|| text.trim().trim_start_matches("isospan: error: ").to_owned())
}

fn usual() -> ReduceSettings {
    ReduceSettings::default()
}

fn of(points: SetKind) -> ReduceSettings {
    ReduceSettings::exact(points)
}

#[test]
fn rust_and_the_program_complete_settings_alike() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [30, 24, 20], |x, y, z| (100.0 * waves(x, y, z)).round());
    write_mesh(&d.join("m.vtk"), 8, |_| true, |p| p, |p| waves(p[0], p[1], p[2]));
    let half = Amount::Fraction(0.5);
    let shifted = |shift| SetChoice { shift: Some(shift), ..SetChoice::default() };
    let upper = Focus { low: FieldValue::Share(0.5), high: FieldValue::Share(1.0) };
    let cases = [
        ("v.npy", "", usual()),
        ("v.npy", "--lossless", ReduceSettings { target: Some(Target::Lossless), ..usual() }),
        ("v.npy", "--no-measure", ReduceSettings { measure: false, ..usual() }),
        ("v.npy", "--shift 0.5", ReduceSettings { set: shifted(0.5), ..usual() }),
        ("v.npy", "--adapt", ReduceSettings { adapt: true, ..usual() }),
        ("v.npy", "--focus 50%:100%", ReduceSettings { focus: Some(upper), ..usual() }),
        (
            "v.npy",
            "--points hyperbolic-cross --cross-r 1,1,2 --count 700",
            ReduceSettings {
                set: SetChoice { r: Some([1, 1, 2]), ..SetChoice::default() },
                amount: Amount::Count(700),
                ..of(SetKind::HyperbolicCross)
            },
        ),
        (
            "v.npy",
            "--points regular --fraction 1/2 --interp nearest",
            ReduceSettings { amount: half, interpolation: Interpolation::Nearest, ..of(SetKind::Regular) },
        ),
        (
            "v.npy",
            "--points halton --value-bits 9 --nan mask --missing 7",
            ReduceSettings {
                value_bits: Some(9.0),
                nan: NanPolicy::Mask,
                missing: Some(7.0),
                ..of(SetKind::Halton)
            },
        ),
        ("m.vtk", "", usual()),
        ("m.vtk", "--shift 0.25", ReduceSettings { set: shifted(0.25), ..usual() }),
        ("m.vtk", "--fraction 1", ReduceSettings { amount: Amount::Fraction(1.0), ..usual() }),
        (
            "m.vtk",
            "--interp quadratic",
            ReduceSettings { interpolation: Interpolation::Quadratic, ..usual() },
        ),
        ("m.vtk", "--focus 0:1", ReduceSettings { focus: Some([0.0, 1.0].into()), ..usual() }),
        ("m.vtk", "--values sample", ReduceSettings { values: Some(Values::Sample), ..usual() }),
    ];
    for (n, (input, flags, settings)) in cases.into_iter().enumerate() {
        let [program, library] = ["p", "r"].map(|name| format!("{n}-{name}.isospan"));
        assert_eq!(by_program(d, input, &program, flags), None, "{input} {flags}");
        Reduction::of(d.join(input)).settings(settings).write(d.join(&library)).unwrap();
        assert!(folder(&d.join(program)) == folder(&d.join(library)), "{input} {flags}");
    }
}

#[test]
fn rust_and_the_program_refuse_the_same_settings() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [12, 11, 10], waves);
    write_mesh(&d.join("m.vtk"), 4, |_| true, |p| p, |p| p[0]);
    let cross = SetChoice { k: Some(2), ..SetChoice::default() };
    let shifted = SetChoice { shift: Some(0.5), ..SetChoice::default() };
    let upper = Focus { low: FieldValue::Share(0.5), high: FieldValue::Share(1.0) };
    let cases = [
        ("v.npy", "--fraction 1/2", ReduceSettings { amount: Amount::Fraction(0.5), ..usual() }),
        ("v.npy", "--values fit", ReduceSettings { values: Some(Values::Fit), ..usual() }),
        ("v.npy", "--cross-k 2", ReduceSettings { set: cross, ..usual() }),
        (
            "v.npy",
            "--shift 0.5 --target-rms 1",
            ReduceSettings {
                set: shifted,
                target: Some(Target::Rms(isospan::pipeline::Bound::Value(1.0))),
                ..usual()
            },
        ),
        ("v.npy", "--points regular --adapt", ReduceSettings { adapt: true, ..of(SetKind::Regular) }),
        ("v.npy", "--focus 2:", ReduceSettings { focus: Some([2.0, f64::INFINITY].into()), ..usual() }),
        (
            "v.npy",
            "--focus 50%:100% --missing 3",
            ReduceSettings { focus: Some(upper), missing: Some(3.0), ..usual() },
        ),
        ("m.vtk", "--points pyramid", of(SetKind::Pyramid)),
        ("m.vtk", "--lossless", ReduceSettings { target: Some(Target::Lossless), ..usual() }),
    ];
    for (input, flags, settings) in cases {
        let said = by_program(d, input, "a.isospan", flags).expect(flags);
        let error = Reduction::of(d.join(input)).settings(settings).write(d.join("b.isospan")).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{flags}: {error}");
        let flag = |setting: Setting, value: Option<&str>| {
            let name = if setting == Setting::Interpolation { "interp" } else { setting.name() };
            let flag = format!("--{}", name.replace('_', "-"));
            value.map_or(flag.clone(), |value| format!("{flag} {value}"))
        };
        assert_eq!(said, worded(&error.to_string(), flag), "{flags}");
        assert!(!error.to_string().contains("--"), "{error}");
    }
}

/// The Rust files of the library's crates: all but the program.
fn library_sources() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().find(|dir| dir.join("src/io").is_dir());
    let mut folders = vec![root.expect("the tests lie in the project").join("src")];
    let mut files = vec![];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && !path.ends_with("src/cli") {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                files.push(path);
            }
        }
    }
    files
}

/// A line without what it says to readers of the code.
fn code(line: &str) -> &str {
    if line.trim_start().starts_with("//") { "" } else { line.split(" // ").next().unwrap_or_default() }
}

#[test]
fn no_message_of_the_library_names_a_flag() {
    /// Flags of other programs.
    const OTHERS: [&str; 3] = ["gdcmconv --raw", "`--features hdf5`", "run it with --ignored"];
    /// Names between backticks that are no settings: of attributes, members, features, programs.
    const NAMES: [&str; 8] = ["axes", "max", "other", "remote", "rms", "samples", "unzip", "world"];
    let files = library_sources();
    assert!(files.len() > 300, "{} files", files.len());
    let is_flag = |part: &str| part.starts_with(|c: char| c.is_ascii_lowercase());
    for path in files {
        let text = fs::read_to_string(&path).unwrap();
        for (n, line) in (1..).zip(text.lines()) {
            let line = OTHERS.iter().fold(code(line).to_owned(), |line, other| line.replace(other, ""));
            let place = format!("{}:{n}: {line}", path.display());
            assert!(!line.split("--").skip(1).any(is_flag), "{place}: name the setting, as in `memory`");
            // And a setting that is named is one.
            for name in line.split('`').skip(1).step_by(2).map(|text| text.split('=').next().unwrap()) {
                let is_word = !name.is_empty() && name.chars().all(|c| c.is_ascii_lowercase() || c == '_');
                let is_known = Setting::ALL.iter().any(|setting| setting.name() == name);
                assert!(is_known || !is_word || NAMES.contains(&name), "{place}: no setting {name}");
            }
        }
    }
}
