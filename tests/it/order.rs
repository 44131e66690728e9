//! Steps are in the order of their times, whatever the order in which they came: a step between
//! others goes between them, one of a time that is there is refused, or takes its place.

use crate::common::*;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{self, Amount, ReduceReport, ReduceSettings, StepChoice};
use isospan::points::SetKind;
use isospan::{Archive, Result};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

const DIMS: [usize; 3] = [18, 15, 13];

fn step(dir: &Path, name: &str, time: f64) -> StepSource {
    let path = dir.join(name);
    write_npy(&path, DIMS, |x, y, z| waves(x + 0.02 * time, y, z) * (1.0 + 0.05 * time));
    StepSource::new(&path, &OpenOptions::default()).at(Some(time))
}

fn steps(dir: &Path, times: &[f64]) -> Vec<StepSource> {
    times.iter().map(|time| step(dir, &format!("v{time}.npy"), *time)).collect()
}

fn few_points(bits: Option<f64>) -> ReduceSettings {
    let settings = settings(SetKind::Halton, Amount::Fraction(0.3), 500);
    ReduceSettings { keyframes: 8, value_bits: bits, ..settings }
}

fn reduce(steps: &[StepSource], bits: Option<f64>, out: &Path) {
    let _ = fs::remove_dir_all(out);
    pipeline::reduce_series(steps, &few_points(bits), out, &run(2), &Silent).unwrap();
}

fn append(steps: &[StepSource], replace: bool, out: &Path) -> Result<ReduceReport> {
    addition(steps, &run(2)).replace(replace).append_to(out)
}

/// The numbers and times of an archive's steps.
fn order(archive: &Path) -> Vec<(u64, f64)> {
    let steps = Archive::open(archive).unwrap().info().unwrap().steps;
    steps.iter().map(|s| (s.number, s.time.unwrap())).collect()
}

fn samples(archive: &Path, choice: StepChoice) -> Vec<u64> {
    let step = Archive::open(archive).unwrap().at(choice).unwrap();
    step.sample([11, 10, 9]).unwrap().into_iter().map(f64::to_bits).collect()
}

/// Each step is what it is alone.
fn are_alone(dir: &Path, archive: &Path, sources: &[&StepSource], bits: Option<f64>) {
    check_archive(archive).unwrap();
    for (number, source) in (0..).zip(sources) {
        let one = dir.join("one.isospan");
        reduce(std::slice::from_ref(*source), bits, &one);
        let expected = samples(&one, StepChoice::First);
        assert!(samples(archive, StepChoice::Number(number)) == expected, "step {number}");
        assert!(samples(archive, StepChoice::Time(source.time.unwrap())) == expected, "step {number}");
    }
}

#[test]
fn a_step_between_others_goes_between_them() {
    let dir = tempfile::tempdir().unwrap();
    let (dir, out) = (dir.path(), dir.path().join("a.isospan"));
    let all = steps(dir, &[-1.0, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0]);
    for bits in [None, Some(12.0)] {
        reduce(&[all[1].clone(), all[3].clone(), all[5].clone()], bits, &out);
        let before = folder(&out);
        // In any order, behind the archive and between its steps.
        let report = append(&[all[6].clone(), all[2].clone(), all[4].clone()], false, &out).unwrap();
        let added: Vec<_> = report.steps.iter().map(|s| (s.number, s.time.unwrap())).collect();
        assert_eq!(added, [(1, 0.5), (3, 1.5), (5, 3.0)]);
        assert_eq!(order(&out), [(0, 0.0), (1, 0.5), (2, 1.0), (3, 1.5), (4, 2.0), (5, 3.0)]);
        let after = folder(&out);
        let kept =
            |(file, bytes): (&PathBuf, &Vec<u8>)| file.ends_with("manifest.zst") || after[file] == *bytes;
        assert!(before.iter().all(kept), "no file of the archive was touched");
        append(&all[..1], false, &out).unwrap();
        let sources: Vec<&StepSource> = all.iter().collect();
        are_alone(dir, &out, &sources, bits);
        // Once more is not twice.
        let whole = folder(&out);
        assert!(append(&all[..4], false, &out).unwrap().steps.is_empty());
        assert!(folder(&out) == whole);
        // Between two steps values are those of both.
        let half = samples(&out, StepChoice::Time(0.25)).into_iter().map(f64::from_bits);
        let ends = [1, 2].map(|n| samples(&out, StepChoice::Number(n)));
        for (n, half) in half.enumerate() {
            let [a, b] = [&ends[0], &ends[1]].map(|values| f64::from_bits(values[n]));
            assert!((0.5 * (a + b) - half).abs() < 1e-5, "{a} {b} {half}");
        }
    }
}

#[test]
fn a_time_that_is_there_is_refused_or_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let (dir, out) = (dir.path(), dir.path().join("a.isospan"));
    let mut all = steps(dir, &[0.0, 0.5, 1.0, 1.5]);
    for bits in [None, Some(12.0)] {
        reduce(&all, bits, &out);
        let whole = folder(&out);
        // The first, one to which others refer, and the last.
        for (round, n) in [1, 0, 3, 1].into_iter().enumerate() {
            let mut other = step(dir, &format!("again{round}.npy"), 7.0 + round as f64);
            other.time = all[n].time;
            let e = append(&[other.clone()], false, &out).unwrap_err();
            let text = e.to_string();
            assert!(e.exit_code() == 2 && text.contains("`replace_steps=true`"), "{text}");
            assert!(text.contains(&format!("that of step {n} already")), "{text}");
            let report = append(&[other.clone()], true, &out).unwrap();
            assert_eq!((report.replaced, report.steps[0].number), (vec![n as u64], n as u64));
            all[n] = other;
            let sources: Vec<&StepSource> = all.iter().collect();
            are_alone(dir, &out, &sources, bits);
            assert!(append(&[all[n].clone()], true, &out).unwrap().steps.is_empty(), "once is enough");
        }
        assert_eq!(order(&out), [(0, 0.0), (1, 0.5), (2, 1.0), (3, 1.5)]);
        // Files of the old steps are there until they are collected.
        let lost = whole.keys().filter(|file| !folder(&out).contains_key(*file)).count();
        assert!(pipeline::collect_garbage(&out, Duration::from_secs(3600), false).unwrap().files.is_empty());
        let collected = pipeline::collect_garbage(&out, Duration::ZERO, false).unwrap().files;
        assert!(!collected.is_empty() && lost <= whole.len(), "{collected:?}");
        let sources: Vec<&StepSource> = all.iter().collect();
        are_alone(dir, &out, &sources, bits);
        // What comes next may refer to what is there.
        let next = step(dir, "next.npy", 2.0);
        append(std::slice::from_ref(&next), false, &out).unwrap();
        let sources: Vec<&StepSource> = all.iter().chain([&next]).collect();
        are_alone(dir, &out, &sources, bits);
        all = steps(dir, &[0.0, 0.5, 1.0, 1.5]);
    }
}

/// Of a file without a time the name decides what is replaced.
#[test]
fn a_file_without_a_time_replaces_that_of_its_name() {
    let dir = tempfile::tempdir().unwrap();
    let (dir, out) = (dir.path(), dir.path().join("a.isospan"));
    let mut all = steps(dir, &[0.0, 1.0, 2.0]);
    all.iter_mut().for_each(|step| step.time = None);
    reduce(&all, None, &out);
    write_npy(&all[1].path, DIMS, |x, y, z| waves(x + 0.3, y, z));
    let report = append(&all[1..2], true, &out).unwrap();
    assert_eq!((report.replaced, report.steps[0].number), (vec![1], 1));
    let values = samples(&out, StepChoice::Number(1));
    assert!(samples(&out, StepChoice::Time(1.0)) == values);
    let one = dir.join("one.isospan");
    reduce(&all[1..2], None, &one);
    assert!(values == samples(&one, StepChoice::First));
    check_archive(&out).unwrap();
    // A program may give every step the same name.
    write_npy(&all[1].path, DIMS, |x, y, z| waves(x + 0.4, y, z));
    assert_eq!(append(&all[1..2], false, &out).unwrap().steps[0].number, 3);
    // A time says where a step goes, and a number does not.
    let e = append(&[step(dir, "t.npy", 0.5)], false, &out).unwrap_err().to_string();
    assert!(e.contains("times must ascend"), "{e}");
}

/// The first step has the coordinates of a grid, also when others come before it or in its place.
#[test]
fn coordinates_stay_with_the_files_that_have_them() {
    let dir = tempfile::tempdir().unwrap();
    let (dir, out) = (dir.path(), dir.path().join("g.isospan"));
    let grid = |name: &str, time: f64, shift: f64| {
        let values: Vec<String> = (0..64).map(|i| (f64::from(i) + shift).to_string()).collect();
        let axis = |scale: f64| {
            let places: Vec<String> = [0.0, 1.0, 3.0, 7.0].iter().map(|x| (x * scale).to_string()).collect();
            places.join(" ")
        };
        let text = format!(
            "# vtk DataFile Version 3.0\nx\nASCII\nDATASET RECTILINEAR_GRID\nDIMENSIONS 4 4 4\n\
             X_COORDINATES 4 float\n{}\nY_COORDINATES 4 float\n{}\nZ_COORDINATES 4 float\n{}\n\
             POINT_DATA 64\nSCALARS heat float 1\nLOOKUP_TABLE default\n{}\n",
            axis(1.0),
            axis(2.0),
            axis(3.0),
            values.join(" ")
        );
        fs::write(dir.join(name), text).unwrap();
        StepSource::new(&dir.join(name), &OpenOptions::default()).at(Some(time))
    };
    reduce(&[grid("a.vtk", 1.0, 0.0)], None, &out);
    let place = |archive: &Path| {
        let surface =
            Archive::open(archive).unwrap().at(StepChoice::Time(1.0)).unwrap().surface(20.0).unwrap();
        surface.vertices.iter().map(|v| v.position).fold([0f32; 3], |m, p| [0, 1, 2].map(|a| m[a].max(p[a])))
    };
    let far = place(&out);
    assert!(far[0] > 6.0, "{far:?}");
    append(&[grid("b.vtk", 0.0, 2.0)], false, &out).unwrap();
    assert_eq!(place(&out), far);
    append(&[grid("c.vtk", 1.0, 0.0)], true, &out).unwrap();
    assert_eq!(place(&out), far);
    pipeline::collect_garbage(&out, Duration::ZERO, false).unwrap();
    assert_eq!(place(&out), far);
    check_archive(&out).unwrap();
}
