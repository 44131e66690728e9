//! Real volumes, where there are some: the folder that `ISOSPAN_SHARED_DATA` names, with its
//! `MANIFEST.tsv`.

use crate::common::*;
use isospan::formats::{OpenOptions, StepSource, open_volume};
use isospan::grid::Geometry;
use isospan::pipeline::{self, NanPolicy, ReduceSettings};
use isospan::surface::check::{SurfaceCheckReport, boundary_outside, check};
use isospan::surface::extract::{ChunkSurface, CubeBench, GridBlock, marching_cubes};
use isospan::surface::weld::{BuilderSettings, SurfaceBuilder};
use isospan::surface::{TriMesh, WorldMap};
use std::fs;
use std::path::Path;

struct Entry {
    file: String,
    dims: [u64; 3],
    scalar: String,
    range: [f64; 2],
    isovalue: f32,
    /// The triangles of `vtkFlyingEdges3D` at each of its isovalues.
    triangles: Vec<(f32, u64)>,
}

/// The volumes of the manifest in formats that are read.
fn volumes(folder: &Path) -> Vec<Entry> {
    let text = fs::read_to_string(folder.join("MANIFEST.tsv")).unwrap();
    text.lines().filter_map(entry).collect()
}

fn entry(line: &str) -> Option<Entry> {
    let c: Vec<&str> = line.split('\t').collect();
    let file = c.first()?;
    let known = ["nii.gz", "nhdr", "nrrd", "mha", "vtk", "vti"];
    let volume = file.starts_with("volumes/") || file.starts_with("series/viscous");
    if !volume || !known.iter().any(|e| file.ends_with(e)) {
        return None;
    }
    let dims: Vec<u64> = c.get(4)?.split('x').filter_map(|n| n.parse().ok()).collect();
    let (lo, hi) = c.get(6)?.split_once("..")?;
    Some(Entry {
        file: (*file).to_owned(),
        dims: dims.try_into().ok()?,
        scalar: numpy_name(c.get(5)?)?,
        range: [lo.parse().ok()?, hi.parse().ok()?],
        isovalue: c.get(8)?.split(';').next()?.trim().parse().ok()?,
        triangles: list(c.get(8)?).zip(list(c.get(9)?).map(|n| n as u64)).collect(),
    })
}

fn list(text: &str) -> impl Iterator<Item = f32> {
    text.split(';').filter_map(|n| n.trim().parse().ok())
}

/// NumPy's name of a type that the manifest calls `u8`, `i16` or `f32`.
fn numpy_name(name: &str) -> Option<String> {
    let (kind, bits) = name.split_at_checked(1)?;
    let kind = [("u", "uint"), ("i", "int"), ("f", "float")].into_iter().find(|k| k.0 == kind)?.1;
    Some(format!("{kind}{bits}"))
}

/// The file's only scalar field, or the one that its active attribute names, is what is read.
fn options(_: &Entry) -> OpenOptions {
    OpenOptions::default()
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn volumes_are_what_the_manifest_says() {
    let folder = shared_data();
    let entries = volumes(&folder);
    assert!(entries.len() >= 10, "{} volumes", entries.len());
    for e in entries {
        let source = open_volume(&folder.join(&e.file), &options(&e)).unwrap();
        let (info, scan) = pipeline::scan(source).unwrap();
        assert_eq!((info.dims, info.field.scalar.name()), (e.dims, e.scalar.as_str()), "{}", e.file);
        // The manifest gives stored values.
        let stored = [scan.min, scan.max].map(|v| (v.unwrap() - info.intercept) / info.slope);
        for (got, expected) in stored.iter().zip(e.range) {
            assert!((got - expected).abs() <= 1e-5 * expected.abs().max(1.0), "{}: {got} {expected}", e.file);
        }
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn each_volume_reduces_to_a_sound_surface() {
    let folder = shared_data();
    let dir = tempfile::tempdir().unwrap();
    for e in volumes(&folder) {
        let input = folder.join(&e.file);
        let info = open_volume(&input, &options(&e)).unwrap().info().clone();
        let out = dir.path().join("v.isospan");
        let settings = ReduceSettings::default();
        let report = pipeline::reduce_series(
            &[StepSource::new(&input, &options(&e))],
            &settings,
            &out,
            &run(2),
            &isospan::exec::Silent,
        )
        .unwrap();
        let per_point = report.archive_bytes as f64 / report.points as f64;
        assert!(per_point <= 4.0, "{}: {per_point} bytes a point", e.file);
        // The manifest's isovalues are stored values too.
        let isovalue = (f64::from(e.isovalue) * info.slope + info.intercept) as f32;
        let file = dir.path().join("v.ply");
        let report = surface(&out, isovalue, &file, 2);
        let mesh = read(&file);
        let sound = check(&mesh);
        assert!(report.triangles > 1000, "{}: {report:?}", e.file);
        assert!(
            sound.is_manifold() && sound.is_oriented() && sound.zero_area_triangles == 0,
            "{}: {sound:?}",
            e.file
        );
        assert_eq!(boundary_outside(&mesh, &info.geometry, info.dims, 1e-2), 0, "{}", e.file);
        fs::remove_dir_all(&out).unwrap();
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn samples_that_are_no_numbers_are_refused_or_masked() {
    let folder = shared_data();
    let input = folder.join("variants/nan_inf_f32.mha");
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("v.isospan");
    let reduce = |nan| {
        let settings = ReduceSettings { nan, ..ReduceSettings::default() };
        pipeline::reduce_series(
            &[StepSource::new(&input, &OpenOptions::default())],
            &settings,
            &out,
            &run(2),
            &isospan::exec::Silent,
        )
    };
    let error = reduce(NanPolicy::Error).unwrap_err();
    assert!(error.exit_code() == 5 && error.to_string().contains("nan_inf_f32.mha"), "{error}");
    let report = reduce(NanPolicy::Mask).unwrap();
    assert!(report.void_points > 0 && report.range.is_some_and(|r| r[1].is_finite()), "{report:?}");
    check_archive(&out).unwrap();
}

/// What `info --json` says of a file: its exit code, standard output, and lines on standard error.
fn told(file: &Path) -> (Option<i32>, Vec<u8>, String) {
    let program = env!("CARGO_BIN_EXE_isospan");
    let out = std::process::Command::new(program).args(["info", "--json"]).arg(file).output().unwrap();
    (out.status.code(), out.stdout, String::from_utf8(out.stderr).unwrap())
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn meshes_are_what_the_manifest_says_and_other_files_take_one_line() {
    let folder = shared_data();
    let text = fs::read_to_string(folder.join("MANIFEST.tsv")).unwrap();
    let (mut good, mut refused) = (0, 0);
    for c in text.lines().map(|line| line.split('\t').collect::<Vec<_>>()) {
        let file = folder.join(c[0]);
        let ends = |list: &[&str]| list.iter().any(|e| c[0].ends_with(e));
        let mesh =
            ends(&[".vtu", ".pvtu", ".ele"]) || c[0].starts_with("variants/") && c[0].ends_with(".vtk");
        if !(c[0].starts_with("meshes/") || c[0].starts_with("variants/")) || !mesh {
            continue;
        }
        let (code, out, error) = told(&file);
        if code == Some(0) {
            let found: serde_json::Value = serde_json::from_slice(&out).unwrap();
            // "8 points; 1 cells", "32505 vertices; 128976 tet"; volumes have "3x4x6", pairs of
            // files nothing.
            let counts: Vec<u64> =
                c[4].split(';').filter_map(|n| n.trim().split(' ').next()?.parse().ok()).collect();
            if let ([points, cells], Some("mesh")) = (&counts[..], found["kind"].as_str()) {
                assert_eq!(
                    (&found["info"]["points"], &found["info"]["cells"]),
                    (&serde_json::json!(points), &serde_json::json!(cells)),
                    "{}",
                    c[0]
                );
                good += 1;
            }
        } else {
            assert_eq!(code, Some(5), "{}: {error}", c[0]);
            assert_eq!(error.lines().count(), 1, "{}: {error}", c[0]);
            assert!(error.contains("expected") && error.contains("got"), "{}: {error}", c[0]);
            refused += 1;
        }
    }
    assert!(good >= 30 && refused >= 15, "{good} meshes, {refused} refused");
}

/// The stored samples of a volume.
fn samples(file: &Path) -> Vec<f32> {
    let mut slabs = open_volume(file, &OpenOptions::default()).unwrap().into_stream();
    let info = slabs.info().clone();
    let mut samples = vec![0.0; info.dims.iter().product::<u64>() as usize];
    let mut bytes = vec![];
    while let Some(voxels) = slabs.next_slab(&mut bytes).unwrap() {
        let size = bytes.len() / voxels.len();
        let value = |b: &[u8]| match info.field.scalar.name() {
            "uint8" => f32::from(b[0]),
            "int16" => f32::from(i16::from_le_bytes(b.try_into().unwrap())),
            "uint16" => f32::from(u16::from_le_bytes(b.try_into().unwrap())),
            "float32" => f32::from_le_bytes(b.try_into().unwrap()),
            "float64" => f64::from_le_bytes(b.try_into().unwrap()) as f32,
            other => panic!("{other}"),
        };
        let [nx, ny, _] = voxels.dims();
        for (n, b) in (0..).zip(bytes.chunks(size)) {
            let [x, y, z] = [voxels.lo[0] + n % nx, voxels.lo[1] + n / nx % ny, voxels.lo[2] + n / nx / ny];
            samples[((z * info.dims[1] + y) * info.dims[0] + x) as usize] = value(b);
        }
    }
    samples
}

/// The surface of the cells between samples, in index space.
fn surface_of_cells(values: &[f32], grid: [u64; 3], isovalue: f32, caps: bool) -> SurfaceCheckReport {
    let block = GridBlock {
        grid,
        stride: [1; 3],
        start: [0; 3],
        size: grid.map(|n| n as usize),
        values,
        cells: grid.map(|n| [0, n - 1]),
    };
    let world = WorldMap::of_samples(&Geometry::default());
    let mut out = ChunkSurface::default();
    marching_cubes(&block, isovalue, caps, &world, &mut CubeBench::default(), &mut out);
    let mut builder = SurfaceBuilder::new(&world, &BuilderSettings::default());
    builder.push(&out).unwrap();
    check(&TriMesh::from_source(&builder.finish().unwrap()).unwrap())
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn cells_have_the_triangles_of_flying_edges() {
    let folder = shared_data();
    let mut compared = 0;
    for e in volumes(&folder) {
        let values = samples(&folder.join(&e.file));
        for &(isovalue, triangles) in &e.triangles {
            let report = surface_of_cells(&values, e.dims, isovalue, false);
            assert_eq!(report.triangles, triangles, "{} {isovalue}", e.file);
            assert!(report.is_manifold() && report.is_oriented(), "{} {isovalue}: {report:?}", e.file);
            compared += 1;
        }
    }
    assert!(compared >= 15, "{compared}");
}

/// File, isovalue, and of the surface of VTK 9.7: area, Euler number, open edges.
const OF_FLYING_EDGES: [(&str, f32, f64, i64, u64); 6] = [
    ("volumes/tooth_ct_u16be/tooth.nhdr", 600.0, 43421.006, 6, 0),
    ("volumes/tooth_ct_u16be/tooth.nhdr", 1000.0, 22282.272, -4, 0),
    ("volumes/engine_ct_u8.nii.gz", 60.0, 218_937.962, -35, 1422),
    ("volumes/engine_ct_u8.nii.gz", 150.0, 116_925.499, 2551, 46),
    ("volumes/hydrogen_f32.vti", 0.05, 6584.235, 4, 0),
    ("volumes/hydrogen_f32.vti", 0.3, 1165.037, 4, 0),
];

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn cells_have_the_surface_of_flying_edges() {
    let folder = shared_data();
    let entries = volumes(&folder);
    for (file, isovalue, area, euler, open) in OF_FLYING_EDGES {
        let dims = entries.iter().find(|e| e.file == file).unwrap().dims;
        let values = samples(&folder.join(file));
        let report = surface_of_cells(&values, dims, isovalue, false);
        assert_eq!((report.euler, report.boundary_edges), (euler, open), "{file} {isovalue}");
        // Vertices are the same but for those at samples, which stay off these; loops are cut into
        // triangles otherwise.
        assert!((report.area / area - 1.0).abs() < 6e-4, "{file} {isovalue}: {}", report.area);
        let capped = surface_of_cells(&values, dims, isovalue, true);
        assert!(capped.is_closed() && capped.is_manifold() && capped.is_oriented(), "{capped:?}");
    }
}
