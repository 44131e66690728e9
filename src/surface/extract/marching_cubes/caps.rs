//! Closing the surface of cubes where the grid ends: the inside part of each square there.
//!
//! The normal of a cap's corner is that of the face; on an edge of the grid it is the mean of two.
//! A vertex of the rim gets the same normal: see [`crate::surface::extract::cap`].

use super::cases::{CAPS, FACES};
use super::{March, Slot};
use std::ops::Range;

impl March<'_> {
    /// Adds the caps of the layer's cells.
    pub(super) fn add_caps(&mut self) {
        for face in 0..FACES.len() {
            let (axis, is_upper) = (face / 2, face % 2 == 1);
            let [lo, hi] = self.block.cells[axis];
            let (is_last, last) = (hi + 1 == self.block.grid[axis], self.cells[axis] - 1);
            let at = if is_upper { last } else { 0 };
            let touches = if is_upper { is_last } else { lo == 0 };
            if !touches || (axis == 2 && self.layer.z != at) {
                continue;
            }
            let along = |k: usize| if k == axis { at..at + 1 } else { 0..self.cells[k] };
            self.add_caps_of(face, along(0), along(1));
        }
    }

    /// Adds the caps on a face of cells.
    fn add_caps_of(&mut self, face: usize, x: Range<usize>, y: Range<usize>) {
        let corners = FACES[face].corners;
        for y in y {
            for x in x.clone() {
                let Some(mask) = self.mask_at(x, y) else { continue };
                let square = (0..4).fold(0, |square, i| square | usize::from(mask >> corners[i] & 1) << i);
                self.add_cap(x, y, face, square);
            }
        }
    }

    /// The corners inside of a cell; `None` of a void one.
    fn mask_at(&self, x: usize, y: usize) -> Option<u8> {
        let (mut mask, mut is_void) = (0, false);
        for (n, (plane, row)) in self.rows(y).into_iter().enumerate() {
            for (dx, x) in [x, x + 1].into_iter().enumerate() {
                let (word, bit) = (row + x / 64, x % 64);
                mask |= ((plane.inside[word] >> bit & 1) as u8) << (2 * n + dx);
                is_void |= plane.missing[word] >> bit & 1 == 1;
            }
        }
        (!is_void).then_some(mask)
    }

    fn add_cap(&mut self, x: usize, y: usize, face: usize, square: usize) {
        let cap = &CAPS[square];
        for corners in &cap.corners[..usize::from(cap.triangles)] {
            let triangle = corners.map(|corner| match corner {
                0..4 => self.vertex_of_node(x, y, FACES[face].corners[usize::from(corner)]),
                _ => self.vertex_of_edge(x, y, FACES[face].edges[usize::from(corner - 4)]),
            });
            self.out.triangles.push(triangle);
        }
    }

    /// The vertex at a corner of a cell of this layer.
    fn vertex_of_node(&mut self, x: usize, y: usize, corner: u8) -> u32 {
        let Slot { at, above } = self.layer.nodes[usize::from(corner)];
        let at = at + y * self.row + x;
        let known = self.vertices[at];
        if known > above {
            return known - 1;
        }
        let bit = |k: usize| usize::from(corner >> k & 1);
        let number = self.push_node([x + bit(0), y + bit(1), self.layer.z + bit(2)]);
        self.vertices[at] = number + 1;
        number
    }
}
