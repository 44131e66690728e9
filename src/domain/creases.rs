//! Where the boundary of a mesh bends: edges at which two triangles meet at an angle, and vertices
//! at which such edges end, part or turn.
//!
//! Samples spread over faces leave corners out: the tetrahedra between them cut a ridge off and
//! fill a groove. So edges and corners are found, to be sampled first
//! ([`scatter`](super::scatter)).
//!
//! # How does it work?
//!
//! Edges of the boundary's triangles are sorted, so the two triangles of an edge follow each other;
//! then edges along a space-filling curve, and their ends by vertex. Sorting is external.

use super::column::{Column, ColumnWriter};
use super::settings::StoreSettings;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::geom::curve::hilbert_key;
use isospan_io::geom::vec3::{cross, difference, dot};
use isospan_mesh::locate::{FINE_BITS, FinePos};

/// A boundary bends where normals, or edges, are further apart than 40 degrees: the cosine.
const BENT: f64 = 0.766;

/// Edges and corners of a boundary.
pub(crate) struct Creases {
    /// The two vertices of each edge and the numbers of its triangles, along a space-filling curve.
    pub(super) edges: Column<[u64; 4]>,
    /// Vertex and number of an edge, for each edge at a corner, by vertices.
    pub(super) corners: Column<[u64; 2]>,
}

impl Creases {
    /// The creases of the triangles of a boundary (three vertices, body).
    pub(super) fn new(
        boundary: &Column<[u64; 4]>,
        positions: &[FinePos],
        settings: &StoreSettings,
    ) -> Result<Self> {
        let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
        let triangles = boundary.get()?;
        let at = |v: u64| positions[v as usize];
        let mut sides: Sorter<[u64; 4]> = Sorter::new(memory, &settings.scratch);
        for (t, &[a, b, c, body]) in (0..).zip(triangles) {
            for [a, b] in [[a, b], [b, c], [c, a]] {
                sides.push([a.min(b), a.max(b), body, t])?;
            }
        }
        let normal = |t: u64| {
            let [a, b, c, _] = triangles[t as usize];
            cross(difference(at(b), at(a)), difference(at(c), at(a)))
        };
        let mut along: Sorter<[u64; 5]> = Sorter::new(memory, &settings.scratch);
        let mut sides = sides.finish()?;
        let mut next = sides.next()?;
        while let Some([a, b, body, first]) = next {
            let (mut second, mut count) = (None, 1);
            next = sides.next()?;
            while let Some(side) = next.filter(|side| side[..3] == [a, b, body]) {
                second = second.or(Some(side[3]));
                count += 1;
                next = sides.next()?;
            }
            let Some(second) = second else { continue };
            if count > 2 || is_bent(normal(first), normal(second)) {
                let middle: LatticePos =
                    std::array::from_fn(|k| ((at(a)[k] + at(b)[k]) >> (FINE_BITS + 1)) as u32);
                along.push([hilbert_key(middle, 21), a, b, first, second])?;
            }
        }
        drop(sides);
        let (mut edges, mut along) = (ColumnWriter::new(&settings.scratch)?, along.finish()?);
        let mut ends: Sorter<[u64; 2]> = Sorter::new(memory, &settings.scratch);
        while let Some([_, a, b, first, second]) = along.next()? {
            ends.push([a, edges.len()])?;
            ends.push([b, edges.len()])?;
            edges.push(&[a, b, first, second])?;
        }
        drop(along);
        let edges = edges.finish()?;
        let corners = corners_of(ends, edges.get()?, positions, settings)?;
        Ok(Self { edges, corners })
    }
}

/// The vertices at which not just two edges meet, one going on as the other.
fn corners_of(
    ends: Sorter<[u64; 2]>,
    edges: &[[u64; 4]],
    positions: &[FinePos],
    settings: &StoreSettings,
) -> Result<Column<[u64; 2]>> {
    let mut corners = ColumnWriter::new(&settings.scratch)?;
    let from = |vertex: u64, edge: u64| {
        let [a, b, ..] = edges[edge as usize];
        difference(positions[(a ^ b ^ vertex) as usize], positions[vertex as usize])
    };
    let mut ends = ends.finish()?;
    let (mut next, mut group) = (ends.next()?, vec![]);
    while let Some([vertex, edge]) = next {
        group.clear();
        group.push(edge);
        next = ends.next()?;
        while let Some([_, edge]) = next.filter(|end| end[0] == vertex) {
            group.push(edge);
            next = ends.next()?;
        }
        let goes_on = match *group {
            [a, b] => !is_bent(from(vertex, a), from(vertex, b).map(|c| -c)),
            _ => false,
        };
        if !goes_on {
            group.iter().try_for_each(|&edge| corners.push(&[vertex, edge]))?;
        }
    }
    corners.finish()
}

/// Whether two directions are too far apart to be one.
fn is_bent(u: [f64; 3], v: [f64; 3]) -> bool {
    dot(u, v) < BENT * (dot(u, u) * dot(v, v)).sqrt()
}
