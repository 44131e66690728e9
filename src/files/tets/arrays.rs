//! What the formats of tetrahedra share: their arrays, in parts, and these compressed.

use crate::tets::StoredTets;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use isospan_io::bytes::store::{read_at, write_at};
use isospan_io::error::{Error, Result};
use isospan_io::formats::shared::sink::Sink;
use isospan_io::geom::LatticePos;
use rayon::prelude::*;
use std::fs::File;
use std::io::Write;

/// What a file states besides the mesh.
pub(crate) struct TetMeta<'a> {
    /// World position of a lattice position.
    pub place: &'a dyn Fn(LatticePos) -> Result<[f64; 3]>,
    /// Whether that turns tetrahedra over.
    pub mirrors: bool,
    /// The fields, in the order of the mesh.
    pub fields: Vec<TetField>,
    /// Free text, a line.
    pub comment: String,
    /// Compresses the arrays on the threads of a pool; they are written as they are without one.
    pub compress: Option<&'a rayon::ThreadPool>,
}

/// What a file states of a field.
pub(crate) struct TetField {
    /// Its name.
    pub name: String,
    /// The offset that is added to all values; where it is not 0, they are written as `f64`.
    pub offset: f64,
}

impl TetField {
    /// Bytes of a value.
    pub(super) fn value_bytes(&self) -> u64 {
        if self.offset == 0.0 { 4 } else { 8 }
    }
}

/// An array of a file.
#[derive(Clone, Copy)]
pub(super) enum TetArray {
    /// 3 × f64 a point.
    Points,
    /// f32 or f64 a point, of the field of a number: see [`TetField::value_bytes`].
    Values(usize),
    /// 4 × i64 a tetrahedron.
    Connectivity,
    /// i64 a tetrahedron: where its vertices end; where they begin as well, from the first number 0
    /// on.
    Offsets { first: u64 },
    /// u8 a tetrahedron.
    Types,
}

impl TetArray {
    /// Its rows, and the bytes of each.
    pub(super) fn size(self, mesh: &StoredTets, meta: &TetMeta<'_>) -> [u64; 2] {
        let (points, tets) = (mesh.point_count(), mesh.tet_count());
        match self {
            Self::Points => [points, 24],
            Self::Values(field) => [points, meta.fields[field].value_bytes()],
            Self::Connectivity => [4 * tets, 8],
            Self::Offsets { first } => [tets + 1 - first, 8],
            Self::Types => [tets, 1],
        }
    }
}

/// Hands the bytes of an array to `put`, part by part.
pub(super) fn each_part(
    mesh: &StoredTets,
    meta: &TetMeta<'_>,
    array: TetArray,
    put: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    let (mut bytes, tets) = (Vec::new(), mesh.tet_count());
    match array {
        TetArray::Points => mesh.points(&mut |batch| {
            bytes.clear();
            for &point in batch {
                (meta.place)(point)?.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
            }
            put(&bytes)
        }),
        TetArray::Values(field) => mesh.values(field, &mut |batch| {
            bytes.clear();
            match meta.fields[field].offset {
                0.0 => batch.iter().for_each(|v| bytes.extend(v.to_le_bytes())),
                offset => batch.iter().for_each(|&v| bytes.extend((offset + f64::from(v)).to_le_bytes())),
            }
            put(&bytes)
        }),
        TetArray::Connectivity => mesh.tets(&mut |batch| {
            bytes.clear();
            for &[a, b, c, d] in batch {
                let tet = if meta.mirrors { [a, b, d, c] } else { [a, b, c, d] };
                tet.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
            }
            put(&bytes)
        }),
        TetArray::Offsets { first } => (first..tets + 1).step_by(PART).try_for_each(|first| {
            bytes.clear();
            let here = first..(tets + 1).min(first + PART as u64);
            here.for_each(|n| bytes.extend((4 * n).to_le_bytes()));
            put(&bytes)
        }),
        TetArray::Types => (0..tets)
            .step_by(PART)
            .try_for_each(|first| put(&[VTK_TETRA; PART][..(tets - first).min(PART as u64) as usize])),
    }
}

/// VTK's number of a tetrahedron.
const VTK_TETRA: u8 = 10;
/// Tetrahedra whose offsets and types are made at a time.
const PART: usize = 4096;
/// Bytes that are compressed together, at most.
pub(super) const BLOCK: usize = 1 << 20;
/// Blocks that are compressed at a time, in parallel.
const BLOCKS: usize = 8;
/// Bytes of memory that compression takes: those that wait, a part of an array more, and the same
/// compressed.
pub(crate) const PACKING_BYTES: u64 = 3 * (BLOCKS * BLOCK) as u64;

/// Arrays that were compressed, in a nameless file.
pub(super) struct Packed {
    file: File,
    /// For each array, the bytes of its blocks before and after.
    pub(super) blocks: Vec<Vec<[u64; 2]>>,
}

impl Packed {
    /// Compresses arrays in blocks of 1 MiB, of which the last is shorter; or, if `in_rows`, in
    /// those of [`block_rows`], of which the last is filled up with zeros.
    pub(super) fn of(
        mesh: &StoredTets,
        meta: &TetMeta<'_>,
        pool: &rayon::ThreadPool,
        in_rows: bool,
        arrays: &[TetArray],
        sink: &Sink<'_>,
    ) -> Result<Self> {
        let file = sink.scratch()?.expect("meshes are written to files");
        let failed = |e| Error::io("write compressed arrays beside", sink.target(), e);
        let mut packer = Packer { pool, file: &file, at: 0, block: 0, waiting: vec![], blocks: vec![] };
        let mut blocks = vec![];
        for &array in arrays {
            let rows = || block_rows(array, mesh, meta) * array.size(mesh, meta)[1];
            packer.block = if in_rows { rows() as usize } else { BLOCK };
            each_part(mesh, meta, array, &mut |bytes| packer.put(bytes).map_err(failed))?;
            blocks.push(packer.finish(in_rows).map_err(failed)?);
        }
        Ok(Self { file, blocks })
    }

    /// Compressed bytes of an array.
    pub(super) fn bytes(&self, array: usize) -> u64 {
        self.blocks[array].iter().map(|block| block[1]).sum()
    }

    /// Writes the compressed bytes of an array.
    pub(super) fn put(&self, array: usize, sink: &mut Sink<'_>) -> Result<()> {
        let mut at = (0..array).map(|before| self.bytes(before)).sum::<u64>();
        let end = at + self.bytes(array);
        let mut buffer = vec![0; BLOCK];
        while at < end {
            let part = &mut buffer[..(end - at).min(BLOCK as u64) as usize];
            read_at(&self.file, part, at)
                .map_err(|e| Error::io("read compressed arrays beside", sink.target(), e))?;
            sink.put(part)?;
            at += part.len() as u64;
        }
        Ok(())
    }
}

/// Rows of an array that are compressed together: 1 of an empty one.
pub(super) fn block_rows(array: TetArray, mesh: &StoredTets, meta: &TetMeta<'_>) -> u64 {
    let [rows, bytes] = array.size(mesh, meta);
    (BLOCK as u64 / bytes).min(rows).max(1)
}

/// Compresses arrays into a file, one after another.
struct Packer<'a> {
    pool: &'a rayon::ThreadPool,
    file: &'a File,
    at: u64,
    /// Bytes of a block of this array.
    block: usize,
    /// Bytes to be compressed: fewer than [`BLOCKS`] blocks, and a part of an array.
    waiting: Vec<u8>,
    /// Bytes of each block before and after.
    blocks: Vec<[u64; 2]>,
}

impl Packer<'_> {
    fn put(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.waiting.extend_from_slice(bytes);
        let full = self.waiting.len() / self.block;
        if full < BLOCKS {
            return Ok(());
        }
        self.pack(full * self.block)
    }

    /// Compresses the first bytes that wait.
    fn pack(&mut self, bytes: usize) -> std::io::Result<()> {
        let compress = |block: &[u8]| {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
            encoder.write_all(block)?;
            encoder.finish()
        };
        let now = &self.waiting[..bytes];
        let blocks: Vec<_> = self.pool.install(|| now.par_chunks(self.block).map(compress).collect());
        for (block, packed) in now.chunks(self.block).zip(blocks) {
            let packed = packed?;
            write_at(self.file, &packed, self.at)?;
            self.at += packed.len() as u64;
            self.blocks.push([block.len() as u64, packed.len() as u64]);
        }
        self.waiting.drain(..bytes);
        Ok(())
    }

    /// Ends an array; returns the bytes of its blocks.
    fn finish(&mut self, fills: bool) -> std::io::Result<Vec<[u64; 2]>> {
        if fills {
            self.waiting.resize(self.waiting.len().next_multiple_of(self.block), 0);
        }
        self.pack(self.waiting.len())?;
        Ok(std::mem::take(&mut self.blocks))
    }
}
