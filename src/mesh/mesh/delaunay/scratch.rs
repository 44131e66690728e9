//! What the steps of a wide insertion pass on to each other.

/// Most vertices of a cavity's boundary here, and its facets.
pub(super) const VERTICES: usize = 32;
pub(super) const FACETS: usize = 2 * VERTICES - 4;
pub(super) const LOG2_ROW: u32 = 5;
/// Vertices that fit half the registers.
pub(super) const FEW: usize = 16;
/// Facets are worked on eight at a time.
pub(super) const PADDED: usize = FACETS + 8;

/// Data passed between the steps of an insertion.
#[derive(Debug)]
#[repr(C, align(64))]
pub(super) struct Scratch {
    /// Vertices relative to the new point and their squared lengths, an array an axis, by local
    /// number.
    pub(super) relative: [[f64; VERTICES]; 4],
    /// Local numbers of the first, second and third corners of the facets.
    pub(super) corner: [[u32; PADDED]; 3],
    /// Corners, and the code of what lies across.
    pub(super) facet: [[u32; 4]; PADDED],
    /// Record number of the new tetrahedron.
    pub(super) id: [u32; PADDED],
    /// Vertices by local number.
    pub(super) vertices: [u32; 3 * FACETS + 8],
    /// `[from << LOG2_ROW | to]` of a directed edge: the code of the face that holds it. With room
    /// for three numbers a facet, so that no boundary, closed or not, leads outside.
    pub(super) edges: [u32; (3 * FACETS + 1) << LOG2_ROW],
}

impl Scratch {
    pub(super) fn boxed() -> Box<Self> {
        Box::new(Self {
            relative: [[0.0; VERTICES]; 4],
            corner: [[0; PADDED]; 3],
            facet: [[0; 4]; PADDED],
            id: [0; PADDED],
            vertices: [0; 3 * FACETS + 8],
            edges: [0; (3 * FACETS + 1) << LOG2_ROW],
        })
    }

    /// Repeats the last of `count` facets up to a multiple of eight.
    #[inline]
    pub(super) fn repeat_last(&mut self, count: usize) {
        for k in count..count.next_multiple_of(8) {
            self.id[k] = self.id[count - 1];
            self.corner.iter_mut().for_each(|c| c[k] = c[count - 1]);
        }
    }
}
