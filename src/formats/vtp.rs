//! VTP: VTK XML PolyData.
//!
//! We write one piece of triangles, its arrays appended raw, so that each is one run of bytes that a reader may map.
//! All lengths follow from the two counts, so the XML head is final before the first vertex.
//!
//! ```text
//! <VTKFile type="PolyData" … byte_order="LittleEndian" header_type="UInt64">
//!   …  DataArray … format="appended" offset="N"     N counted from the byte after the '_'
//!   <AppendedData encoding="raw">
//!    _[u64 length][Points 3 × f32 a vertex]
//!     [u64 length][Normals 3 × f32 a vertex]
//!     [u64 length][connectivity 3 × i64 a triangle]
//!     [u64 length][offsets i64 a triangle: 3, 6, 9, …]
//!   </AppendedData>
//! </VTKFile>
//! ```
//!
//! The isovalue is a field array `isovalue`.

use crate::error::Result;
use crate::formats::surface::{Sink, SurfaceMeta, each_triangle, each_vertex};
use crate::surface::SurfaceSource;

/// Writes a surface as VTP.
pub(super) fn write(source: &dyn SurfaceSource, sink: &mut Sink, meta: &SurfaceMeta) -> Result<()> {
    let (vertices, triangles) = (source.vertex_count(), source.triangle_count());
    // At most 2³² vertices and far fewer than 2⁵⁸ triangles: no product overflows.
    let lengths = [12 * vertices, 12 * vertices, 24 * triangles, 8 * triangles];
    sink.put(head(vertices, triangles, lengths, meta).as_bytes())?;
    sink.put(&lengths[0].to_le_bytes())?;
    each_vertex(source, sink, |sink, v| put_floats(sink, v.position))?;
    sink.put(&lengths[1].to_le_bytes())?;
    each_vertex(source, sink, |sink, v| put_floats(sink, v.normal))?;
    sink.put(&lengths[2].to_le_bytes())?;
    each_triangle(source, sink, |sink, t| t.iter().try_for_each(|&v| sink.put(&u64::from(v).to_le_bytes())))?;
    sink.put(&lengths[3].to_le_bytes())?;
    for n in 1..=triangles {
        sink.put(&(3 * n).to_le_bytes())?;
    }
    sink.put(b"\n  </AppendedData>\n</VTKFile>\n")
}

fn put_floats(sink: &mut Sink, numbers: [f32; 3]) -> Result<()> {
    numbers.iter().try_for_each(|x| sink.put(&x.to_le_bytes()))
}

fn head(vertices: u64, triangles: u64, lengths: [u64; 4], meta: &SurfaceMeta) -> String {
    let mut offset = 0;
    let [points, normals, connectivity, offsets] = lengths.map(|length| {
        let at = offset;
        offset += 8 + length;
        at
    });
    let comment: String = meta.lines().iter().map(|line| format!("  {}\n", comment_text(line))).collect();
    let isovalue = meta.isovalue.map_or(String::new(), |v| {
        format!(
            "    <FieldData>\n      <DataArray type=\"Float64\" Name=\"isovalue\" NumberOfTuples=\"1\" \
             format=\"ascii\">{v}</DataArray>\n    </FieldData>\n"
        )
    });
    let array = |kind: &str, name: &str, components: u32, offset: u64| {
        format!(
            "        <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
             format=\"appended\" offset=\"{offset}\"/>\n"
        )
    };
    [
        "<?xml version=\"1.0\"?>\n<!-- isospan surface\n".to_string(),
        comment,
        "-->\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n  <PolyData>\n"
            .to_string(),
        isovalue,
        format!(
            "    <Piece NumberOfPoints=\"{vertices}\" NumberOfVerts=\"0\" NumberOfLines=\"0\" \
             NumberOfStrips=\"0\" NumberOfPolys=\"{triangles}\">\n"
        ),
        "      <PointData Normals=\"Normals\">\n".to_string(),
        array("Float32", "Normals", 3, normals),
        "      </PointData>\n      <Points>\n".to_string(),
        array("Float32", "Points", 3, points),
        "      </Points>\n      <Polys>\n".to_string(),
        array("Int64", "connectivity", 1, connectivity),
        array("Int64", "offsets", 1, offsets),
        "      </Polys>\n    </Piece>\n  </PolyData>\n  <AppendedData encoding=\"raw\">\n   _".to_string(),
    ]
    .concat()
}

/// "--" may not stand in an XML comment.
fn comment_text(line: &str) -> String {
    line.replace("--", "- -").replace("--", "- -")
}
