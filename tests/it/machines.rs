//! The same bytes on every machine: archives of small fields, and what the program makes of them,
//! have the checksums of `tests/data/machines.tsv`, for any processor, system and vector
//! instructions.
//!
//! The fields are computed by sums, products and quotients, which are exact everywhere; sines are
//! not.

use crate::common::*;
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Like a sine, of period 4.
fn wave(t: f64) -> f64 {
    let t = t - 4.0 * (t / 4.0).round();
    t * (2.0 - t.abs())
}

/// A field without a symmetry.
fn waves(x: f64, y: f64, z: f64) -> f64 {
    wave(3.1 * x) * wave(2.3 * y + 1.0) + wave(3.7 * y) * wave(2.9 * z + 1.0) + 0.3 * wave(2.5 * z * x)
}

/// The same where it is positive; elsewhere zeros of both signs.
fn zeros(x: f64, y: f64, z: f64) -> f64 {
    let value = waves(x, y, z);
    if value > 0.0 { value } else { 0f64.copysign(wave(40.0 * x + 27.0 * y + 35.0 * z)) }
}

/// The same with a hole.
fn hole(x: f64, y: f64, z: f64) -> f64 {
    if ball(x + 0.4, y, z - 0.2) > 0.2 { f64::NAN } else { waves(x, y, z) }
}

/// What is run, in the folder of the fields.
const COMMANDS: &[&str] = &[
    // Every set of points, every way to a value.
    "reduce waves.npy -o default.isospan",
    "reduce waves.npy -o hammersley.isospan --points hammersley --fraction 1/4 --chunk-points 4000",
    "reduce waves.npy -o halton.isospan --fraction 1/4 --points halton --values sample",
    "reduce waves.npy -o cross.isospan --fraction 1/4 --points hyperbolic-cross",
    "reduce waves.npy -o regular.isospan --fraction 1/4 --points regular",
    "reduce waves.npy -o cubic.isospan --points hammersley --fraction 1/8 --values sample --interp cubic",
    "reduce waves.npy -o thesis.isospan --points hammersley --fraction 1/8 --values sample --interp cubic-thesis",
    "reduce waves.npy -o nearest.isospan --points hammersley --fraction 1/8 --interp nearest",
    "reduce waves.npy -o bits.isospan --points hammersley --fraction 1/4 --value-bits 12",
    "reduce waves.npy -o adapt.isospan --fraction 1/8 --adapt",
    "reduce waves.npy -o target.isospan --target-rms 2% --adapt",
    "reduce waves.npy -o bound.isospan --target-max 3%",
    "reduce hole.npy -o hole.isospan --fraction 1/4 --nan mask --adapt",
    "reduce zeros.npy -o zeros.isospan --points hammersley --fraction 1/4 --values sample",
    "reduce zeros.npy -o zeros-bits.isospan --points hammersley --fraction 1/4 --value-bits 8",
    "reduce step_?.npy -o series.isospan --points hammersley --fraction 1/8 --keyframes 2 --chunk-points 2000",
    "reduce step_?.npy -o steps.isospan",
    "reduce zeros.npy -o zeros-default.isospan",
    "reduce hole.npy -o mask.isospan --nan mask",
    "reduce labels.npy -o labels.isospan --labels",
    "reduce cells.vtk -o cells.isospan --fraction 0.99",
    "reduce cells.vtk -o own.isospan --fraction 1 --chunk-points 100",
    "reduce cells.vtk -o quadratic.isospan --fraction 1/1 --values sample --interp quadratic",
    // Every form of an answer.
    "surface hammersley.isospan -i 0.2 -o waves.ply",
    "surface hammersley.isospan -i -0.3,0.2 -o waves.vtp --cap",
    "surface hammersley.isospan -i 0.2 -o waves.glb --roi 3:20,2:19,4:17",
    "surface hammersley.isospan -i -0.3,0.2 -o waves.vtkhdf",
    "surface default.isospan -i 0.2 -o default.ply",
    "surface mask.isospan -i 0.2 -o mask.ply --level 1",
    "surface zeros-default.isospan -i 0 -o zeros-default.stl",
    "surface zeros.isospan -i 0 -o zeros.stl",
    "surface cells.isospan -i 0.3 -o cells.obj",
    "surface own.isospan -i 0.3 -o own.ply",
    "reduce waves.npy -o units.isospan --length-unit um",
    "surface units.isospan -i -0.3,0.2 -o waves.precomputed",
    "surface hammersley.isospan -i 0.2 -o fewer.ply --decimate 0.3 --largest 2",
    "surface series.isospan -i 0.1 -o between.ply --time 1.3",
    "probe hole.isospan --grid 17,13,11 -o grid.npy",
    "export cross.isospan -o cross.vtu",
    "export cross.isospan -o cross.vtkhdf",
    "export hole.isospan -o hole.vtu --compress",
    "export hole.isospan -o hole.vtkhdf --compress",
    "spectrum hammersley.isospan --plot spectrum.svg",
    "spectrum series.isospan --all-steps --plot spectrum.png",
    "render waves.ply -o waves.png --size 160,120 --lights 16 --caption isospan",
    "render hammersley.isospan -i -0.3,0.2 -o glass.png --size 160,120 --lights 16 --together --opacity 0.4,1 --slice z=50% --clip z=:50% --scale-bar",
    "render series.isospan --slice y=40% --all-steps -o planes.gif --size 200,160 --colour-map coolwarm",
    "render waves.ply -o turn.png --size 80,60 --lights 8 --turntable 3",
    "measure hammersley.isospan --against waves.npy --map error.vti",
];

#[test]
fn every_machine_writes_these_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let dims = [30, 28, 26];
    write_npy(&d.join("waves.npy"), dims, waves);
    write_npy(&d.join("zeros.npy"), dims, zeros);
    write_npy(&d.join("hole.npy"), dims, hole);
    write_npy(&d.join("labels.npy"), [40, 28, 70], |x, y, z| (9.0 * waves(x, y, z)).round());
    for step in 0..3 {
        let field = |x, y, z| waves(x, y, z) + 0.1 * f64::from(step) * x;
        write_npy(&d.join(format!("step_{step}.npy")), dims, field);
    }
    write_hexahedra(&d.join("cells.vtk"), waves);
    for command in COMMANDS {
        let args = command.split(' ').chain(["-q"]);
        let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(d).args(args).output().unwrap();
        assert!(out.status.success(), "{command}: {}", String::from_utf8_lossy(&out.stderr));
    }
    let found: String = folder(d).iter().fold(String::new(), |mut text, (path, bytes)| {
        let sum: String = Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect();
        let path = path.to_str().unwrap().replace('\\', "/");
        writeln!(text, "{path}\t{sum}").unwrap();
        text
    });
    let expected = include_str!("../data/machines.tsv");
    if found != expected {
        let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join("machines.tsv");
        fs::write(&kept, &found).unwrap();
        let [found, expected] = [&*found, expected].map(|text| text.lines().collect::<Vec<_>>());
        let other: Vec<&str> = found.iter().filter(|line| !expected.contains(line)).copied().collect();
        panic!(
            "{} of {} files have other bytes than {} were told. If they are to have them on all machines, copy {} to tests/data. \
             If this machine alone finds them, that is an error of the program.\n{}",
            other.len(),
            found.len(),
            expected.len(),
            kept.display(),
            other.join("\n")
        );
    }
}
