//! Finds the nearest place of the reduced domain for points that lie in no tetrahedron.
//!
//! Such a place lies on a face that only one tetrahedron has. In a chunk, the faces of only one
//! tetrahedron are these and the faces between chunks, which are never nearer. So each chunk
//! searches its own faces, and the nearest place of all chunks counts. If several are equally near,
//! the first by the positions of its corners counts. Corners are taken in the order of their
//! positions, so the answer depends on neither chunks nor threads.
//!
//! Where the bodies of points are known, places of a point's own body come before all others.

use crate::domain::nearest::nearest;
use crate::pipeline::read::DecodedChunk;
use isospan_io::geom::{Lattice, LatticePos};
use isospan_mesh::locate::{FINE_BITS, fine};
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::raster::{PointLocator, interpolate};
use std::collections::BTreeMap;

/// A place near a point, and the values there: NaN where a corner has none.
#[derive(Clone, Debug)]
pub(super) struct NearPlace {
    /// Whether it is a place of another body.
    pub(super) is_foreign: bool,
    /// The square of the distance, in fine steps.
    distance2: f64,
    corners: [LatticePos; 3],
    pub(super) values: Vec<f32>,
}

impl NearPlace {
    fn is_before(&self, other: &Self) -> bool {
        self.order() < other.order()
    }

    fn order(&self) -> (bool, f64, [LatticePos; 3]) {
        (self.is_foreign, self.distance2, self.corners)
    }

    /// Whether the place is within `steps` lattice steps of its point.
    pub(super) fn is_within(&self, steps: u32) -> bool {
        let most = f64::from(steps) * f64::from(1u32 << FINE_BITS);
        self.distance2 <= most * most
    }
}

/// Keeps the nearer one of the places of a point.
pub(super) fn keep(places: &mut BTreeMap<u32, NearPlace>, point: u32, place: NearPlace) {
    match places.get_mut(&point) {
        Some(known) if !place.is_before(known) => {}
        Some(known) => *known = place,
        None => {
            places.insert(point, place);
        }
    }
}

/// The places of a chunk's tetrahedra that are nearest to points, of those within `reach` lattice
/// steps along each axis. `is_own` says whether a tetrahedron is in the body of a point.
pub(super) fn near_places(
    chunk: &DecodedChunk,
    lists: &[Vec<f32>],
    points: &PointLocator,
    is_own: impl Fn(usize, u32) -> bool,
    reach: u32,
    lattice: &Lattice,
) -> BTreeMap<u32, NearPlace> {
    let (mut places, far) = (BTreeMap::new(), lattice.max());
    if points.is_empty() {
        return places;
    }
    for (mut face, tet) in single_faces(&chunk.tets) {
        face.sort_unstable_by_key(|&v| chunk.positions[v as usize]);
        let corners = face.map(|v| chunk.positions[v as usize]);
        let lo = std::array::from_fn(|a| {
            corners.iter().map(|c| c[a]).fold(u32::MAX, u32::min).saturating_sub(reach)
        });
        let hi = std::array::from_fn(|a| {
            corners.iter().map(|c| c[a]).fold(0, u32::max).saturating_add(reach).min(far[a])
        });
        points.each_within(lo, hi, |p, n| {
            let (weights, distance2) = nearest(corners.map(fine), fine(p));
            let is_foreign = !is_own(tet as usize, n);
            let known = places.get(&n);
            if known.is_some_and(|k: &NearPlace| k.order() <= (is_foreign, distance2, corners)) {
                return;
            }
            let at = |values: &Vec<f32>| {
                let [a, b, c] = face.map(|v| values[v as usize]);
                interpolate([weights[0], weights[1], weights[2], 0.0], [a, b, c, 0.0])
            };
            let values = lists.iter().map(at).collect();
            places.insert(n, NearPlace { is_foreign, distance2, corners, values });
        });
    }
    places
}

/// The faces that only one of some tetrahedra has, each with the number of that.
fn single_faces(tets: &[Tet]) -> Vec<([u32; 3], u32)> {
    let faces = |(t, &[a, b, c, d]): (u32, &Tet)| {
        [[b, c, d], [a, c, d], [a, b, d], [a, b, c]].map(|mut face| {
            face.sort_unstable();
            (face, t)
        })
    };
    let mut all: Vec<([u32; 3], u32)> = (0..).zip(tets).flat_map(faces).collect();
    all.sort_unstable();
    all.chunk_by(|a, b| a.0 == b.0).filter(|same| same.len() == 1).map(|same| same[0]).collect()
}
