//! Meshes of labels, one after another, from sorted sides of quads.

use super::{Side, smooth::UNITS};
use crate::surface::model::{SurfaceSource, Vertex};
use crate::surface::weld::StoredSurface;
use crate::surface::world_map::WorldMap;
use isospan_io::error::{Error, Result};
use isospan_io::geom::vec3::{cross, dot, minus};
use rustc_hash::FxHashMap;
use std::collections::VecDeque;

/// Bytes of a vertex that is not finished yet, about.
const OPEN_VERTEX: u64 = 120;

/// The mesh of a label, in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LabelMeshSize {
    /// Vertices.
    pub vertices: u64,
    /// Triangles.
    pub triangles: u64,
    /// Voxels of the label.
    pub voxels: u64,
    /// Area, in world units.
    pub area: f64,
    /// Enclosed volume, in world units.
    pub volume: f64,
}

/// Makes the meshes of labels from the sides of their quads, which come in their order.
///
/// A vertex is in the quads of two layers of cells, so two layers are looked up.
pub struct LabelBuilder {
    world: WorldMap,
    /// The number of each vertex of a layer, by y, x and loop: those of this layer and of the next.
    layers: [FxHashMap<u64, u32>; 2],
    /// The layer of the first.
    layer: u32,
    /// Vertices that further quads may have.
    open: VecDeque<OpenVertex>,
    /// The number of the first of them, in the surface.
    first_open: u64,
    /// Bytes for them.
    memory: u64,
    sums: Sums,
}

struct OpenVertex {
    layer: u32,
    position: [f32; 3],
    normal: [f64; 3],
}

/// Sums over the triangles of a label.
#[derive(Default)]
struct Sums {
    vertices: u64,
    triangles: u64,
    /// Faces of voxels across x times their places: the number of voxels.
    faces: i64,
    area: f64,
    volume: f64,
    /// A place nearby, from which volumes are counted.
    centre: Option<[f64; 3]>,
}

impl LabelBuilder {
    /// For labels of a grid whose nodes a map places in the world. `memory` bytes are for vertices
    /// that further quads may have.
    pub fn new(world: &WorldMap, memory: u64) -> Self {
        Self {
            world: *world,
            layers: Default::default(),
            layer: 0,
            open: VecDeque::new(),
            first_open: 0,
            memory,
            sums: Sums::default(),
        }
    }

    /// Adds the next side of a label to a surface, in which its vertices follow those of the labels
    /// before.
    ///
    /// # Errors
    /// [`Error::Usage`] for 2^32 vertices or more; [`Error::Budget`] where memory does not hold two
    /// layers; [`Error::Io`] when the scratch file cannot be written.
    pub fn add(&mut self, side: &Side, out: &mut StoredSurface) -> Result<()> {
        let layer = side.cell[0];
        if layer != self.layer {
            self.go_to(layer, out)?;
        }
        self.first_open = out.vertex_count();
        let numbers = self.corners(side, out)?;
        let mut order = if side.is_cut_at_second() { [1, 2, 3, 0] } else { [0, 1, 2, 3] };
        if side.is_second() != self.world.mirrors() {
            order.swap(1, 3);
        }
        let [a, b, c, d] = order.map(|corner| numbers[corner]);
        for triangle in [[a, b, c], [a, c, d]] {
            self.count(triangle);
            out.push_triangle(triangle)?;
        }
        if side.axis() == 0 {
            let place = i64::from(side.cell[2]);
            self.sums.faces += if side.is_second() { -place } else { place };
        }
        Ok(())
    }

    /// Ends a label.
    ///
    /// # Errors
    /// [`Error::Io`] when the scratch file cannot be written.
    pub fn end_label(&mut self, out: &mut StoredSurface) -> Result<LabelMeshSize> {
        self.layers.iter_mut().for_each(FxHashMap::clear);
        self.finish(u32::MAX, out)?;
        self.layer = 0;
        let Sums { vertices, triangles, faces, area, volume, .. } = std::mem::take(&mut self.sums);
        Ok(LabelMeshSize { vertices, triangles, voxels: faces.unsigned_abs(), area, volume })
    }

    /// Begins a layer: vertices of layers before it are finished.
    fn go_to(&mut self, layer: u32, out: &mut StoredSurface) -> Result<()> {
        let needed = self.open.len() as u64 * OPEN_VERTEX;
        if needed > self.memory {
            return Err(Error::memory("for two layers of a label's vertices", needed, self.memory));
        }
        self.layers.swap(0, 1);
        self.layers[1].clear();
        if layer != self.layer + 1 {
            self.layers[0].clear();
        }
        self.layer = layer;
        self.finish(layer, out)
    }

    /// Stores the vertices before a layer, as far as none of a later one comes before them.
    fn finish(&mut self, layer: u32, out: &mut StoredSurface) -> Result<()> {
        while self.open.front().is_some_and(|v| v.layer < layer) {
            let Some(OpenVertex { position, normal, .. }) = self.open.pop_front() else { break };
            let length = dot(normal, normal).sqrt();
            let normal = if length > 0.0 { normal.map(|x| (x / length) as f32) } else { [0.0; 3] };
            out.push_vertex(Vertex { position, normal })?;
        }
        Ok(())
    }

    /// The numbers of the vertices at the corners of a quad.
    fn corners(&mut self, side: &Side, out: &StoredSurface) -> Result<[u32; 4]> {
        let mut numbers = [0; 4];
        for (corner, number) in numbers.iter_mut().enumerate() {
            let cell = side.corner_cell(corner);
            let key =
                u64::from(cell[1]) << 32 | u64::from(cell[0]) << 2 | u64::from(side.corner_loop(corner));
            let layer = &mut self.layers[(cell[2] - self.layer) as usize];
            let next = out.vertex_count() + self.open.len() as u64;
            if next >= u64::from(u32::MAX) {
                return Err(Error::usage(format!(
                    "the labels have more than {} vertices, the most of one file: give each a file, or ask for fewer",
                    u32::MAX
                )));
            }
            *number = *layer.entry(key).or_insert(next as u32);
            if u64::from(*number) == next {
                let offset = side.offsets[corner];
                let place =
                    [0, 1, 2].map(|a| f64::from(cell[a]) - 0.5 + f64::from(offset[a]) / f64::from(UNITS));
                let position = self.world.position(place);
                self.open.push_back(OpenVertex { layer: cell[2], position, normal: [0.0; 3] });
                self.sums.vertices += 1;
            }
        }
        Ok(numbers)
    }

    /// Adds a triangle to the sums, and to the normals of its corners.
    fn count(&mut self, triangle: [u32; 3]) {
        let at = triangle.map(|number| (u64::from(number) - self.first_open) as usize);
        let [p, q, r] = at.map(|n| self.open[n].position.map(f64::from));
        let normal = cross(minus(q, p), minus(r, p));
        for n in at {
            let sum = &mut self.open[n].normal;
            *sum = [0, 1, 2].map(|a| sum[a] + normal[a]);
        }
        let sums = &mut self.sums;
        let centre = *sums.centre.get_or_insert(p);
        sums.triangles += 1;
        sums.area += dot(normal, normal).sqrt() / 2.0;
        sums.volume += dot(minus(p, centre), normal) / 6.0;
    }
}
