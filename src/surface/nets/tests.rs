//! Tests of surface nets.

use super::*;
use crate::surface::check::check;
use crate::surface::model::TriMesh;
use crate::surface::weld::{BuilderSettings, StoredSurface};
use crate::surface::world_map::WorldMap;
use isospan_io::grid::Geometry;
use std::collections::BTreeMap;

/// The meshes of labels, with the sizes that were counted.
type Meshes = BTreeMap<i32, (TriMesh, LabelMeshSize)>;

/// A label image and the size of it.
#[derive(Clone)]
struct Image {
    dims: [u64; 3],
    labels: Vec<i32>,
}

impl Image {
    /// Labels of a formula, of many small pieces.
    fn made(dims: [u64; 3], labels: u64) -> Self {
        let count: u64 = dims.iter().product();
        let label = |i: u64| {
            let [x, y, z] = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
            let mixed = (x / 3 + 7 * (y / 2) + 31 * (z / 3)).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
            (if (x * y + z) % 7 == 0 { mixed / 5 } else { mixed }) as i32 % labels as i32
        };
        Self { dims, labels: (0..count).map(label).collect() }
    }

    fn at(&self, node: [i64; 3]) -> i32 {
        let is_there = (0..3).all(|a| (0..self.dims[a] as i64).contains(&node[a]));
        let [x, y, z] = node.map(|n| n as usize);
        let [nx, ny, _] = self.dims.map(|n| n as usize);
        if is_there { self.labels[(z * ny + y) * nx + x] } else { NO_LABEL }
    }

    /// The sides of quads of a box of cells.
    fn sides(&self, cells: [[u64; 2]; 3], steps: u32, wanted: impl Fn(i32) -> bool) -> Vec<Side> {
        let around = nodes_around(steps) as i64;
        let start = cells.map(|[lo, _]| lo as i64 - 1 - around);
        let size = [0, 1, 2].map(|a| (cells[a][1] as i64 + around + 1 - start[a]) as usize);
        let mut labels = vec![];
        for z in 0..size[2] as i64 {
            for y in 0..size[1] as i64 {
                labels
                    .extend((0..size[0] as i64).map(|x| self.at([start[0] + x, start[1] + y, start[2] + z])));
            }
        }
        let mut out = vec![];
        quads_of(&LabelBlock { start, size, labels: &labels }, self.dims, cells, steps, wanted, &mut out);
        out
    }

    /// All sides, from boxes of so many cells.
    fn all_sides(&self, part: u64, steps: u32, wanted: impl Fn(i32) -> bool) -> Vec<Side> {
        let ends = |a: usize| (0..=self.dims[a]).step_by(part as usize).map(move |lo| [lo, lo + part]);
        let mut sides = vec![];
        for z in ends(2) {
            for y in ends(1) {
                for x in ends(0) {
                    let cells = [x, y, z].into_iter().zip(self.dims);
                    let cells: Vec<_> = cells.map(|([lo, hi], n)| [lo, hi.min(n + 1)]).collect();
                    sides.extend(self.sides([cells[0], cells[1], cells[2]], steps, &wanted));
                }
            }
        }
        sides.sort_unstable();
        sides
    }

    fn meshes(&self, part: u64, steps: u32, wanted: impl Fn(i32) -> bool) -> Meshes {
        let world = WorldMap::of_samples(&Geometry { spacing: [1.0, 2.0, 0.5], ..Geometry::default() });
        let (mut builder, sides) = (LabelBuilder::new(&world, u64::MAX), self.all_sides(part, steps, wanted));
        let mesh = |sides: &[Side]| {
            let mut out = StoredSurface::new(&BuilderSettings::default());
            sides.iter().for_each(|side| builder.add(side, &mut out).unwrap());
            let size = builder.end_label(&mut out).unwrap();
            (sides[0].label, (out.into_mesh().unwrap(), size))
        };
        sides.chunk_by(|a, b| a.label == b.label).map(mesh).collect()
    }

    fn voxels(&self, label: i32) -> u64 {
        self.labels.iter().filter(|l| **l == label).count() as u64
    }
}

/// Each triangle by the places of its corners, from the least one on: how often it is there, less
/// how often turned over.
fn walls(meshes: &Meshes) -> BTreeMap<[[u32; 3]; 3], (u32, i32)> {
    let mut walls = BTreeMap::new();
    for (mesh, _) in meshes.values() {
        for triangle in &mesh.triangles {
            let mut at = triangle.map(|v| mesh.vertices[v as usize].position.map(f32::to_bits));
            let first = (0..3).min_by_key(|&k| at[k]).unwrap();
            at.rotate_left(first);
            let turned = at[2] < at[1];
            if turned {
                at.swap(1, 2);
            }
            let (count, sum): &mut (u32, i32) = walls.entry(at).or_default();
            *count += 1;
            *sum += if turned { -1 } else { 1 };
        }
    }
    walls
}

/// Each mesh is closed, manifold, oriented, and has about the volume of its voxels; walls between
/// labels are there twice, once turned over.
fn expect_sound(image: &Image, meshes: &Meshes, tolerance: f64) {
    for (label, (mesh, size)) in meshes {
        let report = check(mesh);
        assert!(report.is_closed() && report.is_manifold() && report.is_oriented(), "{label}: {report:?}");
        assert_eq!(report.unreferenced_vertices, 0);
        assert_eq!((report.vertices, report.triangles), (size.vertices, size.triangles));
        assert_eq!(size.voxels, image.voxels(*label), "{label}");
        let volume = report.volume.unwrap();
        assert!(
            (volume - size.voxels as f64).abs() <= tolerance * size.voxels as f64 + 1e-4,
            "{label}: {volume}"
        );
        assert!((volume - size.volume).abs() < 1e-3 && (report.area - size.area).abs() < 1e-3);
    }
    let outer: u64 = (0..3).map(|a| 4 * image.dims[(a + 1) % 3] * image.dims[(a + 2) % 3]).sum();
    let walls = walls(meshes);
    assert!(walls.values().all(|&(count, sum)| (count, sum.abs()) == (1, 1) || (count, sum) == (2, 0)));
    assert_eq!(walls.values().filter(|wall| wall.0 == 1).count() as u64, outer);
}

#[test]
fn all_ways_to_label_eight_nodes_are_sound() {
    // Labels are named in the order of their first nodes.
    fn each(labels: &mut Vec<i32>, found: &mut u32) {
        if labels.len() == 8 {
            let image = Image { dims: [2; 3], labels: labels.clone() };
            expect_sound(&image, &image.meshes(8, 0, |label| label != NO_LABEL), 0.0);
            *found += 1;
            return;
        }
        for label in 0..=labels.iter().max().map_or(0, |most| most + 1) {
            labels.push(label);
            each(labels, found);
            labels.pop();
        }
    }
    let mut found = 0;
    each(&mut vec![], &mut found);
    assert_eq!(found, 4140);
}

#[test]
fn two_labels_around_a_face_are_sound_with_all_neighbours() {
    // All twelve nodes of two cells with a face in common: tied faces are seen from either side.
    for bits in 0..1u32 << 12 {
        let labels = (0..12).map(|n| (bits >> n & 1) as i32).collect();
        let image = Image { dims: [2, 2, 3], labels };
        expect_sound(&image, &image.meshes(8, 0, |label| label != NO_LABEL), 0.0);
    }
}

#[test]
fn neither_boxes_nor_other_labels_change_a_mesh() {
    let image = Image::made([11, 10, 9], 40);
    for steps in [0, 7] {
        let all = image.meshes(100, steps, |label| label != NO_LABEL);
        let volumes = if steps == 0 { 0.0 } else { 0.9 };
        expect_sound(&image, &all, volumes);
        assert_eq!(image.meshes(4, steps, |label| label != NO_LABEL), all);
        for label in [0, 3, 39] {
            let alone = image.meshes(5, steps, |l| l == label);
            assert_eq!((alone.len(), &alone[&label]), (1, &all[&label]), "{label}");
        }
    }
}

#[test]
fn smoothing_keeps_volumes_and_rounds_a_ball() {
    let dims = [32; 3];
    let label = |i: i32| {
        let squared: i32 = [i % 32, i / 32 % 32, i / 1024].iter().map(|c| (2 * c - 31).pow(2)).sum();
        i32::from(squared < 22 * 22)
    };
    let image = Image { dims, labels: (0..32 * 32 * 32).map(label).collect() };
    let [rough, smooth] = [0, 20].map(|steps| image.meshes(40, steps, |label| label != NO_LABEL));
    expect_sound(&image, &rough, 0.0);
    expect_sound(&image, &smooth, 0.01);
    // The area of a ball of cubes is half as large again; here z is four times finer than y.
    assert!(smooth[&1].1.area < 0.82 * rough[&1].1.area);
    // The faces of the domain stay where they are.
    let corner = |mesh: &TriMesh| {
        mesh.vertices.iter().fold([f32::MAX; 3], |least, v| [0, 1, 2].map(|a| least[a].min(v.position[a])))
    };
    assert_eq!(corner(&smooth[&0].0), [-0.5, -1.0, -0.25]);
}
