//! Units: those that files and users name reach the archive, its steps and what is printed, and no
//! byte but those of the manifest.
#![cfg(unix)]

use crate::common::{folder, waves, write_hexahedra, write_npy};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

fn run(dir: &Path, args: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isospan"));
    let out = command.current_dir(dir).args(args).arg("-q").stdin(Stdio::null()).output().unwrap();
    let text = |b| String::from_utf8(b).unwrap();
    (out.status.code().expect("ended by itself"), text(out.stdout), text(out.stderr))
}

fn ok(dir: &Path, args: &[&str]) -> String {
    let (code, out, err) = run(dir, args);
    assert!(code == 0 && err.is_empty(), "{args:?}: {code}: {err}");
    out
}

fn fails(dir: &Path, args: &[&str], why: &str) {
    let (code, out, err) = run(dir, args);
    assert!(code == 2 && out.is_empty() && err.lines().count() == 1, "{args:?}: {code}: {out}{err}");
    assert!(err.contains(why), "{err}");
}

fn info(dir: &Path, archive: &str) -> Value {
    serde_json::from_str(&ok(dir, &["info", archive, "--json"])).unwrap()
}

fn volumes(dir: &Path, count: usize) {
    for n in 0..count {
        write_npy(&dir.join(format!("v{n}.npy")), [20, 18, 16], |x, y, z| waves(x, y, z) + 0.1 * n as f64);
    }
}

fn data(name: &str) -> String {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
        .join("tests/data")
        .join(name)
        .to_str()
        .unwrap()
        .to_owned()
}

const THREE: [&str; 6] = ["--unit", "K", "--length-unit", "micrometer", "--time-unit", "seconds"];

#[test]
fn named_units_are_in_the_manifest_alone() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    volumes(d, 1);
    ok(d, &["reduce", "v0.npy", "-o", "a.isospan"]);
    let plain = folder(&d.join("a.isospan"));
    assert_eq!(info(d, "a.isospan")["units"], json!({}));
    ok(d, &[&["reduce", "v0.npy", "-o", "b.isospan"], &THREE[..]].concat());
    let named = folder(&d.join("b.isospan"));
    // A step without a time has no unit of one.
    assert_eq!(info(d, "b.isospan")["units"], json!({ "value": "K", "length": "µm" }));
    assert_eq!(info(d, "b.isospan")["steps"][0]["unit"], "K");
    let but_for_manifest = |files: &std::collections::BTreeMap<PathBuf, Vec<u8>>| {
        let mut files = files.clone();
        files.retain(|name, _| !name.ends_with("manifest.zst"));
        files
    };
    assert!(plain.len() > 1 && plain != named && but_for_manifest(&plain) == but_for_manifest(&named));
    // The same reduction with other names is the same archive with another manifest; --force is not
    // needed.
    ok(d, &[&["reduce", "v0.npy", "-o", "a.isospan"], &THREE[..]].concat());
    assert!(folder(&d.join("a.isospan")) == named);
    let told = ok(d, &["info", "a.isospan"]);
    assert!(told.contains("K of values, µm of lengths") && told.contains(" K\n"), "{told}");
    ok(d, &["check", "a.isospan"]);
    fails(d, &["reduce", "v0.npy", "-o", "c.isospan", "--unit", " "], "a unit");
    fails(d, &["reduce", "v0.npy", "-o", "c.isospan", "--unit", "K", "--fields", "a,b"], "--fields");
}

#[test]
fn shards_have_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    volumes(d, 1);
    let how = [&["--points", "halton", "--chunk-points", "300"], &THREE[..]].concat();
    ok(d, &[&["reduce", "v0.npy", "-o", "a.isospan"], &how[..]].concat());
    ok(d, &[&["plan", "v0.npy", "-o", "b.isospan", "--shards", "2"], &how[..]].concat());
    ok(d, &["work", "b.isospan", "--shard", "1/2"]);
    ok(d, &["work", "b.isospan", "--shard", "0/2"]);
    ok(d, &["commit", "b.isospan"]);
    assert!(folder(&d.join("a.isospan")) == folder(&d.join("b.isospan")));
}

#[test]
fn further_steps_take_over_units_and_have_no_others() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    volumes(d, 3);
    ok(
        d,
        &[
            &["reduce", "v?.npy", "-o", "all.isospan", "--points", "regular", "--times", "0,0.5,..."],
            &THREE[..],
        ]
        .concat(),
    );
    ok(
        d,
        &[
            &["reduce", "v[01].npy", "-o", "a.isospan", "--points", "regular", "--times", "0,0.5,..."],
            &THREE[..],
        ]
        .concat(),
    );
    for (flag, unit) in [("--unit", "degC"), ("--length-unit", "mm"), ("--time-unit", "ms")] {
        let before = folder(&d.join("a.isospan"));
        let wrong = ["append", "a.isospan", "v2.npy", "--times", "1", flag, unit];
        fails(d, &wrong, &format!("is {unit}, that of step 0 is"));
        assert!(folder(&d.join("a.isospan")) == before);
    }
    ok(d, &["append", "a.isospan", "v2.npy", "--times", "1"]);
    assert!(folder(&d.join("a.isospan")) == folder(&d.join("all.isospan")));
    // What was added is there.
    let again = ok(d, &["append", "a.isospan", "v2.npy", "--times", "1"]);
    assert!(again.contains("none added"), "{again}");
    let found = info(d, "a.isospan");
    assert_eq!(found["units"], json!({ "value": "K", "length": "µm", "time": "s" }));
    assert_eq!(found["steps"][2]["unit"], "K");
}

#[test]
fn fields_of_a_file_have_their_own_units() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let input = data("netcdf3_units.nc");
    let told = ok(d, &["info", &input, "--field", "temp:t1"]);
    assert!(told.contains(" K  (mean"), "{told}");
    let how = ["--fraction", "1", "--points", "halton"];
    ok(d, &[&["reduce", &input, "-o", "f.isospan", "--fields", "temp:t0,share"], &how[..]].concat());
    let found = info(d, "f.isospan");
    assert_eq!(found["units"], json!({ "value": "K", "length": "m" }));
    assert_eq!((&found["steps"][0]["unit"], &found["steps"][1]["unit"]), (&json!("K"), &Value::Null));
    // A series of frames has the unit of its times; times that the user gives have none.
    ok(d, &[&["reduce", &input, "-o", "s.isospan", "--field", "temp"], &how[..]].concat());
    let units = info(d, "s.isospan")["units"].clone();
    assert_eq!(units, json!({ "value": "K", "length": "m", "time": "hours since 2000-01-01" }));
    ok(d, &[&["reduce", &input, "-o", "t.isospan", "--field", "temp", "--times", "1,2"], &how[..]].concat());
    assert_eq!(info(d, "t.isospan")["units"], json!({ "value": "K", "length": "m" }));
    // No text of a file commands a terminal.
    ok(d, &[&["reduce", &input, "-o", "o.isospan", "--field", "odd"], &how[..]].concat());
    for command in [&["info", "o.isospan"][..], &["spectrum", "o.isospan"]] {
        let told = ok(d, command);
        assert!(told.contains("kg m-3") && !told.contains('\u{1b}'), "{told}");
    }
}

#[test]
fn meshes_get_units_from_the_user() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_hexahedra(&d.join("m.vtk"), waves);
    for (name, fraction) in [("own.isospan", "1"), ("few.isospan", "1/2")] {
        ok(d, &[&["reduce", "m.vtk", "-o", name, "--fraction", fraction], &THREE[..]].concat());
        assert_eq!(info(d, name)["units"], json!({ "value": "K", "length": "µm" }));
    }
}

#[test]
fn pictures_and_texts_have_units() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    volumes(d, 2);
    for (name, units) in [("none.isospan", &[][..]), ("units.isospan", &THREE)] {
        ok(d, &[&["reduce", "v?.npy", "-o", name, "--times", "0,0.5,..."], units].concat());
    }
    let small = ["--size", "240,200", "--lights", "0", "--antialias", "1"];
    let pictures: [&[&str]; 5] = [
        &["-i", "0,0.2"],
        &["-i", "0,0.2", "--together"],
        &["-i", "0", "--scale-bar"],
        &["--slice", "z=50%"],
        &["-i", "0", "--steps", "0:1"],
    ];
    for how in pictures {
        let draw = |archive: &str, out: &str| {
            let told = ok(d, &[&["render", archive, "-o", out, "--force"], how, &small[..]].concat());
            (told, std::fs::read(d.join(out)).unwrap())
        };
        let (plain, without) = draw("none.isospan", "a.png");
        let (told, with) = draw("units.isospan", "b.png");
        assert!(with != without, "{how:?}: the unit is in the picture");
        let named = told.contains(" K:") || told.contains(" µm\n");
        assert!(named && !plain.contains(" K:") && !plain.contains("µm"), "{told}");
    }
    // Characters that the font lacks are no reason to fail.
    ok(d, &["reduce", "v0.npy", "-o", "odd.isospan", "--unit", "雪", "--length-unit", "雪"]);
    ok(d, &[&["render", "odd.isospan", "-i", "0,0.2", "-o", "c.png", "--scale-bar"], &small[..]].concat());

    ok(d, &["spectrum", "units.isospan", "--plot", "one.svg"]);
    let svg = std::fs::read_to_string(d.join("one.svg")).unwrap();
    assert!(svg.contains("isovalue (K)") && svg.contains("µm²"), "{svg}");
    ok(d, &["spectrum", "units.isospan", "--all-steps", "--plot", "all.svg"]);
    let svg = std::fs::read_to_string(d.join("all.svg")).unwrap();
    assert!(svg.contains("isovalue (K)") && svg.contains("time (s)"), "{svg}");
    let told = ok(d, &["spectrum", "units.isospan"]);
    assert!(told.contains("µm³, values"), "{told}");
    let told = ok(d, &["probe", "units.isospan", "--grid", "3,3,3", "-o", "p.npy"]);
    assert!(told.contains("values in K"), "{told}");
}

/// The file of each night may count from a date of its own.
#[test]
fn times_are_counted_from_the_date_of_the_first_step() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let bytes = std::fs::read(data("dialects/cf3.nc")).unwrap();
    let night = |name: &str, date: &[u8; 10]| {
        let mut bytes = bytes.clone();
        for at in 0..bytes.len() - 10 {
            if bytes[at..].starts_with(b"2000-01-01") {
                bytes[at..at + 10].copy_from_slice(date);
            }
        }
        std::fs::write(d.join(name), bytes).unwrap();
    };
    for (name, date) in [("a.nc", b"2000-01-01"), ("b.nc", b"2000-01-02"), ("c.nc", b"2000-01-03")] {
        night(name, date);
    }
    let few = ["--points", "regular", "--fraction", "1"];
    ok(d, &[&["reduce", "a.nc", "b.nc", "-o", "s.isospan", "--field", "record"][..], &few].concat());
    ok(d, &["append", "s.isospan", "c.nc"]);
    let report = info(d, "s.isospan");
    let times: Vec<f64> = (0..3).map(|n| report["steps"][n]["time"].as_f64().unwrap()).collect();
    assert_eq!(times, [7.5, 31.5, 55.5]);
    assert_eq!(report["units"]["time"], "hours since 2000-01-01");
    // A time before all others goes there.
    night("d.nc", b"1999-12-31");
    ok(d, &["append", "s.isospan", "d.nc", "--field", "record"]);
    let report = info(d, "s.isospan");
    let times: Vec<f64> = (0..4).map(|n| report["steps"][n]["time"].as_f64().unwrap()).collect();
    assert_eq!(times, [-16.5, 7.5, 31.5, 55.5]);
}

#[test]
fn surface_files_keep_units_and_times() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    volumes(d, 2);
    ok(d, &[&["reduce", "v?.npy", "-o", "u.isospan", "--times", "0,0.5"], &THREE[..]].concat());
    for format in ["ply", "stl", "obj", "vtp", "vtkhdf", "glb"] {
        let file = format!("s.{format}");
        ok(d, &["surface", "u.isospan", "-i", "0.1", "--step", "1", "-o", &file]);
        let told = ok(d, &["check", &file]);
        assert!(told.contains("µm²"), "{file}: {told}");
        let units =
            serde_json::from_str::<Value>(&ok(d, &["check", &file, "--json"])).unwrap()["units"].clone();
        // The 80 bytes of STL do not reach all of them.
        let all = json!({ "value": "K", "length": "µm", "time": "s" });
        assert!(units == all || format == "stl" && units["length"] == "µm", "{file}: {units}");
        // Coordinates are those of the archive, also of the GLB in metres.
        ok(d, &["check", &file, "--within", "u.isospan"]);
        let told = ok(d, &["compare", "s.ply", &file, "--samples", "100"]);
        assert!(told.contains("  in µm; the largest distance is 0 %"), "{file}: {told}");
    }
    ok(d, &["reduce", "v1.npy", "-o", "m.isospan", "--length-unit", "m"]);
    ok(d, &["surface", "m.isospan", "-i", "0.1", "-o", "m.ply"]);
    let (code, out, err) = run(d, &["compare", "s.ply", "m.ply", "--samples", "100"]);
    assert!(code == 0 && out.contains("in world units"), "{out}");
    assert!(err.is_empty() || err.contains("A is in µm and B in m"), "{err}");
    let text = String::from_utf8_lossy(&std::fs::read(d.join("s.vtp")).unwrap()).into_owned();
    assert_eq!(text.matches("Name=\"isovalue\"").count(), 1);
    assert!(text.contains("Name=\"TimeValue\" NumberOfTuples=\"1\" format=\"ascii\">0.5<"));
    ok(d, &["surface", "u.isospan", "-i", "0,0.1", "-o", "two.vtp"]);
    let text = String::from_utf8_lossy(&std::fs::read(d.join("two.vtp")).unwrap()).into_owned();
    assert_eq!(text.matches("Name=\"isovalue\"").count(), 1);
    // All steps in one file.
    let told = ok(d, &["surface", "u.isospan", "-i", "0,0.1", "--all-steps", "-o", "all.vtkhdf"]);
    assert!(told.contains("step 1 (time 0.5)") && told.contains("all steps"), "{told}");
    assert!(std::fs::metadata(d.join("all.vtkhdf")).unwrap().len() > 10_000);
    fails(d, &["surface", "u.isospan", "-i", "0", "-o", "x.ply", "--compress"], "--compress is for .glb");
    ok(d, &["surface", "u.isospan", "-i", "0,0.1", "-o", "two.3mf"]);
    fails(d, &["check", "two.3mf"], "3MF is written and not read");
    let told = ok(d, &["surface", "u.isospan", "-i", "0.1", "-o", "smooth.ply", "--smooth", "--components"]);
    assert!(told.contains(" µm in the mean") && told.contains("area µm²"), "{told}");
}

#[test]
fn a_coded_glb_is_the_quantized_one_in_fewer_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    volumes(d, 1);
    ok(d, &[&["reduce", "v0.npy", "-o", "u.isospan"], &THREE[..]].concat());
    for (file, how) in [("q.glb", "--compress"), ("c.glb", "--compress=meshopt"), ("p.glb", "")] {
        let how: &[&str] = if how.is_empty() { &[] } else { &[how] };
        ok(d, &[&["surface", "u.isospan", "-i", "0,0.1", "--memory", "256MiB", "-o", file], how].concat());
    }
    ok(d, &["surface", "u.isospan", "-i", "0,0.1", "-o", "c2.glb", "--compress=meshopt", "--threads", "1"]);
    let bytes = |file: &str| std::fs::read(d.join(file)).unwrap();
    assert_eq!(bytes("c.glb"), bytes("c2.glb"));
    let [plain, quantized, coded] = ["p.glb", "q.glb", "c.glb"].map(|file| bytes(file).len());
    assert!(3 * coded < 2 * quantized && 2 * quantized < 3 * plain, "{plain} {quantized} {coded}");
    let [a, b] = ["q.glb", "c.glb"]
        .map(|file| serde_json::from_str::<Value>(&ok(d, &["check", file, "--json"])).unwrap());
    for name in ["vertices", "triangles", "components", "boundary_edges", "units"] {
        assert_eq!(a[name], b[name], "{name}");
    }
    // Triangles may begin at another corner, so sums are rounded otherwise.
    for name in ["area", "volume"] {
        let [of_a, of_b] = [&a, &b].map(|report| report[name].as_f64());
        let is_near = of_a.zip(of_b).map_or(of_a == of_b, |(a, b)| (a / b - 1.0).abs() < 1e-9);
        assert!(is_near, "{name}: {of_a:?} {of_b:?}");
    }
    fails(d, &["surface", "u.isospan", "-i", "0", "-o", "x.glb", "--compress=zip"], "meshopt");
}

#[test]
fn neuroglancer_gets_a_folder_of_meshes_in_nanometres() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    volumes(d, 2);
    ok(d, &[&["reduce", "v?.npy", "-o", "u.isospan", "--times", "0,0.5"], &THREE[..]].concat());
    let ask = ["surface", "u.isospan", "-i", "0,0.1", "-o", "n.precomputed"];
    ok(d, &ask);
    let read = |name: &str| std::fs::read(d.join("n.precomputed").join(name)).unwrap();
    let info: Value = serde_json::from_slice(&read("segment_properties/info")).unwrap();
    assert_eq!(info["inline"]["ids"], json!(["1", "2"]));
    assert_eq!(info["inline"]["properties"][0]["values"], json!(["isovalue 0", "isovalue 0.1"]));
    // A micrometre is a thousand nanometres, and cells begin at the least coordinates.
    let info: Value = serde_json::from_slice(&read("info")).unwrap();
    assert_eq!((&info["transform"][0], &info["transform"][5]), (&json!(1000.0), &json!(1000.0)));
    ok(d, &["surface", "u.isospan", "-i", "0.1", "-o", "one.ply"]);
    let mesh = isospan::formats::surface::read_surface(&d.join("one.ply")).unwrap();
    let shard = read("0.shard");
    let word = |at: usize| u64::from_le_bytes(shard[at..at + 8].try_into().unwrap()) as usize;
    // The index of the one minishard: of two segments numbers, gaps, bytes.
    let index = 16 + word(0);
    let [segments, gaps, bytes] = [0, 1, 2].map(|row| [word(index + 16 * row), word(index + 16 * row + 8)]);
    assert_eq!((segments, word(8) - word(0)), ([1, 1], 48));
    let second = 16 + gaps[0] + bytes[0] + gaps[1];
    assert_eq!(second + bytes[1], index);
    let float = |n: usize| f32::from_le_bytes(shard[second + 4 * n..][..4].try_into().unwrap());
    for k in 0..3 {
        let least = mesh.vertices.iter().map(|v| v.position[k]).fold(f32::INFINITY, f32::min);
        assert_eq!(float(3 + k), least);
    }
    fails(d, &ask, "n.precomputed exists");
    ok(d, &[&ask[..], &["--force"]].concat());
    let refused = [
        (&["-i", "0", "-o", "x.precomputed", "--all-steps"][..], "have no steps"),
        (&["-i", "0", "-o", "-", "--format", "precomputed"], "are a folder"),
        (&["-i", "0", "-o", "x.precomputed", "--colour-by", "u.isospan"], "have no colours"),
    ];
    for (args, says) in refused {
        fails(d, &[&["surface", "u.isospan"], args].concat(), says);
    }
    ok(d, &["reduce", "v1.npy", "-o", "m.isospan"]);
    fails(d, &["surface", "m.isospan", "-i", "0.1", "-o", "x.precomputed"], "--length-unit");
}
