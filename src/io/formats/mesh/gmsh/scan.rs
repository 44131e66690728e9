//! The first pass over a `.msh` file finds its sections, its tags and its data.

use super::MOST_RUNS;
use super::elements::skip_elements;
use super::file::{DataList, GmshFile, Runs};
use super::tokens::Tokens;
use crate::bytes::ByteSource;
use crate::cells::{CellField, CellsInfo, Center};
use crate::error::{Error, Result};
use std::sync::Arc;

/// Data lists that a file may have.
const MOST_LISTS: usize = 1 << 16;
/// The most lines of text of a section of data; the first is its name.
const MOST_STRINGS: u64 = 1000;

/// Components of a datum.
const MOST_COMPONENTS: u64 = 1 << 10;

/// Looks through a file.
pub(super) fn scan(source: &Arc<ByteSource>) -> Result<GmshFile> {
    let mut tokens =
        Tokens { source: Arc::clone(source), at: 0, binary: false, big_endian: false, size_bytes: 8 };
    let version_4 = format(&mut tokens)?;
    let mut look = Look { version_4, nodes: None, elements: None, data: vec![] };
    let text = Tokens { binary: false, ..tokens.clone() };
    let mut at = text;
    while let Some(name) = next_section(&mut at)? {
        let mut inside = Tokens { binary: tokens.binary, ..at.clone() };
        match name.as_str() {
            "Nodes" => look.nodes(&mut inside)?,
            "Elements" => look.elements(&mut inside)?,
            "NodeData" => look.data_list(&mut inside, Center::Point)?,
            "ElementData" => look.data_list(&mut inside, Center::Cell)?,
            _ => inside.at = find_end(&inside, &name)?,
        }
        at.at = inside.at;
        let end = format!("$End{name}");
        let found = at.word()?.to_string();
        if found != end {
            return Err(at.wrong(end, format!("'{}'", found.chars().take(40).collect::<String>())));
        }
    }
    look.finish(source, tokens.binary)
}

/// `$MeshFormat`; whether it is version 4.1.
fn format(tokens: &mut Tokens) -> Result<bool> {
    if tokens.word()? != "$MeshFormat" {
        return Err(tokens
            .wrong("$MeshFormat", "something else")
            .with_help("files before version 2 are not read"));
    }
    let version = tokens.word()?.to_string();
    let version_4 = match version.as_str() {
        "4.1" => true,
        "2" | "2.1" | "2.2" => false,
        other => {
            return Err(tokens
                .wrong("version 2.2 or 4.1", format!("version {other}"))
                .with_help("write it with Mesh.MshFileVersion = 4.1"));
        }
    };
    let (binary, size): (u64, u64) = (tokens.parse("0 or 1")?, tokens.parse("4 or 8")?);
    if binary > 1 || !(size == 8 || size == 4 && version_4) {
        return Err(tokens.wrong("0 or 1, and 8", format!("{binary} {size}")));
    }
    tokens.line()?;
    tokens.size_bytes = size as usize;
    if binary == 1 {
        tokens.binary = true;
        let one = tokens.int();
        tokens.at -= 4 * u64::from(one.is_ok());
        tokens.big_endian = one? != 1;
        if tokens.int()? != 1 {
            return Err(tokens.wrong("the int 1", "another"));
        }
        tokens.binary = false;
    }
    let found = tokens.word()?.to_string();
    if found != "$EndMeshFormat" {
        return Err(tokens.wrong("$EndMeshFormat", "something else"));
    }
    tokens.binary = binary == 1;
    Ok(version_4)
}

/// The name of the next section; the place after its line.
fn next_section(at: &mut Tokens) -> Result<Option<String>> {
    let rest = at.source.slice(at.at..at.source.len())?;
    if rest.trim_ascii().is_empty() {
        return Ok(None);
    }
    let found = at.word()?.to_string();
    let Some(name) = found.strip_prefix('$') else {
        return Err(at.wrong(
            "a section, such as $Nodes",
            format!("'{}'", found.chars().take(40).collect::<String>()),
        ));
    };
    at.line()?;
    Ok(Some(name.to_string()))
}

/// Where the end of a section that is not read is.
fn find_end(at: &Tokens, name: &str) -> Result<u64> {
    let end = format!("$End{name}");
    let rest = at.source.slice(at.at..at.source.len())?;
    let found = rest.windows(end.len()).position(|w| w == end.as_bytes());
    found.map(|n| at.at + n as u64).ok_or_else(|| at.wrong(end, "the end of the file"))
}

/// What was found so far.
struct Look {
    version_4: bool,
    nodes: Option<(Tokens, u64, Runs)>,
    elements: Option<(Tokens, u64)>,
    data: Vec<DataList>,
}

impl Look {
    fn nodes(&mut self, t: &mut Tokens) -> Result<()> {
        if self.nodes.is_some() {
            return Err(t.wrong("one section $Nodes", "another"));
        }
        let (blocks, count) = counts(t, self.version_4)?;
        let (start, mut runs) = (t.clone(), Runs::default());
        let mut push = |t: &mut Tokens, tag: u64| match runs.push(tag) {
            true => Ok(()),
            false => Err(t
                .wrong(format!("node tags in at most {MOST_RUNS} runs"), "more")
                .with_help("renumber the mesh in Gmsh")),
        };
        if self.version_4 {
            for _ in 0..blocks {
                let block = t.node_block()?;
                for _ in 0..block.nodes {
                    let tag = t.size()?;
                    push(t, tag)?;
                }
                t.skip_reals(block.nodes.saturating_mul(3 + block.extra))?;
            }
        } else {
            for _ in 0..count {
                let tag = t.int()?;
                push(t, tag)?;
                t.skip_reals(3)?;
            }
        }
        if runs.count != count {
            return Err(t.wrong(format!("{count} nodes"), runs.count.to_string()));
        }
        if let Some(tag) = runs.sort() {
            return Err(t.wrong("node tags that are unique", format!("{tag} twice")));
        }
        self.nodes = Some((start, blocks, runs));
        Ok(())
    }

    fn elements(&mut self, t: &mut Tokens) -> Result<()> {
        if self.elements.is_some() {
            return Err(t.wrong("one section $Elements", "another"));
        }
        let (blocks, count) = counts(t, self.version_4)?;
        let start = t.clone();
        let found = skip_elements(t, self.version_4, blocks, count, |_, _| Ok(()))?;
        if found != count {
            return Err(t.wrong(format!("{count} elements"), found.to_string()));
        }
        self.elements = Some((start, count));
        Ok(())
    }

    fn data_list(&mut self, t: &mut Tokens, center: Center) -> Result<()> {
        if self.data.len() == MOST_LISTS {
            return Err(t.wrong(format!("at most {MOST_LISTS} sections of data"), "more"));
        }
        let binary = std::mem::replace(&mut t.binary, false);
        let strings: u64 = t.parse("a number of strings")?;
        if strings > MOST_STRINGS {
            return Err(t.wrong(format!("at most {MOST_STRINGS} strings"), strings.to_string()));
        }
        t.line()?;
        let mut name = String::new();
        for i in 0..strings {
            let line = t.line()?;
            if i == 0 {
                name = line.trim_matches('"').to_string();
            }
        }
        let reals: u64 = t.parse("a number of reals")?;
        (0..reals).try_for_each(|_| t.parse::<f64>("a number").map(drop))?;
        let ints: u64 = t.parse("a number of integers")?;
        if ints < 3 {
            return Err(t.wrong("3 integers: step, components, entries", ints.to_string()));
        }
        let (step, components, entries): (u64, u64, u64) =
            (t.parse("a time step")?, t.parse("a number of components")?, t.parse("a number of entries")?);
        (3..ints).try_for_each(|_| t.word().map(drop))?;
        if components == 0 || components > MOST_COMPONENTS {
            return Err(t.wrong(format!("1 to {MOST_COMPONENTS} components"), components.to_string()));
        }
        if binary {
            t.line()?;
        }
        t.binary = binary;
        let start = t.clone();
        if binary {
            let each = 4 + 8 * components;
            let bytes = entries.checked_mul(each).filter(|&b| b <= t.source.len() - t.at);
            t.at += bytes.ok_or_else(|| {
                t.wrong(format!("{entries} entries of {each} bytes"), "the end of the file")
            })?;
        } else {
            (0..entries).try_for_each(|_| (0..=components).try_for_each(|_| t.word().map(drop)))?;
        }
        let components = components as u32;
        self.data.push(DataList { name, step, center, components, entries, start });
        Ok(())
    }

    fn finish(mut self, source: &Arc<ByteSource>, binary: bool) -> Result<GmshFile> {
        let lacks = |what: &str| Error::bad_input(source.path(), "sections", what, "none");
        let (nodes_start, node_blocks, nodes) = self.nodes.ok_or_else(|| lacks("$Nodes"))?;
        let (elements_start, cells) = self.elements.ok_or_else(|| lacks("$Elements"))?;
        let mut elements = Runs::default();
        if self.data.iter().any(|d| d.center == Center::Cell) {
            // The head of the section is before the place where elements start: blocks are counted
            // by elements.
            let mut t = elements_start.clone();
            skip_elements(&mut t, self.version_4, u64::MAX, cells, |t, tag| match elements.push(tag) {
                true => Ok(()),
                false => Err(t
                    .wrong(format!("element tags in at most {MOST_RUNS} runs"), "more")
                    .with_help("renumber the mesh in Gmsh")),
            })?;
            if let Some(tag) = elements.sort() {
                return Err(t.wrong("element tags that are unique", format!("{tag} twice")));
            }
        }
        name_steps(&mut self.data);
        let field = |d: &DataList| CellField {
            name: d.name.clone(),
            scalar: d.scalar(),
            components: d.components,
            center: d.center,
        };
        let version = if self.version_4 { "4.1" } else { "2.2" };
        let info = CellsInfo {
            path: source.path().to_path_buf(),
            format: format!("Gmsh {version} ({})", if binary { "binary" } else { "ascii" }),
            points: nodes.count,
            cells,
            fields: self.data.iter().map(field).collect(),
            active: None,
            data_files: vec![],
        };
        source.check()?;
        let (version_4, data) = (self.version_4, self.data);
        Ok(GmshFile { info, version_4, nodes_start, node_blocks, nodes, elements_start, elements, data })
    }
}

/// Numbers of blocks and of entries, which a file has room for.
fn counts(t: &mut Tokens, version_4: bool) -> Result<(u64, u64)> {
    let (blocks, count) = if version_4 {
        let counts = (t.size()?, t.size()?);
        t.skip_sizes(2)?;
        counts
    } else {
        // Counted in text also in a binary file.
        let binary = std::mem::replace(&mut t.binary, false);
        let count = t.parse("a number")?;
        if binary {
            t.line()?;
        }
        t.binary = binary;
        (1, count)
    };
    if blocks.max(count) > t.source.len() {
        let got = format!("{blocks} blocks, {count} entries");
        return Err(t.wrong(format!("fewer than the {} bytes of the file", t.source.len()), got));
    }
    Ok((blocks, count))
}

/// Gives fields of one name different ones.
fn name_steps(data: &mut [DataList]) {
    let mut seen = std::collections::HashSet::new();
    for list in data {
        if !seen.insert((list.name.clone(), list.center)) {
            list.name = format!("{}@{}", list.name, list.step);
        }
    }
}
