//! The documents hang together: links lead somewhere, the book's page of commands is what the
//! program says of itself, its table of contents has every page, README and CONTRIBUTING stay
//! short, and the front pages of the crates list their features.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Documents besides the pages of the book.
const DOCUMENTS: [&str; 8] = [
    "README.md",
    ".github/CONTRIBUTING.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "src/archive/FORMAT.md",
    "src/wavelet/FORMAT.md",
    "benches/README.md",
    "datasets/README.md",
];

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// The pages of the book: names in tools/book/src.
fn pages() -> BTreeSet<String> {
    let files = fs::read_dir(root().join("tools/book/src")).unwrap();
    files.map(|f| f.unwrap().file_name().into_string().unwrap()).filter(|f| f.ends_with(".md")).collect()
}

fn documents() -> Vec<PathBuf> {
    let book = pages().into_iter().map(|page| Path::new("tools/book/src").join(page));
    DOCUMENTS.iter().map(PathBuf::from).chain(book).collect()
}

/// The lines of a document outside of blocks of code.
fn prose(text: &str) -> Vec<&str> {
    let mut in_code = false;
    let mut kept = text.lines().collect::<Vec<_>>();
    kept.retain(|line| {
        let fence = line.trim_start().starts_with("```");
        in_code ^= fence;
        !fence && !in_code
    });
    kept
}

/// A line without what is between backticks.
fn without_code(line: &str) -> String {
    line.split('`').step_by(2).collect()
}

/// The targets of a document's links and pictures.
fn links(text: &str) -> Vec<String> {
    let lines = prose(text).into_iter().map(without_code);
    lines
        .flat_map(|l| {
            l.split("](").skip(1).map(|t| t.split(')').next().unwrap().to_owned()).collect::<Vec<_>>()
        })
        .collect()
}

/// The anchors of a document's headings, as web pages for Markdown make them.
fn anchors(text: &str) -> BTreeSet<String> {
    let (mut seen, mut found) = (BTreeMap::<String, u32>::new(), BTreeSet::new());
    for heading in prose(text).into_iter().filter(|l| l.starts_with('#')) {
        let letters = heading.trim_start_matches('#').trim().to_lowercase().replace(' ', "-");
        let name: String = letters.chars().filter(|c| c.is_alphanumeric() || "-_".contains(*c)).collect();
        let times = seen.entry(name.clone()).or_default();
        found.insert(if *times == 0 { name } else { format!("{name}-{times}") });
        *times += 1;
    }
    found
}

/// What is wrong with a link of the document at `from`, a path below the root.
fn wrong(from: &Path, link: &str) -> Option<String> {
    if link.starts_with("https://") || link.starts_with("http://") {
        return None;
    }
    let (file, anchor) = link.split_once('#').map_or((link, None), |(file, anchor)| (file, Some(anchor)));
    let path = if file.is_empty() { from.to_owned() } else { from.parent().unwrap().join(file) };
    if !root().join(&path).exists() {
        return Some(format!("{}: {link}: there is no such file", from.display()));
    }
    let anchor = anchor?;
    let known = anchors(&fs::read_to_string(root().join(&path)).unwrap());
    (!known.contains(anchor)).then(|| format!("{}: {link}: no heading has this anchor", from.display()))
}

#[test]
fn every_link_leads_to_a_file_and_a_heading() {
    let (mut checked, mut found) = (0, vec![]);
    for document in documents() {
        let links = links(&fs::read_to_string(root().join(&document)).unwrap());
        checked += links.len();
        found.extend(links.iter().filter_map(|link| wrong(&document, link)));
    }
    assert!(found.is_empty(), "{found:#?}");
    assert!(checked > 30, "{checked} links: are they still found?");
}

#[test]
fn the_book_s_contents_list_every_page() {
    let contents = fs::read_to_string(root().join("tools/book/src/SUMMARY.md")).unwrap();
    let mut listed: BTreeSet<String> = links(&contents).into_iter().collect();
    listed.insert("SUMMARY.md".to_owned());
    assert_eq!(listed, pages());
}

/// Expects that a file is what a script writes of what the program says.
fn expect_written(script: &str, file: &str) {
    let path = root().join(script);
    let made = Command::new("bash").arg(path).args([env!("CARGO_BIN_EXE_isospan"), "-"]).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let made = String::from_utf8(made.stdout).unwrap();
    let written = fs::read_to_string(root().join(file)).unwrap();
    let differs = made.lines().zip(written.lines()).find(|(made, written)| made != written);
    assert!(made == written, "run {script}: the program says otherwise, first at {differs:?}");
}

#[test]
fn the_page_of_commands_is_what_the_program_says() {
    expect_written("tools/book/commands", "tools/book/src/commands.md");
}

#[test]
fn keywords_of_python_are_the_flags_of_the_program() {
    expect_written("tools/python/keywords", "tools/python/python/isospan/_reduce.py");
}

/// All files of Rust below a folder.
fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true if path.ends_with("target") => {}
            true => rust_files(&path, found),
            false => found.extend(Some(path).filter(|p| p.extension().is_some_and(|e| e == "rs"))),
        }
    }
}

/// Whether a line of a comment may be long: in a table, a drawing, or with a word that is long.
fn may_be_long(text: &str) -> bool {
    let is_drawn = text.starts_with("   ") || text.trim().contains("   ");
    let has_boxes = text.chars().any(|c| ('\u{2500}'..='\u{25ff}').contains(&c));
    let has_long_word = text.split(' ').any(|word| word.chars().count() > 80);
    is_drawn || has_boxes || has_long_word || text.trim_start().starts_with('|')
}

#[test]
fn comments_have_lines_of_100_columns() {
    let mut files = vec![];
    ["src", "tests", "tools", "benches"].iter().for_each(|f| rust_files(&root().join(f), &mut files));
    let mut found = vec![];
    for file in files {
        let mut is_example = false;
        for (n, line) in fs::read_to_string(&file).unwrap().lines().enumerate() {
            let Some(text) = line.trim_start().strip_prefix("//") else { continue };
            let text = text.trim_start_matches(['/', '!']);
            is_example ^= text.trim_start().starts_with("```");
            if line.chars().count() > 100 && !is_example && !may_be_long(text) {
                found.push(format!("{}:{}", file.display(), n + 1));
            }
        }
    }
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn readme_and_contributing_are_short() {
    for (file, most) in [("README.md", 1500), (".github/CONTRIBUTING.md", 600)] {
        let words = fs::read_to_string(root().join(file)).unwrap().split_whitespace().count();
        assert!(words <= most, "{file} has {words} words: move what is too much to tools/book");
    }
}

/// Features, and whether they are default ones.
type Features = BTreeMap<String, bool>;

/// Those of a manifest.
fn declared(manifest: &str) -> Features {
    let text = fs::read_to_string(root().join(manifest)).unwrap();
    let (_, table) = text.split_once("\n[features]\n").expect("a table of features");
    let rows = table.lines().take_while(|line| !line.starts_with('['));
    let rows: Vec<_> =
        rows.filter(|line| !line.starts_with('#')).filter_map(|l| l.split_once(" = ")).collect();
    let (_, default) = rows.iter().find(|(name, _)| *name == "default").expect("default features");
    let others = rows.iter().filter(|(name, _)| *name != "default");
    others.map(|(name, _)| ((*name).to_owned(), default.contains(&format!("\"{name}\"")))).collect()
}

/// Those that a crate's front page lists.
fn described(page: &str) -> Features {
    let text = fs::read_to_string(root().join(page)).unwrap();
    let (_, list) = text.split_once("//! # Features\n").expect("a list of features");
    let lines = list.lines().take_while(|line| line.starts_with("//!") && !line.starts_with("//! #"));
    let rows = lines.filter_map(|line| line.strip_prefix("//! * `")?.split_once('`'));
    rows.map(|(name, text)| (name.to_owned(), text.starts_with(" (default)"))).collect()
}

#[test]
fn front_pages_list_the_features() {
    let crates = [
        ("Cargo.toml", "src/lib.rs"),
        ("src/io/Cargo.toml", "src/io/lib.rs"),
        ("src/cli/Cargo.toml", "src/cli/lib.rs"),
    ];
    for (manifest, page) in crates {
        assert_eq!(described(page), declared(manifest), "{page} (left) and {manifest}");
    }
    // The program has all of the library's.
    let all: Vec<String> = declared("Cargo.toml").into_keys().collect();
    assert_eq!(isospan::features(), all);
}
