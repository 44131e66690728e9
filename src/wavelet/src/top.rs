//! The numbers that are left when no axis can be split any more: fewer than 8 along each.

use crate::error::{Error, Result};
use crate::range_coder::{Coder, Decoder, Encoder, Odds};

/// Numbers of the coarsest level at most.
const MOST: usize = 7 * 7 * 7;
/// Bits of a difference to what is foretold, at most.
const BITS: usize = 34;

/// The coarsest level as bytes. A number is foretold from its seven neighbours before it, as if
/// their corner's third difference were zero (Ibarria and others, "Out-of-core compression and
/// decompression of large n-dimensional scalar fields", 2003).
///
/// # Errors
/// Numbers of 2^30 and more.
pub fn encode_top(numbers: &[i32], size: [usize; 3]) -> Result<Vec<u8>> {
    let mut coder = Encoder::default();
    let mut numbers = numbers.to_vec();
    walk(&mut numbers, size, &mut coder)?;
    Ok(coder.finish())
}

/// What [`encode_top`] was given.
pub fn decode_top(bytes: &[u8], size: [usize; 3]) -> Result<Vec<i32>> {
    let n: usize = size.iter().product();
    if n > MOST {
        return Err(Error::Damaged("the coarsest level is too large"));
    }
    let (mut numbers, mut coder) = (vec![0; n], Decoder::new(bytes));
    walk(&mut numbers, size, &mut coder)?;
    coder.finish()?;
    Ok(numbers)
}

fn foretold(numbers: &[i32], [nx, ny, _]: [usize; 3], [x, y, z]: [usize; 3]) -> i64 {
    let mut sum = 0;
    for corner in 1..8_usize {
        let [dx, dy, dz] = [corner & 1, corner >> 1 & 1, corner >> 2];
        if dx <= x && dy <= y && dz <= z {
            let number = i64::from(numbers[((z - dz) * ny + y - dy) * nx + x - dx]);
            sum += if corner.count_ones() % 2 == 1 { number } else { -number };
        }
    }
    sum
}

fn walk<C: Coder>(numbers: &mut [i32], size: [usize; 3], coder: &mut C) -> Result<()> {
    let mut odds = [[Odds::new(1 << 15); BITS]; 3];
    let mut before = 0;
    for z in 0..size[2] {
        for y in 0..size[1] {
            for x in 0..size[0] {
                let at = (z * size[1] + y) * size[0] + x;
                let foretold = foretold(numbers, size, [x, y, z]);
                let wanted = i64::from(numbers[at]) - foretold;
                let row = &mut odds[usize::min(before, 2)];
                let difference = difference(wanted, row, coder)?;
                before = (64 - difference.unsigned_abs().leading_zeros() as usize) / 3;
                numbers[at] = i32::try_from(foretold + difference)
                    .map_err(|_| Error::Damaged("a coefficient of the coarsest level is too large"))?;
            }
        }
    }
    Ok(())
}

/// A difference: how many bits it has in unary, those below the highest, and its sign.
fn difference<C: Coder>(wanted: i64, odds: &mut [Odds; BITS], coder: &mut C) -> Result<i64> {
    let length = 64 - wanted.unsigned_abs().leading_zeros() as usize;
    let mut bits = 0;
    while coder.bit(&mut odds[bits], length > bits) {
        bits += 1;
        if bits == BITS {
            return Err(Error::Damaged("a coefficient of the coarsest level is too large"));
        }
    }
    if bits == 0 {
        return Ok(0);
    }
    let mut magnitude = 1;
    for bit in (0..bits - 1).rev() {
        magnitude = magnitude << 1 | i64::from(coder.even(wanted.unsigned_abs() >> bit & 1 == 1));
    }
    Ok(if coder.even(wanted < 0) { -magnitude } else { magnitude })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back() {
        for size in [[1, 1, 1], [7, 7, 7], [4, 1, 6], [2, 7, 3]] {
            let n = size.iter().product::<usize>() as i32;
            for scale in [0, 1, 1000, (1 << 30) / 7] {
                let numbers: Vec<i32> = (0..n).map(|i| (i * 37 % 15 - 7) * scale).collect();
                let bytes = encode_top(&numbers, size).unwrap();
                assert_eq!(decode_top(&bytes, size).unwrap(), numbers);
                let mut longer = bytes.clone();
                longer.extend([1; 12]);
                assert!(decode_top(&longer, size).is_err());
            }
        }
        assert!(encode_top(&[0; 343], [7; 3]).unwrap().len() < 8);
    }
}
