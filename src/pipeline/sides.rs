//! The values of a chunk's vertices at several steps, side by side.
//!
//! What is asked of a chunk at many steps is asked at the same vertices. So those of four steps lie together, vertex by vertex, and one load has them.
//! Steps that are left over have lanes that nobody looks at; a step by itself lies as it is.

use crate::archive::summary::BlockRange;
use crate::exec::with_vectors;
use crate::mesh::tet::Tet;

/// The values of up to four steps.
pub(super) enum Side<'a> {
    One(&'a [f32]),
    Four(Vec<[f32; 4]>),
}

/// The values of all steps.
pub(super) struct Sides<'a> {
    steps: usize,
    all: Vec<Side<'a>>,
}

impl<'a> Sides<'a> {
    /// Of the values of each step, as many as there are vertices.
    pub(super) fn new(steps: &[&'a [f32]]) -> Self {
        let all = steps.chunks(4).map(|four| match *four {
            [values] => Side::One(values),
            _ => Side::Four(four_of(four)),
        });
        Self { steps: steps.len(), all: all.collect() }
    }

    /// How many steps there are.
    pub(super) fn steps(&self) -> usize {
        self.steps
    }

    /// Four by four, with the steps that each has.
    pub(super) fn iter(&self) -> impl Iterator<Item = (std::ops::Range<usize>, &Side<'a>)> {
        (0..self.steps).step_by(4).map(|n| n..self.steps.min(n + 4)).zip(&self.all)
    }
}

impl Sides<'_> {
    /// The ranges of blocks at each step, given the end of each block.
    pub(super) fn ranges(&self, tets: &[Tet], block_ends: &[usize]) -> Vec<Vec<BlockRange>> {
        let mut out = vec![Vec::with_capacity(block_ends.len()); self.steps];
        for (steps, side) in self.iter() {
            let out = &mut out[steps];
            let mut start = 0;
            for &end in block_ends {
                let tets = &tets[std::mem::replace(&mut start, end)..end];
                match side {
                    Side::One(values) => out[0].push(BlockRange::of(tets, values)),
                    Side::Four(values) => {
                        let four = with_vectors(
                            #[inline(always)]
                            || BlockRange::of_steps(tets, values),
                        );
                        out.iter_mut().zip(four).for_each(|(out, range)| out.push(range));
                    }
                }
            }
        }
        out
    }
}

fn four_of(steps: &[&[f32]]) -> Vec<[f32; 4]> {
    let mut out = vec![[0.0; 4]; steps[0].len()];
    for (lane, values) in steps.iter().enumerate() {
        out.iter_mut().zip(*values).for_each(|(four, &value)| four[lane] = value);
    }
    out
}
