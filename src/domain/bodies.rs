//! The bodies of a mesh: tetrahedra that are connected by common faces.
//!
//! Parts of a mesh may touch, slide along each other or overlap without sharing vertices; between
//! them the field is free to jump, and no surface belongs there. So the body of a tetrahedron
//! counts: a tetrahedron of the reduction with corners in two bodies is outside of the mesh.
//!
//! # How does it work?
//!
//! Union-find over the tetrahedra, in a paged array: the faces come sorted, so the two tetrahedra
//! of a face follow each other. Of two roots the lower one stays, so one ascending pass turns
//! parents into body numbers; bodies are numbered by their first tetrahedron in the file. Then the
//! tetrahedra are put in the order of bodies (an external sort of their numbers, unless they are in
//! it already): a body is a range of tetrahedra, and of several tetrahedra that hold a point the
//! lowest is one of the **first body**. That is the rule for points in overlapping bodies.
//!
//! Reference: Tarjan 1975, "Efficiency of a good but not linear set union algorithm".

use super::column::{Column, ColumnWriter};
use super::settings::StoreSettings;
use isospan_io::bytes::paged::Paged;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::error::Result;

/// Which tetrahedra have a face in common, while that is found out.
pub(super) struct Unions {
    /// How far below each tetrahedron its parent is; 0 of a root.
    below: Paged<u64>,
}

impl Unions {
    pub(super) fn new(tets: u64, settings: &StoreSettings) -> Self {
        Self { below: Paged::new(tets, settings.memory, &settings.scratch) }
    }

    /// Two tetrahedra have a common face.
    pub(super) fn join(&mut self, a: u64, b: u64) -> Result<()> {
        let (a, b) = (self.root(a)?, self.root(b)?);
        let (low, high) = (a.min(b), a.max(b));
        if low < high { self.below.set(high, high - low) } else { Ok(()) }
    }

    /// The root of a tetrahedron, halving the path on the way.
    fn root(&mut self, mut t: u64) -> Result<u64> {
        loop {
            let parent = t - self.below.get(t)?;
            let above = parent - self.below.get(parent)?;
            if above == parent {
                return Ok(parent);
            }
            self.below.set(t, t - above)?;
            t = above;
        }
    }

    /// Numbers the bodies.
    pub(super) fn finish(mut self) -> Result<BodyOf> {
        let (mut bodies, mut last, mut in_order) = (0, 0, true);
        for t in 0..self.below.len() {
            let below = self.below.get(t)?;
            let body = if below == 0 { bodies } else { self.below.get(t - below)? };
            bodies += u64::from(below == 0);
            in_order &= last <= body;
            last = body;
            self.below.set(t, body)?;
        }
        Ok(BodyOf { body: self.below, bodies, in_order })
    }
}

/// The body of each tetrahedron.
pub(super) struct BodyOf {
    body: Paged<u64>,
    pub(super) bodies: u64,
    /// Whether the tetrahedra of each body follow each other.
    in_order: bool,
}

impl BodyOf {
    pub(super) fn get(&mut self, tet: u64) -> Result<u64> {
        self.body.get(tet)
    }

    /// The tetrahedra in the order of bodies, and where each body begins.
    pub(super) fn arrange(
        mut self,
        tets: Column<[u64; 4]>,
        settings: &StoreSettings,
    ) -> Result<(Column<[u64; 4]>, Bodies)> {
        let mut starts = ColumnWriter::new(&settings.scratch)?;
        if self.in_order {
            for t in 0..self.body.len() {
                if self.body.get(t)? == starts.len() {
                    starts.push(&t)?;
                }
            }
            return Ok((tets, Bodies { starts: starts.finish()? }));
        }
        let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
        let mut order: Sorter<[u64; 2]> = Sorter::new(memory, &settings.scratch);
        for t in 0..self.body.len() {
            order.push([self.body.get(t)?, t])?;
        }
        let (mut sorted, mut arranged) = (order.finish()?, ColumnWriter::new(&settings.scratch)?);
        let tets = tets.get()?;
        while let Some([body, t]) = sorted.next()? {
            if body == starts.len() {
                starts.push(&arranged.len())?;
            }
            arranged.push(&tets[t as usize])?;
        }
        Ok((arranged.finish()?, Bodies { starts: starts.finish()? }))
    }
}

/// The bodies, each a range of tetrahedra.
pub(crate) struct Bodies {
    /// The first tetrahedron of each.
    starts: Column<u64>,
}

impl Bodies {
    /// The body of a tetrahedron.
    pub(crate) fn of(&self, tet: u64) -> Result<u64> {
        Ok(self.starts.get()?.partition_point(|&first| first <= tet) as u64 - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::settings::BadValue;
    use isospan_io::exec::CancelToken;

    #[test]
    fn bodies_are_numbered_by_their_first_tetrahedron_and_follow_each_other() {
        let (scratch, cancel) = (tempfile::tempdir().unwrap(), CancelToken::new());
        for memory in [0, 1 << 20] {
            let settings = StoreSettings {
                memory,
                scratch: scratch.path().to_path_buf(),
                bad_value: BadValue::Refuse,
                missing: None,
                offset: 0.0,
                cancel: cancel.clone(),
            };
            // Three bodies by the remainder of 3, chained back to front; and one alone.
            let count = 20_000;
            let mut unions = Unions::new(count + 1, &settings);
            for t in (3..count).rev() {
                unions.join(t, t - 3).unwrap();
            }
            let mut of = unions.finish().unwrap();
            assert_eq!(of.bodies, 4);
            assert!((0..count).all(|t| of.get(t).unwrap() == t % 3) && of.get(count).unwrap() == 3);
            let mut tets = ColumnWriter::new(scratch.path()).unwrap();
            (0..=count).for_each(|t| tets.push(&[t; 4]).unwrap());
            let (tets, bodies) = of.arrange(tets.finish().unwrap(), &settings).unwrap();
            let tets = tets.get().unwrap();
            assert!(tets.is_sorted_by_key(|t| if t[0] == count { (3, t[0]) } else { (t[0] % 3, t[0]) }));
            for (i, t) in tets.iter().enumerate() {
                assert_eq!(bodies.of(i as u64).unwrap(), if t[0] == count { 3 } else { t[0] % 3 });
            }
        }
    }
}
