//! How a file is opened.

use super::format::{Format, Registry};
use crate::bytes::IoMode;
use crate::error::{Error, Result};
use crate::volume::units::Units;
use crate::volume::{Assumed, ScalarType};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How to open a volume.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct OpenOptions {
    /// The field to read, where the file has several.
    pub field: Option<String>,
    /// The channel to read, where an array has an axis of them: a label or a number from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channel: Option<String>,
    /// The level to read, where an image has several: its name or its number, 0 for the finest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<String>,
    /// The layout of a headerless file; required for those, refused for others.
    pub raw: Option<RawLayout>,
    /// World lengths of a voxel's edges along x, y and z, for a format without spacing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spacing: Option<[f64; 3]>,
    /// World coordinates of the first sample, for a format without an origin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<[f64; 3]>,
    /// Whether these two count in place of those that a Zarr, HDF5 or NetCDF file tells, too, and
    /// of its coordinates. The directions of its axes stay. Without, and for other formats that
    /// tell a spacing, they are refused.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub replaces_place: bool,
    /// Whether files are mapped or read. Does not change what is read.
    pub io: IoMode,
    /// A text file of one number a point, for meshes whose format keeps values apart: TetGen,
    /// points and tetrahedra as text.
    pub values: Option<PathBuf>,
    /// Whether cell data of a mesh jump between points of one place, as those of two pieces or
    /// materials are. Without, the cells around a place are averaged together.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub jumps: bool,
    /// Units that the user names; each counts in place of the file's.
    #[serde(default, skip_serializing_if = "Units::are_unknown")]
    pub units: Units,
    /// Formats that a program adds to those that are read. They are not written into plans.
    #[serde(skip)]
    pub formats: Registry,
}

impl OpenOptions {
    /// The same, with a format of the program's own, which is looked for before all others:
    ///
    /// ```
    /// use isospan_io::formats::{About, Dataset, Format, Head, OpenOptions, open_volume};
    /// use isospan_io::volume::VolumeSource;
    /// use isospan_io::volume::memory::volume_of;
    /// use isospan_io::{Error, Result};
    /// use std::sync::Arc;
    ///
    /// /// Files of one line, "BALL 16": the squared distance from the middle of 16³ samples.
    /// struct Balls;
    ///
    /// static ABOUT: About =
    ///     About { volumes: &["ball"], suffixes: &[".ball"], magic: &[b"BALL"], ..About::named("a ball") };
    ///
    /// impl Format for Balls {
    ///     fn about(&self) -> &About {
    ///         &ABOUT
    ///     }
    ///
    ///     fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
    ///         let text = String::from_utf8_lossy(&head.bytes).into_owned();
    ///         let number = text.trim_start_matches("BALL").trim().parse();
    ///         let edge = number.map_err(|_| Error::bad_input(head.path, "line 1", "BALL and a number", text))?;
    ///         Ok(Box::new(Ball(edge)))
    ///     }
    /// }
    ///
    /// struct Ball(u64);
    ///
    /// impl Dataset for Ball {
    ///     fn volume(&self, _: &OpenOptions) -> Result<VolumeSource> {
    ///         let n = self.0;
    ///         let square = |i: u64| (i as f32 - (n - 1) as f32 / 2.0).powi(2);
    ///         let value = |i: u64| square(i % n) + square(i / n % n) + square(i / n / n);
    ///         let samples: Vec<f32> = (0..n * n * n).map(value).collect();
    ///         Ok(VolumeSource::Random(Box::new(volume_of("ball", [n; 3], samples)?)))
    ///     }
    /// }
    ///
    /// # fn main() -> Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("a.ball");
    /// std::fs::write(&path, "BALL 16\n").unwrap();
    /// let options = OpenOptions::default().with_format(Arc::new(Balls));
    /// assert_eq!(open_volume(&path, &options)?.info().dims, [16; 3]);
    /// # Ok(())
    /// # }
    /// ```
    #[must_use]
    pub fn with_format(mut self, format: Arc<dyn Format>) -> Self {
        self.formats = self.formats.with(format);
        self
    }

    /// Refuses a channel for a file that has one alone.
    pub(in crate::formats) fn refuse_channel(&self, path: &Path) -> Result<()> {
        match self.channel {
            None => Ok(()),
            Some(_) => {
                let text = "it has no channels to choose from: leave out `channel`";
                Err(Error::usage(format!("{}: {text}", path.display())))
            }
        }
    }

    /// Refuses a level for a file that has one alone.
    pub(in crate::formats) fn refuse_scale(&self, path: &Path) -> Result<()> {
        if self.scale.is_none() {
            return Ok(());
        }
        let text = "it has no levels to choose from: leave out `scale`";
        Err(Error::usage(format!("{}: {text}", path.display())))
    }

    /// What is assumed of a file that does not say how far samples lie apart along some axes.
    pub(in crate::formats) fn assumed(&self, axes: [bool; 3]) -> Assumed {
        let is_given = self.spacing.is_some();
        // Of a file with some coordinates no spacing is taken.
        Assumed { axes: axes.map(|axis| axis && !is_given), can_be_given: axes == [true; 3] }
    }

    /// Whether a spacing or an origin is given.
    fn places(&self) -> bool {
        self.spacing.is_some() || self.origin.is_some()
    }

    /// Whether what a file tells of the places of its samples does not count.
    pub(in crate::formats) fn replaces_coordinates(&self) -> bool {
        self.replaces_place && self.places()
    }

    /// Refuses a spacing and an origin for a file that has its own, unless they replace those.
    pub(in crate::formats) fn refuse_other_geometry(&self, path: &Path, what: &str) -> Result<()> {
        if self.replaces_place { Ok(()) } else { self.refuse_geometry(path, what) }
    }

    /// Refuses a spacing and an origin for a file that has its own, in whose place none can be.
    pub(in crate::formats) fn refuse_geometry(&self, path: &Path, what: &str) -> Result<()> {
        if !self.places() {
            return Ok(());
        }
        let path = path.display();
        let help = "leave out `spacing` and `origin`";
        Err(Error::usage(format!("{path} is {what}, which tells its own spacing and origin: {help}")))
    }
}

/// The layout of a headerless file.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RawLayout {
    /// Samples along x (fastest), y, z.
    pub dims: [u64; 3],
    /// Type of a sample.
    pub scalar: ScalarType,
    /// Whether samples are stored big-endian.
    pub big_endian: bool,
    /// Bytes before the first sample.
    pub offset: u64,
}

/// Whether the file's name ends in one of `suffixes`, in any case.
pub(crate) fn has_suffix(path: &Path, suffixes: &[&str]) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    suffixes.iter().any(|s| name.ends_with(s))
}
