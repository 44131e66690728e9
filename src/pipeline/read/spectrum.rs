//! The contour spectrum of a step: summed chunk by chunk while chunks are made, merged when the
//! archive is completed, and read back. A small archive stores none: it is summed when it is asked
//! for.

use super::archive::expect_recorded;
use super::decoded::DecodedChunk;
use super::step_view::StepView;
use crate::archive::chunked::BlockRange;
use crate::archive::manifest::{MeshPlan, Source};
use crate::archive::segment::PlanHash;
use crate::archive::tables::CoordinateMap;
use crate::spectrum::suggest::suggest;
use crate::spectrum::{
    CellShapes, ChunkPart, LaneBuffers, Limits, Spectrum, SpectrumBuilder, SpectrumFile, Vertices,
};
use isospan_io::error::{Error, Result};
use isospan_io::exec::in_order;
use isospan_io::geom::{Lattice, LatticePos};
use isospan_io::grid::{ChunkId, Geometry, IndexBox};
use isospan_mesh::mesh::tet::Tet;
use serde::Serialize;
use std::path::PathBuf;

/// The memory in which chunks are measured, kept from chunk to chunk so that its pages are not
/// asked for again.
#[derive(Default)]
pub(in crate::pipeline) struct Bench {
    /// Vertices in the world, up to a shift common to all.
    places: Vec<[f64; 4]>,
    lanes: LaneBuffers,
}

/// Measures chunks of a step: has what is needed besides the chunk.
pub(in crate::pipeline) struct Meter {
    limits: Limits,
    lattice: Lattice,
    /// Without an origin, of which only rounding would be left in a difference.
    linear: Geometry,
    /// Of a grid that has coordinates of its own: their file, its hash, the samples along each
    /// axis.
    coordinates: Option<(PathBuf, PlanHash, [u64; 3])>,
}

impl Meter {
    /// For a mesh of `points` points, and the source of a step; `coordinates` is the file and hash
    /// of those that the grid has of its own.
    pub(in crate::pipeline) fn new(
        mesh: &MeshPlan,
        points: u64,
        source: &Source,
        coordinates: Option<(PathBuf, PlanHash)>,
    ) -> Self {
        Self {
            limits: limits(mesh, points),
            lattice: mesh.lattice,
            linear: Geometry { origin: [0.0; 3], ..source.geometry },
            coordinates: coordinates.map(|(path, hash)| (path, hash, source.dims)),
        }
    }

    /// That of an archive.
    pub(in crate::pipeline) fn of_archive(archive: &StepView) -> Self {
        let (plan, source) = (&archive.manifest.plan, &archive.step().plan.source);
        Self::new(plan, archive.points.len(), source, archive.coordinate_file())
    }

    pub(in crate::pipeline) fn limits(&self) -> Limits {
        self.limits
    }

    /// The parts of a chunk at some steps: all its tetrahedra, in the order in which its blocks
    /// decode; positions of its vertices, their values at each step, with the ranges of the blocks.
    /// `bench` is memory.
    pub(in crate::pipeline) fn parts(
        &self,
        positions: &[LatticePos],
        tets: &[Tet],
        steps: &[(&[f32], &[BlockRange])],
        bench: &mut Bench,
    ) -> Result<Vec<ChunkPart>> {
        let Bench { places, lanes } = bench;
        places.clear();
        match &self.coordinates {
            None => places.extend(positions.iter().map(|&p| four(self.place(p)))),
            Some((path, hash, dims)) => {
                // Each call opens its own map, because a map keeps what it has read behind a lock.
                let map = CoordinateMap::open(path, *hash, *dims)?;
                let index = |p| self.lattice.to_index_space(p);
                for &p in positions {
                    places.push(four(map.place(index(p))?.position));
                }
            }
        }
        let none = [f32::INFINITY, f32::NEG_INFINITY];
        let all =
            |ranges: &[BlockRange]| ranges.iter().fold(none, |[lo, hi], r| [lo.min(r.min), hi.max(r.max)]);
        let steps: Vec<Vertices<'_>> =
            steps.iter().map(|(values, ranges)| Vertices { values, range: all(ranges) }).collect();
        Ok(ChunkPart::of_steps(self.limits, places, tets, &steps, lanes))
    }

    fn place(&self, position: LatticePos) -> [f64; 3] {
        self.linear.to_world(self.lattice.to_index_space(position))
    }
}

/// A place in a vector.
fn four([x, y, z]: [f64; 3]) -> [f64; 4] {
    [x, y, z, 0.0]
}

/// How finely a mesh of `points` points is measured.
pub(in crate::pipeline) fn limits(mesh: &MeshPlan, points: u64) -> Limits {
    // Of many points a spectrum is fine enough.
    Limits::of_mesh(points.min(mesh.chunk_target))
}

/// The isosurface of one isovalue, as [`crate::spectrum`] measures it. Lengths are world units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Knot {
    /// The isovalue.
    pub isovalue: f64,
    /// Cells that the isosurface crosses: tetrahedra, or cubes of a pyramid.
    pub active_cells: u64,
    /// Its area.
    pub area: f64,
    /// The volume of the tetrahedra where the field is at or above the isovalue.
    pub volume: f64,
    /// The length of the gradient, integrated over the isosurface.
    pub gradient: f64,
}

/// An isovalue, and how much speaks for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Suggestion {
    /// The isovalue: a round number next to a knot of the spectrum.
    pub isovalue: f64,
    /// How far it stands out: 1 is the highest possible.
    pub strength: f64,
}

/// The contour spectrum of an archive.
#[derive(Clone, Debug, Serialize)]
pub struct SpectrumReport {
    /// Least and largest value of cells that are not void; `None` if all are void.
    pub range: Option<[f64; 2]>,
    /// Cells that are not void: tetrahedra, or cubes of a pyramid.
    pub cells: u64,
    /// Their volume, in world units.
    pub volume: f64,
    /// Whether lengths are those of tetrahedra with straight edges between their corners, of a grid
    /// that has coordinates of its own: the vertices of a surface are placed one by one, and follow
    /// the grid where it is bent. So its area differs a little.
    pub straight_edges: bool,
    /// Isovalues, ascending, with what was measured there.
    pub knots: Vec<Knot>,
    /// Isovalues that are worth a look, the most marked one first.
    pub suggestions: Vec<Suggestion>,
    /// Bytes read for all this.
    pub bytes_read: u64,
}

/// The contour spectrum of a step of a series.
#[derive(Clone, Debug, Serialize)]
pub struct StepSpectrum {
    /// Number of the step.
    pub step: u64,
    /// Its time, or its number where it has none.
    pub time: f64,
    /// What was measured.
    #[serde(flatten)]
    pub spectrum: SpectrumReport,
}

impl StepSpectrum {
    pub(in crate::pipeline) fn of(view: &StepView) -> Result<Self> {
        let step = view.step();
        Ok(Self { step: step.number(), time: step.time_or_number(), spectrum: report(view)? })
    }
}

impl StepView {
    /// The contour spectrum that is stored; none in a small archive, nor where every tetrahedron is
    /// void.
    pub(in crate::pipeline) fn stored_spectrum(&self) -> Result<Option<SpectrumFile>> {
        let Some(recorded) = &self.step().spectrum else { return Ok(None) };
        let limits = limits(&self.manifest.plan, self.points.len());
        let file = SpectrumFile::open(self.layout.spectrum(), Some(self.step_hash()), limits);
        let file = file.map_err(|e| self.lost(e))?;
        expect_recorded(file.segment(), Some(recorded))?;
        Ok(Some(file))
    }

    /// The contour spectrum, and the bytes of its own file; none where every tetrahedron is void.
    /// That of a small archive is summed from all its tetrahedra. One chunk at a time takes less
    /// memory than making it did. That of a pyramid is of a level with at most these nodes.
    fn spectrum(&self, nodes: usize) -> Result<Option<(Spectrum, u64)>> {
        if self.has_labels() {
            return Ok(None);
        }
        if self.is_pyramid() {
            return self.spectrum_of_level(nodes);
        }
        if self.manifest.counts.is_indexed(&self.manifest.plan) {
            return Ok(self.stored_spectrum()?.map(|file| (file.spectrum().clone(), file.bytes_read())));
        }
        let meter = Meter::of_archive(self);
        let (mut bench, mut all) = (Bench::default(), vec![]);
        for id in (0..self.layout.chunk_count()).map(ChunkId) {
            let blocks: Vec<u32> = (0..self.mesh_sizes(id)?.tet_blocks).collect();
            let DecodedChunk { positions, values, tets, .. } = self.decode(id, &blocks)?;
            let range = [BlockRange::of(&tets, &values)];
            all.extend(meter.parts(&positions, &tets, &[(&values, &range)], &mut bench)?);
        }
        Ok(SpectrumBuilder::of_parts(&all, meter.limits()).map(|sum| (sum.spectrum(), 0)))
    }
}

/// Nodes of the level of a pyramid whose spectrum is measured, at most.
const MOST_NODES: usize = 1 << 22;
/// And where isovalues worth a look are all that is asked for.
pub(super) const FEW_NODES: usize = 1 << 18;
/// Cells along each axis of a box that is measured at a time.
const BOX_CELLS: usize = 64;

impl StepView {
    /// The contour spectrum of the finest level of a pyramid that has at most these nodes.
    fn spectrum_of_level(&self, most: usize) -> Result<Option<(Spectrum, u64)>> {
        let pyramid = &self.pyramid()?.pyramid;
        let has_cells = |level: &usize| pyramid.nodes(*level).iter().all(|n| *n > 1);
        let few = |level: &usize| pyramid.nodes(*level).iter().product::<usize>() <= most;
        let mut levels = (0..=pyramid.coarsest()).filter(has_cells);
        let level = levels.clone().find(few).or(levels.next_back()).unwrap_or(0);
        let (nodes, stride) = (pyramid.nodes(level), pyramid.stride(level));
        let axes = self.step().plan.source.geometry.axes();
        let axes = std::array::from_fn(|a| axes[a].map(|x| x * stride[a] as f64));
        let map = self.coordinates()?;
        let place = |map: &CoordinateMap, window: &IndexBox| -> Result<Vec<[f64; 3]>> {
            let [nx, ny, _] = window.dims();
            let at = |i: u64| {
                let node = [i % nx, i / nx % ny, i / nx / ny];
                map.sample(std::array::from_fn(|a| (window.lo[a] + node[a]) * stride[a] as u64))
            };
            (0..window.len() as u64).map(at).collect()
        };
        let limits = Limits::of_mesh(nodes.iter().product::<usize>() as u64);
        let counts = nodes.map(|n| (n - 1).div_ceil(BOX_CELLS));
        let part = |i: usize| {
            let at = [i % counts[0], i / counts[0] % counts[1], i / counts[0] / counts[1]];
            let lo = at.map(|n| (n * BOX_CELLS) as u64);
            let hi = std::array::from_fn(|a| (lo[a] + BOX_CELLS as u64 + 1).min(nodes[a] as u64));
            let window = IndexBox { lo, hi };
            let values = self.nodes(level, &window)?;
            let places = map.as_ref().map(|map| place(map, &window)).transpose()?;
            let shapes = places.as_deref().map_or(CellShapes::Even(axes), CellShapes::Placed);
            Ok(ChunkPart::of_cells(&values, window.dims().map(|n| n as usize), shapes, limits))
        };
        let (bytes, mut parts) = (vec![0; counts.iter().product()], vec![]);
        let threads = self.pools.lend(0)?;
        in_order(&bytes, 0, &threads, part, |_, part| {
            parts.push(part);
            Ok(())
        })?;
        Ok(SpectrumBuilder::of_parts(&parts, limits).map(|sum| (sum.spectrum(), 0)))
    }
}

/// The contour spectrum of a step, with isovalues that are worth a look.
///
/// # Errors
/// [`Error::Usage`] between two steps.
pub(in crate::pipeline) fn report(archive: &StepView) -> Result<SpectrumReport> {
    archive.expect_values()?;
    report_of(archive, MOST_NODES)
}

/// As [`report`], of a level with at most these nodes, where the archive is a pyramid.
pub(super) fn report_of(archive: &StepView, nodes: usize) -> Result<SpectrumReport> {
    if archive.is_between() {
        return Err(Error::usage(format!(
            "{}: the spectrum is known at steps, and not between them: choose one with `step`",
            archive.path().display()
        )));
    }
    let (bytes_read, read_before) = (archive.manifest_bytes()?, archive.bytes_read());
    let Some((spectrum, of_file)) = archive.spectrum(nodes)? else {
        let none = SpectrumReport {
            range: None,
            cells: 0,
            volume: 0.0,
            straight_edges: false,
            knots: vec![],
            suggestions: vec![],
            bytes_read,
        };
        return Ok(none);
    };
    let source = &archive.step().plan.source;
    let knot = |k: &crate::spectrum::SpectrumKnot| Knot {
        isovalue: source.in_file(k.isovalue),
        active_cells: k.active_cells,
        area: k.area,
        volume: k.volume,
        gradient: k.gradient,
    };
    let suggestions = suggest(&spectrum).into_iter();
    Ok(SpectrumReport {
        range: Some(spectrum.range.map(|v| source.in_file(v))),
        cells: spectrum.tetrahedra,
        volume: spectrum.volume,
        straight_edges: archive.coordinate_record().is_some(),
        knots: spectrum.knots.iter().map(knot).collect(),
        suggestions: suggestions
            .map(|s| Suggestion { isovalue: source.in_file(s.isovalue), strength: s.strength })
            .collect(),
        bytes_read: bytes_read + of_file + archive.bytes_read() - read_before,
    })
}
