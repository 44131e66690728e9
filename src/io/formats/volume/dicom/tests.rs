use super::*;
use crate::formats::open_volume;
use crate::formats::tests::{read_all, torture, write};

/// What `tools/make_golden_dicom.py` let pydicom write.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/dicom").join(name)
}

/// The files of the series, in order; their names are in another.
const SERIES: [&str; 5] = ["b", "e", "a", "d", "c"];

fn open_default(path: &Path) -> Result<VolumeSource> {
    open_volume(path, &OpenOptions::default())
}

/// A copy of the series, one of its files changed.
fn copy(name: &str, change: impl Fn(Vec<u8>) -> Vec<u8>) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for file in SERIES {
        let bytes = std::fs::read(data("series").join(file)).unwrap();
        write(&dir, file, &if file == name { change(bytes) } else { bytes });
    }
    dir
}

fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len(), "lengths stay");
    let at = bytes.windows(from.len()).position(|w| w == from).expect("it is there");
    [&bytes[..at], to, &bytes[at + from.len()..]].concat()
}

fn refused(path: &Path) -> String {
    let error = open_default(path).err().expect("refused");
    assert_eq!(error.exit_code(), 5, "{error}");
    error.to_string()
}

#[test]
fn slices_are_ordered_by_their_places() {
    let patterns = [data("series"), data("series").join("?")];
    for (path, io) in patterns.iter().zip([IoMode::Map, IoMode::Read]) {
        let (info, values) =
            read_all(open_volume(path, &OpenOptions { io, ..OpenOptions::default() }).unwrap());
        // Stored from -30 on, with other bits above the twelve: 2 · stored - 1024.
        let expected: Vec<f32> = (0..100).map(|i| 2.0 * (i as f32 - 30.0) - 1024.0).collect();
        assert_eq!((info.dims, values), ([5, 4, 5], expected));
        assert_eq!(info.field.scalar, ScalarType::I16);
        assert_eq!(info.format, "DICOM (5 files, int16 of 12 bits)");
        assert_eq!(info.geometry.to_world([0.0; 3]), [100.0, -7.25, 30.5]);
        // Rows go on along y, columns along -z, slices along -x.
        assert_eq!(info.geometry.to_world([4.0, 3.0, 2.0]), [95.0, -4.25, 29.0]);
        assert_eq!(info.files().len(), 5);
    }
}

#[test]
fn frames_of_one_file_are_a_volume() {
    let (info, values) = read_all(open_default(&data("enhanced.dcm")).unwrap());
    assert_eq!((info.dims, info.field.scalar, info.missing), ([5, 4, 3], ScalarType::U16, Some(59.0)));
    let expected: Vec<f32> = (1..60).map(|i| i as f32).collect();
    assert_eq!(values[..59], expected);
    assert!(values[59].is_nan());
    assert_eq!(info.geometry.to_world([4.0, 3.0, 2.0]), [95.0, -4.25, 29.0]);
    // Slopes of 4, 2 and 1.
    let (info, values) = read_all(open_default(&data("slopes.dcm")).unwrap());
    assert_eq!((info.field.scalar, info.slope, info.missing), (ScalarType::F64, 1.0, None));
    let slope = |i: usize| [4.0, 2.0, 1.0][i / 20];
    let expected: Vec<f32> = (0..59).map(|i| slope(i) * i as f32 + 1.0).collect();
    assert_eq!(values[..59], expected);
    assert!(values[59].is_nan());
    let dir = tempfile::tempdir().unwrap();
    let line = refused(&write(&dir, "one.dcm", b"what"));
    assert!(line.contains("byte 128"), "{line}");
    // Also where the first bytes, which mean nothing, are those of a TIFF.
    let bytes = std::fs::read(data("series/a")).unwrap();
    let line = refused(&write(&dir, "slice", &[&b"II*\0\0\0\x08\0"[..], &bytes[8..]].concat()));
    assert!(line.contains("name the folder"), "{line}");
}

/// Offsets are along the normal from 0 on, or the z of each frame.
#[test]
fn dose_grids_are_placed_and_scaled() {
    let expected: Vec<f32> = (0..60).map(|i| (2.5e-4 * f64::from(i)) as f32).collect();
    let sorted = [&expected[..20], &expected[40..], &expected[20..40]].concat();
    for (name, first, last, expected) in [
        ("dose.dcm", [100.0, -7.25, 30.5], [96.0, -4.25, 29.0], &expected),
        ("dose_places.dcm", [-10.0, 20.0, -30.5], [-7.0, 21.5, -26.5], &expected),
        // Seen from the feet, the normal goes down, and so do the frames.
        ("dose_feet.dcm", [10.0, 20.0, 30.5], [7.0, 21.5, 26.5], &expected),
    ] {
        let (info, values) = read_all(open_default(&data(name)).unwrap());
        assert_eq!((info.dims, info.field.scalar, &values), ([5, 4, 3], ScalarType::U32, expected), "{name}");
        let place = |at| info.geometry.to_world(at);
        assert_eq!((place([0.0; 3]), place([4.0, 3.0, 2.0])), (first, last), "{name}");
        assert_eq!(info.units.value.as_ref().map(ToString::to_string).as_deref(), Some("Gy"));
        torture(name, &std::fs::read(data(name)).unwrap(), usize::MAX);
    }
    // Frames are put in the order of their places.
    let dir = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(data("dose.dcm")).unwrap();
    let path = write(&dir, "a.dcm", &replaced(&bytes, br"0.0\2.0\4.0 ", br"0.0\4.0\2.0 "));
    let (info, values) = read_all(open_default(&path).unwrap());
    assert_eq!((info.geometry.to_world([0.0; 3]), values), ([100.0, -7.25, 30.5], sorted));
    for (from, to, says) in [
        (&br"0.0\2.0\4.0 "[..], &br"1.0\2.0\4.0 "[..], "Grid Frame Offset Vector: expected 0 first"),
        (br"0.0\2.0\4.0 ", br"0.0\2.0     ", "3 numbers"),
        (br"0.0\2.0\4.0 ", br"0.0\2.0\9.0 ", "slices 2 mm apart"),
        (br"0.0\2.0\4.0 ", br"0.0\2.0\x.0 ", "3 numbers"),
        (b"2.5e-4", b"-2.5e4", "Dose Grid Scaling: expected a number above 0"),
        (b"2.5e-4", b"      ", "Dose Grid Scaling (3004,000e)"),
    ] {
        let line = refused(&write(&dir, "a.dcm", &replaced(&bytes, from, to)));
        assert!(line.contains(says), "{says}: {line}");
    }
}

#[test]
fn fractions_are_parts_of_the_largest() {
    let (info, values) = read_all(open_default(&data("fractions.dcm")).unwrap());
    let tens = (0..20).map(|i| (f64::from(10 * i) * (1.0 / 200.0)) as f32);
    let ones = (0..20).map(|i| (f64::from(i) * (1.0 / 200.0)) as f32);
    assert_eq!((info.dims, values), ([5, 4, 2], tens.chain(ones).collect::<Vec<_>>()));
    let dir = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(data("fractions.dcm")).unwrap();
    let line = refused(&write(&dir, "a.dcm", &replaced(&bytes, b"US\x02\0\xc8\0", b"US\x02\0\0\0")));
    assert!(line.contains("Maximum Fractional Value"), "{line}");
}

#[test]
fn maps_have_the_values_of_the_world() {
    let (info, values) = read_all(open_default(&data("map.dcm")).unwrap());
    let expected: Vec<f32> = (0..40).map(|i| 0.5 * i as f32 - 3.0).collect();
    assert_eq!((info.dims, info.slope, info.intercept, values), ([5, 4, 2], 0.5, -3.0, expected));
    let dir = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(data("map.dcm")).unwrap();
    let tag = |n: u8| [0x40, 0, n, 0x92, b'F', b'D'];
    let line = refused(&write(&dir, "a.dcm", &replaced(&bytes, &tag(0x25), &tag(0x26))));
    assert!(line.contains("Real World Value Mapping: expected"), "{line}");
}

#[test]
fn files_that_are_no_images_are_passed_over() {
    let dir = copy("a", |bytes| bytes);
    let whole = read_all(open_default(dir.path()).unwrap()).1;
    std::fs::copy(data("report"), dir.path().join("report")).unwrap();
    write(&dir, "DICOMDIR", b"an index");
    write(&dir, "notes.txt", b"a text");
    let (info, values) = read_all(open_default(dir.path()).unwrap());
    assert_eq!((values, info.data_files.len()), (whole, 5));
    assert_eq!(crate::formats::passed_over(&info), ["DICOMDIR", "notes.txt", "report"]);
    let line = refused(&data("report"));
    assert!(line.contains("no image"), "{line}");
    let reports = tempfile::tempdir().unwrap();
    std::fs::copy(data("report"), reports.path().join("report")).unwrap();
    let line = refused(reports.path());
    assert!(line.contains("expected DICOM images"), "{line}");
}

#[test]
fn slices_that_are_not_one_volume_are_refused_by_name() {
    let place = br"92.5\-7.25\30.5  ";
    let direction = br"0.0\1.0\0.0\0.0\0.0\-1.0";
    for (from, to, says) in [
        (&place[..], &br"97.5\-7.25\30.5  "[..], "two at one: d and e"),
        (place, br"80.5\-7.25\30.5  ", "1 missing between a and c"),
        (place, br"93.3\-7.25\30.5  ", "mm between a and d"),
        (place, br"92.5\-7.25\31.5  ", "along a line, this one at [92.5, -7.25, 30.5]"),
        (place, br"92.5\-7.25       ", "3 numbers"),
        (direction, br"0.0\1.0\0.0\0.0\0.1\-1.0", "one for all slices"),
        (br"0.5\0.75", br"0.5\0.70", "Pixel Spacing"),
        (br"0.5\0.75", br"-.5\0.75", "Pixel Spacing: expected distances above 0"),
        (b"1.2.3.4\0", b"1.2.3.5\0", "one series, got 2, as in a and d"),
        (b"1.2.840.10008.1.2.1\0", b"1.2.840.10008.1.2.5\0", "RLE (1.2.840.10008.1.2.5)"),
        (b"MONOCHROME2", b"RGB        ", "RGB"),
        (b"\x02\x00\x0c\x00(", b"\x02\x00\x0d\x00(", "up to bit 11"),
        (b"(\x00\x10\x00US\x02\x00\x04", b"(\x00\x10\x00US\x02\x00\x03", "samples as in the first slice"),
        (b"(\x00\x10\x00US\x02\x00\x04", b"(\x00\x10\x00US\x02\x00\x05", "50 bytes for 1 x 5 x 5 samples"),
        (b"2.0 ", b"0.0 ", "Rescale Slope"),
        (b"DICM", b"DCIM", "MISSING"),
    ] {
        let dir = copy("d", |bytes| replaced(&bytes, from, to));
        if says == "MISSING" {
            // A file of another kind is no slice: so one is missing, and not only passed over.
            assert!(refused(dir.path()).contains("1 missing between a and c"));
            continue;
        }
        let line = refused(dir.path());
        assert!(line.contains(says), "{says}: {line}");
    }
    let dir = copy("a", |bytes| bytes);
    write(&dir, "f.dcm", b"no head");
    assert!(refused(dir.path()).contains("f.dcm, which has no 'DICM'"));
    // A part of the names.
    let line = refused(&data("series").join("[ab]*"));
    assert!(line.contains("none"), "{line}");
}

#[test]
fn a_series_with_a_gap_is_refused() {
    let dir = copy("a", |bytes| bytes);
    std::fs::remove_file(dir.path().join("d")).unwrap();
    let line = refused(dir.path());
    assert!(line.contains("slices 2.5 mm apart, as most are, got 1 missing between a and c"), "{line}");
}

#[test]
fn damaged_files_are_refused_or_read() {
    let bytes = std::fs::read(data("enhanced.dcm")).unwrap();
    torture("enhanced.dcm", &bytes, bytes.len());
    // Sequences in one another, with and without an end.
    let item = [&[0xfe, 0xff, 0x00, 0xe0][..], &[0xff; 4]].concat();
    let sequence = [&[0x00, 0x52, 0x29, 0x92, b'S', b'Q', 0, 0][..], &[0xff; 4], &item].concat();
    let deep = [&bytes[..bytes.len() - 132], &sequence.repeat(1000)].concat();
    let dir = tempfile::tempdir().unwrap();
    let line = refused(&write(&dir, "deep.dcm", &deep));
    assert!(line.contains("sequences in one another"), "{line}");
}

#[test]
fn lengths_are_millimetres_and_values_what_the_file_says() {
    let units = |path: &Path| {
        let units = open_default(path).unwrap().info().units.clone();
        [units.value, units.length].map(|unit| unit.map(|unit| unit.to_string()))
    };
    let text = |t: &str| Some(t.to_string());
    assert_eq!(units(&data("series")), [None, text("mm")]);
    assert_eq!(units(&data("enhanced.dcm"))[1], text("mm"));
    // Rescale Type, or Units of PET, before the samples; the files have three syntaxes.
    let with = |tag: [u16; 2], value: &str, count: usize| {
        let dir = tempfile::tempdir().unwrap();
        for (n, file) in SERIES.into_iter().enumerate() {
            let bytes = std::fs::read(data("series").join(file)).unwrap();
            let (implicit, big) = (n % 3 == 1, n % 3 == 2);
            let word = |w: u16| if big { w.to_be_bytes() } else { w.to_le_bytes() };
            let pixels = [word(0x7fe0), word(0x0010)].concat();
            let at = bytes.windows(4).rposition(|w| w == pixels).unwrap();
            let kind = [*b"LO", word(value.len() as u16)].concat();
            let length = if implicit { (value.len() as u32).to_le_bytes().to_vec() } else { kind };
            let own = [&word(tag[0]), &word(tag[1]), &length[..], value.as_bytes()].concat();
            let own = if n < count { own } else { vec![] };
            write(&dir, file, &[&bytes[..at], &own, &bytes[at..]].concat());
        }
        units(dir.path())[0].clone()
    };
    assert_eq!(with([0x0028, 0x1054], "HU", 5), text("HU"));
    assert_eq!(with([0x0028, 0x1054], "HU", 4), None, "not of all slices");
    assert_eq!(with([0x0028, 0x1054], "US", 5), None, "not specified");
    assert_eq!(with([0x0054, 0x1001], "BQML", 5), text("Bq/mL"));
}
