//! One file of all meshes, in which each is found by three reads.
//!
//! ```text
//! for each minishard, where its index is                  16 bytes each
//! fragments of a mesh, its manifest, those of the next    as they come
//! index of each minishard: segments, offsets, bytes       24 bytes a mesh
//! ```
//!
//! A segment is in the minishard that its lowest bits say. A folder of two files for each of 10^5
//! labels would be slow to write, to copy and to serve.
//!
//! Source: "Sharded format" of neuroglancer's documentation.

use isospan_io::error::{Error, Result};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::PathBuf;

/// The name of the file.
pub(super) const NAME: &str = "0.shard";
/// Segments of a minishard, about; its index is read as a whole.
const OF_MINISHARD: usize = 1 << 10;

/// Where the manifest of a segment is.
struct Entry {
    segment: u64,
    /// From the end of the first index on.
    start: u64,
    end: u64,
}

/// The file on its way.
pub(super) struct Shard {
    path: PathBuf,
    file: BufWriter<File>,
    /// Bytes after the first index.
    bytes: u64,
    minishards: Vec<Vec<Entry>>,
}

impl Shard {
    /// A file for this many segments.
    pub(super) fn begin(path: PathBuf, file: File, segments: usize) -> Result<Self> {
        let minishards = (0..1 << bits(segments)).map(|_| vec![]).collect();
        let mut shard = Self { path, file: BufWriter::new(file), bytes: 0, minishards };
        let places = vec![0; shard.place_bytes()];
        shard.write(&places)?;
        Ok(shard)
    }

    fn place_bytes(&self) -> usize {
        16 * self.minishards.len()
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(|e| Error::io("write", &self.path, e))
    }

    /// Appends bytes; returns where they are.
    fn append(&mut self, bytes: &[u8]) -> Result<[u64; 2]> {
        self.write(bytes)?;
        let start = self.bytes;
        self.bytes += bytes.len() as u64;
        Ok([start, self.bytes])
    }

    /// Appends a fragment of the next segment.
    pub(super) fn put(&mut self, fragment: &[u8]) -> Result<()> {
        self.append(fragment).map(drop)
    }

    /// Ends a segment.
    pub(super) fn end_segment(&mut self, segment: u64, manifest: &[u8]) -> Result<()> {
        let [start, end] = self.append(manifest)?;
        let minishard = segment as usize & (self.minishards.len() - 1);
        self.minishards[minishard].push(Entry { segment, start, end });
        Ok(())
    }

    /// Writes the indices; returns the bytes of the file.
    pub(super) fn finish(mut self) -> Result<u64> {
        let mut places = vec![];
        for mut entries in std::mem::take(&mut self.minishards) {
            entries.sort_unstable_by_key(|entry| entry.segment);
            places.push(self.append(&index(&entries))?);
        }
        let numbers = places.iter().flatten().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>();
        let io = |e| Error::io("write", &self.path, e);
        self.file.seek(SeekFrom::Start(0)).map_err(io)?;
        self.file.write_all(&numbers).map_err(io)?;
        let file = self.file.into_inner().map_err(|e| io(e.into_error()))?;
        file.sync_all().map_err(io)?;
        Ok(self.bytes + numbers.len() as u64)
    }
}

/// The bits that choose a minishard.
fn bits(segments: usize) -> u32 {
    (segments / OF_MINISHARD).next_power_of_two().ilog2()
}

/// What `info` says of the file, for this many segments.
pub(super) fn sharding(segments: usize) -> Value {
    json!({
        "@type": "neuroglancer_uint64_sharded_v1",
        "hash": "identity",
        "preshift_bits": 0,
        "minishard_bits": bits(segments),
        "shard_bits": 0,
        "minishard_index_encoding": "raw",
        "data_encoding": "raw",
    })
}

/// The index of a minishard: what segments are more than those before them, where each begins after
/// the end of the one before, and their bytes.
fn index(entries: &[Entry]) -> Vec<u8> {
    let before = |n: usize| n.checked_sub(1).map(|n| &entries[n]);
    let all = || entries.iter().enumerate();
    let segments = all().map(|(n, entry)| entry.segment - before(n).map_or(0, |b| b.segment));
    // In the order of segments, offsets may go back: then the sum goes round, as readers' does.
    let starts = all().map(|(n, entry)| entry.start.wrapping_sub(before(n).map_or(0, |b| b.end)));
    let bytes = entries.iter().map(|entry| entry.end - entry.start);
    segments.chain(starts).chain(bytes).flat_map(u64::to_le_bytes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_are_found_by_two_indices() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(NAME);
        // Many segments, not in the order of their numbers.
        let count = 5000u64;
        let number = |n: u64| (n * 7919) % 100_003;
        let mut shard = Shard::begin(path.clone(), File::create(&path).unwrap(), count as usize).unwrap();
        for n in 0..count {
            shard.put(b"fragments").unwrap();
            shard.end_segment(number(n), format!("manifest {}", number(n)).as_bytes()).unwrap();
        }
        let bytes = shard.finish().unwrap();
        let data = std::fs::read(&path).unwrap();
        assert_eq!(data.len() as u64, bytes);
        let word = |at: usize| u64::from_le_bytes(data[at..at + 8].try_into().unwrap());
        let minishards = 1 << sharding(count as usize)["minishard_bits"].as_u64().unwrap();
        assert_eq!(minishards, 4);
        let (first, mut found) = (16 * minishards, 0);
        for minishard in 0..minishards {
            let [start, end] = [0, 8].map(|k| first + word(16 * minishard + k) as usize);
            let n = (end - start) / 24;
            let (mut segment, mut at) = (0, first as u64);
            for i in 0..n {
                let of_row = |row: usize| word(start + 8 * (row * n + i));
                segment += of_row(0);
                at = at.wrapping_add(of_row(1));
                let manifest = &data[at as usize..(at + of_row(2)) as usize];
                assert_eq!(manifest, format!("manifest {segment}").as_bytes());
                assert_eq!(segment as usize % minishards, minishard);
                at += of_row(2);
                found += 1;
            }
        }
        assert_eq!(found, count);
        assert_eq!([0, 1, 1024, 2048, 100_000].map(bits), [0, 0, 0, 1, 7]);
    }
}
