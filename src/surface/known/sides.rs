//! On which side of an isovalue is each corner of each edge, of each tetrahedron? 64 bytes at a time, with AVX-512's instructions for tables of bytes.
#![allow(unsafe_code)]

use super::super::patch::CORNERS;

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
        if crate::exec::Avx512::found().is_some()
            && crate::cpu::may_use(&["AVX512BW", "AVX512_VBMI"])
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512vbmi")
        {
            return Some(Self(()));
        }
        None
    }

    /// Replaces `out` by the bits of corners, 64 in a word, the first one lowest; zeros behind the last.
    #[inline]
    pub(super) fn look_up(self, table: &Table, corners: &[u8], out: &mut Vec<u64>) {
        out.clear();
        #[cfg(target_arch = "x86_64")]
        // SAFETY: there is a proof that the features were found.
        unsafe {
            look_up(table, corners, out);
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = (table, corners);
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi")]
fn look_up(table: &Table, corners: &[u8], out: &mut Vec<u64>) {
    use std::arch::x86_64::*;
    let load = |bytes: &[u8; 64]| {
        // SAFETY: there are 64 bytes to be read.
        unsafe { _mm512_loadu_si512(bytes.as_ptr().cast()) }
    };
    let quarters: &[[u8; 64]; CORNERS / 64] = bytemuck::cast_ref(table);
    let [a, b, c, d] = [load(&quarters[0]), load(&quarters[1]), load(&quarters[2]), load(&quarters[3])];
    let bits = |corners: &[u8; 64]| {
        let corners = load(corners);
        let (low, high) = (_mm512_permutex2var_epi8(a, corners, b), _mm512_permutex2var_epi8(c, corners, d));
        let found = _mm512_mask_blend_epi8(_mm512_movepi8_mask(corners), low, high);
        _mm512_test_epi8_mask(found, _mm512_set1_epi8(1))
    };
    let (whole, rest) = corners.as_chunks::<64>();
    out.extend(whole.iter().map(bits));
    if !rest.is_empty() {
        let mut last = [0; 64];
        last[..rest.len()].copy_from_slice(rest);
        out.push(bits(&last) & ((1 << rest.len()) - 1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_corner_has_its_bit() {
        let Some(tables) = ByteTables::found() else { return };
        let table: Table = std::array::from_fn(|i| (i * 7 % 11 % 3) as u8);
        let corners: Vec<u8> = (0..1000u32).map(|i| (i * i % 257) as u8).collect();
        let mut out = vec![1];
        for n in [0, 1, 63, 64, 65, 127, 128, 1000] {
            tables.look_up(&table, &corners[..n], &mut out);
            assert_eq!(out.len(), n.div_ceil(64));
            for i in 0..64 * out.len() {
                let expected = i < n && table[usize::from(corners[i])] & 1 == 1;
                assert_eq!(out[i / 64] >> (i % 64) & 1 == 1, expected, "{i} of {n}");
            }
        }
    }
}
