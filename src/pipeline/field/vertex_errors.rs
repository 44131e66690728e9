//! Errors at the vertices of a mesh, as they are reported.

use crate::archive::manifest::Source;
use crate::domain::store::CellStore;
use crate::measure::{ErrorSums, FieldError, LevelError, Worst};
use crate::pipeline::read::StepView;
use isospan_io::error::{Error, Result};
use isospan_io::geom::LatticePos;
use isospan_mesh::locate::{FINE_BITS, FinePos};

/// The errors of a step: that of the field and, for a mesh whose points have levels, those at the
/// vertices in the cells of each level.
pub(in crate::pipeline) type StepErrors = (FieldError, Vec<LevelError>);

/// The error of a mesh of the archive's size whose vertices are others.
pub(super) fn other_mesh(archive: &StepView) -> Error {
    let expected = "the mesh that it keeps";
    Error::bad_input(archive.path(), "vertices", expected, "a mesh with others")
        .with_help(format!("the archive was made from {}", archive.step().plan.source.path))
}

/// A position of a mesh on the lattice.
pub(super) fn on_lattice(p: FinePos) -> LatticePos {
    // The frame's box ends at whole lattice steps, so no position is rounded out of it.
    p.map(|c| ((c + (1 << (FINE_BITS - 1))) >> FINE_BITS) as u32)
}

/// The errors at the vertices, as they are reported. Steps are given by positions in the manifest;
/// `columns` has their values, `beyond` their numbers of vertices outside.
pub(super) fn reported_errors(
    archive: &StepView,
    store: &CellStore,
    steps: &[usize],
    columns: &[&[f32]],
    sums: &[(ErrorSums, Vec<ErrorSums>)],
    beyond: &[u64],
) -> Result<Vec<StepErrors>> {
    let positions = store.positions.get()?;
    let mut errors = vec![];
    for (n, (&position, (sums, of_levels))) in steps.iter().zip(sums).enumerate() {
        let source = &archive.manifest.steps[position].plan.source;
        let of_level = |sums: &ErrorSums| sums.level_error().with_rounding(source.rounding);
        let mut error = vertex_error(store, positions, sums, source);
        error.source_range = range_of(columns[n]).map(|r| r.map(|v| f64::from(v) + source.offset));
        error.beyond = beyond[n];
        errors.push((error, of_levels.iter().map(of_level).collect()));
    }
    Ok(errors)
}

/// The least and the largest value at the vertices of a mesh, those outside of all tetrahedra
/// included.
fn range_of(values: &[f32]) -> Option<[f32; 2]> {
    let all = values.iter().filter(|v| v.is_finite()).map(|v| v + 0.0);
    all.fold(None, |range: Option<[f32; 2]>, v| Some(range.map_or([v; 2], |[lo, hi]| [lo.min(v), hi.max(v)])))
}

/// The error of a step at all vertices, and where it is largest.
fn vertex_error(store: &CellStore, positions: &[FinePos], sums: &ErrorSums, source: &Source) -> FieldError {
    let mut error = sums.field_error(store.census.vertices);
    error.worst = sums.largest().map(|l| {
        let log2_steps = store.frame.lattice.log2_steps;
        let steps = log2_steps.map(|s| f64::from(1u32 << FINE_BITS) * f64::from(1u32 << s));
        let p = positions[l.sample as usize];
        let ijk = std::array::from_fn(|a| p[a] as f64 / steps[a]);
        Worst {
            sample: l.sample,
            index: None,
            world: store.frame.geometry.to_world(ijk),
            original: source.in_file(l.original),
            reduced: source.in_file(l.reduced),
        }
    });
    error.of_source(source.offset, source.rounding)
}
