//! What is asked of a surface, and what is reported about it.

use super::refine::{Refine, RefineReport};
use crate::files::surface::{Compression, SurfaceFormat};
use crate::pipeline::read::{LevelChoice, Roi, StepView};
use crate::pipeline::stage::StageSeconds;
use crate::render::ColourMap;
use isospan_io::bytes::publish::folder_of;
use isospan_io::bytes::remote::Traffic;
use isospan_io::error::{Error, Result};
use isospan_io::exec::Resources;
use isospan_mesh::mesh::tet::is_active;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How surfaces are extracted: see [`SurfaceQuery`](crate::pipeline::SurfaceQuery).
#[derive(Clone, Debug)]
pub(in crate::pipeline) struct SurfaceSettings {
    /// The isovalues, each once: a value `>=` it is inside. All are extracted in one pass.
    pub(in crate::pipeline) isovalues: Vec<f64>,
    /// The box at which the surfaces are cut; the whole domain if not given.
    pub(in crate::pipeline) roi: Option<Roi>,
    /// Close the surfaces where the domain ends.
    pub(in crate::pipeline) cap: bool,
    /// What is done to each surface before it is written.
    pub(in crate::pipeline) refine: Refine,
    /// A field whose values a surface file has at the vertices, with their colours.
    pub(in crate::pipeline) colour_by: Option<ColourBy>,
    /// How a GLB is made small.
    pub(in crate::pipeline) compress: Compression,
    /// The level of a pyramid; the finest if not given. Other archives have no levels.
    pub(in crate::pipeline) level: Option<LevelChoice>,
    /// Threads, memory, scratch folder, and what stops it.
    pub(in crate::pipeline) resources: Resources,
}

/// A field that colours surfaces: see [`Step::colours`](crate::pipeline::Step::colours).
#[derive(Clone)]
pub struct ColourBy {
    pub(in crate::pipeline) view: Arc<StepView>,
    /// The values at the ends of the colour map; those of the whole field if not given.
    pub range: Option<[f64; 2]>,
    /// The colour map.
    pub map: ColourMap,
}

impl fmt::Debug for ColourBy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let source = &self.view.step().plan.source;
        write!(f, "{} of {} by {} in {:?}", source.field, source.path, self.map.name(), self.range)
    }
}

impl Default for SurfaceSettings {
    fn default() -> Self {
        Self {
            isovalues: vec![0.0],
            roi: None,
            cap: false,
            refine: Refine::default(),
            colour_by: None,
            compress: Compression::None,
            level: None,
            resources: Resources::default(),
        }
    }
}

impl SurfaceSettings {
    /// The files that surfaces are written to, under a name that may hold `{}`.
    pub(in crate::pipeline) fn files(&self, out: &Path) -> Vec<PathBuf> {
        let count = if is_each_alone(out) { self.isovalues.len() } else { 1 };
        self.isovalues.iter().take(count).map(|&isovalue| file_of(out, isovalue)).collect()
    }

    /// Refuses colours that cannot be had, before work.
    pub(super) fn check_colours(&self, format: SurfaceFormat) -> Result<()> {
        if self.colour_by.is_none() {
            return Ok(());
        }
        format.expect_colours()
    }

    /// The isovalues as the archive has values.
    pub(super) fn kept(&self, archive: &StepView) -> Vec<f32> {
        let source = &archive.step().plan.source;
        self.isovalues.iter().map(|&v| source.kept(v)).collect()
    }

    /// Whether a surface can have a triangle where values are in this range.
    pub(super) fn can_answer(&self, archive: &StepView) -> bool {
        let Some([lo, hi]) = archive.value_range() else { return false };
        self.kept(archive).into_iter().any(|v| is_active(lo, hi, v) || self.cap && v <= hi)
    }

    /// The folder for what does not fit in memory, of a file.
    pub(super) fn scratch_of(&self, out: &Path) -> PathBuf {
        self.resources.scratch.clone().unwrap_or_else(|| folder_of(out).to_path_buf())
    }

    pub(super) fn check(&self) -> Result<()> {
        self.refine.check()?;
        if self.cap && self.roi.is_some() {
            return Err(Error::usage(
                "caps close a surface at the ends of the domain, not at those of a region of interest",
            ));
        }
        if self.isovalues.is_empty() {
            return Err(Error::usage("give at least one isovalue"));
        }
        for (i, &isovalue) in self.isovalues.iter().enumerate() {
            finite(isovalue)?;
            if self.isovalues[..i].contains(&isovalue) {
                return Err(Error::usage(format!("the isovalue {isovalue} is given twice")));
            }
        }
        Ok(())
    }
}

/// What a surface extraction found and read; counts are of all surfaces together.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct SurfaceReport {
    /// Each surface, in the order of the isovalues.
    pub surfaces: Vec<OneSurface>,
    /// Least and largest value of the archive.
    pub range: Option<[f64; 2]>,
    /// The level of a pyramid that answers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub level: Option<usize>,
    /// The box at which the surfaces were cut.
    pub roi: Option<Roi>,
    /// Vertices written.
    pub vertices: u64,
    /// Triangles written.
    pub triangles: u64,
    /// Vertices at which the field that colours them has no value, where one does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub without_value: Option<u64>,
    /// Triangles of the files whose corners are on a line as `f32`.
    pub without_area: u64,
    /// What coordinates in the files are less, where they are far from 0 and the format has no
    /// doubles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shift: Option<[f64; 3]>,
    /// Bytes of the files written.
    pub file_bytes: u64,
    /// Points of the archive.
    pub points: u64,
    /// Tetrahedra of the archive.
    pub tetrahedra: u64,
    /// Cells that a surface crosses, once for each: tetrahedra, or cubes of a pyramid.
    pub active_cells: u64,
    /// Tetrahedron blocks of the archive.
    pub blocks: u64,
    /// Blocks read.
    pub active_blocks: u64,
    /// Chunks of the archive.
    pub chunks: u64,
    /// Chunks that blocks were read of.
    pub active_chunks: u64,
    /// Bytes read: index pages, chunk headers, blocks, values; none of cached blocks. The manifest
    /// was read when the archive was opened ([`crate::Archive::opening`]).
    pub bytes_read: u64,
    /// Bytes of the blocks read, of tetrahedra and of values, that hold an active tetrahedron: what
    /// no reader could do without.
    pub active_bytes: u64,
    /// Bytes of the archive.
    pub archive_bytes: u64,
    /// What was fetched from the server meanwhile, if the archive is on one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remote: Option<Traffic>,
    /// Seconds of wall time of each stage.
    #[serde(serialize_with = "crate::pipeline::stage::by_name")]
    pub seconds: StageSeconds,
}

/// One of the surfaces of an extraction.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct OneSurface {
    /// Its isovalue.
    pub isovalue: f64,
    /// The file that it is in.
    pub file: PathBuf,
    /// Whether no value lies below the isovalue, or none at or above it; then the surface is empty.
    pub outside_range: bool,
    /// Vertices.
    pub vertices: u64,
    /// Triangles.
    pub triangles: u64,
    /// Cells that the surface crosses: cubes of a pyramid, or tetrahedra that touch the region of
    /// interest.
    pub active_cells: u64,
    /// What was done to the surface after its extraction.
    #[serde(flatten)]
    pub refined: RefineReport,
}

/// How many tetrahedra an isosurface crosses.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct CountReport {
    /// The isovalue.
    pub isovalue: f64,
    /// Cells that the surface crosses: tetrahedra, or cubes of a pyramid.
    pub active_cells: u64,
    /// Tetrahedra of the archive.
    pub tetrahedra: u64,
    /// The level of a pyramid, of whose cells as many are crossed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub level: Option<usize>,
    /// Whether the number was stored; otherwise the blocks of the isovalue were decoded.
    pub stored: bool,
    /// Bytes read for it: the spectrum's knots and a page of its levels; also index pages and
    /// blocks where it was not stored.
    pub bytes_read: u64,
}

pub(super) fn finite(isovalue: f64) -> Result<()> {
    if (isovalue as f32).is_finite() {
        Ok(())
    } else {
        Err(Error::usage("the isovalue must be a finite number"))
    }
}

/// The part of a file's name that stands for the isovalue.
const PLACEHOLDER: &str = "{}";

/// The file of an isovalue.
pub(super) fn file_of(out: &Path, isovalue: f64) -> PathBuf {
    match out.file_name().and_then(|name| name.to_str()) {
        Some(name) => out.with_file_name(name.replace(PLACEHOLDER, &isovalue.to_string())),
        None => out.to_path_buf(),
    }
}

/// Whether each isovalue has a file of its own.
pub(super) fn is_each_alone(out: &Path) -> bool {
    out.file_name().is_some_and(|name| name.to_string_lossy().contains(PLACEHOLDER))
}
