//! Which edges does an isovalue cross, which tetrahedra? 64 corners at a time, with AVX-512's
//! instructions for tables of bytes: a byte for each corner gives its side, a bit for each end or
//! corner comes out, and the numbers of those that are crossed are packed without a branch.
#![allow(unsafe_code)]

use super::super::patch::CORNERS;
use super::OPEN;

/// A byte for each corner; the lowest bit counts.
pub(super) type Table = [u8; CORNERS];

/// Proof that the machine has what is needed, and that it may be used.
#[derive(Clone, Copy)]
pub(in super::super) struct ByteTables(());

impl ByteTables {
    /// Looks for it.
    #[inline]
    pub(in super::super) fn found() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if crate::simd::Avx512::found().is_some()
            && crate::simd::may_use_all!(
                "AVX512BW" = "avx512bw",
                "AVX512_VBMI" = "avx512vbmi",
                "AVX512_VBMI2" = "avx512vbmi2"
            )
        {
            return Some(Self(()));
        }
        None
    }

    /// Lists the numbers of the edges between corners on different sides, and of those of them
    /// whose slot is an [`OPEN`] one; returns how many of each there are.
    ///
    /// # Panics
    /// When there is not a slot for each edge, or no room for [`SPARE`] more than are found.
    #[inline]
    pub(super) fn edges(
        self,
        table: &Table,
        edges: &[[u8; 2]],
        slots: &[u16],
        out: [&mut [u16]; 2],
    ) -> [usize; 2] {
        #[cfg(target_arch = "x86_64")]
        {
            // SAFETY: there is a proof that the features were found.
            unsafe { edges_on(table, edges, slots, out) }
        }
        #[cfg(not(target_arch = "x86_64"))]
        unreachable!("there is no proof for {table:?}, {edges:?}, {slots:?}, {out:?}")
    }

    /// Lists the numbers of the tetrahedra with corners on both sides, and their corners inside;
    /// returns how many there are.
    ///
    /// # Panics
    /// When there is no room for [`SPARE`] more than are found.
    #[inline]
    pub(super) fn tets(self, table: &Table, tets: &[[u8; 4]], out: &mut [[u16; 2]]) -> usize {
        #[cfg(target_arch = "x86_64")]
        {
            // SAFETY: there is a proof that the features were found.
            unsafe { tets_on(table, tets, out) }
        }
        #[cfg(not(target_arch = "x86_64"))]
        unreachable!("there is no proof for {table:?}, {tets:?}, {out:?}")
    }
}

/// This many numbers are written behind the last one.
pub(super) const SPARE: usize = 32;

#[cfg(target_arch = "x86_64")]
mod vectors {
    use super::{CORNERS, OPEN, SPARE, Table};
    use std::arch::x86_64::*;

    /// The table, in registers.
    #[derive(Clone, Copy)]
    struct Bytes([__m512i; 4]);

    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vbmi2,bmi2")]
    fn load<T: bytemuck::Pod>(items: &[T]) -> __m512i {
        let bytes: &[u8; 64] = bytemuck::cast_slice(items).try_into().expect("64 bytes");
        // SAFETY: there are 64 bytes to be read.
        unsafe { _mm512_loadu_si512(bytes.as_ptr().cast()) }
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vbmi2,bmi2")]
    fn store<T: bytemuck::Pod>(items: &mut [T], value: __m512i) {
        let bytes: &mut [u8; 64] = bytemuck::cast_slice_mut(items).try_into().expect("64 bytes");
        // SAFETY: there are 64 bytes to be written.
        unsafe { _mm512_storeu_si512(bytes.as_mut_ptr().cast(), value) }
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vbmi2,bmi2")]
    fn bytes_of(table: &Table) -> Bytes {
        let quarters: &[[u8; 64]; CORNERS / 64] = bytemuck::cast_ref(table);
        let [a, b, c, d] = quarters;
        Bytes([load(a), load(b), load(c), load(d)])
    }

    /// The bits of 64 corners, the first one lowest.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vbmi2,bmi2")]
    fn bits(Bytes([a, b, c, d]): Bytes, corners: __m512i) -> u64 {
        let (low, high) = (_mm512_permutex2var_epi8(a, corners, b), _mm512_permutex2var_epi8(c, corners, d));
        let found = _mm512_mask_blend_epi8(_mm512_movepi8_mask(corners), low, high);
        _mm512_test_epi8_mask(found, _mm512_set1_epi8(1))
    }

    /// 64 bytes of a list from an item on; zeros behind the last, and how many items there are.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vbmi2,bmi2")]
    fn part<T: bytemuck::Pod>(items: &[T], from: usize) -> (__m512i, usize) {
        let most = 64 / size_of::<T>();
        let rest = &items[from..];
        if rest.len() >= most {
            return (load(&rest[..most]), most);
        }
        let mut last = [0u8; 64];
        last[..size_of_val(rest)].copy_from_slice(bytemuck::cast_slice(rest));
        (load(&last), rest.len())
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vbmi2,bmi2")]
    pub(super) fn edges_on(
        table: &Table,
        edges: &[[u8; 2]],
        slots: &[u16],
        [all, open]: [&mut [u16]; 2],
    ) -> [usize; 2] {
        assert_eq!(edges.len(), slots.len(), "a slot for each edge");
        let table = bytes_of(table);
        let mut numbers = load(&std::array::from_fn::<u16, SPARE, _>(|i| i as u16));
        let mut count = [0; 2];
        for from in (0..edges.len()).step_by(SPARE) {
            let (corners, here) = part(edges, from);
            let sides = bits(table, corners);
            let crossed = _pext_u64(sides ^ sides >> 1, u64::MAX / 3) as u32 & (u32::MAX >> (SPARE - here));
            let is_open = _mm512_test_epi16_mask(part(slots, from).0, _mm512_set1_epi16(OPEN as i16));
            for (n, (out, mask)) in
                [(&mut *all, crossed), (&mut *open, crossed & is_open)].into_iter().enumerate()
            {
                store(&mut out[count[n]..][..SPARE], _mm512_maskz_compress_epi16(mask, numbers));
                count[n] += mask.count_ones() as usize;
            }
            numbers = _mm512_add_epi16(numbers, _mm512_set1_epi16(SPARE as i16));
        }
        count
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vbmi2,bmi2")]
    pub(super) fn tets_on(table: &Table, tets: &[[u8; 4]], out: &mut [[u16; 2]]) -> usize {
        const TETS: usize = 16;
        let table = bytes_of(table);
        let mut numbers = load(&std::array::from_fn::<u32, TETS, _>(|i| i as u32));
        let shifts = load(&std::array::from_fn::<u32, TETS, _>(|i| 4 * (i as u32 % 8)));
        let mut count = 0;
        for from in (0..tets.len()).step_by(TETS) {
            let (corners, here) = part(tets, from);
            let sides = bits(table, corners);
            let (any, all) = (sides | sides >> 1, sides & sides >> 1);
            let mixed = _pext_u64((any | any >> 2) & !(all & all >> 2), u64::MAX / 15) as u16;
            let active = mixed & (u16::MAX >> (TETS - here));
            // The corners inside of each, four bits, above its number.
            let halves = _mm512_mask_blend_epi32(
                0xff00,
                _mm512_set1_epi32(sides as i32),
                _mm512_set1_epi32((sides >> 32) as i32),
            );
            let inside = _mm512_and_si512(_mm512_srlv_epi32(halves, shifts), _mm512_set1_epi32(15));
            let both = _mm512_or_si512(_mm512_slli_epi32::<16>(inside), numbers);
            store(&mut out[count..][..TETS], _mm512_maskz_compress_epi32(active, both));
            count += active.count_ones() as usize;
            numbers = _mm512_add_epi32(numbers, _mm512_set1_epi32(TETS as i32));
        }
        count
    }
}

#[cfg(target_arch = "x86_64")]
use vectors::{edges_on, tets_on};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_crossed_is_found() {
        let Some(tables) = ByteTables::found() else { return };
        let table: Table = std::array::from_fn(|i| [1, 16, 0, 17][i * 7 % 11 % 4]);
        let side = |corner: u8| table[usize::from(corner)] & 1 == 1;
        let random = |i: u32| (i.wrapping_mul(2_654_435_761) >> 13) as u8;
        let edges: Vec<[u8; 2]> = (0..1000).map(|i| [random(2 * i), random(2 * i + 1)]).collect();
        let slots: Vec<u16> = (0..1000).map(|i| (u16::from(random(i * 5)) << 8) | (i as u16 % 256)).collect();
        let tets: Vec<[u8; 4]> = (0..1000).map(|i| [0, 1, 2, 3].map(|c| random(4 * i + c))).collect();
        for n in [0, 1, 15, 16, 17, 31, 32, 33, 63, 64, 65, 1000] {
            let (mut all, mut open) = ([7; 1000 + SPARE], [7; 1000 + SPARE]);
            let [a, b] = tables.edges(&table, &edges[..n], &slots[..n], [&mut all, &mut open]);
            let is_crossed = |e: &u16| side(edges[usize::from(*e)][0]) != side(edges[usize::from(*e)][1]);
            let crossed: Vec<u16> = (0..n as u16).filter(is_crossed).collect();
            assert_eq!(all[..a], crossed);
            let is_open = |e: &u16| slots[usize::from(*e)] & OPEN != 0;
            assert_eq!(open[..b], crossed.into_iter().filter(is_open).collect::<Vec<_>>());
            let mut out = [[7; 2]; 1000 + SPARE];
            let count = tables.tets(&table, &tets[..n], &mut out);
            let inside = |t: &[u8; 4]| (0..4).map(|i| u16::from(side(t[i])) << i).sum::<u16>();
            let active = (0..).zip(&tets[..n]).map(|(i, t)| [i, inside(t)]).filter(|t| t[1] % 15 != 0);
            assert_eq!(out[..count], active.collect::<Vec<_>>());
        }
    }
}
