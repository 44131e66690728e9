//! Vertices that cells need: polyhedra one in the middle of each, and one in the middle of each
//! face of more than four vertices ([`isospan_io::cells::polyhedron`] has the rule); quadratic
//! cells those that they lack ([`isospan_io::cells::quadratic`]).
//!
//! Both cells at a face must have the same vertex, and memory need not hold the faces of a mesh. So
//! a pass over the cells lists the faces in question, and sorting brings equals together:
//!
//! ```text
//!  cells ─▶ faces: (hash of vertices, number) ─▶ sorted: first of equals ─▶ sorted: vertex of each
//!       └─▶ of which vertices each new one is the mean
//! ```
//!
//! A face is known by the 128 bits of a hash of its vertices, ascending: two of a billion faces are
//! mistaken for each other with a probability of 10^-21.
//!
//! Also listed are faces of four vertices that have a straight corner. They are cut from that
//! corner, unless a cell of another kind has the face too, which is always cut from the smallest
//! vertex.
//!
//! New vertices follow the file's own: first those of cells, then those of faces, in the order of
//! the cells. Positions are means on the fine lattice, rounded to the nearest step; of quadratic
//! cells, what their shape functions say. Values are those of the file's vertices, likewise: there
//! is none where one of these has none. Cell data are averaged to the file's vertices before.

use super::column::{Column, ColumnWriter};
use super::merge::Firsts;
use super::settings::StoreSettings;
use bytemuck::Pod;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::cells::polyhedron::{Cut, Faces, bent_corner, cone, distinct};
use isospan_io::cells::quadratic::{Middles, at_middle};
use isospan_io::cells::{CellBlock, CellKind, CellMesh, CellTet, split};
use isospan_io::error::Result;
use isospan_mesh::locate::FinePos;
use xxhash_rust::xxh3::xxh3_128;

/// Answers for faces of four vertices with a straight corner: they are cut from it,
const FROM_CORNER: u64 = u64::MAX;
/// or from the smallest vertex, as another kind of cell has them.
const FROM_SMALLEST: u64 = u64::MAX - 1;
/// The number of a face of another kind of cell: after those of polyhedra.
const OF_OTHERS: u64 = u64::MAX;

/// Marks a corner in a list of vertices: of a quadratic cell or face.
const CORNER: u64 = 1 << 63;

/// The vertices that the cells of a mesh add to its own.
pub(super) struct Added {
    /// The mesh's own vertices.
    own: u64,
    /// Whether some are of quadratic cells, and may lie outside of the box of those around them.
    has_quadratic: bool,
    /// Of which vertices that of each cell is the mean.
    cells: Lists,
    /// The same of all faces in question.
    faces: Lists,
    /// The faces that have a vertex, by the order of these.
    with_vertex: Column<u64>,
    /// For each face in question its vertex, or how it is cut.
    answers: Column<u64>,
}

impl Added {
    /// Looks for the cells of a mesh that need vertices. `None` of a mesh without any.
    ///
    /// # Errors
    /// When the mesh cannot be read, or the scratch folder not be written.
    pub(super) fn new(
        mesh: &CellMesh,
        positions: &[FinePos],
        firsts: &Firsts,
        settings: &StoreSettings,
    ) -> Result<Option<Self>> {
        let mut met = Met::new(settings)?;
        let (mut cells, mut block) = (mesh.cells()?, CellBlock::default());
        let (mut cell, mut replaced) = (Polyhedron::default(), vec![]);
        while cells.next_block(&mut block)? {
            settings.cancel.check()?;
            for (kind, numbers) in block.iter() {
                if let Some(middles) = kind.middles() {
                    replaced.clear();
                    replaced.extend_from_slice(numbers);
                    firsts.replace(&mut replaced)?;
                    met.add_quadratic(middles, &replaced)?;
                } else if kind == CellKind::Polyhedron {
                    cell.set(numbers, firsts)?;
                    met.add_polyhedron(&cell, numbers, positions)?;
                } else {
                    cell.set_sides(kind, numbers, firsts)?;
                    met.add_sides(&cell, positions)?;
                }
            }
        }
        met.finish(positions.len() as u64, settings)
    }

    /// How many they are.
    pub(super) fn count(&self) -> Result<u64> {
        Ok(self.cells.len()? + self.with_vertex.get()?.len() as u64)
    }

    /// Positions of the mesh's own vertices, then of those added.
    pub(super) fn positions(&self, own: &[FinePos], settings: &StoreSettings) -> Result<Column<FinePos>> {
        self.append(own, settings, |of| {
            let is_corner = |v: &&u64| **v & CORNER != 0;
            let corners = of.iter().filter(is_corner).count() as i128;
            let others = of.len() as i128 - corners;
            std::array::from_fn(|a| {
                let at = |v: &u64| i128::from(own[(v & !CORNER) as usize][a]);
                let of_corners: i128 = of.iter().filter(is_corner).map(at).sum();
                let sum: i128 = of.iter().map(at).sum::<i128>() - of_corners;
                let (above, below) = ((4 + corners) * sum - others * of_corners, 4 * others);
                (2 * above + below).div_euclid(2 * below) as i64
            })
        })
    }

    /// Values of the mesh's own vertices, then of those added.
    pub(super) fn values(&self, own: &[f32], settings: &StoreSettings) -> Result<Column<f32>> {
        self.append(own, settings, |of| {
            let at = |v: &u64| f64::from(own[(v & !CORNER) as usize]);
            let corners = of.iter().filter(|v| **v & CORNER != 0).map(at);
            let value = at_middle(corners, of.iter().filter(|v| **v & CORNER == 0).map(at));
            // It may be beyond all values around; none is infinite.
            value.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
        })
    }

    /// Whether some may lie outside of the box of the mesh's own vertices.
    pub(super) fn may_lie_outside(&self) -> bool {
        self.has_quadratic
    }

    /// What own vertices have, then the means of those that are added.
    fn append<T: Pod>(
        &self,
        own: &[T],
        settings: &StoreSettings,
        mean: impl Fn(&[u64]) -> T,
    ) -> Result<Column<T>> {
        let mut out = ColumnWriter::new(&settings.scratch)?;
        own.iter().try_for_each(|x| out.push(x))?;
        self.cells.each(0..self.cells.len()?, |of| out.push(&mean(of)))?;
        self.faces.each(self.with_vertex.get()?.iter().copied(), |of| out.push(&mean(of)))?;
        out.finish()
    }
}

/// What the cells of a mesh need, while they are gone through.
struct Met {
    /// Of which vertices that of each cell is the mean.
    cells: ListsWriter,
    /// The same of each face in question.
    faces: ListsWriter,
    /// Of each face in question whether it has four vertices and is no quadratic cell's; their
    /// hash; its number, or that of others.
    equals: Sorter<[u64; 4]>,
    has_quadratic: bool,
    vertices: Vec<u64>,
    bytes: Vec<u8>,
}

impl Met {
    fn new(settings: &StoreSettings) -> Result<Self> {
        Ok(Self {
            cells: ListsWriter::new(settings)?,
            faces: ListsWriter::new(settings)?,
            equals: Sorter::new(sorting_memory(settings), &settings.scratch),
            has_quadratic: false,
            vertices: vec![],
            bytes: vec![],
        })
    }

    /// Notes a face, whose vertices are listed, under a number.
    fn add_face(&mut self, has_four: bool, number: u64) -> Result<()> {
        self.bytes.clear();
        self.vertices.iter().for_each(|v| self.bytes.extend(v.to_le_bytes()));
        let hash = xxh3_128(&self.bytes);
        self.equals.push([u64::from(has_four), (hash >> 64) as u64, hash as u64, number])
    }

    /// Adds a quadratic cell that lacks vertices.
    fn add_quadratic(&mut self, middles: &'static Middles, vertices: &[u64]) -> Result<()> {
        self.has_quadratic = true;
        for (n, (mut around, corners)) in middles.around(vertices).enumerate() {
            if n == middles.faces.len() {
                around[..corners].iter_mut().for_each(|v| *v |= CORNER);
                self.cells.push(&around)?;
            } else if own_middle(&around).is_none() {
                self.vertices.clone_from(&around);
                self.vertices.sort_unstable();
                self.add_face(false, self.faces.len())?;
                around[..corners].iter_mut().for_each(|v| *v |= CORNER);
                around.sort_unstable();
                self.faces.push(&around)?;
            }
        }
        Ok(())
    }

    /// Adds the sides of a cell that is no polyhedron.
    fn add_sides(&mut self, cell: &Polyhedron, positions: &[FinePos]) -> Result<()> {
        for face in cell.faces().filter(|face| is_asked(face, positions)) {
            distinct(std::iter::once(face), &mut self.vertices);
            self.add_face(true, OF_OTHERS)?;
        }
        Ok(())
    }

    /// Adds a polyhedron; `numbers` are its faces as the file has them.
    fn add_polyhedron(&mut self, cell: &Polyhedron, numbers: &[u64], positions: &[FinePos]) -> Result<()> {
        distinct(cell.faces(), &mut self.vertices);
        if self.vertices.is_empty() {
            // Its points are one, or two.
            distinct(Faces::new(numbers), &mut self.vertices);
        }
        self.cells.push(&self.vertices)?;
        for face in cell.faces().filter(|face| is_asked(face, positions)) {
            distinct(std::iter::once(face), &mut self.vertices);
            self.add_face(face.len() == 4, self.faces.len())?;
            self.faces.push(&self.vertices)?;
        }
        Ok(())
    }

    /// The vertices that are added to the mesh's `own`; `None` if there are none.
    fn finish(self, own: u64, settings: &StoreSettings) -> Result<Option<Added>> {
        if self.cells.len() == 0 && self.faces.len() == 0 && !self.has_quadratic {
            return Ok(None);
        }
        let (cells, faces) = (self.cells.finish()?, self.faces.finish()?);
        let (with_vertex, answers) = answers(self.equals, own + cells.len()?, settings)?;
        Ok(Some(Added { own, has_quadratic: self.has_quadratic, cells, faces, with_vertex, answers }))
    }
}

/// Bytes for sorting.
fn sorting_memory(settings: &StoreSettings) -> usize {
    usize::try_from(settings.memory).unwrap_or(usize::MAX)
}

/// The vertex of each face in question or how it is cut, and the faces that have a vertex; these
/// are numbered from `first` on, in the order of the faces.
fn answers(
    equals: Sorter<[u64; 4]>,
    first: u64,
    settings: &StoreSettings,
) -> Result<(Column<u64>, Column<u64>)> {
    let memory = sorting_memory(settings);
    // The first face of equals, or how it is cut; the face.
    let mut by_first: Sorter<[u64; 2]> = Sorter::new(memory, &settings.scratch);
    let (mut sorted, mut group) = (equals.finish()?, vec![]);
    let mut next = sorted.next()?;
    while let Some([has_four, high, low, face]) = next {
        group.clear();
        group.push(face);
        next = sorted.next()?;
        while let Some(other) = next.filter(|other| other[..3] == [has_four, high, low]) {
            group.push(other[3]);
            next = sorted.next()?;
        }
        let of_others = group.last() == Some(&OF_OTHERS);
        let answer = match (has_four == 1, of_others) {
            (false, _) => face,
            (true, false) => FROM_CORNER,
            (true, true) => FROM_SMALLEST,
        };
        group
            .iter()
            .filter(|face| **face != OF_OTHERS)
            .try_for_each(|&face| by_first.push([answer, face]))?;
    }
    drop(sorted);
    let mut by_face: Sorter<[u64; 2]> = Sorter::new(memory, &settings.scratch);
    let (mut sorted, mut with_vertex) = (by_first.finish()?, ColumnWriter::new(&settings.scratch)?);
    let mut last = None;
    while let Some([answer, face]) = sorted.next()? {
        if answer >= FROM_SMALLEST {
            by_face.push([face, answer])?;
            continue;
        }
        if last != Some(answer) {
            with_vertex.push(&answer)?;
            last = Some(answer);
        }
        by_face.push([face, first + with_vertex.len() - 1])?;
    }
    drop(sorted);
    let (mut sorted, mut answers) = (by_face.finish()?, ColumnWriter::new(&settings.scratch)?);
    while let Some([_, answer]) = sorted.next()? {
        answers.push(&answer)?;
    }
    Ok((with_vertex.finish()?, answers.finish()?))
}

/// The vertex in the middle of a quadratic face that is collapsed to an edge: the one on that edge.
fn own_middle(around: &[u64]) -> Option<u64> {
    match around[..4] {
        [a, b, c, d] if a == b && c == d => Some(around[5]),
        [a, b, c, d] if b == c && d == a => Some(around[4]),
        _ => None,
    }
}

/// Whether a face has a vertex in its middle, or a straight corner.
fn is_asked(face: &[u64], positions: &[FinePos]) -> bool {
    match face.len() {
        4 => corner_of(face, positions).is_some(),
        n => n > 4,
    }
}

fn corner_of(face: &[u64], positions: &[FinePos]) -> Option<usize> {
    // Whole numbers of 38 bits.
    bent_corner(face, |v| positions[v as usize].map(|x| x as f64))
}

/// Splits the cells of a mesh that need vertices, in the order in which [`Added::new`] met them.
pub(super) struct Splitter<'a> {
    added: &'a Added,
    answers: &'a [u64],
    /// Cells with a vertex in their middle, and faces in question, so far.
    cells: u64,
    faces: usize,
    cell: Polyhedron,
}

impl<'a> Splitter<'a> {
    pub(super) fn new(added: &'a Added) -> Result<Self> {
        Ok(Self { added, answers: added.answers.get()?, cells: 0, faces: 0, cell: Polyhedron::default() })
    }

    /// Appends the tetrahedra of the next quadratic cell, whose vertices that are one have become
    /// one. Gives the number of those that were left out because they name a vertex twice.
    pub(super) fn split_quadratic(
        &mut self,
        middles: &'static Middles,
        vertices: &[u64],
        out: &mut Vec<CellTet>,
    ) -> usize {
        let mut all = vertices.to_vec();
        for (n, (around, _)) in middles.around(vertices).enumerate() {
            let own = own_middle(&around).filter(|_| n < middles.faces.len());
            all.push(if let Some(own) = own {
                own
            } else if n < middles.faces.len() {
                self.faces += 1;
                self.answers[self.faces - 1]
            } else {
                self.cells += 1;
                self.added.own + self.cells - 1
            });
        }
        split(middles.kind, &all, out)
    }

    /// Appends the tetrahedra of the next polyhedron. Gives the number of those that were left out
    /// because they name a vertex twice.
    pub(super) fn split(
        &mut self,
        numbers: &[u64],
        positions: &[FinePos],
        firsts: &Firsts,
        out: &mut Vec<CellTet>,
    ) -> Result<usize> {
        self.cell.set(numbers, firsts)?;
        let (apex, mut dropped) = (self.added.own + self.cells, 0);
        self.cells += 1;
        let Self { cell, answers, faces, .. } = self;
        let mut next_face = || {
            *faces += 1;
            answers[*faces - 1]
        };
        for face in cell.faces() {
            let cut = match face.len() {
                4 => match corner_of(face, positions) {
                    Some(corner) if next_face() == FROM_CORNER => Cut::From(corner),
                    _ => Cut::Smallest,
                },
                5.. => Cut::Around(next_face()),
                _ => Cut::Smallest,
            };
            dropped += cone(apex, face, cut, out);
        }
        Ok(dropped)
    }
}

/// The faces of a cell, in which vertices that are one have become one.
#[derive(Default)]
struct Polyhedron {
    numbers: Vec<u64>,
}

impl Polyhedron {
    fn faces(&self) -> Faces<'_> {
        Faces::new(&self.numbers)
    }

    fn set(&mut self, numbers: &[u64], firsts: &Firsts) -> Result<()> {
        self.numbers.clear();
        Faces::new(numbers).try_for_each(|face| self.push(face, firsts))
    }

    /// Takes the faces of four vertices of a linear cell of another kind.
    fn set_sides(&mut self, kind: CellKind, vertices: &[u64], firsts: &Firsts) -> Result<()> {
        self.numbers.clear();
        let mut of_kind = kind.four_sided(vertices);
        of_kind.try_for_each(|face| self.push(&face, firsts))
    }

    /// Appends a face, unless vertices that are one leave less than a triangle of it.
    fn push(&mut self, face: &[u64], firsts: &Firsts) -> Result<()> {
        let start = self.numbers.len();
        self.numbers.push(0);
        self.numbers.extend_from_slice(face);
        let of = &mut self.numbers[start + 1..];
        firsts.replace(of)?;
        let (mut kept, n) = (0, of.len());
        for i in 0..n {
            if i == 0 || of[i] != of[kept - 1] {
                of[kept] = of[i];
                kept += 1;
            }
        }
        while kept > 1 && of[kept - 1] == of[0] {
            kept -= 1;
        }
        if kept < 3 {
            self.numbers.truncate(start);
        } else {
            self.numbers.truncate(start + 1 + kept);
            self.numbers[start] = kept as u64;
        }
        Ok(())
    }
}

/// Lists of vertices, one after another.
struct Lists {
    of: Column<u64>,
    /// Where each ends.
    ends: Column<u64>,
}

impl Lists {
    fn len(&self) -> Result<u64> {
        Ok(self.ends.get()?.len() as u64)
    }

    /// Calls `visit` with some of the lists.
    fn each(
        &self,
        numbers: impl Iterator<Item = u64>,
        mut visit: impl FnMut(&[u64]) -> Result<()>,
    ) -> Result<()> {
        let (of, ends) = (self.of.get()?, self.ends.get()?);
        for n in numbers {
            let start = if n == 0 { 0 } else { ends[n as usize - 1] };
            visit(&of[start as usize..ends[n as usize] as usize])?;
        }
        Ok(())
    }
}

struct ListsWriter {
    of: ColumnWriter<u64>,
    ends: ColumnWriter<u64>,
}

impl ListsWriter {
    fn new(settings: &StoreSettings) -> Result<Self> {
        Ok(Self { of: ColumnWriter::new(&settings.scratch)?, ends: ColumnWriter::new(&settings.scratch)? })
    }

    fn len(&self) -> u64 {
        self.ends.len()
    }

    fn push(&mut self, list: &[u64]) -> Result<()> {
        list.iter().try_for_each(|v| self.of.push(v))?;
        self.ends.push(&self.of.len())
    }

    fn finish(self) -> Result<Lists> {
        Ok(Lists { of: self.of.finish()?, ends: self.ends.finish()? })
    }
}
