//! Code that the compiler makes for this machine's vectors, where it has them; the same operations,
//! so the same bits.
#![allow(unsafe_code)]

/// Proof that the machine has AVX2 and FMA, and that they may be used.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx2(());

impl Avx2 {
    /// Looks for them.
    #[inline]
    pub(crate) fn found() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if crate::cpu::may_use(&["AVX2", "BMI1", "BMI2", "FMA"])
            && is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("fma")
        {
            return Some(Self(()));
        }
        None
    }
}

/// Proof that the machine has AVX-512 and AVX2, and that they may be used.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx512(Avx2);

impl Avx512 {
    /// Looks for it.
    #[inline]
    pub(crate) fn found() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if crate::cpu::may_use(&["AVX512F", "AVX512VL"])
            && is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
        {
            return Avx2::found().map(Self);
        }
        None
    }

    /// The lesser one.
    #[inline]
    pub(crate) fn avx2(self) -> Avx2 {
        self.0
    }
}

/// Runs a function that is compiled for AVX2 as far as it is inlined, on a machine that has it;
/// else as it is.
#[inline]
pub(crate) fn with_vectors<T>(f: impl FnOnce() -> T) -> T {
    #[cfg(target_arch = "x86_64")]
    if Avx2::found().is_some() {
        // SAFETY: the features were found just now.
        return unsafe { on_avx2(f) };
    }
    f()
}

/// Runs a function that is compiled for AVX-512 as far as it is inlined.
#[inline]
pub(crate) fn with_avx512<T>(_: Avx512, f: impl FnOnce() -> T) -> T {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: there is a proof that the features were found.
    return unsafe { on_avx512(f) };
    #[cfg(not(target_arch = "x86_64"))]
    f()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,fma")]
fn on_avx2<T>(f: impl FnOnce() -> T) -> T {
    f()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx2,bmi1,bmi2,fma")]
fn on_avx512<T>(f: impl FnOnce() -> T) -> T {
    f()
}
