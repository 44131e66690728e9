//! Cuts triangles at the planes of an octree, in whole numbers.
//!
//! A vertex on an edge that is cut depends on the ends of the edge alone. So the triangles on both
//! sides of an edge get the same vertices, and no crack opens, however coarse the numbers are.

/// Steps of a lattice along the edge of a cell: what 16 bits count.
pub(super) const CELL: i64 = u16::MAX as i64;
/// Where a cell is halved, as neuroglancer does: the step after half of the largest number.
pub(super) const HALF: i64 = 1 << 15;

/// A vertex, in steps of the lattice; none is negative.
pub(super) type Place = [i64; 3];

/// Cuts a triangle at the planes between cells, and where `halves` says so at those through their
/// middles. The pieces are appended; what has two equal corners is left out.
pub(super) fn cut(triangle: [Place; 3], halves: bool, out: &mut Vec<[Place; 3]>) {
    let mut pieces = vec![triangle];
    for axis in 0..3 {
        let mut done = vec![];
        while let Some(piece) = pieces.pop() {
            let [lo, hi] = span(&piece, axis);
            let plane = next_plane(lo, halves);
            if plane >= hi {
                done.push(piece);
                continue;
            }
            let [below, above] = split(&piece, axis, plane);
            done.extend(below.triangles());
            pieces.extend(above.triangles());
        }
        pieces = done;
    }
    out.extend(pieces.into_iter().filter(|[a, b, c]| a != b && b != c && c != a));
}

/// The least and the largest coordinate of corners.
pub(super) fn span(corners: &[Place; 3], axis: usize) -> [i64; 2] {
    let [a, b, c] = corners.map(|corner| corner[axis]);
    [a.min(b).min(c), a.max(b).max(c)]
}

/// The first plane beyond a coordinate.
fn next_plane(x: i64, halves: bool) -> i64 {
    let (cell, within) = (x / CELL, x % CELL);
    cell * CELL + if halves && within < HALF { HALF } else { CELL }
}

/// What of a triangle lies on one side of a plane: at most four corners.
#[derive(Default)]
struct Polygon {
    corners: [Place; 4],
    count: usize,
}

impl Polygon {
    fn push(&mut self, corner: Place) {
        self.corners[self.count] = corner;
        self.count += 1;
    }

    fn triangles(&self) -> impl Iterator<Item = [Place; 3]> + use<> {
        let [a, b, c, d] = self.corners;
        [[a, b, c], [a, c, d]].into_iter().take(self.count.saturating_sub(2))
    }
}

/// The parts below and above a plane that a triangle crosses.
fn split(corners: &[Place; 3], axis: usize, plane: i64) -> [Polygon; 2] {
    let [mut below, mut above] = [Polygon::default(), Polygon::default()];
    for (n, &from) in corners.iter().enumerate() {
        let to = corners[(n + 1) % 3];
        if from[axis] <= plane {
            below.push(from);
        }
        if from[axis] >= plane {
            above.push(from);
        }
        if (from[axis] < plane && to[axis] > plane) || (from[axis] > plane && to[axis] < plane) {
            let at = crossing(from, to, axis, plane);
            below.push(at);
            above.push(at);
        }
    }
    [below, above]
}

/// Where an edge crosses a plane, to the nearest step; from whichever end it is looked at.
fn crossing(from: Place, to: Place, axis: usize, plane: i64) -> Place {
    let (from, to) = if from[axis] < to[axis] { (from, to) } else { (to, from) };
    let (done, all) = (i128::from(plane - from[axis]), i128::from(to[axis] - from[axis]));
    std::array::from_fn(|a| match a == axis {
        true => plane,
        // Rounded down, of a quotient to which a half was added.
        false => from[a] + (2 * i128::from(to[a] - from[a]) * done + all).div_euclid(2 * all) as i64,
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::collections::HashMap;

    /// Numbers that are not random.
    struct Lcg(u64);

    impl Lcg {
        fn below(&mut self, n: i64) -> i64 {
            self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((self.0 >> 33) as i64) % n
        }
    }

    /// Edges that are not used as often in one direction as in the other.
    pub(in super::super) fn open_edges(triangles: &[[Place; 3]]) -> usize {
        let mut edges: HashMap<[Place; 2], i64> = HashMap::new();
        for t in triangles {
            for n in 0..3 {
                let (a, b) = (t[n], t[(n + 1) % 3]);
                let (edge, sign) = if a < b { ([a, b], 1) } else { ([b, a], -1) };
                *edges.entry(edge).or_default() += sign;
            }
        }
        edges.values().filter(|sum| **sum != 0).count()
    }

    /// Twice the area of triangles as seen along z, with its sign.
    fn shadow(triangles: &[[Place; 3]]) -> i128 {
        let cross = |[a, b, c]: &[Place; 3]| {
            let [u, v] = [b, c].map(|p| [0, 1].map(|k| i128::from(p[k] - a[k])));
            u[0] * v[1] - u[1] * v[0]
        };
        triangles.iter().map(cross).sum()
    }

    #[test]
    fn pieces_of_closed_surfaces_are_closed_and_lie_in_cells() {
        let mut random = Lcg(7);
        for size in [3, 40_000, 65_535, 1 << 18, 1 << 33] {
            for halves in [false, true] {
                for _ in 0..40 {
                    // A tetrahedron, often with corners on planes.
                    let corner = |random: &mut Lcg| -> Place {
                        std::array::from_fn(|_| match random.below(4) {
                            0 if size > CELL => CELL * random.below(size / CELL + 1),
                            _ => random.below(size),
                        })
                    };
                    let p: Vec<Place> = (0..4).map(|_| corner(&mut random)).collect();
                    let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]].map(|t| t.map(|v| p[v]));
                    let mut pieces = vec![];
                    // A triangle of 2^33 steps has too many pieces.
                    if size > 1 << 20 {
                        let near = |c: Place| c.map(|x| (1 << 33) + x % (1 << 18));
                        faces.iter().for_each(|t| cut(t.map(near), halves, &mut pieces));
                    } else {
                        faces.iter().for_each(|t| cut(*t, halves, &mut pieces));
                    }
                    assert_eq!(open_edges(&pieces), 0);
                    for piece in &pieces {
                        for axis in 0..3 {
                            let [lo, hi] = span(piece, axis);
                            assert!(next_plane(lo, halves) >= hi, "{piece:?}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_plane_triangle_keeps_its_area() {
        let triangle = [[10, 20, 5], [400_000, 30, 5], [200_000, 300_000, 5]];
        let mut pieces = vec![];
        cut(triangle, true, &mut pieces);
        assert!(pieces.len() > 100, "{}", pieces.len());
        let (all, whole) = (shadow(&pieces), shadow(&[triangle]));
        // Each rounded vertex moves by half a step at most.
        assert!((all - whole).abs() < 4 * 400_000, "{all} {whole}");
        // In one cell nothing is cut.
        let small = [[1, 2, 3], [4, 5, 6], [CELL, 1, 1]];
        pieces.clear();
        cut(small, false, &mut pieces);
        assert_eq!(pieces, [small]);
        cut([[1; 3], [2; 3], [1; 3]], false, &mut pieces);
        assert_eq!(pieces.len(), 1);
    }
}
