//! Where in eight numbers is one? SSE2, which each x86-64 machine has, finds it in a few
//! instructions that no compiler finds.
#![allow(unsafe_code)]

/// Eight numbers, to be compared together.
pub(super) type Eight = [u32; 8];

/// The places of a number among eight, as bits.
#[cfg(not(target_arch = "x86_64"))]
pub(super) fn places_of(eight: &Eight, wanted: u32) -> u32 {
    eight.iter().enumerate().fold(0, |bits, (i, &x)| bits | u32::from(x == wanted) << i)
}

/// The places of a number among eight, as bits.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(super) fn places_of(eight: &Eight, wanted: u32) -> u32 {
    use std::arch::x86_64::*;
    let [low, high]: [__m128i; 2] = bytemuck::cast(*eight);
    // SAFETY: SSE2 is part of x86-64.
    unsafe {
        let wanted = _mm_set1_epi32(wanted as i32);
        let (low, high) = (_mm_cmpeq_epi32(low, wanted), _mm_cmpeq_epi32(high, wanted));
        let bytes = _mm_packs_epi16(_mm_packs_epi32(low, high), _mm_setzero_si128());
        _mm_movemask_epi8(bytes) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_place_is_a_bit() {
        let eight = [5, u32::MAX, 0, 5, 7, 1 << 31, u32::MAX, 5];
        for wanted in [0, 1, 5, 7, 1 << 31, u32::MAX] {
            let expected = (0..8).filter(|&i| eight[i] == wanted).map(|i| 1 << i).sum::<u32>();
            assert_eq!(places_of(&eight, wanted), expected, "{wanted}");
        }
    }
}
