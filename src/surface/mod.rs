//! Isosurfaces: marching tetrahedra, welding, checking.
//!
//! ```text
//!  tetrahedra of a chunk ──▶ ChunkSurface ──▶ SurfaceBuilder ──▶ StoredSurface ──▶ a writer of formats/
//!                    extract (any thread)   push (chunk order)   finish
//! ```
//!
//! * [`marching_tets`] turns the active tetrahedra of one chunk into triangles, welded inside the
//!   chunk. Any number of chunks may be extracted at once.
//! * [`weld`] joins the chunks, in chunk order, by edge key, and stores the result on disk beyond a
//!   given size.
//! * [`fans`] splits vertices at which a surface touches itself, where tetrahedra are missing.
//! * [`clip`] cuts a finished surface at planes.
//! * [`components`] measures the connected components and keeps some.
//! * [`decimate`] makes do with fewer triangles.
//! * [`cap`] closes a surface where the domain ends.
//! * [`check`] says of any triangle mesh whether it is closed, manifold and oriented.
//!
//! An edge of the mesh is the pair of its [`crate::geom::PointId`]s, the lower first. Everything
//! about a surface vertex is a function of its edge, so neither the threads nor the cut into chunks
//! show in the surface.

pub mod cap;
mod cases;
pub mod check;
pub mod clip;
mod collapse;
pub mod components;
pub mod decimate;
mod edges;
pub mod fans;
mod fours;
pub(crate) mod known;
pub mod marching_tets;
pub(crate) mod numbered;
mod numbering;
pub(crate) mod ordered;
mod patch;
#[cfg(test)]
mod testing;
pub mod weld;

use crate::error::Result;
use crate::geom::Lattice;
use crate::grid::Geometry;

/// A vertex of an output surface, in world coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// Position.
    pub position: [f32; 3],
    /// Unit normal, pointing to lower values.
    pub normal: [f32; 3],
}

/// A finished surface, to be read front to back as often as needed, in batches, without being in
/// memory as a whole.
pub trait SurfaceSource {
    /// Number of vertices.
    fn vertex_count(&self) -> u64;
    /// Number of triangles.
    fn triangle_count(&self) -> u64;
    /// Hands all vertices, in order, in batches, to `each`.
    ///
    /// # Errors
    /// Errors of reading the store, and those of `each`.
    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()>;
    /// Hands all triangles (three vertex numbers, counter-clockwise seen from outside) in order, in
    /// batches, to `each`.
    ///
    /// # Errors
    /// Errors of reading the store, and those of `each`.
    fn triangles(&self, each: &mut dyn FnMut(&[[u32; 3]]) -> Result<()>) -> Result<()>;
}

/// A surface in memory: what the checker and small tools work on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriMesh {
    /// Vertices.
    pub vertices: Vec<Vertex>,
    /// Triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl TriMesh {
    /// Reads a whole surface into memory: 24 bytes a vertex and 12 a triangle.
    ///
    /// # Errors
    /// Errors of reading the source.
    pub fn from_source(source: &dyn SurfaceSource) -> Result<Self> {
        let mut mesh = Self::default();
        source.vertices(&mut |batch| {
            mesh.vertices.extend_from_slice(batch);
            Ok(())
        })?;
        source.triangles(&mut |batch| {
            mesh.triangles.extend_from_slice(batch);
            Ok(())
        })?;
        Ok(mesh)
    }
}

impl SurfaceSource for TriMesh {
    fn vertex_count(&self) -> u64 {
        self.vertices.len() as u64
    }

    fn triangle_count(&self) -> u64 {
        self.triangles.len() as u64
    }

    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()> {
        each(&self.vertices)
    }

    fn triangles(&self, each: &mut dyn FnMut(&[[u32; 3]]) -> Result<()>) -> Result<()> {
        each(&self.triangles)
    }
}

/// Surfaces one after another, as one.
#[derive(Clone)]
pub struct Joined<'a> {
    parts: Vec<&'a dyn SurfaceSource>,
}

impl<'a> Joined<'a> {
    /// The vertices of all parts, then their triangles, in order; no vertex is shared between
    /// parts.
    pub fn new(parts: Vec<&'a dyn SurfaceSource>) -> Self {
        Self { parts }
    }
}

impl SurfaceSource for Joined<'_> {
    fn vertex_count(&self) -> u64 {
        self.parts.iter().map(|p| p.vertex_count()).sum()
    }

    fn triangle_count(&self) -> u64 {
        self.parts.iter().map(|p| p.triangle_count()).sum()
    }

    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()> {
        self.parts.iter().try_for_each(|p| p.vertices(each))
    }

    fn triangles(&self, each: &mut dyn FnMut(&[[u32; 3]]) -> Result<()>) -> Result<()> {
        let (mut first, mut moved) = (0u64, Vec::new());
        for part in &self.parts {
            // Numbers have 32 bits; a writer refuses more vertices before it asks for a triangle.
            let offset = first as u32;
            part.triangles(&mut |batch| {
                moved.clear();
                moved.extend(batch.iter().map(|t| t.map(|v| v.wrapping_add(offset))));
                each(&moved)
            })?;
            first += part.vertex_count();
        }
        Ok(())
    }
}

/// From the lattice to the world: positions as points, gradients as covectors.
///
/// All of it is in `f64`; a surface vertex is rounded to `f32` once, at the end. Far from the
/// world's origin (more than about a million voxels) that rounding is coarser than 1/16 of a voxel,
/// and small triangles may lose their area; the connectivity is never touched.
#[derive(Clone, Copy, Debug)]
pub struct WorldMap {
    geometry: Geometry,
    /// Voxels a lattice step along each axis, powers of two.
    steps: [f64; 3],
    /// World vectors of the three unit vectors of index space.
    axes: [[f64; 3]; 3],
    /// World covectors of the three unit covectors of the lattice, as long as those of index space
    /// where it has the fewest steps a voxel.
    covectors: [[f64; 3]; 3],
    mirrors: bool,
}

impl WorldMap {
    /// The map of a structured volume.
    pub fn new(lattice: &Lattice, geometry: &Geometry) -> Self {
        let unit = |a: usize| std::array::from_fn(|b| if a == b { 1.0 } else { 0.0 });
        let finer = lattice.finer().map(|f| f64::from(1u32 << f));
        Self {
            geometry: *geometry,
            steps: lattice.log2_steps.map(|s| 1.0 / f64::from(1u32 << s)),
            axes: geometry.axes(),
            covectors: std::array::from_fn(|a| {
                geometry.gradient_to_world(unit(a).map(|x: f64| x * finer[a]))
            }),
            mirrors: geometry.mirrors(),
        }
    }

    /// Whether the map mirrors, so that triangles must be turned over.
    pub fn mirrors(&self) -> bool {
        self.mirrors
    }

    /// The unit world vector of minus the lattice covector `g`; `None` when that has no direction.
    #[inline]
    fn unit_normal(&self, g: [f64; 3]) -> Option<[f32; 3]> {
        let c = &self.covectors;
        let w: [f64; 3] = std::array::from_fn(|k| -(g[0] * c[0][k] + g[1] * c[1][k] + g[2] * c[2][k]));
        // Scaled by the largest component first: spacings of 1e-200 are legal, and their squares
        // vanish.
        let [x, y, z] = w.map(f64::abs);
        let largest = if y < x { x } else { y };
        let largest = if z < largest { largest } else { z };
        if !Self::has_direction(largest) {
            return None;
        }
        let scale = Self::scale_of(largest);
        let w = w.map(|x| x * scale);
        let inverse = 1.0 / (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]).sqrt();
        Some(w.map(|x| (x * inverse) as f32))
    }

    /// Whether a vector with this largest component has a direction.
    #[inline(always)]
    fn has_direction(largest: f64) -> bool {
        largest > 0.0 && largest.is_finite()
    }

    /// A power of two that makes the largest component about 1; for the smallest numbers there is
    /// none large enough, nor need be.
    #[inline(always)]
    fn scale_of(largest: f64) -> f64 {
        f64::from_bits((2046 - (largest.to_bits() >> 52).min(2045)) << 52)
    }
}
