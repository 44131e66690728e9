//! How wrong a surface is, at the end of a reduction, and as its target.

use crate::common::*;
use isospan::formats::StepSource;
use isospan::pipeline::{
    Committed, FieldValue, Length, ReduceReport, Shard, Shards, SurfaceErrors, SurfaceTarget, Target,
};
use isospan::points::SetKind;
use isospan::volume::units::Unit;
use isospan::{Addition, Archive, Reduction, Resources};
use std::path::Path;
use std::process::Command;

/// A volume of whole numbers, of a function of the sample's numbers; voxels of half a unit.
fn write_whole(path: &Path, dims: [u32; 3], f: impl Fn(f64, f64, f64) -> f64) {
    let [nx, ny, nz] = dims;
    let head = "NRRD0004\ntype: int16\ndimension: 3\nencoding: raw\nendian: little\nspacings: 0.5 0.5 0.5";
    let mut bytes = format!("{head}\nsizes: {nx} {ny} {nz}\n\n").into_bytes();
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                bytes.extend((f(f64::from(x), f64::from(y), f64::from(z)) as i16).to_le_bytes());
            }
        }
    }
    std::fs::write(path, bytes).unwrap();
}

/// Waves of a hundred.
fn hundreds(x: f64, y: f64, z: f64) -> f64 {
    (100.0 * waves(x / 20.0 - 1.0, y / 20.0 - 1.0, z / 20.0 - 1.0)).round()
}

/// A shell two voxels thick, in noise, next to a far brighter block; whole numbers.
fn shell(x: f64, y: f64, z: f64) -> f64 {
    if x < 10.0 && y < 10.0 && z < 10.0 {
        return 8000.0;
    }
    let from_shell = ((x - 36.0).powi(2) + (y - 31.5).powi(2) + (z - 27.3).powi(2)).sqrt() - 22.0;
    let hash = (x as u32).wrapping_mul(73_856_093)
        ^ (y as u32).wrapping_mul(19_349_663)
        ^ (z as u32).wrapping_mul(83_492_791);
    let noise = f64::from(hash.wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 24) - 0.5;
    (700.0 * (-from_shell * from_shell).exp() + 100.0 * noise).round()
}

const SHELL: f64 = 400.0;

fn within(distance: f64) -> Target {
    Target::Surface(SurfaceTarget { isovalue: FieldValue::At(SHELL), distance: Length::World(distance) })
}

fn made(input: &Path, out: &Path, target: Target) -> ReduceReport {
    Reduction::of(input).target(target).isovalues([SHELL]).write(out).unwrap()
}

/// What `measure` says of the surface.
fn measured(archive: &Path, input: &Path) -> SurfaceErrors {
    let archive = Archive::open(archive).unwrap();
    archive.measure(input).isovalues(SHELL).run().unwrap().surfaces.swap_remove(0)
}

#[test]
fn a_default_says_what_it_loses_and_a_target_keeps_it() {
    let dir = tempfile::tempdir().unwrap();
    let [input, usual, close] =
        ["v.nrrd", "usual.isospan", "close.isospan"].map(|name| dir.path().join(name));
    write_whole(&input, [72, 64, 56], shell);
    let report = Reduction::of(input.as_path()).isovalues([SHELL]).write(&usual).unwrap();
    let [lost] = &report.surfaces[..] else { panic!("{report:?}") };
    assert!(lost.archive.area < 0.7 * lost.source.area && lost.distance() > 1.0, "{lost:?}");
    assert_eq!(*lost, measured(&usual, &input), "by the same code");

    let report = made(&input, &close, within(0.1));
    let [kept] = &report.surfaces[..] else { panic!("{report:?}") };
    let target = report.target.unwrap();
    assert!(
        target.met && target.reached <= 0.1 && target.reached > 0.05 && target.bound == 0.1,
        "{target:?}"
    );
    assert!((2..=5).contains(&target.tries), "{target:?}");
    assert_eq!(*kept, measured(&close, &input));
    assert_eq!(kept.distance(), target.reached);
    let [a, b] = [kept.to_source.unwrap(), kept.to_archive.unwrap()];
    assert!(a.p99 <= 0.1 && b.p99 <= 0.1 && a.p95 <= a.p99 && b.mean < b.p95 && b.p99 <= b.max, "{kept:?}");
    assert!((kept.archive.area / kept.source.area - 1.0).abs() < 0.05, "{kept:?}");
    // Far less than all samples take.
    let whole = dir.path().join("whole.isospan");
    let whole =
        Reduction::of(input.as_path()).target(Target::Lossless).isovalues([SHELL]).write(whole).unwrap();
    assert!(
        report.archive_bytes < whole.archive_bytes * 2 / 3,
        "{} {}",
        report.archive_bytes,
        whole.archive_bytes
    );
    assert_eq!(whole.surfaces[0].distance(), 0.0);
}

#[test]
fn the_same_call_has_the_same_bytes_whatever_the_threads_and_memory() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("v.nrrd");
    write_whole(&input, [72, 64, 56], shell);
    let with = |name: &str, threads, memory| {
        let resources = Resources::default().with_threads(threads).with_memory(memory);
        let out = dir.path().join(name);
        let report =
            Reduction::of(input.as_path()).target(within(0.2)).resources(resources).write(&out).unwrap();
        (folder(&out), report.target.map(|t| (t.reached, t.tries)), report.surfaces)
    };
    let one = with("a.isospan", 1, 1 << 30);
    assert!(one == with("b.isospan", 3, 96 << 20));
    // It is there already: measured, and not made again.
    let out = dir.path().join("a.isospan");
    let again = made(&input, &out, within(0.2));
    assert!(again.made_before && again.target.unwrap().tries == 0 && again.surfaces == one.2);
    assert!(folder(&out) == one.0);
}

#[test]
fn a_distance_has_a_unit_and_a_target_below_all_is_met_by_the_samples() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_whole(&d.join("v.nrrd"), [40, 36, 32], hundreds);
    let run = |flags: &str| {
        let args =
            ["reduce", "-q", "--force", "v.nrrd", "-o", "v.isospan"].into_iter().chain(flags.split(' '));
        let done = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(d).args(args).output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (done.status.code().unwrap(), text(done.stdout), text(done.stderr))
    };
    let (code, out, err) = run("-i 10.5 --target-surface 200um --length-unit mm");
    assert!(code == 0 && out.contains("of 0.2 wanted") && out.contains("99 % within"), "{out}{err}");
    assert!(
        out.contains(" mm, largest") && out.contains("area") && out.contains("surface at 10.5\n"),
        "{out}"
    );
    // All samples of whole numbers, and their very surface.
    let (code, out, err) = run("-i 10.5 --target-surface 1e-9");
    assert!(code == 0 && out.contains("within 0 of 1e-9 wanted"), "{code} {out}{err}");
    let refused = |flags: &str, word: &str| {
        let (code, out, err) = run(flags);
        assert!(code == 2 && err.contains(word) && err.lines().count() == 1, "{flags}: {code} {out}{err}");
    };
    refused("-i 10.5 --target-surface 0.1mm", "unit of lengths");
    refused("-i 10.5,20 --target-surface 0.1", "one --isovalue");
    refused("-i 1e6 --target-surface 0.1", "no surface at 1000000");
    refused("-i 10.5 --target-surface 0.1 --points halton", "--target-surface");
    refused("-i 10.5 --labels", "labels are names");
    refused("--target-surface 0.1", "--isovalue");
    assert!(!d.join("v.isospan.work").exists());
    write_mesh(&d.join("m.vtk"), 6, |_| true, |p| p, |p| waves(p[0], p[1], p[2]));
    let mesh = Reduction::of(d.join("m.vtk")).isovalues([0.1]).write(d.join("m.isospan"));
    assert!(mesh.unwrap_err().to_string().contains("the source is a mesh") && !d.join("m.isospan").exists());
}

/// Makes what is planned, and the tries after it.
fn finished(out: &Path, shards: u64) -> ReduceReport {
    let planned = Shards::at(out);
    loop {
        for n in 0..shards {
            planned.work(Shard::new(n, shards).unwrap()).unwrap();
        }
        if let Committed::Archive(report) = planned.commit().unwrap() {
            return *report;
        }
    }
}

#[test]
fn a_distance_is_kept_by_shards_as_by_one_process() {
    let dir = tempfile::tempdir().unwrap();
    let [input, whole, parts, other] =
        ["v.nrrd", "whole.isospan", "parts.isospan", "other.isospan"].map(|name| dir.path().join(name));
    write_whole(&input, [72, 64, 56], shell);
    let one = made(&input, &whole, within(0.1));
    let reduction = Reduction::of(input.as_path()).target(within(0.1)).isovalues([SHELL]);
    let plan = reduction.plan_shards(&parts, 3).unwrap();
    let shared = finished(&parts, plan.shards);
    assert!(folder(&parts) == folder(&whole));
    let came = |report: &ReduceReport| report.target.map(|t| (t.reached, t.bound, t.met, t.tries));
    assert_eq!((came(&shared), &shared.surfaces), (came(&one), &one.surfaces));
    assert!(came(&one).unwrap().3 > 1, "{one:?}");
    // The commit of what is published is asked again.
    let Committed::Archive(again) = Shards::at(&parts).commit().unwrap() else { panic!("it is over") };
    assert_eq!((came(&again), &again.surfaces), (came(&one), &one.surfaces));
    // Without a target, surfaces are measured as well.
    let usual = Reduction::of(input.as_path()).isovalues([SHELL, 300.0]);
    let plan = usual.plan_shards(&other, 2).unwrap();
    let shared = finished(&other, plan.shards);
    let report = usual.write(dir.path().join("usual.isospan")).unwrap();
    assert!(shared.surfaces == report.surfaces && shared.surfaces.len() == 2, "{shared:?}");
    // What cannot be measured is refused before anything is made.
    write_mesh(&dir.path().join("m.vtk"), 6, |_| true, |p| p, |p| waves(p[0], p[1], p[2]));
    let mesh = dir.path().join("m.isospan");
    let plan = Reduction::of(dir.path().join("m.vtk")).isovalues([0.1]).plan_shards(&mesh, 2);
    assert!(plan.unwrap_err().to_string().contains("the source is a mesh") && !mesh.exists());
}

#[test]
fn further_steps_are_judged_by_a_distance() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("s.isospan");
    let step = |name: &str, time: f64, noise: f64| {
        let path = dir.path().join(name);
        write_whole(&path, [72, 64, 56], |x, y, z| shell(x, y, z) + noise * hundreds(x, y, z));
        StepSource::from(path.as_path()).at(Some(time))
    };
    let [first, near, between] = [("a.nrrd", 0.0, 0.0), ("b.nrrd", 2.0, 0.1), ("c.nrrd", 1.0, 0.2)]
        .map(|(name, time, noise)| step(name, time, noise));
    Reduction::of_steps([first]).target(within(0.25)).write(&out).unwrap();
    let add = |source: &StepSource, distance: f64| {
        let addition = Addition::of_steps([source.clone()]).isovalues([SHELL]);
        addition.judged_by(within(distance)).append_to(&out).unwrap()
    };
    let (far, none) = (add(&near, 1.0), add(&between, 1e-6));
    let of_step = |source: &StepSource, n: u64| {
        let archive = Archive::open(&out).unwrap();
        archive.measure(source.clone()).step(n).isovalues(SHELL).run().unwrap().surfaces.swap_remove(0)
    };
    // The first addition was step 1, until another one came before it.
    let mut found = of_step(&near, 2);
    assert_eq!(found.step, 2);
    found.step = 1;
    assert_eq!(far.surfaces, [found.clone()]);
    let target = far.target.unwrap();
    assert!(target.met && target.bound == 1.0 && target.reached == found.distance() && target.tries == 0);
    assert_eq!(none.surfaces, [of_step(&between, 1)]);
    assert!(!none.target.unwrap().met && none.surfaces[0].step == 1, "{none:?}");
    // Each is compared with its own samples, whatever the order, and what is there already.
    let [late, early] =
        [("e.nrrd", 5.0, 0.3), ("f.nrrd", 0.5, 0.05)].map(|(name, time, n)| step(name, time, n));
    let several = [&near, &late, &early].map(StepSource::clone);
    let added = Addition::of_steps(several.clone()).isovalues([SHELL]).append_to(&out).unwrap();
    let worst = [of_step(&early, 1), of_step(&late, 4)].into_iter();
    let worst = worst.max_by(|a, b| a.distance().total_cmp(&b.distance())).unwrap();
    assert_eq!((&added.surfaces[..], added.steps.len()), (&[worst][..], 2));
    // What is there is measured once more, at a place in the range, too.
    let again = Addition::of(late.clone()).isovalues([SHELL]).append_to(&out).unwrap();
    assert!(again.made_before && again.surfaces == [of_step(&late, 4)], "{again:?}");
    let middle = Addition::of(late).isovalues([FieldValue::Share(0.5)]).append_to(&out).unwrap();
    assert!(middle.surfaces[0].isovalue > 1000.0, "{middle:?}");
    // A distance in a unit that the archive does not know is no target that is met.
    let metric = Length::of(1.0, &Unit::length("mm").unwrap()).unwrap();
    let target = Target::Surface(SurfaceTarget { isovalue: FieldValue::At(SHELL), distance: metric });
    let refused = Addition::of(step("d.nrrd", 3.0, 0.0)).judged_by(target).append_to(&out);
    assert!(refused.unwrap_err().to_string().contains("unit of lengths"));
    assert_eq!(Archive::open(&out).unwrap().info().unwrap().steps.len(), 5, "nothing was added");
    // Another isovalue does not decide about the target.
    let other = Addition::of(step("g.nrrd", 6.0, 0.0)).isovalues([7000.0, SHELL]);
    let other = other.judged_by(within(1.0)).append_to(&out).unwrap();
    assert!(other.target.unwrap().reached == other.surfaces[1].distance() && other.surfaces.len() == 2);
}

#[test]
fn of_a_series_the_worst_step_is_told_and_kept() {
    let dir = tempfile::tempdir().unwrap();
    let steps: Vec<StepSource> = [0.0, 30.0, 10.0]
        .into_iter()
        .map(|amount| {
            let path = dir.path().join(format!("v{amount}.nrrd"));
            write_whole(&path, [72, 64, 56], |x, y, z| shell(x, y, z) + amount / 100.0 * hundreds(x, y, z));
            StepSource::from(path.as_path())
        })
        .collect();
    let out = dir.path().join("s.isospan");
    let reduction = Reduction::of_steps(steps.clone()).target(within(0.25));
    let report = reduction.isovalues([SHELL, 300.0]).write(&out).unwrap();
    assert!(report.target.unwrap().met && report.surfaces.len() == 2, "{report:?}");
    let archive = Archive::open(&out).unwrap();
    let of_step = |n: u64| {
        let measurement = archive.measure(steps[n as usize].clone()).step(n).isovalues(SHELL);
        measurement.run().unwrap().surfaces.swap_remove(0)
    };
    let all: Vec<SurfaceErrors> = (0..3).map(of_step).collect();
    let worst = all.iter().map(SurfaceErrors::distance).fold(0.0, f64::max);
    assert!(worst <= 0.25 && report.surfaces[0].distance() == worst, "{all:?}");
    assert_eq!(all[report.surfaces[0].step as usize], report.surfaces[0]);
    // Points of a volume are measured, too; nothing is searched for.
    let halton = dir.path().join("h.isospan");
    let points = Reduction::of(steps[0].clone()).points(SetKind::Halton).fraction(0.25);
    let report = points.isovalues([SHELL]).write(halton).unwrap();
    assert!(report.surfaces[0].archive.triangles > 0 && report.surfaces[0].to_archive.is_some());
}

#[test]
fn a_step_without_the_surface_is_no_reason_to_refuse_a_series() {
    let dir = tempfile::tempdir().unwrap();
    let [empty, full] = ["a.nrrd", "b.nrrd"].map(|name| dir.path().join(name));
    write_whole(&empty, [40, 36, 32], |_, _, _| 0.0);
    write_whole(&full, [40, 36, 32], hundreds);
    let target =
        Target::Surface(SurfaceTarget { isovalue: FieldValue::At(10.5), distance: Length::World(0.05) });
    let steps = [&empty, &full].map(|path| StepSource::from(path.as_path()));
    let report = Reduction::of_steps(steps).target(target).write(dir.path().join("s.isospan")).unwrap();
    assert!(report.target.unwrap().met && report.surfaces[0].step == 1, "{report:?}");
    let alone = Reduction::of(empty.as_path()).target(target).write(dir.path().join("a.isospan"));
    assert!(alone.unwrap_err().to_string().contains("no surface at 10.5"));
}

#[test]
fn where_f32_holds_no_smaller_error_the_best_try_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("kelvin.npy");
    write_npy(&input, [24, 20, 16], |x, y, z| 285.0 + 0.01 * waves(x, y, z));
    let distance = Length::World(1e-9);
    let target = Target::Surface(SurfaceTarget { isovalue: FieldValue::At(285.001), distance });
    let out = dir.path().join("kelvin.isospan");
    let found = Reduction::of(input.as_path()).target(target).write(&out).unwrap().target.unwrap();
    assert!(!found.met && found.reached < 0.1 && found.tries <= 10, "{found:?}");
    check_archive(&out).unwrap();
}
