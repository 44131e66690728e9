//! What is asked of labels, and what is reported about them.

use crate::files::labels::LabelTable;
use crate::files::surface::Compression;
use crate::pipeline::stage::StageSeconds;
use crate::surface::TriMesh;
use crate::surface::nets::MOST_STEPS;
use isospan_io::bytes::publish::folder_of;
use isospan_io::bytes::remote::Traffic;
use isospan_io::error::{Error, Result};
use isospan_io::exec::Resources;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Which labels of a label image: some of them by their numbers, or all.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Labels {
    /// Those that are named.
    Each(Vec<i64>),
    /// All but 0, the background.
    All,
    /// All, and 0 too.
    AllWithBackground,
}

macro_rules! number_is_a_label {
    ($($number:ty)*) => {$(
        impl From<$number> for Labels {
            fn from(label: $number) -> Self {
                Self::Each(vec![label.into()])
            }
        }
    )*};
}

number_is_a_label!(i64 i32 u32 i16 u16 i8 u8);

impl<T: Into<i64>> From<Vec<T>> for Labels {
    fn from(labels: Vec<T>) -> Self {
        Self::Each(labels.into_iter().map(Into::into).collect())
    }
}

impl<T: Into<i64>, const N: usize> From<[T; N]> for Labels {
    fn from(labels: [T; N]) -> Self {
        Self::Each(labels.map(Into::into).into())
    }
}

impl<T: Copy + Into<i64>> From<&[T]> for Labels {
    fn from(labels: &[T]) -> Self {
        labels.to_vec().into()
    }
}

/// How the surfaces of labels are made: see [`LabelQuery`](crate::pipeline::LabelQuery).
#[derive(Clone, Debug)]
pub(in crate::pipeline) struct LabelSettings {
    pub(in crate::pipeline) labels: Labels,
    /// Steps of smoothing.
    pub(in crate::pipeline) smooth: u32,
    pub(in crate::pipeline) table: Arc<LabelTable>,
    /// How a GLB is made small.
    pub(in crate::pipeline) compress: Compression,
    pub(in crate::pipeline) resources: Resources,
}

impl LabelSettings {
    pub(super) fn check(&self) -> Result<()> {
        if self.smooth > MOST_STEPS {
            return Err(Error::usage(format!(
                "labels are smoothed in at most {MOST_STEPS} steps, not in {}",
                self.smooth
            )));
        }
        let Labels::Each(labels) = &self.labels else { return Ok(()) };
        if labels.is_empty() {
            return Err(Error::usage("give at least one label"));
        }
        let mut sorted = labels.clone();
        sorted.sort_unstable();
        match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            Some(pair) => Err(Error::usage(format!("the label {} is given twice", pair[0]))),
            None => Ok(()),
        }
    }

    /// The folder for what does not fit in memory, of a file.
    pub(super) fn scratch_of(&self, out: &Path) -> PathBuf {
        self.resources.scratch.clone().unwrap_or_else(|| folder_of(out).to_path_buf())
    }
}

/// What was found of labels; counts are of all their surfaces together.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct LabelReport {
    /// Each label, ascending.
    pub labels: Vec<OneLabel>,
    /// Steps of smoothing.
    pub smooth: u32,
    /// Vertices written.
    pub vertices: u64,
    /// Triangles written.
    pub triangles: u64,
    /// Triangles of the files whose corners are on a line as `f32`.
    pub without_area: u64,
    /// What coordinates in the files are less, where they are far from 0 and the format has no
    /// doubles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shift: Option<[f64; 3]>,
    /// Bytes of the files written.
    pub file_bytes: u64,
    /// Bricks of the archive, each of which has a range of labels.
    pub bricks: u64,
    /// Bricks whose range says that they may hold a part of a surface.
    pub active_bricks: u64,
    /// Bytes read: index pages, tiles, corrections.
    pub bytes_read: u64,
    /// Bytes of the archive.
    pub archive_bytes: u64,
    /// What was fetched from the server meanwhile, if the archive is on one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remote: Option<Traffic>,
    /// Seconds of wall time of each stage.
    #[serde(serialize_with = "crate::pipeline::stage::by_name")]
    pub seconds: StageSeconds,
}

/// The surface of a label, in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct OneLabel {
    /// The label.
    pub label: i64,
    /// Its name; empty if it has none.
    pub name: String,
    /// Its colour: red, green, blue (sRGB) and opacity.
    pub colour: [u8; 4],
    /// The file that it is in; empty in memory.
    pub file: PathBuf,
    /// Its voxels; none if the image does not have the label.
    pub voxels: u64,
    /// Vertices of its surface.
    pub vertices: u64,
    /// Triangles of its surface.
    pub triangles: u64,
    /// The area of its surface, in world units.
    pub area: f64,
    /// The volume in its surface, in world units.
    pub volume: f64,
}

/// The surface of a label, in memory.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct LabelMesh {
    /// The label, with its name, colour and size.
    pub label: OneLabel,
    /// Its surface, closed.
    pub mesh: TriMesh,
}
