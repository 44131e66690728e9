//! Sixteen numbers of 32 bits at a time: a vector of AVX-512, two of AVX2, and the same in plain
//! code, with the same bits.
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;

#[cfg(target_arch = "x86_64")]
pub(super) use avx2::FloatPair;
#[cfg(target_arch = "x86_64")]
pub(super) use avx512::FloatVector;

use crate::geom::LatticePos;

/// A bit for each lane.
pub(super) type Bits = u16;

/// Sixteen `f32`. Each operation is that of each lane by itself, rounded once.
pub(super) trait Floats: Copy {
    /// What must be known before there are such lanes.
    type Proof: Copy;
    /// Some of the lanes.
    type Mask: Copy;
    type Ints: Ints<Proof = Self::Proof, Floats = Self>;
    fn splat(proof: Self::Proof, x: f32) -> Self;
    fn lanes(self) -> [f32; 16];
    /// The lanes of these numbers; their lowest four bits count.
    fn at(self, numbers: Self::Ints) -> Self;
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    /// This divided by the other.
    fn over(self, other: Self) -> Self;
    /// Where this is less.
    fn below(self, other: Self) -> Self::Mask;
    fn bits(mask: Self::Mask) -> Bits;
    /// The one number where a mask is set, else the other.
    fn pick(mask: Self::Mask, set: Self, unset: Self) -> Self;
    /// This, but where the mask is set and the other is less, the other; of numbers.
    fn lesser_where(self, mask: Self::Mask, other: Self) -> Self;
    /// This, but where the mask is set and the other is greater, the other; of numbers.
    fn greater_where(self, mask: Self::Mask, other: Self) -> Self;
    /// Fractions cut off. Numbers that are no `i32` give any one.
    fn cut(self) -> Self::Ints;
}

/// Sixteen `u32`. Sums and differences wrap around.
pub(super) trait Ints: Copy {
    type Proof: Copy;
    type Floats;
    fn of(proof: Self::Proof, lanes: &[u32; 16]) -> Self;
    fn splat(proof: Self::Proof, x: u32) -> Self;
    /// Sixteen positions as three columns.
    fn columns(proof: Self::Proof, row: impl FnMut(usize) -> LatticePos) -> [Self; 3];
    fn lanes(self) -> [u32; 16];
    /// The lanes of these numbers; their lowest four bits count.
    fn at(self, numbers: Self) -> Self;
    /// The lanes whose bits are set, in their order; then any numbers.
    fn packed(self, bits: Bits) -> [u32; 16];
    fn and(self, other: Self) -> Self;
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn shifted_left(self, bits: u32) -> Self;
    fn shifted_right(self, bits: u32) -> Self;
    /// Where this is less.
    fn below(self, other: Self) -> Bits;
    /// The greatest one.
    fn greatest(self) -> u32;
    /// As `i32`, rounded.
    fn floats(self) -> Self::Floats;
}

/// Everywhere.
#[derive(Clone, Copy)]
pub(super) struct Plain<T>([T; 16]);

// Loops over lists in place: those the compiler turns into what vectors there are.
impl<T: Copy> Plain<T> {
    #[inline(always)]
    fn each<U: Copy + Default>(self, f: impl Fn(T) -> U) -> Plain<U> {
        let mut out = [U::default(); 16];
        out.iter_mut().zip(self.0).for_each(|(out, x)| *out = f(x));
        Plain(out)
    }
    #[inline(always)]
    fn pairs(mut self, other: Self, f: impl Fn(T, T) -> T) -> Self {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a = f(*a, b));
        self
    }
    /// All bits where it holds, else none.
    #[inline(always)]
    fn mask(self, other: Self, f: impl Fn(T, T) -> bool) -> [u32; 16] {
        let mut out = [0; 16];
        for (out, (a, b)) in out.iter_mut().zip(self.0.into_iter().zip(other.0)) {
            *out = 0u32.wrapping_sub(u32::from(f(a, b)));
        }
        out
    }
}

#[inline(always)]
fn first_bits(lanes: [u32; 16]) -> Bits {
    let mut bits = 0;
    for (k, lane) in lanes.into_iter().enumerate() {
        bits |= lane & 1 << k;
    }
    bits as Bits
}

impl Floats for Plain<f32> {
    type Proof = ();
    type Mask = [u32; 16];
    type Ints = Plain<u32>;
    #[inline(always)]
    fn splat((): (), x: f32) -> Self {
        Self([x; 16])
    }
    #[inline(always)]
    fn lanes(self) -> [f32; 16] {
        self.0
    }
    #[inline(always)]
    fn at(self, numbers: Plain<u32>) -> Self {
        numbers.each(|n| self.0[n as usize % 16])
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.pairs(other, |a, b| a + b)
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.pairs(other, |a, b| a - b)
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self.pairs(other, |a, b| a * b)
    }
    #[inline(always)]
    fn over(self, other: Self) -> Self {
        self.pairs(other, |a, b| a / b)
    }
    #[inline(always)]
    fn below(self, other: Self) -> [u32; 16] {
        self.mask(other, |a, b| a < b)
    }
    #[inline(always)]
    fn bits(mask: [u32; 16]) -> Bits {
        first_bits(mask)
    }
    #[inline(always)]
    fn pick(mask: [u32; 16], set: Self, mut unset: Self) -> Self {
        for (x, (set, mask)) in unset.0.iter_mut().zip(set.0.into_iter().zip(mask)) {
            *x = f32::from_bits(set.to_bits() & mask | x.to_bits() & !mask);
        }
        unset
    }
    #[inline(always)]
    fn lesser_where(self, mask: [u32; 16], other: Self) -> Self {
        Self::pick(mask, self.pairs(other, |a, b| if b < a { b } else { a }), self)
    }
    #[inline(always)]
    fn greater_where(self, mask: [u32; 16], other: Self) -> Self {
        Self::pick(mask, self.pairs(other, |a, b| if b > a { b } else { a }), self)
    }
    #[inline(always)]
    fn cut(self) -> Plain<u32> {
        self.each(|x| x as i32 as u32)
    }
}

impl Ints for Plain<u32> {
    type Proof = ();
    type Floats = Plain<f32>;
    #[inline(always)]
    fn of((): (), lanes: &[u32; 16]) -> Self {
        Self(*lanes)
    }
    #[inline(always)]
    fn splat((): (), x: u32) -> Self {
        Self([x; 16])
    }
    #[inline(always)]
    fn columns((): (), mut row: impl FnMut(usize) -> LatticePos) -> [Self; 3] {
        let [mut x, mut y, mut z] = [[0; 16]; 3];
        for (n, ((x, y), z)) in x.iter_mut().zip(&mut y).zip(&mut z).enumerate() {
            [*x, *y, *z] = row(n);
        }
        [x, y, z].map(Self)
    }
    #[inline(always)]
    fn lanes(self) -> [u32; 16] {
        self.0
    }
    #[inline(always)]
    fn at(self, numbers: Self) -> Self {
        numbers.each(|n| self.0[n as usize % 16])
    }
    #[inline(always)]
    fn packed(self, mut bits: Bits) -> [u32; 16] {
        let (mut out, mut len) = ([0; 16], 0);
        while bits != 0 {
            out[len % 16] = self.0[bits.trailing_zeros() as usize % 16];
            len += 1;
            bits &= bits - 1;
        }
        out
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self.pairs(other, |a, b| a & b)
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.pairs(other, u32::wrapping_add)
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.pairs(other, u32::wrapping_sub)
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self.pairs(other, u32::wrapping_mul)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.pairs(other, u32::min)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.pairs(other, u32::max)
    }
    #[inline(always)]
    fn shifted_left(self, bits: u32) -> Self {
        self.each(|x| x << bits)
    }
    #[inline(always)]
    fn shifted_right(self, bits: u32) -> Self {
        self.each(|x| x >> bits)
    }
    #[inline(always)]
    fn below(self, other: Self) -> Bits {
        first_bits(self.mask(other, |a, b| a < b))
    }
    #[inline(always)]
    fn greatest(self) -> u32 {
        self.0.into_iter().fold(0, u32::max)
    }
    #[inline(always)]
    fn floats(self) -> Plain<f32> {
        self.each(|x| x as i32 as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[cfg(target_arch = "x86_64")]
    use crate::simd::Avx2;
    use proptest::prelude::*;

    fn same<F: Floats>(proof: F::Proof, rows: &[[u32; 3]; 16], some: Bits) -> Vec<Vec<u32>> {
        let [x, y, z] = F::Ints::columns(proof, |n| rows[n]);
        let (f, g) = (x.shifted_right(7).floats(), y.shifted_right(9).floats());
        let one = F::splat(proof, 1.0);
        let bits = |f: F| f.lanes().map(f32::to_bits).to_vec();
        let h = f.minus(g).over(g.plus(one));
        let mask = f.below(g);
        let packed = x.packed(some)[..some.count_ones() as usize].to_vec();
        vec![
            x.plus(y).lanes().to_vec(),
            x.minus(y).lanes().to_vec(),
            y.times(z).lanes().to_vec(),
            x.min(y).max(z).lanes().to_vec(),
            z.shifted_left(3).plus(F::Ints::splat(proof, 5)).lanes().to_vec(),
            x.at(y).and(z).lanes().to_vec(),
            F::Ints::of(proof, &x.lanes()).lanes().to_vec(),
            packed,
            bits(f.at(z)),
            vec![x.greatest(), u32::from(x.below(z)), u32::from(F::bits(mask))],
            bits(h),
            bits(F::pick(mask, f, h).times(g)),
            bits(f.lesser_where(mask, h)),
            bits(f.greater_where(mask, h)),
            f.times(F::splat(proof, 0.37)).cut().lanes().to_vec(),
        ]
    }

    proptest! {
        #[test]
        fn vectors_and_plain_code_have_the_same_bits(rows: [[u32; 3]; 16], some: u16) {
            let plain = same::<Plain<f32>>((), &rows, some);
            let first = rows.map(|[x, y, _]| x.wrapping_add(y));
            prop_assert_eq!(&plain[0][..], &first);
            #[cfg(target_arch = "x86_64")]
            {
                if let Some(proof) = crate::simd::Avx512::found() {
                    prop_assert_eq!(&same::<FloatVector>(proof, &rows, some), &plain);
                }
                if let Some(proof) = Avx2::found() {
                    prop_assert_eq!(&same::<FloatPair>(proof, &rows, some), &plain);
                }
            }
        }
    }
}
