//! Which level of a pyramid has surfaces of at most so many triangles?
//!
//! Levels are extracted from the coarsest on, without a weld, until one has more. Each has about
//! four times the triangles of the one before, and that one ends where it exceeds the number. So
//! the work is that of the level that is chosen, about, however large the finest one is.

use super::active::{cut_of, work_of};
use super::cubes::{march, part_bytes};
use super::question::ChunkWork;
use super::settings::SurfaceSettings;
use crate::pipeline::read::{Cut, LevelChoice, StepView, world_map};
use crate::surface::WorldMap;
use crate::surface::edit::clip::HalfSpace;
use crate::surface::extract::{ChunkSurface, CubeBench};
use isospan_io::error::{Error, Result};
use isospan_io::exec::pool;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// The level of a question for surfaces.
///
/// # Errors
/// Those of [`StepView::level`]; [`Error::Usage`] where no level has so few triangles.
pub(in crate::pipeline) fn level_of(archive: &StepView, settings: &SurfaceSettings) -> Result<usize> {
    match settings.level {
        Some(LevelChoice::Triangles(most)) if !settings.isovalues.is_empty() => {
            of_triangles(archive, settings, most)
        }
        choice => archive.level(choice),
    }
}

fn of_triangles(archive: &StepView, settings: &SurfaceSettings, most: u64) -> Result<usize> {
    let coarsest = archive.coarsest_level(LevelChoice::Triangles(most))?;
    settings.check()?;
    let count = Count::new(archive, settings)?;
    let mut chosen = None;
    for level in (0..=coarsest).rev() {
        let found = count.up_to(level, most)?;
        if found > most {
            // One that has none where this one has some is no picture of it.
            return match chosen {
                Some((coarser, 1..)) => Ok(coarser),
                _ => Err(Error::usage(format!(
                    "{}: no level has a surface of at most {most} triangles: level {level} has {}",
                    archive.path().display(),
                    count.up_to(level, u64::MAX)?
                ))),
            };
        }
        chosen = Some((level, found));
    }
    Ok(0)
}

/// Counts triangles.
struct Count<'a> {
    archive: &'a StepView,
    settings: &'a SurfaceSettings,
    isovalues: Vec<f32>,
    cut: Option<Cut>,
    world: WorldMap,
}

impl<'a> Count<'a> {
    fn new(archive: &'a StepView, settings: &'a SurfaceSettings) -> Result<Self> {
        let (cut, _) = cut_of(archive, settings)?;
        let (isovalues, world) = (settings.kept(archive), world_map(archive));
        Ok(Self { archive, settings, isovalues, cut, world })
    }

    /// The triangles of all surfaces of a level, or some number above `most`. Where surfaces are
    /// cut, it is the one that cutting can give at most.
    fn up_to(&self, level: usize, most: u64) -> Result<u64> {
        if !self.settings.can_answer(self.archive) {
            return Ok(0);
        }
        let work = work_of(self.archive, self.settings, level, self.cut.as_ref())?.work;
        let found = AtomicU64::new(0);
        let count = |work: &ChunkWork| {
            self.settings.resources.cancel.check()?;
            if found.load(Ordering::Relaxed) <= most {
                found.fetch_add(self.in_part(level, work)?, Ordering::Relaxed);
            }
            Ok(())
        };
        pool(self.threads(&work))?.install(|| work.par_iter().map(count).collect::<Result<()>>())?;
        Ok(found.into_inner())
    }

    /// Threads for which there is memory.
    fn threads(&self, work: &[ChunkWork]) -> usize {
        let isovalues = self.isovalues.len() as u64;
        let bytes =
            |w: &ChunkWork| w.cells.as_ref().map_or(1, |c| part_bytes(c, w.blocks.len() as u64, isovalues));
        let largest = work.iter().map(bytes).max().unwrap_or(1);
        let fitting = (self.settings.resources.memory / 2 / largest).max(1);
        self.settings.resources.worker_threads().min(usize::try_from(fitting).unwrap_or(usize::MAX))
    }

    fn in_part(&self, level: usize, work: &ChunkWork) -> Result<u64> {
        let (mut surface, mut bench) = (ChunkSurface::default(), CubeBench::default());
        let Some(cells) = &work.cells else { return Ok(0) };
        let mut count = 0;
        march(self.archive, level, cells, |block| {
            for &isovalue in &self.isovalues {
                surface.start(isovalue, 0);
                surface.add_cubes(block, self.settings.cap, &self.world, &mut bench);
                count += match &self.cut {
                    None => surface.triangles().len() as u64,
                    Some(cut) => cut_triangles(&surface, &cut.half_spaces, self.world.origin()),
                };
            }
        })?;
        Ok(count)
    }
}

/// Triangles of a surface after it is cut, at most: each plane that crosses one makes one more.
fn cut_triangles(surface: &ChunkSurface, half_spaces: &[HalfSpace], origin: [f64; 3]) -> u64 {
    let outside = |p: [f64; 3]| {
        let bit = |(n, h): (usize, &HalfSpace)| u8::from(h.distance(p) < 0.0) << n;
        half_spaces.iter().enumerate().map(bit).fold(0, |bits, bit| bits | bit)
    };
    let codes: Vec<u8> = surface.vertices().iter().map(|v| outside(v.world(origin))).collect();
    let count = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| codes[v as usize]);
        if a & b & c == 0 { 1 + u64::from((a | b | c).count_ones()) } else { 0 }
    };
    surface.triangles().iter().map(count).sum()
}
