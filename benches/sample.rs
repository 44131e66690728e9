//! Points sampled a second by one thread: `cargo bench --package isospan-benches --bench sample`.
//!
//! Positions are those of a brick's points in Z order of small boxes, as the pipeline asks for
//! them.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isospan::geom::{Lattice, LatticePos};
use isospan::grid::IndexBox;
use isospan::sample::{Interpolation, VoxelBlock, sample};
use std::hint::black_box;

/// Points of the plastic-number sequence, an integer recurrence, sorted by boxes of 4³ voxels.
fn points(lattice: &Lattice, count: usize) -> Vec<LatticePos> {
    const STEPS: [u64; 3] = [0xD1B5_4A32_D192_ED03, 0xABC9_8388_FB8F_AC03, 0x8CB9_2BA7_2F3D_8DD7];
    let max = lattice.max();
    let mut points: Vec<LatticePos> = (1..=count as u64)
        .map(|k| {
            std::array::from_fn(|a| {
                ((u128::from(k.wrapping_mul(STEPS[a])) * u128::from(max[a])) >> 64) as u32
            })
        })
        .collect();
    let shift = lattice.log2_steps[0] + 2;
    points.sort_by_key(|p| (p[2] >> shift, p[1] >> shift, p[0] >> shift, *p));
    points
}

fn bench(c: &mut Criterion) {
    let lattice = Lattice::new([128; 3]).expect("a volume with cells");
    let values: Vec<f32> =
        (0..128u32 * 128 * 128).map(|i| (i.wrapping_mul(2_654_435_761) >> 8) as f32).collect();
    let block = VoxelBlock { voxels: IndexBox::whole(lattice.dims), values: &values };
    let points = points(&lattice, 260_000);
    let mut group = c.benchmark_group("sample");
    group.throughput(Throughput::Elements(points.len() as u64)).sample_size(20);
    for how in Interpolation::ALL {
        let mut out = Vec::with_capacity(points.len());
        group.bench_function(format!("{how}/260k"), |b| {
            b.iter(|| {
                out.clear();
                sample(how, &lattice, &block, black_box(&points), &mut out);
            });
        });
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
