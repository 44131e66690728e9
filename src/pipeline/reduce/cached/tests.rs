//! Sources of chunks give the archives of the plain file, without a copy on disk.

use crate::archive::chunked::ChunkSegment;
use crate::pipeline::read::OpenArchive;
use crate::pipeline::{
    Addition, Amount, Archive, Bound, ReduceReport, ReduceSettings, Reduction, RunSettings, Shard, Shards,
    SourceChunks, Target, estimate_series, reduce_series, work_folder,
};
use isospan_io::exec::{Resources, Silent};
use isospan_io::formats::{OpenOptions, StepSource};
use isospan_io::grid::ChunkId;
use isospan_mesh::points::SetKind;
use isospan_mesh::sample::Values;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const DIMS: [usize; 3] = [56, 52, 48];
const EDGE: usize = 16;

/// As `tools/make_golden_hdf5.py` wrote it: a chunk that is not there reads as 7.
fn value([x, y, z]: [usize; 3]) -> u16 {
    let wave = (x * (55 - x) + 2 * y * (51 - y) + 3 * z * (47 - z)) / 64 * 64;
    if [x, y, z].map(|v| v / EDGE) == [1, 2, 1] { 7 } else { wave as u16 }
}

/// The samples of a box, x fastest; those beyond the volume are 0.
fn samples(lo: [usize; 3], size: [usize; 3], factor: u16) -> Vec<u8> {
    let mut out = vec![];
    for (z, y) in (0..size[2]).flat_map(|z| (0..size[1]).map(move |y| (z, y))) {
        for x in 0..size[0] {
            let at = [lo[0] + x, lo[1] + y, lo[2] + z];
            let is_inside = (0..3).all(|a| at[a] < DIMS[a]);
            let value = if is_inside { factor * value(at) } else { 0 };
            out.extend(value.to_le_bytes());
        }
    }
    out
}

/// The first `dims` samples.
fn nrrd([nx, ny, nz]: [usize; 3], factor: u16) -> Vec<u8> {
    let head = format!(
        "NRRD0004\ntype: ushort\ndimension: 3\nsizes: {nx} {ny} {nz}\nencoding: raw\nendian: little\n\n"
    );
    [head.into_bytes(), samples([0; 3], [nx, ny, nz], factor)].concat()
}

fn zarr(folder: &Path, dims: [usize; 3], edge: usize, factor: u16) {
    let [nx, ny, nz] = dims;
    fs::create_dir(folder).unwrap();
    let head = format!(
        r#"{{"zarr_format":2,"shape":[{nz},{ny},{nx}],"chunks":[{edge},{edge},{edge}],"dtype":"<u2",
           "compressor":null,"fill_value":{},"order":"C","filters":null}}"#,
        7 * factor
    );
    fs::write(folder.join(".zarray"), head).unwrap();
    let grid = dims.map(|d| d.div_ceil(edge));
    for n in 0..grid.iter().product() {
        let [a, b, c] = [n % grid[0], n / grid[0] % grid[1], n / grid[0] / grid[1]];
        if edge != EDGE || [a, b, c] != [1, 2, 1] {
            let chunk = samples([a, b, c].map(|v| v * edge), [edge; 3], factor);
            fs::write(folder.join(format!("{c}.{b}.{a}")), chunk).unwrap();
        }
    }
}

/// Pages in strips of 20 rows, each compressed by zstd.
fn tiff(slices: std::ops::Range<usize>) -> Vec<u8> {
    let [nx, ny, _] = DIMS;
    let (mut file, count) = (b"II*\0\0\0\0\0".to_vec(), slices.len());
    let mut link = 4;
    for z in slices {
        let strips: Vec<Vec<u8>> = (0..ny)
            .step_by(20)
            .map(|y| zstd::bulk::compress(&samples([0, y, z], [nx, 20.min(ny - y), 1], 1), 1).unwrap())
            .collect();
        let mut table = vec![];
        for strip in &strips {
            table.push(file.len() as u32);
            file.extend(strip);
        }
        table.extend(strips.iter().map(|s| s.len() as u32));
        file.resize(file.len().next_multiple_of(2), 0);
        let tables = file.len() as u32;
        table.iter().for_each(|n| file.extend(n.to_le_bytes()));
        let (n, at) = (strips.len() as u32, file.len() as u32);
        file[link..link + 4].copy_from_slice(&at.to_le_bytes());
        let tags: [[u32; 4]; 8] = [
            [256, 4, 1, nx as u32],
            [257, 4, 1, ny as u32],
            [258, 4, 1, 16],
            [259, 4, 1, 50000],
            [262, 4, 1, 1],
            [273, 4, n, tables],
            [278, 4, 1, 20],
            [279, 4, n, tables + 4 * n],
        ];
        file.extend((tags.len() as u16).to_le_bytes());
        for [tag, kind, count, value] in tags {
            file.extend([tag as u16, kind as u16].map(u16::to_le_bytes).concat());
            file.extend([count, value].map(u32::to_le_bytes).concat());
        }
        link = file.len();
        file.extend([0; 4]);
    }
    assert!(count > 0);
    file
}

/// An image of zlib blocks of 1000 bytes.
fn vti() -> Vec<u8> {
    let extent = DIMS.map(|d| format!("0 {}", d - 1)).join(" ");
    let head = format!(
        "<VTKFile type=\"ImageData\" byte_order=\"LittleEndian\" header_type=\"UInt32\" \
         compressor=\"vtkZLibDataCompressor\"><ImageData WholeExtent=\"{extent}\"><Piece Extent=\"{extent}\">\
         <PointData><DataArray type=\"UInt16\" Name=\"data\" format=\"appended\" offset=\"0\"/></PointData>\
         </Piece></ImageData><AppendedData encoding=\"raw\">_"
    );
    let all = samples([0; 3], DIMS, 1);
    let blocks: Vec<Vec<u8>> = all.chunks(1000).map(zlib).collect();
    let mut table = vec![blocks.len() as u32, 1000, all.len() as u32 % 1000];
    table.extend(blocks.iter().map(|b| b.len() as u32));
    let table: Vec<u8> = table.into_iter().flat_map(u32::to_le_bytes).collect();
    [head.into_bytes(), table, blocks.concat(), b"</AppendedData></VTKFile>".to_vec()].concat()
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut packed = flate2::write::ZlibEncoder::new(vec![], flate2::Compression::fast());
    std::io::Write::write_all(&mut packed, bytes).unwrap();
    packed.finish().unwrap()
}

/// Sources in a temporary folder.
struct Inputs(TempDir);

impl Inputs {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name);
        fs::write(path("a.nrrd"), nrrd(DIMS, 1)).unwrap();
        zarr(&path("a.zarr"), DIMS, EDGE, 1);
        fs::write(path("a.h5"), include_bytes!("../../../../tests/data/chunks.h5")).unwrap();
        Self(dir)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn step(&self, name: &str) -> StepSource {
        StepSource::new(&self.path(name), &OpenOptions::default())
    }

    /// Two threads, and a scratch folder that cannot be made.
    fn run(&self) -> RunSettings {
        let scratch = Some(self.path("a.nrrd/nowhere"));
        let resources = Resources::default().with_threads(2).with_memory(256 << 20).with_scratch(scratch);
        RunSettings { resources, ..RunSettings::default() }
    }

    fn reduce(&self, inputs: &[&str], settings: &ReduceSettings, out: &str) -> ReduceReport {
        let steps: Vec<_> = inputs.iter().map(|name| self.step(name)).collect();
        reduce_series(&steps, settings, &self.path(out), &self.run(), &Silent).unwrap()
    }

    /// The bytes of all blocks of an archive. Headers of files are left out: they name the source.
    fn blocks(&self, out: &str) -> Vec<Vec<u8>> {
        let archive = OpenArchive::open(&self.path(out)).unwrap().step_at(0);
        let of_chunk = |segment: &ChunkSegment, chunk| {
            let block = |n| {
                let mut bytes = vec![];
                segment.block(chunk, n, &mut bytes).unwrap();
                bytes
            };
            (0..segment.block_count(chunk)).map(block).collect::<Vec<_>>()
        };
        let mut blocks = vec![];
        for chunk in (0..archive.chunks.len()).map(ChunkId) {
            let segment = archive.segment_of(chunk).unwrap();
            blocks.extend(of_chunk(&segment.mesh, chunk));
            for step in 0..archive.manifest.steps.len() {
                blocks.extend(of_chunk(&archive.values_of(step, chunk).unwrap(), chunk));
            }
        }
        blocks
    }

    /// Whether two archives differ in nothing but the names of their sources.
    fn assert_same(&self, plain: &str, other: &str) {
        let (plain, found) = (self.blocks(plain), self.blocks(other));
        assert!(!plain.is_empty() && plain == found, "the blocks of {other}");
    }
}

fn settings(fraction: f64, values: Values) -> ReduceSettings {
    let amount = Amount::Fraction(fraction);
    ReduceSettings {
        amount,
        chunk_points: 1000,
        values: Some(values),
        ..ReduceSettings::exact(SetKind::Hammersley)
    }
}

/// How often a chunk was decoded, on average.
fn decodes(found: Option<SourceChunks>) -> f64 {
    let SourceChunks { chunks, decodes } = found.expect("it was read by chunks");
    decodes as f64 / chunks as f64
}

#[test]
fn every_source_of_chunks_gives_the_archive_of_the_plain_file() {
    let inputs = Inputs::new();
    fs::write(inputs.path("a.tif"), tiff(0..DIMS[2])).unwrap();
    fs::write(inputs.path("a.vti"), vti()).unwrap();
    fs::create_dir(inputs.path("slices")).unwrap();
    (0..DIMS[2]).for_each(|z| fs::write(inputs.path(&format!("slices/{z}.tif")), tiff(z..z + 1)).unwrap());
    for values in [Values::Sample, Values::Fit] {
        let (settings, plain) = (settings(1.0 / 16.0, values), format!("{values:?}.isospan"));
        let figures = |r: ReduceReport| (r.points, r.chunks, r.range, r.error);
        let of_plain = inputs.reduce(&["a.nrrd"], &settings, &plain);
        assert!(of_plain.source_chunks.is_none() && of_plain.error.is_some());
        let of_plain = figures(of_plain);
        for name in ["a.zarr", "a.h5", "a.tif", "slices", "a.vti"] {
            let out = format!("{name}-{values:?}.isospan");
            let found = inputs.reduce(&[name], &settings, &out);
            // For advice, and to make the archive.
            assert_eq!(decodes(found.source_chunks), 2.0, "{name}");
            assert_eq!(figures(found), of_plain, "{name}");
            inputs.assert_same(&plain, &out);
        }
    }
}

#[test]
fn workers_decode_their_part_alone_and_make_the_same_archive() {
    let (inputs, run) = (Inputs::new(), Inputs::run);
    for (name, values) in [("a.zarr", Values::Sample), ("a.h5", Values::Fit)] {
        let settings = settings(0.4, values);
        let whole = inputs.reduce(&[name], &settings, "whole.isospan");
        assert!(whole.chunks > 32, "segments for three workers: {} chunks", whole.chunks);
        let (out, run) = (inputs.path("shards.isospan"), run(&inputs));
        let reduction = Reduction::of(inputs.step(name)).settings(settings.clone());
        reduction.resources(run.resources.clone()).plan_shards(&out, 3).unwrap();
        let shards = Shards::at(&out).resources(run.resources);
        let work = |n| shards.work(Shard::new(n, 3).unwrap()).unwrap();
        let times: Vec<f64> = (0..3).map(|n| decodes(work(n).source_chunks)).collect();
        assert!(times.iter().all(|t| *t > 0.0) && times.iter().sum::<f64>() < 2.5, "{name}: {times:?}");
        shards.commit().unwrap();
        let manifest = |archive: &str| fs::read(inputs.path(archive).join("manifest.zst")).unwrap();
        assert!(manifest("shards.isospan") == manifest("whole.isospan"), "{name}");
        ["shards.isospan", "whole.isospan"].iter().for_each(|a| fs::remove_dir_all(inputs.path(a)).unwrap());
        let _ = fs::remove_dir_all(work_folder(&out));
    }
}

#[test]
fn steps_are_read_through_caches_and_so_are_those_that_are_added() {
    let inputs = Inputs::new();
    fs::write(inputs.path("b.nrrd"), nrrd(DIMS, 2)).unwrap();
    zarr(&inputs.path("b.zarr"), DIMS, EDGE, 2);
    let settings = settings(1.0 / 16.0, Values::Fit);
    inputs.reduce(&["a.nrrd", "b.nrrd", "a.nrrd"], &settings, "plain.isospan");
    let found = inputs.reduce(&["a.h5", "b.zarr", "a.zarr"], &settings, "chunks.isospan");
    // Only the first step is read for advice.
    assert!((1.0..2.0).contains(&decodes(found.source_chunks)));
    inputs.assert_same("plain.isospan", "chunks.isospan");
    inputs.reduce(&["a.zarr", "b.zarr"], &settings, "added.isospan");
    let out = inputs.path("added.isospan");
    let addition = Addition::of(inputs.step("a.h5")).resources(inputs.run().resources);
    let added = addition.append_to(&out).unwrap();
    assert_eq!((added.steps.len(), added.source_chunks.is_some()), (1, true));
    inputs.assert_same("plain.isospan", "added.isospan");
}

#[test]
fn points_that_adapt_targets_and_measure_need_no_copy() {
    let (inputs, dims) = (Inputs::new(), [24, 22, 20]);
    fs::write(inputs.path("small.nrrd"), nrrd(dims, 1)).unwrap();
    zarr(&inputs.path("small.zarr"), dims, 7, 1);
    let halton = ReduceSettings { points: Some(SetKind::Halton), ..settings(1.0 / 16.0, Values::Sample) };
    let adapted = ReduceSettings { adapt: true, ..halton };
    let with = |target, like: &ReduceSettings| ReduceSettings { target: Some(target), ..like.clone() };
    let rms = with(Target::Rms(Bound::OfRange(0.02)), &settings(1.0 / 16.0, Values::Fit));
    let max = with(Target::Max(Bound::OfRange(0.02)), &adapted);
    for (n, settings) in [adapted, rms, max].iter().enumerate() {
        let [plain, out] = ["plain", "chunks"].map(|name| format!("{name}{n}.isospan"));
        let expected = inputs.reduce(&["small.nrrd"], settings, &plain);
        let found = inputs.reduce(&["small.zarr"], settings, &out);
        assert!(expected.target.is_none_or(|t| t.tries > 1), "{:?}", expected.target);
        assert_eq!((found.error, found.target), (expected.error, expected.target), "{n}");
        inputs.assert_same(&plain, &out);
    }
    let archive = Archive::open(inputs.path("plain0.isospan")).unwrap();
    let against = |name: &str| {
        archive.measure(inputs.path(name)).resources(inputs.run().resources).run().unwrap().error
    };
    assert_eq!(against("small.zarr"), against("small.nrrd"));
}

#[test]
fn where_the_memory_holds_no_cache_the_estimate_has_a_copy() {
    let inputs = Inputs::new();
    let scratch = |memory: u64| {
        let resources = inputs.run().resources.with_memory(memory);
        let run = RunSettings { resources, ..inputs.run() };
        let (input, out) = ([inputs.step("a.zarr")], inputs.path("e.isospan"));
        estimate_series(&input, &settings(0.1, Values::Fit), &out, &run).unwrap().scratch_bytes
    };
    assert_eq!(scratch(256 << 20), 0);
    assert!(scratch(1 << 10) > 0);
}
