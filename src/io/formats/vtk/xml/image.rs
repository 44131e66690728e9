//! Reads images: extents, pieces of one file or of several, the choice of a field, and pieces as
//! one stream of slabs.

use super::array::{ArrayStream, BlockArray, in_place, scalar_type};
use super::head::{Document, Element};
use crate::bytes::filesystem::allow_open_files;
use crate::bytes::{ByteSource, IoMode};
use crate::cells::{Center, GHOSTS, HIDDEN};
use crate::error::{Error, Result};
use crate::formats::shared::centers::{Picked, first_sample, pick, samples};
use crate::formats::shared::header;
use crate::formats::shared::numbers::to_f64;
use crate::formats::shared::stream::sample_bytes;
use crate::grid::{Geometry, IndexBox};
use crate::volume::chunked::ChunkSource;
use crate::volume::slabs::SlabWalk;
use crate::volume::strided::StridedVolume;
use crate::volume::units::Units;
use crate::volume::{Assumed, FieldInfo, ScalarType, SlabStream, VolumeInfo, VolumeSource};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Pieces that are joined; the checks that they cover the image and agree are quadratic.
const MOST_PIECES: usize = 1 << 13;
/// Pairs of pieces that have samples in common: blocks that share their faces have 13 each.
const MOST_OVERLAPS: usize = 1 << 19;

/// An image or a grid: in one file, or in those that an index lists.
pub(super) struct Image {
    /// The file that was named.
    pub(super) doc: Arc<Document>,
    /// What it is: "ImageData" and so on.
    pub(super) kind: &'static str,
    whole: Extent,
    pub(super) pieces: Vec<Piece>,
    /// The files of an index.
    pub(super) files: Vec<PathBuf>,
}

impl Image {
    /// Reads the head of a file, and those of all that it lists.
    pub(super) fn open(source: &Arc<ByteSource>) -> Result<Self> {
        let doc = Arc::new(Document::open_one_of(
            source,
            &[
                "ImageData",
                "RectilinearGrid",
                "StructuredGrid",
                "PImageData",
                "PRectilinearGrid",
                "PStructuredGrid",
            ],
        )?);
        let whole = extent(&doc, &doc.data, "WholeExtent")?;
        let (kind, pieces, files) = match doc.kind.strip_prefix('P') {
            Some(kind) => {
                let (pieces, files) = listed_pieces(&doc, kind, &whole)?;
                (kind, pieces, files)
            }
            None => (doc.kind, pieces(&doc, &whole)?, vec![]),
        };
        let pieces = covering(&doc, whole.dims, pieces)?;
        Ok(Self { doc, kind, whole, pieces, files })
    }

    /// The field to read, and all that can be listed.
    pub(super) fn choice(&self, wanted: Option<&str>) -> Result<Picked> {
        let doc = self.pieces[0].document()?;
        choose(self, &doc, self.pieces[0].element(&doc)?, wanted)
    }

    /// The samples of all points along x, y, z.
    pub(super) fn points(&self) -> [u64; 3] {
        self.whole.dims
    }
}

pub(super) fn volume(image: &Image, wanted: Option<&str>) -> Result<VolumeSource> {
    let whole = image.whole;
    let of_first = image.pieces[0].document()?;
    let first = image.pieces[0].element(&of_first)?;
    let Picked { field, fields, center, .. } = choose(image, &of_first, first, wanted)?;
    refuse_hidden(image)?;
    let how = how_stored(&of_first, arrays(data_of(first, center)).find(|a| name_of(a) == field.name));
    let how = if center == Center::Cell { format!("cell data, {how}") } else { how };
    let count = image.files.len();
    let how = if count > 0 { format!("{count} files, {how}") } else { how };
    let info = VolumeInfo {
        path: image.doc.source.path().to_path_buf(),
        format: format!("VTK XML {} ({how})", image.kind),
        dims: samples(whole.dims, center),
        geometry: geometry(image, center)?,
        field,
        fields,
        slope: 1.0,
        intercept: 0.0,
        missing: None,
        units: Units::default(),
        notes: vec![],
        data_files: image.files.clone(),
        assumed: Assumed::default(),
        is_labels: false,
    };
    sample_bytes(&info.path, info.dims, info.field.scalar)?;
    let pieces = centred(image, center)?;
    if let [only] = &pieces[..] {
        let doc = only.document()?;
        let element = array(&doc, only, &info.field, center)?;
        let bytes = only.bytes(info.field.scalar.bytes());
        if let Some(offset) = in_place(&doc, element, bytes)? {
            let strides = StridedVolume::packed_strides(info.dims, info.field.scalar);
            let strides = strides.expect("the size of the samples was checked");
            let source = Arc::clone(&doc.source);
            let volume = StridedVolume::new(info, source, offset, doc.big_endian, strides)?;
            return Ok(VolumeSource::Random(Box::new(volume)));
        }
        let blocks = BlockArray::open(&doc, element, info.field.scalar, bytes)?;
        if let Some(array) = blocks {
            return Ok(VolumeSource::Chunked(Arc::new(BlockChunks::new(info, array))));
        }
    }
    Ok(VolumeSource::Stream(Box::new(PieceSlabs::new(info, pieces, center)?)))
}

/// Refuses points and cells that are marked as hidden: what is there would be taken for data.
fn refuse_hidden(image: &Image) -> Result<()> {
    for piece in &image.pieces {
        let doc = &*piece.document()?;
        let element = piece.element(doc)?;
        for (place, hidden) in HIDDEN {
            let Some(array) = arrays(element.child(place)).find(|a| name_of(a) == GHOSTS) else {
                continue;
            };
            let scalar = array.attribute("type").and_then(scalar_type);
            if scalar != Some(ScalarType::U8) {
                return Err(doc.wrong(array, "marks of type UInt8", "another type"));
            }
            let cells = |a: usize| if image.whole.dims[a] > 1 { piece.voxels.dims()[a] - 1 } else { 1 };
            let count: u64 = match place {
                "CellData" => (0..3).map(cells).product(),
                _ => piece.voxels.dims().iter().product(),
            };
            let mut stream = ArrayStream::open(doc, array, ScalarType::U8, count)?;
            let (mut left, mut found, mut marks) = (count, 0u64, vec![]);
            while left > 0 {
                marks.resize(left.min(1 << 16) as usize, 0);
                stream.fill(&mut marks)?;
                found += marks.iter().filter(|&&m| m & hidden != 0).count() as u64;
                left -= marks.len() as u64;
            }
            if found > 0 {
                return Err(doc.wrong(array, "no hidden points or cells", format!("{found} of {count}")).with_help(
                    "give the samples there the value NaN (then see `nan`), or write what is visible as .vtu",
                ));
            }
        }
    }
    Ok(())
}

/// Inclusive bounds, as a first sample and numbers of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Extent {
    lo: [i64; 3],
    dims: [u64; 3],
}

fn extent(doc: &Document, element: &Element, name: &str) -> Result<Extent> {
    let bounds: Option<[i64; 6]> = doc.numbers(element, name)?;
    let b = bounds.ok_or_else(|| doc.wrong(element, format!("an attribute '{name}'"), "none"))?;
    let lo = [b[0], b[2], b[4]];
    // Bounds of 32 bits are what VTK can write; they keep the arithmetic far from overflow.
    let fits = b.iter().all(|&x| i32::try_from(x).is_ok());
    if !fits || (0..3).any(|a| b[2 * a + 1] < lo[a]) {
        let got = element.attribute(name).unwrap_or_default();
        return Err(doc.wrong(
            element,
            format!("{name}: x0 <= x1 and so on, of 32 bits"),
            format!("'{got}'"),
        ));
    }
    Ok(Extent { lo, dims: std::array::from_fn(|a| (b[2 * a + 1] - lo[a]) as u64 + 1) })
}

/// A piece and the samples that it stores.
#[derive(Clone)]
pub(super) struct Piece {
    place: PieceFile,
    /// Its number among the pieces of its file.
    number: usize,
    pub(super) voxels: IndexBox,
}

/// The file of a piece.
#[derive(Clone)]
enum PieceFile {
    Open(Arc<Document>),
    /// One that an index lists: open only while it is read.
    Listed {
        path: PathBuf,
        io: IoMode,
        kind: &'static str,
    },
}

impl Piece {
    /// The file that it is in.
    fn path(&self) -> &Path {
        match &self.place {
            PieceFile::Open(doc) => doc.source.path(),
            PieceFile::Listed { path, .. } => path,
        }
    }

    /// The head of its file.
    pub(super) fn document(&self) -> Result<Arc<Document>> {
        match &self.place {
            PieceFile::Open(doc) => Ok(Arc::clone(doc)),
            PieceFile::Listed { path, io, kind } => {
                Document::open(&Arc::new(ByteSource::open(path, *io)?), kind).map(Arc::new)
            }
        }
    }

    /// Its element in that.
    pub(super) fn element<'a>(&self, doc: &'a Document) -> Result<&'a Element> {
        let element = doc.data.all("Piece").nth(self.number);
        element.ok_or_else(|| doc.wrong(&doc.data, "the pieces that it had when it was opened", "fewer"))
    }

    /// Bytes of its samples; the caller has seen that those of the whole image can be counted.
    fn bytes(&self, sample: usize) -> u64 {
        self.voxels.dims().iter().product::<u64>() * sample as u64
    }
}

/// The samples of a piece, given its extent.
fn voxels_of(doc: &Document, element: &Element, part: &Extent, whole: &Extent) -> Result<IndexBox> {
    let lo = std::array::from_fn(|a| part.lo[a].wrapping_sub(whole.lo[a]) as u64);
    let voxels = IndexBox { lo, hi: std::array::from_fn(|a| lo[a].wrapping_add(part.dims[a])) };
    if (0..3).any(|a| part.lo[a] < whole.lo[a] || voxels.hi[a] > whole.dims[a]) {
        let got = format!("'{}'", element.attribute("Extent").unwrap_or_default());
        return Err(doc.wrong(element, "an Extent within WholeExtent", got));
    }
    Ok(voxels)
}

/// The pieces of one file.
fn pieces(doc: &Arc<Document>, whole: &Extent) -> Result<Vec<Piece>> {
    let mut pieces = vec![];
    for (number, element) in doc.data.all("Piece").enumerate() {
        let voxels = voxels_of(doc, element, &extent(doc, element, "Extent")?, whole)?;
        pieces.push(Piece { place: PieceFile::Open(Arc::clone(doc)), number, voxels });
    }
    expect_some(doc, pieces.len())?;
    Ok(pieces)
}

fn expect_some(doc: &Document, count: usize) -> Result<()> {
    if count == 0 || count > MOST_PIECES {
        return Err(doc.wrong(&doc.data, format!("1 to {MOST_PIECES} pieces"), format!("{count}")));
    }
    Ok(())
}

/// The pieces that an index lists, and their files. Each file has the piece that the index says, at
/// the same place of the world.
fn listed_pieces(doc: &Document, kind: &'static str, whole: &Extent) -> Result<(Vec<Piece>, Vec<PathBuf>)> {
    // Processes without samples write an extent that ends before it begins.
    let is_empty = |element: &&Element| {
        let bounds: Option<[i64; 6]> = doc.numbers(element, "Extent").ok().flatten();
        bounds.is_some_and(|b| (0..3).any(|a| b[2 * a + 1] < b[2 * a]))
    };
    let listed: Vec<&Element> = doc.data.all("Piece").filter(|e| !is_empty(e)).collect();
    expect_some(doc, listed.len())?;
    let (mut pieces, mut files) = (vec![], vec![]);
    for element in listed {
        let part = extent(doc, element, "Extent")?;
        let voxels = voxels_of(doc, element, &part, whole)?;
        let name = element.attribute("Source");
        let name = name.ok_or_else(|| doc.wrong(element, "an attribute 'Source'", "none"))?;
        let (path, io) = (header::sibling(doc.source.path(), name), doc.source.mode());
        if !path.is_file() {
            return Err(doc
                .wrong(element, format!("a file {}", path.display()), "none")
                .with_help("put the missing file there, or correct 'Source'"));
        }
        let own = Document::open(&Arc::new(ByteSource::open(&path, io)?), kind)?;
        let found: Vec<&Element> = own.data.all("Piece").collect();
        let [piece] = found[..] else {
            return Err(own.wrong(
                &own.data,
                "one piece, as in each file of an index",
                found.len().to_string(),
            ));
        };
        if extent(&own, piece, "Extent")? != part {
            let extent = |e: &Element| e.attribute("Extent").unwrap_or_default().to_string();
            let expected = format!("the Extent '{}' of the index", extent(element));
            return Err(own.wrong(piece, expected, format!("'{}'", extent(piece))));
        }
        if kind == "ImageData" {
            expect_same_place(doc, &own)?;
        }
        pieces.push(Piece { place: PieceFile::Listed { path: path.clone(), io, kind }, number: 0, voxels });
        files.push(path);
    }
    Ok((pieces, files))
}

/// Refuses a file whose samples lie elsewhere in the world than its index says.
fn expect_same_place(index: &Document, own: &Document) -> Result<()> {
    for (name, usual) in PLACE {
        let text = |doc: &Document| doc.data.attribute(name).unwrap_or(usual).to_string();
        let numbers = |text: &str| -> Vec<f64> {
            text.split_ascii_whitespace().map(|w| w.parse().unwrap_or(f64::NAN)).collect()
        };
        let [of_index, of_file] = [text(index), text(own)];
        let (a, b) = (numbers(&of_index), numbers(&of_file));
        let is_same = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-9 * a.abs().max(b.abs());
        if a.len() != b.len() || !a.iter().zip(&b).all(is_same) {
            let expected = format!("the {name} '{of_index}' of the index");
            return Err(own.wrong(&own.data, expected, format!("'{of_file}'")));
        }
    }
    Ok(())
}

/// What places an image, and its defaults.
const PLACE: [(&str, &str); 3] =
    [("Origin", "0 0 0"), ("Spacing", "1 1 1"), ("Direction", "1 0 0 0 1 0 0 0 1")];

/// The pieces with the samples that they have of a field: all of its points, or its cells, which
/// lie between points of one piece.
fn centred(image: &Image, center: Center) -> Result<Vec<Piece>> {
    let (mut pieces, points) = (image.pieces.clone(), image.whole.dims);
    if center == Center::Cell {
        for piece in &mut pieces {
            let IndexBox { lo, hi } = piece.voxels;
            piece.voxels.hi =
                std::array::from_fn(|a| if points[a] > 1 { hi[a] - 1 } else { hi[a] }.max(lo[a]));
        }
        pieces.retain(|p| !p.voxels.is_empty());
        return covering(&image.doc, samples(points, center), pieces);
    }
    Ok(pieces)
}

/// Checks that every sample is in some piece, and few are in many.
fn covering(doc: &Document, dims: [u64; 3], pieces: Vec<Piece>) -> Result<Vec<Piece>> {
    let common = |a: &Piece, b: &Piece| !a.voxels.intersect(&b.voxels).is_empty();
    let mut overlaps = 0;
    for (n, piece) in pieces.iter().enumerate() {
        overlaps += pieces[..n].iter().filter(|before| common(before, piece)).count();
        if overlaps > MOST_OVERLAPS {
            let expected = format!("at most {MOST_OVERLAPS} pairs of pieces with samples in common");
            return Err(doc.wrong(&doc.data, expected, "more"));
        }
    }
    match uncovered(dims, &pieces) {
        None => Ok(pieces),
        Some(p) => {
            let got = format!("none for sample ({}, {}, {})", p[0], p[1], p[2]);
            Err(doc.wrong(&doc.data, "pieces that cover WholeExtent", got))
        }
    }
}

/// A sample that no piece stores, if there is one. Pieces change only where one begins or ends, so
/// a few samples stand for all: those are tried plane by plane, row by row.
fn uncovered(dims: [u64; 3], pieces: &[Piece]) -> Option<[u64; 3]> {
    let starts = |axis: usize, of: &[&Piece]| {
        let mut at: Vec<u64> = of.iter().flat_map(|p| [p.voxels.lo[axis], p.voxels.hi[axis]]).collect();
        at.push(0);
        at.retain(|&x| x < dims[axis]);
        at.sort_unstable();
        at.dedup();
        at
    };
    let across = |of: &[&Piece], axis: usize, at: u64| -> Vec<usize> {
        let holds = |p: &&Piece| (p.voxels.lo[axis]..p.voxels.hi[axis]).contains(&at);
        (0..of.len()).filter(|&i| holds(&of[i])).collect()
    };
    let all: Vec<&Piece> = pieces.iter().collect();
    for z in starts(2, &all) {
        let plane: Vec<&Piece> = across(&all, 2, z).into_iter().map(|i| all[i]).collect();
        for y in starts(1, &plane) {
            let row: Vec<&Piece> = across(&plane, 1, y).into_iter().map(|i| plane[i]).collect();
            for x in starts(0, &row) {
                if across(&row, 0, x).is_empty() {
                    return Some([x, y, z]);
                }
            }
        }
    }
    None
}

/// VTK's `Direction` is a matrix, row by row, whose columns are the directions of the axes.
fn geometry(image: &Image, center: Center) -> Result<Geometry> {
    let Image { doc, whole, kind, .. } = image;
    if *kind != "ImageData" {
        // The grid's coordinates say where its samples are.
        return Ok(Geometry::default());
    }
    let origin: [f64; 3] = doc.numbers(&doc.data, "Origin")?.unwrap_or([0.0; 3]);
    let spacing: [f64; 3] = doc.numbers(&doc.data, "Spacing")?.unwrap_or([1.0; 3]);
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let rows: [f64; 9] = doc.numbers(&doc.data, "Direction")?.unwrap_or(identity);
    let columns: [[f64; 3]; 3] =
        std::array::from_fn(|a| std::array::from_fn(|i| rows[3 * i + a] * spacing[a]));
    let first = first_sample(whole.dims, center);
    let first: [f64; 3] = std::array::from_fn(|a| whole.lo[a] as f64 + first[a]);
    let step = |i: usize| -> f64 { (0..3).map(|a| columns[a][i] * first[a]).sum() };
    let origin = std::array::from_fn(|i| origin[i] + step(i));
    header::geometry(doc.source.path(), "Origin, Spacing and Direction", origin, columns)
}

/// The arrays of a piece.
fn data_of(piece: &Element, center: Center) -> Option<&Element> {
    piece.child(match center {
        Center::Point => "PointData",
        Center::Cell => "CellData",
    })
}

/// The field to read, and all that can be listed.
fn choose(image: &Image, doc: &Document, piece: &Element, wanted: Option<&str>) -> Result<Picked> {
    let of = |center| fields(doc, data_of(piece, center));
    let (points, cells) = (of(Center::Point)?, of(Center::Cell)?);
    let active = |center| data_of(piece, center).and_then(|d| d.attribute("Scalars"));
    pick(image.doc.source.path(), points, cells, wanted, active)
}

pub(super) fn arrays(data: Option<&Element>) -> impl Iterator<Item = &Element> {
    data.into_iter().flat_map(|d| d.all("DataArray"))
}

pub(super) fn name_of(array: &Element) -> String {
    array.attribute("Name").unwrap_or("data").to_string()
}

/// The numeric arrays of the point or cell data.
pub(super) fn fields(doc: &Document, data: Option<&Element>) -> Result<Vec<FieldInfo>> {
    let mut fields = vec![];
    for array in arrays(data).filter(|a| doc.kind.ends_with("UnstructuredGrid") || name_of(a) != GHOSTS) {
        let Some(scalar) = array.attribute("type").and_then(scalar_type) else { continue };
        let components = doc.count(array, "NumberOfComponents", 1)?;
        let components = u32::try_from(components).ok().filter(|&n| n > 0);
        let components = components
            .ok_or_else(|| doc.wrong(array, "a NumberOfComponents of 32 bits, not 0", "another"))?;
        fields.push(FieldInfo { name: name_of(array), scalar, components });
    }
    Ok(fields)
}

/// The array of the field in a piece.
fn array<'a>(doc: &'a Document, piece: &Piece, field: &FieldInfo, center: Center) -> Result<&'a Element> {
    let element = piece.element(doc)?;
    let same = |a: &&Element| {
        let components = doc.count(a, "NumberOfComponents", 1);
        let scalar = a.attribute("type").and_then(scalar_type);
        name_of(a) == field.name && scalar == Some(field.scalar) && components.is_ok_and(|n| n == 1)
    };
    arrays(data_of(element, center)).find(same).ok_or_else(|| {
        let expected = format!("an array '{}' of type {} in every piece", field.name, field.scalar.name());
        doc.wrong(element, expected, "none like it")
    })
}

/// "appended raw, zlib, UInt64 header" and so on, for people.
pub(super) fn how_stored(doc: &Document, element: Option<&Element>) -> String {
    let place = match element.and_then(|e| e.attribute("format")).unwrap_or("ascii") {
        "binary" => "inline base64",
        "appended" if doc.appended.is_some_and(|a| a.base64) => "appended base64",
        "appended" => "appended raw",
        _ => return "ascii".into(),
    };
    format!("{place}, {}", doc.layout)
}

/// The least bytes that are decoded together, and the least blocks: those at both ends are decoded
/// for their neighbours too.
const CHUNK_BYTES: u64 = 256 << 10;
const BLOCKS_TOGETHER: u64 = 8;

/// The samples of one piece whose blocks lie in the file as they are: some rows or slices each
/// time.
struct BlockChunks {
    info: VolumeInfo,
    array: BlockArray,
    chunk: [u64; 3],
}

impl BlockChunks {
    fn new(info: VolumeInfo, array: BlockArray) -> Self {
        let [x, y, z] = info.dims;
        let row = x * info.field.scalar.bytes() as u64;
        let bytes = CHUNK_BYTES.max(array.block_bytes().saturating_mul(BLOCKS_TOGETHER));
        let rows = (bytes / row).clamp(1, y);
        let slices = if rows == y { (bytes / (row * y)).clamp(1, z) } else { 1 };
        Self { info, array, chunk: [x, rows, slices] }
    }
}

impl ChunkSource for BlockChunks {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn chunk_dims(&self) -> [u64; 3] {
        self.chunk
    }

    fn decoding_bytes(&self) -> u64 {
        let chunk = self.chunk.iter().product::<u64>() * self.info.field.scalar.bytes() as u64;
        chunk.saturating_add(self.array.working_bytes())
    }

    fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        let (d, size) = (self.info.dims, self.info.field.scalar.bytes());
        let lo: [u64; 3] = std::array::from_fn(|a| (at[a] * self.chunk[a]).min(d[a]));
        let part = IndexBox { lo, hi: std::array::from_fn(|a| (lo[a] + self.chunk[a]).min(d[a])) };
        out.clear();
        out.resize(part.len() * size, 0);
        self.array.fill((IndexBox::whole(d).offset(lo) * size) as u64, out)
    }
}

/// The samples of one or several pieces as slabs of the whole image.
struct PieceSlabs {
    info: VolumeInfo,
    joined: Joined,
}

impl PieceSlabs {
    fn new(info: VolumeInfo, pieces: Vec<Piece>, center: Center) -> Result<Self> {
        let what = What::Field(info.field.clone(), center);
        Ok(Self { joined: Joined::new(info.dims, info.field.scalar, what, pieces)?, info })
    }
}

impl SlabStream for PieceSlabs {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn working_bytes(&self) -> u64 {
        self.joined.working_bytes.saturating_add(4 << 20)
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        self.joined.next_slab(out)
    }
}

/// What is read of each piece.
pub(super) enum What {
    Field(FieldInfo, Center),
    /// The positions of its samples: x, y, z of each.
    Points,
}

impl What {
    /// The array in a piece, whose numbers are of a type.
    fn open(&self, doc: &Document, piece: &Piece, scalar: ScalarType) -> Result<ArrayStream> {
        let element = match self {
            Self::Field(field, center) => array(doc, piece, field, *center)?,
            Self::Points => points_of(doc, piece, Some(scalar))?,
        };
        ArrayStream::open(doc, element, scalar, piece.bytes(self.numbers() * scalar.bytes()))
    }

    /// Numbers a sample.
    fn numbers(&self) -> usize {
        match self {
            Self::Field(..) => 1,
            Self::Points => 3,
        }
    }
}

/// The array of the positions of a piece's samples, of this type or of any.
pub(super) fn points_of<'a>(
    doc: &'a Document,
    piece: &Piece,
    scalar: Option<ScalarType>,
) -> Result<&'a Element> {
    let element = piece.element(doc)?;
    let array = element.child("Points").and_then(|p| p.child("DataArray"));
    let array = array.ok_or_else(|| doc.wrong(element, "a DataArray in Points", "none"))?;
    let found = array.attribute("type").and_then(scalar_type);
    if found.is_none() || (scalar.is_some() && found != scalar) {
        let expected = scalar.map_or("numbers".into(), |s| format!("numbers of type {}", s.name()));
        return Err(doc.wrong(array, expected, array.attribute("type").unwrap_or("no type").to_string()));
    }
    Ok(array)
}

/// The numbers of all pieces as slabs of the whole image, in its order. A piece is decoded front to
/// back, and is open only while slabs pass through it: memory is that of a slab and of the decoders
/// that are open together. Samples that several pieces have must be the same in all of them.
pub(super) struct Joined {
    what: What,
    scalar: ScalarType,
    walk: SlabWalk,
    /// Ordered by their first slices, so that pieces one above the other are not open together.
    pieces: Vec<OpenPiece>,
    row: Vec<u8>,
    working_bytes: u64,
}

struct OpenPiece {
    piece: Piece,
    /// The samples that pieces before it have too, and the numbers of those pieces.
    shared: Vec<(IndexBox, usize)>,
    stream: Option<ArrayStream>,
}

/// The most that pieces need together: those that some slice crosses are open at one time.
fn most_at_once(needs: &[(IndexBox, u64)]) -> u64 {
    // (slice, whether a piece begins there, what it needs): ends come first.
    let ends = needs.iter().flat_map(|&(b, n)| [(b.lo[2], true, n), (b.hi[2], false, n)]);
    let mut ends: Vec<(u64, bool, u64)> = ends.collect();
    ends.sort_unstable();
    let (mut now, mut most) = (0u64, 0);
    for (_, begins, need) in ends {
        now = if begins { now.saturating_add(need) } else { now.saturating_sub(need) };
        most = most.max(now);
    }
    most
}

/// The pieces that are files of their own, each counted as one.
fn files(pieces: &[OpenPiece]) -> Vec<(IndexBox, u64)> {
    let listed = pieces.iter().filter(|o| matches!(o.piece.place, PieceFile::Listed { .. }));
    listed.map(|o| (o.piece.voxels, 1)).collect()
}

impl Joined {
    /// The pieces of an image of so many samples, whose numbers are of a type.
    pub(super) fn new(
        dims: [u64; 3],
        scalar: ScalarType,
        what: What,
        mut pieces: Vec<Piece>,
    ) -> Result<Self> {
        pieces.sort_by_key(|p| p.voxels.lo[2]);
        let (mut needs, mut open): (_, Vec<OpenPiece>) = (vec![], vec![]);
        for piece in pieces {
            // Every header is checked before the first slab.
            let stream = what.open(&*piece.document()?, &piece, scalar)?;
            needs.push((piece.voxels, stream.working_bytes()));
            let common = |(n, before): (usize, &OpenPiece)| (piece.voxels.intersect(&before.piece.voxels), n);
            let shared = open.iter().enumerate().map(common).filter(|(b, _)| !b.is_empty()).collect();
            open.push(OpenPiece { piece, shared, stream: None });
        }
        let at_once = most_at_once(&files(&open));
        allow_open_files(at_once).map_err(|most| {
            let got = format!("{at_once} files in one");
            let first = open.first().map_or(Path::new(""), |o| o.piece.path());
            Error::bad_input(first, "pieces", format!("slices through at most {most} files"), got)
                .with_help("allow more open files (ulimit -n), or write fewer pieces beside each other")
        })?;
        let walk = SlabWalk::new(dims, what.numbers() * scalar.bytes());
        Ok(Self { what, scalar, walk, pieces: open, row: vec![], working_bytes: most_at_once(&needs) })
    }

    /// The next slab of the image, in `out`; `None` after the last.
    pub(super) fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        out.clear();
        let Some(slab) = self.walk.next() else { return Ok(None) };
        out.resize(slab.len() * self.what.numbers() * self.scalar.bytes(), 0);
        for number in 0..self.pieces.len() {
            if !self.pieces[number].piece.voxels.intersect(&slab).is_empty() {
                self.copy(number, &slab, out)?;
            }
        }
        Ok(Some(slab))
    }

    /// Copies what piece `number` has of the slab into `out`.
    fn copy(&mut self, number: usize, slab: &IndexBox, out: &mut [u8]) -> Result<()> {
        let size = self.what.numbers() * self.scalar.bytes();
        let open = &mut self.pieces[number];
        let voxels = open.piece.voxels;
        let common = voxels.intersect(slab);
        if open.stream.is_none() {
            open.stream = Some(self.what.open(&*open.piece.document()?, &open.piece, self.scalar)?);
        }
        let stream = open.stream.as_mut().expect("it was opened above");
        if common == *slab && open.shared.iter().all(|(b, _)| b.intersect(slab).is_empty()) {
            // A piece as wide as the image: its part is one run.
            stream.fill(out)?;
        } else {
            self.row.resize(voxels.dims()[0] as usize * size, 0);
            for z in common.lo[2]..common.hi[2] {
                for y in common.lo[1]..common.hi[1] {
                    stream.fill(&mut self.row)?;
                    let holds =
                        |b: &IndexBox| (b.lo[1]..b.hi[1]).contains(&y) && (b.lo[2]..b.hi[2]).contains(&z);
                    for (both, before) in open.shared.iter().filter(|(b, _)| holds(b)) {
                        let count = both.dims()[0] as usize * size;
                        let at = slab.offset([both.lo[0], y, z]) * size;
                        let own = (both.lo[0] - voxels.lo[0]) as usize * size;
                        let (a, b) = (&out[at..at + count], &self.row[own..own + count]);
                        if let Some(n) = differing(self.scalar, a, b) {
                            let sample = [both.lo[0] + n / self.what.numbers() as u64, y, z];
                            let numbers = [a, b].map(|bytes| number_at(self.scalar, bytes, n));
                            let pieces = [*before, number];
                            return Err(self.disagree(pieces, sample, numbers));
                        }
                    }
                    let at = slab.offset([common.lo[0], y, z]) * size;
                    out[at..at + self.row.len()].copy_from_slice(&self.row);
                }
            }
        }
        if common.hi[1] == voxels.hi[1] && common.hi[2] == voxels.hi[2] {
            stream.finish()?;
            open.stream = None;
        }
        Ok(())
    }

    /// The error of two pieces that have different numbers for one sample.
    fn disagree(&self, pieces: [usize; 2], [x, y, z]: [u64; 3], numbers: [f64; 2]) -> Error {
        let name = |n: usize| {
            let piece = &self.pieces[n].piece;
            let path = piece.path().to_path_buf();
            let own = match piece.place {
                PieceFile::Open(_) => format!("piece {}", piece.number),
                PieceFile::Listed { .. } => {
                    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
                }
            };
            (path, own)
        };
        let [(_, before), (path, own)] = pieces.map(name);
        let at = format!("sample ({x}, {y}, {z}) of the image");
        let expected = format!("{}, as {before} has it", numbers[0]);
        Error::bad_input(path, at, expected, format!("{} in {own}", numbers[1]))
            .with_help("pieces that overlap must agree: write them again, from one run")
    }
}

/// The first of two rows' numbers that differ, as numbers: not a number is equal to itself.
fn differing(scalar: ScalarType, a: &[u8], b: &[u8]) -> Option<u64> {
    if a == b {
        return None;
    }
    let count = (a.len() / scalar.bytes()) as u64;
    (0..count).find(|&n| {
        let part = |bytes: &[u8]| bytes[n as usize * scalar.bytes()..][..scalar.bytes()].to_vec();
        let [x, y] = [a, b].map(|bytes| number_at(scalar, bytes, n));
        part(a) != part(b) && !(scalar.is_float() && (x == y || x.is_nan() && y.is_nan()))
    })
}

fn number_at(scalar: ScalarType, bytes: &[u8], n: u64) -> f64 {
    let mut out = [0.0];
    to_f64(scalar, &bytes[n as usize * scalar.bytes()..][..scalar.bytes()], &mut out);
    out[0]
}
