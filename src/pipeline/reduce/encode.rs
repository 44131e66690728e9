//! The contents of one chunk: meshed, sampled, measured, encoded.
//!
//! Each chunk at work has scratch memory of its own. A chunk that outgrows it (its halo had to be
//! widened) drops all it has, and starts again with all scratch memory when no other is at work.
//!
//! For a series, the values of several steps are made while the mesh of a chunk is there: sampled,
//! encoded against the step before, ranges measured. If an earlier pass made the mesh, it is
//! decoded instead, and so are the values before the first step.

use super::workers::{StageTimes, Stored, Work};
use crate::archive::chunk::ChunkEncoder;
use crate::archive::errors::{ChunkErrors, encode_errors};
use crate::archive::summary::{BlockRange, MeshSummary, ValueSummary, encode_value_ranges};
use crate::archive::values::encode_values;
use crate::archive::vertices::ChunkVertices;
use crate::error::{Error, Result};
use crate::geom::LatticePos;
use crate::geom::predicates::signed_volume6;
use crate::grid::Chunk;
use crate::mesh::tet::Tet;
use crate::pipeline::chunk::{
    Cells, ChunkMesher, Field, Meshing, Placement, StepLanes, fitted, interpolated, step_lanes,
};
use crate::pipeline::plan::Halo;
use crate::pipeline::read::{MeshedChunk, spectrum};
use std::sync::{Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

/// A chunk ready to be written.
pub(super) struct Product {
    pub(super) points: u64,
    /// Empty where the mesh is there already.
    pub(super) mesh_blocks: Vec<Vec<u8>>,
    /// Of each step.
    pub(super) value_blocks: Vec<Vec<Vec<u8>>>,
    pub(super) times: StageTimes,
}

/// The working memory that chunks take turns in.
#[derive(Default)]
pub(super) struct Workspaces {
    /// The memory of workers between two chunks.
    workspaces: Mutex<Vec<Workspace>>,
    /// Held shared by chunks at work, alone by a chunk that needs the rooms of all.
    turn: RwLock<()>,
}

/// Memory that a worker keeps from chunk to chunk.
#[derive(Default)]
struct Workspace {
    mesher: ChunkMesher,
    encoder: ChunkEncoder,
    bench: Bench,
}

/// What the values of several steps are measured in.
#[derive(Default)]
struct Bench {
    sides: step_lanes::Room,
    spectrum: spectrum::Bench,
    /// What values are fitted in.
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

/// Makes a chunk in a room of its own; if that is too small, in the rooms of all. One that an earlier try has made is taken over.
pub(super) fn make_chunk(work: &Work<'_>, chunk: &Chunk) -> Result<Product> {
    if let Some((taken, steps)) = &work.taken
        && let Some(product) = taken.product(chunk.id, work.stored.is_none(), steps)?
    {
        return Ok(product);
    }
    {
        let _together = work.rooms.turn.read().unwrap_or_else(PoisonError::into_inner);
        let mut workspace = work.rooms.take_workspace();
        match make_in_room(work, chunk, &mut workspace, work.shares.room)? {
            Making::Done(product) => {
                work.rooms.put_workspace(workspace);
                return Ok(product);
            }
            Making::NeedsRoom { .. } => {}
        }
    }
    let _alone = work.rooms.turn.write().unwrap_or_else(PoisonError::into_inner);
    work.rooms.drop_workspaces();
    match make_in_room(work, chunk, &mut Workspace::default(), work.shares.room_alone())? {
        Making::Done(product) => Ok(product),
        Making::NeedsRoom { bytes } => Err(Error::Budget {
            what: format!(
                "memory (chunk {} needs a wide halo; smaller --chunk-points need less)",
                chunk.id.0
            ),
            needed: work.shares.memory_for(bytes),
            available: work.shares.memory_for(work.shares.room_alone()),
        }),
    }
}

/// As [`Meshing`].
enum Making {
    Done(Product),
    NeedsRoom { bytes: u64 },
}

fn make_in_room(work: &Work<'_>, chunk: &Chunk, workspace: &mut Workspace, room: u64) -> Result<Making> {
    let mut times = StageTimes::default();
    let mut lap = Lap(Instant::now());
    if let Some(stored) = &work.stored {
        let (mut mesh, ends) = stored.archive.stored_mesh(chunk.id)?;
        // What values are fitted to is not stored: it is found around the mesh, or made again with it.
        let mut again = None;
        if work.recipe.halo == Halo::Stars
            && !workspace.mesher.surround(work.recipe, chunk, &mut mesh, room, work.cancel)?
        {
            match workspace.mesher.mesh(work.recipe, chunk, room, work.cancel)? {
                Meshing::Done(mesh) => again = Some(mesh),
                Meshing::NeedsRoom { bytes } => return Ok(Making::NeedsRoom { bytes }),
            }
        }
        lap.add_to(&mut times.mesh);
        return make_from_stored(work, stored, chunk, (mesh, ends), again, workspace, times)
            .map(Making::Done);
    }
    let mut mesh = match workspace.mesher.mesh(work.recipe, chunk, room, work.cancel)? {
        Meshing::Done(mesh) => mesh,
        Meshing::NeedsRoom { bytes } => return Ok(Making::NeedsRoom { bytes }),
    };
    lap.add_to(&mut times.mesh);
    let mut placement = note(work, 0, work.steps[0].field.place(&mesh))?;
    let outside6 = drop_outside(&mut mesh, &mut placement);
    lap.add_to(&mut times.sample);
    let (mut mesh_blocks, ends, summary) =
        encode_mesh(work, chunk, &mut workspace.encoder, &mut mesh, outside6);
    lap.add_to(&mut times.encode);
    let value_blocks =
        encode_steps(work, &mut mesh, &placement, None, &ends, &mut workspace.bench, &mut times)?;
    workspace.mesher.reuse(mesh.all_positions, mesh.tets);
    mesh_blocks.push(summary.encode());
    Ok(Making::Done(Product { points: u64::from(summary.core), mesh_blocks, value_blocks, times }))
}

/// The values of steps on a mesh that is there, with the ends of its blocks; `again` is that of the chunk with what is around it, where values ask for that and it is not there.
fn make_from_stored(
    work: &Work<'_>,
    stored: &Stored<'_>,
    chunk: &Chunk,
    (mut mesh, ends): (MeshedChunk, Vec<usize>),
    again: Option<MeshedChunk>,
    workspace: &mut Workspace,
    mut times: StageTimes,
) -> Result<Product> {
    let mut lap = Lap(Instant::now());
    let place = |mesh: &MeshedChunk| note(work, 0, work.steps[0].field.place(mesh));
    let placement = match again {
        // Of a mesh in which nothing lies outside any more.
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
    let before = stored.base.map(|base| stored.archive.chunk_values(base, chunk.id, vertices)).transpose()?;
    lap.add_to(&mut times.mesh);
    let (before, bench) = (before.as_deref(), &mut workspace.bench);
    let value_blocks = encode_steps(work, &mut mesh, &placement, before, &ends, bench, &mut times)?;
    let points = mesh.core_len() as u64;
    workspace.mesher.reuse(mesh.all_positions, mesh.tets);
    Ok(Product { points, mesh_blocks: vec![], value_blocks, times })
}

/// Adds up what a stage takes.
struct Lap(Instant);

impl Lap {
    fn add_to(&mut self, stage: &mut Duration) {
        let now = Instant::now();
        *stage += now - std::mem::replace(&mut self.0, now);
    }
}

/// The values of all steps, as they are stored.
fn values_of(
    work: &Work<'_>,
    mesh: &mut MeshedChunk,
    placement: &Placement,
    memory: &mut Vec<u64>,
    times: &mut StageTimes,
) -> Result<Vec<Vec<f32>>> {
    let mut lap = Lap(Instant::now());
    let fields: Vec<&dyn Field> = work.steps.iter().map(|step| step.field).collect();
    let note = |n, read| note(work, n, read);
    let interpolated = interpolated(&fields, mesh, placement, work.cancel, note)?;
    lap.add_to(&mut times.sample);
    let wanted: Vec<_> = work.steps.iter().map(|step| (step.field, step.plan.quantiser)).collect();
    let mut values = fitted(&wanted, mesh, placement, interpolated, memory, work.cancel, note)?;
    if work.recipe.halo == Halo::Stars {
        lap.add_to(&mut times.fit);
    }
    for (step, values) in work.steps.iter().zip(&mut values) {
        match &step.plan.quantiser {
            Some(quantiser) => values.iter_mut().for_each(|v| *v = quantiser.round(*v)),
            // A zero has no sign: which of two zeros is the lesser one differs from machine to machine.
            None => values.iter_mut().for_each(|v| *v += 0.0),
        }
    }
    Ok(values)
}

/// Notes a step whose data cannot be used.
fn note<T>(work: &Work<'_>, n: usize, found: Result<T>) -> Result<T> {
    let step = &work.steps[n];
    let found = found.map_err(|e| if work.several { e.at_step(step.plan.number) } else { e });
    if let Err(e @ (Error::BadInput(_) | Error::Io { .. })) = &found {
        let mut bad = work.bad_steps.lock().unwrap_or_else(PoisonError::into_inner);
        bad.entry(n).or_insert_with(|| e.to_string());
    }
    found
}

/// Samples, measures and encodes all steps: the blocks of each, values, their ranges, errors, part of the spectrum, summary. `before` are the
/// values of the first one's base; the mesh has the tetrahedra of all blocks, as they decode, with the end of each block.
fn encode_steps(
    work: &Work<'_>,
    mesh: &mut MeshedChunk,
    placement: &Placement,
    before: Option<&[f32]>,
    block_ends: &[usize],
    bench: &mut Bench,
    times: &mut StageTimes,
) -> Result<Vec<Vec<Vec<u8>>>> {
    let values = values_of(work, mesh, placement, &mut bench.fit, times)?;
    let mut lap = Lap(Instant::now());
    let of_steps: Vec<&[f32]> = values.iter().map(Vec::as_slice).collect();
    let sides = StepLanes::new(&of_steps, &mut bench.sides);
    let (positions, tets) = (mesh.positions(), &*mesh.tets);
    let errors = errors(work, &Cells { positions, tets, block_ends }, &sides)?;
    lap.add_to(&mut times.measure);
    let ranges = sides.ranges(tets, block_ends);
    sides.give_back(&mut bench.sides);
    lap.add_to(&mut times.encode);
    let of_steps: Vec<(&[f32], &[BlockRange])> =
        of_steps.into_iter().zip(&ranges).map(|(values, ranges)| (values, &**ranges)).collect();
    let parts = work.meter.parts(positions, tets, &of_steps, &mut bench.spectrum)?;
    lap.add_to(&mut times.spectrum);
    let (mut out, mut before, blocks) = (vec![], before, &mesh.value_blocks());
    for (n, ((step, part), ranges)) in work.steps.iter().zip(&parts).zip(ranges).enumerate() {
        work.cancel.check()?;
        let values = &*values[n];
        let base = step.plan.base.map(|_| before.expect("a base is the step before"));
        let mut encoded = encode_values(values, blocks, base, step.plan.quantiser.as_ref());
        encoded.push(encode_value_ranges(values, blocks));
        encoded.extend(errors.get(n).map(encode_errors));
        encoded.push(part.encode());
        encoded.push(ValueSummary::of(&values[..mesh.core_len()], ranges).encode());
        out.push(encoded);
        before = Some(values);
    }
    lap.add_to(&mut times.encode);
    Ok(out)
}

/// The errors of each step in a chunk; none where they are not measured.
fn errors(work: &Work<'_>, cells: &Cells<'_>, steps: &StepLanes<'_>) -> Result<Vec<ChunkErrors>> {
    let Some((sample_errors, samples)) = &work.sample_errors else { return Ok(vec![]) };
    let levels = work.recipe.points.levels().map(|levels| &**levels);
    sample_errors
        .chunk_errors(cells, steps, levels, |n, window, out| note(work, n, samples[n].read(window, out)))
}

/// Removes the tetrahedra that lie outside of the data, and the halo points that only they use; tells the six-fold volume of the chunk's own.
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

/// Encodes a chunk's mesh: its blocks, the end of each in the tetrahedra, and its summary. Leaves the mesh with the tetrahedra as they decode.
fn encode_mesh(
    work: &Work<'_>,
    chunk: &Chunk,
    encoder: &mut ChunkEncoder,
    mesh: &mut MeshedChunk,
    outside6: i128,
) -> (Vec<Vec<u8>>, Vec<usize>, MeshSummary) {
    let mut summary = MeshSummary {
        core: mesh.core_len() as u32,
        halo: mesh.halo.len() as u32,
        tet_blocks: 0,
        retries: mesh.retries,
        tets: mesh.tets.len() as u64,
        volume6: volume6(mesh.positions(), mesh.tets.iter()),
        outside6,
    };
    // What follows by formula is not stored.
    if let Some(chunk) = work.recipe.bcc_chunk(chunk) {
        summary.tet_blocks = chunk.brick_count() as u32;
        return (vec![], chunk.brick_ends(), summary);
    }
    let vertices = ChunkVertices {
        core_counts: std::mem::take(&mut mesh.core_counts),
        halo: std::mem::take(&mut mesh.halo),
        shared: std::mem::take(&mut mesh.shared),
    };
    let positions = &mesh.all_positions[..mesh.all_positions.len() - mesh.around];
    let encoded = encoder.encode(&vertices, positions, &mut mesh.tets, work.plan.block_tets);
    ChunkVertices { core_counts: mesh.core_counts, halo: mesh.halo, shared: mesh.shared } = vertices;
    summary.tet_blocks = encoded.tet_blocks() as u32;
    let ends = encoded.block_ends();
    (encoded.blocks, ends, summary)
}
