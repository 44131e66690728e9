//! Tests on real files: the folder named by `ISOSPAN_SHARED_DATA`, whose MANIFEST.tsv says what
//! each file holds. They are ignored unless asked for, as tools/check does where the variable is
//! set.

use super::shared::has_suffix;
use super::tests::try_read_all;
use super::{OpenOptions, open_volume};
use crate::error::Result;
use crate::volume::{ScalarType, VolumeInfo};
use std::path::{Path, PathBuf};

/// A row of the manifest.
struct Row {
    path: PathBuf,
    file: String,
    size: String,
    scalar: String,
    range: String,
    notes: String,
}

fn rows() -> Vec<Row> {
    let root = super::tests::shared_data();
    let text = std::fs::read_to_string(root.join("MANIFEST.tsv")).expect("the manifest is there");
    let row = |line: &str| {
        let cells: Vec<String> = line.split('\t').map(str::to_string).collect();
        let cell = |i: usize| cells.get(i).cloned().unwrap_or_default();
        let (file, size, scalar, range) = (cell(0), cell(4), cell(5), cell(6));
        Row { path: root.join(&file), file, size, scalar, range, notes: cell(12) }
    };
    text.lines().filter(|l| !l.starts_with('#') && !l.starts_with("file\t")).map(row).collect()
}

fn ours(path: &Path) -> bool {
    has_suffix(
        path,
        &[".nrrd", ".nhdr", ".mha", ".mhd", ".nii", ".nii.gz", ".hdr", ".hdr.gz", ".img", ".img.gz", ".npz"],
    ) || path.to_string_lossy().contains("fuzz_artifacts")
}

fn scalar_of(name: &str) -> Option<ScalarType> {
    let numpy = match name {
        "short" => "int16",
        "float" | ">f4" => "float32",
        "double" => "float64",
        other => other,
    };
    // The list has bits after the letter.
    let bits = |t: &ScalarType| format!("{}{}", &t.name()[..1], 8 * t.bytes());
    ScalarType::ALL.into_iter().find(|t| t.name() == numpy || bits(t) == numpy)
}

fn dims_of(size: &str) -> Option<[u64; 3]> {
    let numbers: Vec<u64> = size.split('x').map(str::parse).collect::<std::result::Result<_, _>>().ok()?;
    numbers.try_into().ok()
}

fn range_of(values: &[f32]) -> (f32, f32) {
    values
        .iter()
        .filter(|v| !v.is_nan())
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), &v| (lo.min(v), hi.max(v)))
}

/// What opening and reading a file gives.
fn read(path: &Path) -> Result<(VolumeInfo, Vec<f32>)> {
    let source = open_volume(path, &OpenOptions::default())?;
    let info = source.info().clone();
    Ok((info, try_read_all(source)?))
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn volumes_have_the_manifests_dims_type_and_range() {
    let mut seen = 0;
    for row in rows().into_iter().filter(|r| r.file.starts_with("volumes/") && ours(&r.path)) {
        let (info, values) = read(&row.path).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(Some(info.dims), dims_of(&row.size), "{}", row.file);
        assert_eq!(Some(info.field.scalar), scalar_of(&row.scalar), "{}", row.file);
        let (lo, hi) = row.range.split_once("..").expect("a range");
        let (lo, hi) = (lo.parse::<f32>().unwrap(), hi.parse::<f32>().unwrap());
        let scaled = |v: f32| (info.slope * f64::from(v) + info.intercept) as f32;
        assert_eq!(range_of(&values), (scaled(lo), scaled(hi)), "{}", row.file);
        assert!(info.geometry.is_valid());
        seen += 1;
    }
    assert!(seen >= 6, "{seen} volumes");
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn variants_are_read_right_or_refused_clearly() {
    for row in rows().into_iter().filter(|r| r.file.starts_with("variants/") && ours(&r.path)) {
        let result = read(&row.path);
        let (dims, scalar) = (dims_of(&row.size), scalar_of(&row.scalar));
        match &result {
            Ok((info, _)) if row.notes.starts_with("loads") => {
                // Of four axes the first three are of space.
                let first: Vec<&str> = row.size.split('x').take(3).collect();
                let expected = (dims_of(&first.join("x")), scalar);
                assert_eq!((Some(info.dims), Some(info.field.scalar)), expected, "{}", row.file);
            }
            // Halves of pairs, about which the manifest says nothing.
            Ok((info, _)) => assert!(row.notes == "not loaded" && info.dims == [64, 64, 10], "{}", row.file),
            Err(e) => {
                let line = e.to_string();
                assert!(e.exit_code() == 5 && !line.contains('\n'), "{line}");
                let readable = dims.is_some() && scalar.is_some() && row.notes.starts_with("loads");
                assert!(!readable || row.file.contains("_bz2"), "refused: {line}");
            }
        }
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn known_traps_are_named() {
    let rows = rows();
    for (file, message) in [
        ("pine_root_missing_slices.mhd", "256 missing: pine_root.1, pine_root.2"),
        ("BallBinary30x30x30_byteskip_minus_five.nhdr", "-5"),
        ("BallBinary30x30x30_nifti.nhdr", "more bytes"),
        ("BallBinary30x30x30_bz2.nrrd", "bzip2"),
        ("test1d_ascii.nrrd", "dimension"),
        ("multi_component_i16.nii.gz", "dim[5]"),
        ("rgb/3D.nii", "RGB"),
        ("rgba/4D.nii", "RGBA"),
        ("complex/complex32.nii", "complex"),
        ("minimal_extended_hdr.nii", "dim[0]"),
        ("avg152T1_LR_nifti.hdr.gz", "avg152T1_LR_nifti.img"),
    ] {
        let row = rows
            .iter()
            .find(|r| r.file.ends_with(file))
            .unwrap_or_else(|| panic!("{file} is in the manifest"));
        let line = read(&row.path).expect_err(file).to_string();
        assert!(line.contains(message), "{line}");
    }
}
