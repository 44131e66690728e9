//! The data of steps, opened when their turn comes.

use super::series::SeriesPlan;
use crate::pipeline::chunk::{Field, OwnMesh};
use isospan_io::error::Result;

/// Opens the data of steps.
pub(super) trait Fields {
    /// That of the `n`-th step of the plan.
    fn open<'a>(&'a self, series: &SeriesPlan, n: usize) -> Result<Field<'a>>;

    /// The mesh whose own tetrahedra are kept, where they are.
    fn own(&self) -> Option<OwnMesh<'_>> {
        None
    }
}
