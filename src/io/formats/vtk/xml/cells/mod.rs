//! Unstructured grids: `.vtu`, in one or several pieces; `.pvtu`, `.vtm`, `.vtpc` and `.vtpd`,
//! which list files.
//!
//! ```text
//! <UnstructuredGrid>
//!   <Piece NumberOfPoints="8" NumberOfCells="6">
//!     <PointData Scalars="speed"> <DataArray …/> </PointData>
//!     <CellData> … </CellData>
//!     <Points> <DataArray type="Float32" NumberOfComponents="3" …/> </Points>
//!     <Cells>
//!       <DataArray Name="connectivity" …/>     the vertices of all cells
//!       <DataArray Name="offsets" …/>          where the vertices of each cell end
//!       <DataArray Name="types" …/>            VTK's numbers of kinds of cells
//!       …                                      the faces of polyhedra: see [`faces`]
//!     </Cells>
//!   </Piece>
//! </UnstructuredGrid>
//! ```
//!
//! The arrays of the cells are decoded side by side, in constant memory. Points of later
//! pieces are numbered after those of the pieces before; a point on the border of two pieces is
//! stored, and counted, twice. The files of an index are open only while they are read. Empty
//! pieces, which parallel programs write, may lack their arrays.
//!
//! **Blocks** (`.vtm` and others) are pieces too, of grids; blocks that are surfaces have no volume
//! and are passed over. Fields are those that all blocks have.

use self::faces::{CellFaces, FACE_ARRAYS, Failed, WrongFaces};
use super::array::{ArrayStream, scalar_type};
use super::head::{Document, Element};
use super::image::{arrays, fields, how_stored, name_of};
use crate::bytes::{ByteSource, IoMode};
use crate::cells::{
    BLOCK, CellBlock, CellField, CellFile, CellKind, CellStream, CellsInfo, Center, GHOSTS, NumberStream,
};
use crate::error::{Error, Result};
use crate::formats::shared::header;
use crate::formats::shared::numbers::{push_ids, to_f64};
use crate::volume::ScalarType;
use std::path::PathBuf;
use std::sync::Arc;
use xxhash_rust::xxh3::Xxh3;

mod faces;

/// Files that an index may list.
const MOST_FILES: usize = 1 << 16;

/// Vertices that are held at one time; a cell without a volume may have any number, a polyhedron as
/// many.
const MOST_VERTICES: u64 = 64 * BLOCK as u64;

/// Opens a `.vtu` or `.pvtu` file, or a list of blocks.
pub(super) fn open(source: &Arc<ByteSource>, io: IoMode) -> Result<Grid> {
    let kinds = [&GRIDS[..], &LISTS].concat();
    let doc = Arc::new(Document::open_one_of(source, &kinds)?);
    let mut found = ListedPieces::default();
    match doc.kind {
        "UnstructuredGrid" => list_pieces(&doc, || PieceSource::Open(Arc::clone(&doc)), &mut found.pieces)?,
        "PUnstructuredGrid" => found.add_index(&doc, io)?,
        _ => found.add_blocks(&doc, io)?,
    }
    let ListedPieces { files, pieces, surfaces } = found;
    let info = describe(&doc, &pieces, files, surfaces)?;
    Ok(Grid(Arc::new(Shared { info, doc, pieces })))
}

/// Types of files that hold grids, or list files of pieces of one.
const GRIDS: [&str; 2] = ["UnstructuredGrid", "PUnstructuredGrid"];
/// Types of files that list files of several blocks.
pub(super) const LISTS: [&str; 3] =
    ["vtkMultiBlockDataSet", "vtkPartitionedDataSetCollection", "vtkPartitionedDataSet"];

/// What a file and those that it lists have.
#[derive(Default)]
struct ListedPieces {
    files: Vec<PathBuf>,
    pieces: Vec<CellPiece>,
    /// Blocks that are surfaces.
    surfaces: u64,
}

impl ListedPieces {
    /// The files that the index of a grid lists.
    fn add_index(&mut self, doc: &Document, io: IoMode) -> Result<()> {
        for file in listed_files(doc)? {
            let part = Document::open(&Arc::new(ByteSource::open(&file, io)?), "UnstructuredGrid")?;
            list_pieces(&part, || PieceSource::File(file.clone(), io), &mut self.pieces)?;
            self.files.push(file);
        }
        Ok(())
    }

    /// The files of all blocks.
    fn add_blocks(&mut self, doc: &Document, io: IoMode) -> Result<()> {
        for file in blocks_of(doc)? {
            let source = Arc::new(ByteSource::open(&file, io)?);
            let kinds = [&GRIDS[..], &["PolyData", "PPolyData"]].concat();
            let part = Document::open_one_of(&source, &kinds)?;
            match part.kind {
                "UnstructuredGrid" => {
                    list_pieces(&part, || PieceSource::File(file.clone(), io), &mut self.pieces)?;
                }
                "PUnstructuredGrid" => self.add_index(&part, io)?,
                _ => self.surfaces += 1,
            }
            self.files.push(file);
        }
        Ok(())
    }
}

/// The files that a list of blocks names, in its order.
pub(super) fn blocks_of(doc: &Document) -> Result<Vec<PathBuf>> {
    let (mut files, mut left) = (vec![], vec![&doc.data]);
    while let Some(element) = left.pop() {
        // A block may be empty.
        let file = element.attribute("file").filter(|name| element.name == "DataSet" && !name.is_empty());
        files.extend(file.map(|name| header::sibling(doc.source.path(), name)));
        if files.len() > MOST_FILES {
            return Err(doc.wrong(&doc.data, format!("at most {MOST_FILES} blocks"), "more"));
        }
        left.extend(element.children.iter().rev());
    }
    Ok(files)
}

/// The files that an index lists.
fn listed_files(doc: &Document) -> Result<Vec<PathBuf>> {
    let mut files = vec![];
    for piece in doc.data.all("Piece") {
        let name = piece.attribute("Source");
        let name = name.ok_or_else(|| doc.wrong(piece, "an attribute 'Source'", "none"))?;
        if files.len() == MOST_FILES {
            return Err(doc.wrong(&doc.data, format!("at most {MOST_FILES} pieces"), "more"));
        }
        files.push(header::sibling(doc.source.path(), name));
    }
    Ok(files)
}

/// A piece, and where it is.
struct CellPiece {
    place: PieceSource,
    /// Its number among the pieces of its file.
    number: usize,
    points: u64,
    cells: u64,
}

enum PieceSource {
    Open(Arc<Document>),
    File(PathBuf, IoMode),
}

impl CellPiece {
    fn document(&self) -> Result<Arc<Document>> {
        match &self.place {
            PieceSource::Open(doc) => Ok(Arc::clone(doc)),
            PieceSource::File(path, io) => {
                let source = Arc::new(ByteSource::open(path, *io)?);
                Ok(Arc::new(Document::open(&source, "UnstructuredGrid")?))
            }
        }
    }

    fn element<'a>(&self, doc: &'a Document) -> Result<&'a Element> {
        let element = doc.data.all("Piece").nth(self.number);
        element.ok_or_else(|| doc.wrong(&doc.data, "the pieces that it had when it was opened", "fewer"))
    }
}

/// Appends the pieces of a file that are not empty.
fn list_pieces(doc: &Document, place: impl Fn() -> PieceSource, out: &mut Vec<CellPiece>) -> Result<()> {
    for (number, element) in doc.data.all("Piece").enumerate() {
        let count = |name| {
            let found: Option<[u64; 1]> = doc.numbers(element, name)?;
            found.map(|[n]| n).ok_or_else(|| doc.wrong(element, format!("an attribute '{name}'"), "none"))
        };
        let (points, cells) = (count("NumberOfPoints")?, count("NumberOfCells")?);
        if points > 0 || cells > 0 {
            out.push(CellPiece { place: place(), number, points, cells });
        }
    }
    Ok(())
}

/// The fields of a piece.
fn fields_of(doc: &Document, piece: &Element) -> Result<Vec<CellField>> {
    let mut all = vec![];
    for (name, center) in [("PointData", Center::Point), ("CellData", Center::Cell)] {
        let found = fields(doc, piece.child(name))?;
        let field = |f: crate::volume::FieldInfo| CellField {
            name: f.name,
            scalar: f.scalar,
            components: f.components,
            center,
        };
        all.extend(found.into_iter().map(field));
    }
    Ok(all)
}

fn describe(
    doc: &Document,
    pieces: &[CellPiece],
    data_files: Vec<PathBuf>,
    surfaces: u64,
) -> Result<CellsInfo> {
    let total = |of: fn(&CellPiece) -> u64| pieces.iter().try_fold(0u64, |sum, p| sum.checked_add(of(p)));
    let (points, cells) = (total(|p| p.points), total(|p| p.cells));
    // Far below overflow, and above any file: a position takes bytes.
    let sane = |n: &u64| *n <= i64::MAX as u64 / 64;
    let (Some(points), Some(cells)) = (points.filter(sane), cells.filter(sane)) else {
        return Err(doc.wrong(&doc.data, "numbers of points and cells of 57 bits", "larger ones"));
    };
    let Some(first) = pieces.first() else {
        return Err(doc.wrong(&doc.data, "a Piece with points and cells", "none"));
    };
    let part = first.document()?;
    let piece = first.element(&part)?;
    let mut all = fields_of(&part, piece)?;
    let mut kind = format!("{} files, ", data_files.len());
    if LISTS.contains(&doc.kind) {
        if surfaces > 0 {
            kind += &format!("{surfaces} of surfaces passed over, ");
        }
        let left_out = keep_common(pieces, &mut all)?;
        if left_out > 0 {
            kind += &format!("{left_out} arrays left out that some blocks lack, ");
        }
    }
    let active = piece.child("PointData").and_then(|p| p.attribute("Scalars"));
    let active = active.and_then(|name| all.iter().position(|f| f.name == name && f.center == Center::Point));
    let stored = how_stored(&part, piece.child("Points").and_then(|p| p.child("DataArray")));
    let files = if doc.kind == "UnstructuredGrid" { String::new() } else { kind };
    Ok(CellsInfo {
        path: doc.source.path().to_path_buf(),
        format: format!("VTK XML UnstructuredGrid ({files}{stored})"),
        points,
        cells,
        fields: all,
        active,
        data_files,
    })
}

/// Removes the fields of the first piece that others lack; gives how many some pieces lack.
///
/// # Errors
/// [`Error::BadInput`] where some pieces alone have marks of ghosts.
fn keep_common(pieces: &[CellPiece], all: &mut Vec<CellField>) -> Result<usize> {
    let has_ghosts =
        |fields: &[CellField]| fields.iter().any(|f| f.name == GHOSTS && f.center == Center::Cell);
    let expected = has_ghosts(all);
    let mut names: Vec<(String, Center)> = all.iter().map(|f| (f.name.clone(), f.center)).collect();
    for piece in &pieces[1..] {
        let doc = piece.document()?;
        let element = piece.element(&doc)?;
        let own = fields_of(&doc, element)?;
        if has_ghosts(&own) != expected {
            return Err(doc.wrong(element, format!("{GHOSTS} in all blocks, or in none"), "it in some"));
        }
        all.retain(|f| own.contains(f));
        names.extend(own.into_iter().map(|f| (f.name, f.center)));
    }
    names.sort_by(|a, b| (&a.0, a.1 == Center::Cell).cmp(&(&b.0, b.1 == Center::Cell)));
    names.dedup();
    Ok(names.len() - all.len())
}

struct Shared {
    info: CellsInfo,
    /// The file that was named.
    doc: Arc<Document>,
    pieces: Vec<CellPiece>,
}

/// An opened grid.
pub(super) struct Grid(Arc<Shared>);

impl Grid {
    /// The file that was named.
    pub(super) fn document(&self) -> &Document {
        &self.0.doc
    }

    fn numbers(&self, what: What) -> Box<dyn NumberStream> {
        Box::new(PieceNumbers { shared: Arc::clone(&self.0), what, piece: 0, open: None, bytes: vec![] })
    }
}

impl CellFile for Grid {
    fn info(&self) -> &CellsInfo {
        &self.0.info
    }

    fn points(&self) -> Result<Box<dyn NumberStream>> {
        Ok(self.numbers(What::Points))
    }

    fn cells(&self) -> Result<Box<dyn CellStream>> {
        Ok(Box::new(PieceCells {
            shared: Arc::clone(&self.0),
            piece: 0,
            base: 0,
            open: None,
            bytes: vec![],
            ids: vec![],
        }))
    }

    fn field(&self, field: usize) -> Result<Box<dyn NumberStream>> {
        Ok(self.numbers(What::Field(field)))
    }

    fn may_have_polyhedra(&self) -> Result<bool> {
        for piece in &self.0.pieces {
            let doc = piece.document()?;
            let cells = piece.element(&doc)?.child("Cells");
            if arrays(cells).any(|a| FACE_ARRAYS.contains(&&*name_of(a))) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The hash of arrays that lie in their elements, in one file. There is none where cells are
    /// marked as ghosts: these marks are a part of the mesh that is stored elsewhere.
    fn stored_hash(&self) -> Result<Option<u128>> {
        if self.0.info.fields.iter().any(|f| f.name == GHOSTS) {
            return Ok(None);
        }
        let mut hash = Xxh3::new();
        for piece in &self.0.pieces {
            let PieceSource::Open(doc) = &piece.place else { return Ok(None) };
            let element = piece.element(doc)?;
            hash.update(format!("{} {} {}", piece.points, piece.cells, doc.stored_as()).as_bytes());
            for parent in ["Points", "Cells"] {
                for array in arrays(element.child(parent)) {
                    if array.attribute("format") == Some("appended") {
                        return Ok(None);
                    }
                    let length = array.text.end - array.text.start;
                    hash.update(format!("{parent} {:?} {length} ", array.attributes()).as_bytes());
                    doc.hash_text(array, &mut hash)?;
                }
            }
        }
        Ok(Some(hash.digest128()))
    }
}

#[derive(Clone, Copy)]
enum What {
    Points,
    Field(usize),
}

/// An array of each piece, one after another.
struct PieceNumbers {
    shared: Arc<Shared>,
    what: What,
    piece: usize,
    open: Option<OpenArray>,
    bytes: Vec<u8>,
}

struct OpenArray {
    stream: ArrayStream,
    scalar: ScalarType,
    /// Numbers not read yet.
    left: u64,
}

impl PieceNumbers {
    fn open(&self, piece: &CellPiece) -> Result<OpenArray> {
        let doc = piece.document()?;
        let element = piece.element(&doc)?;
        let (array, scalar, count) = match self.what {
            What::Points => {
                let points = element.child("Points").and_then(|p| p.child("DataArray"));
                let array = points.ok_or_else(|| doc.wrong(element, "a DataArray in Points", "none"))?;
                let scalar = array.attribute("type").and_then(scalar_type);
                let scalar = scalar.ok_or_else(|| doc.wrong(array, "numbers", "another type"))?;
                (array, scalar, piece.points.checked_mul(3))
            }
            What::Field(field) => {
                let field = &self.shared.info.fields[field];
                let (parent, tuples) = match field.center {
                    Center::Point => ("PointData", piece.points),
                    Center::Cell => ("CellData", piece.cells),
                };
                let array = find(&doc, element, parent, field)?;
                (array, field.scalar, tuples.checked_mul(field.components.into()))
            }
        };
        let bytes = count.and_then(|n| n.checked_mul(scalar.bytes() as u64)).zip(count);
        let (bytes, left) =
            bytes.ok_or_else(|| doc.wrong(array, "an array of 63 bits of bytes", "a longer one"))?;
        Ok(OpenArray { stream: ArrayStream::open(&doc, array, scalar, bytes)?, scalar, left })
    }
}

/// The array of a field in a piece.
fn find<'a>(doc: &Document, piece: &'a Element, parent: &str, field: &CellField) -> Result<&'a Element> {
    let same = |a: &&Element| {
        let components = doc.count(a, "NumberOfComponents", 1);
        let scalar = a.attribute("type").and_then(scalar_type);
        name_of(a) == field.name
            && scalar == Some(field.scalar)
            && components.is_ok_and(|n| n == u64::from(field.components))
    };
    arrays(piece.child(parent)).find(same).ok_or_else(|| {
        let (n, name, scalar) = (field.components, &field.name, field.scalar.name());
        let expected = format!("{parent} '{name}' of {n} x {scalar} in every piece");
        doc.wrong(piece, expected, "none like it")
    })
}

impl NumberStream for PieceNumbers {
    fn fill(&mut self, mut out: &mut [f64]) -> Result<()> {
        while !out.is_empty() {
            if self.open.as_ref().is_none_or(|o| o.left == 0) {
                self.next_piece()?;
                continue;
            }
            let open = self.open.as_mut().expect("it is open, as was just seen");
            let n = open.left.min(out.len() as u64) as usize;
            let (now, later) = out.split_at_mut(n);
            self.bytes.resize(n * open.scalar.bytes(), 0);
            open.stream.fill(&mut self.bytes)?;
            to_f64(open.scalar, &self.bytes, now);
            open.left -= n as u64;
            out = later;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        self.open.as_mut().map_or(Ok(()), |o| o.stream.finish())
    }
}

impl PieceNumbers {
    fn next_piece(&mut self) -> Result<()> {
        self.finish()?;
        let piece =
            self.shared.pieces.get(self.piece).expect("as many numbers are asked for as were counted");
        self.open = Some(self.open(piece)?);
        self.piece += 1;
        Ok(())
    }
}

/// The cells of each piece, one after another.
struct PieceCells {
    shared: Arc<Shared>,
    piece: usize,
    /// Points of the pieces before.
    base: u64,
    open: Option<OpenCells>,
    bytes: Vec<u8>,
    ids: Vec<u64>,
}

struct OpenCells {
    path: PathBuf,
    types: Ids,
    offsets: Ids,
    connectivity: Ids,
    faces: CellFaces,
    points: u64,
    /// Cells whose type and offset are not read yet.
    left: u64,
    /// Types and offsets that were read, of which the first ones are used.
    waiting: Waiting,
    /// Cells read.
    at: u64,
    /// Where the vertices of the last cell read end.
    offset: u64,
}

/// What is known of cells to come.
#[derive(Default)]
struct Waiting {
    types: Vec<u64>,
    ends: Vec<u64>,
    /// Where their faces end.
    face_ends: Vec<u64>,
    used: usize,
}

/// An array of integers.
struct Ids {
    stream: ArrayStream,
    scalar: ScalarType,
}

impl Ids {
    /// Puts the next `n` into `out` (cleared first).
    fn read(&mut self, n: usize, bytes: &mut Vec<u8>, out: &mut Vec<u64>) -> Result<()> {
        out.clear();
        bytes.resize(n * self.scalar.bytes(), 0);
        self.stream.fill(bytes)?;
        push_ids(self.scalar, bytes, out);
        Ok(())
    }
}

/// VTK's number of a polyhedron.
const POLYHEDRON: u64 = 42;

/// A number as the file has it: one that is negative is read as the largest.
fn shown(id: u64) -> String {
    (id as i64).to_string()
}

impl OpenCells {
    /// Whether there are cells whose types were read and whose vertices were not.
    fn waits(&self) -> bool {
        self.waiting.used < self.waiting.types.len()
    }

    fn open(piece: &CellPiece) -> Result<Self> {
        let doc = piece.document()?;
        let element = piece.element(&doc)?;
        let cells = element.child("Cells").ok_or_else(|| doc.wrong(element, "an element Cells", "none"))?;
        let array = |name: &str, count: Option<u64>| {
            let array = arrays(Some(cells)).find(|a| name_of(a) == name);
            let array = array.ok_or_else(|| doc.wrong(cells, format!("an array '{name}'"), "none"))?;
            let scalar = array.attribute("type").and_then(scalar_type);
            let scalar = scalar.filter(|s| !s.is_float());
            let scalar = scalar.ok_or_else(|| doc.wrong(array, "an integer type", "another"))?;
            let stream = match count {
                // Points and cells have been checked to be few enough.
                Some(n) => ArrayStream::open(&doc, array, scalar, n * scalar.bytes() as u64)?,
                None => ArrayStream::open_declared(&doc, array, scalar)?,
            };
            Ok(Ids { stream, scalar })
        };
        let (types, offsets) = (array("types", Some(piece.cells))?, array("offsets", Some(piece.cells))?);
        let connectivity = array("connectivity", None)?;
        let has = |name: &str| arrays(Some(cells)).any(|a| name_of(a) == name);
        let faces = CellFaces::open(has, piece.cells, array)?;
        let path = doc.source.path().to_path_buf();
        Ok(Self {
            path,
            types,
            offsets,
            connectivity,
            faces,
            points: piece.points,
            left: piece.cells,
            waiting: Waiting::default(),
            at: 0,
            offset: 0,
        })
    }

    /// An error of the cell that is being read.
    fn wrong(&self, expected: impl Into<String>, got: impl Into<String>) -> Error {
        let cell = self.at;
        Error::bad_input(&self.path, format!("cell {cell} of a piece (counted from 0)"), expected, got)
    }

    fn wrong_faces(&self, (expected, got): WrongFaces) -> Error {
        self.wrong(expected, got).with_help("write the mesh again with VTK or ParaView")
    }

    fn finish(&mut self) -> Result<()> {
        self.types.stream.finish()?;
        self.offsets.stream.finish()?;
        self.connectivity.stream.finish()?;
        self.faces.finish()
    }

    /// The next cells of this piece, at most [`BLOCK`].
    fn read(
        &mut self,
        base: u64,
        bytes: &mut Vec<u8>,
        ids: &mut Vec<u64>,
        out: &mut CellBlock,
    ) -> Result<()> {
        let mut waiting = std::mem::take(&mut self.waiting);
        if waiting.used == waiting.types.len() {
            let n = self.left.min(BLOCK as u64) as usize;
            self.types.read(n, bytes, &mut waiting.types)?;
            self.offsets.read(n, bytes, &mut waiting.ends)?;
            self.faces.read_ends(n, bytes, &mut waiting.face_ends)?;
            self.left -= n as u64;
            waiting.used = 0;
        }
        let n = waiting.types.len();
        while waiting.used < n && out.numbers() as u64 <= MOST_VERTICES {
            self.read_some(&mut waiting, base, bytes, ids, out)?;
        }
        self.waiting = waiting;
        Ok(())
    }

    /// As many of the cells that wait as have few enough vertices together; a polyhedron comes
    /// alone.
    fn read_some(
        &mut self,
        waiting: &mut Waiting,
        base: u64,
        bytes: &mut Vec<u8>,
        ids: &mut Vec<u64>,
        out: &mut CellBlock,
    ) -> Result<()> {
        let Waiting { types, ends, face_ends, used } = waiting;
        let first = *used;
        let is_polyhedron = types[first] == POLYHEDRON;
        let goes_on = |(&t, &e): (&u64, &u64)| {
            !is_polyhedron && t != POLYHEDRON && e.wrapping_sub(self.offset) <= MOST_VERTICES
        };
        let few = types[first..].iter().zip(&ends[first..]).take_while(|&cell| goes_on(cell)).count();
        let run = first..first + few.max(1);
        let end = ends[run.end - 1];
        let span = end.checked_sub(self.offset).ok_or_else(|| self.disorder(end))?;
        if span > MOST_VERTICES {
            self.skip(self.kind(types[first])?, span, bytes, ids)?;
            out.push(CellKind::Flat, &[]);
            self.faces.pass(face_ends, first).map_err(|wrong| self.wrong_faces(wrong))?;
            (self.offset, self.at, *used) = (end, self.at + 1, run.end);
            return Ok(());
        }
        self.connectivity.read(span as usize, bytes, ids)?;
        if is_polyhedron {
            self.polyhedron(face_ends, first, base, bytes, ids, out)?;
            (self.offset, self.at, *used) = (end, self.at + 1, run.end);
            return Ok(());
        }
        let start = self.offset;
        for i in run.clone() {
            let kind = self.kind(types[i])?;
            let span = ends[i].checked_sub(self.offset).map(|_| self.offset - start..ends[i] - start);
            let span = span.ok_or_else(|| self.disorder(ends[i]))?;
            let vertices = ids.get_mut(span.start as usize..span.end as usize);
            let vertices = vertices.ok_or_else(|| self.disorder(ends[i]))?;
            self.push(kind, base, vertices, out)?;
            self.faces.pass(face_ends, i).map_err(|wrong| self.wrong_faces(wrong))?;
            (self.offset, self.at) = (ends[i], self.at + 1);
        }
        *used = run.end;
        Ok(())
    }

    /// Appends a polyhedron, the `i`-th of the cells that wait; `vertices` are those that the file
    /// lists for it.
    fn polyhedron(
        &mut self,
        face_ends: &[u64],
        i: usize,
        base: u64,
        bytes: &mut Vec<u8>,
        vertices: &mut [u64],
        out: &mut CellBlock,
    ) -> Result<()> {
        let mut numbers = vec![];
        if let Err(failed) = self.faces.read(face_ends, i, bytes, &mut numbers) {
            return Err(match failed {
                Failed::Faces(wrong) => self.wrong_faces(wrong),
                Failed::Reading(error) => error,
            });
        }
        vertices.sort_unstable();
        let mut at = 0;
        while at < numbers.len() {
            let end = at + 1 + numbers[at] as usize;
            for v in &mut numbers[at + 1..end] {
                if *v >= self.points {
                    return Err(self.wrong(format!("points of faces below {}", self.points), shown(*v)));
                }
                if vertices.binary_search(v).is_err() {
                    let expected = "faces of the points that are listed for the cell";
                    return Err(self.wrong(expected, shown(*v)));
                }
                *v += base;
            }
            at = end;
        }
        out.push_polyhedron(&numbers);
        Ok(())
    }

    fn disorder(&self, end: u64) -> Error {
        self.wrong(format!("offsets that ascend, {} or more", self.offset), end.to_string())
    }

    fn kind(&self, number: u64) -> Result<CellKind> {
        if number == POLYHEDRON {
            return Ok(CellKind::Polyhedron);
        }
        CellKind::from_vtk(number).map_err(|name| {
            let expected =
                "a polyhedron, or a linear or quadratic cell: tetrahedron, hexahedron, voxel, wedge, pyramid";
            self.wrong(expected, name).with_help("convert it to tetrahedra first")
        })
    }

    /// Appends a cell; its vertices become numbers among the points of all pieces.
    fn push(&self, kind: CellKind, base: u64, vertices: &mut [u64], out: &mut CellBlock) -> Result<()> {
        if kind == CellKind::Flat {
            out.push(kind, &[]);
            return Ok(());
        }
        if vertices.len() != kind.vertices() {
            let expected = format!("{} vertices of {}", kind.vertices(), kind.plural());
            return Err(self.wrong(expected, vertices.len().to_string()));
        }
        for v in vertices.iter_mut() {
            if *v >= self.points {
                let expected = format!("vertices below {}", self.points);
                return Err(self.wrong(expected, shown(*v)));
            }
            *v += base;
        }
        out.push(kind, vertices);
        Ok(())
    }

    /// Goes over the vertices of a cell that has too many to be held.
    fn skip(&mut self, kind: CellKind, mut n: u64, bytes: &mut Vec<u8>, ids: &mut Vec<u64>) -> Result<()> {
        if kind != CellKind::Flat {
            let expected = match kind {
                CellKind::Polyhedron => format!("at most {MOST_VERTICES} points of a polyhedron"),
                _ => format!("{} vertices of {}", kind.vertices(), kind.plural()),
            };
            return Err(self.wrong(expected, n.to_string()));
        }
        while n > 0 {
            let some = n.min(MOST_VERTICES);
            self.connectivity.read(some as usize, bytes, ids)?;
            n -= some;
        }
        Ok(())
    }
}

impl CellStream for PieceCells {
    fn next_block(&mut self, out: &mut CellBlock) -> Result<bool> {
        out.clear();
        loop {
            if let Some(open) = self.open.as_mut().filter(|o| o.left > 0 || o.waits()) {
                open.read(self.base, &mut self.bytes, &mut self.ids, out)?;
                return Ok(true);
            }
            if let Some(mut done) = self.open.take() {
                done.finish()?;
                self.base += done.points;
            }
            let Some(piece) = self.shared.pieces.get(self.piece) else { return Ok(false) };
            self.open = Some(OpenCells::open(piece)?);
            self.piece += 1;
        }
    }
}

#[cfg(test)]
mod tests;
