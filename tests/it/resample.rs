//! The other doors out: tetrahedra as a mesh, the field at samples and at points.

use crate::common::*;
use isospan::exec::Silent;
use isospan::formats::samples::SampleFormat;
use isospan::formats::{OpenOptions, open_volume};
use isospan::grid::IndexBox;
use isospan::pipeline::{self, Amount, Corners, ExportReport, ExportSettings, ProbeReport, ProbeSettings};
use isospan::points::SetKind;
use isospan::volume::VolumeSource;
use isospan::{Archive, Error, Resources};
use std::fs;
use std::io::Read as _;
use std::path::Path;

fn linear(x: f64, y: f64, z: f64) -> f64 {
    3.0 + x - 2.0 * y + 0.5 * z
}

fn export(archive: &Path, settings: ExportSettings, out: &Path) -> (ExportReport, Vtu) {
    let report = Archive::open(archive).unwrap().write_tetrahedra(&settings, out, &Silent).unwrap();
    let bytes = fs::read(out).unwrap();
    assert_eq!(report.file_bytes, bytes.len() as u64);
    let vtu = Vtu::parse(&bytes);
    assert_eq!((report.points, report.tetrahedra), (vtu.points.len() as u64, vtu.tets.len() as u64));
    (report, vtu)
}

/// The arrays of a VTU file as `export` writes them.
struct Vtu {
    points: Vec<[f64; 3]>,
    values: Vec<f32>,
    tets: Vec<[usize; 4]>,
}

impl Vtu {
    fn parse(bytes: &[u8]) -> Self {
        let mark = b"<AppendedData encoding=\"raw\">\n   _";
        let mut at = bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len();
        let mut next = || {
            let length = u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
            at += 8 + length;
            &bytes[at - length..at]
        };
        let (points, values, tets, offsets, types) = (next(), next(), next(), next(), next());
        let float = |b: &[u8]| f64::from_le_bytes(b.try_into().unwrap());
        let int = |b: &[u8]| u64::from_le_bytes(b.try_into().unwrap()) as usize;
        assert!(offsets.chunks(8).enumerate().all(|(i, b)| int(b) == 4 * (i + 1)));
        assert!(types.iter().all(|&t| t == 10));
        Self {
            points: points.chunks(24).map(|p| std::array::from_fn(|a| float(&p[8 * a..][..8]))).collect(),
            values: values.chunks(4).map(|v| f32::from_le_bytes(v.try_into().unwrap())).collect(),
            tets: tets.chunks(32).map(|t| std::array::from_fn(|k| int(&t[8 * k..][..8]))).collect(),
        }
    }

    /// Six times the volume of each tetrahedron.
    fn volumes(&self) -> Vec<f64> {
        let volume = |t: &[usize; 4]| {
            let [a, b, c, d] = t.map(|v| self.points[v]);
            let [u, v, w]: [[f64; 3]; 3] = [b, c, d].map(|p| std::array::from_fn(|k| p[k] - a[k]));
            let minor = |i: usize, j: usize| v[i] * w[j] - v[j] * w[i];
            u[0] * minor(1, 2) + u[1] * minor(2, 0) + u[2] * minor(0, 1)
        };
        self.tets.iter().map(volume).collect()
    }

    /// Corner positions and values, sorted: the same for the same mesh, for any numbering and any
    /// order.
    fn as_set(&self) -> Vec<Vec<([u64; 3], u32)>> {
        let corner = |&v: &usize| (self.points[v].map(f64::to_bits), self.values[v].to_bits());
        let sorted = |t: &[usize; 4]| {
            let mut corners: Vec<_> = t.iter().map(corner).collect();
            corners.sort_unstable();
            corners
        };
        let mut all: Vec<_> = self.tets.iter().map(sorted).collect();
        all.sort_unstable();
        all
    }
}

/// The same mesh, field and values in both formats, compressed or not; a reduction of it, too.
#[test]
fn vtkhdf_files_hold_what_vtu_files_do() {
    use isospan::cells::{CellBlock, CellMesh};
    let dir = tempfile::tempdir().unwrap();
    let (input, archive) = (dir.path().join("w.npy"), dir.path().join("w.isospan"));
    write_npy(&input, [40, 30, 24], waves);
    reduce(&input, &settings(SetKind::Halton, Amount::Fraction(0.3), 5000), &archive, 2);
    let whole = |mesh: &CellMesh| {
        let (mut points, mut values, mut cells) = (vec![], vec![], vec![]);
        let (mut stream, mut block) = (mesh.points().unwrap(), vec![]);
        while stream.next_block(&mut block).unwrap() {
            points.extend(block.iter().map(|p| p.map(f64::to_bits)));
        }
        let (mut stream, mut block) = (mesh.values(0, |_| false).unwrap(), vec![]);
        while stream.next_block(&mut block).unwrap() {
            values.extend(block.iter().map(|v| v.to_bits()));
        }
        let (mut stream, mut block) = (mesh.cells().unwrap(), CellBlock::default());
        while stream.next_block(&mut block).unwrap() {
            cells.extend(block.iter().map(|(kind, vertices)| (kind, vertices.to_vec())));
        }
        (points, values, cells)
    };
    let mut found = vec![];
    for (name, compress) in [("a.vtu", false), ("b.vtkhdf", false), ("c.vtkhdf", true)] {
        let out = dir.path().join(name);
        let write = |threads| {
            let resources = Resources::default().with_threads(threads);
            let settings = ExportSettings { compress, resources, ..ExportSettings::default() };
            let report = Archive::open(&archive).unwrap().write_tetrahedra(&settings, &out, &Silent).unwrap();
            let bytes = fs::read(&out).unwrap();
            assert_eq!(report.file_bytes, bytes.len() as u64);
            bytes
        };
        assert!(write(1) == write(3), "{name}: threads show");
        let mesh = isospan::formats::open_mesh(&out, &OpenOptions::default()).unwrap();
        let again = dir.path().join(name).with_extension("isospan");
        let settings = settings(SetKind::Hammersley, Amount::Fraction(0.2), 5000);
        reduce(&out, &settings, &again, 2);
        let file = dir.path().join("s.ply");
        surface(&again, 0.2, &file, 2);
        found.push((mesh.field().unwrap().name.clone(), whole(&mesh), read(&file)));
    }
    assert!(found[0].1.0.len() > 5000 && found[0].2.triangles.len() > 1000);
    for other in &found[1..] {
        assert_eq!(other.0, found[0].0);
        assert!(other.1 == found[0].1, "points, values or cells differ");
        assert!(other.2 == found[0].2, "surfaces of reductions differ");
    }
    // A file without tetrahedra is a file, too.
    let empty = ExportSettings { range: Some([1e9, 2e9]), compress: true, ..ExportSettings::default() };
    let out = dir.path().join("none.vtkhdf");
    Archive::open(&archive).unwrap().write_tetrahedra(&empty, &out, &Silent).unwrap();
    let mesh = isospan::formats::open_mesh(&out, &OpenOptions::default()).unwrap();
    assert_eq!((mesh.info().points, mesh.info().cells), (0, 0));
}

#[test]
fn exported_tetrahedra_fill_the_domain_each_point_once() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("w.npy");
    write_npy(&input, [40, 30, 24], waves);
    let mut sets = vec![];
    for chunk_points in [900, 250_000] {
        let archive = dir.path().join(format!("{chunk_points}.isospan"));
        let made =
            reduce(&input, &settings(SetKind::Halton, Amount::Fraction(0.3), chunk_points), &archive, 2);
        let (report, vtu) = export(&archive, ExportSettings::default(), &dir.path().join("a.vtu"));
        assert_eq!((report.points, report.tetrahedra), (made.points, made.tetrahedra), "each point once");
        assert_eq!(report.void_tetrahedra, 0);
        let volumes = vtu.volumes();
        assert!(volumes.iter().all(|&v| v > 0.0));
        let whole = 6.0 * 39.0 * 29.0 * 23.0;
        assert!((volumes.iter().sum::<f64>() - whole).abs() < 1e-9 * whole);
        sets.push(vtu.as_set());
        // Memory and threads do not show.
        let bytes = fs::read(dir.path().join("a.vtu")).unwrap();
        let tight = ExportSettings {
            resources: Resources::default().with_threads(1).with_memory(20 << 20),
            ..ExportSettings::default()
        };
        if chunk_points < 1000 {
            export(&archive, tight, &dir.path().join("b.vtu"));
            assert!(fs::read(dir.path().join("b.vtu")).unwrap() == bytes);
        } else {
            let error =
                Archive::open(&archive).unwrap().write_tetrahedra(&tight, &dir.path().join("b.vtu"), &Silent);
            assert!(error.is_ok() || matches!(error, Err(Error::Budget { .. })));
        }
    }
    assert!(sets[0] == sets[1], "the cut into chunks does not show in the mesh");
}

/// The arrays of a compressed VTU file, one after another, as they are before compression.
fn unpacked(bytes: &[u8]) -> Vec<Vec<u8>> {
    let mark = b"<AppendedData encoding=\"raw\">\n   _";
    let mut rest = &bytes[bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len()..];
    let mut next = |n: usize| rest.split_off(..n).unwrap();
    let mut arrays = vec![];
    for _ in 0..5 {
        let mut int = || u64::from_le_bytes(next(8).try_into().unwrap()) as usize;
        let (blocks, size, last) = (int(), int(), int());
        let packed: Vec<usize> = (0..blocks).map(|_| int()).collect();
        let mut array = vec![];
        for (n, packed) in packed.into_iter().enumerate() {
            let mut block = vec![];
            flate2::read::ZlibDecoder::new(next(packed)).read_to_end(&mut block).unwrap();
            assert_eq!(block.len(), if n + 1 == blocks && last > 0 { last } else { size });
            array.extend(block);
        }
        arrays.push(array);
    }
    assert_eq!(rest, b"\n  </AppendedData>\n</VTKFile>\n");
    arrays
}

#[test]
fn a_compressed_export_holds_the_same_arrays() {
    let dir = tempfile::tempdir().unwrap();
    let (input, archive, out) =
        (dir.path().join("w.npy"), dir.path().join("w.isospan"), dir.path().join("o.vtu"));
    write_npy(&input, [40, 30, 24], waves);
    reduce(&input, &settings(SetKind::Halton, Amount::Fraction(0.3), 900), &archive, 2);
    let write = |settings: &ExportSettings| {
        let report = Archive::open(&archive).unwrap().write_tetrahedra(settings, &out, &Silent).unwrap();
        let bytes = fs::read(&out).unwrap();
        assert_eq!(report.file_bytes, bytes.len() as u64);
        bytes
    };
    // Some arrays take several blocks, and one ends with a full one where there is nothing.
    for range in [None, Some([1e9, 2e9])] {
        let plain = ExportSettings { range, ..ExportSettings::default() };
        let packed = ExportSettings { compress: true, ..plain.clone() };
        let (raw, small) = (write(&plain), write(&packed));
        let (text, arrays) = (String::from_utf8_lossy(&small[..400]).into_owned(), unpacked(&small));
        assert!(text.contains("compressor=\"vtkZLibDataCompressor\""), "{text}");
        let as_raw: Vec<u8> =
            arrays.iter().flat_map(|a| [&(a.len() as u64).to_le_bytes()[..], a].concat()).collect();
        assert!(raw.windows(as_raw.len()).any(|w| w == as_raw));
        assert_eq!(
            write(&ExportSettings { resources: packed.resources.clone().with_threads(1), ..packed }),
            small
        );
        if range.is_none() {
            assert!(arrays[2].len() > 1 << 20 && small.len() * 3 < raw.len());
            // So does our reader of compressed meshes.
            let mesh = isospan::formats::open_mesh(&out, &OpenOptions::default()).unwrap();
            let (mut points, mut batch) = (mesh.points().unwrap(), vec![]);
            let mut read = vec![];
            while points.next_block(&mut batch).unwrap() {
                read.extend(batch.iter().flatten().flat_map(|x| x.to_le_bytes()));
            }
            assert!(read == arrays[0]);
        }
    }
}

#[test]
fn a_range_and_a_mask_choose_tetrahedra() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("w.npy");
    write_npy(&input, [30, 30, 30], waves);
    let archive = dir.path().join("w.isospan");
    reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(0.5), 2_000), &archive, 2);
    let out = dir.path().join("o.vtu");
    let (whole_report, whole) = export(&archive, ExportSettings::default(), &out);
    let all = whole.as_set();
    let values = |t: &[([u64; 3], u32)]| -> Vec<f32> { t.iter().map(|c| f32::from_bits(c.1)).collect() };
    for [lo, hi] in [[-0.2, 0.3], [1.3, f32::INFINITY], [0.1, 0.1], [50.0, 60.0]] {
        for corners in [Corners::All, Corners::Any] {
            let settings =
                ExportSettings { range: Some([lo, hi].map(f64::from)), corners, ..ExportSettings::default() };
            let (report, some) = export(&archive, settings, &out);
            let inside = |v: &f32| (lo..=hi).contains(v);
            let wanted: Vec<_> = all
                .iter()
                .filter(|t| match corners {
                    Corners::All => values(t).iter().all(inside),
                    Corners::Any => values(t).iter().any(inside),
                })
                .cloned()
                .collect();
            assert!(
                some.as_set() == wanted,
                "{lo} {hi} {corners:?}: {} of {}",
                some.tets.len(),
                wanted.len()
            );
            // All chunks have values above 1.3.
            if lo > 10.0 {
                assert!(report.bytes_read < whole_report.bytes_read, "{report:?}");
            }
        }
    }
    // A region: exactly the tetrahedra whose bounding box touches it.
    let region =
        ExportSettings { roi: Some("3.5:7,10:12.5,20:".parse().unwrap()), ..ExportSettings::default() };
    let (report, some) = export(&archive, region, &out);
    let touches = |t: &&Vec<([u64; 3], u32)>| {
        let reach = |a: usize, lo: f64, hi: f64| {
            let along: Vec<f64> = t.iter().map(|c| f64::from_bits(c.0[a])).collect();
            along.iter().any(|&x| x >= lo) && along.iter().any(|&x| x <= hi)
        };
        reach(0, 3.5, 7.0) && reach(1, 10.0, 12.5) && reach(2, 20.0, 29.0)
    };
    let wanted: Vec<_> = all.iter().filter(touches).cloned().collect();
    assert!(some.as_set() == wanted && !wanted.is_empty(), "{} of {}", some.tets.len(), wanted.len());
    assert!(report.chunks_read < report.chunks, "{report:?}");
    let each_third = ExportSettings { every: 3, ..ExportSettings::default() };
    let (report, third) = export(&archive, each_third, &out);
    assert_eq!(report.tetrahedra, whole_report.tetrahedra.div_ceil(3));
    let kept: Vec<[[f64; 3]; 4]> = third.tets.iter().map(|t| t.map(|v| third.points[v])).collect();
    let wanted: Vec<[[f64; 3]; 4]> =
        whole.tets.iter().step_by(3).map(|t| t.map(|v| whole.points[v])).collect();
    assert!(kept == wanted);
    let wrong = |s: ExportSettings, out: &str| {
        Archive::open(&archive).unwrap().write_tetrahedra(&s, &dir.path().join(out), &Silent).unwrap_err()
    };
    assert!(matches!(wrong(ExportSettings { every: 0, ..Default::default() }, "o.vtu"), Error::Usage(_)));
    assert!(matches!(
        wrong(ExportSettings { range: Some([2.0, 1.0]), ..Default::default() }, "o.vtu"),
        Error::Usage(_)
    ));
    assert!(matches!(wrong(ExportSettings::default(), "o.vtk"), Error::Usage(_)));
}

/// Of a volume that is turned, the tetrahedra whose bounding box in the world touches a box of the
/// world, and no others.
#[test]
fn a_box_of_the_world_is_one_in_a_turned_volume_too() {
    let dir = tempfile::tempdir().unwrap();
    let (npy, input) = (dir.path().join("w.npy"), dir.path().join("w.nrrd"));
    let (archive, out) = (dir.path().join("w.isospan"), dir.path().join("o.vtu"));
    write_npy(&npy, [24, 24, 24], waves);
    let samples = fs::read(&npy).unwrap();
    let head = "NRRD0004\ntype: float\ndimension: 3\nsizes: 24 24 24\nencoding: raw\nendian: little\nspace dimension: 3\n\
        space directions: (1.2,0.9,0) (-0.6,0.8,0) (0,0.5,2)\nspace origin: (-5,7,1)\n\n";
    fs::write(&input, [head.as_bytes(), &samples[samples.len() - 4 * 24 * 24 * 24..]].concat()).unwrap();
    reduce(&input, &settings(SetKind::Halton, Amount::Fraction(0.5), 1_000), &archive, 2);
    let (_, whole) = export(&archive, ExportSettings::default(), &out);
    let [lo, hi] = [[0.0, 18.0, 20.0], [6.0, 26.0, 30.0]];
    let region =
        ExportSettings { roi: Some("world:0:6,18:26,20:30".parse().unwrap()), ..ExportSettings::default() };
    let (report, some) = export(&archive, region, &out);
    let touches = |t: &&[usize; 4]| {
        (0..3).all(|a| {
            t.iter().any(|&v| whole.points[v][a] >= lo[a]) && t.iter().any(|&v| whole.points[v][a] <= hi[a])
        })
    };
    let wanted = whole.tets.iter().filter(touches).count();
    assert!(wanted > 500 && wanted < whole.tets.len() / 4, "{wanted} of {}", whole.tets.len());
    assert_eq!(report.tetrahedra, wanted as u64);
    let corners = |vtu: &Vtu, t: &[usize; 4]| t.map(|v| vtu.points[v]);
    let kept: Vec<_> = some.tets.iter().map(|t| corners(&some, t)).collect();
    let right: Vec<_> = whole.tets.iter().filter(touches).map(|t| corners(&whole, t)).collect();
    assert!(kept == right);
}

fn probe(archive: &Path, dims: [u64; 3], settings: &ProbeSettings, out: &Path) -> (ProbeReport, Vec<f32>) {
    let format = SampleFormat::from_path(out).unwrap();
    let report = Archive::open(archive).unwrap().write_samples(dims, settings, out, format, &Silent).unwrap();
    let VolumeSource::Random(reader) = open_volume(out, &OpenOptions::default()).unwrap() else {
        panic!("a file of raw samples is mapped")
    };
    assert_eq!(reader.info().dims, dims);
    let whole = IndexBox::whole(dims);
    let mut values = vec![0.0; whole.len()];
    reader.read_box(whole, &mut values).unwrap();
    (report, values)
}

#[test]
fn a_linear_field_comes_back_at_every_sample() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("l.npy");
    let dims = [25, 19, 22];
    write_npy(&input, dims, linear);
    for kind in SetKind::ALL {
        let archive = dir.path().join(format!("{kind}.isospan"));
        reduce(&input, &settings(kind, Amount::Fraction(0.2), 1_000), &archive, 2);
        for grid in [dims.map(|d| d as u64), [49, 37, 43], [7, 100, 3]] {
            let (report, values) =
                probe(&archive, grid, &ProbeSettings::default(), &dir.path().join("l.vti"));
            assert_eq!((report.samples, report.void), (grid.iter().product(), 0));
            let unit = |i: u64, n: u64| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
            for (i, &v) in (0u64..).zip(&values) {
                let [x, y, z] = [i % grid[0], i / grid[0] % grid[1], i / grid[0] / grid[1]];
                let wanted = linear(unit(x, grid[0]), unit(y, grid[1]), unit(z, grid[2]));
                assert!((f64::from(v) - wanted).abs() < 3e-6, "{kind}: {v}, not {wanted}, at {x} {y} {z}");
            }
        }
    }
}

#[test]
fn chunks_threads_and_memory_do_not_show_in_samples() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("w.npy");
    write_npy(&input, [40, 30, 24], waves);
    let mut files = vec![];
    for (chunk_points, threads, memory) in [(700, 2, 1 << 30), (700, 1, 60 << 20), (250_000, 2, 1 << 30)] {
        let archive = dir.path().join(format!("{chunk_points}.isospan"));
        if !archive.exists() {
            reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(0.25), chunk_points), &archive, 2);
        }
        let out = dir.path().join("w.npy.out.npy");
        let settings = ProbeSettings {
            resources: Resources::default().with_threads(threads).with_memory(memory),
            level: None,
        };
        let (report, values) = probe(&archive, [61, 31, 47], &settings, &out);
        assert_eq!(report.samples, 61 * 31 * 47);
        assert!(values.iter().all(|v| v.is_finite()));
        files.push(fs::read(&out).unwrap());
    }
    assert!(files[0] == files[1] && files[0] == files[2]);
}

#[test]
fn where_the_source_has_no_data_there_is_no_number() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("h.npy");
    write_npy(&input, [24, 24, 24], |x, y, z| if x * x + y * y + z * z < 0.1 { f64::NAN } else { x });
    let archive = dir.path().join("h.isospan");
    let settings = pipeline::ReduceSettings {
        nan: pipeline::NanPolicy::Mask,
        ..settings(SetKind::Regular, Amount::Fraction(1.0), 3_000)
    };
    reduce(&input, &settings, &archive, 2);
    let (report, values) = probe(&archive, [24; 3], &ProbeSettings::default(), &dir.path().join("h.vti"));
    assert_eq!(report.void, values.iter().filter(|v| v.is_nan()).count() as u64);
    assert!(report.void > 100 && values[0] == -1.0 && values[12 * 24 * 24 + 12 * 24 + 12].is_nan());
    let (exported, vtu) = export(&archive, ExportSettings::default(), &dir.path().join("h.vtu"));
    assert!(exported.void_tetrahedra > 100 && vtu.values.iter().all(|v| v.is_finite()));
    assert_eq!(exported.void_tetrahedra + exported.tetrahedra, exported.archive_tetrahedra);
}

#[test]
fn points_get_the_values_of_samples_and_a_table_keeps_its_columns() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("w.npy");
    write_npy(&input, [30, 26, 28], waves);
    let path = dir.path().join("w.isospan");
    reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(0.5), 1_500), &path, 2);
    let archive = Archive::open(&path).unwrap();
    let dims = [30, 26, 28];
    let samples = archive.sample(dims).unwrap();
    let mut points: Vec<[f64; 3]> =
        (0..samples.len() as u64).map(|i| [i % 30, i / 30 % 26, i / 30 / 26].map(|x| x as f64)).collect();
    let probed = archive.probe(&points).unwrap();
    assert!(samples.iter().zip(&probed).all(|(a, b)| a.to_bits() == b.to_bits()), "the same rule for ties");
    // In another order, one at a time, and outside.
    for i in [0usize, 1, 777, 12_345, points.len() - 1] {
        assert_eq!(archive.probe(&points[i..=i]).unwrap()[0].to_bits(), samples[i].to_bits(), "{i}");
    }
    assert!(
        archive
            .probe(&[[-0.01, 3.0, 3.0], [f64::NAN; 3], [29.0, 25.0, 27.1]])
            .unwrap()
            .iter()
            .all(|v| v.is_nan())
    );
    assert_eq!(archive.probe(&[]).unwrap(), Vec::<f64>::new());

    points.reverse();
    points.push([99.0, 0.0, 0.0]);
    let table: String =
        points.iter().enumerate().map(|(n, p)| format!("{n},{},{},{}\n", p[0], p[1], p[2])).collect();
    fs::write(dir.path().join("p.csv"), format!("n,x,y,z\n{table}")).unwrap();
    let mut outputs = vec![];
    // With the least memory, points come in many batches.
    for memory in [1 << 30, 24 << 20] {
        let out = dir.path().join("q.csv");
        let settings = ProbeSettings { resources: Resources::default().with_memory(memory), level: None };
        let report = archive.write_probed(&dir.path().join("p.csv"), &settings, &out, &Silent).unwrap();
        assert_eq!((report.samples, report.outside, report.void), (points.len() as u64, 1, 0));
        outputs.push(fs::read_to_string(&out).unwrap());
    }
    assert!(outputs[0] == outputs[1]);
    let mut lines = outputs[0].lines();
    assert!(lines.next().unwrap().starts_with("n,x,y,z,"));
    for (line, wanted) in lines.clone().zip(samples.iter().rev()) {
        assert_eq!(line.rsplit(',').next().unwrap().parse::<f32>().unwrap(), *wanted as f32);
    }
    assert!(lines.next_back().unwrap().ends_with(",99,0,0,nan"));
    let out = dir.path().join("q.npy");
    archive.write_probed(&dir.path().join("p.csv"), &ProbeSettings::default(), &out, &Silent).unwrap();
    let bytes = fs::read(&out).unwrap();
    let values = &bytes[bytes.len() - 4 * points.len()..];
    assert_eq!(values[..4], (samples[samples.len() - 1] as f32).to_le_bytes());
}

#[test]
fn the_library_answers_as_the_program_does() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("w.npy");
    write_npy(&input, [30, 26, 28], waves);
    let path = dir.path().join("w.isospan");
    reduce(&input, &settings(SetKind::Halton, Amount::Fraction(0.5), 1_500), &path, 2);
    let archive = Archive::open(&path).unwrap();
    let file = dir.path().join("s.ply");
    surface(&path, 0.25, &file, 2);
    assert!(read(&file) == archive.surface(0.25).unwrap());
    let mut volume = 0.0;
    let mut active = 0;
    for chunk in archive.active(0.25).unwrap() {
        let chunk = chunk.unwrap();
        for tet in &chunk.tetrahedra {
            let [a, b, c, d] = tet.map(|v| chunk.points[v as usize]);
            let [u, v, w]: [[f64; 3]; 3] = [b, c, d].map(|p| std::array::from_fn(|k| p[k] - a[k]));
            let minor = |i: usize, j: usize| v[i] * w[j] - v[j] * w[i];
            let six = u[0] * minor(1, 2) + u[1] * minor(2, 0) + u[2] * minor(0, 1);
            assert!(six > 0.0);
            volume += six / 6.0;
            let values = tet.map(|v| chunk.values[v as usize]);
            active += u64::from(values.iter().any(|&v| v < 0.25) && values.iter().any(|&v| v >= 0.25));
        }
    }
    assert!(volume > 0.0 && volume < 29.0 * 25.0 * 27.0);
    assert_eq!(active, archive.count(0.25).unwrap().active_cells);
    assert!(matches!(archive.surface(f32::NAN), Err(Error::Usage(_))));
    assert_eq!(archive.check().unwrap().tetrahedra, archive.info().unwrap().tetrahedra);
}
