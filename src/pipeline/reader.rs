//! A chunk of an archive while a question reads it: tetrahedra block by block, and of the corners what is asked for.
//!
//! ```text
//!  header (once) ─▶ tets(block): corners, their positions, tetrahedra ─▶ load_values(tets)
//! ```
//!
//! The tetrahedra of a block are decoded from the positions of its corners. Values come in blocks of [`BLOCK_VALUES`] and positions
//! brick by brick (a brick lists its points again from the formula of the point set), each when a corner of theirs is first needed.
//! So a chunk whose surface is small costs a few bricks.

use super::chunk::MeshedChunk;
use super::open::{OpenArchive, OpenSegment};
use super::plan::check_brick;
use crate::archive::Malformed;
use crate::archive::chunk::{ChunkHeader, TetBlock, TetScratch};
use crate::archive::chunked::ChunkSegment;
use crate::archive::values::BLOCK_VALUES;
use crate::error::{Error, Result};
use crate::geom::{LatticePos, PointId, Site};
use crate::grid::{BrickId, Chunk, ChunkId};
use crate::mesh::tet::Tet;
use std::sync::Arc;

/// A position that no corner has: the lattice ends at 2^24.
const UNPLACED: LatticePos = [u32::MAX; 3];

/// A chunk that is being read. Corner arrays are indexed by chunk-local vertex numbers.
pub(super) struct ChunkReader<'a> {
    archive: &'a OpenArchive,
    segment: Arc<OpenSegment>,
    chunk: Chunk,
    bricks: Vec<BrickId>,
    /// First corner of each brick, and the number of core corners.
    starts: Vec<u32>,
    halo: Vec<PointId>,
    shared: Vec<bool>,
    positions: Vec<LatticePos>,
    ids: Vec<PointId>,
    values: Vec<f32>,
    /// Bytes of each block of values that has been read; 0 of the others.
    value_bytes: Vec<u32>,
    /// Of each block of values, whether a corner of an active tetrahedron is in it.
    active_values: Vec<bool>,
    /// Bytes of the blocks that hold an active tetrahedron.
    active_bytes: u64,
    /// Buffers: the bytes of a block, the points of a brick, the values of a block.
    bytes: Vec<u8>,
    sites: Vec<Site>,
    decoded: Vec<f32>,
    /// Positions of the corners of a block, and what decoding it needs.
    here: Vec<LatticePos>,
    scratch: TetScratch,
}

/// Bytes that a reader holds for each vertex of its chunk, a little more than counted: they are allocated once.
pub(super) const BYTES_PER_VERTEX: u64 = 40;

impl<'a> ChunkReader<'a> {
    /// Reads the header of a chunk.
    pub(super) fn open(archive: &'a OpenArchive, id: ChunkId) -> Result<Self> {
        archive.expect_chunk(id)?;
        let segment = archive.segment_of(id)?;
        let chunk = archive.chunks.chunk(id);
        let blocks = segment.mesh.block_count(id);
        if blocks < 2 {
            return Err(damaged(&segment.mesh, id, "block count", &blocks));
        }
        let mut bytes = vec![];
        segment.mesh.block(id, 0, &mut bytes)?;
        let header = ChunkHeader::decode(&bytes).map_err(|m| segment.mesh.blame(id, 0, m))?.vertices;
        if header.core_counts.len() as u64 != chunk.brick_count() {
            return Err(damaged(&segment.mesh, id, "header", "it has another number of bricks"));
        }
        let vertices = header.len() as usize;
        let value_blocks = vertices.div_ceil(BLOCK_VALUES);
        // The last two blocks are the chunk's part of the spectrum, and the summary.
        if segment.values.block_count(id) != value_blocks as u64 + 2 {
            let got = format!("{} blocks", segment.values.block_count(id));
            return Err(damaged(&segment.values, id, "chunk table", &got));
        }
        let mut starts = vec![0];
        starts.extend(header.core_counts.iter().scan(0, |sum, n| {
            *sum += n;
            Some(*sum)
        }));
        Ok(Self {
            archive,
            segment,
            bricks: chunk.bricks(archive.chunks.bricks()).collect(),
            chunk,
            starts,
            halo: header.halo,
            shared: header.shared,
            positions: vec![UNPLACED; vertices],
            ids: vec![PointId(0); vertices],
            values: vec![f32::NAN; vertices],
            value_bytes: vec![0; value_blocks],
            active_values: vec![false; value_blocks],
            active_bytes: 0,
            bytes,
            sites: vec![],
            decoded: vec![],
            here: vec![],
            scratch: TetScratch::default(),
        })
    }

    /// Corners that the chunk owns; the others are halo.
    pub(super) fn core(&self) -> usize {
        self.starts[self.starts.len() - 1] as usize
    }

    /// Positions; those of corners that were not placed mean nothing.
    pub(super) fn positions(&self) -> &[LatticePos] {
        &self.positions
    }

    /// Ids; those of corners that were not placed mean nothing.
    pub(super) fn ids(&self) -> &[PointId] {
        &self.ids
    }

    /// Values; NaN where there are none, and where they were not loaded.
    pub(super) fn values(&self) -> &[f32] {
        &self.values
    }

    /// Whether another chunk has the corner too.
    pub(super) fn shared(&self) -> &[bool] {
        &self.shared
    }

    /// Appends the tetrahedra of a block; tells its bytes.
    pub(super) fn tets(&mut self, block: u32, out: &mut Vec<Tet>) -> Result<u64> {
        let (mesh, id) = (&self.segment.mesh, self.chunk.id);
        let blocks = mesh.block_count(id);
        // The first block is the header, the last the summary.
        let number = u64::from(block) + 1;
        if number + 1 >= blocks {
            return Err(damaged(mesh, id, "index", &format!("block {block} of {}", blocks - 2)));
        }
        mesh.block(id, number, &mut self.bytes)?;
        let bytes = std::mem::take(&mut self.bytes);
        let decoded = self.decode(&bytes, out);
        self.bytes = bytes;
        decoded?.map_err(|m| self.segment.mesh.blame(id, number, m))?;
        Ok(self.bytes.len() as u64)
    }

    /// Finds where the corners of a block are, and decodes it. The inner error is the block's.
    fn decode(&mut self, bytes: &[u8], out: &mut Vec<Tet>) -> Result<std::result::Result<(), Malformed>> {
        let block = match TetBlock::open(bytes, self.values.len() as u32, &mut self.scratch) {
            Ok(block) => block,
            Err(malformed) => return Ok(Err(malformed)),
        };
        self.here.clear();
        for &v in block.vertices() {
            if self.positions[v as usize] == UNPLACED {
                self.place_corner(v as usize)?;
            }
            self.here.push(self.positions[v as usize]);
        }
        Ok(block.decode(&self.here, &mut self.scratch, out))
    }

    /// Reads the values of all corners of some tetrahedra.
    pub(super) fn load_values(&mut self, tets: &[Tet]) -> Result<()> {
        for &v in tets.iter().flatten() {
            let block = v as usize / BLOCK_VALUES;
            if self.value_bytes[block] == 0 {
                self.read_values(block)?;
            }
        }
        Ok(())
    }

    #[cold]
    fn read_values(&mut self, block: usize) -> Result<()> {
        let end = self.values.len().min((block + 1) * BLOCK_VALUES);
        let place = &mut self.values[block * BLOCK_VALUES..end];
        self.decoded.clear();
        let bytes = self.archive.values_block(self.chunk.id, block as u64, place.len(), &mut self.decoded)?;
        place.copy_from_slice(&self.decoded);
        // A block has at least the byte of its codec.
        self.value_bytes[block] = u32::try_from(bytes).unwrap_or(u32::MAX);
        Ok(())
    }

    /// Notes that a block of so many bytes holds active tetrahedra, these.
    pub(super) fn count_active(&mut self, block_bytes: u64, active: &[Tet]) {
        self.active_bytes += block_bytes;
        active.iter().flatten().for_each(|&v| self.active_values[v as usize / BLOCK_VALUES] = true);
    }

    /// Bytes of the blocks and of the values that hold an active tetrahedron.
    pub(super) fn active_bytes(&self) -> u64 {
        let values = self.value_bytes.iter().zip(&self.active_values);
        self.active_bytes + values.filter(|v| *v.1).map(|v| u64::from(*v.0)).sum::<u64>()
    }

    /// Finds positions and ids of all corners of some tetrahedra.
    pub(super) fn place(&mut self, tets: &[Tet]) -> Result<()> {
        for &v in tets.iter().flatten() {
            if self.positions[v as usize] == UNPLACED {
                self.place_corner(v as usize)?;
            }
        }
        Ok(())
    }

    /// Finds positions and ids of all corners.
    pub(super) fn place_all(&mut self) -> Result<()> {
        (0..self.starts.len() - 1).try_for_each(|brick| self.place_brick(brick))?;
        (self.core()..self.positions.len()).try_for_each(|v| self.place_corner(v))
    }

    /// A halo corner's position is a formula of its id; a core corner's brick is enumerated.
    #[cold]
    fn place_corner(&mut self, v: usize) -> Result<()> {
        let core = self.core();
        if v < core {
            let brick = self.starts.partition_point(|&s| s as usize <= v) - 1;
            return self.place_brick(brick);
        }
        let id = self.halo[v - core];
        let position = self.archive.points.position(id);
        let wrong = || damaged(&self.segment.mesh, self.chunk.id, "halo", &format!("no point {:#x}", id.0));
        (self.positions[v], self.ids[v]) = (position.ok_or_else(wrong)?, id);
        Ok(())
    }

    fn place_brick(&mut self, n: usize) -> Result<()> {
        let (first, end) = (self.starts[n] as usize, self.starts[n + 1] as usize);
        let brick = self.archive.chunks.bricks().brick(self.bricks[n]);
        let wrong = |what: &str| damaged(&self.segment.mesh, self.chunk.id, "header", what);
        check_brick(&self.archive.points, &brick).map_err(|e| wrong(&e.to_string()))?;
        self.archive.points.sites_in(&brick, &mut self.sites);
        if self.sites.len() != end - first {
            let (got, said) = (self.sites.len(), end - first);
            return Err(wrong(&format!(
                "brick {} has {got} points, not the {said} recorded",
                self.bricks[n].0
            )));
        }
        for (i, site) in (first..).zip(&self.sites) {
            (self.positions[i], self.ids[i]) = (site.pos, site.id);
        }
        Ok(())
    }

    /// The mesh of the chunk, of which all corners have been placed.
    pub(super) fn into_mesh(self, tets: Vec<Tet>) -> MeshedChunk {
        MeshedChunk {
            core_counts: self.starts.windows(2).map(|w| w[1] - w[0]).collect(),
            halo: self.halo,
            positions: self.positions,
            shared: self.shared,
            tets,
            retries: 0,
        }
    }

    /// What has been read of the corners: positions, ids, values, whether shared.
    pub(super) fn into_corners(self) -> (Vec<LatticePos>, Vec<PointId>, Vec<f32>, Vec<bool>) {
        (self.positions, self.ids, self.values, self.shared)
    }
}

/// A block that verifies but does not mean anything: written by a faulty program.
pub(super) fn damaged(
    segment: &ChunkSegment,
    chunk: ChunkId,
    at: &str,
    what: &(impl std::fmt::Display + ?Sized),
) -> Error {
    Error::bad_input(
        segment.segment().path(),
        format!("chunk {}, {at}", chunk.0),
        "a chunk as FORMAT.md says",
        what.to_string(),
    )
    .with_help("reduce the source again")
}
