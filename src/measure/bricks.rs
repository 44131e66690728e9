//! Errors brick by brick.
//!
//! A brick's samples lie in tetrahedra of several chunks. Each chunk writes what it knows of a
//! brick as a record; the records are sorted by brick, outside of memory if need be, and those of a
//! brick are added up in chunk order.

use super::sums::error_of;
use isospan_io::error::Result;
use std::collections::BTreeMap;

/// What a chunk knows of a brick. All fields are integers, so that records have an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct BrickRecord {
    pub(crate) brick: u64,
    pub(crate) chunk: u64,
    samples: u64,
    /// Bits of the sum of squares and of the largest absolute error.
    squares: u64,
    max: u64,
}

/// The errors of a brick, or of the cells of a level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct BrickErrors {
    /// Samples measured.
    pub(crate) samples: u64,
    /// Sum of the squares of their errors.
    pub(crate) squares: f64,
    /// The largest absolute error.
    pub(crate) max: f64,
}

impl BrickErrors {
    /// Adds a sample, if it has an error.
    #[inline]
    pub(crate) fn add(&mut self, original: f32, reduced: f32) {
        if original.is_finite() && !reduced.is_nan() {
            let error = f64::from(error_of(original, reduced));
            self.samples += 1;
            self.squares += error * error;
            self.max = self.max.max(error.abs());
        }
    }

    /// Adds what another chunk knows.
    pub(crate) fn merge(&mut self, other: &Self) {
        self.samples += other.samples;
        self.squares += other.squares;
        self.max = self.max.max(other.max);
    }

    /// The root mean square error; NaN of no sample.
    pub(crate) fn rms(&self) -> f64 {
        (self.squares / self.samples as f64).sqrt()
    }
}

impl BrickRecord {
    /// The records of a chunk.
    pub(crate) fn of(chunk: u64, bricks: &BTreeMap<u64, BrickErrors>) -> Vec<Self> {
        let record = |(&brick, e): (&u64, &BrickErrors)| Self {
            brick,
            chunk,
            samples: e.samples,
            squares: e.squares.to_bits(),
            max: e.max.to_bits(),
        };
        bricks.iter().map(record).collect()
    }

    fn errors(&self) -> BrickErrors {
        BrickErrors {
            samples: self.samples,
            squares: f64::from_bits(self.squares),
            max: f64::from_bits(self.max),
        }
    }
}

/// Hands `each` the number and the errors of every brick that has some, given all records in
/// ascending order.
pub(crate) fn merged(
    mut next: impl FnMut() -> Result<Option<BrickRecord>>,
    mut each: impl FnMut(u64, &BrickErrors) -> Result<()>,
) -> Result<()> {
    let mut at: Option<(u64, BrickErrors)> = None;
    while let Some(record) = next()? {
        match &mut at {
            Some((brick, errors)) if *brick == record.brick => errors.merge(&record.errors()),
            _ => {
                if let Some((brick, errors)) = at.replace((record.brick, record.errors())) {
                    each(brick, &errors)?;
                }
            }
        }
    }
    at.map_or(Ok(()), |(brick, errors)| each(brick, &errors))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_of_chunks_become_bricks() {
        let mut bricks = [BTreeMap::<u64, BrickErrors>::new(), BTreeMap::new()];
        for (chunk, brick, a, b) in
            [(0, 4, 1.0, 2.0), (0, 9, 1.0, 4.0), (1, 4, 0.0, -3.0), (1, 2, f32::NAN, 1.0), (1, 5, 0.0, 0.0)]
        {
            bricks[chunk].entry(brick).or_default().add(a, b);
        }
        let mut records: Vec<BrickRecord> =
            bricks.iter().zip(0..).flat_map(|(b, chunk)| BrickRecord::of(chunk, b)).collect();
        records.sort_unstable();
        let (mut records, mut found) = (records.into_iter(), vec![]);
        merged(
            || Ok(records.next()),
            |brick, e| {
                found.push((brick, e.samples, e.rms(), e.max));
                Ok(())
            },
        )
        .unwrap();
        assert!(found[0].0 == 2 && found[0].1 == 0 && found[0].2.is_nan());
        assert_eq!(found[1..], [(4, 2, 5f64.sqrt(), 3.0), (5, 1, 0.0, 0.0), (9, 1, 3.0, 3.0)]);
    }
}
