//! A mesh in memory as its connected components.

use crate::surface::model::TriMesh;

/// The connected components of a mesh: those of most triangles first, among equals the one that
/// begins first. Triangles keep their order, and
/// vertices come in the order of the triangles.
pub fn split(mesh: &TriMesh) -> Vec<TriMesh> {
    let mut parents: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    for &[a, b, c] in &mesh.triangles {
        join(&mut parents, a, b);
        join(&mut parents, b, c);
    }
    const NONE: u32 = u32::MAX;
    let mut numbers = vec![NONE; parents.len()];
    let mut found: Vec<TriMesh> = vec![];
    // The number of a vertex in its component.
    let mut within = vec![NONE; parents.len()];
    for triangle in &mesh.triangles {
        let root = root(&mut parents, triangle[0]) as usize;
        if numbers[root] == NONE {
            numbers[root] = found.len() as u32;
            found.push(TriMesh { origin: mesh.origin, ..TriMesh::default() });
        }
        let component = &mut found[numbers[root] as usize];
        component.triangles.push(triangle.map(|v| {
            let number = &mut within[v as usize];
            if *number == NONE {
                *number = component.vertices.len() as u32;
                component.vertices.push(mesh.vertices[v as usize]);
            }
            *number
        }));
    }
    // The sort is stable.
    found.sort_by_key(|part| std::cmp::Reverse(part.triangles.len()));
    found
}

/// The vertex that stands for the component of another; paths are halved on the way.
fn root(parents: &mut [u32], mut vertex: u32) -> u32 {
    while parents[vertex as usize] != vertex {
        let above = parents[parents[vertex as usize] as usize];
        parents[vertex as usize] = above;
        vertex = above;
    }
    vertex
}

fn join(parents: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b) as usize] = a.min(b);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::Vertex;

    #[test]
    fn components_are_apart_and_the_largest_is_first() {
        let vertices: Vec<Vertex> =
            (0..9).map(|i| Vertex { position: [i as f32, 0.0, 0.0], normal: [0.0, 0.0, 1.0] }).collect();
        let triangles = vec![[0, 1, 2], [4, 5, 3], [5, 4, 6]];
        let parts = split(&TriMesh { vertices, triangles, origin: [1.0; 3] });
        assert_eq!(parts.len(), 2);
        assert_eq!(parts[0].triangles, [[0, 1, 2], [1, 0, 3]]);
        let places: Vec<f32> = parts[0].vertices.iter().map(|v| v.position[0]).collect();
        assert_eq!(places, [4.0, 5.0, 3.0, 6.0]);
        assert_eq!((parts[1].vertices.len(), parts[1].origin), (3, [1.0; 3]));
        assert!(split(&TriMesh::default()).is_empty());
    }
}
