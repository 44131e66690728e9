//! The coarse levels of a pyramid: made of what workers leave of all chunks.

use crate::archive::chunked::ChunkSegment;
use crate::archive::segment::{PlanHash, SegmentKind, SegmentWriter};
use crate::pipeline::plan::Layout;
use crate::pipeline::read::{StepView, chunk_place, has_coarse_mask};
use isospan_io::error::{Error, Result};
use isospan_io::grid::ChunkId;
use isospan_wavelet::{Box3, Coarse, Mask, MaskBuilder, Pyramid, Scale, Tile, TileId, TileSource};
use std::sync::Arc;

/// The samples of nodes that are missing, as a mask of these; no bytes if none is.
pub(super) fn mask_of_nodes(mask: &Mask, nodes: &Box3, stride: [usize; 3]) -> Result<Vec<u8>> {
    let mut values = vec![0.0; nodes.len()];
    mask.each_missing(nodes, stride, |i| values[i] = f32::NAN).map_err(|e| too_fine(&e))?;
    let mut builder = MaskBuilder::new(*nodes);
    builder.add(nodes, nodes, &values);
    Ok(builder.finish())
}

/// Puts together the low coefficients of all chunks, and makes the coarse levels of them, after
/// those of the base where a step has one.
pub(super) fn make_coarse(
    layout: &Layout,
    hash: PlanHash,
    pyramid: &Pyramid,
    scale: &Scale,
    base: Option<&StepView>,
    memory: u64,
) -> Result<()> {
    let all = Box3::all(pyramid.nodes(pyramid.details()));
    let needed = 16 * all.len() as u64;
    if needed > memory {
        return Err(Error::memory("the coarse levels are made in memory", needed, memory));
    }
    let (mut low, mut missing) = (vec![0.0f32; all.len()], Vec::<f32>::new());
    for segment in 0..layout.segment_count() {
        let file = ChunkSegment::open(layout.low(segment), SegmentKind::Low, Some(hash))?;
        let mut bytes = vec![];
        for id in layout.chunks_of(segment).map(ChunkId) {
            let place = pyramid.low_box(&pyramid.chunk(chunk_place(pyramid, id)));
            let last = file.block_count(id).saturating_sub(1);
            if last > 0 {
                file.block(id, 0, &mut bytes)?;
                missing.resize(all.len(), 0.0);
                let found = Mask::new(place, std::mem::take(&mut bytes));
                let found = found.and_then(|m| m.each_missing(&all, [1; 3], |i| missing[i] = f32::NAN));
                found.map_err(|e| {
                    let at = format!("chunk {}", id.0);
                    Error::bad_input(layout.low(segment), at, "a mask", e.to_string())
                })?;
            }
            file.block(id, last, &mut bytes)?;
            let (values, _) = bytes.as_chunks::<4>();
            let values: Vec<f32> = values.iter().map(|b| f32::from_le_bytes(*b)).collect();
            if values.len() != place.len() {
                let (expected, got) = (format!("{} numbers", place.len()), values.len().to_string());
                return Err(Error::bad_input(layout.low(segment), format!("chunk {}", id.0), expected, got));
            }
            all.copy_common(&mut low, &place, &values);
        }
    }
    let bytes = Coarse::encode(pyramid, scale, low, &mut BaseTiles(base)).map_err(|BaseTileError(e)| e)?;
    let mut file = SegmentWriter::create(layout.coarse(), SegmentKind::Coarse, hash)?;
    file.push_block(&bytes)?;
    if !missing.is_empty() && has_coarse_mask(pyramid, pyramid.details()) {
        let mut mask = MaskBuilder::new(all);
        mask.add(&all, &all, &missing);
        file.push_block(&mask.finish())?;
    }
    file.finish()?;
    Ok(())
}

/// The tiles of the base of a step, where it has one.
pub(super) struct BaseTiles<'a>(pub(super) Option<&'a StepView>);

/// An error of the program as one that the crate of wavelets passes on.
pub(super) struct BaseTileError(pub(super) Error);

impl From<isospan_wavelet::Error> for BaseTileError {
    fn from(e: isospan_wavelet::Error) -> Self {
        Self(too_fine(&e))
    }
}

impl TileSource for BaseTiles<'_> {
    type Error = BaseTileError;

    fn tile(&mut self, id: TileId) -> std::result::Result<Option<Arc<Tile>>, BaseTileError> {
        self.0.map_or(Ok(None), |base| base.tile(id)).map_err(BaseTileError)
    }
}

pub(super) fn too_fine(e: &isospan_wavelet::Error) -> Error {
    Error::usage(format!("the error that is asked for is below what f32 holds: {e}"))
}
