//! Tetrahedra with values that are no archive: the original data, and uniform random points.
//!
//! A structured set is cut into tetrahedra as the thesis does it, each cube into six around its
//! diagonal (Kuhn 1960): (50 - 1)³ · 6 = 705 894. Uniform random points are no point set of
//! isospan's, as no box could list its own; here they are few, and the stages are called one by
//! one: points, mesh, values, surface.

use crate::data::tets::{FACES, TetMesh, cross, dot, minus, volume6};
use isospan::Result;
use isospan::geom::curve::Order;
use isospan::geom::{Lattice, LatticePos, PointClass, PointId, Site};
use isospan::grid::{Geometry, IndexBox};
use isospan::locate::{CellBatch, CellHit, FinePos, PointGrid, fine, linear};
use isospan::mesh::mesher::Mesher;
use isospan::mesh::tet::Tet;
use isospan::points::{PointSet, PointSpec};
use isospan::sample::{Interpolation, VoxelBlock, sample};
use isospan::surface::extract::{CellSource, ChunkSurface, Workbench, extract};
use isospan::surface::weld::{BuilderSettings, SurfaceBuilder};
use isospan::surface::{TriMesh, WorldMap};

/// A field, linear in each tetrahedron.
pub(crate) struct TetField {
    lattice: Lattice,
    geometry: Geometry,
    positions: Vec<LatticePos>,
    values: Vec<f32>,
    /// Corners, as numbers of positions.
    pub(crate) tets: Vec<Tet>,
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
        let steps = f64::from(1u32 << lattice.log2_steps[0]);
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
        let (mut bench, mut chunk) = (Workbench::default(), ChunkSurface::default());
        extract(&cells, isovalue, &world, &mut bench, &mut chunk);
        let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
        builder.push(&chunk)?;
        TriMesh::from_source(&builder.finish()?)
    }

    /// The field at the vertices of another one on the same lattice; NaN where there is no
    /// tetrahedron.
    pub(crate) fn at(&self, other: &Self) -> Vec<f32> {
        let points: Vec<FinePos> = other.positions.iter().map(|&p| fine(p)).collect();
        self.located(&points).iter().map(|f| self.value(f)).collect()
    }

    fn located(&self, points: &[FinePos]) -> Vec<CellHit> {
        let cells = CellBatch {
            positions: self.positions.iter().map(|&p| fine(p)).collect(),
            corners: self.tets.clone(),
            ids: (0..self.tets.len() as u64).collect(),
        };
        let mut found = vec![CellHit::default(); points.len()];
        PointGrid::new(points).locate(&cells, &mut found);
        found
    }

    fn value(&self, at: &CellHit) -> f32 {
        match at.id {
            CellHit::NOWHERE => f32::NAN,
            id => linear(&at.weights, &self.tets[id as usize].map(|v| f64::from(self.values[v as usize])))
                as f32,
        }
    }

    /// Values and corners of the tetrahedra, those that are close one after another.
    pub(crate) fn along_a_curve(&self) -> (&[f32], Vec<Tet>) {
        let order = Order::for_count(self.positions.len() as u64);
        let mut tets = self.tets.clone();
        tets.sort_by_cached_key(|t| order.key(self.positions[t[0] as usize]));
        (&self.values, tets)
    }

    /// The volume of all tetrahedra, in cubes of lattice steps.
    fn volume(&self) -> f64 {
        let corners = |t: &Tet| t.map(|v| self.positions[v as usize].map(f64::from));
        self.tets.iter().map(|t| volume6(corners(t)) / 6.0).sum()
    }

    /// The triangles of one tetrahedron only.
    fn boundary(&self) -> Vec<[u32; 3]> {
        let face = |t: &Tet, f: [usize; 3]| {
            let corners = f.map(|i| t[i]);
            let mut sorted = corners;
            sorted.sort_unstable();
            (sorted, corners)
        };
        let mut faces: Vec<_> = self.tets.iter().flat_map(|t| FACES.map(|f| face(t, f))).collect();
        faces.sort_unstable();
        faces.chunk_by(|a, b| a.0 == b.0).filter(|same| same.len() == 1).map(|same| same[0].1).collect()
    }
}

/// A cube of samples, interpolated linearly at uniform random points and meshed; the boundary has
/// the samples of a Hammersley set.
pub(crate) fn uniform(side: usize, geometry: Geometry, samples: &[f32], count: u64) -> Result<TetField> {
    let lattice = Lattice::new([side as u64; 3])?;
    let frame = PointSet::new(PointSpec::Hammersley { n: count, shift: 0.5 }, lattice)?;
    let mut sites: Vec<Site> = vec![];
    frame.sites_in(&lattice.domain(), &mut sites);
    sites.retain(|s| s.id.class() != Some(PointClass::Interior));
    let mut positions: Vec<LatticePos> = sites.iter().map(|s| s.pos).collect();
    let mut random = Random::default();
    positions.extend((0..count).map(|_| random.position(&lattice)));
    let block = VoxelBlock { voxels: IndexBox::whole(lattice.dims), values: samples };
    let mut values = vec![];
    sample(Interpolation::Linear, &lattice, &block, &positions, &mut values);
    let tets = delaunay(&positions)?;
    Ok(TetField { lattice, geometry, positions, values, tets })
}

/// Random samples of the boundary of a mesh by square of the mean distance of the points inside: as
/// many as isospan's.
const BOUNDARY_DENSITY: f64 = 2.0;

/// A mesh, interpolated linearly at uniform random points in it and at uniform random points of its
/// boundary; of their tetrahedra those are kept whose centroid is in the mesh.
pub(crate) fn uniform_in(mesh: &TetField, count: u64) -> Result<TetField> {
    let mut random = Random::default();
    let (mut positions, mut values) = mesh.on_boundary(count, &mut random);
    let wanted = positions.len() + count as usize;
    while positions.len() < wanted {
        let tried: Vec<LatticePos> = (0..count.max(1000)).map(|_| random.position(&mesh.lattice)).collect();
        let found = mesh.located(&tried.iter().map(|&p| fine(p)).collect::<Vec<_>>());
        let inside = tried.into_iter().zip(&found).filter(|(_, f)| f.id != CellHit::NOWHERE);
        for (position, found) in inside.take(wanted - positions.len()) {
            positions.push(position);
            values.push(mesh.value(found));
        }
    }
    let all = delaunay(&positions)?;
    let centroid = |t: &Tet| -> FinePos {
        let corners = t.map(|v| fine(positions[v as usize]));
        std::array::from_fn(|k| corners.iter().map(|c| c[k]).sum::<i64>() / 4)
    };
    let found = mesh.located(&all.iter().map(centroid).collect::<Vec<_>>());
    let inside = all.iter().zip(&found).filter(|(_, f)| f.id != CellHit::NOWHERE);
    let tets = inside.map(|(t, _)| *t).collect();
    Ok(TetField { lattice: mesh.lattice, geometry: mesh.geometry, positions, values, tets })
}

impl TetField {
    /// Of n random points inside, so many times n^(2/3) lie on the boundary besides.
    pub(crate) fn boundary_factor(&self) -> f64 {
        let area: f64 = self.boundary().iter().map(|f| self.area(f)).sum();
        let volume = self.volume();
        BOUNDARY_DENSITY * area / libm::cbrt(volume * volume)
    }

    fn area(&self, face: &[u32; 3]) -> f64 {
        let [a, b, c] = face.map(|v| self.positions[v as usize].map(f64::from));
        let n = cross(minus(b, a), minus(c, a));
        dot(n, n).sqrt() / 2.0
    }

    /// Random points of the boundary, with their values, for so many points inside.
    fn on_boundary(&self, inside: u64, random: &mut Random) -> (Vec<LatticePos>, Vec<f32>) {
        let faces = self.boundary();
        let corners = |f: &[u32; 3]| f.map(|v| self.positions[v as usize].map(f64::from));
        let mut sums = vec![0.0];
        faces.iter().for_each(|f| sums.push(sums[sums.len() - 1] + self.area(f)));
        let total = sums[faces.len()];
        let n = inside as f64;
        let count = (self.boundary_factor() * libm::cbrt(n * n)).round() as usize;
        let mut out = (vec![], vec![]);
        for _ in 0..count {
            let at = random.unit() * total;
            let face = faces[sums.partition_point(|&s| s <= at).clamp(1, faces.len()) - 1];
            let (u, v) = (random.unit().sqrt(), random.unit());
            let weights = [1.0 - u, u * (1.0 - v), u * v];
            let [a, b, c] = corners(&face);
            let place = |k: usize| weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k];
            out.0.push(std::array::from_fn(|k| place(k).round() as u32));
            let values = face.map(|v| f64::from(self.values[v as usize]));
            out.1.push((0..3).map(|i| weights[i] * values[i]).sum::<f64>() as f32);
        }
        out
    }
}

fn delaunay(positions: &[LatticePos]) -> Result<Vec<Tet>> {
    let mut mesher = Mesher::new();
    mesher.delaunay(positions, &Order::for_count(positions.len() as u64))?;
    let mut tets = vec![];
    mesher.for_each_tet(|tet| tets.push(tet));
    Ok(tets)
}

/// SplitMix64 (Steele, Lea and Flood 2014).
#[derive(Default)]
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// From 0 to below 1.
    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A position of the domain.
    fn position(&mut self, lattice: &Lattice) -> LatticePos {
        lattice.max().map(|m| ((u128::from(self.next()) * u128::from(m + 1)) >> 64) as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan::surface::check::check;
    use isospan_mesh::predicates::orient3d;

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
        let back = random.at(&TetField::of_grid(20, geometry, &samples).unwrap());
        assert!(back.iter().all(|v| v.is_finite()), "every sample lies in a tetrahedron");
        let worst = back.iter().zip(&samples).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 0.06, "{worst}");
        assert!(check(&random.surface(0.0).unwrap()).is_closed());
    }

    #[test]
    fn random_points_fill_a_mesh() {
        let (geometry, samples) = sphere(12);
        let mesh = TetField::of_grid(12, geometry, &samples).unwrap();
        let random = uniform_in(&mesh, 3_000).unwrap();
        // Two samples by square of the spacing on six faces.
        let boundary = 2.0 * 6.0 * libm::cbrt(3_000f64 * 3_000.0);
        assert!((random.point_count() as f64 - 3_000.0 - boundary).abs() < 2.0);
        let share = random.volume() / mesh.volume();
        assert!((0.97..1.0001).contains(&share), "{share}");
        let back = random.at(&mesh);
        let outside = back.iter().filter(|v| v.is_nan()).count();
        assert!(outside < samples.len() / 3, "{outside}: the mesh's own boundary alone");
        let pairs = back.iter().zip(&samples).filter(|(b, _)| !b.is_nan());
        let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 0.1, "{worst}");
        assert!(check(&random.surface(0.0).unwrap()).is_closed());
    }
}
