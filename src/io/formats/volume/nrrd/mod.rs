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
//! bytes. The reader takes three axes of space, and one more of time or of a list, whose volumes
//! are the fields "t0", "t1", … (see the module `axes`); their times follow from that axis' spacing
//! and minimum, or from the fourth direction of a space with time, as ITK writes it (see the module
//! `space`). Units of single axes become one. It refuses by name: other numbers of axes, colour and
//! vector axes, bzip2 and hex, compressed or text data in several files, and such data of a series
//! whose volumes do not follow each other.
//!
//! The format: <https://teem.sourceforge.net/nrrd/format.html>.

mod axes;
mod space;

use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::frames;
use crate::formats::shared::header::{Lines, numbered_files, numbers, open_files, plain_info};
use crate::formats::shared::packed::PackedFrames;
use crate::formats::shared::stream::{Codec, Tail, TextSlabs, sample_bytes};
use crate::formats::shared::{Frames, OpenOptions, known_times};
use crate::grid::Geometry;
use crate::volume::strided::StridedVolume;
use crate::volume::{ScalarType, VolumeInfo, VolumeSource};
use axes::Axes;
use std::collections::HashMap;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;

/// NRRD.
pub(in crate::formats) struct Nrrd;

static ABOUT: About = About {
    volumes: &["NRRD"],
    suffixes: &[".nrrd", ".nhdr"],
    magic: &[b"NRRD000"],
    on_servers: true,
    ..About::named("an NRRD file")
};

impl Format for Nrrd {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let source = head.file()?;
        let header = NrrdHeader::parse(source)?;
        let (axes, scalar) = (Axes::of(&header)?, header.scalar()?);
        let data = header.data(Arc::clone(source), &axes, head.io)?;
        let encoding = header.encoding()?;
        Ok(Box::new(NrrdFile { header, axes, scalar, data, encoding }))
    }
}

/// An NRRD file, attached (`.nrrd`) or detached (`.nhdr`).
struct NrrdFile {
    header: NrrdHeader,
    axes: Axes,
    scalar: ScalarType,
    data: Data,
    encoding: NrrdEncoding,
}

impl Dataset for NrrdFile {
    fn files(&self) -> Vec<PathBuf> {
        self.data.parts.iter().map(|part| part.path().to_path_buf()).collect()
    }

    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let Self { header, axes, scalar, data, encoding } = self;
        let place = if header.get("datafile").is_some() { "detached" } else { "attached" };
        let format = format!("NRRD ({place}, {})", encoding.name());
        let mut info = plain_info(&header.path, format, axes.dims(), *scalar, Geometry::default());
        axes.describe(header, &mut info)?;
        frames::check_last(axes.frames(), options, |options| self.volume(options))?;
        let (frame, fields) = frames::choose(&header.path, axes.frames(), *scalar, options)?;
        (info.field, info.fields) = (fields[frame as usize].clone(), fields);
        info.is_labels = header.has_segments;
        header.samples(info, data, *encoding, axes, frame)
    }

    fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        // A name is that of one frame.
        if options.field.is_some() { Ok(vec![]) } else { self.all_steps(options) }
    }

    fn times(&self, options: &OpenOptions) -> Result<HashMap<String, f64>> {
        self.all_steps(options).map(known_times)
    }

    fn packed_steps(&self, options: &OpenOptions) -> Result<Option<(PackedFrames, VolumeInfo)>> {
        if self.axes.frames() == 1 || self.encoding != NrrdEncoding::Gzip {
            return Ok(None);
        }
        let info = self.volume(&frames::first(options))?.info().clone();
        Ok(Some((self.header.packed(&info, &self.data, &self.axes)?, info)))
    }
}

impl NrrdFile {
    /// The volumes of a series, by the names of their fields; none where there is one volume.
    fn all_steps(&self, options: &OpenOptions) -> Result<Frames> {
        let frames = self.axes.list(&self.header)?;
        let any = OpenOptions { field: None, ..options.clone() };
        frames::check_last(frames.len().max(1) as u64, &any, |options| self.volume(options))?;
        Ok(frames)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum NrrdEncoding {
    Raw,
    Gzip,
    Ascii,
}

impl NrrdEncoding {
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
struct NrrdHeader {
    path: PathBuf,
    /// Field names in lower case and without blanks ("spacedirections"), and their values.
    fields: Vec<(String, String)>,
    /// Names that follow a "data file: LIST".
    listed: Vec<String>,
    /// Whether it describes segments, as 3D Slicer does for labels.
    has_segments: bool,
    /// The byte after the header.
    end: u64,
}

impl NrrdHeader {
    fn parse(source: &ByteSource) -> Result<Self> {
        let path = source.path();
        let mut lines = Lines::new(source.head_from(0)?);
        let magic = lines.next().unwrap_or_default();
        if !matches!(
            magic.strip_prefix("NRRD000").map(str::trim_end),
            Some("1" | "2" | "3" | "4" | "5" | "6")
        ) {
            return Err(Error::bad_input(path, "first line", "NRRD0001 to NRRD0006", magic));
        }
        let (path, fields, listed) = (path.to_path_buf(), vec![], vec![]);
        let mut header = Self { path, fields, listed, has_segments: false, end: 0 };
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
            self.has_segments |= line.starts_with("Segment0_");
            return Ok(false);
        }
        let at = format!("line {number}");
        let Some((name, value)) = line.split_once(':') else {
            return Err(Error::bad_input(&self.path, at, "\"field: value\" or an empty line", line)
                .with_help("the header must end with an empty line"));
        };
        let name: String = name.to_ascii_lowercase().split_whitespace().collect();
        if self.get(&name).is_some() {
            return Err(Error::bad_input(&self.path, at, "each field once", line));
        }
        let listing = name == "datafile" && value.split_whitespace().next() == Some("LIST");
        self.fields.push((name, value.trim().to_string()));
        Ok(listing)
    }

    fn get(&self, name: &str) -> Option<&str> {
        self.fields.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }

    fn require(&self, name: &str) -> Result<&str> {
        let missing = || Error::bad_input(&self.path, "header", format!("a field \"{name}\""), "none");
        self.get(name).ok_or_else(missing)
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
                    &self.path,
                    "type",
                    "an integer of 8 to 64 bits, float or double",
                    name,
                ));
            }
        })
    }

    fn encoding(&self) -> Result<NrrdEncoding> {
        let name = self.require("encoding")?.to_ascii_lowercase();
        match name.as_str() {
            "raw" => Ok(NrrdEncoding::Raw),
            "gzip" | "gz" => Ok(NrrdEncoding::Gzip),
            "ascii" | "text" | "txt" => Ok(NrrdEncoding::Ascii),
            _ => Err(Error::bad_input(&self.path, "encoding", "raw, gzip or ascii", &*name)
                .with_help("write it again with one of these, e.g. `unu save -f nrrd -e gzip`")),
        }
    }

    fn big_endian(&self, scalar: ScalarType) -> Result<bool> {
        match self.get("endian").map(str::to_ascii_lowercase).as_deref() {
            Some("little") => Ok(false),
            Some("big") => Ok(true),
            None if scalar.bytes() == 1 => Ok(false),
            got => Err(Error::bad_input(&self.path, "endian", "little or big", got.unwrap_or("none"))),
        }
    }

    /// The files that hold the samples.
    fn data(&self, header: Arc<ByteSource>, axes: &Axes, io: IoMode) -> Result<Data> {
        let Some(value) = self.get("datafile") else {
            return Ok(Data { parts: vec![header], start: self.end });
        };
        let words: Vec<&str> = value.split_whitespace().collect();
        let (names, dim) = match words[..] {
            ["LIST"] => (self.listed.clone(), None),
            ["LIST", dim] => (self.listed.clone(), Some(dim)),
            [pattern, a, b, c, dim] if pattern.contains('%') => {
                (numbered_files(&self.path, "data file", value, &[pattern, a, b, c])?, Some(dim))
            }
            [pattern, ..] if words.len() == 4 && pattern.contains('%') => {
                (numbered_files(&self.path, "data file", value, &words)?, None)
            }
            _ => (vec![value.to_string()], Some("3")),
        };
        let slices = axes.dims()[2].saturating_mul(axes.frames());
        if !matches!(dim, None | Some("2" | "3"))
            || names.is_empty()
            || !slices.is_multiple_of(names.len() as u64)
            || names.len() > 1 && !axes.are_in_order()
        {
            let got = format!("{} file(s) for {slices} slices: {value}", names.len());
            return Err(Error::bad_input(
                &self.path,
                "data file",
                "the same number of whole slices in every file",
                got,
            ));
        }
        Ok(Data { parts: open_files(&self.path, "data file", &names, io)?, start: 0 })
    }

    fn samples(
        &self,
        mut info: VolumeInfo,
        data: &Data,
        encoding: NrrdEncoding,
        axes: &Axes,
        frame: u64,
    ) -> Result<VolumeSource> {
        info.data_files = data.parts.iter().map(|p| p.path().to_path_buf()).collect();
        if encoding != NrrdEncoding::Raw {
            self.check_stream(data, encoding, axes)?;
        }
        if encoding == NrrdEncoding::Gzip {
            return self.packed(&info, data, axes)?.volume(info, frame);
        }
        let (first, byte_skip) = (&data.parts[0], self.byte_skip()?);
        if encoding == NrrdEncoding::Raw {
            let offset = match u64::try_from(byte_skip) {
                Ok(skip) => self.skip_lines(first, data.start)?.saturating_add(skip),
                Err(_) => {
                    let needed = self.needed(&info, axes)?;
                    self.last_bytes(first, needed / data.parts.len() as u64)?
                }
            };
            return self.mapped(info, data, offset, axes, frame);
        }
        let start = self.skip_lines(first, data.start)?;
        let start = start.saturating_add(u64::try_from(byte_skip).unwrap_or(0));
        let range = start..first.len().max(start);
        Ok(VolumeSource::Stream(Box::new(TextSlabs::new(info, Arc::clone(first), range)?)))
    }

    /// Bytes of the samples of all volumes.
    fn needed(&self, info: &VolumeInfo, axes: &Axes) -> Result<u64> {
        let [x, y, z] = info.dims;
        sample_bytes(&self.path, [x, y, z.saturating_mul(axes.frames())], info.field.scalar)
    }

    fn byte_skip(&self) -> Result<i64> {
        let [skip] = numbers::<i64, 1>(&self.path, "byte skip", self.get("byteskip").unwrap_or("0"))?;
        if skip < -1 {
            return Err(Error::bad_input(&self.path, "byte skip", "-1, 0 or more", skip.to_string()));
        }
        Ok(skip)
    }

    /// The volumes of gzipped data, one of which is described.
    fn packed(&self, info: &VolumeInfo, data: &Data, axes: &Axes) -> Result<PackedFrames> {
        let (source, needed) = (Arc::clone(&data.parts[0]), self.needed(info, axes)?);
        let start = self.skip_lines(&source, data.start)?;
        let skip = match u64::try_from(self.byte_skip()?) {
            Ok(skip) => skip,
            Err(_) => self.decoded_before(&source, start, needed)?,
        };
        let (range, codec, tail) = (start..source.len(), Codec::Gzip, Tail::Nothing);
        let (frames, big_endian) = (axes.frames(), self.big_endian(info.field.scalar)?);
        Ok(PackedFrames { source, range, codec, skip, frames, big_endian, tail })
    }

    /// A volume that is read where it lies.
    fn mapped(
        &self,
        info: VolumeInfo,
        data: &Data,
        offset: u64,
        axes: &Axes,
        frame: u64,
    ) -> Result<VolumeSource> {
        let big = self.big_endian(info.field.scalar)?;
        self.same_layout(&data.parts)?;
        let [x, y, z, volume] = axes.strides(info.field.scalar);
        // All samples have fewer than 2^63 bytes.
        let strides = [x, y, z].map(|step| step as i64);
        if !axes.are_in_order() {
            let at = offset.saturating_add(frame * volume);
            let volume = StridedVolume::new(info, Arc::clone(&data.parts[0]), at, big, strides)?;
            return Ok(volume.source());
        }
        let slices = [info.dims[2], z];
        let (parts, each) =
            frames::parts_of(&self.path, &data.parts, offset, [frame, axes.frames()], slices)?;
        Ok(StridedVolume::stacked_at(info, parts, each, big, strides)?.source())
    }

    /// Refuses compressed and text data that cannot be read front to back.
    fn check_stream(&self, data: &Data, encoding: NrrdEncoding, axes: &Axes) -> Result<()> {
        let parts = data.parts.len();
        if parts > 1 {
            let got = format!("{parts} files of {} data", encoding.name());
            let expected = "one file, or several with encoding raw";
            return Err(Error::bad_input(&self.path, "data file", expected, got)
                .with_help("join them, e.g. with `unu save -f nrrd -e gzip`"));
        }
        if !axes.are_in_order() || encoding == NrrdEncoding::Ascii && axes.frames() > 1 {
            let got = format!("{} data of volumes that are interleaved, or text", encoding.name());
            let expected = "volumes one after the other (their axis the last), or encoding raw";
            return Err(Error::bad_input(&self.path, "encoding", expected, got).with_help(
                "write it raw (`unu save -f nrrd -e raw`), or make the axis the last (`unu permute`)",
            ));
        }
        Ok(())
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
        let [count] = numbers::<u64, 1>(&self.path, "line skip", self.get("lineskip").unwrap_or("0"))?;
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
