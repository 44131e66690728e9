//! The values of a chunk whose points have means of nodes: the nodes of its bricks, and of those of
//! the chunks after it that its centres lie between.
//!
//! ```text
//!       ┌───────┬───────┐
//!       │ chunk │ · · · │   · bricks of other chunks with nodes next to its last cells
//!       └───────┼ · · · │
//!         · · · │ · · · │
//!         · · · ┴───────┘
//! ```

use super::damaged::damaged;
use super::recent::RecentBlock;
use super::step_view::StepView;
use super::stored_values::BlockAt;
use crate::archive::values::{NodeCoder, ValueBlocks};
use crate::error::Result;
use crate::grid::ChunkId;
use crate::mesh::bcc::{BccChunk, NODE_BRICK_CELLS, NodeBrick, PointPlace};
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

/// The nodes of a chunk, as far as they are known.
pub(in crate::pipeline) struct NodeValues {
    coder: NodeCoder,
    bricks: Vec<NodeBrick>,
    /// Bricks along each axis.
    dims: [usize; 3],
    /// For each brick its values in parts of a step, x fastest; nothing where they are not known.
    values: Vec<Arc<[i32]>>,
}

impl NodeValues {
    /// No node is known at first.
    pub(in crate::pipeline) fn new(chunk: &BccChunk, coder: NodeCoder) -> Self {
        let bricks: Vec<NodeBrick> = chunk.node_bricks().collect();
        let dims = match (bricks.first(), bricks.last()) {
            (Some(first), Some(last)) => {
                std::array::from_fn(|a| (last.brick[a] - first.brick[a]) as usize + 1)
            }
            _ => [0; 3],
        };
        Self { coder, values: vec![Arc::default(); bricks.len()], dims, bricks }
    }

    /// The bricks, x fastest.
    pub(in crate::pipeline) fn bricks(&self) -> &[NodeBrick] {
        &self.bricks
    }

    /// Sets the values of a brick.
    pub(in crate::pipeline) fn put(&mut self, brick: usize, values: impl Into<Arc<[i32]>>) {
        self.values[brick] = values.into();
    }

    /// The number of the brick that has a node.
    fn brick_of(&self, node: [u32; 3]) -> usize {
        let lo = self.bricks[0].lo;
        let [x, y, z] =
            std::array::from_fn(|a| (((node[a] - lo[a]) / NODE_BRICK_CELLS) as usize).min(self.dims[a] - 1));
        (z * self.dims[1] + y) * self.dims[0] + x
    }

    /// The value of a point whose nodes are known.
    pub(in crate::pipeline) fn value(&self, at: PointPlace) -> f32 {
        let [lo, hi] = at.corners();
        let (mut found, mut len) = ([0; 8], 0);
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    let brick = self.brick_of([x, y, z]);
                    let NodeBrick { lo, nodes, .. } = self.bricks[brick];
                    let place = ((z - lo[2]) * nodes[1] + y - lo[1]) * nodes[0] + x - lo[0];
                    found[len] = self.values[brick][place as usize];
                    len += 1;
                }
            }
        }
        self.coder.mean(found[..len].iter().copied())
    }
}

/// The nodes of chunks that are read from an archive, of the last two steps asked for.
#[derive(Default)]
pub(in crate::pipeline) struct NodeCache(Vec<ReadNodes>);

/// The nodes of a chunk at a step.
struct ReadNodes {
    chunk: ChunkId,
    step: usize,
    bcc: BccChunk,
    values: NodeValues,
    /// The chunk that has each brick, and its number there.
    homes: Vec<(ChunkId, usize)>,
    /// How the values of these chunks are cut into blocks.
    blocks: HashMap<ChunkId, ValueBlocks>,
}

impl NodeCache {
    /// Appends the values of points of a chunk at the step at a position in the manifest, and
    /// returns the bytes read.
    pub(super) fn values(
        &mut self,
        archive: &StepView,
        step: usize,
        chunk: ChunkId,
        points: Range<usize>,
        out: &mut Vec<f32>,
    ) -> Result<u64> {
        let nodes = self.of(archive, step, chunk)?;
        let places = nodes.bcc.point_places(points);
        let mut bytes = 0;
        for &at in &places {
            bytes += nodes.load(archive, at)?;
        }
        out.extend(places.into_iter().map(|at| nodes.values.value(at)));
        Ok(bytes)
    }

    fn of(&mut self, archive: &StepView, step: usize, chunk: ChunkId) -> Result<&mut ReadNodes> {
        let found = self.0.iter().position(|n| (n.step, n.chunk) == (step, chunk));
        let last = match found {
            Some(n) => self.0.remove(n),
            None => {
                self.0.truncate(1);
                ReadNodes::new(archive, step, chunk)?
            }
        };
        self.0.insert(0, last);
        Ok(&mut self.0[0])
    }
}

impl ReadNodes {
    fn new(archive: &StepView, step: usize, chunk: ChunkId) -> Result<Self> {
        let segment = archive.values_of(step, chunk)?;
        let coder = archive.manifest.step_at(step).plan.quantiser.and_then(NodeCoder::new);
        let bcc = archive.bcc_chunk(chunk).filter(BccChunk::has_node_bricks);
        let (Some(bcc), Some(coder)) = (bcc, coder) else {
            return Err(damaged(&segment, chunk, "values of nodes", "a plan without a lattice or rounding"));
        };
        let values = NodeValues::new(&bcc, coder);
        let homes = values.bricks().iter().map(|brick| {
            let at = brick.brick.map(u64::from);
            let home = archive.chunks.chunk(archive.chunks.of_brick(at));
            let [x, y, z] = std::array::from_fn(|a| at[a] - home.brick_lo[a]);
            let [dx, dy] = std::array::from_fn(|a| home.brick_hi[a] - home.brick_lo[a]);
            (home.id, ((z * dy + y) * dx + x) as usize)
        });
        Ok(Self { chunk, step, homes: homes.collect(), blocks: HashMap::new(), values, bcc })
    }

    /// Reads the bricks that a point needs, and returns their bytes.
    fn load(&mut self, archive: &StepView, at: PointPlace) -> Result<u64> {
        let mut read = 0;
        let [lo, hi] = at.corners();
        for corner in 0..8u32 {
            let node = std::array::from_fn(|a| if corner >> a & 1 == 1 { hi[a] } else { lo[a] });
            let brick = self.values.brick_of(node);
            if self.values.values[brick].is_empty() {
                let (step, (chunk, block)) = (self.step, self.homes[brick]);
                let found = archive.recent.nodes.get((step, chunk, block as u64), || {
                    let (segment, mut bytes) = (archive.values_of(step, chunk)?, vec![]);
                    let blocks = self.blocks.entry(chunk).or_insert_with(|| archive.value_blocks(chunk, 0));
                    let at = BlockAt { block, blocks };
                    let number = archive.stored_bytes(step, chunk, at, &mut bytes)?;
                    let nodes = self.values.bricks[brick].nodes;
                    let decoded = self.values.coder.decode(nodes, &bytes);
                    let values = decoded.map_err(|m| segment.blame(chunk, number, m))?;
                    Ok(RecentBlock { bytes: bytes.len() as u64, values: values.into() })
                })?;
                self.values.put(brick, found.values);
                read += found.bytes;
            }
        }
        Ok(read)
    }
}
