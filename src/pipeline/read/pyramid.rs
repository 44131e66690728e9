//! A step of a pyramid: nodes of its levels in any box.
//!
//! ```text
//!  values-*.seg: tiles of the first three levels, by chunk ─┐
//!  coarse.seg: tiles of all others                          ├─▶ tiles, cached ─▶ nodes of a level
//!  ranges-*.seg: corrections of samples, by chunk ──────────┘
//! ```
//!
//! A tile is decoded when a box needs it, and cached with those that were used lately.

use super::step_view::StepView;
use super::steps::mean;
use crate::archive::manifest::{CorrectionRecord, WaveletRecord};
use crate::archive::segment::{Segment, SegmentKind};
use crate::error::{Error, Result};
use crate::grid::{ChunkId, IndexBox};
use crate::points::PointSpec;
use isospan_wavelet::{
    Box3, Coarse, Correction, Levels, Pyramid, Scale, Tile, TileBlock, TileId, TileSource,
    decode_corrections, decode_tile,
};
use rustc_hash::FxHashMap;
use std::collections::HashMap;
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What a step of a pyramid is, apart from its details.
pub(in crate::pipeline) struct PyramidStep {
    pub(in crate::pipeline) pyramid: Pyramid,
    pub(in crate::pipeline) scale: Scale,
    pub(in crate::pipeline) correction: Correction,
    coarse: Coarse,
    tiles: Mutex<Recent<TileId, Arc<Tile>>>,
    blocks: Mutex<Recent<(u64, usize), Arc<StoredBlock>>>,
    /// Nodes, by level and part, for the next question.
    windows: Mutex<Recent<(usize, [u64; 3]), Arc<NodeWindow>>>,
}

/// Nodes of a level in a box.
pub(in crate::pipeline) struct NodeWindow {
    pub(in crate::pipeline) place: IndexBox,
    pub(in crate::pipeline) values: Vec<f32>,
}

/// The bytes of a block, and where its tiles are in them.
struct StoredBlock {
    bytes: Vec<u8>,
    places: FxHashMap<TileId, Range<usize>>,
}

/// What was used lately, in two generations: when the young one is full, it becomes the old one,
/// and what was in that is forgotten.
struct Recent<K, V> {
    young: HashMap<K, V>,
    old: HashMap<K, V>,
    bytes: usize,
    most: usize,
}

impl<K: std::hash::Hash + Eq + Copy, V: Clone> Recent<K, V> {
    fn new(most: usize) -> Self {
        Self { young: HashMap::new(), old: HashMap::new(), bytes: 0, most }
    }

    fn get(&mut self, key: &K, bytes: impl Fn(&V) -> usize) -> Option<V> {
        if let Some(found) = self.young.get(key) {
            return Some(found.clone());
        }
        let found = self.old.remove(key)?;
        let size = bytes(&found);
        self.put(*key, found.clone(), size);
        Some(found)
    }

    fn put(&mut self, key: K, value: V, bytes: usize) {
        if self.bytes + bytes > self.most / 2 && !self.young.is_empty() {
            self.old = std::mem::take(&mut self.young);
            self.bytes = 0;
        }
        self.bytes += bytes;
        self.young.insert(key, value);
    }
}

/// Bytes of a decoded tile.
fn tile_bytes(tile: &Arc<Tile>) -> usize {
    128 + tile.parts.iter().map(|part| 4 * part.numbers.len()).sum::<usize>()
}

fn block_bytes(block: &Arc<StoredBlock>) -> usize {
    64 + block.bytes.len() + 64 * block.places.len()
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The pyramid of a point set that is one.
pub(in crate::pipeline) fn pyramid_of(spec: PointSpec) -> Option<Pyramid> {
    match spec {
        PointSpec::Pyramid { dims, delay } => Some(Pyramid::new(dims.map(|n| n as usize), delay)),
        _ => None,
    }
}

/// What coefficients of a step stand for, and how samples are corrected.
///
/// # Errors
/// [`Error::BadInput`] for numbers that no plan has.
pub(in crate::pipeline) fn scale_of(wavelet: &WaveletRecord, path: &Path) -> Result<(Scale, Correction)> {
    let wrong = |e: isospan_wavelet::Error| {
        Error::bad_input(path, "range, step and correction", "those of a pyramid", e.to_string())
    };
    let scale = Scale::new(wavelet.range, wavelet.step).map_err(wrong)?;
    let correction = match wavelet.correction {
        CorrectionRecord::None => Correction::None,
        CorrectionRecord::Max(bound) => Correction::within(bound, wavelet.range).map_err(wrong)?,
        CorrectionRecord::Lossless => Correction::Whole,
    };
    Ok((scale, correction))
}

/// A box of nodes as the crate of wavelets has it.
pub(in crate::pipeline) fn box3(b: &IndexBox) -> Box3 {
    Box3 { start: b.lo.map(|n| n as usize), size: b.dims().map(|n| n as usize) }
}

/// The same as the rest of the program has it.
pub(in crate::pipeline) fn index_box(b: &Box3) -> IndexBox {
    IndexBox { lo: b.start.map(|n| n as u64), hi: b.end().map(|n| n as u64) }
}

/// The number of a chunk.
pub(in crate::pipeline) fn chunk_number(pyramid: &Pyramid, at: [usize; 3]) -> ChunkId {
    let [nx, ny, _] = pyramid.chunks().map(|n| n as u64);
    let [x, y, z] = at.map(|n| n as u64);
    ChunkId((z * ny + y) * nx + x)
}

/// The place of a chunk among all, along each axis.
pub(in crate::pipeline) fn chunk_place(pyramid: &Pyramid, id: ChunkId) -> [usize; 3] {
    let [nx, ny, _] = pyramid.chunks().map(|n| n as u64);
    [id.0 % nx, id.0 / nx % ny, id.0 / nx / ny].map(|n| n as usize)
}

/// Cells along each axis of a brick, which has a range.
pub(in crate::pipeline) const BRICK_CELLS: usize = isospan_wavelet::TILE;

/// The cells of a chunk: between which of its nodes, as ranges along each axis.
pub(in crate::pipeline) fn cells_of(pyramid: &Pyramid, at: [usize; 3]) -> [Range<usize>; 3] {
    let (place, dims) = (pyramid.chunk(at), pyramid.nodes(0));
    std::array::from_fn(|a| place.start[a]..place.end()[a].min(dims[a] - 1))
}

/// The cells of the bricks of a chunk, in the order of their ranges.
pub(in crate::pipeline) fn bricks_of(pyramid: &Pyramid, at: [usize; 3]) -> Vec<[Range<usize>; 3]> {
    let cells = cells_of(pyramid, at);
    let [nx, ny, nz] = [0, 1, 2].map(|a| cells[a].len().div_ceil(BRICK_CELLS));
    let brick = |i: usize| {
        let at = [i % nx, i / nx % ny, i / nx / ny];
        std::array::from_fn(|a| {
            let start = cells[a].start + BRICK_CELLS * at[a];
            start..(start + BRICK_CELLS).min(cells[a].end)
        })
    };
    (0..nx * ny * nz).map(brick).collect()
}

impl StepView {
    /// Whether the archive is a pyramid.
    pub(in crate::pipeline) fn is_pyramid(&self) -> bool {
        matches!(self.manifest.plan.points, PointSpec::Pyramid { .. })
    }

    /// The pyramid of the step, with its coarse levels.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged archive; [`Error::Usage`] where there is no pyramid.
    pub(in crate::pipeline) fn pyramid(&self) -> Result<&PyramidStep> {
        if let Some(known) = self.pyramid.get() {
            return Ok(known);
        }
        let step = self.step();
        let path = self.layout.coarse();
        let (Some(pyramid), Some(wavelet)) = (pyramid_of(self.manifest.plan.points), step.plan.wavelet) else {
            return Err(Error::usage(format!("{} is no pyramid: it has no levels", self.path().display())));
        };
        let (scale, correction) = scale_of(&wavelet, &self.path().join(crate::archive::manifest::MANIFEST_NAME))?;
        let file = Segment::open(&path, SegmentKind::Coarse, Some(self.step_hash())).map_err(|e| self.lost(e))?;
        if let Some(recorded) = &step.coarse {
            super::archive::expect_recorded(&file, Some(recorded))?;
        }
        let mut bytes = vec![];
        file.block(0, &mut bytes)?;
        let coarse = Coarse::new(&pyramid, bytes).map_err(|e| damaged(&path, 0, &e))?;
        let most = self.cache.most().max(LEAST_CACHE);
        let made = PyramidStep {
            pyramid,
            scale,
            correction,
            coarse,
            tiles: Mutex::new(Recent::new(most)),
            blocks: Mutex::new(Recent::new(most / 8)),
            windows: Mutex::new(Recent::new(self.cache.most())),
        };
        Ok(self.pyramid.get_or_init(|| made))
    }

    /// The nodes of a level in a box, x fastest, less the offset of the source.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged archive; [`Error::Usage`] for a level that is not there.
    pub(in crate::pipeline) fn nodes(&self, level: usize, wanted: &IndexBox) -> Result<Vec<f32>> {
        let mut values = self.nodes_at_step(level, wanted)?;
        if let Some((next, share)) = self.next_step() {
            let behind = next.nodes_at_step(level, wanted)?;
            values.iter_mut().zip(behind).for_each(|(a, b)| *a = mean(*a, b, share));
        }
        Ok(values)
    }

    /// As [`StepView::nodes`], of the step before a moment between two.
    fn nodes_at_step(&self, level: usize, wanted: &IndexBox) -> Result<Vec<f32>> {
        let mut values = self.uncorrected(level, wanted)?;
        if level == 0 {
            self.correct(&mut values, &box3(wanted))?;
        }
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
        let bytes = |window: &Arc<NodeWindow>| 64 + 4 * window.values.len();
        let known = lock(&of.windows).get(&key, bytes);
        if let Some(known) = known.filter(|known| known.place.intersect(wanted) == *wanted) {
            return Ok(known);
        }
        let found = Arc::new(NodeWindow { place: *wanted, values: self.nodes(level, wanted)? });
        if self.cache.most() > 0 {
            lock(&of.windows).put(key, Arc::clone(&found), bytes(&found));
        }
        Ok(found)
    }

    /// As [`StepView::nodes`], without corrections.
    pub(in crate::pipeline) fn uncorrected(&self, level: usize, wanted: &IndexBox) -> Result<Vec<f32>> {
        let of = self.pyramid()?;
        let levels = Levels { pyramid: &of.pyramid, scale: &of.scale, top: of.coarse.top() };
        levels.nodes(level, &box3(wanted), &mut Reader { view: self, of }).map_err(|Found(e)| e)
    }

    /// Corrects samples of a box.
    fn correct(&self, values: &mut [f32], wanted: &Box3) -> Result<()> {
        let of = self.pyramid()?;
        if of.correction == Correction::None {
            return Ok(());
        }
        let (first, last) = (wanted.start, wanted.end().map(|e| e - 1));
        let chunk_at = |sample: [usize; 3]| {
            let chunks = of.pyramid.chunks();
            std::array::from_fn::<usize, 3, _>(|a| (sample[a] / isospan_wavelet::CHUNK).min(chunks[a] - 1))
        };
        let (lo, hi) = (chunk_at(first), chunk_at(last));
        let (mut numbers, mut bytes) = (vec![0; values.len()], vec![]);
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    let id = chunk_number(&of.pyramid, [x, y, z]);
                    let file = self.ranges_of(id)?;
                    file.block(id, 0, &mut bytes)?;
                    let place = of.pyramid.chunk([x, y, z]);
                    decode_corrections(&place, &bytes, wanted, &mut numbers)
                        .map_err(|e| damaged(file.segment().path(), file.block_number(id, 0), &e))?;
                }
            }
        }
        for (value, number) in values.iter_mut().zip(numbers) {
            *value = of.correction.correct(*value, number);
        }
        Ok(())
    }

    /// A block of tiles, read and taken apart.
    fn tile_block(&self, of: &PyramidStep, chunk: ChunkId, number: usize, block: &TileBlock) -> Result<Arc<StoredBlock>> {
        if let Some(known) = lock(&of.blocks).get(&(chunk.0, number), block_bytes) {
            return Ok(known);
        }
        let file = self.values_of(self.position(), chunk)?;
        let mut bytes = vec![];
        if number as u64 >= file.block_count(chunk) {
            let (expected, got) = (format!("more than {number}"), file.block_count(chunk).to_string());
            return Err(Error::bad_input(file.segment().path(), format!("chunk {}, blocks", chunk.0), expected, got));
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

/// Decoded tiles that are cached at least: those around a box.
const LEAST_CACHE: usize = 32 << 20;

fn damaged(path: &Path, block: u64, what: &isospan_wavelet::Error) -> Error {
    Error::bad_input(path, format!("block {block}"), "coefficients of this pyramid", what.to_string())
        .with_help("restore the file, or run the same reduction again")
}

/// An error of the program as one that the crate of wavelets passes on.
struct Found(Error);

impl From<isospan_wavelet::Error> for Found {
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
    type Error = Found;

    fn tile(&mut self, id: TileId) -> std::result::Result<Option<Arc<Tile>>, Found> {
        let (view, of) = (self.view, self.of);
        if let Some(known) = lock(&of.tiles).get(&id, tile_bytes) {
            return Ok(Some(known));
        }
        let tile = if id.level > of.pyramid.details() {
            of.coarse.tile(&of.pyramid, id, self)?
        } else {
            let at = of.pyramid.chunk_of(id);
            let chunk = chunk_number(&of.pyramid, at);
            let (number, block) = of.pyramid.block_of(at, id);
            let stored = view.tile_block(of, chunk, number, &block).map_err(Found)?;
            let bytes = stored.places.get(&id).map(|place| &stored.bytes[place.clone()]);
            decode_tile(&of.pyramid, id, bytes, self)?
        };
        let Some(tile) = tile else { return Ok(None) };
        lock(&of.tiles).put(id, Arc::clone(&tile), tile_bytes(&tile));
        Ok(Some(tile))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_used_lately_stays() {
        let mut recent = Recent::new(100);
        for i in 0..10 {
            recent.put(i, i, 10);
            assert_eq!(recent.get(&0, |_| 10), Some(0), "{i}");
        }
        assert_eq!(recent.get(&1, |_| 10), None);
        assert!(recent.young.len() + recent.old.len() <= 11);
    }

    #[test]
    fn chunks_have_numbers_and_bricks() {
        let pyramid = Pyramid::new([513, 300, 70], [0; 3]);
        assert_eq!(pyramid.chunks(), [2, 2, 1]);
        for id in (0..4).map(ChunkId) {
            assert_eq!(chunk_number(&pyramid, chunk_place(&pyramid, id)), id);
        }
        assert_eq!(cells_of(&pyramid, [1, 1, 0]), [256..512, 256..299, 0..69]);
        let bricks = bricks_of(&pyramid, [1, 1, 0]);
        assert_eq!((bricks.len(), bricks[0].clone()), (8 * 2 * 3, [256..288, 256..288, 0..32]));
        assert_eq!(bricks[47], [480..512, 288..299, 64..69]);
    }
}
