//! What the last block of a chunk says about the chunk, so that the archive can be put together
//! without decoding it.
//!
//! In a mesh segment, it says how many tetrahedra the chunk owns, their volume, and how often its
//! halo was widened. In a value segment, it has the range of the values, and of every tetrahedron
//! block; the index of the step is built from these. Fixed fields, little-endian; see `FORMAT.md`.
//!
//! It also holds the ranges of the chunk's value blocks, by themselves. Where a surface does not
//! pass, a reader that knows on which side of it all values of a block are need not read them.

use super::ranges::{BlockRange, RangeDecoder, RangeEncoder, greater, lesser};
use crate::archive::values::ValueBlocks;
use crate::archive::wire::{Cursor, Malformed};
use isospan_mesh::simd::with_vectors;

/// The most blocks of a chunk.
const MOST_BLOCKS: u32 = 5_000_000;

/// Sizes of the mesh of a chunk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshSizes {
    /// Points that the chunk owns.
    pub core: u32,
    /// Points of other chunks that its tetrahedra use.
    pub halo: u32,
    /// Tetrahedron blocks; of a lattice, bricks.
    pub tet_blocks: u32,
    /// How often the halo was widened.
    pub retries: u32,
    /// Tetrahedra that the chunk owns.
    pub tets: u64,
}

/// The mesh of a chunk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshSummary {
    /// Its sizes.
    pub sizes: MeshSizes,
    /// The six-fold volume of its tetrahedra in lattice steps, exact.
    pub volume6: i128,
    /// The same for tetrahedra that would be the chunk's, but lie outside of the data and are not
    /// stored.
    pub outside6: i128,
}

impl MeshSummary {
    /// Encodes the summary as the bytes of a block: 56 of them.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = vec![];
        let MeshSizes { core, halo, tet_blocks, retries, tets } = self.sizes;
        [core, halo, tet_blocks, retries].iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(tets.to_le_bytes());
        out.extend(self.volume6.to_le_bytes());
        out.extend(self.outside6.to_le_bytes());
        out
    }

    /// From the bytes of a block.
    ///
    /// # Errors
    /// When the length is another.
    pub fn decode(bytes: &[u8]) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        let sizes = MeshSizes {
            core: c.u32("core points")?,
            halo: c.u32("halo points")?,
            tet_blocks: c.u32("tetrahedron blocks")?,
            retries: c.u32("retries")?,
            tets: c.u64("tetrahedra")?,
        };
        let summary = Self { sizes, volume6: c.i128("volume")?, outside6: c.i128("volume outside")? };
        c.end("mesh summary")?;
        Ok(summary)
    }
}

/// The values of a chunk.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ValueSummary {
    /// Void points among those that the chunk owns.
    pub void: u32,
    /// Least value of the points it owns; infinite if all are void.
    pub min: f32,
    /// Largest value of the points it owns.
    pub max: f32,
    /// Each tetrahedron block's.
    pub ranges: Vec<BlockRange>,
}

impl ValueSummary {
    /// The summary of the values of a chunk's own points and the ranges of its blocks.
    pub fn of(own: &[f32], mut ranges: Vec<BlockRange>) -> Self {
        BlockRange::round(&mut ranges);
        Self {
            void: own.iter().filter(|v| v.is_nan()).count() as u32,
            min: own.iter().copied().fold(f32::INFINITY, f32::min),
            max: own.iter().copied().fold(f32::NEG_INFINITY, f32::max),
            ranges,
        }
    }

    /// Encodes the summary as the bytes of a block: 12, then the ranges, compressed column by
    /// column.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = vec![];
        out.extend(self.void.to_le_bytes());
        out.extend(self.min.to_le_bytes());
        out.extend(self.max.to_le_bytes());
        out.extend((self.ranges.len() as u32).to_le_bytes());
        out.extend(encode_ranges(&self.ranges));
        out
    }

    /// From the bytes of a block.
    ///
    /// # Errors
    /// When the length is not that of a whole number of ranges.
    pub fn decode(bytes: &[u8]) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        let (void, min, max) = (c.u32("void points")?, c.f32("least value")?, c.f32("largest value")?);
        let count = c.u32("blocks")?;
        if count > MOST_BLOCKS {
            return Err(Malformed::new("blocks", format!("at most {MOST_BLOCKS}"), count.to_string()));
        }
        let ranges = decode_value_ranges(c.rest(), count as usize)?;
        Ok(Self { void, min, max, ranges })
    }
}

/// Least and largest of some values, voids left out; infinite if all are void: then the least is
/// above the largest.
pub type ValueRange = [f32; 2];

/// The ranges of the value blocks of a chunk with these values. They have the form
/// of those of tetrahedra: one of voids alone has none.
pub fn value_ranges(values: &[f32], blocks: &ValueBlocks) -> Vec<BlockRange> {
    let range = |[min, max]: ValueRange| BlockRange { min, max, tets: u32::from(min <= max) };
    with_vectors(
        #[inline(always)]
        || (0..blocks.count()).map(|n| range(value_range(&values[blocks.range(n)]))).collect(),
    )
}

/// The range of some values. Of two zeros it takes the first one, on every machine.
#[inline(always)]
fn value_range(values: &[f32]) -> ValueRange {
    const LANES: usize = 32;
    let (mut lo, mut hi) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
    let (rows, rest) = values.as_chunks();
    for &row in rows {
        (lo, hi) = (lesser(row, lo), greater(row, hi));
    }
    let lo = lo.iter().chain(rest).fold(f32::INFINITY, |lo, &v| if v < lo { v } else { lo });
    let hi = hi.iter().chain(rest).fold(f32::NEG_INFINITY, |hi, &v| if v > hi { v } else { hi });
    let first = |end: f32| if end == 0.0 { values.iter().copied().find(|v| *v == 0.0) } else { None };
    [first(lo).unwrap_or(lo), first(hi).unwrap_or(hi)]
}

/// The ranges of the blocks that are stored, rounded outwards, as the bytes of a block.
pub fn encode_value_ranges(values: &[f32], blocks: &ValueBlocks) -> Vec<u8> {
    let mut ranges = value_ranges(values, blocks);
    BlockRange::round(&mut ranges);
    encode_ranges(&ranges)
}

fn encode_ranges(ranges: &[BlockRange]) -> Vec<u8> {
    let mut out = vec![];
    let mut coder = RangeEncoder::begin(ranges.iter().copied(), &mut out);
    ranges.iter().for_each(|&range| coder.push(range));
    coder.finish(&mut out);
    out
}

/// The ranges of this number of value blocks.
///
/// # Errors
/// When the bytes are those of others.
pub fn decode_value_ranges(bytes: &[u8], blocks: usize) -> Result<Vec<BlockRange>, Malformed> {
    let mut coder = RangeDecoder::begin(&mut Cursor::new(bytes))?;
    let ranges = (0..blocks).map(|_| coder.pull()).collect::<Result<_, _>>()?;
    coder.end()?;
    Ok(ranges)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::values::BLOCK_VALUES;

    #[test]
    fn summaries_come_back() {
        let sizes = MeshSizes { core: 1, halo: 2, tet_blocks: 3, retries: 4, tets: 5 };
        let mesh = MeshSummary { sizes, volume6: -7 << 80, outside6: 8 << 80 };
        assert_eq!(MeshSummary::decode(&mesh.encode()).unwrap(), mesh);
        let ranges =
            vec![BlockRange { min: 1.0, max: 2.0, tets: 3 }, BlockRange { min: -4.0, max: 5.0, tets: 6 }];
        let values = ValueSummary::of(&[1.5, f32::NAN, -2.0], ranges);
        assert_eq!((values.void, values.min, values.max), (1, -2.0, 1.5));
        assert_eq!(ValueSummary::decode(&values.encode()).unwrap(), values);
        for n in 0..56 {
            assert!(MeshSummary::decode(&mesh.encode()[..n]).is_err());
        }
        assert!(ValueSummary::decode(&values.encode()[..20]).is_err());
    }

    #[test]
    fn ranges_of_value_blocks_come_back() {
        let mut values: Vec<f32> = (0..BLOCK_VALUES as u32 + 3).map(|i| i as f32).collect();
        values[0] = f32::NAN;
        let last = (BLOCK_VALUES + 2) as f32;
        let ends = [[1.0, BLOCK_VALUES as f32 - 1.0], [BLOCK_VALUES as f32, last]];
        let blocks = ValueBlocks::new(values.len());
        let ranges = value_ranges(&values, &blocks);
        assert_eq!(ranges, ends.map(|[min, max]| BlockRange { min, max, tets: 1 }));
        let bytes = encode_value_ranges(&values, &blocks);
        let found = decode_value_ranges(&bytes, 2).unwrap();
        for (range, [lo, hi]) in found.iter().zip(ends) {
            let most = (hi - lo) / 8.0;
            assert!((0.0..=most).contains(&(lo - range.min)) && (0.0..=most).contains(&(range.max - hi)));
        }
        assert!(decode_value_ranges(&bytes[..15], 2).is_err());
        let void = encode_value_ranges(&[f32::NAN; 3], &ValueBlocks::new(3));
        let none = BlockRange { min: f32::INFINITY, max: f32::NEG_INFINITY, tets: 0 };
        assert_eq!(decode_value_ranges(&void, 1).unwrap(), [none]);
    }

    #[test]
    fn ranges_are_those_of_values_taken_one_by_one() {
        let numbers = [0.0, -0.0, 1.5, f32::NAN, -3.0, 1e-45, -1e-45, f32::MAX, f32::INFINITY];
        let mut state = 7u32;
        for len in [1, 31, 32, 33, 100, BLOCK_VALUES, 3000] {
            for kinds in 1..=numbers.len() {
                let mut next = || {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    numbers[(state >> 16) as usize % kinds]
                };
                let values: Vec<f32> = (0..len).map(|_| next()).collect();
                let none = [f32::INFINITY, f32::NEG_INFINITY];
                let wider = |[lo, hi]: ValueRange, &v: &f32| {
                    [if v < lo { v } else { lo }, if v > hi { v } else { hi }]
                };
                let one_by_one = values.chunks(BLOCK_VALUES).map(|block| block.iter().fold(none, wider));
                let bits = |range: ValueRange| range.map(f32::to_bits);
                let expected: Vec<_> = one_by_one.map(bits).collect();
                let blocks = ValueBlocks::new(values.len());
                assert_eq!(
                    value_ranges(&values, &blocks).iter().map(|r| bits([r.min, r.max])).collect::<Vec<_>>(),
                    expected
                );
            }
        }
    }

    #[test]
    fn a_void_corner_takes_its_tetrahedron_out_of_the_range() {
        let values = [0.0, 1.0, 2.0, 3.0, f32::NAN];
        let range = BlockRange::of(&[[0, 1, 2, 3], [1, 2, 3, 4]], &values);
        assert_eq!(range, BlockRange { min: 0.0, max: 3.0, tets: 1 });
        assert_eq!(BlockRange::of(&[[4, 1, 2, 3]], &values).tets, 0);
    }
}
