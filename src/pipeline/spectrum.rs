//! The contour spectrum of a step: measured over all chunks when the archive is put together, and read back.
//!
//! Measuring reads and decodes every chunk once, in parallel, a batch at a time, and adds the parts up in chunk order: the
//! spectrum's bytes do not depend on threads. It is a pass of its own because the isovalues depend on the range of all values.

use super::open::{DecodedChunk, OpenArchive};
use crate::error::Result;
use crate::exec::{CancelToken, Progress};
use crate::geom::Lattice;
use crate::grid::{ChunkId, Geometry};
use crate::spectrum::suggest::{Suggestion, suggest};
use crate::spectrum::{Cells, ChunkPart, Design, Knot, SpectrumBuilder};
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;

/// Measures all chunks, on the threads of `pool`.
pub(super) fn measure(
    archive: &OpenArchive,
    design: Design,
    pool: &rayon::ThreadPool,
    cancel: &CancelToken,
    progress: &dyn Progress,
) -> Result<SpectrumBuilder> {
    let mut builder = SpectrumBuilder::new(design);
    let chunks = archive.chunks.len();
    progress.begin("spectrum", chunks, "chunks");
    let batch = 2 * pool.current_num_threads() as u64;
    for first in (0..chunks).step_by(batch as usize) {
        cancel.check()?;
        archive.close_before(ChunkId(first));
        let design = builder.design();
        let parts: Vec<ChunkPart> = pool.install(|| {
            let of = |c: u64| part_of(archive, design, ChunkId(c));
            (first..(first + batch).min(chunks)).into_par_iter().map(of).collect::<Result<_>>()
        })?;
        parts.iter().for_each(|part| builder.add(part));
        progress.advance(parts.len() as u64);
    }
    Ok(builder)
}

fn part_of(archive: &OpenArchive, design: &Design, chunk: ChunkId) -> Result<ChunkPart> {
    let blocks: Vec<u32> = (0..archive.tet_blocks(chunk)?).collect();
    decoded_part(archive, design, &archive.decode(chunk, &blocks)?)
}

/// The part of a chunk of which all blocks are decoded.
pub(super) fn decoded_part(
    archive: &OpenArchive,
    design: &Design,
    chunk: &DecodedChunk,
) -> Result<ChunkPart> {
    let (lattice, source) = (&archive.manifest.plan.lattice, &archive.step().plan.source);
    let places = match archive.coordinates()? {
        None => world_places(lattice, &source.geometry, chunk),
        Some(map) => {
            let place = |&p| Ok(map.place(lattice.to_index_space(p))?.position);
            chunk.positions.iter().map(place).collect::<Result<_>>()?
        }
    };
    Ok(ChunkPart::of(design, &Cells { values: &chunk.values, places: &places, tets: &chunk.tets }))
}

/// World positions less the origin, of which only rounding would be left in a difference.
fn world_places(lattice: &Lattice, geometry: &Geometry, chunk: &DecodedChunk) -> Vec<[f64; 3]> {
    let linear = Geometry { origin: [0.0; 3], ..*geometry };
    chunk.positions.iter().map(|&p| linear.to_world(lattice.to_index_space(p))).collect()
}

/// The contour spectrum of an archive.
#[derive(Clone, Debug, Serialize)]
pub struct SpectrumReport {
    /// Least and largest value of tetrahedra that are not void; `None` if all are void.
    pub range: Option<[f32; 2]>,
    /// Tetrahedra that are not void.
    pub tetrahedra: u64,
    /// Their volume, in world units.
    pub volume: f64,
    /// Isovalues, ascending, with what was measured there.
    pub knots: Vec<Knot>,
    /// Isovalues that are worth a look, the most marked one first.
    pub suggestions: Vec<Suggestion>,
    /// Bytes read for all this.
    pub bytes_read: u64,
}

/// Reads the contour spectrum of an archive, and suggests isovalues.
///
/// # Errors
/// [`crate::Error::BadInput`] for a damaged archive.
pub fn contour_spectrum(path: &Path) -> Result<SpectrumReport> {
    report(&OpenArchive::open(path)?)
}

/// That of an open archive.
pub(super) fn report(archive: &OpenArchive) -> Result<SpectrumReport> {
    let bytes_read = archive.manifest_bytes()?;
    let Some(file) = archive.spectrum()? else {
        let none = SpectrumReport {
            range: None,
            tetrahedra: 0,
            volume: 0.0,
            knots: vec![],
            suggestions: vec![],
            bytes_read,
        };
        return Ok(none);
    };
    let spectrum = file.spectrum();
    Ok(SpectrumReport {
        range: Some(spectrum.range),
        tetrahedra: spectrum.tetrahedra,
        volume: spectrum.volume,
        knots: spectrum.knots.clone(),
        suggestions: suggest(spectrum),
        bytes_read: bytes_read + file.segment().bytes_read(),
    })
}
