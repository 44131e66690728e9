//! The reduced field at the vertices of the mesh that an archive was made from.
//!
//! Vertices are located as `probe` locates points, in batches. Each has a value: where no
//! tetrahedron holds it, that at the nearest place of one. Where bodies of a mesh touch or overlap,
//! a vertex has the value of its own body, for the field may jump there. The archive does not say
//! which body a tetrahedron is of. It is found from the mesh ([`CellLocator::bodies_of`]).

use super::point_search::{Find, Lists, Outside, PointBodies, each_value};
use super::vertex_errors::on_lattice;
use crate::domain::buckets::Buckets;
use crate::domain::settings::StoreSettings;
use crate::domain::store::CellStore;
use crate::domain::vertices::{VertexBodies, vertex_bodies};
use crate::pipeline::chunk::{CellLocator, NO_BODY};
use crate::pipeline::read::StepView;
use isospan_io::error::Result;
use isospan_io::exec::{Progress, Resources};
use isospan_io::geom::LatticePos;
use std::ops::Range;

/// Bytes for a vertex of a batch: its place, three times while it is sorted and located, its value,
/// its body, and the nearest place.
const VERTEX: u64 = 300;
/// Bytes for the value of each further step.
const FURTHER: u64 = 16;
/// The most vertices of a batch.
const MOST: u64 = 1 << 31;

/// The fields of some steps at the vertices of their mesh.
pub(in crate::pipeline) struct AtVertices<'a> {
    archive: &'a StepView,
    store: &'a CellStore,
    /// Ascending positions in the manifest.
    steps: &'a [usize],
    resources: &'a Resources,
    /// The part of a memory that this may use.
    rest: &'a (dyn Fn(u64) -> u64 + Sync),
    /// Where there are several bodies: the cells of each brick, and the body of each vertex.
    bodies: Option<(Buckets, VertexBodies)>,
}

impl<'a> AtVertices<'a> {
    pub(in crate::pipeline) fn new(
        archive: &'a StepView,
        store: &'a CellStore,
        steps: &'a [usize],
        resources: &'a Resources,
        rest: &'a (dyn Fn(u64) -> u64 + Sync),
        how: &StoreSettings,
    ) -> Result<Self> {
        let bodies = if store.census.bodies > 1 {
            Some((Buckets::new(store, archive.chunks.bricks(), how)?, vertex_bodies(store, how)?))
        } else {
            None
        };
        Ok(Self { archive, store, steps, resources, rest, bodies })
    }

    /// Ranges of vertices that fit in memory.
    pub(in crate::pipeline) fn batches(&self) -> impl Iterator<Item = Range<u64>> + use<> {
        let vertices = self.store.census.vertices;
        let bytes = VERTEX + FURTHER * (self.steps.len() as u64 - 1);
        let most = ((self.rest)(self.resources.memory) / 8 / bytes).clamp(1, MOST);
        (0..vertices).step_by(most as usize).map(move |first| first..vertices.min(first + most))
    }

    /// Calls `each` for every vertex of a batch: with its number, its place, the value of each step
    /// and whether it lies in a tetrahedron of its body.
    pub(in crate::pipeline) fn each_in(
        &mut self,
        batch: Range<u64>,
        progress: &dyn Progress,
        mut each: impl FnMut(u64, LatticePos, &[f32], bool) + Send,
    ) -> Result<()> {
        let (first, bricks) = (batch.start, *self.archive.chunks.bricks());
        let positions = &self.store.positions.get()?[batch.start as usize..batch.end as usize];
        let mut of_points = vec![];
        if let Some((_, of_vertices)) = &mut self.bodies {
            for vertex in batch {
                of_points.push(of_vertices.of(vertex)?.unwrap_or(NO_BODY));
            }
        }
        let cells =
            self.bodies.as_ref().map(|(buckets, _)| CellLocator { store: self.store, buckets, bricks });
        let share = |memory: u64| (self.rest)(memory) / 8 * 7;
        let find = Find {
            resources: self.resources,
            share: &share,
            outside: Outside::All,
            bodies: cells.as_ref().map(|cells| PointBodies { of_points: &of_points, cells }),
            surface: None,
            progress,
            stage: "measure",
        };
        let placed = positions.iter().zip(0u32..).map(|(&p, n)| (on_lattice(p), n));
        each_value(self.archive, Lists::OfSteps(self.steps), placed, &find, |n, values, is_inside| {
            each(first + u64::from(n), on_lattice(positions[n as usize]), values, is_inside);
        })?;
        Ok(())
    }
}
