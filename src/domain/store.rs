//! The files of a mesh: positions, values, tetrahedra, boundary triangles.

use super::bodies::{Bodies, BodyOf, Unions};
use super::column::{Column, ColumnWriter};
use super::creases::Creases;
use super::frame::{Bounds, MeshFrame};
use super::identity::{Identity, IdentityHash};
use super::merge::Firsts;
use super::middles::{Added, Splitter};
use super::settings::{BadValue, StoreSettings};
use isospan_io::bytes::sorter::Sorter;
use isospan_io::cells::average::Replace;
use isospan_io::cells::{CellBlock, CellKind, CellMesh, CellTet, split};
use isospan_io::error::{Error, Result};
use isospan_io::geom::LatticePos;
use isospan_io::geom::curve::hilbert_key;
use isospan_mesh::locate::{CellBatch, FINE_BITS, FinePos, volume6};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

/// What was found in a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeshCensus {
    /// Points of the file.
    pub vertices: u64,
    /// Points that were added: in the middle of polyhedra and of their faces of more than four
    /// points, and of quadratic cells and their faces.
    pub added: u64,
    /// Cells with a volume.
    pub cells: u64,
    /// Tetrahedra that they were split into, those without a volume left out.
    pub tetrahedra: u64,
    /// Of these, tetrahedra whose corners the file lists in the opposite order.
    pub inverted: u64,
    /// Tetrahedra that were left out: flat, or with a vertex twice.
    pub degenerate: u64,
    /// Tetrahedra that were left out, because they lie on the same side of a face as a neighbour:
    /// of two, the one that is turned otherwise than most, or the smaller one.
    #[serde(default, skip_serializing_if = "is_none")]
    pub folded: u64,
    /// Triangles of the boundary.
    pub boundary_triangles: u64,
    /// Cells that were left out as ghosts: marked as copies of another piece's cells, or as hidden.
    pub ghosts: u64,
    /// Points that have position and value of an earlier one, and were taken for that.
    pub repeated: u64,
    /// Bodies: tetrahedra that hang together by common faces.
    pub bodies: u64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde wants a reference")]
fn is_none(count: &u64) -> bool {
    *count == 0
}

/// A mesh on disk.
pub(crate) struct CellStore {
    pub(crate) frame: MeshFrame,
    pub(crate) census: MeshCensus,
    /// Those of the file's points, then of those that were added.
    pub(crate) positions: Column<FinePos>,
    pub(crate) values: Column<f32>,
    /// Vertices of each tetrahedron, positively oriented, body after body.
    pub(crate) tets: Column<[u64; 4]>,
    pub(crate) bodies: Bodies,
    /// Triangles of the boundary, along a space-filling curve: three vertices, counter-clockwise
    /// seen from outside, and the body.
    pub(crate) boundary: Column<[u64; 4]>,
    /// Where the boundary bends.
    pub(super) creases: Creases,
    /// Vertices that are one.
    pub(crate) firsts: Arc<Firsts>,
    /// What cells add.
    added: Option<Added>,
    pub(crate) identity: Identity,
    /// Six times the volume of all tetrahedra, in fine steps.
    pub(crate) volume6: i128,
}

impl CellStore {
    /// Reads a mesh.
    ///
    /// # Errors
    /// When it cannot be read, has no volume, or the scratch folder cannot be written.
    pub(crate) fn build(mesh: &CellMesh, settings: &StoreSettings) -> Result<Self> {
        Self::build_with(mesh, None, settings)
    }

    /// As [`CellStore::build`]. If `known` is given, it says which vertices of the mesh are one.
    ///
    /// # Errors
    /// Errors of [`CellStore::build`].
    pub(crate) fn build_with(
        mesh: &CellMesh,
        known: Option<Firsts>,
        settings: &StoreSettings,
    ) -> Result<Self> {
        let known = known.map(Arc::new);
        // Where quadratic cells reach beyond the points is known when they are met.
        match Self::build_around(mesh, known.clone(), None, settings)? {
            ControlFlow::Continue(store) => Ok(store),
            ControlFlow::Break(beyond) => match Self::build_around(mesh, known, Some(beyond), settings)? {
                ControlFlow::Continue(store) => Ok(store),
                ControlFlow::Break(_) => unreachable!("what cells add was within the box"),
            },
        }
    }

    /// Builds the store in a box that also holds `beyond`, where what cells add lies; breaks with
    /// that box, if it is needed and not known.
    fn build_around(
        mesh: &CellMesh,
        known: Option<Arc<Firsts>>,
        beyond: Option<Bounds>,
        settings: &StoreSettings,
    ) -> Result<ControlFlow<Bounds, Self>> {
        let (frame, positions, mut identity) = place_points(mesh, beyond.as_ref(), settings)?;
        let (firsts, values) = read_known_values(mesh, known, positions.get()?, settings)?;
        let vertices = positions.get()?.len() as u64;
        let look = || Added::new(mesh, positions.get()?, &firsts, settings);
        let added = if beyond.is_some() || mesh.may_have_polyhedra()? { look()? } else { None };
        let (positions, values) = match &added {
            Some(added) => {
                let all = added.positions(positions.get()?, settings)?;
                if beyond.is_none() && added.may_lie_outside() {
                    return Ok(ControlFlow::Break(frame.beyond(all.get()?)));
                }
                (frame.clamped(all, settings)?, added.values(values.get()?, settings)?)
            }
            None => (positions, values),
        };
        let mut sink = TetSink::new(settings)?;
        if !sink.read(mesh, positions.get()?, &firsts, added.as_ref(), settings, &mut identity)? {
            let added = Added::new(mesh, positions.get()?, &firsts, settings)?;
            let added = added.expect("a cell that needs vertices was met");
            let all = added.positions(positions.get()?, settings)?;
            return Ok(ControlFlow::Break(frame.beyond(all.get()?)));
        }
        sink.census.vertices = vertices;
        sink.census.added = added.as_ref().map_or(Ok(0), Added::count)?;
        sink.census.repeated = firsts.repeated;
        sink.refuse_none(&mesh.info().path)?;
        let (sink, boundary, body_of) = sink.without_folds(positions.get()?, settings)?;
        let creases = Creases::new(&boundary, positions.get()?, settings)?;
        let boundary_triangles = boundary.get()?.len() as u64;
        let census = MeshCensus { boundary_triangles, bodies: body_of.bodies, ..sink.census };
        let (tets, bodies) = body_of.arrange(sink.tets.finish()?, settings)?;
        Ok(ControlFlow::Continue(Self {
            frame,
            census,
            positions,
            values,
            tets,
            bodies,
            boundary,
            creases,
            firsts,
            added,
            identity: identity.finish(),
            volume6: sink.volume6,
        }))
    }

    /// The values of another step on the same mesh: `mesh` with its field.
    ///
    /// # Errors
    /// When they cannot be read, or differ at vertices that are one in this store.
    pub(crate) fn values_of(&self, mesh: &CellMesh, settings: &StoreSettings) -> Result<Column<f32>> {
        let column = read_values(mesh, Some(&self.firsts), settings)?;
        let values = column.get()?;
        for (v, value) in values.iter().enumerate() {
            let mut first = [v as u64];
            self.firsts.replace(&mut first)?;
            let other = values[first[0] as usize];
            if *value != other && !(value.is_nan() && other.is_nan()) {
                let at = format!("{}, points {} and {v}", mesh.field()?.name, first[0]);
                let in_file = |v| settings.offset + f64::from(v);
                let expected = "one value, as they lie in one place and had one value at the first step";
                return Err(Error::bad_input(
                    &mesh.info().path,
                    at,
                    expected,
                    format!("{} and {}", in_file(other), in_file(*value)),
                ));
            }
        }
        if let Some(added) = &self.added {
            return added.values(values, settings);
        }
        Ok(column)
    }

    /// Puts tetrahedra into a batch, in place of what was there.
    pub(super) fn fill(&self, batch: &mut CellBatch, tets: impl Iterator<Item = u64>) -> Result<()> {
        let (positions, all) = (self.positions.get()?, self.tets.get()?);
        batch.clear();
        for tet in tets {
            let first = batch.positions.len() as u32;
            batch.positions.extend(all[tet as usize].map(|v| positions[v as usize]));
            batch.corners.push([first, first + 1, first + 2, first + 3]);
            batch.ids.push(tet);
        }
        Ok(())
    }

    /// The part of the box that the mesh fills.
    pub(crate) fn filled(&self) -> f64 {
        let max = self.frame.lattice.max();
        let whole = max.iter().map(|&m| f64::from(m) * f64::from(1u32 << FINE_BITS)).product::<f64>();
        self.volume6 as f64 / (6.0 * whole)
    }
}

/// The box around a mesh, which also holds `beyond`, and its points on the fine lattice of that.
fn place_points(
    mesh: &CellMesh,
    beyond: Option<&Bounds>,
    settings: &StoreSettings,
) -> Result<(MeshFrame, Column<FinePos>, IdentityHash)> {
    let mut identity = IdentityHash::default();
    let (world, bounds) = read_points(mesh, settings, &mut identity)?;
    let bounds = beyond.map_or(bounds, |beyond| bounds.join(beyond));
    let frame = MeshFrame::around(&mesh.info().path, &bounds, world.get()?.len() as u64)?;
    let mut positions = ColumnWriter::new(&settings.scratch)?;
    for &p in world.get()? {
        positions.push(&frame.fine(p))?;
    }
    Ok((frame, positions.finish()?, identity))
}

/// The values of all points, and which points are one. `known` says which are, if it is given.
fn read_known_values(
    mesh: &CellMesh,
    known: Option<Arc<Firsts>>,
    positions: &[FinePos],
    settings: &StoreSettings,
) -> Result<(Arc<Firsts>, Column<f32>)> {
    if known.is_none() && !mesh.averages_places() {
        let values = read_values(mesh, None, settings)?;
        return Ok((Arc::new(Firsts::new(positions, Some(values.get()?), settings)?), values));
    }
    let new = || Firsts::new(positions, None, settings).map(Arc::new);
    let firsts = known.map_or_else(new, Ok)?;
    let values = read_values(mesh, Some(&firsts), settings)?;
    Ok((firsts, values))
}

fn read_points(
    mesh: &CellMesh,
    settings: &StoreSettings,
    identity: &mut IdentityHash,
) -> Result<(Column<[f64; 3]>, Bounds)> {
    let (mut out, mut bounds) = (ColumnWriter::new(&settings.scratch)?, Bounds::NONE);
    let (mut points, mut block) = (mesh.points()?, vec![]);
    while points.next_block(&mut block)? {
        settings.cancel.check()?;
        identity.add_points(&block);
        for p in &block {
            bounds.add(*p);
            out.push(p)?;
        }
    }
    Ok((out.finish()?, bounds))
}

/// The values of all points. Cell data are averaged over the cells around each place: around all
/// points that are one.
fn read_values(
    mesh: &CellMesh,
    firsts: Option<&Arc<Firsts>>,
    settings: &StoreSettings,
) -> Result<Column<f32>> {
    let mut out = ColumnWriter::new(&settings.scratch)?;
    let (wanted, has_offset) = (settings.missing, settings.offset != 0.0);
    // "-1e20", as a text says it, is no f32 that a file may have.
    let missing = move |v: f64| {
        let alike = |m: f64| m == v || f64::from(m as f32) == v || !has_offset && m as f32 == v as f32;
        wanted.is_some_and(alike)
    };
    let of_places = firsts.filter(|firsts| firsts.repeated > 0 && mesh.is_of_cells());
    let replace = of_places.map(|firsts| {
        let firsts = Arc::clone(firsts);
        Box::new(move |points: &mut [u64]| firsts.replace(points)) as Replace
    });
    let mut values = mesh.values_of_places(settings.memory, missing, replace)?;
    let first_of = |v: u64| {
        let mut first = [v];
        of_places.map_or(Ok(()), |firsts| firsts.replace(&mut first)).map(|()| first[0])
    };
    let mut block = vec![];
    while values.next_block(&mut block)? {
        settings.cancel.check()?;
        for &v in &block {
            if first_of(out.len())? != out.len() {
                out.push(&f32::NAN)?;
                continue;
            }
            let value = (v - settings.offset) as f32;
            let good = value.is_finite() && !missing(v);
            out.push(&match settings.bad_value {
                _ if good => value,
                BadValue::Void => f32::NAN,
                BadValue::Use(value) => value,
                BadValue::Refuse => {
                    let (path, at) =
                        (&mesh.info().path, format!("{}, point {}", mesh.field()?.name, out.len()));
                    return Err(Error::bad_input(path, at, "a finite value", v.to_string()).with_help(
                        "choose `nan=mask` (leave a hole there) or `nan=VALUE` (use a value instead)",
                    ));
                }
            })?;
        }
    }
    let means = out.finish()?;
    if of_places.is_none() {
        return Ok(means);
    }
    let (means, mut out) = (means.get()?, ColumnWriter::new(&settings.scratch)?);
    for v in 0..means.len() as u64 {
        out.push(&means[first_of(v)? as usize])?;
    }
    out.finish()
}

/// The faces of a positively oriented tetrahedron, counter-clockwise seen from outside.
const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Three vertices in ascending order, and whether that is an odd permutation.
fn ascending([a, b, c]: [u64; 3]) -> ([u64; 3], bool) {
    let odd = (a > b) ^ (a > c) ^ (b > c);
    let mut sorted = [a, b, c];
    sorted.sort_unstable();
    (sorted, odd)
}

/// Takes the tetrahedra that cells become.
struct TetSink {
    tets: ColumnWriter<[u64; 4]>,
    /// 1 for each that was turned over, else 0.
    turned: ColumnWriter<u8>,
    /// Vertices of all faces, ascending; twice the number of the tetrahedron, and one more where
    /// the vertices run clockwise seen from outside of it.
    faces: Sorter<[u64; 4]>,
    volume6: i128,
    census: MeshCensus,
}

impl TetSink {
    fn new(settings: &StoreSettings) -> Result<Self> {
        let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
        Ok(Self {
            tets: ColumnWriter::new(&settings.scratch)?,
            turned: ColumnWriter::new(&settings.scratch)?,
            faces: Sorter::new(memory, &settings.scratch),
            volume6: 0,
            census: MeshCensus::default(),
        })
    }

    /// Splits all cells. False if one needs vertices, and what cells add is not known.
    fn read(
        &mut self,
        mesh: &CellMesh,
        positions: &[FinePos],
        firsts: &Firsts,
        added: Option<&Added>,
        settings: &StoreSettings,
        identity: &mut IdentityHash,
    ) -> Result<bool> {
        let mut splitter = added.map(Splitter::new).transpose()?;
        let (mut cells, mut block, mut tets) = (mesh.cells()?, CellBlock::default(), vec![]);
        let mut replaced = vec![];
        while cells.next_block(&mut block)? {
            settings.cancel.check()?;
            identity.add_cells(&block);
            for (kind, vertices) in block.iter().filter(|(kind, _)| kind.is_solid()) {
                tets.clear();
                self.census.cells += 1;
                if kind == CellKind::Polyhedron {
                    let splitter = splitter.as_mut().expect("the mesh was looked through for polyhedra");
                    self.census.degenerate += splitter.split(vertices, positions, firsts, &mut tets)? as u64;
                    turn_outwards(&mut tets, positions);
                    tets.iter().try_for_each(|&tet| self.push(tet, positions))?;
                    continue;
                }
                replaced.clear();
                replaced.extend_from_slice(vertices);
                firsts.replace(&mut replaced)?;
                let dropped = match (kind.middles(), &mut splitter) {
                    (Some(middles), Some(splitter)) => {
                        splitter.split_quadratic(middles, &replaced, &mut tets)
                    }
                    (Some(_), None) => return Ok(false),
                    (None, _) => split(kind, &replaced, &mut tets),
                };
                self.census.degenerate += dropped as u64;
                tets.iter().try_for_each(|&tet| self.push(tet, positions))?;
            }
        }
        self.census.ghosts = cells.ghosts();
        Ok(true)
    }

    /// An error for a mesh without a tetrahedron.
    fn refuse_none(&self, path: &Path) -> Result<()> {
        let MeshCensus { cells, degenerate, tetrahedra, .. } = self.census;
        if tetrahedra > 0 {
            return Ok(());
        }
        let got = format!("{cells} cells with a volume, {degenerate} of them flat");
        Err(Error::bad_input(path, "cells", "at least one tetrahedron", got))
    }

    fn push(&mut self, mut tet: [u64; 4], positions: &[FinePos]) -> Result<()> {
        let volume = volume6(tet.map(|v| positions[v as usize]));
        if volume == 0 {
            self.census.degenerate += 1;
            return Ok(());
        }
        if volume < 0 {
            tet.swap(2, 3);
        }
        self.add(tet, volume.abs(), volume < 0)
    }

    /// Adds a tetrahedron that is turned as it must be.
    fn add(&mut self, tet: [u64; 4], volume: i128, was_turned: bool) -> Result<()> {
        self.census.inverted += u64::from(was_turned);
        self.volume6 += volume;
        self.census.tetrahedra += 1;
        for face in FACES {
            let ([a, b, c], odd) = ascending(face.map(|i| tet[i]));
            self.faces.push([a, b, c, self.tets.len() << 1 | u64::from(odd)])?;
        }
        self.turned.push(&u8::from(was_turned))?;
        self.tets.push(&tet)?;
        Ok(())
    }

    /// Leaves out tetrahedra that fold over others, of which surfaces would be turned both ways.
    /// Also the boundary, and the body of each tetrahedron that is left.
    fn without_folds(
        self,
        positions: &[FinePos],
        settings: &StoreSettings,
    ) -> Result<(Self, Column<[u64; 4]>, BodyOf)> {
        let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
        let count = self.tets.len();
        let mut folds: Sorter<[u64; 2]> = Sorter::new(memory, &settings.scratch);
        let (boundary, body_of) = boundary_of(self.faces, count, positions, settings, &mut folds)?;
        let mut folds = folds.finish()?;
        let mut next = folds.next()?;
        let empty = Self::new(settings)?;
        if next.is_none() {
            return Ok((Self { faces: empty.faces, ..self }, boundary, body_of));
        }
        let (tets, turned) = (self.tets.finish()?, self.turned.finish()?);
        let (tets, turned) = (tets.get()?, turned.get()?);
        let volume = |n: u64| volume6(tets[n as usize].map(|v| positions[v as usize]));
        let most = u8::from(2 * self.census.inverted > count);
        let is_odd = |n: u64| turned[n as usize] != most;
        let mut left_out: Sorter<[u64; 1]> = Sorter::new(memory, &settings.scratch);
        while let Some([a, b]) = next {
            let key = |n: u64| (!is_odd(n), volume(n), std::cmp::Reverse(n));
            left_out.push([if key(a) < key(b) { a } else { b }])?;
            next = folds.next()?;
        }
        let mut left_out = left_out.finish()?;
        let mut next = left_out.next()?;
        let census = MeshCensus { tetrahedra: 0, inverted: 0, ..self.census };
        let mut rest = Self { census, ..empty };
        for (n, tet) in (0..).zip(tets) {
            let mut is_left_out = false;
            while next == Some([n]) {
                is_left_out = true;
                next = left_out.next()?;
            }
            match is_left_out {
                true => rest.census.folded += 1,
                false => rest.add(*tet, volume(n), turned[n as usize] == 1)?,
            }
        }
        rest.without_folds(positions, settings)
    }
}

/// Turns the tetrahedra of a polyhedron over, whose faces may be listed as they are seen from
/// inside.
fn turn_outwards(tets: &mut [CellTet], positions: &[FinePos]) {
    let volumes = tets.iter().map(|tet| volume6(tet.map(|v| positions[v as usize])));
    if volumes.sum::<i128>() < 0 {
        tets.iter_mut().for_each(|tet| tet.swap(2, 3));
    }
}

/// The faces of one tetrahedron only, along a space-filling curve, each with its body; and the body
/// of each tetrahedron. Two tetrahedra on one side of a face go to `folds`.
fn boundary_of(
    faces: Sorter<[u64; 4]>,
    tets: u64,
    positions: &[FinePos],
    settings: &StoreSettings,
    folds: &mut Sorter<[u64; 2]>,
) -> Result<(Column<[u64; 4]>, BodyOf)> {
    let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
    let mut along: Sorter<[u64; 5]> = Sorter::new(memory, &settings.scratch);
    let mut unions = Unions::new(tets, settings);
    let mut sorted = faces.finish()?;
    let mut next = sorted.next()?;
    let mut others = vec![];
    while let Some(first) = next {
        others.clear();
        next = sorted.next()?;
        while let Some(face) = next.filter(|face| face[..3] == first[..3]) {
            unions.join(first[3] >> 1, face[3] >> 1)?;
            for before in others.iter().chain([&first[3]]).filter(|before| *before & 1 == face[3] & 1) {
                folds.push([before >> 1, face[3] >> 1])?;
            }
            others.push(face[3]);
            next = sorted.next()?;
        }
        if others.is_empty() {
            let [a, b, c, tet] = first;
            let [b, c] = if tet & 1 == 1 { [c, b] } else { [b, c] };
            along.push([hilbert_key(centre([a, b, c], positions), 21), a, b, c, tet >> 1])?;
        }
    }
    drop(sorted);
    let mut body_of = unions.finish()?;
    let (mut sorted, mut out) = (along.finish()?, ColumnWriter::new(&settings.scratch)?);
    while let Some([_, a, b, c, tet]) = sorted.next()? {
        out.push(&[a, b, c, body_of.get(tet)?])?;
    }
    Ok((out.finish()?, body_of))
}

/// The lattice position at the middle of a triangle, rounded down.
fn centre(triangle: [u64; 3], positions: &[FinePos]) -> LatticePos {
    std::array::from_fn(|a| {
        ((triangle.iter().map(|&v| positions[v as usize][a]).sum::<i64>() / 3) >> FINE_BITS) as u32
    })
}
