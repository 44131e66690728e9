//! The flags that say how a run uses the machine; they change no byte of what it makes.

use super::{grammar, progress::Talk, signals};
use isospan::Resources;
use isospan::exec::CancelToken;
use isospan::pipeline::RunSettings;
use std::path::PathBuf;

/// Threads and memory.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Machine {
    /// Threads; 0 means as many as the process may use.
    #[arg(help_heading = "Resources", long, value_name = "N", default_value = "0", value_parser = grammar::threads, allow_negative_numbers = true)]
    pub(crate) threads: usize,
    /// Limit of memory: 4GiB, 500MB or 50% [default: half of what the process may use]. Pages of
    /// mapped files do not count.
    #[arg(help_heading = "Resources", long, value_name = "SIZE", value_parser = grammar::memory, allow_hyphen_values = true)]
    memory: Option<u64>,
}

impl Machine {
    /// The memory of a run: what was asked for, or half of what the process may use; that number is
    /// reported.
    pub(crate) fn memory(&self, talk: &Talk) -> u64 {
        super::memory(self.memory, talk)
    }

    /// What a command may use, stopped by signals.
    pub(crate) fn resources(&self, scratch: Option<PathBuf>, talk: &Talk) -> Resources {
        self.resources_until(scratch, talk, signals::cancel_token())
    }

    fn resources_until(&self, scratch: Option<PathBuf>, talk: &Talk, cancel: CancelToken) -> Resources {
        let resources = Resources::default().with_threads(self.threads).with_memory(self.memory(talk));
        resources.with_scratch(scratch).with_cancel(cancel)
    }

    /// Settings of a reduction that replaces nothing, stopped by signals.
    pub(crate) fn run(&self, scratch: &InputScratch, talk: &Talk) -> RunSettings {
        self.run_until(scratch, talk, signals::cancel_token())
    }

    /// As [`Machine::run`], stopped by a token.
    pub(crate) fn run_until(&self, scratch: &InputScratch, talk: &Talk, cancel: CancelToken) -> RunSettings {
        RunSettings {
            resources: self.resources_until(scratch.scratch.clone(), talk, cancel),
            ..RunSettings::default()
        }
    }
}

/// Where temporary files of a query go.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct OutputScratch {
    /// Folder for what does not fit in memory [default: the output's folder].
    #[arg(help_heading = "Resources", long, value_name = "FOLDER")]
    pub(crate) scratch: Option<PathBuf>,
}

/// Where temporary files of a reduction go.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct InputScratch {
    /// Folder for the uncompressed copy of a compressed input and for what does not fit in memory
    /// [default: the system's temporary folder].
    #[arg(help_heading = "Resources", long, value_name = "FOLDER")]
    pub(crate) scratch: Option<PathBuf>,
}
