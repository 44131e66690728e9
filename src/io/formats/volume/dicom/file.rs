//! What one file says of its frames.

use super::element::*;
use super::{dose, has_magic};
use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::volume::ScalarType;
use crate::volume::units::Unit;
use std::path::{Path, PathBuf};

/// Most frames of a file.
const MOST_FRAMES: u64 = 1 << 16;

/// A file and its frames.
pub(super) struct DicomFile {
    pub(super) path: PathBuf,
    /// The series that it is of.
    pub(super) series: String,
    pub(super) layout: SampleLayout,
    pub(super) frames: Vec<Frame>,
    pub(super) big_endian: bool,
}

/// How samples are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SampleLayout {
    pub(super) columns: u16,
    pub(super) rows: u16,
    /// 8, 16 or 32.
    bits_allocated: u16,
    pub(super) bits_stored: u16,
    is_signed: bool,
    /// The stored number that means "no data".
    pub(super) padding: Option<f64>,
}

/// Where a frame lies in the file and in the world.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    /// The byte of its first sample.
    pub(super) at: u64,
    pub(super) position: [f64; 3],
    /// The direction in which a row goes on, then that in which a column does.
    pub(super) orientation: [f64; 6],
    /// Millimetres between rows, and between columns.
    pub(super) spacing: [f64; 2],
    pub(super) slope: f64,
    pub(super) intercept: f64,
    /// The unit of values.
    pub(super) unit: Option<Unit>,
}

impl SampleLayout {
    /// The type of a sample.
    pub(super) fn scalar(&self) -> ScalarType {
        match (self.bits_allocated, self.is_signed) {
            (8, false) => ScalarType::U8,
            (8, true) => ScalarType::I8,
            (16, false) => ScalarType::U16,
            (16, true) => ScalarType::I16,
            (_, false) => ScalarType::U32,
            (_, true) => ScalarType::I32,
        }
    }

    /// The number of a sample's little-endian bytes: of the bits that are stored.
    pub(super) fn number(&self, bytes: &[u8]) -> i64 {
        let word = bytes.iter().rev().fold(0u64, |word, &b| word << 8 | u64::from(b));
        let unused = 64 - u32::from(self.bits_stored);
        if self.is_signed { (word << unused) as i64 >> unused } else { (word << unused >> unused) as i64 }
    }

    /// Bytes of a frame.
    fn frame_bytes(&self) -> u64 {
        u64::from(self.columns) * u64::from(self.rows) * u64::from(self.bits_allocated / 8)
    }
}

impl DicomFile {
    /// Reads what describes the samples.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged file, one that is no image, or one of a kind that is not
    /// read.
    pub(super) fn read(source: &ByteSource) -> Result<Self> {
        Self::read_image(source)?.ok_or_else(|| no_image(source.path()))
    }

    /// As [`DicomFile::read`]; `None` of what is no image: a report, a plan, the index of a medium.
    pub(super) fn read_image(source: &ByteSource) -> Result<Option<Self>> {
        let file = Self::parse(source.path(), source.slice(0..source.len())?);
        source.check()?;
        file
    }

    fn parse(path: &Path, bytes: &[u8]) -> Result<Option<Self>> {
        if !has_magic(bytes) {
            return Err(Error::bad_input(path, "byte 128", "'DICM', as in a DICOM file", "other bytes")
                .with_help("a file without this head is read after dcmconv wrote it again"));
        }
        let plain = DicomEncoding { explicit: true, big_endian: false };
        let mut reader = Reader::new(path, bytes, plain);
        let (meta, at) = reader.meta(132)?;
        let syntax = reader.text(&meta, TRANSFER_SYNTAX).unwrap_or_default();
        let encoding = encoding(path, &syntax)?;
        let mut reader = Reader::new(path, bytes, encoding);
        let all = reader.data_set(at)?;
        // An image that was cut short still has its size.
        if ![ROWS, PIXELS, FLOATS, DOUBLES].into_iter().any(|tag| all.has(tag)) {
            return Ok(None);
        }
        let layout = layout(path, &reader, &all)?;
        let [count] = reader.numbers(&all, FRAMES)?.unwrap_or([1.0]);
        if !(1.0..=MOST_FRAMES as f64).contains(&count) || count.fract() != 0.0 {
            let expected = format!("1 to {MOST_FRAMES}");
            return Err(Error::bad_input(path, "Number of Frames", expected, count.to_string()));
        }
        let (pixels, is_bytes) = all.bytes(PIXELS).expect("the layout was refused without samples");
        if layout.bits_allocated == 8 && encoding.big_endian && !is_bytes {
            let help = "write it again as little-endian, e.g. with dcmconv +te";
            return Err(Error::bad_input(
                path,
                "Pixel Data",
                "samples of 8 bits as bytes",
                "in big-endian words",
            )
            .with_help(help));
        }
        let needed = layout.frame_bytes() * count as u64;
        if (pixels.len() as u64) < needed {
            let expected =
                format!("{needed} bytes for {count} x {} x {} samples", layout.rows, layout.columns);
            return Err(Error::bad_input(path, "Pixel Data", expected, pixels.len().to_string())
                .with_help("the file is cut short or damaged"));
        }
        let series = reader.text(&all, SERIES).ok_or_else(|| missing(path, "Series Instance UID", SERIES))?;
        let (mut frames, planes) = (vec![], dose::planes(path, &reader, &all, count as usize)?);
        for number in 0..count as usize {
            let at = pixels.start as u64 + number as u64 * layout.frame_bytes();
            let plane = planes.as_ref().map(|planes| planes[number]);
            frames.push(frame(path, &reader, &all, number, count as usize, at, plane)?);
        }
        Ok(Some(Self { path: path.into(), series, layout, frames, big_endian: encoding.big_endian }))
    }
}

/// How the data set is written; compressed ones are refused.
fn encoding(path: &Path, syntax: &str) -> Result<DicomEncoding> {
    let of = |explicit, big_endian| Ok(DicomEncoding { explicit, big_endian });
    match syntax {
        "1.2.840.10008.1.2" => return of(false, false),
        "1.2.840.10008.1.2.1" => return of(true, false),
        "1.2.840.10008.1.2.2" => return of(true, true),
        "" => return Err(missing(path, "Transfer Syntax UID", TRANSFER_SYNTAX)),
        _ => {}
    }
    let method = match syntax.strip_prefix("1.2.840.10008.1.2.") {
        Some("1.99") => "deflate",
        Some("5") => "RLE",
        Some("4.50" | "4.51" | "4.57" | "4.70") => "JPEG",
        Some("4.80" | "4.81") => "JPEG-LS",
        Some("4.90" | "4.91" | "4.92" | "4.93") => "JPEG 2000",
        Some("4.201" | "4.202" | "4.203") => "HTJ2K",
        Some("4.110" | "4.111" | "4.112") => "JPEG XL",
        Some(x) if x.starts_with("4.10") => "a video",
        _ => "unknown",
    };
    let got = format!("{method} ({syntax})");
    Err(Error::bad_input(path, "Transfer Syntax", "uncompressed samples", got)
        .with_help("write it uncompressed, e.g. with gdcmconv --raw, or convert it with dcm2niix"))
}

fn layout(path: &Path, reader: &Reader<'_>, all: &DataSet) -> Result<SampleLayout> {
    let wrong = |at: &str, expected: &str, got: String| Err(Error::bad_input(path, at, expected, got));
    match all.bytes(PIXELS) {
        Some((bytes, _)) if !bytes.is_empty() => {}
        Some(_) => return wrong("Pixel Data", "samples", "none, or compressed ones".into()),
        None if all.has(FLOATS) || all.has(DOUBLES) => {
            return wrong("Pixel Data", "integers", "floats (Float Pixel Data)".into());
        }
        None => return Err(no_image(path)),
    }
    let integer = |tag, name: &str| reader.integer(all, tag)?.ok_or_else(|| missing(path, name, tag));
    let colours = reader.text(all, COLOURS).unwrap_or_default();
    let samples = reader.integer(all, SAMPLES)?.unwrap_or(1);
    if samples != 1 || !["MONOCHROME1", "MONOCHROME2", ""].contains(&colours.as_str()) {
        let got = format!("{samples} of them, {colours}");
        return wrong("Photometric Interpretation", "one grey value a sample", got);
    }
    if !all.items(LOOKUP).is_empty() {
        let got = "a Modality LUT Sequence".into();
        return wrong("values", "Rescale Slope and Intercept", got);
    }
    let (columns, rows) = (integer(COLUMNS, "Columns")?, integer(ROWS, "Rows")?);
    if columns == 0 || rows == 0 {
        return wrong("Rows and Columns", "1 or more of both", format!("{rows} and {columns}"));
    }
    let bits_allocated = integer(ALLOCATED, "Bits Allocated")?;
    let bits_stored = integer(STORED, "Bits Stored")?;
    let high = reader.integer(all, HIGH_BIT)?.unwrap_or(bits_stored.wrapping_sub(1));
    let fits = [8, 16, 32].contains(&bits_allocated) && (1..=bits_allocated).contains(&bits_stored);
    if !fits || high != bits_stored - 1 {
        let got = format!("{bits_stored} up to bit {high} of {bits_allocated}");
        let expected = "Bits Stored from bit 0 on, of 8, 16 or 32 Bits Allocated";
        return wrong("bits", expected, got);
    }
    let is_signed = match integer(SIGNED, "Pixel Representation")? {
        0 => false,
        1 => true,
        other => return wrong("Pixel Representation", "0 or 1", other.to_string()),
    };
    let mut layout = SampleLayout { columns, rows, bits_allocated, bits_stored, is_signed, padding: None };
    let padding = |tag| {
        let Some(word) = reader.integer(all, tag)? else { return Ok(None) };
        let number = layout.number(&word.to_le_bytes());
        let in_16_bits = if is_signed { i64::from(word as i16) } else { i64::from(word) };
        if number != in_16_bits && u64::from(word) >> bits_stored != 0 {
            let expected = format!("a number of {bits_stored} bits");
            return Err(Error::bad_input(path, "Pixel Padding Value", expected, in_16_bits.to_string()));
        }
        Ok(Some(number as f64))
    };
    let (first, last): (Option<f64>, Option<f64>) = (padding(PADDING)?, padding(PADDING_LIMIT)?);
    if last.is_some() && last != first {
        let got = "a range (Pixel Padding Range Limit)".into();
        return wrong("Pixel Padding Value", "one value that means no data", got);
    }
    layout.padding = first;
    Ok(layout)
}

/// What is said of a frame: by itself, else of all frames, else of the file.
fn frame(
    path: &Path,
    reader: &Reader<'_>,
    all: &DataSet,
    number: usize,
    count: usize,
    at: u64,
    plane: Option<[f64; 3]>,
) -> Result<Frame> {
    let own = all.items(PER_FRAME);
    if !own.is_empty() && own.len() != count {
        let expected = format!("one item for each of {count} frames");
        let at = "Per-frame Functional Groups Sequence";
        return Err(Error::bad_input(path, at, expected, own.len().to_string()));
    }
    let groups = [own.get(number), all.items(SHARED).first()];
    let in_groups = |group: Tag| groups.into_iter().flatten().find_map(|g| g.items(group).first());
    let find = |group: Tag| in_groups(group).unwrap_or(all);
    let orientation = reader.numbers(find(PLANE_ORIENTATION), ORIENTATION)?;
    let position = plane.map_or_else(|| reader.numbers(find(PLANE_POSITION), POSITION), |p| Ok(Some(p)))?;
    let spacing = reader.numbers(find(MEASURES), PIXEL_SPACING)?;
    if count > 1 && plane.is_none() && in_groups(PLANE_POSITION).is_none() {
        let expected = "a Plane Position Sequence for each frame";
        return Err(Error::bad_input(path, "functional groups", expected, "none")
            .with_help("convert it to NIfTI with dcm2niix, or to NRRD with 3D Slicer"));
    }
    let values = find(TRANSFORMATION);
    if let Some(spacing) = spacing.filter(|s: &[f64; 2]| s.iter().any(|&s| s <= 0.0)) {
        let got = format!("{} and {}", spacing[0], spacing[1]);
        return Err(Error::bad_input(path, "Pixel Spacing", "distances above 0", got));
    }
    let is_map = reader.text(all, CLASS).is_some_and(|class| class == PARAMETRIC_MAP);
    let [slope, intercept] = match is_map {
        true => mapping(path, reader, find(MAPPING))?,
        false => scaling(path, reader, all, values)?,
    };
    Ok(Frame {
        at,
        position: position.ok_or_else(|| missing(path, "Image Position (Patient)", POSITION))?,
        orientation: orientation.ok_or_else(|| missing(path, "Image Orientation (Patient)", ORIENTATION))?,
        spacing: spacing.ok_or_else(|| missing(path, "Pixel Spacing", PIXEL_SPACING))?,
        slope,
        intercept,
        unit: unit(reader, all, values),
    })
}

/// Slope and intercept of values: Rescale, and what dose grids and segmentations have besides.
fn scaling(path: &Path, reader: &Reader<'_>, all: &DataSet, values: &DataSet) -> Result<[f64; 2]> {
    let [slope] = reader.numbers(values, SLOPE)?.unwrap_or([1.0]);
    let [intercept] = reader.numbers(values, INTERCEPT)?.unwrap_or([0.0]);
    if slope == 0.0 {
        return Err(Error::bad_input(path, "Rescale Slope", "a number other than 0", "0"));
    }
    let by = dose::scaling(path, reader, all)?.unwrap_or(1.0) * fraction(path, reader, all)?;
    Ok([slope * by, intercept * by])
}

/// The class of parametric maps.
const PARAMETRIC_MAP: &str = "1.2.840.10008.5.1.4.1.1.30";

/// Slope and intercept of a parametric map: those of its first Real World Value Mapping.
fn mapping(path: &Path, reader: &Reader<'_>, item: &DataSet) -> Result<[f64; 2]> {
    let numbers = [reader.double(item, MAPPED_SLOPE)?, reader.double(item, MAPPED_INTERCEPT)?];
    match numbers {
        [Some(slope), Some(intercept)] if slope != 0.0 => Ok([slope, intercept]),
        [slope, _] => {
            let expected = "Real World Value Slope, other than 0, and Intercept";
            let got = slope.map_or("none, or a table".into(), |slope| format!("a slope of {slope}"));
            Err(Error::bad_input(path, "Real World Value Mapping", expected, got))
        }
    }
}

/// What one step of a segmentation of fractions is; 1 of all else.
fn fraction(path: &Path, reader: &Reader<'_>, all: &DataSet) -> Result<f64> {
    if reader.text(all, SEGMENTATION).is_none_or(|kind| kind != "FRACTIONAL") {
        return Ok(1.0);
    }
    let most = reader.integer(all, MOST_FRACTION)?;
    match most.ok_or_else(|| missing(path, "Maximum Fractional Value", MOST_FRACTION))? {
        0 => Err(Error::bad_input(path, "Maximum Fractional Value", "a number above 0", "0")),
        most => Ok(1.0 / f64::from(most)),
    }
}

/// The unit of values: Rescale Type, Units of PET or Dose Units. "US" means that it is not
/// specified.
fn unit(reader: &Reader<'_>, all: &DataSet, values: &DataSet) -> Option<Unit> {
    if reader.text(all, DOSE_UNITS).is_some_and(|unit| unit == "GY") {
        return Unit::new("Gy");
    }
    match (&*reader.text(all, PET_UNITS).unwrap_or_default(), reader.text(values, RESCALE_TYPE)) {
        ("BQML", _) => Unit::new("Bq/mL"),
        ("CNTS", _) => Unit::new("counts"),
        ("", Some(of_scale)) if of_scale != "US" => Unit::new(&of_scale),
        _ => None,
    }
}

fn no_image(path: &Path) -> Error {
    Error::bad_input(path, "Pixel Data", "samples", "none: the file is no image")
}
