//! A whole array in memory as bytes.

use crate::correct::{self, Correction};
use crate::decode::Compressed;
use crate::delay::{boxes, choose_delay};
use crate::error::{Error, Result};
use crate::pyramid::Box3;
use crate::quantise::Scale;
use crate::tile::encode_numbers;
use crate::vectors::with_vectors;
use crate::whole::Transformed;

/// Samples that an array may have.
const MOST: u64 = 1 << 40;

/// How much a compressed array may differ from its samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Accuracy {
    /// What neighbouring values of a coefficient differ by, in units of the samples. The RMS error
    /// is about a fifth of it in smooth data, less where most coefficients are zero, more in
    /// noise.
    Step(f64),
    /// The RMS error over all samples at most, in their units. It is met, by at most a twentieth
    /// less, in two to four tries.
    Rms(f64),
    /// The error of each sample at most, in their units. Samples that are farther off are
    /// corrected.
    Max(f64),
    /// No error of samples that are whole numbers of at most 2^24.
    Lossless,
}

/// What is asked of [`compress`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The step, or the error.
    pub accuracy: Accuracy,
    /// Levels by which the splits of each axis begin later: see
    /// [`Pyramid::new`](crate::Pyramid::new). `None` tries which serves best, on a part of the
    /// samples: [`choose_delay`].
    pub delay: Option<[u8; 3]>,
}

/// Compresses an array of samples, x fastest.
pub fn compress(samples: &[f32], dims: [usize; 3], settings: &Settings) -> Result<Vec<u8>> {
    let wanted = dims.iter().try_fold(1_usize, |n, d| n.checked_mul(*d));
    let sizes_fit = dims.iter().all(|d| u32::try_from(*d).is_ok());
    if samples.is_empty() || samples.len() as u64 > MOST || wanted != Some(samples.len()) || !sizes_fit {
        return Err(Error::Size { dims, samples: samples.len() });
    }
    if let Some(index) = samples.iter().position(|s| !s.is_finite()) {
        return Err(Error::NotFinite { index });
    }
    let range = samples.iter().fold([f64::MAX, f64::MIN], |[low, high], s| {
        let s = f64::from(*s);
        [low.min(s), high.max(s)]
    });
    let correction = match settings.accuracy {
        Accuracy::Max(bound) => Correction::within(bound, range)?,
        Accuracy::Lossless => Correction::lossless(samples)?,
        Accuracy::Step(_) | Accuracy::Rms(_) => Correction::None,
    };
    // The scale is that of any step.
    let mut scale = match settings.accuracy {
        Accuracy::Step(step) => Scale::new(range, step)?,
        Accuracy::Rms(error) => Scale::new(range, error)?,
        Accuracy::Max(bound) => Scale::near(range, STEPS[1] * bound)?,
        Accuracy::Lossless => Scale::near(range, STEPS[1] * HALF)?,
    };
    let mut transformed = Transformed::new(samples, dims, &scale, settings.delay.unwrap_or_default());
    if settings.delay.is_none() {
        if let Accuracy::Rms(error) = settings.accuracy {
            scale = Scale::new(range, transformed.guess(range, error)?)?;
        }
        let whole = Box3::all(dims);
        let tried: Vec<_> = boxes(dims).iter().map(|b| (whole.values_of(samples, b), b.size)).collect();
        let delay = choose_delay(&tried, &scale, samples.len())?;
        if delay != transformed.delay {
            transformed = Transformed::new(samples, dims, &scale, delay);
        }
    }
    match settings.accuracy {
        Accuracy::Step(_) => Ok(transformed.encode(&scale)?.bytes(&transformed, &scale)),
        Accuracy::Rms(error) => transformed.search(samples, range, error),
        Accuracy::Max(bound) => transformed.bounded(samples, &scale, correction, bound),
        Accuracy::Lossless => transformed.bounded(samples, &scale, correction, HALF),
    }
}

/// Steps that are tried under a bound, in bounds: with fewer corrections, and with less before
/// them.
const STEPS: [f64; 3] = [2.0, 3.0, 4.5];
/// The bound of whole numbers, before they are rounded.
const HALF: f64 = 0.5;

/// Coefficients of boxes of samples that stand for an array, from which a step follows.
#[derive(Clone, Debug)]
pub struct Sampling {
    coefficients: Vec<f32>,
    range: [f64; 2],
    delay: [u8; 3],
}

impl Sampling {
    /// Transforms boxes of samples, each with its size. `range` is that of the array.
    ///
    /// # Errors
    /// [`Error::Step`] for a range without a width.
    pub fn new(boxes: &[(Vec<f32>, [usize; 3])], range: [f64; 2], delay: [u8; 3]) -> Result<Self> {
        let unit = Scale::new(range, range[1] - range[0])?;
        let all: usize = boxes.iter().map(|b| b.0.len()).sum();
        // An odd number: an even one would leave out whole bands.
        let every = (all >> 18) | 1;
        let mut coefficients = vec![];
        for (samples, dims) in boxes {
            let transformed = Transformed::new(samples, *dims, &unit, delay);
            coefficients.extend(transformed.window.samples.iter().step_by(every));
        }
        Ok(Self { coefficients, range, delay })
    }

    /// The step with which the samples have an RMS error, about.
    ///
    /// # Errors
    /// [`Error::Step`] for an error that `f32` does not hold.
    pub fn step(&self, error: f64) -> Result<f64> {
        guess(&self.coefficients, &Scale::new(self.range, error)?)
    }

    /// How many times larger the RMS error of samples is than [`Sampling::step`] supposes, at a
    /// step: zeroing makes it larger, the range of the samples less. Some boxes are encoded and
    /// decoded.
    ///
    /// # Errors
    /// As [`compress`].
    pub fn excess(&self, boxes: &[(Vec<f32>, [usize; 3])], step: f64) -> Result<f64> {
        let scale = Scale::new(self.range, step)?;
        let (mut supposed, mut found) = (0.0, 0.0);
        for (samples, dims) in boxes {
            let transformed = Transformed::new(samples, *dims, &scale, self.delay);
            supposed += lost(&transformed.window.samples, f64::from(scale.step));
            let bytes = transformed.encode(&scale)?.bytes(&transformed, &scale);
            let back = Compressed::new(&bytes, samples.len())?.level(0)?;
            let errors = samples.iter().zip(&back).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
            found += errors.sum::<f64>();
        }
        let supposed = supposed.sqrt() * scale.in_samples(scale.step);
        Ok(if supposed > 0.0 && found > 0.0 { found.sqrt() / supposed } else { 1.0 })
    }
}

/// The squared errors of coefficients, in squared steps, as if those below 0.8 steps became zero.
fn lost(coefficients: &[f32], step: f64) -> f64 {
    let (chunks, rest) = coefficients.as_chunks::<LANES>();
    let mut last = [0.0; LANES];
    last[..rest.len()].copy_from_slice(rest);
    let per_step = (1.0 / step) as f32;
    with_vectors(
        #[inline(always)]
        || {
            let mut sums = [0.0_f64; LANES];
            for chunk in chunks.iter().chain([&last]) {
                for (c, sum) in chunk.iter().zip(&mut sums) {
                    let c = c.abs() * per_step;
                    let off = if c < 0.8 { c } else { c - (c + 0.5).floor() };
                    *sum += f64::from(off * off);
                }
            }
            sums.iter().sum()
        },
    )
}

/// Coefficients that are looked at side by side.
const LANES: usize = 16;

/// The step with which coefficients have the error that is the step of a scale.
fn guess(coefficients: &[f32], unit: &Scale) -> Result<f64> {
    let target = f64::from(unit.step);
    let error = |step: f64| step * (lost(coefficients, step) / coefficients.len() as f64).sqrt();
    let (mut low, mut high) = (target, 64.0 * target);
    for _ in 0..12 {
        let middle = (low * high).sqrt();
        *(if error(middle) < target { &mut low } else { &mut high }) = middle;
    }
    Ok(unit.in_samples(low as f32))
}

impl Transformed {
    /// The bytes with the largest step that meets an RMS error, nearly.
    fn search(&self, samples: &[f32], range: [f64; 2], target: f64) -> Result<Vec<u8>> {
        /// Steps are accepted that use this much of the error.
        const USED: f64 = 0.95;
        const TRIES: usize = 6;
        let mut step = self.guess(range, target)?;
        let mut best: Option<(f64, Vec<u8>)> = None;
        for tried in 0.. {
            let scale = Scale::new(range, step)?;
            let bytes = self.encode(&scale)?.bytes(self, &scale);
            let back = Compressed::new(&bytes, samples.len())?.level(0)?;
            let errors = samples.iter().zip(&back).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
            let used = (errors.sum::<f64>() / samples.len() as f64).sqrt() / target;
            if used <= 1.0 && best.as_ref().is_none_or(|(s, _)| *s < step) {
                best = Some((step, bytes));
            }
            let enough = (USED..=1.0).contains(&used) || tried + 1 >= TRIES;
            if enough && let Some((_, bytes)) = best {
                return Ok(bytes);
            }
            // A step that misses in the end is halved until it does not, or is too small.
            let aim = if tried < TRIES { 0.98 / used.max(0.2) } else { 0.5 };
            step *= aim.min(2.5);
        }
        unreachable!("the loop ends by what it returns")
    }

    /// The step with which some of the coefficients have an error.
    fn guess(&self, range: [f64; 2], target: f64) -> Result<f64> {
        let every = (self.window.samples.len() >> 18) | 1;
        let some: Vec<f32> = self.window.samples.iter().copied().step_by(every).collect();
        guess(&some, &Scale::new(range, target)?)
    }

    /// The fewest bytes with which no corrected sample is off by more than a bound. The scale has
    /// the second of the steps.
    fn bounded(&self, samples: &[f32], scale: &Scale, by: Correction, bound: f64) -> Result<Vec<u8>> {
        let dims = self.pyramid.nodes(0);
        let whole = Box3::all(dims);
        let mut best: Option<Vec<u8>> = None;
        for part in STEPS {
            let scale = Scale::near(scale.range, scale.in_samples(scale.step) * part / STEPS[1])?;
            let (scale, mut made) = match self.encode(&scale) {
                Err(Error::Step { least, .. }) => {
                    let scale = Scale::new(scale.range, least)?;
                    (scale, self.encode(&scale)?)
                }
                made => (scale, made?),
            };
            let back = Compressed::new(&made.bytes(self, &scale), samples.len())?.level(0)?;
            made.correction = by;
            for place in correct::boxes(dims) {
                let pairs = whole.values_of(samples, &place).into_iter().zip(whole.values_of(&back, &place));
                let numbers = pairs.map(|(sample, back)| by.number(sample, back, bound)).collect();
                let bytes = encode_numbers(place, numbers)?;
                made.lengths.push(bytes.len() as u32);
                made.tiles.extend(bytes);
            }
            let bytes = made.bytes(self, &scale);
            if best.as_ref().is_none_or(|b| bytes.len() < b.len()) {
                best = Some(bytes);
            }
        }
        best.ok_or(Error::Damaged("there is no step to try"))
    }
}
