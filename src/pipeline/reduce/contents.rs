//! The mesh and the steps of an archive that is made: counts, and the proof that the tetrahedra
//! fill the box.

use crate::archive::chunked::{ChunkSegment, MeshSizes};
use crate::archive::manifest::{Counts, Manifest, SegmentRecord, StoredStep};
use crate::archive::segment::SegmentKind;
use crate::pipeline::plan::{Layout, MeshParts, Plan};
use crate::pipeline::read::{bricks_of, chunk_place, pyramid_of};
use isospan_io::error::{Error, Result};
use isospan_io::grid::ChunkId;
use std::path::Path;

/// The mesh of an archive, and the steps that are finished.
#[derive(Clone, Debug, Default)]
pub(super) struct ArchiveContents {
    pub(super) counts: Counts,
    pub(super) mesh: Vec<SegmentRecord>,
    pub(super) steps: Vec<StoredStep>,
    /// Steps that others have replaced.
    pub(super) bases: Vec<StoredStep>,
    /// How often halos were widened.
    pub(super) halo_retries: u64,
}

impl ArchiveContents {
    /// What an archive has.
    pub(super) fn of(manifest: &Manifest) -> Self {
        let Manifest { counts, mesh, steps, bases, .. } = manifest.clone();
        Self { counts, mesh, steps, bases, halo_retries: 0 }
    }

    pub(super) fn manifest(&self, plan: &Plan) -> Manifest {
        Manifest::new(plan.mesh.clone(), self.counts, self.mesh.clone(), self.steps.clone())
            .with_bases(self.bases.clone())
    }

    /// Reads the summaries of the mesh of all chunks.
    pub(super) fn of_segments(plan: &Plan, parts: &MeshParts, layout: &Layout) -> Result<Self> {
        let counts = Counts { chunks: parts.chunks.len(), ..Counts::default() };
        let mut contents = Self { counts, ..Self::default() };
        if let Some(pyramid) = pyramid_of(plan.mesh.points) {
            contents.counts.points = parts.points.len();
            let bricks = |id: u64| bricks_of(&pyramid, chunk_place(&pyramid, ChunkId(id))).len() as u64;
            contents.counts.blocks = (0..parts.chunks.len()).map(bricks).sum();
            return Ok(contents);
        }
        let mut volume6 = 0i128;
        let hash = plan.mesh_hash();
        for number in 0..layout.segment_count() {
            let file = ChunkSegment::open(layout.mesh(number), SegmentKind::Mesh, Some(hash))?;
            for chunk in layout.chunks_of(number) {
                let mesh = file.mesh_summary(ChunkId(chunk))?;
                contents.add_sizes(mesh.sizes);
                volume6 += mesh.volume6 + mesh.outside6;
            }
            contents.mesh.push(file.record());
        }
        check_volume(plan, [contents.counts.tetrahedra.into(), volume6], layout.root())?;
        Ok(contents)
    }

    /// Adds the sizes of a chunk.
    fn add_sizes(&mut self, sizes: MeshSizes) {
        self.counts.points += u64::from(sizes.core);
        self.counts.tetrahedra += sizes.tets;
        self.counts.blocks += u64::from(sizes.tet_blocks);
        self.halo_retries += u64::from(sizes.retries);
    }
}

/// The owned tetrahedra of all chunks tile the box, or are all of the mesh: their volumes add up to
/// its volume, exactly.
fn check_volume(plan: &Plan, [tets, volume6]: [i128; 2], out: &Path) -> Result<()> {
    let whole = plan.mesh.volume6();
    let all = plan.mesh.own.map_or(tets, |own| own.tetrahedra.into());
    if volume6 == whole && tets == all {
        return Ok(());
    }
    let text = format!("internal error: {tets} of {all} tetrahedra fill {volume6} of {whole} sixths");
    Err(Error::io("commit", out, std::io::Error::other(text)))
}
