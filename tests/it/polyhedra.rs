//! Meshes of polyhedra: they are split without holes, and agree with other cells.

use crate::common::{addition, check_archive, folder, manifest_json, measurement, query, run};
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{Amount, MeshCensus, ReduceReport, ReduceSettings, RunSettings, reduce_series};
use isospan::surface::TriMesh;
use isospan::surface::check::check;
use isospan::{Archive, Resources};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

type Point = [i64; 3];

/// A cell: a VTK type and its vertices, or faces.
enum Cell {
    Of(u8, Vec<usize>),
    Faces(Vec<Vec<usize>>),
}

/// A mesh on whole numbers.
#[derive(Default)]
struct Mesh {
    points: Vec<Point>,
    cells: Vec<Cell>,
}

/// Mixes up the numbers of points.
fn shuffled(n: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by_key(|&i| (i as u64 + 3).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 20);
    order
}

impl Mesh {
    /// The mesh with its points in another order.
    fn shuffled(self) -> Self {
        let order = shuffled(self.points.len());
        let mut number = vec![0; order.len()];
        order.iter().enumerate().for_each(|(new, &old)| number[old] = new);
        let renamed = |of: Vec<usize>| of.into_iter().map(|v| number[v]).collect::<Vec<usize>>();
        let cells = self.cells.into_iter().map(|cell| match cell {
            Cell::Of(kind, vertices) => Cell::Of(kind, renamed(vertices)),
            Cell::Faces(faces) => Cell::Faces(faces.into_iter().map(renamed).collect()),
        });
        Self { points: order.iter().map(|&old| self.points[old]).collect(), cells: cells.collect() }
    }

    /// The cells that `keep` chooses, with their own points only.
    fn part(&self, keep: impl Fn(usize) -> bool) -> Self {
        let (mut numbers, mut part) = (HashMap::new(), Self::default());
        for (_, cell) in self.cells.iter().enumerate().filter(|(i, _)| keep(*i)) {
            let mut own = |v: &usize| {
                *numbers.entry(*v).or_insert_with(|| {
                    part.points.push(self.points[*v]);
                    part.points.len() - 1
                })
            };
            part.cells.push(match cell {
                Cell::Of(kind, vertices) => Cell::Of(*kind, vertices.iter().map(&mut own).collect()),
                Cell::Faces(faces) => {
                    Cell::Faces(faces.iter().map(|f| f.iter().map(&mut own).collect()).collect())
                }
            });
        }
        part
    }

    /// Writes the mesh with a value at each point, and one on each cell: the number of its
    /// vertices.
    fn write(&self, path: &Path, newer: bool, value: impl Fn(Point) -> f64) {
        let (mut ids, mut ends, mut types, mut sizes) = (vec![], vec![], vec![], vec![]);
        let (mut faces, mut face_ends) = (vec![], vec![]);
        let (mut points, mut point_ends, mut polyhedron_ends) = (vec![], vec![], vec![]);
        for cell in &self.cells {
            let before = ids.len();
            match cell {
                Cell::Of(kind, vertices) => {
                    ids.extend_from_slice(vertices);
                    types.push(usize::from(*kind));
                    face_ends.push(-1);
                }
                Cell::Faces(of_cell) => {
                    ids.extend(of_cell.iter().flatten().copied().collect::<BTreeSet<_>>());
                    types.push(42);
                    faces.push(of_cell.len());
                    for face in of_cell {
                        faces.push(face.len());
                        faces.extend_from_slice(face);
                        points.extend_from_slice(face);
                        point_ends.push(points.len());
                    }
                    face_ends.push(faces.len() as i64);
                }
            }
            sizes.push(ids.len() - before);
            ends.push(ids.len());
            polyhedron_ends.push(point_ends.len());
        }
        let text = |numbers: &[usize]| numbers.iter().map(|n| format!("{n} ")).collect::<String>();
        let array = |name: &str, numbers: String| {
            format!("<DataArray type=\"Int64\" Name=\"{name}\" format=\"ascii\">{numbers}</DataArray>\n")
        };
        let places: String = self.points.iter().map(|[x, y, z]| format!("{x} {y} {z} ")).collect();
        let values = self.points.iter().fold(String::new(), |mut text, &p| {
            write!(text, "{} ", value(p)).unwrap();
            text
        });
        let of_faces = if newer {
            let all: Vec<usize> = (0..point_ends.len()).collect();
            [
                array("face_connectivity", text(&points)),
                array("face_offsets", text(&point_ends)),
                array("polyhedron_to_faces", text(&all)),
                array("polyhedron_offsets", text(&polyhedron_ends)),
            ]
            .concat()
        } else {
            let ends = face_ends.iter().map(|n| format!("{n} ")).collect();
            [array("faces", text(&faces)), array("faceoffsets", ends)].concat()
        };
        let text = format!(
            "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>\n\
             <Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n<PointData Scalars=\"f\">\
             <DataArray type=\"Float32\" Name=\"f\" format=\"ascii\">{values}</DataArray></PointData>\n\
             <CellData>{}</CellData>\n<Points><DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">\
             {places}</DataArray></Points>\n<Cells>{}{}{}{of_faces}</Cells></Piece></UnstructuredGrid></VTKFile>\n",
            self.points.len(),
            self.cells.len(),
            array("size", text(&sizes)),
            array("connectivity", text(&ids)),
            array("offsets", text(&ends)),
            array("types", text(&types)),
        );
        std::fs::write(path, text).unwrap();
    }
}

/// The points of a mesh that is being made, each once.
#[derive(Default)]
struct Numbers(BTreeMap<Point, usize>);

impl Numbers {
    fn of(&mut self, p: Point) -> usize {
        let next = self.0.len();
        *self.0.entry(p).or_insert(next)
    }

    fn points(&self) -> Vec<Point> {
        let mut all: Vec<(usize, Point)> = self.0.iter().map(|(p, n)| (*n, *p)).collect();
        all.sort_unstable();
        all.into_iter().map(|(_, p)| p).collect()
    }
}

/// Places in a cube, in VTK's order of a hexahedron's vertices.
const AROUND: [Point; 8] =
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]];

/// A grid of cubes of side 4; of which `refined` chooses those that are cut into eight, and
/// `is_polyhedron` those that become polyhedra although they need not.
fn octree(n: i64, refined: impl Fn(Point) -> bool, is_polyhedron: impl Fn(Point) -> bool) -> Mesh {
    let (mut leaves, mut corners): (Vec<(Point, i64)>, BTreeSet<Point>) = (vec![], BTreeSet::new());
    // The side of the leaf around a unit cube.
    let mut side: HashMap<Point, i64> = HashMap::new();
    let grid = |n: i64| (0..n * n * n).map(move |i| [i % n, i / n % n, i / n / n]);
    for cube in grid(n) {
        let (parts, size) = if refined(cube) { (2, 2) } else { (1, 4) };
        for part in grid(parts) {
            let at: Point = std::array::from_fn(|a| 4 * cube[a] + size * part[a]);
            leaves.push((at, size));
            corners.extend(AROUND.map(|c| std::array::from_fn(|a| at[a] + size * c[a])));
            grid(size).for_each(|u| {
                side.insert(std::array::from_fn(|a| at[a] + u[a]), size);
            });
        }
    }
    let (mut numbers, mut cells) = (Numbers::default(), vec![]);
    for (at, size) in leaves {
        let mut faces: Vec<Vec<Point>> = vec![];
        for (axis, is_high) in (0..6).map(|i| (i / 2, i % 2 == 1)) {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            // The squares in which leaves on the other side have this one.
            let place = |a: i64, b: i64, c: i64| {
                let mut p = at;
                p[axis] += if is_high { size } else { 0 } + c;
                (p[u], p[v]) = (p[u] + a, p[v] + b);
                p
            };
            let beyond = side.get(&place(0, 0, if is_high { 0 } else { -1 })).copied().unwrap_or(size);
            let step = beyond.min(size);
            for (a, b) in
                (0..(size / step).pow(2)).map(|i| (i % (size / step) * step, i / (size / step) * step))
            {
                let mut ring = vec![];
                let square = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]].map(|[i, j]| {
                    let (i, j) = if is_high { (i, j) } else { (j, i) };
                    place(a + step * i, b + step * j, 0)
                });
                for ends in square.windows(2) {
                    for k in 0..step {
                        let p: Point =
                            std::array::from_fn(|c| ends[0][c] + (ends[1][c] - ends[0][c]) / step * k);
                        ring.extend(corners.contains(&p).then_some(p));
                    }
                }
                faces.push(ring);
            }
        }
        let has_hanging = faces.len() > 6 || faces.iter().any(|f| f.len() > 4);
        cells.push(if has_hanging || is_polyhedron(at) {
            let numbered = |face: &Vec<Point>| face.iter().map(|&p| numbers.of(p)).collect();
            Cell::Faces(faces.iter().map(numbered).collect())
        } else {
            let corner = |c: Point| numbers.of(std::array::from_fn(|a| at[a] + size * c[a]));
            Cell::Of(12, AROUND.into_iter().map(corner).collect())
        });
    }
    Mesh { points: numbers.points(), cells }
}

fn kept(input: &Path, run: &RunSettings) -> (PathBuf, ReduceReport) {
    let out = input.with_extension("isospan");
    let settings =
        ReduceSettings { amount: Amount::Fraction(1.0), chunk_points: 2000, ..ReduceSettings::default() };
    let source = StepSource::new(input, &OpenOptions::default());
    let report = reduce_series(&[source], &settings, &out, run, &Silent).unwrap();
    assert!(report.own);
    check_archive(&out).unwrap();
    (out, report)
}

/// Six times the volume of the tetrahedra that an archive keeps, as a part of the cube of 2^24
/// steps.
fn volume(archive: &Path) -> f64 {
    let manifest: serde_json::Value = serde_json::from_str(&manifest_json(archive)).unwrap();
    let words = &manifest["plan"]["own"]["volume6"];
    let word = |i: usize| words[i].as_u64().unwrap();
    ((u128::from(word(1)) << 64 | u128::from(word(0))) as f64) / (6u128 << 72) as f64
}

fn surface(archive: &Path, isovalue: f64) -> TriMesh {
    query(archive, isovalue).resources(Resources::default().with_threads(2)).mesh().unwrap()
}

fn census(report: &ReduceReport) -> MeshCensus {
    report.mesh.unwrap()
}

fn linear([x, y, z]: Point) -> f64 {
    (x + 2 * y) as f64 - 0.5 * z as f64
}

/// The area of the plane where [`linear`] has a value, within the cube of side 16: found for values
/// of 16.5 to 31 by an integral over x and z, in which y stays within the cube.
fn plane_area() -> f64 {
    // The normal (1, 2, -1/2) is 2 along y.
    256.0 * 5.25f64.sqrt() / 2.0
}

/// Cubes as polyhedra, alone and beside hexahedra, in both ways of telling their faces.
#[test]
fn cubes_as_polyhedra_agree_with_hexahedra() {
    let dir = tempfile::tempdir().unwrap();
    for (name, every) in [("all", 1), ("some", 3)] {
        let mesh = octree(4, |_| false, |at| (at[0] + at[1] + at[2]) / 4 % every == 0).shuffled();
        let polyhedra = mesh.cells.iter().filter(|c| matches!(c, Cell::Faces(_))).count() as u64;
        assert!(if every == 1 { polyhedra == 64 } else { (10..40).contains(&polyhedra) });
        let mut sizes = vec![];
        for newer in [false, true] {
            let input = dir.path().join(format!("{name}_{newer}.vtu"));
            mesh.write(&input, newer, linear);
            let (archive, report) = kept(&input, &run(2));
            let census = census(&report);
            assert_eq!((census.vertices, census.added, census.cells), (125, polyhedra, 64));
            assert_eq!(census.tetrahedra, 12 * polyhedra + 6 * (64 - polyhedra));
            // Two triangles on each square of the boundary, and none within.
            assert_eq!((census.boundary_triangles, census.bodies), (192, 1));
            assert_eq!((census.inverted, census.degenerate), (0, 0));
            assert_eq!(volume(&archive), 1.0);
            let error = report.error.unwrap();
            assert_eq!((error.measured, error.max), (125, 0.0), "new points are none of the file's");
            let found = check(&surface(&archive, 20.3));
            assert!(found.is_manifold() && found.is_oriented(), "{found:?}");
            assert!((found.area / plane_area() - 1.0).abs() < 1e-6, "{}", found.area);
            sizes.push(std::fs::read(archive.join("mesh/000000.seg")).unwrap().len());
        }
        assert_eq!(sizes[0], sizes[1]);
    }
}

/// Large cells beside small ones: faces have points on their edges, and a side may have four faces.
#[test]
fn cells_with_hanging_points_leave_no_hole() {
    let dir = tempfile::tempdir().unwrap();
    // A ball, half of it refined.
    let refined = |c: Point| c.iter().all(|&c| c >= 1) || c == [0, 2, 2];
    for (name, every) in [("mixed", false), ("polyhedra", true)] {
        let mesh = octree(4, refined, |_| every).shuffled();
        assert!(mesh.cells.iter().any(|c| matches!(c, Cell::Of(..))) != every);
        let input = dir.path().join(format!("{name}.vtu"));
        mesh.write(&input, true, linear);
        let (archive, report) = kept(&input, &run(2));
        let of_linear = census(&report);
        assert_eq!((of_linear.bodies, of_linear.inverted, of_linear.degenerate), (1, 0, 0));
        assert_eq!(volume(&archive), 1.0);
        let found = check(&surface(&archive, 20.3));
        assert!(found.is_manifold() && found.is_oriented() && found.components == 1, "{found:?}");
        // Vertices stay off the ends of their edges by 1/1024 of these.
        assert!((found.area / plane_area() - 1.0).abs() < 1e-4, "{}", found.area);

        // A ball within: closed, whatever the threads and the chunks.
        let input = dir.path().join(format!("{name}_ball.vtu"));
        mesh.write(&input, false, |p| p.iter().map(|&c| (c - 8) as f64 * (c - 8) as f64).sum::<f64>().sqrt());
        let (archive, _) = kept(&input, &run(3));
        let ball = check(&surface(&archive, 5.3));
        assert!(
            ball.is_closed() && ball.is_oriented() && ball.components == 1 && ball.euler == 2,
            "{ball:?}"
        );
        let expected = 4.0 * std::f64::consts::PI * 5.3 * 5.3;
        assert!((ball.area / expected - 1.0).abs() < 0.2, "{} for {expected}", ball.area);
        let bytes = folder(&archive);
        let (again, _) = kept(&input, &RunSettings { replace: true, ..run(1) });
        assert!(bytes == folder(&again), "other bytes for one thread");
    }
}

/// The triangles of the boundary of a box whose cells have hanging points are those of its faces
/// alone: a hole within would add to them.
#[test]
fn the_boundary_is_that_of_the_box() {
    let dir = tempfile::tempdir().unwrap();
    let inner = |c: Point| c.iter().all(|&c| (1..4).contains(&c));
    let mesh = octree(5, inner, |_| true).shuffled();
    let input = dir.path().join("inner.vtu");
    mesh.write(&input, true, linear);
    let report = kept(&input, &run(2)).1;
    // No cell at the boundary is refined, so its faces there are squares.
    assert_eq!((census(&report).boundary_triangles, census(&report).bodies), (6 * 25 * 2, 1));
}

/// Prisms over triangles of which some edges have a point: quadrilaterals with a straight corner
/// between cells, cut from it; beside a pyramid, which knows nothing of it, as the pyramid is.
#[test]
fn straight_corners_are_cut_from() {
    let dir = tempfile::tempdir().unwrap();
    // On each level a square 0 1 2 3 with 4 on the diagonal 0 - 2: one triangle has it on its edge,
    // the other is cut there.
    let level = |z: i64| [[0, 0, z], [8, 0, z], [8, 8, z], [0, 8, z], [4, 4, z]];
    let (points, n) = ((0..4).flat_map(|z| level(4 * z)).collect::<Vec<_>>(), 3);
    let prism = |base: &[usize], z: usize| {
        let low: Vec<usize> = base.iter().map(|v| 5 * z + v).collect();
        let high: Vec<usize> = low.iter().map(|v| v + 5).collect();
        let count = base.len();
        let side = |i: usize| vec![low[i], low[(i + 1) % count], high[(i + 1) % count], high[i]];
        let lowest = low.iter().rev().copied().collect();
        let faces = [lowest, high.clone()].into_iter().chain((0..count).map(side)).collect();
        Cell::Faces(faces)
    };
    let columns = |points: Vec<Point>| {
        let cells =
            (0..n).flat_map(|z| [prism(&[0, 1, 2, 4], z), prism(&[0, 4, 3], z), prism(&[4, 2, 3], z)]);
        Mesh { points, cells: cells.collect() }
    };
    for seed in [false, true] {
        let mesh = columns(points.clone());
        let mesh = if seed { mesh.shuffled() } else { mesh };
        let input = dir.path().join(format!("{seed}.vtu"));
        mesh.write(&input, seed, linear);
        let (archive, report) = kept(&input, &run(1));
        let found = census(&report);
        // Of each of the three prisms: triangles of the four-sided ones, then of the others.
        assert_eq!((found.tetrahedra, found.degenerate, found.added), (3 * (12 + 2 * 8), 0, 9));
        assert_eq!((found.bodies, found.boundary_triangles), (1, 2 * 4 + 3 * 8));
        let part = 8.0 * 8.0 * 12.0 / (12.0f64 * 12.0 * 12.0);
        // Positions are rounded to 2^-24 of the longest side.
        assert!((volume(&archive) / part - 1.0).abs() < 1e-6);
    }
    // A pyramid on the top of the first column cuts it from point 15, where the corner is not.
    let mut mesh = columns(points);
    mesh.points.push([5, 3, 20]);
    mesh.cells.push(Cell::Of(14, vec![15, 16, 17, 19, 20]));
    let input = dir.path().join("pyramid.vtu");
    mesh.write(&input, true, linear);
    let found = census(&kept(&input, &run(1)).1);
    // Both leave out a flat tetrahedron, and they hang together by the rest.
    assert_eq!((found.bodies, found.degenerate), (1, 2));
}

/// Cells as of a foam: truncated octahedra, whose faces are squares and hexagons.
#[test]
fn truncated_octahedra_fill_their_volume() {
    let dir = tempfile::tempdir().unwrap();
    let mut corners = BTreeSet::new();
    for (a, b) in [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)] {
        for signs in 0..4 {
            let mut p = [0; 3];
            (p[a], p[b]) = (1 - signs % 2 * 2, 2 - signs / 2 * 4);
            corners.insert(p);
        }
    }
    assert_eq!(corners.len(), 24);
    let mut normals: Vec<(Point, i64)> = vec![];
    for axis in 0..3 {
        for sign in [-1, 1] {
            let mut normal = [0; 3];
            normal[axis] = sign;
            normals.push((normal, 2));
        }
    }
    normals.extend((0..8).map(|s| ([1 - s % 2 * 2, 1 - s / 2 % 2 * 2, 1 - s / 4 * 2], 3)));
    let dot = |a: Point, b: Point| (0..3).map(|i| a[i] * b[i]).sum::<i64>();
    let face = |(normal, at): (Point, i64)| {
        let mut of: Vec<Point> = corners.iter().copied().filter(|&p| dot(p, normal) == at).collect();
        let middle: Point = std::array::from_fn(|a| of.iter().map(|p| p[a]).sum::<i64>());
        let n = of.len() as i64;
        let from: [f64; 3] = std::array::from_fn(|a| (n * of[0][a] - middle[a]) as f64);
        let beside: [f64; 3] = std::array::from_fn(|a| {
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            normal[b] as f64 * from[c] - normal[c] as f64 * from[b]
        });
        let angle = |p: &Point| {
            let d: [f64; 3] = std::array::from_fn(|a| (n * p[a] - middle[a]) as f64);
            let along = |e: [f64; 3]| {
                (0..3).map(|a| d[a] * e[a]).sum::<f64>() / e.iter().map(|x| x * x).sum::<f64>().sqrt()
            };
            along(beside).atan2(along(from))
        };
        of.sort_by(|p, q| angle(p).total_cmp(&angle(q)));
        of
    };
    let faces: Vec<Vec<Point>> = normals.into_iter().map(face).collect();
    assert_eq!(faces.iter().map(Vec::len).sum::<usize>(), 6 * 4 + 8 * 6);
    let (mut numbers, mut cells) = (Numbers::default(), vec![]);
    for n in [3i64, 2] {
        for i in 0..n * n * n {
            let at = [i % n, i / n % n, i / n / n].map(|c| 4 * c + 2 + if n == 2 { 2 } else { 0 });
            let number = |p: &Point| numbers.of(std::array::from_fn(|a| p[a] + at[a]));
            let mut number = number;
            cells.push(Cell::Faces(faces.iter().map(|f| f.iter().map(&mut number).collect()).collect()));
        }
    }
    let mesh = Mesh { points: numbers.points(), cells }.shuffled();
    let input = dir.path().join("foam.vtu");
    mesh.write(&input, false, linear);
    let (archive, report) = kept(&input, &run(2));
    let found = census(&report);
    assert_eq!((found.cells, found.tetrahedra), (35, 35 * (6 * 2 + 8 * 6)));
    assert_eq!((found.bodies, found.inverted, found.degenerate), (1, 0, 0));
    // Each inner cell shares its 8 hexagons with outer ones; squares are shared along axes.
    let hexagons = 35 * 8 - 8 * 8;
    assert_eq!(found.added, 35 + hexagons);
    assert_eq!(found.boundary_triangles, 6 * (hexagons - 64) + 2 * (35 * 6 - 2 * (3 * 18 + 3 * 4)));
    assert!((volume(&archive) * 12.0 * 12.0 * 12.0 / (35.0 * 32.0) - 1.0).abs() < 1e-6);
    // In pieces of their own points, whose common faces have one vertex too.
    let index: String = (0..3)
        .map(|k| {
            let name = format!("piece_{k}.vtu");
            mesh.part(|i| i % 3 == k).shuffled().write(&dir.path().join(&name), k == 1, linear);
            format!("<Piece Source=\"{name}\"/>")
        })
        .collect();
    let input = dir.path().join("pieces.pvtu");
    let text = format!(
        "<VTKFile type=\"PUnstructuredGrid\"><PUnstructuredGrid>{index}</PUnstructuredGrid></VTKFile>"
    );
    std::fs::write(&input, text).unwrap();
    let (_, report) = kept(&input, &run(2));
    let pieces = census(&report);
    let of = |c: &MeshCensus| (c.tetrahedra, c.added, c.bodies, c.boundary_triangles);
    assert!(pieces.repeated > 0 && of(&pieces) == of(&found), "{pieces:?}");
}

/// Steps on one mesh of polyhedra, data on cells, and a smaller archive.
#[test]
fn steps_and_other_fields_of_polyhedra() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = octree(3, |c| c == [1, 1, 1], |_| true);
    let steps: Vec<StepSource> = (0..3)
        .map(|n| {
            let path = dir.path().join(format!("step_{n}.vtu"));
            mesh.write(&path, true, |p| linear(p) + 10.0 * f64::from(n));
            StepSource::new(&path, &OpenOptions::default())
        })
        .collect();
    let whole = ReduceSettings { amount: Amount::Fraction(1.0), ..ReduceSettings::default() };
    let out = |name: &str| dir.path().join(name);
    reduce_series(&steps, &whole, &out("all.isospan"), &run(2), &Silent).unwrap();
    reduce_series(&steps[..1], &whole, &out("grown.isospan"), &run(1), &Silent).unwrap();
    addition(&steps[1..], &run(2)).append_to(out("grown.isospan")).unwrap();
    assert!(folder(&out("all.isospan")) == folder(&out("grown.isospan")));
    check_archive(&out("grown.isospan")).unwrap();
    let areas: Vec<f64> = (0..3u32)
        .map(|n| {
            let step = Archive::open(out("all.isospan")).unwrap().step(n.into()).unwrap();
            check(&step.surface(10.3 + 10.0 * f64::from(n)).unwrap()).area
        })
        .collect();
    assert!(
        areas.iter().all(|a| (a / areas[0] - 1.0).abs() < 1e-6),
        "the surface stays where it is: {areas:?}"
    );
    for (n, source) in steps.iter().enumerate() {
        let told = measurement(&out("all.isospan"), &source.path).step(n as u64).run().unwrap();
        assert!(told.same_source && told.error.max == 0.0);
        assert_eq!(told.error.measured, mesh.points.len() as u64);
    }
    // Each point has the mean of the cells around it, so the range is theirs.
    let on_cells = OpenOptions { field: Some("size".into()), ..OpenOptions::default() };
    let source = StepSource::new(&steps[0].path, &on_cells);
    let report = reduce_series(&[source], &whole, &out("size.isospan"), &run(1), &Silent).unwrap();
    let [lo, hi] = report.error.unwrap().source_range.unwrap();
    assert!((8.0..9.0).contains(&lo) && hi > lo && hi <= 26.0, "{lo} {hi}");
    // Sampled, with fitted values and quadratic interpolation too.
    for (amount, interpolation) in
        [(0.5, isospan::sample::Interpolation::Linear), (0.5, isospan::sample::Interpolation::Quadratic)]
    {
        let settings =
            ReduceSettings { amount: Amount::Fraction(amount), interpolation, ..ReduceSettings::default() };
        let out = out(&format!("{interpolation}.isospan"));
        let report = reduce_series(&steps[..1], &settings, &out, &run(2), &Silent).unwrap();
        check_archive(&out).unwrap();
        let error = report.error.unwrap();
        assert!(error.max < 0.1 && error.measured == mesh.points.len() as u64, "{error:?}");
    }
}

#[test]
fn folded_polyhedra_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut mesh = octree(3, |_| false, |_| true);
    // Every other point of a row of cells is moved through the cells around it.
    mesh.points.iter_mut().filter(|p| p.iter().all(|&c| c % 8 == 4)).for_each(|p| p[0] -= 7);
    let input = dir.path().join("folded.vtu");
    mesh.write(&input, false, linear);
    let source = StepSource::new(&input, &OpenOptions::default());
    let settings = ReduceSettings { amount: Amount::Fraction(1.0), ..ReduceSettings::default() };
    let error =
        reduce_series(&[source], &settings, &dir.path().join("a.isospan"), &run(1), &Silent).unwrap_err();
    let line = error.to_string();
    assert!(
        line.contains("not all of its faces are seen from its middle") && error.exit_code() == 5,
        "{line}"
    );
}
