//! From a volume to a surface: what comes out is whole, watertight, in the right place, and read
//! sparingly.

use crate::common::*;
use isospan::Archive;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::grid::Geometry;
use isospan::pipeline::{self, Amount, NanPolicy, ReduceSettings};
use isospan::points::SetKind;
use isospan::sample::{Interpolation, Values};
use isospan::surface::check::{boundary_outside, check};
use std::f64::consts::PI;
use std::fs;
use std::path::Path;

#[test]
fn every_point_set_gives_a_sound_archive_and_sound_surfaces() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    let dims = [48usize, 33, 40];
    write_npy(&input, dims, waves);
    for kind in SetKind::ALL {
        let out = dir.path().join(format!("{kind}.isospan"));
        let report = reduce(&input, &settings(kind, Amount::Fraction(0.25), 6_000), &out, 2);
        let checked = check_archive(&out).unwrap();
        assert_eq!((checked.points, checked.tetrahedra), (report.points, report.tetrahedra), "{kind}");
        for isovalue in [-0.7, 0.0, 0.9] {
            let file = dir.path().join("s.ply");
            let report = surface(&out, isovalue, &file, 2);
            let mesh = read(&file);
            let sound = check(&mesh);
            assert!(sound.triangles > 500 && sound.boundary_edges > 0, "{kind} {isovalue}: {sound:?}");
            assert!(sound.is_manifold() && sound.is_oriented(), "{kind} {isovalue}: {sound:?}");
            assert_eq!(sound.zero_area_triangles, 0, "{kind} {isovalue}");
            assert_eq!(
                boundary_outside(&mesh, &Geometry::default(), dims.map(|d| d as u64), 1e-3),
                0,
                "{kind} {isovalue}"
            );
            let count = count_active(&out, isovalue).unwrap();
            assert_eq!(count.active_cells, report.active_cells, "{kind} {isovalue}");
        }
    }
}

#[test]
fn a_ball_has_the_area_and_the_volume_of_a_ball() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.npy");
    write_npy(&input, [64, 64, 64], ball);
    let out = dir.path().join("ball.isospan");
    reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(0.5), 50_000), &out, 2);
    for extension in ["ply", "stl", "obj", "vtp", "vtkhdf", "glb"] {
        let file = dir.path().join(format!("ball.{extension}"));
        surface(&out, 0.0, &file, 2);
        let report = check(&read(&file));
        assert!(
            report.is_closed() && report.is_manifold() && report.is_oriented(),
            "{extension}: {report:?}"
        );
        assert_eq!((report.euler, report.components), (2, 1), "{extension}");
        let r = 0.7 * 31.5;
        let (area, volume) =
            (report.area / (4.0 * PI * r * r), report.volume.unwrap() / (4.0 / 3.0 * PI * r * r * r));
        assert!((0.98..1.03).contains(&area), "{extension}: {area}");
        assert!((0.98..1.01).contains(&volume), "{extension}: {volume}");
    }
}

#[test]
fn an_isovalue_outside_the_range_gives_an_empty_valid_file() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.npy");
    write_npy(&input, [20, 20, 20], ball);
    let out = dir.path().join("ball.isospan");
    let reduced = reduce(&input, &settings(SetKind::Regular, Amount::Fraction(1.0), 250_000), &out, 1);
    for isovalue in [reduced.range.unwrap()[0], -1e9, 1e9] {
        for extension in ["ply", "stl", "obj", "vtp", "vtkhdf", "glb"] {
            let file = dir.path().join(format!("empty.{extension}"));
            let report = surface(&out, isovalue, &file, 1);
            assert!(report.surfaces[0].outside_range && report.triangles == 0 && report.active_blocks == 0);
            assert_eq!(read(&file).triangles.len(), 0);
        }
    }
}

#[test]
fn a_small_surface_reads_a_small_part_of_the_archive() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.npy");
    write_npy(&input, [80, 80, 80], ball);
    let out = dir.path().join("ball.isospan");
    reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(0.5), 20_000), &out, 2);
    let report = surface(&out, 0.47, &dir.path().join("s.ply"), 2);
    assert!(report.triangles > 100, "{report:?}");
    assert!(report.bytes_read * 8 < report.archive_bytes, "{report:?}");
    assert!(report.active_blocks * 20 < report.blocks, "{report:?}");
}

#[test]
fn holes_are_not_bridged() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("hole.npy");
    // Half of the ball is missing: the surface must end at the hole, not close across it.
    write_npy(&input, [40, 40, 40], |x, y, z| if x > 0.01 { f64::NAN } else { ball(x, y, z) });
    let out = dir.path().join("hole.isospan");
    let refused = pipeline::reduce_series(
        &[StepSource::new(&input, &OpenOptions::default())],
        &ReduceSettings::default(),
        &out,
        &run(2),
        &Silent,
    );
    let error = refused.unwrap_err();
    assert_eq!(error.exit_code(), 5);
    assert!(error.to_string().contains("`nan=mask`"), "{error}");
    assert!(!pipeline::is_archive(&out));
    let masked = ReduceSettings { nan: NanPolicy::Mask, ..ReduceSettings::default() };
    let report = reduce(&input, &masked, &out, 2);
    assert!(report.void_points > report.points / 3 && report.void_points < report.points * 2 / 3);
    let file = dir.path().join("s.ply");
    surface(&out, 0.0, &file, 2);
    let mesh = read(&file);
    let sound = check(&mesh);
    assert!(sound.is_manifold() && sound.is_oriented() && sound.boundary_edges > 20, "{sound:?}");
    assert!(mesh.vertices.iter().all(|v| v.position[0] < 20.5));
    check_archive(&out).unwrap();
}

#[test]
fn a_value_can_stand_in_for_missing_samples() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("hole.npy");
    write_npy(&input, [30, 30, 30], |x, y, z| if x > 0.5 { -999.0 } else { ball(x, y, z) });
    let out = dir.path().join("a.isospan");
    let settings =
        ReduceSettings { nan: NanPolicy::Value(-1.0), missing: Some(-999.0), ..ReduceSettings::default() };
    let report = reduce(&input, &settings, &out, 1);
    assert_eq!(report.void_points, 0);
    assert!(report.range.unwrap()[0] >= -2.6, "{report:?}");
}

#[test]
fn positions_go_through_the_geometry() {
    let dir = tempfile::tempdir().unwrap();
    // The same samples, mirrored and stretched by the header.
    let npy = dir.path().join("ball.npy");
    write_npy(&npy, [30, 30, 30], ball);
    let samples = fs::read(&npy).unwrap()[128..].to_vec();
    fs::write(dir.path().join("ball.raw"), samples).unwrap();
    let header = "NRRD0004\ntype: float\ndimension: 3\nsizes: 30 30 30\nspace dimension: 3\n\
        space directions: (0,2,0) (1,0,0) (0,0,3)\nspace origin: (100,200,300)\nendian: little\nencoding: raw\n\
        data file: ball.raw\n";
    let nhdr = dir.path().join("ball.nhdr");
    fs::write(&nhdr, header).unwrap();
    let out = dir.path().join("ball.isospan");
    reduce(&nhdr, &settings(SetKind::Halton, Amount::Fraction(1.0), 250_000), &out, 2);
    let file = dir.path().join("s.ply");
    surface(&out, 0.0, &file, 2);
    let mesh = read(&file);
    let report = check(&mesh);
    let r = 0.7 * 14.5;
    let expected = 4.0 / 3.0 * PI * r * r * r * 6.0;
    let volume = report.volume.unwrap();
    assert!(
        (0.97..1.01).contains(&(volume / expected)),
        "positive although mirrored: {volume} of {expected}"
    );
    let centre = [100.0 + 14.5, 200.0 + 29.0, 300.0 + 43.5];
    for v in &mesh.vertices {
        let d: Vec<f64> = (0..3).map(|a| f64::from(v.position[a]) - centre[a]).collect();
        let scaled = [d[0], d[1] / 2.0, d[2] / 3.0];
        let distance = scaled.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((distance - r).abs() < 0.3, "{distance}");
        // Normals point to lower values: outwards. As covectors they shrink where the space is
        // stretched.
        let n: f64 = (0..3).map(|a| f64::from(v.normal[a]) * d[a]).sum();
        assert!(n > 0.0);
    }
}

#[test]
fn interpolations_differ_and_all_work() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [24, 24, 24], waves);
    let all =
        [Interpolation::Linear, Interpolation::Cubic, Interpolation::CubicThesis, Interpolation::Nearest];
    // Values at the same points: the field's own, and what each interpolation makes of the samples
    // around.
    let errors = all.map(|interpolation| {
        let out = dir.path().join(format!("{}.isospan", interpolation.name()));
        let settings =
            ReduceSettings { interpolation, ..settings(SetKind::Halton, Amount::Count(5_000), 250_000) };
        reduce(&input, &settings, &out, 2);
        check_archive(&out).unwrap();
        let archive = isospan::Archive::open(&out).unwrap();
        let surface = archive.surface(0.1).unwrap();
        assert!(surface.vertices.len() > 500, "{}", interpolation.name());
        let off = |v: &isospan::surface::Vertex| {
            let [x, y, z] = v.position.map(|c| 2.0 * f64::from(c) / 23.0 - 1.0);
            (waves(x, y, z) - 0.1).powi(2)
        };
        let squares: f64 = surface.vertices.iter().map(off).sum();
        (squares / surface.vertices.len() as f64).sqrt()
    });
    let [linear, cubic, thesis, nearest] = errors;
    assert!(cubic < linear && linear < nearest / 2.0 && thesis < nearest / 2.0, "{errors:?}");
    assert!(thesis != linear && thesis != cubic, "{errors:?}");
}

#[test]
fn tiny_and_flat_volumes() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("tiny.npy");
    for dims in [[2, 2, 2], [2, 3, 50], [100, 2, 2]] {
        write_npy(&input, dims, |x, y, z| x + 0.3 * y - 0.2 * z);
        for kind in SetKind::ALL {
            for amount in [Amount::Count(1), Amount::Fraction(1.0), Amount::Count(3_000)] {
                let out = dir.path().join("tiny.isospan");
                let settings = settings(kind, amount, 250_000);
                match pipeline::reduce_series(
                    &[StepSource::new(&input, &OpenOptions::default())],
                    &settings,
                    &out,
                    &run(1),
                    &Silent,
                ) {
                    Ok(_) => sound(&out, dir.path()),
                    // Some sets have no such size; they say so.
                    Err(e) => assert_eq!(e.exit_code(), 2, "{kind} {amount:?}: {e}"),
                }
                let _ = fs::remove_dir_all(&out);
            }
        }
    }
}

fn sound(archive: &Path, dir: &Path) {
    check_archive(archive).unwrap();
    let file = dir.join("tiny.ply");
    surface(archive, 0.0, &file, 1);
    let report = check(&read(&file));
    assert!(report.triangles > 0 && report.is_manifold() && report.is_oriented(), "{report:?}");
}

/// A noisy block in air that was cut off at -1024, and a small bright one far from it; the
/// coordinates are numbers of samples.
fn blocks(x: f64, y: f64, z: f64) -> f64 {
    let all_in = |lo: f64, hi: f64| [y, z].iter().all(|c| (lo..hi).contains(c));
    if x < 24.0 && all_in(8.0, 24.0) {
        let n = (x as u32).wrapping_mul(73_856_093) ^ (y as u32).wrapping_mul(19_349_663);
        let n = (n ^ (z as u32).wrapping_mul(83_492_791)).wrapping_mul(0x5bd1_e995);
        900.0 + f64::from((n ^ (n >> 15)) % 201)
    } else if x >= 40.0 && all_in(12.0, 20.0) {
        1500.0
    } else {
        -1024.0
    }
}

#[test]
fn fitted_values_make_no_surface_far_from_that_of_all_samples() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("blocks.npy");
    let of = |c: f64, n: f64| ((c + 1.0) / 2.0 * (n - 1.0)).round();
    write_npy(&input, [48, 32, 32], |x, y, z| blocks(of(x, 48.0), of(y, 32.0), of(z, 32.0)));
    let archive = |name: &str, settings: &ReduceSettings| {
        let out = dir.path().join(name);
        let report = reduce(&input, settings, &out, 2);
        (Archive::open(&out).unwrap(), report.range.unwrap())
    };
    let all = settings(SetKind::Regular, Amount::Fraction(1.0), 250_000);
    let (full, range) = archive("full.isospan", &all);
    let few = ReduceSettings { values: Some(Values::Fit), ..ReduceSettings::exact(SetKind::Hammersley) };
    let (fitted, of_fitted) = archive("fitted.isospan", &few);
    assert!(range[0] <= of_fitted[0] && of_fitted[1] <= range[1], "{range:?} {of_fitted:?}");
    // At 1200 there is the bright block alone; nothing is below the air.
    for isovalue in [-1000.0, 0.0, 950.0, 1050.0, 1200.0, 1490.0, -1030.0] {
        let [fitted, full] = [&fitted, &full].map(|archive| archive.surface(isovalue).unwrap().vertices);
        for v in &fitted {
            let near = full.iter().any(|w| {
                (0..3).map(|k| (v.position[k] - w.position[k]).powi(2)).sum::<f32>() <= 4.0f32.powi(2)
            });
            assert!(near, "{isovalue}: {v:?} is further than two spacings from all samples' surface");
        }
        assert_eq!(fitted.is_empty(), full.is_empty(), "{isovalue}");
    }
}
