//! A report as a list of blocks, and its three forms: HTML, Markdown, and a CSV file for each
//! table.

use isospan::{Error, Result};
use std::fmt::Write as _;
use std::path::Path;

/// A cell of a table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Cell {
    Text(String),
    /// A number of this run.
    Number(f64),
    /// The thesis's number and ours; either may be missing.
    Compared {
        thesis: Option<f64>,
        ours: Option<f64>,
    },
    Empty,
}

/// A table: each row has a name and a cell for each column.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Table {
    /// The thesis's number ("3.2"), or ours ("A.1").
    pub(crate) number: String,
    pub(crate) title: String,
    pub(crate) columns: Vec<String>,
    pub(crate) rows: Vec<(String, Vec<Cell>)>,
    /// What a reader must know.
    pub(crate) note: String,
}

/// A picture that lies next to the report.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Picture {
    /// The thesis's number ("3.4"), or ours.
    pub(crate) number: String,
    pub(crate) caption: String,
    /// Name of the PNG file.
    pub(crate) file: String,
}

/// A part of the report.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Block {
    Heading(u8, String),
    Paragraph(String),
    Table(Table),
    Picture(Picture),
}

/// A page.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Document {
    pub(crate) title: String,
    pub(crate) blocks: Vec<Block>,
}

/// Four significant digits, and no more zeros than needed.
pub(crate) fn short(x: f64) -> String {
    if x == 0.0 {
        return "0".into();
    }
    if !x.is_finite() {
        return x.to_string();
    }
    let digits = (3 - x.abs().log10().floor() as i32).clamp(0, 9) as usize;
    match x.abs() {
        1e-4..1e4 => {
            let text = format!("{x:.digits$}");
            if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
        }
        1e4..1e7 => thousands(x.round() as i64),
        _ => format!("{x:.2e}"),
    }
}

/// 705894 as "705 894".
pub(crate) fn thousands(n: i64) -> String {
    let digits = n.unsigned_abs().to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().map(|g| std::str::from_utf8(g).expect("digits")).collect();
    format!("{}{}", if n < 0 { "-" } else { "" }, groups.join("\u{202f}"))
}

impl Cell {
    /// The words of a cell: "30.23 → 0.0021 (14 400×)".
    fn words(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Number(x) => short(*x),
            Self::Empty => "–".into(),
            Self::Compared { thesis, ours } => {
                let name = |x: &Option<f64>| x.map_or("–".into(), short);
                let ratio = self.ratio().map_or(String::new(), |r| format!(" ({}×)", short(r)));
                format!("{} → {}{ratio}", name(thesis), name(ours))
            }
        }
    }

    /// The thesis's number over ours.
    fn ratio(&self) -> Option<f64> {
        match self {
            Self::Compared { thesis: Some(t), ours: Some(o) } if *o > 0.0 && *t > 0.0 => Some(t / o),
            _ => None,
        }
    }
}

impl Table {
    fn is_compared(&self) -> bool {
        self.rows.iter().flat_map(|r| &r.1).any(|c| matches!(c, Cell::Compared { .. }))
    }

    /// A line a row; a column that compares becomes three.
    fn csv(&self) -> Vec<u8> {
        let mut out = csv::Writer::from_writer(vec![]);
        let compared: Vec<bool> = (0..self.columns.len())
            .map(|c| self.rows.iter().any(|r| matches!(r.1.get(c), Some(Cell::Compared { .. }))))
            .collect();
        let mut head = vec![String::new()];
        for (column, compared) in self.columns.iter().zip(&compared) {
            match compared {
                true => head.extend(["thesis", "ours", "ratio"].map(|part| format!("{column}: {part}"))),
                false => head.push(column.clone()),
            }
        }
        out.write_record(&head).expect("writing into memory cannot fail");
        let number = |x: Option<f64>| x.map_or(String::new(), |x| x.to_string());
        for (name, cells) in &self.rows {
            let mut row = vec![name.clone()];
            for (cell, compared) in cells.iter().zip(&compared) {
                match cell {
                    Cell::Compared { thesis, ours } => {
                        row.extend([*thesis, *ours, cell.ratio()].map(number));
                    }
                    _ if *compared => row.extend([cell.words(), String::new(), String::new()]),
                    Cell::Number(x) => row.push(x.to_string()),
                    Cell::Empty => row.push(String::new()),
                    Cell::Text(text) => row.push(text.clone()),
                }
            }
            out.write_record(&row).expect("all rows have as many cells");
        }
        out.into_inner().expect("writing into memory cannot fail")
    }

    fn head(&self) -> String {
        let how = if self.is_compared() { " (thesis → ours, ratio)" } else { "" };
        format!("Table {}. {}{how}", self.number, self.title)
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:1060px;margin:2em auto;padding:0 1em;color:#222}\
h1,h2,h3{line-height:1.2}h2{margin-top:2.2em;border-bottom:1px solid #ddd}table{border-collapse:collapse;font-size:14px;margin:.6em 0}\
th,td{border:1px solid #ddd;padding:.25em .6em;text-align:right}th{background:#f5f5f5}td:first-child,th:first-child{text-align:left}\
figure{margin:1.5em 0}img{max-width:100%}figcaption,.note{color:#555;font-size:14px}.good{color:#14703c}.bad{color:#b03020}.so{color:#8a6500}\
div.scroll{overflow-x:auto}";

impl Document {
    pub(crate) fn push(&mut self, block: Block) {
        self.blocks.push(block);
    }

    pub(crate) fn heading(&mut self, level: u8, text: &str) {
        self.push(Block::Heading(level, text.into()));
    }

    pub(crate) fn text(&mut self, text: impl Into<String>) {
        self.push(Block::Paragraph(text.into()));
    }

    /// Writes `NAME.html`, `NAME.md`, and `table-N.csv` for each table.
    pub(crate) fn write(&self, folder: &Path, name: &str) -> Result<()> {
        put(&folder.join(format!("{name}.html")), self.html().as_bytes())?;
        put(&folder.join(format!("{name}.md")), self.markdown().as_bytes())?;
        for block in &self.blocks {
            if let Block::Table(table) = block {
                put(&folder.join(format!("table-{}.csv", table.number)), &table.csv())?;
            }
        }
        Ok(())
    }

    fn html(&self) -> String {
        let title = escape(&self.title);
        let mut out = format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\n\
             <style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n"
        );
        for block in &self.blocks {
            let _ = match block {
                Block::Heading(level, text) => writeln!(out, "<h{level}>{}</h{level}>", escape(text)),
                Block::Paragraph(text) => writeln!(out, "<p>{}</p>", escape(text)),
                Block::Table(table) => writeln!(out, "{}", html_table(table)),
                Block::Picture(p) => writeln!(
                    out,
                    "<figure id=\"figure-{n}\"><img src=\"{}\" alt=\"Figure {n}\"><figcaption>Figure {n}. {}</figcaption></figure>",
                    p.file,
                    escape(&p.caption),
                    n = p.number
                ),
            };
        }
        out + "</body></html>\n"
    }

    fn markdown(&self) -> String {
        let mut out = format!("# {}\n\n", self.title);
        for block in &self.blocks {
            let _ = match block {
                Block::Heading(level, text) => writeln!(out, "{} {text}\n", "#".repeat(usize::from(*level))),
                Block::Paragraph(text) => writeln!(out, "{text}\n"),
                Block::Table(table) => writeln!(out, "{}", markdown_table(table)),
                Block::Picture(p) => {
                    writeln!(out, "![Figure {}]({})\n\n*Figure {0}. {}*\n", p.number, p.file, p.caption)
                }
            };
        }
        out
    }
}

fn html_table(table: &Table) -> String {
    let mut out = format!(
        "<h3 id=\"table-{}\">{}</h3>\n<div class=\"scroll\"><table><tr><th></th>",
        table.number,
        escape(&table.head())
    );
    table.columns.iter().for_each(|c| out += &format!("<th>{}</th>", escape(c)));
    out += "</tr>\n";
    for (name, cells) in &table.rows {
        out += &format!("<tr><td>{}</td>", escape(name));
        cells.iter().for_each(|c| out += &format!("<td>{}</td>", escape(&c.words())));
        out += "</tr>\n";
    }
    out + "</table></div>\n<p class=\"note\">" + &escape(&table.note) + "</p>"
}

fn markdown_table(table: &Table) -> String {
    let row = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let mut out = format!("**{}**\n\n", table.head());
    out += &row(std::iter::once(String::new()).chain(table.columns.iter().cloned()).collect());
    out += &row(vec!["---".into(); table.columns.len() + 1]);
    for (name, cells) in &table.rows {
        let words = std::iter::once(name.clone()).chain(cells.iter().map(Cell::words));
        out += &row(words.map(|w| w.replace('|', "\\|")).collect());
    }
    out + "\n" + &table.note + "\n"
}

fn put(file: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(file, bytes).map_err(|e| Error::io("write", file, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let all = [0.0, 1833.3, 0.002_101_9, 30.0, 705_894.0, 0.000_05, 0.25, 12_345_678.0].map(short);
        let expected = ["0", "1833", "0.002102", "30", "705\u{202f}894", "5.00e-5", "0.25", "1.23e7"];
        assert_eq!(all, expected.map(String::from));
    }

    #[test]
    fn a_table_has_three_forms() {
        let table = Table {
            number: "3.2".into(),
            title: "Times".into(),
            columns: vec!["SPHERE".into(), "a|b".into()],
            rows: vec![(
                "Linear".into(),
                vec![Cell::Compared { thesis: Some(30.0), ours: Some(0.003) }, Cell::Number(0.5)],
            )],
            note: "One <note>.".into(),
        };
        let text = String::from_utf8(table.csv()).unwrap();
        assert_eq!(text, ",SPHERE: thesis,SPHERE: ours,SPHERE: ratio,a|b\nLinear,30,0.003,10000,0.5\n");
        let document = Document { title: "T".into(), blocks: vec![Block::Table(table)] };
        let folder = tempfile::tempdir().unwrap();
        document.write(folder.path(), "index").unwrap();
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(read("index.html").contains("<td>30 → 0.003 (10\u{202f}000×)</td>"));
        assert!(read("index.html").contains("One &lt;note&gt;."));
        assert!(read("index.md").contains("| Linear | 30 → 0.003 (10\u{202f}000×) | 0.5 |"));
        assert_eq!(read("table-3.2.csv"), text);
    }
}
