//! Fuzzing on the stable toolchain: every reader of files and every part of an archive is given
//! damaged inputs, and must answer or refuse in an orderly way.
//!
//! ```text
//! cargo run --bin fuzz -- --seconds 30
//! ```
//!
//! A case is a number: with the seed it decides target, input and damage ([`mutate`]), so a find is
//! repeated with `--seed S --case N`. Inputs are small good files of every format ([`seeds`]), made
//! here and, where `ISOSPAN_SHARED_DATA` names a folder, read there. A find is
//!
//! * a panic,
//! * more than 256 MiB of memory claimed at a time (and 16 times the input), which a counting
//!   allocator sees,
//! * a case of more than ten seconds.
//!
//! Files that lead to a find are made as small as possible and kept in `--keep DIR`. Exit code 1
//! means that there were finds.

#![allow(clippy::print_stdout)]

mod folders;
mod memory;
mod mutate;
mod seeds;
mod targets;

use folders::Folder;
use isospan::{Error, Result};
use mutate::{Random, mutate};
use seeds::FormatSeeds;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use targets::Archive;

#[global_allocator]
static MEMORY: memory::Counting = memory::Counting;

/// Memory that a case may claim besides its input.
const MOST_MEMORY: usize = 256 << 20;
/// Time that a case may take, on a busy machine.
const MOST_TIME: Duration = Duration::from_secs(10);
/// Attempts to make a find smaller.
const SHRINKS: usize = 400;

const HELP: &str = "\
usage: fuzz [--seconds N | --cases N | --case N] [--seed S] [--target NAME] [--keep DIR]
  --seconds N     stop after N seconds [20]
  --cases N       stop after N cases
  --case N        only this case
  --seed S        another sequence of cases [1]
  --target NAME   a file name extension, or folders, blocks, archive: only these cases
  --keep DIR      where inputs of finds are kept [fuzz-finds in the system's temporary folder]";

struct Settings {
    seconds: u64,
    cases: Option<u64>,
    case: Option<u64>,
    seed: u64,
    target: Option<String>,
    keep: PathBuf,
}

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if args.iter().any(|a| a == "--help" || a == "-h") {
        println!("{HELP}");
        return ExitCode::SUCCESS;
    }
    match parse(&args).and_then(|settings| run(&settings)) {
        Ok(0) => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("fuzz: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

fn parse(args: &[String]) -> Result<Settings> {
    let mut settings = Settings {
        seconds: 20,
        cases: None,
        case: None,
        seed: 1,
        target: None,
        keep: std::env::temp_dir().join("fuzz-finds"),
    };
    let mut args = args.iter();
    while let Some(flag) = args.next() {
        let value = args.next().ok_or_else(|| Error::usage(format!("{flag} needs a value\n{HELP}")))?;
        let number = || value.parse().map_err(|_| Error::usage(format!("{flag} {value}: not a number")));
        match flag.as_str() {
            "--seconds" => settings.seconds = number()?,
            "--cases" => settings.cases = Some(number()?),
            "--case" => settings.case = Some(number()?),
            "--seed" => settings.seed = number()?,
            "--target" => settings.target = Some(value.clone()),
            "--keep" => settings.keep = value.into(),
            _ => return Err(Error::usage(format!("unknown option {flag}\n{HELP}"))),
        }
    }
    Ok(settings)
}

/// What a case is about.
enum Target<'a> {
    Volume(&'a FormatSeeds),
    Mesh(&'a FormatSeeds),
    Surface(&'a FormatSeeds),
    Folders(&'a [Folder]),
    Blocks(&'a [Vec<u8>]),
    Arrays(&'a [Vec<u8>]),
    Archive(&'a Archive),
}

impl Target<'_> {
    fn name(&self) -> &'static str {
        match self {
            Self::Volume(f) | Self::Mesh(f) | Self::Surface(f) => f.extension,
            Self::Folders(_) => "folders",
            Self::Blocks(_) => "blocks",
            Self::Arrays(_) => "arrays",
            Self::Archive(_) => "archive",
        }
    }
}

/// The case under way, for the watchdog: its number plus one, and when it began.
struct Watched {
    case: AtomicU64,
    began: Mutex<Instant>,
}

fn run(settings: &Settings) -> Result<u64> {
    let base = Some(PathBuf::from("/dev/shm")).filter(|p| p.is_dir()).unwrap_or_else(std::env::temp_dir);
    let scratch = tempfile::Builder::new().prefix("isospan-fuzz-").tempdir_in(&base);
    let scratch = scratch.map_err(|e| Error::io("create a folder in", &base, e))?;
    let folder = scratch.path();
    let [volumes, meshes, surfaces] = seeds::all(folder)?;
    let archive = Archive::make(folder)?;
    let blocks = archive.block_inputs()?;
    let (folders, arrays) = (folders::all(), seeds::arrays()?);
    let mut targets: Vec<Target<'_>> = volumes.iter().map(Target::Volume).collect();
    targets.extend(meshes.iter().map(Target::Mesh));
    targets.extend(surfaces.iter().map(Target::Surface));
    targets.extend([Target::Blocks(&blocks), Target::Arrays(&arrays)]);
    // Folders are of many kinds.
    targets.extend([Target::Folders(&folders), Target::Folders(&folders), Target::Folders(&folders)]);
    // An archive has several parts; each case of it costs more than one of a file.
    targets.extend([Target::Archive(&archive), Target::Archive(&archive)]);
    if let Some(name) = &settings.target {
        targets.retain(|t| t.name() == name);
        if targets.is_empty() {
            return Err(Error::usage(format!("there is no target {name}")));
        }
    }
    let said = quiet_panics();
    let watched = watch(settings.seed);
    let fuzzer = Fuzzer { settings, targets, folder, said, watched };
    fuzzer.all()
}

struct Fuzzer<'a> {
    settings: &'a Settings,
    targets: Vec<Target<'a>>,
    folder: &'a Path,
    /// What the last panic said.
    said: Arc<Mutex<String>>,
    watched: Arc<Watched>,
}

impl Fuzzer<'_> {
    fn all(&self) -> Result<u64> {
        let (start, settings) = (Instant::now(), self.settings);
        let (mut case, last) = settings.case.map_or((0, u64::MAX), |c| (c, c));
        let mut finds = BTreeMap::<String, u64>::new();
        let mut refused = 0u64;
        let first = case;
        while case <= last
            && settings.cases.is_none_or(|n| case < n)
            && (settings.cases.is_some()
                || settings.case.is_some()
                || start.elapsed().as_secs() < settings.seconds)
        {
            *self.watched.began.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
            self.watched.case.store(case + 1, Relaxed);
            match self.case(case)? {
                Outcome::Answered => {}
                Outcome::Refused => refused += 1,
                Outcome::Find(find) => {
                    // One fault shows in many cases: report each place once.
                    let times = finds.entry(find.place.clone()).or_default();
                    *times += 1;
                    if *times == 1 {
                        eprintln!(
                            "FIND {}\n  repeat: --seed {} --case {case}\n  {}",
                            find.place, settings.seed, find.input
                        );
                    }
                }
            }
            self.watched.case.store(0, Relaxed);
            case += 1;
        }
        let cases = case - first;
        println!(
            "fuzz: {cases} cases, {refused} refused, {} finds at {} places",
            finds.values().sum::<u64>(),
            finds.len()
        );
        if cases > 1000 && (refused * 20 < cases || refused == cases) {
            return Err(Error::usage(
                "the damage does not reach the readers: hardly any or all inputs were refused",
            ));
        }
        Ok(finds.len() as u64)
    }

    fn case(&self, number: u64) -> Result<Outcome> {
        let mut random = Random::new(self.settings.seed, number);
        let target = &self.targets[random.below(self.targets.len())];
        let format = match target {
            Target::Volume(f) | Target::Mesh(f) | Target::Surface(f) => f,
            Target::Blocks(inputs) => {
                let [input, other] = [0; 2].map(|_| random.pick::<Vec<u8>>(inputs));
                let bytes = mutate(input, other, &mut random);
                return Ok(self.guarded(bytes.len(), || targets::blocks(&bytes)).told(|| text(&bytes)));
            }
            Target::Arrays(inputs) => {
                let [input, other] = [0; 2].map(|_| random.pick::<Vec<u8>>(inputs));
                let bytes = mutate(input, other, &mut random);
                return Ok(self.guarded(bytes.len(), || targets::array(&bytes)).told(|| text(&bytes)));
            }
            Target::Folders(folders) => {
                let (mut what, folder) = (String::new(), self.folder.join("case.folder"));
                let one = random.pick::<Folder>(folders);
                return Ok(self.guarded(1 << 10, || one.case(&folder, &mut random, &mut what)).told(|| what));
            }
            Target::Archive(archive) => {
                let mut what = String::new();
                let outcome = self.guarded(1 << 16, || archive.case(&mut random, &mut what));
                archive.repair()?;
                return Ok(outcome.told(|| what));
            }
        };
        let [input, other] = [0; 2].map(|_| random.pick::<Vec<u8>>(&format.inputs));
        let bytes = damaged(input, other, &mut random);
        let path = self.folder.join(format!("case.{}", format.extension));
        let ask = |bytes: &[u8]| -> Result<Outcome> {
            seeds::put(&path, bytes)?;
            Ok(self.guarded(bytes.len(), || match target {
                Target::Volume(_) => targets::volume(&path, bytes),
                Target::Mesh(_) => targets::mesh(&path),
                _ => targets::surface(&path),
            }))
        };
        match ask(&bytes)? {
            Outcome::Find(find) => {
                let small =
                    shrink(bytes, |b| matches!(ask(b), Ok(Outcome::Find(f)) if f.place == find.place));
                let kept = self.keep(&small, number, format.extension)?;
                Ok(Outcome::Find(find).told(|| format!("{}: {}", kept.display(), text(&small))))
            }
            other => Ok(other),
        }
    }

    fn keep(&self, bytes: &[u8], case: u64, extension: &str) -> Result<PathBuf> {
        let keep = &self.settings.keep;
        std::fs::create_dir_all(keep).map_err(|e| Error::io("create", keep, e))?;
        let path = keep.join(format!("{}-{case}.{extension}", self.settings.seed));
        seeds::put(&path, bytes)?;
        Ok(path)
    }

    /// Runs a case, and judges how it ended.
    fn guarded(&self, len: usize, job: impl FnOnce() -> Result<()>) -> Outcome {
        let before = memory::begin();
        let result = catch_unwind(AssertUnwindSafe(job));
        let claimed = memory::peak_since(before);
        let find = |place: String| Outcome::Find(Find { place, input: String::new() });
        if claimed > MOST_MEMORY + 16 * len {
            return find(format!("{} MiB claimed for an input of {len} bytes", claimed >> 20));
        }
        match result {
            Err(_) => find(format!("panic: {}", self.said.lock().unwrap_or_else(PoisonError::into_inner))),
            Ok(Ok(())) => Outcome::Answered,
            Ok(Err(_)) => Outcome::Refused,
        }
    }
}

enum Outcome {
    Answered,
    Refused,
    Find(Find),
}

struct Find {
    /// What happened and where in the source; the same for all cases of one fault.
    place: String,
    input: String,
}

impl Outcome {
    fn told(self, input: impl FnOnce() -> String) -> Self {
        match self {
            Self::Find(find) => Self::Find(Find { input: input(), ..find }),
            other => other,
        }
    }
}

/// Damage to a file; inside of a gzip file, mostly, as damaged gzip is all alike.
fn damaged(input: &[u8], other: &[u8], random: &mut Random) -> Vec<u8> {
    if input.starts_with(&[0x1f, 0x8b]) && random.below(4) > 0 {
        let mut plain = vec![];
        let whole = std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(input), &mut plain);
        if whole.is_ok() {
            let mut gz = flate2::write::GzEncoder::new(vec![], flate2::Compression::fast());
            let changed = mutate(&plain, b"", random);
            if std::io::Write::write_all(&mut gz, &changed).is_ok() {
                return gz.finish().unwrap_or_default();
            }
        }
    }
    mutate(input, other, random)
}

/// Leaves out parts, ever smaller ones, as long as what is left still `fails`.
fn shrink(mut bytes: Vec<u8>, fails: impl Fn(&[u8]) -> bool) -> Vec<u8> {
    let (mut part, mut tries) = (bytes.len() / 2, 0);
    while part > 0 && tries < SHRINKS {
        let mut at = 0;
        while at < bytes.len() && tries < SHRINKS {
            let end = bytes.len().min(at + part);
            let less = [&bytes[..at], &bytes[end..]].concat();
            tries += 1;
            if fails(&less) { bytes = less } else { at = end }
        }
        part /= 2;
    }
    bytes
}

/// Bytes as a literal of Rust; of many, the first.
fn text(bytes: &[u8]) -> String {
    const MOST: usize = 600;
    let more = if bytes.len() > MOST { format!(" … {} bytes in all", bytes.len()) } else { String::new() };
    format!("b\"{}\"{more}", bytes[..bytes.len().min(MOST)].escape_ascii())
}

/// Keeps what panics say instead of printing it.
fn quiet_panics() -> Arc<Mutex<String>> {
    let said = Arc::new(Mutex::new(String::new()));
    let last = Arc::clone(&said);
    std::panic::set_hook(Box::new(move |info| {
        let payload = info.payload();
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let message = text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("no message");
        let place = info.location().map_or_else(String::new, ToString::to_string);
        *last.lock().unwrap_or_else(PoisonError::into_inner) = format!("{place}: {message}");
    }));
    said
}

/// Ends the program when a case takes too long: a hang cannot be stopped from within.
fn watch(seed: u64) -> Arc<Watched> {
    let watched = Arc::new(Watched { case: AtomicU64::new(0), began: Mutex::new(Instant::now()) });
    let mine = Arc::clone(&watched);
    std::thread::spawn(move || {
        loop {
            std::thread::sleep(Duration::from_millis(500));
            let (case, began) =
                (mine.case.load(Relaxed), *mine.began.lock().unwrap_or_else(PoisonError::into_inner));
            if case > 0 && began.elapsed() > MOST_TIME {
                eprintln!(
                    "FIND a case of more than {} s\n  repeat: --seed {seed} --case {}",
                    MOST_TIME.as_secs(),
                    case - 1
                );
                std::process::exit(1);
            }
        }
    });
    watched
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_are_made_small() {
        let bytes: Vec<u8> = (0..200).collect();
        assert_eq!(shrink(bytes, |b| b.contains(&77) && b.contains(&150)), [77, 150]);
    }

    #[test]
    fn panics_and_claims_are_finds() {
        let settings = parse(&[]).unwrap();
        let (said, watched) = (quiet_panics(), watch(1));
        let fuzzer = Fuzzer { settings: &settings, targets: vec![], folder: Path::new("."), said, watched };
        let place = |job: &dyn Fn() -> Result<()>| match fuzzer.guarded(10, job) {
            Outcome::Find(find) => find.place,
            _ => String::new(),
        };
        let panics = place(&|| panic!("a broken invariant"));
        let _ = std::panic::take_hook();
        assert!(panics.contains("main.rs") && panics.contains("a broken invariant"), "{panics}");
        let claims = place(&|| {
            std::hint::black_box(vec![0u8; 300 << 20]);
            Ok(())
        });
        assert!(claims.contains("MiB claimed"), "{claims}");
        assert_eq!(place(&|| Err(Error::usage("one\ntwo"))) + &place(&|| Ok(())), "");
    }

    /// The seeds are good files, or most damage would never get past their first lines.
    #[test]
    fn seeds_are_good() {
        let dir = tempfile::tempdir().unwrap();
        let [volumes, meshes, surfaces] = seeds::all(dir.path()).unwrap();
        std::fs::write(dir.path().join("samples.raw"), [1; 48]).unwrap();
        for format in &volumes {
            let path = dir.path().join(format!("seed.{}", format.extension));
            seeds::put(&path, &format.inputs[0]).unwrap();
            let outcome = targets::volume(&path, &format.inputs[0]);
            // Those whose samples lie in other files are good headers.
            let header_only = ["nhdr", "hdr"].contains(&format.extension);
            assert!(outcome.is_ok() || header_only, "{}: {}", format.extension, outcome.unwrap_err());
        }
        for format in &meshes {
            let path = dir.path().join(format!("seed.{}", format.extension));
            seeds::put(&path, &format.inputs[0]).unwrap();
            targets::mesh(&path).unwrap();
        }
        for format in &surfaces {
            let path = dir.path().join(format!("seed.{}", format.extension));
            for input in format.inputs.iter().take(2) {
                seeds::put(&path, input).unwrap();
                targets::surface(&path).unwrap();
            }
        }
        for (number, folder) in folders::all().iter().enumerate() {
            let read = folder.read(&dir.path().join(format!("folder_{number}")));
            read.unwrap_or_else(|e| panic!("folder {number}: {e}"));
        }
        let archive = Archive::make(dir.path()).unwrap();
        assert!(archive.block_inputs().unwrap().len() > 20);
        seeds::arrays().unwrap().iter().for_each(|array| targets::array(array).unwrap());
    }
}
