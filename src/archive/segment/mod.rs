//! The container of everything binary: a file of numbered blocks, written once.
//!
//! ```text
//! header | block 0 | block 1 | … | directory pages | footer
//! ```
//!
//! Header and footer are of fixed size. Opening a segment reads nothing else, however many blocks
//! it has. The directory (length and CRC32C of each block) lies in pages that are read, checked and
//! kept the first time a block of theirs is asked for. So a block costs one read, and a damaged
//! byte is found when it is used, or by [`Segment::verify`]. A segment is *done* when header,
//! length and footer verify: a file cut short at any byte is not a segment.
//!
//! Every byte is specified in [the format](super#the-bytes).

mod copy;
mod frame;
mod journal;
mod positioned;
mod read;
mod write;

pub use self::copy::Copied;
pub(crate) use self::copy::{Known, copy_segment};
pub(super) use self::journal::{Journal, Record};
pub use self::read::Segment;
pub(crate) use self::read::segment_plan;
pub use self::write::SegmentWriter;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// First bytes of a segment. As in PNG, the high bit and the line ends show damage by a text-mode
/// transfer.
pub const MAGIC: [u8; 8] = *b"\x89ISO\r\n\x1a\n";
/// Last bytes but eight of a segment.
pub const END_MAGIC: [u8; 8] = *b"ISOEND\r\n";
/// The version this program writes.
pub const FORMAT_VERSION: u16 = 7;
/// That of manifests whose steps are in another order than their files, or have several fields.
pub const ORDERED_FORMAT: u16 = 8;
/// That of manifests of labels.
pub const LABELS_FORMAT: u16 = 9;
/// The oldest program version (in the same numbering) that can read what this program writes.
pub const OLDEST_READER: u16 = 7;
/// The oldest version that this program reads.
pub const OLDEST_FORMAT: u16 = 7;
/// Bytes of the header.
pub const HEADER_BYTES: u64 = 40;
/// Bytes of the footer.
pub const FOOTER_BYTES: u64 = 48;
/// Blocks described by a full directory page.
pub const PAGE_BLOCKS: u64 = 16;
/// Bytes of a directory page besides its entries: the offset of its first block before them, and
/// its checksum behind.
pub const PAGE_FRAME_BYTES: u64 = 12;
/// Bytes of a directory entry: length and checksum of a block.
pub const PAGE_ENTRY_BYTES: u64 = 8;
/// The most bytes of a block.
pub const LARGEST_BLOCK: u64 = 1 << 30;

/// What a segment holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum SegmentKind {
    /// Vertex tables and tetrahedra of a range of chunks.
    Mesh = 1,
    /// Values of a range of chunks, of one step.
    Values = 2,
    /// The span-space index of one step.
    Index = 3,
    /// The contour spectrum of one step.
    Spectrum = 4,
    /// A bricked copy of a volume.
    Bricks = 5,
    /// Points for which there is no formula.
    Points = 6,
    /// Coordinates of a rectilinear or curvilinear grid.
    Coordinates = 7,
    /// How dense the points are, cell by cell.
    Levels = 8,
    /// Duplicate vertices of a source mesh.
    Repeated = 9,
    /// What the chunks of a range add to sums over all, of one step that is not finished.
    Sums = 11,
    /// Low coefficients of a range of chunks of a pyramid, until its coarse levels are made.
    Low = 12,
    /// The coarse levels of a pyramid.
    Coarse = 13,
    /// Ranges and corrections of a range of chunks of a pyramid.
    Ranges = 14,
}

impl SegmentKind {
    fn name(code: u32) -> String {
        match code {
            1 => "mesh".into(),
            2 => "values".into(),
            3 => "index".into(),
            4 => "spectrum".into(),
            5 => "bricks".into(),
            6 => "points".into(),
            7 => "coordinates".into(),
            8 => "levels".into(),
            9 => "repeated vertices".into(),
            11 => "sums".into(),
            12 => "low coefficients".into(),
            13 => "coarse levels".into(),
            14 => "ranges".into(),
            other => format!("unknown kind {other}"),
        }
    }
}

/// The hash of everything that decides the bytes of a segment: files of different plans never mix.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PlanHash(pub u128);

impl PlanHash {
    /// The hash (XXH3, 128 bits) of the canonical text of a plan.
    pub fn of(canonical: &[u8]) -> Self {
        Self(xxhash_rust::xxh3::xxh3_128(canonical))
    }
}

impl fmt::Display for PlanHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

impl Serialize for PlanHash {
    fn serialize<S: Serializer>(&self, s: S) -> std::result::Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for PlanHash {
    fn deserialize<D: Deserializer<'de>>(d: D) -> std::result::Result<Self, D::Error> {
        let text = String::deserialize(d)?;
        let number = (text.len() == 32).then(|| u128::from_str_radix(&text, 16).ok()).flatten();
        number.map(Self).ok_or_else(|| serde::de::Error::custom("a plan hash has 32 hexadecimal digits"))
    }
}

/// A finished segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
pub struct SegmentInfo {
    /// Length of the file.
    pub bytes: u64,
    /// Number of blocks.
    pub blocks: u64,
    /// XXH3 (64 bits) of all bytes before the footer: two writers of the same segment agree on it.
    #[serde(with = "hex_hash")]
    pub content_hash: u64,
}

/// A 64-bit hash as text: a JSON number of that size loses digits in many programs.
mod hex_hash {
    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(hash: &u64, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(&format_args!("{hash:016x}"))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<u64, D::Error> {
        let text = String::deserialize(d)?;
        let number = (text.len() == 16).then(|| u64::from_str_radix(&text, 16).ok()).flatten();
        number.ok_or_else(|| serde::de::Error::custom("a content hash has 16 hexadecimal digits"))
    }
}

#[cfg(test)]
mod tests;
