//! Sums over the tetrahedra of a chunk, at some steps.
//!
//! **How it is fast.** A step of a series is measured anew though its mesh is not made anew, so this is most of what a step costs. What of a tetrahedron
//! does not depend on values is found out once for all steps. Its values, their gradient, and all quotients are computed four at a time, in vectors: of one
//! tetrahedron at four steps that are measured together, the values of a vertex lying side by side; or of four tetrahedra at a step that is
//! alone. Then, tetrahedron by tetrahedron, the knots in its range, eight by eight ([`super::tetra`], [`super::sums`]).
//!
//! Each number of a step is made by the same operations, whatever else is in the vector: so it does not show with which steps it was measured.

use super::design::{Design, Limits};
use super::grid::Places;
use super::sums::{Span, Sums, VOID};
use super::tetra::{BATCH, PiecesOfFour, Shapes};
#[cfg(target_arch = "x86_64")]
use crate::exec::lanes::{Eight, Vector};
use crate::exec::lanes::{Four, Plain, Wide, four};
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
    pub fn of_steps(limits: Limits, places: &[[f64; 4]], tets: &[Tet], steps: &[Vertices<'_>]) -> Vec<Self> {
        Self::of_with(limits, places, tets, steps, Vectors::found())
    }

    /// With these vectors: the same bits.
    pub(super) fn of_with(
        limits: Limits,
        places: &[[f64; 4]],
        tets: &[Tet],
        steps: &[Vertices<'_>],
        vectors: Vectors,
    ) -> Vec<Self> {
        let mut sides: Vec<Side> = steps.chunks(4).map(|steps| Side::new(limits, steps)).collect();
        let cells = Cells { places, tets };
        match vectors {
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx512(proof) => with_avx512(
                proof,
                #[inline(always)]
                || cells.add_all::<Vector, Eight>(proof.avx2(), proof, &mut sides),
            ),
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx2(proof) => with_vectors(
                #[inline(always)]
                || cells.add_all::<Vector, Vector>(proof, proof, &mut sides),
            ),
            _ => cells.add_all::<Plain, Plain>((), (), &mut sides),
        }
        sides.into_iter().flat_map(|side| side.sums).map(OfStep::finish).collect()
    }
}

/// The sums of a step, and where they are made; none where all is void.
struct OfStep(Option<(Design, Sums)>);

impl OfStep {
    fn new(limits: Limits, range: [f32; 2]) -> Self {
        // Of two zeros either may be the least; only one is written.
        let design = (range[0] <= range[1]).then(|| Design::new(range.map(|v| v + 0.0), limits));
        Self(design.map(|design| (design, Sums::new(&design))))
    }

    fn finish(self) -> ChunkPart {
        match self.0 {
            Some((design, sums)) => sums.finish(design),
            None => ChunkPart { tetrahedra: 0, volume: 0.0, measured: None },
        }
    }
}

/// The values of vertices at a step.
#[derive(Clone, Copy)]
struct Corner {
    value: f32,
    /// How many knots, how many levels are at or below it.
    knots: u16,
    levels: u16,
}

/// The same at four steps: knots, then levels. At the second half of a cache line begins the next.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
struct Corners {
    values: [f32; 4],
    ends: [u16; 8],
}

enum Values {
    One(Vec<Corner>),
    Four(Vec<Corners>),
}

/// Up to four steps that are measured side by side.
struct Side {
    values: Values,
    sums: Vec<OfStep>,
}

impl Side {
    fn new(limits: Limits, steps: &[Vertices<'_>]) -> Self {
        let sums: Vec<OfStep> = steps.iter().map(|step| OfStep::new(limits, step.range)).collect();
        let values = match steps {
            [step] => {
                let mut corners = Vec::with_capacity(step.values.len());
                each_corner(step, &sums[0], |corner| corners.push(corner));
                Values::One(corners)
            }
            _ => {
                let void = Corners { values: [0.0; 4], ends: [VOID; 8] };
                let mut corners = vec![void; steps.iter().map(|step| step.values.len()).max().unwrap_or(0)];
                for (lane, (step, sums)) in steps.iter().zip(&sums).enumerate() {
                    let mut to = corners.iter_mut();
                    each_corner(step, sums, |corner| {
                        let to = to.next().expect("as many as there are values");
                        to.values[lane] = corner.value;
                        (to.ends[lane], to.ends[lane + 4]) = (corner.knots, corner.levels);
                    });
                }
                Values::Four(corners)
            }
        };
        Self { values, sums }
    }
}

/// Finds out where the values of a step lie.
fn each_corner(step: &Vertices<'_>, sums: &OfStep, mut each: impl FnMut(Corner)) {
    let Some((design, _)) = &sums.0 else {
        let void = |&value: &f32| Corner { value, knots: VOID, levels: VOID };
        return step.values.iter().map(void).for_each(each);
    };
    let (knots, levels) = (Places::new(&design.knots), Places::new(&design.levels));
    for &value in step.values {
        let place = |places: &Places| if value.is_nan() { VOID } else { places.of(value) as u16 };
        each(Corner { value, knots: place(&knots), levels: place(&levels) });
    }
}

/// The tetrahedra of a chunk.
struct Cells<'a> {
    places: &'a [[f64; 4]],
    tets: &'a [Tet],
}

/// What is known of some tetrahedra.
struct Room {
    shapes: Shapes,
    pieces: [PiecesOfFour; BATCH],
    spans: [[Span; 4]; BATCH],
}

impl Cells<'_> {
    /// Adds all tetrahedra to the sums: those of all steps for some, then for the next ones.
    #[inline(always)]
    fn add_all<W: Four, K: Wide>(&self, proof: W::Proof, knots: K::Proof, sides: &mut [Side]) {
        let pieces = [[[0.0; 4]; 13]; BATCH];
        let spans = [[Span::default(); 4]; BATCH];
        let mut room = Box::new(Room { shapes: Shapes::default(), pieces, spans });
        for tets in self.tets.chunks(BATCH) {
            room.shapes.look::<W>(proof, self.places, tets);
            for Side { values, sums } in &mut *sides {
                match values {
                    Values::One(corners) => {
                        room.gather_one::<W>(proof, corners, tets);
                        room.add::<K>(knots, tets.len(), &mut sums[0], |i| (i / 4, i % 4));
                    }
                    Values::Four(corners) => {
                        room.gather_four::<W>(proof, corners, tets);
                        for (lane, sums) in sums.iter_mut().enumerate() {
                            room.add::<K>(knots, tets.len(), sums, |i| (i, lane));
                        }
                    }
                }
            }
        }
    }
}

impl Room {
    /// Tetrahedra at one step: four by four.
    #[inline(always)]
    fn gather_one<W: Four>(&mut self, proof: W::Proof, corners: &[Corner], tets: &[Tet]) {
        let rooms = self.pieces.iter_mut().zip(&mut self.spans);
        for (n, (tets, (pieces, spans))) in tets.chunks(4).zip(rooms).enumerate() {
            // Of less than four, the last one again.
            let of = four(
                #[inline(always)]
                |i| {
                    let tet = tets[i.min(tets.len() - 1)];
                    four(
                        #[inline(always)]
                        |k| corners[tet[k] as usize],
                    )
                },
            );
            *spans = four(
                #[inline(always)]
                |i| {
                    let [a, b, c, d] = of[i];
                    Span {
                        knots: ends(a.knots, b.knots, c.knots, d.knots),
                        levels: ends(a.levels, b.levels, c.levels, d.levels),
                    }
                },
            );
            let values = four(
                #[inline(always)]
                |k| W::of_floats(proof, &[of[0][k].value, of[1][k].value, of[2][k].value, of[3][k].value]),
            );
            self.shapes.four::<W>(proof, n).pieces(proof, values, pieces);
        }
    }

    /// Each tetrahedron at four steps.
    #[inline(always)]
    fn gather_four<W: Four>(&mut self, proof: W::Proof, corners: &[Corners], tets: &[Tet]) {
        let rooms = self.pieces.iter_mut().zip(&mut self.spans);
        for (i, (tet, (pieces, spans))) in tets.iter().zip(rooms).enumerate() {
            let of = four(
                #[inline(always)]
                |k| &corners[tet[k] as usize],
            );
            let (mut low, mut high) = (of[0].ends, of[0].ends);
            for corner in &of[1..] {
                for (k, &end) in corner.ends.iter().enumerate() {
                    (low[k], high[k]) = (low[k].min(end), high[k].max(end));
                }
            }
            *spans = four(
                #[inline(always)]
                |k| Span { knots: [low[k], high[k]], levels: [low[k + 4], high[k + 4]] },
            );
            let values = four(
                #[inline(always)]
                |k| W::of_floats(proof, &of[k].values),
            );
            self.shapes.one::<W>(proof, i).pieces(proof, values, pieces);
        }
    }

    /// Adds the first tetrahedra to the sums of a step; `at` tells which four, and which of them, each is.
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
            sums.add::<K>(proof, self.spans[n][lane], &self.pieces[n], lane);
        }
    }
}

#[inline(always)]
fn ends(a: u16, b: u16, c: u16, d: u16) -> [u16; 2] {
    [a.min(b).min(c.min(d)), a.max(b).max(c.max(d))]
}
