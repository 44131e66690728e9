//! The vertices of each brick, with their bodies: the samples that values are fitted to.
//!
//! Only vertices of tetrahedra are samples, and of these only the file's own. Points that no cell
//! uses have values that mean nothing, and among duplicate points the first counts. A vertex that
//! bodies share without sharing a face is one of the first of them. The body of each is noted in a
//! paged array while the tetrahedra pass, body after body; then the vertices are sorted by brick,
//! on disk where memory does not hold them.

use super::column::{Column, ColumnWriter};
use super::settings::StoreSettings;
use super::store::CellStore;
use isospan_io::bytes::paged::Paged;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::grid::{BrickGrid, BrickId};
use isospan_mesh::locate::rounded;

/// Vertices handed out at a time.
const BATCH: usize = 1 << 15;

/// A vertex that is a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Vertex {
    /// Its number in the mesh.
    pub(crate) number: u64,
    /// The body that it belongs to.
    pub(crate) body: u64,
    /// The nearest lattice position.
    pub(crate) pos: LatticePos,
}

/// For each brick, the vertices in it, ascending.
pub(crate) struct Vertices {
    /// Number and body of each.
    all: Column<[u64; 2]>,
    /// Where each brick's vertices begin, and the end.
    starts: Column<u64>,
}

impl Vertices {
    /// Sorts the vertices into bricks.
    pub(crate) fn new(store: &CellStore, bricks: &BrickGrid, settings: &StoreSettings) -> Result<Self> {
        let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
        let positions = store.positions.get()?;
        let mut bodies = vertex_bodies(store, settings)?;
        let mut sorter: Sorter<[u64; 3]> = Sorter::new(memory, &settings.scratch);
        for (number, &p) in (0..store.census.vertices).zip(positions) {
            if let Some(body) = bodies.of(number)? {
                sorter.push([bricks.id(bricks.brick_at(rounded(p))).0, number, body])?;
            }
        }
        drop(bodies);
        let (mut all, mut starts) =
            (ColumnWriter::new(&settings.scratch)?, ColumnWriter::new(&settings.scratch)?);
        let mut sorted = sorter.finish()?;
        while let Some([brick, number, body]) = sorted.next()? {
            while starts.len() <= brick {
                starts.push(&all.len())?;
            }
            all.push(&[number, body])?;
        }
        while starts.len() <= bricks.len() {
            starts.push(&all.len())?;
        }
        Ok(Self { all: all.finish()?, starts: starts.finish()? })
    }

    /// Calls `visit` with the vertices of a brick, some at a time.
    pub(crate) fn each_batch(
        &self,
        store: &CellStore,
        brick: BrickId,
        mut visit: impl FnMut(&[Vertex]),
    ) -> Result<()> {
        let (starts, positions) = (self.starts.get()?, store.positions.get()?);
        let (from, to) = (starts[brick.0 as usize] as usize, starts[brick.0 as usize + 1] as usize);
        let vertex =
            |&[number, body]: &[u64; 2]| Vertex { number, body, pos: rounded(positions[number as usize]) };
        for some in self.all.get()?[from..to].chunks(BATCH) {
            visit(&some.iter().map(vertex).collect::<Vec<_>>());
        }
        Ok(())
    }
}

/// The body of each vertex of a mesh: the first of those that have it.
pub(crate) struct VertexBodies {
    /// One more than the body; 0 of a vertex without a tetrahedron.
    bodies: Paged<u64>,
}

impl VertexBodies {
    /// The body of a vertex; `None` of one without a tetrahedron.
    pub(crate) fn of(&mut self, vertex: u64) -> Result<Option<u64>> {
        Ok(self.bodies.get(vertex)?.checked_sub(1))
    }
}

/// Finds the body of each vertex.
pub(crate) fn vertex_bodies(store: &CellStore, settings: &StoreSettings) -> Result<VertexBodies> {
    let vertices = store.positions.get()?.len() as u64;
    let mut bodies = Paged::new(vertices, settings.memory, &settings.scratch);
    for (number, tet) in (0..).zip(store.tets.get()?) {
        if number % BATCH as u64 == 0 {
            settings.cancel.check()?;
        }
        let body = store.bodies.of(number)? + 1;
        for &v in tet {
            if bodies.get(v)? == 0 {
                bodies.set(v, body)?;
            }
        }
    }
    Ok(VertexBodies { bodies })
}
