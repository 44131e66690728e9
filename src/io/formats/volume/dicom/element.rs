//! The elements of a data set: tags, lengths, sequences of items.
//!
//! ```text
//!  tag           VR           length             value
//!  group, number 2 letters    2 or 4 bytes       … or items, each a data set
//!  (0028,0010)   US           02 00              00 02
//! ```
//!
//! An implicit data set has no VR, and lengths of 4 bytes. A length of `ffff ffff` means that items
//! follow, up to a delimiter. Only the elements in [`WANTED`] are kept; others are passed over.

use crate::error::{Error, Place, Result};
use std::ops::Range;
use std::path::Path;

/// A tag: group and number.
pub(super) type Tag = u32;

pub(super) const TRANSFER_SYNTAX: Tag = 0x0002_0010;
pub(super) const CLASS: Tag = 0x0008_0016;
pub(super) const SERIES: Tag = 0x0020_000e;
pub(super) const POSITION: Tag = 0x0020_0032;
pub(super) const ORIENTATION: Tag = 0x0020_0037;
pub(super) const PLANE_POSITION: Tag = 0x0020_9113;
pub(super) const PLANE_ORIENTATION: Tag = 0x0020_9116;
pub(super) const SAMPLES: Tag = 0x0028_0002;
pub(super) const COLOURS: Tag = 0x0028_0004;
pub(super) const FRAMES: Tag = 0x0028_0008;
pub(super) const ROWS: Tag = 0x0028_0010;
pub(super) const COLUMNS: Tag = 0x0028_0011;
pub(super) const PIXEL_SPACING: Tag = 0x0028_0030;
pub(super) const ALLOCATED: Tag = 0x0028_0100;
pub(super) const STORED: Tag = 0x0028_0101;
pub(super) const HIGH_BIT: Tag = 0x0028_0102;
pub(super) const SIGNED: Tag = 0x0028_0103;
pub(super) const PADDING: Tag = 0x0028_0120;
pub(super) const PADDING_LIMIT: Tag = 0x0028_0121;
pub(super) const INTERCEPT: Tag = 0x0028_1052;
pub(super) const SLOPE: Tag = 0x0028_1053;
pub(super) const RESCALE_TYPE: Tag = 0x0028_1054;
pub(super) const LOOKUP: Tag = 0x0028_3000;
pub(super) const MEASURES: Tag = 0x0028_9110;
pub(super) const TRANSFORMATION: Tag = 0x0028_9145;
pub(super) const MAPPING: Tag = 0x0040_9096;
pub(super) const MAPPED_INTERCEPT: Tag = 0x0040_9224;
pub(super) const MAPPED_SLOPE: Tag = 0x0040_9225;
pub(super) const PET_UNITS: Tag = 0x0054_1001;
pub(super) const SEGMENTATION: Tag = 0x0062_0001;
pub(super) const MOST_FRACTION: Tag = 0x0062_000e;
pub(super) const DOSE_UNITS: Tag = 0x3004_0002;
pub(super) const DOSE_OFFSETS: Tag = 0x3004_000c;
pub(super) const DOSE_SCALING: Tag = 0x3004_000e;
pub(super) const SHARED: Tag = 0x5200_9229;
pub(super) const PER_FRAME: Tag = 0x5200_9230;
pub(super) const FLOATS: Tag = 0x7fe0_0008;
pub(super) const DOUBLES: Tag = 0x7fe0_0009;
pub(super) const PIXELS: Tag = 0x7fe0_0010;

/// What is kept, and whether it is a sequence.
#[rustfmt::skip]
const WANTED: [(Tag, bool); 39] = [
    (TRANSFER_SYNTAX, false), (CLASS, false), (SERIES, false), (POSITION, false),
    (ORIENTATION, false), (PLANE_POSITION, true), (PLANE_ORIENTATION, true), (SAMPLES, false), (COLOURS, false),
    (FRAMES, false), (ROWS, false), (COLUMNS, false), (PIXEL_SPACING, false), (ALLOCATED, false), (STORED, false),
    (HIGH_BIT, false), (SIGNED, false), (PADDING, false), (PADDING_LIMIT, false), (INTERCEPT, false),
    (SLOPE, false), (RESCALE_TYPE, false), (LOOKUP, true), (MEASURES, true), (TRANSFORMATION, true), (PET_UNITS, false), (SHARED, true), (PER_FRAME, true),
    (MAPPING, true), (MAPPED_SLOPE, false), (MAPPED_INTERCEPT, false), (SEGMENTATION, false), (MOST_FRACTION, false), (DOSE_UNITS, false), (DOSE_OFFSETS, false), (DOSE_SCALING, false),
    (FLOATS, false), (DOUBLES, false), (PIXELS, false),
];

const ITEM: Tag = 0xfffe_e000;
const END_OF_ITEM: Tag = 0xfffe_e00d;
const END_OF_SEQUENCE: Tag = 0xfffe_e0dd;
const UNDEFINED: u32 = u32::MAX;

/// Sequences in sequences.
const MOST_DEPTH: usize = 16;
/// Elements and items that are kept of a file: some twenty a frame.
const MOST_ELEMENTS: usize = 1 << 21;

/// How a data set is written.
#[derive(Clone, Copy, Debug)]
pub(super) struct DicomEncoding {
    pub(super) explicit: bool,
    pub(super) big_endian: bool,
}

/// Elements, in file order.
#[derive(Debug, Default)]
pub(super) struct DataSet(Vec<Element>);

#[derive(Debug)]
struct Element {
    tag: Tag,
    /// The bytes of its value.
    value: Range<usize>,
    is_bytes: bool,
    items: Vec<DataSet>,
}

/// The bytes of a file, and how those of the data set are read.
pub(super) struct Reader<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    encoding: DicomEncoding,
    kept: usize,
}

impl<'a> Reader<'a> {
    pub(super) fn new(path: &'a Path, bytes: &'a [u8], encoding: DicomEncoding) -> Self {
        Self { path, bytes, encoding, kept: 0 }
    }

    /// The elements of group 2, which are always explicit and little-endian, and where they end.
    pub(super) fn meta(&mut self, start: usize) -> Result<(DataSet, usize)> {
        let (mut at, mut out) = (start, DataSet::default());
        while self.bytes.len() > at + 4 && self.tag(at)? >> 16 == 2 {
            self.element(&mut at, self.bytes.len(), 0, &mut out)?;
        }
        Ok((out, at))
    }

    /// The elements from `start` on, up to the samples, which are the last one.
    pub(super) fn data_set(&mut self, start: usize) -> Result<DataSet> {
        let (mut at, mut out) = (start, DataSet::default());
        while at < self.bytes.len() {
            let tag = self.tag(at)?;
            self.element(&mut at, self.bytes.len(), 0, &mut out)?;
            if [FLOATS, DOUBLES, PIXELS].contains(&tag) {
                break;
            }
        }
        Ok(out)
    }

    /// Reads an element that ends at `end` at the latest, and keeps it where it is wanted.
    fn element(&mut self, at: &mut usize, end: usize, depth: usize, out: &mut DataSet) -> Result<()> {
        let (start, tag) = (*at, self.tag(*at)?);
        *at += 4;
        let (vr, length) = self.length(at, start)?;
        let wanted = WANTED.iter().find(|(t, _)| *t == tag).map(|&(_, is_sequence)| is_sequence);
        let is_pixels = tag == PIXELS && depth == 0;
        let from = *at;
        if length == UNDEFINED && is_pixels {
            // Compressed frames: the caller refuses what has no bytes.
            return self.keep(out, Element { tag, value: from..from, is_bytes: false, items: vec![] });
        }
        let stop = match length {
            UNDEFINED => None,
            length => {
                Some(from.checked_add(length as usize).filter(|&stop| stop <= end).ok_or_else(|| {
                    let got = format!(
                        "{length} bytes of element {}, {} to the end",
                        shown(tag),
                        end - from.min(end)
                    );
                    self.bad(start, "a value within its file and item", got)
                })?)
            }
        };
        let is_sequence = wanted == Some(true) && (vr.is_none() || vr == Some(*b"SQ") || vr == Some(*b"UN"));
        let mut items = vec![];
        if is_sequence || stop.is_none() {
            if stop.is_none() && !matches!(vr, None | Some([b'S', b'Q'] | [b'U', b'N'])) {
                return Err(self.bad(start, "a length", format!("none of element {}", shown(tag))));
            }
            let (usual, kept) = (self.encoding, self.kept);
            if vr == Some(*b"UN") {
                // What a writer did not know is kept as it came: implicit and little-endian.
                self.encoding = DicomEncoding { explicit: false, big_endian: false };
            }
            items = self.items(at, stop, end, depth + 1)?;
            self.encoding = usual;
            if !is_sequence {
                self.kept = kept;
            }
        }
        *at = stop.unwrap_or(*at);
        if wanted.is_none() || wanted == Some(true) && !is_sequence {
            return Ok(());
        }
        self.keep(out, Element { tag, value: from..*at, is_bytes: vr == Some(*b"OB"), items })
    }

    fn keep(&mut self, out: &mut DataSet, element: Element) -> Result<()> {
        self.count(element.value.start)?;
        out.0.push(element);
        Ok(())
    }

    /// Counts an element or an item.
    fn count(&mut self, at: usize) -> Result<()> {
        self.kept += 1;
        if self.kept > MOST_ELEMENTS {
            let expected = format!("at most {MOST_ELEMENTS} elements and items that describe frames");
            return Err(self.bad(at, &expected, "more".into()));
        }
        Ok(())
    }

    /// The items of a sequence, which ends at `stop` or with a delimiter before `end`.
    fn items(
        &mut self,
        at: &mut usize,
        stop: Option<usize>,
        end: usize,
        depth: usize,
    ) -> Result<Vec<DataSet>> {
        if depth > MOST_DEPTH {
            let got = "deeper ones".to_string();
            return Err(self.bad(*at, &format!("at most {MOST_DEPTH} sequences in one another"), got));
        }
        let (mut items, end) = (vec![], stop.unwrap_or(end));
        while stop.is_none_or(|stop| *at < stop) {
            let (start, tag, length) = (*at, self.tag(*at)?, self.word(*at + 4)?);
            *at += 8;
            match tag {
                END_OF_SEQUENCE => return Ok(items),
                ITEM => {}
                _ => return Err(self.bad(start, "an item of a sequence", format!("element {}", shown(tag)))),
            }
            let last =
                match length {
                    UNDEFINED => None,
                    length => Some(at.checked_add(length as usize).filter(|&last| last <= end).ok_or_else(
                        || self.bad(start, "an item within its sequence", format!("one of {length} bytes")),
                    )?),
                };
            let mut item = DataSet::default();
            while last.is_none_or(|last| *at < last) {
                if last.is_none() && self.tag(*at)? == END_OF_ITEM {
                    *at += 8;
                    break;
                }
                self.element(at, last.unwrap_or(end), depth, &mut item)?;
            }
            self.count(start)?;
            items.push(item);
        }
        Ok(items)
    }

    /// The VR and the length of an element.
    fn length(&self, at: &mut usize, start: usize) -> Result<(Option<[u8; 2]>, u32)> {
        if !self.encoding.explicit {
            let length = self.word(*at)?;
            *at += 4;
            return Ok((None, length));
        }
        let bytes = self.take::<4>(*at)?;
        let vr = [bytes[0], bytes[1]];
        if !vr.iter().all(u8::is_ascii_uppercase) {
            let got = format!("'{}'", vr.escape_ascii());
            return Err(self.bad(start, "a value representation of two letters", got));
        }
        let is_long =
            [b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV"]
                .contains(&&vr);
        if is_long {
            let length = self.word(*at + 4)?;
            *at += 8;
            return Ok((Some(vr), length));
        }
        *at += 4;
        Ok((Some(vr), self.half([bytes[2], bytes[3]]).into()))
    }

    fn tag(&self, at: usize) -> Result<Tag> {
        let b = self.take::<4>(at)?;
        Ok(Tag::from(self.half([b[0], b[1]])) << 16 | Tag::from(self.half([b[2], b[3]])))
    }

    fn half(&self, bytes: [u8; 2]) -> u16 {
        if self.encoding.big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
    }

    fn word(&self, at: usize) -> Result<u32> {
        let bytes = self.take(at)?;
        Ok(if self.encoding.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    fn take<const N: usize>(&self, at: usize) -> Result<[u8; N]> {
        let found = self.bytes.get(at..).and_then(|rest| rest.first_chunk::<N>());
        found
            .copied()
            .ok_or_else(|| self.bad(at.min(self.bytes.len()), "an element", "the end of the file".into()))
    }

    /// An error at a byte of the file.
    fn bad(&self, at: usize, expected: &str, got: String) -> Error {
        Error::bad_input(self.path, Place::byte(at as u64), expected, got)
            .with_help("the file is cut short or damaged")
    }

    /// The text of an element, without blanks at its ends; `None` where there is none, or an empty
    /// one.
    pub(super) fn text(&self, of: &DataSet, tag: Tag) -> Option<String> {
        let text = String::from_utf8_lossy(&self.bytes[of.find(tag)?.value.clone()]);
        let text = text.trim_matches([' ', '\0']).to_string();
        Some(text).filter(|text| !text.is_empty())
    }

    /// The numbers of an element that is text.
    pub(super) fn numbers<const N: usize>(&self, of: &DataSet, tag: Tag) -> Result<Option<[f64; N]>> {
        let Some(values) = self.list(of, tag, N)? else { return Ok(None) };
        Ok(<[f64; N]>::try_from(values).ok())
    }

    /// So many numbers of an element that is text.
    pub(super) fn list(&self, of: &DataSet, tag: Tag, count: usize) -> Result<Option<Vec<f64>>> {
        let Some(text) = self.text(of, tag) else { return Ok(None) };
        let number = |word: &str| word.trim().parse().ok().filter(|v: &f64| v.is_finite());
        let values: Option<Vec<f64>> = text.split('\\').map(number).collect();
        match values.filter(|values| values.len() == count) {
            Some(values) => Ok(Some(values)),
            None => {
                let expected = if count == 1 { "a number".into() } else { format!("{count} numbers") };
                let got =
                    if text.len() > 200 { format!("{} others", text.split('\\').count()) } else { text };
                Err(Error::bad_input(self.path, format!("element {}", shown(tag)), expected, got))
            }
        }
    }

    /// The finite number of an element that is one `f64`; `None` where there is none.
    pub(super) fn double(&self, of: &DataSet, tag: Tag) -> Result<Option<f64>> {
        let Some(element) = of.find(tag).filter(|e| !e.value.is_empty()) else { return Ok(None) };
        let bytes = <[u8; 8]>::try_from(&self.bytes[element.value.clone()]).ok();
        let number = bytes
            .map(|b| if self.encoding.big_endian { f64::from_be_bytes(b) } else { f64::from_le_bytes(b) });
        match number.filter(|n| n.is_finite()) {
            Some(number) => Ok(Some(number)),
            None => {
                let got = number.map_or(format!("{} bytes", element.value.len()), |n| n.to_string());
                Err(Error::bad_input(
                    self.path,
                    format!("element {}", shown(tag)),
                    "a number of 8 bytes",
                    got,
                ))
            }
        }
    }

    /// The 16 bits of an element; `None` where there is none.
    pub(super) fn integer(&self, of: &DataSet, tag: Tag) -> Result<Option<u16>> {
        let Some(element) = of.find(tag).filter(|e| !e.value.is_empty()) else { return Ok(None) };
        match self.bytes[element.value.clone()] {
            [a, b] => Ok(Some(self.half([a, b]))),
            _ => {
                let got = format!("{} bytes", element.value.len());
                Err(Error::bad_input(self.path, format!("element {}", shown(tag)), "2 bytes", got))
            }
        }
    }
}

impl DataSet {
    fn find(&self, tag: Tag) -> Option<&Element> {
        self.0.iter().find(|e| e.tag == tag)
    }

    /// Whether there is such an element.
    pub(super) fn has(&self, tag: Tag) -> bool {
        self.find(tag).is_some()
    }

    /// The items of a sequence; none where there is no such element.
    pub(super) fn items(&self, tag: Tag) -> &[DataSet] {
        self.find(tag).map_or(&[], |e| &e.items)
    }

    /// The bytes of an element, and whether they are said to be single bytes.
    pub(super) fn bytes(&self, tag: Tag) -> Option<(Range<usize>, bool)> {
        self.find(tag).map(|e| (e.value.clone(), e.is_bytes))
    }
}

/// A tag as the standard writes it.
pub(super) fn shown(tag: Tag) -> String {
    format!("({:04x},{:04x})", tag >> 16, tag & 0xffff)
}

/// The error of an element that is not there.
pub(super) fn missing(path: &Path, name: &str, tag: Tag) -> Error {
    Error::bad_input(path, format!("{name} {}", shown(tag)), "a value", "none")
}
