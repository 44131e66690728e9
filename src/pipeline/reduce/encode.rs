//! Makes the contents of one chunk: it is meshed, sampled, measured, encoded.
//!
//! Each chunk at work has scratch memory of its own. A chunk that outgrows it (its halo had to be
//! widened) drops all its data, and starts again with all scratch memory when no other chunk is at
//! work.
//!
//! For a series, the values of several steps are made while the mesh of a chunk is there: sampled,
//! encoded against the step before, ranges measured. If an earlier pass made the mesh, it is
//! decoded instead, and so are the values before the first step.

use super::encoded::EncodedChunk;
use super::reuse::ReusedChunks;
use super::workers::MakeChunks;
use crate::archive::chunked::{BlockRange, MeshSizes, MeshSummary, ValueSummary, encode_value_ranges};
use crate::archive::manifest::StepPlan;
use crate::archive::mesh::{ChunkEncoder, ChunkVertices};
use crate::archive::tables::{ChunkErrors, encode_errors};
use crate::archive::values::encode_values;
use crate::pipeline::chunk::{
    ChunkMesher, ChunkTets, Field, Meshing, Placement, Recipe, SampleErrors, Samples, StepLanes, fitted,
    interpolated, step_lanes,
};
use crate::pipeline::plan::{Halo, Shares};
use crate::pipeline::read::{MeshedChunk, Meter, StepView, spectrum};
use crate::pipeline::stage::StageTimes;
use crate::spectrum::Digits;
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::geom::LatticePos;
use isospan_io::grid::Chunk;
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::predicates::signed_volume6;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

/// A step whose values are to be made.
pub(super) struct StepInput<'a> {
    pub(super) plan: &'a StepPlan,
    pub(super) field: &'a Field<'a>,
}

/// A mesh that an earlier pass has made.
pub(super) struct StoredMesh<'a> {
    pub(super) archive: &'a StepView,
    /// The base of the first step: its position in the manifest.
    pub(super) base: Option<usize>,
}

/// Steps whose data could not be used, found by any thread.
pub(super) struct BadSteps {
    /// Whether errors name the step.
    several: bool,
    /// Why, by the position of the step among those of the pass.
    found: Mutex<BTreeMap<usize, String>>,
}

impl BadSteps {
    pub(super) fn new(several: bool) -> Self {
        Self { several, found: Mutex::default() }
    }

    pub(super) fn into_inner(self) -> BTreeMap<usize, String> {
        self.found.into_inner().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes whether the `n`-th step, of this number, could be used.
    pub(super) fn note<T>(&self, n: usize, number: u64, found: Result<T>) -> Result<T> {
        let found = found.map_err(|e| if self.several { e.at_step(number) } else { e });
        if let Err(e @ (Error::BadInput(_) | Error::Io { .. })) = &found {
            let mut bad = self.found.lock().unwrap_or_else(PoisonError::into_inner);
            bad.entry(n).or_insert_with(|| e.to_string());
        }
        found
    }
}

/// Makes the contents of chunks; shared by all threads.
pub(super) struct ChunkMaker<'a> {
    pub(super) recipe: &'a Recipe<'a>,
    /// Tetrahedra of a block.
    pub(super) block_tets: u32,
    /// Steps that follow each other; at least one.
    pub(super) steps: &'a [StepInput<'a>],
    /// Where the mesh comes from, if it is there.
    pub(super) stored: Option<StoredMesh<'a>>,
    /// Chunks that an earlier try has made, and where `steps` are in that.
    pub(super) reused: Option<(&'a ReusedChunks<'a>, Range<usize>)>,
    /// What parts of the spectrum are measured with; none where there will be no spectrum.
    pub(super) meter: Option<&'a Meter>,
    /// What errors are measured with, against the samples of each step; none where they are not.
    pub(super) sample_errors: Option<(SampleErrors, Vec<Samples<'a>>)>,
    pub(super) bad_steps: BadSteps,
    pub(super) shares: Shares,
    pub(super) workspaces: Workspaces,
    pub(super) cancel: &'a CancelToken,
}

/// The working memory that chunks take turns in.
#[derive(Default)]
pub(super) struct Workspaces {
    /// The memory of workers between two chunks.
    workspaces: Mutex<Vec<Workspace>>,
    /// Held shared by chunks at work, alone by a chunk that needs all scratch memory.
    turn: RwLock<()>,
}

/// Memory that a worker keeps from chunk to chunk.
#[derive(Default)]
struct Workspace {
    mesher: ChunkMesher,
    encoder: ChunkEncoder,
    bench: Bench,
}

/// Memory in which the values of several steps are measured.
#[derive(Default)]
struct Bench {
    lanes: step_lanes::LaneBuffers,
    spectrum: spectrum::Bench,
    /// Memory in which values are fitted.
    fit: Vec<u64>,
}

impl Workspaces {
    fn take_workspace(&self) -> Workspace {
        self.workspaces.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    fn put_workspace(&self, workspace: Workspace) {
        self.workspaces.lock().unwrap_or_else(PoisonError::into_inner).push(workspace);
    }

    fn drop_workspaces(&self) {
        self.workspaces.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

/// Some blocks of each step.
type StepBlocks = Vec<Vec<Vec<u8>>>;

/// As [`Meshing`].
enum Encoding {
    Done(EncodedChunk),
    NeedsRoom { bytes: u64 },
}

impl MakeChunks for ChunkMaker<'_> {
    /// Makes a chunk in a share of the scratch memory; if that is too small, in all of it. One that
    /// an earlier try has made is copied from that.
    fn make(&self, chunk: &Chunk) -> Result<EncodedChunk> {
        if let Some((reused, steps)) = &self.reused
            && let Some(encoded) = reused.encoded(chunk.id, self.stored.is_none(), steps)?
        {
            return Ok(encoded);
        }
        {
            let _together = self.workspaces.turn.read().unwrap_or_else(PoisonError::into_inner);
            let mut workspace = self.workspaces.take_workspace();
            match self.encode(chunk, &mut workspace, self.shares.chunk)? {
                Encoding::Done(encoded) => {
                    self.workspaces.put_workspace(workspace);
                    return Ok(encoded);
                }
                Encoding::NeedsRoom { .. } => {}
            }
        }
        let _alone = self.workspaces.turn.write().unwrap_or_else(PoisonError::into_inner);
        self.workspaces.drop_workspaces();
        match self.encode(chunk, &mut Workspace::default(), self.shares.all_chunks())? {
            Encoding::Done(encoded) => Ok(encoded),
            Encoding::NeedsRoom { bytes } => Err(Error::memory(
                format!("chunk {} needs a wide halo; smaller `chunk_points` need less", chunk.id.0),
                self.shares.memory_for(bytes),
                self.shares.memory_for(self.shares.all_chunks()),
            )),
        }
    }

    fn points(&self, chunk: &Chunk) -> u64 {
        self.recipe.points.count_in(&chunk.core)
    }

    fn will_need(&self, chunk: &Chunk) {
        self.steps.iter().for_each(|s| s.field.will_need(chunk));
    }

    fn pass(&self, chunk: &Chunk) {
        self.steps.iter().for_each(|s| s.field.pass(chunk));
        if let Some(stored) = &self.stored {
            stored.archive.close_before(chunk.id);
        }
        if let Some((reused, _)) = &self.reused {
            reused.pass(chunk.id);
        }
    }

    fn queue(&self) -> u64 {
        self.shares.queue
    }

    fn cancel(&self) -> &CancelToken {
        self.cancel
    }
}

impl ChunkMaker<'_> {
    fn encode(&self, chunk: &Chunk, workspace: &mut Workspace, limit: u64) -> Result<Encoding> {
        let mut times = StageTimes::default();
        let mut lap = Lap(Instant::now());
        if let Some(stored) = &self.stored {
            let (mut mesh, ends) = stored.archive.stored_mesh(chunk.id)?;
            // The tetrahedra around, to whose samples values are fitted, are not stored: they are
            // found around the mesh, or made again with it.
            let mut again = None;
            if self.recipe.halo == Halo::Stars
                && !workspace.mesher.surround(self.recipe, chunk, &mut mesh, limit, self.cancel)?
            {
                match workspace.mesher.mesh(self.recipe, chunk, limit, self.cancel)? {
                    Meshing::Done(mesh) => again = Some(mesh),
                    Meshing::NeedsRoom { bytes } => return Ok(Encoding::NeedsRoom { bytes }),
                }
            }
            lap.add_to(&mut times.mesh);
            return self
                .encode_stored(stored, chunk, (mesh, ends), again, workspace, times)
                .map(Encoding::Done);
        }
        let mut mesh = match workspace.mesher.mesh(self.recipe, chunk, limit, self.cancel)? {
            Meshing::Done(mesh) => mesh,
            Meshing::NeedsRoom { bytes } => return Ok(Encoding::NeedsRoom { bytes }),
        };
        lap.add_to(&mut times.mesh);
        let mut placement = self.note(0, self.steps[0].field.place(&mesh))?;
        let outside6 = drop_outside(&mut mesh, &mut placement);
        lap.add_to(&mut times.sample);
        let (mesh_blocks, ends) = self.encode_mesh(&mut workspace.encoder, &mut mesh, outside6);
        lap.add_to(&mut times.encode);
        let bench = &mut workspace.bench;
        let values = self.values_of(&mut mesh, &placement, &mut bench.fit, &mut times)?;
        let (value_blocks, sum_blocks) = self.encode_steps(&mesh, values, None, &ends, bench, &mut times)?;
        let core = mesh.core_len();
        workspace.mesher.reuse(mesh.all_positions, mesh.tets);
        let points = core as u64;
        Ok(Encoding::Done(EncodedChunk { points, mesh_blocks, value_blocks, sum_blocks, times }))
    }

    /// Encodes the values of steps on a mesh that is there, with the ends of its blocks.
    ///
    /// `again` is the mesh with its one-ring neighbours, where values need these and they are not
    /// there.
    fn encode_stored(
        &self,
        stored: &StoredMesh<'_>,
        chunk: &Chunk,
        (mut mesh, ends): (MeshedChunk, Vec<usize>),
        again: Option<MeshedChunk>,
        workspace: &mut Workspace,
        mut times: StageTimes,
    ) -> Result<EncodedChunk> {
        let mut lap = Lap(Instant::now());
        let place = |mesh: &MeshedChunk| self.note(0, self.steps[0].field.place(mesh));
        let placement = match again {
            // The mesh has nothing outside any more.
            None => place(&mesh)?,
            Some(mut whole) => {
                let mut placement = place(&whole)?;
                drop_outside(&mut whole, &mut placement);
                let counts = [&whole, &mesh].map(|mesh| mesh.tets.len());
                if counts[0] != counts[1] {
                    let [expected, got] = counts.map(|n| n.to_string());
                    let at = format!("chunk {}, tetrahedra", chunk.id.0);
                    return Err(Error::bad_input(stored.archive.path(), at, expected, got)
                        .with_help("isospan check tells more"));
                }
                mesh.surround(whole);
                placement
            }
        };
        lap.add_to(&mut times.sample);
        let vertices = mesh.vertices();
        let before =
            stored.base.map(|base| stored.archive.chunk_values(base, chunk.id, vertices)).transpose()?;
        lap.add_to(&mut times.mesh);
        let (before, bench) = (before.as_deref(), &mut workspace.bench);
        let values = self.values_of(&mut mesh, &placement, &mut bench.fit, &mut times)?;
        let (value_blocks, sum_blocks) =
            self.encode_steps(&mesh, values, before, &ends, bench, &mut times)?;
        let points = mesh.core_len() as u64;
        workspace.mesher.reuse(mesh.all_positions, mesh.tets);
        Ok(EncodedChunk { points, mesh_blocks: vec![], value_blocks, sum_blocks, times })
    }

    /// The values of all steps, as they are stored.
    fn values_of(
        &self,
        mesh: &mut MeshedChunk,
        placement: &Placement,
        memory: &mut Vec<u64>,
        times: &mut StageTimes,
    ) -> Result<Vec<Vec<f32>>> {
        let mut lap = Lap(Instant::now());
        let fields: Vec<&Field<'_>> = self.steps.iter().map(|step| step.field).collect();
        let note = |n, read| self.note(n, read);
        let interpolated = interpolated(&fields, mesh, placement, self.cancel, note)?;
        lap.add_to(&mut times.sample);
        let wanted: Vec<_> = self.steps.iter().map(|step| (step.field, step.plan.quantiser)).collect();
        let mut values = fitted(&wanted, mesh, placement, interpolated, memory, self.cancel, note)?;
        if self.recipe.halo == Halo::Stars {
            lap.add_to(&mut times.fit);
        }
        for (step, values) in self.steps.iter().zip(&mut values) {
            match &step.plan.quantiser {
                Some(quantiser) => values.iter_mut().for_each(|v| *v = quantiser.round(*v)),
                // A zero has no sign: which of two zeros is the lesser one differs from machine to
                // machine.
                None => values.iter_mut().for_each(|v| *v += 0.0),
            }
        }
        Ok(values)
    }

    /// Notes whether a step could be used.
    fn note<T>(&self, n: usize, found: Result<T>) -> Result<T> {
        self.bad_steps.note(n, self.steps[n].plan.number, found)
    }

    /// Measures and encodes all steps. The blocks of each are values, their ranges and a summary;
    /// the sums of each are errors, where they are measured, and the part of a spectrum.
    ///
    /// `before` are the values of the first one's base. The mesh has the tetrahedra of all blocks,
    /// as they decode, with the end of each block.
    fn encode_steps(
        &self,
        mesh: &MeshedChunk,
        values: Vec<Vec<f32>>,
        before: Option<&[f32]>,
        block_ends: &[usize],
        bench: &mut Bench,
        times: &mut StageTimes,
    ) -> Result<(StepBlocks, StepBlocks)> {
        let mut lap = Lap(Instant::now());
        let of_steps: Vec<&[f32]> = values.iter().map(Vec::as_slice).collect();
        let lanes = StepLanes::new(&of_steps, &mut bench.lanes);
        let (positions, tets) = (mesh.positions(), &*mesh.tets);
        let errors = self.errors(&ChunkTets { positions, tets, block_ends }, &lanes)?;
        lap.add_to(&mut times.measure);
        let ranges = lanes.ranges(tets, block_ends);
        lanes.give_back(&mut bench.lanes);
        lap.add_to(&mut times.encode);
        let of_steps: Vec<(&[f32], &[BlockRange])> =
            of_steps.into_iter().zip(&ranges).map(|(values, ranges)| (values, &**ranges)).collect();
        let measured = self.meter.map(|m| m.parts(positions, tets, &of_steps, &mut bench.spectrum));
        let parts = measured.transpose()?.unwrap_or_default();
        lap.add_to(&mut times.spectrum);
        let (mut out, mut sums, mut before, blocks) = (vec![], vec![], before, &mesh.value_blocks());
        for (n, (step, ranges)) in self.steps.iter().zip(ranges).enumerate() {
            self.cancel.check()?;
            let values = &*values[n];
            let base = step.plan.base.map(|_| before.expect("a base is the step before"));
            let mut encoded = encode_values(values, blocks, base, step.plan.quantiser.as_ref());
            encoded.push(encode_value_ranges(values, blocks));
            let mut added: Vec<_> = errors.get(n).map(encode_errors).into_iter().collect();
            added.extend(parts.get(n).map(|part| part.encode(Digits::All)));
            sums.push(added);
            encoded.push(ValueSummary::of(&values[..mesh.core_len()], ranges).encode());
            out.push(encoded);
            before = Some(values);
        }
        lap.add_to(&mut times.encode);
        Ok((out, sums))
    }

    /// The errors of each step in a chunk; none where they are not measured.
    fn errors(&self, cells: &ChunkTets<'_>, steps: &StepLanes<'_>) -> Result<Vec<ChunkErrors>> {
        let Some((sample_errors, samples)) = &self.sample_errors else { return Ok(vec![]) };
        let levels = self.recipe.points.levels().map(|levels| &**levels);
        sample_errors
            .chunk_errors(cells, steps, levels, |n, window, out| self.note(n, samples[n].read(window, out)))
    }

    /// Encodes a chunk's mesh: its blocks, and the end of each block of tetrahedra in these.
    /// Leaves the mesh with the tetrahedra as they decode.
    fn encode_mesh(
        &self,
        encoder: &mut ChunkEncoder,
        mesh: &mut MeshedChunk,
        outside6: i128,
    ) -> (Vec<Vec<u8>>, Vec<usize>) {
        let sizes = MeshSizes {
            core: mesh.core_len() as u32,
            halo: mesh.halo.len() as u32,
            tet_blocks: 0,
            retries: mesh.retries,
            tets: mesh.tets.len() as u64,
        };
        let volume6 = volume6(mesh.positions(), mesh.tets.iter());
        let vertices = ChunkVertices {
            core_counts: std::mem::take(&mut mesh.core_counts),
            halo: std::mem::take(&mut mesh.halo),
            shared: std::mem::take(&mut mesh.shared),
        };
        let positions = &mesh.all_positions[..mesh.all_positions.len() - mesh.around];
        let encoded = encoder.encode(&vertices, positions, &mut mesh.tets, self.block_tets);
        ChunkVertices { core_counts: mesh.core_counts, halo: mesh.halo, shared: mesh.shared, .. } = vertices;
        let (ends, sizes) =
            (encoded.block_ends(), MeshSizes { tet_blocks: encoded.tet_blocks() as u32, ..sizes });
        let mut blocks = encoded.blocks;
        blocks.push(MeshSummary { sizes, volume6, outside6 }.encode());
        (blocks, ends)
    }
}

/// Adds up what a stage takes.
struct Lap(Instant);

impl Lap {
    fn add_to(&mut self, stage: &mut Duration) {
        let now = Instant::now();
        *stage += now - std::mem::replace(&mut self.0, now);
    }
}

/// Removes the tetrahedra that lie outside of the data, and the halo points that only they use.
/// Returns six times the volume of those of the chunk itself.
fn drop_outside(mesh: &mut MeshedChunk, placement: &mut Placement) -> i128 {
    let outside = std::mem::take(&mut placement.outside);
    if outside.is_empty() {
        return 0;
    }
    let gone = mesh.tets.iter().zip(&outside).filter(|(_, gone)| **gone).map(|(t, _)| t);
    let volume = volume6(mesh.positions(), gone);
    let mut flags = outside.iter();
    let stays = |_: &Tet| !flags.next().expect("a flag for each tetrahedron, those around last");
    mesh.tets.retain(stays);
    let before = mesh.drop_unused_halo();
    placement.spots = before.iter().map(|&v| placement.spots[v as usize]).collect();
    volume
}

fn volume6<'a>(positions: &[LatticePos], tets: impl Iterator<Item = &'a Tet>) -> i128 {
    tets.map(|t| {
        let [a, b, c, d] = t.map(|v| positions[v as usize]);
        signed_volume6(a, b, c, d)
    })
    .sum()
}
