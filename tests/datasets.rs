//! The files of `datasets/` are those of its manifest, and every one has a licence.

use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("datasets")
}

/// The rows of the manifest by its titles: file, sha256, bytes, format, dims, type, range, origin, licence.
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
        .filter(|f| !["MANIFEST.tsv", "README.md", ".gitattributes"].contains(&f.as_str()))
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
fn samples_cover_the_range_of_the_manifest() {
    for [file, _, _, _, dims, kind, range, ..] in rows() {
        let count: usize = dims.split('x').map(|d| d.parse::<usize>().expect("a number")).product();
        let content = fs::read(folder().join(&file)).expect("a listed file");
        let samples: Vec<u16> = match (file.rsplit('.').next(), kind.as_str()) {
            (Some("raw"), "u16 big-endian") => {
                assert_eq!(content.len(), 2 * count);
                content.chunks(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect()
            }
            // The samples stand at the end, before the newline that ends the array.
            (Some("vtk"), "u8") => vtk_samples(&content, count).iter().map(|&b| b.into()).collect(),
            (Some("nhdr"), _) => continue,
            other => panic!("{file}: no reading of {other:?}"),
        };
        let (lo, hi) = (samples.iter().min().expect("samples"), samples.iter().max().expect("samples"));
        assert_eq!(format!("{lo}..{hi}"), range, "{file}");
    }
}

/// The samples of a binary legacy VTK file with one array: those after the lookup table's line.
fn vtk_samples(content: &[u8], count: usize) -> &[u8] {
    const LINE: &[u8] = b"LOOKUP_TABLE default\n";
    let at = content.windows(LINE.len()).position(|w| w == LINE).expect("a lookup table") + LINE.len();
    &content[at..at + count]
}
