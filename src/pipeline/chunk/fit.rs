//! Fits the values of a chunk's vertices to samples ([`crate::fit`]), at several steps together: a
//! vertex to the samples in all tetrahedra around it.
//!
//! ```text
//!  tetrahedra ─▶ windows (of a mesh: bricks) ─▶ read the samples of each step ─▶ one scan ─▶ sums, steps interleaved ─▶ values
//! ```
//!
//! The samples of a mesh are its vertices. Each lies in one tetrahedron of the reduction, and
//! counts for its corners if the tetrahedron is of the same body.

use super::field::Field;
use super::mesh_field::CellField;
use super::placement::Placement;
use super::volume_field::GridField;
use crate::archive::values::Quantiser;
use crate::domain::vertices::Vertices;
use crate::fit::{BrickTets, Fit, FitMesh, Windows, window_edge};
use crate::pipeline::read::MeshedChunk;
use isospan_io::error::Result;
use isospan_io::exec::{CancelToken, Room};
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::raster::{PointLocator, SampleGrid};
use isospan_mesh::sample::Values;

/// The values of a chunk's vertices at some steps, fitted where that is wanted; from the
/// interpolated ones of these and of the vertices around. Those of a step with a quantiser are
/// rounded, to a multiple within the samples around where there is one. `note` gets the step
/// whose samples were read; `memory` is kept from chunk to chunk, so that its pages are not asked
/// for again.
pub(in crate::pipeline) fn fitted(
    wanted: &[(&Field<'_>, Option<Quantiser>)],
    mesh: &mut MeshedChunk,
    placement: &Placement,
    interpolated: Vec<Vec<f32>>,
    memory: &mut Vec<u64>,
    cancel: &CancelToken,
    note: impl Fn(usize, Result<()>) -> Result<()>,
) -> Result<Vec<Vec<f32>>> {
    let steps: Vec<&[f32]> = interpolated.iter().map(Vec::as_slice).collect();
    let (mut grids, mut cells) = (vec![], vec![]);
    for (field, _) in wanted {
        match field {
            Field::Grid(field) if field.values == Values::Fit => grids.push(field),
            Field::Cells(field) => cells.extend(field.fitted_to.map(|vertices| (field, vertices))),
            Field::Grid(_) | Field::Own(_) => {}
        }
    }
    if grids.is_empty() && cells.is_empty() {
        return Ok(interpolated);
    }
    let vertices = mesh.vertices();
    let (tets, room) = mesh.tets.with_room();
    let words = Fit::further_words(mesh.all_positions.len(), steps.len());
    if memory.len() < words {
        // Not resized, because that would copy the old contents.
        *memory = vec![];
        *memory = vec![0; words];
    }
    let mut room = Room::new(room).and(memory);
    let mut fit = Fit::new(FitMesh { positions: &mesh.all_positions, tets }, &steps, &mut room);
    match cells.first() {
        None => add_samples(&mut fit, &mut room, &grids, cancel, note)?,
        Some(&(_, lying)) => {
            let cells: Vec<&CellField<'_>> = cells.iter().map(|&(field, _)| field).collect();
            add_vertices(&mut fit, &mut room, &cells, lying, placement, cancel, note)?;
        }
    }
    let round = |step: usize, value, bounds| match &wanted[step].1 {
        Some(quantiser) => quantiser.round_within(value, bounds),
        None => value,
    };
    Ok(fit.values_rounded(vertices, &round))
}

/// Adds the samples of volumes.
fn add_samples<'a>(
    fit: &mut Fit<'a>,
    room: &mut Room<'a>,
    fields: &[&GridField],
    cancel: &CancelToken,
    note: impl Fn(usize, Result<()>) -> Result<()>,
) -> Result<()> {
    let (bricks, mesh) = (&fields[0].bricks, fit.mesh());
    let grid = SampleGrid::voxels(&bricks.lattice);
    let windows = Windows::new(&grid, window_edge(bricks.voxels()), mesh.positions, mesh.tets, room);
    for (window, tets) in windows.iter() {
        cancel.check()?;
        fit.add(&grid, &window, tets, |n, part, out| note(n, fields[n].read_window(part, out)))?;
    }
    Ok(())
}

/// Adds the values of steps at the vertices of their mesh.
fn add_vertices<'a>(
    fit: &mut Fit<'a>,
    room: &mut Room<'a>,
    fields: &[&CellField<'_>],
    vertices: &Vertices,
    placement: &Placement,
    cancel: &CancelToken,
    note: impl Fn(usize, Result<()>) -> Result<()>,
) -> Result<()> {
    let (bricks, store, mesh) = (&fields[0].cells.bricks, fields[0].store, fit.mesh());
    let mut originals = vec![];
    for (n, field) in fields.iter().enumerate() {
        note(n, field.values.get().map(|values| originals.push(values)))?;
    }
    let body_of = |[v, ..]: Tet| placement.spots[v as usize].body;
    let mut samples = vec![];
    for (brick, touching) in BrickTets::new(bricks, mesh.positions, mesh.tets, room).iter() {
        cancel.check()?;
        vertices.each_batch(store, brick, |batch| {
            samples.clear();
            for values in &originals {
                samples.extend(batch.iter().map(|v| values[v.number as usize]));
            }
            let places = batch.iter().map(|v| v.pos).zip(0..);
            let points = PointLocator::new(bricks.brick(brick), bricks.lattice.max(), places);
            // The samples of a body do not count for another one that it touches or overlaps.
            let counts_for = |tet: u32, v: u32| body_of(mesh.tets[tet as usize]) == batch[v as usize].body;
            fit.add_points(&points, &samples, touching, counts_for);
        })?;
    }
    Ok(())
}
