//! The link of a vertex, and the geometry that predicts it.
//!
//! With the vertex at the origin, [inversion](https://en.wikipedia.org/wiki/Inversive_geometry)
//! w' = w / |w|² turns spheres through it into planes: the sphere through the vertex, c, d and w
//! has its centre m where m·c' = m·d' = m·w' = 1/2. The centres that satisfy the first two are a
//! line m0 + s n with n = c' × d'; a point w in front of the gate (n·w' > 0) is met at s = (1/2 -
//! m0·w') / (n·w'), and the Delaunay triangle behind the gate is the one met first. All is scaled
//! by 2 |n|², so that only the last step divides.
//!
//! The *key* is one number that holds the least of several s and the point it belongs to: s with
//! the place of the point in its lowest bits. So the first of points that are met at about the same
//! s is predicted.
//!
//! Everything is `f32` arithmetic in a fixed order, with fused multiplications and additions where
//! the code says so. IEEE 754 makes that the same everywhere; its errors cost bits, not
//! correctness.

use isospan_io::geom::LatticePos;

/// Room for a link: more than it may have vertices, for what ends the list.
pub(super) const MOST: usize = super::LARGEST_LINK + 4;
/// No vertex of a link.
pub(super) const NOBODY: usize = MOST - 1;
/// Vertices nearby that are taken at the beginning: the rest is for vertices that must be named.
pub(super) const MOST_NEAR: usize = 48;
/// Gates that are looked at together.
pub(super) const LANES: usize = 4;
/// Bits of a key that hold the place.
pub(super) const PLACE: u32 = MOST as u32 - 1;
/// Entries of a ring of gates; at most half of them wait.
const RING: usize = 2048;
/// More than the vertices of a block.
pub(super) const VERTICES: usize = 2 * super::LARGEST_LIST as usize;
/// Points behind the last one, far from everything.
const FAR: f32 = 1e18;

/// A point, and a number that goes with it: of an inverted one the sum of its absolute coordinates.
pub(super) type Point = [f32; 4];
/// A directed edge of a link: from a place, times 256, to another.
pub(super) type Gate = u16;
/// More than any gate.
pub(super) const GATES: usize = MOST << 8;
/// There is never such a gate.
const NO_GATE: Gate = gate(NOBODY, NOBODY);

#[inline(always)]
pub(super) const fn gate(c: usize, d: usize) -> Gate {
    (c << 8 | d) as Gate
}

/// The places that a gate is from and to.
#[inline(always)]
pub(super) fn ends(gate: Gate) -> [usize; 2] {
    [usize::from(gate >> 8) % MOST, usize::from(gate & 255) % MOST]
}

/// How the inner loops are run; all ways give the same bits.
pub(super) trait Path: Copy {
    /// Begins the list of a link with the vertices behind `v` that are within the radius of it, the
    /// first [`MOST_NEAR`].
    fn near(self, cloud: &Cloud, v: usize, link: &mut Link);
    /// Inverts the first `len` points of a link, and may put anything into those behind them.
    fn invert(self, cloud: &Cloud, link: &mut Link);
    /// Predicts what is behind each of the gates; there is garbage beyond their number.
    fn search(self, link: &Link, gates: &mut Gates);
    /// Runs rare code, out of the way of frequent code.
    fn apart<T>(self, f: impl FnOnce() -> T) -> T;
}

/// The path for every machine.
#[derive(Clone, Copy)]
pub(super) struct Plain;

/// The vertices of a block, in units in which the radius of a neighbourhood is between 1 and 2.
pub(super) struct Cloud {
    /// Coordinates along x, y and z, in whole sixteens.
    pub(super) axes: [Vec<f32>; 3],
    points: Box<[Point; VERTICES]>,
    len: usize,
    pub(super) radius2: f32,
}

impl Default for Cloud {
    fn default() -> Self {
        Self { axes: Default::default(), points: Box::new([[0.0; 4]; VERTICES]), len: 0, radius2: 0.0 }
    }
}

impl Cloud {
    /// Sets the points. `size` gives the radius: its square is `1 + size % 4 / 4` times 2 to the
    /// power of `size / 4`, in lattice steps.
    pub(super) fn set(&mut self, positions: &[LatticePos], size: u8) {
        let power = i32::from(size >> 2);
        let (unit, rest) = (power / 2, power % 2);
        self.radius2 = (1.0 + f32::from(size & 3) / 4.0) * (1 << rest) as f32;
        let scale = f32::from_bits(((127 - unit) as u32) << 23);
        let base = positions.first().copied().unwrap_or_default();
        // Exact: less than 2^24, times a power of two.
        let along = |p: &LatticePos, k: usize| (p[k] as i32).wrapping_sub(base[k] as i32) as f32 * scale;
        self.len = positions.len();
        for (to, p) in self.points.iter_mut().zip(positions) {
            *to = [along(p, 0), along(p, 1), along(p, 2), 0.0];
        }
        for (k, axis) in self.axes.iter_mut().enumerate() {
            axis.clear();
            axis.extend(self.points[..self.len].iter().map(|p| p[k]));
            axis.resize(self.len.next_multiple_of(16), FAR);
        }
    }

    /// Where a vertex is.
    #[inline(always)]
    pub(super) fn point(&self, v: usize) -> &Point {
        &self.points[v % VERTICES]
    }
}

/// What is known of the link of one vertex. Its points begin at a cache line, so that four of them
/// fill one.
#[repr(C, align(64))]
pub(super) struct Link {
    /// Its vertices, inverted; behind them is a point that is in front of no gate.
    pub(super) points: [Point; MOST],
    /// The vertex.
    pub(super) from: Point,
    pub(super) len: usize,
    /// Block-local numbers of its vertices.
    pub(super) id: [u16; MOST],
    /// For each vertex of the block where it was in `id` when it, or another of its number, was
    /// there last, and 256 times the link's stamp then.
    slot: Box<[u32; VERTICES]>,
    /// The stamp of this link, shifted; no other link has had it since the slots were cleared.
    stamp: u32,
    /// For each gate whether it is open: 1 or 0.
    open: Box<[u8; GATES]>,
    /// Gates in the order in which they were opened, some closed again since. Those from `head` to
    /// `tail` wait to be looked at.
    ring: Box<[Gate; RING]>,
    head: usize,
    tail: usize,
}

/// Some gates, and what is predicted behind each.
pub(super) struct Gates {
    pub(super) len: usize,
    /// The gates, and one that is not in use.
    pub(super) gates: [Gate; LANES + 1],
    /// The key of the apex, infinity where nothing is in front.
    pub(super) keys: [f32; LANES],
}

impl Default for Gates {
    fn default() -> Self {
        Self { len: 0, gates: [NO_GATE; LANES + 1], keys: [f32::INFINITY; LANES] }
    }
}

impl Gates {
    /// The place of the apex that is predicted for a gate; [`NOBODY`] if nothing is in front.
    #[inline(always)]
    pub(super) fn apex(&self, lane: usize) -> usize {
        let key = self.keys[lane % LANES];
        if key < f32::INFINITY { (key.to_bits() & PLACE) as usize } else { NOBODY }
    }
}

/// A plane through two inverted points: all that the search needs.
#[derive(Clone, Copy, Default)]
struct Hinge {
    n: [f32; 3],
    u: [f32; 3],
    nn: f32,
    /// A point that is less in front counts as noise: rounding errors of n·w' are below.
    least: f32,
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

impl Hinge {
    #[inline(always)]
    fn new([cx, cy, cz, sc]: Point, [dx, dy, dz, sd]: Point) -> Self {
        let (c, d) = ([cx, cy, cz], [dx, dy, dz]);
        let minor = |j: usize, k: usize| c[j].mul_add(d[k], -(c[k] * d[j]));
        let n = [minor(1, 2), minor(2, 0), minor(0, 1)];
        let (cc, cd, dd) = (dot(c, c), dot(c, d), dot(d, d));
        let (p, q) = (dd - cd, cc - cd);
        let u = [0, 1, 2].map(|k| p.mul_add(c[k], q * d[k]));
        Self { n, u, nn: dot(n, n), least: sc * sd * (sc + sd) * (1.0 / (1 << 21) as f32) }
    }

    /// The key of the point: where the sphere meets it, with its place in the lowest bits. It is no
    /// number if the point is not in front.
    #[inline(always)]
    fn key(&self, [x, y, z, _]: Point, place: usize) -> f32 {
        let h = dot(self.n, [x, y, z]);
        let u = self.u;
        let over = (-u[2]).mul_add(z, (-u[1]).mul_add(y, (-u[0]).mul_add(x, self.nn)));
        let key = f32::from_bits((over / h).to_bits() & !PLACE | place as u32);
        if h > self.least { key } else { f32::NAN }
    }
}

impl Path for Plain {
    fn near(self, cloud: &Cloud, v: usize, link: &mut Link) {
        let from = cloud.point(v);
        link.len = 0;
        for w in v + 1..cloud.len {
            let p = cloud.point(w);
            let d = [p[0] - from[0], p[1] - from[1], p[2] - from[2]];
            if dot(d, d) <= cloud.radius2 && link.len < MOST_NEAR {
                link.id[link.len] = w as u16;
                link.len += 1;
            }
        }
    }

    fn invert(self, cloud: &Cloud, link: &mut Link) {
        for i in 0..link.len {
            link.points[i] = link.inverted(cloud, link.id[i]);
        }
    }

    fn search(self, link: &Link, gates: &mut Gates) {
        for lane in 0..LANES {
            let [c, d] = ends(gates.gates[lane]);
            let hinge = Hinge::new(link.point(c), link.point(d));
            let keys = (0..link.len).map(|i| hinge.key(link.point(i), i));
            gates.keys[lane] = keys.fold(f32::INFINITY, |best, key| if key < best { key } else { best });
        }
    }

    fn apart<T>(self, f: impl FnOnce() -> T) -> T {
        f()
    }
}

impl Default for Link {
    fn default() -> Self {
        Self {
            from: [0.0; 4],
            len: 0,
            id: [0; MOST],
            points: [[0.0; 4]; MOST],
            slot: Box::new([0; VERTICES]),
            stamp: 0,
            open: Box::new([0; GATES]),
            ring: Box::new([NO_GATE; RING]),
            head: 0,
            tail: 0,
        }
    }
}

impl Link {
    /// Prepares for another block.
    pub(super) fn clear(&mut self) {
        self.len = 0;
        (self.head, self.tail) = (0, 0);
    }

    /// Closes all gates, where a block is given up.
    pub(super) fn give_up(&mut self) {
        self.open.fill(0);
    }

    /// Begins the link of `v` with the larger vertices nearby.
    #[inline(always)]
    pub(super) fn begin(&mut self, path: impl Path, cloud: &Cloud, v: usize) {
        self.from = *cloud.point(v);
        path.near(cloud, v, self);
        path.invert(cloud, self);
        self.end_list();
        self.stamp = self.stamp.wrapping_add(1 << 8);
        if self.stamp == 0 {
            self.slot.fill(0);
            self.stamp = 1 << 8;
        }
        let (stamp, slot) = (self.stamp, &mut *self.slot);
        for (&w, place) in self.id.iter().zip(0..self.len as u32) {
            slot[usize::from(w) % VERTICES] = stamp | place;
        }
    }

    /// Puts points that are in front of no gate behind the last one, so that points can be looked
    /// at in fours.
    #[inline(always)]
    fn end_list(&mut self) {
        let n = self.len.min(MOST - 4);
        self.points[n..n + 4].fill([0.0; 4]);
    }

    /// A vertex of the block inverted, seen from this link's.
    #[inline(always)]
    fn inverted(&self, cloud: &Cloud, w: u16) -> Point {
        let (p, from) = (cloud.point(w.into()), self.from);
        let d = [p[0] - from[0], p[1] - from[1], p[2] - from[2]];
        let q = 1.0 / dot(d, d);
        let [x, y, z] = d.map(|c| c * q);
        [x, y, z, x.abs() + y.abs() + z.abs()]
    }

    /// The place of a vertex, or a number that is none.
    #[inline(always)]
    pub(super) fn place_if_any(&self, w: u16) -> u32 {
        self.slot[usize::from(w) % VERTICES] ^ self.stamp
    }

    /// The place of a vertex, if it has one.
    #[inline(always)]
    pub(super) fn find(&self, w: u16) -> Option<usize> {
        let i = self.place_if_any(w);
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
        if i >= super::LARGEST_LINK {
            return None;
        }
        self.id[i] = w;
        self.slot[usize::from(w) % VERTICES] = self.stamp | i as u32;
        self.points[i] = self.inverted(cloud, w);
        self.len += 1;
        self.end_list();
        Some(i)
    }

    #[inline(always)]
    fn point(&self, i: usize) -> Point {
        self.points[i % MOST]
    }

    #[inline(always)]
    pub(super) fn is_open(&self, gate: Gate) -> bool {
        self.open[usize::from(gate) % GATES] != 0
    }

    /// Opens a gate from c to d, regardless of what is beyond.
    #[inline(always)]
    pub(super) fn open(&mut self, c: usize, d: usize) {
        self.open[usize::from(gate(c, d)) % GATES] = 1;
        self.push(gate(c, d), 1);
    }

    /// Closes a gate, if it is open.
    #[inline(always)]
    pub(super) fn close(&mut self, gate: Gate) {
        self.open[usize::from(gate) % GATES] = 0;
    }

    /// An edge of a new triangle: closes the gate of opposite direction, for both sides are known
    /// then; without one, opens a gate.
    #[inline(always)]
    pub(super) fn meet(&mut self, edge: Gate) {
        let back = &mut self.open[usize::from(edge.rotate_left(8)) % GATES];
        let new = std::mem::take(back) ^ 1;
        self.open[usize::from(edge) % GATES] |= new;
        self.push(edge, new);
    }

    #[inline(always)]
    fn push(&mut self, gate: Gate, gates: u8) {
        self.ring[self.tail % RING] = gate;
        self.tail += usize::from(gates);
    }

    /// Whether more gates wait than a mesh can have.
    #[inline(always)]
    pub(super) fn is_crowded(&self) -> bool {
        self.tail - self.head > RING / 2
    }

    /// The next gates that are still open, with what is predicted of them. False if no gate waits;
    /// none may be open even so.
    #[inline(always)]
    pub(super) fn predict(&mut self, path: impl Path, gates: &mut Gates) -> bool {
        let Some(four) = self.next_four() else { return false };
        let mut n = 0;
        gates.gates = [NO_GATE; LANES + 1];
        for (gate, is_open) in four {
            // Gates that are not counted are overwritten.
            gates.gates[n] = gate;
            n += usize::from(is_open);
        }
        gates.gates[n] = NO_GATE;
        gates.len = n;
        if n > 0 {
            path.search(self, gates);
        }
        true
    }

    /// The gates that are to be looked at together, and whether each is still open: 1 or 0. `None`
    /// if no gate waits.
    #[inline(always)]
    pub(super) fn next_four(&mut self) -> Option<[(Gate, u8); LANES]> {
        let (first, waiting) = (self.head, self.tail - self.head);
        self.head += waiting.min(LANES);
        let gate = |k: usize| {
            // A gate that does not wait is an old one, which may be open again.
            let gate = if k < waiting { self.ring[(first + k) % RING] } else { NO_GATE };
            (gate, self.open[usize::from(gate) % GATES])
        };
        (waiting > 0).then(|| std::array::from_fn(gate))
    }

    /// The keys of all vertices; infinity for what is not in front.
    #[inline(always)]
    pub(super) fn scores(&self, gate: Gate) -> [f32; MOST] {
        let [c, d] = ends(gate);
        let hinge = Hinge::new(self.point(c), self.point(d));
        self.score(|w, i| hinge.key(w, i))
    }

    /// Near vertices first.
    #[inline(always)]
    pub(super) fn by_distance(&self) -> [f32; MOST] {
        self.score(|[x, y, z, _], _| -dot([x, y, z], [x, y, z]))
    }

    /// Small circles through the vertex and c first.
    #[inline(always)]
    pub(super) fn by_circle(&self, c: usize) -> [f32; MOST] {
        let p = self.point(c);
        self.score(|w, _| {
            let n = Hinge::new(p, w).nn;
            let e = [w[0] - p[0], w[1] - p[1], w[2] - p[2]];
            if n > 0.0 { -n / dot(e, e) } else { f32::INFINITY }
        })
    }

    #[inline(always)]
    fn score(&self, f: impl Fn(Point, usize) -> f32) -> [f32; MOST] {
        let mut scores = [f32::INFINITY; MOST];
        for (i, score) in scores.iter_mut().enumerate().take(self.len) {
            let s = f(self.point(i), i);
            *score = if s.is_finite() { s } else { f32::INFINITY };
        }
        scores
    }

    /// The place of rank `rank` when the vertices are ordered by finite scores, least first, of
    /// equal ones the first.
    #[inline(always)]
    pub(super) fn nth(&self, scores: &[f32; MOST], rank: usize) -> Option<usize> {
        // Behind the last one the scores are infinite, too; so full vectors can be looked at.
        let scores = &scores[..self.len.next_multiple_of(8).min(MOST)];
        let (mut last, mut before) = (f32::NEG_INFINITY, 0);
        loop {
            let later = scores.iter().map(|&s| if s > last { s } else { f32::INFINITY });
            last = later.fold(f32::INFINITY, |least, s| if s < least { s } else { least });
            if last == f32::INFINITY {
                return None;
            }
            let equal: usize = scores.iter().map(|&s| usize::from(s == last)).sum();
            if rank < before + equal {
                let mut places = (0..scores.len()).filter(|&i| scores[i] == last);
                return places.nth(rank - before);
            }
            before += equal;
        }
    }

    /// The rank of a place; `None` if its score is not finite.
    #[inline(always)]
    pub(super) fn rank(&self, scores: &[f32; MOST], place: usize) -> Option<usize> {
        let score = scores[place % MOST];
        let before = |&(i, &s): &(usize, &f32)| s < score || (s == score && i < place);
        (score < f32::INFINITY).then(|| scores.iter().take(self.len).enumerate().filter(before).count())
    }
}
