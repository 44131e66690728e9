//! What several readers need: options, fields, headers, streams of bytes and of text.

pub(in crate::formats) mod arrays;
pub(in crate::formats) mod axes;
pub(in crate::formats) mod centers;
pub(in crate::formats) mod cf;
pub(in crate::formats) mod codec;
pub mod coordinates;
pub(in crate::formats) mod entries;
mod fields;
pub mod format;
pub(in crate::formats) mod frames;
pub mod hdf5_head;
pub(in crate::formats) mod header;
pub(in crate::formats) mod lengths;
pub(in crate::formats) mod mesh_file;
pub(in crate::formats) mod minc;
pub(in crate::formats) mod numbers;
mod options;
pub mod packed;
mod packing;
pub(in crate::formats) mod ranges;
pub(in crate::formats) mod recent;
pub mod sink;
pub(in crate::formats) mod small;
pub(in crate::formats) mod stream;
pub mod text;
pub(in crate::formats) mod unread;
pub(in crate::formats) mod zip;

pub use fields::pick_field;
pub(in crate::formats) use fields::{field_matches, is_pattern};
pub(crate) use options::has_suffix;
pub use options::{OpenOptions, RawLayout};
use std::collections::HashMap;

/// Fields of a file that are steps, and their times where they are known.
pub type Frames = Vec<(String, Option<f64>)>;

/// The times of steps that have one, by their names.
pub(in crate::formats) fn known_times(frames: Frames) -> HashMap<String, f64> {
    frames.into_iter().filter_map(|(name, time)| Some((name, time?))).collect()
}
