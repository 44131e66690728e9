//! VTKHDF: VTK's PolyData in HDF5.
//!
//! We write one piece of triangles. All lengths follow from the two counts, so the head is final
//! before the first vertex, and the arrays follow it as they are in memory.
//!
//! ```text
//! /comments                                       lines of text, units among them
//! /VTKHDF                                         Type PolyData
//!   NumberOfPoints
//!   Points                                        3 × f32 a vertex (f64 where f32 does not tell them apart)
//!   PointData/Normals                             3 × f32 a vertex
//!   PointData/isovalue                            f32 a vertex    (f64 where one has more digits; label i32) of several surfaces in one file only
//!   PointData/FIELD                               f32 a vertex    of a surface with values
//!   Polygons/NumberOfCells, NumberOfConnectivityIds
//!   Polygons/Connectivity                         3 × i64 a triangle
//!   Polygons/Offsets                              i64: 0, and 3, 6, 9, …
//!   Vertices, Lines, Strips                       the same, without a cell
//!   FieldData/isovalue                            f64: the isovalue of one surface
//!   FieldData/TimeValue                           f64: the time, where there is one
//! ```
//!
//! Normals and scalars are active, as in VTP files. In the name of a field "_" stands for "/", and
//! follows a name that is taken.
//!
//! We read the polygons of all pieces, with the points (and the active point normals, or those of
//! the name `Normals`) of any floating-point type. Vertices and lines are no surface and are
//! skipped; triangle strips, and files of several steps, are refused.

use super::{
    Fan, SurfaceMeta, TIME_VALUE, coordinate_bytes, each_triangle, each_value, each_vertex, is_finite,
    put_floats, put_place, take_line,
};
use crate::surface::SurfaceSource;
use crate::surface::weld::StoredSurface;
use isospan_io::bytes::ByteSource;
use isospan_io::error::{Error, Result};
use isospan_io::formats::shared::hdf5_head::{Dataset, Group, Value};
use isospan_io::formats::shared::sink::Sink;
use isospan_io::formats::volume::hdf5;
use isospan_io::formats::vtk::hdf::{self, HdfFile, active, array_name, count};
use isospan_io::volume::ScalarType;
use std::sync::Arc;

/// Writes a surface as VTKHDF.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    meta: &SurfaceMeta,
) -> Result<()> {
    // In the order of the tree.
    sink.put(&tree(source, meta).head()?)?;
    let origin = source.origin();
    each_vertex(source, sink, |buffer, _, v| put_place(buffer, v, origin))?;
    each_vertex(source, sink, |buffer, _, v| put_floats(buffer, v.normal))?;
    if !meta.parts.is_empty() {
        let put_isovalue = meta.put_isovalue();
        each_vertex(source, sink, |buffer, v, _| put_isovalue(v, buffer))?;
    }
    if let Some(values) = &meta.values {
        each_value(source, sink, values, |buffer, v| values.put(v, buffer))?;
    }
    each_triangle(source, sink, |buffer, _, t| {
        t.iter().for_each(|&v| buffer.extend_from_slice(&u64::from(v).to_le_bytes()));
        Ok(())
    })?;
    sink.put(&[0; 8])?;
    each_triangle(source, sink, |buffer, n, _| {
        buffer.extend_from_slice(&(3 * (n + 1)).to_le_bytes());
        Ok(())
    })
}

fn tree(source: &dyn SurfaceSource, meta: &SurfaceMeta) -> Group {
    // At most 2³² vertices and far fewer than 2⁵⁸ triangles: no product overflows.
    let (vertices, triangles) = (source.vertex_count(), source.triangle_count());
    let mut group = Group::default();
    group.add("NumberOfPoints", count(vertices));
    let coordinate = if coordinate_bytes(source) == 4 { ScalarType::F32 } else { ScalarType::F64 };
    group.add("Points", Dataset::after(coordinate, &[vertices, 3]));
    let mut data = Group::default();
    data.add("Normals", active(Dataset::after(ScalarType::F32, &[vertices, 3]), "Normals"));
    let values = meta.values.as_deref();
    if !meta.parts.is_empty() {
        let isovalues = Dataset::after(meta.part_scalar(), &[vertices]);
        data.add(meta.part_array(), if values.is_some() { isovalues } else { active(isovalues, "Scalars") });
    }
    if let Some(values) = values {
        let others = ["Normals", meta.part_array()];
        let name = array_name(values.name(), &others[..1 + usize::from(!meta.parts.is_empty())]);
        let scalar = if values.bytes() == 4 { ScalarType::F32 } else { ScalarType::F64 };
        data.add(&name, active(Dataset::after(scalar, &[vertices]), "Scalars"));
    }
    group.add_group("PointData", data);
    let cells = |cells: u64, connectivity: Dataset, offsets: Dataset| {
        let mut group = Group::default();
        group.add("NumberOfCells", count(cells));
        group.add("NumberOfConnectivityIds", count(3 * cells));
        group.add("Connectivity", connectivity);
        group.add("Offsets", offsets);
        group
    };
    let connectivity = Dataset::after(ScalarType::I64, &[3 * triangles]);
    let offsets = Dataset::after(ScalarType::I64, &[triangles + 1]);
    group.add_group("Polygons", cells(triangles, connectivity, offsets));
    for none in ["Vertices", "Lines", "Strips"] {
        group.add_group(none, cells(0, Value::integers(&[]).into(), count(0).into()));
    }
    if let Some(data) = field_data(meta) {
        group.add_group("FieldData", data);
    }
    hdf::root("PolyData", &meta.lines(), group)
}

/// Arrays of the whole data set: the isovalue of one surface and the time. VTK reads no texts of a
/// fixed length, so units are in the comments.
pub(super) fn field_numbers(meta: &SurfaceMeta) -> Vec<(&'static str, f64)> {
    let numbers = [("isovalue", meta.isovalue), (TIME_VALUE, meta.time)];
    numbers.into_iter().filter_map(|(name, n)| Some((name, n?))).collect()
}

/// The group of these arrays, where there are any.
pub(super) fn field_data(meta: &SurfaceMeta) -> Option<Group> {
    let (mut data, numbers) = (Group::default(), field_numbers(meta));
    numbers.iter().for_each(|&(name, n)| data.add(name, Value::floats(&[n])));
    (!numbers.is_empty()).then_some(data)
}

/// Vertices that are read at one time.
const BATCH: u64 = 1 << 14;

/// Reads a VTKHDF surface. No more than a part of each array is in memory.
pub(in crate::files) fn read(source: &Arc<ByteSource>, out: &mut StoredSurface) -> Result<()> {
    let kind = hdf5::vtk_kind(source)?;
    if kind.as_deref() != Some("PolyData") {
        let got = kind.map_or("another HDF5 file".into(), |kind| format!("a VTKHDF file of type '{kind}'"));
        let expected = "a VTKHDF surface, of type 'PolyData'";
        return Err(Error::bad_input(source.path(), "kind of HDF5 file", expected, got)
            .with_help("of volumes and meshes, isospan info tells what is in them"));
    }
    let file = HdfFile::new(source.path(), hdf5::arrays(source, 2)?)?;
    if file.has_cells("Strips")? {
        let error = file.wrong("Strips", "polygons", "triangle strips");
        return Err(error.with_help("convert strips to triangles first"));
    }
    read_field_data(&file, out)?;
    read_points(&file, out)?;
    if !file.has_cells("Polygons")? {
        return Ok(());
    }
    let mut cells = file.cells("Polygons/")?;
    while let Some(corners) = cells.next_cell()? {
        if corners < 3 {
            let got = format!("one of {corners}");
            return Err(file.wrong("Polygons/Offsets", "polygons of at least 3 points", got));
        }
        let mut fan = Fan::default();
        for _ in 0..corners {
            let vertex = cells.next_vertex()?;
            let number = u32::try_from(vertex).map_err(|_| {
                file.wrong("Points", "at most 2^32 points of a surface", file.point_count().to_string())
            })?;
            fan.corner(number).map_or(Ok(()), |triangle| out.push_triangle(triangle))?;
        }
    }
    Ok(())
}

/// Units and the time.
fn read_field_data(file: &HdfFile, out: &mut StoredSurface) -> Result<()> {
    file.comments()?.iter().for_each(|line| take_line(out, line));
    let time = format!("FieldData/{TIME_VALUE}");
    if file.array(&time)?.is_some_and(|array| array.shape == [1]) {
        let mut value = [0.0];
        file.numbers(&time)?.fill(&mut value)?;
        out.time = Some(value[0]);
    }
    Ok(())
}

fn read_points(file: &HdfFile, out: &mut StoredSurface) -> Result<()> {
    let count = file.point_count();
    let mut points = file.numbers("Points")?;
    let mut normals = normals(file)?.map(|name| file.numbers(&name)).transpose()?;
    let (mut done, mut positions, mut directions) = (0, vec![], vec![]);
    while done < count {
        let n = (count - done).min(BATCH) as usize;
        positions.resize(3 * n, 0.0);
        directions.resize(3 * n, 0.0);
        points.fill(&mut positions)?;
        if let Some(normals) = &mut normals {
            normals.fill(&mut directions)?;
        }
        for (position, normal) in positions.chunks_exact(3).zip(directions.chunks_exact(3)) {
            let [position, normal] = [position, normal].map(|v| [0, 1, 2].map(|a| v[a]));
            if !is_finite(&position.map(|c| c as f32)) {
                let got = format!("{position:?} for point {done}");
                return Err(file.wrong("Points", "finite coordinates", got));
            }
            out.push_double(position, normal.map(|n| n as f32))?;
            done += 1;
        }
    }
    points.finish()?;
    normals.map_or(Ok(()), |mut normals| normals.finish())
}

/// The active normals of the points; without a mark, those of VTK's usual name.
fn normals(file: &HdfFile) -> Result<Option<String>> {
    let names: Vec<String> =
        file.names_in("PointData").iter().map(|name| format!("PointData/{name}")).collect();
    let marked = names.iter().find(|name| file.is_active(name, "Normals"));
    let Some(name) = marked.or_else(|| names.iter().find(|name| *name == "PointData/Normals")) else {
        return Ok(None);
    };
    let shape = file.array(name)?.map(|array| array.shape);
    if shape != Some(vec![file.point_count(), 3]) {
        let expected = format!("3 numbers for each of {} points", file.point_count());
        return Err(file.wrong(name, expected, format!("{:?}", shape.unwrap_or_default())));
    }
    Ok(Some(name.clone()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::surface::tests::{in_memory, source, tetrahedron};
    use crate::files::surface::{SurfaceFormat, SurfacePart, write_surface};
    use crate::surface::{TriMesh, Vertex};
    use isospan_io::exec::Resources;
    use isospan_io::fixtures::survive;

    fn parse(bytes: &[u8]) -> Result<TriMesh> {
        in_memory(|out| read(&Arc::new(ByteSource::from_vec("f.vtkhdf", bytes.to_vec())), out))
    }

    fn written(parts: Vec<SurfacePart>) -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.vtkhdf");
        let comments = vec!["a\nbé".into()];
        let isovalue = parts.is_empty().then_some(-1.5);
        let meta = SurfaceMeta { isovalue, comments, parts, ..SurfaceMeta::default() };
        write_surface(&source(tetrahedron()), &path, SurfaceFormat::VtkHdf, &meta, &Resources::default())
            .unwrap();
        std::fs::read(path).unwrap()
    }

    #[cfg(feature = "hdf5")]
    #[test]
    fn what_we_write_is_where_the_head_says() {
        let part = |isovalue, vertices| SurfacePart { isovalue, vertices, triangles: 2, label: None };
        let bytes = written(vec![part(0.5, 3), part(1.0 / 3.0, 1)]);
        assert_eq!(parse(&bytes).unwrap(), tetrahedron());
        let file = hdf5_reader::Hdf5File::from_bytes(&bytes).unwrap();
        let floats =
            |name: &str| file.dataset(name).unwrap().read_array::<f64>().unwrap().into_raw_vec_and_offset().0;
        // The isovalue is there once.
        assert!(file.dataset("VTKHDF/FieldData/isovalue").is_err());
        // More digits than an f32 has.
        assert_eq!(floats("VTKHDF/PointData/isovalue"), [0.5, 0.5, 0.5, 1.0 / 3.0]);
        assert_eq!(
            file.dataset("comments").unwrap().read_strings().unwrap(),
            ["isovalue 0.5 0.3333333333333333", "a", "bé"]
        );
        let offsets = file.dataset("VTKHDF/Polygons/Offsets").unwrap().read_array::<i64>().unwrap();
        assert_eq!(offsets.into_raw_vec_and_offset().0, [0, 3, 6, 9, 12]);
        assert_eq!(file.superblock().eof_address, bytes.len() as u64);
    }

    /// A file of two pieces, a square and a triangle, with these arrays instead of good ones.
    #[cfg(feature = "hdf5")]
    fn two_pieces(instead: &[(&str, &[i64])]) -> Result<TriMesh> {
        let points = [
            [0.0f64, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 0.5],
            [5.0, 0.0, 0.0],
            [6.0, 0.0, 0.0],
            [6.0, 1.0, 0.25],
        ];
        let good: [(&str, &[i64]); 6] = [
            ("NumberOfPoints", &[4, 3]),
            ("Polygons/NumberOfCells", &[1, 1]),
            ("Polygons/NumberOfConnectivityIds", &[4, 3]),
            ("Polygons/Connectivity", &[0, 1, 2, 3, 2, 0, 1]),
            ("Polygons/Offsets", &[0, 4, 0, 3]),
            ("Strips/NumberOfCells", &[0, 0]),
        ];
        let [mut group, mut polygons, mut strips, mut data, mut steps] =
            std::array::from_fn(|_| Group::default());
        let here = |numbers: Vec<f64>| {
            let bytes = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
            let shape = [numbers.len() as u64 / 3, 3];
            Dataset::of(ScalarType::F64, &shape, isospan_io::formats::shared::hdf5_head::Data::Here(bytes))
        };
        group.add("Points", here(points.concat()));
        data.add("Up", active(here([0.0, 0.0, 1.0].repeat(7)), "Normals"));
        data.add("Normals", here([1.0, 0.0, 0.0].repeat(7)));
        let new = instead.iter().filter(|(name, _)| good.iter().all(|(n, _)| n != name));
        for (name, list) in good.iter().chain(new) {
            let list = instead.iter().find(|(n, _)| n == name).map_or(*list, |(_, list)| *list);
            let (to, name) = match name.split_once('/') {
                Some(("Polygons", name)) => (&mut polygons, name),
                Some(("Strips", name)) => (&mut strips, name),
                Some((_, name)) => (&mut steps, name),
                None => (&mut group, *name),
            };
            to.add(name, Value::integers(list));
        }
        let groups = [("Polygons", polygons), ("Strips", strips), ("PointData", data), ("Steps", steps)];
        groups.into_iter().for_each(|(name, below)| group.add_group(name, below));
        parse(&hdf::root("PolyData", &[], group).head()?)
    }

    #[cfg(feature = "hdf5")]
    #[test]
    fn pieces_are_read_and_malformed_ones_refused() {
        let mesh = two_pieces(&[]).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [6, 4, 5]]);
        assert_eq!(mesh.vertices[6], Vertex { position: [6.0, 1.0, 0.25], normal: [0.0, 0.0, 1.0] });
        for (name, list, says) in [
            ("NumberOfPoints", &[4, 4][..], "/VTKHDF/Points: expected numbers [8, 3], got [7, 3]"),
            ("Polygons/Connectivity", &[0, 1, 2, 3, 2, 0, 3], "expected points below 3, got 3"),
            ("Polygons/Connectivity", &[0, 1, 2, 3], "expected numbers [7], got [4]"),
            ("Polygons/Offsets", &[0, 3, 0, 3], "expected 4 at the end of a piece"),
            ("Strips/NumberOfCells", &[0, 1], "triangle strips"),
            ("Steps/Values", &[0, 1], "one step"),
        ] {
            let error = two_pieces(&[(name, list)]).unwrap_err().to_string();
            assert!(error.contains(says), "{says}: {error}");
        }
        let flat: [(&str, &[i64]); 4] = [
            ("Polygons/NumberOfCells", &[1, 2]),
            ("Polygons/NumberOfConnectivityIds", &[4, 5]),
            ("Polygons/Connectivity", &[0, 1, 2, 3, 2, 0, 1, 0, 1]),
            ("Polygons/Offsets", &[0, 4, 0, 3, 5]),
        ];
        assert!(two_pieces(&flat).unwrap_err().to_string().contains("at least 3 points, got one of 2"));
        let other = isospan_io::formats::vtk::hdf::root("ImageData", &[], Group::default()).head().unwrap();
        assert!(parse(&other).unwrap_err().to_string().contains("a VTKHDF file of type 'ImageData'"));
    }

    #[test]
    fn damage_does_not_panic() {
        survive(&written(vec![]), |b| drop(parse(b)));
    }
}
