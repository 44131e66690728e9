//! Returns freed memory to the system, so that the process holds only what it uses.
//!
//! The C library keeps freed memory in its arenas, one for each few threads: by default a run that
//! is allowed 1 GiB, and uses it, may hold half as much again. Taking large blocks directly from
//! the system, and trimming arenas early, keeps it at what is in use. The cost, pages that are
//! cleared again for each chunk, is below 1 % of a chunk's work.

#![allow(unsafe_code)]

#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub(super) fn give_back_early() {
    use std::ffi::c_int;
    const TRIM_THRESHOLD: c_int = -1;
    const MMAP_THRESHOLD: c_int = -3;
    // SAFETY: the C library's own declaration; it takes two numbers, and refuses those that it does
    // not know.
    unsafe extern "C" {
        safe fn mallopt(parameter: c_int, value: c_int) -> c_int;
    }
    // A refusal leaves the default, which is correct too.
    let _ = mallopt(MMAP_THRESHOLD, 256 << 10);
    let _ = mallopt(TRIM_THRESHOLD, 1 << 20);
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub(super) fn give_back_early() {}
