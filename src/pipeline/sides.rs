//! The values of a chunk's vertices at several steps, side by side.
//!
//! What is asked of a chunk at many steps is asked at the same vertices. So those of eight steps lie together, vertex by vertex, and one load has them.
//! Steps that are left over have lanes that nobody looks at; a step by itself lies as it is.

use crate::archive::summary::BlockRange;
use crate::exec::with_vectors;
use crate::mesh::tet::Tet;
use std::ops::Range;

/// The memory of values side by side, kept from chunk to chunk so that its pages are not asked for again.
#[derive(Default)]
pub(super) struct Room(Vec<Vec<[f32; 8]>>);

/// The values of up to eight steps.
pub(super) enum Side<'a> {
    One(&'a [f32]),
    Four(Vec<[f32; 4]>),
    Eight(Vec<[f32; 8]>),
}

/// The values of all steps.
pub(super) struct Sides<'a> {
    steps: usize,
    all: Vec<Side<'a>>,
}

/// Steps that lie side by side, at most.
const MOST: usize = 8;

impl<'a> Sides<'a> {
    /// Of the values of each step, as many as there are vertices.
    pub(super) fn new(steps: &[&'a [f32]], room: &mut Room) -> Self {
        let all = steps.chunks(MOST).map(|some| match *some {
            [values] => Side::One(values),
            _ if some.len() <= 4 => Side::Four(side_by_side(some, vec![])),
            _ => Side::Eight(side_by_side(some, room.0.pop().unwrap_or_default())),
        });
        Self { steps: steps.len(), all: all.collect() }
    }

    /// Of the values of one step.
    pub(super) fn one(values: &'a [f32]) -> Self {
        Self { steps: 1, all: vec![Side::One(values)] }
    }

    /// Gives its memory back.
    pub(super) fn give_back(self, room: &mut Room) {
        for side in self.all {
            if let Side::Eight(values) = side {
                room.0.push(values);
            }
        }
    }

    /// How many steps there are.
    pub(super) fn steps(&self) -> usize {
        self.steps
    }

    /// Some by some, with the steps that each has.
    pub(super) fn iter(&self) -> impl Iterator<Item = (Range<usize>, &Side<'a>)> {
        (0..self.steps).step_by(MOST).map(|n| n..self.steps.min(n + MOST)).zip(&self.all)
    }

    /// The ranges of blocks at each step, given the end of each block.
    pub(super) fn ranges(&self, tets: &[Tet], block_ends: &[usize]) -> Vec<Vec<BlockRange>> {
        let mut out = vec![Vec::with_capacity(block_ends.len()); self.steps];
        for (steps, side) in self.iter() {
            let out = &mut out[steps];
            let mut start = 0;
            for &end in block_ends {
                let tets = &tets[std::mem::replace(&mut start, end)..end];
                match side {
                    Side::One(values) => push(out, [BlockRange::of(tets, values)]),
                    Side::Four(values) => push(out, ranges(tets, values)),
                    Side::Eight(values) => push(out, ranges(tets, values)),
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

/// Vertices that are put side by side at a time: they fit in the nearest cache.
const SOME: usize = 256;

/// Lanes without a step have what was there.
fn side_by_side<const N: usize>(steps: &[&[f32]], mut out: Vec<[f32; N]>) -> Vec<[f32; N]> {
    out.resize(steps[0].len(), [0.0; N]);
    for (n, rows) in out.chunks_mut(SOME).enumerate() {
        for (lane, values) in steps.iter().enumerate() {
            rows.iter_mut().zip(&values[n * SOME..]).for_each(|(row, &value)| row[lane] = value);
        }
    }
    out
}
