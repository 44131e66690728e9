//! The values of a chunk's corners at a step, or between two, a block of values when it is first
//! needed.
//!
//! A question about isovalues skips value blocks that lie on one side of all of them, unless a
//! tetrahedron connects them to the other side.

use super::block::Block;
use super::corners::gather;
use super::reader_memory::ValuesMemory;
use super::step_view::StepView;
use super::stored_values::{BlockAt, KnownValues, expect_values};
use super::wanted::Needed;
use crate::archive::chunked::ValueRange;
use crate::archive::values::ValueBlocks;
use isospan_io::error::Result;
use isospan_io::grid::ChunkId;
use isospan_mesh::mesh::tet::{Tet, is_active, range};

/// The values of a chunk's corners, by their numbers.
pub(in crate::pipeline) struct CornerValues<'a> {
    archive: &'a StepView,
    /// Position of a step in the manifest; of the view's moment without.
    step: Option<usize>,
    chunk: ChunkId,
    vertices: usize,
    blocks: ValueBlocks,
    /// Bytes of each block of values that has been read; 0 of the others.
    read: Vec<u32>,
    /// What is known about the values that have not been read, once it was needed.
    ranges: Vec<ValueRange>,
    /// For each block of values, whether it was counted.
    is_counted: Vec<bool>,
    memory: ValuesMemory,
}

impl<'a> CornerValues<'a> {
    /// Those at the moment of a view, of which none has been read yet.
    pub(in crate::pipeline) fn new(
        archive: &'a StepView,
        chunk: ChunkId,
        vertices: usize,
        memory: ValuesMemory,
    ) -> Result<Self> {
        Self::at(archive, None, chunk, vertices, memory)
    }

    /// Those at the step at a position in the manifest.
    pub(in crate::pipeline) fn of_step(
        archive: &'a StepView,
        step: usize,
        chunk: ChunkId,
        vertices: usize,
        memory: ValuesMemory,
    ) -> Result<Self> {
        Self::at(archive, Some(step), chunk, vertices, memory)
    }

    fn at(
        archive: &'a StepView,
        step: Option<usize>,
        chunk: ChunkId,
        vertices: usize,
        mut memory: ValuesMemory,
    ) -> Result<Self> {
        let blocks = ValueBlocks::new(vertices);
        expect_values(&*archive.values_of(step.unwrap_or(archive.position()), chunk)?, chunk, &blocks)?;
        memory.start(vertices);
        Ok(Self {
            archive,
            step,
            chunk,
            vertices,
            read: vec![0; blocks.count()],
            ranges: vec![],
            is_counted: vec![false; blocks.count()],
            blocks,
            memory,
        })
    }

    /// Replaces the values of a block's corners by those of these corners, as far as they are
    /// needed.
    pub(in crate::pipeline) fn take(&mut self, needed: &Needed<'_>, block: &mut Block) -> Result<()> {
        let Block { corners, tets, .. } = block;
        match needed {
            Needed::All => {
                self.load(&corners.numbers)?;
                self.gather(block);
                Ok(())
            }
            Needed::ForActive(isovalues) => {
                self.load_for_active(isovalues, tets, &corners.numbers, &mut corners.values)
            }
        }
    }

    /// Replaces the values of a block's corners, which have been read.
    pub(in crate::pipeline) fn gather(&self, block: &mut Block) {
        gather(&self.memory.values, &block.corners.numbers, &mut block.corners.values);
    }

    /// Reads the values of some corners.
    fn load(&mut self, corners: &[u32]) -> Result<()> {
        Self::load_of_steps(std::slice::from_mut(self), 0, corners)
    }

    /// Reads the values of some corners at the `n`-th of several steps, which ascend. Each block of
    /// values is read once for all of them, differences after what they are to.
    pub(in crate::pipeline) fn load_of_steps(steps: &mut [Self], n: usize, corners: &[u32]) -> Result<()> {
        for &v in corners {
            let block = steps[n].blocks.of(v as usize);
            if steps[n].read[block] == 0 {
                Self::read_block(steps, n, block)?;
            }
        }
        Ok(())
    }

    /// Reads the values of all corners of some tetrahedra.
    pub(super) fn load_of(&mut self, tets: &[Tet]) -> Result<()> {
        tets.iter().try_for_each(|tet| self.load(tet))
    }

    /// The values, of those that have not been read anything.
    pub(in crate::pipeline) fn values(&self) -> &[f32] {
        &self.memory.values
    }

    /// The same, to keep; NaN in blocks that have not been read.
    pub(super) fn into_values(self) -> Vec<f32> {
        let mut values = self.memory.values;
        values.truncate(self.vertices);
        let unread = (0..self.read.len()).filter(|&block| self.read[block] == 0);
        unread.for_each(|block| values[self.blocks.range(block)].fill(f32::NAN));
        values
    }

    /// The memory, for another chunk.
    pub(in crate::pipeline) fn into_memory(self) -> ValuesMemory {
        self.memory
    }

    /// Bytes of the blocks of values that were read and have some of these corners; each block
    /// counts once.
    pub(in crate::pipeline) fn count(&mut self, corners: &[u32]) -> u64 {
        let mut bytes = 0;
        for &v in corners {
            let block = self.blocks.of(v as usize);
            if self.read[block] != 0 && !std::mem::replace(&mut self.is_counted[block], true) {
                bytes += u64::from(self.read[block]);
            }
        }
        bytes
    }

    /// Finds values of corners, exact for all that active tetrahedra have. Blocks of values in
    /// which all are on the same side of each isovalue are read only if a tetrahedron reaches from
    /// there to the other side; else one of the range is taken for each of them, and the
    /// tetrahedron stays inactive.
    fn load_for_active(
        &mut self,
        isovalues: &[f32],
        tets: &[Tet],
        numbers: &[u32],
        values: &mut Vec<f32>,
    ) -> Result<()> {
        let mut is_whole = true;
        for &v in numbers {
            let block = self.blocks.of(v as usize);
            if self.read[block] == 0 {
                let [lo, hi] = self.find_range(block)?;
                if isovalues.iter().any(|&v| is_active(lo, hi, v)) {
                    Self::read_block(std::slice::from_mut(self), 0, block)?;
                } else {
                    is_whole = false;
                }
            }
        }
        if is_whole {
            gather(&self.memory.values, numbers, values);
            return Ok(());
        }
        self.gather_known(numbers, values);
        for tet in tets {
            let Some((lo, hi)) = range(tet.map(|c| values[c as usize])) else { continue };
            if isovalues.iter().any(|&v| is_active(lo, hi, v)) {
                self.load(&tet.map(|c| numbers[c as usize]))?;
            }
        }
        self.gather_known(numbers, values);
        Ok(())
    }

    /// A range that holds the values of a block. Those of all blocks are read together.
    fn find_range(&mut self, block: usize) -> Result<ValueRange> {
        if self.ranges.is_empty() {
            let stored = self.archive.value_ranges(self.chunk, &self.blocks)?;
            self.ranges = match stored {
                Some(stored) => stored.iter().map(|range| [range.min, range.max]).collect(),
                // Between two steps.
                None => vec![[f32::NEG_INFINITY, f32::INFINITY]; self.blocks.count()],
            };
        }
        Ok(self.ranges[block])
    }

    /// The values of corners, of those that have not been read the least that they may have; NaN
    /// where all are void.
    fn gather_known(&self, numbers: &[u32], values: &mut Vec<f32>) {
        values.clear();
        values.extend(numbers.iter().map(|&v| {
            let block = self.blocks.of(v as usize);
            if self.read[block] != 0 {
                return self.memory.values[v as usize];
            }
            let [lo, hi] = self.ranges[block];
            if lo <= hi { lo } else { f32::NAN }
        }));
    }

    /// Reads a block of values of a step. The step before it, of which it may hold differences, is
    /// read first.
    #[cold]
    fn read_block(steps: &mut [Self], n: usize, block: usize) -> Result<()> {
        let Self { archive, step, chunk, .. } = steps[n];
        let blocks = ValueBlocks::new(steps[n].vertices);
        let (at, mut decoded) =
            (BlockAt { block, blocks: &blocks }, std::mem::take(&mut steps[n].memory.decoded));
        decoded.clear();
        let bytes = match step {
            None => archive.values_block(chunk, at, &mut decoded)?,
            Some(step) => {
                let stored = archive.value_block(step, chunk, at)?;
                let chain = std::iter::successors(stored.base, |&base| archive.manifest.base_of(base));
                let earlier = |base: usize| steps[..n].iter().position(|before| before.step == Some(base));
                let before = chain.into_iter().find_map(earlier);
                if let Some(before) = before.filter(|&before| steps[before].read[block] == 0) {
                    Self::read_block(&mut steps[..n], before, block)?;
                }
                let known = before.map(|before| KnownValues {
                    step: steps[before].step.unwrap_or_default(),
                    values: &steps[before].memory.values[blocks.range(block)],
                });
                stored.decode(known, &mut decoded)?
            }
        };
        let this = &mut steps[n];
        this.memory.values[blocks.range(block)].copy_from_slice(&decoded);
        this.memory.decoded = decoded;
        // A block has at least the byte of its codec.
        this.read[block] = u32::try_from(bytes).unwrap_or(u32::MAX);
        Ok(())
    }
}
