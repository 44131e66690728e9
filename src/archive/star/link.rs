//! The link of a vertex, and the geometry that foretells it.
//!
//! With the vertex at the origin, [inversion](https://en.wikipedia.org/wiki/Inversive_geometry) w' = w / |w|² turns spheres through it into planes:
//! the sphere through the vertex, c, d and w has its centre m where m·c' = m·d' = m·w' = 1/2. The centres that satisfy the first two are a
//! line m0 + s n with n = c' × d'; a point w in front of the gate (n·w' > 0) is met at s = (1/2 - m0·w') / (n·w'), and the Delaunay
//! triangle behind the gate is the one met first. All is scaled by 2 |n|², so that only the last step divides.
//!
//! Everything is `f32` arithmetic in a fixed order, with fused multiplications and additions where the code says so, which IEEE 754 makes
//! the same everywhere; what it gets wrong costs bits, not truth.

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
pub(super) const SIZES: usize = 32;
/// Vertices of a block that are passed over together, where their box is not near.
pub(super) const GROUP: usize = 32;
/// Points behind the last one, far from everything.
const FAR: f32 = 1e18;

/// A point, and nothing: so that it is one load.
pub(super) type Point = [f32; 4];

/// How the inner loops are run; all ways give the same bits.
pub(super) trait Path: Copy {
    /// Sets a bit for each group, beginning with eight times `first`, of 64 at most, whose box is within the radius of a point.
    fn near_groups(self, cloud: &Cloud, from: Point, first: usize) -> u64;
    /// Sets a bit for each vertex of a group within the radius of a point.
    fn near(self, cloud: &Cloud, from: Point, group: usize) -> u32;
    /// Inverts the first `len` points of a link, and may put anything into those behind them.
    fn invert(self, cloud: &Cloud, link: &mut Link);
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
    /// Coordinates along x, y and z; whole groups.
    pub(super) axes: [Vec<f32>; 3],
    /// Least and largest coordinates of each group, eight groups at a time.
    pub(super) boxes: [[Vec<f32>; 2]; 3],
    pub(super) points: Vec<Point>,
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
        self.points.clear();
        self.points.extend(positions.iter().map(|p| [along(p, 0), along(p, 1), along(p, 2), 0.0]));
        let padded = positions.len().next_multiple_of(GROUP);
        for (k, (axis, ends)) in self.axes.iter_mut().zip(&mut self.boxes).enumerate() {
            axis.clear();
            axis.extend(self.points.iter().map(|p| p[k]));
            // The last vertex again, lest the last box be large.
            axis.resize(padded, axis.last().copied().unwrap_or_default());
            let groups = axis.as_chunks::<GROUP>().0;
            let [lo, hi] = ends;
            for (end, least) in [(lo, true), (hi, false)] {
                let better = |a: f32, b: f32| if (b < a) == least { b } else { a };
                end.clear();
                end.extend(groups.iter().map(|g| g.iter().copied().fold(g[0], better)));
                end.resize(groups.len().next_multiple_of(8), FAR);
            }
        }
    }

    fn len(&self) -> usize {
        self.points.len()
    }
}

/// What is known of the link of one vertex.
pub(super) struct Link {
    /// The vertex.
    pub(super) from: Point,
    pub(super) len: usize,
    /// Block-local numbers of its vertices, and the inverted points.
    pub(super) id: [u16; MOST],
    pub(super) points: [Point; MOST],
    /// For each vertex of the block where it was in `id` when it was there last, and 256 times the link's stamp then.
    slot: Vec<u32>,
    /// Of this link, shifted: no other's since the slots were cleared.
    stamp: u32,
    /// For each c the set of d to which there is a gate.
    pub(super) out: [u64; MOST],
}

/// Some gates, and what is foretold behind each.
#[derive(Default)]
pub(super) struct Gates {
    pub(super) len: usize,
    pub(super) c: [u8; LANES],
    pub(super) d: [u8; LANES],
    /// The place of the apex, [`NOBODY`] where nothing is in front; and 256 times the context.
    pub(super) told: [u16; LANES],
}

/// The least size of a sphere that has a context of its own: exponent and first bit.
pub(super) const LEAST_SIZE: i32 = (127 - 5) << 1;

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
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

impl Hinge {
    #[inline(always)]
    fn new(c: [f32; 3], d: [f32; 3]) -> Self {
        let minor = |j: usize, k: usize| c[j].mul_add(d[k], -(c[k] * d[j]));
        let n = [minor(1, 2), minor(2, 0), minor(0, 1)];
        let (cc, cd, dd) = (dot(c, c), dot(c, d), dot(d, d));
        let (p, q) = (dd - cd, cc - cd);
        let u = [0, 1, 2].map(|k| p.mul_add(c[k], q * d[k]));
        let sum = |a: [f32; 3]| a[0].abs() + a[1].abs() + a[2].abs();
        let (sc, sd) = (sum(c), sum(d));
        Self { n, u, nn: dot(n, n), least: sc * sd * (sc + sd) * (1.0 / (1 << 21) as f32) }
    }

    /// Where the sphere meets w; and whether w is in front.
    #[inline(always)]
    fn meets(&self, w: [f32; 3]) -> (f32, bool) {
        let h = dot(self.n, w);
        let u = self.u;
        let over = (-u[2]).mul_add(w[2], (-u[1]).mul_add(w[1], (-u[0]).mul_add(w[0], self.nn)));
        (over / h, h > self.least)
    }

    /// Square of a sphere's size against the radius of the neighbourhood, in steps of a factor √2.
    #[inline(always)]
    fn size(&self, s: f32, radius2: f32) -> i32 {
        let square = (s * s).mul_add(self.nn, dot(self.u, self.u)) / (self.nn * self.nn * (4.0 * radius2));
        square.to_bits() as i32 >> 22
    }
}

impl Path for Plain {
    fn near_groups(self, cloud: &Cloud, from: Point, first: usize) -> u64 {
        let groups = cloud.boxes[0][0].len() - 8 * first;
        (0..groups.min(64)).fold(0, |bits, i| {
            let out = [0, 1, 2].map(|k| {
                let [lo, hi] = &cloud.boxes[k];
                (lo[8 * first + i] - from[k]).max(from[k] - hi[8 * first + i]).max(0.0)
            });
            bits | u64::from(dot(out, out) <= cloud.radius2) << i
        })
    }

    fn near(self, cloud: &Cloud, from: Point, group: usize) -> u32 {
        (0..GROUP).fold(0, |bits, i| {
            let d = [0, 1, 2].map(|k| cloud.axes[k][group * GROUP + i] - from[k]);
            bits | u32::from(dot(d, d) <= cloud.radius2) << i
        })
    }

    fn invert(self, cloud: &Cloud, link: &mut Link) {
        for i in 0..link.len {
            link.points[i] = link.inverted(cloud, link.id[i]);
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
            let size = (hinges[l].size(best[l], radius2) - LEAST_SIZE).clamp(0, SIZES as i32 - 2);
            let size = if apex[l] == NOBODY as i32 { SIZES as i32 - 1 } else { size };
            gates.told[l] = (size << 8 | apex[l]) as u16;
        }
    }
}

impl Default for Link {
    fn default() -> Self {
        Self {
            from: [0.0; 4],
            len: 0,
            id: [0; MOST],
            points: [[0.0; 4]; MOST],
            slot: vec![],
            stamp: 0,
            out: [0; MOST],
        }
    }
}

impl Link {
    /// Prepares for another block.
    pub(super) fn clear(&mut self, vertices: usize) {
        (self.len, self.stamp) = (0, 0);
        self.slot.clear();
        self.slot.resize(vertices, 0);
        self.out = [0; MOST];
    }

    /// Begins the link of `v` with the larger vertices nearby.
    #[inline(always)]
    pub(super) fn begin(&mut self, path: impl Path, cloud: &Cloud, v: usize) {
        let from = cloud.points[v];
        let groups = cloud.len().div_ceil(GROUP);
        // Those that are larger than v.
        let (mut n, mut larger) = (0, u32::MAX << (v % GROUP) << 1);
        let mut first = v / GROUP / 8;
        // Groups before that of v are not near.
        let mut behind = u64::MAX << (v / GROUP % 8);
        while 8 * first < groups {
            let mut near = path.near_groups(cloud, from, first) & behind;
            while near != 0 {
                let group = 8 * first + near.trailing_zeros() as usize;
                near &= near - 1;
                let bits = path.near(cloud, from, group);
                // The last group may be filled up.
                let filled = (group * GROUP + GROUP).saturating_sub(cloud.len()) as u32;
                let larger = std::mem::replace(&mut larger, u32::MAX);
                n = self.take(group * GROUP, bits & larger & u32::MAX >> filled, n);
            }
            (first, behind) = (first + 8, u64::MAX);
        }
        (self.from, self.len) = (from, n);
        self.stamp += 1 << 8;
        path.invert(cloud, self);
        for (i, &w) in self.id.iter().enumerate().take(n) {
            self.slot[usize::from(w)] = self.stamp | i as u32;
        }
    }

    /// Takes the vertices of a group that have a bit, as long as there is room.
    #[inline(always)]
    fn take(&mut self, first: usize, mut bits: u32, mut n: usize) -> usize {
        // Four at a time, for the loop's end is a branch that cannot be foretold; what is too much is overwritten.
        let end = (n + bits.count_ones() as usize).min(MOST_NEAR);
        while n < end {
            for k in 0..4 {
                self.id[(n + k) % MOST] = (first + bits.trailing_zeros() as usize) as u16;
                bits &= bits.wrapping_sub(1);
            }
            n += 4;
        }
        end
    }

    /// A vertex of the block inverted, seen from this link's.
    #[inline(always)]
    fn inverted(&self, cloud: &Cloud, w: u16) -> Point {
        let (p, from) = (cloud.points[usize::from(w)], self.from);
        let d = [p[0] - from[0], p[1] - from[1], p[2] - from[2]];
        let q = 1.0 / dot(d, d);
        [d[0] * q, d[1] * q, d[2] * q, 0.0]
    }

    /// The place of a vertex, if it has one.
    #[inline(always)]
    pub(super) fn find(&self, w: u16) -> Option<usize> {
        let i = self.slot.get(usize::from(w))? ^ self.stamp;
        (i < MOST as u32).then_some(i as usize)
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
        self.slot[usize::from(w)] = self.stamp | i as u32;
        self.points[i] = self.inverted(cloud, w);
        self.len += 1;
        Some(i)
    }

    #[inline(always)]
    fn point(&self, i: usize) -> [f32; 3] {
        let [x, y, z, _] = self.points[i % MOST];
        [x, y, z]
    }

    /// Opens a gate from c to d, whatever is beyond.
    #[inline(always)]
    pub(super) fn open(&mut self, c: usize, d: usize) {
        self.out[c % MOST] |= 1 << (d % MOST);
    }

    /// Closes a gate; false if there is none.
    #[inline(always)]
    pub(super) fn close(&mut self, c: usize, d: usize) -> bool {
        let (out, bit) = (&mut self.out[c % MOST], 1 << (d % MOST));
        let open = *out & bit != 0;
        *out &= !bit;
        open
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
    #[inline(always)]
    pub(super) fn scores(&self, c: usize, d: usize) -> [f32; MOST] {
        let hinge = Hinge::new(self.point(c), self.point(d));
        self.score(|w| match hinge.meets(w) {
            (s, true) => s,
            _ => f32::INFINITY,
        })
    }

    /// Near vertices first.
    #[inline(always)]
    pub(super) fn by_distance(&self) -> [f32; MOST] {
        self.score(|w| -dot(w, w))
    }

    /// Small circles through the vertex and c first.
    #[inline(always)]
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
    #[inline(always)]
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
    #[inline(always)]
    pub(super) fn rank(&self, scores: &[f32; MOST], place: usize) -> Option<usize> {
        let score = scores[place % MOST];
        let before = |&(i, &s): &(usize, &f32)| s < score || (s == score && i < place);
        (score < f32::INFINITY).then(|| scores.iter().enumerate().filter(before).count())
    }
}
