//! The link of a vertex, and the geometry that foretells it.
//!
//! With the vertex at the origin, [inversion](https://en.wikipedia.org/wiki/Inversive_geometry) w' = w / |w|² turns spheres through it into planes:
//! the sphere through the vertex, c, d and w has its centre m where m·c' = m·d' = m·w' = 1/2. The centres that satisfy the first two are a
//! line m0 + s n with n = c' × d'; a point w in front of the gate (n·w' > 0) is met at s = (1/2 - m0·w') / (n·w'), and the Delaunay
//! triangle behind the gate is the one met first. All is scaled by 2 |n|², so that only the last step divides.
//!
//! Everything is `f32` arithmetic in a fixed order, which IEEE 754 makes the same everywhere; what it gets wrong costs bits, not truth.

use crate::geom::LatticePos;

/// The most vertices of a link at hand.
pub(super) const MOST: usize = super::LARGEST_LINK;
/// Those nearby that are taken at the beginning: the rest is for vertices that must be named.
const MOST_NEAR: usize = 48;
/// Gates that are looked at together.
pub(super) const LANES: usize = 8;
/// No vertex of a link.
pub(super) const NOBODY: usize = MOST;
/// Contexts of what lies behind a gate: how large the sphere is, and, last, that there is none.
pub(super) const SIZES: usize = 24;
/// Words of a bit for each vertex of a block.
const MOST_WORDS: usize = 64;
/// Points behind the last one, far from everything.
const FAR: f32 = 1e18;

/// A point, and nothing: so that it is one load.
pub(super) type Point = [f32; 4];

/// How the inner loops are run; all ways give the same bits.
pub(super) trait Path: Copy {
    /// Sets a bit for each vertex within the radius of `v`, from the first of the 64 that `v` is one of.
    fn near(self, cloud: &Cloud, v: usize, words: &mut [u64]);
    /// The set of c that have gates.
    fn active(self, link: &Link) -> u64;
    /// Foretells what is behind each of the gates, garbage beyond their number.
    fn search(self, link: &Link, radius2: f32, gates: &mut Gates);
}

/// The path for every machine.
#[derive(Clone, Copy)]
pub(super) struct Plain;

/// The vertices of a block, in units in which the radius of a neighbourhood is between 1 and 2.
#[derive(Default)]
pub(super) struct Cloud {
    pub(super) x: Vec<f32>,
    pub(super) y: Vec<f32>,
    pub(super) z: Vec<f32>,
    points: Vec<Point>,
    pub(super) radius2: f32,
}

impl Cloud {
    /// Sets the points. `size` tells the radius: its square is `1 + size % 4 / 4` times 2 to the power of `size / 4`, in lattice steps.
    pub(super) fn set(&mut self, positions: &[LatticePos], size: u8) {
        let power = i32::from(size >> 2);
        let (unit, rest) = (power / 2, power % 2);
        self.radius2 = (1.0 + f32::from(size & 3) / 4.0) * (1 << rest) as f32;
        let scale = f32::from_bits(((127 - unit) as u32) << 23);
        let base = positions.first().copied().unwrap_or_default();
        // Exact: less than 2^24, times a power of two.
        let along = |p: &LatticePos, k: usize| (p[k] as i32).wrapping_sub(base[k] as i32) as f32 * scale;
        let padded = (positions.len() + 1).next_multiple_of(64);
        for (k, axis) in [&mut self.x, &mut self.y, &mut self.z].into_iter().enumerate() {
            axis.clear();
            axis.extend(positions.iter().map(|p| along(p, k)));
            axis.resize(padded, FAR);
        }
        self.points.clear();
        self.points.extend(positions.iter().map(|p| [along(p, 0), along(p, 1), along(p, 2), 0.0]));
    }

    /// The inverted w, seen from `from`.
    #[inline(always)]
    fn inverted(&self, from: Point, w: usize) -> Point {
        let p = self.points[w];
        let d = [p[0] - from[0], p[1] - from[1], p[2] - from[2]];
        let q = 1.0 / dot(d, d);
        [d[0] * q, d[1] * q, d[2] * q, 0.0]
    }
}

/// What is known of the link of one vertex.
pub(super) struct Link {
    /// The vertex.
    from: Point,
    pub(super) len: usize,
    /// Block-local numbers of its vertices, and the inverted points.
    pub(super) id: [u16; MOST],
    pub(super) points: [Point; MOST],
    /// For each vertex of the block where it is in `id`, if it is there.
    slot: Vec<u8>,
    /// For each c the set of d to which there is a gate.
    pub(super) out: [u64; MOST],
}

/// Some gates, and what is foretold behind each.
#[derive(Default)]
pub(super) struct Gates {
    pub(super) len: usize,
    pub(super) c: [u8; LANES],
    pub(super) d: [u8; LANES],
    /// [`NOBODY`] where nothing is in front.
    pub(super) apex: [u8; LANES],
    pub(super) size: [u8; LANES],
}

impl Gates {
    /// Notes what the search found: the apex, and exponent and first bit of the sphere's size.
    #[inline(always)]
    pub(super) fn note(&mut self, lane: usize, apex: i32, size: i32) {
        let size = (size - ((127 - 5) << 1)).clamp(0, SIZES as i32 - 2);
        self.apex[lane] = apex as u8;
        self.size[lane] = if apex == NOBODY as i32 { SIZES as u8 - 1 } else { size as u8 };
    }
}

/// A plane through two inverted points: all that the search needs.
#[derive(Clone, Copy, Default)]
struct Hinge {
    n: [f32; 3],
    u: [f32; 3],
    nn: f32,
    /// What is less in front is noise: rounding errors of n·w' are below.
    least: f32,
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Hinge {
    #[inline(always)]
    fn new(c: [f32; 3], d: [f32; 3]) -> Self {
        let n = [c[1] * d[2] - c[2] * d[1], c[2] * d[0] - c[0] * d[2], c[0] * d[1] - c[1] * d[0]];
        let (cc, cd, dd) = (dot(c, c), dot(c, d), dot(d, d));
        let (p, q) = (dd - cd, cc - cd);
        let u = [p * c[0] + q * d[0], p * c[1] + q * d[1], p * c[2] + q * d[2]];
        let sum = |a: [f32; 3]| a[0].abs() + a[1].abs() + a[2].abs();
        let (sc, sd) = (sum(c), sum(d));
        Self { n, u, nn: dot(n, n), least: sc * sd * (sc + sd) * (1.0 / (1 << 21) as f32) }
    }

    /// Where the sphere meets w; and whether w is in front.
    #[inline(always)]
    fn meets(&self, w: [f32; 3]) -> (f32, bool) {
        let h = dot(self.n, w);
        ((self.nn - dot(self.u, w)) / h, h > self.least)
    }

    /// Square of a sphere's size against the radius of the neighbourhood, in steps of a factor √2.
    #[inline(always)]
    fn size(&self, s: f32, radius2: f32) -> i32 {
        let square = (dot(self.u, self.u) + s * s * self.nn) / (self.nn * self.nn * (4.0 * radius2));
        square.to_bits() as i32 >> 22
    }
}

impl Path for Plain {
    fn near(self, cloud: &Cloud, v: usize, words: &mut [u64]) {
        for (word, first) in words.iter_mut().zip((v / 64 * 64..).step_by(64)) {
            *word = (0..64).fold(0, |bits, i| {
                let w = first + i;
                let d = [cloud.x[w] - cloud.x[v], cloud.y[w] - cloud.y[v], cloud.z[w] - cloud.z[v]];
                bits | u64::from(dot(d, d) <= cloud.radius2) << i
            });
        }
    }

    fn active(self, link: &Link) -> u64 {
        (0..link.len.min(MOST)).fold(0, |set, c| set | u64::from(link.out[c] != 0) << c)
    }

    fn search(self, link: &Link, radius2: f32, gates: &mut Gates) {
        let hinge = |l: usize| Hinge::new(link.point(gates.c[l].into()), link.point(gates.d[l].into()));
        let hinges: [Hinge; LANES] = std::array::from_fn(hinge);
        let (mut best, mut apex) = ([f32::INFINITY; LANES], [NOBODY as i32; LANES]);
        for i in 0..link.len.min(MOST) {
            let w = link.point(i);
            for l in 0..LANES {
                let (s, front) = hinges[l].meets(w);
                let better = front & (s < best[l]);
                best[l] = if better { s } else { best[l] };
                apex[l] = if better { i as i32 } else { apex[l] };
            }
        }
        for l in 0..LANES {
            gates.note(l, apex[l], hinges[l].size(best[l], radius2));
        }
    }
}

impl Default for Link {
    fn default() -> Self {
        Self { from: [0.0; 4], len: 0, id: [0; MOST], points: [[0.0; 4]; MOST], slot: vec![], out: [0; MOST] }
    }
}

impl Link {
    /// Prepares for another block.
    pub(super) fn clear(&mut self, vertices: usize) {
        self.len = 0;
        self.slot.clear();
        self.slot.resize(vertices, 0);
        self.out = [0; MOST];
    }

    /// Begins the link of `v` with the larger vertices nearby.
    #[inline(always)]
    pub(super) fn begin(&mut self, path: impl Path, cloud: &Cloud, v: usize) {
        let mut words = [0; MOST_WORDS];
        let words = &mut words[..cloud.points.len().div_ceil(64) - v / 64];
        path.near(cloud, v, words);
        // Those that are larger than v.
        words[0] &= u64::MAX << (v % 64) << 1;
        let mut n = 0;
        for (first, &mut mut bits) in (v / 64 * 64..).step_by(64).zip(words) {
            // Four at a time, for the loop's end is a branch that cannot be foretold; what is too much is overwritten.
            let end = (n + bits.count_ones() as usize).min(MOST_NEAR);
            while n < end {
                for k in 0..4 {
                    self.id[(n + k) % MOST] = (first + bits.trailing_zeros() as usize) as u16;
                    bits &= bits.wrapping_sub(1);
                }
                n += 4;
            }
            n = end;
        }
        (self.from, self.len) = (cloud.points[v], n);
        for (i, (&w, point)) in self.id.iter().zip(&mut self.points).enumerate().take(n) {
            self.slot[usize::from(w)] = i as u8;
            *point = cloud.inverted(self.from, w.into());
        }
    }

    /// The place of a vertex, if it has one.
    #[inline(always)]
    pub(super) fn find(&self, w: u16) -> Option<usize> {
        let i = usize::from(*self.slot.get(usize::from(w))?);
        (i < self.len && self.id[i % MOST] == w).then_some(i)
    }

    /// The place of a vertex, which is given one if it has none. `None` if there is no room.
    #[inline(always)]
    pub(super) fn place(&mut self, cloud: &Cloud, w: u16) -> Option<usize> {
        match self.find(w) {
            None => self.add(cloud, w),
            found => found,
        }
    }

    #[cold]
    fn add(&mut self, cloud: &Cloud, w: u16) -> Option<usize> {
        let i = self.len;
        *self.id.get_mut(i)? = w;
        self.slot[usize::from(w)] = i as u8;
        self.points[i] = cloud.inverted(self.from, w.into());
        self.len += 1;
        Some(i)
    }

    #[inline(always)]
    fn point(&self, i: usize) -> [f32; 3] {
        let [x, y, z, _] = self.points[i % MOST];
        [x, y, z]
    }

    #[inline(always)]
    pub(super) fn is_gate(&self, c: usize, d: usize) -> bool {
        self.out[c % MOST] >> (d % MOST) & 1 == 1
    }

    /// Opens a gate from c to d, whatever is beyond.
    #[inline(always)]
    pub(super) fn open(&mut self, c: usize, d: usize) {
        self.out[c % MOST] |= 1 << (d % MOST);
    }

    #[inline(always)]
    pub(super) fn close(&mut self, c: usize, d: usize) {
        self.out[c % MOST] &= !(1 << (d % MOST));
    }

    /// An edge of a new triangle: closes the gate of opposite direction, for both sides are known then; without one, opens a gate.
    #[inline(always)]
    pub(super) fn meet(&mut self, c: usize, d: usize) {
        let (c, d) = (c % MOST, d % MOST);
        let back = self.out[d];
        self.out[d] = back & !(1 << c);
        self.out[c] |= (!back >> c & 1) << d;
    }

    /// Some gates, one from each of the first vertices that have any, with what is foretold of them.
    #[inline(always)]
    pub(super) fn foretell(&self, path: impl Path, cloud: &Cloud, gates: &mut Gates) {
        let mut from = path.active(self);
        gates.len = (from.count_ones() as usize).min(LANES);
        for lane in 0..LANES {
            let c = from.trailing_zeros() as usize;
            let to = self.out[c % MOST];
            (gates.c[lane], gates.d[lane]) = (c as u8, to.trailing_zeros() as u8);
            from &= from.wrapping_sub(1);
        }
        if gates.len > 0 {
            path.search(self, cloud.radius2, gates);
        }
    }

    /// Where the sphere through c and d meets each vertex; infinity for what is not in front.
    pub(super) fn scores(&self, c: usize, d: usize) -> [f32; MOST] {
        let hinge = Hinge::new(self.point(c), self.point(d));
        self.score(|w| match hinge.meets(w) {
            (s, true) => s,
            _ => f32::INFINITY,
        })
    }

    /// Near vertices first.
    pub(super) fn by_distance(&self) -> [f32; MOST] {
        self.score(|w| -dot(w, w))
    }

    /// Small circles through the vertex and c first.
    pub(super) fn by_circle(&self, c: usize) -> [f32; MOST] {
        let p = self.point(c);
        self.score(|w| {
            let n = Hinge::new(p, w).nn;
            let e = [w[0] - p[0], w[1] - p[1], w[2] - p[2]];
            if n > 0.0 { -n / dot(e, e) } else { f32::INFINITY }
        })
    }

    #[inline(always)]
    fn score(&self, f: impl Fn([f32; 3]) -> f32) -> [f32; MOST] {
        let mut scores = [f32::INFINITY; MOST];
        for (i, score) in scores.iter_mut().enumerate().take(self.len) {
            let s = f(self.point(i));
            *score = if s.is_finite() { s } else { f32::INFINITY };
        }
        scores
    }

    /// The place of rank `rank` when the vertices are ordered by finite scores, least first, of equal ones the first.
    pub(super) fn nth(&self, scores: &[f32; MOST], rank: usize) -> Option<usize> {
        let mut last = (f32::NEG_INFINITY, 0);
        for _ in 0..=rank {
            let mut next = (f32::INFINITY, MOST);
            for (i, &s) in scores.iter().enumerate().take(self.len) {
                let later = (s > last.0) | ((s == last.0) & (i > last.1));
                next = if later & (s < next.0) { (s, i) } else { next };
            }
            last = next;
        }
        (last.1 < MOST).then_some(last.1)
    }

    /// The rank of a place; `None` if its score is not finite.
    pub(super) fn rank(&self, scores: &[f32; MOST], place: usize) -> Option<usize> {
        let score = scores[place % MOST];
        let before = |&(i, &s): &(usize, &f32)| s < score || (s == score && i < place);
        (score < f32::INFINITY).then(|| scores.iter().enumerate().filter(before).count())
    }
}
