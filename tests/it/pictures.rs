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
    let far = told["panels"][0]["surfaces"][0]["largest_distance"].as_f64().unwrap();
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
fn archives_are_compared_by_their_surfaces() {
    let dir = balls();
    let dir = dir.path();
    let report = |more: &[&str]| -> serde_json::Value {
        let args = [&["compare"], more, &["--samples", "2000", "--json"]].concat();
        serde_json::from_str(&ok(dir, &args)).unwrap()
    };
    let files = report(&["coarse.ply", "fine.ply"]);
    assert_eq!(report(&["coarse.isospan", "fine.isospan", "--isovalue", "0"]), files);
    assert_eq!(report(&["coarse.ply", "fine.isospan", "-i", "0", "--step", "0"]), files);
    // A picture of both, each coloured by its distance from the other.
    let drawn = ["compare", "coarse.isospan", "fine.ply", "-i", "0", "--samples", "500"];
    let told = ok(dir, &[&drawn[..], &["-o", "both.png"]].concat());
    assert!(told.contains("the largest is from A at"), "{told}");
    let [width, height] = png_size(&dir.join("both.png"));
    assert!(width == 1600 && height > 860, "two panels, words and a scale: {width} x {height}");
    fails(dir, &[&drawn[..], &["-o", "both.png"]].concat(), 2, "--force");
    fails(dir, &[&drawn[..], &["-o", "both.gif"]].concat(), 2, ".png");
    fails(dir, &[&drawn[..], &["--level", "1"]].concat(), 2, "pyramid");
    fails(dir, &["compare", "coarse.isospan", "fine.isospan"], 2, "--isovalue");
    fails(dir, &["compare", "coarse.ply", "fine.ply", "-i", "0"], 2, "both inputs are surfaces");
    fails(dir, &["compare", "coarse.ply", "fine.isospan", "-i", "1e9"], 2, "gives no surface");
}

#[test]
fn what_cannot_be_drawn_is_told_in_one_line() {
    let dir = balls();
    let dir = dir.path();
    fails(dir, &["render", "fine.ply", "-o", "a.jpg"], 2, ".png");
    fails(dir, &["render", "fine.ply", "-o", "a.gif"], 2, "--turntable");
    fails(dir, &["render", "fine.ply", "--slice", "z=1", "-o", "a.png"], 2, "archives");
    fails(dir, &["render", "fine.ply", "--steps", "0:1", "-o", "a.png"], 2, "archives");
    fails(dir, &["render", "fine.isospan", "--slice", "z=99", "-o", "a.png"], 2, "outside");
    fails(dir, &["render", "fine.isospan", "--slice", "z=9", "-o", "a.png", "--size", "60,60"], 2, "small");
    fails(
        dir,
        &["render", "fine.isospan", "--slice", "z=9", "--turntable", "4", "-o", "a.png"],
        2,
        "--isovalue",
    );
    fails(dir, &["render", "fine.isospan", "-i", "0,0", "-o", "a.png"], 2, "twice");
    fails(dir, &["render", "fine.isospan", "-i", "0", "--steps", "7:9", "-o", "a.png"], 2, "steps 0 to 0");
    fails(
        dir,
        &["render", "fine.isospan", "-i", "0,0.1", "--opacity", "1,1,1", "-o", "a.png"],
        2,
        "--opacity",
    );
    fails(dir, &["render", "fine.ply", "--clip", "x=99:", "-o", "a.png"], 2, "--clip");
    fails(dir, &["render", "fine.ply", "--fps", "9", "-o", "a.png"], 2, "--fps");
    let film = ["render", "fine.ply", "--turntable", "1000", "--size", "4000,4000", "-o", "a.png"];
    fails(dir, &film, 2, "too many");
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

/// Red, green, blue of a place on a PNG of opaque pixels.
fn pixel(path: &Path, [x, y]: [usize; 2]) -> [u8; 3] {
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!(info.color_type, png::ColorType::Rgb);
    let at = y * info.line_size + 3 * x;
    [bytes[at], bytes[at + 1], bytes[at + 2]]
}

#[test]
fn isovalues_share_a_panel_and_shine_through() {
    let dir = balls();
    let dir = dir.path();
    let draw = |name: &str, more: &[&str]| {
        let usual =
            ["render", "fine.isospan", "-i", "0.3,0", "--together", "--size", "120,90", "--lights", "8"];
        ok(dir, &[&usual[..], &["-o", name], more].concat());
        png_size(&dir.join(name))
    };
    let colours = ["--colour", "#2020e0,#e02020"];
    draw("opaque.png", &colours);
    let size = draw("glass.png", &[&colours[..], &["--opacity", "1,30%", "--threads", "1"]].concat());
    assert!(size[0] == 120 && size[1] > 90, "one panel and a legend: {size:?}");
    draw("again.png", &[&colours[..], &["--opacity", "1,0.3", "--threads", "3"]].concat());
    let bytes = |name: &str| std::fs::read(dir.join(name)).unwrap();
    assert!(bytes("glass.png") == bytes("again.png"));
    // The ball of the lower isovalue hides the other one, unless it is glass.
    let [opaque, glass] = ["opaque.png", "glass.png"].map(|name| pixel(&dir.join(name), [60, 45]));
    let is_blue = |[r, _, b]: [u8; 3]| b > r;
    assert!(is_blue(opaque) != is_blue(glass), "{opaque:?} {glass:?}");
}

#[test]
fn planes_show_the_field_where_a_cut_shows_it() {
    let dir = balls();
    let dir = dir.path();
    let draw = |name: &str, more: &[&str]| {
        ok(
            dir,
            &[&["render", "fine.isospan", "-o", name, "--lights", "8", "--size", "240,200"], more].concat(),
        )
    };
    // A flat picture: values of the field, in its colours.
    let flat = ["--slice", "z=50%", "--colour-map", "grey", "--colour-range", "-1:1"];
    draw("flat.png", &[&flat[..], &["--threads", "1"]].concat());
    draw("again.png", &[&flat[..], &["--threads", "2"]].concat());
    let bytes = |name: &str| std::fs::read(dir.join(name)).unwrap();
    assert!(bytes("flat.png") == bytes("again.png"));
    let size = png_size(&dir.join("flat.png"));
    assert!(size[0] == 240 && size[1] > 200, "a bar below: {size:?}");
    let [r, g, b] = pixel(&dir.join("flat.png"), [128, 96]);
    let grey = |v: f64| 255.0 * (v + 1.0) / 2.0;
    let probe = dir.join("at.csv");
    std::fs::write(&probe, "x,y,z\n14.5,14.5,14.5\n").unwrap();
    ok(dir, &["probe", "fine.isospan", "--at", "at.csv", "-o", "values.csv"]);
    let told = std::fs::read_to_string(dir.join("values.csv")).unwrap();
    let value: f64 = told.lines().nth(1).unwrap().rsplit(',').next().unwrap().parse().unwrap();
    assert!(r == g && g == b && (f64::from(r) - grey(value)).abs() < 8.0, "{r} {g} {b}, {value}");
    // Cut at the same plane and seen from there, the inside of the ball has the field's colours.
    let above =
        ["--elevation", "90", "-i", "0", "--clip", "z=:50%", "--colour-map", "grey", "--orthographic"];
    draw("cut.png", &[&above[..], &["--slice", "z=50%", "--colour-range", "-1:1"]].concat());
    let [r, g, b] = pixel(&dir.join("cut.png"), [120, 100]);
    assert!(r == g && g == b && (f64::from(r) - grey(value)).abs() < 8.0, "{r} {g} {b}, {value}");
    // Percentages and world units are places of one domain.
    draw("half.png", &["-i", "0", "--clip", "x=50%:"]);
    draw("world.png", &["-i", "0", "--clip", "x=14.5:"]);
    assert!(bytes("half.png") == bytes("world.png"));
    let told = draw("slab.png", &["-i", "0", "--clip", "x=10:20,y=:14.5", "--json"]);
    let slab: serde_json::Value = serde_json::from_str(&told).unwrap();
    let told = draw("whole.png", &["-i", "0", "--json", "--scale-bar"]);
    let whole: serde_json::Value = serde_json::from_str(&told).unwrap();
    let count = |v: &serde_json::Value| v["panels"][0]["surfaces"][0]["triangles"].as_u64().unwrap();
    assert!(count(&slab) > 10 && count(&slab) < count(&whole) / 2, "{slab} {whole}");
    assert!(png_size(&dir.join("whole.png"))[1] > 200, "a scale bar below");
}

#[test]
fn animations_have_their_frames_and_are_the_same_bytes_again() {
    let dir = balls();
    let dir = dir.path();
    let turn = |name: &str, threads: &str| {
        let usual = ["render", "fine.ply", "--turntable", "5", "--size", "64,48", "--lights", "4"];
        ok(dir, &[&usual[..], &["--fps", "10", "--threads", threads, "-o", name]].concat())
    };
    let bytes = |name: &str| std::fs::read(dir.join(name)).unwrap();
    assert!(turn("one.png", "1").contains("5 frames"));
    for (one, three) in [("one.png", "three.png"), ("one.gif", "three.gif"), ("one.apng", "three.apng")] {
        let _ = std::fs::remove_file(dir.join(one));
        turn(one, "1");
        turn(three, "3");
        assert!(bytes(one) == bytes(three), "{one}");
    }
    let file = std::io::BufReader::new(std::fs::File::open(dir.join("one.png")).unwrap());
    let reader = png::Decoder::new(file).read_info().unwrap();
    assert_eq!(reader.info().animation_control.unwrap().num_frames, 5);
    let one = bytes("one.gif");
    let mut gif = gif::DecodeOptions::new().read_info(&one[..]).unwrap();
    let mut delays = vec![];
    while let Some(frame) = gif.read_next_frame().unwrap() {
        assert_eq!([frame.width, frame.height], [64, 48]);
        delays.push(frame.delay);
    }
    assert_eq!(delays, [10; 5]);

    // A series: panels of a picture, frames of an animation.
    for (n, name) in ["s0.npy", "s1.npy", "s2.npy"].into_iter().enumerate() {
        write_npy(&dir.join(name), [16, 16, 16], |x, y, z| ball(x, y, z) + 0.1 * n as f64);
    }
    ok(dir, &["reduce", "s0.npy", "s1.npy", "s2.npy", "-o", "s.isospan", "--times", "0,0.5,..."]);
    let steps = |name: &str, more: &[&str]| {
        let usual = ["render", "s.isospan", "-i", "0", "--size", "80,60", "--lights", "4", "-o", name];
        ok(dir, &[&usual[..], more].concat())
    };
    assert!(steps("s.png", &["--steps", "1:2"]).contains("step 2"));
    let [width, height] = png_size(&dir.join("s.png"));
    assert!(width == 160 && height > 60, "{width} x {height}");
    assert!(steps("s.gif", &["--all-steps"]).contains("3 frames"));
    assert!(steps("turn.png", &["--all-steps", "--turntable", "2"]).contains("2 frames"));
    assert_eq!(png_size(&dir.join("turn.png"))[0], 240, "a panel for each step");
}
