//! [`Step`]: an archive at a step, and all questions that can be asked of it.

use crate::index::Entry;
use crate::pipeline::field::{
    ExportReport, ExportSettings, GridReport, GridSettings, Moments, ProbeReport, ProbeSettings,
    edges_at_missing, export, export_grid, export_zarr, probe_grid, probe_table, sample_grid, values_at,
};
use crate::pipeline::read::{
    ArchiveSummary, IndexToWorld, LevelChoice, SpectrumReport, StepView, bounds, samples_of_level, spectrum,
    summarize,
};
use crate::pipeline::surface::{ColourBy, Plateau, plateau_at, values_on};
use crate::render::ColourMap;
use crate::surface::SurfaceSource;
use isospan_io::error::Result;
use isospan_io::exec::{CancelToken, Progress, Resources, Silent};
use isospan_io::formats::samples::SampleFormat;
use isospan_io::grid::{ChunkId, Geometry};
use isospan_io::volume::units::Units;
use std::path::Path;
use std::sync::Arc;

/// An archive at one of its steps, or at a moment between two: see
/// [`Archive::step`](super::Archive::step) and [`Archive::at`](super::Archive::at).
///
/// A step never changes. It is cheap to get, and answers from several threads at one time. Whether
/// a question is asked from this type or from the command line, the answer is the same.
///
/// [`Step::query`] asks for isosurfaces. Of the other questions, what fits in memory is returned
/// ([`Step::sample`], [`Step::probe`], [`Step::active`]); what may not is written to a file, in
/// bounded memory, by a method with settings and progress ([`Step::write_samples`],
/// [`Step::write_probed`], [`Step::write_tetrahedra`]). Positions are world coordinates.
///
/// A step caches the decoded blocks that a surface needed, for the next one. The cache takes up to
/// [`Archive::KEPT_BYTES`](super::Archive::KEPT_BYTES) or what
/// [`Archive::keeping`](super::Archive::keeping) says, and a quarter more for buffers. A cached
/// tetrahedron takes about 28 bytes. Blocks that were not used lately go first. So while an
/// isovalue is dragged to and fro, a surface costs little more than its triangles.
#[derive(Clone)]
pub struct Step {
    pub(super) view: Arc<StepView>,
}

/// Tetrahedra of one chunk of an archive, with the points that they use.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Tetrahedra {
    /// The chunk.
    pub chunk: u64,
    /// World positions of the points; those that several chunks use are in each of them.
    pub points: Vec<[f64; 3]>,
    /// Value of each point; NaN where the source has no data.
    pub values: Vec<f64>,
    /// Corners: numbers into `points`. Positively oriented in the world.
    pub tetrahedra: Vec<[u32; 4]>,
}

impl Step {
    pub(super) fn of(view: StepView) -> Self {
        Self { view: Arc::new(view) }
    }

    /// The archive's folder or address.
    pub fn path(&self) -> &Path {
        self.view.path()
    }

    /// Number of the step; for a time between two steps, that of the first.
    pub fn number(&self) -> u64 {
        self.view.step().number()
    }

    /// Its time, where the input states one; between two steps, that of the moment.
    pub fn time(&self) -> Option<f64> {
        self.view.time()
    }

    /// Bytes that are cached now: of blocks, or of the tiles and nodes of a pyramid.
    pub fn kept_bytes(&self) -> usize {
        self.view.kept_bytes()
    }

    /// What the archive holds; range, areas and suggestions are those of the step.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] between two steps; [`crate::Error::BadInput`] for a damaged archive.
    pub fn info(&self) -> Result<ArchiveSummary> {
        summarize(&self.view)
    }

    /// The file that the step was made from, or what stood for it; for a time between two steps,
    /// that of the first.
    pub fn source(&self) -> &str {
        &self.view.step().plan.source.path
    }

    /// Least and largest value; `None` when no point has one.
    pub fn value_range(&self) -> Option<[f64; 2]> {
        self.view.file_range()
    }

    /// The offset that is subtracted from all values of the file: the archive has the differences,
    /// as `f32`. It is 0 wherever `f32` holds the values well. Only [`Step::active_blocks`] returns
    /// values less the offset.
    pub fn offset(&self) -> f64 {
        self.view.step().plan.source.offset
    }

    /// The units of values, lengths and times, as far as they are known.
    pub fn units(&self) -> &Units {
        &self.view.step().plan.source.units
    }

    /// From numbers of samples of the source to the world.
    pub fn geometry(&self) -> Geometry {
        self.view.step().plan.source.geometry
    }

    /// Samples of the source along x, y, z.
    pub fn dims(&self) -> [u64; 3] {
        self.view.step().plan.source.dims
    }

    /// Samples of the source along x, y, z that a level of a pyramid spans: it ends at its last
    /// node. All of them where no level is chosen.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for an archive without levels, for a level that is not there, and
    /// where no level has so small an error.
    pub fn dims_of_level(&self, level: Option<LevelChoice>) -> Result<[u64; 3]> {
        if level.is_none() {
            return Ok(self.dims());
        }
        let level = self.view.level(level)?;
        Ok(samples_of_level(&self.view.pyramid()?.pyramid, level))
    }

    /// The least box of the world that holds the domain: its lowest and its highest corner. For a
    /// curvilinear grid this reads all coordinates, once for an open archive.
    ///
    /// # Errors
    /// [`crate::Error::BadInput`] for a damaged archive; [`crate::Error::Cancelled`].
    pub fn bounds(&self, cancel: &CancelToken) -> Result<[[f64; 3]; 2]> {
        bounds(&self.view, cancel)
    }

    /// The plateau of the samples on which an isovalue lies, of a pyramid that was not stored
    /// without loss: its surface there is noise. Some bricks are looked at.
    ///
    /// # Errors
    /// [`crate::Error::BadInput`] for a damaged archive.
    pub fn plateau(&self, isovalue: impl Into<f64>) -> Result<Option<Plateau>> {
        plateau_at(&self.view, isovalue.into())
    }

    /// How large isosurfaces are, over the isovalue, and isovalues that are worth a look. Reads
    /// some ten thousand bytes.
    ///
    /// # Errors
    /// [`crate::Error::BadInput`] for a damaged archive.
    pub fn spectrum(&self) -> Result<SpectrumReport> {
        spectrum::report(&self.view)
    }

    /// The blocks that an isosurface may cross according to the index, in order: of a pyramid, the
    /// bricks of the finest level and of the next three. Their ranges are less [`Step::offset`].
    ///
    /// # Errors
    /// As [`Step::count`].
    pub fn active_blocks(&self, isovalue: impl Into<f64>) -> Result<Vec<Entry>> {
        self.view.ranges()?.query_any(&[self.view.step().plan.source.kept(isovalue.into())])
    }

    /// The tetrahedra of the blocks that an isosurface may cross, chunk after chunk, each read when
    /// it is asked for.
    ///
    /// Not all of them are active: a block has some hundred. Memory: the list of blocks, and a
    /// chunk.
    ///
    /// ```
    /// # use isospan::Archive;
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// # let protein = isospan::Reduction::of("datasets/ironprot.vtk").count(20_000);
    /// # protein.points(isospan::points::SetKind::Hammersley).write(&path)?;
    /// let archive = Archive::open(&path)?;
    /// let mut active = 0;
    /// for chunk in archive.active(100.0)? {
    ///     let chunk = chunk?;
    ///     let inside = |t: &[u32; 4]| t.iter().filter(|&&v| chunk.values[v as usize] >= 100.0).count();
    ///     active += chunk.tetrahedra.iter().filter(|t| (1..4).contains(&inside(t))).count() as u64;
    /// }
    /// assert_eq!(active, archive.count(100.0)?.active_cells);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`Step::count`], and for each chunk.
    pub fn active(&self, isovalue: impl Into<f64>) -> Result<impl Iterator<Item = Result<Tetrahedra>>> {
        let mut blocks = self.active_blocks(isovalue)?.into_iter().peekable();
        let place = IndexToWorld::of(&self.view)?;
        Ok(std::iter::from_fn(move || {
            let chunk = blocks.peek()?.chunk;
            let mut numbers = vec![];
            while let Some(entry) = blocks.next_if(|e| e.chunk == chunk) {
                numbers.push(entry.block);
            }
            Some(self.tetrahedra(ChunkId(chunk), &numbers, &place))
        }))
    }

    fn tetrahedra(&self, chunk: ChunkId, blocks: &[u32], place: &IndexToWorld) -> Result<Tetrahedra> {
        self.view.close_before(chunk);
        let decoded = self.view.decode(chunk, blocks)?;
        let lattice = self.view.manifest.plan.lattice;
        let mut out = Tetrahedra { chunk: chunk.0, ..Tetrahedra::default() };
        let mut numbers = vec![u32::MAX; decoded.positions.len()];
        for tet in &decoded.tets {
            for v in tet.map(|v| v as usize) {
                if numbers[v] == u32::MAX {
                    numbers[v] = out.points.len() as u32;
                    out.points.push(place.world(lattice.to_index_space(decoded.positions[v]))?);
                    out.values.push(self.offset() + f64::from(decoded.values[v]));
                }
            }
            let mut corners = tet.map(|v| numbers[v as usize]);
            if place.mirrors() {
                corners.swap(2, 3);
            }
            out.tetrahedra.push(corners);
        }
        Ok(out)
    }

    /// This step as a field that colours surfaces, of this archive or another one in the same
    /// world: see [`SurfaceQuery::colour_by`](super::SurfaceQuery::colour_by).
    pub fn colours(&self, map: ColourMap) -> ColourBy {
        ColourBy { view: Arc::clone(&self.view), range: None, map }
    }

    /// The values of a field, at a step of this archive or of another one in the same world, at the
    /// vertices of an isosurface of this step. NaN where the field has no value.
    ///
    /// Memory: eight bytes a vertex, besides what the resources allow.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] where a field of another archive has no value at any vertex; those
    /// of [`Step::probe_with`].
    pub fn values_on(
        &self,
        field: &Self,
        surface: &dyn SurfaceSource,
        isovalue: f64,
        resources: &Resources,
    ) -> Result<Vec<f64>> {
        values_on(&self.view, &field.view, surface, isovalue, resources)
    }

    /// The name of the field that the step was made from; empty where the file names none.
    pub fn field(&self) -> &str {
        &self.view.step().plan.source.field
    }

    /// The names of all fields that the archive has at this moment: that of the step, and others
    /// on the same points.
    pub fn fields_here(&self) -> Vec<&str> {
        self.view.fields()
    }

    /// The field, linear in each tetrahedron, at points in world coordinates: NaN outside the
    /// domain, and where the source has no data.
    ///
    /// Every point lies in exactly one tetrahedron, by a rule where they touch, so the answer is
    /// always the same. Points are rounded to the lattice, 2^-24 of the domain's longest side. A
    /// point outside by no more than `f32` and the lattice round coordinates has the value of the
    /// nearest place: so vertices of a surface file have values. Few points cost as much as the
    /// chunks that they lie in. On a curvilinear grid a point is found in a cell of the grid first:
    /// that reads the coordinates around it, and all of them once for an open archive.
    ///
    /// # Errors
    /// [`crate::Error::BadInput`] for a damaged archive; [`crate::Error::Usage`] for 2^32 points or
    /// more.
    pub fn probe(&self, points: &[[f64; 3]]) -> Result<Vec<f64>> {
        self.probe_with(points, &ProbeSettings::default())
    }

    /// As [`Step::probe`], with threads and memory as the settings say, until they stop it.
    ///
    /// # Errors
    /// As [`Step::probe`]; [`crate::Error::Cancelled`].
    pub fn probe_with(&self, points: &[[f64; 3]], settings: &ProbeSettings) -> Result<Vec<f64>> {
        let found = values_at(&self.view, points, settings, &|memory| memory, &Silent)?.values;
        Ok(found.into_iter().map(|v| self.offset() + f64::from(v)).collect())
    }

    /// How many of some edges, given by their ends in world coordinates, lie where the archive has
    /// no data: within a fifth of a voxel from their middle, around them, and inside the domain. An
    /// isosurface ends there, at faces of tetrahedra that have a corner without a value.
    ///
    /// # Errors
    /// As [`Step::probe`]; [`crate::Error::Usage`] for a rectilinear or curvilinear grid.
    pub fn edges_at_missing(&self, edges: &[[[f64; 3]; 2]]) -> Result<u64> {
        self.view.refuse_coordinates("a search for missing samples")?;
        let source = &self.view.step().plan.source;
        edges_at_missing(edges, &source.geometry, source.dims, |points| self.probe(points))
    }

    /// Writes a table of points (CSV) with the field's value next to each, or the values alone
    /// (NPY), in bounded memory.
    ///
    /// # Errors
    /// [`crate::Error::BadInput`] for a table without coordinates, or a damaged archive;
    /// [`crate::Error::Usage`] for a file name that ends in neither `.csv` nor `.npy`; those of
    /// writing the file.
    pub fn write_probed(
        &self,
        points: &Path,
        settings: &ProbeSettings,
        out: &Path,
        progress: &dyn Progress,
    ) -> Result<ProbeReport> {
        probe_table(&self.view, points, settings, out, progress)
    }

    /// The field on a grid of samples that spans the domain, x fastest, in memory: NaN where the
    /// source has no data.
    ///
    /// ```
    /// # use isospan::Archive;
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// # isospan::Reduction::of("datasets/ironprot.vtk").write(&path)?;
    /// let archive = Archive::open(&path)?;
    /// let small = archive.sample([17, 17, 17])?;
    /// assert_eq!(small.len(), 17 * 17 * 17);
    /// assert_eq!(small[0], archive.probe(&[archive.geometry().origin])?[0]);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for a grid that cannot be; [`crate::Error::BadInput`] for a damaged
    /// archive.
    pub fn sample(&self, dims: [u64; 3]) -> Result<Vec<f64>> {
        self.sample_with(dims, &ProbeSettings::default())
    }

    /// As [`Step::sample`], with threads and memory as the settings say, until they stop it.
    ///
    /// # Errors
    /// As [`Step::sample`]; [`crate::Error::Cancelled`].
    pub fn sample_with(&self, dims: [u64; 3], settings: &ProbeSettings) -> Result<Vec<f64>> {
        sample_grid(&self.view, dims, settings)
    }

    /// Writes the field on a grid of samples that spans the domain to a file, in bounded memory.
    ///
    /// The first and last sample of an axis lie on the domain's faces, a single one in the middle;
    /// with [`Step::dims`], samples are at the source's voxels. The bytes do not depend on threads,
    /// memory, or on how the archive is cut into chunks.
    ///
    /// # Errors
    /// As [`Step::sample`]; [`crate::Error::Budget`] when the memory does not suffice; those of
    /// writing the file, of which nothing is left then.
    pub fn write_samples(
        &self,
        dims: [u64; 3],
        settings: &ProbeSettings,
        out: &Path,
        format: SampleFormat,
        progress: &dyn Progress,
    ) -> Result<ProbeReport> {
        probe_grid(&self.view, dims, settings, out, format, progress)
    }

    /// Writes tetrahedra to a file (`.vtu`, `.vtkhdf`), each point once, with its value or those of
    /// several fields, in bounded memory.
    ///
    /// They come chunk by chunk, so the bytes do not depend on the number of threads, nor on
    /// memory: what memory does not hold waits in the scratch folder. Tetrahedra with a corner
    /// without value are left out; of several fields, those that are whole in none, and a value
    /// that one field does not have is NaN. With a range or a region, what cannot have an answer is
    /// not read. An answer without tetrahedra is an empty, valid file.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for settings that make no sense; [`crate::Error::BadInput`] for a
    /// damaged archive; [`crate::Error::Budget`] when the memory does not suffice; those of writing
    /// the file, of which nothing is left then.
    pub fn write_tetrahedra(
        &self,
        settings: &ExportSettings,
        out: &Path,
        progress: &dyn Progress,
    ) -> Result<ExportReport> {
        export(&self.view, settings, out, progress)
    }

    /// Whether the archive is a pyramid of samples, which has levels and no tetrahedra.
    pub fn is_pyramid(&self) -> bool {
        self.view.is_pyramid()
    }

    /// Writes the nodes of a level of a pyramid as a file of samples, in bounded memory, with what
    /// the format has places for: origin, spacing, directions, coordinates, units.
    ///
    /// Samples are `f32`, or `f64` where the values are counted from an offset. At level 0 of an
    /// archive that keeps whole numbers without loss they are those of the source, in its type. The
    /// bytes depend on neither threads nor memory.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for an archive of tetrahedra, a level or a region that is not there,
    /// and a format without a place for the grid; [`crate::Error::BadInput`] for a damaged archive;
    /// those of writing the file, of which nothing is left then.
    pub fn write_grid(
        &self,
        settings: &GridSettings,
        out: &Path,
        format: SampleFormat,
        progress: &dyn Progress,
    ) -> Result<GridReport> {
        export_grid(&self.view, settings, out, format, progress)
    }

    /// Writes a level of a pyramid and all coarser ones as an OME-Zarr image, in bounded memory:
    /// OME-NGFF 0.4 in Zarr 2, with scales, translations and units. Several fields are channels.
    /// Axes that count down in the world are turned round. An image that is there is replaced if
    /// `replace` says so.
    ///
    /// # Errors
    /// Those of [`Step::write_grid`]; [`crate::Error::Usage`] for axes that are turned, and a grid
    /// with coordinates of its own.
    pub fn write_ome_zarr(
        &self,
        settings: &GridSettings,
        out: &Path,
        replace: bool,
        progress: &dyn Progress,
    ) -> Result<GridReport> {
        export_zarr(&Moments::One(&self.view), settings, out, replace, progress)
    }
}
