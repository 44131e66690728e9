//! Fixtures with attributes of every kind, and tests of structured points.

use super::*;
use crate::cells::CellFile;
use crate::fixtures::survive;
use crate::formats::mesh::tests::{read_whole, torture};
use crate::formats::open_volume;
use crate::formats::tests::{read_all, try_read_all};
use crate::formats::vtk::xml::tests::{range, shared};

const TEXT_HEAD: &str = "# vtk DataFile Version 4.2\ntitle BINARY\nASCII\nDATASET STRUCTURED_POINTS\n\
    FIELD FieldData 1\nTIME 1 1 double\n0.5\nDIMENSIONS 4 3 2\nSPACING 0.5 2 4\nORIGIN 1 2 3\n";

/// 4 x 3 x 2 samples; x counts ones, y tens, z hundreds.
fn expected() -> Vec<f32> {
    let value = |i: usize| (i % 4 + 10 * (i / 4 % 3) + 100 * (i / 12)) as f32;
    (0..24).map(value).collect()
}

/// A file of attributes of every kind: before, between and after the two arrays to read.
struct Fixture {
    binary: bool,
    bytes: Vec<u8>,
}

impl Fixture {
    fn new(binary: bool) -> Self {
        let mut this = Self { binary, bytes: vec![] };
        let head = "# vtk DataFile Version 4.2\nti\u{e9}tle\nASCII\nDATASET STRUCTURED_POINTS\n";
        this.text(&if binary { head.replace("ASCII", "Binary") } else { head.into() });
        this.text("FIELD FieldData 2\nTIME 1 1 double\n");
        this.numbers(&[0.5], |v| v.to_be_bytes().to_vec());
        this.text("METADATA\nINFORMATION 0\n\nNULL_ARRAY\n");
        this.text("DIMENSIONS 4 3 2\nspacing 0.5 2 4\nORIGIN 1 2 3\n");
        this.text("CELL_DATA 6\nSCALARS cells short\nLOOKUP_TABLE default\n");
        this.numbers(&[7.0; 6], |v| (v as i16).to_be_bytes().to_vec());
        this.text("POINT_DATA 24\n");
        this
    }

    fn text(&mut self, text: &str) {
        self.bytes.extend(text.as_bytes());
    }

    fn numbers(&mut self, values: &[f64], stored: impl Fn(f64) -> Vec<u8>) {
        if self.binary {
            self.bytes.extend(values.iter().flat_map(|&v| stored(v)));
        } else {
            let words: Vec<String> = values.iter().map(ToString::to_string).collect();
            self.bytes.extend(words.join(" ").into_bytes());
        }
        self.bytes.push(b'\n');
    }

    fn floats(&mut self, values: &[f64]) {
        self.numbers(values, |v| (v as f32).to_be_bytes().to_vec());
    }

    fn bytes(&mut self, values: &[f64]) {
        self.numbers(values, |v| vec![v as u8]);
    }
}

fn rich(binary: bool) -> Vec<u8> {
    let mut f = Fixture::new(binary);
    let values: Vec<f64> = expected().into_iter().map(f64::from).collect();
    f.text("VECTORS v float\n");
    f.floats(&[1.25; 72]);
    f.text("METADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 0 1\n\n");
    f.text("SCALARS two%20w%25rds unsigned_short 1\nLOOKUP_TABLE mine\n");
    f.numbers(&values, |v| (v as u16).to_be_bytes().to_vec());
    f.text("LOOKUP_TABLE mine 2\n");
    f.bytes(&[0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0]);
    f.text("COLOR_SCALARS colors 2\n");
    f.bytes(&[1.0; 48]);
    f.text("TENSORS t double\n");
    f.numbers(&[3.0; 216], |v| v.to_be_bytes().to_vec());
    f.text("TEXTURE_COORDINATES uv 2 float\n");
    f.floats(&[0.5; 48]);
    f.text("NORMALS n float\n");
    f.floats(&[0.5; 72]);
    f.text("FIELD FieldData 4\nbits 1 24 bit\n");
    match binary {
        true => f.bytes(&[255.0; 3]),
        false => f.bytes(&[1.0; 24]),
    }
    f.text("short 1 3 int\n");
    f.numbers(&[1.0; 3], |v| (v as i32).to_be_bytes().to_vec());
    f.text("words 1 24 string\n");
    for i in 0..24 {
        let word = "x".repeat(if i == 5 { 100 } else { i });
        match (binary, word.len()) {
            (true, 100) => f.bytes.extend([0x80, 100]),
            (true, n) => f.bytes.push(0xc0 | n as u8),
            _ => {}
        }
        f.text(&word);
        if !binary {
            f.text("\n");
        }
    }
    f.text("\nlast 1 24 double\n");
    let eighths: Vec<f64> = values.iter().map(|v| v / 8.0).collect();
    f.numbers(&eighths, |v| v.to_be_bytes().to_vec());
    f.text("METADATA\nINFORMATION 0\n\n");
    f.bytes
}

fn open_bytes(bytes: &[u8], field: Option<&str>) -> Result<VolumeSource> {
    let options = OpenOptions { field: field.map(Into::into), ..OpenOptions::default() };
    let file = LegacyFile::open(&Arc::new(ByteSource::from_vec("f.vtk", bytes.to_vec())))?;
    format::Dataset::volume(&file, &options)
}

#[test]
fn every_attribute_is_gone_over() {
    for binary in [false, true] {
        let source = open_bytes(&rich(binary), None).unwrap();
        assert_eq!(matches!(source, VolumeSource::Random(_)), binary);
        let (info, values) = read_all(source);
        assert_eq!((info.dims, &info.field.name[..]), ([4, 3, 2], "two w%rds"));
        assert_eq!((values, info.field.scalar), (expected(), ScalarType::U16), "binary: {binary}");
        assert_eq!(info.geometry.to_world([1.0, 1.0, 1.0]), [1.5, 4.0, 7.0]);
        let names: Vec<(&str, u32)> = info.fields.iter().map(|f| (&f.name[..], f.components)).collect();
        let listed = [
            ("v", 3),
            ("two w%rds", 1),
            ("colors", 2),
            ("t", 9),
            ("uv", 2),
            ("n", 3),
            ("last", 1),
            ("cells", 1),
        ];
        assert_eq!(names, listed);
        let (_, last) = read_all(open_bytes(&rich(binary), Some("last")).unwrap());
        assert_eq!(last, expected().iter().map(|v| v / 8.0).collect::<Vec<_>>());
    }
}

#[test]
fn every_type_is_read() {
    use ScalarType::{F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
    let be = |scalar: ScalarType, v: i64| match scalar {
        F32 => (v as f32).to_be_bytes().to_vec(),
        F64 => (v as f64).to_be_bytes().to_vec(),
        _ => v.to_be_bytes()[8 - scalar.bytes()..].to_vec(),
    };
    let check = |name: &str, scalar: ScalarType, binary: bool| {
        let low = if matches!(scalar, U8 | U16 | U32 | U64) { 1 } else { -2 };
        let mut f = Fixture::new(binary);
        f.text(&format!("SCALARS s {name}\nlookup_table default\n"));
        let values: Vec<f64> = (0..24).map(|i| f64::from(low + i)).collect();
        f.numbers(&values, |v| be(scalar, v as i64));
        let (info, found) = read_all(open_bytes(&f.bytes, None).unwrap());
        assert_eq!(info.field.scalar, scalar, "{name}");
        assert_eq!(found, values.iter().map(|&v| v as f32).collect::<Vec<_>>(), "{name}");
    };
    for (name, scalar) in [
        ("unsigned_char", U8),
        ("char", I8),
        ("signed_char", I8),
        ("unsigned_short", U16),
        ("short", I16),
        ("unsigned_int", U32),
        ("int", I32),
        ("unsigned_long", U64),
        ("long", I64),
        ("vtktypeuint64", U64),
        ("vtktypeint64", I64),
        ("float", F32),
        ("Double", F64),
    ] {
        check(name, scalar, false);
        check(name, scalar, true);
    }
    check("vtkIdType", I64, false);
    check("vtkIdType", I32, true);
}

fn refused(bytes: &[u8], field: Option<&str>) -> String {
    let error = open_bytes(bytes, field).and_then(try_read_all).expect_err("the file is refused");
    assert!(matches!(error.exit_code(), 2 | 5));
    error.to_string()
}

#[test]
fn the_field_is_chosen_or_asked_for() {
    let text = String::from_utf8(rich(false)).unwrap();
    for (field, says) in [("bits", "bits or strings"), ("v", "no scalar field v")] {
        assert!(refused(text.as_bytes(), Some(field)).contains(says));
    }
    let several =
        text.replace("SCALARS two", "GLOBAL_IDS two").replace("short 1\nLOOKUP_TABLE mine", "short");
    assert!(refused(several.as_bytes(), None).contains("two w%rds (uint16), colors (2 x uint8"));
    let grid = text.replace("STRUCTURED_POINTS", "STRUCTURED_GRID").replace("ORIGIN 1 2 3", "");
    let grid = grid.replace("spacing 0.5 2 4", "");
    let (cells_only, _) = grid.split_once("POINT_DATA").unwrap();
    assert!(refused(cells_only.as_bytes(), Some("speed")).contains("no scalar field speed"));
}

#[test]
fn bytes_in_a_text_are_parts_of_255() {
    // VTK writes scalars of bytes as colours: in a text from 0 to 1, with six digits.
    let grids = ["STRUCTURED_POINTS\nDIMENSIONS 2 2 2\nORIGIN 0 0 0\nSPACING 1 1 1\n", &tetrahedron()];
    let bytes = [224.0, 156.0, 0.0, 255.0, 5.0, 34.0, 1.0, 128.0];
    for (grid, n) in grids.into_iter().zip([8, 4]) {
        let written: Vec<String> = bytes[..n].iter().map(|b| format!("{:.6}", b / 255.0)).collect();
        let text = format!(
            "# vtk DataFile Version 5.1\n\nASCII\nDATASET {grid}POINT_DATA {n}\nCOLOR_SCALARS v 1\n{}\n",
            written.join(" ")
        );
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("f.vtk");
        std::fs::write(&path, &text).unwrap();
        let mut values = vec![0.0; n];
        if n == 8 {
            let (info, found) = read_all(open_bytes(text.as_bytes(), None).unwrap());
            assert_eq!(info.field.scalar, ScalarType::U8);
            values = found.into_iter().map(f64::from).collect();
            let beyond = text.replace("0.000000", "1.5");
            let error = open_bytes(beyond.as_bytes(), None).map(read_error).unwrap();
            assert!(error.contains("got 1.5"), "{error}");
        } else {
            let source = Arc::new(ByteSource::open(&path, Default::default()).unwrap());
            super::cells::open(&source).unwrap().field(0).unwrap().fill(&mut values).unwrap();
        }
        assert_eq!(values, bytes[..n]);
    }
}

fn tetrahedron() -> String {
    "UNSTRUCTURED_GRID\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n"
        .into()
}

fn read_error(source: VolumeSource) -> String {
    let VolumeSource::Stream(mut stream) = source else { panic!("a text is read from front to back") };
    stream.next_slab(&mut vec![]).unwrap_err().to_string()
}

#[test]
fn cell_data_of_structured_points_are_samples_in_the_middles() {
    for binary in [false, true] {
        // The file has no array of the point data, or has some.
        for (bytes, field) in [(Fixture::new(binary).bytes, None), (rich(binary), Some("cells"))] {
            let (info, values) = read_all(open_bytes(&bytes, field).unwrap());
            assert_eq!((info.dims, &info.field.name[..], &values[..]), ([3, 2, 1], "cells", &[7.0; 6][..]));
            assert_eq!(info.geometry.to_world([0.0; 3]), [1.25, 3.0, 5.0]);
            assert!(info.format.contains("cell data"), "{}", info.format);
        }
    }
    let text = String::from_utf8(Fixture::new(false).bytes).unwrap().replace("CELL_DATA 6", "CELL_DATA 24");
    assert!(refused(text.as_bytes(), None).contains("CELL_DATA 6"));
}

#[test]
fn cell_data_of_grids_are_samples_in_the_middles() {
    let head = "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET";
    let cells = "CELL_DATA 6\nSCALARS c float 1\nLOOKUP_TABLE default\n1 2 3 4 5 6\n";
    let rectilinear = format!(
        "{head} RECTILINEAR_GRID\nDIMENSIONS 4 3 2\nX_COORDINATES 4 float\n0 1 4 9\nY_COORDINATES 3 float\n\
         0 2 4\nZ_COORDINATES 2 float\n5 3\n{cells}"
    );
    let points: Vec<String> = (0..24)
        .map(|i| format!("{} {} {}", (i % 4) * (i % 4) + i / 4 % 3, 2 * (i / 4 % 3), i / 12))
        .collect();
    let structured =
        format!("{head} STRUCTURED_GRID\nDIMENSIONS 4 3 2\nPOINTS 24 float\n{}\n{cells}", points.join("\n"));
    let dir = tempfile::tempdir().unwrap();
    for text in [rectilinear, structured] {
        let path = crate::formats::tests::write(&dir, "a.vtk", text.as_bytes());
        let (info, values) = read_all(open_volume(&path, &OpenOptions::default()).unwrap());
        assert_eq!((info.dims, values), ([3, 2, 1], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        match crate::formats::tests::open_coordinates(&path, &OpenOptions::default()).unwrap().unwrap() {
            GridCoordinates::Axes(axes) => {
                assert_eq!(axes, [vec![0.5, 2.5, 6.5], vec![1.0, 3.0], vec![4.0]]);
            }
            GridCoordinates::Points(mut stream) => {
                let mut points = vec![0.0; 18];
                stream.fill(&mut points).unwrap();
                stream.finish().unwrap();
                assert_eq!((&points[..3], &points[15..]), (&[1.0, 1.0, 0.5][..], &[8.0, 3.0, 0.5][..]));
            }
        }
    }
}

#[test]
fn malformed_files_are_refused() {
    let good = format!("{TEXT_HEAD}POINT_DATA 24\nSCALARS s int\nLOOKUP_TABLE default\n{}", "7 ".repeat(24));
    assert!(open_bytes(good.as_bytes(), None).is_ok());
    for (from, to, says) in [
        ("# vtk", "# VTK", "line 1"),
        ("ASCII", "EBCDIC", "line 3: expected ASCII or BINARY"),
        ("DATASET", "DATA", "line 4"),
        ("STRUCTURED_POINTS", "POLYDATA", "got DATASET POLYDATA"),
        ("DATASET STRUCTURED_POINTS", "FIELD FieldData 1", "'FIELD'"),
        ("DIMENSIONS 4 3 2", "DIMENSIONS 4 3", "line 9: expected a dimension"),
        ("DIMENSIONS 4 3 2", "DIMENSIONS 4 3 0", "at least one sample"),
        ("DIMENSIONS 4 3 2", "DIMENSIONS 4 3 3", "POINT_DATA 36"),
        ("DIMENSIONS 4 3 2", "DIMENSIONS 9999999999 9999999999 2", "fewer than 2^63"),
        ("SPACING 0.5", "SPACING 0", "span space"),
        ("ORIGIN", "ORIGINAL", "'ORIGINAL'"),
        ("int", "quaternion", "'quaternion'"),
        ("int", "int x", "a number of components"),
        ("int", "int 2", "2 x 24 values of 's'"),
        ("LOOKUP_TABLE", "TABLE", "LOOKUP_TABLE and a name"),
        ("7 7", "7", "1 x 24 values"),
        ("7 7", "7 7 7", "an attribute"),
        ("7 7", "7 7.5", "a number of type int32"),
    ] {
        let bad = good.replacen(from, to, 1);
        assert_ne!(good, bad, "{from}");
        let error = refused(bad.as_bytes(), None);
        assert!(error.contains(says), "{says}: {error}");
    }
}

#[test]
fn damage_does_not_panic() {
    for binary in [false, true] {
        survive(&rich(binary), |b| drop(open_bytes(b, None).and_then(try_read_all)));
    }
}

#[test]
fn a_cut_within_the_data_is_an_error() {
    for binary in [false, true] {
        let bytes = rich(binary);
        let end = bytes.windows(14).rposition(|w| w == b"METADATA\nINFOR").unwrap() - 1;
        let read = |cut: usize| open_bytes(&bytes[..cut], Some("last")).and_then(try_read_all);
        // A text may end within its last number and still be one.
        let end = if binary { end } else { end - 8 };
        assert!((0..end).all(|cut| read(cut).is_err()), "binary: {binary}");
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn real_files_have_the_published_dimensions_and_ranges() {
    for (name, field, dims, scalar, expected) in [
        ("volumes/carotid_flow_f32be.vtk", "scalars", [76, 49, 45], ScalarType::F32, (0.0, 580.0)),
        ("volumes/ironprot_u8.vtk", "scalars", [68, 68, 68], ScalarType::U8, (0.0, 255.0)),
        ("variants/vtkio/volume_complex.vtk", "volume_scalars", [3, 4, 6], ScalarType::I8, (0.0, 50.0)),
    ] {
        let path = shared(name);
        let (info, values) = read_all(open_volume(&path, &OpenOptions::default()).unwrap());
        assert_eq!((info.dims, info.field.scalar, &info.field.name[..]), (dims, scalar, field));
        assert_eq!(range(&values), expected, "{name}");
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn real_files_that_are_no_volume_are_refused_by_name() {
    let folder = shared("variants");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder.join("vtkio")).unwrap().chain(std::fs::read_dir(folder).unwrap()) {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.extension().is_some_and(|e| e == "vtk")
            && !["volume_complex.vtk", "structured_grid.vtk"].contains(&&name[..])
        {
            match open_volume(&path, &OpenOptions::default()) {
                // Data on the cells of grids are samples in their middles.
                Ok(source) => assert!(name.starts_with("rectilinear") && !source.info().fields.is_empty()),
                Err(error) => {
                    let line = error.to_string();
                    let is_named = line.contains("DATASET") || line.contains("got a mesh");
                    assert!(error.exit_code() == 5 && is_named, "{line}");
                }
            }
            seen += 1;
        }
    }
    assert!(seen > 20);
}

const GRID: &str = "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\n\
    FIELD FieldData 1\nTIME 1 1 double\n0.5\nPOINTS 5 float\n0 0 0 1 0 0 1 1 0\n0 1 0 .5 .5 1\n\
    METADATA\nINFORMATION 0\n\nCELLS 3 13\n4 0 1 2 4\n2 0 1\n5 0 1 2 3 4\n\nCELL_TYPES 3\n10 3 14\n\
    CELL_DATA 3\nSCALARS c int\nLOOKUP_TABLE default\n1 9 3\nPOINT_DATA 5\nSCALARS p float\nLOOKUP_TABLE default\n\
    1 2 3 4 5\nVECTORS v double\n0 1 2 0 1 2 0 1 2 0 1 2 3 4 0\nMETADATA\nINFORMATION 0\n\n";

/// The same grid: binary, with the list of version 5.1 or without.
fn binary_grid(offsets: bool) -> Vec<u8> {
    let mut f: Vec<u8> =
        GRID.split("POINTS").next().unwrap().replace("ASCII", "BINARY").replace("0.5\n", "").into();
    let put = |f: &mut Vec<u8>, text: &str, bytes: Vec<u8>| {
        f.extend(text.as_bytes());
        f.extend(bytes);
        f.push(b'\n');
    };
    let floats = |v: &[f32]| v.iter().flat_map(|x| x.to_be_bytes()).collect::<Vec<u8>>();
    let ints = |v: &[i32]| v.iter().flat_map(|x| x.to_be_bytes()).collect::<Vec<u8>>();
    let longs = |v: &[i64]| v.iter().flat_map(|x| x.to_be_bytes()).collect::<Vec<u8>>();
    put(&mut f, "", 0.5f64.to_be_bytes().to_vec());
    let points = [0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0., 0.5, 0.5, 1.];
    put(&mut f, "POINTS 5 float\n", floats(&points));
    put(&mut f, "METADATA\nINFORMATION 0\n\n", vec![]);
    if offsets {
        put(&mut f, "CELLS 4 11\nOFFSETS vtktypeint64\n", longs(&[0, 4, 6, 11]));
        put(&mut f, "CONNECTIVITY vtktypeint64\n", longs(&[0, 1, 2, 4, 0, 1, 0, 1, 2, 3, 4]));
    } else {
        put(&mut f, "CELLS 3 14\n", ints(&[4, 0, 1, 2, 4, 2, 0, 1, 5, 0, 1, 2, 3, 4]));
    }
    put(&mut f, "CELL_TYPES 3\n", ints(&[10, 3, 14]));
    put(&mut f, "CELL_DATA 3\nSCALARS c int\nLOOKUP_TABLE default\n", ints(&[1, 9, 3]));
    put(&mut f, "POINT_DATA 5\nSCALARS p float\nLOOKUP_TABLE default\n", floats(&[1., 2., 3., 4., 5.]));
    f
}

fn mesh(bytes: &[u8]) -> Result<CellMesh> {
    let dir = tempfile::tempdir().unwrap();
    crate::formats::open_mesh(&crate::formats::tests::write(&dir, "a.vtk", bytes), &OpenOptions::default())
}

#[test]
fn unstructured_grids_are_read() {
    use crate::cells::CellKind::{Flat, Pyramid, Tetrahedron};
    let text = GRID.replace("CELLS 3 13", "CELLS 3 14").into_bytes();
    for bytes in [text.clone(), binary_grid(false), binary_grid(true)] {
        let mesh = mesh(&bytes).unwrap();
        let whole = read_whole(&mesh).unwrap();
        assert_eq!(whole.points[4], [0.5, 0.5, 1.0]);
        let expected = [(Tetrahedron, vec![0, 1, 2, 4]), (Flat, vec![]), (Pyramid, vec![0, 1, 2, 3, 4])];
        assert_eq!(whole.cells, expected);
        assert_eq!(whole.values, [1., 2., 3., 4., 5.]);
        let c = read_whole(&mesh.with_field("c").unwrap()).unwrap().values;
        assert_eq!(c, [2., 2., 2., 3., 2.]);
    }
    let v = mesh(&text).unwrap().with_field("v.magnitude").unwrap();
    assert_eq!(read_whole(&v).unwrap().values[4], 5.0);
    let five = GRID.replace(
        "CELLS 3 13\n4 0 1 2 4\n2 0 1\n5 0 1 2 3 4\n",
        "CELLS 4 11\nOFFSETS vtktypeint64\n0 4 6 11\nCONNECTIVITY vtktypeint64\n0 1 2 4 0 1 0 1 2 3 4\n",
    );
    assert_eq!(
        read_whole(&mesh(five.as_bytes()).unwrap()).unwrap(),
        read_whole(&mesh(&text).unwrap()).unwrap()
    );
}

#[test]
fn wrong_unstructured_grids_are_refused() {
    let good = GRID.replace("CELLS 3 13", "CELLS 3 14");
    for (old, new, reason) in [
        ("CELLS 3 14", "CELLS 3 13", "expected POINTS, CELLS"),
        ("CELLS 3 14\n4 0 1 2 4", "CELLS 3 13\n3 0 1 2", "4 vertices of tetrahedra, got 3"),
        ("5 0 1 2 3 4", "5 0 1 2 3 5", "cell 2 (counted from 0): expected vertices among 5 points"),
        ("5 0 1 2 3 4", "5 0 1 2 3 -1", "cell 2"),
        ("10 3 14", "10 3 42", "cell type 42 (polyhedron)"),
        ("CELL_TYPES 3\n10 3 14", "CELL_TYPES 2\n10 3", "3 cell types, got 2"),
        ("POINT_DATA 5", "POINT_DATA 6", "POINT_DATA 5"),
        ("CELL_DATA 3", "CELL_DATA 4", "CELL_DATA 3"),
        ("POINTS 5", "POINTS 9000000000000000000", "values of 'points'"),
        (".5 .5 1", ".5 .5 inf", "point 4: expected finite"),
    ] {
        assert!(good.contains(old), "{old}");
        let outcome = mesh(good.replacen(old, new, 1).as_bytes()).and_then(|m| read_whole(&m));
        let line = outcome.expect_err(new).to_string();
        assert!(line.contains(reason), "{reason}: {line}");
    }
}

#[test]
fn damaged_unstructured_grids_are_survived() {
    torture("a.vtk", GRID.replace("CELLS 3 13", "CELLS 3 14").as_bytes());
    torture("a.vtk", &binary_grid(false));
    torture("a.vtk", &binary_grid(true));
}
