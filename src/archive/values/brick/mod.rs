//! The quantised values of a brick of a body-centred cubic lattice. Each is predicted from those
//! before it; the difference is coded in context.
//!
//! ```text
//!  values, coarse to fine ─▶ mean of the neighbours, or smooth field ─▶ difference ─▶ range coder
//!                              └─ their spread, or their own differences ─▶ which odds
//! ```
//!
//! A brick has up to 8³ nodes and as many centres ([`crate::mesh::bcc`]). Nodes come first, on
//! grids of 8, 4, 2 and 1 cells. On each finer grid those with three odd coordinates come first,
//! then those with two, then those with one. So each lies between some that are known. Centres come
//! last.
//!
//! There are two predictions, and a brick uses the one that takes fewer bits:
//!
//! - The mean of all known values within a grid step, weighted by the inverse square of the
//!   distance (Shepard 1968). The odds depend on how far the neighbours are from their mean. This
//!   suits noise, edges and constant parts.
//! - The most likely value of a random field through the 32 nearest known values, one whose
//!   differences have the variance d^1.75 at a distance d (fractional Brownian motion; Mandelbrot &
//!   Van Ness 1968, kriging: Matheron 1963). Its weights may be negative: it follows curvature, and
//!   no scale enters. The odds depend on the differences that were coded for the nearest eight.
//!
//! A difference is coded as the number of its bits, its sign, and its bits. The odds of the number
//! of bits learn within the brick.
//!
//! A lattice with a node at each sample has bricks of nodes alone. There the difference is rounded
//! to a step, and the value is the prediction plus it, in [`PARTS`] of a step. Noise that is less
//! than half a step then takes few bits, wherever the values lie between two multiples of the step
//! (closed-loop prediction: Cutler 1952; as in Di and Cappello, "Fast error-bounded lossy HPC data
//! compression with SZ", 2016).
//!
//! A brick decodes alone. Weights are made from sums, products, quotients and square roots of f64,
//! which are exact everywhere. All further arithmetic is on integers, so the bytes are the same on
//! every machine.

mod odds;

use self::odds::{MORE, SECOND};
use crate::archive::range_coder::{Decoder, Encoder, Odds};
use std::collections::HashMap;
use std::sync::OnceLock;

/// Cells along an edge of a brick, at most.
const EDGE: usize = 8;
/// Nodes along an edge of a brick of nodes, at most: the last one has those at the domain's end.
const NODES: usize = EDGE + 1;
/// Values of a brick of nodes are whole numbers of these parts of a step.
pub(crate) const PARTS: i32 = 16;
/// How many bits the square of a step is worth, where one of two predictions is chosen.
const BITS_A_SQUARE: u64 = 5;
/// Values of a brick, at most.
const VALUES: usize = 2 * EDGE * EDGE * EDGE;
/// The sum of the weights of a value's neighbours.
const UNIT: i64 = 1 << 14;
/// Kinds of values: nodes on coarse grids, nodes on the finest, centres.
const KINDS: usize = 3;
/// Tables of odds: one for each kind, and one for smooth bricks.
const TABLES: usize = KINDS + 1;
/// Neighbours of a value of a smooth brick, at most.
const SMOOTH_NEAR: usize = 32;
/// Neighbours whose own differences decide the odds.
const NEAREST: usize = 8;
/// Classes of spread.
const SPREADS: usize = 20;
/// Bits that a difference may have.
const MOST_BITS: usize = 32;
/// Numbers of bits that have odds of their own.
const LENGTHS: usize = 20;

/// A value in the order of coding: which one, its table of odds, and the end of its neighbours.
#[derive(Clone, Copy, Debug)]
struct CodedValue {
    number: u16,
    table: u16,
    end: u32,
}

/// A neighbour's number and weight.
type Near = (u16, i16);

/// The order of a brick's values, and the neighbours from which each is predicted.
#[derive(Debug, Default)]
struct Prediction {
    places: Vec<CodedValue>,
    near: Vec<Near>,
}

/// How the values of a brick are predicted.
#[derive(Debug)]
pub(crate) struct Template {
    shape: Shape,
    mean: Prediction,
    /// Made when a brick needs it.
    smooth: OnceLock<Prediction>,
}

/// What a brick has values at.
#[derive(Clone, Copy, Debug)]
enum Shape {
    /// The low corners and the centres of so many cells along each axis.
    Cells([i32; 3]),
    /// So many nodes along each axis.
    Nodes([i32; 3]),
}

/// The place of a value: even coordinates of nodes, odd ones of centres.
type Halves = [i32; 3];

impl Shape {
    /// The number of a value in its brick; none where the brick has no value.
    fn number(self, at: Halves) -> Option<usize> {
        let odd = at[0] & 1;
        match self {
            Self::Cells(cells) => {
                let is_inside = at.iter().zip(cells).all(|(&j, c)| j & 1 == odd && j >= 0 && j < 2 * c);
                is_inside.then(|| number(cells, at))
            }
            Self::Nodes(nodes) => {
                let is_inside = at.iter().zip(nodes).all(|(&j, n)| j & 1 == 0 && j >= 0 && j < 2 * n);
                is_inside.then(|| ((at[2] / 2 * nodes[1] + at[1] / 2) * nodes[0] + at[0] / 2) as usize)
            }
        }
    }

    /// All values in the order of coding, each with the step, in halves, of the grid that it
    /// refines.
    fn in_order(self) -> Vec<(Halves, i32)> {
        match self {
            Self::Cells(cells) => {
                let mut order = nodes_in_order(cells);
                order.extend(all_cells(cells, 1).map(|cell| (cell.map(|c| 2 * c + 1), 2)));
                order
            }
            Self::Nodes(nodes) => nodes_in_order(nodes),
        }
    }
}

impl Template {
    /// The template of a brick of so many cells, 1 to 8 along each axis. Values are numbered in
    /// blocks of 4³ cells: in each block first its nodes, x fastest, then its centres.
    pub(crate) fn of(cells: [u32; 3]) -> &'static Self {
        static ALL: [OnceLock<Template>; EDGE * EDGE * EDGE] =
            [const { OnceLock::new() }; EDGE * EDGE * EDGE];
        let [x, y, z] = cells.map(|c| (c as usize).clamp(1, EDGE) - 1);
        ALL[(z * EDGE + y) * EDGE + x]
            .get_or_init(|| Self::new(Shape::Cells(cells.map(|c| c.clamp(1, EDGE as u32) as i32))))
    }

    /// The template of a brick of so many nodes, 1 to 9 along each axis, numbered x fastest.
    pub(crate) fn of_nodes(nodes: [u32; 3]) -> &'static Self {
        static ALL: [OnceLock<Template>; NODES * NODES * NODES] =
            [const { OnceLock::new() }; NODES * NODES * NODES];
        let nodes = nodes.map(|n| (n as usize).clamp(1, NODES));
        let [x, y, z] = nodes.map(|n| n - 1);
        ALL[(z * NODES + y) * NODES + x].get_or_init(|| Self::new(Shape::Nodes(nodes.map(|n| n as i32))))
    }

    fn new(shape: Shape) -> Self {
        Self { shape, mean: Prediction::mean(shape), smooth: OnceLock::new() }
    }

    fn smooth(&self) -> &Prediction {
        self.smooth.get_or_init(|| Prediction::smooth(self.shape))
    }

    /// How many values a brick has.
    pub(crate) fn len(&self) -> usize {
        self.mean.places.len()
    }
}

impl Prediction {
    /// Predicts by the mean of the neighbours within a grid step.
    fn mean(shape: Shape) -> Self {
        let order = shape.in_order();
        let number = |at: Halves| shape.number(at).expect("the order is of the brick's values");
        let mut rank = vec![usize::MAX; order.len()];
        for (n, &(at, _)) in order.iter().enumerate() {
            rank[number(at)] = n;
        }
        let mut all = Self::default();
        for (n, &(at, step)) in order.iter().enumerate() {
            let kind = if at[0] & 1 == 1 { 2 } else { usize::from(step == 2) };
            let mut found = vec![];
            for d in offsets(step) {
                let other = shape.number(std::array::from_fn(|a| at[a] + d[a]));
                if let Some(other) = other.filter(|&other| rank[other] < n) {
                    // 3 · 2^20 has a whole number of all the sums of squares here.
                    found.push((other, (3 << 20) / i64::from(squared(d))));
                }
            }
            let whole: i64 = found.iter().map(|f| f.1).sum();
            let mut left = UNIT;
            for (i, &(number, part)) in found.iter().enumerate() {
                let weight = if i + 1 == found.len() { left } else { UNIT * part / whole };
                left -= weight;
                all.near.push((number as u16, weight as i16));
            }
            all.push(number(at), kind);
        }
        all
    }

    /// Predicts by the most likely field through the nearest values.
    fn smooth(shape: Shape) -> Self {
        let number = |at: Halves| shape.number(at).expect("the order is of the brick's values");
        let places: Vec<Halves> = shape.in_order().into_iter().map(|(at, _)| at).collect();
        let (mut all, mut known) = (Self::default(), HashMap::new());
        for (n, &at) in places.iter().enumerate() {
            let mut found: Vec<(i32, usize)> =
                places[..n].iter().enumerate().map(|(i, &p)| (squared(less(p, at)), i)).collect();
            if found.len() > SMOOTH_NEAR {
                found.select_nth_unstable(SMOOTH_NEAR);
                found.truncate(SMOOTH_NEAR);
            }
            found.sort_unstable();
            let near: Vec<Halves> = found.iter().map(|&(_, i)| less(places[i], at)).collect();
            let weights = known.entry(near).or_insert_with_key(|near| weights(near));
            let numbers = found.iter().map(|&(_, i)| number(places[i]) as u16);
            all.near.extend(numbers.zip(weights.iter().copied()));
            all.push(number(at), KINDS);
        }
        all
    }

    /// The place whose neighbours were pushed last.
    fn push(&mut self, number: usize, table: usize) {
        self.places.push(CodedValue {
            number: number as u16,
            table: table as u16,
            end: self.near.len() as u32,
        });
    }
}

fn less(a: Halves, b: Halves) -> Halves {
    std::array::from_fn(|k| a[k] - b[k])
}

fn squared(d: Halves) -> i32 {
    d.iter().map(|d| d * d).sum()
}

/// The variance of the difference of two values that are so far apart.
fn variance(d: Halves) -> f64 {
    /// The square of the largest distance in a brick, and 1.
    const DISTANCES: usize = 3 * (2 * EDGE * 2 * EDGE) + 1;
    static ALL: OnceLock<[f64; DISTANCES]> = OnceLock::new();
    ALL.get_or_init(|| {
        std::array::from_fn(|squared| {
            let d = squared as f64;
            if d > 0.0 { d / d.sqrt().sqrt().sqrt() } else { 0.0 }
        })
    })[squared(d) as usize]
}

/// The weights of neighbours at such offsets, the nearest one first: those with the least expected
/// square of the error. All differences are taken to the nearest one. Their covariances form a
/// linear system, solved by Gauss-Jordan elimination. It is positive definite, so it needs no
/// pivoting.
fn weights(near: &[Halves]) -> Vec<i16> {
    let Some((&first, rest)) = near.split_first() else { return vec![] };
    let n = rest.len();
    // The others, then the value itself.
    let mut others = [[0; 3]; SMOOTH_NEAR];
    others[..n].copy_from_slice(rest);
    let to_first = others.map(|a| variance(less(a, first)));
    let mut rows = [[0.0; SMOOTH_NEAR]; SMOOTH_NEAR];
    for (i, row) in rows[..n].iter_mut().enumerate() {
        for (k, entry) in row[..=n].iter_mut().enumerate() {
            *entry = to_first[i] + to_first[k] - variance(less(others[i], others[k]));
        }
    }
    for i in 0..n {
        let pivot = rows[i][i];
        // All columns, in vectors: those before it are 0 in this row.
        let by = rows[i].map(|entry| entry / pivot);
        for row in &mut rows[..n] {
            let factor = row[i];
            row.iter_mut().zip(&by).for_each(|(entry, by)| *entry -= factor * by);
        }
        rows[i] = by;
    }
    let rounded = rows[..n].iter().map(|row| (row[n] * UNIT as f64 + 0.5).floor() as i64);
    let mut all = vec![0];
    all.extend(rounded);
    all[0] = UNIT - all[1..].iter().sum::<i64>();
    all.into_iter().map(|weight| weight as i16).collect()
}

/// The number of a value in its brick.
fn number(cells: [i32; 3], at: Halves) -> usize {
    const BLOCK: i32 = 4;
    let cell = at.map(|j| j / 2);
    let block = cell.map(|c| c / BLOCK * BLOCK);
    let size: [i32; 3] = std::array::from_fn(|a| (cells[a] - block[a]).min(BLOCK));
    let [x, y, _] = cells;
    let before = block[2] * x * y + size[2] * (block[1] * x + size[1] * block[0]);
    let in_block: [i32; 3] = std::array::from_fn(|a| cell[a] - block[a]);
    let offset = (in_block[2] * size[1] + in_block[1]) * size[0] + in_block[0];
    let of_kind = if at[0] & 1 == 1 { size.iter().product() } else { 0 };
    (2 * before + of_kind + offset) as usize
}

/// The cells, or nodes, at multiples of a step, x fastest.
fn all_cells(cells: [i32; 3], step: i32) -> impl Iterator<Item = [i32; 3]> {
    let [x, y, z] = cells.map(|c| (0..c).step_by(step as usize));
    z.flat_map(move |z| {
        let x = x.clone();
        y.clone().flat_map(move |y| x.clone().map(move |x| [x, y, z]))
    })
}

/// All nodes in the order of coding, each with the step, in halves, of the grid that it refines.
fn nodes_in_order(nodes: [i32; 3]) -> Vec<(Halves, i32)> {
    let mut order: Vec<(Halves, i32)> = vec![([0; 3], 16)];
    for step in [8, 4, 2, 1] {
        for odd in [3, 2, 1] {
            let is_new = |node: &[i32; 3]| node.iter().filter(|&&c| c / step % 2 == 1).count() == odd;
            order.extend(all_cells(nodes, step).filter(is_new).map(|node| (node.map(|c| 2 * c), 2 * step)));
        }
    }
    order
}

/// Where neighbours may be: within a step of the grid; for those of the finest, half a step too.
fn offsets(step: i32) -> impl Iterator<Item = Halves> {
    let half = if step == 2 { 1 } else { step };
    let axis = move || (-step..=step).step_by(half as usize);
    axis().flat_map(move |z| axis().flat_map(move |y| axis().map(move |x| [x, y, z])))
}

/// The odds of a brick.
#[derive(Clone)]
struct Model {
    lengths: [[[Odds; LENGTHS]; SPREADS]; TABLES],
    /// The second bit of a difference from the top, by the number of bits.
    seconds: [Odds; LENGTHS],
}

impl Model {
    fn new() -> Self {
        let odds = |in_256: u8| Odds::new(u16::from(in_256) << 8);
        Self {
            lengths: MORE.map(|kind| kind.map(|spread| spread.map(odds))),
            seconds: [odds(SECOND); LENGTHS],
        }
    }
}

/// The class of a spread: twice its base-2 logarithm.
#[inline(always)]
fn class_of(spread: u64) -> usize {
    if spread == 0 {
        return 0;
    }
    let log = spread.ilog2();
    let half = if log > 0 { spread >> (log - 1) & 1 } else { 0 };
    ((2 * log as usize) + half as usize + 1).min(SPREADS - 1)
}

/// The mean of a value's neighbours, and the class of their spread from it, in quarters of a step.
#[inline(always)]
fn from_mean<const OF_STEP: i32>(near: &[Near], values: &[i32]) -> (i32, usize) {
    let mut sum = 0i64;
    for &(number, weight) in near {
        sum += i64::from(values[usize::from(number)]) * i64::from(weight);
    }
    let mean = (sum + UNIT / 2).div_euclid(UNIT) as i32;
    let mut spread = 0u64;
    for &(number, weight) in near {
        let apart = i64::from(values[usize::from(number)]) - i64::from(mean);
        spread += apart.unsigned_abs() * u64::from(weight as u16);
    }
    (mean, class_of(spread / (UNIT as u64 / 4 * OF_STEP as u64)))
}

/// The value of a smooth field, and the class of the nearest neighbours' own differences, in
/// quarters.
#[inline(always)]
fn from_field(near: &[Near], values: &[i32], apart: &[u32; VALUES]) -> (i32, usize) {
    let mut sum = 0i64;
    for &(number, weight) in near {
        sum += i64::from(values[usize::from(number)]) * i64::from(weight);
    }
    let mut size = 0u64;
    for &(number, weight) in &near[..near.len().min(NEAREST)] {
        size += u64::from(apart[usize::from(number) % VALUES]) * u64::from(weight.unsigned_abs());
    }
    ((sum + UNIT / 2).div_euclid(UNIT) as i32, class_of(size / (UNIT as u64 / 4)))
}

/// Appends the values of a brick.
pub(crate) fn encode(template: &Template, values: &[i32], out: &mut Vec<u8>) {
    let (mut coder, mut model) = (Encoder::default(), Model::new());
    put_shorter::<1>(template, i32::MAX, &mut values.to_vec(), &mut coder, &mut model);
    coder.finish(out);
}

/// Appends bricks of nodes, one after another, whose samples are so many parts of a step, 0 to
/// `most`; a step has 1 part or [`PARTS`]. They become what is read back, off by half a step at
/// most.
pub(crate) fn encode_nodes(bricks: &mut [(&Template, Vec<i32>)], parts: i32, most: i32, out: &mut Vec<u8>) {
    let (mut coder, mut model) = (Encoder::default(), Model::new());
    for (template, values) in bricks {
        match parts {
            1 => put_shorter::<1>(template, most, values, &mut coder, &mut model),
            _ => put_shorter::<PARTS>(template, most, values, &mut coder, &mut model),
        }
    }
    coder.finish(out);
}

/// Encodes by both predictions, and takes the one that costs less in bits and in error.
fn put_shorter<const OF_STEP: i32>(
    template: &Template,
    most: i32,
    values: &mut Vec<i32>,
    coder: &mut Encoder,
    model: &mut Model,
) {
    assert_eq!(values.len(), template.len(), "a value for each place");
    let (start, mut smooth) = (coder.bits(), values.clone());
    let samples = if OF_STEP == 1 { vec![] } else { values.clone() };
    let (mut of_smooth, mut model_of_smooth) = (coder.clone(), model.clone());
    put::<false, OF_STEP>(&template.mean, most, values, coder, model);
    put::<true, OF_STEP>(template.smooth(), most, &mut smooth, &mut of_smooth, &mut model_of_smooth);
    let cost = |bits: u64, values: &[i32]| {
        let off = |(a, b): (&i32, &i32)| u64::from(a.abs_diff(*b)).pow(2);
        let squares = samples.iter().zip(values).map(off).sum::<u64>();
        (bits - start) * (OF_STEP * OF_STEP) as u64 + BITS_A_SQUARE * squares
    };
    if cost(of_smooth.bits(), &smooth) < cost(coder.bits(), values) {
        (*coder, *model, *values) = (of_smooth, model_of_smooth, smooth);
    }
}

/// Encodes `values`, which become those that are read back.
fn put<const SMOOTH: bool, const OF_STEP: i32>(
    prediction: &Prediction,
    most: i32,
    values: &mut [i32],
    coder: &mut Encoder,
    model: &mut Model,
) {
    let (mut start, mut apart) = (0, [0; VALUES]);
    coder.raw(1, u32::from(SMOOTH));
    for place in &prediction.places {
        let near = &prediction.near[start..place.end as usize];
        start = place.end as usize;
        let (mean, class) =
            if SMOOTH { from_field(near, values, &apart) } else { from_mean::<OF_STEP>(near, values) };
        let value = &mut values[usize::from(place.number)];
        let mut difference = value.wrapping_sub(mean);
        if OF_STEP > 1 {
            difference = difference.wrapping_add(OF_STEP / 2).div_euclid(OF_STEP);
            *value = mean.wrapping_add(difference.wrapping_mul(OF_STEP)).clamp(0, most);
        }
        let size = difference.unsigned_abs();
        if SMOOTH {
            apart[usize::from(place.number)] = size;
        }
        let bits = (u32::BITS - size.leading_zeros()) as usize;
        let lengths = &mut model.lengths[usize::from(place.table)][class];
        for length in 0..=bits.min(MOST_BITS - 1) {
            coder.bit(&mut lengths[length.min(LENGTHS - 1)], bits > length);
        }
        if bits == 0 {
            continue;
        }
        if bits > 1 {
            coder.bit(&mut model.seconds[bits.min(LENGTHS) - 1], size >> (bits - 2) & 1 == 1);
        }
        // The sign, and the bits below the two highest.
        let mut left = (bits as u32).saturating_sub(2);
        if left > 15 {
            left -= 15;
            coder.raw(15, size >> left & 0x7fff);
        }
        coder.raw(left + 1, (size & ((1 << left) - 1)) << 1 | u32::from(difference < 0));
    }
}

/// Reads the values of a brick; false if the bytes are not such ones.
pub(crate) fn decode(template: &Template, bytes: &[u8], values: &mut [i32]) -> bool {
    let mut coder = Decoder::new(bytes);
    take::<1>(template, i32::MAX, &mut coder, &mut Model::new(), values);
    coder.at_end()
}

/// Reads bricks of nodes, in parts of a step, 0 to `most`; `None` if the bytes are not such ones.
pub(crate) fn decode_nodes(
    templates: &[&Template],
    bytes: &[u8],
    parts: i32,
    most: i32,
) -> Option<Vec<Vec<i32>>> {
    let (mut coder, mut model) = (Decoder::new(bytes), Model::new());
    let bricks = templates.iter().map(|template| {
        let mut values = vec![0; template.len()];
        match parts {
            1 => take::<1>(template, most, &mut coder, &mut model, &mut values),
            _ => take::<PARTS>(template, most, &mut coder, &mut model, &mut values),
        }
        values
    });
    let bricks = bricks.collect();
    coder.at_end().then_some(bricks)
}

fn take<const OF_STEP: i32>(
    template: &Template,
    most: i32,
    coder: &mut Decoder<'_>,
    model: &mut Model,
    values: &mut [i32],
) {
    assert_eq!(values.len(), template.len(), "a value for each place");
    if coder.raw(1) == 1 {
        take_as::<true, OF_STEP>(template.smooth(), most, coder, model, values);
    } else {
        take_as::<false, OF_STEP>(&template.mean, most, coder, model, values);
    }
}

fn take_as<const SMOOTH: bool, const OF_STEP: i32>(
    prediction: &Prediction,
    most: i32,
    coder: &mut Decoder<'_>,
    model: &mut Model,
    values: &mut [i32],
) {
    let (mut start, mut apart) = (0, [0; VALUES]);
    for place in &prediction.places {
        let near = &prediction.near[start..place.end as usize];
        start = place.end as usize;
        let (mean, class) =
            if SMOOTH { from_field(near, values, &apart) } else { from_mean::<OF_STEP>(near, values) };
        let lengths = &mut model.lengths[usize::from(place.table)][class];
        let mut bits = 0;
        while bits < MOST_BITS && coder.bit(&mut lengths[bits.min(LENGTHS - 1)]) {
            bits += 1;
        }
        let mut difference = 0i32;
        if bits > 0 {
            let mut size = 1u32;
            if bits > 1 {
                size = size << 1 | u32::from(coder.bit(&mut model.seconds[bits.min(LENGTHS) - 1]));
            }
            let mut left = (bits as u32).saturating_sub(2);
            if left > 15 {
                left -= 15;
                size = size << 15 | coder.raw(15);
            }
            let low = coder.raw(left + 1);
            size = size << left | low >> 1;
            difference = if low & 1 == 1 { (size as i32).wrapping_neg() } else { size as i32 };
        }
        let mut value = mean.wrapping_add(difference.wrapping_mul(OF_STEP));
        if OF_STEP > 1 {
            value = value.clamp(0, most);
        }
        values[usize::from(place.number)] = value;
        if SMOOTH {
            apart[usize::from(place.number)] = difference.unsigned_abs();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_is_coded_once_from_those_before() {
        let of_cells = [[8, 8, 8], [1, 1, 1], [5, 8, 3], [7, 2, 6]]
            .map(|cells| (Template::of(cells), 2 * cells.iter().product::<u32>()));
        let of_nodes = [[8, 8, 8], [9, 9, 9], [1, 9, 4]]
            .map(|nodes| (Template::of_nodes(nodes), nodes.iter().product::<u32>()));
        for (template, values) in of_cells.into_iter().chain(of_nodes) {
            assert_eq!(template.len() as u32, values);
            for prediction in [&template.mean, template.smooth()] {
                let (mut known, mut start) = (vec![false; template.len()], 0);
                for (n, place) in prediction.places.iter().enumerate() {
                    let near = &prediction.near[start..place.end as usize];
                    start = place.end as usize;
                    assert!(near.iter().all(|&(number, _)| known[usize::from(number)]));
                    assert!(n == 0 || near.iter().map(|&(_, w)| i64::from(w)).sum::<i64>() == UNIT);
                    assert!(!std::mem::replace(&mut known[usize::from(place.number)], true));
                }
            }
        }
    }

    #[test]
    fn weights_are_those_of_the_document() {
        // Halfway between two values; then with a third one behind: an extrapolation has signs.
        assert_eq!(weights(&[[-2, 0, 0], [2, 0, 0]]), [8192, 8192]);
        let three = weights(&[[-2, 0, 0], [-4, 0, 0], [-6, 0, 0]]);
        assert_eq!(three.iter().map(|&w| i64::from(w)).sum::<i64>(), UNIT);
        assert!(three[0] > 16_384 && three[1] < 0, "{three:?}");
    }

    #[test]
    fn values_come_back() {
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 32) as u32
        };
        for cells in [[8, 8, 8], [1, 1, 1], [5, 8, 3]] {
            let template = Template::of(cells);
            for bits in 0..=31 {
                let values: Vec<i32> = (0..template.len())
                    .map(|_| if bits == 0 { 7 } else { (next() >> (32 - bits)) as i32 - (1 << (bits - 1)) })
                    .collect();
                let mut bytes = vec![];
                encode(template, &values, &mut bytes);
                let mut back = vec![0; values.len()];
                assert!(decode(template, &bytes, &mut back), "{cells:?} {bits}");
                assert_eq!(back, values);
                // Noise takes a third more than its bits: the odds of lengths are those of smooth
                // values.
                let most = template.len() * (bits as usize * 4 / 3 + 3) / 8 + 16;
                assert!(bytes.len() <= most, "{} bytes for {bits} bits", bytes.len());
            }
        }
    }

    #[test]
    fn smooth_values_take_few_bits() {
        let template = Template::of([8, 8, 8]);
        let mut values = vec![0; 1024];
        for (at, _) in Shape::Cells([8; 3]).in_order() {
            let [x, y, z] = at.map(|j| f64::from(j) / 2.0);
            values[number([8; 3], at)] = (100.0 * (0.2 * x).sin() + 3.0 * y + z * z / 4.0).round() as i32;
        }
        let mut bytes = vec![];
        encode(template, &values, &mut bytes);
        // Less than half of the 8 bits that each value would take by itself.
        assert!(bytes.len() < 1024 * 4 / 8, "{}", bytes.len());
        // A smooth field does better than a mean.
        let mut by_mean = vec![];
        let (mut coder, mut model) = (Encoder::default(), Model::new());
        put::<false, 1>(&template.mean, i32::MAX, &mut values.clone(), &mut coder, &mut model);
        coder.finish(&mut by_mean);
        assert!(10 * bytes.len() < 7 * by_mean.len(), "{} of {}", bytes.len(), by_mean.len());
    }

    #[test]
    fn the_document_has_the_odds() {
        let document = include_str!("../../FORMAT.md");
        for row in MORE.iter().flatten() {
            let numbers = row.map(|n| n.to_string()).join(" ");
            assert!(document.lines().any(|line| line.trim() == numbers), "{numbers}");
        }
    }

    #[test]
    fn any_bytes_end() {
        let template = Template::of([8, 3, 8]);
        let mut values = vec![0; template.len()];
        for byte in 0..=255u8 {
            decode(template, &[byte; 3000], &mut values);
            decode(template, &[byte], &mut values);
        }
        assert!(!decode(template, &[], &mut values) || values.iter().all(|v| *v == 0));
    }
}
