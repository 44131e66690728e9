//! How far samples are apart, and in which unit, as descriptions of pages say it.
//!
//! | | ImageJ | OME-XML |
//! |---|---|---|
//! | along x, y | the resolution tags | `PhysicalSizeX`, `PhysicalSizeY` |
//! | along z | `spacing=`, else 1 | `PhysicalSizeZ` |
//! | units | `unit=`, where they differ `yunit=`, `zunit=` | `PhysicalSizeXUnit` …, else µm |

use super::page::Page;
use crate::error::Result;
use crate::formats::shared::lengths::Lengths;
use crate::volume::units::Unit;
use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::events::Event;
use std::path::Path;

/// Where the samples of a file lie.
pub(super) struct SampleSpacing {
    /// Along x, y, z.
    pub(super) spacing: [f64; 3],
    pub(super) unit: Option<Unit>,
    /// Axes along which nothing says it: 1 is taken.
    pub(super) missing: [bool; 3],
    /// Lines for the user.
    pub(super) notes: Vec<String>,
}

impl Default for SampleSpacing {
    fn default() -> Self {
        Self { spacing: [1.0; 3], unit: None, missing: [false; 3], notes: vec![] }
    }
}

impl SampleSpacing {
    /// What the description of a page says.
    ///
    /// # Errors
    /// [`Error::BadInput`](crate::Error::BadInput) where the axes have units that are not known.
    pub(super) fn of(path: &Path, page: &Page) -> Result<Self> {
        let text = &page.description;
        let (sizes, units) = if text.starts_with("ImageJ=") {
            (of_imagej(page), imagej_units(text))
        } else {
            (of_ome(text), ome_units(text))
        };
        let sizes = sizes.map(|size| size.filter(|s| s.is_finite() && *s > 0.0));
        if sizes == [None; 3] {
            return Ok(Self { missing: [true; 3], ..Self::default() });
        }
        // An axis without a size has no unit of its own.
        let first = sizes.iter().position(Option::is_some).unwrap_or(0);
        let of_axis = |axis: usize| units[if sizes[axis].is_some() { axis } else { first }].clone();
        let units = std::array::from_fn(|axis| of_axis(axis).as_deref().and_then(Unit::length));
        let lengths = Lengths::of_space(path, "description, units of the axes", units)?;
        let spacing = std::array::from_fn(|axis| sizes[axis].map_or(1.0, |size| lengths.along(axis, size)));
        let (missing, notes) = (sizes.map(|size| size.is_none()), lengths.note.into_iter().collect());
        Ok(Self { spacing, unit: lengths.unit, missing, notes })
    }
}

/// A value of an ImageJ description: lines "key=value" after "ImageJ=version".
pub(super) fn imagej<'a>(description: &'a str, key: &str) -> Option<&'a str> {
    let lines = description.starts_with("ImageJ=").then(|| description.lines())?;
    lines.filter_map(|l| l.split_once('=')).find(|(k, _)| *k == key).map(|(_, v)| v.trim())
}

/// ImageJ's spacing. Where nothing but resolutions of 1 is there, slices are one pixel apart too.
fn of_imagej(page: &Page) -> [Option<f64>; 3] {
    let text = &page.description;
    let z = imagej(text, "spacing").and_then(|v| v.parse::<f64>().ok()).map(f64::abs);
    let [x, y] = page.resolution.unwrap_or([1.0; 2]).map(f64::recip);
    let is_in_pixels = imagej(text, "unit").is_none_or(|unit| Unit::length(&unescaped(unit)).is_none());
    let usual = (is_in_pixels && imagej(text, "spacing").is_none()).then_some(1.0);
    [Some(x), Some(y), z.or(usual)]
}

fn imagej_units(text: &str) -> [Option<String>; 3] {
    let unit = |key: &str| imagej(text, key).map(unescaped);
    let x = unit("unit").or_else(|| unit("xunit"));
    ["xunit", "yunit", "zunit"].map(|key| if key == "xunit" { x.clone() } else { unit(key).or(x.clone()) })
}

/// Text in which ImageJ has written letters as Java does: "\u00B5m".
pub(super) fn unescaped(text: &str) -> String {
    let mut parts = text.split("\\u");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let code = part.get(..4).and_then(|hex| u32::from_str_radix(hex, 16).ok()).and_then(char::from_u32);
        match code {
            Some(letter) => out.extend(std::iter::once(letter).chain(part[4..].chars())),
            None => out.extend(["\\u", part]),
        }
    }
    out
}

/// An attribute of OME-XML's first `Pixels`.
pub(super) fn ome(description: &str, key: &str) -> Option<String> {
    if !description.contains("OME") {
        return None;
    }
    let mut reader = Reader::from_str(description);
    loop {
        match reader.read_event().ok()? {
            Event::Start(tag) | Event::Empty(tag) if tag.local_name().as_ref() == "Pixels" => {
                let found = tag.attributes().filter_map(|a| a.ok()).find(|a| a.key.as_ref() == key)?;
                let value = found.normalized_value(XmlVersion::Implicit1_0);
                return value.ok().map(|value| value.trim().to_owned());
            }
            Event::Eof => return None,
            _ => {}
        }
    }
}

fn of_ome(text: &str) -> [Option<f64>; 3] {
    ["X", "Y", "Z"].map(|axis| ome(text, &format!("PhysicalSize{axis}"))?.parse().ok())
}

/// The units of OME-XML, which are µm where none is named.
fn ome_units(text: &str) -> [Option<String>; 3] {
    let unit = |axis| ome(text, &format!("PhysicalSize{axis}Unit"));
    ["X", "Y", "Z"].map(|axis| Some(unit(axis).unwrap_or_else(|| "µm".into())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_of_java() {
        for (text, letters) in [
            ("\\u00B5m", "µm"),
            ("\\u03BCm", "μm"),
            ("mm", "mm"),
            ("\\u00", "\\u00"),
            ("a\\uD800b", "a\\uD800b"),
            ("\\u00B5\\u00B5", "µµ"),
        ] {
            assert_eq!(unescaped(text), letters);
        }
    }

    #[test]
    fn attributes_of_pixels() {
        let text = "<?xml version='1.0'?><!-- a > b --><OME:OME><OME:Image Name=\"<Pixels\">\n<OME:Pixels\n  \
                    SizeC='2' PhysicalSizeXUnit=\"&#181;m\"><Channel/></OME:Pixels>";
        let text = text.replace("\"<Pixels\"", "\"x\"");
        assert_eq!(ome(&text, "SizeC").as_deref(), Some("2"));
        assert_eq!(ome(&text, "PhysicalSizeXUnit").as_deref(), Some("µm"));
        assert_eq!(ome(&text, "SizeT"), None);
        assert_eq!(ome("no XML", "SizeC"), None);
    }
}
