//! Tetrahedra of a chunk, given to be cut by a surface.

use super::cases::{ODD, ORDERS};
use crate::surface::world_map::WorldMap;
use isospan_io::geom::{LatticePos, PointId};
use isospan_mesh::mesh::tet::Tet;

/// The corners and tetrahedra of (a part of) one chunk. Corner arrays are indexed by the numbers
/// that the tetrahedra use; entries that no tetrahedron uses may hold anything.
#[derive(Clone, Copy, Debug)]
pub struct CellSource<'a> {
    /// Positions of the corners.
    pub positions: &'a [LatticePos],
    /// Values of the corners; NaN where there is no data.
    pub values: &'a [f32],
    /// Ids of the corners.
    pub ids: &'a [PointId],
    /// Whether tetrahedra of other chunks use the corner. `true` is always right, and costs memory
    /// in the builder.
    pub shared: &'a [bool],
    /// The number that each corner has in the chunk, where `tets` number the corners of a block for
    /// themselves. Then the data of a block lies together.
    pub numbers: Option<&'a [u32]>,
    /// Positively oriented tetrahedra.
    pub tets: &'a [Tet],
}

/// An active tetrahedron, its corners in the order of their ids.
#[derive(Clone, Copy, Default)]
pub(super) struct Sorted {
    pub(super) corners: Tet,
    /// The mask of corners inside, and [`ODD`].
    pub(super) case: u8,
}

impl Sorted {
    #[inline(always)]
    pub(super) fn new(ids: &[PointId], tet: &Tet) -> Self {
        let id = tet.map(|c| ids[c as usize]);
        let swapped = |i: usize, j: usize, bit: u32| usize::from(id[j] < id[i]) << bit;
        let order = swapped(0, 1, 0) | swapped(0, 2, 1) | swapped(0, 3, 2);
        let order = order | swapped(1, 2, 3) | swapped(1, 3, 4) | swapped(2, 3, 5);
        let order = &ORDERS[order];
        let corners = order.corners.map(|i| tet[usize::from(i) % 4]);
        Self { corners, case: order.odd }
    }

    /// Looks which corners are inside.
    #[inline(always)]
    pub(super) fn look(&mut self, values: &[f32], isovalue: f32) {
        let inside = |i: usize| u8::from(values[self.corners[i] as usize] >= isovalue) << i;
        self.case |= inside(0) | inside(1) | inside(2) | inside(3);
    }
}

/// The same tetrahedron, its corners in the order of their ids, except that the last two are
/// swapped where its orientation asks for it.
///
/// # Panics
/// When it names a corner that is not there.
#[inline]
pub(crate) fn in_order(ids: &[PointId], tet: &Tet) -> Tet {
    let Sorted { corners: [a, b, c, d], case, .. } = Sorted::new(ids, tet);
    if case == ODD { [a, b, d, c] } else { [a, b, c, d] }
}

/// Finds active tetrahedra: on which side of the isovalue each corner is, a byte, is looked up
/// instead of compared.
#[derive(Clone, Debug, Default)]
pub struct Sides(Vec<u8>);

impl Sides {
    /// A corner inside counts 1, one outside 16, a NaN nothing.
    const OUTSIDE: u8 = 16;
    /// The sums of four corners, some of them inside and all others outside, as bits.
    const ACTIVE: u64 = 1 << (1 + 3 * 16) | 1 << (2 + 2 * 16) | 1 << (3 + 16);

    /// Appends the active tetrahedra to `active`: those for which
    /// [`isospan_mesh::mesh::tet::is_active`] holds.
    ///
    /// # Panics
    /// When a tetrahedron names a corner without a value.
    pub fn select(&mut self, tets: &[Tet], values: &[f32], isovalue: f32, active: &mut Vec<Tet>) {
        self.set(values, isovalue);
        self.active_of(tets, active);
    }

    /// Looks on which side the corners are.
    pub(crate) fn set(&mut self, values: &[f32], isovalue: f32) {
        let side = |&v: &f32| u8::from(v >= isovalue) | (u8::from(v < isovalue) * Self::OUTSIDE);
        self.0.clear();
        self.0.extend(values.iter().map(side));
    }

    /// Appends the active ones of tetrahedra between the corners, found without branches.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    #[inline]
    pub(crate) fn active_of<N: Copy + Into<u32>>(&self, tets: &[[N; 4]], active: &mut Vec<Tet>) {
        let mut end = active.len();
        active.resize(end + tets.len(), [0; 4]);
        for tet in tets {
            let tet: Tet = tet.map(Into::into);
            let [a, b, c, d] = tet.map(|c| self.0[c as usize]);
            active[end] = tet;
            // Four outside are 64, which counts as 0: not active either.
            end += (Self::ACTIVE >> ((a + b + c + d) % 64) & 1) as usize;
        }
        active.truncate(end);
    }
}

/// The normal for an edge without a gradient sum: that of the shortest gradient with the edge's two
/// values, which goes from the lower one to the higher one.
#[cold]
pub(super) fn along_edge(up: [f32; 3], world: &WorldMap) -> [f32; 3] {
    let up = up.map(f64::from);
    world.unit_normal(up).expect("the two ends of an edge differ, and the world map is invertible")
}
