//! Points numbered by an integer k, whose coordinates are radical inverses of k or k itself: found
//! box by box.
//!
//! A [`Net`] is Halton's or Hammersley's set, in a box, on a face of it or on an edge. Nothing is
//! generated and then sorted into boxes: a box finds its own k. In base b, with e digits,
//!
//! ```text
//! Φ_b(k) ∈ [a/b^e, (a+1)/b^e)   ⇔   k ≡ mirror(a)  (mod b^e)
//! ```
//!
//! so an *elementary box*, one such interval on each axis, holds exactly one residue class modulo
//! M = 2^e2·3^e3·5^e5 (Chinese remainder theorem; Niederreiter 1992, chapter 3), a point in every
//! M. On an axis where the coordinate is (k+t)/n, the box gives a range of k. To find the points of
//! a box:
//!
//! 1. take the real intervals that *round* into the box (a point belongs to the box of its rounded
//!    position),
//! 2. choose e2, e3, e5 so that the elementary boxes that cover them waste little and are not too
//!    many,
//! 3. step through each residue class, round, keep what lies in the box.
//!
//! Cost: about 1.2 candidates a kept point for boxes of a thousand points; no memory beyond the
//! answer.
//!
//! Example: Φ₂ ∈ [1/2, 3/4) is the one interval a = 2 of e = 2 digits, mirror(10₂) = 01₂: the k ≡ 1
//! (mod 4). With Φ₃ ∈ [1/3, 2/3), k ≡ 1 (mod 3), that is k ≡ 1 (mod 12).

use super::radical_inverse::{Base, mirror, round_fraction};
use crate::simd::{Avx512, with_avx512, with_vectors};
use isospan_io::geom::{LatticeBox, LatticePos, PointClass, PointId, Site};

/// What a coordinate of a [`Net`] is, k being the point's number and i = k - first its index.
#[derive(Clone, Copy, Debug)]
pub(super) enum NetAxis {
    /// The same position for all points.
    Fixed(u32),
    /// (i + shift)/n.
    Even,
    /// Φ_b(k).
    Radical(Base),
}

/// The points k = first … first+n-1 on up to three axes.
#[derive(Clone, Debug)]
pub(super) struct Net {
    axes: [NetAxis; 3],
    /// Position of coordinate 1 on each axis.
    max: LatticePos,
    first: u64,
    n: u64,
    /// Shift of [`NetAxis::Even`] in 2^-32.
    shift: u32,
    /// ⌊2^123/n⌋, for [`NetAxis::Even`].
    reciprocal: u128,
    class: PointClass,
    /// Index in the class = index in the net · stride + offset.
    stride: u64,
    offset: u64,
}

/// Candidates handled together, so that each axis is one tight loop.
const BATCH: usize = 256;

impl Net {
    /// A net of interior points.
    pub(super) fn new(axes: [NetAxis; 3], max: LatticePos, first: u64, n: u64, shift: u32) -> Self {
        debug_assert!(n <= super::MOST_POINTS && first <= 1);
        let reciprocal = (1u128 << 123) / u128::from(n.max(1));
        Self { axes, max, first, n, shift, reciprocal, class: PointClass::Interior, stride: 1, offset: 0 }
    }

    /// The same net with ids `index · stride + offset` of `class`.
    pub(super) fn named(self, class: PointClass, stride: u64, offset: u64) -> Self {
        Self { class, stride, offset, ..self }
    }

    /// Number of points, before duplicates.
    pub(super) fn len(&self) -> u64 {
        self.n
    }

    /// The position of the point of this index; `None` when there is none.
    pub(super) fn position(&self, index: u64) -> Option<LatticePos> {
        let k = self.first + index;
        (index < self.n).then(|| {
            std::array::from_fn(|a| match self.axes[a] {
                NetAxis::Fixed(p) => p,
                NetAxis::Even => self.even_position(index, self.max[a]),
                NetAxis::Radical(base) => base.position(k, self.max[a]),
            })
        })
    }

    /// About the number of points in a box: exact along a (k+t)/n axis, by the share of length
    /// along the others.
    pub(super) fn count_in(&self, b: &LatticeBox) -> u64 {
        let Some((lo, hi)) = self.numbers_in(b) else { return 0 };
        // n < 2^60; two factors of 25 bits and 16 bits of fraction stay below 2^127.
        let mut count = u128::from(hi - lo) << 16;
        for a in 0..3 {
            if matches!(self.axes[a], NetAxis::Radical(_)) {
                count = count * u128::from(b.hi[a] - b.lo[a]) / u128::from(self.max[a] + 1);
            }
        }
        ((count + (1 << 15)) >> 16) as u64
    }

    /// The number of points by the share of length along each axis that is not fixed.
    pub(super) fn share_in(&self, b: &LatticeBox) -> f64 {
        let mut share = self.n as f64;
        for a in 0..3 {
            match self.axes[a] {
                NetAxis::Fixed(p) if !(b.lo[a] <= p && p < b.hi[a]) => return 0.0,
                NetAxis::Fixed(_) => {}
                _ => share *= f64::from(b.hi[a] - b.lo[a]) / f64::from(self.max[a] + 1),
            }
        }
        share
    }

    /// Appends all points whose rounded position lies in the box, in no particular order,
    /// duplicates included.
    pub(super) fn sites_in(&self, b: &LatticeBox, out: &mut Vec<Site>) {
        let Some(numbers) = self.numbers_in(b) else { return };
        let Some(cover) = Cover::new(self, b, numbers) else { return };
        let mut batch = Batch::new(self, b, out);
        for &r0 in &cover.residues[0] {
            for &r1 in &cover.residues[1] {
                let r01 = add_mod(r0, r1, cover.modulus);
                for &r2 in &cover.residues[2] {
                    let mut k = numbers.0 + add_mod(r01, r2, cover.modulus);
                    while k < numbers.1 {
                        batch.push(k);
                        k += cover.modulus;
                    }
                }
            }
        }
        batch.flush();
    }

    /// The range of k that the fixed and even axes leave; `None` when no point can be in the box.
    fn numbers_in(&self, b: &LatticeBox) -> Option<(u64, u64)> {
        let (mut lo, mut hi) = (0, self.n);
        for a in 0..3 {
            match self.axes[a] {
                NetAxis::Fixed(p) if !(b.lo[a] <= p && p < b.hi[a]) => return None,
                NetAxis::Even => {
                    lo = lo.max(self.first_even(b.lo[a], self.max[a]));
                    hi = hi.min(self.first_even(b.hi[a], self.max[a]));
                }
                _ => {}
            }
        }
        (lo < hi && !b.is_empty()).then_some((self.first + lo, self.first + hi))
    }

    /// The lowest index with an even coordinate of at least `p`:
    /// (i + T/2^32)/n · max + 1/2 >= p, so i·2^32 + T >= (2p - 1)·n·2^31/max.
    fn first_even(&self, p: u32, max: u32) -> u64 {
        if p == 0 {
            return 0;
        }
        let wanted = ((u128::from(2 * p - 1) * u128::from(self.n)) << 31).div_ceil(u128::from(max));
        let index = wanted.saturating_sub(u128::from(self.shift)).div_ceil(1 << 32);
        index.min(u128::from(self.n)) as u64
    }

    /// ⌊(i + T/2^32)/n · max + 1/2⌋. The reciprocal is off by less than 1, so the product by less
    /// than n < 2^60 in 2^-123, which is 2 in 2^-64; the shift's part and the cut to 64 bits by
    /// less than 1 each.
    #[inline]
    fn even_position(&self, index: u64, max: u32) -> u32 {
        let sum = u128::from(index) * self.reciprocal + (self.reciprocal >> 32) * u128::from(self.shift);
        round_fraction((sum >> 59) as u64, 4, max).unwrap_or_else(|| self.exact_even_position(index, max))
    }

    #[cold]
    fn exact_even_position(&self, index: u64, max: u32) -> u32 {
        let (n, i, t) = (u128::from(self.n), u128::from(index), u128::from(self.shift));
        ((((i << 32) + t) * 2 * u128::from(max) + (n << 32)) / (n << 33)) as u32
    }
}

/// Collects candidates and keeps those in the box.
struct Batch<'a> {
    net: &'a Net,
    bounds: LatticeBox,
    out: &'a mut Vec<Site>,
    /// Whether all numbers of the net are ones that [`Base::positions`] takes.
    is_short: bool,
    numbers: [u64; BATCH],
    pos: [[u32; BATCH]; 3],
    /// For each point, whether it is in the box: 1 or 0.
    inside: [u8; BATCH],
    len: usize,
}

impl<'a> Batch<'a> {
    fn new(net: &'a Net, bounds: &LatticeBox, out: &'a mut Vec<Site>) -> Self {
        let takes = |axis: &NetAxis| match axis {
            NetAxis::Radical(base) => base.takes(net.first + net.n),
            _ => Base::Two.takes(net.first + net.n),
        };
        Self {
            net,
            bounds: *bounds,
            out,
            is_short: net.axes.iter().all(takes),
            numbers: [0; BATCH],
            pos: [[0; BATCH]; 3],
            inside: [0; BATCH],
            len: 0,
        }
    }

    #[inline]
    fn push(&mut self, k: u64) {
        self.numbers[self.len] = k;
        self.len += 1;
        if self.len == BATCH {
            self.flush();
        }
    }

    fn flush(&mut self) {
        match self.is_short {
            true => match Avx512::found() {
                Some(proof) => with_avx512(
                    proof,
                    #[inline(always)]
                    || self.place_short(),
                ),
                None => with_vectors(
                    #[inline(always)]
                    || self.place_short(),
                ),
            },
            false => self.place(),
        }
        let numbers = &self.numbers[..self.len];
        // Which are kept is unpredictable: select without branches, then copy.
        let [xs, ys, zs] = &self.pos;
        let (mut kept, mut many) = ([0u16; BATCH], 0);
        for (j, is_inside) in self.inside[..self.len].iter().enumerate() {
            kept[many] = j as u16;
            many += usize::from(*is_inside);
        }
        self.out.extend(kept[..many].iter().map(|&j| {
            let j = usize::from(j) % BATCH;
            let index = (numbers[j] - self.net.first) * self.net.stride + self.net.offset;
            Site { id: PointId::new(self.net.class, index), pos: [xs[j], ys[j], zs[j]] }
        }));
        self.len = 0;
    }

    /// Places the numbers, and looks which are in the box.
    fn place(&mut self) {
        let numbers = &self.numbers[..self.len];
        for (a, pos) in self.pos.iter_mut().enumerate() {
            let max = self.net.max[a];
            let each = pos.iter_mut().zip(numbers);
            match self.net.axes[a] {
                NetAxis::Fixed(p) => pos.fill(p),
                NetAxis::Even => each.for_each(|(p, k)| *p = self.net.even_position(k - self.net.first, max)),
                NetAxis::Radical(Base::Two) => each.for_each(|(p, &k)| *p = Base::Two.position(k, max)),
                NetAxis::Radical(Base::Three) => each.for_each(|(p, &k)| *p = Base::Three.position(k, max)),
                NetAxis::Radical(Base::Five) => each.for_each(|(p, &k)| *p = Base::Five.position(k, max)),
            }
        }
        self.look_inside();
    }

    /// The same, of numbers that [`Base::positions`] takes.
    #[inline(always)]
    fn place_short(&mut self) {
        let (mut short, n) = ([0u32; BATCH], self.len.min(BATCH));
        short.iter_mut().zip(&self.numbers).for_each(|(short, &k)| *short = k as u32);
        for (a, pos) in self.pos.iter_mut().enumerate() {
            let (max, numbers, pos) = (self.net.max[a], &short[..n], &mut pos[..n]);
            match self.net.axes[a] {
                NetAxis::Fixed(p) => pos.fill(p),
                NetAxis::Even => {
                    let index = |k: u32| u64::from(k) - self.net.first;
                    pos.iter_mut()
                        .zip(numbers)
                        .for_each(|(p, &k)| *p = self.net.even_position(index(k), max));
                }
                NetAxis::Radical(Base::Two) => Base::Two.positions(numbers, max, pos),
                NetAxis::Radical(Base::Three) => Base::Three.positions(numbers, max, pos),
                NetAxis::Radical(Base::Five) => Base::Five.positions(numbers, max, pos),
            }
        }
        self.look_inside();
    }

    #[inline(always)]
    fn look_inside(&mut self) {
        let LatticeBox { lo, hi } = self.bounds;
        let ([xs, ys, zs], inside) = (&self.pos, &mut self.inside);
        for (((inside, x), y), z) in inside.iter_mut().zip(xs).zip(ys).zip(zs) {
            let within = |p: u32, a: usize| p.wrapping_sub(lo[a]) < hi[a] - lo[a];
            *inside = u8::from(within(*x, 0) & within(*y, 1) & within(*z, 2));
        }
    }
}

/// The elementary boxes that cover a box.
struct Cover {
    /// M.
    modulus: u64,
    /// What each elementary interval of an axis adds to the residue; the residue is relative to the
    /// first number.
    residues: [Vec<u64>; 3],
}

/// A choice of digits for an axis: base^digits intervals, of which `from ..= to` cover the box.
#[derive(Clone, Copy, Debug)]
struct Digits {
    digits: u32,
    power: u64,
    from: u64,
    to: u64,
}

impl Digits {
    fn intervals(&self) -> u64 {
        self.to - self.from + 1
    }
}

/// More intervals an axis than this would not pay: at 64, at most 2 in 64 are partly outside.
const MOST_INTERVALS: u64 = 64;

/// Residue arithmetic adds two numbers below M in 64 bits, and k + M must not overflow.
const LARGEST_MODULUS: f64 = (1u64 << 62) as f64;

impl Cover {
    /// `None` when the box holds no point of a radical axis.
    fn new(net: &Net, b: &LatticeBox, numbers: (u64, u64)) -> Option<Self> {
        let mut choices: [Vec<Digits>; 3] = Default::default();
        for (a, choices) in choices.iter_mut().enumerate() {
            *choices = match net.axes[a] {
                NetAxis::Radical(base) => choices_of(base, [b.lo[a], b.hi[a]], net.max[a], net.n)?,
                _ => vec![Digits { digits: 0, power: 1, from: 0, to: 0 }],
            };
        }
        let best = cheapest(&choices, numbers.1 - numbers.0);
        let modulus: u64 = best.iter().map(|d| d.power).product();
        let mut residues: [Vec<u64>; 3] = Default::default();
        for a in 0..3 {
            residues[a] = match net.axes[a] {
                NetAxis::Radical(base) => residues_of(base, &best[a], modulus),
                _ => vec![0],
            };
        }
        let first = numbers.0 % modulus;
        for r in &mut residues[0] {
            *r = add_mod(*r, modulus - first, modulus);
        }
        Some(Self { modulus, residues })
    }
}

/// The choices worth considering for an axis: of those with equally many intervals, the one with
/// most digits. `None` when no radical inverse rounds into `lo..hi`.
fn choices_of(base: Base, [lo, hi]: [u32; 2], max: u32, n: u64) -> Option<Vec<Digits>> {
    // Φ·max + 1/2 ∈ [lo, hi), in half steps.
    let (lo2, hi2) = (u128::from((2 * lo).saturating_sub(1)), u128::from(2 * hi - 1));
    let max2 = 2 * u128::from(max);
    let mut choices: Vec<Digits> = Vec::with_capacity(8);
    let (mut digits, mut power) = (0, 1u64);
    loop {
        let from = (lo2 * u128::from(power) / max2) as u64;
        let to = ((hi2 * u128::from(power)).div_ceil(max2).min(u128::from(power)) as u64).checked_sub(1)?;
        if from > to {
            return None;
        }
        let choice = Digits { digits, power, from, to };
        if choices.last().is_some_and(|c| c.intervals() >= choice.intervals()) {
            choices.pop();
        }
        if choice.intervals() <= MOST_INTERVALS {
            choices.push(choice);
        }
        if choice.intervals() > MOST_INTERVALS || power > n {
            return Some(choices);
        }
        digits += 1;
        power *= base.get();
    }
}

/// The combination of least cost, in units of a candidate: a residue class costs about a third of
/// one more, an interval (a remainder in 128 bits) about two. Only speed depends on it.
fn cheapest(choices: &[Vec<Digits>; 3], numbers: u64) -> [Digits; 3] {
    let mut best = [choices[0][0], choices[1][0], choices[2][0]];
    let mut least = f64::INFINITY;
    for d0 in &choices[0] {
        for d1 in &choices[1] {
            for d2 in &choices[2] {
                // In floating-point numbers: that a modulus is a little above the limit does no
                // harm.
                let modulus = [d0, d1, d2].iter().map(|d| d.power as f64).product::<f64>();
                if modulus > LARGEST_MODULUS {
                    continue;
                }
                let m = [d0, d1, d2].map(|d| d.intervals() as f64);
                let classes = m[0] * m[1] * m[2];
                let candidates = classes * (numbers as f64 / modulus);
                let cost = candidates + CLASS_COST * classes + INTERVAL_COST * (m[0] + m[1] + m[2]);
                if cost < least {
                    (least, best) = (cost, [*d0, *d1, *d2]);
                }
            }
        }
    }
    best
}

const CLASS_COST: f64 = 0.4;
const INTERVAL_COST: f64 = 2.0;

/// For each interval, mirror(a) times the idempotent of its axis (1 modulo `power`, 0 modulo the
/// other powers).
fn residues_of(base: Base, choice: &Digits, modulus: u64) -> Vec<u64> {
    let others = modulus / choice.power;
    let idempotent = others * inverse(others % choice.power, choice.power);
    (choice.from..=choice.to)
        .map(|a| {
            let residue = mirror(base.get(), choice.digits, a);
            (u128::from(residue) * u128::from(idempotent) % u128::from(modulus)) as u64
        })
        .collect()
}

/// The inverse of `a` modulo `m`, coprime: Euclid's algorithm. 0 for m = 1.
fn inverse(a: u64, m: u64) -> u64 {
    let (mut r, mut s) = ([i128::from(m), i128::from(a)], [0i128, 1]);
    while r[1] != 0 {
        let q = r[0] / r[1];
        r = [r[1], r[0] - q * r[1]];
        s = [s[1], s[0] - q * s[1]];
    }
    s[0].rem_euclid(i128::from(m)) as u64
}

/// a + b mod m, for a < m and b <= m.
#[inline]
fn add_mod(a: u64, b: u64, m: u64) -> u64 {
    let sum = a + b;
    if sum >= m { sum - m } else { sum }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn brute(net: &Net, b: &LatticeBox) -> Vec<(u64, LatticePos)> {
        (0..net.len()).map(|i| (i, net.position(i).unwrap())).filter(|(_, p)| b.contains(*p)).collect()
    }

    fn found(net: &Net, b: &LatticeBox) -> Vec<(u64, LatticePos)> {
        let mut out = vec![];
        net.sites_in(b, &mut out);
        let mut found: Vec<_> = out.iter().map(|s| (s.id.0, s.pos)).collect();
        found.sort_unstable();
        found
    }

    #[test]
    fn even_positions_are_exact_and_found() {
        for n in [1, 2, 7, 96, 1000] {
            for max in [1, 6, 1000, 3 << 20] {
                for shift in [0, 1 << 31, u32::MAX] {
                    let net = Net::new(
                        [NetAxis::Even, NetAxis::Fixed(0), NetAxis::Fixed(0)],
                        [max; 3],
                        0,
                        n,
                        shift,
                    );
                    let positions: Vec<u32> = (0..n).map(|i| net.position(i).unwrap()[0]).collect();
                    for (i, &p) in positions.iter().enumerate() {
                        assert_eq!(p, net.exact_even_position(i as u64, max), "{n} {max} {shift} {i}");
                        for q in [p.saturating_sub(1), p, p + 1] {
                            let first = positions.partition_point(|&x| x < q) as u64;
                            assert_eq!(net.first_even(q, max), first, "{n} {max} {shift} {q}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn ties_of_even_positions_round_up() {
        // (2i+1)/(2n)·max is half an integer at every third i: the fast path must hand over.
        let net = Net::new(
            [NetAxis::Even, NetAxis::Fixed(0), NetAxis::Fixed(0)],
            [1 << 10; 3],
            0,
            3 << 10,
            1 << 31,
        );
        for i in 0..net.len() {
            assert_eq!(u64::from(net.position(i).unwrap()[0]), (2 * i + 1 + 3) / 6);
        }
    }

    #[test]
    fn boxes_find_their_points() {
        let max = [1000, 777, 530];
        let halton = [Base::Two, Base::Three, Base::Five].map(NetAxis::Radical);
        let hammersley = [NetAxis::Even, NetAxis::Radical(Base::Two), NetAxis::Radical(Base::Three)];
        let face = [NetAxis::Radical(Base::Two), NetAxis::Fixed(777), NetAxis::Radical(Base::Three)];
        for (axes, first) in [(halton, 1), (hammersley, 0), (face, 1)] {
            for n in [1, 30, 5000] {
                let net = Net::new(axes, max, first, n, 1 << 31);
                for lo in [[0, 0, 0], [500, 333, 1], [999, 700, 100], [17, 389, 265]] {
                    for size in [1, 2, 40, 300, 1001] {
                        let b = LatticeBox { lo, hi: lo.map(|x| x + size) }
                            .intersect(&LatticeBox { lo: [0; 3], hi: max.map(|m| m + 1) });
                        assert_eq!(found(&net, &b), brute(&net, &b), "{n} {b:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn residues_by_the_chinese_remainder_theorem() {
        assert_eq!((inverse(3, 7), inverse(2, 9), inverse(0, 1)), (5, 5, 0));
        // The example of the module's head.
        let two = Digits { digits: 2, power: 4, from: 2, to: 2 };
        let three = Digits { digits: 1, power: 3, from: 1, to: 1 };
        let r = (residues_of(Base::Two, &two, 12)[0] + residues_of(Base::Three, &three, 12)[0]) % 12;
        assert_eq!(r, 1);
    }
}
