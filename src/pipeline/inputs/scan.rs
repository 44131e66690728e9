//! One pass over a volume: range, mean, missing samples, histogram. Memory: one slab.

use super::shift::Reading;
use isospan_io::error::Result;
use isospan_io::exec::CancelToken;
use isospan_io::grid::IndexBox;
use isospan_io::volume::convert::convert_row;
use isospan_io::volume::shifted::{each_value, may_need_offset, shortest};
use isospan_io::volume::{SlabStream, VolumeInfo, VolumeReader, VolumeSource};
use serde::Serialize;

/// What one pass over the samples finds. Values have slope and intercept applied.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Scan {
    /// Least finite value; `None` if there is no finite sample.
    pub min: Option<f64>,
    /// Largest finite value.
    pub max: Option<f64>,
    /// Mean of the finite values.
    pub mean: Option<f64>,
    /// Samples that are NaN, or declared missing by the file.
    pub nan: u64,
    /// Samples that are infinite.
    pub infinite: u64,
    /// Finite samples in each of [`Scan::BINS`] equal parts of `min..=max`.
    pub histogram: Vec<u64>,
}

impl Scan {
    /// Number of histogram bins.
    pub const BINS: usize = 64;
}

/// Counts values by the 16 leading bits of an order-preserving key of the `f32`: one pass without
/// knowing the range first. A bin of the final histogram is therefore exact to 1/128 of a value.
/// Values that `f32` may not hold are counted from the first one.
struct Counter {
    by_key: Vec<u64>,
    base: Option<f64>,
    min: f64,
    max: f64,
    sum: f64,
    finite: u64,
    nan: u64,
    infinite: u64,
}

impl Counter {
    fn new() -> Self {
        Self {
            by_key: vec![0; 1 << 16],
            base: None,
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
            sum: 0.0,
            finite: 0,
            nan: 0,
            infinite: 0,
        }
    }

    fn add(&mut self, values: &[f32]) {
        self.base = Some(0.0);
        values.iter().for_each(|&v| self.add_one(f64::from(v)));
    }

    fn add_one(&mut self, v: f64) {
        if v.is_finite() {
            let base = *self.base.get_or_insert(v);
            self.by_key[(ordered_key((v - base) as f32) >> 16) as usize] += 1;
            self.min = self.min.min(v);
            self.max = self.max.max(v);
            self.sum += v;
            self.finite += 1;
        } else if v.is_nan() {
            self.nan += 1;
        } else {
            self.infinite += 1;
        }
    }

    fn finish(self) -> Scan {
        let known = self.finite > 0;
        let mut histogram = vec![0; Scan::BINS];
        let (width, base) = (self.max - self.min, self.base.unwrap_or(0.0));
        for (key, &count) in self.by_key.iter().enumerate().filter(|(_, c)| **c > 0) {
            let value = f64::from(value_of_key((key as u32) << 16 | 0x8000)) + (base - self.min);
            let bin = if width > 0.0 { (value / width * Scan::BINS as f64) as usize } else { 0 };
            histogram[bin.min(Scan::BINS - 1)] += count;
        }
        Scan {
            min: known.then_some(self.min + 0.0),
            max: known.then_some(self.max + 0.0),
            mean: known.then(|| self.sum / self.finite as f64),
            nan: self.nan,
            infinite: self.infinite,
            histogram,
        }
    }
}

/// An unsigned key in the order of the floats.
fn ordered_key(v: f32) -> u32 {
    let bits = v.to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

fn value_of_key(key: u32) -> f32 {
    f32::from_bits(if key >> 31 == 1 { key & !(1 << 31) } else { !key })
}

/// Reads a volume once.
///
/// # Errors
/// Those of reading it.
pub fn scan(source: VolumeSource) -> Result<(VolumeInfo, Scan)> {
    let mut counter = Counter::new();
    let info = source.info().clone();
    match source {
        source if may_need_offset(info.field.scalar, info.slope, info.intercept) => {
            let (mut stream, mut bytes) = (source.into_stream(), vec![]);
            let stored = stream.info().clone();
            while stream.next_slab(&mut bytes)?.is_some() {
                each_value(&bytes, &stored, None, 0.0, |v| counter.add_one(v));
            }
            return Ok((info, counter.finish()));
        }
        VolumeSource::Random(reader) => scan_random(&*reader, &mut counter)?,
        other => scan_stream(&mut *other.into_stream(), &mut counter)?,
    }
    let scan = counter.finish();
    let in_file = |v: Option<f64>| v.map(|v| shortest(v as f32));
    Ok((info, Scan { min: in_file(scan.min), max: in_file(scan.max), ..scan }))
}

fn scan_random(reader: &dyn VolumeReader, counter: &mut Counter) -> Result<()> {
    for_slabs(reader, |_, values| {
        counter.add(values);
        Ok(())
    })
}

/// The range of all finite samples besides the one that means "no data", and of the value that
/// stands for those; 0 where there is none. Reads the volume once.
pub(in crate::pipeline) fn range_of(
    source: VolumeSource,
    reading: &Reading,
    cancel: &CancelToken,
) -> Result<[f32; 2]> {
    let missing = reading.missing().map(|m| m as f32);
    let mut range = [f32::INFINITY, f32::NEG_INFINITY];
    each_slab(source, reading, |_, values| {
        for value in values.iter().filter(|v| v.is_finite() && Some(**v) != missing) {
            // A zero has no sign here.
            range = [range[0].min(value + 0.0), range[1].max(value + 0.0)];
        }
        cancel.check()
    })?;
    if let Some(value) = reading.stand_in() {
        range = [range[0].min(value), range[1].max(value)];
    }
    Ok(if range[0] <= range[1] { range } else { [0.0; 2] })
}

/// Hands all samples of a volume to `each`, in boxes, less the offset. Reads the volume once.
pub(super) fn each_slab(
    source: VolumeSource,
    reading: &Reading,
    mut each: impl FnMut(&IndexBox, &[f32]) -> Result<()>,
) -> Result<()> {
    let mut stream = match source {
        VolumeSource::Random(reader) => return for_slabs(&*reading.reader(reader), each),
        other => other.into_stream(),
    };
    if reading.offset() == 0.0 {
        return for_stream(&mut *stream, each);
    }
    let (info, mut bytes, mut values) = (stream.info().clone(), vec![], vec![]);
    while let Some(slab) = stream.next_slab(&mut bytes)? {
        values.clear();
        each_value(&bytes, &info, reading.declared(), reading.offset(), |v| values.push(v as f32));
        each(&slab, &values)?;
    }
    Ok(())
}

fn for_slabs(reader: &dyn VolumeReader, mut f: impl FnMut(&IndexBox, &[f32]) -> Result<()>) -> Result<()> {
    let dims = reader.info().dims;
    let rows = ((1u64 << 20) / dims[0].max(1)).clamp(1, dims[1].max(1));
    let mut values = vec![];
    for z in 0..dims[2] {
        for y in (0..dims[1]).step_by(rows as usize) {
            let slab = IndexBox { lo: [0, y, z], hi: [dims[0], (y + rows).min(dims[1]), z + 1] };
            values.resize(slab.len(), 0.0);
            reader.read_box(slab, &mut values)?;
            f(&slab, &values)?;
        }
        // A slice at a time would be many calls for small ones.
        if z % 64 == 63 {
            reader.release(z - 63..z + 1);
        }
    }
    Ok(())
}

fn scan_stream(stream: &mut dyn SlabStream, counter: &mut Counter) -> Result<()> {
    for_stream(stream, |_, values| {
        counter.add(values);
        Ok(())
    })
}

fn for_stream(stream: &mut dyn SlabStream, mut f: impl FnMut(&IndexBox, &[f32]) -> Result<()>) -> Result<()> {
    let info = stream.info().clone();
    let (mut bytes, mut values) = (vec![], vec![]);
    while let Some(slab) = stream.next_slab(&mut bytes)? {
        values.resize(slab.len(), 0.0);
        convert_row(&bytes, info.field.scalar, false, info.slope, info.intercept, info.missing, &mut values);
        f(&slab, &values)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_keep_the_order_and_come_back() {
        let values = [f32::MIN, -3.5, -0.0, 0.0, 1e-30, 2.0, 1e30];
        for w in values.windows(2) {
            assert!(ordered_key(w[0]) < ordered_key(w[1]));
        }
        for v in values {
            assert_eq!(value_of_key(ordered_key(v)).to_bits(), v.to_bits());
        }
    }

    #[test]
    fn counts_and_ranges() {
        let mut c = Counter::new();
        c.add(&[0.0, 64.0, 32.0, f32::NAN, f32::INFINITY, 32.0]);
        let s = c.finish();
        assert_eq!((s.min, s.max, s.mean, s.nan, s.infinite), (Some(0.0), Some(64.0), Some(32.0), 1, 1));
        assert_eq!((s.histogram[0], s.histogram[32], s.histogram[63]), (1, 2, 1));
        assert_eq!(Counter::new().finish().min, None);
    }
}
