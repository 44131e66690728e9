//! Four `f64` at a time: vectors of AVX2, and the same in plain code, with the same bits.
#![allow(unsafe_code)]

/// Four lanes. A mask has lanes of all bits or none.
pub(crate) trait Wide: Copy {
    /// What must be known before there are such lanes.
    type Proof: Copy;
    fn of(proof: Self::Proof, lanes: &[f64; 4]) -> Self;
    fn splat(proof: Self::Proof, x: f64) -> Self;
    fn lanes(self) -> [f64; 4];
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    fn over(self, other: Self) -> Self;
    /// The square root.
    fn root(self) -> Self;
    /// The numbers as `f32`.
    fn narrow(self) -> [f32; 4];
    /// Rows as columns.
    fn turned(rows: [Self; 4]) -> [Self; 4];
    /// Where this is less.
    fn below(self, other: Self) -> Self;
    /// Where this is less, or equal.
    fn up_to(self, other: Self) -> Self;
    /// The bits that both have: of a mask and numbers, the numbers, or 0.
    fn and(self, other: Self) -> Self;
    /// Of a mask: the one number where it is set, else the other.
    fn pick(self, set: Self, unset: Self) -> Self;
}

/// Everywhere.
#[derive(Clone, Copy)]
pub(crate) struct Plain([f64; 4]);

impl Plain {
    #[inline(always)]
    fn each(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        Self(std::array::from_fn(|k| f(self.0[k], other.0[k])))
    }
}

#[inline(always)]
fn mask(set: bool) -> f64 {
    f64::from_bits(u64::from(set).wrapping_neg())
}

impl Wide for Plain {
    type Proof = ();
    #[inline(always)]
    fn of((): (), lanes: &[f64; 4]) -> Self {
        Self(*lanes)
    }
    #[inline(always)]
    fn splat((): (), x: f64) -> Self {
        Self([x; 4])
    }
    #[inline(always)]
    fn lanes(self) -> [f64; 4] {
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
    fn over(self, other: Self) -> Self {
        self.each(other, |a, b| a / b)
    }
    #[inline(always)]
    fn root(self) -> Self {
        Self(self.0.map(f64::sqrt))
    }
    #[inline(always)]
    fn narrow(self) -> [f32; 4] {
        self.0.map(|x| x as f32)
    }
    #[inline(always)]
    fn turned(rows: [Self; 4]) -> [Self; 4] {
        std::array::from_fn(|k| Self(rows.map(|row| row.0[k])))
    }
    #[inline(always)]
    fn below(self, other: Self) -> Self {
        self.each(other, |a, b| mask(a < b))
    }
    #[inline(always)]
    fn up_to(self, other: Self) -> Self {
        self.each(other, |a, b| mask(a <= b))
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self.each(other, |a, b| f64::from_bits(a.to_bits() & b.to_bits()))
    }
    #[inline(always)]
    fn pick(self, set: Self, unset: Self) -> Self {
        Self(std::array::from_fn(|k| if self.0[k].to_bits() == 0 { unset.0[k] } else { set.0[k] }))
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Vector;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::Wide;
    use crate::exec::Avx2;
    use std::arch::x86_64::*;

    /// To be had with the proof that there is AVX2 only: so each has been made on such a machine. Of use in code that is compiled for it.
    #[derive(Clone, Copy)]
    pub(crate) struct Vector(__m256d);

    impl Wide for Vector {
        type Proof = Avx2;
        #[inline(always)]
        fn of(_: Avx2, lanes: &[f64; 4]) -> Self {
            // SAFETY: AVX2 was found, and there are four numbers to be read.
            Self(unsafe { _mm256_loadu_pd(lanes.as_ptr()) })
        }
        #[inline(always)]
        fn splat(_: Avx2, x: f64) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_set1_pd(x) })
        }
        #[inline(always)]
        fn lanes(self) -> [f64; 4] {
            bytemuck::cast(self.0)
        }
        #[inline(always)]
        fn plus(self, other: Self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_add_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn minus(self, other: Self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_sub_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn times(self, other: Self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_mul_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn over(self, other: Self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_div_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn root(self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_sqrt_pd(self.0) })
        }
        #[inline(always)]
        fn narrow(self) -> [f32; 4] {
            // SAFETY: AVX2 was found.
            bytemuck::cast(unsafe { _mm256_cvtpd_ps(self.0) })
        }
        #[inline(always)]
        fn turned([a, b, c, d]: [Self; 4]) -> [Self; 4] {
            // SAFETY: AVX2 was found.
            unsafe {
                let (ab, ab_odd) = (_mm256_unpacklo_pd(a.0, b.0), _mm256_unpackhi_pd(a.0, b.0));
                let (cd, cd_odd) = (_mm256_unpacklo_pd(c.0, d.0), _mm256_unpackhi_pd(c.0, d.0));
                [
                    Self(_mm256_permute2f128_pd::<0x20>(ab, cd)),
                    Self(_mm256_permute2f128_pd::<0x20>(ab_odd, cd_odd)),
                    Self(_mm256_permute2f128_pd::<0x31>(ab, cd)),
                    Self(_mm256_permute2f128_pd::<0x31>(ab_odd, cd_odd)),
                ]
            }
        }
        #[inline(always)]
        fn below(self, other: Self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_cmp_pd::<_CMP_LT_OQ>(self.0, other.0) })
        }
        #[inline(always)]
        fn up_to(self, other: Self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_cmp_pd::<_CMP_LE_OQ>(self.0, other.0) })
        }
        #[inline(always)]
        fn and(self, other: Self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_and_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn pick(self, set: Self, unset: Self) -> Self {
            // SAFETY: AVX2 was found.
            Self(unsafe { _mm256_blendv_pd(unset.0, set.0, self.0) })
        }
    }
}
