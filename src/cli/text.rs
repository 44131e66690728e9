//! Numbers, sizes and fractions, in and out.

use isospan::pipeline::SourceChunks;
use std::time::Duration;

/// Parses a number of bytes: `4GiB`, `500MB`, `1048576`, `50%` (of what the process may use).
pub(crate) fn parse_bytes(text: &str) -> Result<u64, String> {
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let number: f64 =
        number.parse().map_err(|_| format!("'{text}' is not a size; write 4GiB, 500MB or 50%"))?;
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kib" => 1024.0,
        "kb" => 1e3,
        "m" | "mib" => 1_048_576.0,
        "mb" => 1e6,
        "g" | "gib" => 1_073_741_824.0,
        "gb" => 1e9,
        "t" | "tib" => 1_099_511_627_776.0,
        "tb" => 1e12,
        "%" if number > 100.0 => return Err(format!("'{text}' is out of range")),
        "%" => isospan::exec::usable_memory() as f64 / 100.0,
        other => {
            return Err(format!(
                "'{other}' is not a unit of size; write KiB, MiB, GiB, TiB, kB, MB, GB, TB or %"
            ));
        }
    };
    let bytes = number * factor;
    if (1.0..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err(format!("'{text}' is out of range")) }
}

/// Parses a fraction of the samples: `1/8`, `0.125`, `12.5%`, `1`.
pub(crate) fn parse_fraction(text: &str) -> Result<f64, String> {
    let number = |s: &str| s.trim().parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
    let value = match (text.split_once('/'), text.strip_suffix('%')) {
        (Some((a, b)), _) => number(a).zip(number(b)).map(|(a, b)| a / b),
        (None, Some(percent)) => number(percent).map(|p| p / 100.0),
        (None, None) => number(text),
    };
    value
        .filter(|v| *v <= 64.0)
        .ok_or_else(|| format!("'{text}' is not a fraction; write 1/8, 0.125 or 12.5%"))
}

/// Parses three comma-separated values.
pub(crate) fn parse_triple<T: std::str::FromStr>(text: &str, what: &str) -> Result<[T; 3], String> {
    let parts: Vec<T> = text.split([',', 'x']).map_while(|p| p.trim().parse().ok()).collect();
    let count = text.split([',', 'x']).count();
    <[T; 3]>::try_from(parts)
        .ok()
        .filter(|_| count == 3)
        .ok_or_else(|| format!("'{text}' is not {what}; write three numbers as X,Y,Z"))
}

/// Parses a time: `2d`, `12h`, `30m`, `90s`.
pub(crate) fn parse_duration(text: &str) -> Result<Duration, String> {
    let wrong = || format!("'{text}' is not a time; write 2d, 12h, 30m or 90s");
    let (number, unit) = text.split_at_checked(text.len().saturating_sub(1)).ok_or_else(wrong)?;
    let seconds = match unit {
        "s" => 1,
        "m" => 60,
        "h" => 3600,
        "d" => 86_400,
        _ => return Err(wrong()),
    };
    let number: u32 = number.parse().map_err(|_| wrong())?;
    Ok(Duration::from_secs(u64::from(number) * seconds))
}

/// A name from a file, on one line.
pub(crate) fn name(name: &str) -> String {
    name.replace('\n', "\\n").replace('\t', "\\t")
}

/// `1234567` as `1 234 567`.
pub(crate) fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(c);
    }
    out
}

/// A value for a person: as it is, with an exponent where it would have many zeros.
pub(crate) fn value(v: f64) -> String {
    if v != 0.0 && !(1e-4..1e9).contains(&v.abs()) { format!("{v:e}") } else { v.to_string() }
}

/// A number with so many significant digits.
pub(crate) fn figures(v: f64, digits: usize) -> f64 {
    format!("{v:.*e}", digits - 1).parse().unwrap_or(v)
}

/// Bytes for a person: `3.4 MiB`.
pub(crate) fn bytes(n: u64) -> String {
    let units = ["B", "KiB", "MiB", "GiB", "TiB", "PiB"];
    let (mut value, mut unit) = (n as f64, 0);
    while value >= 1024.0 && unit + 1 < units.len() {
        (value, unit) = (value / 1024.0, unit + 1);
    }
    if unit == 0 { format!("{n} B") } else { format!("{value:.1} {}", units[unit]) }
}

/// The bad cells of a rectilinear or curvilinear grid.
pub(crate) fn grid_cells(cells: &isospan::archive::coordinates::CellCount) -> String {
    let mirrored = if cells.mirrored { ", mirrored" } else { "" };
    format!(
        "  grid        {} cells fold, {} have no volume{mirrored}",
        count(cells.folded),
        count(cells.degenerate)
    )
}

/// What was found in a tetrahedral mesh.
pub(crate) fn mesh_census(mesh: &isospan::pipeline::MeshCensus) -> String {
    let oddities: String = [
        (mesh.inverted, "inverted"),
        (mesh.degenerate, "without a volume"),
        (mesh.repeated, "points repeated"),
        (mesh.ghosts, "ghosts left out"),
    ]
    .into_iter()
    .filter(|(n, _)| *n > 0)
    .map(|(n, what)| format!("; {} {what}", count(n)))
    .collect();
    let bodies = if mesh.bodies == 1 { "body" } else { "bodies" };
    format!(
        "  mesh        {} cells, {} tetrahedra, {} {bodies}{oddities}",
        count(mesh.cells),
        count(mesh.tetrahedra),
        count(mesh.bodies)
    )
}

/// A duration for a person: `0.123 s`, `2 min 05 s`, `3 h 10 min`.
pub(crate) fn duration(d: Duration) -> String {
    let s = d.as_secs();
    match s {
        0..100 => format!("{:.3} s", d.as_secs_f64()),
        100..6000 => format!("{} min {:02} s", s / 60, s % 60),
        _ => format!("{} h {:02} min", s / 3600, s / 60 % 60),
    }
}

/// A time that is only guessed: whole seconds.
pub(crate) fn rough_duration(d: Duration) -> String {
    match d.as_secs() {
        s @ 0..100 => format!("{s} s"),
        _ => duration(d),
    }
}

/// A line on what samples have lost because values are `f32`, where that matters.
pub(crate) fn rounding(lost: Option<f64>) -> String {
    lost.map_or_else(String::new, |lost| format!("  rounded     {}\n", rounding_words(lost)))
}

/// What such a line says.
pub(crate) fn rounding_words(lost: f64) -> String {
    format!("samples to f32, by up to {}, which the errors include", value(figures(lost, 4)))
}

/// What is said of the chunks of a source: how often one was decoded.
pub(crate) fn source_chunks(found: &SourceChunks) -> String {
    let each = found.decodes as f64 / found.chunks.max(1) as f64;
    format!("the source has {} chunks, each decoded {each:.2} times on average", count(found.chunks))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!(parse_bytes("4GiB"), Ok(4 << 30));
        assert_eq!(parse_bytes("500MB"), Ok(500_000_000));
        assert_eq!(parse_bytes("1.5k"), Ok(1536));
        assert_eq!(parse_bytes("77"), Ok(77));
        assert!(parse_bytes("50%").unwrap() > 1 << 20);
        for bad in ["", "GiB", "-1", "3 parsecs", "101%", "0", "1e30TB"] {
            assert!(parse_bytes(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn times() {
        assert_eq!(parse_duration("2d"), Ok(Duration::from_secs(172_800)));
        assert_eq!(parse_duration("0s"), Ok(Duration::ZERO));
        for bad in ["", "d", "2", "-1h", "2 d", "1.5h", "2µ", "9999999999d"] {
            assert!(parse_duration(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn fractions_and_triples() {
        assert_eq!(parse_fraction("1/8"), Ok(0.125));
        assert_eq!(parse_fraction("0.5"), Ok(0.5));
        assert_eq!(parse_fraction("12.5%"), Ok(0.125));
        for bad in ["%", "1/8%", "0%", "6401%", "0", "-1/8", "1/0", "x", "1/", "nan", "1000"] {
            assert!(parse_fraction(bad).is_err(), "{bad}");
        }
        assert_eq!(parse_triple::<u64>("1,2,3", "dims"), Ok([1, 2, 3]));
        assert_eq!(parse_triple::<u64>("1x2x3", "dims"), Ok([1, 2, 3]));
        for bad in ["1,2", "1,2,3,4", "a,2,3", "1,2,", ""] {
            assert!(parse_triple::<u64>(bad, "dims").is_err(), "{bad}");
        }
    }

    #[test]
    fn for_a_person() {
        assert_eq!(count(1_234_567), "1 234 567");
        assert_eq!(count(12), "12");
        assert_eq!(bytes(3_565_158), "3.4 MiB");
        assert_eq!([0.0, -1300.5, 2e30, 1e-9].map(value), ["0", "-1300.5", "2e30", "1e-9"]);
        assert_eq!(duration(Duration::from_secs(125)), "2 min 05 s");
    }
}
