//! A field that bends along one axis above all: points are closer along it, the lattice has more
//! steps there, and everything else holds as ever.

use crate::common::*;
use isospan::Archive;
use isospan::archive::manifest::Manifest;
use isospan::exec::Silent;
use isospan::formats::{Input, OpenOptions, open_input};
use isospan::pipeline::{Amount, ExportSettings, ReduceReport, ReduceSettings, Roi, SurfaceQuery};
use isospan::points::SetKind;
use isospan::sample::Values;
use isospan::surface::TriMesh;
use isospan::surface::check::check;
use std::fs;
use std::path::{Path, PathBuf};

const DIMS: [usize; 3] = [36, 30, 28];

/// Sheets, a little wavy; coordinates are -1 to 1.
fn sheets(x: f64, y: f64, z: f64) -> f64 {
    (1.4 * x).sin() + (1.2 * y).sin() + 2.0 * (8.0 * z + x * y).sin()
}

/// Its gradient to a voxel.
fn gradient(x: f64, y: f64, z: f64) -> [f64; 3] {
    let c = 2.0 * (8.0 * z + x * y).cos();
    let to_voxel = |a: usize| 2.0 / (DIMS[a] - 1) as f64;
    [
        (1.4 * (1.4 * x).cos() + y * c) * to_voxel(0),
        (1.2 * (1.2 * y).cos() + x * c) * to_voxel(1),
        8.0 * c * to_voxel(2),
    ]
}

fn adapted(fraction: f64, chunk_points: u64) -> ReduceSettings {
    let even = settings(SetKind::Halton, Amount::Fraction(fraction), chunk_points);
    ReduceSettings { adapt: true, values: Some(Values::Fit), ..even }
}

fn made(dir: &Path, chunk_points: u64, threads: usize) -> (PathBuf, ReduceReport) {
    let input = dir.join("sheets.npy");
    write_npy(&input, DIMS, sheets);
    let out = dir.join(format!("{chunk_points}-{threads}.isospan"));
    let report = reduce(&input, &adapted(0.125, chunk_points), &out, threads);
    assert_eq!(Manifest::read(&out).unwrap().plan.lattice.finer(), [0, 0, 2], "more steps along z");
    assert!(check_archive(&out).is_ok(), "sound");
    (out, report)
}

fn ask(query: &SurfaceQuery<'_>, dir: &Path) -> TriMesh {
    let file = dir.join("surface.ply");
    query.write(&file).unwrap();
    read(&file)
}

#[test]
fn it_is_worth_it_and_neither_chunks_nor_threads_nor_shards_show() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, report) = made(dir.path(), u64::MAX >> 20, 2);
    let (cut, other) = made(dir.path(), 400, 2);
    assert!(report.chunks == 1 && other.chunks > 5, "{} chunks", other.chunks);
    assert_eq!(report.error, other.error);
    let sets = [&whole, &cut].map(|archive| triangle_set(&ask(&query(archive, 0.3), dir.path())));
    assert!(sets[0].len() > 1000 && sets[0] == sets[1], "chunks");
    assert_eq!(folder(&cut), folder(&made(dir.path(), 400, 1).0), "threads");
    let (input, parts) = (dir.path().join("sheets.npy"), dir.path().join("parts.isospan"));
    reduce_in_shards(&input, &adapted(0.125, 400), &parts);
    assert_eq!(folder(&cut), folder(&parts), "shards");
    // Twice as many points, evenly spread, are further off.
    let even = ReduceSettings { adapt: false, ..adapted(0.25, 50_000) };
    let even = reduce(&input, &even, &dir.path().join("even.isospan"), 2);
    let [error, of_even] = [&report, &even].map(|r| r.error.as_ref().unwrap().rms);
    assert!(error < of_even && report.points < even.points, "{error} {of_even}");
}

#[test]
fn surfaces_lie_where_the_field_is_and_their_normals_point_down_it() {
    let dir = tempfile::tempdir().unwrap();
    let (archive, _) = made(dir.path(), 900, 2);
    let mesh = ask(&query(&archive, 0.3), dir.path());
    let sound = check(&mesh);
    assert!(sound.is_manifold() && sound.is_oriented() && sound.triangles > 1000, "{sound:?}");
    let unit = |p: [f32; 3]| [0, 1, 2].map(|a| 2.0 * f64::from(p[a]) / (DIMS[a] - 1) as f64 - 1.0);
    let (mut off, mut straight) = (0.0, 0.0);
    for v in &mesh.vertices {
        let [x, y, z] = unit(v.position);
        let g = gradient(x, y, z);
        let length = g.iter().map(|g| g * g).sum::<f64>().sqrt();
        off += (sheets(x, y, z) - 0.3).abs() / length.max(0.05);
        straight -= (0..3).map(|a| g[a] / length * f64::from(v.normal[a])).sum::<f64>();
    }
    let count = mesh.vertices.len() as f64;
    assert!(off / count < 0.25, "{} voxels off", off / count);
    assert!(straight / count > 0.97, "{} of the normals' length", straight / count);
    let spectrum = contour_spectrum(&archive).unwrap();
    assert!((spectrum.volume / (35.0 * 29.0 * 27.0) - 1.0).abs() < 1e-12, "{}", spectrum.volume);
    for knot in spectrum.knots.iter().step_by(9) {
        let area = check(&ask(&query(&archive, knot.isovalue), dir.path())).area;
        assert!((area - knot.area).abs() <= 1e-4 * knot.area + 1e-9, "{knot:?} {area}");
    }
    let capped = ask(&query(&archive, 0.3).cap(true), dir.path());
    assert!(check(&capped).is_closed());
    // Two halves are the whole.
    let areas = [":,:,:13.3", ":,:,13.3:", "9.7:,:,:", ":9.7,:,:"].map(|roi| {
        let roi: Roi = roi.parse().unwrap();
        check(&ask(&query(&archive, 0.3).region(roi), dir.path())).area
    });
    for halves in areas.chunks(2) {
        assert!((halves.iter().sum::<f64>() / sound.area - 1.0).abs() < 1e-4, "{areas:?} {}", sound.area);
    }
}

#[test]
fn samples_points_and_the_stored_error_agree() {
    let dir = tempfile::tempdir().unwrap();
    let (path, report) = made(dir.path(), 900, 2);
    let archive = Archive::open(&path).unwrap();
    let samples = archive.sample(DIMS.map(|d| d as u64)).unwrap();
    let places: Vec<[usize; 3]> =
        (0..samples.len()).map(|i| [i % DIMS[0], i / DIMS[0] % DIMS[1], i / DIMS[0] / DIMS[1]]).collect();
    let world: Vec<[f64; 3]> = places.iter().map(|p| p.map(|x| x as f64)).collect();
    let probed = archive.probe(&world).unwrap();
    assert!(samples.iter().zip(&probed).all(|(a, b)| a.to_bits() == b.to_bits()));
    let unit = |p: [usize; 3]| [0, 1, 2].map(|a| 2.0 * p[a] as f64 / (DIMS[a] - 1) as f64 - 1.0);
    let squares = samples.iter().zip(&places).map(|(&v, &p)| {
        let [x, y, z] = unit(p);
        (f64::from(sheets(x, y, z) as f32) - v).powi(2)
    });
    let rms = (squares.sum::<f64>() / samples.len() as f64).sqrt();
    let stored = report.error.unwrap().rms;
    assert!((rms / stored - 1.0).abs() < 1e-6, "{rms} {stored}");
    // Exported points lie in the box, and their tetrahedra are all of it: `check_archive` has added
    // up the volumes.
    let file = dir.path().join("s.vtu");
    archive.write_tetrahedra(&ExportSettings::default(), &file, &Silent).unwrap();
    let Input::Mesh(mesh) = open_input(&file, &OpenOptions::default()).unwrap() else {
        panic!("an unstructured grid")
    };
    assert_eq!((mesh.info().points, mesh.info().cells), (report.points, report.tetrahedra));
    fs::remove_file(file).unwrap();
}
