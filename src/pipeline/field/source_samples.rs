//! The samples of a source, and what is found of surfaces with them.

use crate::measure::SurfaceDistance;
use crate::pipeline::inputs::Scratch;
#[cfg(feature = "compare")]
use crate::pipeline::inputs::treat_missing;
use crate::pipeline::read::StepView;
use isospan_io::error::Result;
use isospan_io::exec::Resources;
#[cfg(feature = "compare")]
use isospan_io::grid::IndexBox;
use isospan_io::volume::VolumeReader;
use serde::Serialize;

/// The samples of a source, in any order, as an archive has values.
pub(in crate::pipeline) struct SourceSamples {
    pub(super) reader: Box<dyn VolumeReader>,
    pub(super) missing: Option<f64>,
    pub(super) stand_in: Option<f32>,
    /// What is left for work with them.
    pub(in crate::pipeline) resources: Resources,
    pub(super) _scratch: Option<Scratch>,
}

impl SourceSamples {
    /// The samples of a box, x fastest; NaN where there is no data.
    ///
    /// # Errors
    /// Those of reading the source.
    #[cfg(feature = "compare")]
    pub(in crate::pipeline) fn read(&self, place: IndexBox) -> Result<Vec<f32>> {
        let mut samples = vec![0.0; place.len()];
        self.reader.read_box(place, &mut samples)?;
        treat_missing(self.missing, self.stand_in.unwrap_or(f32::NAN), &mut samples);
        Ok(samples)
    }
}

/// What is done with a step and the samples of its source, besides.
pub(in crate::pipeline) type Also<'a> = &'a mut dyn FnMut(&StepView, &SourceSamples) -> Result<()>;

/// How far an isosurface of an archive is from that of the samples. Lengths are world units.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SurfaceErrors {
    /// The number of the step.
    pub step: u64,
    /// The isovalue.
    pub isovalue: f64,
    /// The surface of the archive.
    pub archive: SurfaceSize,
    /// Marching cubes of the samples.
    pub source: SurfaceSize,
    /// From the surface of the archive to that of the samples; none where one of them is empty.
    pub to_source: Option<SurfaceDistance>,
    /// From the surface of the samples to that of the archive.
    pub to_archive: Option<SurfaceDistance>,
}

impl SurfaceErrors {
    /// How far the two surfaces are apart: 99 % of the area of each is at most so far from the
    /// other. That is the Hausdorff distance without the farthest 1 % of each, which may be specks
    /// of noise. 0 where both are empty, infinite where one is.
    pub fn distance(&self) -> f64 {
        match (self.to_source, self.to_archive) {
            (Some(a), Some(b)) => a.p99.max(b.p99),
            _ if self.archive.area == 0.0 && self.source.area == 0.0 => 0.0,
            _ => f64::INFINITY,
        }
    }
}

/// How large a surface is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SurfaceSize {
    /// Triangles.
    pub triangles: u64,
    /// Area.
    pub area: f64,
    /// Connected pieces.
    pub pieces: u64,
    /// Pieces that are closed.
    pub closed_pieces: u64,
}
