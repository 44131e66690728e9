use super::*;
use crate::bytes::IoMode;
use crate::formats::tests::open_coordinates;
use crate::formats::tests::{read_all, torture, write};
use crate::formats::{open_volume, steps_of};
use std::path::PathBuf;

/// What `tools/make_golden_netcdf.py` wrote.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(name)
}

fn options(field: &str) -> OpenOptions {
    OpenOptions { field: Some(field.into()), ..OpenOptions::default() }
}

fn open_field(name: &str, field: &str) -> Result<VolumeSource> {
    open_volume(&data(name), &options(field))
}

/// The numbers from `first` on, in steps of 1.
fn ramp(first: u8, count: u8) -> Vec<f32> {
    (first..first + count).map(f32::from).collect()
}

const FILES: [&str; 3] = ["netcdf3_classic.nc", "netcdf3_offset.nc", "netcdf3_cdf5.nc"];

#[test]
fn every_type_is_mapped_with_records_and_without() {
    let classic = [
        ("i1", ScalarType::I8),
        ("i2", ScalarType::I16),
        ("i4", ScalarType::I32),
        ("f4", ScalarType::F32),
        ("f8", ScalarType::F64),
    ];
    let of_cdf5 = [
        ("u1", ScalarType::U8),
        ("u2", ScalarType::U16),
        ("u4", ScalarType::U32),
        ("i8", ScalarType::I64),
        ("u8", ScalarType::U64),
    ];
    for name in FILES {
        let more = if name.contains("cdf5") { &of_cdf5[..] } else { &[] };
        for (kind, scalar) in classic.iter().chain(more) {
            for field in [format!("fixed_{kind}"), format!("record_{kind}")] {
                for io in [IoMode::Map, IoMode::Read] {
                    let source = open_volume(&data(name), &OpenOptions { io, ..options(&field) }).unwrap();
                    assert!(matches!(source, VolumeSource::Random(_)), "{field} lies in the file as it is");
                    let (info, values) = read_all(source);
                    assert_eq!((info.dims, info.field.scalar), ([5, 3, 4], *scalar), "{name} {field}");
                    assert_eq!(values, ramp(0, 60), "{name} {field}");
                }
            }
        }
    }
}

#[test]
fn the_records_of_one_variable_have_no_gaps() {
    let (info, values) = read_all(open_field("netcdf3_single.nc", "v").unwrap());
    assert_eq!((&*info.format, info.dims), ("NetCDF-3 (classic)", [5, 3, 4]));
    assert_eq!(values, ramp(0, 60));
    // A writer that could not go back left out the number of records.
    let dir = tempfile::tempdir().unwrap();
    let mut bytes = std::fs::read(data("netcdf3_single.nc")).unwrap();
    bytes[4..8].fill(0xff);
    let (info, values) = read_all(open_volume(&write(&dir, "a.nc", &bytes), &options("v")).unwrap());
    assert_eq!((info.dims, values), ([5, 3, 4], ramp(0, 60)));
    // None were written yet.
    bytes[4..8].fill(0);
    let error = open_volume(&write(&dir, "b.nc", &bytes), &OpenOptions::default()).err().expect("refused");
    assert!(error.exit_code() == 5 && error.to_string().contains("no records yet"), "{error}");
}

#[test]
fn attributes_say_what_numbers_mean() {
    for name in FILES {
        let (info, values) = read_all(open_field(name, "packed:t1").unwrap());
        assert_eq!((info.slope, info.intercept, info.missing), (0.5, 10.0, Some(-999.0)));
        assert!(values[0].is_nan());
        assert_eq!((values[1], values[59]), (60.5, 89.5));
        // 3 to 40 are valid, and stand for twice as much.
        let (_, values) = read_all(open_field(name, "ranged").unwrap());
        let expected = |n: usize| if (3..=40).contains(&n) { 2.0 * n as f32 } else { f32::NAN };
        assert!(values.iter().enumerate().all(|(n, v)| v.to_bits() == expected(n).to_bits()), "{values:?}");
        // What was never written has the fill value of the library.
        let (_, values) = read_all(open_field(name, "unwritten").unwrap());
        assert_eq!(&values[15..30], ramp(0, 15));
        assert!(values[..15].iter().chain(&values[30..]).all(|v| v.is_nan()), "{values:?}");
    }
}

#[test]
fn coordinates_place_samples_and_steps() {
    for name in FILES {
        let geometry = open_field(name, "even").unwrap().info().geometry;
        assert_eq!((geometry.origin, geometry.spacing), ([0.0, 30.0, 0.0], [1.0, 10.0, 1.0]));
        assert_eq!(geometry.to_world([4.0, 2.0, 1.0]), [4.0, 10.0, 1.0]);
        let grid = open_coordinates(&data(name), &options("fixed_f4")).unwrap();
        let Some(GridCoordinates::Axes(axes)) = grid else { panic!("levels are uneven") };
        assert_eq!(
            (&axes[1][..], &axes[2][..]),
            (&[30.0, 20.0, 10.0][..], &[1000.0, 925.0, 700.0, 500.0][..])
        );
        assert!(open_coordinates(&data(name), &options("even")).unwrap().is_none());
        // The times are those of records, each far from the other.
        for field in ["packed", "packed:t*"] {
            let steps = steps_of(&[data(name)], &options(field)).unwrap();
            let names: Vec<_> = steps.iter().map(|s| s.options.field.clone().unwrap()).collect();
            let times: Vec<_> = steps.iter().map(|s| s.time).collect();
            assert_eq!(names, ["packed:t0", "packed:t1", "packed:t2", "packed:t3"], "{field}");
            assert_eq!(times, [Some(0.0), Some(6.0), Some(18.0), Some(24.0)], "{field}");
        }
        let placed = OpenOptions { spacing: Some([2.0; 3]), ..options("even") };
        assert_eq!(open_volume(&data(name), &placed).err().expect("its own coordinates").exit_code(), 2);
    }
}

#[test]
fn what_is_not_read_is_named() {
    for (field, reason) in [("text", "got text"), ("none", "no scalar field none")] {
        let error = open_field(FILES[0], field).err().expect("refused");
        assert!(error.to_string().contains(reason), "{error}");
    }
    let error = open_volume(&data(FILES[0]), &OpenOptions::default()).err().expect("several");
    assert!(error.exit_code() == 2 && error.to_string().contains("packed:t0 (int16)"), "{error}");
}

#[test]
fn damage_is_refused() {
    let bytes = std::fs::read(data("netcdf3_single.nc")).unwrap();
    torture("a.nc", &bytes, bytes.len());
    // A damaged number in a header of every version and each list.
    let dir = tempfile::tempdir().unwrap();
    for name in FILES {
        let bytes = std::fs::read(data(name)).unwrap();
        for at in (4..bytes.len().min(2600)).step_by(3) {
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                let path = write(&dir, "a.nc", &damaged);
                for field in ["packed:t1", "record_f4", "ranged"] {
                    let opened = open_volume(&path, &options(field));
                    if let Err(e) = opened.and_then(crate::formats::tests::try_read_all) {
                        let line = e.to_string();
                        assert!(!line.contains('\n') && line.contains("a.nc"), "{line}");
                    }
                }
            }
        }
    }
}

#[test]
fn units_are_those_of_the_variable_and_its_axes() {
    let units = |field: &str| {
        let units = open_field("netcdf3_units.nc", field).unwrap().info().units.clone();
        [units.value, units.length, units.time].map(|unit| unit.map(|unit| unit.to_string()))
    };
    let text = |t: &str| Some(t.to_string());
    assert_eq!(units("temp:t1"), [text("K"), text("m"), text("hours since 2000-01-01")]);
    // Degrees are no lengths, and what a terminal would obey is left out.
    assert_eq!(units("odd"), [text("[31m kg m-3"), None, None]);
    assert_eq!(units("share"), [None, text("m"), None]);
}

#[test]
fn units_of_single_axes_become_one() {
    let info = |field: &str| open_field("axes_units.nc", field).unwrap().info().clone();
    let mixed = info("mixed");
    assert_eq!((mixed.geometry.spacing, mixed.geometry.origin), ([2.0, 500.0, 50.0], [10.0, 1000.0, 100.0]));
    assert_eq!(mixed.units.length.as_ref().map(|unit| unit.as_str()), Some("m"));
    assert!(mixed.notes[0].contains("y from km"), "{:?}", mixed.notes);
    let Some(GridCoordinates::Axes([x, y, z])) =
        open_coordinates(&data("axes_units.nc"), &options("uneven")).unwrap()
    else {
        panic!("depth is uneven")
    };
    assert_eq!((x[1], y[1], z), (12.0, 1500.0, vec![0.0, 1000.0, 3000.0, 6000.0, 10_000.0]));
    let found = info("geographic");
    assert_eq!((found.geometry.spacing, found.units.length), ([1.0, 1.0, 50.0], None));
    assert!(
        found.notes[0].contains("degrees_east (x)") && found.notes[0].contains("m (z)"),
        "{:?}",
        found.notes
    );
}

#[test]
fn time_may_be_any_axis() {
    let path = data("axes_units.nc");
    let steps = steps_of(std::slice::from_ref(&path), &options("time_last")).unwrap();
    assert_eq!(steps.iter().map(|step| step.time).collect::<Vec<_>>(), [Some(3.0), Some(4.0)]);
    let (info, values) = read_all(open_volume(&path, &steps[1].options).unwrap());
    let place = |i: usize| (i % 5, i / 5 % 7, i / 35);
    let expected: Vec<f32> =
        (0..210).map(place).map(|(z, x, y)| (1000 + x + 7 * y + 42 * z) as f32).collect();
    assert_eq!((info.dims, values), ([5, 7, 6], expected));
    // y varies slowest, and is in km.
    assert_eq!(info.geometry.spacing, [50.0, 2.0, 500.0]);
    assert_eq!(info.geometry.origin, [10.0, 1000.0, 100.0]);
    assert_eq!(info.units.time.as_ref().map(|unit| unit.as_str()), Some("hours since 2000-01-01"));
}
