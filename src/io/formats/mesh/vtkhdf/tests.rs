use super::*;
use crate::cells::CellMesh;
use crate::formats::mesh::tests::{read_whole, torture};
use crate::formats::shared::hdf5_head::{Data, Dataset, Group, Value};
use crate::formats::tests::is_mesh;
use crate::formats::vtk::hdf;
use crate::formats::{OpenOptions, open_mesh};
use crate::volume::ScalarType;
use std::path::{Path, PathBuf};

/// Two pieces: a tetrahedron; a triangle and a pyramid. h5py wrote it.
fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/vtkhdf_mesh.hdf")
}

fn with_field(field: &str) -> OpenOptions {
    OpenOptions { field: Some(field.into()), ..OpenOptions::default() }
}

#[test]
fn pieces_are_read_one_after_another() {
    assert!(is_mesh(&golden(), &OpenOptions::default()).unwrap());
    let mesh = open_mesh(&golden(), &OpenOptions::default()).unwrap();
    // The active one of three; text is no field.
    assert_eq!(mesh.field().unwrap().name, "heat");
    let names: Vec<&str> = mesh.info().fields.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names, ["flow", "heat", "mass"]);
    let whole = read_whole(&mesh).unwrap();
    let cells = [
        (CellKind::Tetrahedron, vec![0, 1, 2, 3]),
        (CellKind::Flat, vec![]),
        (CellKind::Pyramid, vec![4, 5, 6, 7, 8]),
    ];
    assert_eq!(whole.cells, cells);
    assert_eq!(whole.points[3..5], [[0.0, 0.0, 1.0], [2.0, 0.0, 0.0]]);
    assert_eq!(whole.values, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    let flow = open_mesh(&golden(), &with_field("flow.y")).unwrap();
    assert_eq!(read_whole(&flow).unwrap().values[2], 7.0);
    let mass = open_mesh(&golden(), &with_field("mass")).unwrap();
    assert_eq!(mass.field().unwrap().center, Center::Cell);
    assert_eq!(read_whole(&mass).unwrap().values, [1.0, 1.0, 1.0, 1.0, 3.0, 3.0, 3.0, 3.0, 3.0]);
}

/// A file with these arrays in `/VTKHDF` instead of good ones of the same mesh.
fn file(instead: &[(&str, &[i64])]) -> Vec<u8> {
    let mut group = Group::default();
    let points = (0..27).flat_map(|n| f64::from(n * n % 7).to_le_bytes()).collect();
    group.add("Points", Dataset::of(ScalarType::F64, &[9, 3], Data::Here(points)));
    let good: [(&str, &[i64]); 6] = [
        ("NumberOfPoints", &[4, 5]),
        ("NumberOfCells", &[1, 2]),
        ("NumberOfConnectivityIds", &[4, 8]),
        ("Connectivity", &[0, 1, 2, 3, 0, 1, 2, 0, 1, 2, 3, 4]),
        ("Offsets", &[0, 4, 0, 3, 8]),
        ("Types", &[10, 5, 14]),
    ];
    for (name, list) in good {
        let list = instead.iter().find(|(n, _)| *n == name).map_or(list, |(_, list)| *list);
        group.add(name, Value::integers(list));
    }
    for (name, list) in instead.iter().filter(|(name, _)| good.iter().all(|(n, _)| n != name)) {
        let (within, name) = name.split_once('/').unwrap();
        let mut data = Group::default();
        data.add(name, Value::integers(list));
        group.add_group(within, data);
    }
    hdf::root("UnstructuredGrid", &[], group).head().unwrap()
}

#[test]
fn malformed_files_are_refused() {
    let read = |instead: &[(&str, &[i64])]| {
        let mesh = open(&Arc::new(ByteSource::from_vec("f.vtkhdf", file(instead))))?;
        read_whole(&CellMesh::new(Arc::new(mesh), None)?)
    };
    assert_eq!(read(&[]).unwrap().cells.len(), 3);
    let vertices = |v: i64| [0, 1, 2, 3, 0, 1, 2, 0, 1, 2, 3, v];
    for (name, list, says) in [
        ("NumberOfPoints", &[4, 4][..], "/VTKHDF/Points: expected numbers [8, 3], got [9, 3]"),
        ("NumberOfPoints", &[4, -5], "not negative"),
        ("NumberOfPoints", &[i64::MAX, i64::MAX], "less than 2^53"),
        ("NumberOfCells", &[3], "expected 2 of either, as of NumberOfPoints, got 1 and 2"),
        ("NumberOfCells", &[1, 3], "/VTKHDF/Offsets: expected numbers [6], got [5]"),
        ("NumberOfConnectivityIds", &[8, 4], "expected 8 at the end of a piece"),
        ("Connectivity", &vertices(5), "/VTKHDF/Connectivity: expected points below 5, got 5"),
        ("Connectivity", &vertices(-1), "expected points below 5, got -1"),
        ("Offsets", &[0, 4, 1, 3, 8], "0 at the begin of each piece"),
        ("Offsets", &[0, 4, 0, 9, 8], "expected offsets that ascend, 0 to 8, got 9"),
        ("Offsets", &[0, 4, 0, 4, 8], "expected 5 vertices of pyramids, got 4"),
        ("Types", &[10, 5, 42], "cell 2 (counted from 0): expected a linear or quadratic cell"),
        ("Types", &[10, 5], "/VTKHDF/Types: expected numbers [3], got [2]"),
        ("PointData/heat", &[1; 8], "expected numbers of 9 points, got [8] of them"),
        ("Steps/Values", &[0, 1], "expected a VTKHDF file of one step"),
    ] {
        let error = read(&[(name, list)]).unwrap_err();
        assert!(error.exit_code() == 5 && error.to_string().contains(says), "{says}: {error}");
    }
}

#[test]
fn damage_does_not_panic() {
    torture("f.vtkhdf", &file(&[("PointData/heat", &[1; 9])]));
}
