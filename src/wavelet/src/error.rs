use std::fmt;

/// Why an array could not be compressed, or bytes not decoded.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Error {
    /// The array has no samples, more than 2^40, or not as many as its size says.
    Size {
        /// Samples along x, y, z.
        dims: [usize; 3],
        /// Samples that were given.
        samples: usize,
    },
    /// A sample is infinite or no number.
    NotFinite {
        /// Its index, x fastest.
        index: usize,
    },
    /// The step is not positive, or so small that `f32` does not hold the coefficients.
    Step {
        /// The step that was asked for.
        step: f64,
        /// What it must be at least.
        least: f64,
    },
    /// The bound of errors is not positive, or so small that `f32` does not hold what is within it.
    Bound {
        /// The bound that was asked for.
        bound: f64,
        /// One that works.
        least: f64,
    },
    /// A sample is no whole number of at most 2^24, which the lossless way wants.
    NotWhole {
        /// Its index, x fastest.
        index: usize,
    },
    /// A label is beyond 2^24, up to which `f32` has all whole numbers.
    Label {
        /// Its index, x fastest.
        index: usize,
    },
    /// A level that the pyramid does not have.
    Level {
        /// The level that was asked for.
        level: usize,
        /// The coarsest one.
        coarsest: usize,
    },
    /// A box that is empty or not within its level.
    Box {
        /// The level.
        level: usize,
        /// Nodes of the level along x, y, z.
        nodes: [usize; 3],
    },
    /// Bytes that no encoder wrote.
    Damaged(&'static str),
}

/// A result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl std::error::Error for Error {}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Size { dims: [x, y, z], samples } => {
                write!(f, "an array of {x} x {y} x {z} samples is not what {samples} samples make")
            }
            Self::NotFinite { index } => write!(f, "sample {index} is infinite or no number"),
            Self::Step { step, least } => {
                write!(f, "a step of {step} is below what f32 holds of these samples: give at least {least}")
            }
            Self::Bound { bound, least } => {
                write!(f, "a bound of {bound} is below what f32 holds of these samples: {least} works")
            }
            Self::NotWhole { index } => {
                write!(f, "sample {index} is no whole number of at most 2^24: give a bound instead")
            }
            Self::Label { index } => write!(f, "label {index} is beyond 2^24"),
            Self::Level { level, coarsest } => {
                write!(f, "there is no level {level}: levels are 0 (the finest) to {coarsest}")
            }
            Self::Box { level, nodes: [x, y, z] } => {
                write!(f, "the box is empty or not within level {level}, which has {x} x {y} x {z} nodes")
            }
            Self::Damaged(what) => write!(f, "damaged: {what}"),
        }
    }
}
