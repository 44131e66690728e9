//! Reads a chunk of an archive for a question: block by block, and only the corners that blocks
//! use.
//!
//! ```text
//!  header (once) ─▶ block(n): its corners, their positions ─▶ its tetrahedra ─▶ the corners' values
//! ```
//!
//! The tetrahedra of a block are decoded from the positions of its corners. Values come in blocks
//! ([`ValueBlocks`]), ids of halo points and flags in pages, and positions brick by brick (a brick
//! lists its points again by formula). Each is read when a corner first needs it. A question about
//! isovalues skips value blocks that lie on one side of all of them, unless a tetrahedron connects
//! them to the other side. So a chunk whose surface is small costs a few bricks. Tetrahedra
//! that follow from the points are made again ([`StarBlocks`]).

use super::block::{Block, BlockCorners};
use super::chunk_mesh::{MeshedChunk, used_corners};
use super::damaged::damaged;
use super::reader_memory::{ReaderMemory, UNPLACED};
use super::region::Cut;
use super::star_blocks::{ChunkBricks, StarBlocks};
use super::step_view::{OpenSegment, StepView};
use super::stored_values::{BlockAt, expect_values};
use crate::archive::Malformed;
use crate::archive::chunked::ValueRange;
use crate::archive::mesh::{ChunkHeader, PAGE_FLAGS, PAGE_IDS, StarRuns, TetBlock, decode_flags, decode_ids};
use crate::archive::values::ValueBlocks;
use crate::error::Result;
use crate::geom::{LatticeBox, LatticePos, PointId};
use crate::grid::{BrickId, Chunk, ChunkId};
use crate::mesh::tet::{Tet, is_active, range};
use crate::pipeline::plan::is_made_again;

/// A chunk that is being read. Corner arrays are indexed by chunk-local vertex numbers.
pub(in crate::pipeline) struct ChunkReader<'a> {
    archive: &'a StepView,
    segment: OpenSegment,
    chunk: Chunk,
    /// The blocks, where their tetrahedra are made again from the points.
    from_points: Option<StarBlocks>,
    bricks: Vec<BrickId>,
    /// First corner of each brick, and the number of core corners.
    starts: Vec<u32>,
    /// Whether another chunk has a corner, of core corners once their page has been read.
    shared: Vec<bool>,
    pages: Pages,
    /// Bytes of each block of values that has been read; 0 of the others.
    value_bytes: Vec<u32>,
    value_blocks: ValueBlocks,
    /// What is known about the values that have not been read, once it was needed.
    value_ranges: Vec<ValueRange>,
    /// For each block of values, whether a corner of an active tetrahedron is in it.
    active_values: Vec<bool>,
    /// Bytes of the blocks that hold an active tetrahedron.
    active_bytes: u64,
    memory: ReaderMemory,
}

/// The pages of a chunk's corners.
struct Pages {
    /// Pages of flags; those of ids follow.
    of_flags: usize,
    /// For each page, whether it has been read.
    read: Vec<bool>,
}

/// Bytes that a reader holds for each vertex of its chunk, a little more than counted: they are
/// allocated once. Where tetrahedra are made again, it holds the points around too, by cells, and
/// the faces that wait.
pub(in crate::pipeline) fn bytes_per_vertex(archive: &StepView) -> u64 {
    if is_made_again(&archive.points) { 160 } else { 44 }
}

impl<'a> ChunkReader<'a> {
    /// Reads the header of a chunk.
    pub(in crate::pipeline) fn open(
        archive: &'a StepView,
        id: ChunkId,
        mut memory: ReaderMemory,
    ) -> Result<Self> {
        archive.expect_chunk(id)?;
        let segment = archive.segment_of(id)?;
        let chunk = archive.chunks.chunk(id);
        let blocks = segment.mesh.block_count(id);
        if blocks < 2 {
            return Err(damaged(&segment.mesh, id, "block count", &blocks));
        }
        segment.mesh.block(id, 0, &mut memory.bytes)?;
        let header = ChunkHeader::decode(&memory.bytes).map_err(|m| segment.mesh.blame(id, 0, m))?;
        if header.core_counts.len() as u64 != chunk.brick_count() {
            return Err(damaged(&segment.mesh, id, "header", "it has another number of bricks"));
        }
        let (vertices, pages) = (header.len(), header.flag_pages() + header.id_pages());
        let least = header.blocks() as u64 + 1;
        if blocks < least || header.from_points && blocks != least {
            return Err(damaged(&segment.mesh, id, "block count", &blocks));
        }
        let from_points = match header.from_points {
            true if !is_made_again(&archive.points) => {
                return Err(damaged(&segment.mesh, id, "header", "it has no tetrahedra"));
            }
            true => {
                let at = header.blocks() as u64 - 1;
                segment.mesh.block(id, at, &mut memory.bytes)?;
                let runs = StarRuns::decode(&memory.bytes, header.core_len() as u32);
                Some(StarBlocks::new(runs.map_err(|m| segment.mesh.blame(id, at, m))?))
            }
            false => None,
        };
        let value_blocks = ValueBlocks::new(vertices);
        expect_values(&segment.values, id, &value_blocks)?;
        let mut starts = vec![0];
        starts.extend(header.core_counts.iter().scan(0, |sum, n| {
            *sum += n;
            Some(*sum)
        }));
        memory.start(vertices);
        let mut shared = vec![false; header.core_len()];
        shared.resize(vertices, true);
        Ok(Self {
            archive,
            segment,
            from_points,
            bricks: chunk.bricks(archive.chunks.bricks()).collect(),
            chunk,
            starts,
            shared,
            pages: Pages { of_flags: header.flag_pages(), read: vec![false; pages] },
            value_bytes: vec![0; value_blocks.count()],
            value_ranges: vec![],
            active_values: vec![false; value_blocks.count()],
            value_blocks,
            active_bytes: 0,
            memory,
        })
    }

    /// Says which blocks will be read, and what is wanted of them: to make tetrahedra again takes
    /// less time then.
    pub(in crate::pipeline) fn expect<'w>(
        &mut self,
        blocks: impl Iterator<Item = (u32, Wanted<'w>)>,
    ) -> Result<()> {
        let Some(mut made) = self.from_points.take() else { return Ok(()) };
        let (of, mut expected) = (self.bricks(), vec![]);
        for (number, wanted) in blocks {
            if (number as usize) < made.len() && wanted.may_be(|| Ok(made.hull(&of, number)))? {
                expected.push(number);
            }
        }
        made.expect(expected);
        self.from_points = Some(made);
        Ok(())
    }

    /// The bricks of a chunk with core points.
    fn bricks(&self) -> ChunkBricks<'_> {
        ChunkBricks {
            archive: self.archive,
            mesh: &self.segment.mesh,
            chunk: &self.chunk,
            bricks: &self.bricks,
            starts: &self.starts,
        }
    }

    /// The same, and the memory in which they are read.
    fn bricks_and_memory(&mut self) -> (ChunkBricks<'_>, &mut ReaderMemory) {
        let Self { archive, segment, chunk, bricks, starts, memory, .. } = self;
        (ChunkBricks { archive, mesh: &segment.mesh, chunk, bricks, starts }, memory)
    }

    /// As [`ChunkReader::expect`], of whole blocks.
    pub(in crate::pipeline) fn expect_all(&mut self, blocks: impl Iterator<Item = u32>) -> Result<()> {
        self.expect(blocks.map(|number| (number, Wanted::All)))
    }

    /// Makes the tetrahedra of a block again, unless its box says that it is not wanted; they are
    /// then in `memory.tets`, with positions and ids of their corners in place.
    fn make_again(&mut self, number: u32, wanted: &Wanted<'_>) -> Result<bool> {
        let mut made = self.from_points.take().expect("asked of such chunks alone");
        let is_wanted = self.make_with(&mut made, number, wanted);
        self.from_points = Some(made);
        is_wanted
    }

    fn make_with(&mut self, made: &mut StarBlocks, number: u32, wanted: &Wanted<'_>) -> Result<bool> {
        if number as usize >= made.len() {
            let got = format!("block {number} of {}", made.len());
            return Err(damaged(&self.segment.mesh, self.chunk.id, "index", &got));
        }
        if !wanted.may_be(|| Ok(made.hull(&self.bricks(), number)))? {
            return Ok(false);
        }
        let (bricks, memory) = self.bricks_and_memory();
        if made.make(&bricks, number, memory)? && self.memory.halo.is_empty() {
            self.load_halo()?;
        }
        let (bricks, memory) = self.bricks_and_memory();
        made.take(&bricks, memory).map(|()| true)
    }

    /// Reads the ids of all halo points, for their numbers.
    fn load_halo(&mut self) -> Result<()> {
        (self.pages.of_flags..self.pages.read.len()).try_for_each(|page| self.load_page(page))?;
        let core = self.core();
        let ReaderMemory { ids, halo, .. } = &mut self.memory;
        halo.extend((core as u32..).zip(&ids[core..self.shared.len()]).map(|(v, &id)| (id, v)));
        Ok(())
    }

    /// As [`ChunkReader::shape`], of a chunk whose tetrahedra are made again.
    fn shape_again(&mut self, number: u32, wanted: &Wanted<'_>, out: &mut Block) -> Result<bool> {
        out.tets.clear();
        out.bytes = 0;
        if !self.make_again(number, wanted)? {
            return Ok(false);
        }
        let vertices = self.shared.len();
        let ReaderMemory { positions, tets, places, .. } = &mut self.memory;
        places.resize(vertices, u32::MAX);
        let corners = &mut out.corners;
        corners.numbers.clear();
        for tet in &*tets {
            out.tets.push(tet.map(|v| {
                let place = &mut places[v as usize];
                if *place == u32::MAX {
                    *place = corners.numbers.len() as u32;
                    corners.numbers.push(v);
                }
                *place
            }));
        }
        corners.numbers.iter().for_each(|&v| places[v as usize] = u32::MAX);
        gather(positions, &corners.numbers, &mut corners.positions);
        if !wanted.is(&corners.positions) {
            out.tets.clear();
            return Ok(false);
        }
        self.load_flags(&corners.numbers)?;
        gather(&self.memory.ids, &corners.numbers, &mut corners.ids);
        gather(&self.shared, &corners.numbers, &mut corners.shared);
        corners.values.resize(corners.numbers.len(), f32::NAN);
        corners.of_chunk = vertices;
        Ok(true)
    }

    /// Corners that the chunk owns; the others are halo.
    pub(in crate::pipeline) fn core(&self) -> usize {
        self.starts[self.starts.len() - 1] as usize
    }

    /// How the values of its corners are cut into blocks.
    pub(in crate::pipeline) fn value_blocks(&self) -> &ValueBlocks {
        &self.value_blocks
    }

    /// Corners of the chunk, of the core and of the halo.
    pub(in crate::pipeline) fn vertices(&self) -> usize {
        self.shared.len()
    }

    /// Reads a block: its tetrahedra, and all of its corners, their values as far as they are
    /// `needed`. False, with nothing in `out`, if it is not wanted.
    pub(in crate::pipeline) fn block(
        &mut self,
        number: u32,
        wanted: &Wanted<'_>,
        needed: &Needed<'_>,
        out: &mut Block,
    ) -> Result<bool> {
        if !self.shape(number, wanted, out)? {
            return Ok(false);
        }
        let BlockCorners { numbers, values, .. } = &mut out.corners;
        match needed {
            Needed::All => {
                numbers.iter().try_for_each(|&v| self.load_value_of(v))?;
                gather(&self.memory.values, numbers, values);
            }
            Needed::ForActive(isovalues) => self.load_for_active(isovalues, &out.tets, numbers, values)?,
        }
        Ok(true)
    }

    /// As [`ChunkReader::block`], but the values of the corners mean nothing.
    pub(in crate::pipeline) fn shape(
        &mut self,
        number: u32,
        wanted: &Wanted<'_>,
        out: &mut Block,
    ) -> Result<bool> {
        if self.from_points.is_some() {
            return self.shape_again(number, wanted, out);
        }
        out.tets.clear();
        out.bytes = self.read(number)?;
        let mut is_wanted = false;
        self.decoded(number, |reader, bytes| reader.decode_alone(bytes, wanted, &mut is_wanted, out))?;
        if !is_wanted {
            return Ok(false);
        }
        self.load_flags(&out.corners.numbers)?;
        let BlockCorners { numbers, positions, ids, values, shared, of_chunk } = &mut out.corners;
        gather(&self.memory.ids, numbers, ids);
        gather(&self.shared, numbers, shared);
        values.resize(numbers.len(), f32::NAN);
        std::mem::swap(positions, &mut self.memory.here);
        *of_chunk = self.shared.len();
        Ok(true)
    }

    /// Appends the tetrahedra of a block, corners numbered as in the chunk. Finds positions and ids
    /// of the block's corners.
    pub(super) fn tets(&mut self, number: u32, out: &mut Vec<Tet>) -> Result<()> {
        if self.from_points.is_some() {
            self.make_again(number, &Wanted::All)?;
            out.extend_from_slice(&self.memory.tets);
            return Ok(());
        }
        self.read(number)?;
        self.decoded(number, |reader, bytes| reader.decode(bytes, out))
    }

    /// Reads the bytes of a block, and returns their number.
    fn read(&mut self, number: u32) -> Result<u64> {
        let (mesh, id) = (&self.segment.mesh, self.chunk.id);
        let blocks = mesh.block_count(id);
        // The last block is the summary.
        let at = self.block_at(number);
        if at + 1 >= blocks {
            return Err(damaged(
                mesh,
                id,
                "index",
                &format!("block {number} of {}", blocks - 1 - self.block_at(0)),
            ));
        }
        mesh.block(id, at, &mut self.memory.bytes)?;
        Ok(self.memory.bytes.len() as u64)
    }

    /// The number of a tetrahedron block among the blocks of the chunk: the header and its pages
    /// come first.
    fn block_at(&self, number: u32) -> u64 {
        (1 + self.pages.read.len()) as u64 + u64::from(number)
    }

    /// Decodes the bytes that were read. The inner error of `decode` is the block's.
    fn decoded(
        &mut self,
        number: u32,
        decode: impl FnOnce(&mut Self, &[u8]) -> Result<std::result::Result<(), Malformed>>,
    ) -> Result<()> {
        let bytes = std::mem::take(&mut self.memory.bytes);
        let decoded = decode(self, &bytes);
        self.memory.bytes = bytes;
        decoded?.map_err(|m| self.segment.mesh.blame(self.chunk.id, self.block_at(number), m))
    }

    fn decode_alone(
        &mut self,
        bytes: &[u8],
        wanted: &Wanted<'_>,
        is_wanted: &mut bool,
        out: &mut Block,
    ) -> Result<std::result::Result<(), Malformed>> {
        let block = match TetBlock::open(bytes, self.shared.len() as u32) {
            Ok(block) => block,
            Err(malformed) => return Ok(Err(malformed)),
        };
        if !wanted.may_be(|| self.hull_of(block.vertices()))? {
            return Ok(Ok(()));
        }
        out.corners.numbers.clear();
        out.corners.numbers.extend_from_slice(block.vertices());
        self.place(block.vertices())?;
        *is_wanted = wanted.is(&self.memory.here);
        if !*is_wanted {
            return Ok(Ok(()));
        }
        let ReaderMemory { here, scratch, .. } = &mut self.memory;
        Ok(block.decode_places(here, scratch, &mut out.tets))
    }

    fn decode(&mut self, bytes: &[u8], out: &mut Vec<Tet>) -> Result<std::result::Result<(), Malformed>> {
        let block = match TetBlock::open(bytes, self.shared.len() as u32) {
            Ok(block) => block,
            Err(malformed) => return Ok(Err(malformed)),
        };
        self.place(block.vertices())?;
        let ReaderMemory { here, scratch, .. } = &mut self.memory;
        Ok(block.decode(here, scratch, out))
    }

    /// Reads the values of all corners of some tetrahedra.
    pub(super) fn load_values(&mut self, tets: &[Tet]) -> Result<()> {
        let used = used_corners(tets, self.memory.values.len());
        for block in 0..self.value_bytes.len() {
            if self.value_bytes[block] == 0 && used[self.value_blocks.range(block)].contains(&true) {
                self.read_values(block)?;
            }
        }
        Ok(())
    }

    #[inline]
    fn load_value_of(&mut self, v: u32) -> Result<()> {
        let block = self.value_blocks.of(v as usize);
        if self.value_bytes[block] == 0 { self.read_values(block) } else { Ok(()) }
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
            let block = self.value_blocks.of(v as usize);
            if self.value_bytes[block] == 0 {
                let [lo, hi] = self.find_range(block)?;
                if isovalues.iter().any(|&v| is_active(lo, hi, v)) {
                    self.read_values(block)?;
                } else {
                    is_whole = false;
                }
            }
        }
        self.gather_known(numbers, values);
        if is_whole {
            return Ok(());
        }
        for tet in tets {
            let Some((lo, hi)) = range(tet.map(|c| values[c as usize])) else { continue };
            if isovalues.iter().any(|&v| is_active(lo, hi, v)) {
                tet.iter().try_for_each(|&c| self.load_value_of(numbers[c as usize]))?;
            }
        }
        self.gather_known(numbers, values);
        Ok(())
    }

    /// A range that holds the values of a block. Those of all blocks are read together.
    fn find_range(&mut self, block: usize) -> Result<ValueRange> {
        if self.value_ranges.is_empty() {
            let stored = self.archive.value_ranges(self.chunk.id, &self.value_blocks)?;
            self.value_ranges = match stored {
                Some(stored) => stored.iter().map(|range| [range.min, range.max]).collect(),
                // Between two steps.
                None => vec![[f32::NEG_INFINITY, f32::INFINITY]; self.value_blocks.count()],
            };
        }
        Ok(self.value_ranges[block])
    }

    /// The values of corners, of those that have not been read the least that they may have; NaN
    /// where all are void.
    fn gather_known(&self, numbers: &[u32], values: &mut Vec<f32>) {
        values.clear();
        values.extend(numbers.iter().map(|&v| {
            let block = self.value_blocks.of(v as usize);
            if self.value_bytes[block] != 0 {
                return self.memory.values[v as usize];
            }
            let [lo, hi] = self.value_ranges[block];
            if lo <= hi { lo } else { f32::NAN }
        }));
    }

    #[cold]
    fn read_values(&mut self, block: usize) -> Result<()> {
        let ReaderMemory { values, decoded, .. } = &mut self.memory;
        let place = &mut values[self.value_blocks.range(block)];
        decoded.clear();
        let at = BlockAt { block, blocks: &self.value_blocks };
        let bytes = self.archive.values_block(self.chunk.id, at, decoded)?;
        place.copy_from_slice(decoded);
        // A block has at least the byte of its codec.
        self.value_bytes[block] = u32::try_from(bytes).unwrap_or(u32::MAX);
        Ok(())
    }

    /// Notes that a block of `block_bytes` bytes holds active tetrahedra, with these corners.
    pub(in crate::pipeline) fn count_active(&mut self, block_bytes: u64, corners: impl Iterator<Item = u32>) {
        self.active_bytes += block_bytes;
        corners.for_each(|v| self.active_values[self.value_blocks.of(v as usize)] = true);
    }

    /// Bytes of the blocks and of the values that hold an active tetrahedron.
    pub(in crate::pipeline) fn active_bytes(&self) -> u64 {
        let values = self.value_bytes.iter().zip(&self.active_values);
        self.active_bytes + values.filter(|v| *v.1).map(|v| u64::from(*v.0)).sum::<u64>()
    }

    /// A box that holds some corners, without placing them: those of core corners are in their
    /// bricks.
    fn hull_of(&mut self, corners: &[u32]) -> Result<LatticeBox> {
        let (core, bricks) = (self.core(), self.archive.chunks.bricks());
        let mut hull = LatticeBox::NOTHING;
        let mut brick_end = 0;
        for &v in corners {
            let here = if v as usize >= core {
                let position = self.halo_position(v as usize)?;
                LatticeBox { lo: position, hi: position.map(|x| x + 1) }
            } else if v < brick_end {
                continue;
            } else {
                let brick = self.starts.partition_point(|&s| s <= v) - 1;
                brick_end = self.starts[brick + 1];
                bricks.brick(self.bricks[brick])
            };
            hull = hull.hull(&here);
        }
        Ok(hull)
    }

    fn halo_position(&mut self, v: usize) -> Result<LatticePos> {
        self.load_page(self.pages.of_flags + v / PAGE_IDS - self.core() / PAGE_IDS)?;
        let id = self.memory.ids[v];
        let wrong = || damaged(&self.segment.mesh, self.chunk.id, "halo", &format!("no point {:#x}", id.0));
        self.archive.points.position(id).ok_or_else(wrong)
    }

    /// Reads the flags of core corners.
    fn load_flags(&mut self, corners: &[u32]) -> Result<()> {
        let mut last = usize::MAX;
        for &v in corners {
            let page = v as usize / PAGE_FLAGS;
            if page == last {
                continue;
            }
            if v as usize >= self.core() {
                continue;
            }
            last = page;
            self.load_page(page)?;
        }
        Ok(())
    }

    #[inline]
    fn load_page(&mut self, page: usize) -> Result<()> {
        if self.pages.read[page] { Ok(()) } else { self.read_page(page) }
    }

    #[cold]
    fn read_page(&mut self, page: usize) -> Result<()> {
        let (core, vertices) = (self.core(), self.vertices());
        let (mesh, id, at) = (&self.segment.mesh, self.chunk.id, 1 + page as u64);
        let mut bytes = vec![];
        mesh.block(id, at, &mut bytes)?;
        let decoded = match page.checked_sub(self.pages.of_flags) {
            None => {
                let first = page * PAGE_FLAGS;
                decode_flags(&bytes, &mut self.shared[first..core.min(first + PAGE_FLAGS)])
            }
            Some(n) => {
                let first = (core / PAGE_IDS + n) * PAGE_IDS;
                decode_ids(&bytes, &mut self.memory.ids[first.max(core)..vertices.min(first + PAGE_IDS)])
            }
        };
        decoded.map_err(|m| mesh.blame(id, at, m))?;
        self.pages.read[page] = true;
        Ok(())
    }

    /// Finds the positions of corners, which are then in `here`, and their ids.
    fn place(&mut self, corners: &[u32]) -> Result<()> {
        gather(&self.memory.positions, corners, &mut self.memory.here);
        while let Some(i) = self.memory.here.iter().position(|&p| p == UNPLACED) {
            for &v in &corners[i..] {
                if self.memory.positions[v as usize] == UNPLACED {
                    self.place_corner(v as usize)?;
                }
            }
            gather(&self.memory.positions, corners, &mut self.memory.here);
        }
        Ok(())
    }

    /// Finds positions and ids of all corners.
    pub(super) fn place_all(&mut self) -> Result<()> {
        (0..self.starts.len() - 1).try_for_each(|brick| self.place_brick(brick))?;
        (self.core()..self.shared.len()).try_for_each(|v| self.place_corner(v))?;
        self.load_all_flags()
    }

    /// A halo corner's position is a formula of its id; a core corner's brick is enumerated.
    #[cold]
    fn place_corner(&mut self, v: usize) -> Result<()> {
        let core = self.core();
        if v < core {
            let brick = self.starts.partition_point(|&s| s as usize <= v) - 1;
            return self.place_brick(brick);
        }
        self.memory.positions[v] = self.halo_position(v)?;
        Ok(())
    }

    fn place_brick(&mut self, n: usize) -> Result<()> {
        let (bricks, ReaderMemory { positions, ids, sites, .. }) = self.bricks_and_memory();
        bricks.place(n, positions, ids, sites)
    }

    /// Reads the flags of all corners.
    pub(super) fn load_all_flags(&mut self) -> Result<()> {
        (0..self.pages.of_flags).try_for_each(|page| self.load_page(page))
    }

    /// The mesh of the chunk, all of whose corners have been placed.
    pub(super) fn into_mesh(self, tets: Vec<Tet>) -> MeshedChunk {
        let core = self.core();
        MeshedChunk {
            core_counts: self.starts.windows(2).map(|w| w[1] - w[0]).collect(),
            halo: self.memory.ids[core..self.shared.len()].to_vec(),
            all_positions: self.memory.positions,
            around: 0,
            shared: self.shared,
            tets: tets.into(),
            retries: 0,
        }
    }

    /// The data that have been read for the corners: positions, ids (any of those not placed),
    /// values (NaN where not loaded), whether shared.
    pub(super) fn into_corners(self) -> (Vec<LatticePos>, Vec<PointId>, Vec<f32>, Vec<bool>) {
        let ReaderMemory { positions, ids, values, .. } = self.memory;
        (positions, ids, values, self.shared)
    }

    /// The memory, for another reader.
    pub(in crate::pipeline) fn into_memory(self) -> ReaderMemory {
        self.memory
    }
}

/// Which values of a block's corners are needed.
pub(in crate::pipeline) enum Needed<'a> {
    All,
    /// The values at corners of tetrahedra that some isovalue crosses.
    ForActive(&'a [f32]),
}

/// Which blocks are wanted, by where their corners are.
pub(in crate::pipeline) enum Wanted<'a> {
    All,
    /// Those that may touch a cut.
    Touching(&'a Cut),
    /// Those that may have a triangle on the boundary of the domain, which ends here.
    AtEnds(LatticePos),
}

impl Wanted<'_> {
    /// Whether a block may be wanted, judged by a box that holds its corners.
    fn may_be(&self, hull: impl FnOnce() -> Result<LatticeBox>) -> Result<bool> {
        Ok(match self {
            Self::All => true,
            Self::Touching(cut) => cut.may_touch_box(&hull()?),
            Self::AtEnds(top) => {
                let hull = hull()?;
                (0..3).any(|a| hull.lo[a] == 0 || hull.hi[a] > top[a])
            }
        })
    }

    /// Whether a block with these corners is wanted.
    fn is(&self, corners: &[LatticePos]) -> bool {
        match self {
            Self::All => true,
            Self::Touching(cut) => cut.may_touch(corners),
            Self::AtEnds(top) => {
                let at_end = |p: &&LatticePos| (0..3).any(|a| p[a] == 0 || p[a] == top[a]);
                corners.iter().filter(at_end).count() >= 3
            }
        }
    }
}

/// The values of an array at certain places, which begin with a run.
fn gather<T: Copy>(all: &[T], places: &[u32], out: &mut Vec<T>) {
    out.clear();
    let Some(&first) = places.first() else { return };
    let run = places.iter().zip(first..).take_while(|&(&v, expected)| v == expected).count();
    out.extend_from_slice(&all[first as usize..first as usize + run]);
    out.extend(places[run..].iter().map(|&v| all[v as usize]));
}
