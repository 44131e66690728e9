//! Capped, decimated, chosen components: sound surfaces, and the same bytes for any threads and
//! memory.

use crate::common::*;
use isospan::Resources;
use isospan::pipeline::{Amount, Refine};
use isospan::points::SetKind;
use isospan::surface::check::check;
use isospan::surface::edit::{components::ComponentFilter, decimate::Decimation};
use std::fs;
use std::path::{Path, PathBuf};

fn archive(dir: &Path, kind: SetKind) -> PathBuf {
    let input = dir.join("waves.npy");
    write_npy(&input, [40, 33, 36], waves);
    let out = dir.join("waves.isospan");
    reduce(&input, &settings(kind, Amount::Fraction(0.5), 4_000), &out, 2);
    out
}

#[test]
fn capped_surfaces_are_closed_and_divide_the_box() {
    for kind in [SetKind::Hammersley, SetKind::Regular] {
        let dir = tempfile::tempdir().unwrap();
        let archive = archive(dir.path(), kind);
        let file = dir.path().join("s.ply");
        let whole = 39.0 * 32.0 * 35.0;
        let mut before = f64::INFINITY;
        for isovalue in [-1e9f32, -0.5, 0.1, 0.6, 1e9] {
            let query = query(&archive, isovalue).resources(Resources::default().with_threads(2));
            query.cap(true).write(&file).unwrap();
            let report = check(&read(&file));
            assert!(
                report.is_closed() && report.is_manifold() && report.is_oriented(),
                "{isovalue} {report:?}"
            );
            let volume = report.volume.unwrap_or(0.0);
            assert!(volume < before, "{isovalue}: less is inside of a higher isovalue");
            match isovalue {
                -1e9 => assert!((volume / whole - 1.0).abs() < 1e-5, "{volume}"),
                1e9 => assert_eq!(report.triangles, 0),
                _ => assert!(volume > 0.0 && volume < whole),
            }
            before = volume;
        }
    }
}

#[test]
fn threads_and_memory_do_not_show() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), SetKind::Halton);
    let refine = Refine {
        components: Some(ComponentFilter { largest: Some(2), ..ComponentFilter::default() }),
        decimate: Some(Decimation { ratio: 0.2, max_error: 0.5 }),
        ..Refine::default()
    };
    let with = |name: &str, threads: usize, memory: u64| {
        let file = dir.path().join(name);
        let resources = Resources::default().with_threads(threads).with_memory(memory);
        let query = query(&archive, 0.1).cap(true).refine(refine.clone()).resources(resources);
        (query.write(&file).unwrap(), fs::read(&file).unwrap(), read(&file))
    };
    let (report, bytes, mesh) = with("a.glb", 1, 1 << 30);
    assert!(bytes == with("b.glb", 4, 1 << 30).1 && bytes == with("c.glb", 2, 160 << 20).1);
    let refined = &report.surfaces[0].refined;
    let (components, decimation) =
        (refined.components.as_ref().unwrap(), refined.decimation.as_ref().unwrap());
    assert!(components.kept <= 2 && components.listed.iter().all(|c| c.closed), "{components:?}");
    assert_eq!(decimation.triangles_before, components.listed.iter().map(|c| c.triangles).sum::<u64>());
    assert_eq!(decimation.triangles_after, report.triangles);
    assert!(decimation.error_estimate <= 0.5 && report.triangles * 2 < decimation.triangles_before);
    let checked = check(&mesh);
    assert!(checked.is_closed() && checked.is_manifold() && checked.is_oriented(), "{checked:?}");
    assert_eq!(checked.components, components.kept);
}

#[test]
fn what_makes_no_sense_is_refused_before_anything_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), SetKind::Halton);
    let filter = ComponentFilter { min_volume: f64::NAN, ..ComponentFilter::default() };
    let ratio = Decimation { ratio: 2.0, ..Decimation::default() };
    for refine in [
        Refine { components: Some(filter), ..Refine::default() },
        Refine { decimate: Some(ratio), ..Refine::default() },
    ] {
        let file = dir.path().join("none.ply");
        let refused = query(&archive, 0.1).refine(refine).write(&file);
        assert_eq!((refused.unwrap_err().exit_code(), file.exists()), (2, false));
    }
}

/// Triangles with all corners on one face of a box from 0 to these ends, their area, and vertices
/// outside of the box.
fn caps(mesh: &isospan::TriMesh, ends: [f32; 3]) -> (usize, f64, usize) {
    let (mut count, mut area) = (0, 0.0);
    for t in &mesh.triangles {
        let p = t.map(|v| mesh.vertices[v as usize].position);
        let on = |axis: usize, end: f32| p.iter().all(|p| p[axis] == end);
        if (0..3).any(|axis| on(axis, 0.0) || on(axis, ends[axis])) {
            let [a, b, c] = p.map(|p| p.map(f64::from));
            let [u, v] = [b, c].map(|q| [0, 1, 2].map(|k| q[k] - a[k]));
            let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            area += n.iter().map(|x| x * x).sum::<f64>().sqrt() / 2.0;
            count += 1;
        }
    }
    let outside = |p: &[f32; 3]| (0..3).any(|k| p[k] < 0.0 || p[k] > ends[k]);
    (count, area, mesh.vertices.iter().filter(|v| outside(&v.position)).count())
}

#[test]
fn caps_stay_in_their_planes() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    write_npy(&input, [40, 33, 36], waves);
    let pyramid = dir.path().join("pyramid.isospan");
    isospan::Reduction::of(input.as_path()).write(&pyramid).unwrap();
    let points = archive(dir.path(), SetKind::Halton);
    let ends = [39.0, 32.0, 35.0];
    let decimate = Some(Decimation { ratio: 0.15, ..Decimation::default() });
    for archive in [pyramid, points] {
        let file = dir.path().join("s.ply");
        let with = |refine: Refine| {
            query(&archive, 0.1).cap(true).refine(refine).write(&file).unwrap();
            read(&file)
        };
        let whole = caps(&with(Refine::default()), ends);
        assert!(whole.0 > 1000 && whole.2 == 0, "{whole:?}");
        for (refine, fewer) in [
            (Refine { decimate, ..Refine::default() }, true),
            (Refine { smooth: Some(10), ..Refine::default() }, false),
            (Refine { smooth: Some(10), decimate, ..Refine::default() }, true),
        ] {
            let mesh = with(refine);
            let (count, area, outside) = caps(&mesh, ends);
            let report = check(&mesh);
            assert!(report.is_closed() && report.is_manifold() && report.is_oriented(), "{report:?}");
            assert_eq!((outside, count < whole.0 / 3), (0, fewer), "{count} of {}", whole.0);
            assert!((area / whole.1 - 1.0).abs() < 0.01, "{area} {}", whole.1);
        }
    }
}

#[test]
fn smoothing_is_bounded_by_the_voxels_of_the_level() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.nhdr");
    let samples: Vec<u8> = (0..36 * 33 * 40i32)
        .map(|n| [n % 40, n / 40 % 33, n / 1320].map(|c| f64::from(c) / 20.0 - 1.0))
        .map(|[x, y, z]| u8::from(waves(x, y, z) > 0.1))
        .collect();
    fs::write(dir.path().join("waves.raw"), samples).unwrap();
    let head = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 40 33 36\nspacings: 0.5 2 3\nencoding: raw\ndata file: waves.raw\n\n";
    fs::write(&input, head).unwrap();
    let out = dir.path().join("waves.isospan");
    isospan::Reduction::of(input.as_path()).write(&out).unwrap();
    let file = dir.path().join("s.ply");
    query(&out, 0.5).write(&file).unwrap();
    let before = read(&file);
    let refine = |smooth_limit| Refine { smooth: Some(20), smooth_limit, ..Refine::default() };
    for (limit, most) in [(None, 0.25), (Some(0.1), 0.1)] {
        let report = query(&out, 0.5).refine(refine(limit)).write(&file).unwrap();
        let smoothing = report.surfaces[0].refined.smoothing.clone().unwrap();
        let after = read(&file);
        let off = |(a, b): (&isospan::surface::Vertex, &isospan::surface::Vertex)| {
            let squares = (0..3).map(|k| f64::from(a.position[k] - b.position[k]).powi(2));
            squares.sum::<f64>().sqrt()
        };
        let farthest = before.vertices.iter().zip(&after.vertices).map(off).fold(0.0, f64::max);
        assert_eq!(before.triangles, after.triangles);
        assert!(farthest > 0.9 * most && farthest < most * 1.001, "{farthest} {smoothing:?}");
        assert!((smoothing.allowed - most).abs() < 1e-12, "{smoothing:?}");
    }
    // An error of decimation is in world units on such a grid, too.
    let decimate = Some(Decimation { max_error: 0.05, ..Decimation::default() });
    let report = query(&out, 0.5).refine(Refine { decimate, ..Refine::default() }).write(&file).unwrap();
    let fewer = read(&file);
    assert!(report.triangles < before.triangles.len() as u64);
    let all = isospan::compare::CompareSettings::default();
    let apart = isospan::compare::compare(&before, &fewer, &all).unwrap();
    assert!(apart.hausdorff < 0.25, "{}", apart.hausdorff);
}
