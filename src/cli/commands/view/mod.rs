//! `isospan view`: archives in a browser, served from this machine to itself.
//!
//! ```text
//!  browser ─▶ connections: places, seconds ─▶ server: token, host, limits ─▶ answers
//!     ▲                                                                        │
//!     └───────────── bytes, streamed ◀── blocking work in a slot ◀─────────────┘
//!  page: the files of src/cli/page, compiled in               archives: those that are open
//! ```

mod connections;
pub(super) mod page;
mod server;

use super::grammar;
use super::machine::Machine;
use super::progress::Talk;
use crate::answers::Archives;
use isospan::{Error, Result};
use std::io::Write as _;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::time::Instant;
use tempfile::NamedTempFile;

/// Show archives in a browser.
///
/// The page has isosurfaces, slices, time steps, and exports of what is seen.
/// Serves a page on this machine only, at an address with a secret token, until Ctrl-C. On a remote
/// machine, forward the port with ssh -L 8417:127.0.0.1:8417 HOST, and give --port 8417.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan view scan.isospan --open\n  isospan view a.isospan b.isospan --port 8417"
)]
pub struct Args {
    /// The archives: folders, or addresses, s3://... or https://...
    #[arg(required = true, value_name = "ARCHIVE")]
    archives: Vec<PathBuf>,
    /// The port on 127.0.0.1; 0 takes a free one.
    #[arg(long, value_name = "N", default_value = "0", value_parser = grammar::whole::<u16>, allow_negative_numbers = true)]
    port: u16,
    /// Open the page in the default browser.
    #[arg(long)]
    open: bool,
    #[command(flatten)]
    machine: Machine,
    /// Folder for what does not fit in memory [default: the system's temporary folder].
    #[arg(help_heading = "Resources", long, value_name = "FOLDER")]
    scratch: Option<PathBuf>,
    /// Print the address as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let means = args.machine.resources(args.scratch.clone(), talk);
    let archives = Archives::open(&args.archives, means.memory / server::SHARE, now)?;
    let stop = means.cancel.clone();
    let token = token()?;
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
    // Removed when the server ends.
    let mut door = None;
    let started = |address: SocketAddr| -> Result<()> {
        let url = format!("http://{address}/{token}/");
        if args.json {
            super::print_json("view", &serde_json::json!({ "url": url, "port": address.port() }))?;
        } else {
            super::print(&format!("{url}\n"))?;
            talk.note("the page is served until Ctrl-C; who has the address can see the archives");
        }
        if args.open {
            door = Some(door_to(&url, args.scratch.as_deref())?);
            door.as_ref().map_or(Ok(()), |door| open_in_browser(door.path()))
        } else {
            Ok(())
        }
    };
    server::serve(archives, means, address, &token, &stop, started)
}

/// A file that leads to the page, which this user alone can read. A browser is started with its
/// name: what a program is started with, every user of the machine can see.
fn door_to(url: &str, scratch: Option<&Path>) -> Result<NamedTempFile> {
    let folder = scratch.map_or_else(std::env::temp_dir, Path::to_path_buf);
    let failed = |e| Error::io("write a file in", &folder, e);
    let mut file = tempfile::Builder::new()
        .prefix("isospan-view-")
        .suffix(".html")
        .tempfile_in(&folder)
        .map_err(failed)?;
    let page = format!(
        "<!DOCTYPE html>\n<meta charset=\"utf-8\">\n<meta name=\"referrer\" content=\"no-referrer\">\n\
         <meta http-equiv=\"refresh\" content=\"0; url={url}\">\n\
         <title>isospan</title>\n<a href=\"{url}\">isospan view</a>\n"
    );
    file.write_all(page.as_bytes()).and_then(|()| file.flush()).map_err(failed)?;
    Ok(file)
}

/// Milliseconds on a clock that never goes back.
fn now() -> f64 {
    static BEGIN: LazyLock<Instant> = LazyLock::new(Instant::now);
    BEGIN.elapsed().as_secs_f64() * 1e3
}

/// 128 random bits, in hexadecimal.
fn token() -> Result<String> {
    let mut bits = [0; 16];
    getrandom::fill(&mut bits)
        .map_err(|e| Error::io("read", "the system's random numbers", std::io::Error::other(e)))?;
    Ok(bits.iter().map(|b| format!("{b:02x}")).collect())
}

/// Starts the default browser. Where there is none, a line on standard error says so, and the page
/// is still served.
fn open_in_browser(page: &Path) -> Result<()> {
    let program = match std::env::consts::OS {
        "macos" => "open",
        "windows" => "explorer",
        _ => "xdg-open",
    };
    let quiet = |c: &mut Command| {
        c.arg(page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()
    };
    if let Err(e) = quiet(&mut Command::new(program)) {
        let _ =
            writeln!(std::io::stderr(), "isospan: cannot start {program} ({e}); open the address by hand");
    }
    Ok(())
}
