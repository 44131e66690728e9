//! What an archive holds, from its manifest: for `info`, and for reports.

use super::pyramid::pyramid_of;
use super::spectrum::{FEW_NODES, Suggestion, report_of};
use super::step_view::StepView;
use crate::archive::manifest::{Manifest, MeshSource, SegmentRecord, StoredStep};
use crate::archive::tables::CellCount;
use crate::archive::values::Quantiser;
use crate::measure::{FieldError, LevelError};
use crate::pipeline::plan::Plan;
use isospan_io::error::Result;
use isospan_io::grid::{ChunkId, Geometry};
use isospan_io::volume::ScalarType;
use isospan_io::volume::units::{Unit, Units};
use isospan_mesh::points::{Levels, PointSpec};
use isospan_mesh::sample::{Interpolation, Values};
use isospan_wavelet::Pyramid;
use serde::Serialize;

/// A level of density.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LevelSummary {
    /// Points to a voxel.
    pub density: f64,
    /// Voxels of the cells that have it.
    pub voxels: u64,
    /// Points in them, about, samples of the boundary not counted.
    pub points: u64,
    /// The errors at the samples in them, where they were measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<LevelError>,
    /// Their part of the bytes of the mesh and of the step's values: in each file, that of the
    /// points.
    pub bytes: u64,
}

impl LevelSummary {
    fn all(archive: &StepView, levels: &Levels) -> Vec<Self> {
        let (plan, step) = (&archive.manifest.plan, archive.step());
        let densities = Plan::densities(plan, levels);
        let bytes = Self::bytes(archive, levels, &densities);
        let of = |((n, density), voxels): ((usize, f64), u64)| Self {
            density,
            voxels,
            points: (density * voxels as f64).round() as u64,
            error: step.level_errors.get(n).copied(),
            bytes: bytes[n].round() as u64,
        };
        densities.into_iter().enumerate().zip(levels.voxels_by_level()).map(of).collect()
    }

    /// The bytes of each segment, shared out by the points of each level in its chunks.
    fn bytes(archive: &StepView, levels: &Levels, densities: &[f64]) -> Vec<f64> {
        let (mesh, values) = (&archive.manifest.mesh, &archive.step().values);
        let mut bytes = vec![0.0; densities.len()];
        for (segment, values) in mesh.iter().zip(values) {
            let mut points = vec![0.0; densities.len()];
            for chunk in segment.first_chunk..segment.first_chunk + segment.chunks {
                let core = archive.chunks.chunk(ChunkId(chunk)).core;
                levels.volumes_in(&core, |level, volume| {
                    points[usize::from(level)] += volume * densities[usize::from(level)];
                });
            }
            let (all, sum) = ((segment.info.bytes + values.info.bytes) as f64, points.iter().sum::<f64>());
            if sum > 0.0 {
                bytes.iter_mut().zip(points).for_each(|(b, p)| *b += all * p / sum);
            }
        }
        bytes
    }
}

/// What an archive holds, from its manifest.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename = "archive")]
#[non_exhaustive]
pub struct ArchiveSummary {
    /// Version of the format.
    pub format: u16,
    /// Name of the source's file.
    pub source: String,
    /// Its format.
    pub source_format: String,
    /// Samples along x, y, z.
    pub dims: [u64; 3],
    /// Type of its samples.
    #[serde(serialize_with = "ScalarType::serialize_name")]
    pub scalar: ScalarType,
    /// Name of the field.
    pub field: String,
    /// Index space to world.
    pub geometry: Geometry,
    /// The units of values, lengths and times, as far as they are known.
    pub units: Units,
    /// The bad cells of a rectilinear or curvilinear grid, whose coordinates are in the archive.
    pub grid_cells: Option<CellCount>,
    /// What the source had, if it is a tetrahedral mesh.
    pub mesh: Option<MeshSource>,
    /// Whether points and tetrahedra are those of that mesh.
    pub own: bool,
    /// The point set, with its parameters.
    pub point_set: PointSpec,
    /// Where the density of the points differs from place to place: each level, the coarsest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub levels: Vec<LevelSummary>,
    /// The levels of a pyramid, the finest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub pyramid: Vec<PyramidLevel>,
    /// How values were interpolated.
    pub interpolation: Interpolation,
    /// Whether they are fitted to the samples.
    pub values: Values,
    /// How values were rounded, if they were.
    pub quantiser: Option<Quantiser>,
    /// Points.
    pub points: u64,
    /// Points without a value.
    pub void_points: u64,
    /// Tetrahedra.
    pub tetrahedra: u64,
    /// Chunks.
    pub chunks: u64,
    /// Tetrahedron blocks.
    pub blocks: u64,
    /// Number of the step that range, areas and suggestions are of.
    pub step: u64,
    /// All time steps.
    pub steps: Vec<StepSummary>,
    /// Least and largest value.
    pub range: Option<[f64; 2]>,
    /// What the samples lost when they became `f32`, at most, where that matters; errors include
    /// it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rounding: Option<f64>,
    /// Area of the isosurface at each isovalue of the contour spectrum.
    pub areas: Vec<[f64; 2]>,
    /// Isovalues that are worth a look, the most marked one first.
    pub suggestions: Vec<Suggestion>,
    /// How far the reduced field is from the samples of its source, where that was measured.
    pub error: Option<FieldError>,
    /// Bytes of all files.
    pub bytes: u64,
    /// Bytes of the samples of all steps as the source has them, not compressed; none of a mesh.
    pub sample_bytes: Option<u64>,
}

/// A level of a pyramid.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PyramidLevel {
    /// Its number: 0 is the finest.
    pub level: usize,
    /// Nodes along x, y, z.
    pub nodes: [u64; 3],
    /// Samples from one node to the next along x, y, z.
    pub stride: [u64; 3],
    /// Cells between nodes.
    pub cells: u64,
    /// Bytes of the step that are read for all of its nodes; not told of very large archives.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// The RMS error at the samples up to its last node, trilinear between nodes, where it was
    /// measured. From level 1 on it has few digits, and is at most a thousandth too large; of large
    /// volumes it is that of some rows of samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms: Option<f64>,
}

impl PyramidLevel {
    /// All levels that have cells.
    fn all(archive: &StepView, pyramid: &Pyramid) -> Vec<Self> {
        // What cannot be read is told by those who need it.
        let bytes = archive.level_bytes(pyramid).ok().flatten();
        let level = |level: usize| {
            let [nodes, stride] = [pyramid.nodes(level), pyramid.stride(level)].map(|n| n.map(|n| n as u64));
            let cells = nodes.iter().map(|n| n - 1).product();
            let bytes = bytes.as_ref().map(|bytes| bytes[level]);
            Self { level, nodes, stride, cells, bytes, rms: archive.level_rms(level) }
        };
        (0..=pyramid.coarsest()).map(level).filter(|level| level.cells > 0).collect()
    }
}

/// A step of an archive, from its manifest.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct StepSummary {
    /// Its number.
    pub number: u64,
    /// Its time, where the input states one.
    pub time: Option<f64>,
    /// Name of the source's file.
    pub source: String,
    /// Name of the field.
    pub field: String,
    /// The unit of its values, where it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<Unit>,
    /// The step that its values refer to; none of a keyframe.
    pub base: Option<u64>,
    /// Least and largest value.
    pub range: Option<[f64; 2]>,
    /// What the samples lost when they became `f32`, at most, where that matters; errors include
    /// it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rounding: Option<f64>,
    /// Points without a value.
    pub void_points: u64,
    /// Root of the mean square of the reduced field's errors at the samples of its source, and the
    /// largest, where they were measured.
    pub error: Option<[f64; 2]>,
    /// Bytes of its values; of a pyramid those of all levels.
    pub value_bytes: u64,
    /// Bytes of its index and spectrum; of a pyramid also of its ranges and corrections.
    pub index_bytes: u64,
}

impl StepSummary {
    /// That of the step at a position in a manifest.
    pub(in crate::pipeline) fn of(manifest: &Manifest, position: usize) -> Self {
        let step = &manifest.steps[position];
        let StoredStep { plan, .. } = step;
        let base = manifest.base_of(position).map(|base| manifest.step_at(base).number());
        Self {
            number: step.number(),
            time: plan.time,
            source: plan.source.path.clone(),
            field: step.field().to_owned(),
            unit: plan.source.units.value.clone(),
            base,
            range: step.file_range(),
            rounding: step.notable_rounding(),
            void_points: step.void_points,
            error: step.error.as_ref().map(|e| [e.rms, e.max]),
            value_bytes: bytes_of(&step.values) + step.coarse.map_or(0, |s| s.bytes),
            index_bytes: bytes_of(&step.ranges)
                + step.index.map_or(0, |s| s.bytes)
                + step.spectrum.map_or(0, |s| s.bytes),
        }
    }
}

fn bytes_of(segments: &[SegmentRecord]) -> u64 {
    segments.iter().map(|s| s.info.bytes).sum()
}

/// Summarizes an archive; range, areas and suggestions are those of the step.
pub(in crate::pipeline) fn summarize(archive: &StepView) -> Result<ArchiveSummary> {
    let (plan, counts, step) = (&archive.manifest.plan, &archive.manifest.counts, archive.step());
    let source = &step.plan.source;
    let spectrum = report_of(archive, FEW_NODES)?;
    let steps = archive.manifest.steps.len();
    let steps = (0..steps).map(|n| StepSummary::of(&archive.manifest, n)).collect();
    Ok(ArchiveSummary {
        format: archive.manifest.format_version(),
        source: source.path.clone(),
        source_format: source.format.clone(),
        dims: source.dims,
        scalar: source.scalar,
        field: step.field().to_owned(),
        geometry: source.geometry,
        units: source.units.clone(),
        grid_cells: archive.coordinate_record().map(|c| c.cells),
        mesh: source.mesh,
        own: archive.manifest.plan.own.is_some(),
        point_set: plan.points,
        levels: archive.points.levels().map_or_else(Vec::new, |levels| LevelSummary::all(archive, levels)),
        pyramid: pyramid_of(plan.points)
            .map_or_else(Vec::new, |pyramid| PyramidLevel::all(archive, &pyramid)),
        interpolation: step.plan.interpolation,
        values: step.plan.values,
        quantiser: step.plan.file_quantiser(),
        points: counts.points,
        void_points: step.void_points,
        tetrahedra: counts.tetrahedra,
        chunks: counts.chunks,
        blocks: counts.blocks,
        step: step.number(),
        bytes: archive.bytes()?,
        sample_bytes: sample_bytes(archive),
        steps,
        range: step.file_range(),
        rounding: step.notable_rounding(),
        areas: spectrum.knots.iter().map(|k| [k.isovalue, k.area]).collect(),
        suggestions: spectrum.suggestions,
        error: step.error.clone(),
    })
}

fn sample_bytes(archive: &StepView) -> Option<u64> {
    let of_step = |step: &StoredStep| {
        let source = &step.plan.source;
        let one = source.scalar.bytes() as u64;
        let all = source.dims.iter().try_fold(one, |bytes, &n| bytes.checked_mul(n))?;
        source.mesh.is_none().then_some(all)
    };
    archive.manifest.steps.iter().map(of_step).try_fold(0u64, |sum, bytes| sum.checked_add(bytes?))
}
