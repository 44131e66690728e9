//! The coefficients of a whole array, and what they are as bytes.

use std::collections::HashMap;

use crate::correct::Correction;
use crate::error::Result;
use crate::lengths::encode_lengths;
use crate::levels::{NoTiles, TileSource};
use crate::pyramid::{Box3, Pyramid};
use crate::quantise::Scale;
use crate::tile::{Tile, tiles_of};
use crate::top::encode_top;
use crate::transform::{Scratch, Window};

pub(crate) const MAGIC: &[u8; 8] = b"isowave1";
/// Bytes before the lengths of tiles: magic, u32 sizes, u8 delays, a zero, f64 least and largest
/// sample, i32 exponent, f32 step, u32 bytes of the coarsest level, u32 bytes of lengths.
pub(crate) const HEADER: usize = 56;

/// The coefficients of a whole array.
pub(crate) struct Transformed {
    pub(crate) pyramid: Pyramid,
    pub(crate) delay: [u8; 3],
    pub(crate) window: Window,
}

impl Transformed {
    pub(crate) fn new(samples: &[f32], dims: [usize; 3], scale: &Scale, delay: [u8; 3]) -> Self {
        let pyramid = Pyramid::new(dims, delay);
        let entered = samples.iter().map(|s| scale.enter(f64::from(*s))).collect();
        let mut window = Window { place: Box3::all(dims), samples: entered };
        window.forward(pyramid.splits(), &mut Scratch::default());
        Self { pyramid, delay, window }
    }

    pub(crate) fn encode(&self, scale: &Scale) -> Result<Encoded> {
        encode_levels(&self.window, &self.pyramid, 0, scale, &mut NoTiles)
    }
}

/// What an encoder made.
pub(crate) struct Encoded {
    pub(crate) top: Vec<u8>,
    /// Bytes of each tile.
    pub(crate) lengths: Vec<u32>,
    pub(crate) tiles: Vec<u8>,
    /// The sum of the squared errors of coefficients, in squared steps.
    pub(crate) error: f64,
    /// How samples are corrected; the corrections are in the last tiles.
    pub(crate) correction: Correction,
}

impl Encoded {
    /// The whole array.
    pub(crate) fn bytes(&self, of: &Transformed, scale: &Scale) -> Vec<u8> {
        let lengths = encode_lengths(&self.lengths);
        let mut out = MAGIC.to_vec();
        of.pyramid.nodes(0).iter().for_each(|d| out.extend((*d as u32).to_le_bytes()));
        out.extend(of.delay);
        out.push(match self.correction {
            Correction::None => 0,
            Correction::Quanta(_) => 1,
            Correction::Whole => 2,
        });
        scale.range.iter().for_each(|r| out.extend(r.to_le_bytes()));
        out.extend(scale.exponent.to_le_bytes());
        out.extend(scale.step.to_le_bytes());
        out.extend((self.top.len() as u32).to_le_bytes());
        out.extend((lengths.len() as u32).to_le_bytes());
        if let Correction::Quanta(quantum) = self.correction {
            out.extend(quantum.to_le_bytes());
        }
        [&out, &self.top, &lengths, &self.tiles].into_iter().flatten().copied().collect()
    }
}

/// What a whole array takes with a step and a delay, with the worth of a bit in squared steps, as
/// bits. Errors are those of the coefficients.
pub(crate) fn price(
    samples: &[f32],
    dims: [usize; 3],
    scale: &Scale,
    delay: [u8; 3],
    bit: f64,
) -> Result<f64> {
    let made = Transformed::new(samples, dims, scale, delay).encode(scale)?;
    Ok(8.0 * (made.top.len() + made.tiles.len()) as f64 + made.error / bit)
}

/// Encodes all levels above one, of whose nodes a window has the coefficients.
pub(crate) fn encode_levels<S: TileSource>(
    window: &Window,
    pyramid: &Pyramid,
    from: usize,
    scale: &Scale,
    before: &mut S,
) -> std::result::Result<Encoded, S::Error> {
    let largest = window.samples.iter().fold(0.0, |most: f32, c| most.max(c.abs()));
    scale.expect_numbers_of(largest)?;
    let size = pyramid.nodes(pyramid.coarsest());
    let low = window.band(&pyramid.splits()[from..], [false; 3], &Box3::all(size));
    let low = low.into_iter().map(|c| scale.nearest(c)).collect::<Result<Vec<i32>>>()?;
    let top = encode_top(&low, size)?;
    let (mut lengths, mut tiles, mut error) = (vec![], vec![], 0.0);
    let mut above = HashMap::new();
    for level in (from + 1..=pyramid.coarsest()).rev() {
        let mut made = HashMap::new();
        for id in tiles_of(pyramid, level) {
            let coefficients = window.tile(pyramid, from, id, |c| scale.in_steps(c));
            let parent = above.get(&pyramid.parent(level, id.at));
            let before = before.tile(id)?;
            let (tile, bytes) = Tile::encode(pyramid, id, &coefficients, parent, before.as_deref())?;
            lengths.push(bytes.len() as u32);
            tiles.extend(bytes);
            error += tile.error(&coefficients);
            made.insert(id.at, tile);
        }
        above = made;
    }
    Ok(Encoded { top, lengths, tiles, error, correction: Correction::None })
}
