use super::*;
use crate::surface::Vertex;
use proptest::prelude::*;

fn mesh(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> TriMesh {
    let vertex = |&position: &[f32; 3]| Vertex { position, normal: [0.0, 0.0, 1.0] };
    TriMesh {
        vertices: positions.iter().map(vertex).collect(),
        triangles: triangles.to_vec(),
        ..TriMesh::default()
    }
}

/// A box of 2 x 1 x 1, seen from outside counter-clockwise.
fn cuboid() -> TriMesh {
    let corner = |i: u32| [(i & 1) as f32 * 2.0, (i >> 1 & 1) as f32, (i >> 2 & 1) as f32];
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    mesh(&std::array::from_fn::<_, 8, _>(|i| corner(i as u32)), &triangles)
}

#[test]
fn a_box_is_in_order() {
    let report = check(&cuboid());
    let wanted = SurfaceCheckReport {
        vertices: 8,
        triangles: 12,
        edges: 18,
        components: 1,
        euler: 2,
        area: 10.0,
        volume: Some(2.0),
        bounding_box: Some([[0.0; 3], [2.0, 1.0, 1.0]]),
        ..SurfaceCheckReport::default()
    };
    assert_eq!(report, wanted);
    assert!(report.is_closed() && report.is_manifold() && report.is_oriented());
}

#[test]
fn a_box_turned_inside_out_has_negative_volume() {
    let mut inside_out = cuboid();
    inside_out.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    assert_eq!(check(&inside_out).volume, Some(-2.0));
}

#[test]
fn an_open_box_has_a_rim() {
    let mut open = cuboid();
    open.triangles.drain(2..4);
    let report = check(&open);
    assert_eq!((report.boundary_edges, report.boundary_loops, report.euler), (4, 1, 1));
    assert_eq!(report.volume, None);
    assert!(report.is_manifold() && report.is_oriented() && !report.is_closed());
    let rim = boundary_edges(&open);
    assert_eq!(rim, [[4, 6], [5, 4], [6, 7], [7, 5]], "as the sides run, against the missing top");
    open.triangles.drain(0..2);
    let report = check(&open);
    assert_eq!((report.boundary_edges, report.boundary_loops, report.euler), (8, 2, 0));
}

#[test]
fn a_turned_triangle_shows_on_its_three_edges() {
    let mut turned = cuboid();
    turned.triangles[5].swap(0, 1);
    let report = check(&turned);
    assert_eq!((report.misoriented_edges, report.non_manifold_edges), (3, 0));
    assert!(!report.is_oriented() && report.is_manifold() && report.volume.is_none());
}

#[test]
fn a_bow_tie_is_two_pieces_at_one_vertex() {
    let positions = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]];
    let report = check(&mesh(&positions, &[[0, 1, 2], [0, 3, 4]]));
    assert_eq!((report.non_manifold_vertices, report.non_manifold_edges), (1, 0));
    assert_eq!((report.boundary_edges, report.components), (6, 1));
    assert!(!report.is_manifold());
}

#[test]
fn three_sheets_on_an_edge_are_not_a_manifold() {
    let positions = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];
    let report = check(&mesh(&positions, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]));
    assert_eq!((report.non_manifold_edges, report.misoriented_edges), (1, 0));
    assert_eq!(report.non_manifold_vertices, 2);
    assert!(!report.is_manifold() && !report.is_oriented());
}

#[test]
fn bad_triangles_are_counted_by_kind() {
    let positions = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [9.0, 9.0, f32::NAN]];
    let triangles = [[0, 1, 3], [3, 1, 0], [1, 3, 0], [0, 0, 1], [0, 1, 2], [0, 1, 5], [u32::MAX, 0, 1]];
    let report = check(&mesh(&positions, &triangles));
    assert_eq!(report.degenerate_triangles, 1);
    assert_eq!(report.zero_area_triangles, 1);
    assert_eq!(report.out_of_range_triangles, 2);
    assert_eq!(report.duplicate_triangles, 2);
    assert_eq!(report.unreferenced_vertices, 1);
    assert_eq!(report.non_finite_vertices, 1);
    assert_eq!(report.triangles, 7);
    assert_eq!(report.bounding_box, Some([[0.0; 3], [2.0, 1.0, 0.0]]));
    assert!(!report.is_manifold());
}

#[test]
fn two_boxes_are_two_pieces() {
    let (mut two, other) = (cuboid(), cuboid());
    two.vertices.extend(other.vertices);
    two.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + 8)));
    let report = check(&two);
    assert_eq!((report.components, report.euler, report.volume), (2, 4, Some(4.0)));
}

#[test]
fn nothing_is_nothing() {
    assert_eq!(check(&TriMesh::default()), SurfaceCheckReport::default());
    assert!(boundary_edges(&TriMesh::default()).is_empty());
    let points = check(&mesh(&[[0.0; 3]; 3], &[]));
    assert_eq!((points.unreferenced_vertices, points.components, points.euler), (3, 0, 0));
}

#[test]
fn rims_are_told_apart_from_the_domain_boundary() {
    let geometry = Geometry { origin: [5.0, 0.0, 0.0], spacing: [2.0, 1.0, 1.0], ..Geometry::default() };
    // In index space: a strip from face x = 0 to face x = 3, at height z = 1, of a domain of 4 x 5
    // x 6 samples.
    let strip = |y0: f32, y1: f32| {
        let corners = [[0.0, y0, 1.0], [3.0, y0, 1.0], [3.0, y1, 1.0], [0.0, y1, 1.0]];
        let world = corners.map(|p: [f32; 3]| geometry.to_world(p.map(f64::from)).map(|x| x as f32));
        mesh(&world, &[[0, 1, 2], [0, 2, 3]])
    };
    assert_eq!(boundary_outside(&strip(0.0, 4.0), &geometry, [4, 5, 6], 1e-4), 0);
    assert_eq!(boundary_outside(&strip(0.0, 3.0), &geometry, [4, 5, 6], 1e-4), 1);
    assert_eq!(boundary_outside(&strip(1.0, 3.0), &geometry, [4, 5, 6], 1e-4), 2);
    assert_eq!(boundary_outside(&strip(1.0, 3.0), &geometry, [4, 5, 6], 1.5), 0);
}

#[test]
fn the_report_is_written_as_json() {
    let json = serde_json::to_value(check(&cuboid())).unwrap();
    assert_eq!(json["euler"], 2);
    assert_eq!(json["volume"], 2.0);
    assert_eq!(json["boundary_edges"], 0);
}

/// A mesh that hands itself out in small batches.
struct Batches(TriMesh);

impl SurfaceSource for Batches {
    fn vertex_count(&self) -> u64 {
        self.0.vertices.len() as u64
    }
    fn triangle_count(&self) -> u64 {
        self.0.triangles.len() as u64
    }
    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()> {
        self.0.vertices.chunks(7).try_for_each(each)
    }
    fn triangles(&self, each: &mut dyn FnMut(&[[u32; 3]]) -> Result<()>) -> Result<()> {
        self.0.triangles.chunks(5).try_for_each(each)
    }
}

/// Shares so small that everything goes to disk and the cache holds one block.
fn tiny(mesh: &TriMesh, domain: &Domain<'_>) -> (SurfaceCheckReport, Option<u64>) {
    let scratch = tempfile::tempdir().unwrap();
    let settings = CheckSettings { scratch: scratch.path().into(), ..CheckSettings::default() };
    let mut shares = Shares::of(mesh.vertex_count(), &settings).unwrap();
    (shares.arcs, shares.positions) = (12 * 5, 8);
    let (report, open) = check_in(&Batches(mesh.clone()), Some(domain), &shares, &mut |_| Ok(0)).unwrap();
    assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 0);
    (report, Some(open.outside))
}

proptest! {
    #[test]
    fn memory_does_not_show(
        places in prop::collection::vec((-2.0f32..2.0, -2.0f32..2.0, 0usize..3), 0..600),
        corners in prop::collection::vec([0usize..40, 0usize..40, 0usize..40], 0..300),
        shift in 0usize..600,
    ) {
        // Few vertices in use: non-manifold edges, bow ties, repeated triangles and vertices,
        // numbers that are none.
        let triangles: Vec<[u32; 3]> = corners.iter().map(|t| t.map(|v| (v + shift) as u32)).collect();
        let positions: Vec<[f32; 3]> = places.iter().map(|&(x, y, z)| [x, y, [0.0, -0.0, 1.0][z]]).collect();
        let mesh = mesh(&positions, &triangles);
        let geometry = Geometry::default();
        let domain = Domain { geometry: &geometry, dims: [2, 2, 2], cuts: &[], tolerance: 0.5 };
        let whole = check_source(&mesh, Some(&domain), &CheckSettings::default()).unwrap();
        let comparable = |found: &(SurfaceCheckReport, Option<u64>)| (serde_json::to_string(&found.0).unwrap(), found.1);
        prop_assert_eq!(comparable(&whole), comparable(&tiny(&mesh, &domain)));
        prop_assert_eq!(whole.0.boundary_edges, boundary_edges(&mesh).len() as u64);
    }
}

#[test]
fn a_grid_with_holes_and_turned_triangles_is_the_same_from_disk() {
    let n = 60u32;
    let positions: Vec<[f32; 3]> =
        (0..n * n).map(|i| [(i % n) as f32, (i / n) as f32, (i * 7 % 5) as f32 * 0.1]).collect();
    let quads = (0..n * n).filter(|i| i % n + 1 < n && i / n + 1 < n && i % 17 != 3);
    let mut triangles: Vec<[u32; 3]> =
        quads.flat_map(|i| [[i, i + 1, i + n], [i + 1, i + n + 1, i + n]]).collect();
    triangles.iter_mut().step_by(101).for_each(|t| t.swap(0, 1));
    let mesh = mesh(&positions, &triangles);
    let geometry = Geometry::default();
    let domain = Domain { geometry: &geometry, dims: [60, 60, 1], cuts: &[], tolerance: 1e-3 };
    let found = check_source(&mesh, Some(&domain), &CheckSettings::default()).unwrap();
    assert!(found.0.boundary_loops > 50 && found.0.misoriented_edges > 50, "{found:?}");
    assert!(found.1.unwrap() > 100, "holes are not on the faces: {found:?}");
    assert_eq!(found, tiny(&mesh, &domain));
}

#[test]
fn too_little_memory_is_refused_naming_what_works() {
    let two = mesh(&[[0.0; 3]; 1000], &[[0, 1, 2]]);
    let within = |memory| {
        let settings = CheckSettings { memory, ..CheckSettings::default() };
        check_source(&two, None, &settings)
    };
    let Err(Error::Budget { needed, .. }) = within(1 << 20) else { panic!("1 MiB is not enough") };
    assert!(within(needed - 1).is_err() && within(needed).is_ok());
    // A fan of very many triangles.
    let fan: Vec<[u32; 3]> = (0..60_000).map(|i| [0, 1 + i % 997, 2 + i % 997]).collect();
    let fan = mesh(&[[0.0; 3]; 1000], &fan);
    let within = |memory| check_source(&fan, None, &CheckSettings { memory, ..CheckSettings::default() });
    let Err(Error::Budget { purpose, needed: more, .. }) = within(needed) else {
        panic!("the fan is too large")
    };
    assert!(purpose.contains("60000 triangles at one vertex"), "{purpose}");
    assert_eq!(within(more).unwrap().0, check(&fan));
}
