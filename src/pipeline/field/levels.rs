//! The field of a level of a pyramid between its nodes, which is trilinear, or of labels that of
//! the nearest node; and its errors at the samples. A level ends at its last node; beyond it there
//! is no value.
//!
//! Samples are decoded box after box, some at a time. Points are sorted by box. A box whose points
//! need no node is not decoded.

use crate::measure::{BrickErrors, ErrorSums};
use crate::pipeline::read::{StepView, index_box, samples_of_level};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Resources, in_order, pool};
use isospan_io::grid::IndexBox;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Cells along each axis of a box that is decoded at a time.
const EDGE: u64 = 64;
/// Bytes of a box: its nodes with margins, at several levels.
const BOX_BYTES: u64 = 16 * (EDGE + 20).pow(3);
/// Samples along each axis of a part that is measured at a time.
const PART: usize = isospan_wavelet::PART;

/// Threads for which there is memory.
fn threads(resources: &Resources) -> usize {
    let fitting = (resources.memory / 2 / BOX_BYTES).max(1);
    resources.worker_threads().min(usize::try_from(fitting).unwrap_or(usize::MAX))
}

/// The value of a cell's nodes at a place in the window; NaN where a node with a weight has none.
fn trilinear(values: &[f32], window: &IndexBox, at: [f64; 3]) -> f32 {
    let (mut node, mut part) = ([0u64; 3], [0.0; 3]);
    for a in 0..3 {
        // The last node ends the last cell.
        let last = window.hi[a] - 1;
        node[a] =
            (at[a].floor().max(0.0) as u64).clamp(window.lo[a], last.saturating_sub(1).max(window.lo[a]));
        part[a] = (at[a] - node[a] as f64).clamp(0.0, 1.0);
    }
    let mut sum = 0.0;
    for corner in 0..8u64 {
        let high = [0, 1, 2].map(|a| corner >> a & 1 == 1);
        let weight: f64 = (0..3).map(|a| if high[a] { part[a] } else { 1.0 - part[a] }).product();
        if weight > 0.0 {
            let at = std::array::from_fn(|a| node[a] + u64::from(high[a]));
            sum += weight * f64::from(values[window.offset(at)]);
        }
    }
    sum as f32 + 0.0
}

/// The value of the node that is nearest to a place in the window: of two, the higher one.
fn nearest(values: &[f32], window: &IndexBox, at: [f64; 3]) -> f32 {
    let node = |a: usize| ((at[a] + 0.5).floor().max(0.0) as u64).clamp(window.lo[a], window.hi[a] - 1);
    values[window.offset([node(0), node(1), node(2)])]
}

/// How values between nodes follow from these: labels are never mixed.
fn between(archive: &StepView) -> fn(&[f32], &IndexBox, [f64; 3]) -> f32 {
    if archive.has_labels() { nearest } else { trilinear }
}

/// Nodes of a level, and samples from one to the next, along each axis.
fn nodes_and_stride(archive: &StepView, level: usize) -> Result<[[u64; 3]; 2]> {
    let pyramid = &archive.pyramid()?.pyramid;
    Ok([pyramid.nodes(level), pyramid.stride(level)].map(|n| n.map(|n| n as u64)))
}

/// The value of the field of a level at places in index space, each with its number, which lie
/// between its nodes.
pub(super) fn values_at_places(
    archive: &StepView,
    level: usize,
    places: &[([f64; 3], u32)],
    resources: &Resources,
    progress: &dyn Progress,
    mut each: impl FnMut(u32, f32) + Send,
) -> Result<u64> {
    let [nodes, stride] = nodes_and_stride(archive, level)?;
    let at = |n: usize| std::array::from_fn(|a| places[n].0[a] / stride[a] as f64);
    let cell = |x: f64, a: usize| (x as u64).min(nodes[a].saturating_sub(2)) / EDGE;
    let mut by_box: BTreeMap<[u64; 3], Vec<usize>> = BTreeMap::new();
    for n in 0..places.len() {
        let place: [f64; 3] = at(n);
        by_box.entry([2, 1, 0].map(|a| cell(place[a], a))).or_default().push(n);
    }
    let (boxes, value_at): (Vec<_>, _) = (by_box.into_iter().collect(), between(archive));
    progress.begin("probe", boxes.len() as u64, "boxes");
    let value = |n: usize| {
        resources.cancel.check()?;
        let ([z, y, x], points) = &boxes[n];
        let lo = [*x, *y, *z].map(|n| n * EDGE);
        let window = IndexBox { lo, hi: std::array::from_fn(|a| (lo[a] + EDGE + 1).min(nodes[a])) };
        let values = archive.nodes(level, &window)?;
        let found = points.iter().map(|&n| (places[n].1, value_at(&values, &window, at(n))));
        Ok(found.collect::<Vec<(u32, f32)>>())
    };
    let threads = archive.pools.lend(threads(resources))?;
    in_order(&vec![0; boxes.len()], 0, &threads, value, |_, found| {
        found.into_iter().for_each(|(n, value)| each(n, value));
        progress.advance(1);
        Ok(())
    })?;
    Ok(boxes.len() as u64)
}

/// Samples of a grid without a value.
#[derive(Default)]
pub(super) struct Without {
    /// Where a node has none.
    pub(super) void: u64,
    /// Beyond the last node of the level.
    pub(super) outside: u64,
}

/// The field of a level at the samples of a grid that spans the domain, in runs, in any order.
pub(super) fn values_on_grid(
    archive: &StepView,
    level: usize,
    grid: [u64; 3],
    resources: &Resources,
    progress: &dyn Progress,
    write: impl Fn(u64, &[f32]) -> Result<()> + Sync,
) -> Result<Without> {
    if grid.contains(&0) {
        return Err(Error::usage("a grid has at least one sample along each axis"));
    }
    let samples = GridOnLevel::new(archive, level, grid)?;
    progress.begin("probe", grid.iter().product(), "samples");
    let sample = |n: usize| {
        resources.cancel.check()?;
        let part = samples.part(n as u64);
        let found = samples.write(archive, &part, &write)?;
        progress.advance(part.len() as u64);
        Ok(found)
    };
    let (threads, mut all) = (archive.pools.lend(threads(resources))?, Without::default());
    in_order(&vec![0; samples.parts() as usize], 0, &threads, sample, |_, found| {
        all.void += found.void;
        all.outside += found.outside;
        Ok(())
    })?;
    Ok(all)
}

/// The samples of a grid that spans the domain, among the nodes of a level.
struct GridOnLevel {
    level: usize,
    grid: [u64; 3],
    /// Samples of the source.
    dims: [u64; 3],
    nodes: [u64; 3],
    stride: [u64; 3],
    /// Samples of the source from one of the grid to the next.
    ratio: [f64; 3],
    /// Samples of the grid up to the last node.
    ends: [u64; 3],
    /// Samples of the grid along the edges of a part.
    edge: [u64; 3],
}

impl GridOnLevel {
    fn new(archive: &StepView, level: usize, grid: [u64; 3]) -> Result<Self> {
        let (dims, [nodes, stride]) = (archive.step().plan.source.dims, nodes_and_stride(archive, level)?);
        let ratio: [f64; 3] = std::array::from_fn(|a| (dims[a] - 1) as f64 / (grid[a] - 1).max(1) as f64);
        let edge = std::array::from_fn(|a| (((EDGE * stride[a]) as f64 / ratio[a]) as u64).max(1));
        let new = Self { level, grid, dims, nodes, stride, ratio, ends: [0; 3], edge };
        let ends = std::array::from_fn(|a| new.end(a));
        Ok(Self { ends, ..new })
    }

    /// Where the i-th sample along an axis is among the nodes; one sample alone lies at the first.
    fn at(&self, i: u64, a: usize) -> f64 {
        let is_last = i + 1 == self.grid[a] && i > 0;
        let sample = if is_last { (self.dims[a] - 1) as f64 } else { i as f64 * self.ratio[a] };
        sample / self.stride[a] as f64
    }

    /// The number of samples along an axis up to the last node.
    fn end(&self, a: usize) -> u64 {
        let last = (self.nodes[a] - 1) as f64 * (1.0 + f64::EPSILON);
        let (mut lo, mut hi) = (0, self.grid[a]);
        while lo < hi {
            let middle = lo + (hi - lo) / 2;
            match self.at(middle, a) <= last {
                true => lo = middle + 1,
                false => hi = middle,
            }
        }
        lo
    }

    /// Parts along each axis.
    fn counts(&self) -> [u64; 3] {
        std::array::from_fn(|a| self.grid[a].div_ceil(self.edge[a]))
    }

    fn parts(&self) -> u64 {
        self.counts().iter().product()
    }

    /// The samples of the n-th part.
    fn part(&self, n: u64) -> IndexBox {
        let counts = self.counts();
        let place = [n % counts[0], n / counts[0] % counts[1], n / counts[0] / counts[1]];
        let lo: [u64; 3] = std::array::from_fn(|a| place[a] * self.edge[a]);
        IndexBox { lo, hi: std::array::from_fn(|a| (lo[a] + self.edge[a]).min(self.grid[a])) }
    }

    /// Hands the values of a part to `write`, row by row.
    fn write(
        &self,
        archive: &StepView,
        part: &IndexBox,
        write: impl Fn(u64, &[f32]) -> Result<()>,
    ) -> Result<Without> {
        let IndexBox { lo, hi } = *part;
        let end: [u64; 3] = std::array::from_fn(|a| hi[a].min(self.ends[a]));
        let within = IndexBox { lo, hi: end };
        let window = IndexBox {
            lo: std::array::from_fn(|a| (self.at(lo[a], a) as u64).min(self.nodes[a] - 1)),
            hi: std::array::from_fn(|a| (self.at(end[a].max(1) - 1, a).ceil() as u64 + 1).min(self.nodes[a])),
        };
        let values = if within.is_empty() { vec![] } else { archive.nodes(self.level, &window)? };
        let mut found = Without { void: 0, outside: part.len() as u64 };
        let (mut row, value_at) = (Vec::with_capacity((hi[0] - lo[0]) as usize), between(archive));
        for z in lo[2]..hi[2] {
            for y in lo[1]..hi[1] {
                row.clear();
                if !within.is_empty() && y < end[1] && z < end[2] {
                    let at = |x| [self.at(x, 0), self.at(y, 1), self.at(z, 2)];
                    row.extend((lo[0]..end[0]).map(|x| value_at(&values, &window, at(x))));
                    found.outside -= row.len() as u64;
                    found.void += row.iter().filter(|v| v.is_nan()).count() as u64;
                }
                row.resize((hi[0] - lo[0]) as usize, f32::NAN);
                write((z * self.grid[1] + y) * self.grid[0] + lo[0], &row)?;
            }
        }
        Ok(found)
    }
}

/// The errors of a level at all samples up to its last node, in parts in order. `originals` reads
/// samples, with NaN for those that are missing. `brick` says in which brick of a map a sample is.
pub(super) fn errors_of(
    archive: &StepView,
    level: usize,
    resources: &Resources,
    progress: &dyn Progress,
    originals: impl Fn(IndexBox, &mut [f32]) -> Result<()> + Sync,
    brick: Option<&(dyn Fn([u64; 3]) -> u64 + Sync)>,
    mut each: impl FnMut(u64, BTreeMap<u64, BrickErrors>) -> Result<()>,
) -> Result<ErrorSums> {
    let (pyramid, dims) = (&archive.pyramid()?.pyramid, archive.step().plan.source.dims);
    let whole = IndexBox { lo: [0; 3], hi: samples_of_level(pyramid, level) };
    let chunks = pyramid.chunks();
    let places = |i: usize| [i % chunks[0], i / chunks[0] % chunks[1], i / chunks[0] / chunks[1]];
    let pool = pool(threads(resources))?;
    progress.begin("measure", dims.iter().product(), "samples");
    let mut sums = ErrorSums::default();
    for chunk in 0..chunks.iter().product() {
        let parts = pyramid.parts(places(chunk), PART);
        let part = |part: &isospan_wavelet::Box3| {
            resources.cancel.check()?;
            let window = index_box(part).intersect(&whole);
            let (mut sums, mut bricks) = (ErrorSums::default(), BTreeMap::<u64, BrickErrors>::new());
            if window.is_empty() {
                return Ok((sums, bricks));
            }
            let nodes = archive.nodes_around(level, &window)?;
            let mut samples = vec![0.0; window.len()];
            originals(window, &mut samples)?;
            nodes.each_row(&window, 1, |[y, z], values| {
                let row = &samples[window.offset([window.lo[0], y, z])..];
                for (x, (original, value)) in (window.lo[0]..).zip(row.iter().zip(values)) {
                    sums.add(*original, *value, || (z * dims[1] + y) * dims[0] + x);
                    if let Some(brick) = brick {
                        bricks.entry(brick([x, y, z])).or_default().add(*original, *value);
                    }
                }
            });
            Ok((sums, bricks))
        };
        let found: Vec<_> = pool.install(|| parts.par_iter().map(part).collect::<Result<_>>())?;
        for (part, bricks) in found {
            sums.merge(&part);
            each(chunk as u64, bricks)?;
        }
        progress.advance(parts.iter().map(|p| p.len() as u64).sum());
    }
    Ok(sums)
}
