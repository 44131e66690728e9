//! The connected components of a surface: measured, and the small ones left out.
//!
//! # How does it work?
//!
//! Union-find over the vertices: the vertices of a triangle belong together. Of two roots the one
//! of lower number stays, so a parent is never above its child, and one ascending pass turns
//! parents into component numbers: a root opens a component, any other vertex has that of its
//! parent, which came before. Components are so numbered by their first vertex. Two more passes
//! measure them; then the kept ones are copied, in the old order.
//!
//! Vertices and triangles are read front to back; what is needed at random (parents, positions,
//! components) lies in paged arrays within the memory given. Neighbouring triangles have near
//! numbers, so few pages move.
//!
//! # What is measured?
//!
//! * *Volume*, of a closed component: what it encloses, positive, or negative when it bounds a
//!   cavity (its normals point to what it encloses). Of an open one: the signed volume between it
//!   and the centre of its bounding box, the sum of the tetrahedra that its triangles form with
//!   that point. It is a property of the component alone, wherever it lies, and that of a closed
//!   surface where the opening is small and flat.
//! * *Closed*: every edge is run along as often in one direction as in the other. Each triangle
//!   adds a 64-bit hash for an edge that it runs up, and subtracts it for one that it runs down; a
//!   component is closed when all cancel. An open one passes for closed with probability 2^-64.
//!
//! # Cost
//!
//! O(n α(n)) time, five passes. Nothing depends on threads or memory but the time.
//!
//! # References
//! Tarjan 1975, "Efficiency of a good but not linear set union algorithm"; path halving: Tarjan,
//! van Leeuwen 1984.

mod split;

pub use split::split;

use crate::surface::closest::closest;
use crate::surface::model::{SurfaceSource, Vertex, corner_of};
use crate::surface::weld::{BuilderSettings, StoredSurface};
use glam::DVec3;
use isospan_io::bytes::paged::Paged;
use isospan_io::error::{Error, Result};
use serde::Serialize;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Which components are kept. All conditions hold for a kept one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComponentFilter {
    /// At most this many: those with most triangles, and among equals those that begin first.
    pub largest: Option<u64>,
    /// At least this many triangles.
    pub min_triangles: u64,
    /// At least this volume, in world units, regardless of its sign (see [`Component::volume`]).
    pub min_volume: f64,
}

impl Default for ComponentFilter {
    fn default() -> Self {
        Self { largest: None, min_triangles: 1, min_volume: 0.0 }
    }
}

/// A connected component.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Component {
    /// Triangles.
    pub triangles: u64,
    /// Vertices.
    pub vertices: u64,
    /// Area.
    pub area: f64,
    /// Enclosed volume; negative for a cavity. Of an open component: the volume between it and the
    /// centre of its bounding box.
    pub volume: f64,
    /// Whether it has no boundary.
    pub closed: bool,
    /// Least and largest coordinates.
    pub bounding_box: [[f64; 3]; 2],
}

/// What [`components`] found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ComponentReport {
    /// Components of the surface.
    pub found: u64,
    /// Components kept.
    pub kept: u64,
    /// The kept components of most triangles, the largest first; at most [`MOST_LISTED`].
    pub listed: Vec<Component>,
}

/// Components listed in a report.
pub const MOST_LISTED: u64 = 1000;

/// Bytes that the choice of the largest takes for each of them.
const CHOICE: u64 = 32;

/// Measures the components of a surface, and keeps those that the filter accepts.
///
/// # Errors
/// [`Error::Budget`] when more of the largest are wanted than memory holds; [`Error::Io`] for the
/// scratch folder.
pub fn components(
    surface: StoredSurface,
    filter: &ComponentFilter,
    settings: &BuilderSettings,
) -> Result<(StoredSurface, ComponentReport)> {
    let memory = settings.memory_bytes as u64;
    let paged = |share: u64| memory / 8 * share;
    let (mut labels, mut records, _) = measured(&surface, settings)?;
    let (mut report, listed, all) =
        choose(&mut records, filter, paged(1)).map_err(|e| e.of_share(paged(1), memory))?;
    for number in listed.into_numbers() {
        report.listed.push(records.get(number)?.component(surface.origin()));
    }
    if all {
        return Ok((surface, report));
    }
    let settings = BuilderSettings { memory_bytes: paged(1) as usize, scratch: settings.scratch.clone() };
    Ok((copy_kept(&surface, &mut labels, &mut records, &settings)?, report))
}

/// What [`totals`] finds of a whole surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceTotals {
    /// Connected components.
    pub pieces: u64,
    /// Those that have no boundary.
    pub closed_pieces: u64,
    /// Area.
    pub area: f64,
    /// The distance of each of the given places from the surface; infinite where it is empty.
    pub distances: Vec<f64>,
}

/// Measures a surface as a whole, and how far it is from some places of the world.
///
/// # Errors
/// [`Error::Io`] for the scratch folder.
pub fn totals(
    surface: &StoredSurface,
    places: &[[f64; 3]],
    settings: &BuilderSettings,
) -> Result<SurfaceTotals> {
    let (_, mut records, mut positions) = measured(surface, settings)?;
    let mut totals = SurfaceTotals::default();
    for number in 0..records.len() {
        let record = records.get(number)?;
        totals.pieces += u64::from(record.triangles > 0);
        totals.closed_pieces += u64::from(record.triangles > 0 && record.is_closed());
        totals.area += record.area;
    }
    let origin = surface.origin();
    let places: Vec<DVec3> =
        places.iter().map(|p| DVec3::from_array(*p) - DVec3::from_array(origin)).collect();
    let mut squares = vec![f64::INFINITY; places.len()];
    if !places.is_empty() {
        each_triangle(surface, |t| {
            let mut corners = [DVec3::ZERO; 3];
            for (corner, v) in corners.iter_mut().zip(t) {
                *corner = DVec3::from_array(positions.get(u64::from(v))?.map(f64::from));
            }
            for (square, &place) in squares.iter_mut().zip(&places) {
                *square = square.min((closest(place, corners) - place).length_squared());
            }
            Ok(())
        })?;
    }
    totals.distances = squares.into_iter().map(f64::sqrt).collect();
    Ok(totals)
}

/// The component of each vertex, what was measured of each component, and the positions.
type Found = (Paged<u32>, Paged<Record>, Paged<[f32; 3]>);

fn measured(surface: &StoredSurface, settings: &BuilderSettings) -> Result<Found> {
    let paged = |share: u64| settings.memory_bytes as u64 / 8 * share;
    let vertices = surface.vertex_count();
    let mut labels = Paged::<u32>::new(vertices, paged(1), &settings.scratch);
    join_triangles(surface, &mut labels)?;
    let count = number_components(&mut labels)?;
    let mut records = Paged::<Record>::new(count, paged(2), &settings.scratch);
    let mut positions = Paged::<[f32; 3]>::new(vertices, paged(3), &settings.scratch);
    measure_vertices(surface, &mut labels, &mut records, &mut positions)?;
    measure_triangles(surface, &mut labels, &mut records, &mut positions)?;
    Ok((labels, records, positions))
}

/// A component while it is measured.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Record {
    triangles: u64,
    vertices: u64,
    area: f64,
    /// Six times the volume between the triangles and `origin`.
    volume6: f64,
    /// Twice the sum of the area vectors: zero when closed.
    area_vector2: [f64; 3],
    /// Sum of the hashes of edges, up and down.
    edges: u64,
    /// The first vertex: near all others, so that volumes lose no digits.
    origin: [f32; 3],
    lo: [f32; 3],
    hi: [f32; 3],
    kept: u32,
}

impl Record {
    fn add_vertex(&mut self, v: &Vertex) {
        if self.vertices == 0 {
            (self.origin, self.lo, self.hi) = (v.position, v.position, v.position);
        }
        self.vertices += 1;
        for (k, x) in v.position.into_iter().enumerate() {
            (self.lo[k], self.hi[k]) = (self.lo[k].min(x), self.hi[k].max(x));
        }
    }

    fn add_triangle(&mut self, t: [u32; 3], corners: [[f32; 3]; 3]) {
        let from_origin = |p: [f32; 3]| {
            let (p, o) = (p.map(f64::from), self.origin.map(f64::from));
            DVec3::new(p[0] - o[0], p[1] - o[1], p[2] - o[2])
        };
        let [a, b, c] = corners.map(from_origin);
        let normal2 = (b - a).cross(c - a);
        self.triangles += 1;
        self.area += 0.5 * normal2.length();
        self.volume6 += a.dot(b.cross(c));
        for (sum, x) in self.area_vector2.iter_mut().zip(normal2.to_array()) {
            *sum += x;
        }
        let [a, b, c] = t;
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let hash = hash_edge(from.min(to), from.max(to));
            self.edges = self.edges.wrapping_add(if from < to { hash } else { hash.wrapping_neg() });
        }
    }

    fn is_closed(&self) -> bool {
        self.edges == 0
    }

    fn volume(&self) -> f64 {
        if self.is_closed() {
            return self.volume6 / 6.0;
        }
        // Moving the apex by d takes away d · (sum of area vectors) / 3.
        let moved = (0..3).map(|k| {
            let centre = 0.5 * (f64::from(self.lo[k]) + f64::from(self.hi[k]));
            (centre - f64::from(self.origin[k])) * self.area_vector2[k]
        });
        (self.volume6 - moved.sum::<f64>()) / 6.0
    }

    fn component(&self, origin: [f64; 3]) -> Component {
        Component {
            triangles: self.triangles,
            vertices: self.vertices,
            area: self.area,
            volume: self.volume(),
            closed: self.is_closed(),
            bounding_box: [self.lo, self.hi].map(|corner| corner_of(corner.map(|x| x + 0.0), origin)),
        }
    }
}

/// Two rounds of SplitMix64's finalizer (Steele, Lea, Flood 2014).
fn hash_edge(low: u32, high: u32) -> u64 {
    let mut x = u64::from(low) << 32 | u64::from(high);
    for _ in 0..2 {
        x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^= x >> 31;
    }
    x
}

/// Hands all triangles one by one.
fn each_triangle(surface: &StoredSurface, mut each: impl FnMut([u32; 3]) -> Result<()>) -> Result<()> {
    surface.triangles(&mut |batch| batch.iter().try_for_each(|&t| each(t)))
}

fn join_triangles(surface: &StoredSurface, parents: &mut Paged<u32>) -> Result<()> {
    for v in 0..parents.len() {
        parents.set(v, v as u32)?;
    }
    each_triangle(surface, |[a, b, c]| {
        let (a, b, c) = (root(parents, a)?, root(parents, b)?, root(parents, c)?);
        let lowest = a.min(b).min(c);
        for v in [a, b, c] {
            parents.set(u64::from(v), lowest)?;
        }
        Ok(())
    })
}

/// The root of a vertex, halving the path on the way.
fn root(parents: &mut Paged<u32>, mut v: u32) -> Result<u32> {
    loop {
        let parent = parents.get(u64::from(v))?;
        if parent == v {
            return Ok(v);
        }
        let above = parents.get(u64::from(parent))?;
        if above == parent {
            return Ok(parent);
        }
        parents.set(u64::from(v), above)?;
        v = above;
    }
}

/// Turns parents into component numbers, and returns how many there are.
fn number_components(parents: &mut Paged<u32>) -> Result<u64> {
    let mut count = 0;
    for v in 0..parents.len() {
        let parent = u64::from(parents.get(v)?);
        let number = if parent == v { count } else { parents.get(parent)? };
        count += u32::from(parent == v);
        parents.set(v, number)?;
    }
    Ok(u64::from(count))
}

fn measure_vertices(
    surface: &StoredSurface,
    labels: &mut Paged<u32>,
    records: &mut Paged<Record>,
    positions: &mut Paged<[f32; 3]>,
) -> Result<()> {
    let mut number = 0;
    surface.vertices(&mut |batch| {
        for v in batch {
            records.change(u64::from(labels.get(number)?))?.add_vertex(v);
            positions.set(number, v.position)?;
            number += 1;
        }
        Ok(())
    })
}

fn measure_triangles(
    surface: &StoredSurface,
    labels: &mut Paged<u32>,
    records: &mut Paged<Record>,
    positions: &mut Paged<[f32; 3]>,
) -> Result<()> {
    each_triangle(surface, |t| {
        let mut corners = [[0.0; 3]; 3];
        for (corner, v) in corners.iter_mut().zip(t) {
            *corner = positions.get(u64::from(v))?;
        }
        records.change(u64::from(labels.get(u64::from(t[0]))?))?.add_triangle(t, corners);
        Ok(())
    })
}

/// The largest of what is offered: by triangles, of equal ones the first.
struct Largest {
    most: usize,
    heap: BinaryHeap<Reverse<(u64, Reverse<u64>)>>,
}

impl Largest {
    fn new(most: u64) -> Self {
        Self { most: most as usize, heap: BinaryHeap::new() }
    }

    fn offer(&mut self, triangles: u64, number: u64) {
        self.heap.push(Reverse((triangles, Reverse(number))));
        if self.heap.len() > self.most {
            self.heap.pop();
        }
    }

    /// Their numbers, the largest first.
    fn into_numbers(self) -> impl Iterator<Item = u64> {
        self.heap.into_sorted_vec().into_iter().map(|Reverse((_, Reverse(number)))| number)
    }
}

/// Marks what is kept; also returns what is listed of it, and whether it is all there is, vertices
/// without a triangle included.
fn choose(
    records: &mut Paged<Record>,
    filter: &ComponentFilter,
    memory: u64,
) -> Result<(ComponentReport, Largest, bool)> {
    let wanted = filter.largest.unwrap_or(u64::MAX).min(records.len());
    let chosen = filter.largest.is_some() && wanted < records.len();
    if chosen && wanted.saturating_mul(CHOICE) > memory {
        let purpose = format!("for the {wanted} largest components");
        return Err(Error::memory(purpose, wanted.saturating_mul(CHOICE), memory));
    }
    let mut report = ComponentReport::default();
    let mut largest = Largest::new(wanted);
    for number in 0..records.len() {
        let record = records.change(number)?;
        report.found += u64::from(record.triangles > 0);
        let accepted = record.triangles >= filter.min_triangles.max(1)
            && (filter.min_volume <= 0.0 || record.volume().abs() >= filter.min_volume);
        record.kept = u32::from(accepted && !chosen);
        if accepted && chosen {
            largest.offer(record.triangles, number);
        }
    }
    for number in largest.into_numbers() {
        records.change(number)?.kept = 1;
    }
    let mut listed = Largest::new(MOST_LISTED);
    for number in 0..records.len() {
        let record = records.get(number)?;
        if record.kept == 1 {
            report.kept += 1;
            listed.offer(record.triangles, number);
        }
    }
    let all = report.kept == records.len();
    Ok((report, listed, all))
}

/// A new surface of the kept components. Spoils the labels.
fn copy_kept(
    surface: &StoredSurface,
    labels: &mut Paged<u32>,
    records: &mut Paged<Record>,
    settings: &BuilderSettings,
) -> Result<StoredSurface> {
    const LEFT_OUT: u32 = u32::MAX;
    let mut out = StoredSurface::like(surface, settings);
    let mut number = 0;
    surface.vertices(&mut |batch| {
        for v in batch {
            let kept = records.get(u64::from(labels.get(number)?))?.kept == 1;
            let new = if kept { out.vertex_count() as u32 } else { LEFT_OUT };
            labels.set(number, new)?;
            if kept {
                out.push_vertex(*v)?;
            }
            number += 1;
        }
        Ok(())
    })?;
    each_triangle(surface, |[a, b, c]| {
        let a = labels.get(u64::from(a))?;
        if a != LEFT_OUT {
            out.push_triangle([a, labels.get(u64::from(b))?, labels.get(u64::from(c))?])?;
        }
        Ok(())
    })?;
    Ok(out)
}

#[cfg(test)]
mod tests;
