//! Levels of pyramids as files of samples: what other programs read is what the archive has.

use crate::common::*;
use isospan::exec::{CancelToken, Resources, Silent};
use isospan::formats::samples::{GridMeta, SampleField, SampleFile, SampleFormat};
use isospan::formats::{OpenOptions, StepSource, open_volume, steps_of};
use isospan::grid::Geometry;
use isospan::pipeline::{
    self, Bound, GridReport, GridSettings, ProbeSettings, ReduceSettings, StepChoice, Target,
};
use isospan::points::SetKind;
use isospan::surface::check::check;
use isospan::volume::units::{Unit, Units};
use isospan::volume::{ScalarType, VolumeInfo};
use isospan::{Archive, Result};
use std::path::Path;
use std::process::{Command, Output};

fn settings(target: Target) -> ReduceSettings {
    ReduceSettings { points: Some(SetKind::Pyramid), target: Some(target), ..ReduceSettings::default() }
}

/// A volume of some type, placed askew, in millimetres.
fn volume(path: &Path, dims: [u64; 3], kind: (ScalarType, f64), value: impl Fn(u64) -> f64) {
    let geometry = Geometry {
        origin: [10.5, -20.25, 3.125],
        spacing: [0.5, 0.75, 2.0],
        direction: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    };
    volume_at(path, dims, geometry, kind, value);
}

fn volume_at(
    path: &Path,
    dims: [u64; 3],
    geometry: Geometry,
    (scalar, offset): (ScalarType, f64),
    value: impl Fn(u64) -> f64,
) {
    let field = SampleField { name: "density".into(), scalar, offset, is_labels: false };
    let units = Units { value: Unit::new("K"), length: Unit::length("mm"), time: None };
    let meta = GridMeta { units, ..GridMeta::even(dims, geometry, field) };
    let format = SampleFormat::from_path(path).unwrap();
    let file = SampleFile::create(path, format, &meta, false, None).unwrap();
    let samples: Vec<f32> = (0..dims.iter().product()).map(|i| (value(i) - offset) as f32).collect();
    file.write(0, &samples).unwrap();
    file.publish(None, &CancelToken::new()).unwrap();
}

/// What our own reader finds in a file: its description, and its stored samples as `f64`.
fn read(path: &Path) -> (VolumeInfo, Vec<f64>) {
    read_with(path, &OpenOptions::default())
}

fn read_with(path: &Path, options: &OpenOptions) -> (VolumeInfo, Vec<f64>) {
    let mut stream = open_volume(path, options).unwrap().into_stream();
    let (info, mut slab) = (stream.info().clone(), vec![]);
    let [nx, ny, nz] = info.dims;
    let mut all = vec![f64::NAN; (nx * ny * nz) as usize];
    while let Some(place) = stream.next_slab(&mut slab).unwrap() {
        let width = info.field.scalar.bytes();
        for (i, bytes) in slab.chunks(width).enumerate() {
            let (d, i) = (place.dims(), i as u64);
            let [x, y, z] = [i % d[0], i / d[0] % d[1], i / d[0] / d[1]];
            let [x, y, z] = [place.lo[0] + x, place.lo[1] + y, place.lo[2] + z];
            all[((z * ny + y) * nx + x) as usize] = number(info.field.scalar, bytes);
        }
    }
    (info, all)
}

fn number(scalar: ScalarType, bytes: &[u8]) -> f64 {
    match scalar {
        ScalarType::U8 => bytes[0].into(),
        ScalarType::U16 => u16::from_le_bytes(bytes.try_into().unwrap()).into(),
        ScalarType::I32 => i32::from_le_bytes(bytes.try_into().unwrap()).into(),
        ScalarType::F32 => f32::from_le_bytes(bytes.try_into().unwrap()).into(),
        ScalarType::F64 => f64::from_le_bytes(bytes.try_into().unwrap()),
        other => panic!("{other:?}"),
    }
}

fn export(archive: &Archive, settings: &GridSettings, out: &Path) -> Result<GridReport> {
    let format = SampleFormat::from_path(out)?;
    archive.at(StepChoice::First)?.write_grid(settings, out, format, &Silent)
}

#[test]
fn all_formats_have_the_samples_and_their_places() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.nrrd"), dir.path().join("a.isospan"));
    let dims = [300u64, 70, 33];
    volume(&input, dims, (ScalarType::F32, 0.0), |i| (i as f64 * 1e-3).sin() + (i % 300) as f64 * 0.01);
    reduce(&input, &settings(Target::Rms(Bound::OfRange(0.01))), &out, 2);
    let archive = Archive::open(&out).unwrap();
    let expected = archive.sample(dims).unwrap();
    let geometry = archive.geometry();
    for name in
        ["a.vti", "a.nrrd", "b.nrrd", "a.nii", "a.nii.gz", "a.mha", "a.mhd", "b.mha", "b.vti", "a.npy"]
    {
        let path = dir.path().join(format!("out-{name}"));
        let compress = name.starts_with('b');
        let settings = GridSettings { compress, ..GridSettings::default() };
        let report = export(&archive, &settings, &path).unwrap();
        assert_eq!((report.dims, &*report.types), (dims, &["float32"][..]), "{name}");
        let (info, values) = read(&path);
        assert!(values == expected, "{name}");
        if name != "a.npy" {
            let near = |a: [f64; 3], b: [f64; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-6);
            assert!(near(info.geometry.origin, geometry.origin), "{name}: {:?}", info.geometry);
            assert!(
                near(info.geometry.to_world([7.0, 5.0, 3.0]), geometry.to_world([7.0, 5.0, 3.0])),
                "{name}"
            );
        }
        if !name.ends_with("vti") && name != "a.npy" {
            assert_eq!(info.units.length, Unit::length("mm"), "{name}");
        }
        // Neither threads nor memory show.
        let before = std::fs::read(&path).unwrap();
        let resources = Resources::default().with_threads(1).with_memory(64 << 20);
        export(&archive, &GridSettings { resources, ..settings.clone() }, &path).unwrap();
        assert!(std::fs::read(&path).unwrap() == before, "{name}");
    }
    assert_eq!(read(&dir.path().join("out-a.vti")).0.field.name, archive.field());
    assert_eq!(read(&dir.path().join("out-a.nrrd")).0.units.value, Unit::new("K"));
    // A grid of its own, from probe.
    let path = dir.path().join("probed.nii.gz");
    let format = SampleFormat::NiftiGz;
    let report =
        archive.write_samples([20, 30, 40], &ProbeSettings::default(), &path, format, &Silent).unwrap();
    let (info, values) = read(&path);
    assert_eq!((info.dims, report.notices.len()), ([20, 30, 40], 1));
    assert!(values == archive.sample([20, 30, 40]).unwrap());
}

#[test]
fn a_level_and_a_region_lie_where_their_samples_do() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.nrrd"), dir.path().join("a.isospan"));
    let dims = [90u64, 70, 33];
    volume(&input, dims, (ScalarType::F32, 0.0), |i| (i as f64 * 1e-3).sin());
    reduce(&input, &settings(Target::Rms(Bound::OfRange(0.01))), &out, 2);
    let archive = Archive::open(&out).unwrap();
    let levels = archive.info().unwrap().pyramid;
    let path = dir.path().join("b.nrrd");
    for (level, of_level) in levels.iter().enumerate().take(4) {
        let whole = GridSettings { level, ..GridSettings::default() };
        let report = export(&archive, &whole, &path).unwrap();
        assert_eq!(report.dims, of_level.nodes);
        let (_, all) = read(&path);
        let part = GridSettings { roi: Some("11:60,:,8:16".parse().unwrap()), ..whole };
        let report = export(&archive, &part, &path).unwrap();
        let (info, values) = read(&path);
        let stride = report.stride;
        let lo = [11u64.div_ceil(stride[0]), 0, 8u64.div_ceil(stride[2])];
        let hi = [60 / stride[0], of_level.nodes[1] - 1, 16 / stride[2]];
        assert_eq!(report.dims, [0, 1, 2].map(|a| hi[a] - lo[a] + 1), "{level}");
        assert_eq!(report.first, [0, 1, 2].map(|a| lo[a] * stride[a]));
        let world = archive.geometry().to_world(report.first.map(|n| n as f64));
        assert!((0..3).all(|k| (info.geometry.origin[k] - world[k]).abs() < 1e-9));
        assert!((info.geometry.spacing[1] - 0.75 * stride[1] as f64).abs() < 1e-12);
        let [nx, ny, _] = of_level.nodes;
        let [dx, dy, _] = report.dims;
        for (i, value) in values.iter().enumerate() {
            let i = i as u64;
            let [x, y, z] = [i % dx + lo[0], i / dx % dy + lo[1], i / dx / dy + lo[2]];
            assert_eq!(*value, all[((z * ny + y) * nx + x) as usize], "level {level}: {x} {y} {z}");
        }
    }
    // The same region in the world, whose axes are turned; and a slice.
    let [a, b] = [[11.0, 0.0, 8.0], [60.0, 69.0, 16.0]].map(|p| archive.geometry().to_world(p));
    let range = |k: usize| format!("{}:{}", a[k].min(b[k]), a[k].max(b[k]));
    let world = format!("world:{},{},{}", range(0), range(1), range(2));
    let of = |roi: &str| {
        export(&archive, &GridSettings { roi: Some(roi.parse().unwrap()), ..Default::default() }, &path)
    };
    assert_eq!(of(&world).unwrap().dims, [50, 70, 9]);
    assert_eq!(of(":,:,5:5").unwrap().dims, [90, 70, 1]);
    assert!(of("5.2:5.7,:,:").unwrap_err().to_string().contains("no sample lies in the region"));
    assert!(of("100:200,:,:").unwrap_err().to_string().contains("outside the volume"));
    let error = export(&archive, &GridSettings { level: 99, ..Default::default() }, &path).unwrap_err();
    assert!(error.to_string().contains("no level 99"), "{error}");
}

#[test]
fn whole_numbers_come_back_in_their_type() {
    let dir = tempfile::tempdir().unwrap();
    for (n, (scalar, offset)) in
        [(ScalarType::U8, 0.0), (ScalarType::U16, 0.0), (ScalarType::I32, 1_234_567_890.0)]
            .into_iter()
            .enumerate()
    {
        let (input, out) = (dir.path().join(format!("{n}.nrrd")), dir.path().join(format!("{n}.isospan")));
        volume(&input, [70, 40, 30], (scalar, offset), |i| offset + (i * i % 251) as f64);
        reduce(&input, &settings(Target::Lossless), &out, 2);
        let archive = Archive::open(&out).unwrap();
        for ending in ["nrrd", "nii.gz", "mha", "vti", "npy"] {
            let path = dir.path().join(format!("{n}-out.{ending}"));
            export(&archive, &GridSettings::default(), &path).unwrap();
            let (info, values) = read(&path);
            assert_eq!(info.field.scalar, scalar, "{ending}");
            assert!(values == read(&input).1, "{ending}");
            // Coarser nodes are means, and no whole numbers.
            let report = export(&archive, &GridSettings { level: 1, ..Default::default() }, &path).unwrap();
            let wide = archive.offset() != 0.0;
            assert_eq!(report.types, [if wide { "float64" } else { "float32" }]);
        }
    }
}

#[test]
fn grids_with_coordinates_keep_them() {
    let dir = tempfile::tempdir().unwrap();
    let n = 24 * 20 * 18;
    let numbers = |count: usize, of: &dyn Fn(usize) -> f64| -> String {
        (0..count).map(|i| format!("{} ", of(i))).collect()
    };
    let values = numbers(n, &|i| (i as f64 * 0.01).sin());
    let extent = "0 23 0 19 0 17";
    let axis = |count, f: f64| {
        format!(
            "<DataArray type=\"Float64\" format=\"ascii\">{}</DataArray>",
            numbers(count, &|i| f * (i * i) as f64)
        )
    };
    let vtr = format!(
        "<VTKFile type=\"RectilinearGrid\"><RectilinearGrid WholeExtent=\"{extent}\"><Piece Extent=\"{extent}\">\
         <PointData><DataArray type=\"Float32\" Name=\"f\" format=\"ascii\">{values}</DataArray></PointData>\
         <Coordinates>{}{}{}</Coordinates></Piece></RectilinearGrid></VTKFile>",
        axis(24, 0.5),
        axis(20, 1.0),
        axis(18, 2.0)
    );
    let place = |i: usize| [i % 24, i / 24 % 20, i / 480].map(|v| v as f64);
    let bent = |i: usize| {
        let [x, y, z] = place(i);
        [x + 0.1 * y * y, y + 0.05 * z, z]
    };
    let points = numbers(3 * n, &|i| bent(i / 3)[i % 3]);
    let vts = format!(
        "<VTKFile type=\"StructuredGrid\"><StructuredGrid WholeExtent=\"{extent}\"><Piece Extent=\"{extent}\">\
         <PointData><DataArray type=\"Float32\" Name=\"f\" format=\"ascii\">{values}</DataArray></PointData>\
         <Points><DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">{points}</DataArray></Points>\
         </Piece></StructuredGrid></VTKFile>"
    );
    for (ending, text, refused) in [("vtr", vtr, "write .vtr"), ("vts", vts, "write .vts")] {
        let (input, out) =
            (dir.path().join(format!("a.{ending}")), dir.path().join(format!("{ending}.isospan")));
        std::fs::write(&input, text).unwrap();
        reduce(&input, &settings(Target::Rms(Bound::OfRange(0.01))), &out, 2);
        let archive = Archive::open(&out).unwrap();
        let path = dir.path().join(format!("out.{ending}"));
        let compress = ending == "vts";
        export(&archive, &GridSettings { compress, ..Default::default() }, &path).unwrap();
        let (_, values) = read(&path);
        assert_eq!(values.len(), n);
        let rms = (values.iter().zip(read(&input).1).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / n as f64)
            .sqrt();
        assert!(rms <= 0.02, "{rms}");
        assert_eq!(positions(&path), positions(&input), "{ending}");
        // Of a level, every second one.
        let level = GridSettings { level: 1, roi: Some(":,:,4:10".parse().unwrap()), ..Default::default() };
        let report = export(&archive, &level, &path).unwrap();
        // The splits of z may begin later.
        let step = report.stride[2] as usize;
        assert_eq!((report.dims, report.first), ([12, 10, 6 / step as u64 + 1], [0, 0, 4]));
        let found = positions(&path);
        match ending {
            "vtr" => {
                let expected: Vec<f64> = (0..24).step_by(2).map(|i| 0.5 * (i * i) as f64).collect();
                assert_eq!(found[..12], expected[..]);
                let expected: Vec<f64> = (4..11).step_by(step).map(|i| 2.0 * (i * i) as f64).collect();
                assert_eq!(found[22..], expected[..]);
            }
            _ => {
                let expected: Vec<f64> = (0..found.len() / 3)
                    .map(|i| [2 * (i % 12), 2 * (i / 12 % 10), 4 + step * (i / 120)])
                    .flat_map(|[x, y, z]| bent((z * 20 + y) * 24 + x))
                    .collect();
                assert_eq!(found, expected);
            }
        }
        let error = export(&archive, &GridSettings::default(), &dir.path().join("no.nii")).unwrap_err();
        assert!(error.to_string().contains(refused), "{error}");
    }
}

/// The coordinates of a grid, as its file has them.
fn positions(path: &Path) -> Vec<f64> {
    use isospan::formats::coordinates::GridCoordinates;
    let info = open_volume(path, &OpenOptions::default()).unwrap().info().clone();
    match StepSource::from(path).coordinates().unwrap().unwrap() {
        GridCoordinates::Axes(axes) => axes.concat(),
        GridCoordinates::Points(mut stream) => {
            let mut all = vec![0.0; 3 * info.dims.iter().product::<u64>() as usize];
            stream.fill(&mut all).unwrap();
            all
        }
    }
}

/// The coordinates of a level of an OME-Zarr image: its place, and its samples as `f64`.
fn read_level(path: &Path, level: usize, field: &str) -> (VolumeInfo, Vec<f64>) {
    let options = OpenOptions { field: Some(format!("{level}{field}")), ..OpenOptions::default() };
    read_with(path, &options)
}

#[test]
fn ome_zarr_has_all_levels_at_their_places() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("a.nrrd"), dir.path().join("a.isospan"));
    let dims = [140u64, 70, 33];
    // One axis counts down.
    let geometry = Geometry {
        origin: [10.5, -20.25, 3.125],
        spacing: [0.5, 0.75, 2.0],
        direction: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
    };
    volume_at(&input, dims, geometry, (ScalarType::U16, 0.0), |i| {
        ((i as f64 * 1e-3).sin() * 900.0 + 1000.0).round()
    });
    reduce(&input, &settings(Target::Lossless), &out, 2);
    let archive = Archive::open(&out).unwrap();
    let levels = archive.info().unwrap().pyramid;
    let image = dir.path().join("a.ome.zarr");
    let settings = GridSettings::default();
    let report = archive.write_ome_zarr(&settings, &image, false, &Silent).unwrap();
    assert_eq!((report.levels, &*report.types), (levels.len() as u64, &["uint16"][..]));
    let step = archive.at(StepChoice::First).unwrap();
    for (level, about) in levels.iter().enumerate() {
        let (info, values) = read_level(&image, level, "");
        assert_eq!((info.dims, info.field.scalar), (about.nodes, ScalarType::U16));
        assert_eq!((info.units.length, info.units.value), (Unit::length("mm"), Unit::new("K")));
        let path = dir.path().join("level.nrrd");
        let of_level = GridSettings { level, ..GridSettings::default() };
        step.write_grid(&of_level, &path, SampleFormat::Nrrd, &Silent).unwrap();
        let (other, expected) = read(&path);
        let [nx, ny, nz] = info.dims;
        for z in 0..nz {
            for y in 0..ny {
                let row = |y: u64| (z * ny + y) * nx;
                for x in 0..nx {
                    let found = values[(row(y) + x) as usize];
                    let wanted = expected[(row(ny - 1 - y) + x) as usize];
                    assert_eq!(found, wanted.round(), "level {level}: {x} {y} {z}");
                }
            }
        }
        let at = |g: &Geometry, y: u64| g.to_world([1.0, y as f64, 2.0]);
        let (a, b) = (at(&info.geometry, 0), at(&other.geometry, ny - 1));
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-9), "{a:?} {b:?}");
    }
    // Another folder is not replaced, an image is; threads do not show.
    let before = folder(&image);
    let resources = Resources::default().with_threads(1);
    archive.write_ome_zarr(&GridSettings { resources, ..settings.clone() }, &image, true, &Silent).unwrap();
    assert!(folder(&image) == before);
    let error = archive.write_ome_zarr(&settings, &image, false, &Silent).unwrap_err().to_string();
    assert!(error.contains("it exists"), "{error}");
    let error = archive.write_ome_zarr(&settings, &out, true, &Silent).unwrap_err().to_string();
    assert!(error.contains("no Zarr folder"), "{error}");
    // Axes that are turned have no place.
    let turned = dir.path().join("turned.nrrd");
    volume(&turned, dims, (ScalarType::F32, 0.0), |i| i as f64);
    reduce(&turned, &self::settings(Target::Rms(Bound::OfRange(0.01))), &dir.path().join("t.isospan"), 2);
    let turned = Archive::open(dir.path().join("t.isospan")).unwrap();
    let error = turned.write_ome_zarr(&settings, &dir.path().join("t.zarr"), false, &Silent).unwrap_err();
    assert!(error.to_string().contains("axes that are turned"), "{error}");
}

#[test]
fn ome_zarr_has_steps_and_a_region() {
    let dir = tempfile::tempdir().unwrap();
    let inputs: Vec<_> = (0..3).map(|t| dir.path().join(format!("{t}.npy"))).collect();
    for (t, input) in inputs.iter().enumerate() {
        write_npy(input, [90, 40, 34], |x, y, z| waves(x, y, z) * (1.0 + 0.2 * t as f64));
    }
    let sources: Vec<StepSource> = inputs
        .iter()
        .zip(0..)
        .map(|(path, t)| StepSource::from(&**path).at(Some(2.0 + 0.5 * f64::from(t))))
        .collect();
    let out = dir.path().join("a.isospan");
    pipeline::reduce_series(&sources, &settings(Target::Rms(Bound::OfRange(0.01))), &out, &run(2), &Silent)
        .unwrap();
    let archive = Archive::open(&out).unwrap();
    let image = dir.path().join("a.zarr");
    let settings = GridSettings { roi: Some("10:80,:,4:".parse().unwrap()), ..GridSettings::default() };
    let report = archive.steps(..).unwrap().write_ome_zarr(&settings, &image, false, &Silent).unwrap();
    assert_eq!((report.steps, report.dims, report.first), (3, [71, 40, 30], [10, 0, 4]));
    let steps = steps_of(std::slice::from_ref(&image), &OpenOptions::default()).unwrap();
    assert_eq!(steps.iter().map(|step| step.time).collect::<Vec<_>>(), [2.0, 2.5, 3.0].map(Some));
    for n in 0..3 {
        let (info, values) = read_level(&image, 0, &format!(":t{n}"));
        assert_eq!(info.geometry.origin, [10.0, 0.0, 4.0]);
        let all = archive.at(StepChoice::Number(n)).unwrap().sample([90, 40, 34]).unwrap();
        for (i, value) in values.iter().enumerate() {
            let at = [i % 71 + 10, i / 71 % 40, i / 71 / 40 + 4];
            assert_eq!(*value, all[(at[2] * 40 + at[1]) * 90 + at[0]]);
        }
    }
}

#[test]
fn an_archive_is_a_source() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let dims = [70u64, 40, 30];
    volume(&d.join("a.nrrd"), dims, (ScalarType::U16, 0.0), |i| (i * i % 251) as f64);
    reduce(&d.join("a.nrrd"), &settings(Target::Lossless), &d.join("a.isospan"), 2);
    // The samples are those of the file, so what is made of them is, too.
    for (n, words) in
        [&["--points", "hammersley"][..], &["--points", "pyramid", "--lossless"]].into_iter().enumerate()
    {
        for input in ["a.nrrd", "a.isospan"] {
            let out = format!("{n}-{input}.isospan");
            let done = isospan(d, &[&["reduce", input, "-o", &out][..], words].concat());
            assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        }
        let [a, b] = ["a.nrrd", "a.isospan"]
            .map(|input| Archive::open(d.join(format!("{n}-{input}.isospan"))).unwrap());
        assert_eq!((a.geometry(), a.units(), a.field()), (b.geometry(), b.units(), b.field()));
        assert!(a.surface(100.5).unwrap() == b.surface(100.5).unwrap(), "{words:?}");
        check_archive(&d.join(format!("{n}-a.isospan.isospan"))).unwrap();
    }
    // The error against another file, too: of a pyramid of some error, against its source.
    let reduce = |args: &[&str]| {
        let done = isospan(d, &[&["reduce", "--json", "-q"][..], args].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        serde_json::from_slice::<serde_json::Value>(&done.stdout).unwrap()
    };
    reduce(&["a.nrrd", "-o", "some.isospan", "--target-rms", "5%"]);
    let again = ["--points", "hammersley", "--count", "4k", "--against", "a.nrrd"];
    let found = reduce(&[&["some.isospan", "-o", "again.isospan"][..], &again].concat());
    let said = isospan(d, &["measure", "again.isospan", "--against", "a.nrrd", "--json"]);
    let said: serde_json::Value = serde_json::from_slice(&said.stdout).unwrap();
    for figure in ["rms", "max", "measured"] {
        assert_eq!(found["against"][figure], said[figure], "{figure}");
    }
    assert_ne!(found["against"]["rms"], found["error"]["rms"]);
    let refused = isospan(d, &["reduce", "some.isospan", "-o", "no.isospan", "--against", "missing.nrrd"]);
    assert!(!refused.status.success() && !d.join("no.isospan").exists());
    // So is a bricked copy of it, which other processes read.
    let done = isospan(d, &["brick", "a.isospan", "-o", "a.bricks"]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert!(read(&d.join("a.bricks")).1 == read(&d.join("a.nrrd")).1);
    // A coarse level is one, too: what export writes of it, in its place.
    for (out, args) in [
        ("l.npy", vec!["export", "a.isospan", "--level", "1", "-o"]),
        ("l.isospan", vec!["reduce", "a.isospan", "--scale", "1", "--target-max", "0.01", "-o"]),
        ("l.bricks", vec!["brick", "a.isospan", "--scale", "1", "-o"]),
    ] {
        let done = isospan(d, &[&args[..], &[out]].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    }
    let [fine, coarse] = ["a.isospan", "l.isospan"].map(|name| Archive::open(d.join(name)).unwrap());
    let level = fine.info().unwrap().pyramid[1].clone();
    assert_eq!((coarse.dims(), level.stride[0]), (level.nodes, 2));
    let spacing = [0, 1, 2].map(|a| fine.geometry().spacing[a] * level.stride[a] as f64);
    assert_eq!(coarse.geometry().spacing, spacing);
    assert_eq!(coarse.geometry().origin, fine.geometry().origin);
    let nodes = read(&d.join("l.npy")).1;
    assert!(
        read(&d.join("l.bricks")).1 == nodes && nodes.len() as u64 == level.nodes.iter().product::<u64>()
    );
    let kept = coarse.sample_with(coarse.dims(), &Default::default()).unwrap();
    assert!(nodes.iter().zip(kept).all(|(a, b)| (a - b).abs() <= 0.0101));
    // Steps have their times.
    let steps: Vec<StepSource> = (0..2)
        .map(|t| {
            let path = d.join(format!("{t}.npy"));
            write_npy(&path, [40, 33, 27], |x, y, z| waves(x, y, z) * (1.0 + f64::from(t)));
            StepSource::from(&*path).at(Some(0.5 * f64::from(t)))
        })
        .collect();
    let rms = settings(Target::Rms(Bound::OfRange(0.01)));
    pipeline::reduce_series(&steps, &rms, &d.join("s.isospan"), &run(2), &Silent).unwrap();
    let again = Archive::open(d.join("s.isospan")).unwrap().sources().unwrap();
    assert_eq!(again.iter().map(|step| step.time).collect::<Vec<_>>(), [Some(0.0), Some(0.5)]);
    let halton = ReduceSettings::exact(SetKind::Halton);
    let report = pipeline::reduce_series(&again, &halton, &d.join("h.isospan"), &run(2), &Silent).unwrap();
    assert!(!report.made_before);
    let report = pipeline::reduce_series(&again, &halton, &d.join("h.isospan"), &run(2), &Silent).unwrap();
    assert!(report.made_before);
    for (args, text) in [
        (&["reduce", "a.isospan", "-o", "a.isospan"][..], "a.isospan"),
        (&["reduce", "h.isospan", "-o", "x.isospan"], "only pyramids are read as volumes"),
        (&["reduce", "a.isospan", "a.nrrd", "-o", "x.isospan"], "give one kind"),
        (
            &["reduce", "a.isospan", "-o", "x.isospan", "--spacing", "1,1,1"],
            "tells all of its samples itself",
        ),
        (&["reduce", "a.isospan", "--scale", "9", "-o", "x.isospan"], "has no level 9"),
        (&["reduce", "a.isospan", "--scale", "fine", "-o", "x.isospan"], "are numbers"),
        (&["brick", "s.isospan", "-o", "s.bricks"], "has 2 steps"),
        (&["plan", "a.isospan", "-o", "x.isospan", "--shards", "2"], "isospan brick"),
    ] {
        let out = isospan(d, args);
        let told = String::from_utf8_lossy(&out.stderr);
        assert!(
            !out.status.success() && told.contains(text) && told.lines().count() == 1,
            "{args:?}: {told}"
        );
        assert!(!d.join("x.isospan").exists() && !d.join("s.bricks").exists(), "{args:?}");
    }
}

#[test]
fn spectra_of_grids_with_coordinates_are_those_of_their_surfaces() {
    let dir = tempfile::tempdir().unwrap();
    let [nx, ny, nz] = [48usize, 40, 36];
    let place = |i: usize| [i % nx, i / nx % ny, i / nx / ny].map(|v| v as f64);
    let extent = format!("0 {} 0 {} 0 {}", nx - 1, ny - 1, nz - 1);
    let numbers = |all: &mut dyn Iterator<Item = f64>| all.map(|v| format!("{v} ")).collect::<String>();
    let bent = |i: usize| {
        let [x, y, z] = place(i);
        [0.1 * x + 0.01 * y, 0.1 * y + 0.002 * z * z, 0.12 * z + 0.001 * x * x]
    };
    let stretched = |i: usize| {
        let [x, y, z] = place(i);
        [0.002 * x * x + 0.02 * x, 0.1 * y, 0.003 * z * z + 0.01 * z]
    };
    let ball = |[x, y, z]: [f64; 3]| {
        let middle = [2.6, 2.6, 2.4];
        let d = [x - middle[0], y - middle[1], z - middle[2]];
        3.0 - (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
    };
    for kind in ["StructuredGrid", "RectilinearGrid"] {
        let at = |i: usize| if kind == "StructuredGrid" { bent(i) } else { stretched(i) };
        let values = numbers(&mut (0..nx * ny * nz).map(|i| ball(at(i))));
        let array = |text: String, n: u32| {
            format!(
                "<DataArray type=\"Float64\" NumberOfComponents=\"{n}\" format=\"ascii\">{text}</DataArray>"
            )
        };
        let coordinates = if kind == "StructuredGrid" {
            format!("<Points>{}</Points>", array(numbers(&mut (0..nx * ny * nz).flat_map(at)), 3))
        } else {
            let lines = [
                numbers(&mut (0..nx).map(|i| at(i)[0])),
                numbers(&mut (0..ny).map(|i| at(i * nx)[1])),
                numbers(&mut (0..nz).map(|i| at(i * nx * ny)[2])),
            ];
            format!("<Coordinates>{}</Coordinates>", lines.map(|line| array(line, 1)).concat())
        };
        let text = format!(
            "<VTKFile type=\"{kind}\"><{kind} WholeExtent=\"{extent}\"><Piece Extent=\"{extent}\"><PointData>\
             <DataArray type=\"Float32\" Name=\"f\" format=\"ascii\">{values}</DataArray></PointData>{coordinates}\
             </Piece></{kind}></VTKFile>"
        );
        let input = dir.path().join(if kind == "StructuredGrid" { "a.vts" } else { "a.vtr" });
        std::fs::write(&input, text).unwrap();
        let out = dir.path().join(format!("{kind}.isospan"));
        reduce(&input, &settings(Target::Max(Bound::OfRange(0.0001))), &out, 2);
        let archive = Archive::open(&out).unwrap();
        let report = archive.spectrum().unwrap();
        assert!(!report.knots.is_empty(), "{kind}");
        let wanted = report.knots.iter().filter(|knot| (1.0..2.0).contains(&knot.isovalue));
        for knot in wanted.step_by(20) {
            let checked = check(&archive.surface(knot.isovalue).unwrap());
            assert!((0.98..1.02).contains(&(knot.area / checked.area)), "{kind} {knot:?} {}", checked.area);
            let radius = 3.0 - knot.isovalue;
            let volume = 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
            if checked.is_closed() {
                assert!((0.97..1.03).contains(&(knot.volume / volume)), "{kind} {knot:?} {volume}");
            }
            assert!((0.95..1.05).contains(&(knot.gradient / knot.area)), "{kind} {knot:?}");
            assert_eq!(knot.active_cells, archive.count(knot.isovalue).unwrap().active_cells);
        }
    }
}

fn isospan(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isospan")).current_dir(dir).args(args).output().unwrap()
}

#[test]
fn the_command_refuses_what_is_for_the_other_kind_of_archive() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_npy(&d.join("a.npy"), [20, 18, 16], waves);
    reduce(&d.join("a.npy"), &settings(Target::Rms(Bound::OfRange(0.01))), &d.join("a.isospan"), 2);
    reduce(&d.join("a.npy"), &ReduceSettings::exact(SetKind::Halton), &d.join("t.isospan"), 2);
    for (args, code, text) in [
        (&["a.isospan", "-o", "a.nii.gz"][..], 0, ""),
        (&["a.isospan", "-o", "a.mhd", "--level", "1", "--json"], 0, ""),
        (&["a.isospan", "-o", "a.mhd"], 2, "a.mhd exists"),
        (&["a.isospan", "-o", "a.mhd", "--force"], 0, ""),
        (&["a.isospan", "-o", "b.vtu"], 2, "is a pyramid of samples, which has no tetrahedra"),
        (&["a.isospan", "-o", "b.nii", "--range", "0:1"], 2, "--range chooses tetrahedra"),
        (&["a.isospan", "-o", "b.nii", "--every", "2"], 2, "--every chooses tetrahedra"),
        (&["a.isospan", "-o", "b.nii", "--compress"], 2, "compressed NIfTI is called .nii.gz"),
        (&["t.isospan", "-o", "b.vtu", "--level", "1"], 2, "leave out --level"),
        (&["t.isospan", "-o", "b.nii"], 2, "samples with isospan probe --grid"),
        (&["a.isospan", "-o", "b.csv"], 2, "end its name in .vti"),
        (&["a.isospan", "-o", "a.ome.zarr"], 0, ""),
        (&["a.isospan", "-o", "a.ome.zarr"], 2, "a.ome.zarr exists"),
        (&["a.isospan", "-o", "a.ome.zarr", "--force"], 0, ""),
        (&["a.isospan", "-o", "t.zarr", "--compress"], 2, "always compressed"),
        (&["a.isospan", "-o", "a.nrrd", "--all-steps"], 2, "for pyramids written as .zarr"),
        (&["t.isospan", "-o", "t.zarr"], 2, "samples with isospan probe --grid"),
    ] {
        let out = isospan(d, &[&["export"], args].concat());
        let told = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(code), "{args:?}: {told}");
        assert!(told.contains(text), "{args:?}: {told}");
        assert!(code == 0 || told.lines().count() == 1, "{args:?}: {told}");
    }
    let left = std::fs::read_dir(d).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    let mut left: Vec<String> = left.collect();
    left.sort();
    assert_eq!(left, ["a.isospan", "a.mhd", "a.nii.gz", "a.npy", "a.ome.zarr", "a.raw", "t.isospan"]);
    // The samples of a detached header are not written over without --force.
    std::fs::remove_file(d.join("a.mhd")).unwrap();
    let out = isospan(d, &["export", "a.isospan", "-o", "a.mhd"]);
    assert!(String::from_utf8_lossy(&out.stderr).contains("a.raw exists"));
}
