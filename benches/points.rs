//! Points found a second: `points/STAGE/SET/N/BOX`, over a diagonal of boxes of about `BOX` points
//! of a set of N. `candidates` is the enumeration with rounding, `sites` the whole with sort and
//! duplicates removed.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isospan::geom::{Lattice, LatticeBox, Site};
use isospan::points::{PointSet, PointSpec, SetKind, SetSettings};
use std::hint::black_box;
use std::time::Duration;

/// Boxes of about `points` interior points, edge to edge along the diagonal of the domain.
fn diagonal(set: &PointSet, points: f64) -> Vec<LatticeBox> {
    let max = set.lattice().max()[0];
    let edge = (points / set.interior_len() as f64).cbrt();
    let parts = (1.0 / edge).max(1.0) as u32;
    let at = |i: u32| (u64::from(max) * u64::from(i) / u64::from(parts)) as u32;
    let step = parts.div_ceil(20) as usize;
    (0..parts).step_by(step).map(|i| LatticeBox { lo: [at(i); 3], hi: [at(i + 1); 3] }).collect()
}

fn bench(c: &mut Criterion) {
    let lattice = Lattice::new([1025; 3]).expect("a small cube is a lattice");
    let cases = [
        (SetKind::Hammersley, 1_000_000, 1000.0),
        (SetKind::Hammersley, 1_000_000, 4000.0),
        (SetKind::Hammersley, 1_000_000, 250_000.0),
        (SetKind::Hammersley, 100_000_000, 1000.0),
        (SetKind::Halton, 1_000_000, 500.0),
        (SetKind::Halton, 1_000_000, 1000.0),
        (SetKind::Halton, 1_000_000, 4000.0),
        (SetKind::Halton, 1_000_000, 250_000.0),
        (SetKind::Halton, 100_000_000, 1000.0),
        (SetKind::Halton, 1_000_000_000_000, 1000.0),
        (SetKind::HyperbolicCross, 1_000_000, 1000.0),
        (SetKind::Regular, 1_000_000, 1000.0),
    ];
    for (kind, n, points) in cases {
        let lattice = if n > 1 << 30 { Lattice::new([10_000; 3]).expect("as above") } else { lattice };
        let spec = PointSpec::with_count(kind, &lattice, n, &SetSettings::default()).expect("a good count");
        let set = PointSet::new(spec, lattice).expect("a good set");
        let boxes = diagonal(&set, points);
        type Find = fn(&PointSet, &LatticeBox, &mut Vec<Site>);
        for (stage, find) in
            [("candidates", PointSet::candidates_in as Find), ("sites", PointSet::sites_in as Find)]
        {
            let mut out = vec![];
            let mut run = || {
                boxes.iter().fold(0, |sum, b| {
                    find(&set, black_box(b), &mut out);
                    sum + out.len() as u64
                })
            };
            let mut group = c.benchmark_group("points");
            group.throughput(Throughput::Elements(run()));
            group
                .sample_size(10)
                .warm_up_time(Duration::from_millis(300))
                .measurement_time(Duration::from_secs(1));
            group.bench_function(format!("{stage}/{kind}/{n}/{points}"), |b| b.iter(&mut run));
            group.finish();
        }
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
