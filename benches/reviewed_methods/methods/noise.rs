//! NOISE's kd-tree (Livnat, Shen and Johnson, "A near optimal isosurface extraction algorithm using
//! the span space", 1996).
//!
//! Each cell is a point (min, max) of the span space; the active ones lie in the quarter left of
//! the isovalue and not below it. A kd-tree halves the points by minimum and by maximum in turn. It
//! has no pointers: the root of a range of the array is in its middle, the subtrees are the halves
//! before and behind it. A subtree whose minima are known to be below the isovalue, or whose maxima
//! not, is not asked for them again; where both are known, all of it is taken.
//!
//! O(√n + k), 12 bytes a cell.

use super::{Cells, Method};
use isospan::Result;

/// A cell.
#[derive(Clone, Copy)]
struct Node {
    min: f32,
    max: f32,
    id: u32,
}

/// The tree.
pub(crate) struct Noise {
    nodes: Vec<Node>,
}

impl Noise {
    pub(crate) fn new(cells: &Cells<'_>) -> Self {
        let mut nodes: Vec<Node> =
            cells.ranges().zip(0..).map(|((min, max), id)| Node { min, max, id }).collect();
        build(&mut nodes, true);
        Self { nodes }
    }
}

fn build(nodes: &mut [Node], by_min: bool) {
    if nodes.len() < 2 {
        return;
    }
    let middle = nodes.len() / 2;
    let key = |n: &Node| if by_min { n.min } else { n.max };
    nodes.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)));
    build(&mut nodes[..middle], !by_min);
    build(&mut nodes[middle + 1..], !by_min);
}

/// `low`: all minima are known to be below the isovalue; `high`: no maximum is.
fn search(nodes: &[Node], by_min: bool, low: bool, high: bool, isovalue: f32, found: &mut Vec<u32>) {
    if low && high {
        found.extend(nodes.iter().map(|n| n.id));
        return;
    }
    let Some(node) = nodes.get(nodes.len() / 2) else { return };
    let (before, behind) = (&nodes[..nodes.len() / 2], &nodes[nodes.len() / 2 + 1..]);
    let (is_low, is_high) = (node.min < isovalue, node.max >= isovalue);
    if is_low && is_high {
        found.push(node.id);
    }
    if by_min {
        search(before, false, low || is_low, high, isovalue, found);
        // Minima behind are no smaller than the node's.
        if is_low {
            search(behind, false, low, high, isovalue, found);
        }
    } else {
        search(behind, true, low, high || is_high, isovalue, found);
        if is_high {
            search(before, true, low, high, isovalue, found);
        }
    }
}

impl Method for Noise {
    fn bytes(&self) -> u64 {
        size_of_val(&self.nodes[..]) as u64
    }

    fn active(&mut self, _: &Cells<'_>, isovalue: f32, found: &mut Vec<u32>) -> Result<()> {
        search(&self.nodes, true, false, false, isovalue, found);
        Ok(())
    }
}
