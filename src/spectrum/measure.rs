//! Sums over tetrahedra.

use super::design::Design;
use super::{Knot, Spectrum};
use crate::mesh::tet::Tet;

/// Tetrahedra with the values and places of their corners.
#[derive(Clone, Copy, Debug)]
pub struct Cells<'a> {
    /// Corner values; NaN is void.
    pub values: &'a [f32],
    /// Corner positions in the world, up to a shift.
    pub places: &'a [[f64; 3]],
    /// Tetrahedra, as numbers of corners.
    pub tets: &'a [Tet],
}

/// What some tetrahedra contribute to a spectrum.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChunkPart {
    tetrahedra: u64,
    /// At each knot, of the tetrahedra that it cuts: area, volume inside, gradient times area.
    cut: Vec<[f64; 3]>,
    /// Volume of tetrahedra whose least value has so many knots at or below it.
    whole: Vec<f64>,
    /// Minima less maxima among the values that have so many knots at or below them.
    ends: Vec<i64>,
    /// For a corner value that has so many levels at or below it: how often it is a minimum, less how often a maximum.
    level_ends: Vec<(u32, i32)>,
}

impl ChunkPart {
    /// Measures tetrahedra. Time: some nanoseconds for each, and for each knot in its range.
    pub fn of(design: &Design, cells: &Cells<'_>) -> Self {
        let knots = design.knots.len();
        let mut part = Self {
            cut: vec![[0.0; 3]; knots],
            whole: vec![0.0; knots + 1],
            ends: vec![0; knots + 1],
            ..Self::default()
        };
        let places: Vec<u32> = cells.values.iter().map(|&v| design.place(v)).collect();
        let knots: Vec<f64> = design.knots.iter().map(|&k| f64::from(k)).collect();
        let mut balance = vec![0i32; cells.values.len()];
        for tet in cells.tets {
            let values = tet.map(|v| cells.values[v as usize]);
            if values.iter().any(|v| v.is_nan()) {
                continue;
            }
            part.tetrahedra += 1;
            let corners = sorted([0, 1, 2, 3].map(|i| (values[i], tet[i])));
            balance[corners[0].1 as usize] += 1;
            balance[corners[3].1 as usize] -= 1;
            let [a, b, c, d] = corners.map(|(_, v)| cells.places[v as usize]);
            let edges = [minus(b, a), minus(c, a), minus(d, a)];
            part.add(
                &knots,
                corners.map(|(_, v)| places[v as usize]),
                corners.map(|(f, _)| f64::from(f)),
                edges,
            );
        }
        for (v, &n) in balance.iter().enumerate().filter(|(_, n)| **n != 0) {
            part.ends[places[v] as usize] += i64::from(n);
            part.level_ends.push((design.levels.place(cells.values[v]), n));
        }
        part
    }

    /// Adds a tetrahedron: its corners by ascending value, their places among the knots, the edges from the first.
    #[inline]
    fn add(&mut self, knots: &[f64], places: [u32; 4], f: [f64; 4], [e1, e2, e3]: [[f64; 3]; 3]) {
        let n1 = cross(e2, e3);
        let six = (e1[0] * n1[0] + e1[1] * n1[1] + e1[2] * n1[2]).abs();
        let volume = six / 6.0;
        let [p0, p1, p2, p3] = places.map(|p| p as usize);
        self.whole[p0] += volume;
        if p0 == p3 {
            return;
        }
        // Six times the volume times the gradient.
        let (n2, n3) = (cross(e3, e1), cross(e1, e2));
        let [d1, d2, d3] = [f[1] - f[0], f[2] - f[0], f[3] - f[0]];
        let g = [0, 1, 2].map(|k| d1 * n1[k] + d2 * n2[k] + d3 * n3[k]);
        let length = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]).sqrt();
        let (area, slope) = (length / 6.0, if six > 0.0 { length / six } else { 0.0 });
        let mut put = |k: usize, density: f64, below: f64| {
            let a = area * density;
            let sums = &mut self.cut[k];
            *sums = [sums[0] + a, sums[1] + volume * (1.0 - below), sums[2] + slope * a];
        };
        // The piece that ends in a knot holds it, as min < v <= max holds the maximum: so no piece is empty, and no
        // denominator zero.
        let r = 1.0 / (d1 * d2 * d3);
        for (k, v) in (p0..p1).map(|k| (k, knots[k])) {
            let t = v - f[0];
            put(k, 3.0 * t * t * r, t * t * t * r);
        }
        let (d12, d13) = (f[2] - f[1], f[3] - f[1]);
        for (k, v) in (p1..p2).map(|k| (k, knots[k])) {
            // How far along the four edges that are cut.
            let [t02, t03] = [(v - f[0]) / d2, (v - f[0]) / d3];
            let [t12, t13] = [(v - f[1]) / d12, (v - f[1]) / d13];
            let density = 3.0 / d3 * (t02 * (1.0 - t12) + (1.0 - t13) * t12);
            // The wedge below, as three tetrahedra.
            let below = t12 * t13 + t12 * t03 * (1.0 - t13) + t02 * t03 * (1.0 - t12);
            put(k, density, below);
        }
        let q = 1.0 / (d3 * d13 * (f[3] - f[2]));
        for (k, v) in (p2..p3).map(|k| (k, knots[k])) {
            let s = f[3] - v;
            put(k, 3.0 * s * s * q, 1.0 - s * s * s * q);
        }
    }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// By value, five comparisons.
#[inline]
fn sorted(mut c: [(f32, u32); 4]) -> [(f32, u32); 4] {
    for (i, j) in [(0, 1), (2, 3), (0, 2), (1, 3), (1, 2)] {
        let (a, b) = (c[i], c[j]);
        let turn = b.0 < a.0;
        (c[i], c[j]) = if turn { (b, a) } else { (a, b) };
    }
    c
}

/// Adds up the parts of all chunks.
#[derive(Clone, Debug)]
pub struct SpectrumBuilder {
    design: Design,
    sum: ChunkPart,
    /// Minima less maxima that have so many levels at or below them.
    pub(super) level_ends: Vec<i64>,
}

impl SpectrumBuilder {
    /// Nothing yet. Memory: 8 bytes a level, that is at most 8 MiB.
    pub fn new(design: Design) -> Self {
        let (knots, levels) = (design.knots.len(), design.levels.count as usize);
        let sum = ChunkPart {
            cut: vec![[0.0; 3]; knots],
            whole: vec![0.0; knots + 1],
            ends: vec![0; knots + 1],
            ..ChunkPart::default()
        };
        Self { design, sum, level_ends: vec![0; levels + 1] }
    }

    /// What is measured.
    pub fn design(&self) -> &Design {
        &self.design
    }

    /// Adds the part of the next chunk. `f64` sums depend on the order of the chunks, in their last bits.
    pub fn add(&mut self, part: &ChunkPart) {
        self.sum.tetrahedra += part.tetrahedra;
        for (sum, new) in self.sum.cut.iter_mut().zip(&part.cut) {
            (0..3).for_each(|i| sum[i] += new[i]);
        }
        self.sum.whole.iter_mut().zip(&part.whole).for_each(|(a, b)| *a += b);
        self.sum.ends.iter_mut().zip(&part.ends).for_each(|(a, b)| *a += b);
        part.level_ends.iter().for_each(|&(place, n)| self.level_ends[place as usize] += i64::from(n));
    }

    /// The spectrum of all chunks.
    pub fn spectrum(&self) -> Spectrum {
        let n = self.design.knots.len();
        let mut knots = vec![Knot::default(); n];
        let mut active = 0;
        for (k, knot) in knots.iter_mut().enumerate() {
            active += self.sum.ends[k];
            let [area, volume, gradient] = self.sum.cut[k];
            let active = u64::try_from(active).expect("a tetrahedron's minimum is not above its maximum");
            *knot =
                Knot { isovalue: self.design.knots[k], active_tetrahedra: active, area, volume, gradient };
        }
        // Tetrahedra that lie inside as a whole: those whose least value is at or above the knot.
        let mut whole = 0.0;
        for k in (0..n).rev() {
            whole += self.sum.whole[k + 1];
            knots[k].volume += whole;
        }
        Spectrum {
            range: self.design.range,
            tetrahedra: self.sum.tetrahedra,
            volume: whole + self.sum.whole[0],
            knots,
            levels: self.design.levels,
        }
    }
}
