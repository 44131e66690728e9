//! Arrays in parts: what does not fit in memory is written and read chunk by chunk.
//!
//! A *chunk* has the tiles of the first three levels over a box of samples; they and their parents
//! depend on no other chunk. What is left, the low coefficients of the last of these levels, is one
//! array for all chunks, of at most 1/512 of the samples where all axes are split. Its levels are
//! the *coarse* ones.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use crate::error::{Error, Result};
use crate::lengths::{Lengths, encode_lengths};
use crate::levels::{TileSource, decode_tile};
use crate::pyramid::{Box3, GROUP, Pyramid, TILE};
use crate::quantise::Scale;
use crate::tile::{Tile, TileId, tiles_of};
use crate::top::decode_top;
use crate::transform::{HALO, Scratch, Window};
use crate::whole::{Encoded, encode_levels};

/// Samples along each axis of a chunk; the last one has one more where the array ends with it.
pub const CHUNK: usize = 256;
/// Samples along each axis of the parts in which a chunk can be made, at least.
pub const PART: usize = TILE << (GROUP - 1);
/// Tiles along each axis of a block, at most.
const BLOCK: usize = 4;

/// Tiles of one level that are stored together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileBlock {
    /// The coarser one of the two levels that the tiles are between; 0 of tiles of labels.
    pub level: usize,
    /// The tiles.
    pub tiles: Box3,
}

impl TileBlock {
    /// Its tiles, in the order in which they are stored.
    pub fn ids(&self) -> impl Iterator<Item = TileId> + use<> {
        let Self { level, tiles: Box3 { start, size: [nx, ny, nz] } } = *self;
        (0..nx * ny * nz).map(move |i| {
            let at = [i % nx, i / nx % ny, i / nx / ny];
            TileId { level, at: std::array::from_fn(|a| start[a] + at[a]) }
        })
    }

    /// The bytes of its tiles, where only some have any.
    fn bytes(&self, tiles: &HashMap<TileId, Vec<u8>>) -> Vec<u8> {
        let of = |id| tiles.get(&id).map_or(&[][..], |bytes| bytes);
        if self.ids().all(|id| of(id).is_empty()) {
            return vec![];
        }
        let lengths: Vec<u32> = self.ids().map(|id| of(id).len() as u32).collect();
        let lengths = encode_lengths(&lengths);
        let mut out = (lengths.len() as u32).to_le_bytes().to_vec();
        out.extend(lengths);
        self.ids().for_each(|id| out.extend_from_slice(of(id)));
        out
    }

    /// Where the tiles are in the bytes of the block that have some. No bytes are tiles of zeros.
    ///
    /// # Errors
    /// [`Error::Damaged`].
    pub fn places(&self, bytes: &[u8]) -> Result<Vec<(TileId, Range<usize>)>> {
        if bytes.is_empty() {
            return Ok(vec![]);
        }
        let short = Error::Damaged("a block of tiles ends early");
        let (of_lengths, rest) = bytes.split_first_chunk().ok_or(short.clone())?;
        let of_lengths = u32::from_le_bytes(*of_lengths) as usize;
        let (lengths, _) = rest.split_at_checked(of_lengths).ok_or(short.clone())?;
        let (mut lengths, mut at, mut found) = (Lengths::new(lengths), 4 + of_lengths, vec![]);
        for id in self.ids() {
            let length = lengths.next()? as usize;
            let end = at.checked_add(length).filter(|end| *end <= bytes.len()).ok_or(short.clone())?;
            if length > 0 {
                found.push((id, at..end));
            }
            at = end;
        }
        lengths.finish()?;
        if at == bytes.len() { Ok(found) } else { Err(Error::Damaged("bytes behind the last tile")) }
    }
}

impl Pyramid {
    /// Levels whose tiles are in chunks.
    pub fn details(&self) -> usize {
        self.coarsest().min(GROUP)
    }

    /// Chunks along each axis.
    pub fn chunks(&self) -> [usize; 3] {
        self.nodes(0).map(|n| (n - 1).div_ceil(CHUNK).max(1))
    }

    /// The samples of a chunk.
    pub fn chunk(&self, at: [usize; 3]) -> Box3 {
        let (dims, chunks) = (self.nodes(0), self.chunks());
        let start = at.map(|c| CHUNK * c);
        let end = |a: usize| if at[a] + 1 == chunks[a] { dims[a] } else { start[a] + CHUNK };
        Box3 { start, size: std::array::from_fn(|a| end(a) - start[a]) }
    }

    /// The parts in which a chunk is made: boxes of samples of `edge` along each axis, a multiple
    /// of [`PART`]; the last ones as the chunk ends.
    pub fn parts(&self, chunk: [usize; 3], edge: usize) -> Vec<Box3> {
        let all = self.chunk(chunk);
        let ends = self.nodes(0);
        // Of one more sample than a multiple, the last is in a tile of its own, but in no part.
        let counts = all.size.map(|n| (n - 1).div_ceil(edge).max(1));
        let part = |i: usize| {
            let at = [i % counts[0], i / counts[0] % counts[1], i / counts[0] / counts[1]];
            let start: [usize; 3] = std::array::from_fn(|a| all.start[a] + edge * at[a]);
            let end = |a: usize| {
                if at[a] + 1 == counts[a] { all.end()[a].min(ends[a]) } else { start[a] + edge }
            };
            Box3 { start, size: [0, 1, 2].map(|a| end(a) - start[a]) }
        };
        (0..counts.iter().product()).map(part).collect()
    }

    /// The samples that a part is made of.
    pub fn window(&self, part: &Box3) -> Box3 {
        let stride = 1 << GROUP;
        let wide = part.widened(HALO).cut(&Box3::all(self.nodes(0)));
        let start = wide.start.map(|s| s / stride * stride);
        Box3 { start, size: std::array::from_fn(|a| wide.end()[a] - start[a]) }
    }

    /// Where the low coefficients of a part or a chunk are among those of the coarse levels.
    pub fn low_box(&self, part: &Box3) -> Box3 {
        let details = self.details();
        let (stride, nodes, dims) = (self.stride(details), self.nodes(details), self.nodes(0));
        let start: [usize; 3] = std::array::from_fn(|a| part.start[a] / stride[a]);
        let end = |a: usize| if part.end()[a] == dims[a] { nodes[a] } else { part.end()[a] / stride[a] };
        Box3 { start, size: std::array::from_fn(|a| end(a) - start[a]) }
    }

    /// The tiles of labels of a part or a chunk.
    pub fn label_tiles(&self, part: &Box3) -> impl Iterator<Item = TileId> + use<> {
        TileBlock { level: 0, tiles: self.tiles_over(0, part) }.ids()
    }

    /// The tiles of a level over a box of samples that begins and ends between tiles, or where the
    /// array ends.
    fn tiles_over(&self, level: usize, place: &Box3) -> Box3 {
        let (stride, tiles, dims) = (self.stride(level.saturating_sub(1)), self.tiles(level), self.nodes(0));
        let start: [usize; 3] = std::array::from_fn(|a| place.start[a] / (TILE * stride[a]));
        let end = |a: usize| match place.end()[a] {
            end if end == dims[a] => tiles[a],
            end => end / (TILE * stride[a]),
        };
        Box3 { start, size: std::array::from_fn(|a| end(a) - start[a]) }
    }

    /// The blocks of tiles of a chunk, in the order in which they are stored: coarse ones first. An
    /// array of labels has tiles of these.
    pub fn blocks(&self, chunk: [usize; 3]) -> Vec<TileBlock> {
        let place = self.chunk(chunk);
        let mut blocks = vec![];
        let first = usize::from(!self.has_labels());
        for level in (first..=self.details()).rev() {
            let all = self.tiles_over(level, &place);
            // A tile of one layer at the end of the array is stored with those before it.
            let counts = all.size.map(|n| (n - 1).max(1).div_ceil(BLOCK));
            for i in 0..counts.iter().product() {
                let at = [i % counts[0], i / counts[0] % counts[1], i / counts[0] / counts[1]];
                let start = |a: usize| all.start[a] + BLOCK * at[a];
                let end = |a: usize| if at[a] + 1 == counts[a] { all.end()[a] } else { start(a) + BLOCK };
                let tiles = Box3 { start: [0, 1, 2].map(start), size: [0, 1, 2].map(|a| end(a) - start(a)) };
                blocks.push(TileBlock { level, tiles });
            }
        }
        blocks
    }

    /// The number of the block of a chunk that has a tile, and the block.
    ///
    /// # Panics
    /// When the tile is not in the chunk.
    pub fn block_of(&self, chunk: [usize; 3], id: TileId) -> (usize, TileBlock) {
        let here = |block: &(usize, TileBlock)| {
            let Box3 { start, .. } = block.1.tiles;
            let end = block.1.tiles.end();
            block.1.level == id.level && (0..3).all(|a| (start[a]..end[a]).contains(&id.at[a]))
        };
        self.blocks(chunk).into_iter().enumerate().find(here).unwrap_or_else(|| panic!("a tile of the chunk"))
    }

    /// The chunk that has a tile of the first levels, or of labels.
    pub fn chunk_of(&self, id: TileId) -> [usize; 3] {
        let (stride, chunks) = (self.stride(id.level.saturating_sub(1)), self.chunks());
        std::array::from_fn(|a| (id.at[a] * TILE * stride[a] / CHUNK).min(chunks[a] - 1))
    }
}

/// What a part of an array becomes.
#[derive(Debug, Default)]
pub struct PartTiles {
    /// The bytes of its tiles that have any.
    pub tiles: HashMap<TileId, Vec<u8>>,
    /// Its low coefficients, x fastest, in [`Pyramid::low_box`].
    pub low: Vec<f32>,
}

/// Encodes a part. `samples` are those of [`Pyramid::window`], as [`Scale::enter`] makes them.
/// `before` has the tiles of the step of a series before, which has the same step of coefficients.
///
/// # Errors
/// [`Error::Step`] for a step that is too small, and those of finding tiles.
pub fn encode_part<S: TileSource>(
    pyramid: &Pyramid,
    scale: &Scale,
    part: &Box3,
    samples: Vec<f32>,
    before: &mut S,
) -> std::result::Result<PartTiles, S::Error> {
    let details = pyramid.details();
    let mut window = Window { place: pyramid.window(part), samples };
    window.forward(&pyramid.splits()[..details], &mut Scratch::default());
    let largest = window.samples.iter().fold(0.0, |most: f32, c| most.max(c.abs()));
    scale.expect_numbers_of(largest)?;
    let (mut made, mut above) = (PartTiles::default(), HashMap::new());
    for level in (1..=details).rev() {
        let mut here = HashMap::new();
        for id in (TileBlock { level, tiles: pyramid.tiles_over(level, part) }).ids() {
            let coefficients = window.tile(pyramid, 0, id, |c| scale.in_steps(c));
            let (parent, before) = (above.get(&pyramid.parent(level, id.at)), before.tile(id)?);
            let (tile, bytes) = Tile::encode(pyramid, id, &coefficients, parent, before.as_deref())?;
            if !bytes.is_empty() {
                made.tiles.insert(id, bytes);
            }
            // Tiles of the first level are no parents.
            if level > 1 {
                here.insert(id.at, tile);
            }
        }
        above = here;
    }
    made.low = window.band(&pyramid.splits()[..details], [false; 3], &pyramid.low_box(part));
    Ok(made)
}

/// The blocks of a chunk, of the tiles of all its parts.
pub fn blocks_of(pyramid: &Pyramid, chunk: [usize; 3], tiles: &HashMap<TileId, Vec<u8>>) -> Vec<Vec<u8>> {
    pyramid.blocks(chunk).iter().map(|block| block.bytes(tiles)).collect()
}

/// The coarse levels, encoded.
#[derive(Clone, Debug)]
pub struct Coarse {
    top: Vec<i32>,
    bytes: Vec<u8>,
    places: HashMap<TileId, Range<usize>>,
}

impl Coarse {
    /// Encodes the low coefficients of all chunks, x fastest. `before` is as in [`encode_part`].
    ///
    /// # Errors
    /// [`Error::Step`] for a step that is too small, and those of finding tiles.
    pub fn encode<S: TileSource>(
        pyramid: &Pyramid,
        scale: &Scale,
        low: Vec<f32>,
        before: &mut S,
    ) -> std::result::Result<Vec<u8>, S::Error> {
        let from = pyramid.details();
        let mut window = Window { place: Box3::all(pyramid.nodes(from)), samples: low };
        window.forward(&pyramid.splits()[from..], &mut Scratch::default());
        let Encoded { top, lengths, tiles, .. } = encode_levels(&window, pyramid, from, scale, before)?;
        let lengths = encode_lengths(&lengths);
        let mut out = (top.len() as u32).to_le_bytes().to_vec();
        out.extend((lengths.len() as u32).to_le_bytes());
        [&top, &lengths, &tiles].into_iter().for_each(|part| out.extend_from_slice(part));
        Ok(out)
    }

    /// Reads what [`Coarse::encode`] made.
    ///
    /// # Errors
    /// [`Error::Damaged`].
    pub fn new(pyramid: &Pyramid, bytes: Vec<u8>) -> Result<Self> {
        let short = Error::Damaged("the coarse levels end early");
        let (head, rest) = bytes.split_first_chunk::<8>().ok_or(short.clone())?;
        let [of_top, of_lengths] = [0, 4]
            .map(|at| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]) as usize);
        let (top, rest) = rest.split_at_checked(of_top).ok_or(short.clone())?;
        let (lengths, _) = rest.split_at_checked(of_lengths).ok_or(short.clone())?;
        let top = decode_top(top, pyramid.nodes(pyramid.coarsest()))?;
        let (mut lengths, mut at, mut places) =
            (Lengths::new(lengths), 8 + of_top + of_lengths, HashMap::new());
        for level in (pyramid.details() + 1..=pyramid.coarsest()).rev() {
            for id in tiles_of(pyramid, level) {
                let length = lengths.next()? as usize;
                let end = at.checked_add(length).filter(|end| *end <= bytes.len()).ok_or(short.clone())?;
                if length > 0 {
                    places.insert(id, at..end);
                }
                at = end;
            }
        }
        lengths.finish()?;
        match at == bytes.len() {
            true => Ok(Self { top, bytes, places }),
            false => Err(Error::Damaged("bytes behind the coarse levels")),
        }
    }

    /// The numbers of the coarsest level.
    pub fn top(&self) -> &[i32] {
        &self.top
    }

    /// A tile of the coarse levels, or none if all its coefficients are zero. Its parent is asked
    /// for where it has one, and the tile before.
    ///
    /// # Errors
    /// [`Error::Damaged`], and those of finding the parent.
    pub fn tile<S: TileSource>(
        &self,
        pyramid: &Pyramid,
        id: TileId,
        source: &mut S,
    ) -> std::result::Result<Option<Arc<Tile>>, S::Error> {
        let bytes = self.places.get(&id).map(|place| &self.bytes[place.clone()]);
        decode_tile(pyramid, id, bytes, source)
    }
}
