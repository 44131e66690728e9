//! The vertices of a chunk: a small header that every question reads, and pages that are read only
//! if a block has a vertex in them.
//!
//! ```text
//!  header                points of each brick, numbers of halo points and of tetrahedron blocks
//!  pages of flags        8192 core points each: which of them other chunks have too
//!  pages of halo ids     those of the local vertices n · 1024 … n · 1024 + 1023: as the blocks of values
//!  pages of heads        of 256 tetrahedron blocks each (`heads`)
//! ```
//!
//! Vertices have ids local to the chunk: first the core points, brick after brick, each brick's in
//! the order in which the point set enumerates them (along the Hilbert curve), then the halo
//! points. Ids and positions of core points cost nothing: they follow from the point set and the
//! counts. The id of a halo point is stored, as the difference to the one before.
//!
//! A small surface touches a few blocks of a chunk, and these lie together. So do the halo points
//! of a page, and the values that come with them: [`order_halo`] sorts them along the curve first,
//! and only within a page by id, which keeps differences small.

use super::heads::PAGE_HEADS;
use crate::archive::values::BLOCK_VALUES;
use crate::archive::wire::{Cursor, Malformed, put_varint, to_zstd, unzstd};
use isospan_io::geom::curve::hilbert_key;
use isospan_io::geom::{LatticePos, PointId};
use std::ops::Range;

/// Codec of a header block: one zstd frame.
pub(in crate::archive) const HEADER_ZSTD: u8 = 0;
/// Core points of a page of flags.
pub const PAGE_FLAGS: usize = 8192;
/// Local vertices that a page of halo ids is about, from a multiple of it on.
pub const PAGE_IDS: usize = BLOCK_VALUES;
/// Compression level of headers and pages: most of one are differences of ids, which no level
/// shrinks much.
const LEVEL: i32 = 3;
/// The most bytes of an expanded header.
pub(in crate::archive) const LARGEST_HEADER: usize = 1 << 28;
/// The most bytes of an expanded page of ids: a varint has up to ten.
const LARGEST_IDS: usize = 10 * PAGE_IDS;
/// Bits an axis of the key by which halo points are sorted.
const ORDER_BITS: u32 = 16;

/// The vertices of a chunk's mesh.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChunkVertices {
    /// Points of each brick of the chunk, in brick order. Local ids run through them in this order.
    pub core_counts: Vec<u32>,
    /// Halo points in use; the local id of one is the number of core points plus its position here.
    /// Any order will do, that of [`order_halo`] does best.
    pub halo: Vec<PointId>,
    /// For each local vertex, whether another chunk has it too; always true for halo points.
    pub shared: Vec<bool>,
}

impl ChunkVertices {
    /// Number of core points.
    pub fn core_len(&self) -> u32 {
        self.core_counts.iter().sum()
    }

    /// Number of local vertices.
    pub fn len(&self) -> u32 {
        self.core_len() + self.halo.len() as u32
    }

    /// Whether there is no vertex.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The header of a chunk with so many blocks of tetrahedra, then the pages.
    pub(super) fn encode(&self, tet_blocks: u32) -> Vec<Vec<u8>> {
        let halo = self.halo.len() as u32;
        let header = ChunkHeader { core_counts: self.core_counts.clone(), halo, tet_blocks };
        let core = header.core_len();
        let flags = self.shared[..core].chunks(PAGE_FLAGS).map(|page| {
            let byte =
                |eight: &[bool]| eight.iter().enumerate().fold(0, |byte, (i, &b)| byte | u8::from(b) << i);
            to_zstd(&page.chunks(8).map(byte).collect::<Vec<u8>>(), LEVEL)
        });
        let ids = (0..header.id_pages()).map(|n| {
            let (mut body, mut before) = (vec![], 0u64);
            for id in &self.halo[header.ids_of(n)] {
                let step = id.0.wrapping_sub(before) as i64;
                put_varint(&mut body, (step << 1 ^ step >> 63) as u64);
                before = id.0;
            }
            to_zstd(&body, LEVEL)
        });
        std::iter::once(header.encode()).chain(flags).chain(ids).collect()
    }
}

/// Sorts halo points as they are stored: by place in runs of a page, within each by id. `core` is
/// the number of core points.
pub fn order_halo<T>(
    core: usize,
    halo: &mut [T],
    position: impl Fn(&T) -> LatticePos,
    id: impl Fn(&T) -> PointId,
) {
    halo.sort_by_cached_key(|point| (hilbert_key(position(point), ORDER_BITS), id(point)));
    let (first, rest) = halo.split_at_mut(halo.len().min(PAGE_IDS - core % PAGE_IDS));
    for page in std::iter::once(first).chain(rest.chunks_mut(PAGE_IDS)) {
        page.sort_unstable_by_key(&id);
    }
}

/// The part of a chunk's vertices that every question to the chunk needs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChunkHeader {
    /// Points of each brick of the chunk, in brick order.
    pub core_counts: Vec<u32>,
    /// Number of halo points.
    pub halo: u32,
    /// Number of tetrahedron blocks.
    pub tet_blocks: u32,
}

impl ChunkHeader {
    /// Number of core points.
    pub fn core_len(&self) -> usize {
        self.core_counts.iter().map(|&n| n as usize).sum()
    }

    /// Number of local vertices.
    pub fn len(&self) -> usize {
        self.core_len() + self.halo as usize
    }

    /// Whether there is no vertex.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Pages of flags, the blocks behind the header.
    pub fn flag_pages(&self) -> usize {
        self.core_len().div_ceil(PAGE_FLAGS)
    }

    /// Pages of halo ids, the blocks behind those.
    pub fn id_pages(&self) -> usize {
        if self.halo == 0 { 0 } else { self.len().div_ceil(PAGE_IDS) - self.core_len() / PAGE_IDS }
    }

    /// Pages of the heads of tetrahedron blocks, the blocks behind those.
    pub fn head_pages(&self) -> usize {
        (self.tet_blocks as usize).div_ceil(PAGE_HEADS)
    }

    /// Blocks of a chunk before those of its tetrahedra: this, and the pages.
    pub fn blocks(&self) -> usize {
        1 + self.flag_pages() + self.id_pages() + self.head_pages()
    }

    /// The halo points of a page.
    fn ids_of(&self, page: usize) -> Range<usize> {
        let (core, first) = (self.core_len(), self.core_len() / PAGE_IDS + page);
        let place = |vertex: usize| vertex.clamp(core, self.len()) - core;
        place(first * PAGE_IDS)..place((first + 1) * PAGE_IDS)
    }

    fn encode(&self) -> Vec<u8> {
        let mut body = vec![];
        put_varint(&mut body, self.core_counts.len() as u64);
        self.core_counts.iter().for_each(|&n| put_varint(&mut body, u64::from(n)));
        put_varint(&mut body, u64::from(self.halo));
        put_varint(&mut body, u64::from(self.tet_blocks));
        [vec![HEADER_ZSTD], to_zstd(&body, LEVEL)].concat()
    }

    /// Decodes block 0 of a chunk.
    ///
    /// # Errors
    /// When the bytes are not such a block.
    pub fn decode(bytes: &[u8]) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        let codec = c.u8("codec")?;
        if codec != HEADER_ZSTD {
            return Err(Malformed::new("codec", "a known header codec", codec.to_string()));
        }
        let body = unzstd(c.rest(), LARGEST_HEADER, "chunk header")?;
        let mut c = Cursor::new(&body);
        // A number takes at least a byte, so a lying count is found first.
        let n = c.varint32("bricks")? as usize;
        if n > c.rest().len() {
            return Err(Malformed::new(
                "bricks",
                format!("at most {} numbers", c.rest().len()),
                n.to_string(),
            ));
        }
        let core_counts = (0..n).map(|_| c.varint32("points of a brick")).collect::<Result<Vec<u32>, _>>()?;
        let halo = c.varint32("halo points")?;
        let tet_blocks = c.varint32("tetrahedron blocks")?;
        c.end("chunk header")?;
        let all = core_counts.iter().map(|&n| u64::from(n)).sum::<u64>() + u64::from(halo);
        if all > u64::from(u32::MAX) {
            return Err(Malformed::new("vertices", "at most 2^32 - 1", all.to_string()));
        }
        Ok(Self { core_counts, halo, tet_blocks })
    }
}

/// Decodes a page of flags, one for each of `out`.
///
/// # Errors
/// When the bytes are not such a page.
pub fn decode_flags(bytes: &[u8], out: &mut [bool]) -> Result<(), Malformed> {
    let bits = unzstd(bytes, PAGE_FLAGS / 8, "shared flags")?;
    if bits.len() != out.len().div_ceil(8) {
        let expected = format!("{} bytes", out.len().div_ceil(8));
        return Err(Malformed::new("shared flags", expected, bits.len().to_string()));
    }
    for (eight, byte) in out.chunks_mut(8).zip(bits) {
        (0..).zip(eight).for_each(|(i, flag)| *flag = byte >> i & 1 == 1);
    }
    Ok(())
}

/// Decodes a page of halo ids, one for each of `out`.
///
/// # Errors
/// When the bytes are not such a page.
pub fn decode_ids(bytes: &[u8], out: &mut [PointId]) -> Result<(), Malformed> {
    let body = unzstd(bytes, LARGEST_IDS, "halo points")?;
    let (mut c, mut before) = (Cursor::new(&body), 0u64);
    for id in out {
        let step = c.varint("halo point")?;
        before = before.wrapping_add(step >> 1 ^ (step & 1).wrapping_neg());
        *id = PointId(before);
    }
    c.end("halo points")
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan_io::geom::PointClass;

    fn vertices(core_counts: &[u32], halo: usize) -> ChunkVertices {
        let core = core_counts.iter().sum::<u32>() as usize;
        let id = |i: u64| PointId::new(PointClass::Interior, i.wrapping_mul(0x9E37_79B9) % (1 << 40));
        let mut halo: Vec<PointId> = (0..halo as u64).map(id).collect();
        if let Some(last) = halo.last_mut() {
            *last = PointId(u64::MAX);
        }
        let shared = (0..core + halo.len()).map(|i| i >= core || i % 7 == 0 && i % 1000 < 200).collect();
        ChunkVertices { core_counts: core_counts.to_vec(), halo, shared }
    }

    /// Reads all pages.
    fn decode(blocks: &[Vec<u8>]) -> Result<ChunkVertices, Malformed> {
        let header = ChunkHeader::decode(&blocks[0])?;
        let core = header.core_len();
        let (mut shared, mut halo) = (vec![true; header.len()], vec![PointId(0); header.halo as usize]);
        let (flags, ids) = blocks[1..].split_at(header.flag_pages());
        for (page, flags) in flags.iter().zip(shared[..core].chunks_mut(PAGE_FLAGS)) {
            decode_flags(page, flags)?;
        }
        assert_eq!(ids.len(), header.id_pages());
        for (n, page) in ids.iter().enumerate() {
            decode_ids(page, &mut halo[header.ids_of(n)])?;
        }
        Ok(ChunkVertices { core_counts: header.core_counts, halo, shared })
    }

    #[test]
    fn vertices_come_back() {
        for halo in [0, 1, 23, 24, 25, 1047, 1048, 1049, 5000] {
            for core in [&[][..], &[1000, 0], &[8000, 192], &[8193, 20_000, 3]] {
                let vertices = vertices(core, halo);
                assert_eq!(decode(&vertices.encode(0)).unwrap(), vertices);
            }
        }
    }

    #[test]
    fn pages_are_those_of_the_values() {
        for (core, halo) in [(0, 1024), (1000, 24), (1000, 25), (1024, 2048), (5, 1)] {
            let header = ChunkHeader { core_counts: vec![core], halo, tet_blocks: 0 };
            let blocks: Vec<usize> = (core..core + halo).map(|v| v as usize / BLOCK_VALUES).collect();
            let pages: Vec<usize> =
                (0..header.id_pages()).flat_map(|n| header.ids_of(n).map(move |_| n)).collect();
            assert_eq!(pages, blocks.iter().map(|b| b - blocks[0]).collect::<Vec<_>>());
        }
    }

    #[test]
    fn halo_points_of_a_page_lie_together() {
        let point = |i: u64| {
            let place = |shift: u32| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> shift) as u32 % (1 << 24);
            (PointId(i * 3), [place(5), place(17), place(33)])
        };
        let core = 500;
        let sort = |mut points: Vec<(PointId, LatticePos)>| {
            order_halo(core, &mut points, |p| p.1, |p| p.0);
            points
        };
        let sorted = sort((0..5000).map(point).collect());
        assert_eq!(sort((0..5000).rev().map(point).collect()), sorted, "whatever the order before");
        let mut last = 0;
        for page in 0..6 {
            let begin = if page == 0 { 0 } else { 1024 * page - core };
            let points = &sorted[begin..(1024 * (page + 1) - core).min(5000)];
            assert!(points.is_sorted(), "by id");
            let keys = || points.iter().map(|p| hilbert_key(p.1, ORDER_BITS));
            assert!(last <= keys().min().unwrap());
            last = keys().max().unwrap();
        }
        sort(vec![]);
    }

    #[test]
    fn damaged_pages_never_panic() {
        let good = vertices(&[20, 0, 30], 40).encode(0);
        for block in 0..good.len() {
            for i in 0..good[block].len() {
                let mut bad = good.clone();
                bad[block].truncate(i);
                // Two of three pages are none then; the last bytes of a frame may be missing from a
                // header alone.
                assert!(ChunkHeader::decode(&bad[0]).is_err() || decode(&bad).is_err());
                for bit in 0..8 {
                    let mut bad = good[block].clone();
                    bad[i] ^= 1 << bit;
                    let _ = ChunkHeader::decode(&bad);
                    let _ = decode_flags(&bad, &mut [false; 50]);
                    let _ = decode_ids(&bad, &mut [PointId(0); 40]);
                }
            }
        }
        // Bodies without compression, so that the fields themselves are hit.
        let body = unzstd(&good[0][1..], 1 << 20, "body").unwrap();
        for i in 0..body.len() {
            for value in [0, 0x7f, 0x80, 0xff] {
                let mut bad = body.clone();
                bad[i] = value;
                let _ = ChunkHeader::decode(&[vec![HEADER_ZSTD], to_zstd(&bad, 1)].concat());
            }
        }
        assert!(decode_flags(&good[1], &mut [false; 57]).is_err());
        assert!(decode_ids(&good[2], &mut [PointId(0); 39]).is_err());
        assert!(decode_ids(&good[2], &mut [PointId(0); 41]).is_err());
    }
}
