//! Batches of `f32`: vectors of AVX2 and AVX-512, each of which needs a proof that the machine has
//! the instructions; and vectors that all machines of a kind have.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod plain;

use super::wide::{Neighbourhood, View};
use super::{Grid, Star};
use crate::simd::F64s;
#[cfg(target_arch = "x86_64")]
use avx2::Narrow;
#[cfg(target_arch = "x86_64")]
use avx512::Wide;
use plain::Plain;

/// The vectors that a machine has.
#[derive(Clone, Copy, Debug)]
pub(super) enum Vectors {
    /// AVX-512.
    #[cfg(target_arch = "x86_64")]
    Wide(Wide),
    /// AVX2.
    #[cfg(target_arch = "x86_64")]
    Narrow(Narrow),
    /// What every machine has.
    Plain(Plain),
}

impl Vectors {
    /// The widest ones; none where insertion takes less time.
    pub(super) fn found() -> Option<Self> {
        let pays = |vectors: &Self| !matches!(vectors, Self::Plain(_)) || plain::PAYS;
        Self::all().into_iter().flatten().find(pays)
    }

    /// All that there are, the widest first.
    pub(super) fn all() -> [Option<Self>; 3] {
        #[cfg(target_arch = "x86_64")]
        let [wide, narrow] = [Wide::found().map(Self::Wide), Narrow::found().map(Self::Narrow)];
        #[cfg(not(target_arch = "x86_64"))]
        let [wide, narrow] = [None, None];
        [wide, narrow, Some(Self::Plain(Plain))]
    }
}

/// A machine that has some: code that is compiled for them.
pub(super) trait Machine: Copy {
    type Batch: Batch<Proof = Self>;
    /// [`Neighbourhood::gather`].
    fn gather(
        self,
        near: &mut Neighbourhood,
        grid: &Grid,
        rows: &[[u32; 2]],
        p: [f32; 3],
        reach: f32,
    ) -> bool;
    /// [`Neighbourhood::close`].
    fn close<const N: usize>(
        self,
        near: &mut Neighbourhood,
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> Star;
}

/// Some lanes. Each operation is that of each lane by itself, rounded once.
pub(super) trait Batch: Copy {
    type Proof: Copy;
    /// A bit for each lane, in some form.
    type Mask: Copy;
    /// How lanes are packed.
    type Packing: Copy;
    /// Half as many `f64`.
    type Doubles: F64s;
    /// The number of lanes.
    const LANES: usize;
    /// Whether there are registers for the points nearby.
    const HOLDS: bool;
    /// The lanes of a list from a place on.
    fn load(proof: Self::Proof, list: &[f32], place: usize) -> Self;
    fn store(self, list: &mut [f32], place: usize);
    fn splat(proof: Self::Proof, x: f32) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    /// This times the one, plus the other: rounded once.
    fn times_plus(self, factor: Self, more: Self) -> Self;
    /// This less a product: rounded once.
    fn less_product(self, a: Self, b: Self) -> Self;
    /// This divided by the other.
    fn over(self, other: Self) -> Self;
    /// The lesser one.
    fn min(self, other: Self) -> Self;
    /// The least of all lanes, and a batch of it.
    fn least(self) -> (f32, Self);
    /// Where this is less; not where one is NaN.
    fn below(self, other: Self) -> Self::Mask;
    /// Which of the lanes of these bits have this less.
    fn below_in(self, other: Self, lanes: u32) -> u32;
    fn equals(self, other: Self) -> Self::Mask;
    /// The one number where a mask is set, else the other.
    fn pick(mask: Self::Mask, set: Self, unset: Self) -> Self;
    /// A mask as a number: bit k is that of lane k.
    fn bits(mask: Self::Mask) -> u32;
    /// Which numbers of a list, from a place on, are this one.
    fn find(proof: Self::Proof, list: &[u32], place: usize, number: u32) -> u32;
    /// How to pack the lanes of these bits.
    fn packing(proof: Self::Proof, bits: u32) -> Self::Packing;
    /// The lanes of the packing come first; what follows is arbitrary.
    fn packed(self, packing: Self::Packing) -> Self;
    fn doubles(proof: Self::Proof, x: f64) -> Self::Doubles;
    /// The numbers of a list from a place on.
    fn load_doubles(proof: Self::Proof, list: &[f32], place: usize) -> Self::Doubles;
    /// Each rounded.
    fn store_doubles(doubles: Self::Doubles, list: &mut [f32], place: usize);
}
