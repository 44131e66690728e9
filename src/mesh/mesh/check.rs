//! Properties that a tetrahedralization must have, as functions; used by tests and by anyone in
//! doubt.

use crate::mesh::tet::Tet;
use crate::predicates::{insphere_perturbed, signed_volume6};
use isospan_io::geom::LatticePos;
use isospan_io::geom::curve::Order;
use std::collections::BTreeMap;

/// Face i of a positively oriented tetrahedron, seen counterclockwise from outside.
const OUTWARD: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// What [`check`] found in a sound mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Tetrahedra.
    pub tets: usize,
    /// Facets of the hull: those of one tetrahedron only.
    pub hull_facets: usize,
    /// Six times the volume, exactly.
    pub volume6: i128,
    /// Vertices that occur in a tetrahedron.
    pub vertices: usize,
}

/// Checks that `tets` is a Delaunay tetrahedralization of (some of) `positions`, with the ties of
/// `order`: positive orientation, facets shared by at most two tetrahedra and oppositely seen,
/// every shared facet locally Delaunay (which makes the whole Delaunay), a closed hull, and the sum
/// of the volumes equal to the volume that the hull encloses.
///
/// # Errors
/// A sentence about the first fault.
pub fn check(positions: &[LatticePos], tets: &[Tet], order: &Order) -> Result<Summary, String> {
    let mut facets: BTreeMap<[u32; 3], Vec<Side>> = BTreeMap::new();
    let mut volume6 = 0i128;
    let mut used = vec![false; positions.len()];
    for (t, tet) in tets.iter().enumerate() {
        if tet.iter().any(|&v| v as usize >= positions.len()) {
            return Err(format!("tetrahedron {t} {tet:?}: no such vertex"));
        }
        let volume = volume_of(positions, *tet);
        if volume <= 0 {
            return Err(format!("tetrahedron {t} {tet:?}: six times its volume is {volume}"));
        }
        volume6 += volume;
        for (i, face) in OUTWARD.iter().enumerate() {
            used[tet[i] as usize] = true;
            let mut key = face.map(|k| tet[k]);
            key.sort_unstable();
            facets.entry(key).or_default().push(Side { tet: t, face: i });
        }
    }
    let (hull_facets, enclosed) = check_facets(positions, tets, &facets, order)?;
    if enclosed != volume6 {
        return Err(format!("the tetrahedra fill {volume6}/6, their hull encloses {enclosed}/6"));
    }
    Ok(Summary { tets: tets.len(), hull_facets, volume6, vertices: used.iter().filter(|&&u| u).count() })
}

fn volume_of(positions: &[LatticePos], tet: Tet) -> i128 {
    let [a, b, c, d] = tet.map(|v| positions[v as usize]);
    signed_volume6(a, b, c, d)
}

/// A facet, as a tetrahedron has it: the one across from a corner.
#[derive(Clone, Copy)]
struct Side {
    tet: usize,
    face: usize,
}

/// Each facet of one or two tetrahedra; counts the hull's and adds up the volume below it.
fn check_facets(
    positions: &[LatticePos],
    tets: &[Tet],
    facets: &BTreeMap<[u32; 3], Vec<Side>>,
    order: &Order,
) -> Result<(usize, i128), String> {
    let (mut hull, mut enclosed) = (0, 0);
    for (key, sides) in facets {
        match sides[..] {
            [Side { tet: t, face: i }] => {
                hull += 1;
                let [a, b, c] = OUTWARD[i].map(|k| positions[tets[t][k] as usize]);
                // The cone over the facet from the lattice's origin.
                enclosed += signed_volume6([0; 3], a, b, c);
                convex(positions, tets, t, i)?;
            }
            [one, other] => locally_delaunay(positions, tets, one, other, order)?,
            _ => return Err(format!("facet {key:?} belongs to {} tetrahedra", sides.len())),
        }
    }
    Ok((hull, enclosed))
}

/// No vertex lies beyond a hull facet; checked against a bounded sample of the positions.
fn convex(positions: &[LatticePos], tets: &[Tet], t: usize, i: usize) -> Result<(), String> {
    let [a, b, c] = OUTWARD[i].map(|k| positions[tets[t][k] as usize]);
    let step = (positions.len() / 200).max(1);
    match positions.iter().step_by(step).find(|&&p| signed_volume6(a, b, c, p) > 0) {
        Some(p) => Err(format!("position {p:?} lies beyond hull facet {i} of tetrahedron {t}")),
        None => Ok(()),
    }
}

fn locally_delaunay(
    positions: &[LatticePos],
    tets: &[Tet],
    here: Side,
    there: Side,
    order: &Order,
) -> Result<(), String> {
    let (one, other) = (tets[here.tet], tets[there.tet]);
    let apex = other[there.face];
    let mut mirrored = one;
    mirrored[here.face] = apex;
    if volume_of(positions, mirrored) >= 0 {
        return Err(format!("tetrahedra {one:?} and {other:?} lie on one side of their common facet"));
    }
    let five = [one[0], one[1], one[2], one[3], apex].map(|v| positions[v as usize]);
    if insphere_perturbed(&five, &ranks(&five, order)) > 0 {
        return Err(format!("vertex {apex} lies in the circumsphere of {one:?}"));
    }
    Ok(())
}

/// The places of five positions in the insertion order.
pub fn ranks(five: &[LatticePos; 5], order: &Order) -> [u32; 5] {
    let mut sorted = [0usize, 1, 2, 3, 4];
    sorted.sort_by(|&a, &b| order.compare(five[a], five[b]));
    let mut rank = [0; 5];
    for (place, i) in (0u32..).zip(sorted) {
        rank[i] = place;
    }
    rank
}

/// Six times the volume of the box spanned by two opposite corners.
pub fn box_volume6(lo: LatticePos, hi: LatticePos) -> i128 {
    6 * (0..3).map(|k| i128::from(hi[k]) - i128::from(lo[k])).product::<i128>()
}
