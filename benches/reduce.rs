//! The whole of `reduce`, in points a second: a volume from the disk to a finished archive, one
//! thread and all; and steps of a series, in points of all steps a second.
//!
//! `cargo bench --package isospan-benches --bench reduce`, about a minute; names are
//! `reduce/FIELD/THREADS` and `series/STEPS/THREADS`.

use criterion::measurement::WallTime;
use criterion::{
    BenchmarkGroup, BenchmarkId, Criterion, SamplingMode, Throughput, criterion_group, criterion_main,
};
use isospan::Resources;
use isospan::exec::{Silent, available_threads};
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{Amount, ReduceSettings, RunSettings, reduce_series};
use isospan::points::SetKind;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Samples along each axis; a point for eight of them.
const SIZE: u32 = 128;

/// A step of a drifting gyroid, with so much noise upon it, as an f32 volume.
fn write_step(folder: &Path, t: u32, noise: f32) -> PathBuf {
    let path = folder.join(format!("v{t}-{noise}.nrrd"));
    let wave = |i: u32, drift: f32| (i as f32 * 0.1 + drift).sin_cos();
    let drift = t as f32 * 0.05;
    let mut state = 1u32;
    let sizes = format!("sizes: {SIZE} {SIZE} {SIZE}");
    let head = format!("NRRD0004\ntype: float\ndimension: 3\n{sizes}\nendian: little\nencoding: raw\n\n");
    let mut bytes = head.into_bytes();
    for z in 0..SIZE {
        let (sz, cz) = wave(z, 0.0);
        for y in 0..SIZE {
            let (sy, cy) = wave(y, 0.0);
            for x in 0..SIZE {
                let (sx, cx) = wave(x, drift);
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let random = (state >> 8) as f32 / (1u32 << 24) as f32 - 0.5;
                bytes.extend((sx * cy + sy * cz + sz * cx + noise * random).to_le_bytes());
            }
        }
    }
    fs::write(&path, bytes).expect("the folder is ours");
    path
}

/// Reduces steps with some threads; returns the points of the mesh.
fn reduce_all(steps: &[StepSource], folder: &Path, threads: usize) -> u64 {
    let settings =
        ReduceSettings { amount: Amount::Fraction(0.125), ..ReduceSettings::exact(SetKind::Hammersley) };
    let run = RunSettings {
        resources: Resources::default().with_threads(threads),
        replace: true,
        ..RunSettings::default()
    };
    let out = folder.join("bench.isospan");
    reduce_series(steps, &settings, &out, &run, &Silent).expect("the volumes are whole").points
}

fn threads() -> Vec<usize> {
    let mut all = vec![1, 2, available_threads()];
    all.retain(|&n| n <= available_threads());
    all.dedup();
    all
}

/// Ten runs of each bench: a run takes about a second.
fn group<'a>(c: &'a mut Criterion, name: &str) -> BenchmarkGroup<'a, WallTime> {
    let mut group = c.benchmark_group(name);
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    group.warm_up_time(Duration::from_millis(100)).measurement_time(Duration::from_secs(4));
    group
}

fn bench_reduce(c: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut group = group(c, "reduce");
    for (name, noise) in [("smooth", 0.0), ("noise", 2.0)] {
        let step = [StepSource::new(&write_step(folder.path(), 0, noise), &OpenOptions::default())];
        for threads in threads() {
            let points = reduce_all(&step, folder.path(), threads);
            group.throughput(Throughput::Elements(points));
            let id = BenchmarkId::new(name, threads);
            group.bench_function(id, |b| b.iter(|| reduce_all(&step, folder.path(), threads)));
        }
    }
    group.finish();
}

fn bench_series(c: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let step = |t| StepSource::new(&write_step(folder.path(), t, 0.01), &OpenOptions::default());
    let steps: Vec<StepSource> = (0..16).map(step).collect();
    let mut group = group(c, "series");
    for count in [1, 16] {
        let points = reduce_all(&steps[..count], folder.path(), 1);
        group.throughput(Throughput::Elements(points * count as u64));
        let id = BenchmarkId::new(count.to_string(), 1);
        group.bench_function(id, |b| b.iter(|| reduce_all(&steps[..count], folder.path(), 1)));
    }
    group.finish();
}

criterion_group!(benches, bench_reduce, bench_series);
criterion_main!(benches);
