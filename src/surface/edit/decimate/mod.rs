//! Fewer triangles for nearly the same surface, within a given memory.
//!
//! # How does it work?
//!
//! A surface is taken in *patches* of 65 536 triangles, as they follow one another: those of a few
//! neighbouring blocks of the mesh. Patches are decimated side by side (`collapse.rs`), each with
//! the vertices fixed that others use, and written in order. So seams stay as dense as they were.
//! The next pass shifts the patches by half, and what was a seam lies inside:
//!
//! ```text
//!  pass 1   ├───────────┼───────────┼───────────┼────       ┼ seam, kept as it is
//!  pass 2   ├─────┼───────────┼───────────┼──────────
//! ```
//!
//! The first of several passes goes half of the way only, so that seams get their turn. Passes go
//! on until the goal is reached, or one of them takes away less than 3 %, at most 12.
//!
//! # Guarantees
//! * Components, genus and boundaries stay what they are, an oriented manifold stays one; vertices
//!   on a boundary do not move.
//! * A vertex on a face of the domain stays on it: caps stay plane, and end where they did.
//! * The bytes are a function of the surface and the goal: patches are a number of triangles, not
//!   of bytes, so neither threads nor memory show.
//! * With `max_error`, no vertex's estimate exceeds it: the estimates of a vertex are handed on
//!   from pass to pass. It is an estimate (see `collapse.rs`): what it is in truth was measured,
//!   not proven. Triangles are not kept from intersecting.
//!
//! # Cost
//! O(n log n) time; [`Decimation::least_memory`], and beyond that as many patches at a time as
//! memory allows.

use super::collapse::{BYTES_PER_TRIANGLE, Goal, Patch, collapse_edges};
use super::faces::Faces;
use crate::surface::model::{SurfaceSource, Vertex};
use crate::surface::weld::{BuilderSettings, StoredSurface};
use isospan_io::bytes::paged::Paged;
use isospan_io::bytes::store::{Cached, Store};
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;

/// Triangles of a patch.
const PATCH: u64 = 1 << 16;
const MOST_PASSES: u32 = 12;
/// A pass that keeps more than this part of the triangles is the last.
const TOO_LITTLE: f64 = 0.97;

/// How far a surface is decimated: until one of the two is reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decimation {
    /// The part of the triangles to keep: 0.1 for a tenth. 0: as few as `max_error` and the
    /// topology allow.
    pub ratio: f64,
    /// The largest estimated distance from the original surface, in world units; no bound.
    pub max_error: f64,
}

impl Default for Decimation {
    fn default() -> Self {
        Self { ratio: 0.0, max_error: f64::INFINITY }
    }
}

impl Decimation {
    /// Whether the numbers make sense.
    ///
    /// # Errors
    /// [`Error::Usage`] when not.
    pub fn check(&self) -> Result<()> {
        if !(0.0..=1.0).contains(&self.ratio) {
            return Err(Error::usage(format!(
                "the share of the triangles to keep is from 0 to 1, not {}{}",
                self.ratio,
                if (1.0..=100.0).contains(&self.ratio) {
                    format!("; {} % is written {}%", self.ratio, self.ratio)
                } else {
                    String::new()
                }
            )));
        }
        if self.max_error.is_nan() || self.max_error < 0.0 {
            return Err(Error::usage("the largest error of a decimation must be a number, and not negative"));
        }
        Ok(())
    }

    /// The least memory in which a surface of this many triangles is decimated.
    pub fn least_memory(triangles: u64) -> u64 {
        2 * patch_bytes(triangles)
    }
}

/// Memory for a patch of a surface of this many triangles: its working data, its triangles and
/// vertices before.
fn patch_bytes(triangles: u64) -> u64 {
    triangles.min(PATCH) * BYTES_PER_TRIANGLE
}

/// What a decimation did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DecimationReport {
    /// Triangles before.
    pub triangles_before: u64,
    /// Triangles after.
    pub triangles_after: u64,
    /// Passes over the surface.
    pub passes: u32,
    /// The largest of the vertices' estimated distances from the original surface, in world units:
    /// sums of distances to the planes of replaced triangles. It is no bound.
    pub error_estimate: f64,
}

/// Decimates a surface; vertices on the faces stay on them. Uses the threads of the pool that it is
/// called in.
///
/// # Errors
/// [`Error::Usage`] for a goal that makes no sense; [`Error::Budget`] below
/// [`Decimation::least_memory`]; [`Error::Cancelled`]; [`Error::Io`] for the scratch folder.
pub fn decimate(
    surface: StoredSurface,
    goal: &Decimation,
    faces: &Faces,
    settings: &BuilderSettings,
    cancel: &CancelToken,
) -> Result<(StoredSurface, DecimationReport)> {
    goal.check()?;
    let (before, memory) = (surface.triangle_count(), settings.memory_bytes as u64);
    let least = Decimation::least_memory(before);
    if memory < least {
        return Err(Error::memory("to decimate", least, memory));
    }
    let wanted = (before as f64 * goal.ratio).ceil() as u64;
    let mut now = Rated { surface, errors: None };
    let mut passes = 0;
    while passes < MOST_PASSES && now.surface.triangle_count() > wanted {
        let count = now.surface.triangle_count();
        // Seams get their turn in the second pass.
        let first_of_several = passes == 0 && count > PATCH;
        let target = if first_of_several { wanted.midpoint(count) } else { wanted };
        let pass = Pass {
            shift: if passes % 2 == 0 { 0 } else { PATCH / 2 },
            keep: target as f64 / count as f64,
            max_error: goal.max_error,
            at_a_time: (memory / 2 / patch_bytes(before)).max(1) as usize,
            // A quarter for all that is read and written at random.
            records: memory / 16,
            scratch: &settings.scratch,
            faces,
            cancel,
        };
        now = pass.run(&now)?;
        passes += 1;
        if !first_of_several && now.surface.triangle_count() as f64 > TOO_LITTLE * count as f64 {
            break;
        }
    }
    let report = DecimationReport {
        triangles_before: before,
        triangles_after: now.surface.triangle_count(),
        passes,
        error_estimate: now.largest_error()?,
    };
    Ok((now.surface, report))
}

/// A surface with the estimated error of each vertex; none before the first pass.
struct Rated {
    surface: StoredSurface,
    errors: Option<Store<f32>>,
}

impl Rated {
    fn largest_error(&self) -> Result<f64> {
        let mut largest = 0.0f32;
        if let Some(errors) = &self.errors {
            errors.each(&mut |batch| {
                largest = batch.iter().copied().fold(largest, f32::max);
                Ok(())
            })?;
        }
        Ok(f64::from(largest))
    }
}

/// The only patch that uses a vertex, counted from 1; 0 before it is known.
type Owner = u32;
const SEVERAL: Owner = u32::MAX;

struct Pass<'a> {
    /// Triangles that are missing in the first patch.
    shift: u64,
    /// The part of its triangles that a patch keeps.
    keep: f64,
    max_error: f64,
    at_a_time: usize,
    /// Bytes for each of the arrays that are used at random.
    records: u64,
    scratch: &'a Path,
    faces: &'a Faces,
    cancel: &'a CancelToken,
}

/// A patch, and the numbers of its vertices in the surface that it is from.
struct NumberedPatch {
    patch: Patch,
    numbers: Vec<u32>,
}

impl Pass<'_> {
    fn run(&self, from: &Rated) -> Result<Rated> {
        let vertices = from.surface.vertex_count();
        let mut owners = Paged::<Owner>::new(vertices, self.records, self.scratch);
        self.each_patch(&from.surface, |number, triangles| {
            for &v in triangles.iter().flatten() {
                let owner = owners.change(u64::from(v))?;
                *owner = if *owner == 0 || *owner == number { number } else { SEVERAL };
            }
            Ok(())
        })?;
        let mut records = from.surface.random_vertices(self.records as usize);
        let mut errors = from.errors.as_ref().map(|e| Cached::new(e, self.records as usize));
        let mut out = Output {
            surface: StoredSurface::like(
                &from.surface,
                &BuilderSettings {
                    memory_bytes: 2 * self.records as usize,
                    scratch: self.scratch.to_path_buf(),
                },
            ),
            errors: Store::new(self.records as usize / 4, self.scratch),
            numbers: Paged::new(vertices, self.records, self.scratch),
        };
        let mut waiting: Vec<NumberedPatch> = vec![];
        self.each_patch(&from.surface, |_, triangles| {
            let mut numbers: Vec<u32> = triangles.iter().flatten().copied().collect();
            numbers.sort_unstable();
            numbers.dedup();
            let mut patch = Patch { triangles: triangles.to_vec(), ..Patch::default() };
            for &v in &numbers {
                let v = u64::from(v);
                patch.vertices.push(records.get(v)?);
                patch.on.push(self.faces.on(patch.vertices[patch.vertices.len() - 1].position));
                patch.errors.push(errors.as_mut().map_or(Ok(0.0), |e| e.get(v))?);
                patch.fixed.push(owners.get(v)? == SEVERAL);
            }
            let local = |v: u32| numbers.binary_search(&v).expect("all corners are listed") as u32;
            patch.triangles.iter_mut().for_each(|t| *t = t.map(local));
            waiting.push(NumberedPatch { patch, numbers });
            if waiting.len() == self.at_a_time { self.decimate(&mut waiting, &mut out) } else { Ok(()) }
        })?;
        self.decimate(&mut waiting, &mut out)?;
        Ok(Rated { surface: out.surface, errors: Some(out.errors) })
    }

    /// Hands the triangles of each patch, and its number from 1.
    fn each_patch(
        &self,
        surface: &StoredSurface,
        mut each: impl FnMut(u32, &[[u32; 3]]) -> Result<()>,
    ) -> Result<()> {
        let (mut patch, mut number, mut room) = (vec![], 1, PATCH - self.shift);
        surface.triangles(&mut |mut batch| {
            while !batch.is_empty() {
                let (these, rest) = batch.split_at(batch.len().min(room as usize));
                patch.extend_from_slice(these);
                room -= these.len() as u64;
                batch = rest;
                if room == 0 {
                    each(number, &patch)?;
                    patch.clear();
                    (number, room) = (number + 1, PATCH);
                }
            }
            Ok(())
        })?;
        if patch.is_empty() { Ok(()) } else { each(number, &patch) }
    }

    fn decimate(&self, waiting: &mut Vec<NumberedPatch>, out: &mut Output) -> Result<()> {
        self.cancel.check()?;
        waiting.par_iter_mut().for_each(|p| {
            let triangles = (p.patch.triangles.len() as f64 * self.keep).ceil() as usize;
            collapse_edges(&mut p.patch, self.faces, Goal { triangles, error: self.max_error });
        });
        waiting.drain(..).try_for_each(|p| out.append(&p))
    }
}

/// A surface that patches are appended to.
struct Output {
    surface: StoredSurface,
    errors: Store<f32>,
    /// New numbers, from 1, of vertices that several patches use; 0 before the first of them.
    numbers: Paged<u32>,
}

impl Output {
    fn append(&mut self, p: &NumberedPatch) -> Result<()> {
        const NONE: u32 = u32::MAX;
        let mut new = vec![NONE; p.numbers.len()];
        for t in &p.patch.triangles {
            for v in t.map(|v| v as usize).into_iter().filter(|&v| p.patch.fixed[v]) {
                if new[v] == NONE {
                    // 0 becomes the NONE that it stands for.
                    new[v] = self.numbers.get(u64::from(p.numbers[v]))?.wrapping_sub(1);
                }
            }
            for v in t.map(|v| v as usize) {
                if new[v] == NONE {
                    new[v] = self.push(&p.patch.vertices[v], p.patch.errors[v])?;
                    if p.patch.fixed[v] {
                        self.numbers.set(u64::from(p.numbers[v]), new[v] + 1)?;
                    }
                }
            }
            self.surface.push_triangle(t.map(|v| new[v as usize]))?;
        }
        Ok(())
    }

    fn push(&mut self, vertex: &Vertex, error: f32) -> Result<u32> {
        let number = self.surface.vertex_count() as u32;
        self.surface.push_vertex(*vertex)?;
        self.errors.push(error)?;
        Ok(number)
    }
}

#[cfg(test)]
mod tests;
