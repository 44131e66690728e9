//! Some `f64` at a time: vectors of AVX2 and AVX-512, and the same in plain code, with the same
//! bits.
#![allow(unsafe_code)]

/// Lanes. Each operation is that of each lane by itself, rounded once.
pub(crate) trait Wide: Copy {
    /// What must be known before there are such lanes.
    type Proof: Copy;
    /// The lanes as an array.
    type Lanes: bytemuck::Pod;
    /// A bit for each lane, in some form.
    type Mask: Copy;
    fn of(proof: Self::Proof, lanes: &Self::Lanes) -> Self;
    fn splat(proof: Self::Proof, x: f64) -> Self;
    fn lanes(self) -> Self::Lanes;
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    /// This times the one, plus the other: rounded once.
    fn times_plus(self, factor: Self, more: Self) -> Self;
    /// This divided by the other.
    fn over(self, other: Self) -> Self;
    /// The square root.
    fn root(self) -> Self;
    /// The largest integer that is not above.
    fn floor(self) -> Self;
    /// This where it is less, else the other.
    fn min(self, other: Self) -> Self;
    /// This where it is greater, else the other.
    fn max(self, other: Self) -> Self;
    /// Where this is less.
    fn below(self, other: Self) -> Self::Mask;
    /// Where this is not NaN.
    fn is_number(self) -> Self::Mask;
    /// The one number where a mask is set, else the other.
    fn pick(mask: Self::Mask, set: Self, unset: Self) -> Self;
    /// A mask as a number: bit k is that of lane k.
    fn bits(mask: Self::Mask) -> u32;
}

/// `N` lanes, from `f32` and back.
pub(crate) trait Floats<const N: usize>: Wide<Lanes = [f64; N]> {
    fn of_floats(proof: Self::Proof, lanes: &[f32; N]) -> Self;
    /// Each rounded.
    fn floats(self) -> [f32; N];
    /// In each lane the first where it is less, else the second: a NaN that comes first changes
    /// nothing.
    fn lesser(proof: Self::Proof, a: &[f32; N], b: &[f32; N]) -> [f32; N];
    /// In each lane the first where it is greater, else the second.
    fn greater(proof: Self::Proof, a: &[f32; N], b: &[f32; N]) -> [f32; N];
}

/// Four lanes.
pub(crate) trait Four: Floats<4> {
    /// Four rows as four columns.
    fn columns(rows: [Self; 4]) -> [Self; 4];
}

/// The places of the bits that are set in a byte, ascending.
pub(crate) static PLACES: [[u8; 8]; 256] = {
    let (mut places, mut byte) = ([[0; 8]; 256], 0);
    while byte < 256 {
        let (mut bit, mut n) = (0, 0);
        while bit < 8 {
            if byte >> bit & 1 == 1 {
                places[byte][n] = bit;
                n += 1;
            }
            bit += 1;
        }
        byte += 1;
    }
    places
};

/// As `[0, 1, 2].map`, which is inlined where the compiler likes it; but a vector that crosses a
/// call is no gain.
#[inline(always)]
pub(crate) fn three<T>(mut of: impl FnMut(usize) -> T) -> [T; 3] {
    [of(0), of(1), of(2)]
}

/// As `[0, 1, 2, 3].map`.
#[inline(always)]
pub(crate) fn four<T>(mut of: impl FnMut(usize) -> T) -> [T; 4] {
    [of(0), of(1), of(2), of(3)]
}

/// The lesser and the greater one of each pair.
#[inline(always)]
fn exchanged<W: Wide>(a: W, b: W) -> (W, W) {
    (a.min(b), b.max(a))
}

/// Four in ascending order, by a network of exchanges.
#[inline(always)]
pub(crate) fn sorted<W: Wide>([a, b, c, d]: [W; 4]) -> [W; 4] {
    let ((a, b), (c, d)) = (exchanged(a, b), exchanged(c, d));
    let ((a, c), (b, d)) = (exchanged(a, c), exchanged(b, d));
    let (b, c) = exchanged(b, c);
    [a, b, c, d]
}

/// Everywhere, and of any number.
#[derive(Clone, Copy)]
pub(crate) struct Plain<const N: usize = 4>([f64; N]);

impl<const N: usize> Plain<N> {
    #[inline(always)]
    fn each(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        Self(std::array::from_fn(|k| f(self.0[k], other.0[k])))
    }
}

impl<const N: usize> Wide for Plain<N>
where
    [f64; N]: bytemuck::Pod,
{
    type Proof = ();
    type Lanes = [f64; N];
    type Mask = [bool; N];
    #[inline(always)]
    fn of((): (), lanes: &[f64; N]) -> Self {
        Self(*lanes)
    }
    #[inline(always)]
    fn splat((): (), x: f64) -> Self {
        Self([x; N])
    }
    #[inline(always)]
    fn lanes(self) -> [f64; N] {
        self.0
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.each(other, |a, b| a + b)
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
        Self(std::array::from_fn(|k| self.0[k].mul_add(factor.0[k], more.0[k])))
    }
    #[inline(always)]
    fn over(self, other: Self) -> Self {
        self.each(other, |a, b| a / b)
    }
    #[inline(always)]
    fn root(self) -> Self {
        Self(self.0.map(f64::sqrt))
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self(self.0.map(f64::floor))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.each(other, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.each(other, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn below(self, other: Self) -> [bool; N] {
        std::array::from_fn(|k| self.0[k] < other.0[k])
    }
    #[inline(always)]
    fn is_number(self) -> [bool; N] {
        self.0.map(|x| !x.is_nan())
    }
    #[inline(always)]
    fn pick(mask: [bool; N], set: Self, unset: Self) -> Self {
        Self(std::array::from_fn(|k| if mask[k] { set.0[k] } else { unset.0[k] }))
    }
    #[inline(always)]
    fn bits(mask: [bool; N]) -> u32 {
        mask.iter().enumerate().map(|(k, &set)| u32::from(set) << k).sum()
    }
}

impl<const N: usize> Floats<N> for Plain<N>
where
    [f64; N]: bytemuck::Pod,
{
    #[inline(always)]
    fn of_floats((): (), lanes: &[f32; N]) -> Self {
        Self(lanes.map(f64::from))
    }
    #[inline(always)]
    fn floats(self) -> [f32; N] {
        self.0.map(|x| x as f32)
    }
    #[inline(always)]
    fn lesser((): (), a: &[f32; N], b: &[f32; N]) -> [f32; N] {
        std::array::from_fn(|k| if a[k] < b[k] { a[k] } else { b[k] })
    }
    #[inline(always)]
    fn greater((): (), a: &[f32; N], b: &[f32; N]) -> [f32; N] {
        std::array::from_fn(|k| if a[k] > b[k] { a[k] } else { b[k] })
    }
}

impl Four for Plain {
    #[inline(always)]
    fn columns(rows: [Self; 4]) -> [Self; 4] {
        [0, 1, 2, 3].map(|k| Self(rows.map(|r| r.0[k])))
    }
}

/// Eight lanes, as two times four.
#[derive(Clone, Copy)]
pub(crate) struct Pair<W>(W, W);

impl<W: Four> Wide for Pair<W> {
    type Proof = W::Proof;
    type Lanes = [f64; 8];
    type Mask = (W::Mask, W::Mask);
    #[inline(always)]
    fn of(proof: W::Proof, &[a, b, c, d, e, f, g, h]: &[f64; 8]) -> Self {
        Self(W::of(proof, &[a, b, c, d]), W::of(proof, &[e, f, g, h]))
    }
    #[inline(always)]
    fn splat(proof: W::Proof, x: f64) -> Self {
        let all = W::splat(proof, x);
        Self(all, all)
    }
    #[inline(always)]
    fn lanes(self) -> [f64; 8] {
        let ([a, b, c, d], [e, f, g, h]) = (self.0.lanes(), self.1.lanes());
        [a, b, c, d, e, f, g, h]
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        Self(self.0.plus(other.0), self.1.plus(other.1))
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        Self(self.0.minus(other.0), self.1.minus(other.1))
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Self(self.0.times(other.0), self.1.times(other.1))
    }
    #[inline(always)]
    fn times_plus(self, factor: Self, more: Self) -> Self {
        Self(self.0.times_plus(factor.0, more.0), self.1.times_plus(factor.1, more.1))
    }
    #[inline(always)]
    fn over(self, other: Self) -> Self {
        Self(self.0.over(other.0), self.1.over(other.1))
    }
    #[inline(always)]
    fn root(self) -> Self {
        Self(self.0.root(), self.1.root())
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self(self.0.floor(), self.1.floor())
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0), self.1.min(other.1))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0), self.1.max(other.1))
    }
    #[inline(always)]
    fn below(self, other: Self) -> Self::Mask {
        (self.0.below(other.0), self.1.below(other.1))
    }
    #[inline(always)]
    fn is_number(self) -> Self::Mask {
        (self.0.is_number(), self.1.is_number())
    }
    #[inline(always)]
    fn pick(mask: Self::Mask, set: Self, unset: Self) -> Self {
        Self(W::pick(mask.0, set.0, unset.0), W::pick(mask.1, set.1, unset.1))
    }
    #[inline(always)]
    fn bits(mask: Self::Mask) -> u32 {
        W::bits(mask.0) | W::bits(mask.1) << 4
    }
}

impl<W: Four> Floats<8> for Pair<W> {
    #[inline(always)]
    fn of_floats(proof: W::Proof, &[a, b, c, d, e, f, g, h]: &[f32; 8]) -> Self {
        Self(W::of_floats(proof, &[a, b, c, d]), W::of_floats(proof, &[e, f, g, h]))
    }
    #[inline(always)]
    fn floats(self) -> [f32; 8] {
        let ([a, b, c, d], [e, f, g, h]) = (self.0.floats(), self.1.floats());
        [a, b, c, d, e, f, g, h]
    }
    #[inline(always)]
    fn lesser(proof: W::Proof, a: &[f32; 8], b: &[f32; 8]) -> [f32; 8] {
        let ([a, more_a], [b, more_b]) = (halves(a), halves(b));
        bytemuck::cast([W::lesser(proof, a, b), W::lesser(proof, more_a, more_b)])
    }
    #[inline(always)]
    fn greater(proof: W::Proof, a: &[f32; 8], b: &[f32; 8]) -> [f32; 8] {
        let ([a, more_a], [b, more_b]) = (halves(a), halves(b));
        bytemuck::cast([W::greater(proof, a, b), W::greater(proof, more_a, more_b)])
    }
}

#[inline(always)]
fn halves(all: &[f32; 8]) -> &[[f32; 4]; 2] {
    bytemuck::cast_ref(all)
}

#[cfg(target_arch = "x86_64")]
pub(crate) use vectors::{Eight, Vector, turned};

/// Vectors are made with a proof only, so the machine has the instructions. They are of use in code
/// that is compiled for these.
#[cfg(target_arch = "x86_64")]
mod vectors {
    use super::{Floats, Four, Wide};
    use crate::exec::{Avx2, Avx512};
    use std::arch::x86_64::*;

    /// Four lanes of AVX2.
    #[derive(Clone, Copy)]
    pub(crate) struct Vector(__m256d);

    /// Eight lanes of AVX-512.
    #[derive(Clone, Copy)]
    pub(crate) struct Eight(__m512d);

    macro_rules! wide {
        (
            $t:ident, $proof:ty, $lanes:ty, $mask:ty, $load:ident, $store:ident, $splat:ident, $add:ident, $sub:ident, $mul:ident, $fma:ident,
            $div:ident, $sqrt:ident, $floor:ident, $min:ident, $max:ident
        ) => {
            impl Wide for $t {
                type Proof = $proof;
                type Lanes = $lanes;
                type Mask = $mask;
                #[inline(always)]
                fn of(_: $proof, lanes: &$lanes) -> Self {
                    // SAFETY: the instructions were found, and there are as many numbers to be
                    // read.
                    Self(unsafe { $load(lanes.as_ptr()) })
                }
                #[inline(always)]
                fn splat(_: $proof, x: f64) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $splat(x) })
                }
                #[inline(always)]
                fn lanes(self) -> $lanes {
                    let mut out: $lanes = [0.0; size_of::<$lanes>() / 8];
                    // SAFETY: the instructions were found, and there is room for all numbers.
                    unsafe { $store(out.as_mut_ptr(), self.0) };
                    out
                }
                #[inline(always)]
                fn plus(self, other: Self) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $add(self.0, other.0) })
                }
                #[inline(always)]
                fn minus(self, other: Self) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $sub(self.0, other.0) })
                }
                #[inline(always)]
                fn times(self, other: Self) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $mul(self.0, other.0) })
                }
                #[inline(always)]
                fn times_plus(self, factor: Self, more: Self) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $fma(self.0, factor.0, more.0) })
                }
                #[inline(always)]
                fn over(self, other: Self) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $div(self.0, other.0) })
                }
                #[inline(always)]
                fn root(self) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $sqrt(self.0) })
                }
                #[inline(always)]
                fn floor(self) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $floor::<{ _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC }>(self.0) })
                }
                #[inline(always)]
                fn min(self, other: Self) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $min(self.0, other.0) })
                }
                #[inline(always)]
                fn max(self, other: Self) -> Self {
                    // SAFETY: the instructions were found.
                    Self(unsafe { $max(self.0, other.0) })
                }
                #[inline(always)]
                fn below(self, other: Self) -> $mask {
                    self.is_below(other)
                }
                #[inline(always)]
                fn is_number(self) -> $mask {
                    self.is_ordered()
                }
                #[inline(always)]
                fn pick(mask: $mask, set: Self, unset: Self) -> Self {
                    Self::picked(mask, set, unset)
                }
                #[inline(always)]
                fn bits(mask: $mask) -> u32 {
                    Self::bits_of(mask)
                }
            }
        };
    }

    wide!(
        Vector,
        Avx2,
        [f64; 4],
        __m256d,
        _mm256_loadu_pd,
        _mm256_storeu_pd,
        _mm256_set1_pd,
        _mm256_add_pd,
        _mm256_sub_pd,
        _mm256_mul_pd,
        _mm256_fmadd_pd,
        _mm256_div_pd,
        _mm256_sqrt_pd,
        _mm256_round_pd,
        _mm256_min_pd,
        _mm256_max_pd
    );

    impl Vector {
        #[inline(always)]
        fn is_below(self, other: Self) -> __m256d {
            // SAFETY: AVX2 was found.
            unsafe { _mm256_cmp_pd::<_CMP_LT_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn is_ordered(self) -> __m256d {
            // SAFETY: AVX2 was found.
            unsafe { _mm256_cmp_pd::<_CMP_ORD_Q>(self.0, self.0) }
        }
        #[inline(always)]
        fn picked(mask: __m256d, set: Self, unset: Self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_blendv_pd(unset.0, set.0, mask) })
        }
        #[inline(always)]
        fn bits_of(mask: __m256d) -> u32 {
            // SAFETY: AVX2 was found.
            (unsafe { _mm256_movemask_pd(mask) }) as u32
        }
    }

    wide!(
        Eight,
        Avx512,
        [f64; 8],
        __mmask8,
        _mm512_loadu_pd,
        _mm512_storeu_pd,
        _mm512_set1_pd,
        _mm512_add_pd,
        _mm512_sub_pd,
        _mm512_mul_pd,
        _mm512_fmadd_pd,
        _mm512_div_pd,
        _mm512_sqrt_pd,
        _mm512_roundscale_pd,
        _mm512_min_pd,
        _mm512_max_pd
    );

    impl Eight {
        #[inline(always)]
        fn is_below(self, other: Self) -> __mmask8 {
            // SAFETY: AVX-512 was found.
            unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn is_ordered(self) -> __mmask8 {
            // SAFETY: AVX-512 was found.
            unsafe { _mm512_cmp_pd_mask::<_CMP_ORD_Q>(self.0, self.0) }
        }
        #[inline(always)]
        fn picked(mask: __mmask8, set: Self, unset: Self) -> Self {
            // SAFETY: AVX-512 was found.
            Self(unsafe { _mm512_mask_blend_pd(mask, unset.0, set.0) })
        }
        #[inline(always)]
        fn bits_of(mask: __mmask8) -> u32 {
            u32::from(mask)
        }
    }

    impl Floats<8> for Eight {
        #[inline(always)]
        fn of_floats(_: Avx512, lanes: &[f32; 8]) -> Self {
            // SAFETY: AVX-512 was found, and there are eight numbers to be read.
            Self(unsafe { _mm512_cvtps_pd(_mm256_loadu_ps(lanes.as_ptr())) })
        }
        #[inline(always)]
        fn floats(self) -> [f32; 8] {
            // SAFETY: AVX-512 was found.
            bytemuck::cast(unsafe { _mm512_cvtpd_ps(self.0) })
        }
        #[inline(always)]
        fn lesser(_: Avx512, a: &[f32; 8], b: &[f32; 8]) -> [f32; 8] {
            // SAFETY: AVX-512 was found, and there are eight numbers to be read.
            bytemuck::cast(unsafe { _mm256_min_ps(_mm256_loadu_ps(a.as_ptr()), _mm256_loadu_ps(b.as_ptr())) })
        }
        #[inline(always)]
        fn greater(_: Avx512, a: &[f32; 8], b: &[f32; 8]) -> [f32; 8] {
            // SAFETY: AVX-512 was found, and there are eight numbers to be read.
            bytemuck::cast(unsafe { _mm256_max_ps(_mm256_loadu_ps(a.as_ptr()), _mm256_loadu_ps(b.as_ptr())) })
        }
    }

    impl Floats<4> for Vector {
        #[inline(always)]
        fn of_floats(_: Avx2, lanes: &[f32; 4]) -> Self {
            // SAFETY: AVX2 was found, and there are four numbers to be read.
            Self(unsafe { _mm256_cvtps_pd(_mm_loadu_ps(lanes.as_ptr())) })
        }
        #[inline(always)]
        fn floats(self) -> [f32; 4] {
            // SAFETY: AVX2 was found.
            bytemuck::cast(unsafe { _mm256_cvtpd_ps(self.0) })
        }
        #[inline(always)]
        fn lesser(_: Avx2, a: &[f32; 4], b: &[f32; 4]) -> [f32; 4] {
            // SAFETY: AVX2 was found, and there are four numbers to be read.
            bytemuck::cast(unsafe { _mm_min_ps(_mm_loadu_ps(a.as_ptr()), _mm_loadu_ps(b.as_ptr())) })
        }
        #[inline(always)]
        fn greater(_: Avx2, a: &[f32; 4], b: &[f32; 4]) -> [f32; 4] {
            // SAFETY: AVX2 was found, and there are four numbers to be read.
            bytemuck::cast(unsafe { _mm_max_ps(_mm_loadu_ps(a.as_ptr()), _mm_loadu_ps(b.as_ptr())) })
        }
    }

    /// Eight rows as eight columns: bits are moved, and nothing else. The compiler would make
    /// gathers of a loop over such.
    #[inline(always)]
    pub(crate) fn turned(_: Avx2, rows: [&[f32; 8]; 8]) -> [[f32; 8]; 8] {
        // SAFETY: AVX2 was found, and each row has eight numbers to be read.
        unsafe {
            let [a, b, c, d, e, f, g, h] = [
                _mm256_loadu_ps(rows[0].as_ptr()),
                _mm256_loadu_ps(rows[1].as_ptr()),
                _mm256_loadu_ps(rows[2].as_ptr()),
                _mm256_loadu_ps(rows[3].as_ptr()),
                _mm256_loadu_ps(rows[4].as_ptr()),
                _mm256_loadu_ps(rows[5].as_ptr()),
                _mm256_loadu_ps(rows[6].as_ptr()),
                _mm256_loadu_ps(rows[7].as_ptr()),
            ];
            let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
            let (ef, gh) = (_mm256_unpacklo_ps(e, f), _mm256_unpacklo_ps(g, h));
            let (ab_high, cd_high) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
            let (ef_high, gh_high) = (_mm256_unpackhi_ps(e, f), _mm256_unpackhi_ps(g, h));
            // Columns 0 and 4, 1 and 5, 2 and 6, 3 and 7: of the first four rows, of the last four.
            let (x0, y0) = (_mm256_shuffle_ps::<0x44>(ab, cd), _mm256_shuffle_ps::<0x44>(ef, gh));
            let (x1, y1) = (_mm256_shuffle_ps::<0xee>(ab, cd), _mm256_shuffle_ps::<0xee>(ef, gh));
            let (x2, y2) =
                (_mm256_shuffle_ps::<0x44>(ab_high, cd_high), _mm256_shuffle_ps::<0x44>(ef_high, gh_high));
            let (x3, y3) =
                (_mm256_shuffle_ps::<0xee>(ab_high, cd_high), _mm256_shuffle_ps::<0xee>(ef_high, gh_high));
            [
                bytemuck::cast(_mm256_permute2f128_ps::<0x20>(x0, y0)),
                bytemuck::cast(_mm256_permute2f128_ps::<0x20>(x1, y1)),
                bytemuck::cast(_mm256_permute2f128_ps::<0x20>(x2, y2)),
                bytemuck::cast(_mm256_permute2f128_ps::<0x20>(x3, y3)),
                bytemuck::cast(_mm256_permute2f128_ps::<0x31>(x0, y0)),
                bytemuck::cast(_mm256_permute2f128_ps::<0x31>(x1, y1)),
                bytemuck::cast(_mm256_permute2f128_ps::<0x31>(x2, y2)),
                bytemuck::cast(_mm256_permute2f128_ps::<0x31>(x3, y3)),
            ]
        }
    }

    impl Four for Vector {
        #[inline(always)]
        fn columns([a, b, c, d]: [Self; 4]) -> [Self; 4] {
            // SAFETY: AVX2 was found.
            unsafe {
                let (ab, cd) = (_mm256_unpacklo_pd(a.0, b.0), _mm256_unpacklo_pd(c.0, d.0));
                let (ab_odd, cd_odd) = (_mm256_unpackhi_pd(a.0, b.0), _mm256_unpackhi_pd(c.0, d.0));
                [
                    Self(_mm256_permute2f128_pd::<0x20>(ab, cd)),
                    Self(_mm256_permute2f128_pd::<0x20>(ab_odd, cd_odd)),
                    Self(_mm256_permute2f128_pd::<0x31>(ab, cd)),
                    Self(_mm256_permute2f128_pd::<0x31>(ab_odd, cd_odd)),
                ]
            }
        }
    }
}
