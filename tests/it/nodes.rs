//! Lattices with a node at each sample: only nodes have values of their own.

use crate::common::*;
use isospan::Archive;
use isospan::archive::manifest::Manifest;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{
    self, Amount, AppendSettings, Bound, MeasureSettings, NanPolicy, ReduceSettings, StepChoice, Target,
    UnpackSettings, ValueBits, unpack,
};
use isospan::points::SetKind;
use isospan::sample::Values;
use std::path::Path;

fn nodes(bits: f64, chunk_points: u64) -> ReduceSettings {
    ReduceSettings {
        values: Values::Nodes,
        value_bits: ValueBits::Bits(bits),
        ..settings(SetKind::Bcc, Amount::Fraction(0.125), chunk_points)
    }
}

fn noise(x: f64, y: f64, z: f64) -> f64 {
    (1e4 * (x + 3.7 * y + 9.1 * z).sin()).rem_euclid(1.0)
}

fn cut(x: f64, y: f64, z: f64) -> f64 {
    if ball(x + 0.4, y, z - 0.2) > 0.4 { f64::NAN } else { waves(x, y, z) }
}

/// The field at samples, as a program outside finds it.
fn error_of(archive: &Path, input: &Path) -> isospan::measure::FieldError {
    let settings = MeasureSettings { resources: run(2).resources, ..MeasureSettings::default() };
    pipeline::measure(archive, input, &OpenOptions::default(), &settings, &Silent).unwrap().error
}

#[test]
fn samples_come_back_within_half_a_step_however_they_are_cut() {
    let dir = tempfile::tempdir().unwrap();
    // Cells of 16 or not, two samples, a long axis.
    for (n, dims) in [[33, 20, 47], [16, 17, 18], [2, 40, 2], [120, 3, 5]].into_iter().enumerate() {
        let input = dir.path().join(format!("{n}.npy"));
        write_npy(&input, dims, |x, y, z| waves(x, y, z) + 0.1 * noise(x, y, z));
        let mut surfaces = vec![];
        for (chunk, threads) in [(3_000, 2), (3_000, 1), (1_000_000, 2)] {
            let out = dir.path().join(format!("{n}-{chunk}-{threads}.isospan"));
            let report = reduce(&input, &nodes(6.5, chunk), &out, threads);
            let error = report.error.unwrap();
            let bound = report.quantiser.unwrap().bound;
            assert!(error.max <= bound && error.max > 0.5 * bound, "{} of {bound}", error.max);
            assert_eq!(error.measured, dims.iter().product::<usize>() as u64);
            check_archive(&out).unwrap();
            surfaces.push(triangle_set(&Archive::open(&out).unwrap().surface(0.1).unwrap()));
        }
        let made = |threads| folder(&dir.path().join(format!("{n}-3000-{threads}.isospan")));
        assert!(made(1) == made(2), "threads");
        assert!(surfaces[0] == surfaces[2] && surfaces[0].len() > 10, "chunks");
    }
}

#[test]
fn whole_numbers_are_stored_as_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("bytes.npy"), dir.path().join("bytes.isospan"));
    let dims = [40usize, 33, 20];
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    let head = "{'descr': '|u1', 'fortran_order': False, 'shape': (20, 33, 40), }";
    bytes.extend(format!("{head:<117}\n").bytes());
    bytes.extend(
        (0..dims.iter().product::<usize>()).map(|i| ((i * i) % 251) as u8 | (u8::from(i == 0) * 255)),
    );
    std::fs::write(&input, bytes).unwrap();
    let report =
        reduce(&input, &ReduceSettings { value_bits: ValueBits::Bits(8.0), ..nodes(8.0, 9_000) }, &out, 2);
    assert_eq!((report.error.unwrap().max, report.quantiser.unwrap().parts), (0.0, 1));
    check_archive(&out).unwrap();
}

#[test]
fn holes_and_steps_are_read_as_they_are_made() {
    let dir = tempfile::tempdir().unwrap();
    let steps: Vec<StepSource> = (0..3)
        .map(|t| {
            let path = dir.path().join(format!("{t}.npy"));
            let moved = 0.05 * f64::from(t);
            write_npy(
                &path,
                [40, 36, 34],
                |x, y, z| if t == 1 { cut(x, y, z) } else { waves(x + moved, y, z) },
            );
            StepSource::new(&path, &OpenOptions::default()).at(Some(f64::from(t)))
        })
        .collect();
    let settings = ReduceSettings { nan: NanPolicy::Mask, ..nodes(7.0, 9_000) };
    let out = |name: &str| dir.path().join(name);
    let make = |steps: &[StepSource], name: &str, threads| {
        pipeline::reduce_series(steps, &settings, &out(name), &run(threads), &Silent).unwrap()
    };
    let all = out("all.isospan");
    make(&steps, "all.isospan", 2);
    make(&steps, "one.isospan", 1);
    assert!(folder(&all) == folder(&out("one.isospan")), "threads");
    make(&steps[..2], "grown.isospan", 2);
    pipeline::append(&steps[2..], &AppendSettings::default(), &out("grown.isospan"), &run(2), &Silent)
        .unwrap();
    assert!(folder(&all) == folder(&out("grown.isospan")), "appended");
    check_archive(&all).unwrap();
    for time in [0.0, 0.4, 1.0, 1.7] {
        let choice = StepChoice::Time(time);
        let archive = Archive::open(&all).unwrap().at(choice.clone()).unwrap();
        let surface = archive.surface(0.1).unwrap();
        assert!(surface.triangles.len() > 1_000, "{time}");
        if time == 1.0 {
            let settings = UnpackSettings { step: choice.clone(), ..UnpackSettings::default() };
            assert!(unpack(&all, &settings, &Silent).unwrap().files[0].blocks > 0);
            assert_eq!(surface, Archive::open(&all).unwrap().at(choice).unwrap().surface(0.1).unwrap());
        }
    }
    // What is stored of a step with a hole is what is found again.
    let alone = out("alone.isospan");
    let report = make(&steps[1..2], "alone.isospan", 2);
    assert!(report.void_points > 100, "{}", report.void_points);
    let (told, found) = (report.error.unwrap(), error_of(&alone, &steps[1].path));
    assert_eq!((told.rms, told.max, told.measured), (found.rms, found.max, found.measured));
    // And without one, where no tetrahedron is looked at.
    let report = make(&steps[..1], "whole.isospan", 2);
    let (told, found) = (report.error.unwrap(), error_of(&out("whole.isospan"), &steps[0].path));
    assert_eq!((told.rms, told.max, told.mean, told.worst), (found.rms, found.max, found.mean, found.worst));
}

#[test]
fn noise_has_its_samples_where_an_error_is_wanted() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("noise.npy");
    write_npy(&input, [40, 36, 32], |x, y, z| waves(x, y, z) + noise(x, y, z));
    for (n, target) in
        [Target::Rms(Bound::OfRange(0.03)), Target::Max(Bound::Value(0.1))].into_iter().enumerate()
    {
        let out = dir.path().join(format!("{n}.isospan"));
        let settings = ReduceSettings { target: Some(target), ..ReduceSettings::default() };
        let settings = ReduceSettings { points: Some(SetKind::Bcc), ..settings };
        let report = reduce(&input, &settings, &out, 2);
        let told = report.target.unwrap();
        assert!(told.met && told.reached > 0.9 * told.bound, "{told:?}");
        let manifest = Manifest::read(&out).unwrap();
        assert_eq!(manifest.steps[0].plan.values, Values::Nodes);
        assert_eq!(manifest.plan.lattice_cells(), Some([39, 35, 31]));
        check_archive(&out).unwrap();
        assert!(reduce(&input, &settings, &out, 2).made_before);
    }
}

#[test]
fn what_does_not_go_with_nodes_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("waves.npy"), dir.path().join("no.isospan"));
    write_npy(&input, [20, 20, 20], waves);
    let usual = nodes(8.0, 5_000);
    let wrong = [
        ReduceSettings { value_bits: ValueBits::Exact, ..usual.clone() },
        ReduceSettings { value_bits: ValueBits::Bits(22.0), ..usual.clone() },
        ReduceSettings { points: Some(SetKind::Halton), ..usual.clone() },
        ReduceSettings { target: Some(Target::Rms(Bound::OfRange(0.01))), ..usual.clone() },
    ];
    let mesh = dir.path().join("cells.vtk");
    write_hexahedra(&mesh, |x, y, z| x + y * z);
    let of_mesh = [(&mesh, usual)];
    for (input, settings) in wrong.map(|settings| (&input, settings)).into_iter().chain(of_mesh) {
        let sources = [StepSource::new(input, &OpenOptions::default())];
        let e = pipeline::reduce_series(&sources, &settings, &out, &run(2), &Silent).unwrap_err();
        assert!(matches!(e, isospan::Error::Usage(_)), "{e}");
        assert!(!out.exists());
    }
}

/// A mesh has no samples at nodes: an error that is not met is reported as that.
#[test]
fn a_mesh_is_searched_without_them() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("cells.vtk"), dir.path().join("cells.isospan"));
    write_hexahedra(&input, |x, y, z| (9.0 * x).sin() * (7.0 * y + z).cos());
    let settings = ReduceSettings {
        points: Some(SetKind::Bcc),
        target: Some(Target::Rms(Bound::OfRange(1e-5))),
        ..ReduceSettings::default()
    };
    let told = reduce(&input, &settings, &out, 2).target.unwrap();
    assert!(!told.met, "{told:?}");
    assert_eq!(Manifest::read(&out).unwrap().steps[0].plan.values, Values::Fit);
}
