//! Polyhedra: cells with any number of faces, each with any number of vertices.
//!
//! A star from a vertex, as of other kinds ([`split`](mod@super::split)), does not fill them: faces
//! may have vertices on straight edges (of meshes that are refined in places), and a cell need not
//! be seen whole from a vertex. So a polyhedron is the cone of a vertex in its middle over all of
//! its faces, and a face is cut by a rule that depends on the face alone, so that neighbours agree:
//!
//! | face | cut |
//! |---|---|
//! | triangle | not |
//! | four vertices | from the smallest one, as of other kinds; or from its bent corner |
//! | more | around a vertex in its middle |
//!
//! A *bent corner* is straight or points inwards. Only a cut from there has no flat triangle.
//!
//! ```text
//!   d-------c      d-------c        e---d---c
//!   |     / |      |     / |        |\  |  /|
//!   |   /   |      |   /   |        |  \m/  |      a is the smallest; h lies on the edge a-b
//!   | /     |      | /     |        | / | \ |
//!   a-------b      h---a---b …      a---h---b
//! ```
//!
//! A vertex in the middle is the mean of those of its cell or face, each once: in position and in
//! value. So a linear field stays linear. Who has positions and values at hand makes them
//! (`domain`); this module knows numbers, and checks that the faces of a cell close.
//!
//! All faces of a convex cell are seen from the mean of its vertices. Of other cells some may not
//! be: their tetrahedra are turned over, and are treated as those of other kinds.

use super::orient::{Orientation, orient};
use super::star::{CellTet, drop_collapsed};

/// A corner is straight if the sine of the turn there is less than this: one degree.
const STRAIGHT: f64 = 0.0175;

/// The faces of a polyhedron, as a [`CellBlock`](super::CellBlock) has them.
#[derive(Clone, Debug)]
pub struct Faces<'a>(&'a [u64]);

impl<'a> Faces<'a> {
    /// Takes what a block has of a polyhedron: for each face its number of vertices, then these.
    pub fn new(numbers: &'a [u64]) -> Self {
        Self(numbers)
    }
}

impl<'a> Iterator for Faces<'a> {
    type Item = &'a [u64];

    fn next(&mut self) -> Option<&'a [u64]> {
        let (count, rest) = self.0.split_first()?;
        let (face, rest) = rest.split_at(*count as usize);
        self.0 = rest;
        Some(face)
    }
}

/// Puts the vertices of some faces into `out` (cleared first), ascending, each once.
pub fn distinct<'a>(faces: impl Iterator<Item = &'a [u64]>, out: &mut Vec<u64>) {
    out.clear();
    faces.for_each(|face| out.extend_from_slice(face));
    out.sort_unstable();
    out.dedup();
}

/// How many tetrahedra a polyhedron is split into.
pub fn tetrahedra_of(faces: Faces<'_>) -> u64 {
    faces.map(|face| if face.len() > 4 { face.len() } else { face.len() - 2 } as u64).sum()
}

/// What is wrong with a polyhedron: what was expected, and what was found.
pub(super) type Wrong = (&'static str, String);

/// Checks the faces of a polyhedron, and turns them so that all are seen anticlockwise from one
/// side: each edge is run along once in each direction.
///
/// # Errors
/// Where the faces are too few or too small, name a vertex twice, or are not the surface of a body.
pub(super) fn check(numbers: &mut [u64]) -> Result<(), Wrong> {
    let count = Faces::new(numbers).count();
    if count < 4 {
        return Err(("at least 4 faces of a polyhedron", count.to_string()));
    }
    // Both vertices, the face, whether it runs upwards.
    let mut edges: Vec<(u64, u64, usize, bool)> = vec![];
    let mut sorted = vec![];
    for (number, face) in Faces::new(numbers).enumerate() {
        if face.len() < 3 {
            return Err(("at least 3 points of a face", format!("{} of face {number}", face.len())));
        }
        distinct(std::iter::once(face), &mut sorted);
        if sorted.len() < face.len() {
            return Err(("faces whose points differ", format!("face {number} with a point twice")));
        }
        for (i, &a) in face.iter().enumerate() {
            let b = face[(i + 1) % face.len()];
            edges.push((a.min(b), a.max(b), number, a < b));
        }
    }
    edges.sort_unstable();
    let mut sides = Sides { parents: (0..count).map(|face| (face, false)).collect() };
    let mut bodies = count;
    for same in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let &[(_, _, f, up), (_, _, g, also_up)] = same else {
            let (a, b, ..) = same[0];
            let got = format!("the edge of points {a} and {b} in {}", same.len());
            return Err(("faces that close: each edge in two of them", got));
        };
        match sides.join(f, g, up == also_up) {
            JoinedFaces::First => bodies -= 1,
            JoinedFaces::Again => {}
            JoinedFaces::Otherwise => {
                return Err(("faces that are the surface of a body", "a surface with one side".into()));
            }
        }
    }
    if bodies > 1 {
        return Err(("faces that hang together", format!("{bodies} surfaces")));
    }
    let mut at = 0;
    for face in 0..count {
        let n = numbers[at] as usize;
        if sides.of(face).1 {
            numbers[at + 1..=at + n].reverse();
        }
        at += n + 1;
    }
    Ok(())
}

/// Faces that hang together by edges: for each another one, in the end the same for all, and
/// whether it is turned the other way.
struct Sides {
    parents: Vec<(usize, bool)>,
}

enum JoinedFaces {
    First,
    Again,
    /// Against what is known.
    Otherwise,
}

impl Sides {
    fn of(&mut self, face: usize) -> (usize, bool) {
        let (mut root, mut turned) = (face, false);
        while self.parents[root].0 != root {
            turned ^= self.parents[root].1;
            root = self.parents[root].0;
        }
        // Later searches are short.
        let (mut at, mut rest) = (face, turned);
        while self.parents[at].0 != root && at != root {
            let (next, step) = std::mem::replace(&mut self.parents[at], (root, rest));
            (at, rest) = (next, rest ^ step);
        }
        (root, turned)
    }

    fn join(&mut self, a: usize, b: usize, turned: bool) -> JoinedFaces {
        let ((a, a_turned), (b, b_turned)) = (self.of(a), self.of(b));
        let turned = turned ^ a_turned ^ b_turned;
        if a == b {
            return if turned { JoinedFaces::Otherwise } else { JoinedFaces::Again };
        }
        // The first face is the root of all in the end, and so stays as it is.
        self.parents[a.max(b)] = (a.min(b), turned);
        JoinedFaces::First
    }
}

/// How a face is cut into triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// From its vertex with the smallest number.
    Smallest,
    /// From the vertex at this place in the face.
    From(usize),
    /// Around a vertex in its middle, of this number.
    Around(u64),
}

/// Appends the tetrahedra of an apex and the triangles of a face, positively oriented where the
/// face is seen anticlockwise from outside. Gives the number of those that were left out because
/// they name a vertex twice.
pub fn cone(apex: u64, face: &[u64], cut: Cut, out: &mut Vec<CellTet>) -> usize {
    let (start, n) = (out.len(), face.len());
    let from = match cut {
        Cut::Around(middle) => {
            out.extend((0..n).map(|i| [apex, middle, face[i], face[(i + 1) % n]]));
            return drop_collapsed(start, out);
        }
        Cut::From(from) => from,
        Cut::Smallest => (0..n).min_by_key(|&i| face[i]).unwrap_or(0),
    };
    let at = |step: usize| face[(from + step) % n];
    out.extend((1..n.max(1) - 1).map(|step| [apex, at(0), at(step), at(step + 1)]));
    drop_collapsed(start, out)
}

/// The corner of a face of four vertices that is straight, or points inwards: where the face must
/// be cut from. At most one of a face that does not cross itself. The same from both sides of the
/// face.
pub fn bent_corner(face: &[u64], place: impl Fn(u64) -> [f64; 3]) -> Option<usize> {
    let least = (0..4).min_by_key(|&i| face[i])?;
    // From the smallest vertex on, towards the smaller one of its neighbours: rounding is the same
    // from both sides.
    let step = if face[(least + 1) % 4] < face[(least + 3) % 4] { 1 } else { 3 };
    let order: [usize; 4] = std::array::from_fn(|i| (least + i * step) % 4);
    let p = order.map(|i| place(face[i]));
    let minus = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| a[k] - b[k]) };
    let cross = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let length = |a: [f64; 3]| dot(a, a).sqrt();
    let normal = cross(minus(p[2], p[0]), minus(p[3], p[1]));
    let sine = |i: usize| {
        let (to, on) = (minus(p[i], p[(i + 3) % 4]), minus(p[(i + 1) % 4], p[i]));
        let sine = dot(cross(to, on), normal) / (length(to) * length(on) * length(normal));
        match sine {
            // An edge without a length.
            _ if sine.is_nan() => -1.0,
            // The tip of a needle is not straight.
            0.0.. if dot(to, on) <= 0.0 => 1.0,
            _ => sine,
        }
    };
    let sines: [f64; 4] = std::array::from_fn(sine);
    let bent = (0..4).min_by(|&a, &b| sines[a].total_cmp(&sines[b]))?;
    (sines[bent] < STRAIGHT).then_some(order[bent])
}

/// Whether the tetrahedra of a polyhedron are turned both ways.
pub(super) fn is_folded(faces: Faces<'_>, place: impl Fn(u64) -> [f64; 3]) -> bool {
    let mean = |of: &[u64]| -> [f64; 3] {
        std::array::from_fn(|k| of.iter().map(|&v| place(v)[k]).sum::<f64>() / of.len() as f64)
    };
    let (mut vertices, mut tets, mut seen) = (vec![], vec![], [false; 2]);
    distinct(faces.clone(), &mut vertices);
    let middle = mean(&vertices);
    // Numbers of vertices in the middle; no point of a file has them.
    const CELL: u64 = u64::MAX;
    const FACE: u64 = u64::MAX - 1;
    for face in faces {
        let (cut, of_face) = match face.len() {
            4 => (bent_corner(face, &place).map_or(Cut::Smallest, Cut::From), middle),
            5.. => (Cut::Around(FACE), mean(face)),
            _ => (Cut::Smallest, middle),
        };
        tets.clear();
        cone(CELL, face, cut, &mut tets);
        for tet in &tets {
            let turned = orient(tet.map(|v| match v {
                CELL => middle,
                FACE => of_face,
                v => place(v),
            }));
            seen[0] |= turned == Orientation::Positive;
            seen[1] |= turned == Orientation::Inverted;
        }
    }
    seen == [true; 2]
}

#[cfg(test)]
mod tests;
