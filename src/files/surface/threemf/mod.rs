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
use super::parts::{PartRange, TakeParts, each_part, parts_of};
use super::{SurfaceMeta, VertexValues};
use crate::surface::SurfaceSource;
use crate::surface::weld::BuilderSettings;
use isospan_io::bytes::store::Cached;
use isospan_io::error::Result;
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
/// Bytes of text that are compressed at a time.
const HANDED_ON: usize = 1 << 16;

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

/// Writes a surface as 3MF. Vertices of objects wait as `scratch` says.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    meta: &SurfaceMeta,
    scratch: &BuilderSettings,
) -> Result<()> {
    let mut zip = Zip::default();
    zip.add(sink, "[Content_Types].xml", CONTENT_TYPES.as_bytes())?;
    zip.add(sink, "_rels/.rels", RELATIONS.as_bytes())?;
    zip.begin(sink, "3D/3dmodel.model")?;
    let unit = unit_of(meta.units.length.as_ref());
    let (parts, target) = (parts_of(source, meta), sink.target().to_path_buf());
    let colours = meta.values.as_deref().map(|values| (values, values.cached()));
    let mut model = Model { zip: &mut zip, sink, meta, colours, text: vec![] };
    model.put_head(unit)?;
    each_part(source, &parts, scratch, &target, &mut model)?;
    model.put_build(&parts, source.origin(), unit.map_or(1.0, |(_, scale)| scale))?;
    model.hand_on(true)?;
    zip.end(sink)?;
    zip.finish(sink)
}

/// The text of a model, which is compressed in pieces of one size: their bytes do not depend on
/// how a source hands out what it has.
struct Model<'a, 's> {
    zip: &'a mut Zip,
    sink: &'a mut Sink<'s>,
    meta: &'a SurfaceMeta,
    colours: Option<(&'a VertexValues, Cached<'a, f32>)>,
    text: Vec<u8>,
}

impl Model<'_, '_> {
    fn put(&mut self, text: &str) -> Result<()> {
        self.text.extend_from_slice(text.as_bytes());
        self.hand_on(false)
    }

    /// Compresses whole pieces of the text, or all of it.
    fn hand_on(&mut self, all: bool) -> Result<()> {
        let whole = self.text.len() / HANDED_ON * HANDED_ON;
        let now = if all { self.text.len() } else { whole };
        for piece in self.text[..now].chunks(HANDED_ON) {
            self.zip.put(self.sink, piece)?;
        }
        self.text.drain(..now);
        Ok(())
    }

    fn put_head(&mut self, unit: Option<(&'static str, f64)>) -> Result<()> {
        let unit = unit.map_or_else(String::new, |(name, _)| format!(" unit=\"{name}\""));
        self.put(&format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<model{unit} xml:lang=\"en-US\" xmlns=\"{CORE}\" \
             xmlns:m=\"{MATERIALS}\">\n  <metadata name=\"Application\">isospan {}</metadata>\n",
            env!("CARGO_PKG_VERSION")
        ))?;
        let lines = self.meta.lines().join("; ");
        if !lines.is_empty() {
            let lines = xml_attribute(&lines);
            self.put(&format!("  <metadata name=\"Description\">{lines}</metadata>\n"))?;
        }
        self.put("  <resources>\n")?;
        if let Some(values) = &self.meta.values {
            self.put(&format!("    <m:colorgroup id=\"{COLOURS}\">\n"))?;
            for [r, g, b] in values.palette() {
                self.put(&format!("      <m:color color=\"#{r:02X}{g:02X}{b:02X}FF\"/>\n"))?;
            }
            return self.put("    </m:colorgroup>\n");
        }
        if self.meta.are_labels() {
            self.put(&format!("    <basematerials id=\"{COLOURS}\">\n"))?;
            for part in &self.meta.parts {
                let [r, g, b, a] = part.label.as_ref().map_or([u8::MAX; 4], |label| label.colour);
                let name = xml_attribute(&part.name());
                let colour = format!("#{r:02X}{g:02X}{b:02X}{a:02X}");
                self.put(&format!("      <base name=\"{name}\" displaycolor=\"{colour}\"/>\n"))?;
            }
            self.put("    </basematerials>\n")?;
        }
        Ok(())
    }

    /// The end of the model: each object at its place.
    fn put_build(&mut self, parts: &[PartRange], origin: [f64; 3], scale: f64) -> Result<()> {
        self.put("  </resources>\n  <build>\n")?;
        let [x, y, z] = origin.map(|c| scale * c);
        let transform = match scale == 1.0 && origin == [0.0; 3] {
            true => String::new(),
            false => format!(" transform=\"{scale} 0 0 0 {scale} 0 0 0 {scale} {x} {y} {z}\""),
        };
        for part in parts {
            let id = COLOURS + 1 + part.number;
            self.put(&format!("    <item objectid=\"{id}\"{transform}/>\n"))?;
        }
        self.put("  </build>\n</model>\n")
    }
}

impl TakeParts for Model<'_, '_> {
    fn begin(&mut self, part: &PartRange) -> Result<()> {
        let (name, id) = (xml_attribute(&part.name), COLOURS + 1 + part.number);
        let colour = match self.meta.are_labels() && self.meta.values.is_none() {
            true => format!(" pid=\"{COLOURS}\" pindex=\"{}\"", part.number),
            false => String::new(),
        };
        self.put(&format!(
            "    <object id=\"{id}\" type=\"model\" name=\"{name}\"{colour}>\n      <mesh>\n        <vertices>\n"
        ))
    }

    fn vertices(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        for position in positions {
            self.text.extend_from_slice(b"<vertex");
            for (name, c) in [" x=\"", " y=\"", " z=\""].into_iter().zip(position) {
                self.text.extend_from_slice(name.as_bytes());
                push_decimal(&mut self.text, c + 0.0);
                self.text.push(b'"');
            }
            self.text.extend_from_slice(b"/>\n");
        }
        self.hand_on(false)
    }

    fn between(&mut self) -> Result<()> {
        self.put("        </vertices>\n        <triangles>\n")
    }

    fn triangles(&mut self, part: &PartRange, triangles: &[[u32; 3]]) -> Result<()> {
        for &[a, b, c] in triangles {
            put(&mut self.text, format_args!("<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\""));
            if let Some((values, cached)) = &mut self.colours {
                let corners = [a, b, c].map(|v| part.first + u64::from(v));
                let [p, q, r] = numbers(values, cached, corners)?;
                put(&mut self.text, format_args!(" pid=\"{COLOURS}\" p1=\"{p}\" p2=\"{q}\" p3=\"{r}\""));
            }
            self.text.extend_from_slice(b"/>\n");
        }
        self.hand_on(false)
    }

    fn end(&mut self) -> Result<()> {
        self.put("        </triangles>\n      </mesh>\n    </object>\n")
    }
}

/// The numbers of the colours of a triangle's corners.
fn numbers(values: &VertexValues, cached: &mut Cached<'_, f32>, triangle: [u64; 3]) -> Result<[usize; 3]> {
    let mut out = [0; 3];
    for (number, vertex) in out.iter_mut().zip(triangle) {
        *number = values.index(cached.get(vertex)?);
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
    use isospan_io::exec::Resources;
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
        write_surface(source, &path, SurfaceFormat::ThreeMf, meta, &Resources::default()).unwrap();
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
    }

    #[test]
    fn thousands_of_objects_are_written_in_one_pass() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("many.3mf");
        let one = source(far_tetrahedron());
        let joined = Joined::new(vec![&one; 3000]);
        let part = |n: u32| SurfacePart { isovalue: n.into(), vertices: 4, triangles: 4, label: None };
        let meta = SurfaceMeta { parts: (0..3000).map(part).collect(), ..SurfaceMeta::default() };
        write_surface(&joined, &path, SurfaceFormat::ThreeMf, &meta, &Resources::default()).unwrap();
        let text = model(&std::fs::read(&path).unwrap());
        assert_eq!(text.matches("<object ").count(), 3000);
        assert_eq!(text.matches("<triangle v1=\"0\" v2=\"2\" v3=\"1\"/>").count(), 3000);
        assert_eq!(text.matches("<vertex x=\"0.125\"").count(), 3000);
        // Triangles that use vertices of another part are an error.
        let parts = vec![SurfacePart { vertices: 3, ..part(0) }, SurfacePart { vertices: 5, ..part(1) }];
        let meta = SurfaceMeta { parts, ..SurfaceMeta::default() };
        let two = Joined::new(vec![&one; 2]);
        let error = write_surface(&two, &path, SurfaceFormat::ThreeMf, &meta, &Resources::default())
            .unwrap_err()
            .to_string();
        assert!(error.contains("of a part of the vertices 0 to 3"), "{error}");
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
