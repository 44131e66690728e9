//! Welding the surfaces of chunks into one.
//!
//! A vertex belongs to an edge of the mesh, so two chunks have a vertex in common exactly when they
//! have its edge in common, and only edges between two corners that other chunks use too can be
//! that. The builder keeps a table of those *shared* edges: (lower id, higher id) -> vertex number
//! and gradient sum. All other vertices pass straight to the store. Coordinates are never compared.
//!
//! # Guarantees
//! * Vertices are numbered by first appearance: chunk by chunk in the order of the calls of
//!   [`SurfaceBuilder::push`], within a chunk in the order of [`ChunkSurface::vertices`]. The
//!   result is a function of that sequence alone.
//! * Position and normal of a vertex do not depend on the cut into chunks (see
//!   [`super::extract::marching_tets`]): gradient sums are integers, added as chunks come, and
//!   turned into normals once, at the end.
//!
//! # Memory
//! Up to `memory_bytes` of finished records (24 bytes a vertex, 12 a triangle); what exceeds it
//! goes to nameless files in the scratch folder, which vanish with the process. In addition about
//! 100 bytes for every shared edge that is still open. By default all stay open until the end:
//! O(surface on chunk borders). A caller that knows which corners later chunks can still use closes
//! the others with [`SurfaceBuilder::keep_open`].
//!
//! # Example
//! ```
//! # use isospan::{geom::{Lattice, PointId}, grid::Geometry};
//! # use isospan::surface::{SurfaceSource, WorldMap, extract::*, weld::*};
//! # fn main() -> isospan::Result<()> {
//! let lattice = Lattice::new([2, 2, 2])?;
//! let s = lattice.max()[0];
//! let cells = CellSource {
//!     positions: &[[0, 0, 0], [s, 0, 0], [0, s, 0], [0, 0, s]],
//!     values: &[1.0, 0.0, 0.0, 0.0],
//!     ids: &[PointId(7), PointId(3), PointId(5), PointId(1)],
//!     shared: &[false; 4],
//!     numbers: None,
//!     tets: &[[0, 1, 2, 3]],
//! };
//! let world = WorldMap::new(&lattice, &Geometry::default());
//! let mut chunk = ChunkSurface::default();
//! extract(&cells, 0.5, &world, &mut Workbench::default(), &mut chunk);
//!
//! let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
//! builder.push(&chunk)?;
//! let surface = builder.finish()?;
//! assert_eq!((surface.vertex_count(), surface.triangle_count()), (3, 1));
//! # Ok(())
//! # }
//! ```

use crate::surface::extract::{ChunkSurface, SharedEdge};
use crate::surface::model::{SurfaceSource, TriMesh, Vertex, relative_to, world_of};
use crate::surface::world_map::{WorldMap, nearby_origin};
use isospan_io::bytes::store::{Cached, Store};
use isospan_io::error::{Error, Result};
use isospan_io::geom::PointId;
use isospan_io::volume::units::Units;
use rustc_hash::FxHashMap;
use std::path::PathBuf;

/// Where a surface is kept while it is built.
#[derive(Clone, Debug)]
pub struct BuilderSettings {
    /// Bytes of finished vertices and triangles to hold in memory before a file is used.
    pub memory_bytes: usize,
    /// Folder for that file.
    pub scratch: PathBuf,
}

impl Default for BuilderSettings {
    fn default() -> Self {
        Self { memory_bytes: 256 << 20, scratch: std::env::temp_dir() }
    }
}

/// A shared edge that later chunks may have too.
#[derive(Clone, Copy, Debug)]
struct OpenEdge {
    key: (PointId, PointId),
    number: u32,
    gradient: [i64; 3],
}

impl OpenEdge {
    /// The normal by the sum so far; `None` where that has no direction.
    fn normal(&self, world: &WorldMap) -> Option<[f32; 3]> {
        world.unit_normal(self.gradient.map(|x| x as f64))
    }
}

/// Joins chunk surfaces, given in chunk order, into one surface.
#[derive(Debug)]
pub struct SurfaceBuilder {
    vertices: Store<Vertex>,
    triangles: Store<[u32; 3]>,
    open: Vec<OpenEdge>,
    /// Key to index in `open`; looked up, never iterated.
    by_key: FxHashMap<(PointId, PointId), u32>,
    world: WorldMap,
    /// Chunk-local vertex number to global one; a buffer.
    numbers: Vec<u32>,
    /// Of a surface that is handed on while it is built.
    handed_on: Option<HandedOn>,
}

/// What was handed on.
#[derive(Debug, Default)]
struct HandedOn {
    vertices: u64,
    triangles: u64,
    /// Vertices among them whose normals were finished since.
    changed: Vec<(u32, Vertex)>,
}

/// What was added to a surface since the part before: its new vertices and triangles. A triangle
/// has numbers of vertices of this part and of earlier ones.
pub struct SurfaceAddition<'a> {
    builder: &'a SurfaceBuilder,
    vertices: u64,
    triangles: u64,
    /// Earlier vertices that have their final normals now, by their numbers.
    pub changed: &'a [(u32, Vertex)],
}

impl SurfaceBuilder {
    /// An empty surface. `world` is the map with which the chunks are finished.
    pub fn new(world: &WorldMap, settings: &BuilderSettings) -> Self {
        Self::reusing(world, settings, TriMesh::default())
    }

    /// The same, in the memory of a surface that is no longer needed.
    pub fn reusing(world: &WorldMap, settings: &BuilderSettings, memory: TriMesh) -> Self {
        let StoredSurface { vertices, triangles, .. } = StoredSurface::reusing(settings, memory);
        Self {
            vertices,
            triangles,
            open: Vec::new(),
            by_key: FxHashMap::default(),
            world: *world,
            numbers: Vec::new(),
            handed_on: None,
        }
    }

    /// Hands on what was added since the last call. Vertices that later chunks may have too get
    /// the normals of the triangles so far; the final ones follow once their edges are closed.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch file cannot be read; those of `each`.
    pub fn hand_on<T>(&mut self, each: impl FnOnce(&SurfaceAddition<'_>) -> Result<T>) -> Result<T> {
        let HandedOn { vertices, triangles, changed } = self.handed_on.take().unwrap_or_default();
        let done = each(&SurfaceAddition { builder: self, vertices, triangles, changed: &changed })?;
        let (vertices, triangles) = (self.vertices.len(), self.triangles.len());
        self.handed_on = Some(HandedOn { vertices, triangles, changed: vec![] });
        Ok(done)
    }

    /// Adds the (finished) surface of the next chunk.
    ///
    /// # Errors
    /// [`Error::Usage`] when the surface would have 2^32 vertices or more, [`Error::Io`] when the
    /// scratch file cannot be written.
    pub fn push(&mut self, chunk: &ChunkSurface) -> Result<()> {
        self.check_room(chunk.vertices().len() as u64)?;
        self.numbers.clear();
        let mut rest = 0;
        for edge in chunk.shared_edges() {
            let at = edge.vertex as usize;
            self.append_run(&chunk.vertices()[rest..at])?;
            let number = self.weld(edge, &chunk.vertices()[at])?;
            self.numbers.push(number);
            rest = at + 1;
        }
        self.append_run(&chunk.vertices()[rest..])?;
        let mut numbered = [[0; 3]; 512];
        for triangles in chunk.triangles().chunks(numbered.len()) {
            for (to, triangle) in numbered.iter_mut().zip(triangles) {
                *to = triangle.map(|v| self.numbers[v as usize]);
            }
            self.triangles.extend(&numbered[..triangles.len()])?;
        }
        Ok(())
    }

    /// Appends vertices that no other chunk has.
    fn append_run(&mut self, vertices: &[Vertex]) -> Result<()> {
        let first = self.vertices.len() as u32;
        self.numbers.extend(first..first + vertices.len() as u32);
        self.vertices.extend(vertices)
    }

    /// Closes the shared edges for which `is_open` is false: no later chunk has them. Their normals
    /// are finished and their memory is freed. Pushing such an edge again would give a second
    /// vertex.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch file cannot be read or written.
    pub fn keep_open(&mut self, is_open: impl Fn(PointId, PointId) -> bool) -> Result<()> {
        let (kept, closed) = self.open.iter().partition::<Vec<OpenEdge>, _>(|e| is_open(e.key.0, e.key.1));
        self.finish_normals(&closed)?;
        self.by_key = kept.iter().enumerate().map(|(i, e)| (e.key, i as u32)).collect();
        self.open = kept;
        Ok(())
    }

    /// Shared edges still open.
    pub fn open_edges(&self) -> usize {
        self.open.len()
    }

    /// Closes all edges: no chunk comes any more.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch file cannot be read or written.
    pub fn close(&mut self) -> Result<()> {
        self.by_key.clear();
        let open = std::mem::take(&mut self.open);
        self.finish_normals(&open)
    }

    /// The finished surface.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch file cannot be read or written.
    pub fn finish(mut self) -> Result<StoredSurface> {
        self.close()?;
        let Self { vertices, triangles, world, .. } = self;
        let (units, time) = (Units::default(), None);
        let origin = world.origin();
        Ok(StoredSurface { vertices, triangles, origin, low: None, ends: NO_BOX, units, time })
    }

    fn check_room(&self, more: u64) -> Result<()> {
        // All count as new: welding could only spare a chunk that is within one chunk of the limit.
        if self.vertices.len() + more < u64::from(u32::MAX) {
            return Ok(());
        }
        Err(Error::usage(format!(
            "the surface has more than {} vertices, the most that files with 32-bit vertex numbers hold; extract a region \
             of interest, another isovalue, or from an archive of fewer points",
            u32::MAX
        )))
    }

    fn append(&mut self, vertex: &Vertex) -> Result<u32> {
        let number = self.vertices.len() as u32;
        self.vertices.push(*vertex)?;
        Ok(number)
    }

    fn weld(&mut self, edge: &SharedEdge, vertex: &Vertex) -> Result<u32> {
        if let Some(&i) = self.by_key.get(&edge.key) {
            let open = &mut self.open[i as usize];
            for (sum, part) in open.gradient.iter_mut().zip(edge.gradient) {
                *sum = sum.wrapping_add(part);
            }
            return Ok(open.number);
        }
        let number = self.append(vertex)?;
        self.by_key.insert(edge.key, self.open.len() as u32);
        self.open.push(OpenEdge { key: edge.key, number, gradient: edge.gradient });
        Ok(number)
    }

    /// Writes the normals of edges whose gradient sums are complete. `edges` ascend by number, as
    /// `open` always does.
    fn finish_normals(&mut self, edges: &[OpenEdge]) -> Result<()> {
        let normals: Vec<_> = edges.iter().map(|e| (e.number, e.normal(&self.world))).collect();
        let handed_on = &mut self.handed_on;
        self.vertices.patch(&normals, |number, vertex, &normal| {
            vertex.normal = normal.unwrap_or(vertex.normal);
            if let Some(handed_on) = handed_on.as_mut().filter(|h| u64::from(number) < h.vertices) {
                handed_on.changed.push((number, *vertex));
            }
        })
    }
}

impl SurfaceSource for SurfaceAddition<'_> {
    fn vertex_count(&self) -> u64 {
        self.builder.vertices.len() - self.vertices
    }

    fn triangle_count(&self) -> u64 {
        self.builder.triangles.len() - self.triangles
    }

    fn origin(&self) -> [f64; 3] {
        self.builder.world.origin()
    }

    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()> {
        let SurfaceBuilder { vertices, open, world, .. } = self.builder;
        let mut first = self.vertices;
        let mut open = open[open.partition_point(|e| u64::from(e.number) < first)..].iter().peekable();
        let mut shown = vec![];
        vertices.each_from(first, &mut |batch| {
            shown.clear();
            shown.extend_from_slice(batch);
            let past = first + batch.len() as u64;
            while let Some(edge) = open.next_if(|e| u64::from(e.number) < past) {
                let vertex = &mut shown[(u64::from(edge.number) - first) as usize];
                vertex.normal = edge.normal(world).unwrap_or(vertex.normal);
            }
            first = past;
            each(&shown)
        })
    }

    fn triangles(&self, each: &mut dyn FnMut(&[[u32; 3]]) -> Result<()>) -> Result<()> {
        self.builder.triangles.each_from(self.triangles, each)
    }
}

/// Vertices that are moved at a time.
const SETTLED: u64 = 1 << 14;

/// A welded surface, in memory or in a file that vanishes with it.
#[derive(Debug)]
pub struct StoredSurface {
    vertices: Store<Vertex>,
    triangles: Store<[u32; 3]>,
    origin: [f64; 3],
    /// What `f32` leaves of the positions of a file with doubles, until the origin is known; there
    /// may be fewer than vertices.
    low: Option<Store<[f32; 3]>>,
    /// The least box that holds such positions.
    ends: [[f64; 3]; 2],
    /// What a file says of its units.
    pub(crate) units: Units,
    /// What it says of the time.
    pub(crate) time: Option<f64>,
}

/// A box that holds nothing.
const NO_BOX: [[f64; 3]; 2] = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];

impl StoredSurface {
    /// A surface without vertices, to be filled.
    pub fn new(settings: &BuilderSettings) -> Self {
        Self::reusing(settings, TriMesh::default())
    }

    /// The same, in the memory of a surface that is no longer needed.
    fn reusing(settings: &BuilderSettings, memory: TriMesh) -> Self {
        let half = settings.memory_bytes / 2;
        Self {
            vertices: Store::reusing(half, &settings.scratch, memory.vertices),
            triangles: Store::reusing(half, &settings.scratch, memory.triangles),
            origin: [0.0; 3],
            low: None,
            ends: NO_BOX,
            units: Units::default(),
            time: None,
        }
    }

    /// The units of coordinates, isovalues and times, as far as the file that it was read from
    /// names them.
    pub fn units(&self) -> &Units {
        &self.units
    }

    /// The time that the file names.
    pub fn time(&self) -> Option<f64> {
        self.time
    }

    /// A surface without vertices, to be filled from another one or parts of it: its positions are
    /// counted from the same place.
    pub(super) fn like(source: &dyn SurfaceSource, settings: &BuilderSettings) -> Self {
        Self { origin: source.origin(), ..Self::new(settings) }
    }

    /// A copy of a surface.
    ///
    /// # Errors
    /// Errors of reading it; [`Error::Io`] when the scratch file cannot be written.
    pub fn of(source: &dyn SurfaceSource, settings: &BuilderSettings) -> Result<Self> {
        let mut surface = Self::like(source, settings);
        source.vertices(&mut |batch| surface.vertices.extend(batch))?;
        source.triangles(&mut |batch| surface.triangles.extend(batch))?;
        Ok(surface)
    }

    /// Appends a vertex.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch file cannot be written.
    pub fn push_vertex(&mut self, vertex: Vertex) -> Result<()> {
        self.vertices.push(vertex)
    }

    /// Appends a vertex, given its place in the world, of a surface that [`Self::settle`] ends.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch file cannot be written.
    pub(crate) fn push_double(&mut self, place: [f64; 3], normal: [f32; 3]) -> Result<()> {
        let position = place.map(|x| x as f32);
        let low = relative_to(place, position.map(f64::from));
        if low != [0.0; 3] {
            let store = self.low.get_or_insert_with(|| Store::beside(&self.vertices, 4));
            while store.len() < self.vertices.len() {
                store.push([0.0; 3])?;
            }
            store.push(low)?;
        }
        for (k, &x) in place.iter().enumerate() {
            (self.ends[0][k], self.ends[1][k]) = (self.ends[0][k].min(x), self.ends[1][k].max(x));
        }
        self.vertices.push(Vertex { position, normal })
    }

    /// Says what the positions of all vertices are counted from.
    pub(crate) fn count_from(&mut self, origin: [f64; 3]) {
        self.origin = origin;
    }

    /// Counts positions from a place nearby, where they were given as doubles and are far from 0.
    ///
    /// # Errors
    /// [`Error::Io`] for the scratch file.
    pub(crate) fn settle(&mut self) -> Result<()> {
        let Some(low) = self.low.take() else { return Ok(()) };
        let origin = nearby_origin(self.ends, [0.0; 3]);
        if origin == [0.0; 3] {
            return Ok(());
        }
        let (mut first, count) = (0, self.vertices.len());
        let (mut lows, mut patches) = (vec![], vec![]);
        while first < count {
            let n = (count - first).min(SETTLED);
            lows.clear();
            lows.resize(n as usize, [0.0; 3]);
            let held = low.len().saturating_sub(first).min(n);
            low.read_from(first, &mut lows[..held as usize])?;
            patches.clear();
            patches.extend((first as u32..).zip(lows.iter().copied()));
            self.vertices.patch(&patches, |_, vertex, &low| {
                let place = world_of(low, vertex.position.map(f64::from));
                vertex.position = relative_to(place, origin);
            })?;
            first += n;
        }
        self.origin = origin;
        Ok(())
    }

    /// The surface in memory; moved there where it is already.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch file cannot be read.
    pub fn into_mesh(self) -> Result<TriMesh> {
        let (vertices, triangles) = (self.vertices.into_vec()?, self.triangles.into_vec()?);
        Ok(TriMesh { vertices, triangles, origin: self.origin })
    }

    /// The memory of a surface that is no longer needed.
    pub(crate) fn into_memory(self) -> TriMesh {
        TriMesh::new(self.vertices.into_memory(), self.triangles.into_memory())
    }

    /// Single vertices, through a cache of about this many bytes.
    pub(crate) fn random_vertices(&self, memory_bytes: usize) -> Cached<'_, Vertex> {
        Cached::new(&self.vertices, memory_bytes)
    }

    /// Appends a triangle, of vertices that may be appended later.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch file cannot be written.
    pub fn push_triangle(&mut self, triangle: [u32; 3]) -> Result<()> {
        self.triangles.push(triangle)
    }

    /// Lets `rewrite` change each triangle, given with its number.
    pub(super) fn rewrite_triangles(
        &mut self,
        settings: &BuilderSettings,
        mut rewrite: impl FnMut(u64, &mut [u32; 3]) -> Result<()>,
    ) -> Result<()> {
        let mut rewritten = Self::new(settings).triangles;
        self.triangles.each(&mut |batch| {
            batch.iter().try_for_each(|&triangle| {
                let mut triangle = triangle;
                rewrite(rewritten.len(), &mut triangle)?;
                rewritten.push(triangle)
            })
        })?;
        self.triangles = rewritten;
        Ok(())
    }
}

impl SurfaceSource for StoredSurface {
    fn vertex_count(&self) -> u64 {
        self.vertices.len()
    }

    fn triangle_count(&self) -> u64 {
        self.triangles.len()
    }

    fn origin(&self) -> [f64; 3] {
        self.origin
    }

    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()> {
        self.vertices.each(each)
    }

    fn triangles(&self, each: &mut dyn FnMut(&[[u32; 3]]) -> Result<()>) -> Result<()> {
        self.triangles.each(each)
    }
}

#[cfg(test)]
mod tests;
