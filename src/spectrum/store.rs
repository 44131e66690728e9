//! A spectrum as a segment of one block. `FORMAT.md` specifies the bytes.

use super::Spectrum;
use super::builder::SpectrumBuilder;
use super::design::Limits;
use super::part::ChunkPart;
use super::part::Digits;
use crate::archive::segment::{PlanHash, Segment, SegmentInfo, SegmentKind, SegmentWriter};
use isospan_io::error::{Error, Result};
use std::path::Path;

impl SpectrumBuilder {
    /// Writes the spectrum and publishes it.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(&self, path: impl AsRef<Path>, plan: PlanHash) -> Result<SegmentInfo> {
        let mut out = SegmentWriter::create_unlooked(path, SegmentKind::Spectrum, plan)?;
        out.push_block(&self.total().encode(Digits::Few))?;
        out.finish()
    }
}

/// A spectrum that has been read.
pub struct SpectrumFile {
    segment: Segment,
    total: SpectrumBuilder,
    spectrum: Spectrum,
}

impl SpectrumFile {
    /// Reads a spectrum, which was made with these limits.
    ///
    /// # Errors
    /// When it is not a spectrum of this plan (`None`: of any plan), or is damaged.
    pub fn open(path: impl AsRef<Path>, plan: Option<PlanHash>, limits: Limits) -> Result<Self> {
        let segment = Segment::open(path, SegmentKind::Spectrum, plan)?;
        if segment.block_count() != 1 {
            let got = segment.block_count().to_string();
            return Err(Error::bad_input(segment.path(), "block count", "1", got));
        }
        let mut block = vec![];
        segment.block(0, &mut block)?;
        let part =
            ChunkPart::decode(&block, limits, Digits::Few).map_err(|m| m.in_block(segment.path(), 0))?;
        let Some(total) = SpectrumBuilder::of_part(&part) else {
            return Err(Error::bad_input(segment.path(), "block 0", "tetrahedra that are not void", "none"));
        };
        Ok(Self { segment, spectrum: total.spectrum(), total })
    }

    /// The spectrum at its knots.
    pub fn spectrum(&self) -> &Spectrum {
        &self.spectrum
    }

    /// The container: path, bytes read, verification.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// Bytes read.
    pub fn bytes_read(&self) -> u64 {
        self.segment.bytes_read()
    }

    /// The number of active tetrahedra, exactly; `None` at an isovalue at which it is not stored.
    pub fn active(&self, isovalue: f32) -> Option<u64> {
        let [lo, hi] = self.spectrum.range;
        if !(lo < isovalue && isovalue <= hi) {
            return Some(0);
        }
        let knots = &self.spectrum.knots;
        if let Ok(k) = knots.binary_search_by(|k| k.isovalue.total_cmp(&isovalue)) {
            return Some(knots[k].active_cells);
        }
        self.spectrum.levels.find(isovalue).map(|n| self.total.levels[n as usize])
    }

    /// Checks that the file is whole, and has the block that `expected` would write.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn verify(&self, expected: &SpectrumBuilder) -> Result<()> {
        let segment = &self.segment;
        segment.verify()?;
        let mut found = vec![];
        segment.block(0, &mut found)?;
        if found == expected.total().encode(Digits::Few) {
            return Ok(());
        }
        let (expected, got) = ("the sums over all tetrahedra", "others");
        Err(Error::bad_input(segment.path(), "block 0", expected, got)
            .with_help("the archive is damaged or was written by a faulty program: make it again"))
    }
}
