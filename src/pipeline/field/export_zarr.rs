//! `export` of a pyramid as OME-Zarr: a level and all coarser ones, of one step or of several.
//!
//! ```text
//!  step ─▶ field ─▶ level ─▶ chunks, decoded side by side ─▶ a file each
//! ```
//!
//! Memory: a chunk for each thread.

use super::export_grid::{GridReport, GridSettings, LevelGrid, Views, field_of};
use crate::pipeline::read::{OpenArchive, StepView};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Clock, Progress};
use isospan_io::formats::ome_zarr::{ZarrFolder, ZarrImage, ZarrLevel, ZarrTimes, unit_name};
use isospan_io::formats::samples::{SampleField, limits};
use isospan_io::grid::{Geometry, IndexBox};
use isospan_io::volume::ScalarType;
use isospan_io::volume::units::{Units, common};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// Samples along each axis of a chunk, and of those of a large volume.
const CHUNK: u64 = 64;
const LARGE_CHUNK: u64 = 128;
/// More samples than this are a large volume.
const LARGE: u64 = 1 << 30;

/// The steps that are exported.
pub(in crate::pipeline) enum Moments<'a> {
    /// One step, or a moment between two.
    One(&'a StepView),
    /// Those at positions in the manifest.
    Steps(&'a Arc<OpenArchive>, Range<usize>),
}

impl Moments<'_> {
    fn count(&self) -> usize {
        match self {
            Self::One(_) => 1,
            Self::Steps(_, positions) => positions.len(),
        }
    }

    /// Uses the n-th step, whose files are closed then.
    fn with<T>(&self, n: usize, use_it: impl FnOnce(&StepView) -> Result<T>) -> Result<T> {
        match self {
            Self::One(view) => use_it(view),
            Self::Steps(archive, positions) => use_it(&archive.step_at(positions.start + n)),
        }
    }
}

/// Writes a pyramid as OME-Zarr: see
/// [`Step::write_ome_zarr`](crate::pipeline::Step::write_ome_zarr).
pub(in crate::pipeline) fn export_zarr(
    moments: &Moments<'_>,
    settings: &GridSettings,
    out: &Path,
    replace: bool,
    progress: &dyn Progress,
) -> Result<GridReport> {
    let start = Clock::start();
    let (grids, (placed, flips)) = moments.with(0, |view| {
        let grids = levels_of(view, settings)?;
        let placed = placed(view, &grids)?;
        Ok((grids, placed))
    })?;
    let about = About::of(moments, &settings.fields, settings.level)?;
    let finest = &grids[0];
    let notices = about.notices();
    let folder = ZarrFolder::create(out, about.image(out, placed, finest), replace)?;
    let writer = Writer { folder, flips, scalar: about.field.scalar, settings, progress };
    let each: u64 = grids.iter().map(|grid| grid.dims().iter().product::<u64>()).sum();
    let parts = (moments.count() * about.channels.len()) as u64;
    progress.begin("export", each.saturating_mul(parts), "samples");
    let (mut void, mut bytes_read) = (0, 0);
    for n in 0..moments.count() {
        moments.with(n, |view| {
            let before = view.bytes_read();
            let views = Views::of(view, &settings.fields)?;
            for (channel, of_field) in views.all().enumerate() {
                for (level, grid) in grids.iter().enumerate() {
                    void += writer.write_level(of_field, grid, level, [n as u64, channel as u64])?;
                }
            }
            bytes_read += view.bytes_read() - before + views.others_read();
            Ok(())
        })?;
    }
    Ok(GridReport {
        fields: about.channels.into_iter().map(|(name, _)| name).collect(),
        types: vec![about.field.scalar.name()],
        level: settings.level,
        levels: grids.len() as u64,
        steps: moments.count() as u64,
        dims: finest.dims(),
        first: finest.first(),
        stride: finest.stride(),
        void,
        notices,
        bytes_read,
        file_bytes: writer.folder.publish()?,
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// The levels that are written, from the finest to the last one with a sample in the region.
fn levels_of(view: &StepView, settings: &GridSettings) -> Result<Vec<LevelGrid>> {
    let of = |level| LevelGrid::of(view, level, settings.roi.as_ref(), &settings.resources);
    let mut grids = vec![of(settings.level)?];
    for level in settings.level + 1..=view.pyramid()?.pyramid.coarsest() {
        match of(level) {
            Ok(grid) => grids.push(grid),
            // No node of a coarser level is in the region either.
            Err(Error::Usage(_)) if settings.roi.is_some() => break,
            Err(e) => return Err(e),
        }
    }
    Ok(grids)
}

/// Where the levels lie, and along which axes they are turned round, so that each has a positive
/// scale.
fn placed(view: &StepView, grids: &[LevelGrid]) -> Result<(Vec<ZarrLevel>, [bool; 3])> {
    let refuse = |what: &str, instead: &str| {
        Err(Error::usage(format!(
            "{}: OME-Zarr has a scale and a translation, and no place for {what}; write {instead}",
            view.path().display()
        )))
    };
    if let Some(map) = view.coordinates()? {
        let is_rectilinear = map.axes().is_some();
        return refuse("coordinates of a grid's own", if is_rectilinear { ".vtr" } else { ".vts" });
    }
    let Geometry { direction, .. } = view.step().plan.source.geometry;
    let is_along =
        |a: usize| (0..3).all(|b| (direction[a][b].abs() - f64::from(u8::from(a == b))).abs() < 1e-9);
    if !(0..3).all(is_along) {
        return refuse("axes that are turned", ".nrrd, .nii.gz, .mha or .vti");
    }
    let flips = [0, 1, 2].map(|a| direction[a][a] < 0.0);
    let level = |grid: &LevelGrid| {
        let of = grid.geometry(view);
        let last = grid.dims().map(|n| (n - 1) as f64);
        let far = of.to_world(last);
        let translation = std::array::from_fn(|a| if flips[a] { far[a] } else { of.origin[a] });
        ZarrLevel { dims: grid.dims(), scale: of.spacing, translation }
    };
    Ok((grids.iter().map(level).collect(), flips))
}

/// What all steps and fields of an image have in common.
struct About {
    field: SampleField,
    units: Units,
    times: Option<ZarrTimes>,
    /// The names and ranges of fields.
    channels: Vec<(String, [f64; 2])>,
    /// Whether steps have times that are not evenly apart.
    has_odd_times: bool,
}

impl About {
    fn of(moments: &Moments<'_>, fields: &[String], level: usize) -> Result<Self> {
        let (mut all, mut units, mut times, mut channels) = (vec![], vec![], vec![], vec![]);
        for n in 0..moments.count() {
            moments.with(n, |view| {
                times.push(view.step().plan.time);
                let views = Views::of(view, fields)?;
                for (c, view) in views.all().enumerate() {
                    let field = field_of(view, level);
                    let range = view.step().file_range().unwrap_or([0.0, 1.0]);
                    if n == 0 {
                        channels.push((field.name.clone(), range));
                    } else if let Some((_, [lo, hi])) = channels.get_mut(c) {
                        (*lo, *hi) = (lo.min(range[0]), hi.max(range[1]));
                    }
                    units.push(view.step().plan.source.units.clone());
                    all.push(field);
                }
                Ok(())
            })?;
        }
        let offset = all[0].offset;
        let is_one = all.iter().all(|field| field.scalar == all[0].scalar);
        let field = if is_one { all[0].clone() } else { SampleField::floats(&all[0].name, offset) };
        let mut units_of_all = units[0].clone();
        units_of_all.value = common(units.into_iter().map(|units| units.value));
        let even = evenly(&times);
        let has_odd_times = even.is_none() && times.iter().any(Option::is_some);
        let count = times.len() as u64;
        let [start, step] = even.unwrap_or([0.0, 1.0]);
        let times = (count > 1).then_some(ZarrTimes { count, start, step });
        if has_odd_times {
            units_of_all.time = None;
        }
        Ok(Self { field, units: units_of_all, times, channels, has_odd_times: has_odd_times && count > 1 })
    }

    /// The image at `out`, with these levels, the finest of which has the samples of a grid.
    fn image(&self, out: &Path, levels: Vec<ZarrLevel>, finest: &LevelGrid) -> ZarrImage {
        let samples = finest.dims().into_iter().fold(1, u64::saturating_mul);
        ZarrImage {
            name: out.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
            scalar: self.field.scalar,
            offset: self.field.offset,
            units: self.units.clone(),
            levels,
            chunk: if samples > LARGE { LARGE_CHUNK } else { CHUNK },
            times: self.times,
            channels: if self.channels.len() > 1 { self.channels.clone() } else { vec![] },
        }
    }

    /// What the image has no place for, a line each.
    fn notices(&self) -> Vec<String> {
        let mut lines = vec![];
        let lengths = self.units.length.as_ref();
        let times = self.units.time.as_ref().filter(|_| self.times.is_some());
        for unit in lengths.into_iter().chain(times).filter(|unit| unit_name(unit).is_none()) {
            lines.push(format!("OME-Zarr has no name for the unit {unit}"));
        }
        if self.has_odd_times {
            lines.push(
                "OME-Zarr has no place for times that are not evenly apart: it has step numbers".into(),
            );
        }
        lines
    }
}

/// The time of the first step, and from each to the next, where that is the same.
fn evenly(times: &[Option<f64>]) -> Option<[f64; 2]> {
    let times: Vec<f64> = times.iter().copied().collect::<Option<_>>()?;
    let (first, last) = (*times.first()?, *times.last()?);
    let step = (last - first) / (times.len() - 1).max(1) as f64;
    let is_even = (0..times.len()).all(|n| (first + step * n as f64 - times[n]).abs() <= 1e-6 * step);
    (step > 0.0 && is_even).then_some([first, step])
}

/// Writes levels.
struct Writer<'a> {
    folder: ZarrFolder,
    flips: [bool; 3],
    scalar: ScalarType,
    settings: &'a GridSettings,
    progress: &'a dyn Progress,
}

impl Writer<'_> {
    /// Writes a level of a field, of the step and channel `at`; returns how many samples have no
    /// value.
    fn write_level(&self, view: &StepView, grid: &LevelGrid, level: usize, at: [u64; 2]) -> Result<u64> {
        let (dims, chunk) = (grid.dims(), self.folder.chunk_dims(level));
        let write = |place: [u64; 3]| {
            let lo: [u64; 3] = std::array::from_fn(|a| place[a] * chunk[a]);
            let hi: [u64; 3] = std::array::from_fn(|a| (lo[a] + chunk[a]).min(dims[a]));
            // In the order of the archive.
            let window = IndexBox {
                lo: std::array::from_fn(|a| if self.flips[a] { dims[a] - hi[a] } else { lo[a] }),
                hi: std::array::from_fn(|a| if self.flips[a] { dims[a] - lo[a] } else { hi[a] }),
            };
            let mut values = grid.nodes_in(view, &window)?;
            flip(&mut values, window.dims(), self.flips);
            // Nodes of coarser levels are means of whole numbers.
            if let Some([least, most]) = limits(self.scalar).filter(|_| level > 0) {
                let offset = view.step().plan.source.offset;
                let [least, most] = [least, most].map(|n| (n as f64 - offset) as f32);
                values.iter_mut().for_each(|v| *v = v.round().clamp(least, most));
            }
            self.folder.write_chunk(level, at, place, &values)?;
            self.progress.advance(values.len() as u64);
            Ok(values.iter().filter(|v| v.is_nan()).count() as u64)
        };
        grid.each_part(view, chunk, &self.settings.resources, write)
    }
}

/// Turns an array round along some axes.
fn flip(values: &mut [f32], dims: [u64; 3], flips: [bool; 3]) {
    let [nx, ny, nz] = dims.map(|n| n as usize);
    if flips[0] {
        values.chunks_mut(nx).for_each(<[f32]>::reverse);
    }
    if flips[1] {
        for slice in values.chunks_mut(nx * ny) {
            for y in 0..ny / 2 {
                let (low, high) = slice.split_at_mut((ny - 1 - y) * nx);
                low[y * nx..][..nx].swap_with_slice(&mut high[..nx]);
            }
        }
    }
    if flips[2] {
        let slice = nx * ny;
        for z in 0..nz / 2 {
            let (low, high) = values.split_at_mut((nz - 1 - z) * slice);
            low[z * slice..][..slice].swap_with_slice(&mut high[..slice]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_are_turned_round() {
        let mut values: Vec<f32> = (0..24).map(|i| i as f32).collect();
        let before = values.clone();
        flip(&mut values, [2, 3, 4], [true, true, true]);
        assert!(values.iter().eq(before.iter().rev()));
        flip(&mut values, [2, 3, 4], [true, false, true]);
        flip(&mut values, [2, 3, 4], [false, true, false]);
        assert_eq!(values, before);
    }

    #[test]
    fn times_are_evenly_apart_or_are_not() {
        let of = |times: &[f64]| evenly(&times.iter().copied().map(Some).collect::<Vec<_>>());
        assert_eq!(of(&[1.0, 1.5, 2.0]), Some([1.0, 0.5]));
        assert_eq!((of(&[1.0, 1.5, 2.1]), of(&[1.0, 1.0]), evenly(&[Some(1.0), None])), (None, None, None));
    }
}
