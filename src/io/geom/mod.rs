//! Small geometric values shared by every stage: point ids, lattice positions and boxes.

pub mod curve;
pub mod lattice;
pub mod vec3;

pub use lattice::{Lattice, LatticeBox, LatticePos};

/// The kind of a sample site; the four highest bits of its [`PointId`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum PointClass {
    /// A point of the set itself.
    Interior = 0,
    /// A boundary sample on one of the 12 edges of the domain box.
    Edge = 1,
    /// A boundary sample on one of the 6 faces of the domain box.
    Face = 2,
    /// One of the 8 corners of the domain box.
    Corner = 3,
    /// A point of a list: a sample of the boundary of a tetrahedral mesh.
    Explicit = 4,
}

/// Names a sample site for ever: its class above its index in that class. A site's position is a
/// function of its id.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct PointId(pub u64);

impl PointId {
    const INDEX_BITS: u32 = 60;

    /// The id of the `index`-th site of `class`; `index < 2^60`.
    pub fn new(class: PointClass, index: u64) -> Self {
        debug_assert!(index < 1 << Self::INDEX_BITS);
        Self((class as u64) << Self::INDEX_BITS | index)
    }

    /// The class bits, `None` if they are not a known class (an id from a damaged file).
    pub fn class(self) -> Option<PointClass> {
        match self.0 >> Self::INDEX_BITS {
            0 => Some(PointClass::Interior),
            1 => Some(PointClass::Edge),
            2 => Some(PointClass::Face),
            3 => Some(PointClass::Corner),
            4 => Some(PointClass::Explicit),
            _ => None,
        }
    }

    /// The index within the class.
    pub fn index(self) -> u64 {
        self.0 & ((1 << Self::INDEX_BITS) - 1)
    }
}

/// A sample site: id and position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Site {
    /// Its id.
    pub id: PointId,
    /// Its position on the lattice.
    pub pos: LatticePos,
}
