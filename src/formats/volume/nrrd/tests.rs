//! Tests of the NRRD reader.

use super::*;
use crate::formats::tests::{gzip, ramp, read_all, torture, try_read_all, write};

const HEAD: &str = "NRRD0004\n# c\ntype: unsigned short\ndimension: 3\nsizes: 4 3 2\nkey:=a: b\n";

fn with(fields: &str, data: &[u8]) -> Vec<u8> {
    [HEAD.as_bytes(), fields.as_bytes(), b"\n", data].concat()
}

fn text() -> Vec<u8> {
    (0..24)
        .map(|i| format!("{}{}", 1000 + i, if i % 4 == 3 { "\n" } else { ", " }))
        .collect::<String>()
        .into_bytes()
}

fn check(path: &Path, format: &str) -> VolumeInfo {
    let (info, values) = read_all(open(path, &OpenOptions::default()).unwrap());
    assert_eq!((info.dims, info.field.scalar), ([4, 3, 2], ScalarType::U16));
    assert_eq!(info.format, format);
    assert_eq!(values, (0..24).map(|i| (1000 + i) as f32).collect::<Vec<_>>());
    info
}

#[test]
fn attached_in_every_encoding() {
    let dir = tempfile::tempdir().unwrap();
    let file = |data: Vec<u8>| write(&dir, "a.nrrd", &data);
    check(&file(with("endian: little\nencoding: raw\n", &ramp(false))), "NRRD (attached, raw)");
    check(&file(with("endian: big\r\nencoding: RAW\r\n", &ramp(true))), "NRRD (attached, raw)");
    check(&file(with("endian: big\nencoding: gz\n", &gzip(&ramp(true)))), "NRRD (attached, gzip)");
    check(&file(with("encoding: ascii\n", &text())), "NRRD (attached, ascii)");
}

#[test]
fn skips_of_lines_and_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let file = |data: Vec<u8>| write(&dir, "a.nrrd", &data);
    let little = "endian: little\nencoding: raw\n";
    let data = [b"one\ntwo\nxyz", &ramp(false)[..]].concat();
    check(&file(with(&format!("{little}line skip: 2\nbyte skip: 3\n"), &data)), "NRRD (attached, raw)");
    check(&file(with(&format!("{little}byte skip: -1\n"), &data)), "NRRD (attached, raw)");
    let gz = [b"one\ntwo\n".to_vec(), gzip(&[b"xyz", &ramp(false)[..]].concat())].concat();
    let head = "endian: little\nencoding: gzip\nline skip: 2\n";
    check(&file(with(&format!("{head}byteskip: 3\n"), &gz)), "NRRD (attached, gzip)");
    check(&file(with(&format!("{head}byte skip: -1\n"), &gz)), "NRRD (attached, gzip)");
    let too_long = open(&file(with(head, &gz)), &OpenOptions::default()).and_then(try_read_all);
    assert!(too_long.unwrap_err().to_string().contains("more bytes"));
}

#[test]
fn detached_in_one_file_or_in_slices() {
    let dir = tempfile::tempdir().unwrap();
    write(&dir, "all.raw", &ramp(true));
    write(&dir, "s01.raw", &ramp(true)[..24]);
    write(&dir, "s02.raw", &ramp(true)[24..]);
    for data in ["all.raw", "./all.raw", "s%02d.raw 1 2 1", "s%02d.raw 1 2 1 2", "LIST\ns01.raw\ns02.raw"] {
        let head = format!("{HEAD}endian: big\nencoding: raw\ndata file: {data}\n");
        check(&write(&dir, "a.nhdr", head.as_bytes()), "NRRD (detached, raw)");
    }
    for data in
        ["none.raw", "s%02d.raw 1 3 1", "s%02d.raw 1 3 2", "LIST\n", "LIST 1\ns01.raw\ns02.raw", "s01.raw"]
    {
        let head = format!("{HEAD}endian: big\nencoding: raw\ndatafile: {data}\n");
        let error = open(&write(&dir, "a.nhdr", head.as_bytes()), &OpenOptions::default()).err().expect(data);
        assert_eq!(error.exit_code(), 5, "{error}");
    }
}

#[test]
fn orientation_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let file = |fields: &str| {
        let fields = format!("endian: little\nencoding: raw\n{fields}\n");
        check(&write(&dir, "a.nrrd", &with(&fields, &ramp(false))), "NRRD (attached, raw)").geometry
    };
    let g = file(
        "space: left-posterior-superior\nspace directions: (0, 2,0) (-0.5,0,0) (0,0,3)\nspace origin: (1,2,3)",
    );
    assert_eq!((g.origin, g.spacing), ([1.0, 2.0, 3.0], [2.0, 0.5, 3.0]));
    assert_eq!(g.direction, [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
    assert_eq!(file("spacings: 0.5 nan 2").spacing, [0.5, 1.0, 2.0]);
    let g = file("axis mins: 0 0 10\naxis maxs: 4 1 12\ncenters: cell node ???");
    assert_eq!((g.spacing, g.origin), ([1.0, 0.5, 2.0], [0.5, 0.0, 10.0]));
}

#[test]
fn what_is_not_read_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let good = String::from_utf8(with("endian: little\nencoding: raw\n", b"")).unwrap();
    for (from, to, message) in [
        ("dimension: 3", "dimension: 4", "dimension"),
        ("encoding: raw", "encoding: bzip2", "bzip2"),
        ("encoding: raw", "encoding: hex", "hex"),
        ("endian: little", "endian: middle", "middle"),
        ("endian: little", "a: b", "endian"),
        ("type: unsigned short", "type: block", "block"),
        ("sizes: 4 3 2", "sizes: 4 3", "sizes"),
        ("sizes: 4 3 2", "sizes: 4 3 2 1", "sizes"),
        ("sizes: 4 3 2", "sizes: 4 0 2", "dimensions"),
        ("sizes: 4 3 2", "sizes: 4 3 3", "cut short"),
        ("sizes: 4 3 2", "sizes: 4294967296 4294967296 4294967296", "dimensions"),
        ("sizes: 4 3 2", "sizes: 4 3 2\nsizes: 4 3 2", "once"),
        ("sizes: 4 3 2", "sizes: 4 3 2\nkinds: RGB-color domain domain", "RGB-color"),
        ("sizes: 4 3 2", "sizes: 4 3 2\nbyte skip: -5", "-5"),
        ("sizes: 4 3 2", "sizes: 4 3 2\nspace directions: none (1,0,0) (0,1,0)", "none"),
        ("sizes: 4 3 2", "sizes: 4 3 2\nspace directions: (1,0,0) (2,0,0) (0,0,1)", "span"),
        ("sizes: 4 3 2", "sizes: 4 3 2\nspacings: 0 1 1", "span"),
        ("NRRD0004", "NRRD0009", "NRRD0009"),
    ] {
        assert!(good.contains(from));
        let bytes = [good.replacen(from, to, 1).as_bytes(), &ramp(false)].concat();
        let error = open(&write(&dir, "a.nrrd", &bytes), &OpenOptions::default()).err().expect(to);
        assert!(error.exit_code() == 5 && error.to_string().contains(message), "{error}");
    }
}

#[test]
fn damage_is_refused() {
    let file = with("endian: big\nencoding: raw\n", &ramp(true));
    torture("a.nrrd", &file, file.len());
    let file = with("endian: big\nencoding: gzip\nbyte skip: -1\n", &gzip(&ramp(true)));
    torture("a.nrrd", &file, file.len());
    let file = with("encoding: ascii\n", &text());
    // A number may lose its last digits, and the last its line end.
    torture("a.nrrd", &file, file.len() - 5);
}

#[test]
fn units_of_axes_and_samples() {
    let dir = tempfile::tempdir().unwrap();
    let units = |fields: &str| {
        let file =
            write(&dir, "a.nrrd", &with(&format!("{fields}endian: little\nencoding: raw\n"), &ramp(false)));
        let units = open(&file, &OpenOptions::default()).unwrap().info().units.clone();
        [units.value, units.length].map(|unit| unit.map(|unit| unit.to_string()))
    };
    let text = |t: &str| Some(t.to_string());
    let space = "space: left-posterior-superior\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n";
    let of_space = format!("{space}space units: \"mm\" \"mm\" \"mm\"\nsample units: Hounsfield\n");
    assert_eq!(units(&of_space), [text("Hounsfield"), text("mm")]);
    assert_eq!(units("units: \"um\" \"um\" \"um\"\n"), [None, text("µm")]);
    for unknown in ["units: \"mm\" \"mm\" \"m\"\n", "units: \"mm\" \"\" \"mm\"\n", "units: mm\n", "", space] {
        assert_eq!(units(unknown), [None, None], "{unknown}");
    }
}
