//! OBJ, the text format of Wavefront's Advanced Visualizer.
//!
//! A line is a statement: `v x y z` is a vertex, `vn x y z` a normal, `f a//a b//b c//c` a face of
//! vertex and normal numbers, both counted from 1. Several surfaces in one file are groups,
//! `g isovalue_600`; those of labels have the labels' names, or `g label_3`, and colours. We write
//! the shortest decimals that read back as the same `f32`; of a surface that is far from 0, as the
//! same `f64`.
//!
//! We read `v` and `f` in all their forms (`a`, `a/t`, `a//n`, `a/t/n`; negative numbers count back
//! from the last vertex; polygons become fans; `\` continues a line). Statements that do not affect
//! the shape (normals, texture, groups, materials, curves) are skipped; a statement that OBJ does
//! not have is an error.

use super::ply::check_indices;
use super::{
    Fan, SurfaceMeta, SurfacePart, each_triangle, each_vertex, each_vertex_with, is_finite, take_line,
};
use crate::surface::weld::StoredSurface;
use crate::surface::{SurfaceSource, Vertex};
use isospan_io::error::Result;
use isospan_io::formats::shared::sink::Sink;
use isospan_io::formats::shared::text::Words;
use std::fmt;
use std::io::Write;
use std::path::Path;

/// Statements that say nothing of vertices and faces.
const IGNORED: [&str; 39] = [
    "vt",
    "vn",
    "vp",
    "l",
    "p",
    "o",
    "g",
    "s",
    "mg",
    "mtllib",
    "usemtl",
    "usemap",
    "maplib",
    "shadow_obj",
    "trace_obj",
    "bevel",
    "c_interp",
    "d_interp",
    "lod",
    "cstype",
    "deg",
    "bmat",
    "step",
    "curv",
    "curv2",
    "surf",
    "parm",
    "trim",
    "hole",
    "scrv",
    "sp",
    "end",
    "con",
    "ctech",
    "stech",
    "bsp",
    "bzp",
    "cdc",
    "res",
];

/// Writes a surface as OBJ.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    meta: &SurfaceMeta,
) -> Result<()> {
    sink.put(b"# isospan surface\n")?;
    for line in meta.lines() {
        // A backslash at the end would continue the comment into the data.
        sink.put(format!("# {}\n", line.replace('\\', "/")).as_bytes())?;
    }
    let (origin, is_far) = (source.origin(), source.origin() != [0.0; 3]);
    let place = |v: &Vertex| -> [Decimal; 3] {
        if is_far { v.world(origin).map(Decimal::Double) } else { v.position.map(Decimal::Single) }
    };
    match meta.values.as_deref() {
        // Colours after a position are what most programs read (MeshLab, Blender, CloudCompare).
        Some(values) => each_vertex_with(source, sink, Some(values), |text, _, v, value| {
            let [x, y, z] = place(v);
            let [r, g, b] = values.colour(value).map(|c| f32::from(c) / 255.0);
            put(text, format_args!("v {x} {y} {z} {r:.4} {g:.4} {b:.4}\n"));
        })?,
        None if meta.are_labels() => {
            let colour = meta.label_colour();
            each_vertex(source, sink, |text, number, v| {
                let [x, y, z] = place(v);
                let [r, g, b] = colour(number).map(|c| f32::from(c) / 255.0);
                put(text, format_args!("v {x} {y} {z} {r:.4} {g:.4} {b:.4}\n"));
            })?;
        }
        None if is_far => each_vertex(source, sink, |text, _, v| {
            let [x, y, z] = place(v);
            put(text, format_args!("v {x} {y} {z}\n"));
        })?,
        None => each_vertex(source, sink, |text, _, v| statement(text, "v", v.position))?,
    }
    each_vertex(source, sink, |text, _, v| statement(text, "vn", v.normal))?;
    let mut groups = groups(meta).into_iter().peekable();
    each_triangle(source, sink, |text, number, t| {
        while let Some((_, name)) = groups.next_if(|group| group.0 <= number) {
            put(text, format_args!("g {name}\n"));
        }
        let [a, b, c] = t.map(|v| u64::from(v) + 1);
        put(text, format_args!("f {a}//{a} {b}//{b} {c}//{c}\n"));
        Ok(())
    })
}

/// The first triangle and the name of the group of each of several surfaces.
fn groups(meta: &SurfaceMeta) -> Vec<(u64, String)> {
    let mut first = 0;
    let group = |part: &SurfacePart| {
        let start = first;
        first += part.triangles;
        let name = match &part.label {
            None => format!("isovalue_{}", part.isovalue),
            Some(label) if label.name.is_empty() => format!("label_{}", part.isovalue),
            // Names are words.
            Some(label) => label.name.split_whitespace().collect::<Vec<_>>().join("_"),
        };
        (start, name)
    };
    meta.parts.iter().map(group).collect()
}

/// A coordinate, written as the shortest decimal that reads back as the same number.
enum Decimal {
    Single(f32),
    Double(f64),
}

impl fmt::Display for Decimal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Single(x) => x.fmt(f),
            Self::Double(x) => x.fmt(f),
        }
    }
}

pub(super) fn put(text: &mut Vec<u8>, what: std::fmt::Arguments<'_>) {
    text.write_fmt(what).expect("writing to memory cannot fail");
}

fn statement(text: &mut Vec<u8>, word: &str, numbers: [f32; 3]) {
    text.extend_from_slice(word.as_bytes());
    for x in numbers {
        text.push(b' ');
        push_decimal(text, x);
    }
    text.push(b'\n');
}

/// The shortest decimal that reads back as `x`; with an exponent where zeros would fill the line.
pub(super) fn push_decimal(text: &mut Vec<u8>, x: f32) {
    let plain = x == 0.0 || (1e-5..1e9).contains(&x.abs()) || !x.is_finite();
    if plain { put(text, format_args!("{x}")) } else { put(text, format_args!("{x:e}")) }
}

/// Reads an OBJ surface.
pub(in crate::files) fn read(path: &Path, bytes: &[u8], out: &mut StoredSurface) -> Result<()> {
    let mut words = Words::new(path, bytes, 0);
    let mut polygon = vec![];
    while let Some(line) = words.line() {
        let mut line = line.into_owned();
        while line.ends_with('\\') {
            line.pop();
            line.push(' ');
            line += &words.line().unwrap_or_default();
        }
        // A comment may follow a statement.
        let statement = line.split('#').next().unwrap_or_default();
        let mut parts = statement.split_ascii_whitespace();
        let wrong = |what: &str| words.wrong(what, format!("'{}'", statement.trim()));
        match parts.next() {
            None => take_line(out, line.trim_start().trim_start_matches('#')),
            Some("v") => {
                let place = vertex(parts).ok_or_else(|| wrong("v and three finite numbers"))?;
                out.push_double(place, [0.0; 3])?;
            }
            Some("f") => {
                let corners = face(parts, out.vertex_count(), &mut polygon);
                corners.ok_or_else(|| wrong("f and the numbers of at least three vertices"))?;
                let mut fan = Fan::default();
                let mut triangles = polygon.iter().filter_map(|&corner| fan.corner(corner));
                triangles.try_for_each(|triangle| out.push_triangle(triangle))?;
            }
            Some(word) if IGNORED.contains(&word) => {}
            Some(_) => return Err(wrong("an OBJ statement")),
        }
    }
    check_indices(path, out)
}

/// x, y, z; a weight or a colour may follow.
fn vertex<'a>(parts: impl Iterator<Item = &'a str>) -> Option<[f64; 3]> {
    let numbers: Vec<f64> = parts.map(|p| p.parse().ok()).collect::<Option<_>>()?;
    let place: [f64; 3] = numbers.get(..3)?.try_into().ok()?;
    is_finite(&place.map(|x| x as f32)).then_some(place)
}

/// The vertices of a face, counted from 0.
fn face<'a>(parts: impl Iterator<Item = &'a str>, vertices: u64, polygon: &mut Vec<u32>) -> Option<()> {
    polygon.clear();
    for part in parts {
        let number: i64 = part.split('/').next()?.parse().ok()?;
        let index = match number {
            1.. => number - 1,
            // -1 is the last vertex so far.
            _ => (number < 0).then(|| vertices as i64 + number)?,
        };
        polygon.push(u32::try_from(index).ok()?);
    }
    (polygon.len() >= 3).then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::surface::tests::{in_memory, source, tetrahedron};
    use crate::files::surface::{SurfaceFormat, write_surface};
    use crate::surface::TriMesh;
    use isospan_io::exec::Resources;
    use isospan_io::fixtures::survive;

    fn parse(text: &str) -> Result<TriMesh> {
        in_memory(|out| read(Path::new("f.obj"), text.as_bytes(), out))
    }

    #[test]
    fn the_text_is_what_others_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.obj");
        let mut mesh = tetrahedron();
        mesh.vertices.iter_mut().for_each(|v| v.normal = [0.0, -1.0, 0.5]);
        let meta =
            SurfaceMeta { isovalue: Some(0.1), comments: vec!["back\\".into()], ..SurfaceMeta::default() };
        write_surface(&source(mesh), &path, SurfaceFormat::Obj, &meta, &Resources::default()).unwrap();
        let text = std::fs::read_to_string(path).unwrap();
        assert!(text.starts_with("# isospan surface\n# isovalue 0.1\n# back/\nv 0.1 0.33333334 1e-20\n"));
        assert!(text.contains("\nv 16777216 0 1.5e10\n") && text.contains("\nvn 0 -1 0.5\n"));
        assert!(text.ends_with("\nf 3//3 1//1 4//4\n"));
        survive(text.as_bytes(), |b| drop(in_memory(|out| read(Path::new("f"), b, out))));
    }

    #[test]
    fn all_forms_of_a_face() {
        let text = "# c\nmtllib x.mtl\nv 0 0 0\nv 1 0 0 1.0\nv 1 1 0 0.5 0.5 0.5 # grey\r\nvt 0 0\nvn 0 0 1\n\
            f 1 2 3\nf 1/1 2/1 3/1\nf 1//1 2//1 3//1\nv 0 1 0\nf 1/1/1 2/1/1 \\\n 3/1/1 4/1/1\n\
            g a\nf -4 -3 -1\ns off\nf 1 2 5\nv 5 5 5\n";
        let mesh = parse(text).unwrap();
        let expected = [[0, 1, 2], [0, 1, 2], [0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 1, 3], [0, 1, 4]];
        assert_eq!((mesh.vertices.len(), mesh.triangles), (5, expected.to_vec()));
    }

    #[test]
    fn malformed_files_are_refused() {
        for (text, says) in [
            ("v 1 2\n", "line 1"),
            ("\nv 1 2 nan\n", "line 2"),
            ("v 1 2 x\n", "three finite"),
            ("v 0 0 0\nf 1 1\n", "at least three"),
            ("v 0 0 0\nf 1 1 0\n", "at least three"),
            ("v 0 0 0\nf 1 1 -2\n", "at least three"),
            ("v 0 0 0\nf 1 1 4294967297\n", "at least three"),
            ("v 0 0 0\nf 1 1 2\n", "below 1"),
            ("hello\n", "an OBJ statement"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
    }
}
