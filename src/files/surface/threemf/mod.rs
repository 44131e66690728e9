//! 3MF: the 3D Manufacturing Format (3MF Consortium, ISO/IEC 25422), written only.
//!
//! ```text
//! [Content_Types].xml, _rels/.rels       what the parts of the archive are
//! 3D/3dmodel.model                       the model, XML:
//!   m:colorgroup                         colours of a surface with values
//!   basematerials                        colours of labels
//!   object, mesh                         one for each surface of the file
//!   build, item                          where each of them lies
//! ```
//!
//! The archive is a zip file, whose members are compressed (DEFLATE) while they are written.
//!
//! The format has six units of length. Another one that is known becomes one of them by the
//! transform of the items; so does the origin of a surface that is far from 0. Without a unit the
//! model has none, which readers take for millimetres. Axes are as they are: z is up. Colours are
//! those of 256 places of the colour map, and grey where there is no value; a triangle has one at
//! each corner. Objects are of the type `model`, which should be closed.

mod zip;

use super::obj::{push_decimal, put};
use super::{SurfaceMeta, VertexValues, each_triangle, each_vertex};
use crate::surface::SurfaceSource;
use isospan_io::bytes::store::Cached;
use isospan_io::error::{Error, Result};
use isospan_io::formats::shared::sink::Sink;
use isospan_io::formats::shared::text::xml_attribute;
use isospan_io::volume::units::Unit;
use zip::Zip;

const CONTENT_TYPES: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
    <Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\
    <Default Extension=\"rels\" ContentType=\"application/vnd.openxmlformats-package.relationships+xml\"/>\
    <Default Extension=\"model\" ContentType=\"application/vnd.ms-package.3dmanufacturing-3dmodel+xml\"/>\
    </Types>\n";
const RELATIONS: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
    <Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">\
    <Relationship Target=\"/3D/3dmodel.model\" Id=\"rel0\" \
    Type=\"http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel\"/></Relationships>\n";
const CORE: &str = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02";
const MATERIALS: &str = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02";

/// The number of the group of colours; objects have the numbers behind it.
const COLOURS: usize = 1;
/// Objects of a file, at most: for each, the whole surface is read.
const MOST_OBJECTS: usize = 1000;

/// Units of the format, in metres, from the smallest on.
const UNITS: [(&str, f64); 6] = [
    ("micron", 1e-6),
    ("millimeter", 1e-3),
    ("centimeter", 1e-2),
    ("inch", 0.0254),
    ("foot", 0.3048),
    ("meter", 1.0),
];

/// The unit of the format that lengths are written in, and how many of it one of theirs is.
fn unit_of(unit: Option<&Unit>) -> Option<(&'static str, f64)> {
    let (number, power) = unit?.metres()?;
    let metres: f64 = format!("{number}e{power}").parse().ok()?;
    let same = UNITS.iter().find(|(_, size)| (metres / size - 1.0).abs() < 1e-9);
    if let Some((name, _)) = same {
        return Some((name, 1.0));
    }
    // Decimal ones: a nanometre is 0.001 of a micron.
    let (name, size) = if metres < 1e-3 { UNITS[0] } else { UNITS[5] };
    Some((name, metres / size))
}

/// A surface of a file.
struct Object {
    name: String,
    vertices: u64,
    triangles: u64,
}

fn objects(source: &dyn SurfaceSource, meta: &SurfaceMeta) -> Vec<Object> {
    if meta.parts.is_empty() {
        let name = meta.isovalue.map_or_else(|| "surface".to_owned(), |v| format!("isovalue {v}"));
        let (vertices, triangles) = (source.vertex_count(), source.triangle_count());
        return vec![Object { name, vertices, triangles }];
    }
    let object = |part: &super::SurfacePart| Object {
        name: part.name(),
        vertices: part.vertices,
        triangles: part.triangles,
    };
    meta.parts.iter().map(object).collect()
}

/// Refuses more objects than can be written in a short time.
pub(in crate::files) fn check_limits(meta: &SurfaceMeta) -> Result<()> {
    match meta.parts.len() > MOST_OBJECTS {
        true => Err(Error::usage(format!(
            "a 3MF file gets at most {MOST_OBJECTS} objects, this surface has {} parts: give each a file, \
             or write GLB, VTP or PLY",
            meta.parts.len()
        ))),
        false => Ok(()),
    }
}

/// Writes a surface as 3MF.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    meta: &SurfaceMeta,
) -> Result<()> {
    let mut zip = Zip::default();
    zip.add(sink, "[Content_Types].xml", CONTENT_TYPES.as_bytes())?;
    zip.add(sink, "_rels/.rels", RELATIONS.as_bytes())?;
    zip.begin(sink, "3D/3dmodel.model")?;
    let unit = unit_of(meta.units.length.as_ref());
    zip.put(sink, head(meta, unit).as_bytes())?;
    let objects = objects(source, meta);
    Model { source, meta, objects: &objects }.write(&mut zip, sink)?;
    zip.put(sink, build(&objects, source.origin(), unit.map_or(1.0, |(_, scale)| scale)).as_bytes())?;
    zip.end(sink)?;
    zip.finish(sink)
}

fn head(meta: &SurfaceMeta, unit: Option<(&'static str, f64)>) -> String {
    let unit = unit.map_or_else(String::new, |(name, _)| format!(" unit=\"{name}\""));
    let mut text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<model{unit} xml:lang=\"en-US\" xmlns=\"{CORE}\" \
         xmlns:m=\"{MATERIALS}\">\n  <metadata name=\"Application\">isospan {}</metadata>\n",
        env!("CARGO_PKG_VERSION")
    );
    let lines = meta.lines().join("; ");
    if !lines.is_empty() {
        text += &format!("  <metadata name=\"Description\">{}</metadata>\n", xml_attribute(&lines));
    }
    text += "  <resources>\n";
    if let Some(values) = &meta.values {
        text += &format!("    <m:colorgroup id=\"{COLOURS}\">\n");
        for [r, g, b] in values.palette() {
            text += &format!("      <m:color color=\"#{r:02X}{g:02X}{b:02X}FF\"/>\n");
        }
        text += "    </m:colorgroup>\n";
    } else if meta.are_labels() {
        text += &format!("    <basematerials id=\"{COLOURS}\">\n");
        for part in &meta.parts {
            let [r, g, b, a] = part.label.as_ref().map_or([u8::MAX; 4], |label| label.colour);
            let name = xml_attribute(&part.name());
            let colour = format!("#{r:02X}{g:02X}{b:02X}{a:02X}");
            text += &format!("      <base name=\"{name}\" displaycolor=\"{colour}\"/>\n");
        }
        text += "    </basematerials>\n";
    }
    text
}

/// The end of the model: each object at its place.
fn build(objects: &[Object], origin: [f64; 3], scale: f64) -> String {
    let mut text = String::from("  </resources>\n  <build>\n");
    let [x, y, z] = origin.map(|c| scale * c);
    let transform = match scale == 1.0 && origin == [0.0; 3] {
        true => String::new(),
        false => format!(" transform=\"{scale} 0 0 0 {scale} 0 0 0 {scale} {x} {y} {z}\""),
    };
    for (n, _) in objects.iter().enumerate().filter(|(_, object)| object.triangles > 0) {
        text += &format!("    <item objectid=\"{}\"{transform}/>\n", COLOURS + 1 + n);
    }
    text + "  </build>\n</model>\n"
}

/// The objects of a model. Vertices and triangles of all of them come in two runs, and the text has
/// them in turn: so a part is read by itself, of all that the source hands out.
struct Model<'a> {
    source: &'a dyn SurfaceSource,
    meta: &'a SurfaceMeta,
    objects: &'a [Object],
}

impl Model<'_> {
    fn write(&self, zip: &mut Zip, sink: &mut Sink<'_>) -> Result<()> {
        let (mut vertices, mut triangles) = (0, 0);
        for (n, object) in self.objects.iter().enumerate() {
            if object.triangles > 0 {
                let name = xml_attribute(&object.name);
                let id = COLOURS + 1 + n;
                let colour = match self.meta.are_labels() && self.meta.values.is_none() {
                    true => format!(" pid=\"{COLOURS}\" pindex=\"{n}\""),
                    false => String::new(),
                };
                let head = format!(
                    "    <object id=\"{id}\" type=\"model\" name=\"{name}\"{colour}>\n      <mesh>\n        <vertices>\n"
                );
                zip.put(sink, head.as_bytes())?;
                self.put_vertices(zip, sink, vertices..vertices + object.vertices)?;
                zip.put(sink, b"        </vertices>\n        <triangles>\n")?;
                self.put_triangles(zip, sink, triangles..triangles + object.triangles, vertices)?;
                zip.put(sink, b"        </triangles>\n      </mesh>\n    </object>\n")?;
            }
            vertices += object.vertices;
            triangles += object.triangles;
        }
        Ok(())
    }

    fn put_vertices(&self, zip: &mut Zip, sink: &mut Sink<'_>, range: std::ops::Range<u64>) -> Result<()> {
        let mut each = |bytes: &[u8]| zip.put(sink, bytes);
        let mut packed = Sink::stream(&mut each);
        each_vertex(self.source, &mut packed, |text, n, v| {
            if range.contains(&n) {
                text.extend_from_slice(b"<vertex");
                for (name, c) in [" x=\"", " y=\"", " z=\""].into_iter().zip(v.position) {
                    text.extend_from_slice(name.as_bytes());
                    push_decimal(text, c + 0.0);
                    text.push(b'"');
                }
                text.extend_from_slice(b"/>\n");
            }
        })
    }

    fn put_triangles(
        &self,
        zip: &mut Zip,
        sink: &mut Sink<'_>,
        range: std::ops::Range<u64>,
        first: u64,
    ) -> Result<()> {
        let values = self.meta.values.as_deref();
        let mut colours = values.map(|values| (values, values.cached()));
        let mut each = |bytes: &[u8]| zip.put(sink, bytes);
        let mut packed = Sink::stream(&mut each);
        each_triangle(self.source, &mut packed, |text, n, t| {
            if range.contains(&n) {
                let [a, b, c] = t.map(|v| u64::from(v).saturating_sub(first));
                put(text, format_args!("<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\""));
                if let Some((values, cached)) = &mut colours {
                    let [p, q, r] = numbers(values, cached, t)?;
                    put(text, format_args!(" pid=\"{COLOURS}\" p1=\"{p}\" p2=\"{q}\" p3=\"{r}\""));
                }
                text.extend_from_slice(b"/>\n");
            }
            Ok(())
        })
    }
}

/// The numbers of the colours of a triangle's corners.
fn numbers(values: &VertexValues, cached: &mut Cached<'_, f32>, triangle: [u32; 3]) -> Result<[usize; 3]> {
    let mut out = [0; 3];
    for (number, vertex) in out.iter_mut().zip(triangle) {
        *number = values.index(cached.get(vertex.into())?);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::labels::LabelStyle;
    use crate::files::surface::tests::{far_tetrahedron, source};
    use crate::files::surface::{SurfaceFormat, SurfacePart, write_surface};
    use crate::render::ColourMap;
    use crate::surface::Joined;
    use isospan_io::volume::units::Units;
    use std::io::Read;
    use std::sync::Arc;

    /// The model of a file that was written, and the names of the members before it.
    fn model(bytes: &[u8]) -> String {
        let (mut at, mut text) = (0, String::new());
        while bytes[at..].starts_with(b"PK\x03\x04") {
            let le = |from: usize| usize::from(bytes[at + from]) + 256 * usize::from(bytes[at + from + 1]);
            let data = at + 30 + le(26) + le(28);
            let mut inflated = flate2::bufread::DeflateDecoder::new(&bytes[data..]);
            text.clear();
            inflated.read_to_string(&mut text).unwrap();
            let used = inflated.total_in() as usize;
            assert!(bytes[data + used..].starts_with(b"PK\x07\x08"));
            at = data + used + 24;
        }
        assert!(bytes[at..].starts_with(b"PK\x01\x02"));
        text
    }

    fn written(meta: &SurfaceMeta, several: bool) -> String {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.3mf");
        let (a, b) = (source(far_tetrahedron()), source(far_tetrahedron()));
        let joined = Joined::new(vec![&a, &b]);
        let source: &dyn SurfaceSource = if several { &joined } else { &a };
        write_surface(source, &path, SurfaceFormat::ThreeMf, meta).unwrap();
        model(&std::fs::read(path).unwrap())
    }

    #[test]
    fn units_places_and_parts_are_in_the_model() {
        let of = |unit: &str| Units::of_length(Unit::length(unit));
        let one = SurfaceMeta { isovalue: Some(7.0), units: of("mm"), ..SurfaceMeta::default() };
        let text = written(&one, false);
        assert!(text.contains("<model unit=\"millimeter\"") && text.contains("name=\"isovalue 7\""));
        assert!(text.contains("transform=\"1 0 0 0 1 0 0 0 1 448262.5 -5411932.25 310\""), "{text}");
        assert!(text.contains("<vertex x=\"0.125\" y=\"0.25\" z=\"-0.5\"/>"));
        assert!(text.contains("<triangle v1=\"0\" v2=\"2\" v3=\"1\"/>"));
        let text = written(&SurfaceMeta { units: of("nm"), ..one.clone() }, false);
        assert!(text.contains("unit=\"micron\"") && text.contains("transform=\"0.001 0 0 0 0.001"), "{text}");
        assert!(written(&SurfaceMeta::default(), false).contains("<model xml:lang"));
        let part = |isovalue, vertices, triangles| SurfacePart { isovalue, vertices, triangles, label: None };
        let parts = vec![part(0.5, 4, 4), part(0.6, 0, 0), part(1.0, 4, 4)];
        let text = written(&SurfaceMeta { parts, ..SurfaceMeta::default() }, true);
        assert_eq!(text.matches("<object").count(), 2);
        assert_eq!(text.matches("<vertex ").count(), 8);
        assert_eq!(text.matches("<triangle v1=\"0\" v2=\"2\" v3=\"1\"/>").count(), 2);
        let label = Some(LabelStyle { name: "Left \"A\"".into(), colour: [255, 0, 16, 128] });
        let parts = vec![SurfacePart { label, ..part(3.0, 4, 4) }];
        let text = written(&SurfaceMeta { parts, ..SurfaceMeta::default() }, false);
        assert!(text.contains("<base name=\"Left &quot;A&quot;\" displaycolor=\"#FF001080\"/>"), "{text}");
        assert!(text.contains("name=\"Left &quot;A&quot;\" pid=\"1\" pindex=\"0\""), "{text}");
        let many = SurfaceMeta { parts: vec![part(1.0, 0, 0); 1001], ..SurfaceMeta::default() };
        assert!(check_limits(&many).unwrap_err().to_string().contains("1000 objects"));
    }

    #[test]
    fn corners_have_colours() {
        let folder = std::env::temp_dir();
        let mut values = VertexValues::new("f", [0.0, 1.0], ColourMap::Grey, 1 << 10, &folder).unwrap();
        values.extend(&[0.0, 1.0, 0.5, f32::NAN]).unwrap();
        let meta = SurfaceMeta { values: Some(Arc::new(values)), ..SurfaceMeta::default() };
        let text = written(&meta, false);
        assert_eq!(text.matches("<m:color ").count(), 257);
        assert!(
            text.contains("<triangle v1=\"0\" v2=\"1\" v3=\"3\" pid=\"1\" p1=\"0\" p2=\"255\" p3=\"256\"/>")
        );
    }

    #[test]
    fn units_of_the_format_are_their_own() {
        let of = |unit: &str| unit_of(Unit::length(unit).as_ref());
        assert_eq!(of("um"), Some(("micron", 1.0)));
        assert_eq!(of("inch"), Some(("inch", 1.0)));
        assert_eq!(of("km").map(|(name, n)| (name, n.round())), Some(("meter", 1000.0)));
        assert_eq!(of("furlong"), None);
    }
}
