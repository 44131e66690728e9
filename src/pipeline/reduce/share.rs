//! How large an error of each sample a search for the distance of a surface tries.
//!
//! Where a field is nearly linear, its surface moves by the error over the gradient. So the error
//! of each sample is what is searched for: a pyramid is made with corrections that bound it. Whole
//! numbers are kept as they are where less than half of one is asked for.

use crate::pipeline::settings::{Bound, Target};
use serde::{Deserialize, Serialize};

/// The error of a try, as a part of the range of the samples, at first.
const FIRST: f64 = 0.02;
/// The least one of samples whose range is as large as they are.
const LEAST: f64 = 1e-6;
/// Below this error a whole number is kept without loss.
const OF_WHOLE: f64 = 0.5;

/// How large the error of the samples is in a try.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Share {
    /// The length of the range of samples that are all whole numbers.
    pub(super) of_whole: Option<f64>,
    /// The least that `f32` holds.
    #[serde(default)]
    pub(super) least: f64,
}

/// How many times finer than the first is a try that has no error, at least: it is another one.
const LOSSLESS: f64 = 1.05;

impl Share {
    /// What a try asks for, which is so many times coarser than the first.
    pub(super) fn target(self, factor: f64) -> Target {
        let share = FIRST * factor;
        match self.of_whole {
            Some(range) if share * range < OF_WHOLE => Target::Lossless,
            _ => Target::Max(Bound::OfRange(share)),
        }
    }

    /// How many times finer a try may be than the first: from an error of the whole range to none.
    pub(super) fn limits(self) -> [f64; 2] {
        let finest = match self.of_whole {
            Some(range) => (FIRST / (0.99 * OF_WHOLE / range)).max(LOSSLESS),
            None => (FIRST / LEAST.max(self.least)).max(1.0),
        };
        [FIRST, finest]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_finest_try_of_whole_numbers_is_without_loss() {
        let whole = Share { of_whole: Some(255.0), least: 0.0 };
        let [coarsest, finest] = whole.limits();
        assert_eq!(whole.target(1.0 / finest), Target::Lossless);
        assert_eq!(whole.target(1.0), Target::Max(Bound::OfRange(FIRST)));
        assert_eq!(whole.target(1.0 / coarsest), Target::Max(Bound::OfRange(1.0)));
        // Few values: the first try is finer than half of one already.
        let few = Share { of_whole: Some(1.0), least: 0.0 };
        assert_eq!(few.target(1.0 / few.limits()[1]), Target::Lossless);
        let [_, finest] = Share::default().limits();
        let Target::Max(Bound::OfRange(share)) = Share::default().target(1.0 / finest) else {
            panic!("an error of each sample")
        };
        assert!((share / LEAST - 1.0).abs() < 1e-9, "{share}");
        // Kelvins around 285: f32 holds no millionth of their range.
        let warm = Share { of_whole: None, least: 1e-5 };
        assert!((FIRST / warm.limits()[1] / 1e-5 - 1.0).abs() < 1e-9);
    }
}
