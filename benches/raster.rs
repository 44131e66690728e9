//! Scan conversion, in samples a second: `cargo bench --package isospan-benches --bench raster`;
//! names are `raster/SAMPLES A POINT`, `scan/…` and `fit/…`.
//!
//! Every sample of a volume of 128³ is visited once, with its weights: the tetrahedra of a chunk
//! one by one (`raster`), or many together (`scan`). Values are also fitted to the samples:
//! tetrahedra are sorted into windows, and the contributions of the samples are added up (`fit`).

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use isospan::exec::Room;
use isospan::fit::{Fit, FitMesh, Windows, window_edge};
use isospan::geom::curve::Order;
use isospan::geom::{Lattice, LatticePos};
use isospan::grid::IndexBox;
use isospan::mesh::chunk::{ChunkOutcome, ChunkRegion, mesh_chunk};
use isospan::mesh::mesher::Mesher;
use isospan::mesh::tet::Tet;
use isospan::points::{PointSet, PointSpec};
use isospan::raster::{BatchScan, SampleGrid, Scanner};
use std::convert::Infallible;

fn mesh(lattice: Lattice, n: u64) -> (Vec<LatticePos>, Vec<Tet>) {
    let set = PointSet::new(PointSpec::Hammersley { n, shift: 0.5 }, lattice).expect("a set");
    let mut sites = vec![];
    set.sites_in(&lattice.domain(), &mut sites);
    let positions: Vec<LatticePos> = sites.iter().map(|s| s.pos).collect();
    let whole = lattice.domain();
    let region = ChunkRegion { core: whole, near: whole, region: whole, domain: whole };
    let order = Order::for_count(n);
    match mesh_chunk(&mut Mesher::new(), &region, &positions, &order).expect("a mesh") {
        ChunkOutcome::Done(mesh) => (positions, mesh.tets.to_vec()),
        ChunkOutcome::WidenHalo { .. } => unreachable!("nothing is unseen"),
    }
}

fn bench(c: &mut Criterion) {
    let lattice = Lattice::new([128; 3]).expect("a volume with cells");
    let (grid, whole) = (SampleGrid::voxels(&lattice), IndexBox::whole(lattice.dims));
    let scanner = Scanner::new(&grid, &whole);
    let mut group = c.benchmark_group("raster");
    group.throughput(Throughput::Elements(whole.len() as u64)).sample_size(10);
    for share in [1, 8, 16, 64, 512] {
        let (positions, tets) = mesh(lattice, whole.len() as u64 / share);
        let tets: Vec<[LatticePos; 4]> = tets.iter().map(|t| t.map(|v| positions[v as usize])).collect();
        group.bench_function(BenchmarkId::from_parameter(share), |b| {
            b.iter(|| {
                let (mut count, mut sum) = (0, 0.0);
                for &tet in &tets {
                    scanner.each_run(tet, |_, weights| {
                        count += weights.len();
                        weights.iter().for_each(|w| sum += w[0] - w[1] + w[2] * w[3]);
                    });
                }
                assert_eq!(count, whole.len());
                sum
            });
        });
    }
    group.finish();
    let mut group = c.benchmark_group("scan");
    group.throughput(Throughput::Elements(whole.len() as u64)).sample_size(10);
    for share in [8, 16, 64] {
        let (positions, tets) = mesh(lattice, whole.len() as u64 / share);
        let mut batch = BatchScan::default();
        group.bench_function(BenchmarkId::from_parameter(share), |b| {
            b.iter(|| {
                let (mut count, mut sum) = (0, 0.0);
                batch.each_member(&scanner, &positions, &tets, |members| {
                    count += members.places().len();
                    let [a, b, c, d] = members.weights();
                    for (((a, b), c), d) in a.iter().zip(b).zip(c).zip(d) {
                        sum += a - b + c * d;
                    }
                });
                assert_eq!(count, whole.len());
                sum
            });
        });
    }
    group.finish();
    let mut group = c.benchmark_group("fit");
    group.throughput(Throughput::Elements(whole.len() as u64)).sample_size(10);
    for share in [8, 16, 64] {
        let (positions, tets) = mesh(lattice, whole.len() as u64 / share);
        let values: Vec<f32> = (0..positions.len()).map(|i| i as f32).collect();
        let mesh = FitMesh { positions: &positions, tets: &tets };
        let mut memory = vec![0; 4 * tets.len()];
        group.bench_function(BenchmarkId::from_parameter(share), |b| {
            b.iter(|| {
                let room = &mut Room::new(&mut memory);
                let mut fit = Fit::new(mesh, &[&values], room);
                let edge = window_edge([16.0; 3]);
                for (window, tets) in Windows::new(&grid, edge, &positions, &tets, room).iter() {
                    let read = |_, _, out: &mut [f32]| {
                        out.fill(1.0);
                        Ok::<(), Infallible>(())
                    };
                    fit.add(&grid, &window, tets, read).expect("nothing fails");
                }
                fit.values(positions.len())
            });
        });
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
