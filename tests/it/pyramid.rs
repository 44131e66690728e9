//! Volumes as wavelet pyramids: what was asked for is met, and all questions are those of samples.

use crate::common::*;
use isospan::exec::{CancelToken, Resources, Silent};
use isospan::formats::StepSource;
use isospan::pipeline::{self, Bound, LevelChoice, ReduceSettings, Roi, RunSettings, StepChoice, Target};
use isospan::points::SetKind;
use isospan::surface::TriMesh;
use isospan::surface::check::check;
use isospan::{Archive, Error};
use std::path::Path;
use std::process::Command;

fn pyramid(target: Option<Target>) -> ReduceSettings {
    ReduceSettings { points: Some(SetKind::Pyramid), target, ..ReduceSettings::default() }
}

fn rms(part: f64) -> ReduceSettings {
    pyramid(Some(Target::Rms(Bound::OfRange(part))))
}

/// A wave with noise and an edge.
fn rough(x: f64, y: f64, z: f64) -> f64 {
    let noise = (1e4 * (x + 3.7 * y + 9.1 * z).sin()).rem_euclid(1.0);
    waves(x, y, z) + 0.05 * noise + if ball(x, y, z) > 0.3 { 0.5 } else { 0.0 }
}

fn with_memory(memory: u64) -> RunSettings {
    RunSettings { resources: run(2).resources.with_memory(memory), ..run(2) }
}

#[test]
fn an_error_is_met_with_the_same_bytes_for_any_threads_and_memory() {
    let dir = tempfile::tempdir().unwrap();
    // Several chunks, a chunk with a sample more than its cells, a thin volume.
    for (n, dims) in [[300, 40, 34], [257, 30, 20], [20, 2, 600]].into_iter().enumerate() {
        let input = dir.path().join(format!("{n}.npy"));
        write_npy(&input, dims, rough);
        let mut archives = vec![];
        for (threads, memory) in [(1, 1 << 30), (2, 1 << 30), (2, 110 << 20)] {
            let out = dir.path().join(format!("{n}-{threads}-{memory}.isospan"));
            let run = RunSettings { resources: run(threads).resources.with_memory(memory), ..run(threads) };
            let sources = [StepSource::from(&*input)];
            let report = pipeline::reduce_series(&sources, &rms(0.02), &out, &run, &Silent).unwrap();
            let (error, target) = (report.error.clone().unwrap(), report.target.unwrap());
            assert!(target.met && error.rms >= 0.9 * target.bound, "{dims:?}: {target:?}");
            assert_eq!(error.measured, dims.iter().product::<usize>() as u64);
            let again = error_of(&out, &input);
            assert_eq!((again.rms, again.max), (error.rms, error.max), "the error that is stored");
            check_archive(&out).unwrap();
            archives.push(folder(&out));
        }
        assert!(archives.iter().all(|a| *a == archives[0]), "{dims:?}");
    }
}

/// Blocks of samples with one value, and a slope between them.
fn plateaus() -> StepSource {
    let sample = |i: usize| [0, 100, 200][i % 60 / 20] + if i / 60 % 50 < 10 { (i % 20) as i16 } else { 0 };
    let samples: Vec<i16> = (0..60 * 50 * 40).map(sample).collect();
    isospan::volume_of("plateaus", [60, 50, 40], samples).unwrap().into()
}

#[test]
fn an_isovalue_on_a_plateau_of_a_lossy_archive_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let made = |name: &str, target: Target| {
        let out = dir.path().join(name);
        let report = isospan::Reduction::of(plateaus()).target(target).write(&out).unwrap();
        (Archive::open(&out).unwrap(), report.error.unwrap().rms)
    };
    let (coarse, error) = made("coarse.isospan", Target::Rms(Bound::OfRange(0.01)));
    let found = coarse.plateau(100.0).unwrap().unwrap();
    assert!(found.share > 0.15 && found.error == error && found.between.is_none(), "{found:?}");
    assert_eq!(coarse.plateau(50.0).unwrap(), None);
    // A value between whole numbers, once the error keeps these apart.
    let (fine, _) = made("fine.isospan", Target::Rms(Bound::Value(0.1)));
    let found = fine.plateau(100.0).unwrap().unwrap();
    assert_eq!(found.between, Some(100.5));
    assert_eq!(fine.plateau(100.5).unwrap(), None);
    let (whole, _) = made("whole.isospan", Target::Lossless);
    assert_eq!(whole.plateau(100.0).unwrap(), None);
    let mut program = Command::new(env!("CARGO_BIN_EXE_isospan"));
    program.current_dir(dir.path()).args(["surface", "coarse.isospan", "-i", "100", "-o", "s.ply"]);
    let output = program.output().unwrap();
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && errors.contains("samples around the surface of 100 are"), "{errors}");
}

#[test]
fn decoded_nodes_are_kept_for_the_next_surface() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [90, 80, 70], rough);
    reduce(&input, &rms(0.01), &out, 2);
    // Tiles around a box are kept in any case.
    for (kept, most) in [(0, 48 << 20), (1 << 20, 50 << 20), (256 << 20, 256 << 20)] {
        let open = Archive::open(&out).unwrap().keeping(kept);
        assert_eq!(open.kept_bytes(), 0);
        let first = open.surface(0.3).unwrap();
        let bytes = open.kept_bytes();
        assert!(bytes > 0 && bytes <= most, "{kept}: {bytes}");
        assert!(open.surface(0.3).unwrap() == first);
        // All that the surface needs was there.
        assert!(kept < 256 << 20 || open.kept_bytes() == bytes, "{bytes}");
    }
}

#[test]
fn a_bound_of_each_sample_is_kept_and_whole_numbers_without_loss() {
    let dir = tempfile::tempdir().unwrap();
    let (input, whole) = (dir.path().join("a.npy"), dir.path().join("whole.npy"));
    write_npy(&input, [270, 33, 20], rough);
    write_npy(&whole, [270, 33, 20], |x, y, z| (100.0 * rough(x, y, z)).round());
    for part in [0.05, 0.002] {
        let out = dir.path().join(format!("{part}.isospan"));
        let report = reduce(&input, &pyramid(Some(Target::Max(Bound::OfRange(part)))), &out, 2);
        let target = report.target.unwrap();
        assert!(target.met && report.error.unwrap().max > 0.5 * target.bound, "{target:?}");
        assert_eq!(target.tries, 1);
        check_archive(&out).unwrap();
    }
    let out = dir.path().join("whole.isospan");
    let report = reduce(&whole, &pyramid(Some(Target::Lossless)), &out, 2);
    assert_eq!(report.error.unwrap().max, 0.0);
    let archive = Archive::open(&out).unwrap();
    assert!(samples(&archive, StepChoice::First).iter().all(|v| v.fract() == 0.0));
    check_archive(&out).unwrap();
    let sources = [StepSource::from(&*input)];
    let refused = pipeline::reduce_series(
        &sources,
        &pyramid(Some(Target::Lossless)),
        &dir.path().join("no.isospan"),
        &run(2),
        &Silent,
    );
    assert!(refused.unwrap_err().to_string().contains("whole numbers"));
}

/// Whether each cell of a grid has a node inside and one outside.
fn crossed(values: &[f64], dims: [u64; 3], isovalue: f64) -> u64 {
    let [nx, ny, nz] = dims.map(|n| n as usize);
    let at = |x: usize, y: usize, z: usize| values[(z * ny + y) * nx + x] >= isovalue;
    let mut count = 0;
    for z in 0..nz - 1 {
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                let corners =
                    [0, 1, 2, 3, 4, 5, 6, 7].map(|c| at(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2)));
                count += u64::from(corners.contains(&true) && corners.contains(&false));
            }
        }
    }
    count
}

#[test]
fn surfaces_are_those_of_the_samples() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [300, 40, 34], rough);
    reduce(&input, &rms(0.01), &out, 2);
    let archive = Archive::open(&out).unwrap();
    let values = samples(&archive, StepChoice::First);
    for isovalue in [-0.5, 0.1, 0.4] {
        let count = archive.count(isovalue).unwrap().active_cells;
        assert_eq!(count, crossed(&values, archive.dims(), isovalue), "{isovalue}");
        let closed = archive.query(isovalue).cap(true).mesh().unwrap();
        let checked = check(&closed);
        assert!(checked.is_closed() && checked.is_manifold(), "{isovalue}: {checked:?}");
        // A region has the same triangles, cut.
        let whole = archive.surface(isovalue).unwrap();
        let region: Roi = "20:280,:,5:".parse().unwrap();
        let part = archive.query(isovalue).region(region).mesh().unwrap();
        assert!(!part.triangles.is_empty() && part.triangles.len() < whole.triangles.len());
        // Neither threads nor memory show.
        let little = Resources::default().with_threads(1).with_memory(100 << 20);
        assert!(archive.query(isovalue).resources(little).mesh().unwrap() == whole);
    }
}

#[test]
fn levels_are_coarser_and_a_missing_one_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [64, 60, 70], ball);
    reduce(&input, &rms(0.002), &out, 2);
    let archive = Archive::open(&out).unwrap();
    let levels = archive.info().unwrap().pyramid;
    assert_eq!((levels[0].nodes, levels[1].nodes), ([64, 60, 70], [32, 30, 35]));
    let surface = |level| archive.query(0.1).level(LevelChoice::Level(level)).mesh();
    let area = |mesh: &TriMesh| check(mesh).area;
    let fine = surface(0).unwrap();
    for level in 1..4 {
        let coarse = surface(level).unwrap();
        let fewer = fine.triangles.len() as f64 / coarse.triangles.len() as f64;
        let expected = 4f64.powi(level as i32);
        assert!((0.7 * expected..1.5 * expected).contains(&fewer), "level {level}: {fewer}");
        assert!((0.9..1.1).contains(&(area(&coarse) / area(&fine))), "level {level}");
    }
    let error = surface(99).unwrap_err().to_string();
    assert!(error.contains("no level 99") && error.contains("0 (the finest) to"), "{error}");
}

#[test]
fn points_have_the_trilinear_mean_of_samples() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [140, 40, 34], rough);
    reduce(&input, &rms(0.01), &out, 2);
    let archive = Archive::open(&out).unwrap();
    let (values, dims) = (samples(&archive, StepChoice::First), archive.dims());
    let at = |p: [u64; 3]| values[((p[2] * dims[1] + p[1]) * dims[0] + p[0]) as usize];
    let places: Vec<[f64; 3]> = (0..500)
        .map(|i| [f64::from(i) * 0.277, f64::from(i * 7 % 39) + 0.25, f64::from(i * 11 % 33) + 0.75])
        .collect();
    let found = archive.probe(&places).unwrap();
    for (place, found) in places.iter().zip(found) {
        let (lo, t) = (place.map(|x| x as u64), place.map(f64::fract));
        let corner = |c: u64| {
            let high = [0, 1, 2].map(|a| c >> a & 1);
            let weight: f64 = (0..3).map(|a| if high[a] == 1 { t[a] } else { 1.0 - t[a] }).product();
            weight * at([0, 1, 2].map(|a| (lo[a] + high[a]).min(dims[a] - 1)))
        };
        let expected: f64 = (0..8).map(corner).sum();
        assert!((found - expected).abs() < 1e-5, "{place:?}: {found} {expected}");
    }
    assert!(archive.probe(&[[-5.0, 0.0, 0.0]]).unwrap()[0].is_nan());
}

#[test]
fn steps_of_a_series_are_made_together_or_one_after_another() {
    let dir = tempfile::tempdir().unwrap();
    let inputs: Vec<_> = (0..3).map(|t| dir.path().join(format!("{t}.npy"))).collect();
    for (t, input) in inputs.iter().enumerate() {
        write_npy(input, [60, 40, 34], |x, y, z| rough(x, y, z) * (1.0 + 0.2 * t as f64));
    }
    let sources: Vec<StepSource> = inputs.iter().map(|path| StepSource::from(&**path)).collect();
    let [together, grown] = ["together", "grown"].map(|name| dir.path().join(format!("{name}.isospan")));
    pipeline::reduce_series(&sources, &rms(0.01), &together, &run(2), &Silent).unwrap();
    pipeline::reduce_series(&sources[..1], &rms(0.01), &grown, &run(2), &Silent).unwrap();
    addition(&sources[1..], &run(2)).append_to(&grown).unwrap();
    let archive = Archive::open(&together).unwrap();
    let grown = Archive::open(&grown).unwrap();
    assert_eq!(samples(&grown, StepChoice::Number(2)).len(), 60 * 40 * 34);
    let [a, b] = [1, 2].map(|n| samples(&archive, StepChoice::Number(n)));
    let between = samples(&archive, StepChoice::Time(1.25));
    assert!((0..a.len()).all(|i| (between[i] - (0.75 * a[i] + 0.25 * b[i])).abs() < 1e-6));
    let surface = archive.at(StepChoice::Time(1.25)).unwrap().surface(0.1).unwrap();
    assert!(!surface.triangles.is_empty());
    check_archive(&together).unwrap();
}

/// Steps that change little, one that does not change, and one that has nothing in common with
/// others.
fn moving(dir: &Path, dims: [usize; 3]) -> Vec<StepSource> {
    let step = |t: usize| {
        let input = dir.join(format!("{t}.npy"));
        let shift = 0.004 * [0.0, 1.0, 2.0, 2.0, 3.0, 90.0, 91.0][t];
        write_npy(&input, dims, |x, y, z| waves(x + shift, y, z) + 0.2 * (rough(x, y, z) - waves(x, y, z)));
        StepSource::from(&*input)
    };
    (0..7).map(step).collect()
}

#[test]
fn steps_are_stored_as_what_changes() {
    let dir = tempfile::tempdir().unwrap();
    let sources = moving(dir.path(), [300, 40, 34]);
    let bound = Target::Max(Bound::Value(0.02));
    let out = |name: &str| dir.path().join(format!("{name}.isospan"));
    let of = |keyframes| ReduceSettings { keyframes, ..pyramid(Some(bound)) };
    let with = |threads, memory| RunSettings {
        resources: Resources::default().with_threads(threads).with_memory(memory),
        ..RunSettings::default()
    };
    let bytes = |name: &str| folder(&out(name)).values().map(Vec::len).sum::<usize>();
    for (keyframes, name) in [(1, "alone"), (3, "three"), (16, "all")] {
        let made = pipeline::reduce_series(&sources, &of(keyframes), &out(name), &run(2), &Silent).unwrap();
        assert!(made.steps.iter().all(|step| step.error.unwrap()[1] <= 0.02), "{name}");
        check_archive(&out(name)).unwrap();
    }
    assert!(bytes("all") < bytes("three") && bytes("three") < bytes("alone"));
    let sizes = [16, 1].map(|keyframes| {
        let settings = ReduceSettings { keyframes, ..rms(0.001) };
        pipeline::reduce_series(&sources, &settings, &out("rms"), &with(2, 1 << 30), &Silent).unwrap();
        let made = bytes("rms");
        std::fs::remove_dir_all(out("rms")).unwrap();
        made
    });
    assert!(10 * sizes[0] < 8 * sizes[1], "{sizes:?}");
    let expected = folder(&out("three"));
    for (threads, memory, name) in [(1, 1 << 30, "one"), (3, 200 << 20, "little")] {
        let run = with(threads, memory);
        pipeline::reduce_series(&sources, &of(3), &out(name), &run, &Silent).unwrap();
        assert!(folder(&out(name)) == expected, "{name}");
    }
    reduce_series_in_shards(&sources, &of(3), &out("shards"));
    assert!(folder(&out("shards")) == expected);
    pipeline::reduce_series(&sources[..1], &of(3), &out("grown"), &run(2), &Silent).unwrap();
    for added in [&sources[1..2], &sources[2..6], &sources[6..]] {
        addition(added, &run(2)).append_to(out("grown")).unwrap();
    }
    assert!(folder(&out("grown")) == expected);
    // A step by itself, and one after another; a box of it, and all.
    let archive = Archive::open(out("all")).unwrap();
    let mut steps = 0;
    let each = |number: u64, _: f64, meshes: &mut Vec<TriMesh>| {
        let alone = Archive::open(out("all"))?.step(number)?.query(0.4).meshes()?;
        assert!(*meshes == alone && !alone[0].triangles.is_empty(), "step {number}");
        steps += 1;
        Ok(())
    };
    archive.steps(..).unwrap().query(0.4).for_each(each).unwrap();
    assert_eq!(steps, 7);
}

#[test]
fn a_step_that_others_refer_to_can_be_lost_or_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let (sources, out) = (moving(dir.path(), [70, 40, 34]), dir.path().join("a.isospan"));
    let settings = pyramid(Some(Target::Max(Bound::Value(0.02))));
    pipeline::reduce_series(&sources[..4], &settings, &out, &run(2), &Silent).unwrap();
    let values = |n| samples(&Archive::open(&out).unwrap(), StepChoice::Number(n));
    let (before, last) = (folder(&out), values(3));
    // Step 3 cannot be read without step 1; it is made again from there.
    std::fs::remove_file(out.join("steps/000001-values-000000.seg")).unwrap();
    let asked = Archive::open(&out).unwrap().at(StepChoice::Number(3)).unwrap().surface(0.4);
    assert!(matches!(asked, Err(Error::Incomplete { .. })), "{:?}", asked.err());
    pipeline::reduce_series(&sources[..4], &settings, &out, &run(2), &Silent).unwrap();
    assert!(folder(&out) == before && values(3) == last);
    std::fs::copy(dir.path().join("6.npy"), dir.path().join("1.npy")).unwrap();
    addition(&sources[1..2], &run(2)).replace(true).append_to(&out).unwrap();
    check_archive(&out).unwrap();
    assert!(values(3) == last && values(1) != values(2));
    addition(&sources[4..5], &run(2)).append_to(&out).unwrap();
    check_archive(&out).unwrap();
    assert!(values(3) == last && values(4).len() == last.len());
}

/// A simulation often begins with nothing.
#[test]
fn a_first_step_that_is_constant_decides_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let inputs: Vec<_> = (0..3).map(|t| dir.path().join(format!("{t}.npy"))).collect();
    for (t, input) in inputs.iter().enumerate() {
        write_npy(input, [40, 33, 27], |x, y, z| 1e-3 * t as f64 * rough(x, y, z));
    }
    let sources: Vec<StepSource> = inputs.iter().map(|path| StepSource::from(&**path)).collect();
    let out = dir.path().join("a.isospan");
    let one_percent = Bound::OfRange(0.01);
    for target in [Target::Rms(one_percent), Target::Max(one_percent), Target::Max(Bound::Value(1e-5))] {
        let settings = pyramid(Some(target));
        let replaced = RunSettings { replace: true, ..run(2) };
        let made = pipeline::reduce_series(&sources, &settings, &out, &replaced, &Silent).unwrap();
        let found = made.target.unwrap();
        assert!(found.met && found.tries <= 2, "{target:?}: {found:?}");
        let alone = pipeline::reduce_series(&sources[..1], &settings, &out, &replaced, &Silent).unwrap();
        assert!(alone.target.unwrap().met && alone.steps[0].error.unwrap()[1] == 0.0, "{target:?}");
        // What is added has the bound of the first, or the usual error.
        let added = addition(&sources[1..], &run(2)).append_to(&out);
        for (n, step) in (1..).zip(added.unwrap().steps) {
            let [rms, max] = step.error.unwrap();
            let range = 4e-3 * f64::from(n);
            assert!(rms < 0.012 * range, "{target:?}: {rms} of {range}");
            assert!(target != Target::Max(Bound::Value(1e-5)) || max <= 1e-5, "{target:?}: {max}");
        }
        check_archive(&out).unwrap();
    }
}

#[test]
fn steps_that_are_added_keep_the_bound() {
    let dir = tempfile::tempdir().unwrap();
    let inputs: Vec<_> = (0..2).map(|t| dir.path().join(format!("{t}.npy"))).collect();
    for (t, input) in inputs.iter().enumerate() {
        write_npy(input, [40, 33, 27], |x, y, z| (90.0 * rough(x, y, z) * (1.0 + t as f64)).round());
    }
    let sources: Vec<StepSource> = inputs.iter().map(|path| StepSource::from(&**path)).collect();
    for (name, target, most) in
        [("lossless", Target::Lossless, 0.0), ("max", Target::Max(Bound::Value(1.5)), 1.5)]
    {
        let [together, grown] = ["a", "b"].map(|part| dir.path().join(format!("{name}-{part}.isospan")));
        pipeline::reduce_series(&sources, &pyramid(Some(target)), &together, &run(2), &Silent).unwrap();
        pipeline::reduce_series(&sources[..1], &pyramid(Some(target)), &grown, &run(2), &Silent).unwrap();
        let added = addition(&sources[1..], &run(2)).append_to(&grown);
        assert!(added.unwrap().steps.iter().all(|step| step.error.unwrap()[1] <= most), "{name}");
        assert!(folder(&together) == folder(&grown), "{name}");
    }
}

#[test]
fn shards_have_the_bytes_of_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("a.npy");
    // More chunks than a segment has.
    write_npy(&input, [4400, 12, 9], waves);
    let [whole, shards] = ["whole", "shards"].map(|name| dir.path().join(format!("{name}.isospan")));
    let settings = pyramid(Some(Target::Max(Bound::OfRange(0.01))));
    reduce(&input, &settings, &whole, 2);
    reduce_in_shards(&input, &settings, &shards);
    let [a, b] = [&whole, &shards].map(|out| folder(out));
    assert!(a.keys().eq(b.keys()) && a == b, "{:?}", b.keys());
}

#[test]
fn lost_files_are_made_again() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [60, 40, 34], rough);
    let settings = pyramid(Some(Target::Max(Bound::OfRange(0.05))));
    reduce(&input, &settings, &out, 2);
    let before = folder(&out);
    for name in before.keys().filter(|name| name.extension().is_some_and(|e| e == "seg")) {
        std::fs::remove_file(out.join(name)).unwrap();
        let open = Archive::open(&out).and_then(|archive| archive.surface(0.1));
        assert!(matches!(open, Err(Error::Incomplete { .. })), "{name:?}: {:?}", open.err());
        reduce(&input, &settings, &out, 2);
        assert!(folder(&out) == before, "{name:?}");
    }
}

#[test]
fn damage_is_an_error_or_the_right_answer() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [40, 30, 20], rough);
    reduce(&input, &pyramid(Some(Target::Max(Bound::OfRange(0.05)))), &out, 2);
    let answer = |out: &Path| -> isospan::Result<TriMesh> { Archive::open(out)?.surface(0.1) };
    let right = answer(&out).unwrap();
    let mut errors = 0;
    for (name, bytes) in folder(&out) {
        for at in (0..bytes.len()).step_by(7) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1 << (at % 8);
            std::fs::write(out.join(&name), &damaged).unwrap();
            match answer(&out) {
                Ok(found) => assert!(found == right, "{name:?} byte {at}"),
                Err(_) => errors += 1,
            }
        }
        std::fs::write(out.join(&name), &bytes).unwrap();
    }
    assert!(errors > 100 && answer(&out).unwrap() == right);
}

#[test]
fn what_asks_for_tetrahedra_or_points_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [40, 30, 20], waves);
    reduce(&input, &rms(0.01), &out, 2);
    let archive = Archive::open(&out).unwrap();
    let error = archive.active(0.1).unwrap().next().unwrap().unwrap_err().to_string();
    assert!(error.contains("is a pyramid of samples, which has no tetrahedra"), "{error}");
    assert!(archive.bounds(&CancelToken::new()).is_ok());
    let points = dir.path().join("points.isospan");
    let halton = ReduceSettings::exact(SetKind::Halton);
    reduce(&input, &halton, &points, 2);
    let level_1 = query(&points, 0.1).level(LevelChoice::Level(1));
    let error = level_1.mesh().unwrap_err().to_string();
    assert!(error.contains("is no pyramid: it has no levels"), "{error}");
    let refused = |settings: &ReduceSettings| {
        let out = dir.path().join("no.isospan");
        let sources = [StepSource::from(&*input)];
        pipeline::reduce_series(&sources, settings, &out, &with_memory(1 << 30), &Silent)
            .unwrap_err()
            .to_string()
    };
    assert!(refused(&ReduceSettings { target: Some(Target::Lossless), ..halton }).contains("only a pyramid"));
    let fine = pyramid(Some(Target::Rms(Bound::OfRange(1e-12))));
    assert!(refused(&fine).contains("below what f32 holds"), "{}", refused(&fine));
}

#[test]
fn a_spectrum_has_the_areas_of_surfaces() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.npy"), dir.path().join("a.isospan"));
    write_npy(&input, [60, 60, 60], ball);
    reduce(&input, &rms(0.002), &out, 2);
    let archive = Archive::open(&out).unwrap();
    let report = archive.spectrum().unwrap();
    let knot = &report.knots[report.knots.len() / 2];
    let mesh = archive.surface(knot.isovalue).unwrap();
    let area = check(&mesh).area;
    assert!((0.95..1.05).contains(&(knot.area / area)), "{knot:?} {area}");
    assert_eq!(knot.active_cells, archive.count(knot.isovalue).unwrap().active_cells);
}
