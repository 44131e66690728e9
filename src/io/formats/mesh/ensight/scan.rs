//! Finds where the arrays of a geometry file or a variable file are. Costs a pass over a text, and
//! a few bytes of each part of a binary file.

use crate::bytes::ByteSource;
use crate::cells::{CellKind, Center};
use crate::error::{Error, Place, Result};
use crate::formats::shared::ranges::RangeNumbers;
use crate::formats::shared::text::Words;
use crate::volume::ScalarType;
use std::ops::Range;
use std::sync::Arc;

/// Bytes of a text in a binary file.
const LINE: u64 = 80;
/// Parts that a file may have, and groups of elements of a part.
const MOST_PARTS: usize = 1 << 20;

/// How numbers are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EnsightEncoding {
    Text,
    Binary { big_endian: bool },
}

/// Numbers in a file.
#[derive(Clone, Debug)]
pub(super) struct Run {
    source: Arc<ByteSource>,
    range: Range<u64>,
    encoding: EnsightEncoding,
}

impl Run {
    pub(super) fn open(&self, scalar: ScalarType) -> RangeNumbers {
        match self.encoding {
            EnsightEncoding::Text => RangeNumbers::text(&self.source, self.range.clone(), scalar),
            EnsightEncoding::Binary { big_endian } => {
                RangeNumbers::binary(&self.source, self.range.clone(), scalar, big_endian)
            }
        }
    }
}

/// Elements of one type in a part.
pub(super) struct Group {
    pub(super) name: String,
    pub(super) kind: CellKind,
    pub(super) elements: u64,
    /// The nodes of the elements, counted from 1 in the part.
    pub(super) nodes: Run,
}

/// A part of a geometry.
pub(super) struct EnsightPart {
    pub(super) number: i64,
    pub(super) points: u64,
    /// The coordinates along x, y and z.
    pub(super) axes: [Run; 3],
    pub(super) groups: Vec<Group>,
}

/// A geometry.
pub(super) struct Geometry {
    pub(super) encoding: EnsightEncoding,
    pub(super) parts: Vec<EnsightPart>,
}

/// The kind of an element, and how many nodes it has; `None` of one that is not read.
fn kind_of(name: &str) -> Option<(CellKind, u64)> {
    use CellKind as K;
    let (name, is_ghost) = name.strip_prefix("g_").map_or((name, false), |name| (name, true));
    let (kind, nodes) = match name {
        "point" => (K::Flat, 1),
        "bar2" => (K::Flat, 2),
        "bar3" | "tria3" => (K::Flat, 3),
        "quad4" => (K::Flat, 4),
        "tria6" => (K::Flat, 6),
        "quad8" => (K::Flat, 8),
        "tetra4" => (K::Tetrahedron, 4),
        "tetra10" => (K::QuadraticTetrahedron, 10),
        "pyramid5" => (K::Pyramid, 5),
        "pyramid13" => (K::QuadraticPyramid, 13),
        "penta6" => (K::Wedge, 6),
        "penta15" => (K::QuadraticWedge, 15),
        "hexa8" => (K::Hexahedron, 8),
        "hexa20" => (K::QuadraticHexahedron, 20),
        _ => return None,
    };
    Some((if is_ghost { K::Flat } else { kind }, nodes))
}

/// Reads a geometry file.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file, structured blocks, elements that are not read.
pub(super) fn geometry(source: &Arc<ByteSource>) -> Result<Geometry> {
    let (mut c, ids) = head(source)?;
    let mut parts: Vec<EnsightPart> = vec![];
    let mut line = c.optional_text()?;
    if line.as_deref().is_some_and(|l| l.starts_with("extents")) {
        c.skip(6)?;
        line = c.optional_text()?;
    }
    while let Some(text) = line {
        if text != "part" {
            return Err(c.wrong("part", format!("'{text}'")));
        }
        if parts.len() == MOST_PARTS {
            return Err(c.wrong("at most 2^20 parts", "more"));
        }
        if parts.is_empty() {
            c.find_byte_order()?;
        }
        let mut part = points_of_part(&mut c, ids)?;
        loop {
            line = c.optional_text()?;
            let Some(name) = line.clone().filter(|l| l != "part") else { break };
            if part.groups.len() == MOST_PARTS {
                return Err(c.wrong("at most 2^20 groups of elements", "more"));
            }
            part.groups.push(group(&mut c, ids, name)?);
        }
        if parts.iter().any(|p| p.number == part.number) {
            return Err(c.wrong("parts of different numbers", format!("a second part {}", part.number)));
        }
        parts.push(part);
    }
    source.check()?;
    Ok(Geometry { encoding: c.encoding, parts })
}

/// Whether a file has numbers of its own for nodes and elements.
#[derive(Clone, Copy)]
struct Ids {
    nodes: bool,
    elements: bool,
}

/// Reads the lines before the first part.
fn head(source: &Arc<ByteSource>) -> Result<(Cursor<'_>, Ids)> {
    let mut head = vec![0; source.len().min(LINE) as usize];
    source.read_at(0, &mut head)?;
    let first = String::from_utf8_lossy(&head).to_ascii_lowercase();
    if first.starts_with("fortran binary") {
        return Err(Error::bad_input(source.path(), "first line", "C Binary, or text", "Fortran Binary")
            .with_help("write it as C binary, or as .vtu, e.g. with ParaView"));
    }
    let mut c = Cursor { source, at: 0, encoding: EnsightEncoding::Text };
    if first.starts_with("c binary") {
        c.line_fits()?;
        (c.at, c.encoding) = (LINE, EnsightEncoding::Binary { big_endian: false });
    }
    c.description()?;
    c.description()?;
    let has_ids = |line: &str| ["given", "ignore"].iter().any(|w| line.to_ascii_lowercase().contains(w));
    let [nodes, elements] = [c.text("node id …")?, c.text("element id …")?];
    if !nodes.starts_with("node id") || !elements.starts_with("element id") {
        let got = format!("'{nodes}' and '{elements}'");
        return Err(c.wrong("the lines node id … and element id …", got));
    }
    let ids = Ids { nodes: has_ids(&nodes), elements: has_ids(&elements) };
    Ok((c, ids))
}

/// Reads a part up to its first group of elements.
fn points_of_part(c: &mut Cursor<'_>, ids: Ids) -> Result<EnsightPart> {
    let number = c.int()?;
    c.description()?;
    let section = c.text("coordinates")?;
    if section.starts_with("block") {
        return Err(c
            .wrong("coordinates of an unstructured part", "a structured block")
            .with_help("write the part as .vts, or as an unstructured part (ParaView: Append Datasets)"));
    }
    if section != "coordinates" {
        return Err(c.wrong("coordinates", format!("'{section}'")));
    }
    let points = c.count()?;
    if ids.nodes {
        c.skip(points)?;
    }
    let axes = [c.skip(points)?, c.skip(points)?, c.skip(points)?];
    Ok(EnsightPart { number, points, axes, groups: vec![] })
}

/// Reads a group of elements of a part.
fn group(c: &mut Cursor<'_>, ids: Ids, name: String) -> Result<Group> {
    let is_polygon = ["nsided", "g_nsided"].contains(&name.as_str());
    let kind = if is_polygon { Some((CellKind::Flat, 1)) } else { kind_of(&name) };
    let (kind, count) = kind.ok_or_else(|| {
        let expected = "tetra4, pyramid5, penta6, hexa8, those of second order, or flat elements";
        c.wrong(expected, format!("'{name}'")).with_help("convert it to tetrahedra first")
    })?;
    let elements = c.count()?;
    if ids.elements {
        c.skip(elements)?;
    }
    let mut nodes = c.skip(elements.saturating_mul(count))?;
    if is_polygon {
        // These were the numbers of nodes.
        let mut counts = nodes.open(ScalarType::I32);
        let (mut left, mut all, mut some) = (elements, 0u64, vec![]);
        while left > 0 {
            let n = left.min(4096);
            some.clear();
            counts.read_ids(n as usize, &mut some)?;
            all = some.iter().fold(all, |sum, &n| sum.saturating_add(n));
            left -= n;
        }
        nodes = c.skip(all)?;
    }
    Ok(Group { name, kind, elements, nodes })
}

/// Numbers of a variable: of all nodes of a part, or of a group of its elements.
pub(super) struct Values {
    part: usize,
    /// Which of the part's groups.
    group: usize,
    /// One run for each component.
    pub(super) runs: Vec<Run>,
    /// The number that means none.
    pub(super) missing: Option<f64>,
}

impl Values {
    /// Those of a part's nodes, or of a group of its elements.
    pub(super) fn of(all: &[Self], part: usize, group: usize) -> Option<&Self> {
        all.iter().find(|v| (v.part, v.group) == (part, group))
    }
}

/// Reads a variable file of a geometry.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file, and for parts of which some nodes alone have values.
pub(super) fn values(
    source: &Arc<ByteSource>,
    geometry: &Geometry,
    center: Center,
    components: u32,
) -> Result<Vec<Values>> {
    let mut c = Cursor { source, at: 0, encoding: geometry.encoding };
    c.description()?;
    let mut found: Vec<Values> = vec![];
    let mut line = c.optional_text()?;
    while let Some(text) = line {
        if text != "part" {
            return Err(c.wrong("part", format!("'{text}'")));
        }
        let number = c.int()?;
        let part = geometry.parts.iter().position(|p| p.number == number);
        let part = part.ok_or_else(|| c.wrong("a part of the geometry", format!("part {number}")))?;
        let of = &geometry.parts[part];
        loop {
            line = c.optional_text()?;
            let Some(text) = line.clone().filter(|l| l != "part") else { break };
            let mut words = text.split_whitespace();
            let (section, way) = (words.next().unwrap_or_default(), words.next());
            let group = match center {
                Center::Point => (section == "coordinates").then_some((0, of.points)),
                Center::Cell => {
                    let group = of.groups.iter().position(|g| g.name == section);
                    group.map(|group| (group, of.groups[group].elements))
                }
            };
            let (group, count) = group.ok_or_else(|| {
                let expected = if center == Center::Point { "coordinates" } else { "a type of its elements" };
                c.wrong(format!("{expected} of part {number}"), format!("'{section}'"))
            })?;
            let missing = match way {
                None => None,
                Some("undef") => Some(c.float()?),
                Some(other) => {
                    let expected = format!("numbers of all of part {number}");
                    return Err(c.wrong(expected, format!("'{section} {other}'")));
                }
            };
            let runs = (0..components).map(|_| c.skip(count)).collect::<Result<_>>()?;
            if Values::of(&found, part, group).is_some() {
                return Err(c.wrong(format!("'{section}' of part {number} once"), "a second time"));
            }
            found.push(Values { part, group, runs, missing });
        }
    }
    source.check()?;
    Ok(found)
}

/// Goes through a file.
struct Cursor<'a> {
    source: &'a Arc<ByteSource>,
    at: u64,
    encoding: EnsightEncoding,
}

impl Cursor<'_> {
    fn wrong(&self, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(self.source.path(), Place::byte(self.at), expected, got)
    }

    /// The next line, which may be empty; `None` at the end of the file.
    fn line(&mut self) -> Result<Option<String>> {
        let left = self.source.len() - self.at;
        if left == 0 {
            return Ok(None);
        }
        let line = match self.encoding {
            EnsightEncoding::Text => {
                let rest = &self.source.slice(0..self.source.len())?[self.at as usize..];
                let end = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
                self.at += (end + 1).min(rest.len()) as u64;
                rest[..end].to_vec()
            }
            EnsightEncoding::Binary { .. } => {
                self.line_fits()?;
                let mut line = vec![0; LINE as usize];
                self.source.read_at(self.at, &mut line)?;
                self.at += LINE;
                line.truncate(line.iter().position(|&b| b == 0).unwrap_or(line.len()));
                line
            }
        };
        let text = String::from_utf8_lossy(&line);
        Ok(Some(text.trim().chars().filter(|c| !c.is_control()).take(LINE as usize).collect()))
    }

    /// Fails where a text of a binary file is cut short.
    fn line_fits(&self) -> Result<()> {
        match self.source.len() - self.at {
            left if left < LINE => Err(self.wrong("a text of 80 bytes", format!("{left} bytes"))),
            _ => Ok(()),
        }
    }

    /// The next line that is not empty.
    fn optional_text(&mut self) -> Result<Option<String>> {
        loop {
            match self.line()? {
                Some(line) if line.is_empty() && self.encoding == EnsightEncoding::Text => {}
                line => return Ok(line),
            }
        }
    }

    fn text(&mut self, what: &str) -> Result<String> {
        let line = self.optional_text()?;
        line.ok_or_else(|| self.wrong(what, "the end of the file"))
    }

    /// Goes over a line that may say anything.
    fn description(&mut self) -> Result<()> {
        let line = self.line()?;
        line.map(drop).ok_or_else(|| self.wrong("a description", "the end of the file"))
    }

    /// Numbers of four bytes, or words.
    fn skip(&mut self, n: u64) -> Result<Run> {
        let start = self.at;
        match self.encoding {
            EnsightEncoding::Binary { .. } => {
                let end = n.checked_mul(4).and_then(|bytes| start.checked_add(bytes));
                let end = end.filter(|&end| end <= self.source.len());
                self.at = end.ok_or_else(|| self.wrong(format!("{n} numbers"), "the end of the file"))?;
            }
            EnsightEncoding::Text => {
                let all = self.source.slice(0..self.source.len())?;
                let mut words = Words::new(self.source.path(), all, start as usize);
                for _ in 0..n {
                    if words.next().is_none() {
                        return Err(words.wrong(format!("{n} numbers"), "the end of the file"));
                    }
                }
                let end = words.at();
                self.at = end as u64;
                // What follows begins on a line of its own.
                let rest = &all[end..];
                let blank = rest.iter().position(|b| !b.is_ascii_whitespace() || *b == b'\n');
                if let Some(at) = blank.filter(|&at| n > 0 && rest[at] == b'\n') {
                    self.at += at as u64 + 1;
                }
                let range = start..end as u64;
                return Ok(Run { source: Arc::clone(self.source), range, encoding: self.encoding });
            }
        }
        Ok(Run { source: Arc::clone(self.source), range: start..self.at, encoding: self.encoding })
    }

    fn int(&mut self) -> Result<i64> {
        let at = self.at;
        let mut id = vec![];
        self.skip(1)?.open(ScalarType::I32).read_ids(1, &mut id)?;
        i64::try_from(id[0])
            .map_err(|_| Error::bad_input(self.source.path(), Place::byte(at), "a number", "another"))
    }

    fn count(&mut self) -> Result<u64> {
        self.int().map(|n| n as u64)
    }

    fn float(&mut self) -> Result<f64> {
        use crate::cells::NumberStream;
        let mut number = [0.0];
        self.skip(1)?.open(ScalarType::F32).fill(&mut number)?;
        Ok(number[0])
    }

    /// Decides the order of bytes by the number of a part, which is small.
    fn find_byte_order(&mut self) -> Result<()> {
        if self.encoding == EnsightEncoding::Text {
            return Ok(());
        }
        let at = self.at;
        for big_endian in [false, true] {
            self.encoding = EnsightEncoding::Binary { big_endian };
            let number = self.int();
            self.at = at;
            if number.is_ok_and(|n| (0..1 << 16).contains(&n)) {
                return Ok(());
            }
        }
        Err(self.wrong("the number of a part, below 65536", "another in either order of bytes"))
    }
}
