//! What is done with a damaged input. An error is as good as an answer; panics, hangs and claims of
//! memory are finds.

use crate::mutate::{Random, mutate};
use crate::seeds::{get, partners, put};
use isospan::archive::chunked::{MeshSummary, ValueSummary};
use isospan::archive::manifest::{
    MANIFEST_NAME, Manifest, index_path, mesh_segment_path, pack_manifest, values_segment_path,
};
use isospan::archive::mesh::{BlockHead, ChunkHeader, TetBlock, TetScratch, decode_flags, decode_ids};
use isospan::archive::segment::{PlanHash, Segment, SegmentInfo, SegmentKind, SegmentWriter};
use isospan::archive::values::{KnownOfBlock, decode_values};
use isospan::bytes::IoMode;
use isospan::cells::scan::{scan, scan_field};
use isospan::exec::Silent;
use isospan::formats::RawLayout;
use isospan::formats::surface::read_surface;
use isospan::formats::{OpenOptions, StepSource, open_mesh, open_volume};
use isospan::geom::PointId;
use isospan::grid::IndexBox;
use isospan::pipeline::{self, Amount, ReduceSettings, RunSettings};
use isospan::points::SetKind;
use isospan::surface::check::check;
use isospan::volume::chunked::ChunkedVolume;
use isospan::volume::{ScalarType, VolumeReader, VolumeSource};
use isospan::{Error, Resources, Result};
use isospan_wavelet::{Box3, Compressed, MOST_LABEL, Mask, decode_labels, encode_labels};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Slabs read of a volume: enough to go through every decoder, not all of what a few bytes may
/// expand to.
const MOST_SLABS: usize = 8;
/// Bytes of decoded chunks that are cached: so few that some are decoded again.
const CACHED: u64 = 1 << 10;
/// The most samples that are read at once at random access.
const MOST_SAMPLES: u64 = 1 << 20;

/// Opens a volume and reads it.
pub(crate) fn volume(path: &Path, bytes: &[u8]) -> Result<()> {
    let io = if bytes.len().is_multiple_of(2) { IoMode::Map } else { IoMode::Read };
    let raw = raw_layout(path, bytes);
    let spacing = raw.as_ref().map(|_| if bytes.get(6) == Some(&255) { [f64::NAN; 3] } else { [1.0; 3] });
    let options = OpenOptions { raw, spacing, io, ..OpenOptions::default() };
    let source = match open_volume(path, &options) {
        Err(Error::Usage(text)) if text.contains("several fields") => {
            open_volume(path, &OpenOptions { field: Some("b".into()), ..options })?
        }
        other => other?,
    };
    match &source {
        VolumeSource::Random(reader) => boxes(&**reader)?,
        VolumeSource::Chunked(chunks) => boxes(&ChunkedVolume::new(Arc::clone(chunks), CACHED))?,
        VolumeSource::Stream(_) => {}
    }
    let (mut stream, mut slab) = (source.into_stream(), vec![]);
    for _ in 0..MOST_SLABS {
        if stream.next_slab(&mut slab)?.is_none() {
            break;
        }
    }
    Ok(())
}

/// Reads the first samples of a volume, and the last.
fn boxes(reader: &dyn VolumeReader) -> Result<()> {
    let d = reader.info().dims;
    let first = IndexBox { lo: [0; 3], hi: d.map(|d| d.min(64)) };
    let last = IndexBox { lo: d.map(|d| d.saturating_sub(5)), hi: d };
    for voxels in [first, last] {
        if voxels.checked_len().is_some_and(|n| n <= MOST_SAMPLES) {
            reader.read_box(voxels, &mut vec![0.0; voxels.len()])?;
        }
    }
    Ok(())
}

/// Opens a mesh and reads its points, cells and all of its fields.
pub(crate) fn mesh(path: &Path) -> Result<()> {
    let partners = partners(path);
    for (other, text) in &partners {
        put(other, text.as_bytes())?;
    }
    // Of a geometry of EnSight the case is opened.
    let is_geometry = path.extension().is_some_and(|e| e == "geo");
    let named = if is_geometry { &partners[0].0 } else { path };
    let mesh = open_mesh(named, &OpenOptions::default())?;
    scan(&mesh)?;
    (0..mesh.info().fields.len()).try_for_each(|field| scan_field(&mesh, field).map(drop))?;
    if mesh.field().is_ok() {
        let (mut values, mut block) = (mesh.values(0, f64::is_nan)?, vec![]);
        while values.next_block(&mut block)? {}
    }
    Ok(())
}

/// The layout of a headerless file is an input too: the file's first bytes decide it.
fn raw_layout(path: &Path, bytes: &[u8]) -> Option<RawLayout> {
    path.extension().is_some_and(|e| e == "raw").then(|| {
        let at = |i: usize| u64::from(bytes.get(i).copied().unwrap_or(0));
        let dim = |i: usize| if at(i) == 255 { u64::MAX } else { 4 << (at(i) / 32 * 8) };
        RawLayout {
            dims: if at(0) % 2 == 0 { [4; 3] } else { [dim(0), dim(1), dim(2)] },
            scalar: ScalarType::ALL[at(3) as usize % ScalarType::ALL.len()],
            big_endian: at(4) % 2 == 1,
            offset: if at(5) == 255 { u64::MAX } else { at(5) / 8 },
        }
    })
}

/// Reads a surface and checks it.
pub(crate) fn surface(path: &Path) -> Result<()> {
    check(&read_surface(path)?);
    Ok(())
}

/// The decoder of compressed arrays: all samples, the coarsest level, and a box.
pub(crate) fn array(bytes: &[u8]) -> Result<()> {
    const MOST: usize = 1 << 16;
    let refused = |error: isospan_wavelet::Error| Error::usage(error.to_string());
    let array = Compressed::new(bytes, MOST).map_err(refused)?;
    let coarsest = array.pyramid().coarsest();
    for level in [0, coarsest] {
        let nodes = array.level(level).map_err(refused)?;
        assert!(nodes.iter().all(|n| n.is_finite()), "a sample is infinite or no number");
    }
    let last = array.pyramid().nodes(0).map(|n| n - 1);
    array.nodes(0, &Box3 { start: last, size: [1; 3] }).map_err(refused)?;
    Ok(())
}

/// The decoders of blocks, with bytes that no checksum guards.
pub(crate) fn blocks(bytes: &[u8]) -> Result<()> {
    let Some((&which, block)) = bytes.split_first() else { return Ok(()) };
    let blame = |m: isospan::archive::Malformed| m.in_block(Path::new("a block"), 0);
    match which {
        0 => ChunkHeader::decode(block).map(drop).map_err(blame),
        1 => tetrahedra(block).map_err(blame),
        2 => {
            let n = block.len() % 5000;
            let before = vec![1.5; n];
            let known = KnownOfBlock { n, before: &before };
            decode_values(block, &known, &mut vec![]).map_err(blame)
        }
        3 => MeshSummary::decode(block).map(drop).map_err(blame),
        4 => ValueSummary::decode(block).map(drop).map_err(blame),
        5 => decode_flags(block, &mut vec![false; block.len() % 5000]).map_err(blame),
        7 => mask(block),
        8 => labels(block),
        _ => decode_ids(block, &mut vec![PointId(0); block.len() % 1024]).map_err(blame),
    }
}

/// Which samples are missing in a box that has boxes of all sizes.
fn mask(block: &[u8]) -> Result<()> {
    let place = Box3 { start: [256, 0, 32], size: [33, 1 + block.len() % 40, 64] };
    let mask = Mask::new(place, block.to_vec());
    let mut missing = 0;
    let read = mask.and_then(|mask| mask.each_missing(&place, [1; 3], |_| missing += 1));
    assert!(missing <= place.len(), "a sample is missing twice");
    read.map_err(|e| Error::usage(e.to_string()))
}

/// A tile of labels, of many sizes.
fn labels(block: &[u8]) -> Result<()> {
    let size = [1 + block.len() % 32, 1 + block.len() % 29, 1 + block.len() % 7];
    let labels = decode_labels(block, size).map_err(|e| Error::usage(e.to_string()))?;
    assert!(labels.iter().all(|label| label.abs() <= MOST_LABEL), "a label is beyond what f32 holds");
    Ok(())
}

fn tetrahedra(block: &[u8]) -> std::result::Result<(), isospan::archive::Malformed> {
    let mut scratch = TetScratch::default();
    let vertices = 1 << (block.len() % 32);
    // Lengths give any heads.
    let own = (block.len() as u32 % 97).min(vertices);
    let head = BlockHead { first: 0, own, tets: block.len() as u32 * 3 % 1000 };
    let block = TetBlock::open(block, &head, vertices)?;
    let scatter = |v: &u32| [1, 5, 25].map(|f| v.wrapping_mul(2_654_435_761u32.wrapping_mul(f)) >> 8);
    let positions: Vec<_> = block.vertices().iter().map(scatter).collect();
    block.decode(&positions, &mut scratch, &mut vec![])
}

/// A small archive, and a copy of it to damage.
pub(crate) struct Archive {
    good: PathBuf,
    copy: PathBuf,
    /// Its files, by their paths in it.
    files: Vec<(PathBuf, Vec<u8>)>,
}

const ISOVALUE: f32 = 100.0;

impl Archive {
    /// Reduces a seed to an archive of three chunks.
    pub(crate) fn make(folder: &Path) -> Result<Self> {
        let input = folder.join("archive.raw");
        let samples: Vec<u8> = (0..30 * 6 * 5u32).map(|i| (i * 37 % 251) as u8).collect();
        put(&input, &samples)?;
        let layout = RawLayout { dims: [30, 6, 5], scalar: ScalarType::U8, big_endian: false, offset: 0 };
        let settings = ReduceSettings {
            amount: Amount::Fraction(1.0),
            chunk_points: 200,
            ..ReduceSettings::exact(SetKind::Hammersley)
        };
        let (good, copy) = (folder.join("good.isospan"), folder.join("copy.isospan"));
        let options = OpenOptions { raw: Some(layout), ..OpenOptions::default() };
        pipeline::reduce_series(
            &[StepSource::new(&input, &options)],
            &settings,
            &good,
            &RunSettings::default(),
            &Silent,
        )?;
        let step = "steps/000000-";
        let names = [
            MANIFEST_NAME.into(),
            "mesh/000000.seg".into(),
            format!("{step}values-000000.seg"),
            format!("{step}index.seg"),
            format!("{step}spectrum.seg"),
        ];
        let mut files = vec![];
        for name in names.map(PathBuf::from) {
            let to = copy.join(&name);
            let parent = to.parent().expect("a file of the archive lies in a folder");
            fs::create_dir_all(parent).map_err(|e| Error::io("create", parent, e))?;
            let bytes = get(&good.join(&name))?;
            put(&to, &bytes)?;
            files.push((name, bytes));
        }
        Ok(Self { good, copy, files })
    }

    /// The blocks of the archive as inputs of [`blocks`].
    pub(crate) fn block_inputs(&self) -> Result<Vec<Vec<u8>>> {
        let mesh = Segment::open(mesh_segment_path(&self.good, 0), SegmentKind::Mesh, None)?;
        let values = Segment::open(values_segment_path(&self.good, 0, 0), SegmentKind::Values, None)?;
        let mut inputs = vec![];
        for (segment, kinds) in [(&mesh, &[0u8, 1, 3, 5, 6][..]), (&values, &[2, 4])] {
            let mut block = vec![];
            for n in 0..segment.block_count().min(12) {
                segment.block(n, &mut block)?;
                inputs.extend(kinds.iter().map(|&k| [&[k], &block[..]].concat()));
            }
        }
        let labels: Vec<i32> = (0..6000).map(|i| i * i / 97 % 1300 / 100).collect();
        let labels = encode_labels(&labels, [20, 30, 10]).map_err(|e| Error::usage(e.to_string()))?;
        inputs.push([&[8], &labels[..]].concat());
        Ok(inputs)
    }

    /// Damages the copy, asks it, and repairs it. Gives what was done, for the report.
    pub(crate) fn case(&self, random: &mut Random, what: &mut String) -> Result<()> {
        let outcome = self.damage(random, what).and_then(|()| self.ask());
        self.repair()?;
        outcome
    }

    /// Puts the good files back, also after a panic.
    pub(crate) fn repair(&self) -> Result<()> {
        self.files.iter().try_for_each(|(name, bytes)| put(&self.copy.join(name), bytes))
    }

    fn damage(&self, random: &mut Random, what: &mut String) -> Result<()> {
        match random.below(8) {
            0 | 1 => {
                let (name, bytes) = random.pick(&self.files);
                *what = format!("bytes of {}", name.display());
                put(&self.copy.join(name), &mutate(bytes, b"", random))
            }
            2 | 3 => {
                *what = "the manifest, sealed again".into();
                self.damage_manifest(random, what)
            }
            _ => self.damage_block(random, what),
        }
    }

    /// Changes numbers of the manifest; where the result can be read, all hashes are made to fit
    /// it.
    fn damage_manifest(&self, random: &mut Random, what: &mut String) -> Result<()> {
        let good = Manifest::read(&self.good)?.to_json();
        let text = mutate(good.as_bytes(), good.as_bytes(), random);
        let Ok(mut manifest) = serde_json::from_slice::<Manifest>(&text) else {
            let text = String::from_utf8_lossy(&text);
            return put(&self.copy.join(MANIFEST_NAME), &pack_manifest(&text));
        };
        what.push_str(&format!(": {}", serde_json::json!(manifest)));
        manifest.plan_hash = manifest.plan.hash();
        let (mesh, number) =
            (mesh_segment_path(&self.copy, 0), manifest.steps.first().map(|s| s.plan.number));
        if number == Some(0) && !manifest.mesh.is_empty() && !manifest.steps[0].values.is_empty() {
            manifest.mesh[0].info = reseal(&mesh, SegmentKind::Mesh, manifest.plan_hash, |_, _| {})?;
            let hash = manifest.steps[0].plan.hash(manifest.plan_hash);
            let values = values_segment_path(&self.copy, 0, 0);
            manifest.steps[0].values[0].info = reseal(&values, SegmentKind::Values, hash, |_, _| {})?;
            manifest.steps[0].index =
                Some(reseal(&index_path(&self.copy, 0), SegmentKind::Index, hash, |_, _| {})?);
        }
        manifest.write(&self.copy)
    }

    /// Damages a block behind good checksums; of a compressed block, mostly what it expands to.
    fn damage_block(&self, random: &mut Random, what: &mut String) -> Result<()> {
        let mut manifest = Manifest::read(&self.good)?;
        let hash = manifest.steps[0].plan.hash(manifest.plan_hash);
        let step = &mut manifest.steps[0];
        let (path, kind, plan, info) = match random.below(3) {
            0 => (
                mesh_segment_path(&self.copy, 0),
                SegmentKind::Mesh,
                manifest.plan_hash,
                &mut manifest.mesh[0].info,
            ),
            1 => (values_segment_path(&self.copy, 0, 0), SegmentKind::Values, hash, &mut step.values[0].info),
            _ => (index_path(&self.copy, 0), SegmentKind::Index, hash, step.index.get_or_insert_default()),
        };
        let block = random.next() % info.blocks;
        *what = format!("block {block} of {}, sealed again", path.display());
        *info = reseal(&path, kind, plan, |n, bytes| {
            if n == block {
                *bytes = damaged_block(bytes, random);
            }
        })?;
        manifest.write(&self.copy)
    }

    fn ask(&self) -> Result<()> {
        let out = self.copy.with_extension("ply");
        let archive = isospan::Archive::open(&self.copy)?.keeping(0);
        let query = archive.query(ISOVALUE).resources(Resources::default().with_threads(1));
        let outcomes = [
            archive.check().map(drop),
            archive.count(ISOVALUE).map(drop),
            query.write(&out).map(drop),
            query.clone().cap(true).write(&out).map(drop),
            archive.info().map(drop),
        ];
        outcomes.into_iter().collect()
    }
}

fn damaged_block(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    const FRAME: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
    let frame = bytes.windows(4).take(12).position(|w| w == FRAME);
    let expand = |at: usize| zstd::bulk::decompress(&bytes[at..], 1 << 20).ok();
    match frame.and_then(|at| Some((at, expand(at)?))) {
        Some((at, body)) if random.below(4) > 0 => {
            let start =
                if random.below(4) == 0 { mutate(&bytes[..at], b"", random) } else { bytes[..at].to_vec() };
            let packed = zstd::bulk::compress(&mutate(&body, b"", random), 1).unwrap_or_default();
            [start, packed].concat()
        }
        _ => mutate(bytes, b"", random),
    }
}

/// Writes a segment again, with good checksums, under a plan hash and with blocks changed by
/// `edit`.
fn reseal(
    path: &Path,
    kind: SegmentKind,
    plan: PlanHash,
    mut edit: impl FnMut(u64, &mut Vec<u8>),
) -> Result<SegmentInfo> {
    let segment = Segment::open(path, kind, None)?;
    let mut blocks = vec![];
    for n in 0..segment.block_count() {
        let mut block = vec![];
        segment.block(n, &mut block)?;
        edit(n, &mut block);
        blocks.push(block);
    }
    let mut writer = SegmentWriter::create(path, kind, plan)?;
    for block in &blocks {
        writer.push_block(block)?;
    }
    writer.finish()
}
