//! Complete settings: what follows from what a user gives, and from the input.
//!
//! ```text
//!  ReduceSettings ── complete(InputFacts) ──▶ CompleteSettings ──▶ plan, search, archive
//!   what is given      volume or mesh?          nothing is open
//! ```
//!
//! These are the only rules: the command line and Python give what their flags and keywords say.

use super::{Amount, Bound, NanPolicy, ReduceSettings, Target};
use crate::archive::segment::PlanHash;
use isospan_io::error::{Error, Result};
use isospan_io::setting::Setting;
use isospan_mesh::points::{SetKind, SetSettings};
use isospan_mesh::sample::{Interpolation, Values};
use serde::{Deserialize, Serialize};

/// What completes settings: what must be known of an input.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InputFacts {
    /// Whether it is a mesh, and no volume.
    pub is_mesh: bool,
    /// Whether its file says that its samples are labels.
    pub is_labels: bool,
    /// Least and largest value of its first step: for a focus that is a share of them.
    pub range: Option<[f64; 2]>,
}

/// Settings of a reduction that leave nothing open. They decide every byte of an archive, together
/// with the input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct CompleteSettings {
    /// The point set.
    pub points: SetKind,
    /// Its parameters that do not follow from the amount.
    pub set: SetSettings,
    /// The number of points.
    pub amount: Amount,
    /// What decides where points are dense, if anything does.
    #[serde(default)]
    pub adapt: Option<Adapt>,
    /// The error or the size that is not to be exceeded.
    #[serde(default)]
    pub target: Option<Target>,
    /// How values are interpolated between samples.
    pub interpolation: Interpolation,
    /// Whether values are fitted to the samples.
    pub values: Values,
    /// What happens to samples that are no numbers.
    pub nan: NanPolicy,
    /// A value that means "no data", besides what the file declares.
    pub missing: Option<f64>,
    /// Bits to which values are rounded, of the range of the source.
    #[serde(default)]
    pub value_bits: Option<f64>,
    /// Points meshed together.
    pub chunk_points: u64,
    /// Steps from one keyframe to the next.
    pub keyframes: u64,
    /// Whether the field is measured at every sample of the source in the end.
    pub measure: bool,
    /// How many times coarser the coefficients of a pyramid are than a target seems to ask for: a
    /// search for a target finds it.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub(in crate::pipeline) step_factor: f64,
}

fn one() -> f64 {
    1.0
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_one(factor: &f64) -> bool {
    *factor == 1.0
}

/// What decides where points are dense.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Adapt {
    /// The values of interest: what happens above and below does not count.
    pub focus: Option<[f64; 2]>,
}

/// The RMS error of a pyramid by default, as a part of the range of the samples.
pub(in crate::pipeline) const DEFAULT_ERROR: f64 = 0.01;

impl CompleteSettings {
    /// A hash of all of them.
    pub(in crate::pipeline) fn hash(&self) -> PlanHash {
        PlanHash::of(&serde_json::to_vec(self).expect("settings are plain data"))
    }

    /// The value that means "no data", as a plan records it: NaN and infinity always do.
    pub(in crate::pipeline) fn finite_missing(&self) -> Option<f64> {
        self.missing.filter(|m| m.is_finite())
    }
}

impl ReduceSettings {
    /// The settings with all that follows from them for an input, by the rules of every door:
    ///
    /// * A focus makes points adapt. So does an error as the target of a mesh without named points,
    ///   and of Halton points.
    /// * A volume becomes a pyramid of its samples, with an RMS error of 1 % of their range where
    ///   no target is given; or Halton points that adapt; or Hammersley points, where their shift
    ///   is given. A mesh becomes Hammersley points, or Halton points that adapt.
    /// * A volume whose file says that it has labels is kept as these.
    /// * Values at points are fitted, or sampled where the interpolation wants that.
    ///
    /// # Errors
    /// [`Error::Usage`] for settings that do not go together.
    pub fn complete(&self, input: &InputFacts) -> Result<CompleteSettings> {
        let adapts = self.adapts(input.is_mesh);
        let points = self.set_of(input.is_mesh, adapts);
        self.check_set(points)?;
        let is_pyramid = points == SetKind::Pyramid;
        if is_pyramid {
            self.check_pyramid(input.is_mesh)?;
        }
        let adapt = if adapts { Some(self.adapt_at(points, input.range)?) } else { None };
        let target = match self.target {
            None if is_pyramid && input.is_labels => Some(Target::Labels),
            // An error that is not measured is no target.
            None if is_pyramid && self.measure => Some(Target::Rms(Bound::OfRange(DEFAULT_ERROR))),
            given => given,
        };
        if target == Some(Target::Labels) {
            self.check_labels(points)?;
        }
        let values = if is_pyramid { Some(Values::Sample) } else { self.values };
        Ok(CompleteSettings {
            points,
            set: self.set.complete(),
            amount: self.amount,
            adapt,
            target,
            interpolation: self.interpolation,
            values: values.unwrap_or_else(|| Values::usual(self.interpolation)),
            nan: self.nan,
            missing: self.missing,
            value_bits: self.value_bits,
            chunk_points: self.chunk_points,
            keyframes: self.keyframes,
            measure: self.measure,
            step_factor: 1.0,
        })
    }

    /// Whether points adapt.
    fn adapts(&self, is_mesh: bool) -> bool {
        let may_adapt = match self.points {
            None => is_mesh,
            Some(points) => points == SetKind::Halton,
        };
        let is_of_error = self.target.is_some_and(|target| target.bound().is_some());
        self.adapt || self.focus.is_some() || is_of_error && may_adapt
    }

    /// The point set.
    fn set_of(&self, is_mesh: bool, adapts: bool) -> SetKind {
        self.points.unwrap_or(match (adapts, is_mesh) {
            (true, _) => SetKind::Halton,
            (false, true) => SetKind::Hammersley,
            (false, false) if self.set.shift.is_some() && self.target.is_none() => SetKind::Hammersley,
            (false, false) => SetKind::Pyramid,
        })
    }

    /// Refuses parameters of another set.
    fn check_set(&self, points: SetKind) -> Result<()> {
        let set = &self.set;
        let is_cross = set.m.is_some() || set.k.is_some() || set.r.is_some();
        if is_cross && points != SetKind::HyperbolicCross {
            return Err(Error::usage(format!(
                "{}, {} and {} are for {}",
                Setting::CrossM,
                Setting::CrossK,
                Setting::CrossR,
                Setting::Points.of(SetKind::HyperbolicCross)
            )));
        }
        if set.shift.is_some() && points != SetKind::Hammersley {
            return Err(Error::usage(format!(
                "{} is for {}",
                Setting::Shift,
                Setting::Points.of(SetKind::Hammersley)
            )));
        }
        Ok(())
    }

    /// Refuses what a pyramid cannot be of, and what asks for points: it has all samples.
    fn check_pyramid(&self, is_mesh: bool) -> Result<()> {
        if is_mesh {
            return Err(Error::usage(
                "a pyramid keeps all samples of a volume, and this is a mesh: choose a point set",
            ));
        }
        let asked = [
            (matches!(self.amount, Amount::Count(_)), Setting::Count),
            (matches!(self.amount, Amount::Fraction(_)), Setting::Fraction),
            (self.values.is_some(), Setting::Values),
            (self.value_bits.is_some(), Setting::ValueBits),
            (self.interpolation != Interpolation::Linear, Setting::Interpolation),
            (self.chunk_points != Self::CHUNK_POINTS, Setting::ChunkPoints),
        ];
        match asked.into_iter().find(|asked| asked.0) {
            None => Ok(()),
            Some((_, setting)) => Err(Error::usage(format!(
                "{setting} is for point sets, and a pyramid keeps all samples of a volume: add {}, halton or \
                 regular, or leave {setting} out and ask surface for a {}",
                Setting::Points.of(SetKind::Hammersley),
                Setting::Level
            ))),
        }
    }

    /// Refuses what labels cannot have: they are samples, and each step is alone.
    fn check_labels(&self, points: SetKind) -> Result<()> {
        let refuse = |setting: Setting, why: &str| {
            Err(Error::usage(format!("{setting} does not go with {}: {why}", Setting::Labels)))
        };
        match () {
            () if points != SetKind::Pyramid => refuse(Setting::Points, "labels are those of all samples"),
            () if self.keyframes != Self::KEYFRAMES => {
                refuse(Setting::Keyframes, "each step of labels is one")
            }
            () => Ok(()),
        }
    }

    /// What decides where points are dense.
    fn adapt_at(&self, points: SetKind, range: Option<[f64; 2]>) -> Result<Adapt> {
        if points != SetKind::Halton {
            return Err(Error::usage(format!(
                "only a halton set can be denser in some places; {} does not go with {}",
                Setting::Adapt,
                Setting::Points.of(points)
            )));
        }
        let focus = self.focus.map(|focus| focus.of(range)).transpose()?;
        match focus {
            Some([lo, hi]) if !(lo < hi && lo.is_finite() && hi.is_finite()) => Err(Error::usage(format!(
                "the focus {lo}:{hi} is no range: write two numbers, the smaller one first"
            ))),
            focus => Ok(Adapt { focus }),
        }
    }
}
