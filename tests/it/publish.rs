//! `isospan publish`: a folder with a copy of the archive, which replaces nothing by chance; and
//! archives that a program gets by ranges, as the page in it does.

use crate::common::*;
use isospan::Archive;
use isospan::bytes::remote::{Fetched, Ranges, Wanted, add_host};
use isospan::pipeline::{Amount, archive_files};
use isospan::points::SetKind;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

fn archive(dir: &Path) -> PathBuf {
    let (input, out) = (dir.join("waves.npy"), dir.join("waves.isospan"));
    write_npy(&input, [40, 33, 37], waves);
    reduce(&input, &settings(SetKind::Halton, Amount::Fraction(0.25), 3_000), &out, 2);
    out
}

/// The files of a folder and its folders, by their names in it.
fn all_files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let (mut found, mut folders) = (BTreeMap::new(), vec![folder.to_path_buf()]);
    while let Some(here) = folders.pop() {
        for entry in fs::read_dir(here).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_path_buf(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

#[cfg(feature = "view")]
mod command {
    use super::*;
    use std::process::{Command, Output};

    fn publish(dir: &Path, args: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_isospan"))
            .current_dir(dir)
            .arg("publish")
            .args(args)
            .output()
            .unwrap()
    }

    fn done(dir: &Path, args: &[&str]) {
        let output = publish(dir, args);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    fn refused(dir: &Path, args: &[&str], why: &str) {
        let output = publish(dir, args);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) || output.status.code() == Some(5), "{args:?}: {text}");
        assert!(text.contains(why) && text.trim_end().lines().count() == 1, "{args:?}: {text}");
    }

    #[test]
    fn a_folder_has_the_page_and_the_archive_and_replaces_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let d = dir.path();
        let archive = archive(d);
        // Neither is part of the archive.
        fs::write(archive.join("mesh/stray.txt"), "stray").unwrap();
        let unpacked = Command::new(env!("CARGO_BIN_EXE_isospan"))
            .args(["unpack", "-q"])
            .arg(&archive)
            .output()
            .unwrap();
        assert!(unpacked.status.success());
        done(d, &["waves.isospan", "-o", "viewer"]);
        let files = all_files(&d.join("viewer"));
        let (copied, page): (BTreeMap<_, _>, _) =
            files.into_iter().partition(|(path, _)| path.starts_with("waves.isospan"));
        let named: BTreeMap<PathBuf, Vec<u8>> = archive_files(&archive)
            .unwrap()
            .into_iter()
            .map(|file| (Path::new("waves.isospan").join(&file), fs::read(archive.join(file)).unwrap()))
            .collect();
        assert!(copied.len() > 3 && copied == named, "{:?}", copied.keys());
        let names: Vec<&str> = page.keys().map(|name| name.to_str().unwrap()).collect();
        let expected = [
            "index.html",
            "isospan.wasm.gz",
            "licences.txt",
            "local.js",
            "main.js",
            "scene.js",
            "source.js",
            "spectrum.js",
            "style.css",
            "three.js",
            "worker.js",
        ];
        assert_eq!(names, expected);
        let index = String::from_utf8(page[Path::new("index.html")].clone()).unwrap();
        assert!(index.contains("name=\"isospan-archives\" content=\"waves.isospan\""));

        // What is there stays, unless it is such a folder and --force is given.
        refused(d, &["waves.isospan", "-o", "viewer"], "--force");
        fs::write(d.join("viewer/old"), "old").unwrap();
        done(d, &["waves.isospan", "-o", "viewer", "--force"]);
        assert!(!d.join("viewer/old").exists());
        fs::create_dir(d.join("mine")).unwrap();
        done(d, &["waves.isospan", "-o", "mine"]);
        fs::create_dir(d.join("other")).unwrap();
        fs::write(d.join("other/letter"), "dear").unwrap();
        refused(d, &["waves.isospan", "-o", "other", "--force"], "isospan publish made");
        refused(d, &["waves.isospan", "-o", "waves.npy", "--force"], "it is a file");
        refused(d, &["waves.isospan", "-o", "waves.isospan/viewer"], "lies in waves.isospan");
        refused(d, &["waves.isospan", "viewer/waves.isospan", "-o", "new"], "has this name");
        refused(d, &["https://example.org/a.isospan", "-o", "new"], "copy the archive");
        refused(d, &["viewer", "-o", "new"], "a folder of other files");
        // A file of the archive that is missing.
        fs::remove_file(archive.join("mesh/000000.seg")).unwrap();
        assert_eq!(publish(d, &["waves.isospan", "-o", "new"]).status.code(), Some(1));
        let mut left: Vec<_> = fs::read_dir(d).unwrap().map(|e| e.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, ["mine", "other", "viewer", "waves.isospan", "waves.npy"], "nothing half-written");
    }
}

/// The files below a folder.
struct Folder(PathBuf);

impl Ranges for Folder {
    fn get(&self, name: &str, wanted: &Wanted) -> io::Result<Fetched> {
        let bytes = fs::read(self.0.join(name))?;
        let len = bytes.len() as u64;
        let range = match wanted {
            Wanted::Last(count) => len.saturating_sub(*count)..len,
            Wanted::At(range) => range.clone(),
        };
        let bytes = bytes[range.start as usize..range.end as usize].to_vec();
        Ok(Fetched { len, range, bytes })
    }
}

#[test]
fn a_program_gets_files_by_ranges_itself() {
    let dir = tempfile::tempdir().unwrap();
    let local = Archive::open(archive(dir.path())).unwrap();
    add_host("folder", Folder(dir.path().to_path_buf()));
    let there = Archive::open("host://folder/waves.isospan").unwrap();
    for isovalue in [-0.2, 0.3] {
        let (a, b) = (local.surface(isovalue).unwrap(), there.surface(isovalue).unwrap());
        assert!(a.triangles.len() > 500 && a == b);
    }
    assert_eq!(local.count(0.1).unwrap().active_tetrahedra, there.count(0.1).unwrap().active_tetrahedra);
    let error = Archive::open("host://folder/none.isospan").err().unwrap().to_string();
    assert!(error.contains("host://folder/none.isospan/manifest.json"), "{error}");
    let error = Archive::open("host://nobody/waves.isospan").err().unwrap().to_string();
    assert!(error.contains("'nobody'"), "{error}");
}
