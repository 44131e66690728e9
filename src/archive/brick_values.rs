//! The quantised values of a brick of a body-centred cubic lattice: predicted from those before, the rest coded in context.
//!
//! ```text
//!  values, coarse to fine ─▶ mean of the neighbours that are known ─▶ difference ─▶ range coder
//!                                        └─ their spread ─▶ which odds
//! ```
//!
//! A brick has up to 8³ nodes and as many centres ([`crate::mesh::bcc`]). Nodes come first, on grids of 8, 4, 2 and 1
//! cells. On each finer grid those with three odd coordinates come first, then those with two, then with one: so each lies
//! between some that are known. Centres come last. The prediction is the mean of all known values within a grid step,
//! weighted by the inverse square of the distance (Shepard 1968). A difference is coded as the number of its bits, its
//! sign, and its bits. The odds of the former depend on how far the neighbours are from
//! their mean, and learn within the brick.
//!
//! A brick decodes alone. All arithmetic is of integers, so the bytes are the same on every machine.

mod odds;

use self::odds::{MORE, SECOND};
use super::range::{Decoder, Encoder, Odds};
use std::sync::OnceLock;

/// Cells along an edge of a brick, at most.
const EDGE: usize = 8;
/// The sum of the weights of a value's neighbours.
const UNIT: i64 = 1 << 14;
/// Kinds of values: nodes on coarse grids, nodes on the finest, centres.
const KINDS: usize = 3;
/// Classes of spread.
const SPREADS: usize = 20;
/// Bits that a difference may have.
const MOST_BITS: usize = 32;
/// Those that have odds of their own.
const LENGTHS: usize = 20;

/// A value in the order of coding: which one, its kind, and the end of its neighbours.
#[derive(Clone, Copy, Debug)]
struct Place {
    number: u16,
    kind: u16,
    end: u32,
}

/// The order of a brick's values, and the neighbours from which each is predicted.
#[derive(Debug)]
pub(crate) struct Template {
    places: Vec<Place>,
    /// Number and weight.
    near: Vec<(u16, u16)>,
}

/// The place of a value: even coordinates of nodes, odd ones of centres.
type Halves = [i32; 3];

impl Template {
    /// That of a brick of so many cells, 1 to 8 along each axis. Values are numbered in blocks of 4³ cells: of each its nodes, x
    /// fastest, then its centres.
    pub(crate) fn of(cells: [u32; 3]) -> &'static Self {
        static ALL: [OnceLock<Template>; EDGE * EDGE * EDGE] =
            [const { OnceLock::new() }; EDGE * EDGE * EDGE];
        let [x, y, z] = cells.map(|c| (c as usize).clamp(1, EDGE) - 1);
        ALL[(z * EDGE + y) * EDGE + x]
            .get_or_init(|| Self::new(cells.map(|c| c.clamp(1, EDGE as u32) as i32)))
    }

    fn new(cells: [i32; 3]) -> Self {
        let order = in_order(cells);
        let mut rank = vec![usize::MAX; order.len()];
        for (n, &(at, _)) in order.iter().enumerate() {
            rank[number(cells, at)] = n;
        }
        let inside = |at: Halves| {
            let odd = at[0] & 1;
            at.iter().zip(cells).all(|(&j, c)| j & 1 == odd && j >= 0 && j < 2 * c)
        };
        let (mut places, mut near) = (vec![], vec![]);
        for (n, &(at, step)) in order.iter().enumerate() {
            let kind = if at[0] & 1 == 1 { 2 } else { usize::from(step == 2) };
            let mut found = vec![];
            for d in offsets(step) {
                let other = std::array::from_fn(|a| at[a] + d[a]);
                if inside(other) && rank[number(cells, other)] < n {
                    let squared: i32 = d.iter().map(|d| d * d).sum();
                    // 3 · 2^20 has a whole number of all the sums of squares here.
                    found.push((number(cells, other), (3 << 20) / i64::from(squared)));
                }
            }
            let whole: i64 = found.iter().map(|f| f.1).sum();
            let mut left = UNIT;
            for (i, &(number, part)) in found.iter().enumerate() {
                let weight = if i + 1 == found.len() { left } else { UNIT * part / whole };
                left -= weight;
                near.push((number as u16, weight as u16));
            }
            places.push(Place {
                number: number(cells, at) as u16,
                kind: kind as u16,
                end: near.len() as u32,
            });
        }
        Self { places, near }
    }

    /// How many values a brick has.
    pub(crate) fn len(&self) -> usize {
        self.places.len()
    }
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

/// All values in the order of coding, each with the step, in halves, of the grid that it refines.
fn in_order(cells: [i32; 3]) -> Vec<(Halves, i32)> {
    let each = |step: i32| {
        let [x, y, z] = cells.map(|c| (0..c).step_by(step as usize));
        z.flat_map(move |z| {
            let x = x.clone();
            y.clone().flat_map(move |y| x.clone().map(move |x| [x, y, z]))
        })
    };
    let mut order: Vec<(Halves, i32)> = vec![([0; 3], 16)];
    for step in [4, 2, 1] {
        for odd in [3, 2, 1] {
            let is_new = |cell: &[i32; 3]| cell.iter().filter(|&&c| c / step % 2 == 1).count() == odd;
            order.extend(each(step).filter(is_new).map(|cell| (cell.map(|c| 2 * c), 2 * step)));
        }
    }
    order.extend(each(1).map(|cell| (cell.map(|c| 2 * c + 1), 2)));
    order
}

/// Where neighbours may be: within a step of the grid; for those of the finest, half a step too.
fn offsets(step: i32) -> impl Iterator<Item = Halves> {
    let half = if step == 2 { 1 } else { step };
    let axis = move || (-step..=step).step_by(half as usize);
    axis().flat_map(move |z| axis().flat_map(move |y| axis().map(move |x| [x, y, z])))
}

/// The odds of a brick.
struct Model {
    lengths: [[[Odds; LENGTHS]; SPREADS]; KINDS],
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

/// The class of a spread, in quarters: twice its base-2 logarithm.
#[inline(always)]
fn class_of(spread: u64) -> usize {
    if spread == 0 {
        return 0;
    }
    let log = spread.ilog2();
    let half = if log > 0 { spread >> (log - 1) & 1 } else { 0 };
    ((2 * log as usize) + half as usize + 1).min(SPREADS - 1)
}

/// The prediction of a value, and the class of the spread from its neighbours.
#[inline(always)]
fn predict(near: &[(u16, u16)], values: &[i32]) -> (i32, usize) {
    let mut sum = 0i64;
    for &(number, weight) in near {
        sum += i64::from(values[usize::from(number)]) * i64::from(weight);
    }
    let mean = (sum + UNIT / 2).div_euclid(UNIT) as i32;
    let mut spread = 0u64;
    for &(number, weight) in near {
        let apart = i64::from(values[usize::from(number)]) - i64::from(mean);
        spread += apart.unsigned_abs() * u64::from(weight);
    }
    (mean, class_of(spread / (UNIT as u64 / 4)))
}

/// Appends the values of a brick.
pub(crate) fn encode(template: &Template, values: &[i32], out: &mut Vec<u8>) {
    assert_eq!(values.len(), template.len(), "a value for each place");
    let (mut coder, mut model, mut start) = (Encoder::default(), Model::new(), 0);
    for place in &template.places {
        let near = &template.near[start..place.end as usize];
        start = place.end as usize;
        let (mean, spread) = predict(near, values);
        let difference = values[usize::from(place.number)].wrapping_sub(mean);
        let size = difference.unsigned_abs();
        let bits = (u32::BITS - size.leading_zeros()) as usize;
        let lengths = &mut model.lengths[usize::from(place.kind)][spread];
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
    coder.finish(out);
}

/// Reads the values of a brick; false if the bytes are not such ones.
pub(crate) fn decode(template: &Template, bytes: &[u8], values: &mut [i32]) -> bool {
    assert_eq!(values.len(), template.len(), "a value for each place");
    let (mut coder, mut model, mut start) = (Decoder::new(bytes), Model::new(), 0);
    for place in &template.places {
        let near = &template.near[start..place.end as usize];
        start = place.end as usize;
        let (mean, spread) = predict(near, values);
        let lengths = &mut model.lengths[usize::from(place.kind)][spread];
        let mut bits = 0;
        while bits < MOST_BITS && coder.bit(&mut lengths[bits.min(LENGTHS - 1)]) {
            bits += 1;
        }
        let mut difference = 0;
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
        values[usize::from(place.number)] = mean.wrapping_add(difference);
    }
    coder.at_end()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_is_coded_once_from_those_before() {
        for cells in [[8, 8, 8], [1, 1, 1], [5, 8, 3], [7, 2, 6]] {
            let template = Template::of(cells);
            assert_eq!(template.len() as u32, 2 * cells.iter().product::<u32>());
            let (mut known, mut start) = (vec![false; template.len()], 0);
            for (n, place) in template.places.iter().enumerate() {
                let near = &template.near[start..place.end as usize];
                start = place.end as usize;
                assert!(near.iter().all(|&(number, _)| known[usize::from(number)]));
                assert!(n == 0 || near.iter().map(|&(_, w)| i64::from(w)).sum::<i64>() == UNIT);
                assert!(!std::mem::replace(&mut known[usize::from(place.number)], true));
            }
        }
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
                // Noise takes a third more than its bits: the odds of lengths are those of smooth values.
                let most = template.len() * (bits as usize * 4 / 3 + 3) / 8 + 16;
                assert!(bytes.len() <= most, "{} bytes for {bits} bits", bytes.len());
            }
        }
    }

    #[test]
    fn smooth_values_take_few_bits() {
        let template = Template::of([8, 8, 8]);
        let mut values = vec![0; 1024];
        for (at, _) in in_order([8; 3]) {
            let [x, y, z] = at.map(|j| f64::from(j) / 2.0);
            values[number([8; 3], at)] = (100.0 * (0.2 * x).sin() + 3.0 * y + z * z / 4.0).round() as i32;
        }
        let mut bytes = vec![];
        encode(template, &values, &mut bytes);
        // Of the 8 that each would take for itself.
        assert!(bytes.len() < 1024 * 4 / 8, "{}", bytes.len());
    }

    #[test]
    fn the_document_has_the_odds() {
        let document = include_str!("FORMAT.md");
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
