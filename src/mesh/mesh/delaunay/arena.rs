//! The memory of one worker: points, tetrahedra with their spheres, and the error margin of the
//! spheres.

use isospan_io::geom::curve::Order;
use isospan_io::geom::{Lattice, LatticePos};

/// Vertex number of the point at infinity.
pub(super) const INFINITE: u32 = 0;

/// Bit of a record's first vertex: the tetrahedron is in the cavity, or is gone.
pub(super) const DEAD: u32 = 1 << 31;

/// Records at most: a neighbour code holds a record number and two bits for the face.
pub(super) const MOST_TETS: usize = 1 << 30;

/// Tags of a new mesh start here and stay below [`LAST_TAG`]: read as `f32`, as the vector code
/// does, they are normal numbers, which convert fast.
pub(super) const FIRST_TAG: u32 = 0x3f80_0000;
pub(super) const LAST_TAG: u32 = 0x7e00_0000;

/// A point in scaled local coordinates (integers of at most 2^24, exact in `f32`); infinity has
/// NaN.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub(super) struct Point {
    pub(super) at: [f32; 3],
    /// Its number on the boundary of a cavity, above a base that grows from cavity to cavity.
    pub(super) tag: u32,
}

impl Point {
    #[inline]
    pub(super) fn f64s(&self) -> [f64; 3] {
        self.at.map(f64::from)
    }

    /// The integers; only of finite points.
    #[inline]
    pub(super) fn pos(&self) -> LatticePos {
        self.at.map(|c| c as u32)
    }
}

/// A tetrahedron, or a ghost (a hull facet joined to infinity): one cache line.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(in crate::mesh) struct Tetra {
    /// Centre of the circumsphere and squared radius; all NaN when only the integers know.
    pub(super) sphere: [f64; 4],
    /// Vertices, positively oriented; [`INFINITE`] in a ghost, which is oriented as if infinity
    /// were just beyond the hull facet.
    pub(super) v: [u32; 4],
    /// Across the face opposite vertex i: `4·record + face there`.
    pub(super) n: [u32; 4],
}

impl Tetra {
    pub(in crate::mesh) const NONE: Self = Self { sphere: [f64::NAN; 4], v: [DEAD, 0, 0, 0], n: [0; 4] };

    #[inline]
    pub(super) fn is_dead(&self) -> bool {
        self.v[0] & DEAD != 0
    }

    /// The vertices without the cavity's mark.
    #[inline]
    pub(super) fn vertices(&self) -> [u32; 4] {
        [self.v[0] & !DEAD, self.v[1], self.v[2], self.v[3]]
    }

    /// The squared distance to the sphere along a tangent; NaN where only the integers know.
    #[inline]
    pub(super) fn power(&self, p: [f64; 3]) -> f64 {
        let d: [f64; 3] = std::array::from_fn(|k| p[k] - self.sphere[k]);
        d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - self.sphere[3]
    }
}

/// For each place i of a vertex, the other three in the order that makes (face, vertex i)
/// positively oriented.
pub(super) const FACE: [[usize; 3]; 4] = [[1, 3, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2]];

/// The same from the other side: (face, a point beyond it) is positively oriented.
pub(super) const FACE_FROM_BEYOND: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// When a computed sphere may be trusted, and what it decides.
///
/// A power (squared distance to the centre minus squared radius) beyond ±`e` has the right sign;
/// nearer to zero the integers are asked. Spheres whose own error may exceed what `e` allows are
/// stored as NaN, so one absolute margin serves the whole mesh.
///
/// # Proof
/// Let ε = 2^-53, p the tetrahedron's last vertex, u, v, w the others minus p, m the longest of
/// their lengths, D = u·(v×w), h = N / 2D with N = |u|² v×w + |v|² w×u + |w|² u×v: the centre is
/// c = p + h, the radius |h|. Stars mark exact values. u, v, w, the components of the cross
/// products (≤ 2^49) and |u|², |v|², |w|² (< 2^50) are integers below 2^53, hence exact.
///
/// 1. A component of N and D are sums of three products: errors of at most 3ε (to first order)
///    times the sum of the absolute products. Summed up, |δN| ≤ 9ε m⁴ and |δD| ≤ 3ε m³.
/// 2. Ñ/2D̃ - h* = (δN - 2h* δD)/2D̃, and m ≤ 2|h*| (p and the others are on the sphere). With κ =
///    m³/|D̃| ≥ 1: |Ñ/2D̃ - h*| ≤ 12 εκ |h*|. The division by two roundings adds 2.01 ε|h̃|. The
///    acceptance below makes εκ ≤ 2^-10, so |h*| ≤ 1.02 ρ, ρ = |h̃|.
/// 3. Rounding c̃ = p + h̃ moves it by at most ε(√3R + ρ), R the largest coordinate. So the centre
///    is off by at most δ = 16 εκρ + 1.75 εR.
/// 4. For a point q with |q - c̃| ≤ 4ρ the power is off by at most 2·4.1ρδ + δ² (centre), 2.05ρδ +
///    3ερ² (radius) and 6ε·17ρ² (evaluation, in any order of summation, with or without fused
///    operations): together at most 11ρδ + 105ερ² ≤ 281 εκρ² + 20 εRρ.
/// 5. A sphere is accepted if 512 εκ·max(ρ², e) ≤ e/2 (so εκ ≤ 2^-10, as used above) and 80 εRρ ≤
///    e. Then the error is at most 0.28e + 0.25e < e.
/// 6. For |q - c̃| > 4ρ, q is outside the true sphere (δ < ρ/4: the centre's error is small by 5,
///    and ρ ≥ √3/2 against 1.75·2^-29) and the computed power is positive: never a false "in
///    conflict".
///
/// # Exact spheres
/// On lattice-like data most centres lie on the half-lattice, and then the arithmetic can be exact.
/// With h' = round(2h̃)/2 and |2h'| ≤ 2^22 by component, the sums 2h'·u are integers below 2^53:
/// comparing them with |u|², |v|², |w|² proves h' exact. Then c and r² are exact; powers of lattice
/// points are **integers** (|q|² - |p|² - 2c·(q - p) with 2c integer), evaluated without error
/// where |q - c| ≤ 4ρ (squares of half-integers, sum below 2^50 quarter units; e is a power of two,
/// at least 2^-4). Such a sphere is stored with r² lowered by e + ½: an exact tie evaluates to e +
/// ½ and is decided as "not in conflict", which is the tie rule for a new point that is the latest
/// of the five (see [`crate::predicates`]), and a computed power below -e is a true one
/// below -2e - ½.
#[derive(Clone, Copy, Debug)]
pub(super) struct Margin {
    /// The absolute margin: a power of two, at least 2^-4.
    pub(super) e: f64,
    /// A power above this means "outside": `e`, or more while points are inserted out of order.
    pub(super) above: f64,
    /// Largest squared radius accepted: (e / 80εR)²; negative when no sphere is to be trusted.
    pub(super) most_r2: f64,
    /// (e / 1024ε)²: accepted if m⁶·max(ρ², e)² is at most this times D².
    pub(super) most_kappa: f64,
    /// Whether to try exact spheres.
    pub(super) half_lattice: bool,
}

impl Margin {
    const EPSILON: f64 = 1.0 / (1u64 << 53) as f64;
    /// The largest component of 2h' of an exact sphere.
    pub(super) const MOST_EXACT: f64 = (1 << 22) as f64;

    /// No sphere is trusted: the integers decide everything.
    pub(super) const INTEGERS: Self =
        Self { e: 1.0, above: 1.0, most_r2: -1.0, most_kappa: 0.0, half_lattice: false };

    /// A margin for coordinates of at most `largest`, `e` wished for.
    pub(super) fn new(wished: f64, largest: f64, half_lattice: bool) -> Self {
        let mut e = 1.0 / 16.0;
        while e * 2.0 <= wished {
            e *= 2.0;
        }
        let radius = e / (80.0 * Self::EPSILON * largest.max(1.0));
        let kappa = e / (1024.0 * Self::EPSILON);
        Self { e, above: e, most_r2: radius * radius, most_kappa: kappa * kappa, half_lattice }
    }

    /// The sphere through p and p + u, p + v, p + w, to be stored; each of `legs` is a difference
    /// and its squared length.
    #[inline]
    pub(super) fn sphere(&self, p: [f64; 3], legs: [[f64; 4]; 3]) -> [f64; 4] {
        let [u, v, w] = legs;
        let cross = |a: [f64; 4], b: [f64; 4]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let (vw, wu, uv) = (cross(v, w), cross(w, u), cross(u, v));
        let d = u[0] * vw[0] + u[1] * vw[1] + u[2] * vw[2];
        let inverse = 0.5 / d;
        let h: [f64; 3] = std::array::from_fn(|k| (u[3] * vw[k] + v[3] * wu[k] + w[3] * uv[k]) * inverse);
        let r2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
        let m2 = u[3].max(v[3]).max(w[3]);
        let scale = r2.max(self.e);
        // A NaN anywhere makes a comparison false and is refused.
        if !(r2 <= self.most_r2 && m2 * m2 * m2 * (scale * scale) <= self.most_kappa * (d * d)) {
            return [f64::NAN; 4];
        }
        if self.half_lattice {
            let twice = h.map(|c| (c + c).round_ties_even());
            let meets = |l: [f64; 4]| twice[0] * l[0] + twice[1] * l[1] + twice[2] * l[2] == l[3];
            if twice.iter().all(|c| c.abs() <= Self::MOST_EXACT) && meets(u) && meets(v) && meets(w) {
                let h = twice.map(|c| c * 0.5);
                let r2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
                return [p[0] + h[0], p[1] + h[1], p[2] + h[2], r2 - (self.e + 0.5)];
            }
        }
        [p[0] + h[0], p[1] + h[1], p[2] + h[2], r2]
    }
}

/// Shift and scale to small local coordinates.
#[derive(Debug, Default)]
pub(super) struct LocalFrame {
    pub(super) origin: LatticePos,
    pub(super) shift: u32,
}

impl LocalFrame {
    pub(super) fn around(positions: &[LatticePos]) -> Self {
        let origin = positions.iter().fold([u32::MAX; 3], |m, p| std::array::from_fn(|k| m[k].min(p[k])));
        let bits = positions.iter().fold(0, |bits, p| (0..3).fold(bits, |bits, k| bits | (p[k] - origin[k])));
        let shift = if bits == 0 { 0 } else { bits.trailing_zeros() };
        // Space below, for positions that come later.
        let most = positions.iter().fold([0; 3], |m, p| std::array::from_fn(|k| m[k].max(p[k])));
        let below = |k: usize| origin[k].min(most[k] - origin[k]) >> shift << shift;
        let origin =
            if positions.is_empty() { origin } else { std::array::from_fn(|k| origin[k] - below(k)) };
        Self { origin, shift }
    }

    /// Whether a position has coordinates here.
    pub(super) fn has(&self, p: LatticePos) -> bool {
        let last = (1 << self.shift) - 1;
        (0..3).all(|k| p[k] >= self.origin[k] && (p[k] - self.origin[k]) & last == 0)
    }

    /// No coordinate of a position is larger.
    pub(super) fn largest(&self) -> f64 {
        let most = self.origin.map(|c| Lattice::LARGEST.saturating_sub(c) >> self.shift);
        f64::from(most[0].max(most[1]).max(most[2]))
    }

    pub(super) fn point(&self, p: LatticePos) -> Point {
        Point { at: std::array::from_fn(|k| ((p[k] - self.origin[k]) >> self.shift) as f32), tag: 0 }
    }

    fn global(&self, p: LatticePos) -> LatticePos {
        std::array::from_fn(|k| (p[k] << self.shift) + self.origin[k])
    }
}

/// Everything an insertion touches; reused from mesh to mesh.
#[derive(Debug)]
pub(super) struct Arena {
    /// The point at infinity, then the points in insertion order.
    pub(super) points: Vec<Point>,
    pub(super) tets: Vec<Tetra>,
    /// Dead records below `tets.len()`.
    pub(super) free: Vec<u32>,
    pub(super) margin: Margin,
    pub(super) frame: LocalFrame,
    pub(super) order: Order,
    /// Whether each new point is later than all points of the mesh.
    pub(super) in_order: bool,
    /// A live tetrahedron near the next point.
    pub(super) hint: u32,
    /// The cavity, in breadth-first order; before an insertion, tetrahedra known to be in conflict.
    pub(super) cavity: Vec<u32>,
    /// The cavity's boundary as codes of what lies across it: `4·record + face there`.
    pub(super) boundary: Vec<u32>,
    /// For each tetrahedron of a level of the search, which neighbours are in conflict.
    pub(super) masks: Vec<u8>,
    /// The next free tag.
    pub(super) tag: u32,
    /// Vertices of the boundary relative to the new point, and their squared lengths, by local
    /// number.
    pub(super) local: Vec<[f64; 4]>,
    pub(super) star: Star,
    /// Buffers that the wide path uses in place of `local` and `star`.
    #[cfg(target_arch = "x86_64")]
    pub(super) wide: Box<super::scratch::Scratch>,
}

/// The new tetrahedra of an insertion before they are written, one entry a boundary facet.
#[derive(Debug, Default)]
pub(super) struct Star {
    /// Vertices of the facet, and neighbour code across it.
    pub(super) facet: Vec<[u32; 4]>,
    /// Local numbers of the vertices.
    pub(super) local: Vec<[u32; 4]>,
    /// Record number of the new tetrahedron.
    pub(super) id: Vec<u32>,
    /// The vertices by local number.
    pub(super) vertices: Vec<u32>,
    /// `[from << log2 + to]` of a directed edge, in local numbers: `4·entry + face`.
    pub(super) edges: Vec<u16>,
    /// The same as a list to sort, for large cavities.
    pub(super) edge_list: Vec<(u64, u32)>,
}

impl Default for Arena {
    fn default() -> Self {
        Self {
            points: Vec::new(),
            tets: Vec::new(),
            free: Vec::new(),
            margin: Margin::INTEGERS,
            frame: LocalFrame::default(),
            order: Order { bits: 1 },
            in_order: false,
            hint: 0,
            cavity: Vec::new(),
            boundary: Vec::new(),
            masks: Vec::new(),
            tag: FIRST_TAG,
            local: Vec::new(),
            star: Star::default(),
            #[cfg(target_arch = "x86_64")]
            wide: super::scratch::Scratch::boxed(),
        }
    }
}

impl Arena {
    #[inline]
    pub(super) fn position(&self, vertex: u32) -> LatticePos {
        self.points[vertex as usize].pos()
    }

    /// The places of five finite vertices in the insertion order of their positions.
    pub(super) fn ranks(&self, vertices: [u32; 5]) -> [u32; 5] {
        let keys = vertices.map(|v| {
            let at = self.frame.global(self.position(v));
            (self.order.key(at), at)
        });
        keys.map(|k| keys.iter().filter(|other| **other < k).count() as u32)
    }

    /// Gives each new tetrahedron a record: first those of the cavity, then free ones, then new
    /// ones. Leaves the cavity empty.
    pub(super) fn allocate(&mut self) {
        let wanted = self.boundary.len();
        let id = &mut self.star.id;
        std::mem::swap(id, &mut self.cavity);
        self.cavity.clear();
        if id.len() > wanted {
            self.free.extend(id.drain(wanted..));
        }
        while id.len() < wanted {
            id.push(self.free.pop().unwrap_or_else(|| {
                self.tets.push(Tetra::NONE);
                self.tets.len() as u32 - 1
            }));
        }
    }

    /// The sphere of a record as it stands; NaN for ghosts.
    pub(super) fn sphere_of(&self, tet: u32) -> [f64; 4] {
        let v = self.tets[tet as usize].vertices().map(|v| self.points[v as usize].f64s());
        let leg = |q: [f64; 3]| {
            let d: [f64; 3] = std::array::from_fn(|k| q[k] - v[3][k]);
            [d[0], d[1], d[2], d[0] * d[0] + d[1] * d[1] + d[2] * d[2]]
        };
        self.margin.sphere(v[3], [leg(v[0]), leg(v[1]), leg(v[2])])
    }
}
