//! Nodes of a level in a box, from tiles that are found when they are needed.

use std::sync::Arc;

use crate::error::Error;
use crate::pyramid::{Box3, Pyramid, TILE};
use crate::quantise::Scale;
use crate::refilter::{REACH, refilter};
use crate::tile::{Tile, TileId};
use crate::transform::{MARGIN, Scratch, Window};

/// Where decoded tiles come from.
pub trait TileSource {
    /// What may go wrong.
    type Error: From<Error>;

    /// A tile, or none if all its coefficients are zero.
    fn tile(&mut self, id: TileId) -> Result<Option<Arc<Tile>>, Self::Error>;

    /// The tile at the step of a series before that tiles may refer to; none if there is no such
    /// step, or all its coefficients are zero.
    fn before(&mut self, _id: TileId) -> Result<Option<Arc<Tile>>, Self::Error> {
        Ok(None)
    }

    /// Tells that a tile is used, and is not asked for again for the same box.
    fn used(&mut self, _id: TileId) {}

    /// A vector for so many nodes: one that was given back, where there is one. What is in it is
    /// overwritten.
    fn room(&mut self, nodes: usize) -> Vec<f32> {
        Vec::with_capacity(nodes)
    }

    /// Takes a vector of nodes that is no longer needed.
    fn give_back(&mut self, _room: Vec<f32>) {}
}

/// There is no step before.
#[derive(Clone, Copy, Debug)]
pub struct NoTiles;

impl TileSource for NoTiles {
    type Error = Error;

    fn tile(&mut self, _: TileId) -> Result<Option<Arc<Tile>>, Error> {
        Ok(None)
    }
}

/// The levels of an array whose tiles are elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct Levels<'a> {
    /// Which levels there are.
    pub pyramid: &'a Pyramid,
    /// What coefficients stand for.
    pub scale: &'a Scale,
    /// The numbers of the coarsest level.
    pub top: &'a [i32],
}

impl Levels<'_> {
    /// The nodes of a level in a box, x fastest: the same bits for any box that has them. Samples
    /// are those of level 0, without corrections.
    pub fn nodes<S: TileSource>(
        &self,
        level: usize,
        wanted: &Box3,
        tiles: &mut S,
    ) -> Result<Vec<f32>, S::Error> {
        let coarsest = self.pyramid.coarsest();
        if level > coarsest {
            return Err(Error::Level { level, coarsest }.into());
        }
        let nodes = self.pyramid.nodes(level);
        let all = Box3::all(nodes);
        if wanted.is_empty() || wanted.cut(&all) != *wanted {
            return Err(Error::Box { level, nodes }.into());
        }
        let mut values = match level {
            0 => self.low(0, wanted, tiles)?,
            _ => {
                let around = wanted.widened(REACH).cut(&all);
                let low = self.low(level, &around, tiles)?;
                refilter(self.pyramid, level, &around, low, wanted)
            }
        };
        values.iter_mut().for_each(|v| *v = self.scale.leave(*v) as f32);
        Ok(values)
    }

    /// Low coefficients of a level in a box: the transform undone, coarsest level first.
    fn low<S: TileSource>(&self, level: usize, wanted: &Box3, tiles: &mut S) -> Result<Vec<f32>, S::Error> {
        let p = self.pyramid;
        if level == p.coarsest() {
            let numbers = Box3::all(p.nodes(level)).values_of(self.top, wanted);
            return Ok(numbers.into_iter().map(|n| self.scale.restored(n)).collect());
        }
        let split = p.split(level + 1);
        let window = wanted.around(split, MARGIN).cut(&Box3::all(p.nodes(level)));
        let mut samples = tiles.room(window.len());
        samples.clear();
        samples.resize(window.len(), 0.0);
        let mut work = Window { place: window, samples };
        let low = window.halved(split);
        let of_low = self.low(level + 1, &low, tiles)?;
        work.put_band(&[split], [false; 3], &low, &of_low);
        tiles.give_back(of_low);
        self.details(level + 1, &mut work, tiles)?;
        work.inverse(&[split], &mut Scratch::default());
        window.crop(&mut work.samples, wanted);
        Ok(work.samples)
    }

    /// The coefficients between a level and the finer one, into a window of the finer one.
    fn details<S: TileSource>(&self, level: usize, work: &mut Window, tiles: &mut S) -> Result<(), S::Error> {
        let p = self.pyramid;
        // Of the finer level, some tiles may have parents here; no others are asked for again.
        let are_parents = Tile::is_parent(p, level);
        let first = work.place.start.map(|s| s / TILE);
        let last = work.place.end().map(|e| (e - 1) / TILE);
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let id = TileId { level, at: [x, y, z] };
                    if let Some(tile) = tiles.tile(id)? {
                        work.put_tile(p, &tile, |n| self.scale.restored(n));
                        if !are_parents {
                            tiles.used(id);
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

/// Decodes a tile of some bytes, or none of zeros. Its parent is asked for where it has one, and
/// the tile before.
///
/// # Errors
/// [`Error::Damaged`], and those of finding the parent.
pub fn decode_tile<S: TileSource>(
    pyramid: &Pyramid,
    id: TileId,
    bytes: Option<&[u8]>,
    source: &mut S,
) -> std::result::Result<Option<Arc<Tile>>, S::Error> {
    let before = source.before(id)?;
    let Some(bytes) = bytes else { return Ok(before) };
    let parent = match Tile::has_parent(pyramid, id.level) {
        true => source.tile(TileId { level: id.level + 1, at: pyramid.parent(id.level, id.at) })?,
        false => None,
    };
    let tile = Tile::decode(pyramid, id, bytes, parent.as_deref(), before.as_deref())?;
    Ok(Some(Arc::new(tile)).filter(|tile| !tile.is_zero()))
}
