//! Rectilinear and curvilinear grids: meshed in index space, placed by their coordinates. Analytic
//! maps say what must come out.

use crate::common::{check_archive, contour_spectrum, query, streamed};
use isospan::exec::{CancelToken, Silent};
use isospan::formats::surface::read_surface;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{
    Amount, ExportSettings, NanPolicy, ReduceReport, ReduceSettings, Roi, RunSettings, StepChoice,
    reduce_series,
};
use isospan::points::SetKind;
use isospan::surface::TriMesh;
use isospan::surface::check::check;
use isospan::{Archive, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

type Place = fn([f64; 3]) -> [f64; 3];
type Field = fn([f64; 3]) -> f64;

/// A quarter of a turn of a tube: angle, height, radius.
fn tube([x, y, z]: [f64; 3]) -> [f64; 3] {
    let (angle, radius) = (x / 24.0 * std::f64::consts::FRAC_PI_2, 1.0 + z / 10.0);
    [radius * angle.cos(), radius * angle.sin(), 0.25 * y]
}

/// A part of a spherical shell: longitude, latitude, radius.
fn shell([x, y, z]: [f64; 3]) -> [f64; 3] {
    let (longitude, latitude, radius) = (x / 24.0 * 1.5, (y - 8.0) / 8.0, 1.0 + z / 10.0);
    let flat = radius * latitude.cos();
    [flat * longitude.cos(), flat * longitude.sin(), radius * latitude.sin()]
}

const DIMS: [usize; 3] = [25, 17, 11];

fn samples() -> impl Iterator<Item = [f64; 3]> {
    (0..DIMS[0] * DIMS[1] * DIMS[2])
        .map(|i| [i % DIMS[0], i / DIMS[0] % DIMS[1], i / DIMS[0] / DIMS[1]].map(|v| v as f64))
}

fn words(numbers: impl Iterator<Item = f64>) -> String {
    let mut out = String::new();
    numbers.for_each(|v| writeln!(out, "{v}").expect("writing to memory"));
    out
}

/// A field on a curvilinear grid, as a VTS or legacy file.
fn curvilinear(path: &Path, place: Place, field: Field) {
    let points = words(samples().flat_map(place));
    let values = words(samples().map(|p| field(place(p))));
    let n = DIMS[0] * DIMS[1] * DIMS[2];
    let text = if path.extension().is_some_and(|e| e == "vts") {
        format!(
            "<VTKFile type=\"StructuredGrid\"><StructuredGrid WholeExtent=\"0 24 0 16 0 10\"><Piece Extent=\"0 24 0 16 0 10\">\n\
             <PointData><DataArray type=\"Float32\" Name=\"f\" format=\"ascii\">{values}</DataArray></PointData>\n\
             <Points><DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">{points}</DataArray></Points>\n\
             </Piece></StructuredGrid></VTKFile>\n"
        )
    } else {
        format!(
            "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET STRUCTURED_GRID\nDIMENSIONS 25 17 11\nPOINTS {n} double\n\
             {points}POINT_DATA {n}\nSCALARS f float\nLOOKUP_TABLE default\n{values}"
        )
    };
    std::fs::write(path, text).unwrap();
}

fn small_chunks() -> ReduceSettings {
    let points = Some(SetKind::Regular);
    ReduceSettings { points, amount: Amount::Fraction(1.0), chunk_points: 1500, ..Default::default() }
}

fn make(input: &Path) -> Result<(PathBuf, ReduceReport)> {
    let archive = input.with_extension("isospan");
    let settings = small_chunks();
    let run = RunSettings::default();
    let report = reduce_series(
        &[StepSource::new(input, &OpenOptions::default())],
        &settings,
        &archive,
        &run,
        &Silent,
    )?;
    check_archive(&archive)?;
    Ok((archive, report))
}

fn surface(archive: &Path, isovalue: f32) -> TriMesh {
    let out = archive.with_extension("ply");
    let query = query(archive, isovalue);
    query.write(&out).unwrap();
    let mesh = read_surface(&out).unwrap();
    let (found, parts) = streamed(&query);
    assert!(found == [mesh.clone()] && parts > 2, "{parts} parts are the file");
    mesh
}

/// Probes at positions of the world, and surfaces that are cut at boxes of it.
fn answers_in_the_world(archive: &Archive, isovalue: f64) {
    let mesh = archive.surface(isovalue).unwrap();
    let points: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| v.position.map(f64::from)).collect();
    let values = archive.probe(&points).unwrap();
    for (p, value) in points.iter().zip(values) {
        assert!((value - isovalue).abs() < 1e-4, "{value} at {p:?}");
    }
    let far = points[0].map(|x| x + 1e3);
    assert!(archive.probe(&[far]).unwrap()[0].is_nan());
    let [lo, hi] = archive.bounds(&CancelToken::new()).unwrap();
    assert!(points.iter().all(|p| (0..3).all(|a| lo[a] - 1e-5 <= p[a] && p[a] <= hi[a] + 1e-5)));
    // A box and what lies beyond one of its faces are the whole; the rim lies on the face.
    for axis in 0..3 {
        let middle = 0.5 * (lo[axis] + hi[axis]) + 0.01;
        let cut = |range: String| {
            let mut ranges = [":"; 3];
            ranges[axis] = &range;
            let region: Roi = format!("world:{}", ranges.join(",")).parse().unwrap();
            let query = archive.query(isovalue).region(region);
            let found = query.mesh().unwrap();
            assert!(streamed(&query).0 == [found.clone()]);
            let same = |_: u64, _: f64, of_step: &mut Vec<TriMesh>| {
                assert!(of_step[..] == [found.clone()]);
                Ok(())
            };
            archive.steps(..).unwrap().query(isovalue).region(region).for_each(same).unwrap();
            found
        };
        let (below, above) = (cut(format!(":{middle}")), cut(format!("{middle}:")));
        let area = |mesh: &TriMesh| check(mesh).area;
        assert!(area(&below) > 0.0 && area(&above) > 0.0);
        let sum = area(&below) + area(&above);
        assert!((sum / area(&mesh) - 1.0).abs() < 1e-3, "{sum}");
        for (mesh, sign) in [(&below, 1.0), (&above, -1.0)] {
            let beyond = |v: &isospan::surface::Vertex| sign * (f64::from(v.position[axis]) - middle);
            assert!(mesh.vertices.iter().all(|v| beyond(v) < 1e-5), "axis {axis}");
        }
    }
    let nowhere: Roi = "world:1000:1001,:,:".parse().unwrap();
    let error = archive.query(isovalue).region(nowhere).mesh().unwrap_err();
    assert!(error.to_string().contains("outside the volume"), "{error}");
}

fn radius(p: [f64; 3]) -> f64 {
    p[0].hypot(p[1])
}

fn distance(p: [f64; 3]) -> f64 {
    p[0].hypot(p[1]).hypot(p[2])
}

/// Area, and that the triangles' sides are those that the normals say: of slivers not each, of the
/// area nearly all.
fn area(mesh: &TriMesh) -> f64 {
    let sub =
        |a: [f32; 3], b: [f32; 3]| -> [f64; 3] { std::array::from_fn(|i| f64::from(a[i]) - f64::from(b[i])) };
    let (mut sum, mut agreeing) = (0.0, 0.0);
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
        let (u, v) = (sub(b.position, a.position), sub(c.position, a.position));
        let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let along: f64 = (0..3).map(|i| cross[i] * f64::from(a.normal[i])).sum();
        let size = distance(cross);
        agreeing += along / 2.0;
        sum += size / 2.0;
    }
    assert!(agreeing > 0.9 * sum, "{agreeing} of {sum} agree with the normals");
    sum
}

/// The volume of what `export` writes, and the largest difference of a point's value from `field`
/// there.
fn exported(archive: &Path, field: Field) -> (f64, f64) {
    let out = archive.with_extension("vtu");
    let archive = Archive::open(archive).unwrap();
    let report = archive.write_tetrahedra(&ExportSettings::default(), &out, &Silent).unwrap();
    let bytes = std::fs::read(&out).unwrap();
    let mark = b"<AppendedData encoding=\"raw\">\n   _";
    let points_at = bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len() + 8;
    let values_at = points_at + 24 * report.points as usize + 8;
    let tets_at = values_at + 4 * report.points as usize + 8;
    let number = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    let point = |v: usize| -> [f64; 3] { std::array::from_fn(|a| number(points_at + 24 * v + 8 * a)) };
    let value = |v: usize| f32::from_le_bytes(bytes[values_at + 4 * v..][..4].try_into().unwrap());
    let wrong = (0..report.points as usize)
        .map(|v| (field(point(v)) - f64::from(value(v))).abs())
        .fold(0.0, f64::max);
    let volume = (0..report.tetrahedra as usize).map(|t| {
        let corner =
            |k: usize| u64::from_le_bytes(bytes[tets_at + 32 * t + 8 * k..][..8].try_into().unwrap());
        let [a, b, c, d] = std::array::from_fn(|k| point(corner(k) as usize));
        let [u, v, w]: [[f64; 3]; 3] = [b, c, d].map(|p| std::array::from_fn(|k| p[k] - a[k]));
        let minor = |i: usize, j: usize| v[i] * w[j] - v[j] * w[i];
        (u[0] * minor(1, 2) + u[1] * minor(2, 0) + u[2] * minor(0, 1)) / 6.0
    });
    (volume.sum(), wrong)
}

/// The area of an isosurface in tetrahedra with straight edges between corners in the world.
fn straight_area(archive: &Path, isovalue: f64) -> f64 {
    let triangle = |[a, b, c]: [[f64; 3]; 3]| {
        let [u, v]: [[f64; 3]; 2] = [b, c].map(|p| std::array::from_fn(|k| p[k] - a[k]));
        let minor = |i: usize, j: usize| u[i] * v[j] - u[j] * v[i];
        (minor(1, 2).powi(2) + minor(2, 0).powi(2) + minor(0, 1).powi(2)).sqrt() / 2.0
    };
    let mut sum = 0.0;
    for chunk in Archive::open(archive).unwrap().active(isovalue).unwrap() {
        let chunk = chunk.unwrap();
        for tet in &chunk.tetrahedra {
            let corners = tet.map(|v| (chunk.values[v as usize], chunk.points[v as usize]));
            let (inside, outside): (Vec<_>, Vec<_>) = corners.into_iter().partition(|c| c.0 >= isovalue);
            let cut = |a: (f64, [f64; 3]), b: (f64, [f64; 3])| -> [f64; 3] {
                let t = (isovalue - a.0) / (b.0 - a.0);
                std::array::from_fn(|k| a.1[k] + t * (b.1[k] - a.1[k]))
            };
            let cuts: Vec<_> = inside.iter().flat_map(|&a| outside.iter().map(move |&b| cut(a, b))).collect();
            sum += match *cuts {
                [a, b, c] => triangle([a, b, c]),
                [a, b, c, d] => triangle([a, b, d]) + triangle([a, c, d]),
                _ => 0.0,
            };
        }
    }
    sum
}

#[test]
fn a_tube_and_a_shell_have_their_areas_and_normals() {
    let dir = tempfile::tempdir().unwrap();
    let tube_area = 1.52 * std::f64::consts::FRAC_PI_2 * 4.0;
    let shell_area = 1.52 * 1.52 * 1.5 * 2.0 * 1f64.sin();
    let cases: [(&str, Place, Field, f64); 3] = [
        ("tube.vts", tube, radius, tube_area),
        ("tube.vtk", tube, radius, tube_area),
        ("shell.vts", shell, distance, shell_area),
    ];
    let mut tubes = vec![];
    for (name, place, field, expected) in cases {
        let input = dir.path().join(name.replace("tube.", &format!("tube-{}.", tubes.len())));
        curvilinear(&input, place, field);
        let (archive, report) = make(&input).unwrap();
        let cells = report.grid_cells.expect("a grid with coordinates");
        assert_eq!((cells.folded, cells.degenerate), (0, 0), "{name}");
        let mesh = surface(&archive, 1.52);
        let found = area(&mesh);
        assert!((found / expected - 1.0).abs() < 0.01, "{name}: {found}, not {expected}");
        for v in &mesh.vertices {
            let p = v.position.map(f64::from);
            assert!((field(p) - 1.52).abs() < 0.01, "{name}: {p:?}");
            // The field grows outwards, so normals point to the axis.
            let inward = if name.starts_with("tube") { [p[0], p[1], 0.0] } else { p };
            let cosine = (0..3).map(|i| inward[i] * f64::from(v.normal[i])).sum::<f64>() / distance(inward);
            assert!(cosine < -0.97, "{name}: {cosine}");
        }
        assert_eq!(check(&mesh).non_manifold_edges, 0);
        answers_in_the_world(&Archive::open(&archive).unwrap(), 1.52);
        let grid_volume =
            if name.starts_with("tube") { tube_area / 1.52 } else { shell_area / 1.52f64.powi(2) }
                * if name.starts_with("tube") { (4.0 - 1.0) / 2.0 } else { (8.0 - 1.0) / 3.0 };
        let (volume, wrong) = exported(&archive, field);
        assert!(
            (volume / grid_volume - 1.0).abs() < 0.01 && wrong < 0.02,
            "{name}: {volume}, not {grid_volume}; {wrong}"
        );
        // The spectrum measures areas in the world too.
        let spectrum = contour_spectrum(&archive).unwrap();
        let near = spectrum
            .knots
            .iter()
            .min_by(|a, b| (a.isovalue - 1.52).abs().total_cmp(&(b.isovalue - 1.52).abs()));
        let knot = near.expect("a spectrum has knots");
        let at_knot = expected * (knot.isovalue / 1.52).powi(if name.starts_with("tube") { 1 } else { 2 });
        // Of straight tetrahedra exactly, which it says: the surface follows the grid.
        assert!(spectrum.straight_edges);
        let straight = straight_area(&archive, knot.isovalue);
        assert!((knot.area / straight - 1.0).abs() < 1e-6, "{name}: {} {straight}", knot.area);
        assert!((knot.area / at_knot - 1.0).abs() < 0.03, "{name}: {} at {}", knot.area, knot.isovalue);
        tubes.push(mesh);
    }
    assert_eq!(tubes[0], tubes[1], "VTS and legacy files of one grid");
}

/// A sphere in a box whose samples stand at squares; y descends, so the map mirrors.
fn rectilinear(text: &dyn Fn([String; 3], String) -> String) -> String {
    let axis = |n: usize, of: &dyn Fn(f64) -> f64| -> Vec<f64> { (0..n).map(|i| of(i as f64)).collect() };
    let axes = [
        axis(25, &|i| (i / 24.0).powi(2) * 2.0 - 0.6),
        axis(17, &|i| 1.0 - i / 8.0),
        axis(11, &|i| i / 5.0 - 1.0),
    ];
    let place = |p: [f64; 3]| distance(std::array::from_fn(|a| axes[a][p[a] as usize]));
    let values = words(samples().map(place));
    text(axes.clone().map(|axis| words(axis.into_iter())), values)
}

#[test]
fn a_reduction_that_was_refused_for_missing_samples_is_no_other_work() {
    let dir = tempfile::tempdir().unwrap();
    let legacy = rectilinear(&|[x, y, z], values| {
        let (first, others) = values.split_once(char::is_whitespace).unwrap();
        assert!(first.parse::<f64>().is_ok());
        format!(
            "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET RECTILINEAR_GRID\nDIMENSIONS 25 17 11\nX_COORDINATES 25 double\n{x}\
             Y_COORDINATES 17 double\n{y}Z_COORDINATES 11 double\n{z}POINT_DATA 4675\nSCALARS f float\nLOOKUP_TABLE default\nnan {others}"
        )
    });
    let input = dir.path().join("missing.vtk");
    std::fs::write(&input, legacy).unwrap();
    let error = make(&input).expect_err("a sample is missing");
    assert!(error.to_string().contains("`nan=mask`"), "{error}");
    let settings = ReduceSettings { nan: NanPolicy::Mask, ..small_chunks() };
    let (archive, run) = (input.with_extension("isospan"), RunSettings::default());
    reduce_series(&[StepSource::new(&input, &OpenOptions::default())], &settings, &archive, &run, &Silent)
        .unwrap();
    check_archive(&archive).unwrap();
}

#[test]
fn a_sphere_in_a_rectilinear_grid_is_a_sphere() {
    let dir = tempfile::tempdir().unwrap();
    let xml = rectilinear(&|[x, y, z], values| {
        let table = |t: &str| format!("<DataArray type=\"Float64\" format=\"ascii\">{t}</DataArray>\n");
        format!(
            "<VTKFile type=\"RectilinearGrid\"><RectilinearGrid WholeExtent=\"0 24 0 16 0 10\"><Piece Extent=\"0 24 0 16 0 10\">\n\
             <PointData><DataArray type=\"Float32\" Name=\"f\" format=\"ascii\">{values}</DataArray></PointData>\n\
             <Coordinates>{}{}{}</Coordinates></Piece></RectilinearGrid></VTKFile>\n",
            table(&x),
            table(&y),
            table(&z)
        )
    });
    let legacy = rectilinear(&|[x, y, z], values| {
        format!(
            "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET RECTILINEAR_GRID\nDIMENSIONS 25 17 11\nX_COORDINATES 25 double\n{x}\
             Y_COORDINATES 17 double\n{y}Z_COORDINATES 11 double\n{z}POINT_DATA 4675\nSCALARS f float\nLOOKUP_TABLE default\n{values}"
        )
    });
    let mut meshes = vec![];
    for (name, text) in [("a.vtr", xml), ("b.vtk", legacy)] {
        let input = dir.path().join(name);
        std::fs::write(&input, text).unwrap();
        let (archive, report) = make(&input).unwrap();
        let cells = report.grid_cells.expect("a grid with coordinates");
        assert_eq!((cells.folded, cells.degenerate, cells.mirrored), (0, 0, true));
        let mesh = surface(&archive, 0.5);
        let found = area(&mesh);
        assert!((found / std::f64::consts::PI - 1.0).abs() < 0.05, "{found}");
        assert_eq!(check(&mesh).boundary_edges, 0, "closed");
        meshes.push(mesh);
        // The coordinates are those of all steps.
        let (input, out) =
            (StepSource::new(&input, &OpenOptions::default()), archive.with_extension("steps.isospan"));
        let run = RunSettings::default();
        reduce_series(&[input.clone(), input], &small_chunks(), &out, &run, &Silent).unwrap();
        assert_eq!(
            Archive::open(&out).unwrap().at(StepChoice::Number(1)).unwrap().surface(0.5).unwrap(),
            meshes[0]
        );
        let archive = Archive::open(&archive).unwrap();
        answers_in_the_world(&archive, 0.5);
    }
    assert_eq!(meshes[0], meshes[1], "VTR and legacy files of one grid");
}

#[test]
fn bad_coordinates_are_refused_and_folds_counted() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("folded.vts");
    fn folded(p: [f64; 3]) -> [f64; 3] {
        if p == [5.0, 5.0, 5.0] { [7.5, 7.5, 5.0] } else { p }
    }
    curvilinear(&input, folded, |p| p[0]);
    let (_, report) = make(&input).unwrap();
    let cells = report.grid_cells.expect("a grid with coordinates");
    assert!((1..=8).contains(&cells.folded), "{cells:?}");
    fn broken(p: [f64; 3]) -> [f64; 3] {
        if p == [5.0, 5.0, 5.0] { [f64::NAN; 3] } else { p }
    }
    let input = dir.path().join("broken.vts");
    curvilinear(&input, broken, |_| 1.0);
    let line = make(&input).unwrap_err().to_string();
    assert!(line.contains("broken.vts") && line.contains("finite"), "{line}");
    let text = std::fs::read_to_string(dir.path().join("folded.vts")).unwrap();
    std::fs::write(&input, text.replacen("<Points>", "<Pints>", 1).replacen("</Points>", "</Pints>", 1))
        .unwrap();
    let line = make(&input).unwrap_err().to_string();
    assert!(line.contains("a DataArray in Points"), "{line}");
}
