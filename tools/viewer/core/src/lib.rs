//! The questions of the viewer's page, answered in the page: what `isospan publish` puts beside it,
//! as WebAssembly.
//!
//! ```text
//!  page ─▶ worker.js ─▶ answer("0/surface?isovalues=600") ─▶ the answers of `isospan view` ─▶ pieces ─▶ page
//!                  ◀─ fetch(name, range) ◀─ pages of 16 KiB, read ahead, kept ◀─┘
//! ```
//!
//! Addresses and answers are those of the server of `isospan view`. `tools/viewer/wasm` makes the
//! file that the program has. On other machines nobody asks: the compiler checks what there is.
#![cfg_attr(not(target_arch = "wasm32"), allow(dead_code))]

#[cfg(target_arch = "wasm32")]
mod host;

#[cfg(target_arch = "wasm32")]
use host::{is_stopped, now};
use isospan::exec::CancelToken;
use isospan::{Error, Resources, Result};
use isospan_cli::answers::{self, Archives, Sink};
use serde::de::DeserializeOwned;
use std::path::PathBuf;

/// Other machines have nobody to ask for the time.
#[cfg(not(target_arch = "wasm32"))]
fn now() -> f64 {
    0.0
}

/// Nor for what it no longer wants.
#[cfg(not(target_arch = "wasm32"))]
fn is_stopped() -> bool {
    false
}

/// Bytes for one answer. A page has 4 GiB at most.
const MEMORY: u64 = 2 << 30;
/// Bytes of decoded blocks, for the next isovalue.
const KEPT: u64 = 1 << 30;
/// Where what does not fit in memory would go.
const SCRATCH: &str = "no disk";

/// Archives that are asked.
pub struct Viewer {
    archives: Archives,
    means: Resources,
}

impl Viewer {
    /// Opens the archives of some addresses.
    ///
    /// # Errors
    /// When one cannot be opened.
    pub fn open(addresses: &[PathBuf]) -> Result<Self> {
        let means = Resources::default().with_threads(1).with_memory(MEMORY);
        let means = means.with_scratch(PathBuf::from(SCRATCH)).with_cancel(CancelToken::asking(is_stopped));
        Ok(Self { archives: Archives::open(addresses, KEPT, now)?, means })
    }

    /// Answers a question, by the address that a server has for it.
    fn answer(&self, address: &str, sink: &mut dyn Sink) -> Result<()> {
        let (path, query) = address.split_once('?').unwrap_or((address, ""));
        let unknown = || Error::usage(format!("'{path}' is no question"));
        let Some((archive, question)) = path.split_once('/') else {
            return match path {
                "archives" => answers::archives(&self.archives, sink),
                "colours" => answers::colours(sink),
                _ => Err(unknown()),
            };
        };
        let archive = archive.parse().map_err(|_| unknown())?;
        let (archives, means) = (&self.archives, &self.means);
        match question {
            "spectrum" => answers::spectrum(archives, archive, &parameters(query)?, means, sink),
            "bounds" => answers::bounds(archives, archive, &parameters(query)?, means, sink),
            "surface" => answers::surface(archives, archive, &parameters(query)?, means, sink),
            "export" => answers::export(archives, archive, &parameters(query)?, means, sink),
            "slice" => answers::slice(archives, archive, &parameters(query)?, means, sink),
            _ => Err(unknown()),
        }
    }
}

fn parameters<Q: DeserializeOwned>(query: &str) -> Result<Q> {
    serde_urlencoded::from_str(query).map_err(|e| Error::usage(format!("'{query}': {e}")))
}

/// A status of HTTP, and what to tell a person.
fn refusal(error: &Error) -> (u32, String) {
    match error {
        Error::Io { path, .. } if path.as_os_str() == SCRATCH => (
            413,
            "this takes more memory than a page has: choose a region, or use isospan on a machine".into(),
        ),
        Error::Usage(_) | Error::NoSuch(_) => (400, error.to_string()),
        Error::Budget { .. } => (413, error.to_string()),
        _ => (500, error.to_string()),
    }
}
