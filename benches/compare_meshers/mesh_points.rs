//! Our part of `compare.py`: makes points, and meshes the points of a file.
//!
//! * `mesh_points points SET COUNT FILE`: writes points of the unit cube as little-endian f64 triples.
//! * `mesh_points kernel FILE REPEAT`: rounds them to the lattice and meshes them as one, in memory that is reused.
//! * `mesh_points stage FILE REPEAT THREADS CHUNK`: adds samples of the cube's boundary, as a reduction has them, cuts the
//!   cube into chunks of at most CHUNK points, and meshes those, halos and certification included.
//!
//! Prints a line a repetition: points, tetrahedra, wall seconds, CPU seconds (of all threads).

use isospan::geom::curve::Order;
use isospan::geom::{Lattice, LatticeBox, LatticePos, PointClass};
use isospan::mesh::chunk::{ChunkOutcome, ChunkRegion, mesh_chunk};
use isospan::mesh::delaunay::Mesher;
use isospan::points::{PointSet, PointSpec, SetKind, SetSettings};
use std::collections::BTreeSet;
use std::error::Error;
use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

const SIDE: u32 = Lattice::LARGEST;
const USAGE: &str = "points SET COUNT FILE | kernel FILE REPEAT | stage FILE REPEAT THREADS CHUNK";

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    match args[..] {
        ["points", set, count, file] => write_points(file, &points(set, count.parse()?)?),
        ["kernel", file, repeat] => kernel(&read_points(file)?, repeat.parse()?),
        ["stage", file, repeat, threads, chunk] => {
            stage(read_points(file)?, repeat.parse()?, threads.parse()?, chunk.parse()?)
        }
        _ => Err(USAGE.into()),
    }
}

fn points(set: &str, count: u64) -> Result<Vec<LatticePos>, Box<dyn Error>> {
    let kind = match set {
        "uniform" => return Ok(uniform(count)),
        "hammersley" => SetKind::Hammersley,
        "halton" => SetKind::Halton,
        "cross" => SetKind::HyperbolicCross,
        "regular" => SetKind::Regular,
        "bcc" => SetKind::Bcc,
        _ => return Err(format!("no set {set}").into()),
    };
    let lattice = Lattice::new([1025; 3])?;
    let spec = PointSpec::with_count(kind, &lattice, count, &SetSettings::default())?;
    let mut sites = vec![];
    PointSet::new(spec, lattice)?.sites_in(&lattice.domain(), &mut sites);
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

/// Halos of a chunk at most, each twice as wide as the one before; the last holds all points.
const TRIES: usize = 26;

/// A chunk's core, and its boxes and points at each try, made when they are first asked for: in the run before those that are measured.
struct Chunk {
    core: LatticeBox,
    tries: [OnceLock<Input>; TRIES],
}

/// A chunk's boxes and points.
struct Input {
    boxes: ChunkRegion,
    positions: Vec<LatticePos>,
}

fn stage(points: Vec<LatticePos>, repeat: usize, threads: usize, chunk: usize) -> Result<(), Box<dyn Error>> {
    let spacing = (f64::from(SIDE) / (points.len() as f64).cbrt()) as u32;
    let on_faces = boundary(points.len() as u64)?;
    let all: BTreeSet<LatticePos> = points.into_iter().chain(on_faces).collect();
    let all: Vec<LatticePos> = all.into_iter().collect();
    let order = Order::for_count(all.len() as u64);
    let domain = LatticeBox { lo: [0; 3], hi: [SIDE + 1; 3] };
    let mut cores = vec![];
    cut(all.clone(), domain, chunk.max(1), &mut cores);
    let chunks: Vec<Chunk> =
        cores.iter().map(|&core| Chunk { core, tries: [const { OnceLock::new() }; TRIES] }).collect();
    let mesh = |mesher: &mut Mesher, chunk: &Chunk| -> Result<usize, isospan::Error> {
        for (widened, input) in (0..).zip(&chunk.tries) {
            let input = input.get_or_init(|| halo(&all, chunk.core, domain, spacing, widened));
            match mesh_chunk(mesher, &input.boxes, &input.positions, &order)? {
                ChunkOutcome::Done(mesh) => {
                    let tets = mesh.tets.len();
                    mesher.reuse(mesh.tets);
                    return Ok(tets);
                }
                // As a reduction does.
                ChunkOutcome::WidenHalo { .. } => {}
            }
        }
        unreachable!("a region that is the whole domain certifies everything")
    };
    let mut meshers: Vec<Mesher> = (0..threads).map(|_| Mesher::new()).collect();
    report(repeat, all.len(), || {
        let (next, total) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for mesher in &mut meshers {
                scope.spawn(|| {
                    while let Some(chunk) = chunks.get(next.fetch_add(1, Ordering::Relaxed)) {
                        let tets = mesh(mesher, chunk).expect("the points are on the lattice");
                        total.fetch_add(tets, Ordering::Relaxed);
                    }
                });
            }
        });
        Ok(total.into_inner())
    })
}

/// The samples of the boundary that a reduction to `count` points has.
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

/// Halves the box across its longest edge until each part has at most `most` points.
fn cut(points: Vec<LatticePos>, part: LatticeBox, most: usize, cores: &mut Vec<LatticeBox>) {
    let axis = (0..3).max_by_key(|&a| part.hi[a] - part.lo[a]).expect("there are three axes");
    let mut along: Vec<u32> = points.iter().map(|p| p[axis]).collect();
    let middle = along.len() / 2;
    if points.len() <= most || part.hi[axis] - part.lo[axis] < 2 {
        return cores.push(part);
    }
    let at = (*along.select_nth_unstable(middle).1).clamp(part.lo[axis] + 1, part.hi[axis] - 1);
    let (below, above): (Vec<_>, Vec<_>) = points.into_iter().partition(|p| p[axis] < at);
    let (mut low, mut high) = (part, part);
    (low.hi[axis], high.lo[axis]) = (at, at);
    cut(below, low, most, cores);
    cut(above, high, most, cores);
}

/// The halo of a chunk, widened so many times.
fn halo(all: &[LatticePos], core: LatticeBox, domain: LatticeBox, spacing: u32, widened: u32) -> Input {
    let width = |quarters: u32| (u64::from(spacing / 4 * quarters) << widened).min(u64::from(SIDE)) as u32;
    let near = core.grow_within([width(quarters("NEAR", 6)); 3], &domain);
    let region = core.grow_within([width(quarters("FAR", 16)); 3], &domain);
    let mut positions: Vec<LatticePos> = all.iter().copied().filter(|p| region.contains(*p)).collect();
    positions.sort_by_key(|p| !near.contains(*p));
    Input { boxes: ChunkRegion { core, near, region, domain }, positions }
}

/// A width in quarters of the spacing, to try others.
fn quarters(name: &str, usual: u32) -> u32 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(usual)
}
