//! An archive at one of its steps, or at a moment between two. Questions are asked of such a view.
//!
//! ```text
//!  OpenArchive: manifest, mesh, all value segments ◀── StepView: a step, its index, its cached blocks
//! ```
//!
//! A view never changes its step. Views of one archive share the files of its mesh, and can be used
//! at the same time. Files of values are closed with the view.

use super::archive::{OpenArchive, bytes_read, expect_recorded};
use super::block_cache::BlockCache;
use super::choice::{Moment, StepChoice};
use super::pools::BufferPool;
use super::pyramid::PyramidStep;
use crate::archive::chunked::ChunkSegment;
use crate::archive::manifest::{BaseStep, StepPlan, StoredStep};
use crate::archive::segment::{PlanHash, Segment, SegmentKind};
use crate::index::{SpanIndex, index_entries};
use crate::pipeline::plan::Layout;
use isospan_io::error::{Error, Result};
use isospan_io::grid::ChunkId;
use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// The files that hold a range of chunks at a step.
pub(in crate::pipeline) struct OpenSegment {
    pub(in crate::pipeline) mesh: Arc<ChunkSegment>,
    pub(in crate::pipeline) values: Arc<ChunkSegment>,
}

impl OpenSegment {
    /// The files, that of the mesh only if it is asked for.
    pub(in crate::pipeline) fn files(&self, with_mesh: bool) -> impl Iterator<Item = &Segment> {
        let mesh = with_mesh.then_some(&self.mesh);
        mesh.into_iter().chain([&self.values]).map(|file| file.segment())
    }
}

/// An archive at one of its steps, or at a moment between two. It has from the archive what all
/// steps share.
pub(in crate::pipeline) struct StepView {
    archive: Arc<OpenArchive>,
    pub(super) moment: Moment,
    /// The files of the step.
    pub(in crate::pipeline) layout: Layout,
    /// Value segments by number and position of the step: its own, and those that its values refer
    /// to.
    values: Mutex<BTreeMap<(u64, usize), Arc<ChunkSegment>>>,
    /// Bytes read from value segments that are closed again.
    read_before: AtomicU64,
    /// Decoded blocks for the next question.
    pub(in crate::pipeline) cache: BlockCache,
    /// Buffers for it, while blocks are cached.
    pub(in crate::pipeline) spare: BufferPool,
    /// Segments of ranges of a pyramid, by number.
    ranges: Mutex<BTreeMap<u64, Arc<ChunkSegment>>>,
    /// The levels of a pyramid, once they were asked for.
    pub(super) pyramid: OnceLock<PyramidStep>,
    /// The step behind a moment between two, of a pyramid.
    next: OnceLock<Box<StepView>>,
    /// The step that its tiles may refer to, of a pyramid.
    base: OnceLock<Option<Box<StepView>>>,
    /// Whether this is the base of another step, and answers no question itself.
    pub(super) is_base: bool,
}

impl Deref for StepView {
    type Target = OpenArchive;

    fn deref(&self) -> &OpenArchive {
        &self.archive
    }
}

impl OpenArchive {
    /// The archive at the step at a position in the manifest.
    pub(in crate::pipeline) fn step_at(self: &Arc<Self>, position: usize) -> StepView {
        StepView::new(Arc::clone(self), Moment { step: position, beyond: None })
    }

    /// The archive at a step, or at a time.
    pub(in crate::pipeline) fn at(self: &Arc<Self>, choice: StepChoice) -> Result<StepView> {
        let moment = Moment::of(&self.manifest, choice, self.path())?;
        if moment.beyond.is_some() && self.manifest.plan.has_labels() {
            return Err(Error::usage(format!(
                "{}: labels are known at steps, and not between them: choose one with `step`",
                self.path().display()
            )));
        }
        Ok(StepView::new(Arc::clone(self), moment))
    }
}

impl StepView {
    fn new(archive: Arc<OpenArchive>, moment: Moment) -> Self {
        Self {
            layout: archive.layout_at(moment.step),
            archive,
            moment,
            values: Mutex::default(),
            read_before: AtomicU64::new(0),
            cache: BlockCache::default(),
            spare: BufferPool::default(),
            ranges: Mutex::default(),
            pyramid: OnceLock::new(),
            next: OnceLock::new(),
            base: OnceLock::new(),
            is_base: false,
        }
    }

    /// The same, with a cache of about `bytes` bytes of decoded blocks.
    pub(in crate::pipeline) fn keeping(self, bytes: usize) -> Self {
        Self { cache: BlockCache::new(bytes), ..self }
    }

    /// Bytes that are cached now.
    pub(in crate::pipeline) fn kept_bytes(&self) -> usize {
        self.cache.bytes() + self.pyramid.get().map_or(0, PyramidStep::cached_bytes)
    }

    /// The whole archive.
    pub(in crate::pipeline) fn archive(&self) -> &Arc<OpenArchive> {
        &self.archive
    }

    /// The step, or the one before the moment.
    pub(in crate::pipeline) fn step(&self) -> &StoredStep {
        self.manifest.step_at(self.moment.step)
    }

    /// The time, where the input states one.
    pub(in crate::pipeline) fn time(&self) -> Option<f64> {
        let time = self.step().plan.time?;
        let Some(share) = self.moment.beyond else { return Some(time) };
        let next = self.manifest.step_at(self.moment.step + 1).plan.time?;
        Some(time + share * (next - time))
    }

    /// The step behind a moment between two, and how far that is from the step before.
    pub(super) fn next_step(&self) -> Option<(&Self, f64)> {
        let share = self.moment.beyond?;
        let make = || Box::new(self.archive.step_at(self.moment.step + 1).keeping(self.cache.most()));
        Some((self.next.get_or_init(make), share))
    }

    /// The step that its tiles may refer to.
    pub(super) fn base(&self) -> Option<&Self> {
        let make = |position| Box::new(Self { is_base: true, ..self.archive.step_at(position) });
        let base = || self.manifest.base_of(self.moment.step).map(make);
        self.base.get_or_init(base).as_deref()
    }

    /// Whether the values of a step may refer to this one.
    pub(in crate::pipeline) fn is_base_of(&self, plan: &StepPlan) -> bool {
        plan.base == Some(BaseStep { number: self.step().plan.number, hash: self.step_hash() })
    }

    /// The view, with that of the step before: if that is the base, tiles are found in its cache.
    pub(in crate::pipeline) fn after(self, before: Option<Self>) -> Self {
        if let Some(before) = before.filter(|before| before.is_base_of(&self.step().plan)) {
            _ = self.base.set(Some(Box::new(before.without_base())));
        }
        self
    }

    /// The view without the tiles of its base, which is opened again if they are needed.
    pub(in crate::pipeline) fn without_base(self) -> Self {
        Self { base: OnceLock::new(), ..self }
    }

    /// Its position in the manifest.
    pub(in crate::pipeline) fn position(&self) -> usize {
        self.moment.step
    }

    /// The names of all fields that the archive has at this moment.
    pub(in crate::pipeline) fn fields(&self) -> Vec<&str> {
        self.moment.fields(&self.manifest)
    }

    /// The same moment, of another field.
    pub(in crate::pipeline) fn in_field(&self, field: &str) -> Result<Self> {
        let moment = self.moment.in_field(&self.manifest, field, self.path())?;
        Ok(Self::new(Arc::clone(&self.archive), moment))
    }

    /// Whether this is a moment between two steps, for which nothing is stored.
    pub(in crate::pipeline) fn is_between(&self) -> bool {
        self.moment.beyond.is_some()
    }

    /// Whether tetrahedra may be missing within the domain: only there does a surface touch itself.
    pub(in crate::pipeline) fn may_have_holes(&self) -> bool {
        let step = self.step();
        step.void_points > 0 || step.plan.source.mesh.is_some()
    }

    pub(in crate::pipeline) fn step_hash(&self) -> PlanHash {
        self.step().plan.hash(self.manifest.plan_hash)
    }

    /// The index; that of a small archive is made of the ranges of its chunks.
    pub(in crate::pipeline) fn index(&self) -> Result<SpanIndex> {
        let Some(recorded) = &self.step().index else {
            let mut entries = vec![];
            for chunk in 0..self.manifest.counts.chunks {
                let file = self.summaries_of(ChunkId(chunk))?;
                let summary = file.value_summary(ChunkId(chunk))?;
                entries.extend(index_entries(chunk, &summary.ranges));
            }
            return Ok(SpanIndex::of_entries(entries));
        };
        let index = SpanIndex::open(self.layout.index(), Some(self.step_hash())).map_err(|e| self.lost(e))?;
        index.segment().map_or(Ok(()), |file| expect_recorded(file, Some(recorded)))?;
        Ok(index)
    }

    /// Refuses a chunk that an index names and that is not there.
    pub(in crate::pipeline) fn expect_chunk(&self, id: ChunkId) -> Result<()> {
        if id.0 >= self.chunks.len() {
            let got = format!("an entry of chunk {}", id.0);
            return Err(Error::bad_input(
                self.layout.index(),
                "entries",
                format!("chunks below {}", self.chunks.len()),
                got,
            ));
        }
        Ok(())
    }

    /// Refuses a brick that an index names and that is not there.
    pub(in crate::pipeline) fn expect_block(&self, id: ChunkId, block: u32, count: usize) -> Result<()> {
        if (block as usize) < count {
            return Ok(());
        }
        let (expected, got) = (format!("bricks below {count} of chunk {}", id.0), block.to_string());
        Err(Error::bad_input(self.layout.index(), "entries", expected, got))
    }

    /// The segments of a number.
    pub(in crate::pipeline) fn segment(&self, number: u64) -> Result<OpenSegment> {
        self.expect_tetrahedra()?;
        Ok(OpenSegment {
            mesh: self.mesh_segment(number)?,
            values: self.values_segment(self.position(), number)?,
        })
    }

    /// The segments that have a chunk.
    pub(in crate::pipeline) fn segment_of(&self, chunk: ChunkId) -> Result<OpenSegment> {
        self.segment(self.layout.segment_of(chunk))
    }

    /// The value segment of a step, by its position in the manifest, and a number.
    fn values_segment(&self, step: usize, number: u64) -> Result<Arc<ChunkSegment>> {
        let mut open = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(segment) = open.get(&(number, step)) {
            return Ok(Arc::clone(segment));
        }
        let StoredStep { plan, values, .. } = self.manifest.step_at(step);
        let (path, hash) = (self.layout_at(step).values(number), plan.hash(self.manifest.plan_hash));
        let record = values.get(number as usize);
        let segment = Arc::new(self.chunk_segment(&path, SegmentKind::Values, hash, number, record)?);
        open.insert((number, step), Arc::clone(&segment));
        Ok(segment)
    }

    /// The value segment of a step, by its position in the manifest, that has a chunk.
    pub(in crate::pipeline) fn values_of(&self, step: usize, chunk: ChunkId) -> Result<Arc<ChunkSegment>> {
        self.values_segment(step, self.layout.segment_of(chunk))
    }

    /// The segment of the ranges of a pyramid that has a chunk.
    pub(in crate::pipeline) fn ranges_of(&self, chunk: ChunkId) -> Result<Arc<ChunkSegment>> {
        let number = self.layout.segment_of(chunk);
        let mut open = self.ranges.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(segment) = open.get(&number) {
            return Ok(Arc::clone(segment));
        }
        let (path, record) = (self.layout.ranges(number), self.step().ranges.get(number as usize));
        let hash = self.step_hash();
        let segment = Arc::new(self.chunk_segment(&path, SegmentKind::Ranges, hash, number, record)?);
        open.insert(number, Arc::clone(&segment));
        Ok(segment)
    }

    /// The segment with the summary of a chunk.
    pub(in crate::pipeline) fn summaries_of(&self, chunk: ChunkId) -> Result<Arc<ChunkSegment>> {
        match self.is_pyramid() {
            true => self.ranges_of(chunk),
            false => self.values_of(self.position(), chunk),
        }
    }

    /// Closes the segments before that of a chunk: their files, and the cached pages of their
    /// directories.
    pub(in crate::pipeline) fn close_before(&self, chunk: ChunkId) {
        let number = self.layout.segment_of(chunk);
        self.close_meshes_before(number);
        let mut open = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        let later = open.split_off(&(number, 0));
        let closed = std::mem::replace(&mut *open, later);
        self.read_before.fetch_add(bytes_read(closed.values()), Ordering::Relaxed);
    }

    /// Bytes read so far for this view, and of the mesh also for others.
    pub(in crate::pipeline) fn bytes_read(&self) -> u64 {
        self.mesh_bytes_read() + self.value_bytes_read()
    }

    /// Bytes read so far of values for this view.
    pub(in crate::pipeline) fn value_bytes_read(&self) -> u64 {
        let open = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        self.read_before.load(Ordering::Relaxed) + bytes_read(open.values())
    }

    /// Bytes of all files of the archive.
    pub(in crate::pipeline) fn bytes(&self) -> Result<u64> {
        self.file_bytes()
    }
}
