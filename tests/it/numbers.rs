//! Numbers at an isovalue are those of fields whose answer is known, whatever the threads, memory
//! and chunks.

use crate::common::*;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{self, Amount, Bound, LevelChoice, NanPolicy, NumbersReport, ReduceSettings, Target};
use isospan::points::SetKind;
use isospan::surface::check::check;
use isospan::{Archive, Resources};
use std::f64::consts::PI;
use std::path::Path;
use std::process::Command;

/// A pyramid of a field with next to no error; missing samples are kept.
fn exact(input: &Path, spacing: [f64; 3], out: &Path) -> Archive {
    let settings = ReduceSettings {
        points: Some(SetKind::Pyramid),
        target: Some(Target::Max(Bound::Value(1e-5))),
        nan: NanPolicy::Mask,
        ..ReduceSettings::default()
    };
    let options = OpenOptions { spacing: Some(spacing), ..OpenOptions::default() };
    pipeline::reduce_series(&[StepSource::new(input, &options)], &settings, out, &run(2), &Silent).unwrap();
    Archive::open(out).unwrap()
}

fn numbers(archive: &Archive, isovalue: f64) -> NumbersReport {
    archive.query(isovalue).numbers().unwrap()
}

fn near(a: f64, b: f64, part: f64) -> bool {
    (a - b).abs() <= part * b.abs()
}

#[test]
fn a_sphere_in_anisotropic_voxels_has_its_area_volume_and_ball() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("sphere.npy");
    // A box of 20, 20 and 20 in the world, around 10, 10, 10.
    write_npy(&input, [81, 41, 51], |x, y, z| -10.0 * (x * x + y * y + z * z).sqrt());
    let archive = exact(&input, [0.25, 0.5, 0.4], &dir.path().join("a.isospan"));
    let found = numbers(&archive, -7.0);
    assert!(near(found.area, 4.0 * PI * 49.0, 0.005), "{found:?}");
    assert!(near(found.above.volume, 4.0 / 3.0 * PI * 343.0, 0.005), "{found:?}");
    assert!(near(found.volume, 8000.0, 1e-12) && near(found.above.fraction, 0.1796, 0.005));
    assert!(near(found.above.volume + found.below.volume, 8000.0, 1e-12));
    assert_eq!((found.pieces, found.closed_pieces), (1, 1));
    assert_eq!((found.above.pieces, found.below.pieces), (Some(1), Some(1)));
    assert_eq!((found.above.percolates, found.below.percolates), (Some([false; 3]), Some([true; 3])));
    let ball = found.above.ball.unwrap();
    assert_eq!(ball.centre, [10.0; 3]);
    assert!(ball.radius <= 7.0 && near(ball.radius, 7.0, 0.005) && ball.to_samples >= ball.radius);
    // In a corner, between three faces and the sphere.
    let beside = found.below.ball.unwrap();
    let from_sphere = beside.centre.map(|c| (c - 10.0).powi(2)).iter().sum::<f64>().sqrt() - 7.0;
    assert!(near(beside.radius, 3f64.sqrt() * 10.0 / (1.0 + 3f64.sqrt()) - 7.0 / (1.0 + 3f64.sqrt()), 0.1));
    assert!(beside.radius <= from_sphere + 0.02);
    // The volume is the one that the surface in a file encloses.
    let ply = dir.path().join("s.ply");
    archive.query(-7.0).write(&ply).unwrap();
    let of_file = check(&read(&ply));
    assert!(near(found.area, of_file.area, 1e-6) && near(found.above.volume, of_file.volume.unwrap(), 1e-5));
    // Half as fine, on a domain that ends at the last node.
    let coarse = archive.query(-7.0).level(LevelChoice::Level(1)).numbers().unwrap();
    assert_eq!(coarse.level, Some(1));
    assert!(near(coarse.area, found.area, 0.02) && near(coarse.above.volume, found.above.volume, 0.02));
}

#[test]
fn tubes_percolate_along_their_axes_alone() {
    let dir = tempfile::tempdir().unwrap();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let input = dir.path().join(format!("{name}.npy"));
        // Three tubes along the axis, and a ball beside them.
        let field = |x: f64, y: f64, z: f64| {
            let p = [x, y, z];
            let (u, v) = (p[(axis + 1) % 3], p[(axis + 2) % 3]);
            let tube = |a: f64, b: f64, r: f64| r - ((u - a).powi(2) + (v - b).powi(2)).sqrt();
            let tubes = tube(-0.6, -0.6, 0.15).max(tube(-0.6, 0.5, 0.2)).max(tube(0.0, 0.1, 0.25));
            tubes.max(0.2 - ((u - 0.6).powi(2) + (v - 0.6).powi(2) + p[axis].powi(2)).sqrt())
        };
        let mut dims = [44, 44, 44];
        dims[axis] = 150;
        write_npy(&input, dims, field);
        let archive = exact(&input, [1.0; 3], &dir.path().join(format!("{name}.isospan")));
        let found = numbers(&archive, 0.0);
        let along: [bool; 3] = std::array::from_fn(|a| a == axis);
        assert_eq!(found.above.percolates, Some(along), "{name}");
        assert_eq!(found.below.percolates, Some([true; 3]), "{name}");
        assert_eq!((found.pieces, found.closed_pieces), (4, 1), "{name}");
        assert_eq!((found.above.pieces, found.below.pieces), (Some(4), Some(1)), "{name}");
        // Between samples, which the axis of the tube does not meet.
        let (ball, widest) = (found.above.ball.unwrap(), 0.25 * 43.0 / 2.0);
        assert!(ball.radius <= widest + 0.01 && ball.radius > widest - 1.0, "{name}: {ball:?}");
        assert!(ball.to_samples >= ball.radius && ball.to_samples < widest + 1.0, "{name}: {ball:?}");
    }
}

#[test]
fn threads_memory_and_chunks_change_no_number() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("w.npy");
    // Several chunks of a pyramid, with missing samples.
    let holes = |x: f64, y: f64, z: f64| if ball(x - 0.5, y, z) > 0.4 { f64::NAN } else { waves(x, y, z) };
    write_npy(&input, [290, 60, 50], holes);
    let archive = exact(&input, [1.0, 1.5, 2.0], &dir.path().join("a.isospan"));
    let with = |threads, memory| {
        let resources = Resources::default().with_threads(threads).with_memory(memory);
        archive.query(0.3).resources(resources).numbers().unwrap()
    };
    let found = with(1, 1 << 30);
    assert!(found.pieces > 1 && found.above.ball.is_some() && found.below.ball.is_some(), "{found:?}");
    // Cells at missing samples belong to neither side.
    let domain = 289.0 * 59.0 * 49.0 * 3.0;
    assert!(
        found.volume < 0.99 * domain && near(found.above.volume + found.below.volume, found.volume, 1e-12)
    );
    for (threads, memory) in [(2, 1 << 30), (3, 60 << 20)] {
        assert_eq!(with(threads, memory), found, "{threads} threads, {memory} bytes");
    }
    // Tetrahedra, in chunks of any size.
    write_npy(&input, [40, 34, 30], waves);
    let mut all = vec![];
    for chunk in [3_000, 100_000] {
        let out = dir.path().join(format!("{chunk}.isospan"));
        reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(0.5), chunk), &out, 2);
        all.push(numbers(&Archive::open(&out).unwrap(), 0.3));
    }
    assert!(near(all[0].area, all[1].area, 1e-6) && all[0].above.volume == all[1].above.volume, "{all:?}");
    assert_eq!((all[0].pieces, all[0].closed_pieces), (all[1].pieces, all[1].closed_pieces));
    assert_eq!((all[0].above.pieces, all[0].above.percolates, all[0].above.ball), (None, None, None));
    let spectrum = contour_spectrum(&dir.path().join("100000.isospan")).unwrap();
    assert!(near(all[0].volume, spectrum.volume, 1e-9));
    let knot = spectrum.knots[spectrum.knots.len() / 3];
    let at = numbers(&Archive::open(dir.path().join("3000.isospan")).unwrap(), knot.isovalue);
    assert!(near(at.above.volume, knot.volume, 1e-5) && near(at.area, knot.area, 1e-3), "{at:?} {knot:?}");
}

/// What the program prints, which must succeed.
fn says(dir: &Path, args: &[&str]) -> String {
    let done = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap();
    assert!(done.status.success(), "{args:?}: {}", String::from_utf8_lossy(&done.stderr));
    String::from_utf8(done.stdout).unwrap()
}

#[test]
fn three_commands_say_the_same_numbers() {
    let dir = tempfile::tempdir().unwrap();
    write_npy(&dir.path().join("b.npy"), [30, 28, 26], ball);
    exact(&dir.path().join("b.npy"), [1.0; 3], &dir.path().join("b.isospan"));
    let count = says(dir.path(), &["count", "b.isospan", "-i", "0.1", "--numbers"]);
    let numbers = count.split_once('\n').unwrap().1;
    assert!(numbers.contains("1 piece, closed") && numbers.contains("along x, y, z"), "{count}");
    assert!(
        numbers.contains("none reaches across") && numbers.matches("largest ball").count() == 2,
        "{count}"
    );
    for command in ["spectrum", "check"] {
        let said = says(dir.path(), &[command, "b.isospan", "-i", "0.1"]);
        assert!(said.ends_with(numbers), "{said}\n{count}");
    }
    let plain = says(dir.path(), &["count", "b.isospan", "-i", "0.1"]);
    assert_eq!(plain, count.split_once('\n').unwrap().0.to_owned() + "\n");
    // Nothing lies above: no surface, and the other side is all.
    let none = says(dir.path(), &["count", "b.isospan", "-i", "7", "--numbers"]);
    assert!(none.contains("0 pieces") && none.contains("100 % of the domain"), "{none}");
}

#[test]
fn a_surface_is_measured_against_that_of_the_samples() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("s.npy");
    write_npy(&input, [70, 140, 40], |x, y, z| ball(x, y, z) + 0.05 * waves(x, y, z));
    let exact = exact(&input, [1.0, 0.5, 2.0], &dir.path().join("exact.isospan"));
    let source = || {
        let options = OpenOptions { spacing: Some([1.0, 0.5, 2.0]), ..OpenOptions::default() };
        StepSource::new(&input, &options)
    };
    // Next to no error: the same triangles, welded in other boxes.
    let found = exact.measure(source()).isovalues([0.1, 50.0]).run().unwrap();
    let [same, none] = &found.surfaces[..] else { panic!("{found:?}") };
    assert_eq!(same.archive.pieces, same.source.pieces);
    assert!(
        near(same.archive.area, same.source.area, 1e-4) && same.to_source.unwrap().max < 0.01,
        "{same:?}"
    );
    assert_eq!((none.source.triangles, none.to_source, none.to_archive), (0, None, None));
    // A coarse one, whatever the threads and memory; distances are those of `compare`.
    let rough = dir.path().join("rough.isospan");
    let settings = ReduceSettings {
        points: Some(SetKind::Pyramid),
        target: Some(Target::Rms(Bound::OfRange(0.05))),
        ..ReduceSettings::default()
    };
    pipeline::reduce_series(&[source()], &settings, &rough, &run(2), &Silent).unwrap();
    let rough = Archive::open(&rough).unwrap();
    let with = |threads, memory| {
        let resources = Resources::default().with_threads(threads).with_memory(memory);
        rough.measure(source()).isovalues(0.1).resources(resources).run().unwrap().surfaces.swap_remove(0)
    };
    let found = with(1, 1 << 30);
    assert_eq!(with(3, 64 << 20), found);
    let [a, b] = ["a.ply", "b.ply"].map(|name| dir.path().join(name));
    rough.query(0.1).write(&a).unwrap();
    exact.query(0.1).write(&b).unwrap();
    let compared =
        isospan::compare::compare(&read(&a), &read(&b), &isospan::compare::CompareSettings::default())
            .unwrap();
    let (to_source, to_archive) = (found.to_source.unwrap(), found.to_archive.unwrap());
    assert!(to_source.mean > 0.01 && near(to_source.mean, compared.a_to_b.mean, 0.05), "{found:?}");
    assert!(near(to_archive.rms, compared.b_to_a.rms, 0.05) && to_archive.max <= compared.b_to_a.max + 0.01);
    assert!(near(found.archive.area, compared.a.area, 1e-6) && found.archive.pieces == compared.a.components);
}
