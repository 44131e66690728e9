//! Numbers and sizes, for a person.

use isospan::pipeline::SourceChunks;
use std::time::Duration;

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
    fn for_a_person() {
        assert_eq!(count(1_234_567), "1 234 567");
        assert_eq!(count(12), "12");
        assert_eq!(bytes(3_565_158), "3.4 MiB");
        assert_eq!([0.0, -1300.5, 2e30, 1e-9].map(value), ["0", "-1300.5", "2e30", "1e-9"]);
        assert_eq!(duration(Duration::from_secs(125)), "2 min 05 s");
    }
}
