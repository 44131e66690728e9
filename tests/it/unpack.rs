//! Unpacked blocks: the same surfaces from other bytes on disk, and never from those of another
//! archive.

#[path = "../../tools/fuzz/unpacked_words.rs"]
mod unpacked_words;

use crate::common::*;
use isospan::archive::manifest::{Manifest, unpacked_path};
use isospan::archive::segment::{Segment, SegmentKind};
use isospan::exec::Silent;
use isospan::formats::surface::SurfaceFormat;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{
    self, Amount, AppendSettings, NanPolicy, Refine, StepChoice, StepRange, SurfaceReport, SurfaceSettings,
    UnpackReport, UnpackSettings, remove_unpacked, unpack,
};
use isospan::points::SetKind;
use isospan::surface::edit::{components::ComponentFilter, decimate::Decimation};
use isospan::{Archive, Error, Resources};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use unpacked_words::seal_words;

const DIMS: [usize; 3] = [40, 33, 37];

/// Several chunks, and a ball without data.
fn archive(dir: &Path, name: &str, shift: f64) -> PathBuf {
    let input = dir.join(format!("{name}.npy"));
    let far = |x: f64, y: f64, z: f64| (x - 0.4).powi(2) + y * y + z * z > 0.05;
    write_npy(&input, DIMS, |x, y, z| if far(x, y, z) { waves(x + shift, y, z) } else { f64::NAN });
    let out = dir.join(format!("{name}.isospan"));
    let mut settings = settings(SetKind::Halton, Amount::Fraction(0.25), 3_000);
    settings.nan = NanPolicy::Mask;
    assert!(reduce(&input, &settings, &out, 2).chunks > 3);
    out
}

fn unpacked(archive: &Path, settings: &UnpackSettings) -> UnpackReport {
    unpack(archive, settings, &Silent).unwrap()
}

/// All kinds of questions about surfaces, as files.
fn answers(archive: &Path, dir: &Path) -> Vec<Vec<u8>> {
    let all = || SurfaceSettings {
        resources: Resources::default().with_threads(2),
        isovalues: vec![0.3],
        ..SurfaceSettings::default()
    };
    let components = ComponentFilter { largest: Some(2), ..ComponentFilter::default() };
    let decimate = Decimation { ratio: 0.3, ..Decimation::default() };
    let questions = [
        all(),
        SurfaceSettings { isovalues: vec![-0.8, 0.3, 1.1], ..all() },
        SurfaceSettings { roi: Some("5:20,3:,:30".parse().unwrap()), ..all() },
        SurfaceSettings { cap: true, isovalues: vec![0.3, -0.5], ..all() },
        SurfaceSettings {
            refine: Refine { components: Some(components), decimate: Some(decimate) },
            ..all()
        },
    ];
    let ask = |settings: &SurfaceSettings| {
        let out = dir.join("answer.vtp");
        extract_surface(archive, settings, &out, SurfaceFormat::Vtp, &Silent).unwrap();
        fs::read(&out).unwrap()
    };
    let mut found: Vec<Vec<u8>> = questions.iter().map(ask).collect();
    let open = Archive::open(archive).unwrap();
    // Blocks that were used before are used otherwise.
    for _ in 0..2 {
        for settings in &questions {
            let meshes = open.surfaces(settings).unwrap();
            found.push(meshes.iter().flat_map(|m| format!("{m:?}").into_bytes()).collect());
        }
    }
    found
}

#[test]
fn unpacked_blocks_give_the_same_surfaces() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), "a", 0.0);
    let right = answers(&archive, dir.path());
    let file = unpacked_path(&archive, 0);
    let mut bytes = None;
    for (threads, memory) in [(1, 1 << 30), (3, 1 << 30), (3, 40 << 20)] {
        let report = unpacked(
            &archive,
            &UnpackSettings {
                resources: Resources::default().with_threads(threads).with_memory(memory),
                ..UnpackSettings::default()
            },
        );
        assert_eq!(report.files[0].file, file);
        assert!(report.files[0].blocks > 100 && report.files[0].tetrahedra > 10_000, "{report:?}");
        let written = fs::read(&file).unwrap();
        assert_eq!(report.bytes, written.len() as u64);
        assert!(bytes.get_or_insert_with(|| written.clone()) == &written, "{threads} threads");
    }
    assert!(answers(&archive, dir.path()) == right);
    check_archive(&archive).unwrap();
    let info = summarize(&archive).unwrap();
    assert_eq!(info.steps[0].unpacked_bytes, Some(bytes.unwrap().len() as u64));
    // They are what is read.
    let out = dir.path().join("one.ply");
    let report = surface(&archive, 0.3, &out, 1);
    assert!(report.bytes_read > 20 * report.active_cells, "{report:?}");
    assert!(report.active_bytes > report.bytes_read / 2 && report.bytes_read < report.archive_bytes);
    let removed = remove_unpacked(&archive, &UnpackSettings::default(), false).unwrap();
    assert_eq!((removed.bytes, removed.files.len()), (info.steps[0].unpacked_bytes.unwrap(), 1));
    let packed = surface(&archive, 0.3, &out, 1);
    assert!(packed.bytes_read * 3 < report.bytes_read);
    assert_eq!(info.bytes, summarize(&archive).unwrap().bytes);
    assert!(answers(&archive, dir.path()) == right);
    let error = unpack(
        &archive,
        &UnpackSettings { resources: Resources::default().with_memory(1 << 20), ..UnpackSettings::default() },
        &Silent,
    );
    assert_eq!(error.unwrap_err().exit_code(), 4);
}

#[test]
fn a_range_leaves_other_blocks_packed() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), "a", 0.0);
    let right = answers(&archive, dir.path());
    let all = unpacked(&archive, &UnpackSettings::default());
    let range = |low, high| UnpackSettings { range: [low, high], ..UnpackSettings::default() };
    let some = unpacked(&archive, &range(0.25, 0.35));
    assert!(some.files[0].blocks < all.files[0].blocks && some.bytes < all.bytes, "{some:?} {all:?}");
    let told = all.files[0].blocks + all.files[0].packed_blocks;
    assert_eq!(some.files[0].blocks + some.files[0].packed_blocks, told);
    assert!(answers(&archive, dir.path()) == right);
    check_archive(&archive).unwrap();
    let none = unpacked(&archive, &range(50.0, 60.0));
    assert_eq!(none.files[0].blocks, 0);
    assert!(answers(&archive, dir.path()) == right);
    assert_eq!(unpack(&archive, &range(2.0, 1.0), &Silent).unwrap_err().exit_code(), 2);
}

#[test]
fn steps_are_unpacked_by_themselves() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), "a", 0.0);
    let add = |shift: f64, name: &str| {
        let input = dir.path().join(name);
        write_npy(&input, DIMS, |x, y, z| waves(x + shift, y, z));
        let settings = AppendSettings::default();
        let steps = [StepSource::new(&input, &OpenOptions::default())];
        pipeline::append(&steps, &settings, &archive, &run(2), &Silent).unwrap();
    };
    add(0.1, "b.npy");
    let at = |step: u64| {
        let (step, settings) = (StepChoice::Number(step), SurfaceSettings::of(0.3));
        let out = dir.path().join("step.ply");
        let report = extract_surface_at(&archive, step, &settings, &out, SurfaceFormat::Ply, &Silent);
        (fs::read(&out).unwrap(), report.unwrap().bytes_read)
    };
    let right = [at(0), at(1)];
    unpacked(&archive, &UnpackSettings { step: StepChoice::Number(1), ..UnpackSettings::default() });
    assert!(!unpacked_path(&archive, 0).exists() && unpacked_path(&archive, 1).exists());
    assert!(at(0) == right[0] && at(1).0 == right[1].0 && at(1).1 > 3 * right[1].1);
    // Another step leaves the file valid.
    add(0.2, "c.npy");
    assert!(at(1).0 == right[1].0 && at(1).1 > 3 * right[1].1);
    check_archive(&archive).unwrap();
    let series = |name: &str| {
        let out = dir.path().join(format!("{name}_%02d.ply"));
        let settings = SurfaceSettings::of(0.3);
        let made =
            extract_series(&archive, StepRange::default(), &settings, &out, SurfaceFormat::Ply, &Silent);
        let of_step =
            |report: &SurfaceReport| (fs::read(&report.surfaces[0].file).unwrap(), report.bytes_read);
        made.unwrap().steps.iter().map(|s| of_step(&s.report)).unzip::<_, _, Vec<_>, Vec<_>>()
    };
    let (before, _) = series("before");
    let all = UnpackSettings { steps: Some(StepRange::default()), ..UnpackSettings::default() };
    assert_eq!(unpacked(&archive, &all).files.len(), 3);
    let (after, read) = series("after");
    assert!(after == before && at(0).0 == right[0].0);
    assert!(read.iter().zip([0, 1, 2].map(at)).all(|(read, (_, alone))| *read > alone / 2), "{read:?}");
    check_archive(&archive).unwrap();
    // A moment between two steps has no file, and is answered as ever.
    let (time, settings) = (StepChoice::Time(0.5), SurfaceSettings::of(0.3));
    let moment = |archive: &Path| {
        let out = dir.path().join("between.ply");
        extract_surface_at(archive, time.clone(), &settings, &out, SurfaceFormat::Ply, &Silent).unwrap();
        fs::read(out).unwrap()
    };
    let with = moment(&archive);
    let of_time = UnpackSettings { step: StepChoice::Time(0.5), ..UnpackSettings::default() };
    assert_eq!(unpack(&archive, &of_time, &Silent).unwrap_err().exit_code(), 2);
    let one = UnpackSettings { step: StepChoice::Number(2), ..UnpackSettings::default() };
    assert_eq!(remove_unpacked(&archive, &one, true).unwrap().files.len(), 1);
    assert_eq!(remove_unpacked(&archive, &all, false).unwrap().files.len(), 2);
    assert!(moment(&archive) == with);
}

fn extract(archive: &Path) -> Result<Vec<u8>, Error> {
    let out = archive.with_extension("ply");
    let settings = SurfaceSettings {
        resources: Resources::default().with_threads(1),
        cap: true,
        ..SurfaceSettings::of(0.3)
    };
    extract_surface(archive, &settings, &out, SurfaceFormat::Ply, &Silent)?;
    let settings =
        SurfaceSettings { resources: Resources::default().with_threads(1), ..SurfaceSettings::of(0.3) };
    extract_surface(archive, &settings, &out, SurfaceFormat::Ply, &Silent)?;
    Ok(fs::read(out).unwrap())
}

/// An error of a file that cannot be used says what to do.
fn orderly(what: &str, error: &Error) {
    let line = error.to_string();
    assert!(error.exit_code() == 5 && !line.contains('\n'), "{what}: {line}");
    assert!(line.contains("isospan unpack"), "{what}: {line}");
}

#[test]
fn files_of_other_archives_are_never_used() {
    let dir = tempfile::tempdir().unwrap();
    let (a, b) = (archive(dir.path(), "a", 0.0), archive(dir.path(), "b", 0.01));
    let right = extract(&a).unwrap();
    unpacked(&b, &UnpackSettings::default());
    fs::copy(unpacked_path(&b, 0), unpacked_path(&a, 0)).unwrap();
    for error in [extract(&a).unwrap_err(), check_archive(&a).unwrap_err(), summarize(&a).unwrap_err()] {
        orderly("of another archive", &error);
        assert!(error.to_string().contains("plan hash"), "{error}");
    }
    // The same plan and step, but other bytes of values: what the manifest says of them is looked
    // at.
    let good = dir.path().join("good.seg");
    unpacked(&a, &UnpackSettings::default());
    fs::copy(unpacked_path(&a, 0), &good).unwrap();
    let mut manifest = Manifest::read(&a).unwrap();
    manifest.steps[0].values[0].info.content_hash ^= 1;
    manifest.write(&a).unwrap();
    orderly("of other values", &extract(&a).unwrap_err());
    manifest.steps[0].values[0].info.content_hash ^= 1;
    manifest.write(&a).unwrap();
    assert!(extract(&a).unwrap() == right);
    // What a killed writer leaves is not looked at.
    remove_unpacked(&a, &UnpackSettings::default(), false).unwrap();
    fs::copy(&good, a.join("steps/.000000-unpacked.seg.tmp-elsewhere-1-0")).unwrap();
    let report = surface(&a, 0.3, &dir.path().join("packed.ply"), 1);
    assert!(report.bytes_read < 20 * report.active_cells);
}

#[test]
fn damage_is_an_error_or_does_not_show() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), "a", 0.0);
    let right = extract(&archive).unwrap();
    unpacked(&archive, &UnpackSettings { range: [0.29, 0.31], ..UnpackSettings::default() });
    let file = unpacked_path(&archive, 0);
    let good = fs::read(&file).unwrap();
    let put = |bytes: &[u8]| {
        fs::remove_file(&file).unwrap();
        fs::write(&file, bytes).unwrap();
    };
    let (mut found, mut harmless) = (0, 0);
    let step = good.len() / 150;
    let ends = (0..100).chain(good.len() - 60..good.len());
    for at in ends.chain((0..good.len()).step_by(step)) {
        let mut bad = good.clone();
        bad[at] ^= 1 << (at % 8);
        put(&bad);
        match extract(&archive) {
            Ok(surface) => {
                assert!(surface == right, "byte {at}");
                harmless += 1;
            }
            Err(error) => {
                orderly(&format!("byte {at}"), &error);
                found += 1;
            }
        }
    }
    assert!(found > 100 && harmless < 150, "{found} and {harmless}");
    for cut in (0..good.len()).step_by(good.len() / 20) {
        put(&good[..cut]);
        orderly(&format!("cut at {cut}"), &extract(&archive).unwrap_err());
    }
    let middle = good.len() / 2;
    put(&[&good[..middle], &[good[middle] ^ 1], &good[middle + 1..]].concat());
    orderly("check", &check_archive(&archive).unwrap_err());
    put(&good);
    check_archive(&archive).unwrap();
}

/// Words changed behind good checksums: an error, or a surface, and nothing else; and `check` finds
/// each.
#[test]
fn words_that_lie_harm_nobody() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), "a", 0.0);
    let right = extract(&archive).unwrap();
    unpacked(&archive, &UnpackSettings { range: [0.29, 0.31], ..UnpackSettings::default() });
    let file = unpacked_path(&archive, 0);
    let good = fs::read(&file).unwrap();
    let segment = Segment::open(&file, SegmentKind::Unpacked, None).unwrap();
    let (hash, blocks) = (segment.plan(), segment.block_count());
    let mut block = vec![];
    let mut is_there = |n: &u64| segment.block(*n, &mut block).is_ok() && !block.is_empty();
    let filled: Vec<u64> = (1..blocks).filter(|n| is_there(n)).collect();
    let (mut refused, mut other) = (0, 0);
    let mut random = 1u64;
    for case in 0..300usize {
        fs::remove_file(&file).unwrap();
        fs::write(&file, &good).unwrap();
        reseal(&file, SegmentKind::Unpacked, hash, |n, bytes| {
            if n == filled[case * 37 % filled.len()] {
                let mut random = random ^ n;
                for _ in 0..=case % 4 {
                    random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    let most = if case % 5 == 0 { bytes.len().min(32) } else { bytes.len() };
                    let at = (random >> 33) as usize % most;
                    bytes[at] = (random >> 20) as u8;
                }
                if case % 50 == 49 {
                    bytes.truncate(bytes.len() / 2);
                }
                if case % 7 > 0 {
                    seal_words(bytes);
                }
            }
        });
        random = random.wrapping_mul(2862933555777941757).wrapping_add(3037000493);
        match extract(&archive) {
            Err(error) => {
                orderly(&format!("case {case}"), &error);
                refused += 1;
            }
            Ok(surface) => other += usize::from(surface != right),
        }
        // A checksum that was hit was mended.
        if case % 30 == 0 && fs::read(&file).unwrap() != good {
            orderly("check", &check_archive(&archive).unwrap_err());
        }
    }
    assert!(refused > 50 && other > 10, "{refused} and {other}");
}

fn isospan(args: &[&str], tunables: &str) -> (i32, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
    let output = command.args(args).env("GLIBC_TUNABLES", tunables).output().unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    (output.status.code().unwrap_or(-1), text.concat())
}

#[test]
fn the_command_line_unpacks_and_removes() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), "a", 0.0);
    let name = archive.to_str().unwrap();
    let out = dir.path().join("out.ply");
    let surface = |tunables: &str| {
        let args =
            ["surface", name, "--isovalue", "0.3", "-o", out.to_str().unwrap(), "--threads", "2", "--force"];
        let (code, text) = isospan(&args, tunables);
        assert_eq!(code, 0, "{text}");
        fs::read(&out).unwrap()
    };
    let right = surface("");
    // What it will write is said before, and is near to what it writes.
    let before = folder(&archive);
    let (code, text) = isospan(&["unpack", name, "--range", "-1:0.5", "--dry-run", "--json"], "");
    let need =
        serde_json::Deserializer::from_str(&text).into_iter::<serde_json::Value>().next().unwrap().unwrap();
    assert!(code == 0 && folder(&archive) == before, "{text}");
    let (code, text) = isospan(&["unpack", name, "--range", "-1:0.5", "--threads", "1"], "");
    let bytes = fs::metadata(unpacked_path(&archive, 0)).unwrap().len() as f64;
    let predicted = need["bytes"].as_u64().unwrap() as f64;
    assert!(bytes < 1.1 * predicted && bytes > 0.5 * predicted, "{bytes} of {predicted}");
    assert!(text.contains("that are free, for"), "{text}");
    assert!(
        code == 0 && text.contains("000000-unpacked.seg") && text.contains("bytes a tetrahedron"),
        "{text}"
    );
    let written = fs::read(unpacked_path(&archive, 0)).unwrap();
    // Without vectors the same bytes are written, and the same surface comes from them.
    let plain = "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F";
    isospan(&["unpack", name, "--range", "-1:0.5", "--force"], plain);
    assert!(fs::read(unpacked_path(&archive, 0)).unwrap() == written);
    for tunables in ["", plain, "glibc.cpu.hwcaps=-AVX512BW"] {
        assert!(surface(tunables) == right, "{tunables}");
    }
    let (_, text) = isospan(&["info", name], "");
    assert!(text.contains("unpacked    1 of 1 step,"), "{text}");
    let (code, text) = isospan(&["unpack", name, "--remove", "--json"], "");
    assert!(code == 0 && text.contains("\"step\":0"), "{text}");
    assert!(!unpacked_path(&archive, 0).exists());
    assert_eq!(isospan(&["unpack", name, "--range", "3:2"], "").0, 2);
    assert_eq!(isospan(&["unpack", name, "--range", "1:2", "--remove"], "").0, 2);
    assert_eq!(isospan(&["unpack", dir.path().to_str().unwrap()], "").0, 5);
}

#[test]
fn what_a_killed_run_has_left_is_swept() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), "a", 0.0);
    let name = archive.to_str().unwrap();
    let right = extract(&archive).unwrap();
    let file = unpacked_path(&archive, 0);
    unpacked(&archive, &UnpackSettings::default());
    let whole = fs::read(&file).unwrap();
    fs::remove_file(&file).unwrap();
    // A part of the file, under the name that it is written under.
    let left = file.with_file_name(".000000-unpacked.seg.tmp-elsewhere-12-ab");
    fs::write(&left, &whole[..whole.len() / 2]).unwrap();
    assert!(extract(&archive).unwrap() == right);
    unpacked(&archive, &UnpackSettings::default());
    assert!(fs::read(&file).unwrap() == whole && extract(&archive).unwrap() == right);
    let (code, text) = isospan(&["gc", name, "--older-than", "1h"], "");
    assert!(code == 0 && left.exists(), "{text}");
    let (code, text) = isospan(&["gc", name, "--older-than", "0s"], "");
    assert!(code == 0 && text.contains("1 file") && !left.exists() && file.exists(), "{text}");
}

/// A file system that is too small is reported before anything is written.
#[test]
#[cfg(target_os = "linux")]
#[ignore = "mounts a file system, which wants root; tools/check runs it"]
fn a_disk_that_is_too_small_is_refused_beforehand() {
    let dir = tempfile::tempdir().unwrap();
    archive(dir.path(), "a", 0.0);
    let script = "mkdir small && mount -t tmpfs -o size=1m tmpfs small && cp -r a.isospan small/ || exit 99
        \"$0\" unpack small/a.isospan 2>&1; code=$?; ls small/a.isospan/steps; exit $code";
    let out = Command::new("unshare")
        .args(["--mount", "bash", "-c", script, env!("CARGO_BIN_EXE_isospan")])
        .current_dir(dir.path())
        .output()
        .unwrap();
    let text = String::from_utf8(out.stdout).unwrap();
    assert_eq!(out.status.code(), Some(4), "{text}");
    assert!(text.contains("disk") && !text.contains("unpacked"), "{text}");
}
