//! Makes the thesis's data sets: SPHERE, SEIS, HEART, TORSO and HEAD. [`data`] says what they are.

mod data;

use data::{Content, Dataset};
use isospan::{Error, Result};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const HELP: &str = "\
usage: thesis_data FOLDER [NAME…]
  FOLDER   where the files go
  NAME     of sphere, seis, heart, torso, head; all if none is given
Real geometries of heart and torso are taken from the folder that ISOSPAN_SHARED_DATA names; without it, ellipsoids.";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if args.is_empty() || args.iter().any(|a| a.starts_with('-')) {
        eprintln!("{HELP}");
        let asked = args.iter().any(|a| a == "--help" || a == "-h");
        return ExitCode::from(if asked { 0 } else { 2 });
    }
    match run(Path::new(&args[0]), &args[1..]) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("thesis_data: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

fn run(folder: &Path, names: &[String]) -> Result<()> {
    let known = |name: &String| Dataset::ALL.into_iter().find(|d| d.name().eq_ignore_ascii_case(name));
    let mut wanted = names
        .iter()
        .map(|name| {
            known(name).ok_or_else(|| Error::usage(format!("there is no data set {name:?}; see --help")))
        })
        .collect::<Result<Vec<_>>>()?;
    if wanted.is_empty() {
        wanted.extend(Dataset::ALL);
    }
    let shared = std::env::var_os("ISOSPAN_SHARED_DATA").map(PathBuf::from);
    for dataset in wanted {
        let made = dataset.make(folder, shared.as_deref())?;
        let values = made.values().len();
        let size = match &made.content {
            Content::Grid { geometry, .. } => format!("{values} samples, spacing {:.4}", geometry.spacing[0]),
            Content::Mesh(mesh) => format!("{values} vertices, {} tetrahedra", mesh.tets.len()),
        };
        let name = made.dataset.name();
        eprintln!("{name}: {}: {size}; isovalue {}; {}", made.file.display(), made.isovalue, made.origin);
    }
    Ok(())
}
