//! A mesh at several levels of detail, cut into the cells of an octree.
//!
//! ```text
//!  surface ─▶ lattice of 16 bits a cell ─▶ cut at planes ─▶ sorted by cell ─▶ Draco ─▶ level 0
//!     └─▶ a quarter of its triangles ─▶ ... of cells of twice the size ─▶ level 1 ─▶ ...
//! ```
//!
//! Level `k` has cells of `2^k` times the edge of those of level 0, and steps of `2^k` times the
//! length, which is 1/65535 of the edge. Each level is decimated from the one before, which keeps
//! all pieces and holes of the surface. A corner is off by half a step along each axis at most; one
//! that is new, where a triangle is cut, by a step. What is smaller than a step vanishes: cells are
//! so small that nearly all edges of triangles have several steps.
//!
//! Source: "Multi-resolution mesh format" of neuroglancer's documentation.

use super::cut::{CELL, HALF, Place, cut, span};
use super::draco::{Corners, encode};
use crate::surface::SurfaceSource;
use crate::surface::edit::decimate::{Decimation, decimate};
use crate::surface::edit::faces::Faces;
use crate::surface::weld::{BuilderSettings, StoredSurface};
use bytemuck::{Pod, Zeroable};
use isospan_io::bytes::sorter::{Sorted, Sorter};
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::geom::vec3::{cross, dot, minus};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// Triangles that a cell of level 0 has, about, before they are cut.
const OF_CELL: u64 = 1 << 14;
/// Triangles that a cell of a coarser level has at most: without it there is no such level.
const MOST_OF_CELL: u64 = 1 << 16;
/// Steps that 99 % of the edges of triangles have at least.
const OF_EDGE: f64 = 4.0;
/// A surface in one cell with no more triangles has no coarser level.
const FEW: u64 = 1 << 11;
/// The part of the triangles that the next level has.
const RATIO: f64 = 0.25;
/// A level that keeps more than this part of the one before is not worth its bytes.
const TOO_MANY: f64 = 0.6;
/// Cells along the longest edge of the box are at most 2 to this power.
const DEEPEST: u32 = 16;
/// Bytes that a triangle takes while its fragment is encoded.
const OF_TRIANGLE: u64 = 512;
/// Triangles that are encoded side by side, at most.
const AT_ONCE: u64 = 1 << 20;

/// What the writer may use.
pub(super) struct WriterMeans<'a> {
    pub(super) memory: u64,
    /// Bytes that each store of vertices or triangles holds; more lie in the scratch folder.
    pub(super) held: usize,
    pub(super) scratch: PathBuf,
    pub(super) pool: ThreadPool,
    pub(super) cancel: CancelToken,
    /// The folder that errors name.
    pub(super) target: &'a Path,
}

impl WriterMeans<'_> {
    /// What a store may hold.
    pub(super) fn store(&self) -> BuilderSettings {
        BuilderSettings { memory_bytes: self.held, scratch: self.scratch.clone() }
    }
}

/// The memory of a run in which the largest mesh, of this many triangles, is decimated: half of it
/// holds the surface, and half of the rest the stores.
pub(super) fn least_memory(triangles: u64) -> u64 {
    if triangles > FEW { 4 * Decimation::least_memory(triangles) } else { 0 }
}

/// The box of a surface and its cells of level 0.
struct Lattice {
    origin: [f32; 3],
    size: [f64; 3],
    /// The edge of a cell.
    edge: f32,
}

impl Lattice {
    /// The cells along each axis.
    fn cells(&self, level: u32) -> Place {
        let edge = self.cell_edge(level);
        self.size.map(|size| ((size / edge).ceil() as i64).max(1))
    }

    fn cell_edge(&self, level: u32) -> f64 {
        f64::from(self.edge) * f64::from(1u32 << level)
    }

    /// The Morton number of the cell of a level in which a position lies.
    fn cell(&self, position: [f32; 3], level: u32, cells: Place) -> u64 {
        let at = self.place(position, level, cells);
        morton(std::array::from_fn(|k| (at[k] / CELL).min(cells[k] - 1) as u32))
    }

    /// The step of a level that is nearest to a position.
    fn place(&self, position: [f32; 3], level: u32, cells: Place) -> Place {
        let step = self.cell_edge(level) / CELL as f64;
        std::array::from_fn(|k| {
            let at = (f64::from(position[k]) - f64::from(self.origin[k])) / step;
            (at.round() as i64).clamp(0, cells[k] * CELL)
        })
    }
}

/// A surface on its way through its levels.
struct Levels<'a> {
    means: &'a WriterMeans<'a>,
    lattice: Lattice,
}

/// A cell of a level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Node {
    at: [u32; 3],
    /// The bytes of its fragment; none where no triangle is.
    bytes: u32,
    /// Which of its octants have triangles: a bit for each, x fastest.
    filled: u8,
}

/// A level of detail.
struct Level {
    /// About the length of an edge of a triangle.
    scale: f32,
    /// Its cells, in Morton order.
    nodes: BTreeMap<u64, Node>,
}

/// A piece of a triangle that lies in one cell, as it is sorted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct TrianglePiece {
    /// The Morton number of the cell, its highest 16 bits first.
    cell: [u16; 4],
    corners: Corners,
}

impl TrianglePiece {
    fn of(corners: &[Place; 3], cells: Place) -> Self {
        // What lies in the last plane belongs to the last cell.
        let at: Place = std::array::from_fn(|k| (span(corners, k)[0] / CELL).min(cells[k] - 1));
        let number = morton(at.map(|x| x as u32));
        Self {
            cell: [48, 32, 16, 0].map(|shift| (number >> shift) as u16),
            corners: corners.map(|corner| std::array::from_fn(|k| (corner[k] - at[k] * CELL) as u16)),
        }
    }

    fn number(&self) -> u64 {
        self.cell.iter().fold(0, |number, &part| number << 16 | u64::from(part))
    }

    /// The octant of its cell that it lies in: a bit for each axis.
    fn octant(&self) -> u8 {
        let is_upper = |k: usize| self.corners.iter().any(|corner| i64::from(corner[k]) > HALF);
        (0..3).map(|k| u8::from(is_upper(k)) << k).sum()
    }
}

/// The Morton number of a cell: bits of x, y and z in turn, x lowest.
fn morton(at: [u32; 3]) -> u64 {
    let spread = |x: u32| (0..21).map(|bit| u64::from(x >> bit & 1) << (3 * bit)).sum::<u64>();
    spread(at[0]) | spread(at[1]) << 1 | spread(at[2]) << 2
}

/// The triangles of a cell.
struct Fragment {
    number: u64,
    filled: u8,
    triangles: Vec<Corners>,
}

/// Hands on the fragments of all levels, and returns the manifest of the mesh; none where no
/// triangle is as large as a step.
///
/// # Errors
/// [`Error::Budget`] for memory, [`Error::Cancelled`], those of the scratch folder and of `put`.
pub(super) fn write_levels(
    mut surface: StoredSurface,
    means: &WriterMeans<'_>,
    put: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<Option<Vec<u8>>> {
    let Some(whole) = lattice_of(&surface)? else { return Ok(None) };
    let (edge, lattice) = fit_cells(&surface, &whole, means)?;
    let (all, levels) = (surface.triangle_count(), Levels { means, lattice });
    let mut done: Vec<Level> = vec![];
    loop {
        let (level, count) = (done.len() as u32, surface.triangle_count());
        let scale = edge * (all as f64 / count as f64).sqrt();
        let nodes = levels.write(&surface, level, put)?;
        if level == 0 && nodes.is_empty() {
            return Ok(None);
        }
        done.push(Level { scale: (scale as f32).max(f32::MIN_POSITIVE), nodes });
        let is_one = levels.lattice.cells(level) == [1; 3];
        if is_one && count <= FEW || level > DEEPEST {
            break;
        }
        let goal = Decimation { ratio: RATIO, ..Decimation::default() };
        let memory_bytes = usize::try_from(means.memory / 2).unwrap_or(usize::MAX);
        let memory = BuilderSettings { memory_bytes, ..means.store() };
        let fewer =
            means.pool.install(|| decimate(surface, &goal, &Faces::default(), &memory, &means.cancel));
        surface = fewer.map_err(|e| e.of_share(means.memory / 2, means.memory))?.0;
        let is_worth_it = surface.triangle_count() as f64 <= TOO_MANY * count as f64;
        if !is_worth_it || levels.most_in_cell(&surface, level + 1)? > MOST_OF_CELL {
            break;
        }
    }
    link(&mut done);
    Ok(Some(manifest(&levels.lattice, &done)))
}

/// Hands on the corners of all triangles.
fn each_triangle(
    surface: &StoredSurface,
    means: &WriterMeans<'_>,
    mut each: impl FnMut([[f32; 3]; 3]) -> Result<()>,
) -> Result<()> {
    let mut vertices = surface.random_vertices(means.held);
    surface.triangles(&mut |batch| {
        means.cancel.check()?;
        for triangle in batch {
            let mut corners = [[0.0; 3]; 3];
            for (corner, &v) in corners.iter_mut().zip(triangle) {
                *corner = vertices.get(u64::from(v))?.position;
            }
            each(corners)?;
        }
        Ok(())
    })
}

/// The box of a surface, in one cell; none where no vertex is.
fn lattice_of(surface: &StoredSurface) -> Result<Option<Lattice>> {
    let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    surface.vertices(&mut |batch| {
        for vertex in batch {
            for (k, &x) in vertex.position.iter().enumerate() {
                (lo[k], hi[k]) = (lo[k].min(x), hi[k].max(x));
            }
        }
        Ok(())
    })?;
    if lo[0] > hi[0] {
        return Ok(None);
    }
    let size: [f64; 3] = std::array::from_fn(|k| f64::from(hi[k]) - f64::from(lo[k]));
    let edge = edge_of(size.into_iter().fold(0.0, f64::max));
    Ok(Some(Lattice { origin: lo, size, edge }))
}

/// The edge of a cell that a length fits in.
fn edge_of(length: f64) -> f32 {
    match length as f32 {
        0.0 => 1.0,
        edge => edge.next_up(),
    }
}

/// The length of an edge of a triangle, about, and a lattice of level 0: its cells have no far more
/// triangles than usual, and its steps are short enough for the edges.
///
/// Where a surface is dense at one place and has large triangles at others, cells are not so small
/// that cutting makes far more triangles, or that cells have few.
fn fit_cells(surface: &StoredSurface, whole: &Lattice, means: &WriterMeans<'_>) -> Result<(f64, Lattice)> {
    let (count, longest) = (surface.triangle_count(), whole.size.into_iter().fold(0.0, f64::max));
    // What fills its box has eight times as many cells of half the edge, and others fewer.
    let mut depth = (0..DEEPEST).find(|depth| OF_CELL << (3 * depth) >= count).unwrap_or(DEEPEST);
    let mut coarser: Option<Lattice> = None;
    loop {
        let lattice = Lattice { edge: edge_of(longest / f64::from(1u32 << depth)), ..*whole };
        let census = Census::of(surface, &lattice, means)?;
        let edge = (census.area * 4.0 / 3f64.sqrt() / count.max(1) as f64).sqrt();
        if let Some(coarser) = coarser.filter(|_| census.is_too_fine(count)) {
            return Ok((edge, coarser));
        }
        let is_fine = census.short_edge() >= OF_EDGE * f64::from(lattice.edge) / CELL as f64;
        if is_fine && census.most() <= 2 * OF_CELL || depth == DEEPEST {
            return Ok((edge, lattice));
        }
        (coarser, depth) = (Some(lattice), depth + 1);
    }
}

/// What the triangles of a surface say of the cells of a lattice.
struct Census {
    area: f64,
    /// Edges by the highest bits of their lengths.
    edges: Vec<u64>,
    /// First corners of triangles in each cell.
    in_cells: HashMap<u64, u64>,
    /// Pieces that cutting makes, about.
    pieces: f64,
}

/// Bits of an `f32` that do not choose its place among lengths.
const LOW_BITS: u32 = 20;

impl Census {
    fn of(surface: &StoredSurface, lattice: &Lattice, means: &WriterMeans<'_>) -> Result<Self> {
        let mut census =
            Self { area: 0.0, edges: vec![0; 1 << (32 - LOW_BITS)], in_cells: HashMap::new(), pieces: 0.0 };
        let most_cells = most_cells(surface.triangle_count());
        let (cells, edge) = (lattice.cells(0), f64::from(lattice.edge));
        each_triangle(surface, means, |corners| {
            census.area += area_of(corners);
            let mut longest = 0.0;
            for n in 0..3 {
                let [from, to] = [corners[n], corners[(n + 1) % 3]].map(|p| p.map(f64::from));
                let along = minus(to, from);
                let length = dot(along, along).sqrt();
                longest = f64::max(longest, length);
                census.edges[((length as f32).to_bits() >> LOW_BITS) as usize] += 1;
            }
            census.pieces += (1.0 + longest / edge).powi(2);
            let number = lattice.cell(corners[0], 0, cells);
            if census.in_cells.len() as u64 <= most_cells || census.in_cells.contains_key(&number) {
                *census.in_cells.entry(number).or_default() += 1;
            }
            Ok(())
        })?;
        Ok(census)
    }

    fn most(&self) -> u64 {
        self.in_cells.values().copied().max().unwrap_or(0)
    }

    /// A length that 99 % of the edges have at least. Edges between equal positions do not count.
    fn short_edge(&self) -> f64 {
        let all: u64 = self.edges.iter().skip(1).sum();
        let mut shorter = 0;
        for (bits, count) in self.edges.iter().enumerate().skip(1) {
            shorter += count;
            if 100 * shorter > all {
                return f64::from(f32::from_bits((bits as u32) << LOW_BITS));
            }
        }
        f64::INFINITY
    }

    /// Whether cells are too small for so many triangles.
    fn is_too_fine(&self, triangles: u64) -> bool {
        let most_pieces = 1.5 * triangles as f64 + 4096.0;
        self.in_cells.len() as u64 > most_cells(triangles) || self.pieces > most_pieces
    }
}

/// Cells that a surface of so many triangles has at most.
fn most_cells(triangles: u64) -> u64 {
    triangles / 64 + 1024
}

fn area_of(corners: [[f32; 3]; 3]) -> f64 {
    let [a, b, c] = corners.map(|p| p.map(f64::from));
    let normal = cross(minus(b, a), minus(c, a));
    dot(normal, normal).sqrt() / 2.0
}

impl Levels<'_> {
    /// Hands on the fragments of a level, and returns its cells.
    fn write(
        &self,
        surface: &StoredSurface,
        level: u32,
        put: &mut dyn FnMut(&[u8]) -> Result<()>,
    ) -> Result<BTreeMap<u64, Node>> {
        let mut sorted = self.pieces(surface, level)?;
        let mut next = sorted.next()?;
        let mut nodes = BTreeMap::new();
        let most = (self.means.memory / 8 / OF_TRIANGLE).min(AT_ONCE);
        while next.is_some() {
            self.means.cancel.check()?;
            let (mut fragments, mut held) = (vec![], 0);
            while let Some(piece) = next.filter(|_| held == 0 || held < most) {
                let fragment = self.fragment(piece, &mut sorted, &mut next)?;
                held += fragment.triangles.len() as u64;
                fragments.push(fragment);
            }
            let encoded: Vec<_> = self
                .means
                .pool
                .install(|| fragments.par_iter().map(|fragment| encode(&fragment.triangles)).collect());
            for (fragment, bytes) in fragments.iter().zip(encoded) {
                let bytes = bytes.map_err(|e| self.broken(e.to_string()))?;
                put(&bytes)?;
                let at = place_of(fragment.number);
                let bytes = u32::try_from(bytes.len()).map_err(|e| self.broken(e.to_string()))?;
                nodes.insert(fragment.number, Node { at, bytes, filled: fragment.filled });
            }
        }
        Ok(nodes)
    }

    fn broken(&self, why: String) -> Error {
        Error::io("write", self.means.target, io::Error::new(ErrorKind::InvalidData, why))
    }

    /// The pieces of all triangles, cell by cell.
    fn pieces(&self, surface: &StoredSurface, level: u32) -> Result<Sorted<TrianglePiece>> {
        let (means, cells) = (self.means, self.lattice.cells(level));
        let mut sorter = Sorter::new(means.held, &means.scratch);
        let mut pieces = vec![];
        each_triangle(surface, means, |corners| {
            pieces.clear();
            let corners = corners.map(|corner| self.lattice.place(corner, level, cells));
            cut(corners, level > 0, &mut pieces);
            pieces.iter().try_for_each(|piece| sorter.push(TrianglePiece::of(piece, cells)))
        })?;
        sorter.finish()
    }

    /// The most triangles that begin in a cell of a level.
    fn most_in_cell(&self, surface: &StoredSurface, level: u32) -> Result<u64> {
        let (cells, mut in_cells) = (self.lattice.cells(level), HashMap::<u64, u64>::new());
        each_triangle(surface, self.means, |corners| {
            *in_cells.entry(self.lattice.cell(corners[0], level, cells)).or_default() += 1;
            Ok(())
        })?;
        Ok(in_cells.into_values().max().unwrap_or(0))
    }

    /// The triangles of the cell of a piece; `next` is then the first piece of the next one.
    fn fragment(
        &self,
        first: TrianglePiece,
        sorted: &mut Sorted<TrianglePiece>,
        next: &mut Option<TrianglePiece>,
    ) -> Result<Fragment> {
        let (memory, mut count) = (self.means.memory, 0);
        let mut fragment = Fragment { number: first.number(), filled: 0, triangles: vec![] };
        while let Some(piece) = next.filter(|piece| piece.cell == first.cell) {
            fragment.filled |= 1 << piece.octant();
            count += 1;
            if OF_TRIANGLE * count <= memory / 4 {
                fragment.triangles.push(piece.corners);
            }
            *next = sorted.next()?;
        }
        let needed = 4 * OF_TRIANGLE * count;
        if needed > memory {
            return Err(Error::memory("for a cell of a mesh", needed, memory));
        }
        Ok(fragment)
    }
}

/// The cell of a Morton number.
fn place_of(number: u64) -> [u32; 3] {
    std::array::from_fn(|k| (0..21).map(|bit| (number >> (3 * bit + k) & 1) as u32 * (1 << bit)).sum())
}

/// Adds cells without triangles, so that each cell lies in one of the next level. And a coarse cell
/// with triangles in an octant has a finer cell there: else the coarse ones would stay in view.
fn link(levels: &mut [Level]) {
    for level in (1..levels.len()).rev() {
        let octants = |(&number, node): (&u64, &Node)| {
            let filled = node.filled;
            (0..8).filter(move |octant| filled >> octant & 1 == 1).map(move |octant| number << 3 | octant)
        };
        let children: Vec<u64> = levels[level].nodes.iter().flat_map(octants).collect();
        add_empty(&mut levels[level - 1].nodes, children);
    }
    for level in 1..levels.len() {
        let parents: Vec<u64> = levels[level - 1].nodes.keys().map(|number| number >> 3).collect();
        add_empty(&mut levels[level].nodes, parents);
    }
}

fn add_empty(nodes: &mut BTreeMap<u64, Node>, numbers: Vec<u64>) {
    for number in numbers {
        nodes.entry(number).or_insert_with(|| Node { at: place_of(number), ..Node::default() });
    }
}

/// The bytes of the manifest of a segment.
fn manifest(lattice: &Lattice, levels: &[Level]) -> Vec<u8> {
    let mut out = vec![];
    put_floats(&mut out, [lattice.edge; 3]);
    put_floats(&mut out, lattice.origin);
    put_numbers(&mut out, [levels.len() as u32]);
    put_floats(&mut out, levels.iter().map(|level| level.scale));
    // No level is moved.
    put_floats(&mut out, levels.iter().flat_map(|_| [0.0; 3]));
    put_numbers(&mut out, levels.iter().map(|level| level.nodes.len() as u32));
    for level in levels {
        for axis in 0..3 {
            put_numbers(&mut out, level.nodes.values().map(|node| node.at[axis]));
        }
        put_numbers(&mut out, level.nodes.values().map(|node| node.bytes));
    }
    out
}

fn put_floats(out: &mut Vec<u8>, numbers: impl IntoIterator<Item = f32>) {
    put_numbers(out, numbers.into_iter().map(f32::to_bits));
}

fn put_numbers(out: &mut Vec<u8>, numbers: impl IntoIterator<Item = u32>) {
    numbers.into_iter().for_each(|n| out.extend_from_slice(&n.to_le_bytes()));
}
