//! Joins the edges that several blocks of a chunk have: where all of these blocks are at hand, the
//! sums around their edges are added up once for all isovalues.
//!
//! Such an edge gets a number in the chunk. The first block that has it, in the order in which
//! blocks are extracted, has its normal; the others have only its number. An isovalue that crosses
//! the edge crosses it in all of these blocks, so the first block has made the vertex when the
//! others need it. An edge keeps the sum of each block if both its ends are shared with other
//! chunks, or if one of its blocks is not at hand.

use super::super::cells::{CellSource, along_edge};
use super::super::fours;
use super::super::patch::up;
use super::crossed::sum_of;
use super::make::close_groups;
use super::{FIRST, Group, Normal, OPEN, Precomputed, PrecomputedBlock, SHARED, SLOTS_BEHIND, SUM, Shape};
use crate::simd::Plain;
use crate::surface::world_map::WorldMap;
use rustc_hash::{FxHashMap, FxHashSet};

/// No number yet.
const NONE: u32 = u32::MAX;

/// The edges of the blocks of a chunk that several of them may have.
#[derive(Debug, Default)]
pub(crate) struct Joiner {
    /// Edges by the numbers of their ends in the chunk; looked up, never iterated.
    edges: FxHashMap<[u32; 2], Edge>,
    /// Edges of blocks that are not at hand.
    apart: FxHashSet<[u32; 2]>,
    count: u32,
}

#[derive(Debug)]
struct Edge {
    sum: [i64; 3],
    number: u32,
}

impl Joiner {
    /// Adds the sums of a block.
    pub(crate) fn add(&mut self, block: &PrecomputedBlock) {
        let block = block.view();
        for (n, &slot) in block.slots_of_edges().iter().enumerate().filter(|(_, slot)| **slot & OPEN != 0) {
            let Some(key) = key(block, n) else { continue };
            let part = sum_of(block.slots()[usize::from(slot & !OPEN)..].first_chunk().expect("six words"));
            let edge = self.edges.entry(key).or_insert(Edge { sum: [0; 3], number: NONE });
            edge.sum.iter_mut().zip(part).for_each(|(sum, part)| *sum = sum.wrapping_add(part));
        }
    }

    /// Keeps apart the edges of a block whose part of the sums will not be at hand.
    pub(crate) fn keep_apart(&mut self, cells: &CellSource<'_>) {
        let numbers = cells.numbers.unwrap_or_default();
        for tet in cells.tets {
            for i in 0..4 {
                for j in 0..i {
                    let mut ends = [tet[i], tet[j]].map(|v| numbers[v as usize]);
                    ends.sort_unstable();
                    self.apart.insert(ends);
                }
            }
        }
    }

    /// The block with its edges joined. Blocks are given in order, when all were added.
    pub(crate) fn join(&mut self, block: &PrecomputedBlock, world: &WorldMap) -> PrecomputedBlock {
        let known = block.view();
        let [groups_end, _, corners_end, edges_end, _, slots_at, slots_end] = known.ends();
        let (mut slots, mut of_edges) = (Vec::with_capacity(known.shape.slots), vec![]);
        for (n, &slot) in known.slots_of_edges().iter().enumerate() {
            let (is_open, old) = (slot & OPEN != 0, &known.slots()[usize::from(slot & !OPEN)..]);
            let open = is_open.then(|| self.normal_of(known, n, world)).flatten();
            match open {
                None => slots.extend(is_open.then_some(SUM)),
                Some((number, None)) => slots.push(number),
                Some((number, Some(_))) => slots.push(number | FIRST),
            }
            // There is no more of them than there was before.
            of_edges.push(slots.len() as u16 | slot & OPEN);
            match open {
                Some((_, normal)) => slots.extend(normal.into_iter().flatten()),
                None => slots.extend_from_slice(&old[..if is_open { 6 } else { 3 }]),
            }
        }
        let mut words = block.words[..slots_at].to_vec();
        let groups: &mut [Group] = bytemuck::cast_slice_mut(&mut words[..groups_end]);
        close_groups(groups, &of_edges, slots.len());
        let edges = bytemuck::cast_slice_mut::<u32, u16>(&mut words[corners_end..edges_end]);
        edges[known.shape.edges..].copy_from_slice(&of_edges);
        slots.extend([0; SLOTS_BEHIND]);
        words.extend_from_slice(&slots);
        words.extend_from_slice(&block.words[slots_end..]);
        PrecomputedBlock { words: words.into(), shape: Shape { slots: slots.len(), ..known.shape } }
    }

    /// The number of an edge that is joined, and where it is met first its normal.
    fn normal_of(
        &mut self,
        block: Precomputed<'_>,
        n: usize,
        world: &WorldMap,
    ) -> Option<(u32, Option<Normal>)> {
        let key = key(block, n).filter(|key| self.count < FIRST && !self.apart.contains(key))?;
        let edge = self.edges.get_mut(&key).expect("all blocks were added before");
        if edge.number != NONE {
            return Some((edge.number, None));
        }
        edge.number = self.count;
        self.count += 1;
        let [normal, ..] = fours::normals::<Plain<f64, 4>>((), &[edge.sum, [0; 3], [0; 3], [0; 3]], world);
        let ends = block.edges()[n].map(|corner| &block.at()[usize::from(corner)]);
        let normal = normal.unwrap_or_else(|| along_edge(up(ends), world));
        Some((edge.number, Some(normal.map(f32::to_bits))))
    }

    /// Numbers that were given.
    pub(crate) fn count(&self) -> u32 {
        self.count
    }
}

/// The numbers of an edge's ends in the chunk, the lower one first; `None` if other chunks may have
/// it.
fn key(block: Precomputed<'_>, n: usize) -> Option<[u32; 2]> {
    let mut ends = block.edges()[n].map(|corner| block.numbers()[usize::from(corner)]);
    if ends[0] & ends[1] & SHARED != 0 {
        return None;
    }
    ends = ends.map(|number| number & !SHARED);
    ends.sort_unstable();
    Some(ends)
}
