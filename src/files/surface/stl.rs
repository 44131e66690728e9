//! STL, the stereolithography format of 3D Systems (1989).
//!
//! A file has only triangles, each with its three positions, so shared vertices are repeated. The
//! reader merges vertices of equal bits (-0 being 0). This restores exactly the sharing of a
//! surface whose vertices are distinct in `f32`. The reader sorts three times, so that the surface
//! need not fit in memory:
//!
//! ```text
//! corners by position           equal ones lie together: each learns the first corner at its place
//! by first corner, then corner  a new first corner is the next vertex
//! by corner                     three vertex numbers are a triangle
//! ```
//!
//! ```text
//! 0   80 bytes of comment, not beginning with "solid"
//! 80  u32 number of triangles, little-endian
//! 84  a record of 50 bytes for each: normal 3 × f32, three positions 3 × f32 each, u16 attribute (0)
//! ```
//!
//! The text form has `facet normal`, `outer loop`, three `vertex x y z`, `endloop`, `endfacet` for
//! each triangle, between `solid NAME` and `endsolid`. Many binary files begin with "solid", so a
//! file whose length agrees with the count at byte 80 is binary. The normals of a file are not
//! read: they follow from the positions.

use super::{ReadLimits, SurfaceMeta, ascii, each_triangle, is_finite, origin_line, put_floats, take_line};
use crate::surface::weld::{BuilderSettings, StoredSurface};
use crate::surface::{SurfaceSource, Vertex, nearby_origin, relative_to};
use byteorder::{ByteOrder, LE};
use isospan_io::bytes::sorter::Sorter;
use isospan_io::bytes::store::{Cached, Store};
use isospan_io::bytes::{ByteSource, IoMode};
use isospan_io::error::{Error, Result};
use isospan_io::formats::shared::sink::Sink;
use isospan_io::formats::shared::text::Words;
use std::fs::File;
use std::io::Write;
use std::path::Path;

const HEADER: usize = 80;
const RECORD: usize = 50;

/// The count is 32 bits wide.
pub(in crate::files) fn check_limits(triangles: u64) -> Result<()> {
    if u32::try_from(triangles).is_err() {
        return Err(Error::usage(format!(
            "an STL file holds at most {} triangles, this surface has {triangles}; write PLY or VTP instead",
            u32::MAX
        )));
    }
    Ok(())
}

/// Writes a surface as binary STL. Triangles name vertices in any order, so the positions go to a
/// mapped scratch file first (12 bytes each): memory stays that of a buffer. Where there is no file
/// they are stored within the memory of `scratch`, and beyond it in its folder.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    meta: &SurfaceMeta,
    scratch: &BuilderSettings,
) -> Result<()> {
    let head = |sink: &mut Sink<'_>| {
        sink.put(&header(origin_line(source), meta))?;
        sink.put(&(source.triangle_count() as u32).to_le_bytes())
    };
    if let Some(file) = sink.scratch()? {
        let positions = Positions::store(source, sink, file)?;
        head(sink)?;
        return each_triangle(source, sink, |buffer, _, t| {
            let corners = [positions.at(t[0])?, positions.at(t[1])?, positions.at(t[2])?];
            buffer.extend_from_slice(&record(corners));
            Ok(())
        });
    }
    let mut positions = Store::new(scratch.memory_bytes, &scratch.scratch);
    source.vertices(&mut |batch| batch.iter().try_for_each(|v| positions.push(v.position)))?;
    check_count(positions.len(), source, sink)?;
    let mut positions = Cached::new(&positions, CACHE);
    head(sink)?;
    each_triangle(source, sink, |buffer, _, t| {
        let [a, b, c] = t.map(u64::from);
        let corners = [positions.get(a)?, positions.get(b)?, positions.get(c)?];
        buffer.extend_from_slice(&record(corners));
        Ok(())
    })
}

/// Bytes of positions that are kept of those on disk.
const CACHE: usize = 1 << 20;

fn check_count(count: u64, source: &dyn SurfaceSource, sink: &Sink<'_>) -> Result<()> {
    let announced = source.vertex_count();
    if count == announced {
        return Ok(());
    }
    Err(sink.broken_source(format!("{count} vertices instead of the {announced} announced")))
}

/// The comment: as many whole lines of it as there is limits for.
fn header(origin: Option<String>, meta: &SurfaceMeta) -> [u8; HEADER] {
    // There is little room, and nowhere else for the origin.
    let mut text = String::from(if origin.is_some() { "binary STL" } else { "binary STL, isospan surface" });
    for line in origin.into_iter().chain(meta.lines()) {
        text += ", ";
        text += &ascii(&line);
    }
    let mut out = [b' '; HEADER];
    let n = text.len().min(HEADER);
    out[..n].copy_from_slice(&text.as_bytes()[..n]);
    out
}

fn record(corners: [[f32; 3]; 3]) -> [u8; RECORD] {
    let mut out = [0; RECORD];
    let [a, b, c] = corners;
    LE::write_f32_into([normal(corners), a, b, c].as_flattened(), &mut out[..48]);
    out
}

/// The unit normal of a triangle by the right-hand rule; zero for a triangle without area.
fn normal(corners: [[f32; 3]; 3]) -> [f32; 3] {
    let [a, b, c] = corners.map(|p| glam::DVec3::from_array(p.map(f64::from)));
    (b - a).cross(c - a).normalize_or_zero().to_array().map(|x| x as f32)
}

/// The positions of all vertices, in a scratch file.
struct Positions {
    /// `None` for a surface without vertices: an empty file cannot be mapped.
    mapped: Option<ByteSource>,
}

impl Positions {
    fn store(source: &dyn SurfaceSource, sink: &Sink<'_>, file: File) -> Result<Self> {
        let target = sink.target().to_path_buf();
        let fail = |e| Error::io("write a scratch file beside", &target, e);
        let (mut buffer, mut out, mut count) = (vec![], &file, 0);
        source.vertices(&mut |batch| {
            count += batch.len() as u64;
            buffer.clear();
            batch.iter().for_each(|v| put_floats(&mut buffer, v.position));
            out.write_all(&buffer).map_err(fail)
        })?;
        check_count(count, source, sink)?;
        let any = source.vertex_count() > 0;
        let mapped = any.then(|| ByteSource::of_file(&target, file, IoMode::Map)).transpose()?;
        Ok(Self { mapped })
    }

    /// The position of a vertex that is known to exist.
    fn at(&self, vertex: u32) -> Result<[f32; 3]> {
        let mapped = self.mapped.as_ref().expect("each_triangle hands only vertices that exist");
        let start = u64::from(vertex) * 12;
        Ok(position(mapped.slice(start..start + 12)?))
    }
}

/// Three little-endian numbers.
fn position(bytes: &[u8]) -> [f32; 3] {
    let mut position = [0.0; 3];
    LE::read_f32_into(&bytes[..12], &mut position);
    position
}

/// The number of triangles that is stored at byte 80.
fn count(bytes: &[u8]) -> Option<u64> {
    bytes.get(HEADER..HEADER + 4).map(|field| LE::read_u32(field).into())
}

/// Whether the length agrees with the count of a binary file.
pub(in crate::files) fn is_binary(bytes: &[u8]) -> bool {
    count(bytes).is_some_and(|n| bytes.len() as u64 == (HEADER + 4) as u64 + n * RECORD as u64)
}

/// Reads an STL surface, binary or text.
pub(in crate::files) fn read(
    path: &Path,
    bytes: &[u8],
    limits: &ReadLimits,
    out: &mut StoredSurface,
) -> Result<()> {
    if !is_binary(bytes) {
        if bytes.trim_ascii_start().starts_with(b"solid") {
            return read_text(path, bytes, limits, out);
        }
        let expected = match count(bytes) {
            Some(n) => format!("{} bytes for {n} triangles", 84 + n * RECORD as u64),
            None => "at least 84 bytes".to_string(),
        };
        return Err(Error::bad_input(path, "binary STL", expected, format!("{} bytes", bytes.len()))
            .with_help("the file is cut short, or it is no STL file"));
    }
    // What was cut off is no line.
    let header = String::from_utf8_lossy(&bytes[..HEADER]);
    let mut lines: Vec<&str> = header.split(", ").collect();
    if !header.ends_with(' ') {
        lines.pop();
    }
    lines.iter().for_each(|line| take_line(out, line));
    let mut build = Build::new(path, limits);
    for (n, record) in bytes[HEADER + 4..].chunks_exact(RECORD).enumerate() {
        let corners = [12, 24, 36].map(|at| position(&record[at..]));
        build.push(corners, || format!("triangle {n}"))?;
    }
    build.finish(out)
}

/// Reads a text twice: decimals that are far from 0 have digits that only doubles hold.
fn read_text(path: &Path, bytes: &[u8], limits: &ReadLimits, out: &mut StoredSurface) -> Result<()> {
    let mut ends = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    each_facet(path, bytes, &mut |corners, _| {
        for (k, x) in corners.iter().flat_map(|corner| (0..3).map(|k| (k, corner[k]))) {
            (ends[0][k], ends[1][k]) = (ends[0][k].min(x), ends[1][k].max(x));
        }
        Ok(())
    })?;
    let origin = nearby_origin(ends, [0.0; 3]);
    let mut build = Build::new(path, limits);
    each_facet(path, bytes, &mut |corners, words| {
        build.push(corners.map(|corner| relative_to(corner, origin)), || words.place())
    })?;
    out.count_from(origin);
    build.finish(out)
}

/// Takes the corners of a facet, and the words after it.
type EachFacet<'a> = dyn FnMut([[f64; 3]; 3], &Words<'_>) -> Result<()> + 'a;

/// Hands the corners of each facet of a text, and the place after it.
fn each_facet(path: &Path, bytes: &[u8], each: &mut EachFacet<'_>) -> Result<()> {
    let mut words = Words::new(path, bytes, 0);
    // The name of a solid is the rest of its line, and any text.
    while let Some(first) = words.next() {
        if first != b"solid" {
            return Err(words.wrong("'solid' or the end of the file", String::from_utf8_lossy(first)));
        }
        words.line();
        while facet_or_end(&mut words)? {
            let corners = read_facet(&mut words)?;
            each(corners, &words)?;
        }
    }
    Ok(())
}

/// Whether a facet follows; otherwise the solid has ended.
fn facet_or_end(words: &mut Words<'_>) -> Result<bool> {
    match words.word("'facet' or 'endsolid'")? {
        "facet" => Ok(true),
        "endsolid" => {
            words.line();
            Ok(false)
        }
        other => Err(words.wrong("'facet' or 'endsolid'", format!("'{other}'"))),
    }
}

/// A facet after its first word.
fn read_facet(words: &mut Words<'_>) -> Result<[[f64; 3]; 3]> {
    expect(words, "normal")?;
    for _ in 0..3 {
        words.parse::<f32>("a number of the facet's normal")?;
    }
    expect(words, "outer")?;
    expect(words, "loop")?;
    let mut corners = [[0.0; 3]; 3];
    for corner in &mut corners {
        expect(words, "vertex")?;
        for c in corner.iter_mut() {
            *c = words.parse("a coordinate")?;
        }
    }
    expect(words, "endloop")?;
    expect(words, "endfacet")?;
    Ok(corners)
}

fn expect(words: &mut Words<'_>, word: &str) -> Result<()> {
    let quoted = format!("'{word}'");
    match words.word(&quoted)? {
        found if found == word => Ok(()),
        found => Err(words.wrong(quoted, format!("'{found}'"))),
    }
}

/// A 64-bit number in the words of a record to be sorted: the high one first.
fn words(n: u64) -> [u32; 2] {
    [(n >> 32) as u32, n as u32]
}

fn number(words: [u32; 2]) -> u64 {
    u64::from(words[0]) << 32 | u64::from(words[1])
}

/// Joins equal corners to vertices, numbered by first appearance.
struct Build<'a> {
    path: &'a Path,
    limits: &'a ReadLimits,
    /// Corners so far.
    corners: u64,
    /// (bits of the position, corner).
    by_position: Sorter<[u32; 5]>,
}

impl<'a> Build<'a> {
    fn new(path: &'a Path, limits: &'a ReadLimits) -> Self {
        // At most two sorters are at work at a time.
        Self { path, limits, corners: 0, by_position: limits.sorter(2) }
    }

    fn push(&mut self, corners: [[f32; 3]; 3], at: impl Fn() -> String) -> Result<()> {
        for corner in corners {
            if !is_finite(&corner) {
                return Err(Error::bad_input(self.path, at(), "finite coordinates", format!("{corner:?}")));
            }
            // -0 + 0 = 0: both zeros get the same bits.
            let [x, y, z] = corner.map(|c| (c + 0.0).to_bits());
            let [high, low] = words(self.corners);
            self.by_position.push([x, y, z, high, low])?;
            self.corners += 1;
        }
        Ok(())
    }

    fn finish(self, out: &mut StoredSurface) -> Result<()> {
        let mut by_first: Sorter<[u32; 7]> = self.limits.sorter(2);
        let (mut corners, mut place, mut first) = (self.by_position.finish()?, None, [0; 2]);
        while let Some([x, y, z, high, low]) = corners.next()? {
            if place != Some([x, y, z]) {
                (place, first) = (Some([x, y, z]), [high, low]);
            }
            by_first.push([first[0], first[1], high, low, x, y, z])?;
        }
        drop(corners);
        let mut by_corner: Sorter<[u32; 3]> = self.limits.sorter(2);
        let mut corners = by_first.finish()?;
        while let Some([first_high, first_low, high, low, position @ ..]) = corners.next()? {
            if [first_high, first_low] == [high, low] {
                let vertex = Vertex { position: position.map(f32::from_bits), normal: [0.0; 3] };
                out.push_vertex(vertex)?;
            }
            let last = u32::try_from(out.vertex_count() - 1).map_err(|_| {
                let at = format!("triangle {}", number([high, low]) / 3);
                Error::bad_input(self.path, at, "at most 2^32 different vertices", "more of them")
            })?;
            by_corner.push([high, low, last])?;
        }
        drop(corners);
        let mut corners = by_corner.finish()?;
        while let Some([.., a]) = corners.next()? {
            let others = [corners.next()?, corners.next()?];
            let [b, c] = others.map(|corner| corner.expect("corners are pushed three at a time")[2]);
            out.push_triangle([a, b, c])?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::surface::tests::{in_memory, rooms, source, tetrahedron};
    use crate::files::surface::{SurfaceFormat, write_surface};
    use crate::surface::TriMesh;
    use isospan_io::exec::Resources;
    use isospan_io::fixtures::survive;

    fn parse(bytes: &[u8]) -> Result<TriMesh> {
        let [wide, narrow] =
            rooms().map(|limits| in_memory(|out| read(Path::new("f.stl"), bytes, &limits, out)));
        assert_eq!(format!("{wide:?}"), format!("{narrow:?}"), "on disk as in memory");
        wide
    }

    fn written(mesh: TriMesh) -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.stl");
        let meta =
            SurfaceMeta { isovalue: Some(1.5), comments: vec!["é".repeat(80)], ..SurfaceMeta::default() };
        write_surface(&source(mesh), &path, SurfaceFormat::Stl, &meta, &Resources::default()).unwrap();
        std::fs::read(path).unwrap()
    }

    fn flat() -> TriMesh {
        let mut mesh = tetrahedron();
        let corners = [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 3.0, 1.0], [4.0, 0.0, 1.0]];
        for (v, position) in mesh.vertices.iter_mut().zip(corners) {
            v.position = position;
        }
        mesh.triangles = vec![[0, 1, 2], [1, 0, 2], [0, 1, 3]];
        mesh
    }

    #[test]
    fn records_have_the_normal_of_their_triangle() {
        let bytes = written(flat());
        assert_eq!(bytes.len(), 84 + 3 * 50);
        assert!(bytes.starts_with(b"binary STL, isospan surface, isovalue 1.5, ??") && is_binary(&bytes));
        let normals: Vec<_> = bytes[84..].chunks(50).map(position).collect();
        assert_eq!(normals, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]);
        assert_eq!(position(&bytes[84 + 24..]), [2.0, 0.0, 1.0]);
    }

    #[test]
    fn equal_positions_become_one_vertex() {
        let text = "solid a name with endsolid in it\n facet normal 0 0 1\n outer loop\n vertex 0 0 0\n\
            vertex 1 0 0\n vertex 0 1e0 -0\n endloop\n endfacet\n facet normal 0 0 0\n outer loop\n\
            vertex 1 -0.0 0\n vertex 1 1 0\n vertex 0 1 0\n endloop\n endfacet\nendsolid x\nsolid\nendsolid\n";
        let mesh = parse(text.as_bytes()).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles), (4, vec![[0, 1, 2], [1, 3, 2]]));
        for (from, to, says) in [
            ("facet", "fazet", "'facet' or"),
            ("outer loop", "outer ring", "'loop'"),
            ("1 1 0", "1 inf 0", "finite"),
            ("1 1 0", "1 x 0", "a coordinate"),
            ("endsolid\n", "", "end of the file"),
            ("endsolid\n", "endsolid\nstray", "'solid'"),
        ] {
            let error = parse(text.replace(from, to).as_bytes()).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
        survive(text.as_bytes(), |b| drop(parse(b)));
    }

    #[test]
    fn a_binary_file_may_begin_with_solid() {
        let mut bytes = written(tetrahedron());
        bytes[..5].copy_from_slice(b"solid");
        let mesh = parse(&bytes).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (4, 4));
    }

    #[test]
    fn damage_is_found() {
        let bytes = written(tetrahedron());
        survive(&bytes, |b| drop(parse(b)));
        assert!((0..bytes.len()).all(|cut| parse(&bytes[..cut]).is_err()));
        let mut nan = bytes.clone();
        nan[84 + 12..84 + 16].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(parse(&nan).unwrap_err().to_string().contains("triangle 0"));
    }

    #[test]
    fn decimals_far_from_0_keep_their_digits() {
        let text = "solid far\nfacet normal 0 0 1\nouter loop\nvertex 448262.001 5411932.5 7\n\
            vertex 448262.002 5411932.5 7\nvertex 448262.001 5411932.501 7.001\nendloop\nendfacet\nendsolid far\n";
        let mesh = parse(text.as_bytes()).unwrap();
        let at = |v: usize| mesh.vertices[v].world(mesh.origin);
        assert_eq!(mesh.vertices.len(), 3);
        assert!((at(1)[0] - at(0)[0] - 1e-3).abs() < 1e-7 && (at(2)[1] - 5_411_932.501).abs() < 1e-7);
    }

    #[test]
    fn too_many_triangles_are_refused() {
        assert!(check_limits(u32::MAX.into()).is_ok());
        assert_eq!(check_limits(1 << 32).unwrap_err().exit_code(), 2);
    }
}
