use super::*;
use crate::surface::{TriMesh, Vertex};
use isospan_io::exec::Resources;

/// A sphere of radius 1 in rows and columns.
fn sphere(rows: u32, normals: bool) -> TriMesh {
    let columns = 2 * rows;
    let mut mesh = TriMesh::default();
    for i in 0..=rows {
        for j in 0..columns {
            let (t, p) = (
                std::f64::consts::PI * f64::from(i) / f64::from(rows),
                std::f64::consts::TAU * f64::from(j) / f64::from(columns),
            );
            let at =
                [libm::sin(t) * libm::cos(p), libm::sin(t) * libm::sin(p), libm::cos(t)].map(|c| c as f32);
            mesh.vertices.push(Vertex { position: at, normal: if normals { at } else { [0.0; 3] } });
        }
    }
    for i in 0..rows {
        for j in 0..columns {
            let (a, b) = (i * columns + j, i * columns + (j + 1) % columns);
            mesh.triangles.push([a, a + columns, b + columns]);
            mesh.triangles.push([a, b + columns, b]);
        }
    }
    mesh
}

fn settings(threads: usize) -> RenderSettings {
    RenderSettings {
        resources: Resources::default().with_threads(threads).with_memory(1 << 30),
        lights: 24,
        ..RenderSettings::default()
    }
}

fn of(mesh: &TriMesh, paint: Paint) -> Subject<'_> {
    Subject { surface: mesh, paint, opacity: 1.0, values: &[] }
}

fn draw(mesh: &TriMesh, camera: &Camera, paint: Paint, settings: &RenderSettings) -> Image {
    let view = View::fit(camera, &[mesh], [90, 80]).unwrap();
    render(&[of(mesh, paint)], &view, settings).unwrap()
}

fn lightness(p: &[u8; 4]) -> u32 {
    p[..3].iter().map(|&c| u32::from(c)).sum()
}

const GREY: Paint = Paint::Plain([200; 3]);

#[test]
fn a_sphere_is_a_disc_lit_from_above_left() {
    let camera = Camera { perspective: false, ..Camera::default() };
    let image = draw(&sphere(40, true), &camera, GREY, &settings(2));
    let at = |x: usize, y: usize| &image.pixels[y * 90 + x];
    let covered = image.pixels.iter().filter(|p| **p != [255; 4]).count() as f64;
    let radius = 0.94 * 40.0;
    let disc = std::f64::consts::PI * radius * radius;
    assert!((covered / disc - 1.0).abs() < 0.06, "{covered} {disc}");
    assert!(lightness(at(33, 28)) > lightness(at(57, 55)) + 100, "{:?} {:?}", at(33, 28), at(57, 55));
    assert!(lightness(at(45, 40)) > 300 && at(2, 2) == &[255; 4]);
    // Edges are smooth: some pixels lie between surface and background.
    let row: Vec<u32> = image.pixels[40 * 90..41 * 90].iter().map(lightness).collect();
    assert!(row.windows(2).filter(|w| w[0].abs_diff(w[1]) > 20).count() >= 2);
}

#[test]
fn threads_and_memory_do_not_show() {
    let mesh = sphere(30, true);
    let one = draw(&mesh, &Camera::default(), GREY, &settings(1));
    assert_eq!(draw(&mesh, &Camera::default(), GREY, &settings(3)), one);
    let least = needed([90, 80], &settings(1), false);
    let tight = RenderSettings { resources: settings(2).resources.with_memory(least), ..settings(2) };
    assert_eq!(draw(&mesh, &Camera::default(), GREY, &tight), one);
    let view = View::fit(&Camera::default(), &[&mesh], [90, 80]).unwrap();
    let subject = of(&mesh, GREY);
    let less = RenderSettings { resources: settings(1).resources.with_memory(least - 1), ..settings(1) };
    assert_eq!(render(&[subject], &view, &less).unwrap_err().exit_code(), 4);
}

#[test]
fn normals_that_a_file_does_not_have_are_made() {
    let camera = Camera::default();
    let given = draw(&sphere(40, true), &camera, Paint::Normals, &settings(1));
    let made = draw(&sphere(40, false), &camera, Paint::Normals, &settings(1));
    let flat =
        draw(&sphere(8, false), &camera, Paint::Normals, &RenderSettings { flat: true, ..settings(1) });
    let smooth = draw(&sphere(8, false), &camera, Paint::Normals, &settings(1));
    let far = |a: &Image, b: &Image| {
        let d = |(p, q): (&[u8; 4], &[u8; 4])| (0..3).map(|k| u64::from(p[k].abs_diff(q[k]))).sum::<u64>();
        a.pixels.iter().zip(&b.pixels).map(d).sum::<u64>() as f64 / a.pixels.len() as f64
    };
    assert!(far(&given, &made) < 1.0, "{}", far(&given, &made));
    assert!(far(&flat, &smooth) > 5.0, "{}", far(&flat, &smooth));
}

#[test]
fn triangles_with_a_common_edge_leave_no_gap_and_no_overlap() {
    // A square in many slivers: every sample is covered exactly once, so the first and the last
    // triangle drawn give the same.
    let n = 37u32;
    let rim = |k: u32| {
        let a = std::f64::consts::TAU * f64::from(k) / f64::from(n);
        [(libm::cos(a)) as f32, (libm::sin(a)) as f32, 0.0]
    };
    let mut mesh = TriMesh {
        vertices: (0..n).map(|k| Vertex { position: rim(k), normal: [0.0, 0.0, 1.0] }).collect(),
        triangles: vec![],
        ..TriMesh::default()
    };
    mesh.vertices.push(Vertex { position: [0.1, -0.2, 0.0], normal: [0.0, 0.0, 1.0] });
    mesh.triangles = (0..n).map(|k| [k, (k + 1) % n, n]).collect();
    let camera = Camera { elevation: 90.0, perspective: false, ..Camera::default() };
    let view = View::fit(&camera, &[&mesh], [64, 64]).unwrap();
    let values: Vec<f32> = (0..=n).map(|k| if k == n { 0.0 } else { 1.0 }).collect();
    let settings = RenderSettings { samples: 1, lights: 0, ..settings(1) };
    let paint = |mesh: &TriMesh| {
        render(&[Subject { values: &values, ..of(mesh, Paint::Values([0.0, 1.0])) }], &view, &settings)
            .unwrap()
    };
    let image = paint(&mesh);
    mesh.triangles.reverse();
    assert_eq!(paint(&mesh), image, "no sample is in two of them");
    for y in 0..64 {
        let row: Vec<bool> = image.pixels[y * 64..][..64].iter().map(|p| *p != [255; 4]).collect();
        assert!(row.windows(2).filter(|w| w[0] != w[1]).count() <= 2, "row {y} has a gap");
    }
}

#[test]
fn a_roof_shades_what_lies_below() {
    // A floor, and a small roof above its middle.
    let plate = |half: f32, z: f32| {
        [[-half, -half], [half, -half], [half, half], [-half, half]]
            .map(|[x, y]| Vertex { position: [x, y, z], normal: [0.0, 0.0, 1.0] })
    };
    let both = TriMesh {
        vertices: [plate(2.0, 0.0), plate(0.4, 0.5)].concat(),
        triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        ..TriMesh::default()
    };
    let camera = Camera { elevation: 35.0, azimuth: 0.0, perspective: false, ..Camera::default() };
    let view = View::fit(&camera, &[&both], [120, 90]).unwrap();
    let drawn = |mesh: &TriMesh, lights| {
        let settings = RenderSettings { lights, ..settings(2) };
        render(&[of(mesh, GREY)], &view, &settings).unwrap()
    };
    let floor = TriMesh {
        vertices: both.vertices.clone(),
        triangles: both.triangles[..2].to_vec(),
        ..TriMesh::default()
    };
    let darkest = |image: &Image| image.pixels.iter().map(lightness).min().unwrap();
    assert!(darkest(&drawn(&both, 48)) + 60 < darkest(&drawn(&floor, 48)));
    assert_eq!(
        darkest(&drawn(&floor, 48)).abs_diff(darkest(&drawn(&floor, 0))) / 20,
        0,
        "a plain floor has no shadow"
    );
}

#[test]
fn a_transparent_background_is_transparent() {
    let settings = RenderSettings { background: [255, 255, 255, 0], ..settings(1) };
    let image = draw(&sphere(30, true), &Camera::default(), GREY, &settings);
    assert_eq!(image.pixels[0][3], 0);
    assert_eq!(image.pixels[40 * 90 + 45][3], 255);
    assert!(image.pixels.iter().any(|p| (1..255).contains(&p[3])), "edges are half transparent");
}

/// A square across the line of sight, at a height.
fn plate(z: f32) -> TriMesh {
    let at = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let vertices = at.map(|[x, y]| Vertex { position: [x, y, z], normal: [0.0, 0.0, 1.0] });
    TriMesh { vertices: vertices.to_vec(), triangles: vec![[0, 1, 2], [0, 2, 3]], ..TriMesh::default() }
}

#[test]
fn layers_add_up_from_front_to_back_in_any_order_of_subjects() {
    // A colour map is not lit, so every colour is known.
    let heights = [0.0f32, 0.5, 1.0, 1.0];
    let plates = heights.map(plate);
    let (shares, opacities) = ([0.9f64, 0.1, 0.5, 0.7], [1.0f32, 0.4, 0.3, 0.6]);
    let values = shares.map(|s| [s as f32; 4]);
    let subjects: Vec<Subject<'_>> = (0..4)
        .map(|n| Subject {
            surface: &plates[n],
            paint: Paint::Flat(ColourMap::Viridis, [0.0, 1.0]),
            opacity: opacities[n],
            values: &values[n],
        })
        .collect();
    let camera = Camera { elevation: 90.0, azimuth: 0.0, perspective: false, ..Camera::default() };
    let sources: Vec<&dyn SurfaceSource> = subjects.iter().map(|s| s.surface).collect();
    let view = View::fit(&camera, &sources, [32, 32]).unwrap();
    let middle = |order: &[usize], threads: usize| {
        let drawn: Vec<Subject<'_>> = order.iter().map(|&n| subjects[n]).collect();
        render(&drawn, &view, &settings(threads)).unwrap().pixels[16 * 32 + 16]
    };
    // Of two at one height the one that comes first is in front.
    let expected = |front_to_back: &[usize]| {
        let mut through = 1.0f32;
        let mut light = [0.0f32; 3];
        for &n in front_to_back {
            let colour = colour::linear(ColourMap::Viridis.colour(shares[n]));
            light = std::array::from_fn(|k| light[k] + through * opacities[n] * colour[k]);
            through *= 1.0 - opacities[n];
        }
        let background = colour::linear([255; 3]);
        let [r, g, b] = std::array::from_fn(|k| colour::encode(light[k] + through * background[k]));
        [r, g, b, 255]
    };
    let near = |a: [u8; 4], b: [u8; 4]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 1);
    for (order, front_to_back) in [
        (&[0, 1, 2, 3][..], &[2, 3, 1, 0][..]),
        (&[2, 0, 3, 1], &[2, 3, 1, 0]),
        (&[3, 1, 0, 2], &[3, 2, 1, 0]),
        (&[1, 3], &[3, 1]),
        (&[1], &[1]),
    ] {
        let found = middle(order, 1);
        assert!(near(found, expected(front_to_back)), "{order:?}: {found:?} {:?}", expected(front_to_back));
        assert_eq!(middle(order, 3), found);
    }
}

#[test]
fn a_transparent_surface_shows_what_is_inside_and_throws_no_shadow() {
    let (outer, inner) = (sphere(30, true), sphere(12, true));
    let inner = TriMesh {
        vertices: inner
            .vertices
            .iter()
            .map(|v| Vertex { position: v.position.map(|c| c / 2.0), ..*v })
            .collect(),
        ..inner
    };
    let view = View::fit(&Camera::default(), &[&outer], [90, 80]).unwrap();
    let [red, blue] = [[220, 30, 30], [30, 30, 220]].map(Paint::Plain);
    let drawn = |opacity: f32, threads: usize, more: u64| {
        let glass = Subject { opacity, ..of(&outer, blue) };
        let memory = needed([90, 80], &settings(1), opacity < 1.0) + more;
        let resources = settings(threads).resources.with_memory(memory);
        render(&[glass, of(&inner, red)], &view, &RenderSettings { resources, ..settings(1) })
    };
    let at = |image: &Image, x: usize| image.pixels[40 * 90 + x];
    let glass = drawn(0.3, 2, 1 << 20).unwrap();
    assert_eq!(drawn(0.3, 1, 0).unwrap(), glass, "threads and memory do not show");
    let middle = at(&glass, 45);
    assert!(middle[0] > middle[2] + 40, "red is seen through blue: {middle:?}");
    let opaque = at(&drawn(1.0, 1, 0).unwrap(), 45);
    assert!(opaque[2] > opaque[0] + 40, "{opaque:?}");
    let alone = render(&[of(&inner, red)], &view, &settings(1)).unwrap();
    // Two layers at 0.3 lie in front; without a shadow, half of the red arrives.
    assert!(u32::from(middle[0]) * 2 > u32::from(at(&alone, 45)[0]), "{middle:?}");
    assert!(glass.pixels[0] == [255; 4] && glass.pixels.iter().all(|p| p[3] == 255));
    for wrong in [0.0, -0.5, 1.5, f32::NAN] {
        assert_eq!(drawn(wrong, 1, 0).unwrap_err().exit_code(), 2, "{wrong}");
    }
}

#[test]
fn views_of_a_turn_have_one_scale_and_leave_nothing_out() {
    let mut bar = sphere(12, true);
    bar.vertices.iter_mut().for_each(|v| v.position[0] *= 4.0);
    let cameras: Vec<Camera> =
        (0..8).map(|n| Camera { azimuth: f64::from(n) * 45.0, ..Camera::default() }).collect();
    let views = View::fit_all(&cameras, &[&bar], [90, 80]).unwrap();
    assert!(views.iter().all(|v| v.pixel() == views[0].pixel()));
    for view in &views {
        let image = render(&[of(&bar, GREY)], view, &settings(1)).unwrap();
        let rim = (0..90).flat_map(|x| [(x, 0), (x, 79)]).chain((0..80).flat_map(|y| [(0, y), (89, y)]));
        assert!(rim.into_iter().all(|(x, y)| image.pixels[y * 90 + x] == [255; 4]));
    }
    // Seen along its axis, the bar is a disc of radius 1: a known length.
    let end = Camera { azimuth: 0.0, elevation: 0.0, perspective: false, ..Camera::default() };
    let pixel = View::fit(&end, &[&bar], [90, 80]).unwrap().pixel();
    assert!((pixel - 2.0 / (0.94 * 80.0)).abs() < 1e-4, "{pixel}");
}
