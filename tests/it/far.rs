//! Coordinates that `f32` does not tell apart: of a map, in metres, say.

use crate::common::*;
use isospan::formats::surface::{SurfaceFormat, read_surface};
use isospan::surface::check::check;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn isospan(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap()
}

/// Standard output of a command that succeeds.
fn ok(dir: &Path, args: &[&str]) -> String {
    let out = isospan(dir, args);
    let error = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success(), "{args:?}: {error}");
    String::from_utf8(out.stdout).unwrap()
}

fn json(dir: &Path, args: &[&str]) -> serde_json::Value {
    serde_json::from_str(&ok(dir, &[args, &["--json"]].concat())).unwrap()
}

/// Eastings, northings and heights of a place on a map.
const UTM: [f64; 3] = [448_262.25, 5_411_932.5, 310.0];

/// A legacy VTK file of 6 x 6 x 6 cubes of a side of 1/8, whose corner is at a place; the field is
/// the distance from a point in them.
fn write_cubes(path: &Path, corner: [f64; 3]) {
    const N: usize = 6;
    let id = |x: usize, y: usize, z: usize| (z * (N + 1) + y) * (N + 1) + x;
    let (mut points, mut values, mut cells) = (String::new(), String::new(), String::new());
    for n in 0..(N + 1) * (N + 1) * (N + 1) {
        let at = [n % (N + 1), n / (N + 1) % (N + 1), n / (N + 1) / (N + 1)];
        let place = at.map(|i| i as f64 / 8.0);
        let [x, y, z] = [0, 1, 2].map(|k| corner[k] + place[k]);
        points += &format!("{x} {y} {z}\n");
        let distance: f64 = place.iter().zip([0.35, 0.4, 0.37]).map(|(p, m)| (p - m).powi(2)).sum();
        values += &format!("{}\n", distance.sqrt());
        if at.iter().all(|&i| i < N) {
            let [x, y, z] = at;
            let face = |z| [(x, y, z), (x + 1, y, z), (x + 1, y + 1, z), (x, y + 1, z)];
            let corners = face(z).into_iter().chain(face(z + 1)).map(|(x, y, z)| id(x, y, z).to_string());
            cells += &format!("8 {}\n", corners.collect::<Vec<_>>().join(" "));
        }
    }
    let (count, points_count) = (N.pow(3), (N + 1).pow(3));
    let types = "12\n".repeat(count);
    let text = format!(
        "# vtk DataFile Version 3.0\ncubes\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {points_count} double\n\
         {points}CELLS {count} {}\n{cells}CELL_TYPES {count}\n{types}POINT_DATA {points_count}\n\
         SCALARS distance double 1\nLOOKUP_TABLE default\n{values}",
        9 * count
    );
    fs::write(path, text).unwrap();
}

#[test]
fn a_surface_on_a_map_has_the_area_that_it_has_at_the_origin() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_cubes(&d.join("near.vtk"), [0.0; 3]);
    write_cubes(&d.join("far.vtk"), UTM);
    for name in ["near", "far"] {
        let (input, out) = (format!("{name}.vtk"), format!("{name}.isospan"));
        ok(d, &["reduce", &input, "-o", &out, "--fraction", "1", "-q"]);
    }
    ok(d, &["surface", "near.isospan", "-i", "0.25", "-o", "near.ply"]);
    let near = check(&read_surface(&d.join("near.ply")).unwrap());
    assert!(near.is_closed() && near.volume.is_some());
    for format in SurfaceFormat::ALL.into_iter().filter(|format| format.is_read()) {
        let file = format!("far.{}", format.extension());
        let text = ok(d, &["surface", "far.isospan", "-i", "0.25", "-o", &file]);
        assert_eq!(text.contains("coordinates   are less 448262.6 5411932.9"), format.shifts(), "{text}");
        // A file that check refuses would fail here.
        let checked = json(d, &["check", &file]);
        assert_eq!(checked["triangles"], near.triangles, "{file}");
        let off = |name: &str, right: f64| (checked[name].as_f64().unwrap() / right - 1.0).abs();
        assert!(off("area", near.area) < 1e-5 && off("volume", near.volume.unwrap()) < 1e-5, "{checked}");
        let [lo, hi] = [0, 1].map(|end| checked["bounding_box"][end][1].as_f64().unwrap());
        let middle = f64::midpoint(lo, hi);
        let right = if format == SurfaceFormat::Stl { -0.0 } else { UTM[1] + 0.4 };
        assert!((middle - right).abs() < 0.1, "{file}: {lo} {hi}");
    }
    let report = json(d, &["surface", "far.isospan", "-i", "0.25", "-o", "far.stl", "--force"]);
    assert_eq!(report["shift"][1], 5_411_932.9);
    let compared = json(d, &["compare", "far.ply", "far.obj"]);
    assert!(compared["hausdorff"].as_f64().unwrap() < 1e-6, "{compared}");
    let at = compared["a_to_b"]["max_at"][1].as_f64().unwrap();
    assert!(at == 0.0 || (at - UTM[1]).abs() < 1.0, "{compared}");
    ok(d, &["render", "far.vtp", "-o", "far.png", "--size", "64x64"]);
}

/// Two tetrahedra as they are: one with sides of 1000, and one so small, at its far end, that
/// `f32` has one number for the corners of a triangle in it.
#[test]
fn triangles_that_f32_leaves_no_area_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let corners = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let tet = |at: f64, side: f64| -> String {
        corners.map(|c| c.map(|x| (at + side * x).to_string()).join(" ") + "\n").concat()
    };
    let text = format!(
        "# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 8 double\n{}{}CELLS 2 10\n\
         4 0 1 2 3\n4 4 5 6 7\nCELL_TYPES 2\n10\n10\nPOINT_DATA 8\nSCALARS a float 1\n\
         LOOKUP_TABLE default\n0 1 1 1 0 1 1 1\n",
        tet(0.0, 1000.0),
        tet(1000.3, 0.0005)
    );
    fs::write(d.join("m.vtk"), text).unwrap();
    ok(d, &["reduce", "m.vtk", "-o", "m.isospan", "--fraction", "1", "-q"]);
    let out = isospan(d, &["surface", "m.isospan", "-i", "0.01", "-o", "m.ply"]);
    let error = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(5), "{error}");
    let line = "m.ply: surface: expected triangles that have an area, got 1 of 2 without";
    assert!(error.contains(line) && error.lines().count() == 1, "{error}");
    let found = check(&read_surface(&d.join("m.ply")).unwrap());
    assert_eq!((found.triangles, found.zero_area_triangles), (2, 1), "the file is there all the same");
    assert_eq!(isospan(d, &["check", "m.ply"]).status.code(), Some(5));
    ok(d, &["surface", "m.isospan", "-i", "0.5", "-o", "m.ply", "--force"]);
}

#[test]
fn a_volume_on_a_map_is_cut_where_the_box_says() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [24, 22, 20], ball);
    let origin = "500000,4100000,0";
    ok(
        d,
        &[
            "reduce",
            "v.npy",
            "-o",
            "v.isospan",
            "--spacing",
            "0.01,0.01,0.01",
            "--origin",
            origin,
            "--points",
            "regular",
            "--fraction",
            "1",
            "-q",
        ],
    );
    ok(
        d,
        &[
            "reduce",
            "v.npy",
            "-o",
            "n.isospan",
            "--spacing",
            "0.01,0.01,0.01",
            "--points",
            "regular",
            "--fraction",
            "1",
            "-q",
        ],
    );
    let cut = |archive: &str, out: &str, roi: &str| {
        ok(d, &["surface", archive, "-i", "0.3", "-o", out, "--roi", roi]);
        json(d, &["check", out, "--within", archive, "--roi", roi])
    };
    let far = cut("v.isospan", "far.vtp", "world:500000.05:500000.12,:4100000.15,:");
    let near = cut("n.isospan", "near.vtp", "world:0.05:0.12,:0.15,:");
    let area = |report: &serde_json::Value| report["area"].as_f64().unwrap();
    assert_eq!(far["triangles"], near["triangles"]);
    assert!((area(&far) / area(&near) - 1.0).abs() < 1e-5, "{far} {near}");
    let ends =
        |report: &serde_json::Value| [0, 1].map(|end| report["bounding_box"][end][0].as_f64().unwrap());
    let (far, near) = (ends(&far), ends(&near));
    for end in [0, 1] {
        assert!((far[end] - 500_000.0 - near[end]).abs() < 1e-6, "{far:?} {near:?}");
    }
    assert!((far[1] - 500_000.12).abs() < 1e-6, "{far:?}");
}

#[test]
fn coordinates_beyond_f32_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("v.npy"), [20, 18, 16], ball);
    for (spacing, says) in
        [("1e38,1e38,1e38", "is no number as f32"), ("1e-40,1e-40,1e-40", "has no shape as f32")]
    {
        ok(
            d,
            &[
                "reduce",
                "v.npy",
                "-o",
                "v.isospan",
                "--spacing",
                spacing,
                "--points",
                "regular",
                "--fraction",
                "1/2",
                "-q",
                "--force",
            ],
        );
        let out = isospan(d, &["surface", "v.isospan", "-i", "0.3", "-o", "v.ply"]);
        let error = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(2), "{spacing}: {error}");
        assert!(error.contains(says) && !d.join("v.ply").exists(), "{spacing}: {error}");
    }
}

#[test]
#[ignore = "wants the folder ISOSPAN_SHARED_DATA"]
fn a_mesh_at_utm_coordinates_has_the_area_that_vtk_finds() {
    let folder = std::env::var("ISOSPAN_SHARED_DATA").unwrap();
    let input = Path::new(&folder).join("turn3/s14_utm.vtu");
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    ok(d, &["reduce", input.to_str().unwrap(), "-o", "m.isospan", "--fraction", "1", "-q"]);
    for file in ["m.ply", "m.vtp", "m.vtkhdf", "m.obj", "m.stl", "m.glb"] {
        ok(d, &["surface", "m.isospan", "-i", "40.2", "-o", file]);
        let area = json(d, &["check", file])["area"].as_f64().unwrap();
        // VTK contours the hexahedra, and this the tetrahedra in them.
        assert!((area / 0.0217 - 1.0).abs() < 0.02, "{file}: {area}");
    }
}
