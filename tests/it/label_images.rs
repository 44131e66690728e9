//! Label images: what is stored is what comes back, bit by bit, at every door.

use crate::common::*;
use isospan::Archive;
use isospan::pipeline::{NanPolicy, ReduceSettings, StepChoice, Target};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn labels() -> ReduceSettings {
    ReduceSettings { target: Some(Target::Labels), ..ReduceSettings::default() }
}

/// Cells of a tilted grid: some thousand labels up to 2^24, some of them negative.
fn cells(x: f64, y: f64, z: f64) -> f64 {
    let cell = |t: f64| (5.0 * t).floor();
    let [a, b, c] = [cell(x + 0.3 * y), cell(y - 0.2 * z), cell(z + 0.1 * x)];
    if x * x + y * y > 0.8 { 0.0 } else { (7919.0 * a + 131.0 * b + 13.0 * c * c) * 37.0 }
}

/// An image of unsigned 16-bit or 32-bit labels as NRRD, with some lines of its own.
fn write_nrrd(path: &Path, dims: [usize; 3], kind: &str, more: &str, label: impl Fn(usize) -> u32) {
    let [x, y, z] = dims;
    let head = format!(
        "NRRD0004\ntype: {kind}\ndimension: 3\nsizes: {x} {y} {z}\nspacings: 1 1 2\nendian: little\nencoding: raw\n{more}\n"
    );
    let mut bytes = head.into_bytes();
    for i in 0..x * y * z {
        let label = label(i).to_le_bytes();
        bytes.extend(if kind == "uint8" { &label[..1] } else { &label[..] });
    }
    fs::write(path, bytes).unwrap();
}

fn isospan(dir: &Path, line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(line.split(' ')).output().unwrap()
}

fn run_well(dir: &Path, line: &str) -> String {
    let out = isospan(dir, line);
    assert!(out.status.success(), "{line}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

/// What a command that is refused says.
fn refused(dir: &Path, line: &str) -> String {
    let out = isospan(dir, line);
    assert!(!out.status.success(), "{line}");
    let text = String::from_utf8(out.stderr).unwrap();
    assert!(!text.contains("panic"), "{text}");
    text
}

#[test]
fn labels_come_back_with_the_same_bytes_for_any_threads_and_memory() {
    let dir = tempfile::tempdir().unwrap();
    for (n, dims) in [[300, 40, 34], [257, 30, 20], [33, 65, 290], [7, 6, 5]].into_iter().enumerate() {
        let input = dir.path().join(format!("{n}.npy"));
        write_npy(&input, dims, cells);
        let mut archives = vec![];
        for (threads, memory) in [(1, 1u64 << 30), (2, 1 << 30), (2, 110 << 20)] {
            let out = dir.path().join(format!("{n}-{threads}-{memory}.isospan"));
            let mut run = run(threads);
            run.resources = run.resources.with_memory(memory);
            let report = isospan::Reduction::of(&*input).settings(labels()).resources(run.resources);
            let report = report.write(&out).unwrap();
            let error = report.error.clone().unwrap();
            assert!(error.max == 0.0 && report.target.unwrap().met, "{dims:?}: {error:?}");
            let found = samples(&Archive::open(&out).unwrap(), StepChoice::First);
            let unit = |i: usize, n: usize| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
            for (i, label) in found.iter().enumerate() {
                let at = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
                let [x, y, z] = [0, 1, 2].map(|a| unit(at[a], dims[a]));
                assert_eq!(*label, f64::from(cells(x, y, z) as f32), "{at:?}");
            }
            assert_eq!(error_of(&out, &input).max, 0.0);
            check_archive(&out).unwrap();
            archives.push(folder(&out));
        }
        assert!(archives.iter().all(|a| *a == archives[0]), "{dims:?}");
    }
}

#[test]
fn shards_have_the_bytes_of_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("a.npy");
    // More chunks than a segment has; a sample here and there is missing.
    let field = |x: f64, y, z| if (40.0 * x).floor() == 3.0 { f64::NAN } else { cells(x, y, z) };
    write_npy(&input, [4400, 12, 9], field);
    let [whole, shards] = ["whole", "shards"].map(|name| dir.path().join(format!("{name}.isospan")));
    let settings = ReduceSettings { nan: NanPolicy::Mask, ..labels() };
    let report = reduce(&input, &settings, &whole, 2);
    assert!(report.void_points > 1000, "{report:?}");
    reduce_in_shards(&input, &settings, &shards);
    let [a, b] = [&whole, &shards].map(|out| folder(out));
    assert!(a.keys().eq(b.keys()) && a == b, "{:?}", b.keys());
    assert!(!a.keys().any(|file| file.to_string_lossy().contains("coarse")), "{:?}", a.keys());
    check_archive(&whole).unwrap();
    let found = samples(&Archive::open(&whole).unwrap(), StepChoice::First);
    assert_eq!(found.iter().filter(|v| v.is_nan()).count() as u64, report.void_points);
}

/// NIfTI says that samples are labels, in both versions.
#[test]
fn exported_labels_are_labels_again() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for (name, dims) in [("small", [40, 30, 20]), ("long", [33_000, 2, 2])] {
        write_nrrd(&d.join(format!("{name}.nrrd")), dims, "uint8", "", |i| (i / 900) as u32 % 5);
        let out = run_well(d, &format!("reduce {name}.nrrd --labels -o {name}.isospan"));
        let next = format!("next: isospan surface {name}.isospan --labels all -o {name}.glb");
        assert!(out.contains(&next), "{out}");
        run_well(d, &format!("export {name}.isospan -o {name}.nii.gz"));
        run_well(d, &format!("reduce {name}.nii.gz -o {name}_again.isospan"));
        let [first, again] =
            ["", "_again"].map(|again| Archive::open(d.join(format!("{name}{again}.isospan"))).unwrap());
        let sets = [&first, &again].map(|archive| archive.info().unwrap().point_set);
        assert_eq!(sets[0], sets[1]);
        assert_eq!(samples(&first, StepChoice::First), samples(&again, StepChoice::First));
    }
}

#[test]
fn files_that_say_so_have_labels_without_a_flag() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let label = |i: usize| if i % 40 < 20 { 0 } else { (i / 900) as u32 % 5 };
    write_nrrd(&d.join("a.seg.nrrd"), [40, 30, 20], "uint8", "Segment0_ID:=Segment_1\n", label);
    write_nrrd(&d.join("plain.nrrd"), [40, 30, 20], "uint8", "", label);
    assert!(run_well(d, "reduce a.seg.nrrd -o a.isospan").contains("  labels      of all samples"));
    let info = run_well(d, "info a.isospan");
    assert!(info.contains("labels, 40 x 30 x 20 samples") && !info.contains("worth a look"), "{info}");
    assert!(manifest_json(&d.join("a.isospan")).contains("\"format_version\":9"));
    // A target that is given wins, and other files have pyramids.
    run_well(d, "reduce a.seg.nrrd -o lossless.isospan --lossless");
    run_well(d, "reduce plain.nrrd -o plain.isospan");
    for other in ["lossless", "plain"] {
        let json = manifest_json(&d.join(format!("{other}.isospan")));
        assert!(json.contains("\"set\":\"pyramid\"") && json.contains("\"format_version\":7"), "{json}");
    }
    // The type of the source comes back, and so do its samples.
    run_well(d, "export a.isospan -o back.nrrd");
    let [source, back] = ["a.seg.nrrd", "back.nrrd"].map(|name| fs::read(d.join(name)).unwrap());
    assert_eq!(source[source.len() - 24_000..], back[back.len() - 24_000..]);
    assert!(String::from_utf8_lossy(&back).contains("type: uint8"));
    // What is made of the archive has labels, too.
    assert!(run_well(d, "reduce a.isospan -o again.isospan").contains("  labels      of all samples"));
}

#[test]
fn nothing_is_between_two_labels() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_nrrd(&d.join("a.nrrd"), [20, 20, 20], "uint8", "", |i| if i % 20 < 10 { 3 } else { 200 });
    run_well(d, "reduce a.nrrd -o a.isospan --labels");
    assert!(run_well(d, "info a.isospan").starts_with("a.isospan: isospan archive, format 9\n"));
    fs::write(d.join("at.csv"), "x,y,z\n9.4,3.3,5\n9.6,3,5.9\n2.5,2.5,2.5\n").unwrap();
    run_well(d, "probe a.isospan --at at.csv -o at.npy");
    let bytes = fs::read(d.join("at.npy")).unwrap();
    let (found, _) = bytes[bytes.len() - 12..].as_chunks::<4>();
    assert_eq!(found.iter().map(|b| f32::from_le_bytes(*b)).collect::<Vec<_>>(), [3.0, 200.0, 3.0]);
    run_well(d, "probe a.isospan --grid 57,31,9 -o fine.npy");
    let bytes = fs::read(d.join("fine.npy")).unwrap();
    let (values, _) = bytes[bytes.len() - 4 * 57 * 31 * 9..].as_chunks::<4>();
    let mut values: Vec<f32> = values.iter().map(|b| f32::from_le_bytes(*b)).collect();
    values.sort_by(f32::total_cmp);
    values.dedup();
    assert_eq!(values, [3.0, 200.0]);
    for (line, words) in [
        ("surface a.isospan -i 5 -o a.ply", "has labels, which are names"),
        ("surface a.isospan -i 5 -o a.ply", "asked for with --labels"),
        ("count a.isospan -i 5", "has labels"),
        ("spectrum a.isospan", "has labels"),
        ("export a.isospan -o b.nrrd --level 1", "no level 1: labels have level 0 alone"),
        ("probe a.isospan --grid 4,4,4 -o b.npy --level 2", "no level 2: labels have level 0 alone"),
    ] {
        let text = refused(d, line);
        assert!(text.contains(words), "{line}: {text}");
    }
}

#[test]
fn numbers_that_are_no_labels_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let dims = [20, 20, 20];
    // 2^24 + 1 is no f32; 2^24 + 2 is one.
    for (name, most) in [("odd", (1 << 24) + 1), ("even", (1 << 24) + 2)] {
        write_nrrd(&d.join(format!("{name}.nrrd")), dims, "uint32", "", |i| if i == 777 { most } else { 5 });
        let text = refused(d, &format!("reduce {name}.nrrd -o a.isospan --labels"));
        assert!(text.contains("whole numbers from -16777216 to 16777216") && text.contains("anew"), "{text}");
    }
    write_nrrd(&d.join("most.nrrd"), dims, "uint32", "", |i| if i == 777 { 1 << 24 } else { 5 });
    run_well(d, "reduce most.nrrd -o most.isospan --labels");
    let found = samples(&Archive::open(d.join("most.isospan")).unwrap(), StepChoice::First);
    assert_eq!((found[777], found[776]), (16_777_216.0, 5.0));
    write_npy(&d.join("half.npy"), [9, 9, 9], |x, _, _| if x > 0.9 { 0.5 } else { 2.0 });
    let text = refused(d, "reduce half.npy -o a.isospan --labels");
    assert!(text.contains("sample (8, 0, 0)") && text.contains("leave --labels out"), "{text}");
    for (flags, words) in [
        ("--labels --target-rms 1%", "cannot be used with"),
        ("--labels --lossless", "cannot be used with"),
        ("--labels --points halton", "--points does not go with --labels"),
        ("--labels --keyframes 2", "--keyframes does not go with --labels"),
        ("--labels --interp cubic", "--interp is for point sets"),
    ] {
        let text = refused(d, &format!("reduce most.nrrd -o b.isospan {flags}"));
        assert!(text.contains(words), "{flags}: {text}");
    }
    assert!(!d.join("a.isospan/manifest.zst").exists() && !d.join("b.isospan").exists());
}

#[test]
fn a_series_of_labels_has_steps_that_stand_alone() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for step in 0..3usize {
        let label = move |i: usize| (i / (50 + step)) as u32 % 7;
        write_nrrd(&d.join(format!("s{step}.nrrd")), [30, 20, 10], "uint8", "", label);
    }
    run_well(d, "reduce s0.nrrd s1.nrrd -o s.isospan --labels");
    run_well(d, "append s.isospan s2.nrrd");
    check_archive(&d.join("s.isospan")).unwrap();
    let json = manifest_json(&d.join("s.isospan"));
    assert!(!json.contains("\"base\"") && json.matches("\"correction\":\"labels\"").count() == 3, "{json}");
    let archive = Archive::open(d.join("s.isospan")).unwrap();
    for step in 0..3usize {
        let found = samples(&archive, StepChoice::Number(step as u64));
        let expected: Vec<f64> = (0..6000).map(|i| (i / (50 + step) % 7) as f64).collect();
        assert_eq!(found, expected, "{step}");
    }
    let text = refused(d, "probe s.isospan --time 0.5 --grid 3,3,3 -o x.npy");
    assert!(text.contains("labels are known at steps, and not between them"), "{text}");
    let text = refused(d, "append s.isospan s2.nrrd --keyframes 3");
    assert!(text.contains("--keyframes does not go with labels"), "{text}");
}

#[test]
fn damaged_labels_are_an_error_or_the_right_answer() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("a.npy");
    write_npy(&input, [70, 40, 36], cells);
    let out = dir.path().join("a.isospan");
    reduce(&input, &labels(), &out, 2);
    let good = samples(&Archive::open(&out).unwrap(), StepChoice::First);
    let file = out.join("steps/000000-values-000000.seg");
    let bytes = fs::read(&file).unwrap();
    for n in (0..bytes.len()).step_by(61) {
        let mut damaged = bytes.clone();
        damaged[n] ^= 1 << (n % 8);
        fs::write(&file, &damaged).unwrap();
        let step = Archive::open(&out).and_then(|archive| archive.step(0));
        let found = step.and_then(|step| step.sample(step.dims()));
        assert!(found.is_err() || found.is_ok_and(|found| found == good), "byte {n}");
        assert!(check_archive(&out).is_err(), "byte {n}");
    }
}
