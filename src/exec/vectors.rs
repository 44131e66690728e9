//! Code that the compiler makes for this machine's vectors, where it has them; the same operations, so the same bits.
#![allow(unsafe_code)]

/// Proof that the machine has AVX2, and that it may be used.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

impl Avx2 {
    /// Looks for it.
    #[inline]
    pub(crate) fn found() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if crate::cpu::may_use(&["AVX2", "BMI1", "BMI2"])
            && is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
        {
            return Some(Self(()));
        }
        None
    }
}

/// Runs a function that is compiled for AVX2 as far as it is inlined, on a machine that has it; else as it is.
#[inline]
pub(crate) fn with_vectors<T>(f: impl FnOnce() -> T) -> T {
    #[cfg(target_arch = "x86_64")]
    if Avx2::found().is_some() {
        // SAFETY: the features were found just now.
        return unsafe { on_avx2(f) };
    }
    f()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2")]
fn on_avx2<T>(f: impl FnOnce() -> T) -> T {
    f()
}
