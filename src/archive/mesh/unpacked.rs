//! Unpacked blocks: all that a surface needs of each block of a step, in the form in which it is
//! used, in a segment that is mapped.
//!
//! The packed blocks of an archive take a few bits a tetrahedron and must be decoded; these take
//! some sixty bytes and are used where they lie. They are made on request, next to the segments,
//! and may be removed at any time: they hold nothing that is not in the segments.
//!
//! ```text
//!  zeros │ chunk 0: block 0, block 1, … │ chunk 1: … │ table: version, range, corners, blocks and numbered edges of each chunk
//! ```
//!
//! A block begins at a multiple of [`UNPACKED_ALIGNED`] bytes of the file and is as many
//! little-endian words as it says. A block without bytes exists only packed: it is out of the
//! range, or one of the few that are too large. The hash in the segment's header is that of the
//! segments that it was made of ([`unpacked_hash`]): it is never used with others.
//!
//! Often only a part of a block is read. So its words have checksums of their own. The code that
//! knows what is read checks these, and what the words hold, once, and notes that in
//! [`Unpacked::noted`]. [`Unpacked::verify`] checks all.

use crate::archive::segment::{
    BlockPlace, HEADER_BYTES, PlanHash, Segment, SegmentInfo, SegmentKind, SegmentWriter,
};
use crate::archive::wire::{Cursor, Malformed};
use crate::error::{Error, Result};
use crate::grid::ChunkId;
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::AtomicU64;
use xxhash_rust::xxh3::Xxh3Default;

/// The version of what the blocks hold.
pub(in crate::archive) const UNPACKED_VERSION: u32 = 1;
/// Blocks begin at multiples of this many bytes.
pub(in crate::archive) const UNPACKED_ALIGNED: usize = 64;
/// The most corners of a chunk for each of its blocks: what is allocated for them follows from a
/// file.
pub(in crate::archive) const UNPACKED_CORNERS: u64 = 8192;
/// Bytes of a chunk in the table.
const CHUNK_BYTES: usize = 12;
/// Bytes that each numbered edge has in some block, at least.
const EDGE_BYTES: u64 = 16;

/// What to do about a file that cannot be used.
const HELP: &str = "make it again with isospan unpack, or remove it with isospan unpack --remove";

/// The contents of a segment of unpacked blocks.
#[derive(Clone, Debug, PartialEq)]
pub struct UnpackedTable {
    /// The file has the blocks that isovalues in this range need.
    pub range: [f32; 2],
    /// All chunks, in order.
    pub chunks: Vec<UnpackedChunk>,
}

/// What is unpacked of a chunk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UnpackedChunk {
    /// Its corners.
    pub corners: u32,
    /// Its blocks.
    pub blocks: u32,
    /// Edges of several blocks that have numbers.
    pub edges: u32,
}

impl UnpackedTable {
    /// Whether the range holds all of these isovalues.
    pub fn answers(&self, isovalues: &[f32]) -> bool {
        let [low, high] = self.range;
        isovalues.iter().all(|v| (low..=high).contains(v))
    }

    fn encode(&self) -> Vec<u8> {
        let mut out = vec![];
        out.extend(UNPACKED_VERSION.to_le_bytes());
        self.range.iter().for_each(|v| out.extend(v.to_le_bytes()));
        for UnpackedChunk { corners, blocks, edges } in &self.chunks {
            [corners, blocks, edges].iter().for_each(|n| out.extend(n.to_le_bytes()));
        }
        out
    }

    /// The table of a file of `of_file` bytes.
    fn decode(bytes: &[u8], of_file: u64) -> std::result::Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        let version = c.u32("version")?;
        if version != UNPACKED_VERSION {
            return Err(Malformed::new("version", UNPACKED_VERSION.to_string(), version.to_string()));
        }
        let range = [c.f32("range")?, c.f32("range")?];
        let mut chunks = Vec::with_capacity(c.rest().len() / CHUNK_BYTES);
        while !c.rest().is_empty() {
            let [corners, blocks, edges] = [c.u32("corners")?, c.u32("blocks")?, c.u32("edges")?];
            // Both are allocated for.
            if blocks > 0 && u64::from(corners) > UNPACKED_CORNERS * u64::from(blocks) {
                let most = format!("at most {UNPACKED_CORNERS} a block");
                return Err(Malformed::new("corners of a chunk", most, format!("{corners} of {blocks}")));
            }
            if u64::from(edges) > of_file / EDGE_BYTES {
                let most = format!("at most those of {of_file} bytes");
                return Err(Malformed::new("edges of a chunk", most, edges.to_string()));
            }
            chunks.push(UnpackedChunk { corners, blocks, edges });
        }
        Ok(Self { range, chunks })
    }

    fn blocks(&self) -> u64 {
        self.chunks.iter().map(|c| u64::from(c.blocks)).sum()
    }
}

/// The hash of unpacked blocks that are made of segments with these contents, those of the mesh and
/// of the values, and of a step with this hash.
pub fn unpacked_hash<'a>(step: PlanHash, made_of: impl Iterator<Item = &'a SegmentInfo>) -> PlanHash {
    let mut hash = Xxh3Default::new();
    hash.update(step.to_string().as_bytes());
    for info in made_of {
        hash.update(&info.bytes.to_le_bytes());
        hash.update(&info.content_hash.to_le_bytes());
    }
    PlanHash(hash.digest128())
}

/// Writes unpacked blocks, chunk after chunk.
pub struct UnpackedWriter {
    segment: SegmentWriter,
    table: UnpackedTable,
}

impl UnpackedWriter {
    /// Begins the file that will be `path`, whose folder exists, with the blocks that isovalues in
    /// a range need.
    ///
    /// # Errors
    /// When the temporary file cannot be made; [`Error::Usage`] on a machine whose integers begin
    /// with the highest byte.
    pub fn create(path: &Path, hash: PlanHash, range: [f32; 2]) -> Result<Self> {
        expect_little_endian(path)?;
        let mut segment = SegmentWriter::create(path, SegmentKind::Unpacked, hash)?;
        segment.will_be_mapped();
        // The blocks behind it begin at a multiple of the alignment.
        segment.push_block(&[0; UNPACKED_ALIGNED - HEADER_BYTES as usize])?;
        Ok(Self { segment, table: UnpackedTable { range, chunks: vec![] } })
    }

    /// Appends the words of the blocks of the next chunk; no words for a block that exists only
    /// packed.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn push(&mut self, corners: u32, edges: u32, blocks: &[Vec<u32>]) -> Result<()> {
        for words in blocks {
            self.segment.push_block(bytemuck::cast_slice(words))?;
        }
        // Less than 2^32: they are counted by the index.
        self.table.chunks.push(UnpackedChunk { corners, edges, blocks: blocks.len() as u32 });
        Ok(())
    }

    /// Publishes the file.
    ///
    /// # Errors
    /// When it cannot be written, synced or renamed.
    pub fn finish(mut self) -> Result<SegmentInfo> {
        self.segment.push_block(&self.table.encode())?;
        self.segment.finish()
    }
}

/// Blocks are used where they lie: their bytes must be in the machine's order.
fn expect_little_endian(path: &Path) -> Result<()> {
    if cfg!(target_endian = "little") {
        return Ok(());
    }
    Err(Error::usage(format!(
        "{}: unpacked blocks are for machines whose integers begin with the lowest byte; isospan unpack --remove removes them",
        path.display()
    )))
}

/// An open file of unpacked blocks.
pub struct Unpacked {
    segment: Segment,
    table: UnpackedTable,
    /// The first block of each chunk, and behind the last.
    starts: Vec<u64>,
    /// For each chunk that was used, a number for each block.
    noted: Vec<OnceLock<Box<[AtomicU64]>>>,
}

/// A block of a file of unpacked blocks.
#[derive(Clone, Copy)]
pub struct UnpackedPlace<'a> {
    at: BlockPlace<'a>,
    chunk: usize,
    n: usize,
}

impl<'a> UnpackedPlace<'a> {
    /// Bytes of it; 0 of one that is to be had packed only.
    pub fn bytes(&self) -> u64 {
        self.at.len.into()
    }

    /// The words of a mapped file, not checked yet.
    pub(crate) fn at_hand(&self) -> Option<&'a [u32]> {
        self.at.bytes.and_then(|bytes| bytemuck::try_cast_slice(bytes).ok())
    }
}

impl Unpacked {
    /// Opens a file; reads header, footer and table. `None` if there is none.
    ///
    /// # Errors
    /// When it is damaged, or was made of other segments than those of `hash`, or of another number
    /// of chunks.
    pub fn open(path: &Path, hash: PlanHash, chunks: u64) -> Result<Option<Self>> {
        let segment = match Segment::map(path, SegmentKind::Unpacked, Some(hash)) {
            Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                return Ok(None);
            }
            segment => segment.map_err(helped)?,
        };
        expect_little_endian(path)?;
        let mut bytes = vec![];
        let bad = |at: &str, expected: String, got: String| {
            Err(Error::bad_input(path, at, expected, got).with_help(HELP))
        };
        let Some(blocks) = segment.block_count().checked_sub(2) else {
            return bad("block count", "at least 2".into(), segment.block_count().to_string());
        };
        segment.block(blocks + 1, &mut bytes).map_err(helped)?;
        let table = UnpackedTable::decode(&bytes, segment.info().bytes)
            .map_err(|m| helped(m.in_block(path, blocks + 1)))?;
        if table.chunks.len() as u64 != chunks || table.blocks() != blocks {
            let got = format!("{blocks} blocks of {} chunks", table.chunks.len());
            return bad("table", format!("{} blocks of {chunks} chunks", table.blocks()), got);
        }
        let mut starts = vec![1];
        for chunk in &table.chunks {
            starts.push(starts[starts.len() - 1] + u64::from(chunk.blocks));
        }
        let noted = table.chunks.iter().map(|_| OnceLock::new()).collect();
        Ok(Some(Self { segment, table, starts, noted }))
    }

    /// The contents of the segment.
    pub fn table(&self) -> &UnpackedTable {
        &self.table
    }

    /// The container.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// What is unpacked of a chunk.
    ///
    /// # Panics
    /// When there is no such chunk.
    pub fn chunk(&self, chunk: ChunkId) -> UnpackedChunk {
        self.table.chunks[chunk.0 as usize]
    }

    /// Appends the places of blocks of a chunk, by their numbers in it.
    ///
    /// # Errors
    /// When there is no such block, or the directory is damaged.
    ///
    /// # Panics
    /// When there is no such chunk.
    pub fn places<'a>(
        &'a self,
        chunk: ChunkId,
        blocks: impl Iterator<Item = u32> + Clone,
        out: &mut Vec<UnpackedPlace<'a>>,
    ) -> Result<()> {
        let (first, count) = (self.starts[chunk.0 as usize], self.chunk(chunk).blocks);
        if let Some(missing) = blocks.clone().find(|&n| n >= count) {
            let (at, expected) = (format!("chunk {}", chunk.0), format!("more than {missing} blocks"));
            return Err(
                Error::bad_input(self.segment.path(), at, expected, count.to_string()).with_help(HELP)
            );
        }
        let mut places = vec![];
        self.segment.places(blocks.clone().map(|n| first + u64::from(n)), &mut places).map_err(helped)?;
        let chunk = chunk.0 as usize;
        out.extend(places.into_iter().zip(blocks).map(|(at, n)| UnpackedPlace { at, chunk, n: n as usize }));
        Ok(())
    }

    /// The words of a block, where they lie and not checked yet, or in `buffer`.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn words<'a>(&self, place: &UnpackedPlace<'a>, buffer: &'a mut Vec<u32>) -> Result<&'a [u32]> {
        let BlockPlace { number, bytes, .. } = place.at;
        let Some(bytes) = bytes else { return self.read(number, buffer) };
        self.segment.count_used(bytes.len() as u64);
        bytemuck::try_cast_slice(bytes)
            .map_err(|_| self.blame(place, Malformed::new("place", "a multiple of 64 bytes", "another")))
    }

    /// The words of a block of a file that is not mapped.
    fn read<'a>(&self, number: u64, buffer: &'a mut Vec<u32>) -> Result<&'a [u32]> {
        let mut bytes = vec![];
        self.segment.block(number, &mut bytes).map_err(helped)?;
        buffer.clear();
        buffer.extend(bytes.as_chunks().0.iter().map(|&word| u32::from_le_bytes(word)));
        Ok(buffer)
    }

    /// The parts of a block that were found to be right; 0 in the beginning.
    pub fn noted(&self, place: &UnpackedPlace<'_>) -> &AtomicU64 {
        let blocks = self.table.chunks[place.chunk].blocks;
        let of_chunk =
            self.noted[place.chunk].get_or_init(|| (0..blocks).map(|_| AtomicU64::new(0)).collect());
        &of_chunk[place.n]
    }

    /// Whether the words that were used so far were the file's.
    ///
    /// # Errors
    /// When it has become shorter, or its device failed.
    pub fn check_mapped(&self) -> Result<()> {
        self.segment.check_mapped()
    }

    /// Reads all of it, and looks at each checksum.
    ///
    /// # Errors
    /// The first damage found.
    pub fn verify(&self) -> Result<()> {
        self.segment.verify().map_err(helped)
    }

    /// The error of a block whose words are wrong.
    pub fn blame(&self, place: &UnpackedPlace<'_>, what: Malformed) -> Error {
        helped(what.in_block(self.segment.path(), place.at.number))
    }
}

/// An error that says what is done about such a file.
fn helped(error: Error) -> Error {
    error.with_help(HELP)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::Ordering;

    const RANGE: [f32; 2] = [-1.5, f32::INFINITY];

    fn table() -> UnpackedTable {
        let chunk = |corners, blocks, edges| UnpackedChunk { corners, blocks, edges };
        UnpackedTable { range: RANGE, chunks: vec![chunk(100, 3, 20), chunk(7, 0, 0), chunk(9, 1, 5)] }
    }

    fn words(n: u32) -> Vec<u32> {
        (0..16 * n).map(|i| i * 7919).collect()
    }

    fn write(path: &Path, hash: PlanHash) {
        let mut out = UnpackedWriter::create(path, hash, RANGE).unwrap();
        for (chunk, blocks) in table().chunks.iter().zip([&[2, 0, 3][..], &[], &[1]]) {
            let blocks: Vec<Vec<u32>> = blocks.iter().map(|&n| words(n)).collect();
            out.push(chunk.corners, chunk.edges, &blocks).unwrap();
        }
        out.finish().unwrap();
    }

    #[test]
    fn blocks_come_back_where_they_lie() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("u.seg");
        let hash = PlanHash(7);
        assert!(Unpacked::open(&path, hash, 3).unwrap().is_none());
        write(&path, hash);
        let file = Unpacked::open(&path, hash, 3).unwrap().unwrap();
        assert_eq!((file.table(), file.chunk(ChunkId(2))), (&table(), table().chunks[2]));
        let (mut places, mut buffer) = (vec![], vec![]);
        file.places(ChunkId(0), 0..3, &mut places).unwrap();
        file.places(ChunkId(2), 0..1, &mut places).unwrap();
        for noted in [0, 5] {
            for (place, size) in places.iter().zip([2, 0, 3, 1]) {
                assert_eq!(place.bytes(), 64 * u64::from(size));
                let found = file.words(place, &mut buffer).unwrap();
                assert_eq!((found, place.at_hand()), (&*words(size), Some(&*words(size))));
                assert_eq!(found.as_ptr().addr() % UNPACKED_ALIGNED, 0);
                assert_eq!(file.noted(place).fetch_or(5, Ordering::Relaxed), noted);
            }
        }
        file.verify().unwrap();
        file.check_mapped().unwrap();
        assert!(file.places(ChunkId(1), 0..1, &mut places).is_err());
        let error = Unpacked::open(&path, PlanHash(8), 3).err().unwrap().to_string();
        assert!(error.contains("plan hash") && error.contains("isospan unpack --remove"), "{error}");
        assert!(Unpacked::open(&path, hash, 4).is_err());
    }

    #[test]
    fn a_damaged_byte_is_found_when_it_is_used() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("u.seg");
        let hash = PlanHash(7);
        write(&path, hash);
        let good = std::fs::read(&path).unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 1 << (at % 8);
            std::fs::remove_file(&path).unwrap();
            std::fs::write(&path, &bad).unwrap();
            let use_all = || -> Result<()> {
                let file = Unpacked::open(&path, hash, 3)?.expect("it is there");
                let mut places = vec![];
                file.places(ChunkId(0), 0..3, &mut places)?;
                places.iter().try_for_each(|place| file.words(place, &mut vec![]).map(drop))?;
                file.verify()
            };
            let error = use_all().expect_err("a flipped bit");
            assert_eq!(error.exit_code(), 5, "byte {at}: {error}");
            assert!(error.to_string().contains("isospan unpack"), "byte {at}: {error}");
        }
    }

    #[test]
    fn tables_that_lie_are_refused() {
        let good = table().encode();
        assert_eq!(UnpackedTable::decode(&good, 320).unwrap(), table());
        assert!(UnpackedTable::decode(&good, 319).is_err(), "20 edges");
        for cut in (0..good.len()).filter(|cut| cut % CHUNK_BYTES != 0) {
            assert!(UnpackedTable::decode(&good[..cut], 320).is_err());
        }
        for (at, byte) in [(0, 2), (15, 9), (23, 9)] {
            let mut bad = good.clone();
            bad[at] = byte;
            assert!(UnpackedTable::decode(&bad, 320).is_err(), "byte {at}");
        }
    }

    #[test]
    fn the_hash_is_that_of_all_it_was_made_of() {
        let info = |bytes, content_hash| SegmentInfo { bytes, blocks: 1, content_hash };
        let of = |step, infos: &[SegmentInfo]| unpacked_hash(PlanHash(step), infos.iter());
        let whole = of(1, &[info(1, 2), info(3, 4)]);
        assert_ne!(whole, of(2, &[info(1, 2), info(3, 4)]));
        assert_ne!(whole, of(1, &[info(1, 2), info(3, 5)]));
        assert_ne!(whole, of(1, &[info(1, 2), info(4, 4)]));
        assert_ne!(whole, of(1, &[info(1, 2)]));
    }
}
