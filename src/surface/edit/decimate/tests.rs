use super::*;
use crate::surface::TriMesh;
use crate::surface::check::check;
use crate::surface::testing::{Grid, assert_sound, mirrored};
use isospan_io::grid::Geometry;

fn stored(mesh: &TriMesh, settings: &BuilderSettings) -> StoredSurface {
    let mut out = StoredSurface::new(settings);
    mesh.vertices.iter().for_each(|&v| out.push_vertex(v).unwrap());
    mesh.triangles.iter().for_each(|&t| out.push_triangle(t).unwrap());
    out
}

fn run(mesh: &TriMesh, goal: Decimation, memory_bytes: usize, threads: usize) -> (TriMesh, DecimationReport) {
    let scratch = tempfile::tempdir().unwrap();
    let settings = BuilderSettings { memory_bytes, scratch: scratch.path().to_path_buf() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let done = pool.install(|| {
        decimate(stored(mesh, &settings), &goal, &Faces::default(), &settings, &CancelToken::new())
    });
    let (surface, report) = done.unwrap();
    (TriMesh::from_source(&surface).unwrap(), report)
}

const ENOUGH: usize = 1 << 30;

/// A busy surface that ends at the box, of two patches and a bit.
fn gyroid(geometry: &Geometry) -> TriMesh {
    let grid = Grid::new([52, 46, 44]);
    let s = 0.55;
    let values = grid.sample(|[x, y, z]| {
        (s * x).sin() * (s * y).cos() + (s * y).sin() * (s * z).cos() + (s * z).sin() * (s * x).cos()
    });
    grid.surface(&values, 0.1, geometry)
}

fn ball(n: u64) -> TriMesh {
    let grid = Grid::new([n; 3]);
    let c = (n - 1) as f64 / 2.0;
    let values = grid.sample(|p| c * 0.8 - p.iter().map(|x| (x - c).powi(2)).sum::<f64>().sqrt());
    grid.surface(&values, 0.0, &Geometry::default())
}

/// What decimation must keep: manifold, orientation, components, genus, boundary.
fn assert_same_topology(before: &TriMesh, after: &TriMesh) {
    let (b, a) = (check(before), assert_sound(after));
    assert_eq!((a.euler, a.components, a.boundary_loops), (b.euler, b.components, b.boundary_loops));
    assert_eq!(a.boundary_edges, b.boundary_edges);
}

#[test]
fn topology_is_kept_and_the_goal_reached_across_seams() {
    for geometry in [Geometry::default(), mirrored()] {
        let mesh = gyroid(&geometry);
        assert!(mesh.triangles.len() as u64 > 2 * PATCH, "{} triangles", mesh.triangles.len());
        let (few, report) = run(&mesh, Decimation { ratio: 0.15, ..Decimation::default() }, ENOUGH, 2);
        assert_same_topology(&mesh, &few);
        assert!(few.triangles.len() <= mesh.triangles.len() * 155 / 1000, "{report:?}");
        assert!(report.passes >= 2, "{report:?}");
        let (b, a) = (check(&mesh), check(&few));
        assert!((a.area / b.area - 1.0).abs() < 0.02, "{} {}", a.area, b.area);
    }
}

#[test]
fn as_few_as_there_can_be_is_still_a_ball() {
    let mesh = ball(20);
    let (few, _) = run(&mesh, Decimation::default(), ENOUGH, 1);
    assert_same_topology(&mesh, &few);
    assert!(few.triangles.len() < 100, "{}", few.triangles.len());
}

#[test]
fn neither_threads_nor_memory_show() {
    let mesh = gyroid(&Geometry::default());
    let goal = Decimation { ratio: 0.3, max_error: 0.2 };
    let wanted = run(&mesh, goal, ENOUGH, 1);
    let least = Decimation::least_memory(mesh.triangles.len() as u64) as usize;
    assert!(run(&mesh, goal, least, 2) == wanted);
    let settings = BuilderSettings { memory_bytes: least - 1, ..BuilderSettings::default() };
    let refused =
        decimate(stored(&mesh, &settings), &goal, &Faces::default(), &settings, &CancelToken::new());
    assert_eq!(refused.unwrap_err().exit_code(), 4);
}

#[test]
fn the_error_is_kept_and_measured() {
    let (n, limit) = (32, 0.1);
    let mesh = ball(n);
    let radius = |p: [f32; 3]| {
        let c = (n - 1) as f64 / 2.0;
        p.iter().map(|&x| (f64::from(x) - c).powi(2)).sum::<f64>().sqrt()
    };
    let radii = |mesh: &TriMesh| {
        let middles = mesh.triangles.iter().map(|t| {
            let corners = t.map(|v| mesh.vertices[v as usize].position);
            [0, 1, 2].map(|k| (corners[0][k] + corners[1][k] + corners[2][k]) / 3.0)
        });
        let all = middles.chain(mesh.vertices.iter().map(|v| v.position)).map(radius);
        all.fold((f64::INFINITY, 0.0f64), |(lo, hi), r| (lo.min(r), hi.max(r)))
    };
    let (few, report) = run(&mesh, Decimation { ratio: 0.0, max_error: limit }, ENOUGH, 2);
    assert_same_topology(&mesh, &few);
    assert!(report.error_estimate <= limit && report.error_estimate > limit / 2.0, "{report:?}");
    assert!(few.triangles.len() * 4 < mesh.triangles.len(), "{report:?}");
    let ((lo, hi), (lo_few, hi_few)) = (radii(&mesh), radii(&few));
    assert!(lo_few > lo - limit && hi_few < hi + limit, "{lo} {hi} {lo_few} {hi_few}");
}

#[test]
fn goals_that_make_no_sense_are_refused() {
    for goal in [
        Decimation { ratio: 1.5, ..Decimation::default() },
        Decimation { ratio: f64::NAN, ..Decimation::default() },
        Decimation { max_error: -1.0, ..Decimation::default() },
    ] {
        assert_eq!(goal.check().unwrap_err().exit_code(), 2);
    }
}

#[test]
fn nothing_to_do_changes_nothing() {
    let mesh = ball(12);
    assert_eq!(run(&mesh, Decimation { ratio: 1.0, ..Decimation::default() }, ENOUGH, 1).0, mesh);
    assert_eq!(run(&TriMesh::default(), Decimation::default(), ENOUGH, 1).0, TriMesh::default());
}
