//! A damaged archive gives an error or the right answer: never a panic, never a wrong surface
//! without an error.
//!
//! Damage by accident (a byte flipped, a file cut short or lost) is found by checksums. Damage on
//! purpose has good checksums: segments of other archives, and manifests that are sealed again
//! around absurd numbers. Those must end in an error too, soon, and without a huge allocation.

use crate::common::*;
use isospan::archive::manifest::{MANIFEST_NAME, Manifest, MeshPlan};
use isospan::archive::segment::SegmentKind;
use isospan::error::{ErrorKind, Fault};
use isospan::geom::Lattice;
use isospan::pipeline::Amount;
use isospan::points::{PointSpec, SetKind};
use isospan::{Archive, Error, Resources};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

const ISOVALUE: f32 = 0.11;

/// What an intact archive answers.
#[derive(Clone, PartialEq)]
struct Answers {
    surface: Vec<u8>,
    active: u64,
}

fn extract(archive: &Path) -> Result<Vec<u8>, Error> {
    let out = archive.with_extension("ply");
    let query = Archive::open(archive)?.keeping(0).query(ISOVALUE);
    let made = query.resources(Resources::default().with_threads(1)).write(&out);
    let bytes = fs::read(&out);
    let _ = fs::remove_file(&out);
    made.map(|_| bytes.expect("a surface was written"))
}

fn answers(archive: &Path) -> Answers {
    check_archive(archive).unwrap();
    let active = count_active(archive, ISOVALUE).unwrap().active_cells;
    Answers { surface: extract(archive).unwrap(), active }
}

/// An error of a damaged archive: one line, of the class "bad input" or, for lost files,
/// "incomplete".
fn orderly(what: &str, error: &Error) {
    let line = error.to_string();
    assert!(
        [3, 5].contains(&error.exit_code()) && !line.contains('\n'),
        "{what}: code {}: {line}",
        error.exit_code()
    );
}

/// `check` must find any damage; a query that does not meet it gives the right answer.
fn error_or_right(archive: &Path, right: &Answers, what: &str) {
    match check_archive(archive) {
        Ok(_) => panic!("{what}: not found by check"),
        Err(e) => orderly(what, &e),
    }
    match count_active(archive, ISOVALUE) {
        Ok(found) => assert_eq!(found.active_cells, right.active, "{what}"),
        Err(e) => orderly(what, &e),
    }
    match extract(archive) {
        Ok(found) => assert!(found == right.surface, "{what}: another surface"),
        Err(e) => orderly(what, &e),
    }
    if let Err(e) = summarize(archive) {
        orderly(what, &e);
    }
}

/// An archive of several chunks and about 20 kB.
fn small(dir: &Path, name: &str, seed: f64) -> PathBuf {
    let (out, chunks) = of_chunks(dir, name, seed, 200);
    assert!(chunks > 2, "several chunks");
    out
}

/// One of a single chunk: it has neither index nor spectrum.
fn single(dir: &Path) -> PathBuf {
    let (out, chunks) = of_chunks(dir, "single", 0.0, 100_000);
    assert_eq!(chunks, 1);
    assert!(Manifest::read(&out).unwrap().steps[0].index.is_none());
    out
}

fn of_chunks(dir: &Path, name: &str, seed: f64, chunk_points: u64) -> (PathBuf, u64) {
    let input = dir.join(format!("{name}.npy"));
    write_npy(&input, [30, 6, 5], |x, y, z| waves(x + seed, y, z));
    let out = dir.join(format!("{name}.isospan"));
    let settings = settings(SetKind::Hammersley, Amount::Fraction(1.0), chunk_points);
    let report = reduce(&input, &settings, &out, 1);
    (out, report.chunks)
}

fn copy(from: &Path, to: &Path) {
    for (file, bytes) in folder(from) {
        let to = to.join(file);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::write(to, bytes).unwrap();
    }
}

/// Replaces a file by another one; some file systems flush a file that is cut and written again.
fn put(path: &Path, bytes: &[u8]) {
    let _ = fs::remove_file(path);
    fs::write(path, bytes).unwrap();
}

/// Runs `job` for the numbers below `n`, on two threads that have a copy of the archive each.
fn share(archive: &Path, n: usize, job: impl Fn(&Path, usize) + Sync) {
    let next = AtomicUsize::new(0);
    std::thread::scope(|threads| {
        for _ in 0..2 {
            threads.spawn(|| {
                let dir = tempfile::tempdir().unwrap();
                let mine = dir.path().join("copy.isospan");
                copy(archive, &mine);
                loop {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    if i >= n {
                        break;
                    }
                    job(&mine, i);
                }
            });
        }
    });
}

/// The places of a file to damage: all near its ends and in a manifest, and of the middle every
/// seventh.
fn places(file: &Path, len: usize) -> impl Iterator<Item = usize> {
    let (all, near) = (file.ends_with(MANIFEST_NAME) || file.ends_with("000000-index.seg"), 300);
    (0..len).filter(move |&i| all || i < near || i + near >= len || i % 7 == 0)
}

#[test]
fn every_flipped_byte_is_found_or_harmless() {
    let dir = tempfile::tempdir().unwrap();
    flip_every_byte(&small(dir.path(), "a", 0.0));
    flip_every_byte(&single(dir.path()));
}

fn flip_every_byte(archive: &Path) {
    let right = answers(archive);
    let files: Vec<_> = folder(archive).into_iter().collect();
    let jobs: Vec<(usize, usize)> =
        (0..files.len()).flat_map(|f| places(&files[f].0, files[f].1.len()).map(move |i| (f, i))).collect();
    assert!(jobs.len() > 2_000, "{} places", jobs.len());
    share(archive, jobs.len(), |copy, job| {
        let (file, at) = jobs[job];
        let (name, good) = &files[file];
        let mut bad = good.clone();
        // Another bit each time; a manifest gets other digits.
        bad[at] ^= 1 << (at % 8);
        put(&copy.join(name), &bad);
        error_or_right(copy, &right, &format!("{} byte {at}", name.display()));
        put(&copy.join(name), good);
    });
}

#[test]
fn every_cut_is_found_or_harmless() {
    let dir = tempfile::tempdir().unwrap();
    let archive = small(dir.path(), "a", 0.0);
    let right = answers(&archive);
    let files: Vec<_> = folder(&archive).into_iter().collect();
    let jobs: Vec<(usize, usize)> = (0..files.len())
        .flat_map(|f| places(&files[f].0, files[f].1.len()).step_by(2).map(move |i| (f, i)))
        .collect();
    share(&archive, jobs.len(), |copy, job| {
        let (file, at) = jobs[job];
        let (name, good) = &files[file];
        put(&copy.join(name), &good[..at]);
        error_or_right(copy, &right, &format!("{} cut at {at}", name.display()));
        put(&copy.join(name), &[&good[..], b"\0more"].concat());
        error_or_right(copy, &right, &format!("{} with bytes behind", name.display()));
        put(&copy.join(name), good);
    });
}

/// A program can tell a damaged byte from a file that makes no sense.
#[test]
fn a_changed_block_is_an_error_of_its_checksum() {
    let dir = tempfile::tempdir().unwrap();
    let archive = small(dir.path(), "a", 0.0);
    let file = archive.join("steps/000000-values-000000.seg");
    let mut bytes = fs::read(&file).unwrap();
    bytes[100] ^= 1;
    put(&file, &bytes);
    let error = check_archive(&archive).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::BadInput(Fault::Checksum), "{error}");
    assert_eq!(error.path(), Some(&*file));
}

#[test]
fn lost_files_are_named_and_other_files_are_ignored() {
    let dir = tempfile::tempdir().unwrap();
    let archive = small(dir.path(), "a", 0.0);
    let right = answers(&archive);
    for (name, good) in folder(&archive) {
        let file = archive.join(&name);
        fs::remove_file(&file).unwrap();
        let short = name.file_name().unwrap().to_string_lossy().into_owned();
        let error = check_archive(&archive).unwrap_err();
        assert!(error.to_string().contains(&short), "{error}");
        assert_eq!(error.exit_code(), if name.ends_with(MANIFEST_NAME) { 5 } else { 3 }, "{error}");
        // A folder in its place.
        fs::create_dir(&file).unwrap();
        let error = check_archive(&archive).unwrap_err();
        assert!(!error.to_string().contains('\n') && [1, 5].contains(&error.exit_code()), "{error}");
        fs::remove_dir(&file).unwrap();
        put(&file, &good);
    }
    fs::write(archive.join("notes.txt"), "mine").unwrap();
    fs::write(archive.join("mesh/000099.seg"), "not a segment").unwrap();
    fs::write(archive.join("steps/000007-values-000000.seg"), "not a segment").unwrap();
    assert!(answers(&archive) == right);
}

/// Each file of one archive in the place of another's: of another volume, another point set,
/// another isovalue.
#[test]
fn files_of_other_archives_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let a = small(dir.path(), "a", 0.0);
    let right = answers(&a);
    let values = small(dir.path(), "values", 0.3);
    let input = dir.path().join("a.npy");
    let points = dir.path().join("points.isospan");
    reduce(&input, &settings(SetKind::Halton, Amount::Fraction(1.0), 200), &points, 1);
    let good = folder(&a);
    for other in [&values, &points] {
        for (name, bytes) in folder(other) {
            if good.get(&name) == Some(&bytes) {
                assert!(name.starts_with("mesh") && other == &values, "one mesh serves all fields");
                continue;
            }
            put(&a.join(&name), &bytes);
            if !name.ends_with(MANIFEST_NAME) || other == &points {
                error_or_right(&a, &right, &format!("{} of {}", name.display(), other.display()));
            } else {
                assert!(check_archive(&a).is_err(), "the manifest of another volume");
            }
            put(&a.join(&name), &good[&name]);
        }
    }
    assert!(answers(&a) == right);
}

/// Asks everything; only the time is promised, and that a refusal is orderly.
fn ask(archive: &Path, what: &str) -> bool {
    let start = Instant::now();
    let errors = [
        check_archive(archive).err(),
        count_active(archive, ISOVALUE).err(),
        extract(archive).err(),
        summarize(archive).err(),
    ];
    errors.iter().flatten().for_each(|e| orderly(what, e));
    let took = start.elapsed();
    assert!(took < Duration::from_secs(600), "{what}: {took:?}");
    errors[0].is_some()
}

type PlanEdit = Box<dyn Fn(&mut MeshPlan)>;

#[test]
fn absurd_manifests_with_good_checksums_are_refused_soon() {
    let dir = tempfile::tempdir().unwrap();
    let good = small(dir.path(), "a", 0.0);
    let huge = Lattice::new([16_777_217; 3]).unwrap();
    let long = |axis: usize| {
        let mut dims = [2; 3];
        dims[axis] = 16_777_217;
        Lattice::new(dims).unwrap()
    };
    let set = |points: PointSpec| move |p: &mut MeshPlan| p.points = points;
    let on = |lattice: Lattice| {
        move |p: &mut MeshPlan| (p.lattice, p.brick_edge, p.chunk_target) = (lattice, [1; 3], 1)
    };
    let plans: Vec<(&str, PlanEdit)> = vec![
        ("2^59 points", Box::new(set(PointSpec::Halton { n: 1 << 59 }))),
        ("no points", Box::new(set(PointSpec::Halton { n: 0 }))),
        ("too many points", Box::new(set(PointSpec::Hammersley { n: u64::MAX, shift: 0.5 }))),
        ("a shift of 7", Box::new(set(PointSpec::Hammersley { n: 500, shift: 7.0 }))),
        ("a cross of 2^40", Box::new(set(PointSpec::HyperbolicCross { m: 40, k: 5, r: [0; 3] }))),
        ("a cross of 2^99", Box::new(set(PointSpec::HyperbolicCross { m: 99, k: 5, r: [1; 3] }))),
        ("odd counts", Box::new(set(PointSpec::Regular { counts: [0, 1, u64::MAX] }))),
        ("a cube of 2^72 bricks", Box::new(on(huge))),
        ("2^24 bricks along x", Box::new(on(long(0)))),
        ("2^24 bricks along y", Box::new(on(long(1)))),
        ("2^24 bricks along z", Box::new(on(long(2)))),
        ("bricks of no voxel", Box::new(|p| p.brick_edge = [0; 3])),
        ("bricks of 2^64 voxels", Box::new(|p| p.brick_edge = [u64::MAX; 3])),
        ("chunks of no point", Box::new(|p| p.chunk_target = 0)),
        ("no order", Box::new(|p| p.order_bits = 0)),
        ("too much order", Box::new(|p| p.order_bits = u32::MAX)),
        ("blocks of nothing", Box::new(|p| p.block_tets = 0)),
        ("no samples", Box::new(|p| p.lattice.dims = [0; 3])),
        ("2^64 samples", Box::new(|p| p.lattice.dims = [u64::MAX; 3])),
        ("fine steps", Box::new(|p| p.lattice.log2_steps = [31; 3])),
        (
            "a stretched lattice",
            Box::new(|p| p.lattice = Lattice::stretched(p.lattice.dims, [0, 1, 0]).unwrap()),
        ),
        ("finer steps", Box::new(|p| p.lattice.log2_steps = [u32::MAX; 3])),
    ];
    for (what, edit) in &plans {
        for chunks in [None, Some(1), Some(1 << 40), Some(u64::MAX)] {
            let bad = dir.path().join("bad.isospan");
            copy(&good, &bad);
            reseal_all(
                &bad,
                |m| {
                    edit(&mut m.plan);
                    m.steps[0].plan.source.dims = m.plan.lattice.dims;
                    if let Some(chunks) = chunks {
                        m.counts.chunks = chunks;
                        (m.mesh[0].chunks, m.steps[0].values[0].chunks) = (chunks, chunks);
                    }
                },
                |_, _, _| {},
            );
            assert!(ask(&bad, what), "{what}, {chunks:?} chunks: not refused by check");
            fs::remove_dir_all(&bad).unwrap();
        }
    }
}

type ManifestEdit = Box<dyn Fn(&mut Manifest)>;

#[test]
fn manifests_that_contradict_themselves_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let good = small(dir.path(), "a", 0.0);
    let edits: Vec<(&str, ManifestEdit)> = vec![
        ("no steps", Box::new(|m| m.steps.clear())),
        ("no segments", Box::new(|m| m.mesh.clear())),
        ("a segment too many", Box::new(|m| m.mesh.push(m.mesh[0].clone()))),
        (
            "an empty segment",
            Box::new(|m| {
                m.mesh.insert(0, isospan::archive::manifest::SegmentRecord { chunks: 0, ..m.mesh[0] })
            }),
        ),
        (
            "segments beyond 2^64",
            Box::new(|m| {
                m.mesh[0].chunks = u64::MAX;
                m.mesh.push(m.mesh[0].clone());
            }),
        ),
        ("counts", Box::new(|m| m.counts.points = u64::MAX)),
        ("another length", Box::new(|m| m.mesh[0].info.bytes += 1)),
        ("another hash of values", Box::new(|m| m.steps[0].values[0].info.content_hash ^= 1)),
        ("another hash of the index", Box::new(|m| m.steps[0].index.as_mut().unwrap().content_hash ^= 1)),
        ("no index of several chunks", Box::new(|m| (m.steps[0].index, m.steps[0].spectrum) = (None, None))),
        ("a flat geometry", Box::new(|m| m.steps[0].plan.source.geometry.spacing = [0.0; 3])),
        ("an endless geometry", Box::new(|m| m.steps[0].plan.source.geometry.origin = [f64::MAX; 3])),
        ("other dimensions", Box::new(|m| m.steps[0].plan.source.dims = [3; 3])),
        ("another step", Box::new(|m| m.steps[0].plan.number = u64::MAX)),
        ("a step twice", Box::new(|m| m.steps.push(m.steps[0].clone()))),
    ];
    for (what, edit) in &edits {
        let bad = dir.path().join("bad.isospan");
        copy(&good, &bad);
        let mut manifest = Manifest::read(&bad).unwrap();
        edit(&mut manifest);
        manifest.write(&bad).unwrap();
        assert!(ask(&bad, what), "{what}: not refused by check");
        fs::remove_dir_all(&bad).unwrap();
    }
}

/// Blocks that are lies behind good checksums cause no panic, no hang and no huge allocation,
/// however wrong they are.
#[test]
fn blocks_that_lie_behind_good_checksums_do_no_harm() {
    let dir = tempfile::tempdir().unwrap();
    lie_in_every_block(&small(dir.path(), "a", 0.0));
    lie_in_every_block(&single(dir.path()));
}

fn lie_in_every_block(good: &Path) {
    let manifest = Manifest::read(good).unwrap();
    let step = &manifest.steps[0];
    let mut jobs = vec![];
    for (kind, blocks) in [
        (SegmentKind::Mesh, manifest.mesh[0].info.blocks),
        (SegmentKind::Values, step.values[0].info.blocks),
        (SegmentKind::Index, step.index.map_or(0, |i| i.blocks)),
    ] {
        for block in 0..blocks {
            // The first chunk, the summary and the table behind the last, and some in between.
            if block < 3 || block + 3 > blocks {
                jobs.extend(
                    [0, 1, 4, 12].into_iter().flat_map(|at| [(kind, block, at, 0), (kind, block, at, 0xff)]),
                );
            }
        }
    }
    let good_files = folder(good);
    share(good, jobs.len(), |copy, job| {
        let (kind, block, at, value) = jobs[job];
        // Bytes from `at` on, so that whole fields become 0 or as large as they can be.
        reseal_all(
            copy,
            |_| {},
            |k, n, bytes| {
                if (k, n) == (kind, block) {
                    bytes.iter_mut().skip(at).take(4).for_each(|b| *b = value);
                }
            },
        );
        ask(copy, &format!("{kind:?} block {block}: {value:#x} at {at}"));
        for (name, bytes) in &good_files {
            put(&copy.join(name), bytes);
        }
    });
}
