//! VTKHDF: VTK's UnstructuredGrid in HDF5, written as one piece:
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

use super::arrays::{Packed, TetArray, TetMeta, block_rows, each_part};
use crate::tets::StoredTets;
use isospan_io::error::Result;
use isospan_io::formats::shared::hdf5_head::{Data, Dataset, Group};
use isospan_io::formats::shared::sink::Sink;
use isospan_io::formats::vtk::hdf::{self, active, array_name, count};
use isospan_io::volume::ScalarType;

/// The arrays of the mesh, in the order of a file's tree; those of the fields follow.
const OF_MESH: [TetArray; 4] =
    [TetArray::Points, TetArray::Connectivity, TetArray::Offsets { first: 0 }, TetArray::Types];

/// Writes a mesh as VTKHDF.
pub(super) fn write(mesh: &StoredTets, meta: &TetMeta<'_>, sink: &mut Sink<'_>) -> Result<()> {
    let arrays: Vec<TetArray> =
        OF_MESH.into_iter().chain((0..meta.fields.len()).map(TetArray::Values)).collect();
    let packed = meta.compress.map(|pool| Packed::of(mesh, meta, pool, true, &arrays, sink)).transpose()?;
    sink.put(&tree(mesh, meta, &arrays, packed.as_ref()).head()?)?;
    for (n, array) in arrays.into_iter().enumerate() {
        match &packed {
            None => each_part(mesh, meta, array, &mut |bytes| sink.put(bytes))?,
            Some(packed) => packed.put(n, sink)?,
        }
    }
    Ok(())
}

fn tree(mesh: &StoredTets, meta: &TetMeta<'_>, arrays: &[TetArray], packed: Option<&Packed>) -> Group {
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
