//! Which crossed edges of a cell have a vertex of a label's surface in common?
//!
//! Around a cell, the walls of a label are loops that cross its edges and faces. A face with the
//! label at two diagonal corners has two pieces of loops, which keep these corners apart; both
//! cells at the face see the same. A loop is a vertex, so the surface is the dual of that of
//! marching cubes, and touches itself nowhere, with one exception: where both pieces on a face
//! belong to one loop on either side of it, four quads would meet in an edge. On such a face, which
//! is *tied*, the pieces keep the other two corners apart (Wenger, Isosurfaces, section 3.4).

use std::sync::LazyLock;

/// No face.
pub(super) const NO_FACE: u8 = u8::MAX;

/// The loops of a mask of corners: bit i is the corner with x in bit 0 of i, y in bit 1, z in bit
/// 2.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loops {
    /// The loop of each edge that is crossed.
    of_edge: [u8; 12],
    /// The face whose two pieces belong to one loop: 2 · axis, and 1 more for the far one.
    pub(super) tied: u8,
}

impl Loops {
    /// The loop of an edge.
    pub(super) fn of(&self, edge: usize) -> u8 {
        self.of_edge[edge]
    }
}

/// The edge along an axis whose place is `u` along the next axis and `v` along the one after.
pub(super) fn edge_number(axis: usize, u: usize, v: usize) -> usize {
    4 * axis + u + 2 * v
}

/// The loops of a mask; if `is_turned`, with the pieces on its tied face the other way.
pub(super) fn loops(mask: u8, is_turned: bool) -> &'static Loops {
    static TABLE: LazyLock<Vec<[Loops; 2]>> = LazyLock::new(|| (0..=u8::MAX).map(of_mask).collect());
    &TABLE[usize::from(mask)][usize::from(is_turned)]
}

/// The loops of a mask, and those with its tied face turned.
fn of_mask(mask: u8) -> [Loops; 2] {
    let (of_edge, pieces) = joined(mask, 1);
    let is_tied = |p: &[[usize; 2]; 2]| of_edge[p[0][0]] == of_edge[p[1][0]];
    let tied = pieces.iter().position(|p| p.as_ref().is_some_and(is_tied));
    let tied = tied.map_or(NO_FACE, |face| face as u8);
    // A mask with a tied face has no other face with two pieces.
    let turned = if tied == NO_FACE { of_edge } else { joined(mask, 0).0 };
    [Loops { of_edge, tied }, Loops { of_edge: turned, tied }]
}

/// The two pieces on each face that has two: the edges that each joins.
type Pieces = [Option<[[usize; 2]; 2]>; 6];

/// The loop of each edge, where pieces on faces keep corners apart that are inside (1) or not (0).
fn joined(mask: u8, apart: u8) -> ([u8; 12], Pieces) {
    let inside = |corner: usize| mask >> corner & 1;
    let mut group: [usize; 12] = std::array::from_fn(|edge| edge);
    let mut pieces: Pieces = [None; 6];
    let mut join = |[a, b]: [usize; 2]| {
        let (from, to) = (group[a].max(group[b]), group[a].min(group[b]));
        group.iter_mut().filter(|g| **g == from).for_each(|g| *g = to);
    };
    for (face, pieces) in pieces.iter_mut().enumerate() {
        let (corners, edges) = around_face(face);
        let crossed = |k: &usize| inside(corners[*k]) != inside(corners[(*k + 1) % 4]);
        let found: Vec<usize> = (0..4).filter(crossed).collect();
        match found[..] {
            [a, b] => join([edges[a], edges[b]]),
            [_, _, _, _] => {
                let k = usize::from(inside(corners[0]) != apart);
                let two = [[edges[(k + 3) % 4], edges[k]], [edges[k + 1], edges[(k + 2) % 4]]];
                two.into_iter().for_each(&mut join);
                *pieces = Some(two);
            }
            _ => {}
        }
    }
    // Loops are numbered in the order of their first crossed edges.
    let (mut of_edge, mut seen) = ([0; 12], vec![]);
    for edge in (0..12).filter(|&edge| is_crossed(mask, edge)) {
        let known = seen.iter().position(|g| *g == group[edge]);
        of_edge[edge] = known.unwrap_or(seen.len()) as u8;
        if known.is_none() {
            seen.push(group[edge]);
        }
    }
    (of_edge, pieces)
}

fn is_crossed(mask: u8, edge: usize) -> bool {
    let axis = edge / 4;
    let corner = (edge % 4 % 2) << ((axis + 1) % 3) | (edge % 4 / 2) << ((axis + 2) % 3);
    mask >> corner & 1 != mask >> (corner | 1 << axis) & 1
}

/// The corners of a face in their order around it, and the edge from each to the next.
fn around_face(face: usize) -> ([usize; 4], [usize; 4]) {
    let (axis, far) = (face / 2, face % 2);
    let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
    let corner = |u: usize, v: usize| far << axis | u << b | v << c;
    let corners = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
    // Along b, an edge has its place along c and the axis; along c, along the axis and b.
    let edges =
        [edge_number(b, 0, far), edge_number(c, far, 1), edge_number(b, 1, far), edge_number(c, far, 0)];
    (corners, edges)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_has_at_most_four_loops_and_36_masks_have_a_tied_face() {
        let count = |mask: u8, turned: bool| {
            let crossed = (0..12).filter(|&edge| is_crossed(mask, edge));
            1 + crossed.map(|edge| loops(mask, turned).of(edge)).max().unwrap_or(0)
        };
        assert_eq!((0..=u8::MAX).map(|mask| count(mask, false)).max(), Some(4));
        let tied: Vec<u8> = (0..=u8::MAX).filter(|&mask| loops(mask, false).tied != NO_FACE).collect();
        assert_eq!(tied.len(), 36);
        // A tied face is the only one with two pieces, and turned it parts the loop.
        for mask in tied {
            assert_eq!(joined(mask, 1).1.iter().flatten().count(), 1, "{mask:08b}");
            assert_eq!((count(mask, false), count(mask, true)), (1, 2), "{mask:08b}");
        }
        // Two corners at the ends of a diagonal of a face, and of the cell.
        assert_eq!((count(0b1001, false), count(0b1000_0001, false)), (2, 2));
        // Edges join the corners that their numbers say.
        assert!(is_crossed(1, edge_number(0, 0, 0)) && !is_crossed(1, edge_number(0, 1, 0)));
        let (corners, edges) = around_face(5);
        for k in 0..4 {
            let both = 1u8 << corners[k] | 1 << corners[(k + 1) % 4];
            assert!(!is_crossed(both, edges[k]) && is_crossed(1 << corners[k], edges[k]));
        }
    }
}
