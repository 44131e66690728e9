//! NRRD ("nearly raw raster data", Teem): a text header, then the samples, in the same file or in
//! others.
//!
//! ```text
//! NRRD0004                      magic and version, 1 to 6
//! # a comment
//! type: short                   "field: value" lines in any order
//! dimension: 3
//! sizes: 256 256 25             fastest axis first: x y z
//! space directions: (0.78,0,0) (0,-0.78,0) (0,0,6.5)      or   spacings: 0.78 0.78 6.5
//! space origin: (-99.6,99.6,-78)
//! endian: little
//! encoding: gzip                raw | gzip | ascii
//! modality:=MR                  "key:=value" lines are other programs' business
//!                               an empty line, then the samples; or
//! data file: brain.raw          a file | pattern first last step [dim] | LIST [dim], then a name on each line
//! ```
//!
//! `line skip` lines of the data file come before the samples, and then `byte skip` bytes, which
//! count decoded bytes in a compressed file; `byte skip: -1` means that the samples are the last
//! bytes. The reader takes three spatial axes of one number a sample. It refuses by name: other
//! numbers of axes, colour and vector axes, bzip2 and hex, compressed or text data in several
//! files.
//!
//! The format: <https://teem.sourceforge.net/nrrd/format.html>.

use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::formats::shared::format::{Format, Head};
use crate::formats::shared::header::{
    Lines, geometry, numbered_files, numbers, open_files, plain_info, scaled_axes,
};
use crate::formats::shared::stream::{ByteSlabs, Codec, Tail, TextSlabs, sample_bytes};
use crate::formats::shared::{OpenOptions, pick_field};
use crate::grid::Geometry;
use crate::volume::strided::StridedVolume;
use crate::volume::units::{Unit, Units, common};
use crate::volume::{Assumed, ScalarType, VolumeInfo, VolumeSource};
use std::io;
use std::path::Path;
use std::sync::Arc;

/// NRRD.
pub(in crate::formats) struct Nrrd;

impl Format for Nrrd {
    fn name(&self) -> &'static str {
        "an NRRD file"
    }

    fn suffixes(&self) -> &'static [&'static str] {
        &[".nrrd", ".nhdr"]
    }

    fn is_on_servers(&self) -> bool {
        true
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        head.bytes.starts_with(b"NRRD000")
    }

    fn volume(&self, path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
        open(path, options)
    }
}

/// Opens an NRRD file, attached (`.nrrd`) or detached (`.nhdr`).
///
/// # Errors
/// [`Error::BadInput`] when it is malformed, cut short, or of a kind that is not read.
pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    let source = Arc::new(ByteSource::open(path, options.io)?);
    let header = Header::parse(&source)?;
    let (dims, scalar) = (header.dims()?, header.scalar()?);
    let data = header.data(Arc::clone(&source), dims, options.io)?;
    let encoding = header.encoding()?;
    let place = if header.get("datafile").is_some() { "detached" } else { "attached" };
    let format = format!("NRRD ({place}, {})", encoding.name());
    let mut info = plain_info(path, format, dims, scalar, header.geometry(dims)?);
    info.assumed = Assumed::in_header(header.assumed());
    info.units = header.units();
    pick_field(path, &info.fields, options.field.as_deref())?;
    header.samples(info, data, encoding)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Raw,
    Gzip,
    Ascii,
}

impl Encoding {
    fn name(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::Gzip => "gzip",
            Self::Ascii => "ascii",
        }
    }
}

/// The files that hold the samples, front to back.
struct Data {
    parts: Vec<Arc<ByteSource>>,
    /// The first byte of data in each, before any skip.
    start: u64,
}

/// The header's lines.
struct Header<'a> {
    path: &'a Path,
    /// Field names in lower case and without blanks ("spacedirections"), and their values.
    fields: Vec<(String, String)>,
    /// Names that follow a "data file: LIST".
    listed: Vec<String>,
    /// The byte after the header.
    end: u64,
}

impl<'a> Header<'a> {
    fn parse(source: &'a ByteSource) -> Result<Self> {
        let path = source.path();
        let mut lines = Lines::new(source.head_from(0)?);
        let magic = lines.next().unwrap_or_default();
        if !matches!(
            magic.strip_prefix("NRRD000").map(str::trim_end),
            Some("1" | "2" | "3" | "4" | "5" | "6")
        ) {
            return Err(Error::bad_input(path, "first line", "NRRD0001 to NRRD0006", magic));
        }
        let mut header = Self { path, fields: vec![], listed: vec![], end: 0 };
        let mut listing = false;
        while let Some(line) = lines.next() {
            if line.is_empty() {
                break;
            }
            if listing {
                header.listed.push(line.trim().to_string());
            } else if !line.starts_with('#') {
                listing = header.take(&line, lines.number)?;
            }
        }
        header.end = lines.at as u64;
        Ok(header)
    }

    /// Takes a line; `true` when the lines after it are names of data files.
    fn take(&mut self, line: &str, number: usize) -> Result<bool> {
        if line.split_once(":=").is_some_and(|(key, _)| !key.contains(": ")) {
            return Ok(false);
        }
        let at = format!("line {number}");
        let Some((name, value)) = line.split_once(':') else {
            return Err(Error::bad_input(self.path, at, "\"field: value\" or an empty line", line)
                .with_help("the header must end with an empty line"));
        };
        let name: String = name.to_ascii_lowercase().split_whitespace().collect();
        if self.get(&name).is_some() {
            return Err(Error::bad_input(self.path, at, "each field once", line));
        }
        let listing = name == "datafile" && value.split_whitespace().next() == Some("LIST");
        self.fields.push((name, value.trim().to_string()));
        Ok(listing)
    }

    fn get(&self, name: &str) -> Option<&str> {
        self.fields.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }

    fn require(&self, name: &str) -> Result<&str> {
        let missing = || Error::bad_input(self.path, "header", format!("a field \"{name}\""), "none");
        self.get(name).ok_or_else(missing)
    }

    fn dims(&self) -> Result<[u64; 3]> {
        let [n] = numbers::<u32, 1>(self.path, "dimension", self.require("dimension")?)?;
        if n != 3 {
            return Err(Error::bad_input(self.path, "dimension", "3", n.to_string()).with_help(
                "only volumes with one number a sample are read; cut out one, e.g. with `unu slice`",
            ));
        }
        let kinds: Vec<&str> = self.get("kinds").unwrap_or("").split_whitespace().collect();
        let spatial = ["domain", "space", "time", "none", "???"];
        if let Some(kind) = kinds.iter().find(|k| !spatial.contains(&k.to_ascii_lowercase().as_str())) {
            return Err(Error::bad_input(self.path, "kinds", "three spatial axes", *kind).with_help(
                "colours, vectors and lists are not read; cut out one component, e.g. with `unu slice`",
            ));
        }
        numbers(self.path, "sizes", self.require("sizes")?)
    }

    fn scalar(&self) -> Result<ScalarType> {
        let name = self.require("type")?.to_ascii_lowercase();
        let words: Vec<&str> = name.split_whitespace().collect();
        Ok(match words.join(" ").as_str() {
            "signed char" | "int8" | "int8_t" => ScalarType::I8,
            "uchar" | "unsigned char" | "uint8" | "uint8_t" => ScalarType::U8,
            "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
                ScalarType::I16
            }
            "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => ScalarType::U16,
            "int" | "signed int" | "int32" | "int32_t" => ScalarType::I32,
            "uint" | "unsigned int" | "uint32" | "uint32_t" => ScalarType::U32,
            "longlong"
            | "long long"
            | "long long int"
            | "signed long long"
            | "signed long long int"
            | "int64"
            | "int64_t" => ScalarType::I64,
            "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => {
                ScalarType::U64
            }
            "float" => ScalarType::F32,
            "double" => ScalarType::F64,
            _ => {
                return Err(Error::bad_input(
                    self.path,
                    "type",
                    "an integer of 8 to 64 bits, float or double",
                    name,
                ));
            }
        })
    }

    fn encoding(&self) -> Result<Encoding> {
        let name = self.require("encoding")?.to_ascii_lowercase();
        match name.as_str() {
            "raw" => Ok(Encoding::Raw),
            "gzip" | "gz" => Ok(Encoding::Gzip),
            "ascii" | "text" | "txt" => Ok(Encoding::Ascii),
            _ => Err(Error::bad_input(self.path, "encoding", "raw, gzip or ascii", &*name)
                .with_help("write it again with one of these, e.g. `unu save -f nrrd -e gzip`")),
        }
    }

    fn big_endian(&self, scalar: ScalarType) -> Result<bool> {
        match self.get("endian").map(str::to_ascii_lowercase).as_deref() {
            Some("little") => Ok(false),
            Some("big") => Ok(true),
            None if scalar.bytes() == 1 => Ok(false),
            got => Err(Error::bad_input(self.path, "endian", "little or big", got.unwrap_or("none"))),
        }
    }

    fn geometry(&self, dims: [u64; 3]) -> Result<Geometry> {
        let origin = match self.get("spaceorigin") {
            Some(text) => self.vectors("space origin", text, 1)?[0],
            None => [0.0; 3],
        };
        if let Some(text) = self.get("spacedirections") {
            let columns = self.vectors("space directions", text, 3)?;
            return geometry(self.path, "space directions", origin, [columns[0], columns[1], columns[2]]);
        }
        let (spacing, start) = self.per_axis(dims)?;
        let origin = if self.get("spaceorigin").is_some() { origin } else { start };
        geometry(self.path, "spacings", origin, scaled_axes(spacing))
    }

    /// The units of values, and of lengths where all axes have the same one.
    fn units(&self) -> Units {
        let names = |name: &str| {
            let text = self.get(name).unwrap_or_default();
            // Each in quotes.
            let quoted: Vec<&str> = text.split('"').skip(1).step_by(2).collect();
            if quoted.len() == 3 { common(quoted.into_iter().map(Unit::length)) } else { None }
        };
        let length = names(if self.get("space").or(self.get("spacedimension")).is_some() {
            "spaceunits"
        } else {
            "units"
        });
        let value = self.get("sampleunits").and_then(|text| Unit::new(text.trim_matches('"')));
        Units { value, length, time: None }
    }

    /// Axes whose spacing is not known.
    fn assumed(&self) -> [bool; 3] {
        let is_known = |name: &str, axis: usize| {
            let word = self.get(name).and_then(|text| text.split_whitespace().nth(axis));
            word.is_some_and(|word| !word.eq_ignore_ascii_case("nan"))
        };
        let has_ends = |axis: usize| is_known("axismins", axis) && is_known("axismaxs", axis);
        let has_directions = self.get("spacedirections").is_some();
        std::array::from_fn(|axis| !has_directions && !is_known("spacings", axis) && !has_ends(axis))
    }

    /// Spacing and first position of each axis from `spacings`, `axis mins`, `axis maxs`; NaN means
    /// unknown there.
    fn per_axis(&self, dims: [u64; 3]) -> Result<([f64; 3], [f64; 3])> {
        let read = |name: &str, label: &str| match self.get(name) {
            Some(text) => numbers::<f64, 3>(self.path, label, text),
            None => Ok([f64::NAN; 3]),
        };
        let (given, mins, maxs) =
            (read("spacings", "spacings")?, read("axismins", "axis mins")?, read("axismaxs", "axis maxs")?);
        let (mut spacing, mut start) = ([1.0; 3], [0.0; 3]);
        let centers: Vec<&str> =
            self.get("centers").or(self.get("centerings")).unwrap_or("").split_whitespace().collect();
        for a in 0..3 {
            // A cell-centred axis goes from the outer face of its first sample to that of its last.
            let cell = centers.get(a).is_some_and(|c| *c == "cell");
            let steps = if cell { dims[a] } else { dims[a].saturating_sub(1).max(1) } as f64;
            if !given[a].is_nan() {
                spacing[a] = given[a];
            } else if !mins[a].is_nan() && !maxs[a].is_nan() {
                spacing[a] = (maxs[a] - mins[a]) / steps;
            }
            if !mins[a].is_nan() {
                start[a] = mins[a] + if cell { 0.5 * spacing[a] } else { 0.0 };
            }
        }
        Ok((spacing, start))
    }

    /// `count` vectors "(x,y,z)".
    fn vectors(&self, at: &str, text: &str, count: usize) -> Result<Vec<[f64; 3]>> {
        let wrong = || {
            Error::bad_input(self.path, at, format!("{count} vector(s) of the form (x,y,z)"), text)
                .with_help("axes without a direction (colours, vectors, time) are not read")
        };
        let (mut vectors, mut rest) = (vec![], text.trim());
        while !rest.is_empty() {
            let (inside, after) = rest.strip_prefix('(').and_then(|r| r.split_once(')')).ok_or_else(wrong)?;
            let parts =
                inside.split(',').map(|x| x.trim().parse()).collect::<std::result::Result<Vec<f64>, _>>();
            vectors.push(parts.ok().and_then(|p| p.try_into().ok()).ok_or_else(wrong)?);
            rest = after.trim_start();
        }
        if vectors.len() == count { Ok(vectors) } else { Err(wrong()) }
    }

    /// The files that hold the samples.
    fn data(&self, header: Arc<ByteSource>, dims: [u64; 3], io: IoMode) -> Result<Data> {
        let Some(value) = self.get("datafile") else {
            return Ok(Data { parts: vec![header], start: self.end });
        };
        let words: Vec<&str> = value.split_whitespace().collect();
        let (names, dim) = match words[..] {
            ["LIST"] => (self.listed.clone(), None),
            ["LIST", dim] => (self.listed.clone(), Some(dim)),
            [pattern, a, b, c, dim] if pattern.contains('%') => {
                (numbered_files(self.path, "data file", value, &[pattern, a, b, c])?, Some(dim))
            }
            [pattern, ..] if words.len() == 4 && pattern.contains('%') => {
                (numbered_files(self.path, "data file", value, &words)?, None)
            }
            _ => (vec![value.to_string()], Some("3")),
        };
        if !matches!(dim, None | Some("2" | "3"))
            || names.is_empty()
            || !dims[2].is_multiple_of(names.len() as u64)
        {
            let got = format!("{} file(s) for {} slices: {value}", names.len(), dims[2]);
            return Err(Error::bad_input(
                self.path,
                "data file",
                "the same number of whole slices in every file",
                got,
            ));
        }
        Ok(Data { parts: open_files(self.path, "data file", &names, io)?, start: 0 })
    }

    fn samples(&self, mut info: VolumeInfo, data: Data, encoding: Encoding) -> Result<VolumeSource> {
        info.data_files = data.parts.iter().map(|p| p.path().to_path_buf()).collect();
        let scalar = info.field.scalar;
        let needed = sample_bytes(self.path, info.dims, scalar)?;
        let parts = data.parts.len() as u64;
        let [byte_skip] = numbers::<i64, 1>(self.path, "byte skip", self.get("byteskip").unwrap_or("0"))?;
        if byte_skip < -1 {
            return Err(Error::bad_input(self.path, "byte skip", "-1, 0 or more", byte_skip.to_string()));
        }
        let first = &data.parts[0];
        if encoding == Encoding::Raw {
            let offset = match u64::try_from(byte_skip) {
                Ok(skip) => self.skip_lines(first, data.start)?.saturating_add(skip),
                Err(_) => self.last_bytes(first, needed / parts)?,
            };
            let strides = StridedVolume::packed_strides(info.dims, scalar).expect("fewer than 2^63 bytes");
            let (slices, big) = (info.dims[2] / parts, self.big_endian(scalar)?);
            self.same_layout(&data.parts)?;
            let volume = StridedVolume::stacked(info, data.parts, slices, offset, big, strides)?;
            return Ok(volume.source());
        }
        if parts > 1 {
            let got = format!("{parts} files of {} data", encoding.name());
            return Err(Error::bad_input(
                self.path,
                "data file",
                "one file, or several with encoding raw",
                got,
            )
            .with_help("join them, e.g. with `unu save -f nrrd -e gzip`"));
        }
        let start = self.skip_lines(first, data.start)?;
        if encoding == Encoding::Ascii {
            let start = start.saturating_add(u64::try_from(byte_skip).unwrap_or(0));
            let range = start..first.len().max(start);
            return Ok(VolumeSource::Stream(Box::new(TextSlabs::new(info, Arc::clone(first), range)?)));
        }
        let range = start..first.len();
        let skip = match u64::try_from(byte_skip) {
            Ok(skip) => skip,
            Err(_) => self.decoded_before(first, start, needed)?,
        };
        let big = self.big_endian(scalar)?;
        let slabs = ByteSlabs::new(info, first, range, Codec::Gzip, skip, big, Tail::Nothing)?;
        Ok(VolumeSource::Stream(Box::new(slabs)))
    }

    /// Slices in several files all start at the same byte, so skips that depend on a file's content
    /// need one file or files of one length.
    fn same_layout(&self, parts: &[Arc<ByteSource>]) -> Result<()> {
        let depends = self.get("byteskip") == Some("-1") || !matches!(self.get("lineskip"), None | Some("0"));
        match parts.iter().find(|p| depends && p.len() != parts[0].len()) {
            Some(odd) => {
                let expected = format!("{} bytes, as in the first of the data files", parts[0].len());
                Err(Error::bad_input(
                    odd.path(),
                    "length of the file",
                    expected,
                    format!("{} bytes", odd.len()),
                ))
            }
            None => Ok(()),
        }
    }

    /// The byte after the lines to skip.
    fn skip_lines(&self, source: &ByteSource, start: u64) -> Result<u64> {
        let [count] = numbers::<u64, 1>(self.path, "line skip", self.get("lineskip").unwrap_or("0"))?;
        let rest = source.head_from(start)?;
        let mut at = 0;
        for skipped in 0..count {
            let end = rest[at..].iter().position(|&b| b == b'\n');
            let got = || format!("{skipped} lines");
            at += 1 + end.ok_or_else(|| {
                Error::bad_input(source.path(), "line skip", format!("{count} lines to skip"), got())
            })?;
        }
        Ok(start + at as u64)
    }

    /// Where the last `needed` bytes of a file start.
    fn last_bytes(&self, source: &ByteSource, needed: u64) -> Result<u64> {
        source.len().checked_sub(needed).ok_or_else(|| {
            let expected = format!("{needed} bytes of samples");
            Error::bad_input(source.path(), "samples", expected, format!("a file of {} bytes", source.len()))
                .with_help("the file is cut short, or its sizes or type are wrong")
        })
    }

    /// Decoded bytes before the last `needed` ones; decodes the file once to count them.
    fn decoded_before(&self, source: &Arc<ByteSource>, start: u64, needed: u64) -> Result<u64> {
        let mut decoded = Codec::Gzip.reader(source, start..source.len())?;
        let total = io::copy(&mut decoded, &mut io::sink()).map_err(|e| {
            Error::bad_input(source.path(), "samples", "good gzip data", e.to_string())
                .with_help("the file is damaged or cut short; fetch it again")
        })?;
        total.checked_sub(needed).ok_or_else(|| {
            let got = format!("{total} bytes after decoding");
            Error::bad_input(source.path(), "samples", format!("{needed} bytes of samples"), got)
                .with_help("the file is cut short, or its sizes or type are wrong")
        })
    }
}

#[cfg(test)]
mod tests;
