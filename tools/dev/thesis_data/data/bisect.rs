//! Refines a mesh to a number of vertices: the longest edge is cut in its middle, until there are
//! enough.
//!
//! All tetrahedra around the edge are cut with it, so the mesh stays conforming after each cut; no
//! vertex moves, so the shape of the body stays too. Of edges of one length the one of the lowest
//! vertices comes first. As in Rivara 1984, "Algorithms for refining triangular grids", where each
//! cell's longest edge is cut; here it is the longest of all.
//!
//! Time: a heap operation for each new edge, and the tetrahedra around an edge for each cut.
//! Memory: a list a edge.

use super::tets::{TetMesh, dot, minus};
use rustc_hash::FxHashMap;
use std::collections::BinaryHeap;

type Edge = (u32, u32);

/// Tetrahedra around edges, and edges by length.
struct Edges {
    around: FxHashMap<Edge, Vec<u32>>,
    /// Squared length, which is positive so that its bits sort as it does, and the edge, lowest
    /// first.
    longest: BinaryHeap<(u64, std::cmp::Reverse<Edge>)>,
}

fn edge(a: u32, b: u32) -> Edge {
    (a.min(b), a.max(b))
}

impl Edges {
    fn of(mesh: &TetMesh) -> Self {
        let mut edges = Self { around: FxHashMap::default(), longest: BinaryHeap::new() };
        for (t, tet) in mesh.tets.iter().enumerate() {
            for (i, j) in (0..4).flat_map(|i| (i + 1..4).map(move |j| (i, j))) {
                edges.add(mesh, edge(tet[i], tet[j]), t as u32);
            }
        }
        edges
    }

    fn add(&mut self, mesh: &TetMesh, edge: Edge, tet: u32) {
        let around = self.around.entry(edge).or_insert_with(|| {
            let along = minus(mesh.points[edge.0 as usize], mesh.points[edge.1 as usize]);
            self.longest.push((dot(along, along).to_bits(), std::cmp::Reverse(edge)));
            vec![]
        });
        around.push(tet);
    }

    fn remove(&mut self, edge: Edge, tet: u32) {
        let around = self.around.get_mut(&edge).expect("an edge of a tetrahedron is listed");
        around.retain(|&t| t != tet);
    }
}

/// Cuts edges until the mesh has `vertices` of them; values, if any, are dropped.
pub(crate) fn refine(mesh: &mut TetMesh, vertices: usize) {
    mesh.values.clear();
    let mut edges = Edges::of(mesh);
    while mesh.points.len() < vertices {
        let Some((_, std::cmp::Reverse(longest))) = edges.longest.pop() else { return };
        cut(mesh, &mut edges, longest);
    }
}

/// Cuts the edge (a, b) at m: of each tetrahedron around it, the half at a keeps the number and the
/// half at b gets a new one.
fn cut(mesh: &mut TetMesh, edges: &mut Edges, (a, b): Edge) {
    let Some(around) = edges.around.remove(&(a, b)) else { return };
    let m = mesh.points.len() as u32;
    let [from, to] = [a, b].map(|v| mesh.points[v as usize]);
    mesh.points.push(std::array::from_fn(|k| 0.5 * (from[k] + to[k])));
    for t in around {
        let old = mesh.tets[t as usize];
        let new = mesh.tets.len() as u32;
        mesh.tets[t as usize] = old.map(|v| if v == b { m } else { v });
        mesh.tets.push(old.map(|v| if v == a { m } else { v }));
        mesh.regions.push(mesh.regions[t as usize]);
        let link: Vec<u32> = old.into_iter().filter(|&v| v != a && v != b).collect();
        for &v in &link {
            edges.remove(edge(b, v), t);
            edges.add(mesh, edge(b, v), new);
            edges.add(mesh, edge(m, v), t);
            edges.add(mesh, edge(m, v), new);
        }
        edges.add(mesh, edge(link[0], link[1]), new);
        edges.add(mesh, edge(a, m), t);
        edges.add(mesh, edge(m, b), new);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tets::{FACES, tests::cube, volume6};
    use super::*;

    #[test]
    fn a_refined_cube_is_a_cube() {
        let mut mesh = cube();
        mesh.regions[2] = 7;
        refine(&mut mesh, 500);
        assert_eq!(mesh.points.len(), 500);
        let volumes: Vec<f64> = (0..mesh.tets.len()).map(|t| volume6(mesh.corners(t))).collect();
        assert!(volumes.iter().all(|&v| v > 0.0));
        assert_eq!(volumes.iter().sum::<f64>(), 6.0);
        let of_seven: f64 = volumes.iter().zip(&mesh.regions).filter(|(_, r)| **r == 7).map(|(v, _)| v).sum();
        assert_eq!(of_seven, 1.0);
        // Conforming: a face has two tetrahedra, or one and lies on a side of the cube.
        let mut faces: FxHashMap<[u32; 3], u32> = FxHashMap::default();
        for tet in &mesh.tets {
            for face in FACES {
                let mut key = face.map(|i| tet[i]);
                key.sort_unstable();
                *faces.entry(key).or_default() += 1;
            }
        }
        for (face, tets) in faces {
            let at = |side: f64, k: usize| face.iter().all(|&v| mesh.points[v as usize][k] == side);
            let on_side = (0..3).any(|k| at(0.0, k) || at(1.0, k));
            assert_eq!(tets, if on_side { 1 } else { 2 });
        }
        // The longest edges are gone: the diagonal was 1.7 long.
        let longest = Edges::of(&mesh).longest.pop().map(|l| f64::from_bits(l.0).sqrt());
        assert!(longest.is_some_and(|l| l < 0.4), "{longest:?}");
    }
}
