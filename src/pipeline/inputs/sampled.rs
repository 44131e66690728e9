//! What is known of a volume before it becomes a pyramid: the range of its samples, and boxes of
//! them that stand for all.

use super::scan::each_slab;
use super::shift::{Reading, treat_missing};
use isospan_io::error::Result;
use isospan_io::exec::CancelToken;
use isospan_io::grid::IndexBox;
use isospan_io::volume::chunked::ChunkedVolume;
use isospan_io::volume::{VolumeReader, VolumeSource};
use isospan_mesh::simd::with_vectors;
use isospan_wavelet::{Box3, fill};
use std::convert::Infallible;

/// A volume of at most this many samples is a box by itself.
const WHOLE: u64 = 1 << 23;
/// Boxes of a larger one, and samples along each axis of a box.
const BOXES: u64 = 24;
const EDGE: u64 = 64;
/// Bytes of decoded chunks while boxes are read.
const CACHE: u64 = 32 << 20;
/// Boxes of a larger one on which delays are tried.
const TRIED: usize = 8;
/// A volume of at most this many samples is encoded and decoded as a whole.
const SMALL: usize = 1 << 19;
/// Small boxes of a larger one, half of them below so many samples; and samples along each axis of
/// one.
const SMALL_BOXES: u64 = 16;
const MANY_SMALL: usize = 1 << 22;
const SMALL_EDGE: u64 = 32;

/// What one reading of a volume finds.
pub(in crate::pipeline) struct Sampled {
    /// Least and largest sample.
    pub(in crate::pipeline) range: Option<[f32; 2]>,
    /// Samples of boxes, x fastest, and their sizes. Missing ones have values that cost little.
    pub(in crate::pipeline) boxes: Vec<(Vec<f32>, [usize; 3])>,
    /// The part of these samples that is known.
    pub(in crate::pipeline) known: f64,
    /// Samples of the volume.
    pub(in crate::pipeline) samples: usize,
}

impl Sampled {
    /// Reads a volume once.
    ///
    /// # Errors
    /// Those of reading; [`crate::Error::Cancelled`].
    pub(in crate::pipeline) fn of(
        source: VolumeSource,
        reading: &Reading,
        cancel: &CancelToken,
    ) -> Result<Self> {
        let dims = source.info().dims;
        let boxes = boxes(dims);
        let mut found: Vec<Vec<f32>> = boxes.iter().map(|b| vec![0.0; b.len()]).collect();
        let (missing, stand_in) = (reading.missing().map(|m| m as f32), reading.stand_in());
        let mut range = [f32::INFINITY, f32::NEG_INFINITY];
        each_slab(source, reading, |slab, values| {
            range = widened(range, values, missing);
            boxes.iter().zip(&mut found).for_each(|(b, to)| take(b, to, slab, values));
            cancel.check()
        })?;
        if let Some(value) = stand_in {
            range = [range[0].min(value), range[1].max(value)];
        }
        let range = (range[0] <= range[1]).then_some(range);
        let sizes = boxes.iter().map(|b| b.dims().map(|n| n as usize));
        Ok(Self::new(reading, dims, range, found.into_iter().zip(sizes).collect()))
    }

    /// Missing samples are refused later, where that is asked for.
    fn new(
        reading: &Reading,
        dims: [u64; 3],
        range: Option<[f32; 2]>,
        mut boxes: Vec<(Vec<f32>, [usize; 3])>,
    ) -> Self {
        let (mut all, mut missing) = (0, 0);
        let [min, max] = range.unwrap_or_default();
        for (values, dims) in &mut boxes {
            treat_missing(reading.missing(), reading.stand_in().unwrap_or(f32::NAN), values);
            all += values.len();
            let here = values.iter().filter(|v| v.is_nan()).count();
            missing += here;
            if here == 0 {
                continue;
            }
            let (whole, given) = (Box3::all(*dims), values.clone());
            let read = |place: &Box3| {
                let mut found = vec![0.0; place.len()];
                take(&indices(place), &mut found, &indices(&whole), &given);
                Ok::<_, Infallible>(found)
            };
            let Ok(()) = fill(*dims, &whole, values, min / 2.0 + max / 2.0, read);
        }
        let known = if missing < all { (all - missing) as f64 / all as f64 } else { 1.0 };
        let samples = dims.iter().map(|&n| n as usize).fold(1, usize::saturating_mul);
        Self { range, boxes, known, samples }
    }
}

impl Sampled {
    /// As [`Sampled::of`], but of a source that is read in any order the boxes alone: the range is
    /// theirs then.
    ///
    /// # Errors
    /// As [`Sampled::of`].
    pub(in crate::pipeline) fn of_boxes(
        source: VolumeSource,
        reading: &Reading,
        cancel: &CancelToken,
    ) -> Result<Self> {
        let reader: Box<dyn VolumeReader> = match source {
            VolumeSource::Random(reader) => reader,
            VolumeSource::Chunked(chunks) => Box::new(ChunkedVolume::new(chunks, CACHE)),
            stream @ VolumeSource::Stream(_) => return Self::of(stream, reading, cancel),
        };
        let dims = reader.info().dims;
        let (places, reader) = (boxes(dims), reading.reader(reader));
        let (mut range, mut found) = ([f32::INFINITY, f32::NEG_INFINITY], vec![]);
        for place in places {
            cancel.check()?;
            let mut values = vec![0.0; place.len()];
            reader.read_box(place, &mut values)?;
            treat_missing(reading.missing(), reading.stand_in().unwrap_or(f32::NAN), &mut values);
            range = values.iter().fold(range, |[lo, hi], v| [lo.min(*v), hi.max(*v)]);
            found.push((values, place.dims().map(|n| n as usize)));
        }
        Ok(Self::new(reading, dims, (range[0] <= range[1]).then_some(range), found))
    }

    /// Fewer boxes, to try out which axes are split later.
    pub(in crate::pipeline) fn few_boxes(&self) -> Vec<(Vec<f32>, [usize; 3])> {
        match &self.boxes[..] {
            [whole] => cut(whole, isospan_wavelet::boxes(whole.1).iter().map(indices)),
            boxes => boxes.iter().take(TRIED).cloned().collect(),
        }
    }

    /// Small boxes all over the volume, to encode and decode: all of a small one.
    pub(in crate::pipeline) fn small_boxes(&self) -> Vec<(Vec<f32>, [usize; 3])> {
        match &self.boxes[..] {
            [whole] if whole.0.len() <= SMALL => vec![whole.clone()],
            [whole] => {
                let count = if whole.0.len() < MANY_SMALL { SMALL_BOXES / 2 } else { SMALL_BOXES };
                cut(whole, spread(whole.1.map(|n| n as u64), count, SMALL_EDGE))
            }
            boxes => {
                let first =
                    |of: &(Vec<f32>, [usize; 3])| cut(of, spread(of.1.map(|n| n as u64), 1, SMALL_EDGE));
                boxes.iter().take(SMALL_BOXES as usize).flat_map(first).collect()
            }
        }
    }
}

/// A range with some samples. A zero has no sign in it.
fn widened(range: [f32; 2], values: &[f32], missing: Option<f32>) -> [f32; 2] {
    // What no sample equals.
    let missing = missing.unwrap_or(f32::NAN);
    with_vectors(
        #[inline(always)]
        || {
            let [mut least, mut most] = [[range[0]; LANES], [range[1]; LANES]];
            let (chunks, rest) = values.as_chunks::<LANES>();
            let mut last = [f32::NAN; LANES];
            last[..rest.len()].copy_from_slice(rest);
            for chunk in chunks.iter().chain([&last]) {
                for ((v, least), most) in chunk.iter().zip(&mut least).zip(&mut most) {
                    let is_there = v.abs() < f32::INFINITY && *v != missing;
                    *least = if is_there && v + 0.0 < *least { v + 0.0 } else { *least };
                    *most = if is_there && v + 0.0 > *most { v + 0.0 } else { *most };
                }
            }
            [least.into_iter().fold(range[0], f32::min), most.into_iter().fold(range[1], f32::max)]
        },
    )
}

/// Samples that are compared side by side.
const LANES: usize = 16;

/// Parts of a box of samples.
fn cut(
    (values, dims): &(Vec<f32>, [usize; 3]),
    parts: impl IntoIterator<Item = IndexBox>,
) -> Vec<(Vec<f32>, [usize; 3])> {
    let whole = IndexBox::whole(dims.map(|n| n as u64));
    let part = |place: IndexBox| {
        let mut samples = vec![0.0; place.len()];
        take(&place, &mut samples, &whole, values);
        (samples, place.dims().map(|n| n as usize))
    };
    parts.into_iter().map(part).collect()
}

fn indices(b: &Box3) -> IndexBox {
    IndexBox { lo: b.start.map(|n| n as u64), hi: b.end().map(|n| n as u64) }
}

/// Copies what a box has in common with a slab.
fn take(b: &IndexBox, to: &mut [f32], slab: &IndexBox, values: &[f32]) {
    let here = b.intersect(slab);
    if here.is_empty() {
        return;
    }
    let width = here.dims()[0] as usize;
    for z in here.lo[2]..here.hi[2] {
        for y in here.lo[1]..here.hi[1] {
            let [at, from] = [b, slab].map(|b| b.offset([here.lo[0], y, z]));
            to[at..at + width].copy_from_slice(&values[from..from + width]);
        }
    }
}

/// Boxes of a volume that stand for all of it: all of a small one.
fn boxes(dims: [u64; 3]) -> Vec<IndexBox> {
    let samples = dims.iter().map(|&d| u128::from(d)).product::<u128>();
    if samples <= u128::from(WHOLE) {
        return vec![IndexBox::whole(dims)];
    }
    spread(dims, BOXES, EDGE).collect()
}

/// Boxes of about `edge` samples along each axis, all over a volume.
fn spread(dims: [u64; 3], count: u64, edge: u64) -> impl Iterator<Item = IndexBox> {
    // The boxes of a thin volume are longer, so that all have as many samples.
    let mut edges = dims.map(|n| n.min(edge));
    for a in 0..3 {
        let others = edges.iter().enumerate().filter(|(b, _)| *b != a).map(|(_, e)| e).product::<u64>();
        edges[a] = (edge.pow(3) / others.max(1)).clamp(edges[a], 4 * edge).min(dims[a]);
    }
    // Each axis goes through the places in an order of its own: a net of base 2, 3 and 5.
    let place = move |i: u64, a: usize| {
        let base = [2, 3, 5][a];
        let (mut n, mut part, mut unit) = (i + 1, 0.0, 1.0);
        while n > 0 {
            unit /= base as f64;
            part += (n % base) as f64 * unit;
            n /= base;
        }
        (part * (dims[a] - edges[a] + 1) as f64) as u64
    };
    let one = move |i: u64| {
        let lo: [u64; 3] = std::array::from_fn(|a| place(i, a).min(dims[a] - edges[a]));
        IndexBox { lo, hi: std::array::from_fn(|a| lo[a] + edges[a]) }
    };
    (0..count).map(one)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_lie_in_the_volume() {
        for dims in [[2, 2, 2], [200, 200, 200], [1000, 900, 800], [4096, 4096, 3], [1 << 24, 2, 2]] {
            let boxes = boxes(dims);
            assert!(boxes.iter().all(|b| !b.is_empty() && (0..3).all(|a| b.hi[a] <= dims[a])), "{boxes:?}");
            let samples: usize = boxes.iter().map(IndexBox::len).sum();
            assert!(samples <= WHOLE as usize, "{dims:?}: {samples}");
        }
    }
}
