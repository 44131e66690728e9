//! The end of a reduction: merges what all chunks have reported.
//!
//! For the mesh, once, these are counts, and the proof that the tetrahedra fill the box. For each
//! step, they are its index and its spectrum.

use super::sums::{FinishedSteps, StoredSums};
use crate::archive::chunked::{ChunkSegment, MeshSizes};
use crate::archive::manifest::{CoordinateRecord, Counts, Manifest, SegmentRecord, Step, StepPlan};
use crate::archive::segment::{PlanHash, SegmentInfo, SegmentKind};
use crate::error::{Error, Result};
use crate::grid::ChunkId;
use crate::index::{BuildSettings, IndexBuilder, index_entries};
use crate::pipeline::plan::{Layout, MeshParts, Plan, estimate};
use crate::pipeline::read::{limits, sizes_of};
use crate::pipeline::settings::RunSettings;
use crate::spectrum::{Design, Limits, SpectrumBuilder};
use std::path::Path;

/// The mesh of an archive, and the steps that are finished.
#[derive(Clone, Debug, Default)]
pub(super) struct ArchiveContents {
    pub(super) counts: Counts,
    pub(super) mesh: Vec<SegmentRecord>,
    pub(super) steps: Vec<Step>,
    /// How often halos were widened.
    pub(super) halo_retries: u64,
}

impl ArchiveContents {
    /// What an archive has.
    pub(super) fn of(manifest: &Manifest) -> Self {
        let Manifest { counts, mesh, steps, .. } = manifest.clone();
        Self { counts, mesh, steps, halo_retries: 0 }
    }

    pub(super) fn manifest(&self, plan: &Plan) -> Manifest {
        Manifest::new(plan.mesh.clone(), self.counts, self.mesh.clone(), self.steps.clone())
    }

    /// Reads the summaries of the mesh of all chunks; those of a lattice follow by formula.
    pub(super) fn of_segments(plan: &Plan, parts: &MeshParts, layout: &Layout) -> Result<Self> {
        let counts = Counts { chunks: parts.chunks.len(), ..Counts::default() };
        let mut contents = Self { counts, ..Self::default() };
        if let Some(bcc) = parts.bcc {
            for chunk in parts.chunks.iter() {
                let [lo, hi] = parts.chunks.bricks().cells_of(&chunk);
                contents.add_sizes(sizes_of(&bcc.chunk(lo, hi)));
            }
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

    /// Adds the `n`-th step of the plan. Except in small archives, builds its index, and its
    /// spectrum from what chunks have measured, unless the step is finished.
    /// `coordinates` are those of a grid that has some, given with the first step of the archive.
    #[allow(clippy::too_many_arguments)]
    pub(super) fn add_step(
        &mut self,
        plan: &Plan,
        n: usize,
        layout: &Layout,
        finished: &FinishedSteps,
        parts: &MeshParts,
        coordinates: Option<CoordinateRecord>,
        run: &RunSettings,
    ) -> Result<()> {
        let (step, hash) = (&plan.steps[n], plan.step_hash(n));
        let layout = layout.at(step.number);
        let (mut values, mut void_points) = (vec![], 0);
        let is_indexed = self.counts.is_indexed(&plan.mesh);
        // The ranges of all points, and of the tetrahedra that are not void.
        let mut value_range = [f32::INFINITY, f32::NEG_INFINITY];
        let mut range = value_range;
        let mut index = IndexBuilder::new(&BuildSettings {
            memory: run.resources.memory.saturating_sub(estimate::BASE),
            scratch: Some(run.resources.scratch_folder()),
        });
        for number in 0..layout.segment_count() {
            let file = ChunkSegment::open(layout.values(number), SegmentKind::Values, Some(hash))?;
            for chunk in layout.chunks_of(number) {
                let summary = file.value_summary(ChunkId(chunk))?;
                void_points += u64::from(summary.void);
                value_range = [value_range[0].min(summary.min), value_range[1].max(summary.max)];
                for entry in index_entries(chunk, &summary.ranges) {
                    range = [range[0].min(entry.min), range[1].max(entry.max)];
                    if is_indexed {
                        index.push(entry)?;
                    }
                }
            }
            values.push(file.record());
        }
        // Those that chunks were measured with: by the set's own number of points, which may be a
        // little off.
        let limits = limits(&plan.mesh, parts.points.len());
        let spectrum = match finished.get(step.number) {
            _ if !is_indexed || range[0] > range[1] => None,
            Some(finished) => finished.spectrum,
            None => Some(sum_spectrum(&layout, step, hash, Design::new(range, limits), limits)?),
        };
        self.steps.push(Step {
            plan: step.clone(),
            value_range: (value_range[0] <= value_range[1]).then_some(value_range),
            void_points,
            values,
            index: is_indexed.then(|| index.finish(layout.index(), hash)).transpose()?,
            spectrum,
            coordinates,
            error: None,
            level_errors: vec![],
        });
        Ok(())
    }
}

/// Adds up what all chunks have measured of a step, and writes it.
fn sum_spectrum(
    layout: &Layout,
    step: &StepPlan,
    hash: PlanHash,
    design: Design,
    limits: Limits,
) -> Result<SegmentInfo> {
    let mut builder = SpectrumBuilder::new(design);
    for number in 0..layout.segment_count() {
        let sums = StoredSums::open(layout, number, step, hash)?;
        for chunk in layout.chunks_of(number) {
            builder.add(&sums.part(ChunkId(chunk), limits)?);
        }
    }
    builder.finish(layout.spectrum(), hash)
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
