//! The windows of a volume, and which tetrahedra touch each.
//!
//! Windows are cubes of samples on a grid that belongs to the volume, not to a chunk. A window is
//! read where tetrahedra have samples: its box is cut to theirs. Where samples lie anywhere, as the
//! vertices of a mesh do, windows are bricks ([`BrickTets`]).

use isospan_io::exec::{Lent, Room};
use isospan_io::geom::LatticePos;
use isospan_io::grid::{BrickGrid, BrickId, IndexBox};
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::raster::{SampleGrid, greater, lesser};
use isospan_mesh::simd::with_vectors;

/// Samples along an edge of a window, at least: few tetrahedra then touch two of them.
const LEAST_EDGE: u64 = 32;

/// Samples along the edges of a window, where bricks have `brick` cells: a window is a brick, or
/// some of them together.
pub fn window_edge(brick: [f64; 3]) -> [u64; 3] {
    brick.map(|edge| {
        let edge = (edge.ceil() as u64).max(1);
        edge * LEAST_EDGE.div_ceil(edge)
    })
}

/// Three coordinates for each vertex, such as those of its window, and a 0: four are a vector.
type Places = [[u32; 4]];

/// Stands for the window of a tetrahedron that lies in several.
const SEVERAL: u32 = u32::MAX;

/// Tetrahedra, window by window: a counting sort.
#[derive(Debug)]
struct Sorted<'a> {
    /// The first window that a vertex lies in, and how many follow along each axis.
    lo: [u64; 3],
    dims: [u64; 3],
    /// End of each window's tetrahedra.
    ends: Vec<u32>,
    tets: Lent<'a, u32>,
}

impl<'a> Sorted<'a> {
    /// For vertices in these windows; without tetrahedra yet.
    #[inline(always)]
    fn around(at: &Places) -> Self {
        let (mut lo, mut hi) = ([u32::MAX; 4], [0; 4]);
        at.iter().for_each(|&w| (lo, hi) = (lesser(lo, w), greater(hi, w.map(|w| w + 1))));
        let dims = std::array::from_fn(|k| u64::from(hi[k].saturating_sub(lo[k])));
        let count = dims.iter().product::<u64>() as usize;
        Self {
            lo: [0, 1, 2].map(|k| u64::from(lo[k])),
            dims,
            ends: vec![0; count],
            tets: Room::none().lend(0, 0),
        }
    }

    /// Sorts tetrahedra, and calls `each` with each of them and its window, or [`SEVERAL`].
    #[inline(always)]
    fn sort(
        mut self,
        at: &Places,
        tets: &[Tet],
        room: &mut Room<'a>,
        mut each: impl FnMut(&Self, &Tet, u32),
    ) -> Self {
        let sorted = &mut self;
        let mut only = room.lend(tets.len(), SEVERAL);
        for (tet, only) in tets.iter().zip(&mut *only) {
            let [a, b, c, d] = tet.map(|v| at[v as usize]);
            if (a == b) & (a == c) & (a == d) {
                let n = sorted.number([0, 1, 2].map(|k| u64::from(a[k])));
                *only = n as u32;
                sorted.ends[n] += 1;
            } else {
                sorted.each_of(at, tet, |sorted, n| sorted.ends[n] += 1);
            }
            each(sorted, tet, *only);
        }
        let mut sum = 0;
        for n in &mut sorted.ends {
            sum += std::mem::replace(n, sum);
        }
        sorted.tets = room.lend(sum as usize, 0);
        let put = |sorted: &mut Self, n: usize, t: usize| {
            sorted.tets[sorted.ends[n] as usize] = t as u32;
            sorted.ends[n] += 1;
        };
        for (t, (tet, &only)) in tets.iter().zip(&*only).enumerate() {
            match only {
                SEVERAL => sorted.each_of(at, tet, |sorted, n| put(sorted, n, t)),
                n => put(sorted, n as usize, t),
            }
        }
        self
    }

    /// The tetrahedra of each window, ascending, x first.
    fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let starts = std::iter::once(&0).chain(&self.ends);
        starts.zip(&self.ends).map(|(&start, &end)| &self.tets[start as usize..end as usize])
    }

    #[inline(always)]
    fn number(&self, w: [u64; 3]) -> usize {
        let [x, y, z] = std::array::from_fn(|k| w[k] - self.lo[k]);
        ((z * self.dims[1] + y) * self.dims[0] + x) as usize
    }

    /// The coordinates of a window.
    fn coordinates(&self, number: usize) -> [u64; 3] {
        let (n, [x, y, _]) = (number as u64, self.dims);
        [self.lo[0] + n % x, self.lo[1] + n / x % y, self.lo[2] + n / x / y]
    }

    /// Calls `f` with the number of each window that a tetrahedron's bounding box touches.
    fn each_of(&mut self, at: &Places, tet: &Tet, mut f: impl FnMut(&mut Self, usize)) {
        let (lo, hi) = bounds(tet.map(|v| at[v as usize]));
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    let n = self.number([x, y, z].map(u64::from));
                    f(self, n);
                }
            }
        }
    }
}

/// Tetrahedra, brick by brick.
#[derive(Debug)]
pub struct BrickTets<'a> {
    bricks: BrickGrid,
    sorted: Sorted<'a>,
}

impl<'a> BrickTets<'a> {
    /// Sorts tetrahedra into the bricks that their bounding boxes touch. Time and memory also grow
    /// with the number of bricks that the box around all vertices touches.
    pub fn new(bricks: &BrickGrid, positions: &[LatticePos], tets: &[Tet], room: &mut Room<'a>) -> Self {
        // A volume has at most 2^24 + 1 samples along an axis.
        let brick = |&p: &LatticePos| bricks.brick_at(p).map(|c| c as u32);
        let at = places(room, positions, |p| with_zero(brick(p)));
        Self { bricks: *bricks, sorted: Sorted::around(&at).sort(&at, tets, room, |_, _, _| {}) }
    }

    /// The bricks that tetrahedra touch, ascending, with these.
    pub fn iter(&self) -> impl Iterator<Item = (BrickId, &[u32])> {
        let all = self.sorted.iter().enumerate().filter(|(_, tets)| !tets.is_empty());
        all.map(|(n, tets)| (self.bricks.id(self.sorted.coordinates(n)), tets))
    }
}

/// Tetrahedra, window by window.
#[derive(Debug)]
pub struct Windows<'a> {
    sorted: Sorted<'a>,
    /// The samples of each window that tetrahedra may have.
    boxes: Vec<Samples>,
}

/// The first and the last of a box of samples.
#[derive(Clone, Copy, Debug)]
struct Samples {
    lo: [u32; 4],
    hi: [u32; 4],
}

const NONE: Samples = Samples { lo: [u32::MAX; 4], hi: [0; 4] };

impl<'a> Windows<'a> {
    /// Sorts tetrahedra into windows of `edge` samples. Time and memory also grow with the number
    /// of windows that the box around all vertices touches.
    pub fn new(
        grid: &SampleGrid,
        edge: [u64; 3],
        positions: &[LatticePos],
        tets: &[Tet],
        room: &mut Room<'a>,
    ) -> Self {
        with_vectors(
            #[inline(always)]
            || Self::sort(grid, edge.map(|e| e as u32), positions, tets, room),
        )
    }

    #[inline(always)]
    fn sort(
        grid: &SampleGrid,
        edge: [u32; 3],
        positions: &[LatticePos],
        tets: &[Tet],
        room: &mut Room<'a>,
    ) -> Self {
        // The last sample at or before a vertex: a tetrahedron has no sample before the least of
        // those of its vertices, and none behind the greatest.
        let samples = places(room, positions, |&p| with_zero(sample_before(grid, p)));
        let window = |s: &[u32; 4]| with_zero(std::array::from_fn(|k| s[k] / edge[k]));
        let at = places(room, &samples, window);
        let sorted = Sorted::around(&at);
        let mut boxes = vec![NONE; sorted.ends.len()];
        let sorted = sorted.sort(
            &at,
            tets,
            room,
            #[inline(always)]
            |sorted, tet, only| {
                let (lo, hi) = bounds(tet.map(|v| samples[v as usize]));
                match only {
                    SEVERAL => sorted.include(&mut boxes, edge, Samples { lo, hi }),
                    n => {
                        let b = &mut boxes[n as usize];
                        *b = Samples { lo: lesser(b.lo, lo), hi: greater(b.hi, hi) };
                    }
                }
            },
        );
        Self { sorted, boxes }
    }

    /// The windows that have samples, ascending, x first: the box of their samples, and their
    /// tetrahedra.
    pub fn iter(&self) -> impl Iterator<Item = (IndexBox, &[u32])> {
        let all = self.boxes.iter().zip(self.sorted.iter()).filter(|(_, tets)| !tets.is_empty());
        all.map(|(samples, tets)| {
            let lo = [0, 1, 2].map(|k| u64::from(samples.lo[k]));
            (IndexBox { lo, hi: [0, 1, 2].map(|k| u64::from(samples.hi[k]) + 1) }, tets)
        })
    }
}

impl Sorted<'_> {
    /// Widens the boxes of all windows that a box of samples touches to its part in them.
    fn include(&self, boxes: &mut [Samples], edge: [u32; 3], samples: Samples) {
        let window = |s: [u32; 4], k: usize| s[k] / edge[k];
        let [xs, ys, zs] = [0, 1, 2].map(|k| window(samples.lo, k)..=window(samples.hi, k));
        for [y, z] in zs.flat_map(|z| ys.clone().map(move |y| [y, z])) {
            for x in xs.clone() {
                let w = [x, y, z];
                let (first, last) =
                    ([0, 1, 2].map(|k| w[k] * edge[k]), [0, 1, 2].map(|k| (w[k] + 1) * edge[k] - 1));
                let b = &mut boxes[self.number(w.map(u64::from))];
                *b = Samples {
                    lo: lesser(b.lo, greater(samples.lo, with_zero(first))),
                    hi: greater(b.hi, lesser(samples.hi, with_zero(last))),
                };
            }
        }
    }
}

/// Three coordinates of each item, and a 0.
#[inline(always)]
fn places<'a, T>(room: &mut Room<'a>, items: &[T], place: impl Fn(&T) -> [u32; 4]) -> Lent<'a, [u32; 4]> {
    let mut all = room.lend(items.len(), [0; 4]);
    all.iter_mut().zip(items).for_each(|(at, item)| *at = place(item));
    all
}

#[inline(always)]
fn sample_before(grid: &SampleGrid, p: LatticePos) -> [u32; 3] {
    // A volume has at most 2^24 + 1 samples along an axis.
    std::array::from_fn(|k| (grid.axes()[k].below(p[k] + 1) as u32).saturating_sub(1))
}

#[inline(always)]
fn with_zero([x, y, z]: [u32; 3]) -> [u32; 4] {
    [x, y, z, 0]
}

#[inline(always)]
fn bounds([a, b, c, d]: [[u32; 4]; 4]) -> ([u32; 4], [u32; 4]) {
    (lesser(lesser(a, b), lesser(c, d)), greater(greater(a, b), greater(c, d)))
}
