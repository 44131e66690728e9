//! Vertices moved within their cells, so that steps of voxels become smooth walls.
//!
//! Taubin's filter: each vertex moves a part of the way to the mean of its neighbours, then a
//! little more away from it, which keeps volumes about as they are (Taubin, SIGGRAPH 1995). A
//! neighbour is a vertex of a cell with a common face where labels differ. Where three labels or
//! more meet, only neighbours along that line count, so it becomes smooth too. What lies on a face
//! of the domain stays in its plane.
//!
//! A step reaches as far as one cell, and all vertices move at the same time. So a vertex is the
//! same in every block that has as many cells around it as there are steps.

use super::LabelBlock;

/// Parts of the way, in turn.
const PARTS: [f32; 2] = [0.33, -0.34];
/// The most that a vertex moves along an axis, in cells: it stays away from its neighbours' cells.
const MOST: f32 = 0.48;
/// Units of an offset in a cell.
pub(super) const UNITS: f32 = 65536.0;
/// No vertex, and no neighbour.
const NONE: u32 = u32::MAX;

/// Where vertices are in their cells.
pub(super) struct Offsets {
    /// The vertex of each cell, at the place of its first node; empty where none was moved.
    numbers: Vec<u32>,
    moved: Vec<[i16; 3]>,
}

impl Offsets {
    /// The vertices of a block of a grid of so many nodes, after some steps.
    pub(super) fn after(steps: u32, block: &LabelBlock<'_>, grid: [u64; 3]) -> Self {
        if steps == 0 {
            return Self { numbers: vec![], moved: vec![] };
        }
        let (numbers, cells) = vertices(block);
        let around: Vec<[u32; 6]> =
            cells.iter().map(|&cell| neighbours(block, &numbers, cell, grid)).collect();
        let held: Vec<[bool; 3]> = cells.iter().map(|&cell| at_ends(block, cell, grid)).collect();
        let mut at = vec![[0.0f32; 3]; cells.len()];
        let mut next = at.clone();
        for step in 0..steps {
            let part = PARTS[step as usize % 2];
            for (n, to) in next.iter_mut().enumerate() {
                *to = moved(at[n], &around[n], &held[n], &at, part);
            }
            std::mem::swap(&mut at, &mut next);
        }
        let moved = at.iter().map(|p| p.map(|x| (x * UNITS).round() as i16)).collect();
        Self { numbers, moved }
    }

    /// The offset of the vertex of a cell from its middle.
    pub(super) fn of(&self, cell: usize) -> [i16; 3] {
        let number = self.numbers.get(cell).copied().unwrap_or(NONE);
        self.moved.get(number as usize).copied().unwrap_or_default()
    }
}

/// The number of the vertex of each cell in which labels differ, and these cells.
fn vertices(block: &LabelBlock<'_>) -> (Vec<u32>, Vec<usize>) {
    let (mut numbers, mut cells) = (vec![NONE; block.labels.len()], vec![]);
    let [nx, ny, nz] = block.size;
    for z in 0..nz - 1 {
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                let cell = block.index([x, y, z]);
                let first = block.labels[cell];
                if (1..8).any(|corner| block.corner(cell, corner) != first) {
                    numbers[cell] = cells.len() as u32;
                    cells.push(cell);
                }
            }
        }
    }
    (numbers, cells)
}

/// On which axes the vertex of a cell lies on a face of the domain.
fn at_ends(block: &LabelBlock<'_>, cell: usize, grid: [u64; 3]) -> [bool; 3] {
    let place = block.cell_place(cell);
    [0, 1, 2].map(|a| place[a] == 0 || place[a] == grid[a] as i64)
}

/// The neighbours of the vertex of a cell: before and after it along x, y and z.
fn neighbours(block: &LabelBlock<'_>, numbers: &[u32], cell: usize, grid: [u64; 3]) -> [u32; 6] {
    let (stride, local) = (block.stride(), block.local(cell));
    let held = at_ends(block, cell, grid);
    let labels: [usize; 6] = std::array::from_fn(|face| labels_of_face(block, cell, face));
    // A vertex on a line on which labels meet has two neighbours on it, or more.
    let on_line = labels.iter().filter(|n| **n > 2).count() >= 2;
    std::array::from_fn(|face| {
        let (axis, is_far) = (face / 2, face % 2 == 1);
        let is_there = if is_far { local[axis] + 2 < block.size[axis] } else { local[axis] > 0 };
        let joins = if on_line { labels[face] > 2 } else { labels[face] > 1 };
        match is_there && joins && !held[axis] {
            true if is_far => numbers[cell + stride[axis]],
            true => numbers[cell - stride[axis]],
            false => NONE,
        }
    })
}

/// How many labels the four corners of a face of a cell have; what is outside counts as one.
fn labels_of_face(block: &LabelBlock<'_>, cell: usize, face: usize) -> usize {
    let (axis, far) = (face / 2, face % 2);
    let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
    let corner = |u: usize, v: usize| block.corner(cell, far << axis | u << b | v << c);
    let four = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
    (0..4).filter(|&k| !four[..k].contains(&four[k])).count()
}

/// Where a vertex moves.
fn moved(at: [f32; 3], around: &[u32; 6], held: &[bool; 3], all: &[[f32; 3]], part: f32) -> [f32; 3] {
    let (mut sum, mut count) = ([0.0f32; 3], 0u8);
    for (face, &other) in around.iter().enumerate() {
        let Some(other) = all.get(other as usize) else { continue };
        for (sum, x) in sum.iter_mut().zip(other) {
            *sum += x;
        }
        sum[face / 2] += if face % 2 == 1 { 1.0 } else { -1.0 };
        count += 1;
    }
    if count == 0 {
        return at;
    }
    std::array::from_fn(|a| {
        let mean = sum[a] / f32::from(count);
        if held[a] { 0.0 } else { (at[a] + part * (mean - at[a])).clamp(-MOST, MOST) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::nets::NO_LABEL;

    #[test]
    fn steps_of_voxels_become_flat_and_ends_stay() {
        // A slope: a step up every four nodes; outside around it.
        let n = 26;
        let mut labels = vec![NO_LABEL; n * n * n];
        for (i, label) in labels.iter_mut().enumerate() {
            let [x, y, z] = [i % n, i / n % n, i / n / n];
            if [x, y, z].iter().all(|c| (1..n - 1).contains(c)) {
                *label = i32::from(y < 8 + x / 4);
            }
        }
        let block = LabelBlock { start: [-1; 3], size: [n; 3], labels: &labels };
        let offsets = Offsets::after(20, &block, [n as u64 - 2; 3]);
        let is_wall = |cell: &usize| {
            let has = |label| (0..8).any(|k| block.corner(*cell, k) == label);
            let inner = block.local(*cell).iter().all(|c| (6..18).contains(c));
            inner && has(0) && has(1)
        };
        // How far vertices of the wall are from a plane, before and after.
        let above = |cell: usize, part: f32| {
            let (at, offset) = (block.local(cell), offsets.of(cell));
            let place = |a: usize| at[a] as f32 + part * f32::from(offset[a]) / UNITS;
            place(1) - place(0) / 4.0
        };
        let spread = |part: f32| {
            let all: Vec<f32> = (0..labels.len()).filter(is_wall).map(|cell| above(cell, part)).collect();
            all.iter().copied().fold(f32::MIN, f32::max) - all.iter().copied().fold(f32::MAX, f32::min)
        };
        assert!(spread(1.0) < 0.7 * spread(0.0), "{} {}", spread(0.0), spread(1.0));
        // On the face of the domain.
        assert!((0..n - 1).all(|y| offsets.of(block.index([12, y, 0]))[2] == 0));
    }
}
