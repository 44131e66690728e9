//! Extraction, welding and checking of a gyroid in a chunk of 262 144 points and 1.5 million
//! tetrahedra; and whole surfaces of archives whose blocks are kept (`kept/FIELD/POINTS`, one
//! thread: of 60 000 points what is kept fits in the caches, of a million it does not). Throughput
//! is in triangles; of the cells of a grid (`cubes/ISOVALUE`) it is in cells.
//!
//! `cargo bench --package isospan-benches --bench surface`, about a minute.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::geom::{Lattice, LatticePos, PointId};
use isospan::grid::Geometry;
use isospan::mesh::tet::{self, Tet};
use isospan::pipeline::{Amount, ReduceSettings, RunSettings, reduce_series};
use isospan::points::SetKind;
use isospan::sample::Values;
use isospan::surface::check::check;
use isospan::surface::extract::{
    CellSource, ChunkSurface, CubeBench, GridBlock, Workbench, extract, marching_cubes,
};
use isospan::surface::weld::{BuilderSettings, SurfaceBuilder};
use isospan::surface::{TriMesh, WorldMap};
use isospan::{Archive, Resources};
use std::hint::black_box;
use std::path::{Path, PathBuf};

const N: u64 = 64;
const ISOVALUE: f32 = 0.1;

struct Chunk {
    lattice: Lattice,
    positions: Vec<LatticePos>,
    values: Vec<f32>,
    ids: Vec<PointId>,
    shared: Vec<bool>,
    tets: Vec<Tet>,
}

impl Chunk {
    /// Voxels cut into Kuhn's six tetrahedra; corners on the faces are shared.
    fn new() -> Self {
        let lattice = Lattice::new([N; 3]).expect("a small grid has a lattice");
        let voxels = || (0..N * N * N).map(|n| [n % N, n / N % N, n / N / N]);
        let gyroid = |ijk: [u64; 3]| {
            let [x, y, z] = ijk.map(|i| i as f64 * 0.25);
            (x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()) as f32
        };
        Self {
            lattice,
            positions: voxels().map(|p| lattice.of_voxel(p)).collect(),
            values: voxels().map(gyroid).collect(),
            ids: (0..N * N * N).map(|n| PointId((n * 0x9E_3779_B97F) & ((1 << 40) - 1))).collect(),
            shared: voxels().map(|p| p.iter().any(|&i| i == 0 || i == N - 1)).collect(),
            tets: voxels().filter(|p| p.iter().all(|&i| i < N - 1)).flat_map(kuhn).collect(),
        }
    }

    fn source<'a>(&'a self, tets: &'a [Tet]) -> CellSource<'a> {
        CellSource {
            positions: &self.positions,
            values: &self.values,
            ids: &self.ids,
            shared: &self.shared,
            numbers: None,
            tets,
        }
    }

    fn active(&self) -> Vec<Tet> {
        let is_active = |t: &&Tet| {
            tet::range(t.map(|c| self.values[c as usize]))
                .is_some_and(|(lo, hi)| tet::is_active(lo, hi, ISOVALUE))
        };
        self.tets.iter().filter(is_active).copied().collect()
    }
}

fn kuhn(at: [u64; 3]) -> [Tet; 6] {
    let paths = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
    std::array::from_fn(|n| {
        let mut p = at;
        let number = |p: [u64; 3]| ((p[2] * N + p[1]) * N + p[0]) as u32;
        let mut tet = [number(p); 4];
        for (step, axis) in paths[n].into_iter().enumerate() {
            p[axis] += 1;
            tet[step + 1] = number(p);
        }
        if n >= 3 {
            tet.swap(2, 3);
        }
        tet
    })
}

fn surface(c: &mut Criterion) {
    let chunk = Chunk::new();
    let world = WorldMap::new(&chunk.lattice, &Geometry::default());
    let active = chunk.active();
    let (mut bench, mut out) = (Workbench::default(), ChunkSurface::default());
    extract(&chunk.source(&active), ISOVALUE, &world, &mut bench, &mut out);
    let triangles = out.triangles().len() as u64;

    let mut group = c.benchmark_group("surface");
    group.throughput(Throughput::Elements(triangles));
    for (name, tets) in [("extract/active cells", &active), ("extract/all cells", &chunk.tets)] {
        group.bench_function(format!("{name}/{}", tets.len()), |b| {
            b.iter(|| extract(black_box(&chunk.source(tets)), ISOVALUE, &world, &mut bench, &mut out));
        });
    }
    let build = || {
        let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
        builder.push(&out).expect("memory suffices");
        builder.finish().expect("memory suffices")
    };
    group.bench_function(format!("weld/{triangles}"), |b| {
        b.iter_batched(|| (), |()| build(), BatchSize::PerIteration);
    });
    let mesh = TriMesh::from_source(&build()).expect("memory suffices");
    group.bench_function(format!("check/{triangles}"), |b| b.iter(|| check(black_box(&mesh))));
    group.finish();
}

/// The same gyroid by the cells of its grid: crossed as above, and by nothing.
fn cubes(c: &mut Criterion) {
    let values = Chunk::new().values;
    let world = WorldMap::of_samples(&Geometry::default());
    let block = GridBlock {
        grid: [N; 3],
        stride: [1; 3],
        start: [0; 3],
        size: [N as usize; 3],
        values: &values,
        cells: [[0, N - 1]; 3],
    };
    let (mut bench, mut out) = (CubeBench::default(), ChunkSurface::default());
    let mut group = c.benchmark_group("cubes");
    group.throughput(Throughput::Elements((N - 1).pow(3)));
    for isovalue in [ISOVALUE, 10.0] {
        group.bench_function(isovalue.to_string(), |b| {
            b.iter(|| marching_cubes(black_box(&block), isovalue, false, &world, &mut bench, &mut out));
        });
    }
    group.finish();
}

/// A gyroid with so many turns along each axis, reduced to an archive of so many points.
fn archive(folder: &Path, turns: f32, points: u64) -> PathBuf {
    const SIZE: u32 = 128;
    let input = folder.join("gyroid.nrrd");
    let sizes = format!("sizes: {SIZE} {SIZE} {SIZE}");
    let head = format!("NRRD0004\ntype: float\ndimension: 3\n{sizes}\nendian: little\nencoding: raw\n\n");
    let wave = |i: u32| (i as f32 / SIZE as f32 * turns * std::f32::consts::TAU).sin_cos();
    let mut bytes = head.into_bytes();
    for z in 0..SIZE {
        for y in 0..SIZE {
            for x in 0..SIZE {
                let [(sx, cx), (sy, cy), (sz, cz)] = [x, y, z].map(wave);
                bytes.extend((sx * cy + sy * cz + sz * cx).to_le_bytes());
            }
        }
    }
    std::fs::write(&input, bytes).expect("the folder is ours");
    let out = folder.join(format!("{turns}-{points}.isospan"));
    let amount = Amount::Count(points);
    let settings = ReduceSettings {
        points: Some(SetKind::Halton),
        amount,
        values: Some(Values::Sample),
        measure: false,
        ..ReduceSettings::default()
    };
    let (options, run) = (OpenOptions::default(), RunSettings::default());
    reduce_series(&[StepSource::new(&input, &options)], &settings, &out, &run, &Silent)
        .expect("the volume is whole");
    out
}

/// A user drags an isovalue: questions to blocks that are kept.
fn kept(c: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let mut group = c.benchmark_group("kept");
    for (field, turns) in [("smooth", 1.0), ("busy", 5.0)] {
        for points in [60_000, 1_000_000] {
            let archive = Archive::open(archive(folder.path(), turns, points)).expect("it was just made");
            let archive = archive.keeping(4 << 30);
            let one = Resources::default().with_threads(1);
            let questions = [0.0, 0.01, 0.02, 0.03].map(|v| archive.query(v).resources(one.clone()));
            let mut surfaces = vec![];
            let mut ask = || -> u64 {
                let triangles = questions.iter().map(|question| {
                    question.meshes_into(&mut surfaces).expect("memory suffices");
                    surfaces[0].triangles.len() as u64
                });
                triangles.sum()
            };
            // All blocks are read.
            let triangles = ask();
            group.throughput(Throughput::Elements(triangles));
            group.bench_function(format!("{field}/{points}"), |b| b.iter(&mut ask));
        }
    }
    group.finish();
}

criterion_group!(benches, surface, cubes, kept);
criterion_main!(benches);
