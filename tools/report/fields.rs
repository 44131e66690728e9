//! Tetrahedra with values that are no archive: the original data, and uniform random points.
//!
//! A structured set is cut into tetrahedra as the thesis does it, each cube into six around its diagonal (Kuhn 1960): (50 - 1)³ · 6 =
//! 705 894. Uniform random points are no point set of isospan's, as no box could list its own; here they are few, and
//! the stages are called one by one: points, mesh, values, surface.

use crate::data::tets::TetMesh;
use isospan::Result;
use isospan::geom::curve::Order;
use isospan::geom::{Lattice, LatticePos, PointClass, PointId, Site};
use isospan::grid::{Geometry, IndexBox};
use isospan::locate::{CellBatch, FinePos, Found, PointGrid, fine, linear};
use isospan::mesh::delaunay::Mesher;
use isospan::mesh::tet::Tet;
use isospan::points::{PointSet, PointSpec};
use isospan::sample::{Interpolation, VoxelBlock, sample};
use isospan::surface::marching_tets::{CellSource, ChunkSurface, extract};
use isospan::surface::weld::{BuilderSettings, SurfaceBuilder};
use isospan::surface::{TriMesh, WorldMap};
use std::time::Instant;

/// A field, linear in each tetrahedron.
pub(crate) struct TetField {
    lattice: Lattice,
    geometry: Geometry,
    positions: Vec<LatticePos>,
    values: Vec<f32>,
    pub(crate) tets: Vec<Tet>,
}

/// A field on uniform random points, with the seconds of its stages.
pub(crate) struct Random {
    pub(crate) field: TetField,
    pub(crate) mesh_seconds: f64,
    pub(crate) sample_seconds: f64,
}

impl TetField {
    /// A cube of samples, each of its cells in six tetrahedra.
    pub(crate) fn of_grid(side: usize, geometry: Geometry, samples: &[f32]) -> Result<Self> {
        const PATHS: [[usize; 3]; 6] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [1, 0, 2], [2, 1, 0]];
        let lattice = Lattice::new([side as u64; 3])?;
        let of = |n: usize| [n % side, n / side % side, n / side / side];
        let positions = (0..samples.len()).map(|n| lattice.of_voxel(of(n).map(|i| i as u64))).collect();
        let strides = [1, side as u32, (side * side) as u32];
        let mut tets = vec![];
        for n in (0..samples.len()).filter(|&n| of(n).iter().all(|&i| i + 1 < side)) {
            for (number, path) in PATHS.iter().enumerate() {
                let mut tet = [n as u32; 4];
                for (i, &axis) in path.iter().enumerate() {
                    tet[i + 1] = tet[i] + strides[axis];
                }
                // The last three paths are odd permutations of the axes.
                if number >= 3 {
                    tet.swap(2, 3);
                }
                tets.push(tet);
            }
        }
        Ok(Self { lattice, geometry, positions, values: samples.to_vec(), tets })
    }

    pub(crate) fn point_count(&self) -> u64 {
        self.positions.len() as u64
    }

    /// A tetrahedral mesh, its vertices rounded to 2^-24 of its longest side.
    pub(crate) fn of_mesh(mesh: &TetMesh) -> Result<Self> {
        const CELLS: f64 = 1024.0;
        let [lo, hi] = mesh.bounds();
        let side: [f64; 3] = std::array::from_fn(|k| hi[k] - lo[k]);
        let voxel = side.iter().fold(0.0, |a: f64, &b| a.max(b)) / CELLS;
        let lattice = Lattice::new(side.map(|s| (s / voxel).ceil().max(1.0) as u64 + 1))?;
        let steps = f64::from(1u32 << lattice.log2_steps);
        let max = lattice.max();
        let place = |p: &[f64; 3]| -> LatticePos {
            std::array::from_fn(|k| (((p[k] - lo[k]) / voxel * steps).round() as u32).min(max[k]))
        };
        Ok(Self {
            lattice,
            geometry: Geometry { origin: lo, spacing: [voxel; 3], ..Geometry::default() },
            positions: mesh.points.iter().map(place).collect(),
            values: mesh.values.clone(),
            tets: mesh.tets.clone(),
        })
    }

    /// The surface of an isovalue, from all cells.
    pub(crate) fn surface(&self, isovalue: f32) -> Result<TriMesh> {
        let ids: Vec<PointId> =
            (0..self.positions.len()).map(|n| PointId::new(PointClass::Interior, n as u64)).collect();
        let cells = CellSource {
            positions: &self.positions,
            values: &self.values,
            ids: &ids,
            shared: &vec![false; ids.len()],
            numbers: None,
            tets: &self.tets,
        };
        let world = WorldMap::new(&self.lattice, &self.geometry);
        let mut chunk = ChunkSurface::default();
        extract(&cells, isovalue, &world, &mut chunk);
        let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
        builder.push(&chunk)?;
        TriMesh::from_source(&builder.finish()?)
    }

    /// The field at the samples of a cube of which `self` fills the whole.
    pub(crate) fn at_samples(&self, side: usize) -> Vec<f32> {
        let of = |n: usize| [n % side, n / side % side, n / side / side].map(|i| i as u64);
        let points: Vec<FinePos> = (0..side.pow(3)).map(|n| fine(self.lattice.of_voxel(of(n)))).collect();
        let cells = CellBatch {
            positions: self.positions.iter().map(|&p| fine(p)).collect(),
            corners: self.tets.clone(),
            ids: (0..self.tets.len() as u64).collect(),
        };
        let mut found = vec![Found::default(); points.len()];
        PointGrid::new(&points).locate(&cells, &mut found);
        let value = |f: &Found| match f.id {
            Found::NOWHERE => f32::NAN,
            id => {
                linear(&f.weights, &self.tets[id as usize].map(|v| f64::from(self.values[v as usize]))) as f32
            }
        };
        found.iter().map(value).collect()
    }
}

/// A cube of samples, interpolated linearly at uniform random points and meshed; the boundary has the samples of a Hammersley set.
pub(crate) fn uniform(side: usize, geometry: Geometry, samples: &[f32], count: u64) -> Result<Random> {
    let lattice = Lattice::new([side as u64; 3])?;
    let started = Instant::now();
    let positions = random_positions(&lattice, count)?;
    let mut mesher = Mesher::new();
    mesher.delaunay(&positions, &Order::for_count(positions.len() as u64))?;
    let mut tets = vec![];
    mesher.for_each_tet(|tet| tets.push(tet));
    let mesh_seconds = started.elapsed().as_secs_f64();
    let sampling = Instant::now();
    let block = VoxelBlock { voxels: IndexBox::whole(lattice.dims), values: samples };
    let mut values = vec![];
    sample(Interpolation::Linear, &lattice, &block, &positions, &mut values);
    let sample_seconds = sampling.elapsed().as_secs_f64();
    Ok(Random {
        field: TetField { lattice, geometry, positions, values, tets },
        mesh_seconds,
        sample_seconds,
    })
}

fn random_positions(lattice: &Lattice, count: u64) -> Result<Vec<LatticePos>> {
    let frame = PointSet::new(PointSpec::Hammersley { n: count, shift: 0.5 }, *lattice)?;
    let mut sites: Vec<Site> = vec![];
    frame.sites_in(&lattice.domain(), &mut sites);
    sites.retain(|s| s.id.class() != Some(PointClass::Interior));
    let mut positions: Vec<LatticePos> = sites.iter().map(|s| s.pos).collect();
    let max = lattice.max();
    let mut state = 0;
    for _ in 0..count {
        positions.push(max.map(|m| ((u128::from(next(&mut state)) * u128::from(m + 1)) >> 64) as u32));
    }
    Ok(positions)
}

/// SplitMix64 (Steele, Lea and Flood 2014).
fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan::geom::predicates::orient3d;
    use isospan::surface::check::check;

    fn sphere(side: usize) -> (Geometry, Vec<f32>) {
        let at = |i: usize| i as f32 / (side - 1) as f32 - 0.5;
        let f = |n: usize| {
            let [x, y, z] = [n % side, n / side % side, n / side / side].map(at);
            x * x + y * y + z * z - 0.16
        };
        let spacing = 1.0 / (side - 1) as f64;
        let geometry = Geometry { origin: [-0.5; 3], spacing: [spacing; 3], ..Geometry::default() };
        (geometry, (0..side.pow(3)).map(f).collect())
    }

    #[test]
    fn the_thesis_counts_its_cells() {
        let (geometry, samples) = sphere(50);
        let field = TetField::of_grid(50, geometry, &samples).unwrap();
        assert_eq!(field.tets.len(), 705_894);
        assert!(field.tets.iter().step_by(97).all(|t| {
            let [a, b, c, d] = t.map(|v| field.positions[v as usize]);
            orient3d(a, b, c, d) > 0
        }));
        let surface = field.surface(0.0).unwrap();
        let report = check(&surface);
        assert!(report.is_closed() && report.is_manifold() && report.is_oriented());
        let far = surface.vertices.iter().map(|v| {
            (v.position.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>().sqrt() - 0.4).abs()
        });
        assert!(far.fold(0.0, f64::max) < 1e-3);
    }

    #[test]
    fn random_points_fill_the_box() {
        let (geometry, samples) = sphere(20);
        let random = uniform(20, geometry, &samples, 2_000).unwrap();
        let back = random.field.at_samples(20);
        assert!(back.iter().all(|v| v.is_finite()), "every sample lies in a tetrahedron");
        let worst = back.iter().zip(&samples).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 0.06, "{worst}");
        assert!(check(&random.field.surface(0.0).unwrap()).is_closed());
    }
}
