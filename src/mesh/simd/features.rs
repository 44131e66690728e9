//! Which vector instructions may be used: those that the machine has and the user does not forbid.
//!
//! All vector code gives the bytes of the plain code. To check that, or to make a machine behave
//! as an older one of the same cluster, instructions are forbidden as for the C library:
//! `GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F`.
#![allow(unsafe_code)]

use std::sync::LazyLock;

/// Whether none of these features is forbidden.
pub fn may_use(features: &[&str]) -> bool {
    static FORBIDDEN: LazyLock<Vec<String>> =
        LazyLock::new(|| forbidden(&std::env::var("GLIBC_TUNABLES").unwrap_or_default()));
    !features.iter().any(|f| FORBIDDEN.iter().any(|no| no == f))
}

/// The features that tunables take away, without the `_Usable` that older C libraries want.
fn forbidden(tunables: &str) -> Vec<String> {
    let lists = tunables.split(':').filter_map(|t| t.strip_prefix("glibc.cpu.hwcaps="));
    let less = lists.flat_map(|list| list.split(',')).filter_map(|f| f.strip_prefix('-'));
    less.map(|f| f.strip_suffix("_Usable").unwrap_or(f).to_owned()).collect()
}

/// Whether the machine has some features and none of them is forbidden. Each has the C library's
/// name and the compiler's.
#[cfg(target_arch = "x86_64")]
#[macro_export]
#[doc(hidden)]
macro_rules! may_use_all {
    ($($name:literal = $feature:tt),*) => {
        $crate::simd::may_use(&[$($name),*]) $(&& is_x86_feature_detected!($feature))*
    };
}

/// A token: the machine has AVX2 and FMA, and they may be used.
#[derive(Clone, Copy, Debug)]
pub struct Avx2(());

impl Avx2 {
    /// Looks for them.
    #[inline]
    pub fn found() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if may_use_all!("AVX2" = "avx2", "BMI1" = "bmi1", "BMI2" = "bmi2", "FMA" = "fma") {
            return Some(Self(()));
        }
        None
    }
}

/// A token: the machine has AVX-512 and AVX2, and they may be used.
#[derive(Clone, Copy, Debug)]
pub struct Avx512(Avx2);

impl Avx512 {
    /// Looks for it.
    #[inline]
    pub fn found() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        if may_use_all!("AVX512F" = "avx512f", "AVX512VL" = "avx512vl") {
            return Avx2::found().map(Self);
        }
        None
    }

    /// The token of AVX2.
    #[inline]
    pub fn avx2(self) -> Avx2 {
        self.0
    }
}

/// Runs a function that is compiled for AVX2 as far as it is inlined, on a machine that has it;
/// else as it is.
#[inline]
pub fn with_vectors<T>(f: impl FnOnce() -> T) -> T {
    #[cfg(target_arch = "x86_64")]
    if Avx2::found().is_some() {
        // SAFETY: the features were found just now.
        return unsafe { on_avx2(f) };
    }
    f()
}

/// Runs a function that is compiled for AVX-512 as far as it is inlined.
#[inline]
pub fn with_avx512<T>(_: Avx512, f: impl FnOnce() -> T) -> T {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: the token says that the features were found.
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

#[cfg(test)]
mod tests {
    #[test]
    fn tunables_take_features_away() {
        let found = super::forbidden(
            "glibc.malloc.check=1:glibc.cpu.hwcaps=-AVX2,-FMA,ERMS,-AVX512F_Usable:glibc.cpu.x=-BMI1",
        );
        assert_eq!(found, ["AVX2", "FMA", "AVX512F"]);
        assert!(super::forbidden("").is_empty());
    }
}
