//! Sums over chunks.

use super::design::{Design, Limits};
use super::part::{ChunkPart, Measured};
use super::{Spectrum, SpectrumKnot};

/// Adds up the parts of all chunks.
#[derive(Clone, Debug)]
pub struct SpectrumBuilder {
    design: Design,
    tetrahedra: u64,
    volume: f64,
    active: Vec<u64>,
    sums: Vec<[f64; 3]>,
    /// Active tetrahedra at each level.
    pub(super) levels: Vec<u64>,
}

impl SpectrumBuilder {
    /// Nothing yet.
    pub fn new(design: Design) -> Self {
        let (knots, levels) = (design.knots.count as usize, design.levels.count as usize);
        Self {
            design,
            tetrahedra: 0,
            volume: 0.0,
            active: vec![0; knots],
            sums: vec![[0.0; 3]; knots],
            levels: vec![0; levels],
        }
    }

    /// The spectrum of all chunks, whose parts were made with these limits; none if all tetrahedra
    /// are void.
    pub fn of_parts(parts: &[ChunkPart], limits: Limits) -> Option<Self> {
        let ranges = parts.iter().filter_map(|part| Some(part.measured.as_ref()?.design.range));
        let range = ranges.reduce(|[lo, hi], of| [lo.min(of[0]), hi.max(of[1])])?;
        let mut all = Self::new(Design::new(range, limits));
        parts.iter().for_each(|part| all.add(part));
        Some(all)
    }

    /// The spectrum of a chunk alone; none if all its tetrahedra are void.
    pub(super) fn of_part(part: &ChunkPart) -> Option<Self> {
        let mut alone = Self::new(part.measured.as_ref()?.design);
        alone.add(part);
        Some(alone)
    }

    /// What is measured.
    pub fn design(&self) -> &Design {
        &self.design
    }

    /// Adds the part of the next chunk, whose range is in that of the design, which has the same
    /// limits. `f64` sums depend on the order of the chunks, in their last bits.
    pub fn add(&mut self, part: &ChunkPart) {
        let Some(measured) = &part.measured else { return };
        self.tetrahedra += part.tetrahedra;
        self.volume += part.volume;
        let (all, of) = (&self.design, &measured.design);
        for (k, sum) in (0..).zip(&mut self.sums) {
            if let Some(here) = of.knots.number_of(&all.knots, k) {
                self.active[k as usize] += measured.active[here as usize];
                (0..3).for_each(|i| sum[i] += measured.sums[here as usize][i]);
            } else if all.knots.value(k) <= of.range[0] {
                sum[1] += part.volume;
            }
        }
        for (n, level) in (0..).zip(&mut self.levels) {
            *level += of.levels.number_of(&all.levels, n).map_or(0, |here| measured.levels[here as usize]);
        }
    }

    /// What all chunks have together, in the form of one.
    pub(super) fn total(&self) -> ChunkPart {
        let Self { design, tetrahedra, volume, active, sums, levels } = self.clone();
        ChunkPart { tetrahedra, volume, measured: Some(Measured { design, active, sums, levels }) }
    }

    /// The spectrum of all chunks.
    pub fn spectrum(&self) -> Spectrum {
        let knots = self.design.knots.values().into_iter().zip(&self.active).zip(&self.sums).map(
            |((isovalue, &active_cells), &[area, volume, gradient])| SpectrumKnot {
                isovalue,
                active_cells,
                area,
                volume,
                gradient,
            },
        );
        Spectrum {
            range: self.design.range,
            tetrahedra: self.tetrahedra,
            volume: self.volume,
            knots: knots.collect(),
            levels: self.design.levels,
        }
    }
}
