use super::*;
use crate::surface::check::check;
use crate::surface::model::TriMesh;
use crate::surface::testing::{Grid, assert_sound, mirrored};
use isospan_io::grid::Geometry;

fn stored(mesh: &TriMesh, settings: &BuilderSettings) -> StoredSurface {
    let mut out = StoredSurface::new(settings);
    mesh.vertices.iter().for_each(|&v| out.push_vertex(v).unwrap());
    mesh.triangles.iter().for_each(|&t| out.push_triangle(t).unwrap());
    out
}

fn run(mesh: &TriMesh, filter: ComponentFilter, memory_bytes: usize) -> (TriMesh, ComponentReport) {
    let scratch = tempfile::tempdir().unwrap();
    let settings = BuilderSettings { memory_bytes, scratch: scratch.path().to_path_buf() };
    let (kept, report) = components(stored(mesh, &settings), &filter, &settings).unwrap();
    (TriMesh::from_source(&kept).unwrap(), report)
}

/// Four balls of different sizes, a hollow one, and one that the box cuts.
fn balls(geometry: &Geometry) -> TriMesh {
    let grid = Grid::new([40, 30, 30]);
    let ball = |p: [f64; 3], c: [f64; 3], r: f64| {
        r - ((p[0] - c[0]).powi(2) + (p[1] - c[1]).powi(2) + (p[2] - c[2]).powi(2)).sqrt()
    };
    let values = grid.sample(|p| {
        let hollow = ball(p, [28.0, 18.0, 14.0], 9.0).min(-ball(p, [28.0, 18.0, 14.0], 5.0));
        let whole = [
            ([6.0, 6.0, 6.0], 4.0),
            ([6.0, 18.0, 8.0], 3.0),
            ([10.0, 24.0, 22.0], 2.5),
            ([0.0, 0.0, 22.0], 5.0),
        ];
        whole.into_iter().map(|(c, r)| ball(p, c, r)).fold(hollow, f64::max)
    });
    grid.surface(&values, 0.0, geometry)
}

/// The components by brute force: labels by repeated minimum over triangles.
fn brute_force(mesh: &TriMesh) -> Vec<TriMesh> {
    let mut label: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    loop {
        let before = label.clone();
        for t in &mesh.triangles {
            let lowest = t.iter().map(|&v| label[v as usize]).min().unwrap();
            t.iter().for_each(|&v| label[v as usize] = lowest);
        }
        if before == label {
            break;
        }
    }
    let mut roots = label.clone();
    roots.sort_unstable();
    roots.dedup();
    let part = |&root: &u32| TriMesh {
        vertices: mesh.vertices.clone(),
        triangles: mesh.triangles.iter().copied().filter(|t| label[t[0] as usize] == root).collect(),
        ..TriMesh::default()
    };
    roots.iter().map(part).collect()
}

#[test]
fn components_are_those_of_brute_force() {
    for geometry in [Geometry::default(), mirrored()] {
        let mesh = balls(&geometry);
        let (kept, report) = run(&mesh, ComponentFilter::default(), 1 << 26);
        assert_eq!((&kept, report.found, report.kept), (&mesh, 6, 6));
        let mut parts = brute_force(&mesh);
        parts.sort_by_key(|p| Reverse(p.triangles.len()));
        for (part, got) in parts.iter().zip(&report.listed) {
            let wanted = check(part);
            assert_eq!((got.triangles, got.closed), (wanted.triangles, wanted.is_closed()));
            assert_eq!(got.vertices, wanted.vertices - wanted.unreferenced_vertices);
            assert_eq!(Some(got.bounding_box), wanted.bounding_box);
            assert!((got.area / wanted.area - 1.0).abs() < 1e-12);
            if let Some(volume) = wanted.volume {
                assert!((got.volume / volume - 1.0).abs() < 1e-9, "{got:?} {volume}");
            }
        }
        let cavities = report.listed.iter().filter(|c| c.volume < 0.0).count();
        assert_eq!((cavities, report.listed.iter().filter(|c| !c.closed).count()), (1, 1));
    }
}

#[test]
fn the_largest_the_many_and_the_voluminous_are_kept() {
    let mesh = balls(&Geometry::default());
    let all = run(&mesh, ComponentFilter::default(), 1 << 26).1.listed;
    for n in 0..8 {
        let filter = ComponentFilter { largest: Some(n), ..Default::default() };
        let (kept, report) = run(&mesh, filter, 1 << 26);
        let expected = &all[..all.len().min(n as usize)];
        assert_eq!((&report.listed[..], report.found), (expected, 6));
        assert_eq!(kept.triangles.len() as u64, expected.iter().map(|c| c.triangles).sum::<u64>());
        assert_eq!(assert_sound(&kept).components, expected.len() as u64);
    }
    let least = all[3].triangles;
    let (kept, report) = run(&mesh, ComponentFilter { min_triangles: least, ..Default::default() }, 1 << 26);
    assert_eq!((report.kept, assert_sound(&kept).components), (4, 4));
    let (kept, report) = run(&mesh, ComponentFilter { min_volume: 500.0, ..Default::default() }, 1 << 26);
    assert_eq!((report.kept, assert_sound(&kept).components), (2, 2), "the hollow ball's outside and inside");
    assert_eq!(
        run(&mesh, ComponentFilter { min_volume: 1e9, ..Default::default() }, 1 << 26).0,
        TriMesh::default()
    );
}

#[test]
fn memory_decides_nothing() {
    let mesh = balls(&mirrored());
    let filter = ComponentFilter { largest: Some(3), min_triangles: 10, min_volume: 1.0 };
    let wanted = run(&mesh, filter, 1 << 26);
    for memory in [0, 30_000, 300_000] {
        let filter = ComponentFilter { largest: None, min_triangles: 300, ..filter };
        assert_eq!(run(&mesh, filter, memory), run(&mesh, filter, 1 << 26));
    }
    assert_eq!(run(&mesh, filter, 10_000), wanted);
}

#[test]
fn more_of_the_largest_than_memory_holds_are_refused() {
    let mesh = balls(&Geometry::default());
    let settings = BuilderSettings { memory_bytes: 8 * CHOICE as usize, ..Default::default() };
    let filter = ComponentFilter { largest: Some(2), ..Default::default() };
    let error = components(stored(&mesh, &settings), &filter, &settings).unwrap_err();
    assert_eq!(error.exit_code(), 4);
    // What the error names suffices, and no less does.
    let Error::Budget { needed, available, .. } = error else { panic!("{error}") };
    assert_eq!(available, 8 * CHOICE);
    let with = |memory: u64| {
        let settings = BuilderSettings { memory_bytes: memory as usize, ..Default::default() };
        components(stored(&mesh, &settings), &filter, &settings)
    };
    assert!(with(needed).is_ok() && with(needed - 1).is_err());
}

#[test]
fn the_volume_of_an_open_component_does_not_depend_on_its_place() {
    let mut half = balls(&Geometry::default());
    half = brute_force(&half).into_iter().find(|p| !check(p).is_closed()).unwrap();
    let here = run(&half, ComponentFilter::default(), 1 << 26).1.listed[0].clone();
    half.vertices.iter_mut().for_each(|v| v.position[1] += 512.0);
    let there = run(&half, ComponentFilter::default(), 1 << 26).1.listed[0].clone();
    assert!((here.volume / there.volume - 1.0).abs() < 1e-4 && here.volume > 10.0, "{here:?} {there:?}");
}

#[test]
fn an_empty_surface_has_no_component() {
    let (kept, report) = run(&TriMesh::default(), ComponentFilter::default(), 1 << 20);
    assert_eq!((kept, report), (TriMesh::default(), ComponentReport::default()));
}
