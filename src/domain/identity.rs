//! Whether two files hold the same mesh: hashes of all points, and of all cells that have a volume.
//!
//! Coordinates are hashed as `f64`, for any type in the file; cells as kind and vertex numbers, of
//! polyhedra the faces, in the order of the file. Cells without a volume, and those that a file
//! marks as ghosts, are no part of the mesh. Cost: one pass over both, of which hashing is little.

use isospan_io::cells::{CellBlock, CellMesh};
use isospan_io::error::Result;
use isospan_io::exec::CancelToken;
use xxhash_rust::xxh3::Xxh3;

/// What identifies a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Identity {
    /// XXH3 (128 bits) of the points: x y z of each, -0 as 0.
    pub(crate) points: u128,
    /// XXH3 (128 bits) of the cells: of each its kind in a byte and its vertices as u64.
    pub(crate) cells: u128,
}

impl Identity {
    /// Reads the points and the cells of a mesh.
    ///
    /// # Errors
    /// Errors of reading them.
    pub(crate) fn of(mesh: &CellMesh, cancel: &CancelToken) -> Result<Self> {
        let mut hashes = IdentityHash::default();
        let (mut points, mut block) = (mesh.points()?, vec![]);
        while points.next_block(&mut block)? {
            cancel.check()?;
            hashes.add_points(&block);
        }
        let (mut cells, mut block) = (mesh.cells()?, CellBlock::default());
        while cells.next_block(&mut block)? {
            cancel.check()?;
            hashes.add_cells(&block);
        }
        Ok(hashes.finish())
    }
}

/// The hashes of what was read so far.
#[derive(Default)]
pub(super) struct IdentityHash {
    points: Xxh3,
    cells: Xxh3,
    bytes: Vec<u8>,
}

impl IdentityHash {
    pub(super) fn add_points(&mut self, points: &[[f64; 3]]) {
        self.bytes.clear();
        points.iter().flatten().for_each(|x| self.bytes.extend((x + 0.0).to_le_bytes()));
        self.points.update(&self.bytes);
    }

    pub(super) fn add_cells(&mut self, cells: &CellBlock) {
        self.bytes.clear();
        for (kind, vertices) in cells.iter().filter(|(kind, _)| kind.is_solid()) {
            self.bytes.push(kind as u8);
            vertices.iter().for_each(|v| self.bytes.extend(v.to_le_bytes()));
        }
        self.cells.update(&self.bytes);
    }

    pub(super) fn finish(&self) -> Identity {
        Identity { points: self.points.digest128(), cells: self.cells.digest128() }
    }
}
