//! Coding and decoding of a chunk's tetrahedra, in tetrahedra a second, and of values, in values a second.
//!
//! `cargo bench --bench archive`; names are `encode/SET`, `decode/SET`, `values/encode` and `values/decode`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isospan::archive::chunk::{ChunkVertices, decode_tets, encode_chunk};
use isospan::archive::values::{BLOCK_VALUES, decode_values, encode_values};
use isospan::geom::LatticePos;
use isospan::geom::curve::Order;
use isospan::mesh::delaunay::Mesher;
use isospan::mesh::tet::Tet;
use std::hint::black_box;
use std::time::Duration;

const POINTS: u64 = 62_500;
const BLOCK_TETS: u32 = 1024;

fn radical_inverse(base: u64, mut k: u64) -> u32 {
    let (mut digits, mut scale) = (0u64, 1u64);
    while k > 0 {
        (digits, scale, k) = (digits * base + k % base, scale * base, k / base);
    }
    ((u128::from(digits) << 24) / u128::from(scale)) as u32
}

fn hammersley() -> Vec<LatticePos> {
    let x = |k: u64| (((2 * k + 1) << 23) / POINTS) as u32;
    (0..POINTS).map(|k| [x(k), radical_inverse(2, k), radical_inverse(3, k)]).collect()
}

fn body_centred() -> Vec<LatticePos> {
    let corner = |i: u32| [i % 31, i / 31 % 31, i / 961].map(|c| c << 19);
    (0..31 * 31 * 31).flat_map(|i| [corner(i), corner(i).map(|c| c + (1 << 18))]).collect()
}

/// The points in the order of a chunk's vertices, and their tetrahedra.
fn mesh(mut positions: Vec<LatticePos>) -> (ChunkVertices, Vec<Tet>) {
    let order = Order::for_count(positions.len() as u64);
    positions.sort_by_cached_key(|&p| order.key(p));
    let mut mesher = Mesher::new();
    mesher.delaunay(&positions, &order).expect("the points are on the lattice");
    let mut tets = vec![];
    mesher.for_each_tet(|t| tets.push(t));
    let n = positions.len();
    (ChunkVertices { core_counts: vec![n as u32], halo: vec![], shared: vec![false; n] }, tets)
}

fn tetrahedra(c: &mut Criterion) {
    let mut group = c.benchmark_group("archive");
    group.sample_size(10).measurement_time(Duration::from_secs(2)).warm_up_time(Duration::from_millis(500));
    for (name, positions) in [("hammersley", hammersley()), ("bcc", body_centred())] {
        let (vertices, tets) = mesh(positions);
        group.throughput(Throughput::Elements(tets.len() as u64));
        group.bench_function(format!("encode/{name}"), |b| {
            b.iter(|| encode_chunk(&vertices, black_box(&tets), BLOCK_TETS).tet_blocks());
        });
        let blocks = encode_chunk(&vertices, &tets, BLOCK_TETS).blocks;
        let bytes: usize = blocks[1..].iter().map(Vec::len).sum();
        eprintln!("    {name}: {:.2} bits a tetrahedron", bytes as f64 * 8.0 / tets.len() as f64);
        let mut out = vec![];
        group.bench_function(format!("decode/{name}"), |b| {
            b.iter(|| {
                out.clear();
                for block in &blocks[1..] {
                    decode_tets(black_box(block), vertices.len(), &mut out).expect("the block was just made");
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
    group.bench_function("encode", |b| b.iter(|| encode_values(black_box(&values)).len()));
    let blocks = encode_values(&values);
    let mut out = vec![];
    group.bench_function("decode", |b| {
        b.iter(|| {
            out.clear();
            for (block, part) in blocks.iter().zip(values.chunks(BLOCK_VALUES)) {
                decode_values(black_box(block), part.len(), &mut out).expect("the block was just made");
            }
            out.len()
        });
    });
    group.finish();
}

criterion_group!(benches, tetrahedra, values);
criterion_main!(benches);
