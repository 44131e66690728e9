//! MetaImage (MetaIO; ITK, VTK, elastix): a text header, then the samples, in the same file
//! (`.mha`) or others (`.mhd`).
//!
//! ```text
//! NDims = 3                          "Key = Value" lines in any order, but ElementDataFile is the last
//! DimSize = 115 157 129              x fastest
//! ElementType = MET_SHORT
//! ElementSpacing = 1.366 1.366 2.5
//! DistanceUnits = mm                 um, mm or cm
//! Offset = -153.8 -150.4 -1434.5     or Position, or Origin: the first sample, in the world
//! TransformMatrix = 1 0 0 0 1 0 0 0 1    the direction of each index axis, one after the other
//! BinaryDataByteOrderMSB = False     or ElementByteOrderMSB
//! CompressedData = True              zlib
//! CompressedDataSize = 2949155
//! HeaderSize = 0                     bytes to skip in a data file; -1: the samples are its last bytes
//! ElementDataFile = LOCAL            the samples follow; or a file name; or slices:
//! ElementDataFile = slice%03d.raw 1 129 1       a pattern and first, last and step of the numbers
//! ElementDataFile = LIST             or a name on each of the lines that follow
//! ```
//!
//! `BinaryData = False` is text. Bytes after the last sample are ignored, as MetaIO does. A fourth
//! axis is one of time: its volumes are the fields "t0", "t1", …, with times by its spacing and
//! offset. The reader refuses by name: other numbers of axes, a fourth axis that is not at right
//! angles to space, several channels, arrays, compressed or text data in several files, a series as
//! text. `ElementToIntensityFunctionSlope` and `…Offset` are ignored, as ITK and VTK
//! do.
//!
//! The format: <https://itk.org/Wiki/ITK/MetaIO/Documentation>.

use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::frames;
use crate::formats::shared::header::{Lines, geometry, numbered_files, numbers, open_files, plain_info};
use crate::formats::shared::packed::PackedFrames;
use crate::formats::shared::stream::{Codec, Tail, TextSlabs, sample_bytes};
use crate::formats::shared::{Frames, OpenOptions, known_times};
use crate::grid::Geometry;
use crate::volume::strided::StridedVolume;
use crate::volume::units::{Unit, Units};
use crate::volume::{Assumed, ScalarType, VolumeInfo, VolumeSource};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

/// MetaImage.
pub(in crate::formats) struct MetaImage;

static ABOUT: About = About {
    volumes: &["MetaImage"],
    suffixes: &[".mha", ".mhd"],
    on_servers: true,
    ..About::named("a MetaImage file")
};

impl Format for MetaImage {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let source = head.file()?;
        let header = MetaImageHeader::parse(source)?;
        let ([dims, [frames, ..]], scalar) = (header.dims()?, header.scalar()?);
        let bytes = sample_bytes(head.path, [dims[0], dims[1], dims[2].saturating_mul(frames)], scalar)?;
        let encoding = header.encoding()?;
        let (parts, start) = header.parts(source, head.io, bytes)?;
        Ok(Box::new(MetaImageFile { header, dims, frames, scalar, encoding, parts, start }))
    }
}

/// A MetaImage file.
struct MetaImageFile {
    header: MetaImageHeader,
    /// Samples along x, y, z.
    dims: [u64; 3],
    /// Volumes.
    frames: u64,
    scalar: ScalarType,
    encoding: MetaImageEncoding,
    /// The files of the samples, and where these begin in each.
    parts: Vec<Arc<ByteSource>>,
    start: u64,
}

impl Dataset for MetaImageFile {
    fn files(&self) -> Vec<PathBuf> {
        self.parts.iter().map(|part| part.path().to_path_buf()).collect()
    }

    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let header = &self.header;
        let place = if header.is_local()? { "attached" } else { "detached" };
        let format = format!("MetaImage ({place}, {})", self.encoding.name());
        let mut info = plain_info(&header.path, format, self.dims, self.scalar, header.geometry()?);
        info.assumed = Assumed::in_header([header.any(&SPACING).is_none(); 3]);
        let unit = header.get("DistanceUnits").filter(|unit| ["um", "mm", "cm"].contains(unit));
        info.units = Units::of_length(unit.and_then(Unit::length));
        frames::check_last(self.frames, options, |options| self.volume(options))?;
        let (frame, fields) = frames::choose(&header.path, self.frames, self.scalar, options)?;
        (info.field, info.fields) = (fields[frame as usize].clone(), fields);
        self.samples(info, frame)
    }

    fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        // A name is that of one frame.
        if options.field.is_some() { Ok(vec![]) } else { self.all_steps(options) }
    }

    fn times(&self, options: &OpenOptions) -> Result<HashMap<String, f64>> {
        self.all_steps(options).map(known_times)
    }

    fn packed_steps(&self, options: &OpenOptions) -> Result<Option<(PackedFrames, VolumeInfo)>> {
        if self.frames == 1 || self.encoding != MetaImageEncoding::Zlib {
            return Ok(None);
        }
        let info = self.volume(&frames::first(options))?.info().clone();
        Ok(Some((self.packed(self.only_part()?)?, info)))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum MetaImageEncoding {
    Raw,
    Zlib,
    Text,
}

impl MetaImageEncoding {
    fn name(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::Zlib => "zlib",
            Self::Text => "text",
        }
    }
}

/// The keys of the place of the first sample.
const OFFSET: [&str; 3] = ["Offset", "Position", "Origin"];

/// The keys of the spacing.
const SPACING: [&str; 2] = ["ElementSpacing", "ElementSize"];

struct MetaImageHeader {
    path: PathBuf,
    fields: Vec<(String, String)>,
    /// The lines after the header, where it ends with a LIST.
    listed: Vec<String>,
    /// The byte after the header.
    end: u64,
}

impl MetaImageHeader {
    fn parse(source: &ByteSource) -> Result<Self> {
        let path = source.path();
        let mut lines = Lines::new(source.head_from(0)?);
        let mut header = Self { path: path.to_path_buf(), fields: vec![], listed: vec![], end: 0 };
        while header.get("ElementDataFile").is_none() {
            let at = |n: usize| format!("line {n}");
            let Some(line) = lines.next() else {
                let expected = "a last line \"ElementDataFile = …\"";
                return Err(Error::bad_input(path, at(lines.number + 1), expected, "the end of the text"));
            };
            if line.trim().is_empty() || line.starts_with('#') {
                continue;
            }
            let Some((key, value)) = line.split_once(['=', ':']) else {
                return Err(Error::bad_input(path, at(lines.number), "\"Key = Value\"", line));
            };
            if header.get(key.trim()).is_some() {
                return Err(Error::bad_input(path, at(lines.number), "each key once", line));
            }
            header.fields.push((key.trim().into(), value.trim().into()));
        }
        header.end = lines.at as u64;
        if header.require("ElementDataFile")?.split_whitespace().next() == Some("LIST") {
            let names = std::iter::from_fn(|| lines.next()).map(|l| l.trim().to_string());
            header.listed = names.filter(|l| !l.is_empty()).collect();
        }
        Ok(header)
    }

    fn get(&self, key: &str) -> Option<&str> {
        self.fields.iter().find(|(k, _)| k == key).map(|(_, v)| v.as_str())
    }

    /// The value of the first of several names of one thing.
    fn any(&self, keys: &[&'static str]) -> Option<(&'static str, &str)> {
        keys.iter().find_map(|&k| Some((k, self.get(k)?)))
    }

    fn require(&self, key: &str) -> Result<&str> {
        self.get(key).ok_or_else(|| Error::bad_input(&self.path, "header", format!("a key {key}"), "none"))
    }

    fn flag(&self, keys: &[&'static str], default: bool) -> Result<bool> {
        let Some((key, value)) = self.any(keys) else { return Ok(default) };
        match value.to_ascii_lowercase().as_str() {
            "true" | "t" | "1" | "yes" => Ok(true),
            "false" | "f" | "0" | "no" => Ok(false),
            _ => Err(Error::bad_input(&self.path, key, "True or False", value)),
        }
    }

    fn integer<T: std::str::FromStr + Copy + Default>(&self, key: &str, default: &str) -> Result<T> {
        Ok(numbers::<T, 1>(&self.path, key, self.get(key).unwrap_or(default))?[0])
    }

    /// Axes: 3, or 4 of a series.
    fn axes(&self) -> Result<usize> {
        let [n] = numbers::<u32, 1>(&self.path, "NDims", self.require("NDims")?)?;
        match n {
            3 | 4 => Ok(n as usize),
            _ => Err(Error::bad_input(&self.path, "NDims", "3, or 4 for a series", n.to_string())
                .with_help("only volumes are read; cut out one")),
        }
    }

    /// Samples along x, y, z, and volumes.
    fn dims(&self) -> Result<[[u64; 3]; 2]> {
        if let Some(kind) = self.get("ObjectType").filter(|k| !k.eq_ignore_ascii_case("Image")) {
            return Err(Error::bad_input(&self.path, "ObjectType", "Image", kind));
        }
        let axes = self.axes()?;
        let channels: u32 = self.integer("ElementNumberOfChannels", "1")?;
        if channels != 1 {
            return Err(Error::bad_input(&self.path, "ElementNumberOfChannels", "1", channels.to_string())
                .with_help("colours and vectors are not read; write one component to a file of its own"));
        }
        let sizes = self.require("DimSize")?;
        if axes == 3 {
            return Ok([numbers(&self.path, "DimSize", sizes)?, [1; 3]]);
        }
        let [x, y, z, frames] = numbers::<u64, 4>(&self.path, "DimSize", sizes)?;
        frames::check_count(&self.path, "DimSize", frames)?;
        Ok([[x, y, z], [frames, 1, 1]])
    }

    /// The numbers of a key, one for each of at most four axes.
    fn per_axis(&self, keys: &[&'static str], default: f64) -> Result<[f64; 4]> {
        let Some((key, text)) = self.any(keys) else { return Ok([default; 4]) };
        if self.axes()? == 4 {
            return numbers(&self.path, key, text);
        }
        let [x, y, z] = numbers(&self.path, key, text)?;
        Ok([x, y, z, default])
    }

    /// The time of the first volume, and from each to the next.
    fn times(&self) -> Result<[f64; 2]> {
        let [.., start] = self.per_axis(&OFFSET, 0.0)?;
        let [.., step] = self.per_axis(&SPACING, 1.0)?;
        Ok([start, step])
    }

    /// The directions of the axes of space.
    fn directions(&self) -> Result<[[f64; 3]; 3]> {
        let usual: [[f64; 3]; 3] = std::array::from_fn(|a| std::array::from_fn(|b| f64::from(a == b)));
        let Some((key, text)) = self.any(&["TransformMatrix", "Rotation", "Orientation"]) else {
            return Ok(usual);
        };
        if self.axes()? == 3 {
            let matrix = numbers::<f64, 9>(&self.path, key, text)?;
            return Ok(std::array::from_fn(|a| std::array::from_fn(|b| matrix[3 * a + b])));
        }
        let matrix = numbers::<f64, 16>(&self.path, key, text)?;
        let is_apart = (0..3).all(|a| matrix[4 * a + 3] == 0.0 && matrix[12 + a] == 0.0);
        if !is_apart || matrix[15] != 1.0 {
            let expected = "a fourth axis at right angles to those of space (0 0 0 1)";
            return Err(Error::bad_input(&self.path, key, expected, text));
        }
        Ok(std::array::from_fn(|a| std::array::from_fn(|b| matrix[4 * a + b])))
    }

    fn scalar(&self) -> Result<ScalarType> {
        Ok(match self.require("ElementType")? {
            "MET_CHAR" | "MET_ASCII_CHAR" => ScalarType::I8,
            "MET_UCHAR" => ScalarType::U8,
            "MET_SHORT" => ScalarType::I16,
            "MET_USHORT" => ScalarType::U16,
            // MetaIO's long has 4 bytes on every system.
            "MET_INT" | "MET_LONG" => ScalarType::I32,
            "MET_UINT" | "MET_ULONG" => ScalarType::U32,
            "MET_LONG_LONG" => ScalarType::I64,
            "MET_ULONG_LONG" => ScalarType::U64,
            "MET_FLOAT" => ScalarType::F32,
            "MET_DOUBLE" => ScalarType::F64,
            other => {
                let expected = "MET_CHAR to MET_ULONG_LONG, MET_FLOAT or MET_DOUBLE";
                return Err(Error::bad_input(&self.path, "ElementType", expected, other));
            }
        })
    }

    fn encoding(&self) -> Result<MetaImageEncoding> {
        let binary = self.flag(&["BinaryData"], true)?;
        let compressed = self.flag(&["CompressedData"], false)?;
        Ok(match (binary, compressed) {
            (true, false) => MetaImageEncoding::Raw,
            (true, true) => MetaImageEncoding::Zlib,
            (false, false) => MetaImageEncoding::Text,
            (false, true) => {
                let expected = "binary data, or no compression";
                return Err(Error::bad_input(&self.path, "CompressedData", expected, "compressed text"));
            }
        })
    }

    fn geometry(&self) -> Result<Geometry> {
        let [x, y, z, _] = self.per_axis(&SPACING, 1.0)?;
        let [o_x, o_y, o_z, _] = self.per_axis(&OFFSET, 0.0)?;
        let (spacing, directions) = ([x, y, z], self.directions()?);
        let columns = std::array::from_fn(|a| directions[a].map(|d| d * spacing[a]));
        geometry(&self.path, "ElementSpacing and TransformMatrix", [o_x, o_y, o_z], columns)
    }

    fn is_local(&self) -> Result<bool> {
        Ok(matches!(self.require("ElementDataFile")?, "LOCAL" | "Local" | "local"))
    }

    /// The files that hold the samples, `bytes` of them in all, and where these start in each.
    fn parts(&self, source: &Arc<ByteSource>, io: IoMode, bytes: u64) -> Result<(Vec<Arc<ByteSource>>, u64)> {
        let ([dims, [frames, ..]], local) = (self.dims()?, self.is_local()?);
        let slices = dims[2].saturating_mul(frames);
        let parts = if local { vec![Arc::clone(source)] } else { self.files(slices, io)? };
        let start = self.start(&parts, local, self.encoding()?, bytes / parts.len() as u64)?;
        Ok((parts, start))
    }

    /// The files next to the header that hold the samples.
    fn files(&self, slices: u64, io: IoMode) -> Result<Vec<Arc<ByteSource>>> {
        let value = self.require("ElementDataFile")?;
        let words: Vec<&str> = value.split_whitespace().collect();
        let last = slices.to_string();
        let (names, dim) = match words[..] {
            ["LIST"] => (self.listed.clone(), None),
            ["LIST", dim] => (self.listed.clone(), Some(dim)),
            [pattern] if pattern.contains('%') => (self.pattern(value, &[pattern, "1", &last, "1"])?, None),
            [pattern, _, _, _] if pattern.contains('%') => (self.pattern(value, &words)?, None),
            _ => (vec![value.to_string()], Some("3")),
        };
        if !matches!(dim, None | Some("2" | "3"))
            || names.is_empty()
            || !slices.is_multiple_of(names.len() as u64)
        {
            let got = format!("{} file(s) for {slices} slices: {value}", names.len());
            let expected = "the same number of whole slices in every file";
            return Err(Error::bad_input(&self.path, "ElementDataFile", expected, got));
        }
        open_files(&self.path, "ElementDataFile", &names, io)
    }

    fn pattern(&self, value: &str, words: &[&str]) -> Result<Vec<String>> {
        numbered_files(&self.path, "ElementDataFile", value, words)
    }

    /// Where the samples start in each file; `needed` bytes of samples are in each.
    fn start(
        &self,
        parts: &[Arc<ByteSource>],
        local: bool,
        encoding: MetaImageEncoding,
        needed: u64,
    ) -> Result<u64> {
        let skip: i64 = self.integer("HeaderSize", "0")?;
        match (skip, encoding) {
            (0, _) if local => return Ok(self.end),
            (0.., _) => return Ok(skip.unsigned_abs()),
            (-1, MetaImageEncoding::Raw | MetaImageEncoding::Zlib) => {}
            _ => {
                return Err(Error::bad_input(
                    &self.path,
                    "HeaderSize",
                    "0 or more, or -1 for binary data",
                    skip.to_string(),
                ));
            }
        }
        let needed = if encoding == MetaImageEncoding::Raw {
            needed
        } else {
            self.integer("CompressedDataSize", "none")?
        };
        let len = parts[0].len();
        if let Some(odd) = parts.iter().find(|p| p.len() != len) {
            let expected = format!("{len} bytes, as in the first of the data files");
            return Err(Error::bad_input(
                odd.path(),
                "length of the file",
                expected,
                format!("{} bytes", odd.len()),
            ));
        }
        len.checked_sub(needed).ok_or_else(|| {
            Error::bad_input(
                parts[0].path(),
                "samples",
                format!("{needed} bytes"),
                format!("a file of {len} bytes"),
            )
            .with_help("the file is cut short, or the header's sizes or type are wrong")
        })
    }

    fn big_endian(&self) -> Result<bool> {
        self.flag(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"], false)
    }

    fn compressed_end(&self, part: &ByteSource, start: u64) -> Result<u64> {
        // 0 is written by programs that did not know the size yet.
        let size: u64 = self.integer("CompressedDataSize", "0")?;
        let end = if size == 0 { Some(part.len()) } else { start.checked_add(size) };
        end.filter(|&e| e <= part.len() && start <= e).ok_or_else(|| {
            let expected = format!("{size} bytes from byte {start} on");
            Error::bad_input(
                part.path(),
                "CompressedDataSize",
                expected,
                format!("a file of {} bytes", part.len()),
            )
            .with_help("the file is cut short")
        })
    }
}

impl MetaImageFile {
    /// The volumes of a series, by the names of their fields; none where there is one volume.
    fn all_steps(&self, options: &OpenOptions) -> Result<Frames> {
        let frames = frames::list(self.frames, Some(self.header.times()?));
        let any = OpenOptions { field: None, ..options.clone() };
        frames::check_last(frames.len().max(1) as u64, &any, |options| self.volume(options))?;
        Ok(frames)
    }

    fn samples(&self, mut info: VolumeInfo, frame: u64) -> Result<VolumeSource> {
        let (header, frames) = (&self.header, self.frames);
        info.data_files = self.files();
        if self.encoding == MetaImageEncoding::Raw {
            let strides =
                StridedVolume::packed_strides(info.dims, info.field.scalar).expect("fewer than 2^63 bytes");
            let slices = [info.dims[2], strides[2] as u64];
            let (parts, each) =
                frames::parts_of(&header.path, &self.parts, self.start, [frame, frames], slices)?;
            let volume = StridedVolume::stacked_at(info, parts, each, header.big_endian()?, strides)?;
            return Ok(volume.source());
        }
        let part = self.only_part()?;
        if self.encoding == MetaImageEncoding::Zlib {
            return self.packed(part)?.volume(info, frame);
        }
        if frames > 1 {
            let got = "text of several volumes";
            return Err(Error::bad_input(&header.path, "BinaryData", "binary data of a series", got)
                .with_help("write it again as binary data"));
        }
        let slabs = TextSlabs::new(info, Arc::clone(part), self.start..part.len().max(self.start))?;
        Ok(VolumeSource::Stream(Box::new(slabs)))
    }

    /// The only file of data that is read front to back.
    fn only_part(&self) -> Result<&Arc<ByteSource>> {
        let [part] = &self.parts[..] else {
            let got = format!("{} files of {} data", self.parts.len(), self.encoding.name());
            let expected = "one file, or several without compression";
            return Err(Error::bad_input(&self.header.path, "ElementDataFile", expected, got));
        };
        Ok(part)
    }

    /// The volumes of compressed data.
    fn packed(&self, part: &Arc<ByteSource>) -> Result<PackedFrames> {
        let (source, range) = (Arc::clone(part), self.start..self.header.compressed_end(part, self.start)?);
        // MetaIO takes a gzip header for a zlib one, too.
        let start = range.start..range.end.min(range.start.saturating_add(2));
        let gzip = part.slice(start)?.starts_with(&[0x1f, 0x8b]);
        let codec = if gzip { Codec::Gzip } else { Codec::Zlib };
        let (skip, tail, big_endian) = (0, Tail::Nothing, self.header.big_endian()?);
        Ok(PackedFrames { source, range, codec, skip, frames: self.frames, big_endian, tail })
    }
}

#[cfg(test)]
mod tests;
