//! Compresses three-dimensional arrays of numbers by a wavelet transform.
//!
//! An array becomes the quantised coefficients of a CDF 9/7 wavelet transform of *all* of it. They
//! are coded in *tiles*, each of which is decoded by itself. So the transform sees across tiles,
//! and a small box, or a coarse level, is read without the rest.
//!
//! ```
//! use isospan_wavelet::{Accuracy, Box3, Compressed, Settings, compress};
//!
//! let samples: Vec<f32> = (0..64 * 64 * 64).map(|i| ((i % 64) as f32 * 0.1).sin()).collect();
//! let settings = Settings { accuracy: Accuracy::Rms(0.002), delay: None };
//! let bytes = compress(&samples, [64; 3], &settings)?;
//! let array = Compressed::new(&bytes, samples.len())?;
//! // Every second sample along each axis, nearly; and a box of samples.
//! let coarse = array.level(1)?;
//! let part = array.nodes(0, &Box3 { start: [10, 20, 30], size: [4, 4, 4] })?;
//! assert!((part[0] - samples[(30 * 64 + 20) * 64 + 10]).abs() < 0.02);
//! # assert_eq!(coarse.len(), array.pyramid().nodes(1).iter().product());
//! # Ok::<(), isospan_wavelet::Error>(())
//! ```
//!
//! A program that streams uses the parts: [`Pyramid`] says which levels, bands and tiles there are,
//! [`Window`] transforms a box with a halo, [`Tile`] encodes and decodes, [`Scale`] quantises. The
//! results are the same bits for any boxes, on any machine: all arithmetic is IEEE 754 or of whole
//! numbers, in a fixed order. `FORMAT.md` specifies every byte and every rounding.
//!
//! Labels, whole numbers that are names, are not transformed: [`encode_labels`] codes a tile of
//! them.
//!
//! Where samples are missing, [`fill()`] finds values that cost little, and a [`Mask`] tells where.
//!
//! Costs: a transform, its inverse, and coding take about 20 to 60 ns a sample altogether, each
//! way. An array is held in memory three times while it is compressed as a whole.

mod chunks;
mod correct;
mod decode;
mod delay;
mod encode;
mod error;
mod fill;
mod labels;
pub mod learn;
mod lengths;
mod levels;
mod mask;
mod model;
mod pyramid;
mod quantise;
mod range_coder;
mod refilter;
mod tables;
mod tile;
mod top;
mod transform;
mod vectors;
mod whole;

pub use chunks::{CHUNK, Coarse, PART, PartTiles, TileBlock, blocks_of, encode_part};
pub use correct::{Correction, decode_corrections, encode_corrections};
pub use decode::Compressed;
pub use delay::{boxes, choose_delay};
pub use encode::{Accuracy, Sampling, Settings, compress};
pub use error::{Error, Result};
pub use fill::fill;
pub use labels::{MOST_LABEL, decode_labels, encode_labels};
pub use levels::{Levels, NoTiles, TileSource, decode_tile};
pub use mask::{Mask, MaskBuilder};
pub use pyramid::{Band, Box3, GROUP, Pyramid, TILE};
pub use quantise::Scale;
pub use refilter::TAPS;
pub use tile::{Part, Tile, TileId};
pub use top::{decode_top, encode_top};
pub use transform::{HALO, HIGH, LIFTING, LOW, MARGIN, Scratch, UNDO_HIGH, UNDO_LOW, Window};
