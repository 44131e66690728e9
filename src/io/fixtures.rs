//! What tests of several crates make files with: VTK's XML in every encoding, and damage.

use base64::prelude::{BASE64_STANDARD, Engine};
use std::io::Write;

/// Cuts at every length and flips bytes: a reader gives an error or a surface, and does not
/// panic.
pub fn survive(bytes: &[u8], read: impl Fn(&[u8])) {
    for cut in 0..bytes.len() {
        read(&bytes[..cut]);
    }
    for at in 0..bytes.len() {
        for flip in [0x01, 0x10, 0x80, 0xff] {
            let mut bad = bytes.to_vec();
            bad[at] ^= flip;
            read(&bad);
        }
    }
}

/// How arrays are stored in a fixture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoding {
    /// "ascii", "binary", "raw" or "base64" (appended).
    pub format: &'static str,
    /// "", "ZLib" or "LZ4".
    pub compressor: &'static str,
    /// Whether the highest byte comes first.
    pub big_endian: bool,
    /// Whether lengths have 64 bits.
    pub wide: bool,
    /// Bytes of a block; some divide the arrays' lengths, some do not.
    pub block: usize,
}

/// Ascii first, then all combinations of the binary ones.
pub fn every_encoding() -> Vec<Encoding> {
    let mut all =
        vec![Encoding { format: "ascii", compressor: "", big_endian: false, wide: false, block: 0 }];
    for format in ["binary", "raw", "base64"] {
        for (compressor, block) in [("", 0), ("ZLib", 20), ("ZLib", 24), ("LZ4", 20), ("LZ4", 1 << 15)] {
            for big_endian in [false, true] {
                for wide in [false, true] {
                    all.push(Encoding { format, compressor, big_endian, wide, block });
                }
            }
        }
    }
    all
}

/// A number type of a fixture's array.
pub trait Number: Copy + std::fmt::Display {
    /// Its name in a file.
    const NAME: &'static str;
    /// Its bytes, the lowest first.
    fn le(self) -> Vec<u8>;
}

macro_rules! numbers {
    ($($t:ty, $name:literal;)*) => {$(
        impl Number for $t {
            const NAME: &'static str = $name;
            fn le(self) -> Vec<u8> {
                self.to_le_bytes().to_vec()
            }
        }
    )*};
}
numbers! {
    u8, "UInt8"; i8, "Int8"; u16, "UInt16"; i16, "Int16"; u32, "UInt32"; i32, "Int32"; u64, "UInt64"; i64, "Int64";
    f32, "Float32"; f64, "Float64";
}

/// A file being made.
pub struct Fixture {
    encoding: Encoding,
    kind: String,
    head: String,
    appended: Vec<u8>,
}

impl Encoding {
    /// Begins a file of a type; `attributes` are those of the element below `VTKFile`.
    pub fn file(self, kind: &str, attributes: &str) -> Fixture {
        let order = if self.big_endian { "BigEndian" } else { "LittleEndian" };
        let header = if self.wide { "UInt64" } else { "UInt32" };
        let compressor = match self.compressor {
            "" => String::new(),
            name => format!(" compressor=\"vtk{name}DataCompressor\""),
        };
        let head = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"{kind}\" version=\"1.0\" byte_order=\"{order}\" \
             header_type=\"{header}\"{compressor}>\n<{kind} {attributes}>\n"
        );
        Fixture { encoding: self, kind: kind.into(), head, appended: vec![] }
    }

    fn word(self, n: usize) -> Vec<u8> {
        let mut bytes = if self.wide { (n as u64).le() } else { (n as u32).le() };
        if self.big_endian {
            bytes.reverse();
        }
        bytes
    }

    /// The header and the data, which base64 encodes apart.
    fn pack(self, data: &[u8]) -> [Vec<u8>; 2] {
        if self.compressor.is_empty() {
            return [vec![], [self.word(data.len()), data.to_vec()].concat()];
        }
        let blocks: Vec<&[u8]> = data.chunks(self.block).collect();
        let packed: Vec<Vec<u8>> = blocks.iter().map(|b| self.compress(b)).collect();
        let numbers = [blocks.len(), self.block, data.len() % self.block];
        let lengths = packed.iter().map(Vec::len);
        let header = numbers.into_iter().chain(lengths).flat_map(|n| self.word(n)).collect();
        [header, packed.concat()]
    }

    fn compress(self, block: &[u8]) -> Vec<u8> {
        if self.compressor == "LZ4" {
            return lz4_flex::block::compress(block);
        }
        let mut zlib = flate2::write::ZlibEncoder::new(vec![], flate2::Compression::default());
        zlib.write_all(block).unwrap();
        zlib.finish().unwrap()
    }
}

impl Fixture {
    /// Adds text.
    pub fn text(&mut self, text: &str) {
        self.head += text;
    }

    /// Adds an array, as the encoding says.
    pub fn array<T: Number>(&mut self, name: &str, components: u32, values: &[T]) {
        let e = self.encoding;
        let start = format!(
            "<DataArray type=\"{}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=",
            T::NAME
        );
        self.head += &start;
        if e.format == "ascii" {
            let words: Vec<String> = values.iter().map(ToString::to_string).collect();
            self.head += &format!("\"ascii\">\n {}\n</DataArray>\n", words.join(" "));
            return;
        }
        let stored = |v: &T| if e.big_endian { v.le().into_iter().rev().collect() } else { v.le() };
        let parts = e.pack(&values.iter().flat_map(stored).collect::<Vec<u8>>());
        let text = parts.each_ref().map(|p| BASE64_STANDARD.encode(p)).concat();
        let offset = self.appended.len();
        match e.format {
            "binary" => self.head += &format!("\"binary\">\n  {text}\n<InformationKey/></DataArray>\n"),
            "raw" => self.appended.extend(parts.concat()),
            _ => self.appended.extend(text.into_bytes()),
        }
        if e.format != "binary" {
            self.head += &format!("\"appended\" offset=\"{offset}\"/>\n");
        }
    }

    /// The bytes of the file.
    pub fn finish(self) -> Vec<u8> {
        let mut out = format!("{}</{}>\n", self.head, self.kind).into_bytes();
        if matches!(self.encoding.format, "raw" | "base64") {
            out.extend(format!("<AppendedData encoding=\"{}\">\n  _", self.encoding.format).into_bytes());
            out.extend(self.appended);
            out.extend(b"\n</AppendedData>\n");
        }
        out.extend(b"</VTKFile>\n");
        out
    }
}
