//! Writes the head of an HDF5 file: everything but the bytes of its large datasets, which follow.
//!
//! All lengths are known before, so the head is final when it is written, and the file is a stream.
//!
//! ```text
//!  superblock             version 2: where the root group is, and where the file ends
//!  objects                headers of version 2, members before the group that links to them;
//!                         a small dataset's bytes, or a list of chunks, lie before its header
//!  large datasets         in the order of the tree: as they are, or as chunks that zlib compressed
//! ```
//!
//! Links lie in the headers of groups. All numbers are little-endian. The places of chunks are in a
//! fixed array of one page, which takes HDF5 1.10 to read; the rest takes 1.8.
//!
//! The format: "HDF5 File Format Specification Version 3.0", The HDF Group.

use crate::error::{Error, Result};
use crate::volume::ScalarType;

/// What a file begins with.
pub(in crate::formats) const SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";
/// An address of nothing.
const UNDEFINED: u64 = u64::MAX;

/// Kinds of messages in the headers of objects.
const DATASPACE: u8 = 1;
const LINK_INFO: u8 = 2;
const DATATYPE: u8 = 3;
const FILL_VALUE: u8 = 5;
const LINK: u8 = 6;
const LAYOUT: u8 = 8;
const GROUP_INFO: u8 = 10;
const FILTERS: u8 = 11;
const ATTRIBUTE: u8 = 12;

/// Small data: their type, their entries along each axis, their bytes.
pub struct Value {
    datatype: Vec<u8>,
    shape: Vec<u64>,
    bytes: Vec<u8>,
}

impl Value {
    /// A list of integers, `i64`.
    pub fn integers(list: &[i64]) -> Self {
        let bytes = list.iter().flat_map(|v| v.to_le_bytes()).collect();
        Self { datatype: number_type(ScalarType::I64), shape: vec![list.len() as u64], bytes }
    }

    /// One integer, `i64`.
    pub(in crate::formats) fn integer(number: i64) -> Self {
        Self { datatype: number_type(ScalarType::I64), shape: vec![], bytes: number.to_le_bytes().to_vec() }
    }

    /// A list of `f64`.
    pub fn floats(list: &[f64]) -> Self {
        let bytes = list.iter().flat_map(|v| v.to_le_bytes()).collect();
        Self { datatype: number_type(ScalarType::F64), shape: vec![list.len() as u64], bytes }
    }

    /// One word of ASCII, of exactly its length.
    pub(in crate::formats) fn word(word: &str) -> Self {
        Self { datatype: text_type(word.len(), 0), shape: vec![], bytes: word.into() }
    }

    /// A list of lines, UTF-8, filled up with zeros to the length of the longest.
    pub(in crate::formats) fn lines(lines: &[String]) -> Self {
        let width = lines.iter().map(String::len).max().unwrap_or(0).max(1);
        let filled = |line: &String| {
            let mut bytes = line.clone().into_bytes();
            bytes.resize(width, 0);
            bytes
        };
        let bytes = lines.iter().flat_map(filled).collect();
        Self { datatype: text_type(width, 1), shape: vec![lines.len() as u64], bytes }
    }
}

/// Where the bytes of a dataset are.
pub enum Data {
    /// In the head.
    Here(Vec<u8>),
    /// After it, so many.
    After(u64),
    /// After it, in chunks of so many rows, each of them compressed (zlib) to so many bytes. The
    /// last chunk is a full one too.
    Chunks {
        /// Rows of a chunk.
        rows: u64,
        /// Bytes of each compressed chunk.
        packed: Vec<u64>,
    },
}

/// A dataset.
pub struct Dataset {
    datatype: Vec<u8>,
    row_bytes: u64,
    shape: Vec<u64>,
    data: Data,
    attributes: Vec<(&'static str, Value)>,
}

impl Dataset {
    /// Numbers, `shape` of them along each axis, the slowest first.
    pub fn of(scalar: ScalarType, shape: &[u64], data: Data) -> Self {
        let row_bytes = shape[1..].iter().product::<u64>() * scalar.bytes() as u64;
        Self { datatype: number_type(scalar), row_bytes, shape: shape.to_vec(), data, attributes: vec![] }
    }

    /// Numbers after the head, as they are.
    pub fn after(scalar: ScalarType, shape: &[u64]) -> Self {
        let bytes = shape.iter().product::<u64>() * scalar.bytes() as u64;
        Self::of(scalar, shape, Data::After(bytes))
    }

    /// The same with an attribute.
    pub(in crate::formats) fn with(mut self, name: &'static str, value: Value) -> Self {
        self.attributes.push((name, value));
        self
    }
}

impl From<Value> for Dataset {
    fn from(value: Value) -> Self {
        let Value { datatype, shape, bytes } = value;
        Self { datatype, row_bytes: 0, shape, data: Data::Here(bytes), attributes: vec![] }
    }
}

enum GroupMember {
    Group(Group),
    Dataset(Dataset),
}

/// A group: its attributes, and its members, whose names differ.
#[derive(Default)]
pub struct Group {
    attributes: Vec<(&'static str, Value)>,
    members: Vec<(String, GroupMember)>,
}

impl Group {
    /// The same with an attribute.
    pub(in crate::formats) fn with(mut self, name: &'static str, value: Value) -> Self {
        self.attributes.push((name, value));
        self
    }

    /// Adds a dataset.
    pub fn add(&mut self, name: &str, dataset: impl Into<Dataset>) {
        self.members.push((name.into(), GroupMember::Dataset(dataset.into())));
    }

    /// Adds a group.
    pub fn add_group(&mut self, name: &str, group: Self) {
        self.members.push((name.into(), GroupMember::Group(group)));
    }

    /// The head of the file of which this is the root group.
    ///
    /// # Errors
    /// [`Error::Usage`] for a name of about 64 KiB or more.
    pub fn head(&self) -> Result<Vec<u8>> {
        // No length depends on an address.
        let length = self.head_before(0)?.len() as u64;
        self.head_before(length)
    }

    /// The head, where large datasets begin at the byte `next`.
    fn head_before(&self, next: u64) -> Result<Vec<u8>> {
        let mut objects = Objects { out: vec![0; 48], next };
        let root = objects.group(self)?;
        let Objects { mut out, next: end } = objects;
        let mut superblock = [SIGNATURE, &[2, 8, 8, 0]].concat();
        superblock.extend([0, UNDEFINED, end, root].iter().flat_map(|a| a.to_le_bytes()));
        out[..48].copy_from_slice(&checked(superblock));
        Ok(out)
    }
}

/// The objects of a head, which begins at byte 0 of its file.
struct Objects {
    out: Vec<u8>,
    /// Where the next large dataset begins.
    next: u64,
}

impl Objects {
    /// Appends bytes; tells where.
    fn put(&mut self, bytes: &[u8]) -> u64 {
        let at = self.out.len() as u64;
        self.out.extend_from_slice(bytes);
        at
    }

    fn group(&mut self, group: &Group) -> Result<u64> {
        let no_heap = [&[0, 0][..], &UNDEFINED.to_le_bytes(), &UNDEFINED.to_le_bytes()].concat();
        let mut messages = vec![(LINK_INFO, no_heap), (GROUP_INFO, vec![0, 0])];
        for (name, member) in &group.members {
            let address = match member {
                GroupMember::Group(group) => self.group(group)?,
                GroupMember::Dataset(dataset) => self.dataset(dataset)?,
            };
            let length = u16::try_from(name.len()).map_err(|_| too_long(name))?.to_le_bytes();
            // A hard link; its name is UTF-8, and the length of that has two bytes.
            let link = [&[1, 0x11, 1][..], &length, name.as_bytes(), &address.to_le_bytes()];
            messages.push((LINK, link.concat()));
        }
        self.header(messages, &group.attributes)
    }

    fn dataset(&mut self, dataset: &Dataset) -> Result<u64> {
        let mut messages = vec![
            (DATASPACE, dataspace(&dataset.shape)),
            (DATATYPE, dataset.datatype.clone()),
            // None, and space for it when it is asked for.
            (FILL_VALUE, vec![3, 0x0a]),
        ];
        let layout = match &dataset.data {
            Data::Chunks { packed, .. } if packed.is_empty() => contiguous(UNDEFINED, 0),
            Data::Chunks { rows, packed } => {
                // One filter, number 1 (zlib), without a name; its level is a hint.
                messages.push((FILTERS, vec![2, 1, 1, 0, 0, 0, 1, 0, 1, 0, 0, 0]));
                self.chunks(dataset, *rows, packed)
            }
            Data::Here(bytes) if !bytes.is_empty() => contiguous(self.put(bytes), bytes.len() as u64),
            Data::After(bytes) if *bytes > 0 => {
                self.next += bytes;
                contiguous(self.next - bytes, *bytes)
            }
            Data::Here(_) | Data::After(_) => contiguous(UNDEFINED, 0),
        };
        messages.push((LAYOUT, layout));
        self.header(messages, &dataset.attributes)
    }

    /// Appends the list of a dataset's chunks: a fixed array in one page.
    fn chunks(&mut self, dataset: &Dataset, rows: u64, packed: &[u64]) -> Vec<u8> {
        let chunk_bytes = rows * dataset.row_bytes;
        let (at, count) = (self.out.len() as u64, packed.len() as u64);
        // As many bytes as HDF5 takes for the size of a compressed chunk of this size.
        let size_bytes = (1 + (chunk_bytes.ilog2() as usize + 8) / 8).min(8);
        let page_bits = (u64::BITS - count.leading_zeros()).max(10) as u8;
        let header = [
            &b"FAHD\x00\x01"[..],
            &[12 + size_bytes as u8, page_bits],
            &count.to_le_bytes(),
            &(at + 28).to_le_bytes(),
        ];
        let mut block = [&b"FADB\x00\x01"[..], &at.to_le_bytes()].concat();
        for bytes in packed {
            block.extend_from_slice(&self.next.to_le_bytes());
            block.extend_from_slice(&bytes.to_le_bytes()[..size_bytes]);
            block.extend_from_slice(&[0; 4]);
            self.next += bytes;
        }
        self.put(&checked(header.concat()));
        self.put(&checked(block));
        // Layout 4, in chunks: rows, columns, and the size of an element, in no more bytes than the
        // largest takes, which HDF5 2.0 checks.
        let columns = &dataset.shape[1..];
        let element = dataset.row_bytes / columns.iter().product::<u64>();
        let sizes: Vec<u64> = [&[rows], columns, &[element]].concat();
        let width = sizes.iter().max().map_or(1, |most| most.ilog2() as usize / 8 + 1);
        let mut layout = vec![4, 2, 0, sizes.len() as u8, width as u8];
        sizes.iter().for_each(|n| layout.extend_from_slice(&n.to_le_bytes()[..width]));
        layout.extend([3, page_bits]);
        layout.extend(at.to_le_bytes());
        layout
    }

    /// Appends the header of an object.
    fn header(&mut self, mut messages: Vec<(u8, Vec<u8>)>, attributes: &[(&str, Value)]) -> Result<u64> {
        for (name, value) in attributes {
            let space = dataspace(&value.shape);
            let sizes = [name.len() + 1, value.datatype.len(), space.len()];
            let mut body = vec![3, 0];
            sizes.iter().for_each(|&n| body.extend((n as u16).to_le_bytes()));
            body.push(0);
            body.extend_from_slice(name.as_bytes());
            body.push(0);
            messages.push((ATTRIBUTE, [&body[..], &value.datatype, &space, &value.bytes].concat()));
        }
        let mut all = vec![];
        for (kind, body) in messages {
            let size = u16::try_from(body.len()).map_err(|_| too_long(&String::from_utf8_lossy(&body)))?;
            all.extend_from_slice(&[kind, size.to_le_bytes()[0], size.to_le_bytes()[1], 0]);
            all.extend_from_slice(&body);
        }
        // Version 2, and the size of the messages in four bytes.
        let size = u32::try_from(all.len()).map_err(|_| too_long("(of all)"))?;
        Ok(self.put(&checked([&b"OHDR\x02\x02"[..], &size.to_le_bytes(), &all].concat())))
    }
}

fn too_long(name: &str) -> Error {
    let begin: String = name.chars().filter(|c| !c.is_control()).take(40).collect();
    Error::usage(format!(
        "an HDF5 file takes names of at most 65 000 bytes; '{begin}…' is longer: write .vtp or .vtu"
    ))
}

/// The entries along each axis; none of one value.
fn dataspace(shape: &[u64]) -> Vec<u8> {
    let mut space = vec![2, shape.len() as u8, 0, u8::from(!shape.is_empty())];
    shape.iter().for_each(|n| space.extend(n.to_le_bytes()));
    space
}

fn contiguous(at: u64, bytes: u64) -> Vec<u8> {
    [&[3, 1][..], &at.to_le_bytes(), &bytes.to_le_bytes()].concat()
}

/// Text of a fixed length, filled up with zeros; the set of characters is 0 for ASCII, 1 for UTF-8.
fn text_type(bytes: usize, characters: u8) -> Vec<u8> {
    [&[0x13, characters << 4 | 1, 0, 0][..], &(bytes as u32).to_le_bytes()].concat()
}

/// A number as the machine has it: little-endian, all bits used, floats those of IEEE 754.
fn number_type(scalar: ScalarType) -> Vec<u8> {
    let bytes = scalar.bytes() as u8;
    let signed = matches!(scalar, ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64);
    // Bits of the exponent and of the mantissa, and the bias.
    let parts = match scalar {
        ScalarType::F16 => Some((5, 10, 15)),
        ScalarType::F32 => Some((8, 23, 127)),
        ScalarType::F64 => Some((11, 52, 1023u32)),
        _ => None,
    };
    let kind = match parts {
        None => [0x10, u8::from(signed) << 3, 0, 0],
        Some(_) => [0x11, 0x20, 8 * bytes - 1, 0],
    };
    let mut out = [&kind[..], &[bytes, 0, 0, 0], &[0, 0, 8 * bytes, 0]].concat();
    if let Some((exponent, mantissa, bias)) = parts {
        out.extend([mantissa, exponent, 0, mantissa]);
        out.extend(bias.to_le_bytes());
    }
    out
}

/// Bytes with their checksum.
fn checked(mut bytes: Vec<u8>) -> Vec<u8> {
    bytes.extend(lookup3(&bytes).to_le_bytes());
    bytes
}

/// The checksum of HDF5's metadata: `hashlittle` of Bob Jenkins' lookup3.c (2006), begun with 0.
fn lookup3(bytes: &[u8]) -> u32 {
    let begin = 0xdead_beefu32.wrapping_add(bytes.len() as u32);
    let [mut a, mut b, mut c] = [begin; 3];
    let mut rest = bytes;
    while !rest.is_empty() {
        let (now, later) = rest.split_at(rest.len().min(12));
        let mut block = [0; 12];
        block[..now.len()].copy_from_slice(now);
        let word = |i: usize| u32::from_le_bytes([0, 1, 2, 3].map(|k| block[4 * i + k]));
        a = a.wrapping_add(word(0));
        b = b.wrapping_add(word(1));
        c = c.wrapping_add(word(2));
        rest = later;
        if rest.is_empty() {
            for (x, y, turn) in
                [(2, 1, 14), (0, 2, 11), (1, 0, 25), (2, 1, 16), (0, 2, 4), (1, 0, 14), (2, 1, 24)]
            {
                let mut all = [a, b, c];
                all[x] = (all[x] ^ all[y]).wrapping_sub(all[y].rotate_left(turn));
                [a, b, c] = all;
            }
            break;
        }
        for (x, y, z, turn) in
            [(0, 2, 1, 4), (1, 0, 2, 6), (2, 1, 0, 8), (0, 2, 1, 16), (1, 0, 2, 19), (2, 1, 0, 4)]
        {
            let mut all = [a, b, c];
            all[x] = all[x].wrapping_sub(all[y]) ^ all[y].rotate_left(turn);
            all[y] = all[y].wrapping_add(all[z]);
            [a, b, c] = all;
        }
    }
    c
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_lookup3() {
        // The values that lookup3.c gives as examples, in its driver5.
        assert_eq!(lookup3(b""), 0xdead_beef);
        assert_eq!(lookup3(b"Four score and seven years ago"), 0x1777_0551);
    }

    /// More chunks than HDF5's usual page of a fixed array has.
    #[cfg(feature = "hdf5")]
    #[test]
    fn chunks_are_found() {
        use std::io::Write as _;
        let packed: Vec<Vec<u8>> = (0..1500i64)
            .map(|chunk| {
                let mut encoder = flate2::write::ZlibEncoder::new(vec![], flate2::Compression::fast());
                // Two rows of three numbers.
                (0..6).for_each(|k| encoder.write_all(&(6 * chunk + k).to_le_bytes()).unwrap());
                encoder.finish().unwrap()
            })
            .collect();
        let data = Data::Chunks { rows: 2, packed: packed.iter().map(|p| p.len() as u64).collect() };
        let mut group = Group::default();
        group.add("first", Dataset::after(ScalarType::U8, &[3]));
        group.add("chunks", Dataset::of(ScalarType::I64, &[2999, 3], data));
        group.add("last", Dataset::after(ScalarType::F32, &[1]));
        let file =
            [group.head().unwrap(), vec![1, 2, 3], packed.concat(), 7f32.to_le_bytes().into()].concat();
        let file = hdf5_reader::Hdf5File::from_vec(file).unwrap();
        let chunks = file.dataset("chunks").unwrap().read_array::<i64>().unwrap();
        assert_eq!(chunks.shape(), [2999, 3]);
        assert!(chunks.iter().copied().eq(0..3 * 2999));
        assert_eq!(file.dataset("first").unwrap().read_raw_bytes().unwrap(), [1, 2, 3]);
        assert_eq!(file.dataset("last").unwrap().read_raw_bytes().unwrap(), 7f32.to_le_bytes());
    }

    #[test]
    fn a_name_beyond_a_header_is_refused() {
        let mut group = Group::default();
        group.add(&"n".repeat(70_000), Value::integers(&[1]));
        assert!(group.head().unwrap_err().to_string().contains("names of at most"));
    }
}
