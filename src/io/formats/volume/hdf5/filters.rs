//! Filters that HDF5 has as plugins.
//!
//! The registry:
//! <https://github.com/HDFGroup/hdf5_plugins/blob/master/docs/RegisteredFilterPlugins.md>.

use crate::formats::shared::codec::{bitshuffle, blosc, blosc2, lz4, lzf, read_to_end, unzstd};
use flate2::bufread::ZlibDecoder;
use hdf5_reader::error::Error;
use hdf5_reader::{FilterRegistry, filters::FILTER_DEFLATE};

/// What is read, for messages.
pub(super) const READ: &str =
    "filters that are read: deflate, shuffle, szip, LZF, LZ4, Zstandard, bitshuffle, Blosc, Blosc2";

/// Decodes a chunk, given the filter's settings, to at most so many bytes.
type Decode = fn(&[u8], &[u32], usize) -> Result<Vec<u8>, String>;

const FILTERS: [(u16, &str, Decode); 7] = [
    // The reader's own has no limit where a filter of ours is before it.
    (FILTER_DEFLATE, "deflate", |stored, _, limit| {
        let mut out = vec![];
        read_to_end(ZlibDecoder::new(stored), limit, &mut out)?;
        Ok(out)
    }),
    (32000, "LZF", |stored, _, limit| lzf::decode(stored, limit)),
    (32001, "Blosc", |stored, _, limit| {
        let mut out = vec![];
        blosc::decode(stored, limit, &mut out)?;
        Ok(out)
    }),
    (32004, "LZ4", |stored, _, limit| lz4::decode(stored, limit)),
    (32008, "bitshuffle", bitshuffle::decode),
    (32015, "Zstandard", |stored, _, limit| unzstd(stored, limit)),
    (32026, "Blosc2", |stored, _, limit| blosc2::decode(stored, limit)),
];

/// The filters of the reader, and ours, for chunks of at most so many bytes.
pub(super) fn registry(chunk_bytes: u64) -> FilterRegistry {
    // What is compressed a second time may be a little longer than a chunk.
    let limit = usize::try_from(chunk_bytes + chunk_bytes / 8 + (1 << 16)).unwrap_or(usize::MAX);
    let mut registry = FilterRegistry::new();
    for (number, name, decode) in FILTERS {
        registry.register(
            number,
            Box::new(move |filter, stored, _| {
                decode(stored, &filter.client_data, limit)
                    .map_err(|why| Error::DecompressionError(format!("{name}: {why}")))
            }),
        );
    }
    registry
}

/// Registered filters that are not read, by their numbers.
const UNREAD: [(&str, &str); 7] = [
    ("305", "LZO"),
    ("307", "bzip2"),
    ("32013", "ZFP"),
    ("32017", "SZ"),
    ("32018", "FCIDECOMP"),
    ("32024", "SZ3"),
    ("32028", "SPERR"),
];

/// The name of a filter that is not read.
pub(super) fn name_of_unread(number: &str) -> &'static str {
    UNREAD.iter().find(|(id, _)| *id == number).map_or("of another name", |(_, name)| name)
}
