//! Volumes that are folders: a stack of TIFF slices, a Zarr array. Both are made as the slices
//! come.

use crate::{NumberType, Settings};
use isospan::{Error, Result};
use std::path::{Path, PathBuf};

/// Samples along each axis of a Zarr chunk; this many slices are in memory at a time.
const CHUNK: usize = 64;

/// A folder that fills with slices.
pub(crate) enum Folder {
    Tiffs { folder: PathBuf, number: usize },
    Zarr { folder: PathBuf, layer: Vec<u8>, first: usize },
}

impl Folder {
    pub(crate) fn tiffs(folder: &Path) -> Result<Self> {
        create(folder)?;
        Ok(Self::Tiffs { folder: folder.into(), number: 0 })
    }

    pub(crate) fn zarr(folder: &Path, s: &Settings) -> Result<Self> {
        create(folder)?;
        put(&folder.join("zarr.json"), zarr_json(s).as_bytes())?;
        Ok(Self::Zarr { folder: folder.into(), layer: vec![], first: 0 })
    }

    /// Takes the stored samples of the next slice.
    pub(crate) fn slice(&mut self, s: &Settings, samples: &[u8]) -> Result<()> {
        match self {
            Self::Tiffs { folder, number } => {
                let file = folder.join(format!("slice_{number:06}.tif"));
                *number += 1;
                put(&file, &[&tiff_head(s)[..], samples].concat())
            }
            Self::Zarr { folder, layer, first } => {
                layer.extend_from_slice(samples);
                let slices = layer.len() / samples.len();
                if slices == CHUNK || *first + slices == s.dims[2] {
                    write_layer(folder, s, layer, *first)?;
                    *first += slices;
                    layer.clear();
                }
                Ok(())
            }
        }
    }
}

fn create(folder: &Path) -> Result<()> {
    std::fs::create_dir(folder).map_err(|e| Error::io("create the folder", folder, e))
}

fn put(file: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(file, bytes).map_err(|e| Error::io("write", file, e))
}

/// A file's head for one uncompressed strip: byte order, and a directory of tags, each (tag, type,
/// count, value) in 12 bytes.
fn tiff_head(s: &Settings) -> Vec<u8> {
    const SHORT: u16 = 3;
    const LONG: u16 = 4;
    let bits = 8 * s.kind.bytes() as u32;
    let [x, y, _] = s.dims.map(|d| d as u32);
    // Unsigned integers are sample format 1, floating-point numbers 3.
    let format = if s.kind == NumberType::F32 { 3 } else { 1 };
    let mut tags = [
        (256, LONG, x),
        (257, LONG, y),
        (258, SHORT, bits),
        (259, SHORT, 1),
        (262, SHORT, 1),
        (273, LONG, 0),
        (277, SHORT, 1),
        (278, LONG, y),
        (279, LONG, x * y * bits / 8),
        (339, SHORT, format),
    ];
    let head = 8 + 2 + 12 * tags.len() as u32 + 4;
    tags[5].2 = head;
    let order = |n: u32, width: usize| {
        let mut bytes = n.to_le_bytes()[..width].to_vec();
        if s.big_endian {
            bytes.reverse();
        }
        bytes
    };
    let mut out = if s.big_endian { b"MM".to_vec() } else { b"II".to_vec() };
    out.extend([order(42, 2), order(8, 4), order(tags.len() as u32, 2)].concat());
    for (tag, kind, value) in tags {
        out.extend([order(tag, 2), order(kind.into(), 2), order(1, 4)].concat());
        // A short value lies at the front of its four bytes.
        let value = if kind == SHORT { [order(value, 2), vec![0, 0]].concat() } else { order(value, 4) };
        out.extend(value);
    }
    out.extend([0; 4]);
    out
}

/// Version 3: https://zarr-specs.readthedocs.io/en/latest/v3/core/index.html
fn zarr_json(s: &Settings) -> String {
    let kind = match s.kind {
        NumberType::F32 => "float32",
        NumberType::U8 => "uint8",
        NumberType::U16 => "uint16",
    };
    let endian = if s.big_endian { "big" } else { "little" };
    let [x, y, z] = s.dims;
    serde_json::json!({
        "zarr_format": 3, "node_type": "array", "shape": [z, y, x], "data_type": kind, "fill_value": 0,
        "dimension_names": ["z", "y", "x"], "attributes": {},
        "chunk_grid": { "name": "regular", "configuration": { "chunk_shape": [CHUNK, CHUNK, CHUNK] } },
        "chunk_key_encoding": { "name": "default", "configuration": { "separator": "/" } },
        "codecs": [
            { "name": "bytes", "configuration": { "endian": endian } },
            { "name": "zstd", "configuration": { "level": 1, "checksum": false } },
        ],
    })
    .to_string()
}

/// Writes the chunks of up to [`CHUNK`] slices. Chunks at the far sides are padded with zeros.
fn write_layer(folder: &Path, s: &Settings, layer: &[u8], first: usize) -> Result<()> {
    let ([nx, ny, _], size) = (s.dims, s.kind.bytes());
    let slices = layer.len() / (nx * ny * size);
    for cy in 0..ny.div_ceil(CHUNK) {
        let row = folder.join(format!("c/{}/{cy}", first / CHUNK));
        std::fs::create_dir_all(&row).map_err(|e| Error::io("create the folder", &row, e))?;
        for cx in 0..nx.div_ceil(CHUNK) {
            let mut chunk = vec![0; CHUNK * CHUNK * CHUNK * size];
            let width = CHUNK.min(nx - cx * CHUNK) * size;
            for z in 0..slices {
                for y in 0..CHUNK.min(ny - cy * CHUNK) {
                    let from = ((z * ny + cy * CHUNK + y) * nx + cx * CHUNK) * size;
                    let to = (z * CHUNK + y) * CHUNK * size;
                    chunk[to..to + width].copy_from_slice(&layer[from..from + width]);
                }
            }
            let file = row.join(cx.to_string());
            let stored = zstd::bulk::compress(&chunk, 1).map_err(|e| Error::io("compress", &file, e))?;
            put(&file, &stored)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan::formats::{OpenOptions, open_volume};

    #[test]
    fn the_library_reads_the_same_volume_from_every_format() {
        let folder = tempfile::tempdir().unwrap();
        let samples = |name: &str, more: &str| {
            let out = folder.path().join(name);
            let line = format!("gyroid --dims 70,66,130 --periods 1 {more} -o {}", out.display());
            let args: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
            Settings::parse(&args).unwrap().write().unwrap();
            let source = open_volume(&out, &OpenOptions::default()).unwrap();
            assert_eq!(source.info().dims, [70, 66, 130]);
            let mut stream = source.into_stream();
            let (mut all, mut slab) = (vec![0.0; 70 * 66 * 130], vec![]);
            let size = stream.info().field.scalar.bytes();
            while let Some(part) = stream.next_slab(&mut slab).unwrap() {
                for (n, value) in slab.chunks_exact(size).enumerate() {
                    let ([x0, y0, z0], [dx, dy, _]) = (part.lo, part.dims());
                    let n = n as u64;
                    let [x, y, z] = [x0 + n % dx, y0 + n / dx % dy, z0 + n / dx / dy];
                    all[(x + 70 * (y + 66 * z)) as usize] = match *value {
                        [a] => f64::from(a),
                        [a, b] => f64::from(u16::from_le_bytes([a, b])),
                        [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
                        _ => panic!("{size} bytes a sample"),
                    };
                }
            }
            all
        };
        for (n, more) in
            ["", "--endian big", "--type uint16 --endian big", "--type uint8"].into_iter().enumerate()
        {
            let plain = samples(&format!("{n}.nrrd"), more);
            assert!(plain == samples(&format!("{n}.tifs"), more), "tifs {more}");
            assert!(plain == samples(&format!("{n}.zarr"), more), "zarr {more}");
        }
    }
}
