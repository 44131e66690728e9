//! What decides the bytes of an archive's mesh, and how large that is.

use super::record::{is_one, one};
use crate::archive::segment::PlanHash;
use crate::archive::tables::{ExplicitRecord, LevelsRecord, RepeatedRecord};
use isospan_io::geom::Lattice;
use isospan_io::grid::{BrickGrid, ChunkCuts};
use isospan_mesh::points::PointSpec;
use serde::{Deserialize, Serialize};

/// An archive of one chunk with at most this many blocks has no index and no spectrum of its steps:
/// they follow from its values.
pub const MOST_UNINDEXED: u64 = 512;
/// A pyramid of at most this many chunks has none: it follows from the ranges of bricks.
pub const MOST_UNINDEXED_CHUNKS: u64 = 8;

/// Everything that decides the bytes of the mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeshPlan {
    /// The lattice of the domain.
    pub lattice: Lattice,
    /// The point set.
    pub points: PointSpec,
    /// Bits an axis of the curve in the insertion order, on which the tetrahedra of cospherical
    /// points depend.
    pub order_bits: u32,
    /// Cells along each edge of a brick: of the body-centred cubic lattice, where that is all of
    /// the points; else of voxels.
    pub brick_edge: [u64; 3],
    /// Points of a chunk, about.
    #[serde(default = "usual_chunk", skip_serializing_if = "is_usual_chunk")]
    pub chunk_target: u64,
    /// Tetrahedra of a block, about.
    #[serde(default = "usual_block", skip_serializing_if = "is_usual_block")]
    pub block_tets: u32,
    /// The points of the set that are listed and follow no formula.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub explicit: Option<ExplicitRecord>,
    /// If points and tetrahedra are those of a mesh, what is known of these.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub own: Option<OwnRecord>,
    /// The levels of the points, where their density differs from place to place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub levels: Option<LevelsRecord>,
    /// The duplicate vertices, of a tetrahedral mesh that has some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeated: Option<RepeatedRecord>,
    /// Whether chunks prove all tetrahedra at the vertices of their own, which fitted values need,
    /// and not their own alone: their halos reach further.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stars: bool,
    /// The chunks and the order of points, if they are not those that the points ask for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<FrameRecord>,
}

/// Points of a chunk, about, unless the user chooses.
pub const CHUNK_POINTS: u64 = 250_000;

fn usual_chunk() -> u64 {
    CHUNK_POINTS
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_usual_chunk(points: &u64) -> bool {
    *points == CHUNK_POINTS
}

/// Tetrahedra a block, about. An isosurface of a smooth field crosses a tenth of the tetrahedra of
/// blocks of 1024 that it meets, nearly a fifth of those of 256, for 1.2 bits more each; still
/// smaller blocks take more bits, and no less time, because each has its list of vertices.
pub const BLOCK_TETS: u32 = 256;

fn usual_block() -> u32 {
    BLOCK_TETS
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_usual_block(tets: &u32) -> bool {
    *tets == BLOCK_TETS
}

/// What a plan says of a mesh's own tetrahedra.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OwnRecord {
    /// Number of tetrahedra.
    pub tetrahedra: u64,
    /// Six times the volume of all in lattice steps, its low and its high 64 bits.
    pub volume6: [u64; 2],
}

impl OwnRecord {
    /// The record of so many tetrahedra of this volume.
    pub(crate) fn new(tetrahedra: u64, volume6: u128) -> Self {
        Self { tetrahedra, volume6: [volume6 as u64, (volume6 >> 64) as u64] }
    }

    /// Six times the volume of all in lattice steps; that of a damaged record may be any.
    pub(crate) fn volume6(&self) -> i128 {
        (u128::from(self.volume6[1]) << 64 | u128::from(self.volume6[0])) as i128
    }
}

/// The parts that a plan takes from an earlier one, so that chunks whose points did not change have
/// the same bytes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Bits an axis of the key that orders points: see
    /// [`PointSet::order_bits`](isospan_mesh::points::PointSet::order_bits).
    pub site_bits: u32,
    /// Where bricks are cut into chunks.
    pub cuts: ChunkCuts,
}

impl MeshPlan {
    /// The hash that mesh segments carry: of the plan as JSON without spaces, members in the order
    /// of this struct.
    pub fn hash(&self) -> PlanHash {
        PlanHash::of(&serde_json::to_vec(self).expect("a plan is plain data"))
    }

    /// Six times the volume of all tetrahedra, in cubic lattice steps: that of the domain, or of
    /// the mesh whose own tetrahedra they are.
    pub(crate) fn volume6(&self) -> i128 {
        self.own.map_or_else(|| self.lattice.volume6(), |own| own.volume6())
    }

    /// The bricks.
    pub fn bricks(&self) -> BrickGrid {
        BrickGrid::new(self.lattice, self.brick_edge)
    }

    /// Whether all samples are stored, as a wavelet pyramid or as labels.
    pub fn is_pyramid(&self) -> bool {
        matches!(self.points, PointSpec::Pyramid { .. } | PointSpec::Labels { .. })
    }

    /// Whether these are labels, without coarser levels.
    pub fn has_labels(&self) -> bool {
        matches!(self.points, PointSpec::Labels { .. })
    }

    /// Whether tetrahedra are in files of their own.
    pub fn stores_mesh(&self) -> bool {
        !self.is_pyramid()
    }
}

/// Sizes of the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Points, each counted once.
    pub points: u64,
    /// Tetrahedra.
    pub tetrahedra: u64,
    /// Chunks.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub chunks: u64,
    /// Tetrahedron blocks.
    pub blocks: u64,
}

impl Counts {
    /// Whether the steps of the mesh of a plan have an index and a spectrum each: see
    /// [`MOST_UNINDEXED`].
    pub fn is_indexed(&self, plan: &MeshPlan) -> bool {
        match plan.is_pyramid() {
            true => self.chunks > MOST_UNINDEXED_CHUNKS,
            false => self.chunks > 1 || self.blocks > MOST_UNINDEXED,
        }
    }
}
