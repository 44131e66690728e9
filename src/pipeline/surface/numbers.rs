//! Numbers at an isovalue: how large are its surface and the parts on both sides of it, in how many
//! pieces, do they reach across the domain, and which ball fits in?
//!
//! Area and pieces are those of the surface that a query extracts. Volumes are those that marching
//! cubes bounds in each cell, or the linear field in each tetrahedron, summed as integers. What
//! needs neighbours, pieces of phases and balls, is for grids: see [`crate::phase`].

use super::level::level_of;
use super::phases::{Phases, phases};
use super::query::make;
use super::settings::SurfaceSettings;
use super::weld::SurfaceStorage;
use crate::phase::{BallMeans, Connected, Phase, PhaseMap, connected, largest_ball};
use crate::pipeline::read::{Blocks, DecodedChunk, IndexToWorld, StepView, Visit, bounds, world_of};
use crate::surface::edit::components::{SurfaceTotals, totals};
use crate::surface::weld::{BuilderSettings, StoredSurface};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Threads};
use isospan_io::geom::vec3::{cross, dot, minus};
use serde::Serialize;
use std::path::Path;

/// What an isovalue makes of a field. Lengths are world units.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct NumbersReport {
    /// The isovalue.
    pub isovalue: f64,
    /// The level of a pyramid that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub level: Option<usize>,
    /// Area of the surface.
    pub area: f64,
    /// Connected pieces of the surface.
    pub pieces: u64,
    /// Pieces that are closed; the others end at the faces of the domain, or where data is missing.
    pub closed_pieces: u64,
    /// Volume of the domain: of all cells that are not void.
    pub volume: f64,
    /// The part of the domain at or above the isovalue.
    pub above: PhaseNumbers,
    /// The part below it.
    pub below: PhaseNumbers,
}

/// A part of the domain on one side of an isovalue.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PhaseNumbers {
    /// Volume.
    pub volume: f64,
    /// Its share of the domain, 0 to 1.
    pub fraction: f64,
    /// Connected pieces, as the surface bounds them. Of grids only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pieces: Option<u64>,
    /// Whether a piece joins the two faces of the domain across x, y, z. Of grids only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub percolates: Option<[bool; 3]>,
    /// The largest ball around a sample that lies in this part and in the domain. None of an empty
    /// part. Of grids whose axes are at right angles only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ball: Option<InscribedBall>,
}

/// A ball in a part of the domain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct InscribedBall {
    /// Its centre in the world: the place of a sample.
    pub centre: [f64; 3],
    /// Its radius: the distance from the surface, or from the nearest face of the domain.
    pub radius: f64,
    /// The distance from the nearest sample that is not in this part, or from the nearest face.
    /// The centre is the sample at which this is largest.
    pub to_samples: f64,
}

/// The numbers at the only isovalue of a question.
pub(in crate::pipeline) fn numbers(
    archive: &StepView,
    isovalue: f64,
    settings: &SurfaceSettings,
    progress: &dyn Progress,
) -> Result<NumbersReport> {
    settings.check()?;
    let level = level_of(archive, settings)?;
    let kept = archive.step().plan.source.kept(isovalue);
    let scratch = settings.resources.scratch_folder();
    let mut report = NumbersReport { isovalue, ..NumbersReport::default() };
    let threads = archive.pools.lend(settings.resources.threads)?;
    if archive.is_pyramid() {
        report.level = Some(level);
        let nodes = archive.pyramid()?.pyramid.nodes(level);
        if nodes.iter().all(|n| *n > 1) {
            let found = phases(archive, level, kept, settings, (&threads, &scratch), progress)?;
            report.set_volumes(found.above, found.all);
            let means = PhaseMeans { archive, level, settings, threads: &threads, scratch: &scratch };
            means.measure(&found, &mut report)?;
        }
    } else {
        let (above, all) = volumes_of_tetrahedra(archive, kept, settings, progress)?;
        report.set_volumes(above, all);
    }
    drop(threads);
    let centres: Vec<[f64; 3]> = report.balls().map(|ball| ball.centre).collect();
    let found = surface_totals(archive, &centres, settings, progress)?;
    for (ball, distance) in report.balls().zip(&found.distances) {
        ball.radius = ball.to_samples.min(*distance);
    }
    Ok(NumbersReport { area: found.area, pieces: found.pieces, closed_pieces: found.closed_pieces, ..report })
}

impl NumbersReport {
    fn set_volumes(&mut self, above: f64, all: f64) {
        let below = all - above;
        self.volume = all;
        for (phase, volume) in [(&mut self.above, above), (&mut self.below, below)] {
            phase.volume = volume;
            phase.fraction = if all > 0.0 { volume / all } else { 0.0 };
        }
    }

    fn balls(&mut self) -> impl Iterator<Item = &mut InscribedBall> {
        self.above.ball.iter_mut().chain(&mut self.below.ball)
    }
}

/// The surface, extracted and measured in the world.
fn surface_totals(
    archive: &StepView,
    places: &[[f64; 3]],
    settings: &SurfaceSettings,
    progress: &dyn Progress,
) -> Result<SurfaceTotals> {
    let scratch = settings.resources.scratch_folder();
    let storage = SurfaceStorage { scratch: scratch.clone(), reused: vec![] };
    let made = make(archive, settings, storage, None, progress)?;
    let half = usize::try_from(settings.resources.memory / 2).unwrap_or(usize::MAX);
    let beside = BuilderSettings { memory_bytes: half, scratch };
    let found = &made.surfaces[0];
    if found.is_placed || archive.coordinate_record().is_none() {
        return totals(&found.surface, places, &beside);
    }
    let place = BuilderSettings { memory_bytes: half / 4, ..beside.clone() };
    let placed = found.in_world(archive, &found.surface, |surface| StoredSurface::of(surface, &place))?;
    totals(&placed, places, &beside)
}

/// What the phases of a grid are measured with.
struct PhaseMeans<'a> {
    archive: &'a StepView,
    level: usize,
    settings: &'a SurfaceSettings,
    threads: &'a Threads,
    scratch: &'a Path,
}

impl PhaseMeans<'_> {
    fn measure(&self, found: &Phases, report: &mut NumbersReport) -> Result<()> {
        let axes = self.axes()?;
        for (phase, to) in [(Phase::Above, &mut report.above), (Phase::Below, &mut report.below)] {
            let cancel = &self.settings.resources.cancel;
            let Connected { pieces, percolates, .. } = connected(&found.map, phase, cancel)?;
            (to.pieces, to.percolates) = (Some(pieces), Some(percolates));
            if let Some(axes) = &axes {
                to.ball = self.ball(&found.map, phase, axes)?;
            }
        }
        Ok(())
    }

    fn ball(&self, map: &PhaseMap, phase: Phase, axes: &[Vec<f64>; 3]) -> Result<Option<InscribedBall>> {
        let resources = &self.settings.resources;
        let memory = usize::try_from(resources.memory / 4).unwrap_or(usize::MAX);
        let (scratch, cancel) = (self.scratch, &resources.cancel);
        let means = BallMeans { memory, scratch, threads: self.threads, cancel };
        let Some(ball) = largest_ball(map, phase, axes, &means)? else { return Ok(None) };
        let stride = self.archive.pyramid()?.pyramid.stride(self.level);
        let index = std::array::from_fn(|a| (ball.node[a] * stride[a]) as f64);
        let centre = world_of(self.archive, index)?;
        Ok(Some(InscribedBall { centre, radius: ball.distance, to_samples: ball.distance }))
    }

    /// The places of nodes along each axis, from the first one on; none where axes are not at right
    /// angles.
    fn axes(&self) -> Result<Option<[Vec<f64>; 3]>> {
        let pyramid = &self.archive.pyramid()?.pyramid;
        let (nodes, stride) = (pyramid.nodes(self.level), pyramid.stride(self.level));
        if let Some(map) = self.archive.coordinates()? {
            let Some(axes) = map.axes() else { return Ok(None) };
            let place = |a: usize, n: usize| (axes[a][n * stride[a]] - axes[a][0]).abs();
            return Ok(Some(std::array::from_fn(|a| (0..nodes[a]).map(|n| place(a, n)).collect())));
        }
        let axes = self.archive.step().plan.source.geometry.axes();
        let lengths = axes.map(|axis| dot(axis, axis).sqrt());
        let is_right = |a: usize, b: usize| dot(axes[a], axes[b]).abs() <= 1e-6 * lengths[a] * lengths[b];
        if !(is_right(0, 1) && is_right(1, 2) && is_right(0, 2)) {
            return Ok(None);
        }
        let place = |a: usize, n: usize| (n * stride[a]) as f64 * lengths[a];
        Ok(Some(std::array::from_fn(|a| (0..nodes[a]).map(|n| place(a, n)).collect())))
    }
}

/// Parts of the box around a mesh in which volumes are summed: more than it has tetrahedra.
const UNIT: f64 = (1u64 << 63) as f64 * (1u64 << 17) as f64;

/// The volume of all tetrahedra that are not void where the field is at or above an isovalue, and
/// their whole volume. Edges are straight in the world.
fn volumes_of_tetrahedra(
    archive: &StepView,
    isovalue: f32,
    settings: &SurfaceSettings,
    progress: &dyn Progress,
) -> Result<(f64, f64)> {
    let [lo, hi] = bounds(archive, &settings.resources.cancel)?;
    let hull: f64 = (0..3).map(|k| hi[k] - lo[k]).product();
    let (lattice, to_world) = (archive.manifest.plan.lattice, IndexToWorld::of(archive)?);
    let visit = Visit::new(archive, Blocks::All, &settings.resources, |memory| memory / 2)?;
    visit.check_memory(0)?;
    progress.begin("volumes", visit.chunks.len() as u64, "chunks");
    let job = |_, chunk: DecodedChunk| -> Result<[i128; 2]> {
        let place = |p| Ok(minus(to_world.world(lattice.to_index_space(p))?, lo));
        let mut places = vec![None; chunk.positions.len()];
        let mut sums = [0i128; 2];
        for tet in &chunk.tets {
            let values = tet.map(|v| chunk.values[v as usize]);
            if values.iter().any(|v| v.is_nan()) {
                continue;
            }
            let mut corners = [[0.0; 3]; 4];
            for (corner, &v) in corners.iter_mut().zip(tet) {
                let known = &mut places[v as usize];
                *corner = match known {
                    Some(place) => *place,
                    None => *known.insert(place(chunk.positions[v as usize])?),
                };
            }
            let [a, b, c, d] = corners;
            let volume = dot(minus(b, a), cross(minus(c, a), minus(d, a))).abs() / 6.0;
            let share = share_above(values, isovalue);
            sums[0] += (volume * share / hull * UNIT).round() as i128;
            sums[1] += (volume / hull * UNIT).round() as i128;
        }
        Ok(sums)
    };
    let mut all = [0i128; 2];
    visit.each(0, progress, job, |_, sums| {
        all = [all[0] + sums[0], all[1] + sums[1]];
        Ok(())
    })?;
    let [above, all] = all.map(|sum| sum as f64 / UNIT * hull);
    Ok((above, all))
}

/// The share of a tetrahedron with these values at its corners in which the linear field is at or
/// above an isovalue.
fn share_above(mut values: [f32; 4], isovalue: f32) -> f64 {
    values.sort_by(f32::total_cmp);
    let v = f64::from(isovalue);
    let inside = values.iter().filter(|f| **f >= isovalue).count();
    let f = values.map(f64::from);
    // How far the surface crosses the edge from corner i towards corner k.
    let along = |i: usize, k: usize| (f[i] - v) / (f[i] - f[k]);
    match inside {
        0 => 0.0,
        1 => along(3, 0) * along(3, 1) * along(3, 2),
        2 => {
            let (a, b, c, d) = (along(2, 0), along(2, 1), along(3, 0), along(3, 1));
            // The wedge between the two corners, as three tetrahedra.
            a * b + c * d * (1.0 - a) + a * d * (1.0 - b)
        }
        3 => 1.0 - along(0, 1) * along(0, 2) * along(0, 3),
        _ => 1.0,
    }
}

/// Refuses numbers of a part of the domain.
pub(in crate::pipeline) fn expect_whole(settings: &SurfaceSettings) -> Result<()> {
    if settings.roi.is_some() {
        return Err(Error::usage("numbers are those of the whole domain: leave the region out"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_of_a_tetrahedron_are_those_of_its_parts() {
        // The field x + 2 y + 4 z on the unit tetrahedron, by counting points of a fine grid.
        let f = [0.0f32, 1.0, 2.0, 4.0];
        for isovalue in [-1.0f32, 0.3, 0.9, 1.0, 1.4, 2.0, 2.7, 3.9, 4.0, 5.0] {
            let (n, mut inside, mut all) = (60, 0.0, 0.0);
            for i in 0..n * n * n {
                let p = [i % n, i / n % n, i / n / n].map(|k| (k as f64 + 0.5) / n as f64);
                if p.iter().sum::<f64>() <= 1.0 {
                    all += 1.0;
                    inside += f64::from(u8::from(p[0] + 2.0 * p[1] + 4.0 * p[2] >= f64::from(isovalue)));
                }
            }
            let found = share_above([f[2], f[0], f[3], f[1]], isovalue);
            assert!((found - inside / all).abs() < 0.01, "{isovalue}: {found}, not {}", inside / all);
        }
        assert_eq!(share_above([3.0; 4], 3.0), 1.0);
        assert_eq!(share_above([1.0, 1.0, 2.0, 2.0], 1.5), 0.5);
    }
}
