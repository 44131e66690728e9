//! Copies volumes into bricks: on request, and where an input has no random access.

use crate::pipeline::plan::estimate;
use crate::pipeline::settings::RunSettings;
use isospan_io::bytes::publish;
use isospan_io::error::Result;
use isospan_io::exec::{CancelToken, Progress};
use isospan_io::grid::IndexBox;
use isospan_io::volume::bricked::BrickedVolume;
use isospan_io::volume::chunked::ChunkShape;
use isospan_io::volume::{SlabStream, VolumeInfo, VolumeReader, VolumeSource};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Copies a volume into bricks at `out`, using about `memory` bytes.
///
/// # Errors
/// Those of reading the volume and of writing the file; nothing is left under the name then.
pub fn brick(
    source: VolumeSource,
    out: &Path,
    memory: u64,
    cancel: &CancelToken,
    progress: &dyn Progress,
) -> Result<()> {
    brick_with(BrickedVolume::build, source, out, memory, cancel, progress)
}

/// Whether the file at `out` is the bricked copy of a volume, sample by sample.
///
/// # Errors
/// Those of reading the volume; a file without bricks is not a copy.
pub fn is_bricked(
    source: VolumeSource,
    out: &Path,
    cancel: &CancelToken,
    progress: &dyn Progress,
) -> Result<bool> {
    let Ok(bricks) = BrickedVolume::open(out) else { return Ok(false) };
    progress.begin("compare", source.info().dims.iter().product(), "samples");
    let mut before = 0;
    let stream = Box::new(Stoppable { stream: source.into_stream(), cancel: cancel.clone() });
    bricks.is_copy_of(stream, &mut |done| {
        progress.advance(done - before);
        before = done;
    })
}

/// A function that copies a stream to a file, in so much memory, telling the samples done.
type BuildBricks = fn(Box<dyn SlabStream>, &Path, usize, &mut dyn FnMut(u64)) -> Result<()>;

fn brick_with(
    build: BuildBricks,
    source: VolumeSource,
    out: &Path,
    memory: u64,
    cancel: &CancelToken,
    progress: &dyn Progress,
) -> Result<()> {
    let dims = source.info().dims;
    progress.begin("brick", dims.iter().product(), "samples");
    let mut before = 0;
    let memory = usize::try_from(memory).unwrap_or(usize::MAX);
    let stream = Box::new(Stoppable { stream: source.into_stream(), cancel: cancel.clone() });
    build(stream, out, memory, &mut |done| {
        progress.advance(done - before);
        before = done;
    })
}

/// A stream that ends with [`Error::Cancelled`] when the run is cancelled.
struct Stoppable {
    stream: Box<dyn SlabStream>,
    cancel: CancelToken,
}

impl SlabStream for Stoppable {
    fn info(&self) -> &VolumeInfo {
        self.stream.info()
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        self.cancel.check()?;
        self.stream.next_slab(out)
    }
}

/// Bytes of the copy that is made of a volume without random access, and memory to make it in; 0 of
/// others.
pub(in crate::pipeline) fn copy_bytes(source: &VolumeSource) -> (u64, u64) {
    if let VolumeSource::Random(_) = source {
        return (0, 0);
    }
    let info = source.info();
    // Bricks at the border are padded, and each has a checksum.
    let samples = info.dims.iter().map(|&d| d as f64).product::<f64>();
    let bytes = (samples * info.field.scalar.bytes() as f64 * 1.1) as u64 + (1 << 20);
    (bytes, copying_bytes(source) + COPY_BUFFER)
}

/// The least that slices are collected in while a stream is copied into bricks.
const COPY_BUFFER: u64 = 8 << 20;

/// Memory that copying into bricks takes, besides the slices that are collected: the decoder, a
/// checksum a brick.
fn copying_bytes(source: &VolumeSource) -> u64 {
    let bricks = source.info().dims.iter().map(|d| d.div_ceil(32)).fold(1, u64::saturating_mul);
    let decoder = match source {
        VolumeSource::Random(_) => 0,
        VolumeSource::Chunked(chunks) => ChunkShape::of(&**chunks).stream_bytes(),
        VolumeSource::Stream(stream) => stream.working_bytes(),
    };
    estimate::BASE.saturating_add(decoder).saturating_add(bricks.saturating_mul(8))
}

/// Copies a volume into bricks in the scratch folder; the copy is removed when the second value is
/// dropped.
pub(super) fn copied(
    source: VolumeSource,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<(Box<dyn VolumeReader>, Option<Scratch>)> {
    let rest = run.resources.memory.saturating_sub(copying_bytes(&source));
    let folder = run.resources.scratch_folder();
    // Removes what runs have left that were killed while they copied.
    publish::sweep(&folder);
    let scratch = Scratch::new(&folder);
    brick_with(BrickedVolume::build_scratch, source, &scratch.0, rest / 2, &run.resources.cancel, progress)?;
    let reader = BrickedVolume::open(&scratch.0)?;
    // An open file without a name is gone when the process ends in any way.
    #[cfg(unix)]
    scratch.remove();
    Ok((Box::new(reader), Some(scratch)))
}

/// A file that is removed in the end.
pub(in crate::pipeline) struct Scratch(PathBuf);

impl Scratch {
    fn new(folder: &Path) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Self(folder.join(format!(
            "isospan-scratch-{}-{}-{number}.bricks",
            publish::host(),
            std::process::id()
        )))
    }

    fn remove(&self) {
        // Not there: removed before, or never made.
        let _ = fs::remove_file(&self.0);
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        self.remove();
    }
}
