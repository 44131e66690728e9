//! A mesh's field at the samples of a grid: those of the lattice's voxels, block by block.
//!
//! Each sample is located among the cells that a block has, as points of a reduction are
//! ([`isospan_mesh::locate`]); where there is no cell, the value is no number.

use super::buckets::Buckets;
use super::settings::StoreSettings;
use super::store::CellStore;
use isospan_io::error::Result;
use isospan_io::grid::{BrickGrid, BrickId, IndexBox};
use isospan_mesh::locate::{CellBatch, CellHit, FinePos, PointGrid, fine, linear};

/// The cells of a mesh, sorted into blocks.
pub(crate) struct Voxels<'a> {
    store: &'a CellStore,
    blocks: BrickGrid,
    buckets: Buckets,
}

impl<'a> Voxels<'a> {
    /// Bytes that reading a box takes for each of its samples: position, the same sorted, what was
    /// found, the value.
    pub(crate) const SAMPLE_BYTES: u64 = 2 * 40 + size_of::<CellHit>() as u64 + 4;

    /// Sorts the cells of a mesh into blocks.
    pub(crate) fn new(store: &'a CellStore, blocks: BrickGrid, settings: &StoreSettings) -> Result<Self> {
        let buckets = Buckets::new(store, &blocks, settings)?;
        Ok(Self { store, blocks, buckets })
    }

    /// The field at the samples of a box that lies in a block, those of its far faces included: x
    /// fastest, NaN outside of the mesh.
    pub(crate) fn read(&self, block: BrickId, samples: &IndexBox) -> Result<Vec<f32>> {
        let mut points: Vec<FinePos> = Vec::with_capacity(samples.len());
        for z in samples.lo[2]..samples.hi[2] {
            for y in samples.lo[1]..samples.hi[1] {
                let row = samples.lo[0]..samples.hi[0];
                points.extend(row.map(|x| fine(self.blocks.lattice.of_voxel([x, y, z]))));
            }
        }
        let (grid, mut found) = (PointGrid::new(&points), vec![CellHit::default(); points.len()]);
        self.buckets.each_batch(self.store, block, &mut CellBatch::default(), |cells| {
            grid.locate(cells, &mut found);
        })?;
        let (tets, values) = (self.store.tets.get()?, self.store.values.get()?);
        let value = |found: &CellHit| match found.id {
            CellHit::NOWHERE => f32::NAN,
            id => linear(&found.weights, &tets[id as usize].map(|v| f64::from(values[v as usize]))) as f32,
        };
        Ok(found.iter().map(value).collect())
    }
}
