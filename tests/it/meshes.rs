//! Reductions of tetrahedral meshes: the reduced domain is the mesh's, and surfaces are those of
//! its field.

use crate::common::{
    self, addition, check_archive, measurement, read, run, surface, triangle_set, write_mesh, write_placed,
};
use isospan::Resources;
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{Amount, NanPolicy, ReduceReport, ReduceSettings, RunSettings, reduce_series};
use isospan::sample::Interpolation;
use isospan::surface::check::{SurfaceCheckReport, check};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn settings(fraction: f64) -> ReduceSettings {
    ReduceSettings { amount: Amount::Fraction(fraction), ..ReduceSettings::default() }
}

fn reduced(input: &Path, settings: &ReduceSettings, out: &str, run: &RunSettings) -> (PathBuf, ReduceReport) {
    let out = input.with_file_name(out);
    let report =
        reduce_series(&[StepSource::new(input, &OpenOptions::default())], settings, &out, run, &Silent)
            .unwrap();
    check_archive(&out).unwrap();
    (out, report)
}

/// An isosurface and what is to be said of it.
fn extracted(archive: &Path, isovalue: f32) -> (isospan::surface::TriMesh, SurfaceCheckReport) {
    let out = archive.with_extension("ply");
    surface(archive, isovalue, &out, 2);
    let mesh = read(&out);
    let report = check(&mesh);
    assert!(report.is_oriented() && report.is_manifold(), "{report:?}");
    (mesh, report)
}

#[test]
fn a_linear_field_on_a_block_gives_its_plane() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("block.vtk");
    write_mesh(&input, 12, |_| true, |p| [2.0 * p[0], p[1], p[2] + 5.0], |p| p[0]);
    for interpolation in [Interpolation::Linear, Interpolation::Quadratic, Interpolation::QuadraticThesis] {
        let settings = ReduceSettings { interpolation, ..settings(0.5) };
        let (archive, report) = reduced(&input, &settings, &format!("{interpolation}.isospan"), &run(2));
        assert_eq!(report.mesh.unwrap().tetrahedra, 6 * 12 * 12 * 12);
        let (mesh, found) = extracted(&archive, 0.7);
        assert!((found.area - 1.0).abs() < 0.01, "{interpolation}: a unit square has {}", found.area);
        assert!(mesh.vertices.iter().all(|p| (p.position[0] - 0.7).abs() < 1e-4), "a plane");
    }
    let cubic = ReduceSettings { interpolation: Interpolation::Cubic, ..settings(0.5) };
    let out = dir.path().join("cubic.isospan");
    let error =
        reduce_series(&[StepSource::new(&input, &OpenOptions::default())], &cubic, &out, &run(1), &Silent)
            .unwrap_err();
    assert_eq!((error.exit_code(), out.exists()), (2, false), "{error}");
}

/// Corners of the box lie beside those of the mesh there, where samples of its boundary
/// clear all other points.
#[test]
fn a_box_of_unequal_sides_is_filled_by_points_of_a_grid() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    write_mesh(&d.join("box.vtk"), 10, |_| true, |p| [1.3 * p[0], 1.1 * p[1], 0.9 * p[2]], |p| p[0]);
    let chunked = ["--chunk-points", "200"];
    let all = [("regular", &[chunked, ["--ratio", "2"], ["--size", "20KiB"]][..]), ("halton", &[chunked])];
    for (points, flags) in all {
        for more in flags {
            let args = ["reduce", "-q", "box.vtk", "-o", "box.isospan", "--force", "--points", points];
            let out = std::process::Command::new(env!("CARGO_BIN_EXE_isospan"))
                .current_dir(d)
                .args(args.iter().chain(more))
                .output()
                .unwrap();
            let errors = String::from_utf8_lossy(&out.stderr).into_owned();
            assert_eq!(out.status.code(), Some(0), "{points} {more:?}: {errors}");
            let archive = d.join("box.isospan");
            check_archive(&archive).unwrap();
            let (mesh, found) = extracted(&archive, 0.7);
            assert!((found.area - 0.99).abs() < 0.05, "{points}: {}", found.area);
            assert!(mesh.vertices.iter().all(|p| (p.position[0] - 0.7).abs() < 0.01), "a plane");
        }
    }
}

/// Area of the section through the cubes that are kept, at a height within the layer `z`.
fn section(n: u32, z: u32, keep: impl Fn([f64; 3]) -> bool) -> f64 {
    let centre = |c: u32| (f64::from(c) + 0.5) / f64::from(n);
    let kept = (0..n * n).filter(|i| keep([centre(i % n), centre(i / n), centre(z)])).count();
    kept as f64 / f64::from(n * n)
}

#[test]
fn no_surface_is_invented_in_a_cavity_a_hole_or_a_gap() {
    let dir = tempfile::tempdir().unwrap();
    let far = |p: [f64; 3], axes: &[usize]| axes.iter().any(|&a| (p[a] - 0.5).abs() > 0.25);
    let length = |p: &[f64]| p.iter().map(|c| (c - 0.5) * (c - 0.5)).sum::<f64>().sqrt();
    type Keep<'a> = &'a dyn Fn([f64; 3]) -> bool;
    // What is kept of the unit cube.
    let cases: [(&str, Keep<'_>, u64); 5] = [
        ("cavity", &|p| far(p, &[0, 1, 2]), 1),
        ("hole", &|p| far(p, &[0, 1]), 1),
        ("two bodies", &|p| (p[0] - 0.5).abs() > 0.125, 2),
        ("torus", &|p| (length(&p[..2]) - 0.32).hypot(p[2] - 0.5) < 0.16, 1),
        ("shell", &|p| (0.3..0.5).contains(&length(&p)), 1),
    ];
    for (name, keep, bodies) in cases {
        let input = dir.path().join(format!("{name}.vtk"));
        write_mesh(&input, 16, keep, |p| p, |p| p[2]);
        let (archive, report) = reduced(&input, &settings(2.5), &format!("{name}.isospan"), &run(2));
        assert!(report.void_points > 0 && report.mesh.unwrap().bodies == bodies, "{name}");
        let (mesh, found) = extracted(&archive, 0.45);
        let area = section(16, 7, keep);
        assert!((found.area / area - 1.0).abs() < 0.03, "{name}: {} for {area}", found.area);
        for t in &mesh.triangles {
            let centre: [f64; 3] = std::array::from_fn(|a| {
                t.iter().map(|&v| f64::from(mesh.vertices[v as usize].position[a])).sum::<f64>() / 3.0
            });
            // A point spacing is 0.06.
            let kept = |x: f64, y: f64| keep([x, y, centre[2]].map(|c| ((c * 16.0).floor() + 0.5) / 16.0));
            let far = [-0.04, 0.0, 0.04];
            let deep = far.iter().all(|x| far.iter().all(|y| !kept(centre[0] + x, centre[1] + y)));
            assert!(!deep, "{name}: a triangle at {centre:?}");
        }
    }
}

/// Sections of solids with flat, thin and round walls, along the axes and turned. The field is
/// linear, so their areas are known.
#[test]
fn sections_have_the_areas_of_the_solids() {
    let dir = tempfile::tempdir().unwrap();
    // A rotation about (1, 2, 3).
    let turned = |p: [f64; 3]| {
        let axis = [1.0, 2.0, 3.0].map(|c: f64| c / 14f64.sqrt());
        let (sin, cos) = 0.7f64.sin_cos();
        let along: f64 = (0..3).map(|k| axis[k] * p[k]).sum();
        std::array::from_fn(|k| {
            let (l, m) = ((k + 1) % 3, (k + 2) % 3);
            cos * p[k] + sin * (axis[l] * p[m] - axis[m] * p[l]) + (1.0 - cos) * along * axis[k]
        })
    };
    // Angle, radius and height; the two ends of the angle are one.
    let ring = |[a, r, z]: [f64; 3]| {
        let (sin, cos) = if a == 1.0 { (0.0, 1.0) } else { (std::f64::consts::TAU * a).sin_cos() };
        [(1.0 + r) * cos, (1.0 + r) * sin, z]
    };
    let ring_area = 7.0 * (std::f64::consts::TAU / 14.0).sin() * 3.0;
    type Map<'a> = &'a dyn Fn([f64; 3]) -> [f64; 3];
    type Keep<'a> = &'a dyn Fn([f64; 3]) -> bool;
    // Cells that are kept of the cube, where they are put, the area of a section, its Euler number.
    let cases: [(&str, Keep<'_>, Map<'_>, f64, i64); 6] = [
        ("box", &|_| true, &|p| p, 1.0, 1),
        ("ell", &|p| p[0] < 0.5 || p[1] < 0.5, &|p| p, 0.75, 1),
        (
            "channel",
            &|p| p[0] < 2.0 / 14.0 || p[0] > 12.0 / 14.0 || p[1] < 2.0 / 14.0,
            &|p| p,
            1.0 - 120.0 / 196.0,
            1,
        ),
        ("plate", &|_| true, &|[x, y, z]| [0.02 * x, y, z], 0.02, 1),
        ("rod", &|_| true, &|[x, y, z]| [0.05 * x, 0.1 * y, z], 0.005, 1),
        ("ring", &|_| true, &ring, ring_area, 0),
    ];
    for (name, keep, place, area, euler) in cases {
        let input = dir.path().join(format!("{name}.vtk"));
        for is_turned in [false, true] {
            let placed = |p| if is_turned { turned(place(p)) } else { place(p) };
            write_placed(&input, 14, keep, |p| (placed(p), place(p)[2]));
            // Points of the least fraction are five times as far apart as the plate is thick.
            let fractions = if name == "plate" { &[0.99, 0.5][..] } else { &[0.99, 0.5, 0.125] };
            for &fraction in fractions {
                let (archive, _) = reduced(&input, &settings(fraction), "section.isospan", &run_again());
                for isovalue in [0.27, 0.51, 0.77] {
                    let (_, found) = extracted(&archive, isovalue);
                    let off = found.area / area - 1.0;
                    let at = format!("{name}, turned {is_turned}, {fraction}, {isovalue}");
                    assert!(off.abs() < 0.02, "{at}: {} of {area}", found.area);
                    assert_eq!(found.euler, euler, "{at}");
                }
            }
        }
    }
}

#[test]
fn bodies_that_touch_or_overlap_are_whole_where_the_field_jumps() {
    let dir = tempfile::tempdir().unwrap();
    // The middle layer of 17 is left out, and the gap is closed: the two halves meet at x = 0.5 and
    // share no vertex.
    let keep = |p: [f64; 3]| (p[0] - 0.5).abs() > 0.5 / 17.0;
    let closed = |p: [f64; 3], gap: f64| {
        let x = if p[0] < 0.5 { p[0] * 17.0 / 16.0 } else { 1.0 - (1.0 - p[0]) * 17.0 / 16.0 + gap };
        [x, p[1], p[2]]
    };
    // Vertices in one place; a gap far below a lattice step; a real one; two overlaps, less and
    // more than a spacing.
    for gap in [0.0, 4e-10, 0.01, -0.01, -0.15] {
        let input = dir.path().join(format!("gap {gap}.vtk"));
        write_placed(&input, 17, keep, |p| (closed(p, gap), if p[0] > 0.5 { p[2] + 10.0 } else { p[2] }));
        let (archive, report) = reduced(&input, &settings(2.5), &format!("gap {gap}.isospan"), &run(2));
        assert_eq!((report.mesh.unwrap().bodies, report.mesh.unwrap().repeated), (2, 0), "{gap}");
        let area = |isovalue: f32| extracted(&archive, isovalue).1.area;
        assert_eq!(area(5.0), 0.0, "{gap}: the jump is no surface");
        // The first one is whole, the second one has what is left.
        let (first, second) = (area(0.45), area(10.45));
        assert!((0.49..0.505).contains(&first), "{gap}: {first} of 0.5");
        let left = 0.5 + gap.min(0.0);
        assert!((left - 0.01..left + 0.005).contains(&second), "{gap}: {second} of {left}");
    }
    // Without a jump, and at equal positions, they are one body.
    let input = dir.path().join("smooth.vtk");
    write_mesh(&input, 17, keep, |p| closed(p, 0.0), |p| p[2]);
    let (archive, report) = reduced(&input, &settings(0.99), "smooth.isospan", &run(2));
    assert_eq!((report.mesh.unwrap().bodies, report.mesh.unwrap().repeated), (1, 18 * 18));
    assert!((extracted(&archive, 0.45).1.area - 1.0).abs() < 0.01);
}

/// Which vertices are one is decided by the first step, whose file need not be there when others
/// are added.
#[test]
fn appended_steps_have_the_bodies_of_the_first() {
    let dir = tempfile::tempdir().unwrap();
    // Two halves of a cube that meet at x = 0.5 and share no vertex; the field goes on, or jumps
    // there.
    let keep = |p: [f64; 3]| (p[0] - 0.5).abs() > 0.5 / 9.0;
    let closed =
        |[x, y, z]: [f64; 3]| [if x < 0.5 { x * 9.0 / 8.0 } else { 1.0 - (1.0 - x) * 9.0 / 8.0 }, y, z];
    let step = |name: &str, jump: f64, slope: f64| {
        let path = dir.path().join(name);
        write_placed(&path, 9, keep, |p| (closed(p), slope * p[2] + if p[0] > 0.5 { jump } else { 0.0 }));
        StepSource::new(&path, &OpenOptions::default())
    };
    let (smooth, jump) = ([step("s0.vtk", 0.0, 1.0), step("s1.vtk", 0.0, 2.0)], step("j.vtk", 10.0, 1.0));
    let settings = ReduceSettings { chunk_points: 300, ..settings(0.99) };
    let out = |name: &str| dir.path().join(name);
    let made = |steps: &[StepSource], name: &str| {
        reduce_series(steps, &settings, &out(name), &run(2), &Silent).unwrap()
    };
    let add =
        |step: &StepSource, name: &str| addition(std::slice::from_ref(step), &run(1)).append_to(out(name));
    for (case, first, bodies) in [("smooth", &smooth[0], 1), ("jump", &jump, 2)] {
        let [all, grown] = ["all", "grown"].map(|kind| format!("{case}-{kind}.isospan"));
        let found = made(&[first.clone(), smooth[1].clone()], &all).mesh.unwrap();
        assert_eq!((found.bodies, found.repeated), (bodies, if bodies == 1 { 100 } else { 0 }), "{case}");
        made(std::slice::from_ref(first), &grown);
        let hidden = first.path.with_extension("away");
        std::fs::rename(&first.path, &hidden).unwrap();
        let report = add(&smooth[1], &grown).unwrap();
        std::fs::rename(&hidden, &first.path).unwrap();
        assert_eq!((report.steps.len(), report.mesh.unwrap().bodies), (1, bodies), "{case}");
        assert!(common::folder(&out(&all)) == common::folder(&out(&grown)), "{case}");
        check_archive(&out(&grown)).unwrap();
    }
    assert!(out("smooth-all.isospan/mesh/repeated.seg").exists());
    assert!(!out("jump-all.isospan/mesh/repeated.seg").exists());
    // What is one cannot have two values.
    let before = common::folder(&out("smooth-grown.isospan"));
    let e = add(&jump, "smooth-grown.isospan").unwrap_err();
    assert!(e.exit_code() == 5 && e.to_string().contains("step 2, f, points"), "{e}");
    let manifest = Path::new("manifest.zst");
    assert!(common::folder(&out("smooth-grown.isospan"))[manifest] == before[manifest]);
    // The segment of the duplicate vertices is one of the archive: damage is found, and so is its
    // loss.
    let file = out("smooth-all.isospan/mesh/repeated.seg");
    let good = std::fs::read(&file).unwrap();
    for at in [20, 60, good.len() / 2, good.len() - 60, good.len() - 20] {
        let mut bad = good.clone();
        bad[at] ^= 8;
        std::fs::write(&file, bad).unwrap();
        assert_eq!(check_archive(&out("smooth-all.isospan")).unwrap_err().exit_code(), 5, "byte {at}");
        assert_eq!(add(&smooth[0], "smooth-all.isospan").unwrap_err().exit_code(), 5, "byte {at}");
    }
}

/// Points moved, points more, cells in another order: the error names the file and what differs. A
/// volume is no mesh.
#[test]
fn steps_of_other_meshes_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, n: u32, shift: f64| {
        let path = dir.path().join(name);
        write_mesh(&path, n, |_| true, |[x, y, z]| [x + shift * y * y, y, z], |p| p[0] * p[1]);
        StepSource::new(&path, &OpenOptions::default())
    };
    let (first, moved, more) = (write("a.vtk", 6, 0.0), write("b.vtk", 6, 0.1), write("c.vtk", 7, 0.0));
    let text = std::fs::read_to_string(&first.path).unwrap();
    let at = text.find("CELLS").unwrap();
    let mut lines: Vec<&str> = text[at..].lines().collect();
    lines.swap(1, 2);
    let other = StepSource::new(&dir.path().join("d.vtk"), &OpenOptions::default());
    std::fs::write(&other.path, format!("{}{}\n", &text[..at], lines.join("\n"))).unwrap();
    let volume = StepSource::new(&dir.path().join("v.npy"), &OpenOptions::default());
    common::write_npy(&volume.path, [7, 7, 7], common::waves);
    let (out, settings) = (dir.path().join("m.isospan"), settings(0.99));
    reduce_series(std::slice::from_ref(&first), &settings, &out, &run(2), &Silent).unwrap();
    let before = common::folder(&out);
    let cases = [
        (&moved, "b.vtk: step 1, points: expected the positions of a.vtk, step 0, got others"),
        (&more, "c.vtk: step 1, points: expected 343 of a.vtk, step 0, got 512"),
        (&other, "d.vtk: step 1, cells: expected those of a.vtk, step 0, got others"),
        (&volume, "v.npy: step 1, kind of file: expected a mesh"),
    ];
    for (step, expected) in &cases {
        let e = addition(std::slice::from_ref(step), &run(1)).append_to(&out).unwrap_err();
        let text = e.to_string();
        assert!(e.exit_code() == 5 && text.contains(expected) && !text.contains('\n'), "{expected}: {text}");
        assert!(common::folder(&out) == before, "{expected}");
    }
    // They cost themselves alone.
    let good = StepSource::new(&dir.path().join("e.vtk"), &OpenOptions::default());
    write_mesh(&good.path, 6, |_| true, |p| p, |p| p[2]);
    let steps: Vec<StepSource> = cases.iter().map(|c| c.0.clone()).chain([good]).collect();
    let keep_going = RunSettings { keep_going: true, ..run(2) };
    let report = addition(&steps, &keep_going).append_to(&out).unwrap();
    assert_eq!(report.steps.iter().map(|s| s.number).collect::<Vec<_>>(), [5]);
    assert_eq!(report.skipped.iter().map(|s| s.number).collect::<Vec<_>>(), [1, 2, 3, 4]);
    check_archive(&out).unwrap();
    // A mesh is no step of a volume.
    let out = dir.path().join("v.isospan");
    let settings = ReduceSettings::exact(isospan::points::SetKind::Regular);
    reduce_series(std::slice::from_ref(&volume), &settings, &out, &run(2), &Silent).unwrap();
    let e = addition(std::slice::from_ref(&first), &run(1)).append_to(&out).unwrap_err();
    assert!(e.exit_code() == 5 && e.to_string().contains("a volume, as other steps are"), "{e}");
}

#[test]
fn ghosts_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ghosts.vtk");
    write_mesh(&input, 8, |_| true, |p| p, |p| p[2]);
    // The first half of the cells are copies, or hidden; the other marks do not leave cells out.
    let cells = 6 * 8 * 8 * 8;
    let mut text = std::fs::read_to_string(&input).unwrap();
    writeln!(text, "CELL_DATA {cells}\nSCALARS vtkGhostType unsigned_char\nLOOKUP_TABLE default").unwrap();
    (0..cells).for_each(|i| writeln!(text, "{}", [[1, 32], [16, 8]][2 * i / cells][i % 2]).unwrap());
    std::fs::write(&input, text).unwrap();
    let (archive, report) = reduced(&input, &settings(0.99), "ghosts.isospan", &run(2));
    let census = report.mesh.unwrap();
    assert_eq!((census.cells, census.ghosts), (cells as u64 / 2, cells as u64 / 2));
    let area = |isovalue: f32| extracted(&archive, isovalue).1.area;
    assert_eq!(area(0.3), 0.0, "below there are ghosts only");
    assert!((area(0.7) - 1.0).abs() < 0.02, "{}", area(0.7));
}

#[test]
fn threads_memory_and_chunks_do_not_change_the_reduction() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("ball.vtk");
    let radius = |p: [f64; 3]| p.iter().map(|c| (c - 0.5) * (c - 0.5)).sum::<f64>().sqrt();
    write_mesh(&input, 14, |p| radius(p) < 0.48, |p| p, |p| radius(p) + 0.05 * (9.0 * p[0]).sin());
    let (one, _) = reduced(&input, &settings(0.99), "one.isospan", &run(1));
    let small = RunSettings { resources: run(2).resources.with_memory(64 << 20), ..run(2) };
    let (two, _) = reduced(&input, &settings(0.99), "two.isospan", &small);
    assert_eq!(common::folder(&one), common::folder(&two));
    let chunked = ReduceSettings { chunk_points: 500, ..settings(0.99) };
    let (many, report) = reduced(&input, &chunked, "many.isospan", &run(2));
    assert!(report.chunks > 4);
    let triangles = |archive: &Path| triangle_set(&extracted(archive, 0.3).0);
    assert_eq!(triangles(&one), triangles(&many));
}

#[test]
fn values_that_are_no_numbers() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("nan.vtk");
    write_mesh(&input, 8, |_| true, |p| p, |p| if p[0] > 0.8 { f64::NAN } else { p[1] });
    let out = dir.path().join("refused.isospan");
    let refused = reduce_series(
        &[StepSource::new(&input, &OpenOptions::default())],
        &settings(0.99),
        &out,
        &run(1),
        &Silent,
    )
    .unwrap_err();
    assert!(refused.exit_code() == 5 && refused.to_string().contains("point"), "{refused}");
    let masked = ReduceSettings { nan: NanPolicy::Mask, ..settings(0.99) };
    let (archive, _) = reduced(&input, &masked, "masked.isospan", &run(2));
    let (mesh, found) = extracted(&archive, 0.5);
    assert!(mesh.vertices.iter().all(|p| p.position[0] < 0.88) && found.area > 0.6, "{found:?}");
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn real_meshes() {
    let data = common::shared_data();
    let dir = tempfile::tempdir().unwrap();
    // File, field, isovalue, area of VTK's contour of the whole mesh.
    for (name, field, isovalue, area) in [
        ("post_flow_tet.vtk", "Pressure", 0.8, 11.1234),
        ("cylinder_flow_tet.vtk", "vel_norm", 0.3, 0.005_047_44),
    ] {
        let out = dir.path().join(format!("{name}.isospan"));
        let options = OpenOptions { field: Some(field.into()), ..OpenOptions::default() };
        reduce_series(
            &[StepSource::new(&data.join("meshes").join(name), &options)],
            &settings(0.99),
            &out,
            &run(2),
            &Silent,
        )
        .unwrap();
        check_archive(&out).unwrap();
        let found = extracted(&out, isovalue).1.area;
        assert!((found / area - 1.0).abs() < 0.1, "{name}: {found} for {area}");
    }
}

#[test]
fn the_error_at_the_vertices_is_measured() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("ell.vtk"), dir.path().join("ell.isospan"));
    let field = |[x, y, _]: [f64; 3]| (4.0 * x).sin() + y * y;
    write_mesh(&input, 12, |[x, y, _]| x < 0.5 || y < 0.5, |p| p, field);
    let settings =
        ReduceSettings { amount: Amount::Fraction(0.99), chunk_points: 600, ..ReduceSettings::default() };
    let made =
        reduce_series(&[StepSource::new(&input, &OpenOptions::default())], &settings, &out, &run(2), &Silent)
            .unwrap();
    let e = made.error.unwrap();
    assert_eq!((e.samples, e.measured), (made.samples, made.samples), "all vertices");
    assert!(e.beyond > 0 && e.beyond < e.samples / 10, "{e:?}");
    assert!(e.rms > 1e-4 && e.max < 0.1, "{e:?}");
    let worst = e.worst.as_ref().unwrap();
    assert!((worst.original - field(worst.world)).abs() < 1e-5, "{worst:?}");
    let resources = Resources::default().with_threads(1).with_memory(1 << 30);
    let again = measurement(&out, &input).resources(resources).run().unwrap();
    assert!(again.same_source && again.error == e);
}

/// A flat-walled, a thin, a hollow and a curved domain.
fn shapes(dir: &Path) -> Vec<(&'static str, PathBuf)> {
    let radius = |p: [f64; 3]| p.iter().map(|c| (c - 0.5) * (c - 0.5)).sum::<f64>().sqrt();
    let shell = move |p: [f64; 3]| (0.3..0.45).contains(&radius(p));
    let at = |name: &'static str| (name, dir.join(format!("{name}.vtk")));
    let all = vec![at("box"), at("ell"), at("plate"), at("shell")];
    let field = |[x, y, z]: [f64; 3]| x + 0.3 * (4.0 * y).sin() + 0.2 * z;
    write_mesh(&all[0].1, 14, |_| true, |p| p, field);
    write_mesh(&all[1].1, 14, |[x, y, _]| x < 0.5 || y < 0.5, |p| p, field);
    write_mesh(&all[2].1, 14, |_| true, |[x, y, z]| [x, y, 0.1 * z + 7.0], field);
    write_mesh(&all[3].1, 18, shell, |p| p, field);
    all
}

#[test]
fn as_many_points_are_made_as_are_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    for (name, input) in shapes(dir.path()) {
        for (amount, adapt) in [
            (Amount::Fraction(0.99), false),
            (Amount::Fraction(0.5), false),
            (Amount::Count(700), false),
            (Amount::Count(1200), true),
        ] {
            let mut settings = ReduceSettings { amount, ..ReduceSettings::default() };
            if adapt {
                settings.points = Some(isospan::points::SetKind::Halton);
                settings.adapt = true;
            }
            let (_, report) = reduced(&input, &settings, "counted.isospan", &run_again());
            let asked = match amount {
                Amount::Count(n) => n as f64,
                Amount::Usual => unreachable!("each asks for a number"),
                Amount::Fraction(f) => f * report.samples as f64,
            };
            let made = (report.points - report.void_points) as f64;
            assert!((made / asked - 1.0).abs() < 0.03, "{name}, {amount:?}: {made} of {asked}");
        }
    }
}

/// Replaces what is there.
fn run_again() -> RunSettings {
    RunSettings { replace: true, ..run(2) }
}

#[test]
fn a_surface_is_probed_without_holes_and_points_outside_have_no_value() {
    let dir = tempfile::tempdir().unwrap();
    for (name, input) in shapes(dir.path()) {
        let (archive, _) = reduced(&input, &settings(0.5), "probed.isospan", &run_again());
        let isovalue = 0.7;
        let (mesh, _) = extracted(&archive, isovalue);
        let points: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| v.position.map(f64::from)).collect();
        let open = isospan::pipeline::Archive::open(&archive).unwrap();
        let values = open.probe(&points).unwrap();
        let off = values.iter().map(|v| (v - f64::from(isovalue)).abs()).fold(0.0, f64::max);
        assert!(values.iter().all(|v| v.is_finite()) && off < 1e-3, "{name}: {off} of {}", values.len());
        let outside = open.probe(&[[0.5, 0.5, -0.001], [1.5, 0.5, 0.5]]).unwrap();
        assert!(outside.iter().all(|v| v.is_nan()), "{name}: {outside:?}");
    }
}
