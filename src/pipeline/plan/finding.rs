//! What a user should know before or after a run: the findings, and their messages.

use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};

/// Something a user should know.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Notice {
    /// The file that it is about.
    pub path: PathBuf,
    /// What was found.
    #[serde(flatten)]
    pub finding: Finding,
    /// The same in words, with the setting that helps, on one line: see
    /// [`worded`](isospan_io::setting::worded).
    pub text: String,
}

/// What was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Finding {
    /// Many samples have exactly one value, far from all others: it may mean "no data".
    Fill {
        /// The value.
        value: f64,
        /// The part of the samples that have it, from 0 to 1.
        share: f64,
        /// Least and largest of the other values.
        others: [f64; 2],
    },
    /// All samples (fill values apart) are equal: no isovalue has a surface.
    Constant {
        /// The value.
        value: f64,
    },
    /// A few samples make the range a hundred times wider, or more.
    Stretched {
        /// How many of the samples read do so.
        count: u64,
        /// The one that is farthest from the others.
        value: f64,
        /// Least and largest of the other values.
        others: [f64; 2],
    },
    /// The samples are names of parts, as of a segmentation: values between them mean nothing.
    Labels {
        /// Different values among the samples read.
        values: u64,
        /// Least and largest.
        range: [f64; 2],
    },
    /// Files of a folder that are no part of the volume, such as the reports beside a DICOM series.
    PassedOver {
        /// Their names, the first ones of many.
        files: Vec<String>,
        /// How many there are.
        count: u64,
    },
    /// Nothing says how far samples lie apart along some axes: a spacing of 1 is assumed.
    AssumedSpacing {
        /// Along x, y, z.
        axes: [bool; 3],
    },
    /// More points are asked for than there are samples.
    MorePoints {
        /// Points asked for.
        points: u64,
        /// Samples of a volume; vertices of a mesh.
        samples: u64,
    },
    /// The own vertices of a mesh would be the better archive.
    OwnIsBetter {
        /// Points asked for.
        points: u64,
        /// Vertices of the mesh.
        vertices: u64,
        /// Bytes of an archive of its own vertices, about.
        own: u64,
    },
    /// The archive takes more bytes than its source.
    LargerThanSource {
        /// Bytes of the archive.
        archive: u64,
        /// Bytes of the source: its files, or its samples, whichever is less.
        source: u64,
        /// Whether the archive's bytes are an estimate, before it is made.
        estimated: bool,
    },
    /// What a reader converted, took or left out, as the text says.
    Reading,
}

impl fmt::Display for Notice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Notice {
    pub(in crate::pipeline) fn new(path: &Path, finding: Finding, text: &str) -> Self {
        let text = format!("{}: {text}", path.display());
        Self { path: path.to_path_buf(), finding, text }
    }
}
