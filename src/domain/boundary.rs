//! Samples of the boundary of a mesh, and what they clear around them.
//!
//! Samples keep their distance from each other, corners and edges first
//! ([`scatter`](super::scatter)), about as far apart as points inside. Positions are rounded to the
//! lattice. A sample is a point of the mesh even where rounding has pushed it outside: then its
//! value is interpolated in its triangle.
//!
//! # The boundary becomes faces
//!
//! Samples alone do not make the boundary a part of the tetrahedralization. A point outside that is
//! nearer to the wall than samples are to each other has tetrahedra that reach deep inside. If
//! these are kept, the wall sticks out; if they are left out, it has dents. So no point of the set
//! lies near a sample, on either side: within [`CLEAR`] mean distances. That is √2 times the radius
//! of the circles between samples and more, as spheres reach further out where a body is thin.
//!
//! ```text
//!      p                A sphere through three samples whose circle has the radius r reaches a
//!    ·╱ ╲·    a         above the wall and b below, a·b = r². Let p above and q below be at least
//!  ──s───s──            √2·r from each sample: then both are at least r from the wall near the
//!    ·╲ ╱·    b         circle's middle, and no sphere through s and p holds q. So the triangle is
//!      q                a face of the Delaunay tetrahedralization: a flat wall is made of faces.
//! ```
//!
//! Then each tetrahedron lies on one side, and its centroid shows which. Four samples of a flat
//! wall form a tetrahedron whose only thickness comes from rounding; it is left out.
//!
//! # Bodies that touch
//!
//! A point has one value. So where two bodies touch, each sample becomes two, one a little inside
//! of each body: see [`contact`](super::contact).

use super::contact::Contacts;
use super::near::{Near, sorted};
use super::scatter::scattered;
use super::spacing::Spacing;
use super::store::CellStore;
use super::wall::{Sample, Surface};
use isospan_io::error::{Error, Result};
use isospan_io::geom::LatticePos;
use isospan_mesh::locate::FINE_BITS;
use isospan_mesh::points::ExplicitPoints;
use std::path::Path;
use std::sync::Arc;

/// All samples, in the order of the list of their positions.
pub(crate) struct BoundarySamples {
    pub(crate) points: Arc<ExplicitPoints>,
    samples: Vec<Sample>,
}

/// Samples per square of the mean distance by which places of the boundary are found.
const NEAR_DENSITY: f64 = 2.0;
/// No point that follows a formula lies within this many mean distances of a sample.
const CLEAR: f64 = 1.2;

impl BoundarySamples {
    /// Samples the boundary of a mesh whose inside has points at this mean distance.
    ///
    /// # Errors
    /// [`Error::Budget`] when `memory` does not hold them.
    pub(crate) fn new(store: &CellStore, spacing: &Spacing, memory: u64, path: &Path) -> Result<Self> {
        let step = f64::from(spacing.by_level[0]) * f64::from(1u32 << FINE_BITS);
        let near_each = step * step / NEAR_DENSITY;
        let (positions, triangles) = (store.positions.get()?, store.boundary.get()?);
        let surface = Surface { positions, triangles, spacing };
        let count = surface.area() / near_each;
        // The list, its neighbourhoods, sorted; of several bodies pairs, places by which neighbours
        // are found, and while they are located.
        let lists = if store.census.bodies > 1 { 8.0 } else { 4.0 };
        let bytes = (count * lists * size_of::<(LatticePos, Sample)>() as f64) as u64;
        if bytes > memory || count > ExplicitPoints::MOST as f64 {
            let purpose = format!("for {count:.0} samples of the boundary of {}", path.display());
            return Err(Error::memory(purpose, bytes, memory));
        }
        let lattice = store.frame.lattice;
        let samples = scattered(store, &surface)?;
        let samples: Vec<(LatticePos, Sample)> = if store.census.bodies > 1 {
            let near = Near::new(lattice, spacing.clone(), surface.sampled(near_each));
            Contacts { near: &near, store, lattice, spacing }.split(&samples)?
        } else {
            samples.into_iter().map(|(p, s)| (p, Sample::On(s))).collect()
        };
        let (points, samples) = sorted(lattice, &samples);
        let clear = (CLEAR * f64::from(spacing.by_level[0])).round() as u32;
        Ok(Self { points: Arc::new(points.clearing(clear)), samples })
    }

    /// The sample at a position.
    pub(crate) fn at(&self, pos: LatticePos) -> Option<&Sample> {
        self.points.find(pos).map(|i| &self.samples[i])
    }
}
