//! Reads images: extents, pieces, the choice of a field, and pieces as one stream of slabs.

use super::array::{ArrayStream, BlockArray, in_place, scalar_type};
use super::head::{Document, Element};
use crate::bytes::ByteSource;
use crate::cells::{Center, GHOSTS, HIDDEN};
use crate::error::Result;
use crate::formats::shared::centers::{Picked, first_sample, pick, samples};
use crate::formats::shared::header;
use crate::formats::shared::stream::sample_bytes;
use crate::grid::{Geometry, IndexBox};
use crate::volume::chunked::ChunkSource;
use crate::volume::slabs::SlabWalk;
use crate::volume::strided::StridedVolume;
use crate::volume::{FieldInfo, ScalarType, SlabStream, VolumeInfo, VolumeSource};
use std::sync::Arc;

/// Pieces that are joined; the check that they cover the image is quadratic.
const MOST_PIECES: usize = 1024;

pub(super) fn open(source: &Arc<ByteSource>, wanted: Option<&str>) -> Result<VolumeSource> {
    let doc = Document::open_one_of(source, &["ImageData", "RectilinearGrid", "StructuredGrid"])?;
    let whole = extent(&doc, &doc.data, "WholeExtent")?;
    let pieces = pieces(&doc, &whole)?;
    let first = pieces[0].element;
    let Picked { field, fields, center, .. } = choose(&doc, first, wanted)?;
    refuse_hidden(&doc, &whole, &pieces)?;
    let pieces = centred(&doc, &whole, pieces, center)?;
    let how = how_stored(&doc, arrays(data_of(first, center)).find(|a| name_of(a) == field.name));
    let how = if center == Center::Cell { format!("cell data, {how}") } else { how };
    let info = VolumeInfo {
        path: source.path().to_path_buf(),
        format: format!("VTK XML {} ({how})", doc.kind),
        dims: samples(whole.dims, center),
        geometry: geometry(&doc, &whole, center)?,
        field,
        fields,
        slope: 1.0,
        intercept: 0.0,
        missing: None,
        data_files: vec![],
    };
    sample_bytes(&info.path, info.dims, info.field.scalar)?;
    if let [only] = &pieces[..] {
        let element = array(&doc, only, &info.field, center)?;
        if let Some(offset) = in_place(&doc, element, only.bytes(&info.field))? {
            let strides = StridedVolume::packed_strides(info.dims, info.field.scalar);
            let strides = strides.expect("the size of the samples was checked");
            let volume = StridedVolume::new(info, Arc::clone(source), offset, doc.big_endian, strides)?;
            return Ok(VolumeSource::Random(Box::new(volume)));
        }
        let blocks = BlockArray::open(&doc, element, info.field.scalar, only.bytes(&info.field))?;
        if let Some(array) = blocks {
            return Ok(VolumeSource::Chunked(Arc::new(BlockChunks::new(info, array))));
        }
    }
    Ok(VolumeSource::Stream(Box::new(PieceSlabs::new(doc, info, &whole, center)?)))
}

/// Refuses points and cells that are marked as hidden: what is there would be taken for data.
fn refuse_hidden(doc: &Document, whole: &Extent, pieces: &[Piece<'_>]) -> Result<()> {
    for piece in pieces {
        for (place, hidden) in HIDDEN {
            let Some(array) = arrays(piece.element.child(place)).find(|a| name_of(a) == GHOSTS) else {
                continue;
            };
            let scalar = array.attribute("type").and_then(scalar_type);
            if scalar != Some(ScalarType::U8) {
                return Err(doc.wrong(array, "marks of type UInt8", "another type"));
            }
            let cells = |a: usize| if whole.dims[a] > 1 { piece.voxels.dims()[a] - 1 } else { 1 };
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
                    "give the samples there the value NaN (then see --nan), or write what is visible as .vtu",
                ));
            }
        }
    }
    Ok(())
}

/// Inclusive bounds, as a first sample and numbers of samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    lo: [i64; 3],
    pub(super) dims: [u64; 3],
}

pub(super) fn extent(doc: &Document, element: &Element, name: &str) -> Result<Extent> {
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
pub(super) struct Piece<'a> {
    /// Its number among the pieces of the document.
    number: usize,
    pub(super) element: &'a Element,
    pub(super) voxels: IndexBox,
}

impl Piece<'_> {
    /// Bytes of its samples; the caller has seen that those of the whole image can be counted.
    fn bytes(&self, field: &FieldInfo) -> u64 {
        self.voxels.dims().iter().product::<u64>() * field.scalar.bytes() as u64
    }
}

/// The pieces, which together cover the whole extent.
pub(super) fn pieces<'a>(doc: &'a Document, whole: &Extent) -> Result<Vec<Piece<'a>>> {
    let mut pieces = vec![];
    for (number, element) in doc.data.all("Piece").enumerate() {
        let part = extent(doc, element, "Extent")?;
        let lo = std::array::from_fn(|a| (part.lo[a] - whole.lo[a]) as u64);
        let voxels = IndexBox { lo, hi: std::array::from_fn(|a| lo[a].wrapping_add(part.dims[a])) };
        if (0..3).any(|a| part.lo[a] < whole.lo[a] || voxels.hi[a] > whole.dims[a]) {
            let got = format!("'{}'", element.attribute("Extent").unwrap_or_default());
            return Err(doc.wrong(element, "an Extent within WholeExtent", got));
        }
        pieces.push(Piece { number, element, voxels });
    }
    if pieces.is_empty() || pieces.len() > MOST_PIECES {
        let expected = format!("1 to {MOST_PIECES} pieces");
        return Err(doc.wrong(&doc.data, expected, format!("{}", pieces.len())));
    }
    covering(doc, whole.dims, pieces)
}

/// The pieces with the samples that they have of a field: all of its points, or its cells, which
/// lie between points of one piece.
fn centred<'a>(
    doc: &Document,
    whole: &Extent,
    mut pieces: Vec<Piece<'a>>,
    center: Center,
) -> Result<Vec<Piece<'a>>> {
    if center == Center::Cell {
        for piece in &mut pieces {
            let IndexBox { lo, hi } = piece.voxels;
            piece.voxels.hi =
                std::array::from_fn(|a| if whole.dims[a] > 1 { hi[a] - 1 } else { hi[a] }.max(lo[a]));
        }
        pieces.retain(|p| !p.voxels.is_empty());
        return covering(doc, samples(whole.dims, center), pieces);
    }
    Ok(pieces)
}

/// Checks that every sample is in some piece.
fn covering<'a>(doc: &Document, dims: [u64; 3], pieces: Vec<Piece<'a>>) -> Result<Vec<Piece<'a>>> {
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
fn uncovered(dims: [u64; 3], pieces: &[Piece<'_>]) -> Option<[u64; 3]> {
    let starts = |axis: usize, of: &[&Piece<'_>]| {
        let mut at: Vec<u64> = of.iter().flat_map(|p| [p.voxels.lo[axis], p.voxels.hi[axis]]).collect();
        at.push(0);
        at.retain(|&x| x < dims[axis]);
        at.sort_unstable();
        at.dedup();
        at
    };
    let across = |of: &[&Piece<'_>], axis: usize, at: u64| -> Vec<usize> {
        let holds = |p: &&Piece<'_>| (p.voxels.lo[axis]..p.voxels.hi[axis]).contains(&at);
        (0..of.len()).filter(|&i| holds(&of[i])).collect()
    };
    let all: Vec<&Piece<'_>> = pieces.iter().collect();
    for z in starts(2, &all) {
        let plane: Vec<&Piece<'_>> = across(&all, 2, z).into_iter().map(|i| all[i]).collect();
        for y in starts(1, &plane) {
            let row: Vec<&Piece<'_>> = across(&plane, 1, y).into_iter().map(|i| plane[i]).collect();
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
fn geometry(doc: &Document, whole: &Extent, center: Center) -> Result<Geometry> {
    if doc.kind != "ImageData" {
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
fn choose(doc: &Document, piece: &Element, wanted: Option<&str>) -> Result<Picked> {
    let of = |center| fields(doc, data_of(piece, center));
    let (points, mut cells) = (of(Center::Point)?, of(Center::Cell)?);
    if doc.kind != "ImageData" {
        let cell_fields: Vec<String> = cells.drain(..).map(|f| f.name).collect();
        let refused = |expected: String, got: String| {
            Err(doc.wrong(piece, expected, got).with_help("convert cell data to point data first"))
        };
        let missing = |name: &str| !points.iter().any(|f| f.name == name && f.components == 1);
        if let Some(name) = wanted.filter(|n| missing(n) && cell_fields.iter().any(|c| c == n)) {
            return refused(format!("point data '{name}'"), "cell data of that name".into());
        }
        if points.is_empty() && !cell_fields.is_empty() {
            return refused("point data".into(), format!("cell data only: {}", cell_fields.join(", ")));
        }
    }
    let active = |center| data_of(piece, center).and_then(|d| d.attribute("Scalars"));
    pick(doc.source.path(), points, cells, wanted, active)
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
fn array<'a>(doc: &Document, piece: &Piece<'a>, field: &FieldInfo, center: Center) -> Result<&'a Element> {
    let same = |a: &&Element| {
        let components = doc.count(a, "NumberOfComponents", 1);
        let scalar = a.attribute("type").and_then(scalar_type);
        name_of(a) == field.name && scalar == Some(field.scalar) && components.is_ok_and(|n| n == 1)
    };
    arrays(data_of(piece.element, center)).find(same).ok_or_else(|| {
        let expected = format!("an array '{}' of type {} in every piece", field.name, field.scalar.name());
        doc.wrong(piece.element, expected, "none like it")
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

/// The samples of one or several pieces as slabs of the whole image, in its order. A piece is
/// decoded front to back, and is open only while slabs pass through it: memory is that of a slab
/// and of the decoders that are open together.
struct PieceSlabs {
    doc: Document,
    info: VolumeInfo,
    center: Center,
    walk: SlabWalk,
    /// Ordered by their first slices, so that pieces one above the other are not open together.
    pieces: Vec<OpenPiece>,
    row: Vec<u8>,
    working_bytes: u64,
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

struct OpenPiece {
    number: usize,
    voxels: IndexBox,
    stream: Option<ArrayStream>,
}

impl PieceSlabs {
    fn new(doc: Document, info: VolumeInfo, whole: &Extent, center: Center) -> Result<Self> {
        let found = centred(&doc, whole, pieces(&doc, whole)?, center)?;
        let mut needs = vec![];
        for piece in &found {
            // Every header is checked before the first slab.
            let element = array(&doc, piece, &info.field, center)?;
            let stream = ArrayStream::open(&doc, element, info.field.scalar, piece.bytes(&info.field))?;
            needs.push((piece.voxels, stream.working_bytes()));
        }
        let open = |p: Piece<'_>| OpenPiece { number: p.number, voxels: p.voxels, stream: None };
        let mut pieces: Vec<OpenPiece> = found.into_iter().map(open).collect();
        pieces.sort_by_key(|p| p.voxels.lo[2]);
        let walk = SlabWalk::new(info.dims, info.field.scalar.bytes());
        Ok(Self { doc, info, center, walk, pieces, row: vec![], working_bytes: most_at_once(&needs) })
    }

    /// Copies what piece `number` has of the slab into `out`.
    fn copy(&mut self, number: usize, slab: &IndexBox, out: &mut [u8]) -> Result<()> {
        let size = self.info.field.scalar.bytes();
        let piece = &mut self.pieces[number];
        let common = piece.voxels.intersect(slab);
        if piece.stream.is_none() {
            let element = self.doc.data.all("Piece").nth(piece.number).expect("pieces were listed from it");
            let found = Piece { number: piece.number, element, voxels: piece.voxels };
            let element = array(&self.doc, &found, &self.info.field, self.center)?;
            let bytes = found.bytes(&self.info.field);
            piece.stream = Some(ArrayStream::open(&self.doc, element, self.info.field.scalar, bytes)?);
        }
        let stream = piece.stream.as_mut().expect("it was opened above");
        if common == *slab {
            // A piece as wide as the image: its part is one run.
            stream.fill(out)?;
        } else {
            self.row.resize(piece.voxels.dims()[0] as usize * size, 0);
            for z in common.lo[2]..common.hi[2] {
                for y in common.lo[1]..common.hi[1] {
                    stream.fill(&mut self.row)?;
                    let at = slab.offset([common.lo[0], y, z]) * size;
                    out[at..at + self.row.len()].copy_from_slice(&self.row);
                }
            }
        }
        if common.hi[1] == piece.voxels.hi[1] && common.hi[2] == piece.voxels.hi[2] {
            stream.finish()?;
            piece.stream = None;
        }
        Ok(())
    }
}

impl SlabStream for PieceSlabs {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn working_bytes(&self) -> u64 {
        self.working_bytes.saturating_add(4 << 20)
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        out.clear();
        let Some(slab) = self.walk.next() else { return Ok(None) };
        out.resize(slab.len() * self.info.field.scalar.bytes(), 0);
        for number in 0..self.pieces.len() {
            if !self.pieces[number].voxels.intersect(&slab).is_empty() {
                self.copy(number, &slab, out)?;
            }
        }
        Ok(Some(slab))
    }
}
