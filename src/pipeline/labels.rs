//! [`LabelQuery`]: the surfaces of which labels are wanted, and where they go.

use crate::files::labels::LabelTable;
use crate::files::surface::{Compression, SurfaceFormat};
use crate::pipeline::step::Step;
use crate::pipeline::surface::{
    LabelMesh, LabelReport, LabelSettings, Labels, OneLabel, label_files, label_meshes, label_sizes,
    write_labels,
};
use isospan_io::error::Result;
use isospan_io::exec::{Progress, Resources, Silent};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A question for the surfaces of labels: [`Step::labels`] begins one.
///
/// The archive is that of a label image that was reduced without loss. Each label has one closed
/// mesh, by surface nets, and neighbours share their walls: the same vertices and triangles, turned
/// over. A mesh is the same whichever other labels are asked for, and for any threads and memory.
///
/// Without smoothing a mesh is the faces of the label's voxels, so its volume is exactly theirs. A
/// voxel reaches half-way to the next one, and so half a spacing beyond the outer samples.
///
/// ```
/// use isospan::pipeline::{Labels, Target};
/// use isospan::{Archive, Reduction, volume_of};
/// # fn main() -> isospan::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("labels.isospan");
/// // Two labels side by side, and a background around them.
/// let label = |x: usize| if x < 2 || x > 9 { 0 } else { 1 + (x / 6) as u8 };
/// let samples: Vec<u8> = (0..12 * 8 * 8).map(|i| label(i % 12)).collect();
/// let image = volume_of("two labels", [12, 8, 8], samples)?;
/// Reduction::of(image).target(Target::Lossless).write(&path)?;
///
/// let archive = Archive::open(&path)?;
/// let meshes = archive.labels([1, 2]).meshes()?;
/// assert_eq!(meshes[0].label.voxels, 4 * 8 * 8);
/// // Without the meshes: which labels there are, and how large.
/// assert_eq!(archive.labels(Labels::All).sizes()?.len(), 2);
/// assert!((meshes[0].label.volume - (4 * 8 * 8) as f64).abs() < 1e-9);
///
/// // All labels but 0 in one file, smoothed, a node each.
/// let report = archive.labels(Labels::All).smooth(10).write(folder.path().join("all.glb"))?;
/// assert_eq!(report.labels.len(), 2);
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
#[must_use = "nothing is asked before an end, such as meshes or write"]
pub struct LabelQuery<'a> {
    of: Step,
    settings: LabelSettings,
    format: Option<SurfaceFormat>,
    progress: &'a dyn Progress,
}

impl Step {
    /// A question for the surfaces of labels, each closed: of some by their numbers, or of all.
    pub fn labels(&self, labels: impl Into<Labels>) -> LabelQuery<'static> {
        let settings = LabelSettings {
            labels: labels.into(),
            smooth: 0,
            table: Arc::default(),
            compress: Compression::None,
            resources: Resources::default(),
        };
        LabelQuery { of: self.clone(), settings, format: None, progress: &Silent }
    }
}

impl LabelQuery<'_> {
    /// Steps of smoothing, at most 64; 0 leaves the faces of voxels, 10 are usual. Vertices stay
    /// in their cells, walls common, and volumes about the same: within 1 % for compact labels of
    /// a thousand voxels and more. Small labels and thin sheets change more, as the sizes of
    /// [`OneLabel`] tell.
    ///
    /// [`OneLabel`]: crate::pipeline::OneLabel
    pub fn smooth(mut self, steps: u32) -> Self {
        self.settings.smooth = steps;
        self
    }

    /// Names and colours; labels without an entry have a colour of a palette.
    pub fn table(mut self, table: LabelTable) -> Self {
        self.settings.table = Arc::new(table);
        self
    }

    /// How a GLB is made small: `true` is [`Compression::Quantized`].
    pub fn compress(mut self, compress: impl Into<Compression>) -> Self {
        self.settings.compress = compress.into();
        self
    }

    /// The format of files, whatever their names end in.
    pub fn format(mut self, format: SurfaceFormat) -> Self {
        self.format = Some(format);
        self
    }

    /// Threads, memory, scratch folder, and what stops it.
    pub fn resources(mut self, resources: Resources) -> Self {
        self.settings.resources = resources;
        self
    }

    /// Shows how far it is.
    pub fn progress(self, progress: &dyn Progress) -> LabelQuery<'_> {
        let Self { of, settings, format, .. } = self;
        LabelQuery { of, settings, format, progress }
    }

    /// The meshes in memory, ascending by label. A label without voxels has an empty one.
    ///
    /// # Errors
    /// As [`LabelQuery::write`], but for files.
    pub fn meshes(&self) -> Result<Vec<LabelMesh>> {
        label_meshes(&self.of.view, &self.settings, self.progress)
    }

    /// The labels with their names, colours, voxels and the sizes of their surfaces, ascending by
    /// label. One surface is in memory at a time.
    ///
    /// # Errors
    /// As [`LabelQuery::write`], but for files.
    pub fn sizes(&self) -> Result<Vec<OneLabel>> {
        label_sizes(&self.of.view, &self.settings, self.progress)
    }

    /// Writes the meshes to a file, or, where its name holds `{}`, each to a file with its label in
    /// that place. In one file they follow each other, ascending by label: nodes with names and
    /// colours in GLB, groups in OBJ, segments with names in a folder for neuroglancer, an array
    /// `label` of the vertices in PLY, VTP and VTKHDF. STL does not keep them apart.
    ///
    /// Memory grows neither with the labels nor with their meshes: what it does not hold waits in
    /// the scratch folder.
    ///
    /// # Errors
    /// [`Error::Usage`](crate::Error::Usage) for an archive that keeps no whole numbers exactly, a
    /// grid with coordinates, a label that is given twice, and more than 64 steps of smoothing;
    /// [`Error::BadInput`](crate::Error::BadInput) for a damaged archive;
    /// [`Error::Budget`](crate::Error::Budget) when the memory does not suffice;
    /// [`Error::Cancelled`](crate::Error::Cancelled); those of writing a file.
    pub fn write(&self, out: impl AsRef<Path>) -> Result<LabelReport> {
        let out = out.as_ref();
        let format = self.format.map_or_else(|| SurfaceFormat::from_path(out), Ok)?;
        write_labels(&self.of.view, &self.settings, out, format, self.progress)
    }

    /// The files that [`LabelQuery::write`] makes. Where each label has one and all are asked for,
    /// they are known only when the image was read: none are named.
    pub fn files(&self, out: impl AsRef<Path>) -> Vec<PathBuf> {
        label_files(&self.settings, out.as_ref())
    }
}
