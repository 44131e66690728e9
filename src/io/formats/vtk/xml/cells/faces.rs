//! The faces of polyhedra, in either of VTK's two ways of telling them.
//!
//! ```text
//!  until 9.3  faces                of each polyhedron: number of faces, then the faces:
//!                                  of each its number of points, and these
//!             faceoffsets          where those of each cell end in faces; -1 of other cells
//!
//!  from 9.4   face_connectivity    the points of all faces
//!             face_offsets         where the points of each face end
//!             polyhedron_to_faces  the faces of all polyhedra, by their numbers
//!             polyhedron_offsets   where the faces of each cell end; other cells have none
//! ```
//!
//! All are read front to back, so the faces of the newer way must come in the order of the cells,
//! each of one cell, as VTK writes them: others are refused.

use super::{Ids, MOST_VERTICES, shown};
use crate::error::{Error, Result};

/// Names of arrays that only meshes with polyhedra have.
pub(super) const FACE_ARRAYS: [&str; 2] = ["faces", "polyhedron_offsets"];

/// What was expected, and what was found.
pub(super) type WrongFaces = (String, String);

/// Why faces are not read.
pub(super) enum Failed {
    /// They are wrong.
    Faces(WrongFaces),
    /// The array cannot be read.
    Reading(Error),
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self::Reading(error)
    }
}

/// What was read of faces.
type Read<T> = std::result::Result<T, Failed>;

fn wrong<T>(expected: impl Into<String>, got: impl Into<String>) -> Read<T> {
    Err(Failed::Faces((expected.into(), got.into())))
}

/// The arrays of faces of a piece.
pub(super) enum CellFaces {
    None,
    Old {
        faces: Ids,
        /// A number a cell.
        ends: Ids,
        /// Numbers of `faces` that were read.
        at: u64,
    },
    New {
        connectivity: Ids,
        offsets: Ids,
        of_cells: Ids,
        /// A number a cell.
        ends: Ids,
        /// Faces that were read.
        at: u64,
        /// Numbers of `connectivity` that were read.
        point: u64,
    },
}

impl CellFaces {
    /// Opens the arrays of a piece: `has` says whether it has one, `open` opens one of as many
    /// numbers as are told, or as it has.
    pub(super) fn open(
        has: impl Fn(&str) -> bool,
        cells: u64,
        open: impl Fn(&str, Option<u64>) -> Result<Ids>,
    ) -> Result<Self> {
        if has("faces") {
            let (faces, ends) = (open("faces", None)?, open("faceoffsets", Some(cells))?);
            return Ok(Self::Old { faces, ends, at: 0 });
        }
        if has("polyhedron_offsets") {
            return Ok(Self::New {
                connectivity: open("face_connectivity", None)?,
                offsets: open("face_offsets", None)?,
                of_cells: open("polyhedron_to_faces", None)?,
                ends: open("polyhedron_offsets", Some(cells))?,
                at: 0,
                point: 0,
            });
        }
        Ok(Self::None)
    }

    /// Must be called after the last cell.
    pub(super) fn finish(&mut self) -> Result<()> {
        let all = match self {
            Self::None => vec![],
            Self::Old { faces, ends, .. } => vec![faces, ends],
            Self::New { connectivity, offsets, of_cells, ends, .. } => {
                vec![connectivity, offsets, of_cells, ends]
            }
        };
        all.into_iter().try_for_each(|ids| ids.stream.finish())
    }

    /// Puts where the faces of the next `n` cells end into `out` (cleared first).
    pub(super) fn read_ends(&mut self, n: usize, bytes: &mut Vec<u8>, out: &mut Vec<u64>) -> Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Old { ends, .. } | Self::New { ends, .. } => ends.read(n, bytes, out),
        }
    }

    /// Goes over the `i`-th of some cells, which is no polyhedron.
    pub(super) fn pass(&self, ends: &[u64], i: usize) -> std::result::Result<(), WrongFaces> {
        let has_none = match self {
            Self::None => true,
            // Some writers repeat the last end.
            Self::Old { at, .. } => ends[i] == u64::MAX || ends[i] <= *at,
            Self::New { at, .. } => ends[i] == *at,
        };
        if has_none {
            return Ok(());
        }
        Err((
            "no faces of a cell that is no polyhedron".into(),
            format!("faces that end at {}", shown(ends[i])),
        ))
    }

    /// Puts the faces of the `i`-th of some cells, a polyhedron, into `out`: of each its number of
    /// points, then these.
    pub(super) fn read(
        &mut self,
        ends: &[u64],
        i: usize,
        bytes: &mut Vec<u8>,
        out: &mut Vec<u64>,
    ) -> Read<()> {
        match self {
            Self::None => wrong(
                "the faces of a polyhedron, in the arrays 'faces' or 'polyhedron_offsets'",
                "neither of these",
            ),
            Self::Old { faces, at, .. } => {
                let span = span(*at, ends[i], "numbers of the faces of a polyhedron")?;
                let mut numbers = vec![];
                faces.read(span, bytes, &mut numbers)?;
                *at = ends[i];
                counted_faces(&numbers, out)
            }
            Self::New { connectivity, offsets, of_cells, at, point, .. } => {
                let count = span(*at, ends[i], "faces of a polyhedron")?;
                let (mut faces, mut face_ends, mut points) = (vec![], vec![], vec![]);
                of_cells.read(count, bytes, &mut faces)?;
                if let Some((face, next)) = faces.iter().zip(*at..).find(|(face, next)| **face != *next) {
                    let expected = format!("face {next}: each face of one cell, in the order of the cells");
                    return wrong(expected, shown(*face));
                }
                offsets.read(count, bytes, &mut face_ends)?;
                let all =
                    span(*point, *face_ends.last().unwrap_or(point), "points of faces of a polyhedron")?;
                connectivity.read(all, bytes, &mut points)?;
                let start = *point;
                for &end in &face_ends {
                    let n = span(*point, end, "points of a face")?;
                    let from = (*point - start) as usize;
                    let Some(of_face) = points.get(from..from + n) else {
                        return wrong("offsets of faces that ascend", end.to_string());
                    };
                    out.push(n as u64);
                    out.extend_from_slice(of_face);
                    *point = end;
                }
                *at = ends[i];
                Ok(())
            }
        }
    }
}

/// Puts the faces of a polyhedron, whose `numbers` begin with that of the faces, into `out`.
fn counted_faces(numbers: &[u64], out: &mut Vec<u64>) -> Read<()> {
    let Some((&count, mut rest)) = numbers.split_first() else {
        return wrong("the number of a polyhedron's faces", "none");
    };
    for face in 0..count {
        let Some((&n, after)) = rest.split_first() else {
            return wrong(format!("{} faces", shown(count)), format!("numbers of {face}"));
        };
        let Some(points) = usize::try_from(n).ok().and_then(|n| after.get(..n)) else {
            let expected = format!("a face of at most {} points, as many as are left", after.len());
            return wrong(expected, shown(n));
        };
        out.push(n);
        out.extend_from_slice(points);
        rest = &after[points.len()..];
    }
    if !rest.is_empty() {
        let got = format!("{} more numbers", rest.len());
        return wrong(format!("the end of a polyhedron of {count} faces"), got);
    }
    Ok(())
}

/// The length of a span that begins where the one before ended.
fn span(at: u64, end: u64, what: &str) -> Read<usize> {
    match end.checked_sub(at).filter(|_| end != u64::MAX) {
        None => wrong(format!("an end of {what} of {at} or more"), shown(end)),
        Some(n) if n > MOST_VERTICES => wrong(format!("at most {MOST_VERTICES} {what}"), n.to_string()),
        Some(n) => Ok(n as usize),
    }
}
