//! The parts of a surface one after another: the vertices of each, then its triangles.
//!
//! A source hands out the vertices of all parts, then all triangles. So positions wait in a store,
//! 12 bytes each, and on disk beyond its memory; then one walk over the triangles has both.

use super::SurfaceMeta;
use crate::surface::SurfaceSource;
use crate::surface::weld::BuilderSettings;
use isospan_io::bytes::store::Store;
use isospan_io::error::{Error, Result};
use std::io::{self, ErrorKind};
use std::path::Path;

/// Vertices that are handed out at a time.
const BATCH: u64 = 1 << 14;

/// A part of a surface.
pub(in crate::files) struct PartRange {
    /// Its place among all parts of the surface.
    pub(in crate::files) number: usize,
    pub(in crate::files) name: String,
    /// Its first vertex.
    pub(in crate::files) first: u64,
    pub(in crate::files) vertices: u64,
    pub(in crate::files) triangles: u64,
}

/// Takes parts: for each `begin`, vertices, `between`, triangles, `end`.
pub(in crate::files) trait TakeParts {
    fn begin(&mut self, part: &PartRange) -> Result<()>;
    /// Positions of the next vertices.
    fn vertices(&mut self, positions: &[[f32; 3]]) -> Result<()>;
    fn between(&mut self) -> Result<()> {
        Ok(())
    }
    /// The next triangles; a part has numbers of its own vertices.
    fn triangles(&mut self, part: &PartRange, triangles: &[[u32; 3]]) -> Result<()>;
    fn end(&mut self) -> Result<()>;
}

/// The parts of a surface that have triangles; a surface of one kind is one part.
pub(in crate::files) fn parts_of(source: &dyn SurfaceSource, meta: &SurfaceMeta) -> Vec<PartRange> {
    let (vertices, triangles) = (source.vertex_count(), source.triangle_count());
    if meta.parts.is_empty() {
        let name = meta.isovalue.map_or_else(|| "surface".to_owned(), |v| format!("isovalue {v}"));
        let one = PartRange { number: 0, name, first: 0, vertices, triangles };
        return if triangles > 0 { vec![one] } else { vec![] };
    }
    let mut sum = 0;
    let part = |(number, part): (usize, &super::SurfacePart)| {
        let first = sum;
        sum += part.vertices;
        let (vertices, triangles) = (part.vertices, part.triangles);
        PartRange { number, name: part.name(), first, vertices, triangles }
    };
    meta.parts.iter().enumerate().map(part).filter(|part| part.triangles > 0).collect()
}

/// Hands parts to `take`. Vertices wait as `scratch` says; errors name `target`.
pub(in crate::files) fn each_part(
    source: &dyn SurfaceSource,
    parts: &[PartRange],
    scratch: &BuilderSettings,
    target: &Path,
    take: &mut dyn TakeParts,
) -> Result<()> {
    let mut positions = Store::new(scratch.memory_bytes, &scratch.scratch);
    source.vertices(&mut |batch| batch.iter().try_for_each(|v| positions.push(v.position)))?;
    let mut walk = Walk { positions: &positions, rest: parts.iter(), open: None, target, take };
    if positions.len() != source.vertex_count() {
        let announced = source.vertex_count();
        return Err(walk.broken(format!("{} vertices instead of the {announced} announced", positions.len())));
    }
    source.triangles(&mut |batch| walk.add(batch))?;
    walk.finish()
}

/// A walk over the triangles.
struct Walk<'a> {
    positions: &'a Store<[f32; 3]>,
    rest: std::slice::Iter<'a, PartRange>,
    /// The part whose triangles come, and how many are still to come.
    open: Option<(&'a PartRange, u64)>,
    target: &'a Path,
    take: &'a mut dyn TakeParts,
}

impl<'a> Walk<'a> {
    fn broken(&self, what: String) -> Error {
        Error::io("write", self.target, io::Error::new(ErrorKind::InvalidData, what))
    }

    fn add(&mut self, mut triangles: &[[u32; 3]]) -> Result<()> {
        while !triangles.is_empty() {
            let (part, left) = match self.open {
                Some((part, left)) if left > 0 => (part, left),
                _ => self.next()?,
            };
            let now = left.min(triangles.len() as u64);
            let (here, later) = triangles.split_at(now as usize);
            let local: Vec<[u32; 3]> = here.iter().map(|t| self.local(part, t)).collect::<Result<_>>()?;
            self.take.triangles(part, &local)?;
            (self.open, triangles) = (Some((part, left - now)), later);
        }
        Ok(())
    }

    /// A triangle with the numbers of a part's own vertices.
    fn local(&self, part: &PartRange, triangle: &[u32; 3]) -> Result<[u32; 3]> {
        let own = triangle.map(|v| u64::from(v).checked_sub(part.first).filter(|&v| v < part.vertices));
        match own {
            [Some(a), Some(b), Some(c)] => Ok([a, b, c].map(|v| v as u32)),
            _ => {
                let (first, end) = (part.first, part.first + part.vertices);
                Err(self.broken(format!("triangle {triangle:?} of a part of the vertices {first} to {end}")))
            }
        }
    }

    /// Ends a part and begins the next one.
    fn next(&mut self) -> Result<(&'a PartRange, u64)> {
        if self.open.take().is_some() {
            self.take.end()?;
        }
        let Some(part) = self.rest.next() else {
            return Err(self.broken("more triangles than announced".into()));
        };
        let end = part.first + part.vertices;
        if end > self.positions.len() {
            return Err(self.broken(format!("a part up to vertex {end} of {}", self.positions.len())));
        }
        self.take.begin(part)?;
        let (mut first, mut some) = (part.first, vec![]);
        while first < end {
            some.resize((end - first).min(BATCH) as usize, [0.0; 3]);
            self.positions.read_from(first, &mut some)?;
            self.take.vertices(&some)?;
            first += some.len() as u64;
        }
        self.take.between()?;
        Ok((part, part.triangles))
    }

    fn finish(mut self) -> Result<()> {
        let left = self.open.map_or(0, |(_, left)| left);
        let missing = left + self.rest.clone().map(|part| part.triangles).sum::<u64>();
        if missing > 0 {
            return Err(self.broken(format!("{missing} triangles fewer than announced")));
        }
        match self.open.take() {
            Some(_) => self.take.end(),
            None => Ok(()),
        }
    }
}
