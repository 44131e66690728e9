//! Which vector instructions may be used: those that the machine has, less those that the user
//! forbids.
//!
//! Vector code gives the bytes of the plain code that stands beside it. To see that, or to make a
//! machine behave as an older one of the same cluster, instructions are forbidden as for the C
//! library: `GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F`.

use std::sync::LazyLock;

/// Whether none of these features is forbidden.
pub(crate) fn may_use(features: &[&str]) -> bool {
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
