//! Cells of second order with vertices on their edges alone: they are given those in the middle of
//! their faces, so that thin curved ones do not fold, and neighbours of other kinds agree.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

/// Points of a mesh, each once, and its cells by VTK's types.
#[derive(Default)]
struct Mesh {
    points: Vec<[f64; 3]>,
    known: HashMap<[i64; 3], usize>,
    cells: Vec<(u8, Vec<usize>)>,
}

impl Mesh {
    fn point(&mut self, p: [f64; 3]) -> usize {
        let key = p.map(|x| (x * 1e9).round() as i64);
        let next = self.points.len();
        *self.known.entry(key).or_insert_with(|| {
            self.points.push(p);
            next
        })
    }

    /// Adds a cell, whose vertices lie where `place` says of those of a cell in parameters.
    fn add(&mut self, kind: u8, vertices: &[[f64; 3]], place: impl Fn([f64; 3]) -> [f64; 3]) {
        let numbers = vertices.iter().map(|&p| self.point(place(p))).collect();
        self.cells.push((kind, numbers));
    }

    /// Writes a legacy VTK file with a value for each point.
    fn write(&self, path: &Path, value: impl Fn([f64; 3]) -> f64) {
        let mut text = format!(
            "# vtk DataFile Version 3.0\ncells\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {} double\n",
            self.points.len()
        );
        self.points.iter().for_each(|[x, y, z]| writeln!(text, "{x} {y} {z}").unwrap());
        let numbers: usize = self.cells.iter().map(|(_, of)| of.len() + 1).sum();
        writeln!(text, "CELLS {} {numbers}", self.cells.len()).unwrap();
        for (_, of) in &self.cells {
            let of: Vec<String> = of.iter().map(ToString::to_string).collect();
            writeln!(text, "{} {}", of.len(), of.join(" ")).unwrap();
        }
        writeln!(text, "CELL_TYPES {}", self.cells.len()).unwrap();
        self.cells.iter().for_each(|(kind, _)| writeln!(text, "{kind}").unwrap());
        writeln!(text, "POINT_DATA {}\nSCALARS f double 1\nLOOKUP_TABLE default", self.points.len()).unwrap();
        self.points.iter().for_each(|&p| writeln!(text, "{}", value(p)).unwrap());
        std::fs::write(path, text).unwrap();
    }
}

/// The vertices of a hexahedron of second order, edge by edge as VTK has them.
fn hexahedron() -> Vec<[f64; 3]> {
    let corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]];
    const EDGES: [[usize; 2]; 12] =
        [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
    with_middles(&corners.map(|c| c.map(f64::from)), &EDGES)
}

/// The vertices of a wedge of one unit.
fn wedge() -> Vec<[f64; 3]> {
    with_middles(
        &[
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [0.0, 1.0, 1.0],
        ],
        &[[0, 1], [1, 2], [2, 0], [3, 4], [4, 5], [5, 3], [0, 3], [1, 4], [2, 5]],
    )
}

fn with_middles(corners: &[[f64; 3]], edges: &[[usize; 2]]) -> Vec<[f64; 3]> {
    let middle = |[a, b]: &[usize; 2]| std::array::from_fn(|i| 0.5 * (corners[*a][i] + corners[*b][i]));
    corners.iter().copied().chain(edges.iter().map(middle)).collect()
}

fn ok(dir: &Path, args: &[&str]) -> String {
    let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap();
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

/// Keeps the mesh of `m.vtk`; gives what was found in it.
fn kept(d: &Path) -> serde_json::Value {
    let report = ok(d, &["reduce", "m.vtk", "-o", "m.isospan", "--fraction", "1", "--json", "-q", "--force"]);
    ok(d, &["check", "m.isospan", "-q"]);
    serde_json::from_str::<serde_json::Value>(&report).unwrap()["mesh"].clone()
}

/// The area of a surface of `m.isospan`, which is sound, and the number of its components.
fn area(d: &Path, isovalue: &str) -> (f64, u64) {
    ok(d, &["surface", "m.isospan", "-i", isovalue, "-o", "s.ply", "-q", "--force"]);
    let found = ok(d, &["check", "s.ply", "--json"]);
    let found: serde_json::Value = serde_json::from_str(&found).unwrap();
    (found["area"].as_f64().unwrap(), found["components"].as_u64().unwrap())
}

/// Six cells around a pipe whose wall is thinner than their faces are curved.
#[test]
fn thin_curved_cells_do_not_fold() {
    let dir = tempfile::tempdir().unwrap();
    let (d, mut mesh) = (dir.path(), Mesh::default());
    let (inner, outer, height) = (0.24, 0.25, 0.2);
    for sixth in 0..6 {
        mesh.add(25, &hexahedron(), |[r, along, z]| {
            let (radius, angle) =
                (inner + (outer - inner) * r, (f64::from(sixth) + along) * 60f64.to_radians());
            [radius * angle.cos(), radius * angle.sin(), height * z]
        });
    }
    mesh.write(&d.join("m.vtk"), |p| p[2]);
    assert!(ok(d, &["info", "m.vtk"]).contains("288 tetrahedra"));
    let census = kept(d);
    assert_eq!(census["folded"], serde_json::Value::Null, "{census}");
    for (name, expected) in [("tetrahedra", 288), ("added", 36), ("degenerate", 0), ("bodies", 1)] {
        assert_eq!(census[name], expected, "{name}: {census}");
    }
    // A ring between two polygons of twelve sides.
    let (found, ring) = (area(d, "0.07").0, 3.0 * (outer * outer - inner * inner));
    assert!((found / ring - 1.0).abs() < 1e-4, "{found} {ring}");
    mesh.write(&d.join("m.vtk"), |p| p[0]);
    kept(d);
    // The plane x = 0.1 cuts its sides, which run from an angle of 60 degrees to one of 90.
    let side = |radius: f64| {
        let [a, b] = [60f64, 90.0].map(|angle| angle.to_radians().sin_cos());
        let t = (0.1 - radius * b.1) / (radius * a.1 - radius * b.1);
        radius * (b.0 + t * (a.0 - b.0))
    };
    let (found, components) = area(d, "0.1");
    let expected = 2.0 * height * (side(outer) - side(inner));
    assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
    assert_eq!(components, 2);
}

/// A hexahedron, a wedge beside it and a pyramid on it, which share faces; a hexahedron that is
/// collapsed to a wedge beside that.
#[test]
fn neighbours_of_other_kinds_have_the_same_middles() {
    let pyramid = with_middles(
        &[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 1.0], [0.5, 0.5, 2.0]],
        &[[0, 1], [1, 2], [2, 3], [3, 0], [0, 4], [1, 4], [2, 4], [3, 4]],
    );
    let dir = tempfile::tempdir().unwrap();
    let (d, mut mesh) = (dir.path(), Mesh::default());
    mesh.add(25, &hexahedron(), |p| p);
    mesh.add(26, &wedge(), |[x, y, z]| [1.0 + x, y, z]);
    mesh.add(27, &pyramid, |p| p);
    // Its face x = 1 is an edge.
    mesh.add(25, &hexahedron(), |[x, y, z]| [-x, (1.0 - x) * y + x, z]);
    let field = |p: [f64; 3]| p[0] + 0.25 * p[1] + 2.0 * p[2];
    mesh.write(&d.join("m.vtk"), field);
    let census = kept(d);
    // Of the collapsed face nothing is added: the second hexahedron has three faces of its own, two
    // triangles among them, and a centre.
    for (name, expected) in [("added", 7 + 2 + 5), ("bodies", 1), ("cells", 4)] {
        assert_eq!(census[name], expected, "{name}: {census}");
    }
    // A plane, cut by the mesh, whose outline it has.
    for isovalue in ["0.9", "1.7", "2.6"] {
        let (found, components) = area(d, isovalue);
        assert!(found > 0.2 && components == 1, "{found} {components}");
    }
}

/// Cells whose faces are edges add nothing; values that would be infinite in a middle are finite.
#[test]
fn collapsed_cells_and_large_values_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let (d, mut mesh) = (dir.path(), Mesh::default());
    let tetrahedron = with_middles(
        &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        &[[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]],
    );
    mesh.add(24, &tetrahedron, |p| p);
    mesh.add(26, &wedge(), |[x, y, _]| [x, y, 0.0]);
    mesh.write(&d.join("m.vtk"), |p| p[2]);
    let census = kept(d);
    assert_eq!((&census["added"], &census["tetrahedra"]), (&0.into(), &8.into()), "{census}");
    let mut mesh = Mesh::default();
    mesh.add(25, &hexahedron(), |p| p);
    mesh.write(&d.join("m.vtk"), |p| if p.contains(&0.5) { 3e38 } else { -3e38 });
    kept(d);
    assert!(area(d, "1e38").0 > 0.1);
}

/// A face whose middle lies higher than all points of the file.
#[test]
fn middles_beyond_all_points_are_within_the_domain() {
    let dir = tempfile::tempdir().unwrap();
    let (d, mut mesh) = (dir.path(), Mesh::default());
    let bump = |x: f64, y: f64| 0.5 * (x * (1.0 - x) + y * (1.0 - y));
    mesh.add(25, &hexahedron(), |[x, y, z]| [x, y, z * (1.0 + bump(x, y))]);
    mesh.write(&d.join("m.vtk"), |p| p[2]);
    assert_eq!(kept(d)["added"], 7);
    // Vertices on edges are at most at 1.125, the middle of the face is at 1.25.
    let info: serde_json::Value = serde_json::from_str(&ok(d, &["info", "m.isospan", "--json"])).unwrap();
    let top = info["range"][1].as_f64().unwrap();
    assert!((top - 1.25).abs() < 1e-6, "{top}");
    let (found, components) = area(d, "1.2");
    // A pyramid over the middle: its sides run to 1.125 half a unit away.
    let half = 0.5 * (1.25 - 1.2) / 0.125;
    assert!((found / (2.0 * half * half) - 1.0).abs() < 1e-3 && components == 1, "{found}");
}

/// A pipe of libMesh, contoured as VTK contours it: areas and components of its surfaces (VTK 9.7,
/// `vtkContourFilter` of both blocks, points of one place joined).
#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn a_pipe_of_another_program_has_the_surfaces_of_vtk() {
    let shared = std::env::var("ISOSPAN_SHARED_DATA").expect("it names the folder");
    let file = Path::new(&shared).join("turn3/hex20_pipe.e");
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for (field, isovalue, expected, pieces) in [
        ("x", "0.1", 0.008_000_028, 2),
        ("y", "0.05", 0.008_000_016, 2),
        ("z", "0.1", 0.014_700_045, 1),
        ("x", "-0.21", 0.015_635_890, 2),
    ] {
        let file = file.to_str().unwrap();
        let args = ["reduce", file, "--field", field, "-o", "m.isospan", "--fraction", "1", "-q", "--force"];
        ok(d, &args);
        let (found, components) = area(d, isovalue);
        assert!((found / expected - 1.0).abs() < 1e-5 && components == pieces, "{field} {isovalue}: {found}");
    }
}
