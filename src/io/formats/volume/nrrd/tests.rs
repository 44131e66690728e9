//! Tests of the NRRD reader.

use super::*;
use crate::formats::open_volume;
use crate::formats::tests::{gzip, ramp, read_all, torture, try_read_all, write};
use crate::volume::units::Unit;
use std::path::Path;

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
    let (info, values) = read_all(open_volume(path, &OpenOptions::default()).unwrap());
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
    let too_long = open_volume(&file(with(head, &gz)), &OpenOptions::default()).and_then(try_read_all);
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
        let error =
            open_volume(&write(&dir, "a.nhdr", head.as_bytes()), &OpenOptions::default()).err().expect(data);
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
        ("dimension: 3", "dimension: 2", "dimension"),
        ("dimension: 3", "dimension: 4", "sizes"),
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
        let error = open_volume(&write(&dir, "a.nrrd", &bytes), &OpenOptions::default()).err().expect(to);
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
        let units = open_volume(&file, &OpenOptions::default()).unwrap().info().units.clone();
        [units.value, units.length].map(|unit| unit.map(|unit| unit.to_string()))
    };
    let text = |t: &str| Some(t.to_string());
    let space = "space: left-posterior-superior\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n";
    let of_space = format!("{space}space units: \"mm\" \"mm\" \"mm\"\nsample units: Hounsfield\n");
    assert_eq!(units(&of_space), [text("Hounsfield"), text("mm")]);
    assert_eq!(units("units: \"um\" \"um\" \"um\"\n"), [None, text("µm")]);
    for unknown in ["units: \"mm\" \"\" \"mm\"\n", "units: mm\n", "", space] {
        assert_eq!(units(unknown), [None, None], "{unknown}");
    }
}

#[test]
fn units_of_single_axes_become_one() {
    let dir = tempfile::tempdir().unwrap();
    let info = |fields: &str| {
        let fields = format!("{fields}endian: little\nencoding: raw\n");
        let file = write(&dir, "a.nrrd", &with(&fields, &ramp(false)));
        open_volume(&file, &OpenOptions::default()).map(|opened| opened.info().clone())
    };
    let space = "space dimension: 3\nspace directions: (1,0,0) (0,2,0) (0,0,3)\nspace origin: (10,20,30)\n";
    let found = info(&format!("{space}space units: \"mm\" \"mm\" \"um\"\n")).unwrap();
    assert_eq!((found.geometry.spacing, found.geometry.origin), ([1.0, 2.0, 0.003], [10.0, 20.0, 0.03]));
    assert_eq!(found.units.length, Unit::length("mm"));
    assert!(found.notes[0].contains("z from µm"), "{:?}", found.notes);
    // Units of space are those of the world's axes, whatever the axes of the samples are.
    let turned = "space dimension: 3\nspace directions: (0,0,1) (0,2,0) (3,0,0)\nspace origin: (10,20,30)\n";
    let found = info(&format!("{turned}space units: \"mm\" \"mm\" \"um\"\n")).unwrap();
    assert_eq!((found.geometry.spacing, found.geometry.origin), ([0.001, 2.0, 3.0], [10.0, 20.0, 0.03]));
    let found = info("spacings: 1 2 3\nunits: \"mm\" \"cm\" \"m\"\n").unwrap();
    assert_eq!(found.geometry.spacing, [1.0, 20.0, 3000.0]);
    let error = info("units: \"mm\" \"parsecs ago\" \"mm\"\n").unwrap_err().to_string();
    assert!(error.contains("parsecs ago") && error.contains("units"), "{error}");
}

type Series = (Vec<Vec<f32>>, Vec<Option<f64>>, VolumeInfo);

/// The samples of three volumes of 4 x 3 x 2 of a file with these lines, and its times.
fn series(fields: &str, data: &[u8]) -> Result<Series> {
    let dir = tempfile::tempdir().unwrap();
    let head = format!("NRRD0005\ntype: ushort\ndimension: 4\n{fields}endian: little\n\n");
    let file = write(&dir, "a.nrrd", &[head.as_bytes(), data].concat());
    let steps = crate::formats::steps_of(&[file], &OpenOptions::default())?;
    let mut infos = vec![];
    let values = steps.iter().map(|step| {
        let (info, values) = read_all(open_volume(&step.path, &step.options)?);
        infos.push(info);
        Ok(values)
    });
    let values = values.collect::<Result<Vec<_>>>()?;
    Ok((values, steps.iter().map(|step| step.time).collect(), infos.swap_remove(0)))
}

#[test]
fn a_fourth_axis_has_the_volumes_of_a_series() {
    let numbers =
        |of: &dyn Fn(u16) -> u16| -> Vec<u8> { (0..72).flat_map(|i| of(i).to_le_bytes()).collect() };
    let expected: Vec<Vec<f32>> = (0..3).map(|t| (0..24).map(|i| (24 * t + i) as f32).collect()).collect();
    let last = numbers(&|i| i);
    let space = "space: left-posterior-superior\nspace origin: (1,2,3)\n";
    let times = [Some(10.0), Some(10.5), Some(11.0)];
    let of_time = "spacings: nan nan nan 0.5\naxis mins: nan nan nan 10\nunits: \"\" \"\" \"\" \"s\"\n";
    let directions = "space directions: (2,0,0) (0,2,0) (0,0,3) none\n";
    for (kinds, has_times) in [("domain domain domain time", true), ("domain domain domain list", false)] {
        let head = format!("sizes: 4 3 2 3\nkinds: {kinds}\n{space}{directions}{of_time}");
        for (encoding, data) in [("raw", last.clone()), ("gzip", gzip(&last))] {
            let (values, found, info) = series(&format!("{head}encoding: {encoding}\n"), &data).unwrap();
            assert_eq!((info.dims, &values), ([4, 3, 2], &expected), "{kinds}, {encoding}");
            assert_eq!((info.geometry.spacing, info.geometry.origin), ([2.0, 2.0, 3.0], [1.0, 2.0, 3.0]));
            assert_eq!(found == times, has_times, "{kinds}: {found:?}");
            assert_eq!(info.units.time.is_some(), has_times, "{kinds}");
        }
    }
    // Slicer's sequences have the volumes as the fastest axis.
    let first = numbers(&|i| 24 * (i % 3) + i / 3);
    let directions = "space directions: none (2,0,0) (0,2,0) (0,0,3)\n";
    let head = format!("sizes: 3 4 3 2\nkinds: list domain domain domain\n{space}{directions}");
    let (values, found, info) = series(&format!("{head}encoding: raw\n"), &first).unwrap();
    assert_eq!((info.dims, values, found), ([4, 3, 2], expected.clone(), vec![None; 3]));
    let error = series(&format!("{head}encoding: gzip\n"), &gzip(&first)).unwrap_err().to_string();
    assert!(error.contains("interleaved") && error.contains("encoding"), "{error}");
    // Nothing says what the last axis is.
    let (values, _, info) = series("sizes: 4 3 2 3\nencoding: raw\n", &last).unwrap();
    assert_eq!(values, expected);
    assert!(info.notes[0].contains("axis 3"), "{:?}", info.notes);
}

#[test]
fn a_space_may_have_time() {
    let data: Vec<u8> = (0..72u16).flat_map(u16::to_le_bytes).collect();
    let expected: Vec<Vec<f32>> = (0..3).map(|t| (0..24).map(|i| (24 * t + i) as f32).collect()).collect();
    let known = vec![Some(10.0), Some(10.5), Some(11.0)];
    // As ITK writes an image of four dimensions; and with a name of the space.
    let itk = "space dimension: 4\nkinds: domain domain domain domain\n";
    let named = "space: right-anterior-superior-time\nkinds: domain domain domain time\n";
    let directions =
        "space directions: (0,-1,0,0) (2,0,0,0) (0,0,3,0) (0,0,0,0.5)\nspace origin: (1,2,3,10)\n";
    let units = "space units: \"mm\" \"mm\" \"mm\" \"s\"\n";
    for (space, encoding) in [(itk, "raw"), (itk, "gzip"), (named, "raw"), ("space: RAST\n", "raw")] {
        let fields = format!("sizes: 4 3 2 3\n{space}{directions}{units}encoding: {encoding}\n");
        let data = if encoding == "gzip" { gzip(&data) } else { data.clone() };
        let (values, times, info) = series(&fields, &data).unwrap();
        assert_eq!((info.dims, &values, &times), ([4, 3, 2], &expected, &known), "{space}");
        let place = info.geometry.to_world([1.0, 1.0, 1.0]);
        assert_eq!((info.geometry.origin, place), ([1.0, 2.0, 3.0], [3.0, 1.0, 6.0]));
        let [length, time] = [info.units.length, info.units.time].map(|unit| unit.unwrap());
        assert_eq!(([length.as_str(), time.as_str()], info.notes), (["mm", "s"], vec![]));
    }
    let back = directions.replace("0.5", "-0.5");
    let (_, times, info) = series(&format!("sizes: 4 3 2 3\n{itk}{back}encoding: raw\n"), &data).unwrap();
    assert_eq!(times, [None; 3]);
    assert!(info.notes[0].contains("no times"), "{:?}", info.notes);
    for (directions, word) in [
        ("(0,-1,0,0) (2,0,0,0) (0,0,3,0) (0.1,0,0,0.5)", "right angles"),
        ("(0,-1,0,0) (2,0,0,0) (0,0,0,3) (0,0,0,0.5)", "right angles"),
        ("(0,-1,0) (2,0,0) (0,0,3) (0,0,0)", "(x,y,z,t)"),
    ] {
        let fields = format!("sizes: 4 3 2 3\n{itk}space directions: {directions}\nencoding: raw\n");
        let error = series(&fields, &data).unwrap_err();
        assert!(error.exit_code() == 5 && error.to_string().contains(word), "{error}");
    }
    let fields = format!("sizes: 4 3 2 3\nspace dimension: 5\n{directions}encoding: raw\n");
    let error = series(&fields, &data).unwrap_err().to_string();
    assert!(error.contains("space dimension") && error.contains("got 5"), "{error}");
}

#[test]
fn axes_that_are_no_space_and_no_series_are_refused() {
    let data = vec![0; 1000];
    for (fields, word) in [
        ("sizes: 4 3 2 3\nkinds: domain domain domain vector\n", "vector"),
        ("sizes: 3 9 9 2\nkinds: RGB-color domain domain domain\n", "RGB-color"),
        ("sizes: 3 9 9 2\n", "sizes 3 9 9 2"),
        ("sizes: 4 3 2 3\nkinds: domain domain time time\n", "time time"),
        ("sizes: 4 3 2 99999\nkinds: domain domain domain time\n", "65536"),
        ("sizes: 4 3 2 50\nkinds: domain domain domain time\n", "byte"),
    ] {
        let error = series(&format!("{fields}encoding: raw\n"), &data).unwrap_err();
        assert!(error.exit_code() == 5 && error.to_string().contains(word), "{error}");
    }
    let dir = tempfile::tempdir().unwrap();
    let head =
        "NRRD0005\ntype: uchar\ndimension: 3\nsizes: 4 3 2\nkinds: domain domain time\nencoding: raw\n\n";
    let file = write(&dir, "a.nrrd", &[head.as_bytes(), &data].concat());
    let error = open_volume(&file, &OpenOptions::default()).err().unwrap().to_string();
    assert!(error.contains("three axes of space") && error.contains("time"), "{error}");
}
