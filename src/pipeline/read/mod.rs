//! An archive being read: its manifest, its chunks and blocks, its steps.
//!
//! ```text
//!  archive ─▶ step_view ─▶ chunk_reader ─▶ block ─▶ block_cache    one chunk, some of its blocks
//!                 │            └─▶ corners, corner_values: of a step, or between two
//!                 └─▶ visit: all chunks that meet a region, side by side, within memory
//! ```
//!
//! Nothing here knows how an archive is made, or which questions are asked.

mod archive;
mod block;
mod block_cache;
mod choice;
mod chunk_mesh;
mod chunk_reader;
mod coordinates;
mod corner_values;
mod corners;
mod damaged;
mod decoded;
mod frontier;
mod labels;
mod level;
mod level_field;
mod nodes;
mod pools;
mod pyramid;
mod reader_memory;
mod region;
mod segments;
pub(super) mod spectrum;
mod step_view;
mod steps;
mod stored_values;
mod summary;
mod visit;
mod wanted;

pub(super) use archive::OpenArchive;
pub use archive::is_archive;
pub(super) use block::{Block, BlockCorners, NumberedShape};
pub(super) use choice::is_of_fields;
pub use choice::{StepChoice, StepRange};
pub(super) use chunk_mesh::{MeshedChunk, used_corners};
pub(super) use chunk_reader::{ChunkReader, READER_PER_VERTEX};
pub(super) use coordinates::{
    IndexToWorld, WorldBox, bounds, coordinate_hash, expect_in_f32, in_memory, in_world, index_places,
    origin_of_volume, world_box, world_map, world_of, write_coordinates,
};
pub(super) use corner_values::CornerValues;
pub(super) use decoded::DecodedChunk;
pub(super) use frontier::Frontier;
pub use level::LevelChoice;
pub(super) use level_field::{LevelNodes, samples_of_level};
pub(super) use pools::{BufferPool, Buffers};
pub(super) use pyramid::{
    Brick, box3, bricks_of, cells_in, chunk_place, has_coarse_mask, index_box, pyramid_of, range_of_cells,
    scale_of,
};
pub(super) use reader_memory::{ReaderMemory, ValuesMemory};
pub(super) use region::Cut;
pub use region::{Roi, RoiSpace};
pub(super) use segments::{Depth, SegmentState, inspect};
pub(super) use spectrum::{Bench, Meter, limits};
pub use spectrum::{Knot, SpectrumReport, StepSpectrum, Suggestion};
pub(super) use step_view::{OpenSegment, StepView};
pub(super) use steps::Ranges;
pub(super) use summary::summarize;
pub use summary::{ArchiveSummary, LevelSummary, PyramidLevel, StepSummary};
pub(super) use visit::{Blocks, Visit, full_region};
pub(super) use wanted::{Needed, WantedBlocks};
