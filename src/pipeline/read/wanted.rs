//! Which blocks of a chunk a question wants, and which values of their corners.

use super::region::Cut;
use isospan_io::error::Result;
use isospan_io::geom::{LatticeBox, LatticePos};

/// Which values of a block's corners are needed.
pub(in crate::pipeline) enum Needed<'a> {
    All,
    /// The values at corners of tetrahedra that some isovalue crosses.
    ForActive(&'a [f32]),
}

/// Which blocks are wanted, by where their corners are.
pub(in crate::pipeline) enum WantedBlocks<'a> {
    All,
    /// Those that may touch a cut.
    Touching(&'a Cut),
    /// Those that may have a triangle on the boundary of the domain, which ends here.
    AtEnds(LatticePos),
}

impl WantedBlocks<'_> {
    /// Whether a block may be wanted, judged by a box that holds its corners.
    pub(super) fn may_be(&self, hull: impl FnOnce() -> Result<LatticeBox>) -> Result<bool> {
        Ok(match self {
            Self::All => true,
            Self::Touching(cut) => cut.may_touch_box(&hull()?),
            Self::AtEnds(top) => {
                let hull = hull()?;
                (0..3).any(|a| hull.lo[a] == 0 || hull.hi[a] > top[a])
            }
        })
    }

    /// Whether a block with these corners is wanted.
    pub(super) fn is(&self, corners: &[LatticePos]) -> bool {
        match self {
            Self::All => true,
            Self::Touching(cut) => cut.may_touch(corners),
            Self::AtEnds(top) => {
                let at_end = |p: &&LatticePos| (0..3).any(|a| p[a] == 0 || p[a] == top[a]);
                corners.iter().filter(at_end).count() >= 3
            }
        }
    }
}
