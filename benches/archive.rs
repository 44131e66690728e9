//! Coding and decoding of a chunk's tetrahedra, in tetrahedra a second, and of values, in values a
//! second.
//!
//! `cargo bench --package isospan-benches --bench archive`; names are `encode/SET`, `decode/SET`,
//! `values/encode` and `values/decode`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isospan::archive::mesh::{ChunkEncoder, ChunkVertices, TetBlock, TetScratch};
use isospan::archive::values::{BLOCK_VALUES, KnownOfBlock, ValueBlocks, decode_values, encode_values};
use isospan::geom::curve::Order;
use isospan::geom::{Lattice, LatticePos};
use isospan::grid::{BrickGrid, BrickId};
use isospan::mesh::mesher::Mesher;
use isospan::mesh::tet::Tet;
use isospan::points::{PointSet, PointSpec, SetKind, SetSettings};
use std::hint::black_box;
use std::time::Duration;

const POINTS: u64 = 62_500;
const BLOCK_TETS: u32 = 256;

/// The points of a set in the order of a chunk's vertices (brick after brick), and their
/// tetrahedra.
fn mesh(kind: SetKind) -> (Vec<LatticePos>, Vec<Tet>) {
    const SAMPLES: u64 = 101;
    let lattice = Lattice::new([SAMPLES; 3]).expect("it is small");
    let spec =
        PointSpec::with_count(kind, &lattice, POINTS, &SetSettings::default()).expect("it is possible");
    let points = PointSet::new(spec, lattice).expect("it is possible");
    // About a thousand points a brick.
    let edge = (SAMPLES as f64 * (1024.0 / points.len() as f64).cbrt()).round() as u64;
    let bricks = BrickGrid::new(lattice, [edge; 3]);
    let (mut positions, mut sites): (Vec<LatticePos>, _) = (vec![], vec![]);
    for brick in 0..bricks.len() {
        points.sites_in(&bricks.brick(BrickId(brick)), &mut sites);
        positions.extend(sites.iter().map(|s| s.pos));
    }
    let mut mesher = Mesher::new();
    mesher.delaunay(&positions, &Order::for_count(points.len())).expect("the points are on the lattice");
    let mut tets = vec![];
    mesher.for_each_tet(|t| tets.push(t));
    // As a chunk's mesh has them: the least vertex first in each, ascending by it.
    tets.iter_mut().for_each(|t| {
        let least = (0..4).min_by_key(|&i| t[i]).expect("four corners");
        *t = [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]][least].map(|i| t[i]);
    });
    tets.sort_unstable();
    (positions, tets)
}

fn tetrahedra(c: &mut Criterion) {
    let mut group = c.benchmark_group("archive");
    group.sample_size(10).measurement_time(Duration::from_secs(2)).warm_up_time(Duration::from_millis(500));
    let sets = [SetKind::Hammersley, SetKind::Halton, SetKind::HyperbolicCross, SetKind::Regular];
    for kind in sets {
        let (name, (positions, tets)) = (kind.name(), mesh(kind));
        let (n, halo, mut encoder) = (positions.len(), vec![], ChunkEncoder::default());
        let vertices = ChunkVertices { core_counts: vec![n as u32], halo, shared: vec![false; n] };
        group.throughput(Throughput::Elements(tets.len() as u64));
        group.bench_function(format!("encode/{name}"), |b| {
            b.iter(|| {
                let mut tets = black_box(&tets).clone();
                encoder.encode(&vertices, &positions, &mut tets, BLOCK_TETS).tet_blocks()
            });
        });
        let encoded = encoder.encode(&vertices, &positions, &mut tets.clone(), BLOCK_TETS);
        let blocks = encoded.blocks_of_tets();
        let bytes: usize = blocks.iter().map(Vec::len).sum();
        eprintln!("    {name}: {:.2} bits a tetrahedron", bytes as f64 * 8.0 / tets.len() as f64);
        let (mut out, mut scratch, mut here) = (vec![], TetScratch::default(), vec![]);
        group.bench_function(format!("decode/{name}"), |b| {
            b.iter(|| {
                out.clear();
                for (block, head) in blocks.iter().zip(&encoded.heads) {
                    let block = TetBlock::open(black_box(block), head, vertices.len());
                    let block = block.expect("the block was just made");
                    here.clear();
                    here.extend(block.vertices().iter().map(|&v| positions[v as usize]));
                    block.decode(&here, &mut scratch, &mut out).expect("the block was just made");
                }
                out.len()
            });
        });
    }
    group.finish();
}

/// A smooth field along a curve, with noise in the last bits as interpolation leaves it.
fn values(c: &mut Criterion) {
    let values: Vec<f32> = (0..POINTS as u32)
        .map(|i| (i as f32 * 0.01).sin() + (i.wrapping_mul(2_654_435_761) >> 20) as f32 * 1e-6)
        .collect();
    let mut group = c.benchmark_group("values");
    group.sample_size(10).throughput(Throughput::Elements(POINTS));
    let of = ValueBlocks::new(values.len());
    group.bench_function("encode", |b| b.iter(|| encode_values(black_box(&values), &of, None, None).len()));
    let blocks = encode_values(&values, &of, None, None);
    let mut out = vec![];
    group.bench_function("decode", |b| {
        b.iter(|| {
            out.clear();
            for (block, part) in blocks.iter().zip(values.chunks(BLOCK_VALUES)) {
                let known = KnownOfBlock { n: part.len(), ..KnownOfBlock::default() };
                decode_values(black_box(block), &known, &mut out).expect("the block was just made");
            }
            out.len()
        });
    });
    group.finish();
}

criterion_group!(benches, tetrahedra, values);
criterion_main!(benches);
