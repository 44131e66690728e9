//! A spectrum as a segment: block 0 has the knots, the others the levels, 4096 a page. `FORMAT.md`
//! specifies the bytes.

use super::builder::SpectrumBuilder;
use super::design::MOST_LEVELS;
use super::grid::Grid;
use super::{Knot, Spectrum};
use crate::archive::Malformed;
use crate::archive::segment::{PlanHash, Segment, SegmentInfo, SegmentKind, SegmentWriter};
use crate::archive::wire::{Cursor, put_varint, to_zstd, unzstd};
use crate::error::{Error, Result};
use std::path::Path;

/// Levels of a page.
pub(crate) const PAGE_ACTIVE: u32 = 4096;
/// The most knots that a reader takes.
pub(crate) const LARGEST_KNOTS: u32 = 1 << 16;
pub(super) const PAGE_LEVEL: i32 = 9;

impl SpectrumBuilder {
    /// Writes the spectrum and publishes it.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(&self, path: impl AsRef<Path>, plan: PlanHash) -> Result<SegmentInfo> {
        let mut out = SegmentWriter::create_unlooked(path, SegmentKind::Spectrum, plan)?;
        self.blocks().try_for_each(|block| out.push_block(&block).map(drop))?;
        out.finish()
    }

    /// The blocks of the segment.
    fn blocks(&self) -> impl Iterator<Item = Vec<u8>> {
        let mut before = 0;
        let pages = self.levels.chunks(PAGE_ACTIVE as usize).map(move |page| {
            let block = encode_page(before, page);
            before = page.last().copied().unwrap_or_default();
            block
        });
        std::iter::once(encode_head(&self.spectrum())).chain(pages)
    }
}

fn encode_head(s: &Spectrum) -> Vec<u8> {
    let mut out = vec![];
    s.range.iter().for_each(|v| out.extend(v.to_le_bytes()));
    out.extend(s.tetrahedra.to_le_bytes());
    out.extend(s.volume.to_le_bytes());
    s.levels.encode(&mut out);
    out.extend((s.knots.len() as u32).to_le_bytes());
    s.knots.iter().for_each(|k| out.extend(k.isovalue.to_le_bytes()));
    s.knots.iter().for_each(|k| out.extend(k.active_tetrahedra.to_le_bytes()));
    for column in [|k: &Knot| k.area, |k: &Knot| k.volume, |k: &Knot| k.gradient] {
        s.knots.iter().for_each(|k| out.extend(column(k).to_le_bytes()));
    }
    out
}

fn decode_head(bytes: &[u8]) -> std::result::Result<Spectrum, Malformed> {
    let mut c = Cursor::new(bytes);
    let range = [c.f32("least value")?, c.f32("largest value")?];
    let (tetrahedra, volume) = (c.u64("tetrahedra")?, f64_of(&mut c, "volume")?);
    let levels = Grid::decode(&mut c, MOST_LEVELS as u32)?;
    let knots = c.u32("knots")?;
    if knots > LARGEST_KNOTS {
        return Err(Malformed::new("knots", format!("at most {LARGEST_KNOTS}"), knots.to_string()));
    }
    let mut all = vec![Knot::default(); knots as usize];
    for k in &mut all {
        k.isovalue = c.f32("isovalue")?;
    }
    for k in &mut all {
        k.active_tetrahedra = c.u64("active tetrahedra")?;
    }
    for k in &mut all {
        k.area = f64_of(&mut c, "area")?;
    }
    for k in &mut all {
        k.volume = f64_of(&mut c, "volume")?;
    }
    for k in &mut all {
        k.gradient = f64_of(&mut c, "gradient")?;
    }
    c.end("spectrum")?;
    if !all.is_sorted_by(|a, b| a.isovalue < b.isovalue) {
        return Err(Malformed::new("isovalues", "ascending ones", "others"));
    }
    Ok(Spectrum { range, tetrahedra, volume, knots: all, levels })
}

pub(super) fn f64_of(c: &mut Cursor<'_>, at: &'static str) -> std::result::Result<f64, Malformed> {
    c.u64(at).map(f64::from_bits)
}

/// The number at the last level before the page, and the difference from each level to the next.
fn encode_page(before: u64, active: &[u64]) -> Vec<u8> {
    let mut out = vec![];
    put_varint(&mut out, before);
    let mut body = vec![];
    put_differences(&mut body, before, active);
    out.extend(to_zstd(&body, PAGE_LEVEL));
    out
}

/// The difference of each number to the one before, its sign moved to the lowest bit.
pub(super) fn put_differences(out: &mut Vec<u8>, mut before: u64, numbers: &[u64]) {
    for &n in numbers {
        let d = n.wrapping_sub(before) as i64;
        put_varint(out, (d << 1 ^ d >> 63) as u64);
        before = n;
    }
}

/// The number at the `n`-th level of a page of `levels`.
fn decode_page(bytes: &[u8], levels: u32, n: u32) -> std::result::Result<u64, Malformed> {
    let mut c = Cursor::new(bytes);
    let before = c.varint("active tetrahedra")?;
    let body = unzstd(c.rest(), levels as usize * 10, "differences")?;
    let mut c = Cursor::new(&body);
    let mut active = u128::from(before) as i128;
    for _ in 0..=n {
        let z = c.varint("difference")?;
        active += i128::from((z >> 1) as i64 ^ -((z & 1) as i64));
    }
    u64::try_from(active)
        .map_err(|_| Malformed::new("active tetrahedra", "a number of 64 bits", active.to_string()))
}

/// An open spectrum.
pub struct SpectrumFile {
    levels: Levels,
    spectrum: Spectrum,
}

/// Where the numbers at the levels are.
enum Levels {
    File(Segment),
    /// In memory.
    Known(SpectrumBuilder),
}

impl SpectrumFile {
    /// Opens a spectrum; reads the knots, and none of the levels.
    ///
    /// # Errors
    /// When it is not a spectrum of this plan (`None`: of any plan), or is damaged there.
    pub fn open(path: impl AsRef<Path>, plan: Option<PlanHash>) -> Result<Self> {
        let segment = Segment::open(path, SegmentKind::Spectrum, plan)?;
        if segment.block_count() == 0 {
            return Err(Error::bad_input(segment.path(), "block count", "at least 1", "0"));
        }
        let mut block = vec![];
        segment.block(0, &mut block)?;
        let spectrum = decode_head(&block).map_err(|m| m.in_block(segment.path(), 0))?;
        let blocks = 1 + u64::from(spectrum.levels.count.div_ceil(PAGE_ACTIVE));
        if blocks != segment.block_count() {
            let got = segment.block_count().to_string();
            return Err(Error::bad_input(segment.path(), "block count", blocks.to_string(), got));
        }
        Ok(Self { levels: Levels::File(segment), spectrum })
    }

    /// A spectrum that is not stored as such.
    pub fn of(builder: SpectrumBuilder) -> Self {
        Self { spectrum: builder.spectrum(), levels: Levels::Known(builder) }
    }

    /// The spectrum at its knots.
    pub fn spectrum(&self) -> &Spectrum {
        &self.spectrum
    }

    /// The container: path, bytes read, verification. None of a spectrum in memory.
    pub fn segment(&self) -> Option<&Segment> {
        match &self.levels {
            Levels::File(segment) => Some(segment),
            Levels::Known(_) => None,
        }
    }

    /// Bytes read from its own file.
    pub fn bytes_read(&self) -> u64 {
        self.segment().map_or(0, Segment::bytes_read)
    }

    /// The number of active tetrahedra, exactly; `None` at an isovalue at which it is not stored.
    /// Reads a page.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged page.
    pub fn active(&self, isovalue: f32) -> Result<Option<u64>> {
        let [lo, hi] = self.spectrum.range;
        if !(lo < isovalue && isovalue <= hi) {
            return Ok(Some(0));
        }
        let knots = &self.spectrum.knots;
        if let Ok(k) = knots.binary_search_by(|k| k.isovalue.total_cmp(&isovalue)) {
            return Ok(Some(knots[k].active_tetrahedra));
        }
        let levels = self.spectrum.levels;
        let Some(n) = levels.find(isovalue) else { return Ok(None) };
        let segment = match &self.levels {
            Levels::File(segment) => segment,
            Levels::Known(builder) => return Ok(Some(builder.levels[n as usize])),
        };
        let (page, at) = (n / PAGE_ACTIVE, n % PAGE_ACTIVE);
        let number = u64::from(page) + 1;
        let mut block = vec![];
        segment.block(number, &mut block)?;
        let in_page = (levels.count - page * PAGE_ACTIVE).min(PAGE_ACTIVE);
        let active = decode_page(&block, in_page, at).map_err(|m| m.in_block(segment.path(), number))?;
        Ok(Some(active))
    }

    /// Reads the whole file: every checksum, and whether it has the blocks that `expected` would
    /// write.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn verify(&self, expected: &SpectrumBuilder) -> Result<()> {
        // One in memory was made of parts, which are verified where they are stored.
        let Levels::File(segment) = &self.levels else { return Ok(()) };
        segment.verify()?;
        let mut found = vec![];
        for (n, block) in (0..segment.block_count()).zip(expected.blocks()) {
            segment.block(n, &mut found)?;
            if found != block {
                let (expected, got) = ("the sums over all tetrahedra", "others");
                return Err(Error::bad_input(segment.path(), format!("block {n}"), expected, got)
                    .with_help("the archive is damaged or was written by a faulty program: make it again"));
            }
        }
        Ok(())
    }
}
