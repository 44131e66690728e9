//! A VTI file with the errors of each brick.

use crate::measure::{BrickErrors, BrickRecord, merged};
use crate::pipeline::read::StepView;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::error::Result;
use isospan_io::exec::Resources;
use isospan_io::formats::brick_map::{BrickMapFile, BrickNumbers};
use isospan_io::grid::Geometry;
use std::collections::BTreeMap;
use std::path::Path;

/// The map of bricks, being collected.
pub(super) struct Map {
    file: BrickMapFile,
    bricks: u64,
    sorter: Sorter<BrickRecord>,
}

/// The part of a budget that sorting for a map takes.
pub(super) fn map_bytes(memory: u64) -> u64 {
    (memory / 8).min(64 << 20)
}

/// Bricks that are written at a time.
const BATCH: usize = 1 << 12;

impl Map {
    pub(super) fn new(archive: &StepView, path: &Path, resources: &Resources) -> Result<Self> {
        let (bricks, g) = (archive.chunks.bricks(), &archive.step().plan.source.geometry);
        let spacing = std::array::from_fn(|a| g.spacing[a] * bricks.voxels()[a]);
        let memory = map_bytes(resources.memory);
        Ok(Self {
            file: BrickMapFile::create(path, bricks.dims(), &Geometry { spacing, ..*g })?,
            bricks: bricks.len(),
            sorter: Sorter::new(memory as usize, &resources.scratch_folder()),
        })
    }

    pub(super) fn add(&mut self, chunk: u64, bricks: &BTreeMap<u64, BrickErrors>) -> Result<()> {
        BrickRecord::of(chunk, bricks).into_iter().try_for_each(|record| self.sorter.push(record))
    }

    /// Writes all bricks, those without a sample too.
    pub(super) fn finish(self) -> Result<u64> {
        const NONE: BrickNumbers = BrickNumbers { rms: f32::NAN, max: f32::NAN, samples: 0 };
        let mut records = self.sorter.finish()?;
        let (mut batch, mut first) = (vec![], 0u64);
        let mut put = |brick: BrickNumbers, last: bool| {
            batch.push(brick);
            if batch.len() == BATCH || last {
                self.file.write(first, &batch)?;
                first += batch.len() as u64;
                batch.clear();
            }
            Ok(())
        };
        let mut next = 0;
        merged(
            || records.next(),
            |brick, errors| {
                while next < brick {
                    put(NONE, false)?;
                    next += 1;
                }
                next += 1;
                let max = if errors.samples == 0 { f32::NAN } else { errors.max as f32 };
                let numbers = BrickNumbers { rms: errors.rms() as f32, max, samples: errors.samples };
                put(numbers, next == self.bricks)
            },
        )?;
        while next < self.bricks {
            next += 1;
            put(NONE, next == self.bricks)?;
        }
        self.file.publish()
    }
}
