//! Builds indexes of synthetic blocks in 256 MiB, asks them, and prints how many pages were touched
//! against √(n/L) + k/L, where n is the number of entries, k of answers, and L = 128 the least
//! entries of a full page.
//!
//! `cargo run --release --bin index_pages -- 1000000 10000000 100000000` (the last takes 5 GB
//! of disk in the system's temporary folder, and as much memory as it is given)
//!
//! On 2 cores of an AMD EPYC (virtual machine, shared, 2026-11-21), one run; 10^8 entries took
//! about 30 seconds of CPU time:
//!
//! | entries | anonymous memory | file | bytes to open | isovalue | answers | pages | √(n/L) + k/L | bytes read |
//! |---|---|---|---|---|---|---|---|---|
//! | 10^6 | 23 MiB | 13 MB | 4 204 | 0.5 | 900 | 31 | 95 | 86 kB |
//! | 10^7 | 253 MiB | 131 MB | 4 204 | 0.5 | 8 996 | 126 | 350 | 312 kB |
//! | 10^8 | 239 MiB | 1.4 GB | 4 204 | 0.0005 | 66 695 | 716 | 1405 | 1.5 MB |
//! | 10^8 | | | 4 204 | 0.5 | 89 933 | 1 160 | 1586 | 2.8 MB |

#![allow(clippy::print_stdout)]

use isospan::archive::segment::PlanHash;
use isospan::index::{BuildSettings, Entry, IndexBuilder, SpanIndex};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

const MEMORY: u64 = 256 << 20;
const PLAN: PlanHash = PlanHash(1);
const BLOCKS_A_CHUNK: u64 = 1700;

/// Middles spread over 0..1, widths mostly small, and one in a thousand up to a tenth of the range.
fn entry(i: u64) -> Entry {
    let spread = |by: u64| ((i + 1).wrapping_mul(by) >> 40) as f32 / (1u64 << 24) as f32;
    let (middle, w) = (spread(0x9e37_79b9_7f4a_7c15), spread(0xd1b5_4a32_d192_ed03));
    let width = if i.is_multiple_of(1000) { 0.1 * w } else { 0.002 * w * w * w * w };
    let (chunk, block) = (i / BLOCKS_A_CHUNK, (i % BLOCKS_A_CHUNK) as u32);
    Entry { min: middle - width, max: middle + width, chunk, block, tets: 1000 }
}

/// Anonymous memory of this process, in KiB; 0 where the system does not report it.
fn anonymous_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("RssAnon:"));
    line.and_then(|l| l.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

/// Runs `work` and returns the most anonymous memory seen meanwhile.
fn watched<T>(work: impl FnOnce() -> T) -> (T, u64) {
    let (peak, done) = (AtomicU64::new(0), AtomicBool::new(false));
    std::thread::scope(|threads| {
        threads.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                peak.fetch_max(anonymous_kib(), Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        let result = work();
        done.store(true, Ordering::Relaxed);
        (result, peak.load(Ordering::Relaxed))
    })
}

fn build(n: u64, path: &Path) -> isospan::Result<()> {
    let mut index = IndexBuilder::new(&BuildSettings { memory: MEMORY, scratch: None });
    (0..n).try_for_each(|i| index.push(entry(i)))?;
    index.finish(path, PLAN).map(drop)
}

fn ask(n: u64, path: &Path) -> isospan::Result<()> {
    for isovalue in [0.0005f32, 0.1, 0.5, 0.9] {
        let start = Instant::now();
        let index = SpanIndex::open(path, Some(PLAN))?;
        let opened = index.segment().expect("a file").bytes_read();
        let found = index.query(isovalue)?.len() as u64;
        let took = start.elapsed();
        let brute = if n <= 10_000_000 {
            (0..n).map(entry).filter(|e| e.min < isovalue && isovalue <= e.max).count() as u64
        } else {
            found
        };
        assert_eq!(found, brute, "a query is a scan");
        let expected = (n as f64 / 128.0).sqrt() + found as f64 / 128.0;
        println!(
            "{n:>11}  {isovalue:<7} {found:>8} {:>7} {expected:>9.0} {:>6.2} {opened:>8} {:>9} {:>8.1}",
            index.pages_read(),
            index.pages_read() as f64 / expected,
            index.segment().expect("a file").bytes_read(),
            took.as_secs_f64() * 1e3
        );
    }
    Ok(())
}

fn main() -> isospan::Result<()> {
    let sizes: Vec<u64> =
        std::env::args().skip(1).map(|a| a.parse().expect("arguments are numbers of entries")).collect();
    let sizes = if sizes.is_empty() { vec![1_000_000] } else { sizes };
    let folder = tempfile::tempdir().expect("the system's temporary folder can be written");
    let path = folder.path().join("index.seg");
    for n in sizes {
        let start = Instant::now();
        let (built, peak) = watched(|| build(n, &path));
        built?;
        println!(
            "{n} entries: built in {:.1} s, at most {} MiB of anonymous memory, {} bytes",
            start.elapsed().as_secs_f64(),
            peak >> 10,
            std::fs::metadata(&path).map_or(0, |m| m.len())
        );
        println!("          n  isovalue answers   pages  √n/L+k/L  ratio   opened      read       ms");
        ask(n, &path)?;
    }
    Ok(())
}
