//! Reads the tetrahedra of a chunk for a question: block by block, and only the corners that blocks
//! use.
//!
//! ```text
//!  header (once) ─▶ block(n): its corners, their positions (corners) ─▶ its tetrahedra
//!                                                                └─▶ their values (corner_values)
//! ```
//!
//! The tetrahedra of a block are decoded from the positions of its corners. A chunk whose surface
//! is small costs a few bricks.

use super::block::{Block, BlockCorners};
use super::chunk_mesh::MeshedChunk;
use super::corners::{ChunkCorners, CornerLists};
use super::damaged::damaged;
use super::reader_memory::ReaderMemory;
use super::step_view::StepView;
use super::wanted::WantedBlocks;
use crate::archive::Malformed;
use crate::archive::chunked::ChunkSegment;
use crate::archive::mesh::{BlockHead, ChunkHeader, PAGE_HEADS, TetBlock, TetScratch};
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::grid::ChunkId;
use isospan_mesh::mesh::tet::Tet;
use std::ops::Range;
use std::sync::Arc;

/// Bytes that a reader holds for each vertex of its chunk, a little more than counted: they are
/// allocated once.
pub(in crate::pipeline) const READER_PER_VERTEX: u64 = 40;

/// Blocks that are read at once, at most.
const AT_ONCE: u32 = 32;

/// Blocks that follow each other and were read at once.
#[derive(Default)]
struct BlockRun {
    first: u32,
    bytes: Vec<u8>,
    ends: Vec<usize>,
    /// Blocks that will be read, the next one last.
    expected: Vec<u32>,
}

impl BlockRun {
    fn numbers(&self) -> Range<u32> {
        self.first..self.first + self.ends.len() as u32
    }

    fn block(&self, number: u32) -> &[u8] {
        let n = (number - self.first) as usize;
        &self.bytes[if n == 0 { 0 } else { self.ends[n - 1] }..self.ends[n]]
    }

    /// The end of the run that begins with a block: of those that are expected.
    fn next(&mut self, number: u32) -> u32 {
        while self.expected.last().is_some_and(|&next| next < number) {
            self.expected.pop();
        }
        let mut end = number;
        while end - number < AT_ONCE && self.expected.last() == Some(&end) {
            self.expected.pop();
            end += 1;
        }
        end.max(number + 1)
    }
}

/// A chunk that is being read.
pub(in crate::pipeline) struct ChunkReader<'a> {
    mesh: Arc<ChunkSegment>,
    id: ChunkId,
    corners: ChunkCorners<'a>,
    blocks: u32,
    /// The heads of blocks, page after page, of pages that were read.
    heads: Vec<Vec<BlockHead>>,
    run: BlockRun,
    bytes: Vec<u8>,
    here: Vec<LatticePos>,
    scratch: TetScratch,
}

impl<'a> ChunkReader<'a> {
    /// Reads the header of a chunk.
    pub(in crate::pipeline) fn open(
        archive: &'a StepView,
        id: ChunkId,
        memory: ReaderMemory,
    ) -> Result<Self> {
        archive.expect_chunk(id)?;
        let (mesh, chunk) = (archive.segment_of(id)?.mesh, archive.chunks.chunk(id));
        let ReaderMemory { corners, mut bytes, here, scratch } = memory;
        let blocks = mesh.block_count(id);
        if blocks < 2 {
            return Err(damaged(&mesh, id, "block count", &blocks));
        }
        mesh.block(id, 0, &mut bytes)?;
        let header = ChunkHeader::decode(&bytes).map_err(|m| mesh.blame(id, 0, m))?;
        if header.core_counts.len() as u64 != chunk.brick_count() {
            return Err(damaged(&mesh, id, "header", "it has another number of bricks"));
        }
        // The last block is the summary.
        if blocks != header.blocks() as u64 + u64::from(header.tet_blocks) + 1 {
            return Err(damaged(&mesh, id, "block count", &blocks));
        }
        let corners = ChunkCorners::new(archive, Arc::clone(&mesh), &chunk, &header, corners);
        let heads = vec![vec![]; header.head_pages()];
        Ok(Self {
            mesh,
            id,
            corners,
            blocks: header.tet_blocks,
            heads,
            run: BlockRun::default(),
            bytes,
            here,
            scratch,
        })
    }

    /// Says which blocks will be read, ascending: those that follow each other are read at once.
    pub(in crate::pipeline) fn expect(&mut self, numbers: impl Iterator<Item = u32>) {
        self.run.expected = numbers.collect();
        self.run.expected.reverse();
    }

    /// Corners that the chunk owns; the others are halo.
    pub(in crate::pipeline) fn core(&self) -> usize {
        self.corners.core()
    }

    /// Corners of the chunk, of the core and of the halo.
    pub(in crate::pipeline) fn vertices(&self) -> usize {
        self.corners.len()
    }

    /// Reads a block: its tetrahedra, and all of its corners but their values. False if it is not
    /// wanted; `out` then means nothing.
    pub(in crate::pipeline) fn block(
        &mut self,
        number: u32,
        wanted: &WantedBlocks<'_>,
        out: &mut Block,
    ) -> Result<bool> {
        out.tets.clear();
        let (bytes, head) = self.read(number)?;
        let is_wanted = self.decode(number, &bytes, &head, wanted, out);
        out.bytes = bytes.len() as u64;
        self.bytes = bytes;
        if !is_wanted? {
            return Ok(false);
        }
        let BlockCorners { numbers, positions, ids, values, shared, of_chunk } = &mut out.corners;
        self.corners.ids_and_flags(numbers, ids, shared)?;
        values.resize(numbers.len(), f32::NAN);
        std::mem::swap(positions, &mut self.here);
        *of_chunk = self.corners.len();
        Ok(true)
    }

    /// Appends the tetrahedra of a block, corners numbered as in the chunk. Finds positions and ids
    /// of the block's corners.
    pub(super) fn tets(&mut self, number: u32, out: &mut Vec<Tet>) -> Result<()> {
        let (bytes, head) = self.read(number)?;
        let block = self.open_block(number, &bytes, &head)?;
        self.corners.place(block.vertices(), &mut self.here)?;
        let decoded = block.decode(&self.here, &mut self.scratch, out);
        self.bytes = bytes;
        decoded.map_err(|m| self.blame(number, m))
    }

    /// Finds positions, ids and flags of all corners.
    pub(super) fn place_all(&mut self) -> Result<()> {
        self.corners.place_all()
    }

    /// Finds the flags of all corners.
    pub(super) fn load_all_flags(&mut self) -> Result<()> {
        self.corners.load_all_flags()
    }

    /// The bytes of a block, in memory that is to be given back, and its head.
    fn read(&mut self, number: u32) -> Result<(Vec<u8>, BlockHead)> {
        if number >= self.blocks {
            return Err(damaged(&self.mesh, self.id, "index", &format!("block {number} of {}", self.blocks)));
        }
        let head = self.head(number as usize)?;
        if !self.run.numbers().contains(&number) {
            let (end, at) = (self.run.next(number).min(self.blocks), self.block_at(number));
            let BlockRun { first, bytes, ends, .. } = &mut self.run;
            self.mesh.run(self.id, at..at + u64::from(end - number), bytes, ends)?;
            *first = number;
        }
        let mut bytes = std::mem::take(&mut self.bytes);
        bytes.clear();
        bytes.extend_from_slice(self.run.block(number));
        Ok((bytes, head))
    }

    /// The head of a block.
    fn head(&mut self, number: usize) -> Result<BlockHead> {
        let page = number / PAGE_HEADS;
        if self.heads[page].is_empty() {
            let at = (1 + self.corners.pages() + page) as u64;
            self.mesh.block(self.id, at, &mut self.bytes)?;
            let count = PAGE_HEADS.min(self.blocks as usize - page * PAGE_HEADS);
            let heads = BlockHead::decode(&self.bytes, count, self.corners.len() as u32);
            self.heads[page] = heads.map_err(|m| self.mesh.blame(self.id, at, m))?;
        }
        Ok(self.heads[page][number % PAGE_HEADS])
    }

    /// The number of a tetrahedron block among the blocks of the chunk: the header and pages come
    /// first.
    fn block_at(&self, number: u32) -> u64 {
        (1 + self.corners.pages() + self.heads.len()) as u64 + u64::from(number)
    }

    fn open_block<'b>(&self, number: u32, bytes: &'b [u8], head: &BlockHead) -> Result<TetBlock<'b>> {
        TetBlock::open(bytes, head, self.corners.len() as u32).map_err(|m| self.blame(number, m))
    }

    fn blame(&self, number: u32, malformed: Malformed) -> isospan_io::error::Error {
        self.mesh.blame(self.id, self.block_at(number), malformed)
    }

    /// Decodes a block, if it is wanted; the positions of its corners are then in `here`.
    fn decode(
        &mut self,
        number: u32,
        bytes: &[u8],
        head: &BlockHead,
        wanted: &WantedBlocks<'_>,
        out: &mut Block,
    ) -> Result<bool> {
        let block = self.open_block(number, bytes, head)?;
        if !wanted.may_be(|| self.corners.hull(block.vertices()))? {
            return Ok(false);
        }
        out.corners.numbers.clear();
        out.corners.numbers.extend_from_slice(block.vertices());
        self.corners.place(block.vertices(), &mut self.here)?;
        if !wanted.is(&self.here) {
            return Ok(false);
        }
        let decoded = block.decode_places(&self.here, &mut self.scratch, &mut out.tets);
        decoded.map_err(|m| self.blame(number, m))?;
        Ok(true)
    }

    /// The mesh of the chunk, all of whose corners have been placed.
    pub(super) fn into_mesh(self, tets: Vec<Tet>) -> MeshedChunk {
        let (core, core_counts) = (self.core(), self.corners.core_counts());
        let (all_positions, mut ids, shared) = self.corners.into_lists();
        ids.drain(..core);
        let tets = tets.into();
        MeshedChunk { core_counts, halo: ids, all_positions, around: 0, shared, tets, retries: 0 }
    }

    /// What has been found about the corners.
    pub(super) fn into_corners(self) -> CornerLists {
        self.corners.into_lists()
    }

    /// The memory, for another reader.
    pub(in crate::pipeline) fn into_memory(self) -> ReaderMemory {
        let Self { corners, bytes, here, scratch, .. } = self;
        ReaderMemory { corners: corners.into_memory(), bytes, here, scratch }
    }
}
