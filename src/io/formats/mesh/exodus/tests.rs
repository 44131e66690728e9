use crate::cells::quadratic::with_middles;
use crate::cells::{CellKind, CellMesh, Orientation, orient, split};
use crate::formats::mesh::tests::{Whole, read_whole, torture};
use crate::formats::tests::is_mesh;
use crate::formats::tests::write;
use crate::formats::{OpenOptions, StepSource, open_mesh, open_volume, steps_of};
use std::path::{Path, PathBuf};

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/exodus").join(name)
}

fn bytes_of(name: &str) -> Vec<u8> {
    std::fs::read(golden(name)).unwrap()
}

fn with_field(field: &str) -> OpenOptions {
    OpenOptions { field: Some(field.into()), ..OpenOptions::default() }
}

fn read(name: &str, field: &str) -> (CellMesh, Whole) {
    let mesh = open_mesh(&golden(name), &with_field(field)).unwrap_or_else(|e| panic!("{e}"));
    let whole = read_whole(&mesh).unwrap_or_else(|e| panic!("{e}"));
    (mesh, whole)
}

/// `bytes` with one text in place of another of the same length, everywhere.
fn replaced(bytes: &[u8], old: &[u8], new: &[u8]) -> Vec<u8> {
    assert_eq!(old.len(), new.len());
    let (mut out, mut found) = (bytes.to_vec(), 0);
    for at in 0..=bytes.len() - old.len() {
        if bytes[at..].starts_with(old) {
            out[at..at + new.len()].copy_from_slice(new);
            found += 1;
        }
    }
    assert!(found > 0, "{}", String::from_utf8_lossy(old));
    out
}

/// The row of cells that all files hold, and its heat in a step.
fn check_row(whole: &Whole, step: f32) {
    assert_eq!(whole.points.len(), 12);
    assert_eq!(whole.points[9], [2.0, 0.0, 1.0]);
    let cell = |kind, nodes: &[u64]| (kind, nodes.iter().map(|n| n - 1).collect::<Vec<u64>>());
    let expected = [
        cell(CellKind::Hexahedron, &[1, 2, 3, 4, 5, 6, 7, 8]),
        cell(CellKind::Wedge, &[2, 9, 3, 6, 10, 7]),
        cell(CellKind::Flat, &[]),
        cell(CellKind::Flat, &[]),
        cell(CellKind::Pyramid, &[5, 6, 7, 8, 11]),
        cell(CellKind::Tetrahedron, &[4, 3, 8, 12]),
    ];
    assert_eq!(whole.cells, expected);
    for (p, &value) in whole.points.iter().zip(&whole.values) {
        assert_eq!(value, (p[0] + 10.0 * p[1] + 100.0 * p[2]) as f32 + 1000.0 * step);
    }
}

#[test]
fn every_container_gives_the_mesh() {
    let packed = cfg!(feature = "hdf5").then_some("row_packed.exo");
    for name in ["row.exo", "row_cdf5.g"].into_iter().chain(packed) {
        assert!(is_mesh(&golden(name), &OpenOptions::default()).unwrap(), "{name}");
        for step in 0..3 {
            check_row(&read(name, &format!("heat:t{step}")).1, step as f32);
            let load = read(name, &format!("load:t{step}")).1.values;
            assert!(load.iter().all(|&v| v == step as f32), "{name}");
        }
        let (mesh, mass) = read(name, "mass:t2");
        // A node of the hexahedron and both shells; one of the wedge, which has no mass, too; one
        // of the tetrahedron alone. Cells without a volume do not count.
        assert_eq!((mass.values[0], mass.values[11]), (12.0, 52.0), "{name}");
        assert!(mass.values[1].is_nan() && mass.values[8].is_nan(), "{name}");
        assert_eq!(mass.values[4], 0.5 * (12.0 + 42.0));
        let names: Vec<_> = mesh.info().fields.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names[..4], ["heat:t0", "load:t0", "mass:t0", "heat:t1"]);
        assert_eq!(names.len(), 9);
    }
    // Old files have all coordinates in one variable, and all values; one step needs no name.
    let (mesh, whole) = read("row_old.e", "heat");
    check_row(&whole, 0.0);
    assert_eq!(mesh.info().format, "Exodus II in NetCDF-3 (classic)");
    assert_eq!(read("row_old.e", "mass").1.values[11], 50.0);
}

#[test]
#[cfg(feature = "hdf5")]
fn what_meshio_writes_is_read() {
    let mesh = open_mesh(&golden("meshio.e"), &OpenOptions::default()).unwrap();
    let whole = read_whole(&mesh).unwrap();
    let kinds: Vec<_> = whole.cells.iter().map(|(kind, _)| *kind).collect();
    assert_eq!(kinds, [CellKind::Hexahedron, CellKind::Tetrahedron]);
    assert_eq!((whole.values[11], mesh.info().format.as_str()), (70.5, "Exodus II in NetCDF-4"));
}

#[test]
fn steps_are_a_series_with_times() {
    let times = |steps: Vec<StepSource>| steps.iter().map(|s| s.time).collect::<Vec<_>>();
    let steps = |field: Option<&str>, name: &str| {
        let options = field.map_or_else(OpenOptions::default, with_field);
        steps_of(&[golden(name)], &options).unwrap()
    };
    let all = [Some(0.5), Some(1.5), Some(4.0)];
    assert_eq!(times(steps(Some("heat"), "row.exo")), all);
    assert_eq!(times(steps(Some("mass:t[12]"), "row.exo")), all[1..]);
    assert_eq!(times(steps(Some("heat:t1"), "row.exo")), [None]);
    assert_eq!(times(steps(Some("heat"), "row_old.e")), [Some(0.5)]);
    if cfg!(feature = "hdf5") {
        assert_eq!(times(steps(Some("heat"), "row_packed.exo")), all);
    }
    let error =
        open_mesh(&golden("row.exo"), &OpenOptions::default()).unwrap().field().unwrap_err().to_string();
    assert!(error.contains("heat:t0 (float64), load:t0 (float32), mass:t0 (float64, on cells)"), "{error}");
}

#[test]
fn what_is_wrong_is_told() {
    let good = bytes_of("row.exo");
    let dir = tempfile::tempdir().unwrap();
    let fails = |bytes: &[u8]| {
        let path = write(&dir, "a.exo", bytes);
        let outcome = open_mesh(&path, &with_field("heat:t0")).and_then(|mesh| read_whole(&mesh));
        let error = outcome.expect_err("it is refused");
        assert_eq!(error.exit_code(), 5, "{error}");
        error.to_string()
    };
    for (old, new, reason) in [
        ("TETRA", "NFACE", "connect5: expected TETRA, HEX, WEDGE or PYRAMID"),
        ("TETRA", "HEX8\0", "'HEX8' of 4 nodes"),
        ("coordz", "coordw", "coordinates: expected x, y and z of 12 nodes"),
        ("connect4", "connecta", "connect4: expected the nodes of the elements, got none"),
        ("num_el_blk", "num_el_blq", "num_el_blk: expected a number of element blocks, got none"),
        ("vals_nod_var2", "vals_nod_varb", "vals_nod_var2: expected the numbers of 'load', got none"),
        (
            "num_nod_var",
            "num_procs\0\0",
            "num_procs: expected a whole mesh, got a part of one that 2 processes wrote",
        ),
    ] {
        let line = fails(&replaced(&good, old.as_bytes(), new.as_bytes()));
        assert!(line.contains(reason), "{line}");
    }
    // Nodes that there are not, of the tetrahedron.
    for node in [0u32, 13, u32::MAX] {
        let old: Vec<u8> = [4u32, 3, 8, 12].iter().flat_map(|n| n.to_be_bytes()).collect();
        let new: Vec<u8> = [4u32, 3, node, 12].iter().flat_map(|n| n.to_be_bytes()).collect();
        let line = fails(&replaced(&good, &old, &new));
        assert!(line.contains("connect5, element 1: expected nodes from 1 to 12"), "{line}");
    }
    let error = open_mesh(&golden("row.exo"), &with_field("none")).err().expect("no such field");
    assert_eq!(error.exit_code(), 2);
    // Not a volume, under any name.
    let path = write(&dir, "a.nc", &good);
    assert!(is_mesh(&path, &OpenOptions::default()).unwrap());
    if cfg!(feature = "hdf5") {
        let path = write(&dir, "a.h5", &bytes_of("row_packed.exo"));
        let line = open_volume(&path, &OpenOptions::default()).err().expect("refused").to_string();
        assert!(line.contains("an Exodus II file of another name") && line.contains(".exo"), "{line}");
    }
}

#[test]
fn numbers_that_were_never_written_are_none() {
    let fill = 9.969_209_968_386_869e36f64.to_be_bytes();
    let dir = tempfile::tempdir().unwrap();
    let bytes = replaced(&bytes_of("row.exo"), &1011.0f64.to_be_bytes(), &fill);
    let mesh = open_mesh(&write(&dir, "a.exo", &bytes), &with_field("heat:t1")).unwrap();
    assert!(read_whole(&mesh).unwrap().values[2].is_nan());
}

#[test]
fn damage_is_survived() {
    torture("a.exo", &bytes_of("row.exo"));
    torture("a.e", &bytes_of("row_old.e"));
}

/// Elements of second order, their nodes in the order of Exodus II: cut on all of their nodes they
/// fill their volume.
#[test]
fn nodes_of_second_order_are_in_their_places() {
    let whole = read("second_order.exo", "x").1;
    let volumes: Vec<_> = whole
        .cells
        .iter()
        .map(|(kind, nodes)| {
            let mut tets = vec![];
            let (filled, all, added) = with_middles(*kind, nodes, |v| whole.points[v as usize]);
            assert_eq!(split(filled, &all, &mut tets), 0);
            let place =
                |v: u64| added.get((u64::MAX - v) as usize).unwrap_or_else(|| &whole.points[v as usize]);
            let of = |t: &[u64; 4]| {
                let p = t.map(|v| *place(v));
                assert_eq!(orient(p), Orientation::Positive, "{kind:?}");
                let d: [[f64; 3]; 3] =
                    std::array::from_fn(|i| std::array::from_fn(|a| p[i + 1][a] - p[0][a]));
                let minor = |i: usize, j: usize| d[1][i] * d[2][j] - d[1][j] * d[2][i];
                (d[0][0] * minor(1, 2) - d[0][1] * minor(0, 2) + d[0][2] * minor(0, 1)) / 6.0
            };
            (*kind, (tets.iter().map(of).sum::<f64>() * 1e6).round() / 1e6)
        })
        .collect();
    assert_eq!(
        volumes,
        [
            (CellKind::QuadraticTetrahedron, 0.166_667),
            (CellKind::QuadraticHexahedron, 1.0),
            (CellKind::TriquadraticHexahedron, 1.0),
            (CellKind::QuadraticWedge, 0.5),
            (CellKind::BiquadraticWedge, 0.5),
            (CellKind::QuadraticPyramid, 0.333_333),
            (CellKind::BiquadraticPyramid, 0.333_333),
        ]
    );
}
