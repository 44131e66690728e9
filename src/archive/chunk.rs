//! The mesh of one chunk as blocks: a header with the vertices, then the tetrahedra, some hundred a block.
//!
//! **Vertices** have ids local to the chunk: first the core points, brick after brick, each brick's in the order in
//! which the point set enumerates them (along the Hilbert curve), then the halo points that some tetrahedron uses, by
//! ascending [`PointId`]. Ids and positions of core points cost nothing (the point set tells them from the counts); a
//! halo point costs a difference of ids, one or two bytes.
//!
//! **Blocks.** A tetrahedron belongs to its smallest local vertex. A block is a run of vertices with all their
//! tetrahedra: as ids follow the bricks and, inside a brick, the Hilbert curve, a block is compact in space, its (min, max) are
//! near each other, and few of its vertices are shared with other blocks.
//!
//! A block decodes on its own, in two steps: [`TetBlock::open`] tells its vertices ([`ChunkVertices`] gives their number, against which every id is
//! checked); [`TetBlock::decode`] takes their positions, which foretell most of the tetrahedra.

use super::star;
use super::tuples::{self, canonical};
use super::wire::{Cursor, Malformed, put_varint, to_zstd, unzstd};
use crate::geom::{LatticePos, PointId};
use crate::mesh::tet::Tet;

/// Codec of a header block: one zstd frame.
pub const HEADER_ZSTD: u8 = 0;
/// Codec of a tetrahedron block: sorted tuples, differences, zstd.
pub const TETS_TUPLES: u8 = 0;
/// Codec of a tetrahedron block: star after star.
pub const TETS_STARS: u8 = 1;
/// Compression level of headers: most of one are differences of ids, which no level shrinks much.
const HEADER_LEVEL: i32 = 3;
/// The most bytes of an expanded header.
pub const LARGEST_HEADER: usize = 1 << 28;

/// The vertices of a chunk's mesh.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChunkVertices {
    /// Points of each brick of the chunk, in brick order. Local ids run through them in this order.
    pub core_counts: Vec<u32>,
    /// Halo points in use, ascending; the local id of one is the number of core points plus its position here.
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
}

/// A chunk ready to be written.
#[derive(Clone, Debug, Default)]
pub struct EncodedChunk {
    /// Block 0 is the header, the others hold the tetrahedra.
    pub blocks: Vec<Vec<u8>>,
    /// All tetrahedra, block after block.
    tets: Vec<Tet>,
    /// First tetrahedron of each block, and the number of all.
    starts: Vec<u32>,
}

impl EncodedChunk {
    /// Number of tetrahedron blocks.
    pub fn tet_blocks(&self) -> usize {
        self.starts.len() - 1
    }

    /// The tetrahedra of tetrahedron block `n`, which is `blocks[n + 1]`, as its decoder gives them.
    pub fn block_tets(&self, n: usize) -> &[Tet] {
        &self.tets[self.starts[n] as usize..self.starts[n + 1] as usize]
    }

    /// The blocks, and all tetrahedra, block after block, as their decoders give them.
    pub fn into_parts(self) -> (Vec<Vec<u8>>, Vec<Tet>) {
        (self.blocks, self.tets)
    }

    /// The end of each tetrahedron block in the tetrahedra of all.
    pub fn block_ends(&self) -> Vec<usize> {
        self.starts[1..].iter().map(|&end| end as usize).collect()
    }
}

/// Turns each tetrahedron so that its smallest vertex comes first, and sorts by that; nothing is done where all are so already.
fn by_vertex(tets: Vec<Tet>, vertices: u32) -> Vec<Tet> {
    let mut before = 0;
    let in_order = |t: &Tet| {
        let before = std::mem::replace(&mut before, t[0]);
        (before <= t[0]) & (t[0] < t[1]) & (t[0] < t[2]) & (t[0] < t[3])
    };
    if tets.iter().all(in_order) {
        return tets;
    }
    let canonical: Vec<Tet> = tets.into_iter().map(canonical).collect();
    let mut places = vec![0u32; vertices as usize];
    canonical.iter().for_each(|t| places[t[0] as usize] += 1);
    let mut sum = 0;
    for n in &mut places {
        // Each count becomes its run's start; placing the tetrahedra moves it to the run's end.
        sum += std::mem::replace(n, sum);
    }
    let mut sorted = vec![[0; 4]; canonical.len()];
    for t in canonical {
        let at = &mut places[t[0] as usize];
        sorted[*at as usize] = t;
        *at += 1;
    }
    sorted
}

/// Cuts between runs of tetrahedra of one first vertex so that blocks have about `block_tets` tetrahedra.
fn block_starts(tets: &[Tet], block_tets: u32) -> Vec<u32> {
    let total = tets.len() as u32;
    let wanted = u64::from(total.div_ceil(block_tets)).max(1);
    let mut starts = vec![0];
    for i in 1..wanted {
        // The run that the goal is in, or ends.
        let goal = (u64::from(total) * i / wanted) as usize;
        let v = tets[goal - 1][0];
        let above = goal + tets[goal..].iter().take_while(|t| t[0] == v).count();
        let below = goal - tets[..goal].iter().rev().take_while(|t| t[0] == v).count();
        let cut = (if above - goal <= goal - below { above } else { below }) as u32;
        if cut > starts[starts.len() - 1] && cut < total {
            starts.push(cut);
        }
    }
    if total > 0 {
        starts.push(total);
    }
    starts
}

/// Turns meshes of chunks into blocks, with memory that it keeps from chunk to chunk.
#[derive(Default)]
pub struct ChunkEncoder(star::Writer);

impl ChunkEncoder {
    /// Turns a chunk's mesh into blocks of about `block_tets` tetrahedra; `positions` are those of the local vertices. The bytes depend on
    /// the *set* of tetrahedra, not on their order nor on how each is turned; least is to be done where the smallest vertex comes first in
    /// each, and they ascend by that.
    ///
    /// # Panics
    /// When a vertex id is not local, `positions` or `shared` is not as long as the vertices, the halo is not ascending, or `block_tets` is 0.
    pub fn encode(
        &mut self,
        vertices: &ChunkVertices,
        positions: &[LatticePos],
        tets: Vec<Tet>,
        block_tets: u32,
    ) -> EncodedChunk {
        assert!(block_tets > 0, "a block holds at least one tetrahedron");
        assert_eq!(positions.len(), vertices.len() as usize, "one position a vertex");
        assert_eq!(vertices.shared.len(), vertices.len() as usize, "one shared flag a vertex");
        let largest = tets.iter().fold(0, |most, t| t.iter().fold(most, |most, &v| most.max(v)));
        assert!(tets.is_empty() || largest < vertices.len(), "every vertex is local");
        let mut tets = by_vertex(tets, vertices.len());
        let starts = block_starts(&tets, block_tets);
        let mut blocks = vec![encode_header(vertices)];
        for w in starts.windows(2) {
            let tets = &mut tets[w[0] as usize..w[1] as usize];
            blocks.push(encode_tets(&mut self.0, tets, positions));
        }
        EncodedChunk { blocks, tets, starts }
    }
}

/// Encodes one block of tetrahedra, the smallest vertex first in each, ascending by it; leaves them as they will be decoded.
fn encode_tets(writer: &mut star::Writer, tets: &mut [Tet], positions: &[LatticePos]) -> Vec<u8> {
    let mut out = vec![TETS_STARS];
    if writer.encode(tets, positions, &mut out) {
        tets.copy_from_slice(writer.told());
    } else {
        out[0] = TETS_TUPLES;
        tets.iter_mut().for_each(|t| *t = canonical(*t));
        tets.sort_unstable();
        tuples::encode(tets, &mut out);
    }
    out
}

/// Memory that decoding blocks reuses.
#[derive(Default)]
pub struct TetScratch {
    stars: star::Scratch,
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
    Stars(star::Reader<'a>),
}

impl<'a> TetBlock<'a> {
    /// Reads the vertices of a block, each below `vertices` ([`ChunkVertices::len`]).
    ///
    /// # Errors
    /// When the bytes are not a block, or name a vertex that is not there.
    pub fn open(bytes: &'a [u8], vertices: u32) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        match c.u8("codec")? {
            TETS_TUPLES => {
                let mut tets = vec![];
                tuples::decode(c.rest(), vertices, &mut tets)?;
                Ok(Self { vertices: tuples::vertex_list(&tets), body: Body::Tuples(tets) })
            }
            TETS_STARS => {
                let mut ids = vec![];
                let reader = star::Reader::open(c.rest(), vertices, &mut ids)?;
                Ok(Self { vertices: ids, body: Body::Stars(reader) })
            }
            other => Err(Malformed::new("codec", "a known tetrahedron codec", other.to_string())),
        }
    }

    /// The local vertices of the block, ascending.
    pub fn vertices(&self) -> &[u32] {
        &self.vertices
    }

    /// Appends the tetrahedra to `out`, positively oriented, in the same order every time; `positions` are those of
    /// [`TetBlock::vertices`].
    ///
    /// # Errors
    /// When the bytes are not a block, or the positions not those that it was made with; `out` may then hold some tetrahedra, whose vertices are
    /// the block's.
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

    /// As [`TetBlock::decode`], with corners told by their places in [`TetBlock::vertices`].
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

fn encode_header(vertices: &ChunkVertices) -> Vec<u8> {
    let mut body = vec![];
    put_varint(&mut body, vertices.core_counts.len() as u64);
    vertices.core_counts.iter().for_each(|&n| put_varint(&mut body, u64::from(n)));
    put_varint(&mut body, vertices.halo.len() as u64);
    let mut next = 0;
    for id in &vertices.halo {
        put_varint(&mut body, id.0.checked_sub(next).expect("halo ids ascend"));
        next = id.0 + 1;
    }
    let core = &vertices.shared[..vertices.core_len() as usize];
    for eight in core.chunks(8) {
        body.push(eight.iter().enumerate().fold(0, |byte, (i, &bit)| byte | u8::from(bit) << i));
    }
    let mut out = vec![HEADER_ZSTD];
    out.extend(to_zstd(&body, HEADER_LEVEL));
    out
}

/// Reads a count and as many 32-bit numbers; each takes at least a byte, so a lying count is found first.
fn counted(c: &mut Cursor<'_>, at: &'static str) -> Result<Vec<u32>, Malformed> {
    let n = checked_count(c, at)?;
    (0..n).map(|_| c.varint32(at)).collect()
}

fn checked_count(c: &mut Cursor<'_>, at: &'static str) -> Result<usize, Malformed> {
    let n = c.varint32(at)? as usize;
    if n > c.rest().len() {
        return Err(Malformed::new(at, format!("at most {} numbers", c.rest().len()), n.to_string()));
    }
    Ok(n)
}

impl ChunkVertices {
    /// Decodes block 0 of a chunk, its header.
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
        let core_counts = counted(&mut c, "points of a brick")?;
        let n = checked_count(&mut c, "halo points")?;
        let mut halo = Vec::with_capacity(n);
        let mut next = Some(0u64);
        for _ in 0..n {
            let gap = c.varint("halo point")?;
            let id = next.and_then(|n| n.checked_add(gap));
            let id = id.ok_or_else(|| Malformed::new("halo point", "an id of 64 bits", "a larger one"))?;
            halo.push(PointId(id));
            next = id.checked_add(1);
        }
        let core = core_counts.iter().map(|&n| u64::from(n)).sum::<u64>();
        if core + n as u64 > u64::from(u32::MAX) {
            return Err(Malformed::new("vertices", "at most 2^32 - 1", (core + n as u64).to_string()));
        }
        let bits = c.take(core.div_ceil(8) as usize, "shared flags")?;
        c.end("chunk header")?;
        let mut shared: Vec<bool> = (0..core as usize).map(|i| bits[i / 8] >> (i % 8) & 1 == 1).collect();
        shared.resize(core as usize + n, true);
        Ok(Self { core_counts, halo, shared })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::geom::PointClass;

    /// A box of cubes, each cut in six tetrahedra around its diagonal, positively oriented; vertices x fastest.
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
    ) -> EncodedChunk {
        ChunkEncoder::default().encode(vertices, positions, tets.to_vec(), block_tets)
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

    fn decode(encoded: &EncodedChunk, positions: &[LatticePos]) -> (ChunkVertices, Vec<Tet>) {
        let header = ChunkVertices::decode(&encoded.blocks[0]).unwrap();
        let (mut all, mut scratch) = (vec![], TetScratch::default());
        let reopened = |bytes| TetBlock::open(bytes, header.len()).unwrap();
        for (n, bytes) in encoded.blocks[1..].iter().enumerate() {
            let before = all.len();
            let block = TetBlock::open(bytes, header.len()).unwrap();
            let here: Vec<LatticePos> = block.vertices().iter().map(|&v| positions[v as usize]).collect();
            block.decode(&here, &mut scratch, &mut all).unwrap();
            assert_eq!(&all[before..], encoded.block_tets(n), "in the same order, turned the same way");
            let (block, mut places) = (reopened(bytes), vec![]);
            let vertices = block.vertices().to_vec();
            block.decode_places(&here, &mut scratch, &mut places).unwrap();
            let named: Vec<Tet> = places.iter().map(|t| t.map(|p| vertices[p as usize])).collect();
            assert_eq!(named, all[before..]);
        }
        (header, all)
    }

    #[test]
    fn a_mesh_comes_back_whatever_the_block_size() {
        let tets = cubes([9, 7, 8]);
        let vertices = vertices_of(10 * 8 * 9);
        for block_tets in [1, 7, 100, 1000, 1_000_000] {
            let positions = corners([9, 7, 8]);
            let encoded = encode_chunk(&vertices, &positions, &tets, block_tets);
            assert_eq!(encoded.blocks.len(), encoded.tet_blocks() + 1);
            let (header, back) = decode(&encoded, &positions);
            assert_eq!(header, vertices);
            assert_eq!(sorted(&back), sorted(&tets));
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
        assert_eq!(one.blocks, encode_chunk(&vertices, &positions, &tets, 100).blocks);
    }

    #[test]
    fn no_tetrahedra_and_no_vertices_are_a_chunk_too() {
        let (header, tets) = decode(&encode_chunk(&ChunkVertices::default(), &[], &[], 1000), &[]);
        assert_eq!((header, tets.len()), (ChunkVertices::default(), 0));
        let (header, _) = decode(&encode_chunk(&vertices_of(10), &[[0; 3]; 10], &[], 1000), &[]);
        assert_eq!(header, vertices_of(10));
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
            assert_eq!(sorted(&decode(&encoded, &positions).1), sorted(tets));
            let mut other: Vec<Tet> = tets.iter().rev().map(|&[a, b, c, d]| [c, d, a, b]).collect();
            other.rotate_left(tets.len() / 2);
            assert_eq!(encode_chunk(&vertices_of(40), &positions, &other, 1000).blocks, encoded.blocks);
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
        let encoded = encode_chunk(&vertices_of(11 * 11 * 11), &corners([10; 3]), &cubes([10; 3]), 1000);
        assert_eq!(encoded.tet_blocks(), 6);
        for n in 0..6 {
            assert!((900..1100).contains(&encoded.block_tets(n).len()), "{}", encoded.block_tets(n).len());
        }
    }

    #[test]
    fn damaged_headers_never_panic() {
        let mut vertices = vertices_of(50);
        vertices.halo.push(PointId::new(PointClass::Corner, 7));
        vertices.shared.push(true);
        let positions = vec![[0; 3]; vertices.len() as usize];
        let good = encode_chunk(&vertices, &positions, &[], 10).blocks.remove(0);
        assert_eq!(ChunkVertices::decode(&good).unwrap(), vertices);
        for i in 0..good.len() {
            assert!(ChunkVertices::decode(&good[..i]).is_err());
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[i] ^= 1 << bit;
                let _ = ChunkVertices::decode(&bad);
            }
        }
        // A body without compression, so that the fields themselves are hit.
        let body = unzstd(&good[1..], 1 << 20, "body").unwrap();
        for i in 0..body.len() {
            for value in [0, 0x7f, 0x80, 0xff] {
                let mut bad = body.clone();
                bad[i] = value;
                let mut block = vec![HEADER_ZSTD];
                block.extend(to_zstd(&bad, 1));
                let _ = ChunkVertices::decode(&block);
            }
        }
    }
}
