//! The sides of all quads, part by part, sorted by label: what meshes are made of.

use super::image::{CellBox, LabelImage, LabelSelection};
use super::settings::LabelSettings;
use crate::pipeline::plan::estimate;
use crate::surface::nets::{LabelBlock, LabelBuilder, LabelMeshSize, Side, nodes_around, quads_of};
use crate::surface::weld::StoredSurface;
use isospan_io::bytes::sorter::{Sorted, Sorter};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, in_order};
use isospan_wavelet::TILE;
use std::collections::BTreeMap;
use std::path::Path;

/// Cells along each axis of a part, the most first; what memory allows. Parts do not show in
/// meshes.
const PARTS: [u64; 4] = [128, 64, 32, 16];
/// Bytes for each node of a part: its value, its label, what decodes it; and what smooths it.
const OF_NODE: u64 = 24;
const OF_SMOOTHED_NODE: u64 = 48;
/// Bytes for the sides of a cell, where every second edge has a quad.
const OF_CELL: u64 = 3 * size_of::<Side>() as u64;

/// How memory is shared out.
pub(super) struct Shares {
    /// For sides that wait to be sorted.
    sorter: u64,
    /// For vertices of a label that are not finished.
    pub(super) layers: u64,
    /// For finished vertices and triangles.
    pub(super) finished: u64,
    /// For parts at work.
    batch: u64,
}

impl Shares {
    fn of(memory: u64) -> Self {
        let rest = memory.saturating_sub(estimate::BASE);
        Self { sorter: rest / 4, layers: rest / 8, finished: rest / 8, batch: rest / 2 }
    }
}

/// Sorted sides, from which each label's mesh is made after the other.
pub(super) struct LabelMeshes {
    sorted: Sorted<Side>,
    /// The first side of the next label.
    next: Option<Side>,
    builder: LabelBuilder,
    pub(super) shares: Shares,
}

impl LabelMeshes {
    /// Finds the sides of the wanted labels in some bricks.
    pub(super) fn of(
        image: &LabelImage<'_>,
        wanted: &LabelSelection,
        bricks: impl IntoIterator<Item = [u64; 3]> + Clone,
        settings: &LabelSettings,
        scratch: &Path,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let resources = &settings.resources;
        let shares = Shares::of(resources.memory);
        let (parts, bytes) = parts(image, bricks, settings, shares.batch)?;
        let mut sorter = Sorter::new(usize::try_from(shares.sorter).unwrap_or(usize::MAX), scratch);
        let pool = image.view.pools.lend(resources.threads)?;
        progress.begin("labels", parts.len() as u64, "parts");
        let make = |n: usize| {
            resources.cancel.check()?;
            sides_of(image, wanted, parts[n], settings.smooth)
        };
        in_order(&bytes, shares.batch, &pool, make, |_, sides: Vec<Side>| {
            progress.advance(1);
            sides.into_iter().try_for_each(|side| sorter.push(side))
        })?;
        let mut sorted = sorter.finish()?;
        let world = crate::pipeline::read::world_map(image.view);
        let builder = LabelBuilder::new(&world, shares.layers);
        Ok(Self { next: sorted.next()?, sorted, builder, shares })
    }

    /// The next label that has a surface.
    pub(super) fn next_label(&self) -> Option<i32> {
        self.next.map(|side| side.label)
    }

    /// Adds the mesh of the next label to a surface.
    pub(super) fn add_next(&mut self, out: &mut StoredSurface) -> Result<LabelMeshSize> {
        let label = self.next_label();
        while let Some(side) = self.next.filter(|side| Some(side.label) == label) {
            self.builder.add(&side, out)?;
            self.next = self.sorted.next()?;
        }
        self.builder.end_label(out)
    }
}

/// Boxes of cells with the bricks, and the bytes that each takes.
fn parts(
    image: &LabelImage<'_>,
    bricks: impl IntoIterator<Item = [u64; 3]> + Clone,
    settings: &LabelSettings,
    memory: u64,
) -> Result<(Vec<CellBox>, Vec<u64>)> {
    let mut least = 0;
    for most in PARTS {
        let parts = boxes(image, bricks.clone(), most);
        let bytes: Vec<u64> = parts.iter().map(|part| part_bytes(part, settings.smooth)).collect();
        least = bytes.iter().copied().max().unwrap_or(0);
        // With room for two at a time.
        if least <= memory / 2 || most == PARTS[3] && least <= memory {
            return Ok((parts, bytes));
        }
    }
    Err(Error::memory("for a part of the labels", 2 * least + estimate::BASE, settings.resources.memory))
}

/// The least boxes that hold the bricks of a part, of at most so many cells along each axis; and
/// one more at the first end, where cells go beyond the outer nodes.
fn boxes(image: &LabelImage<'_>, bricks: impl IntoIterator<Item = [u64; 3]>, most: u64) -> Vec<CellBox> {
    let bricks_of_part = (most / TILE as u64).max(1);
    let mut boxes: BTreeMap<[u64; 3], CellBox> = BTreeMap::new();
    for place in bricks {
        let cells = image.cells_of(place);
        let all = boxes.entry(place.map(|n| n / bricks_of_part)).or_insert(cells);
        for (all, cells) in all.iter_mut().zip(cells) {
            *all = [all[0].min(cells[0]), all[1].max(cells[1])];
        }
    }
    let boxes = boxes.into_values();
    if most >= TILE as u64 {
        return boxes.collect();
    }
    let pieces =
        |[lo, hi]: [u64; 2]| (lo..hi).step_by(most as usize).map(move |from| [from, (from + most).min(hi)]);
    let cut = |[x, y, z]: CellBox| {
        pieces(z).flat_map(move |z| pieces(y).flat_map(move |y| pieces(x).map(move |x| [x, y, z])))
    };
    boxes.flat_map(cut).collect()
}

fn part_bytes(part: &CellBox, steps: u32) -> u64 {
    let around = nodes_around(steps);
    let nodes: u64 = part.iter().map(|[lo, hi]| hi - lo + 2 + 2 * around).product();
    let cells: u64 = part.iter().map(|[lo, hi]| hi - lo).product();
    nodes * (OF_NODE + if steps > 0 { OF_SMOOTHED_NODE } else { 0 }) + cells * OF_CELL
}

/// The sides of the wanted labels in a part.
fn sides_of(image: &LabelImage<'_>, wanted: &LabelSelection, part: CellBox, steps: u32) -> Result<Vec<Side>> {
    let around = nodes_around(steps) as i64;
    let start = part.map(|[lo, _]| lo as i64 - 1 - around);
    let size = std::array::from_fn(|a| (part[a][1] as i64 + around + 1 - start[a]) as usize);
    let labels = image.labels(start, size)?;
    let mut sides = vec![];
    let block = LabelBlock { start, size, labels: &labels };
    quads_of(&block, image.grid, part, steps, |label| wanted.has(label), &mut sides);
    Ok(sides)
}
