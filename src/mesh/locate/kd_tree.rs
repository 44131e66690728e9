//! The thesis's search (section 4.3): a pointerless kd-tree over the bounding boxes of the cells.
//!
//! A cell is a point of six dimensions, xmin, xmax, ymin, ymax, zmin, zmax, and the tree's levels
//! take them by turns. It is an array: the node in the middle of a range is the root of the range,
//! what is before is its left subtree, what is behind its right one (the layout of Livnat, Shen and
//! Johnson 1996). A node's key is not less than those to the left and not more than those to the
//! right.
//!
//! A point p lies in no cell whose minimum is above p, nor in one whose maximum is below it:
//!
//! ```text
//! level of a minimum: right only if key <= p          level of a maximum: left only if key >= p
//! ```
//!
//! The thesis's pseudo-code tests the maximum like the minimum (`extrema[2*index+1] < P`, then
//! right), which loses cells; here it is put right.

use super::{CellBatch, CellHit, FinePos, keep, weights};

/// A kd-tree over the cells of a batch.
#[derive(Clone, Debug)]
pub struct KdTree<'a> {
    cells: &'a CellBatch,
    /// Cells in the order of the tree.
    order: Vec<u32>,
    /// Bounding boxes in that order: xmin, xmax, ymin, ymax, zmin, zmax.
    boxes: Vec<[i64; 6]>,
}

impl<'a> KdTree<'a> {
    /// Builds the tree, by medians: n log n.
    pub fn new(cells: &'a CellBatch) -> Self {
        let box_of = |cell: usize| {
            let corners = cells.corners_of(cell);
            let extreme = |k: usize, pick: fn(i64, i64) -> i64| {
                corners.iter().map(|c| c[k]).reduce(pick).expect("four")
            };
            std::array::from_fn(|i| extreme(i / 2, if i % 2 == 0 { i64::min } else { i64::max }))
        };
        let mut nodes: Vec<([i64; 6], u32)> = (0..cells.ids.len()).map(|c| (box_of(c), c as u32)).collect();
        arrange(&mut nodes, 0);
        let (boxes, order) = nodes.into_iter().unzip();
        Self { cells, order, boxes }
    }

    /// Looks for each point; `found[i]` keeps the answer of the lowest id for point i.
    pub fn locate(&self, points: &[FinePos], found: &mut [CellHit]) {
        assert_eq!(found.len(), points.len(), "an answer for each point");
        for (p, found) in points.iter().zip(found) {
            self.search(0..self.order.len(), 0, *p, found);
        }
    }

    fn search(&self, range: std::ops::Range<usize>, key: usize, p: FinePos, found: &mut CellHit) {
        if range.is_empty() {
            return;
        }
        let middle = range.start + range.len() / 2;
        let node = &self.boxes[middle];
        if (0..3).all(|k| node[2 * k] <= p[k] && p[k] <= node[2 * k + 1]) {
            let cell = self.order[middle] as usize;
            if let Some(weights) = weights(self.cells.corners_of(cell), p) {
                keep(found, self.cells.ids[cell], cell, weights);
            }
        }
        let (is_minimum, at) = (key.is_multiple_of(2), p[key / 2]);
        if is_minimum || node[key] >= at {
            self.search(range.start..middle, (key + 1) % 6, p, found);
        }
        if !is_minimum || node[key] <= at {
            self.search(middle + 1..range.end, (key + 1) % 6, p, found);
        }
    }
}

/// Puts the median by the level's key in the middle, and so on in both halves.
fn arrange(nodes: &mut [([i64; 6], u32)], key: usize) {
    if nodes.len() < 2 {
        return;
    }
    let middle = nodes.len() / 2;
    nodes.select_nth_unstable_by_key(middle, |(b, cell)| (b[key], *cell));
    let (left, rest) = nodes.split_at_mut(middle);
    arrange(left, (key + 1) % 6);
    arrange(&mut rest[1..], (key + 1) % 6);
}
