//! Whether an isovalue lies on a plateau of the samples of a pyramid: many of them have that very
//! value in the source, and values near it in the archive, so its surface is noise.
//!
//! Some active bricks are looked at. On a plateau, far more of their samples are within the error
//! of the isovalue than there are beside it.

use crate::index::Entry;
use crate::pipeline::read::{Brick, StepView, bricks_of, chunk_place, pyramid_of};
use isospan_io::error::Result;
use isospan_io::grid::{ChunkId, IndexBox};
use serde::Serialize;

/// What is near an isovalue that lies on a plateau.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Plateau {
    /// The part of the samples around the surface that are within twice the error of the isovalue.
    pub share: f64,
    /// The RMS error of the archive.
    pub error: f64,
    /// A value that lies between samples, where these are whole numbers that the error leaves
    /// apart.
    pub between: Option<f64>,
}

/// Active bricks that are looked at.
const BRICKS: usize = 4;
/// The least share of samples that makes a plateau.
const LEAST_SHARE: f64 = 0.1;
/// How many times more samples are near the isovalue than as near to values beside it.
const TIMES: usize = 4;

/// The plateau of a step on which an isovalue lies; none in an archive without loss.
pub(in crate::pipeline) fn plateau_at(archive: &StepView, isovalue: f64) -> Result<Option<Plateau>> {
    let (step, plan) = (archive.step(), &archive.manifest.plan);
    let lost = step.error.as_ref().filter(|error| error.max > 0.0).map(|error| error.rms);
    let (Some(pyramid), Some(error), false) = (pyramid_of(plan.points), lost, archive.is_between()) else {
        return Ok(None);
    };
    let source = &step.plan.source;
    let kept = source.kept(isovalue);
    let found = archive.ranges()?.query_any(&[kept])?;
    let of_chunk = |run: &[Entry]| {
        let bricks = bricks_of(&pyramid, chunk_place(&pyramid, ChunkId(run[0].chunk)));
        let named = run.iter().filter_map(|entry| bricks.get(entry.block as usize));
        named.filter(|brick| brick.level == 0).cloned().collect::<Vec<_>>()
    };
    let active: Vec<Brick> = found.chunk_by(|a, b| a.chunk == b.chunk).flat_map(of_chunk).collect();
    let every = active.len().div_ceil(BRICKS).max(1);
    let (mut near, mut beside, mut all) = (0, 0, 0);
    for Brick { cells, .. } in active.iter().step_by(every) {
        let window = IndexBox {
            lo: [0, 1, 2].map(|a| cells[a].start as u64),
            hi: [0, 1, 2].map(|a| cells[a].end as u64 + 1),
        };
        for value in archive.nodes(0, &window)? {
            let apart = f64::from((value - kept).abs()) / error;
            near += usize::from(apart <= 2.0);
            beside += usize::from(apart > 2.0 && apart <= 6.0);
            all += usize::from(!apart.is_nan());
        }
    }
    // What lies beside is twice as wide.
    let share = near as f64 / all.max(1) as f64;
    if share < LEAST_SHARE || 2 * near < TIMES * beside {
        return Ok(None);
    }
    let apart = (!source.scalar.is_float()).then_some(source.slope.abs());
    let between = apart.filter(|apart| 6.0 * error < *apart).map(|apart| isovalue + apart / 2.0);
    Ok(Some(Plateau { share, error, between }))
}
