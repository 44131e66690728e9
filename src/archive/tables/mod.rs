//! What an archive stores once, next to its chunks.
//!
//! * `coordinates`: those of a rectilinear or curvilinear grid.
//! * `errors`: the sums of errors of a chunk.
//! * `explicit`: points that no formula gives.
//! * `levels`: the refinement level of each cell.
//! * `repeated`: which points of a mesh have the same place.

pub(super) mod coordinates;
mod errors;
mod explicit;
mod find;
pub(super) mod levels;
mod repeated;

pub use coordinates::{CellCount, CoordinateMap, Coordinates, write_coordinates};
pub(crate) use errors::{ChunkErrors, decode_errors, encode_errors};
pub use explicit::{ExplicitRecord, explicit_path, read_explicit, write_explicit};
pub use find::CellBoxes;
pub use levels::{LevelsRecord, levels_path, read_levels, write_levels};
pub(crate) use repeated::{RepeatedReader, write_repeated};
pub use repeated::{RepeatedRecord, repeated_path};
