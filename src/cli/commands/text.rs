//! Numbers and sizes, for a person.

use isospan::pipeline::SourceChunks;
use isospan::volume::units::Unit;
use std::path::Path;
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

/// A number for a person, who is not helped by more than seven digits.
pub(crate) fn number(v: f64) -> String {
    value(figures(v, 7))
}

/// A value of a field whose values have this range: with the digits that distinguish places in it.
pub(crate) fn in_range(v: f64, [lo, hi]: [f64; 2]) -> String {
    let beyond = (v.abs() / (hi - lo)).log10();
    let more = if beyond.is_finite() { beyond.clamp(0.0, 9.0) as usize } else { 0 };
    value(figures(v, 7 + more))
}

/// `0 .. 1300`.
pub(crate) fn range(range: [f64; 2]) -> String {
    format!("{} .. {}", in_range(range[0], range), in_range(range[1], range))
}

/// So much of a range: ` (1.2 % of the range)`; nothing where there is none.
pub(crate) fn share_of(v: f64, range: Option<[f64; 2]>) -> String {
    let length = range.map(|[lo, hi]| hi - lo).filter(|length| *length > 0.0);
    length.map_or(String::new(), |length| format!(" ({} %)", value(figures(100.0 * v / length, 3))))
}

/// ` K`, to stand behind a number; nothing where no unit is known.
pub(crate) fn unit(unit: Option<&Unit>) -> String {
    unit.map_or_else(String::new, |unit| format!(" {unit}"))
}

/// A unit of area (power 2) or volume (3), to stand behind a number: ` mm³`; of a unit of several
/// words ` (m s-1)³`, without one nothing.
pub(crate) fn unit_to_the(power: u32, unit: Option<&Unit>) -> String {
    let is_word = |unit: &Unit| unit.as_str().chars().all(char::is_alphabetic);
    let power = if power == 2 { '²' } else { '³' };
    unit.map_or_else(String::new, |unit| {
        if is_word(unit) { format!(" {unit}{power}") } else { format!(" ({unit}){power}") }
    })
}

/// `1 chunk`, `2 chunks`.
pub(crate) fn plural(n: u64, what: &str) -> String {
    format!("{} {what}{}", count(n), if n == 1 { "" } else { "s" })
}

/// A path as a word of a shell: quoted where that takes it for more than a name.
pub(crate) fn shell(path: &Path) -> String {
    let text = path.to_string_lossy();
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,@%".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) { text.into_owned() } else { quoted(&text) }
}

/// A text as a word of a shell.
pub(crate) fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// A number with so many significant digits.
pub(crate) fn figures(v: f64, digits: usize) -> f64 {
    format!("{v:.*e}", digits - 1).parse().unwrap_or(v)
}

/// The bytes of an archive to those of its source: `1/60.3 of the source`.
fn ratio(ours: u64, theirs: u64) -> String {
    let (ours, theirs) = (ours.max(1) as f64, theirs.max(1) as f64);
    if ours <= theirs {
        format!("1/{:.1} of the source", theirs / ours)
    } else {
        format!("{:.1} TIMES THE SOURCE", ours / theirs)
    }
}

/// `about 1/3.0 of the source (3.0 MiB)`.
pub(crate) fn about_of(ours: u64, source: u64) -> String {
    format!("about {} ({})", ratio(ours, source), bytes(source))
}

/// The line that compares the bytes of an archive with those of its source; `of` names one of the
/// `count` values, a sample or a vertex.
pub(crate) fn ratio_line(ours: u64, theirs: u64, count: u64, of: &str) -> String {
    let bits = |bytes: u64| format!("{:.2}", bytes as f64 * 8.0 / count.max(1) as f64);
    format!(
        "  ratio       {} ({}): {} bits a {of}, the source {}",
        ratio(ours, theirs),
        bytes(theirs),
        bits(ours),
        bits(theirs)
    )
}

/// The line that says the bits that an archive has for each sample, where the size of its source is
/// not known; the ratio is that to the source alone.
pub(crate) fn bits_line(ours: u64, samples: u64, count: u64) -> String {
    let bits = |bytes: u64| format!("{:.2}", bytes as f64 * 8.0 / count.max(1) as f64);
    format!("  bits        {} a sample, of {} in the source ({})", bits(ours), bits(samples), bytes(samples))
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
pub(crate) fn grid_cells(cells: &isospan::archive::tables::CellCount) -> String {
    let mirrored = if cells.mirrored { ", mirrored" } else { "" };
    let folds = if cells.folded == 1 { "folds" } else { "fold" };
    let have = if cells.degenerate == 1 { "has" } else { "have" };
    format!(
        "  grid        {} {folds}, {} {have} no volume{mirrored}",
        plural(cells.folded, "cell"),
        count(cells.degenerate)
    )
}

/// What was found in a tetrahedral mesh.
pub(crate) fn mesh_census(mesh: &isospan::pipeline::MeshCensus) -> String {
    let oddities: String = [
        (mesh.inverted, "turned over, as they were inverted"),
        (mesh.folded, "left out, as they fold over their neighbours"),
        (mesh.degenerate, "without a volume"),
        (mesh.repeated, "points repeated"),
        (mesh.added, "points added in the middle of cells and of their faces"),
        (mesh.ghosts, "ghosts left out"),
    ]
    .into_iter()
    .filter(|(n, _)| *n > 0)
    .map(|(n, what)| format!("; {} {what}", count(n)))
    .collect();
    let bodies = if mesh.bodies == 1 { "body" } else { "bodies" };
    format!(
        "  mesh        {}, {} tetrahedra, {} {bodies}{oddities}",
        plural(mesh.cells, "cell"),
        count(mesh.tetrahedra),
        count(mesh.bodies)
    )
}

/// A duration for a person: `0.12 s`, `12.3 s`, `2 min 05 s`, `3 h 10 min`.
pub(crate) fn duration(d: Duration) -> String {
    let s = d.as_secs();
    match s {
        0..10 => format!("{:.2} s", d.as_secs_f64()),
        10..100 => format!("{:.1} s", d.as_secs_f64()),
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
        assert_eq!(duration(Duration::from_millis(11_240)), "11.2 s");
        assert_eq!([plural(1, "chunk"), plural(1200, "chunk")], ["1 chunk", "1 200 chunks"]);
        assert_eq!(range([0.0, 0.1f32.into()]), "0 .. 0.1");
        assert_eq!(range([-1e34, 2.0]), "-1e34 .. 2");
        assert_eq!(range([101_325_000.0, 101_325_002.75]), "101325000 .. 101325002.75");
        assert_eq!(range([5.0, 5.0]), "5 .. 5");
        assert_eq!(share_of(0.5, Some([100.0, 200.0])), " (0.5 %)");
        assert_eq!(share_of(0.5, Some([1.0, 1.0])), "");
    }

    #[test]
    fn paths_are_words_of_a_shell() {
        let word = |path: &str| shell(Path::new(path));
        assert_eq!(word("runs/a_1.isospan"), "runs/a_1.isospan");
        assert_eq!(word("my scan.isospan"), "'my scan.isospan'");
        assert_eq!(word("it's"), r"'it'\''s'");
    }
}
