//! Volumes that are many files: the slices in a folder, or those that a pattern matches.
//!
//! Slices are ordered by the numbers in their names as numbers: `slice_9` comes before `slice_10`.
//! The names must differ in numbers alone, and the first number in which they differ must be
//! different for all. A gap in these numbers means that a slice is missing. A volume without it
//! would be silently wrong, so that is an error that names the numbers.

use crate::bytes::publish::folder_of;
use crate::bytes::remote::is_remote;
use crate::error::{Error, Result};
use crate::formats::shared::has_suffix;
use std::path::{Path, PathBuf};

/// Whether a path that does not exist is a pattern for file names: `slices_*.tif`.
pub(in crate::formats) fn is_pattern(path: &Path) -> bool {
    has_wildcard(path) && !is_remote(path) && !path.exists()
}

/// Whether the name could be a pattern.
pub(in crate::formats) fn has_wildcard(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().contains('*'))
        || path.file_name().is_some_and(|name| name.to_string_lossy().contains('?')) && !is_remote(path)
}

/// The files that a pattern stands for, in the order of their numbers.
pub(in crate::formats) fn matching(pattern: &Path) -> Result<Vec<PathBuf>> {
    let name = pattern.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let folder = folder_of(pattern);
    let names: Vec<String> =
        names_in(folder)?.into_iter().filter(|n| matches(name.as_bytes(), n.as_bytes())).collect();
    if names.is_empty() {
        return Err(Error::bad_input(pattern, "pattern", "files that match it", "none")
            .with_help("* stands for any characters, ? for one, in the file's name alone"));
    }
    Ok(in_order(pattern, names)?.into_iter().map(|n| pattern.with_file_name(n)).collect())
}

/// The visible files of a folder, or those that a pattern stands for, in the order of their names.
pub(in crate::formats) fn files(path: &Path) -> Result<Vec<PathBuf>> {
    let mut files: Vec<PathBuf> = if is_pattern(path) {
        let pattern = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let names = names_in(folder_of(path))?.into_iter();
        let found = names.filter(|n| matches(pattern.as_bytes(), n.as_bytes()));
        found.map(|n| path.with_file_name(n)).collect()
    } else {
        names_in(path)?.into_iter().map(|n| path.join(n)).collect()
    };
    files.sort_unstable();
    Ok(files)
}

/// The files of a folder whose names end in one of `suffixes`, in the order of their numbers; empty
/// if there is none.
pub(in crate::formats) fn in_folder(folder: &Path, suffixes: &[&str]) -> Result<Vec<PathBuf>> {
    let names = names_in(folder)?.into_iter().filter(|n| has_suffix(Path::new(n), suffixes)).collect();
    Ok(in_order(folder, names)?.into_iter().map(|n| folder.join(n)).collect())
}

/// The names of the visible files of a folder. A name that is not UTF-8 is not one of ours.
fn names_in(folder: &Path) -> Result<Vec<String>> {
    let mut names = vec![];
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io("list", folder, e))? {
        let entry = entry.map_err(|e| Error::io("list", folder, e))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if !name.starts_with('.') && entry.path().is_file() {
            names.push(name);
        }
    }
    Ok(names)
}

/// Whether a name matches a pattern of `*` and `?`.
fn matches(pattern: &[u8], name: &[u8]) -> bool {
    let (mut p, mut n, mut star) = (0, 0, None);
    while n < name.len() {
        if p < pattern.len() && pattern[p] == b'*' {
            star = Some((p, n));
            p += 1;
        } else if p < pattern.len() && (pattern[p] == b'?' || pattern[p] == name[n]) {
            (p, n) = (p + 1, n + 1);
        } else if let Some((at, taken)) = star {
            // The star takes one character more.
            star = Some((at, taken + 1));
            (p, n) = (at + 1, taken + 1);
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|&c| c == b'*')
}

/// A name cut at its numbers: texts, and the numbers between them.
fn parts(name: &str) -> (Vec<String>, Vec<u128>) {
    let (mut texts, mut numbers, mut rest) = (vec![], vec![], name);
    loop {
        let digits = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        texts.push(rest[..digits].to_string());
        rest = &rest[digits..];
        let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
        // More than 38 digits count nothing: they are part of the text.
        match rest[..end].parse() {
            Ok(number) => numbers.push(number),
            Err(_) => texts.last_mut().expect("just pushed").push_str(&rest[..end]),
        }
        rest = &rest[end..];
        if rest.is_empty() {
            return (texts, numbers);
        }
    }
}

/// Sorts by the numbers in names, as numbers, then by the names.
pub(in crate::formats) fn by_numbers<T>(all: &mut [T], name: impl Fn(&T) -> String) {
    all.sort_by_cached_key(|one| {
        let name = name(one);
        (parts(&name).1, name)
    });
}

/// Whether a name comes before another by its numbers, or is another's for other reasons than
/// these.
pub(in crate::formats) fn rise(before: &str, after: &str) -> bool {
    let (before, after) = (parts(before), parts(after));
    before.0 != after.0 || before.1 <= after.1
}

/// Puts names in the order of their numbers.
fn in_order(path: &Path, mut names: Vec<String>) -> Result<Vec<String>> {
    if names.len() < 2 {
        return Ok(names);
    }
    by_numbers(&mut names, Clone::clone);
    let cut: Vec<_> = names.iter().map(|n| parts(n)).collect();
    if let Some(other) = (1..cut.len()).find(|&i| cut[i].0 != cut[0].0) {
        let got = format!("{} and {}", names[0], names[other]);
        return Err(Error::bad_input(path, "slices", "names that differ in numbers alone", got)
            .with_help("choose the slices by a pattern: \"FOLDER/slice_*.tif\", in quotes"));
    }
    let numbers = || cut.iter().map(|(_, numbers)| numbers);
    let varying = (0..cut[0].1.len()).find(|&i| numbers().any(|n| n[i] != cut[0].1[i]));
    let order: Vec<u128> = varying.map(|i| numbers().map(|n| n[i]).collect()).unwrap_or_default();
    let twice = order.windows(2).position(|w| w[0] >= w[1]).or(order.is_empty().then_some(0));
    if let Some(i) = twice {
        let got = format!("{} and {}", names[i], names[i + 1]);
        return Err(Error::bad_input(path, "slices", "one file for each number", got)
            .with_help("choose the slices by a pattern: \"FOLDER/slice_*.tif\", in quotes"));
    }
    refuse_gaps(path, &order)?;
    Ok(names)
}

/// Numbers must go on in equal steps.
fn refuse_gaps(path: &Path, order: &[u128]) -> Result<()> {
    const SHOWN: usize = 8;
    let step = order.windows(2).map(|w| w[1] - w[0]).min().unwrap_or(1);
    let mut missing = order.windows(2).filter(|w| w[1] - w[0] != step);
    let Some(first) = missing.next() else { return Ok(()) };
    let gaps = std::iter::once(first).chain(missing);
    let count: u128 = gaps.clone().map(|w| (w[1] - w[0]).div_ceil(step) - 1).sum();
    let shown = gaps.flat_map(|w| {
        let (start, end) = (w[0], w[1]);
        (1..).map(move |i| start + i * step).take_while(move |&n| n < end)
    });
    let mut shown: Vec<String> = shown.take(SHOWN).map(|n| n.to_string()).collect();
    if count > SHOWN as u128 {
        shown.push("…".into());
    }
    let (lo, hi) = (order[0], order[order.len() - 1]);
    let expected = format!("numbers from {lo} to {hi} in steps of {step}");
    let got = format!("{count} missing: {}", shown.join(", "));
    Err(Error::bad_input(path, "slices", expected, got).with_help(
        "fetch the missing slices, or choose a part by a pattern, or number the slices without gaps",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ordered(names: &[&str]) -> std::result::Result<Vec<String>, String> {
        in_order(Path::new("f"), names.iter().map(|n| n.to_string()).collect()).map_err(|e| e.to_string())
    }

    #[test]
    fn numbers_are_ordered_as_numbers() {
        assert_eq!(ordered(&["s10.tif", "s9.tif", "s8.tif"]).unwrap(), ["s8.tif", "s9.tif", "s10.tif"]);
        assert_eq!(ordered(&["a4_12_x7.tif", "a4_2_x9.tif"]).unwrap(), ["a4_2_x9.tif", "a4_12_x7.tif"]);
        assert_eq!(ordered(&["s009", "s007", "s005"]).unwrap(), ["s005", "s007", "s009"]);
        assert_eq!(ordered(&["only.tif"]).unwrap(), ["only.tif"]);
    }

    #[test]
    fn missing_slices_are_named() {
        let error = ordered(&["s1", "s2", "s4", "s5", "s9"]).unwrap_err();
        assert!(error.contains("from 1 to 9 in steps of 1, got 4 missing: 3, 6, 7, 8;"), "{error}");
        let error = ordered(&["s1", "s2", "s900"]).unwrap_err();
        assert!(error.contains("897 missing: 3, 4, 5, 6, 7, 8, 9, 10, …"), "{error}");
        assert!(ordered(&["s10", "s20", "s25"]).unwrap_err().contains("missing: 15;"));
        assert!(ordered(&["s10", "s20", "s35"]).unwrap_err().contains("1 missing: 30;"));
    }

    #[test]
    fn names_of_several_series_are_refused() {
        for (names, message) in [
            (&["a1", "b2"][..], "got a1 and b2"),
            (&["a1", "a01"], "one file for each number"),
            (&["a1_1", "a1_2", "a2_1"], "one file for each number"),
            (&["a", "b"], "numbers alone"),
        ] {
            assert!(ordered(names).unwrap_err().contains(message), "{names:?}");
        }
        let long = ["9".repeat(60), "8".repeat(60)];
        assert!(ordered(&[&long[0], &long[1]]).is_err());
    }

    #[test]
    fn patterns_match_as_in_a_shell() {
        for (pattern, name, expected) in [
            ("*.tif", "a.tif", true),
            ("a*b*c", "a1b2b3c", true),
            ("a*b*c", "a1b2b3", false),
            ("s_??.tif", "s_01.tif", true),
            ("s_??.tif", "s_1.tif", false),
            ("*", "", true),
            ("?", "", false),
            ("a", "ab", false),
        ] {
            assert_eq!(matches(pattern.as_bytes(), name.as_bytes()), expected, "{pattern} {name}");
        }
    }
}
