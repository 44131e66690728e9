//! Sums over the tetrahedra of a chunk, at some steps.
//!
//! **How it is fast.** A step of a series is measured anew though its mesh is not made anew, so this is most of what a step costs. What of a tetrahedron
//! does not depend on values is found out once for all steps. Its values, their gradient, and all quotients are computed eight at a time, in vectors: of one
//! tetrahedron at up to eight steps that are measured together, what is known of a vertex lying side by side in a cache line; or of eight tetrahedra at a
//! step that is alone. Then, tetrahedron by tetrahedron, the knots in its range, eight by eight ([`super::tetra`], [`super::sums`]).
//!
//! Each number of a step is made by the same operations, whatever else is in the vector: so it does not show with which steps it was measured.

use super::design::{Design, Limits};
use super::side::{Alone, Knots, OfStep, Room as Memory, SIDE_BY_SIDE, Side, Together, ends_of, span_of};
use super::sums::VOID;
use super::tetra::{BATCH, PiecesOf, Shapes};
#[cfg(target_arch = "x86_64")]
use crate::exec::lanes::{Eight, Vector};
use crate::exec::lanes::{Floats, Four, Pair, Plain, Wide, four};
use crate::exec::{Avx2, Avx512, with_avx512, with_vectors};
use crate::mesh::tet::Tet;

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

/// The values of a chunk's vertices at a step.
#[derive(Clone, Copy, Debug)]
pub struct Vertices<'a> {
    /// NaN is void.
    pub values: &'a [f32],
    /// Least and largest value of the tetrahedra that are not void; the first above the second where all are.
    pub range: [f32; 2],
}

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
            (Some(proof), _) => Self::Avx512(proof),
            (None, Some(proof)) => Self::Avx2(proof),
            (None, None) => Self::Plain,
        }
    }
}

impl ChunkPart {
    /// Measures tetrahedra at some steps: a part for each. `places` are those of the vertices in the world, up to a shift common to all, and a 0. A function of
    /// the order and of the turns of the tetrahedra too, in the last bits. Time: some nanoseconds for each tetrahedron and step, and for each eight knots in its range.
    pub fn of_steps(
        limits: Limits,
        places: &[[f64; 4]],
        tets: &[Tet],
        steps: &[Vertices<'_>],
        memory: &mut Memory,
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
        memory: &mut Memory,
    ) -> Vec<Self> {
        let mut sides: Vec<Side> =
            steps.chunks(SIDE_BY_SIDE).map(|steps| Side::new(limits, steps, memory)).collect();
        let cells = Cells { places, tets };
        match vectors {
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx512(proof) => with_avx512(
                proof,
                #[inline(always)]
                || cells.add_all::<Vector, Eight, Eight>(proof.avx2(), proof, proof, &mut sides),
            ),
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx2(proof) => with_vectors(
                #[inline(always)]
                || cells.add_all::<Vector, Pair<Vector>, Vector>(proof, proof, proof, &mut sides),
            ),
            _ => cells.add_all::<Plain, Pair<Plain>, Plain>((), (), (), &mut sides),
        }
        sides.into_iter().flat_map(|side| side.finish(memory)).collect()
    }
}

/// The tetrahedra of a chunk.
struct Cells<'a> {
    places: &'a [[f64; 4]],
    tets: &'a [Tet],
}

impl Cells<'_> {
    /// Adds all tetrahedra to the sums: those of all steps for some, then for the next ones.
    #[inline(always)]
    fn add_all<W: Four, S: Floats<8>, K: Wide>(
        &self,
        four: W::Proof,
        eight: S::Proof,
        knots: K::Proof,
        sides: &mut [Side],
    ) {
        let (mut shapes, mut fours, mut eights) =
            (Box::<Shapes>::default(), Room::<4>::new(), Room::<8>::new());
        for from in (0..self.tets.len()).step_by(BATCH) {
            let (tets, next) = self.tets[from..].split_at(BATCH.min(self.tets.len() - from));
            let next = &next[..BATCH.min(next.len())];
            shapes.look::<W>(four, self.places, tets);
            for side in &mut *sides {
                match side {
                    Side::One(side) => {
                        eights.gather_one::<S>(eight, &shapes, side, tets);
                        eights.add::<K>(knots, tets.len(), &mut side.sums[0], |i| (i / 8, i % 8));
                    }
                    Side::Four(side) => fours.measure::<W, K>((four, knots), &shapes, side, tets, next),
                    Side::Eight(side) => eights.measure::<S, K>((eight, knots), &shapes, side, tets, next),
                }
            }
        }
    }
}

/// What is known of some tetrahedra.
struct Room<const N: usize> {
    pieces: [PiecesOf<N>; BATCH],
    spans: [[Knots; 2]; BATCH],
}

impl<const N: usize> Room<N> {
    fn new() -> Box<Self> {
        Box::new(Self { pieces: [[[0.0; N]; 12]; BATCH], spans: [[[VOID; SIDE_BY_SIDE]; 2]; BATCH] })
    }

    /// Tetrahedra at some steps.
    #[inline(always)]
    fn measure<S: Floats<N>, K: Wide>(
        &mut self,
        (proof, knots): (S::Proof, K::Proof),
        shapes: &Shapes,
        side: &mut Together<N>,
        tets: &[Tet],
        next: &[Tet],
    ) {
        side.will_look_at(next);
        self.gather::<S>(proof, shapes, side, tets);
        // All steps of one, then of the next: so a sum need not wait for what was added to it just before.
        for (pieces, [lo, hi]) in self.pieces.iter().zip(&self.spans).take(tets.len()) {
            for (lane, sums) in side.sums.iter_mut().enumerate().take(N) {
                if let Some((_, sums)) = &mut sums.0 {
                    sums.add::<K, N>(knots, [lo[lane], hi[lane]], pieces, lane);
                }
            }
        }
    }

    #[inline(always)]
    fn gather<S: Floats<N>>(
        &mut self,
        proof: S::Proof,
        shapes: &Shapes,
        side: &mut Together<N>,
        tets: &[Tet],
    ) {
        let rooms = self.pieces.iter_mut().zip(&mut self.spans);
        for (i, (tet, (pieces, span))) in tets.iter().zip(rooms).enumerate() {
            let values = four(
                #[inline(always)]
                |k| side.vertices[tet[k] as usize].values,
            );
            *span = span_of(four(
                #[inline(always)]
                |k| side.knots[tet[k] as usize],
            ));
            for (&v, ends) in tet.iter().zip(&ends_of(&values)) {
                side.vertices[v as usize].ends.iter_mut().zip(ends).for_each(|(to, end)| *to += end);
            }
            let values = four(
                #[inline(always)]
                |k| S::of_floats(proof, &values[k]),
            );
            shapes.one::<S>(proof, i).pieces(proof, values, pieces);
        }
    }

    /// Adds the first tetrahedra to the sums of a step; `at` tells where each is, and in which lane.
    #[inline(always)]
    fn add<K: Wide>(
        &self,
        proof: K::Proof,
        count: usize,
        sums: &mut OfStep,
        at: impl Fn(usize) -> (usize, usize),
    ) {
        let Some((_, sums)) = &mut sums.0 else { return };
        for i in 0..count.min(BATCH) {
            let (n, lane) = at(i);
            let [lo, hi] = &self.spans[n];
            sums.add::<K, N>(proof, [lo[lane], hi[lane]], &self.pieces[n], lane);
        }
    }
}

impl Room<8> {
    /// Tetrahedra at one step: eight by eight.
    #[inline(always)]
    fn gather_one<S: Floats<8>>(&mut self, proof: S::Proof, shapes: &Shapes, side: &mut Alone, tets: &[Tet]) {
        let rooms = self.pieces.iter_mut().zip(&mut self.spans);
        for (n, (tets, (pieces, span))) in tets.chunks(8).zip(rooms).enumerate() {
            // Of less than eight, the last one again.
            let corner = |k: usize, i: usize| tets[i.min(tets.len() - 1)][k] as usize;
            let values = [0, 1, 2, 3].map(|k| std::array::from_fn(|i| side.values[corner(k, i)]));
            let knots = [0, 1, 2, 3].map(|k| std::array::from_fn(|i| side.knots[corner(k, i)]));
            *span = span_of(knots);
            let ends = ends_of(&values);
            for (i, tet) in tets.iter().enumerate() {
                (0..4).for_each(|k| side.ends[tet[k] as usize] += ends[k][i]);
            }
            let values = four(
                #[inline(always)]
                |k| S::of_floats(proof, &values[k]),
            );
            shapes.eight::<S>(proof, n).pieces(proof, values, pieces);
        }
    }
}
