//! Which point set: its parameters as they are stored, and their choice from a wanted number of
//! points.

use super::MOST_POINTS;
use super::explicit::ExplicitPoints;
use super::grids::hyperbolic_cross_len;
use isospan_io::error::{Error, Result};
use isospan_io::geom::Lattice;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// The kinds of point sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SetKind {
    /// ((k+t)/n, Φ₂(k), Φ₃(k)).
    Hammersley,
    /// (Φ₂(k), Φ₃(k), Φ₅(k)).
    Halton,
    /// The hyperbolic cross.
    HyperbolicCross,
    /// A sub-grid of the voxels.
    Regular,
    /// All samples, stored as a wavelet pyramid.
    Pyramid,
    /// The own vertices of a mesh. It is not chosen by name: a mesh that is asked for whole has it.
    Own,
}

impl SetKind {
    /// The kinds of points that are joined to tetrahedra and are chosen by name, in the order in
    /// which they are presented.
    pub const ALL: [Self; 4] = [Self::Hammersley, Self::Halton, Self::HyperbolicCross, Self::Regular];

    /// The name on the command line and in an archive.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hammersley => "hammersley",
            Self::Halton => "halton",
            Self::HyperbolicCross => "hyperbolic-cross",
            Self::Regular => "regular",
            Self::Pyramid => "pyramid",
            Self::Own => "own",
        }
    }
}

impl fmt::Display for SetKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for SetKind {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let mut all = Self::ALL.into_iter().chain([Self::Pyramid]);
        all.find(|k| k.name() == name).ok_or_else(|| {
            let known = Self::ALL.map(Self::name).join(", ") + ", " + Self::Pyramid.name();
            Error::usage(format!("there is no point set called '{name}'; choose one of {known}"))
        })
    }
}

/// A point set in a box: everything its positions depend on, besides the lattice.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "set", rename_all = "kebab-case", deny_unknown_fields)]
pub enum PointSpec {
    /// ((k+t)/n, Φ₂(k), Φ₃(k)), k = 0 … n-1.
    Hammersley {
        /// Number of points, at least 1.
        n: u64,
        /// The shift t, 0 <= t < 1, rounded to a multiple of 2^-32.
        shift: f64,
    },
    /// (Φ₂(k), Φ₃(k), Φ₅(k)), k = 1 … n.
    Halton {
        /// Number of points, at least 1.
        n: u64,
    },
    /// The union of the grids l_j/2^(s_j+k) with Σ (r_j+1)·s_j <= m·(r_min+1).
    HyperbolicCross {
        /// Level, at most 40.
        m: u32,
        /// log2 of the cells of the coarsest grid: 2 to 5; the published formula has 3.
        k: u32,
        /// Regularity of the field along each axis, at most 1000.
        r: [u32; 3],
    },
    /// A sub-grid of the voxels, which includes the faces of the box.
    Regular {
        /// Voxels along each axis: at least 2, at most the volume's.
        counts: [u64; 3],
    },
    /// All samples, stored as a wavelet pyramid.
    Pyramid {
        /// Samples along each axis: those of the volume.
        dims: [u64; 3],
        /// Levels by which the splits of each axis begin later.
        delay: [u8; 3],
    },
    /// All samples, stored as labels, without coarser levels.
    Labels {
        /// Samples along each axis: those of the volume.
        dims: [u64; 3],
    },
    /// Listed points alone: the own vertices of a mesh. Several may share a position.
    Own {
        /// Number of points, at least 1 and at most [`ExplicitPoints::MOST`].
        n: u64,
    },
}

/// The parameters that [`PointSpec::with_count`] may not choose itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SetSettings {
    /// Shift t of a Hammersley set; default 1/2.
    pub shift: f64,
    /// m of a hyperbolic cross; chosen by the count if absent.
    pub m: Option<u32>,
    /// k of a hyperbolic cross; chosen by the count if absent.
    pub k: Option<u32>,
    /// Regularities of a hyperbolic cross; default 1.
    pub r: [u32; 3],
}

impl Default for SetSettings {
    fn default() -> Self {
        Self { shift: 0.5, m: None, k: None, r: [1; 3] }
    }
}

/// The largest m of a hyperbolic cross: 2^40 points and more for any k.
const LARGEST_M: u32 = 40;
const KS: std::ops::RangeInclusive<u32> = 2..=5;
const LARGEST_R: u32 = 1000;
/// Levels by which the splits of an axis begin later, at most.
const MOST_DELAY: u8 = 8;

impl PointSpec {
    /// The set of a kind with a number of interior points as near to `count` as the kind allows.
    /// Samples of the boundary come on top.
    ///
    /// # Errors
    /// [`Error::Usage`] for a count of 0 or above [`MOST_POINTS`], and for settings that are out of
    /// range.
    pub fn with_count(kind: SetKind, lattice: &Lattice, count: u64, settings: &SetSettings) -> Result<Self> {
        if count == 0 || count > MOST_POINTS {
            return Err(Error::usage(format!("{count} points: choose a number from 1 to {MOST_POINTS}")));
        }
        let spec = match kind {
            SetKind::Hammersley => Self::Hammersley { n: count, shift: settings.shift },
            SetKind::Halton => Self::Halton { n: count },
            SetKind::HyperbolicCross => nearest_cross(count, settings),
            SetKind::Regular => Self::Regular { counts: nearest_counts(count, lattice.dims) },
            SetKind::Pyramid => Self::Pyramid { dims: lattice.dims, delay: [0; 3] },
            SetKind::Own => Self::Own { n: count },
        };
        spec.check(lattice)?;
        Ok(spec.canonical())
    }

    /// The same set with its shift rounded as it is used, a number that survives being written as
    /// decimal text.
    pub(super) fn canonical(self) -> Self {
        match self {
            Self::Hammersley { n, shift } => {
                Self::Hammersley { n, shift: f64::from(shift_q32(shift)) / 4_294_967_296.0 }
            }
            other => other,
        }
    }

    /// The kind of the set.
    pub fn kind(&self) -> SetKind {
        match self {
            Self::Hammersley { .. } => SetKind::Hammersley,
            Self::Halton { .. } => SetKind::Halton,
            Self::HyperbolicCross { .. } => SetKind::HyperbolicCross,
            Self::Regular { .. } => SetKind::Regular,
            Self::Pyramid { .. } | Self::Labels { .. } => SetKind::Pyramid,
            Self::Own { .. } => SetKind::Own,
        }
    }

    /// Number of interior points, not to be asked of parameters that [`PointSpec::check`] refuses.
    fn interior(&self) -> u128 {
        match *self {
            Self::Hammersley { n, .. } | Self::Halton { n } | Self::Own { n } => u128::from(n),
            Self::HyperbolicCross { m, k, r } => hyperbolic_cross_len(m, k, r),
            Self::Regular { counts } => counts.iter().map(|&c| u128::from(c)).product(),
            Self::Pyramid { dims, .. } | Self::Labels { dims } => {
                dims.iter().map(|&d| u128::from(d)).product()
            }
        }
    }

    /// Whether all parameters are in range.
    ///
    /// # Errors
    /// [`Error::Usage`] that names the parameter, its value and its range.
    pub fn check(&self, lattice: &Lattice) -> Result<()> {
        match *self {
            Self::Hammersley { shift, .. } if !(0.0..1.0).contains(&shift) => {
                return refuse("the shift of a Hammersley set", shift, "at least 0 and below 1");
            }
            Self::HyperbolicCross { m, .. } if m > LARGEST_M => {
                return refuse("m of a hyperbolic cross", m, "0 to 40");
            }
            Self::HyperbolicCross { k, .. } if !KS.contains(&k) => {
                return refuse("k of a hyperbolic cross", k, "2 to 5");
            }
            Self::HyperbolicCross { r, .. } if r.iter().any(|&r| r > LARGEST_R) => {
                return refuse(
                    "a regularity of a hyperbolic cross",
                    r.into_iter().fold(0, u32::max),
                    "0 to 1000",
                );
            }
            Self::Regular { counts } => {
                for (c, d) in counts.into_iter().zip(lattice.dims) {
                    if !(2..=d).contains(&c) {
                        return refuse(
                            "an axis of a regular set",
                            c,
                            &format!("2 to the volume's {d} samples"),
                        );
                    }
                }
            }
            Self::Pyramid { dims, delay }
                if dims != lattice.dims || delay.iter().any(|&d| d > MOST_DELAY) =>
            {
                return refuse(
                    "a pyramid",
                    format!("of {dims:?} samples with delays {delay:?}"),
                    &format!("of all samples, with delays of at most {MOST_DELAY}"),
                );
            }
            Self::Labels { dims } if dims != lattice.dims => {
                return refuse("an array of labels", format!("of {dims:?} samples"), "of all samples");
            }
            Self::Own { n } if n > ExplicitPoints::MOST as u64 => {
                return refuse(
                    "the number of listed points",
                    n,
                    &format!("at most {}", ExplicitPoints::MOST),
                );
            }
            _ => {}
        }
        match self.interior() {
            n if n == 0 || n > u128::from(MOST_POINTS) => refuse(
                &format!("the size of a {} set", self.kind()),
                n,
                &format!("1 to {MOST_POINTS} points"),
            ),
            _ => Ok(()),
        }
    }
}

fn refuse(what: &str, got: impl fmt::Display, expected: &str) -> Result<()> {
    Err(Error::usage(format!("{what} is {got}; it must be {expected}")))
}

/// The shift in 2^-32, rounded; a shift in range that rounds to 1 is the largest below it.
pub(super) fn shift_q32(shift: f64) -> u32 {
    // Multiplying by a power of two is exact, and the conversion saturates.
    (shift * 4_294_967_296.0 + 0.5) as u32
}

/// The candidate whose count is nearest to `count`; the first of equals.
fn nearest<T: Copy>(
    count: u64,
    candidates: impl IntoIterator<Item = T>,
    len: impl Fn(T) -> u128,
) -> Option<T> {
    candidates.into_iter().min_by_key(|&c| len(c).abs_diff(u128::from(count)))
}

/// m and k by the count, unless given. Out-of-range settings pass through, for `check` to name
/// them.
fn nearest_cross(count: u64, settings: &SetSettings) -> PointSpec {
    let r = settings.r;
    let ks = settings.k.map_or(KS, |k| k..=k);
    let ms = settings.m.map_or(0..=LARGEST_M, |m| m..=m);
    let in_range = *ks.end() <= *KS.end() && *ms.end() <= LARGEST_M && r.iter().all(|&r| r <= LARGEST_R);
    let first = (*ms.start(), *ks.start());
    let best = if in_range {
        let pairs = ks.flat_map(|k| ms.clone().map(move |m| (m, k)));
        nearest(count, pairs, |(m, k)| hyperbolic_cross_len(m, k, r))
    } else {
        None
    };
    let (m, k) = best.unwrap_or(first);
    PointSpec::HyperbolicCross { m, k, r }
}

/// A sub-grid as nearly isotropic as the volume: by bisection the spacing whose grid is the finest
/// with at most `count` points, then the best of the eight grids with one voxel more or not on each
/// axis.
fn nearest_counts(count: u64, dims: [u64; 3]) -> [u64; 3] {
    let at = |h: f64| dims.map(|d| (((d - 1) as f64 / h) as u64 + 1).clamp(2, d));
    let len = |c: [u64; 3]| c.iter().map(|&c| u128::from(c)).product::<u128>();
    let (mut fine, mut coarse) = (1.0, dims.into_iter().max().unwrap_or(2) as f64);
    if len(at(fine)) <= u128::from(count) {
        return dims;
    }
    for _ in 0..60 {
        let middle = (fine + coarse) / 2.0;
        if len(at(middle)) > u128::from(count) { fine = middle } else { coarse = middle }
    }
    let base = at(coarse);
    let grids = (0..8u64).map(|more| std::array::from_fn(|a| (base[a] + (more >> a & 1)).min(dims[a])));
    nearest(count, grids, len).unwrap_or(base)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lattice() -> Lattice {
        Lattice::new([103, 94, 161]).unwrap()
    }

    #[test]
    fn counts_are_met_as_nearly_as_the_kind_allows() {
        let l = lattice();
        for count in [20, 500, 9000, 194_851, 1_000_000] {
            for kind in SetKind::ALL {
                let spec = PointSpec::with_count(kind, &l, count, &SetSettings::default()).unwrap();
                let off = spec.interior() as f64 / count as f64;
                let allowed = match kind {
                    SetKind::Hammersley | SetKind::Halton => 1.0,
                    SetKind::Regular if count >= 500 => 1.1,
                    _ => 2.0,
                };
                assert!((1.0 / allowed..=allowed).contains(&off), "{kind} {count}: {spec:?} {off}");
            }
        }
        let all =
            PointSpec::with_count(SetKind::Regular, &l, u64::MAX >> 6, &SetSettings::default()).unwrap();
        assert_eq!(all, PointSpec::Regular { counts: l.dims });
    }

    #[test]
    fn the_nearest_cross_is_the_nearest() {
        let spec = |count, settings| {
            PointSpec::with_count(SetKind::HyperbolicCross, &lattice(), count, &settings).unwrap()
        };
        let by_count = SetSettings::default();
        assert_eq!(spec(495, by_count), PointSpec::HyperbolicCross { m: 2, k: 2, r: [1; 3] });
        let published = SetSettings { k: Some(3), ..by_count };
        assert!(matches!(spec(495, published), PointSpec::HyperbolicCross { m: 0, k: 3, .. }));
        let fixed = SetSettings { k: Some(3), m: Some(4), ..by_count };
        assert!(matches!(spec(1, fixed), PointSpec::HyperbolicCross { m: 4, k: 3, .. }));
    }

    #[test]
    fn bad_parameters_are_named() {
        let refused = |spec: PointSpec, word: &str| {
            let message = spec.check(&lattice()).unwrap_err().to_string();
            assert!(message.contains(word), "{message}");
        };
        refused(PointSpec::Hammersley { n: 5, shift: 1.0 }, "shift");
        refused(PointSpec::Hammersley { n: 5, shift: f64::NAN }, "shift");
        refused(PointSpec::Hammersley { n: 0, shift: 0.5 }, "hammersley");
        refused(PointSpec::Halton { n: MOST_POINTS + 1 }, "halton");
        refused(PointSpec::HyperbolicCross { m: 41, k: 3, r: [1; 3] }, "41");
        refused(PointSpec::HyperbolicCross { m: 2, k: 6, r: [1; 3] }, "k of");
        refused(PointSpec::HyperbolicCross { m: 2, k: 3, r: [1, u32::MAX, 1] }, "regularity");
        refused(PointSpec::Regular { counts: [4, 95, 4] }, "94");
        refused(PointSpec::Regular { counts: [4, 1, 4] }, "regular");
        let settings = SetSettings { k: Some(9), ..SetSettings::default() };
        assert!(PointSpec::with_count(SetKind::HyperbolicCross, &lattice(), 100, &settings).is_err());
        assert!(PointSpec::with_count(SetKind::Halton, &lattice(), 0, &SetSettings::default()).is_err());
    }

    #[test]
    fn names_and_json() {
        for kind in SetKind::ALL {
            assert_eq!(kind.name().parse::<SetKind>().unwrap(), kind);
            assert_eq!(serde_json::to_string(&kind).unwrap(), format!("\"{kind}\""));
            let spec = PointSpec::with_count(kind, &lattice(), 700, &SetSettings::default()).unwrap();
            let json = serde_json::to_string(&spec).unwrap();
            assert!(json.contains(&format!("\"set\":\"{kind}\"")), "{json}");
            assert_eq!(serde_json::from_str::<PointSpec>(&json).unwrap(), spec);
        }
        assert!("bcc".parse::<SetKind>().unwrap_err().to_string().contains("pyramid"));
    }

    #[test]
    fn shifts_are_rounded() {
        let third = SetSettings { shift: 1.0 / 3.0, ..SetSettings::default() };
        let spec = PointSpec::with_count(SetKind::Hammersley, &lattice(), 9, &third).unwrap();
        let PointSpec::Hammersley { shift, .. } = spec else { panic!("a Hammersley set") };
        assert!((shift - 1.0 / 3.0).abs() < 2e-10 && (shift * 4_294_967_296.0).fract() == 0.0);
        assert_eq!(spec.canonical(), spec);
        assert_eq!((shift_q32(0.0), shift_q32(0.5), shift_q32(1.0 - 1e-16)), (0, 1 << 31, u32::MAX));
    }
}
