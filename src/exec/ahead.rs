//! Tells the processor what will be read soon.
#![allow(unsafe_code)]

/// Asks for items to be brought into the nearest cache, and does not wait for them. Of use for what lies nowhere near what was read last,
/// while something else is done for as long as that takes.
#[inline]
pub(crate) fn will_read<T>(items: &[T]) {
    #[cfg(target_arch = "x86_64")]
    for line in (0..size_of_val(items)).step_by(64) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: the address lies in the slice, and nothing but time depends on it; every x86-64 has SSE.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(items.as_ptr().cast::<i8>().add(line)) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = items;
}
