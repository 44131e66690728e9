//! Names and colours of labels: tables that other programs write, and a palette for what has none.
//!
//! | table | a line |
//! |---|---|
//! | CSV with a header | `label,name,r,g,b` and perhaps `,a`, in any order; 0 to 255 |
//! | label description of ITK-SNAP | `3  255 0 0  1  1 1  "Caudate"`: number, colour, opacity 0 to 1, two marks, name |
//! | colour table of 3D Slicer (`.ctbl`), of FreeSurfer | `3 Caudate 255 0 0 255`: number, name, colour |
//!
//! Lines that begin with `#` are comments. A colour whose opacity is 0 in all lines is opaque, as
//! FreeSurfer means it.

use isospan_io::bytes::read_whole;
use isospan_io::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// The most bytes of a table.
const MOST_BYTES: u64 = 256 << 20;

/// How a label is shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelStyle {
    /// Its name; empty if it has none.
    pub name: String,
    /// Red, green, blue (sRGB) and opacity.
    pub colour: [u8; 4],
}

/// Names and colours of some labels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LabelTable {
    entries: BTreeMap<i64, LabelStyle>,
}

impl LabelTable {
    /// Reads a table: CSV with a header, a label description of ITK-SNAP, or a colour table of 3D
    /// Slicer or FreeSurfer. Its content says which.
    ///
    /// # Errors
    /// [`Error::Io`] where it cannot be read; [`Error::BadInput`] for a line that is none of a
    /// table, and for a label that is there twice.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = read_whole(path, MOST_BYTES)?;
        let text = String::from_utf8_lossy(&bytes);
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        Self::parse(path, text)
    }

    fn parse(path: &Path, text: &str) -> Result<Self> {
        let lines = text.lines().enumerate().map(|(n, line)| (n + 1, line.trim()));
        let lines: Vec<_> = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#')).collect();
        let Some(&(_, first)) = lines.first() else {
            return Err(Error::bad_input(path, "table of labels", "a line for each label", "none"));
        };
        let columns = first.contains(',').then(|| Columns::of(path, first)).transpose()?;
        let rows = if columns.is_some() { &lines[1..] } else { &lines[..] };
        let mut entries = BTreeMap::new();
        for &(number, line) in rows {
            let found = match &columns {
                Some(columns) => columns.entry(line),
                None => words(line),
            };
            let wrong = |expected: &str| {
                Err(Error::bad_input(path, format!("line {number}"), expected, format!("'{line}'")))
            };
            let Some((label, style)) = found else {
                return wrong("a label, a name and a colour of 0 to 255");
            };
            if entries.insert(label, style).is_some() {
                return wrong("a label that is not there before");
            }
        }
        if entries.values().all(|style| style.colour[3] == 0) {
            entries.values_mut().for_each(|style| style.colour[3] = u8::MAX);
        }
        Ok(Self { entries })
    }

    /// The labels of a name, ascending; spaces around it do not count.
    pub fn labels_named(&self, name: &str) -> Vec<i64> {
        let has = |entry: &(&i64, &LabelStyle)| entry.1.name.trim() == name.trim();
        self.entries.iter().filter(has).map(|(label, _)| *label).collect()
    }

    /// How a label is shown: without an entry, in a colour of the palette and without a name.
    pub fn style(&self, label: i64) -> LabelStyle {
        self.entries
            .get(&label)
            .cloned()
            .unwrap_or_else(|| LabelStyle { name: String::new(), colour: palette(label) })
    }

    /// Gives a label a name and a colour.
    pub fn insert(&mut self, label: i64, style: LabelStyle) {
        self.entries.insert(label, style);
    }

    /// The labels that it has, ascending.
    pub fn labels(&self) -> impl Iterator<Item = i64> {
        self.entries.keys().copied()
    }
}

/// The colour of a label without one: hues that are far apart for neighbouring numbers.
pub fn palette(label: i64) -> [u8; 4] {
    // Steps of the golden ratio around the circle of hues, in 1536 parts.
    let turned = (label as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let hue = (((turned >> 32) * 1536) >> 32) as u32;
    let (sector, part) = (hue / 256, hue % 256);
    let saturated = match sector {
        0 => [255, part, 0],
        1 => [255 - part, 255, 0],
        2 => [0, 255, part],
        3 => [0, 255 - part, 255],
        4 => [part, 0, 255],
        _ => [255, 0, 255 - part],
    };
    // Two paler or darker kinds tell hues apart that are near each other.
    let [white, black] = [[40, 255], [110, 255], [40, 200]][label.rem_euclid(3) as usize];
    let [r, g, b] = saturated.map(|c| ((white + c * (255 - white) / 255) * black / 255) as u8);
    [r, g, b, u8::MAX]
}

/// The places of the columns of a CSV.
struct Columns {
    label: usize,
    name: Option<usize>,
    colour: [Option<usize>; 4],
}

impl Columns {
    fn of(path: &Path, header: &str) -> Result<Self> {
        let names: Vec<String> = fields(header).iter().map(|f| f.to_ascii_lowercase()).collect();
        let find = |known: &[&str]| names.iter().position(|name| known.contains(&name.as_str()));
        let label = find(&["label", "labelvalue", "value", "id", "index", "number"]);
        let Some(label) = label else {
            let got = format!("'{header}'");
            return Err(Error::bad_input(path, "header", "a column 'label'", got)
                .with_help("name the columns: label,name,r,g,b"));
        };
        let colour = [
            find(&["r", "red", "color_r"]),
            find(&["g", "green", "color_g"]),
            find(&["b", "blue", "color_b"]),
            find(&["a", "alpha", "opacity", "color_a"]),
        ];
        Ok(Self { label, name: find(&["name", "label_name", "text"]), colour })
    }

    fn entry(&self, line: &str) -> Option<(i64, LabelStyle)> {
        let fields = fields(line);
        let label = fields.get(self.label)?.parse().ok()?;
        let name = self.name.map_or(Some(String::new()), |at| fields.get(at).cloned())?;
        let mut colour = palette(label);
        for (to, at) in colour.iter_mut().zip(self.colour) {
            if let Some(at) = at {
                *to = fields.get(at)?.parse().ok()?;
            }
        }
        Some((label, LabelStyle { name, colour }))
    }
}

/// The fields of a line of CSV; quotes may hold commas.
fn fields(line: &str) -> Vec<String> {
    let (mut fields, mut is_quoted) = (vec![String::new()], false);
    let mut letters = line.chars().peekable();
    while let Some(letter) = letters.next() {
        let last = fields.len() - 1;
        match letter {
            '"' if is_quoted && letters.peek() == Some(&'"') => fields[last].extend(letters.next()),
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => fields.push(String::new()),
            other => fields[last].push(other),
        }
    }
    fields.iter().map(|field| field.trim().to_owned()).collect()
}

/// A line of words: of ITK-SNAP if its name is quoted, else of 3D Slicer.
fn words(line: &str) -> Option<(i64, LabelStyle)> {
    let byte = |word: &str| word.parse::<u8>().ok();
    if let Some((numbers, rest)) = line.split_once('"') {
        let numbers: Vec<&str> = numbers.split_whitespace().collect();
        let [label, r, g, b, opacity, _, _] = numbers[..] else { return None };
        let opacity: f64 = opacity.parse().ok().filter(|share| (0.0..=1.0).contains(share))?;
        let colour = [byte(r)?, byte(g)?, byte(b)?, (opacity * 255.0).round() as u8];
        let name = rest.strip_suffix('"')?.to_owned();
        return Some((label.parse().ok()?, LabelStyle { name, colour }));
    }
    let words: Vec<&str> = line.split_whitespace().collect();
    let [label, name @ .., r, g, b, a] = &words[..] else { return None };
    let colour = [byte(r)?, byte(g)?, byte(b)?, byte(a)?];
    (!name.is_empty()).then(|| Some((label.parse().ok()?, LabelStyle { name: name.join(" "), colour })))?
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<LabelTable> {
        LabelTable::parse(Path::new("labels.txt"), text)
    }

    fn style(name: &str, colour: [u8; 4]) -> LabelStyle {
        LabelStyle { name: name.into(), colour }
    }

    #[test]
    fn tables_of_other_programs_have_names_and_colours() {
        let snap = "################\n# ITK-SnAP Label Description File\n    0     0    0    0        0  0  0    \"Clear Label\"\n    3   255  128    0        0.5  1  1    \"Left \"\n";
        let table = parse(snap).unwrap();
        assert_eq!(table.style(3), style("Left ", [255, 128, 0, 128]));
        assert_eq!(table.style(0), style("Clear Label", [0; 4]));
        let slicer = "# Color table file labels.ctbl\n# 2 values\n0 Background 0 0 0 0\n1 white matter 255 254 1 255\n";
        assert_eq!(parse(slicer).unwrap().style(1), style("white matter", [255, 254, 1, 255]));
        // FreeSurfer has 0 for all that is opaque.
        let freesurfer = "#No. Label Name:   R   G   B   A\n\n17  Left-Hippocampus  220 216 20 0\n";
        assert_eq!(parse(freesurfer).unwrap().style(17), style("Left-Hippocampus", [220, 216, 20, 255]));
        let csv = "\u{feff}Name,label,r,g,b\n\"a, \"\"b\"\"\",-5,1,2,3\n c ,7,4,5,6\n";
        let table = parse(csv.trim_start_matches('\u{feff}')).unwrap();
        assert_eq!(table.style(-5), style("a, \"b\"", [1, 2, 3, 255]));
        assert_eq!(
            (table.style(7), table.labels().collect::<Vec<_>>()),
            (style("c", [4, 5, 6, 255]), vec![-5, 7])
        );
        assert_eq!(parse("label,name\n4,x\n").unwrap().style(4), style("x", palette(4)));
        assert_eq!(table.style(8), style("", palette(8)));
    }

    #[test]
    fn lines_of_no_table_are_refused() {
        for (text, says) in [
            ("", "a line for each label"),
            ("a,b\n1,2\n", "a column 'label'"),
            ("label,name,r,g,b\n1,x,1,2\n", "line 2"),
            ("label,name,r,g,b\n1,x,1,2,256\n", "line 2"),
            ("1 x 1 2 3 4\n1 y 1 2 3 4\n", "not there before"),
            ("1 1 2 3\n", "line 1"),
            ("1 1 2 3 4\n", "line 1"),
            ("1 255 0 0 2 1 1 \"x\"\n", "line 1"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(says), "{text}: {error}");
        }
    }

    #[test]
    fn neighbouring_numbers_have_different_colours() {
        let colours: Vec<_> = (0..64).map(palette).collect();
        let apart = |a: &[u8; 4], b: &[u8; 4]| (0..3).map(|k| u32::from(a[k].abs_diff(b[k]))).sum::<u32>();
        assert!(colours.windows(2).all(|pair| apart(&pair[0], &pair[1]) > 100), "{colours:?}");
        assert_eq!(colours.iter().collect::<std::collections::BTreeSet<_>>().len(), 64);
    }
}
