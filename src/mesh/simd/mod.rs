//! Vector code: some numbers at a time, with the same bits on every machine.
//!
//! A kernel is written once, over the traits of this module. It is compiled for each type that
//! implements them, and the machine decides at run time which of these runs:
//!
//! | | everywhere | AVX2 | AVX-512 |
//! |---|---|---|---|
//! | `f64` | [`Plain`] | `F64x4`, [`Pair`] of it | `F64x8` |
//! | `f32` | [`Plain`], [`Vec4x2`] | `F32x8`, [`Pair`] of it | `F32x16` |
//! | `u32` | [`Plain`] | `U32x8`, [`Pair`] of it | `U32x16` |
//!
//! A vector of AVX2 or AVX-512 is made from a token ([`Avx2`], [`Avx512`]). There is a token only
//! where the machine has the instructions and the user does not forbid them. Vectors are fast in
//! code that is compiled for them: closures of [`with_vectors`] and [`with_avx512`], and what is
//! inlined there. A vector that crosses a call passes through memory. So all functions here are
//! `#[inline(always)]`.
//!
//! Each operation acts on each lane by itself and rounds once; none is fused but `mul_add` and
//! `neg_mul_add`. A kernel with the same operations in the same order has the same bits.

mod features;
mod lanes;
mod pair;
mod plain;
#[cfg(test)]
mod tests;
mod vec4;
#[cfg(target_arch = "x86_64")]
mod x86;

/// Whether one instruction of all machines for which this is compiled multiplies and adds.
/// Elsewhere plain code has to call a function for that.
const HAS_FMA: bool = cfg!(any(
    target_arch = "aarch64",
    target_arch = "powerpc64",
    target_arch = "riscv64",
    target_feature = "fma"
));

#[cfg(target_arch = "x86_64")]
pub use crate::may_use_all;
pub use features::{Avx2, Avx512, may_use, with_avx512, with_vectors};
pub use lanes::{Compress, F32s, F32x16s, F64s, F64x4s, F64xN, Floats, Lanes, U32x16s};
pub use pair::Pair;
pub use plain::Plain;
pub(crate) use vec4::Vec4x2;
#[cfg(target_arch = "x86_64")]
pub use x86::{F32x8, F32x16, F64x4, F64x8, transpose_f32x8};

/// The places of the bits that are set in a byte, ascending.
pub static PLACES: [[u8; 8]; 256] = {
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

/// The places of a number among eight, as bits.
#[inline(always)]
pub fn places_among_eight(eight: &[u32; 8], wanted: u32) -> u32 {
    #[cfg(target_arch = "x86_64")]
    return x86::places_among_eight(eight, wanted);
    #[cfg(not(target_arch = "x86_64"))]
    {
        type Eight = Plain<u32, 8>;
        Eight::bitmask(Eight::load((), eight).eq(Eight::splat((), wanted)))
    }
}

/// As `[0, 1, 2].map`, but always inlined.
#[inline(always)]
pub fn three<T>(mut of: impl FnMut(usize) -> T) -> [T; 3] {
    [of(0), of(1), of(2)]
}

/// As `[0, 1, 2, 3].map`, but always inlined.
#[inline(always)]
pub fn four<T>(mut of: impl FnMut(usize) -> T) -> [T; 4] {
    [of(0), of(1), of(2), of(3)]
}

/// The lesser and the greater one of each pair.
#[inline(always)]
fn exchanged<V: Lanes>(a: V, b: V) -> (V, V) {
    (a.min(b), b.max(a))
}

/// Four in ascending order, by a network of exchanges.
#[inline(always)]
pub fn sorted<V: Lanes>([a, b, c, d]: [V; 4]) -> [V; 4] {
    let ((a, b), (c, d)) = (exchanged(a, b), exchanged(c, d));
    let ((a, c), (b, d)) = (exchanged(a, c), exchanged(b, d));
    let (b, c) = exchanged(b, c);
    [a, b, c, d]
}

/// Evaluates an expression with a type of lanes of AVX2 and its token, if there is one, else with
/// plain lanes. The expression is compiled for AVX2 as far as it is inlined.
#[macro_export]
#[doc(hidden)]
macro_rules! on_avx2_or_plain {
    ($avx2:expr, $vector:ident, $plain:ty, |$lanes:ident, $token:ident| $with:expr) => {
        match $avx2 {
            #[cfg(target_arch = "x86_64")]
            Some($token) => {
                type $lanes = $crate::simd::$vector;
                $crate::simd::with_vectors(
                    #[inline(always)]
                    || $with,
                )
            }
            _ => {
                type $lanes = $plain;
                #[allow(clippy::let_unit_value, reason = "plain lanes need no token")]
                let $token = ();
                $with
            }
        }
    };
}

/// Evaluates an expression with the widest lanes that may be used: a vector of AVX-512, or a pair
/// of vectors of AVX2, or plain ones. It is compiled for them as far as it is inlined.
#[macro_export]
#[doc(hidden)]
macro_rules! on_widest {
    ($wide:ident, $half:ident, $plain:ty, |$lanes:ident, $token:ident| $with:expr) => {
        match $crate::simd::Avx512::found() {
            #[cfg(target_arch = "x86_64")]
            Some($token) => {
                type $lanes = $crate::simd::$wide;
                $crate::simd::with_avx512(
                    $token,
                    #[inline(always)]
                    || $with,
                )
            }
            _ => match $crate::simd::Avx2::found() {
                #[cfg(target_arch = "x86_64")]
                Some($token) => {
                    type $lanes = $crate::simd::Pair<$crate::simd::$half>;
                    $crate::simd::with_vectors(
                        #[inline(always)]
                        || $with,
                    )
                }
                _ => {
                    type $lanes = $plain;
                    #[allow(clippy::let_unit_value, reason = "plain lanes need no token")]
                    let $token = ();
                    $with
                }
            },
        }
    };
}
pub use crate::on_avx2_or_plain;
pub use crate::on_widest;
