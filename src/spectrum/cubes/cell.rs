//! What one cell contributes at one isovalue: its piece of marching cubes, which has an area and
//! encloses a volume.
//!
//! Corner c lies at the bits of c: x is bit 0, y bit 1, z bit 2. Walked around, a face has runs of
//! corners inside; each run is cut off by a segment, from the edge where the walk enters it to the
//! edge where it leaves it. So two corners inside that lie on a diagonal are kept apart. The two
//! faces of an edge walk it in opposite directions, so each crossed edge is entered once and left
//! once: the segments close to loops by themselves. A loop of n edges is a fan of n - 2 triangles,
//! none of which lies in a face of the cell.

use isospan_io::geom::vec3::{cross, dot, minus};
use std::sync::LazyLock;

/// A place, or a direction, in the unit cube.
type CellPlace = [f64; 3];

/// The shape of a cell in the world.
#[derive(Clone, Copy)]
pub(super) struct World {
    /// Cross products of two edges each: what takes an area in the unit cube to one in the world,
    /// and a gradient to one in the world times the volume.
    normals: [[f64; 3]; 3],
    /// Volume of a cell.
    pub(super) volume: f64,
}

impl World {
    /// Of cells with these edges.
    pub(super) fn new([x, y, z]: [[f64; 3]; 3]) -> Self {
        let normals = [cross(y, z), cross(z, x), cross(x, y)];
        Self { normals, volume: dot(x, normals[0]).abs() }
    }

    /// The area of a piece of this area vector in the unit cube.
    #[inline(always)]
    fn area(&self, s: CellPlace) -> f64 {
        let [x, y, z] = &self.normals;
        let v = [0, 1, 2].map(|i| s[0] * x[i] + s[1] * y[i] + s[2] * z[i]);
        dot(v, v).sqrt()
    }

    /// The length of a gradient.
    #[inline(always)]
    fn gradient(&self, g: CellPlace) -> f64 {
        if self.volume > 0.0 { self.area(g) / self.volume } else { 0.0 }
    }
}

/// What a cell has at an isovalue.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cut {
    /// Area in the world.
    pub(super) area: f64,
    /// Gradient times area.
    pub(super) gradient: f64,
    /// The share of the cell inside.
    pub(super) inside: f64,
    /// The share of its corners.
    pub(super) corners: f64,
}

/// The part of the surface in a cell with these corner values less the isovalue, not all of which
/// are on one side.
#[inline(always)]
pub(super) fn cut(values: &[f64; 8], world: &World, cases: &Cases) -> Cut {
    let corners = (0..8).fold(0, |bits, c| bits | usize::from(values[c] >= 0.0) << c);
    let case = &cases[corners];
    // Of all edges, those that are not crossed too: so vectors can do it.
    let along: [f64; 12] = std::array::from_fn(
        #[inline(always)]
        |edge| {
            let [a, b] = ENDS[edge].map(|c| values[usize::from(c)]);
            a / (a - b)
        },
    );
    // Three times the volume, by the theorem of Gauss: the faces at 0 add nothing.
    let mut thrice: f64 =
        case.runs[..usize::from(case.run_count)].iter().map(|run| run.area(corners, &along)).sum();
    let mut out = Cut::default();
    let mut from = 0;
    for &length in &case.lengths[..usize::from(case.loop_count)] {
        let edges = &case.edges[from..from + usize::from(length)];
        from += edges.len();
        let first = crossing(edges[0], &along);
        let second = crossing(edges[1], &along);
        let (mut sum, mut before) = (add(first, second), minus(second, first));
        let mut area = 0.0;
        for &edge in &edges[2..] {
            let place = crossing(edge, &along);
            let side = minus(place, first);
            let normal = cross(before, side).map(|s| s * 0.5);
            area += world.area(normal);
            thrice += dot(first, normal);
            (sum, before) = (add(sum, place), side);
        }
        let middle = sum.map(|s| s / edges.len() as f64);
        out.area += area;
        out.gradient += area * world.gradient(gradient(values, middle));
    }
    out.inside = thrice / 3.0;
    out.corners = f64::from(corners.count_ones()) / 8.0;
    out
}

/// How the surface runs through a cell, by the corners that are inside.
#[derive(Clone, Copy, Default)]
pub(super) struct Case {
    /// The edges of all loops, and how many each has.
    edges: [u8; 12],
    lengths: [u8; 4],
    loop_count: u8,
    /// Runs of corners on the three faces at 1.
    runs: [Run; 6],
    run_count: u8,
}

/// Corners inside that follow each other around a face.
#[derive(Clone, Copy, Default)]
struct Run {
    corners: u8,
    /// The edges before and behind.
    enters: u8,
    leaves: u8,
}

impl Run {
    /// The area inside.
    #[inline(always)]
    fn area(&self, corners: usize, along: &[f64; 12]) -> f64 {
        let inside = |edge: u8| {
            let edge = usize::from(edge);
            if corners >> ENDS[edge][0] & 1 != 0 { along[edge] } else { 1.0 - along[edge] }
        };
        if self.corners == 4 {
            return 1.0;
        }
        let (a, b) = (inside(self.enters), inside(self.leaves));
        match self.corners {
            1 => a * b / 2.0,
            2 => (a + b) / 2.0,
            _ => 1.0 - (1.0 - a) * (1.0 - b) / 2.0,
        }
    }
}

/// All cases.
pub(super) type Cases = [Case; 256];
pub(super) static CASES: LazyLock<Cases> = LazyLock::new(|| std::array::from_fn(Case::new));

impl Case {
    fn new(corners: usize) -> Self {
        let mut case = Self::default();
        let mut next = [None; 12];
        for axis in 0..3 {
            for far in [false, true] {
                for run in runs(corners, &face(axis, far)) {
                    if run.corners < 4 {
                        next[usize::from(run.enters)] = Some(run.leaves);
                    }
                    if far {
                        case.runs[usize::from(case.run_count)] = run;
                        case.run_count += 1;
                    }
                }
            }
        }
        let mut count = 0;
        for first in 0..12 {
            let (mut edge, mut found) = (first, vec![]);
            while let Some(then) = next[usize::from(edge)].take() {
                found.push(edge);
                edge = then;
            }
            if !found.is_empty() {
                let start = (0..found.len()).min_by_key(|start| flat(&found, *start));
                found.rotate_left(start.expect("a loop has edges"));
                case.edges[count..count + found.len()].copy_from_slice(&found);
                case.lengths[usize::from(case.loop_count)] = found.len() as u8;
                case.loop_count += 1;
                count += found.len();
            }
        }
        case
    }
}

/// How many triangles of the fan from an edge of a loop lie in a face of the cell.
fn flat(found: &[u8], start: usize) -> usize {
    let corners = |edge: u8| {
        let [a, b] = ENDS[usize::from(edge)];
        1 << a | 1 << b
    };
    let at = |n: usize| corners(found[(start + n) % found.len()]);
    let faces = (0..6).map(|n| face(n / 2, n % 2 != 0).iter().fold(0u32, |bits, c| bits | 1 << c));
    let triangles = (2..found.len()).map(|n| at(0) | at(n - 1) | at(n));
    let faces: Vec<u32> = faces.collect();
    triangles.filter(|triangle| faces.iter().any(|face| triangle & !face == 0)).count()
}

/// The corners of a face in the order of a walk around it, to the left seen from outside.
fn face(axis: usize, far: bool) -> [usize; 4] {
    let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    if far { [0, u, u | v, v].map(|c| c | 1 << axis) } else { [0, v, u | v, u] }
}

/// The runs of corners inside on a face.
fn runs(corners: usize, face: &[usize; 4]) -> Vec<Run> {
    let is_inside = |n: usize| corners >> face[n % 4] & 1 != 0;
    let edge = |n: usize| edge_of(face[n % 4], face[(n + 1) % 4]);
    if (0..4).all(is_inside) {
        return vec![Run { corners: 4, ..Run::default() }];
    }
    let starts = (0..4).filter(|&n| is_inside(n + 1) && !is_inside(n));
    let run = |n: usize| {
        let corners = (1..4).take_while(|i| is_inside(n + i)).count();
        Run { corners: corners as u8, enters: edge(n), leaves: edge(n + corners) }
    };
    starts.map(run).collect()
}

/// The number of an edge.
fn edge_of(a: usize, b: usize) -> u8 {
    let edge = ENDS.iter().position(|ends| ends.map(usize::from) == [a.min(b), a.max(b)]);
    edge.expect("corners of an edge") as u8
}

/// The lower and the upper corner of each edge.
const ENDS: [[u8; 2]; 12] =
    [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [4, 6], [1, 3], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

/// Where the surface crosses an edge, by how far that is from the lower corner.
#[inline(always)]
fn crossing(edge: u8, along: &[f64; 12]) -> CellPlace {
    let mut place = STARTS[usize::from(edge)];
    place[usize::from(edge / 4)] = along[usize::from(edge)];
    place
}

/// The lower corner of each edge.
const STARTS: [CellPlace; 12] = {
    let mut starts = [[0.0; 3]; 12];
    let mut n = 0;
    while n < 36 {
        starts[n / 3][n % 3] = (ENDS[n / 3][0] >> (n % 3) & 1) as f64;
        n += 1;
    }
    starts
};

/// The gradient of the trilinear field.
#[inline(always)]
fn gradient(f: &[f64; 8], place: CellPlace) -> CellPlace {
    [0, 1, 2].map(|axis| {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let slope = |low: usize| f[low | 1 << axis] - f[low];
        let at = |low: usize| slope(low) + (slope(low | 1 << u) - slope(low)) * place[u];
        at(0) + (at(1 << v) - at(0)) * place[v]
    })
}

#[inline(always)]
fn add(a: CellPlace, b: CellPlace) -> CellPlace {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    #[test]
    fn a_corner_is_an_eighth_of_an_octahedron() {
        let world = World::new(UNIT);
        for corner in 0..8 {
            let mut values = [-1.0; 8];
            values[corner] = 1.0;
            let one = cut(&values, &world, &CASES);
            let area = 3f64.sqrt() / 8.0;
            assert!((one.area - area).abs() < 1e-12, "{one:?}");
            assert!((one.inside - 1.0 / 48.0).abs() < 1e-12, "{corner}: {one:?}");
            let rest = cut(&values.map(|v| -v), &world, &CASES);
            assert!((rest.area - area).abs() < 1e-12);
            assert!((rest.inside + one.inside - 1.0).abs() < 1e-12, "{corner}: {rest:?}");
        }
    }

    #[test]
    fn all_cases_are_closed_and_keep_corners_inside_apart() {
        let mut triangles = 0;
        for corners in 1..255usize {
            let case = CASES[corners];
            let crossed = (0..12).filter(|&edge| {
                let [a, b]: [u8; 2] = ENDS[edge];
                (corners >> a ^ corners >> b) & 1 != 0
            });
            let lengths = &case.lengths[..usize::from(case.loop_count)];
            assert_eq!(lengths.iter().sum::<u8>() as usize, crossed.count());
            assert!(lengths.iter().all(|n| *n >= 3), "{corners:08b}");
            let mut from = 0;
            for length in lengths.iter().map(|n| usize::from(*n)) {
                assert_eq!(flat(&case.edges[from..from + length], 0), 0, "{corners:08b}");
                from += length;
            }
            let values = std::array::from_fn(|c| if corners >> c & 1 != 0 { 1.0 } else { -1.0 });
            let share = cut(&values, &World::new(UNIT), &CASES).inside;
            assert!(0.0 < share && share < 1.0, "{corners:08b}: {share}");
            triangles += lengths.iter().map(|n| usize::from(*n) - 2).sum::<usize>();
        }
        // As many as Flying Edges makes.
        assert_eq!(triangles, 820);
        let opposite = CASES[1 << 0 | 1 << 3];
        assert_eq!((opposite.loop_count, &opposite.lengths[..2]), (2, &[3, 3][..]));
        let around = CASES[255 ^ (1 << 0 | 1 << 3)];
        assert_eq!((around.loop_count, around.lengths[0]), (1, 6));
    }
}
