//! What a user chooses: what is made ([`ReduceSettings`]), and with which resources
//! ([`RunSettings`]).
//!
//! The first decides every byte of an archive; the second decides none.

use crate::archive::manifest::{self, KEYFRAMES};
use crate::archive::segment::PlanHash;
use isospan_io::error::{Error, Result};
use isospan_io::exec::Resources;
use isospan_mesh::points::{SetKind, SetSettings};
use isospan_mesh::sample::{Interpolation, Values};
use serde::{Deserialize, Serialize};
use std::fmt;

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

/// What the user chooses of a reduction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReduceSettings {
    /// The point set. By default a pyramid of all samples for a volume, Hammersley's points for a
    /// mesh, and Halton's where points adapt.
    pub points: Option<SetKind>,
    /// Its parameters that do not follow from the amount.
    pub set: SetSettings,
    /// The number of interior points for a volume that is no pyramid: a pyramid refuses it. For a
    /// mesh, the number of points with a value, boundary included. A mesh is kept as it is by a
    /// fraction of 1, or a count of its vertices or more: with default points, linear
    /// interpolation, and neither `adapt` nor `target`.
    pub amount: Amount,
    /// Whether points are dense where the field needs them; a Halton set can be. An error as the
    /// target of a mesh, or of a Halton set, implies it.
    #[serde(default)]
    pub adapt: Option<Adapt>,
    /// The error or the size that is not to be exceeded: the amount follows from it. A target that
    /// cannot be met is no error: the report says so, see
    /// [`ReduceReport::unmet`](super::ReduceReport::unmet).
    #[serde(default)]
    pub target: Option<Target>,
    /// How values are interpolated between samples.
    pub interpolation: Interpolation,
    /// Whether values are fitted to the samples, as they are by default; not those of
    /// [`Interpolation::Nearest`].
    pub values: Values,
    /// What happens to samples that are no numbers.
    pub nan: NanPolicy,
    /// A value that means "no data", besides what the file declares.
    pub missing: Option<f64>,
    /// Bits to which values are rounded, of the range of the source; values are exact without.
    #[serde(default)]
    pub value_bits: Option<f64>,
    /// Points meshed together.
    pub chunk_points: u64,
    /// In a series: steps from one keyframe, which refers to no other step, to the next; 1 makes
    /// each step a keyframe.
    pub keyframes: u64,
    /// Whether the field is measured at every sample of the source in the end.
    pub measure: bool,
    /// How many times coarser the coefficients of a pyramid are than a target seems to ask for: a
    /// search for a target finds it.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    #[doc(hidden)]
    pub step_factor: f64,
}

fn one() -> f64 {
    1.0
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_one(factor: &f64) -> bool {
    *factor == 1.0
}

/// The RMS error of a pyramid by default, as a part of the range of the samples.
pub(super) const DEFAULT_ERROR: f64 = 0.01;

impl ReduceSettings {
    /// A hash of all of them.
    pub(super) fn hash(&self) -> PlanHash {
        PlanHash::of(&serde_json::to_vec(self).expect("settings are plain data"))
    }

    /// Exact values at points of a set, with defaults for all else.
    pub fn exact(points: SetKind) -> Self {
        Self { points: Some(points), ..Self::default() }
    }

    /// The settings with what a target implies. Every door completes them, so that a request has
    /// the same bytes from the command line, from Rust and from Python.
    ///
    /// Without a target, a pyramid has an RMS error of [`DEFAULT_ERROR`]. An error of a mesh, or
    /// with a Halton set, is met by points that adapt.
    pub(super) fn complete(&self, of_mesh: bool) -> Self {
        if self.set_of(of_mesh) == SetKind::Pyramid {
            let usual = Target::Rms(Bound::OfRange(DEFAULT_ERROR));
            // An error that is not measured is no target.
            let target = self.target.or(self.measure.then_some(usual));
            return Self { points: Some(SetKind::Pyramid), target, values: Values::Sample, ..self.clone() };
        }
        let Some(target) = self.target else { return self.clone() };
        let can_adapt = match self.points {
            None => of_mesh,
            Some(points) => points == SetKind::Halton,
        };
        let implied = (target.bound().is_some() && can_adapt).then(Adapt::default);
        let settings = Self { adapt: self.adapt.or(implied), ..self.clone() };
        Self { points: Some(settings.set_of(of_mesh)), ..settings }
    }

    /// The point set, for a mesh or for a volume.
    pub(super) fn set_of(&self, of_mesh: bool) -> SetKind {
        self.points.unwrap_or(match (self.adapt, of_mesh) {
            (Some(_), _) => SetKind::Halton,
            (None, true) => SetKind::Hammersley,
            (None, false) => SetKind::Pyramid,
        })
    }

    /// Default of `chunk_points`.
    pub const CHUNK_POINTS: u64 = manifest::CHUNK_POINTS;
    /// The value that means "no data", as a plan records it: NaN and infinity always do.
    pub(super) fn finite_missing(&self) -> Option<f64> {
        self.missing.filter(|m| m.is_finite())
    }

    /// Default of `keyframes`.
    pub const KEYFRAMES: u64 = KEYFRAMES;
}

impl Default for ReduceSettings {
    fn default() -> Self {
        Self {
            points: None,
            set: SetSettings::default(),
            amount: Amount::Usual,
            adapt: None,
            target: None,
            interpolation: Interpolation::Linear,
            values: Values::Fit,
            nan: NanPolicy::Error,
            missing: None,
            value_bits: None,
            chunk_points: Self::CHUNK_POINTS,
            keyframes: Self::KEYFRAMES,
            measure: true,
            step_factor: 1.0,
        }
    }
}

/// What decides where points are dense.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Adapt {
    /// The values of interest: what happens above and below does not count.
    pub focus: Option<[f64; 2]>,
}

impl Adapt {
    /// # Errors
    /// [`Error::Usage`] for a range that is none, and for a point set that cannot be denser in some
    /// places.
    pub(super) fn check(&self, settings: &ReduceSettings) -> Result<()> {
        if let Some([lo, hi]) = self.focus
            && !(lo < hi && lo.is_finite() && hi.is_finite())
        {
            return Err(Error::usage(format!(
                "the focus {lo}:{hi} is no range: write two numbers, the smaller one first"
            )));
        }
        let points = settings.set_of(false);
        if points != SetKind::Halton {
            return Err(Error::usage(format!(
                "only a halton set can be denser in some places; --adapt does not go with --points {points}"
            )));
        }
        Ok(())
    }
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
    /// No error of samples that are whole numbers, of a volume.
    Lossless,
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
    /// Whether corrections of single samples meet it, so that nothing is searched for.
    pub(super) fn is_met_by_corrections(self, settings: &ReduceSettings) -> bool {
        matches!(self, Self::Max(_) | Self::Lossless) && settings.set_of(false) == SetKind::Pyramid
    }

    /// How large the error may be, if that is what is wanted.
    pub(super) fn bound(self) -> Option<Bound> {
        match self {
            Self::Rms(bound) | Self::Max(bound) => Some(bound),
            Self::Lossless | Self::Size(_) | Self::Ratio(_) => None,
        }
    }

    /// # Errors
    /// [`Error::Usage`] for a bound that is no positive number, and for settings that cannot meet
    /// it.
    pub(super) fn check(self, settings: &ReduceSettings) -> Result<()> {
        let (what, bound) = match self {
            Self::Rms(Bound::Value(v) | Bound::OfRange(v))
            | Self::Max(Bound::Value(v) | Bound::OfRange(v)) => ("an error", v),
            Self::Lossless if settings.set_of(false) == SetKind::Pyramid => return Ok(()),
            Self::Lossless => return Err(Error::usage("only a pyramid holds all samples without loss")),
            Self::Size(bytes) => ("a size", bytes as f64),
            Self::Ratio(ratio) => ("a ratio", ratio),
        };
        if !(bound > 0.0 && bound.is_finite()) {
            return Err(Error::usage(format!("{what} of {bound} cannot be met: give a number above 0")));
        }
        if self.bound().is_some() && !settings.measure {
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
