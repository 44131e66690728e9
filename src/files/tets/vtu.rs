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
//!     [u64 length][each field f32 a point]                 (f64 where it is counted from an offset)
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

use super::arrays::{BLOCK, Packed, TetArray, TetField, TetMeta, each_part};
use crate::tets::StoredTets;
use isospan_io::error::Result;
use isospan_io::formats::shared::sink::Sink;
use isospan_io::formats::shared::text::xml_attribute;

/// The arrays of a file, in order.
fn arrays(meta: &TetMeta<'_>) -> Vec<TetArray> {
    let values = (0..meta.fields.len()).map(TetArray::Values);
    let cells = [TetArray::Connectivity, TetArray::Offsets { first: 1 }, TetArray::Types];
    [TetArray::Points].into_iter().chain(values).chain(cells).collect()
}

/// Writes a mesh as VTU.
pub(super) fn write(mesh: &StoredTets, meta: &TetMeta<'_>, sink: &mut Sink<'_>) -> Result<()> {
    match meta.compress {
        None => put_plain(mesh, meta, sink)?,
        Some(pool) => put_compressed(mesh, meta, pool, sink)?,
    }
    sink.put(b"\n  </AppendedData>\n</VTKFile>\n")
}

fn put_plain(mesh: &StoredTets, meta: &TetMeta<'_>, sink: &mut Sink<'_>) -> Result<()> {
    // Fewer than 2^59 points and tetrahedra: no product overflows.
    let arrays = arrays(meta);
    let length = |array: &TetArray| array.size(mesh, meta).iter().product::<u64>();
    sink.put(head(mesh, arrays.iter().map(|array| 8 + length(array)), meta).as_bytes())?;
    for array in arrays {
        let length = length(&array);
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
    let arrays = arrays(meta);
    let packed = Packed::of(mesh, meta, pool, false, &arrays, sink)?;
    let table = |array: usize| -> Vec<u8> {
        let blocks = &packed.blocks[array];
        let last = blocks.last().map_or(0, |block| block[0] % BLOCK as u64);
        let head = [blocks.len() as u64, BLOCK as u64, last];
        head.into_iter().chain(blocks.iter().map(|block| block[1])).flat_map(u64::to_le_bytes).collect()
    };
    let lengths = (0..arrays.len()).map(|array| table(array).len() as u64 + packed.bytes(array));
    sink.put(head(mesh, lengths, meta).as_bytes())?;
    for array in 0..arrays.len() {
        sink.put(&table(array))?;
        packed.put(array, sink)?;
    }
    Ok(())
}

/// The file up to its arrays, which take so many bytes, in the order of [`arrays`].
fn head(mesh: &StoredTets, lengths: impl Iterator<Item = u64>, meta: &TetMeta<'_>) -> String {
    let (points, tets) = (mesh.point_count(), mesh.tet_count());
    let mut offset = 0;
    let mut offsets = lengths.map(|length| {
        let at = offset;
        offset += length;
        at
    });
    // In the order of the arrays.
    let mut array = |kind: &str, name: &str, components: u32| {
        let offset = offsets.next().expect("a length of each array");
        format!(
            "        <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
             format=\"appended\" offset=\"{offset}\"/>\n"
        )
    };
    let positions = array("Float64", "Points", 3);
    let of_field = |field: &TetField| {
        array(&format!("Float{}", 8 * field.value_bytes()), &xml_attribute(&field.name), 1)
    };
    let fields: String = meta.fields.iter().map(of_field).collect();
    let first = meta.fields.first().map_or(String::new(), |field| xml_attribute(&field.name));
    let compressor = if meta.compress.is_some() { " compressor=\"vtkZLibDataCompressor\"" } else { "" };
    [
        format!("<?xml version=\"1.0\"?>\n<!-- {} -->\n", meta.comment.replace("--", "- -").replace("--", "- -")),
        "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\"".into(),
        format!("{compressor}>\n"),
        format!("  <UnstructuredGrid>\n    <Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{tets}\">\n"),
        format!("      <PointData Scalars=\"{first}\">\n"),
        fields,
        "      </PointData>\n      <Points>\n".into(),
        positions,
        "      </Points>\n      <Cells>\n".into(),
        array("Int64", "connectivity", 1),
        array("Int64", "offsets", 1),
        array("UInt8", "types", 1),
        "      </Cells>\n    </Piece>\n  </UnstructuredGrid>\n  <AppendedData encoding=\"raw\">\n   _".into(),
    ]
    .concat()
}
