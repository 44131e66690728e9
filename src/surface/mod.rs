//! Isosurfaces: marching tetrahedra, welding, checking.

use crate::error::Result;

/// A vertex of an output surface, in world coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// Position.
    pub position: [f32; 3],
    /// Unit normal, pointing to lower values.
    pub normal: [f32; 3],
}

/// A finished surface, to be read front to back as often as needed, in batches, without being in memory as a whole.
pub trait SurfaceSource {
    /// Number of vertices.
    fn vertex_count(&self) -> u64;
    /// Number of triangles.
    fn triangle_count(&self) -> u64;
    /// Hands all vertices, in order, in batches, to `each`.
    ///
    /// # Errors
    /// Those of reading the store, and those of `each`.
    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()>;
    /// Hands all triangles (three vertex numbers, counter-clockwise seen from outside) in order, in batches, to `each`.
    ///
    /// # Errors
    /// Those of reading the store, and those of `each`.
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
