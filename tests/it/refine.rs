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
        Refine { components: Some(filter), decimate: None },
        Refine { components: None, decimate: Some(ratio) },
    ] {
        let file = dir.path().join("none.ply");
        let refused = query(&archive, 0.1).refine(refine).write(&file);
        assert_eq!((refused.unwrap_err().exit_code(), file.exists()), (2, false));
    }
}
