//! Legacy VTK files (`.vtk`): structured points as volumes, unstructured grids as meshes (see
//! `cells`).
//!
//! ```text
//! # vtk DataFile Version 3.0
//! a title
//! BINARY                               or ASCII
//! DATASET STRUCTURED_POINTS
//! DIMENSIONS 76 49 45
//! SPACING 1 1 1                        ASPECT_RATIO in old files
//! ORIGIN 100 80 1
//! POINT_DATA 167580
//! SCALARS speed float                  name, type, number of components
//! LOOKUP_TABLE default
//! …                                    big-endian numbers, or text
//! VECTORS velocity float
//! …
//! FIELD attributes 1
//! pressure 1 167580 float              name, components, tuples, type
//! …
//! ```
//!
//! A file has no table of contents. To find an array, the reader skips all arrays before it: by
//! their lengths in a binary file, word by word in a text. Binary samples are then mapped where
//! they lie; text is a stream of slabs. Keywords may be in any case, names are percent-encoded.
//!
//! **Rectilinear and structured grids** are read alike, in index space; [`coordinates`] gives the
//! positions of their samples: `X_COORDINATES 76 float` (Y, Z), or `POINTS 167580 float` with three
//! numbers a sample.
//!
//! **Fields** are the arrays of the point data. Without `field` the one array under `SCALARS` is
//! read where there is exactly one with one component (VTK's writer puts the active scalars there
//! and all others under `FIELD`), else the only array with one component. Cell data are samples in
//! the middles of the cells: one fewer along each axis. They are read where no array of the point
//! data is a scalar, or by their name.
//!
//! A `long` is taken to have 8 bytes, as on every 64-bit Unix; `char` is signed; a binary
//! `vtkIdType` is stored in 4 bytes, even if it has more in memory. Arrays of bits and strings are
//! skipped.

mod cells;
mod scan;

use crate::bytes::ByteSource;
use crate::cells::{CellMesh, Center, GHOSTS, HIDDEN, NumberStream};
use crate::error::{Error, Result};
use crate::formats::shared::OpenOptions;
use crate::formats::shared::centers::{Middles, Picked, along_axis, first_sample, pick, samples};
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::format::{self, About, Format, Head};
use crate::formats::shared::header;
use crate::formats::shared::mesh_file::MeshFile;
use crate::formats::shared::ranges::RangeNumbers;
use crate::formats::shared::stream::{TextSlabs, sample_bytes};
use crate::formats::shared::text::TextNumbers;
use crate::volume::strided::StridedVolume;
use crate::volume::units::Units;
use crate::volume::{Assumed, ScalarType, VolumeInfo, VolumeSource};
use scan::{Dataset, LegacyArray, Scanned, Scanner, Type};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// Legacy VTK.
pub(in crate::formats) struct VtkLegacy;

static ABOUT: About = About {
    volumes: &["legacy VTK"],
    meshes: &["legacy VTK"],
    suffixes: &[".vtk"],
    magic: &[b"# vtk DataFile"],
    ..About::named("a legacy VTK file")
};

impl Format for VtkLegacy {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn format::Dataset>> {
        let source = head.file()?;
        if is_mesh(&head.bytes) {
            return Ok(Box::new(MeshFile::new(cells::open(source)?)?));
        }
        Ok(Box::new(LegacyFile::open(source)?))
    }
}

impl format::Dataset for MeshFile<cells::Grid> {
    fn is_mesh(&self) -> bool {
        true
    }

    fn mesh(&self, options: &OpenOptions) -> Result<CellMesh> {
        self.of_field(options)
    }

    fn time(&self, _: &OpenOptions) -> Result<Option<f64>> {
        let (source, scanned) = self.file.scanned();
        time(source, scanned)
    }
}

/// Structured points, or a rectilinear or curvilinear grid.
struct LegacyFile {
    source: Arc<ByteSource>,
    scanned: Scanned,
}

impl LegacyFile {
    fn open(source: &Arc<ByteSource>) -> Result<Self> {
        let scanned = Scanner::new(source.path(), source.slice(0..source.len())?, &GRIDS)?.scan()?;
        Ok(Self { source: Arc::clone(source), scanned })
    }
}

impl format::Dataset for LegacyFile {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let (source, file, path) = (&self.source, &self.scanned, self.source.path());
        let Picked { field, center, index, fields } = choose(path, file, options.field.as_deref())?;
        refuse_hidden(source, file)?;
        let of_center = arrays_of(file, center).iter();
        let mut readable = of_center.filter(|a| a.name != GHOSTS && a.field().is_some());
        let chosen = readable.nth(index).expect("it was picked among those");
        let first = match file.dataset {
            Dataset::StructuredPoints => first_sample(file.dims, center),
            // The grid's coordinates say where its samples are.
            _ => [0.0; 3],
        };
        let origin = std::array::from_fn(|a| file.origin[a] + first[a] * file.spacing[a]);
        let info = VolumeInfo {
            path: path.to_path_buf(),
            format: format_name(file, center),
            dims: samples(file.dims, center),
            field,
            fields,
            geometry: header::geometry(path, "ORIGIN, SPACING", origin, header::scaled_axes(file.spacing))?,
            slope: 1.0,
            intercept: 0.0,
            missing: None,
            units: Units::default(),
            notes: vec![],
            data_files: vec![],
            assumed: Assumed::default(),
            is_labels: false,
        };
        let data = chosen.data.clone();
        if !file.binary {
            let push = file.words_of(&data);
            let slabs = TextSlabs::new(info, Arc::clone(source), data)?.written(push);
            return Ok(VolumeSource::Stream(Box::new(slabs)));
        }
        sample_bytes(path, info.dims, info.field.scalar)?;
        let strides = StridedVolume::packed_strides(info.dims, info.field.scalar);
        let strides = strides.expect("the size of the samples was checked");
        let volume = StridedVolume::new(info, Arc::clone(source), data.start, true, strides)?;
        Ok(VolumeSource::Random(Box::new(volume)))
    }

    fn coordinates(&self, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
        coordinates(&self.source, &self.scanned, options.field.as_deref())
    }

    fn time(&self, _: &OpenOptions) -> Result<Option<f64>> {
        time(&self.source, &self.scanned)
    }
}

fn format_name(file: &Scanned, center: Center) -> String {
    let how = match (file.binary, center) {
        (true, Center::Point) => "binary",
        (false, Center::Point) => "ascii",
        (true, Center::Cell) => "cell data, binary",
        (false, Center::Cell) => "cell data, ascii",
    };
    format!("legacy VTK {} ({how})", file.dataset.name().to_ascii_lowercase().replace('_', " "))
}

/// Refuses points and cells that are marked as hidden: what is there would be taken for data.
fn refuse_hidden(source: &Arc<ByteSource>, file: &Scanned) -> Result<()> {
    for (place, hidden) in HIDDEN {
        let (center, section) = match place {
            "CellData" => (Center::Cell, "CELL_DATA"),
            _ => (Center::Point, "POINT_DATA"),
        };
        let Some(array) = arrays_of(file, center).iter().find(|a| a.name == GHOSTS) else { continue };
        let Type::Number(scalar) = array.kind else { continue };
        let count = samples(file.dims, center).iter().product::<u64>();
        let (mut left, mut found, mut stream) = (count, 0u64, numbers(source, file, &array.data, scalar));
        let mut marks = vec![];
        while left > 0 {
            marks.resize(left.min(1 << 16) as usize, 0.0);
            stream.fill(&mut marks)?;
            found += marks.iter().filter(|&&m| m as u8 & hidden != 0).count() as u64;
            left -= marks.len() as u64;
        }
        if found > 0 {
            let (at, got) = (format!("{section}, {GHOSTS}"), format!("{found} of {count}"));
            return Err(Error::bad_input(source.path(), at, "no hidden points or cells", got).with_help(
                "give the samples there the value NaN (then see `nan`), or write what is visible as .vtu",
            ));
        }
    }
    Ok(())
}

/// The datasets whose samples are a volume.
const GRIDS: [Dataset; 3] = [Dataset::StructuredPoints, Dataset::RectilinearGrid, Dataset::StructuredGrid];

/// The numbers of an array.
fn numbers(source: &Arc<ByteSource>, file: &Scanned, data: &Range<u64>, scalar: ScalarType) -> RangeNumbers {
    match file.binary {
        true => RangeNumbers::binary(source, data.clone(), scalar, true),
        // In a text, integers have the width that they need.
        false => {
            let words = TextNumbers::new(source, data.clone()).written(file.words_of(data));
            RangeNumbers::words(words, scalar)
        }
    }
}

/// The coordinates of the samples of a field of a rectilinear or curvilinear grid; `None` of
/// structured points.
///
/// # Errors
/// Those of a choice of fields; [`Error::BadInput`] for a malformed file.
fn coordinates(
    source: &Arc<ByteSource>,
    file: &Scanned,
    wanted: Option<&str>,
) -> Result<Option<GridCoordinates>> {
    let path = source.path();
    if file.dataset == Dataset::StructuredPoints {
        return Ok(None);
    }
    let center = choose(path, file, wanted)?.center;
    let part = |array: Option<(u64, &LegacyArray)>, keyword: &str, expected: u64| {
        let Some((n, array)) = array.filter(|(n, _)| *n == expected) else {
            let got = array.map_or("none".into(), |(n, _)| n.to_string());
            return Err(Error::bad_input(path, keyword, format!("{expected} for the DIMENSIONS"), got));
        };
        match array.kind {
            Type::Number(scalar) => Ok((n, numbers(source, file, &array.data, scalar))),
            _ => Err(Error::bad_input(path, keyword, "numbers", "bits or strings")),
        }
    };
    match file.dataset {
        Dataset::RectilinearGrid => {
            let mut axes: [Vec<f64>; 3] = Default::default();
            for (a, axis) in axes.iter_mut().enumerate() {
                let keyword = ["X_COORDINATES", "Y_COORDINATES", "Z_COORDINATES"][a];
                let found = file.axes[a].as_ref().map(|(n, array)| (*n, array));
                // The scan has checked that there are this many numbers.
                let (n, mut stream) = part(found, keyword, file.dims[a])?;
                axis.resize(n as usize, 0.0);
                stream.fill(axis)?;
            }
            Ok(Some(GridCoordinates::Axes(axes.map(|axis| along_axis(axis, center)))))
        }
        Dataset::StructuredGrid => {
            let found = file.points.as_ref().map(|array| (file.point_count, array));
            sample_bytes(path, file.dims, ScalarType::F64)?;
            let (_, stream) = part(found, "POINTS", file.dims.iter().product())?;
            Ok(Some(GridCoordinates::Points(match center {
                Center::Point => Box::new(stream),
                Center::Cell => Box::new(Middles::new(Box::new(stream), file.dims)),
            })))
        }
        _ => Ok(None),
    }
}

/// The time that a file has in its field data, as `TIME` or `TimeValue`.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file.
fn time(source: &Arc<ByteSource>, file: &Scanned) -> Result<Option<f64>> {
    let Some(LegacyArray { kind: Type::Number(scalar), data, .. }) = &file.time else { return Ok(None) };
    let mut time = [0.0];
    numbers(source, file, data, *scalar).fill(&mut time)?;
    Ok(Some(time[0]))
}

/// Whether the head of a legacy VTK file says that it is an unstructured grid.
pub(in crate::formats) fn is_mesh(head: &[u8]) -> bool {
    let mut lines = head.split(|&b| b == b'\n').skip(2).map(<[u8]>::trim_ascii).filter(|l| !l.is_empty());
    let dataset = lines.nth(1).unwrap_or_default().to_ascii_uppercase();
    let mut words = dataset.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
    head.starts_with(b"# vtk DataFile")
        && words.next() == Some(b"DATASET")
        && words.next() == Some(b"UNSTRUCTURED_GRID")
}

fn arrays_of(file: &Scanned, center: Center) -> &[LegacyArray] {
    match center {
        Center::Point => &file.arrays,
        Center::Cell => &file.cell_arrays,
    }
}

/// The field to read, and all that can be listed.
fn choose(path: &Path, file: &Scanned, wanted: Option<&str>) -> Result<Picked> {
    let refuse = |got: String, help: &str| {
        let expected = match wanted {
            Some(name) => format!("an array '{name}' of numbers"),
            None => "an array of numbers".into(),
        };
        Err(Error::bad_input(path, "POINT_DATA", expected, got).with_help(help))
    };
    let fields =
        |center| arrays_of(file, center).iter().filter(|a| a.name != GHOSTS).filter_map(LegacyArray::field);
    let of = |center| fields(center).collect::<Vec<_>>();
    let (points, cells) = (of(Center::Point), of(Center::Cell));
    let missing = |name: &str| !points.iter().chain(&cells).any(|f| f.name == name);
    if let Some(name) = wanted.filter(|name| missing(name))
        && file.arrays.iter().chain(&file.cell_arrays).any(|a| a.name == name)
    {
        return refuse("one of bits or strings".into(), "write it as unsigned_char");
    }
    let active = |center| {
        let active = |a: &&LegacyArray| a.is_scalars && a.field().is_some_and(|f| f.components == 1);
        let mut active = arrays_of(file, center).iter().filter(active);
        active.next().filter(|_| active.next().is_none()).map(|a| &a.name[..])
    };
    pick(path, points, cells, wanted, active)
}

#[cfg(test)]
mod tests;
