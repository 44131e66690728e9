//! Sums over the tetrahedra of a chunk, at some steps.
//!
//! **How it is fast.** A step of a series is measured anew though its mesh is not made anew, so
//! this is most of what a step costs. What does not depend on values is computed once for all
//! steps. The values of a tetrahedron, their gradient, and all quotients are computed eight at a
//! time, in vectors. A vector has one tetrahedron at up to eight steps that are measured together,
//! with what is known of a vertex in one cache line. At a step that is alone, it has
//! eight tetrahedra. Then, tetrahedron by tetrahedron, come the knots in its range, eight by eight
//! ([`super::tetra`], [`super::sums`]). The amount of data read bounds that part. So the places of
//! the knots are found along with the quotients, and the volume is read once for all steps.
//!
//! Each number of a step is made by the same operations, with anything else in the vector: so it
//! does not show with which steps it was measured.

use super::design::Limits;
use super::lanes::{Alone, LANES, LaneBuffers, Lanes, Together, ends_of};
use super::part::{ChunkPart, Vertices};
use super::tetra::{BATCH, Ladder, PiecesOf, Shapes};
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::simd::{Avx2, Avx512, F64s, F64x4s, F64xN, Plain, four, with_avx512, with_vectors};
#[cfg(target_arch = "x86_64")]
use isospan_mesh::simd::{F64x4, F64x8, Pair};

/// The vectors that are used.
#[derive(Clone, Copy)]
pub(super) enum Vectors {
    Plain,
    Avx2(Avx2),
    Avx512(Avx512),
}

impl Vectors {
    fn found() -> Self {
        match (Avx512::found(), Avx2::found()) {
            (Some(token), _) => Self::Avx512(token),
            (None, Some(token)) => Self::Avx2(token),
            (None, None) => Self::Plain,
        }
    }
}

impl ChunkPart {
    /// Measures tetrahedra at some steps: a part for each. `places` are those of the vertices in
    /// the world, up to a shift common to all, and a 0. A function of the order and of the turns of
    /// the tetrahedra too, in the last bits. Time: some nanoseconds for each tetrahedron and step,
    /// and for each eight knots in its range.
    pub fn of_steps(
        limits: Limits,
        places: &[[f64; 4]],
        tets: &[Tet],
        steps: &[Vertices<'_>],
        memory: &mut LaneBuffers,
    ) -> Vec<Self> {
        Self::of_with(limits, places, tets, steps, Vectors::found(), memory)
    }

    /// With these vectors: the same bits.
    pub(super) fn of_with(
        limits: Limits,
        places: &[[f64; 4]],
        tets: &[Tet],
        steps: &[Vertices<'_>],
        vectors: Vectors,
        memory: &mut LaneBuffers,
    ) -> Vec<Self> {
        let mut lanes = Lanes::all(limits, steps, memory);
        let cells = ChunkCells { places, tets };
        match vectors {
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx512(token) => with_avx512(
                token,
                #[inline(always)]
                || cells.add_all::<F64x4, F64x8, F64x8>(token.avx2(), token, token, &mut lanes),
            ),
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx2(token) => with_vectors(
                #[inline(always)]
                || cells.add_all::<F64x4, Pair<F64x4>, F64x4>(token, token, token, &mut lanes),
            ),
            _ => cells.add_all::<Plain<f64, 4>, Plain<f64, 8>, Plain<f64, 4>>((), (), (), &mut lanes),
        }
        lanes.into_iter().flat_map(|steps| steps.finish(tets.len() as u64, memory)).collect()
    }
}

/// The tetrahedra of a chunk.
struct ChunkCells<'a> {
    places: &'a [[f64; 4]],
    tets: &'a [Tet],
}

impl ChunkCells<'_> {
    /// Adds all tetrahedra to the sums: those of all steps for some, then for the next ones.
    #[inline(always)]
    fn add_all<W: F64x4s, S: F64xN<8>, K: F64s>(
        &self,
        four: W::Token,
        eight: S::Token,
        knots: K::Token,
        lanes: &mut [Lanes],
    ) {
        let (mut shapes, mut pieces_of) =
            (Box::<Shapes>::default(), Box::new(PieceBuffers([PiecesOf::NONE; AT_HAND])));
        for from in (0..self.tets.len()).step_by(BATCH) {
            let tets = &self.tets[from..self.tets.len().min(from + BATCH)];
            let next = self.tets.get(from + AHEAD..).unwrap_or_default();
            shapes.look::<W>(four, self.places, tets);
            for steps in &mut *lanes {
                match steps {
                    Lanes::One(steps) => pieces_of.measure_one::<S, K>(eight, knots, &shapes, steps, tets),
                    Lanes::Eight(steps) => {
                        pieces_of.measure::<S, K>(eight, knots, &shapes, steps, tets, next)
                    }
                }
            }
        }
    }
}

/// The sums are made this many tetrahedra later: what was just written cannot be read piece by
/// piece at once, and the processor has two things to do.
const LATER: usize = 2;

/// The vertices of a tetrahedron are prefetched this many tetrahedra before it is looked at.
const AHEAD: usize = 16;

/// What is known of some tetrahedra; of one at some steps, or of eight at one.
struct PieceBuffers([PiecesOf; AT_HAND]);

const AT_HAND: usize = BATCH / 8;
const _: () = assert!(AT_HAND > LATER);

impl PieceBuffers {
    /// Tetrahedra at some steps; `next` are those that lie [`AHEAD`] of each.
    #[inline(always)]
    fn measure<S: F64xN<8>, K: F64s>(
        &mut self,
        token: S::Token,
        knots: K::Token,
        shapes: &Shapes,
        steps: &mut Together,
        tets: &[Tet],
        next: &[Tet],
    ) {
        let ladder = Ladder::<S>::new(token, steps.designs.each_ref().map(Option::as_ref));
        for i in 0..tets.len() + LATER {
            if let Some(tet) = tets.get(i) {
                if let Some(next) = next.get(i) {
                    steps.will_look_at(next);
                }
                let pieces = &mut self.0[i % AT_HAND];
                let floats = four(
                    #[inline(always)]
                    |k| steps.vertices[tet[k] as usize].values,
                );
                let values = four(
                    #[inline(always)]
                    |k| S::from_f32(token, &floats[k]),
                );
                let void = voids(values);
                let mut ends = ends_of(&floats);
                if void != 0 {
                    for lane in (0..LANES).filter(|lane| void >> lane & 1 != 0) {
                        steps.void[lane] += 1;
                        ends.iter_mut().for_each(|ends| ends[lane] = 0);
                    }
                }
                for (&v, ends) in tet.iter().zip(&ends) {
                    steps.vertices[v as usize].ends.iter_mut().zip(ends).for_each(|(to, end)| *to += end);
                }
                shapes.one::<S>(token, i).pieces(token, &ladder, values, void, pieces);
            }
            // All steps of one, then of the next: so a sum need not wait for what was added to it
            // just before.
            if i >= LATER {
                let pieces = &self.0[(i - LATER) % AT_HAND];
                let (volume, [a, b, c, d, e, f, g, h]) = (pieces.volume[0], &mut *steps.sums);
                // Without a loop: so where each lies is known beforehand.
                a.add::<K>(knots, pieces, 0, volume);
                b.add::<K>(knots, pieces, 1, volume);
                c.add::<K>(knots, pieces, 2, volume);
                d.add::<K>(knots, pieces, 3, volume);
                e.add::<K>(knots, pieces, 4, volume);
                f.add::<K>(knots, pieces, 5, volume);
                g.add::<K>(knots, pieces, 6, volume);
                h.add::<K>(knots, pieces, 7, volume);
            }
        }
    }

    /// Tetrahedra at one step: eight by eight.
    #[inline(always)]
    fn measure_one<S: F64xN<8>, K: F64s>(
        &mut self,
        token: S::Token,
        knots: K::Token,
        shapes: &Shapes,
        steps: &mut Alone,
        tets: &[Tet],
    ) {
        let Some(design) = &steps.design else { return };
        let ladder = Ladder::<S>::new(token, [Some(design); 8]);
        for (n, (tets, pieces)) in tets.chunks(8).zip(&mut self.0).enumerate() {
            // With fewer than eight, the last one is repeated.
            let corner = |k: usize, i: usize| tets[i.min(tets.len() - 1)][k] as usize;
            let floats: [[f32; 8]; 4] =
                [0, 1, 2, 3].map(|k| std::array::from_fn(|i| steps.values[corner(k, i)]));
            let values = four(
                #[inline(always)]
                |k| S::from_f32(token, &floats[k]),
            );
            let void = voids(values);
            let ends = ends_of(&floats);
            for (i, tet) in tets.iter().enumerate() {
                if void >> i & 1 == 0 {
                    (0..4).for_each(|k| steps.ends[tet[k] as usize] += ends[k][i]);
                } else {
                    steps.void += 1;
                }
            }
            shapes.eight::<S>(token, n).pieces(token, &ladder, values, void, pieces);
        }
        for (tets, pieces) in tets.chunks(8).zip(&self.0) {
            for lane in 0..tets.len() {
                steps.sums.add::<K>(knots, pieces, lane % 8, pieces.volume[lane % 8]);
            }
        }
    }
}

/// Tetrahedra with a value that is NaN, bit by bit.
#[inline(always)]
fn voids<S: F64xN<8>>([a, b, c, d]: [S; 4]) -> u32 {
    !S::bitmask((a + b + (c + d)).is_number()) & 0xff
}
