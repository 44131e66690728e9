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
    #[cfg_attr(not(has_wasm), ignore = "wants the page's WebAssembly: run tools/viewer/wasm")]
    fn a_folder_has_the_page_and_the_archive_and_replaces_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let d = dir.path();
        let archive = archive(d);
        // It is no part of the archive.
        fs::write(archive.join("mesh/stray.txt"), "stray").unwrap();
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
            "published.json",
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
        done(d, &["waves.isospan", "-o", "viewer", "--force"]);
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

/// What a folder holds that `publish` did not write stays, and keeps the folder.
#[cfg(all(feature = "view", unix))]
mod others {
    use super::*;
    use std::process::{Command, Stdio};
    use std::time::Duration;

    /// The exit code and the words of a command that may take a minute.
    fn publish(dir: &Path, args: &[&str]) -> (Option<i32>, String) {
        let program = env!("CARGO_BIN_EXE_isospan");
        let output = Command::new("timeout")
            .args(["-s", "KILL", "60", program, "publish"])
            .args(args)
            .current_dir(dir)
            .output()
            .unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    }

    /// Each file, folder and link below a folder, without following one.
    fn state(folder: &Path) -> BTreeMap<PathBuf, String> {
        let (mut found, mut folders) = (BTreeMap::new(), vec![folder.to_path_buf()]);
        while let Some(here) = folders.pop() {
            for entry in fs::read_dir(here).unwrap() {
                let (path, about) = entry.map(|e| (e.path(), e.file_type().unwrap())).unwrap();
                if about.is_dir() {
                    folders.push(path.clone());
                }
                let text =
                    if about.is_file() { xxhash_rust::xxh3::xxh3_64(&fs::read(&path).unwrap()) } else { 0 };
                found.insert(path, format!("{about:?} {text}"));
            }
        }
        found
    }

    fn pipe(at: &Path) {
        assert!(Command::new("mkfifo").arg(at).status().unwrap().success());
    }

    /// What is done to a folder, by its name.
    type Way<'a> = (&'a str, &'a dyn Fn(&Path));

    #[test]
    #[cfg_attr(not(has_wasm), ignore = "wants the page's WebAssembly: run tools/viewer/wasm")]
    fn a_folder_that_holds_anything_else_is_refused_by_name() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let d = dir.path();
        archive(d);
        assert_eq!(publish(d, &["waves.isospan", "-o", "fresh"]).0, Some(0));
        let add: &[Way<'_>] = &[
            ("photo.jpg", &|v| fs::write(v.join("photo.jpg"), "photo").unwrap()),
            (".git", &|v| {
                fs::create_dir_all(v.join(".git/objects")).unwrap();
                fs::write(v.join(".git/HEAD"), "ref: refs/heads/main").unwrap();
            }),
            ("empty", &|v| fs::create_dir(v.join("empty")).unwrap()),
            ("notes", &|v| fs::write(v.join("waves.isospan/mesh/notes"), "notes").unwrap()),
            ("link", &|v| symlink("/etc/hostname", v.join("link")).unwrap()),
            ("pipe", &|v| pipe(&v.join("pipe"))),
            ("style.css was changed", &|v| fs::write(v.join("style.css"), "body { color: red }").unwrap()),
            ("main.js was changed", &|v| {
                fs::rename(v.join("main.js"), v.with_extension("js")).unwrap();
                symlink(v.with_extension("js"), v.join("main.js")).unwrap();
            }),
            ("published.json", &|v| fs::remove_file(v.join("published.json")).unwrap()),
            ("published.json", &|v| fs::write(v.join("published.json"), "{}").unwrap()),
            ("published.json", &|v| {
                fs::remove_file(v.join("published.json")).unwrap();
                pipe(&v.join("published.json"));
            }),
        ];
        for (n, (what, change)) in add.iter().enumerate() {
            let name = format!("viewer-{n}");
            assert_eq!(publish(d, &["waves.isospan", "-o", &name]).0, Some(0));
            change(&d.join(&name));
            let before = state(&d.join(&name));
            let (code, words) = publish(d, &["waves.isospan", "-o", &name, "--force"]);
            assert!(code == Some(2) && words.contains(what) && words.lines().count() == 1, "{what}: {words}");
            assert!(state(&d.join(&name)) == before, "{what}");
        }
        // A file of ours alone makes no folder ours.
        fs::create_dir(d.join("home")).unwrap();
        fs::write(d.join("home/isospan.wasm.gz"), "wasm").unwrap();
        fs::write(d.join("home/letter"), "dear").unwrap();
        let (code, words) = publish(d, &["waves.isospan", "-o", "home", "--force"]);
        assert!(code == Some(2) && words.contains("isospan publish made"), "{words}");
        assert_eq!(state(&d.join("home")).len(), 2);
        // A link to a folder is none.
        symlink("fresh", d.join("link")).unwrap();
        let (code, words) = publish(d, &["waves.isospan", "-o", "link", "--force"]);
        assert!(code == Some(2) && words.contains("it is a link"), "{words}");
        // What is left of a folder is replaced.
        fs::remove_file(d.join("fresh/style.css")).unwrap();
        assert_eq!(publish(d, &["waves.isospan", "-o", "fresh", "--force"]).0, Some(0));
        assert!(d.join("fresh/style.css").exists());
        let hidden = fs::read_dir(d)
            .unwrap()
            .filter(|e| e.as_ref().unwrap().file_name().to_string_lossy().starts_with('.'));
        assert_eq!(hidden.count(), 0, "nothing is left");
    }

    #[test]
    #[cfg_attr(not(has_wasm), ignore = "wants the page's WebAssembly: run tools/viewer/wasm")]
    fn an_archive_is_copied_by_its_manifest_alone() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let d = dir.path();
        let archive = archive(d);
        fs::write(d.join("key"), "private").unwrap();
        let segment = archive.join("mesh/000000.seg");
        let whole = fs::read(&segment).unwrap();
        let swap = |make: &dyn Fn(&Path)| {
            fs::remove_file(&segment).unwrap();
            make(&segment);
        };
        let ways: &[Way<'_>] = &[
            ("a link to a key", &|at| symlink(d.join("key"), at).unwrap()),
            ("a link to the segment", &|at| {
                fs::write(d.join("copy.seg"), &whole).unwrap();
                symlink(d.join("copy.seg"), at).unwrap();
            }),
            ("a link to nothing", &|at| symlink("none", at).unwrap()),
            ("zeros without end", &|at| symlink("/dev/zero", at).unwrap()),
            ("a pipe", &|at| pipe(at)),
            ("another file", &|at| fs::write(at, vec![7; whole.len()]).unwrap()),
            ("a byte more", &|at| fs::write(at, [&whole[..], &[0]].concat()).unwrap()),
            ("a byte else", &|at| {
                let mut other = whole.clone();
                other[whole.len() / 2] ^= 1;
                fs::write(at, other).unwrap();
            }),
        ];
        for (what, make) in ways {
            swap(make);
            let (code, words) = publish(d, &["waves.isospan", "-o", "viewer"]);
            assert!(code.is_some_and(|c| c != 0 && c < 100), "{what}: {code:?} {words}");
            assert!(words.contains("000000.seg") && words.lines().count() == 1, "{what}: {words}");
            assert!(!d.join("viewer").exists(), "{what}");
        }
        swap(&|at| fs::write(at, &whole).unwrap());
        // Folders and the manifest are no links either.
        for name in ["mesh", "manifest.zst"] {
            let away = d.join(format!("away-{name}"));
            fs::rename(archive.join(name), &away).unwrap();
            symlink(&away, archive.join(name)).unwrap();
            let (code, words) = publish(d, &["waves.isospan", "-o", "viewer"]);
            assert!(code.is_some_and(|c| c != 0 && c < 100) && words.contains(name), "{name}: {words}");
            fs::remove_file(archive.join(name)).unwrap();
            fs::rename(&away, archive.join(name)).unwrap();
        }
        assert_eq!(publish(d, &["waves.isospan", "-o", "viewer"]).0, Some(0));
        let hidden = fs::read_dir(d)
            .unwrap()
            .filter(|e| e.as_ref().unwrap().file_name().to_string_lossy().starts_with('.'));
        assert_eq!(hidden.count(), 0, "nothing is left");
    }

    /// Kills at any time: there is a whole folder or none, and the next run leaves nothing else.
    #[test]
    #[cfg_attr(not(has_wasm), ignore = "wants the page's WebAssembly: run tools/viewer/wasm")]
    fn a_killed_run_leaves_a_whole_folder_or_none() {
        let dir = tempfile::tempdir().unwrap();
        let d = dir.path();
        archive(d);
        assert_eq!(publish(d, &["waves.isospan", "-o", "viewer"]).0, Some(0));
        let whole = all_files(&d.join("viewer"));
        // More rounds by hand: ISOSPAN_KILLS=100.
        let rounds: u32 = std::env::var("ISOSPAN_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(8);
        let mut within = 0;
        for round in 0..rounds {
            let is_new = round % 2 == 1;
            if is_new {
                fs::remove_dir_all(d.join("viewer")).unwrap();
            }
            let mut child = Command::new(env!("CARGO_BIN_EXE_isospan"))
                .args(["publish", "waves.isospan", "-o", "viewer", "--force", "-q"])
                .current_dir(d)
                .stdout(Stdio::null())
                .spawn()
                .unwrap();
            // At once, after the first files, and so on, to after the last one.
            let wanted = whole.len() * round as usize / (rounds as usize - 1);
            while child.try_wait().unwrap().is_none() && begun_files(d) < wanted {
                std::thread::sleep(Duration::from_millis(1));
            }
            child.kill().unwrap();
            child.wait().unwrap();
            within += u32::from(begun_files(d) > 0);
            let is_there = d.join("viewer").exists();
            assert!(is_there || is_new, "the folder is lost");
            assert!(!is_there || all_files(&d.join("viewer")) == whole, "round {round}: half a folder");
            let (code, words) = publish(d, &["waves.isospan", "-o", "viewer", "--force", "-q"]);
            assert!(code == Some(0) && all_files(&d.join("viewer")) == whole, "round {round}: {words}");
            let mut names: Vec<_> = fs::read_dir(d).unwrap().map(|e| e.unwrap().file_name()).collect();
            names.sort();
            assert_eq!(names, ["viewer", "waves.isospan", "waves.npy"], "round {round}");
        }
        assert!(within > 0, "no run was killed while it wrote");
    }

    /// How many files there are in folders that are not done yet.
    fn begun_files(d: &Path) -> usize {
        let (mut count, mut folders) = (0, vec![d.to_path_buf()]);
        while let Some(here) = folders.pop() {
            // They may go while they are listed.
            for entry in fs::read_dir(&here).into_iter().flatten().flatten() {
                let (Ok(kind), is_below) = (entry.file_type(), here != d) else { continue };
                if kind.is_dir() && (is_below || entry.file_name().to_string_lossy().starts_with('.')) {
                    folders.push(entry.path());
                }
                count += usize::from(is_below && kind.is_file());
            }
        }
        count
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
    assert_eq!(local.count(0.1).unwrap().active_cells, there.count(0.1).unwrap().active_cells);
    let error = Archive::open("host://folder/none.isospan").err().unwrap().to_string();
    assert!(error.contains("host://folder/none.isospan/manifest.zst"), "{error}");
    let error = Archive::open("host://nobody/waves.isospan").err().unwrap().to_string();
    assert!(error.contains("'nobody'"), "{error}");
}
