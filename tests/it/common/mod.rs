//! What tests of several files need: volumes to reduce, folders to compare, triangles as a set.

use isospan::archive::manifest::{MANIFEST_NAME, Manifest, pack_manifest};
use isospan::archive::segment::{PlanHash, Segment, SegmentInfo, SegmentKind, SegmentWriter};
use isospan::exec::Silent;
use isospan::formats::surface::read_surface;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{
    self, Addition, Amount, ArchiveCheck, ArchiveSummary, CountReport, Isovalues, Measurement, ReduceReport,
    ReduceSettings, RunSettings, Shard, Shards, SpectrumReport, StepChoice, StreamedPart, SurfaceQuery,
    SurfaceReport, SurfaceSink,
};
use isospan::points::SetKind;
use isospan::sample::Values;
use isospan::surface::{SurfaceSource, TriMesh};
use isospan::{Archive, Reduction, Resources, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// A field as an NPY file of `dims` (x, y, z) f32 samples, x fastest.
pub(crate) fn write_npy(path: &Path, dims: [usize; 3], f: impl Fn(f64, f64, f64) -> f64) {
    let shape = format!("({}, {}, {})", dims[2], dims[1], dims[0]);
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    let unit = |i: usize, n: usize| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let value = f(unit(x, dims[0]), unit(y, dims[1]), unit(z, dims[2]));
                bytes.extend((value as f32).to_le_bytes());
            }
        }
    }
    fs::write(path, bytes).unwrap();
}

/// A legacy VTK file of hexahedra in an L, with a field.
pub(crate) fn write_hexahedra(path: &Path, field: impl Fn(f64, f64, f64) -> f64) {
    let n = 10;
    let id = |x: usize, y: usize, z: usize| (z * (n + 1) + y) * (n + 1) + x;
    let (mut points, mut values, mut cells, mut count) = (String::new(), String::new(), String::new(), 0);
    for z in 0..=n {
        for y in 0..=n {
            for x in 0..=n {
                points += &format!("{x} {y} {z}\n");
                values += &format!("{}\n", field(x as f64 / 9.0, y as f64 / 8.0, z as f64 / 7.0));
                if x < n && y < n && z < n && (x < n / 2 || y < n / 2) {
                    let corners = [
                        (0, 0, 0),
                        (1, 0, 0),
                        (1, 1, 0),
                        (0, 1, 0),
                        (0, 0, 1),
                        (1, 0, 1),
                        (1, 1, 1),
                        (0, 1, 1),
                    ];
                    let ids = corners.map(|(a, b, c)| id(x + a, y + b, z + c).to_string());
                    cells += &format!("8 {}\n", ids.join(" "));
                    count += 1;
                }
            }
        }
    }
    let total = (n + 1).pow(3);
    let text = format!(
        "# vtk DataFile Version 3.0\nL\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {total} double\n{points}CELLS {count} {}\n{cells}\
         CELL_TYPES {count}\n{}POINT_DATA {total}\nSCALARS f float 1\nLOOKUP_TABLE default\n{values}",
        9 * count,
        "12\n".repeat(count)
    );
    fs::write(path, text).unwrap();
}

/// A legacy VTK file of the cubes of a grid that `keep`s, each in six tetrahedra, with a field.
pub(crate) fn write_mesh(
    path: &Path,
    n: u32,
    keep: impl Fn([f64; 3]) -> bool,
    place: impl Fn([f64; 3]) -> [f64; 3],
    field: impl Fn([f64; 3]) -> f64,
) {
    write_placed(path, n, keep, |p| (place(p), field(place(p))));
}

/// As [`write_mesh`], with a function that gives place and value of a vertex.
pub(crate) fn write_placed(
    path: &Path,
    n: u32,
    keep: impl Fn([f64; 3]) -> bool,
    place: impl Fn([f64; 3]) -> ([f64; 3], f64),
) {
    const PATHS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let m = n + 1;
    let number = |c: [u32; 3]| (c[2] * m + c[1]) * m + c[0];
    let unit = |c: [u32; 3]| c.map(|x| f64::from(x) / f64::from(n));
    let mut used = BTreeMap::new();
    let mut tets = vec![];
    for z in 0..n {
        for y in 0..n {
            for x in 0..n {
                if !keep([x, y, z].map(|c| (f64::from(c) + 0.5) / f64::from(n))) {
                    continue;
                }
                for path in PATHS {
                    let mut at = [x, y, z];
                    let mut tet = [number(at); 4];
                    used.insert(number(at), unit(at));
                    for (i, axis) in path.into_iter().enumerate() {
                        at[axis] += 1;
                        tet[i + 1] = number(at);
                        used.insert(number(at), unit(at));
                    }
                    tets.push(tet);
                }
            }
        }
    }
    let compact: BTreeMap<u32, usize> = used.keys().enumerate().map(|(i, &v)| (v, i)).collect();
    let placed: Vec<([f64; 3], f64)> = used.values().map(|&p| place(p)).collect();
    let mut text = format!(
        "# vtk DataFile Version 3.0\nmesh\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {} double\n",
        placed.len()
    );
    for (p, _) in &placed {
        writeln!(text, "{} {} {}", p[0], p[1], p[2]).unwrap();
    }
    writeln!(text, "CELLS {} {}", tets.len(), 5 * tets.len()).unwrap();
    for tet in &tets {
        let [a, b, c, d] = tet.map(|v| compact[&v]);
        writeln!(text, "4 {a} {b} {c} {d}").unwrap();
    }
    writeln!(text, "CELL_TYPES {}", tets.len()).unwrap();
    tets.iter().for_each(|_| text.push_str("10\n"));
    writeln!(text, "POINT_DATA {}\nSCALARS f double\nLOOKUP_TABLE default", placed.len()).unwrap();
    placed.iter().for_each(|(_, value)| writeln!(text, "{value}").unwrap());
    fs::write(path, text).unwrap();
}

/// Waves along all axes, cut open by the faces of the box; values in about -2 .. 2.
pub(crate) fn waves(x: f64, y: f64, z: f64) -> f64 {
    (5.0 * x).sin() * (4.0 * y).cos() + (6.0 * y).sin() * (5.0 * z).cos() + 0.3 * (4.0 * z * x).sin()
}

/// Positive inside a ball of radius 0.7.
pub(crate) fn ball(x: f64, y: f64, z: f64) -> f64 {
    0.49 - x * x - y * y - z * z
}

/// Sampled values, not rounded: those of the field, and of a linear field to the last bit, which
/// most tests compare with.
pub(crate) fn settings(points: SetKind, amount: Amount, chunk_points: u64) -> ReduceSettings {
    ReduceSettings { amount, chunk_points, values: Some(Values::Sample), ..ReduceSettings::exact(points) }
}

pub(crate) fn run(threads: usize) -> RunSettings {
    RunSettings {
        resources: Resources::default().with_threads(threads).with_memory(4 << 30),
        ..RunSettings::default()
    }
}

pub(crate) fn reduce(input: &Path, settings: &ReduceSettings, out: &Path, threads: usize) -> ReduceReport {
    pipeline::reduce_series(
        &[StepSource::new(input, &OpenOptions::default())],
        settings,
        out,
        &run(threads),
        &Silent,
    )
    .unwrap()
}

/// As [`reduce`], in two shards, the second one first.
pub(crate) fn reduce_in_shards(input: &Path, settings: &ReduceSettings, out: &Path) {
    reduce_series_in_shards(&[StepSource::new(input, &OpenOptions::default())], settings, out);
}

pub(crate) fn reduce_series_in_shards(sources: &[StepSource], settings: &ReduceSettings, out: &Path) {
    let run = run(2);
    let reduction = Reduction::of_steps(sources.to_vec()).settings(settings.clone());
    reduction.resources(run.resources.clone()).plan_shards(out, 2).unwrap();
    let shards = Shards::at(out).resources(run.resources);
    for shard in [1, 0] {
        shards.work(Shard::new(shard, 2).unwrap()).unwrap();
    }
    shards.commit().unwrap();
}

/// All samples of a step, x fastest.
pub(crate) fn samples(archive: &Archive, choice: StepChoice) -> Vec<f64> {
    let step = archive.at(choice).unwrap();
    step.sample(step.dims()).unwrap()
}

/// The error of an archive of one step against its source.
pub(crate) fn error_of(archive: &Path, input: &Path) -> isospan::measure::FieldError {
    measurement(archive, input).resources(run(2).resources).run().unwrap().error
}

/// A measurement of an archive against a file.
pub(crate) fn measurement(archive: &Path, input: &Path) -> Measurement<'static> {
    Archive::open(archive).unwrap().measure(input)
}

/// Steps that are to be added to an archive.
pub(crate) fn addition(steps: &[StepSource], run: &RunSettings) -> Addition<'static> {
    let addition = Addition::of_steps(steps.to_vec()).keep_going(run.keep_going);
    addition.resources(run.resources.clone())
}

pub(crate) fn surface(archive: &Path, isovalue: impl Into<f64>, out: &Path, threads: usize) -> SurfaceReport {
    let isovalue: f64 = isovalue.into();
    let resources = Resources::default().with_threads(threads);
    query(archive, isovalue).resources(resources).write(out).unwrap()
}

/// A question as the command line asks it: the archive is opened for it, and keeps nothing.
pub(crate) fn query(archive: &Path, isovalues: impl Into<Isovalues>) -> SurfaceQuery<'static> {
    Archive::open(archive).unwrap().keeping(0).query(isovalues)
}

pub(crate) fn check_archive(archive: &Path) -> Result<ArchiveCheck> {
    Archive::open(archive)?.check()
}

pub(crate) fn count_active(archive: &Path, isovalue: impl Into<f64>) -> Result<CountReport> {
    Archive::open(archive)?.count(isovalue)
}

pub(crate) fn summarize(archive: &Path) -> Result<ArchiveSummary> {
    Archive::open(archive)?.info()
}

pub(crate) fn contour_spectrum(archive: &Path) -> Result<SpectrumReport> {
    Archive::open(archive)?.spectrum()
}

pub(crate) fn read(path: &Path) -> TriMesh {
    read_surface(path).unwrap()
}

/// The triangles of a surface by the bits of their corners, each rotated to start with its least
/// corner.
pub(crate) fn triangle_set(mesh: &TriMesh) -> BTreeSet<[[u32; 3]; 3]> {
    mesh.triangles
        .iter()
        .map(|t| {
            let mut c = t.map(|v| mesh.vertices[v as usize].position.map(f32::to_bits));
            let least = (0..3).min_by_key(|&i| c[i]).unwrap();
            c.rotate_left(least);
            c
        })
        .collect()
}

/// All files below a folder, by their paths in it, with their content.
pub(crate) fn folder(path: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut waiting = vec![path.to_path_buf()];
    while let Some(next) = waiting.pop() {
        for entry in fs::read_dir(&next).unwrap() {
            let entry = entry.unwrap().path();
            if entry.is_dir() {
                waiting.push(entry);
            } else {
                files.insert(entry.strip_prefix(path).unwrap().to_path_buf(), fs::read(&entry).unwrap());
            }
        }
    }
    files
}

/// The folder of real data sets. Tests that want it are ignored unless they are asked for, as
/// `tools/check` does where there is one.
pub(crate) fn shared_data() -> PathBuf {
    let folder = std::env::var_os("ISOSPAN_SHARED_DATA").map(PathBuf::from).filter(|p| p.is_dir());
    folder.expect("ISOSPAN_SHARED_DATA names a folder of real data")
}

/// Sends a signal; whether there was a process to take it.
#[cfg(unix)]
pub(crate) fn send_signal(process: u32, signal: rustix::process::Signal) -> bool {
    let process = i32::try_from(process).ok().and_then(rustix::process::Pid::from_raw);
    rustix::process::kill_process(process.expect("a number of a process"), signal).is_ok()
}

/// The manifest of an archive as JSON.
pub(crate) fn manifest_json(archive: &Path) -> String {
    Manifest::read(archive).unwrap().to_json()
}

/// Replaces the manifest of an archive by this JSON, with a good checksum.
pub(crate) fn put_manifest(archive: &Path, json: &str) {
    fs::write(archive.join(MANIFEST_NAME), pack_manifest(json)).unwrap();
}

/// Rewrites a segment, with good checksums, under another plan hash and with blocks changed by
/// `edit`.
pub(crate) fn reseal(
    path: &Path,
    kind: SegmentKind,
    plan: PlanHash,
    edit: impl Fn(u64, &mut Vec<u8>),
) -> SegmentInfo {
    let segment = Segment::open(path, kind, None).unwrap();
    let mut blocks = vec![];
    for n in 0..segment.block_count() {
        let mut block = vec![];
        segment.block(n, &mut block).unwrap();
        edit(n, &mut block);
        blocks.push(block);
    }
    let _ = fs::remove_file(path);
    let mut writer = SegmentWriter::create(path, kind, plan).unwrap();
    for block in &blocks {
        writer.push_block(block).unwrap();
    }
    writer.finish().unwrap()
}

/// Gives the archive another plan, and everything in it the hashes of that plan: all checksums are
/// good.
pub(crate) fn reseal_all(
    archive: &Path,
    change: impl Fn(&mut Manifest),
    edit: impl Fn(SegmentKind, u64, &mut Vec<u8>),
) {
    let mut manifest = Manifest::read(archive).unwrap();
    change(&mut manifest);
    manifest.plan_hash = manifest.plan.hash();
    manifest.mesh[0].info =
        reseal(&archive.join("mesh/000000.seg"), SegmentKind::Mesh, manifest.plan_hash, |n, b| {
            edit(SegmentKind::Mesh, n, b);
        });
    let step = &mut manifest.steps[0];
    let hash = step.plan.hash(manifest.plan_hash);
    let files = [
        ("000000-values-000000.seg", SegmentKind::Values),
        ("000000-index.seg", SegmentKind::Index),
        ("000000-spectrum.seg", SegmentKind::Spectrum),
    ];
    // A small archive has values alone.
    let [values, index, spectrum] = files.map(|(file, kind)| {
        let path = archive.join("steps").join(file);
        path.exists().then(|| reseal(&path, kind, hash, |n, b| edit(kind, n, b)))
    });
    (step.values[0].info, step.index, step.spectrum) = (values.expect("values are there"), index, spectrum);
    manifest.write(archive).unwrap();
}

/// The surfaces of a step whose parts were put together, in place of those of a preview, and the
/// number of all parts.
pub(crate) fn streamed(query: &SurfaceQuery<'_>) -> (Vec<TriMesh>, usize) {
    let count = query.isovalues().len();
    let mut taken = Taken { shown: vec![Default::default(); count], ..Taken::default() };
    let report = query.stream(&mut taken).unwrap();
    assert_eq!(report.triangles, taken.whole);
    assert!(!taken.shown.iter().any(|(_, is_preview)| *is_preview), "surfaces end as they are");
    (taken.shown.into_iter().map(|(surface, _)| surface).collect(), taken.parts)
}

/// What a stream has handed on.
#[derive(Default)]
struct Taken {
    /// The surfaces, and whether each is a preview.
    shown: Vec<(TriMesh, bool)>,
    parts: usize,
    chunks: u64,
    /// Triangles of whole surfaces.
    whole: u64,
}

impl SurfaceSink for Taken {
    fn part(&mut self, part: &StreamedPart<'_>) -> Result<()> {
        let (surface, is_preview) = &mut self.shown[part.isovalue];
        let was_preview = std::mem::replace(is_preview, part.is_preview);
        assert!(was_preview || !part.is_preview || *surface == TriMesh::default());
        if was_preview && !part.is_preview {
            *surface = TriMesh::default();
        }
        let added = TriMesh::from_source(part.added)?;
        surface.vertices.extend(added.vertices);
        surface.triangles.extend(added.triangles);
        let count = surface.vertices.len() as u32;
        assert!(surface.triangles.iter().flatten().all(|&v| v < count), "vertices come first");
        for &(number, vertex) in part.changed {
            surface.vertices[number as usize] = vertex;
        }
        assert!(part.chunks >= self.chunks, "chunks come in order");
        (self.parts, self.chunks) = (self.parts + 1, part.chunks);
        Ok(())
    }

    fn whole(&mut self, _: usize, surface: &dyn SurfaceSource) -> Result<()> {
        self.whole += surface.triangle_count();
        Ok(())
    }
}
