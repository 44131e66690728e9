//! DICOM (medical images): a folder of slices in files of their own, and files of many frames.
//!
//! ```text
//!  | 128 bytes, "DICM" | group 2: transfer syntax | elements … | (7fe0,0010): samples of the frames |
//! ```
//!
//! Each slice says where it lies: Image Position (the middle of its first sample, in mm, in the
//! patient's coordinates), Image Orientation (the directions of rows and columns) and Pixel
//! Spacing. Slices are ordered along the normal of their plane, whatever their names are. Files of
//! many frames ("enhanced") say the same in functional groups, shared or of each frame; dose grids
//! have a vector of offsets (see `dose`). In a folder, files that are no images are passed over.
//!
//! A volume that is not whole would be silently wrong. So these are errors that name the files: two
//! series in one folder, two slices at one place (times or echoes), a gap, unequal spacing, slices
//! of different sizes or directions. Also refused by name: compressed samples, colours, modality
//! lookup tables, and frames without a position.
//!
//! Values are those of Rescale Slope and Intercept; where these differ from slice to slice (PET),
//! they are computed as `f64`. Segmentations of fractions are divided by Maximum Fractional Value,
//! dose grids are multiplied by Dose Grid Scaling, parametric maps have their Real World Values.
//! The Pixel Padding Value means "no data". Bits above Bits Stored may be overlays, and are not
//! part of a sample.
//!
//! Files are read where they lie, some rows at a time. Memory: what describes the frames.
//!
//! The reader is our own: a data dictionary is large, and some thirty elements say all that is
//! needed.
//! The format: the DICOM standard, parts PS3.3 (C.7.6) and PS3.5 (7).

mod dose;
mod element;
mod file;
mod series;

use super::stack;
use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::formats::shared::cf::Convert;
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::header::plain_info;
use crate::formats::shared::recent::Recent;
use crate::formats::shared::stream::sample_bytes;
use crate::formats::shared::{OpenOptions, has_suffix, pick_field};
use crate::grid::IndexBox;
use crate::volume::chunked::ChunkSource;
use crate::volume::units::{Unit, Units};
use crate::volume::{ScalarType, VolumeInfo, VolumeSource};
use file::{DicomFile, SampleLayout};
use series::Series;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// DICOM.
pub(in crate::formats) struct Dicom;

const SUFFIXES: [&str; 2] = [".dcm", ".ima"];

static ABOUT: About = About { volumes: &["DICOM"], suffixes: &SUFFIXES, ..About::named("a DICOM file") };
/// The slices of a folder or a pattern.
pub(in crate::formats) static OF_SERIES: About =
    About { volumes: &["DICOM"], ..About::named("a DICOM series") };

impl Format for Dicom {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        has_magic(&head.bytes)
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let source = Arc::clone(head.file()?);
        let file = DicomFile::read(&source)?;
        if file.frames.len() == 1 {
            return Err(Error::bad_input(head.path, "Number of Frames", "frames of a volume", "one slice")
                .with_help("name the folder of its series, or a pattern for the slices, in quotes"));
        }
        let series = Arc::new(series::of(head.path, vec![file])?);
        Ok(Box::new(Images { path: head.path.to_path_buf(), series, source: Some(source), io: head.io }))
    }
}

fn has_magic(head: &[u8]) -> bool {
    head.get(128..132) == Some(b"DICM")
}

/// Whether a file is DICOM, by its first bytes.
fn is_dicom(path: &Path) -> Result<bool> {
    let source = ByteSource::open(path, IoMode::Read)?;
    let mut head = vec![0; source.len().min(132) as usize];
    source.read_at(0, &mut head)?;
    Ok(has_magic(&head))
}

/// The slices in a folder, or of a pattern; `None` where there is no DICOM file.
///
/// # Errors
/// [`Error::BadInput`] for files that are no DICOM but are called so, or are damaged, and for
/// slices that are not one volume.
pub(super) fn open_folder(path: &Path, io: IoMode) -> Result<Option<Box<dyn Dataset>>> {
    let is_pattern = stack::is_pattern(path);
    let (mut files, mut others) = (vec![], vec![]);
    for file in stack::files(path)? {
        // The index of a medium lists its files, which are elsewhere.
        let is_index = file.file_name().is_some_and(|name| name.eq_ignore_ascii_case("DICOMDIR"));
        if !is_index && std::fs::metadata(&file).is_ok_and(|m| m.len() > 0) && is_dicom(&file)? {
            files.push(file);
        } else if !is_index && (is_pattern || has_suffix(&file, &SUFFIXES)) {
            others.push(file);
        }
    }
    if files.is_empty() && (is_pattern || others.is_empty()) {
        return Ok(None);
    }
    if let Some(other) = others.first() {
        let got = format!("{}, which has no 'DICM' at byte 128", other.display());
        return Err(Error::bad_input(path, "slices", "DICOM files", got)
            .with_help("fetch the file again, or choose the slices by a pattern, in quotes"));
    }
    // The index of a medium, reports and plans are no slices; `passed_over` names them.
    let mut images = vec![];
    for file in &files {
        images.extend(DicomFile::read_image(&ByteSource::open(file, io)?)?);
    }
    if images.is_empty() {
        let got = format!("{} without samples, as {}", files.len(), files[0].display());
        return Err(
            Error::bad_input(path, "slices", "DICOM images", got).with_help("name the folder of the images")
        );
    }
    let series = Arc::new(series::of(path, images)?);
    Ok(Some(Box::new(Images { path: path.to_path_buf(), series, source: None, io })))
}

/// The frames of all files, as one volume.
struct Images {
    /// The file, folder or pattern that was named.
    path: PathBuf,
    series: Arc<Series>,
    /// The file, where there is only one; a series may have more than can be open.
    source: Option<Arc<ByteSource>>,
    io: IoMode,
}

impl Dataset for Images {
    fn files(&self) -> Vec<PathBuf> {
        self.series.paths.clone()
    }

    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let (path, series) = (&*self.path, &self.series);
        let SampleLayout { columns, rows, bits_stored, .. } = series.layout;
        let stored = series.layout.scalar();
        let first = &series.slices[0];
        let varies = series.slices.iter().any(|s| (s.slope, s.intercept) != (first.slope, first.intercept));
        let scalar = if varies { ScalarType::F64 } else { stored };
        let dims = [columns.into(), rows.into(), series.slices.len() as u64];
        sample_bytes(path, dims, scalar)?;
        let is_one = self.source.is_some();
        let files = if is_one { "frames".into() } else { format!("{} files", series.paths.len()) };
        let format = format!("DICOM ({files}, {} of {bits_stored} bits)", stored.name());
        let mut info = plain_info(path, format, dims, scalar, series.geometry);
        info.units = Units { value: series.unit.clone(), ..Units::of_length(Unit::length("mm")) };
        pick_field(path, &info.fields, options.field.as_deref())?;
        let mut convert = None;
        if varies {
            let lines = series.slices.iter().map(|s| [s.slope, s.intercept]).collect();
            let valid = [f64::NEG_INFINITY, f64::INFINITY];
            let missing = series.layout.padding.into_iter().collect();
            convert = Some(Convert { valid, missing, lines, slices: [1, dims[2]] });
        } else {
            (info.slope, info.intercept, info.missing) =
                (first.slope, first.intercept, series.layout.padding);
        }
        if !is_one {
            info.data_files.clone_from(&series.paths);
        }
        Ok(VolumeSource::Chunked(Arc::new(Rows {
            rows: (ROWS_BYTES / (dims[0] * 8)).clamp(1, dims[1]),
            info,
            series: Arc::clone(series),
            io: self.io,
            source: self.source.clone(),
            files: Recent::default(),
            convert,
        })))
    }
}

/// Bytes of the rows that are decoded together, at most, where one row is not more.
const ROWS_BYTES: u64 = 256 << 10;

/// Some rows of a slice each time.
struct Rows {
    info: VolumeInfo,
    series: Arc<Series>,
    io: IoMode,
    /// The file, where there is only one.
    source: Option<Arc<ByteSource>>,
    /// The files of a series that were read last.
    files: Recent<ByteSource>,
    /// How stored numbers become values, where that differs between slices.
    convert: Option<Convert>,
    rows: u64,
}

impl ChunkSource for Rows {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn chunk_dims(&self) -> [u64; 3] {
        [self.info.dims[0], self.rows, 1]
    }

    fn decoding_bytes(&self) -> u64 {
        // Stored, and given out.
        16 * self.info.dims[0] * self.rows
    }

    fn decode(&self, [_, y, z]: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        let d = self.info.dims;
        let lo = (y * self.rows).min(d[1]);
        let part = IndexBox { lo: [0, lo, z], hi: [d[0], (lo + self.rows).min(d[1]), z + 1] };
        let Series { layout, slices, paths, .. } = &*self.series;
        let slice = &slices[z as usize];
        let size = layout.scalar().bytes();
        let source = match &self.source {
            Some(source) => Arc::clone(source),
            None => self.files.get(slice.file, || ByteSource::open(&paths[slice.file], self.io))?,
        };
        let mut stored = vec![0; part.len() * size];
        source.read_at(slice.at + lo * d[0] * size as u64, &mut stored)?;
        out.clear();
        out.reserve(part.len() * self.info.field.scalar.bytes());
        for bytes in stored.chunks_exact_mut(size) {
            if slice.big_endian {
                bytes.reverse();
            }
            let number = layout.number(bytes);
            match &self.convert {
                Some(convert) => out.extend(convert.value(number as f64, [0, z]).to_le_bytes()),
                None => out.extend(&number.to_le_bytes()[..size]),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
