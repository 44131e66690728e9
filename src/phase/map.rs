//! Which nodes of a grid are in a phase: a bit for each, plane after plane.

use isospan_io::bytes::store::Store;
use isospan_io::error::Result;
use std::path::Path;

/// A side of the isovalue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Values at or above it.
    Above,
    /// Values below it.
    Below,
}

/// The phases of all nodes of a grid, in memory or in a file that vanishes with them.
#[derive(Debug)]
pub struct PhaseMap {
    dims: [usize; 3],
    /// Words of a row of bits.
    words: usize,
    above: Store<u64>,
    /// Which nodes have a value, where some have none.
    known: Option<Store<u64>>,
}

/// Some planes of a grid while their bits are found.
#[derive(Debug)]
pub struct PhaseSlab {
    dims: [usize; 3],
    words: usize,
    above: Vec<u64>,
    known: Vec<u64>,
}

/// Nodes of a word.
pub(super) const WORD: usize = u64::BITS as usize;

impl PhaseMap {
    /// A map of a grid of `dims` nodes along x, y, z, without its planes yet.
    pub fn new(dims: [usize; 3], has_holes: bool, memory: usize, scratch: &Path) -> Self {
        let store = || Store::new(memory / 2, scratch);
        let known = has_holes.then(store);
        Self { dims, words: dims[0].div_ceil(WORD), above: store(), known }
    }

    /// Nodes along x, y, z.
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// Words of a row of bits.
    pub(super) fn words(&self) -> usize {
        self.words
    }

    /// An empty slab of so many planes.
    pub fn slab(&self, planes: usize) -> PhaseSlab {
        PhaseSlab::new([self.dims[0], self.dims[1], planes], self.known.is_some())
    }

    /// Appends the next planes.
    ///
    /// # Errors
    /// Those of the scratch folder.
    pub fn push(&mut self, slab: &PhaseSlab) -> Result<()> {
        self.above.extend(&slab.above)?;
        self.known.as_mut().map_or(Ok(()), |known| known.extend(&slab.known))
    }

    /// The bits of a phase in a plane, row after row.
    ///
    /// # Errors
    /// Those of the scratch folder.
    pub(super) fn plane(&self, phase: Phase, z: usize, out: &mut Vec<u64>) -> Result<()> {
        let size = self.words * self.dims[1];
        out.clear();
        out.resize(size, 0);
        self.above.read_from((z * size) as u64, out)?;
        if phase == Phase::Above {
            return Ok(());
        }
        let mut known = vec![u64::MAX; size];
        if let Some(store) = &self.known {
            store.read_from((z * size) as u64, &mut known)?;
        }
        let past = self.dims[0] % WORD;
        let last = if past == 0 { u64::MAX } else { (1 << past) - 1 };
        for (n, (bits, known)) in out.iter_mut().zip(known).enumerate() {
            let there = if n % self.words + 1 == self.words { last } else { u64::MAX };
            *bits = !*bits & known & there;
        }
        Ok(())
    }
}

impl PhaseSlab {
    /// A box of nodes, none of them above or known yet.
    pub fn new(dims: [usize; 3], has_holes: bool) -> Self {
        let words = dims[0].div_ceil(WORD);
        let bits = vec![0; words * dims[1] * dims[2]];
        let known = if has_holes { bits.clone() } else { vec![] };
        Self { dims, words, above: bits, known }
    }

    /// Copies the bits of a box whose first node is at a place, the x of which is a multiple of 64.
    pub fn put(&mut self, part: &Self, at: [usize; 3]) {
        for n in 0..part.dims[1] * part.dims[2] {
            let (y, z) = (at[1] + n % part.dims[1], at[2] + n / part.dims[1]);
            let to = (z * self.dims[1] + y) * self.words + at[0] / WORD;
            let copy =
                |to: &mut [u64], from: &[u64]| to.iter_mut().zip(from).for_each(|(to, from)| *to |= from);
            let from = n * part.words..(n + 1) * part.words;
            copy(&mut self.above[to..], &part.above[from.clone()]);
            if !self.known.is_empty() {
                copy(&mut self.known[to..], &part.known[from]);
            }
        }
    }

    /// Notes the values of nodes of a row from `x` on, a multiple of 64, in a plane of the slab.
    pub fn note(&mut self, [x, y, z]: [usize; 3], values: &[f32], isovalue: f32) {
        let row = (z * self.dims[1] + y) * self.words + x / WORD;
        for (n, values) in values.chunks(WORD).enumerate() {
            let bits = |of: &dyn Fn(f32) -> bool| {
                values.iter().enumerate().fold(0, |bits, (i, &v)| bits | u64::from(of(v)) << i)
            };
            self.above[row + n] |= bits(&|v| v >= isovalue);
            if let Some(known) = self.known.get_mut(row + n) {
                *known |= bits(&|v| !v.is_nan());
            }
        }
    }
}
