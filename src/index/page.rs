//! Pages of the index: their shape, which follows from the number of entries, and their bytes.

use super::Entry;
use crate::archive::Malformed;
use crate::archive::chunked::{BlockRange, RangeDecoder, RangeEncoder};
use crate::archive::wire::Cursor;
use std::collections::BTreeMap;

/// The most entries of a leaf page.
pub(crate) const LEAF_ENTRIES: u64 = 64;
/// Levels of halving in an inner page: at most 2^6 children.
pub(crate) const PAGE_LEVELS: u32 = 6;
/// First byte of a leaf page.
pub(crate) const LEAF: u8 = 0;
/// First byte of an inner page.
pub(crate) const INNER: u8 = 1;

/// Bounds of the entries below a node: the lowest min and the highest max.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    pub(super) lowest: f32,
    pub(super) highest: f32,
}

impl Bounds {
    /// The bounds of nothing: any entry widens them.
    pub(super) const NONE: Self = Self { lowest: f32::INFINITY, highest: f32::NEG_INFINITY };

    /// Takes an entry in. By the total order of bits: which of two zeros is the lowest must not
    /// depend on who comes first.
    pub(super) fn add(&mut self, e: &Entry) {
        if e.min.total_cmp(&self.lowest).is_lt() {
            self.lowest = e.min;
        }
        if e.max.total_cmp(&self.highest).is_gt() {
            self.highest = e.max;
        }
    }

    /// The bounds of some entries; zeros if there is none.
    pub(super) fn of(entries: &[Entry]) -> Self {
        let mut all = Self::NONE;
        entries.iter().for_each(|e| all.add(e));
        if entries.is_empty() { Self { lowest: 0.0, highest: 0.0 } } else { all }
    }
}

/// Sizes of the children of an inner page over `n` entries.
pub(super) fn child_sizes(n: u64) -> Vec<u64> {
    split_sizes(n, PAGE_LEVELS)
}

/// Sizes of the parts of `n` entries: halved, the smaller half first, until small enough or as
/// often as asked.
pub(super) fn split_sizes(n: u64, levels: u32) -> Vec<u64> {
    fn split(n: u64, levels: u32, out: &mut Vec<u64>) {
        if levels == 0 || n <= LEAF_ENTRIES {
            return out.push(n);
        }
        split(n / 2, levels - 1, out);
        split(n - n / 2, levels - 1, out);
    }
    let mut out = vec![];
    split(n, levels, &mut out);
    out
}

/// Number of pages of subtrees. On each level there are but two sizes, so few are ever computed.
#[derive(Debug, Default)]
pub(super) struct PageCounts(BTreeMap<u64, u64>);

impl PageCounts {
    pub(super) fn of(&mut self, n: u64) -> u64 {
        if n <= LEAF_ENTRIES {
            return 1;
        }
        if let Some(&pages) = self.0.get(&n) {
            return pages;
        }
        let pages = 1 + child_sizes(n).into_iter().map(|c| self.of(c)).sum::<u64>();
        self.0.insert(n, pages);
        pages
    }
}

/// Writes a leaf; entries are in order of place.
pub(super) fn encode_leaf(entries: &[Entry]) -> Vec<u8> {
    let (mut places, mut before) = (vec![], None);
    for e in entries {
        places.push(steps(before, e));
        before = Some(e);
    }
    let bits = |of: fn(&(u64, u64)) -> u64| 64 - places.iter().map(of).max().unwrap_or(0).leading_zeros();
    let (chunk_bits, block_bits) = (bits(|p| p.0), bits(|p| p.1));
    let mut out = vec![LEAF, chunk_bits as u8, block_bits as u8];
    let mut coder = RangeEncoder::begin(entries.iter().map(Entry::range), &mut out);
    for (e, (chunk, block)) in entries.iter().zip(places) {
        coder.number(chunk_bits, chunk);
        coder.number(block_bits, block);
        coder.push(e.range());
    }
    coder.finish(&mut out);
    out
}

/// The chunks from the entry before to an entry, and the blocks between the two, or before it in
/// another chunk.
fn steps(before: Option<&Entry>, e: &Entry) -> (u64, u64) {
    let (chunk, block) = before.map_or((0, None), |b| (b.chunk, Some(b.block)));
    let first = block.filter(|_| chunk == e.chunk).map_or(0, |b| u64::from(b) + 1);
    (e.chunk - chunk, u64::from(e.block) - first)
}

pub(super) fn decode_leaf(bytes: &[u8], n: u64) -> Result<Vec<Entry>, Malformed> {
    let mut c = Cursor::new(bytes);
    kind(&mut c, LEAF)?;
    let bits = [c.u8("bits of chunks")?, c.u8("bits of blocks")?].map(u32::from);
    if bits[0] > 64 || bits[1] > 32 {
        return Err(Malformed::new("bits of places", "at most 64 and 32", format!("{bits:?}")));
    }
    let mut coder = RangeDecoder::begin(&mut c)?;
    let mut entries: Vec<Entry> = vec![];
    for _ in 0..n {
        let [chunk, block] = bits.map(|bits| coder.number(bits));
        let before = entries.last().map_or((0, 0), |e| (e.chunk, u64::from(e.block) + 1));
        let first = if chunk == 0 { before.1 } else { 0 };
        let place = (before.0.checked_add(chunk), u32::try_from(first + block));
        let (Some(chunk), Ok(block)) = place else {
            return Err(Malformed::new("place", "numbers of 64 and 32 bits", "a larger one"));
        };
        let BlockRange { min, max, tets } = coder.pull()?;
        entries.push(Entry { min, max, chunk, block, tets });
    }
    coder.end()?;
    Ok(entries)
}

pub(super) fn encode_inner(children: &[Bounds]) -> Vec<u8> {
    let mut out = vec![INNER];
    children.iter().for_each(|b| out.extend(b.lowest.to_le_bytes()));
    children.iter().for_each(|b| out.extend(b.highest.to_le_bytes()));
    out
}

pub(super) fn decode_inner(bytes: &[u8], n: usize) -> Result<Vec<Bounds>, Malformed> {
    let mut c = Cursor::new(bytes);
    kind(&mut c, INNER)?;
    let mut column = || (0..n).map(|_| c.f32("bound")).collect::<Result<Vec<f32>, Malformed>>();
    let (lowest, highest) = (column()?, column()?);
    c.end("inner page")?;
    Ok(lowest.into_iter().zip(highest).map(|(lowest, highest)| Bounds { lowest, highest }).collect())
}

fn kind(c: &mut Cursor<'_>, expected: u8) -> Result<(), Malformed> {
    let got = c.u8("page kind")?;
    if got == expected {
        return Ok(());
    }
    Err(Malformed::new("page kind", expected.to_string(), got.to_string()))
}
