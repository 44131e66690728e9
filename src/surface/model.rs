//! A surface: vertices and triangles, in memory or read in batches.

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
