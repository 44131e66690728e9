//! The archive: a folder of segments that are written once, and a manifest.
//!
//! * [`segment`]: the container, numbered blocks with checksums, published whole or not at all.
//! * [`mesh`]: the mesh of a chunk as blocks that decode on their own.
//! * [`values`]: the values of a chunk's points, as blocks.
//! * [`tables`]: what is stored once: coordinates, levels, listed points, sums of errors.
//! * [`chunked`]: segments of a range of chunks, with the counts and ranges of each.
//! * [`manifest`]: what the archive was made of and which segments it has; written last.
//!
//! The archive promises the following. A file under its name is complete, and was synced before it
//! got the name. A damaged byte is an error when it is read, never a wrong answer and never a
//! panic. The bytes of a file depend on its contents alone. It does not promise that the meaning of
//! a block was checked because its checksum was; for that see the checks of [`crate::pipeline`].
#![doc = include_str!("FORMAT.md")]

pub mod chunked;
#[doc(hidden)]
pub mod lock;
pub mod manifest;
pub mod mesh;
mod range_coder;
pub mod segment;
pub mod tables;
pub mod values;
pub(crate) mod wire;

pub use wire::Malformed;

#[cfg(test)]
mod tests {
    use super::mesh::{chunk, connectivity, heads, vertices};
    use super::tables::{coordinates, levels};
    use super::{manifest, segment, values};
    use crate::index::page;
    use crate::spectrum;
    use isospan_io::bytes::publish::TEMPORARY_MARK;

    /// The table at the end of FORMAT.md, and the bytes that it draws.
    #[test]
    fn the_document_has_the_constants_of_the_code() {
        let document = include_str!("FORMAT.md");
        let constants: &[(&str, u64)] = &[
            ("FORMAT_VERSION", u64::from(segment::FORMAT_VERSION)),
            ("ORDERED_FORMAT", u64::from(segment::ORDERED_FORMAT)),
            ("LABELS_FORMAT", u64::from(segment::LABELS_FORMAT)),
            ("OLDEST_READER", u64::from(segment::OLDEST_READER)),
            ("OLDEST_FORMAT", u64::from(segment::OLDEST_FORMAT)),
            ("HEADER_BYTES", segment::HEADER_BYTES),
            ("FOOTER_BYTES", segment::FOOTER_BYTES),
            ("PAGE_BLOCKS", segment::PAGE_BLOCKS),
            ("PAGE_FRAME_BYTES", segment::PAGE_FRAME_BYTES),
            ("PAGE_ENTRY_BYTES", segment::PAGE_ENTRY_BYTES),
            ("LARGEST_BLOCK", segment::LARGEST_BLOCK),
            ("LARGEST_HEADER", vertices::LARGEST_HEADER as u64),
            ("HEADER_ZSTD", u64::from(vertices::HEADER_ZSTD)),
            ("PAGE_FLAGS", vertices::PAGE_FLAGS as u64),
            ("PAGE_IDS", vertices::PAGE_IDS as u64),
            ("TETS_TUPLES", u64::from(chunk::TETS_TUPLES)),
            ("TETS_STARS", u64::from(chunk::TETS_STARS)),
            ("PAGE_HEADS", heads::PAGE_HEADS as u64),
            ("LARGEST_STARS", connectivity::LARGEST_STARS as u64),
            ("LARGEST_LIST", u64::from(connectivity::LARGEST_LIST)),
            ("LARGEST_LINK", connectivity::LARGEST_LINK as u64),
            ("BLOCK_CELLS", levels::BLOCK_CELLS as u64),
            ("BLOCK_VALUES", values::BLOCK_VALUES as u64),
            ("VALUES_RAW", u64::from(values::VALUES_RAW)),
            ("VALUES_PCO", u64::from(values::VALUES_PCO)),
            ("VALUES_QUANTISED", u64::from(values::VALUES_QUANTISED)),
            ("VALUES_AFTER", u64::from(values::VALUES_AFTER)),
            ("VALUES_AFTER_QUANTISED", u64::from(values::VALUES_AFTER_QUANTISED)),
            ("CHUNK_POINTS", manifest::CHUNK_POINTS),
            ("LONGEST_CHAIN", manifest::LONGEST_CHAIN),
            ("MOST_UNINDEXED", manifest::MOST_UNINDEXED),
            ("MOST_UNINDEXED_CHUNKS", manifest::MOST_UNINDEXED_CHUNKS),
            ("COORDINATES_AXES", u64::from(coordinates::COORDINATES_AXES)),
            ("COORDINATES_POINTS", u64::from(coordinates::COORDINATES_POINTS)),
            ("COORDINATES_RUN", coordinates::RUN),
            ("LEAF_ENTRIES", page::LEAF_ENTRIES),
            ("PAGE_LEVELS", u64::from(page::PAGE_LEVELS)),
            ("LEAF", u64::from(page::LEAF)),
            ("INNER", u64::from(page::INNER)),
            ("MOST_LEVELS", spectrum::MOST_LEVELS),
        ];
        for (name, value) in constants {
            let line = format!("| `{name}` | {value} |");
            assert!(document.lines().any(|l| l == line), "{line}");
        }
        let rows = document.lines().filter(|l| l.starts_with("| `")).count();
        assert_eq!(rows, constants.len(), "no constant of the document is unchecked");
        let magic = segment::MAGIC.map(|b| format!("{b:02X}")).join(" ");
        assert!(document.contains(&format!("`{magic}`")));
        assert!(document.contains(TEMPORARY_MARK));
    }
}
