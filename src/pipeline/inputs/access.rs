//! Access in any order to the samples of a source: in place, through a cache of decoded chunks, or
//! from a copy in bricks.
//!
//! Sizes alone decide whether a cache suffices. Boxes of samples, those of the archive's chunks or
//! of blocks, are read in rows along x, and rows in layers along z. So a chunk of the source is
//! decoded once if all chunks that meet a layer are cached, and about twice if those that meet a
//! row are. The cache holds:
//!
//! * the chunks of two layers, if they take at most a quarter of the memory, because some threads
//!   work on the next layer already;
//! * else those of a layer, or of two rows, or of a row; rows only if they decode a chunk 2.5 times
//!   at most;
//! * else those of the boxes that are at work in a row, if they take at most half of the memory;
//! * if none of these fit, the source is copied into bricks, as a stream is.

use super::bricked_copy::{Scratch, copied};
use crate::pipeline::plan::{Halo, estimate};
use crate::pipeline::settings::RunSettings;
use isospan_io::error::Result;
use isospan_io::exec::Progress;
use isospan_io::geom::LatticeBox;
use isospan_io::grid::{ChunkGrid, IndexBox};
use isospan_io::volume::chunked::{ChunkShape, ChunkedVolume};
use isospan_io::volume::{VolumeReader, VolumeSource};
use isospan_mesh::points::PointSet;

/// The part of the memory that decoded chunks may take, and that they may where the source would be
/// copied otherwise.
const PART: u64 = 4;
const LARGEST_PART: u64 = 2;
/// How often a chunk may be decoded in one pass, on average.
const MOST_DECODES: f64 = 2.5;

/// The most bytes of decoded chunks that are cached.
pub(in crate::pipeline) fn most_cached(memory: u64) -> u64 {
    memory / PART
}

/// The most bytes of them where fewer are of no use.
pub(in crate::pipeline) fn most_at_work(memory: u64) -> u64 {
    memory / LARGEST_PART
}

/// A box of samples that is read at a time, and the part of it that no other one has.
#[derive(Clone, Copy, Debug)]
pub(in crate::pipeline) struct ReadBox {
    pub(in crate::pipeline) samples: IndexBox,
    pub(in crate::pipeline) own: IndexBox,
}

/// Samples around a point from which its value is interpolated, on each side.
const AROUND: u64 = 2;

/// The samples around the chunks of an archive: of all, or of some that stand for all.
pub(in crate::pipeline) fn boxes_of_chunks<'a>(
    points: &'a PointSet,
    chunks: &'a ChunkGrid,
    halo: Halo,
) -> impl Iterator<Item = ReadBox> + use<'a> {
    let lattice = chunks.bricks().lattice;
    let domain = lattice.domain();
    let samples = move |b: &LatticeBox| {
        let voxel = |at: u32, a: usize| u64::from(at) >> lattice.log2_steps[a];
        let hi = std::array::from_fn(|a| (voxel(b.hi[a], a) + 1).min(lattice.dims[a]));
        IndexBox { lo: std::array::from_fn(|a| voxel(b.lo[a], a)), hi }
    };
    estimate::some_chunks(chunks).map(move |chunk| {
        let around = estimate::near(points, &chunk.core, &domain, halo);
        let IndexBox { lo, hi } = samples(&around);
        let hi = std::array::from_fn(|a| (hi[a] + AROUND).min(lattice.dims[a]));
        let around = IndexBox { lo: lo.map(|v| v.saturating_sub(AROUND)), hi };
        ReadBox { samples: around, own: samples(&chunk.core) }
    })
}

/// The chunks of a source that the boxes of a pass meet.
pub(in crate::pipeline) struct Met {
    shape: ChunkShape,
    /// Chunks along each axis that meet one of the boxes, at most.
    one: [u64; 3],
    /// The largest step from one box to the next, and the widest box along x.
    step: [u64; 3],
    width: u64,
    /// Whether rows decode chunks rarely enough.
    rows: bool,
}

impl Met {
    pub(in crate::pipeline) fn of(shape: &ChunkShape, boxes: impl Iterator<Item = ReadBox>) -> Self {
        let (dims, edge) = (shape.dims, shape.chunk);
        // How many times more samples the chunks hold than the box has itself, on average.
        let (mut one, mut step, mut more, mut count) = ([1u64; 3], [1u64; 3], [0.0; 3], 0.0);
        let mut width = 1;
        for ReadBox { samples, own } in boxes {
            for a in 0..3 {
                let met = samples.hi[a].div_ceil(edge[a]).saturating_sub(samples.lo[a] / edge[a]);
                let held = met.saturating_mul(edge[a]).min(dims[a]);
                (one[a], step[a]) = (one[a].max(met), step[a].max(own.dims()[a]));
                more[a] += held as f64 / own.dims()[a].max(1) as f64;
            }
            width = width.max(samples.dims()[0]);
            count += 1.0;
        }
        let rows = more[1] / count * (more[2] / count) <= MOST_DECODES;
        Self { shape: *shape, one, step, width, rows }
    }

    /// Useful sizes of a cache, from the largest to the least: for the chunks that meet two layers
    /// of boxes, a layer, two rows, a row. Rows have no size where they would decode chunks too
    /// often.
    pub(in crate::pipeline) fn sizes(&self) -> [Option<u64>; 4] {
        let (grid, one) = (self.shape.grid(), self.one);
        let next = |a: usize| self.step[a].div_ceil(self.shape.chunk[a]);
        let two: [u64; 3] = std::array::from_fn(|a| (one[a] + next(a)).min(grid[a]));
        let [x, y, _] = grid;
        let counts = [[x, y, two[2]], [x, y, one[2]], [x, two[1], one[2]], [x, one[1], one[2]]];
        std::array::from_fn(|n| (n < 2 || self.rows).then(|| self.shape.cached_bytes(counts[n])))
    }

    /// The size for the boxes of a row that so many workers are at, one after the other, and for
    /// the next one, which shares chunks with them.
    pub(in crate::pipeline) fn at_work(&self, workers: usize) -> Option<u64> {
        let steps = self.step[0].saturating_mul(workers as u64);
        let x =
            (self.width.saturating_add(steps).div_ceil(self.shape.chunk[0]) + 1).min(self.shape.grid()[0]);
        self.rows.then(|| self.shape.cached_bytes([x, self.one[1], self.one[2]]))
    }
}

/// A cache of decoded chunks for one pass over a source.
#[derive(Clone, Copy, Debug)]
pub(in crate::pipeline) struct ChunkCache {
    /// Bytes of decoded chunks in it.
    pub(in crate::pipeline) size: u64,
    /// All that it takes, decoding included.
    pub(in crate::pipeline) held: u64,
}

impl ChunkCache {
    /// The cache for a pass that reads these boxes and needs `least` bytes itself; `None` where the
    /// memory does not hold both, or the source has no chunks. The workers of the pass take one box
    /// after the other if `in_order`.
    pub(in crate::pipeline) fn fitting(
        source: &VolumeSource,
        boxes: impl Iterator<Item = ReadBox>,
        in_order: bool,
        least: u64,
        run: &RunSettings,
    ) -> Option<Self> {
        let VolumeSource::Chunked(chunks) = source else { return None };
        let shape = ChunkShape::of(&**chunks);
        let threads = run.resources.worker_threads();
        let decoding = shape.decoding_bytes.saturating_mul(threads as u64);
        let held = decoding.saturating_add(shape.shared_bytes());
        let (met, memory) = (Met::of(&shape, boxes), run.resources.memory);
        let at_work = if in_order { met.at_work(threads) } else { None };
        let caches = met.sizes().map(|size| (size, most_cached(memory)));
        let caches = caches.into_iter().chain([(at_work, most_at_work(memory))]);
        let sizes = caches.filter_map(|(size, most)| size.filter(|&size| size <= most));
        let mut caches = sizes.map(|size| Self { size, held: size.saturating_add(held) });
        let fits = |cache: &Self| cache.held.saturating_add(least) <= memory;
        caches.find(fits)
    }
}

/// Random access to a source. One of chunks is read through a cache of `cached` bytes of them.
/// Without that, it is copied into bricks, as a stream is. The copy is removed when the second
/// value is dropped.
pub(in crate::pipeline) fn random_access(
    source: VolumeSource,
    cached: Option<u64>,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<(Box<dyn VolumeReader>, Option<Scratch>)> {
    match (source, cached) {
        (VolumeSource::Random(reader), _) => Ok((reader, None)),
        (VolumeSource::Chunked(chunks), Some(size)) => Ok((Box::new(ChunkedVolume::new(chunks, size)), None)),
        (source, _) => copied(source, run, progress),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan_io::error::Error;
    use isospan_io::exec::Resources;
    use isospan_io::volume::VolumeInfo;
    use isospan_io::volume::chunked::ChunkSource;
    use isospan_io::volume::memory::info_of;
    use isospan_io::volume::{ScalarType, VolumeSource};
    use std::sync::Arc;

    /// 512 x 512 x 512 samples of u16 in chunks of 64 x 64 x 64.
    struct Made(VolumeInfo);

    impl ChunkSource for Made {
        fn info(&self) -> &VolumeInfo {
            &self.0
        }

        fn chunk_dims(&self) -> [u64; 3] {
            [64; 3]
        }

        fn decoding_bytes(&self) -> u64 {
            1 << 20
        }

        fn decode(&self, _: [u64; 3], _: &mut Vec<u8>) -> Result<()> {
            Err(Error::usage("not read"))
        }
    }

    fn made() -> VolumeSource {
        VolumeSource::Chunked(Arc::new(Made(info_of("made", [512; 3], ScalarType::U16))))
    }

    /// Boxes of `edge` samples along each axis, and 4 more on each side.
    fn boxes(edge: u64) -> impl Iterator<Item = ReadBox> {
        let places = move || (0..512).step_by(edge as usize);
        let all = places().flat_map(move |z| places().flat_map(move |y| places().map(move |x| [x, y, z])));
        all.map(move |lo: [u64; 3]| ReadBox {
            samples: IndexBox {
                lo: lo.map(|v| v.saturating_sub(4)),
                hi: lo.map(|v| (v + edge + 4).min(512)),
            },
            own: IndexBox { lo, hi: lo.map(|v| v + edge) },
        })
    }

    fn shape() -> ChunkShape {
        let VolumeSource::Chunked(chunks) = made() else { unreachable!("as it was made") };
        ChunkShape::of(&*chunks)
    }

    #[test]
    fn caches_hold_the_chunks_that_meet_layers_or_rows() {
        let bytes = |count| Some(shape().cached_bytes(count));
        assert!(bytes([1; 3]) > Some(64 * 64 * 64 * 2));
        // A box of 256 meets 5 chunks along each axis, and both meet 8.
        let all = [[8, 8, 8], [8, 8, 5], [8, 8, 5], [8, 5, 5]].map(bytes);
        assert_eq!(Met::of(&shape(), boxes(256)).sizes(), all);
        // Of a long row, the boxes that two workers are at, and the next one.
        let mut long = shape();
        long.dims[0] = 4096;
        let long = Met::of(&long, boxes(256));
        assert_eq!((long.sizes()[3], long.at_work(2)), (bytes([64, 5, 5]), bytes([14, 5, 5])));
        assert_eq!(long.at_work(100), long.sizes()[3]);
        // Small boxes in rows would decode a chunk again and again.
        let (layers, small) = ([[8, 8, 3], [8, 8, 2]].map(bytes), Met::of(&shape(), boxes(32)));
        assert_eq!(small.sizes(), [layers[0], layers[1], None, None]);
        assert_eq!(small.at_work(1), None);
    }

    #[test]
    fn a_cache_takes_a_quarter_of_the_memory_and_leaves_what_else_is_needed() {
        let resources = |memory| Resources::default().with_threads(2).with_memory(memory);
        let run = |memory| RunSettings { resources: resources(memory), ..RunSettings::default() };
        let cache = |least, memory| ChunkCache::fitting(&made(), boxes(256), false, least, &run(memory));
        let size = |memory| cache(0, memory).map(|c| c.size);
        let sizes = Met::of(&shape(), boxes(256)).sizes();
        let [layers, layer, rows, row] = sizes.map(|bytes| bytes.unwrap());
        assert_eq!((size(4 * layers), size(4 * layers - 1)), (Some(layers), Some(layer)));
        assert_eq!((size(4 * rows - 1), size(4 * row - 1)), (Some(row), None));
        let held = layers + (2 << 20);
        let with = |least| cache(least, 4 * layers);
        assert_eq!(with(4 * layers - held).map(|c| c.held), Some(held));
        assert_eq!(with(4 * layers - held + 1).map(|c| c.size), Some(layer));
        assert!(with(4 * layers).is_none());
    }
}
