//! A series is its steps: one mesh, and of each step what it would be alone. Appending is reducing
//! all at once. A bad step costs itself alone.

use crate::common::*;
use isospan::archive::manifest::Manifest;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{
    self, Amount, NanPolicy, ReduceReport, ReduceSettings, Roi, RunSettings, Step, StepChoice, StepRange,
};
use isospan::points::SetKind;
use isospan::sample::{Interpolation, Values};
use isospan::{Archive, Resources};
use std::fs;
use std::path::{Path, PathBuf};

const DIMS: [usize; 3] = [26, 22, 20];

/// Waves that drift and grow.
fn moving(t: usize) -> impl Fn(f64, f64, f64) -> f64 {
    let t = t as f64;
    move |x, y, z| waves(x + 0.02 * t, y, z) * (1.0 + 0.05 * t)
}

/// Steps as files, their times 0, 0.5, 1, ….
fn write_steps(dir: &Path, count: usize) -> Vec<StepSource> {
    let step = |t: usize| {
        let path = dir.join(format!("v{t}.npy"));
        write_npy(&path, DIMS, moving(t));
        StepSource::new(&path, &OpenOptions::default()).at(Some(0.5 * t as f64))
    };
    (0..count).map(step).collect()
}

fn few_points() -> ReduceSettings {
    ReduceSettings { keyframes: 3, ..settings(SetKind::Halton, Amount::Fraction(0.3), 900) }
}

fn few_points_of(fraction: f64) -> ReduceSettings {
    ReduceSettings { amount: Amount::Fraction(fraction), ..few_points() }
}

fn reduce_all(
    steps: &[StepSource],
    settings: &ReduceSettings,
    out: &Path,
    run: &RunSettings,
) -> ReduceReport {
    pipeline::reduce_series(steps, settings, out, run, &Silent).unwrap()
}

fn choice(number: u64) -> StepChoice {
    StepChoice::Number(number)
}

fn surface_at(archive: &Path, step: StepChoice, isovalue: f32, out: &Path) -> Vec<u8> {
    Archive::open(archive).unwrap().keeping(0).at(step).unwrap().query(isovalue).write(out).unwrap();
    fs::read(out).unwrap()
}

/// Whether two archives answer alike, at a step of each.
fn same_answers(dir: &Path, (a, step_a): (&Path, u64), (b, step_b): (&Path, u64)) {
    let open = |path, step| Archive::open(path).unwrap().at(choice(step)).unwrap();
    let (one, two) = (open(a, step_a), open(b, step_b));
    let bits = |a: &Step| a.sample([15, 14, 13]).unwrap().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&one), bits(&two));
    assert_eq!(one.value_range(), two.value_range());
    assert_eq!(one.spectrum().unwrap().knots, two.spectrum().unwrap().knots);
    for isovalue in [-0.7, 0.1, 0.123_456] {
        let count = |a: &Step| a.count(isovalue).unwrap().active_cells;
        assert_eq!(count(&one), count(&two));
        let surface = |path, step| surface_at(path, choice(step), isovalue, &dir.join("s.ply"));
        assert!(surface(a, step_a) == surface(b, step_b), "isovalue {isovalue}");
    }
}

/// Steps of one open archive share its files, and do not disturb each other.
#[test]
fn steps_of_an_open_archive_are_asked_in_turns() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 3);
    let out = dir.path().join("a.isospan");
    reduce_all(&steps, &few_points(), &out, &run(2));
    let archive = Archive::open(&out).unwrap();
    let choices = [choice(0), choice(2), StepChoice::Time(0.3), choice(1)];
    let alone = choices.clone().map(|c| Archive::open(&out).unwrap().at(c).unwrap().surface(0.1).unwrap());
    assert!(alone[0] != alone[1] && alone[0] != alone[2] && alone[1] != alone[3]);
    let open = choices.map(|c| archive.at(c).unwrap());
    for _ in 0..2 {
        // The second time from cached blocks.
        std::thread::scope(|threads| {
            for (step, alone) in open.iter().zip(&alone) {
                threads.spawn(move || assert!(step.surface(0.1).unwrap() == *alone));
            }
        });
    }
    assert!(archive.surface(0.1).unwrap() == alone[0], "an archive answers as its first step");
    assert_eq!(open.map(|step| step.number()), [0, 2, 0, 1]);
    assert_eq!(archive.step(3).err().unwrap().exit_code(), 2);
}

#[test]
fn each_step_is_what_it_is_alone() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 5);
    for bits in [None, Some(14.0)] {
        let settings = ReduceSettings { value_bits: bits, ..few_points() };
        let all = dir.path().join(format!("all{bits:?}.isospan"));
        let report = reduce_all(&steps, &settings, &all, &run(2));
        assert_eq!(
            report.steps.iter().map(|s| s.base).collect::<Vec<_>>(),
            [None, Some(0), Some(1), None, Some(3)]
        );
        check_archive(&all).unwrap();
        for (number, step) in (0..).zip(&steps) {
            let one = dir.path().join("one.isospan");
            let _ = fs::remove_dir_all(&one);
            reduce_all(std::slice::from_ref(step), &settings, &one, &run(2));
            same_answers(dir.path(), (&all, number), (&one, 0));
            let little = Resources::default().with_memory(1 << 28);
            let measured = measurement(&all, &step.path).step(number).resources(little).run().unwrap();
            let stored =
                |path, step| Archive::open(path).unwrap().step(step).unwrap().info().unwrap().error.unwrap();
            assert_eq!(measured.error, stored(&all, number));
            assert_eq!(measured.error, stored(&one, 0));
        }
    }
}

/// Steps are fitted together, and some have holes of their own: each is what it is alone, however
/// many are made at a time.
#[test]
fn steps_with_holes_are_fitted_as_alone() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 10);
    for (t, at) in [(2, 0.2), (3, 0.7), (8, 0.5)] {
        let hole = move |x: f64, y: f64, z: f64| (x - at).abs() + (y - 0.5).abs() + (z - 0.5).abs() < 0.3;
        let field = move |x, y, z| if hole(x, y, z) { f64::NAN } else { moving(t)(x, y, z) };
        write_npy(&steps[t].path, DIMS, field);
    }
    let out = |name: &str| dir.path().join(name);
    let settings = ReduceSettings { nan: NanPolicy::Mask, values: Some(Values::Fit), ..few_points() };
    let report = reduce_all(&steps, &settings, &out("all.isospan"), &run(2));
    let void = report.steps.iter().map(|s| s.void_points > 0).collect::<Vec<_>>();
    assert_eq!((0..10).filter(|&t| void[t]).collect::<Vec<_>>(), [2, 3, 8]);
    let small = RunSettings { resources: run(1).resources.with_memory(33 << 20), ..run(1) };
    reduce_all(&steps, &settings, &out("small.isospan"), &small);
    assert!(folder(&out("all.isospan")) == folder(&out("small.isospan")));
    reduce_all(&steps[..3], &settings, &out("grown.isospan"), &run(2));
    addition(&steps[3..], &run(2)).keyframes(3).append_to(out("grown.isospan")).unwrap();
    assert!(folder(&out("all.isospan")) == folder(&out("grown.isospan")));
    for number in [1, 2, 3, 8, 9] {
        let _ = fs::remove_dir_all(out("one.isospan"));
        let step = &steps[number as usize..=number as usize];
        reduce_all(step, &settings, &out("one.isospan"), &run(1));
        same_answers(dir.path(), (&out("all.isospan"), number), (&out("one.isospan"), 0));
    }
}

#[test]
fn values_near_those_before_take_fewer_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let step = |t: usize| {
        let path = dir.path().join(format!("n{t}.npy"));
        // Noise that stays, and a little change.
        let noise = |x: f64, y: f64, z: f64| (x * 9e4).sin() + (y * 7e4).sin() + (z * 8e4).cos();
        write_npy(&path, DIMS, |x, y, z| noise(x, y, z) + 1e-5 * t as f64 * x);
        StepSource::new(&path, &OpenOptions::default())
    };
    let steps: Vec<StepSource> = (0..4).map(step).collect();
    let bytes = |keyframes, out: &str| {
        let settings = ReduceSettings { keyframes, ..few_points() };
        reduce_all(&steps, &settings, &dir.path().join(out), &run(2))
            .steps
            .iter()
            .map(|s| s.value_bytes)
            .collect::<Vec<_>>()
    };
    let (alone, after) = (bytes(1, "a.isospan"), bytes(4, "b.isospan"));
    assert_eq!(alone[0], after[0]);
    assert!((1..4).all(|t| after[t] * 10 < alone[t] * 9), "{after:?} {alone:?}");
    for t in 0..4 {
        same_answers(dir.path(), (&dir.path().join("a.isospan"), t), (&dir.path().join("b.isospan"), t));
    }
}

#[test]
fn threads_memory_and_chunks_change_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 6);
    let out = |name: &str| dir.path().join(name);
    reduce_all(&steps, &few_points(), &out("a.isospan"), &run(1));
    let expected = folder(&out("a.isospan"));
    // With so little memory the steps are made a few at a time: the mesh is decoded for the later
    // ones.
    for (name, threads, memory) in [("b.isospan", 2, 24 << 20), ("c.isospan", 3, 1 << 30)] {
        reduce_all(
            &steps,
            &few_points(),
            &out(name),
            &RunSettings { resources: run(threads).resources.with_memory(memory), ..run(threads) },
        );
        assert!(folder(&out(name)) == expected, "{name}");
    }
    let settings = ReduceSettings { chunk_points: 100_000, ..few_points() };
    reduce_all(&steps, &settings, &out("d.isospan"), &run(2));
    for number in [0, 1, 5] {
        let triangles = |name: &str| {
            surface_at(&out(name), choice(number), 0.1, &out("s.ply"));
            triangle_set(&read(&out("s.ply")))
        };
        assert_eq!(triangles("a.isospan"), triangles("d.isospan"));
    }
}

#[test]
fn appending_is_reducing_all_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 7);
    let out = |name: &str| dir.path().join(name);
    for bits in [None, Some(12.0)] {
        let settings = ReduceSettings { value_bits: bits, ..few_points() };
        let (all, grown) = (out("all.isospan"), out("grown.isospan"));
        for archive in [&all, &grown] {
            let _ = fs::remove_dir_all(archive);
        }
        reduce_all(&steps, &settings, &all, &run(2));
        reduce_all(&steps[..2], &settings, &grown, &run(2));
        for (from, to) in [(2, 3), (3, 7)] {
            let report = addition(&steps[from..to], &run(1)).keyframes(3).append_to(&grown).unwrap();
            assert_eq!(report.steps.len(), to - from);
        }
        assert!(folder(&all) == folder(&grown), "{bits:?}");
        // Once more is not twice.
        let report = addition(&steps[3..7], &run(1)).keyframes(3).append_to(&grown).unwrap();
        assert!(report.steps.is_empty() && folder(&all) == folder(&grown));
        // The same file at another time is another step.
        let again = steps[6].clone().at(Some(9.0));
        let report = addition(&[again], &run(1)).keyframes(3).append_to(&grown).unwrap();
        assert_eq!(report.steps.iter().map(|s| (s.number, s.time)).collect::<Vec<_>>(), [(7, Some(9.0))]);
    }
}

/// On a mesh: fields of one file that come later, and files.
#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn appending_to_a_mesh_is_reducing_all_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let field = |name: &str| OpenOptions { field: Some(name.into()), ..OpenOptions::default() };
    let grow = |steps: &[StepSource], cuts: &[usize], settings: &ReduceSettings| {
        let out = |name: &str| dir.path().join(name);
        for name in ["all.isospan", "grown.isospan"] {
            let _ = fs::remove_dir_all(out(name));
        }
        reduce_all(steps, settings, &out("all.isospan"), &run(2));
        reduce_all(&steps[..cuts[0]], settings, &out("grown.isospan"), &run(2));
        for cut in cuts.windows(2) {
            let report = addition(&steps[cut[0]..cut[1]], &run(1))
                .keyframes(3)
                .append_to(out("grown.isospan"))
                .unwrap();
            assert_eq!(report.steps.len(), cut[1] - cut[0]);
        }
        assert!(folder(&out("all.isospan")) == folder(&out("grown.isospan")), "{cuts:?}");
        // Once more is not twice.
        let last = &steps[cuts[cuts.len() - 2]..];
        let report = addition(last, &run(1)).keyframes(3).append_to(out("grown.isospan")).unwrap();
        assert!(report.steps.is_empty() && folder(&out("all.isospan")) == folder(&out("grown.isospan")));
        check_archive(&out("grown.isospan")).unwrap();
    };
    let settings = ReduceSettings { amount: Amount::Fraction(1.0), ..few_points() };
    let path = shared_series("monodomain3d_tet_51steps.vtu");
    let steps = isospan::formats::steps_of(&[path], &field("V_*")).unwrap();
    grow(&steps, &[20, 21, 51], &settings);
    let rounded = ReduceSettings { value_bits: Some(12.0), ..settings.clone() };
    grow(&steps[..8], &[3, 8], &rounded);
    let folder = shared_series("heart_activation");
    let steps = isospan::formats::steps_of(&[folder.join("*.vtu")], &field("activation")).unwrap();
    let quadratic = ReduceSettings { interpolation: Interpolation::Quadratic, ..settings };
    grow(&steps, &[1, 3, 5], &quadratic);
}

/// As one reduction of the good steps, under their own numbers.
#[test]
fn a_bad_step_costs_itself_alone() {
    let dir = tempfile::tempdir().unwrap();
    let mut steps = write_steps(dir.path(), 6);
    let out = |name: &str| dir.path().join(name);
    // One of another size, one that is cut off, one with a hole that is met in the last chunk only.
    write_npy(&steps[1].path, [26, 22, 19], moving(1));
    let bytes = fs::read(&steps[2].path).unwrap();
    fs::write(&steps[2].path, &bytes[..bytes.len() / 2]).unwrap();
    write_npy(&steps[4].path, DIMS, |x, y, z| if x + y + z > 2.8 { f64::NAN } else { moving(4)(x, y, z) });
    for (bad, expected) in [(1, "step 1, dimensions"), (2, "step 2, "), (4, "step 4, sample near (2")] {
        let some = if bad == 4 { [&steps[3], &steps[4]] } else { [&steps[0], &steps[bad]] }.map(Clone::clone);
        let e =
            pipeline::reduce_series(&some, &few_points(), &out("x.isospan"), &run(2), &Silent).unwrap_err();
        let expected = expected.replace(&bad.to_string(), "1");
        assert!(e.to_string().contains(&expected) || bad == 4, "{e}");
        assert!(e.to_string().contains("step 1, ") && e.exit_code() == 5, "{e}");
        fs::remove_dir_all(out("x.isospan")).unwrap_or_default();
    }
    let keep_going = RunSettings { keep_going: true, ..run(2) };
    let report = reduce_all(&steps, &few_points(), &out("a.isospan"), &keep_going);
    let numbers = |r: &ReduceReport| r.steps.iter().map(|s| s.number).collect::<Vec<_>>();
    assert_eq!(numbers(&report), [0, 3, 5]);
    assert_eq!(report.skipped.iter().map(|s| s.number).collect::<Vec<_>>(), [1, 2, 4]);
    assert!(report.skipped.iter().all(|s| !s.reason.contains('\n')), "{:?}", report.skipped);
    check_archive(&out("a.isospan")).unwrap();
    assert_eq!(Manifest::read(&out("a.isospan")).unwrap().steps[2].plan.base.unwrap().number, 3);
    let left = folder(&out("a.isospan")).into_keys().any(|file| file.to_string_lossy().contains("000004-"));
    assert!(!left, "nothing is left of it");
    for number in [0, 3, 5] {
        let one = out("one.isospan");
        let _ = fs::remove_dir_all(&one);
        let step = &steps[number as usize..=number as usize];
        reduce_all(step, &few_points(), &one, &run(1));
        same_answers(dir.path(), (&out("a.isospan"), number), (&one, 0));
    }
    // The same again is the same, and what none can be made of is an error.
    reduce_all(
        &steps,
        &few_points(),
        &out("b.isospan"),
        &RunSettings { resources: keep_going.resources.clone().with_threads(1), ..keep_going.clone() },
    );
    assert!(folder(&out("a.isospan")) == folder(&out("b.isospan")));
    steps.drain(..1);
    let none = pipeline::reduce_series(&steps[1..2], &few_points(), &out("n.isospan"), &keep_going, &Silent);
    assert_eq!(none.unwrap_err().exit_code(), 5);
    // Further steps are refused in the same way.
    let e = addition(&steps[..1], &run(1)).append_to(out("a.isospan"));
    assert!(e.unwrap_err().to_string().contains("step 6, dimensions: expected 26 x 22 x 20, as step 0 has"));
}

#[test]
fn times_must_ascend() {
    let dir = tempfile::tempdir().unwrap();
    let mut steps = write_steps(dir.path(), 3);
    steps[2].time = Some(0.5);
    let out = dir.path().join("a.isospan");
    let e = pipeline::reduce_series(&steps, &few_points(), &out, &run(1), &Silent).unwrap_err();
    assert!(e.to_string().contains("step 1 is at 0.5, step 2 at 0.5") && e.exit_code() == 2, "{e}");
}

#[test]
fn between_two_steps_values_are_linear() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 3);
    let out = dir.path().join("a.isospan");
    reduce_all(&steps, &few_points(), &out, &run(2));
    let open = |step| Archive::open(&out).unwrap().at(step).unwrap();
    let sample = |step| open(step).sample([12, 11, 10]).unwrap();
    let (a, b) = (sample(choice(0)), sample(choice(1)));
    // The value at a corner is rounded, then those of the corners are weighted: a few last bits.
    for ((a, b), t) in a.iter().zip(&b).zip(sample(StepChoice::Time(0.125))) {
        assert!((0.75 * a + 0.25 * b - t).abs() < 1e-5, "{a} {b} {t}");
    }
    assert_eq!(sample(StepChoice::Time(0.5)), b);
    assert_eq!(sample(StepChoice::First), a);
    for isovalue in [-0.7, 0.1, 1.3] {
        let archive = open(StepChoice::Time(0.3));
        let file = dir.path().join("s.ply");
        surface_at(&out, StepChoice::Time(0.3), isovalue, &file);
        let found = archive.count(isovalue).unwrap();
        assert!(found.active_cells > 0 && !found.stored);
        let report = isospan::surface::check::check(&read(&file));
        assert!(report.is_manifold() && report.triangles as u64 >= found.active_cells, "{report:?}");
    }
    for (step, text) in [
        (StepChoice::Time(1.1), "the time 1.1 is not within 0 .. 1"),
        (StepChoice::Time(f64::NAN), "not within"),
        (choice(3), "no step 3; it has steps 0 to 2"),
    ] {
        let e = Archive::open(&out).unwrap().at(step).err().unwrap();
        assert!(e.to_string().contains(text) && e.exit_code() == 2, "{e}");
    }
    let e = open(StepChoice::Time(0.3)).spectrum().unwrap_err();
    assert!(e.to_string().contains("choose one with `step`"));
}

/// Damage of a step is found, and is damage of that step and of those that refer to it.
#[test]
fn a_damaged_step_does_not_hurt_others() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 4);
    let out = dir.path().join("a.isospan");
    reduce_all(&steps, &few_points(), &out, &run(2));
    let file = out.join("steps/000001-values-000000.seg");
    let good = fs::read(&file).unwrap();
    let answer = |step| Archive::open(&out)?.step(step)?.sample([9, 9, 9]);
    let expected: Vec<Vec<f64>> = (0..4).map(|s| answer(s).unwrap()).collect();
    let mut bad = good.clone();
    bad[100] ^= 4;
    fs::write(&file, &bad).unwrap();
    assert_eq!(answer(0).unwrap(), expected[0]);
    assert_eq!(answer(3).unwrap(), expected[3], "the next keyframe");
    assert_eq!(answer(1).unwrap_err().exit_code(), 5);
    assert_eq!(check_archive(&out).unwrap_err().exit_code(), 5);
    fs::remove_file(&file).unwrap();
    let e = answer(1).unwrap_err();
    assert!(e.exit_code() == 3 && e.to_string().contains("steps/000001-values-000000.seg"), "{e}");
    // The same reduction makes it again, and nothing else.
    reduce_all(&steps, &few_points(), &out, &run(1));
    assert!(fs::read(&file).unwrap() == good);
    assert_eq!(answer(2).unwrap(), expected[2]);
}

/// The same reduction once more finds nothing to make. If any file of the archive is lost, it makes
/// that file again. Another reduction does not touch what is there.
#[test]
fn the_same_reduction_makes_what_is_missing() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 3);
    let adapted = ReduceSettings { adapt: true, ..few_points() };
    for settings in [few_points(), adapted] {
        let out = dir.path().join("a.isospan");
        reduce_all(&steps, &settings, &out, &RunSettings { replace: true, ..run(2) });
        let whole = folder(&out);
        let again = |settings: &ReduceSettings, steps: &[StepSource]| {
            pipeline::reduce_series(steps, settings, &out, &run(2), &Silent)
        };
        let refused = |result: isospan::Result<ReduceReport>, text: &str| {
            let e = result.unwrap_err();
            assert!(e.to_string().contains(text) && e.exit_code() == 2, "{e}");
        };
        let report = again(&settings, &steps).unwrap();
        assert!(report.made_before && report.steps.len() == 3 && report.error.is_some());
        assert!(folder(&out) == whole);
        refused(again(&few_points_of(0.2), &steps), "exists; choose another name");
        refused(again(&settings, &steps[..2]), "exists; choose another name");
        let planned = |settings| pipeline::estimate_series(&steps, settings, &out, &run(2));
        assert!(planned(&settings).is_ok());
        let e = planned(&few_points_of(0.2)).unwrap_err();
        assert!(e.to_string().contains("exists; choose another name"), "{e}");
        assert!(folder(&out) == whole);
        let lost: Vec<PathBuf> =
            whole.keys().filter(|f| !f.ends_with("manifest.zst")).map(|f| out.join(f)).collect();
        assert!(lost.len() > 8, "{lost:?}");
        for path in &lost {
            fs::remove_file(path).unwrap();
            let there = folder(&out);
            refused(again(&few_points_of(0.2), &steps), "not made by this reduction alone");
            refused(again(&settings, &steps[..2]), "not made by this reduction alone");
            assert!(folder(&out) == there, "{path:?}");
            assert!(!again(&settings, &steps).unwrap().made_before);
            assert!(folder(&out) == whole, "{path:?}");
        }
        // One that was cut short is as good as lost.
        fs::OpenOptions::new().write(true).open(&lost[0]).unwrap().set_len(100).unwrap();
        assert!(!again(&settings, &steps).unwrap().made_before);
        assert!(folder(&out) == whole);
    }
}

fn shared_series(name: &str) -> PathBuf {
    shared_data().join("series").join(name)
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn frames_and_patterns_of_real_data() {
    let dir = tempfile::tempdir().unwrap();
    let reduce_pattern = |pattern: PathBuf, options: &OpenOptions, out: &Path| {
        let steps = isospan::formats::steps_of(&[pattern], options).unwrap();
        let report = reduce_all(&steps, &few_points(), out, &run(2));
        check_archive(out).unwrap();
        report
    };
    let path = shared_series("echo4d_f32_11frames.nii.gz");
    let out = dir.path().join("echo.isospan");
    let report = reduce_pattern(path.clone(), &OpenOptions::default(), &out);
    assert_eq!(report.steps.len(), 11);
    let one = dir.path().join("echo7.isospan");
    let options = OpenOptions { field: Some("t7".into()), ..OpenOptions::default() };
    // A field alone has no time, which files of surfaces state.
    let alone = StepSource::new(&path, &options).at(report.steps[7].time);
    reduce_all(&[alone], &few_points(), &one, &run(2));
    same_answers(dir.path(), (&out, 7), (&one, 0));
    let folder = shared_series("viscous_fingers_f32");
    let out = dir.path().join("fingers.isospan");
    let report = reduce_pattern(folder.join("*.vti"), &OpenOptions::default(), &out);
    assert_eq!(report.steps.len(), 8);
    assert_eq!(report.steps[7].source, "density_t080.vti");
}

#[test]
fn surfaces_of_many_steps_have_a_list() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 4);
    // One whose values do not reach the isovalue.
    write_npy(&steps[2].path, DIMS, |x, _, _| 0.01 * x);
    let archive = dir.path().join("a.isospan");
    reduce_all(&steps, &few_points(), &archive, &run(2));
    let all = Archive::open(&archive).unwrap().keeping(0).steps(..).unwrap();
    let out = dir.path().join("s_%03d.vtp");
    let report = all.query(0.5).write(&out).unwrap();
    assert_eq!(report.lists, [dir.path().join("s.pvd")]);
    assert_eq!(report.steps.iter().map(|s| s.skipped).collect::<Vec<_>>(), [false, false, true, false]);
    let listed = isospan::formats::steps_of(&report.lists, &OpenOptions::default()).unwrap();
    assert_eq!(listed.iter().map(|s| s.time).collect::<Vec<_>>(), [0.0, 0.5, 1.0, 1.5].map(Some));
    for (number, step) in (0..).zip(&listed) {
        let alone = surface_at(&archive, choice(number), 0.5, &dir.path().join("one.vtp"));
        assert!(fs::read(&step.path).unwrap() == alone, "{number}");
    }
    // What all steps share is read once: with little memory, where each is extracted by itself,
    // more is.
    let read = |memory| {
        let resources = Resources::default().with_memory(memory);
        let report = all.query(0.5).resources(resources).write(&out).unwrap();
        report.steps.iter().map(|s| s.report.bytes_read).sum::<u64>()
    };
    let passes = [1 << 30, 28 << 20, 24 << 20].map(read);
    assert!(passes[0] < passes[1] && passes[1] < passes[2], "{passes:?}");
    assert_eq!(report.steps[2].report.triangles, 0);
    let read = [1, 2].map(|n: usize| report.steps[n].report.bytes_read);
    assert!(read[1] < read[0], "{read:?}");
    let some = Archive::open(&archive).unwrap().steps(1..=2).unwrap();
    let report = some.query([0.5, -0.25]).write(dir.path().join("t%d_{}.ply")).unwrap();
    assert_eq!(report.lists, ["t_0.5.ply.series", "t_-0.25.ply.series"].map(|f| dir.path().join(f)));
    let listed = isospan::formats::steps_of(&report.lists[1..], &OpenOptions::default()).unwrap();
    assert_eq!(listed[1].path, dir.path().join("t2_-0.25.ply"));
    let none: StepRange = "7:".parse().unwrap();
    let e = Archive::open(&archive).unwrap().steps(none).err().unwrap();
    assert!(e.exit_code() == 2 && e.to_string().contains("it has steps 0 to 3"), "{e}");
    let spectra = all.spectra().unwrap();
    assert_eq!(
        spectra[3].spectrum.knots,
        Archive::open(&archive).unwrap().at(choice(3)).unwrap().spectrum().unwrap().knots
    );
}

/// A simulation on one tetrahedral mesh: all steps in one file; and one file a step.
#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn meshes_are_located_once_for_all_steps() {
    let dir = tempfile::tempdir().unwrap();
    let settings = ReduceSettings { amount: Amount::Fraction(1.0), ..few_points() };
    let field = |name: &str| OpenOptions { field: Some(name.into()), ..OpenOptions::default() };
    let path = shared_series("monodomain3d_tet_51steps.vtu");
    let steps = isospan::formats::steps_of(std::slice::from_ref(&path), &field("V_*")).unwrap();
    assert_eq!(steps.len(), 51);
    let out = dir.path().join("m.isospan");
    reduce_all(&steps, &settings, &out, &run(2));
    check_archive(&out).unwrap();
    for number in [0, 10, 50] {
        let one = dir.path().join("one.isospan");
        let _ = fs::remove_dir_all(&one);
        let step = StepSource::new(&path, &field(&format!("V_{number:06}")));
        reduce_all(&[step], &settings, &one, &run(2));
        // The first step is a constant that is no f32: the series is counted from it, and others
        // alone are not.
        let [of_series, alone] = [(&out, number), (&one, 0)]
            .map(|(archive, n)| Archive::open(archive).unwrap().at(choice(n)).unwrap());
        if of_series.offset() == alone.offset() {
            same_answers(dir.path(), (&out, number), (&one, 0));
        } else {
            let [a, b] = [of_series, alone].map(|archive| archive.sample([15, 14, 13]).unwrap());
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-4 || a.is_nan() && b.is_nan()));
        }
    }
    let folder = shared_series("heart_activation");
    let mut steps = isospan::formats::steps_of(&[folder.join("*.vtu")], &field("activation")).unwrap();
    assert_eq!(steps.len(), 5);
    steps.push(StepSource::new(&path, &field("V_000010")));
    let out = dir.path().join("h.isospan");
    let e = pipeline::reduce_series(&steps, &settings, &out, &run(2), &Silent).unwrap_err();
    assert!(e.to_string().contains("step 5, points: expected"), "{e}");
    let report = reduce_all(&steps, &settings, &out, &RunSettings { keep_going: true, ..run(2) });
    assert_eq!((report.steps.len(), report.skipped.len()), (5, 1));
    check_archive(&out).unwrap();
}

/// Several steps are extracted in one pass, as many as memory has room for: each surface is the one
/// that comes out alone.
#[test]
fn surfaces_of_steps_are_those_of_each_alone() {
    let dir = tempfile::tempdir().unwrap();
    let steps = write_steps(dir.path(), 5);
    // One without an answer, and one with a hole.
    write_npy(&steps[1].path, DIMS, |x, _, _| 0.01 * x + 10.0);
    let hole = |x: f64, y: f64, z: f64| (x - 0.4).abs() + (y - 0.5).abs() + (z - 0.5).abs() < 0.3;
    write_npy(&steps[3].path, DIMS, |x, y, z| if hole(x, y, z) { f64::NAN } else { moving(3)(x, y, z) });
    let region: Roi = "3:18,:,4:15".parse().unwrap();
    let questions = [(false, None), (true, None), (false, Some(region))];
    for (bits, keyframes) in [(None, 3), (Some(12.0), 16)] {
        let archive = dir.path().join(format!("a{keyframes}.isospan"));
        let settings = ReduceSettings { value_bits: bits, keyframes, nan: NanPolicy::Mask, ..few_points() };
        reduce_all(&steps, &settings, &archive, &run(2));
        for (cap, region) in questions {
            let alone = |step| {
                let step = Archive::open(&archive).unwrap().step(step).unwrap();
                step.query([0.5, -0.25]).cap(cap).region(region).meshes().unwrap()
            };
            let alone: Vec<_> = (0..5).map(alone).collect();
            assert!(alone[1][0].triangles.is_empty() != cap && alone[0] != alone[4]);
            for (threads, memory) in [(1, 1 << 30), (3, 1 << 30), (2, 40 << 20), (1, 27 << 20)] {
                let all = Archive::open(&archive).unwrap().steps(..).unwrap();
                let resources = Resources::default().with_threads(threads).with_memory(memory);
                let query = all.query([0.5, -0.25]).cap(cap).region(region).resources(resources);
                let mut next = 0;
                let compare = |step, time, surfaces: &mut Vec<_>| {
                    assert_eq!((step, time), (next, 0.5 * next as f64));
                    assert!(
                        *surfaces == alone[step as usize],
                        "step {step}, {threads} threads, {memory} bytes"
                    );
                    next += 1;
                    Ok(())
                };
                query.for_each(compare).unwrap();
                assert_eq!(next, 5);
            }
        }
    }
}

/// What was said of the first steps holds for further ones: the value that means "no data",
/// keyframes, the field of a file with several.
#[test]
fn appended_steps_take_over_what_was_said_of_the_first() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| dir.path().join(name);
    let steps = write_steps(dir.path(), 5);
    for (t, step) in steps.iter().enumerate() {
        let wave = moving(t);
        write_npy(&step.path, DIMS, |x, y, z| if x > 0.4 { -1e34 } else { wave(x, y, z) });
    }
    let settings = ReduceSettings { nan: NanPolicy::Mask, missing: Some(-1e34), ..few_points() };
    reduce_all(&steps, &settings, &out("all.isospan"), &run(2));
    reduce_all(&steps[..2], &settings, &out("grown.isospan"), &run(2));
    let append = |steps: &[StepSource], missing: Option<f64>| {
        addition(steps, &run(2)).missing(missing).append_to(out("grown.isospan")).unwrap()
    };
    append(&steps[2..3], None);
    let report = append(&steps[3..], None);
    assert!(report.range.is_some_and(|[lo, hi]| lo > -10.0 && hi < 10.0), "{:?}", report.range);
    assert!(folder(&out("all.isospan")) == folder(&out("grown.isospan")));
    // Another missing value that is given is that of the new step, and of those behind it; it is
    // measured without being given again.
    let other = StepSource::new(&out("o.npy"), &OpenOptions::default()).at(Some(9.0));
    write_npy(&other.path, DIMS, |x, y, z| if x > 0.4 { -9999.0 } else { waves(x, y, z) });
    let report = append(std::slice::from_ref(&other), Some(-9999.0));
    assert!(report.range.is_some_and(|[lo, _]| lo > -10.0), "{:?}", report.range);
    let little = Resources::default().with_memory(1 << 28);
    let measured = measurement(&out("grown.isospan"), &other.path).step(5).resources(little).run();
    assert_eq!(measured.unwrap().error, report.error.unwrap());

    let vti = |name: &str, t: f64| {
        let values = |f: fn(f64, f64) -> f64| {
            (0..64).map(|i| f(f64::from(i), t).to_string()).collect::<Vec<_>>().join(" ")
        };
        let array = |name: &str, values: String| {
            format!("<DataArray type=\"Float32\" Name=\"{name}\" format=\"ascii\">{values}</DataArray>")
        };
        let text = format!(
            "<?xml version=\"1.0\"?><VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\"><ImageData \
             WholeExtent=\"0 3 0 3 0 3\" Origin=\"0 0 0\" Spacing=\"1 1 1\"><Piece Extent=\"0 3 0 3 0 3\"><PointData>{}{}\
             </PointData></Piece></ImageData></VTKFile>",
            array("heat", values(|i, t| i + t)),
            array("salt", values(|i, t| 1000.0 + i + t))
        );
        fs::write(out(name), text).unwrap();
        out(name)
    };
    let salt = OpenOptions { field: Some("salt".into()), ..OpenOptions::default() };
    let first = StepSource::new(&vti("a.vti", 0.0), &salt);
    reduce_all(&[first], &few_points(), &out("salt.isospan"), &run(1));
    let next = StepSource::new(&vti("b.vti", 3.0), &OpenOptions::default());
    let report = addition(&[next], &run(1)).append_to(out("salt.isospan")).unwrap();
    assert_eq!(report.steps[0].field, "salt");
}

#[test]
fn a_field_of_another_name_is_no_step() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| dir.path().join(name);
    let image = |file: &str, field: &str, shift: f64| {
        let values: Vec<String> = (0..64).map(|i| (f64::from(i) + shift).to_string()).collect();
        let text = format!(
            "# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 4 4 4\nORIGIN 0 0 0\n\
             SPACING 1 1 1\nPOINT_DATA 64\nSCALARS {field} float 1\nLOOKUP_TABLE default\n{}\n",
            values.join(" ")
        );
        fs::write(out(file), text).unwrap();
        StepSource::new(&out(file), &OpenOptions::default())
    };
    let (heat, later) = (image("a.vtk", "heat", 0.0), image("b.vtk", "heat", 2.0));
    let salt = image("c.vtk", "salt", 1000.0);
    let archive = out("a.isospan");
    let both = [heat.clone(), salt.clone()];
    let reduced = pipeline::reduce_series(&both, &few_points(), &archive, &run(1), &Silent);
    let refused = reduced.unwrap_err().to_string();
    assert!(refused.contains("c.vtk: its field is salt, the field of step 0 is heat"), "{refused}");
    assert!(!archive.exists());

    reduce_all(&[heat], &few_points(), &archive, &run(1));
    let append = |source: &StepSource| addition(std::slice::from_ref(source), &run(1)).append_to(&archive);
    assert!(append(&salt).unwrap_err().to_string().contains("its field is salt"));
    assert_eq!(append(&later).unwrap().steps[0].field, "heat");
    let pattern = OpenOptions { field: Some("*".into()), ..OpenOptions::default() };
    let chosen = StepSource::new(&salt.path, &pattern);
    assert_eq!(append(&chosen).unwrap().steps[0].field, "salt");
}
