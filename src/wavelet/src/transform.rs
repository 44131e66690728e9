//! The wavelet transform: CDF 9/7 by lifting, along one axis at a time, in place.
//!
//! Cohen, Daubechies, Feauveau, "Biorthogonal bases of compactly supported wavelets" (1992), in the
//! four lifting steps of Daubechies and Sweldens, "Factoring wavelet transforms into lifting steps"
//! (1998). Each line of an axis becomes its low half, then its high half. A line is continued
//! beyond its ends by reflection. All bands are scaled so that the transform is nearly orthonormal.
//!
//! Arithmetic is `f32`; each sum and product is rounded by itself, in the order below. So a
//! coefficient depends on the samples in its window alone, and is the same bits on all machines.

use crate::pyramid::{Band, Box3, Pyramid};
use crate::tile::{Tile, TileId};
use crate::vectors::with_vectors;

/// The four lifting steps, in their order: odd samples, even ones, odd ones, even ones.
pub const LIFTING: [f32; 4] = [-1.586_134_3, -0.052_980_117, 0.882_911_1, 0.443_506_87];
/// What low coefficients are multiplied by after the steps: the square root of 2, over 1.2301741.
pub const LOW: f32 = 1.149_604_4;
/// What high coefficients are multiplied by after the steps: 1.2301741, over the square root of 2.
pub const HIGH: f32 = 0.869_864_46;
/// What low coefficients are multiplied by before the steps are undone.
pub const UNDO_LOW: f32 = HIGH;
/// What high coefficients are multiplied by before the steps are undone.
pub const UNDO_HIGH: f32 = LOW;

/// Lines that are transformed at a time.
const W: usize = 32;
type Row = [f32; W];

/// Working space of a transform.
#[derive(Debug, Default)]
pub struct Scratch {
    even: Vec<Row>,
    odd: Vec<Row>,
    turned: Vec<Row>,
}

/// An array of samples, x fastest, of which a box at the origin is worked on.
struct Array<'a> {
    samples: &'a mut [f32],
    /// Its size along x, y, z.
    dims: [usize; 3],
}

/// Adds `c` times the sum of both neighbours to each of `odd`.
#[inline(always)]
fn lift_odd(c: f32, even: &[Row], odd: &mut [Row]) {
    let last = even.len() - 1;
    for (i, to) in odd.iter_mut().enumerate() {
        let (left, right) = (&even[i], &even[(i + 1).min(last)]);
        for k in 0..W {
            to[k] += c * (left[k] + right[k]);
        }
    }
}

/// Adds `c` times the sum of both neighbours to each of `even`.
#[inline(always)]
fn lift_even(c: f32, even: &mut [Row], odd: &[Row]) {
    let Some(last) = odd.len().checked_sub(1) else { return };
    for (i, to) in even.iter_mut().enumerate() {
        let (left, right) = (&odd[i.saturating_sub(1)], &odd[i.min(last)]);
        for k in 0..W {
            to[k] += c * (left[k] + right[k]);
        }
    }
}

#[inline(always)]
fn forward_steps(even: &mut [Row], odd: &mut [Row]) {
    lift_odd(LIFTING[0], even, odd);
    lift_even(LIFTING[1], even, odd);
    lift_odd(LIFTING[2], even, odd);
    lift_even(LIFTING[3], even, odd);
    even.iter_mut().flatten().for_each(|v| *v *= LOW);
    odd.iter_mut().flatten().for_each(|v| *v *= HIGH);
}

#[inline(always)]
fn inverse_steps(even: &mut [Row], odd: &mut [Row]) {
    even.iter_mut().flatten().for_each(|v| *v *= UNDO_LOW);
    odd.iter_mut().flatten().for_each(|v| *v *= UNDO_HIGH);
    lift_even(-LIFTING[3], even, odd);
    lift_odd(-LIFTING[2], even, odd);
    lift_even(-LIFTING[1], even, odd);
    lift_odd(-LIFTING[0], even, odd);
}

/// Transforms up to W lines side by side: sample i of line k is at `i * stride + k`.
#[inline(always)]
fn lines(samples: &mut [f32], n: usize, stride: usize, across: usize, inverse: bool, s: &mut Scratch) {
    let (evens, odds) = (n.div_ceil(2), n / 2);
    s.even.resize(evens, [0.0; W]);
    s.odd.resize(odds, [0.0; W]);
    let (even, odd) = (&mut s.even[..], &mut s.odd[..]);
    let load = |to: &mut Row, at: usize| match across {
        W => to.copy_from_slice(&samples[at..at + W]),
        _ => to[..across].copy_from_slice(&samples[at..at + across]),
    };
    if inverse {
        (0..evens).for_each(|i| load(&mut even[i], i * stride));
        (0..odds).for_each(|i| load(&mut odd[i], (evens + i) * stride));
        inverse_steps(even, odd);
    } else {
        for i in 0..n {
            load(if i % 2 == 0 { &mut even[i / 2] } else { &mut odd[i / 2] }, i * stride);
        }
        forward_steps(even, odd);
    }
    let mut store = |from: &Row, at: usize| match across {
        W => samples[at..at + W].copy_from_slice(from),
        _ => samples[at..at + across].copy_from_slice(&from[..across]),
    };
    if inverse {
        for i in 0..n {
            store(if i % 2 == 0 { &even[i / 2] } else { &odd[i / 2] }, i * stride);
        }
    } else {
        (0..evens).for_each(|i| store(&even[i], i * stride));
        (0..odds).for_each(|i| store(&odd[i], (evens + i) * stride));
    }
}

/// Lines along x lie next to each other: W of them are turned, transformed, and turned back.
#[inline(always)]
fn along_x(samples: &mut [f32], n: usize, stride: usize, across: usize, inverse: bool, s: &mut Scratch) {
    let mut turned = std::mem::take(&mut s.turned);
    turned.resize(n, [0.0; W]);
    for k in 0..across {
        for (to, from) in turned.iter_mut().zip(&samples[k * stride..][..n]) {
            to[k] = *from;
        }
    }
    lines(turned.as_flattened_mut(), n, W, W, inverse, s);
    for k in 0..across {
        for (from, to) in turned.iter().zip(&mut samples[k * stride..][..n]) {
            *to = from[k];
        }
    }
    s.turned = turned;
}

/// Transforms the box of a size at the origin along one axis.
fn along(array: &mut Array<'_>, size: [usize; 3], axis: usize, inverse: bool, s: &mut Scratch) {
    with_vectors(
        #[inline(always)]
        || along_plainly(array, size, axis, inverse, s),
    );
}

#[inline(always)]
fn along_plainly(array: &mut Array<'_>, size: [usize; 3], axis: usize, inverse: bool, s: &mut Scratch) {
    let [dx, dy, _] = array.dims;
    let (n, stride) = (size[axis], [1, dx, dx * dy]);
    // The axis of the outer loop, and that of lines side by side.
    let (outer, inner) = [(2, 1), (2, 0), (1, 0)][axis];
    for o in 0..size[outer] {
        for i in (0..size[inner]).step_by(W) {
            let across = W.min(size[inner] - i);
            let part = &mut array.samples[o * stride[outer] + i * stride[inner]..];
            match axis {
                0 => along_x(part, n, stride[1], across, inverse, s),
                _ => lines(part, n, stride[axis], across, inverse, s),
            }
        }
    }
}

/// Samples of a box of an array, or its coefficients.
///
/// The transform of an array at a coefficient depends on samples in a window around it. So a
/// window of a large array has the array's coefficients, bit by bit, where it is [`HALO`] wide
/// around them, or ends where the array ends.
#[derive(Clone, Debug)]
pub struct Window {
    /// The box. Its start is a multiple of the stride of the levels that are made of it.
    pub place: Box3,
    /// Samples, x fastest. After [`Window::forward`]: coefficients, low ones first along each axis.
    pub samples: Vec<f32>,
}

/// Nodes around a coefficient that it depends on, for a group of levels: 4, 8 and 16 of them.
pub const HALO: usize = 28;
/// Nodes around a sample whose coefficients it depends on, of one level; even.
pub const MARGIN: usize = 6;

/// The size of a box, and of what is left of it after each split.
fn sizes<'a>(size: [usize; 3], splits: impl Iterator<Item = &'a [bool; 3]>) -> Vec<[usize; 3]> {
    let mut sizes = vec![size];
    for split in splits {
        let now = sizes[sizes.len() - 1];
        sizes.push(std::array::from_fn(|a| if split[a] { now[a].div_ceil(2) } else { now[a] }));
    }
    sizes
}

impl Window {
    /// Transforms samples, or nodes of a level, along the axes of each split in turn.
    pub fn forward(&mut self, splits: &[[bool; 3]], scratch: &mut Scratch) {
        let sizes = sizes(self.place.size, splits.iter());
        let mut array = Array { samples: &mut self.samples, dims: self.place.size };
        for (split, size) in splits.iter().zip(sizes) {
            (0..3).filter(|a| split[*a]).for_each(|a| along(&mut array, size, a, false, scratch));
        }
    }

    /// Undoes [`Window::forward`].
    pub fn inverse(&mut self, splits: &[[bool; 3]], scratch: &mut Scratch) {
        let sizes = sizes(self.place.size, splits.iter());
        let mut array = Array { samples: &mut self.samples, dims: self.place.size };
        for (split, size) in splits.iter().zip(sizes).rev() {
            (0..3).rev().filter(|a| split[*a]).for_each(|a| along(&mut array, size, a, true, scratch));
        }
    }

    /// The coefficients of a band after some splits: those in a part of the band.
    pub fn band(&self, splits: &[[bool; 3]], high: [bool; 3], part: &Box3) -> Vec<f32> {
        let mut found = Vec::with_capacity(part.len());
        self.rows(splits, high, part, |row| found.extend_from_slice(&self.samples[row]));
        found
    }

    /// The coefficients of a tile, band by band. The window was made of nodes of level `from`, and
    /// has all levels up to the tile's.
    pub fn tile(
        &self,
        pyramid: &Pyramid,
        from: usize,
        id: TileId,
        turn: impl Fn(f32) -> f32,
    ) -> Vec<Vec<f32>> {
        let splits = &pyramid.splits()[from..id.level];
        let part = |band: Band| {
            let mut found = self.band(splits, band.high, &pyramid.part(id.level, &band, id.at));
            found.iter_mut().for_each(|c| *c = turn(*c));
            found
        };
        pyramid.bands(id.level).map(part).collect()
    }

    /// Puts what a tile has in common with a window of the level below its own.
    pub(crate) fn put_tile(&mut self, pyramid: &Pyramid, tile: &Tile, restored: impl Fn(i32) -> f32) {
        let split = pyramid.split(tile.id.level);
        for (part, band) in tile.parts.iter().zip(pyramid.bands(tile.id.level)) {
            let low = self.place.halved(split);
            // Of the window's nodes along a split axis, half are high ones, one less if they are
            // odd.
            let size = |a: usize| if band.high[a] { self.place.size[a] / 2 } else { low.size[a] };
            let here = Box3 { start: low.start, size: [0, 1, 2].map(size) }.cut(&part.place);
            if here.is_empty() {
                continue;
            }
            let mut numbers = Vec::with_capacity(here.len());
            part.place.each_row(&here, |at| {
                numbers.extend(part.numbers[at..at + here.size[0]].iter().map(|n| restored(*n)));
            });
            self.put_band(&[split], band.high, &here, &numbers);
        }
    }

    /// Puts coefficients where [`Window::band`] finds them.
    pub fn put_band(&mut self, splits: &[[bool; 3]], high: [bool; 3], part: &Box3, coefficients: &[f32]) {
        let (mut rows, mut at) = (vec![], 0);
        self.rows(splits, high, part, |row| rows.push(row));
        for row in rows {
            let n = row.len();
            self.samples[row].copy_from_slice(&coefficients[at..at + n]);
            at += n;
        }
    }

    /// Where the rows of a part of a band are.
    fn rows(
        &self,
        splits: &[[bool; 3]],
        high: [bool; 3],
        part: &Box3,
        mut row: impl FnMut(std::ops::Range<usize>),
    ) {
        let left = sizes(self.place.size, splits.iter())[splits.len()];
        let first: [usize; 3] = std::array::from_fn(|a| {
            let start = self.place.start[a] >> splits.iter().filter(|s| s[a]).count();
            part.start[a] - start + if high[a] { left[a] } else { 0 }
        });
        let [nx, ny, _] = self.place.size;
        for z in first[2]..first[2] + part.size[2] {
            for y in first[1]..first[1] + part.size[1] {
                let at = (z * ny + y) * nx + first[0];
                row(at..at + part.size[0]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_and_plain_code_have_the_same_bits_and_the_inverse_undoes() {
        for dims in [[37, 20, 9], [8, 33, 16], [70, 1, 8]] {
            let n: usize = dims.iter().product();
            let samples: Vec<f32> = (0..n).map(|i| ((i * 7919) % 1013) as f32 * 0.01 - 5.0).collect();
            let (mut wide, mut plain) = (samples.clone(), samples.clone());
            let mut scratch = Scratch::default();
            let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            let axes: Vec<usize> = (0..3).filter(|a| dims[*a] > 1).collect();
            for (inverse, axes) in [(false, axes.clone()), (true, axes.into_iter().rev().collect())] {
                for axis in axes {
                    along(&mut Array { samples: &mut wide, dims }, dims, axis, inverse, &mut scratch);
                    along_plainly(
                        &mut Array { samples: &mut plain, dims },
                        dims,
                        axis,
                        inverse,
                        &mut scratch,
                    );
                    assert_eq!(bits(&wide), bits(&plain));
                }
            }
            assert!(samples.iter().zip(&wide).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }

    #[test]
    fn the_transform_of_a_constant_has_no_details() {
        let mut window = Window { place: Box3::all([16, 16, 1]), samples: vec![3.0; 256] };
        window.forward(&[[true, true, false]], &mut Scratch::default());
        let low = window.band(&[[true, true, false]], [false; 3], &Box3::all([8, 8, 1]));
        assert!(low.iter().all(|c| (c - 6.0).abs() < 1e-4));
        let high = window.band(&[[true, true, false]], [true, false, false], &Box3::all([8, 8, 1]));
        assert!(high.iter().all(|c| c.abs() < 1e-4));
    }
}
