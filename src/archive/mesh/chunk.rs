//! The mesh of one chunk as blocks: the vertices ([`super::vertices`]), then the tetrahedra, some
//! hundred a block.
//!
//! **Blocks.** A tetrahedron belongs to its smallest local vertex. A block is a run of vertices
//! with all their tetrahedra. Ids follow the bricks and, inside a brick, the Hilbert curve, and
//! runs are cut with the same aim (`runs.rs`). So a block is compact in space, its min and max are
//! near each other, and it shares few vertices with other blocks.
//!
//! A block decodes on its own, in two steps: [`TetBlock::open`] gives its vertices
//! ([`ChunkVertices`] gives their number, against which every id is checked); [`TetBlock::decode`]
//! takes their positions, which predict most of the tetrahedra.

use super::connectivity;
use super::heads::BlockHead;
use super::runs::block_starts;
use super::tuples;
use super::vertices::ChunkVertices;
use crate::archive::wire::{Cursor, Malformed};
use isospan_io::geom::LatticePos;
use isospan_mesh::mesh::tet::{Tet, canonical};

/// Codec of a tetrahedron block: sorted tuples, differences, zstd.
pub(in crate::archive) const TETS_TUPLES: u8 = 0;
/// Codec of a tetrahedron block: star after star. The size of neighbourhoods is added.
pub(in crate::archive) const TETS_STARS: u8 = 1;

/// A chunk ready to be written.
#[derive(Clone, Debug, Default)]
pub struct EncodedChunk {
    /// The vertices' blocks, heads of the tetrahedra's, then these.
    pub blocks: Vec<Vec<u8>>,
    /// Of each tetrahedron block.
    pub heads: Vec<BlockHead>,
}

impl EncodedChunk {
    /// Number of tetrahedron blocks.
    pub fn tet_blocks(&self) -> usize {
        self.heads.len()
    }

    /// The tetrahedron blocks.
    pub fn blocks_of_tets(&self) -> &[Vec<u8>] {
        &self.blocks[self.blocks.len() - self.tet_blocks()..]
    }

    /// The end of each tetrahedron block in the tetrahedra of all.
    pub fn block_ends(&self) -> Vec<usize> {
        let end = |sum: &mut usize, head: &BlockHead| {
            *sum += head.tets as usize;
            Some(*sum)
        };
        self.heads.iter().scan(0, end).collect()
    }
}

/// Turns each tetrahedron so that its smallest vertex comes first, and sorts by that; nothing is
/// done where all are so already.
fn by_vertex(tets: &mut [Tet]) {
    let mut before = 0;
    let in_order = |t: &Tet| {
        let before = std::mem::replace(&mut before, t[0]);
        (before <= t[0]) & (t[0] < t[1]) & (t[0] < t[2]) & (t[0] < t[3])
    };
    if !tets.iter().all(in_order) {
        tets.iter_mut().for_each(|t| *t = canonical(*t));
        tets.sort_unstable();
    }
}

/// Turns meshes of chunks into blocks, with memory that it keeps from chunk to chunk.
#[derive(Default)]
pub struct ChunkEncoder(connectivity::Writer);

impl ChunkEncoder {
    /// Turns a chunk's mesh into blocks of about `block_tets` tetrahedra; `positions` are those of
    /// the local vertices. The bytes depend on the *set* of tetrahedra, not on their order nor on
    /// how each is turned; least is to be done where the smallest vertex comes first in each, and
    /// they ascend by that. Leaves the tetrahedra block after block, as their decoders give them.
    ///
    /// # Panics
    /// When a vertex id is not local, `positions` or `shared` is not as long as the vertices, or
    /// `block_tets` is 0.
    pub fn encode(
        &mut self,
        vertices: &ChunkVertices,
        positions: &[LatticePos],
        tets: &mut [Tet],
        block_tets: u32,
    ) -> EncodedChunk {
        assert!(block_tets > 0, "a block holds at least one tetrahedron");
        assert_eq!(positions.len(), vertices.len() as usize, "one position a vertex");
        assert_eq!(vertices.shared.len(), vertices.len() as usize, "one shared flag a vertex");
        let largest = tets.iter().fold(0, |most, t| t.iter().fold(most, |most, &v| most.max(v)));
        assert!(tets.is_empty() || largest < vertices.len(), "every vertex is local");
        by_vertex(tets);
        let starts = block_starts(tets, positions, block_tets);
        let heads = BlockHead::all(tets, &starts);
        let mut blocks = vertices.encode(heads.len() as u32);
        blocks.extend(BlockHead::encode(&heads, block_tets));
        for (head, w) in heads.iter().zip(starts.windows(2)) {
            let tets = &mut tets[w[0] as usize..w[1] as usize];
            blocks.push(encode_tets(&mut self.0, tets, head.first, positions));
        }
        EncodedChunk { blocks, heads }
    }
}

/// Encodes one block of tetrahedra, the smallest vertex first in each, ascending by it; leaves them
/// as they will be decoded.
fn encode_tets(
    writer: &mut connectivity::Writer,
    tets: &mut [Tet],
    own_from: u32,
    positions: &[LatticePos],
) -> Vec<u8> {
    let mut out = vec![];
    if writer.encode(tets, own_from, positions, &mut out) {
        // Sizes are far below 255: they stand for lengths below 2^24.
        out[0] += TETS_STARS;
        tets.copy_from_slice(writer.decoded());
    } else {
        out.push(TETS_TUPLES);
        tets.iter_mut().for_each(|t| *t = canonical(*t));
        tets.sort_unstable();
        tuples::encode(tets, &mut out);
    }
    out
}

/// Memory that decoding blocks reuses.
#[derive(Default)]
pub struct TetScratch {
    stars: connectivity::Scratch,
    /// 0, 1, 2, …
    count: Vec<u32>,
}

/// A tetrahedron block whose vertices are known, and that waits for their positions.
pub struct TetBlock<'a> {
    vertices: Vec<u32>,
    body: Body<'a>,
}

enum Body<'a> {
    Tuples(Vec<Tet>),
    Stars(connectivity::Reader<'a>),
}

impl<'a> TetBlock<'a> {
    /// Reads the vertices of a block with this head, each below `vertices`
    /// ([`ChunkVertices::len`]).
    ///
    /// # Errors
    /// When the bytes are not a block, or name a vertex that is not there.
    pub fn open(bytes: &'a [u8], head: &BlockHead, vertices: u32) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        match c.u8("codec")? {
            TETS_TUPLES => {
                let mut tets = vec![];
                tuples::decode(c.rest(), vertices, &mut tets)?;
                Ok(Self { vertices: tuples::vertex_list(&tets), body: Body::Tuples(tets) })
            }
            stars => {
                let (size, mut ids) = (stars - TETS_STARS, vec![]);
                let reader = connectivity::Reader::open(c.rest(), size, head, vertices, &mut ids)?;
                Ok(Self { vertices: ids, body: Body::Stars(reader) })
            }
        }
    }

    /// The local vertices of the block, ascending.
    pub fn vertices(&self) -> &[u32] {
        &self.vertices
    }

    /// Appends the tetrahedra to `out`, positively oriented, in the same order every time;
    /// `positions` are those of [`TetBlock::vertices`].
    ///
    /// # Errors
    /// When the bytes are not a block, or the positions not those that it was made with; `out` may
    /// then hold some tetrahedra, whose vertices are the block's.
    ///
    /// # Panics
    /// When there is not one position a vertex.
    pub fn decode(
        self,
        positions: &[LatticePos],
        scratch: &mut TetScratch,
        out: &mut Vec<Tet>,
    ) -> Result<(), Malformed> {
        assert_eq!(positions.len(), self.vertices.len(), "one position a vertex");
        match self.body {
            Body::Tuples(tets) => out.extend(tets),
            Body::Stars(reader) => reader.decode(&mut scratch.stars, &self.vertices, positions, out)?,
        }
        Ok(())
    }

    /// As [`TetBlock::decode`], with corners given by their places in [`TetBlock::vertices`].
    ///
    /// # Errors
    /// As [`TetBlock::decode`].
    ///
    /// # Panics
    /// As [`TetBlock::decode`].
    pub fn decode_places(
        self,
        positions: &[LatticePos],
        scratch: &mut TetScratch,
        out: &mut Vec<Tet>,
    ) -> Result<(), Malformed> {
        assert_eq!(positions.len(), self.vertices.len(), "one position a vertex");
        match self.body {
            Body::Tuples(tets) => {
                let place = |v| self.vertices.binary_search(&v).expect("the list has all vertices") as u32;
                out.extend(tets.iter().map(|t| t.map(place)));
            }
            Body::Stars(reader) => {
                let TetScratch { stars, count } = scratch;
                let known = count.len() as u32;
                count.extend(known..(positions.len() as u32).max(known));
                reader.decode(stars, &count[..positions.len()], positions, out)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::heads::PAGE_HEADS;
    use super::super::vertices::ChunkHeader;
    use super::*;
    use isospan_io::geom::PointId;

    /// A box of cubes, each cut in six tetrahedra around its diagonal, positively oriented;
    /// vertices x fastest.
    pub(crate) fn cubes(n: [u32; 3]) -> Vec<Tet> {
        const AROUND: [[u32; 3]; 6] = [[1, 3, 7], [3, 2, 7], [2, 6, 7], [6, 4, 7], [4, 5, 7], [5, 1, 7]];
        let (sx, sy) = (n[0] + 1, n[1] + 1);
        let mut tets = vec![];
        for z in 0..n[2] {
            for y in 0..n[1] {
                for x in 0..n[0] {
                    let corner = |c: u32| ((z + (c >> 2)) * sy + y + (c >> 1 & 1)) * sx + x + (c & 1);
                    tets.extend(AROUND.map(|[a, b, c]| [corner(0), corner(a), corner(b), corner(c)]));
                }
            }
        }
        tets
    }

    /// Where the corners of [`cubes`] are.
    pub(crate) fn corners(n: [u32; 3]) -> Vec<LatticePos> {
        let (sx, sy) = (n[0] + 1, n[1] + 1);
        (0..sx * sy * (n[2] + 1)).map(|i| [i % sx, i / sx % sy, i / sx / sy].map(|c| 1000 * c)).collect()
    }

    fn encode_chunk(
        vertices: &ChunkVertices,
        positions: &[LatticePos],
        tets: &[Tet],
        block_tets: u32,
    ) -> (EncodedChunk, Vec<Tet>) {
        let mut tets = tets.to_vec();
        (ChunkEncoder::default().encode(vertices, positions, &mut tets, block_tets), tets)
    }

    fn vertices_of(n: u32) -> ChunkVertices {
        let core = n * 4 / 5;
        ChunkVertices {
            core_counts: vec![core / 3, 0, core - core / 3],
            halo: (0..u64::from(n - core)).map(|i| PointId(i * i * 977 + 5)).collect(),
            shared: (0..n).map(|i| i >= core || i % 5 == 0).collect(),
        }
    }

    pub(crate) fn sorted(tets: &[Tet]) -> Vec<Tet> {
        let mut tets: Vec<Tet> = tets.iter().map(|&t| canonical(t)).collect();
        tets.sort_unstable();
        tets
    }

    /// Decodes a chunk, and compares it with the tetrahedra that its encoder left.
    fn decode((encoded, expected): &(EncodedChunk, Vec<Tet>), positions: &[LatticePos]) -> Vec<Tet> {
        let (mut all, mut scratch) = (vec![], TetScratch::default());
        let header = ChunkHeader::decode(&encoded.blocks[0]).unwrap();
        assert_eq!(header.tet_blocks as usize, encoded.tet_blocks());
        let pages = &encoded.blocks[header.blocks() - header.head_pages()..header.blocks()];
        let left = |n: usize| PAGE_HEADS.min(encoded.tet_blocks() - n * PAGE_HEADS);
        let page = |(n, bytes): (usize, &Vec<u8>)| {
            BlockHead::decode(bytes, left(n), positions.len() as u32).unwrap()
        };
        let heads: Vec<BlockHead> = pages.iter().enumerate().flat_map(page).collect();
        assert_eq!(heads, encoded.heads);
        for (n, bytes) in encoded.blocks_of_tets().iter().enumerate() {
            let (before, head) = (all.len(), &heads[n]);
            let open = |bytes| TetBlock::open(bytes, head, positions.len() as u32).unwrap();
            let block = open(bytes);
            let here: Vec<LatticePos> = block.vertices().iter().map(|&v| positions[v as usize]).collect();
            block.decode(&here, &mut scratch, &mut all).unwrap();
            assert_eq!(
                all[before..],
                expected[before..before + head.tets as usize],
                "in the same order, turned the same way"
            );
            let (block, mut places) = (open(bytes), vec![]);
            let vertices = block.vertices().to_vec();
            block.decode_places(&here, &mut scratch, &mut places).unwrap();
            let named: Vec<Tet> = places.iter().map(|t| t.map(|p| vertices[p as usize])).collect();
            assert_eq!(named, all[before..]);
        }
        all
    }

    #[test]
    fn a_mesh_comes_back_whatever_the_block_size() {
        let tets = cubes([9, 7, 8]);
        let vertices = vertices_of(10 * 8 * 9);
        for block_tets in [1, 7, 100, 1000, 1_000_000] {
            let positions = corners([9, 7, 8]);
            let encoded = encode_chunk(&vertices, &positions, &tets, block_tets);
            let blocks = encoded.0.tet_blocks() as u32;
            assert!(encoded.0.blocks.starts_with(&vertices.encode(blocks)));
            assert_eq!(sorted(&decode(&encoded, &positions)), sorted(&tets));
        }
    }

    #[test]
    fn bytes_depend_on_the_set_alone() {
        let mut tets = cubes([5, 5, 5]);
        let vertices = vertices_of(216);
        let positions = corners([5, 5, 5]);
        let one = encode_chunk(&vertices, &positions, &tets, 100);
        tets.reverse();
        tets.iter_mut().for_each(|t| *t = [t[2], t[3], t[0], t[1]]);
        assert_eq!(one.0.blocks, encode_chunk(&vertices, &positions, &tets, 100).0.blocks);
    }

    #[test]
    fn no_tetrahedra_and_no_vertices_are_a_chunk_too() {
        for n in [0, 10] {
            let (encoded, _) = encode_chunk(&vertices_of(n), &vec![[0; 3]; n as usize], &[], 1000);
            assert_eq!((encoded.tet_blocks(), &*encoded.blocks), (0, &*vertices_of(n).encode(0)));
        }
    }

    #[test]
    fn tetrahedra_that_are_no_mesh_come_back_too() {
        let mut state = 1u64;
        let mut next = |below: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % below) as u32
        };
        let positions: Vec<LatticePos> = (0..40).map(|_| [0; 3].map(|_: u32| next(1 << 20))).collect();
        let round_trip = |tets: &[Tet]| {
            let encoded = encode_chunk(&vertices_of(40), &positions, tets, 1000);
            assert_eq!(sorted(&decode(&encoded, &positions)), sorted(tets));
            let mut other: Vec<Tet> = tets.iter().rev().map(|&[a, b, c, d]| [c, d, a, b]).collect();
            other.rotate_left(tets.len() / 2);
            assert_eq!(encode_chunk(&vertices_of(40), &positions, &other, 1000).0.blocks, encoded.0.blocks);
        };
        for n in [1, 2, 10, 500, 3000] {
            let any: Vec<Tet> = std::iter::repeat_with(|| [0; 4].map(|_: u32| next(40)))
                .filter(|t| (1..4).all(|i| !t[..i].contains(&t[i])))
                .take(n)
                .collect();
            round_trip(&any);
        }
        let both: Vec<Tet> =
            cubes([2, 2, 2]).iter().flat_map(|&[a, b, c, d]| [[a, b, c, d], [b, a, c, d]]).collect();
        round_trip(&both);
        round_trip(&[[0, 1, 2, 3]; 3]);
    }

    #[test]
    fn blocks_are_near_the_size_asked_for() {
        let (encoded, _) = encode_chunk(&vertices_of(11 * 11 * 11), &corners([10; 3]), &cubes([10; 3]), 1000);
        assert!((5..8).contains(&encoded.tet_blocks()));
        for head in &encoded.heads {
            assert!((500..=1250).contains(&head.tets), "{head:?}");
        }
    }
}
