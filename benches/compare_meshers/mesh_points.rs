//! Our part of `compare.py`: makes points, and meshes the points of a file.
//!
//! * `mesh_points points SET COUNT FILE`: writes points of the unit cube as little-endian f64
//!   triples.
//! * `mesh_points kernel FILE REPEAT`: rounds them to the lattice and meshes them as one, in memory
//!   that is reused.
//! * `mesh_points stage SET COUNT REPEAT THREADS CHUNK`: makes points with the samples of the
//!   cube's boundary that a reduction adds to them, cuts the cube into chunks of about CHUNK points
//!   as a reduction to 1/8 of the samples does, and meshes those, halos and certification included,
//!   evenly spread ones star by star.
//!
//! Prints a line a repetition: points, tetrahedra, wall seconds, CPU seconds (of all threads).

use isospan::geom::curve::{Order, hilbert_key};
use isospan::geom::{Lattice, LatticeBox, LatticePos, PointClass};
use isospan::grid::{BrickGrid, ChunkGrid};
use isospan::mesh::chunk::{ChunkOutcome, ChunkRegion, Manner, mesh_widening};
use isospan::mesh::mesher::Mesher;
use isospan::points::{PointSet, PointSpec, SetKind, SetSettings};
use std::collections::BTreeSet;
use std::error::Error;
use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

const SIDE: u32 = Lattice::LARGEST;
const USAGE: &str = "points SET COUNT FILE | kernel FILE REPEAT | stage SET COUNT REPEAT THREADS CHUNK";

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    match args[..] {
        ["points", set, count, file] => write_points(file, &interior(set, count.parse()?)?),
        ["kernel", file, repeat] => kernel(&read_points(file)?, repeat.parse()?),
        ["stage", set, count, repeat, threads, chunk] => {
            stage(&Whole::new(set, count.parse()?)?, repeat.parse()?, threads.parse()?, chunk.parse()?)
        }
        _ => Err(USAGE.into()),
    }
}

/// A set of about so many points; `None` of independent ones, which are no set.
fn point_set(set: &str, count: u64) -> Result<Option<PointSet>, Box<dyn Error>> {
    let kind = match set {
        "uniform" => return Ok(None),
        "hammersley" => SetKind::Hammersley,
        "halton" => SetKind::Halton,
        "cross" => SetKind::HyperbolicCross,
        "regular" => SetKind::Regular,
        _ => return Err(format!("no set {set}").into()),
    };
    let lattice = Lattice::new([1025; 3])?;
    let spec = PointSpec::with_count(kind, &lattice, count, &SetSettings::default())?;
    Ok(Some(PointSet::new(spec, lattice)?))
}

fn interior(set: &str, count: u64) -> Result<Vec<LatticePos>, Box<dyn Error>> {
    let Some(set) = point_set(set, count)? else { return Ok(uniform(count)) };
    let mut sites = vec![];
    set.sites_in(&set.lattice().domain(), &mut sites);
    Ok(sites.iter().filter(|s| s.id.class() == Some(PointClass::Interior)).map(|s| s.pos).collect())
}

fn uniform(count: u64) -> Vec<LatticePos> {
    let mut state = 1u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as u32
    };
    (0..count).map(|_| [next(), next(), next()]).collect()
}

fn write_points(file: &str, points: &[LatticePos]) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::BufWriter::new(std::fs::File::create(file)?);
    for c in points.iter().flatten() {
        out.write_all(&(f64::from(*c) / f64::from(SIDE)).to_le_bytes())?;
    }
    Ok(out.flush()?)
}

fn read_points(file: &str) -> Result<Vec<LatticePos>, Box<dyn Error>> {
    let bytes = std::fs::read(file)?;
    let number = |b: &[u8]| f64::from_le_bytes(b.try_into().expect("eight bytes"));
    let point =
        |b: &[u8]| std::array::from_fn(|k| (number(&b[8 * k..8 * k + 8]) * f64::from(SIDE)).round() as u32);
    Ok(bytes.chunks_exact(24).map(point).collect())
}

/// CPU seconds of this process so far, its threads included; 0 where the system does not say.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    // User and system time, in the 1/100 s of every Linux.
    after_name.split_whitespace().skip(11).take(2).filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / 100.0
}

fn report(
    repeat: usize,
    points: usize,
    mut run: impl FnMut() -> Result<usize, isospan::Error>,
) -> Result<(), Box<dyn Error>> {
    // Once before, so that the memory is there.
    run()?;
    for _ in 0..repeat {
        let (start, cpu) = (Instant::now(), cpu_seconds());
        let tets = run()?;
        let wall = start.elapsed().as_secs_f64();
        writeln!(std::io::stdout(), "{points} {tets} {wall:.4} {:.2}", cpu_seconds() - cpu)?;
    }
    Ok(())
}

fn kernel(points: &[LatticePos], repeat: usize) -> Result<(), Box<dyn Error>> {
    let order = Order::for_count(points.len() as u64);
    let mut mesher = Mesher::new();
    report(repeat, points.len(), || {
        mesher.delaunay(points, &order)?;
        let mut tets = 0;
        mesher.for_each_tet(|_| tets += 1);
        Ok(tets)
    })
}

/// Points, those of the boundary too, each place once.
struct Whole {
    points: Vec<LatticePos>,
    /// The mean distance of neighbours.
    spacing: u32,
    even: bool,
}

impl Whole {
    fn new(set: &str, count: u64) -> Result<Self, Box<dyn Error>> {
        let (points, spacing, even) = match point_set(set, count)? {
            Some(set) => {
                let (domain, mut sites) = (set.lattice().domain(), vec![]);
                set.sites_in(&domain, &mut sites);
                let points: BTreeSet<LatticePos> = sites.iter().map(|s| s.pos).collect();
                (points, set.spacing_around(&domain)[0][0], set.is_even())
            }
            None => {
                let spacing = (f64::from(SIDE) / (count as f64).cbrt()) as u32;
                (uniform(count).into_iter().chain(boundary(count)?).collect(), spacing, false)
            }
        };
        Ok(Self { points: points.into_iter().collect(), spacing, even })
    }
}

/// A worker, and its list of positions.
type Desk = (Mesher, Vec<LatticePos>);

/// Halos of a chunk at most, each twice as wide as the one before; the last holds all points.
const WIDTHS: usize = 26;

/// A chunk's core; its boxes and points, and those of each wider halo, made when they are first
/// asked for: in the run before those that are measured.
struct Chunk {
    core: LatticeBox,
    first: OnceLock<(ChunkRegion, Vec<LatticePos>)>,
    wider: [OnceLock<(LatticeBox, Vec<LatticePos>)>; WIDTHS],
}

fn stage(whole: &Whole, repeat: usize, threads: usize, chunk: u64) -> Result<(), Box<dyn Error>> {
    let &Whole { points: ref all, spacing, even } = whole;
    let order = Order::for_count(all.len() as u64);
    let domain = LatticeBox { lo: [0; 3], hi: [SIDE + 1; 3] };
    let cores = cores(all, chunk)?;
    let no_more = [const { OnceLock::new() }; WIDTHS];
    let chunks = cores.into_iter().map(|core| Chunk { core, first: OnceLock::new(), wider: no_more.clone() });
    let chunks: Vec<Chunk> = chunks.collect();
    let mesh = |(mesher, positions): &mut Desk, chunk: &Chunk| -> Result<usize, isospan::Error> {
        let (boxes, first) = chunk.first.get_or_init(|| halo(all, chunk.core, domain, spacing));
        positions.clear();
        positions.extend_from_slice(first);
        let mut wider = (1..).zip(&chunk.wider);
        let mut widen = |positions: &mut Vec<LatticePos>| {
            let (widened, points) =
                wider.next().expect("a region that is the whole domain certifies everything");
            let (region, more) = points.get_or_init(|| widened_halo(all, boxes, spacing, widened));
            positions.extend_from_slice(more);
            Ok(Some(*region))
        };
        match mesh_widening(mesher, boxes, positions, &order, Manner { around: false, even }, &mut widen)? {
            ChunkOutcome::Done(mesh) => {
                let tets = mesh.tets.len();
                mesher.reuse(mesh.tets);
                Ok(tets)
            }
            ChunkOutcome::WidenHalo { .. } => unreachable!("there is always a wider halo"),
        }
    };
    let mut desks: Vec<Desk> = (0..threads).map(|_| (Mesher::new(), vec![])).collect();
    report(repeat, all.len(), || {
        let (next, total) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for desk in &mut desks {
                scope.spawn(|| {
                    while let Some(chunk) = chunks.get(next.fetch_add(1, Ordering::Relaxed)) {
                        let tets = mesh(desk, chunk).expect("the points are on the lattice");
                        total.fetch_add(tets, Ordering::Relaxed);
                    }
                });
            }
        });
        Ok(total.into_inner())
    })
}

/// The samples of the boundary that a reduction to `count` evenly spread points has.
fn boundary(count: u64) -> Result<Vec<LatticePos>, Box<dyn Error>> {
    let lattice = Lattice::new([1025; 3])?;
    let set = PointSet::new(PointSpec::Hammersley { n: count, shift: 0.5 }, lattice)?;
    let mut all = vec![];
    for axis in 0..3 {
        let (mut low, mut high) = (lattice.domain(), lattice.domain());
        (low.hi[axis], high.lo[axis]) = (1, SIDE);
        for face in [low, high] {
            let mut sites = vec![];
            set.sites_in(&face, &mut sites);
            all.extend(sites.iter().filter(|s| s.id.class() != Some(PointClass::Interior)).map(|s| s.pos));
        }
    }
    Ok(all)
}

/// Chunks of about so many points, cut between bricks of about a thousand, as a reduction has them.
fn cores(all: &[LatticePos], chunk: u64) -> Result<Vec<LatticeBox>, Box<dyn Error>> {
    let lattice = Lattice::new([1025; 3])?;
    let edge = 1025.0 * (1024.0 / all.len() as f64).cbrt();
    let bricks = BrickGrid::new(lattice, [(edge.round() as u64).max(1); 3]);
    let mut counts = vec![0u64; usize::try_from(bricks.len())?];
    for &p in all {
        counts[bricks.id(bricks.brick_at(p)).0 as usize] += 1;
    }
    let count = move |b: &LatticeBox| {
        let (lo, hi) = (bricks.brick_at(b.lo), bricks.brick_at(b.hi.map(|c| c - 1)));
        let rows = (lo[2]..=hi[2]).flat_map(|z| (lo[1]..=hi[1]).map(move |y| (y, z)));
        let row = |(y, z)| &counts[bricks.id([lo[0], y, z]).0 as usize..=bricks.id([hi[0], y, z]).0 as usize];
        rows.flat_map(row).sum()
    };
    Ok(ChunkGrid::new(bricks, chunk, count)?.iter().map(|chunk| chunk.core).collect())
}

/// The halo of a chunk.
fn halo(
    all: &[LatticePos],
    core: LatticeBox,
    domain: LatticeBox,
    spacing: u32,
) -> (ChunkRegion, Vec<LatticePos>) {
    let near = core.grow_within([spacing / 4 * quarters("NEAR", 7); 3], &domain);
    let region = core.grow_within([far(spacing, 0); 3], &domain);
    let mut positions: Vec<LatticePos> = all.iter().copied().filter(|p| region.contains(*p)).collect();
    // Those of the core along a curve, as a reduction lists them.
    positions.sort_by_cached_key(|p| (!core.contains(*p), !near.contains(*p), hilbert_key(*p, 12)));
    (ChunkRegion { core, near, region, domain }, positions)
}

/// A halo that is twice as wide so many times, and what it has more than the one before.
fn widened_halo(
    all: &[LatticePos],
    boxes: &ChunkRegion,
    spacing: u32,
    widened: u32,
) -> (LatticeBox, Vec<LatticePos>) {
    let region = |widened| boxes.core.grow_within([far(spacing, widened); 3], &boxes.domain);
    let (before, region) = (region(widened - 1), region(widened));
    (region, all.iter().copied().filter(|p| region.contains(*p) && !before.contains(*p)).collect())
}

/// The width of the region, widened so many times.
fn far(spacing: u32, widened: u32) -> u32 {
    (u64::from(spacing / 4 * quarters("FAR", 12)) << widened).min(u64::from(SIDE)) as u32
}

/// A width in quarters of the spacing, to try others.
fn quarters(name: &str, usual: u32) -> u32 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(usual)
}
