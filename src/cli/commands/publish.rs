//! `isospan publish`: a folder that is a viewer, on any web server.
//!
//! ```text
//!  FOLDER: index.html, style.css, *.js      the page of `isospan view`
//!          worker.js, isospan.wasm.gz       the queries, which a worker of the page runs
//!          licences.txt                     of all that is in these files
//!          published.json                   all other files, with their lengths and hashes
//!          NAME.isospan/                    copies of the archives, read by ranges
//! ```
//!
//! All is written beside the folder and synced; the folder gets its name last. `--force` replaces
//! what the list in a folder names, as it was written. A folder that holds anything else is
//! refused.

mod own;

use super::output::{Force, exists, expect_no_input};
use super::progress::Talk;
use super::text;
use super::view::page::{self, Queries};
use isospan::archive::lock::WriterLock;
use isospan::bytes::StagedFolder;
use isospan::bytes::remote::is_remote;
use isospan::exec::CancelToken;
use isospan::pipeline::copy_archive;
use isospan::{Archive, Error, Result};
use own::{LIST, List};
use serde::Serialize;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// Write a folder that shows archives on any web server.
///
/// The folder has the page of isospan view, the queries as WebAssembly and a copy of each archive.
/// Put it on a web server or an object store: no program runs there, and the page asks no other
/// host. The server must answer range requests, as most do. A page that is opened as a file shows
/// nothing.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan publish scan.isospan -o viewer\n  isospan publish a.isospan b.isospan -o viewer --force"
)]
pub struct Args {
    /// The archives, folders on this machine.
    #[arg(required = true, value_name = "ARCHIVE")]
    archives: Vec<PathBuf>,
    /// The folder to write.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    #[command(flatten)]
    force: Force,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// What was written.
#[derive(Debug, Default, Serialize)]
pub struct Report {
    /// The folder.
    folder: PathBuf,
    /// The names of the archives in it.
    archives: Vec<String>,
    /// Files, and their bytes.
    files: u64,
    bytes: u64,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let report = publish(args, super::signals::cancel_token())?;
    if args.json {
        return super::print_json("publish", &report);
    }
    let (files, bytes) = (text::plural(report.files, "file"), text::bytes(report.bytes));
    let out = args.output.display();
    super::print(&format!("{out}: {files}, {bytes}\n"))?;
    talk.note("put the folder on any web server or object store that answers range requests");
    talk.note(&format!("to look at it here: python3 -m http.server --directory {out}"));
    Ok(())
}

/// Writes the folder.
///
/// # Errors
/// Those of the command.
pub fn publish(args: &Args, cancel: CancelToken) -> Result<Report> {
    let queries = expect_queries(page::QUERIES)?;
    let out = &args.output;
    let names = names_of(&args.archives)?;
    expect_no_input(out, &args.archives)?;
    expect_place(out)?;
    let _lock = WriterLock::acquire(out)?;
    let stage = StagedFolder::begin(out)?;
    let published = expect_room(out, args.force)?;
    let mut folder = Folder {
        path: stage.new_folder(),
        list: List::default(),
        report: Report { folder: out.clone(), archives: names.clone(), ..Report::default() },
        cancel,
    };
    for (archive, name) in args.archives.iter().zip(&names) {
        folder.copy_archive(archive, name)?;
    }
    folder.write_page(&names, &queries)?;
    folder.write_list()?;
    if let Some(old) = stage.publish(published.is_some())? {
        published.unwrap_or_default().remove_from(&old, out)?;
    }
    Ok(folder.report)
}

/// The queries, which a program has that was built where they had been made.
fn expect_queries(queries: Option<Queries>) -> Result<Queries> {
    queries.ok_or_else(|| {
        let text = "this program was built without the page's WebAssembly: take one of a release, or run \
                    tools/viewer/wasm in a clone of the source and build it again";
        Error::usage(text)
    })
}

/// The names that archives have in the folder.
fn names_of(archives: &[PathBuf]) -> Result<Vec<String>> {
    let pages = page::FILES.iter().map(|file| file.name).chain([
        "worker.js",
        "isospan.wasm.gz",
        "licences.txt",
        LIST,
    ]);
    let mut taken: Vec<String> = pages.map(str::to_owned).collect();
    let mut names = vec![];
    for archive in archives {
        if is_remote(archive) {
            let text = format!("{}: copy the archive to this machine first", archive.display());
            return Err(Error::usage(text));
        }
        // Of `.` and the like, too; what is no archive is told here.
        Archive::open(archive)?;
        let place = archive.canonicalize().map_err(|e| Error::io("find", archive, e))?;
        let name =
            place.file_name().and_then(|name| name.to_str()).filter(|name| !name.contains(['\n', '\r']));
        let Some(name) = name else {
            let text = format!("{}: its name cannot be part of a web address", archive.display());
            return Err(Error::usage(text));
        };
        // Some servers do not tell large letters from small ones.
        if taken.iter().any(|other| other.eq_ignore_ascii_case(name)) {
            let text = format!("{}: another file of the folder has this name", archive.display());
            return Err(Error::usage(text));
        }
        taken.push(name.to_owned());
        names.push(name.to_owned());
    }
    Ok(names)
}

/// Refuses a place where no folder can be written, before anything is made beside it.
fn expect_place(out: &Path) -> Result<()> {
    let refuse = |why: String| Err(Error::usage(format!("cannot write {}: {why}", out.display())));
    if out.file_name().is_none() {
        return refuse("give the name of a folder".into());
    }
    match fs::symlink_metadata(out) {
        Ok(about) if about.is_symlink() => refuse("it is a link; give the name of a folder".into()),
        Ok(about) if !about.is_dir() => refuse("it is a file; give the name of a folder".into()),
        Ok(_) => Ok(()),
        Err(_) => match out.parent() {
            Some(parent) if !parent.as_os_str().is_empty() && !parent.is_dir() => {
                refuse(format!("there is no folder {}; create it first", parent.display()))
            }
            _ => Ok(()),
        },
    }
}

/// Refuses a folder that exists, unless it is empty, or is to be replaced and holds what was
/// published. Returns the list of what is to be replaced.
fn expect_room(out: &Path, force: Force) -> Result<Option<List>> {
    let is_empty = match fs::read_dir(out) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => true,
        entries => entries.map_err(|e| Error::io("list", out, e))?.next().is_none(),
    };
    match () {
        () if is_empty => Ok(None),
        () if !force.is_given() => Err(exists(out)),
        () => List::of_all_in(out).map(Some),
    }
}

/// A folder on its way.
struct Folder {
    path: PathBuf,
    list: List,
    report: Report,
    cancel: CancelToken,
}

impl Folder {
    /// Writes a file. It may be read by whom this user's files may be read by.
    fn write(&mut self, name: &str, from: &mut dyn Read) -> Result<()> {
        let path = self.path.join(name);
        let mut file = File::create_new(&path).map_err(|e| Error::io("create", &path, e))?;
        let (mut piece, mut hash, mut bytes) = (vec![0; 1 << 20], own::Hash::default(), 0);
        loop {
            self.cancel.check()?;
            let count = from.read(&mut piece).map_err(|e| Error::io("write", &path, e))?;
            if count == 0 {
                break;
            }
            hash.update(&piece[..count]);
            file.write_all(&piece[..count]).map_err(|e| Error::io("write", &path, e))?;
            bytes += count as u64;
        }
        file.sync_all().map_err(|e| Error::io("sync", &path, e))?;
        self.wrote(name.to_owned(), bytes, hash.digest());
        Ok(())
    }

    fn wrote(&mut self, name: String, bytes: u64, hash: u64) {
        self.report.files += 1;
        self.report.bytes += bytes;
        self.list.add(name, bytes, hash);
    }

    fn copy_archive(&mut self, archive: &Path, name: &str) -> Result<()> {
        let copy = self.path.join(name);
        for file in copy_archive(archive, &copy, &self.cancel)? {
            let parts = file.name.iter().map(|part| part.to_string_lossy());
            let name = parts.fold(name.to_owned(), |name, part| format!("{name}/{part}"));
            self.wrote(name, file.bytes, file.hash);
        }
        // What is not whole does not open.
        Archive::open(copy)?.info()?;
        Ok(())
    }

    /// The list of all files, the last one.
    fn write_list(&mut self) -> Result<()> {
        let text = self.list.to_text();
        self.write(LIST, &mut text.as_bytes())
    }

    fn write_page(&mut self, names: &[String], queries: &Queries) -> Result<()> {
        for (n, file) in page::FILES.iter().enumerate() {
            let mut content =
                if file.is_gzip { unpacked(file.name, file.content)? } else { file.content.to_vec() };
            if n == 0 {
                content = with_archives(&String::from_utf8_lossy(&content), names).into_bytes();
            }
            self.write(file.name, &mut &content[..])?;
        }
        let licences = unpacked("licences.txt", queries.licences_gz)?;
        self.write("licences.txt", &mut &licences[..])?;
        let mut worker = page::WORKER;
        self.write("worker.js", &mut worker)?;
        let wasm = unpacked_wasm(queries)?;
        let mut packed = flate2::read::GzEncoder::new(&wasm[..], flate2::Compression::best());
        self.write("isospan.wasm.gz", &mut packed)
    }
}

/// The queries as WebAssembly.
fn unpacked_wasm(queries: &Queries) -> Result<Vec<u8>> {
    zstd::decode_all(queries.wasm_zst).map_err(|e| Error::io("unpack", "isospan.wasm", e))
}

/// What was compressed by gzip.
fn unpacked(name: &str, content: &[u8]) -> Result<Vec<u8>> {
    let mut out = vec![];
    let read = flate2::read::GzDecoder::new(content).read_to_end(&mut out);
    read.map_err(|e| Error::io("unpack", name, e))?;
    Ok(out)
}

/// The page, which says where its archives are and what it may ask for.
fn with_archives(page: &str, names: &[String]) -> String {
    const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
                          connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'";
    const FIRST: &str = "<meta charset=\"utf-8\">\n";
    let escaped = |text: &str| {
        text.chars().fold(String::new(), |mut out, c| {
            match c {
                '&' => out += "&amp;",
                '<' => out += "&lt;",
                '"' => out += "&quot;",
                '\n' => out += "&#10;",
                c => out.push(c),
            }
            out
        })
    };
    let archives = escaped(&names.join("\n"));
    let more = format!(
        "  <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n  \
         <meta name=\"referrer\" content=\"no-referrer\">\n  \
         <meta name=\"isospan-archives\" content=\"{archives}\">\n"
    );
    page.replacen(FIRST, &(FIRST.to_owned() + &more), 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan::archive::segment::FORMAT_VERSION;

    /// A number of LEB128 at the beginning of some bytes, and the rest.
    fn number(bytes: &[u8]) -> (usize, &[u8]) {
        let length = 1 + bytes.iter().position(|b| b & 0x80 == 0).unwrap();
        let digits = bytes[..length].iter().rev();
        (digits.fold(0, |n, b| n << 7 | usize::from(b & 0x7f)), &bytes[length..])
    }

    /// The contents of the section `isospan` of a file of WebAssembly.
    fn section(file: &[u8]) -> Option<&[u8]> {
        let mut rest = file.strip_prefix(b"\0asm\x01\0\0\0").unwrap();
        while let Some((&kind, after)) = rest.split_first() {
            let (length, after) = number(after);
            let (content, next) = after.split_at(length);
            let (length, after) = number(content);
            if kind == 0 && &after[..length] == b"isospan" {
                return Some(&after[length..]);
            }
            rest = next;
        }
        None
    }

    #[test]
    fn a_program_without_the_queries_says_where_they_come_from() {
        let error = expect_queries(None).err().unwrap();
        let text = error.to_string();
        assert!(text.contains("tools/viewer/wasm") && text.lines().count() == 1, "{text}");
        assert_eq!(error.exit_code(), 2);
        assert_eq!(page::QUERIES.is_some(), cfg!(has_wasm));
    }

    #[test]
    #[cfg_attr(not(has_wasm), ignore = "wants the page's WebAssembly: run tools/viewer/wasm")]
    fn the_queries_read_what_this_program_writes() {
        let file = unpacked_wasm(&page::QUERIES.unwrap()).unwrap();
        let format = section(&file).expect("tools/viewer/core names a format");
        assert_eq!(format, FORMAT_VERSION.to_le_bytes(), "run tools/viewer/wasm");
    }

    #[test]
    #[cfg_attr(not(has_wasm), ignore = "wants the page's WebAssembly: run tools/viewer/wasm")]
    fn the_licences_are_those_of_what_is_compiled_in() {
        let licences = page::QUERIES.unwrap().licences_gz;
        let text = String::from_utf8(unpacked("licences.txt", licences).unwrap()).unwrap();
        // What both the queries and this program have.
        for name in ["three.js", "zstd-sys ", "serde_json ", "pco ", "glam ", "rayon "] {
            assert!(text.lines().any(|line| line.starts_with(name)), "{name}: run tools/viewer/wasm");
        }
    }

    #[test]
    fn the_page_names_its_archives() {
        let page = String::from_utf8_lossy(page::FILES[0].content).into_owned();
        let found = with_archives(&page, &["a&b.isospan".into(), "\"c\" <d>.isospan".into()]);
        assert!(found.contains("content=\"a&amp;b.isospan&#10;&quot;c&quot; &lt;d>.isospan\""), "{found}");
        let policy = found.find("Content-Security-Policy").unwrap();
        assert!(policy < found.find("<script").unwrap() && policy < found.find("<link").unwrap());
    }
}
