//! A label image that an archive keeps exactly: which of its bricks may hold a part of the
//! surfaces, and the labels of the nodes in a box.

use super::settings::Labels;
use crate::archive::manifest::CorrectionRecord;
use crate::index::Entry;
use crate::pipeline::read::{StepView, bricks_of, chunk_place, pyramid_of};
use crate::surface::nets::NO_LABEL;
use isospan_io::error::{Error, Result};
use isospan_io::grid::{ChunkId, IndexBox};
use isospan_wavelet::{Pyramid, TILE};
use std::collections::BTreeSet;

/// Cells of a box along each axis, from the first to past the last. Cell c lies between nodes
/// c - 1 and c, so a grid of n nodes has cells 0 to n.
pub(super) type CellBox = [[u64; 2]; 3];

/// A label image.
pub(super) struct LabelImage<'a> {
    pub(super) view: &'a StepView,
    pyramid: Pyramid,
    /// Its nodes.
    pub(super) grid: [u64; 3],
    /// What labels are more than the values of the archive.
    offset: i64,
}

/// Which labels are wanted, as the archive has values.
pub(super) enum LabelSelection {
    /// These, ascending.
    Each(Vec<i32>),
    /// All but one.
    AllBut(i32),
    All,
}

impl LabelSelection {
    pub(super) fn has(&self, label: i32) -> bool {
        label != NO_LABEL
            && match self {
                Self::Each(labels) => labels.binary_search(&label).is_ok(),
                Self::AllBut(other) => label != *other,
                Self::All => true,
            }
    }

    /// Whether a range may hold one.
    fn meets(&self, min: f32, max: f32) -> bool {
        match self {
            Self::Each(labels) => {
                let first = labels.partition_point(|&label| (label as f32) < min);
                labels.get(first).is_some_and(|&label| label as f32 <= max)
            }
            Self::AllBut(other) => min < max || min != *other as f32,
            Self::All => true,
        }
    }

    /// The least value that one may have.
    fn least(&self, range: [f32; 2]) -> f32 {
        match self {
            Self::Each(labels) => labels.first().map_or(range[1], |&label| label as f32),
            _ => range[0],
        }
    }
}

/// Bricks that may hold a part of the surfaces.
pub(super) struct ActiveBricks {
    /// Their places: z, y, x, of bricks of [`TILE`] cells.
    pub(super) places: BTreeSet<[u64; 3]>,
    /// Bricks of the archive.
    pub(super) of: u64,
    /// Bytes of the index that were read.
    pub(super) index_bytes: u64,
}

impl<'a> LabelImage<'a> {
    /// The label image that an archive keeps.
    ///
    /// # Errors
    /// [`Error::Usage`] for an archive that keeps no whole numbers exactly, for a moment between
    /// two steps, and for a grid with coordinates of its own.
    pub(super) fn of(view: &'a StepView) -> Result<Self> {
        let refuse = |why: &str| {
            let path = view.path().display();
            Err(Error::usage(format!("{path}: {why}: reduce the label image with `labels`")))
        };
        view.refuse_coordinates("a surface of labels")?;
        let (step, pyramid) = (view.step(), pyramid_of(view.manifest.plan.points));
        let Some(pyramid) = pyramid else {
            return refuse("the archive has tetrahedra, whose values are no labels");
        };
        let is_exact = step
            .plan
            .wavelet
            .is_some_and(|w| matches!(w.correction, CorrectionRecord::Labels | CorrectionRecord::Lossless));
        let offset = step.plan.source.offset;
        if !is_exact || offset.fract() != 0.0 || step.plan.source.rounding > 0.0 {
            return refuse("the archive does not keep whole numbers exactly, so it has no labels");
        }
        if view.is_between() {
            return Err(Error::usage("labels are those of a step, not of a moment between two"));
        }
        let grid = pyramid.nodes(0).map(|n| n as u64);
        Ok(Self { view, pyramid, grid, offset: offset as i64 })
    }

    /// A label as the file has it.
    pub(super) fn in_file(&self, label: i32) -> i64 {
        self.offset + i64::from(label)
    }

    /// The labels that are wanted. Those that no value of the archive can have are left out.
    pub(super) fn wanted(&self, labels: &Labels) -> LabelSelection {
        let kept = |label: i64| i32::try_from(label - self.offset).ok().filter(|label| *label != NO_LABEL);
        match labels {
            Labels::Each(labels) => {
                let mut labels: Vec<i32> = labels.iter().filter_map(|&label| kept(label)).collect();
                labels.sort_unstable();
                LabelSelection::Each(labels)
            }
            Labels::All => kept(0).map_or(LabelSelection::All, LabelSelection::AllBut),
            Labels::AllWithBackground => LabelSelection::All,
        }
    }

    /// The bricks that may hold a part of the surfaces: those that have several labels, one of them
    /// wanted; and those of one that is wanted at the ends of the image.
    pub(super) fn active_bricks(&self, wanted: &LabelSelection) -> Result<ActiveBricks> {
        let counts = self.brick_counts();
        let all = counts.iter().product();
        let Some(range) = self.view.value_range() else {
            return Ok(ActiveBricks { places: BTreeSet::new(), of: all, index_bytes: 0 });
        };
        // Cells with a missing sample have no range.
        if self.view.may_have_holes() {
            let [nx, ny, nz] = counts;
            let rows = (0..nz).flat_map(|z| (0..ny).map(move |y| [z, y]));
            let places = rows.flat_map(|[z, y]| (0..nx).map(move |x| [z, y, x])).collect();
            return Ok(ActiveBricks { places, of: all, index_bytes: 0 });
        }
        let index = self.view.ranges()?;
        let entries = index.query_inside(wanted.least(range), |_| true)?;
        let mut places = BTreeSet::new();
        for run in entries.chunk_by(|a, b| a.chunk == b.chunk) {
            self.add_bricks(run, wanted, &counts, &mut places)?;
        }
        Ok(ActiveBricks { places, of: all, index_bytes: index.bytes_read() })
    }

    /// Adds the active ones of some bricks of a chunk.
    fn add_bricks(
        &self,
        entries: &[Entry],
        wanted: &LabelSelection,
        counts: &[u64; 3],
        places: &mut BTreeSet<[u64; 3]>,
    ) -> Result<()> {
        let chunk = ChunkId(entries[0].chunk);
        self.view.expect_chunk(chunk)?;
        let bricks = bricks_of(&self.pyramid, chunk_place(&self.pyramid, chunk));
        for entry in entries {
            let Some(brick) = bricks.get(entry.block as usize) else {
                self.view.expect_block(chunk, entry.block, bricks.len())?;
                continue;
            };
            let place = [2, 1, 0].map(|a| (brick.cells[a].start / TILE) as u64);
            let is_at_end = (0..3).any(|k| place[k] == 0 || place[k] + 1 == counts[2 - k]);
            let has_walls = entry.min < entry.max || is_at_end;
            if brick.level == 0 && has_walls && wanted.meets(entry.min, entry.max) {
                places.insert(place);
            }
        }
        Ok(())
    }

    /// Bricks along each axis.
    fn brick_counts(&self) -> [u64; 3] {
        self.grid.map(|n| (n - 1).div_ceil(TILE as u64))
    }

    /// The cells of a brick. Those at the ends have the cells that go beyond the outer nodes.
    pub(super) fn cells_of(&self, place: [u64; 3]) -> CellBox {
        let (counts, tile) = (self.brick_counts(), TILE as u64);
        std::array::from_fn(|a| {
            let at = place[2 - a];
            let lo = if at == 0 { 0 } else { at * tile + 1 };
            let hi = if at + 1 == counts[a] { self.grid[a] + 1 } else { (at + 1) * tile + 1 };
            [lo, hi]
        })
    }

    /// The labels of the nodes in a box, x fastest; outside the image there is none.
    pub(super) fn labels(&self, start: [i64; 3], size: [usize; 3]) -> Result<Vec<i32>> {
        let mut labels = vec![NO_LABEL; size.iter().product()];
        let lo = start.map(|n| n.max(0) as u64);
        let hi = std::array::from_fn(|a| ((start[a] + size[a] as i64).max(0) as u64).min(self.grid[a]));
        let inside = IndexBox { lo, hi };
        if (0..3).any(|a| lo[a] >= hi[a]) {
            return Ok(labels);
        }
        let values = self.view.nodes(0, &inside)?;
        let [dx, dy, _] = inside.dims().map(|n| n as usize);
        for (row, values) in values.chunks_exact(dx).enumerate() {
            let at = [0, (row % dy) as i64, (row / dy) as i64];
            let [x, y, z] = [0, 1, 2].map(|a| (lo[a] as i64 + at[a] - start[a]) as usize);
            let to = &mut labels[(z * size[1] + y) * size[0] + x..][..dx];
            for (label, value) in to.iter_mut().zip(values) {
                *label = if value.is_nan() { NO_LABEL } else { *value as i32 };
            }
        }
        self.view.spare.give_nodes(values);
        Ok(labels)
    }
}
