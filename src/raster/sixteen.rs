//! Sixteen numbers of 32 bits at a time: a vector of AVX-512, two of AVX2, and the same in plain code, with the same bits.
#![allow(unsafe_code)]

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
    /// Of a mask: the one number where it is set, else the other.
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

#[cfg(target_arch = "x86_64")]
pub(super) use vectors::{FloatPair, FloatVector};

/// To be had with a proof only: so each has been made on a machine that has the instructions. Of use in code that is compiled for them.
#[cfg(target_arch = "x86_64")]
mod vectors {
    use super::{Bits, Floats, Ints};
    use crate::exec::{Avx2, Avx512};
    use crate::geom::LatticePos;
    use std::arch::x86_64::*;

    #[derive(Clone, Copy)]
    pub(in super::super) struct FloatVector(__m512);
    #[derive(Clone, Copy)]
    pub(in super::super) struct IntVector(__m512i);

    /// Operations of a pair, lane by lane.
    macro_rules! pairs {
        ($($name:ident = $vector:ident),*) => {
            $(
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    // SAFETY: AVX-512 was found.
                    Self(unsafe { $vector(self.0, other.0) })
                }
            )*
        };
    }

    impl Floats for FloatVector {
        type Proof = Avx512;
        type Mask = __mmask16;
        type Ints = IntVector;
        pairs!(plus = _mm512_add_ps, minus = _mm512_sub_ps, times = _mm512_mul_ps, over = _mm512_div_ps);
        #[inline(always)]
        fn splat(_: Avx512, x: f32) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_set1_ps(x) })
        }
        #[inline(always)]
        fn lanes(self) -> [f32; 16] {
            let mut out = [0.0; 16];
            // SAFETY: AVX-512 was found, and there is room for all numbers.
            unsafe { _mm512_storeu_ps(out.as_mut_ptr(), self.0) };
            out
        }
        #[inline(always)]
        fn at(self, numbers: IntVector) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_permutexvar_ps(numbers.0, self.0) })
        }
        #[inline(always)]
        fn below(self, other: Self) -> __mmask16 {
            // SAFETY: AVX-512 was found.
            unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn bits(mask: __mmask16) -> Bits {
            mask
        }
        #[inline(always)]
        fn pick(mask: __mmask16, set: Self, unset: Self) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_mask_blend_ps(mask, unset.0, set.0) })
        }
        #[inline(always)]
        fn lesser_where(self, mask: __mmask16, other: Self) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_mask_min_ps(self.0, mask, other.0, self.0) })
        }
        #[inline(always)]
        fn greater_where(self, mask: __mmask16, other: Self) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_mask_max_ps(self.0, mask, other.0, self.0) })
        }
        #[inline(always)]
        fn cut(self) -> IntVector {
            // SAFETY: AVX-512 was found.
            IntVector(unsafe { _mm512_cvttps_epi32(self.0) })
        }
    }

    /// Of use as [`IntVector`] is.
    #[inline(always)]
    fn quarters(a: LatticePos, b: LatticePos, c: LatticePos, d: LatticePos) -> __m512i {
        // SAFETY: the one caller has a proof of AVX-512.
        unsafe {
            let low = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(quarter(a)), quarter(b));
            let high = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(quarter(c)), quarter(d));
            _mm512_inserti64x4::<1>(_mm512_castsi256_si512(low), high)
        }
    }

    #[inline(always)]
    fn quarter([x, y, z]: LatticePos) -> __m128i {
        // SAFETY: as above, and SSE4.1 comes with it.
        unsafe {
            let xy = _mm_cvtsi64_si128((u64::from(x) | u64::from(y) << 32) as i64);
            _mm_insert_epi32::<2>(xy, z as i32)
        }
    }

    impl Ints for IntVector {
        type Proof = Avx512;
        type Floats = FloatVector;
        #[inline(always)]
        fn of(_: Avx512, lanes: &[u32; 16]) -> Self {
            // SAFETY: AVX-512 was found, and there are sixteen numbers to be read.
            Self(unsafe { _mm512_loadu_si512(lanes.as_ptr().cast()) })
        }
        pairs!(
            and = _mm512_and_si512,
            plus = _mm512_add_epi32,
            minus = _mm512_sub_epi32,
            times = _mm512_mullo_epi32,
            min = _mm512_min_epu32,
            max = _mm512_max_epu32
        );
        #[inline(always)]
        fn splat(_: Avx512, x: u32) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_set1_epi32(x as i32) })
        }
        #[inline(always)]
        fn columns(_: Avx512, mut row: impl FnMut(usize) -> LatticePos) -> [Self; 3] {
            // Lane k of four lanes is row 4·lane + k: then columns have them in order.
            let a = quarters(row(0), row(4), row(8), row(12));
            let b = quarters(row(1), row(5), row(9), row(13));
            let c = quarters(row(2), row(6), row(10), row(14));
            let d = quarters(row(3), row(7), row(11), row(15));
            // SAFETY: AVX-512 was found.
            unsafe {
                let (ab, cd) = (_mm512_unpacklo_epi32(a, b), _mm512_unpacklo_epi32(c, d));
                let (ab_high, cd_high) = (_mm512_unpackhi_epi32(a, b), _mm512_unpackhi_epi32(c, d));
                [
                    Self(_mm512_unpacklo_epi64(ab, cd)),
                    Self(_mm512_unpackhi_epi64(ab, cd)),
                    Self(_mm512_unpacklo_epi64(ab_high, cd_high)),
                ]
            }
        }
        #[inline(always)]
        fn lanes(self) -> [u32; 16] {
            let mut out = [0u32; 16];
            // SAFETY: AVX-512 was found, and there is room for all numbers.
            unsafe { _mm512_storeu_si512(out.as_mut_ptr().cast(), self.0) };
            out
        }
        #[inline(always)]
        fn at(self, numbers: Self) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_permutexvar_epi32(numbers.0, self.0) })
        }
        #[inline(always)]
        fn packed(self, bits: Bits) -> [u32; 16] {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_maskz_compress_epi32(bits, self.0) }).lanes()
        }
        #[inline(always)]
        fn shifted_left(self, bits: u32) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_sll_epi32(self.0, _mm_cvtsi32_si128(bits as i32)) })
        }
        #[inline(always)]
        fn shifted_right(self, bits: u32) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_srl_epi32(self.0, _mm_cvtsi32_si128(bits as i32)) })
        }
        #[inline(always)]
        fn below(self, other: Self) -> Bits {
            // SAFETY: AVX-512 was found.
            unsafe { _mm512_cmplt_epu32_mask(self.0, other.0) }
        }
        #[inline(always)]
        fn greatest(self) -> u32 {
            // SAFETY: AVX-512 was found.
            unsafe { _mm512_reduce_max_epu32(self.0) }
        }
        #[inline(always)]
        fn floats(self) -> FloatVector {
            // SAFETY: AVX-512 was found.
            FloatVector(unsafe { _mm512_cvtepi32_ps(self.0) })
        }
    }

    /// Lanes 0 to 7 and 8 to 15.
    #[derive(Clone, Copy)]
    pub(in super::super) struct FloatPair(__m256, __m256);
    #[derive(Clone, Copy)]
    pub(in super::super) struct IntPair(__m256i, __m256i);

    /// The same of both halves.
    macro_rules! halves {
        ($($name:ident = $vector:ident),*) => {
            $(
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    // SAFETY: AVX2 was found.
                    unsafe { Self($vector(self.0, other.0), $vector(self.1, other.1)) }
                }
            )*
        };
    }

    impl Floats for FloatPair {
        type Proof = Avx2;
        type Mask = (__m256, __m256);
        type Ints = IntPair;
        halves!(plus = _mm256_add_ps, minus = _mm256_sub_ps, times = _mm256_mul_ps, over = _mm256_div_ps);
        #[inline(always)]
        fn splat(_: Avx2, x: f32) -> Self {
            // SAFETY: AVX2 was found.
            let all = unsafe { _mm256_set1_ps(x) };
            Self(all, all)
        }
        #[inline(always)]
        fn lanes(self) -> [f32; 16] {
            let mut out = [0.0; 16];
            // SAFETY: AVX2 was found, and there is room for twice eight numbers.
            unsafe {
                _mm256_storeu_ps(out.as_mut_ptr(), self.0);
                _mm256_storeu_ps(out[8..].as_mut_ptr(), self.1);
            }
            out
        }
        #[inline(always)]
        fn at(self, numbers: IntPair) -> Self {
            Self(picked(self, numbers.0), picked(self, numbers.1))
        }
        #[inline(always)]
        fn below(self, other: Self) -> Self::Mask {
            // SAFETY: AVX2 was found.
            unsafe {
                (_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0), _mm256_cmp_ps::<_CMP_LT_OQ>(self.1, other.1))
            }
        }
        #[inline(always)]
        fn bits(mask: Self::Mask) -> Bits {
            // SAFETY: AVX2 was found.
            unsafe { (_mm256_movemask_ps(mask.0) | _mm256_movemask_ps(mask.1) << 8) as Bits }
        }
        #[inline(always)]
        fn pick(mask: Self::Mask, set: Self, unset: Self) -> Self {
            // SAFETY: AVX2 was found.
            unsafe {
                Self(_mm256_blendv_ps(unset.0, set.0, mask.0), _mm256_blendv_ps(unset.1, set.1, mask.1))
            }
        }
        #[inline(always)]
        fn lesser_where(self, mask: Self::Mask, other: Self) -> Self {
            // SAFETY: AVX2 was found.
            let lesser = unsafe { Self(_mm256_min_ps(other.0, self.0), _mm256_min_ps(other.1, self.1)) };
            Self::pick(mask, lesser, self)
        }
        #[inline(always)]
        fn greater_where(self, mask: Self::Mask, other: Self) -> Self {
            // SAFETY: AVX2 was found.
            let greater = unsafe { Self(_mm256_max_ps(other.0, self.0), _mm256_max_ps(other.1, self.1)) };
            Self::pick(mask, greater, self)
        }
        #[inline(always)]
        fn cut(self) -> IntPair {
            // SAFETY: AVX2 was found.
            unsafe { IntPair(_mm256_cvttps_epi32(self.0), _mm256_cvttps_epi32(self.1)) }
        }
    }

    /// Of the sixteen lanes those of eight numbers. Of use as [`FloatPair`] is.
    #[inline(always)]
    fn picked(from: FloatPair, numbers: __m256i) -> __m256 {
        // SAFETY: there is a pair, so AVX2 was found.
        unsafe {
            let (low, high) =
                (_mm256_permutevar8x32_ps(from.0, numbers), _mm256_permutevar8x32_ps(from.1, numbers));
            // Bit 3 tells which half.
            _mm256_blendv_ps(low, high, _mm256_castsi256_ps(_mm256_slli_epi32::<28>(numbers)))
        }
    }

    /// The lanes whose bits are set come first.
    #[inline(always)]
    fn packed(lanes: __m256i, bits: u8) -> __m256i {
        // SAFETY: the one caller has a pair, so AVX2 was found, and BMI2 with it.
        unsafe {
            let bytes = _pdep_u64(u64::from(bits), 0x0101_0101_0101_0101) * 0xff;
            let numbers = _pext_u64(0x0706_0504_0302_0100, bytes);
            let numbers = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(numbers as i64));
            _mm256_permutevar8x32_epi32(lanes, numbers)
        }
    }

    /// Two positions in a vector.
    #[inline(always)]
    fn two(a: LatticePos, b: LatticePos) -> __m256i {
        // SAFETY: the one caller has a proof of AVX2.
        unsafe { _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(quarter(a)), quarter(b)) }
    }

    /// Rows 0 to 3 and 4 to 7, the latter in the upper halves, as columns.
    #[inline(always)]
    fn columns_of([a, b, c, d]: [__m256i; 4]) -> [__m256i; 3] {
        // SAFETY: the one caller has a proof of AVX2.
        unsafe {
            let (ab, cd) = (_mm256_unpacklo_epi32(a, b), _mm256_unpacklo_epi32(c, d));
            let (ab_high, cd_high) = (_mm256_unpackhi_epi32(a, b), _mm256_unpackhi_epi32(c, d));
            [
                _mm256_unpacklo_epi64(ab, cd),
                _mm256_unpackhi_epi64(ab, cd),
                _mm256_unpacklo_epi64(ab_high, cd_high),
            ]
        }
    }

    impl Ints for IntPair {
        type Proof = Avx2;
        type Floats = FloatPair;
        halves!(
            and = _mm256_and_si256,
            plus = _mm256_add_epi32,
            minus = _mm256_sub_epi32,
            times = _mm256_mullo_epi32,
            min = _mm256_min_epu32,
            max = _mm256_max_epu32
        );
        #[inline(always)]
        fn of(_: Avx2, lanes: &[u32; 16]) -> Self {
            // SAFETY: AVX2 was found, and there are twice eight numbers to be read.
            unsafe {
                Self(
                    _mm256_loadu_si256(lanes.as_ptr().cast()),
                    _mm256_loadu_si256(lanes[8..].as_ptr().cast()),
                )
            }
        }
        #[inline(always)]
        fn splat(_: Avx2, x: u32) -> Self {
            // SAFETY: AVX2 was found.
            let all = unsafe { _mm256_set1_epi32(x as i32) };
            Self(all, all)
        }
        #[inline(always)]
        fn columns(_: Avx2, mut row: impl FnMut(usize) -> LatticePos) -> [Self; 3] {
            let low = [two(row(0), row(4)), two(row(1), row(5)), two(row(2), row(6)), two(row(3), row(7))];
            let high =
                [two(row(8), row(12)), two(row(9), row(13)), two(row(10), row(14)), two(row(11), row(15))];
            let ([x, y, z], [u, v, w]) = (columns_of(low), columns_of(high));
            [Self(x, u), Self(y, v), Self(z, w)]
        }
        #[inline(always)]
        fn lanes(self) -> [u32; 16] {
            let mut out = [0; 16];
            // SAFETY: AVX2 was found, and there is room for twice eight numbers.
            unsafe {
                _mm256_storeu_si256(out.as_mut_ptr().cast(), self.0);
                _mm256_storeu_si256(out[8..].as_mut_ptr().cast(), self.1);
            }
            out
        }
        #[inline(always)]
        fn at(self, numbers: Self) -> Self {
            // SAFETY: AVX2 was found. The bits stay what they are.
            unsafe {
                let all = FloatPair(_mm256_castsi256_ps(self.0), _mm256_castsi256_ps(self.1)).at(numbers);
                Self(_mm256_castps_si256(all.0), _mm256_castps_si256(all.1))
            }
        }
        #[inline(always)]
        fn packed(self, bits: Bits) -> [u32; 16] {
            let mut out = [0u32; 16];
            let (low, high) = (packed(self.0, bits as u8), packed(self.1, (bits >> 8) as u8));
            let first = (bits as u8).count_ones() as usize;
            // SAFETY: AVX2 was found, and there is room for eight numbers behind each of the first nine places.
            unsafe {
                _mm256_storeu_si256(out.as_mut_ptr().cast(), low);
                _mm256_storeu_si256(out[first..first + 8].as_mut_ptr().cast(), high);
            }
            out
        }
        #[inline(always)]
        fn shifted_left(self, bits: u32) -> Self {
            // SAFETY: AVX2 was found.
            unsafe {
                let bits = _mm_cvtsi32_si128(bits as i32);
                Self(_mm256_sll_epi32(self.0, bits), _mm256_sll_epi32(self.1, bits))
            }
        }
        #[inline(always)]
        fn shifted_right(self, bits: u32) -> Self {
            // SAFETY: AVX2 was found.
            unsafe {
                let bits = _mm_cvtsi32_si128(bits as i32);
                Self(_mm256_srl_epi32(self.0, bits), _mm256_srl_epi32(self.1, bits))
            }
        }
        #[inline(always)]
        fn below(self, other: Self) -> Bits {
            // Not less is to be the greater one.
            let greater = self.max(other);
            // SAFETY: AVX2 was found.
            let not_less =
                unsafe { (_mm256_cmpeq_epi32(greater.0, self.0), _mm256_cmpeq_epi32(greater.1, self.1)) };
            // SAFETY: as above.
            !unsafe { FloatPair::bits((_mm256_castsi256_ps(not_less.0), _mm256_castsi256_ps(not_less.1))) }
        }
        #[inline(always)]
        fn greatest(self) -> u32 {
            self.lanes().into_iter().fold(0, u32::max)
        }
        #[inline(always)]
        fn floats(self) -> FloatPair {
            // SAFETY: AVX2 was found.
            unsafe { FloatPair(_mm256_cvtepi32_ps(self.0), _mm256_cvtepi32_ps(self.1)) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[cfg(target_arch = "x86_64")]
    use crate::exec::Avx2;
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
                if let Some(proof) = crate::exec::Avx512::found() {
                    prop_assert_eq!(&same::<FloatVector>(proof, &rows, some), &plain);
                }
                if let Some(proof) = Avx2::found() {
                    prop_assert_eq!(&same::<FloatPair>(proof, &rows, some), &plain);
                }
            }
        }
    }
}
