//! A step and its error as the manifest has them: what is usual, or follows, is left out. Reports
//! tell all members of the same types, so they are not written as these are.

use super::{CoordinateRecord, SegmentRecord, Source, StepPlan, StoredStep};
use crate::archive::segment::SegmentInfo;
use crate::measure::{FieldError, LevelError, PERCENTILES, Percentile, Worst};
use isospan_io::grid::Geometry;
use serde::{Deserialize, Deserializer, Serialize};

/// Whether a member has the value that it has where it is left out.
pub(super) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Whether a number is 0 and not -0, which is another value.
#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
pub(super) fn is_zero(v: &f64) -> bool {
    v.to_bits() == 0
}

pub(super) fn one<T: From<u8>>() -> T {
    T::from(1)
}

pub(super) fn is_one<T: From<u8> + PartialEq>(v: &T) -> bool {
    *v == one()
}

fn same_bits<const N: usize>(a: &[f64; N], b: &[f64; N]) -> bool {
    a.map(f64::to_bits) == b.map(f64::to_bits)
}

/// A geometry without its usual members.
#[derive(Serialize, Deserialize)]
#[serde(remote = "Geometry", default = "Geometry::default")]
pub(super) struct GeometryRecord {
    #[serde(skip_serializing_if = "is_usual_origin")]
    origin: [f64; 3],
    #[serde(skip_serializing_if = "is_usual_spacing")]
    spacing: [f64; 3],
    #[serde(skip_serializing_if = "is_usual_direction")]
    direction: [[f64; 3]; 3],
}

fn is_usual_origin(origin: &[f64; 3]) -> bool {
    same_bits(origin, &Geometry::default().origin)
}

fn is_usual_spacing(spacing: &[f64; 3]) -> bool {
    same_bits(spacing, &Geometry::default().spacing)
}

fn is_usual_direction(direction: &[[f64; 3]; 3]) -> bool {
    direction.iter().zip(&Geometry::default().direction).all(|(a, b)| same_bits(a, b))
}

pub(super) fn is_usual_geometry(geometry: &Geometry) -> bool {
    is_usual_origin(&geometry.origin)
        && is_usual_spacing(&geometry.spacing)
        && is_usual_direction(&geometry.direction)
}

/// A [`StoredStep`].
#[derive(Serialize, Deserialize)]
pub(super) struct StepRecord {
    #[serde(flatten)]
    plan: StepPlan,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    place: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    series: Option<String>,
    value_range: Option<[f32; 2]>,
    #[serde(default, skip_serializing_if = "is_default")]
    void_points: u64,
    values: Vec<SegmentRecord>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    ranges: Vec<SegmentRecord>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    coarse: Option<SegmentInfo>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    index: Option<SegmentInfo>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    spectrum: Option<SegmentInfo>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    coordinates: Option<CoordinateRecord>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    error: Option<ErrorRecord>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    level_errors: Vec<LevelError>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    level_rms: Vec<f64>,
}

impl From<StoredStep> for StepRecord {
    fn from(step: StoredStep) -> Self {
        let error = step.error.as_ref().map(|e| ErrorRecord::new(e, &step.plan.source, step.value_range));
        Self {
            plan: step.plan,
            place: step.place,
            series: step.series,
            value_range: step.value_range,
            void_points: step.void_points,
            values: step.values,
            ranges: step.ranges,
            coarse: step.coarse,
            index: step.index,
            spectrum: step.spectrum,
            coordinates: step.coordinates,
            error,
            level_errors: step.level_errors,
            level_rms: step.level_rms,
        }
    }
}

impl TryFrom<StepRecord> for StoredStep {
    type Error = String;

    fn try_from(record: StepRecord) -> Result<Self, String> {
        let error = record.error.map(|e| e.error(&record.plan.source, record.value_range)).transpose()?;
        Ok(Self {
            plan: record.plan,
            place: record.place,
            series: record.series,
            value_range: record.value_range,
            void_points: record.void_points,
            values: record.values,
            ranges: record.ranges,
            coarse: record.coarse,
            index: record.index,
            spectrum: record.spectrum,
            coordinates: record.coordinates,
            error,
            level_errors: record.level_errors,
            level_rms: record.level_rms,
        })
    }
}

/// A [`FieldError`].
#[derive(Serialize, Deserialize)]
struct ErrorRecord {
    /// Left out: all samples of the source.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    samples: Option<u64>,
    /// Left out: all of `samples`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    measured: Option<u64>,
    #[serde(default, skip_serializing_if = "is_default")]
    missing: u64,
    #[serde(default, skip_serializing_if = "is_default")]
    void: u64,
    #[serde(default, skip_serializing_if = "is_default")]
    outside: u64,
    #[serde(default, skip_serializing_if = "is_default")]
    beyond: u64,
    /// Left out: that of the values. Null: none.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "there")]
    source_range: Option<Option<[f64; 2]>>,
    /// Left out: the difference at the worst sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    max: Option<f64>,
    rms: f64,
    mean: f64,
    bias: f64,
    /// Of [`PERCENTILES`].
    percentiles: [f64; PERCENTILES.len()],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    worst: Option<WorstRecord>,
}

/// A [`Worst`].
#[derive(Serialize, Deserialize)]
struct WorstRecord {
    sample: u64,
    /// Left out: that of a volume, by its number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    index: Option<[u64; 3]>,
    /// Left out: where the geometry has the index.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    world: Option<[f64; 3]>,
    original: f64,
    reduced: f64,
}

/// A member that is there, be it null.
fn there<'de, T: Deserialize<'de>, D: Deserializer<'de>>(input: D) -> Result<Option<T>, D::Error> {
    T::deserialize(input).map(Some)
}

/// What the other members of a step say of its error.
struct Follows {
    samples: Option<u64>,
    source_range: Option<[f64; 2]>,
    max: Option<f64>,
}

impl Follows {
    fn of(source: &Source, values: Option<[f32; 2]>, worst: Option<&Worst>) -> Self {
        let product = || source.dims.iter().try_fold(1u64, |all, n| all.checked_mul(*n));
        Self {
            samples: source.mesh.map_or_else(product, |mesh| Some(mesh.vertices)),
            source_range: values.map(|range| range.map(|v| f64::from(v) + source.offset)),
            max: worst
                .map(|w| f64::from((w.reduced as f32 - w.original as f32).abs()))
                .filter(|max| max.is_finite()),
        }
    }
}

/// The place of a sample of a volume; none of a mesh, nor of a number that is too large.
fn index_of(source: &Source, sample: u64) -> Option<[u64; 3]> {
    let [x, y, z] = source.dims;
    let row = sample.checked_div(x)?;
    let index = [sample % x, row.checked_rem(y)?, row.checked_div(y)?];
    (source.mesh.is_none() && index[2] < z).then_some(index)
}

impl ErrorRecord {
    fn new(e: &FieldError, source: &Source, values: Option<[f32; 2]>) -> Self {
        debug_assert!(e.percentiles.iter().map(|p| p.percent).eq(PERCENTILES), "{e:?}");
        let follows = Follows::of(source, values, e.worst.as_ref());
        let worst = e.worst.map(|w| {
            let place = w.index.map(|index| world_of(&source.geometry, index));
            WorstRecord {
                sample: w.sample,
                index: w.index.filter(|_| w.index != index_of(source, w.sample)),
                world: Some(w.world).filter(|world| !place.is_some_and(|p| same_bits(world, &p))),
                original: w.original,
                reduced: w.reduced,
            }
        });
        let bits = |range: Option<[f64; 2]>| range.map(|range| range.map(f64::to_bits));
        Self {
            samples: Some(e.samples).filter(|_| Some(e.samples) != follows.samples),
            measured: Some(e.measured).filter(|measured| *measured != e.samples),
            missing: e.missing,
            void: e.void,
            outside: e.outside,
            beyond: e.beyond,
            source_range: Some(e.source_range).filter(|range| bits(*range) != bits(follows.source_range)),
            max: Some(e.max).filter(|_| Some(e.max) != follows.max),
            rms: e.rms,
            mean: e.mean,
            bias: e.bias,
            percentiles: std::array::from_fn(|n| e.percentiles[n].error),
            worst,
        }
    }

    fn error(self, source: &Source, values: Option<[f32; 2]>) -> Result<FieldError, String> {
        let missing = |member: &str| format!("an error of a step without `{member}`, which does not follow");
        let worst = self.worst.map(|w| {
            let index = w.index.or_else(|| index_of(source, w.sample));
            let world = w.world.or_else(|| index.map(|index| world_of(&source.geometry, index)));
            Some(Worst { sample: w.sample, index, world: world?, original: w.original, reduced: w.reduced })
        });
        let worst = worst.map(|w| w.ok_or_else(|| missing("world"))).transpose()?;
        let follows = Follows::of(source, values, worst.as_ref());
        let samples = self.samples.or(follows.samples).ok_or_else(|| missing("samples"))?;
        Ok(FieldError {
            samples,
            measured: self.measured.unwrap_or(samples),
            missing: self.missing,
            void: self.void,
            outside: self.outside,
            source_range: self.source_range.unwrap_or(follows.source_range),
            beyond: self.beyond,
            max: self.max.or(follows.max).ok_or_else(|| missing("max"))?,
            rms: self.rms,
            mean: self.mean,
            bias: self.bias,
            percentiles: PERCENTILES
                .into_iter()
                .zip(self.percentiles)
                .map(|(percent, error)| Percentile { percent, error })
                .collect(),
            worst,
        })
    }
}

fn world_of(geometry: &Geometry, index: [u64; 3]) -> [f64; 3] {
    geometry.to_world(index.map(|i| i as f64))
}
