//! Here are tetrahedra of chunks: one mesh, each point once.
//!
//! ```text
//!  tetrahedra of a chunk ──▶ TetBuilder ──▶ StoredTets ──▶ a writer of formats/
//!                      push (chunk order)  finish
//! ```
//!
//! A point that only one chunk has goes straight to the store. One that several chunks have is
//! known by its [`PointId`]: a table tells the number that it got when the first of them came.
//! Coordinates are never compared.
//!
//! **Numbers** are given in the order of first use: chunk after chunk, tetrahedron after
//! tetrahedron, corner after corner. The result is a function of the sequence of
//! [`TetBuilder::push`] alone.
//!
//! **Memory.** Up to `memory_bytes` of finished records (12 bytes a point, 4 for the value of each
//! field, 32 a tetrahedron); what exceeds it goes to nameless files in the scratch folder. In
//! addition about 40 bytes for each shared point that is still open: a caller that knows which
//! points later chunks can still use closes the others ([`TetBuilder::keep_open`]).

use isospan_io::bytes::store::Store;
use isospan_io::error::Result;
use isospan_io::geom::{LatticePos, PointId};
use isospan_mesh::mesh::tet::Tet;
use rustc_hash::FxHashMap;
use std::path::Path;

/// Tetrahedra of a chunk. Arrays of corners are indexed by chunk-local vertex numbers.
#[derive(Clone, Copy, Debug)]
pub struct ChunkTets<'a> {
    /// Positions.
    pub positions: &'a [LatticePos],
    /// Ids.
    pub ids: &'a [PointId],
    /// Values of each field.
    pub values: &'a [&'a [f32]],
    /// Whether other chunks have the point too.
    pub shared: &'a [bool],
    /// The tetrahedra.
    pub tets: &'a [Tet],
}

/// No number yet.
const NONE: u64 = u64::MAX;

/// Joins the tetrahedra of chunks.
#[derive(Debug)]
pub struct TetBuilder {
    points: Store<LatticePos>,
    values: Vec<Store<f32>>,
    tets: Store<[u64; 4]>,
    /// Numbers of shared points that later chunks may have; looked up, never iterated in its order.
    open: FxHashMap<PointId, u64>,
    /// Chunk-local vertex number to global one; a buffer.
    numbers: Vec<u64>,
}

impl TetBuilder {
    /// An empty mesh with the values of so many fields. What exceeds `memory_bytes` goes to the
    /// folder `scratch`.
    pub fn new(fields: usize, memory_bytes: usize, scratch: &Path) -> Self {
        let share = memory_bytes / 4 / (3 + fields);
        Self {
            points: Store::new(3 * share, scratch),
            values: (0..fields).map(|_| Store::new(share, scratch)).collect(),
            tets: Store::new(memory_bytes / 4 * 3, scratch),
            open: FxHashMap::default(),
            numbers: vec![],
        }
    }

    /// Adds the tetrahedra of the next chunk.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when the scratch file cannot be written.
    pub fn push(&mut self, chunk: &ChunkTets<'_>) -> Result<()> {
        self.numbers.clear();
        self.numbers.resize(chunk.positions.len(), NONE);
        for tet in chunk.tets {
            let mut numbers = [0; 4];
            for (number, &v) in numbers.iter_mut().zip(tet) {
                *number = self.number(chunk, v as usize)?;
            }
            self.tets.push(numbers)?;
        }
        Ok(())
    }

    fn number(&mut self, chunk: &ChunkTets<'_>, v: usize) -> Result<u64> {
        if self.numbers[v] != NONE {
            return Ok(self.numbers[v]);
        }
        let next = self.points.len();
        let number = match chunk.shared[v] {
            true => *self.open.entry(chunk.ids[v]).or_insert(next),
            false => next,
        };
        if number == next {
            self.points.push(chunk.positions[v])?;
            self.values.iter_mut().zip(chunk.values).try_for_each(|(all, of)| all.push(of[v]))?;
        }
        self.numbers[v] = number;
        Ok(number)
    }

    /// Closes the points for which `is_open` is false: no later chunk has them.
    pub fn keep_open(&mut self, is_open: impl Fn(PointId) -> bool) {
        self.open.retain(|&id, _| is_open(id));
        self.open.shrink_to_fit();
    }

    /// Shared points that are open.
    pub fn open_points(&self) -> usize {
        self.open.len()
    }

    /// Tetrahedra so far.
    pub fn tet_count(&self) -> u64 {
        self.tets.len()
    }

    /// The finished mesh.
    pub fn finish(self) -> StoredTets {
        StoredTets { points: self.points, values: self.values, tets: self.tets }
    }
}

/// A finished mesh, in memory or in a file that vanishes with it. It is read front to back as often
/// as needed, in batches.
#[derive(Debug)]
pub struct StoredTets {
    points: Store<LatticePos>,
    values: Vec<Store<f32>>,
    tets: Store<[u64; 4]>,
}

impl StoredTets {
    /// Number of points.
    pub fn point_count(&self) -> u64 {
        self.points.len()
    }

    /// Number of tetrahedra.
    pub fn tet_count(&self) -> u64 {
        self.tets.len()
    }

    /// Hands the positions of all points, in order, in batches, to `each`.
    ///
    /// # Errors
    /// Those of reading the scratch file, and those of `each`.
    pub fn points(&self, each: &mut dyn FnMut(&[LatticePos]) -> Result<()>) -> Result<()> {
        self.points.each(each)
    }

    /// Hands the values of a field at all points, in order, in batches, to `each`.
    ///
    /// # Errors
    /// Those of reading the scratch file, and those of `each`.
    pub fn values(&self, field: usize, each: &mut dyn FnMut(&[f32]) -> Result<()>) -> Result<()> {
        self.values[field].each(each)
    }

    /// Hands all tetrahedra (four point numbers, positively oriented) in order, in batches, to
    /// `each`.
    ///
    /// # Errors
    /// Those of reading the scratch file, and those of `each`.
    pub fn tets(&self, each: &mut dyn FnMut(&[[u64; 4]]) -> Result<()>) -> Result<()> {
        self.tets.each(each)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_points_are_one_until_they_are_closed() {
        let scratch = tempfile::tempdir().unwrap();
        for memory in [0, 1 << 20] {
            let mut builder = TetBuilder::new(2, memory, scratch.path());
            let positions = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]];
            let ids = [7, 8, 9, 10, 11].map(PointId);
            let chunk = ChunkTets {
                positions: &positions,
                ids: &ids,
                values: &[&[0.0, 1.0, 2.0, 3.0, 4.0], &[5.0, 6.0, 7.0, 8.0, 9.0]],
                shared: &[false, true, true, true, false],
                tets: &[[1, 2, 3, 4], [0, 1, 2, 3]],
            };
            builder.push(&chunk).unwrap();
            builder.push(&ChunkTets { tets: &[[0, 1, 2, 3]], ..chunk }).unwrap();
            builder.keep_open(|id| id.0 != 8);
            assert_eq!(builder.open_points(), 2);
            builder.push(&ChunkTets { tets: &[[2, 3, 1, 0]], ..chunk }).unwrap();
            let mesh = builder.finish();
            let (mut values, mut tets) = ([vec![], vec![]], vec![]);
            for (field, all) in values.iter_mut().enumerate() {
                mesh.values(field, &mut |some| {
                    all.extend_from_slice(some);
                    Ok(())
                })
                .unwrap();
            }
            mesh.tets(&mut |t| {
                tets.extend_from_slice(t);
                Ok(())
            })
            .unwrap();
            assert_eq!(values[0], [1.0, 2.0, 3.0, 4.0, 0.0, 0.0, 1.0, 0.0]);
            assert_eq!(values[1], [6.0, 7.0, 8.0, 9.0, 5.0, 5.0, 6.0, 5.0]);
            assert_eq!(tets, [[0, 1, 2, 3], [4, 0, 1, 2], [5, 0, 1, 2], [1, 2, 6, 7]]);
            assert_eq!((mesh.point_count(), mesh.tet_count()), (8, 4));
        }
    }
}
