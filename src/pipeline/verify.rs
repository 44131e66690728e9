//! `check` of an archive: every checksum, and every invariant that ties its parts together.
//!
//! * every block of every segment has its checksum, every table its size;
//! * each brick has the number of points that the point set gives it, each halo id is a point outside the chunk;
//! * each tetrahedron is positively oriented, belongs to the chunk that holds it, and all together fill the box exactly;
//! * the ranges of the blocks, the entries of the index, and the sums of the spectrum are those of the values.

use super::open::{DecodedChunk, OpenArchive, OpenSegment, used_corners};
use super::reduce::{domain_volume6, index_entries, mesh_summary, value_summary};
use super::spectrum::{Meter, stored_part};
use crate::archive::summary::{BlockRange, MeshSummary};
use crate::error::{Error, Result};
use crate::geom::predicates::signed_volume6;
use crate::grid::{Chunk, ChunkId};
use crate::index::{Entry, EntryDigest};
use crate::spectrum::{ChunkPart, Design, SpectrumBuilder};
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;

/// What was verified.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ArchiveCheck {
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
    /// Entries of the index.
    pub index_entries: u64,
}

/// Verifies a whole archive. Cost: reading and decoding all of it.
///
/// # Errors
/// [`Error::BadInput`] that names the first thing that is wrong.
pub fn check_archive(path: &Path) -> Result<ArchiveCheck> {
    let archive = OpenArchive::open(path)?;
    let mut check = ArchiveCheck::default();
    let mut entries = EntryDigest::default();
    let mut volume6 = 0i128;
    let (spectrum, meter) = (archive.spectrum()?, Meter::of_archive(&archive));
    let mut measured = spectrum
        .as_ref()
        .map(|file| SpectrumBuilder::new(Design::new(file.spectrum().range, meter.limits())));
    for number in 0..archive.layout.segment_count() {
        let segment = archive.segment(number)?;
        for file in [segment.mesh.segment(), segment.values.segment()] {
            file.verify()?;
            check.segments += 1;
            check.blocks += file.block_count();
            check.bytes += file.info().bytes;
        }
        let chunks: Vec<u64> = archive.layout.chunks_of(number).collect();
        let checked: Vec<CheckedChunk> = chunks
            .par_iter()
            .map(|&c| check_chunk(&archive, &segment, ChunkId(c), &meter))
            .collect::<Result<_>>()?;
        for CheckedChunk { summary, ranges, part } in checked {
            if let Some(measured) = &mut measured {
                measured.add(&part);
            }
            volume6 += summary.volume6 + summary.outside6;
            check.points += u64::from(summary.core);
            check.tetrahedra += summary.tets;
            ranges.iter().for_each(|e| entries.add(e));
        }
    }
    if let Some(map) = archive.coordinates()? {
        let file = map.segment();
        file.verify()?;
        (check.segments, check.blocks) = (check.segments + 1, check.blocks + file.block_count());
        check.bytes += file.info().bytes;
        let (found, recorded) = (Some(map.count_cells()?), archive.step().coordinates.map(|c| c.cells));
        if found != recorded {
            let (expected, got) = (format!("{recorded:?}"), format!("{found:?}"));
            return Err(Error::bad_input(path, "cells of the grid", expected, got));
        }
    }
    let whole = domain_volume6(&archive.manifest.plan.lattice);
    if volume6 != whole {
        return Err(Error::bad_input(
            path,
            "tetrahedra",
            format!("a volume of {whole}/6 lattice cells"),
            volume6.to_string(),
        ));
    }
    let totals = &archive.manifest.counts;
    let found = [check.points, check.tetrahedra];
    if found != [totals.points, totals.tetrahedra] {
        let expected = format!("{} points, {} tetrahedra", totals.points, totals.tetrahedra);
        return Err(Error::bad_input(path, "totals", expected, format!("{} and {}", found[0], found[1])));
    }
    check_index(&archive, entries, &mut check)?;
    match (spectrum, measured) {
        (Some(file), Some(measured)) => {
            file.verify(&measured)?;
            check.segments += 1;
            check.blocks += file.segment().block_count();
            check.bytes += file.segment().info().bytes;
        }
        _ if entries.count > 0 => {
            return Err(Error::bad_input(path, "spectrum", "one, as there are values", "none"));
        }
        _ => {}
    }
    Ok(check)
}

/// What a chunk contributes to the checks of the whole.
struct CheckedChunk {
    summary: MeshSummary,
    /// The entries that the index must have.
    ranges: Vec<Entry>,
    part: ChunkPart,
}

/// Checks a chunk against its summaries and its part of the spectrum.
fn check_chunk(
    archive: &OpenArchive,
    segment: &OpenSegment,
    id: ChunkId,
    meter: &Meter,
) -> Result<CheckedChunk> {
    let (summary, values) = (mesh_summary(&segment.mesh, id)?, value_summary(&segment.values, id)?);
    let file = segment.mesh.segment().path();
    let wrong = |at: &str, expected: String, got: String| {
        Err(Error::bad_input(file, format!("chunk {}, {at}", id.0), expected, got))
    };
    // A chunk has a header and a summary besides.
    let blocks = segment.mesh.block_count(id);
    if u64::from(summary.tet_blocks) + 2 != blocks {
        return wrong("summary", format!("that of {blocks} blocks"), format!("{summary:?}"));
    }
    let blocks: Vec<u32> = (0..summary.tet_blocks).collect();
    let decoded = archive.decode(id, &blocks)?;
    let (mut ranges, mut start) = (vec![], 0);
    for &end in &decoded.block_ends {
        ranges.push(BlockRange::of(&decoded.tets[start..end], &decoded.values));
        start = end;
    }
    if ranges != values.ranges {
        return wrong("ranges", "those of the values".into(), "others".into());
    }
    let found = MeshSummary {
        core: decoded.core as u32,
        halo: (decoded.positions.len() - decoded.core) as u32,
        tets: decoded.tets.len() as u64,
        volume6: check_tets(&decoded, &archive.chunks.chunk(id), file)?,
        ..summary
    };
    if found != summary {
        return wrong("summary", format!("{found:?}"), format!("{summary:?}"));
    }
    let used = used_corners(&decoded.tets, decoded.positions.len());
    let core = &archive.chunks.chunk(id).core;
    if let Some(v) = (decoded.core..used.len()).find(|&v| !used[v] || core.contains(decoded.positions[v])) {
        let at = format!("{:?}", decoded.positions[v]);
        return wrong("halo", "points of other chunks that tetrahedra use".into(), at);
    }
    let part = meter.part(&decoded.positions, &decoded.values, &decoded.tets, &ranges)?;
    if part != stored_part(&segment.values, id, meter.limits())? {
        return wrong("spectrum", "the sums over all tetrahedra".into(), "others".into());
    }
    Ok(CheckedChunk { summary, ranges: index_entries(id.0, &ranges).collect(), part })
}

/// Every tetrahedron is positively oriented and the chunk's own; returns their volume.
fn check_tets(decoded: &DecodedChunk, chunk: &Chunk, file: &Path) -> Result<i128> {
    let mut volume6 = 0;
    for tet in &decoded.tets {
        let corners = tet.map(|v| decoded.positions[v as usize]);
        let [a, b, c, d] = corners;
        let volume = signed_volume6(a, b, c, d);
        if volume <= 0 || !chunk.core.contains(a.min(b).min(c).min(d)) {
            let at = format!("chunk {}, a tetrahedron", chunk.id.0);
            return Err(Error::bad_input(file, at, "positive, and the chunk's own", format!("{corners:?}")));
        }
        volume6 += volume;
    }
    Ok(volume6)
}

/// The index has an entry for each block that is not void, and no others.
fn check_index(archive: &OpenArchive, expected: EntryDigest, check: &mut ArchiveCheck) -> Result<()> {
    let index = archive.index()?;
    let found = index.verify()?;
    if found != expected {
        let text = |d: EntryDigest| format!("{} entries", d.count);
        let got = if found.count == expected.count { "as many others".into() } else { text(found) };
        let expected = format!("{}, one a block of finite values", text(expected));
        return Err(Error::bad_input(archive.layout.index(), "entries", expected, got));
    }
    check.segments += 1;
    check.blocks += index.segment().block_count();
    check.bytes += index.segment().info().bytes;
    check.index_entries = found.count;
    Ok(())
}
