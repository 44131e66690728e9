//! The connected pieces of a phase, plane by plane.

use super::map::{Phase, PhaseMap, WORD};
use isospan_io::error::Result;
use isospan_io::exec::CancelToken;

/// How a phase hangs together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Connected {
    /// Connected pieces.
    pub pieces: u64,
    /// Whether one of them joins the two faces of the grid across x, y, z.
    pub percolates: [bool; 3],
    /// Nodes.
    pub nodes: u64,
}

/// Neighbouring nodes of a row that are in the phase, from the first to past the last.
#[derive(Clone, Copy, Debug)]
struct Run {
    start: u32,
    end: u32,
    piece: u32,
}

/// The runs of a plane.
#[derive(Debug, Default)]
struct Plane {
    runs: Vec<Run>,
    /// Where the runs of each row begin, and where the last ones end.
    rows: Vec<usize>,
}

impl Plane {
    fn row(&self, y: usize) -> &[Run] {
        &self.runs[self.rows[y]..self.rows[y + 1]]
    }
}

/// Pieces that may still grow.
#[derive(Debug, Default)]
struct GrowingPieces {
    parents: Vec<u32>,
    /// Which faces of the grid each root touches, a bit each: 2a is the lower one of axis a.
    faces: Vec<u8>,
}

impl GrowingPieces {
    fn add(&mut self, faces: u8) -> u32 {
        self.parents.push(self.parents.len() as u32);
        self.faces.push(faces);
        self.parents.len() as u32 - 1
    }

    fn root(&mut self, mut piece: u32) -> u32 {
        while self.parents[piece as usize] != piece {
            let above = self.parents[self.parents[piece as usize] as usize];
            self.parents[piece as usize] = above;
            piece = above;
        }
        piece
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        let (low, high) = (a.min(b), a.max(b));
        self.parents[high as usize] = low;
        self.faces[low as usize] |= self.faces[high as usize];
    }

    /// Joins the runs of two rows that touch: runs `reach` nodes apart touch, too.
    fn join_rows(&mut self, a: &[Run], b: &[Run], reach: u32) {
        let (mut i, mut j) = (0, 0);
        while let (Some(x), Some(y)) = (a.get(i), b.get(j)) {
            if x.start < y.end + reach && y.start < x.end + reach {
                self.join(x.piece, y.piece);
            }
            if x.end < y.end { i += 1 } else { j += 1 }
        }
    }
}

/// How a phase hangs together: see [`crate::phase`].
///
/// # Errors
/// Those of the scratch folder; [`crate::Error::Cancelled`].
pub fn connected(map: &PhaseMap, phase: Phase, cancel: &CancelToken) -> Result<Connected> {
    let [_, ny, nz] = map.dims();
    let by_diagonals = phase == Phase::Below;
    let (mut pieces, mut bits, mut out) = (GrowingPieces::default(), vec![], Connected::default());
    let (mut below, mut plane) = (Plane::default(), Plane::default());
    for z in 0..nz {
        cancel.check()?;
        map.plane(phase, z, &mut bits)?;
        list_runs(&bits, map, z, &mut plane, &mut pieces);
        out.nodes += plane.runs.iter().map(|run| u64::from(run.end - run.start)).sum::<u64>();
        let reach = u32::from(by_diagonals);
        for y in 0..ny {
            if y > 0 {
                pieces.join_rows(plane.row(y), plane.row(y - 1), reach);
            }
            if z == 0 {
                continue;
            }
            pieces.join_rows(plane.row(y), below.row(y), reach);
            if by_diagonals && y > 0 {
                pieces.join_rows(plane.row(y), below.row(y - 1), 0);
                pieces.join_rows(plane.row(y - 1), below.row(y), 0);
            }
        }
        end_pieces(&mut pieces, &mut plane.runs, &mut out);
        std::mem::swap(&mut below, &mut plane);
    }
    end_pieces(&mut pieces, &mut [], &mut out);
    Ok(out)
}

/// Lists the runs of a plane, each a piece of its own.
fn list_runs(bits: &[u64], map: &PhaseMap, z: usize, plane: &mut Plane, pieces: &mut GrowingPieces) {
    let [nx, ny, nz] = map.dims();
    plane.runs.clear();
    plane.rows.clear();
    let of_plane = u8::from(z == 0) << 4 | u8::from(z + 1 == nz) << 5;
    for y in 0..ny {
        plane.rows.push(plane.runs.len());
        let of_row = of_plane | u8::from(y == 0) << 2 | u8::from(y + 1 == ny) << 3;
        let row = &bits[y * map.words()..][..map.words()];
        let mut x = next(row, 0, true, nx);
        while x < nx {
            let end = next(row, x, false, nx);
            let piece = pieces.add(of_row | u8::from(x == 0) | u8::from(end == nx) << 1);
            plane.runs.push(Run { start: x as u32, end: end as u32, piece });
            x = next(row, end, true, nx);
        }
    }
    plane.rows.push(plane.runs.len());
}

/// The first place of a row from `x` on at which a bit is set, or is not; `nx` where there is none.
fn next(row: &[u64], x: usize, is_set: bool, nx: usize) -> usize {
    let mut at = x;
    while at < nx {
        let word = if is_set { row[at / WORD] } else { !row[at / WORD] };
        let rest = word >> (at % WORD);
        if rest != 0 {
            return nx.min(at + rest.trailing_zeros() as usize);
        }
        at = (at / WORD + 1) * WORD;
    }
    nx
}

/// Counts the pieces that the runs of the last plane do not have, and numbers the others anew.
fn end_pieces(pieces: &mut GrowingPieces, runs: &mut [Run], out: &mut Connected) {
    const ENDED: u32 = u32::MAX;
    let mut numbers = vec![ENDED; pieces.parents.len()];
    let mut kept = GrowingPieces::default();
    for run in runs {
        let root = pieces.root(run.piece) as usize;
        if numbers[root] == ENDED {
            numbers[root] = kept.add(pieces.faces[root]);
        }
        run.piece = numbers[root];
    }
    for (root, number) in numbers.iter().enumerate() {
        if pieces.parents[root] as usize == root && *number == ENDED {
            out.pieces += 1;
            let joins = |a: usize| pieces.faces[root] >> (2 * a) & 3 == 3;
            (0..3).for_each(|a| out.percolates[a] |= joins(a));
        }
    }
    *pieces = kept;
}
