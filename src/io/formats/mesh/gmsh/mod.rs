//! Gmsh's `.msh` files of versions 2.2 and 4.1, ascii and binary, with `$NodeData` and
//! `$ElementData`.
//!
//! ```text
//! $MeshFormat
//! 4.1 0 8                         version, 1 for binary, bytes of a size; a binary file has the int 1 after it
//! $EndMeshFormat
//! $Nodes
//! 1 4 1 4                         blocks, nodes, least and largest tag            2.2: nodes
//! 3 1 0 4                         dimension, entity, parametric, nodes in it           tag x y z
//! 1 2 3 4                         tags, then positions                                 …
//! 0 0 0 …
//! $EndNodes
//! $Elements
//! 1 1 1 1                         blocks, elements, least and largest tag         2.2: elements
//! 3 1 4 1                         dimension, entity, type, elements in it              tag type n tags… nodes…
//! 1 1 2 3 4                       tag, nodes                                           (binary: type n tags, in groups)
//! $EndElements
//! $NodeData
//! 1 "pressure" 1 0.0 3 0 1 4      strings; reals; integers: step, components, entries
//! 1 0.5 …                         tag, components
//! $EndNodeData
//! ```
//!
//! **Tags.** Nodes have tags of their own, in any order and with gaps, and elements name them.
//! Points are numbered here in file order; tags are found in a table of *runs* of consecutive tags.
//! Real files have one run for each entity. A file with more than [`MOST_RUNS`] is refused: Gmsh
//! can renumber it.
//!
//! **Data** lists may lack entries: those are NaN. They may be in any order: a list in the order of
//! the points is read once, any other once for each window of a million numbers. A name that occurs
//! again (other time steps) has the step's number added: `pressure@1`.
//!
//! Other sections are skipped. A first pass scans the whole file once; its memory is that of the
//! runs.

mod elements;
mod file;
mod scan;
mod tokens;

use crate::cells::{CellFile, CellStream, CellsInfo, Center, NumberStream};
use crate::error::Result;
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::mesh_file::{MeshFile, PlainMesh};
use elements::Elements;
use file::{DataList, GmshFile};
use std::sync::Arc;
use tokens::Tokens;

/// Gmsh.
pub(in crate::formats) struct Gmsh;

static ABOUT: About =
    About { meshes: &["Gmsh"], suffixes: &[".msh"], magic: &[b"$MeshFormat"], ..About::named("a Gmsh file") };

impl Format for Gmsh {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let file = scan::scan(head.file()?)?;
        Ok(Box::new(PlainMesh(MeshFile::new(Mesh(Arc::new(file)))?)))
    }
}

/// Runs of consecutive tags that a file may have.
pub(crate) const MOST_RUNS: usize = 1 << 20;

/// Numbers of a data list that are gathered at a time.
const WINDOW: u64 = 1 << 20;

struct Mesh(Arc<GmshFile>);

impl CellFile for Mesh {
    fn info(&self) -> &CellsInfo {
        &self.0.info
    }

    fn points(&self) -> Result<Box<dyn NumberStream>> {
        let tokens = self.0.nodes_start.clone();
        Ok(Box::new(Positions { file: Arc::clone(&self.0), tokens, blocks: 0, left: 0, extra: 0 }))
    }

    fn cells(&self) -> Result<Box<dyn CellStream>> {
        Ok(Box::new(Elements::new(&self.0)))
    }

    fn field(&self, field: usize) -> Result<Box<dyn NumberStream>> {
        let list = &self.0.data[field];
        let tuples = match list.center {
            Center::Point => self.0.info.points,
            Center::Cell => self.0.info.cells,
        };
        let numbers = tuples * u64::from(list.components);
        let (next, file) = (list.start.clone(), Arc::clone(&self.0));
        let ordered = list.is_ordered(&file)?;
        Ok(Box::new(Gathered {
            file,
            field,
            ordered,
            next,
            entry: 0,
            numbers,
            first: 0,
            window: vec![],
            used: 0,
        }))
    }
}

/// The positions of all nodes.
struct Positions {
    file: Arc<GmshFile>,
    tokens: Tokens,
    /// Blocks begun; version 2.2 has one.
    blocks: u64,
    /// Nodes of this block to come.
    left: u64,
    /// Parameters after each position.
    extra: u64,
}

impl Positions {
    fn begin_block(&mut self) -> Result<()> {
        self.blocks += 1;
        if !self.file.version_4 {
            self.left = self.file.info.points;
            return Ok(());
        }
        let block = self.tokens.node_block()?;
        self.tokens.skip_sizes(block.nodes)?;
        (self.left, self.extra) = (block.nodes, block.extra);
        Ok(())
    }
}

impl NumberStream for Positions {
    fn fill(&mut self, out: &mut [f64]) -> Result<()> {
        for position in out.chunks_exact_mut(3) {
            while self.left == 0 {
                assert!(self.blocks < self.file.node_blocks, "the nodes of all blocks were counted");
                self.begin_block()?;
            }
            if !self.file.version_4 {
                self.tokens.int()?;
            }
            for x in position {
                *x = self.tokens.real()?;
            }
            for _ in 0..self.extra {
                self.tokens.real()?;
            }
            self.left -= 1;
        }
        self.tokens.check()
    }

    fn finish(&mut self) -> Result<()> {
        // The first look has seen that the section ends here.
        Ok(())
    }
}

/// The entries of a data list in the order of the points or cells.
struct Gathered {
    file: Arc<GmshFile>,
    field: usize,
    /// Whether the list is in the order of the points or cells.
    ordered: bool,
    /// The next entry, and the number of entries before it; the first one in a list that is not
    /// ordered.
    next: Tokens,
    entry: u64,
    /// Numbers of all tuples.
    numbers: u64,
    /// The first number after the window.
    first: u64,
    window: Vec<f64>,
    used: usize,
}

impl Gathered {
    /// Goes through the list for the next window.
    fn gather(&mut self) -> Result<()> {
        let list = &self.file.data[self.field];
        let components = u64::from(list.components);
        let most = WINDOW / components * components;
        let n = (self.numbers - self.first).min(most.max(components));
        self.window.clear();
        self.window.resize(n as usize, f64::NAN);
        self.used = 0;
        let (mut tokens, mut entry) = (self.next.clone(), self.entry);
        while entry < list.entries {
            let before = self.ordered.then(|| tokens.clone());
            let tag = tokens.int()?;
            let at = self.file.index_of(list.center, tag).map(|i| (i * components).wrapping_sub(self.first));
            if let (Some(before), Some(true)) = (before, at.map(|at| at >= n)) {
                (self.next, self.entry) = (before, entry);
                break;
            }
            for c in 0..components {
                let value = tokens.real()?;
                if let Some(slot) = at.and_then(|at| self.window.get_mut(at.wrapping_add(c) as usize)) {
                    *slot = value;
                }
            }
            entry += 1;
        }
        if self.ordered && entry == list.entries {
            self.entry = entry;
        }
        self.first += n;
        tokens.check()
    }
}

impl NumberStream for Gathered {
    fn fill(&mut self, out: &mut [f64]) -> Result<()> {
        for x in out {
            if self.used == self.window.len() {
                self.gather()?;
            }
            *x = self.window[self.used];
            self.used += 1;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }
}

impl GmshFile {
    /// The number of the point or cell of a tag.
    fn index_of(&self, center: Center, tag: u64) -> Option<u64> {
        match center {
            Center::Point => self.nodes.find(tag),
            Center::Cell => self.elements.find(tag),
        }
    }
}

impl DataList {
    /// Whether the entries are in the order of the points or cells.
    fn is_ordered(&self, file: &GmshFile) -> Result<bool> {
        let (mut tokens, mut last) = (self.start.clone(), None);
        for _ in 0..self.entries {
            let tag = tokens.int()?;
            tokens.skip_reals(self.components.into())?;
            if let Some(index) = file.index_of(self.center, tag) {
                if last.is_some_and(|last| last >= index) {
                    return Ok(false);
                }
                last = Some(index);
            }
        }
        Ok(true)
    }
    /// The type of its numbers in the file.
    fn scalar(&self) -> crate::volume::ScalarType {
        crate::volume::ScalarType::F64
    }
}

#[cfg(test)]
mod tests;
