//! How far is a surface of an archive from marching cubes of the samples that it was made from?
//!
//! The samples are read box by box, each with a sample around it, and their surface is welded as
//! that of an archive is. Both surfaces are in the scratch folder beyond their share of memory.

use super::query::make;
use super::settings::SurfaceSettings;
use super::weld::SurfaceStorage;
use crate::compare::apart;
use crate::pipeline::field::{SourceSamples, SurfaceErrors, SurfaceSize};
use crate::pipeline::read::{LevelChoice, StepView, in_world, world_map};
use crate::surface::SurfaceSource;
use crate::surface::edit::components::totals;
use crate::surface::edit::fans::split_fans;
use crate::surface::extract::{ChunkSurface, CubeBench, GridBlock};
use crate::surface::weld::{BuilderSettings, StoredSurface, SurfaceBuilder};
use isospan_io::error::Result;
use isospan_io::exec::{Progress, Resources, in_order};
use isospan_io::geom::PointId;
use isospan_io::grid::IndexBox;

/// Cells along each axis of a box of samples, at most.
const PART: [u64; 3] = [128, 128, 64];
/// Bytes in which a box is extracted, for each of its samples.
const SAMPLE: u64 = 40;

/// The errors of the surfaces of a step at some isovalues.
pub(in crate::pipeline) fn surface_errors(
    archive: &StepView,
    samples: &SourceSamples,
    isovalues: &[f64],
    level: Option<LevelChoice>,
    progress: &dyn Progress,
) -> Result<Vec<SurfaceErrors>> {
    isovalues.iter().map(|&isovalue| errors_at(archive, samples, isovalue, level, progress)).collect()
}

fn errors_at(
    archive: &StepView,
    samples: &SourceSamples,
    isovalue: f64,
    level: Option<LevelChoice>,
    progress: &dyn Progress,
) -> Result<SurfaceErrors> {
    let resources = &samples.resources;
    let own = SurfaceSettings {
        isovalues: vec![isovalue],
        level,
        resources: resources.clone(),
        ..SurfaceSettings::default()
    };
    let storage = SurfaceStorage { scratch: resources.scratch_folder(), reused: vec![] };
    let mut made = make(archive, &own, storage, None, progress)?;
    let found = made.surfaces.swap_remove(0);
    let surface = placed(archive, found.surface, resources)?;
    let kept = archive.step().plan.source.kept(isovalue);
    let of_samples = placed(archive, surface_of_samples(archive, samples, kept, progress)?, resources)?;
    let rest = resources.clone().with_memory(resources.memory / 2);
    progress.begin("distances", 2, "surfaces");
    let to_source = apart(&surface, &of_samples, &rest)?;
    progress.advance(1);
    let to_archive = apart(&of_samples, &surface, &rest)?;
    progress.advance(1);
    Ok(SurfaceErrors {
        step: archive.step().number(),
        isovalue,
        archive: size(&surface, &rest)?,
        source: size(&of_samples, &rest)?,
        to_source,
        to_archive,
    })
}

fn size(surface: &StoredSurface, resources: &Resources) -> Result<SurfaceSize> {
    let found = totals(surface, &[], &beside(resources, 1))?;
    Ok(SurfaceSize {
        triangles: surface.triangle_count(),
        area: found.area,
        pieces: found.pieces,
        closed_pieces: found.closed_pieces,
    })
}

/// Where a surface is, which has a part of the memory.
fn beside(resources: &Resources, part: u64) -> BuilderSettings {
    let memory_bytes = usize::try_from(resources.memory / part).unwrap_or(usize::MAX);
    BuilderSettings { memory_bytes, scratch: resources.scratch_folder() }
}

/// A surface of index space in the world, where the grid has coordinates of its own.
fn placed(archive: &StepView, surface: StoredSurface, resources: &Resources) -> Result<StoredSurface> {
    match archive.coordinate_record() {
        None => Ok(surface),
        Some(_) => in_world(archive, &surface, |s| StoredSurface::of(s, &beside(resources, 16))),
    }
}

/// Marching cubes of the samples.
fn surface_of_samples(
    archive: &StepView,
    samples: &SourceSamples,
    isovalue: f32,
    progress: &dyn Progress,
) -> Result<StoredSurface> {
    let (dims, world, resources) = (archive.step().plan.source.dims, world_map(archive), &samples.resources);
    let place = beside(resources, 16);
    let mut builder = SurfaceBuilder::new(&world, &place);
    if dims.contains(&1) {
        return builder.finish();
    }
    let counts: [u64; 3] = std::array::from_fn(|a| (dims[a] - 1).div_ceil(PART[a]));
    let of_layer = counts[0] * counts[1];
    let cells = |n: usize| -> [[u64; 2]; 3] {
        let n = n as u64;
        let at = [n % counts[0], n / counts[0] % counts[1], n / of_layer];
        std::array::from_fn(|a| [at[a] * PART[a], ((at[a] + 1) * PART[a]).min(dims[a] - 1)])
    };
    let make = |n: usize| {
        resources.cancel.check()?;
        let cells = cells(n);
        let window = IndexBox {
            lo: cells.map(|[lo, _]| lo.saturating_sub(1)),
            hi: std::array::from_fn(|a| (cells[a][1] + 2).min(dims[a])),
        };
        let values = samples.read(window)?;
        let size = window.dims().map(|n| n as usize);
        let block = GridBlock { grid: dims, stride: [1; 3], start: window.lo, size, values: &values, cells };
        let (mut surface, mut bench) = (ChunkSurface::default(), CubeBench::default());
        surface.start(isovalue, 0);
        surface.add_cubes(&block, false, &world, &mut bench);
        surface.finish(&world);
        Ok(surface)
    };
    let bytes =
        vec![SAMPLE * PART.map(|n| n + 3).iter().product::<u64>(); counts.iter().product::<u64>() as usize];
    let threads = archive.pools.lend(resources.threads)?;
    progress.begin("surface of the samples", bytes.len() as u64, "parts");
    in_order(&bytes, resources.memory / 4, &threads, make, |n, surface: ChunkSurface| {
        builder.push(&surface)?;
        progress.advance(1);
        if !(n as u64 + 1).is_multiple_of(of_layer) {
            return Ok(());
        }
        // Of edges below the next layer no box has any more.
        let first = cells(n)[2][1] * dims[0] * dims[1];
        builder.keep_open(|a: PointId, b: PointId| a.index().max(b.index()) >= first)
    })?;
    let surface = builder.finish()?;
    match archive.may_have_holes() {
        true => split_fans(surface, &place, resources.memory / 4),
        false => Ok(surface),
    }
}
