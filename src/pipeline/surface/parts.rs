//! Surfaces that are handed on part by part while they are extracted: each chunk as soon as it is
//! welded.
//!
//! A vertex on an edge that later chunks may have has its final normal last, so the last part has
//! the normals of such vertices. What is cut or has holes is changed as a whole in the end: its
//! parts are a preview, and the last part is all of the surface. What is refined is that part
//! alone.

use super::settings::SurfaceSettings;
use crate::pipeline::read::{IndexToWorld, StepView};
use crate::surface::weld::SurfaceBuilder;
use crate::surface::{SurfaceSource, Vertex};
use isospan_io::error::Result;

/// Takes surfaces that are streamed: see
/// [`SurfaceQuery::stream`](crate::pipeline::SurfaceQuery::stream). A closure takes parts alone.
///
/// Its methods are called on one thread at a time; others wait while a part is taken.
pub trait SurfaceSink: Send {
    /// Takes a part of a surface.
    ///
    /// # Errors
    /// Its own; the extraction ends with them.
    fn part(&mut self, part: &StreamedPart<'_>) -> Result<()>;

    /// Takes a surface as a whole after all its parts, given which isovalue it is of, from 0.
    ///
    /// # Errors
    /// Its own; the extraction ends with them.
    fn whole(&mut self, _isovalue: usize, _surface: &dyn SurfaceSource) -> Result<()> {
        Ok(())
    }
}

impl<F: FnMut(&StreamedPart<'_>) -> Result<()> + Send> SurfaceSink for F {
    fn part(&mut self, part: &StreamedPart<'_>) -> Result<()> {
        self(part)
    }
}

/// A part of a surface that is streamed to a [`SurfaceSink`].
#[non_exhaustive]
pub struct StreamedPart<'a> {
    /// Which isovalue of the query, from 0.
    pub isovalue: usize,
    /// The vertices and triangles that are new. A triangle has numbers of vertices of this part
    /// and of earlier ones.
    pub added: &'a dyn SurfaceSource,
    /// Earlier vertices that have their final normals now, by their numbers.
    pub changed: &'a [(u32, Vertex)],
    /// Chunks of the archive before this number have no further triangles.
    pub chunks: u64,
    /// Whether the part is of a preview: of the surface before it is cut at the region of interest,
    /// or along the edges of holes. The first part without this mark takes the place of all with
    /// it.
    pub is_preview: bool,
}

/// Takes the parts of surfaces.
pub(super) struct Parts<'a> {
    to_world: IndexToWorld,
    /// Whether the surface is changed as a whole, when all chunks have added to it.
    changes: bool,
    /// Whether parts come before that.
    is_early: bool,
    sink: &'a mut dyn SurfaceSink,
}

impl<'a> Parts<'a> {
    pub(super) fn new(
        archive: &StepView,
        settings: &SurfaceSettings,
        sink: &'a mut dyn SurfaceSink,
    ) -> Result<Self> {
        let is_early = settings.refine.changes_nothing();
        let changes = !is_early || settings.roi.is_some() || archive.may_have_holes();
        Ok(Self { to_world: IndexToWorld::of(archive)?, changes, is_early, sink })
    }

    /// Whether the parts are those of a preview, whose last normals nobody needs.
    pub(super) fn are_previews(&self) -> bool {
        self.changes
    }

    /// Hands on what chunks before a number have added to the surface of an isovalue.
    pub(super) fn take(&mut self, builder: &mut SurfaceBuilder, isovalue: usize, chunks: u64) -> Result<()> {
        if !self.is_early {
            return Ok(());
        }
        let Self { to_world, sink, changes: is_preview, .. } = self;
        let is_preview = *is_preview;
        builder.hand_on(|added| {
            let place = |&(number, vertex)| Ok((number, to_world.vertex(&vertex)?));
            let changed = added.changed.iter().map(place).collect::<Result<Vec<_>>>()?;
            let is_empty = added.vertex_count() == 0 && added.triangle_count() == 0 && changed.is_empty();
            if is_empty {
                return Ok(());
            }
            to_world.surface(added, |added| {
                sink.part(&StreamedPart { isovalue, added, changed: &changed, chunks, is_preview })
            })
        })
    }

    /// Hands on a finished surface in the world: as a part unless its parts were, and as a whole.
    pub(super) fn take_whole(
        &mut self,
        surface: &dyn SurfaceSource,
        isovalue: usize,
        chunks: u64,
    ) -> Result<()> {
        if self.changes {
            let is_preview = false;
            self.sink.part(&StreamedPart { isovalue, added: surface, changed: &[], chunks, is_preview })?;
        }
        self.sink.whole(isovalue, surface)
    }
}
