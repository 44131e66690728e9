//! TIFF: a stack of slices in a folder (`scan/` or `"scan/slice_*.tif"`), or the pages of one file;
//! also BigTIFF.
//!
//! A page is cut into strips or tiles, each compressed by itself:
//!
//! ```text
//!  ┌─────────┐ strip 0     ┌────┬────┬──┐
//!  ├─────────┤ strip 1     │ 0  │ 1  │ 2│   tiles at the far sides are padded
//!  ├─────────┤ strip 2     ├────┼────┼──┤
//!  └─────────┘ (shorter)   │ 3  │ 4  │ 5│
//!                          └────┴────┴──┘
//! ```
//!
//! Consecutive uncompressed strips are mapped and read in place, without a copy; every page may
//! start elsewhere. Anything else (LZW, deflate, PackBits, zstd; tiles; predictors) is decoded by
//! rows of strips or tiles, as they are asked for ([`crate::volume::chunked`]). Memory: some rows,
//! and a page's table of strips, which is read for each.
//!
//! The reader takes grey values of 8 to 64 bits, integers and floats, in either byte order. It
//! refuses by name: colours, palettes, other numbers of bits, JPEG and other compressions, pages
//! that differ in size or type, missing slices. Pages that are thumbnails or masks of others are
//! skipped. Pages of several channels or moments, as ImageJ and OME-XML describe them, are fields:
//! `data:c0`, `data:DAPI`, `data:t0`, `data:DAPI:t0`. ImageJ's stacks of more than 4 GiB have one
//! page, whose description has the number of images that follow each other: they are read too.
//!
//! TIFF has no tag for the distance of slices, and its resolution is usually that of a screen. So
//! spacing comes from ImageJ's description or from OME-XML (see the module `place`); without either
//! it is 1. What the user gives replaces it. The times of moments are in these descriptions too
//! (see the module `times`). Rows are in the file's order: the tag for orientation is not applied.
//!
//! The parser is our own, because mapping in place needs the places of the strips, and they are
//! most of TIFF. The format: TIFF 6.0 (Adobe, 1992); BigTIFF:
//! <https://www.awaresystems.be/imaging/tiff/bigtiff.html>.

mod ifd;
mod page;
mod place;
mod planes;
mod slices;
mod times;

use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::formats::shared::format::{Format, Head};
use crate::formats::shared::header::{geometry, given_geometry, plain_info, scaled_axes};
use crate::formats::shared::stream::sample_bytes;
use crate::formats::shared::{Frames, OpenOptions, known_times, pick_field};
use crate::volume::chunked::ChunkSource;
use crate::volume::strided::StridedVolume;
use crate::volume::units::Units;
use crate::volume::{Assumed, VolumeInfo, VolumeSource};
use ifd::Tiff;
pub(in crate::formats) use ifd::has_magic;
use page::{Page, Shape};
use place::{Place, imagej, ome};
use planes::Planes;
use slices::SliceFiles;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// TIFF, one file with a page for each slice.
pub(in crate::formats) struct TiffFile;

impl Format for TiffFile {
    fn name(&self) -> &'static str {
        "a TIFF file"
    }

    fn is_on_servers(&self) -> bool {
        true
    }

    fn suffixes(&self) -> &'static [&'static str] {
        &SUFFIXES
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        has_magic(&head.bytes)
    }

    fn has_spacing(&self) -> bool {
        false
    }

    fn has_channels(&self) -> bool {
        true
    }

    fn frames(&self, path: &Path, options: &OpenOptions) -> Result<Option<Frames>> {
        let planes = planes_of(path, options)?;
        Ok(Some(planes.map_or(vec![], |planes| planes.frames(options))))
    }

    fn times(&self, path: &Path, options: &OpenOptions) -> Result<HashMap<String, f64>> {
        let planes = planes_of(path, options)?;
        Ok(planes.map_or_else(HashMap::new, |planes| known_times(planes.all_frames())))
    }

    fn volume(&self, path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
        open(path, options)
    }
}

/// Endings of names of TIFF files.
pub(in crate::formats) const SUFFIXES: [&str; 4] = [".tif", ".tiff", ".btf", ".tf8"];

/// Bytes decoded at a time, unless a strip or a row of tiles has more.
const CHUNK_BYTES: u64 = 1 << 20;

/// Opens one file of several pages.
///
/// # Errors
/// [`Error::BadInput`] when it is malformed, of a kind that is not read, or has a single page.
pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    let tiff = Tiff::open(Arc::new(ByteSource::open(path, options.io)?))?;
    let (mut places, mut pages) = (vec![], None::<(Page, bool)>);
    for place in tiff.places()? {
        let page = Page::parse(&tiff, place)?;
        if page.secondary {
            continue;
        }
        match &mut pages {
            None => pages = Some((page.clone(), page.in_place().is_some())),
            Some((first, in_place)) => {
                let name = format!("page {}", places.len());
                same_shape(path, &name, first.shape, page.shape)?;
                *in_place &= page.in_place().is_some();
            }
        }
        places.push(place);
    }
    let Some((first, in_place)) = pages else {
        return Err(tiff.wrong("pages", "a page that is no thumbnail or mask", "none"));
    };
    if let Some(planes) = Planes::of(path, &first.description)? {
        return of_planes(&tiff, &places, &first, in_place, &planes, options);
    }
    options.refuse_channel(path)?;
    let images = images(&first.description);
    if places.len() == 1 && images > 1 {
        let info = info(path, "TIFF (ImageJ stack", &tiff, &first, images, options)?;
        return imagej_stack(&tiff, places[0], &first, images, info, [0, 1]);
    }
    if places.len() == 1 {
        let help = "for a stack of slices name their folder, or a pattern in quotes: \"slice_*.tif\"";
        return Err(tiff.wrong("pages", "at least 2 slices", "1").with_help(help));
    }
    if images > 1 && images != places.len() as u64 {
        let expected = format!("{images} images, as the description says");
        return Err(tiff.wrong("pages", &expected, format!("{}", places.len())));
    }
    let info = info(path, "TIFF (pages", &tiff, &first, places.len() as u64, options)?;
    if in_place {
        mapped(info, &tiff, &places)
    } else {
        Ok(chunked(info, &first, Pages::OfFile(tiff, places)))
    }
}

/// Opens the pages of one channel and moment.
fn of_planes(
    tiff: &Tiff,
    places: &[u64],
    first: &Page,
    in_place: bool,
    planes: &Planes,
    options: &OpenOptions,
) -> Result<VolumeSource> {
    let path = tiff.source.path();
    let is_one_page = places.len() == 1 && images(&first.description) == planes.count();
    if !is_one_page && places.len() as u64 != planes.count() {
        let got = places.len().to_string();
        return Err(tiff
            .wrong("pages", &format!("{} images of {planes}, as the description says", planes.count()), got)
            .with_help("write each channel and moment to a file of its own"));
    }
    if planes.slices < 2 {
        return Err(tiff.wrong("pages", "at least 2 slices", planes.to_string()));
    }
    let scalar = first.shape.scalar;
    let (field, channel, moment) = planes.choose(path, scalar, options)?;
    let all = OpenOptions { field: None, ..options.clone() };
    let kind = if is_one_page { "TIFF (ImageJ stack" } else { "TIFF (pages" };
    let mut info = info(path, kind, tiff, first, planes.slices, &all)?;
    (info.field, info.fields) = (field, planes.fields(scalar));
    info.units.time.clone_from(&planes.times.unit);
    info.notes.extend(planes.times.notes.iter().cloned());
    let number = |z| planes.number(channel, z, moment);
    if is_one_page {
        return imagej_stack(
            tiff,
            places[0],
            first,
            planes.count(),
            info,
            [number(0), number(1) - number(0)],
        );
    }
    let pages: Vec<u64> = (0..planes.slices).map(|z| places[number(z) as usize]).collect();
    if in_place {
        mapped(info, tiff, &pages)
    } else {
        Ok(chunked(info, first, Pages::OfFile(tiff.clone(), pages)))
    }
}

/// The channels and moments of a file; none where there is one.
fn planes_of(path: &Path, options: &OpenOptions) -> Result<Option<Planes>> {
    let tiff = Tiff::open(Arc::new(ByteSource::open(path, options.io)?))?;
    let Some(place) = tiff.places()?.first().copied() else { return Ok(None) };
    Planes::of(path, &Page::parse(&tiff, place)?.description)
}

/// Opens a stack of files, a slice each; `path` is the folder or the pattern that was named.
///
/// # Errors
/// [`Error::BadInput`] when a slice is malformed, of a kind that is not read, or differs from the
/// first one.
pub(in crate::formats) fn open_stack(
    path: &Path,
    files: Vec<PathBuf>,
    options: &OpenOptions,
) -> Result<VolumeSource> {
    let (mut first, mut in_place) = (None::<(Tiff, Page)>, Some(vec![]));
    for file in &files {
        let (tiff, page) = only_page(file, options.io)?;
        let at = page.in_place();
        if let Some((other, of)) = &first {
            same_shape(file, "slice", of.shape, page.shape)?;
            in_place = in_place.filter(|_| tiff.big_endian == other.big_endian);
        } else {
            first = Some((tiff, page));
        }
        in_place = in_place.zip(at).map(|(mut all, at)| {
            all.push(at);
            all
        });
    }
    let Some((tiff, first)) = first else {
        return Err(Error::bad_input(path, "slices", "TIFF files", "none"));
    };
    let mut info = info(path, "TIFF (stack", &tiff, &first, files.len() as u64, options)?;
    info.data_files.clone_from(&files);
    if let Some(offsets) = in_place {
        let volume = SliceFiles::new(info, files, offsets, tiff.big_endian, options.io);
        return Ok(VolumeSource::Random(Box::new(volume)));
    }
    Ok(chunked(info, &first, Pages::Files(files, options.io)))
}

/// The page of a slice's file.
fn only_page(file: &Path, io: IoMode) -> Result<(Tiff, Page)> {
    let tiff = Tiff::open(Arc::new(ByteSource::open(file, io)?))?;
    let mut found = None;
    for place in tiff.places()? {
        let page = Page::parse(&tiff, place)?;
        if !page.secondary && found.replace(page).is_some() {
            return Err(tiff.wrong("pages", "one, as a slice of a stack has", "several").with_help(
                "name the one file that holds the volume, or a pattern for the slices, in quotes",
            ));
        }
    }
    let page = found.ok_or_else(|| tiff.wrong("pages", "a page that is no thumbnail or mask", "none"))?;
    if images(&page.description) > 1 || Planes::of(file, &page.description)?.is_some() {
        return Err(tiff.wrong("description", "one image, as a slice of a stack has", "a stack"));
    }
    Ok((tiff, page))
}

fn same_shape(path: &Path, at: &str, expected: Shape, got: Shape) -> Result<()> {
    if expected == got {
        return Ok(());
    }
    let expected = format!("{expected}, as in the first one");
    Err(Error::bad_input(path, at, expected, got.to_string())
        .with_help("all slices of a volume have the same size and type"))
}

fn info(
    path: &Path,
    kind: &str,
    tiff: &Tiff,
    page: &Page,
    slices: u64,
    options: &OpenOptions,
) -> Result<VolumeInfo> {
    let ([x, y], scalar) = (page.shape.dims, page.shape.scalar);
    let dims = [x, y, slices];
    sample_bytes(path, dims, scalar)?;
    let big = if tiff.big { "Big" } else { "" };
    let format = format!("{big}{kind}, {})", page.compression.name());
    // What a user gives has no unit of the file.
    let place = if options.spacing.is_some() { Place::default() } else { Place::of(path, page)? };
    let geometry = geometry(path, "spacing", [0.0; 3], scaled_axes(place.spacing))?;
    let geometry = given_geometry(path, options, geometry)?;
    let mut info = plain_info(path, format, dims, scalar, geometry);
    (info.units, info.notes) = (Units::of_length(place.unit), place.notes);
    info.assumed = Assumed { axes: place.missing, can_be_given: true };
    pick_field(path, &info.fields, options.field.as_deref())?;
    Ok(info)
}

/// ImageJ writes stacks of more than 4 GiB as one page and the images one after the other. Of these
/// a volume has one as its first slice, and each `step`-th after it.
fn imagej_stack(
    tiff: &Tiff,
    place: u64,
    page: &Page,
    images: u64,
    info: VolumeInfo,
    [first, step]: [u64; 2],
) -> Result<VolumeSource> {
    let Some(at) = page.in_place() else {
        let expected = "uncompressed images one after the other, as ImageJ writes them";
        let got = format!("one page of {} data for {images} images", page.compression.name());
        return Err(tiff.wrong("pages", expected, got));
    };
    let [x, y, _] = info.dims;
    let end = at.saturating_add(sample_bytes(&info.path, [x, y, images], info.field.scalar)?);
    if (at..end).contains(&place) {
        let got = format!("the directory at byte {place} among {images} images from byte {at} to {end}");
        return Err(tiff.wrong("description", "images that follow each other", got));
    }
    // All images together were counted.
    let [along_x, along_y, image] = packed(&info)?;
    let (start, strides) = (at + first * image as u64, [along_x, along_y, step as i64 * image]);
    let volume = StridedVolume::new(info, Arc::clone(&tiff.source), start, tiff.big_endian, strides)?;
    Ok(volume.source())
}

fn packed(info: &VolumeInfo) -> Result<[i64; 3]> {
    StridedVolume::packed_strides(info.dims, info.field.scalar).ok_or_else(|| {
        let [x, y, z] = info.dims;
        Error::bad_input(&info.path, "dimensions", "fewer than 2^63 bytes", format!("{x} x {y} x {z}"))
    })
}

/// The number of images that an ImageJ description states; 1 without one.
fn images(description: &str) -> u64 {
    imagej(description, "images").and_then(|v| v.parse().ok()).unwrap_or(1)
}

/// All pages of a file, read where they lie.
fn mapped(info: VolumeInfo, tiff: &Tiff, places: &[u64]) -> Result<VolumeSource> {
    let mut parts = vec![];
    for &place in places {
        let changed = || tiff.wrong("samples", "the uncompressed strips that were there", "others");
        parts.push((Arc::clone(&tiff.source), Page::parse(tiff, place)?.in_place().ok_or_else(changed)?));
    }
    let strides = packed(&info)?;
    let volume = StridedVolume::stacked_at(info, parts, 1, tiff.big_endian, strides)?;
    Ok(volume.source())
}

/// Where the pages of a volume are.
enum Pages {
    OfFile(Tiff, Vec<u64>),
    Files(Vec<PathBuf>, IoMode),
}

impl Pages {
    fn page(&self, number: usize) -> Result<(Tiff, Page)> {
        match self {
            Self::OfFile(tiff, places) => Ok((tiff.clone(), Page::parse(tiff, places[number])?)),
            Self::Files(files, io) => only_page(&files[number], *io),
        }
    }
}

fn chunked(info: VolumeInfo, first: &Page, pages: Pages) -> VolumeSource {
    let (row, step) = (info.dims[0].saturating_mul(info.field.scalar.bytes() as u64), first.part_rows());
    let together = (CHUNK_BYTES / row.saturating_mul(step).max(1)).max(1);
    let rows = step.saturating_mul(together).min(info.dims[1]);
    // The samples, and a strip or tile before and after it is decoded: that may be larger than the
    // page.
    let decoding_bytes = row.saturating_mul(rows).saturating_add(first.part_bytes().saturating_mul(2));
    VolumeSource::Chunked(Arc::new(PageChunks { info, pages, rows, decoding_bytes }))
}

/// The pages of a volume, some strips or a row of tiles each time.
struct PageChunks {
    info: VolumeInfo,
    pages: Pages,
    /// Rows that are decoded together.
    rows: u64,
    decoding_bytes: u64,
}

impl ChunkSource for PageChunks {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn chunk_dims(&self) -> [u64; 3] {
        [self.info.dims[0], self.rows, 1]
    }

    fn decoding_bytes(&self) -> u64 {
        self.decoding_bytes
    }

    fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        out.clear();
        let ([x, y, _], scalar) = (self.info.dims, self.info.field.scalar);
        let (tiff, page) = self.pages.page(at[2] as usize)?;
        // A file may have changed since it was opened.
        same_shape(tiff.source.path(), "slice", Shape { dims: [x, y], scalar }, page.shape)?;
        let first = at[1].saturating_mul(self.rows).min(y);
        page.rows(&tiff, first, first.saturating_add(self.rows).min(y), out)
    }
}

#[cfg(test)]
mod tests;
