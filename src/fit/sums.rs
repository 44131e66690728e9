//! The sums at the vertices, of interleaved steps.
//!
//! The contribution of a sample goes to the four corners of its tetrahedron, at each step. So the
//! values and sums of up to eight steps lie together, vertex by vertex; Σ w² once for all of them,
//! until a sample counts at one step and not at another: from then on each has its own, with what
//! all had in common so far. Steps that are left over have lanes that are not looked at.

use super::{Located, NONE, RoundWithin};
use bytemuck::{Pod, Zeroable};
use isospan_io::exec::{Lent, Room};
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::simd::{Avx2, F64xN, Plain, four, on_avx2_or_plain, on_widest, sorted, with_vectors};

/// ω: the length of the step.
const STEP: f64 = 1.16;
/// γ: the weight at which a sample begins to pull a corner the other way.
const TURN: f64 = 0.125;
/// c: what a vertex' interpolated value counts, in samples.
const PULL: f64 = 0.25;
/// The largest difference of a sample that counts as such.
const MOST: f64 = f32::MAX as f64;
/// Samples, or vertices, that are interleaved at a time, or taken apart: they fit in the nearest
/// cache.
const SOME: usize = 256;
/// Steps that are interleaved, at most.
const TOGETHER: usize = 8;

/// A vertex at some steps. Packed, so that it has no bytes without a meaning, and any memory will
/// do.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C, packed)]
struct FitVertex<const N: usize> {
    /// Interpolated values.
    values: [f32; N],
    /// The least and the largest of the interpolated value and the samples that count.
    least: [f32; N],
    largest: [f32; N],
    /// Σ (w - γ) times the difference.
    pulls: [f64; N],
    /// Σ w².
    weight: f64,
}

/// The vertices at some steps.
pub(super) struct Sums<'a, const N: usize> {
    /// Steps; there may be fewer than lanes.
    steps: usize,
    vertices: Lent<'a, FitVertex<N>>,
    /// Σ w² of each step, where it is not the same for all.
    apart: Vec<[f64; N]>,
    /// Some samples, interleaved.
    rows: Vec<[f32; N]>,
}

/// One step, or some interleaved ones.
pub(super) enum Lanes<'a> {
    One(Sums<'a, 1>),
    Four(Sums<'a, 4>),
    Eight(Sums<'a, 8>),
}

impl<'a> Lanes<'a> {
    /// All steps, given the interpolated values of each.
    pub(super) fn all(steps: &[&[f32]], room: &mut Room<'a>) -> Vec<Self> {
        let lanes = |some: &[&[f32]]| match some.len() {
            1 => Self::One(Sums::new(some, room)),
            2..=4 => Self::Four(Sums::new(some, room)),
            _ => Self::Eight(Sums::new(some, room)),
        };
        steps.chunks(TOGETHER).map(lanes).collect()
    }

    /// How many groups of lanes so many steps make, and the words of memory that each takes, at
    /// most.
    pub(super) fn count(steps: usize) -> usize {
        steps.div_ceil(TOGETHER)
    }

    pub(super) fn words(vertices: usize) -> usize {
        vertices.saturating_mul(size_of::<FitVertex<TOGETHER>>().div_ceil(size_of::<u64>()))
    }

    pub(super) fn steps(&self) -> usize {
        match self {
            Self::One(sums) => sums.steps,
            Self::Four(sums) => sums.steps,
            Self::Eight(sums) => sums.steps,
        }
    }

    /// Adds what samples contribute, in their order; those of each step follow each other.
    pub(super) fn add(&mut self, located: &[Located], samples: &[f32], tets: &[Tet]) {
        match self {
            Self::One(sums) => with_vectors(
                #[inline(always)]
                || sums.add::<Plain<f64, 1>>((), located, samples, tets),
            ),
            Self::Four(sums) => add_four(sums, located, samples, tets),
            Self::Eight(sums) => add_eight(sums, located, samples, tets),
        }
    }

    /// The fitted values of the first `count` vertices at each step.
    pub(super) fn values(&self, count: usize, round: &RoundWithin<'_>) -> Vec<Vec<f32>> {
        match self {
            Self::One(sums) => sums.values(count, round),
            Self::Four(sums) => sums.values(count, round),
            Self::Eight(sums) => sums.values(count, round),
        }
    }
}

#[inline(never)]
fn add_four(sums: &mut Sums<'_, 4>, located: &[Located], samples: &[f32], tets: &[Tet]) {
    on_avx2_or_plain!(Avx2::found(), F64x4, Plain<f64, 4>, |W, token| sums
        .add::<W>(token, located, samples, tets));
}

#[inline(never)]
fn add_eight(sums: &mut Sums<'_, 8>, located: &[Located], samples: &[f32], tets: &[Tet]) {
    on_widest!(F64x8, F64x4, Plain<f64, 8>, |W, token| sums.add::<W>(token, located, samples, tets));
}

impl<'a, const N: usize> Sums<'a, N> {
    fn new(steps: &[&[f32]], room: &mut Room<'a>) -> Self {
        let none =
            FitVertex { values: [0.0; N], least: [0.0; N], largest: [0.0; N], pulls: [0.0; N], weight: 0.0 };
        let mut vertices = room.lend(steps[0].len(), none);
        for (n, vertices) in vertices.chunks_mut(SOME).enumerate() {
            for (lane, values) in steps.iter().enumerate() {
                let values = &values[n * SOME..];
                for (vertex, &value) in vertices.iter_mut().zip(values) {
                    vertex.values[lane] = value;
                    // An interpolated value may exceed the range of `f32`, a stored one may not.
                    let bound = value.clamp(f32::MIN, f32::MAX);
                    (vertex.least[lane], vertex.largest[lane]) = (bound, bound);
                }
            }
        }
        Self { steps: steps.len(), vertices, apart: vec![], rows: vec![[0.0; N]; SOME] }
    }

    /// Adds what samples contribute: nothing at a step where one, or a corner of its tetrahedron,
    /// is no number.
    #[inline(always)]
    pub(super) fn add<W: F64xN<N>>(
        &mut self,
        token: W::Token,
        located: &[Located],
        samples: &[f32],
        tets: &[Tet],
    ) {
        let all = (1 << self.steps) - 1;
        let (least, most, zero) = (W::splat(token, -MOST), W::splat(token, MOST), W::splat(token, 0.0));
        for (n, some) in located.chunks(SOME).enumerate() {
            for (lane, of_step) in samples.chunks_exact(located.len()).enumerate().take(N) {
                let of_step = &of_step[n * SOME..];
                self.rows.iter_mut().zip(of_step).for_each(|(row, &sample)| row[lane] = sample);
            }
            for (located, i) in some.iter().zip(0..SOME).filter(|(located, _)| located.tet != NONE) {
                let (tet, sample) = (tets[located.tet as usize], W::from_f32(token, &self.rows[i]));
                let weights = located.weights.map(f64::from);
                let [a, b, c, d] = sorted(four(
                    #[inline(always)]
                    |k| {
                        let value = W::from_f32(token, &{ self.vertices[tet[k] as usize].values });
                        W::splat(token, weights[k]) * (sample - value)
                    },
                ));
                let sum = a + b + c + d;
                let counts = W::bitmask(sum.is_number()) & all;
                if counts == 0 {
                    continue;
                }
                // To add 0 changes no sum: none is -0, as they begin at 0.
                let sum = W::select(sum.is_number(), sum.min(most).max(least), zero);
                let difference = W::from_f32(token, &sum.to_f32());
                let mut row = self.rows[i];
                if counts != all {
                    let uncounted = |&lane: &usize| counts >> lane & 1 == 0;
                    (0..N).filter(uncounted).for_each(|lane| row[lane] = f32::NAN);
                }
                for (v, w) in tet.into_iter().zip(weights) {
                    let at = &mut self.vertices[v as usize];
                    at.least = W::min_f32(token, &row, &{ at.least });
                    at.largest = W::max_f32(token, &row, &{ at.largest });
                    let pulls = W::load(token, &{ at.pulls });
                    at.pulls = (pulls + W::splat(token, w - TURN) * difference).to_array();
                    if counts == all {
                        at.weight += w * w;
                    }
                }
                if counts != all || !self.apart.is_empty() {
                    self.add_apart(tet, weights, counts);
                }
            }
        }
    }

    /// Adds to the weights of those steps at which a sample counts.
    #[inline(never)]
    fn add_apart(&mut self, tet: Tet, weights: [f64; 4], counts: u32) {
        if self.apart.is_empty() {
            self.apart = self.vertices.iter().map(|vertex| [vertex.weight; N]).collect();
        }
        for (v, w) in tet.into_iter().zip(weights) {
            let at = &mut self.apart[v as usize];
            let of = |lane: usize| if counts >> lane & 1 == 1 { w * w } else { 0.0 };
            (0..N).for_each(|lane| at[lane] += of(lane));
        }
    }

    fn values(&self, count: usize, round: &RoundWithin<'_>) -> Vec<Vec<f32>> {
        let mut out: Vec<Vec<f32>> = (0..self.steps).map(|_| Vec::with_capacity(count)).collect();
        for (n, vertices) in self.vertices[..count].chunks(SOME).enumerate() {
            for (lane, out) in out.iter_mut().enumerate() {
                let fitted = |(v, vertex): (usize, &FitVertex<N>)| {
                    let weight = self.apart.get(n * SOME + v).map_or(vertex.weight, |weights| weights[lane]);
                    let value = vertex.values[lane];
                    let moved = f64::from(value) + STEP * vertex.pulls[lane] / (PULL + weight);
                    // A void one stays void: it has no bounds.
                    if moved.is_nan() {
                        value
                    } else {
                        let [least, largest] = [vertex.least[lane], vertex.largest[lane]];
                        round(lane, (moved as f32).clamp(least, largest), [least, largest])
                    }
                };
                out.extend(vertices.iter().enumerate().map(fitted));
            }
        }
        out
    }

    /// Σ (w - γ) · difference, Σ w² and the bounds of each vertex at each step, as bits.
    #[cfg(test)]
    fn bits(&self) -> Vec<[u64; 4]> {
        let weight = |v: usize, lane: usize| self.apart.get(v).map_or(self.vertices[v].weight, |w| w[lane]);
        let of = |v: usize| {
            let FitVertex { pulls, least, largest, .. } = self.vertices[v];
            let bound = |x: f32| u64::from(x.to_bits());
            (0..self.steps).map(move |lane| {
                let sums = [pulls[lane], weight(v, lane)].map(f64::to_bits);
                [sums[0], sums[1], bound(least[lane]), bound(largest[lane])]
            })
        };
        (0..self.vertices.len()).flat_map(of).collect()
    }
}

#[cfg(test)]
impl Lanes<'_> {
    /// As [`Lanes::add`] where there are no vectors.
    pub(super) fn add_plain(&mut self, located: &[Located], samples: &[f32], tets: &[Tet]) {
        match self {
            Self::One(sums) => sums.add::<Plain<f64, 1>>((), located, samples, tets),
            Self::Four(sums) => sums.add::<Plain<f64, 4>>((), located, samples, tets),
            Self::Eight(sums) => sums.add::<Plain<f64, 8>>((), located, samples, tets),
        }
    }

    pub(super) fn bits(&self) -> Vec<[u64; 4]> {
        match self {
            Self::One(sums) => sums.bits(),
            Self::Four(sums) => sums.bits(),
            Self::Eight(sums) => sums.bits(),
        }
    }
}
