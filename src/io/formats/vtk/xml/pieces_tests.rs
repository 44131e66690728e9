//! Indices of VTK (`.pvti`, `.pvtr`, `.pvts`) and the files that they list.

use super::*;
use crate::formats::open_volume;
use crate::formats::tests::{open_coordinates, read_all, try_read_all};
use std::path::{Path, PathBuf};

/// What `tools/make_golden_pieces.py` let VTK write.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/pieces").join(name)
}

/// The samples x + 10 y + 100 z.
fn samples([nx, ny, nz]: [usize; 3], by: f32) -> Vec<f32> {
    let value = |i: usize| (i % nx + 10 * (i / nx % ny) + 100 * (i / (nx * ny))) as f32;
    (0..nx * ny * nz).map(|i| by * value(i)).collect()
}

fn choose(field: &str) -> OpenOptions {
    OpenOptions { field: Some(field.into()), ..OpenOptions::default() }
}

/// A copy of the files of `image.pvti`, one of them changed.
fn copy_of_image(dir: &tempfile::TempDir, name: &str, change: impl Fn(Vec<u8>) -> Vec<u8>) -> PathBuf {
    for file in ["image.pvti", "image_0.vti", "image_1.vti", "image_2.vti", "image_3.vti"] {
        let bytes = std::fs::read(data(file)).unwrap();
        std::fs::write(dir.path().join(file), if file == name { change(bytes) } else { bytes }).unwrap();
    }
    dir.path().join("image.pvti")
}

fn replaced(bytes: Vec<u8>, from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len(), "offsets stay");
    let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).expect(from);
    [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()
}

#[test]
fn pieces_of_several_files_are_one_volume() {
    for name in ["image.pvti", "ghosts.pvti", "rectilinear.pvtr", "curvilinear.pvts"] {
        let (info, values) = read_all(open_volume(&data(name), &choose("heat")).unwrap());
        assert_eq!((info.dims, values), ([9, 8, 7], samples([9, 8, 7], 1.0)), "{name}");
        let count = info.data_files.len();
        assert!(info.format.contains(&format!("{count} files")) && info.files().len() == count + 1);
    }
    for name in ["image.pvti", "ghosts.pvti"] {
        let (info, values) = read_all(open_volume(&data(name), &choose("mass")).unwrap());
        assert_eq!((info.dims, values), ([8, 7, 6], samples([8, 7, 6], 0.5)), "{name}");
        // Half a cell from the point (2, 0, -1).
        assert_eq!(info.geometry.to_world([0.0; 3]), [11.25, 20.125, 29.0]);
    }
    let (info, _) = read_all(open_volume(&data("image.pvti"), &OpenOptions::default()).unwrap());
    assert_eq!((&*info.field.name, info.geometry.to_world([0.0; 3])), ("heat", [11.0, 20.0, 28.0]));
}

#[test]
fn coordinates_of_pieces_are_joined() {
    let found = open_coordinates(&data("rectilinear.pvtr"), &OpenOptions::default()).unwrap();
    let Some(GridCoordinates::Axes(axes)) = found else { panic!("tables") };
    let table = |count: usize, of: fn(f64) -> f64| (0..count).map(|n| of(n as f64)).collect::<Vec<_>>();
    assert_eq!(axes, [table(9, |x| x * x), table(8, |y| y), table(7, |z| 3.0 - z * z * z)]);
    let found = open_coordinates(&data("curvilinear.pvts"), &OpenOptions::default()).unwrap();
    let Some(GridCoordinates::Points(mut points)) = found else { panic!("points") };
    // In parts of any length.
    let mut all = vec![0.0; 3 * 9 * 8 * 7];
    all.chunks_mut(100).for_each(|part| points.fill(part).unwrap());
    points.finish().unwrap();
    for (n, found) in all.chunks(3).enumerate() {
        let [x, y, z] = [n % 9, n / 9 % 8, n / 72].map(|v| v as f64);
        let expected = [x + 0.1 * y, y + 0.1 * z, z + 0.1 * x];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{n}: {found:?}");
    }
    assert!(open_coordinates(&data("image.pvti"), &OpenOptions::default()).unwrap().is_none());
}

#[test]
fn what_does_not_fit_together_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let error = |name: &str, change: &dyn Fn(Vec<u8>) -> Vec<u8>| {
        let path = copy_of_image(&dir, name, change);
        let error = open_volume(&path, &choose("heat")).and_then(try_read_all).expect_err("refused");
        assert_eq!(error.exit_code(), 5, "{error}");
        error.to_string()
    };
    let whole = "Extent=\"2 6 3 7 -1 5\"";
    let piece = format!("<Piece {whole}");
    for (file, from, to, at, what) in [
        ("image.pvti", "Source=\"image_3", "Source=\"image_9", "image.pvti", "image_9.vti"),
        (
            "image.pvti",
            whole,
            "Extent=\"2 6 4 7 -1 5\"",
            "image_1.vti",
            "the Extent '2 6 4 7 -1 5' of the index",
        ),
        ("image_1.vti", &piece, "<Piece Extent=\"2 6 3 7 -1 4\"", "image_1.vti", "'2 6 3 7 -1 4'"),
        ("image_2.vti", "Origin=\"10 20", "Origin=\"11 20", "image_2.vti", "the Origin '10 20 30'"),
        ("image_2.vti", "Name=\"heat\"", "Name=\"cold\"", "image_2.vti", "an array 'heat'"),
        ("image_2.vti", "type=\"ImageData\"", "type=\"Table_arr\"", "image_2.vti", "Table_arr"),
    ] {
        let line = error(file, &|bytes| replaced(bytes, from, to));
        assert!(line.contains(at) && line.contains(what), "{line}");
    }
    // A piece that the index does not list.
    let line = error("image.pvti", &|bytes| {
        let text = String::from_utf8(bytes).unwrap();
        let lines: Vec<&str> = text.lines().filter(|l| !l.contains("image_0")).collect();
        lines.join("\n").into_bytes()
    });
    assert!(line.contains("none for sample (0, 0, 0)"), "{line}");
    // Processes without samples are no missing pieces.
    let path = copy_of_image(&dir, "image.pvti", |bytes| {
        let text = String::from_utf8(bytes).unwrap();
        text.replacen("<Piece", "<Piece Extent=\"0 -1 0 -1 0 -1\" Source=\"none.vti\"/><Piece", 1)
            .into_bytes()
    });
    let (_, values) = read_all(open_volume(&path, &choose("heat")).unwrap());
    assert_eq!(values, samples([9, 8, 7], 1.0));
}

/// The image of a row of two pieces that share the sample (2, 0, 0).
fn row(dir: &tempfile::TempDir, of_first: &str, of_second: &str) -> PathBuf {
    let piece = |name: &str, extent: &str, values: &str| {
        let text = format!(
            "<VTKFile type=\"ImageData\"><ImageData WholeExtent=\"0 4 0 0 0 0\"><Piece Extent=\"{extent}\">\
             <PointData><DataArray type=\"Float64\" Name=\"a\" format=\"ascii\">{values}</DataArray></PointData>\
             </Piece></ImageData></VTKFile>"
        );
        std::fs::write(dir.path().join(name), text).unwrap();
    };
    piece("first.vti", "0 2 0 0 0 0", of_first);
    piece("second.vti", "2 4 0 0 0 0", of_second);
    let index = "<VTKFile type=\"PImageData\"><PImageData WholeExtent=\"0 4 0 0 0 0\">\
                 <Piece Extent=\"0 2 0 0 0 0\" Source=\"first.vti\"/>\
                 <Piece Extent=\"2 4 0 0 0 0\" Source=\"second.vti\"/></PImageData></VTKFile>";
    let path = dir.path().join("row.pvti");
    std::fs::write(&path, index).unwrap();
    path
}

#[test]
fn samples_of_two_pieces_agree() {
    let dir = tempfile::tempdir().unwrap();
    let open = |path: &Path| open_volume(path, &OpenOptions::default());
    let (_, values) = read_all(open(&row(&dir, "1 2 3", "3 4 5")).unwrap());
    assert_eq!(values, [1.0, 2.0, 3.0, 4.0, 5.0]);
    // Zeros of both signs are equal, and so is what is not a number.
    let (_, values) = read_all(open(&row(&dir, "1 2 -0", "0 4 5")).unwrap());
    assert_eq!(values[2], 0.0);
    let (_, values) = read_all(open(&row(&dir, "1 2 nan", "nan 4 5")).unwrap());
    assert!(values[2].is_nan());
    let error = open(&row(&dir, "1 2 3", "3.5 4 5")).and_then(try_read_all).expect_err("they disagree");
    let line = error.to_string();
    for what in [
        "second.vti",
        "sample (2, 0, 0) of the image",
        "expected 3, as first.vti has it",
        "3.5 in second.vti",
    ] {
        assert!(line.contains(what), "{line}");
    }
}

#[test]
fn pieces_that_all_overlap_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let data = "<PointData><DataArray type=\"UInt8\" Name=\"a\" format=\"ascii\">1 1</DataArray></PointData>";
    let piece = format!("<Piece Extent=\"0 1 0 0 0 0\">{data}</Piece>");
    let open = |count: usize| {
        let text = format!(
            "<VTKFile type=\"ImageData\"><ImageData WholeExtent=\"0 1 0 0 0 0\">{}</ImageData></VTKFile>",
            piece.repeat(count)
        );
        let path = dir.path().join("many.vti");
        std::fs::write(&path, text).unwrap();
        open_volume(&path, &OpenOptions::default())
    };
    assert_eq!(read_all(open(3).unwrap()).1, [1.0, 1.0]);
    let line = open(2000).err().expect("refused").to_string();
    assert!(line.contains("pairs of pieces with samples in common"), "{line}");
}
