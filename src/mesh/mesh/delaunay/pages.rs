//! Large pages for the records: an insertion touches dozens of records anywhere in some hundred
//! megabytes, and with 4 KiB pages the translation of addresses is a fifth of the time.
#![allow(unsafe_code)]

/// Makes room in an empty vector for `count` items, and asks the system to back it with large
/// pages. Advice only: where it is not taken, or there is none, everything works as before.
///
/// Memory that is too small is given back first: to grow it would copy it, although it is empty,
/// and into small pages. An eighth more than asked for suffices for other chunks of the same plan.
pub(in crate::mesh) fn reserve<T>(items: &mut Vec<T>, count: usize) {
    debug_assert!(items.is_empty());
    if items.capacity() >= count {
        return;
    }
    *items = Vec::new();
    items.reserve_exact(count + count / 8);
    #[cfg(target_os = "linux")]
    advise(items);
}

#[cfg(target_os = "linux")]
fn advise<T>(items: &mut Vec<T>) {
    const LARGE: usize = 2 << 20;
    let start = items.as_mut_ptr() as usize;
    let end = start + items.capacity() * size_of::<T>();
    let (first, last) = (start.next_multiple_of(LARGE), end / LARGE * LARGE);
    if first < last {
        let at = items.as_mut_ptr().cast::<u8>().wrapping_add(first - start);
        // SAFETY: the range lies within the vector's allocation; this advice changes no contents. A
        // refusal is harmless.
        let _ = unsafe { rustix::mm::madvise(at.cast(), last - first, rustix::mm::Advice::LinuxHugepage) };
    }
}
