use super::*;
use crate::bytes::IoMode;
use crate::formats::open_volume;
use crate::formats::tests::{read_all, write};
use std::path::PathBuf;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(name)
}

fn open(name: &str, field: &str) -> Result<VolumeSource> {
    let field = Some(field.to_string());
    open_volume(&data(name), &OpenOptions { field, ..OpenOptions::default() })
}

/// What `tools/make_golden_hdf5.py` wrote: each sample its index.
fn ramp() -> Vec<f32> {
    (0..60u8).map(f32::from).collect()
}

/// All values, put where their slabs say.
fn values(source: VolumeSource) -> Vec<f32> {
    let info = source.info().clone();
    let whole = IndexBox::whole(info.dims);
    let mut values = vec![f32::NAN; whole.len()];
    match source {
        VolumeSource::Random(reader) => reader.read_box(whole, &mut values).unwrap(),
        other => {
            let mut stream = other.into_stream();
            let (mut bytes, mut filled) = (vec![], 0);
            while let Some(slab) = stream.next_slab(&mut bytes).unwrap() {
                let mut part = vec![0.0; slab.len()];
                let (scalar, missing) = (info.field.scalar, info.missing);
                crate::volume::convert::convert_row(
                    &bytes,
                    scalar,
                    false,
                    info.slope,
                    info.intercept,
                    missing,
                    &mut part,
                );
                let (lo, d) = (slab.lo, slab.dims());
                filled += part.len();
                for (i, v) in part.into_iter().enumerate() {
                    let (x, y, z) = (i as u64 % d[0], i as u64 / d[0] % d[1], i as u64 / (d[0] * d[1]));
                    let at = ((lo[2] + z) * info.dims[1] + lo[1] + y) * info.dims[0] + lo[0] + x;
                    values[at as usize] = v;
                }
            }
            assert_eq!(filled, values.len(), "each sample once");
        }
    }
    values
}

#[test]
fn every_type_is_read_in_both_orders_mapped_and_chunked() {
    for version in ["earliest", "latest"] {
        let name = format!("types_{version}.h5");
        for (field, scalar) in [
            ("u1", ScalarType::U8),
            ("i1", ScalarType::I8),
            ("u2", ScalarType::U16),
            ("i2", ScalarType::I16),
            ("big_i2", ScalarType::I16),
            ("u4", ScalarType::U32),
            ("big_u4", ScalarType::U32),
            ("i4", ScalarType::I32),
            ("u8", ScalarType::U64),
            ("i8", ScalarType::I64),
            ("f4", ScalarType::F32),
            ("big_f4", ScalarType::F32),
            ("f8", ScalarType::F64),
            ("big_f8", ScalarType::F64),
        ] {
            let mapped = open(&name, &format!("group/{field}")).unwrap();
            assert!(matches!(mapped, VolumeSource::Random(_)), "{field} lies in the file as it is");
            let chunked = open(&name, &format!("/group/{field}_chunks")).unwrap();
            for source in [mapped, chunked] {
                assert_eq!((source.info().dims, source.info().field.scalar), ([5, 4, 3], scalar));
                assert_eq!(values(source), ramp(), "{name} {field}");
            }
        }
    }
}

#[test]
fn both_ways_of_reading_give_the_same() {
    for field in ["group/big_f8", "group/big_f8_chunks"] {
        for io in [IoMode::Map, IoMode::Read] {
            let options = OpenOptions { field: Some(field.into()), io, ..OpenOptions::default() };
            assert_eq!(values(open_volume(&data("types_latest.h5"), &options).unwrap()), ramp(), "{field}");
        }
    }
}

/// MATLAB's files begin with 512 bytes of their own.
#[test]
fn a_file_may_begin_with_a_block_of_the_user_s() {
    for (field, format) in [("mapped", "HDF5"), ("chunks", "HDF5 (chunked)")] {
        let source = open("user_block.mat", field).unwrap();
        assert_eq!(source.info().format, format);
        assert_eq!(values(source), ramp(), "{field}");
    }
}

#[test]
fn fields_are_listed_once_and_found_by_any_link() {
    let path = data("types_earliest.h5");
    let error = open_volume(&path, &OpenOptions::default()).err().expect("many fields");
    assert_eq!(error.exit_code(), 2);
    let line = error.to_string();
    assert!(line.contains("group/f4 (float32)") && line.contains("group/big_i2_chunks (int16)"), "{line}");
    assert_eq!(open("types_earliest.h5", "again").unwrap().info().fields.len(), 28);
    for name in ["again", "/root/group/i2"] {
        assert_eq!(values(open("types_latest.h5", name).unwrap()), ramp(), "{name}");
    }
    assert_eq!(open("types_latest.h5", "group/none").err().expect("no such field").exit_code(), 2);
}

#[test]
fn layouts_indices_and_fill_values_are_read() {
    for version in ["earliest", "latest"] {
        let name = format!("layouts_{version}.h5");
        for field in ["unlimited", "unlimited2", "one", "lzf", "scaleoffset", "four", "compact", "half"] {
            assert_eq!(values(open(&name, field).unwrap()), ramp(), "{name} {field}");
        }
        for field in ["frames", "frames_chunks"] {
            let frame = |t: u32| values(open(&name, &format!("{field}:t{t}")).unwrap());
            assert_eq!(frame(1), ramp(), "{name} {field}");
            assert_eq!(frame(0), ramp().iter().map(|v| v - 7.0).collect::<Vec<f32>>());
        }
        assert_eq!(values(open(&name, "empty").unwrap()), vec![-5.0; 60]);
        let part = values(open(&name, "part").unwrap());
        let expected = |i: usize| if i % 5 < 2 && i / 5 % 4 < 2 && i / 20 < 2 { 1.0 } else { -5.0 };
        assert_eq!(part, (0..60).map(expected).collect::<Vec<f32>>());
    }
}

/// Bytes of a sample, and its value at (x, y, z), as in `tools/make_golden_hdf5.py`.
fn filtered(scalar: ScalarType, [x, y, z]: [u64; 3]) -> f32 {
    let value = (1000 + 20 * x + 7 * z + (13 * y + 5 * x) % 17) as f32;
    if scalar == ScalarType::U16 { value } else { value / 8.0 }
}

#[test]
fn filters_that_are_plugins_are_read() {
    let options = OpenOptions { field: Some("lzf".into()), ..OpenOptions::default() };
    let names: Vec<String> = open_volume(&data("filters.h5"), &options)
        .unwrap()
        .info()
        .fields
        .iter()
        .map(|f| f.name.clone())
        .filter(|name| name != "zfp")
        .collect();
    assert_eq!(names.len(), 48, "{names:?}");
    for name in names {
        let source = open("filters.h5", &name).unwrap();
        let ([nx, ny, _], scalar) = (source.info().dims, source.info().field.scalar);
        let expected = |i: usize| match &*name {
            "blosc2_zeros" => 0.0,
            "blosc2_nan" => f32::NAN,
            "blosc2_same" => 3.0,
            _ => {
                let i = i as u64;
                filtered(scalar, [i % nx % 13, i / nx % ny % 10, i / (nx * ny) % 9])
            }
        };
        let found = values(source);
        let same = |(i, &v): (usize, &f32)| v.to_bits() == expected(i).to_bits();
        assert!(found.iter().enumerate().all(same), "{name}: {:?}", &found[..20]);
    }
    let error = open("filters.h5", "zfp").and_then(|source| {
        let mut stream = source.into_stream();
        stream.next_slab(&mut vec![]).map(|_| ())
    });
    let line = error.unwrap_err().to_string();
    assert!(line.contains("the filter ZFP") && line.contains("bitshuffle, Blosc"), "{line}");
}

#[test]
fn what_is_not_read_is_refused_for_its_reason() {
    for (field, reason) in [
        ("complex", "records"),
        ("text", "text"),
        ("boolean", "an enumeration"),
        ("five", "3 x 1 x 4 x 5 x 1"),
    ] {
        let error = open("layouts_latest.h5", field).err().expect("refused");
        assert_eq!(error.exit_code(), 5, "{error}");
        assert!(error.to_string().contains(reason) && error.to_string().contains(field), "{error}");
    }
}

#[test]
fn numbers_of_both_attributes_are_missing() {
    let found = values(open("layouts_latest.h5", "two_missing").unwrap());
    let right = |(n, v): (usize, &f32)| if [1, 2].contains(&n) { v.is_nan() } else { *v == n as f32 };
    assert!(found.iter().enumerate().all(right), "{found:?}");
}

#[test]
fn netcdf_places_scales_and_marks_what_is_missing() {
    let source = open("grid.nc", "temp").unwrap();
    let info = source.info().clone();
    assert_eq!((info.slope, info.intercept, info.missing), (0.5, 10.0, Some(-999.0)));
    // Levels 100, 110, 150 are not regular; latitude falls. So it is a rectilinear grid.
    assert_eq!(info.geometry, Geometry::default());
    let axes = axes_of("grid.nc", "temp").unwrap().unwrap();
    assert_eq!(axes[0], [0.0, 0.5, 1.0, 1.5, 2.0]);
    assert_eq!(axes[1], [5.0, 2.5, 0.0, -2.5]);
    assert_eq!(axes[2], [100.0, 110.0, 150.0]);
    let values = values(source);
    assert!(values[1].is_nan());
    assert_eq!((values[0], values[2], values[59]), (10.0, 11.0, 39.5));
    let (info, values) = read_all(open("grid.nc", "plain").unwrap());
    assert_eq!((info.geometry.spacing, values), ([1.0; 3], ramp()));
    let axes = axes_of("grid.nc", "plain").unwrap().unwrap();
    assert_eq!(axes[0], [0.0, 1.0, 2.0, 3.0, 4.0], "an axis without coordinates");
}

/// The coordinates of a rectilinear grid.
fn axes_of(name: &str, field: &str) -> Result<Option<[Vec<f64>; 3]>> {
    let options = OpenOptions { field: Some(field.into()), ..OpenOptions::default() };
    Ok(crate::formats::tests::open_coordinates(&data(name), &options)?.map(|found| match found {
        GridCoordinates::Axes(axes) => axes,
        GridCoordinates::Points(_) => panic!("axes"),
    }))
}

/// World coordinates of sample (1, 2, 1), to a millionth.
fn place(source: &VolumeSource) -> [f64; 3] {
    source.info().geometry.to_world([1.0, 2.0, 1.0]).map(|x| (x * 1e6).round() / 1e6)
}

#[test]
fn images_of_vtkhdf_are_placed_and_other_types_refused() {
    let source = open("vtkhdf.hdf", "heat").unwrap();
    assert!(source.info().format.contains("VTKHDF"), "{}", source.info().format);
    // x is (2 + 1) steps of 0.5 along y, y is 2 steps of 0.25 against x.
    assert_eq!(place(&source), [9.5, 21.5, 32.0]);
    assert_eq!(values(source), ramp());
    let cells = open("vtkhdf.hdf", "VTKHDF/CellData/mass").unwrap();
    assert_eq!((cells.info().dims, place(&cells)), ([4, 3, 2], [9.375, 21.75, 33.0]));
    assert_eq!(open_volume(&data("vtkhdf.hdf"), &OpenOptions::default()).unwrap().info().field.name, "heat");
    let line = open("vtkhdf.hdf", "flow").err().expect("vectors").to_string();
    assert!(line.contains("flow (3 x float32, not scalar)"), "{line}");
    for (name, what) in [
        ("vtkhdf_mesh.hdf", "VTKHDF file of type 'UnstructuredGrid'; copy it to a disk"),
        ("imaris.ims", "an Imaris file"),
    ] {
        // As it is opened from a server: on this machine the first one is a mesh.
        let source = Arc::new(ByteSource::open(data(name), IoMode::Auto).unwrap());
        let opened = Opened::of(&source);
        let volume = opened.and_then(|file| format::Dataset::volume(&file, &OpenOptions::default()));
        let error = volume.err().expect("refused");
        assert_eq!(error.exit_code(), 5);
        assert!(error.to_string().contains(what), "{error}");
    }
}

#[test]
fn minc_is_placed_and_scaled_slice_by_slice() {
    let source = open_volume(&data("minc.mnc"), &OpenOptions::default()).unwrap();
    // Fastest is x, along world y; then z; slowest y, whose steps of -8 go along -x.
    assert_eq!(source.info().dims, [5, 4, 3]);
    assert_eq!(place(&source), [-20.0 + 8.0, -10.0 + 7.0, 30.0 + 2.0 * 9.0]);
    let found = values(source);
    let value = |i: usize| {
        let (lo, hi) = [(0.0, 50.0), (100.0, 200.0), (200.0, 300.0)][i / 20];
        lo + i as f64 / 50.0 * (hi - lo)
    };
    for (i, v) in found.into_iter().enumerate() {
        // 51 to 59 are out of the valid range.
        let right = if i > 50 { v.is_nan() } else { (f64::from(v) - value(i)).abs() < 1e-4 };
        assert!(right, "{i}: {v}");
    }
}

#[test]
fn virtual_datasets_are_named() {
    // The reader stops at one, so that the other datasets of the file are not read either.
    for field in [None, Some("entry/data"), Some("entry/own")] {
        let options = OpenOptions { field: field.map(str::to_owned), ..OpenOptions::default() };
        let error = open_volume(&data("virtual.h5"), &options).err().expect("refused");
        let line = error.to_string();
        assert!(error.exit_code() == 5 && !line.contains('\n'), "{line}");
        let words = ["virtual.h5: /entry/data: expected", "a virtual dataset", "h5repack -l NAME:CONTI"];
        assert!(words.iter().all(|word| line.contains(word)), "{line}");
    }
}

#[test]
fn images_of_itk_are_placed() {
    let source = open_volume(&data("itk.h5"), &OpenOptions::default()).unwrap();
    assert_eq!(place(&source), [1.0 - 0.5, 2.0 + 0.5, 3.0 + 2.0]);
    assert_eq!(values(source), ramp());
}

#[test]
fn axes_are_what_they_are_called() {
    assert_eq!(open("axes.h5", "sized").unwrap().info().geometry.spacing, [0.25, 0.5, 2.0]);
    // The first axis is x: what is read fastest lies along z.
    assert_eq!(place(&open("axes.h5", "fortran").unwrap()), [1.0, 2.0, 1.0].map(|x: f64| x));
    let fortran = open("axes.h5", "fortran").unwrap();
    assert_eq!(fortran.info().geometry.to_world([4.0, 0.0, 0.0]), [0.0, 0.0, 4.0]);
    let nexus = open("axes.h5", "entry/counts").unwrap();
    assert_eq!(
        (nexus.info().geometry.spacing, nexus.info().geometry.origin),
        ([0.25, 0.5, 2.0], [0.0, 0.0, 1.0])
    );
    let line = open("axes.h5", "vectors").err().expect("vectors").to_string();
    assert!(line.contains("vectors (3 x float32, not scalar)"), "{line}");
    for (field, channel) in [(Some("channels:c1"), None), (Some("channels"), Some("1")), (None, Some("c1"))] {
        let [field, channel] = [field, channel].map(|text| text.map(str::to_owned));
        let options = OpenOptions { field, channel, ..OpenOptions::default() };
        let source = open_volume(&data("axes.h5"), &options).unwrap();
        assert_eq!((&*source.info().field.name, source.info().dims), ("channels:c1", [5, 4, 3]));
        assert_eq!(values(source), ramp().iter().map(|v| v + 100.0).collect::<Vec<f32>>());
    }
    for (field, channel) in [("channels", None), ("channels", Some("2")), ("channels:c0", Some("1"))] {
        let (field, channel) = (Some(field.to_owned()), channel.map(str::to_owned));
        let options = OpenOptions { field, channel, ..OpenOptions::default() };
        let error = open_volume(&data("axes.h5"), &options).err().expect("no channel, or another");
        assert!(error.exit_code() == 2 && error.to_string().contains("channels:c0"), "{error}");
    }
}

#[test]
fn what_netcdf_never_wrote_is_missing() {
    // Its name does not say that it is NetCDF. The library's fill value of bytes may be a value.
    for (name, unwritten) in [("single", f32::NAN), ("short", f32::NAN), ("byte", -127.0)] {
        let found = values(open("netcdf4_fill.h5", name).unwrap());
        for (n, value) in found.into_iter().enumerate() {
            let expected = if n < 12 { n as f32 } else { unwritten };
            assert!(value == expected || value.is_nan() && expected.is_nan(), "{name}, {n}: {value}");
        }
    }
}

#[test]
fn levels_are_a_grid_and_steps_have_their_times() {
    let axes = axes_of("levels.nc", "temp:t1").unwrap().unwrap();
    assert_eq!((&axes[1][..], &axes[2][..]), (&[30.0, 20.0, 10.0, 0.0][..], &[1000.0, 925.0, 700.0][..]));
    let options = |field: &str| OpenOptions { field: Some(field.into()), ..OpenOptions::default() };
    for field in ["temp", "temp*", "/temp"] {
        let steps = crate::formats::steps_of(&[data("levels.nc")], &options(field)).unwrap();
        let names: Vec<_> = steps.iter().map(|s| s.options.field.clone().unwrap()).collect();
        let times: Vec<_> = steps.iter().map(|s| s.time).collect();
        assert_eq!(names, ["temp:t0", "temp:t1", "temp:t2"], "{field}");
        assert_eq!(times, [Some(0.0), Some(6.0), Some(18.0)], "{field}");
    }
    let line = open("levels.nc", "temp").err().expect("three of them").to_string();
    assert!(line.contains("temp:t0"), "{line}");
    let found = values(open("levels.nc", "temp:t1").unwrap());
    assert!(found[0].is_nan(), "out of the valid range");
    assert_eq!((found[1], found[59]), (50.5, 79.5));
}

/// Opens and reads each field of a damaged file, or its beginning; panics are the test's failures.
fn survives(path: &Path, fields: &[&str]) {
    for &field in fields {
        let options = OpenOptions { field: Some(field.into()), ..OpenOptions::default() };
        let read = open_volume(path, &options).and_then(|source| match source {
            VolumeSource::Random(reader) => {
                let d = reader.info().dims.map(|n| n.min(8));
                let voxels = IndexBox::whole(d);
                reader.read_box(voxels, &mut vec![0.0; voxels.len()])
            }
            other => {
                let (mut stream, mut bytes) = (other.into_stream(), vec![]);
                // A damaged shape may be a large one, of chunks that are not there.
                for _ in 0..20 {
                    if stream.next_slab(&mut bytes)?.is_none() {
                        break;
                    }
                }
                Ok(())
            }
        });
        if let Err(e) = read {
            let line = e.to_string();
            assert!(!line.contains('\n') && line.len() < 2000, "{line}");
        }
    }
}

#[test]
fn damage_is_an_error_or_the_answer() {
    let dir = tempfile::tempdir().unwrap();
    // Each ninety-seventh byte; fewer between them, and more time, when the variable says so.
    let steps = std::env::var("ISOSPAN_HDF5_DAMAGE").ok().and_then(|s| s.parse().ok()).unwrap_or(97usize);
    for (name, fields) in [
        ("types_latest.h5", &["group/f4_chunks", "group/u2"][..]),
        ("types_earliest.h5", &["group/big_f8_chunks", "group/i1"]),
        ("layouts_latest.h5", &["unlimited2", "scaleoffset", "unlimited", "compact"]),
        ("layouts_earliest.h5", &["unlimited2", "lzf", "part", "frames:t1"]),
        ("grid.nc", &["temp", "plain"]),
        ("filters.h5", &["lzf_all", "bitshuffle_lz4", "blosc2_boxes", "blosc_zstd_2", "lz4_blocks"]),
    ] {
        let bytes = std::fs::read(data(name)).unwrap();
        // As many damages of a large file as of a small one.
        let steps = steps * bytes.len().div_ceil(16 << 10);
        for cut in (0..bytes.len()).step_by(7 * steps) {
            survives(&write(&dir, name, &bytes[..cut]), fields);
        }
        for at in (steps % 7..bytes.len()).step_by(steps) {
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                survives(&write(&dir, name, &damaged), fields);
            }
        }
    }
}

#[test]
fn damaged_samples_are_found_by_their_checksum() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(data("types_latest.h5")).unwrap();
    let mut refused = 0;
    for at in (0..bytes.len()).step_by(11) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        let options = OpenOptions { field: Some("group/i8_chunks".into()), ..OpenOptions::default() };
        let path = write(&dir, "a.h5", &damaged);
        let Ok(source) = open_volume(&path, &options) else {
            refused += 1;
            continue;
        };
        let mut stream = source.into_stream();
        let (mut out, mut all) = (vec![], vec![]);
        match std::iter::from_fn(|| stream.next_slab(&mut out).map(|s| s.map(|_| out.clone())).transpose())
            .collect::<Result<Vec<_>>>()
        {
            Err(_) => refused += 1,
            Ok(slabs) => all.extend(slabs.concat()),
        }
        let right: Vec<u8> = (0..60i64).flat_map(i64::to_le_bytes).collect();
        assert!(all.is_empty() || all == right, "a wrong value for byte {at}");
    }
    assert!(refused > 20, "{refused}");
}

#[test]
fn units_are_those_of_attributes() {
    let units = |name: &str, field: &str| {
        let units = open(name, field).unwrap().info().units.clone();
        [units.value, units.length, units.time].map(|unit| unit.map(|unit| unit.to_string()))
    };
    let text = |t: &str| Some(t.to_string());
    assert_eq!(units("units.nc", "temp:t1"), [text("K"), text("m"), text("hours since 2000-01-01")]);
    assert_eq!(units("units.nc", "odd"), [text("[31m kg m-3"), None, None]);
    assert_eq!(units("units.nc", "share"), [None, text("m"), None]);
    assert_eq!(units("units.h5", "sized"), [None, text("µm"), None]);
    assert_eq!(units("units.h5", "entry/counts"), [text("counts"), text("µm"), None]);
    assert_eq!(units("axes.h5", "fortran"), [None, None, None]);
}

/// The samples that `tools/make_golden_axes.py` writes, at one time and of one channel.
fn of_axes(time: usize, channel: usize) -> Vec<f32> {
    (0..5 * 6 * 7).map(|i| (i + 1000 * time + 500 * channel) as f32).collect()
}

#[test]
fn axes_are_found_by_their_names() {
    let path = data("axes_named.h5");
    let read = |field: &str, channel: Option<&str>| {
        let field = Some(field.to_string());
        let options = OpenOptions { field, channel: channel.map(String::from), ..OpenOptions::default() };
        let (info, values) = read_all(open_volume(&path, &options)?);
        assert_eq!(info.dims, [7, 6, 5], "{:?}", options.field);
        Ok::<_, Error>(values)
    };
    for name in ["one_channel", "one_channel_in_chunks"] {
        assert_eq!(read(name, None).unwrap(), of_axes(0, 0), "{name}");
    }
    for name in ["probabilities", "probabilities_in_chunks", "channels_inside", "one_time"] {
        for channel in 0..3 {
            let word = channel.to_string();
            assert_eq!(read(name, Some(&word)).unwrap(), of_axes(0, channel), "{name}");
            assert_eq!(read(&format!("{name}:c{channel}"), None).unwrap(), of_axes(0, channel), "{name}");
        }
        assert_eq!(read(name, None).unwrap_err().exit_code(), 2, "{name} has three channels");
    }
    for (t, c) in [(0, 2), (1, 0)] {
        assert_eq!(read(&format!("movie:c{c}:t{t}"), None).unwrap(), of_axes(t, c));
        let word = c.to_string();
        let options =
            OpenOptions { field: Some("movie".into()), channel: Some(word), ..OpenOptions::default() };
        let steps = crate::formats::steps_of(std::slice::from_ref(&path), &options).unwrap();
        assert_eq!(steps.len(), 2);
        let (_, values) = read_all(open_volume(&path, &steps[t].options).unwrap());
        assert_eq!(values, of_axes(t, c));
    }
    // The axes y, x, z of the world.
    let options = OpenOptions { field: Some("time_last:t1".into()), ..OpenOptions::default() };
    let (info, values) = read_all(open_volume(&path, &options).unwrap());
    let place = |i: usize| (i % 5, i / 5 % 7, i / 35);
    let expected: Vec<f32> =
        (0..210).map(place).map(|(z, x, y)| (1000 + x + 7 * y + 42 * z) as f32).collect();
    assert_eq!((info.dims, values), ([5, 7, 6], expected));
    assert_eq!(info.geometry.direction[0], [0.0, 0.0, 1.0]);
}
