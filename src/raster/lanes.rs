//! Four `f32` at a time: what every x86-64 has, and the same in plain code elsewhere.
#![allow(unsafe_code)]

/// Four lanes.
#[derive(Clone, Copy)]
pub(super) struct Four(imp::Lanes);

impl Four {
    #[inline(always)]
    pub(super) fn new(lanes: [f32; 4]) -> Self {
        Self(imp::new(lanes))
    }

    /// A position and 0; coordinates of at most 24 bits, and 2^24, are exact.
    #[inline(always)]
    pub(super) fn position(p: [u32; 3]) -> Self {
        Self(imp::position(p))
    }

    /// The first three lanes of four rows as three columns.
    #[inline(always)]
    pub(super) fn columns(rows: [Self; 4]) -> [Self; 3] {
        imp::columns(rows.map(|r| r.0)).map(Self)
    }

    #[inline(always)]
    pub(super) fn splat(x: f32) -> Self {
        Self::new([x; 4])
    }

    #[inline(always)]
    pub(super) fn lanes(self) -> [f32; 4] {
        imp::lanes(self.0)
    }

    #[inline(always)]
    pub(super) fn plus(self, other: Self) -> Self {
        Self(imp::add(self.0, other.0))
    }

    #[inline(always)]
    pub(super) fn minus(self, other: Self) -> Self {
        Self(imp::sub(self.0, other.0))
    }

    #[inline(always)]
    pub(super) fn times(self, other: Self) -> Self {
        Self(imp::mul(self.0, other.0))
    }

    /// The lesser of each pair; of numbers.
    #[inline(always)]
    pub(super) fn min(self, other: Self) -> Self {
        Self(imp::min(self.0, other.0))
    }

    /// The greater of each pair; of numbers.
    #[inline(always)]
    pub(super) fn max(self, other: Self) -> Self {
        Self(imp::max(self.0, other.0))
    }

    /// Lanes 1, 2, 0, 3.
    #[inline(always)]
    pub(super) fn turned(self) -> Self {
        Self(imp::turned(self.0))
    }

    /// Each lane in all four.
    #[inline(always)]
    pub(super) fn spread(self) -> [Self; 4] {
        let [a, b, c, d] = self.lanes();
        [Self::splat(a), Self::splat(b), Self::splat(c), Self::splat(d)]
    }

    /// Bit i is the sign of lane i.
    #[inline(always)]
    pub(super) fn signs(self) -> u32 {
        imp::signs(self.0)
    }
}

#[cfg(target_arch = "x86_64")]
mod imp {
    use std::arch::x86_64::*;

    pub(super) type Lanes = __m128;

    #[inline(always)]
    pub(super) fn new([a, b, c, d]: [f32; 4]) -> Lanes {
        // SAFETY: every x86-64 has SSE.
        unsafe { _mm_setr_ps(a, b, c, d) }
    }
    #[inline(always)]
    pub(super) fn lanes(x: Lanes) -> [f32; 4] {
        bytemuck::cast(x)
    }
    #[inline(always)]
    pub(super) fn add(x: Lanes, y: Lanes) -> Lanes {
        // SAFETY: every x86-64 has SSE.
        unsafe { _mm_add_ps(x, y) }
    }
    #[inline(always)]
    pub(super) fn sub(x: Lanes, y: Lanes) -> Lanes {
        // SAFETY: every x86-64 has SSE.
        unsafe { _mm_sub_ps(x, y) }
    }
    #[inline(always)]
    pub(super) fn mul(x: Lanes, y: Lanes) -> Lanes {
        // SAFETY: every x86-64 has SSE.
        unsafe { _mm_mul_ps(x, y) }
    }
    #[inline(always)]
    pub(super) fn min(x: Lanes, y: Lanes) -> Lanes {
        // SAFETY: every x86-64 has SSE.
        unsafe { _mm_min_ps(x, y) }
    }
    #[inline(always)]
    pub(super) fn max(x: Lanes, y: Lanes) -> Lanes {
        // SAFETY: every x86-64 has SSE.
        unsafe { _mm_max_ps(x, y) }
    }
    #[inline(always)]
    pub(super) fn position([x, y, z]: [u32; 3]) -> Lanes {
        // SAFETY: every x86-64 has SSE2.
        unsafe { _mm_cvtepi32_ps(_mm_setr_epi32(x as i32, y as i32, z as i32, 0)) }
    }
    #[inline(always)]
    pub(super) fn columns([a, b, c, d]: [Lanes; 4]) -> [Lanes; 3] {
        // SAFETY: every x86-64 has SSE.
        unsafe {
            let (ab, cd) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
            let (ab_high, cd_high) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
            [_mm_movelh_ps(ab, cd), _mm_movehl_ps(cd, ab), _mm_movelh_ps(ab_high, cd_high)]
        }
    }
    #[inline(always)]
    pub(super) fn turned(x: Lanes) -> Lanes {
        // SAFETY: every x86-64 has SSE.
        unsafe { _mm_shuffle_ps::<0b11_00_10_01>(x, x) }
    }
    #[inline(always)]
    pub(super) fn signs(x: Lanes) -> u32 {
        // SAFETY: every x86-64 has SSE.
        (unsafe { _mm_movemask_ps(x) }) as u32
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod imp {
    pub(super) type Lanes = [f32; 4];

    #[inline(always)]
    pub(super) fn new(lanes: [f32; 4]) -> Lanes {
        lanes
    }
    #[inline(always)]
    pub(super) fn lanes(x: Lanes) -> [f32; 4] {
        x
    }
    #[inline(always)]
    pub(super) fn add(x: Lanes, y: Lanes) -> Lanes {
        std::array::from_fn(|i| x[i] + y[i])
    }
    #[inline(always)]
    pub(super) fn sub(x: Lanes, y: Lanes) -> Lanes {
        std::array::from_fn(|i| x[i] - y[i])
    }
    #[inline(always)]
    pub(super) fn mul(x: Lanes, y: Lanes) -> Lanes {
        std::array::from_fn(|i| x[i] * y[i])
    }
    #[inline(always)]
    pub(super) fn min(x: Lanes, y: Lanes) -> Lanes {
        std::array::from_fn(|i| if x[i] < y[i] { x[i] } else { y[i] })
    }
    #[inline(always)]
    pub(super) fn max(x: Lanes, y: Lanes) -> Lanes {
        std::array::from_fn(|i| if x[i] > y[i] { x[i] } else { y[i] })
    }
    #[inline(always)]
    pub(super) fn position([x, y, z]: [u32; 3]) -> Lanes {
        [x as f32, y as f32, z as f32, 0.0]
    }
    #[inline(always)]
    pub(super) fn columns([a, b, c, d]: [Lanes; 4]) -> [Lanes; 3] {
        [0, 1, 2].map(|k| [a[k], b[k], c[k], d[k]])
    }
    #[inline(always)]
    pub(super) fn turned([a, b, c, d]: Lanes) -> Lanes {
        [b, c, a, d]
    }
    #[inline(always)]
    pub(super) fn signs(x: Lanes) -> u32 {
        (0..4).map(|i| (x[i].to_bits() >> 31) << i).sum()
    }
}
