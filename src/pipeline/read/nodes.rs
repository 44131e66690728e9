//! Nodes of the levels of a pyramid, in any box.

use super::archive::expect_recorded;
use super::pyramid::{
    CoarseLevels, NodeWindow, PyramidStep, StoredBlock, block_bytes, box3, chunk_number, has_coarse_mask,
    lock, mask_bytes, pyramid_of, scale_of, tile_bytes,
};
use super::step_view::StepView;
use super::steps::mean;
use crate::archive::manifest::MANIFEST_NAME;
use crate::archive::segment::{Segment, SegmentKind};
use isospan_io::error::{Error, Result};
use isospan_io::grid::{ChunkId, IndexBox};
use isospan_wavelet::{
    Box3, Coarse, Correction, Levels, Mask, Pyramid, Tile, TileBlock, TileId, TileSource, decode_corrections,
    decode_tile,
};
use std::path::Path;
use std::sync::Arc;

impl StepView {
    /// The pyramid of the step.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged archive; [`Error::Usage`] where there is no pyramid.
    pub(in crate::pipeline) fn pyramid(&self) -> Result<&PyramidStep> {
        if let Some(known) = self.pyramid.get() {
            return Ok(known);
        }
        let wavelet = self.step().plan.wavelet;
        let (Some(pyramid), Some(wavelet)) = (pyramid_of(self.manifest.plan.points), wavelet) else {
            return Err(Error::usage(format!("{} is no pyramid: it has no levels", self.path().display())));
        };
        let (scale, correction) = scale_of(&wavelet).map_err(|e| {
            let at = "range, step and correction of a step";
            Error::bad_input(self.path().join(MANIFEST_NAME), at, "those of a pyramid", e.to_string())
        })?;
        let most = self.cache.most();
        let of_tiles = if self.is_base { CACHE_OF_BASE } else { most.max(LEAST_CACHE) };
        let made = PyramidStep::new(pyramid, scale, correction, [of_tiles, most]);
        Ok(self.pyramid.get_or_init(|| made))
    }

    /// The coarse levels of the step.
    fn coarse<'a>(&self, of: &'a PyramidStep) -> Result<&'a CoarseLevels> {
        if let Some(known) = of.coarse.get() {
            return Ok(known);
        }
        let _reading = lock(&of.reading);
        if let Some(known) = of.coarse.get() {
            return Ok(known);
        }
        let path = self.layout.coarse();
        let file =
            Segment::open(&path, SegmentKind::Coarse, Some(self.step_hash())).map_err(|e| self.lost(e))?;
        if let Some(recorded) = &self.step().coarse {
            expect_recorded(&file, Some(recorded))?;
        }
        let mut bytes = vec![];
        file.block(0, &mut bytes)?;
        let tiles = Coarse::new(&of.pyramid, bytes).map_err(|e| damaged(&path, 0, &e))?;
        let mut missing = None;
        if file.block_count() > 1 {
            let mut bytes = vec![];
            file.block(1, &mut bytes)?;
            let place = Box3::all(of.pyramid.nodes(of.pyramid.details()));
            missing = Some(Mask::new(place, bytes).map_err(|e| damaged(&path, 1, &e))?);
        }
        Ok(of.coarse.get_or_init(|| CoarseLevels { tiles, missing }))
    }

    /// A decoded tile of the step; none if all its coefficients are zero. Tiles of the first three
    /// levels need no coarse one.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged archive.
    pub(in crate::pipeline) fn tile(&self, id: TileId) -> Result<Option<Arc<Tile>>> {
        Reader { view: self, of: self.pyramid()? }.tile(id).map_err(|TileReadError(e)| e)
    }

    /// The nodes of a level in a box, x fastest, less the offset of the source; NaN where the
    /// sample of a node is missing.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged archive; [`Error::Usage`] for a level that is not there.
    pub(in crate::pipeline) fn nodes(&self, level: usize, wanted: &IndexBox) -> Result<Vec<f32>> {
        let mut values = self.nodes_at_step(level, wanted)?;
        if let Some((next, share)) = self.next_step() {
            let behind = next.nodes_at_step(level, wanted)?;
            values.iter_mut().zip(&behind).for_each(|(a, b)| *a = mean(*a, *b, share));
            next.spare.give_nodes(behind);
        }
        Ok(values)
    }

    /// As [`StepView::nodes`], of the step before a moment between two.
    fn nodes_at_step(&self, level: usize, wanted: &IndexBox) -> Result<Vec<f32>> {
        let mut values = self.uncorrected(level, wanted)?;
        if level == 0 {
            self.correct(&mut values, &box3(wanted))?;
        }
        self.leave_out_missing(level, wanted, &mut values)?;
        Ok(values)
    }

    /// Nodes of a level that include a box, cached under a key where the view caches anything.
    ///
    /// # Errors
    /// As [`StepView::nodes`].
    pub(in crate::pipeline) fn cached_nodes(
        &self,
        level: usize,
        key: [u64; 3],
        wanted: &IndexBox,
    ) -> Result<Arc<NodeWindow>> {
        let (of, key) = (self.pyramid()?, (level, key));
        let known = lock(&of.windows).get(&key);
        if let Some(known) = known.filter(|known| known.place.intersect(wanted) == *wanted) {
            return Ok(known);
        }
        let mut values = self.nodes(level, wanted)?;
        if self.cache.most() > 0 {
            values.shrink_to_fit();
        }
        let found = Arc::new(NodeWindow { place: *wanted, values });
        if self.cache.most() > 0 {
            lock(&of.windows).put(key, Arc::clone(&found), 64 + 4 * found.values.len());
        }
        Ok(found)
    }

    /// As [`StepView::nodes`], without corrections, and with values that stand for missing samples.
    pub(in crate::pipeline) fn uncorrected(&self, level: usize, wanted: &IndexBox) -> Result<Vec<f32>> {
        let of = self.pyramid()?;
        if of.pyramid.has_labels() {
            return self.labels(of, level, wanted);
        }
        let levels = Levels { pyramid: &of.pyramid, scale: &of.scale, top: self.coarse(of)?.tiles.top() };
        levels.nodes(level, &box3(wanted), &mut Reader { view: self, of }).map_err(|TileReadError(e)| e)
    }

    /// Corrects samples of a box.
    fn correct(&self, values: &mut [f32], wanted: &Box3) -> Result<()> {
        let of = self.pyramid()?;
        if of.correction == Correction::None {
            return Ok(());
        }
        let (first, last) = (wanted.start, wanted.end().map(|e| e - 1));
        let (mut numbers, mut bytes) = (vec![0; values.len()], vec![]);
        for at in chunks_with(&of.pyramid, first, last) {
            let id = chunk_number(&of.pyramid, at);
            let file = self.ranges_of(id)?;
            file.block(id, 0, &mut bytes)?;
            let place = of.pyramid.chunk(at);
            decode_corrections(&place, &bytes, wanted, &mut numbers)
                .map_err(|e| damaged(file.segment().path(), file.block_number(id, 0), &e))?;
        }
        for (value, number) in values.iter_mut().zip(numbers) {
            *value = of.correction.correct(*value, number);
        }
        Ok(())
    }

    /// Makes NaN of the nodes of a box whose samples are missing. Returns whether there are any.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged archive.
    pub(in crate::pipeline) fn leave_out_missing(
        &self,
        level: usize,
        wanted: &IndexBox,
        values: &mut [f32],
    ) -> Result<bool> {
        let of = self.pyramid()?;
        let mut any = false;
        let mut leave_out = |i: usize| (values[i], any) = (f32::NAN, true);
        let (pyramid, nodes, details) = (&of.pyramid, box3(wanted), of.pyramid.details());
        let stride = pyramid.stride(level);
        if has_coarse_mask(pyramid, level) {
            let Some(mask) = &self.coarse(of)?.missing else { return Ok(false) };
            let fine = pyramid.stride(details);
            let steps = std::array::from_fn(|a| stride[a] / fine[a]);
            let found = mask.each_missing(&nodes, steps, leave_out);
            return found.map(|()| any).map_err(|e| damaged(&self.layout.coarse(), 1, &e));
        }
        let last = [0, 1, 2].map(|a| (nodes.end()[a] - 1) * stride[a]);
        let first = [0, 1, 2].map(|a| nodes.start[a] * stride[a]);
        for at in chunks_with(pyramid, first, last) {
            let id = chunk_number(pyramid, at);
            let Some(mask) = self.mask_of(of, id, at)? else { continue };
            mask.each_missing(&nodes, stride, &mut leave_out).map_err(|e| {
                let number = pyramid.blocks(at).len() as u64;
                match self.values_of(self.position(), id) {
                    Ok(file) => damaged(file.segment().path(), file.block_number(id, number), &e),
                    Err(e) => e,
                }
            })?;
        }
        Ok(any)
    }

    /// The mask of a chunk, where it has missing samples.
    fn mask_of(&self, of: &PyramidStep, chunk: ChunkId, at: [usize; 3]) -> Result<Option<Arc<Mask>>> {
        let file = self.values_of(self.position(), chunk)?;
        let (blocks, found) = (of.pyramid.blocks(at).len() as u64, file.block_count(chunk));
        if found <= blocks {
            return Ok(None);
        }
        if found > blocks + 1 {
            let (at, expected) = (format!("chunk {}, blocks", chunk.0), format!("at most {}", blocks + 1));
            return Err(Error::bad_input(file.segment().path(), at, expected, found.to_string()));
        }
        if let Some(known) = lock(&of.masks).get(&chunk.0) {
            return Ok(Some(known));
        }
        let mut bytes = vec![];
        file.block(chunk, blocks, &mut bytes)?;
        let mask = Mask::new(of.pyramid.chunk(at), bytes)
            .map_err(|e| damaged(file.segment().path(), file.block_number(chunk, blocks), &e))?;
        let mask = Arc::new(mask);
        lock(&of.masks).put(chunk.0, Arc::clone(&mask), mask_bytes(&mask));
        Ok(Some(mask))
    }

    /// A block of tiles, read and taken apart.
    pub(super) fn tile_block(
        &self,
        of: &PyramidStep,
        chunk: ChunkId,
        number: usize,
        block: &TileBlock,
    ) -> Result<Arc<StoredBlock>> {
        if let Some(known) = lock(&of.blocks).get(&(chunk.0, number)) {
            return Ok(known);
        }
        let file = self.values_of(self.position(), chunk)?;
        let mut bytes = vec![];
        if number as u64 >= file.block_count(chunk) {
            let (expected, got) = (format!("more than {number}"), file.block_count(chunk).to_string());
            return Err(Error::bad_input(
                file.segment().path(),
                format!("chunk {}, blocks", chunk.0),
                expected,
                got,
            ));
        }
        file.block(chunk, number as u64, &mut bytes)?;
        let places = block
            .places(&bytes)
            .map_err(|e| damaged(file.segment().path(), file.block_number(chunk, number as u64), &e))?;
        let found = Arc::new(StoredBlock { bytes, places: places.into_iter().collect() });
        let size = block_bytes(&found);
        lock(&of.blocks).put((chunk.0, number), Arc::clone(&found), size);
        Ok(found)
    }
}

/// The places of the chunks that have the samples of a box, from its first to its last.
fn chunks_with(
    pyramid: &Pyramid,
    first: [usize; 3],
    last: [usize; 3],
) -> impl Iterator<Item = [usize; 3]> + use<> {
    let chunks = pyramid.chunks();
    let [lo, hi] = [first, last].map(|sample| {
        std::array::from_fn::<usize, 3, _>(|a| (sample[a] / isospan_wavelet::CHUNK).min(chunks[a] - 1))
    });
    (lo[2]..=hi[2])
        .flat_map(move |z| (lo[1]..=hi[1]).flat_map(move |y| (lo[0]..=hi[0]).map(move |x| [x, y, z])))
}

/// Decoded tiles that are cached at least: those around a box.
const LEAST_CACHE: usize = 32 << 20;
/// And those of a base: some parents. There may be many bases.
const CACHE_OF_BASE: usize = 1 << 20;

pub(super) fn damaged(path: &Path, block: u64, what: &isospan_wavelet::Error) -> Error {
    Error::bad_input(path, format!("block {block}"), "coefficients of this pyramid", what.to_string())
        .with_help("restore the file, or run the same reduction again")
}

/// An error of the program as one that the crate of wavelets passes on.
struct TileReadError(Error);

impl From<isospan_wavelet::Error> for TileReadError {
    fn from(e: isospan_wavelet::Error) -> Self {
        match e {
            isospan_wavelet::Error::Level { level, coarsest } => Self(Error::usage(format!(
                "there is no level {level}: the archive has levels 0 (the finest) to {coarsest}"
            ))),
            other => Self(Error::usage(other.to_string())),
        }
    }
}

struct Reader<'a> {
    view: &'a StepView,
    of: &'a PyramidStep,
}

impl TileSource for Reader<'_> {
    type Error = TileReadError;

    fn tile(&mut self, id: TileId) -> std::result::Result<Option<Arc<Tile>>, TileReadError> {
        let (view, of) = (self.view, self.of);
        if let Some(known) = lock(&of.tiles).get(&id) {
            return Ok(Some(known));
        }
        let tile = if id.level > of.pyramid.details() {
            view.coarse(of).map_err(TileReadError)?.tiles.tile(&of.pyramid, id, self)?
        } else {
            let at = of.pyramid.chunk_of(id);
            let chunk = chunk_number(&of.pyramid, at);
            let (number, block) = of.pyramid.block_of(at, id);
            let stored = view.tile_block(of, chunk, number, &block).map_err(TileReadError)?;
            let bytes = stored.places.get(&id).map(|place| &stored.bytes[place.clone()]);
            decode_tile(&of.pyramid, id, bytes, self)?
        };
        let Some(tile) = tile else { return Ok(None) };
        if !view.is_base || Tile::is_parent(&of.pyramid, id.level) {
            lock(&of.tiles).put(id, Arc::clone(&tile), tile_bytes(&tile));
        }
        Ok(Some(tile))
    }

    fn before(&mut self, id: TileId) -> std::result::Result<Option<Arc<Tile>>, TileReadError> {
        self.view.base().map_or(Ok(None), |base| base.tile(id)).map_err(TileReadError)
    }

    fn room(&mut self, nodes: usize) -> Vec<f32> {
        self.view.spare.nodes(nodes)
    }

    fn give_back(&mut self, room: Vec<f32>) {
        self.view.spare.give_nodes(room);
    }
}
