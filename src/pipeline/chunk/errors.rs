//! Measures the errors of a chunk: its field is compared with every sample of the source while its
//! tetrahedra and values are in memory.
//!
//! ```text
//!  some blocks ─▶ the box of their tetrahedra ─▶ read its samples, of each step ─▶ scan conversion ─▶ sample and field
//! ```
//!
//! The tetrahedra of a block lie together, so the box around a few consecutive blocks is small. Its
//! samples are read from the source. The scan conversion ([`isospan_mesh::raster`]) visits each
//! sample of the domain in exactly one tetrahedron. The samples in a tetrahedron and their weights
//! are found once for all steps that are measured together.

use super::step_errors::{CompareBuffers, Measured};
use super::step_lanes::StepLanes;
use super::step_samples::WindowSamples;
use crate::archive::tables::ChunkErrors;
use crate::domain::column::Column;
use crate::domain::store::CellStore;
use crate::measure::{BrickErrors, ErrorSums, FieldError, Tally, Worst};
use crate::pipeline::inputs::treat_missing;
use crate::pipeline::plan::ERROR_WINDOW;
use crate::pipeline::read::{StepView, world_of};
use isospan_io::error::{Error, Result};
use isospan_io::geom::{Lattice, LatticePos};
use isospan_io::grid::IndexBox;
use isospan_io::volume::VolumeReader;
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::points::Levels;
use isospan_mesh::raster::{BatchScan, SampleGrid, Scanner, corner_box, greater, lesser};
use isospan_mesh::simd::with_vectors;
use std::ops::Range;

/// The samples that an archive was made from.
pub(in crate::pipeline) enum Originals<'a> {
    Volume {
        reader: &'a dyn VolumeReader,
        /// A sample of this value is missing, besides those that the reader knows.
        missing: Option<f64>,
        /// The value that replaces samples that are not finite.
        stand_in: Option<f32>,
    },
    /// A mesh, and the values at its vertices.
    Mesh(&'a CellStore, &'a Column<f32>),
}

/// The samples of a step's volume.
pub(in crate::pipeline) struct Samples<'a> {
    reader: &'a dyn VolumeReader,
    missing: Option<f64>,
    stand_in: f32,
}

impl<'a> Samples<'a> {
    /// Those that values are made from; `None` of a mesh.
    pub(in crate::pipeline) fn of(originals: &Originals<'a>) -> Option<Self> {
        match *originals {
            Originals::Volume { reader, missing, stand_in } => {
                Some(Self { reader, missing, stand_in: stand_in.unwrap_or(f32::NAN) })
            }
            Originals::Mesh(..) => None,
        }
    }

    /// Reads a window; no finite number where there is no sample.
    pub(in crate::pipeline) fn read(&self, window: IndexBox, out: &mut [f32]) -> Result<()> {
        self.reader.read_box(window, out)?;
        if self.missing.is_some() || !self.stand_in.is_nan() {
            treat_missing(self.missing, self.stand_in, out);
        }
        Ok(())
    }
}

/// The tetrahedra of a chunk, block after block.
pub(in crate::pipeline) struct ChunkTets<'a> {
    pub(in crate::pipeline) positions: &'a [LatticePos],
    pub(in crate::pipeline) tets: &'a [Tet],
    /// End of each block in `tets`.
    pub(in crate::pipeline) block_ends: &'a [usize],
}

/// Blocks are taken together as long as the box around them has no more samples.
const AROUND_BLOCKS: u64 = 1 << 15;

/// Measures chunks of a volume.
pub(in crate::pipeline) struct SampleErrors {
    grid: SampleGrid,
}

impl SampleErrors {
    pub(in crate::pipeline) fn new(lattice: &Lattice) -> Self {
        Self { grid: SampleGrid::voxels(lattice) }
    }

    /// Samples along each axis.
    pub(in crate::pipeline) fn dims(&self) -> [u64; 3] {
        self.grid.dims()
    }

    /// The errors of a chunk at some steps, given the values of its vertices at each; `read` reads
    /// samples of one.
    pub(in crate::pipeline) fn errors(
        &self,
        cells: &ChunkTets<'_>,
        steps: &StepLanes<'_>,
        read: impl FnMut(usize, IndexBox, &mut [f32]) -> Result<()>,
    ) -> Result<Vec<ErrorSums>> {
        let mut sums: Vec<Tally> = (0..steps.steps()).map(|_| Tally::default()).collect();
        let dims = self.dims();
        self.each_sample(
            cells,
            steps,
            read,
            #[inline(always)]
            |m| add(&mut sums[m.step], &m, dims),
        )?;
        Ok(sums.into_iter().map(Tally::finish).collect())
    }

    /// The errors of a chunk as they are stored: as [`SampleErrors::errors`], and apart for the
    /// cells of each level.
    pub(in crate::pipeline) fn chunk_errors(
        &self,
        cells: &ChunkTets<'_>,
        steps: &StepLanes<'_>,
        levels: Option<&Levels>,
        read: impl FnMut(usize, IndexBox, &mut [f32]) -> Result<()>,
    ) -> Result<Vec<ChunkErrors>> {
        let Some(levels) = levels else {
            let all = self.errors(cells, steps, read)?;
            return Ok(all.into_iter().map(|sums| ChunkErrors { sums, levels: vec![] }).collect());
        };
        let none = vec![BrickErrors::default(); usize::from(levels.top()) + 1];
        let mut all: Vec<_> = (0..steps.steps()).map(|_| (Tally::default(), none.clone())).collect();
        let (dims, lattice) = (self.dims(), levels.cells().lattice);
        self.each_sample(cells, steps, read, |m| {
            let (sums, levels_of) = &mut all[m.step];
            add(sums, &m, dims);
            for (n, (original, reduced)) in m.compared.pairs().enumerate() {
                let level = levels.at(lattice.of_voxel(m.place(n)));
                levels_of[usize::from(level)].add(original, reduced);
            }
        })?;
        Ok(all.into_iter().map(|(sums, levels)| ChunkErrors { sums: sums.finish(), levels }).collect())
    }

    /// Calls `each` for all samples in the tetrahedra of a chunk, some at a time, at each of some
    /// steps.
    pub(in crate::pipeline) fn each_sample(
        &self,
        cells: &ChunkTets<'_>,
        steps: &StepLanes<'_>,
        mut read: impl FnMut(usize, IndexBox, &mut [f32]) -> Result<()>,
        mut each: impl FnMut(Measured<'_>),
    ) -> Result<()> {
        let (mut batch, mut buffers) = (BatchScan::default(), CompareBuffers::default());
        let mut originals = WindowSamples::new(steps);
        let groups = with_vectors(
            #[inline(always)]
            || self.groups(cells),
        );
        for (whole, tets) in groups {
            for window in whole.windows(ERROR_WINDOW) {
                originals.read(window, &mut read)?;
                let (tets, scanner) = (&cells.tets[tets.clone()], Scanner::new(&self.grid, &window));
                with_vectors(
                    #[inline(always)]
                    || {
                        batch.each_member(
                            &scanner,
                            cells.positions,
                            tets,
                            #[inline(always)]
                            |members| buffers.compare(members, &window, tets, steps, &originals, &mut each),
                        )
                    },
                );
            }
        }
        Ok(())
    }

    /// Runs of blocks with the box of their samples, where they have some.
    #[inline(always)]
    fn groups(&self, cells: &ChunkTets<'_>) -> Vec<(IndexBox, Range<usize>)> {
        let mut groups: Vec<(IndexBox, Range<usize>)> = vec![];
        let mut start = 0;
        for &end in cells.block_ends {
            let tets = std::mem::replace(&mut start, end)..end;
            let Some(samples) = self.around(cells.positions, &cells.tets[tets.clone()]) else { continue };
            match groups.last_mut().map(|last| (union(&last.0, &samples), last)) {
                Some((both, last)) if both.checked_len().is_some_and(|n| n <= AROUND_BLOCKS) => {
                    *last = (both, last.1.start..tets.end);
                }
                _ => groups.push((samples, tets)),
            }
        }
        groups
    }

    /// The samples in the bounding box of some tetrahedra.
    #[inline(always)]
    fn around(&self, positions: &[LatticePos], tets: &[Tet]) -> Option<IndexBox> {
        let (mut lo, mut hi) = ([u32::MAX; 4], [0; 4]);
        for tet in tets {
            let (least, most) = corner_box(positions, tet);
            (lo, hi) = (lesser(least, lo), greater(most, hi));
        }
        let ([x, y, z, _], [u, v, w, _]) = (lo, hi);
        (!tets.is_empty()).then(|| self.grid.within([x, y, z], [u, v, w])).filter(|b| !b.is_empty())
    }
}

fn union(a: &IndexBox, b: &IndexBox) -> IndexBox {
    IndexBox {
        lo: std::array::from_fn(|k| a.lo[k].min(b.lo[k])),
        hi: std::array::from_fn(|k| a.hi[k].max(b.hi[k])),
    }
}

/// Adds some samples to the sums of their step.
#[inline(never)]
pub(in crate::pipeline) fn add(sums: &mut Tally, m: &Measured<'_>, dims: [u64; 3]) {
    with_vectors(
        #[inline(always)]
        || sums.add(&m.compared, |n| m.number(n, dims)),
    );
}

/// The reported error of all samples of a volume, each counted once.
pub(in crate::pipeline) fn field_error_of(archive: &StepView, sums: &ErrorSums) -> Result<FieldError> {
    field_error_within(archive, archive.step().plan.source.dims, sums)
}

/// As [`field_error_of`], of the first so many samples along each axis: others are outside.
pub(in crate::pipeline) fn field_error_within(
    archive: &StepView,
    within: [u64; 3],
    sums: &ErrorSums,
) -> Result<FieldError> {
    let source = &archive.step().plan.source;
    let dims = source.dims;
    let [samples, inside] = [dims, within].map(|dims| dims.iter().product::<u64>());
    if sums.samples() != inside {
        let expected = format!("tetrahedra that hold {inside} samples, each once");
        return Err(Error::bad_input(archive.path(), "tetrahedra", expected, sums.samples().to_string())
            .with_help("isospan check tells more"));
    }
    let mut error = sums.field_error(samples);
    if let Some(l) = sums.largest() {
        let index = [l.sample % dims[0], l.sample / dims[0] % dims[1], l.sample / dims[0] / dims[1]];
        error.worst = Some(Worst {
            sample: l.sample,
            index: Some(index),
            world: world_of(archive, index.map(|i| i as f64))?,
            original: source.in_file(l.original),
            reduced: source.in_file(l.reduced),
        });
    }
    Ok(error.of_source(source.offset, source.rounding))
}
