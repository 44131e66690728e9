//! A volume that isospan does not know: boxes of samples from a file of a camera, which packs two
//! samples of 12 bits in three bytes. `cargo run --example custom_volume`.
//!
//! Nothing is unpacked on disk, and no more of the file is in memory than a box.
#![allow(clippy::print_stdout)]

use isospan::grid::IndexBox;
use isospan::volume::memory::info_of;
use isospan::volume::{ScalarType, VolumeInfo, VolumeReader};
use isospan::{Archive, Error, Reduction, Result, TriMesh};
use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// A file of samples of 12 bits, x fastest; rows have an even number of them.
struct Packed {
    file: File,
    info: VolumeInfo,
}

impl Packed {
    fn open(path: &Path, dims: [u64; 3]) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io("open", path, e))?;
        let length = file.metadata().map_err(|e| Error::io("stat", path, e))?.len();
        let expected = dims.iter().product::<u64>() / 2 * 3;
        if length != expected {
            return Err(Error::bad_input(path, "length", format!("{expected} bytes"), length.to_string()));
        }
        // What a reader says of itself: name, size and type; units and spacing where it knows them.
        let info = info_of(&path.display().to_string(), dims, ScalarType::U16);
        Ok(Self { file, info })
    }

    /// The samples `x` of a row.
    fn read_row(&self, x: [u64; 2], row: u64, out: &mut [f32]) -> Result<()> {
        // Whole pairs around them.
        let (first, last) = (x[0] / 2, x[1].div_ceil(2));
        let mut bytes = vec![0; (last - first) as usize * 3];
        let pair = row * self.info.dims[0] / 2 + first;
        let read = self.file.read_exact_at(&mut bytes, pair * 3);
        read.map_err(|e| Error::io("read", &self.info.path, e))?;
        let values = bytes.chunks_exact(3).flat_map(|b| {
            let [a, b, c] = [b[0], b[1], b[2]].map(u16::from);
            [a | (b & 15) << 8, b >> 4 | c << 4]
        });
        for (out, value) in out.iter_mut().zip(values.skip((x[0] % 2) as usize)) {
            *out = f32::from(value);
        }
        Ok(())
    }
}

impl VolumeReader for Packed {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    /// Called from several threads at a time.
    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()> {
        let [width, height, _] = voxels.dims();
        for (n, out) in (0..).zip(out.chunks_exact_mut(width as usize)) {
            let (y, z) = (voxels.lo[1] + n % height, voxels.lo[2] + n / height);
            self.read_row([voxels.lo[0], voxels.hi[0]], z * self.info.dims[1] + y, out)?;
        }
        Ok(())
    }
}

/// What the camera wrote: squares of distances from the middle.
fn write_packed(path: &Path, side: u64) -> Result<()> {
    let square = |i: u64| (2 * i).abs_diff(side - 1).pow(2);
    let sample = |i: u64| (square(i % side) + square(i / side % side) + square(i / (side * side))).min(4095);
    let pairs = (0..side.pow(3)).step_by(2).map(|i| (sample(i), sample(i + 1)));
    let bytes = pairs.flat_map(|(a, b)| [a as u8, (a >> 8 | (b & 15) << 4) as u8, (b >> 4) as u8]);
    fs::write(path, bytes.collect::<Vec<_>>()).map_err(|e| Error::io("write", path, e))
}

/// Makes the file and an archive in a folder, and returns a surface.
pub(crate) fn run(folder: &Path) -> Result<TriMesh> {
    let (file, archive) = (folder.join("camera.u12"), folder.join("camera.isospan"));
    write_packed(&file, 64)?;
    Reduction::of(Packed::open(&file, [64; 3])?).replace(true).write(&archive)?;
    Archive::open(&archive)?.surface(1600.0)
}

#[allow(dead_code, reason = "the test calls run")]
fn main() -> Result<()> {
    let mesh = run(&std::env::temp_dir())?;
    println!("{} vertices, {} triangles", mesh.vertices.len(), mesh.triangles.len());
    Ok(())
}
