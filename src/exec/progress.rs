//! How a run reports its progress. The library draws nothing itself.

/// Receives the progress of a run; called from several threads.
pub trait Progress: Send + Sync {
    /// A stage of `total` units begins; it ends the one before.
    fn begin(&self, stage: &str, total: u64, unit: &str);
    /// `units` more are done.
    fn advance(&self, units: u64);
    /// The last stage is over.
    fn end(&self);
    /// Something that the user should know, as a line; see [`Notice`](crate::pipeline::Notice).
    /// Nothing by default: reports have it too.
    fn notice(&self, _line: &str) {}
}

/// Hears and says nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &str, _total: u64, _unit: &str) {}
    fn advance(&self, _units: u64) {}
    fn end(&self) {}
}
