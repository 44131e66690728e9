//! Meshes that are kept as they are: their own vertices and tetrahedra, with no error in any
//! answer.

use crate::common::{
    self, addition, check_archive, folder, measurement, query, reduce_in_shards, run, triangle_set,
    write_mesh, write_placed,
};
use isospan::exec::Silent;
use isospan::formats::samples::SampleFormat;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{
    self, Amount, ExportSettings, NanPolicy, ReduceReport, ReduceSettings, Roi, RunSettings, reduce_series,
};
use isospan::points::SetKind;
use isospan::sample::Interpolation;
use isospan::surface::TriMesh;
use isospan::surface::check::check;
use isospan::{Archive, Resources};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn whole(chunk_points: u64) -> ReduceSettings {
    ReduceSettings { amount: Amount::Fraction(1.0), chunk_points, ..ReduceSettings::default() }
}

fn again(threads: usize) -> RunSettings {
    RunSettings { replace: true, ..run(threads) }
}

fn kept(input: &Path, settings: &ReduceSettings, out: &str, run: &RunSettings) -> (PathBuf, ReduceReport) {
    let out = input.with_file_name(out);
    let report =
        reduce_series(&[StepSource::new(input, &OpenOptions::default())], settings, &out, run, &Silent)
            .unwrap();
    assert!(report.own);
    check_archive(&out).unwrap();
    (out, report)
}

fn extracted(archive: &Path, isovalue: f64, threads: usize) -> TriMesh {
    query(archive, isovalue).resources(Resources::default().with_threads(threads)).mesh().unwrap()
}

/// A mesh as its file gives it.
#[derive(Default)]
struct Mesh {
    points: Vec<[f64; 3]>,
    values: Vec<f64>,
    tets: Vec<[usize; 4]>,
}

impl Mesh {
    /// Reads what [`write_mesh`] has written.
    fn read(path: &Path) -> Self {
        let text = std::fs::read_to_string(path).unwrap();
        let mut words = text.split_ascii_whitespace();
        words.find(|w| *w == "POINTS").unwrap();
        let count: usize = words.next().unwrap().parse().unwrap();
        words.next();
        let numbers: Vec<f64> = words.by_ref().take(3 * count).map(|w| w.parse().unwrap()).collect();
        let points = numbers.chunks(3).map(|p| [p[0], p[1], p[2]]).collect();
        let cells: usize = words.by_ref().nth(1).unwrap().parse().unwrap();
        words.next();
        let ids: Vec<usize> = words.by_ref().take(5 * cells).map(|w| w.parse().unwrap()).collect();
        let tets = ids.chunks(5).map(|t| [t[1], t[2], t[3], t[4]]).collect();
        words.find(|w| *w == "default").unwrap();
        let values = words.map(|w| w.parse().unwrap()).collect();
        Self { points, values, tets }
    }

    fn write(&self, path: &Path) {
        let mut text = "# vtk DataFile Version 3.0\nmesh\nASCII\nDATASET UNSTRUCTURED_GRID\n".to_owned();
        writeln!(text, "POINTS {} double", self.points.len()).unwrap();
        self.points.iter().for_each(|[x, y, z]| writeln!(text, "{x} {y} {z}").unwrap());
        writeln!(text, "CELLS {} {}", self.tets.len(), 5 * self.tets.len()).unwrap();
        self.tets.iter().for_each(|[a, b, c, d]| writeln!(text, "4 {a} {b} {c} {d}").unwrap());
        writeln!(text, "CELL_TYPES {}", self.tets.len()).unwrap();
        self.tets.iter().for_each(|_| text.push_str("10\n"));
        writeln!(text, "POINT_DATA {}\nSCALARS f double\nLOOKUP_TABLE default", self.points.len()).unwrap();
        self.values.iter().for_each(|v| writeln!(text, "{v}").unwrap());
        std::fs::write(path, text).unwrap();
    }

    fn add(&mut self, points: &[[f64; 3]], values: &[f64]) -> usize {
        let first = self.points.len();
        self.points.extend_from_slice(points);
        self.values.extend_from_slice(values);
        first
    }

    /// Marching tetrahedra in a few lines: triangles, area, vertices - edges + triangles. A vertex
    /// at which several fans of triangles meet counts once for each, as surfaces have it.
    fn contour(&self, isovalue: f64) -> (u64, f64, i64) {
        let mut triangles: Vec<[[usize; 2]; 3]> = vec![];
        for tet in &self.tets {
            let (inside, outside): (Vec<usize>, Vec<usize>) =
                tet.iter().partition(|&&v| self.values[v] >= isovalue);
            // The corners of the section in turn, each on an edge of the tetrahedron.
            let corners: Vec<[usize; 2]> = match (&inside[..], &outside[..]) {
                ([], _) | (_, []) => continue,
                (&[a], others) | (others, &[a]) => others.iter().map(|&b| [a.min(b), a.max(b)]).collect(),
                (&[a, b], &[c, d]) => {
                    [[a, c], [c, b], [b, d], [d, a]].map(|[a, b]| [a.min(b), a.max(b)]).to_vec()
                }
                _ => unreachable!("a tetrahedron has four corners"),
            };
            triangles.extend((2..corners.len()).map(|k| [corners[0], corners[k - 1], corners[k]]));
        }
        let (mut area, mut edges) = (0.0, BTreeSet::new());
        let mut around: BTreeMap<[usize; 2], Vec<[[usize; 2]; 2]>> = BTreeMap::new();
        for t in &triangles {
            area += triangle_area(t.map(|corner| self.crossing(corner, isovalue)));
            for k in 0..3 {
                let [a, b, c] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
                edges.insert([a.min(b), a.max(b)]);
                around.entry(a).or_default().push([b, c]);
            }
        }
        let vertices: usize = around.values().map(|sides| fans(sides)).sum();
        (triangles.len() as u64, area, vertices as i64 - edges.len() as i64 + triangles.len() as i64)
    }

    fn crossing(&self, [a, b]: [usize; 2], isovalue: f64) -> [f64; 3] {
        let t = (isovalue - self.values[a]) / (self.values[b] - self.values[a]);
        std::array::from_fn(|k| self.points[a][k] + t * (self.points[b][k] - self.points[a][k]))
    }
}

/// How many fans triangles form around a vertex, given their sides opposite to it.
fn fans(sides: &[[[usize; 2]; 2]]) -> usize {
    let mut left = sides.to_vec();
    let mut count = 0;
    while let Some(first) = left.pop() {
        let mut fan: BTreeSet<[usize; 2]> = first.into();
        loop {
            let before = left.len();
            left.retain(|side| {
                let joins = side.iter().any(|end| fan.contains(end));
                if joins {
                    fan.extend(side);
                }
                !joins
            });
            if left.len() == before {
                break;
            }
        }
        count += 1;
    }
    count
}

fn triangle_area([a, b, c]: [[f64; 3]; 3]) -> f64 {
    let (u, v): ([f64; 3], [f64; 3]) =
        (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    0.5 * n.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// The surface of an archive is the contour of a mesh.
fn expect_contour(mesh: &Mesh, archive: &Path, isovalue: f64, what: &str) -> TriMesh {
    let (triangles, area, euler) = mesh.contour(isovalue);
    let surface = extracted(archive, isovalue, 2);
    let found = check(&surface);
    assert!(found.is_oriented(), "{what} at {isovalue}: {found:?}");
    assert_eq!((found.triangles, found.euler), (triangles, euler), "{what} at {isovalue}: {found:?}");
    // A vertex stays off the ends of its edge by 1/1024 of it.
    assert!((found.area - area).abs() <= 1e-4 * area, "{what} at {isovalue}: {} for {area}", found.area);
    let active = Archive::open(archive).unwrap().count(isovalue).unwrap().active_cells;
    let is_active = |t: &&[usize; 4]| {
        let inside = t.iter().filter(|&&v| mesh.values[v] >= isovalue).count();
        inside > 0 && inside < 4
    };
    assert_eq!(active, mesh.tets.iter().filter(is_active).count() as u64, "{what} at {isovalue}");
    surface
}

/// Flat-walled, thin, hollow and curved domains; several bodies.
fn shapes(dir: &Path) -> Vec<(&'static str, PathBuf)> {
    let radius = |p: [f64; 3]| p.iter().map(|c| (c - 0.5) * (c - 0.5)).sum::<f64>().sqrt();
    let field = |[x, y, z]: [f64; 3]| x + 0.3 * (4.0 * y).sin() + 0.2 * (3.0 * z).cos();
    let path = |name: &'static str| (name, dir.join(format!("{name}.vtk")));
    let all = vec![path("box"), path("ell"), path("plate"), path("shell"), path("two bodies")];
    write_mesh(&all[0].1, 14, |_| true, |p| p, field);
    write_mesh(&all[1].1, 18, |[x, y, _]| x < 0.5 || y < 0.5, |p| p, field);
    write_mesh(&all[2].1, 14, |_| true, |[x, y, z]| [x, y, 0.01 * z + 7.0], field);
    write_mesh(&all[3].1, 22, move |p| (0.3..0.45).contains(&radius(p)), |p| p, field);
    write_mesh(&all[4].1, 16, |p| (p[0] - 0.5).abs() > 0.15, |p| p, field);
    all
}

#[test]
fn surfaces_are_those_of_the_mesh_in_any_number_of_chunks() {
    let dir = tempfile::tempdir().unwrap();
    for (name, input) in shapes(dir.path()) {
        let mesh = Mesh::read(&input);
        let mut sets = vec![];
        for (chunk_points, least) in [(250_000, 1), (100, 2)] {
            let (archive, report) = kept(&input, &whole(chunk_points), "kept.isospan", &again(2));
            assert!(report.chunks >= least, "{name}: {} chunks", report.chunks);
            assert_eq!((report.points, report.void_points), (mesh.points.len() as u64, 0), "{name}");
            assert_eq!(report.tetrahedra, mesh.tets.len() as u64, "{name}");
            let e = report.error.as_ref().unwrap();
            assert_eq!((e.samples, e.measured, e.beyond), (report.samples, report.samples, 0), "{name}");
            assert!(e.rms == 0.0 && e.max == 0.0, "{name}: {e:?}");
            for isovalue in [0.31, 0.7] {
                let surface = expect_contour(&mesh, &archive, isovalue, name);
                if isovalue == 0.7 {
                    sets.push(triangle_set(&surface));
                }
            }
            let open = Archive::open(&archive).unwrap();
            let values = open.probe(&mesh.points).unwrap();
            let off = values.iter().zip(&mesh.values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(values.iter().all(|v| v.is_finite()) && off < 1e-5, "{name}: {off}");
            assert!(open.probe(&[[0.5, 0.5, -0.01], [1.5, 0.5, 0.5]]).unwrap().iter().all(|v| v.is_nan()));
        }
        assert_eq!(sets[0], sets[1], "{name}: the same triangles from any chunks");
    }
}

/// A surface in a tetrahedron that spans many chunks whose points are elsewhere.
#[test]
fn a_long_tetrahedron_is_found_wherever_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("long.vtk");
    write_mesh(&input, 18, |_| true, |p| p, |p| p[0]);
    let mut mesh = Mesh::read(&input);
    for (from, to) in [([-0.4, 1.1, 0.5], [1.9, 1.1, 0.5]), ([1.2, -0.3, -0.4], [1.3, 1.6, 1.7])] {
        let near = |p: [f64; 3], k: usize| std::array::from_fn(|a| p[a] + if a == k { 0.05 } else { 0.0 });
        let first = mesh.add(&[from, to, near(to, 1), near(from, 2)], &[100.0, 200.0, 200.0, 100.0]);
        mesh.tets.push([first, first + 1, first + 2, first + 3]);
    }
    mesh.write(&input);
    let (archive, report) = kept(&input, &whole(100), "long.isospan", &run(2));
    assert!(report.chunks > 4, "{}", report.chunks);
    assert_eq!(report.mesh.unwrap().bodies, 3);
    expect_contour(&mesh, &archive, 0.45, "the cube");
    for (at, x) in [(123.0, 0.23), (150.0, 0.5), (177.0, 0.77)] {
        let surface = expect_contour(&mesh, &archive, at, "the slivers");
        // The middle of each section.
        for (place, triangles) in [
            ([-0.4 + 2.3 * x, 1.1 + 0.025 * x, 0.5 + 0.025 * (1.0 - x)], 2),
            ([1.2 + 0.1 * x, -0.3 + 1.9 * x + 0.025 * x, -0.4 + 2.1 * x + 0.025 * (1.0 - x)], 2),
        ] {
            let around: Vec<String> = place.iter().map(|c| format!("{}:{}", c - 0.06, c + 0.06)).collect();
            let region: Roi = format!("world:{}", around.join(",")).parse().unwrap();
            let resources = Resources::default().with_threads(2);
            let cut = query(&archive, at).region(region).resources(resources).mesh().unwrap();
            assert!(
                cut.triangles.len() >= triangles,
                "{at}: {place:?} of {} triangles",
                surface.triangles.len()
            );
            let value = Archive::open(&archive).unwrap().probe(&[place]).unwrap()[0];
            assert!((value - at).abs() < 0.1, "{value} at {place:?}");
        }
    }
    // Of tetrahedra that touch a box in the middle of nowhere, the one that does is exported.
    let settings = ExportSettings {
        roi: Some("world:0.4:0.6,1.05:1.2,0.45:0.6".parse().unwrap()),
        ..ExportSettings::default()
    };
    let report =
        Archive::open(&archive).unwrap().write_tetrahedra(&settings, &dir.path().join("one.vtu"), &Silent);
    assert_eq!(report.unwrap().tetrahedra, 1);
}

/// Vertices of bodies that touch share positions, and stay different points.
#[test]
fn bodies_that_touch_keep_their_own_vertices() {
    let dir = tempfile::tempdir().unwrap();
    let keep = |p: [f64; 3]| (p[0] - 0.5).abs() > 0.5 / 9.0;
    let closed =
        |[x, y, z]: [f64; 3]| [if x < 0.5 { x * 9.0 / 8.0 } else { 1.0 - (1.0 - x) * 9.0 / 8.0 }, y, z];
    let input = dir.path().join("jump.vtk");
    write_placed(&input, 9, keep, |p| (closed(p), if p[0] > 0.5 { p[2] + 10.0 } else { p[2] }));
    let mesh = Mesh::read(&input);
    for chunk_points in [250_000, 100] {
        let (archive, report) = kept(&input, &whole(chunk_points), "jump.isospan", &again(2));
        assert_eq!((report.mesh.unwrap().bodies, report.points), (2, mesh.points.len() as u64));
        assert_eq!(report.error.unwrap().max, 0.0, "no vertex is taken for the other one of its place");
        for isovalue in [0.45, 5.0, 10.45] {
            expect_contour(&mesh, &archive, isovalue, "two bodies");
        }
    }
    // Where values agree, vertices of one place are one.
    let input = dir.path().join("smooth.vtk");
    write_placed(&input, 9, keep, |p| (closed(p), p[2]));
    let (archive, report) = kept(&input, &whole(100), "smooth.isospan", &run(2));
    let census = report.mesh.unwrap();
    assert_eq!((census.bodies, census.repeated, report.points), (1, 100, report.samples - 100));
    assert_eq!(report.error.unwrap().measured, report.samples);
    let found = check(&extracted(&archive, 0.45, 2));
    assert!(found.is_manifold() && found.components == 1 && (found.area - 1.0).abs() < 1e-6, "{found:?}");
}

/// Bodies that overlap, and cells of each in the other: each has its surface; where both have a
/// sample, the first has it for any threads.
#[test]
fn bodies_that_overlap_are_both_there() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("overlap.vtk");
    let keep = |p: [f64; 3]| (p[0] - 0.5).abs() > 0.5 / 17.0;
    let shifted = |[x, y, z]: [f64; 3]| if x < 0.5 { [x + 0.3, y, z] } else { [x, y + 0.01, z] };
    write_placed(&input, 17, keep, |p| (shifted(p), if p[0] > 0.5 { p[2] + 10.0 } else { p[2] }));
    let mesh = Mesh::read(&input);
    let (archive, report) = kept(&input, &whole(100), "overlap.isospan", &run(2));
    assert!(report.chunks > 2 && report.mesh.unwrap().bodies == 2);
    expect_contour(&mesh, &archive, 0.45, "overlap");
    expect_contour(&mesh, &archive, 10.45, "overlap");
    let open = Archive::open(&archive).unwrap();
    let mut grids = vec![];
    for threads in [1, 2, 5] {
        let out = dir.path().join(format!("{threads}.npy"));
        let settings =
            pipeline::ProbeSettings { resources: Resources::default().with_threads(threads), level: None };
        let report = open.write_samples([31, 30, 29], &settings, &out, SampleFormat::Npy, &Silent).unwrap();
        let bytes = std::fs::read(&out).unwrap();
        let values = &bytes[bytes.len() - 4 * 31 * 30 * 29..];
        let nan = values.chunks(4).filter(|v| f32::from_le_bytes([v[0], v[1], v[2], v[3]]).is_nan()).count();
        assert_eq!(report.void, nan as u64, "samples without a value are counted once");
        assert!(nan > 0 && nan < 31 * 30 * 29 / 2, "{nan}");
        grids.push(bytes);
    }
    assert!(grids[0] == grids[1] && grids[0] == grids[2]);
    let points: Vec<[f64; 3]> = (0..50).map(|i| [0.6, 0.02 * f64::from(i), 0.37]).collect();
    assert_eq!(format!("{:?}", open.probe(&points)), format!("{:?}", open.probe(&points)));
}

/// Complexes that no Delaunay mesh has: thousands of tetrahedra at an edge, tetrahedra that share
/// an edge or a vertex alone.
#[test]
fn any_complex_of_tetrahedra_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let mut mesh = Mesh::default();
    let n = 5000;
    let axis = mesh.add(&[[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], &[-1.0, 1.0]);
    let ring: Vec<[f64; 3]> = (0..n)
        .map(|i| {
            let angle = f64::from(i) * std::f64::consts::TAU / f64::from(n);
            [angle.cos(), angle.sin(), 0.3 * (3.0 * angle).sin()]
        })
        .collect();
    let values: Vec<f64> = (0..n).map(|i| f64::from(i % 7) / 7.0 - 0.4).collect();
    let first = mesh.add(&ring, &values);
    mesh.tets.extend((0..n as usize).map(|i| [axis, axis + 1, first + i, first + (i + 1) % n as usize]));
    // Two that share an edge alone; one more at a vertex of it.
    let more = mesh.add(
        &[
            [3.0, 0.0, 0.0],
            [3.0, 0.0, 1.0],
            [4.0, 0.1, 0.0],
            [4.0, -0.1, 0.5],
            [2.0, 0.1, 0.0],
            [2.0, -0.1, 0.5],
        ],
        &[0.1, 0.9, -0.3, 0.4, 0.2, -0.7],
    );
    mesh.tets.extend([[0, 1, 2, 3], [0, 1, 4, 5]].map(|t: [usize; 4]| t.map(|v| more + v)));
    let tip = mesh.add(&[[3.0, 0.2, -1.0], [3.2, 0.0, -1.0], [2.9, -0.2, -1.1]], &[0.6, -0.6, -0.2]);
    mesh.tets.push([more, tip, tip + 1, tip + 2]);
    let input = dir.path().join("fan.vtk");
    mesh.write(&input);
    for chunk_points in [250_000, 100] {
        let (archive, report) = kept(&input, &whole(chunk_points), "fan.isospan", &again(2));
        assert_eq!(report.tetrahedra, mesh.tets.len() as u64);
        for isovalue in [-0.35, 0.05, 0.5] {
            expect_contour(&mesh, &archive, isovalue, "fan");
        }
    }
}

#[test]
fn the_same_bytes_however_the_work_is_done() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.vtk");
    let radius = |p: [f64; 3]| p.iter().map(|c| (c - 0.5) * (c - 0.5)).sum::<f64>().sqrt();
    let keep = |p: [f64; 3]| (0.25..0.5).contains(&radius(p));
    write_mesh(&input, 24, keep, |[x, y, z]| [x * x, y, z], |p| radius(p) + 0.05 * (9.0 * p[0]).sin());
    let settings = whole(100);
    let (one, report) = kept(&input, &settings, "one.isospan", &run(1));
    assert!(report.chunks > 4);
    let small = RunSettings { resources: run(2).resources.with_memory(64 << 20), ..run(2) };
    let (two, _) = kept(&input, &settings, "two.isospan", &small);
    assert!(folder(&one) == folder(&two), "threads and memory");
    let shards = dir.path().join("shards.isospan");
    reduce_in_shards(&input, &settings, &shards);
    assert!(folder(&one) == folder(&shards), "shards");
    let (counted, _) = kept(
        &input,
        &ReduceSettings { amount: Amount::Count(u64::MAX >> 8), ..whole(100) },
        "count.isospan",
        &run(2),
    );
    assert!(folder(&one) == folder(&counted), "a count of all vertices or more");
    // Finished before; and made again where a file is lost.
    let report =
        reduce_series(&[StepSource::new(&input, &OpenOptions::default())], &settings, &one, &run(1), &Silent)
            .unwrap();
    assert!(report.made_before && report.own);
    std::fs::remove_file(two.join("mesh/points.seg")).unwrap();
    kept(&input, &settings, "two.isospan", &run(1));
    assert!(folder(&one) == folder(&two), "repaired");
    check_archive(&one).unwrap();
    // Surfaces: any threads.
    let surface = triangle_set(&extracted(&one, 0.4, 1));
    assert_eq!(triangle_set(&extracted(&one, 0.4, 4)), surface);
}

#[test]
fn steps_are_added_to_a_mesh_that_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let keep = |p: [f64; 3]| (p[0] - 0.5).abs() > 0.5 / 9.0;
    let closed =
        |[x, y, z]: [f64; 3]| [if x < 0.5 { x * 9.0 / 8.0 } else { 1.0 - (1.0 - x) * 9.0 / 8.0 }, y, z];
    let step = |n: u32| {
        let path = dir.path().join(format!("s{n}.vtk"));
        let t = f64::from(n);
        write_placed(&path, 9, keep, |p| {
            (closed(p), (1.0 + 0.1 * t) * p[2] + if p[0] > 0.5 { 10.0 } else { 0.0 })
        });
        StepSource::new(&path, &OpenOptions::default())
    };
    let steps: Vec<StepSource> = (0..4).map(step).collect();
    let out = |name: &str| dir.path().join(name);
    let all = reduce_series(&steps, &whole(100), &out("all.isospan"), &run(2), &Silent).unwrap();
    assert!(all.own && all.steps.len() == 4 && all.steps.iter().all(|s| s.error == Some([0.0, 0.0])));
    reduce_series(&steps[..2], &whole(100), &out("grown.isospan"), &run(1), &Silent).unwrap();
    for step in &steps[2..] {
        let one = std::slice::from_ref(step);
        let report = addition(one, &run(2)).append_to(out("grown.isospan")).unwrap();
        assert!(report.own);
    }
    assert!(folder(&out("all.isospan")) == folder(&out("grown.isospan")));
    check_archive(&out("all.isospan")).unwrap();
    for (n, source) in steps.iter().enumerate() {
        let mesh = Mesh::read(&source.path);
        let step = Archive::open(out("all.isospan")).unwrap().step(n as u64).unwrap();
        let found = check(&step.surface(0.43).unwrap());
        let (triangles, area, euler) = mesh.contour(0.43);
        assert_eq!((found.triangles, found.euler), (triangles, euler), "step {n}");
        assert!((found.area - area).abs() < 1e-6, "step {n}");
        let told = measurement(&out("all.isospan"), &source.path).step(n as u64).run().unwrap();
        assert!(told.same_source && told.error.max == 0.0 && told.error.measured == all.samples, "step {n}");
    }
    // Another mesh is no step.
    let other = dir.path().join("other.vtk");
    write_placed(&other, 9, keep, |p| (closed(p).map(|c| c * c), p[2]));
    let other = StepSource::new(&other, &OpenOptions::default());
    let e = addition(&[other], &run(2)).append_to(out("grown.isospan")).unwrap_err();
    assert_eq!(e.exit_code(), 5, "{e}");
}

/// Steps that lie in one file are those of one mesh, and all containers of it give one archive's
/// answers.
#[test]
fn steps_of_a_variable_are_a_series_on_one_mesh() {
    let dir = tempfile::tempdir().unwrap();
    let data = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("tests/data");
    let heat = OpenOptions { field: Some("heat".into()), ..OpenOptions::default() };
    let mut areas = vec![];
    for (number, name) in ["exodus/row.exo", "exodus/row_cdf5.g", "exodus/row_packed.exo", "ensight/big.case"]
        .into_iter()
        .enumerate()
    {
        let steps = isospan::formats::steps_of(&[data.join(name)], &heat).unwrap();
        assert_eq!(steps.iter().map(|s| s.time).collect::<Vec<_>>(), [0.5, 1.5, 4.0].map(Some));
        let out = dir.path().join(format!("{number}.isospan"));
        let report = reduce_series(&steps, &whole(1000), &out, &run(2), &Silent).unwrap();
        check_archive(&out).unwrap();
        assert!(report.own && report.points == 12, "{name}: parts of one mesh are joined");
        for step in 0..3u32 {
            // Each step is the one before and 1000 more: the surface stays where it is.
            let archive = Archive::open(&out).unwrap();
            let mesh = archive.step(step.into()).unwrap().surface(50.5 + 1000.0 * f64::from(step)).unwrap();
            let place = |v: u32| mesh.vertices[v as usize].position.map(f64::from);
            areas.push(mesh.triangles.iter().map(|t| triangle_area(t.map(place))).sum::<f64>());
        }
    }
    assert!(areas[0] > 1.0 && areas.iter().all(|a| (a - areas[0]).abs() < 1e-4), "{areas:?}");
}

#[test]
fn errors_are_those_of_rounded_values_alone() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ell.vtk");
    write_mesh(&input, 9, |[x, y, _]| x < 0.5 || y < 0.5, |p| p, |[x, y, z]| (4.0 * x).sin() + y * y + z);
    let settings = ReduceSettings { value_bits: Some(8.0), ..whole(100) };
    let (out, report) = kept(&input, &settings, "ell.isospan", &run(2));
    let (e, bound) = (report.error.unwrap(), report.quantiser.unwrap().bound);
    assert!(e.rms > 0.0 && e.max <= bound * 1.000_001 && e.max > bound / 4.0, "{e:?} {bound}");
    let map = dir.path().join("map.vti");
    let one = Resources::default().with_threads(1);
    let told = measurement(&out, &input).map(map.clone()).resources(one).run().unwrap();
    assert!(told.same_source && told.error == e && map.exists());
    // The field of another file with as many vertices that are elsewhere is no original.
    let other = dir.path().join("other.vtk");
    write_mesh(&other, 9, |[x, y, _]| x < 0.5 || y < 0.5, |[x, y, z]| [x, y * y, z], |p| p[0]);
    let e = measurement(&out, &other).run().unwrap_err();
    assert!(e.exit_code() == 5 && e.to_string().contains("a mesh with others"), "{e}");
}

#[test]
fn vertices_without_a_value_or_a_tetrahedron() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("nan.vtk");
    write_mesh(&input, 8, |_| true, |p| p, |p| if p[0] > 0.8 { f64::NAN } else { p[1] });
    let mut mesh = Mesh::read(&input);
    mesh.add(&[[0.5, 0.5, 0.5], [1.0, 1.0, 1.0]], &[7.0, 8.0]);
    mesh.write(&input);
    let masked = ReduceSettings { nan: NanPolicy::Mask, ..whole(100) };
    let (archive, report) = kept(&input, &masked, "masked.isospan", &run(2));
    assert_eq!((report.points, report.samples), (9 * 9 * 9, 9 * 9 * 9 + 2));
    assert_eq!(report.void_points, 2 * 9 * 9);
    let e = report.error.unwrap();
    assert_eq!((e.measured, e.max), (7 * 9 * 9, 0.0));
    mesh.tets.retain(|t| t.iter().all(|&v| mesh.values[v].is_finite()));
    expect_contour(&mesh, &archive, 0.52, "holes");
}

#[test]
fn what_is_asked_for_decides_what_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("box.vtk");
    write_mesh(&input, 7, |_| true, |p| p, |p| p[0] * p[1]);
    let vertices = 8 * 8 * 8;
    let with = |amount| ReduceSettings { amount, ..ReduceSettings::default() };
    let of = |settings: &ReduceSettings| {
        let out = dir.path().join("m.isospan");
        reduce_series(&[StepSource::new(&input, &OpenOptions::default())], settings, &out, &again(2), &Silent)
            .unwrap()
            .own
    };
    assert!(of(&with(Amount::Count(vertices))) && of(&with(Amount::Count(vertices + 1))));
    assert!(!of(&with(Amount::Count(vertices - 1))) && !of(&with(Amount::Fraction(0.99))));
    assert!(!of(&with(Amount::Fraction(1.5))), "more points than vertices");
    assert!(!of(&ReduceSettings { points: Some(SetKind::Halton), ..whole(1000) }));
    assert!(!of(&ReduceSettings { interpolation: Interpolation::Quadratic, ..whole(1000) }));
    let adapted = ReduceSettings { points: Some(SetKind::Halton), adapt: true, ..whole(1000) };
    assert!(!of(&adapted));
}

#[test]
fn what_the_lattice_cannot_hold_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("thin.vtk");
    write_mesh(&input, 4, |_| true, |p| p, |p| p[0]);
    let mut mesh = Mesh::read(&input);
    // A corner 1e-9 above the others: flat in the archive, not in the file.
    let first = mesh.add(
        &[[0.1, 0.1, 2.0], [0.5, 0.1, 2.0], [0.1, 0.5, 2.0], [0.2, 0.2, 2.0 + 1e-9]],
        &[0.0, 1.0, 2.0, 3.0],
    );
    mesh.tets.push([first, first + 1, first + 2, first + 3]);
    mesh.write(&input);
    let out = dir.path().join("thin.isospan");
    let e = reduce_series(
        &[StepSource::new(&input, &OpenOptions::default())],
        &whole(1000),
        &out,
        &run(2),
        &Silent,
    )
    .unwrap_err();
    let text = e.to_string();
    assert!(e.exit_code() == 5 && text.contains("thin.vtk: tetrahedra") && !text.contains('\n'), "{text}");
    assert!(text.contains("1 that would not") && text.contains("0.99") && !out.exists(), "{text}");
    let sampled = ReduceSettings { amount: Amount::Fraction(0.99), ..ReduceSettings::default() };
    reduce_series(&[StepSource::new(&input, &OpenOptions::default())], &sampled, &out, &run(2), &Silent)
        .unwrap();
    // One that is flat in the file has no volume to keep: it is counted, and the rest is kept.
    mesh.points[first + 3][2] = 2.0;
    let solid = mesh.add(&[[0.1, 0.1, 2.5]], &[4.0]);
    mesh.tets.push([first, first + 1, first + 2, solid]);
    mesh.write(&input);
    let (archive, report) = kept(&input, &whole(1000), "flat.isospan", &run(2));
    assert_eq!(report.mesh.unwrap().degenerate, 1);
    mesh.tets.remove(mesh.tets.len() - 2);
    expect_contour(&mesh, &archive, 1.5, "flat");
}

/// Cells of other kinds are kept as the tetrahedra that they are split into.
#[test]
fn hexahedra_are_kept_as_tetrahedra() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("hex.vtu");
    common::write_hexahedra(&input, |x, y, z| x * x + y - z);
    let (archive, report) = kept(&input, &whole(100), "hex.isospan", &run(2));
    assert_eq!((report.points, report.tetrahedra), (1056, 4500));
    assert_eq!(report.error.unwrap().max, 0.0);
    let found = check(&extracted(&archive, 0.31, 2));
    assert!(found.is_manifold() && found.is_oriented() && found.triangles > 100, "{found:?}");
}

/// Cells that are pushed through their neighbours would turn parts of a surface the other way.
#[test]
fn cells_that_fold_over_others_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("crushed.vtk");
    let is_inner = |x: f64| x > 0.3 && x < 0.7;
    let place = |p: [f64; 3]| {
        let is_pushed = (p[0] - 0.4).abs() < 0.01 && is_inner(p[1]) && is_inner(p[2]);
        (if is_pushed { [0.75, p[1], p[2]] } else { p }, p[1] + 0.3 * p[2])
    };
    write_placed(&input, 5, |_| true, place);
    for chunk_points in [1000, 100] {
        let (archive, report) = kept(&input, &whole(chunk_points), "crushed.isospan", &again(2));
        let census = report.mesh.unwrap();
        assert!(census.folded > 6 && census.tetrahedra + census.folded == 750, "{census:?}");
        for isovalue in [0.4, 0.55, 0.7] {
            let found = check(&extracted(&archive, isovalue, 2));
            assert!(found.is_manifold() && found.is_oriented() && found.triangles > 50, "{found:?}");
        }
    }
    // Cells that a file lists one way or the other are turned, and all are kept.
    write_mesh(&input, 5, |_| true, |p| p, |p| p[1]);
    let text = std::fs::read_to_string(&input).unwrap();
    let mut is_other = false;
    let turned: Vec<String> = text
        .lines()
        .map(|line| match line.split_ascii_whitespace().collect::<Vec<_>>()[..] {
            ["4", a, b, c, d] => {
                is_other = !is_other;
                if is_other { format!("4 {a} {b} {d} {c}") } else { line.to_owned() }
            }
            _ => line.to_owned(),
        })
        .collect();
    std::fs::write(&input, turned.join("\n") + "\n").unwrap();
    let census = kept(&input, &whole(1000), "turned.isospan", &run(2)).1.mesh.unwrap();
    assert!(census.folded == 0 && census.inverted > 100 && census.tetrahedra == 750, "{census:?}");
}

/// A legacy VTK file of tetrahedra with a value for each.
fn write_cells(path: &Path, points: &[[f64; 3]], tets: &[[usize; 4]], values: &[f64]) {
    let mut text = format!(
        "# vtk DataFile Version 3.0\ncells\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {} double\n",
        points.len()
    );
    points.iter().for_each(|[x, y, z]| writeln!(text, "{x} {y} {z}").unwrap());
    writeln!(text, "CELLS {} {}", tets.len(), 5 * tets.len()).unwrap();
    tets.iter().for_each(|[a, b, c, d]| writeln!(text, "4 {a} {b} {c} {d}").unwrap());
    write!(text, "CELL_TYPES {}\n{}", tets.len(), "10\n".repeat(tets.len())).unwrap();
    writeln!(text, "CELL_DATA {}\nSCALARS f double 1\nLOOKUP_TABLE default", tets.len()).unwrap();
    values.iter().for_each(|v| writeln!(text, "{v}").unwrap());
    std::fs::write(path, text).unwrap();
}

/// Values of cells are averaged around a place, also where each piece of a mesh has a point there.
#[test]
fn cells_of_two_pieces_are_averaged_together() {
    let dir = tempfile::tempdir().unwrap();
    let [plain, whole_file, pieces] = ["plain.vtk", "whole.vtk", "pieces.vtk"].map(|n| dir.path().join(n));
    write_mesh(&plain, 6, |_| true, |p| p, |p| p[0]);
    let mesh = Mesh::read(&plain);
    let centre = |tet: &[usize; 4], a: usize| tet.iter().map(|&v| mesh.points[v][a]).sum::<f64>() / 4.0;
    let values: Vec<f64> = mesh.tets.iter().map(|t| centre(t, 0) + 0.2 * centre(t, 1)).collect();
    write_cells(&whole_file, &mesh.points, &mesh.tets, &values);
    let mut numbers = BTreeMap::new();
    let mut points = vec![];
    let of_piece = |tet: &[usize; 4]| {
        let piece = centre(tet, 0) > 0.5;
        tet.map(|v| {
            *numbers.entry((piece, v)).or_insert_with(|| {
                points.push(mesh.points[v]);
                points.len() - 1
            })
        })
    };
    let tets: Vec<[usize; 4]> = mesh.tets.iter().map(of_piece).collect();
    assert_eq!(points.len(), mesh.points.len() + 49);
    write_cells(&pieces, &points, &tets, &values);
    let (one, _) = kept(&whole_file, &whole(100), "one.isospan", &run(2));
    let (two, report) = kept(&pieces, &whole(100), "two.isospan", &run(2));
    assert_eq!(report.mesh.unwrap().repeated, 49);
    let all = |archive: &Path, isovalue: f64| triangle_set(&extracted(archive, isovalue, 2));
    for isovalue in [0.4, 0.55, 0.61, 0.75] {
        assert_eq!(all(&one, isovalue), all(&two, isovalue), "{isovalue}");
        let found = check(&extracted(&two, isovalue, 2));
        assert!(found.is_manifold() && found.components == 1, "{isovalue}: {found:?}");
    }
    // Where the field jumps, each piece has means of its own, and surfaces end there.
    let options = OpenOptions { jumps: true, ..OpenOptions::default() };
    let out = dir.path().join("jumps.isospan");
    let sources = [StepSource::new(&pieces, &options)];
    let report = reduce_series(&sources, &whole(100), &out, &run(2), &Silent).unwrap();
    assert_eq!(report.mesh.unwrap().repeated, 0);
    check_archive(&out).unwrap();
    let [together, apart] = [&two, &out].map(|archive| check(&extracted(archive, 0.61, 2)));
    assert!(together.components == 1 && apart.components == 2, "{together:?} {apart:?}");
    let plain = [StepSource::new(&plain, &options)];
    let refused = reduce_series(&plain, &whole(100), &out, &again(2), &Silent).unwrap_err();
    assert!(refused.exit_code() == 2 && refused.to_string().contains("`jumps`"), "{refused}");
}

#[test]
fn damaged_plans_of_kept_meshes_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("box.vtk");
    write_mesh(&input, 5, |_| true, |p| p, |p| p[0]);
    let (archive, _) = kept(&input, &whole(1000), "box.isospan", &run(1));
    let good = common::manifest_json(&archive);
    for (from, to) in [
        ("\"set\":\"own\"", "\"set\":\"halton\""),
        ("\"own\":{", "\"owm\":{"),
        ("\"tetrahedra\":750", "\"tetrahedra\":751"),
    ] {
        let bad = good.replacen(from, to, 1);
        assert!(bad != good, "{from}: {good}");
        common::put_manifest(&archive, &bad);
        assert!(check_archive(&archive).is_err(), "{from}");
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn real_meshes_are_kept() {
    let data = common::shared_data();
    let dir = tempfile::tempdir().unwrap();
    // File, field, isovalue; triangles, vertices - edges + triangles, and area of VTK's contour of
    // the mesh.
    for (name, field, isovalue, triangles, euler, area) in [
        ("meshes/kit_heart_inflation.vtu", None, 13.4, 7626, -4, 6994.856),
        ("meshes/fim_activation_196k.vtu", Some("seed1"), 85.15, 10582, 1, 77933.261),
        ("meshes/post_flow_tet.vtk", Some("Pressure"), 0.74, 1662, 4, 10.129_793),
        ("meshes/cylinder_flow_tet.vtk", Some("vel_norm"), 0.3, 1690, 0, 0.005_047_441),
    ] {
        let options = OpenOptions { field: field.map(str::to_owned), ..OpenOptions::default() };
        for chunk_points in [250_000, 1000] {
            let out = dir.path().join("real.isospan");
            let report = reduce_series(
                &[StepSource::new(&data.join(name), &options)],
                &whole(chunk_points),
                &out,
                &again(2),
                &Silent,
            )
            .unwrap();
            assert!(report.own && report.error.unwrap().max == 0.0);
            check_archive(&out).unwrap();
            let found = check(&extracted(&out, isovalue, 2));
            assert_eq!((found.triangles, found.euler), (triangles, euler), "{name}");
            assert!((found.area / area - 1.0).abs() < 1e-5, "{name}: {} for {area}", found.area);
        }
    }
}
