//! The contour spectrum of an archive is what its surfaces are: as many active tetrahedra, the same
//! area, the same volume.

use crate::common::{
    self, ball, check_archive, contour_spectrum, count_active, folder, read, reduce, settings, summarize,
    surface, waves, write_npy,
};
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{self, Amount, NanPolicy, ReduceSettings};
use isospan::points::SetKind;
use isospan::surface::check::check;
use std::fs;
use std::path::Path;

/// A field as NRRD with an anisotropic, mirrored and turned geometry.
fn write_turned(path: &Path, dims: [usize; 3], f: impl Fn(f64, f64, f64) -> f64) {
    let npy = path.with_extension("npy");
    write_npy(&npy, dims, f);
    let data = fs::read(&npy).unwrap();
    let samples = dims.iter().product::<usize>() * 4;
    let head = format!(
        "NRRD0004\ntype: float\ndimension: 3\nsizes: {} {} {}\nencoding: raw\nendian: little\n\
         space: left-posterior-superior\nspace directions: (0,2,0) (0.5,0,0) (0,0,3)\nspace origin: (1e3,-7,40)\n\n",
        dims[0], dims[1], dims[2]
    );
    fs::write(path, [head.as_bytes(), &data[data.len() - samples..]].concat()).unwrap();
}

#[test]
fn a_spectrum_is_what_the_surfaces_are() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.nrrd");
    write_turned(&input, [28, 24, 20], ball);
    // Small archives have none stored: it is summed from the tetrahedra of their chunks.
    for (set, chunk_points, several, stored) in [
        (SetKind::Hammersley, 2_000, true, true),
        (SetKind::Hammersley, 100_000, false, false),
        (SetKind::Regular, 100_000, false, false),
    ] {
        let out = dir.path().join(format!("{set:?}-{chunk_points}.isospan"));
        let made = reduce(&input, &settings(set, Amount::Fraction(0.5), chunk_points), &out, 2);
        assert_eq!(made.chunks > 1, several, "{set:?}: {} chunks", made.chunks);
        assert_eq!(folder(&out).keys().any(|f| f.ends_with("000000-spectrum.seg")), stored, "{set:?}");
        let spectrum = contour_spectrum(&out).unwrap();
        assert!(
            (spectrum.volume / (27.0 * 23.0 * 19.0 * 3.0) - 1.0).abs() < 1e-12,
            "the domain's volume in the world"
        );
        // What a chunk of a lattice needs of others is read with it.
        let most = if stored { 30_000 } else { made.archive_bytes * if several { 3 } else { 1 } };
        assert!(
            spectrum.knots.len() > 20 && spectrum.bytes_read <= most,
            "{} of {most} bytes",
            spectrum.bytes_read
        );
        let mut closed = 0;
        for knot in spectrum.knots.iter().step_by(4) {
            let file = dir.path().join("s.ply");
            let report = surface(&out, knot.isovalue, &file, 2);
            assert_eq!(report.active_cells, knot.active_cells, "{set:?} {knot:?}");
            let found = check(&read(&file));
            assert!((found.area - knot.area).abs() <= 1e-4 * knot.area + 1e-9, "{knot:?} {}", found.area);
            if let Some(volume) = found.volume.filter(|_| found.is_closed() && knot.area > 0.0) {
                assert!((volume - knot.volume).abs() <= 1e-3 * knot.volume, "{knot:?} {volume}");
                closed += 1;
            }
        }
        assert!(closed > 2);
    }
}

#[test]
fn counts_are_exact_whether_stored_or_not() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("waves.npy");
    // A corner without values: its tetrahedra are void, and count nowhere.
    write_npy(&input, [25, 22, 20], |x, y, z| if x + y + z > 1.8 { f64::NAN } else { waves(x, y, z) });
    let out = dir.path().join("waves.isospan");
    let settings =
        ReduceSettings { nan: NanPolicy::Mask, ..settings(SetKind::Halton, Amount::Fraction(1.0), 1_500) };
    let made = reduce(&input, &settings, &out, 2);
    assert!(made.void_points > 0);
    let (mut stored, mut decoded) = (0, 0);
    let few_digits = (-8..8).map(|i| i as f32 * 0.25);
    let many_digits = (0..8).map(|i| -1.9 + i as f32 * 0.456_789_1);
    for isovalue in few_digits.chain(many_digits).chain([-100.0, 100.0]) {
        let count = count_active(&out, isovalue).unwrap();
        let report = surface(&out, isovalue, &dir.path().join("s.ply"), 1);
        assert_eq!(count.active_cells, report.active_cells, "{isovalue}");
        if count.stored {
            assert!(count.bytes_read < 30_000, "{} bytes", count.bytes_read);
        }
        *(if count.stored { &mut stored } else { &mut decoded }) += 1;
    }
    assert!(stored >= 16 && decoded >= 7, "{stored} stored, {decoded} decoded");
    check_archive(&out).unwrap();
}

#[test]
fn nothing_but_void_has_no_spectrum() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("void.npy");
    write_npy(&input, [20, 20, 20], |_, _, _| f64::NAN);
    // A small archive, which has no file of a spectrum in any case, and one with an index.
    for (name, amount, chunk_points) in [("one", 0.125, 100_000), ("several", 1.0, 1000)] {
        let out = dir.path().join(format!("{name}.isospan"));
        let amount = Amount::Fraction(amount);
        let settings =
            ReduceSettings { nan: NanPolicy::Mask, chunk_points, ..settings(SetKind::Halton, amount, 1) };
        pipeline::reduce_series(
            &[StepSource::new(&input, &OpenOptions::default())],
            &settings,
            &out,
            &common::run(1),
            &Silent,
        )
        .unwrap();
        let has = |file: &str| folder(&out).keys().any(|f| f.ends_with(file));
        assert_eq!((has("000000-index.seg"), has("000000-spectrum.seg")), (name == "several", false));
        let spectrum = contour_spectrum(&out).unwrap();
        assert!(spectrum.range.is_none() && spectrum.knots.is_empty());
        assert_eq!(count_active(&out, 0.0).unwrap().active_cells, 0);
        check_archive(&out).unwrap();
        assert!(summarize(&out).unwrap().suggestions.is_empty());
    }
}
