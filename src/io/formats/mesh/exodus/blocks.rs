//! Element blocks of an Exodus II file: their types, their order of nodes, and their stream.

use super::Shared;
use crate::cells::{BLOCK, CellBlock, CellKind, CellStream, NumberStream};
use crate::error::{Error, Result};
use crate::formats::shared::arrays::Arrays;
use std::path::Path;
use std::sync::Arc;

/// Element blocks that a file may have.
const MOST_BLOCKS: u64 = 1 << 16;

/// A block of elements of one type.
pub(super) struct Block {
    /// Its number, from 1 on.
    pub(super) number: u64,
    pub(super) elements: u64,
    kind: CellKind,
    /// Where VTK's vertices are among the nodes of an element.
    order: Vec<usize>,
}

impl Block {
    fn connect(&self) -> String {
        format!("connect{}", self.number)
    }
}

/// The kind of a type of element, and where VTK's vertices after the corners are among its nodes;
/// empty where the orders are the same. Names differ after their first three letters.
fn kind_of(name: &str, nodes: u64) -> Option<(CellKind, &'static [usize])> {
    use CellKind as K;
    let letters: String = name.chars().take(3).collect::<String>().to_ascii_uppercase();
    Some(match (letters.as_str(), nodes) {
        ("TET", 4) => (K::Tetrahedron, &[]),
        ("TET", 10) => (K::QuadraticTetrahedron, &[]),
        ("HEX", 8) => (K::Hexahedron, &[]),
        ("HEX", 20) => (K::QuadraticHexahedron, &[8, 9, 10, 11, 16, 17, 18, 19, 12, 13, 14, 15]),
        ("HEX", 27) => (
            K::TriquadraticHexahedron,
            &[8, 9, 10, 11, 16, 17, 18, 19, 12, 13, 14, 15, 23, 24, 25, 26, 21, 22, 20],
        ),
        ("WED", 6) => (K::Wedge, &[]),
        ("WED", 15) => (K::QuadraticWedge, &[6, 7, 8, 12, 13, 14, 9, 10, 11]),
        ("WED", 18) => (K::BiquadraticWedge, &[6, 7, 8, 12, 13, 14, 9, 10, 11, 15, 16, 17]),
        ("PYR", 5) => (K::Pyramid, &[]),
        ("PYR", 13) => (K::QuadraticPyramid, &[]),
        ("PYR", 14) => (K::BiquadraticPyramid, &[]),
        (
            "CIR" | "SPH" | "POI" | "BAR" | "TRU" | "BEA" | "ROD" | "EDG" | "TRI" | "QUA" | "SHE" | "NSI",
            _,
        ) => (K::Flat, &[]),
        _ => return None,
    })
}

/// The blocks of a file, those without elements left out.
pub(super) fn blocks_of(path: &Path, arrays: &dyn Arrays) -> Result<Vec<Block>> {
    let wrong = |at: &str, expected: &str, got: String| Error::bad_input(path, at, expected, got);
    let count = arrays.dimension("num_el_blk");
    let count = count.ok_or_else(|| wrong("num_el_blk", "a number of element blocks", "none".into()))?;
    if count > MOST_BLOCKS {
        return Err(wrong("num_el_blk", "at most 65536 element blocks", count.to_string()));
    }
    let (mut blocks, mut total) = (vec![], 0u64);
    for number in 1..=count {
        // A block without elements has neither.
        let Some(elements) = arrays.dimension(&format!("num_el_in_blk{number}")).filter(|&n| n > 0) else {
            continue;
        };
        let connect = format!("connect{number}");
        let name = arrays.attribute(&connect, "elem_type");
        let array = arrays.array(&connect)?;
        let array = array.ok_or_else(|| wrong(&connect, "the nodes of the elements", "none".into()))?;
        let nodes = array.shape.get(1).copied().unwrap_or(0);
        let (kind, order) = kind_of(&name, nodes).ok_or_else(|| {
            let expected =
                "TETRA, HEX, WEDGE or PYRAMID of first or second order, or a type without a volume";
            wrong(&connect, expected, format!("'{name}' of {nodes} nodes"))
                .with_help("leave that block out, or convert the file to .vtu with ParaView")
        })?;
        if kind != CellKind::Flat && (array.shape.len() != 2 || array.shape[0] != elements) {
            let expected = format!("{elements} x {nodes} nodes");
            return Err(Error::bad_input(path, &connect[..], expected, format!("{:?}", array.shape)));
        }
        let corners = (0..kind.vertices().saturating_sub(order.len())).chain(order.iter().copied());
        total = total.saturating_add(elements);
        blocks.push(Block { number, elements, kind, order: corners.collect() });
    }
    match arrays.dimension("num_elem") {
        Some(told) if told != total => {
            Err(wrong("num_elem", &format!("{total}, as the blocks have"), told.to_string()))
        }
        _ => Ok(blocks),
    }
}

/// The elements of all blocks, one after another.
pub(super) struct Elements {
    shared: Arc<Shared>,
    /// Blocks begun.
    begun: usize,
    open: Option<Box<dyn NumberStream>>,
    /// Elements of this block not read yet.
    left: u64,
    nodes: Vec<f64>,
}

impl Elements {
    pub(super) fn new(shared: &Arc<Shared>) -> Self {
        Self { shared: Arc::clone(shared), begun: 0, open: None, left: 0, nodes: vec![] }
    }
}

impl CellStream for Elements {
    fn next_block(&mut self, out: &mut CellBlock) -> Result<bool> {
        out.clear();
        while self.left == 0 {
            if let Some(mut done) = self.open.take() {
                done.finish()?;
            }
            let Some(block) = self.shared.blocks.get(self.begun) else { return Ok(false) };
            self.begun += 1;
            self.left = block.elements;
            if block.kind != CellKind::Flat {
                self.open = Some(self.shared.arrays.numbers(&block.connect(), &[])?);
            }
        }
        let block = &self.shared.blocks[self.begun - 1];
        let n = self.left.min(BLOCK as u64) as usize;
        let Some(open) = &mut self.open else {
            (0..n).for_each(|_| out.push(CellKind::Flat, &[]));
            self.left -= n as u64;
            return Ok(true);
        };
        let count = block.order.len();
        self.nodes.resize(n * count, 0.0);
        open.fill(&mut self.nodes)?;
        let mut vertices = vec![0; count];
        for (i, nodes) in self.nodes.chunks_exact(count).enumerate() {
            for (vertex, &from) in vertices.iter_mut().zip(&block.order) {
                // They count from 1, in the order of the coordinates, whatever ids maps give.
                let node = nodes[from];
                if !(node >= 1.0 && node <= self.shared.info.points as f64 && node.fract() == 0.0) {
                    let element = block.elements - self.left + i as u64 + 1;
                    let expected = format!("nodes from 1 to {}", self.shared.info.points);
                    let at = format!("{}, element {element}", block.connect());
                    return Err(Error::bad_input(&self.shared.info.path, at, expected, node.to_string()));
                }
                *vertex = node as u64 - 1;
            }
            out.push(block.kind, &vertices);
        }
        self.left -= n as u64;
        Ok(true)
    }
}
