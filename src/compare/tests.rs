use super::*;
use crate::surface::{TriMesh, Vertex};
use isospan_io::exec::Resources;
use std::collections::BTreeMap;

fn vertex(p: [f64; 3]) -> Vertex {
    Vertex { position: p.map(|c| c as f32), normal: [0.0; 3] }
}

/// An icosahedron with edges halved `times` times and vertices pushed to the sphere of radius 1.
fn sphere(times: u32) -> TriMesh {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let unit = |p: [f64; 3]| {
        let l = p.iter().map(|c| c * c).sum::<f64>().sqrt();
        p.map(|c| c / l)
    };
    let mut points: Vec<[f64; 3]> = [
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ]
    .map(unit)
    .to_vec();
    let mut triangles: Vec<[u32; 3]> = vec![
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    for _ in 0..times {
        let mut middles = BTreeMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let (p, q) = (points[a as usize], points[b as usize]);
                points.push(unit(std::array::from_fn(|k| p[k] + q[k])));
                points.len() as u32 - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
            })
            .collect();
    }
    TriMesh { vertices: points.into_iter().map(vertex).collect(), triangles, ..TriMesh::default() }
}

fn settings(samples: u64) -> CompareSettings {
    CompareSettings { resources: Resources::default().with_threads(2).with_memory(1 << 30), samples }
}

#[test]
fn an_icosahedron_and_its_sphere_are_as_far_apart_as_geometry_says() {
    let (solid, ball) = (sphere(0), sphere(5));
    let report = compare(&solid, &ball, &settings(40_000)).unwrap();
    // Vertices lie on the sphere; the centre of a face is nearest to the middle of the solid, and
    // farthest from the sphere.
    let edge = 4.0 / (10.0 + 2.0 * 5f64.sqrt()).sqrt();
    let inradius = 3f64.sqrt() / 12.0 * (3.0 + 5f64.sqrt()) * edge;
    let expected = 1.0 - inradius;
    assert!((report.a_to_b.max - expected).abs() < 2e-3, "{} {expected}", report.a_to_b.max);
    assert!((report.b_to_a.max - expected).abs() < 2e-3, "{} {expected}", report.b_to_a.max);
    assert_eq!(report.hausdorff, report.a_to_b.max.max(report.b_to_a.max));
    // Over a face at distance h from the middle, the distance from the sphere is 1 - sqrt(h² + r²).
    let mean = over_face(edge, |r| 1.0 - (inradius * inradius + r * r).sqrt());
    assert!((report.a_to_b.mean / mean - 1.0).abs() < 0.02, "{} {mean}", report.a_to_b.mean);
    assert!(report.a_to_b.rms > report.a_to_b.mean && report.rms < report.hausdorff);
    // And the sphere's normal there is turned by the angle whose tangent is r / h.
    let turned = over_face(edge, |r| libm::atan(r / inradius).powi(2)).sqrt().to_degrees();
    assert!((report.a_to_b.rms_normal_degrees / turned - 1.0).abs() < 0.02, "{:?} {turned}", report.a_to_b);
    assert_eq!((report.a.euler, report.a.components, report.b.euler), (2, 1, 2));
    assert!((report.b.area / (4.0 * std::f64::consts::PI) - 1.0).abs() < 2e-3);
    assert!(report.b.volume.unwrap() > report.a.volume.unwrap());
}

/// The mean over an equilateral triangle of a function of the distance from its centre, by brute
/// force.
fn over_face(edge: f64, of: impl Fn(f64) -> f64) -> f64 {
    let height = edge * 3f64.sqrt() / 2.0;
    let (mut sum, mut n) = (0.0, 0.0);
    for i in 0..400 {
        for j in 0..400 {
            let x = edge * (f64::from(i) + 0.5) / 400.0 - edge / 2.0;
            let y = height * (f64::from(j) + 0.5) / 400.0;
            if x.abs() * 2.0 / edge <= 1.0 - y / height {
                sum += of((x * x + (y - height / 3.0).powi(2)).sqrt());
                n += 1.0;
            }
        }
    }
    sum / n
}

#[test]
fn a_surface_is_no_distance_from_itself() {
    let ball = sphere(3);
    let mut turned = ball.clone();
    turned.triangles.reverse();
    turned.triangles.iter_mut().for_each(|t| t.rotate_left(1));
    let report = compare(&ball, &turned, &settings(5_000)).unwrap();
    assert_eq!((report.hausdorff, report.mean, report.rms), (0.0, 0.0, 0.0));
    assert!(report.rms_normal_degrees < 1e-6, "{}", report.rms_normal_degrees);
}

#[test]
fn a_shift_is_found_and_threads_do_not_show() {
    let ball = sphere(4);
    let mut moved = ball.clone();
    moved.vertices.iter_mut().for_each(|v| v.position[0] += 0.125);
    let all: Vec<CompareReport> = [1, 2, 5]
        .map(|threads| {
            compare(
                &ball,
                &moved,
                &CompareSettings {
                    resources: settings(20_000).resources.with_threads(threads),
                    ..settings(20_000)
                },
            )
            .unwrap()
        })
        .to_vec();
    assert!(all.iter().all(|r| *r == all[0]));
    assert!((all[0].hausdorff - 0.125).abs() < 1e-3);
    assert!((all[0].a_to_b.rms - 0.125 / 3f64.sqrt()).abs() < 2e-3, "{}", all[0].a_to_b.rms);
    assert!(all[0].a_to_b.max_at[0].abs() > 0.98, "at a pole of the shift");
}

#[test]
fn samples_are_even_by_area() {
    // A large and a small triangle, 3 to 1, and one without area between them.
    let vertices =
        [[0.0; 3], [3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [0.0, 1.0, 5.0]];
    let mesh = TriMesh {
        vertices: vertices.map(vertex).to_vec(),
        triangles: vec![[0, 1, 2], [0, 1, 1], [3, 4, 5]],
        ..TriMesh::default()
    };
    let triangles = Triangles::read(&mesh).unwrap();
    let samples = AreaSamples::new(&triangles, 4_000).unwrap();
    let points: Vec<[f64; 3]> = (0..4_000).map(|k| samples.get(k).0).collect();
    assert_eq!(points.iter().filter(|p| p[2] == 0.0).count(), 3_000);
    let mean = |k: usize| points[..3_000].iter().map(|p| p[k]).sum::<f64>() / 3_000.0;
    assert!((mean(0) - 1.0).abs() < 2e-3 && (mean(1) - 1.0 / 3.0).abs() < 2e-3, "{} {}", mean(0), mean(1));
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let ball = sphere(1);
    let refused = |mesh: &TriMesh, memory| {
        compare(
            &ball,
            mesh,
            &CompareSettings { resources: settings(100).resources.with_memory(memory), ..settings(100) },
        )
        .unwrap_err()
        .exit_code()
    };
    assert_eq!(refused(&TriMesh::default(), 1 << 30), 2);
    let line = TriMesh {
        vertices: vec![vertex([0.0; 3]), vertex([1.0, 0.0, 0.0])],
        triangles: vec![[0, 1, 1]],
        ..TriMesh::default()
    };
    assert_eq!(refused(&line, 1 << 30), 2);
    let far = TriMesh {
        vertices: vec![vertex([1e20, 0.0, 0.0]); 3],
        triangles: vec![[0, 1, 2]],
        ..TriMesh::default()
    };
    assert_eq!(refused(&far, 1 << 30), 2);
    assert_eq!(refused(&ball, 1 << 20), 4);
}

#[test]
fn distances_in_pieces_are_those_of_the_whole() {
    let (a, mut b) = (sphere(5), sphere(6));
    for v in &mut b.vertices {
        let [x, y, z] = v.position;
        v.position = [1.2 * x + 0.1, y, 0.9 * z];
    }
    let with = |memory, threads| {
        apart(&a, &b, &Resources::default().with_memory(memory).with_threads(threads)).unwrap().unwrap()
    };
    let all = with(1 << 30, 1);
    // The least pieces: 20 of them.
    assert_eq!([with(0, 1), with(0, 3)], [all; 2]);
    let exact = distances(&a, &b, &CompareSettings::default()).unwrap();
    let largest = exact.iter().copied().fold(0.0, f32::max);
    assert_eq!(all.max as f32, largest);
    let sampled = compare(&a, &b, &CompareSettings::default()).unwrap().a_to_b;
    assert!((all.mean - sampled.mean).abs() < 1e-3 * all.mean, "{all:?} {sampled:?}");
    assert!((all.rms - sampled.rms).abs() < 1e-3 * all.rms, "{all:?} {sampled:?}");
    let far = TriMesh::default();
    assert_eq!(apart(&a, &far, &Resources::default()).unwrap(), None);
}
