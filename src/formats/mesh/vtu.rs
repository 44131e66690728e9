//! Writes VTU files: VTK XML UnstructuredGrid, of tetrahedra.
//!
//! A file has one piece. Its arrays are appended raw, so that each is one run of bytes that a
//! reader may map. All lengths follow from the two counts, so the XML header is final before the
//! first point, and the memory used is that of a buffer.
//!
//! ```text
//! <VTKFile type="UnstructuredGrid" … byte_order="LittleEndian" header_type="UInt64">
//!   …  DataArray … format="appended" offset="N"     N counted from the byte after the '_'
//!   <AppendedData encoding="raw">
//!    _[u64 length][Points 3 × f64 a point]
//!     [u64 length][the field f32 a point]                  (f64 where it is counted from an offset)
//!     [u64 length][connectivity 4 × i64 a tetrahedron]
//!     [u64 length][offsets i64 a tetrahedron: 4, 8, 12, …]
//!     [u64 length][types u8 a tetrahedron: 10]
//!   </AppendedData>
//! </VTKFile>
//! ```
//!
//! Arrays may be compressed (`compressor="vtkZLibDataCompressor"`). Each is then cut into blocks of
//! 1 MiB, and in place of its length there is
//!
//! ```text
//!     [u64 blocks n][u64 bytes of a block][u64 bytes of the last one, 0 if it is full][n × u64 compressed bytes][zlib streams]
//! ```
//!
//! The compressed lengths are known only at the end, so the streams wait in a nameless file next to
//! the target until the header is written.
//!
//! Coordinates are `f64`: the lattice is finer than `f32` can resolve, and rounding could turn over
//! a flat tetrahedron. Every tetrahedron has a positive volume as VTK counts it, also where the
//! volume's geometry mirrors. On a curvilinear grid this excludes those that its coordinates turn
//! over: tetrahedra in folded cells, and slivers where cells are bent.

use crate::bytes::store::{read_at, write_at};
use crate::error::{Error, Result};
use crate::formats::shared::sink::Sink;
use crate::formats::shared::text::xml_attribute;
use crate::geom::LatticePos;
use crate::tets::StoredTets;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use std::fs::File;
use std::io::Write;
use std::path::Path;

/// VTK's number of a tetrahedron.
const VTK_TETRA: u8 = 10;

/// What a file states besides the mesh.
pub(crate) struct TetMeta<'a> {
    /// World position of a lattice position.
    pub place: &'a dyn Fn(LatticePos) -> Result<[f64; 3]>,
    /// Whether that turns tetrahedra over.
    pub mirrors: bool,
    /// Name of the field.
    pub field: String,
    /// The offset that is added to all values; where it is not 0, they are written as `f64`.
    pub offset: f64,
    /// Free text, a line.
    pub comment: String,
    /// Compresses the arrays on the threads of a pool; they are written as they are without one.
    pub compress: Option<&'a rayon::ThreadPool>,
}

impl TetMeta<'_> {
    fn value_bytes(&self) -> u64 {
        if self.offset == 0.0 { 4 } else { 8 }
    }
}

/// The arrays of a file, in order.
const ARRAYS: [Array; 5] = [Array::Points, Array::Values, Array::Connectivity, Array::Offsets, Array::Types];

#[derive(Clone, Copy)]
enum Array {
    Points,
    Values,
    Connectivity,
    Offsets,
    Types,
}

/// Writes a mesh to `path` and returns the bytes of the file. A mesh without tetrahedra gives an
/// empty, valid file.
///
/// # Errors
/// [`crate::Error::Usage`] when the target is a folder or lies in none; [`crate::Error::Io`] when
/// the system refuses to write; those of reading the mesh. After an error nothing new lies under
/// `path`.
pub(crate) fn write_vtu(mesh: &StoredTets, path: &Path, meta: &TetMeta<'_>) -> Result<u64> {
    let mut sink = Sink::create(path)?;
    match meta.compress {
        None => put_plain(mesh, meta, &mut sink)?,
        Some(pool) => put_compressed(mesh, meta, pool, &mut sink)?,
    }
    sink.put(b"\n  </AppendedData>\n</VTKFile>\n")?;
    sink.publish()
}

fn put_plain(mesh: &StoredTets, meta: &TetMeta<'_>, sink: &mut Sink<'_>) -> Result<()> {
    let (points, tets) = (mesh.point_count(), mesh.tet_count());
    // Fewer than 2^59 of each: no product overflows.
    let lengths = [24 * points, meta.value_bytes() * points, 32 * tets, 8 * tets, tets];
    sink.put(head(mesh, lengths.map(|length| 8 + length), meta).as_bytes())?;
    for (array, length) in ARRAYS.into_iter().zip(lengths) {
        sink.put(&length.to_le_bytes())?;
        each_part(mesh, meta, array, &mut |bytes| sink.put(bytes))?;
    }
    Ok(())
}

fn put_compressed(
    mesh: &StoredTets,
    meta: &TetMeta<'_>,
    pool: &rayon::ThreadPool,
    sink: &mut Sink<'_>,
) -> Result<()> {
    let scratch = sink.scratch()?.expect("meshes are written to files");
    let failed = |e| Error::io("write compressed arrays beside", sink.target(), e);
    let mut packer = Packer { pool, file: &scratch, at: 0, waiting: vec![], table: vec![] };
    let mut packed = vec![];
    for array in ARRAYS {
        each_part(mesh, meta, array, &mut |bytes| packer.put(bytes).map_err(failed))?;
        packed.push(packer.finish().map_err(failed)?);
    }
    let lengths = std::array::from_fn(|array| packed[array].0.len() as u64 + packed[array].1);
    sink.put(head(mesh, lengths, meta).as_bytes())?;
    let (mut buffer, mut at) = (vec![0; BLOCK], 0);
    for (header, mut left) in packed {
        sink.put(&header)?;
        while left > 0 {
            let part = &mut buffer[..left.min(BLOCK as u64) as usize];
            read_at(&scratch, part, at)
                .map_err(|e| Error::io("read compressed arrays beside", sink.target(), e))?;
            sink.put(part)?;
            (at, left) = (at + part.len() as u64, left - part.len() as u64);
        }
    }
    Ok(())
}

/// Hands the bytes of an array to `put`, part by part.
fn each_part(
    mesh: &StoredTets,
    meta: &TetMeta<'_>,
    array: Array,
    put: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    let (mut bytes, tets) = (Vec::new(), mesh.tet_count());
    match array {
        Array::Points => mesh.points(&mut |batch| {
            bytes.clear();
            for point in batch {
                (meta.place)(point.pos)?.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
            }
            put(&bytes)
        }),
        Array::Values => mesh.points(&mut |batch| {
            bytes.clear();
            match meta.offset {
                0.0 => batch.iter().for_each(|point| bytes.extend(point.value.to_le_bytes())),
                offset => {
                    batch.iter().for_each(|p| bytes.extend((offset + f64::from(p.value)).to_le_bytes()))
                }
            }
            put(&bytes)
        }),
        Array::Connectivity => mesh.tets(&mut |batch| {
            bytes.clear();
            for &[a, b, c, d] in batch {
                let tet = if meta.mirrors { [a, b, d, c] } else { [a, b, c, d] };
                tet.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
            }
            put(&bytes)
        }),
        Array::Offsets => (0..tets).step_by(PART).try_for_each(|first| {
            bytes.clear();
            let here = first + 1..=tets.min(first + PART as u64);
            here.for_each(|n| bytes.extend((4 * n).to_le_bytes()));
            put(&bytes)
        }),
        Array::Types => (0..tets)
            .step_by(PART)
            .try_for_each(|first| put(&[VTK_TETRA; PART][..(tets - first).min(PART as u64) as usize])),
    }
}

/// Tetrahedra whose offsets and types are made at a time.
const PART: usize = 4096;
/// Bytes that are compressed together.
const BLOCK: usize = 1 << 20;
/// Blocks that are compressed at a time, in parallel.
const BLOCKS: usize = 8;
/// Bytes of memory that compression takes: those that wait, a part of an array more, and the same
/// compressed.
pub(crate) const PACKING_BYTES: u64 = 3 * (BLOCKS * BLOCK) as u64;

/// Compresses arrays into a file, one after another.
struct Packer<'a> {
    pool: &'a rayon::ThreadPool,
    file: &'a File,
    at: u64,
    /// Bytes to be compressed: fewer than [`BLOCKS`] blocks, and a part of an array.
    waiting: Vec<u8>,
    /// Bytes of each block before and after.
    table: Vec<[u64; 2]>,
}

impl Packer<'_> {
    fn put(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.waiting.extend_from_slice(bytes);
        let full = self.waiting.len() / BLOCK;
        if full < BLOCKS {
            return Ok(());
        }
        self.pack(full * BLOCK)
    }

    /// Compresses the first bytes that wait.
    fn pack(&mut self, bytes: usize) -> std::io::Result<()> {
        let compress = |block: &[u8]| {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
            encoder.write_all(block)?;
            encoder.finish()
        };
        let now = &self.waiting[..bytes];
        let blocks: Vec<_> = self.pool.install(|| now.par_chunks(BLOCK).map(compress).collect());
        for (block, packed) in now.chunks(BLOCK).zip(blocks) {
            let packed = packed?;
            write_at(self.file, &packed, self.at)?;
            self.at += packed.len() as u64;
            self.table.push([block.len() as u64, packed.len() as u64]);
        }
        self.waiting.drain(..bytes);
        Ok(())
    }

    /// Ends an array; returns what comes before its blocks, and their bytes.
    fn finish(&mut self) -> std::io::Result<(Vec<u8>, u64)> {
        self.pack(self.waiting.len())?;
        let last = self.table.last().map_or(0, |block| block[0] % BLOCK as u64);
        let head = [self.table.len() as u64, BLOCK as u64, last];
        let sizes = self.table.iter().map(|block| block[1]);
        let header = head.into_iter().chain(sizes.clone()).flat_map(u64::to_le_bytes).collect();
        let bytes = sizes.sum();
        self.table.clear();
        Ok((header, bytes))
    }
}

fn head(mesh: &StoredTets, lengths: [u64; 5], meta: &TetMeta<'_>) -> String {
    let (points, tets) = (mesh.point_count(), mesh.tet_count());
    let mut offset = 0;
    let [at_points, at_values, at_connectivity, at_offsets, at_types] = lengths.map(|length| {
        let at = offset;
        offset += length;
        at
    });
    let name = xml_attribute(&meta.field);
    let array = |kind: &str, name: &str, components: u32, offset: u64| {
        format!(
            "        <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
             format=\"appended\" offset=\"{offset}\"/>\n"
        )
    };
    let compressor = if meta.compress.is_some() { " compressor=\"vtkZLibDataCompressor\"" } else { "" };
    [
        format!("<?xml version=\"1.0\"?>\n<!-- {} -->\n", meta.comment.replace("--", "- -").replace("--", "- -")),
        "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\"".into(),
        format!("{compressor}>\n"),
        format!("  <UnstructuredGrid>\n    <Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{tets}\">\n"),
        format!("      <PointData Scalars=\"{name}\">\n"),
        array(&format!("Float{}", 8 * meta.value_bytes()), &name, 1, at_values),
        "      </PointData>\n      <Points>\n".into(),
        array("Float64", "Points", 3, at_points),
        "      </Points>\n      <Cells>\n".into(),
        array("Int64", "connectivity", 1, at_connectivity),
        array("Int64", "offsets", 1, at_offsets),
        array("UInt8", "types", 1, at_types),
        "      </Cells>\n    </Piece>\n  </UnstructuredGrid>\n  <AppendedData encoding=\"raw\">\n   _".into(),
    ]
    .concat()
}
