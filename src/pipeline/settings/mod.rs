//! What a user chooses: what is made ([`ReduceSettings`]), and with which resources
//! ([`RunSettings`]).
//!
//! The first decides every byte of an archive; the second decides none. What is made of the first
//! are [`CompleteSettings`]: by the same rules from the command line, from Rust and from Python.

mod complete;
mod surface_target;

use crate::archive::manifest::{self, KEYFRAMES};
use isospan_io::error::{Error, Result};
use isospan_io::exec::Resources;
use isospan_io::setting::Setting;
use isospan_mesh::points::{SetKind, SetSettings};
use isospan_mesh::sample::{Interpolation, Values};
use serde::{Deserialize, Serialize};
use std::fmt;

pub(super) use complete::DEFAULT_ERROR;
pub use complete::{Adapt, CompleteSettings, InputFacts};
pub use surface_target::{Length, SurfaceTarget};

/// How many points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Amount {
    /// All samples of a pyramid; of points an eighth of the samples.
    #[default]
    Usual,
    /// This fraction of the samples.
    Fraction(f64),
    /// This number.
    Count(u64),
}

impl Amount {
    /// This fraction of a number, or this number.
    pub(super) fn of(self, all: f64) -> f64 {
        match self {
            Self::Usual => all / 8.0,
            Self::Fraction(part) => all * part,
            Self::Count(n) => n as f64,
        }
    }
}

/// What the user chooses of a reduction; what is not said follows from the rest and from the input
/// ([`ReduceSettings::complete`]).
#[derive(Clone, Debug, PartialEq)]
pub struct ReduceSettings {
    /// The point set. By default a pyramid of all samples for a volume, Hammersley's points for a
    /// mesh, and Halton's where points adapt.
    pub points: Option<SetKind>,
    /// Its parameters that do not follow from the amount.
    pub set: SetChoice,
    /// The number of interior points for a volume that is no pyramid: a pyramid refuses it. For a
    /// mesh, the number of points with a value, boundary included. A mesh is kept as it is by a
    /// fraction of 1, or a count of its vertices or more: with default points, linear
    /// interpolation, and neither `adapt` nor `target`.
    pub amount: Amount,
    /// Whether points are dense where the field needs them; a Halton set can be. An error as the
    /// target of a mesh, or of a Halton set, implies it, and so does a focus.
    pub adapt: bool,
    /// The values that matter where points adapt: what happens above and below does not count.
    pub focus: Option<Focus>,
    /// The error or the size that is not to be exceeded: the amount follows from it. A target that
    /// cannot be met is no error: the report says so, see
    /// [`ReduceReport::unmet`](super::ReduceReport::unmet). A pyramid has an RMS error of 1 % of
    /// the range by default.
    pub target: Option<Target>,
    /// How values are interpolated between samples.
    pub interpolation: Interpolation,
    /// Whether values are fitted to the samples. By default they are, but for the interpolations
    /// whose very values are wanted ([`Values::usual`]).
    pub values: Option<Values>,
    /// What happens to samples that are no numbers.
    pub nan: NanPolicy,
    /// A value that means "no data", besides what the file declares.
    pub missing: Option<f64>,
    /// Bits to which values are rounded, of the range of the source; values are exact without.
    pub value_bits: Option<f64>,
    /// Points meshed together.
    pub chunk_points: u64,
    /// In a series: steps from one keyframe, which refers to no other step, to the next; 1 makes
    /// each step a keyframe.
    pub keyframes: u64,
    /// Whether the field is measured at every sample of the source in the end.
    pub measure: bool,
}

impl ReduceSettings {
    /// Exact values at points of a set, with defaults for all else.
    pub fn exact(points: SetKind) -> Self {
        Self { points: Some(points), ..Self::default() }
    }

    /// Default of `chunk_points`.
    pub const CHUNK_POINTS: u64 = manifest::CHUNK_POINTS;
    /// Default of `keyframes`.
    pub const KEYFRAMES: u64 = KEYFRAMES;
}

impl Default for ReduceSettings {
    fn default() -> Self {
        Self {
            points: None,
            set: SetChoice::default(),
            amount: Amount::Usual,
            adapt: false,
            focus: None,
            target: None,
            interpolation: Interpolation::Linear,
            values: None,
            nan: NanPolicy::Error,
            missing: None,
            value_bits: None,
            chunk_points: Self::CHUNK_POINTS,
            keyframes: Self::KEYFRAMES,
            measure: true,
        }
    }
}

/// Parameters of a point set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetChoice {
    /// Of Hammersley points: the shift t in (k + t)/n; 1/2 by default.
    pub shift: Option<f64>,
    /// Of a hyperbolic cross: its level; the one nearest to the count by default.
    pub m: Option<u32>,
    /// Of a hyperbolic cross: log2 of the cells of the coarsest grid; by the count as well.
    pub k: Option<u32>,
    /// Of a hyperbolic cross: the regularity of the field along x, y and z; 1 by default.
    pub r: Option<[u32; 3]>,
}

impl SetChoice {
    /// All of them.
    fn complete(self) -> SetSettings {
        let usual = SetSettings::default();
        SetSettings {
            shift: self.shift.unwrap_or(usual.shift),
            m: self.m,
            k: self.k,
            r: self.r.unwrap_or(usual.r),
        }
    }
}

/// The values of the field that matter, from one to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Focus {
    /// The lower end.
    pub low: FieldValue,
    /// The upper end.
    pub high: FieldValue,
}

impl Focus {
    /// Whether an end is a share of the range of the field.
    pub(super) fn is_of_a_range(self) -> bool {
        [self.low, self.high].iter().any(|end| matches!(end, FieldValue::Share(_)))
    }

    /// Its ends, of a field of this range.
    fn of(self, range: Option<[f64; 2]>) -> Result<[f64; 2]> {
        Ok([self.low.of(range)?, self.high.of(range)?])
    }
}

impl From<[f64; 2]> for Focus {
    fn from([low, high]: [f64; 2]) -> Self {
        Self { low: FieldValue::At(low), high: FieldValue::At(high) }
    }
}

/// A value of the field, or a place in its range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FieldValue {
    /// The value.
    At(f64),
    /// This part of the range above its lower end: 0.5 is the middle.
    Share(f64),
}

impl From<f64> for FieldValue {
    fn from(value: f64) -> Self {
        Self::At(value)
    }
}

impl FieldValue {
    /// The value itself, where the field has this range.
    ///
    /// # Errors
    /// [`Error::Usage`] for a share of a range that there is not.
    pub fn of(self, range: Option<[f64; 2]>) -> Result<f64> {
        match (self, range) {
            (Self::At(value), _) => Ok(value),
            (Self::Share(share), Some([lo, hi])) => Ok(short(lo + share * (hi - lo), hi - lo)),
            (Self::Share(_), None) => {
                Err(Error::usage("there is no range to take a percentage of: no point has a value"))
            }
        }
    }
}

/// A number with the digits of an `f32`, unless that is no place in a range of this length.
fn short(value: f64, length: f64) -> f64 {
    let short = (value as f32).to_string().parse().unwrap_or(value);
    if (short - value).abs() <= 1e-6 * length { short } else { value }
}

/// What to do with samples that are NaN, infinite, or declared missing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NanPolicy {
    /// Refuse the volume, naming the first such sample.
    #[default]
    Error,
    /// A point that such a sample contributes to is void, and a tetrahedron with a void corner is
    /// never extracted.
    Mask,
    /// Use this value in place of such a sample.
    Value(f64),
}

impl NanPolicy {
    /// What [`NanPolicy`]'s `Display` writes; `None` for other text.
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "error" => Some(Self::Error),
            "mask" => Some(Self::Mask),
            number => number.parse::<f64>().ok().filter(|v| (*v as f32).is_finite()).map(Self::Value),
        }
    }
}

impl fmt::Display for NanPolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Error => f.write_str("error"),
            Self::Mask => f.write_str("mask"),
            Self::Value(v) => write!(f, "{v}"),
        }
    }
}

/// An error that is not to be exceeded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// The root of the mean square of the errors at all samples.
    Rms(Bound),
    /// The largest absolute error at a sample, or at a vertex of a mesh.
    Max(Bound),
    /// The distance of an isosurface from that of the samples, of a volume that becomes a pyramid.
    Surface(SurfaceTarget),
    /// No error of samples that are whole numbers, of a volume.
    Lossless,
    /// The same of labels, whole numbers that are names: without coarser levels, as there is no
    /// mean of two of them. A volume has it by default whose file says that it has labels.
    Labels,
    /// Bytes of the archive.
    Size(u64),
    /// How many times as many bytes the source has: its files or its samples, whichever are less.
    Ratio(f64),
}

/// How large an error may be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bound {
    /// In units of the field.
    Value(f64),
    /// As a part of the range of the samples.
    OfRange(f64),
}

impl Bound {
    /// The bound in units of the field, whose samples have this range.
    pub fn in_units(self, range: [f64; 2]) -> f64 {
        match self {
            Self::Value(v) => v,
            Self::OfRange(part) => part * (range[1] - range[0]),
        }
    }
}

impl Target {
    /// How large the error may be, if that is what is wanted.
    pub(super) fn bound(self) -> Option<Bound> {
        match self {
            Self::Rms(bound) | Self::Max(bound) => Some(bound),
            Self::Surface(_) | Self::Lossless | Self::Labels | Self::Size(_) | Self::Ratio(_) => None,
        }
    }

    /// Whether it bounds the bytes of the archive.
    pub(super) fn is_of_bytes(self) -> bool {
        matches!(self, Self::Size(_) | Self::Ratio(_))
    }

    /// Whether it bounds the error of each sample.
    pub(super) fn is_of_each_sample(self) -> bool {
        matches!(self, Self::Max(_) | Self::Lossless | Self::Labels)
    }

    /// Whether corrections of single samples meet it, so that nothing is searched for.
    pub(super) fn is_met_by_corrections(self, settings: &CompleteSettings) -> bool {
        self.is_of_each_sample() && settings.points == SetKind::Pyramid
    }

    /// # Errors
    /// [`Error::Usage`] for a bound that is no positive number, and for settings that cannot meet
    /// it.
    pub(super) fn check(self, settings: &CompleteSettings) -> Result<()> {
        let (what, bound) = match self {
            Self::Rms(Bound::Value(v) | Bound::OfRange(v))
            | Self::Max(Bound::Value(v) | Bound::OfRange(v)) => ("an error", v),
            Self::Surface(_) if settings.points != SetKind::Pyramid => {
                return Err(Error::usage(format!(
                    "{} is for a volume that becomes a pyramid, and this becomes points",
                    Setting::TargetSurface
                )));
            }
            Self::Surface(target) => ("a distance", target.distance.in_world(None, None)?),
            Self::Lossless | Self::Labels if settings.points == SetKind::Pyramid => return Ok(()),
            Self::Lossless | Self::Labels => {
                return Err(Error::usage("only a pyramid holds all samples without loss"));
            }
            Self::Size(bytes) => ("a size", bytes as f64),
            Self::Ratio(ratio) => ("a ratio", ratio),
        };
        if !(bound > 0.0 && bound.is_finite()) {
            return Err(Error::usage(format!("{what} of {bound} cannot be met: give a number above 0")));
        }
        if !settings.measure && (self.bound().is_some() || matches!(self, Self::Surface(_))) {
            return Err(Error::usage("a target needs an error that is measured"));
        }
        Ok(())
    }
}

/// Settings that decide how a run uses the machine, and not what it makes.
#[derive(Clone, Debug, Default)]
pub struct RunSettings {
    /// Whether an archive that is already there is replaced.
    pub replace: bool,
    /// In a series: leave out steps that cannot be used, and report them. This changes which steps
    /// are made, but nothing in the other steps.
    pub keep_going: bool,
    /// Threads, memory, scratch folder, and what stops it.
    pub resources: Resources,
}
