//! Surfaces of labels: closed, with the volumes of their voxels, the same for any threads, memory
//! and other labels that are asked for.

use crate::common::*;
use isospan::formats::labels::{LabelStyle, LabelTable};
use isospan::pipeline::{Labels, Target};
use isospan::surface::check::check;
use isospan::{Archive, Reduction, Resources, volume_of};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Labels of the nearest of some places, and 0 outside of an ellipsoid that reaches two faces.
fn cells(dims: [usize; 3], count: u64) -> Vec<u16> {
    let mixed =
        |n: u64| n.wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let place = |n: u64| {
        [0, 1, 2].map(|a| (mixed(3 * n + a as u64) >> 40) as f64 / (1u64 << 24) as f64 * dims[a] as f64)
    };
    let places: Vec<[f64; 3]> = (1..=count).map(place).collect();
    let label = |i: usize| {
        let at = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]].map(|c| c as f64);
        let from_middle: f64 = (0..3).map(|a| (at[a] / dims[a] as f64 - 0.5).powi(2)).sum();
        if from_middle > 0.27 {
            return 0;
        }
        let squared = |p: &[f64; 3]| (0..3).map(|a| (p[a] - at[a]).powi(2)).sum::<f64>();
        let nearest = places.iter().enumerate().min_by(|a, b| squared(a.1).total_cmp(&squared(b.1)));
        nearest.unwrap().0 as u16 + 1
    };
    (0..dims.iter().product()).map(label).collect()
}

/// An archive of a label image, and the voxels of each label.
fn reduced(folder: &Path, dims: [usize; 3], labels: Vec<u16>) -> (PathBuf, BTreeMap<i64, u64>) {
    let mut voxels = BTreeMap::new();
    labels.iter().for_each(|&label| *voxels.entry(i64::from(label)).or_default() += 1);
    let path = folder.join("labels.isospan");
    let image = volume_of("made labels", dims.map(|n| n as u64), labels).unwrap();
    Reduction::of(image).target(Target::Lossless).write(&path).unwrap();
    (path, voxels)
}

#[test]
fn meshes_are_closed_and_the_same_for_any_threads_memory_and_company() {
    let dir = tempfile::tempdir().unwrap();
    // Two chunks.
    let (path, voxels) = reduced(dir.path(), [270, 40, 36], cells([270, 40, 36], 40));
    let archive = Archive::open(&path).unwrap();
    for (steps, tolerance) in [(0, 0.0), (20, 0.01)] {
        let mut files: Vec<Vec<u8>> = vec![];
        for (threads, memory) in [(1, 1 << 30), (2, 1 << 30), (2, 48 << 20)] {
            let out = dir.path().join(format!("{steps}-{threads}-{memory}.ply"));
            let resources = Resources::default().with_threads(threads).with_memory(memory);
            let report = archive.labels(Labels::All).smooth(steps).resources(resources).write(&out).unwrap();
            assert_eq!(report.labels.len(), voxels.len() - 1);
            assert!(report.active_bricks <= report.bricks && report.without_area == 0);
            for one in &report.labels {
                assert_eq!(one.voxels, voxels[&one.label], "{}", one.label);
                let off = (one.volume / one.voxels as f64 - 1.0).abs();
                // What small labels lose is not held within a bound.
                assert!(one.voxels < 1000 && steps > 0 || off <= tolerance + 1e-6, "{steps} steps: {one:?}");
            }
            files.push(std::fs::read(&out).unwrap());
        }
        assert!(files.iter().all(|file| *file == files[0]), "{steps}");
        // Alone, and in a file of its own.
        let each = dir.path().join("label_{}.ply");
        let report = archive.labels(Labels::AllWithBackground).smooth(steps).write(&each).unwrap();
        assert_eq!(
            report.labels.iter().map(|one| one.label).collect::<Vec<_>>(),
            voxels.keys().copied().collect::<Vec<_>>()
        );
        let there: Vec<i64> = voxels.keys().copied().collect();
        for label in [0, there[there.len() / 2], there[there.len() - 1]] {
            let alone = dir.path().join("alone.ply");
            archive.labels(label).smooth(steps).write(&alone).unwrap();
            let with_others = dir.path().join(format!("label_{label}.ply"));
            assert_eq!(std::fs::read(&alone).unwrap(), std::fs::read(&with_others).unwrap(), "{label}");
            let found = check(&read(&alone));
            assert!(found.is_closed() && found.is_manifold() && found.is_oriented(), "{label}: {found:?}");
            let one = report.labels.iter().find(|one| one.label == label).unwrap();
            assert!((found.volume.unwrap() - one.volume).abs() < 1e-3 * one.volume);
            assert!((found.area - one.area).abs() < 1e-3 * one.area);
        }
    }
}

#[test]
fn few_labels_read_few_bricks_and_two_layers_have_surfaces_too() {
    let dir = tempfile::tempdir().unwrap();
    let (path, voxels) = reduced(dir.path(), [270, 40, 36], cells([270, 40, 36], 40));
    let archive = Archive::open(&path).unwrap();
    let last = *voxels.keys().last().unwrap();
    let bricks = |labels: Labels| {
        archive.labels(labels).write(dir.path().join("l.ply")).map(|report| report.active_bricks).unwrap()
    };
    // A range of labels may hold a label that is not there, but not one beyond it.
    assert!(bricks(last.into()) < bricks(Labels::All));
    assert_eq!(bricks((last + 1).into()), 0);

    let layers = dir.path().join("layers");
    std::fs::create_dir(&layers).unwrap();
    let (path, voxels) = reduced(&layers, [40, 30, 2], cells([40, 30, 2], 9));
    let meshes = Archive::open(&path).unwrap().labels(Labels::AllWithBackground).smooth(20).meshes().unwrap();
    assert_eq!(meshes.len(), voxels.len());
    for made in &meshes {
        let found = check(&made.mesh);
        assert!(found.is_closed() && found.is_manifold() && found.is_oriented(), "{found:?}");
        assert_eq!(made.label.voxels, voxels[&made.label.label]);
    }
}

#[test]
fn a_table_gives_names_and_colours() {
    let dir = tempfile::tempdir().unwrap();
    let (path, _) = reduced(dir.path(), [40, 30, 20], cells([40, 30, 20], 5));
    let mut table = LabelTable::default();
    table.insert(2, LabelStyle { name: "Left atrium".into(), colour: [200, 30, 20, 255] });
    let obj = dir.path().join("l.obj");
    let report = Archive::open(&path).unwrap().labels([3, 2]).table(table).write(&obj).unwrap();
    assert_eq!(
        (report.labels[0].name.as_str(), report.labels[0].colour),
        ("Left atrium", [200, 30, 20, 255])
    );
    let text = std::fs::read_to_string(&obj).unwrap();
    let groups: Vec<&str> = text.lines().filter(|line| line.starts_with("g ")).collect();
    assert_eq!(groups, ["g Left_atrium", "g label_3"]);
    assert!(text.lines().any(|line| line.starts_with("v ") && line.ends_with(" 0.7843 0.1176 0.0784")));
}

fn isospan(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap()
}

fn stderr(out: &Output) -> String {
    String::from_utf8_lossy(&out.stderr).into_owned()
}

#[test]
fn the_program_writes_labels_and_refuses_what_has_none() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    reduced(d, [40, 30, 20], cells([40, 30, 20], 5));
    std::fs::write(d.join("t.csv"), "label,name,r,g,b\n3,Heart,255,0,0\n").unwrap();
    let surface = |labels: &str, more: &[&str]| {
        isospan(d, &[&["surface", "labels.isospan", "--labels", labels][..], more].concat())
    };
    let out = surface("3,9", &["-o", "l.glb", "--label-table", "t.csv", "--smooth", "--stats"]);
    assert!(out.status.success() && stderr(&out).contains("no voxel has the label 9"), "{}", stderr(&out));
    let text = String::from_utf8(out.stdout).unwrap();
    assert!(text.contains("Heart") && text.contains("bricks"), "{text}");
    let glb = String::from_utf8_lossy(&std::fs::read(d.join("l.glb")).unwrap()).into_owned();
    assert!(glb.contains("\"name\":\"Heart\"") && !glb.contains("label 9"));
    let found = isospan(d, &["check", "l.glb"]);
    assert!(found.status.success(), "{}", stderr(&found));

    assert!(surface("all", &["-o", "each_{}.stl"]).status.success() && d.join("each_5.stl").exists());
    let again = surface("all", &["-o", "each_{}.stl"]);
    assert!(!again.status.success() && stderr(&again).contains("exists"), "{}", stderr(&again));
    assert!(
        surface("all,0", &["-o", "each_{}.stl", "--force"]).status.success() && d.join("each_0.stl").exists()
    );

    write_npy(&d.join("v.npy"), [20, 18, 16], waves);
    for (name, flags) in [("lossy", &[][..]), ("points", &["--points", "hammersley"])] {
        let archive = format!("{name}.isospan");
        assert!(isospan(d, &[&["reduce", "v.npy", "-o", &archive][..], flags].concat()).status.success());
        let out = isospan(d, &["surface", &archive, "--labels", "1", "-o", "x.ply"]);
        assert_eq!(out.status.code(), Some(2), "{name}");
        assert!(stderr(&out).contains("--labels") && stderr(&out).lines().count() <= 2, "{}", stderr(&out));
    }
    for (labels, more, says) in [
        ("3,3", &["-o", "x.ply"][..], "twice"),
        ("all,3", &["-o", "x.ply"], "name no other than 0"),
        ("Heart", &["-o", "x.ply"], "--label-table"),
        ("Liver", &["-o", "x.ply", "--label-table", "t.csv"], "t.csv has no such name"),
        ("", &["-o", "x.ply"], "expected a label"),
        ("3", &["-o", "-"], "-o"),
        ("3", &["-o", "x.ply", "-i", "1"], "cannot be used with"),
        ("3", &["-o", "x.ply", "--smooth", "65"], "at most 64 steps"),
        ("3", &["-o", "x.ply", "--label-table", "v.npy"], "v.npy"),
    ] {
        let out = surface(labels, more);
        assert!(!out.status.success() && stderr(&out).contains(says), "{labels} {more:?}: {}", stderr(&out));
    }
    assert!(!d.join("x.ply").exists());
}

#[test]
fn the_program_lists_labels_by_number_and_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let (_, voxels) = reduced(d, [40, 30, 20], cells([40, 30, 20], 5));
    std::fs::write(d.join("t.csv"), "label,name,r,g,b\n3,Heart,255,0,0\n4,Lung,0,255,0\n5,Lung,0,0,9\n")
        .unwrap();
    let count = |more: &[&str]| isospan(d, &[&["count", "labels.isospan"][..], more].concat());
    let listed = |more: &[&str]| -> Vec<(i64, String, u64, f64)> {
        let out = count(&[more, &["--json"]].concat());
        let found: serde_json::Value =
            serde_json::from_slice(&out.stdout).unwrap_or_else(|_| panic!("{}", stderr(&out)));
        let one = |l: &serde_json::Value| {
            let name = l["name"].as_str().unwrap().to_owned();
            let (number, volume) = (l["label"].as_i64().unwrap(), l["volume"].as_f64().unwrap());
            (number, name, l["voxels"].as_u64().unwrap(), volume)
        };
        found["labels"].as_array().unwrap().iter().map(one).collect()
    };
    let all = listed(&["--labels", "all", "--label-table", "t.csv"]);
    let expected: Vec<(i64, u64)> = voxels.iter().map(|(l, n)| (*l, *n)).filter(|(l, _)| *l != 0).collect();
    assert_eq!(all.iter().map(|one| (one.0, one.2)).collect::<Vec<_>>(), expected);
    let heart = listed(&["--labels", "Heart,1", "--label-table", "t.csv"]);
    assert_eq!(heart.iter().map(|one| (one.0, one.1.as_str())).collect::<Vec<_>>(), [(1, ""), (3, "Heart")]);
    assert!((heart[1].3 / heart[1].2 as f64 / (heart[0].3 / heart[0].2 as f64) - 1.0).abs() < 1e-9);
    let text = String::from_utf8(count(&["--labels", "3", "--label-table", "t.csv"]).stdout).unwrap();
    assert!(text.starts_with("1 label\n") && text.ends_with("  Heart\n"), "{text}");
    for (more, says) in [
        (&["--labels", "Lung", "--label-table", "t.csv"][..], "at 4 and 5"),
        (&["--labels", "Lung"], "--label-table"),
        (&["--labels", "3", "-i", "1"], "cannot be used with"),
        (&["--labels", "3", "--level", "0"], "cannot be used with"),
        (&[], "--isovalue"),
    ] {
        let out = count(more);
        assert!(out.status.code() == Some(2) && stderr(&out).contains(says), "{more:?}: {}", stderr(&out));
    }
    // An isovalue that no value has is told.
    write_npy(&d.join("v.npy"), [20, 18, 16], waves);
    assert!(isospan(d, &["reduce", "v.npy", "-o", "v.isospan"]).status.success());
    let out = isospan(d, &["count", "v.isospan", "-i", "99"]);
    let text = |out: &Output| String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(out.status.success() && text(&out).contains("outside the range"), "{}", text(&out));
    assert!(!text(&isospan(d, &["count", "v.isospan", "-i", "0.1"])).contains("outside"));
}
