//! The corners of a block that is kept ([`super::numbered`]), in the order of their ids.

use super::cells::CellSource;
use super::fours::Corner;
use super::patch::CORNERS;
use isospan_io::geom::{LatticePos, PointId};
use isospan_mesh::mesh::tet::Tet;

/// In the number of a corner: other chunks may have it.
pub(super) const SHARED: u32 = 1 << 31;
/// Edges between as many corners as there may be: the next power of two.
pub(super) const EDGE_SLOTS: usize = 1 << 15;

/// Corners by their ids, least first.
pub(super) struct Order {
    corners: [u8; CORNERS],
    len: usize,
}

impl Order {
    /// `None` of a block with too many corners or tetrahedra, which is rare, or of corners without
    /// numbers in a chunk.
    pub(super) fn of(cells: &CellSource<'_>) -> Option<Self> {
        let (numbers, len, tets) = (cells.numbers?, cells.ids.len(), cells.tets.len());
        if len > CORNERS || tets >= usize::from(u16::MAX) || numbers.iter().any(|&n| n >= SHARED) {
            return None;
        }
        let mut corners: [u8; CORNERS] = std::array::from_fn(|i| i as u8);
        corners[..len].sort_unstable_by_key(|&i| cells.ids[usize::from(i)]);
        Some(Self { corners, len })
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = usize> {
        self.corners[..self.len].iter().map(|&i| usize::from(i))
    }

    /// The place of each corner in the order.
    pub(super) fn ranks(&self) -> [u8; CORNERS] {
        let mut rank = [0; CORNERS];
        (0..=255).zip(self.iter()).for_each(|(r, i)| rank[i] = r);
        rank
    }

    /// Their numbers in the chunk, with [`SHARED`].
    pub(super) fn numbers(&self, cells: &CellSource<'_>) -> impl Iterator<Item = u32> {
        let numbers = cells.numbers.unwrap_or_default();
        self.iter().map(move |i| numbers[i] | if cells.shared[i] { SHARED } else { 0 })
    }

    /// The positions and values of the corners.
    pub(super) fn corners(&self, cells: &CellSource<'_>) -> impl Iterator<Item = Corner> {
        self.iter().map(|i| {
            // At most 2^24: exact.
            let [x, y, z] = cells.positions[i].map(|x| x as f32);
            [x, y, z, cells.values[i]]
        })
    }

    /// Their ids, the low half first.
    pub(super) fn ids(&self, cells: &CellSource<'_>) -> impl Iterator<Item = u32> {
        self.iter().map(|i| cells.ids[i].0).flat_map(|id| [id as u32, (id >> 32) as u32])
    }
}

/// The id of a corner, of such as [`Order::ids`] gives.
#[inline(always)]
pub(super) fn id_of(ids: &[u32], corner: usize) -> PointId {
    PointId(u64::from(ids[2 * corner]) | u64::from(ids[2 * corner + 1]) << 32)
}

/// The ids of two corners, if other chunks may have both.
#[inline(always)]
pub(super) fn shared_ids(numbers: &[u32], ids: &[u32], ends: [u8; 2]) -> Option<(PointId, PointId)> {
    let [a, b] = ends.map(usize::from);
    let is_shared = numbers[a] & numbers[b] & SHARED != 0;
    is_shared.then(|| (id_of(ids, a), id_of(ids, b)))
}

/// On which side each corner is: inside 1, outside 16, a NaN 0.
#[inline(always)]
pub(super) fn sides_of(corners: &[Corner], isovalue: f32) -> [u8; CORNERS] {
    let mut sides = [0; CORNERS];
    for (side, corner) in sides.iter_mut().zip(corners) {
        let v = corner[3];
        *side = u8::from(v >= isovalue) | u8::from(v < isovalue) << 4;
    }
    sides
}

/// A place for each edge: few of them, close together, where there are few corners.
#[inline(always)]
pub(super) fn slot_of([low, high]: [u8; 2]) -> usize {
    let high = usize::from(high);
    (high * high.wrapping_sub(1) / 2 + usize::from(low)) % EDGE_SLOTS
}

/// The buffers into which a block is unpacked.
pub(crate) struct Unpacked<'a> {
    pub(crate) numbers: &'a mut Vec<u32>,
    pub(crate) positions: &'a mut Vec<LatticePos>,
    pub(crate) ids: &'a mut Vec<PointId>,
    pub(crate) values: &'a mut Vec<f32>,
    pub(crate) shared: &'a mut Vec<bool>,
    pub(crate) tets: &'a mut Vec<Tet>,
}

impl Unpacked<'_> {
    /// Replaces all by a block: its corners in the order of their ids.
    pub(super) fn put(
        &mut self,
        numbers: &[u32],
        corners: &[Corner],
        ids: &[u32],
        tets: impl Iterator<Item = Tet>,
    ) {
        let whole = |x: f32| x as u32;
        self.numbers.clear();
        self.numbers.extend(numbers.iter().map(|n| n & !SHARED));
        self.shared.clear();
        self.shared.extend(numbers.iter().map(|n| n & SHARED != 0));
        self.positions.clear();
        self.positions.extend(corners.iter().map(|&[x, y, z, _]| [whole(x), whole(y), whole(z)]));
        self.values.clear();
        self.values.extend(corners.iter().map(|at| at[3]));
        self.ids.clear();
        self.ids.extend((0..corners.len()).map(|i| id_of(ids, i)));
        self.tets.clear();
        self.tets.extend(tets);
    }
}
