use super::*;

fn mesh(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> TriMesh {
    let vertex = |&position: &[f32; 3]| Vertex { position, normal: [0.0, 0.0, 1.0] };
    TriMesh { vertices: positions.iter().map(vertex).collect(), triangles: triangles.to_vec() }
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
    let wanted = SurfaceReport {
        vertices: 8,
        triangles: 12,
        edges: 18,
        components: 1,
        euler: 2,
        area: 10.0,
        volume: Some(2.0),
        bounding_box: Some([[0.0; 3], [2.0, 1.0, 1.0]]),
        ..SurfaceReport::default()
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
    assert_eq!(check(&TriMesh::default()), SurfaceReport::default());
    assert!(boundary_edges(&TriMesh::default()).is_empty());
    let points = check(&mesh(&[[0.0; 3]; 3], &[]));
    assert_eq!((points.unreferenced_vertices, points.components, points.euler), (3, 0, 0));
}

#[test]
fn rims_are_told_apart_from_the_domain_boundary() {
    let geometry = Geometry { origin: [5.0, 0.0, 0.0], spacing: [2.0, 1.0, 1.0], ..Geometry::default() };
    // In index space: a strip from face x = 0 to face x = 3, at height z = 1, of a domain of 4 x 5 x 6 samples.
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
