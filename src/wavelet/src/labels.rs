//! Labels: whole numbers that are names, of which none is between two others.
//!
//! Nothing is transformed: a tile has the labels of 32³ nodes, and decodes alone. A node mostly has
//! the label of a neighbour. So its labels are tried, the one of most neighbours first; a bit says
//! whether it is that one. Odds depend on which neighbours have the label.
//!
//! ```text
//!  plane before      this plane        nine neighbours, of which those beside the node count twice
//!  . b .             d c e
//!  b B b             L ?               a label that no neighbour has is one of the tile's palette,
//!  . b .                               by how lately it was needed, or a new one, as a number
//! ```
//!
//! A row begins with one bit where all rows around it have one label: whether it has that, too. So
//! what is all one label costs next to nothing.
//!
//! It takes 40 to 60 ns a node each way, and 180 where labels have few nodes each. See `FORMAT.md`.

use crate::error::{Error, Result};
use crate::pyramid::TILE;
use crate::range_coder::{Coder, Decoder, Encoder, Odds};

/// Largest magnitude of a label: `f32` has all whole numbers up to it.
pub const MOST_LABEL: i32 = 1 << 24;

/// Labels of a tile that are remembered, at most.
const MOST_REMEMBERED: usize = 1024;
/// Neighbours whose labels are tried.
const NEIGHBOURS: usize = 9;
/// How much each of them counts: those beside the node are the first three.
const WEIGHTS: [u8; NEIGHBOURS] = [2, 2, 2, 1, 1, 1, 1, 1, 1];
/// What all of them count together.
const MOST_WEIGHT: usize = 12;
/// Sets of neighbours.
const SETS: usize = 1 << NEIGHBOURS;

/// Odds to begin with, by what neighbours with the label count together: of the label that is tried
/// first, of the second, of further ones. They are means over volumes of brains, neurons and cells.
const TRIED: [[u16; MOST_WEIGHT]; 3] = [
    [32_768, 60_900, 20_400, 20_300, 29_000, 46_600, 43_800, 49_700, 49_300, 56_900, 63_000, 65_286],
    [49_400, 52_700, 48_500, 46_600, 59_000, 61_700, 61_700, 61_700, 61_700, 61_700, 61_700, 61_700],
    [43_200, 50_000, 54_100, 60_000, 60_000, 60_000, 60_000, 60_000, 60_000, 60_000, 60_000, 60_000],
];
/// Of rows that are as the rows around them: at the first plane or row, and elsewhere.
const ALIKE: [u16; 2] = [60_000, 63_500];

const fn initial() -> [[Odds; SETS]; 3] {
    let mut odds = [[Odds::new(0); SETS]; 3];
    let mut set = 1;
    while set < SETS {
        let (mut weight, mut n) = (0, 0);
        while n < NEIGHBOURS {
            weight += if set >> n & 1 == 1 { WEIGHTS[n] as usize } else { 0 };
            n += 1;
        }
        let mut rank = 0;
        while rank < 3 {
            odds[rank][set] = Odds::new(TRIED[rank][weight - 1]);
            rank += 1;
        }
        set += 1;
    }
    odds
}

static INITIAL: [[Odds; SETS]; 3] = initial();

/// What a tile has learned so far.
struct Model {
    tried: [[Odds; SETS]; 3],
    alike: [Odds; 2],
    is_new: Odds,
    /// Bits of the place in the palette.
    place: [Odds; 11],
    /// Bits of the difference to the new label before, and its sign.
    bits: [Odds; BITS],
    sign: Odds,
    /// Labels, those that were needed lately first.
    palette: Vec<i32>,
    /// The new label before.
    last: i32,
}

/// Bits of a difference of labels, at most.
const BITS: usize = 26;

impl Model {
    fn new() -> Self {
        let even = Odds::new(1 << 15);
        Self {
            tried: INITIAL,
            alike: ALIKE.map(Odds::new),
            is_new: even,
            place: [even; 11],
            bits: [even; BITS],
            sign: even,
            palette: vec![],
            last: 0,
        }
    }

    /// A label that no neighbour has.
    fn other<C: Coder>(&mut self, wanted: i32, coder: &mut C) -> Result<i32> {
        let known = if C::ENCODES { self.palette.iter().position(|l| *l == wanted) } else { None };
        let is_new = self.palette.is_empty() || coder.bit(&mut self.is_new, known.is_none());
        let label = if is_new {
            self.palette.truncate(MOST_REMEMBERED - 1);
            self.new_label(wanted, coder)?
        } else {
            let place = self.place(known.unwrap_or(0), coder)?;
            self.palette.remove(place)
        };
        self.palette.insert(0, label);
        Ok(label)
    }

    /// A place in the palette: of the place plus one, how many bits it has in unary, then those
    /// below the highest.
    fn place<C: Coder>(&mut self, wanted: usize, coder: &mut C) -> Result<usize> {
        let (wanted, mut more) = (wanted + 1, 0);
        while more < self.place.len() && coder.bit(&mut self.place[more], wanted >> (more + 1) > 0) {
            more += 1;
        }
        let mut found = 1;
        for bit in (0..more).rev() {
            found = found << 1 | usize::from(coder.even(wanted >> bit & 1 == 1));
        }
        match found <= self.palette.len() {
            true => Ok(found - 1),
            false => Err(Error::Damaged("a label is not in the palette of its tile")),
        }
    }

    /// A label as its difference to the new one before.
    fn new_label<C: Coder>(&mut self, wanted: i32, coder: &mut C) -> Result<i32> {
        let difference = wanted.wrapping_sub(self.last);
        let size = difference.unsigned_abs();
        let length = 32 - size.leading_zeros() as usize;
        let mut bits = 0;
        while bits < BITS && coder.bit(&mut self.bits[bits], length > bits) {
            bits += 1;
        }
        let mut found = i32::from(bits > 0);
        for bit in (0..bits.saturating_sub(1)).rev() {
            found = found << 1 | i32::from(coder.even(size >> bit & 1 == 1));
        }
        let is_less = bits > 0 && coder.bit(&mut self.sign, difference < 0);
        let label = self.last + if is_less { -found } else { found };
        if label.abs() > MOST_LABEL {
            return Err(Error::Damaged("a label is beyond 2^24"));
        }
        self.last = label;
        Ok(label)
    }

    /// A label of which neighbours have these.
    fn node<C: Coder>(&mut self, wanted: i32, around: &[i32; NEIGHBOURS], coder: &mut C) -> Result<i32> {
        if around.iter().all(|label| *label == around[0]) {
            let odds = &mut self.tried[0][SETS - 1];
            return if coder.bit(odds, wanted == around[0]) {
                Ok(around[0])
            } else {
                self.other(wanted, coder)
            };
        }
        let (sets, mut weights) = sets_of(around);
        for rank in 0.. {
            // The first one of those that count most.
            let (mut best, mut most) = (0, 0);
            for (n, weight) in weights.iter().enumerate() {
                if *weight > most {
                    (best, most) = (n, *weight);
                }
            }
            if most == 0 {
                break;
            }
            if coder.bit(&mut self.tried[rank.min(2)][sets[best]], wanted == around[best]) {
                return Ok(around[best]);
            }
            weights[best] = 0;
        }
        self.other(wanted, coder)
    }
}

/// Which neighbours have the label of each, and what these count; 0 where an earlier one has it.
fn sets_of(around: &[i32; NEIGHBOURS]) -> ([usize; NEIGHBOURS], [u8; NEIGHBOURS]) {
    let (mut sets, mut weights) = ([0; NEIGHBOURS], [0; NEIGHBOURS]);
    let mut seen = 0;
    for n in 0..NEIGHBOURS {
        if seen >> n & 1 == 1 {
            continue;
        }
        for m in n..NEIGHBOURS {
            if around[m] == around[n] {
                sets[n] |= 1 << m;
                weights[n] += WEIGHTS[m];
            }
        }
        seen |= sets[n];
    }
    (sets, weights)
}

/// The rows that are known around a row, as places of their first nodes: the one before it in its
/// plane, and in the plane before the one beside it, the one before and the one after that. Where
/// the tile has no such row, another stands for it. None around the first row of all.
fn rows_around([nx, ny, _]: [usize; 3], y: usize, z: usize) -> Option<[usize; 4]> {
    let row = |y: usize, z: usize| (z * ny + y) * nx;
    match (y, z) {
        (0, 0) => None,
        (y, 0) => Some([row(y - 1, 0); 4]),
        (y, z) => {
            let behind = row(y, z - 1);
            let before = if y > 0 { row(y - 1, z) } else { behind };
            Some([before, behind, row(y.saturating_sub(1), z - 1), row((y + 1).min(ny - 1), z - 1)])
        }
    }
}

/// Codes all labels of a tile, x fastest.
fn walk<C: Coder>(labels: &mut [i32], size: [usize; 3], coder: &mut C) -> Result<()> {
    let mut model = Model::new();
    let is_one = C::ENCODES && labels.iter().all(|label| *label == labels[0]);
    if coder.even(is_one) {
        let label = model.new_label(labels[0], coder)?;
        labels.fill(label);
        return Ok(());
    }
    let [nx, ny, nz] = size;
    // The rows that have one label, of this plane and of the one before.
    let mut one_label = vec![false; ny * nz];
    for (n, (y, z)) in (0..nz).flat_map(|z| (0..ny).map(move |y| (y, z))).enumerate() {
        let (known, rest) = labels.split_at_mut(n * nx);
        let row = &mut rest[..nx];
        let Some(around) = rows_around(size, y, z) else {
            first_row(row, &mut model, coder)?;
            one_label[n] = row.iter().all(|label| *label == row[0]);
            continue;
        };
        let label = known[around[0]];
        if around.iter().all(|at| one_label[at / nx] && known[*at] == label) {
            let is_alike = C::ENCODES && row.iter().all(|l| *l == label);
            if coder.bit(&mut model.alike[usize::from(y > 0 && z > 0)], is_alike) {
                row.fill(label);
                one_label[n] = true;
                continue;
            }
        }
        let [before, beside, low, high] = around.map(|at| &known[at..at + nx]);
        let mut left = before[0];
        for x in 0..nx {
            let (xl, xr) = (x.saturating_sub(1), (x + 1).min(nx - 1));
            let of_node =
                [left, before[x], beside[x], before[xl], before[xr], beside[xl], beside[xr], low[x], high[x]];
            left = model.node(row[x], &of_node, coder)?;
            row[x] = left;
        }
        one_label[n] = row.iter().all(|label| *label == row[0]);
    }
    Ok(())
}

/// The first row of a tile, of whose nodes only the one before is known.
fn first_row<C: Coder>(row: &mut [i32], model: &mut Model, coder: &mut C) -> Result<()> {
    for x in 0..row.len() {
        row[x] = match x {
            0 => model.other(row[0], coder)?,
            _ => model.node(row[x], &[row[x - 1]; NEIGHBOURS], coder)?,
        };
    }
    Ok(())
}

/// The labels of a tile as bytes, x fastest. No bytes are zeros alone.
///
/// # Errors
/// [`Error::Size`] for more than 32 nodes along an axis, none, or another number of labels;
/// [`Error::Label`] for one beyond [`MOST_LABEL`].
pub fn encode_labels(labels: &[i32], size: [usize; 3]) -> Result<Vec<u8>> {
    check_size(size, labels.len())?;
    if let Some(index) = labels.iter().position(|label| label.unsigned_abs() > MOST_LABEL as u32) {
        return Err(Error::Label { index });
    }
    if labels.iter().all(|label| *label == 0) {
        return Ok(vec![]);
    }
    let mut coder = Encoder::default();
    walk(&mut labels.to_vec(), size, &mut coder)?;
    Ok(coder.finish())
}

/// What [`encode_labels`] was given.
///
/// # Errors
/// [`Error::Size`] for more than 32 nodes along an axis, or none; [`Error::Damaged`].
pub fn decode_labels(bytes: &[u8], size: [usize; 3]) -> Result<Vec<i32>> {
    let n = size.iter().product();
    check_size(size, n)?;
    let mut labels = vec![0; n];
    if !bytes.is_empty() {
        let mut coder = Decoder::new(bytes);
        walk(&mut labels, size, &mut coder)?;
        coder.finish()?;
    }
    Ok(labels)
}

fn check_size(size: [usize; 3], labels: usize) -> Result<()> {
    let is_tile = size.iter().all(|n| (1..=TILE).contains(n)) && size.iter().product::<usize>() == labels;
    if is_tile { Ok(()) } else { Err(Error::Size { dims: size, samples: labels }) }
}
