//! Several fields of each step: from one file or from several, each judged by its own range.

use crate::common::*;
use isospan::cells::CellBlock;
use isospan::formats::{OpenOptions, open_mesh};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;

const DIMS: [usize; 3] = [12, 11, 10];

/// A field by its name and its values.
type Field<'a> = (&'a str, &'a dyn Fn(f64, f64, f64) -> f64);

/// An image with some fields, at a time.
fn image(dir: &Path, name: &str, time: Option<f64>, fields: &[Field<'_>]) {
    let [nx, ny, nz] = DIMS;
    let at = |n: usize, count: usize| n as f64 / (count - 1) as f64;
    let mut arrays = String::new();
    for (field, value) in fields {
        let samples = (0..nx * ny * nz).map(|i| {
            let (x, y, z) = (i % nx, i / nx % ny, i / (nx * ny));
            (value(at(x, nx), at(y, ny), at(z, nz)) as f32).to_string()
        });
        let values = samples.collect::<Vec<_>>().join(" ");
        arrays += &format!(r#"<DataArray type="Float32" Name="{field}" format="ascii">{values}</DataArray>"#);
    }
    let time = time.map_or(String::new(), |t| {
        format!(
            r#"<FieldData><DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">{t}</DataArray></FieldData>"#
        )
    });
    let extent = format!("0 {} 0 {} 0 {}", nx - 1, ny - 1, nz - 1);
    let text = format!(
        r#"<?xml version="1.0"?><VTKFile type="ImageData" version="1.0" byte_order="LittleEndian"><ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="1 1 1">{time}<Piece Extent="{extent}"><PointData>{arrays}</PointData></Piece></ImageData></VTKFile>"#
    );
    fs::write(dir.join(name), text).unwrap();
}

fn heat(t: f64) -> impl Fn(f64, f64, f64) -> f64 {
    move |x, y, z| 300.0 + 50.0 * waves(x + 0.05 * t, y, z)
}

fn pressure(t: f64) -> impl Fn(f64, f64, f64) -> f64 {
    move |x, y, z| 1e5 + 4e4 * (x + 0.1 * t) * y + 1e3 * z
}

pub(crate) fn both(dir: &Path, name: &str, time: f64) {
    image(dir, name, Some(time), &[("T", &heat(time)), ("p", &pressure(time))]);
}

/// Exit code, standard output and standard error.
fn run(dir: &Path, args: &[&str]) -> (i32, String, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (out.status.code().unwrap(), text(out.stdout), text(out.stderr))
}

fn json(dir: &Path, args: &[&str]) -> Value {
    let (code, out, errors) = run(dir, &[args, &["--json"]].concat());
    assert_eq!(code, 0, "{args:?}: {errors}");
    serde_json::from_str(&out).unwrap()
}

fn refused(dir: &Path, args: &[&str], words: &str) {
    let (code, _, errors) = run(dir, args);
    assert!(code != 0 && errors.contains(words), "{args:?}: {code}: {errors}");
}

/// What a file of tetrahedra has, numbers by their bits.
#[derive(PartialEq)]
struct Exported {
    /// Name and values.
    fields: Vec<(String, Vec<u64>)>,
    points: Vec<[u64; 3]>,
    cells: Vec<Vec<u64>>,
}

impl Exported {
    fn read(path: &Path) -> Self {
        let mesh = open_mesh(path, &OpenOptions::default()).unwrap();
        let (mut points, mut cells, mut fields) = (vec![], vec![], vec![]);
        let (mut stream, mut block) = (mesh.points().unwrap(), vec![]);
        while stream.next_block(&mut block).unwrap() {
            points.extend(block.iter().map(|p| p.map(f64::to_bits)));
        }
        let (mut stream, mut block) = (mesh.cells().unwrap(), CellBlock::default());
        while stream.next_block(&mut block).unwrap() {
            cells.extend(block.iter().map(|(_, vertices)| vertices.to_vec()));
        }
        for field in &mesh.info().fields {
            let (mut values, mut block) = (vec![], vec![]);
            let mut stream = mesh.with_field(&field.name).unwrap().values(0, |_| false).unwrap();
            while stream.next_block(&mut block).unwrap() {
                values.extend(block.iter().map(|v| v.to_bits()));
            }
            fields.push((field.name.clone(), values));
        }
        Self { fields, points, cells }
    }

    fn names(&self) -> Vec<&str> {
        self.fields.iter().map(|f| &*f.0).collect()
    }
}

/// Number, time and field of each step.
fn listed(dir: &Path, archive: &str) -> Vec<(u64, f64, String)> {
    let about = json(dir, &["info", archive]);
    let steps = about["steps"].as_array().unwrap().iter();
    let of = |s: &Value| {
        let field = s["field"].as_str().unwrap().to_owned();
        (s["number"].as_u64().unwrap(), s["time"].as_f64().unwrap(), field)
    };
    steps.map(of).collect()
}

fn count(dir: &Path, archive: &str, more: &[&str]) -> u64 {
    let found = json(dir, &[&["count", archive][..], more].concat());
    let found = if found.is_array() { found[0].clone() } else { found };
    let counts = found["counts"].as_array().map_or(found.clone(), |all| all[0].clone());
    counts["active_cells"].as_u64().unwrap()
}

#[test]
fn each_step_has_all_fields() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    (0..3).for_each(|t| both(d, &format!("v{t}.vti"), f64::from(t)));
    let reduce = |out: &str, inputs: &[&str]| {
        let args = [
            &["reduce", "-q", "-o", out, "--fields", "T,p", "--points", "halton", "--fraction", "1/2"][..],
            inputs,
        ]
        .concat();
        let (code, _, errors) = run(d, &args);
        assert_eq!(code, 0, "{errors}");
    };
    reduce("all.isospan", &["v0.vti", "v1.vti", "v2.vti"]);
    let expected: Vec<_> =
        ["T", "p"].iter().flat_map(|f| (0..3).map(|n| (n, n as f64, (*f).to_owned()))).collect();
    assert_eq!(listed(d, "all.isospan"), expected);
    assert_eq!(run(d, &["check", "all.isospan"]).0, 0);
    // Each is what it is alone, by number, by time and between times.
    for (field, isovalue) in [("T", "310"), ("p", "110000")] {
        for n in ["0", "1", "2"] {
            let (file, out) = (format!("v{n}.vti"), format!("{field}{n}.isospan"));
            let reduce = format!("reduce -q {file} -o {out} --field {field} --points halton --fraction 1/2");
            assert_eq!(run(d, &reduce.split(' ').collect::<Vec<_>>()).0, 0);
            let alone = count(d, &out, &["-i", isovalue]);
            assert!(alone > 0);
            assert_eq!(count(d, "all.isospan", &["-i", isovalue, "--step", n, "--field", field]), alone);
            assert_eq!(count(d, "all.isospan", &["-i", isovalue, "--time", n, "--field", field]), alone);
        }
        assert!(count(d, "all.isospan", &["-i", isovalue, "--time", "0.5", "--field", field]) > 0);
        let out = format!("{field}_%d.ply");
        let surface = ["surface", "-q", "all.isospan", "-i", isovalue, "--all-steps", "-o", &out];
        refused(d, &surface, "choose one with --field");
        assert_eq!(run(d, &[&surface[..], &["--field", field]].concat()).0, 0);
        assert!(d.join(format!("{field}_2.ply")).exists());
    }
    refused(d, &["count", "all.isospan", "-i", "310", "--step", "1"], "each step has the fields T, p");
    refused(d, &["count", "all.isospan", "-i", "310", "--step", "1", "--field", "q"], "no field q");
    // Coloured by another field of the same step.
    let colours = ["surface", "-q", "all.isospan", "-i", "310", "--step", "2", "--field", "T", "-o", "c.ply"];
    assert_eq!(run(d, &[&colours[..], &["--colour-by", "p"]].concat()).0, 0);
    let alone = ["surface", "-q", "T2.isospan", "-i", "310", "-o", "d.ply", "--colour-by", "p2.isospan"];
    assert_eq!(run(d, &alone).0, 0);
    assert!(fs::read(d.join("c.ply")).unwrap() == fs::read(d.join("d.ply")).unwrap());

    // The same from files of one field each.
    for t in 0..3 {
        let time = f64::from(t);
        image(d, &format!("T{t}.vti"), Some(time), &[("T", &heat(time))]);
        image(d, &format!("p{t}.vti"), Some(time), &[("p", &pressure(time))]);
    }
    reduce("apart.isospan", &["T0.vti", "T1.vti", "T2.vti", "p0.vti", "p1.vti", "p2.vti"]);
    assert_eq!(listed(d, "apart.isospan"), expected);
    let args = ["reduce", "-o", "n.isospan", "--fields", "T,p", "T0.vti", "T1.vti", "p0.vti"];
    refused(d, &args, "T has 2 steps, p has 1");
    let args = ["reduce", "-o", "n.isospan", "--fields", "T,p", "T0.vti", "T1.vti", "p0.vti", "p2.vti"];
    refused(d, &args, "at time 2");
    assert!(!d.join("n.isospan").exists());

    // Further steps have all fields too, and go where their times lie.
    both(d, "late.vti", 1.5);
    let (code, _, errors) = run(d, &["append", "-q", "all.isospan", "late.vti"]);
    assert_eq!(code, 0, "{errors}");
    let times = [0.0, 1.0, 1.5, 2.0];
    let expected: Vec<_> =
        ["T", "p"].iter().flat_map(|f| (0..).zip(times).map(|(n, t)| (n, t, (*f).to_owned()))).collect();
    assert_eq!(listed(d, "all.isospan"), expected);
    assert_eq!(run(d, &["check", "all.isospan"]).0, 0);
    refused(d, &["append", "all.isospan", "T0.vti"], "no field p");
}

/// One moment is as ever: a step for each field. A second moment makes them fields of steps.
#[test]
fn fields_of_one_moment_become_those_of_steps() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    both(d, "a.vti", 3.0);
    both(d, "b.vti", 4.0);
    let reduce = "reduce -q a.vti -o a.isospan --fields T,p --points regular --fraction 1/2";
    assert_eq!(run(d, &reduce.split(' ').collect::<Vec<_>>()).0, 0);
    let before = count(d, "a.isospan", &["-i", "110000", "--step", "p"]);
    let (code, _, errors) = run(d, &["append", "-q", "a.isospan", "b.vti", "--fields", "T,p"]);
    assert_eq!(code, 0, "{errors}");
    let about = json(d, &["info", "a.isospan"]);
    let steps = about["steps"].as_array().unwrap().iter();
    let steps: Vec<_> =
        steps.map(|s| (s["number"].as_u64().unwrap(), s["field"].as_str().unwrap())).collect();
    assert_eq!(steps, [(0, "T"), (1, "T"), (0, "p"), (1, "p")]);
    assert_eq!(count(d, "a.isospan", &["-i", "110000", "--step", "0", "--field", "p"]), before);
    assert_eq!(run(d, &["check", "a.isospan"]).0, 0);
}

/// One file of a step has all its fields, each as it is exported alone.
#[test]
fn an_export_has_all_fields_of_the_step() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    (0..3).for_each(|t| both(d, &format!("v{t}.vti"), f64::from(t)));
    let plain = ["--points", "halton", "--fraction", "1/2"];
    let reduce = |out: &str, inputs: &[&str]| {
        let args =
            [&["reduce", "-q", "-o", out, "--fields", "T,p", "--chunk-points", "300"][..], &plain, inputs];
        let (code, _, errors) = run(d, &args.concat());
        assert_eq!(code, 0, "{errors}");
    };
    reduce("all.isospan", &["v0.vti", "v1.vti", "v2.vti"]);
    reduce("one.isospan", &["v2.vti"]);
    let export = |archive: &str, out: &str, more: &[&str]| {
        json(d, &[&["export", archive, "-q", "-o", out, "--force"][..], more].concat())
    };
    let vtu = |out: &str| Exported::read(&d.join(out));
    let alone = |archive: &str, more: &[&str]| {
        export(archive, "alone.vtu", more);
        vtu("alone.vtu")
    };
    for (archive, step, of_field) in [
        ("all.isospan", &["--step", "2"][..], ["--field", "--field"]),
        ("all.isospan", &["--time", "1.25"], ["--field", "--field"]),
        ("one.isospan", &[], ["--step", "--field"]),
    ] {
        for (out, more) in
            [("b.vtu", &[][..]), ("b.vtkhdf", &[]), ("b.vtu", &["--fields", "T,p", "--compress"])]
        {
            let report = export(archive, out, &[step, more].concat());
            assert_eq!(report["fields"], serde_json::json!(["T", "p"]));
            let found = vtu(out);
            assert_eq!(found.names(), ["T", "p"]);
            for (n, (flag, name)) in of_field.into_iter().zip(["T", "p"]).enumerate() {
                let one = alone(archive, &[step, &[flag, name]].concat());
                assert_eq!(one.fields.len(), 1);
                assert!(one.fields[0] == found.fields[n], "{archive} {step:?} {name}");
                assert!(one.points == found.points && one.cells == found.cells);
            }
        }
    }
    // Any memory and threads; what does not fit waits on disk.
    let whole = export("all.isospan", "whole.vtu", &["--step", "1"]);
    let tight = export("all.isospan", "tight.vtu", &["--step", "1", "--threads", "1", "--memory", "40M"]);
    assert_eq!(whole["bytes_read"], tight["bytes_read"]);
    assert!(fs::read(d.join("whole.vtu")).unwrap() == fs::read(d.join("tight.vtu")).unwrap());
    // The first field is that of the range.
    for (fields, range) in [("T,p", "310:"), ("p,T", "110000:")] {
        let both = export("all.isospan", "r.vtu", &["--step", "1", "--fields", fields, "--range", range]);
        let one = alone("all.isospan", &["--step", "1", "--field", &fields[..1], "--range", range]);
        assert_eq!(both["tetrahedra"].as_u64().unwrap(), one.cells.len() as u64);
        assert!(vtu("r.vtu").fields[0] == one.fields[0] && !one.cells.is_empty());
    }
    let out = ["export", "all.isospan", "-o", "n.vtu"];
    let refuse = |more: &[&str], words: &str| refused(d, &[&out[..], more].concat(), words);
    refuse(&["--range", "310:"], "name that field first in --fields");
    refuse(&["--fields", "T,q"], "no field q; it has T, p");
    refuse(&["--fields", "T,T"], "T is asked for twice");
    refuse(&["--step", "T", "--fields", "p"], "give a step by its number");
    assert!(!d.join("n.vtu").exists());
}

/// Where one field has no value and another has, the other is written; where none has, nothing is.
#[test]
fn an_export_of_fields_keeps_what_any_has() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let hole = |from: f64| move |x: f64, y: f64, z: f64| if x > from { f64::NAN } else { waves(x, y, z) };
    image(d, "a.vti", None, &[("T", &hole(0.4)), ("p", &hole(0.7))]);
    let reduce = "reduce -q a.vti -o a.isospan --fields T,p --points regular --fraction 1 --nan mask";
    let (code, _, errors) = run(d, &reduce.split(' ').collect::<Vec<_>>());
    assert_eq!(code, 0, "{errors}");
    let export =
        |out: &str, more: &[&str]| json(d, &[&["export", "a.isospan", "-q", "-o", out][..], more].concat());
    let count = |report: &Value, name: &str| report[name].as_u64().unwrap();
    let [t, p, both] = [("T.vtu", &["--field", "T"][..]), ("p.vtu", &["--field", "p"]), ("both.vtu", &[])]
        .map(|(out, more)| export(out, more));
    assert!(count(&t, "tetrahedra") < count(&p, "tetrahedra"));
    assert_eq!(count(&both, "tetrahedra"), count(&p, "tetrahedra"));
    assert_eq!(count(&both, "void_tetrahedra"), count(&p, "void_tetrahedra"));
    let has_nan = |field: &(String, Vec<u64>)| field.1.iter().any(|v| f64::from_bits(*v).is_nan());
    let fields = Exported::read(&d.join("both.vtu")).fields;
    assert!(has_nan(&fields[0]) && !has_nan(&fields[1]));
}

/// Points go where the fields need them, whatever their units are.
#[test]
fn adapted_points_do_not_depend_on_units() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    // One field bends where x is small, the other where it is large.
    let bend = |x: f64, y: f64, z: f64| (40.0 * x * x).sin() + 0.1 * y * z;
    let errors_of = |scale: f64, out: &str| {
        let scaled = move |x: f64, y: f64, z: f64| scale * bend(x, y, z);
        image(d, "a.vti", None, &[("T", &|x, y, z| bend(1.0 - x, y, z)), ("p", &scaled)]);
        let args = ["reduce", "-q", "a.vti", "-o", out, "--fields", "T,p", "--adapt", "--fraction", "1/3"];
        let (code, _, errors) = run(d, &[&args[..], &[]].concat());
        assert_eq!(code, 0, "{errors}");
        let file = format!("{out}.vtu");
        assert_eq!(run(d, &["export", "-q", out, "--field", "T", "-o", &file]).0, 0);
        Exported::read(&d.join(file))
    };
    let [same, large, small] =
        [(1.0, "same.isospan"), (1024.0, "large.isospan"), (1.0 / 1024.0, "small.isospan")]
            .map(|(scale, out)| errors_of(scale, out));
    assert!(same == large && same == small);
    // A target in parts of the ranges as well.
    let args =
        ["reduce", "-q", "a.vti", "-o", "t.isospan", "--fields", "T,p", "--adapt", "--target-rms", "3%"];
    let report = json(d, &args);
    assert_eq!(report["target"]["met"], true, "{report}");
    let found = report["target"]["reached"].as_f64().unwrap();
    assert!(found > 0.01 && found <= 0.03, "{found}");
    // What is there already is judged as it was.
    let again = json(d, &args);
    assert_eq!(again["made_before"], true);
    assert_eq!(
        (&again["target"]["bound"], &again["target"]["reached"]),
        (&report["target"]["bound"], &report["target"]["reached"])
    );
}

/// A page without a server shows each field: the copy has all.
#[test]
#[cfg_attr(not(has_wasm), ignore = "wants the page's WebAssembly: run tools/viewer/wasm")]
fn several_fields_of_a_step_are_published() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    (0..2).for_each(|t| both(d, &format!("v{t}.vti"), f64::from(t)));
    let reduce = ["reduce", "-q", "v0.vti", "v1.vti", "-o", "f.isospan", "--fields", "T,p"];
    assert_eq!(run(d, &reduce).0, 0);
    let (code, _, errors) = run(d, &["publish", "-q", "f.isospan", "-o", "page"]);
    assert_eq!(code, 0, "{errors}");
    for (field, isovalue) in [("T", "310"), ("p", "110000")] {
        for step in ["0", "1"] {
            let what = ["-i", isovalue, "--step", step, "--field", field];
            let found = count(d, "page/f.isospan", &what);
            assert!(found > 0 && found == count(d, "f.isospan", &what), "{field} {step}");
        }
    }
}

/// A question is about one field: no command takes the one that `--step` names for that of
/// `--field`.
#[test]
fn a_step_that_is_another_field_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    (0..2).for_each(|t| both(d, &format!("v{t}.vti"), f64::from(t)));
    assert_eq!(run(d, &["reduce", "-q", "v0.vti", "v1.vti", "-o", "s.isospan", "--fields", "T,p"]).0, 0);
    assert_eq!(run(d, &["reduce", "-q", "v0.vti", "-o", "f.isospan", "--fields", "T,p"]).0, 0);
    let commands: [&[&str]; 12] = [
        &["count", "-i", "310"],
        &["spectrum"],
        &["spectrum", "--plot", "o.svg"],
        &["surface", "-i", "310", "-o", "o.ply"],
        &["surface", "-i", "50%", "-o", "o.ply"],
        &["surface", "-i", "310", "-o", "-"],
        &["surface", "-i", "310", "-o", "o.ply", "--colour-by", "p"],
        &["compare", "s.isospan", "-i", "310"],
        &["probe", "--grid", "3,3,3", "-o", "o.npy"],
        &["export", "-o", "o.vti"],
        &["info"],
        &["render", "-i", "310", "-o", "o.png"],
    ];
    for archive in ["s.isospan", "f.isospan"] {
        for command in &commands {
            let ask = |field| {
                let what = ["--step", "T", "--field", field];
                run(d, &[&command[..1], &[archive], &command[1..], &what].concat())
            };
            let (code, out, errors) = ask("p");
            let words = "isospan: error: --step T and --field p are two fields: give one of them, or the step by \
                         its number\n";
            assert_eq!((code, &*out, &*errors), (2, "", words), "{archive} {command:?}");
        }
        // The same field twice is one.
        let twice = ["-i", "310", "--step", "T", "--field", "T"];
        assert!(count(d, archive, &twice) > 0);
    }
    assert_eq!(fs::read_dir(d).unwrap().count(), 4, "nothing was written");
}

/// All steps of a field are not those of another one.
#[test]
fn steps_of_a_field_that_is_not_there_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    (0..2).for_each(|t| both(d, &format!("v{t}.vti"), f64::from(t)));
    assert_eq!(run(d, &["reduce", "-q", "v0.vti", "v1.vti", "-o", "T.isospan", "--field", "T"]).0, 0);
    assert_eq!(run(d, &["reduce", "-q", "v0.vti", "-o", "f.isospan", "--fields", "T,p"]).0, 0);
    for archive in ["T.isospan", "f.isospan"] {
        for command in [&["surface", archive, "-i", "310", "-o", "o%d.ply"][..], &["spectrum", archive]] {
            let words = format!("{archive}: step 0 has the field T, not p: steps together");
            refused(d, &[command, &["--all-steps", "--field", "p"]].concat(), &words);
        }
        assert!(!d.join("o0.ply").exists());
    }
    let of_one =
        ["surface", "-q", "f.isospan", "-i", "110000", "-o", "o%d.ply", "--steps", "1", "--field", "p"];
    assert_eq!(run(d, &of_one).0, 0);
    let all = ["surface", "-q", "T.isospan", "-i", "310", "-o", "T%d.ply", "--all-steps", "--field", "T"];
    assert_eq!(run(d, &all).0, 0);
}

/// A part of the range is that of each field: kelvins and pascals are not added.
#[test]
fn a_target_is_that_of_each_field() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    both(d, "a.vti", 0.0);
    let points = ["--points", "regular"];
    let reduce = ["reduce", "-q", "a.vti", "-o", "a.isospan", "--fields", "p,T", points[0], points[1]];
    let report = json(d, &[&reduce[..], &["--target-rms", "2%"]].concat());
    assert!(report["target"]["of_ranges"] == true && report["target"]["met"] == true, "{report}");
    let steps = report["steps"].as_array().unwrap();
    for step in steps {
        let [lo, hi] = [0, 1].map(|n| step["range"][n].as_f64().unwrap());
        let rms = step["error"][0].as_f64().unwrap();
        assert!(rms <= 0.021 * (hi - lo), "{step}");
    }
    let (_, words, _) =
        run(d, &["reduce", "a.vti", "-o", "w.isospan", "--fields", "p,T", "--target-rms", "2%"]);
    assert!(words.contains("% of 2 % wanted, of the range of each field"), "{words}");
    refused(d, &[&reduce[..], &["--force", "--target-rms", "5"]].concat(), "there are several");
}

/// Colours are those of the other archive at the same time, not of the same number.
#[test]
fn colours_of_another_archive_are_those_of_the_time() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for (name, times) in [("a", vec![0.0, 1.0, 2.0]), ("b", vec![1.0, 2.0, 3.0])] {
        let files: Vec<String> = times.iter().map(|t| format!("{name}{t}.vti")).collect();
        times.iter().zip(&files).for_each(|(t, file)| both(d, file, *t));
        let (field, out) = (if name == "a" { "T" } else { "p" }, format!("{name}.isospan"));
        let mut args =
            vec!["reduce", "-q", "-o", &out, "--field", field, "--points", "regular", "--fraction", "1/2"];
        args.extend(files.iter().map(|f| &**f));
        let (code, _, errors) = run(d, &args);
        assert_eq!(code, 0, "{errors}");
    }
    let surface = |step: &[&str], out: &str| {
        let args = ["surface", "-q", "a.isospan", "-i", "310", "--colour-by", "b.isospan", "-o", out];
        run(d, &[&args[..], step].concat())
    };
    assert_eq!(surface(&["--step", "1"], "number.ply").0, 0);
    assert_eq!(surface(&["--time", "1"], "time.ply").0, 0);
    assert!(fs::read(d.join("number.ply")).unwrap() == fs::read(d.join("time.ply")).unwrap());
    let (code, _, errors) = surface(&["--step", "0"], "none.ply");
    assert!(code == 2 && errors.contains("step 0 is at time 0") && errors.contains("1 to 3"), "{errors}");
    assert!(!d.join("none.ply").exists());
}

/// A night that is repaired, repeated or changed holds no other up.
#[test]
fn nights_are_repaired_repeated_and_changed() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    fs::create_dir(d.join("scope")).unwrap();
    let night = |more: &[&str]| {
        let args = [
            "nightly",
            "scope",
            "n*.vti",
            "n.isospan",
            "--settle=0s",
            "--points",
            "regular",
            "--fraction",
            "1/2",
            "-q",
        ];
        let (code, out, errors) = run(d, &[&args[..], &["--fields", "T,p"], more].concat());
        (code, out, errors)
    };
    let write = |name: &str, time: f64| both(d, &format!("scope/{name}"), time);
    write("n1.vti", 1.0);
    fs::write(d.join("scope/n2.vti"), "cut off").unwrap();
    write("n3.vti", 3.0);
    assert_eq!(night(&[]).0, 1);
    let times = || -> Vec<f64> {
        let listed = listed(d, "n.isospan");
        let of_p = listed.iter().filter(|(_, _, field)| field == "p").map(|(_, time, _)| *time).collect();
        assert_eq!(listed.len() % 2, 0);
        of_p
    };
    assert_eq!(times(), [1.0, 3.0]);
    // Repaired: it goes between the others. Repeated: it is left out, and the next one is added.
    write("n2.vti", 2.0);
    write("n3b.vti", 3.0);
    write("n4.vti", 4.0);
    let (code, out, errors) = night(&[]);
    assert_eq!(code, 1, "{out}{errors}");
    assert_eq!(times(), [1.0, 2.0, 3.0, 4.0]);
    assert!(out.contains("left out   n3b.vti: ") && out.contains("--replace"), "{out}");
    assert!(errors.contains("n3b.vti") && !errors.contains("already"), "said once: {errors}");
    fs::remove_file(d.join("scope/n3b.vti")).unwrap();
    assert_eq!(night(&[]).0, 0);
    // Changed under its name.
    image(d, "scope/n2.vti", Some(2.0), &[("T", &heat(9.0)), ("p", &pressure(9.0))]);
    write("n5.vti", 5.0);
    let (code, out, _) = night(&[]);
    assert!(code == 1 && out.contains("changed    n2.vti: "), "{code} {out}");
    assert_eq!(times(), [1.0, 2.0, 3.0, 4.0, 5.0]);
    let (code, out, errors) = night(&["--replace"]);
    assert_eq!(code, 0, "{out}{errors}");
    assert!(out.contains("replaced   1"), "{out}");
    assert_eq!((times(), night(&[]).0), (vec![1.0, 2.0, 3.0, 4.0, 5.0], 0));
    assert_eq!(run(d, &["check", "n.isospan"]).0, 0);
}
