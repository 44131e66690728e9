//! Meshes, fields and comparisons for the tests of this module.

use super::extract::{CellSource, ChunkSurface, Workbench, extract};
use super::weld::{BuilderSettings, SurfaceBuilder};
use super::{TriMesh, Vertex, WorldMap};
use isospan_io::geom::{Lattice, LatticePos, PointId};
use isospan_io::grid::Geometry;
use isospan_mesh::mesh::tet::Tet;

/// A box of voxels, each cut into Kuhn's six tetrahedra.
pub(super) struct Grid {
    pub(super) lattice: Lattice,
    pub(super) positions: Vec<LatticePos>,
    pub(super) ids: Vec<PointId>,
    pub(super) tets: Vec<Tet>,
}

/// The six tetrahedra of a cube: one for each order of the axes, along the path from corner 000 to
/// corner 111.
const PATHS: [([usize; 3], bool); 6] = [
    ([0, 1, 2], false),
    ([1, 2, 0], false),
    ([2, 0, 1], false),
    ([0, 2, 1], true),
    ([2, 1, 0], true),
    ([1, 0, 2], true),
];

impl Grid {
    pub(super) fn new(dims: [u64; 3]) -> Self {
        let lattice = Lattice::new(dims).unwrap();
        let number = |[i, j, k]: [u64; 3]| ((k * dims[1] + j) * dims[0] + i) as u32;
        let mut grid = Self { lattice, positions: Vec::new(), ids: Vec::new(), tets: Vec::new() };
        for k in 0..dims[2] {
            for (j, i) in (0..dims[1]).flat_map(|j| (0..dims[0]).map(move |i| (j, i))) {
                // An odd factor permutes the numbers below 2^40: ids in no order that positions
                // know.
                let id = (u64::from(number([i, j, k])) * 0x9E_3779_B97F) & ((1 << 40) - 1);
                grid.ids.push(PointId(id));
                grid.positions.push(lattice.of_voxel([i, j, k]));
                if i + 1 < dims[0] && j + 1 < dims[1] && k + 1 < dims[2] {
                    grid.add_cube([i, j, k], number);
                }
            }
        }
        grid
    }

    fn add_cube(&mut self, corner: [u64; 3], number: impl Fn([u64; 3]) -> u32) {
        for (path, odd) in PATHS {
            let mut at = corner;
            let mut tet = [number(at); 4];
            for (step, axis) in path.into_iter().enumerate() {
                at[axis] += 1;
                tet[step + 1] = number(at);
            }
            if odd {
                tet.swap(2, 3);
            }
            self.tets.push(tet);
        }
    }

    /// Values of a function of index space.
    pub(super) fn sample(&self, f: impl Fn([f64; 3]) -> f64) -> Vec<f32> {
        self.positions.iter().map(|&p| f(self.lattice.to_index_space(p)) as f32).collect()
    }

    /// The surface by way of one chunk.
    pub(super) fn surface(&self, values: &[f32], isovalue: f32, geometry: &Geometry) -> TriMesh {
        self.surface_of_chunks(values, isovalue, geometry, &vec![0; self.tets.len()])
    }

    /// The surface by way of chunks: `chunk[i]` is the chunk of tetrahedron i. Each chunk lists its
    /// corners in its own order, and the corners of its tetrahedra in its own rotation.
    pub(super) fn surface_of_chunks(
        &self,
        values: &[f32],
        isovalue: f32,
        geometry: &Geometry,
        chunk: &[usize],
    ) -> TriMesh {
        let world = WorldMap::new(&self.lattice, geometry);
        let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
        let mut out = ChunkSurface::default();
        for part in self.parts(values, chunk) {
            extract(&part.source(), isovalue, &world, &mut Workbench::default(), &mut out);
            builder.push(&out).unwrap();
        }
        TriMesh::from_source(&builder.finish().unwrap()).unwrap()
    }

    pub(super) fn parts(&self, values: &[f32], chunk: &[usize]) -> Vec<OwnedChunk> {
        let count = chunk.iter().max().map_or(0, |c| c + 1);
        let tets_of = |c: usize| (0..self.tets.len()).filter(move |&i| chunk[i] == c);
        let mut users = vec![0u32; self.positions.len()];
        let corners: Vec<Vec<u32>> = (0..count)
            .map(|c| {
                let mut all: Vec<u32> = tets_of(c).flat_map(|i| self.tets[i]).collect();
                all.sort_unstable_by_key(|v| v.wrapping_mul(0x9E37_79B9 + 2 * c as u32));
                all.dedup();
                all.iter().for_each(|&v| users[v as usize] += 1);
                all
            })
            .collect();
        let part = |(c, corners): (usize, &Vec<u32>)| {
            let mut local = vec![u32::MAX; self.positions.len()];
            corners.iter().enumerate().for_each(|(i, &v)| local[v as usize] = i as u32);
            let rotate = |[a, b, c, d]: Tet, by: usize| match by % 3 {
                0 => [a, b, c, d],
                1 => [b, c, a, d],
                _ => [d, c, b, a],
            };
            OwnedChunk {
                positions: corners.iter().map(|&v| self.positions[v as usize]).collect(),
                values: corners.iter().map(|&v| values[v as usize]).collect(),
                ids: corners.iter().map(|&v| self.ids[v as usize]).collect(),
                shared: corners.iter().map(|&v| users[v as usize] > 1).collect(),
                tets: tets_of(c).map(|i| rotate(self.tets[i].map(|v| local[v as usize]), i + c)).collect(),
            }
        };
        corners.iter().enumerate().map(part).collect()
    }
}

/// A chunk that owns its arrays.
pub(super) struct OwnedChunk {
    pub(super) positions: Vec<LatticePos>,
    pub(super) values: Vec<f32>,
    pub(super) ids: Vec<PointId>,
    pub(super) shared: Vec<bool>,
    pub(super) tets: Vec<Tet>,
}

impl OwnedChunk {
    pub(super) fn source(&self) -> CellSource<'_> {
        CellSource {
            positions: &self.positions,
            values: &self.values,
            ids: &self.ids,
            shared: &self.shared,
            numbers: None,
            tets: &self.tets,
        }
    }
}

/// The triangles as a sorted list of the bits of their corners, each beginning with its smallest
/// corner: equal for two meshes exactly when they are the same set of triangles with the same
/// positions and normals.
pub(super) fn triangle_set(mesh: &TriMesh) -> Vec<[[u32; 6]; 3]> {
    let bits = |v: &Vertex| bytemuck::cast::<Vertex, [u32; 6]>(*v);
    let mut set: Vec<[[u32; 6]; 3]> = mesh
        .triangles
        .iter()
        .map(|t| {
            let mut corners = t.map(|v| bits(&mesh.vertices[v as usize]));
            let smallest = (0..3).min_by_key(|&i| corners[i]).unwrap();
            corners.rotate_left(smallest);
            corners
        })
        .collect();
    set.sort_unstable();
    set
}

/// A surface with everything but closedness in order.
pub(super) fn assert_sound(mesh: &TriMesh) -> super::check::SurfaceCheckReport {
    let report = super::check::check(mesh);
    assert!(report.is_manifold() && report.is_oriented(), "{report:?}");
    assert_eq!(
        (report.zero_area_triangles, report.unreferenced_vertices, report.non_finite_vertices),
        (0, 0, 0),
        "{report:?}"
    );
    for v in &mesh.vertices {
        let length: f32 = v.normal.iter().map(|x| x * x).sum();
        assert!((length - 1.0).abs() < 1e-5, "{v:?}");
    }
    report
}

/// A map that mirrors, is anisotropic, rotated and shifted.
pub(super) fn mirrored() -> Geometry {
    Geometry {
        origin: [3.0, -20.0, 7.0],
        spacing: [0.5, 2.0, 1.25],
        direction: [[0.6, 0.8, 0.0], [0.8, -0.6, 0.0], [0.0, 0.0, 1.0]],
    }
}
