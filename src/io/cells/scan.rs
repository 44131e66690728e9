//! One pass over a mesh: bounds, cells by kind, ranges of fields. Memory: a block, and the window
//! of averaged cell data.

use super::polyhedron::{Faces, tetrahedra_of};
use super::quadratic::with_middles;
use super::{CellBlock, CellKind, CellMesh, split};
use crate::error::Result;
use serde::Serialize;
use std::collections::BTreeMap;

/// What the points and cells of a mesh tell.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeshScan {
    /// Smallest and largest coordinates; of a mesh without points, none.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Number of cells of each kind that occurs.
    pub kinds: BTreeMap<CellKind, u64>,
    /// Tetrahedra that the cells are split into.
    pub tetrahedra: u64,
    /// Cells marked as ghosts: copies of another piece's cells, or hidden.
    pub ghosts: u64,
    /// Tetrahedra left out because their cell names a vertex more than once.
    pub collapsed: u64,
}

/// Reads the points and the cells of a mesh once.
///
/// # Errors
/// Those of reading them.
pub fn scan(mesh: &CellMesh) -> Result<MeshScan> {
    let mut out = MeshScan { bounds: None, kinds: BTreeMap::new(), tetrahedra: 0, ghosts: 0, collapsed: 0 };
    let (mut points, mut block) = (mesh.points()?, vec![]);
    while points.next_block(&mut block)? {
        for p in &block {
            let [lo, hi] = out.bounds.get_or_insert([*p, *p]);
            for a in 0..3 {
                lo[a] = lo[a].min(p[a]);
                hi[a] = hi[a].max(p[a]);
            }
        }
    }
    let (mut cells, mut block, mut tets) = (mesh.cells()?, CellBlock::default(), vec![]);
    while cells.next_block(&mut block)? {
        for (kind, vertices) in block.iter() {
            *out.kinds.entry(kind).or_default() += 1;
            tets.clear();
            if kind == CellKind::Polyhedron {
                out.tetrahedra += tetrahedra_of(Faces::new(vertices));
                continue;
            }
            // Where its vertices lie decides nothing here.
            let (kind, all, _) = with_middles(kind, vertices, |_| [0.0; 3]);
            out.collapsed += split(kind, &all, &mut tets) as u64;
            out.tetrahedra += tets.len() as u64;
        }
    }
    out.ghosts = cells.ghosts();
    Ok(out)
}

/// What the stored numbers of a field tell: of its value, or its magnitude where it has several
/// components.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FieldScan {
    /// Least finite value; `None` if there is none.
    pub min: Option<f64>,
    /// Largest finite value.
    pub max: Option<f64>,
    /// Numbers that are NaN.
    pub nan: u64,
    /// Numbers that are infinite.
    pub infinite: u64,
}

/// Reads the field `info().fields[field]` once, as it is stored: cell data are not averaged.
///
/// # Errors
/// Those of reading it.
pub fn scan_field(mesh: &CellMesh, field: usize) -> Result<FieldScan> {
    let (mut values, mut block) = (mesh.stored(field)?, vec![]);
    let mut out = FieldScan { min: None, max: None, nan: 0, infinite: 0 };
    while values.next_block(&mut block)? {
        for &v in &block {
            if v.is_finite() {
                out.min = Some(out.min.map_or(v, |m| m.min(v)));
                out.max = Some(out.max.map_or(v, |m| m.max(v)));
            } else if v.is_nan() {
                out.nan += 1;
            } else {
                out.infinite += 1;
            }
        }
    }
    // A zero has no sign: which of two zeros is the lesser one differs from machine to machine.
    [out.min, out.max] = [out.min, out.max].map(|end| end.map(|v| v + 0.0));
    Ok(out)
}
