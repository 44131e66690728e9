//! Questions whose answer is a surface, or its size.
//!
//! ```text
//!  query: settings ─▶ index ─▶ active blocks ─▶ extract: chunk by chunk ─▶ weld ─▶ refine ─▶ file
//! ```
//!
//! [`pass`] answers for several steps together.

mod active;
#[cfg(feature = "compare")]
mod against;
mod colours;
mod cubes;
mod extract;
mod labels;
mod level;
mod numbers;
mod one_file;
mod parts;
mod pass;
mod phases;
mod plateau;
mod query;
mod question;
mod refine;
mod series;
mod settings;
mod steps;
mod weld;
mod worker;

#[cfg(feature = "compare")]
pub(super) use against::surface_errors;
pub(super) use colours::values_on;
pub use labels::{LabelMesh, LabelReport, Labels, OneLabel};
pub(super) use labels::{LabelSettings, label_files, label_meshes, label_sizes, write_labels};
pub(super) use level::level_of;
pub use numbers::{InscribedBall, NumbersReport, PhaseNumbers};
pub(super) use numbers::{expect_whole, numbers};
pub use parts::{StreamedPart, SurfaceSink};
pub use plateau::Plateau;
pub(super) use plateau::plateau_at;
pub(super) use query::{count, stream_file, stream_surfaces, surfaces_in_memory, write_surfaces};
pub use refine::{Refine, RefineReport};
pub(super) use series::{series_files, surfaces_of_steps, write_series};
pub(super) use settings::SurfaceSettings;
pub use settings::{ColourBy, CountReport, OneSurface, SurfaceReport};
pub use steps::{SeriesReport, StepSurfaces};
