//! Precomputed blocks (`isospan unpack`) while questions are answered: found among the segments of
//! a step, and used where they are mapped.
//!
//! ```text
//!  steps/N-unpacked.seg, mapped ──▶ words of a block ──▶ checksum, contents: once ──▶ precomputed block ──▶ surface
//! ```
//!
//! They are used where they exist and were made for this archive, for a stored step on this
//! machine. Blocks are decoded instead between two steps, and in an archive on a server, where
//! sixty bytes per tetrahedron would cross the network. A damaged file, or one of other segments,
//! is an error.

use super::worker::{ChunkWork, ChunkWorker};
use crate::archive::Malformed;
use crate::archive::mesh::{Unpacked, UnpackedPlace, unpacked_hash};
use crate::archive::segment::PlanHash;
use crate::bytes::remote::is_remote;
use crate::error::{Error, Result};
use crate::exec::will_read;
use crate::index::Entry;
use crate::pipeline::read::{Buffers, OpenArchive, StepSummary, StepView, unpack_precomputed};
use crate::surface::extract::{Flaw, Precomputed};
use std::sync::atomic::Ordering;

impl StepView {
    /// The unpacked blocks of the step, if there are any. They are searched for once.
    pub(in crate::pipeline) fn unpacked(&self) -> Result<Option<&Unpacked>> {
        if self.is_between() || is_remote(self.path()) {
            return Ok(None);
        }
        if let Some(found) = self.unpacked.get() {
            return Ok(found.as_ref());
        }
        let found = self.open_unpacked(self.position())?;
        Ok(self.unpacked.get_or_init(|| found).as_ref())
    }
}

impl OpenArchive {
    /// The unpacked blocks of the step at a position in the manifest, if there are any.
    pub(super) fn open_unpacked(&self, step: usize) -> Result<Option<Unpacked>> {
        let path = self.layout_at(step).unpacked();
        Unpacked::open(&path, self.unpacked_hash(step), self.chunks.len())
    }

    /// All steps, with what is unpacked of them.
    pub(in crate::pipeline) fn summarized_steps(&self) -> Result<Vec<StepSummary>> {
        let all = 0..self.manifest.steps.len();
        all.map(|n| {
            let file = if is_remote(self.path()) { None } else { self.open_unpacked(n)? };
            let unpacked_bytes = file.map(|file| file.segment().info().bytes);
            Ok(StepSummary { unpacked_bytes, ..StepSummary::of(&self.manifest, n) })
        })
        .collect()
    }

    /// The hash of what the unpacked blocks of a step are made of: the mesh, and its values, back
    /// to a keyframe.
    pub(super) fn unpacked_hash(&self, step: usize) -> PlanHash {
        let manifest = &self.manifest;
        let chain = std::iter::successors(Some(step), |&step| manifest.base_of(step));
        let chain: Vec<_> = chain.map(|step| manifest.step_at(step)).collect();
        let values = chain.iter().rev().flat_map(|step| &step.values);
        let made_of = manifest.mesh.iter().chain(values).map(|record| &record.info);
        unpacked_hash(chain[0].plan.hash(manifest.plan_hash), made_of)
    }
}

/// The unpacked blocks of a chunk that a question asks for, in its order.
pub(super) struct UnpackedChunk<'a> {
    file: &'a Unpacked,
    places: Vec<UnpackedPlace<'a>>,
    /// Corners of the chunk, and edges with numbers.
    corners: usize,
    edges: usize,
    words: Vec<u32>,
}

impl<'a> UnpackedChunk<'a> {
    /// `None` where nothing is unpacked.
    pub(super) fn of(archive: &'a StepView, work: &ChunkWork) -> Result<Option<Self>> {
        let Some(file) = archive.unpacked()? else { return Ok(None) };
        let mut places = Vec::with_capacity(work.blocks.len());
        file.places(work.chunk, work.blocks.iter().map(|b| b.block), &mut places)?;
        let chunk = file.chunk(work.chunk);
        let (corners, edges) = (chunk.corners as usize, chunk.edges as usize);
        Ok(Some(Self { file, places, corners, edges, words: vec![] }))
    }

    /// Adds the `n`-th of the blocks to the surfaces of the chunk. False if it is available only
    /// packed.
    pub(super) fn add(
        &mut self,
        n: usize,
        entry: &Entry,
        chunk: &mut ChunkWorker<'_>,
        buffers: &mut Buffers,
    ) -> Result<bool> {
        let place = self.places[n];
        if place.bytes() == 0 {
            return Ok(false);
        }
        self.prefetch(n, chunk.question.isovalues);
        let file = self.file;
        let isovalues = chunk.question.is_whole().then_some(chunk.question.isovalues);
        let block = block_of(file, &place, self.corners, isovalues, &mut self.words)?;
        let before = chunk.active();
        if chunk.question.is_whole() {
            chunk.number_edges(self.edges);
            if !chunk.add_precomputed(entry, block, self.corners, &mut buffers.bench) {
                return Err(flawed(
                    file,
                    &place,
                    Flaw::new("edges of tetrahedra", "those between their corners", "others"),
                ));
            }
        } else {
            if !block.has_whole_tets() {
                let flaw = Flaw::new("corners of tetrahedra", "corners in different places", "others");
                return Err(flawed(file, &place, flaw));
            }
            unpack_precomputed(block, self.corners, &mut buffers.block);
            chunk.add(entry, buffers, None);
        }
        if chunk.active() > before {
            chunk.question.active_bytes.fetch_add(place.bytes(), Ordering::Relaxed);
        }
        Ok(true)
    }

    /// Asks the system and the processor for the blocks that follow.
    fn prefetch(&self, n: usize, isovalues: &[f32]) {
        let ahead = |blocks: usize| self.places.get(n + blocks)?.at_hand();
        // Its groups were prefetched before.
        if let Some(Ok(next)) = ahead(1).map(Precomputed::open) {
            next.block.tets_will_be_read(isovalues);
        }
        // About the part of any block that is read: its lists except the edges of tetrahedra and
        // slots.
        if let Some(words) = ahead(2) {
            will_read(&words[..words.len() * 2 / 5]);
        }
        // A page must be there for the processor to read ahead in it.
        if let Some([first, .., last]) = ahead(3) {
            std::hint::black_box(*first ^ *last);
        }
    }

    /// Whether all words that were used were the file's.
    ///
    /// # Errors
    /// When the file has become shorter meanwhile.
    pub(super) fn end(self) -> Result<()> {
        self.file.check_mapped()
    }
}

/// The block at a place, in a chunk of `of_chunk` corners. The part of it that a question about
/// these isovalues (none: about all) reads is checked when it is first read.
fn block_of<'a>(
    file: &Unpacked,
    place: &UnpackedPlace<'a>,
    of_chunk: usize,
    isovalues: Option<&[f32]>,
    words: &'a mut Vec<u32>,
) -> Result<Precomputed<'a>> {
    let is_right = |words: &'a [u32]| {
        let (stored, noted) = (Precomputed::open(words)?, file.noted(place));
        let known = noted.load(Ordering::Relaxed);
        let right = stored.check(of_chunk, isovalues, known)?;
        if right != known {
            noted.fetch_or(right, Ordering::Relaxed);
        }
        Ok(stored.block)
    };
    is_right(file.words(place, words)?).map_err(|flaw| flawed(file, place, flaw))
}

fn flawed(file: &Unpacked, place: &UnpackedPlace<'_>, Flaw { at, expected, got }: Flaw) -> Error {
    file.blame(place, Malformed::new(at, expected, got))
}
