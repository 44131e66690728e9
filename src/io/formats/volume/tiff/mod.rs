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
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::header::{geometry, given_geometry, plain_info, scaled_axes};
use crate::formats::shared::recent::Recent;
use crate::formats::shared::stream::sample_bytes;
use crate::formats::shared::{Frames, OpenOptions, known_times, pick_field};
use crate::volume::chunked::ChunkSource;
use crate::volume::strided::StridedVolume;
use crate::volume::units::Units;
use crate::volume::{Assumed, VolumeInfo, VolumeSource};
use ifd::Tiff;
pub(in crate::formats) use ifd::has_magic;
use page::{Page, Shape};
use place::{SampleSpacing, imagej, ome};
use planes::Planes;
use slices::SliceFiles;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// TIFF, one file with a page for each slice.
pub(in crate::formats) struct TiffFile;

static ABOUT: About = About {
    volumes: &["TIFF"],
    suffixes: &SUFFIXES,
    on_servers: true,
    has_spacing: false,
    has_channels: true,
    ..About::named("a TIFF file")
};
/// A stack of files.
pub(in crate::formats) static OF_STACK: About =
    About { volumes: &["TIFF"], has_spacing: false, ..About::named("a stack of TIFF files") };

impl Format for TiffFile {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        has_magic(&head.bytes)
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        Ok(Box::new(TiffPages::open(head.file()?)?))
    }
}

/// Endings of names of TIFF files.
pub(in crate::formats) const SUFFIXES: [&str; 4] = [".tif", ".tiff", ".btf", ".tf8"];

/// Bytes decoded at a time, unless a strip or a row of tiles has more.
const CHUNK_BYTES: u64 = 1 << 20;

/// One file of several pages.
struct TiffPages {
    tiff: Tiff,
    /// Where the pages are, without thumbnails and masks.
    places: Vec<u64>,
    first: Page,
    /// Whether all are read where they lie.
    in_place: bool,
    /// The channels and moments, where there are several.
    planes: Option<Planes>,
}

impl TiffPages {
    fn open(source: &Arc<ByteSource>) -> Result<Self> {
        let (path, tiff) = (source.path(), Tiff::open(Arc::clone(source))?);
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
        let planes = Planes::of(path, &first.description)?;
        Ok(Self { tiff, places, first, in_place, planes })
    }
}

impl Dataset for TiffPages {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let Self { tiff, places, first, in_place, planes } = self;
        if let Some(planes) = planes {
            return self.of_planes(planes, options);
        }
        options.refuse_channel(tiff.source.path())?;
        let images = images(&first.description);
        if places.len() == 1 && images > 1 {
            let info = info("TIFF (ImageJ stack", tiff, first, images, options)?;
            return imagej_stack(tiff, places[0], first, images, info, [0, 1]);
        }
        if places.len() == 1 {
            let help = "for a stack of slices name their folder, or a pattern in quotes: \"slice_*.tif\"";
            return Err(tiff.wrong("pages", "at least 2 slices", "1").with_help(help));
        }
        if images > 1 && images != places.len() as u64 {
            let expected = format!("{images} images, as the description says");
            return Err(tiff.wrong("pages", &expected, format!("{}", places.len())));
        }
        let info = info("TIFF (pages", tiff, first, places.len() as u64, options)?;
        if *in_place {
            mapped(info, tiff, places)
        } else {
            Ok(chunked(info, first, Pages::OfFile(tiff.clone(), places.clone())))
        }
    }

    fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        Ok(self.planes.as_ref().map_or_else(Vec::new, |planes| planes.frames(options)))
    }

    fn times(&self, _: &OpenOptions) -> Result<HashMap<String, f64>> {
        Ok(self.planes.as_ref().map_or_else(HashMap::new, |planes| known_times(planes.all_frames())))
    }
}

impl TiffPages {
    /// The pages of one channel and moment.
    fn of_planes(&self, planes: &Planes, options: &OpenOptions) -> Result<VolumeSource> {
        let Self { tiff, places, first, in_place, .. } = self;
        let is_one_page = places.len() == 1 && images(&first.description) == planes.count();
        if !is_one_page && places.len() as u64 != planes.count() {
            let got = places.len().to_string();
            let expected = format!("{} images of {planes}, as the description says", planes.count());
            return Err(tiff
                .wrong("pages", &expected, got)
                .with_help("write each channel and moment to a file of its own"));
        }
        if planes.slices < 2 {
            return Err(tiff.wrong("pages", "at least 2 slices", planes.to_string()));
        }
        let scalar = first.shape.scalar;
        let (field, channel, moment) = planes.choose(tiff.source.path(), scalar, options)?;
        let all = OpenOptions { field: None, ..options.clone() };
        let kind = if is_one_page { "TIFF (ImageJ stack" } else { "TIFF (pages" };
        let mut info = info(kind, tiff, first, planes.slices, &all)?;
        (info.field, info.fields) = (field, planes.fields(scalar));
        info.units.time.clone_from(&planes.times.unit);
        info.notes.extend(planes.times.notes.iter().cloned());
        let number = |z| planes.number(channel, z, moment);
        if is_one_page {
            let slices = [number(0), number(1) - number(0)];
            return imagej_stack(tiff, places[0], first, planes.count(), info, slices);
        }
        let pages: Vec<u64> = (0..planes.slices).map(|z| places[number(z) as usize]).collect();
        if *in_place {
            mapped(info, tiff, &pages)
        } else {
            Ok(chunked(info, first, Pages::OfFile(tiff.clone(), pages)))
        }
    }
}

/// A stack of files, a slice each.
struct Stack {
    /// The folder or the pattern that was named.
    path: PathBuf,
    files: Vec<PathBuf>,
    /// The first one, and its page.
    tiff: Tiff,
    first: Page,
    /// Where samples begin in each file, where they are read where they lie.
    offsets: Option<Vec<u64>>,
    io: IoMode,
}

impl Dataset for Stack {
    fn files(&self) -> Vec<PathBuf> {
        self.files.clone()
    }

    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let count = self.files.len() as u64;
        let mut info = info_at(&self.path, "TIFF (stack", &self.tiff, &self.first, count, options)?;
        info.data_files.clone_from(&self.files);
        if let Some(offsets) = &self.offsets {
            let (files, offsets) = (self.files.clone(), offsets.clone());
            let volume = SliceFiles::new(info, files, offsets, self.tiff.big_endian, self.io);
            return Ok(VolumeSource::Random(Box::new(volume)));
        }
        Ok(chunked(info, &self.first, Pages::Files(self.files.clone(), self.io, Recent::default())))
    }
}

/// Opens a stack of files, a slice each; `path` is the folder or the pattern that was named.
///
/// # Errors
/// [`Error::BadInput`] when a slice is malformed, of a kind that is not read, or differs from the
/// first one.
pub(in crate::formats) fn open_stack(
    path: &Path,
    files: Vec<PathBuf>,
    io: IoMode,
) -> Result<Box<dyn Dataset>> {
    let (mut first, mut offsets) = (None::<(Tiff, Page)>, Some(vec![]));
    for file in &files {
        let (tiff, page) = only_page(file, io)?;
        let at = page.in_place();
        if let Some((other, of)) = &first {
            same_shape(file, "slice", of.shape, page.shape)?;
            offsets = offsets.filter(|_| tiff.big_endian == other.big_endian);
        } else {
            first = Some((tiff, page));
        }
        offsets = offsets.zip(at).map(|(mut all, at)| {
            all.push(at);
            all
        });
    }
    let Some((tiff, first)) = first else {
        return Err(Error::bad_input(path, "slices", "TIFF files", "none"));
    };
    Ok(Box::new(Stack { path: path.to_path_buf(), files, tiff, first, offsets, io }))
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

/// What a volume of so many slices like a page is.
fn info(kind: &str, tiff: &Tiff, page: &Page, slices: u64, options: &OpenOptions) -> Result<VolumeInfo> {
    info_at(tiff.source.path(), kind, tiff, page, slices, options)
}

fn info_at(
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
    let place =
        if options.spacing.is_some() { SampleSpacing::default() } else { SampleSpacing::of(path, page)? };
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
    /// Those that were used last stay open.
    Files(Vec<PathBuf>, IoMode, Recent<(Tiff, Page)>),
}

impl Pages {
    fn page(&self, number: usize) -> Result<Arc<(Tiff, Page)>> {
        match self {
            Self::OfFile(tiff, places) => Ok(Arc::new((tiff.clone(), Page::parse(tiff, places[number])?))),
            Self::Files(files, io, open) => open.get(number, || only_page(&files[number], *io)),
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
        let (tiff, page) = &*self.pages.page(at[2] as usize)?;
        // A file may have changed since it was opened.
        same_shape(tiff.source.path(), "slice", Shape { dims: [x, y], scalar }, page.shape)?;
        let first = at[1].saturating_mul(self.rows).min(y);
        page.rows(tiff, first, first.saturating_add(self.rows).min(y), out)
    }
}

#[cfg(test)]
mod tests;
