//! Says whether the page's WebAssembly lies in `page`, where `tools/viewer/wasm` puts it. Only
//! `isospan publish` needs it.
#![allow(clippy::print_stdout, reason = "cargo reads it")]

use std::env;
use std::path::Path;

fn main() {
    println!("cargo::rustc-check-cfg=cfg(has_wasm)");
    println!("cargo::rerun-if-changed=build.rs");
    if env::var_os("CARGO_FEATURE_VIEW").is_none() {
        return;
    }
    // The folder: for a file that is missing, cargo would compile the crate each time.
    println!("cargo::rerun-if-changed=page");
    if ["isospan.wasm.zst", "licences.txt.gz"].iter().all(|file| Path::new("page").join(file).exists()) {
        println!("cargo::rustc-cfg=has_wasm");
    }
}
