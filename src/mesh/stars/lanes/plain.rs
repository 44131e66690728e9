//! Eight lanes, as two times four, in vectors that all machines of a kind have: NEON's on aarch64.

use super::{Batch, Machine};
use crate::mesh::stars::wide::{Neighbourhood, View};
use crate::mesh::stars::{Grid, Star};
use crate::simd::{self, F64s as _, Lanes as _, PLACES};
use glam::{BVec4A, Vec4};

/// Whether that takes less time than insertion: where one instruction multiplies and adds.
/// Elsewhere that is a call.
pub(super) const PAYS: bool = cfg!(any(
    target_arch = "aarch64",
    target_arch = "powerpc64",
    target_arch = "riscv64",
    target_feature = "fma"
));

/// Any machine.
#[derive(Clone, Copy, Debug)]
pub(in crate::mesh::stars) struct Plain;

impl Machine for Plain {
    type Batch = Lanes;
    fn gather(
        self,
        near: &mut Neighbourhood,
        grid: &Grid,
        rows: &[[u32; 2]],
        p: [f32; 3],
        reach: f32,
    ) -> bool {
        near.gather::<Lanes>(self, grid, rows, p, reach)
    }
    fn close<const N: usize>(
        self,
        near: &mut Neighbourhood,
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> Star {
        near.close::<N, Lanes>(self, view, is_outer)
    }
}

/// Four and four.
#[derive(Clone, Copy, Debug)]
pub(in crate::mesh::stars) struct Lanes([Vec4; 2]);

impl Lanes {
    #[inline(always)]
    fn each(self, other: Self, f: impl Fn(Vec4, Vec4) -> Vec4) -> Self {
        let ([a, b], [c, d]) = (self.0, other.0);
        Self([f(a, c), f(b, d)])
    }
}

impl Batch for Lanes {
    type Proof = Plain;
    type Mask = [BVec4A; 2];
    type Packing = [u8; 8];
    type Doubles = simd::Plain<f64, 4>;
    const LANES: usize = 8;
    const HOLDS: bool = false;
    #[inline(always)]
    fn load(_: Plain, list: &[f32], place: usize) -> Self {
        let eight = &list[place..place + 8];
        Self([Vec4::from_slice(&eight[..4]), Vec4::from_slice(&eight[4..])])
    }
    #[inline(always)]
    fn store(self, list: &mut [f32], place: usize) {
        let to = &mut list[place..place + 8];
        self.0[0].write_to_slice(&mut to[..4]);
        self.0[1].write_to_slice(&mut to[4..]);
    }
    #[inline(always)]
    fn splat(_: Plain, x: f32) -> Self {
        Self([Vec4::splat(x); 2])
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.each(other, |a, b| a - b)
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self.each(other, |a, b| a * b)
    }
    #[inline(always)]
    fn times_plus(self, factor: Self, more: Self) -> Self {
        let ([a, b], [c, d], [e, f]) = (self.0, factor.0, more.0);
        Self([a.mul_add(c, e), b.mul_add(d, f)])
    }
    #[inline(always)]
    fn less_product(self, a: Self, b: Self) -> Self {
        let [c, d] = a.0;
        Self([-c, -d]).times_plus(b, self)
    }
    #[inline(always)]
    fn over(self, other: Self) -> Self {
        self.each(other, |a, b| a / b)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.each(other, Vec4::min)
    }
    #[inline(always)]
    fn least(self) -> (f32, Self) {
        let least = self.0[0].min(self.0[1]).min_element();
        (least, Self([Vec4::splat(least); 2]))
    }
    #[inline(always)]
    fn below(self, other: Self) -> [BVec4A; 2] {
        [self.0[0].cmplt(other.0[0]), self.0[1].cmplt(other.0[1])]
    }
    #[inline(always)]
    fn below_in(self, other: Self, lanes: u32) -> u32 {
        Self::bits(self.below(other)) & lanes
    }
    #[inline(always)]
    fn equals(self, other: Self) -> [BVec4A; 2] {
        [self.0[0].cmpeq(other.0[0]), self.0[1].cmpeq(other.0[1])]
    }
    #[inline(always)]
    fn pick(mask: [BVec4A; 2], set: Self, unset: Self) -> Self {
        let ([a, b], [c, d]) = (set.0, unset.0);
        Self([Vec4::select(mask[0], a, c), Vec4::select(mask[1], b, d)])
    }
    #[inline(always)]
    fn bits(mask: [BVec4A; 2]) -> u32 {
        mask[0].bitmask() | mask[1].bitmask() << 4
    }
    #[inline(always)]
    fn find(_: Plain, list: &[u32], place: usize, number: u32) -> u32 {
        (0..8).map(|k| u32::from(list[place..place + 8][k] == number) << k).sum()
    }
    #[inline(always)]
    fn packing(_: Plain, bits: u32) -> [u8; 8] {
        PLACES[bits as usize & 0xff]
    }
    #[inline(always)]
    fn packed(self, packing: [u8; 8]) -> Self {
        let lanes: [f32; 8] = bytemuck::cast(self.0);
        Self(bytemuck::cast(packing.map(|place| lanes[usize::from(place) % 8])))
    }
    #[inline(always)]
    fn doubles(_: Plain, x: f64) -> simd::Plain<f64, 4> {
        simd::Plain::splat((), x)
    }
    #[inline(always)]
    fn load_doubles(_: Plain, list: &[f32], place: usize) -> simd::Plain<f64, 4> {
        simd::Plain::from_f32((), &list[place..])
    }
    #[inline(always)]
    fn store_doubles(doubles: simd::Plain<f64, 4>, list: &mut [f32], place: usize) {
        list[place..place + 4].copy_from_slice(&doubles.to_f32());
    }
}
