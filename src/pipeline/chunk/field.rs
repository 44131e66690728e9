//! Where the values at the vertices of a chunk come from, and which tetrahedra lie outside of the
//! data.
//!
//! The mesh of a chunk knows positions only. A [`Field`] of each step is asked for each chunk.
//! Vertices are grouped by bricks, so that what is read for a group lies together.

use super::errors::Originals;
use super::mesh_field::CellField;
use super::own_field::OwnField;
use super::placement::Placement;
use super::volume_field;
use super::volume_field::GridField;
use crate::pipeline::read::MeshedChunk;
use isospan_io::error::Result;
use isospan_io::exec::CancelToken;
use isospan_io::grid::Chunk;

/// The data of a step: a source of values at any place.
pub(in crate::pipeline) enum Field<'a> {
    /// The samples of a volume.
    Grid(GridField),
    /// The cells of a mesh.
    Cells(CellField<'a>),
    /// The vertices of a mesh that is kept as it is.
    Own(OwnField<'a>),
}

impl Field<'_> {
    /// Where the vertices of a chunk lie, and its tetrahedra outside of the data. The answer serves
    /// all steps of a series.
    ///
    /// # Errors
    /// When the data cannot be read.
    pub(in crate::pipeline) fn place(&self, mesh: &MeshedChunk) -> Result<Placement> {
        match self {
            Self::Grid(grid) => Ok(grid.place(mesh)),
            Self::Cells(cells) => cells.place(mesh),
            Self::Own(own) => own.place(mesh),
        }
    }

    /// The samples that the values are made from.
    pub(in crate::pipeline) fn originals(&self) -> Originals<'_> {
        match self {
            Self::Grid(grid) => grid.originals(),
            Self::Cells(cells) => Originals::Mesh(cells.store, &cells.values),
            Self::Own(own) => Originals::Mesh(own.mesh.store, &own.values),
        }
    }

    /// Hints that a chunk will be asked for soon.
    pub(in crate::pipeline) fn will_need(&self, chunk: &Chunk) {
        if let Self::Grid(grid) = self {
            grid.will_need(chunk);
        }
    }

    /// Says that no chunk before this one will be asked for again; chunks pass in order.
    pub(in crate::pipeline) fn pass(&self, chunk: &Chunk) {
        if let Self::Grid(grid) = self {
            grid.pass(chunk);
        }
    }
}

/// Interpolated values at the vertices of a chunk at some steps, in their order; where values are
/// fitted, then those at the vertices around. `note` gets the step that was read.
pub(in crate::pipeline) fn interpolated(
    fields: &[&Field<'_>],
    mesh: &MeshedChunk,
    placement: &Placement,
    cancel: &CancelToken,
    note: impl Fn(usize, Result<()>) -> Result<()>,
) -> Result<Vec<Vec<f32>>> {
    let mut values = vec![vec![]; fields.len()];
    let mut grids = vec![];
    for (n, field) in fields.iter().enumerate() {
        match field {
            Field::Grid(grid) => grids.push(grid),
            Field::Cells(cells) => {
                cancel.check()?;
                note(n, cells.interpolated(placement).map(|found| values[n] = found))?;
            }
            Field::Own(own) => {
                cancel.check()?;
                note(n, own.at_vertices(placement).map(|found| values[n] = found))?;
            }
        }
    }
    if !grids.is_empty() {
        volume_field::interpolate(&grids, mesh, &placement.groups, &mut values, cancel, note)?;
    }
    Ok(values)
}
