//! From an array in memory to a mesh in memory: `cargo run --example array_to_mesh`.
#![allow(clippy::print_stdout)]

use isospan::grid::Geometry;
use isospan::{Archive, Reduction, Result, TriMesh, volume_of};
use std::path::Path;

/// Samples along x, y, z.
const DIMS: [u64; 3] = [64, 48, 40];
/// Millimetres from one sample to the next.
const SPACING: [f64; 3] = [0.5, 0.5, 1.0];

/// The distance of each sample from the middle, in millimetres; x runs fastest.
fn distances() -> Vec<f32> {
    let mut samples = vec![];
    for z in 0..DIMS[2] {
        for y in 0..DIMS[1] {
            for x in 0..DIMS[0] {
                let from_middle = |a: usize, i: u64| SPACING[a] * (i as f64 - (DIMS[a] - 1) as f64 / 2.0);
                let place = [from_middle(0, x), from_middle(1, y), from_middle(2, z)];
                samples.push(place.iter().map(|c| c * c).sum::<f64>().sqrt() as f32);
            }
        }
    }
    samples
}

/// Makes an archive in a folder, and returns the surface at a distance of 9 mm.
pub(crate) fn run(folder: &Path) -> Result<TriMesh> {
    let volume = volume_of("distances", DIMS, distances())?
        .placed(Geometry { spacing: SPACING, ..Geometry::default() });

    // Once: the archive is a folder of a few kilobytes.
    let path = folder.join("distances.isospan");
    let made = Reduction::of(volume).replace(true).write(&path)?;
    println!("{} bytes, RMS error {:?}", made.archive_bytes, made.error.map(|e| e.rms));

    // As often as you like: vertices are millimetres, triangles are numbers of vertices.
    Archive::open(&path)?.surface(9.0)
}

#[allow(dead_code, reason = "the test calls run")]
fn main() -> Result<()> {
    let mesh = run(&std::env::temp_dir())?;
    println!("{} vertices, {} triangles", mesh.vertices.len(), mesh.triangles.len());
    Ok(())
}
