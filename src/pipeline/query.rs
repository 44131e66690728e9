//! [`SurfaceQuery`]: which surfaces are wanted, said one method at a time, and where they go.

use crate::files::surface::{Compression, SurfaceFormat};
use crate::pipeline::read::{LevelChoice, Roi};
use crate::pipeline::step::Step;
use crate::pipeline::steps::Steps;
use crate::pipeline::surface::{
    ColourBy, CountReport, NumbersReport, Refine, SeriesReport, SurfaceReport, SurfaceSettings, SurfaceSink,
    count, expect_whole, level_of, numbers, series_files, stream_file, stream_surfaces, surfaces_in_memory,
    surfaces_of_steps, write_series, write_surfaces,
};
use crate::surface::TriMesh;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Resources, Silent};
use std::io::Write;
use std::path::{Path, PathBuf};

/// A question for isosurfaces: which, and how. [`Step::query`] and [`Steps::query`] begin one.
///
/// Nothing is read before one of its ends is called. Of a step:
///
/// * [`mesh`](Self::mesh) and [`meshes`](Self::meshes) return surfaces in memory;
/// * [`write`](Self::write) makes files, and [`write_to`](Self::write_to) the bytes of one, in
///   bounded memory;
/// * [`stream`](Self::stream) hands on each part as soon as it is there, in bounded memory;
/// * [`count`](Self::count) says how many cells a surface crosses;
/// * [`numbers`](Self::numbers) measures it, and the parts of the domain on both sides.
///
/// All isovalues are extracted in one pass, in which each block is decoded once; each surface is
/// the one that would come out alone. Chunks are extracted in parallel and welded in their order:
/// the bytes do not depend on the number of threads, nor on memory.
///
/// ```
/// use isospan::pipeline::{Roi, RoiSpace};
/// use isospan::{Archive, Resources};
/// # fn main() -> isospan::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("protein.isospan");
/// # isospan::Reduction::of("datasets/ironprot.vtk").write(&path)?;
/// let archive = Archive::open(&path)?;
/// let corner = Roi { space: RoiSpace::Index, lo: [0.0; 3], hi: [40.0; 3] };
/// let mesh = archive.query(100.0).region(corner).mesh()?;
/// # assert!(!mesh.triangles.is_empty());
///
/// // Several isovalues, each in a file of its own, in little memory.
/// let little = Resources::default().with_memory(256 << 20);
/// let query = archive.query([80.0, 128.0]).cap(true).resources(little);
/// let report = query.write(folder.path().join("protein_{}.ply"))?;
/// assert_eq!(report.surfaces[1].file, folder.path().join("protein_128.ply"));
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
#[must_use = "nothing is asked before an end, such as mesh, write or stream"]
pub struct SurfaceQuery<'a, Of = Step> {
    of: Of,
    settings: SurfaceSettings,
    format: Option<SurfaceFormat>,
    progress: &'a dyn Progress,
}

/// One isovalue or several: a number, or an array, a slice or a vector of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Isovalues(Vec<f64>);

impl Isovalues {
    #[cfg(feature = "compare")]
    pub(super) fn into_vec(self) -> Vec<f64> {
        self.0
    }
}

macro_rules! number_is_an_isovalue {
    ($($number:ty)*) => {$(
        impl From<$number> for Isovalues {
            fn from(isovalue: $number) -> Self {
                Self(vec![isovalue.into()])
            }
        }
    )*};
}

number_is_an_isovalue!(f64 f32 i32 u32 i16 u16 i8 u8);

impl<T: Into<f64>> From<Vec<T>> for Isovalues {
    fn from(isovalues: Vec<T>) -> Self {
        Self(isovalues.into_iter().map(Into::into).collect())
    }
}

impl<T: Into<f64>, const N: usize> From<[T; N]> for Isovalues {
    fn from(isovalues: [T; N]) -> Self {
        Self(isovalues.map(Into::into).into())
    }
}

impl<T: Copy + Into<f64>> From<&[T]> for Isovalues {
    fn from(isovalues: &[T]) -> Self {
        isovalues.to_vec().into()
    }
}

impl<T: Copy + Into<f64>> From<&Vec<T>> for Isovalues {
    fn from(isovalues: &Vec<T>) -> Self {
        isovalues.clone().into()
    }
}

impl Step {
    /// A question for isosurfaces, of an isovalue or of several: a value `>=` it is inside.
    pub fn query(&self, isovalues: impl Into<Isovalues>) -> SurfaceQuery<'static> {
        SurfaceQuery::new(self.clone(), isovalues.into())
    }

    /// An isosurface, in memory: [`query(isovalue).mesh()`](SurfaceQuery::mesh).
    ///
    /// # Errors
    /// Those of [`SurfaceQuery::mesh`].
    pub fn surface(&self, isovalue: impl Into<f64>) -> Result<TriMesh> {
        let isovalue: f64 = isovalue.into();
        self.query(isovalue).mesh()
    }

    /// How many cells an isosurface crosses, exactly:
    /// [`query(isovalue).count()`](SurfaceQuery::count).
    ///
    /// # Errors
    /// Those of [`SurfaceQuery::count`].
    pub fn count(&self, isovalue: impl Into<f64>) -> Result<CountReport> {
        let isovalue: f64 = isovalue.into();
        self.query(isovalue).count()
    }
}

impl Steps {
    /// A question for isosurfaces of each of the steps, of an isovalue or of several: a value `>=`
    /// it is inside.
    pub fn query(&self, isovalues: impl Into<Isovalues>) -> SurfaceQuery<'static, Self> {
        SurfaceQuery::new(self.clone(), isovalues.into())
    }
}

impl<Of> SurfaceQuery<'static, Of> {
    fn new(of: Of, isovalues: Isovalues) -> Self {
        let settings = SurfaceSettings { isovalues: isovalues.0, ..SurfaceSettings::default() };
        Self { of, settings, format: None, progress: &Silent }
    }
}

impl<Of> SurfaceQuery<'_, Of> {
    /// Cuts the surfaces at a box; the whole domain if none. Only chunks that touch it are read.
    pub fn region(mut self, region: impl Into<Option<Roi>>) -> Self {
        self.settings.roi = region.into();
        self
    }

    /// Closes the surfaces where the domain ends.
    pub fn cap(mut self, cap: bool) -> Self {
        self.settings.cap = cap;
        self
    }

    /// The level of a pyramid; the finest if none. Other archives have no levels.
    pub fn level(mut self, level: impl Into<Option<LevelChoice>>) -> Self {
        self.settings.level = level.into();
        self
    }

    /// What is done to each surface before it is handed on: choice of components, decimation.
    pub fn refine(mut self, refine: Refine) -> Self {
        self.settings.refine = refine;
        self
    }

    /// A field whose values a surface file has at the vertices, with their colours: see
    /// [`Step::colours`]. Surfaces in memory and streamed parts have none: see [`Step::values_on`].
    pub fn colour_by(mut self, colours: impl Into<Option<ColourBy>>) -> Self {
        self.settings.colour_by = colours.into();
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
    pub fn progress(self, progress: &dyn Progress) -> SurfaceQuery<'_, Of> {
        let Self { of, settings, format, .. } = self;
        SurfaceQuery { of, settings, format, progress }
    }

    /// The isovalues, in their order.
    pub fn isovalues(&self) -> &[f64] {
        &self.settings.isovalues
    }

    fn format_of(&self, out: &Path) -> Result<SurfaceFormat> {
        self.format.map_or_else(|| SurfaceFormat::from_path(out), Ok)
    }

    /// The isovalue of a question that has one answer.
    fn only_isovalue(&self, several: &str) -> Result<f64> {
        match self.settings.isovalues[..] {
            [isovalue] => Ok(isovalue),
            ref all => Err(Error::usage(format!("expected one isovalue, got {}: {several}", all.len()))),
        }
    }
}

impl SurfaceQuery<'_> {
    /// The surface of the only isovalue, in memory.
    ///
    /// # Errors
    /// Those of [`SurfaceQuery::meshes`]; [`Error::Usage`] for several isovalues.
    pub fn mesh(&self) -> Result<TriMesh> {
        self.only_isovalue("meshes has an answer for each")?;
        Ok(self.meshes()?.swap_remove(0))
    }

    /// The surfaces in memory, in the order of the isovalues. For what may not fit in memory there
    /// is [`SurfaceQuery::write`].
    ///
    /// ```
    /// # use isospan::Archive;
    /// # use isospan::pipeline::Refine;
    /// # use isospan::surface::edit::components::ComponentFilter;
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// # isospan::Reduction::of("datasets/ironprot.vtk").write(&path)?;
    /// let archive = Archive::open(&path)?;
    /// let largest = ComponentFilter { largest: Some(1), ..ComponentFilter::default() };
    /// let refine = Refine { components: Some(largest), ..Refine::default() };
    /// let surfaces = archive.query([80.0, 128.0]).cap(true).refine(refine).meshes()?;
    /// assert!(surfaces[0].triangles.len() > surfaces[1].triangles.len());
    ///
    /// // Another isovalue between the two: most blocks are still in memory.
    /// let between = archive.surface(100.0)?;
    /// # assert!(archive.kept_bytes() > 0 && !between.triangles.is_empty());
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`SurfaceQuery::write`], but for files; [`Error::Usage`] for a surface of 2^32 vertices
    /// or more.
    pub fn meshes(&self) -> Result<Vec<TriMesh>> {
        surfaces_in_memory(&self.of.view, &self.settings, self.progress, vec![])
    }

    /// As [`SurfaceQuery::meshes`], in the memory of surfaces that were asked for before; these are
    /// replaced. This is for an isovalue that is dragged: where blocks are kept, new cleared pages
    /// would take the system about a tenth of the time of each answer.
    ///
    /// ```
    /// # use isospan::Archive;
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// # isospan::Reduction::of("datasets/ironprot.vtk").write(&path)?;
    /// let archive = Archive::open(&path)?;
    /// let mut shown = vec![];
    /// for isovalue in [80.0, 81.0, 82.0] {
    ///     archive.query(isovalue).meshes_into(&mut shown)?;
    ///     assert_eq!(shown[0], archive.surface(isovalue)?);
    /// }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`SurfaceQuery::meshes`]; `surfaces` is empty then.
    pub fn meshes_into(&self, surfaces: &mut Vec<TriMesh>) -> Result<()> {
        let reused = std::mem::take(surfaces);
        *surfaces = surfaces_in_memory(&self.of.view, &self.settings, self.progress, reused)?;
        Ok(())
    }

    /// Writes the surfaces to a file, or, where its name holds `{}`, each to a file with its
    /// isovalue in that place. The name's ending says the format, unless
    /// [`format`](SurfaceQuery::format) does.
    ///
    /// In one file surfaces follow each other, named as the format can. Vertices and triangles that
    /// memory does not hold wait in the scratch folder. An isovalue outside the values' range gives
    /// an empty, valid surface.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged archive; [`Error::Budget`] when the memory does not
    /// suffice; [`Error::Usage`] for a question that makes no sense; [`Error::Cancelled`]; those of
    /// writing a file, of which nothing is left then.
    pub fn write(&self, out: impl AsRef<Path>) -> Result<SurfaceReport> {
        let out = out.as_ref();
        write_surfaces(&self.of.view, &self.settings, out, self.format_of(out)?, self.progress)
    }

    /// Writes the bytes of the file that [`SurfaceQuery::write`] makes to `out`: for a program that
    /// sends a file, or has no disk.
    ///
    /// ```
    /// # use isospan::Archive;
    /// # use isospan::formats::surface::SurfaceFormat;
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// # isospan::Reduction::of("datasets/ironprot.vtk").write(&path)?;
    /// let mut answer = vec![];
    /// let report = Archive::open(&path)?.query(100.0).write_to(&mut answer, SurfaceFormat::Glb)?;
    /// assert_eq!(answer.len() as u64, report.file_bytes);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`SurfaceQuery::write`], but for those of a file; [`Error::Io`] where `out` fails. An
    /// [`Error`] that `out` gives as the cause comes back as it is.
    pub fn write_to(&self, out: &mut dyn Write, format: SurfaceFormat) -> Result<SurfaceReport> {
        let mut hand_on = |bytes: &[u8]| out.write_all(bytes).map_err(cause_of);
        stream_file(&self.of.view, &self.settings, format, self.progress, &mut hand_on)
    }

    /// Streams the surfaces with world positions: the sink gets each chunk's part as soon as it is
    /// welded, in the order of the chunks; then each surface as a whole.
    ///
    /// The parts of an isovalue, put together, are its surface. A surface that is cut at a region,
    /// or of a field with holes, is one part, and so is one that is refined. Before the former come
    /// the parts of a preview, [`StreamedPart::is_preview`]: of the surface as it was extracted.
    ///
    /// ```
    /// # use isospan::Archive;
    /// # use isospan::pipeline::StreamedPart;
    /// # use isospan::surface::TriMesh;
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// # let protein = isospan::Reduction::of("datasets/ironprot.vtk").count(20_000);
    /// # protein.points(isospan::points::SetKind::Hammersley).write(&path)?;
    /// let archive = Archive::open(&path)?;
    /// let mut shown = TriMesh::default();
    /// archive.query(100.0).stream(&mut |part: &StreamedPart<'_>| {
    ///     let added = TriMesh::from_source(part.added)?;
    ///     shown.vertices.extend(added.vertices);
    ///     shown.triangles.extend(added.triangles);
    ///     for &(number, vertex) in part.changed {
    ///         shown.vertices[number as usize] = vertex;
    ///     }
    ///     Ok(())
    /// })?;
    /// assert_eq!(shown, archive.surface(100.0)?);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`SurfaceQuery::write`], but for those of a file, and those of the sink.
    ///
    /// [`StreamedPart::is_preview`]: crate::pipeline::StreamedPart::is_preview
    pub fn stream(&self, sink: &mut dyn SurfaceSink) -> Result<SurfaceReport> {
        stream_surfaces(&self.of.view, &self.settings, self.progress, sink)
    }

    /// How many cells the surface of the only isovalue crosses, exactly: tetrahedra, or cubes of
    /// the level of a pyramid.
    ///
    /// # Errors
    /// [`Error::Usage`] for an isovalue that is not finite, for several, for a region, and for a
    /// level that cannot be had; [`Error::BadInput`] for a damaged archive; [`Error::Cancelled`].
    pub fn count(&self) -> Result<CountReport> {
        let isovalue = self.only_isovalue("count each by itself")?;
        if self.settings.roi.is_some() {
            return Err(Error::usage("cells are counted in the whole domain: leave the region out"));
        }
        count(&self.of.view, isovalue, &self.settings)
    }

    /// What the only isovalue makes of the field: area and pieces of its surface, volumes on both
    /// sides, whether these reach across the domain, and the largest balls in them.
    ///
    /// Volumes are those that marching cubes bounds, so both sides together fill the domain. All of
    /// it is looked at, but for what the index says to lie on one side. The report depends on
    /// neither threads nor memory; what memory does not hold waits in the scratch folder.
    ///
    /// ```
    /// # use isospan::Archive;
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// # isospan::Reduction::of("datasets/ironprot.vtk").write(&path)?;
    /// let found = Archive::open(&path)?.query(100.0).numbers()?;
    /// assert!(found.area > 0.0 && found.above.volume < found.volume);
    /// assert_eq!(found.below.percolates, Some([true; 3]));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Those of [`SurfaceQuery::meshes`]; [`Error::Usage`] for several isovalues and for a region.
    pub fn numbers(&self) -> Result<NumbersReport> {
        let isovalue = self.only_isovalue("measure each by itself")?;
        expect_whole(&self.settings)?;
        let whole = SurfaceSettings { cap: false, refine: Refine::default(), ..self.settings.clone() };
        numbers(&self.of.view, isovalue, &whole, self.progress)
    }

    /// The number of the level of a pyramid that answers; 0 where none is chosen.
    ///
    /// # Errors
    /// [`Error::Usage`] for an archive without levels, for a level that is not there, and where no
    /// level has so few triangles or so small an error.
    pub fn chosen_level(&self) -> Result<u32> {
        level_of(&self.of.view, &self.settings).map(|level| level as u32)
    }

    /// The files that [`SurfaceQuery::write`] makes.
    pub fn files(&self, out: impl AsRef<Path>) -> Vec<PathBuf> {
        self.settings.files(out.as_ref())
    }
}

impl SurfaceQuery<'_, Steps> {
    /// Writes the surfaces of each step, as [`SurfaceQuery::write`] does of one; the file's name
    /// holds `%d` or `%04d` in place of the step's number. It also writes a list of the files with
    /// their times.
    ///
    /// # Errors
    /// Those of [`SurfaceQuery::write`]; [`Error::Usage`] for a name without that place.
    pub fn write(&self, out: impl AsRef<Path>) -> Result<SeriesReport> {
        let (out, Steps { open, positions }) = (out.as_ref(), &self.of);
        let format = self.format_of(out)?;
        write_series(open, positions.clone(), &self.settings, out, format, self.progress)
    }

    /// Hands on the surfaces of step after step in memory. `each` gets the number and the time of a
    /// step, and its surfaces. Several steps are extracted at a time, as memory allows: what they
    /// share is decoded once. The memory of surfaces that `each` does not take is reused for later
    /// ones.
    ///
    /// ```
    /// # use isospan::{Archive, StepSource};
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// # let steps = vec![StepSource::from("datasets/ironprot.vtk"); 2];
    /// # isospan::Reduction::of_steps(steps).write(&path)?;
    /// let archive = Archive::open(&path)?;
    /// let mut triangles = vec![];
    /// archive.steps(..)?.query(100.0).for_each(|_step, time, surfaces| {
    ///     triangles.push((time, surfaces[0].triangles.len()));
    ///     Ok(())
    /// })?;
    /// assert_eq!(triangles.len(), archive.info()?.steps.len());
    /// # assert!(triangles.iter().all(|t| t.1 > 0));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Those of [`SurfaceQuery::meshes`], and those of `each`.
    pub fn for_each(&self, mut each: impl FnMut(u64, f64, &mut Vec<TriMesh>) -> Result<()>) -> Result<()> {
        let Steps { open, positions } = &self.of;
        surfaces_of_steps(open, positions.clone(), &self.settings, self.progress, &mut each)
    }

    /// The files that [`SurfaceQuery::write`] makes: those of the steps, then the lists.
    ///
    /// # Errors
    /// [`Error::Usage`] for a name without a place for the step's number, and for one whose ending
    /// is of no format.
    pub fn files(&self, out: impl AsRef<Path>) -> Result<Vec<PathBuf>> {
        let (out, Steps { open, positions }) = (out.as_ref(), &self.of);
        series_files(open, positions.clone(), &self.settings, out, self.format_of(out)?)
    }
}

/// The error that a writer wraps, or its own.
fn cause_of(error: std::io::Error) -> Error {
    error.downcast::<Error>().unwrap_or_else(|error| Error::io("write", "a surface", error))
}
