//! Inputs of several files: Zarr arrays and images, slices of TIFF and of DICOM, an index of VTK's
//! and the files that it lists. One of the files is damaged.

use crate::mutate::{Random, mutate};
use crate::seeds::{gzip, put, samples, tiff, zlib};
use crate::targets;
use isospan::{Error, Result};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};

/// A good folder: files by their paths in it, those with metadata first.
pub(crate) struct Folder {
    files: Vec<(&'static str, Vec<u8>)>,
    /// Files that describe the others.
    described_by: usize,
}

/// Folders of every kind and with every compressor.
pub(crate) fn all() -> Vec<Folder> {
    let plain = samples(2, 24);
    let lz4 = [&48u32.to_le_bytes()[..], &lz4_flex::block::compress(&plain)].concat();
    vec![
        version_2(Value::Null, plain.clone()),
        version_2(json!({ "id": "gzip", "level": 1 }), gzip(&plain)),
        version_2(json!({ "id": "zlib" }), zlib(&plain)),
        version_2(json!({ "id": "zstd" }), zstd(&plain)),
        version_2(json!({ "id": "lz4" }), lz4),
        version_2(json!({ "id": "blosc", "cname": "lz4", "shuffle": 1 }), blosc(&plain)),
        version_3(&plain),
        shards(&plain),
        image(plain),
        Folder { files: vec![("s_1.tif", tiff(1, 1)), ("s_2.tif", tiff(8, 1))], described_by: 2 },
        Folder { files: pieces(), described_by: 1 },
        Folder { files: slices(), described_by: 5 },
    ]
}

impl Folder {
    /// Damages a file or two (or leaves one out), reads the folder, and writes to `what` which
    /// bytes were at fault.
    pub(crate) fn case(&self, folder: &Path, random: &mut Random, what: &mut String) -> Result<()> {
        let mut files = self.files.clone();
        for _ in 0..=random.below(2) {
            let most = if random.below(2) == 0 { self.described_by } else { files.len() };
            let at = random.below(most);
            let other = random.pick(&self.files).1.clone();
            files[at].1 = mutate(&files[at].1, &other, random);
            *what += &format!("{} = b\"{}\" ", files[at].0, files[at].1.escape_ascii());
        }
        if random.below(16) == 0 {
            let (name, _) = files.remove(random.below(self.files.len()));
            *what += &format!("without {name}");
        }
        let _ = fs::remove_dir_all(folder);
        for (name, bytes) in &files {
            let path = folder.join(name);
            let parent = path.parent().expect("a file of the folder lies in it");
            fs::create_dir_all(parent).map_err(|e| Error::io("create", parent, e))?;
            put(&path, bytes)?;
        }
        targets::volume(&self.opened(folder), &files[0].1)
    }

    /// As it is.
    #[cfg(test)]
    pub(crate) fn read(&self, folder: &Path) -> Result<()> {
        for (name, bytes) in &self.files {
            fs::create_dir_all(folder.join(name).parent().expect("it lies in the folder")).expect("created");
            put(&folder.join(name), bytes)?;
        }
        targets::volume(&self.opened(folder), b"")
    }

    /// What is named to open it: the folder, or an index in it.
    fn opened(&self, folder: &Path) -> PathBuf {
        let name = self.files[0].0;
        if name.ends_with(".pvti") { folder.join(name) } else { folder.into() }
    }
}

/// A series of DICOM.
fn slices() -> Vec<(&'static str, Vec<u8>)> {
    macro_rules! file {
        ($name:literal) => {
            ($name, include_bytes!(concat!("../../../tests/data/dicom/series/", $name)).to_vec())
        };
    }
    vec![file!("a"), file!("b"), file!("c"), file!("d"), file!("e")]
}

/// An image in four pieces.
fn pieces() -> Vec<(&'static str, Vec<u8>)> {
    macro_rules! file {
        ($name:literal) => {
            ($name, include_bytes!(concat!("../../../tests/data/pieces/", $name)).to_vec())
        };
    }
    vec![
        file!("image.pvti"),
        file!("image_0.vti"),
        file!("image_1.vti"),
        file!("image_2.vti"),
        file!("image_3.vti"),
    ]
}

fn file(value: &Value) -> Vec<u8> {
    value.to_string().into_bytes()
}

/// 4 x 3 x 4 samples in two chunks along z, the second of which is not there.
fn array_2(compressor: &Value, shape: &Value, chunks: &Value) -> Vec<u8> {
    file(&json!({
        "zarr_format": 2, "shape": shape, "chunks": chunks, "dtype": "<u2", "compressor": compressor,
        "fill_value": 4, "order": "C", "filters": null
    }))
}

fn version_2(compressor: Value, chunk: Vec<u8>) -> Folder {
    let array = array_2(&compressor, &json!([4, 3, 4]), &json!([2, 3, 4]));
    let names = file(&json!({ "_ARRAY_DIMENSIONS": ["z", "y", "x"] }));
    Folder { files: vec![(".zarray", array), (".zattrs", names), ("0.0.0", chunk)], described_by: 2 }
}

fn array_3(chunk: [u64; 3], codecs: Value) -> Vec<u8> {
    file(&json!({
        "zarr_format": 3, "node_type": "array", "shape": [2, 3, 4], "data_type": "uint16",
        "chunk_grid": { "name": "regular", "configuration": { "chunk_shape": chunk } },
        "chunk_key_encoding": { "name": "default", "configuration": { "separator": "/" } },
        "fill_value": 4, "codecs": codecs, "attributes": {}, "dimension_names": ["z", "y", "x"]
    }))
}

fn bytes_codec() -> Value {
    json!({ "name": "bytes", "configuration": { "endian": "little" } })
}

fn checksummed(bytes: Vec<u8>) -> Vec<u8> {
    let sum = crc32c::crc32c(&bytes).to_le_bytes();
    [bytes, sum.to_vec()].concat()
}

fn version_3(plain: &[u8]) -> Folder {
    let transpose = json!({ "name": "transpose", "configuration": { "order": [2, 0, 1] } });
    let zstd_codec = json!({ "name": "zstd", "configuration": {} });
    let codecs = json!([transpose, bytes_codec(), { "name": "crc32c" }, zstd_codec]);
    let chunk = zstd(&checksummed(plain.to_vec()));
    Folder { files: vec![("zarr.json", array_3([2, 3, 4], codecs)), ("c/0/0/0", chunk)], described_by: 1 }
}

/// A shard of two chunks, its index at the end and, so that damage gets past it, without a
/// checksum.
fn shards(plain: &[u8]) -> Folder {
    let parts = [gzip(&plain[..24]), gzip(&plain[24..])];
    let lengths = parts.each_ref().map(|p| p.len() as u64);
    let index = [0, lengths[0], lengths[0], lengths[1]].map(u64::to_le_bytes).concat();
    let [first, second] = parts;
    let codecs = json!([{ "name": "sharding_indexed", "configuration": {
        "chunk_shape": [1, 3, 4], "codecs": [bytes_codec(), { "name": "gzip", "configuration": { "level": 1 } }],
        "index_codecs": [bytes_codec()], "index_location": "end" } }]);
    let shard = [first, second, index].concat();
    Folder { files: vec![("zarr.json", array_3([2, 3, 4], codecs)), ("c/0/0/0", shard)], described_by: 1 }
}

/// An OME-Zarr image of one level.
fn image(plain: Vec<u8>) -> Folder {
    let axes: Vec<Value> = ["c", "z", "y", "x"].iter().map(|n| json!({ "name": n })).collect();
    let level = json!({ "path": "0", "coordinateTransformations": [
        { "type": "scale", "scale": [1.0, 4.0, 3.0, 2.0] },
        { "type": "translation", "translation": [0.0, 30.0, 20.0, 10.0] } ] });
    let image = file(&json!({ "multiscales": [{ "axes": axes, "datasets": [level] }] }));
    let array = array_2(&Value::Null, &json!([1, 2, 3, 4]), &json!([1, 2, 3, 4]));
    let files = vec![(".zattrs", image), ("0/.zarray", array), ("0/0.0.0.0", plain)];
    Folder { files, described_by: 2 }
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    zstd::bulk::compress(bytes, 1).expect("compressing in memory")
}

/// Blosc data of one unsplit LZ4 block of 16-bit elements with shuffled bytes.
fn blosc(bytes: &[u8]) -> Vec<u8> {
    let shuffled: Vec<u8> =
        (0..2).flat_map(|b| bytes.iter().skip(b).step_by(2).copied().collect::<Vec<_>>()).collect();
    let lz4 = lz4_flex::block::compress(&shuffled);
    let (plain, packed) = (bytes.len() as u32, lz4.len() as u32);
    let head = [plain, plain, 24 + packed, 20, packed].map(u32::to_le_bytes).concat();
    [vec![2, 1, 1 | 16 | 1 << 5, 2], head, lz4].concat()
}
