//! The vertices of a chunk at some steps, with what is known of them, side by side.

use super::design::{Design, Limits};
use super::grid::BinaryPlaces;
use super::measure::{ChunkPart, Vertices};
use super::sums::{Ends, Sums, VOID};
use crate::exec::lanes::bytes::{equal, greater, lesser};
use crate::exec::{will_read, with_vectors};
use crate::mesh::tet::Tet;

/// Steps that are measured side by side.
pub(super) const SIDE_BY_SIDE: usize = 8;

/// The sums of a step, and where they are made; none where all is void.
pub(super) struct OfStep(pub(super) Option<(Design, Sums)>);

impl OfStep {
    fn new(limits: Limits, range: [f32; 2]) -> Self {
        // Of two zeros either may be the least; only one is written.
        let design = (range[0] <= range[1]).then(|| Design::new(range.map(|v| v + 0.0), limits));
        Self(design.map(|design| (design, Sums::new(&design))))
    }

    /// How many knots are at or below each value.
    #[inline(always)]
    fn knots(&self, values: &[f32]) -> impl Iterator<Item = u8> {
        let places = self.0.as_ref().map(|(design, _)| BinaryPlaces::new(&design.knots));
        values.iter().map(
            #[inline(always)]
            move |value| match &places {
                Some(places) if !value.is_nan() => places.of(*value) as u8,
                _ => VOID,
            },
        )
    }

    /// What the tetrahedra have at their ends, so far nothing.
    fn ends(&self) -> Option<Ends> {
        self.0.as_ref().map(|(design, _)| Ends::new(design))
    }

    fn finish(self, ends: Option<Ends>) -> ChunkPart {
        match self.0.zip(ends) {
            Some(((design, sums), ends)) => sums.finish(design, &ends),
            None => ChunkPart { tetrahedra: 0, volume: 0.0, measured: None },
        }
    }
}

/// Up to eight steps.
pub(super) enum Side {
    One(Alone),
    Four(Together<4>),
    Eight(Together<8>),
}

impl Side {
    pub(super) fn new(limits: Limits, steps: &[Vertices<'_>], room: &mut Room) -> Self {
        let sums: Vec<OfStep> = steps.iter().map(|step| OfStep::new(limits, step.range)).collect();
        with_vectors(
            #[inline(always)]
            || match steps {
                [step] => Self::One(Alone::new(step, sums)),
                _ if steps.len() <= 4 => Self::Four(Together::new(steps, sums, Memory::default())),
                _ => Self::Eight(Together::new(steps, sums, room.0.pop().unwrap_or_default())),
            },
        )
    }

    pub(super) fn finish(self, room: &mut Room) -> Vec<ChunkPart> {
        match self {
            Self::One(side) => side.finish(),
            Self::Four(side) => side.finish().0,
            Self::Eight(side) => {
                let (parts, memory) = side.finish();
                room.0.push(memory);
                parts
            }
        }
    }
}

/// A step by itself: of each vertex its value, how many knots are at or below it, of how many more tetrahedra it is the least corner than the largest.
pub(super) struct Alone {
    pub(super) values: Vec<f32>,
    pub(super) knots: Vec<u8>,
    pub(super) ends: Vec<i32>,
    pub(super) sums: Vec<OfStep>,
}

impl Alone {
    #[inline(always)]
    fn new(step: &Vertices<'_>, sums: Vec<OfStep>) -> Self {
        let (values, knots) = (step.values.to_vec(), sums[0].knots(step.values).collect());
        Self { ends: vec![0; values.len()], values, knots, sums }
    }

    fn finish(self) -> Vec<ChunkPart> {
        let Self { values, knots, ends, sums } = self;
        let all = |mut to: Ends| {
            let vertices = values.iter().zip(&knots).zip(&ends);
            vertices.for_each(|((&value, &knots), &ends)| to.add(value, knots, ends));
            to
        };
        sums.into_iter()
            .map(|sums| (sums.ends().map(all), sums))
            .map(|(ends, sums)| sums.finish(ends))
            .collect()
    }
}

/// A vertex at some steps: as for [`Alone`].
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Vertex<const N: usize> {
    pub(super) values: [f32; N],
    pub(super) ends: [i32; N],
}

/// How many knots are at or below a vertex's value at some steps; void where there are fewer.
pub(super) type Knots = [u8; SIDE_BY_SIDE];

/// Some steps side by side. Lanes that have no step are void.
pub(super) struct Together<const N: usize> {
    pub(super) vertices: Vec<Vertex<N>>,
    pub(super) knots: Vec<Knots>,
    pub(super) sums: Vec<OfStep>,
}

/// Vertices that are put side by side at a time: they fit in the nearest cache.
const SOME: usize = 256;

/// Memory of steps side by side.
type Memory<const N: usize> = (Vec<Vertex<N>>, Vec<Knots>);

/// The memory of eight steps side by side, kept from chunk to chunk so that its pages are not asked for again.
#[derive(Default)]
pub struct Room(Vec<Memory<8>>);

impl<const N: usize> Together<N> {
    #[inline(always)]
    fn new(steps: &[Vertices<'_>], sums: Vec<OfStep>, (mut vertices, mut knots): Memory<N>) -> Self {
        let count = steps[0].values.len();
        let nothing = Vertex { values: [f32::NAN; N], ends: [0; N] };
        vertices.resize(count, nothing);
        knots.resize(count, [VOID; SIDE_BY_SIDE]);
        for (n, (vertices, knots)) in vertices.chunks_mut(SOME).zip(knots.chunks_mut(SOME)).enumerate() {
            vertices.fill(nothing);
            knots.fill([VOID; SIDE_BY_SIDE]);
            for (lane, (step, sums)) in steps.iter().zip(&sums).enumerate() {
                let values = &step.values[n * SOME..][..vertices.len()];
                vertices.iter_mut().zip(values).for_each(|(to, &value)| to.values[lane] = value);
                knots.iter_mut().zip(sums.knots(values)).for_each(|(to, knots)| to[lane] = knots);
            }
        }
        Self { vertices, knots, sums }
    }

    /// The parts, and the memory.
    fn finish(self) -> (Vec<ChunkPart>, Memory<N>) {
        let Self { vertices, knots, sums } = self;
        let mut all: Vec<Option<Ends>> = sums.iter().map(OfStep::ends).collect();
        for (vertex, knots) in vertices.iter().zip(&knots) {
            for (lane, to) in all.iter_mut().enumerate() {
                if let Some(to) = to {
                    to.add(vertex.values[lane], knots[lane], vertex.ends[lane]);
                }
            }
        }
        let parts = sums.into_iter().zip(all).map(|(sums, ends)| sums.finish(ends));
        (parts.collect(), (vertices, knots))
    }

    /// Asks for the vertices of tetrahedra that come next.
    #[inline(always)]
    pub(super) fn will_look_at(&self, tets: &[Tet]) {
        for &v in tets.as_flattened() {
            will_read(&self.vertices[v as usize..v as usize + 1]);
        }
    }
}

/// One for the corner that is the least, minus one for the one that is the largest; of equal ones, the first. 0 where a corner is NaN.
#[inline(always)]
pub(super) fn ends_of<const N: usize>([a, b, c, d]: &[[f32; N]; 4]) -> [[i32; N]; 4] {
    let mut out = [[0; N]; 4];
    for k in 0..N {
        let (a, b, c, d) = (a[k], b[k], c[k], d[k]);
        let live = !(a.is_nan() | b.is_nan() | c.is_nan() | d.is_nan());
        let (ab, cd) = (a <= b, c <= d);
        let low = (if ab { a } else { b }) <= (if cd { c } else { d });
        let (ba, dc) = (a >= b, c >= d);
        let high = (if ba { a } else { b }) >= (if dc { c } else { d });
        let end = |least: bool, largest: bool| i32::from(live & least) - i32::from(live & largest);
        out[0][k] = end(low & ab, high & ba);
        out[1][k] = end(low & !ab, high & !ba);
        out[2][k] = end(!low & cd, !high & dc);
        out[3][k] = end(!low & !cd, !high & !dc);
    }
    out
}

/// From the least to the largest number of knots at or below the corners; void where a corner is.
#[inline(always)]
pub(super) fn span_of([a, b, c, d]: [Knots; 4]) -> [Knots; 2] {
    let lo = lesser(lesser(a, b), lesser(c, d));
    let hi = greater(greater(a, b), greater(c, d));
    // All bits of those that are void.
    const _: () = assert!(VOID == u8::MAX);
    let void = u64::from_le_bytes(equal(hi, [VOID; SIDE_BY_SIDE]));
    [(u64::from_le_bytes(lo) | void).to_le_bytes(), hi]
}
