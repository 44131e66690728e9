//! The offset that is subtracted from the values of a source before they become `f32`, and their
//! rounding then: see [`isospan_io::volume::shifted`].
//!
//! The first step of an archive decides the offset; all steps have it. Sources whose type is exact
//! in `f32` are not read for this; others are read once, or twice where values lose digits.

use crate::archive::manifest::StepPlan;
use crate::pipeline::settings::NanPolicy;
use isospan_io::cells::CellMesh;
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::volume::shifted::{Shifted, Surveyed, is_missing, is_whole, may_need_offset, survey};
use isospan_io::volume::{ScalarType, VolumeInfo, VolumeReader, VolumeSource};
use isospan_mesh::simd::with_vectors;
use isospan_wavelet::MOST_LABEL;
use std::path::Path;

/// From this on, `f64` has not all whole numbers.
const WHOLE_F64: f64 = 9_007_199_254_740_992.0;

/// How the values of a source are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::pipeline) struct Shift {
    /// The offset that is subtracted.
    pub(in crate::pipeline) offset: f64,
    /// The most that a value differs from its `f32`, where that matters.
    pub(in crate::pipeline) rounding: f64,
}

impl Shift {
    /// That of a step.
    pub(in crate::pipeline) fn of(step: &StepPlan) -> Self {
        Self { offset: step.source.offset, rounding: step.source.rounding }
    }

    /// The shift of a volume; `offset` is the one that the archive has already.
    ///
    /// # Errors
    /// Those of reading it; [`Error::BadInput`] for values that `f32` does not hold.
    pub(in crate::pipeline) fn of_volume(
        open: impl Fn() -> Result<VolumeSource>,
        offset: Option<f64>,
        missing: Option<f64>,
        cancel: &CancelToken,
    ) -> Result<Self> {
        let source = open()?;
        // Of a reader that has values alone, those.
        let info = match &source {
            VolumeSource::Random(reader) => reader.stored_info(),
            other => other.info().clone(),
        };
        let VolumeInfo { path, slope, intercept, field, .. } = info;
        if !may_need_offset(field.scalar, slope, intercept) && offset.is_none_or(|o| o == 0.0) {
            return Ok(Self::default());
        }
        let mut source = Some(source);
        let look = |offset| {
            let source = source.take().map_or_else(&open, Ok)?;
            survey(source.into_stream(), missing, offset, cancel)
        };
        Self::chosen(&path, is_whole(field.scalar, slope, intercept), offset, look)
    }

    /// None: labels are kept as they are.
    ///
    /// # Errors
    /// Those of reading the volume; [`Error::BadInput`] for numbers that `f32` does not hold.
    pub(in crate::pipeline) fn of_labels(
        open: impl Fn() -> Result<VolumeSource>,
        missing: Option<f64>,
        cancel: &CancelToken,
    ) -> Result<Self> {
        let source = open()?;
        let VolumeInfo { path, slope, intercept, field, .. } = match &source {
            VolumeSource::Random(reader) => reader.stored_info(),
            other => other.info().clone(),
        };
        if !may_need_offset(field.scalar, slope, intercept) {
            return Ok(Self::default());
        }
        let found = survey(source.into_stream(), missing, 0.0, cancel)?;
        let [lo, hi] = found.range;
        if lo > hi || found.rounding(true) == 0.0 && lo.abs().max(hi.abs()) <= MOST_LABEL.into() {
            return Ok(Self::default());
        }
        let expected = format!("labels: whole numbers from -{MOST_LABEL} to {MOST_LABEL}, which f32 holds");
        Err(Error::bad_input(path, "samples", expected, format!("{lo} to {hi}")).with_help(
            "number them anew from 0 on, as skimage.segmentation.relabel_sequential and fastremap.renumber do",
        ))
    }

    /// The shift of a field of a mesh.
    ///
    /// # Errors
    /// As [`Shift::of_volume`].
    pub(in crate::pipeline) fn of_mesh(
        mesh: &CellMesh,
        offset: Option<f64>,
        missing: Option<f64>,
        memory: u64,
        cancel: &CancelToken,
    ) -> Result<Self> {
        let scalar = mesh.field()?.scalar;
        // A magnitude, or a mean of cells, may be no f32 where the numbers are.
        let exact = !may_need_offset(scalar, 1.0, 0.0) && !scalar.is_float();
        if exact && offset.is_none_or(|o| o == 0.0) {
            return Ok(Self::default());
        }
        let mut largest = 0.0f64;
        let look = |offset| {
            let (mut values, mut block, mut found) =
                (mesh.values(memory, move |v| is_missing(v, missing))?, vec![], Surveyed::NONE);
            while values.next_block(&mut block)? {
                cancel.check()?;
                for v in block.iter().filter(|v| !is_missing(**v, missing)) {
                    found.add(v - offset);
                    largest = largest.max(v.abs());
                }
            }
            Ok(found)
        };
        let shift = Self::chosen(&mesh.info().path, is_whole(scalar, 1.0, 0.0), offset, look)?;
        // Numbers of meshes are read as f64, which has not all of these whole numbers.
        let wide = matches!(scalar, ScalarType::I64 | ScalarType::U64) && largest >= WHOLE_F64;
        let lost = if wide { (largest.next_up() - largest) / 2.0 } else { 0.0 };
        Ok(Self { rounding: shift.rounding + lost, ..shift })
    }

    fn chosen(
        path: &Path,
        whole: bool,
        offset: Option<f64>,
        mut look: impl FnMut(f64) -> Result<Surveyed>,
    ) -> Result<Self> {
        let mut found = look(offset.unwrap_or(0.0))?;
        let offset = match offset {
            Some(offset) => offset,
            None => {
                let chosen = found.offset(whole);
                if chosen != 0.0 {
                    found = look(chosen)?;
                }
                chosen
            }
        };
        if found.is_beyond() {
            let [lo, hi] = found.range.map(|v| v + offset);
            let expected = "values that f32 holds, from 1.2e-38 to 3.4e38 in size";
            return Err(Error::bad_input(path, "values", expected, format!("{lo:e} to {hi:e}")).with_help(
                "scale the field before; or, where one of these means no data, name it with `missing`",
            ));
        }
        Ok(Self { offset, rounding: found.rounding(whole) })
    }
}

/// How samples are read: less the offset, and those that are none.
#[derive(Clone, Copy, Debug)]
pub(in crate::pipeline) struct Reading {
    offset: f64,
    missing: Option<f64>,
    nan: NanPolicy,
}

impl Reading {
    pub(in crate::pipeline) fn new(offset: f64, missing: Option<f64>, nan: NanPolicy) -> Self {
        Self { offset, missing, nan }
    }

    /// That of a step; where it refuses what is no number, that has no value.
    pub(in crate::pipeline) fn of(step: &StepPlan) -> Self {
        let nan = NanPolicy::parse(&step.nan).unwrap_or(NanPolicy::Mask);
        Self::new(step.source.offset, step.missing, nan)
    }

    pub(in crate::pipeline) fn offset(&self) -> f64 {
        self.offset
    }

    /// The value that means "no data" in the source, besides what that declares.
    pub(super) fn declared(&self) -> Option<f64> {
        self.missing
    }

    /// Values less the offset.
    pub(in crate::pipeline) fn reader(&self, reader: Box<dyn VolumeReader>) -> Box<dyn VolumeReader> {
        match self.offset {
            0.0 => reader,
            offset => Box::new(Shifted::new(reader, offset, self.missing)),
        }
    }

    /// The value that means "no data" among those that the reader gives; one that subtracts has
    /// made it NaN.
    pub(in crate::pipeline) fn missing(&self) -> Option<f64> {
        self.missing.filter(|_| self.offset == 0.0)
    }

    /// The value that replaces samples that are not finite, if they are not refused or left out.
    pub(in crate::pipeline) fn stand_in(&self) -> Option<f32> {
        match self.nan {
            NanPolicy::Value(v) => Some((v - self.offset) as f32),
            NanPolicy::Error | NanPolicy::Mask => None,
        }
    }
}

/// Puts a value in the place of samples that are missing or infinite.
pub(in crate::pipeline) fn treat_missing(missing: Option<f64>, stand_in: f32, samples: &mut [f32]) {
    // Where nothing is declared missing, a number that is equal to none. Written without a branch,
    // for the compiler's vectors.
    let missing = missing.map_or(f32::NAN, |m| m as f32);
    with_vectors(
        #[inline(always)]
        // What it compares with by value: through a reference it could be one of the samples.
        move || {
            for v in samples {
                *v = if v.is_finite() & (*v != missing) { *v } else { stand_in };
            }
        },
    );
}
