//! What commands print with `--json` is what the schema of reports says,
//! tools/book/src/reports.schema.json: every field is described there, and every field that it
//! requires is printed.

use crate::common::*;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

fn schema() -> Value {
    let file =
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("tools/book/src/reports.schema.json");
    serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap()
}

/// What is wrong with a value at a place; the first thing. Of JSON Schema what the file uses, and
/// more strictly: a field that the schema does not name is wrong.
fn fault(root: &Value, schema: &Value, value: &Value, at: &str) -> Option<String> {
    let shown: String = value.to_string().chars().take(200).collect();
    let wrong = |why: String| Some(format!("{at}: {why}: {shown}"));
    if let Some(name) = schema["$ref"].as_str() {
        let target = &root["$defs"][name.strip_prefix("#/$defs/").unwrap()];
        assert!(target.is_object(), "{name} is not defined");
        return fault(root, target, value, at);
    }
    for alternatives in ["oneOf", "anyOf"] {
        if let Some(all) = schema[alternatives].as_array() {
            let faults: Vec<Option<String>> = all.iter().map(|s| fault(root, s, value, at)).collect();
            let fit = faults.iter().filter(|f| f.is_none()).count();
            let is_right = if alternatives == "oneOf" { fit == 1 } else { fit > 0 };
            return if is_right { None } else { wrong(format!("{fit} of {faults:?} fit")) };
        }
    }
    if let Some(constant) = schema.get("const") {
        return if constant == value { None } else { wrong(format!("expected {constant}")) };
    }
    if let Some(all) = schema["enum"].as_array() {
        return if all.contains(value) { None } else { wrong(format!("expected one of {all:?}")) };
    }
    let types: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(several) => several.iter().map(|t| t.as_str().unwrap()).collect(),
        other => panic!("{at}: no type: {other}"),
    };
    let is = |kind: &&str| match *kind {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "string" => value.is_string(),
        "integer" => value.is_u64() || value.is_i64(),
        "number" => value.is_number(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        other => panic!("{at}: an unknown type: {other}"),
    };
    if !types.iter().any(is) {
        return wrong(format!("expected {types:?}"));
    }
    if let (Some(least), Some(number)) = (schema["minimum"].as_f64(), value.as_f64())
        && number < least
    {
        return wrong(format!("expected at least {least}"));
    }
    if let Some(items) = value.as_array() {
        let length = items.len() as u64;
        if schema["minItems"].as_u64().is_some_and(|n| length < n)
            || schema["maxItems"].as_u64().is_some_and(|n| length > n)
        {
            return wrong("another number of items".into());
        }
        return items.iter().enumerate().find_map(|(n, item)| {
            fault(root, schema["prefixItems"].get(n).unwrap_or(&schema["items"]), item, &format!("{at}[{n}]"))
        });
    }
    let fields = value.as_object()?;
    let required = schema["required"].as_array().into_iter().flatten();
    if let Some(name) = required.map(|n| n.as_str().unwrap()).find(|n| !fields.contains_key(*n)) {
        return wrong(format!("no {name}"));
    }
    fields.iter().find_map(|(name, field)| {
        let known = schema["properties"].get(name).or_else(|| schema.get("additionalProperties"));
        match known {
            Some(schema) => fault(root, schema, field, &format!("{at}.{name}")),
            None => wrong(format!("{name} is not in the schema")),
        }
    })
}

/// Runs a command in a folder; what it prints, line by line, is checked.
fn reports(root: &Value, dir: &Path, args: &[&str], seen: &mut BTreeSet<String>) {
    let out = Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap();
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(matches!(out.status.code(), Some(0 | 5)), "{args:?}: {stderr}");
    let text = String::from_utf8(out.stdout).unwrap();
    assert!(!text.is_empty(), "{args:?}: {stderr}");
    for line in text.lines() {
        check(root, &serde_json::from_str(line).unwrap(), &format!("{args:?}"), seen);
    }
}

fn check(root: &Value, report: &Value, what: &str, seen: &mut BTreeSet<String>) {
    let name = report["schema"].as_str().unwrap_or_else(|| panic!("{what}: no schema: {report}"));
    assert!(root["$defs"].get(name).is_some(), "{what}: {name} is not in the schema");
    assert_eq!(fault(root, &root["$defs"][name], report, name), None, "{what}");
    let listed = serde_json::json!({ "$ref": format!("#/$defs/{name}") });
    assert!(root["oneOf"].as_array().unwrap().contains(&listed), "{name} is not listed");
    seen.insert(name.to_owned());
}

#[test]
fn every_report_is_as_its_schema_says() {
    let (root, mut seen) = (schema(), BTreeSet::new());
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    for n in 0..2 {
        write_npy(&d.join(format!("v{n}.npy")), [20, 18, 16], |x, y, z| waves(x, y, z) + 0.1 * f64::from(n));
    }
    write_npy(&d.join("holes.npy"), [20, 18, 16], |x, y, z| if x > 0.8 { f64::NAN } else { ball(x, y, z) });
    write_npy(&d.join("labels.npy"), [20, 18, 16], |x, _, _| (3.0 * x).round());
    write_hexahedra(&d.join("m.vtk"), waves);
    let surface = ["surface", "a.isospan", "-i", "0.1"];
    let commands: &[&[&str]] = &[
        &["info", "v0.npy", "labels.npy", "holes.npy", "m.vtk"],
        &["info", "v0.npy", "m.vtk", "--no-scan"],
        &["reduce", "v0.npy", "-o", "a.isospan", "--dry-run"],
        &["reduce", "v0.npy", "-o", "a.isospan"],
        &["reduce", "v0.npy", "-o", "a.isospan"],
        &["reduce", "v?.npy", "-o", "s.isospan", "--times", "0,0.5,..."],
        &["append", "s.isospan", "v0.npy", "--times", "9", "-i", "0.1"],
        &["reduce", "holes.npy", "-o", "h.isospan", "--nan", "mask", "--points", "hammersley"],
        &["reduce", "v0.npy", "-o", "i.isospan", "-i", "0.1,1e6"],
        &["reduce", "v0.npy", "-o", "j.isospan", "-i", "50%", "--target-surface", "1%"],
        &["reduce", "v0.npy", "-o", "k.isospan", "--points", "hammersley"],
        &["reduce", "v0.npy", "-o", "r.isospan", "--points", "regular"],
        &["reduce", "v0.npy", "-o", "x.isospan", "--points", "hyperbolic-cross"],
        &["reduce", "v?.npy", "-o", "y.isospan", "--points", "pyramid"],
        &["reduce", "v0.npy", "-o", "t.isospan", "--target-rms", "10%", "--dry-run"],
        &["reduce", "v0.npy", "-o", "t.isospan", "--target-rms", "10%"],
        &["reduce", "v0.npy", "-o", "t.isospan", "--target-rms", "10%"],
        &["reduce", "v0.npy", "-o", "z.isospan", "--size", "50%"],
        &["reduce", "v0.npy", "-o", "d.isospan", "--adapt", "--focus", "10%:90%"],
        &["reduce", "m.vtk", "-o", "m.isospan", "--fraction", "1/2"],
        &["reduce", "m.vtk", "-o", "w.isospan", "--fraction", "1"],
        &[
            "info",
            "a.isospan",
            "s.isospan",
            "h.isospan",
            "r.isospan",
            "x.isospan",
            "y.isospan",
            "d.isospan",
            "m.isospan",
            "w.isospan",
        ],
        &[&surface[..], &["-o", "a.ply", "--components", "--decimate", "50%", "--roi", "2:,:,:"]].concat(),
        &["surface", "a.isospan", "-i", "-0.5,50%", "-o", "a_{}.stl", "--cap"],
        &["surface", "s.isospan", "-i", "0.1", "--all-steps", "-o", "s%d.ply"],
        &["reduce", "labels.npy", "-o", "l.isospan", "--lossless"],
        &["surface", "l.isospan", "--labels", "1,2", "-o", "l.glb"],
        &["count", "l.isospan", "--labels", "all"],
        &["count", "a.isospan", "-i", "0.1,0.123456"],
        &["surface", "y.isospan", "-i", "0.1", "--level", "1", "-o", "y.ply"],
        &["surface", "y.isospan", "-i", "0.1", "--triangles", "500", "--all-steps", "-o", "y%d.ply"],
        &["count", "y.isospan", "-i", "0.1", "--level", "1"],
        &["probe", "y.isospan", "--grid", "4,4,4", "--level", "1", "-o", "y.vti"],
        &["measure", "y.isospan", "--against", "v0.npy", "--level", "1"],
        &["render", "y.isospan", "-i", "0.1", "--level", "1", "-o", "y.png", "--size", "40,40"],
        &["count", "y.isospan", "-i", "0.1", "--numbers"],
        &["count", "k.isospan", "-i", "0.1", "--numbers"],
        &["spectrum", "a.isospan", "--plot", "a.svg"],
        &["spectrum", "a.isospan", "-i", "0.1"],
        &["spectrum", "s.isospan", "--all-steps"],
        &["probe", "a.isospan", "--grid", "4,4,4", "-o", "a.vti"],
        &["export", "k.isospan", "-o", "a.vtu", "--range", "20%:80%"],
        &["export", "a.isospan", "-o", "a.nrrd", "--level", "1"],
        &["export", "y.isospan", "-o", "y.nrrd", "--level", "1"],
        &["measure", "a.isospan", "--against", "v0.npy", "--map", "map.vti"],
        &["measure", "a.isospan", "--against", "v0.npy", "-i", "0.1,1e6"],
        &["measure", "m.isospan", "--against", "m.vtk"],
        &["compare", "a.isospan", "y.isospan", "-i", "0.1", "--samples", "500", "--level", "1"],
        &["compare", "a.ply", "a_-0.5.stl", "--samples", "500"],
        &["check", "a.isospan"],
        &["check", "a.isospan", "-i", "0.1"],
        &["check", "m.isospan"],
        &["check", "a.ply"],
        &["check", "a_-0.5.stl", "--within", "a.isospan"],
        &["render", "a.ply", "-o", "a.png", "--size", "40,40", "--lights", "0", "--distance-to", "a.ply"],
        &["render", "a.isospan", "-i", "0.1", "-o", "b.png", "--size", "40,40", "--lights", "0"],
        &["render", "a.isospan", "--slice", "z=50%", "-o", "c.png", "--size", "200,200"],
        &["brick", "v0.npy", "-o", "v.bricks"],
        &[
            "plan",
            "v0.npy",
            "-o",
            "p.isospan",
            "--shards",
            "2",
            "--points",
            "regular",
            "--chunk-points",
            "200",
            "-i",
            "0.1",
        ],
        &["status", "p.isospan"],
        &["slurm", "p.isospan"],
        &["work", "p.isospan"],
        &["commit", "p.isospan"],
        &["gc", "p.isospan", "--older-than", "0s"],
        &["nightly", ".", "v0.npy", "night.isospan", "--settle", "0s", "-i", "0.1"],
    ];
    for args in commands {
        reports(&root, d, &[*args, &["--json", "-q"]].concat(), &mut seen);
    }
    #[cfg(has_wasm)]
    reports(&root, d, &["publish", "a.isospan", "-o", "viewer", "--json", "-q"], &mut seen);
    view(&root, d, &mut seen);
    let known = root["oneOf"].as_array().unwrap().iter().map(|r| r["$ref"].as_str().unwrap());
    let known: BTreeSet<String> = known.map(|r| r.trim_start_matches("#/$defs/").to_owned()).collect();
    // Without the page's WebAssembly nothing is published.
    let is_there = |name: &&String| match name.as_str() {
        "isospan.view" => cfg!(feature = "view"),
        "isospan.publish" => cfg!(has_wasm),
        _ => true,
    };
    let unseen: Vec<&String> = known.difference(&seen).filter(is_there).collect();
    assert!(unseen.is_empty(), "nothing printed {unseen:?}");
}

/// The first line that `isospan view` prints; then it is ended.
#[cfg(feature = "view")]
fn view(root: &Value, dir: &Path, seen: &mut BTreeSet<String>) {
    use std::io::{BufRead, BufReader};
    let mut child = Command::new(env!("CARGO_BIN_EXE_isospan"))
        .current_dir(dir)
        .args(["view", "a.isospan", "--json", "-q"])
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    check(root, &serde_json::from_str(&line).unwrap(), "view", seen);
}

#[cfg(not(feature = "view"))]
fn view(_root: &Value, _dir: &Path, _seen: &mut BTreeSet<String>) {}

/// The test would see a field that is not described, or one that is missing.
#[test]
fn a_wrong_report_is_found() {
    let root = schema();
    let right = serde_json::json!({
        "schema": "isospan.count", "version": 1, "isovalue": 0.5, "active_cells": 3, "tetrahedra": 7,
        "stored": true, "bytes_read": 9,
    });
    let fault_of = |value: &Value| fault(&root, &root["$defs"]["isospan.count"], value, "count");
    assert_eq!(fault_of(&right), None);
    let with = |name: &str, value: Value| {
        let mut changed = right.clone();
        changed[name] = value;
        changed
    };
    for (changed, why) in [
        (with("more", 1.into()), "more is not in the schema"),
        (with("version", 2.into()), "expected 1"),
        (with("stored", 1.into()), "boolean"),
        (with("tetrahedra", (-7).into()), "at least 0"),
    ] {
        let text = fault_of(&changed).unwrap();
        assert!(text.contains(why), "{text}");
    }
    let mut less = right.clone();
    less.as_object_mut().unwrap().remove("stored");
    assert!(fault_of(&less).unwrap().contains("no stored"));
}
