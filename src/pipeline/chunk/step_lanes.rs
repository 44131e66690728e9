//! The values of a chunk's vertices at several time steps, interleaved.
//!
//! A question about many steps concerns the same vertices. So the values of eight steps lie next to
//! each other, vertex by vertex, and one vector load fetches them. If fewer than eight steps are
//! left, the other lanes are unused. A single step is stored as it is.

use crate::archive::chunked::BlockRange;
use isospan_mesh::mesh::tet::Tet;
#[cfg(target_arch = "x86_64")]
use isospan_mesh::simd::transpose_f32x8;
use isospan_mesh::simd::{Avx2, with_vectors};
use std::ops::Range;

/// The memory of interleaved values, reused from chunk to chunk so that its pages are not requested
/// again.
#[derive(Default)]
pub(in crate::pipeline) struct LaneBuffers(Vec<Vec<[f32; 8]>>);

/// The values of up to eight steps.
pub(super) enum Lanes<'a> {
    One(&'a [f32]),
    Four(Vec<[f32; 4]>),
    Eight(Vec<[f32; 8]>),
}

/// The values of all steps.
pub(in crate::pipeline) struct StepLanes<'a> {
    steps: usize,
    all: Vec<Lanes<'a>>,
}

/// The most steps that are interleaved.
const MOST: usize = 8;

impl<'a> StepLanes<'a> {
    /// Of the values of each step, as many as there are vertices.
    pub(in crate::pipeline) fn new(steps: &[&'a [f32]], buffers: &mut LaneBuffers) -> Self {
        let all = steps.chunks(MOST).map(|some| match *some {
            [values] => Lanes::One(values),
            _ if some.len() <= 4 => Lanes::Four(interleaved(some, vec![])),
            _ => Lanes::Eight(interleaved(some, buffers.0.pop().unwrap_or_default())),
        });
        Self { steps: steps.len(), all: all.collect() }
    }

    /// Of the values of one step.
    pub(in crate::pipeline) fn one(values: &'a [f32]) -> Self {
        Self { steps: 1, all: vec![Lanes::One(values)] }
    }

    /// Gives its memory back.
    pub(in crate::pipeline) fn give_back(self, buffers: &mut LaneBuffers) {
        for lanes in self.all {
            if let Lanes::Eight(values) = lanes {
                buffers.0.push(values);
            }
        }
    }

    /// How many steps there are.
    pub(super) fn steps(&self) -> usize {
        self.steps
    }

    /// Some by some, with the steps that each has.
    pub(super) fn iter(&self) -> impl Iterator<Item = (Range<usize>, &Lanes<'a>)> {
        (0..self.steps).step_by(MOST).map(|n| n..self.steps.min(n + MOST)).zip(&self.all)
    }

    /// The ranges of blocks at each step, given the end of each block.
    pub(in crate::pipeline) fn ranges(&self, tets: &[Tet], block_ends: &[usize]) -> Vec<Vec<BlockRange>> {
        let mut out = vec![Vec::with_capacity(block_ends.len()); self.steps];
        for (steps, lanes) in self.iter() {
            let out = &mut out[steps];
            let mut start = 0;
            for &end in block_ends {
                let tets = &tets[std::mem::replace(&mut start, end)..end];
                match lanes {
                    Lanes::One(values) => push(out, [BlockRange::of(tets, values)]),
                    Lanes::Four(values) => push(out, ranges(tets, values)),
                    Lanes::Eight(values) => push(out, ranges(tets, values)),
                }
            }
        }
        out
    }
}

fn ranges<const N: usize>(tets: &[Tet], values: &[[f32; N]]) -> [BlockRange; N] {
    with_vectors(
        #[inline(always)]
        || BlockRange::of_steps(tets, values),
    )
}

/// A block's range at each step.
fn push<const N: usize>(out: &mut [Vec<BlockRange>], ranges: [BlockRange; N]) {
    out.iter_mut().zip(ranges).for_each(|(out, range)| out.push(range));
}

/// Values that are interleaved at a time: they fit in the nearest cache.
const SOME: usize = 256;

/// Interleaves columns; there are at most as many as lanes. Lanes without a column hold arbitrary
/// numbers.
pub(super) fn interleave<const N: usize>(columns: &[&[f32]], rows: &mut [[f32; N]]) {
    let mut done = 0;
    #[cfg(target_arch = "x86_64")]
    if N == 8
        && let (Some(token), Ok(rows)) = (Avx2::found(), bytemuck::try_cast_slice_mut(rows))
    {
        done = with_vectors(
            #[inline(always)]
            || put_eights(token, columns, rows),
        );
    }
    for (n, rows) in rows[done..].chunks_mut(SOME).enumerate() {
        for (lane, values) in columns.iter().enumerate() {
            rows.iter_mut().zip(&values[done + n * SOME..]).for_each(|(row, &value)| row[lane] = value);
        }
    }
}

/// Those of eight lanes, eight rows at a time; returns how many rows are done.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn put_eights(token: Avx2, columns: &[&[f32]], rows: &mut [[f32; 8]]) -> usize {
    let eights = rows.as_chunks_mut::<8>().0;
    let columns: [&[[f32; 8]]; 8] =
        std::array::from_fn(|lane| &columns[lane.min(columns.len() - 1)].as_chunks().0[..eights.len()]);
    for (n, rows) in eights.iter_mut().enumerate() {
        let [a, b, c, d, e, f, g, h] = &columns;
        *rows = transpose_f32x8(token, [&a[n], &b[n], &c[n], &d[n], &e[n], &f[n], &g[n], &h[n]]);
    }
    8 * eights.len()
}

fn interleaved<const N: usize>(steps: &[&[f32]], mut out: Vec<[f32; N]>) -> Vec<[f32; N]> {
    out.resize(steps[0].len(), [0.0; N]);
    interleave(steps, &mut out);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_interleaved() {
        for (steps, len) in [(1, 3), (3, 8), (5, 7), (8, 16), (8, 8 * SOME + 13), (4, SOME + 1)] {
            let of = |step: usize, n: usize| f32::from_bits((step << 20 | n) as u32);
            let columns: Vec<Vec<f32>> =
                (0..steps).map(|step| (0..len).map(|n| of(step, n)).collect()).collect();
            let columns: Vec<&[f32]> = columns.iter().map(Vec::as_slice).collect();
            let mut eight = vec![[0.0f32; 8]; len];
            interleave(&columns, &mut eight);
            let mut same = (0..len).all(|n| (0..steps).all(|k| eight[n][k].to_bits() == of(k, n).to_bits()));
            if steps <= 4 {
                let mut four = vec![[0.0f32; 4]; len];
                interleave(&columns, &mut four);
                same &= (0..len).all(|n| (0..steps).all(|k| four[n][k].to_bits() == of(k, n).to_bits()));
            }
            assert!(same, "{steps} steps, {len} vertices");
        }
    }
}
