//! The program draws and compares surfaces: the same bytes again, and one line where it cannot.
#![cfg(unix)]

use crate::common::{ball, reduce, settings, write_npy};
use isospan::pipeline::Amount;
use isospan::points::SetKind;
use std::path::Path;
use std::process::{Command, Stdio};

fn run(dir: &Path, args: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
    let out = command.current_dir(dir).args(args).arg("-q").stdin(Stdio::null()).output().unwrap();
    let text = |b| String::from_utf8(b).unwrap();
    (out.status.code().expect("ended by itself"), text(out.stdout), text(out.stderr))
}

fn ok(dir: &Path, args: &[&str]) -> String {
    let (code, out, err) = run(dir, args);
    assert!(code == 0 && err.is_empty(), "{args:?}: {code}: {err}");
    out
}

fn fails(dir: &Path, args: &[&str], code: i32, why: &str) {
    let (found, out, err) = run(dir, args);
    assert!(found == code && out.is_empty() && err.lines().count() == 1, "{args:?}: {found}: {out}{err}");
    assert!(err.contains(why), "{err}");
}

/// Archives of a ball from many and from few points, and their surfaces.
fn balls() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.npy");
    write_npy(&input, [30, 30, 30], ball);
    for (name, fraction) in [("fine", 1.0), ("coarse", 0.05)] {
        let out = dir.path().join(format!("{name}.isospan"));
        reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(fraction), 50_000), &out, 2);
        ok(dir.path(), &["surface", &format!("{name}.isospan"), "-i", "0", "-o", &format!("{name}.ply")]);
    }
    dir
}

/// Width and height that a PNG file states.
fn png_size(path: &Path) -> [u32; 2] {
    let bytes = std::fs::read(path).unwrap();
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
    [16, 20].map(|at| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()))
}

#[test]
fn pictures_of_files_and_archives_are_the_same_bytes_again() {
    let dir = balls();
    let dir = dir.path();
    let small = ["--size", "80,60", "--lights", "16"];
    let draw = |more: &[&str]| ok(dir, &[&["render"][..], more, &small].concat());
    let told = draw(&["fine.ply", "coarse.ply", "-o", "a.png", "--threads", "1"]);
    assert!(told.contains("coarse.ply") && told.contains("triangles"), "{told}");
    draw(&["fine.ply", "coarse.ply", "-o", "b.png", "--threads", "3"]);
    let bytes = |name: &str| std::fs::read(dir.join(name)).unwrap();
    assert!(bytes("a.png") == bytes("b.png"));
    let [width, height] = png_size(&dir.join("a.png"));
    assert!(width == 160 && height > 60, "two panels, and words below: {width} x {height}");
    // An archive is drawn as its surface is.
    draw(&["fine.ply", "-o", "c.png"]);
    draw(&["fine.isospan", "-i", "0", "-o", "d.png"]);
    assert!(bytes("c.png") == bytes("d.png") && png_size(&dir.join("c.png")) == [80, 60]);
    draw(&["fine.isospan", "-i", "0,0.2", "-o", "e.png", "--columns", "1", "--colour", "normals,#336699"]);
    assert_eq!(png_size(&dir.join("e.png"))[0], 80);
    let told = draw(&["coarse.ply", "--distance-to", "fine.ply", "-o", "f.png", "--json"]);
    let told: serde_json::Value = serde_json::from_str(&told).unwrap();
    let far = told["panels"][0]["largest_distance"].as_f64().unwrap();
    assert!(far > 0.1 && far < 5.0, "{told}");
    assert!(png_size(&dir.join("f.png"))[1] > 60, "a scale below");
}

#[test]
fn surfaces_are_compared_and_a_surface_is_itself() {
    let dir = balls();
    let dir = dir.path();
    let told = ok(dir, &["compare", "fine.ply", "fine.ply", "--samples", "2000", "--json"]);
    let same: serde_json::Value = serde_json::from_str(&told).unwrap();
    assert_eq!((same["hausdorff"].as_f64(), same["rms"].as_f64()), (Some(0.0), Some(0.0)));
    let told = ok(dir, &["compare", "coarse.ply", "fine.ply", "--samples", "2000", "--json"]);
    let apart: serde_json::Value = serde_json::from_str(&told).unwrap();
    assert!(apart["hausdorff"].as_f64().unwrap() > apart["rms"].as_f64().unwrap());
    assert!(apart["rms"].as_f64().unwrap() > 0.01);
    assert!(ok(dir, &["compare", "coarse.ply", "fine.ply", "--samples", "2000"]).contains("RMS distance"));
}

#[test]
fn what_cannot_be_drawn_is_told_in_one_line() {
    let dir = balls();
    let dir = dir.path();
    fails(dir, &["render", "fine.ply", "-o", "a.jpg"], 2, ".png");
    fails(dir, &["render", "fine.isospan", "-o", "a.png"], 2, "--isovalue");
    fails(dir, &["render", "fine.ply", "-i", "1", "-o", "a.png"], 2, "archives");
    fails(dir, &["render", "fine.isospan", "-i", "99", "-o", "a.png"], 2, "no surface");
    fails(dir, &["render", "fine.ply", "-o", "a.png", "--caption", "雪"], 2, "font");
    fails(dir, &["render", "fine.ply", "-o", "a.png", "--caption", "a", "--caption", "b"], 2, "2 captions");
    fails(dir, &["render", "fine.ply", "-o", "a.png", "--elevation", "99"], 2, "elevation");
    fails(dir, &["render", "fine.ply", "-o", "a.png", "--memory", "20MiB"], 4, "memory");
    fails(dir, &["compare", "fine.ply", "ball.npy"], 5, "ball.npy");
    assert!(!dir.join("a.png").exists());
}
