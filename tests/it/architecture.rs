//! The table of imports in ARCHITECTURE.md is the code's: each row names what its module uses of
//! others, no less and no more, and only modules of the rows above it. And no five types share a
//! name.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// A module and the module, or the part of one, that it uses: ("index", "mesh::tet").
type Imports = BTreeMap<String, BTreeSet<String>>;

/// The heading of the table of modules.
const MODULES: &str = "## Which module may use which?";
/// What every module uses, and the root of each crate with the macros that lie there.
const NO_ROWS: [&str; 6] = ["error", "lib", "Error", "may_use_all", "on_avx2_or_plain", "on_widest"];
/// The crates whose modules have rows: their names in code, and their folders. Which crate may use
/// which, Cargo says.
const CRATES: [(&str, &str); 3] =
    [("isospan_io", "src/io"), ("isospan_mesh", "src/mesh"), ("isospan", "src")];
/// The other crates that users build.
const OTHERS: [&str; 2] = ["src/cli", "src/wavelet/src"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The sources of a crate below a folder.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    // Cargo checks the imports of another crate.
    add_sources(folder, &|path| !path.join("Cargo.toml").exists(), found);
}

/// The sources in a folder and in those below it that are `looked_into`, without files of tests.
fn add_sources(folder: &Path, looked_into: &dyn Fn(&Path) -> bool, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let of_tests =
            name.ends_with("tests.rs") || ["tests", "testing.rs", "shared_data.rs"].contains(&&*name);
        match path.is_dir() {
            _ if of_tests => {}
            true if looked_into(&path) => add_sources(&path, looked_into, found),
            false if name.ends_with(".rs") => found.push(path),
            _ => {}
        }
    }
}

/// The code of a file without comments and without its modules of tests.
fn code(text: &str) -> String {
    let mut lines = text.lines().peekable();
    let mut kept = String::new();
    while let Some(line) = lines.next() {
        let of_tests = line == "#[cfg(test)]" || line.starts_with("#[cfg(all(test");
        if of_tests && lines.peek().is_some_and(|l| l.contains("mod ") && l.ends_with('{')) {
            lines.by_ref().find(|l| *l == "}");
            continue;
        }
        kept += line.split("//").next().unwrap();
        kept.push('\n');
    }
    kept
}

/// The word at the beginning of `text`.
fn word(text: &str) -> &str {
    &text[..text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len())]
}

/// The names at the beginning of `text`, the rest of a path: one, or each in braces.
fn names(text: &str) -> Vec<&str> {
    if !text.starts_with('{') {
        return vec![word(text)];
    }
    let (mut depth, mut found) = (0, vec![]);
    for (at, letter) in text.char_indices() {
        match letter {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if depth == 1 && ['{', ','].contains(&letter) {
            found.push(word(text[at + 1..].trim_start()));
        } else if depth == 0 {
            break;
        }
    }
    found.retain(|name| !name.is_empty());
    found
}

/// What follows a path, wherever a file uses it: the name of a crate, or of a folder.
fn paths_of<'a>(code: &'a str, name: &str) -> Vec<&'a str> {
    let name = format!("{name}::");
    let goes_on = |at: usize| code[..at].ends_with(|c: char| c.is_alphanumeric() || "_:".contains(c));
    code.match_indices(&name)
        .filter(|(at, _)| !goes_on(*at))
        .map(|(at, _)| &code[at + name.len()..])
        .collect()
}

/// All paths of modules to others: module, other, and the name that is used of it.
fn paths_of_the_code(root: &Path) -> BTreeSet<[String; 3]> {
    let mut found = BTreeSet::new();
    for (own, folder) in CRATES {
        let mut files = vec![];
        sources(&root.join(folder), &mut files);
        for file in files {
            let below = file.strip_prefix(root.join(folder)).unwrap().to_string_lossy().into_owned();
            let module = word(&below).to_owned();
            if NO_ROWS.contains(&&*module) {
                continue;
            }
            let code = code(&fs::read_to_string(&file).unwrap());
            let others = CRATES.iter().filter(|(name, _)| *name != own).map(|(name, _)| *name);
            for path in others.chain(["crate"]).flat_map(|name| paths_of(&code, name)) {
                let other = word(path);
                assert!(!other.is_empty(), "{below}: write `crate::module`, not `crate::{{`");
                if other != module && !NO_ROWS.contains(&other) {
                    let rest = path[other.len()..].strip_prefix("::").unwrap_or_default();
                    found.extend(names(rest).iter().map(|n| [module.clone(), other.into(), (*n).to_owned()]));
                }
            }
        }
    }
    found
}

/// Modules that consist of rooms, and their folders.
const HOUSES: [(&str, &str); 4] = [
    ("pipeline", "src/pipeline"),
    ("formats", "src/io/formats"),
    ("archive", "src/archive"),
    ("surface", "src/surface"),
];

/// The rooms of a module, and what each uses of others.
fn rooms_of_the_code(folder: &Path, house: &str) -> Imports {
    let (mut files, mut found) = (vec![], Imports::new());
    sources(folder, &mut files);
    for file in files {
        let below = file.strip_prefix(folder).unwrap().to_string_lossy().into_owned();
        let room = word(&below);
        if room == "mod" {
            continue;
        }
        let used = found.entry(room.to_owned()).or_default();
        let text = code(&fs::read_to_string(&file).unwrap());
        let own = format!("crate::{house}::");
        for path in text.replace(&format!("pub(in crate::{house})"), "").split(&own).skip(1) {
            let other = word(path);
            assert!(!other.is_empty(), "{below}: write `{own}room`, without braces");
            if other != room {
                used.insert(other.to_owned());
            }
        }
        assert!(!text.contains("super::super::super"), "{below}: a room is not left by `super`");
    }
    found
}

#[test]
fn the_table_of_rooms_is_the_code_s() {
    let text = fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    for (house, folder) in HOUSES {
        let (order, listed) = rows(&text, &format!("## Which room of `{house}` may use which?"));
        assert_eq!(listed, rooms_of_the_code(&root().join(folder), house));
        for (at, room) in order.iter().enumerate() {
            for other in &listed[room] {
                assert!(order[..at].contains(other), "{room} uses {other}, which is below it");
            }
        }
    }
}

/// The folders of a crate that have files of its own, its root first.
fn folders_of(root: &Path) -> Vec<PathBuf> {
    let (mut folders, mut at) = (vec![root.to_owned()], 0);
    while at < folders.len() {
        let entries = fs::read_dir(&folders[at]).unwrap().map(|entry| entry.unwrap().path());
        folders.extend(entries.filter(|path| path.join("mod.rs").exists()));
        at += 1;
    }
    folders
}

/// The files of a folder, and the files of the same folder that each uses. A `mod.rs` is the
/// folder's face: it may use all of them, and is left out. A folder in it counts as one of its
/// files, with all that it has. `own` is the path of the folder in code.
fn files_of_a_folder(folder: &Path, own: &str) -> Imports {
    let (mut files, mut found) = (vec![], Imports::new());
    sources(folder, &mut files);
    let below = |file: &Path| file.strip_prefix(folder).unwrap().to_string_lossy().into_owned();
    let mut used = vec![];
    for file in &files {
        let below = below(file);
        let name = word(&below).to_owned();
        if below.contains('/') || !["mod", "lib", "main"].contains(&&*name) {
            let code = code(&fs::read_to_string(file).unwrap());
            let depth = below.split('/').count() - usize::from(below.ends_with("/mod.rs"));
            let up = vec!["super"; depth].join("::");
            let paths = [own, &up].into_iter().flat_map(|path| paths_of(&code, path));
            used.push((name.clone(), paths.flat_map(names_of).collect::<BTreeSet<_>>()));
            found.entry(name).or_default();
        }
    }
    for (name, others) in used {
        let others: Vec<_> = others.into_iter().filter(|o| *o != name && found.contains_key(o)).collect();
        found.get_mut(&name).unwrap().extend(others);
    }
    found
}

fn names_of(text: &str) -> Vec<String> {
    names(text).into_iter().map(str::to_owned).collect()
}

#[test]
fn the_files_of_a_folder_have_no_circles() {
    let mut looked_at = 0;
    for crate_folder in CRATES.map(|(_, folder)| folder).into_iter().chain(OTHERS) {
        let crate_folder = root().join(crate_folder);
        for folder in folders_of(&crate_folder) {
            let below = folder.strip_prefix(&crate_folder).unwrap().iter();
            let own = std::iter::once("crate").chain(below.map(|part| part.to_str().unwrap()));
            let mut left = files_of_a_folder(&folder, &own.collect::<Vec<_>>().join("::"));
            looked_at += left.len();
            // Files that use none of those that are left go, until none does.
            while let Some(free) = left.iter().find(|(_, used)| used.iter().all(|u| !left.contains_key(u))) {
                let free = free.0.clone();
                left.remove(&free);
            }
            assert!(left.is_empty(), "files of {folder:?} use one another in a circle: {left:#?}");
        }
    }
    assert!(looked_at > 400, "{looked_at} files");
}

/// The rows of the table below a heading: their order, and what each lists.
fn rows(text: &str, heading: &str) -> (Vec<String>, Imports) {
    let table = text.split(&format!("\n{heading}\n")).nth(1).expect("the heading");
    let rows = table.split("\n## ").next().unwrap().lines().filter(|l| l.starts_with("| `"));
    let (mut order, mut imports) = (vec![], Imports::new());
    for row in rows {
        let cells: Vec<Vec<&str>> =
            row.split('|').skip(1).map(|cell| cell.split('`').skip(1).step_by(2).collect()).collect();
        for module in &cells[0] {
            order.push((*module).to_owned());
            imports.insert((*module).to_owned(), cells[1].iter().map(|o| (*o).to_owned()).collect());
        }
    }
    (order, imports)
}

#[test]
fn the_table_of_imports_is_the_code_s() {
    let root = root();
    let (_, listed) = rows(&fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap(), MODULES);
    let (mut missing, mut used) = (BTreeSet::new(), Imports::new());
    for [module, other, name] in paths_of_the_code(&root) {
        let row = listed.get(&module).unwrap_or_else(|| panic!("{module} has no row"));
        let entry = [other.clone(), format!("{other}::{name}")].into_iter().find(|e| row.contains(e));
        match entry {
            Some(entry) => _ = used.entry(module).or_default().insert(entry),
            None => _ = missing.insert(format!("{module} uses {other}::{name}")),
        }
    }
    assert!(missing.is_empty(), "the table of ARCHITECTURE.md lacks: {missing:#?}");
    for (module, row) in &listed {
        let unused: Vec<_> = row.difference(used.entry(module.clone()).or_default()).collect();
        assert!(unused.is_empty(), "the row of {module} in ARCHITECTURE.md has what is not used: {unused:?}");
    }
}

#[test]
fn modules_use_those_of_the_rows_above() {
    let root = root();
    let (order, listed) = rows(&fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap(), MODULES);
    for (at, module) in order.iter().enumerate() {
        for other in listed[module].iter().map(|entry| word(entry)) {
            assert!(order[..at].iter().any(|m| m == other), "{module} uses {other}, which is below it");
        }
    }
}

/// Types that may share a name, at most: the name of five says too little of each.
const MOST_NAMESAKES: usize = 4;

/// The name of the type that a line of code begins to define.
fn type_of(line: &str) -> Option<&str> {
    let line = line.trim_start();
    let line = match line.strip_prefix("pub(") {
        Some(rest) => rest.split_once(") ")?.1,
        None => line.strip_prefix("pub ").unwrap_or(line),
    };
    let rest = ["struct ", "enum ", "trait "].iter().find_map(|kind| line.strip_prefix(kind))?;
    Some(word(rest)).filter(|name| name.starts_with(char::is_uppercase))
}

#[test]
fn no_five_types_share_a_name() {
    let (root, mut files) = (root(), vec![]);
    for folder in ["src", "tools"] {
        add_sources(&root.join(folder), &|_| true, &mut files);
    }
    files.sort();
    let mut places = BTreeMap::<String, Vec<String>>::new();
    for file in &files {
        let below = file.strip_prefix(&root).unwrap().to_string_lossy();
        for name in code(&fs::read_to_string(file).unwrap()).lines().filter_map(type_of) {
            places.entry(name.to_owned()).or_default().push(below.to_string());
        }
    }
    assert!(places.len() > 1000, "{} names", places.len());
    // Each command has its own, after the custom of clap: `surface::Args`.
    assert!(places.remove("Args").is_some());
    places.retain(|_, files| files.len() > MOST_NAMESAKES);
    assert!(places.is_empty(), "give all but the most central types more telling names: {places:#?}");
}
