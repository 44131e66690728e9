//! The samples of a window at several time steps, interleaved as values of vertices are
//! ([`step_lanes`](super::step_lanes)): one load fetches a sample at eight steps.
//!
//! Samples are read step by step, some slices of the window at a time, and interleaved while they
//! are in a near cache.

use super::step_lanes::{Lanes, StepLanes, interleave};
use isospan_io::error::Result;
use isospan_io::grid::IndexBox;
use std::ops::Range;

/// The samples of a window at up to eight steps, x fastest.
pub(super) enum Rows {
    One(Vec<f32>),
    Four(Vec<[f32; 4]>),
    Eight(Vec<[f32; 8]>),
}

/// The samples of a window at all steps. Lanes without a step have any number.
pub(super) struct WindowSamples {
    rows_of_steps: Vec<(Range<usize>, Rows)>,
    /// The samples of some slices, step after step.
    slices: Vec<f32>,
}

/// Samples of a step that are interleaved at a time, where a slice has no more: those of eight
/// steps fit in the second cache.
const SOME: usize = 1 << 13;

impl WindowSamples {
    /// For the steps whose values lie so.
    pub(super) fn new(steps: &StepLanes<'_>) -> Self {
        let rows = |lanes: &Lanes<'_>| match lanes {
            Lanes::One(_) => Rows::One(vec![]),
            Lanes::Four(_) => Rows::Four(vec![]),
            Lanes::Eight(_) => Rows::Eight(vec![]),
        };
        Self {
            rows_of_steps: steps.iter().map(|(steps, lanes)| (steps, rows(lanes))).collect(),
            slices: vec![],
        }
    }

    /// Reads those of a window; `read` reads samples of one step.
    pub(super) fn read(
        &mut self,
        window: IndexBox,
        read: &mut impl FnMut(usize, IndexBox, &mut [f32]) -> Result<()>,
    ) -> Result<()> {
        for (steps, rows) in &mut self.rows_of_steps {
            match rows {
                Rows::One(samples) => {
                    samples.resize(window.len(), 0.0);
                    read(steps.start, window, samples)?;
                }
                Rows::Four(rows) => fill(rows, steps, window, &mut self.slices, read)?,
                Rows::Eight(rows) => fill(rows, steps, window, &mut self.slices, read)?,
            }
        }
        Ok(())
    }

    /// Those of each group of steps.
    pub(super) fn rows_of_steps(&self) -> impl Iterator<Item = &Rows> {
        self.rows_of_steps.iter().map(|(_, rows)| rows)
    }
}

fn fill<const N: usize>(
    rows: &mut Vec<[f32; N]>,
    steps: &Range<usize>,
    window: IndexBox,
    slices: &mut Vec<f32>,
    read: &mut impl FnMut(usize, IndexBox, &mut [f32]) -> Result<()>,
) -> Result<()> {
    rows.resize(window.len(), [0.0; N]);
    let mut rest = &mut **rows;
    for part in window.slices(SOME) {
        let rows;
        (rows, rest) = rest.split_at_mut(part.len());
        slices.resize(steps.len() * rows.len(), 0.0);
        for (step, out) in steps.clone().zip(slices.chunks_exact_mut(rows.len())) {
            read(step, part, out)?;
        }
        let columns: Vec<&[f32]> = slices.chunks_exact(rows.len()).collect();
        interleave(&columns, rows);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::step_lanes::LaneBuffers;
    use super::*;

    #[test]
    fn slices_make_the_window() {
        let of = |step: usize, [x, y, z]: [u64; 3]| (((step as u64 * 64 + z) * 256 + y) * 256 + x) as f32;
        // Many slices; some at a time, the last ones fewer; each more than are read at a time.
        for dims in [[3, 2, 50], [61, 30, 11], [130, 90, 3]] {
            for count in [1, 3, 9, 13] {
                let lo = [5, 6, 7];
                let window = IndexBox { lo, hi: std::array::from_fn(|k| lo[k] + dims[k]) };
                let none = vec![vec![0.0]; count];
                let values: Vec<&[f32]> = none.iter().map(Vec::as_slice).collect();
                let mut samples = WindowSamples::new(&StepLanes::new(&values, &mut LaneBuffers::default()));
                let mut read = |step: usize, part: IndexBox, out: &mut [f32]| {
                    assert_eq!(out.len(), part.len());
                    let mut out = out.iter_mut();
                    for z in part.lo[2]..part.hi[2] {
                        for y in part.lo[1]..part.hi[1] {
                            (part.lo[0]..part.hi[0])
                                .for_each(|x| *out.next().expect("room") = of(step, [x, y, z]));
                        }
                    }
                    Ok(())
                };
                // What was there before does not show.
                let first = IndexBox { hi: lo.map(|l| l + 2), ..window };
                samples.read(first, &mut read).unwrap();
                samples.read(window, &mut read).unwrap();
                let at = |n: usize| {
                    let (n, [x, y, _]) = (n as u64, dims);
                    [lo[0] + n % x, lo[1] + n / x % y, lo[2] + n / x / y]
                };
                let mut seen = 0;
                for (steps, rows) in &samples.rows_of_steps {
                    for (lane, step) in steps.clone().enumerate() {
                        let found: Vec<f32> = match rows {
                            Rows::One(samples) => samples.clone(),
                            Rows::Four(rows) => rows.iter().map(|row| row[lane]).collect(),
                            Rows::Eight(rows) => rows.iter().map(|row| row[lane]).collect(),
                        };
                        assert!(found.len() == window.len());
                        assert!(found.iter().enumerate().all(|(n, &v)| v == of(step, at(n))), "step {step}");
                        seen += 1;
                    }
                }
                assert_eq!(seen, count);
            }
        }
    }
}
