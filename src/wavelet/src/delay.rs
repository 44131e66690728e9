//! Which axis is split later than the others: tried on boxes of samples.

use crate::encode;
use crate::error::Result;
use crate::pyramid::Box3;
use crate::quantise::Scale;

/// Splits by which an axis may be late.
const LATEST: u8 = 3;
/// Edge of a box that is tried.
const EDGE: usize = 64;
/// Boxes of a large array.
const BOXES: usize = 8;
/// A delay must be this much better than none: a box is not all of the samples.
const BETTER: f64 = 0.97;
/// What a bit is worth, in squared steps.
const BIT: f64 = 0.08;

/// Boxes of an array to try delays on: one in the middle, and more of them in a large one.
pub fn boxes(dims: [usize; 3]) -> Vec<Box3> {
    let samples: usize = dims.iter().product();
    let n = (samples >> 22).clamp(1, BOXES);
    // Bits of the number of a box, in opposite order, are its place: 1/2, 1/4, 3/4, …
    let part = |i: usize, n: usize| ((i + 1) as u32).reverse_bits() as f64 / 2.0_f64.powi(32) * n as f64;
    let one = |i: usize| {
        let size = dims.map(|n| n.min(EDGE));
        // The axes go through the places in different order.
        let at = |a: usize| part((i * (2 * a + 1)) % n, dims[a] - size[a]) as usize;
        Box3 { start: [0, 1, 2].map(at), size }
    };
    (0..n).map(one).collect()
}

/// The delay with which boxes of samples take the least bits and errors, at a step.
pub fn choose_delay(boxes: &[(Vec<f32>, [usize; 3])], scale: &Scale) -> Result<[u8; 3]> {
    let none = [0; 3];
    let mut best = (BETTER * price(boxes, scale, none)?, none);
    let mut way = none;
    // An axis alone, or both others.
    for one in [[0, 0, 1], [0, 1, 0], [1, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]] {
        let price = price(boxes, scale, one)?;
        if price < best.0 {
            (best, way) = ((price, one), one);
        }
    }
    for late in 2..=LATEST {
        let later = way.map(|d| d * late);
        let price = if way == none { break } else { price(boxes, scale, later)? };
        if price >= best.0 {
            break;
        }
        best = (price, later);
    }
    Ok(best.1)
}

/// Bits and squared errors of boxes, in bits.
fn price(boxes: &[(Vec<f32>, [usize; 3])], scale: &Scale, delay: [u8; 3]) -> Result<f64> {
    boxes.iter().map(|(samples, dims)| encode::price(samples, *dims, scale, delay, BIT)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_along_which_little_is_alike_is_split_late() {
        let scale = Scale::new([-4.0, 4.0], 0.05).unwrap();
        let dims = [64, 64, 32];
        let wave = |i: usize| {
            let [x, y, z] = [i % 64, i / 64 % 64, i / 4096].map(|n| n as f64);
            ((x * 0.1).sin() + (y * 0.12).cos() + 1.5 * (z * 1.9).sin()) as f32
        };
        let samples: Vec<f32> = (0..dims.iter().product()).map(wave).collect();
        let delay = choose_delay(&[(samples, dims)], &scale).unwrap();
        assert!(delay[2] > 0 && delay[..2] == [0, 0], "{delay:?}");
        let dims = [40, 40, 40];
        let ball = |i: usize| {
            let r = [i % 40, i / 40 % 40, i / 1600].map(|n| (n as f64 - 20.0).powi(2)).iter().sum::<f64>();
            (1.0 / (1.0 + (r - 120.0) * (r - 120.0) / 4000.0)) as f32
        };
        let samples: Vec<f32> = (0..dims.iter().product()).map(ball).collect();
        assert_eq!(choose_delay(&[(samples, dims)], &scale), Ok([0; 3]));
    }

    #[test]
    fn boxes_lie_in_the_array() {
        for dims in [[1, 1, 1], [300, 20, 64], [700, 600, 500]] {
            let boxes = boxes(dims);
            assert!(boxes.iter().all(|b| !b.is_empty() && b.cut(&Box3::all(dims)) == *b), "{boxes:?}");
            assert!(boxes.iter().enumerate().all(|(i, b)| boxes[..i].iter().all(|a| a != b)));
        }
    }
}
