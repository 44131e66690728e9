//! Builds an index: kd-splits in memory, or on disk beyond a given memory (`external.rs`); pages
//! depth first.

use super::Entry;
use super::external::Spill;
use super::page::{Bounds, LEAF_ENTRIES, PAGE_LEVELS};
use super::subtree::{SplitAxis, write_subtree};
use crate::archive::segment::{PlanHash, SegmentInfo, SegmentKind, SegmentWriter};
use isospan_io::error::Result;
use std::path::{Path, PathBuf};

/// How an index is built; none of it shows in the file.
#[derive(Clone, Debug)]
pub struct BuildSettings {
    /// Bytes for everything that grows. Below [`BuildSettings::LEAST_MEMORY`] it counts as that.
    pub memory: u64,
    /// Folder for what does not fit in memory, 48 bytes an entry; the system's temporary folder if
    /// not given.
    pub scratch: Option<PathBuf>,
}

impl BuildSettings {
    /// Buffers, and the tables of a split: what every build takes, with any memory.
    pub const LEAST_MEMORY: u64 = 8 << 20;

    /// Entries that memory holds. A million entries have some 5 000 pages, of 8 bytes in the
    /// writer's directory.
    fn capacity(&self) -> usize {
        let room = self.memory.saturating_sub(Self::LEAST_MEMORY) / (size_of::<Entry>() as u64 + 1);
        usize::try_from(room).unwrap_or(usize::MAX).max(2 * LEAF_ENTRIES as usize)
    }
}

impl Default for BuildSettings {
    fn default() -> Self {
        Self { memory: 256 << 20, scratch: None }
    }
}

/// Collects the blocks of a step. The file depends on the set of entries, not on the order in which
/// they come, nor on memory.
#[derive(Debug)]
pub struct IndexBuilder {
    /// Entries that are not in the spill.
    entries: Vec<Entry>,
    capacity: usize,
    scratch: PathBuf,
    /// Made when memory is full for the first time.
    spill: Option<Spill>,
    len: u64,
}

impl Default for IndexBuilder {
    fn default() -> Self {
        Self::new(&BuildSettings::default())
    }
}

impl IndexBuilder {
    /// No entries.
    pub fn new(settings: &BuildSettings) -> Self {
        Self {
            entries: vec![],
            capacity: settings.capacity(),
            scratch: settings.scratch.clone().unwrap_or_else(std::env::temp_dir),
            spill: None,
            len: 0,
        }
    }

    /// Adds a block. A void block (no finite tetrahedron) has no range and is not added.
    ///
    /// # Errors
    /// When memory is full and the scratch folder cannot be written.
    ///
    /// # Panics
    /// When the range is not a range: `min <= max` and neither NaN.
    pub fn push(&mut self, entry: Entry) -> Result<()> {
        assert!(entry.min <= entry.max, "block {:?} of range {}..{}", entry.place(), entry.min, entry.max);
        if self.entries.len() == self.capacity {
            self.spill_all()?;
        } else if self.entries.len() == self.entries.capacity() {
            // Doubling, but never beyond what memory holds.
            self.entries
                .reserve_exact(self.entries.len().max(1 << 10).min(self.capacity - self.entries.len()));
        }
        self.entries.push(entry);
        self.len += 1;
        Ok(())
    }

    fn spill_all(&mut self) -> Result<()> {
        if self.spill.is_none() {
            self.spill = Some(Spill::new(&self.scratch)?);
        }
        let spill = self.spill.as_mut().expect("it was just made");
        spill.append(&self.entries)?;
        self.entries.clear();
        Ok(())
    }

    /// Number of entries.
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Writes the index and publishes it.
    ///
    /// # Errors
    /// When the file or the scratch folder cannot be written.
    ///
    /// # Panics
    /// When a block was added twice; that is not always noticed when the entries did not fit in
    /// memory.
    pub fn finish(mut self, path: impl AsRef<Path>, plan: PlanHash) -> Result<SegmentInfo> {
        if self.spill.is_some() {
            self.spill_all()?;
        }
        let mut out = SegmentWriter::create_unlooked(path, SegmentKind::Index, plan)?;
        if let Some(spill) = self.spill {
            out.push_block(&root_block(self.len, spill.bounds()))?;
            spill.write(self.entries, self.capacity, &mut out)?;
            return out.finish();
        }
        let mut entries = self.entries;
        entries.sort_unstable_by_key(Entry::place);
        assert!(entries.is_sorted_by(|a, b| a.place() < b.place()), "each block is added once");
        out.push_block(&root_block(self.len, Bounds::of(&entries)))?;
        if !entries.is_empty() {
            write_subtree(&mut entries, SplitAxis::Min, &mut out)?;
        }
        out.finish()
    }
}

/// Block 0: number of entries, lowest min, highest max, shape of the tree.
fn root_block(entries: u64, bounds: Bounds) -> Vec<u8> {
    let mut out = entries.to_le_bytes().to_vec();
    out.extend(bounds.lowest.to_le_bytes());
    out.extend(bounds.highest.to_le_bytes());
    out.extend((LEAF_ENTRIES as u32).to_le_bytes());
    out.extend(PAGE_LEVELS.to_le_bytes());
    out
}
