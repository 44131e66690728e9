//! Elements of a `.msh` file: their types, their order of vertices, and their stream.

use super::file::GmshFile;
use super::tokens::Tokens;
use crate::cells::{BLOCK, CellBlock, CellKind, CellStream};
use crate::error::Result;
use std::sync::Arc;

/// A type of element.
struct Type {
    kind: CellKind,
    nodes: u64,
    /// Where VTK's vertices after the corners are among Gmsh's; empty where the orders are the
    /// same.
    order: &'static [u8],
}

/// Gmsh's type numbers, or the name of one that is not read.
fn type_of(number: u64) -> std::result::Result<Type, String> {
    use CellKind as K;
    let flat = |nodes| Type { kind: K::Flat, nodes, order: &[] };
    let solid = |kind: K, order| Type { kind, nodes: kind.vertices() as u64, order };
    Ok(match number {
        1 => flat(2),
        2 | 8 => flat(3),
        3 | 26 => flat(4),
        9 | 28 => flat(6),
        10 | 20 => flat(9),
        15 => flat(1),
        16 => flat(8),
        21 => flat(10),
        22 | 24 => flat(12),
        23 => flat(15),
        25 => flat(21),
        27 => flat(5),
        36 => flat(16),
        37 => flat(25),
        4 => solid(K::Tetrahedron, &[]),
        5 => solid(K::Hexahedron, &[]),
        6 => solid(K::Wedge, &[]),
        7 => solid(K::Pyramid, &[]),
        11 => solid(K::QuadraticTetrahedron, &[4, 5, 6, 7, 9, 8]),
        12 => solid(
            K::TriquadraticHexahedron,
            &[8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15, 22, 23, 21, 24, 20, 25, 26],
        ),
        13 => solid(K::BiquadraticWedge, &[6, 9, 7, 12, 14, 13, 8, 10, 11, 15, 17, 16]),
        14 => solid(K::BiquadraticPyramid, &[5, 8, 10, 6, 7, 9, 11, 12, 13]),
        17 => solid(K::QuadraticHexahedron, &[8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15]),
        18 => solid(K::QuadraticWedge, &[6, 9, 7, 12, 14, 13, 8, 10, 11]),
        19 => solid(K::QuadraticPyramid, &[5, 8, 10, 6, 7, 9, 11, 12]),
        29..=31 | 71..=75 => {
            return Err(format!("element type {number} (tetrahedron of third order or more)"));
        }
        92..=98 => return Err(format!("element type {number} (hexahedron of third order or more)")),
        other => return Err(format!("element type {other}")),
    })
}

/// A run of elements of one type.
struct Group {
    kind: Type,
    /// Tags before the nodes of each, its own not counted; only in version 2.2.
    tags: u64,
    elements: u64,
}

/// The head of the next group: a block of version 4, a group of a binary file of version 2.2, or
/// one element of a text. In a text of version 2.2 the element's own tag comes first.
fn group(t: &mut Tokens, version_4: bool) -> Result<(Group, Option<u64>)> {
    let (number, tags, elements, tag) = if version_4 {
        t.skip_int()?;
        t.skip_int()?;
        (t.int()?, 0, t.size()?, None)
    } else if t.binary {
        let (number, elements, tags) = (t.int()?, t.int()?, t.int()?);
        (number, tags, elements, None)
    } else {
        let tag = t.int()?;
        (t.int()?, t.int()?, 1, Some(tag))
    };
    let kind = type_of(number).map_err(|name| {
        let expected = "a linear or quadratic element: tetrahedron, hexahedron, prism, pyramid";
        t.wrong(expected, name).with_help("write it with Mesh.ElementOrder = 1 or 2")
    })?;
    Ok((Group { kind, tags, elements }, tag))
}

/// The tag of an element that follows its group's head.
fn element_tag(t: &mut Tokens, version_4: bool) -> Result<u64> {
    if version_4 { t.size() } else { t.int() }
}

/// Goes over elements, at most `blocks` blocks of version 4 and about `most` elements; gives how
/// many there were.
pub(super) fn skip_elements(
    t: &mut Tokens,
    version_4: bool,
    blocks: u64,
    most: u64,
    mut each: impl FnMut(&Tokens, u64) -> Result<()>,
) -> Result<u64> {
    let (mut found, mut groups) = (0, 0);
    // A block may be empty, and so may a file.
    while if version_4 && blocks < u64::MAX { groups < blocks } else { found < most } {
        let (group, tag) = group(t, version_4)?;
        groups += 1;
        let left = most - found;
        if group.elements > left {
            return Err(t.wrong(format!("{left} more elements"), group.elements.to_string()));
        }
        for _ in 0..group.elements {
            let tag = match tag {
                Some(tag) => tag,
                None => element_tag(t, version_4)?,
            };
            each(t, tag)?;
            if version_4 {
                t.skip_sizes(group.kind.nodes)?;
            } else {
                t.skip_ints(group.tags.saturating_add(group.kind.nodes))?;
            }
        }
        found += group.elements;
    }
    Ok(found)
}

/// The elements of a file.
pub(super) struct Elements {
    file: Arc<GmshFile>,
    tokens: Tokens,
    group: Option<Group>,
    /// Whether the next element's own tag was read with its group.
    tag_read: bool,
    /// Elements read.
    at: u64,
    nodes: Vec<u64>,
    vertices: Vec<u64>,
}

impl Elements {
    pub(super) fn new(file: &Arc<GmshFile>) -> Self {
        let tokens = file.elements_start.clone();
        let file = Arc::clone(file);
        Self { file, tokens, group: None, tag_read: false, at: 0, nodes: vec![], vertices: vec![] }
    }

    fn read(&mut self, out: &mut CellBlock) -> Result<()> {
        let (t, version_4) = (&mut self.tokens, self.file.version_4);
        while self.group.as_ref().is_none_or(|g| g.elements == 0) {
            let (group, tag) = group(t, version_4)?;
            (self.group, self.tag_read) = (Some(group), tag.is_some());
        }
        let group = self.group.as_mut().expect("one was begun above");
        group.elements -= 1;
        if !self.tag_read {
            element_tag(t, version_4)?;
        }
        if !version_4 {
            t.skip_ints(group.tags)?;
        }
        let kind = &group.kind;
        self.at += 1;
        if kind.kind == CellKind::Flat {
            if version_4 {
                t.skip_sizes(kind.nodes)?
            } else {
                t.skip_ints(kind.nodes)?
            }
            out.push(CellKind::Flat, &[]);
            return Ok(());
        }
        self.nodes.clear();
        for _ in 0..kind.nodes {
            let tag = if version_4 { t.size()? } else { t.int()? };
            let node = self.file.nodes.find(tag);
            self.nodes.push(node.ok_or_else(|| t.wrong("the tag of a node", tag.to_string()))?);
        }
        let corners = self.nodes.len() - kind.order.len();
        self.vertices.clear();
        self.vertices.extend_from_slice(&self.nodes[..corners]);
        self.vertices.extend(kind.order.iter().map(|&i| self.nodes[usize::from(i)]));
        out.push(kind.kind, &self.vertices);
        Ok(())
    }
}

impl CellStream for Elements {
    fn next_block(&mut self, out: &mut CellBlock) -> Result<bool> {
        out.clear();
        let n = (self.file.info.cells - self.at).min(BLOCK as u64);
        (0..n).try_for_each(|_| self.read(out))?;
        self.tokens.check()?;
        Ok(n > 0)
    }
}
