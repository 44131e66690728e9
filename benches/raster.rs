//! Scan conversion, in samples a second: `cargo bench --bench raster`; names are `raster/SAMPLES A POINT`.
//!
//! Every sample of a volume of 128³ is visited once, in the order of the tetrahedra of a chunk.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use isospan::geom::curve::Order;
use isospan::geom::{Lattice, LatticePos};
use isospan::grid::IndexBox;
use isospan::mesh::chunk::{ChunkOutcome, ChunkRegion, mesh_chunk};
use isospan::mesh::delaunay::Mesher;
use isospan::points::{PointSet, PointSpec};
use isospan::raster::{SampleGrid, Scanner};

fn tetrahedra(lattice: Lattice, n: u64) -> Vec<[LatticePos; 4]> {
    let set = PointSet::new(PointSpec::Hammersley { n, shift: 0.5 }, lattice).expect("a set");
    let mut sites = vec![];
    set.sites_in(&lattice.domain(), &mut sites);
    let positions: Vec<LatticePos> = sites.iter().map(|s| s.pos).collect();
    let whole = lattice.domain();
    let region = ChunkRegion { core: whole, near: whole, region: whole, domain: whole };
    let order = Order::for_count(n);
    match mesh_chunk(&mut Mesher::new(), &region, &positions, &order).expect("a mesh") {
        ChunkOutcome::Done(mesh) => mesh.tets.iter().map(|t| t.map(|v| positions[v as usize])).collect(),
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
        let tets = tetrahedra(lattice, whole.len() as u64 / share);
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
}

criterion_group!(benches, bench);
criterion_main!(benches);
