use super::cut::{CELL, HALF, Place, tests::open_edges};
use super::*;
use crate::files::labels::LabelStyle;
use crate::files::surface::tests::{far_tetrahedron, source};
use crate::files::surface::{SurfaceFormat, SurfacePart, stream_surface, write_surface};
use crate::surface::weld::BuilderSettings;
use crate::surface::{Joined, TriMesh};
use draco_core::{DecoderBuffer, Mesh, MeshDecoder, PointIndex};
use isospan_io::bytes::read_whole as read;
use isospan_io::volume::units::{Unit, Units};
use std::collections::BTreeMap;

fn near() -> TriMesh {
    TriMesh { origin: [0.0; 3], ..far_tetrahedron() }
}

fn micrometres() -> SurfaceMeta {
    SurfaceMeta { units: Units::of_length(Unit::length("um")), ..SurfaceMeta::default() }
}

/// A torus of 2 n² triangles.
fn torus(n: u32) -> TriMesh {
    let angle = |i: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
    let vertex = |i: u32| {
        let [(s, c), (t, d)] = [angle(i / n), angle(i % n)].map(f64::sin_cos);
        let position = [(20.0 + 8.0 * d) * c, (20.0 + 8.0 * d) * s, 5.0 + 8.0 * t].map(|x| x as f32);
        Vertex { position, normal: [(d * c) as f32, (d * s) as f32, t as f32] }
    };
    let at = |i: u32, j: u32| (i % n) * n + j % n;
    let pair = |i: u32, j: u32| {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    let triangles = (0..n).flat_map(|i| (0..n).flat_map(move |j| pair(i, j))).collect();
    TriMesh { vertices: (0..n * n).map(vertex).collect(), triangles, origin: [0.0; 3] }
}

/// A level of detail as its files have it.
struct Read {
    scale: f32,
    /// The triangles of each cell, in steps from its corner; none of a cell without bytes.
    cells: BTreeMap<[u32; 3], Vec<[[u32; 3]; 3]>>,
}

impl Read {
    /// All triangles, in steps from the origin.
    fn triangles(&self) -> Vec<[Place; 3]> {
        let of_cell = |(at, triangles): (&[u32; 3], &Vec<[[u32; 3]; 3]>)| -> Vec<[Place; 3]> {
            let place =
                |corner: [u32; 3]| std::array::from_fn(|k| i64::from(at[k]) * CELL + i64::from(corner[k]));
            triangles.iter().map(|t| t.map(place)).collect()
        };
        self.cells.iter().flat_map(of_cell).collect()
    }
}

/// What is before the end of the manifest of a segment, and where that begins.
fn found_in_shard(folder: &Path, segment: u64) -> (Vec<u8>, usize) {
    let mut data = read(&folder.join(shard::NAME), 1 << 30).unwrap();
    let word = |at: usize| u64::from_le_bytes(data[at..at + 8].try_into().unwrap());
    // There is one minishard.
    let [start, end] = [0, 8].map(|at| 16 + word(at) as usize);
    let (count, mut at, mut number) = ((end - start) / 24, 16, 0);
    for n in 0..count {
        let [more, skipped, bytes] = [0, 1, 2].map(|row| word(start + 8 * (row * count + n)));
        number += more;
        at += skipped as usize;
        if number == segment {
            data.truncate(at + bytes as usize);
            return (data, at);
        }
        at += bytes as usize;
    }
    panic!("no segment {segment}");
}

/// What the files of a segment say: the edge of a cell, the origin, the levels.
fn read_segment(folder: &Path, segment: u64) -> (f32, [f32; 3], Vec<Read>) {
    let (data, start) = found_in_shard(folder, segment);
    let mut words = data[start..].chunks(4).map(|word| u32::from_le_bytes(word.try_into().unwrap()));
    let mut next = |count: usize| words.by_ref().take(count).collect::<Vec<u32>>();
    let floats = |words: Vec<u32>| words.into_iter().map(f32::from_bits).collect::<Vec<f32>>();
    let (edge, origin, levels) = (floats(next(3))[0], floats(next(3)), next(1)[0] as usize);
    let (scales, moved) = (floats(next(levels)), floats(next(3 * levels)));
    assert!(moved.iter().all(|x| *x == 0.0));
    let counts = next(levels);
    let cells: Vec<_> = counts.into_iter().map(|n| (next(3 * n as usize), next(n as usize))).collect();
    assert_eq!(words.next(), None);
    // Fragments lie before their manifest.
    let mut at = start - cells.iter().flat_map(|(_, bytes)| bytes).sum::<u32>() as usize;
    let mut levels = vec![];
    for (scale, (places, bytes)) in scales.into_iter().zip(cells) {
        let mut cells = BTreeMap::new();
        for (n, &size) in bytes.iter().enumerate() {
            let place = [0, 1, 2].map(|k| places[k * bytes.len() + n]);
            let here = &data[at..at + size as usize];
            at += here.len();
            let triangles = if here.is_empty() { vec![] } else { decoded(here) };
            assert!(cells.insert(place, triangles).is_none());
        }
        levels.push(Read { scale, cells });
    }
    (edge, origin.try_into().unwrap(), levels)
}

fn decoded(bytes: &[u8]) -> Vec<[[u32; 3]; 3]> {
    let mut mesh = Mesh::new();
    MeshDecoder::new().decode(&mut DecoderBuffer::new(bytes), &mut mesh).unwrap();
    let positions = mesh.attribute(0);
    let corner = |point: PointIndex| -> [u32; 3] {
        let at = positions.mapped_index(point).0 as usize * 12;
        let data = &positions.buffer().data()[at..at + 12];
        std::array::from_fn(|k| u32::from_le_bytes(data[4 * k..4 * k + 4].try_into().unwrap()))
    };
    mesh.faces().iter().map(|face| face.map(corner)).collect()
}

fn area_of(mesh: &TriMesh) -> f64 {
    crate::surface::check::check(mesh).area
}

fn area(triangles: &[[Place; 3]], step: f64) -> f64 {
    let one = |t: &[Place; 3]| {
        let [u, v] = [1, 2].map(|n| std::array::from_fn(|k| (t[n][k] - t[0][k]) as f64 * step));
        let n = isospan_io::geom::vec3::cross(u, v);
        isospan_io::geom::vec3::dot(n, n).sqrt() / 2.0
    };
    triangles.iter().map(one).sum()
}

fn write(mesh: &dyn SurfaceSource, path: &Path, meta: &SurfaceMeta, resources: &Resources) -> Result<u64> {
    write_surface(mesh, path, SurfaceFormat::Neuroglancer, meta, resources)
}

#[test]
fn each_label_is_a_segment_in_nanometres() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.precomputed");
    let (a, none, b) = (source(near()), source(TriMesh::default()), source(near()));
    let joined = Joined::new(vec![&a, &none, &b]);
    let part = |label: f64, name: &str, n: u64| {
        let label_style = LabelStyle { name: name.into(), colour: [0; 4] };
        SurfacePart { isovalue: label, vertices: n, triangles: n, label: Some(label_style) }
    };
    let parts = vec![part(3.0, "Left \"A\"", 4), part(5.0, "none", 0), part(7.0, "", 4)];
    let meta = SurfaceMeta { parts, ..micrometres() };
    // A second time, in the place of the first.
    for _ in 0..2 {
        let bytes = write(&joined, &path, &meta, &Resources::default()).unwrap();
        let text = |name: &str| fs::read_to_string(path.join(name)).unwrap();
        let json = |name: &str| serde_json::from_str::<serde_json::Value>(&text(name)).unwrap();
        let info = json("info");
        assert_eq!((&info["@type"], &info["vertex_quantization_bits"]), (&json!(KIND), &json!(16)));
        let rows = [1e3, 0.0, 0.0, 0.0, 0.0, 1e3, 0.0, 0.0, 0.0, 0.0, 1e3, 0.0];
        assert_eq!(info["transform"], json!(rows));
        let names = json("segment_properties/info");
        assert_eq!(names["inline"]["ids"], json!(["3", "7"]));
        assert_eq!(names["inline"]["properties"][0]["values"], json!(["Left \"A\"", "label 7"]));
        for segment in [3, 7] {
            let (edge, origin, levels) = read_segment(&path, segment);
            let [only] = &levels[..] else { panic!("{} levels", levels.len()) };
            let step = f64::from(edge) / CELL as f64;
            let mut found: Vec<[Place; 3]> = only.triangles();
            let place = |v: u32| {
                let p = near().vertices[v as usize].position;
                std::array::from_fn(|k| ((f64::from(p[k]) - f64::from(origin[k])) / step).round() as i64)
            };
            let mut right: Vec<[Place; 3]> = near().triangles.iter().map(|t| t.map(place)).collect();
            let first_least = |t: &mut [Place; 3]| {
                let least = (0..3).min_by_key(|&n| t[n]).unwrap();
                t.rotate_left(least);
            };
            found.iter_mut().chain(&mut right).for_each(first_least);
            found.sort_unstable();
            right.sort_unstable();
            assert_eq!(found, right);
        }
        let all = ["info", "segment_properties/info", "0.shard"];
        let sizes: u64 = all.map(|name| fs::metadata(path.join(name)).unwrap().len()).iter().sum();
        assert_eq!((bytes, fs::read_dir(&path).unwrap().count()), (sizes, 3));
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    // What somebody keeps beside the meshes is not lost.
    fs::write(path.join("photo.jpg"), "mine").unwrap();
    let error = write(&joined, &path, &meta, &Resources::default()).unwrap_err();
    assert!(error.to_string().contains("meshes alone"), "{error}");
    assert_eq!(fs::read_dir(&path).unwrap().count(), 4);
}

#[test]
fn levels_are_closed_and_lie_in_their_cells() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.precomputed");
    let mesh = torus(300);
    write(&source(mesh.clone()), &path, &micrometres(), &Resources::default()).unwrap();
    let (edge, origin, levels) = read_segment(&path, 1);
    assert!(levels.len() > 3 && levels[0].cells.len() > 8, "{} {}", levels.len(), levels[0].cells.len());
    let exact = 4.0 * std::f64::consts::PI.powi(2) * 20.0 * 8.0;
    for (k, level) in levels.iter().enumerate() {
        let triangles = level.triangles();
        assert_eq!(open_edges(&triangles), 0, "level {k}");
        let step = f64::from(edge) * f64::from(1u32 << k) / CELL as f64;
        let off = area(&triangles, step) / exact - 1.0;
        assert!(off.abs() < 0.01, "level {k} of {} triangles: area {off}", triangles.len());
        for (at, triangles) in &level.cells {
            for corner in triangles.iter().flatten().flatten() {
                assert!(i64::from(*corner) <= CELL);
            }
            // Finer cells are where triangles are, and each lies in a coarser one.
            let parent = at.map(|x| x / 2);
            assert!(levels.get(k + 1).is_none_or(|coarser| coarser.cells.contains_key(&parent)));
            for t in triangles.iter().filter(|_| k > 0) {
                let child = std::array::from_fn(|axis| {
                    let x = t.map(|corner| i64::from(corner[axis]));
                    let is_upper = x.iter().any(|x| *x > HALF);
                    assert!(!is_upper || x.iter().all(|x| *x >= HALF), "{t:?} is in two octants");
                    2 * at[axis] + u32::from(is_upper)
                });
                assert!(levels[k - 1].cells.contains_key(&child));
            }
        }
        if k > 0 {
            let share = triangles.len() as f64 / levels[k - 1].triangles().len() as f64;
            assert!((0.15..0.6).contains(&share) && level.scale > levels[k - 1].scale, "{k} {share}");
        }
    }
    assert!(levels.last().unwrap().cells.len() == 1);
    // The finest level has each vertex, to half a step.
    let step = f64::from(edge) / CELL as f64;
    let found: std::collections::HashSet<Place> = levels[0].triangles().into_iter().flatten().collect();
    for vertex in &mesh.vertices {
        let at = |k: usize| (f64::from(vertex.position[k]) - f64::from(origin[k])) / step;
        assert!(found.contains(&std::array::from_fn(|k| at(k).round() as i64)), "{vertex:?}");
    }
}

#[test]
fn threads_and_memory_do_not_show() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = source(torus(110));
    let bytes = |name: &str, resources: Resources| {
        let path = dir.path().join(name).with_extension("precomputed");
        write(&mesh, &path, &micrometres(), &resources).unwrap();
        fs::read(path.join(shard::NAME)).unwrap()
    };
    let one = bytes("one", Resources::default().with_threads(1));
    assert_eq!(one, bytes("four", Resources::default().with_threads(4)));
    assert_eq!(one, bytes("little", Resources::default().with_memory(100 << 20)));
    let path = dir.path().join("none.precomputed");
    let little = Resources::default().with_memory(1 << 20);
    let error = write(&mesh, &path, &micrometres(), &little).unwrap_err();
    let Error::Budget { needed, available, .. } = error else { panic!("{error}") };
    assert_eq!(available, 1 << 20);
    // What it says suffices.
    write(&mesh, &path, &micrometres(), &Resources::default().with_memory(needed)).unwrap();
    fs::remove_dir_all(&path).unwrap();
    let stopped = Resources::default();
    stopped.cancel.cancel();
    assert_eq!(write(&mesh, &path, &micrometres(), &stopped).unwrap_err().exit_code(), 75);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 3);
}

#[test]
fn a_surface_far_from_0_is_placed_by_the_transform() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("far.precomputed");
    write(&source(far_tetrahedron()), &path, &micrometres(), &Resources::default()).unwrap();
    let info: serde_json::Value = serde_json::from_slice(&fs::read(path.join("info")).unwrap()).unwrap();
    let placed = [3, 7, 11].map(|n| info["transform"][n].as_f64().unwrap());
    assert_eq!(placed, far_tetrahedron().origin.map(|x| x * 1e3));
    let (_, origin, _) = read_segment(&path, 1);
    assert!(origin.iter().all(|x| x.abs() < 10.0), "{origin:?}");
}

#[test]
fn what_has_no_triangles_is_an_empty_folder() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("none.precomputed");
    write(&source(TriMesh::default()), &path, &micrometres(), &Resources::default()).unwrap();
    assert_eq!(fs::read_dir(&path).unwrap().count(), 3);
    // Triangles that are points leave no mesh, and no segment.
    let point =
        TriMesh { vertices: vec![near().vertices[0]; 3], triangles: vec![[0, 1, 2]], origin: [0.0; 3] };
    let joined = (source(point), source(near()));
    let part = |isovalue: f64, vertices: u64, triangles: u64| SurfacePart {
        isovalue,
        vertices,
        triangles,
        label: None,
    };
    let meta = SurfaceMeta { parts: vec![part(0.5, 3, 1), part(0.7, 4, 4)], ..micrometres() };
    write(&Joined::new(vec![&joined.0, &joined.1]), &path, &meta, &Resources::default()).unwrap();
    let names: serde_json::Value =
        serde_json::from_slice(&fs::read(path.join("segment_properties/info")).unwrap()).unwrap();
    assert_eq!(names["inline"]["ids"], json!(["2"]));
    assert_eq!(read_segment(&path, 2).2[0].triangles().len(), 4);
}

/// A mesh of several copies of another one, each scaled and moved.
fn copies(of: &TriMesh, places: impl IntoIterator<Item = (f32, [f32; 3])>) -> TriMesh {
    let mut all = TriMesh::default();
    for (scale, place) in places {
        let first = all.vertices.len() as u32;
        let moved = |v: &Vertex| Vertex {
            position: std::array::from_fn(|k| place[k] + scale * v.position[k]),
            normal: v.normal,
        };
        all.vertices.extend(of.vertices.iter().map(moved));
        all.triangles.extend(of.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    all
}

#[test]
fn small_pieces_far_apart_are_there() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.precomputed");
    // Rings of about 1/40 000 of the domain.
    let places = (0..64)
        .map(|n| (0.025 / 40.0, [(n % 4) as f32, (n / 4 % 4) as f32, (n / 16) as f32].map(|x| 330.0 * x)));
    let mesh = copies(&torus(10), places);
    write(&source(mesh.clone()), &path, &micrometres(), &Resources::default()).unwrap();
    let (edge, _, levels) = read_segment(&path, 1);
    let found = levels[0].triangles();
    assert_eq!((found.len(), open_edges(&found)), (mesh.triangles.len(), 0));
    let step = f64::from(edge) / CELL as f64;
    let exact = 64.0 * area_of(&torus(10)) * (0.025 / 40.0f64).powi(2);
    let off = area(&found, step) / exact - 1.0;
    assert!(off.abs() < 0.05, "{off} of a step of {step}");
}

#[test]
fn a_dense_spot_does_not_cut_what_is_large() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.precomputed");
    // A ring of 80 000 triangles within 1/3000 of a ring of 200.
    let mut mesh = copies(&torus(200), [(1.0 / 3000.0, [0.0; 3])]);
    let large = copies(&torus(10), [(1.0, [0.0; 3])]);
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend(&large.vertices);
    mesh.triangles.extend(large.triangles.iter().map(|t| t.map(|v| v + first)));
    write(&source(mesh.clone()), &path, &micrometres(), &Resources::default()).unwrap();
    let (_, _, levels) = read_segment(&path, 1);
    let found = levels[0].triangles();
    assert_eq!(open_edges(&found), 0);
    let (most, cells) = (2 * mesh.triangles.len(), levels[0].cells.len());
    assert!(found.len() < most && cells < 5000, "{} triangles in {cells} cells", found.len());
}

#[test]
fn what_lies_on_disk_does_not_show() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = torus(60);
    let bytes = |held: usize| {
        let means = WriterMeans {
            memory: 64 << 20,
            held,
            scratch: dir.path().to_path_buf(),
            pool: pool(2).unwrap(),
            cancel: Resources::default().cancel,
            target: dir.path(),
        };
        let mut surface = StoredSurface::new(&means.store());
        mesh.vertices.iter().for_each(|v| surface.push_vertex(*v).unwrap());
        mesh.triangles.iter().for_each(|t| surface.push_triangle(*t).unwrap());
        let mut out = vec![];
        let mut put = |fragment: &[u8]| {
            out.extend_from_slice(fragment);
            Ok(())
        };
        let manifest = write_levels(surface, &means, &mut put).unwrap().unwrap();
        [out, manifest]
    };
    // A vertex has 24 bytes, a piece of a triangle 26: nearly all are on disk.
    assert_eq!(bytes(1 << 10), bytes(16 << 20));
}

#[test]
fn what_neuroglancer_does_not_have_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.precomputed");
    let refused = |mesh: TriMesh, meta: &SurfaceMeta, says: &str| {
        let error = write(&source(mesh), &path, meta, &Resources::default()).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains(says), "{error}");
    };
    refused(near(), &SurfaceMeta::default(), "the unit of length of this archive is not known");
    let parsecs = SurfaceMeta { units: Units::of_length(Unit::new("pc")), ..SurfaceMeta::default() };
    refused(near(), &parsecs, "'pc'");
    let label = Some(LabelStyle { name: String::new(), colour: [0; 4] });
    for number in [-2.0, 0.0] {
        let parts = vec![SurfacePart { isovalue: number, vertices: 4, triangles: 4, label: label.clone() }];
        refused(near(), &SurfaceMeta { parts, ..micrometres() }, &format!("the label {number}"));
    }
    fs::create_dir(&path).unwrap();
    refused(near(), &micrometres(), "not a folder of neuroglancer's meshes alone");
    let scratch = BuilderSettings::default();
    let mut none = |_: &[u8]| Ok(());
    let near = source(near());
    let error = stream_surface(&near, SurfaceFormat::Neuroglancer, &micrometres(), &scratch, &mut none);
    assert!(error.unwrap_err().to_string().contains("a folder"));
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}
