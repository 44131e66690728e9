//! A whole array in memory as bytes, of which each level, or a box of it, can be decoded alone.

use std::collections::HashMap;

use crate::correct::{self, Correction};
use crate::delay::{boxes, choose_delay};
use crate::error::{Error, Result};
use crate::pyramid::{Box3, Pyramid};
use crate::quantise::Scale;
use crate::range_coder::{Coder, Decoder, Encoder, Odds};
use crate::refilter::{REACH, each_row, refilter};
use crate::tile::{Part, Tile, TileId, decode_numbers, encode_numbers};
use crate::top::{decode_top, encode_top};
use crate::transform::{MARGIN, Scratch, Window};

const MAGIC: &[u8; 8] = b"isowave1";
/// Bytes before the lengths of tiles: magic, u32 sizes, u8 delays, a zero, f64 least and largest
/// sample, i32 exponent, f32 step, u32 bytes of the coarsest level, u32 bytes of lengths.
const HEADER: usize = 56;
/// Samples that an array may have.
const MOST: usize = 1 << 40;

/// How much a compressed array may differ from its samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Accuracy {
    /// What neighbouring values of a coefficient differ by, in units of the samples. The RMS error is
    /// about a fifth of it in smooth data, less where most coefficients are zero, more in noise.
    Step(f64),
    /// The RMS error over all samples at most, in their units. It is met, by at most a twentieth
    /// less, in two to four tries.
    Rms(f64),
    /// The error of each sample at most, in their units. Samples that are farther off are corrected.
    Max(f64),
    /// No error of samples that are whole numbers of at most 2^24.
    Lossless,
}

/// What is asked of [`compress`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The step, or the error.
    pub accuracy: Accuracy,
    /// Levels by which the splits of each axis begin later: see [`Pyramid::new`]. `None` tries which
    /// serves best, on a part of the samples: [`choose_delay`].
    pub delay: Option<[u8; 3]>,
}

/// Samples of a box of an array.
fn cut(samples: &[f32], dims: [usize; 3], part: &Box3) -> Vec<f32> {
    let mut found = Vec::with_capacity(part.len());
    each_row(&Box3::all(dims), part, |at| found.extend_from_slice(&samples[at..at + part.size[0]]));
    found
}

fn tiles_of(pyramid: &Pyramid, level: usize) -> impl Iterator<Item = TileId> + use<> {
    let [nx, ny, nz] = pyramid.tiles(level);
    (0..nx * ny * nz).map(move |i| TileId { level, at: [i % nx, i / nx % ny, i / nx / ny] })
}

/// Compresses an array of samples, x fastest.
pub fn compress(samples: &[f32], dims: [usize; 3], settings: &Settings) -> Result<Vec<u8>> {
    let wanted = dims.iter().try_fold(1_usize, |n, d| n.checked_mul(*d));
    let sizes_fit = dims.iter().all(|d| u32::try_from(*d).is_ok());
    if samples.is_empty() || samples.len() > MOST || wanted != Some(samples.len()) || !sizes_fit {
        return Err(Error::Size { dims, samples: samples.len() });
    }
    if let Some(index) = samples.iter().position(|s| !s.is_finite()) {
        return Err(Error::NotFinite { index });
    }
    let range = samples.iter().fold([f64::MAX, f64::MIN], |[low, high], s| {
        let s = f64::from(*s);
        [low.min(s), high.max(s)]
    });
    let correction = match settings.accuracy {
        Accuracy::Max(bound) => Correction::within(bound, range)?,
        Accuracy::Lossless => Correction::lossless(samples)?,
        Accuracy::Step(_) | Accuracy::Rms(_) => Correction::None,
    };
    // The scale is that of any step.
    let mut scale = match settings.accuracy {
        Accuracy::Step(step) => Scale::new(range, step)?,
        Accuracy::Rms(error) => Scale::new(range, error)?,
        Accuracy::Max(bound) => Scale::near(range, STEPS[1] * bound)?,
        Accuracy::Lossless => Scale::near(range, STEPS[1] * HALF)?,
    };
    let mut transformed = Transformed::new(samples, dims, &scale, settings.delay.unwrap_or_default());
    if settings.delay.is_none() {
        if let Accuracy::Rms(error) = settings.accuracy {
            scale = Scale::new(range, transformed.guess(range, error)?)?;
        }
        let tried: Vec<_> = boxes(dims).iter().map(|b| (cut(samples, dims, b), b.size)).collect();
        let delay = choose_delay(&tried, &scale)?;
        if delay != transformed.delay {
            transformed = Transformed::new(samples, dims, &scale, delay);
        }
    }
    match settings.accuracy {
        Accuracy::Step(_) => Ok(transformed.encode(&scale)?.bytes(&transformed, &scale)),
        Accuracy::Rms(error) => transformed.search(samples, range, error),
        Accuracy::Max(bound) => transformed.bounded(samples, &scale, correction, bound),
        Accuracy::Lossless => transformed.bounded(samples, &scale, correction, HALF),
    }
}

/// Steps that are tried under a bound, in bounds: with fewer corrections, and with less before them.
const STEPS: [f64; 3] = [2.0, 3.0, 4.5];
/// The bound of whole numbers, before they are rounded.
const HALF: f64 = 0.5;

/// What an encoder made.
struct Encoded {
    top: Vec<u8>,
    /// Bytes of each tile.
    lengths: Vec<u32>,
    tiles: Vec<u8>,
    /// The sum of the squared errors of coefficients, in squared steps.
    error: f64,
    /// How samples are corrected; the corrections are in the last tiles.
    correction: Correction,
}

impl Encoded {
    /// The whole array.
    fn bytes(&self, of: &Transformed, scale: &Scale) -> Vec<u8> {
        let lengths = encode_lengths(&self.lengths);
        let mut out = MAGIC.to_vec();
        of.pyramid.nodes(0).iter().for_each(|d| out.extend((*d as u32).to_le_bytes()));
        out.extend(of.delay);
        out.push(match self.correction {
            Correction::None => 0,
            Correction::Quanta(_) => 1,
            Correction::Whole => 2,
        });
        scale.range.iter().for_each(|r| out.extend(r.to_le_bytes()));
        out.extend(scale.exponent.to_le_bytes());
        out.extend(scale.step.to_le_bytes());
        out.extend((self.top.len() as u32).to_le_bytes());
        out.extend((lengths.len() as u32).to_le_bytes());
        if let Correction::Quanta(quantum) = self.correction {
            out.extend(quantum.to_le_bytes());
        }
        [&out, &self.top, &lengths, &self.tiles].into_iter().flatten().copied().collect()
    }
}

/// What a whole array takes with a step and a delay, with the worth of a bit in squared steps, as
/// bits. Errors are those of the coefficients.
pub(crate) fn price(
    samples: &[f32],
    dims: [usize; 3],
    scale: &Scale,
    delay: [u8; 3],
    bit: f64,
) -> Result<f64> {
    let made = Transformed::new(samples, dims, scale, delay).encode(scale)?;
    Ok(8.0 * (made.top.len() + made.tiles.len()) as f64 + made.error / bit)
}

/// The coefficients of a whole array.
struct Transformed {
    pyramid: Pyramid,
    delay: [u8; 3],
    window: Window,
}

impl Transformed {
    fn new(samples: &[f32], dims: [usize; 3], scale: &Scale, delay: [u8; 3]) -> Self {
        let pyramid = Pyramid::new(dims, delay);
        let entered = samples.iter().map(|s| scale.enter(f64::from(*s))).collect();
        let mut window = Window { place: Box3::all(dims), samples: entered };
        window.forward(pyramid.splits(), &mut Scratch::default());
        Self { pyramid, delay, window }
    }

    /// The bytes with the largest step that meets an RMS error, nearly.
    fn search(&self, samples: &[f32], range: [f64; 2], target: f64) -> Result<Vec<u8>> {
        /// Steps are accepted that use this much of the error.
        const USED: f64 = 0.95;
        const TRIES: usize = 6;
        let mut step = self.guess(range, target)?;
        let mut best: Option<(f64, Vec<u8>)> = None;
        for tried in 0.. {
            let scale = Scale::new(range, step)?;
            let bytes = self.encode(&scale)?.bytes(self, &scale);
            let back = Compressed::new(&bytes, samples.len())?.level(0)?;
            let errors = samples.iter().zip(&back).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
            let used = (errors.sum::<f64>() / samples.len() as f64).sqrt() / target;
            if used <= 1.0 && best.as_ref().is_none_or(|(s, _)| *s < step) {
                best = Some((step, bytes));
            }
            let enough = (USED..=1.0).contains(&used) || tried + 1 >= TRIES;
            if enough && let Some((_, bytes)) = best {
                return Ok(bytes);
            }
            // A step that misses in the end is halved until it does not, or is too small.
            let aim = if tried < TRIES { 0.98 / used.max(0.2) } else { 0.5 };
            step *= aim.min(2.5);
        }
        unreachable!("the loop ends by what it returns")
    }

    /// The step with which coefficients have an error, as if those below 0.8 steps became zero.
    fn guess(&self, range: [f64; 2], target: f64) -> Result<f64> {
        let every = (self.window.samples.len() >> 18) + 1;
        let unit = Scale::new(range, target)?;
        let target = f64::from(unit.step);
        let error = |step: f64| {
            let lost = |c: &f32| match f64::from(c.abs()) / step {
                c if c < 0.8 => c * c,
                c => (c - c.round()).powi(2),
            };
            let some = self.window.samples.iter().step_by(every);
            let n = some.len() as f64;
            step * (some.map(lost).sum::<f64>() / n).sqrt()
        };
        let (mut low, mut high) = (target, 64.0 * target);
        for _ in 0..12 {
            let middle = (low * high).sqrt();
            *(if error(middle) < target { &mut low } else { &mut high }) = middle;
        }
        Ok(unit.in_samples(low as f32))
    }

    /// The fewest bytes with which no corrected sample is off by more than a bound. The scale has the
    /// second of the steps.
    fn bounded(&self, samples: &[f32], scale: &Scale, by: Correction, bound: f64) -> Result<Vec<u8>> {
        let dims = self.pyramid.nodes(0);
        let mut best: Option<Vec<u8>> = None;
        for part in STEPS {
            let scale = Scale::near(scale.range, scale.in_samples(scale.step) * part / STEPS[1])?;
            let mut made = self.encode(&scale)?;
            let back = Compressed::new(&made.bytes(self, &scale), samples.len())?.level(0)?;
            made.correction = by;
            for place in correct::boxes(dims) {
                let pairs = cut(samples, dims, &place).into_iter().zip(cut(&back, dims, &place));
                let numbers = pairs.map(|(sample, back)| by.number(sample, back, bound)).collect();
                let bytes = encode_numbers(place, numbers)?;
                made.lengths.push(bytes.len() as u32);
                made.tiles.extend(bytes);
            }
            let bytes = made.bytes(self, &scale);
            if best.as_ref().is_none_or(|b| bytes.len() < b.len()) {
                best = Some(bytes);
            }
        }
        best.ok_or(Error::Damaged("there is no step to try"))
    }

    fn encode(&self, scale: &Scale) -> Result<Encoded> {
        let p = &self.pyramid;
        let size = p.nodes(p.coarsest());
        let low = self.window.band(p.splits(), [false; 3], &Box3::all(size));
        let low = low.into_iter().map(|c| scale.nearest(c)).collect::<Result<Vec<i32>>>()?;
        let top = encode_top(&low, size);
        let (mut lengths, mut tiles, mut error) = (vec![], vec![], 0.0);
        let mut above = HashMap::new();
        for level in (1..=p.coarsest()).rev() {
            let mut made = HashMap::new();
            for id in tiles_of(p, level) {
                let coefficients = self.window.tile(p, id, |c| scale.in_steps(c));
                let parent = above.get(&p.parent(level, id.at));
                let (tile, bytes) = Tile::encode(p, id, &coefficients, parent)?;
                lengths.push(bytes.len() as u32);
                tiles.extend(bytes);
                error += tile.error(&coefficients);
                made.insert(id.at, tile);
            }
            above = made;
        }
        Ok(Encoded { top, lengths, tiles, error, correction: Correction::None })
    }
}

/// An array that [`compress`] made, to be decoded in parts.
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
        lengths.decoder.finish()?;
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
    pub fn each_tile(
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
        let first = work.place.start.map(|s| s / crate::pyramid::TILE);
        let last = work.place.end().map(|e| (e - 1) / crate::pyramid::TILE);
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let id = TileId { level, at: [x, y, z] };
                    if self.places.contains_key(&id) {
                        let tile = self.tile(id, tiles)?;
                        work.put_tile(p, tile, |n| self.scale.restored(n));
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
            let parent = match Tile::has_parent(p, id.level) && self.places.contains_key(&up) {
                true => Some(self.tile(up, tiles)?.clone()),
                false => None,
            };
            let bytes = self.places.get(&id).copied().unwrap_or_default();
            tiles.insert(id, Tile::decode(p, id, bytes, parent.as_ref())?);
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

/// Odds of the number of bits of a length: after no bytes, and after some.
type LengthOdds = [[Odds; 33]; 2];

fn length<C: Coder>(wanted: u32, before: usize, odds: &mut LengthOdds, coder: &mut C) -> Result<u32> {
    let bits = 32 - wanted.leading_zeros() as usize;
    let mut read = 0;
    while coder.bit(&mut odds[before.min(1)][read], bits > read) {
        read += 1;
        if read > 32 {
            return Err(Error::Damaged("a length is too large"));
        }
    }
    let mut value = u32::from(read > 0);
    for bit in (0..read.saturating_sub(1)).rev() {
        value = value << 1 | u32::from(coder.even(wanted >> bit & 1 == 1));
    }
    Ok(value)
}

fn encode_lengths(lengths: &[u32]) -> Vec<u8> {
    let (mut coder, mut odds, mut before) = (Encoder::default(), [[Odds::new(1 << 15); 33]; 2], 0);
    for wanted in lengths {
        length(*wanted, before, &mut odds, &mut coder).unwrap_or_else(|_| unreachable!());
        before = *wanted as usize;
    }
    coder.finish()
}

struct Lengths<'a> {
    decoder: Decoder<'a>,
    odds: LengthOdds,
    before: usize,
}

impl<'a> Lengths<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { decoder: Decoder::new(bytes), odds: [[Odds::new(1 << 15); 33]; 2], before: 0 }
    }

    fn next(&mut self) -> Result<u32> {
        let length = length(0, self.before, &mut self.odds, &mut self.decoder)?;
        self.before = length as usize;
        Ok(length)
    }
}
