//! Several isovalues at once, and boxes: the answers are those of one question at a time, and of
//! the whole, cut.

use crate::common::*;
use isospan::grid::Geometry;
use isospan::pipeline::{Amount, NanPolicy, ReduceSettings, Roi, SurfaceReport};
use isospan::points::SetKind;
use isospan::surface::TriMesh;
use isospan::surface::check::{
    CheckSettings, Domain, OpenEdges, boundary_edges, boundary_outside, check, check_within,
};
use isospan::{Archive, Resources};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

const DIMS: [usize; 3] = [48, 33, 40];

fn archive(dir: &Path, kind: SetKind) -> PathBuf {
    let input = dir.join("waves.npy");
    write_npy(&input, DIMS, waves);
    let out = dir.join("waves.isospan");
    reduce(&input, &settings(kind, Amount::Fraction(0.25), 4_000), &out, 2);
    out
}

#[test]
fn several_isovalues_give_the_bytes_of_each_alone() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), SetKind::Hammersley);
    let isovalues = [0.9, -0.7, 1e9, 0.0];
    for extension in ["ply", "stl", "obj", "vtp", "vtkhdf"] {
        let query = query(&archive, isovalues).resources(Resources::default().with_threads(2));
        let report = query.write(dir.path().join(format!("all_{{}}.{extension}"))).unwrap();
        let mut single = SurfaceReport::default();
        for (one, isovalue) in report.surfaces.iter().zip(isovalues) {
            assert_eq!(one.file, dir.path().join(format!("all_{isovalue}.{extension}")));
            let alone = dir.path().join(format!("alone.{extension}"));
            single = surface(&archive, isovalue, &alone, 1);
            assert!(fs::read(&one.file).unwrap() == fs::read(&alone).unwrap(), "{extension} {isovalue}");
            assert_eq!((one.triangles, one.vertices), (single.triangles, single.vertices));
            assert_eq!(one.active_cells, single.active_cells);
            assert_eq!(one.outside_range, isovalue > 10.0);
        }
        assert!(report.active_bytes > 0 && report.active_bytes <= report.bytes_read, "{report:?}");
        // Each block once: fewer bytes than for one isovalue after the other.
        assert!(report.bytes_read < 3 * single.bytes_read, "{} {}", report.bytes_read, single.bytes_read);
    }
}

#[test]
fn parts_of_surfaces_put_together_are_the_surfaces() {
    for kind in [SetKind::Regular, SetKind::Halton] {
        let dir = tempfile::tempdir().unwrap();
        let archive = Archive::open(archive(dir.path(), kind)).unwrap();
        for threads in [1, 2] {
            let resources = Resources::default().with_threads(threads);
            let all = archive.query([0.9, 1e9, 0.0]).resources(resources);
            let (found, parts) = streamed(&all);
            assert!(found == all.meshes().unwrap(), "{kind:?}, {threads} threads");
            assert!(parts > 4 && found[1] == TriMesh::default(), "{parts} parts");
            let region: Roi = "5:30,:,2.5:20".parse().unwrap();
            for query in [all.clone().region(region), all.cap(true)] {
                let (found, parts) = streamed(&query);
                assert!(found == query.meshes().unwrap());
                assert!(parts > 4, "{parts} parts, those of a preview too");
            }
        }
        // An error of whoever takes the parts ends it.
        let mut refuse = |_: &isospan::pipeline::StreamedPart<'_>| Err(isospan::Error::Cancelled);
        let ended = archive.query(0.0).stream(&mut refuse);
        assert!(matches!(ended, Err(isospan::Error::Cancelled)));
    }
}

/// Of a chunk that a surface touches but its header is read, and pages of what its blocks have.
#[test]
fn a_surface_reads_at_most_twice_the_bytes_of_its_blocks() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.npy");
    write_npy(&input, DIMS, ball);
    let archive = dir.path().join("ball.isospan");
    reduce(&input, &settings(SetKind::Halton, Amount::Count(60_000), 8_000), &archive, 2);
    let mut asked = 0;
    for isovalue in [0.45f32, 0.4, 0.3, 0.2, 0.0, -0.3, -0.8, -1.5, -2.2] {
        let report = surface(&archive, isovalue, &dir.path().join("ball.ply"), 1);
        if report.active_blocks >= 64 {
            asked += 1;
            assert!(report.bytes_read <= 2 * report.active_bytes, "{isovalue}: {report:?}");
        }
    }
    assert!(asked > 3, "{asked}");
}

#[test]
fn several_isovalues_in_one_file_follow_each_other() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), SetKind::Halton);
    let isovalues = [0.9, -0.7, 0.0];
    for extension in ["ply", "obj", "vtp", "vtkhdf"] {
        let all = dir.path().join(format!("all.{extension}"));
        query(&archive, isovalues).write(&all).unwrap();
        let (joined, mut expected) = (read(&all), TriMesh::default());
        for isovalue in isovalues {
            let alone = dir.path().join(format!("one.{extension}"));
            surface(&archive, isovalue, &alone, 1);
            let (mesh, first) = (read(&alone), expected.vertices.len() as u32);
            expected.triangles.extend(mesh.triangles.iter().map(|t| t.map(|v| v + first)));
            expected.vertices.extend(mesh.vertices);
        }
        assert!(joined == expected, "{extension}");
        let text = String::from_utf8_lossy(&fs::read(&all).unwrap()).into_owned();
        let named = match extension {
            "obj" => "\ng isovalue_-0.7",
            "ply" => "property float isovalue\n",
            "vtkhdf" => "Scalars",
            _ => "Scalars=\"isovalue\"",
        };
        assert!(text.contains(named) && text.contains("isovalue 0.9 -0.7"), "{extension}");
    }
    for isovalues in [vec![], vec![1.0, 2.0, 1.0], vec![1.0, f64::NAN], vec![1e300]] {
        let out = dir.path().join("x.ply");
        let error = query(&archive, isovalues).write(&out);
        assert_eq!(error.unwrap_err().exit_code(), 2);
        assert!(!out.exists());
    }
}

/// Boundary edges that lie neither on a face of the box (in index space) nor on one of the domain.
fn open_elsewhere(mesh: &TriMesh, lo: [f64; 3], hi: [f64; 3]) -> usize {
    let faces = |v: u32| {
        let p = mesh.vertices[v as usize].position.map(f64::from);
        (0..3).fold(0u8, |faces, a| {
            let near = |x: f64| u8::from((p[a] - x).abs() < 1e-4);
            faces | near(lo[a].max(0.0)) << (2 * a) | near(hi[a].min((DIMS[a] - 1) as f64)) << (2 * a + 1)
        })
    };
    boundary_edges(mesh).iter().filter(|[a, b]| faces(*a) & faces(*b) == 0).count()
}

#[test]
fn a_box_cuts_every_surface_exactly_at_its_faces() {
    let dir = tempfile::tempdir().unwrap();
    for kind in SetKind::ALL {
        let archive = archive(dir.path(), kind);
        for roi in ["10:30.5,5:28,7.25:33", "20:21,:,:", ":,-5:16,12:99", "0:47,0:32,0:39"] {
            let roi: Roi = roi.parse().unwrap();
            let file = dir.path().join("roi.ply");
            let report = query(&archive, 0.1).region(roi).write(&file).unwrap();
            let mesh = read(&file);
            let sound = check(&mesh);
            assert!(
                sound.triangles > 100 && sound.is_manifold() && sound.is_oriented(),
                "{kind} {roi:?} {sound:?}"
            );
            assert_eq!((sound.zero_area_triangles, sound.unreferenced_vertices), (0, 0), "{kind} {roi:?}");
            assert_eq!(open_elsewhere(&mesh, roi.lo, roi.hi), 0, "{kind} {roi:?}");
            assert_eq!(report.triangles, sound.triangles);
            let inside = |p: [f32; 3]| {
                (0..3).all(|a| f64::from(p[a]) > roi.lo[a] - 1e-4 && f64::from(p[a]) < roi.hi[a] + 1e-4)
            };
            assert!(mesh.vertices.iter().all(|v| inside(v.position)), "{kind} {roi:?}");
        }
        fs::remove_dir_all(&archive).unwrap();
    }
}

/// A cut does not change what is inside, and the parts on its two sides make the whole.
#[test]
fn boxes_that_touch_make_the_whole() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), SetKind::Hammersley);
    let file = dir.path().join("part.ply");
    let part = |roi: Option<&str>, threads| {
        let region: Option<Roi> = roi.map(|text| text.parse().unwrap());
        let query =
            query(&archive, -0.3).region(region).resources(Resources::default().with_threads(threads));
        (query.write(&file).unwrap(), read(&file))
    };
    let (whole_report, whole) = part(None, 2);
    let area = check(&whole).area;
    let mut sum = 0.0;
    for x in [":19.7", "19.7:"] {
        for z in [":30", "30:"] {
            let (_, mesh) = part(Some(&format!("{x},:,{z}")), 2);
            let (_, again) = part(Some(&format!("world:{x},:,{z}")), 1);
            assert!(mesh == again, "index space is the world here");
            sum += check(&mesh).area;
        }
    }
    assert!((sum / area - 1.0).abs() < 1e-5, "{sum} {area}");
    // Triangles that no plane touches are those of the whole, normals included.
    let (report, mesh) = part(Some("2:12,2:12,2:12"), 2);
    let inner = |p: [f32; 3]| p.iter().all(|&x| x > 2.5 && x < 11.5);
    let inner_triangles = |mesh: &TriMesh| {
        let mut all: Vec<Vec<u32>> = mesh
            .triangles
            .iter()
            .map(|t| t.map(|v| mesh.vertices[v as usize]))
            .filter(|t| t.iter().all(|v| inner(v.position)))
            .map(|t| {
                t.iter().flat_map(|v| v.position.into_iter().chain(v.normal)).map(f32::to_bits).collect()
            })
            .collect();
        all.sort();
        all
    };
    assert!(inner_triangles(&mesh).len() > 20 && inner_triangles(&mesh) == inner_triangles(&whole));
    assert!(report.active_chunks < whole_report.active_chunks, "{report:?}");
    assert!(report.bytes_read < whole_report.bytes_read, "{report:?}");
}

#[test]
fn a_box_in_the_world_goes_through_the_geometry() {
    let dir = tempfile::tempdir().unwrap();
    let npy = dir.path().join("ball.npy");
    write_npy(&npy, [30, 30, 30], ball);
    fs::write(dir.path().join("ball.raw"), &fs::read(&npy).unwrap()[128..]).unwrap();
    let header = "NRRD0004\ntype: float\ndimension: 3\nsizes: 30 30 30\nspace dimension: 3\n\
        space directions: (0,2,0) (1,0,0) (0,0,3)\nspace origin: (100,200,300)\nendian: little\nencoding: raw\n\
        data file: ball.raw\n";
    let nhdr = dir.path().join("ball.nhdr");
    fs::write(&nhdr, header).unwrap();
    let out = dir.path().join("ball.isospan");
    reduce(&nhdr, &settings(SetKind::Halton, Amount::Fraction(1.0), 250_000), &out, 2);
    let cut = |roi: &str| {
        let file = dir.path().join("s.ply");
        query(&out, 0.0).region(roi.parse::<Roi>().unwrap()).write(&file).unwrap();
        read(&file)
    };
    // Index axis 0 is world axis y in steps of 2; 14.5 is the middle.
    let index = cut("14.5:,:,:");
    let world = cut("world::,229:,:");
    let report = check(&index);
    assert!(report.is_manifold() && (report.euler, report.boundary_loops) == (1, 1), "{report:?}");
    assert!(index.vertices.iter().all(|v| v.position[1] > 229.0 - 1e-3));
    assert!((check(&world).area / report.area - 1.0).abs() < 1e-5);
    assert!(boundary_outside(&index, &Geometry::default(), [30; 3], 1e-3) > 20);
    let outside: Roi = "world:0:1,:,:".parse().unwrap();
    let error = query(&out, 0.0).region(outside).write(dir.path().join("x.ply"));
    assert!(error.unwrap_err().to_string().contains("outside the volume"));
}

#[test]
fn what_an_open_archive_keeps_does_not_show() {
    let dir = tempfile::tempdir().unwrap();
    let archive = archive(dir.path(), SetKind::Hammersley);
    let file = dir.path().join("s.ply");
    let roi: Option<Roi> = Some("10:30,5:20.5,8:30".parse().unwrap());
    let asked = [(0.1, false, None), (0.15, true, None), (-0.3, false, roi), (0.1, false, None)];
    let resources = |threads| Resources::default().with_threads(threads);
    let alone = |isovalue: f64, cap, roi: Option<Roi>| {
        query(&archive, isovalue).cap(cap).region(roi).resources(resources(2)).write(&file).unwrap();
        read(&file)
    };
    let each = |(first, cap, roi)| [first, first, 0.4].map(|isovalue| alone(isovalue, cap, roi));
    let alone: Vec<TriMesh> = asked.into_iter().flat_map(each).collect();
    assert!(alone.iter().all(|mesh| mesh.triangles.len() > 100));
    for kept in [0, 300_000, 256 << 20] {
        let open = isospan::Archive::open(&archive).unwrap().keeping(kept);
        let query = |isovalues: &[f64]| open.query(isovalues).resources(resources(2));
        let each = |(first, cap, roi): (f64, bool, Option<Roi>)| {
            [&[first][..], &[first, 0.4]].map(|v| query(v).cap(cap).region(roi).meshes().unwrap())
        };
        let found: Vec<TriMesh> = asked.into_iter().flat_map(each).flatten().collect();
        assert!(found == alone, "{kept} bytes kept");
        assert!(open.kept_bytes() <= kept && (kept == 0 || open.kept_bytes() > kept.min(1 << 20) / 4));
        // What is kept need not be read again.
        let query = open.query(0.1).resources(resources(1));
        let (first, second) = (query.write(&file).unwrap(), query.write(&file).unwrap());
        assert_eq!((first.triangles, first.active_blocks), (second.triangles, second.active_blocks));
        assert_eq!(second.active_bytes == 0, kept > 1 << 20, "{kept}");
        assert!(read(&file) == alone[0]);
    }
}

/// Of values, those of blocks are read in which the surface is, or next to which; no other
/// neighbours of its tetrahedra.
#[test]
fn a_surface_reads_little_that_it_does_not_need() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("far.npy"), dir.path().join("far.isospan"));
    let far = |x: f64, y: f64, z: f64| ((x - 0.7).powi(2) + (y + 0.3).powi(2) + (z - 0.1).powi(2)).sqrt();
    write_npy(&input, [64; 3], far);
    reduce(&input, &settings(SetKind::Hammersley, Amount::Fraction(0.125), 100_000), &out, 2);
    let (file, mut ratios) = (dir.path().join("one.ply"), vec![]);
    let archive = isospan::Archive::open(&out).unwrap();
    for isovalue in (2..20).map(|n| 0.1 * n as f32) {
        let report = surface(&out, isovalue, &file, 1);
        // Of blocks that are kept all values are read.
        assert!(read(&file) == archive.surface(isovalue).unwrap());
        ratios.push(report.bytes_read as f64 / report.active_bytes as f64);
    }
    ratios.sort_by(f64::total_cmp);
    assert!(ratios[ratios.len() / 2] < 1.6 && ratios[ratios.len() - 2] < 2.0, "{ratios:?}");
}

/// A surface ends at samples without data, and is right; with a triangle less it has a hole,
/// wherever that is.
#[test]
fn a_surface_that_ends_at_missing_samples_is_sound() {
    let dir = tempfile::tempdir().unwrap();
    let (input, archive) = (dir.path().join("m.npy"), dir.path().join("m.isospan"));
    let far = |x: f64, y: f64, z: f64| (x - 0.3).powi(2) + y * y + z * z > 0.2;
    write_npy(&input, [34, 30, 28], |x, y, z| if far(x, y, z) { waves(x, y, z) } else { f64::NAN });
    let masked =
        ReduceSettings { nan: NanPolicy::Mask, ..settings(SetKind::Halton, Amount::Fraction(0.5), 3_000) };
    reduce(&input, &masked, &archive, 2);
    let asked = Archive::open(&archive).unwrap();
    let geometry = Geometry::default();
    let domain = Domain { geometry: &geometry, dims: [34, 30, 28], cuts: &[], tolerance: 1e-2 };
    let open = |mesh: &TriMesh| {
        let mut at_missing = |edges: &[[[f64; 3]; 2]]| asked.edges_at_missing(edges);
        check_within(mesh, &domain, &CheckSettings::default(), &mut at_missing).unwrap().1
    };
    let whole = asked.surface(0.3).unwrap();
    let (found, parts) = streamed(&asked.query(0.3));
    assert!(found == [whole.clone()] && parts > 3, "{parts} parts, those of a preview too");
    let found = open(&whole);
    assert!(found.outside == 0 && found.at_missing > 100, "{found:?}");
    // Holes far from the boundary, each of one triangle.
    let rim: BTreeSet<u32> = boundary_edges(&whole).into_iter().flatten().collect();
    let inner: Vec<usize> = (0..whole.triangles.len())
        .filter(|&t| {
            let middle = |v: u32| whole.vertices[v as usize].position;
            let apart = |v: u32| {
                rim.iter().all(|&r| (0..3).map(|a| (middle(v)[a] - middle(r)[a]).powi(2)).sum::<f32>() > 1.0)
            };
            t % 997 == 0 && whole.triangles[t].into_iter().all(apart)
        })
        .take(3)
        .collect();
    assert_eq!(inner.len(), 3);
    for t in inner {
        let mut holed = whole.clone();
        holed.triangles.remove(t);
        assert_eq!(open(&holed), OpenEdges { outside: 3, ..found }, "triangle {t}");
    }
    let out = dir.path().join("m.ply");
    surface(&archive, 0.3, &out, 2);
    let run = std::process::Command::new(env!("CARGO_BIN_EXE_isospan"))
        .args(["check", out.to_str().unwrap(), "--within", archive.to_str().unwrap()])
        .output()
        .unwrap();
    let text = String::from_utf8(run.stdout).unwrap();
    assert!(run.status.success() && text.contains("at missing samples"), "{text}");
}
