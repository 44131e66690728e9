//! Code that is compiled for wider vectors where the machine has them, with the same bits.
//!
//! As for the C library, `GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2` forbids them.
#![allow(unsafe_code)]

/// Runs a function that is compiled for AVX2 as far as it is inlined, on a machine that has it;
/// else as it is. No product and sum are fused in either.
#[inline]
pub(crate) fn with_vectors<T>(f: impl FnOnce() -> T) -> T {
    #[cfg(target_arch = "x86_64")]
    {
        static MAY: std::sync::LazyLock<bool> = std::sync::LazyLock::new(|| {
            let tunables = std::env::var("GLIBC_TUNABLES").unwrap_or_default();
            let forbidden = tunables.split([':', '=', ',']).any(|t| t == "-AVX2" || t == "-AVX2_Usable");
            !forbidden && std::arch::is_x86_feature_detected!("avx2")
        });
        if *MAY {
            // SAFETY: the feature was found.
            return unsafe { on_avx2(f) };
        }
    }
    f()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn on_avx2<T>(f: impl FnOnce() -> T) -> T {
    f()
}
