//! Marching cubes (Lorensen and Cline 1987): look at every cell.
//!
//! The eight corners of a cube, inside or outside, are a number of eight bits; a table says which
//! triangles such a cube has. Those on the left of a cube are those on the right of the one before.
//! The table here is derived, not typed in: on each face of a cube, walked around counter-clockwise
//! as seen from outside, a run of inside corners is cut off by a segment, from where it is entered
//! to where it is left. A segment ends on an edge where the segment of the neighbouring face
//! begins, so they close to loops, which are cut into triangles. As a face's segments follow from
//! its own corners, neighbouring cubes agree and the surface is closed, which the published table
//! is not.
//!
//! O(n) time, no memory. Of tetrahedra the same is done with four corners.

use super::{CORNERS, Cells, Method, NOTHING, coordinates, sample_of};
use isospan::Result;
use isospan::grid::Geometry;
use isospan::mesh::tet::is_active;
use isospan::surface::{TriMesh, Vertex};

/// Looks at every cell.
pub(crate) struct Marching;

impl Method for Marching {
    fn bytes(&self) -> u64 {
        0
    }

    fn active(&mut self, cells: &Cells<'_>, isovalue: f32, found: &mut Vec<u32>) -> Result<()> {
        match *cells {
            Cells::Cubes { dims, samples } => {
                scan([[0; 3], dims.map(|d| d - 1)], dims, samples, isovalue, |id, _| found.push(id));
            }
            Cells::Tets { .. } => {
                let all = cells.ranges().zip(0..).filter(|&((lo, hi), _)| is_active(lo, hi, isovalue));
                found.extend(all.map(|(_, id): (_, u32)| id));
            }
        }
        Ok(())
    }
}

/// Calls `each` with the number and the case of each active cube of a box of cubes, from `lo` to
/// before `hi`.
pub(crate) fn scan(
    [lo, hi]: [[usize; 3]; 2],
    dims: [usize; 3],
    samples: &[f32],
    isovalue: f32,
    mut each: impl FnMut(u32, u8),
) {
    let cubes = dims.map(|d| d - 1);
    for (z, y) in (lo[2]..hi[2]).flat_map(|z| (lo[1]..hi[1]).map(move |y| (z, y))) {
        let rows = [[y, z], [y + 1, z], [y, z + 1], [y + 1, z + 1]]
            .map(|[y, z]| &samples[sample_of(dims, [lo[0], y, z])..sample_of(dims, [hi[0], y, z]) + 1]);
        // Bits 0, 2, 4, 6 of a case: the corners at x.
        let side =
            |x: usize| (0..4).fold(0u8, |bits, row| bits | u8::from(rows[row][x] >= isovalue) << (2 * row));
        let mut left = side(0);
        for x in lo[0]..hi[0] {
            let right = side(x - lo[0] + 1);
            let case = left | right << 1;
            if case != 0 && case != u8::MAX {
                each(sample_of(cubes, [x, y, z]) as u32, case);
            }
            left = right;
        }
    }
}

/// An edge of a cube: its corner of lower coordinates, and its axis.
type Edge = (usize, usize);

/// Loops of edges of each case, each counter-clockwise as seen from where values are lower.
fn loops(case: u8) -> Vec<Vec<Edge>> {
    let inside = |c: usize| case >> c & 1 == 1;
    // next[edge]: the edge that follows on a loop.
    let mut next: Vec<(Edge, Edge)> = vec![];
    for (axis, upper) in (0..3).flat_map(|a| [(a, false), (a, true)]) {
        let (b, c) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
        let base = if upper { 1 << axis } else { 0 };
        let mut around = [base, base + b, base + b + c, base + c];
        if !upper {
            around.reverse();
        }
        let edge = |i: usize| -> Edge {
            let (p, q) = (around[i % 4], around[(i + 1) % 4]);
            (p & q, (p ^ q).trailing_zeros() as usize)
        };
        for entry in (0..4).filter(|&i| !inside(around[i]) && inside(around[(i + 1) % 4])) {
            let exit = (entry + 1..entry + 4)
                .find(|&i| inside(around[i % 4]) && !inside(around[(i + 1) % 4]))
                .expect("what is entered is left: there is a corner outside");
            next.push((edge(entry), edge(exit)));
        }
    }
    let mut out = vec![];
    while let Some((first, mut at)) = next.pop() {
        let mut one = vec![first];
        while at != first {
            one.push(at);
            let place = next.iter().position(|n| n.0 == at).expect("segments close to loops");
            at = next.swap_remove(place).1;
        }
        out.push(one);
    }
    out
}

/// The surface of a grid, in the world; triangles are counter-clockwise as seen from where values
/// are lower.
pub(crate) fn surface(dims: [usize; 3], samples: &[f32], geometry: &Geometry, isovalue: f32) -> TriMesh {
    let table: Vec<Vec<Vec<Edge>>> = (0..=u8::MAX).map(loops).collect();
    let cubes = dims.map(|d| d - 1);
    let mut mesh = TriMesh::default();
    // The vertex of each edge, three a sample.
    let mut numbers = vec![u32::MAX; 3 * samples.len()];
    let mirrors = geometry.mirrors();
    scan([[0; 3], cubes], dims, samples, isovalue, |id, case| {
        let cube = coordinates(cubes, id as usize);
        for one in &table[usize::from(case)] {
            let corners: Vec<u32> = one
                .iter()
                .map(|&(corner, axis)| {
                    let at: [usize; 3] = std::array::from_fn(|k| cube[k] + CORNERS[corner][k]);
                    let number = &mut numbers[3 * sample_of(dims, at) + axis];
                    if *number == u32::MAX {
                        *number = mesh.vertices.len() as u32;
                        mesh.vertices.push(vertex(dims, samples, geometry, isovalue, at, axis));
                    }
                    *number
                })
                .collect();
            for i in 1..corners.len() - 1 {
                let [a, b, c] = [corners[0], corners[i], corners[i + 1]];
                mesh.triangles.push(if mirrors { [a, c, b] } else { [a, b, c] });
            }
        }
    });
    mesh
}

fn vertex(
    dims: [usize; 3],
    samples: &[f32],
    geometry: &Geometry,
    isovalue: f32,
    at: [usize; 3],
    axis: usize,
) -> Vertex {
    let mut end = at;
    end[axis] += 1;
    let [a, b] = [at, end].map(|p| f64::from(samples[sample_of(dims, p)]));
    let mut ijk = at.map(|i| i as f64);
    ijk[axis] += (f64::from(isovalue) - a) / (b - a);
    Vertex { position: geometry.to_world(ijk).map(|x| x as f32), normal: [0.0; 3] }
}

/// Smallest and largest of some samples.
pub(crate) fn range_of(samples: impl Iterator<Item = f32>) -> (f32, f32) {
    samples.fold(NOTHING, |(lo, hi), v| (lo.min(v), hi.max(v)))
}
