//! Tests of the MetaImage reader.

use super::*;
use crate::formats::open_volume;
use crate::formats::tests::{ramp, read_all, torture, write};
use std::io::Write;
use std::path::Path;

const HEAD: &str = "ObjectType = Image\nNDims = 3\nDimSize = 4 3 2\nElementType = MET_USHORT\n";

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut z = flate2::write::ZlibEncoder::new(vec![], flate2::Compression::fast());
    z.write_all(bytes).unwrap();
    z.finish().unwrap()
}

fn with(fields: &str, data: &[u8]) -> Vec<u8> {
    [HEAD.as_bytes(), fields.as_bytes(), data].concat()
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
    let file = |fields: &str, data: &[u8]| write(&dir, "a.mha", &with(fields, data));
    let local = "ElementDataFile = LOCAL\n";
    check(&file(local, &ramp(false)), "MetaImage (attached, raw)");
    check(
        &file(&format!("BinaryDataByteOrderMSB = True\n{local}"), &ramp(true)),
        "MetaImage (attached, raw)",
    );
    check(
        &file(&format!("HeaderSize = -1\n{local}"), &[b"xyz", &ramp(false)[..]].concat()),
        "MetaImage (attached, raw)",
    );
    let (z, head) = (zlib(&ramp(true)), "ElementByteOrderMSB = True\nCompressedData = True\n");
    check(&file(&format!("{head}{local}"), &z), "MetaImage (attached, zlib)");
    let size = format!("CompressedDataSize = {}\n", z.len());
    check(&file(&format!("{head}{size}{local}"), &[&z[..], b"more"].concat()), "MetaImage (attached, zlib)");
    let text: String = (0..24).map(|i| format!("{} ", 1000 + i)).collect();
    check(&file(&format!("BinaryData = False\n{local}"), text.as_bytes()), "MetaImage (attached, text)");
}

#[test]
fn detached_in_one_file_or_in_slices() {
    let dir = tempfile::tempdir().unwrap();
    write(&dir, "all data.raw", &[b"xyz", &ramp(true)[..]].concat());
    for i in 0..2usize {
        write(&dir, &format!("s{:02}.raw", i + 1), &[b"xyz", &ramp(true)[24 * i..][..24]].concat());
    }
    for data in [
        "all data.raw",
        "s%02d.raw 1 2 1",
        "s%02d.raw",
        "LIST\ns01.raw\n\ns02.raw\n",
        "LIST 2\ns01.raw\ns02.raw",
    ] {
        for skip in ["3", "-1"] {
            let fields = format!("ElementByteOrderMSB = True\nHeaderSize = {skip}\nElementDataFile = {data}");
            check(&write(&dir, "a.mhd", &with(&fields, &[])), "MetaImage (detached, raw)");
        }
    }
    let refused = |data: &str| {
        let fields = format!("HeaderSize = 3\nElementDataFile = {data}");
        let error = open_volume(&write(&dir, "a.mhd", &with(&fields, &[])), &OpenOptions::default())
            .err()
            .expect(data);
        assert_eq!(error.exit_code(), 5);
        error.to_string()
    };
    assert!(refused("t%d.raw 5 6 1").contains("2 missing: t5.raw, t6.raw"));
    for data in
        ["none.raw", "s%02d.raw 1 3 1", "s%02d.raw 1 9 2", "LIST\n", "LIST 1\ns01.raw\ns02.raw", "s01.raw"]
    {
        refused(data);
    }
}

#[test]
fn orientation_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let fields = "Offset = 1 2 3\nElementSpacing = 2 0.5 3\nTransformMatrix = 0 1 0 -1 0 0 0 0 1\n";
    let path = write(&dir, "a.mha", &with(&format!("{fields}ElementDataFile = LOCAL\n"), &ramp(false)));
    let g = check(&path, "MetaImage (attached, raw)").geometry;
    assert_eq!((g.origin, g.spacing), ([1.0, 2.0, 3.0], [2.0, 0.5, 3.0]));
    assert_eq!(g.direction, [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
}

#[test]
fn what_is_not_read_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let good = String::from_utf8(with("ElementDataFile = LOCAL\n", b"")).unwrap();
    let extra = |line: &str| format!("NDims = 3\n{line}");
    for (from, to, message) in [
        ("NDims = 3", "NDims = 2".to_string(), "NDims"),
        ("NDims = 3", "NDims = 4".to_string(), "DimSize"),
        ("Image", "Tube".into(), "Tube"),
        ("MET_USHORT", "MET_FLOAT_ARRAY".into(), "MET_FLOAT_ARRAY"),
        ("NDims = 3", extra("ElementNumberOfChannels = 3"), "ElementNumberOfChannels"),
        ("NDims = 3", extra("BinaryData = maybe"), "maybe"),
        ("NDims = 3", extra("HeaderSize = -2"), "-2"),
        ("NDims = 3", extra("ElementSpacing = 1 1 0"), "span"),
        ("NDims = 3", extra("NDims = 3"), "once"),
        ("NDims = 3", extra("no key"), "Key = Value"),
        ("4 3 2", "4 3".into(), "3 numbers"),
        ("4 3 2", "4 3 3".into(), "cut short"),
        ("4 3 2", "4 -3 2".into(), "DimSize"),
        ("4 3 2", "4294967296 4294967296 4294967296".into(), "dimensions"),
        ("ElementDataFile = LOCAL\n", String::new(), "Key = Value"),
    ] {
        assert!(good.contains(from));
        let bytes = [good.replacen(from, &to, 1).as_bytes(), &ramp(false)].concat();
        let error = open_volume(&write(&dir, "a.mha", &bytes), &OpenOptions::default()).err().expect(&to);
        assert!(error.exit_code() == 5 && error.to_string().contains(message), "{error}");
    }
}

#[test]
fn damage_is_refused() {
    let file = with("ElementDataFile = LOCAL\n", &ramp(false));
    torture("a.mha", &file, file.len());
    let file = with("CompressedData = True\nElementDataFile = LOCAL\n", &zlib(&ramp(false)));
    torture("a.mha", &file, file.len());
}

const SERIES: &str = "ObjectType = Image\nNDims = 4\nDimSize = 4 3 2 3\nElementType = MET_USHORT\n\
    ElementSpacing = 2 2 3 0.5\nOffset = 1 2 3 10\n";

type Series = (Vec<Vec<f32>>, Vec<Option<f64>>);

/// The volumes of a series with these lines, and their times.
fn series(dir: &tempfile::TempDir, fields: &str, data: &[u8]) -> Result<Series> {
    let file = write(dir, "a.mha", &[format!("{SERIES}{fields}").as_bytes(), data].concat());
    let steps = crate::formats::steps_of(&[file], &OpenOptions::default())?;
    let read = |step: &crate::formats::StepSource| {
        let (info, values) = read_all(open_volume(&step.path, &step.options)?);
        assert_eq!((info.dims, info.geometry.origin), ([4, 3, 2], [1.0, 2.0, 3.0]));
        assert_eq!(info.geometry.spacing, [2.0, 2.0, 3.0]);
        Ok(values)
    };
    Ok((steps.iter().map(read).collect::<Result<_>>()?, steps.iter().map(|step| step.time).collect()))
}

#[test]
fn a_fourth_axis_is_time() {
    let dir = tempfile::tempdir().unwrap();
    let data: Vec<u8> = (0..72u16).flat_map(u16::to_le_bytes).collect();
    let expected: Vec<Vec<f32>> = (0..3).map(|t| (0..24).map(|i| (24 * t + i) as f32).collect()).collect();
    let expected = (expected, vec![Some(10.0), Some(10.5), Some(11.0)]);
    let local = "TransformMatrix = 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\nElementDataFile = LOCAL\n";
    assert_eq!(series(&dir, local, &data).unwrap(), expected);
    let packed = format!("CompressedData = True\n{local}");
    assert_eq!(series(&dir, &packed, &zlib(&data)).unwrap(), expected);
    // A file for each volume, for each slice, or some.
    write(&dir, "all.raw", &data);
    for (prefix, bytes) in [("v", 48), ("s", 24)] {
        for (n, part) in data.chunks(bytes).enumerate() {
            write(&dir, &format!("{prefix}{n}.raw"), part);
        }
    }
    for files in ["all.raw", "v%d.raw 0 2 1", "s%d.raw 0 5 1", "LIST\nv0.raw\nv1.raw\nv2.raw\n"] {
        assert_eq!(series(&dir, &format!("ElementDataFile = {files}\n"), b"").unwrap(), expected, "{files}");
    }
}

#[test]
fn a_fourth_axis_that_is_not_read_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    for (fields, word) in [
        ("TransformMatrix = 1 0 0 0.1 0 1 0 0 0 0 1 0 0 0 0 1\nElementDataFile = LOCAL\n", "right angles"),
        ("BinaryData = False\nElementDataFile = LOCAL\n", "binary data of a series"),
        ("ElementDataFile = LOCAL\n", "bytes"),
    ] {
        let error = series(&dir, fields, &[0; 100]).unwrap_err();
        assert!(error.exit_code() == 5 && error.to_string().contains(word), "{error}");
    }
    let five = SERIES.replace("NDims = 4", "NDims = 5") + "ElementDataFile = LOCAL\n";
    let error = open_volume(&write(&dir, "b.mha", five.as_bytes()), &OpenOptions::default()).err().unwrap();
    assert!(error.to_string().contains("NDims"), "{error}");
}
