//! The coefficients of a tile as bytes.
//!
//! All bands of one level over one box are a *tile*. It is decoded by itself, once its parent is
//! (the tile one level up over the same place). Each decision is coded with odds that depend on the
//! *energy* around it: magnitudes that are known already, near it in its band, at its place in the
//! parent's band, and in the bands of the tile before it.

use crate::error::{Error, Result};
use crate::model::{Model, Odd, UNARY, class, cost, step};
use crate::pyramid::{Band, Box3, GROUP, Pyramid};
use crate::quantise::{BACK, in_bounds, nearest, restored};
use crate::range_coder::{Coder, Decoder, Encoder};

/// Magnitudes count for at most this much in an energy.
const MOST: u8 = 15;
/// Weights of magnitudes in an energy: of the three coefficients just before along an axis, of the
/// six diagonally before, of the three two before along an axis, of the parent, of its six
/// neighbours, and of the bands before. From a regression on 17 volumes.
const NEAR: u32 = 13;
const DIAGONAL: u32 = 5;
const TWO: u32 = 4;
const PARENT: u32 = 2;
const AROUND: u32 = 1;
const BANDS: u32 = 3;
/// Groups whose parents have more energy than this are coded without a flag.
const QUIET: u32 = 24;
/// Edge of a group.
const EDGE: usize = 4;
/// What a bit is worth, in squared steps.
const BIT: f32 = 0.08;
/// Bits of the part of a magnitude that is not coded in unary, at most.
const LONGEST: u32 = 30;

/// A number and one before it have a sum whose magnitude is less than this.
const MOST_SUM: u32 = 1 << 30;

/// Which tile: its level and its place in the grid of that level's tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileId {
    /// The coarser one of the two levels that it is between.
    pub level: usize,
    /// Its place along x, y, z.
    pub at: [usize; 3],
}

/// All tiles of a level, in their order.
pub(crate) fn tiles_of(pyramid: &Pyramid, level: usize) -> impl Iterator<Item = TileId> + use<> {
    let [nx, ny, nz] = pyramid.tiles(level);
    (0..nx * ny * nz).map(move |i| TileId { level, at: [i % nx, i / nx % ny, i / nx / ny] })
}

/// Quantised coefficients of a tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Which one.
    pub id: TileId,
    /// Of each band of the level, in their order.
    pub parts: Vec<Part>,
}

/// Quantised coefficients of one band in a tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Where they are in the band.
    pub place: Box3,
    /// Multiples of the step, x fastest.
    pub numbers: Vec<i32>,
}

impl Tile {
    /// A tile of zeros.
    pub fn zero(pyramid: &Pyramid, id: TileId) -> Self {
        let part = |band: Band| {
            let place = pyramid.part(id.level, &band, id.at);
            Part { place, numbers: vec![0; place.len()] }
        };
        Self { id, parts: pyramid.bands(id.level).map(part).collect() }
    }

    /// Whether all coefficients are zero.
    pub fn is_zero(&self) -> bool {
        self.parts.iter().all(|p| p.numbers.iter().all(|n| *n == 0))
    }

    /// Quantises and encodes. `coefficients` are those of each band, in steps, as `numbers` lie. A
    /// coefficient becomes the nearest number or one of less magnitude, if that saves more bits
    /// than its error is worth. No bytes are a tile of zeros.
    ///
    /// `before` is the tile at the step of a series before, if it has other numbers than zeros.
    /// Then the tile may be stored as what changes, and no bytes are the tile before.
    pub fn encode(
        pyramid: &Pyramid,
        id: TileId,
        coefficients: &[Vec<f32>],
        parent: Option<&Self>,
        before: Option<&Self>,
    ) -> Result<(Self, Vec<u8>)> {
        let mut tile = Self::nearest(pyramid, id, coefficients)?;
        let Some(before) = before else {
            if tile.is_zero() {
                return Ok((tile, vec![]));
            }
            let mut encoder = Encoder::default();
            tile.walk(pyramid, parent, &mut Model::of(id.level), &mut encoder, Some(coefficients))?;
            // What was left may have been too little to be worth its bits.
            let bytes = if tile.is_zero() { vec![] } else { encoder.finish() };
            return Ok((tile, bytes));
        };
        let changed = tile.clone().encode_change(pyramid, coefficients, before)?;
        let mut encoder = Encoder::default();
        encoder.even(false);
        tile.walk(pyramid, parent, &mut Model::of(id.level), &mut encoder, Some(coefficients))?;
        let alone = (tile, encoder.finish());
        let price = |(tile, bytes): &(Self, Vec<u8>)| {
            tile.error(coefficients) + f64::from(BIT) * 8.0 * bytes.len() as f64
        };
        Ok(if price(&changed) < price(&alone) { changed } else { alone })
    }

    /// The nearest numbers.
    fn nearest(pyramid: &Pyramid, id: TileId, coefficients: &[Vec<f32>]) -> Result<Self> {
        let mut tile = Self::zero(pyramid, id);
        for (part, real) in tile.parts.iter_mut().zip(coefficients) {
            assert_eq!(part.numbers.len(), real.len(), "a coefficient for each number");
            for (number, c) in part.numbers.iter_mut().zip(real) {
                if !in_bounds(*c) {
                    return Err(Error::Damaged("a coefficient is out of bounds"));
                }
                *number = nearest(*c);
            }
        }
        Ok(tile)
    }

    /// Encodes what changes from the tile before, without a parent: where something moves, the
    /// changes of a coarser level say little.
    fn encode_change(
        mut self,
        pyramid: &Pyramid,
        coefficients: &[Vec<f32>],
        before: &Self,
    ) -> Result<(Self, Vec<u8>)> {
        let mut real = coefficients.to_vec();
        for ((part, real), old) in self.parts.iter_mut().zip(&mut real).zip(&before.parts) {
            for ((number, c), old) in part.numbers.iter_mut().zip(real).zip(&old.numbers) {
                *number -= old;
                *c -= restored(*old);
            }
        }
        let mut encoder = Encoder::default();
        encoder.even(true);
        self.walk(pyramid, None, &mut Model::of(self.id.level), &mut encoder, Some(&real))?;
        let bytes = if self.is_zero() { vec![] } else { encoder.finish() };
        self.add(before)?;
        Ok((self, bytes))
    }

    /// Adds the numbers of the tile before.
    fn add(&mut self, before: &Self) -> Result<()> {
        for (part, old) in self.parts.iter_mut().zip(&before.parts) {
            for (number, old) in part.numbers.iter_mut().zip(&old.numbers) {
                let sum = number.checked_add(*old).filter(|sum| sum.unsigned_abs() < MOST_SUM);
                *number = sum.ok_or(Error::Damaged("a coefficient is too large"))?;
            }
        }
        Ok(())
    }

    /// The sum of the squared differences to what it was made of, in squared steps.
    pub fn error(&self, coefficients: &[Vec<f32>]) -> f64 {
        let pairs =
            self.parts.iter().zip(coefficients).flat_map(|(part, real)| part.numbers.iter().zip(real));
        pairs.map(|(n, c)| f64::from(restored(*n) - c).powi(2)).sum()
    }

    /// Decodes what [`Tile::encode`] made, with the same parent and tile before.
    pub fn decode(
        pyramid: &Pyramid,
        id: TileId,
        bytes: &[u8],
        parent: Option<&Self>,
        before: Option<&Self>,
    ) -> Result<Self> {
        if bytes.is_empty() {
            return Ok(before.cloned().unwrap_or_else(|| Self::zero(pyramid, id)));
        }
        let (mut tile, mut decoder) = (Self::zero(pyramid, id), Decoder::new(bytes));
        let before = before.filter(|_| decoder.even(false));
        let parent = parent.filter(|_| before.is_none());
        tile.walk(pyramid, parent, &mut Model::of(id.level), &mut decoder, None)?;
        decoder.finish()?;
        before.map_or(Ok(()), |before| tile.add(before))?;
        Ok(tile)
    }

    /// Whether tiles of a level are parents of others.
    pub fn is_parent(pyramid: &Pyramid, level: usize) -> bool {
        level > 1 && Self::has_parent(pyramid, level - 1)
    }

    /// Whether tiles of a level have parents.
    pub fn has_parent(pyramid: &Pyramid, level: usize) -> bool {
        !level.is_multiple_of(GROUP) && level < pyramid.coarsest()
    }

    /// Codes all numbers, which the coder reads or writes.
    pub(crate) fn walk<C: Coder>(
        &mut self,
        pyramid: &Pyramid,
        parent: Option<&Self>,
        model: &mut Model,
        coder: &mut C,
        real: Option<&[Vec<f32>]>,
    ) -> Result<()> {
        let up = (self.id.level < pyramid.coarsest()).then(|| pyramid.split(self.id.level + 1));
        let mut before = Before::new(self.parts.iter().map(|p| p.place.size));
        for (at, (part, band)) in self.parts.iter_mut().zip(pyramid.bands(self.id.level)).enumerate() {
            if part.numbers.is_empty() {
                continue;
            }
            let above = band.has_parent.then_some(parent).flatten().and_then(|tile| {
                let up = up?;
                let their = pyramid.bands(self.id.level + 1).position(|b| b.high == band.high)?;
                Parents::new(&part.place, tile.parts.get(their)?, up)
            });
            let highs = band.high.iter().filter(|h| **h).count();
            let walk = BandWalk { part, before: &mut before, parents: above, real: real.map(|r| &r[at][..]) };
            walk.code(&mut model.sets[highs - 1], usize::from(band.has_parent), coder)?;
        }
        Ok(())
    }
}

/// Encodes numbers of a box by themselves, as a band without a parent. No bytes are zeros.
pub(crate) fn encode_numbers(place: Box3, numbers: Vec<i32>) -> Result<Vec<u8>> {
    if numbers.iter().all(|n| *n == 0) {
        return Ok(vec![]);
    }
    let mut coder = Encoder::default();
    walk_numbers(&mut Part { place, numbers }, &mut Odd::of_corrections(), &mut coder)?;
    Ok(coder.finish())
}

/// Decodes what [`encode_numbers`] made.
pub(crate) fn decode_numbers(place: Box3, bytes: &[u8]) -> Result<Part> {
    let mut part = Part { place, numbers: vec![0; place.len()] };
    if !bytes.is_empty() {
        let mut coder = Decoder::new(bytes);
        walk_numbers(&mut part, &mut Odd::of_corrections(), &mut coder)?;
        coder.finish()?;
    }
    Ok(part)
}

/// Codes the numbers of a box.
pub(crate) fn walk_numbers<C: Coder>(part: &mut Part, odds: &mut Odd, coder: &mut C) -> Result<()> {
    let mut before = Before::new([part.place.size].into_iter());
    BandWalk { part, before: &mut before, parents: None, real: None }.code(odds, 0, coder)
}

/// Sums of magnitudes of the bands that are coded, by place, and whether a group has any.
struct Before {
    size: [usize; 3],
    sums: Vec<u8>,
    groups: Vec<bool>,
    any: bool,
}

impl Before {
    fn new(sizes: impl Iterator<Item = [usize; 3]>) -> Self {
        let size = sizes.fold([0; 3], |most, s| std::array::from_fn(|a| most[a].max(s[a])));
        let groups = size.map(|n| n.div_ceil(EDGE));
        Self {
            size,
            sums: vec![0; size.iter().product()],
            groups: vec![false; groups.iter().product()],
            any: false,
        }
    }

    #[inline(always)]
    fn group(&self, [x, y, z]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.size.map(|n| n.div_ceil(EDGE));
        (z * ny + y) * nx + x
    }
}

/// The energy of the parents of a part.
struct Parents {
    energy: Vec<u16>,
    size: [usize; 3],
    shift: [u32; 3],
}

impl Parents {
    /// None if the parents are zeros.
    fn new(place: &Box3, parent: &Part, split: [bool; 3]) -> Option<Self> {
        let shift = split.map(u32::from);
        let theirs = &parent.place;
        if theirs.is_empty() || parent.numbers.iter().all(|n| *n == 0) {
            return None;
        }
        let first = |a: usize| ((place.start[a] >> shift[a]) - theirs.start[a]).min(theirs.size[a] - 1);
        let behind = |a: usize| {
            let last = ((place.end()[a] - 1) >> shift[a]) - theirs.start[a];
            last.min(theirs.size[a] - 1) + 1
        };
        let (start, end): ([usize; 3], [usize; 3]) = ([0, 1, 2].map(first), [0, 1, 2].map(behind));
        let [sx, sy, sz] = theirs.size;
        let magnitude = |i: usize| parent.numbers[i].unsigned_abs().min(u32::from(MOST));
        let mut energy = vec![];
        for z in start[2]..end[2] {
            for y in start[1]..end[1] {
                for x in start[0]..end[0] {
                    let i = (z * sy + y) * sx + x;
                    let mut around = 0;
                    for (at, n, stride) in [(x, sx, 1), (y, sy, sx), (z, sz, sx * sy)] {
                        around += if at > 0 { magnitude(i - stride) } else { 0 };
                        around += if at + 1 < n { magnitude(i + stride) } else { 0 };
                    }
                    energy.push((PARENT * magnitude(i) + AROUND * around) as u16);
                }
            }
        }
        Some(Self { energy, size: std::array::from_fn(|a| end[a] - start[a]), shift })
    }

    /// The energy for a place in the part.
    #[inline(always)]
    fn at(&self, at: [usize; 3]) -> u32 {
        let [x, y, z]: [usize; 3] = std::array::from_fn(|a| (at[a] >> self.shift[a]).min(self.size[a] - 1));
        u32::from(self.energy[(z * self.size[1] + y) * self.size[0] + x])
    }
}

/// The magnitudes of a band that are coded, with a margin of zeros.
struct Known {
    magnitudes: Vec<u8>,
    row: usize,
    layer: usize,
}

impl Known {
    const MARGIN: usize = 2;

    fn new([x, y, z]: [usize; 3]) -> Self {
        let row = x + 2 * Self::MARGIN;
        let layer = row * (y + 2 * Self::MARGIN);
        Self { magnitudes: vec![0; layer * (z + Self::MARGIN)], row, layer }
    }

    #[inline(always)]
    fn place(&self, [x, y, z]: [usize; 3]) -> usize {
        (z + Self::MARGIN) * self.layer + (y + Self::MARGIN) * self.row + x + Self::MARGIN
    }

    #[inline(always)]
    fn energy(&self, at: usize) -> u32 {
        let (row, layer) = (self.row, self.layer);
        let known = &self.magnitudes[at - 2 * layer..at];
        let back = |n: usize| u32::from(known[2 * layer - n]);
        let near = back(1) + back(row) + back(layer);
        let on_diagonals = back(row + 1) + back(row - 1) + back(layer + 1) + back(layer - 1);
        let diagonal = on_diagonals + back(layer + row) + back(layer - row);
        NEAR * near + DIAGONAL * diagonal + TWO * (back(2) + back(2 * row) + back(2 * layer))
    }
}

struct BandWalk<'a> {
    part: &'a mut Part,
    before: &'a mut Before,
    parents: Option<Parents>,
    /// Coefficients in steps, where numbers may be made less.
    real: Option<&'a [f32]>,
}

impl BandWalk<'_> {
    fn code<C: Coder>(mut self, odds: &mut Odd, has_parent: usize, coder: &mut C) -> Result<()> {
        let any = C::ENCODES && self.part.numbers.iter().any(|n| *n != 0);
        if !coder.bit(&mut odds.band[has_parent], any) {
            return Ok(());
        }
        let size = self.part.place.size;
        let mut known = Known::new(size);
        let groups = size.map(|n| n.div_ceil(EDGE));
        // Whether a group has any, with a margin of groups before the first.
        let (row, layer) = (groups[0] + 1, (groups[0] + 1) * (groups[1] + 1));
        let mut have = vec![false; layer * (groups[2] + 1)];
        for z in 0..groups[2] {
            for y in 0..groups[1] {
                for x in 0..groups[0] {
                    let at = (z + 1) * layer + (y + 1) * row + x + 1;
                    let beside = have[at - 1] || have[at - row] || have[at - layer];
                    have[at] = self.group([x, y, z], beside, odds, &mut known, coder)?;
                }
            }
        }
        self.done(&known);
        Ok(())
    }

    /// The corners of a group.
    #[inline(always)]
    fn corners(&self, group: [usize; 3]) -> [std::ops::Range<usize>; 3] {
        let size = self.part.place.size;
        std::array::from_fn(|a| EDGE * group[a]..(EDGE * (group[a] + 1)).min(size[a]))
    }

    /// Codes a group; returns whether it has any coefficient but zeros.
    #[inline(always)]
    fn group<C: Coder>(
        &mut self,
        group: [usize; 3],
        beside: bool,
        odds: &mut Odd,
        known: &mut Known,
        coder: &mut C,
    ) -> Result<bool> {
        let [xs, ys, zs] = self.corners(group);
        let size = self.part.place.size;
        let above = match &self.parents {
            Some(parents) if !beside => {
                let mut sum = 0;
                for z in zs.clone().step_by(2) {
                    for y in ys.clone().step_by(2) {
                        sum += xs.clone().step_by(2).map(|x| parents.at([x, y, z])).sum::<u32>();
                    }
                }
                sum
            }
            _ => 0,
        };
        let flagged = !beside && above <= QUIET;
        if flagged {
            let any = C::ENCODES && {
                let row = |z: usize, y: usize| (z * size[1] + y) * size[0];
                let none = |z, y| self.part.numbers[row(z, y)..][xs.clone()].iter().all(|n| *n == 0);
                !zs.clone().all(|z| ys.clone().all(|y| none(z, y)))
            };
            let others = self.before.groups[self.before.group(group)];
            let at = 2 * usize::from(others) + usize::from(above > 0);
            if !coder.bit(&mut odds.group[at], any) {
                return Ok(false);
            }
        }
        let mut found = false;
        for z in zs {
            for y in ys.clone() {
                let (mut at, mut place) =
                    ((z * size[1] + y) * size[0] + xs.start, known.place([xs.start, y, z]));
                for x in xs.clone() {
                    let kind = if !flagged { 2 } else { usize::from(!found) };
                    let energy = known.energy(place) + self.energy_elsewhere([x, y, z]);
                    let magnitude = self.number(at, kind, class(energy), odds, coder)?;
                    if magnitude > 0 {
                        found = true;
                        known.magnitudes[place] = magnitude.min(u32::from(MOST)) as u8;
                    }
                    (at, place) = (at + 1, place + 1);
                }
            }
        }
        Ok(found)
    }

    /// The energy of the parent and of the bands before.
    #[inline(always)]
    fn energy_elsewhere(&self, at @ [x, y, z]: [usize; 3]) -> u32 {
        let above = self.parents.as_ref().map_or(0, |p| p.at(at));
        let beside = match self.before.any {
            true => self.before.sums[(z * self.before.size[1] + y) * self.before.size[0] + x],
            false => 0,
        };
        above + BANDS * u32::from(beside)
    }

    /// Codes a number; returns its magnitude.
    #[inline(always)]
    fn number<C: Coder>(
        &mut self,
        at: usize,
        kind: usize,
        class: usize,
        odds: &mut Odd,
        coder: &mut C,
    ) -> Result<u32> {
        let mut number = self.part.numbers[at];
        if let Some(real) = self.real
            && number != 0
        {
            number = cheaper(number, real[at].abs(), kind, class, odds);
            self.part.numbers[at] = number;
        }
        if !coder.bit(&mut odds.other[kind][class], number != 0) {
            return Ok(0);
        }
        let negative = coder.even(number < 0);
        let magnitude = coded_magnitude(number.unsigned_abs(), class, odds, coder)?;
        if !C::ENCODES {
            self.part.numbers[at] = if negative { -(magnitude as i32) } else { magnitude as i32 };
        }
        Ok(magnitude)
    }

    /// The bands that follow know this one.
    fn done(&mut self, known: &Known) {
        let size = self.part.place.size;
        self.before.any = true;
        for z in 0..size[2] {
            for y in 0..size[1] {
                let from = &known.magnitudes[known.place([0, y, z])..][..size[0]];
                let to = (z * self.before.size[1] + y) * self.before.size[0];
                for (x, magnitude) in from.iter().enumerate().filter(|(_, m)| **m > 0) {
                    self.before.sums[to + x] += magnitude;
                    let group = self.before.group([x, y, z].map(|i| i / EDGE));
                    self.before.groups[group] = true;
                }
            }
        }
    }
}

/// A magnitude of at least 1.
#[inline(always)]
fn coded_magnitude<C: Coder>(wanted: u32, class: usize, odds: &mut Odd, coder: &mut C) -> Result<u32> {
    let mut magnitude = 1;
    while magnitude <= UNARY {
        if !coder.bit(&mut odds.larger[step(magnitude)][class], wanted > magnitude) {
            return Ok(magnitude);
        }
        magnitude += 1;
    }
    // The rest, plus 1, as an Exp-Golomb code: a one for each bit below the highest, a zero, those
    // bits.
    let rest = wanted.wrapping_sub(magnitude).wrapping_add(1);
    let bits = rest.max(1).ilog2();
    let mut more = 0;
    while coder.even(more < bits) {
        more += 1;
        if more >= LONGEST {
            return Err(Error::Damaged("a coefficient is too large"));
        }
    }
    let mut read = 1;
    for bit in (0..more).rev() {
        read = read << 1 | u32::from(coder.even(rest >> bit & 1 == 1));
    }
    Ok(magnitude + read - 1)
}

/// The number, or the one below it in magnitude, or zero: that with the least error and cost.
#[inline(always)]
fn cheaper(number: i32, real: f32, kind: usize, class: usize, odds: &Odd) -> i32 {
    let magnitude = number.unsigned_abs();
    let zero = real * real + BIT * cost(odds.other[kind][class], false);
    let not_zero = cost(odds.other[kind][class], true) + 1.0;
    // Bits of a magnitude and of one less have those up to it in common.
    let larger = |m: u32, bit: bool| match m {
        1..=UNARY => cost(odds.larger[step(m)][class], bit),
        _ => 0.0,
    };
    let common: f32 = (1..magnitude.min(UNARY + 1).saturating_sub(1)).map(|m| larger(m, true)).sum();
    let error = |m: u32| (real - (m as f32 + BACK)) * (real - (m as f32 + BACK));
    let this = if magnitude > 1 { larger(magnitude - 1, true) } else { 0.0 } + larger(magnitude, false);
    let this = error(magnitude) + BIT * (not_zero + common + this);
    let mut best = (this, magnitude);
    if magnitude > 1 {
        let less = error(magnitude - 1) + BIT * (not_zero + common + larger(magnitude - 1, false));
        if less < best.0 {
            best = (less, magnitude - 1);
        }
    }
    if magnitude < 4 && zero < best.0 {
        best = (zero, 0);
    }
    best.1 as i32 * number.signum()
}
