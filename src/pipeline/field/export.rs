//! `export`: the reduced tetrahedra as a mesh for other programs, each point once.

use crate::files::tets::arrays::{PACKING_BYTES, TetField, TetMeta};
use crate::files::tets::{TetFormat, write_tetrahedra};
use crate::pipeline::plan::estimate;
use crate::pipeline::read::{
    Blocks, Cut, DecodedChunk, Frontier, IndexToWorld, Roi, RoiSpace, StepView, Visit,
};
use crate::pipeline::stage::{Stage, StageSeconds};
use crate::tets::{ChunkTets, StoredTets, TetBuilder};
use isospan_io::bytes::publish::folder_of;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Resources, pool};
use isospan_io::grid::ChunkId;
use isospan_mesh::mesh::tet::Tet;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;

/// Which corners of a tetrahedron must have a value in the range (as VTK's threshold filter asks).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Corners {
    /// All four.
    #[default]
    All,
    /// At least one.
    Any,
}

/// What is exported.
#[derive(Clone, Debug)]
pub struct ExportSettings {
    /// The fields whose values are written, of those that the archive has at the moment of the
    /// step ([`Step::fields_here`](crate::pipeline::Step::fields_here)); that of the step alone
    /// where none is named.
    pub fields: Vec<String>,
    /// Only tetrahedra with values in this range, both ends included: those of the first field.
    pub range: Option<[f64; 2]>,
    /// How many of their corners.
    pub corners: Corners,
    /// Only tetrahedra whose bounding box touches this box.
    pub roi: Option<Roi>,
    /// Only each n-th of these, in the order of the file; 1 is all.
    pub every: u64,
    /// Compresses the file's arrays (zlib).
    pub compress: bool,
    /// Threads, memory, scratch folder, and what stops it.
    pub resources: Resources,
}

impl Default for ExportSettings {
    fn default() -> Self {
        Self {
            fields: vec![],
            range: None,
            corners: Corners::All,
            roi: None,
            every: 1,
            compress: false,
            resources: Resources::default(),
        }
    }
}

/// What an export wrote and read.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct ExportReport {
    /// The fields whose values were written.
    pub fields: Vec<String>,
    /// Points written.
    pub points: u64,
    /// Tetrahedra written.
    pub tetrahedra: u64,
    /// Tetrahedra of the archive.
    pub archive_tetrahedra: u64,
    /// Tetrahedra with a corner without value, which are never written, in the blocks that were
    /// read. Of several fields, those that have such a corner in each field; with a range, in the
    /// first.
    pub void_tetrahedra: u64,
    /// Chunks read.
    pub chunks_read: u64,
    /// Chunks of the archive.
    pub chunks: u64,
    /// Bytes read of segments.
    pub bytes_read: u64,
    /// Bytes of the file written.
    pub file_bytes: u64,
    /// Seconds of wall time of each stage.
    #[serde(serialize_with = "crate::pipeline::stage::by_name")]
    pub seconds: StageSeconds,
}

/// Bytes while a shared point is open: its entry in the table, which is at most half full, twice
/// while it grows.
const OPEN_POINT: u64 = 100;

/// Writes the tetrahedra of an archive to a file: see
/// [`Step::write_tetrahedra`](crate::pipeline::Step::write_tetrahedra).
pub(in crate::pipeline) fn export(
    archive: &StepView,
    settings: &ExportSettings,
    out: &Path,
    progress: &dyn Progress,
) -> Result<ExportReport> {
    let Some((first, others)) = settings.fields.split_first() else {
        return export_fields(archive, &[], settings, out, progress);
    };
    if let Some(twice) = others.iter().enumerate().find(|(n, name)| settings.fields[..=*n].contains(name)) {
        return Err(Error::usage(format!("the field {} is asked for twice", twice.1)));
    }
    let others = others.iter().map(|name| archive.in_field(name)).collect::<Result<Vec<_>>>()?;
    export_fields(&archive.in_field(first)?, &others, settings, out, progress)
}

/// Writes the values of a view and of `others`, which are further fields of the same moment.
fn export_fields(
    archive: &StepView,
    others: &[StepView],
    settings: &ExportSettings,
    out: &Path,
    progress: &dyn Progress,
) -> Result<ExportReport> {
    let start = Instant::now();
    if settings.roi.is_some_and(|roi| roi.space == RoiSpace::World) {
        archive.refuse_coordinates("an export of a box of the world")?;
    }
    let format = TetFormat::from_path(out)?;
    if settings.every == 0 {
        return Err(Error::usage(
            "of every 0 tetrahedra there is no first: give 1 for all, 2 for half of them",
        ));
    }
    let read_before = archive.bytes_read();
    let wanted = WantedTets::of(archive, others, settings)?;
    let (blocks, index_bytes) = wanted.blocks(archive)?;
    let fixed = estimate::BASE + blocks.bytes() + if settings.compress { PACKING_BYTES } else { 0 };
    let rest = settings.resources.memory.saturating_sub(fixed);
    let share = |memory: u64| memory.saturating_sub(fixed) / 4 * 3;
    let mut visit = Visit::new(archive, blocks, &settings.resources, share)?;
    if let Some(cut) = &wanted.cut {
        visit.confine(|region| cut.may_touch_box(region))?;
    }
    let extra = visit.most_vertices() * 4 * others.len() as u64;
    visit.check_memory(extra)?;
    let scratch = settings.resources.scratch.clone().unwrap_or_else(|| folder_of(out).to_path_buf());
    let mut join = Join::new(&visit, others, settings, rest / 8, &scratch);
    progress.begin("export", visit.chunks.len() as u64, "chunks");
    visit.each(extra, progress, |id, chunk| wanted.select(id, chunk), |n, chosen| join.push(n, &chosen))?;
    let (void_tetrahedra, mesh) = (join.void, join.builder.finish());
    let read = start.elapsed();

    let start = Instant::now();
    let (fields, file_bytes) = write_mesh(archive, others, settings, &mesh, out, format)?;
    // Of the mesh, the archive counts the bytes of all.
    let bytes_of_others = others.iter().map(StepView::value_bytes_read).sum::<u64>();
    Ok(ExportReport {
        fields,
        points: mesh.point_count(),
        tetrahedra: mesh.tet_count(),
        archive_tetrahedra: archive.manifest.counts.tetrahedra,
        void_tetrahedra,
        chunks_read: visit.chunks.len() as u64,
        chunks: archive.chunks.len(),
        bytes_read: archive.bytes_read() - read_before + index_bytes + bytes_of_others,
        file_bytes,
        seconds: vec![(Stage::Join, read.as_secs_f64()), (Stage::Write, start.elapsed().as_secs_f64())],
    })
}

/// Writes the joined tetrahedra. Returns the names of their fields and the bytes of the file.
fn write_mesh(
    archive: &StepView,
    others: &[StepView],
    settings: &ExportSettings,
    mesh: &StoredTets,
    out: &Path,
    format: TetFormat,
) -> Result<(Vec<String>, u64)> {
    let (place, lattice) = (IndexToWorld::of(archive)?, archive.manifest.plan.lattice);
    let path = &archive.step().plan.source.path;
    let threads = settings.compress.then(|| pool(settings.resources.threads)).transpose()?;
    let meta = TetMeta {
        place: &|p| place.world(lattice.to_index_space(p)),
        mirrors: place.mirrors(),
        fields: std::iter::once(archive).chain(others).map(field_of).collect(),
        comment: format!("isospan {}: reduced tetrahedra of {path}", env!("CARGO_PKG_VERSION")),
        compress: threads.as_ref(),
    };
    let bytes = write_tetrahedra(mesh, out, format, &meta)?;
    Ok((meta.fields.into_iter().map(|field| field.name).collect(), bytes))
}

/// A field, as a file states it: by the name that it has in the archive.
fn field_of(view: &StepView) -> TetField {
    let step = view.step();
    TetField { name: step.field().to_owned(), offset: step.plan.source.offset }
}

/// A chunk with the tetrahedra that are wanted, the values of each further field, and the number
/// of void tetrahedra.
struct Selected {
    chunk: DecodedChunk,
    others: Vec<Vec<f32>>,
    void: u64,
}

/// Which tetrahedra of a chunk are wanted, with which further fields.
struct WantedTets<'a> {
    range: Option<[f32; 2]>,
    corners: Corners,
    cut: Option<Cut>,
    others: &'a [StepView],
}

impl<'a> WantedTets<'a> {
    fn of(archive: &StepView, others: &'a [StepView], settings: &ExportSettings) -> Result<Self> {
        let source = &archive.step().plan.source;
        let log2_steps = archive.manifest.plan.lattice.log2_steps;
        let cut = |roi: Roi| roi.cut(&source.geometry, source.dims, log2_steps, [0.0; 3]);
        Ok(Self {
            range: settings.range.map(|range| range.map(|v| source.kept(v))),
            corners: settings.corners,
            cut: settings.roi.map(cut).transpose()?,
            others,
        })
    }

    /// The blocks that may have such tetrahedra, and the bytes of the index that were read.
    fn blocks(&self, archive: &StepView) -> Result<(Blocks, u64)> {
        let Some([lo, hi]) = self.range else { return Ok((Blocks::All, 0)) };
        let index = archive.ranges()?;
        let entries = index.query_values(lo, hi)?;
        Ok((Blocks::Some(entries), index.bytes_read()))
    }

    /// The tetrahedra of a chunk that are wanted.
    fn select(&self, id: ChunkId, mut chunk: DecodedChunk) -> Result<Selected> {
        let mut void = 0;
        let has_all = |values: &[f32], tet: &Tet| tet.iter().all(|&v| !values[v as usize].is_nan());
        let (values, positions) = (&chunk.values, &chunk.positions);
        chunk.tets.retain(|tet: &Tet| {
            if self.cut.as_ref().is_some_and(|cut| !cut.touches(&tet.map(|v| positions[v as usize]))) {
                return false;
            }
            let Some(range) = self.range else { return true };
            let has_all = has_all(values, tet);
            void += u64::from(!has_all);
            has_all && in_range(tet.map(|v| values[v as usize]), range, self.corners)
        });
        let others = self.others.iter().map(|view| view.values_of_tets(id, positions.len(), &chunk.tets));
        let others = others.collect::<Result<Vec<_>>>()?;
        if self.range.is_none() {
            chunk.tets.retain(|tet| {
                let has_any = has_all(values, tet) || others.iter().any(|values| has_all(values, tet));
                void += u64::from(!has_any);
                has_any
            });
        }
        Ok(Selected { chunk, others, void })
    }
}

fn in_range(values: [f32; 4], [lo, hi]: [f32; 2], corners: Corners) -> bool {
    let inside = |v: &f32| (lo..=hi).contains(v);
    match corners {
        Corners::All => values.iter().all(inside),
        Corners::Any => values.iter().any(inside),
    }
}

/// Joins chunks, in order, and closes points that no chunk to come can have.
struct Join<'a> {
    visit: &'a Visit<'a>,
    others: &'a [StepView],
    builder: TetBuilder,
    every: u64,
    /// Tetrahedra that passed so far.
    passed: u64,
    void: u64,
    /// Made when first needed.
    frontier: Option<Frontier>,
    memory: u64,
    most_open: u64,
    look_at: u64,
}

impl<'a> Join<'a> {
    /// `share` bytes for finished records, and as many for open points.
    fn new(
        visit: &'a Visit<'a>,
        others: &'a [StepView],
        settings: &ExportSettings,
        share: u64,
        scratch: &Path,
    ) -> Self {
        let most_open = share / OPEN_POINT;
        let records = usize::try_from(share).unwrap_or(usize::MAX);
        Self {
            visit,
            others,
            builder: TetBuilder::new(1 + others.len(), records, scratch),
            every: settings.every,
            passed: 0,
            void: 0,
            frontier: None,
            memory: settings.resources.memory,
            most_open,
            look_at: most_open / 64 + 1,
        }
    }

    /// Adds the n-th chunk.
    fn push(&mut self, n: usize, selected: &Selected) -> Result<()> {
        let chunk = &selected.chunk;
        self.void += selected.void;
        let each_nth: Vec<Tet>;
        let tets = if self.every == 1 {
            &chunk.tets
        } else {
            let first = (self.every - self.passed % self.every) % self.every;
            let step = usize::try_from(self.every).unwrap_or(usize::MAX);
            each_nth = chunk.tets.iter().copied().skip(first as usize).step_by(step).collect();
            &each_nth
        };
        self.passed += chunk.tets.len() as u64;
        let others = selected.others.iter().map(Vec::as_slice);
        self.builder.push(&ChunkTets {
            positions: &chunk.positions,
            ids: &chunk.ids,
            values: &std::iter::once(&*chunk.values).chain(others).collect::<Vec<_>>(),
            shared: &chunk.shared,
            tets,
        })?;
        self.others.iter().for_each(|view| view.close_before(self.visit.chunks[n]));
        self.close_points(n + 1)
    }

    fn close_points(&mut self, done: usize) -> Result<()> {
        if (self.builder.open_points() as u64) < self.look_at {
            return Ok(());
        }
        let archive = self.visit.archive;
        let frontier = match self.frontier.take() {
            Some(frontier) => frontier,
            None => Frontier::new(archive, self.visit.chunks.iter().copied())?,
        };
        let beyond = self.frontier.insert(frontier).after(done);
        self.builder.keep_open(|id| archive.points.position(id).is_none_or(|p| beyond.can_have(p, p)));
        let open = self.builder.open_points() as u64;
        if open > self.most_open {
            let needed = self.memory.saturating_add(8 * (open - self.most_open) * OPEN_POINT);
            return Err(Error::memory("for points that chunks share", needed, self.memory));
        }
        self.look_at = (2 * open).clamp(self.most_open / 64 + 1, self.most_open + 1);
        Ok(())
    }
}
