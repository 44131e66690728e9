//! Which samples are missing, as bytes: a bit a sample, in boxes that are read by themselves.

use std::ops::Range;

use crate::correct::boxes_in;
use crate::error::{Error, Result};
use crate::lengths::{LengthOdds, length, new_odds};
use crate::pyramid::Box3;
use crate::range_coder::{Coder, Decoder, Encoder, Odds};

/// Neighbours that decide the odds of a bit: all are coded before it.
const NEIGHBOURS: usize = 7;
/// Odds to begin with, in 1/65536, by the number of missing neighbours.
const FIRST: [u16; NEIGHBOURS + 1] = [400, 6_000, 16_000, 26_000, 39_000, 49_000, 59_000, 65_000];

/// What a box of samples has.
#[derive(Clone, Debug, Default, PartialEq)]
enum BoxMask<T> {
    /// All samples.
    #[default]
    None,
    /// None of them.
    All,
    /// Some: their bits.
    Some(T),
}

impl<T> BoxMask<T> {
    /// Its number among the kinds of boxes.
    fn kind(&self) -> usize {
        match self {
            Self::None => 0,
            Self::Some(_) => 1,
            Self::All => 2,
        }
    }
}

/// The odds of what boxes are.
struct Directory {
    /// Whether a sample is missing, and then whether all are, by the kind of the box before.
    kinds: [[Odds; 2]; 3],
    lengths: LengthOdds,
    before: usize,
    length_before: u32,
}

impl Directory {
    fn new() -> Self {
        let kinds = [[Odds::new(1 << 15); 2]; 3];
        Self { kinds, lengths: new_odds(), before: 0, length_before: 0 }
    }

    /// Codes what a box is, with the bytes of its bits if it has any.
    fn code<C: Coder>(&mut self, wanted: &BoxMask<u32>, coder: &mut C) -> Result<BoxMask<u32>> {
        let odds = &mut self.kinds[self.before];
        let found = if !coder.bit(&mut odds[0], *wanted != BoxMask::None) {
            BoxMask::None
        } else if coder.bit(&mut odds[1], *wanted == BoxMask::All) {
            BoxMask::All
        } else {
            let bytes = if let BoxMask::Some(bytes) = wanted { *bytes } else { 0 };
            self.length_before = length(bytes, self.length_before as usize, &mut self.lengths, coder)?;
            BoxMask::Some(self.length_before)
        };
        self.before = found.kind();
        Ok(found)
    }
}

/// The bits of a box, x fastest, with a border of zeros: one before and one behind along x and y,
/// one before along z.
struct Bits {
    size: [usize; 3],
    bits: Vec<u8>,
}

impl Bits {
    fn new(size: [usize; 3]) -> Self {
        let [x, y, z] = size;
        Self { size, bits: vec![0; (x + 2) * (y + 2) * (z + 1)] }
    }

    fn at(&self, [x, y, z]: [usize; 3]) -> usize {
        ((z + 1) * (self.size[1] + 2) + y + 1) * (self.size[0] + 2) + x + 1
    }

    fn walk<C: Coder>(&mut self, coder: &mut C) {
        let row = self.size[0] + 2;
        let plane = row * (self.size[1] + 2);
        let before = [1, row, plane, row + 1, row - 1, plane - 1, plane - row];
        let mut odds: [Odds; 1 << NEIGHBOURS] =
            std::array::from_fn(|n| Odds::new(FIRST[n.count_ones() as usize]));
        for z in 0..self.size[2] {
            for y in 0..self.size[1] {
                let first = self.at([0, y, z]);
                for at in first..first + self.size[0] {
                    let known = |n: usize| usize::from(self.bits[at - before[n]]) << n;
                    let context = (0..NEIGHBOURS).map(known).sum::<usize>();
                    self.bits[at] = u8::from(coder.bit(&mut odds[context], self.bits[at] == 1));
                }
            }
        }
    }
}

/// The missing samples of a box of an array, while they become bytes.
#[derive(Debug)]
pub struct MaskBuilder {
    place: Box3,
    boxes: Vec<BoxMask<Vec<u8>>>,
}

impl MaskBuilder {
    /// For a box of samples, none of which is missing yet.
    pub fn new(place: Box3) -> Self {
        Self { place, boxes: vec![BoxMask::None; boxes_in(place).count()] }
    }

    /// Notes which samples of a part are missing: those that are NaN. `values` are those of a
    /// window, which has the part. A part begins and ends between boxes, or where all end.
    pub fn add(&mut self, part: &Box3, window: &Box3, values: &[f32]) {
        for (place, mask) in boxes_in(self.place).zip(&mut self.boxes) {
            if place.cut(part) != place {
                continue;
            }
            let mut missing = 0;
            window.each_row(&place, |at| {
                missing += values[at..at + place.size[0]].iter().filter(|v| v.is_nan()).count();
            });
            *mask = match missing {
                0 => BoxMask::None,
                all if all == place.len() => BoxMask::All,
                _ => {
                    let (mut bits, mut rows) = (Bits::new(place.size), vec![]);
                    window.each_row(&place, |at| rows.push(at));
                    for (n, from) in rows.into_iter().enumerate() {
                        let to = bits.at([0, n % place.size[1], n / place.size[1]]);
                        for x in 0..place.size[0] {
                            bits.bits[to + x] = u8::from(values[from + x].is_nan());
                        }
                    }
                    let mut coder = Encoder::default();
                    bits.walk(&mut coder);
                    BoxMask::Some(coder.finish())
                }
            };
        }
    }

    /// The bytes; none if no sample is missing.
    pub fn finish(self) -> Vec<u8> {
        if self.boxes.iter().all(|mask| *mask == BoxMask::None) {
            return vec![];
        }
        let (mut coder, mut directory, mut rest) = (Encoder::default(), Directory::new(), vec![]);
        for mask in &self.boxes {
            let told = match mask {
                BoxMask::None => BoxMask::None,
                BoxMask::All => BoxMask::All,
                BoxMask::Some(bytes) => {
                    rest.extend_from_slice(bytes);
                    BoxMask::Some(bytes.len() as u32)
                }
            };
            directory.code(&told, &mut coder).unwrap_or_else(|_| unreachable!());
        }
        let directory = coder.finish();
        let mut out = (directory.len() as u32).to_le_bytes().to_vec();
        out.extend(directory);
        out.extend(rest);
        out
    }
}

/// The missing samples of a box of an array.
#[derive(Clone, Debug)]
pub struct Mask {
    place: Box3,
    bytes: Vec<u8>,
    boxes: Vec<BoxMask<Range<usize>>>,
}

impl Mask {
    /// Reads what [`MaskBuilder::finish`] made of a box.
    ///
    /// # Errors
    /// [`Error::Damaged`].
    pub fn new(place: Box3, bytes: Vec<u8>) -> Result<Self> {
        let short = Error::Damaged("a mask ends early");
        let (of_directory, rest) = bytes.split_first_chunk().ok_or(short.clone())?;
        let of_directory = u32::from_le_bytes(*of_directory) as usize;
        let (told, _) = rest.split_at_checked(of_directory).ok_or(short.clone())?;
        let (mut coder, mut directory, mut at) = (Decoder::new(told), Directory::new(), 4 + of_directory);
        let mut next = |_| {
            Ok(match directory.code(&BoxMask::None, &mut coder)? {
                BoxMask::None => BoxMask::None,
                BoxMask::All => BoxMask::All,
                BoxMask::Some(length) => {
                    let end = at.checked_add(length as usize).filter(|end| *end <= bytes.len());
                    let start = std::mem::replace(&mut at, end.ok_or(short.clone())?);
                    BoxMask::Some(start..at)
                }
            })
        };
        let boxes: Vec<_> = boxes_in(place).map(&mut next).collect::<Result<_>>()?;
        coder.finish()?;
        match at == bytes.len() {
            true => Ok(Self { place, bytes, boxes }),
            false => Err(Error::Damaged("bytes behind a mask")),
        }
    }

    /// Bytes of memory.
    pub fn size(&self) -> usize {
        self.bytes.len() + self.boxes.len() * size_of::<BoxMask<Range<usize>>>()
    }

    /// Calls with the place of each missing node in an array over `wanted`, whose node i is sample
    /// i times the stride. Nodes elsewhere are passed over.
    ///
    /// # Errors
    /// [`Error::Damaged`].
    pub fn each_missing(
        &self,
        wanted: &Box3,
        stride: [usize; 3],
        mut missing: impl FnMut(usize),
    ) -> Result<()> {
        for (place, mask) in boxes_in(self.place).zip(&self.boxes) {
            let nodes = nodes_in(&place, stride).cut(wanted);
            if *mask == BoxMask::None || nodes.is_empty() {
                continue;
            }
            let bits = match mask {
                BoxMask::Some(range) => Some(decode(&place, &self.bytes[range.clone()])?),
                _ => None,
            };
            let (mut rows, mut row) = (vec![], 0);
            wanted.each_row(&nodes, |at| rows.push(at));
            for z in nodes.start[2]..nodes.end()[2] {
                for y in nodes.start[1]..nodes.end()[1] {
                    for x in 0..nodes.size[0] {
                        let node = [nodes.start[0] + x, y, z];
                        let bit = |bits: &Bits| {
                            let at = std::array::from_fn(|a| node[a] * stride[a] - place.start[a]);
                            bits.bits[bits.at(at)] == 1
                        };
                        if bits.as_ref().is_none_or(bit) {
                            missing(rows[row] + x);
                        }
                    }
                    row += 1;
                }
            }
        }
        Ok(())
    }
}

/// The bits of a box that has some.
fn decode(place: &Box3, bytes: &[u8]) -> Result<Bits> {
    let (mut bits, mut coder) = (Bits::new(place.size), Decoder::new(bytes));
    bits.walk(&mut coder);
    coder.finish()?;
    Ok(bits)
}

/// The nodes in a box of samples.
fn nodes_in(place: &Box3, stride: [usize; 3]) -> Box3 {
    let [start, end] = [place.start, place.end()].map(|at| [0, 1, 2].map(|a| at[a].div_ceil(stride[a])));
    Box3 { start, size: [0, 1, 2].map(|a| end[a] - start[a]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes_of(place: &Box3, values: &[f32]) -> Vec<u8> {
        let mut builder = MaskBuilder::new(*place);
        builder.add(place, place, values);
        builder.finish()
    }

    fn field(place: &Box3, missing: impl Fn([usize; 3]) -> bool) -> Vec<f32> {
        let [nx, ny, _] = place.size;
        let one = |i: usize| missing([i % nx, i / nx % ny, i / nx / ny]);
        (0..place.len()).map(|i| if one(i) { f32::NAN } else { i as f32 }).collect()
    }

    #[test]
    fn masks_come_back_in_any_box_at_any_stride() {
        let place = Box3 { start: [256, 0, 512], size: [70, 33, 65] };
        let ball = |p: [usize; 3]| p.iter().map(|n| n.abs_diff(30).pow(2)).sum::<usize>() < 400;
        let kinds: [&dyn Fn([usize; 3]) -> bool; 5] = [
            &ball,
            &|p| !ball(p),
            &|p| (p[0] * 7919 + p[1] * 104_729 + p[2] * 1_299_709) % 101 == 3,
            &|_| true,
            &|p| p == [69, 32, 64],
        ];
        for missing in kinds {
            let mask = Mask::new(place, bytes_of(&place, &field(&place, missing))).unwrap();
            for (wanted, stride) in [
                (place, [1; 3]),
                (Box3 { start: [250, 3, 530], size: [60, 20, 100] }, [1; 3]),
                (Box3 { start: [120, 0, 128], size: [50, 17, 20] }, [2, 2, 4]),
            ] {
                let mut found = vec![false; wanted.len()];
                mask.each_missing(&wanted, stride, |i| found[i] = true).unwrap();
                for (i, found) in found.into_iter().enumerate() {
                    let [nx, ny, _] = wanted.size;
                    let node = [i % nx, i / nx % ny, i / nx / ny];
                    let at = [0, 1, 2].map(|a| ((wanted.start[a] + node[a]) * stride[a]) as isize);
                    let at = [0, 1, 2].map(|a| at[a] - place.start[a] as isize);
                    let within = (0..3).all(|a| (0..place.size[a] as isize).contains(&at[a]));
                    assert_eq!(found, within && missing(at.map(|n| n as usize)), "{node:?}");
                }
            }
        }
    }

    #[test]
    fn what_is_alike_is_nearly_free() {
        let place = Box3::all([256; 3]);
        let none = vec![1.0; place.len()];
        assert_eq!(bytes_of(&place, &none).len(), 0);
        assert!(bytes_of(&place, &field(&place, |_| true)).len() < 24);
        let half = bytes_of(&place, &field(&place, |p| p[0] < 128)).len();
        assert!(half < 96, "{half}");
        let ball = |p: [usize; 3]| p.iter().map(|n| n.abs_diff(128).pow(2)).sum::<usize>() < 10_000;
        let bytes = bytes_of(&place, &field(&place, ball)).len();
        // Its surface crosses some 150 000 cells.
        assert!(bytes < 24_000, "{bytes}");
    }

    #[test]
    fn damaged_masks_are_errors_or_masks() {
        let place = Box3::all([70, 40, 33]);
        let missing = |p: [usize; 3]| p[0] + p[1] < 50 || p[0] * p[1] * p[2] % 7 == 1;
        let bytes = bytes_of(&place, &field(&place, missing));
        let read = |bytes: Vec<u8>| Mask::new(place, bytes)?.each_missing(&place, [1; 3], |_| ());
        for n in 0..bytes.len().min(400) {
            assert!(read(bytes[..n].to_vec()).is_err(), "cut at {n}");
            let mut damaged = bytes.clone();
            damaged[n] ^= 1 << (n % 8);
            let _ = read(damaged);
        }
        assert!(read([bytes, vec![1]].concat()).is_err());
    }
}
