//! The Delaunay kernel and the chunk stage, in points a second, with the worker's memory reused.
//!
//! `cargo bench --package isospan-benches --bench delaunay`; names are `delaunay/SET/POINTS` and
//! `chunk/SET/POINTS OWNED`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use isospan::geom::curve::{Order, hilbert_key};
use isospan::geom::{LatticeBox, LatticePos};
use isospan::mesh::chunk::{ChunkOutcome, ChunkRegion, Manner, mesh_widening};
use isospan::mesh::mesher::Mesher;
use std::collections::BTreeSet;
use std::hint::black_box;
use std::time::Duration;

const FULL: u32 = 1 << 24;

fn radical_inverse(base: u64, mut k: u64) -> u32 {
    let (mut digits, mut scale) = (0u64, 1u64);
    while k > 0 {
        (digits, scale, k) = (digits * base + k % base, scale * base, k / base);
    }
    ((u128::from(digits) << 24) / u128::from(scale)) as u32
}

fn hammersley(n: u64) -> Vec<LatticePos> {
    let x = |k: u64| (((2 * k + 1) << 23) / n) as u32;
    (0..n).map(|k| [x(k), radical_inverse(2, k), radical_inverse(3, k)]).collect()
}

fn halton(n: u64) -> Vec<LatticePos> {
    (1..=n).map(|k| [2, 3, 5].map(|b| radical_inverse(b, k))).collect()
}

fn random(n: u64) -> Vec<LatticePos> {
    let mut state = 1u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as u32
    };
    (0..n).map(|_| [next(), next(), next()]).collect()
}

fn grid(n: u32, step: u32) -> Vec<LatticePos> {
    (0..n * n * n).map(|i| [i % n, i / n % n, i / n / n].map(|c| c * step)).collect()
}

fn bcc(n: u32, step: u32) -> Vec<LatticePos> {
    let mut all = grid(n, 2 * step);
    all.extend(grid(n, 2 * step).into_iter().map(|p| p.map(|c| c + step)));
    all
}

/// A sparse grid of dyadic positions, dense along the planes through the middle like a hyperbolic
/// cross.
fn cross(levels: u32, base: u32) -> Vec<LatticePos> {
    let mut all = BTreeSet::new();
    for sx in 0..=levels {
        for sy in 0..=levels - sx {
            let t = [sx + base, sy + base, levels - sx - sy + base];
            let n = t.map(|t| (1u32 << t) - 1);
            for i in 0..n[0] * n[1] * n[2] {
                let l = [i % n[0] + 1, i / n[0] % n[1] + 1, i / n[0] / n[1] + 1];
                all.insert(std::array::from_fn::<u32, 3, _>(|k| l[k] << (24 - t[k])));
            }
        }
    }
    all.into_iter().collect()
}

fn kernel(c: &mut Criterion) {
    let sets = [
        ("hammersley", hammersley(62_500)),
        ("hammersley", hammersley(250_000)),
        ("halton", halton(250_000)),
        ("random", random(62_500)),
        ("random", random(250_000)),
        ("cross", cross(4, 3)),
        ("cross", cross(6, 3)),
        ("grid", grid(40, 1 << 18)),
        ("grid", grid(63, 1 << 18)),
        ("bcc", bcc(50, 1 << 17)),
    ];
    let mut group = c.benchmark_group("delaunay");
    group.sample_size(10).measurement_time(Duration::from_secs(2)).warm_up_time(Duration::from_millis(500));
    let mut mesher = Mesher::new();
    for (name, positions) in &sets {
        let order = Order::for_count(positions.len() as u64);
        group.throughput(Throughput::Elements(positions.len() as u64));
        group.bench_with_input(BenchmarkId::new(*name, positions.len()), positions, |b, p| {
            b.iter(|| mesher.delaunay(black_box(p), &order).unwrap());
        });
        let mut tets = 0u64;
        mesher.for_each_tet(|_| tets += 1);
        if tets > 0 {
            eprintln!("    {name}/{}: {tets} tetrahedra", positions.len());
        }
    }
    group.finish();
}

/// A core in the middle of a larger set, with a halo of three spacings, half of it inserted at
/// once; by insertion, and star by star.
fn stage(c: &mut Criterion) {
    let all = hammersley(2_000_000);
    let order = Order::for_count(all.len() as u64);
    let domain = LatticeBox { lo: [0; 3], hi: [FULL + 1; 3] };
    let core = LatticeBox { lo: [FULL / 4; 3], hi: [FULL / 4 * 3; 3] };
    let spacing = FULL / 126;
    let near = core.grow_within([3 * spacing / 2; 3], &domain);
    let region = core.grow_within([3 * spacing; 3], &domain);
    let mut positions: Vec<LatticePos> = all.into_iter().filter(|p| region.contains(*p)).collect();
    positions.sort_by_cached_key(|p| (!core.contains(*p), !near.contains(*p), hilbert_key(*p, 12)));
    let owned = positions.iter().filter(|p| core.contains(**p)).count() as u64;
    let boxes = ChunkRegion { core, near, region, domain };
    let mut mesher = Mesher::new();
    let mut group = c.benchmark_group("chunk");
    group.sample_size(10).measurement_time(Duration::from_secs(4)).throughput(Throughput::Elements(owned));
    for (name, even) in [("hammersley", false), ("hammersley stars", true)] {
        let manner = Manner { around: false, even };
        group.bench_function(BenchmarkId::new(name, format!("{} {owned}", positions.len())), |b| {
            b.iter(|| {
                let positions = black_box(&mut positions);
                match mesh_widening(&mut mesher, &boxes, positions, &order, manner, &mut |_| Ok(None))
                    .unwrap()
                {
                    ChunkOutcome::Done(mesh) => {
                        let tets = mesh.tets.len();
                        mesher.reuse(mesh.tets);
                        tets
                    }
                    ChunkOutcome::WidenHalo { uncertified } => panic!("{uncertified} uncertified"),
                }
            });
        });
    }
    group.finish();
}

criterion_group!(benches, kernel, stage);
criterion_main!(benches);
