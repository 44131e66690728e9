//! The vertices of a chunk at some steps, with what is known of them, interleaved.

use super::design::{Design, Limits};
use super::part::{ChunkPart, Vertices};
use super::sums::{Ends, Sums};
use isospan_io::exec::will_read;
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::simd::with_vectors;

/// Steps that are interleaved, at most, and at least: two are measured sooner one by one.
pub(super) const LANES: usize = 8;
const FEWEST: usize = 3;

/// The design at which a step is measured; `None` where all is void.
fn design(limits: Limits, step: &Vertices<'_>) -> Option<Design> {
    // Either of two zeros may be the least; only one is written.
    (step.range[0] <= step.range[1]).then(|| Design::new(step.range.map(|v| v + 0.0), limits))
}

/// The part where all is void.
pub(super) const NOTHING: ChunkPart = ChunkPart { tetrahedra: 0, volume: 0.0, measured: None };

/// One step, or up to eight.
pub(super) enum Lanes {
    One(Box<Alone>),
    Eight(Box<Together>),
}

impl Lanes {
    /// The lanes of all steps, in their order.
    pub(super) fn all(limits: Limits, steps: &[Vertices<'_>], buffers: &mut LaneBuffers) -> Vec<Self> {
        let mut lanes = vec![];
        with_vectors(
            #[inline(always)]
            || {
                for steps in steps.chunks(LANES) {
                    if steps.len() < FEWEST {
                        lanes.extend(steps.iter().map(|step| Self::One(Box::new(Alone::new(limits, step)))));
                    } else {
                        let memory = buffers.0.pop().unwrap_or_default();
                        lanes.push(Self::Eight(Box::new(Together::new(limits, steps, memory))));
                    }
                }
            },
        );
        lanes
    }

    /// The parts of a chunk of `tets` tetrahedra.
    pub(super) fn finish(self, tets: u64, buffers: &mut LaneBuffers) -> Vec<ChunkPart> {
        with_vectors(
            #[inline(always)]
            || match self {
                Self::One(steps) => vec![steps.finish(tets)],
                Self::Eight(steps) => {
                    let (parts, memory) = steps.finish(tets);
                    buffers.0.push(memory);
                    parts
                }
            },
        )
    }
}

/// A step by itself: for each vertex its value, and the number of tetrahedra of which it is the
/// least corner, less the number of which it is the largest.
pub(super) struct Alone {
    pub(super) values: Vec<f32>,
    pub(super) ends: Vec<i32>,
    pub(super) design: Option<Design>,
    pub(super) sums: Sums,
    /// Tetrahedra that are void.
    pub(super) void: u64,
}

impl Alone {
    #[inline(always)]
    fn new(limits: Limits, step: &Vertices<'_>) -> Self {
        let design = design(limits, step);
        let (values, sums) = (step.values.to_vec(), Sums::new(design.as_ref()));
        Self { ends: vec![0; values.len()], values, design, sums, void: 0 }
    }

    #[inline(always)]
    fn finish(self, tets: u64) -> ChunkPart {
        let Some(design) = self.design else { return NOTHING };
        let mut ends = Ends::new(&design);
        self.values.iter().zip(&self.ends).for_each(|(&value, &n)| ends.add(value, n));
        self.sums.finish(tets - self.void, design, &ends)
    }
}

/// A vertex at some steps: as for [`Alone`].
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
pub(super) struct LaneVertex {
    pub(super) values: [f32; LANES],
    pub(super) ends: [i32; LANES],
}

/// Some interleaved steps. Lanes that have no step are 0.
pub(super) struct Together {
    pub(super) vertices: Vec<LaneVertex>,
    pub(super) designs: [Option<Design>; LANES],
    pub(super) sums: Box<[Sums; LANES]>,
    /// Tetrahedra that are void.
    pub(super) void: [u64; LANES],
    steps: usize,
}

/// Vertices that are interleaved at a time: they fit in the nearest cache.
const SOME: usize = 256;

/// The memory of interleaved steps, reused from chunk to chunk so that its pages are not asked
/// for again.
#[derive(Default)]
pub struct LaneBuffers(Vec<Vec<LaneVertex>>);

impl Together {
    #[inline(always)]
    fn new(limits: Limits, steps: &[Vertices<'_>], mut vertices: Vec<LaneVertex>) -> Self {
        let designs = std::array::from_fn(|lane| steps.get(lane).and_then(|step| design(limits, step)));
        let sums: Vec<Sums> =
            designs.iter().map(|design: &Option<Design>| Sums::new(design.as_ref())).collect();
        let sums = sums.into_boxed_slice().try_into().ok().expect("as many as lanes");
        vertices.resize(steps[0].values.len(), LaneVertex::default());
        for (n, vertices) in vertices.chunks_mut(SOME).enumerate() {
            vertices.fill(LaneVertex::default());
            for (lane, step) in steps.iter().enumerate().filter(|(lane, _)| designs[*lane].is_some()) {
                let values = &step.values[n * SOME..][..vertices.len()];
                vertices.iter_mut().zip(values).for_each(|(to, &value)| to.values[lane] = value);
            }
        }
        Self { vertices, designs, sums, void: [0; LANES], steps: steps.len() }
    }

    /// The parts, and the memory.
    #[inline(always)]
    fn finish(self, tets: u64) -> (Vec<ChunkPart>, Vec<LaneVertex>) {
        let mut all = self.designs.map(|design| design.as_ref().map(Ends::new));
        for vertices in self.vertices.chunks(SOME) {
            for (lane, ends) in all.iter_mut().enumerate() {
                if let Some(ends) = ends {
                    vertices.iter().for_each(|vertex| ends.add(vertex.values[lane], vertex.ends[lane]));
                }
            }
        }
        let part = |lane: usize| match (self.designs[lane], &all[lane]) {
            (Some(design), Some(ends)) => self.sums[lane].finish(tets - self.void[lane], design, ends),
            _ => NOTHING,
        };
        ((0..self.steps).map(part).collect(), self.vertices)
    }

    /// Asks for the vertices of a tetrahedron that comes soon.
    #[inline(always)]
    pub(super) fn will_look_at(&self, tet: &Tet) {
        for &v in tet {
            will_read(&self.vertices[v as usize..v as usize + 1]);
        }
    }
}

/// One for the corner that is the least, minus one for the one that is the largest; of equal ones
/// any. No value is NaN.
#[inline(always)]
pub(super) fn ends_of<const N: usize>([a, b, c, d]: &[[f32; N]; 4]) -> [[i32; N]; 4] {
    let mut out = [[0; N]; 4];
    for k in 0..N {
        let (a, b, c, d) = (a[k], b[k], c[k], d[k]);
        let (ab, cd) = (a <= b, c <= d);
        let low = (if ab { a } else { b }) <= (if cd { c } else { d });
        let high = (if ab { b } else { a }) >= (if cd { d } else { c });
        let end = |least: bool, largest: bool| i32::from(least) - i32::from(largest);
        out[0][k] = end(low & ab, high & !ab);
        out[1][k] = end(low & !ab, high & ab);
        out[2][k] = end(!low & cd, !high & !cd);
        out[3][k] = end(!low & !cd, !high & cd);
    }
    out
}
