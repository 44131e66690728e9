//! What the first pass over a file found.

use super::MOST_RUNS;
use super::tokens::Tokens;
use crate::cells::{CellsInfo, Center};

/// A file that was looked through.
pub(super) struct GmshFile {
    pub(super) info: CellsInfo,
    pub(super) version_4: bool,
    /// The first block of nodes, or in version 2.2 the first node.
    pub(super) nodes_start: Tokens,
    pub(super) node_blocks: u64,
    pub(super) nodes: Runs,
    /// The first block of elements, or in version 2.2 the first element.
    pub(super) elements_start: Tokens,
    /// Tags of elements; only known where there are data on them.
    pub(super) elements: Runs,
    pub(super) data: Vec<DataList>,
}

/// A `$NodeData` or `$ElementData` section.
pub(super) struct DataList {
    pub(super) name: String,
    pub(super) step: u64,
    pub(super) center: Center,
    pub(super) components: u32,
    pub(super) entries: u64,
    /// The first entry.
    pub(super) start: Tokens,
}

/// Tags in file order as runs of consecutive ones: first tag, number of the first, length; sorted
/// by tag at the end.
#[derive(Default)]
pub(super) struct Runs {
    runs: Vec<(u64, u64, u64)>,
    pub(super) count: u64,
}

impl Runs {
    /// Adds the next tag; `false` when there are too many runs.
    pub(super) fn push(&mut self, tag: u64) -> bool {
        match self.runs.last_mut() {
            Some((first, _, len)) if tag.checked_sub(*len) == Some(*first) => *len += 1,
            _ => {
                if self.runs.len() == MOST_RUNS {
                    return false;
                }
                self.runs.push((tag, self.count, 1));
            }
        }
        self.count += 1;
        true
    }

    /// Sorts the runs; gives a tag that occurs twice, if there is one.
    pub(super) fn sort(&mut self) -> Option<u64> {
        self.runs.sort_unstable();
        self.runs.windows(2).find(|w| w[0].0 + w[0].2 > w[1].0).map(|w| w[1].0)
    }

    /// The number of a tag.
    pub(super) fn find(&self, tag: u64) -> Option<u64> {
        let after = self.runs.partition_point(|r| r.0 <= tag);
        let (first, index, len) = self.runs[..after].last()?;
        (tag - first < *len).then(|| index + (tag - first))
    }
}
