//! A compressed array, of which each level, or a box of it, is decoded alone.

use std::collections::HashMap;

use crate::correct::{self, Correction};
use crate::encode::{HEADER, MAGIC};
use crate::error::{Error, Result};
use crate::lengths::Lengths;
use crate::pyramid::{Box3, Pyramid, TILE};
use crate::quantise::Scale;
use crate::refilter::{REACH, each_row, refilter};
use crate::tile::{Part, Tile, TileId, decode_numbers, tiles_of};
use crate::top::decode_top;
use crate::transform::{MARGIN, Scratch, Window};

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
        let mut tiles = Tiles::default();
        for id in tiles_of(&self.pyramid, level) {
            let tile = self.tile(id, &mut tiles)?.clone();
            let up = TileId { level: level + 1, at: self.pyramid.parent(level, id.at) };
            tell(tile, tiles.get(&up))?;
        }
        Ok(())
    }

    /// All nodes of a level, x fastest; of level 0 these are its samples.
    pub fn level(&self, level: usize) -> Result<Vec<f32>> {
        self.check(level)?;
        self.nodes(level, &Box3::all(self.pyramid.nodes(level)))
    }

    /// The nodes of a level in a box: the same bits as [`Compressed::level`] has there. What lies
    /// elsewhere is not decoded.
    pub fn nodes(&self, level: usize, wanted: &Box3) -> Result<Vec<f32>> {
        self.check(level)?;
        let nodes = self.pyramid.nodes(level);
        let all = Box3::all(nodes);
        if wanted.is_empty() || wanted.cut(&all) != *wanted {
            return Err(Error::Box { level, nodes });
        }
        let values = match level {
            0 => self.low(0, wanted, &mut Tiles::default())?,
            _ => {
                let around = wanted.widened(REACH).cut(&all);
                let low = self.low(level, &around, &mut Tiles::default())?;
                refilter(&self.pyramid, level, &around, low, wanted)
            }
        };
        let mut values: Vec<f32> = values.into_iter().map(|v| self.scale.leave(v) as f32).collect();
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
            let numbers = decode_numbers(*place, bytes)?.numbers;
            let (mut from, mut to) = (vec![], vec![]);
            each_row(place, &here, |at| from.push(at));
            each_row(wanted, &here, |at| to.push(at));
            for (from, to) in from.into_iter().zip(to) {
                let numbers = &numbers[from..from + here.size[0]];
                for (sample, number) in samples[to..to + here.size[0]].iter_mut().zip(numbers) {
                    *sample = self.correction.correct(*sample, *number);
                }
            }
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

    fn check(&self, level: usize) -> Result<()> {
        let coarsest = self.pyramid.coarsest();
        if level > coarsest { Err(Error::Level { level, coarsest }) } else { Ok(()) }
    }

    /// Low coefficients of a level in a box: the transform undone, coarsest level first.
    fn low(&self, level: usize, wanted: &Box3, tiles: &mut Tiles) -> Result<Vec<f32>> {
        let p = &self.pyramid;
        let mut found = Vec::with_capacity(wanted.len());
        if level == p.coarsest() {
            let place = Box3::all(p.nodes(level));
            each_row(&place, wanted, |at| {
                let row = &self.top[at..at + wanted.size[0]];
                found.extend(row.iter().map(|n| self.scale.restored(*n)));
            });
            return Ok(found);
        }
        let split = p.split(level + 1);
        let window = wanted.around(split, MARGIN).cut(&Box3::all(p.nodes(level)));
        let mut work = Window { place: window, samples: vec![0.0; window.len()] };
        let low = window.halved(split);
        work.put_band(&[split], [false; 3], &low, &self.low(level + 1, &low, tiles)?);
        self.details(level + 1, &mut work, tiles)?;
        work.inverse(&[split], &mut Scratch::default());
        each_row(&window, wanted, |at| found.extend_from_slice(&work.samples[at..at + wanted.size[0]]));
        Ok(found)
    }

    /// The coefficients between a level and the finer one, into a window of the finer one.
    fn details(&self, level: usize, work: &mut Window, tiles: &mut Tiles) -> Result<()> {
        let p = &self.pyramid;
        // Of the finer level, some tiles may have parents here; no others are asked for again.
        let are_parents = level > 1 && Tile::has_parent(p, level - 1);
        let first = work.place.start.map(|s| s / TILE);
        let last = work.place.end().map(|e| (e - 1) / TILE);
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let id = TileId { level, at: [x, y, z] };
                    if self.places.contains_key(&id) {
                        let tile = self.tile(id, tiles)?;
                        work.put_tile(p, tile, |n| self.scale.restored(n));
                        if !are_parents {
                            tiles.remove(&id);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// A decoded tile; its parents are decoded first.
    fn tile<'t>(&self, id: TileId, tiles: &'t mut Tiles) -> Result<&'t Tile> {
        if !tiles.contains_key(&id) {
            let p = &self.pyramid;
            let up = TileId { level: id.level + 1, at: p.parent(id.level, id.at) };
            if Tile::has_parent(p, id.level) && self.places.contains_key(&up) {
                self.tile(up, tiles)?;
            }
            let bytes = self.places.get(&id).copied().unwrap_or_default();
            let tile = Tile::decode(p, id, bytes, tiles.get(&up))?;
            tiles.insert(id, tile);
        }
        Ok(&tiles[&id])
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

/// Tiles that are decoded.
type Tiles = HashMap<TileId, Tile>;
