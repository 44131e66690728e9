//! `check` of an archive: every checksum, and every invariant that ties its parts together.
//!
//! * every block of every segment has its checksum, every table its size;
//! * each brick has the number of points that the point set gives it, each halo id is a point
//!   outside the chunk;
//! * each tetrahedron is positively oriented, belongs to the chunk that holds it, and all together
//!   fill the box exactly;
//! * the ranges of the blocks, of tetrahedra and of values, the entries of the index, and the sums
//!   of the spectrum are those of the values;
//! * the error of a volume's step is that of all chunks together.

use crate::archive::chunked::{BlockRange, MeshSizes, MeshSummary, value_ranges};
use crate::archive::mesh::ChunkHeader;
use crate::archive::segment::{Segment, SegmentKind};
use crate::archive::tables::RepeatedReader;
use crate::archive::values::ValueBlocks;
use crate::index::{Entry, EntryDigest, index_entries};
use crate::pipeline::read::{
    Bench, Brick, DecodedChunk, Meter, OpenArchive, OpenSegment, StepView, bricks_of, chunk_place,
    range_of_cells, used_corners,
};
use crate::pipeline::reduce::strays;
use crate::spectrum::{ChunkPart, Design, SpectrumBuilder};
use isospan_io::bytes::remote::is_remote;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{CancelToken, Threads, in_order};
use isospan_io::grid::{Chunk, ChunkId, IndexBox};
use isospan_mesh::predicates::signed_volume6;
use serde::Serialize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What was verified.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct ArchiveCheck {
    /// Steps.
    pub steps: u64,
    /// Segments, index included.
    pub segments: u64,
    /// Blocks whose checksum was verified.
    pub blocks: u64,
    /// Bytes of the segments.
    pub bytes: u64,
    /// Points.
    pub points: u64,
    /// Tetrahedra.
    pub tetrahedra: u64,
    /// Whether they are those of a mesh, which need not fill the box.
    pub own: bool,
    /// Entries of the index.
    pub index_entries: u64,
    /// Files in the archive's folders that it does not name; nothing reads them.
    pub strays: Vec<PathBuf>,
}

/// Verifies a whole archive, until it is stopped. Cost: reading and decoding all of it.
///
/// # Errors
/// [`Error::BadInput`] that names the first thing that is wrong; [`Error::Cancelled`].
pub(super) fn check_archive(archive: &Arc<OpenArchive>, cancel: &CancelToken) -> Result<ArchiveCheck> {
    let (path, mut check) = (archive.path(), ArchiveCheck::default());
    check.own = archive.manifest.plan.own.is_some();
    if !is_remote(path) {
        check.strays = strays(path, &archive.manifest)?;
    }
    let threads = Threads::new(0)?;
    for step in 0..archive.manifest.steps.len() {
        let view = archive.step_at(step);
        check_step(&view, &threads, cancel, &mut check)?;
        check.steps += 1;
    }
    for base in archive.manifest.steps.len()..archive.manifest.all_steps().count() {
        cancel.check()?;
        check_base(&archive.step_at(base), &mut check)?;
    }
    if let Some(record) = &archive.manifest.plan.repeated {
        let mut pairs = RepeatedReader::open(path, archive.manifest.plan_hash, record)?;
        pairs.segment().verify()?;
        check.add(pairs.segment());
        while pairs.next()?.is_some() {}
    }
    if let Some(map) = archive.coordinates()? {
        let file = map.segment();
        file.verify()?;
        check.add(file);
        let (found, recorded) = (Some(map.count_cells()?), archive.coordinate_record().map(|c| c.cells));
        if found != recorded {
            let (expected, got) = (format!("{recorded:?}"), format!("{found:?}"));
            return Err(Error::bad_input(path, "cells of the grid", expected, got));
        }
    }
    Ok(check)
}

impl ArchiveCheck {
    fn add(&mut self, file: &Segment) {
        self.segments += 1;
        self.blocks += file.block_count();
        self.bytes += file.info().bytes;
    }
}

/// Verifies the values of a step to which others refer.
fn check_base(archive: &StepView, check: &mut ArchiveCheck) -> Result<()> {
    if archive.is_pyramid() {
        return check_files_of_pyramid(archive, check);
    }
    for number in 0..archive.layout.segment_count() {
        let segment = archive.segment(number)?;
        segment.files(false).try_for_each(Segment::verify)?;
        segment.files(false).for_each(|file| check.add(file));
    }
    Ok(())
}

/// Verifies a step; with the first one of an archive also the mesh.
fn check_step(
    archive: &StepView,
    threads: &Threads,
    cancel: &CancelToken,
    check: &mut ArchiveCheck,
) -> Result<()> {
    if archive.is_pyramid() {
        return check_pyramid(archive, threads, cancel, check);
    }
    let with_mesh = archive.position() == 0;
    let (mut entries, mut volume6) = (EntryDigest::default(), 0i128);
    let spectrum = archive.stored_spectrum()?;
    let meter = spectrum.as_ref().map(|_| Meter::of_archive(archive));
    let mut measured = spectrum
        .as_ref()
        .zip(meter.as_ref())
        .map(|(file, meter)| SpectrumBuilder::new(Design::new(file.spectrum().range, meter.limits())));
    let look = |n: usize| {
        cancel.check()?;
        let chunk = ChunkId(n as u64);
        let segment = archive.segment_of(chunk)?;
        if archive.layout.begins_segment(chunk) {
            segment.files(with_mesh).try_for_each(Segment::verify)?;
        }
        check_chunk(archive, &segment, chunk, meter.as_ref())
    };
    // What is left of a chunk is small, so threads alone bound the memory.
    let bytes = vec![0; archive.layout.chunk_count() as usize];
    in_order(&bytes, 0, threads, look, |n, CheckedChunk { sizes, volume6: of_chunk, ranges, part }| {
        let chunk = ChunkId(n as u64);
        if archive.layout.begins_segment(chunk) {
            archive.close_before(chunk);
            archive.segment_of(chunk)?.files(with_mesh).for_each(|file| check.add(file));
        }
        if let Some((measured, part)) = measured.as_mut().zip(part) {
            measured.add(&part);
        }
        if with_mesh {
            volume6 += of_chunk;
            check.points += u64::from(sizes.core);
            check.tetrahedra += sizes.tets;
        }
        ranges.iter().for_each(|e| entries.add(e));
        Ok(())
    })?;
    if with_mesh {
        check_totals(archive, volume6, check)?;
    }
    check_index(archive, entries, check)?;
    if let Some((file, measured)) = spectrum.zip(measured) {
        file.verify(&measured)?;
        check.add(file.segment());
    } else if entries.count > 0 && archive.step().index.is_some() {
        return Err(Error::bad_input(archive.path(), "spectrum", "one, as there are values", "none"));
    }
    Ok(())
}

/// Verifies the checksums of a step of a pyramid.
fn check_files_of_pyramid(archive: &StepView, check: &mut ArchiveCheck) -> Result<()> {
    for number in 0..archive.layout.segment_count() {
        let first = ChunkId(archive.layout.chunks_of(number).start);
        for file in [archive.values_of(archive.position(), first)?, archive.ranges_of(first)?] {
            file.segment().verify()?;
            check.add(file.segment());
        }
    }
    if archive.manifest.plan.has_labels() {
        return Ok(());
    }
    let coarse = Segment::open(archive.layout.coarse(), SegmentKind::Coarse, Some(archive.step_hash()))?;
    coarse.verify()?;
    check.add(&coarse);
    Ok(())
}

/// Verifies a step of a pyramid: all its nodes are decoded, and lie in the ranges of their bricks.
fn check_pyramid(
    archive: &StepView,
    threads: &Threads,
    cancel: &CancelToken,
    check: &mut ArchiveCheck,
) -> Result<()> {
    let (pyramid, mut entries) = (&archive.pyramid()?.pyramid, EntryDigest::default());
    check_files_of_pyramid(archive, check)?;
    // Of the nodes of cells, the last along an axis is the next brick's, but where the array ends.
    let own_end = |cells: &[Range<usize>; 3]| {
        let dims = pyramid.nodes(0);
        std::array::from_fn(|a| (cells[a].end + usize::from(cells[a].end + 1 == dims[a])) as u64)
    };
    let look = |n: usize| {
        cancel.check()?;
        let (id, at) = (ChunkId(n as u64), chunk_place(pyramid, ChunkId(n as u64)));
        let file = archive.ranges_of(id)?;
        let (summary, bricks) = (file.value_summary(id)?, bricks_of(pyramid, at));
        let wrong = |at: String, expected: String, got: String| {
            Err(Error::bad_input(file.segment().path(), format!("chunk {}, {at}", id.0), expected, got))
        };
        if summary.ranges.len() != bricks.len() {
            return wrong("ranges".into(), bricks.len().to_string(), summary.ranges.len().to_string());
        }
        let mut void = 0;
        for (n, (range, Brick { level, cells })) in summary.ranges.iter().zip(&bricks).enumerate() {
            let window = IndexBox {
                lo: std::array::from_fn(|a| cells[a].start as u64),
                hi: std::array::from_fn(|a| cells[a].end as u64 + 1),
            };
            let values = archive.nodes(*level, &window)?;
            if *level == 0 {
                void += missing_below(&values, &window, own_end(cells));
            }
            let (found, _) = range_of_cells(&values, &window, cells);
            let holds = range.min <= found.min && found.max <= range.max;
            if found.tets != range.tets || found.tets > 0 && !holds {
                let said = |r: &BlockRange| format!("{} cells from {} to {}", r.tets, r.min, r.max);
                return wrong(format!("brick {n}"), said(range), said(&found));
            }
        }
        if void != summary.void as usize {
            return wrong("missing samples".into(), summary.void.to_string(), void.to_string());
        }
        let ranges: Vec<Entry> = index_entries(id.0, &summary.ranges).collect();
        Ok((ranges, pyramid.chunk(at).len() as u64))
    };
    let bytes = vec![0; archive.layout.chunk_count() as usize];
    in_order(&bytes, 0, threads, look, |_, (ranges, samples): (Vec<Entry>, u64)| {
        ranges.iter().for_each(|e| entries.add(e));
        if archive.position() == 0 {
            check.points += samples;
        }
        Ok(())
    })?;
    check_index(archive, entries, check)
}

/// How many values of a box are missing, those at an end and behind it left out.
fn missing_below(values: &[f32], place: &IndexBox, end: [u64; 3]) -> usize {
    let rows = (place.lo[2]..end[2]).flat_map(|z| (place.lo[1]..end[1]).map(move |y| [place.lo[0], y, z]));
    let width = (end[0] - place.lo[0]) as usize;
    rows.map(|first| values[place.offset(first)..][..width].iter().filter(|v| v.is_nan()).count()).sum()
}

/// The tetrahedra fill the box, or have the volume of the mesh that they are from, and are as many
/// as the manifest says.
fn check_totals(archive: &StepView, volume6: i128, check: &ArchiveCheck) -> Result<()> {
    let (path, whole) = (archive.path(), archive.manifest.plan.volume6());
    if volume6 != whole {
        let expected = format!("a volume of {whole}/6 lattice cells");
        return Err(Error::bad_input(path, "tetrahedra", expected, volume6.to_string()));
    }
    if let Some(own) = archive.manifest.plan.own.filter(|own| own.tetrahedra != check.tetrahedra) {
        let expected = format!("the {} of the mesh", own.tetrahedra);
        return Err(Error::bad_input(path, "tetrahedra", expected, check.tetrahedra.to_string()));
    }
    let totals = &archive.manifest.counts;
    let found = [check.points, check.tetrahedra];
    if found != [totals.points, totals.tetrahedra] {
        let expected = format!("{} points, {} tetrahedra", totals.points, totals.tetrahedra);
        return Err(Error::bad_input(path, "totals", expected, format!("{} and {}", found[0], found[1])));
    }
    Ok(())
}

/// What a chunk contributes to the checks of the whole.
struct CheckedChunk {
    sizes: MeshSizes,
    /// Six times the volume of its tetrahedra, and of those that were left out, at the first step.
    volume6: i128,
    /// The entries that the index must have.
    ranges: Vec<Entry>,
    /// What it adds to the spectrum, where that is stored.
    part: Option<ChunkPart>,
}

/// Checks a chunk against its summaries and its part of the spectrum.
fn check_chunk(
    archive: &StepView,
    segment: &OpenSegment,
    id: ChunkId,
    meter: Option<&Meter>,
) -> Result<CheckedChunk> {
    let (sizes, values) = (archive.mesh_sizes(id)?, segment.values.value_summary(id)?);
    let file = segment.mesh.segment().path();
    let wrong = |at: &str, expected: String, got: String| {
        Err(Error::bad_input(file, format!("chunk {}, {at}", id.0), expected, got))
    };
    // A chunk has the blocks of its vertices and a summary besides.
    let blocks = segment.mesh.block_count(id);
    let header =
        ChunkHeader { core_counts: vec![sizes.core], halo: sizes.halo, tet_blocks: sizes.tet_blocks };
    if u64::from(sizes.tet_blocks) + header.blocks() as u64 + 1 != blocks {
        return wrong("summary", format!("that of {blocks} blocks"), format!("{sizes:?}"));
    }
    let blocks: Vec<u32> = (0..sizes.tet_blocks).collect();
    let decoded = archive.decode(id, &blocks)?;
    let (mut ranges, mut start) = (vec![], 0);
    for &end in &decoded.block_ends {
        ranges.push(BlockRange::of(&decoded.tets[start..end], &decoded.values));
        start = end;
    }
    let mut rounded = ranges.clone();
    BlockRange::round(&mut rounded);
    if rounded != values.ranges {
        return wrong("ranges", "those of the values".into(), "others".into());
    }
    let blocks = ValueBlocks::new(decoded.values.len());
    let stored = archive.value_ranges(id, &blocks)?.expect("a step is looked at");
    let mut found = value_ranges(&decoded.values, &blocks);
    BlockRange::round_within(&mut found, BlockRange::bounds(stored.iter().copied()));
    // Blocks of values that no tetrahedron uses were not decoded.
    if found.iter().zip(&stored).any(|(found, stored)| found.tets > 0 && found != stored) {
        return wrong("ranges of values", "those of the values".into(), "others".into());
    }
    let volume6 = match archive.position() {
        0 => check_mesh(archive, &decoded, segment, sizes, id)?,
        _ => 0,
    };
    let of_step = (&*decoded.values, &*ranges);
    let parts =
        meter.map(|meter| meter.parts(&decoded.positions, &decoded.tets, &[of_step], &mut Bench::default()));
    let part = parts.transpose()?.and_then(|mut parts| parts.pop());
    Ok(CheckedChunk { sizes, volume6, ranges: index_entries(id.0, &rounded).collect(), part })
}

/// Checks that the tetrahedra of a chunk agree with its summary, and use its halo. Returns their
/// volume and that of those that were left out.
fn check_mesh(
    archive: &StepView,
    decoded: &DecodedChunk,
    segment: &OpenSegment,
    sizes: MeshSizes,
    id: ChunkId,
) -> Result<i128> {
    let file = segment.mesh.segment().path();
    let wrong = |at: &str, expected: String, got: String| {
        Err(Error::bad_input(file, format!("chunk {}, {at}", id.0), expected, got))
    };
    let sizes = MeshSizes {
        core: decoded.core as u32,
        halo: (decoded.positions.len() - decoded.core) as u32,
        tets: decoded.tets.len() as u64,
        ..sizes
    };
    let volume6 = check_tets(decoded, &archive.chunks.chunk(id), file)?;
    let summary = segment.mesh.mesh_summary(id)?;
    let outside6 = summary.outside6;
    let found = MeshSummary { sizes, volume6, outside6 };
    if found != summary {
        return wrong("summary", format!("{found:?}"), format!("{summary:?}"));
    }
    let used = used_corners(&decoded.tets, decoded.positions.len());
    let core = &archive.chunks.chunk(id).core;
    if let Some(v) = (decoded.core..used.len()).find(|&v| !used[v] || core.contains(decoded.positions[v])) {
        let at = format!("{:?}", decoded.positions[v]);
        return wrong("halo", "points of other chunks that tetrahedra use".into(), at);
    }
    let mut halo = decoded.ids[decoded.core..].to_vec();
    halo.sort_unstable();
    if halo.windows(2).any(|w| w[0] == w[1]) {
        return wrong("halo", "each point once".into(), "one twice".into());
    }
    Ok(volume6 + outside6)
}

/// Every tetrahedron is positively oriented and the chunk's own; returns their volume.
fn check_tets(decoded: &DecodedChunk, chunk: &Chunk, file: &Path) -> Result<i128> {
    let mut volume6 = 0;
    for tet in &decoded.tets {
        let corners = tet.map(|v| decoded.positions[v as usize]);
        let [a, b, c, d] = corners;
        let volume = signed_volume6(a, b, c, d);
        let is_own = chunk.core.contains(a.min(b).min(c).min(d));
        if volume <= 0 || !is_own {
            let at = format!("chunk {}, a tetrahedron", chunk.id.0);
            return Err(Error::bad_input(file, at, "positive, and the chunk's own", format!("{corners:?}")));
        }
        volume6 += volume;
    }
    Ok(volume6)
}

/// The index has an entry for each block that is not void, and no others.
fn check_index(archive: &StepView, expected: EntryDigest, check: &mut ArchiveCheck) -> Result<()> {
    let index = archive.index()?;
    let found = index.verify()?;
    if found != expected {
        let text = |d: EntryDigest| format!("{} entries", d.count);
        let got = if found.count == expected.count { "as many others".into() } else { text(found) };
        let expected = format!("{}, one a block of finite values", text(expected));
        return Err(Error::bad_input(archive.layout.index(), "entries", expected, got));
    }
    index.segment().into_iter().for_each(|file| check.add(file));
    check.index_entries += found.count;
    Ok(())
}
