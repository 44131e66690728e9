//! Which axis is split later than the others: tried on boxes of samples.

use crate::error::Result;
use crate::pyramid::Box3;
use crate::quantise::Scale;
use crate::whole;

/// Splits by which an axis may be late.
const LATEST: u8 = 3;
/// Edge of a box that is tried.
const EDGE: usize = 64;
/// Boxes of a large array.
const BOXES: usize = 8;
/// A delay must be this much better than none: a box is not all of the samples.
const BETTER: f64 = 0.97;
/// An array with this many times the samples of its boxes is tried along steep axes alone.
const MANY: usize = 2;
/// Differences between neighbours along a steep axis are larger than along another, by this factor.
const STEEP: f64 = 1.35;
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

/// The delay with which boxes of samples take the least bits and errors, at a step. Of an array
/// with many more samples, axes are late along which neighbours differ more than along others.
pub fn choose_delay(boxes: &[(Vec<f32>, [usize; 3])], scale: &Scale, samples: usize) -> Result<[u8; 3]> {
    let none = [0; 3];
    let tried: usize = boxes.iter().map(|b| b.0.len()).sum();
    let ways = match samples > MANY * tried {
        true => vec![steep(boxes)],
        // An axis alone, or both others.
        false => vec![[0, 0, 1], [0, 1, 0], [1, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]],
    };
    if ways == [none] {
        return Ok(none);
    }
    let mut best = (BETTER * price(boxes, scale, none)?, none);
    let mut way = none;
    for one in ways {
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

/// The axes along which neighbours differ much more than along another.
fn steep(boxes: &[(Vec<f32>, [usize; 3])]) -> [u8; 3] {
    let (mut sums, mut counts) = ([0.0; 3], [0.0; 3]);
    for (samples, [nx, ny, _]) in boxes {
        let squares = |a: &[f32], b: &[f32]| {
            a.iter().zip(b).map(|(a, b)| f64::from(a - b) * f64::from(a - b)).sum::<f64>()
        };
        let layer = nx * ny;
        for row in samples.chunks_exact(*nx) {
            sums[0] += squares(row, &row[1..]);
            counts[0] += (nx - 1) as f64;
        }
        for rows in samples.chunks_exact(layer) {
            sums[1] += squares(rows, &rows[*nx..]);
            counts[1] += (layer - nx) as f64;
        }
        sums[2] += squares(samples, &samples[layer..]);
        counts[2] += (samples.len() - layer) as f64;
    }
    let mean = |a: usize| if counts[a] > 0.0 { sums[a] / counts[a] } else { f64::INFINITY };
    let least = (0..3).map(mean).fold(f64::INFINITY, f64::min);
    [0, 1, 2].map(|a| u8::from(mean(a).is_finite() && mean(a) > STEEP * STEEP * least))
}

/// Bits and squared errors of boxes, in bits.
fn price(boxes: &[(Vec<f32>, [usize; 3])], scale: &Scale, delay: [u8; 3]) -> Result<f64> {
    boxes.iter().map(|(samples, dims)| whole::price(samples, *dims, scale, delay, BIT)).sum()
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
        let (n, many) = (samples.len(), 1 << 30);
        let boxes = [(samples, dims)];
        let delay = choose_delay(&boxes, &scale, n).unwrap();
        assert!(delay[2] > 0 && delay[..2] == [0, 0], "{delay:?}");
        assert_eq!(choose_delay(&boxes, &scale, many), Ok(delay));
        let dims = [40, 40, 40];
        let ball = |i: usize| {
            let r = [i % 40, i / 40 % 40, i / 1600].map(|n| (n as f64 - 20.0).powi(2)).iter().sum::<f64>();
            (1.0 / (1.0 + (r - 120.0) * (r - 120.0) / 4000.0)) as f32
        };
        let samples: Vec<f32> = (0..dims.iter().product()).map(ball).collect();
        let boxes = [(samples, dims)];
        assert_eq!(choose_delay(&boxes, &scale, boxes[0].0.len()), Ok([0; 3]));
        assert_eq!(choose_delay(&boxes, &scale, many), Ok([0; 3]));
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
