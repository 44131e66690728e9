//! Common parts of the headers of several formats: text lines, lists of numbers, numbered slice
//! files, axes.

use super::options::OpenOptions;
use crate::bytes::remote::is_remote;
use crate::bytes::{ByteSource, IoMode, place};
use crate::error::{Error, Result};
use crate::grid::Geometry;
use crate::volume::units::Units;
use crate::volume::{Assumed, FieldInfo, ScalarType, VolumeInfo};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

/// The lines of a text header that may be followed by binary samples.
pub(in crate::formats) struct Lines<'a> {
    bytes: &'a [u8],
    /// Byte after the line given last.
    pub at: usize,
    /// Number of the line given last, from 1.
    pub number: usize,
}

impl<'a> Lines<'a> {
    /// The longest line taken for text. Real headers have lines of a few hundred bytes; key/value
    /// pairs that carry other programs' records, of a megabyte.
    const LONGEST: usize = 16 << 20;

    pub(in crate::formats) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, number: 0 }
    }

    /// The next line without its end (`\n` or `\r\n`); bytes that are no UTF-8 are replaced. `None`
    /// at the end of the file, or where no line ends soon enough to be text.
    pub(in crate::formats) fn next(&mut self) -> Option<String> {
        let rest = &self.bytes[self.at..];
        if rest.is_empty() {
            return None;
        }
        let window = &rest[..rest.len().min(Self::LONGEST)];
        let end = window.iter().position(|&b| b == b'\n');
        if end.is_none() && window.len() < rest.len() {
            return None;
        }
        let line = &window[..end.unwrap_or(window.len())];
        self.at += end.map_or(window.len(), |e| e + 1);
        self.number += 1;
        Some(String::from_utf8_lossy(line.strip_suffix(b"\r").unwrap_or(line)).into_owned())
    }
}

/// Exactly `N` numbers, separated by blanks.
pub(in crate::formats) fn numbers<T: FromStr + Copy + Default, const N: usize>(
    path: &Path,
    at: &str,
    text: &str,
) -> Result<[T; N]> {
    let wrong =
        || Error::bad_input(path, at, if N == 1 { "a number".into() } else { format!("{N} numbers") }, text);
    let mut out = [T::default(); N];
    let mut words = text.split_whitespace();
    for slot in &mut out {
        *slot = words.next().and_then(|w| w.parse().ok()).ok_or_else(wrong)?;
    }
    if words.next().is_some() { Err(wrong()) } else { Ok(out) }
}

/// The map to the world of a volume whose sample (i, j, k) is at
/// `origin + i·columns[0] + j·columns[1] + k·columns[2]`.
pub(in crate::formats) fn geometry(
    path: &Path,
    at: &str,
    origin: [f64; 3],
    columns: [[f64; 3]; 3],
) -> Result<Geometry> {
    let spacing = columns.map(|c| (c[0] * c[0] + c[1] * c[1] + c[2] * c[2]).sqrt());
    let direction = std::array::from_fn(|a| columns[a].map(|x| x / spacing[a]));
    let geometry = Geometry { origin, spacing, direction };
    if geometry.is_valid() {
        return Ok(geometry);
    }
    let list = |v: [f64; 3]| format!("({}, {}, {})", v[0], v[1], v[2]);
    let got = format!("{} from origin {}", columns.map(list).join(" "), list(origin));
    Err(Error::bad_input(path, at, "finite axes that span space", got))
}

/// The map to the world of a file that does not say where its samples lie: the user may. Axes keep
/// the directions that the file gives them.
pub(in crate::formats) fn given_geometry(
    path: &Path,
    options: &OpenOptions,
    usual: Geometry,
) -> Result<Geometry> {
    if options.spacing.is_none() && options.origin.is_none() {
        return Ok(usual);
    }
    let spacing = options.spacing.unwrap_or(usual.spacing);
    if !spacing.iter().all(|&s| s > 0.0 && s.is_finite()) {
        let [x, y, z] = spacing;
        return Err(Error::usage(format!("`spacing={x},{y},{z}`: every spacing must be a positive number")));
    }
    let origin = options.origin.unwrap_or(usual.origin);
    let columns = std::array::from_fn(|a| usual.direction[a].map(|x| x * spacing[a]));
    geometry(path, "`spacing` and `origin`", origin, columns)
}

/// Columns of [`geometry`] for axes along x, y, z. A negative spacing flips its axis.
pub(in crate::formats) fn scaled_axes(spacing: [f64; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|a| std::array::from_fn(|b| if a == b { spacing[a] } else { 0.0 }))
}

/// What is known of a file with one unnamed field and no scaling.
pub(in crate::formats) fn plain_info(
    path: &Path,
    format: impl Into<String>,
    dims: [u64; 3],
    scalar: ScalarType,
    geometry: Geometry,
) -> VolumeInfo {
    let field = FieldInfo { name: "data".into(), scalar, components: 1 };
    VolumeInfo {
        path: path.to_path_buf(),
        format: format.into(),
        dims,
        fields: vec![field.clone()],
        field,
        geometry,
        slope: 1.0,
        intercept: 0.0,
        missing: None,
        units: Units::default(),
        notes: vec![],
        data_files: vec![],
        assumed: Assumed::default(),
        is_labels: false,
    }
}

/// A file that a header names: relative names are relative to the header's folder.
pub(in crate::formats) fn sibling(header: &Path, name: impl AsRef<Path>) -> PathBuf {
    header.parent().unwrap_or(Path::new("")).join(name)
}

/// The names of numbered slice files: `pattern min max step`, with one C-style `%d` in the pattern.
pub(in crate::formats) fn numbered_files(
    path: &Path,
    at: &str,
    text: &str,
    words: &[&str],
) -> Result<Vec<String>> {
    // More files than this are a mistake in the header, not slices.
    const MOST: i64 = 1 << 20;
    let wrong = || {
        Error::bad_input(path, at, "a pattern with one %d, then first, last and step of the numbers", text)
            .with_help("for example: slice%03d.raw 1 256 1")
    };
    let [pattern, first, last, step] = words else { return Err(wrong()) };
    let number = |w: &str| w.parse::<i64>().map_err(|_| wrong());
    let (first, last, step) = (number(first)?, number(last)?, number(step)?);
    let span = last.checked_sub(first).ok_or_else(wrong)?;
    let steps = span.checked_div(step).filter(|&n| n < MOST).ok_or_else(wrong)?;
    if span != 0 && (span < 0) != (step < 0) {
        return Err(wrong());
    }
    (0..=steps).map(|i| c_number(pattern, first + i * step).ok_or_else(wrong)).collect()
}

/// `printf(pattern, number)` for a pattern with exactly one of `%d`, `%i`, `%u`, with an optional
/// width, and `%%`.
fn c_number(pattern: &str, number: i64) -> Option<String> {
    let (mut out, mut rest, mut used) = (String::new(), pattern, false);
    while let Some(at) = rest.find('%') {
        out.push_str(&rest[..at]);
        rest = &rest[at + 1..];
        if let Some(after) = rest.strip_prefix('%') {
            out.push('%');
            rest = after;
            continue;
        }
        let digits = rest.len() - rest.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let (spec, after) = rest.split_at(digits);
        rest = after.strip_prefix(['d', 'i', 'u'])?;
        let width = if spec.is_empty() { 0 } else { spec.parse::<usize>().ok().filter(|&w| w < 40)? };
        if std::mem::replace(&mut used, true) {
            return None;
        }
        out.push_str(&if spec.starts_with('0') {
            format!("{number:0width$}")
        } else {
            format!("{number:width$}")
        });
    }
    out.push_str(rest);
    used.then_some(out)
}

/// Opens the slice files that a header names; those that are missing are named in the error.
pub(in crate::formats) fn open_files(
    header: &Path,
    at: &str,
    names: &[String],
    io: IoMode,
) -> Result<Vec<Arc<ByteSource>>> {
    if names.iter().any(String::is_empty) {
        return Err(Error::bad_input(header, at, "the name of a file", "none"));
    }
    let paths: Vec<PathBuf> = names.iter().map(|n| sibling(header, n)).collect();
    if is_remote(header)
        && let Some(name) = names.iter().zip(&paths).find(|(_, p)| !is_remote(p)).map(|(name, _)| name)
    {
        let expected = "files on the server of the header";
        return Err(Error::bad_input(header, at, expected, format!("{name}, on this machine"))
            .with_help("copy the header and its files to a disk"));
    }
    let lengths = place::lengths(&paths)?;
    let missing: Vec<&String> =
        names.iter().zip(lengths).filter(|(_, l)| l.is_none()).map(|(n, _)| n).collect();
    if !missing.is_empty() {
        let shown: Vec<&str> = missing.iter().take(3).map(|n| n.as_str()).collect();
        let more = if missing.len() > 3 { ", …" } else { "" };
        let expected = format!("{} data file(s) beside the header", names.len());
        let got = format!("{} missing: {}{more}", missing.len(), shown.join(", "));
        return Err(
            Error::bad_input(header, at, expected, got).with_help("put the missing files into its folder")
        );
    }
    paths.iter().map(|p| Ok(Arc::new(ByteSource::open(p, io)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_expanded_as_c_does() {
        for (pattern, number, expected) in [
            ("a%d.raw", 7, Some("a7.raw")),
            ("a%03d.raw", 7, Some("a007.raw")),
            ("a%3d", 7, Some("a  7")),
            ("100%%_%i", -2, Some("100%_-2")),
            ("plain", 7, None),
            ("%d%d", 7, None),
            ("%s", 7, None),
            ("%", 7, None),
            ("%099999999999d", 7, None),
        ] {
            assert_eq!(c_number(pattern, number).as_deref(), expected, "{pattern}");
        }
        let names = |t: &str| {
            numbered_files(Path::new("h"), "file", t, &t.split_whitespace().collect::<Vec<_>>())
                .map_err(|e| e.exit_code())
        };
        assert_eq!(names("s%02d 1 5 2").unwrap(), ["s01", "s03", "s05"]);
        assert_eq!(names("s%d 2 1 -1").unwrap(), ["s2", "s1"]);
        for bad in
            ["s%d 1 5 0", "s%d 5 1 1", "s%d 1 9223372036854775807 1", "s%d 1 5", "s 1 2 1", "s%d a b c"]
        {
            assert_eq!(names(bad), Err(5), "{bad}");
        }
    }

    #[test]
    fn lines_end_either_way() {
        let mut lines = Lines::new(b"a\r\nb\n\nlast");
        let all: Vec<String> = std::iter::from_fn(|| lines.next()).collect();
        assert_eq!(all, ["a", "b", "", "last"]);
        assert_eq!((lines.at, lines.number), (10, 4));
    }

    #[test]
    fn axes_need_not_be_aligned() {
        let g =
            geometry(Path::new("h"), "axes", [1.0; 3], [[0.0, 2.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 0.0, 0.5]]);
        let g = g.unwrap();
        assert_eq!((g.spacing, g.direction[1]), ([2.0, 3.0, 0.5], [-1.0, 0.0, 0.0]));
        assert_eq!(g.to_world([1.0, 1.0, 2.0]), [-2.0, 3.0, 2.0]);
        for bad in [[0.0; 3], [f64::NAN, 1.0, 1.0], [f64::INFINITY, 1.0, 1.0]] {
            assert!(geometry(Path::new("h"), "axes", [0.0; 3], scaled_axes(bad)).is_err());
        }
    }
}
