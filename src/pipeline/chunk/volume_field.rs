//! The field of a structured volume: the points of some bricks are interpolated from the samples
//! around them, read for that.

use super::errors::Originals;
use super::groups::Groups;
use super::placement::Placement;
use crate::pipeline::inputs::{Scratch, treat_missing};
use crate::pipeline::read::MeshedChunk;
use crate::pipeline::settings::NanPolicy;
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::geom::LatticePos;
use isospan_io::grid::{BrickGrid, Chunk, IndexBox};
use isospan_io::volume::VolumeReader;
use isospan_mesh::sample::{Interpolation, Places, Values};
use isospan_mesh::simd::with_vectors;
use std::sync::atomic::{AtomicU64, Ordering};

/// A volume, and how it is sampled.
pub(in crate::pipeline) struct GridField {
    pub(in crate::pipeline) reader: Box<dyn VolumeReader>,
    /// The copy that is read; it is removed after the reader.
    #[allow(dead_code, reason = "what counts is when it is dropped")]
    pub(in crate::pipeline) scratch: Option<Scratch>,
    pub(in crate::pipeline) bricks: BrickGrid,
    pub(in crate::pipeline) interpolation: Interpolation,
    pub(in crate::pipeline) values: Values,
    pub(in crate::pipeline) nan: NanPolicy,
    /// The value that replaces samples that are not finite.
    pub(in crate::pipeline) stand_in: Option<f32>,
    pub(in crate::pipeline) missing: Option<f64>,
    /// Slices below have been given up.
    pub(in crate::pipeline) released: AtomicU64,
}

/// Whether all samples are finite. Looks at all of them, in vectors.
fn all_finite(samples: &[f32]) -> bool {
    with_vectors(
        #[inline(always)]
        || samples.iter().fold(true, |all, v| all & v.is_finite()),
    )
}

/// Interpolates the values of some steps, group by group: where a vertex lies is found out once for
/// all of them.
pub(super) fn interpolate(
    fields: &[&GridField],
    mesh: &MeshedChunk,
    groups: &Groups,
    values: &mut [Vec<f32>],
    cancel: &CancelToken,
    note: impl Fn(usize, Result<()>) -> Result<()>,
) -> Result<()> {
    let GridField { bricks, interpolation, values: wanted, .. } = fields[0];
    let vertices = if *wanted == Values::Fit { mesh.all_positions.len() } else { mesh.vertices() };
    values.iter_mut().for_each(|values| values.resize(vertices, 0.0));
    let mut places = Places::new(*interpolation, &bricks.lattice);
    let (mut voxels, mut found) = (vec![], vec![]);
    for (core, others) in groups.iter() {
        cancel.check()?;
        places.find(&mesh.all_positions, core.clone(), others);
        for (n, (field, values)) in fields.iter().zip(&mut *values).enumerate() {
            found.clear();
            note(n, field.sample(&places, &mut voxels, &mut found))?;
            let (of_core, of_others) = found.split_at(core.len());
            values[core.clone()].copy_from_slice(of_core);
            others.iter().zip(of_others).for_each(|(&v, &value)| values[v as usize] = value);
        }
    }
    Ok(())
}

impl GridField {
    pub(super) fn place(&self, mesh: &MeshedChunk) -> Placement {
        Placement { groups: Groups::of(&self.bricks, mesh), ..Placement::default() }
    }

    pub(super) fn originals(&self) -> Originals<'_> {
        Originals::Volume { reader: &*self.reader, missing: self.missing, stand_in: self.stand_in }
    }

    pub(super) fn will_need(&self, chunk: &Chunk) {
        self.reader.will_need(self.voxels_of(chunk));
    }

    /// Gives up the samples that no later chunk will need: those below the layer of chunks that
    /// lies before the current one, as a halo reaches into its neighbours.
    pub(in crate::pipeline) fn pass(&self, chunk: &Chunk) {
        let samples = self.voxels_of(chunk);
        let keep = samples.lo[2].saturating_sub(samples.dims()[2]);
        let released = self.released.fetch_max(keep, Ordering::Relaxed);
        if keep > released {
            self.reader.release(released..keep);
        }
    }

    /// Reads the samples of a window that values are fitted to; NaN means no sample.
    pub(in crate::pipeline) fn read_window(&self, window: IndexBox, out: &mut [f32]) -> Result<()> {
        self.reader.read_box(window, out)?;
        if self.nan == NanPolicy::Error && self.missing.is_none() && all_finite(out) {
            return Ok(());
        }
        self.treat_missing(out);
        if self.nan == NanPolicy::Error
            && let Some(bad) = out.iter().position(|v| v.is_nan())
        {
            let (d, i) = (window.dims(), bad as u64);
            let at = [i % d[0], i / d[0] % d[1], i / d[0] / d[1]];
            let sample = std::array::from_fn(|k| window.lo[k] + at[k]);
            return Err(self.nan_error(self.bricks.lattice.of_voxel(sample)));
        }
        Ok(())
    }

    /// Appends the values at some places, whose samples are read into `voxels`.
    fn sample(&self, places: &Places<'_>, voxels: &mut Vec<f32>, out: &mut Vec<f32>) -> Result<()> {
        voxels.resize(places.voxels().len(), 0.0);
        self.reader.read_box(places.voxels(), voxels)?;
        // Where infinite samples are refused, they show in the values.
        if self.nan != NanPolicy::Error || self.missing.is_some() {
            self.treat_missing(voxels);
        }
        let first = out.len();
        places.sample(voxels, out);
        if self.nan == NanPolicy::Error
            && let Some(bad) = out[first..].iter().position(|v| !v.is_finite())
        {
            return Err(self.nan_error(places.positions()[bad]));
        }
        Ok(())
    }

    /// Missing and infinite samples become NaN, or the value that stands for them.
    fn treat_missing(&self, voxels: &mut [f32]) {
        treat_missing(self.missing, self.stand_in.unwrap_or(f32::NAN), voxels);
    }

    fn nan_error(&self, at: LatticePos) -> Error {
        let p = self.bricks.lattice.to_index_space(at);
        let place = format!("sample near ({:.0}, {:.0}, {:.0})", p[0], p[1], p[2]);
        Error::bad_input(
            &self.reader.info().path,
            place,
            "a finite value",
            "NaN, infinity or a missing value",
        )
        .with_help("choose `nan=mask` (leave a hole there) or `nan=VALUE` (use a value instead)")
    }

    /// The samples around a chunk's core: what will be read for it, up to a border.
    fn voxels_of(&self, chunk: &Chunk) -> IndexBox {
        let last = chunk.core.hi.map(|h| h - 1);
        self.interpolation.voxels_for(&self.bricks.lattice, &[chunk.core.lo, last])
    }
}
