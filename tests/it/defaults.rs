//! What a reduction makes of a volume or a mesh without any choices of the user.

use crate::common::{folder, reduce, waves, write_mesh, write_npy};
use isospan::pipeline::{Bound, ReduceSettings, Target};
use isospan::points::SetKind;
use std::process::Command;

#[test]
fn a_volume_becomes_a_pyramid_with_an_error_of_a_hundredth_of_its_range() {
    let dir = tempfile::tempdir().unwrap();
    let [input, usual, named] = ["v.npy", "usual.isospan", "named.isospan"].map(|n| dir.path().join(n));
    write_npy(&input, [44, 40, 36], waves);
    let report = reduce(&input, &ReduceSettings::default(), &usual, 2);
    let all_named = ReduceSettings {
        points: Some(SetKind::Pyramid),
        target: Some(Target::Rms(Bound::OfRange(0.01))),
        ..ReduceSettings::default()
    };
    reduce(&input, &all_named, &named, 2);
    assert!(folder(&usual) == folder(&named));
    let error = report.error.unwrap();
    let [low, high] = error.source_range.unwrap();
    let share = error.rms / (high - low);
    assert!((0.005..=0.01).contains(&share), "{share}");
    assert!(40 * report.archive_bytes < 4 * 44 * 40 * 36, "{} bytes", report.archive_bytes);
}

#[test]
fn a_flag_for_points_of_a_volume_asks_for_their_set() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [24, 22, 20], waves);
    for flag in [
        "--fraction 1/2",
        "--count 900",
        "--values fit",
        "--value-bits 8",
        "--interp nearest",
        "--chunk-points 1000",
    ] {
        let flag: Vec<&str> = flag.split(' ').collect();
        let args = [&["reduce", "v.npy", "-o", "v.isospan"], &flag[..]].concat();
        let run = |more: &[&str]| {
            let mut program = Command::new(env!("CARGO_BIN_EXE_isospan"));
            let out = program.current_dir(d).args(&args).args(more).output().unwrap();
            (out.status.code().unwrap(), String::from_utf8(out.stderr).unwrap())
        };
        let (code, error) = run(&["-q"]);
        assert!(code == 2 && error.contains(flag[0]) && error.contains("--points"), "{code} {error}");
        assert!(!d.join("v.isospan").exists());
        let (code, error) = run(&["-q", "--points", "regular"]);
        assert_eq!(code, 0, "{error}");
        std::fs::remove_dir_all(d.join("v.isospan")).unwrap();
    }
}

#[test]
fn a_mesh_becomes_exact_hammersley_points() {
    let dir = tempfile::tempdir().unwrap();
    let [input, usual, named] = ["m.vtk", "usual.isospan", "named.isospan"].map(|n| dir.path().join(n));
    write_mesh(&input, 10, |_| true, |p| p, |p| waves(p[0], p[1], p[2]));
    let report = reduce(&input, &ReduceSettings::default(), &usual, 2);
    assert!(report.quantiser.is_none());
    reduce(&input, &ReduceSettings::exact(SetKind::Hammersley), &named, 2);
    assert!(folder(&usual) == folder(&named));
}
