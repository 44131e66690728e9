//! The files of `datasets/` are those of its manifest, and every one has a licence.

use isospan::formats::{OpenOptions, open_volume};
use isospan::grid::IndexBox;
use isospan::volume::VolumeSource;
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("datasets")
}

/// The rows of the manifest by its titles: file, sha256, bytes, format, dims, type, range, origin,
/// licence.
fn rows() -> Vec<[String; 9]> {
    let text = fs::read_to_string(folder().join("MANIFEST.tsv")).expect("the manifest is there");
    let mut rows = text.lines().map(|line| {
        let fields: Vec<_> = line.split('\t').map(str::to_owned).collect();
        <[String; 9]>::try_from(fields).unwrap_or_else(|f| panic!("nine fields a row, not {f:?}"))
    });
    assert_eq!(rows.next().expect("titles")[..3], ["file", "sha256", "bytes"]);
    rows.collect()
}

/// All files below a folder, relative to it.
fn files_below(root: &Path, at: &Path, found: &mut BTreeSet<String>) {
    for entry in fs::read_dir(at).expect("a readable folder") {
        let path = entry.expect("a readable entry").path();
        if path.is_dir() {
            files_below(root, &path, found);
        } else {
            let relative = path.strip_prefix(root).expect("below the root");
            found.insert(relative.to_string_lossy().replace('\\', "/"));
        }
    }
}

#[test]
fn files_have_the_checksums_of_the_manifest() {
    let rows = rows();
    assert!(!rows.is_empty());
    for [file, sha256, bytes, ..] in &rows {
        let content = fs::read(folder().join(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        assert_eq!(content.len().to_string(), *bytes, "{file}");
        let got: String = Sha256::digest(&content).iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(got, *sha256, "{file}");
    }
}

#[test]
fn every_file_is_listed_and_its_licence_is_there() {
    let mut found = BTreeSet::new();
    files_below(&folder(), &folder(), &mut found);
    let listed: BTreeSet<String> = rows().into_iter().map(|[file, ..]| file).collect();
    let data: BTreeSet<String> = found
        .iter()
        .filter(|f| !f.starts_with("licenses/") && !f.starts_with("pictures/"))
        .filter(|f| !["MANIFEST.tsv", "generated.tsv", "README.md", ".gitattributes"].contains(&f.as_str()))
        .filter(|f| !f.contains(".isospan/") && !f.ends_with(".ply"))
        .cloned()
        .collect();
    assert_eq!(data, listed);
    for [file, .., licence] in rows() {
        let text = licence.split(": ").nth(1).unwrap_or_else(|| panic!("{file}: licence {licence:?}"));
        assert!(found.contains(text), "{file}: {text} is missing");
    }
}

#[test]
fn the_readers_find_what_the_manifest_says() {
    let mut read = 0;
    for [file, _, _, format, dims, kind, range, ..] in rows() {
        if format.starts_with("samples of") {
            continue;
        }
        let source = open_volume(&folder().join(&file), &OpenOptions::default());
        let VolumeSource::Random(volume) = source.unwrap_or_else(|e| panic!("{e}")) else {
            panic!("{file}: uncompressed files are mapped");
        };
        let info = volume.info();
        assert_eq!(info.dims.map(|d| d.to_string()).join("x"), dims, "{file}");
        assert_eq!(kind.split(' ').next(), Some(info.field.scalar.name()), "{file}");
        let whole = IndexBox::whole(info.dims);
        let mut values = vec![0.0; whole.len()];
        volume.read_box(whole, &mut values).unwrap_or_else(|e| panic!("{e}"));
        let lo = values.iter().copied().fold(f32::INFINITY, f32::min);
        let hi = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        assert_eq!(format!("{lo}..{hi}"), range, "{file}");
        read += 1;
    }
    assert_eq!(read, 2);
}
