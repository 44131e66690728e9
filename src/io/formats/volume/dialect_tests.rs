//! Dialects inside NetCDF-3, HDF5 and Zarr, against what their programs' own readers say of them.

use crate::error::Result;
use crate::formats::shared::OpenOptions;
use crate::formats::tests::open_coordinates;
use crate::formats::tests::{read_all, torture, write};
use crate::formats::{open_volume, steps_of};
use crate::volume::{VolumeInfo, VolumeSource};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

/// What `tools/make_golden_dialects.py` wrote.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/dialects").join(name)
}

fn options(field: Option<&str>) -> OpenOptions {
    OpenOptions { field: field.map(str::to_owned), ..OpenOptions::default() }
}

fn open(path: &Path, field: Option<&str>) -> Result<VolumeSource> {
    open_volume(path, &options(field))
}

/// Why a file, or a field of it, is refused.
fn refusal(path: &Path, field: Option<&str>) -> String {
    let error = open(path, field).err().expect("refused");
    assert_eq!(error.exit_code(), 5, "{error}");
    let line = error.to_string();
    assert!(!line.contains('\n') && line.contains(&path.display().to_string()), "{line}");
    line
}

/// A place, to a hundred-thousandth.
fn key(world: [f64; 3]) -> [i64; 3] {
    world.map(|x| (x * 1e5).round() as i64)
}

/// Compares the samples of a source with those of an oracle, each at its place in the world.
fn agrees(source: VolumeSource, oracle: &str) -> VolumeInfo {
    let (info, values) = read_all(source);
    let text = fs::read_to_string(data(&format!("{oracle}.txt"))).unwrap();
    let row = |line: &str| line.split(' ').map(|word| word.parse().unwrap()).collect::<Vec<f64>>();
    let rows = text.lines().map(row).map(|v| (key([v[0], v[1], v[2]]), v[3]));
    let known: HashMap<[i64; 3], f64> = rows.collect();
    assert_eq!(known.len(), values.len(), "{oracle}");
    let [nx, ny, _] = info.dims.map(|d| d as usize);
    for (i, value) in values.into_iter().enumerate() {
        let at = [i % nx, i / nx % ny, i / (nx * ny)].map(|n| n as f64);
        let world = info.geometry.to_world(at);
        let expected = *known.get(&key(world)).unwrap_or_else(|| panic!("{oracle}: nothing at {world:?}"));
        let value = f64::from(value);
        let near = (value - expected).abs() <= 1e-5 * expected.abs().max(1.0);
        assert!(near || value.is_nan() && expected.is_nan(), "{oracle} {world:?}: {value}, not {expected}");
    }
    info
}

#[test]
fn minc_1_is_placed_and_scaled_slice_by_slice() {
    for name in ["minc1_bytes.mnc", "minc1_shorts.mnc"] {
        let info = agrees(open(&data(name), None).unwrap(), name);
        assert_eq!((&*info.format, info.units.length.unwrap().as_str()), ("MINC 1", "mm"));
        assert_eq!(info.field.name, "image");
        let has_steps = name == "minc1_bytes.mnc";
        assert_eq!(info.assumed.axes, if has_steps { [false; 3] } else { [false, true, true] });
        assert!(open_coordinates(&data(name), &options(None)).unwrap().is_none());
    }
    let given = OpenOptions { spacing: Some([1.0; 3]), ..OpenOptions::default() };
    assert_eq!(open_volume(&data("minc1_bytes.mnc"), &given).err().expect("its own").exit_code(), 2);
}

/// The bytes of a file with one text in place of another of the same length.
fn changed(name: &str, from: &[u8], to: &[u8]) -> Vec<u8> {
    let mut bytes = fs::read(data(name)).unwrap();
    assert_eq!(from.len(), to.len());
    let places: Vec<usize> =
        (0..bytes.len() - from.len()).filter(|&at| bytes[at..].starts_with(from)).collect();
    assert!(!places.is_empty(), "{from:?} is in {name}");
    for at in places {
        bytes[at..at + to.len()].copy_from_slice(to);
    }
    bytes
}

#[test]
fn times_of_minc_are_steps() {
    for name in ["minc1_times.mnc", "minc2_times.mnc"] {
        for field in [None, Some("image"), Some("image:t*")] {
            let steps = steps_of(&[data(name)], &options(field)).unwrap();
            assert_eq!(steps.iter().map(|s| s.time).collect::<Vec<_>>(), [Some(10.0), Some(12.5)], "{name}");
            for (t, step) in steps.iter().enumerate() {
                let source = open_volume(&step.path, &step.options).unwrap();
                let info = agrees(source, &format!("minc_times.t{t}"));
                assert_eq!((info.field.name, info.fields.len()), (format!("image:t{t}"), 2));
                let [length, time] = [info.units.length, info.units.time].map(|unit| unit.unwrap());
                assert_eq!([length.as_str(), time.as_str()], ["mm", "s"]);
            }
        }
        let line = open(&data(name), None).err().expect("two volumes").to_string();
        assert!(line.contains("image:t0 (int16), image:t1 (int16)"), "{line}");
    }
}

#[test]
fn minc_1_that_is_not_read_is_named() {
    let dir = tempfile::tempdir().unwrap();
    for (from, to, reason) in [
        (&b"xspace"[..], &b"tspace"[..], "yspace,zspace,tspace"),
        (b"regular__", b"irregular", "irregular spacing"),
        (b"image-min", b"image-mix", "image-min"),
    ] {
        let line = refusal(&write(&dir, "a.mnc", &changed("minc1_bytes.mnc", from, to)), None);
        assert!(line.contains(reason), "{line}");
    }
}

#[test]
fn damage_is_an_error_or_an_answer() {
    let bytes = fs::read(data("minc1_shorts.mnc")).unwrap();
    torture("a.mnc", &bytes, 4);
    let dir = tempfile::tempdir().unwrap();
    let bytes = fs::read(data("tomviz.emd")).unwrap();
    for at in (0..bytes.len()).step_by(13) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0xff;
        let path = write(&dir, "a.emd", &damaged);
        if let Err(e) = open(&path, None) {
            let line = e.to_string();
            assert!(!line.contains('\n') && line.contains("a.emd"), "{line}");
        }
    }
}

#[test]
fn microscopes_axes_are_followed() {
    for (name, format) in
        [("ncem.emd", "EMD"), ("tomviz.emd", "EMD"), ("py4dstem.h5", "EMD"), ("hyperspy.hspy", "HyperSpy")]
    {
        let info = agrees(open(&data(name), None).unwrap(), name);
        assert!(info.format.starts_with(format), "{name}: {}", info.format);
        assert_eq!(info.assumed.axes, [false; 3], "{name}");
        let unit = info.units.length.map(|unit| unit.to_string());
        assert_eq!(unit.as_deref(), Some(if name == "py4dstem.h5" { "Å" } else { "nm" }), "{name}");
    }
    let line = refusal(&data("spectra.hspy"), None);
    assert!(line.contains("axes of space") && line.contains("'Energy' (eV)"), "{line}");
    let line = refusal(&data("velox.emd"), None);
    assert!(line.contains("a Velox file") && line.contains("frames are the last axis"), "{line}");
    let dir = tempfile::tempdir().unwrap();
    for (from, to, reason) in [(&b"[n_m]"[..], &b"[deg]"[..], "'x' (deg)"), (b"[n_m]", b"[sec]", "'x' (sec)")]
    {
        let line = refusal(&write(&dir, "a.emd", &changed("tomviz.emd", from, to)), None);
        assert!(line.contains(reason), "{line}");
    }
    // Without its description the array is a plain one.
    let plain = write(&dir, "b.emd", &changed("tomviz.emd", b"emd_group_type", b"emd_group_kind"));
    let info = open(&plain, None).unwrap().info().clone();
    assert_eq!((info.assumed.axes, info.assumed.can_be_given), ([true; 3], true));
}

#[test]
fn missing_values_and_signs_are_those_of_cf() {
    for name in ["cf3.nc", "cf4.nc"] {
        for field in ["two", "wide", "ranged"] {
            let info = agrees(open(&data(name), Some(field)).unwrap(), &format!("{name}.{field}"));
            assert_eq!(info.assumed.axes, [false; 3]);
        }
    }
}

/// Writes an uncompressed array of one chunk.
fn zarr(folder: &Path, name: &str, shape: &[u64], dtype: &str, bytes: &[u8], attributes: &Value) {
    let folder = folder.join(name);
    fs::create_dir_all(&folder).unwrap();
    let array = json!({
        "zarr_format": 2, "shape": shape, "chunks": shape, "dtype": dtype, "compressor": null,
        "fill_value": null, "order": "C", "filters": null
    });
    fs::write(folder.join(".zarray"), array.to_string()).unwrap();
    fs::write(folder.join(".zattrs"), attributes.to_string()).unwrap();
    let chunk = if shape.is_empty() { "0".to_string() } else { vec!["0"; shape.len()].join(".") };
    fs::write(folder.join(chunk), bytes).unwrap();
}

/// A group as xarray writes it, with the coordinates of `cf3.nc`.
fn zarr_group(dir: &tempfile::TempDir) -> PathBuf {
    let group = dir.path().join("a.zarr");
    fs::create_dir_all(&group).unwrap();
    fs::write(group.join(".zgroup"), r#"{"zarr_format": 2}"#).unwrap();
    let since = "hours since 2000-01-01";
    for (axis, values, unit) in [
        ("time", &[7.5][..], since),
        ("t", &[0.0, 1.0, 2.0], since),
        ("z", &[0.0, 2.0, 4.0], "m"),
        ("y", &[0.0, 1.0, 2.0, 3.0], "m"),
        ("x", &[0.0, 1.0, 2.0, 3.0, 4.0], "m"),
    ] {
        let bytes: Vec<u8> = values.iter().flat_map(|v: &f64| v.to_le_bytes()).collect();
        let attributes = json!({ "_ARRAY_DIMENSIONS": [axis], "units": unit });
        zarr(&group, axis, &[values.len() as u64], "<f8", &bytes, &attributes);
    }
    let attributes = json!({ "_ARRAY_DIMENSIONS": [], "units": since });
    zarr(&group, "moment", &[], "<f8", &9.25f64.to_le_bytes(), &attributes);
    group
}

#[test]
fn zarr_follows_cf_alike() {
    let dir = tempfile::tempdir().unwrap();
    let group = zarr_group(&dir);
    let space = json!(["z", "y", "x"]);
    let mut stored: Vec<i16> = (0..60).collect();
    stored[..3].copy_from_slice(&[-32767, -999, -998]);
    let bytes: Vec<u8> = stored.iter().flat_map(|v| v.to_le_bytes()).collect();
    let packed = json!({
        "_ARRAY_DIMENSIONS": space, "_FillValue": -32767, "missing_value": [-999, -998], "scale_factor": 0.5,
        "add_offset": 10.0
    });
    zarr(&group, "two", &[3, 4, 5], "<i2", &bytes, &packed);
    let bytes: Vec<u8> = (0..60).map(|n| 255 - 3 * n).collect();
    let unsigned = json!({ "_ARRAY_DIMENSIONS": space, "_Unsigned": "true", "_FillValue": -1 });
    zarr(&group, "wide", &[3, 4, 5], "|i1", &bytes, &unsigned);
    for field in ["two", "wide"] {
        agrees(open(&group, Some(field)).unwrap(), &format!("cf3.nc.{field}"));
    }
    let floats: Vec<u8> = (0..60u8).flat_map(|n| f32::from(n).to_le_bytes()).collect();
    let add =
        |name: &str, shape: &[u64], attributes: Value| zarr(&group, name, shape, "<f4", &floats, &attributes);
    add("record", &[1, 3, 4, 5], json!({ "_ARRAY_DIMENSIONS": ["time", "z", "y", "x"] }));
    add("scalar", &[3, 4, 5], json!({ "_ARRAY_DIMENSIONS": space, "coordinates": "moment" }));
    for (field, time) in [("record", 7.5), ("scalar", 9.25)] {
        times_of_one(&group, field, time);
    }
    for (name, shape, attributes, reason) in [
        ("times", [3, 4, 5], json!({ "_ARRAY_DIMENSIONS": ["t", "y", "x"] }), "three axes of space"),
        ("bands", [3, 4, 5], json!({ "_ARRAY_DIMENSIONS": ["band", "y", "x"] }), "three axes of space"),
        ("faces", [3, 4, 5], json!({ "_ARRAY_DIMENSIONS": space, "mesh": "m", "location": "face" }), "UGRID"),
    ] {
        add(name, &shape, attributes);
        let line = open(&group.join(name), None).err().expect("refused").to_string();
        assert!(line.contains(reason), "{line}");
    }
    add("Experiments/it/data", &[3, 4, 5], json!({}));
    fs::create_dir_all(group.join("Experiments/it/axis-0")).unwrap();
    let axis =
        json!({ "name": "z", "navigate": false, "offset": 0.0, "scale": 2.0, "size": 3, "units": "nm" });
    fs::write(group.join("Experiments/it/axis-0/.zattrs"), axis.to_string()).unwrap();
    let line = open(&group.join("Experiments/it/data"), None).err().expect("refused").to_string();
    assert!(line.contains("HyperSpy (.zspy)") && line.contains("save it as .hspy"), "{line}");
    // Axes are what they are called, in any order.
    add("turned", &[5, 4, 3], json!({ "_ARRAY_DIMENSIONS": ["lon", "lat", "lev"] }));
    assert_eq!(open(&group, Some("turned")).unwrap().info().dims, [5, 4, 3]);
    assert_eq!(open(&group, Some("turned")).unwrap().info().assumed.axes, [true; 3]);
}

/// A file or group that is one step, at a time with a unit.
fn times_of_one(path: &Path, field: &str, time: f64) {
    let steps = steps_of(&[path.to_path_buf()], &options(Some(field))).unwrap();
    assert_eq!((steps.len(), steps[0].time), (1, Some(time)), "{field}");
    let unit = open(path, Some(field)).unwrap().info().units.time.clone();
    assert_eq!(unit.unwrap().as_str(), "hours since 2000-01-01", "{field}");
}

#[test]
fn the_time_of_a_file_with_one_record_is_kept() {
    for name in ["cf3.nc", "cf4.nc"] {
        times_of_one(&data(name), "record", 7.5);
        times_of_one(&data(name), "scalar", 9.25);
        let steps = steps_of(&[data(name)], &options(Some("two"))).unwrap();
        assert_eq!(steps[0].time, None, "its time is not known: {name}");
    }
    // A frame of a series has its own.
    let levels = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/levels.nc");
    let steps = steps_of(&[levels], &options(Some("temp:t1"))).unwrap();
    assert_eq!((steps.len(), steps[0].time), (1, Some(6.0)));
}

#[test]
fn what_is_no_place_is_refused_by_name() {
    for name in ["cf3.nc", "cf4.nc"] {
        let line = refusal(&data(name), Some("times"));
        assert!(line.contains("three axes of space, got 3 (t) x 4 (y) x 5 (x)"), "{line}");
        assert!(line.contains("time is no place"), "{line}");
        let line = refusal(&data(name), Some("faces"));
        assert!(line.contains("values on each face of the mesh 'mesh' (UGRID)"), "{line}");
    }
}

/// A NetCDF-3 file with one attribute, a dimension of 5, and a variable of three axes.
fn classic(attribute: &str, text: &str, variable: &str) -> Vec<u8> {
    let word = |n: u32| n.to_be_bytes().to_vec();
    let padded = |text: &str| {
        let mut bytes = [word(text.len() as u32), text.as_bytes().to_vec()].concat();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    };
    let mut out = [b"CDF\x01".to_vec(), word(0), word(10), word(1), padded("n"), word(5)].concat();
    out.extend([word(12), word(1), padded(attribute), word(2), padded(text), word(11), word(1)].concat());
    out.extend(
        [padded(variable), word(3), word(0), word(0), word(0), word(0), word(0), word(5), word(500)].concat(),
    );
    let begin = out.len() as u32 + 4;
    [out, word(begin), vec![0; 500]].concat()
}

#[test]
fn programs_that_use_netcdf_3_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let open_as = |attribute: &str, text: &str, variable: &str| {
        open(&write(&dir, "a.nc", &classic(attribute, text, variable)), None)
    };
    let plain = open_as("title", "a field", "field").unwrap().info().clone();
    assert_eq!((plain.dims, plain.assumed.axes), ([5; 3], [true; 3]));
    for (attribute, text, variable, reason) in [
        ("Conventions", "AMBER", "coordinates", "a trajectory of AMBER"),
        ("file_format", "ETSF Nanoquanta", "density", "a file of ETSF"),
        ("xyz_origin", "0 0 0", "data", "a map of Chimera"),
        ("floating_point_word_size", "8", "vals", "an Exodus II file of another name"),
    ] {
        let line = open_as(attribute, text, variable).err().expect("refused").to_string();
        assert!(line.contains(reason), "{line}");
    }
}

#[test]
fn a_spacing_that_is_assumed_is_known_to_be() {
    let dir = tempfile::tempdir().unwrap();
    let path = write(&dir, "a.nc", &classic("title", "a field", "field"));
    let given = OpenOptions { spacing: Some([2.0; 3]), ..OpenOptions::default() };
    assert_eq!(open_volume(&path, &given).unwrap().info().assumed.axes, [false; 3]);
    let header = |spacing: &str| {
        let text = format!(
            "ObjectType = Image\nNDims = 3\nDimSize = 4 3 2\n{spacing}ElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
        );
        let path = write(&dir, "a.mha", &[text.as_bytes(), &[7; 24]].concat());
        open(&path, None).unwrap().info().assumed
    };
    assert_eq!((header("").axes, header("").can_be_given), ([true; 3], false));
    assert_eq!(header("ElementSpacing = 1 1 1\n").axes, [false; 3]);
    let header = |spacing: &str| {
        let text = format!("NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 3 2\n{spacing}encoding: raw\n\n");
        open(&write(&dir, "a.nrrd", &[text.as_bytes(), &[7; 24]].concat()), None).unwrap().info().assumed.axes
    };
    assert_eq!(header(""), [true; 3]);
    assert_eq!(header("spacings: 1 1 nan\n"), [false, false, true]);
    assert_eq!(header("space directions: (1,0,0) (0,1,0) (0,0,1)\nspace dimension: 3\n"), [false; 3]);
}

#[test]
fn files_that_count_from_their_own_dates_are_one_series() {
    let dir = tempfile::tempdir().unwrap();
    let later = |name: &str, date: &[u8]| write(&dir, name, &changed("cf3.nc", b"2000-01-01", date));
    let files = [data("cf3.nc"), later("b.nc", b"2000-01-02"), later("c.nc", b"2000-02-01")];
    let steps = steps_of(&files, &options(Some("record"))).unwrap();
    let times: Vec<_> = steps.iter().map(|step| step.time).collect();
    assert_eq!(times, [Some(7.5), Some(31.5), Some(751.5)]);
    let unit = |n: usize| steps[n].units(&open(&files[n], Some("record")).unwrap().info().units).time;
    assert_eq!([unit(0).unwrap().as_str(), "hours since 2000-01-01"], ["hours since 2000-01-01"; 2]);
    assert_eq!(unit(1), None, "that of the file is another one");
    // What a user names is no date of the file.
    let mut named = options(Some("record"));
    named.units.time = Some("h".parse().unwrap());
    let times: Vec<_> = steps_of(&files, &named).unwrap().iter().map(|step| step.time).collect();
    assert_eq!(times, [Some(7.5); 3]);
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn files_of_others_have_their_right_answers() {
    let folder = crate::formats::tests::shared_data().join("turn3");
    let path = |name: &str| folder.join(name);
    if !folder.is_dir() {
        return;
    }
    let range = |values: &[f32]| {
        let finite = values.iter().copied().filter(|v| v.is_finite());
        [finite.clone().fold(f32::INFINITY, f32::min), finite.fold(f32::NEG_INFINITY, f32::max)]
    };
    for (name, spacing, origin) in
        [("tiny.mnc", [2.0; 3], [-20.0, -20.0, -10.0]), ("minc1-no-att.mnc", [1.0; 3], [0.0; 3])]
    {
        let (info, values) = read_all(open(&path(name), None).unwrap());
        assert_eq!((info.geometry.spacing, info.geometry.origin), (spacing, origin), "{name}");
        let found = range(&values).map(|v| (v * 1e4).round() / 1e4);
        assert_eq!(found, [0.2078, 0.7490], "{name}");
    }
    let info = open(&path("emd_tomviz.emd"), None).unwrap().info().clone();
    assert_eq!(info.dims, [14, 18, 22]);
    assert_eq!(info.geometry.to_world([1.0, 1.0, 1.0]), [0.5, 1.0, 1.5]);
    assert_eq!(info.geometry.to_world([1.0, 0.0, 0.0]), [0.0, 0.0, 1.5], "what is fastest lies along z");
    let info = open(&path("q6.hspy"), None).unwrap().info().clone();
    assert_eq!((info.geometry.spacing, info.geometry.origin), ([1.0, 2.0, 3.0], [5.0; 3]));
    assert!(refusal(&path("q6_ugrid.nc"), None).contains("UGRID"));
    assert!(refusal(&path("s6_timelatlon.nc"), None).contains("14 (t) x 18 (y) x 22 (x)"));
    let (_, values) = read_all(open(&path("s6_unsigned3.nc"), None).unwrap());
    assert_eq!(range(&values), [0.0, 200.0]);
    let (_, values) = read_all(open(&path("s6_packed.nc"), None).unwrap());
    assert_eq!((range(&values), values.iter().filter(|v| v.is_nan()).count()), ([273.15, 373.15], 48));
}
