//! Reads the XML of a VTK file: a small tree of elements, and where the data of each array lie.
//!
//! Data are not copied: an element knows the byte range of its text. Reading stops at
//! `<AppendedData`, because what follows need not be XML. A header is refused when it has more than
//! [`MOST_ELEMENTS`] elements, nests deeper than [`MOST_DEPTH`], or has a tag of more than
//! [`MOST_TAG`] bytes: no real file does, and time and memory stay bounded.

use crate::bytes::ByteSource;
use crate::error::{Error, Place, Result};
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};
use std::ops::Range;
use std::sync::Arc;
use xxhash_rust::xxh3::Xxh3;

const MOST_ELEMENTS: usize = 1 << 18;
const MOST_DEPTH: usize = 32;
/// The reader compares the names of a tag's attributes with one another.
const MOST_TAG: usize = 1 << 16;

/// An element of the head.
#[derive(Debug, Default)]
pub struct Element {
    /// Its name.
    pub name: String,
    /// The elements in it, in file order.
    pub children: Vec<Element>,
    /// The bytes of the first text in it that is not only white space.
    pub(super) text: Range<u64>,
    /// The byte after its start tag.
    pub(super) at: u64,
    attributes: Vec<(String, String)>,
}

impl Element {
    /// The value of an attribute.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str())
    }

    /// All attributes and what they are, in file order.
    pub(super) fn attributes(&self) -> &[(String, String)] {
        &self.attributes
    }

    /// The children of a name.
    pub fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Element> + 'a {
        self.children.iter().filter(move |c| c.name == name)
    }

    /// The first child of a name.
    pub fn child(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|c| c.name == name)
    }
}

/// How arrays are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compressor {
    None,
    Zlib,
    Lz4,
}

/// Where appended data lie.
#[derive(Clone, Copy, Debug)]
pub(super) struct Appended {
    /// The byte after the '_'.
    pub(super) start: u64,
    /// Whether they are base64 text.
    pub(super) base64: bool,
}

/// An opened VTK XML file.
#[derive(Debug)]
pub struct Document {
    /// The file.
    pub(super) source: Arc<ByteSource>,
    /// The file's type, one of those that were asked for.
    pub(super) kind: &'static str,
    /// The element below `VTKFile`.
    pub data: Element,
    /// The byte order of binary data.
    pub(super) big_endian: bool,
    /// Whether lengths are 64 bits wide.
    pub(super) wide: bool,
    pub(super) compressor: Compressor,
    pub(super) appended: Option<Appended>,
    /// The `header_type` and the compressor, for people.
    pub(super) layout: String,
}

impl Document {
    /// Reads the head of a file whose `type` is `kind`.
    ///
    /// # Errors
    /// [`Error::BadInput`] for what is no VTK XML file, or one of another type.
    pub fn open(source: &Arc<ByteSource>, kind: &'static str) -> Result<Self> {
        Self::open_one_of(source, &[kind])
    }

    /// Reads the head of a file whose `type` is one of `kinds`.
    ///
    /// # Errors
    /// [`Error::BadInput`] for what is no VTK XML file, or one of another type.
    pub(in crate::formats) fn open_one_of(source: &Arc<ByteSource>, kinds: &[&'static str]) -> Result<Self> {
        let (mut file, appended) = Parser::new(source)?.run()?;
        let path = source.path();
        let bad = |at: &str, expected: &str, got: String| Error::bad_input(path, at, expected, got);
        let attribute = |name: &str| file.attribute(name);
        let found = attribute("type").ok_or_else(|| bad("VTKFile", "an attribute 'type'", "none".into()))?;
        let Some(kind) = kinds.iter().copied().find(|k| *k == found) else {
            let expected = format!("type=\"{}\"", kinds.join("\" or \""));
            return Err(bad("VTKFile", &expected, what_is(found)).with_help(help_for(found)));
        };
        let big_endian = match attribute("byte_order") {
            Some("BigEndian") => true,
            Some("LittleEndian") | None => false,
            Some(x) => return Err(bad("byte_order", "LittleEndian or BigEndian", format!("'{x}'"))),
        };
        let wide = match attribute("header_type") {
            Some("UInt64") => true,
            Some("UInt32") | None => false,
            Some(x) => return Err(bad("header_type", "UInt32 or UInt64", format!("'{x}'"))),
        };
        let compressor = match attribute("compressor").unwrap_or_default() {
            "" => Compressor::None,
            "vtkZLibDataCompressor" => Compressor::Zlib,
            "vtkLZ4DataCompressor" => Compressor::Lz4,
            x => {
                let e = bad("compressor", "vtkZLibDataCompressor or vtkLZ4DataCompressor", format!("'{x}'"));
                return Err(e.with_help("write the file again with zlib, LZ4 or without compression"));
            }
        };
        let header = if wide { "UInt64" } else { "UInt32" };
        let packed = match compressor {
            Compressor::None => "uncompressed",
            Compressor::Zlib => "zlib",
            Compressor::Lz4 => "LZ4",
        };
        let layout = format!("{packed}, {header} header");
        let at = file.children.iter().position(|c| c.name == kind);
        let data = match at {
            Some(at) => file.children.swap_remove(at),
            None => return Err(bad("VTKFile", &format!("an element '{kind}'"), "none".into())),
        };
        Ok(Self { source: Arc::clone(source), kind, data, big_endian, wide, compressor, appended, layout })
    }

    /// An error at an element.
    pub fn wrong(&self, element: &Element, expected: impl Into<String>, got: impl Into<String>) -> Error {
        let name = element.attribute("Name").map_or(String::new(), |n| format!(" '{n}'"));
        Error::bad_input(
            self.source.path(),
            format!("{}{name} at byte {}", element.name, element.at),
            expected,
            got,
        )
    }

    /// All that decides how the bytes of arrays are read.
    pub(super) fn stored_as(&self) -> String {
        format!("{} {} {:?}", self.big_endian, self.wide, self.compressor)
    }

    /// Adds the text of an element to a hash, as it is stored.
    pub(super) fn hash_text(&self, element: &Element, hash: &mut Xxh3) -> Result<()> {
        let mut part = vec![0; 1 << 16];
        let Range { mut start, end } = element.text;
        while start < end {
            let n = (end - start).min(part.len() as u64) as usize;
            self.source.read_at(start, &mut part[..n])?;
            hash.update(&part[..n]);
            start += n as u64;
        }
        Ok(())
    }

    /// A list of `N` numbers in an attribute; `None` where there is no such attribute.
    pub(in crate::formats) fn numbers<T: std::str::FromStr + Copy + Default, const N: usize>(
        &self,
        element: &Element,
        name: &str,
    ) -> Result<Option<[T; N]>> {
        let Some(text) = element.attribute(name) else { return Ok(None) };
        let mut out = [T::default(); N];
        let mut words = text.split_ascii_whitespace();
        let filled = out.iter_mut().all(|x| match words.next().and_then(|w| w.parse().ok()) {
            Some(value) => {
                *x = value;
                true
            }
            None => false,
        });
        if filled && words.next().is_none() {
            return Ok(Some(out));
        }
        Err(self.wrong(element, format!("{N} numbers in {name}"), format!("'{text}'")))
    }

    /// A number in an attribute, or `default` where there is none.
    pub fn count(&self, element: &Element, name: &str, default: u64) -> Result<u64> {
        Ok(self.numbers::<u64, 1>(element, name)?.map_or(default, |[n]| n))
    }
}

/// A description of a file of another type, for messages.
fn what_is(kind: &str) -> String {
    let known = match kind {
        "ImageData" => "an image (.vti)",
        "PolyData" => "a surface (.vtp)",
        "UnstructuredGrid" => "an unstructured grid (.vtu)",
        "RectilinearGrid" => "a rectilinear grid (.vtr)",
        "StructuredGrid" => "a curvilinear grid (.vts)",
        "PImageData" => "the index of an image in several files (.pvti)",
        "vtkMultiBlockDataSet" | "vtkPartitionedDataSetCollection" | "vtkPartitionedDataSet" => {
            "a list of blocks in several files (.vtm, .vtpc, .vtpd)"
        }
        "Collection" => "a ParaView collection (.pvd)",
        _ if kind.starts_with('P') => "the index of data in several files",
        _ => return format!("type=\"{kind}\""),
    };
    format!("type=\"{kind}\": {known}")
}

fn help_for(kind: &str) -> &'static str {
    match kind {
        "PolyData" => "resample or convert it first",
        "Collection" => "name one of the files that it lists",
        _ if kind.starts_with('P') => "name one of the files that it lists, or write all in one",
        _ => "resample or convert it first",
    }
}

/// Builds the tree from the events of the XML reader.
struct Parser<'a> {
    source: &'a ByteSource,
    bytes: &'a [u8],
    /// Length of a byte order mark, which the XML reader does not see.
    base: u64,
    open: Vec<Element>,
    elements: usize,
}

impl<'a> Parser<'a> {
    fn new(source: &'a ByteSource) -> Result<Self> {
        let whole = source.slice(0..source.len())?;
        let bytes = whole.strip_prefix(b"\xef\xbb\xbf").unwrap_or(whole);
        let base = (whole.len() - bytes.len()) as u64;
        Ok(Self { source, bytes, base, open: vec![], elements: 0 })
    }

    /// The root element, and where appended data begin.
    fn run(mut self) -> Result<(Element, Option<Appended>)> {
        let mut reader = Reader::from_reader(self.bytes);
        loop {
            let before = reader.buffer_position();
            let event = reader.read_event();
            let after = reader.buffer_position();
            let event = event.map_err(|e| self.bad(reader.error_position(), e.to_string()))?;
            match event {
                Event::Start(tag) => {
                    let element = self.element(&tag, after)?;
                    if element.name == "AppendedData" && self.open.len() == 1 {
                        let appended = self.appended(&element, after)?;
                        return Ok((self.open.remove(0), Some(appended)));
                    }
                    self.open.push(element);
                    if self.open.len() > MOST_DEPTH {
                        return Err(self.bad(before, format!("elements nested deeper than {MOST_DEPTH}")));
                    }
                }
                Event::Empty(tag) => {
                    let element = self.element(&tag, after)?;
                    if let Some(root) = self.close(element) {
                        return Ok((root, None));
                    }
                }
                Event::End(_) => {
                    let Some(element) = self.open.pop() else {
                        return Err(self.bad(before, "an end tag without its start".into()));
                    };
                    if let Some(root) = self.close(element) {
                        return Ok((root, None));
                    }
                }
                Event::Text(_) => self.text(before, after),
                Event::Eof => return Err(self.bad(after, "the end of the file within it".into())),
                _ => {}
            }
        }
    }

    fn element(&mut self, tag: &BytesStart<'_>, after: u64) -> Result<Element> {
        self.elements += 1;
        if self.elements > MOST_ELEMENTS {
            return Err(self.bad(after, format!("more than {MOST_ELEMENTS} elements")));
        }
        if tag.len() > MOST_TAG {
            return Err(self.bad(after, format!("a tag of {} bytes", tag.len())));
        }
        let name = tag.name().as_ref().to_string();
        if self.open.is_empty() && name != "VTKFile" {
            return Err(self.bad(after, format!("an element '{name}'")));
        }
        let mut attributes = vec![];
        for attribute in tag.attributes() {
            let attribute = attribute.map_err(|e| self.bad(after, e.to_string()))?;
            let value = attribute.normalized_value(XmlVersion::Implicit1_0);
            let value = value.map_err(|e| self.bad(after, e.to_string()))?;
            attributes.push((attribute.key.as_ref().to_string(), value.into_owned()));
        }
        Ok(Element { name, attributes, at: self.base + after, ..Element::default() })
    }

    /// Hands an ended element to its parent, or returns it when it is the root.
    fn close(&mut self, element: Element) -> Option<Element> {
        match self.open.last_mut() {
            Some(parent) => {
                parent.children.push(element);
                None
            }
            None => Some(element),
        }
    }

    fn text(&mut self, start: u64, end: u64) {
        let blank = self.bytes[start as usize..end as usize].trim_ascii_start().is_empty();
        if let Some(element) = self.open.last_mut().filter(|e| !blank && e.text.is_empty()) {
            element.text = self.base + start..self.base + end;
        }
    }

    fn appended(&self, element: &Element, after: u64) -> Result<Appended> {
        let rest = &self.bytes[after as usize..];
        let blank = rest.len() - rest.trim_ascii_start().len();
        if rest.get(blank) != Some(&b'_') {
            return Err(self.bad(after, "AppendedData whose first byte is not '_'".into()));
        }
        let base64 = match element.attribute("encoding") {
            Some("raw") => false,
            Some("base64") => true,
            x => {
                let got = format!("AppendedData of encoding '{}'", x.unwrap_or_default());
                return Err(self.bad(after, got).with_help("the encodings are raw and base64"));
            }
        };
        Ok(Appended { start: self.base + after + blank as u64 + 1, base64 })
    }

    fn bad(&self, at: u64, got: String) -> Error {
        let at = Place::byte(self.base + at);
        Error::bad_input(self.source.path(), at, "the head of a VTK XML file", got)
    }
}
