use super::*;
use crate::surface::check::check;
use crate::surface::extract::Workbench;
use crate::surface::testing::{Grid, assert_sound, mirrored, triangle_set};
use crate::surface::weld::{BuilderSettings, SurfaceBuilder};
use crate::surface::{TriMesh, Vertex, WorldMap};
use isospan_io::grid::Geometry;

/// The capped surface, by way of chunks.
fn capped(grid: &Grid, values: &[f32], isovalue: f32, geometry: &Geometry, chunk: &[usize]) -> TriMesh {
    let world = WorldMap::new(&grid.lattice, geometry);
    let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
    let mut out = ChunkSurface::default();
    for part in grid.parts(values, chunk) {
        let source = part.source();
        let mut at_ends = vec![];
        select_boundary(&source, grid.lattice.max(), isovalue, &mut at_ends);
        out.start(isovalue, source.ids.len());
        out.add(&source, &world, &mut Workbench::default());
        out.add_caps(&CellSource { tets: &at_ends, ..source }, &world, grid.lattice.max());
        out.finish(&world);
        builder.push(&out).unwrap();
    }
    TriMesh::from_source(&builder.finish().unwrap()).unwrap()
}

fn in_one(grid: &Grid, values: &[f32], isovalue: f32) -> TriMesh {
    capped(grid, values, isovalue, &Geometry::default(), &vec![0; grid.tets.len()])
}

/// The part of a tetrahedron where the linear interpolant is `>= 0`.
fn part_inside(f: [f64; 4]) -> f64 {
    let (inside, outside): (Vec<f64>, Vec<f64>) =
        (f.into_iter().filter(|&x| x >= 0.0).collect(), f.into_iter().filter(|&x| x < 0.0).collect());
    // A corner is cut off at these parts of its three edges.
    let corner = |x: f64, others: &[f64]| others.iter().map(|y| x / (x - y)).product::<f64>();
    match (&inside[..], &outside[..]) {
        ([], _) => 0.0,
        (_, []) => 1.0,
        ([a], rest) => corner(*a, rest),
        (rest, [a]) => 1.0 - corner(*a, rest),
        ([a, b], [c, d]) => {
            // A wedge between (a, ac, ad) and (b, bc, bd), as three tetrahedra.
            let (ac, ad, bc, bd) = (a / (a - c), a / (a - d), b / (b - c), b / (b - d));
            ac * ad + (1.0 - ac) * ad * bc + (1.0 - ad) * bc * bd
        }
        _ => unreachable!(),
    }
}

fn volume_inside(grid: &Grid, values: &[f32], isovalue: f32) -> f64 {
    // Kuhn's tetrahedra have a sixth of a voxel each.
    let part = |t: &Tet| part_inside(t.map(|v| f64::from(values[v as usize]) - f64::from(isovalue))) / 6.0;
    grid.tets.iter().map(part).sum()
}

fn waves([x, y, z]: [f64; 3]) -> f64 {
    (0.7 * x).sin() + (0.9 * y + 0.3).cos() + (0.8 * z + 0.2 * x).sin()
}

#[test]
fn the_whole_box_is_its_six_faces() {
    let grid = Grid::new([4, 5, 6]);
    let mesh = in_one(&grid, &vec![1.0; grid.ids.len()], 0.5);
    let report = assert_sound(&mesh);
    assert_eq!((report.boundary_edges, report.euler, report.components), (0, 2, 1));
    assert_eq!((report.volume, report.area), (Some(60.0), 2.0 * (12.0 + 15.0 + 20.0)));
    assert_eq!(in_one(&grid, &vec![0.0; grid.ids.len()], 0.5), TriMesh::default());
}

#[test]
fn what_is_enclosed_is_what_is_inside() {
    let grid = Grid::new([14, 12, 13]);
    let values = grid.sample(waves);
    for isovalue in [-1.7f32, -0.4, 0.013, 0.9, 1.8] {
        let report = assert_sound(&in_one(&grid, &values, isovalue));
        assert_eq!(report.boundary_edges, 0, "{isovalue}");
        let wanted = volume_inside(&grid, &values, isovalue);
        assert!((report.volume.unwrap() / wanted - 1.0).abs() < 2e-3, "{isovalue}: {report:?} {wanted}");
    }
}

#[test]
fn values_equal_to_the_isovalue_leave_it_closed() {
    let grid = Grid::new([7, 6, 5]);
    let mut seed = 7u32;
    for isovalue in [0.0f32, 1.0, 2.0] {
        for _ in 0..40 {
            let values: Vec<f32> = (0..grid.ids.len())
                .map(|_| {
                    seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (seed >> 30) as f32
                })
                .collect();
            let report = assert_sound(&in_one(&grid, &values, isovalue));
            assert_eq!(report.boundary_edges, 0);
        }
    }
}

#[test]
fn chunks_and_mirrors_do_not_show() {
    let grid = Grid::new([10, 9, 11]);
    let values = grid.sample(waves);
    for geometry in [Geometry::default(), mirrored()] {
        let whole = capped(&grid, &values, 0.2, &geometry, &vec![0; grid.tets.len()]);
        let report = assert_sound(&whole);
        assert!(report.boundary_edges == 0 && report.volume.unwrap() > 0.0, "{report:?}");
        for parts in [2usize, 7] {
            let chunk: Vec<usize> = (0..grid.tets.len()).map(|i| (i / 6 * 31) % parts).collect();
            let cut = capped(&grid, &values, 0.2, &geometry, &chunk);
            assert_eq!(triangle_set(&cut), triangle_set(&whole));
        }
    }
}

#[test]
fn caps_look_out_of_the_box() {
    let grid = Grid::new([3, 3, 3]);
    let mesh = in_one(&grid, &vec![1.0; grid.ids.len()], 0.0);
    for v in &mesh.vertices {
        for (k, x) in v.position.into_iter().enumerate() {
            let n = v.normal[k];
            assert!(
                if x == 0.0 {
                    n < 0.0
                } else if x == 2.0 {
                    n > 0.0
                } else {
                    n == 0.0
                },
                "{v:?}"
            );
        }
    }
}

#[test]
fn the_rim_faces_out_of_the_box() {
    let grid = Grid::new([6, 6, 6]);
    let mesh = in_one(&grid, &grid.sample(|[x, y, _]| 2.3 - x + 0.2 * y), 0.0);
    let at = |axis: usize, x: f32| mesh.vertices.iter().filter(move |v| v.position[axis] == x);
    // The surface leans; its upper and lower rims lie in z = 0 and z = 5.
    let inner = |v: &&Vertex| v.position[1] > 0.0 && v.position[1] < 5.0 && v.position[0] > 0.0;
    assert!(at(2, 0.0).filter(inner).count() > 10);
    assert!(at(2, 0.0).filter(inner).all(|v| v.normal[2] < -0.999), "{:?}", at(2, 0.0).next());
    assert!(at(2, 5.0).filter(inner).all(|v| v.normal[2] > 0.999));
    let inside = mesh.vertices.iter().filter(|v| v.position.iter().all(|&x| x > 0.0 && x < 5.0));
    assert!(inside.clone().count() > 10 && inside.clone().all(|v| v.normal[0] > 0.9));
}

#[test]
fn no_cap_is_made_up_around_missing_samples() {
    let grid = Grid::new([6, 6, 6]);
    let mut values = vec![1.0; grid.ids.len()];
    values[0] = f32::NAN;
    let report = check(&in_one(&grid, &values, 0.0));
    assert!(report.boundary_edges > 0 && report.is_oriented() && report.is_manifold(), "{report:?}");
}
