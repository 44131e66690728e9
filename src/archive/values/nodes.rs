//! The values of a lattice with a node at each sample: those of the nodes are coded, brick by
//! brick, and those of all other points follow from them.
//!
//! ```text
//!  samples of a brick ─▶ parts of a step ─▶ differences to predictions, rounded to steps ─▶ bytes
//!                                     bytes ─▶ parts of the nodes ─▶ means, at centres and on faces
//! ```
//!
//! A value is off by half a step at most, and does not leave the range of the source. It is a whole
//! number of [`PARTS`] of a step, or of steps where all samples are such numbers. So means of nodes
//! are exact sums: all chunks that have a point give it the same value.
//!
//! A brick has up to 16³ nodes, and one more along an axis that ends with it. Up to eight smaller
//! ones, [`brick::Template`], are coded one after another with odds that go on learning.

use super::brick::{self, PARTS, Template};
use super::{Coder, LEVEL_WITH_VOID, Quantiser, VALUES_NODES, VALUES_NODES_VOID, VOID, VOID_STEP};
use super::{pack, unpacked};
use crate::archive::wire::{Cursor, Malformed};

/// Codes bricks of nodes with the steps of a quantiser.
#[derive(Clone, Copy, Debug)]
pub struct NodeCoder {
    quantiser: Quantiser,
    /// The largest value, in parts.
    most: i32,
}

impl NodeCoder {
    /// The fewest bits of values: a step is as large as the range.
    pub const LEAST_BITS: f64 = 1.0;
    /// The most bits: parts of a step, and predictions of them, fit in 32 bits.
    pub const MOST_BITS: f64 = 20.0;

    /// `None` for a quantiser with too many steps, or other parts.
    pub fn new(quantiser: Quantiser) -> Option<Self> {
        let has_few = (Self::LEAST_BITS..=Self::MOST_BITS).contains(&quantiser.bits);
        let has_parts = [1, PARTS].contains(&quantiser.parts);
        let most = (quantiser.steps_of_range() * f64::from(quantiser.parts)) as i32;
        (has_few && has_parts).then_some(Self { quantiser, most })
    }

    /// Appends the bytes of a brick with so many nodes along each axis, and returns its values as
    /// they will be read: numbers of parts. Void samples are NaN.
    ///
    /// # Panics
    /// When there is not one sample a node.
    pub fn encode(&self, nodes: [u32; 3], samples: &[f32], out: &mut Vec<u8>) -> Vec<i32> {
        assert_eq!(samples.len() as u32, nodes.iter().product::<u32>(), "a sample for each node");
        let Quantiser { origin, step, parts, .. } = self.quantiser;
        let in_parts = |v: &f32| match v.is_nan() {
            true => VOID_STEP,
            false => {
                (((f64::from(*v) - origin) / step * f64::from(parts)).round() as i32).clamp(0, self.most)
            }
        };
        let mut values: Vec<i32> = samples.iter().map(in_parts).collect();
        if values.contains(&VOID_STEP) {
            let rounded = |&v: &i32| if v == VOID_STEP { v } else { (v + parts / 2) / parts };
            let steps: Vec<i32> = values.iter().map(rounded).collect();
            out.push(VALUES_NODES_VOID);
            pack(&steps, Coder { searched: false, differences: false }, LEVEL_WITH_VOID, out);
            return steps.into_iter().map(|steps| self.of_steps(steps)).collect();
        }
        let cut: Vec<Part> = cut(nodes).collect();
        let of_part = |part: &Part| part.places(nodes).map(|place| values[place]).collect();
        let mut bricks: Vec<(&Template, Vec<i32>)> =
            cut.iter().map(|part| (Template::of_nodes(part.nodes), of_part(part))).collect();
        out.push(VALUES_NODES);
        brick::encode_nodes(&mut bricks, parts, self.most, out);
        for (part, (_, found)) in cut.iter().zip(bricks) {
            part.places(nodes).zip(found).for_each(|(place, value)| values[place] = value);
        }
        values
    }

    /// Reads the values of a brick with so many nodes along each axis.
    ///
    /// # Errors
    /// When the bytes are not such a brick.
    pub fn decode(&self, nodes: [u32; 3], bytes: &[u8]) -> Result<Vec<i32>, Malformed> {
        let mut c = Cursor::new(bytes);
        let codec = c.u8("codec")?;
        let mut values = vec![0; nodes.iter().product::<u32>() as usize];
        match codec {
            VALUES_NODES => {
                let cut: Vec<Part> = cut(nodes).collect();
                let templates: Vec<&Template> =
                    cut.iter().map(|part| Template::of_nodes(part.nodes)).collect();
                let found = brick::decode_nodes(&templates, c.rest(), self.quantiser.parts, self.most);
                let Some(found) = found else {
                    let expected = format!("{} values of a brick", values.len());
                    return Err(Malformed::new("values", expected, "other bytes"));
                };
                for (part, found) in cut.iter().zip(found) {
                    part.places(nodes).zip(found).for_each(|(place, value)| values[place] = value);
                }
            }
            VALUES_NODES_VOID => {
                unpacked(c.rest(), &mut values)?;
                values.iter_mut().for_each(|v| *v = self.of_steps(*v));
            }
            other => return Err(Malformed::new("codec", "one for nodes", other.to_string())),
        }
        Ok(values)
    }

    /// The parts of a number of steps, or void.
    fn of_steps(&self, steps: i32) -> i32 {
        let parts = self.quantiser.parts;
        if steps == VOID_STEP { steps } else { steps.saturating_mul(parts).clamp(0, self.most) }
    }

    /// The mean of nodes with such values; void where one of them is.
    pub fn mean(&self, nodes: impl ExactSizeIterator<Item = i32>) -> f32 {
        let parts = nodes.len() as f64 * f64::from(self.quantiser.parts);
        let sum = nodes.map(|v| if v == VOID_STEP { None } else { Some(i64::from(v)) }).sum::<Option<i64>>();
        let Quantiser { origin, step, .. } = self.quantiser;
        sum.map_or(f32::from_bits(VOID), |sum| (origin + sum as f64 / parts * step) as f32 + 0.0)
    }
}

/// A part of a brick that has a template.
struct Part {
    lo: [u32; 3],
    nodes: [u32; 3],
}

impl Part {
    /// The places of its nodes in a brick, x fastest.
    fn places(&self, brick: [u32; 3]) -> impl Iterator<Item = usize> {
        let [x, y, z] = std::array::from_fn(|a| self.lo[a]..self.lo[a] + self.nodes[a]);
        z.flat_map(move |z| {
            let x = x.clone();
            y.clone().flat_map(move |y| x.clone().map(move |x| ((z * brick[1] + y) * brick[0] + x) as usize))
        })
    }
}

/// Cuts a brick at the eighth node of each axis with more than nine, x fastest.
fn cut(nodes: [u32; 3]) -> impl Iterator<Item = Part> {
    const CUT: u32 = 8;
    let parts = nodes.map(|n| if n > CUT + 1 { 2 } else { 1 });
    (0..parts.iter().product::<u32>()).map(move |n| {
        let at = [n % parts[0], n / parts[0] % parts[1], n / parts[0] / parts[1]];
        let end = |a: usize| if at[a] + 1 == parts[a] { nodes[a] } else { CUT };
        let lo = at.map(|at| at * CUT);
        Part { lo, nodes: std::array::from_fn(|a| end(a) - lo[a]) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn coder(bits: f64) -> NodeCoder {
        NodeCoder::new(Quantiser { parts: PARTS, ..Quantiser::new(bits, [0.0, 100.0]) }).unwrap()
    }

    fn wave(i: usize) -> f32 {
        50.0 + 40.0 * (i as f32 / 40.0).sin() + ((i * 7919) % 13) as f32 / 10.0
    }

    #[test]
    fn bricks_come_back_within_half_a_step_and_damage_does_no_harm() {
        for (bits, nodes) in [(6.0, [16, 16, 16]), (4.5, [17, 8, 9]), (12.0, [3, 1, 5]), (20.0, [8, 8, 8])] {
            let coder = coder(bits);
            let step = coder.quantiser.step;
            let len = nodes.iter().product::<u32>() as usize;
            let samples: Vec<f32> = (0..len).map(wave).collect();
            let mut bytes = vec![];
            let values = coder.encode(nodes, &samples, &mut bytes);
            assert_eq!(coder.decode(nodes, &bytes).unwrap(), values);
            for (sample, &value) in samples.iter().zip(&values) {
                let off = f64::from(coder.mean([value].into_iter()) - sample).abs();
                assert!(off <= step * (0.5 + 1.0 / 32.0) + 1e-5, "{off} of {step}");
            }
            for cut in 0..bytes.len().min(60) {
                let _ = coder.decode(nodes, &bytes[..cut]);
            }
            for at in 0..bytes.len().min(200) {
                let mut bad = bytes.clone();
                bad[at] ^= 1 << (at % 8);
                if let Ok(values) = coder.decode(nodes, &bad) {
                    assert!(values.iter().all(|v| (0..=coder.most).contains(v)));
                }
            }
        }
    }

    #[test]
    fn whole_steps_come_back_exactly() {
        let coder = NodeCoder::new(Quantiser::new(8.0, [0.0, 255.0])).unwrap();
        let samples: Vec<f32> = (0..17 * 16 * 16).map(|i| wave(i).round()).collect();
        let mut bytes = vec![];
        let values = coder.encode([17, 16, 16], &samples, &mut bytes);
        assert_eq!(coder.decode([17, 16, 16], &bytes).unwrap(), values);
        assert!(samples.iter().zip(values).all(|(&sample, value)| coder.mean([value].into_iter()) == sample));
    }

    #[test]
    fn void_nodes_come_back() {
        let coder = coder(6.0);
        let mut samples: Vec<f32> = (0..512).map(wave).collect();
        (samples[3], samples[100]) = (f32::NAN, f32::NAN);
        let mut bytes = vec![];
        let values = coder.encode([8; 3], &samples, &mut bytes);
        assert_eq!(coder.decode([8; 3], &bytes).unwrap(), values);
        let void: Vec<usize> = (0..512).filter(|&i| coder.mean([values[i]].into_iter()).is_nan()).collect();
        assert_eq!(void, [3, 100]);
        assert!(coder.mean([values[0], values[3]].into_iter()).is_nan());
        let mean = coder.mean([values[0], values[1]].into_iter());
        let each = [0, 1].map(|i| coder.mean([values[i]].into_iter()));
        assert!((mean - (each[0] + each[1]) / 2.0).abs() < 1e-5);
    }

    #[test]
    fn noise_below_half_a_step_takes_few_bits() {
        // Wherever the mean lies between two steps.
        for mean in [50.0, 50.4, 50.8] {
            let coder = coder(6.0);
            let samples: Vec<f32> = (0..512).map(|i| mean + ((i * 7919) % 97) as f32 / 150.0).collect();
            let mut bytes = vec![];
            coder.encode([8; 3], &samples, &mut bytes);
            assert!(bytes.len() < 24, "{} bytes", bytes.len());
        }
    }

    #[test]
    fn too_many_steps_are_refused() {
        assert!(NodeCoder::new(Quantiser::new(0.5, [0.0, 1.0])).is_none());
        assert!(NodeCoder::new(Quantiser::new(20.5, [0.0, 1.0])).is_none());
        assert!(NodeCoder::new(Quantiser { parts: 3, ..Quantiser::new(8.0, [0.0, 1.0]) }).is_none());
    }
}
