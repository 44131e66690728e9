//! A region of interest: a box to which a question is confined, in index or world coordinates.
//!
//! A surface is cut exactly at the box: its rim lies on the box's faces, so the surfaces of two
//! boxes that touch fit together, and nothing outside is in the file. (Extracting a subset and
//! contouring it, as one would in VTK, gives the same for a box of whole voxels.)

use crate::surface::edit::clip::HalfSpace;
use isospan_io::error::{Error, Result};
use isospan_io::geom::{LatticeBox, LatticePos};
use isospan_io::grid::{Geometry, IndexBox};
use serde::Serialize;
use std::str::FromStr;

/// Parts of a voxel that a place in the world may be off by when it is one of a sample.
const ROUNDING: f64 = 1e-6;

/// A box, in coordinates of its choice. An infinite end is open: the box reaches to the end of the
/// domain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Roi {
    /// The coordinates of `lo` and `hi`.
    pub space: RoiSpace,
    /// Lowest corner.
    pub lo: [f64; 3],
    /// Highest corner.
    pub hi: [f64; 3],
}

/// The coordinates of a [`Roi`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RoiSpace {
    /// Numbers of samples, from 0; fractions are between samples.
    Index,
    /// World coordinates: those of the surface files.
    World,
}

/// `I0:I1,J0:J1,K0:K1` in index coordinates, `world:X0:X1,Y0:Y1,Z0:Z1` in world coordinates; an end
/// may be left out.
impl FromStr for Roi {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = || {
            format!(
                "'{text}' is no box; write I0:I1,J0:J1,K0:K1 in numbers of samples, or world:X0:X1,Y0:Y1,Z0:Z1; an end \
                 that is left out is that of the volume"
            )
        };
        let (space, ranges) = match text.strip_prefix("world:") {
            Some(rest) => (RoiSpace::World, rest),
            None => (RoiSpace::Index, text.strip_prefix("index:").unwrap_or(text)),
        };
        let end = |text: &str, open: f64| match text.trim() {
            "" => Some(open),
            number => number.parse().ok().filter(|x: &f64| x.is_finite()),
        };
        let range = |text: &str| {
            let (lo, hi) = text.split_once(':')?;
            Some([end(lo, f64::NEG_INFINITY)?, end(hi, f64::INFINITY)?])
        };
        let ranges: Option<Vec<[f64; 2]>> = ranges.split(',').map(range).collect();
        let ranges: [[f64; 2]; 3] = ranges.and_then(|r| r.try_into().ok()).ok_or_else(wrong)?;
        Ok(Self { space, lo: ranges.map(|r| r[0]), hi: ranges.map(|r| r[1]) })
    }
}

impl Roi {
    /// The half-spaces, in the world, whose intersection is the box; an open end gives none.
    /// `origin` is that of the surfaces that are cut.
    pub fn half_spaces(&self, geometry: &Geometry, dims: [u64; 3], origin: [f64; 3]) -> Vec<HalfSpace> {
        self.half_spaces_of(geometry, scale_of(domain_hull(geometry, dims), origin))
    }

    /// The same for positions of at most `scale` along each axis, as they are stored.
    pub(super) fn half_spaces_of(&self, geometry: &Geometry, scale: [f64; 3]) -> Vec<HalfSpace> {
        let mut all = vec![];
        for a in 0..3 {
            let (normal, offset) = self.axis(a, geometry);
            for (end, sign) in [(self.lo[a], 1.0), (self.hi[a], -1.0)] {
                if end.is_finite() {
                    all.push(HalfSpace::new(normal.map(|x| sign * x), sign * (end - offset), scale));
                }
            }
        }
        all
    }

    /// Coordinate `a` of this box as a function of world positions: normal · p + offset.
    fn axis(&self, a: usize, geometry: &Geometry) -> ([f64; 3], f64) {
        let unit = |b: usize| std::array::from_fn(|c| if b == c { 1.0 } else { 0.0 });
        match self.space {
            RoiSpace::World => (unit(a), 0.0),
            RoiSpace::Index => {
                let offset = geometry.to_index([0.0; 3])[a];
                (std::array::from_fn(|b| geometry.to_index(unit(b))[a] - offset), offset)
            }
        }
    }

    /// The box's hull in index space, open ends replaced by the domain's.
    fn index_hull(&self, geometry: &Geometry, dims: [u64; 3]) -> [[f64; 3]; 2] {
        let last = dims.map(|d| (d - 1) as f64);
        let to_space = |ijk: [f64; 3]| match self.space {
            RoiSpace::World => geometry.to_world(ijk),
            RoiSpace::Index => ijk,
        };
        let domain = hull(corners([0.0; 3], last).map(to_space));
        let lo = std::array::from_fn(|a| if self.lo[a].is_finite() { self.lo[a] } else { domain[0][a] });
        let hi = std::array::from_fn(|a| if self.hi[a].is_finite() { self.hi[a] } else { domain[1][a] });
        hull(corners(lo, hi).map(|p| match self.space {
            RoiSpace::World => geometry.to_index(p),
            RoiSpace::Index => p,
        }))
    }

    /// The nodes in the box, ends included, of `nodes` along each axis, the n-th of which is sample
    /// `stride · n`.
    ///
    /// # Errors
    /// [`Error::Usage`] for a box outside the domain, or without a node.
    pub(in crate::pipeline) fn nodes(
        &self,
        geometry: &Geometry,
        dims: [u64; 3],
        nodes: [u64; 3],
        stride: [u64; 3],
    ) -> Result<IndexBox> {
        // A single slice is a region here.
        if (0..3).any(|a| self.lo[a] != self.hi[a]) {
            let wide = |a: usize| if self.lo[a] == self.hi[a] { self.hi[a] + 1.0 } else { self.hi[a] };
            Self { hi: std::array::from_fn(wide), ..*self }.check_volume()?;
        }
        let ([lo, hi], last) = (self.index_hull(geometry, dims), dims.map(|d| (d - 1) as f64));
        if (0..3).any(|a| hi[a] < -ROUNDING || lo[a] > last[a] + ROUNDING) {
            return Err(self.outside(match self.space {
                RoiSpace::World => domain_hull(geometry, dims),
                RoiSpace::Index => [[0.0; 3], last],
            }));
        }
        let place = |x: f64, a: usize| x / stride[a] as f64;
        let first = |a: usize| place(lo[a] - ROUNDING, a).ceil().max(0.0) as u64;
        let end = |a: usize| (place(hi[a] + ROUNDING, a).floor() as u64 + 1).min(nodes[a]);
        let found = IndexBox { lo: std::array::from_fn(first), hi: std::array::from_fn(end) };
        if found.is_empty() {
            let [x, y, z] = stride;
            return Err(Error::usage(format!(
                "no sample lies in the region of interest {}: give a larger one, or a finer level (here is one at \
                 each {x}, {y}, {z} samples of the source)",
                in_words(self.lo, self.hi)
            )));
        }
        Ok(found)
    }

    fn check_volume(&self) -> Result<()> {
        // False for a NaN too.
        if (0..3).all(|a| self.lo[a] < self.hi[a]) {
            return Ok(());
        }
        Err(Error::usage(format!(
            "the region of interest {} has no volume: give the lower end of each axis first",
            in_words(self.lo, self.hi)
        )))
    }

    fn outside(&self, [lo, hi]: [[f64; 3]; 2]) -> Error {
        Error::usage(format!(
            "the region of interest {} is outside the volume, which is {}",
            in_words(self.lo, self.hi),
            in_words(lo, hi)
        ))
    }

    /// Refuses a box without volume, and one outside of a domain of these bounds.
    pub(super) fn check_within(&self, [lo, hi]: [[f64; 3]; 2]) -> Result<()> {
        self.check_volume()?;
        if (0..3).any(|a| self.hi[a] < lo[a] || self.lo[a] > hi[a]) {
            return Err(self.outside([lo, hi]));
        }
        Ok(())
    }

    /// The cut of an archive's surfaces, which have this origin, at this box.
    ///
    /// # Errors
    /// [`Error::Usage`] for a box without volume, and for one outside the domain.
    pub(in crate::pipeline) fn cut(
        &self,
        geometry: &Geometry,
        dims: [u64; 3],
        log2_steps: [u32; 3],
        origin: [f64; 3],
    ) -> Result<Cut> {
        self.check_volume()?;
        let [lo, hi] = self.index_hull(geometry, dims);
        let last = dims.map(|d| (d - 1) as f64);
        let domain = match self.space {
            RoiSpace::World => domain_hull(geometry, dims),
            RoiSpace::Index => [[0.0; 3], last],
        };
        if (0..3).any(|a| hi[a] < 0.0 || lo[a] > last[a]) {
            return Err(self.outside(domain));
        }
        let steps = log2_steps.map(|s| f64::from(1u32 << s));
        // One step more than rounding could lose; beyond the domain, casts saturate.
        let lattice = LatticeBox {
            lo: std::array::from_fn(|a| ((lo[a] * steps[a]).floor() - 1.0).max(0.0) as u32),
            hi: std::array::from_fn(|a| ((hi[a] * steps[a]).ceil() + 2.0).max(0.0) as u32),
        };
        Ok(Cut {
            lattice,
            half_spaces: self.half_spaces(geometry, dims, origin),
            roi: *self,
            geometry: *geometry,
            steps,
        })
    }
}

/// A box in words; an open end has none.
fn in_words(lo: [f64; 3], hi: [f64; 3]) -> String {
    let end = |v: f64| if v.is_infinite() { String::new() } else { v.to_string() };
    [0, 1, 2].map(|a| format!("{}:{}", end(lo[a]), end(hi[a]))).join(",")
}

/// The least box of the world that holds a volume of `dims` samples.
pub(super) fn domain_hull(geometry: &Geometry, dims: [u64; 3]) -> [[f64; 3]; 2] {
    hull(corners([0.0; 3], dims.map(|d| (d - 1) as f64)).map(|p| geometry.to_world(p)))
}

fn corners(lo: [f64; 3], hi: [f64; 3]) -> [[f64; 3]; 8] {
    std::array::from_fn(|n| std::array::from_fn(|a| if n >> a & 1 == 0 { lo[a] } else { hi[a] }))
}

fn hull(points: [[f64; 3]; 8]) -> [[f64; 3]; 2] {
    let fold = |f: fn(f64, f64) -> f64| {
        std::array::from_fn(|a| points.iter().map(|p| p[a]).reduce(f).expect("eight are not none"))
    };
    [fold(f64::min), fold(f64::max)]
}

/// The largest coordinate in a box of the world along each axis, in size, counted from an origin.
pub(super) fn scale_of([lo, hi]: [[f64; 3]; 2], origin: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|a| (lo[a] - origin[a]).abs().max((hi[a] - origin[a]).abs()))
}

/// A [`Roi`] on an archive's lattice.
pub(in crate::pipeline) struct Cut {
    /// Holds the box.
    lattice: LatticeBox,
    pub(in crate::pipeline) half_spaces: Vec<HalfSpace>,
    roi: Roi,
    geometry: Geometry,
    /// Steps of the lattice in a voxel, along each axis.
    steps: [f64; 3],
}

impl Cut {
    /// Whether the bounding box of some corners touches the box's hull. Certainly true for those of
    /// a tetrahedron that the box touches.
    pub(in crate::pipeline) fn may_touch(&self, corners: &[LatticePos]) -> bool {
        (0..3).all(|a| {
            let mut along = corners.iter().map(|p| p[a]);
            along.clone().any(|x| x >= self.lattice.lo[a]) && along.any(|x| x < self.lattice.hi[a])
        })
    }

    /// Whether the bounding box of some corners touches the region, both in the coordinates of the
    /// region: in a rotated volume, a box of the world is not a box of the lattice.
    pub(in crate::pipeline) fn touches(&self, corners: &[LatticePos]) -> bool {
        let place = |p: &LatticePos| {
            let ijk = std::array::from_fn(|a| f64::from(p[a]) / self.steps[a]);
            match self.roi.space {
                RoiSpace::World => self.geometry.to_world(ijk),
                RoiSpace::Index => ijk,
            }
        };
        let ends = |[lo, hi]: [[f64; 3]; 2], p: [f64; 3]| {
            [std::array::from_fn(|a| p[a].min(lo[a])), std::array::from_fn(|a| p[a].max(hi[a]))]
        };
        let [lo, hi] = corners.iter().map(place).fold([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]], ends);
        (0..3).all(|a| lo[a] <= self.roi.hi[a] && hi[a] >= self.roi.lo[a])
    }

    /// Whether a box of the lattice touches the box's hull.
    pub(in crate::pipeline) fn may_touch_box(&self, b: &LatticeBox) -> bool {
        !self.lattice.intersect(b).is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_spellings_are_read_and_nonsense_is_not() {
        let index: Roi = "1:2.5,-3:4, 5 : 6".parse().unwrap();
        assert_eq!(index, Roi { space: RoiSpace::Index, lo: [1.0, -3.0, 5.0], hi: [2.5, 4.0, 6.0] });
        let world: Roi = "world:-1e3:2,:,3:".parse().unwrap();
        let inf = f64::INFINITY;
        assert_eq!(world, Roi { space: RoiSpace::World, lo: [-1e3, -inf, 3.0], hi: [2.0, inf, inf] });
        for bad in ["", "1:2,3:4", "1:2,3:4,5", "1:2,3:4,5:x", "1:2,3:4,5:6,7:8", "world", "1:nan,:,:"] {
            assert!(bad.parse::<Roi>().unwrap_err().contains("I0:I1"), "{bad}");
        }
    }

    #[test]
    fn a_box_in_the_world_is_the_same_box_in_index_space() {
        // Axes swapped, one mirrored, spacing 2, 1, 3.
        let geometry = Geometry {
            origin: [100.0, 200.0, 300.0],
            spacing: [2.0, 1.0, 3.0],
            direction: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        };
        let dims = [11, 21, 31];
        let index: Roi = "2:4,5:9,:7".parse().unwrap();
        let world: Roi = "world:91:95,204:208,:321".parse().unwrap();
        let [a, b] = [index, world].map(|roi| roi.cut(&geometry, dims, [4; 3], [0.0; 3]).unwrap());
        assert_eq!(a.lattice, b.lattice);
        assert_eq!((a.half_spaces.len(), b.half_spaces.len()), (5, 5));
        for (p, inside) in
            [([93.0, 206.0, 310.0], true), ([93.0, 206.0, 322.0], false), ([96.0, 206.0, 310.0], false)]
        {
            for cut in [&a, &b] {
                assert_eq!(cut.half_spaces.iter().all(|h| h.distance(p) >= 0.0), inside, "{p:?}");
            }
        }
    }

    #[test]
    fn a_box_without_volume_or_outside_is_refused() {
        let cut = |text: &str| {
            let roi: Roi = text.parse().unwrap();
            roi.cut(&Geometry::default(), [10; 3], [3; 3], [0.0; 3]).map(drop).map_err(|e| e.to_string())
        };
        assert!(cut("2:2,:,:").unwrap_err().contains("no volume"));
        assert!(cut("5:2,:,:").unwrap_err().contains("no volume"));
        assert!(cut("9.5:12,:,:").unwrap_err().contains("outside"));
        assert!(cut("8.5:1e300,:,:").is_ok());
    }
}
