use super::*;
use crate::formats::mesh::tests::{Whole, read_whole, torture_with};
use crate::formats::open_mesh;
use crate::formats::tests::write;

const NODES: &str = "# a comment\n5 3 2 1\n1  0 0 0  0.5 7 0\n2 1 0 0  1.5 8 1 # another\n\n3 0 1 0 2.5 9 0\n\
    4  0 0 1e0  3.5 9 0\r\n5 0 0 -1 4.5 9 0\n# the end";
const CELLS: &str = "2 4 1\n1 1 2 3 4 10\n2 1 3 2 5 20\n";

fn open(nodes: &str, cells: &str, names: [&str; 2], field: Option<&str>) -> Result<CellMesh> {
    let dir = tempfile::tempdir().unwrap();
    write(&dir, names[1], cells.as_bytes());
    let options = OpenOptions { field: field.map(str::to_string), ..OpenOptions::default() };
    open_mesh(&write(&dir, names[0], nodes.as_bytes()), &options)
}

const NAMES: [&str; 2] = ["a.node", "a.ele"];

fn cells(of: &Whole) -> Vec<Vec<u64>> {
    of.cells.iter().map(|(_, v)| v.clone()).collect()
}

#[test]
fn tetgen_pairs_are_read() {
    let mesh = open(NODES, CELLS, NAMES, Some("attribute1")).unwrap();
    let whole = read_whole(&mesh).unwrap();
    assert_eq!(whole.points[3..], [[0., 0., 1.], [0., 0., -1.]]);
    assert_eq!(cells(&whole), [[0, 1, 2, 3], [0, 2, 1, 4]]);
    assert_eq!(whole.values, [0.5, 1.5, 2.5, 3.5, 4.5]);
    let regions = read_whole(&mesh.with_field("region").unwrap()).unwrap().values;
    assert_eq!(regions, [15., 15., 15., 10., 20.]);
    let zero = "3 3\n0 0 0 0\n1 1 0 0\n2 0 1 0\n";
    assert_eq!(read_whole(&open(zero, "0 4 0\n", NAMES, None).unwrap()).unwrap().points.len(), 3);
}

#[test]
fn second_order_cells_have_the_middles_of_their_edges() {
    let corners = [[0.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]];
    // TetGen's order of the edges.
    let edges = [[2, 3], [0, 3], [0, 1], [1, 2], [1, 3], [0, 2]];
    let middle =
        |[a, b]: [usize; 2]| -> [f64; 3] { std::array::from_fn(|k| (corners[a][k] + corners[b][k]) / 2.0) };
    let mut nodes = String::from("10 3\n");
    for (i, p) in corners.into_iter().chain(edges.map(middle)).enumerate() {
        nodes += &format!("{i} {} {} {}\n", p[0], p[1], p[2]);
    }
    let mesh = open(&nodes, "1 10 1\n0 0 1 2 3 4 5 6 7 8 9 77\n", NAMES, Some("region")).unwrap();
    let whole = read_whole(&mesh).unwrap();
    assert_eq!(whole.cells[0].0, CellKind::QuadraticTetrahedron);
    assert!(whole.values.iter().all(|&v| v == 77.0));
    // VTK's order of the edges.
    for (edge, &v) in [[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]].into_iter().zip(&whole.cells[0].1[4..])
    {
        assert_eq!(whole.points[v as usize], middle(edge), "{edge:?}");
    }
    let error = open(&nodes, "1 5\n0 0 1 2 3 4\n", NAMES, None).err().unwrap();
    assert!(error.to_string().contains("cells of 4 or 10 vertices"), "{error}");
}

#[test]
fn bare_pairs_are_read_from_either_base() {
    let points = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n";
    for (tets, counted) in [("1 2 3 4\n", 1), ("0 1 2 3\n", 0)] {
        let mesh = open(points, tets, ["a.pts", "a.tet"], Some("z")).unwrap();
        assert!(mesh.info().format.ends_with(&format!("counted from {counted}")));
        let whole = read_whole(&mesh).unwrap();
        assert_eq!((cells(&whole), whole.values[3]), (vec![vec![0, 1, 2, 3]], 1.0));
    }
    let counted = format!("4\n{points}");
    assert_eq!(open(&counted, "1\n1 2 3 4\n", ["a.pts", "a.tet"], None).unwrap().info().points, 4);
    let error = open("5\n0 0 0\n", "1 1 1 1\n", ["a.pts", "a.tet"], None).err().unwrap();
    assert!(error.to_string().contains("expected 1 rows, got 5"), "{error}");
}

#[test]
fn a_file_of_values_is_a_field() {
    let dir = tempfile::tempdir().unwrap();
    write(&dir, "a.ele", CELLS.as_bytes());
    let nodes = write(&dir, "a.node", NODES.as_bytes());
    let open = |values: &str| {
        let options = OpenOptions {
            values: Some(write(&dir, "potential.txt", values.as_bytes())),
            ..OpenOptions::default()
        };
        open_mesh(&nodes, &options).and_then(|m| Ok((m.field()?.name.clone(), read_whole(&m)?.values)))
    };
    assert_eq!(open("1\n2\n3\n4\nnan\n").unwrap().1[..4], [1., 2., 3., 4.]);
    assert_eq!(open("1\n2\n3\n4\n5\n").unwrap().0, "potential");
    for bad in ["1\n2\n3\n4\n", "1\n2\n3\n4\n5\n6\n", "1\n2\nx\n4\n5\n", "1 2\n3\n4\n5\n6\n"] {
        assert_eq!(open(bad).unwrap_err().exit_code(), 5, "{bad}");
    }
}

#[test]
fn what_is_wrong_is_told_by_its_line() {
    for (old, new, reason) in [
        ("5 3 2 1", "5 2 2 1", "2 dimensions"),
        ("5 3 2 1", "6 3 2 1", "the end of the file after 5 rows"),
        ("5 3 2 1", "4 3 2 1", "more: 5 0 0 -1"),
        ("5 3 2 1", "99999999 3 2 1", "fewer rows than bytes"),
        ("5 3 2 1", "points", "a.node: line 2: expected points"),
        ("\n3 0 1", "\n4 0 1", "line 6: expected row 3 with its 6 numbers, got 4 0 1 0"),
        ("1.5 8 1 #", "1.5 8 #", "row 2 with its 6 numbers"),
        ("1e0", "inf", "finite"),
        ("\n1  0", "\n2  0", "the first point, numbered 0 or 1"),
    ] {
        assert!(NODES.contains(old));
        let outcome = open(&NODES.replacen(old, new, 1), CELLS, NAMES, None).and_then(|m| read_whole(&m));
        let line = outcome.expect_err(new).to_string();
        assert!(line.contains(reason), "{line}");
    }
    for (cells, reason) in [
        ("2 10 1\n1 1 2 3 4 10\n", "row 1 with its 11 numbers"),
        ("1 4 0\n1 1 2 3 6\n", "cell 0 (counted from 0): expected vertices among 5 points, got point 5"),
        ("1 4 0\n1 0 2 3 4\n", "cell 1: expected vertices counted from 1, as points are, got vertex 0"),
        ("1 4 0\n1 -1 2 3 4\n", "row 1 with its 4 numbers"),
        ("1 4 0\n1 1.5 2 3 4\n", "row 1 with its 4 numbers"),
    ] {
        let outcome = open(NODES, cells, NAMES, None).and_then(|m| read_whole(&m));
        let line = outcome.expect_err(cells).to_string();
        assert!(line.contains(reason), "{line}");
    }
    let dir = tempfile::tempdir().unwrap();
    let alone = write(&dir, "a.ele", CELLS.as_bytes());
    assert!(open_mesh(&alone, &OpenOptions::default()).err().unwrap().to_string().contains("a.node"));
}

#[test]
fn damage_is_survived() {
    torture_with("a.node", NODES.as_bytes(), &[("a.ele", CELLS.as_bytes())]);
    torture_with("a.ele", CELLS.as_bytes(), &[("a.node", NODES.as_bytes())]);
    torture_with("a.tet", b"1 2 3 4\n", &[("a.pts", b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n")]);
}
