//! A compressed array, of which each level, or a box of it, is decoded alone.

use std::collections::HashMap;
use std::sync::Arc;

use crate::correct::{self, Correction};
use crate::error::{Error, Result};
use crate::lengths::Lengths;
use crate::levels::{Levels, TileSource, decode_tile};
use crate::pyramid::{Box3, Pyramid};
use crate::quantise::Scale;
use crate::tile::{Part, Tile, TileId, decode_numbers, tiles_of};
use crate::top::decode_top;
use crate::whole::{HEADER, MAGIC};

/// An array that [`compress`](crate::compress) made, to be decoded in parts.
#[derive(Clone, Debug)]
pub struct Compressed<'a> {
    delay: [u8; 3],
    pyramid: Pyramid,
    scale: Scale,
    top: Vec<i32>,
    /// The bytes of tiles that have any.
    places: HashMap<TileId, &'a [u8]>,
    correction: Correction,
    /// Those of boxes of corrections.
    corrections: Vec<(Box3, &'a [u8])>,
}

impl<'a> Compressed<'a> {
    /// Reads the header and the lengths of tiles of an array with at most `most` samples. Damaged
    /// bytes are an error here or when they are decoded, or other samples.
    pub fn new(bytes: &'a [u8], most: usize) -> Result<Self> {
        let damaged = Error::Damaged;
        let (header, rest) = bytes.split_at_checked(HEADER).ok_or(damaged("there is no whole header"))?;
        if !header.starts_with(MAGIC) {
            return Err(damaged("this is no compressed array"));
        }
        let (correction, rest) = correction(header[23], rest)?;
        let u32_at =
            |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
        let dims = [8, 12, 16].map(|at| u32_at(at) as usize);
        let samples = dims.iter().try_fold(1_usize, |n, d| n.checked_mul(*d)).unwrap_or(usize::MAX);
        if samples == 0 || samples > most {
            return Err(Error::Size { dims, samples: most });
        }
        let f64_at = |at: usize| f64::from_bits(u64::from(u32_at(at)) | u64::from(u32_at(at + 4)) << 32);
        let range = [f64_at(24), f64_at(32)];
        let scale =
            Scale { range, exponent: u32_at(40) as i32, step: f32::from_bits(u32_at(44)) }.checked()?;
        if range.iter().any(|r| !(*r as f32).is_finite()) {
            return Err(damaged("the range is beyond f32"));
        }
        let delay = [header[20], header[21], header[22]];
        let pyramid = Pyramid::new(dims, delay);
        let (of_top, of_lengths) = (u32_at(48) as usize, u32_at(52) as usize);
        let (top, rest) = rest.split_at_checked(of_top).ok_or(damaged("it ends in the coarsest level"))?;
        let (lengths, mut rest) =
            rest.split_at_checked(of_lengths).ok_or(damaged("it ends in the lengths"))?;
        let top = decode_top(top, pyramid.nodes(pyramid.coarsest()))?;
        let mut lengths = Lengths::new(lengths);
        let mut places = HashMap::new();
        for id in (1..=pyramid.coarsest()).rev().flat_map(|level| tiles_of(&pyramid, level)) {
            let (tile, behind) =
                rest.split_at_checked(lengths.next()? as usize).ok_or(damaged("it ends in a tile"))?;
            rest = behind;
            if !tile.is_empty() {
                places.insert(id, tile);
            }
        }
        let mut corrections = vec![];
        for place in correct::boxes(dims).filter(|_| correction != Correction::None) {
            let (numbers, behind) = rest
                .split_at_checked(lengths.next()? as usize)
                .ok_or(damaged("it ends in the corrections"))?;
            rest = behind;
            if !numbers.is_empty() {
                corrections.push((place, numbers));
            }
        }
        lengths.finish()?;
        match rest.is_empty() {
            true => Ok(Self { delay, pyramid, scale, top, places, correction, corrections }),
            false => Err(damaged("bytes behind the last tile")),
        }
    }

    /// Its levels.
    pub fn pyramid(&self) -> &Pyramid {
        &self.pyramid
    }

    /// What neighbouring values of a coefficient differ by, in units of the samples.
    pub fn step(&self) -> f64 {
        self.scale.in_samples(self.scale.step)
    }

    /// Levels by which the splits of each axis begin later.
    pub fn delay(&self) -> [u8; 3] {
        self.delay
    }

    /// Calls with each tile of a level and its parent.
    pub(crate) fn each_tile(
        &self,
        level: usize,
        mut tell: impl FnMut(Tile, Option<&Tile>) -> Result<()>,
    ) -> Result<()> {
        let mut tiles = Decoded::of(self);
        for id in tiles_of(&self.pyramid, level) {
            let tile = tiles.tile(id)?.map_or_else(|| Tile::zero(&self.pyramid, id), |tile| (*tile).clone());
            let up = TileId { level: level + 1, at: self.pyramid.parent(level, id.at) };
            tell(tile, tiles.known.get(&up).map(|tile| &**tile))?;
        }
        Ok(())
    }

    /// All nodes of a level, x fastest; of level 0 these are its samples.
    pub fn level(&self, level: usize) -> Result<Vec<f32>> {
        let coarsest = self.pyramid.coarsest();
        match level <= coarsest {
            true => self.nodes(level, &Box3::all(self.pyramid.nodes(level))),
            false => Err(Error::Level { level, coarsest }),
        }
    }

    /// The nodes of a level in a box: the same bits as [`Compressed::level`] has there. What lies
    /// elsewhere is not decoded.
    pub fn nodes(&self, level: usize, wanted: &Box3) -> Result<Vec<f32>> {
        let levels = Levels { pyramid: &self.pyramid, scale: &self.scale, top: &self.top };
        let mut values = levels.nodes(level, wanted, &mut Decoded::of(self))?;
        if level == 0 {
            self.correct(&mut values, wanted)?;
        }
        Ok(values)
    }

    /// Corrects the samples of a box.
    fn correct(&self, samples: &mut [f32], wanted: &Box3) -> Result<()> {
        if self.correction == Correction::Whole {
            samples.iter_mut().for_each(|s| *s = self.correction.correct(*s, 0));
        }
        for (place, bytes) in &self.corrections {
            let here = place.cut(wanted);
            if here.is_empty() {
                continue;
            }
            let numbers = place.values_of(&decode_numbers(*place, bytes)?.numbers, &here);
            let mut rows = numbers.chunks(here.size[0]);
            wanted.each_row(&here, |at| {
                for (sample, number) in samples[at..].iter_mut().zip(rows.next().unwrap_or_default()) {
                    *sample = self.correction.correct(*sample, *number);
                }
            });
        }
        match samples.iter().all(|s| s.is_finite()) {
            true => Ok(()),
            false => Err(Error::Damaged("a corrected sample is infinite")),
        }
    }

    /// Calls with the corrections of each box that has some.
    pub(crate) fn each_correction(&self, mut tell: impl FnMut(&mut Part) -> Result<()>) -> Result<()> {
        self.corrections.iter().try_for_each(|(place, bytes)| tell(&mut decode_numbers(*place, bytes)?))
    }
}

/// How samples are corrected, and what follows.
fn correction(kind: u8, rest: &[u8]) -> Result<(Correction, &[u8])> {
    match kind {
        0 => Ok((Correction::None, rest)),
        1 => {
            let (quantum, rest) = rest.split_first_chunk().ok_or(Error::Damaged("it ends in the quantum"))?;
            let quantum = f64::from_le_bytes(*quantum);
            match quantum.is_finite() && quantum > 0.0 {
                true => Ok((Correction::Quanta(quantum), rest)),
                false => Err(Error::Damaged("the quantum of corrections is none")),
            }
        }
        2 => Ok((Correction::Whole, rest)),
        _ => Err(Error::Damaged("corrections of a kind that is not known")),
    }
}

/// The tiles of an array, decoded when they are asked for.
struct Decoded<'t, 'a> {
    of: &'t Compressed<'a>,
    known: HashMap<TileId, Arc<Tile>>,
}

impl<'t, 'a> Decoded<'t, 'a> {
    fn of(of: &'t Compressed<'a>) -> Self {
        Self { of, known: HashMap::new() }
    }
}

impl TileSource for Decoded<'_, '_> {
    type Error = Error;

    fn tile(&mut self, id: TileId) -> Result<Option<Arc<Tile>>> {
        if let Some(known) = self.known.get(&id) {
            return Ok(Some(Arc::clone(known)));
        }
        let (p, bytes) = (&self.of.pyramid, self.of.places.get(&id).copied());
        let Some(tile) = decode_tile(p, id, bytes, self)? else { return Ok(None) };
        self.known.insert(id, Arc::clone(&tile));
        Ok(Some(tile))
    }

    fn used(&mut self, id: TileId) {
        self.known.remove(&id);
    }
}
