//! At which isovalues a spectrum is measured: from the range of the values, and from where blocks have theirs.

use super::levels::Levels;
use crate::index::ordered_key;

/// The most knots.
const MOST_KNOTS: u64 = 256;
/// The fewest, for an archive of a few points.
const FEWEST_KNOTS: u64 = 32;

/// How many values lie where: a histogram of all `f32` by their 16 highest bits, in 512 KiB. Two neighbouring bins differ
/// by less than 1 %.
#[derive(Clone, Debug)]
pub struct ValueCounts {
    bins: Vec<u64>,
}

impl Default for ValueCounts {
    fn default() -> Self {
        Self { bins: vec![0; 1 << 16] }
    }
}

impl ValueCounts {
    /// Counts a value `weight` times.
    pub fn add(&mut self, value: f32, weight: u64) {
        self.bins[(ordered_key(value) >> 16) as usize] += weight;
    }

    /// The lower ends of the bins that hold the `parts - 1` values that cut all values in equal parts.
    fn quantiles(&self, parts: u64) -> Vec<f32> {
        let total = u128::from(self.bins.iter().sum::<u64>());
        let (mut below, mut cut, mut found) = (0u128, 1u64, vec![]);
        for (bin, &n) in self.bins.iter().enumerate() {
            below += u128::from(n);
            while cut < parts && n > 0 && below * u128::from(parts) > total * u128::from(cut) {
                let key = (bin as u32) << 16;
                found.push(f32::from_bits(if key >> 31 == 1 { key & !(1 << 31) } else { !key }));
                cut += 1;
            }
        }
        found
    }
}

/// What a spectrum is measured at.
#[derive(Clone, Debug, PartialEq)]
pub struct Design {
    /// Least and largest value.
    pub range: [f32; 2],
    /// Isovalues of area, volume and gradient, ascending, inside the range.
    pub knots: Vec<f32>,
    /// Isovalues of the number of active tetrahedra alone.
    pub levels: Levels,
}

impl Design {
    /// For `points` points of values in `range`, most of them where `values` says.
    pub fn new(range: [f32; 2], values: &ValueCounts, points: u64) -> Self {
        // A difference of levels takes 12 bits or so, a knot 36 bytes: together three bits a point.
        let levels = Levels::new(range, points / 4);
        let most = (points / 128).clamp(FEWEST_KNOTS, MOST_KNOTS);
        let even = Levels::new(range, most - most / 4);
        let mut knots: Vec<f32> = (0..even.count).map(|n| even.level(n)).collect();
        let dense = values.quantiles(most + 1 - u64::from(even.count));
        // A person would rather read 0.05 than 0.0498046875.
        let round = |v| levels.place(v).checked_sub(1).map(|n| levels.level(n));
        knots.extend(dense.into_iter().filter_map(round));
        knots.sort_unstable_by(f32::total_cmp);
        knots.dedup();
        Self { range, knots, levels }
    }

    /// How many knots are at or below `x`.
    pub(super) fn place(&self, x: f32) -> u32 {
        self.knots.partition_point(|&k| k <= x) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knots_are_even_and_dense_where_values_are() {
        let mut values = ValueCounts::default();
        (0..1000u16).for_each(|i| values.add(f32::from(i) * 1e-5, 3));
        values.add(1.0, 1);
        let design = Design::new([0.0, 1.0], &values, 1_000_000);
        assert!((200..=256).contains(&design.knots.len()), "{}", design.knots.len());
        assert!(design.knots.is_sorted_by(|a, b| a < b) && design.knots.iter().all(|&k| 0.0 < k && k <= 1.0));
        assert!(design.knots.iter().filter(|&&k| k < 0.01).count() > 40);
        assert!(design.knots.contains(&0.5) && design.knots.contains(&1.0));
        let few = Design::new([0.0, 1.0], &values, 10);
        assert!(few.knots.len() <= 32 && few.levels.count <= 2);
        assert!(Design::new([2.0, 2.0], &ValueCounts::default(), 10).knots.is_empty());
    }
}
