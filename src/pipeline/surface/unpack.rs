//! `isospan unpack`: writes a precomputed copy of a step's blocks, in the form in which surfaces
//! use them.
//!
//! ```text
//!  a chunk: its blocks, decoded ──▶ precomputed (crate::surface::extract) ──▶ edges joined ──▶ words ──▶ in order ──▶ steps/N-unpacked.seg
//! ```
//!
//! The copy depends on the archive and the range alone: the same bytes for any number of threads.
//! The file appears when it is complete, and names the segments that it was made of. `unpacked`
//! uses it.

use crate::archive::chunked::{BlockRange, MeshSizes};
use crate::archive::manifest::{Manifest, steps_folder, unpacked_path, unpacked_step};
use crate::archive::mesh::{Unpacked, UnpackedChunk, UnpackedWriter};
use crate::bytes::publish::sync_folders;
use crate::bytes::remote::is_remote;
use crate::error::{Error, Result};
use crate::exec::{Progress, Resources, Threads, in_order};
use crate::grid::ChunkId;
use crate::pipeline::plan::estimate;
use crate::pipeline::read::{
    BufferPool, Buffers, ChunkReader, Moment, Needed, OpenArchive, StepChoice, StepRange, StepView, Wanted,
    bytes_per_vertex, world_map,
};
use crate::surface::WorldMap;
use crate::surface::extract::{Joiner, PrecomputedBlock};
use serde::Serialize;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What is unpacked, and how.
#[derive(Clone, Debug)]
pub struct UnpackSettings {
    /// The step.
    pub step: StepChoice,
    /// Several steps, in place of one.
    pub steps: Option<StepRange>,
    /// The field of a range of steps, where each has several.
    pub field: Option<String>,
    /// Only blocks that can answer isovalues from the first to the second; surfaces at others
    /// decode blocks.
    pub range: [f64; 2],
    /// Leave the steps as they are that are unpacked for the range already.
    pub keep: bool,
    /// Threads, memory, scratch folder, and what stops it.
    pub resources: Resources,
}

impl Default for UnpackSettings {
    fn default() -> Self {
        Self {
            step: StepChoice::First,
            steps: None,
            field: None,
            range: EVERYTHING,
            keep: false,
            resources: Resources::default(),
        }
    }
}

/// All isovalues.
const EVERYTHING: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// What was unpacked, or removed.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct UnpackReport {
    /// The files.
    pub files: Vec<UnpackedFile>,
    /// Bytes of all of them.
    pub bytes: u64,
}

/// A file of unpacked blocks.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct UnpackedFile {
    /// Number of its step.
    pub step: u64,
    /// The file.
    pub file: PathBuf,
    /// Its length.
    pub bytes: u64,
    /// Blocks in it, and their tetrahedra.
    pub blocks: u64,
    /// See `blocks`.
    pub tetrahedra: u64,
    /// Blocks that are available only packed: out of the range, without a value, or too large.
    pub packed_blocks: u64,
}

/// Bytes of a tetrahedron while its chunk is unpacked: known, joined, an edge in a table; and in
/// the file.
const BYTES_PER_TET: u64 = 192;
const BYTES_ON_DISK: u64 = 64;
/// What a chunk of any size takes.
const PER_CHUNK: u64 = 4 << 20;

/// What [`unpack`] will write.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct UnpackNeed {
    /// Bytes of the new files, about; seldom more.
    pub bytes: u64,
    /// Tetrahedra in them.
    pub tetrahedra: u64,
    /// Steps that stay as they are, for they are unpacked for the range already.
    pub unpacked: u64,
    /// Number of the first step that is unpacked for another range.
    pub other_range: Option<u64>,
    /// Bytes that are free where they go (a file is replaced when the new one is complete); `None`
    /// where the system does not say.
    pub free: Option<u64>,
}

/// What [`unpack`] will write with these settings; nothing is written.
///
/// # Errors
/// As [`unpack`]; [`Error::Budget`] when the disk does not have room for it.
pub fn unpack_need(path: &Path, settings: &UnpackSettings) -> Result<UnpackNeed> {
    let (archive, positions) = open_chosen(path, settings)?;
    let (mut tetrahedra, mut unpacked, mut other_range) = (0, 0, None);
    for view in positions.map(|n| archive.step_at(n)) {
        let range = settings.range.map(|v| view.step().plan.source.kept(v));
        match unpacked_range(&view) {
            Some(of_file) if settings.keep && holds(of_file, range) => {
                unpacked += 1;
                continue;
            }
            Some(of_file) if !holds(of_file, range) => {
                other_range = other_range.or(Some(view.step().plan.number));
            }
            _ => {}
        }
        tetrahedra += parts_of(&view, range)?.iter().map(|part| part.wanted_tets).sum::<u64>();
    }
    let bytes = tetrahedra * BYTES_ON_DISK;
    let free = estimate::free_bytes(archive.path());
    match free {
        Some(available) if available < bytes => Err(Error::disk(archive.path(), bytes, available)),
        _ => Ok(UnpackNeed { bytes, tetrahedra, unpacked, other_range, free }),
    }
}

/// The range that a step is unpacked for. A damaged file counts as none.
fn unpacked_range(view: &StepView) -> Option<[f32; 2]> {
    view.unpacked().ok().flatten().map(|file| file.table().range)
}

/// Whether one range holds another.
fn holds([low, high]: [f32; 2], [least, most]: [f32; 2]) -> bool {
    low <= least && most <= high
}

/// The archive, and the positions of the steps that are meant.
fn open_chosen(path: &Path, settings: &UnpackSettings) -> Result<(Arc<OpenArchive>, std::ops::Range<usize>)> {
    expect_local(path)?;
    let [low, high] = settings.range;
    if low.is_nan() || high.is_nan() || low > high {
        return Err(Error::usage(format!("the range {low} to {high} is empty: give the lower value first")));
    }
    let archive = OpenArchive::open(path)?;
    let positions = chosen(&archive.manifest, settings, path)?;
    Ok((archive, positions))
}

/// Unpacks steps of an archive: surfaces of them read their blocks, about sixty bytes a
/// tetrahedron, where they lie, several times as fast as they decode the few bits that the archive
/// has of each. The surfaces are the same, byte for byte.
///
/// ```
/// # use isospan::{Archive, exec::Silent};
/// use isospan::pipeline::{UnpackSettings, remove_unpacked, unpack};
/// # fn main() -> isospan::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("protein.isospan");
/// # let protein = isospan::Reduction::of("datasets/ironprot.vtk").count(20_000);
/// # protein.points(isospan::points::SetKind::Hammersley).write(&path)?;
/// let before = Archive::open(&path)?.surface(100.0)?;
/// let report = unpack(&path, &UnpackSettings { range: [80.0, 120.0], ..UnpackSettings::default() }, &Silent)?;
/// assert!(report.files[0].tetrahedra > 0);
/// assert_eq!(Archive::open(&path)?.surface(100.0)?, before);
/// assert_eq!(remove_unpacked(&path, &UnpackSettings::default(), false)?.bytes, report.bytes);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`Error::BadInput`] for a damaged archive; [`Error::Usage`] for one on a server, for a moment
/// between two steps, or an empty range; [`Error::Budget`] when memory or disk do not suffice;
/// those of writing the files.
pub fn unpack(path: &Path, settings: &UnpackSettings, progress: &dyn Progress) -> Result<UnpackReport> {
    // All steps at once: disk that does for the first ones alone is found too small before anything
    // is written.
    unpack_need(path, settings)?;
    let (archive, positions) = open_chosen(path, settings)?;
    let mut report = UnpackReport::default();
    for view in positions.map(|n| archive.step_at(n)) {
        let range = settings.range.map(|v| view.step().plan.source.kept(v));
        if settings.keep && unpacked_range(&view).is_some_and(|of_file| holds(of_file, range)) {
            continue;
        }
        let file = unpack_step(&view, settings, progress)?;
        report.bytes += file.bytes;
        report.files.push(file);
    }
    sync_folders([steps_folder(path)])?;
    Ok(report)
}

/// Removes what [`unpack`] has made: of the steps that the settings name if `chosen_only`, else
/// all.
///
/// # Errors
/// When a file cannot be removed.
pub fn remove_unpacked(path: &Path, settings: &UnpackSettings, chosen_only: bool) -> Result<UnpackReport> {
    expect_local(path)?;
    let manifest = Manifest::read(path)?;
    let mut report = UnpackReport::default();
    if chosen_only {
        for position in chosen(&manifest, settings, path)? {
            remove(&mut report, &unpacked_path(path, manifest.steps[position].plan.number))?;
        }
    } else {
        let folder = steps_folder(path);
        let list = |e| Error::io("list", &folder, e);
        let mut files = vec![];
        for entry in fs::read_dir(&folder).map_err(list)? {
            let name = entry.map_err(list)?.file_name().to_string_lossy().into_owned();
            // The files of steps that no longer exist, too.
            if unpacked_step(&name).is_some() {
                files.push(folder.join(name));
            }
        }
        files.sort();
        files.iter().try_for_each(|file| remove(&mut report, file))?;
    }
    sync_folders([steps_folder(path)])?;
    Ok(report)
}

fn remove(report: &mut UnpackReport, file: &Path) -> Result<()> {
    let bytes = fs::metadata(file).map(|about| about.len());
    match bytes.and_then(|bytes| fs::remove_file(file).map(|()| bytes)) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        Err(e) => Err(Error::io("remove", file, e)),
        Ok(bytes) => {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            report.bytes += bytes;
            report.files.push(UnpackedFile {
                step: unpacked_step(&name).expect("only such files are removed"),
                file: file.to_path_buf(),
                bytes,
                ..UnpackedFile::default()
            });
            Ok(())
        }
    }
}

fn expect_local(path: &Path) -> Result<()> {
    if is_remote(path) {
        let path = path.display();
        return Err(Error::usage(format!("{path}: an archive on a server is not unpacked; copy it first")));
    }
    Ok(())
}

/// The positions in the manifest of the steps that are meant.
fn chosen(manifest: &Manifest, settings: &UnpackSettings, path: &Path) -> Result<std::ops::Range<usize>> {
    if let Some(steps) = settings.steps {
        return steps.positions(manifest, settings.field.as_deref(), path);
    }
    let Moment { step, beyond } = Moment::of(manifest, settings.step.clone(), path)?;
    match beyond {
        None => Ok(step..step + 1),
        Some(_) => Err(Error::usage("steps are unpacked, and no moment between two of them")),
    }
}

/// Unpacks a step.
fn unpack_step(
    archive: &StepView,
    settings: &UnpackSettings,
    progress: &dyn Progress,
) -> Result<UnpackedFile> {
    let range = settings.range.map(|v| archive.step().plan.source.kept(v));
    let parts = parts_of(archive, range)?;
    let per_vertex = bytes_per_vertex(archive);
    let bytes: Vec<u64> = parts.iter().map(|part| part.need(per_vertex)).collect();
    let largest = estimate::BASE + bytes.iter().copied().max().unwrap_or(0);
    if settings.resources.memory < largest {
        return Err(Error::memory("", largest, settings.resources.memory));
    }
    let path = archive.layout.unpacked();
    let mut writer = UnpackedWriter::create(&path, archive.unpacked_hash(archive.position()), range)?;
    let step = archive.step().number();
    progress.begin(&format!("unpack step {step}"), parts.len() as u64, "chunks");
    let threads = Threads::new(settings.resources.threads)?;
    let (spare, world) = (BufferPool::default(), world_map(archive));
    let make = |n: usize| {
        settings.resources.cancel.check()?;
        let mut buffers = spare.buffers();
        let made = MadeChunk::of(archive, ChunkId(n as u64), range, &world, &mut buffers)?;
        spare.give_buffers(buffers);
        Ok(made)
    };
    let mut file = UnpackedFile { step, file: path, ..UnpackedFile::default() };
    let memory = settings.resources.memory - estimate::BASE;
    in_order(&bytes, memory, &threads, make, |n, made: MadeChunk| {
        archive.close_before(ChunkId(n as u64));
        writer.push(made.corners, made.edges, &made.blocks)?;
        for words in &made.blocks {
            // The third word is the number of tetrahedra of a block.
            match words.get(2) {
                Some(&tets) => {
                    file.blocks += 1;
                    file.tetrahedra += u64::from(tets);
                }
                None => file.packed_blocks += 1,
            }
        }
        progress.advance(1);
        Ok(())
    })?;
    file.bytes = writer.finish()?.bytes;
    Ok(file)
}

/// What is known of a chunk before it is unpacked.
struct ChunkOutline {
    sizes: MeshSizes,
    wanted_tets: u64,
}

impl ChunkOutline {
    fn need(&self, per_vertex: u64) -> u64 {
        let vertices = u64::from(self.sizes.core) + u64::from(self.sizes.halo);
        let tets = self.wanted_tets.saturating_mul(BYTES_PER_TET);
        PER_CHUNK.saturating_add(vertices.saturating_mul(per_vertex)).saturating_add(tets)
    }
}

/// Reads the summaries of all chunks.
fn parts_of(archive: &StepView, range: [f32; 2]) -> Result<Vec<ChunkOutline>> {
    let part = |id: ChunkId| {
        archive.close_before(id);
        let ranges = archive.segment_of(id)?.values.value_summary(id)?.ranges;
        let wanted_tets = ranges.iter().filter(|r| can_answer(r, range)).map(|r| u64::from(r.tets)).sum();
        Ok(ChunkOutline { sizes: archive.mesh_sizes(id)?, wanted_tets })
    };
    let parts = (0..archive.chunks.len()).map(|id| part(ChunkId(id))).collect();
    // The chunks are read again, from the first on.
    archive.close_before(ChunkId(u64::MAX));
    parts
}

/// Whether a block can answer some isovalue in a range.
fn can_answer(block: &BlockRange, [low, high]: [f32; 2]) -> bool {
    block.tets > 0 && block.min < high && low <= block.max
}

/// A chunk, unpacked.
struct MadeChunk {
    corners: u32,
    /// Edges of several blocks that have numbers.
    edges: u32,
    /// The words of each block; none for blocks that are available only packed.
    blocks: Vec<Vec<u32>>,
}

impl MadeChunk {
    fn of(
        archive: &StepView,
        id: ChunkId,
        range: [f32; 2],
        world: &WorldMap,
        buffers: &mut Buffers,
    ) -> Result<Self> {
        let ranges = archive.segment_of(id)?.values.value_summary(id)?.ranges;
        let mut reader = ChunkReader::open(archive, id, std::mem::take(&mut buffers.reader))?;
        let Buffers { block, bench, .. } = buffers;
        let (mut known, mut joiner) = (vec![], Joiner::default());
        let blocks = (0..).zip(&ranges);
        reader.expect_all(blocks.clone().filter(|(_, range)| range.tets > 0).map(|(n, _)| n))?;
        for (n, of_block) in blocks {
            let mut found = None;
            // One without a value has no surface.
            if of_block.tets > 0 {
                reader.block(n, &Wanted::All, &Needed::All, block)?;
                let cells = block.corners.cells(&block.tets);
                found = can_answer(of_block, range).then(|| bench.precompute(&cells, world)).flatten();
                match &found {
                    Some(found) => joiner.add(found),
                    None => joiner.keep_apart(&cells),
                }
            }
            known.push(found);
        }
        let words = |found: Option<PrecomputedBlock>| {
            let mut words = vec![];
            if let Some(found) = found {
                joiner.join(&found, world).store(&mut words);
            }
            words
        };
        let blocks = known.into_iter().map(words).collect();
        let corners = reader.vertices() as u32;
        buffers.reader = reader.into_memory();
        Ok(Self { corners, edges: joiner.count(), blocks })
    }
}

/// Looks whether a chunk's unpacked blocks are those that would be made now.
///
/// # Errors
/// The first that is another.
pub(in crate::pipeline) fn check_unpacked(archive: &StepView, file: &Unpacked, id: ChunkId) -> Result<()> {
    let (world, mut buffers) = (world_map(archive), Buffers::default());
    let made = MadeChunk::of(archive, id, file.table().range, &world, &mut buffers)?;
    let stored = file.chunk(id);
    let at = format!("chunk {}", id.0);
    let wrong = |expected: String, got: String| {
        let help = "make it again with isospan unpack, or remove it with isospan unpack --remove";
        Err(Error::bad_input(file.segment().path(), &at, expected, got).with_help(help))
    };
    let expected =
        UnpackedChunk { corners: made.corners, blocks: made.blocks.len() as u32, edges: made.edges };
    if stored != expected {
        return wrong(format!("{expected:?}"), format!("{stored:?}"));
    }
    let (mut places, mut buffer) = (vec![], vec![]);
    file.places(id, 0..stored.blocks, &mut places)?;
    for (n, (place, words)) in places.iter().zip(&made.blocks).enumerate() {
        if file.words(place, &mut buffer)? != words.as_slice() {
            return wrong(format!("block {n} as the archive has it"), "another".into());
        }
    }
    Ok(())
}
