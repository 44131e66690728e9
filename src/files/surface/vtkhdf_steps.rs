//! VTKHDF of several steps: VTK's PolyData in HDF5, with a group `Steps`.
//!
//! ```text
//! /VTKHDF                                         as of one step, the arrays of all steps one after another;
//!                                                 NumberOf… have an entry, Offsets begin at 0, for each
//!   Steps                                         NSteps
//!     Values                                      f64: the times
//!     PartOffsets, NumberOfParts                  i64 a step: its number, and 1
//!     PointOffsets                                i64 a step: points before
//!     CellOffsets, ConnectivityIdOffsets          i64 a step for each of Vertices, Lines, Polygons, Strips
//!     PointDataOffsets/NAME                       i64 a step, as PointOffsets
//!     FieldDataOffsets/NAME                       i64 a step: 0, as one number is that of all steps
//!     FieldDataSizes/NAME                         i64 a step for components and tuples: 1, 1
//! ```
//!
//! The format: "VTKHDF File Format", temporal data, docs.vtk.org.

use super::vtkhdf::{field_data, field_numbers};
use super::{SurfaceMeta, coordinate_bytes, each_triangle, each_vertex, put_floats, put_place};
use crate::surface::SurfaceSource;
use isospan_io::error::Result;
use isospan_io::formats::shared::hdf5_head::{Data, Dataset, Group, Value};
use isospan_io::formats::shared::sink::Sink;
use isospan_io::formats::vtk::hdf::{self, active};
use isospan_io::volume::ScalarType;
use std::path::Path;

/// The surface of a step, among those that follow each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceStep {
    /// The time.
    pub time: f64,
    /// Its vertices.
    pub vertices: u64,
    /// Its triangles, whose vertices are counted from the first one of the step.
    pub triangles: u64,
}

/// Numbers that are written at a time.
const AT_A_TIME: u64 = 1 << 14;

/// Writes the surfaces of several steps to one file, and returns its bytes. The source has the
/// vertices of all steps, then their triangles; the parts of `meta` are those of all steps, too.
///
/// # Errors
/// As [`write_surface`](super::write_surface).
pub fn write_surface_steps(
    source: &dyn SurfaceSource,
    steps: &[SurfaceStep],
    path: &Path,
    meta: &SurfaceMeta,
) -> Result<u64> {
    let mut sink = Sink::create(path)?;
    // In the order of the tree.
    sink.put(&tree(source, steps, meta).head()?)?;
    let origin = source.origin();
    each_vertex(source, &mut sink, |buffer, _, v| put_place(buffer, v, origin))?;
    each_vertex(source, &mut sink, |buffer, _, v| put_floats(buffer, v.normal))?;
    if !meta.parts.is_empty() {
        let put_isovalue = meta.put_isovalue();
        each_vertex(source, &mut sink, |buffer, v, _| put_isovalue(v, buffer))?;
    }
    each_triangle(source, &mut sink, |buffer, _, t| {
        t.iter().for_each(|&v| buffer.extend_from_slice(&u64::from(v).to_le_bytes()));
        Ok(())
    })?;
    for step in steps {
        put_offsets(step.triangles, &mut sink)?;
    }
    sink.publish()
}

/// Where the triangles of a step begin, and the end of the last one.
fn put_offsets(triangles: u64, sink: &mut Sink<'_>) -> Result<()> {
    let (mut next, mut buffer) = (0, vec![]);
    while next <= triangles {
        let end = (next + AT_A_TIME).min(triangles + 1);
        buffer.clear();
        (next..end).for_each(|n| buffer.extend_from_slice(&(3 * n).to_le_bytes()));
        sink.put(&buffer)?;
        next = end;
    }
    Ok(())
}

/// Integers, so many to a row.
fn integers(list: &[i64], columns: u64) -> Dataset {
    let bytes = list.iter().flat_map(|n| n.to_le_bytes()).collect();
    let rows = list.len() as u64 / columns;
    let shape = if columns == 1 { vec![rows] } else { vec![rows, columns] };
    Dataset::of(ScalarType::I64, &shape, Data::Here(bytes))
}

/// The sums of all before each.
fn before(counts: impl Iterator<Item = u64>) -> Vec<i64> {
    let mut sum = 0;
    let place = |n: u64| {
        let at = sum;
        sum += n as i64;
        at
    };
    counts.map(place).collect()
}

fn tree(source: &dyn SurfaceSource, steps: &[SurfaceStep], meta: &SurfaceMeta) -> Group {
    let (vertices, triangles) = (source.vertex_count(), source.triangle_count());
    let list = |of: fn(&SurfaceStep) -> u64| -> Vec<i64> { steps.iter().map(|s| of(s) as i64).collect() };
    let zeros = || vec![0; steps.len()];
    let mut group = Group::default();
    group.add("NumberOfPoints", integers(&list(|s| s.vertices), 1));
    let coordinate = if coordinate_bytes(source) == 4 { ScalarType::F32 } else { ScalarType::F64 };
    group.add("Points", Dataset::after(coordinate, &[vertices, 3]));
    let mut data = Group::default();
    data.add("Normals", active(Dataset::after(ScalarType::F32, &[vertices, 3]), "Normals"));
    if !meta.parts.is_empty() {
        let parts = Dataset::after(meta.part_scalar(), &[vertices]);
        data.add(meta.part_array(), active(parts, "Scalars"));
    }
    group.add_group("PointData", data);
    let mut polygons = Group::default();
    polygons.add("NumberOfCells", integers(&list(|s| s.triangles), 1));
    polygons.add("NumberOfConnectivityIds", integers(&list(|s| 3 * s.triangles), 1));
    polygons.add("Connectivity", Dataset::after(ScalarType::I64, &[3 * triangles]));
    polygons.add("Offsets", Dataset::after(ScalarType::I64, &[triangles + steps.len() as u64]));
    group.add_group("Polygons", polygons);
    for none in ["Vertices", "Lines", "Strips"] {
        let mut cells = Group::default();
        cells.add("NumberOfCells", integers(&zeros(), 1));
        cells.add("NumberOfConnectivityIds", integers(&zeros(), 1));
        cells.add("Connectivity", Value::integers(&[]));
        cells.add("Offsets", integers(&zeros(), 1));
        group.add_group(none, cells);
    }
    if let Some(data) = field_data(meta) {
        group.add_group("FieldData", data);
    }
    group.add_group("Steps", steps_of(steps, meta));
    hdf::root("PolyData", &meta.lines(), group)
}

/// Where each step begins.
fn steps_of(steps: &[SurfaceStep], meta: &SurfaceMeta) -> Group {
    let [points, triangles] = [|s: &SurfaceStep| s.vertices, |s: &SurfaceStep| s.triangles];
    let points = before(steps.iter().map(points));
    let triangles = before(steps.iter().map(triangles));
    // Vertices, lines, polygons, strips.
    let of_cells =
        |corners: i64| -> Vec<i64> { triangles.iter().flat_map(|n| [0, 0, corners * n, 0]).collect() };
    let mut group = hdf::steps(steps.len() as u64);
    group.add("Values", Value::floats(&steps.iter().map(|s| s.time).collect::<Vec<_>>()));
    group.add("PartOffsets", integers(&(0..steps.len() as i64).collect::<Vec<_>>(), 1));
    group.add("NumberOfParts", integers(&vec![1; steps.len()], 1));
    group.add("PointOffsets", integers(&points, 1));
    group.add("CellOffsets", integers(&of_cells(1), 4));
    group.add("ConnectivityIdOffsets", integers(&of_cells(3), 4));
    let mut data = Group::default();
    data.add("Normals", integers(&points, 1));
    if !meta.parts.is_empty() {
        data.add(meta.part_array(), integers(&points, 1));
    }
    group.add_group("PointDataOffsets", data);
    // Without these, VTK reads no field data of a step.
    let numbers = field_numbers(meta);
    if !numbers.is_empty() {
        let (mut offsets, mut sizes) = (Group::default(), Group::default());
        for (name, _) in numbers {
            offsets.add(name, integers(&vec![0; steps.len()], 1));
            sizes.add(name, integers(&vec![1; 2 * steps.len()], 2));
        }
        group.add_group("FieldDataOffsets", offsets);
        group.add_group("FieldDataSizes", sizes);
    }
    group
}

#[cfg(all(test, feature = "hdf5"))]
mod tests {
    use super::*;
    use crate::files::surface::tests::{source, tetrahedron};
    use crate::surface::TriMesh;

    #[test]
    fn steps_follow_each_other() {
        // Two tetrahedra, each counted from its own first vertex, and a step without a surface.
        let one = tetrahedron();
        let mesh = TriMesh::new(
            [one.vertices.clone(), one.vertices.clone()].concat(),
            [one.triangles.clone(), one.triangles].concat(),
        );
        let step = |time, vertices, triangles| SurfaceStep { time, vertices, triangles };
        let steps = [step(0.0, 4, 4), step(0.5, 0, 0), step(2.0, 4, 4)];
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.vtkhdf");
        let meta = SurfaceMeta { isovalue: Some(7.0), ..SurfaceMeta::default() };
        let bytes = write_surface_steps(&source(mesh), &steps, &path, &meta).unwrap();
        let file = hdf5_reader::Hdf5File::from_bytes(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(file.superblock().eof_address, bytes);
        let list = |name: &str| {
            let array = file.dataset(&format!("VTKHDF/{name}")).unwrap().read_array::<i64>().unwrap();
            array.into_raw_vec_and_offset().0
        };
        assert_eq!(list("NumberOfPoints"), [4, 0, 4]);
        assert_eq!(list("Polygons/Offsets"), [0, 3, 6, 9, 12, 0, 0, 3, 6, 9, 12]);
        assert_eq!(list("Steps/PointOffsets"), [0, 4, 4]);
        assert_eq!(list("Steps/CellOffsets"), [0, 0, 0, 0, 0, 0, 4, 0, 0, 0, 4, 0]);
        assert_eq!(list("Steps/ConnectivityIdOffsets"), [0, 0, 0, 0, 0, 0, 12, 0, 0, 0, 12, 0]);
        assert_eq!(list("Steps/FieldDataOffsets/isovalue"), [0; 3]);
        assert_eq!(list("Steps/FieldDataSizes/isovalue"), [1; 6]);
    }
}
