//! Samples of fields on a grid, written in any order.
//!
//! | format | file | fields | compressed |
//! |---|---|---|---|
//! | **VTI** | VTK ImageData, appended raw, with origin, spacing and direction | any number | zlib, in blocks |
//! | **VTR**, **VTS** | the same of a grid with coordinates of its own | any number | zlib, in blocks |
//! | **NRRD** | space directions and units | one | gzip |
//! | **NIfTI** | version 1, or 2 where that does not hold the grid | one | `.nii.gz` |
//! | **MetaImage** | `.mha`, or `.mhd` with a `.raw` beside it | one | zlib |
//! | **TIFF** | a page for each slice, with ImageJ's spacing and unit; BigTIFF beyond 4 GiB | one | |
//! | **NPY** | version 1, shape (z, y, x), or (n) for a list | one | |
//!
//! All have a header whose length is known beforehand, then the samples one after another, x
//! fastest. So each run of samples has a known place in the file and is written as soon as it is
//! ready; the memory used is that of a header. What is compressed waits in a nameless file until
//! all is there, and is then compressed in blocks, on several threads with the same bytes. The
//! bytes go to a temporary file next to the target, which is synced and then renamed.

mod file;
mod heads;
mod nifti;
mod pack;
#[cfg(test)]
mod tests;
mod tiff;
mod vtk;

pub use file::SampleFile;
pub(in crate::formats) use file::publishable;
pub use file::{limits, push_samples};
pub(in crate::formats) use heads::numbers;
pub(crate) use heads::numpy_type;

use crate::error::{Error, Result};
use crate::formats::shared::has_suffix;
use crate::grid::Geometry;
use crate::volume::ScalarType;
use crate::volume::units::{Unit, Units};
use std::path::{Path, PathBuf};

/// What lies around the arrays of a file.
#[derive(Debug, Default)]
struct FileLayout {
    /// Before all of them.
    head: Vec<u8>,
    /// Directly before each of them; none where nothing does.
    before: Vec<Vec<u8>>,
    /// Behind all of them.
    tail: Vec<u8>,
    /// A header in a file of its own.
    header: Option<Vec<u8>>,
}

/// A format that samples are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleFormat {
    /// VTK XML ImageData.
    Vti,
    /// VTK XML RectilinearGrid.
    Vtr,
    /// VTK XML StructuredGrid.
    Vts,
    /// NRRD, attached.
    Nrrd,
    /// NIfTI, one file.
    Nifti,
    /// The same, compressed.
    NiftiGz,
    /// MetaImage, one file.
    Mha,
    /// MetaImage, the samples in a file beside the header.
    Mhd,
    /// NumPy.
    Npy,
    /// TIFF, a page for each slice.
    Tiff,
}

/// How names end, and what they ask for.
const ENDINGS: [(&str, SampleFormat); 11] = [
    (".vti", SampleFormat::Vti),
    (".vtr", SampleFormat::Vtr),
    (".vts", SampleFormat::Vts),
    (".nrrd", SampleFormat::Nrrd),
    (".nii", SampleFormat::Nifti),
    (".nii.gz", SampleFormat::NiftiGz),
    (".mha", SampleFormat::Mha),
    (".mhd", SampleFormat::Mhd),
    (".npy", SampleFormat::Npy),
    (".tif", SampleFormat::Tiff),
    (".tiff", SampleFormat::Tiff),
];

impl SampleFormat {
    /// The format that a file name asks for, by its extension in any case.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is no extension or it is none of ours.
    pub fn from_path(path: &Path) -> Result<Self> {
        let found = ENDINGS.iter().find(|(ending, _)| has_suffix(path, &[*ending]));
        found.map(|(_, format)| *format).ok_or_else(|| {
            Error::usage(format!(
                "cannot tell the format of samples on a grid from {}: end its name in .vti, .vtr, .vts, .nrrd, \
                 .nii, .nii.gz, .mha, .mhd, .tif or .npy",
                path.display()
            ))
        })
    }

    /// How names of its files end.
    pub fn ending(self) -> &'static str {
        ENDINGS.iter().find(|(_, format)| *format == self).map_or("", |(ending, _)| ending)
    }

    /// Whether a file may have several fields.
    pub fn has_fields(self) -> bool {
        matches!(self, Self::Vti | Self::Vtr | Self::Vts)
    }

    /// The files that are written under a name: itself, and the samples of a detached header.
    pub fn files(self, path: &Path) -> Vec<PathBuf> {
        let samples = (self == Self::Mhd).then(|| path.with_extension("raw"));
        std::iter::once(path.to_path_buf()).chain(samples).collect()
    }

    /// What of a grid has no place in a file of this format, or is converted, a line each.
    pub fn notices(self, meta: &GridMeta) -> Vec<String> {
        let Units { value, length, .. } = &meta.units;
        let name = self.ending();
        let mut lines = vec![];
        let has_lengths = match self {
            Self::Nrrd => true,
            Self::Tiff => {
                length.as_ref().is_some_and(|unit| unit.as_str() == "µm" || unit.as_str().is_ascii())
            }
            Self::Nifti | Self::NiftiGz => nifti::unit_of(length.as_ref()).0 > 0,
            Self::Mha | Self::Mhd => heads::has_unit(length.as_ref()),
            Self::Vti | Self::Vtr | Self::Vts | Self::Npy => false,
        };
        if let Some(unit) = length.as_ref().filter(|_| !has_lengths) {
            lines.push(format!("{name} has no place for the unit of lengths, {unit}"));
        }
        if let Some(unit) = value.as_ref().filter(|_| self != Self::Nrrd) {
            lines.push(format!("{name} has no place for the unit of values, {unit}"));
        }
        if let (Self::Npy, GridPlace::Even(geometry)) = (self, &meta.place)
            && *geometry != Geometry::default()
        {
            let [x, y, z] = geometry.origin;
            let [a, b, c] = geometry.spacing;
            lines.push(format!("{name} has no place for the origin {x},{y},{z} and the spacing {a},{b},{c}"));
        }
        if let (Self::Tiff, GridPlace::Even(geometry)) = (self, &meta.place)
            && (geometry.origin != [0.0; 3] || geometry.direction != Geometry::default().direction)
        {
            lines.push(format!("{name} has no place for the origin and the directions of the axes"));
        }
        if let (true, Some(unit)) = (nifti::converts(self, length.as_ref()), length) {
            lines.push(format!("lengths in {unit} are written in one of NIfTI's units, m, mm or µm"));
        }
        if let (Some(theirs), true) = (self.anatomy(), meta.anatomy != Anatomy::Unknown)
            && theirs != meta.anatomy
        {
            let [from, to] = [meta.anatomy.name(), theirs.name()];
            lines.push(format!(
                "the world of the source is {from}, that of {name} is {to}: x and y change sign"
            ));
        }
        lines
    }

    /// Which way the axes of its world point in a patient.
    fn anatomy(self) -> Option<Anatomy> {
        match self {
            Self::Nifti | Self::NiftiGz => Some(Anatomy::Ras),
            Self::Mha | Self::Mhd => Some(Anatomy::Lps),
            _ => None,
        }
    }

    /// Refuses a grid that the format has no place for.
    fn expect(self, path: &Path, meta: &GridMeta, compress: bool) -> Result<()> {
        let refuse = |why: String| Err(Error::usage(format!("cannot write {}: {why}", path.display())));
        let ending = self.ending();
        match (&meta.place, self) {
            (GridPlace::Even(_), Self::Vtr | Self::Vts) => {
                return refuse(format!("{ending} is for grids with coordinates of their own; write .vti"));
            }
            (GridPlace::Axes(_), Self::Vtr) | (GridPlace::Points, Self::Vts) | (GridPlace::Even(_), _) => {}
            (GridPlace::Axes(_), _) => {
                return refuse(format!(
                    "a rectilinear grid has no spacing, as {ending} needs it; write .vtr"
                ));
            }
            (GridPlace::Points, _) => {
                return refuse(format!(
                    "a curvilinear grid has no spacing, as {ending} needs it; write .vts"
                ));
            }
        }
        if meta.fields.len() > 1 && !self.has_fields() {
            let names: Vec<&str> = meta.fields.iter().map(|field| &*field.name).collect();
            return refuse(format!(
                "{ending} has one field: choose one of {} with `field`",
                names.join(", ")
            ));
        }
        if compress && self == Self::Npy {
            return refuse("NPY is not compressed: leave out `compress`".into());
        }
        if compress && self == Self::Tiff {
            return refuse("TIFF is written without compression: leave out `compress`".into());
        }
        if compress && self == Self::Nifti {
            return refuse("compressed NIfTI is called .nii.gz".into());
        }
        Ok(())
    }
}

/// Which way the axes of a world point in a patient, where that is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Anatomy {
    /// Not known, or no patient.
    #[default]
    Unknown,
    /// To the right, to the front, up: NIfTI and MINC.
    Ras,
    /// To the left, to the back, up: DICOM and ITK.
    Lps,
}

impl Anatomy {
    /// That of the world of a source, by its format, as a person calls it.
    pub fn of_format(format: &str) -> Self {
        let is = |names: &[&str]| names.iter().any(|name| format.starts_with(name));
        match () {
            () if is(&["NIfTI", "MINC"]) => Self::Ras,
            () if is(&["DICOM", "MetaImage"]) => Self::Lps,
            () => Self::Unknown,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Ras => "right-anterior-superior",
            Self::Lps => "left-posterior-superior",
        }
    }
}

/// Where the samples of a grid lie.
#[derive(Clone, Debug, PartialEq)]
pub enum GridPlace {
    /// Evenly.
    Even(Geometry),
    /// At these coordinates along x, y and z.
    Axes([Vec<f64>; 3]),
    /// Anywhere: [`SampleFile::write_points`] tells.
    Points,
}

/// A field of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleField {
    /// Its name.
    pub name: String,
    /// The type of the samples that are written.
    pub scalar: ScalarType,
    /// The offset that is added to all values.
    pub offset: f64,
    /// Whether samples are labels, names rather than values. Of the formats, NIfTI says so.
    pub is_labels: bool,
}

impl SampleField {
    /// Floating-point samples; of 64 bits where they are counted from an offset.
    pub fn floats(name: &str, offset: f64) -> Self {
        let scalar = if offset == 0.0 { ScalarType::F32 } else { ScalarType::F64 };
        Self { name: name.to_owned(), scalar, offset, is_labels: false }
    }
}

/// The grid of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct GridMeta {
    /// Samples along each axis.
    pub dims: [u64; 3],
    /// Where they lie.
    pub place: GridPlace,
    /// The fields, at least one.
    pub fields: Vec<SampleField>,
    /// The units of values and lengths.
    pub units: Units,
    /// What the world is of.
    pub anatomy: Anatomy,
}

impl GridMeta {
    /// A grid of evenly spaced samples of one field, without units.
    pub fn even(dims: [u64; 3], geometry: Geometry, field: SampleField) -> Self {
        let (units, anatomy) = (Units::default(), Anatomy::default());
        Self { dims, place: GridPlace::Even(geometry), fields: vec![field], units, anatomy }
    }

    /// Number of samples.
    ///
    /// # Errors
    /// [`Error::Usage`] when their bytes do not fit a file.
    pub fn samples(&self) -> Result<u64> {
        let [x, y, z] = self.dims;
        let samples = x.checked_mul(y).and_then(|n| n.checked_mul(z)).filter(|&n| n < 1 << 56);
        samples.ok_or_else(|| Error::usage(format!("a grid of {x} x {y} x {z} samples does not fit a file")))
    }

    /// Bytes of the arrays of a file: the fields, then coordinates.
    fn array_bytes(&self) -> Result<Vec<u64>> {
        let samples = self.samples()?;
        let fields = self.fields.iter().map(|field| field.scalar.bytes() as u64 * samples);
        let coordinates = match &self.place {
            GridPlace::Even(_) => vec![],
            GridPlace::Axes(axes) => axes.iter().map(|axis| 8 * axis.len() as u64).collect(),
            GridPlace::Points => vec![24 * samples],
        };
        Ok(fields.chain(coordinates).collect())
    }

    /// The map to the world of a format, whose axes may point elsewhere.
    fn geometry_in(&self, theirs: Anatomy) -> Geometry {
        let GridPlace::Even(mut geometry) = self.place.clone() else { return Geometry::default() };
        if self.anatomy != Anatomy::Unknown && self.anatomy != theirs {
            let turned = |v: &mut [f64; 3]| (v[0], v[1]) = (0.0 - v[0], 0.0 - v[1]);
            turned(&mut geometry.origin);
            geometry.direction.iter_mut().for_each(turned);
        }
        geometry
    }

    fn field(&self) -> &SampleField {
        &self.fields[0]
    }

    fn length_unit(&self) -> Option<&Unit> {
        self.units.length.as_ref()
    }
}
