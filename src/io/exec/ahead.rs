//! Announces to the processor what will be read soon.
#![allow(unsafe_code)]

/// Asks for items to be brought into the nearest cache, and does not wait for them. Of use for what
/// lies nowhere near what was read last, while something else is done for as long as that takes.
#[inline]
pub fn will_read<T>(items: &[T]) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let first = items.as_ptr().cast::<i8>();
        // The lines that the slice touches: it may begin within one.
        let before = first.addr() % 64;
        for line in (0..before + size_of_val(items)).step_by(64) {
            let at = first.wrapping_sub(before).wrapping_add(line);
            // SAFETY: nothing but time depends on the address; every x86-64 has SSE.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(at) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = items;
}
