//! VTKHDF: VTK's UnstructuredGrid in HDF5.
//!
//! We read the cells of all pieces, in the order of their vertices that VTU files have, with the
//! fields on points and cells. A point on the border of two pieces is stored, and counted, twice.
//! Files of several steps are refused. Memory: a part of each array.

use crate::bytes::ByteSource;
use crate::cells::{
    BLOCK, CellBlock, CellField, CellFile, CellKind, CellStream, CellsInfo, Center, NumberStream,
};
use crate::error::{Error, Result};
use crate::formats::shared::format::{self, About, Format, Head};
use crate::formats::shared::mesh_file::{MeshFile, PlainMesh};
use crate::formats::volume::hdf5;
use crate::formats::vtk::hdf::{Cells, HdfFile, Ids, components};
use std::sync::Arc;

/// VTKHDF files of type UnstructuredGrid.
pub(in crate::formats) struct VtkHdf;

static ABOUT: About = About { meshes: &["VTKHDF"], suffixes: &[".vtkhdf"], ..About::named("a VTKHDF mesh") };

impl Format for VtkHdf {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        let local = head.source().filter(|source| head.is_hdf5() && !source.is_remote());
        // What is wrong with a damaged file the reader of volumes tells.
        let kind = local.and_then(|source| hdf5::vtk_kind(source).ok().flatten());
        kind.as_deref() == Some("UnstructuredGrid")
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn format::Dataset>> {
        Ok(Box::new(PlainMesh(MeshFile::new(open(head.file()?)?)?)))
    }
}

fn open(source: &Arc<ByteSource>) -> Result<Mesh> {
    let file = HdfFile::new(source.path(), hdf5::arrays(source, 2)?)?;
    let (points, cells) = (file.point_count(), file.cells("")?.cell_count);
    let (mut fields, mut places, mut active) = (vec![], vec![], None);
    for (group, center, count) in [("PointData", Center::Point, points), ("CellData", Center::Cell, cells)] {
        for name in file.names_in(group) {
            let place = format!("{group}/{name}");
            if file.arrays.is_text(&format!("VTKHDF/{place}")) {
                continue;
            }
            let array = file.array(&place)?.expect("the file names it");
            let Some((scalar, components)) = components(&array, count) else {
                let expected = format!(
                    "numbers of {count} {}",
                    if center == Center::Point { "points" } else { "cells" }
                );
                return Err(file.wrong(&place, expected, format!("{:?} of them", array.shape)));
            };
            if active.is_none() && file.is_active(&place, "Scalars") {
                active = Some(fields.len());
            }
            fields.push(CellField { name, scalar, components, center });
            places.push(place);
        }
    }
    let info = CellsInfo {
        path: file.path.clone(),
        format: "VTKHDF UnstructuredGrid".into(),
        points,
        cells,
        fields,
        active,
        data_files: vec![],
    };
    Ok(Mesh { info, file, places })
}

struct Mesh {
    info: CellsInfo,
    file: HdfFile,
    /// Where the fields are.
    places: Vec<String>,
}

impl CellFile for Mesh {
    fn info(&self) -> &CellsInfo {
        &self.info
    }

    fn points(&self) -> Result<Box<dyn NumberStream>> {
        self.file.numbers("Points")
    }

    fn cells(&self) -> Result<Box<dyn CellStream>> {
        let (cells, types) = (self.file.cells("")?, self.file.ids("Types", self.info.cells)?);
        Ok(Box::new(Blocks { info: self.info.clone(), cells, types, at: 0, vertices: vec![] }))
    }

    fn field(&self, field: usize) -> Result<Box<dyn NumberStream>> {
        self.file.numbers(&self.places[field])
    }
}

/// The cells in blocks.
struct Blocks {
    info: CellsInfo,
    cells: Cells,
    types: Ids,
    /// Cells read.
    at: u64,
    vertices: Vec<u64>,
}

impl Blocks {
    fn wrong(&self, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(&self.info.path, format!("cell {} (counted from 0)", self.at), expected, got)
    }

    /// The next cell; `false` after the last.
    fn read(&mut self, out: &mut CellBlock) -> Result<bool> {
        let Some(count) = self.cells.next_cell()? else { return Ok(false) };
        let kind = CellKind::from_vtk(self.types.next()?.unwrap_or(u64::MAX)).map_err(|name| {
            let expected = "a linear or quadratic cell: tetrahedron, hexahedron, voxel, wedge, pyramid";
            self.wrong(expected, name).with_help("convert it to tetrahedra first")
        })?;
        if kind != CellKind::Flat && count != kind.vertices() as u64 {
            let expected = format!("{} vertices of {}", kind.vertices(), kind.plural());
            return Err(self.wrong(expected, count.to_string()));
        }
        self.vertices.clear();
        for _ in 0..count {
            let vertex = self.cells.next_vertex()?;
            // One without a volume may have any number.
            if kind != CellKind::Flat {
                self.vertices.push(vertex);
            }
        }
        out.push(kind, &self.vertices);
        self.at += 1;
        Ok(true)
    }
}

impl CellStream for Blocks {
    fn next_block(&mut self, out: &mut CellBlock) -> Result<bool> {
        out.clear();
        while out.len() < BLOCK && self.read(out)? {}
        Ok(!out.is_empty())
    }
}

#[cfg(all(test, feature = "hdf5"))]
mod tests;
