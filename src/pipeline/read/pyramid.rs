//! A step of a pyramid: nodes of its levels in any box.
//!
//! ```text
//!  values-*.seg: tiles of the first three levels, by chunk ─┐
//!  coarse.seg: tiles of all others                          ├─▶ tiles, cached ─▶ nodes of a level
//!  ranges-*.seg: corrections of samples, by chunk ──────────┘
//! ```
//!
//! A tile is decoded when a box needs it, and cached with those that were used lately. It may be
//! stored as what changes from the tile of another step, its base, which is decoded then.

use crate::archive::chunked::BlockRange;
use crate::archive::manifest::{CorrectionRecord, WaveletRecord};
use isospan_io::grid::{ChunkId, IndexBox};
use isospan_mesh::points::PointSpec;
use isospan_wavelet::{Box3, Coarse, Correction, Mask, Pyramid, Scale, Tile, TileId};
use rustc_hash::FxHashMap;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// What a step of a pyramid is, apart from its details.
pub(in crate::pipeline) struct PyramidStep {
    pub(in crate::pipeline) pyramid: Pyramid,
    pub(in crate::pipeline) scale: Scale,
    pub(in crate::pipeline) correction: Correction,
    pub(super) coarse: OnceLock<CoarseLevels>,
    /// Held while these are read, which one thread does.
    pub(super) reading: Mutex<()>,
    pub(super) tiles: Mutex<Recent<TileId, Arc<Tile>>>,
    /// Tiles of labels, of an archive that has these.
    pub(super) labels: Mutex<Recent<TileId, Arc<Vec<i32>>>>,
    pub(super) blocks: Mutex<Recent<(u64, usize), Arc<StoredBlock>>>,
    /// The samples of chunks that are missing.
    pub(super) masks: Mutex<Recent<u64, Arc<Mask>>>,
    /// Nodes, by level and part, for the next question.
    pub(super) windows: Mutex<Recent<WindowKey, Arc<NodeWindow>>>,
}

/// What is stored for all chunks together.
pub(super) struct CoarseLevels {
    pub(super) tiles: Coarse,
    /// The nodes of the last level of chunks that are missing, where some are.
    pub(super) missing: Option<Mask>,
}

/// A level, and the place of a part among its parts.
pub(super) type WindowKey = (usize, [u64; 3]);

/// Nodes of a level in a box.
pub(in crate::pipeline) struct NodeWindow {
    pub(in crate::pipeline) place: IndexBox,
    pub(in crate::pipeline) values: Vec<f32>,
}

impl PyramidStep {
    /// A step, of which about so many bytes of tiles and of nodes are cached.
    pub(super) fn new(
        pyramid: Pyramid,
        scale: Scale,
        correction: Correction,
        [of_tiles, of_nodes]: [usize; 2],
    ) -> Self {
        Self {
            pyramid,
            scale,
            correction,
            coarse: OnceLock::new(),
            reading: Mutex::default(),
            tiles: Mutex::new(Recent::new(of_tiles)),
            labels: Mutex::new(Recent::new(of_tiles)),
            blocks: Mutex::new(Recent::new(of_tiles / 8)),
            masks: Mutex::new(Recent::new(of_tiles / 8)),
            windows: Mutex::new(Recent::new(of_nodes)),
        }
    }

    /// Bytes that are cached now.
    pub(super) fn cached_bytes(&self) -> usize {
        let of_tiles = lock(&self.tiles).bytes() + lock(&self.blocks).bytes() + lock(&self.labels).bytes();
        of_tiles + lock(&self.masks).bytes() + lock(&self.windows).bytes()
    }
}

/// The bytes of a block, and where its tiles are in them.
pub(super) struct StoredBlock {
    pub(super) bytes: Vec<u8>,
    pub(super) places: FxHashMap<TileId, Range<usize>>,
}

/// What was used lately, in two generations: when the young one is full, it becomes the old one,
/// and what was in that is forgotten.
pub(super) struct Recent<K, V> {
    young: Generation<K, V>,
    old: Generation<K, V>,
    most: usize,
}

/// Values with their bytes, and the bytes of all.
struct Generation<K, V> {
    values: HashMap<K, (V, usize)>,
    bytes: usize,
}

impl<K: std::hash::Hash + Eq + Copy, V: Clone> Recent<K, V> {
    fn new(most: usize) -> Self {
        let none = || Generation { values: HashMap::new(), bytes: 0 };
        Self { young: none(), old: none(), most }
    }

    fn bytes(&self) -> usize {
        self.young.bytes + self.old.bytes
    }

    pub(super) fn get(&mut self, key: &K) -> Option<V> {
        if let Some((found, _)) = self.young.values.get(key) {
            return Some(found.clone());
        }
        let (found, bytes) = self.old.take(key)?;
        self.put(*key, found.clone(), bytes);
        Some(found)
    }

    pub(super) fn put(&mut self, key: K, value: V, bytes: usize) {
        self.young.take(&key);
        if self.young.bytes + bytes > self.most / 2 && !self.young.values.is_empty() {
            let young = Generation { values: HashMap::new(), bytes: 0 };
            self.old = std::mem::replace(&mut self.young, young);
        }
        self.old.take(&key);
        self.young.bytes += bytes;
        self.young.values.insert(key, (value, bytes));
    }
}

impl<K: std::hash::Hash + Eq, V> Generation<K, V> {
    fn take(&mut self, key: &K) -> Option<(V, usize)> {
        let found = self.values.remove(key)?;
        self.bytes -= found.1;
        Some(found)
    }
}

/// Bytes of a decoded tile.
pub(super) fn tile_bytes(tile: &Arc<Tile>) -> usize {
    128 + tile.parts.iter().map(|part| 4 * part.numbers.len()).sum::<usize>()
}

pub(super) fn mask_bytes(mask: &Arc<Mask>) -> usize {
    64 + mask.size()
}

pub(super) fn block_bytes(block: &Arc<StoredBlock>) -> usize {
    64 + block.bytes.len() + 64 * block.places.len()
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The pyramid of a point set that is one.
pub(in crate::pipeline) fn pyramid_of(spec: PointSpec) -> Option<Pyramid> {
    match spec {
        PointSpec::Pyramid { dims, delay } => Some(Pyramid::new(dims.map(|n| n as usize), delay)),
        PointSpec::Labels { dims } => Some(Pyramid::of_labels(dims.map(|n| n as usize))),
        _ => None,
    }
}

/// What coefficients of a step stand for, and how samples are corrected.
///
/// # Errors
/// Those of numbers that no plan has.
pub(in crate::pipeline) fn scale_of(wavelet: &WaveletRecord) -> isospan_wavelet::Result<(Scale, Correction)> {
    // Labels have no coefficients.
    let step = match wavelet.correction {
        CorrectionRecord::Labels => (wavelet.range[1] - wavelet.range[0]).max(1.0),
        _ => wavelet.step,
    };
    let scale = Scale::new(wavelet.range, step)?;
    let correction = match wavelet.correction {
        CorrectionRecord::None | CorrectionRecord::Labels => Correction::None,
        CorrectionRecord::Max(bound) => Correction::within(bound, wavelet.range)?,
        CorrectionRecord::Lossless => Correction::Whole,
    };
    Ok((scale, correction))
}

/// Whether missing nodes of a level are told with the coarse levels, and not by chunks.
pub(in crate::pipeline) fn has_coarse_mask(pyramid: &Pyramid, level: usize) -> bool {
    level >= pyramid.details().max(1)
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

/// Cells of a level of a chunk that have a range together.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::pipeline) struct Brick {
    pub(in crate::pipeline) level: usize,
    /// Between which nodes of the level, along each axis.
    pub(in crate::pipeline) cells: [Range<usize>; 3],
}

/// The cells of a level that begin in a box of samples, which begins at a node and ends at one or
/// where the array does.
pub(in crate::pipeline) fn cells_in(pyramid: &Pyramid, place: &Box3, level: usize) -> [Range<usize>; 3] {
    let (stride, nodes, dims) = (pyramid.stride(level), pyramid.nodes(level), pyramid.nodes(0));
    std::array::from_fn(|a| {
        let start = place.start[a] / stride[a];
        let end = if place.end()[a] == dims[a] { nodes[a] - 1 } else { place.end()[a] / stride[a] };
        start..end.max(start)
    })
}

/// The bricks of a chunk, in the order of their ranges: those of the finest level, then those of
/// each coarser one that chunks have details of.
pub(in crate::pipeline) fn bricks_of(pyramid: &Pyramid, at: [usize; 3]) -> Vec<Brick> {
    let place = pyramid.chunk(at);
    let of_level = |level: usize| {
        let cells = cells_in(pyramid, &place, level);
        let [nx, ny, nz] = [0, 1, 2].map(|a| cells[a].len().div_ceil(BRICK_CELLS));
        (0..nx * ny * nz).map(move |i| {
            let at = [i % nx, i / nx % ny, i / nx / ny];
            let range = |a: usize| {
                let start = cells[a].start + BRICK_CELLS * at[a];
                start..(start + BRICK_CELLS).min(cells[a].end)
            };
            Brick { level, cells: [range(0), range(1), range(2)] }
        })
    };
    (0..=pyramid.details()).flat_map(of_level).collect()
}

/// The range of the nodes of some cells, void ones left out, and that of all nodes that are known.
pub(in crate::pipeline) fn range_of_cells(
    values: &[f32],
    place: &IndexBox,
    cells: &[Range<usize>; 3],
) -> (BlockRange, [f32; 2]) {
    let [xs, ys, zs] = cells;
    let none = [f32::INFINITY, f32::NEG_INFINITY];
    let wider = |[min, max]: [f32; 2], v: f32| [if v < min { v } else { min }, if v > max { v } else { max }];
    let row = |y: usize, z: usize| &values[place.offset([xs.start, y, z].map(|n| n as u64))..][..=xs.len()];
    let (mut known, mut missing) = (none, false);
    for z in zs.start..=zs.end {
        for y in ys.start..=ys.end {
            for &v in row(y, z) {
                known = wider(known, v);
                missing |= v.is_nan();
            }
        }
    }
    let known = known.map(|v| v + 0.0);
    let (mut range, mut count) = (known, cells.iter().map(ExactSizeIterator::len).product());
    if missing {
        (range, count) = (none, 0);
        for z in zs.clone() {
            for y in ys.clone() {
                let rows = [row(y, z), row(y + 1, z), row(y, z + 1), row(y + 1, z + 1)];
                for x in 0..xs.len() {
                    let nodes = || rows.iter().flat_map(|row| &row[x..x + 2]);
                    if !nodes().any(|v| v.is_nan()) {
                        range = nodes().fold(range, |range, v| wider(range, *v + 0.0));
                        count += 1;
                    }
                }
            }
        }
    }
    (BlockRange { min: range[0], max: range[1], tets: count as u32 }, known)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_used_lately_stays() {
        let mut recent = Recent::new(100);
        for i in 0..10 {
            recent.put(i, i, 10);
            assert_eq!(recent.get(&0), Some(0), "{i}");
            let kept = recent.young.values.len() + recent.old.values.len();
            assert!(recent.bytes() == 10 * kept && recent.bytes() <= 100, "{i}");
        }
        assert_eq!(recent.get(&1), None);
        // A value in the place of another counts once.
        let before = recent.bytes();
        recent.put(0, 7, 10);
        assert_eq!((recent.get(&0), recent.bytes()), (Some(7), before));
    }

    #[test]
    fn chunks_have_numbers_and_bricks() {
        let pyramid = Pyramid::new([513, 300, 70], [0; 3]);
        assert_eq!(pyramid.chunks(), [2, 2, 1]);
        for id in (0..4).map(ChunkId) {
            assert_eq!(chunk_number(&pyramid, chunk_place(&pyramid, id)), id);
        }
        let place = pyramid.chunk([1, 1, 0]);
        assert_eq!(cells_in(&pyramid, &place, 0), [256..512, 256..299, 0..69]);
        assert_eq!(cells_in(&pyramid, &place, 3), [32..64, 32..37, 0..8]);
        let bricks = bricks_of(&pyramid, [1, 1, 0]);
        assert_eq!(bricks.len(), 8 * 2 * 3 + 4 * 2 + 2 + 1);
        let at = |n: usize| (bricks[n].level, bricks[n].cells.clone());
        assert_eq!(at(0), (0, [256..288, 256..288, 0..32]));
        assert_eq!(at(47), (0, [480..512, 288..299, 64..69]));
        assert_eq!(at(48), (1, [128..160, 128..149, 0..32]));
        assert_eq!(at(58), (3, [32..64, 32..37, 0..8]));
        // A chunk of few samples at the end has no coarse cells of its own.
        let pyramid = Pyramid::new([260, 40, 40], [0; 3]);
        let levels: Vec<usize> = bricks_of(&pyramid, [1, 0, 0]).iter().map(|b| b.level).collect();
        assert_eq!(levels, [0, 0, 0, 0, 1]);
    }
}
