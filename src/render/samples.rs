//! What is seen at each sample of an image: a z-buffer.

use super::View;
use rayon::prelude::*;

/// Bytes of a sample.
pub(super) const BYTES: u64 = 4 + 8 + 4;
/// Bytes of a sample besides, where surfaces are transparent.
pub(super) const LAYER_BYTES: u64 = 4 + 12;
/// Subjects that a sample can tell apart.
pub(super) const MOST_SUBJECTS: usize = 1 << 14;

/// Steps of a sample that corners are rounded to.
const STEPS: i64 = 256;
/// The farthest from the image that a corner is taken to be, in steps: products of differences must
/// fit 64 bits.
const FAR: f64 = (1u64 << 29) as f64;

/// A corner of a triangle on the image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    /// In steps from the left and from the top.
    pub(super) at: [i64; 2],
    pub(super) depth: f32,
    pub(super) normal: [f32; 3],
    pub(super) value: f32,
    /// Whether the triangle is seen from its far side.
    pub(super) is_back: bool,
}

/// What is seen.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct VisiblePoint {
    /// Unit normal, times 2^14; then twice the number of the subject, and 1 more where the far side
    /// of a triangle is seen.
    packed: [i16; 4],
    pub(super) value: f32,
}

impl VisiblePoint {
    pub(super) fn normal(&self) -> [f32; 3] {
        let [x, y, z, _] = self.packed;
        super::unit([x, y, z].map(f32::from))
    }

    pub(super) fn is_back(&self) -> bool {
        self.packed[3] & 1 != 0
    }

    /// Number of the subject.
    pub(super) fn subject(&self) -> usize {
        (self.packed[3] >> 1) as usize
    }
}

/// What is known of the layers that a sample has had.
#[derive(Clone, Copy, Debug)]
pub(super) struct Past {
    /// Depth and number of the triangle that was seen last; the next one lies behind it.
    pub(super) depth: f32,
    pub(super) order: u32,
    /// The share of the light that has not been stopped.
    pub(super) through: f32,
}

impl Past {
    const NONE: Self = Self { depth: f32::INFINITY, order: 0, through: 1.0 };

    /// Nothing more is seen.
    pub(super) fn end(&mut self) {
        self.depth = f32::NEG_INFINITY;
    }
}

/// The samples of an image, row by row; each pixel has a square of them.
pub(super) struct Samples {
    /// Samples along each side of a pixel, and along each side of the image.
    pub(super) side: usize,
    pub(super) size: [usize; 2],
    perspective: bool,
    pub(super) depths: Vec<f32>,
    pub(super) seen: Vec<VisiblePoint>,
    /// Numbers of the triangles that are seen, and what was seen in front of them; empty where all
    /// is opaque.
    pub(super) orders: Vec<u32>,
    pub(super) past: Vec<Past>,
}

/// Rows of a thread's turn.
const BAND: usize = 32;

impl Samples {
    pub(super) fn new(view: &View, side: u32, transparent: bool) -> Self {
        let size = view.size().map(|s| s as usize * side as usize);
        let layered = if transparent { size[0] * size[1] } else { 0 };
        Self {
            side: side as usize,
            size,
            perspective: view.is_perspective(),
            depths: vec![f32::NEG_INFINITY; size[0] * size[1]],
            seen: vec![VisiblePoint::default(); size[0] * size[1]],
            orders: vec![0; layered],
            past: vec![Past::NONE; layered],
        }
    }

    /// A place on the image, given in pixels, in steps.
    pub(super) fn snap(&self, at: [f64; 2]) -> [i64; 2] {
        at.map(|x| (x * (self.side as i64 * STEPS) as f64).clamp(-FAR, FAR).round() as i64)
    }

    /// Draws triangles of a subject, in order; `first` is the number of the first.
    pub(super) fn draw(&mut self, triangles: &[[Corner; 3]], subject: u16, first: u32) {
        let (width, perspective) = (self.size[0], self.perspective);
        let height = self.size[1] as i64;
        // The rows of samples that each may cover.
        let rows: Vec<[i64; 2]> = triangles
            .iter()
            .map(|t| {
                let (lo, hi) = extent(t.map(|c| c.at[1]));
                [lo.max(0), hi.min(height - 1)]
            })
            .collect();
        let part = BAND * width;
        let layered = !self.past.is_empty();
        let (depths, seen) = (self.depths.par_chunks_mut(part), self.seen.par_chunks_mut(part));
        let draw =
            |n: usize, depths: &mut [f32], seen: &mut [VisiblePoint], orders: &mut [u32], past: &[Past]| {
                let top = (n * BAND) as i64;
                let last = top + (depths.len() / width) as i64 - 1;
                let mut band = Band { first: top, width, perspective, subject, depths, seen, orders, past };
                for (k, (t, &[lo, hi])) in triangles.iter().zip(&rows).enumerate() {
                    if lo <= last && hi >= top {
                        band.draw(t, first.wrapping_add(k as u32), [lo.max(top), hi.min(last)]);
                    }
                }
            };
        if layered {
            let (orders, past) = (self.orders.par_chunks_mut(part), self.past.par_chunks(part));
            let bands = depths.zip(seen).zip(orders.zip(past)).enumerate();
            bands.for_each(|(n, ((depths, seen), (orders, past)))| draw(n, depths, seen, orders, past));
        } else {
            let bands = depths.zip(seen).enumerate();
            bands.for_each(|(n, (depths, seen))| draw(n, depths, seen, &mut [], &[]));
        }
    }
}

/// The first and the last sample whose centre may lie between the ends.
fn extent([a, b, c]: [i64; 3]) -> (i64, i64) {
    let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
    ((lo - STEPS / 2).div_euclid(STEPS), (hi - STEPS / 2).div_euclid(STEPS) + 1)
}

/// Some rows.
struct Band<'a> {
    first: i64,
    width: usize,
    perspective: bool,
    subject: u16,
    depths: &'a mut [f32],
    seen: &'a mut [VisiblePoint],
    orders: &'a mut [u32],
    past: &'a [Past],
}

/// Twice the area of (a, b, p), as a function of p.
#[derive(Clone, Copy)]
struct Edge {
    x: i64,
    y: i64,
    at: [i64; 2],
    /// 0 where a sample on the edge belongs to the triangle, else -1.
    bias: i64,
}

impl Edge {
    fn new(a: [i64; 2], b: [i64; 2]) -> Self {
        let (x, y) = (a[1] - b[1], b[0] - a[0]);
        // Rows go down, so with a positive area the inside is to the right of an edge that goes up:
        // a left one.
        let is_top_left = b[1] < a[1] || (a[1] == b[1] && b[0] > a[0]);
        Self { x, y, at: a, bias: if is_top_left { 0 } else { -1 } }
    }

    fn value(&self, p: [i64; 2]) -> i64 {
        self.x * (p[0] - self.at[0]) + self.y * (p[1] - self.at[1])
    }
}

impl Band<'_> {
    fn draw(&mut self, t: &[Corner; 3], order: u32, [top, bottom]: [i64; 2]) {
        let [a, mut b, mut c] = *t;
        let area = Edge::new(a.at, b.at).value(c.at);
        if area < 0 {
            (b, c) = (c, b);
        }
        let area = area.abs();
        let (left, right) = extent([a, b, c].map(|k| k.at[0]));
        let (left, right) = (left.max(0), right.min(self.width as i64 - 1));
        if area == 0 || left > right {
            return;
        }
        let edges = [Edge::new(b.at, c.at), Edge::new(c.at, a.at), Edge::new(a.at, b.at)];
        let (unit, corners) = (1.0 / area as f64, [a, b, c]);
        for y in top..=bottom {
            let centre = [left * STEPS + STEPS / 2, y * STEPS + STEPS / 2];
            let mut w = edges.map(|e| e.value(centre) + e.bias);
            let row = (y - self.first) as usize * self.width;
            for x in left..=right {
                if w[0] | w[1] | w[2] >= 0 {
                    let weights = [0, 1].map(|k| ((w[k] - edges[k].bias) as f64 * unit) as f32);
                    self.see(
                        row + x as usize,
                        &corners,
                        order,
                        [weights[0], weights[1], 1.0 - weights[0] - weights[1]],
                    );
                }
                w = std::array::from_fn(|k| w[k] + edges[k].x * STEPS);
            }
        }
    }

    #[inline]
    fn see(&mut self, at: usize, corners: &[Corner; 3], order: u32, weights: [f32; 3]) {
        let sum =
            |of: &dyn Fn(&Corner) -> f32, w: [f32; 3]| (0..3).map(|k| w[k] * of(&corners[k])).sum::<f32>();
        let depth = sum(&|c| c.depth, weights);
        if depth <= self.depths[at] {
            return;
        }
        if let Some(past) = self.past.get(at) {
            let behind = depth < past.depth || depth == past.depth && order > past.order;
            if !behind {
                return;
            }
            self.orders[at] = order;
        }
        self.depths[at] = depth;
        // What is linear in space is not linear on a perspective image.
        let w = if self.perspective {
            std::array::from_fn(|k| weights[k] * corners[k].depth / depth)
        } else {
            weights
        };
        let normal = super::unit(std::array::from_fn(|k| sum(&|c| c.normal[k], w)));
        let [x, y, z] = normal.map(|n| (n * 16384.0).round() as i16);
        let value = sum(&|c| c.value, w);
        self.seen[at] = VisiblePoint {
            packed: [x, y, z, 2 * self.subject as i16 + i16::from(corners[0].is_back)],
            value,
        };
    }
}
