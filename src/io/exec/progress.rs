//! How a run reports its progress. The library draws nothing itself.

/// A try of a search for a target, which begins.
#[derive(Clone, Copy, Debug)]
pub struct Attempt {
    /// Its number: the first is 1.
    pub number: u32,
    /// About how many there will be.
    pub about: u32,
    /// What the try before reached, in this run.
    pub last: Option<Reached>,
}

/// What a try of a search reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reached {
    /// "RMS error", "largest error", "distance" or "bytes".
    pub quantity: &'static str,
    /// How much of it the try has.
    pub value: f64,
    /// How much it may have.
    pub wanted: f64,
}

/// Receives the progress of a run; called from several threads.
pub trait Progress: Send + Sync {
    /// A stage of `total` units begins; it ends the one before.
    fn begin(&self, stage: &str, total: u64, unit: &str);
    /// `units` more are done.
    fn advance(&self, units: u64);
    /// The last stage is over.
    fn end(&self);
    /// Something that the user should know, as a line. Nothing by default: reports have it
    /// too.
    fn notice(&self, _line: &str) {}
    /// A try of a search for a target begins: the stages that follow are its own. Nothing by
    /// default.
    fn attempt(&self, _attempt: &Attempt) {}
}

/// Hears and says nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &str, _total: u64, _unit: &str) {}
    fn advance(&self, _units: u64) {}
    fn end(&self) {}
}
