//! isospan reduces a scalar field that does not fit in memory to a small archive, and extracts watertight
//! isosurfaces from it in time proportional to the surface.

pub mod archive;
pub mod bytes;
pub mod error;
pub mod exec;
pub mod formats;
pub mod geom;
pub mod grid;
pub mod index;
pub mod mesh;
pub mod pipeline;
pub mod points;
pub mod sample;
pub mod surface;
pub mod volume;

pub use error::{Error, Result};
