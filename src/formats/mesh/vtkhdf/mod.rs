//! VTKHDF: VTK's UnstructuredGrid in HDF5.
//!
//! We write one piece:
//!
//! ```text
//! /comments                                     a line
//! /VTKHDF                                       Type UnstructuredGrid
//!   NumberOfPoints, NumberOfCells, NumberOfConnectivityIds
//!   Points                                      3 × f64 a point
//!   Connectivity                                4 × i64 a tetrahedron
//!   Offsets                                     i64: 0, 4, 8, …
//!   Types                                       u8 a tetrahedron: 10
//!   PointData/FIELD, …                          f32 a point      (f64 where it is counted from an offset)
//! ```
//!
//! Arrays lie in the file as they are, or in chunks that are compressed (zlib). In the name of the
//! field "_" stands for "/".
//!
//! We read the cells of all pieces, in the order of their vertices that VTU files have, with the
//! fields on points and cells. A point on the border of two pieces is stored, and counted, twice.
//! Files of several steps are refused. Memory: a part of each array.

use crate::bytes::ByteSource;
use crate::cells::{
    BLOCK, CellBlock, CellField, CellFile, CellKind, CellMesh, CellStream, CellsInfo, Center, NumberStream,
};
use crate::error::{Error, Result};
use crate::formats::mesh::tet_arrays::{Array, Packed, TetMeta, block_rows, each_part};
use crate::formats::shared::OpenOptions;
use crate::formats::shared::format::{Format, Head};
use crate::formats::shared::hdf5_head::{Data, Dataset, Group};
use crate::formats::shared::sink::Sink;
use crate::formats::volume::hdf5;
use crate::formats::vtk::hdf::{self, Cells, HdfFile, Ids, active, array_name, components, count};
use crate::tets::StoredTets;
use crate::volume::ScalarType;
use std::path::Path;
use std::sync::Arc;

/// The arrays of the mesh, in the order of a file's tree; those of the fields follow.
const OF_MESH: [Array; 4] = [Array::Points, Array::Connectivity, Array::Offsets { first: 0 }, Array::Types];

/// Writes a mesh as VTKHDF.
pub(in crate::formats) fn write(mesh: &StoredTets, meta: &TetMeta<'_>, sink: &mut Sink<'_>) -> Result<()> {
    let arrays: Vec<Array> = OF_MESH.into_iter().chain((0..meta.fields.len()).map(Array::Values)).collect();
    let packed = meta.compress.map(|pool| Packed::of(mesh, meta, (pool, true), &arrays, sink)).transpose()?;
    sink.put(&tree(mesh, meta, &arrays, packed.as_ref()).head()?)?;
    for (n, array) in arrays.into_iter().enumerate() {
        match &packed {
            None => each_part(mesh, meta, array, &mut |bytes| sink.put(bytes))?,
            Some(packed) => packed.put(n, sink)?,
        }
    }
    Ok(())
}

fn tree(mesh: &StoredTets, meta: &TetMeta<'_>, arrays: &[Array], packed: Option<&Packed>) -> Group {
    let array = |n: usize, scalar: ScalarType| {
        let [rows, row_bytes] = arrays[n].size(mesh, meta);
        let shape = if n == 0 { &[rows, 3][..] } else { &[rows] };
        let data = match packed {
            // Fewer than 2^59 points and tetrahedra: no product overflows.
            None => Data::After(rows * row_bytes),
            Some(packed) => Data::Chunks {
                rows: block_rows(arrays[n], mesh, meta),
                packed: packed.blocks[n].iter().map(|block| block[1]).collect(),
            },
        };
        Dataset::of(scalar, shape, data)
    };
    let mut group = Group::default();
    group.add("NumberOfPoints", count(mesh.point_count()));
    group.add("NumberOfCells", count(mesh.tet_count()));
    group.add("NumberOfConnectivityIds", count(4 * mesh.tet_count()));
    group.add("Points", array(0, ScalarType::F64));
    group.add("Connectivity", array(1, ScalarType::I64));
    group.add("Offsets", array(2, ScalarType::I64));
    group.add("Types", array(3, ScalarType::U8));
    let (mut data, mut names) = (Group::default(), Vec::<String>::new());
    for (n, field) in meta.fields.iter().enumerate() {
        let others: Vec<&str> = names.iter().map(String::as_str).collect();
        let name = array_name(&field.name, &others);
        let scalar = if field.value_bytes() == 4 { ScalarType::F32 } else { ScalarType::F64 };
        let values = array(OF_MESH.len() + n, scalar);
        match n {
            0 => data.add(&name, active(values, "Scalars")),
            _ => data.add(&name, values),
        }
        names.push(name);
    }
    group.add_group("PointData", data);
    hdf::root("UnstructuredGrid", std::slice::from_ref(&meta.comment), group)
}

/// VTKHDF files of type UnstructuredGrid.
pub(in crate::formats) struct VtkHdf;

impl Format for VtkHdf {
    fn name(&self) -> &'static str {
        "a VTKHDF mesh"
    }

    fn suffixes(&self) -> &'static [&'static str] {
        &[".vtkhdf"]
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        let local = head.source().filter(|source| head.is_hdf5() && !source.is_remote());
        // What is wrong with a damaged file the reader of volumes tells.
        let kind = local.and_then(|source| hdf5::vtk_kind(source).ok().flatten());
        kind.as_deref() == Some("UnstructuredGrid")
    }

    fn is_mesh(&self, _: &Head<'_>) -> bool {
        true
    }

    fn mesh(&self, path: &Path, options: &OpenOptions) -> Result<CellMesh> {
        let source = Arc::new(ByteSource::open(path, options.io)?);
        CellMesh::new(Arc::new(open(&source)?), options.field.as_deref())
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
