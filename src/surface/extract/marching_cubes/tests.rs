use super::cases::{CASES, share_face};
use super::*;
use crate::surface::check::{SurfaceCheckReport, check};
use crate::surface::testing::{assert_sound, mirrored, triangle_set};
use crate::surface::weld::{BuilderSettings, SurfaceBuilder};
use crate::surface::{TriMesh, Vertex};
use isospan_io::grid::Geometry;

/// A grid with all its values.
struct Field {
    grid: [u64; 3],
    stride: [u64; 3],
    values: Vec<f32>,
}

/// Blocks of at most so many cells along each axis, and how many nodes more their windows have.
#[derive(Clone, Copy)]
struct Cut {
    cells: [u64; 3],
    more: u64,
}

const WHOLE: Cut = Cut { cells: [u64::MAX; 3], more: 0 };

impl Field {
    fn new(grid: [u64; 3], f: impl Fn([f64; 3]) -> f64) -> Self {
        let [nx, ny, nz] = grid;
        let nodes = (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])));
        let values = nodes.map(|node| f(node.map(|x| x as f64)) as f32).collect();
        Self { grid, stride: [1; 3], values }
    }

    /// Values of a sequence without pattern: `of` makes them from 32 bits.
    fn random(grid: [u64; 3], mut seed: u64, of: impl Fn(u32) -> f32) -> Self {
        let mut field = Self::new(grid, |_| 0.0);
        for value in &mut field.values {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *value = of((seed >> 32) as u32);
        }
        field
    }

    fn surface(&self, isovalue: f32, caps: bool, geometry: &Geometry, cut: Cut) -> TriMesh {
        let world = WorldMap::of_samples(geometry);
        let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
        let (mut bench, mut out) = (CubeBench::default(), ChunkSurface::default());
        self.each_block(cut, &mut |block| {
            marching_cubes(block, isovalue, caps, &world, &mut bench, &mut out);
            builder.push(&out).unwrap();
        });
        TriMesh::from_source(&builder.finish().unwrap()).unwrap()
    }

    fn each_block(&self, cut: Cut, each: &mut dyn FnMut(&GridBlock<'_>)) {
        let starts = |k: usize| (0..self.grid[k].max(2) - 1).step_by(cut.cells[k].min(1 << 40) as usize);
        for z in starts(2) {
            for y in starts(1) {
                for x in starts(0) {
                    let lo = [x, y, z];
                    let last = self.grid.map(|n| n - 1);
                    let cells: [[u64; 2]; 3] = std::array::from_fn(|k| {
                        [lo[k].min(last[k]), lo[k].saturating_add(cut.cells[k]).min(last[k])]
                    });
                    self.window(cells, cut.more, each);
                }
            }
        }
    }

    /// Gives a block with the nodes that it must have, and `more`.
    fn window(&self, cells: [[u64; 2]; 3], more: u64, each: &mut dyn FnMut(&GridBlock<'_>)) {
        let start = cells.map(|[lo, _]| lo.saturating_sub(1 + more));
        let end: [u64; 3] = std::array::from_fn(|k| (cells[k][1] + 2 + more).min(self.grid[k]));
        let mut values = vec![];
        for z in start[2]..end[2] {
            for y in start[1]..end[1] {
                let row = (z * self.grid[1] + y) * self.grid[0];
                values.extend_from_slice(&self.values[(row + start[0]) as usize..(row + end[0]) as usize]);
            }
        }
        let size = std::array::from_fn(|k| (end[k] - start[k]) as usize);
        each(&GridBlock { grid: self.grid, stride: self.stride, start, size, values: &values, cells });
    }

    fn whole(&self, isovalue: f32, caps: bool) -> TriMesh {
        self.surface(isovalue, caps, &Geometry::default(), WHOLE)
    }
}

fn closed(mesh: &TriMesh) -> SurfaceCheckReport {
    let report = assert_sound(mesh);
    assert_eq!(report.boundary_edges, 0, "{report:?}");
    report
}

/// A map with axes that are not at right angles.
fn sheared() -> Geometry {
    Geometry {
        origin: [-3.0, 0.5, 11.0],
        spacing: [0.75, 1.5, 3.0],
        direction: [[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.28, 0.96]],
    }
}

/// Triangles of `vtkFlyingEdges3D` of VTK 9.7 in a cube, by the mask of corners inside.
const OF_FLYING_EDGES: &str = "\
    0112122312232332122323342334344312232334233434432332344334434552\
    1223233423343443233432433445435223343445344545543443435245545421\
    1223233423343443233434453445455423343445342345323443455445325241\
    2334344534452332344543544552324134454552453434212332324134212110";

#[test]
fn a_cube_has_the_triangles_of_flying_edges() {
    let counts: String = CASES.iter().map(|case| char::from(b'0' + case.triangles)).collect();
    assert_eq!(counts, OF_FLYING_EDGES);
    assert_eq!(CASES.iter().map(|case| u32::from(case.triangles)).sum::<u32>(), 820);
}

#[test]
fn what_two_edges_of_a_face_join_is_a_segment_and_no_cut() {
    for (mask, case) in CASES.iter().enumerate() {
        let triangles = &case.corners[..usize::from(case.triangles)];
        let sides: Vec<[u8; 2]> = triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
        let cuts = sides.iter().filter(|&&[a, b]| sides.contains(&[b, a]));
        for &[a, b] in cuts {
            assert!(!share_face(a, b), "{mask:08b}: {a} {b}");
        }
        // Each crossed edge is in a triangle, and there is no other.
        let inside = |corner: u8| mask >> corner & 1;
        for edge in 0..12 {
            let low = lower_corner(edge);
            let is_crossed = inside(low) != inside(low + (1 << (edge / 4)));
            assert_eq!(triangles.iter().any(|t| t.contains(&edge)), is_crossed, "{mask:08b}: {edge}");
            assert_eq!(case.edges[..usize::from(case.count)].contains(&edge), is_crossed);
        }
    }
}

#[test]
fn any_two_cells_that_share_a_face_are_closed() {
    for axis in 0..3 {
        let mut grid = [2; 3];
        grid[axis] = 3;
        for mask in 0..1u32 << 12 {
            let values = (0..12).map(|i| if mask >> i & 1 == 1 { 1.0 + i as f32 } else { -1.5 }).collect();
            let report = closed(&Field { grid, stride: [1; 3], values }.whole(0.0, true));
            assert_eq!(report.volume.is_none_or(|v| v <= 0.0), mask == 0, "{axis} {mask:012b}: {report:?}");
        }
    }
}

#[test]
fn values_equal_to_the_isovalue_leave_it_closed() {
    for seed in 0..20 {
        let field = Field::random([9, 6, 7], seed, |bits| (bits >> 30) as f32);
        for isovalue in [0.0, 1.0, 2.0, 3.0, 4.0] {
            closed(&field.whole(isovalue, true));
        }
    }
}

fn ball([x, y, z]: [f64; 3]) -> f64 {
    12.0 - ((x - 15.2).powi(2) + (y - 14.9).powi(2) + (z - 15.6).powi(2)).sqrt()
}

#[test]
fn a_ball_is_a_ball() {
    let mesh = Field::new([32; 3], ball).whole(0.0, false);
    let report = closed(&mesh);
    assert_eq!((report.euler, report.components), (2, 1));
    let radius = 12.0f64;
    let [area, volume] = [4.0 * radius.powi(2), 4.0 / 3.0 * radius.powi(3)].map(|x| x * std::f64::consts::PI);
    assert!((report.area / area - 1.0).abs() < 5e-3, "{report:?}");
    assert!((report.volume.unwrap() / volume - 1.0).abs() < 5e-3, "{report:?}");
    for v in &mesh.vertices {
        let out = glam::Vec3::from_array(v.position) - glam::Vec3::new(15.2, 14.9, 15.6);
        assert!(out.normalize().dot(glam::Vec3::from_array(v.normal)) > 0.999, "{v:?}");
    }
}

#[test]
fn the_normals_of_a_linear_field_are_exact() {
    let g = [0.7, -0.4, 0.9];
    for geometry in [Geometry::default(), mirrored(), sheared()] {
        for stride in [[1; 3], [2, 1, 4]] {
            let of_index = |p: [f64; 3]| (0..3).map(|k| g[k] * p[k] * stride[k] as f64).sum::<f64>();
            let field = Field { stride, ..Field::new([9, 8, 7], of_index) };
            let mesh = field.surface(2.3, false, &geometry, WHOLE);
            let wanted = glam::DVec3::from_array(geometry.gradient_to_world(g)).normalize();
            assert!(mesh.vertices.len() > 20);
            for v in &mesh.vertices {
                let normal = glam::DVec3::from_array(v.normal.map(f64::from));
                assert!((normal + wanted).length() < 1e-5, "{v:?} {wanted}");
                let index = geometry.to_index(v.position.map(f64::from));
                let value: f64 = (0..3).map(|k| g[k] * index[k]).sum();
                // Where the vertex would be less than 1/1024 from a node, it is off by so much.
                assert!((value - 2.3).abs() < 4e-3, "{v:?} {value}");
            }
            for t in &mesh.triangles {
                let [a, b, c] =
                    t.map(|v| glam::Vec3::from_array(mesh.vertices[v as usize].position).as_dvec3());
                assert!((b - a).cross(c - a).dot(wanted) < 0.0, "a triangle faces lower values");
            }
        }
    }
}

#[test]
fn a_cut_into_blocks_does_not_show() {
    let cuts = [[1, 1, 1], [3, 2, 4], [5, 70, 1], [70, 3, 5], [64, 64, 64], [2, 2, 70]];
    let random = |bits: u32| match bits % 40 {
        0 => f32::NAN,
        1 => 1.0,
        _ => (bits >> 8) as f32 / (1 << 23) as f32,
    };
    let grids = [[9, 10, 8], [67, 5, 4], [2, 2, 9], [3, 130, 2]];
    for (n, grid) in grids.into_iter().enumerate() {
        for (stride, geometry) in
            [([1, 1, 1], Geometry::default()), ([2, 1, 4], mirrored()), ([4, 4, 2], sheared())]
        {
            let field = Field { stride, ..Field::random(grid, n as u64, random) };
            for caps in [false, true] {
                let whole = field.surface(1.0, caps, &geometry, WHOLE);
                let report = check(&whole);
                assert!(report.triangles > 0 && report.is_oriented(), "{report:?}");
                assert_eq!((report.zero_area_triangles, report.unreferenced_vertices), (0, 0));
                for (more, cells) in cuts.into_iter().enumerate() {
                    let cut = field.surface(1.0, caps, &geometry, Cut { cells, more: more as u64 % 3 });
                    assert_eq!(cut.vertices.len(), whole.vertices.len(), "{grid:?} {cells:?} {caps}");
                    assert!(triangle_set(&cut) == triangle_set(&whole), "{grid:?} {cells:?} {caps}");
                }
            }
        }
    }
}

#[test]
fn buffers_that_were_used_before_do_not_show() {
    let world = WorldMap::of_samples(&Geometry::default());
    let mut bench = CubeBench::default();
    let mut used = ChunkSurface::default();
    for grid in [[20, 9, 8], [5, 6, 7], [9, 20, 8]] {
        let field = Field::random(grid, 3, |bits| (bits >> 16) as f32);
        for isovalue in [2e4f32, 5e4] {
            field.each_block(WHOLE, &mut |block| {
                marching_cubes(block, isovalue, true, &world, &mut bench, &mut used);
                let mut fresh = ChunkSurface::default();
                marching_cubes(block, isovalue, true, &world, &mut CubeBench::default(), &mut fresh);
                assert_eq!((used.vertices(), used.triangles()), (fresh.vertices(), fresh.triangles()));
                assert_eq!(used.active_cells(), fresh.active_cells());
            });
        }
    }
}

#[test]
fn several_blocks_may_be_one_chunk() {
    let field = Field::random([11, 9, 10], 8, |bits| (bits >> 16) as f32);
    let world = WorldMap::of_samples(&Geometry::default());
    let (mut bench, mut out) = (CubeBench::default(), ChunkSurface::default());
    out.start(3e4, 0);
    field.each_block(Cut { cells: [4, 3, 5], more: 0 }, &mut |block| {
        out.add_cubes(block, true, &world, &mut bench);
    });
    out.finish(&world);
    let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
    builder.push(&out).unwrap();
    let mesh = TriMesh::from_source(&builder.finish().unwrap()).unwrap();
    closed(&mesh);
    assert!(triangle_set(&mesh) == triangle_set(&field.whole(3e4, true)));
}

#[test]
fn crossed_cells_are_counted() {
    let field =
        Field::random([70, 6, 5], 5, |bits| if bits % 50 == 0 { f32::NAN } else { (bits >> 31) as f32 });
    let mut wanted = 0;
    for z in 0..4 {
        for y in 0..5 {
            for x in 0..69 {
                let nodes: [f32; 8] = std::array::from_fn(|c| {
                    field.values[x + (c & 1) + 70 * (y + (c >> 1 & 1) + 6 * (z + (c >> 2)))]
                });
                let crossed = nodes.iter().any(|&v| v >= 1.0) && nodes.iter().any(|&v| v < 1.0);
                wanted += u64::from(crossed && !nodes.iter().any(|v| v.is_nan()));
            }
        }
    }
    let world = WorldMap::of_samples(&Geometry::default());
    let mut out = ChunkSurface::default();
    field.each_block(WHOLE, &mut |block| {
        marching_cubes(block, 1.0, false, &world, &mut CubeBench::default(), &mut out);
    });
    assert_eq!(out.active_cells(), wanted);
}

#[test]
fn the_whole_grid_is_its_six_faces() {
    let field = Field::new([4, 5, 6], |_| 1.0);
    let mesh = field.whole(0.5, true);
    let report = closed(&mesh);
    assert_eq!((report.euler, report.components), (2, 1));
    assert_eq!((report.volume, report.area), (Some(60.0), 2.0 * (12.0 + 15.0 + 20.0)));
    for v in &mesh.vertices {
        for (k, (x, n)) in v.position.into_iter().zip(v.normal).enumerate() {
            let last = [3.0, 4.0, 5.0][k];
            let is_right = if x == 0.0 {
                n < 0.0
            } else if x == last {
                n > 0.0
            } else {
                n == 0.0
            };
            assert!(is_right, "{v:?}");
        }
    }
    assert_eq!(field.whole(1.5, true), TriMesh::default());
}

#[test]
fn the_rim_faces_out_of_the_grid() {
    let mesh = Field::new([6, 6, 6], |[x, y, _]| 2.3 - x + 0.2 * y).whole(0.0, true);
    closed(&mesh);
    let rim = |v: &&Vertex| {
        v.position[2] == 5.0 && v.position[1] > 0.0 && v.position[1] < 5.0 && v.position[0] > 0.0
    };
    assert!(mesh.vertices.iter().filter(rim).count() > 10);
    assert!(mesh.vertices.iter().filter(rim).all(|v| v.normal == [0.0, 0.0, 1.0]));
}

#[test]
fn no_surface_and_no_cap_is_made_up_around_missing_samples() {
    let mut field = Field::new([6, 6, 6], |_| 1.0);
    field.values[0] = f32::NAN;
    let report = check(&field.whole(0.0, true));
    // The caps lack the three squares at a corner.
    assert_eq!((report.boundary_edges, report.triangles), (6, 2 * (6 * 25 - 3)), "{report:?}");
    assert!(report.is_oriented() && report.is_manifold(), "{report:?}");
    field.values.fill(f32::NAN);
    assert_eq!(field.whole(0.0, true), TriMesh::default());
}

#[test]
fn a_difference_without_data_is_one_sided() {
    // Of a linear field one-sided differences are exact, too.
    let mut field = Field::new([8, 8, 8], |[x, y, z]| x + 2.0 * y - z - 5.3);
    for i in (0..field.values.len()).step_by(37) {
        field.values[i] = f32::NAN;
    }
    let mesh = field.whole(0.0, false);
    let wanted = glam::Vec3::new(-1.0, -2.0, 1.0).normalize();
    assert!(mesh.vertices.len() > 30);
    assert!(mesh.vertices.iter().all(|v| (glam::Vec3::from_array(v.normal) - wanted).length() < 1e-6));
}

#[test]
fn infinite_and_large_values_have_vertices() {
    let of = |bits: u32| match bits % 5 {
        0 => f32::INFINITY,
        1 => f32::NEG_INFINITY,
        2 => f32::MAX,
        3 => f32::MIN,
        _ => 0.0,
    };
    for isovalue in [-1.0, 0.0, 1.0, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
        closed(&Field::random([7, 8, 6], 2, of).whole(isovalue, true));
    }
    assert_eq!(Field::random([4; 3], 2, of).whole(f32::NAN, true), TriMesh::default());
}

#[test]
fn a_grid_without_cells_has_no_surface() {
    for grid in [[1, 5, 5], [5, 1, 5], [5, 5, 1], [1, 1, 1]] {
        let field = Field::random(grid, 4, |bits| (bits >> 16) as f32);
        assert_eq!(field.whole(3e4, true), TriMesh::default(), "{grid:?}");
    }
}

#[test]
fn a_window_that_lacks_nodes_is_refused() {
    let field = Field::new([8; 3], |[x, _, _]| x);
    let run = |start: u64, size: usize, cells: [u64; 2]| {
        let values = &field.values[..size * 64];
        let block = GridBlock {
            grid: [8; 3],
            stride: [1; 3],
            start: [0, 0, start],
            size: [8, 8, size],
            values,
            cells: [[0, 7], [0, 7], cells],
        };
        let world = WorldMap::of_samples(&Geometry::default());
        let mut out = ChunkSurface::default();
        std::panic::catch_unwind(move || {
            marching_cubes(&block, 3.5, false, &world, &mut CubeBench::default(), &mut out);
            out.triangles().len()
        })
        .is_ok()
    };
    assert!(run(0, 8, [0, 7]) && run(1, 6, [2, 5]) && run(0, 3, [0, 1]) && run(5, 3, [6, 7]));
    assert!(!run(0, 7, [0, 7]) && !run(2, 5, [2, 5]) && !run(1, 5, [2, 5]) && !run(0, 2, [0, 1]));
    assert!(!run(1, 8, [2, 5]) && !run(0, 8, [0, 8]));
}
