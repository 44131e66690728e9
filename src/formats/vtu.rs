//! VTU: VTK XML UnstructuredGrid, of tetrahedra, written.
//!
//! One piece, its arrays appended raw, so that each is one run of bytes that a reader may map; all lengths follow from the two
//! counts, so the XML head is final before the first point, and the memory used is that of a buffer.
//!
//! ```text
//! <VTKFile type="UnstructuredGrid" … byte_order="LittleEndian" header_type="UInt64">
//!   …  DataArray … format="appended" offset="N"     N counted from the byte after the '_'
//!   <AppendedData encoding="raw">
//!    _[u64 length][Points 3 × f64 a point]
//!     [u64 length][the field f32 a point]
//!     [u64 length][connectivity 4 × i64 a tetrahedron]
//!     [u64 length][offsets i64 a tetrahedron: 4, 8, 12, …]
//!     [u64 length][types u8 a tetrahedron: 10]
//!   </AppendedData>
//! </VTKFile>
//! ```
//!
//! Coordinates are `f64`: the lattice is finer than `f32` tells apart, and a flat tetrahedron could turn over by rounding. Every
//! tetrahedron has a positive volume as VTK counts it, also where the volume's geometry mirrors; of a curvilinear grid all but those
//! that its coordinates turn over: in folded cells, and slivers where cells are bent.

use crate::error::Result;
use crate::formats::surface::Sink;
use crate::geom::LatticePos;
use crate::tets::StoredTets;
use std::path::Path;

/// VTK's number of a tetrahedron.
const VTK_TETRA: u8 = 10;

/// What a file tells besides the mesh.
pub struct TetMeta<'a> {
    /// World position of a lattice position.
    pub place: &'a dyn Fn(LatticePos) -> Result<[f64; 3]>,
    /// Whether that turns tetrahedra over.
    pub mirrors: bool,
    /// Name of the field.
    pub field: String,
    /// Free text, a line.
    pub comment: String,
}

/// Writes a mesh to `path` and returns the bytes of the file. A mesh without tetrahedra gives an empty, valid file.
///
/// # Errors
/// [`crate::Error::Usage`] when the target is a folder or lies in none; [`crate::Error::Io`] when the system refuses to write; those of
/// reading the mesh. After an error nothing new lies under `path`.
pub fn write_vtu(mesh: &StoredTets, path: &Path, meta: &TetMeta<'_>) -> Result<u64> {
    let mut sink = Sink::create(path)?;
    let (points, tets) = (mesh.point_count(), mesh.tet_count());
    // Fewer than 2^59 of each: no product overflows.
    let lengths = [24 * points, 4 * points, 32 * tets, 8 * tets, tets];
    sink.put(head(points, tets, &lengths, meta).as_bytes())?;
    sink.put(&lengths[0].to_le_bytes())?;
    mesh.points(&mut |batch| {
        batch.iter().try_for_each(|p| {
            let world = (meta.place)(p.pos)?;
            world.iter().try_for_each(|x| sink.put(&x.to_le_bytes()))
        })
    })?;
    sink.put(&lengths[1].to_le_bytes())?;
    mesh.points(&mut |batch| batch.iter().try_for_each(|p| sink.put(&p.value.to_le_bytes())))?;
    sink.put(&lengths[2].to_le_bytes())?;
    mesh.tets(&mut |batch| {
        batch.iter().try_for_each(|&[a, b, c, d]| {
            let tet = if meta.mirrors { [a, b, d, c] } else { [a, b, c, d] };
            tet.iter().try_for_each(|v| sink.put(&v.to_le_bytes()))
        })
    })?;
    sink.put(&lengths[3].to_le_bytes())?;
    (1..=tets).try_for_each(|n| sink.put(&(4 * n).to_le_bytes()))?;
    sink.put(&lengths[4].to_le_bytes())?;
    (0..tets).try_for_each(|_| sink.put(&[VTK_TETRA]))?;
    sink.put(b"\n  </AppendedData>\n</VTKFile>\n")?;
    sink.publish()
}

fn head(points: u64, tets: u64, lengths: &[u64; 5], meta: &TetMeta<'_>) -> String {
    let mut offset = 0;
    let [at_points, at_values, at_connectivity, at_offsets, at_types] = lengths.map(|length| {
        let at = offset;
        offset += 8 + length;
        at
    });
    let name = attribute(&meta.field);
    let array = |kind: &str, name: &str, components: u32, offset: u64| {
        format!(
            "        <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
             format=\"appended\" offset=\"{offset}\"/>\n"
        )
    };
    [
        format!("<?xml version=\"1.0\"?>\n<!-- {} -->\n", meta.comment.replace("--", "- -").replace("--", "- -")),
        "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n"
            .into(),
        format!("  <UnstructuredGrid>\n    <Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{tets}\">\n"),
        format!("      <PointData Scalars=\"{name}\">\n"),
        array("Float32", &name, 1, at_values),
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

/// Text as the value of an XML attribute; control characters, which XML has no way to write, become spaces.
pub(super) fn attribute(text: &str) -> String {
    let text: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
