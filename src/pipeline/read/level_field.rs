//! The field of a level of a pyramid, trilinear between its nodes, at samples.

use super::pyramid::{PyramidStep, range_of_cells};
use super::step_view::StepView;
use crate::archive::chunked::BlockRange;
use isospan_io::error::Result;
use isospan_io::grid::IndexBox;
use isospan_wavelet::Pyramid;
use std::ops::Range;

/// Nodes of a level, from which rows of samples are interpolated.
pub(in crate::pipeline) struct LevelNodes {
    window: IndexBox,
    stride: [u64; 3],
    values: Vec<f32>,
}

/// How many samples of a volume a level spans along each axis: it ends at its last node.
pub(in crate::pipeline) fn samples_of_level(pyramid: &Pyramid, level: usize) -> [u64; 3] {
    let (nodes, stride) = (pyramid.nodes(level), pyramid.stride(level));
    [0, 1, 2].map(|a| ((nodes[a] - 1) * stride[a] + 1) as u64)
}

impl StepView {
    /// The nodes around samples of a box, which the level has.
    ///
    /// # Errors
    /// As [`StepView::nodes`].
    pub(in crate::pipeline) fn nodes_around(&self, level: usize, place: &IndexBox) -> Result<LevelNodes> {
        let PyramidStep { pyramid, .. } = self.pyramid()?;
        let (nodes, stride) = (pyramid.nodes(level), pyramid.stride(level).map(|n| n as u64));
        let window = IndexBox {
            lo: std::array::from_fn(|a| place.lo[a] / stride[a]),
            hi: std::array::from_fn(|a| ((place.hi[a] - 1).div_ceil(stride[a]) + 1).min(nodes[a] as u64)),
        };
        Ok(LevelNodes { window, stride, values: self.nodes(level, &window)? })
    }
}

impl LevelNodes {
    /// The range of some cells of the level.
    pub(in crate::pipeline) fn range_of(&self, cells: &[Range<usize>; 3]) -> BlockRange {
        range_of_cells(&self.values, &self.window, cells).0
    }

    #[cfg(test)]
    fn new(window: IndexBox, stride: [u64; 3], values: Vec<f32>) -> Self {
        Self { window, stride, values }
    }

    /// Calls with y, z and the values of rows of the samples of a box: of one in `every`, evenly
    /// spread. A value is NaN where a node with a weight is.
    pub(in crate::pipeline) fn each_row(
        &self,
        place: &IndexBox,
        every: u64,
        mut each: impl FnMut([u64; 2], &[f32]),
    ) {
        let stride = self.stride[0];
        let first = place.lo[0] / stride;
        let count = ((place.hi[0] - 1).div_ceil(stride) - first) as usize + 1;
        let shares: Vec<f32> = (0..stride).map(|n| n as f32 / stride as f32).collect();
        let mut nodes = vec![0.0; count];
        let mut row = vec![0.0; (place.hi[0] - place.lo[0]) as usize];
        for z in place.lo[2]..place.hi[2] {
            // Three has no divisor in common with a power of two: all distances from nodes are
            // among the rows that are taken.
            for y in (place.lo[1]..place.hi[1]).filter(|y| (y + 3 * z).is_multiple_of(every)) {
                self.nodes_of_row(first, [y, z], &mut nodes);
                expand(&nodes, &shares, (place.lo[0] % stride) as usize, &mut row);
                each([y, z], &row);
            }
        }
    }

    /// The values at the nodes of a row of samples along x.
    fn nodes_of_row(&self, first: u64, at: [u64; 2], nodes: &mut [f32]) {
        let [y, z] = [1, 2].map(|a| (at[a - 1] / self.stride[a], at[a - 1] % self.stride[a]));
        let share = |part: u64, a: usize| part as f32 / self.stride[a] as f32;
        let count = nodes.len();
        let row = |y: u64, z: u64| &self.values[self.window.offset([first, y, z])..][..count];
        nodes.copy_from_slice(row(y.0, z.0));
        if y.1 > 0 {
            blend(nodes, row(y.0 + 1, z.0), share(y.1, 1));
        }
        if z.1 > 0 {
            let mut above = row(y.0, z.0 + 1).to_vec();
            if y.1 > 0 {
                blend(&mut above, row(y.0 + 1, z.0 + 1), share(y.1, 1));
            }
            blend(nodes, &above, share(z.1, 2));
        }
    }
}

fn blend(a: &mut [f32], b: &[f32], share: f32) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += (b - *a) * share);
}

/// The samples of a row, from so many after the first node on. `shares` are those of the second of
/// two nodes at the samples from the first on.
fn expand(nodes: &[f32], shares: &[f32], skipped: usize, row: &mut [f32]) {
    let whole = match (shares.len(), skipped) {
        (1, _) => return row.copy_from_slice(&nodes[..row.len()]),
        (2, 0) => expand_by::<2>(nodes, shares, row),
        (4, 0) => expand_by::<4>(nodes, shares, row),
        (8, 0) => expand_by::<8>(nodes, shares, row),
        _ => 0,
    };
    let (mut start, rest) = (skipped, &nodes[whole..]);
    let mut row = &mut row[whole * shares.len()..];
    for (n, a) in rest.iter().enumerate() {
        let (samples, others) = row.split_at_mut((shares.len() - start).min(row.len()));
        cell([*a, *rest.get(n + 1).unwrap_or(a)], &shares[start..], samples);
        (row, start) = (others, 0);
    }
}

/// As many whole cells as there are; returns how many.
fn expand_by<const N: usize>(nodes: &[f32], shares: &[f32], row: &mut [f32]) -> usize {
    let Some(shares) = shares.first_chunk::<N>() else { return 0 };
    let (cells, _) = row.as_chunks_mut::<N>();
    let count = cells.len().min(nodes.len() - 1);
    for (samples, ends) in cells.iter_mut().zip(nodes.windows(2)) {
        cell([ends[0], ends[1]], shares, samples);
    }
    count
}

/// Samples between two nodes.
#[inline(always)]
fn cell([a, b]: [f32; 2], shares: &[f32], samples: &mut [f32]) {
    for (sample, share) in samples.iter_mut().zip(shares) {
        *sample = a + (b - a) * share;
    }
    // A node is itself, whatever is beside it.
    if let (Some(first), Some(0.0)) = (samples.first_mut(), shares.first()) {
        *first = a;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_trilinear_from_any_place_on() {
        let value = |at: [f64; 3]| (at[0] + 10.0 * at[1] - 3.0 * at[2] + 0.5 * at[0] * at[1]) as f32;
        for stride in [[1, 1, 1], [2, 2, 2], [4, 1, 2], [8, 4, 4], [16, 2, 1]] {
            let window = IndexBox { lo: [1, 0, 2], hi: [8, 5, 6] };
            let mut values = vec![];
            for z in 2..6 {
                for y in 0..5 {
                    let at = |x: u64| [x * stride[0], y * stride[1], z * stride[2]].map(|n| n as f64);
                    values.extend((1..8).map(|x| value(at(x))));
                }
            }
            let nodes = LevelNodes::new(window, stride, values);
            for first in [stride[0], stride[0] + stride[0] / 2, 2 * stride[0]] {
                let end = |a: usize| (window.hi[a] - 1) * stride[a] + 1;
                let place = IndexBox { lo: [first, 0, 2 * stride[2]], hi: [0, 1, 2].map(end) };
                let mut rows = 0;
                nodes.each_row(&place, 1, |[y, z], row| {
                    rows += 1;
                    for (x, found) in (first..).zip(row) {
                        let expected = value([x, y, z].map(|n| n as f64));
                        assert!((found - expected).abs() < 1e-3, "{stride:?} {x} {y} {z}");
                    }
                });
                assert_eq!(rows, place.dims()[1] * place.dims()[2]);
            }
        }
    }

    #[test]
    fn a_node_without_a_value_reaches_as_far_as_its_weight() {
        let window = IndexBox { lo: [0; 3], hi: [4, 2, 1] };
        let values = vec![1.0, f32::NAN, 3.0, 4.0, 1.0, 2.0, 3.0, 4.0];
        let nodes = LevelNodes::new(window, [4; 3], values);
        let mut found = vec![];
        nodes.each_row(&IndexBox { lo: [0; 3], hi: [13, 5, 1] }, 1, |_, row| found.push(row.to_vec()));
        let missing: Vec<bool> = found[0].iter().map(|v| v.is_nan()).collect();
        let expected: Vec<bool> = (0..13).map(|x| (1..8).contains(&x)).collect();
        assert_eq!(missing, expected);
        assert!(found[4].iter().all(|v| !v.is_nan()) && found[4][2] == 1.5);
    }
}
