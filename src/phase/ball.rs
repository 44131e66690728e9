//! The node of a phase that is farthest from all others: an exact distance transform.

use super::map::{Phase, PhaseMap, WORD};
use isospan_io::bytes::store::Store;
use isospan_io::error::Result;
use isospan_io::exec::{CancelToken, Threads};
use rayon::prelude::*;
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// The largest ball around a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// The node.
    pub node: [usize; 3],
    /// Its distance from the nearest node that is not in the phase, or from the nearest face of the
    /// grid.
    pub distance: f64,
}

/// What the search for a ball may use.
#[derive(Clone, Copy)]
pub struct BallMeans<'a> {
    /// Bytes for nodes in their planes, and as many for columns.
    pub memory: usize,
    /// Folder for what does not fit in them.
    pub scratch: &'a Path,
    /// Threads.
    pub threads: &'a Threads,
    /// Stops it.
    pub cancel: &'a CancelToken,
}

/// No node.
const NONE: u32 = u32::MAX;

/// The largest ball of a phase: see [`crate::phase`]. `axes` are the places of the nodes along each
/// axis, which must be at right angles, counted from the first one and ascending. Of nodes as far
/// from others the first one. None where no node is in the phase, or on the faces alone, and of a
/// grid whose planes have 2^32 nodes.
///
/// # Errors
/// Those of the scratch folder; [`crate::Error::Cancelled`].
pub fn largest_ball(
    map: &PhaseMap,
    phase: Phase,
    axes: &[Vec<f64>; 3],
    means: &BallMeans<'_>,
) -> Result<Option<Ball>> {
    let [nx, ny, nz] = map.dims();
    if nx.checked_mul(ny).is_none_or(|n| n >= NONE as usize) {
        return Ok(None);
    }
    let nearest = nearest_in_planes(map, phase, axes, means)?;
    let search = ColumnSearch { dims: map.dims(), axes, best: AtomicU64::new(0) };
    let rows = (means.memory / (4 * nx * nz).max(1)).clamp(1, ny);
    let (mut found, mut block) = (NodeDistance::default(), vec![]);
    for first in (0..ny).step_by(rows) {
        means.cancel.check()?;
        let count = rows.min(ny - first);
        block.resize(count * nx * nz, NONE);
        for (z, part) in block.chunks_mut(count * nx).enumerate() {
            nearest.read_from(((z * ny + first) * nx) as u64, part)?;
        }
        let of_row = |row: usize| search.row(first + row, &block[row * nx..], count * nx);
        found = each_of(means.threads, 0..count, of_row).into_iter().fold(found, NodeDistance::or);
    }
    let node = [found.place % nx, found.place / nx % ny, found.place / nx / ny];
    Ok((found.squared > 0.0).then(|| Ball { node, distance: found.squared.sqrt() }))
}

/// What some numbers give, on all threads.
fn each_of<T: Send>(
    threads: &Threads,
    numbers: Range<usize>,
    of: impl Fn(usize) -> T + Sync + Send,
) -> Vec<T> {
    match threads {
        Threads::Calling => numbers.map(of).collect(),
        Threads::Pool(pool) => pool.install(|| numbers.into_par_iter().map(of).collect()),
    }
}

/// A node and the square of its distance.
#[derive(Clone, Copy, Debug)]
struct NodeDistance {
    squared: f64,
    place: usize,
}

impl Default for NodeDistance {
    fn default() -> Self {
        Self { squared: 0.0, place: usize::MAX }
    }
}

impl NodeDistance {
    /// The farther one; of two as far the first.
    fn or(self, other: Self) -> Self {
        let is_farther = other.squared > self.squared;
        let is_first = other.squared == self.squared && other.place < self.place;
        if is_farther || is_first { other } else { self }
    }
}

/// For each node of the phase the nearest node in its plane that is not in it: x + nx·y.
fn nearest_in_planes(
    map: &PhaseMap,
    phase: Phase,
    axes: &[Vec<f64>; 3],
    means: &BallMeans<'_>,
) -> Result<Store<u32>> {
    let [nx, ny, nz] = map.dims();
    let mut all = Store::new(means.memory, means.scratch);
    let at_once = means.threads.count().max(1);
    for first in (0..nz).step_by(at_once) {
        means.cancel.check()?;
        let plane = |z: usize| -> Result<Vec<u32>> {
            let mut bits = vec![];
            map.plane(phase, z, &mut bits)?;
            Ok(nearest_in_plane(&bits, map.words(), [nx, ny], axes))
        };
        let planes = first..(first + at_once).min(nz);
        each_of(means.threads, planes, plane).into_iter().try_for_each(|plane| all.extend(&plane?))?;
    }
    Ok(all)
}

fn nearest_in_plane(bits: &[u64], words: usize, [nx, ny]: [usize; 2], axes: &[Vec<f64>; 3]) -> Vec<u32> {
    let mut in_rows = vec![NONE; nx * ny];
    for (y, row) in in_rows.chunks_mut(nx).enumerate() {
        nearest_in_row(&bits[y * words..][..words], &axes[0], row);
    }
    let (mut envelope, mut heights, mut all) = (Envelope::default(), vec![0.0; ny], vec![NONE; nx * ny]);
    for x in 0..nx {
        for (y, height) in heights.iter_mut().enumerate() {
            let near = in_rows[y * nx + x];
            *height = if near == NONE { f64::INFINITY } else { square(axes[0][x] - axes[0][near as usize]) };
        }
        envelope.build(&axes[1], &heights);
        envelope.each(&axes[1], |y, lowest| {
            all[y * nx + x] = in_rows[lowest * nx + x] + (lowest * nx) as u32;
        });
    }
    all
}

/// For each node of a row the nearest one that is not in the phase.
fn nearest_in_row(bits: &[u64], places: &[f64], out: &mut [u32]) {
    let mut before = NONE;
    for (x, near) in out.iter_mut().enumerate() {
        if bits[x / WORD] >> (x % WORD) & 1 == 0 {
            before = x as u32;
        }
        *near = before;
    }
    let mut behind = NONE;
    for (x, near) in out.iter_mut().enumerate().rev() {
        if *near == x as u32 {
            behind = *near;
        }
        if behind == NONE {
            continue;
        }
        let is_nearer =
            *near == NONE || places[behind as usize] - places[x] < places[x] - places[*near as usize];
        if is_nearer {
            *near = behind;
        }
    }
}

fn square(x: f64) -> f64 {
    x * x
}

/// The search in columns along z.
struct ColumnSearch<'a> {
    dims: [usize; 3],
    axes: &'a [Vec<f64>; 3],
    /// The bits of the largest square so far: they ascend with it.
    best: AtomicU64,
}

impl ColumnSearch<'_> {
    /// The farthest node of a row of columns, whose nodes lie `stride` apart in `nearest`.
    fn row(&self, y: usize, nearest: &[u32], stride: usize) -> NodeDistance {
        let [nx, ny, nz] = self.dims;
        let (mut envelope, mut found) = (Envelope::default(), NodeDistance::default());
        let (mut heights, mut most) = (vec![0.0; nz], vec![0.0; nz]);
        for x in 0..nx {
            let to_face = self.to_face(0, x).min(self.to_face(1, y));
            let best = f64::from_bits(self.best.load(Ordering::Relaxed));
            let mut highest = 0.0f64;
            for z in 0..nz {
                let near = nearest[z * stride + x];
                heights[z] = self.in_plane([x, y], near);
                most[z] = square(to_face.min(self.to_face(2, z)));
                highest = highest.max(most[z].min(heights[z]));
            }
            if highest < best || highest == 0.0 {
                continue;
            }
            envelope.build(&self.axes[2], &heights);
            let mut at = |z: usize, squared: f64| {
                let place = (z * ny + y) * nx + x;
                found = found.or(NodeDistance { squared: squared.min(most[z]), place });
            };
            if envelope.sites.is_empty() {
                (0..nz).for_each(|z| at(z, f64::INFINITY));
            }
            envelope.each(&self.axes[2], |z, lowest| {
                at(z, square(self.axes[2][z] - self.axes[2][lowest]) + heights[lowest]);
            });
            self.best.fetch_max(found.squared.to_bits(), Ordering::Relaxed);
        }
        found
    }

    /// The square of the distance of a node from another one in its plane.
    fn in_plane(&self, [x, y]: [usize; 2], near: u32) -> f64 {
        if near == NONE {
            return f64::INFINITY;
        }
        let (u, v) = (near as usize % self.dims[0], near as usize / self.dims[0]);
        square(self.axes[0][x] - self.axes[0][u]) + square(self.axes[1][y] - self.axes[1][v])
    }

    /// The distance of a node from the nearer face across an axis.
    fn to_face(&self, axis: usize, n: usize) -> f64 {
        let places = &self.axes[axis];
        places[n].min(places[places.len() - 1] - places[n])
    }
}

/// The lower envelope of parabolas, one at each place with a height.
#[derive(Debug, Default)]
struct Envelope {
    /// The parabolas that are somewhere the lowest, and from where on each is.
    sites: Vec<usize>,
    from: Vec<f64>,
}

impl Envelope {
    fn build(&mut self, places: &[f64], heights: &[f64]) {
        self.sites.clear();
        self.from.clear();
        for (q, &height) in heights.iter().enumerate().filter(|(_, h)| h.is_finite()) {
            let mut from = f64::NEG_INFINITY;
            let mut is_lower = true;
            while let Some(&k) = self.sites.last() {
                let apart = places[q] - places[k];
                if apart <= 0.0 && height >= heights[k] {
                    is_lower = false;
                    break;
                }
                // Where the two have one height.
                from = if apart <= 0.0 {
                    f64::NEG_INFINITY
                } else {
                    0.5 * (places[q] + places[k] + (height - heights[k]) / apart)
                };
                if from > self.from[self.from.len() - 1] {
                    break;
                }
                self.sites.pop();
                self.from.pop();
                from = f64::NEG_INFINITY;
            }
            if is_lower {
                self.sites.push(q);
                self.from.push(from);
            }
        }
    }

    /// Calls with each place and that of the parabola that is the lowest there.
    fn each(&self, places: &[f64], mut each: impl FnMut(usize, usize)) {
        if self.sites.is_empty() {
            return;
        }
        let mut n = 0;
        for (at, &place) in places.iter().enumerate() {
            while self.from.get(n + 1).is_some_and(|from| *from < place) {
                n += 1;
            }
            each(at, self.sites[n]);
        }
    }
}
