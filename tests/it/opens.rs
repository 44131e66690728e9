//! A file is opened once for all that is asked of it: its fields, steps, times and coordinates, and
//! the plan of a reduction. Each pass over samples (a hash, a measurement) may open it once more.

use crate::common::{run, write_npy};
use isospan::bytes::opens::OpenCount;
use isospan::exec::Silent;
use isospan::formats::{Input, OpenOptions, StepSource, steps_of};
use isospan::pipeline::{ReduceSettings, reduce_series};
use isospan::points::SetKind;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

const DIMS: [usize; 3] = [16, 16, 16];

/// Samples of two bytes, x fastest.
fn samples() -> Vec<u8> {
    let value = |i: usize| ((i % 16) * (i / 16 % 16) + i / 256) as u16;
    (0..4096).flat_map(|i| value(i).to_le_bytes()).collect()
}

/// An uncompressed image of one slice, in one strip.
fn write_tiff(file: &Path, slice: &[u8]) {
    let entries: [(u16, u32); 8] =
        [(256, 16), (257, 16), (258, 16), (259, 1), (262, 1), (273, 200), (278, 16), (279, 512)];
    let mut out = b"II*\0\x08\0\0\0".to_vec();
    out.extend((entries.len() as u16).to_le_bytes());
    for (tag, number) in entries {
        out.extend([&tag.to_le_bytes()[..], &4u16.to_le_bytes(), &1u32.to_le_bytes()].concat());
        out.extend(number.to_le_bytes());
    }
    out.resize(200, 0);
    out.extend(slice);
    fs::write(file, out).unwrap();
}

/// An array of eight chunks.
fn write_zarr(array: &Path) {
    fs::create_dir_all(array).unwrap();
    let meta = "{\"zarr_format\": 2, \"shape\": [16, 16, 16], \"chunks\": [8, 8, 8], \"dtype\": \"<u2\", \
        \"compressor\": null, \"fill_value\": 0, \"order\": \"C\", \"filters\": null}";
    fs::write(array.join(".zarray"), meta).unwrap();
    let all = samples();
    for chunk in 0..8 {
        let [x, y, z] = [chunk % 2, chunk / 2 % 2, chunk / 4].map(|n| 8 * n);
        let rows = (0..64).map(|row| 2 * (x + 16 * (y + row % 8) + 256 * (z + row / 8)));
        let bytes: Vec<u8> = rows.flat_map(|at| all[at..at + 16].to_vec()).collect();
        fs::write(array.join(format!("{}.{}.{}", z / 8, y / 8, x / 8)), bytes).unwrap();
    }
}

/// A folder with an input of each kind.
fn inputs() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path().to_path_buf();
    let head = "NRRD0004\ntype: uint16\ndimension: 3\nendian: little\nencoding: raw\nsizes: 16 16 16\n\
        spacings: 1 1 1\ndata file: a.raw\n\n";
    fs::write(d.join("a.nhdr"), head).unwrap();
    fs::write(d.join("a.raw"), samples()).unwrap();
    write_npy(&d.join("a.npy"), DIMS, |x, y, z| x * y + z);
    fs::create_dir(d.join("stack")).unwrap();
    for (z, slice) in samples().chunks(512).enumerate() {
        write_tiff(&d.join(format!("stack/s{z:02}.tif")), slice);
    }
    write_zarr(&d.join("a.zarr"));
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data");
    fs::copy(data.join("chunks.h5"), d.join("chunks.h5")).unwrap();
    fs::copy(data.join("levels.nc"), d.join("levels.nc")).unwrap();
    (dir, d)
}

fn sum(opens: &BTreeMap<PathBuf, u64>, name: &str) -> u64 {
    opens.iter().filter(|(file, _)| file.ends_with(name)).map(|(_, n)| n).sum()
}

#[test]
fn all_that_is_asked_of_a_file_is_asked_of_one_opening() {
    let (_dir, d) = inputs();
    let count = OpenCount::begin(&d);
    for (name, files) in [
        ("a.nhdr", &["a.nhdr", "a.raw"][..]),
        ("a.npy", &["a.npy"]),
        ("stack", &["s00.tif", "s07.tif"]),
        ("a.zarr", &[".zarray"]),
        ("chunks.h5", &["chunks.h5"]),
        ("levels.nc", &["levels.nc"]),
    ] {
        let any = OpenOptions { field: Some("*".into()), ..OpenOptions::default() };
        let step = steps_of(&[d.join(name)], &OpenOptions::default()).unwrap().remove(0);
        let step = if step.open().is_ok() { step } else { step.with_options(&any) };
        for _ in 0..3 {
            assert!(!step.is_mesh().unwrap());
            assert!(matches!(step.open().unwrap(), Input::Volume(_)));
            step.coordinates().unwrap();
        }
        let opens = count.take();
        for file in files {
            assert_eq!(sum(&opens, file), 1, "{name}: {opens:?}");
        }
    }
}

#[test]
fn a_reduction_opens_each_file_once_a_pass() {
    let (_dir, d) = inputs();
    let count = OpenCount::begin(&d);
    for (name, file, most) in [
        // Opened, and hashed.
        ("a.nhdr", "a.nhdr", 2),
        ("a.nhdr", "a.raw", 2),
        ("a.npy", "a.npy", 2),
        ("chunks.h5", "chunks.h5", 2),
        ("a.zarr", ".zarray", 2),
        // Hashed, and read for the range and for advice; each try reads it for the archive and for
        // its error.
        ("a.zarr", "1.0.1", 9),
        // Parsed besides, by who opens the stack and by who checks that it is what it was.
        ("stack", "s05.tif", 11),
    ] {
        for points in [SetKind::Pyramid, SetKind::Regular] {
            let steps = steps_of(&[d.join(name)], &OpenOptions::default()).unwrap();
            let settings = ReduceSettings { points: Some(points), ..ReduceSettings::default() };
            let out = tempfile::tempdir().unwrap();
            reduce_series(&steps, &settings, &out.path().join("a.isospan"), &run(1), &Silent).unwrap();
            let opens = count.take();
            let found = sum(&opens, file);
            assert!((1..=most).contains(&found), "{name}, {points:?}: {file} of {opens:?}");
        }
    }
}

#[test]
fn a_file_that_was_written_again_is_opened_again() {
    let (_dir, d) = inputs();
    let step = StepSource::from(&*d.join("a.npy"));
    let dims = |step: &StepSource| match step.open().unwrap() {
        Input::Volume(volume) => volume.info().dims,
        Input::Mesh(_) => panic!("a volume"),
    };
    assert_eq!(dims(&step), [16; 3]);
    write_npy(&d.join("a.npy"), [4, 5, 6], |x, _, _| x);
    assert_eq!(dims(&step), [4, 5, 6]);
    // Data that a header names count, too.
    let step = StepSource::from(&*d.join("a.nhdr"));
    assert_eq!(dims(&step), [16; 3]);
    fs::remove_file(d.join("a.raw")).unwrap();
    assert!(step.open().err().unwrap().to_string().contains("a.raw"));
}
