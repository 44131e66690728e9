//! A vertex for each fan of triangles.
//!
//! Where tetrahedra are missing (void ones around missing samples, those outside of a mesh), the
//! ones around a mesh edge can form several separate groups. The surface crosses the edge in one
//! vertex, and has a fan of triangles there for each group:
//!
//! ```text
//!      \  A  /              A and B have the vertex v in common and no edge at it: the surface is no manifold
//!       \ | /               there. So the first fan (that of the lowest triangle) keeps v, and each
//!   ─────(v)─────  rim      other gets a vertex of its own at the same place, with the same normal.
//!       / | \
//!      /  B  \
//! ```
//!
//! # How does it work?
//!
//! A fan that is not closed has two edges of the rim at v, a closed one none; around a mesh edge
//! there is one closed fan or some open ones. So first the vertices of the rim are found: each
//! triangle adds at each corner a hash of the next corner and takes away one of the one before;
//! where an edge has both its triangles, the two cancel. (A rim vertex passes for an inner one with
//! probability 2^-64.) Then the corners at rim vertices are sorted by vertex and triangle, the fans
//! of each vertex are separated by union-find, and the triangles of further fans are rewritten.
//!
//! # Cost
//!
//! Two passes over the triangles, and one more with a copy of them if a vertex was split; 8 bytes a
//! vertex, in pages within the memory given. New vertices follow the old ones, in the order of the
//! vertices that they are made from: a function of the surface alone.

use crate::surface::model::{SurfaceSource, Vertex};
use crate::surface::weld::{BuilderSettings, StoredSurface};
use isospan_io::bytes::paged::Paged;
use isospan_io::bytes::sorter::{Sorted, Sorter};
use isospan_io::bytes::store::Store;
use isospan_io::error::{Error, Result};

/// A corner at a vertex of the rim: the vertex, the triangle, the corners next and before.
type Corner = [u64; 4];
/// A vertex that a triangle gets: the triangle, the vertex before, the new one.
type Change = [u64; 3];

/// Splits the vertices at which several fans meet. An oriented surface whose edges have at most two
/// triangles is then a manifold. `memory` bounds what is held besides the surface; `settings` says
/// where the surface is stored.
///
/// # Errors
/// [`Error::Usage`] when there would be 2^32 vertices or more; [`Error::Io`] for the scratch
/// folder.
pub fn split_fans(
    mut surface: StoredSurface,
    settings: &BuilderSettings,
    memory: u64,
) -> Result<StoredSurface> {
    let share = usize::try_from(memory / 4).unwrap_or(usize::MAX);
    let corners = corners_at_rim(&surface, share, settings)?;
    let mut changes = Sorter::new(share, &settings.scratch);
    let copies = fans(&surface, corners.finish()?, &mut changes, share, settings)?;
    if copies.len() > 0 {
        copies.each(&mut |batch| batch.iter().try_for_each(|&v| surface.push_vertex(v)))?;
        let mut changes = changes.finish()?;
        let mut next = changes.next()?;
        surface.rewrite_triangles(settings, |number, triangle| {
            while let Some([_, old, new]) = next.filter(|c| c[0] == number) {
                let corner = triangle.iter_mut().find(|v| u64::from(**v) == old);
                *corner.expect("the triangle had the vertex") = new as u32;
                next = changes.next()?;
            }
            Ok(())
        })?;
    }
    Ok(surface)
}

/// The corners of triangles at vertices of the rim.
fn corners_at_rim(
    surface: &StoredSurface,
    memory: usize,
    settings: &BuilderSettings,
) -> Result<Sorter<Corner>> {
    let mut sums = Paged::<u64>::new(surface.vertex_count(), memory as u64, &settings.scratch);
    each_corner(surface, |[v, _, next, before]| {
        let sum = sums.change(v)?;
        *sum = sum.wrapping_add(hash(next)).wrapping_sub(hash(before));
        Ok(())
    })?;
    let mut corners = Sorter::new(memory, &settings.scratch);
    each_corner(surface, |corner| if sums.get(corner[0])? == 0 { Ok(()) } else { corners.push(corner) })?;
    Ok(corners)
}

fn each_corner(surface: &StoredSurface, mut each: impl FnMut(Corner) -> Result<()>) -> Result<()> {
    let mut number = 0;
    surface.triangles(&mut |batch| {
        for triangle in batch {
            let [a, b, c] = triangle.map(u64::from);
            each([a, number, b, c])?;
            each([b, number, c, a])?;
            each([c, number, a, b])?;
            number += 1;
        }
        Ok(())
    })
}

/// SplitMix64's finalizer (Steele, Lea, Flood 2014).
fn hash(v: u64) -> u64 {
    let x = v.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Adds the changes that further fans need to `changes`, and returns the vertices for them.
fn fans(
    surface: &StoredSurface,
    mut corners: Sorted<Corner>,
    changes: &mut Sorter<Change>,
    memory: usize,
    settings: &BuilderSettings,
) -> Result<Store<Vertex>> {
    let mut copies = Store::new(memory / 2, &settings.scratch);
    let mut vertices = surface.random_vertices(memory / 2);
    let (mut around, mut fan_of) = (vec![], vec![]);
    let mut next = corners.next()?;
    while let Some(first) = next {
        around.clear();
        while let Some(corner) = next.filter(|c| c[0] == first[0]) {
            around.push(corner);
            next = corners.next()?;
        }
        let fans = number_fans(&around, &mut fan_of);
        if fans < 2 {
            continue;
        }
        let vertex = vertices.get(first[0])?;
        let new = surface.vertex_count() + copies.len();
        if new + fans > u64::from(u32::MAX) {
            return Err(Error::usage(format!(
                "the surface has more than {} vertices, the most that files with 32-bit vertex numbers hold",
                u32::MAX
            )));
        }
        (1..fans).try_for_each(|_| copies.push(vertex))?;
        for (corner, &fan) in around.iter().zip(&fan_of).filter(|(_, fan)| **fan > 0) {
            changes.push([corner[1], corner[0], new + fan - 1])?;
        }
    }
    Ok(copies)
}

/// Numbers the fans of the corners at a vertex, by their first corner, and returns how many there
/// are.
fn number_fans(around: &[Corner], fan_of: &mut Vec<u64>) -> u64 {
    // Corners with a neighbour in common are next to each other once sorted.
    let mut sides: Vec<(u64, usize)> =
        around.iter().enumerate().flat_map(|(i, &[_, _, next, before])| [(next, i), (before, i)]).collect();
    sides.sort_unstable();
    fan_of.clear();
    fan_of.extend(0..around.len() as u64);
    for pair in sides.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        let (a, b) = (root(fan_of, pair[0].1), root(fan_of, pair[1].1));
        fan_of[a.max(b)] = a.min(b) as u64;
    }
    let mut fans = 0;
    for i in 0..around.len() {
        let parent = fan_of[i] as usize;
        fan_of[i] = if parent == i { fans } else { fan_of[parent] };
        fans += u64::from(parent == i);
    }
    fans
}

/// The root of a corner, halving the path on the way.
fn root(parents: &mut [u64], mut i: usize) -> usize {
    while parents[i] != i as u64 {
        parents[i] = parents[parents[i] as usize];
        i = parents[i] as usize;
    }
    i
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::TriMesh;
    use crate::surface::check::check;

    fn stored(vertices: u32, triangles: &[[u32; 3]], settings: &BuilderSettings) -> StoredSurface {
        let mut surface = StoredSurface::new(settings);
        for v in 0..vertices {
            let position = [v as f32, (v * v) as f32, (v % 3) as f32];
            surface.push_vertex(Vertex { position, ..Vertex::default() }).unwrap();
        }
        triangles.iter().for_each(|&t| surface.push_triangle(t).unwrap());
        surface
    }

    #[test]
    fn each_fan_gets_a_vertex_and_nothing_else_changes() {
        let scratch = tempfile::tempdir().unwrap();
        for memory_bytes in [0, 1 << 20] {
            let settings = BuilderSettings { memory_bytes, scratch: scratch.path().to_path_buf() };
            // Three fans at vertex 0: triangles 0 and 3, 1, 2 and 4; and a tetrahedron, which is
            // closed.
            let triangles = [[0, 1, 2], [5, 0, 4], [0, 6, 7], [2, 3, 0], [7, 8, 0]];
            let closed = [[9, 10, 11], [10, 9, 12], [11, 10, 12], [9, 11, 12]];
            let all: Vec<[u32; 3]> = triangles.into_iter().chain(closed).collect();
            let surface = stored(13, &all, &settings);
            assert_eq!(check(&TriMesh::from_source(&surface).unwrap()).non_manifold_vertices, 1);
            let split =
                TriMesh::from_source(&split_fans(surface, &settings, memory_bytes as u64).unwrap()).unwrap();
            assert_eq!(split.vertices.len(), 15);
            assert_eq!(split.triangles[..5], [[0, 1, 2], [5, 13, 4], [14, 6, 7], [2, 3, 0], [7, 8, 14]]);
            assert_eq!(split.triangles[5..], closed);
            assert!(split.vertices[13] == split.vertices[0] && split.vertices[14] == split.vertices[0]);
            assert_eq!(check(&split).non_manifold_vertices, 0);
        }
    }

    #[test]
    fn a_manifold_stays_as_it_is() {
        let settings = BuilderSettings { memory_bytes: 1 << 20, ..BuilderSettings::default() };
        // A strip, whose vertices all lie on the rim.
        let strip: Vec<[u32; 3]> =
            (0..50).map(|i| if i % 2 == 0 { [i, i + 1, i + 2] } else { [i + 1, i, i + 2] }).collect();
        let before = TriMesh::from_source(&stored(52, &strip, &settings)).unwrap();
        let after = split_fans(stored(52, &strip, &settings), &settings, 1 << 20).unwrap();
        assert_eq!(TriMesh::from_source(&after).unwrap(), before);
    }
}
