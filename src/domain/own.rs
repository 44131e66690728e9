//! The mesh's own vertices and tetrahedra, ready to be kept as they are.
//!
//! Nothing is sampled and nothing is meshed: the points of the archive are the vertices of
//! tetrahedra, and its tetrahedra are those that the cells were split into.
//!
//! ```text
//!  positions ─▶ rounded to the lattice ─▶ list, sorted ─▶ place of each vertex, vertex of each place
//!  tetrahedra ─▶ still of their orientation? ─▶ (brick, tetrahedron), sorted ─▶ those with a corner in each brick
//! ```
//!
//! **Rounding.** A position is rounded to the nearest of 2^24 steps along the longest side, so it
//! moves by at most 2^-25 of that along each axis. Vertices may come to share a position, and
//! vertices of bodies that touch do so from the start: they stay different points. A tetrahedron
//! that would become flat or turn over is refused, for neither a volume nor a surface would be
//! right there.
//!
//! **Which chunk.** A tetrahedron belongs to the chunk that has its least corner by position, then
//! by place in the list.
//!
//! Memory: the list, at most [`POINT_BYTES`] a vertex while it is made. The rest is on disk.

use super::column::{Column, ColumnWriter};
use super::settings::StoreSettings;
use super::store::CellStore;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::error::{Error, Result};
use isospan_io::geom::LatticePos;
use isospan_io::grid::{BrickGrid, BrickId};
use isospan_mesh::locate::rounded;
use isospan_mesh::points::ExplicitPoints;
use isospan_mesh::predicates::signed_volume6;
use std::path::Path;
use std::sync::Arc;

/// Bytes of a vertex while the list is made: its position, once more while that is sorted, its part
/// of the grid, whether it is used.
pub(crate) const POINT_BYTES: u64 = 32;
/// Tetrahedra or vertices between two looks at whether to stop.
const BATCH: usize = 1 << 15;
/// The place of a vertex that no tetrahedron has.
pub(crate) const UNUSED: u32 = u32::MAX;

/// The vertices of all tetrahedra, as listed points.
pub(crate) struct OwnVertices {
    pub(crate) points: Arc<ExplicitPoints>,
    /// The place in the list of each vertex; [`UNUSED`] of the others. A vertex that stands for
    /// equals has the place, they have none.
    pub(crate) places: Column<u32>,
    /// The volume of all tetrahedra on the lattice, six times.
    pub(crate) volume6: u128,
}

impl OwnVertices {
    /// Lists the vertices of a mesh, whose file is at `path`.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a tetrahedron that rounding makes flat or turns over;
    /// [`Error::Budget`] where memory does not hold the list.
    pub(crate) fn new(store: &CellStore, settings: &StoreSettings, path: &Path) -> Result<Self> {
        let positions = store.positions.get()?;
        let needed = positions.len() as u64 * POINT_BYTES;
        if needed > settings.memory {
            return Err(Error::memory("for a list of the mesh's vertices", needed, settings.memory));
        }
        if positions.len() > ExplicitPoints::MOST {
            let expected = format!("at most {} where all are kept", ExplicitPoints::MOST);
            return Err(Error::bad_input(path, "points", expected, positions.len().to_string())
                .with_help("give a `fraction` below 1"));
        }
        let mut used = vec![false; positions.len()];
        let volume6 = check_tets(store, settings, path, &mut used)?;
        let mut listed = Vec::with_capacity(used.iter().filter(|used| **used).count());
        listed.extend(positions.iter().zip(&used).filter(|(_, used)| **used).map(|(&p, _)| rounded(p)));
        let points = ExplicitPoints::with_repeats(&store.frame.lattice, listed);
        // The vertices of one position have places by ascending numbers.
        let mut met = vec![0u32; points.len() as usize];
        let mut places = ColumnWriter::new(&settings.scratch)?;
        for (&p, used) in positions.iter().zip(&used) {
            places.push(&if *used {
                let first = points.find(rounded(p)).expect("the list has all vertices that are used");
                met[first] += 1;
                first as u32 + met[first] - 1
            } else {
                UNUSED
            })?;
        }
        Ok(Self { points: Arc::new(points), places: places.finish()?, volume6 })
    }
}

/// Notes the vertices of all tetrahedra, and adds up the volumes of these on the lattice.
fn check_tets(store: &CellStore, settings: &StoreSettings, path: &Path, used: &mut [bool]) -> Result<u128> {
    let (positions, tets) = (store.positions.get()?, store.tets.get()?);
    let (mut sum, mut lost, mut first) = (0u128, 0u64, None);
    for (number, tet) in tets.iter().enumerate() {
        if number % BATCH == 0 {
            settings.cancel.check()?;
        }
        let [a, b, c, d] = tet.map(|v| rounded(positions[v as usize]));
        let volume6 = signed_volume6(a, b, c, d);
        tet.iter().for_each(|&v| used[v as usize] = true);
        match u128::try_from(volume6) {
            Ok(volume6 @ 1..) => sum += volume6,
            _ => {
                lost += 1;
                first.get_or_insert(tet);
            }
        }
    }
    let Some(tet) = first else { return Ok(sum) };
    let got = format!("{lost} that would not, the first with the points {tet:?}");
    Err(Error::bad_input(
        path,
        "tetrahedra",
        "those that keep their orientation when positions are rounded to 2^-24 of the longest side",
        got,
    )
    .with_help("a `fraction` below 1, such as 0.99, samples the mesh instead of keeping its cells"))
}

/// The own tetrahedra of a mesh, by bricks.
pub(crate) struct OwnCells {
    pub(crate) vertices: OwnVertices,
    /// The vertex at each place of the list.
    numbers: Column<u64>,
    /// The tetrahedra with a corner in the first brick, in the second, …, ascending in each.
    cells: Column<u64>,
    /// Where each brick's tetrahedra begin, and the end.
    starts: Column<u64>,
}

/// A tetrahedron by the places of its corners, positively oriented.
pub(crate) type OwnTet = [u32; 4];

impl OwnCells {
    /// Sorts the tetrahedra into bricks.
    ///
    /// # Errors
    /// When the scratch folder cannot be written.
    pub(crate) fn new(
        vertices: OwnVertices,
        store: &CellStore,
        bricks: &BrickGrid,
        settings: &StoreSettings,
    ) -> Result<Self> {
        let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
        let mut sorter: Sorter<[u64; 2]> = Sorter::new(memory, &settings.scratch);
        let positions = store.positions.get()?;
        for (number, tet) in store.tets.get()?.iter().enumerate() {
            if number % BATCH == 0 {
                settings.cancel.check()?;
            }
            let of = tet.map(|v| bricks.id(bricks.brick_at(rounded(positions[v as usize]))).0);
            for (_, &brick) in of.iter().enumerate().filter(|(i, brick)| !of[..*i].contains(brick)) {
                sorter.push([brick, number as u64])?;
            }
        }
        let (mut cells, mut starts) =
            (ColumnWriter::new(&settings.scratch)?, ColumnWriter::new(&settings.scratch)?);
        let mut sorted = sorter.finish()?;
        while let Some([brick, cell]) = sorted.next()? {
            while starts.len() <= brick {
                starts.push(&cells.len())?;
            }
            cells.push(&cell)?;
        }
        while starts.len() <= bricks.len() {
            starts.push(&cells.len())?;
        }
        drop(sorted);
        let numbers = numbers_of(&vertices, settings)?;
        Ok(Self { vertices, numbers, cells: cells.finish()?, starts: starts.finish()? })
    }

    /// How many tetrahedra have a corner in some bricks; one with corners in several counts as
    /// often.
    pub(crate) fn count(&self, bricks: impl Iterator<Item = BrickId>) -> Result<u64> {
        let starts = self.starts.get()?;
        Ok(bricks.map(|b| starts[b.0 as usize + 1] - starts[b.0 as usize]).sum())
    }

    /// The tetrahedra with a corner in some bricks, each once, ascending by their numbers.
    pub(crate) fn of_bricks(
        &self,
        store: &CellStore,
        bricks: impl Iterator<Item = BrickId>,
    ) -> Result<Vec<OwnTet>> {
        let (starts, cells, mut numbers) = (self.starts.get()?, self.cells.get()?, vec![]);
        for brick in bricks {
            let [from, to] = [brick.0, brick.0 + 1].map(|b| starts[b as usize] as usize);
            numbers.extend_from_slice(&cells[from..to]);
        }
        numbers.sort_unstable();
        numbers.dedup();
        let (tets, places) = (store.tets.get()?, self.vertices.places.get()?);
        Ok(numbers.iter().map(|&n| tets[n as usize].map(|v| places[v as usize])).collect())
    }

    /// The vertex at each of some places.
    pub(crate) fn numbers_at(&self, places: impl Iterator<Item = u64>) -> Result<Vec<u64>> {
        let numbers = self.numbers.get()?;
        Ok(places.map(|place| numbers[place as usize]).collect())
    }

    /// The position of a place.
    pub(crate) fn position(&self, place: u32) -> LatticePos {
        self.vertices.points.positions()[place as usize]
    }
}

/// The vertex at each place.
fn numbers_of(vertices: &OwnVertices, settings: &StoreSettings) -> Result<Column<u64>> {
    let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
    let mut sorter: Sorter<[u64; 2]> = Sorter::new(memory, &settings.scratch);
    for (number, &place) in vertices.places.get()?.iter().enumerate().filter(|(_, p)| **p != UNUSED) {
        sorter.push([u64::from(place), number as u64])?;
    }
    let (mut sorted, mut numbers) = (sorter.finish()?, ColumnWriter::new(&settings.scratch)?);
    while let Some([_, number]) = sorted.next()? {
        numbers.push(&number)?;
    }
    numbers.finish()
}
