//! Checks whether a segment is done. A file of its name is not enough: its header, plan, length and
//! checksums must be right.

use crate::archive::chunked::ChunkSegment;
use crate::archive::segment::{PlanHash, SegmentKind};
use isospan_io::error::Error;
use std::fmt;
use std::ops::Range;
use std::path::Path;

/// How much of a file is read to judge it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::pipeline) enum Depth {
    /// Header, footer and chunk table: a file that was cut short is found, a flipped bit in a block
    /// is not.
    Frame,
    /// Every byte.
    All,
}

/// What was found under a segment's name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::pipeline) enum SegmentState {
    /// The segment, of this plan and these chunks.
    Whole,
    /// Nothing.
    Missing,
    /// A segment of another plan.
    OtherPlan,
    /// Something else; the text says what is wrong with it.
    Damaged(String),
}

impl SegmentState {
    /// In a word or two.
    pub(in crate::pipeline) fn name(&self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::Missing => "not there",
            Self::OtherPlan => "of another plan",
            Self::Damaged(_) => "damaged",
        }
    }
}

impl fmt::Display for SegmentState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damaged(why) => write!(f, "{}: {why}", self.name()),
            _ => f.write_str(self.name()),
        }
    }
}

/// Looks at the file of a segment.
pub(in crate::pipeline) fn inspect(
    path: &Path,
    kind: SegmentKind,
    plan: PlanHash,
    chunks: &Range<u64>,
    depth: Depth,
) -> SegmentState {
    let found = match ChunkSegment::open(path, kind, None) {
        Ok(segment) => segment,
        Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
            return SegmentState::Missing;
        }
        Err(e) => return SegmentState::Damaged(reason(&e)),
    };
    if found.segment().plan() != plan {
        return SegmentState::OtherPlan;
    }
    if found.chunks() != *chunks {
        return SegmentState::Damaged(format!("it has chunks {:?}, not {chunks:?}", found.chunks()));
    }
    match depth {
        Depth::Frame => SegmentState::Whole,
        Depth::All => match found.segment().verify() {
            Ok(()) => SegmentState::Whole,
            Err(e) => SegmentState::Damaged(reason(&e)),
        },
    }
}

/// An error without the file's name, which is shown next to it.
fn reason(error: &Error) -> String {
    match error {
        Error::BadInput(bad) => format!("{}: expected {}, got {}", bad.at, bad.expected, bad.got),
        Error::Io { doing, source, .. } => format!("cannot {doing} it: {source}"),
        other => other.to_string(),
    }
}
