//! `isospan completions` and `isospan man`.

use super::Cli;
use clap::CommandFactory;
use isospan::{Error, Result};
use std::path::PathBuf;

/// Print a completion script for a shell.
#[derive(clap::Args, Debug)]
pub(crate) struct CompletionsArgs {
    /// The shell.
    shell: clap_complete::Shell,
}

/// Print the manual page, or write one page per command into a folder.
#[derive(clap::Args, Debug)]
pub(crate) struct ManArgs {
    /// Write isospan.1, isospan-info.1, … into this folder instead.
    #[arg(long, value_name = "FOLDER")]
    dir: Option<PathBuf>,
}

pub(crate) fn completions(args: &CompletionsArgs) -> Result<()> {
    let mut text = vec![];
    clap_complete::generate(args.shell, &mut Cli::command(), "isospan", &mut text);
    super::print(&String::from_utf8_lossy(&text))
}

pub(crate) fn man(args: &ManArgs) -> Result<()> {
    if let Some(dir) = &args.dir {
        std::fs::create_dir_all(dir).map_err(|e| Error::io("create", dir, e))?;
        return clap_mangen::generate_to(Cli::command(), dir)
            .map_err(|e| Error::io("write the manual pages to", dir, e));
    }
    let mut text = vec![];
    clap_mangen::Man::new(Cli::command())
        .render(&mut text)
        .map_err(|e| Error::io("render", "the manual page", e))?;
    super::print(&String::from_utf8_lossy(&text))
}
