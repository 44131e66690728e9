//! Surfaces coloured by another field: values at the vertices, the same bytes however made.

use crate::common::*;
use isospan::pipeline::{ReduceSettings, StepChoice};
use isospan::render::ColourMap;
use isospan::sample::Values;
use isospan::{Archive, Resources};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

const DIMS: [usize; 3] = [20, 18, 16];

/// A name, and the value at a sample's place.
type Field<'a> = (&'a str, &'a dyn Fn([f64; 3]) -> f64);

/// A file with some fields.
fn write_fields(path: &Path, fields: &[Field<'_>]) {
    let [nx, ny, nz] = DIMS;
    let mut text = format!(
        "# vtk DataFile Version 3.0\ntwo\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS {nx} {ny} {nz}\n\
         ORIGIN 0 0 0\nSPACING 1 1 1\nPOINT_DATA {}\n",
        nx * ny * nz
    );
    for (name, value) in fields {
        let _ = writeln!(text, "SCALARS {name} float 1\nLOOKUP_TABLE default");
        for n in 0..nx * ny * nz {
            let at = [n % nx, n / nx % ny, n / (nx * ny)].map(|i| i as f64);
            let _ = writeln!(text, "{:.6}", value(at));
        }
    }
    fs::write(path, text).unwrap();
}

/// A file with two fields: a ball, and a linear field, 2x + y.
fn write_two_fields(path: &Path) {
    let ball = |p: [f64; 3]| {
        let [a, b, c] = [p[0] - 9.5, p[1] - 8.5, p[2] - 7.5];
        6.0 - (a * a + b * b + c * c).sqrt()
    };
    write_fields(path, &[("ball", &ball), ("heat", &|p| 2.0 * p[0] + p[1])]);
}

fn isospan(dir: &Path, args: &[&str]) -> String {
    let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap();
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

/// The vertices of a binary PLY: position, value, colour.
fn vertices(bytes: &[u8]) -> Vec<([f32; 3], f32, [u8; 3])> {
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = String::from_utf8_lossy(&bytes[..end]);
    assert!(header.contains("property float nz\nproperty float heat\nproperty uchar red\n"), "{header}");
    let count = header.lines().find_map(|l| l.strip_prefix("element vertex ")).unwrap();
    let record = |r: &[u8]| {
        let float = |at: usize| f32::from_le_bytes(r[4 * at..4 * at + 4].try_into().unwrap());
        ([0, 1, 2].map(float), float(6), [r[28], r[29], r[30]])
    };
    bytes[end..].chunks(31).take(count.parse().unwrap()).map(record).collect()
}

#[test]
fn two_fields_of_one_file() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_two_fields(&d.join("two.vtk"));
    let exact = ["--values", "sample", "--points", "regular", "--fraction", "1/2"];
    isospan(d, &[&["reduce", "two.vtk", "-o", "two.isospan", "--fields", "ball,heat"], &exact[..]].concat());
    let info = isospan(d, &["info", "two.isospan"]);
    assert!(info.contains("ball") && info.contains("heat"), "{info}");
    let heat = isospan(d, &["count", "two.isospan", "--step", "heat", "--isovalue", "20"]);
    assert!(heat != isospan(d, &["count", "two.isospan", "--step", "ball", "--isovalue", "1"]));
    let make = |out: &str, more: &[&str]| {
        let what = ["surface", "two.isospan", "--step", "ball", "-i", "1", "--colour-by", "heat", "-o", out];
        isospan(d, &[&what[..], more].concat());
        fs::read(d.join(out)).unwrap()
    };
    let bytes = make("ball.ply", &["--colour-range", "10:40", "--colour-map", "coolwarm"]);
    let found = vertices(&bytes);
    assert!(found.len() > 200);
    for &(p, value, colour) in &found {
        assert!((value - (2.0 * p[0] + p[1])).abs() < 1e-3, "{p:?}: {value}");
        assert_eq!(colour, ColourMap::Coolwarm.colour((f64::from(value) - 10.0) / 30.0));
    }
    // The surface is that without colours, and threads do not show.
    isospan(d, &["surface", "two.isospan", "--step", "ball", "-i", "1", "-o", "plain.ply"]);
    let [plain, coloured] = ["plain.ply", "ball.ply"].map(|name| read(&d.join(name)));
    assert_eq!(plain, coloured);
    let one = make("one.ply", &["--colour-range", "10:40", "--colour-map", "coolwarm", "--threads", "1"]);
    assert!(one == bytes);
    // The other formats hold the same surface.
    for name in ["ball.vtp", "ball.vtkhdf", "ball.glb", "ball.obj"] {
        let bytes = make(name, &[]);
        assert_eq!(read(&d.join(name)).triangles.len(), plain.triangles.len(), "{name}");
        let text = String::from_utf8_lossy(&bytes);
        let wanted = match name {
            "ball.vtp" => "<PointData Scalars=\"heat\" Normals=\"Normals\">",
            "ball.vtkhdf" => "Attribute\0",
            "ball.glb" => "\"COLOR_0\":2",
            _ => "# colours viridis of heat, 0 to 55",
        };
        assert!(text.contains(wanted), "{name}: {}", &text[..1000.min(text.len())]);
    }
    let stl = ["surface", "two.isospan", "-i", "1", "--colour-by", "heat", "-o", "ball.stl"];
    let refused = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(d).args(stl).output().unwrap();
    assert!(!refused.status.success() && !d.join("ball.stl").exists());
    let unknown = ["surface", "two.isospan", "-i", "1", "--colour-by", "cold", "-o", "cold.ply"];
    let refused = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(d).args(unknown).output().unwrap();
    assert!(String::from_utf8_lossy(&refused.stderr).contains("it has ball, heat"));
}

/// A PNG's width, and its pixels, RGB.
fn pixels(path: &Path) -> (usize, Vec<[u8; 3]>) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(fs::read(path).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut bytes).unwrap();
    assert_eq!(frame.color_type, png::ColorType::Rgb);
    (frame.width as usize, bytes.as_chunks().0.to_vec())
}

#[test]
fn pictures_show_another_field() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_two_fields(&d.join("two.vtk"));
    isospan(
        d,
        &[
            "reduce",
            "two.vtk",
            "-o",
            "two.isospan",
            "--fields",
            "ball,heat",
            "--points",
            "regular",
            "--fraction",
            "1/2",
        ],
    );
    let view = ["--size", "120,120", "--lights", "0", "--azimuth", "0", "--elevation", "0", "--orthographic"];
    let render = |out: &str, more: &[&str]| {
        let what = ["render", "two.isospan", "--step", "ball", "-i", "1", "-o", out];
        isospan(d, &[&what[..], &view, more].concat())
    };
    let said = render("heat.png", &["--colour-by", "heat", "--colour-range", "20:30"]);
    assert!(said.contains("triangles") && !said.contains("without a value"), "{said}");
    // Heat rises across the ball: from violet to blue and on, which has more green.
    let (width, heat) = pixels(&d.join("heat.png"));
    let row = &heat[60 * width..][..120];
    let solid: Vec<&[u8; 3]> = row.iter().filter(|&&p| p != [255; 3]).collect();
    let (first, last) = (solid[solid.len() / 8], solid[solid.len() * 7 / 8]);
    assert!(first[1].abs_diff(last[1]) > 40, "{first:?} {last:?}");
    // A scale below the panel, of the field's name; planes show the same field.
    assert!(heat.len() / width > 120 + 30, "{} rows", heat.len() / width);
    render("cut.png", &["--colour-by", "heat", "--slice", "z=50%"]);
    render("plain.png", &["--slice", "z=50%"]);
    assert!(pixels(&d.join("cut.png")).1 != pixels(&d.join("plain.png")).1);
    let json = render("json.png", &["--colour-by", "heat", "--json"]);
    assert!(json.contains("\"without_value\":0") && json.contains("\"range\""), "{json}");
    // What cannot be had is refused, and nothing is left.
    for (more, words) in [
        (&["--colour-by", "cold"][..], "it has ball, heat"),
        (&["--colour-by", "heat", "--colour", "#ff0000"], "cannot be used with"),
        (&["--colour-range", "1:2"], "--colour-range is for --slice and --colour-by"),
    ] {
        let what = ["render", "two.isospan", "--step", "ball", "-i", "1", "-o", "no.png"];
        let args = [&what[..], more].concat();
        let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(d).args(&args).output().unwrap();
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(2) && said.contains(words), "{args:?}: {said}");
        assert!(!d.join("no.png").exists());
    }
}

#[test]
fn a_field_elsewhere_is_refused_and_missing_values_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_two_fields(&d.join("two.vtk"));
    let text = fs::read_to_string(d.join("two.vtk")).unwrap();
    for (name, origin) in [("far", "ORIGIN 500 0 0"), ("near", "ORIGIN 10 0 0")] {
        fs::write(d.join(format!("{name}.vtk")), text.replace("ORIGIN 0 0 0", origin)).unwrap();
    }
    for (input, field) in [("two", "ball"), ("far", "heat"), ("near", "heat")] {
        let (file, out) = (format!("{input}.vtk"), format!("{input}.isospan"));
        isospan(
            d,
            &["reduce", &file, "-o", &out, "--field", field, "--points", "regular", "--fraction", "1/2"],
        );
    }
    for command in [
        &["surface", "two.isospan", "-i", "1", "--colour-by", "far.isospan", "-o", "far.ply"][..],
        &["render", "two.isospan", "-i", "1", "--colour-by", "far.isospan", "-o", "far.png"],
    ] {
        let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(d).args(command).output().unwrap();
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(said.contains("heat has no value at any vertex of the surface"), "{said}");
        assert!(out.status.code() == Some(2) && !d.join(command[7]).exists());
    }
    let said =
        isospan(d, &["surface", "two.isospan", "-i", "1", "--colour-by", "near.isospan", "-o", "a.ply"]);
    let count = vertices(&fs::read(d.join("a.ply")).unwrap()).iter().filter(|v| v.1.is_nan()).count();
    assert!(count > 0 && said.contains(&format!("colours       {count} of ")), "{count}: {said}");
    let small = ["--size", "60,60", "--lights", "0"];
    let what = ["render", "two.isospan", "-i", "1", "--colour-by", "near.isospan", "-o", "a.png"];
    let said = isospan(d, &[&what[..], &small].concat());
    assert!(said.contains(&format!(", {count} of ")) && said.contains("vertices without a value"), "{said}");
}

/// Two cubes that overlap, of six tetrahedra each; two fields.
fn write_overlapping(path: &Path) {
    let corner = |n: usize, lo: f64, side: f64| [0, 1, 2].map(|a| lo + side * (n >> a & 1) as f64);
    let points: Vec<[f64; 3]> =
        (0..8).map(|n| corner(n, 0.0, 2.0)).chain((0..8).map(|n| corner(n, -0.5, 2.0))).collect();
    let tets = [[0, 1, 3, 7], [0, 1, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 4, 6, 7]];
    let mut text =
        "# vtk DataFile Version 3.0\ntwo\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 16 float\n".to_owned();
    points.iter().for_each(|[x, y, z]| _ = writeln!(text, "{x} {y} {z}"));
    text += "CELLS 12 60\n";
    for first in [0, 8] {
        tets.iter().for_each(|t| _ = writeln!(text, "4 {}", t.map(|v| (v + first).to_string()).join(" ")));
    }
    text += &format!("CELL_TYPES 12\n{}POINT_DATA 16\n", "10\n".repeat(12));
    // The second cube has no surface of x = 1.
    text += "SCALARS x float 1\nLOOKUP_TABLE default\n";
    points.iter().enumerate().for_each(|(n, p)| _ = writeln!(text, "{}", if n < 8 { p[0] } else { 0.25 }));
    text += "SCALARS heat float 1\nLOOKUP_TABLE default\n";
    (0..16).for_each(|n| _ = writeln!(text, "{}", if n < 8 { 7 } else { -1 }));
    fs::write(path, text).unwrap();
}

#[test]
fn where_bodies_overlap_a_vertex_has_the_colour_of_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_overlapping(&d.join("two.vtk"));
    isospan(d, &["reduce", "two.vtk", "-o", "two.isospan", "--fields", "x,heat", "--fraction", "1"]);
    isospan(d, &["surface", "two.isospan", "--step", "x", "-i", "1", "--colour-by", "heat", "-o", "x.ply"]);
    let found = vertices(&fs::read(d.join("x.ply")).unwrap());
    // One of them lies within both cubes.
    assert!(found.len() > 6 && found.iter().any(|(p, ..)| p.iter().all(|c| (c - 1.0).abs() < 1e-3)));
    assert!(found.iter().all(|&(_, heat, _)| heat == 7.0), "{found:?}");
}

#[test]
fn another_archive_in_little_memory() {
    let dir = tempfile::tempdir().unwrap();
    let [ball_file, slope_file] = ["ball.npy", "slope.npy"].map(|n| dir.path().join(n));
    write_npy(&ball_file, [40, 36, 32], ball);
    write_npy(&slope_file, [40, 36, 32], |x, y, z| x + 2.0 * y - z);
    let exact = ReduceSettings {
        values: Some(Values::Sample),
        value_bits: None,
        ..settings(isospan::points::SetKind::Halton, isospan::pipeline::Amount::Fraction(0.5), 4_000)
    };
    let [ball_out, slope_out] = [&ball_file, &slope_file].map(|f| f.with_extension("isospan"));
    reduce(&ball_file, &exact, &ball_out, 2);
    reduce(&slope_file, &exact, &slope_out, 2);
    let mut files = vec![];
    for memory in [64 << 20, 4 << 30] {
        let archive = Archive::open(&ball_out).unwrap();
        let by = Archive::open(&slope_out).unwrap().at(StepChoice::First).unwrap();
        let query = archive.query([0.1, -0.05]).colour_by(by.colours(ColourMap::Grey));
        let out = dir.path().join(format!("{memory}.vtp"));
        query.resources(Resources::default().with_memory(memory)).write(&out).unwrap();
        files.push(fs::read(out).unwrap());
    }
    assert!(files[0] == files[1]);
}

#[test]
fn a_field_that_is_void_at_a_surface_is_grey_there() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    // The second field has values where x is large, far from the plane.
    let far = |p: [f64; 3]| if p[0] > 12.0 { p[0] } else { -1.0 };
    write_fields(&d.join("two.vtk"), &[("plane", &|p| p[0]), ("far", &far)]);
    let reduce = [
        "reduce",
        "two.vtk",
        "-o",
        "two.isospan",
        "--fields",
        "plane,far",
        "--points",
        "regular",
        "--fraction",
        "1/2",
    ];
    isospan(d, &[&reduce[..], &["--nan", "mask", "--missing=-1"]].concat());
    let said = isospan(
        d,
        &["surface", "two.isospan", "--step", "plane", "-i", "4.5", "--colour-by", "far", "-o", "a.ply"],
    );
    let count = read(&d.join("a.ply")).vertices.len();
    assert!(count > 100 && said.contains(&format!("colours       {count} of {count} vertices")), "{said}");
}
