//! What is written comes back from our own readers.

use super::*;
use crate::exec::CancelToken;
use crate::formats::tests::read_all;
use crate::formats::{OpenOptions, open_volume};

fn meta(scalar: ScalarType, offset: f64) -> GridMeta {
    let geometry = Geometry {
        origin: [1.0, -2.5, 1e-3],
        spacing: [0.5, 2.0, 3.0],
        direction: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    };
    let field = SampleField { name: "a < \"b\"".into(), scalar, offset, is_labels: false };
    let units = Units { value: Unit::new("K"), length: Unit::length("mm"), time: None };
    GridMeta { units, ..GridMeta::even([4, 3, 2], geometry, field) }
}

/// Writes the numbers of samples in any order.
fn write(path: &Path, meta: &GridMeta, compress: bool, pool: Option<&rayon::ThreadPool>) {
    let format = SampleFormat::from_path(path).unwrap();
    let file = SampleFile::create(path, format, meta, compress, None).unwrap();
    for first in [12u64, 0, 20, 4, 16, 8] {
        let run: Vec<f32> = (first..first + 4).map(|i| i as f32).collect();
        file.write(first, &run).unwrap();
    }
    let bytes: u64 = file.publish(pool, &CancelToken::new()).unwrap();
    let files = format.files(path);
    assert_eq!(bytes, files.iter().map(|file| std::fs::metadata(file).unwrap().len()).sum::<u64>());
}

#[test]
fn runs_in_any_order_come_back_from_our_own_readers() {
    let dir = tempfile::tempdir().unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    for (scalar, offset) in
        [(ScalarType::F32, 0.0), (ScalarType::F64, 1e9), (ScalarType::U8, 0.0), (ScalarType::I16, -300.0)]
    {
        let meta = meta(scalar, offset);
        for (ending, format) in ENDINGS {
            if matches!(format, SampleFormat::Vtr | SampleFormat::Vts) {
                continue;
            }
            for compress in [false, true] {
                let never = [SampleFormat::Npy, SampleFormat::Nifti, SampleFormat::Tiff];
                if compress && never.contains(&format) {
                    continue;
                }
                let path = dir.path().join(format!("a{ending}"));
                write(&path, &meta, compress, None);
                let (info, values) = read_all(open_volume(&path, &OpenOptions::default()).unwrap());
                let text = format!("{ending} {scalar:?} {compress}");
                assert_eq!((info.dims, info.field.scalar), ([4, 3, 2], scalar), "{text}");
                let wanted: Vec<f32> = (0..24).map(|i| (offset + f64::from(i)) as f32).collect();
                assert_eq!(values, wanted, "{text}");
                if format == SampleFormat::Tiff {
                    let GridPlace::Even(place) = &meta.place else { unreachable!() };
                    let apart = (0..3).map(|a| info.geometry.spacing[a] / place.spacing[a] - 1.0);
                    assert!(apart.into_iter().all(|d| d.abs() < 1e-8), "{text}: {:?}", info.geometry);
                    assert_eq!(info.units.length, meta.units.length, "{text}");
                } else if format != SampleFormat::Npy {
                    let GridPlace::Even(place) = meta.place else { unreachable!() };
                    let near = |a: [f64; 3], b: [f64; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-6);
                    assert!(near(info.geometry.origin, place.origin), "{text}: {:?}", info.geometry);
                    assert!(near(info.geometry.spacing, place.spacing), "{text}");
                    assert!((0..3).all(|a| near(info.geometry.direction[a], place.direction[a])), "{text}");
                }
                if format == SampleFormat::Vti {
                    assert_eq!(info.field.name, meta.field().name);
                }
                if matches!(format, SampleFormat::Nrrd | SampleFormat::Nifti | SampleFormat::Mha) {
                    assert_eq!(info.units.length, meta.units.length, "{text}");
                }
                let one: Vec<Vec<u8>> =
                    format.files(&path).iter().map(|f| std::fs::read(f).unwrap()).collect();
                write(&path, &meta, compress, Some(&pool));
                let many = format.files(&path).into_iter().map(|f| std::fs::read(f).unwrap());
                assert!(many.eq(one), "{text}");
            }
        }
    }
}

#[test]
fn a_patient_is_not_turned_over() {
    let dir = tempfile::tempdir().unwrap();
    let of = |anatomy| GridMeta { anatomy, ..meta(ScalarType::F32, 0.0) };
    for (ending, source, turned) in [
        (".nii", Anatomy::Lps, true),
        (".nii", Anatomy::Ras, false),
        (".nii", Anatomy::Unknown, false),
        (".mha", Anatomy::Ras, true),
        (".mha", Anatomy::Lps, false),
        (".nrrd", Anatomy::Ras, false),
    ] {
        let (path, meta) = (dir.path().join(format!("a{ending}")), of(source));
        write(&path, &meta, false, None);
        let geometry = open_volume(&path, &OpenOptions::default()).unwrap().info().geometry;
        let sign = if turned { -1.0 } else { 1.0 };
        assert!((geometry.origin[0] - sign).abs() < 1e-6, "{ending} {source:?}: {geometry:?}");
        assert!((geometry.direction[0][1] - sign).abs() < 1e-6, "{ending} {source:?}: {geometry:?}");
        let told = SampleFormat::from_path(&path).unwrap().notices(&meta);
        assert_eq!(told.iter().any(|line| line.contains("change sign")), turned);
    }
    let text = std::fs::read_to_string(dir.path().join("a.nrrd"));
    assert!(text.is_err() || text.unwrap().contains("space: right-anterior-superior"));
}

#[test]
fn a_grid_that_version_1_does_not_hold_is_version_2() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.nii");
    let mut meta = meta(ScalarType::F32, 0.0);
    let far = Geometry { origin: [4_500_000.123, 0.125, 7.0], spacing: [0.01; 3], ..Geometry::default() };
    meta.place = GridPlace::Even(far);
    meta.units.length = Unit::length("nm");
    write(&path, &meta, false, None);
    let source = open_volume(&path, &OpenOptions::default()).unwrap();
    let info = source.info();
    assert!(info.format.contains("NIfTI-2"), "{}", info.format);
    // In micrometres, of which NIfTI has a number.
    assert_eq!(info.units.length, Unit::length("µm"));
    assert!(
        (info.geometry.origin[0] - 4_500.000_123).abs() < 1e-9
            && (info.geometry.spacing[0] - 1e-5).abs() < 1e-18
    );
    assert!(SampleFormat::Nifti.notices(&meta)[1].contains("nm"));
}

#[test]
fn several_blocks_are_one_stream() {
    let dir = tempfile::tempdir().unwrap();
    let dims = [300, 200, 90];
    let meta = GridMeta { dims, ..meta(ScalarType::U16, 0.0) };
    let samples: Vec<f32> = (0..dims.iter().product::<u64>()).map(|i| (i * i % 40_009) as f32).collect();
    for name in ["a.nii.gz", "a.nrrd", "a.mha", "a.vti"] {
        let path = dir.path().join(name);
        let format = SampleFormat::from_path(&path).unwrap();
        let file = SampleFile::create(&path, format, &meta, true, Some(dir.path())).unwrap();
        file.write(0, &samples).unwrap();
        file.publish(None, &CancelToken::new()).unwrap();
        let (_, values) = read_all(open_volume(&path, &OpenOptions::default()).unwrap());
        assert!(values == samples, "{name}");
    }
}

#[test]
fn other_names_and_endless_grids_are_refused() {
    assert!(SampleFormat::from_path(Path::new("a.csv")).is_err());
    assert_eq!(SampleFormat::from_path(Path::new("A.NII.GZ")).unwrap(), SampleFormat::NiftiGz);
    let endless = GridMeta { dims: [1 << 24; 3], ..meta(ScalarType::F32, 0.0) };
    assert_eq!(endless.samples().unwrap_err().exit_code(), 2);
    let dir = tempfile::tempdir().unwrap();
    let meta = meta(ScalarType::U8, 0.0);
    let refused = |name: &str, compress| {
        let (path, format) = (dir.path().join(name), SampleFormat::from_path(Path::new(name)).unwrap());
        SampleFile::create(&path, format, &meta, compress, None).map(drop).unwrap_err().to_string()
    };
    assert!(refused("a.vtr", false).contains("write .vti"));
    assert!(refused("a.npy", true).contains("leave out `compress`"));
    let file = SampleFile::create(&dir.path().join("a.npy"), SampleFormat::Npy, &meta, false, None).unwrap();
    assert!(file.write(0, &[300.0]).unwrap_err().to_string().contains("300 cannot be written as uint8"));
    assert!(file.write(0, &[f32::NAN]).is_err());
    drop(file);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "nothing half-written");
}
