//! A surface: vertices and triangles, in memory or read in batches.

use isospan_io::error::Result;

/// A vertex of an output surface, in world coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// Position, less the origin of its surface: see [`SurfaceSource::origin`].
    pub position: [f32; 3],
    /// Unit normal, pointing to lower values.
    pub normal: [f32; 3],
}

impl Vertex {
    /// Its place in the world, given the origin of its surface.
    #[inline]
    pub fn world(&self, origin: [f64; 3]) -> [f64; 3] {
        world_of(self.position, origin)
    }
}

/// The place in the world of a position that is counted from an origin.
#[inline]
pub(crate) fn world_of(position: [f32; 3], origin: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| origin[k] + f64::from(position[k]))
}

/// A position less an origin. What is counted from 0 already stays as it is.
#[inline]
pub(crate) fn relative_to(world: [f64; 3], origin: [f64; 3]) -> [f32; 3] {
    std::array::from_fn(|k| (world[k] - origin[k]) as f32)
}

/// A corner of a box in the world. A coordinate that is counted from 0 has the digits that it is
/// written with, as `f32`.
pub(super) fn corner_of(position: [f32; 3], origin: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| match origin[k] {
        0.0 => position[k].to_string().parse().unwrap_or(f64::from(position[k])),
        far => far + f64::from(position[k]),
    })
}

/// A finished surface, to be read front to back as often as needed, in batches, without being in
/// memory as a whole.
pub trait SurfaceSource {
    /// Number of vertices.
    fn vertex_count(&self) -> u64;
    /// Number of triangles.
    fn triangle_count(&self) -> u64;
    /// The place in the world that positions are counted from. It is 0 but for a surface so far
    /// from 0 that `f32` would not tell its vertices apart.
    fn origin(&self) -> [f64; 3] {
        [0.0; 3]
    }
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
    /// The place in the world that positions are counted from: see [`SurfaceSource::origin`].
    pub origin: [f64; 3],
}

impl TriMesh {
    /// A surface whose positions are those of the world.
    pub fn new(vertices: Vec<Vertex>, triangles: Vec<[u32; 3]>) -> Self {
        Self { vertices, triangles, origin: [0.0; 3] }
    }

    /// Reads a whole surface into memory: 24 bytes a vertex and 12 a triangle.
    ///
    /// # Errors
    /// Errors of reading the source.
    pub fn from_source(source: &dyn SurfaceSource) -> Result<Self> {
        let mut mesh = Self { origin: source.origin(), ..Self::default() };
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

    fn origin(&self) -> [f64; 3] {
        self.origin
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

    /// That of the first part.
    fn origin(&self) -> [f64; 3] {
        self.parts.first().map_or([0.0; 3], |p| p.origin())
    }

    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()> {
        let origin = self.origin();
        self.parts.iter().try_for_each(|part| vertices_from(*part, origin, each))
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

/// Hands out the vertices of a surface with positions that are counted from another origin.
pub(crate) fn vertices_from(
    source: &dyn SurfaceSource,
    origin: [f64; 3],
    each: &mut dyn FnMut(&[Vertex]) -> Result<()>,
) -> Result<()> {
    let own = source.origin();
    if own == origin {
        return source.vertices(each);
    }
    let mut moved = Vec::new();
    source.vertices(&mut |batch| {
        moved.clear();
        moved.extend(batch.iter().map(|v| Vertex { position: relative_to(v.world(own), origin), ..*v }));
        each(&moved)
    })
}
