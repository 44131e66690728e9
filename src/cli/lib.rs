//! The `isospan` program: `cargo install isospan-cli` puts it on the path.
//!
//! ```text
//! isospan reduce  scan.nrrd -o scan.isospan              once: a small archive
//! isospan surface scan.isospan -i 600 -o bone.ply        as often as you like: any isosurface
//! ```
//!
//! The library beside it is what the program, the Python package and the viewer's page share. None
//! of it is meant for other programs: they use the crate `isospan`.
//!
//! # Features
//!
//! * `program` (default): the commands. Without it there are the answers of the viewer alone.
//! * `view` (default): `isospan view` and `isospan publish`.

#[doc(hidden)]
pub mod answers;
#[cfg(feature = "program")]
#[doc(hidden)]
pub mod commands;
