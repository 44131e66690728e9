//! Our part of the comparison with VTK's filters: asks an open archive for one isosurface after
//! another, as a program does while its user drags an isovalue. For each question a line: the
//! round, the isovalue, seconds, CPU seconds, triangles.
//!
//!     ask_archive ARCHIVE THREADS ROUNDS KEPT_MIB ISOVALUE..
//!
//! Each round opens the archive anew and asks for all isovalues. CPU seconds are 0 where the system
//! does not report them so finely.

#![allow(unsafe_code)]
#![allow(clippy::print_stdout)]

use isospan::{Archive, Resources};
use std::time::Instant;

const USAGE: &str = "ask_archive ARCHIVE THREADS ROUNDS KEPT_MIB ISOVALUE..";

fn number<T: std::str::FromStr>(text: Option<String>) -> T {
    text.and_then(|t| t.parse().ok()).unwrap_or_else(|| panic!("usage: {USAGE}"))
}

/// CPU seconds of this process so far.
#[cfg(unix)]
fn cpu_seconds() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the call writes to a structure of ours; where it fails the time stays 0.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &raw mut time) };
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

#[cfg(not(unix))]
fn cpu_seconds() -> f64 {
    0.0
}

fn main() -> isospan::Result<()> {
    let mut args = std::env::args().skip(1);
    let path: String = number(args.next());
    let (threads, rounds, kept): (usize, usize, usize) =
        (number(args.next()), number(args.next()), number(args.next()));
    let isovalues: Vec<f32> = args.map(|v| number(Some(v))).collect();
    for round in 0..rounds {
        let archive = Archive::open(&path)?.keeping(kept << 20);
        let mut surfaces = vec![];
        for &isovalue in &isovalues {
            let query = archive.query(isovalue).resources(Resources::default().with_threads(threads));
            let start = (Instant::now(), cpu_seconds());
            query.meshes_into(&mut surfaces)?;
            let (wall, cpu) = (start.0.elapsed().as_secs_f64(), cpu_seconds() - start.1);
            println!("{round} {isovalue} {wall:.6} {cpu:.6} {}", surfaces[0].triangles.len());
        }
    }
    Ok(())
}
