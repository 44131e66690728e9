use crate::cells::scan::scan;
use crate::cells::{CellKind, CellMesh, Center};
use crate::error::Result;
use crate::fixtures::{Encoding, Fixture, every_encoding};
use crate::formats::mesh::tests::{read_whole, torture};
use crate::formats::tests::write;
use crate::formats::{OpenOptions, open_mesh};

/// A tetrahedron, a triangle and a pyramid on five points; `x` moves them.
fn piece(file: &mut Fixture, x: f32) {
    piece_of(file, x, x);
}

fn piece_of(file: &mut Fixture, x: f32, value: f32) {
    file.text("<Piece NumberOfPoints=\"5\" NumberOfCells=\"3\">\n<PointData Scalars=\"p\">");
    file.array("v", 3, &(0..15).map(|i| i as i16).collect::<Vec<i16>>());
    file.array("p", 1, &[1.5, 2.0, 3.0, 4.0, value]);
    file.text("</PointData>\n<CellData>");
    file.array("c", 1, &[1u8, 2, 4]);
    file.text("</CellData>\n<Points>");
    let points = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.5, x];
    file.array("Points", 3, &points);
    file.text("</Points>\n<Cells>");
    file.array("connectivity", 1, &[0i64, 1, 2, 4, 0, 1, 2, 0, 1, 2, 3, 4]);
    file.array("offsets", 1, &[4i64, 7, 12]);
    file.array("types", 1, &[10u8, 5, 14]);
    file.text("</Cells></Piece>\n");
}

fn grid(encoding: Encoding, pieces: usize) -> Vec<u8> {
    let mut file = encoding.file("UnstructuredGrid", "");
    (0..pieces).for_each(|i| piece(&mut file, i as f32 + 1.0));
    file.finish()
}

fn open(bytes: &[u8], field: Option<&str>) -> Result<CellMesh> {
    let dir = tempfile::tempdir().unwrap();
    let options = OpenOptions { field: field.map(str::to_string), ..OpenOptions::default() };
    open_mesh(&write(&dir, "f.vtu", bytes), &options)
}

#[test]
fn every_encoding_gives_the_mesh() {
    for encoding in every_encoding() {
        for pieces in [1, 2] {
            let mesh = open(&grid(encoding, pieces), None).unwrap_or_else(|e| panic!("{encoding:?}: {e}"));
            let whole = read_whole(&mesh).unwrap_or_else(|e| panic!("{encoding:?}: {e}"));
            assert_eq!(whole.points.len(), 5 * pieces);
            assert_eq!(whole.points[1], [1.0, 0.0, 0.0]);
            for i in 0..pieces as u64 {
                let cells = &whole.cells[3 * i as usize..][..3];
                let ids = |of: &[u64]| of.iter().map(|v| v + 5 * i).collect::<Vec<u64>>();
                assert_eq!(cells[0], (CellKind::Tetrahedron, ids(&[0, 1, 2, 4])));
                assert_eq!(cells[1], (CellKind::Flat, vec![]));
                assert_eq!(cells[2], (CellKind::Pyramid, ids(&[0, 1, 2, 3, 4])));
                assert_eq!(whole.values[5 * i as usize + 4], i as f32 + 1.0, "{encoding:?}");
            }
            let averaged = read_whole(&mesh.with_field("c").unwrap()).unwrap().values;
            assert_eq!(averaged[..5], [2.5, 2.5, 2.5, 4.0, 2.5]);
            assert_eq!(read_whole(&mesh.with_field("v.z").unwrap()).unwrap().values[1], 5.0);
        }
    }
    let info = open(&grid(every_encoding()[1], 1), None).unwrap().info().clone();
    let fields: Vec<_> = info.fields.iter().map(|f| (&f.name[..], f.components, f.center)).collect();
    assert_eq!(fields, [("v", 3, Center::Point), ("p", 1, Center::Point), ("c", 1, Center::Cell)]);
    assert!(info.format.contains("inline base64, uncompressed, UInt32"), "{}", info.format);
}

#[test]
fn files_that_store_the_same_mesh_have_one_hash() {
    let hash = |encoding: Encoding, x, value| {
        let mut file = encoding.file("UnstructuredGrid", "");
        piece_of(&mut file, x, value);
        open(&file.finish(), None).unwrap().stored_hash().unwrap()
    };
    let mut all = vec![];
    for encoding in every_encoding() {
        let first = hash(encoding, 1.0, 1.0);
        assert_eq!(first, hash(encoding, 1.0, 7.0), "{encoding:?}: of other values");
        assert!(first.is_none() || first != hash(encoding, 2.0, 1.0), "{encoding:?}: of moved points");
        all.extend(first);
    }
    assert!(all.len() > 3);
    all.sort_unstable();
    assert!(all.windows(2).all(|pair| pair[0] != pair[1]), "as many as there are ways to store it");
}

#[test]
fn an_index_joins_its_files() {
    let dir = tempfile::tempdir().unwrap();
    let ascii = every_encoding()[0];
    write(&dir, "a_0.vtu", &grid(ascii, 1));
    // Processes without a part of the mesh write empty pieces.
    write(
        &dir,
        "a_1.vtu",
        b"<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>\
        <Piece NumberOfPoints=\"0\" NumberOfCells=\"0\"/></UnstructuredGrid></VTKFile>",
    );
    write(&dir, "a_2.vtu", &grid(ascii, 2));
    let index = "<VTKFile type=\"PUnstructuredGrid\"><PUnstructuredGrid GhostLevel=\"0\">\
        <Piece Source=\"a_0.vtu\"/><Piece Source=\"a_1.vtu\"/><Piece Source=\"a_2.vtu\"/></PUnstructuredGrid></VTKFile>";
    let path = write(&dir, "a.pvtu", index.as_bytes());
    let mesh = open_mesh(&path, &OpenOptions::default()).unwrap();
    let whole = read_whole(&mesh).unwrap();
    assert_eq!((whole.points.len(), whole.cells[8].1[0], mesh.info().data_files.len()), (15, 10, 3));
    std::fs::remove_file(dir.path().join("a_2.vtu")).unwrap();
    let error = open_mesh(&path, &OpenOptions::default()).err().expect("a missing file");
    assert!(error.to_string().contains("a_2.vtu"), "{error}");
}

/// A surface, which has no volume.
const SURFACE: &str =
    "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"0\"/></PolyData></VTKFile>";

#[test]
fn blocks_are_joined() {
    let dir = tempfile::tempdir().unwrap();
    let ascii = every_encoding()[0];
    write(&dir, "a_0.vtu", &grid(ascii, 1));
    write(&dir, "a_1.vtp", SURFACE.as_bytes());
    // The second grid lacks an array.
    let second = String::from_utf8(grid(ascii, 2)).unwrap().replace("Name=\"c\"", "Name=\"d\"");
    write(&dir, "a_2.vtu", second.as_bytes());
    let index = "<VTKFile type=\"PUnstructuredGrid\"><PUnstructuredGrid><Piece Source=\"a_0.vtu\"/>\
        </PUnstructuredGrid></VTKFile>";
    write(&dir, "a_3.pvtu", index.as_bytes());
    let list = |kind: &str, blocks: &str| {
        let text = format!("<VTKFile type=\"{kind}\"><{kind}>{blocks}</{kind}></VTKFile>");
        // The type alone tells what it is.
        open_mesh(&write(&dir, "a.xml", text.as_bytes()), &OpenOptions::default())
    };
    for kind in ["vtkMultiBlockDataSet", "vtkPartitionedDataSetCollection", "vtkPartitionedDataSet"] {
        let mesh = list(
            kind,
            "<DataSet index=\"0\" file=\"a_0.vtu\"/><Block index=\"1\"><DataSet index=\"0\" file=\"a_1.vtp\"/>\
             <DataSet index=\"1\"/><Block><DataSet file=\"a_2.vtu\"/></Block></Block><DataSet file=\"a_3.pvtu\"/>",
        )
        .unwrap();
        let whole = read_whole(&mesh).unwrap();
        assert_eq!((whole.points.len(), whole.cells.len()), (20, 12));
        assert_eq!(whole.cells[9], (CellKind::Tetrahedron, vec![15, 16, 17, 19]));
        assert_eq!((whole.values[9], whole.values[14]), (1.0, 2.0));
        let info = mesh.info();
        let names: Vec<_> = info.fields.iter().map(|f| &f.name[..]).collect();
        assert_eq!((names, info.data_files.len()), (vec!["v", "p"], 5), "a field of all blocks");
        let told = "5 files, 1 of surfaces passed over, 2 arrays left out that some blocks lack, ";
        assert!(info.format.contains(told), "{}", info.format);
    }
    let fails = |blocks: &str| list("vtkMultiBlockDataSet", blocks).err().expect(blocks).to_string();
    assert!(fails("<DataSet file=\"none.vtu\"/>").contains("none.vtu"));
    assert!(fails("<Block/>").contains("a Piece with points and cells, got none"));
    let image = String::from_utf8(ascii.file("ImageData", "").finish()).unwrap();
    write(&dir, "b.vti", image.as_bytes());
    let line = fails("<DataSet file=\"a_0.vtu\"/><DataSet file=\"b.vti\"/>");
    assert!(line.contains("b.vti") && line.contains("an image (.vti)"), "{line}");
    // Copies of cells would count where their marks were left out.
    let marked = String::from_utf8(grid(ascii, 1)).unwrap().replace("Name=\"c\"", "Name=\"vtkGhostType\"");
    write(&dir, "c.vtu", marked.as_bytes());
    for blocks in [["a_0", "c"], ["c", "a_0"]] {
        let line = fails(&blocks.map(|b| format!("<DataSet file=\"{b}.vtu\"/>")).concat());
        assert!(line.contains("expected vtkGhostType in all blocks, or in none, got it in some"), "{line}");
    }
    assert_eq!(list("vtkMultiBlockDataSet", "<DataSet file=\"c.vtu\"/>").unwrap().info().cells, 3);
}

#[test]
fn what_is_wrong_is_told() {
    let good = String::from_utf8(grid(every_encoding()[0], 1)).unwrap();
    for (old, new, reason) in [
        (" 0 1 2 4 0", " 0 1 2 5 0", "cell 0 of a piece (counted from 0): expected vertices below 5, got 5"),
        (" 0 1 2 4 0", " 0 1 2 -4 0", "got -1"),
        (" 4 7 12", " 4 3 12", "offsets that ascend, 4 or more, got 3"),
        (" 4 7 12", " 3 7 12", "4 vertices of tetrahedra, got 3"),
        (" 4 7 12", " 4 7 13", "more numbers"),
        ("0 1 2 3 4\n", "0 1 2 3 4 0\n", "the end of the array's numbers"),
        (
            " 10 5 14",
            " 10 5 42",
            "the faces of a polyhedron, in the arrays 'faces' or 'polyhedron_offsets', got",
        ),
        (" 10 5 14", " 10 5 41", "cell type 41 (convex point set)"),
        (" 10 5 14", " 10 5 99", "cell type 99"),
        (" 10 5 14", " 10 5", "more numbers"),
        ("Name=\"types\"", "Name=\"kinds\"", "an array 'types'"),
        ("NumberOfCells=\"3\"", "NumberOfCells=\"30000000000000000000\"", "numbers in NumberOfCells"),
        ("NumberOfCells=\"3\"", "NumberOfCells=\"3000000000000\"", "a file too short"),
        ("NumberOfPoints=\"5\"", "NumberOfPoints=\"9223372036854775807\"", "57 bits"),
        (" 0 0 0 1 ", " 0 nan 0 1 ", "point 0: expected finite coordinates, got (0, NaN, 0)"),
    ] {
        assert!(good.contains(old), "{old}");
        let outcome = open(good.replacen(old, new, 1).as_bytes(), None).and_then(|m| read_whole(&m));
        let line = outcome.err().unwrap_or_else(|| panic!("{new} was read")).to_string();
        assert!(line.contains(reason), "{line}");
    }
    let error = open(good.as_bytes(), Some("q")).err().expect("no such field");
    assert_eq!(error.exit_code(), 2);
}

#[test]
fn damage_is_survived() {
    for at in [0, 1, 9, 22, 30] {
        torture("f.vtu", &grid(every_encoding()[at], 1));
    }
    for newer in [false, true] {
        for at in [0, 9] {
            torture("f.vtu", &polyhedra(every_encoding()[at], newer, 1));
        }
    }
}

/// A pyramid as a polyhedron, a triangle, and a tetrahedron as a polyhedron.
fn polyhedra(encoding: Encoding, newer: bool, pieces: usize) -> Vec<u8> {
    let mut file = encoding.file("UnstructuredGrid", "");
    for _ in 0..pieces {
        file.text("<Piece NumberOfPoints=\"5\" NumberOfCells=\"3\">\n<PointData>");
        file.array("p", 1, &[1.5f32, 2.0, 3.0, 4.0, 7.0]);
        file.text("</PointData>\n<Points>");
        file.array(
            "Points",
            3,
            &[0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.5, 1.0],
        );
        file.text("</Points>\n<Cells>");
        file.array("connectivity", 1, &[0i64, 1, 2, 3, 4, 0, 1, 2, 0, 1, 2, 4]);
        file.array("offsets", 1, &[5i64, 8, 12]);
        file.array("types", 1, &[42u8, 5, 42]);
        if newer {
            let points =
                [0i32, 3, 2, 1, 0, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 4, 0, 2, 1, 0, 1, 4, 1, 2, 4, 0, 4, 2];
            file.array("face_connectivity", 1, &points);
            file.array("face_offsets", 1, &[4i64, 7, 10, 13, 16, 19, 22, 25, 28]);
            file.array("polyhedron_to_faces", 1, &[0i64, 1, 2, 3, 4, 5, 6, 7, 8]);
            file.array("polyhedron_offsets", 1, &[5i64, 5, 9]);
        } else {
            let first = [5i64, 4, 0, 3, 2, 1, 3, 0, 1, 4, 3, 1, 2, 4, 3, 2, 3, 4, 3, 3, 0, 4];
            let second = [4i64, 3, 0, 2, 1, 3, 0, 1, 4, 3, 1, 2, 4, 3, 0, 4, 2];
            file.array("faces", 1, &[&first[..], &second].concat());
            file.array("faceoffsets", 1, &[22i32, -1, 39]);
        }
        file.text("</Cells></Piece>\n");
    }
    file.finish()
}

#[test]
fn faces_of_polyhedra_are_read_in_both_ways() {
    for (encoding, newer) in every_encoding().into_iter().flat_map(|e| [(e, false), (e, true)]) {
        let mesh = open(&polyhedra(encoding, newer, 2), None).unwrap_or_else(|e| panic!("{encoding:?}: {e}"));
        let whole = read_whole(&mesh).unwrap_or_else(|e| panic!("{encoding:?} {newer}: {e}"));
        assert!(mesh.may_have_polyhedra().unwrap());
        let faces = |first: u64, of: &[&[u64]]| {
            let face =
                |f: &&[u64]| std::iter::once(f.len() as u64).chain(f.iter().map(|v| v + first)).collect();
            of.iter().map(face).collect::<Vec<Vec<u64>>>().concat()
        };
        for first in [0, 5] {
            let pyramid: [&[u64]; 5] = [&[0, 3, 2, 1], &[0, 1, 4], &[1, 2, 4], &[2, 3, 4], &[3, 0, 4]];
            let tetrahedron: [&[u64]; 4] = [&[0, 2, 1], &[0, 1, 4], &[1, 2, 4], &[0, 4, 2]];
            let cells = &whole.cells[3 * first as usize / 5..][..3];
            assert_eq!(cells[0], (CellKind::Polyhedron, faces(first, &pyramid)), "{encoding:?} {newer}");
            assert_eq!(cells[1], (CellKind::Flat, vec![]));
            assert_eq!(cells[2], (CellKind::Polyhedron, faces(first, &tetrahedron)), "{encoding:?} {newer}");
        }
        let found = scan(&mesh).unwrap();
        assert_eq!((found.kinds[&CellKind::Polyhedron], found.tetrahedra), (4, 2 * (6 + 4)));
    }
    assert!(!open(&grid(every_encoding()[0], 1), None).unwrap().may_have_polyhedra().unwrap());
}

#[test]
fn wrong_faces_are_told() {
    let text = |newer| String::from_utf8(polyhedra(every_encoding()[0], newer, 1)).unwrap();
    for (newer, old, new, reason) in [
        (
            false,
            " 5 4 0 3 ",
            " 5 4 0 9 ",
            "cell 0 of a piece (counted from 0): expected points of faces below 5, got 9",
        ),
        (false, " 5 4 0 3 ", " 5 4 0 -3 ", "expected points of faces below 5, got -1"),
        (
            false,
            " 4 3 0 2 1 ",
            " 4 3 0 2 3 ",
            "cell 2 of a piece (counted from 0): expected faces of the points that are listed for the cell, got 3",
        ),
        (false, " 5 4 0 3 ", " 6 4 0 3 ", "expected 6 faces, got numbers of 5"),
        (false, " 5 4 0 3 ", " 4 4 0 3 ", "expected the end of a polyhedron of 4 faces, got 4 more numbers"),
        (
            false,
            " 5 4 0 3 ",
            " 5 40 0 3 ",
            "expected a face of at most 20 points, as many as are left, got 40",
        ),
        (
            false,
            " 5 4 0 3 2 1 ",
            " 5 4 0 2 3 1 ",
            "cell 0 (counted from 0): expected faces that close: each edge in two of them, got the edge of points",
        ),
        (
            false,
            " 22 -1 39",
            " 22 23 39",
            "cell 1 of a piece (counted from 0): expected no faces of a cell that is no polyhedron, got faces that end at 23",
        ),
        (
            false,
            " 22 -1 39",
            " 22 -1 21",
            "cell 2 of a piece (counted from 0): expected an end of numbers of the faces of a polyhedron of 22 or more, got 21",
        ),
        (false, " 22 -1 39", " 22 -1 -1", "of 22 or more, got -1"),
        (
            false,
            " 22 -1 39",
            " 22 -1 999999",
            "expected at most 262144 numbers of the faces of a polyhedron, got 999977",
        ),
        (false, " 22 -1 39", " 22 -1 40", "more numbers, got their end"),
        (false, "Name=\"faceoffsets\"", "Name=\"facesets\"", "an array 'faceoffsets'"),
        (
            true,
            " 5 5 9",
            " 5 6 9",
            "cell 1 of a piece (counted from 0): expected no faces of a cell that is no polyhedron, got faces that end at 6",
        ),
        (
            true,
            " 5 5 9",
            " 5 5 8",
            "cell 2 (counted from 0): expected at least 4 faces of a polyhedron, got 3",
        ),
        (
            true,
            " 0 1 2 3 4 5 ",
            " 0 1 3 2 4 5 ",
            "expected face 2: each face of one cell, in the order of the cells, got 3",
        ),
        (true, " 4 7 10 ", " 4 3 10 ", "expected an end of points of a face of 4 or more, got 3"),
        (true, " 4 7 10 ", " 4 17 10 ", "expected offsets of faces that ascend, got 17"),
        (true, "Name=\"face_connectivity\"", "Name=\"face_points\"", "an array 'face_connectivity'"),
    ] {
        let good = text(newer);
        assert!(good.contains(old), "{old}: {good}");
        let outcome = open(good.replacen(old, new, 1).as_bytes(), None).and_then(|m| read_whole(&m));
        let line = outcome.err().unwrap_or_else(|| panic!("{new} was read")).to_string();
        assert!(line.contains(reason), "{line}");
    }
}
