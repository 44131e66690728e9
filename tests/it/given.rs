//! Volumes that a program gives: samples in memory, and anything that answers for boxes of them.

use crate::common;
use isospan::exec::{CancelToken, Silent};
use isospan::formats::{OpenOptions, StepSource};
use isospan::grid::{Geometry, IndexBox};
use isospan::pipeline::{
    Addition, Archive, ReduceReport, ReduceSettings, RunSettings, StepChoice, Target, reduce_series,
};
use isospan::points::SetKind;
use isospan::volume::memory::{info_of, volume_of};
use isospan::volume::{ScalarType, VolumeInfo, VolumeReader};
use isospan::{Error, Reduction, Resources, Result};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

const DIMS: [usize; 3] = [20, 24, 18];

fn field(x: f64, y: f64, z: f64) -> f64 {
    (3.0 * x).sin() + y * y - 0.5 * z + 0.1 * (9.0 * y * z).cos()
}

/// The samples that an NPY file of the field has.
fn samples() -> Vec<f32> {
    let unit = |i: usize, n: usize| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
    let [nx, ny, nz] = DIMS;
    let place = |i: usize| [unit(i % nx, nx), unit(i / nx % ny, ny), unit(i / nx / ny, nz)];
    (0..nx * ny * nz).map(|i| field(place(i)[0], place(i)[1], place(i)[2]) as f32).collect()
}

fn dims() -> [u64; 3] {
    DIMS.map(|n| n as u64)
}

fn given(samples: Vec<f32>) -> StepSource {
    StepSource::given("field", Arc::new(volume_of("field", dims(), samples).unwrap()))
}

fn reduce(source: StepSource, settings: &ReduceSettings, out: &Path) -> Result<ReduceReport> {
    reduce_series(&[source], settings, out, &RunSettings::default(), &Silent)
}

#[test]
fn samples_in_memory_give_what_their_file_gives() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("field.npy");
    common::write_npy(&file, DIMS, field);
    let halton = ReduceSettings { points: Some(SetKind::Halton), ..ReduceSettings::default() };
    let rms = isospan::pipeline::Bound::OfRange(0.01);
    let target = ReduceSettings { target: Some(Target::Rms(rms)), ..ReduceSettings::default() };
    let ratio = ReduceSettings { target: Some(Target::Ratio(4.0)), ..halton.clone() };
    for (n, settings) in [ReduceSettings::default(), halton, target].iter().enumerate() {
        let [a, b] = ["file", "given"].map(|name| dir.path().join(format!("{name}-{n}.isospan")));
        reduce_series(
            &[StepSource::new(&file, &OpenOptions::default())],
            settings,
            &a,
            &RunSettings { replace: true, ..RunSettings::default() },
            &Silent,
        )
        .unwrap();
        let made = reduce(given(samples()), settings, &b).unwrap();
        assert!(made.error.is_some());
        let [a, b] = [a, b].map(|path| Archive::open(path).unwrap().surface(0.25).unwrap());
        assert!(!a.triangles.is_empty());
        assert_eq!((a.vertices, a.triangles), (b.vertices, b.triangles), "settings {n}");
    }
    // Bytes depend on names, and with them what fits a size.
    let made = reduce(given(samples()), &ratio, &dir.path().join("ratio.isospan")).unwrap();
    assert!(made.target.unwrap().met);
}

#[test]
fn the_same_samples_are_known_again_and_others_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a.isospan");
    let settings = ReduceSettings::default();
    assert!(!reduce(given(samples()), &settings, &out).unwrap().made_before);
    assert!(reduce(given(samples()), &settings, &out).unwrap().made_before);
    let mut others = samples();
    others[77] += 0.001;
    let error = reduce(given(others), &settings, &out).expect_err("another volume");
    assert!(matches!(error, Error::Usage { .. }), "{error}");
}

#[test]
fn an_archive_is_measured_against_samples_in_memory() {
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("field.npy"), dir.path().join("a.isospan"));
    common::write_npy(&file, DIMS, field);
    let made = reduce(given(samples()), &ReduceSettings::default(), &out).unwrap();
    let measured = |source| Archive::open(&out)?.measure(source).run();
    let [against_samples, against_file] =
        [given(samples()), StepSource::new(&file, &OpenOptions::default())].map(|s| measured(s).unwrap());
    assert_eq!(Some(&against_samples.error), made.error.as_ref());
    assert_eq!(against_samples.error, against_file.error);
    // A file has another hash than samples have.
    assert!(against_samples.same_source && !against_file.same_source);
    let raised = measured(given(samples().iter().map(|v| v + 1.0).collect())).unwrap();
    assert!(!raised.same_source && raised.error.rms > 0.9);
    let small = StepSource::given("small", Arc::new(volume_of("small", [2, 2, 2], vec![0.0; 8]).unwrap()));
    let error = measured(small).expect_err("another size");
    assert!(matches!(&error, Error::BadInput(bad) if bad.got.contains("2 x 2 x 2")), "{error}");
}

#[test]
fn a_check_and_a_count_are_stopped() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a.isospan");
    let steps = [0.0, 1.0].map(|time| given(samples()).at(Some(time)));
    reduce_series(&steps, &ReduceSettings::default(), &out, &RunSettings::default(), &Silent).unwrap();
    let (go, stop) = (CancelToken::new(), CancelToken::new());
    stop.cancel();
    let archive = Archive::open(&out).unwrap();
    assert_eq!(archive.check_until(&go).unwrap().steps, 2);
    assert!(matches!(archive.check_until(&stop), Err(Error::Cancelled)));
    let between = archive.at(StepChoice::Time(0.5)).unwrap();
    let count = |cancel| between.query(0.25).resources(Resources::default().with_cancel(cancel)).count();
    assert!(count(go).unwrap().active_cells > 0);
    assert!(matches!(count(stop), Err(Error::Cancelled)));
}

#[test]
fn steps_are_added_and_places_are_those_of_the_volume() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a.isospan");
    let geometry = Geometry { origin: [10.0, 0.0, -5.0], spacing: [0.5, 2.0, 1.0], ..Geometry::default() };
    let step = |samples: Vec<f32>, time: f64| {
        let volume = volume_of("field", dims(), samples).unwrap().placed(geometry);
        StepSource::given("field", Arc::new(volume)).at(Some(time))
    };
    let (run, settings) = (RunSettings::default(), ReduceSettings::default());
    reduce_series(&[step(samples(), 0.0)], &settings, &out, &run, &Silent).unwrap();
    let later = samples().iter().map(|v| v + 1.0).collect();
    Addition::of(step(later, 2.5)).append_to(&out).unwrap();
    let archive = Archive::open(&out).unwrap();
    assert_eq!(archive.geometry(), geometry);
    assert_eq!(archive.info().unwrap().steps.len(), 2);
}

#[test]
fn other_processes_cannot_read_it() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a.isospan");
    let planned = Reduction::of(given(samples())).plan_shards(&out, 2);
    let error = planned.expect_err("refused").to_string();
    assert!(error.contains("field is in memory"), "{error}");
    assert_eq!(fs::read_dir(dir.path()).unwrap().filter(|e| !hidden(e)).count(), 0);
}

/// A lock file stays.
fn hidden(entry: &std::io::Result<fs::DirEntry>) -> bool {
    entry.as_ref().unwrap().file_name().to_string_lossy().starts_with('.')
}

/// A field that is computed when it is asked for.
struct Computed {
    info: VolumeInfo,
    identity: Option<&'static str>,
    read: AtomicU64,
    /// Fails from this slice on.
    end: u64,
}

impl Computed {
    fn new(identity: Option<&'static str>, end: u64) -> Arc<Self> {
        let info = info_of("computed", [32; 3], ScalarType::F32);
        Arc::new(Self { info, identity, read: AtomicU64::new(0), end })
    }
}

impl VolumeReader for Computed {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()> {
        if voxels.hi[2] > self.end {
            return Err(Error::bad_input("computed", "slice 20", "values", "none"));
        }
        self.read.fetch_add(voxels.len() as u64, Ordering::Relaxed);
        let ([x, y, z], d) = (voxels.lo, voxels.dims());
        for (i, value) in (0..).zip(out.iter_mut()) {
            let at = [x + i % d[0], y + i / d[0] % d[1], z + i / d[0] / d[1]];
            *value = at.iter().map(|&n| (n as f32 - 15.5).powi(2)).sum::<f32>().sqrt();
        }
        Ok(())
    }

    fn identity(&self) -> Option<String> {
        self.identity.map(str::to_owned)
    }
}

#[test]
fn a_computed_field_is_hashed_only_without_an_identity() {
    let dir = tempfile::tempdir().unwrap();
    let read = [None, Some("distance from the centre")].map(|identity| {
        let volume = Computed::new(identity, 32);
        let out = dir.path().join(format!("{}.isospan", identity.is_some()));
        let source = StepSource::given("computed", Arc::clone(&volume) as Arc<dyn VolumeReader>);
        reduce(source, &ReduceSettings::default(), &out).unwrap();
        let surface = Archive::open(&out).unwrap().surface(10.0).unwrap();
        assert!(surface.vertices.iter().all(|v| {
            let r = v.position.map(|x| (x - 15.5).powi(2)).iter().sum::<f32>().sqrt();
            (r - 10.0).abs() < 0.5
        }));
        volume.read.load(Ordering::Relaxed)
    });
    assert_eq!(read[0] - read[1], 32 * 32 * 32);
}

#[test]
fn an_error_of_the_reader_ends_the_run_and_leaves_no_archive() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a.isospan");
    let source = StepSource::given("computed", Computed::new(Some("cut"), 20));
    let error = reduce(source, &ReduceSettings::default(), &out).expect_err("it has no more slices");
    assert!(error.to_string().contains("slice 20"), "{error}");
    assert!(!out.join("manifest.zst").exists() && Archive::open(&out).is_err());
    let stop = CancelToken::new();
    stop.cancel();
    let run = RunSettings { resources: Resources::default().with_cancel(stop), ..RunSettings::default() };
    let made = reduce_series(&[given(samples())], &ReduceSettings::default(), &out, &run, &Silent);
    assert!(matches!(made, Err(Error::Cancelled)));
}
