//! The experiments: each a data set reduced in one way, timed by stages and measured against the original.
//!
//! Everything is asked for by a [`Key`] and done once. Reductions and extractions are those of the library on one thread; their
//! seconds are its own reports', the least of three runs where they are short: what else the machine does only adds to
//! them. Extraction is what `isospan surface` does but
//! for writing the file: opening the archive, its index, the active blocks, marching tetrahedra, welding.

use crate::data::{Content, Dataset, GRID, Made};
use crate::distances::{Distances, compare, roughness};
use crate::fields::{TetField, uniform};
use isospan::exec::Silent;
use isospan::formats::OpenOptions;
use isospan::formats::surface::{SurfaceFormat, SurfaceMeta, write_surface};
use isospan::measure::ErrorSums;
use isospan::pipeline::{
    Amount, ReduceReport, ReduceSettings, RunSettings, SurfaceSettings, extract_surface, reduce,
};
use isospan::points::SetKind;
use isospan::sample::Interpolation;
use isospan::surface::TriMesh;
use isospan::{Archive, Error, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Kinds of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Points {
    Hammersley,
    Halton,
    Hyperbolic,
    Regular,
    Lattice,
    Uniform,
}

impl Points {
    pub(crate) const ALL: [Self; 6] =
        [Self::Hammersley, Self::Halton, Self::Hyperbolic, Self::Regular, Self::Lattice, Self::Uniform];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Hammersley => "Hammersley",
            Self::Halton => "Halton",
            Self::Hyperbolic => "Hyperbolic",
            Self::Regular => "Regular",
            Self::Lattice => "Lattice",
            Self::Uniform => "Uniform random",
        }
    }

    /// The library's set; it has none of uniform random points.
    fn kind(self) -> Option<SetKind> {
        match self {
            Self::Hammersley => Some(SetKind::Hammersley),
            Self::Halton => Some(SetKind::Halton),
            Self::Hyperbolic => Some(SetKind::HyperbolicCross),
            Self::Regular => Some(SetKind::Regular),
            Self::Lattice => Some(SetKind::Bcc),
            Self::Uniform => None,
        }
    }
}

/// An experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Key {
    pub(crate) dataset: Dataset,
    pub(crate) points: Points,
    /// Points asked for, without those of the boundary.
    pub(crate) count: u64,
    pub(crate) how: How,
}

/// Interpolations, in an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum How {
    Linear,
    /// Cubic in volumes, quadratic in meshes.
    Higher,
    /// The same as the thesis prints it.
    HigherThesis,
    Nearest,
}

impl How {
    fn interpolation(self, dataset: Dataset) -> Interpolation {
        match (self, is_grid(dataset)) {
            (Self::Linear, _) => Interpolation::Linear,
            (Self::Higher, true) => Interpolation::Cubic,
            (Self::HigherThesis, true) => Interpolation::CubicThesis,
            (Self::Higher, false) => Interpolation::Quadratic,
            (Self::HigherThesis, false) => Interpolation::QuadraticThesis,
            (Self::Nearest, _) => Interpolation::Nearest,
        }
    }
}

/// Whether a data set is structured.
pub(crate) fn is_grid(dataset: Dataset) -> bool {
    matches!(dataset, Dataset::Sphere | Dataset::Seis)
}

/// What came of an experiment.
#[derive(Clone, Debug)]
pub(crate) struct Outcome {
    is_grid: bool,
    /// Points asked for.
    pub(crate) asked: u64,
    /// Points with values, with those of the boundary.
    pub(crate) points: u64,
    pub(crate) tetrahedra: u64,
    pub(crate) mesh_seconds: f64,
    pub(crate) sample_seconds: f64,
    pub(crate) extract_seconds: f64,
    pub(crate) triangles: u64,
    pub(crate) field: FieldError,
    /// From the original's surface.
    pub(crate) distances: Distances,
    /// RMS angle between neighbouring triangles, in degrees.
    pub(crate) roughness: f64,
    /// The surface.
    pub(crate) file: PathBuf,
}

impl Outcome {
    /// One number for the error of the field: the RMS in volumes; in meshes what 95 of 100 samples do not exceed, since
    /// the cell of the dipole would outweigh all others.
    pub(crate) fn field_error(&self) -> f64 {
        if self.is_grid { self.field.rms } else { self.field.most }
    }
}

/// The reduced field less the original, at the original's samples, in units of the spread of their values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FieldError {
    pub(crate) rms: f64,
    /// 95 of 100 samples have no larger error.
    pub(crate) most: f64,
    /// Share of the samples that lie in no tetrahedron.
    pub(crate) outside: f64,
}

/// A data set with what it is measured against.
pub(crate) struct Original {
    pub(crate) made: Made,
    pub(crate) cells: u64,
    pub(crate) surface: TriMesh,
    /// Of that surface: RMS angle between neighbouring triangles, in degrees.
    pub(crate) roughness: f64,
    pub(crate) file: PathBuf,
    /// Length of the diagonal of the bounding box: the unit of distances.
    pub(crate) diagonal: f64,
    /// The 95th percentile of the values less the 5th: the unit of errors. The range is no unit near a dipole.
    spread: f64,
}

/// All data and experiments.
pub(crate) struct Lab {
    folder: PathBuf,
    originals: BTreeMap<Dataset, Original>,
    outcomes: BTreeMap<Key, Outcome>,
    /// Runs of which a time is the least.
    repeats: usize,
    /// Only parts of at most 1/4 are tried.
    quick: bool,
}

/// Longer reductions than this many seconds are not repeated.
const LONG: f64 = 1.0;

impl Lab {
    /// Makes data sets.
    pub(crate) fn new(
        folder: &Path,
        datasets: &[Dataset],
        shared: Option<&Path>,
        quick: bool,
    ) -> Result<Self> {
        let mut originals = BTreeMap::new();
        for &dataset in datasets {
            let made = dataset.make(folder, shared)?;
            eprintln!("report: {}: {}", dataset.name(), made.origin);
            originals.insert(dataset, Original::new(made, folder)?);
        }
        Ok(Self {
            folder: folder.into(),
            originals,
            outcomes: BTreeMap::new(),
            repeats: if quick { 1 } else { 3 },
            quick,
        })
    }

    pub(crate) fn datasets(&self) -> impl Iterator<Item = Dataset> + '_ {
        self.originals.keys().copied()
    }

    /// How many were done.
    pub(crate) fn experiments(&self) -> usize {
        self.outcomes.len()
    }

    pub(crate) fn original(&self, dataset: Dataset) -> Option<&Original> {
        self.originals.get(&dataset)
    }

    /// The experiment of a part 1/n of the points; `None` without the data set, or where there is no such experiment.
    pub(crate) fn part(
        &mut self,
        dataset: Dataset,
        points: Points,
        n: u64,
        how: How,
    ) -> Result<Option<Outcome>> {
        let Some(original) = self.originals.get(&dataset).filter(|_| !self.quick || n >= 4) else {
            return Ok(None);
        };
        let count = original.size().div_ceil(n);
        self.run(Key { dataset, points, count, how })
    }

    /// The outcome of an experiment, from before or now.
    pub(crate) fn run(&mut self, key: Key) -> Result<Option<Outcome>> {
        let impossible = key.points == Points::Uniform && (!is_grid(key.dataset) || key.how != How::Linear);
        if impossible || !self.originals.contains_key(&key.dataset) {
            return Ok(None);
        }
        if !self.outcomes.contains_key(&key) {
            let outcome = match key.points.kind() {
                Some(kind) => self.reduce(key, kind)?,
                None => self.at_random(key)?,
            };
            self.outcomes.insert(key, outcome);
        }
        Ok(self.outcomes.get(&key).cloned())
    }

    fn reduce(&self, key: Key, kind: SetKind) -> Result<Outcome> {
        let original = &self.originals[&key.dataset];
        let archive = self.folder.join("reduced.isospan");
        let mut settings = ReduceSettings {
            points: kind,
            amount: Amount::Count(key.count),
            interpolation: key.how.interpolation(key.dataset),
            ..ReduceSettings::default()
        };
        let (first, mut times) = self.time(original, &settings, &archive)?;
        settings.measure = false;
        for _ in 1..self.repeats {
            if times.iter().sum::<f64>() < LONG {
                let (_, again) = self.time(original, &settings, &archive)?;
                times = std::array::from_fn(|i| times[i].min(again[i]));
            }
        }
        let surface = Archive::open(&archive)?.surface(original.made.isovalue)?;
        let file = self.surface_file(key);
        write_surface(&surface, &file, SurfaceFormat::Ply, &SurfaceMeta::default())?;
        std::fs::remove_dir_all(&archive).map_err(|e| Error::io("remove", &archive, e))?;
        let [mesh_seconds, sample_seconds, extract_seconds] = times;
        Ok(Outcome {
            is_grid: is_grid(key.dataset),
            asked: key.count,
            points: first.points - first.void_points,
            tetrahedra: first.tetrahedra,
            mesh_seconds,
            sample_seconds,
            extract_seconds,
            triangles: surface.triangles.len() as u64,
            field: original.error_of(first.error.as_ref().expect("the first reduction is measured")),
            distances: compare(&surface, &original.surface)?.in_units_of(original.diagonal),
            roughness: roughness(&surface),
            file,
        })
    }

    /// Reduces and extracts, and tells the seconds of meshing, interpolation and extraction.
    fn time(
        &self,
        original: &Original,
        settings: &ReduceSettings,
        archive: &Path,
    ) -> Result<(ReduceReport, [f64; 3])> {
        let scratch = Some(self.folder.clone());
        let run = RunSettings { threads: 1, replace: true, scratch, ..RunSettings::default() };
        let input = &original.made.file;
        let report = reduce(input, &OpenOptions::default(), settings, archive, &run, &Silent)?;
        let query = SurfaceSettings { threads: 1, ..SurfaceSettings::of(original.made.isovalue) };
        let file = self.folder.join("timed.ply");
        let mut extraction = f64::INFINITY;
        for _ in 0..self.repeats {
            let found = extract_surface(archive, &query, &file, SurfaceFormat::Ply, &Silent)?;
            extraction = extraction.min(seconds(&found.seconds, &["open, index", "extract"]));
        }
        let times = [seconds(&report.seconds, &["mesh"]), seconds(&report.seconds, &["sample"]), extraction];
        Ok((report, times))
    }

    fn at_random(&self, key: Key) -> Result<Outcome> {
        let original = &self.originals[&key.dataset];
        let Content::Grid { geometry, samples } = &original.made.content else {
            return Err(Error::usage("uniform random points are for structured data"));
        };
        let random = uniform(GRID, *geometry, samples, key.count)?;
        let started = Instant::now();
        let surface = random.field.surface(original.made.isovalue)?;
        let extract_seconds = started.elapsed().as_secs_f64();
        let file = self.surface_file(key);
        write_surface(&surface, &file, SurfaceFormat::Ply, &SurfaceMeta::default())?;
        Ok(Outcome {
            is_grid: is_grid(key.dataset),
            asked: key.count,
            points: random.field.point_count(),
            tetrahedra: random.field.tets.len() as u64,
            mesh_seconds: random.mesh_seconds,
            sample_seconds: random.sample_seconds,
            extract_seconds,
            triangles: surface.triangles.len() as u64,
            field: original.error_of_values(&random.field.at_samples(GRID)),
            distances: compare(&surface, &original.surface)?.in_units_of(original.diagonal),
            roughness: roughness(&surface),
            file,
        })
    }

    fn surface_file(&self, key: Key) -> PathBuf {
        let Key { dataset, points, count, how } = key;
        self.folder.join(format!("{dataset:?}-{points:?}-{count}-{how:?}.ply"))
    }
}

impl Original {
    fn new(made: Made, folder: &Path) -> Result<Self> {
        let field = match &made.content {
            Content::Grid { geometry, samples } => TetField::of_grid(GRID, *geometry, samples)?,
            Content::Mesh(mesh) => TetField::of_mesh(mesh)?,
        };
        let surface = field.surface(made.isovalue)?;
        let file = folder.join(format!("{:?}-original.ply", made.dataset));
        write_surface(&surface, &file, SurfaceFormat::Ply, &SurfaceMeta::default())?;
        let side: [f64; 3] = match &made.content {
            Content::Grid { geometry, .. } => geometry.spacing.map(|s| s * (GRID - 1) as f64),
            Content::Mesh(mesh) => {
                let [lo, hi] = mesh.bounds();
                std::array::from_fn(|k| hi[k] - lo[k])
            }
        };
        let diagonal = side.iter().map(|s| s * s).sum::<f64>().sqrt();
        let at = |share| f64::from(crate::data::quantile(made.values(), share));
        let spread = at(0.95) - at(0.05);
        let roughness = roughness(&surface);
        Ok(Self { cells: field.tets.len() as u64, made, surface, roughness, file, diagonal, spread })
    }

    /// Samples, or vertices.
    pub(crate) fn size(&self) -> u64 {
        self.made.values().len() as u64
    }

    fn error_of(&self, error: &isospan::measure::FieldError) -> FieldError {
        let most = error.percentiles.iter().find(|p| p.percent == 95.0);
        FieldError {
            rms: error.rms / self.spread,
            most: most.map_or(f64::NAN, |p| p.error / self.spread),
            outside: 1.0 - error.measured as f64 / error.samples as f64,
        }
    }

    /// The same of values that are no archive's.
    fn error_of_values(&self, reduced: &[f32]) -> FieldError {
        let mut sums = ErrorSums::default();
        let pairs = self.made.values().iter().zip(reduced).enumerate();
        pairs.filter(|(_, (_, r))| !r.is_nan()).for_each(|(n, (&o, &r))| sums.add(o, r, || n as u64));
        let outside = reduced.iter().filter(|r| r.is_nan()).count() as f64 / reduced.len() as f64;
        FieldError { rms: sums.rms() / self.spread, most: sums.percentile(95.0) / self.spread, outside }
    }
}

/// The sum of the seconds of some stages.
fn seconds(all: &[(String, f64)], stages: &[&str]) -> f64 {
    all.iter().filter(|(name, _)| stages.contains(&name.as_str())).map(|(_, s)| s).sum()
}
