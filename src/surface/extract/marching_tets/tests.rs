use super::super::cases::{CASES, EDGES, is_odd};
use super::super::cells::Sides;
use super::super::edges::{EdgeLookup, EdgeTable, NO_BUCKET};
use super::*;
use crate::surface::check::boundary_outside;
use crate::surface::testing::{Grid, assert_sound, mirrored, triangle_set};
use crate::surface::{TriMesh, Vertex};
use isospan_io::geom::{Lattice, LatticePos, PointId};
use isospan_io::grid::Geometry;
use isospan_mesh::mesh::tet::{self, Tet};
use proptest::prelude::*;

const PERMUTATIONS: [([usize; 4], bool); 24] = {
    let mut all = [([0; 4], false); 24];
    let (mut code, mut n) = (0, 0);
    while code < 256 {
        let p = [code / 64, code / 16 % 4, code / 4 % 4, code % 4];
        if p[0] != p[1] && p[0] != p[2] && p[0] != p[3] && p[1] != p[2] && p[1] != p[3] && p[2] != p[3] {
            all[n] = (p, is_odd([p[0] as u8, p[1] as u8, p[2] as u8, p[3] as u8]));
            n += 1;
        }
        code += 1;
    }
    all
};

/// One positively oriented tetrahedron, its corners listed in the order of `list`, ids by `ids`.
fn one_tet(values: [f32; 4], ids: [u64; 4], tet: Tet, geometry: &Geometry) -> TriMesh {
    let lattice = Lattice::new([5, 5, 5]).unwrap();
    let positions = [[0, 0, 0], [3, 0, 1], [1, 4, 0], [0, 1, 3]].map(|p| lattice.of_voxel(p));
    let ids = ids.map(PointId);
    let cells = CellSource {
        positions: &positions,
        values: &values,
        ids: &ids,
        shared: &[true; 4],
        numbers: None,
        tets: &[tet],
    };
    let mut out = ChunkSurface::default();
    extract(&cells, 0.0, &WorldMap::new(&lattice, geometry), &mut Workbench::default(), &mut out);
    TriMesh { vertices: out.vertices().to_vec(), triangles: out.triangles().to_vec(), ..TriMesh::default() }
}

fn facing(mesh: &TriMesh, t: [u32; 3]) -> [f64; 3] {
    let [a, b, c] = t.map(|v| mesh.vertices[v as usize].position.map(f64::from));
    let minus = |p: [f64; 3], q: [f64; 3]| std::array::from_fn(|k| p[k] - q[k]);
    glam::DVec3::from_array(minus(b, a)).cross(glam::DVec3::from_array(minus(c, a))).to_array()
}

#[test]
fn sixteen_cases_face_lower_values() {
    for geometry in [Geometry::default(), mirrored()] {
        for mask in 0..16usize {
            let values: [f32; 4] = std::array::from_fn(|i| {
                let size = 1.0 + i as f32 * 0.7;
                if mask >> i & 1 == 1 { size } else { -size }
            });
            let mesh = one_tet(values, [9, 4, 6, 2], [0, 1, 2, 3], &geometry);
            let count = [0, 1, 2, 1, 0][mask.count_ones() as usize];
            assert_eq!(mesh.triangles.len(), count, "{mask:04b}");
            for t in &mesh.triangles {
                // In one tetrahedron the triangles lie in a plane of constant f, so their normal is
                // the gradient's.
                let normal = along_gradient(values, &geometry);
                let facing = facing(&mesh, *t);
                let length = facing.iter().map(|x| x * x).sum::<f64>().sqrt();
                let cosine: f64 = (0..3).map(|k| facing[k] / length * f64::from(normal[k])).sum();
                assert!(cosine > 0.9999, "{mask:04b} {cosine}");
            }
        }
    }
}

/// The normal as the inverse of the matrix of edges gives it.
fn along_gradient(f: [f32; 4], geometry: &Geometry) -> [f32; 3] {
    let corner = [[0.0; 3], [3.0, 0.0, 1.0], [1.0, 4.0, 0.0], [0.0, 1.0, 3.0]];
    let world = corner.map(|p| glam::DVec3::from_array(geometry.to_world(p)));
    let edges = glam::DMat3::from_cols(world[1] - world[0], world[2] - world[0], world[3] - world[0]);
    let rise = glam::DVec3::new(f64::from(f[1] - f[0]), f64::from(f[2] - f[0]), f64::from(f[3] - f[0]));
    (-(edges.transpose().inverse() * rise)).normalize().as_vec3().to_array()
}

#[test]
fn the_order_of_corners_does_not_matter() {
    let even = PERMUTATIONS.iter().filter(|p| !p.1);
    assert_eq!(even.clone().count(), 12);
    for mask in 1..15usize {
        let values: [f32; 4] =
            std::array::from_fn(|i| if mask >> i & 1 == 1 { 0.3 + i as f32 } else { -1.1 });
        for (ids, _) in PERMUTATIONS {
            let ids = ids.map(|i| i as u64 * 10);
            let plain = one_tet(values, ids, [0, 1, 2, 3], &Geometry::default());
            for (order, _) in even.clone() {
                let other = one_tet(values, ids, order.map(|i| i as u32), &Geometry::default());
                assert_eq!(other, plain, "{mask:04b} {ids:?} {order:?}");
            }
        }
    }
}

#[test]
fn quadrilaterals_are_cut_at_their_smallest_edge() {
    for (mask, case) in CASES.iter().enumerate() {
        let crossed: Vec<[u8; 2]> =
            EDGES.into_iter().filter(|ends| ends.map(|c| mask >> c & 1).iter().sum::<usize>() == 1).collect();
        assert_eq!(usize::from(case.triangles), crossed.len().saturating_sub(2), "{mask:05b}");
        assert_eq!(case.edges[..crossed.len()], crossed[..], "{mask:05b}");
        for t in &case.corners[..usize::from(case.triangles)] {
            assert_eq!(t[0], 0, "{mask:05b}: the smallest edge begins every triangle");
            assert!(t.iter().all(|&e| usize::from(e) < crossed.len()));
        }
    }
}

#[test]
fn active_is_the_shared_rule() {
    let levels = [f32::NAN, f32::NEG_INFINITY, -1.0, 0.0, 1.0, f32::INFINITY];
    let values: Vec<[f32; 4]> = (0..1296)
        .map(|code: usize| std::array::from_fn(|i| levels[code / 6usize.pow(i as u32) % 6]))
        .collect();
    let flat: Vec<f32> = values.concat();
    let tets: Vec<Tet> = (0..1296u32).map(|i| [4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3]).collect();
    for isovalue in [-2.0, -1.0, 0.0, 0.5, 1.0, 2.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut active = vec![];
        Sides::default().select(&tets, &flat, isovalue, &mut active);
        let is_active = |v: [f32; 4]| tet::range(v).is_some_and(|(lo, hi)| tet::is_active(lo, hi, isovalue));
        let wanted: Vec<Tet> =
            tets.iter().zip(&values).filter(|(_, v)| is_active(**v)).map(|(t, _)| *t).collect();
        assert_eq!(active, wanted, "{isovalue}");
    }
}

fn ball(centre: [f64; 3], radius: f64) -> impl Fn([f64; 3]) -> f64 {
    move |p| radius * radius - (0..3).map(|k| (p[k] - centre[k]) * (p[k] - centre[k])).sum::<f64>()
}

/// The largest angle's cosine between vertex normals and the direction from (or to, sign -1) the
/// centre.
fn worst_cosine(mesh: &TriMesh, centre: [f64; 3], sign: f64) -> f64 {
    let cosine = |v: &Vertex| {
        let r: [f64; 3] = std::array::from_fn(|k| f64::from(v.position[k]) - centre[k]);
        let length = r.iter().map(|x| x * x).sum::<f64>().sqrt();
        (0..3).map(|k| sign * r[k] / length * f64::from(v.normal[k])).sum::<f64>()
    };
    mesh.vertices.iter().map(cosine).fold(1.0, f64::min)
}

#[test]
fn spheres_converge() {
    let mut errors = Vec::new();
    for n in [12u64, 24, 48] {
        let (centre, radius) = ([0.5 * n as f64 + 0.1; 3], 0.35 * n as f64);
        let grid = Grid::new([n + 1; 3]);
        let mesh = grid.surface(&grid.sample(ball(centre, radius)), 0.0, &Geometry::default());
        let report = assert_sound(&mesh);
        assert!(report.is_closed());
        assert_eq!((report.euler, report.components), (2, 1));
        assert!(worst_cosine(&mesh, centre, 1.0) > 1.0 - 2.0 / (n * n) as f64 * 4.0);
        let area = 4.0 * std::f64::consts::PI * radius * radius;
        let volume = area * radius / 3.0;
        errors.push([(report.area / area - 1.0).abs(), (report.volume.unwrap() / volume - 1.0).abs()]);
    }
    for pair in errors.windows(2) {
        assert!((0..2).all(|k| pair[1][k] < 0.35 * pair[0][k]), "{errors:?}");
    }
}

#[test]
fn a_field_that_grows_outwards_gives_a_cavity() {
    let grid = Grid::new([20; 3]);
    let inward = ball([9.3; 3], 6.0);
    let mesh = grid.surface(&grid.sample(|p| -inward(p)), 0.0, &Geometry::default());
    let report = assert_sound(&mesh);
    assert!(report.is_closed() && report.volume.unwrap() < -800.0, "{report:?}");
    assert!(worst_cosine(&mesh, [9.3; 3], -1.0) > 0.95);
}

#[test]
fn a_mirroring_map_keeps_the_outside_outside() {
    let grid = Grid::new([20; 3]);
    let values = grid.sample(ball([9.3; 3], 6.0));
    let plain = assert_sound(&grid.surface(&values, 0.0, &Geometry::default())).volume.unwrap();
    let mirrored = assert_sound(&grid.surface(&values, 0.0, &mirrored())).volume.unwrap();
    assert!((mirrored / plain - 1.25).abs() < 1e-5, "{plain} {mirrored}");
}

#[test]
fn linear_fields_have_exact_normals() {
    let grid = Grid::new([7, 6, 5]);
    let values = grid.sample(|p| 2.0 * p[0] - p[1] + 0.5 * p[2]);
    for geometry in [Geometry::default(), mirrored()] {
        let mesh = grid.surface(&values, 3.1, &geometry);
        let report = assert_sound(&mesh);
        assert_eq!(boundary_outside(&mesh, &geometry, [7, 6, 5], 1e-4), 0, "{report:?}");
        assert_eq!((report.components, report.boundary_loops, report.euler), (1, 1, 1));
        let g = glam::DVec3::from_array(geometry.gradient_to_world([2.0, -1.0, 0.5]));
        let wanted = (-g).normalize().as_vec3();
        for v in &mesh.vertices {
            assert!(wanted.distance(glam::Vec3::from_array(v.normal)) < 1e-6, "{v:?} {wanted}");
        }
    }
}

#[test]
fn a_plane_through_the_samples_is_a_plane() {
    let grid = Grid::new([6; 3]);
    for isovalue in [1.0, 3.0, 5.0] {
        let mesh = grid.surface(&grid.sample(|p| p[0]), isovalue, &Geometry::default());
        let report = assert_sound(&mesh);
        assert_eq!(boundary_outside(&mesh, &Geometry::default(), [6; 3], 1e-4), 0);
        assert!((report.area - 25.0).abs() < 0.1, "{report:?}");
        assert!(mesh.vertices.iter().all(|v| (v.position[0] - isovalue).abs() <= 1.0 / 1024.0));
    }
    let values = grid.sample(|p| p[0]);
    assert!(grid.surface(&values, 0.0, &Geometry::default()).triangles.is_empty(), "all inside");
}

#[test]
fn constant_fields_have_no_surface() {
    let grid = Grid::new([4; 3]);
    for isovalue in [1.0, 2.0, 3.0] {
        let mesh = grid.surface(&grid.sample(|_| 2.0), isovalue, &Geometry::default());
        assert_eq!(mesh, TriMesh::default());
    }
}

#[test]
fn a_torus_has_a_hole() {
    let grid = Grid::new([33, 31, 17]);
    let torus = |p: [f64; 3]| {
        let (x, y, z) = (p[0] - 16.1, p[1] - 15.2, p[2] - 8.3);
        let ring = (x * x + y * y).sqrt() - 9.0;
        16.0 - ring * ring - z * z
    };
    let report = assert_sound(&grid.surface(&grid.sample(torus), 0.0, &Geometry::default()));
    let volume = 2.0 * std::f64::consts::PI.powi(2) * 9.0 * 16.0;
    assert!(report.is_closed());
    assert_eq!((report.euler, report.components), (0, 1));
    assert!((report.volume.unwrap() / volume - 1.0).abs() < 0.03, "{report:?}");
}

fn gyroid(p: [f64; 3]) -> f64 {
    let [x, y, z] = p.map(|c| c * 0.41);
    x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
}

#[test]
fn a_gyroid_ends_at_the_box() {
    let grid = Grid::new([25, 20, 23]);
    for geometry in [Geometry::default(), mirrored()] {
        let mesh = grid.surface(&grid.sample(gyroid), 0.0, &geometry);
        let report = assert_sound(&mesh);
        assert!(report.boundary_edges > 100 && report.euler < 0, "{report:?}");
        assert_eq!(boundary_outside(&mesh, &geometry, [25, 20, 23], 1e-4), 0);
    }
}

#[test]
fn chunks_do_not_show() {
    let grid = Grid::new([14, 13, 12]);
    let values = grid.sample(gyroid);
    let whole = grid.surface(&values, 0.2, &mirrored());
    assert!(whole.triangles.len() > 1000);
    let scattered: Vec<usize> = (0..grid.tets.len()).map(|i| (i * i * 7 + i) % 11 % 5).collect();
    let slabs: Vec<usize> = (0..grid.tets.len()).map(|i| i * 4 / grid.tets.len()).collect();
    let each: Vec<usize> = (0..grid.tets.len()).map(|i| i / 100).collect();
    for chunk in [scattered, slabs, each] {
        let mesh = grid.surface_of_chunks(&values, 0.2, &mirrored(), &chunk);
        assert_sound(&mesh);
        assert_eq!(mesh.vertices.len(), whole.vertices.len());
        assert_eq!(triangle_set(&mesh), triangle_set(&whole));
    }
}

/// Adds a block whose corners have numbers of their own.
fn add_numbered_alone(block: &CellSource<'_>, world: &WorldMap, out: &mut ChunkSurface) {
    let mut numbers: Vec<u32> = block.tets.iter().flatten().copied().collect();
    numbers.sort_unstable_by_key(|v| std::cmp::Reverse(*v));
    numbers.dedup();
    let own = |v: u32| numbers.iter().position(|&n| n == v).unwrap() as u32;
    let tets: Vec<Tet> = block.tets.iter().map(|t| t.map(own)).collect();
    let positions: Vec<LatticePos> = numbers.iter().map(|&v| block.positions[v as usize]).collect();
    let values: Vec<f32> = numbers.iter().map(|&v| block.values[v as usize]).collect();
    let ids: Vec<PointId> = numbers.iter().map(|&v| block.ids[v as usize]).collect();
    let shared: Vec<bool> = numbers.iter().map(|&v| block.shared[v as usize]).collect();
    out.add(
        &CellSource {
            positions: &positions,
            values: &values,
            ids: &ids,
            shared: &shared,
            numbers: Some(&numbers),
            tets: &tets,
        },
        world,
        &mut Workbench::default(),
    );
}

#[test]
fn blocks_of_a_chunk_are_one_chunk() {
    let grid = Grid::new([9; 3]);
    let values = grid.sample(gyroid);
    let shared = vec![false; values.len()];
    let source = |tets| CellSource {
        positions: &grid.positions,
        values: &values,
        ids: &grid.ids,
        shared: &shared,
        numbers: None,
        tets,
    };
    let world = WorldMap::new(&grid.lattice, &Geometry::default());
    let (mut once, mut blocks) = (ChunkSurface::default(), ChunkSurface::default());
    let mut bench = Workbench::default();
    extract(&source(&grid.tets), 0.0, &world, &mut bench, &mut once);
    for _ in 0..2 {
        blocks.start(0.0, values.len());
        grid.tets.chunks(97).for_each(|tets| blocks.add(&source(tets), &world, &mut bench));
        blocks.finish(&world);
        assert_eq!((blocks.vertices(), blocks.triangles()), (once.vertices(), once.triangles()));
        blocks.start(0.0, values.len());
        for tets in grid.tets.chunks(97) {
            add_numbered_alone(&source(tets), &world, &mut blocks);
        }
        blocks.finish(&world);
        assert_eq!((blocks.vertices(), blocks.triangles()), (once.vertices(), once.triangles()));
        assert_eq!(blocks.active_cells(), once.active_cells());
        assert!(blocks.shared_edges().is_empty() && blocks.bytes() > 0);
    }
}

#[test]
fn no_surface_across_a_hole_in_the_data() {
    let grid = Grid::new([16; 3]);
    let hole = |p: [f64; 3]| p[0] >= 7.0 && p[1] >= 7.0 && p[2] >= 7.0;
    let field = ball([7.4; 3], 5.2);
    let mesh =
        grid.surface(&grid.sample(|p| if hole(p) { f64::NAN } else { field(p) }), 0.0, &Geometry::default());
    let report = assert_sound(&mesh);
    assert!(report.boundary_edges > 10);
    assert_eq!(boundary_outside(&mesh, &Geometry::default(), [16; 3], 1e-4), report.boundary_edges);
    assert!(mesh.vertices.iter().all(|v| !hole(v.position.map(f64::from))));
    let mut around = Grid::new([16; 3]);
    let is_hole = |c: u32| hole(grid.lattice.to_index_space(grid.positions[c as usize]));
    around.tets.retain(|t| !t.iter().any(|&c| is_hole(c)));
    assert_eq!(mesh, around.surface(&around.sample(&field), 0.0, &Geometry::default()));
    let nothing = grid.surface(&grid.sample(|_| f64::NAN), 0.0, &Geometry::default());
    assert!(nothing.triangles.is_empty());
}

#[test]
fn extreme_values_leave_unit_normals() {
    let grid = Grid::new([8; 3]);
    let far = |p: [f64; 3]| if p[0] + p[1] > 9.0 { f64::INFINITY } else { -p[2] - 1.0 };
    assert_sound(&grid.surface(&grid.sample(far), 0.0, &Geometry::default()));
    let both = |p: [f64; 3]| if p[0] > 3.5 { f64::INFINITY } else { f64::NEG_INFINITY };
    let mesh = grid.surface(&grid.sample(both), 0.0, &Geometry::default());
    assert_sound(&mesh);
    let huge = |p: [f64; 3]| if p[2] > 3.5 { f64::from(f32::MAX) } else { f64::from(-f32::MAX) };
    let mesh = grid.surface(&grid.sample(huge), 1e30, &Geometry::default());
    assert_sound(&mesh);
    let tiny = |p: [f64; 3]| (p[2] - 3.5) * f64::from(f32::MIN_POSITIVE) * 1e-3;
    let mesh = grid.surface(&grid.sample(tiny), 0.0, &Geometry::default());
    assert_sound(&mesh);
    assert!(mesh.vertices.iter().all(|v| v.normal[2] < -0.99), "straight down");
}

#[test]
fn a_far_outlier_does_not_spoil_normals() {
    let grid = Grid::new([10; 3]);
    let values = grid.sample(|p| if p == [9.0; 3] { 1e30 } else { p[0] + p[1] * 2.0 });
    let mesh = grid.surface(&values, 4.3, &Geometry::default());
    let wanted = glam::Vec3::new(-1.0, -2.0, 0.0).normalize();
    let good =
        mesh.vertices.iter().filter(|v| wanted.distance(glam::Vec3::from_array(v.normal)) < 1e-5).count();
    assert!(good > 100 && good + 30 > mesh.vertices.len(), "{good} of {}", mesh.vertices.len());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Values equal to the isovalue everywhere, corners off the grid, any chunks: a manifold up to
    /// the box, and the chunks do not show.
    #[test]
    fn random_levels_give_a_manifold(
        levels in prop::collection::vec(0u8..3, 125),
        shifts in prop::collection::vec(prop::array::uniform3(-100i64..100), 125),
        chunk in prop::collection::vec(0usize..4, 384),
    ) {
        let mut grid = Grid::new([5; 3]);
        let steps = 1i64 << grid.lattice.log2_steps[0];
        let max = grid.lattice.max();
        for (p, shift) in grid.positions.iter_mut().zip(&shifts) {
            if (0..3).all(|k| p[k] > 0 && p[k] < max[k]) {
                // At most a tenth of a voxel: Kuhn's tetrahedra keep their orientation.
                *p = std::array::from_fn(|k| (i64::from(p[k]) + shift[k] * steps / 1000) as u32);
            }
        }
        let values: Vec<f32> = levels.iter().map(|&l| f32::from(l)).collect();
        let whole = grid.surface(&values, 1.0, &Geometry::default());
        assert_sound(&whole);
        prop_assert_eq!(boundary_outside(&whole, &Geometry::default(), [5; 3], 1e-4), 0);
        let cut = grid.surface_of_chunks(&values, 1.0, &Geometry::default(), &chunk);
        prop_assert_eq!(triangle_set(&cut), triangle_set(&whole));
    }

    /// The report of a surface and of the same with all values negated about the isovalue differ in
    /// orientation only, unless a value is the isovalue.
    #[test]
    fn negation_turns_the_surface_over(values in prop::collection::vec(prop_oneof![-9i8..0, 1i8..9], 64)) {
        let grid = Grid::new([4; 3]);
        let up: Vec<f32> = values.iter().map(|&v| f32::from(v)).collect();
        let down: Vec<f32> = values.iter().map(|&v| -f32::from(v)).collect();
        let (up, down) = (grid.surface(&up, 0.0, &Geometry::default()), grid.surface(&down, 0.0, &Geometry::default()));
        let sorted = |m: &TriMesh| {
            let mut triangles = m.triangles.clone();
            triangles.sort_unstable();
            triangles
        };
        let mut turned = down.clone();
        turned.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        turned.vertices.iter_mut().for_each(|v| v.normal = v.normal.map(|x| -x));
        let positions = |m: &TriMesh| -> Vec<[f32; 3]> { m.vertices.iter().map(|v| v.position).collect() };
        prop_assert_eq!(positions(&turned), positions(&up));
        prop_assert_eq!(sorted(&turned), sorted(&up));
        for (a, b) in turned.vertices.iter().zip(&up.vertices) {
            prop_assert!((0..3).all(|k| a.normal[k] == b.normal[k]), "{:?} {:?}", a, b);
        }
    }
}

#[test]
fn corners_of_any_degree_find_their_edges() {
    let mut table = EdgeTable::default();
    for _ in 0..3 {
        table.clear(2000);
        assert!(table.heads.iter().all(|&head| head == NO_BUCKET) && table.buckets.len() == 1);
        let edges: Vec<[u32; 2]> = (1..1000).flat_map(|b| [[0, b], [b, b + 1], [7, b + 500]]).collect();
        let mut known = std::collections::BTreeMap::new();
        for round in 0..3 {
            for &edge in &edges {
                let next = known.len() as u32;
                let wanted = *known.entry(edge).or_insert(next);
                let found = match table.find_or_add(edge) {
                    EdgeLookup::Known(number) => number,
                    EdgeLookup::New(number) => {
                        assert_eq!(number, next);
                        number
                    }
                };
                assert_eq!(found, wanted, "{edge:?} round {round}");
            }
        }
        assert_eq!(table.lows.len(), known.len());
        assert!(table.overflow.len() > 1800);
    }
}
