//! Questions whose answer is a surface, or its size.
//!
//! ```text
//!  query: settings ─▶ index ─▶ active blocks ─▶ extract: chunk by chunk ─▶ weld ─▶ refine ─▶ file
//! ```
//!
//! [`extract_steps`] answers for many steps at once, [`unpack`] stores blocks as extraction uses
//! them.

mod active;
mod colours;
mod cubes;
mod extract;
mod extract_steps;
mod level;
mod parts;
mod plateau;
mod query;
mod refine;
mod series;
mod settings;
mod unpack;
mod unpacked;
mod worker;

pub(super) use colours::values_on;
pub(super) use level::level_of;
pub use parts::SurfacePart;
pub use plateau::Plateau;
pub(super) use plateau::plateau_at;
pub(super) use query::{count, stream_file, stream_surfaces, surfaces_in_memory, write_surfaces};
pub use refine::{Refine, RefineReport};
pub use series::{SeriesReport, StepSurfaces};
pub(super) use series::{series_files, surfaces_of_steps, write_series};
pub use settings::{ColourBy, CountReport, OneSurface, SurfaceReport, SurfaceSettings};
pub(super) use unpack::check_unpacked;
pub use unpack::{
    UnpackNeed, UnpackReport, UnpackSettings, UnpackedFile, remove_unpacked, unpack, unpack_need,
};
