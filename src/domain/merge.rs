//! Vertices that a file has more than once.
//!
//! The pieces of a partitioned mesh repeat the points of their common border, and some programs
//! repeat them for every cell. Vertices of one position (on the fine lattice) and one value are one
//! vertex: the first of them stands for all, so that the cells around it have common faces. Those
//! of one position and **different** values stay apart: there the field jumps, and the cells next
//! to the jump belong to different bodies ([`super::bodies`]). Cell data are averaged over all
//! cells around a place, so there its vertices are one, unless the user says that the field jumps.
//!
//! An external sort by position, value and number brings equals together; another by number puts
//! the answers in order. All steps of a series share the answers of the first, regardless of their
//! own values; an archive keeps them for steps to come.

use super::column::{Column, ColumnWriter};
use super::settings::StoreSettings;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::error::Result;
use isospan_mesh::locate::FinePos;

/// The bits of every value that is missing.
const VOID: u32 = 0x7fc0_0000;

/// For each vertex the first that equals it.
pub(crate) struct Firsts {
    /// None where all vertices differ.
    of: Option<Column<u64>>,
    /// Vertices that equal an earlier one.
    pub(crate) repeated: u64,
}

impl Firsts {
    /// Of vertices with values; of their places alone without.
    pub(super) fn new(
        positions: &[FinePos],
        values: Option<&[f32]>,
        settings: &StoreSettings,
    ) -> Result<Self> {
        let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
        let mut equals: Sorter<[u64; 5]> = Sorter::new(memory, &settings.scratch);
        for (v, [x, y, z]) in positions.iter().enumerate() {
            // One NaN, one zero. A compiler may take the NaN of a sum for any other: bits are
            // chosen.
            let value = values.map_or(0.0, |values| values[v]);
            let bits = if value.is_nan() { VOID } else { (value + 0.0).to_bits() };
            equals.push([*x as u64, *y as u64, *z as u64, u64::from(bits), v as u64])?;
        }
        let mut answers: Sorter<[u64; 2]> = Sorter::new(memory, &settings.scratch);
        let (mut sorted, mut first, mut repeated) = (equals.finish()?, [u64::MAX; 5], 0);
        while let Some(vertex) = sorted.next()? {
            if vertex[..4] == first[..4] {
                answers.push([vertex[4], first[4]])?;
                repeated += 1;
            } else {
                first = vertex;
            }
        }
        if repeated == 0 {
            return Ok(Self { of: None, repeated });
        }
        let mut answers = answers.finish()?;
        Self::known(|| answers.next(), positions.len() as u64, settings)
    }

    /// As they were found before: `next` gives the vertices that equal an earlier one, ascending,
    /// each with that earlier one.
    pub(crate) fn known(
        mut next: impl FnMut() -> Result<Option<[u64; 2]>>,
        vertices: u64,
        settings: &StoreSettings,
    ) -> Result<Self> {
        let (mut of, mut repeated, mut pair) = (ColumnWriter::new(&settings.scratch)?, 0, next()?);
        for v in 0..vertices {
            match pair {
                Some([vertex, first]) if vertex == v => {
                    of.push(&first)?;
                    repeated += 1;
                    pair = next()?;
                }
                _ => of.push(&v)?,
            }
        }
        let of = of.finish()?;
        Ok(Self { of: (repeated > 0).then_some(of), repeated })
    }

    /// Vertices that equal an earlier one, ascending, and that.
    pub(crate) fn pairs(&self) -> Result<impl Iterator<Item = [u64; 2]> + '_> {
        let of = self.of.as_ref().map_or(Ok(&[][..]), Column::get)?;
        Ok((0u64..).zip(of).filter(|(v, first)| v != *first).map(|(v, &first)| [v, first]))
    }

    /// Puts the first of its equals in the place of each vertex. Vertices that polyhedra add have
    /// none.
    pub(crate) fn replace(&self, vertices: &mut [u64]) -> Result<()> {
        if let Some(of) = &self.of {
            let of = of.get()?;
            vertices.iter_mut().for_each(|v| *v = of.get(*v as usize).copied().unwrap_or(*v));
        }
        Ok(())
    }
}
