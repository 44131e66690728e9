//! A mesh at several levels of detail, cut into the cells of an octree.
//!
//! ```text
//!  surface ─▶ lattice of 16 bits a cell ─▶ cut at planes ─▶ sorted by cell ─▶ Draco ─▶ level 0
//!     └─▶ a quarter of its triangles ─▶ ... of cells of twice the size ─▶ level 1 ─▶ ...
//! ```
//!
//! Level `k` has cells of `2^k` times the edge of those of level 0, and steps of `2^k` times the
//! length. Each level is decimated from the one before, so it keeps all pieces and holes of the
//! surface. A corner is off by half a step along each axis at most: `2^k / 131070` of the edge of a
//! cell of level 0.
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
    pub(super) scratch: PathBuf,
    pub(super) pool: ThreadPool,
    pub(super) cancel: CancelToken,
    /// The folder that errors name.
    pub(super) target: &'a Path,
}

impl WriterMeans<'_> {
    /// A part of the memory, for what lies on disk beyond it.
    pub(super) fn share(&self, part: u64) -> BuilderSettings {
        let memory_bytes = usize::try_from(self.memory / part).unwrap_or(usize::MAX);
        BuilderSettings { memory_bytes, scratch: self.scratch.clone() }
    }
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

/// Hands on the fragments of all levels, and returns the manifest of the mesh.
///
/// # Errors
/// [`Error::Budget`] for memory, [`Error::Cancelled`], those of the scratch folder and of `put`.
pub(super) fn write_levels(
    mut surface: StoredSurface,
    means: &WriterMeans<'_>,
    put: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<Vec<u8>> {
    let Some(lattice) = lattice_of(&surface)? else { return Ok(manifest(&NOTHING, &[])) };
    let (edge, lattice) = fit_cells(&surface, lattice, means)?;
    let (all, levels) = (surface.triangle_count(), Levels { means, lattice });
    let mut done: Vec<Level> = vec![];
    loop {
        let (level, count) = (done.len() as u32, surface.triangle_count());
        let scale = edge * (all as f64 / count as f64).sqrt();
        let nodes = levels.write(&surface, level, put)?;
        done.push(Level { scale: (scale as f32).max(f32::MIN_POSITIVE), nodes });
        let is_one = levels.lattice.cells(level) == [1; 3];
        if is_one && count <= FEW || level > DEEPEST {
            break;
        }
        let goal = Decimation { ratio: RATIO, ..Decimation::default() };
        let (memory, cancel) = (means.share(2), &means.cancel);
        let fewer = means.pool.install(|| decimate(surface, &goal, &Faces::default(), &memory, cancel));
        surface = fewer.map_err(|e| e.of_share(means.memory / 2, means.memory))?.0;
        if surface.triangle_count() as f64 > TOO_MANY * count as f64 {
            break;
        }
    }
    link(&mut done);
    Ok(manifest(&levels.lattice, &done))
}

/// What the manifest of a mesh without triangles says of its cells.
const NOTHING: Lattice = Lattice { origin: [0.0; 3], size: [0.0; 3], edge: 1.0 };

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

/// The length of an edge of a triangle, about, and a lattice of which no cell has far more than the
/// usual number of triangles.
fn fit_cells(surface: &StoredSurface, lattice: Lattice, means: &WriterMeans<'_>) -> Result<(f64, Lattice)> {
    let (count, longest) = (surface.triangle_count(), lattice.size.into_iter().fold(0.0, f64::max));
    // A surface has about four times as many cells of half the edge.
    let mut depth = (0..DEEPEST).find(|depth| OF_CELL << (2 * depth) >= count).unwrap_or(DEEPEST);
    loop {
        let edge = edge_of(longest / f64::from(1u32 << depth));
        let lattice = Lattice { edge, ..lattice };
        let cells = lattice.cells(0);
        let mut vertices = surface.random_vertices(means.share(8).memory_bytes);
        let (mut area, mut in_cells) = (0.0, HashMap::<u64, u64>::new());
        surface.triangles(&mut |batch| {
            means.cancel.check()?;
            for triangle in batch {
                let mut corners = [[0.0; 3]; 3];
                for (corner, &v) in corners.iter_mut().zip(triangle) {
                    *corner = vertices.get(u64::from(v))?.position;
                }
                area += area_of(corners);
                let at = lattice.place(corners[0], 0, cells);
                let at = std::array::from_fn(|k| (at[k] / CELL).min(cells[k] - 1) as u32);
                *in_cells.entry(morton(at)).or_default() += 1;
            }
            Ok(())
        })?;
        let most = in_cells.values().copied().max().unwrap_or(0);
        if most <= 2 * OF_CELL || depth == DEEPEST {
            // Of equilateral triangles.
            return Ok(((area * 4.0 / 3f64.sqrt() / count.max(1) as f64).sqrt(), lattice));
        }
        depth += 1;
    }
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
        let place = means.share(8);
        let mut sorter = Sorter::new(place.memory_bytes, &place.scratch);
        let mut vertices = surface.random_vertices(place.memory_bytes);
        let mut pieces = vec![];
        surface.triangles(&mut |batch| {
            means.cancel.check()?;
            for triangle in batch {
                let mut corners = [[0; 3]; 3];
                for (corner, &v) in corners.iter_mut().zip(triangle) {
                    *corner = self.lattice.place(vertices.get(u64::from(v))?.position, level, cells);
                }
                pieces.clear();
                cut(corners, level > 0, &mut pieces);
                pieces.iter().try_for_each(|piece| sorter.push(TrianglePiece::of(piece, cells)))?;
            }
            Ok(())
        })?;
        sorter.finish()
    }

    /// The triangles of the cell of a piece; `next` is then the first piece of the next one.
    fn fragment(
        &self,
        first: TrianglePiece,
        sorted: &mut Sorted<TrianglePiece>,
        next: &mut Option<TrianglePiece>,
    ) -> Result<Fragment> {
        let mut fragment = Fragment { number: first.number(), filled: 0, triangles: vec![] };
        while let Some(piece) = next.filter(|piece| piece.cell == first.cell) {
            fragment.filled |= 1 << piece.octant();
            fragment.triangles.push(piece.corners);
            let (memory, needed) = (self.means.memory, OF_TRIANGLE * fragment.triangles.len() as u64);
            if needed > memory / 4 {
                return Err(Error::memory("for a cell of a mesh", 4 * needed, memory));
            }
            *next = sorted.next()?;
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
