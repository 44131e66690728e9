//! The experiments: each a data set reduced in one way, and measured against the original.
//!
//! Everything is asked for by a [`Key`] and done once. Errors ([`Lab::part`]) are those of one
//! reduction, distances the library's own ([`isospan::compare`]). Times ([`Lab::times`]) are asked
//! for separately: the same reduction again and again, on one thread, while nothing else of the
//! report runs; the medians count. Extraction is what `isospan surface` does but for writing the
//! file: opening the archive, its index, the active blocks, marching tetrahedra, welding.
//!
//! All sets have equal numbers of points, those of the boundary among them, as far as a set allows.

use crate::data::{Content, Dataset, GRID, Made};
use crate::fields::{TetField, uniform, uniform_in};
use crate::methods::median;
use crate::roughness::roughness;
use isospan::compare::{CompareSettings, compare};
use isospan::exec::Silent;
use isospan::formats::surface::{SurfaceFormat, SurfaceMeta, write_surface};
use isospan::formats::{OpenOptions, StepSource};
use isospan::geom::Lattice;
use isospan::measure::ErrorSums;
use isospan::pipeline::{Amount, ReduceReport, ReduceSettings, RunSettings, Stage, reduce_series};
use isospan::points::{PointSet, PointSpec, SetKind};
use isospan::sample::{Interpolation, Values};
use isospan::surface::TriMesh;
use isospan::{Archive, Resources, Result};
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
    Uniform,
}

impl Points {
    pub(crate) const ALL: [Self; 5] =
        [Self::Hammersley, Self::Halton, Self::Hyperbolic, Self::Regular, Self::Uniform];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Hammersley => "Hammersley",
            Self::Halton => "Halton",
            Self::Hyperbolic => "Hyperbolic",
            Self::Regular => "Regular",
            Self::Uniform => "Uniform random",
        }
    }

    /// The library's set; it has none of uniform random points.
    pub(crate) fn kind(self) -> Option<SetKind> {
        match self {
            Self::Hammersley => Some(SetKind::Hammersley),
            Self::Halton => Some(SetKind::Halton),
            Self::Hyperbolic => Some(SetKind::HyperbolicCross),
            Self::Regular => Some(SetKind::Regular),
            Self::Uniform => None,
        }
    }
}

/// An experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Key {
    pub(crate) dataset: Dataset,
    pub(crate) points: Points,
    /// Points asked for, those of the boundary among them.
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
    /// Points with values, with those of the boundary.
    pub(crate) points: u64,
    pub(crate) tetrahedra: u64,
    pub(crate) triangles: u64,
    pub(crate) field: FieldError,
    /// From the original's surface.
    pub(crate) distances: Distances,
    /// RMS angle between neighbouring triangles, in degrees.
    pub(crate) roughness: f64,
    /// The surface.
    pub(crate) file: PathBuf,
}

/// How far a surface is from the original's, both ways, in units of the diagonal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Distances {
    pub(crate) hausdorff: f64,
    /// Root mean square.
    pub(crate) rms: f64,
    /// Root mean square angle between normals, in degrees.
    pub(crate) normal: f64,
}

/// Seconds of an experiment's stages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Times {
    /// Points asked for.
    pub(crate) asked: u64,
    /// Points with values, with those of the boundary.
    pub(crate) points: u64,
    pub(crate) mesh: f64,
    pub(crate) sample: f64,
    pub(crate) extract: f64,
}

/// Samples by area of a surface whose distance is measured.
const DISTANCE_SAMPLES: u64 = 20_000;

/// Distances in units of `diagonal`; infinite if a surface is empty.
pub(crate) fn distances(a: &TriMesh, b: &TriMesh, diagonal: f64) -> Result<Distances> {
    if a.triangles.is_empty() || b.triangles.is_empty() {
        return Ok(Distances { hausdorff: f64::INFINITY, rms: f64::INFINITY, normal: f64::NAN });
    }
    let found = compare(a, b, &CompareSettings { samples: DISTANCE_SAMPLES, ..CompareSettings::default() })?;
    let [hausdorff, rms] = [found.hausdorff, found.rms].map(|d| d / diagonal);
    Ok(Distances { hausdorff, rms, normal: found.rms_normal_degrees })
}

impl Outcome {
    /// One number for the error of the field: the RMS in volumes; in meshes what 95 of 100 samples
    /// do not exceed, since the cell of the dipole would outweigh all others.
    pub(crate) fn field_error(&self) -> f64 {
        if self.is_grid { self.field.rms } else { self.field.most }
    }
}

/// The reduced field less the original, at the original's samples, in units of the spread of their
/// values.
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
    /// All its cells.
    pub(crate) field: TetField,
    pub(crate) surface: TriMesh,
    /// Of that surface: RMS angle between neighbouring triangles, in degrees.
    pub(crate) roughness: f64,
    pub(crate) file: PathBuf,
    /// Length of the diagonal of the bounding box: the unit of distances.
    pub(crate) diagonal: f64,
    /// The 95th percentile of the values less the 5th: the unit of errors. The range is no unit
    /// near a dipole.
    pub(crate) spread: f64,
    /// Of n points inside, so many times n^(2/3) samples of the boundary come on top.
    boundary: f64,
}

/// All data and experiments.
pub(crate) struct Lab {
    folder: PathBuf,
    originals: BTreeMap<Dataset, Original>,
    outcomes: BTreeMap<Key, Outcome>,
    times: BTreeMap<Key, Times>,
    /// Seconds that all times took, by the clock and of this process.
    timed: [f64; 2],
    /// Runs of which a time is the median.
    repeats: usize,
    /// Only parts of at most 1/4 are tried.
    quick: bool,
}

impl Lab {
    /// Makes data sets.
    pub(crate) fn new(
        folder: &Path,
        datasets: &[Dataset],
        shared: Option<&Path>,
        quick: bool,
    ) -> Result<Self> {
        let mut lab = Self {
            folder: folder.into(),
            originals: BTreeMap::new(),
            outcomes: BTreeMap::new(),
            times: BTreeMap::new(),
            timed: [0.0; 2],
            repeats: if quick { 1 } else { 3 },
            quick,
        };
        for &dataset in datasets {
            let made = dataset.make(folder, shared)?;
            eprintln!("report: {}: {}", dataset.name(), made.origin);
            lab.originals.insert(dataset, Original::new(made, folder)?);
            let boundary = lab.boundary(dataset)?;
            lab.originals.entry(dataset).and_modify(|o| o.boundary = boundary);
        }
        Ok(lab)
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

    /// The experiment of a part 1/n of the points; `None` without the data set, or where there is
    /// no such experiment.
    pub(crate) fn part(
        &mut self,
        dataset: Dataset,
        points: Points,
        n: u64,
        how: How,
    ) -> Result<Option<Outcome>> {
        match self.key(dataset, points, n, how) {
            Some(key) => self.run(key),
            None => Ok(None),
        }
    }

    /// The times of a part 1/n of the points, as `part`.
    pub(crate) fn times_of_part(
        &mut self,
        dataset: Dataset,
        points: Points,
        n: u64,
        how: How,
    ) -> Result<Option<Times>> {
        match self.key(dataset, points, n, how) {
            Some(key) => self.times(key),
            None => Ok(None),
        }
    }

    fn key(&self, dataset: Dataset, points: Points, n: u64, how: How) -> Option<Key> {
        let original = self.originals.get(&dataset).filter(|_| !self.quick || n >= 4)?;
        Some(Key { dataset, points, count: original.size().div_ceil(n), how })
    }

    /// The outcome of an experiment, from before or now.
    pub(crate) fn run(&mut self, key: Key) -> Result<Option<Outcome>> {
        let impossible = key.points == Points::Uniform && key.how != How::Linear;
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

    /// The times of an experiment, from before or now: medians of several runs on one thread.
    pub(crate) fn times(&mut self, key: Key) -> Result<Option<Times>> {
        let (Some(kind), Some(original)) = (key.points.kind(), self.originals.get(&key.dataset)) else {
            return Ok(None);
        };
        if let Some(&known) = self.times.get(&key) {
            return Ok(Some(known));
        }
        let mut settings = self.settings(key, kind);
        let archive = self.folder.join("reduced.isospan");
        let (mut mesh, mut sample, mut extract, mut points) = (vec![], vec![], vec![], 0);
        let mut outcome = self.outcomes.get(&key).cloned();
        let (started, worked) = (Instant::now(), processor_seconds());
        for _ in 0..self.repeats {
            // The first run gives the errors, too, if they are not known.
            settings.measure = outcome.is_none();
            let report = self.reduce_into(key.dataset, &settings, &archive, 1)?;
            points = report.points - report.void_points;
            if settings.measure {
                outcome = Some(self.outcome_of(key, &report, &archive)?);
            }
            mesh.push(seconds(&report.seconds, &[Stage::Mesh]));
            sample.push(seconds(&report.seconds, &[Stage::Sample]));
        }
        let file = self.folder.join("timed.ply");
        for _ in 0..self.repeats {
            let open = Archive::open(&archive)?.keeping(0);
            let query = open.query(original.made.isovalue).resources(Resources::default().with_threads(1));
            let found = query.write(&file)?;
            extract.push(open.opening().seconds + seconds(&found.seconds, &[Stage::Open, Stage::Extract]));
        }
        if let Some((before, after)) = worked.zip(processor_seconds()) {
            self.timed[0] += started.elapsed().as_secs_f64();
            self.timed[1] += after - before;
        }
        let [mesh, sample, extract] = [mesh, sample, extract].map(median);
        let times = Times { asked: key.count, points, mesh, sample, extract };
        self.times.insert(key, times);
        self.outcomes.extend(outcome.map(|o| (key, o)));
        Ok(Some(times))
    }

    /// How much of one processor this process had while times were taken; `None` where the system
    /// does not report it.
    pub(crate) fn share_of_a_processor(&self) -> Option<f64> {
        let [clock, process] = self.timed;
        (clock > 0.0).then(|| process / clock)
    }

    fn settings(&self, key: Key, kind: SetKind) -> ReduceSettings {
        ReduceSettings {
            amount: Amount::Count(self.inside(key)),
            interpolation: key.how.interpolation(key.dataset),
            values: Some(Values::Sample),
            ..ReduceSettings::exact(kind)
        }
    }

    /// How many points inside make `key.count` with those of the boundary: n + b·n^(2/3) is that
    /// many.
    fn inside(&self, key: Key) -> u64 {
        // Regular points of a grid have its faces among them.
        if is_grid(key.dataset) && key.points == Points::Regular {
            return key.count;
        }
        let original = &self.originals[&key.dataset];
        let b = match (key.points, &original.made.content) {
            (Points::Uniform, Content::Mesh(_)) => original.field.boundary_factor(),
            _ => original.boundary,
        };
        let (mut few, mut many) = (1.0, key.count as f64);
        for _ in 0..64 {
            let n = (few + many) / 2.0;
            let all = n + b * libm::cbrt(n * n);
            if all < key.count as f64 { few = n } else { many = n }
        }
        (few.round() as u64).max(1)
    }

    /// See [`Original::boundary`]: of the frame of a box, and as found in one reduction of a mesh.
    fn boundary(&self, dataset: Dataset) -> Result<f64> {
        let inside = self.originals[&dataset].size().div_ceil(8);
        let all = if is_grid(dataset) {
            let spec = PointSpec::Hammersley { n: inside, shift: 0.5 };
            PointSet::new(spec, Lattice::new([GRID as u64; 3])?)?.len()
        } else {
            let settings = ReduceSettings {
                amount: Amount::Count(inside),
                values: Some(Values::Sample),
                measure: false,
                ..ReduceSettings::default()
            };
            let report = self.reduce_into(dataset, &settings, &self.folder.join("reduced.isospan"), 0)?;
            report.points - report.void_points
        };
        let n = inside as f64;
        Ok((all.saturating_sub(inside)) as f64 / libm::cbrt(n * n))
    }

    fn reduce_into(
        &self,
        dataset: Dataset,
        settings: &ReduceSettings,
        archive: &Path,
        threads: usize,
    ) -> Result<ReduceReport> {
        let scratch = Some(self.folder.clone());
        let run = RunSettings {
            resources: Resources::default().with_threads(threads).with_scratch(scratch),
            replace: true,
            ..RunSettings::default()
        };
        let input = &self.originals[&dataset].made.file;
        reduce_series(&[StepSource::new(input, &OpenOptions::default())], settings, archive, &run, &Silent)
    }

    fn reduce(&self, key: Key, kind: SetKind) -> Result<Outcome> {
        let archive = self.folder.join("reduced.isospan");
        let report = self.reduce_into(key.dataset, &self.settings(key, kind), &archive, 0)?;
        self.outcome_of(key, &report, &archive)
    }

    fn outcome_of(&self, key: Key, report: &ReduceReport, archive: &Path) -> Result<Outcome> {
        let original = &self.originals[&key.dataset];
        let surface = Archive::open(archive)?.surface(original.made.isovalue)?;
        let field = original.error_of(report.error.as_ref().expect("the reduction is measured"));
        self.outcome(key, report.points - report.void_points, report.tetrahedra, field, &surface)
    }

    fn at_random(&self, key: Key) -> Result<Outcome> {
        let original = &self.originals[&key.dataset];
        let inside = self.inside(key);
        let random = match &original.made.content {
            Content::Grid { geometry, samples } => uniform(GRID, *geometry, samples, inside)?,
            Content::Mesh(_) => uniform_in(&original.field, inside)?,
        };
        let surface = random.surface(original.made.isovalue)?;
        let field = original.error_of_values(&random.at(&original.field));
        self.outcome(key, random.point_count(), random.tets.len() as u64, field, &surface)
    }

    fn outcome(
        &self,
        key: Key,
        points: u64,
        tetrahedra: u64,
        field: FieldError,
        surface: &TriMesh,
    ) -> Result<Outcome> {
        let original = &self.originals[&key.dataset];
        let file = self.surface_file(key);
        write_surface(surface, &file, SurfaceFormat::Ply, &SurfaceMeta::default(), &Resources::default())?;
        Ok(Outcome {
            is_grid: is_grid(key.dataset),
            points,
            tetrahedra,
            triangles: surface.triangles.len() as u64,
            field,
            distances: distances(surface, &original.surface, original.diagonal)?,
            roughness: roughness(surface),
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
        write_surface(&surface, &file, SurfaceFormat::Ply, &SurfaceMeta::default(), &Resources::default())?;
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
        Ok(Self { field, made, surface, roughness, file, diagonal, spread, boundary: 0.0 })
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

/// Seconds that processors have spent on this process, as Linux counts them: in hundredths.
fn processor_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Behind the name, which may hold anything: the state, ten numbers, then the times of the
    // program and of the system.
    let numbers = stat.rsplit(')').next()?.split_whitespace().skip(11).take(2);
    let ticks: Vec<u64> = numbers.map_while(|n| n.parse().ok()).collect();
    (ticks.len() == 2).then(|| ticks.iter().sum::<u64>() as f64 / 100.0)
}

/// The sum of the seconds of some stages.
fn seconds(all: &[(Stage, f64)], stages: &[Stage]) -> f64 {
    all.iter().filter(|(stage, _)| stages.contains(stage)).map(|(_, s)| s).sum()
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_process_works() {
        let before = processor_seconds().unwrap();
        let started = Instant::now();
        while processor_seconds().unwrap() < before + 0.05 {
            assert!(started.elapsed().as_secs() < 60, "a loop takes processor time");
        }
    }
}
