//! Volumes at the edge of what a header can say, in each format that a few lines can write: axes of
//! a single sample, and claims of 10^18 samples. Each is refused by `reduce` in one line, the
//! second at once.

use crate::common::*;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

fn isospan(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap()
}

const FORMATS: [&str; 9] = ["nrrd", "mha", "npy", "nii", "vti", "vtk", "tifs", "zarr", "raw"];

/// Bytes of a volume of u8 that claims `dims`, and has `data`; for TIFF of one slice, for Zarr of
/// the metadata.
fn bytes(format: &str, dims: [u64; 3], data: &[u8]) -> Vec<u8> {
    let [x, y, z] = dims;
    let text = match format {
        "nrrd" => format!("NRRD0004\ntype: uint8\ndimension: 3\nsizes: {x} {y} {z}\nencoding: raw\n\n"),
        "mha" => format!(
            "ObjectType = Image\nNDims = 3\nDimSize = {x} {y} {z}\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
        ),
        "npy" => {
            let dict = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': ({z}, {y}, {x}), }}");
            let padded = format!("{dict:<117}\n");
            return [b"\x93NUMPY\x01\x00\x76\x00", padded.as_bytes(), data].concat();
        }
        "nii" => return nifti(dims, data),
        "vti" => format!(
            "<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
             <ImageData WholeExtent=\"0 {x1} 0 {y1} 0 {z1}\" Origin=\"0 0 0\" Spacing=\"1 1 1\">\n\
             <Piece Extent=\"0 {x1} 0 {y1} 0 {z1}\"><PointData Scalars=\"s\">\n\
             <DataArray type=\"UInt8\" Name=\"s\" format=\"ascii\">{}</DataArray>\n\
             </PointData></Piece></ImageData></VTKFile>\n",
            data.iter().map(|v| format!("{v} ")).collect::<String>(),
            x1 = x - 1,
            y1 = y - 1,
            z1 = z - 1,
        ),
        "vtk" => format!(
            "# vtk DataFile Version 3.0\nt\nBINARY\nDATASET STRUCTURED_POINTS\nDIMENSIONS {x} {y} {z}\nORIGIN 0 0 0\n\
             SPACING 1 1 1\nPOINT_DATA {}\nSCALARS s unsigned_char\nLOOKUP_TABLE default\n",
            x * y * z
        ),
        "tifs" => return tiff(x as u32, y as u32, data),
        "zarr" => format!(
            "{{\"zarr_format\": 2, \"shape\": [{z}, {y}, {x}], \"chunks\": [{}, {}, {}], \"dtype\": \"|u1\", \
             \"compressor\": null, \"fill_value\": 0, \"order\": \"C\", \"filters\": null}}",
            z.min(64),
            y.min(64),
            x.min(64)
        ),
        "raw" => String::new(),
        other => panic!("{other}"),
    };
    let data = if ["vti", "zarr"].contains(&format) { &[] } else { data };
    [text.as_bytes(), data].concat()
}

/// NIfTI-2, whose dimensions are 64 bits wide.
fn nifti([x, y, z]: [u64; 3], data: &[u8]) -> Vec<u8> {
    let mut head = vec![0; 544];
    let mut put = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &540u32.to_le_bytes());
    put(4, b"n+2\0\r\n\x1a\n");
    put(12, &2u16.to_le_bytes());
    put(14, &8u16.to_le_bytes());
    for (n, d) in [3, x, y, z, 1, 1, 1, 1].into_iter().enumerate() {
        put(16 + 8 * n, &d.to_le_bytes());
        put(104 + 8 * n, &1f64.to_le_bytes());
    }
    put(168, &544u64.to_le_bytes());
    [head, data.to_vec()].concat()
}

/// One uncompressed strip behind a directory.
fn tiff(x: u32, y: u32, data: &[u8]) -> Vec<u8> {
    let tags = [
        (256u16, x),
        (257, y),
        (258, 8),
        (259, 1),
        (262, 1),
        (273, 8 + 2 + 9 * 12 + 4),
        (277, 1),
        (278, y),
        (279, x.saturating_mul(y)),
    ];
    let mut out = b"II\x2a\0\x08\0\0\0".to_vec();
    out.extend((tags.len() as u16).to_le_bytes());
    for (tag, value) in tags {
        out.extend(tag.to_le_bytes());
        out.extend([4, 0, 1, 0, 0, 0]);
        out.extend(value.to_le_bytes());
    }
    [out, vec![0; 4], data.to_vec()].concat()
}

/// Writes a volume that claims `dims` and has the samples of `there`, and returns the arguments
/// that name it.
fn volume(dir: &Path, format: &str, dims: [u64; 3], there: [u64; 3]) -> Vec<String> {
    let path: PathBuf = dir.join(format!("v.{format}"));
    let slice = (there[0] * there[1]) as usize;
    let data: Vec<u8> = (0..slice * there[2] as usize).map(|i| (i * 37 % 251) as u8).collect();
    match format {
        "tifs" => {
            fs::create_dir(&path).unwrap();
            for (n, part) in data.chunks(slice).enumerate() {
                fs::write(path.join(format!("s{n}.tif")), bytes(format, dims, part)).unwrap();
            }
        }
        "zarr" => {
            fs::create_dir(&path).unwrap();
            fs::write(path.join(".zarray"), bytes(format, dims, &[])).unwrap();
            if dims == there {
                fs::write(path.join("0.0.0"), data).unwrap();
            }
        }
        _ => fs::write(&path, bytes(format, dims, &data)).unwrap(),
    }
    let mut args = vec![path.to_str().unwrap().to_owned()];
    if format == "raw" {
        args.extend(["--dims".into(), format!("{},{},{}", dims[0], dims[1], dims[2])]);
        args.extend(["--type".into(), "uint8".into()]);
    }
    args
}

fn with<'a>(before: &[&'a str], volume: &'a [String], after: &[&'a str]) -> Vec<&'a str> {
    let volume: Vec<&str> = volume.iter().map(String::as_str).collect();
    [before, &volume, after].concat()
}

#[test]
fn axes_of_one_sample_are_read_and_cannot_be_meshed() {
    for format in FORMATS {
        for dims in [[1, 1, 1], [7, 1, 1], [1, 6, 1], [1, 1, 5], [6, 5, 1], [1, 5, 6], [6, 1, 5], [2, 2, 2]] {
            let dir = tempfile::tempdir().unwrap();
            let d = dir.path();
            // A single slice in a folder is a stack of one.
            let volume = volume(d, format, dims, dims);
            let info = isospan(d, &with(&["info", "--json"], &volume, &[]));
            let told = String::from_utf8_lossy(&info.stderr).into_owned();
            assert!(info.status.success(), "{format} {dims:?}: {told}");
            let json: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
            assert_eq!(json["info"]["dims"], serde_json::json!(dims), "{format}");
            let reduced = isospan(
                d,
                &with(
                    &["-q", "reduce"],
                    &volume,
                    &["-o", "a.isospan", "--points", "regular", "--fraction", "1"],
                ),
            );
            let line = String::from_utf8(reduced.stderr).unwrap();
            if dims.contains(&1) {
                // Nothing lies between samples along such an axis: there is nothing to mesh.
                assert_eq!((reduced.status.code(), line.trim_end().lines().count()), (Some(5), 1), "{line}");
                assert!(line.contains("every axis needs at least 2 samples"), "{format} {dims:?}: {line}");
            } else {
                assert!(reduced.status.success(), "{format} {dims:?}: {line}");
                assert!(isospan(d, &["check", "a.isospan"]).status.success());
            }
        }
    }
}

#[test]
fn claims_of_a_million_million_million_samples_are_refused_at_once() {
    for format in FORMATS {
        let dir = tempfile::tempdir().unwrap();
        let d = dir.path();
        // Slices of a stack are counted by their files: there each claims as much.
        let dims = if format == "tifs" { [1 << 30, 1 << 30, 2] } else { [1_000_000; 3] };
        let volume = volume(d, format, dims, [2, 2, 2]);
        let before = folder(d).len();
        let started = Instant::now();
        let out = isospan(d, &with(&["-q", "reduce"], &volume, &["-o", "a.isospan"]));
        let line = String::from_utf8(out.stderr).unwrap();
        assert!(matches!(out.status.code(), Some(2 | 4 | 5)), "{format}: {:?}: {line}", out.status);
        assert_eq!(line.trim_end().lines().count(), 1, "{format}: {line}");
        assert!(started.elapsed() < Duration::from_secs(600), "{format}: {:?}", started.elapsed());
        assert_eq!(folder(d).len(), before, "{format}: nothing is left");
    }
}
