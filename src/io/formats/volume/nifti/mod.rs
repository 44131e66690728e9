//! NIfTI-1 and NIfTI-2 (neuroimaging): a binary header of 348 or 540 bytes, then the samples, x
//! fastest.
//!
//! ```text
//!  .nii, .nii.gz    | header | extensions | … samples from vox_offset on |
//!  .hdr + .img      | header |             | samples from vox_offset on | in the other file; either may be .gz
//! ```
//!
//! `sizeof_hdr`, the first number, is 348 or 540 in the byte order of the file. Fields used:
//!
//! | field | NIfTI-1 | NIfTI-2 | |
//! |---|---|---|---|
//! | magic | 344 "n+1", "ni1" | 4 "n+2", "ni2" | one file, or a pair |
//! | `dim` | 40, 8 x i16 | 16, 8 x i64 | number of axes, then x, y, z, t, components … |
//! | `datatype` | 70, i16 | 12, i16 | |
//! | `pixdim` | 76, 8 x f32 | 104, 8 x f64 | handedness of the quaternion, then spacings; of t, in any unit |
//! | `toffset` | 136, f32 | 216, f64 | time of the first frame |
//! | `vox_offset` | 108, f32 | 168, i64 | |
//! | `scl_slope`, `scl_inter` | 112, f32 | 176, f64 | value = slope · stored + inter; slope 0: none |
//! | `qform_code`, `sform_code` | 252, i16 | 344, i32 | above 0: the map to the world is given |
//! | `quatern_b` … `qoffset_z` | 256, 6 x f32 | 352, 6 x f64 | a rotation and an origin |
//! | `srow_x` … `srow_z` | 280, 12 x f32 | 400, 12 x f64 | the rows of an affine map |
//!
//! The affine map is used where there is one, else the quaternion, else `pixdim` alone (0 means 1).
//! The frames of a time series are fields "t0", "t1", …. The reader refuses by name: fewer than
//! three axes, several numbers a sample (vectors, complex, colours), long double.
//!
//! The format: Cox et al., "A (sort of) new image data format standard: NIfTI-1" (2004), and
//! `nifti1.h`, `nifti2.h`.

use crate::bytes::{ByteSource, place};
use crate::error::{Error, Result};
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::frames::{self, fields};
use crate::formats::shared::header::{geometry, scaled_axes};
use crate::formats::shared::packed::PackedFrames;
use crate::formats::shared::stream::{Codec, Tail, sample_bytes};
use crate::formats::shared::{Frames, OpenOptions, has_suffix, known_times, pick_field};
use crate::grid::Geometry;
use crate::volume::strided::StridedVolume;
use crate::volume::units::{Unit, Units};
use crate::volume::{Assumed, ScalarType, VolumeInfo, VolumeSource};
use byteorder::{BE, ByteOrder, LE};
use std::collections::HashMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// NIfTI-1 and NIfTI-2.
pub(in crate::formats) struct Nifti;

static ABOUT: About = About {
    volumes: &["NIfTI"],
    suffixes: &[".nii", ".nii.gz", ".hdr", ".hdr.gz", ".img", ".img.gz"],
    on_servers: true,
    ..About::named("a NIfTI file")
};

impl Format for Nifti {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        has_magic(&head.bytes) || has_magic(&head.unzipped())
    }

    /// A file, or a pair by the name of either file.
    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let is_data = has_suffix(head.path, &[".img", ".img.gz"]);
        let source = match is_data {
            true => Arc::new(ByteSource::open(partner(head.path, "hdr")?, head.io)?),
            false => Arc::clone(head.file()?),
        };
        let header = NiftiHeader::parse(&source)?;
        let data = match (header.is_pair()?, is_data) {
            (false, _) => source,
            (true, true) => Arc::clone(head.file()?),
            (true, false) => Arc::new(ByteSource::open(partner(head.path, "img")?, head.io)?),
        };
        let offset = header.offset(header.is_pair()?)?;
        let (path, gzip) = (head.path.to_path_buf(), is_gzip(&data)?);
        Ok(Box::new(NiftiFile { path, header, data, gzip, offset }))
    }
}

/// The intent of samples that are labels.
pub(super) const INTENT_LABEL: i32 = 1002;

/// A file, or a pair.
struct NiftiFile {
    /// The one that was named.
    path: PathBuf,
    header: NiftiHeader,
    /// The file of the samples, and where in it, unpacked, they begin.
    data: Arc<ByteSource>,
    gzip: bool,
    offset: u64,
}

impl Dataset for NiftiFile {
    fn files(&self) -> Vec<PathBuf> {
        vec![self.header.path.clone(), self.data.path().to_path_buf()]
    }

    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let (path, header) = (&*self.path, &self.header);
        let (scalar, dims, frames) = (header.scalar()?, header.dims()?, header.frames()?);
        let frame_bytes = sample_bytes(path, dims, scalar)?;
        check_size(&self.data, self.gzip, self.offset, frames, frame_bytes)?;
        let fields = fields(frames, scalar);
        let frame = pick_field(path, &fields, options.field.as_deref())? as u64;
        let (slope, intercept) = header.scaling()?;
        let info = VolumeInfo {
            path: path.to_path_buf(),
            format: header.format(header.is_pair()?, self.gzip),
            dims,
            field: fields[frame as usize].clone(),
            fields,
            geometry: header.geometry()?,
            slope,
            intercept,
            missing: None,
            units: header.units(),
            notes: header.notes(frames),
            data_files: vec![self.data.path().to_path_buf()],
            assumed: Assumed::in_header(header.assumed()),
            is_labels: header.integer((68, 2), (504, 4)) == i64::from(INTENT_LABEL),
        };
        let data = Arc::clone(&self.data);
        if self.gzip {
            return header.packed(data, self.offset)?.volume(info, frame);
        }
        let offset = self.offset + frame * frame_bytes;
        let strides = StridedVolume::packed_strides(dims, scalar).expect("fewer than 2^63 bytes");
        let volume = StridedVolume::new(info, data, offset, header.big_endian, strides)?;
        Ok(volume.source())
    }

    fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        // A name is that of one frame.
        if options.field.is_some() { Ok(vec![]) } else { self.all_steps(options) }
    }

    fn times(&self, options: &OpenOptions) -> Result<HashMap<String, f64>> {
        self.all_steps(options).map(known_times)
    }

    fn packed_steps(&self, options: &OpenOptions) -> Result<Option<(PackedFrames, VolumeInfo)>> {
        if self.header.frames()? == 1 || !self.gzip {
            return Ok(None);
        }
        let info = self.volume(&frames::first(options))?.info().clone();
        Ok(Some((self.header.packed(Arc::clone(&self.data), self.offset)?, info)))
    }
}

impl NiftiFile {
    /// The frames by the names of their fields, and their times: `toffset` and a `pixdim[4]` for
    /// each. None where there is one volume.
    fn all_steps(&self, options: &OpenOptions) -> Result<Frames> {
        let (header, frames) = (&self.header, self.header.frames()?);
        if frames == 1 {
            return Ok(vec![]);
        }
        // Refuses a header that claims more frames than there are, before they are listed.
        self.volume(&frames::first(options))?;
        let times = [header.float(136, 216, 0), header.float(76, 104, 4)];
        Ok(frames::list(frames, header.spectral_unit().is_none().then_some(times)))
    }
}

/// Whether a file that starts so is a NIfTI file or the header of one.
pub(in crate::formats) fn has_magic(head: &[u8]) -> bool {
    let is = |at: usize, magic: [&[u8]; 2]| head.get(at..at + 4).is_some_and(|m| magic.contains(&m));
    is(344, [b"n+1\0", b"ni1\0"]) || is(4, [b"n+2\0", b"ni2\0"])
}

fn is_gzip(source: &ByteSource) -> Result<bool> {
    Ok(source.slice(0..source.len().min(2))? == [0x1f, 0x8b])
}

/// The other file of a pair: `wanted` is "hdr" or "img"; compressed or not.
fn partner(path: &Path, wanted: &str) -> Result<PathBuf> {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let gz = if name.to_ascii_lowercase().ends_with(".gz") { &name[..name.len() - 3] } else { &name };
    let stem = if has_suffix(Path::new(gz), &[".hdr", ".img"]) { &gz[..gz.len() - 4] } else { gz };
    // The partner is most likely compressed like the file named.
    let mut endings = ["", ".gz"];
    if gz.len() < name.len() {
        endings.reverse();
    }
    let names = endings.map(|e| format!("{stem}.{wanted}{e}"));
    let mut found = None;
    for name in &names {
        let file = path.with_file_name(name);
        if found.is_none() && place::exists(&file)? {
            found = Some(file);
        }
    }
    found.ok_or_else(|| {
        let expected = format!("the other file of the pair, {} or {}", names[0], names[1]);
        Error::bad_input(path, "file", expected, "neither").with_help("put it into the same folder")
    })
}

/// Refuses a header that claims more than the file can hold, before its frames are listed.
fn check_size(data: &ByteSource, gzip: bool, offset: u64, frames: u64, frame_bytes: u64) -> Result<()> {
    // See `stream`: deflate never decodes to more than 1032 times its size.
    let most = if gzip { data.len().saturating_mul(1032) } else { data.len() };
    let needed = frames.checked_mul(frame_bytes).and_then(|n| n.checked_add(offset));
    if needed.is_some_and(|n| n <= most) {
        return Ok(());
    }
    let expected = format!("{frames} frame(s) of {frame_bytes} bytes from byte {offset} on");
    let got = format!("a file of {} bytes", data.len());
    Err(Error::bad_input(data.path(), "samples", expected, got)
        .with_help("the file is cut short, or its dimensions or type are wrong"))
}

/// The header's bytes, and how to read them.
struct NiftiHeader {
    path: PathBuf,
    bytes: Vec<u8>,
    big_endian: bool,
    /// 1 or 2.
    version: u8,
}

impl NiftiHeader {
    const BYTES: [usize; 2] = [348, 540];

    fn parse(source: &Arc<ByteSource>) -> Result<Self> {
        let mut bytes = vec![];
        let reader: Box<dyn Read> = if is_gzip(source)? {
            Codec::Gzip.reader(source, 0..source.len())?
        } else {
            Box::new(source.reader(0..source.len())?)
        };
        let read = reader.take(Self::BYTES[1] as u64).read_to_end(&mut bytes);
        let path = source.path().to_path_buf();
        let both = bytes.get(..4).map_or([0; 2], |first| [LE::read_i32(first), BE::read_i32(first)]);
        let known = [(348, 1), (540, 2)].into_iter().find_map(|(size, version)| {
            let order = both.iter().position(|&s| s == size)?;
            Some((version, order == 1))
        });
        let Some((version, big_endian)) = known else {
            if let Err(e) = read {
                return Err(Error::bad_input(path, "header", "good gzip data", e.to_string()));
            }
            let got = format!("{} (or {})", both[0], both[1]);
            return Err(Error::bad_input(path, "sizeof_hdr, byte 0", "348 (NIfTI-1) or 540 (NIfTI-2)", got)
                .with_help("this is no NIfTI file"));
        };
        let size = Self::BYTES[version as usize - 1];
        if bytes.len() < size {
            let got = read.err().map_or_else(|| format!("{} bytes", bytes.len()), |e| e.to_string());
            return Err(Error::bad_input(path, "header", format!("{size} bytes"), got)
                .with_help("the file is cut short or damaged"));
        }
        bytes.truncate(size);
        Ok(Self { path, bytes, big_endian, version })
    }

    /// An integer: `at` and bytes of the field in version 1 and in version 2.
    fn integer(&self, one: (usize, usize), two: (usize, usize)) -> i64 {
        let (at, size) = if self.version == 1 { one } else { two };
        let field = &self.bytes[at..at + size];
        if self.big_endian { BE::read_int(field, size) } else { LE::read_int(field, size) }
    }

    /// The `i`-th float of a field that has `f32`s at `one` in version 1, `f64`s at `two` in
    /// version 2.
    fn float(&self, one: usize, two: usize, i: usize) -> f64 {
        let field = &self.bytes[if self.version == 1 { one + 4 * i } else { two + 8 * i }..];
        match (self.version, self.big_endian) {
            (1, false) => LE::read_f32(field).into(),
            (1, true) => BE::read_f32(field).into(),
            (_, false) => LE::read_f64(field),
            (_, true) => BE::read_f64(field),
        }
    }

    fn bad(&self, at: &str, expected: &str, got: impl Into<String>) -> Error {
        Error::bad_input(&self.path, at, expected, got)
    }

    fn is_pair(&self) -> Result<bool> {
        let at = if self.version == 1 { 344 } else { 4 };
        match (&self.bytes[at..at + 3], self.bytes[at + 3]) {
            (b"n+1" | b"n+2", 0) => Ok(false),
            (b"ni1" | b"ni2", 0) if has_suffix(&self.path, &[".hdr", ".hdr.gz"]) => Ok(true),
            (b"ni1" | b"ni2", 0) => {
                Err(self.bad("name", ".hdr, beside an .img", "a header of a pair by another name"))
            }
            (magic, _) => Err(self
                .bad("magic", "n+1, ni1, n+2 or ni2", String::from_utf8_lossy(magic))
                .with_help("an Analyze 7.5 file? write it as NIfTI: it does not tell its orientation")),
        }
    }

    /// The units of `xyzt_units`: of space in the lowest three bits, of time in the next three.
    fn units(&self) -> Units {
        let code = self.integer((123, 1), (500, 4));
        let length = match code & 7 {
            1 => Unit::length("m"),
            2 => Unit::length("mm"),
            3 => Unit::length("µm"),
            _ => None,
        };
        let time = match code & 0x38 {
            8 => Unit::time("s"),
            16 => Unit::time("ms"),
            24 => Unit::time("µs"),
            _ => None,
        };
        Units { value: None, length, time }
    }

    /// The unit of a fourth axis that is not one of time.
    fn spectral_unit(&self) -> Option<&'static str> {
        match self.integer((123, 1), (500, 4)) & 0x38 {
            32 => Some("Hz"),
            40 => Some("ppm"),
            48 => Some("rad/s"),
            _ => None,
        }
    }

    fn notes(&self, frames: u64) -> Vec<String> {
        let note =
            |unit| format!("its fourth axis is in {unit}, which is no time: the volumes have no times");
        self.spectral_unit().filter(|_| frames > 1).map(note).into_iter().collect()
    }

    fn dim(&self, axis: usize) -> i64 {
        self.integer((40 + 2 * axis, 2), (16 + 8 * axis, 8))
    }

    fn dims(&self) -> Result<[u64; 3]> {
        let axes = self.dim(0);
        if !(3..=7).contains(&axes) {
            return Err(self
                .bad("dim[0]", "3 axes, or 4 for a time series", format!("{axes}"))
                .with_help("only volumes are read"));
        }
        let mut dims = [0; 3];
        for (a, dim) in dims.iter_mut().enumerate() {
            let n = self.dim(a + 1);
            *dim = u64::try_from(n).map_err(|_| self.bad("dim", "positive numbers", n.to_string()))?;
        }
        Ok(dims)
    }

    /// Frames of a time series, 1 for a single volume.
    fn frames(&self) -> Result<u64> {
        let axes = self.dim(0) as usize;
        if let Some(a) = (5..=axes).find(|&a| self.dim(a) != 1) {
            return Err(self
                .bad(&format!("dim[{a}]"), "1: one number a sample", self.dim(a).to_string())
                .with_help("vectors and tensors are not read; write one component to a file of its own"));
        }
        let frames = if axes >= 4 { self.dim(4) } else { 1 };
        u64::try_from(frames)
            .ok()
            .filter(|&n| n > 0)
            .ok_or_else(|| self.bad("dim[4]", "1 frame or more", frames.to_string()))
    }

    fn scalar(&self) -> Result<ScalarType> {
        let code = self.integer((70, 2), (12, 2));
        let name = match code {
            2 => return Ok(ScalarType::U8),
            4 => return Ok(ScalarType::I16),
            8 => return Ok(ScalarType::I32),
            16 => return Ok(ScalarType::F32),
            64 => return Ok(ScalarType::F64),
            256 => return Ok(ScalarType::I8),
            512 => return Ok(ScalarType::U16),
            768 => return Ok(ScalarType::U32),
            1024 => return Ok(ScalarType::I64),
            1280 => return Ok(ScalarType::U64),
            1 => "bits",
            32 | 1792 | 2048 => "complex numbers",
            128 => "RGB colours",
            2304 => "RGBA colours",
            1536 => "long double",
            _ => "unknown",
        };
        let expected = "an integer of 8 to 64 bits, float or double";
        Err(self.bad("datatype", expected, format!("{code} ({name})")).with_help("write one number a sample"))
    }

    fn offset(&self, pair: bool) -> Result<u64> {
        let offset =
            if self.version == 1 { self.float(108, 0, 0) } else { self.integer((0, 2), (168, 8)) as f64 };
        let least = match (pair, self.version) {
            (true, _) => 0.0,
            (false, 1) => 352.0,
            (false, _) => 544.0,
        };
        if offset >= least && offset < 1e15 && offset.fract() == 0.0 {
            return Ok(offset as u64);
        }
        Err(self.bad("vox_offset", &format!("a whole number of bytes, at least {least}"), offset.to_string()))
    }

    /// The volumes of gzipped data. As other readers do, bytes after the last one are passed over.
    fn packed(&self, source: Arc<ByteSource>, skip: u64) -> Result<PackedFrames> {
        let (range, codec, tail) = (0..source.len(), Codec::Gzip, Tail::Checked);
        let (frames, big_endian) = (self.frames()?, self.big_endian);
        Ok(PackedFrames { source, range, codec, skip, frames, big_endian, tail })
    }

    fn scaling(&self) -> Result<(f64, f64)> {
        let (slope, intercept) = (self.float(112, 176, 0), self.float(116, 184, 0));
        if slope == 0.0 || !slope.is_finite() {
            return Ok((1.0, 0.0));
        }
        if !intercept.is_finite() {
            return Err(self.bad("scl_inter", "a finite number", intercept.to_string()));
        }
        Ok((slope, intercept))
    }

    /// Axes whose spacing is not known: nothing but `pixdim` says it, which is 0.
    fn assumed(&self) -> [bool; 3] {
        let has_rows = self.integer((254, 2), (348, 4)) > 0;
        std::array::from_fn(|a| !has_rows && self.float(76, 104, a + 1) == 0.0)
    }

    fn geometry(&self) -> Result<Geometry> {
        let (qform, sform) = (self.integer((252, 2), (344, 4)), self.integer((254, 2), (348, 4)));
        let pixdim: [f64; 3] = std::array::from_fn(|a| self.float(76, 104, a + 1));
        let spacing = pixdim.map(|p| if p == 0.0 { 1.0 } else { p.abs() });
        if sform > 0 {
            let row = |r: usize, c: usize| self.float(280, 400, 4 * r + c);
            let columns = std::array::from_fn(|c| std::array::from_fn(|r| row(r, c)));
            return geometry(&self.path, "srow_x to srow_z", std::array::from_fn(|r| row(r, 3)), columns);
        }
        if qform <= 0 {
            return geometry(&self.path, "pixdim", [0.0; 3], scaled_axes(spacing));
        }
        let rotation = self.rotation();
        // The sign of pixdim[0] says whether the third axis completes a right-handed triple.
        let hand = if self.float(76, 104, 0) < 0.0 { -1.0 } else { 1.0 };
        let scale = [spacing[0], spacing[1], hand * spacing[2]];
        let columns = std::array::from_fn(|a| std::array::from_fn(|r| rotation[r][a] * scale[a]));
        geometry(
            &self.path,
            "quatern_b to qoffset_z",
            std::array::from_fn(|r| self.float(256, 352, 3 + r)),
            columns,
        )
    }

    /// The rotation of the unit quaternion (a, b, c, d); the file has b, c, d.
    fn rotation(&self) -> [[f64; 3]; 3] {
        let [mut b, mut c, mut d] = std::array::from_fn(|i| self.float(256, 352, i));
        let squares = b * b + c * c + d * d;
        let a = if squares < 1.0 { (1.0 - squares).sqrt() } else { 0.0 };
        if squares > 1.0 {
            // Rounding of a half turn.
            let norm = squares.sqrt();
            (b, c, d) = (b / norm, c / norm, d / norm);
        }
        [
            [a * a + b * b - c * c - d * d, 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)],
            [2.0 * (b * c + a * d), a * a + c * c - b * b - d * d, 2.0 * (c * d - a * b)],
            [2.0 * (b * d - a * c), 2.0 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    }

    fn format(&self, pair: bool, gzip: bool) -> String {
        let kind = if pair { "header and image" } else { "one file" };
        format!("NIfTI-{} ({kind}{})", self.version, if gzip { ", gzip" } else { "" })
    }
}

#[cfg(test)]
mod tests;
