use crate::cells::{CellKind, CellMesh, Center, Orientation, orient, split};
use crate::error::Result;
use crate::formats::mesh::tests::{Whole, read_whole, torture};
use crate::formats::tests::write;
use crate::formats::{OpenOptions, open_mesh};
use std::path::Path;

/// Written by Gmsh 4: a box of 1 x 2 x 3 in tetrahedra; unit cubes in second-order hexahedra and
/// prisms. Each has f = x + 10 y + 100 z and the vectors (x, y, z) on nodes, and numbers 0, 1, 2, …
/// on elements with a volume.
fn fixture(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/gmsh");
    std::fs::read(folder.join(format!("{name}.msh"))).unwrap()
}

fn open(bytes: &[u8], field: &str) -> Result<CellMesh> {
    let dir = tempfile::tempdir().unwrap();
    let options = OpenOptions { field: Some(field.into()), ..OpenOptions::default() };
    open_mesh(&write(&dir, "a.msh", bytes), &options)
}

/// Six times the volume, all tetrahedra being positive.
fn volume(whole: &Whole) -> f64 {
    let (mut tets, mut sum) = (vec![], 0.0);
    for (kind, vertices) in &whole.cells {
        split(*kind, vertices, &mut tets);
    }
    for tet in tets {
        let p = tet.map(|v| whole.points[v as usize]);
        assert_eq!(orient(p), Orientation::Positive);
        let d: [glam::DVec3; 4] = p.map(glam::DVec3::from_array);
        sum += (d[1] - d[0]).cross(d[2] - d[0]).dot(d[3] - d[0]);
    }
    sum
}

#[test]
fn files_of_gmsh_are_read() {
    for (name, kind, six_volumes) in [
        ("tet_22_ascii", CellKind::Tetrahedron, 36.0),
        ("tet_22_bin", CellKind::Tetrahedron, 36.0),
        ("tet_41_ascii", CellKind::Tetrahedron, 36.0),
        ("tet_41_bin", CellKind::Tetrahedron, 36.0),
        ("hex_22_bin", CellKind::TriquadraticHexahedron, 6.0),
        ("hex_41_ascii", CellKind::TriquadraticHexahedron, 6.0),
        ("wedge_22_bin", CellKind::BiquadraticWedge, 6.0),
        ("wedge_41_ascii", CellKind::BiquadraticWedge, 6.0),
    ] {
        let mesh = open(&fixture(name), "f").unwrap_or_else(|e| panic!("{name}: {e}"));
        let fields: Vec<_> =
            mesh.info().fields.iter().map(|f| (&f.name[..], f.components, f.center)).collect();
        assert_eq!(fields, [("f", 1, Center::Point), ("disp", 3, Center::Point), ("c", 1, Center::Cell)]);
        let whole = read_whole(&mesh).unwrap_or_else(|e| panic!("{name}: {e}"));
        let solid: Vec<_> = whole.cells.iter().filter(|c| c.0 != CellKind::Flat).collect();
        assert!(!solid.is_empty() && solid.iter().all(|c| c.0 == kind), "{name}");
        assert!(solid.len() < whole.cells.len(), "{name}: the boundary is there too");
        assert!((volume(&whole) - six_volumes).abs() < 1e-9, "{name}");
        for (p, v) in whole.points.iter().zip(&whole.values) {
            assert!((p[0] + 10.0 * p[1] + 100.0 * p[2] - f64::from(*v)).abs() < 1e-4, "{name}");
        }
        let z = read_whole(&mesh.with_field("disp.z").unwrap()).unwrap();
        assert!(z.points.iter().zip(&z.values).all(|(p, v)| (p[2] - f64::from(*v)).abs() < 1e-6), "{name}");
        let c = read_whole(&mesh.with_field("c").unwrap()).unwrap().values;
        assert!(c.iter().all(|v| *v >= 0.0 && *v < solid.len() as f32), "{name}");
    }
}

const SPARSE: &str = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Comments\nany text $Nodes\n$EndComments\n\
    $Nodes\n5\n7 0 0 0\n3 1 0 0\n4 0 1 0\n100 0 0 1\n50 9 9 9\n$EndNodes\n\
    $Elements\n2\n1 15 2 0 1 7\n9 4 3 1 2 3 7 3 4 100\n$EndElements\n\
    $NodeData\n1\n\"p q\"\n1\n0.5\n3\n0\n1\n4\n100 1\n4 2\n3 3\n7 4\n$EndNodeData\n\
    $NodeData\n1\n\"p q\"\n1\n1.5\n3\n1\n1\n1\n3 8\n$EndNodeData\n";

#[test]
fn tags_have_gaps_and_data_any_order() {
    let mesh = open(SPARSE.as_bytes(), "p q").unwrap();
    let whole = read_whole(&mesh).unwrap();
    assert_eq!(whole.cells[1], (CellKind::Tetrahedron, vec![0, 1, 2, 3]));
    assert_eq!(whole.values[..4], [4.0, 3.0, 2.0, 1.0]);
    assert!(whole.values[4].is_nan(), "a node without a value");
    let later = read_whole(&mesh.with_field("p q@1").unwrap()).unwrap().values;
    assert!(later[1] == 8.0 && later[0].is_nan());
}

#[test]
fn what_is_wrong_is_told() {
    for (old, new, reason) in [
        ("2.2 0 8", "4.0 0 8", "expected version 2.2 or 4.1, got version 4.0"),
        ("3 7 3 4 100", "3 7 3 5 100", "line 18: expected the tag of a node, got 5"),
        ("\n3 1 0 0", "\n7 1 0 0", "7 twice"),
        ("9 4 3", "9 29 3", "element type 29 (tetrahedron of third order"),
        ("9 4 3", "9 77 3", "element type 77"),
        ("$Nodes\n5", "$Nodes\n6", "line 14"),
        ("$Nodes\n5", "$Nodes\n4", "expected $EndNodes, got '50'"),
        ("$Nodes\n5", "$Nodes\n18446744073709551615", "fewer than the"),
        ("$Elements\n2", "$Elements\n1", "expected $EndElements"),
        ("$EndComments", "$EndComment", "expected $EndComments, got the end of the file"),
        ("\n4 0 1 0", "\n4 0 nan 0", "finite coordinates"),
        ("\n4 0 1 0", "\n4 0 x 0", "line 11: expected a number, got 'x'"),
        ("\n0\n1\n4\n", "\n0\n0\n4\n", "1 to 1024 components"),
        ("$Elements", "$Elephants", "expected $EndElephants"),
    ] {
        assert!(SPARSE.contains(old), "{old}");
        let outcome = open(SPARSE.replacen(old, new, 1).as_bytes(), "x").and_then(|m| read_whole(&m));
        let line = outcome.expect_err(new).to_string();
        assert!(line.contains(reason), "{line}");
    }
}

#[test]
fn damage_is_survived() {
    torture("a.msh", SPARSE.as_bytes());
    torture("a.msh", &fixture("tet_41_bin")[..1400]);
}
