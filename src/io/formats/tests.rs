//! Helpers for the tests of all readers, and tests of the doors.

use super::coordinates::GridCoordinates;
use super::{OpenOptions, RawLayout, StepSource, open, open_volume, pick_field};
use crate::error::Result;
use crate::exec::CancelToken;
use crate::grid::IndexBox;
use crate::volume::{FieldInfo, ScalarType, VolumeInfo, VolumeSource, convert::convert_row};
use std::io::Write;
use std::path::{Path, PathBuf};

/// The folder of real data sets, for tests that are ignored unless asked for.
pub(crate) fn shared_data() -> PathBuf {
    PathBuf::from(
        std::env::var_os("ISOSPAN_SHARED_DATA").expect("ISOSPAN_SHARED_DATA names a folder of real data"),
    )
}

/// Whether a file is a mesh.
pub(crate) fn is_mesh(path: &Path, options: &OpenOptions) -> Result<bool> {
    Ok(open(path, options)?.is_mesh())
}

/// The coordinates of a file.
pub(crate) fn open_coordinates(path: &Path, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
    open(path, options)?.coordinates(options)
}

/// Writes a file in a temporary folder.
pub(crate) fn write(dir: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = dir.path().join(name);
    // Some file systems flush a file that is cut and written again; a new one costs nothing.
    let _ = std::fs::remove_file(&path);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// The samples 1000, 1001, … of a 4 x 3 x 2 volume of u16.
pub(crate) fn ramp(big_endian: bool) -> Vec<u8> {
    let sample = |i: u16| if big_endian { i.to_be_bytes() } else { i.to_le_bytes() };
    (1000..1024).flat_map(sample).collect()
}

pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut gz = flate2::write::GzEncoder::new(vec![], flate2::Compression::fast());
    gz.write_all(bytes).unwrap();
    gz.finish().unwrap()
}

/// All values of a source, x fastest; panics on an error.
pub(crate) fn read_all(source: VolumeSource) -> (VolumeInfo, Vec<f32>) {
    let info = source.info().clone();
    (info, try_read_all(source).unwrap())
}

/// All values of a source, x fastest.
pub(crate) fn try_read_all(source: VolumeSource) -> Result<Vec<f32>> {
    let info = source.info().clone();
    let whole = IndexBox::whole(info.dims);
    if let VolumeSource::Random(reader) = &source {
        let mut values = vec![0.0; whole.len()];
        reader.read_box(whole, &mut values)?;
        return Ok(values);
    }
    let (mut stream, mut bytes, mut values) = (source.into_stream(), vec![], vec![]);
    while let Some(slab) = stream.next_slab(&mut bytes)? {
        let mut part = vec![0.0; slab.len()];
        convert_row(&bytes, info.field.scalar, false, info.slope, info.intercept, info.missing, &mut part);
        assert_eq!(whole.offset(slab.lo), values.len());
        values.extend(part);
    }
    assert_eq!(values.len(), whole.len());
    Ok(values)
}

/// Whether a damaged file is refused, or read whole, in an orderly way; panics are the test's
/// failures.
pub(crate) fn survives(path: &Path) -> bool {
    let opened = open_volume(path, &OpenOptions::default());
    match opened.and_then(try_read_all) {
        Ok(_) => true,
        Err(e) => {
            let (line, folder) = (e.to_string(), path.parent().expect("a folder").display().to_string());
            assert!(!line.contains('\n') && line.contains(&folder), "{line}");
            false
        }
    }
}

/// Cuts a small file at every length and flips bytes all over; every cut inside `needed` must
/// be refused.
pub(crate) fn torture(name: &str, bytes: &[u8], needed: usize) {
    let dir = tempfile::tempdir().unwrap();
    assert!(survives(&write(&dir, name, bytes)), "the undamaged file is read");
    for cut in 0..bytes.len() {
        let read = survives(&write(&dir, name, &bytes[..cut]));
        assert!(!(read && cut < needed), "{name} cut to {cut} bytes was read");
    }
    for at in 0..bytes.len().min(1500) {
        for flip in [0x01, 0x10, 0x80, 0xff] {
            let mut damaged = bytes.to_vec();
            damaged[at] ^= flip;
            survives(&write(&dir, name, &damaged));
        }
    }
}

/// As the libraries of N5, neuroglancer's (cloud-volume) and OpenFOAM write them.
#[test]
fn folders_of_other_programs_are_named() {
    let n5 =
        r#"{"dataType":"uint8","compression":{"type":"gzip"},"blockSize":[64,64,64],"dimensions":[9,9,9]}"#;
    let info = r#"{"data_type": "uint8", "num_channels": 1, "scales": [{"key": "8_8_8"}], "type": "image"}"#;
    let meshes = r#"{"@type": "neuroglancer_multilod_draco"}"#;
    for (file, content, kind, help) in [
        ("attributes.json", r#"{"n5":"2.5.1"}"#, "an N5 container", "OME-Zarr"),
        ("attributes.json", n5, "an array of N5", "OME-Zarr"),
        ("info", info, "a precomputed volume of neuroglancer", ".npy"),
        ("info", meshes, "precomputed data of neuroglancer", ".npy"),
        ("system/controlDict", "FoamFile {}", "an OpenFOAM case", "foamToVTK"),
        ("slice_01.bmp", "BM\x36\x10\0\0\0\0\0\0", "a BMP picture", "TIFF slices"),
        ("info", "{}", "none of these", "name a file in it"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        let refused = |path: &Path| {
            let error = open_volume(path, &OpenOptions::default()).err().expect("refused");
            assert_eq!(error.exit_code(), 5);
            error.to_string()
        };
        let line = refused(dir.path());
        assert!(line.contains(kind) && line.contains(help), "{line}");
        if matches!(file, "attributes.json" | "info") {
            let line = refused(&path);
            assert!(line.contains(kind), "{line}");
        }
        if file.ends_with(".bmp") {
            let line = refused(&dir.path().join("*.bmp"));
            assert!(line.contains(kind) && line.contains(help), "{line}");
        }
    }
}

/// What `tools/make_golden_decoders.py` let the programs of each field write. Cut short anywhere
/// before the last sample, they are refused.
#[test]
fn files_of_other_programs_have_their_samples() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/decoders");
    let each = (0..16).flat_map(|z| (0..16).flat_map(move |y| (0..16).map(move |x| x + 3 * y + 7 * z)));
    let expected: Vec<f32> = each.map(|v: u16| f32::from(v)).collect();
    let dir = tempfile::tempdir().unwrap();
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        let (info, values) = read_all(open_volume(&path, &OpenOptions::default()).expect(name));
        assert_eq!((info.dims, &values), ([16; 3], &expected), "{name}");
        let bytes = std::fs::read(&path).unwrap();
        for part in 1..8 {
            let cut = write(&dir, name, &bytes[..bytes.len() * part / 8]);
            let read = open_volume(&cut, &OpenOptions::default()).and_then(try_read_all);
            // The description of a TIFF file and padding may lie behind the samples.
            assert!(
                read.is_err() || read.is_ok_and(|values| values == expected),
                "{name}, {part} of 8 parts"
            );
        }
        count += 1;
    }
    assert!(count > 30, "{count} files");
}

fn field(name: &str, components: u32) -> FieldInfo {
    FieldInfo { name: name.into(), scalar: ScalarType::F32, components }
}

#[test]
fn fields_are_picked_or_listed() {
    let path = Path::new("f.vti");
    let fields = [field("velocity", 3), field("speed", 1), field("heat", 1)];
    assert_eq!(pick_field(path, &fields[..2], None).unwrap(), 1);
    assert_eq!(pick_field(path, &fields, Some("heat")).unwrap(), 2);
    for wanted in [None, Some("velocity"), Some("none")] {
        let error = pick_field(path, &fields, wanted).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(
            error.to_string().contains("velocity (3 x float32, not scalar), speed (float32), heat (float32)"),
            "{error}"
        );
    }
    assert_eq!(pick_field(path, &fields[..1], None).unwrap_err().exit_code(), 5);
    assert_eq!(pick_field(path, &[], None).unwrap_err().exit_code(), 5);
}

#[test]
fn unknown_kinds_are_told_what_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let open = |name: &str, bytes: &[u8]| {
        open_volume(&write(&dir, name, bytes), &OpenOptions::default()).err().expect("refused")
    };
    assert!(open("a.png", b"\x89PNG").to_string().contains("MetaImage"));
    for (name, bytes, kind, help) in [
        ("a.czi", &b"ZISRAWFILE\0"[..], "a Zeiss CZI file", "bfconvert"),
        ("a.vgl", b"FORMAT\n", "a file of VGStudio", "`dims`"),
        ("p", b"\nFoamFile\n{", "an OpenFOAM file", "foamToVTK"),
        ("case.foam", b"\n", "an OpenFOAM case", "foamToVTK"),
        ("slice", b"BM\x36\x10\0\0\0\0\0\0\x36\0\0\0", "a BMP picture", "TIFF slices"),
        ("BM", b"BM and other letters", "none of these", "`dims`"),
        ("slice", b"RIFF\x10\0\0\0WEBPVP8 ", "a WebP picture", "TIFF slices"),
        (
            "a.xmf",
            b"<?xml version=\"1.0\" ?>\n<!DOCTYPE Xdmf>\n<Xdmf Version=\"3.0\">",
            "an XDMF file",
            "HDF5",
        ),
        ("a.sgy", b"C 1 CLIENT", "SEG-Y", "segyio"),
        ("a.mgz", b"\0\0\0\x01", "FreeSurfer", "mri_convert"),
        ("a.other", b"what", "none of these: it begins with 77 68 61 74", "`dims`"),
    ] {
        let line = open(name, bytes).to_string();
        assert!(line.contains(kind) && line.contains(help), "{line}");
    }
    let scans = tempfile::tempdir().unwrap();
    write(&scans, "IM0002", b"ZISRAWFILE\0");
    let line = open_volume(scans.path(), &OpenOptions::default()).err().expect("refused").to_string();
    assert!(line.contains("a Zeiss CZI file") && line.contains("bfconvert"), "{line}");
    // A case is named by an empty file; that of another name is empty.
    let line = open("case.foam", b"").to_string();
    assert!(line.contains("an OpenFOAM case") && line.contains("foamToVTK"), "{line}");
    assert!(open("case", b"").to_string().contains("empty"));
    assert_eq!(open("a.raw", b"1234").exit_code(), 2);
    let layout = RawLayout { dims: [2; 3], scalar: ScalarType::U8, big_endian: false, offset: 0 };
    let options = OpenOptions { raw: Some(layout), ..OpenOptions::default() };
    let nrrd = write(&dir, "a.nrrd", b"NRRD0004\n");
    let error = open_volume(&nrrd, &options).err().expect("refused");
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("an NRRD file"), "{error}");
}

/// A series in one compressed stream is unpacked once, whatever its format: each step, decoded by
/// itself, would decode those before it.
#[test]
fn compressed_series_are_unpacked_once() {
    let dir = tempfile::tempdir().unwrap();
    let samples: Vec<u8> = (0..72u16).flat_map(u16::to_le_bytes).collect();
    let mut packed = flate2::write::GzEncoder::new(vec![], flate2::Compression::fast());
    packed.write_all(&samples).unwrap();
    let packed = packed.finish().unwrap();
    let nrrd = "NRRD0005\ntype: ushort\ndimension: 4\nsizes: 4 3 2 3\nendian: little\nencoding: gzip\n\n";
    let meta = "ObjectType = Image\nNDims = 4\nDimSize = 4 3 2 3\nElementType = MET_USHORT\n\
                CompressedData = True\nElementDataFile = LOCAL\n";
    for (name, head) in [("a.nrrd", nrrd), ("a.mha", meta)] {
        let path = write(&dir, name, &[head.as_bytes(), &packed[..]].concat());
        let options = OpenOptions { field: Some("t1".into()), ..OpenOptions::default() };
        assert_eq!(StepSource::new(&path, &options).packed_bytes().unwrap(), Some(144), "{name}");
        let cancel = CancelToken::default();
        let frames = StepSource::new(&path, &options).unpack(dir.path(), &cancel).unwrap();
        for t in 0..3 {
            let reader = frames.open(&format!("t{t}")).unwrap();
            let (info, values) = read_all(VolumeSource::Random(reader));
            let expected: Vec<f32> = (24 * t..24 * t + 24).map(|i| i as f32).collect();
            assert_eq!((info.field.name, values), (format!("t{t}"), expected), "{name}");
        }
        let longer = [head.as_bytes(), &packed[..packed.len() - 9]].concat();
        let error =
            StepSource::new(&write(&dir, name, &longer), &options).unpack(dir.path(), &cancel).err().unwrap();
        assert_eq!(error.exit_code(), 5, "{error}");
    }
    let one = nrrd.replace("sizes: 4 3 2 3", "sizes: 4 3 6 1");
    let path = write(&dir, "b.nrrd", &[one.as_bytes(), &packed[..]].concat());
    assert_eq!(StepSource::from(&*path).packed_bytes().unwrap(), None, "of one volume");
}
