//! The lattice that a mesh lies in, and the way from the world to it.

use super::column::{Column, ColumnWriter};
use super::settings::StoreSettings;
use isospan_io::error::{Error, Result};
use isospan_io::geom::Lattice;
use isospan_io::grid::Geometry;
use isospan_mesh::locate::{FINE_BITS, FinePos};
use std::path::Path;

/// The longest side of a mesh's bounding box in fine steps, as a power of two.
const LONGEST_BITS: u32 = 24 + FINE_BITS;
/// Voxels along the longest side, as a power of two: at least and at most.
const VOXEL_BITS: std::ops::RangeInclusive<u32> = 3..=20;

/// The bounding box of some positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    pub(crate) lo: [f64; 3],
    pub(crate) hi: [f64; 3],
}

impl Bounds {
    pub(crate) const NONE: Self = Self { lo: [f64::INFINITY; 3], hi: [f64::NEG_INFINITY; 3] };

    /// The bounds of two boxes.
    pub(super) fn join(&self, other: &Self) -> Self {
        Self {
            lo: std::array::from_fn(|a| self.lo[a].min(other.lo[a])),
            hi: std::array::from_fn(|a| self.hi[a].max(other.hi[a])),
        }
    }

    pub(crate) fn add(&mut self, p: [f64; 3]) {
        self.lo = std::array::from_fn(|a| self.lo[a].min(p[a]));
        self.hi = std::array::from_fn(|a| self.hi[a].max(p[a]));
    }
}

/// A lattice in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MeshFrame {
    pub(crate) lattice: Lattice,
    pub(crate) geometry: Geometry,
    /// Fine steps a world unit.
    scale: f64,
}

impl MeshFrame {
    /// The lattice around a mesh of `vertices` vertices: its voxels are about as large as the
    /// vertices lie apart.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a mesh without extent, or with one that `f64` cannot represent.
    pub(crate) fn around(path: &Path, bounds: &Bounds, vertices: u64) -> Result<Self> {
        let side: [f64; 3] = std::array::from_fn(|a| bounds.hi[a] - bounds.lo[a]);
        let longest = side.into_iter().fold(0.0, f64::max);
        if !(side.iter().all(|s| *s > 0.0) && longest.is_finite()) {
            let got = format!("{} x {} x {}", side[0], side[1], side[2]);
            return Err(Error::bad_input(path, "bounding box", "a finite length along each axis", got));
        }
        // The least power of two of voxels that are smaller than the vertices lie apart; by
        // multiplication, which is exact enough on all machines.
        let share = side.iter().map(|s| s / longest).product::<f64>();
        let wanted = vertices.max(1) as f64;
        let voxels =
            |bits: u32| share * f64::from(1u32 << bits) * f64::from(1u32 << bits) * f64::from(1u32 << bits);
        let bits = VOXEL_BITS.clone().find(|&b| voxels(b) >= wanted).unwrap_or(*VOXEL_BITS.end());
        let cells = f64::from(1u32 << bits);
        let voxel = longest / cells;
        let dims = side.map(|s| (s / voxel).ceil().clamp(1.0, cells) as u64 + 1);
        Ok(Self {
            lattice: Lattice::new(dims)?,
            geometry: Geometry { origin: bounds.lo, spacing: [voxel; 3], ..Geometry::default() },
            scale: (1u64 << LONGEST_BITS) as f64 / longest,
        })
    }

    /// The bounds in the world of the fine positions that lie outside of the box.
    pub(super) fn beyond(&self, positions: &[FinePos]) -> Bounds {
        let (mut bounds, most) = (Bounds::NONE, self.most());
        let is_outside = |p: &&FinePos| (0..3).any(|a| !(0..=most[a]).contains(&p[a]));
        for p in positions.iter().filter(is_outside) {
            bounds.add(std::array::from_fn(|a| self.geometry.origin[a] + p[a] as f64 / self.scale));
        }
        bounds
    }

    /// The upper corner of the box in fine steps.
    fn most(&self) -> FinePos {
        self.lattice.max().map(|max| i64::from(max) << FINE_BITS)
    }

    /// Fine positions, within the box.
    pub(super) fn clamped(&self, all: Column<FinePos>, settings: &StoreSettings) -> Result<Column<FinePos>> {
        let most = self.most();
        let is_within = |p: &FinePos| (0..3).all(|a| (0..=most[a]).contains(&p[a]));
        if all.get()?.iter().all(is_within) {
            return Ok(all);
        }
        let mut out = ColumnWriter::new(&settings.scratch)?;
        for p in all.get()? {
            let clamped: FinePos = std::array::from_fn(|a| p[a].clamp(0, most[a]));
            out.push(&clamped)?;
        }
        out.finish()
    }

    /// A position of the world on the fine lattice: the nearest, within the box.
    pub(crate) fn fine(&self, p: [f64; 3]) -> FinePos {
        let most = self.most();
        std::array::from_fn(|a| {
            (((p[a] - self.geometry.origin[a]) * self.scale).round() as i64).clamp(0, most[a])
        })
    }
}
