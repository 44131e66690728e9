//! Examines inputs before a plan is made: their range, their offset, where points are needed.
//!
//! Each pass reads a source from front to back, or a bounded part of it. Where samples are needed
//! in any order, [`access`] says how they are read.

mod access;
mod bricked_copy;
mod density;
mod mesh_density;
mod sampled;
mod scan;
mod shift;
mod survey;

pub(super) use access::{ChunkCache, Met, boxes_of_chunks, most_at_work, most_cached, random_access};
pub(super) use bricked_copy::{Scratch, copy_bytes};
pub use bricked_copy::{brick, is_bricked};
pub(super) use density::Errors;
pub(super) use mesh_density::{MeshChoice, MeshCurves};
pub(super) use sampled::Sampled;
pub(super) use scan::range_of;
pub use scan::{Scan, scan};
pub(super) use shift::{Reading, Shift, treat_missing};
pub(super) use survey::{Fill, Seen, Stretch, Survey, survey_mesh, survey_volume, watched};
