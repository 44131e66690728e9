//! Sums over the tetrahedra of a chunk, and over chunks.
//!
//! **How it is fast.** A step of a series is measured anew though its mesh is not made anew, so this is most of what a step costs.
//! Tetrahedra are taken a batch at a time, column by column: edges, values, volume and gradient of all, then the values of each sorted by
//! exchanges, and all divisions, in loops without branches that the compiler turns into vector code. Then, tetrahedron by tetrahedron, the
//! knots in its range, four by four: of the three parabolas all are computed, and the one that holds is chosen. Fours begin at the same knots for all tetrahedra,
//! and those out of a range get 0: so a sum is read as it was written, and the processor need not wait for the one before to leave its queue.

use super::design::{Design, Limits};
use super::grid::Places;
use super::{Knot, Spectrum};
#[cfg(target_arch = "x86_64")]
use crate::exec::Vector;
use crate::exec::{Avx2, Plain, Wide, with_vectors};
use crate::mesh::tet::Tet;

/// A corner of tetrahedra.
#[derive(Clone, Copy, Debug, Default)]
pub struct Corner {
    at: [f64; 3],
    value: f32,
    /// How many knots, how many levels are at or below its value.
    knot: u16,
    level: u16,
}

impl Corner {
    /// A value at a place in the world, up to a shift common to all; NaN is void.
    pub fn new(value: f32, at: [f64; 3]) -> Self {
        Self { at, value, ..Self::default() }
    }
}

/// What the tetrahedra of a chunk contribute to a spectrum: the spectrum of the chunk.
#[derive(Clone, Debug, PartialEq)]
pub struct ChunkPart {
    pub(super) tetrahedra: u64,
    pub(super) volume: f64,
    /// `None` if every tetrahedron is void.
    pub(super) measured: Option<Measured>,
}

/// The spectrum of tetrahedra that are not void.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Measured {
    pub(super) design: Design,
    /// At each knot: active tetrahedra; area, volume inside, gradient times area.
    pub(super) active: Vec<u64>,
    pub(super) sums: Vec<[f64; 3]>,
    /// Active tetrahedra at each level.
    pub(super) levels: Vec<u64>,
}

impl ChunkPart {
    /// Measures tetrahedra whose values, void ones left out, have this range (the first above the second: all are void). A function of
    /// the order and of the turns of the tetrahedra too, in the last bits. Time: some nanoseconds for each tetrahedron, and for each knot in its range.
    pub fn of(limits: Limits, range: [f32; 2], corners: Vec<Corner>, tets: &[Tet]) -> Self {
        Self::of_with(limits, range, corners, tets, Avx2::found())
    }

    /// With vectors of AVX2, or without: the same bits.
    pub(super) fn of_with(
        limits: Limits,
        range: [f32; 2],
        mut corners: Vec<Corner>,
        tets: &[Tet],
        avx2: Option<Avx2>,
    ) -> Self {
        if range[0] > range[1] {
            return Self { tetrahedra: 0, volume: 0.0, measured: None };
        }
        // Of two zeros either may be the least; only one is written.
        let design = Design::new(range.map(|v| v + 0.0), limits);
        let (knots, levels) = (Places::new(&design.knots), Places::new(&design.levels));
        for c in corners.iter_mut().filter(|c| !c.value.is_nan()) {
            (c.knot, c.level) = (knots.of(c.value) as u16, levels.of(c.value) as u16);
        }
        let mut sums = Sums::new(&design);
        #[cfg(target_arch = "x86_64")]
        if let Some(proof) = avx2 {
            with_vectors(
                #[inline(always)]
                || sums.add_all::<Vector>(proof, &corners, tets),
            );
            return sums.finish(design);
        }
        let _ = avx2;
        sums.add_all::<Plain>((), &corners, tets);
        sums.finish(design)
    }
}

/// Tetrahedra that are looked at together.
const BATCH: usize = 64;
/// Knots that are looked at side by side: their number is rounded up to a multiple.
const LANES: usize = 4;

type Column = [f64; BATCH];

/// Tetrahedra, column by column.
struct Batch {
    len: usize,
    /// Edges from one corner to the others.
    edges: [[Column; 3]; 3],
    /// Corner values, sorted later.
    values: [Column; 4],
    /// One over the differences of sorted values: 1 - 0, 2 - 0, 3 - 0, 2 - 1, 3 - 1, 3 - 2.
    inverse: [Column; 6],
    /// How many knots are at or below the least value, and the largest.
    knots: [[u16; 2]; BATCH],
    volume: Column,
    /// The gradient's length, and that times the volume.
    slope: Column,
    area: Column,
}

/// Sums while they are made.
struct Sums {
    isovalues: Vec<[f64; LANES]>,
    tetrahedra: u64,
    /// At each knot, of the tetrahedra that it cuts.
    cut: Vec<Cut>,
    /// Volume of tetrahedra whose least value has so many knots at or below it.
    whole: Vec<f64>,
    /// Minima less maxima that have so many knots, so many levels at or below them.
    ends: Vec<i64>,
    level_ends: Vec<i64>,
    batch: Box<Batch>,
}

impl Sums {
    fn new(design: &Design) -> Self {
        let (knots, levels) = (design.knots.count as usize, design.levels.count as usize);
        let batch = [0.0; BATCH];
        Self {
            isovalues: side_by_side(&design.knots.values()),
            tetrahedra: 0,
            cut: vec![Cut::default(); knots.div_ceil(LANES)],
            whole: vec![0.0; knots + 1],
            ends: vec![0; knots + 1],
            level_ends: vec![0; levels + 1],
            batch: Box::new(Batch {
                len: 0,
                edges: [[batch; 3]; 3],
                values: [batch; 4],
                inverse: [batch; 6],
                knots: [[0; 2]; BATCH],
                volume: batch,
                slope: batch,
                area: batch,
            }),
        }
    }

    #[inline(always)]
    fn add_all<W: Wide>(&mut self, proof: W::Proof, corners: &[Corner], tets: &[Tet]) {
        for tets in tets.chunks(BATCH) {
            self.gather(corners, tets);
            self.batch.measure();
            self.spread::<W>(proof);
        }
    }

    /// Takes tetrahedra without a void corner into the batch.
    #[inline(always)]
    fn gather(&mut self, corners: &[Corner], tets: &[Tet]) {
        let batch = &mut *self.batch;
        batch.len = 0;
        for tet in tets {
            let [a, b, c, d] = tet.map(|v| &corners[v as usize]);
            if a.value.is_nan() | b.value.is_nan() | c.value.is_nan() | d.value.is_nan() {
                continue;
            }
            let i = batch.len % BATCH;
            batch.len = i + 1;
            for (edge, corner) in batch.edges.iter_mut().zip([b, c, d]) {
                for (k, column) in edge.iter_mut().enumerate() {
                    column[i] = corner.at[k] - a.at[k];
                }
            }
            for (column, corner) in batch.values.iter_mut().zip([a, b, c, d]) {
                column[i] = f64::from(corner.value);
            }
            let ends = |of: fn(&Corner) -> u16| {
                let [a, b, c, d] = [a, b, c, d].map(of);
                [a.min(b).min(c.min(d)), a.max(b).max(c.max(d))]
            };
            batch.knots[i] = ends(|c| c.knot);
            let [lo, hi] = ends(|c| c.level).map(usize::from);
            self.level_ends[lo] += 1;
            self.level_ends[hi] -= 1;
        }
        self.tetrahedra += batch.len as u64;
    }

    /// Adds the tetrahedra of the batch at the knots in their ranges.
    #[inline(always)]
    fn spread<W: Wide>(&mut self, proof: W::Proof) {
        let batch = &*self.batch;
        for i in 0..batch.len.min(BATCH) {
            let [lo, hi] = batch.knots[i].map(usize::from);
            let volume = batch.volume[i];
            self.whole[lo] += volume;
            self.ends[lo] += 1;
            self.ends[hi] -= 1;
            if lo == hi {
                continue;
            }
            let pieces = batch.pieces(i);
            let blocks = lo / LANES..hi.div_ceil(LANES);
            for (isovalues, cut) in self.isovalues[blocks.clone()].iter().zip(&mut self.cut[blocks]) {
                pieces.add::<W>(proof, isovalues, cut);
            }
        }
    }

    fn finish(self, design: Design) -> ChunkPart {
        let counts = |ends: &[i64]| {
            let mut active = 0;
            let count = |n: &i64| {
                active += n;
                u64::try_from(active).expect("a tetrahedron's minimum is not above its maximum")
            };
            // What is above all isovalues does not count for any.
            ends[..ends.len() - 1].iter().map(count).collect()
        };
        // Tetrahedra that lie inside as a whole: those whose least value is at or above the knot.
        let mut whole = 0.0;
        let at = |k: usize| {
            let cut = &self.cut[k / LANES];
            [cut.area[k % LANES], cut.inside[k % LANES], cut.slope[k % LANES]]
        };
        let mut sums: Vec<[f64; 3]> = (0..design.knots.count as usize).map(at).collect();
        for (sum, volume) in sums.iter_mut().zip(&self.whole[1..]).rev() {
            whole += volume;
            sum[1] += whole;
        }
        let measured =
            Measured { design, active: counts(&self.ends), sums, levels: counts(&self.level_ends) };
        ChunkPart { tetrahedra: self.tetrahedra, volume: whole + self.whole[0], measured: Some(measured) }
    }
}

impl Batch {
    /// Volume and gradient of each, and the values sorted.
    #[inline(always)]
    fn measure(&mut self) {
        let len = self.len.min(BATCH);
        for i in 0..len {
            let [e1, e2, e3] = [0, 1, 2].map(|e| [0, 1, 2].map(|k| self.edges[e][k][i]));
            let (n1, n2, n3) = (cross(e2, e3), cross(e3, e1), cross(e1, e2));
            let six = (e1[0] * n1[0] + e1[1] * n1[1] + e1[2] * n1[2]).abs();
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| self.values[k][i]);
            let [d1, d2, d3] = [b - a, c - a, d - a];
            // Six times the volume times the gradient.
            let g = [0, 1, 2].map(|k| d1 * n1[k] + d2 * n2[k] + d3 * n3[k]);
            let length = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]).sqrt();
            let slope = length / six;
            self.volume[i] = six / 6.0;
            self.area[i] = length / 6.0;
            self.slope[i] = if six > 0.0 { slope } else { 0.0 };
            let ((a, b), (c, d)) = (sorted(a, b), sorted(c, d));
            let ((a, c), (b, d)) = (sorted(a, c), sorted(b, d));
            let (b, c) = sorted(b, c);
            let differences = [b - a, c - a, d - a, c - b, d - b, d - c];
            for (k, f) in [a, b, c, d].into_iter().enumerate() {
                self.values[k][i] = f;
            }
            for (k, d) in differences.into_iter().enumerate() {
                self.inverse[k][i] = 1.0 / d;
            }
        }
    }

    #[inline(always)]
    fn pieces(&self, i: usize) -> Pieces {
        let f = [0, 1, 2, 3].map(|k| self.values[k][i]);
        let [d1, d2, d3, d12, d13, d23] = [0, 1, 2, 3, 4, 5].map(|k| self.inverse[k][i]);
        Pieces {
            f,
            d2,
            d3,
            d12,
            d13,
            first: d1 * d2 * d3,
            third: d3 * d13 * d23,
            volume: self.volume[i],
            area: self.area[i],
            slope: self.area[i] * self.slope[i],
        }
    }
}

/// Sums at some knots.
#[derive(Clone, Copy, Default)]
struct Cut {
    area: [f64; LANES],
    /// Volume inside.
    inside: [f64; LANES],
    /// Gradient times area.
    slope: [f64; LANES],
}

/// Isovalues by lanes; behind the last one, such as are in no range.
fn side_by_side(isovalues: &[f32]) -> Vec<[f64; LANES]> {
    let lanes = |part: &[f32]| [0, 1, 2, 3].map(|k| part.get(k).map_or(f64::INFINITY, |&v| f64::from(v)));
    isovalues.chunks(LANES).map(lanes).collect()
}

/// The three parabolas of a tetrahedron, and the cubics that are their integrals.
struct Pieces {
    f: [f64; 4],
    d2: f64,
    d3: f64,
    d12: f64,
    d13: f64,
    first: f64,
    third: f64,
    /// What the pieces are multiplied with.
    volume: f64,
    area: f64,
    slope: f64,
}

/// One exchange of a sorting network: a minimum and a maximum of the machine's.
#[inline(always)]
fn sorted(a: f64, b: f64) -> (f64, f64) {
    (if a < b { a } else { b }, if a < b { b } else { a })
}

impl Pieces {
    /// Adds what the tetrahedron has at some knots: at those in its range.
    #[inline(always)]
    fn add<W: Wide>(&self, proof: W::Proof, knots: &[f64; LANES], sums: &mut Cut) {
        let of = |x| W::splat(proof, x);
        let [f0, f1, f2, f3] = self.f.map(of);
        let (v, one, three) = (W::of(proof, knots), of(1.0), of(3.0));
        // A piece holds the knot that ends it, as min < v <= max holds the maximum: so no piece with a knot is empty, and its
        // denominators are not zero. The others give anything, and are not taken.
        // Below f1: a corner is outside.
        let t = v.minus(f0);
        let first = t.times(t).times(of(self.first));
        // How far along the four edges that are cut; the wedge below is three tetrahedra.
        let u = v.minus(f1);
        let [d2, d3, d12, d13] = [self.d2, self.d3, self.d12, self.d13].map(of);
        let [t02, t12, t13] = [t.times(d2), u.times(d12), u.times(d13)];
        let cut = t02.times(one.minus(t12)).plus(one.minus(t13).times(t12));
        let wedge = t12.times(t13).plus(t.times(d3).times(cut));
        // Above f2: a corner is inside.
        let s = f3.minus(v);
        let third = s.times(s).times(of(self.third));
        let (low, high) = (v.up_to(f1), f2.below(v));
        let lower = low.pick(three.times(first), three.times(d3).times(cut));
        let density = high.pick(three.times(third), lower);
        let above = high.pick(s.times(third), one.minus(low.pick(t.times(first), wedge)));
        // A mask and a number: the number, or 0.
        let within = f0.below(v).and(v.up_to(f3));
        let (density, above) = (within.and(density), within.and(above));
        sums.area = W::of(proof, &sums.area).plus(of(self.area).times(density)).lanes();
        sums.inside = W::of(proof, &sums.inside).plus(of(self.volume).times(above)).lanes();
        sums.slope = W::of(proof, &sums.slope).plus(of(self.slope).times(density)).lanes();
    }
}

#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Adds up the parts of all chunks.
#[derive(Clone, Debug)]
pub struct SpectrumBuilder {
    design: Design,
    tetrahedra: u64,
    volume: f64,
    active: Vec<u64>,
    sums: Vec<[f64; 3]>,
    /// Active tetrahedra at each level.
    pub(super) levels: Vec<u64>,
}

impl SpectrumBuilder {
    /// Nothing yet.
    pub fn new(design: Design) -> Self {
        let (knots, levels) = (design.knots.count as usize, design.levels.count as usize);
        Self {
            design,
            tetrahedra: 0,
            volume: 0.0,
            active: vec![0; knots],
            sums: vec![[0.0; 3]; knots],
            levels: vec![0; levels],
        }
    }

    /// What is measured.
    pub fn design(&self) -> &Design {
        &self.design
    }

    /// Adds the part of the next chunk, whose range is in that of the design, which has the same limits. `f64` sums depend on the order
    /// of the chunks, in their last bits.
    pub fn add(&mut self, part: &ChunkPart) {
        let Some(measured) = &part.measured else { return };
        self.tetrahedra += part.tetrahedra;
        self.volume += part.volume;
        let (all, of) = (&self.design, &measured.design);
        for (k, sum) in (0..).zip(&mut self.sums) {
            if let Some(here) = of.knots.number_of(&all.knots, k) {
                self.active[k as usize] += measured.active[here as usize];
                (0..3).for_each(|i| sum[i] += measured.sums[here as usize][i]);
            } else if all.knots.value(k) <= of.range[0] {
                sum[1] += part.volume;
            }
        }
        for (n, level) in (0..).zip(&mut self.levels) {
            *level += of.levels.number_of(&all.levels, n).map_or(0, |here| measured.levels[here as usize]);
        }
    }

    /// The spectrum of all chunks.
    pub fn spectrum(&self) -> Spectrum {
        let knots = self.design.knots.values().into_iter().zip(&self.active).zip(&self.sums).map(
            |((isovalue, &active_tetrahedra), &[area, volume, gradient])| Knot {
                isovalue,
                active_tetrahedra,
                area,
                volume,
                gradient,
            },
        );
        Spectrum {
            range: self.design.range,
            tetrahedra: self.tetrahedra,
            volume: self.volume,
            knots: knots.collect(),
            levels: self.design.levels,
        }
    }
}
