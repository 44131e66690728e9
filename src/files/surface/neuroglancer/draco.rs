//! The bytes of a mesh with corners of 16 bits, by Draco.

use draco_core::{
    DataType, DracoError, EncoderBuffer, EncoderOptions, GeometryAttributeType, Mesh, MeshEncoder,
    PointAttribute,
};

/// Draco's level of compression. Higher ones need a sixth fewer bytes, and choose predictions by
/// logarithms of the system, which are not the same on every machine.
const LEVEL: i32 = 5;

/// The corners of a triangle, in steps of a cell.
pub(super) type Corners = [[u16; 3]; 3];

/// Encodes triangles; corners at one place become one vertex.
///
/// The attribute of positions has whole numbers of 32 bits and is not quantized once more, as
/// neuroglancer expects it.
pub(super) fn encode(triangles: &[Corners]) -> Result<Vec<u8>, DracoError> {
    let mut places: Vec<[u16; 3]> = triangles.iter().flatten().copied().collect();
    places.sort_unstable();
    places.dedup();
    let number = |place: &[u16; 3]| places.binary_search(place).expect("all corners are listed") as u32;
    let faces: Vec<u32> = triangles.iter().flatten().map(number).collect();
    let mut positions = PointAttribute::new();
    positions.try_init(GeometryAttributeType::Position, 3, DataType::Int32, false, places.len())?;
    let bytes: Vec<u8> = places.iter().flatten().flat_map(|&x| i32::from(x).to_le_bytes()).collect();
    positions.buffer_mut().write(0, &bytes);
    let mut mesh = Mesh::new();
    mesh.set_num_points(places.len());
    mesh.add_attribute(positions);
    mesh.set_num_faces(triangles.len());
    mesh.set_faces_from_flat_indices(&faces);
    let (mut encoder, mut out) = (MeshEncoder::new(), EncoderBuffer::new());
    encoder.set_mesh(mesh);
    let mut options = EncoderOptions::new();
    options.set_compression_level(LEVEL);
    encoder.encode(&options, &mut out)?;
    Ok(out.data().to_vec())
}
