use super::*;
use crate::formats::open_volume;
use crate::formats::shared::codec::blosc;
use crate::formats::shared::zip::tests::zip;
use crate::formats::tests::{gzip, open_coordinates, write};
use crate::grid::IndexBox;
use crate::volume::ScalarType;
use crate::volume::chunked::step;
use crate::volume::convert::convert_row;
use base64::prelude::{BASE64_STANDARD, Engine};
use serde_json::json;
use std::fs;

/// Sizes along x, y, z of the arrays below, and of their chunks: all different, the last chunks
/// cut.
const DIMS: [u64; 3] = [7, 5, 6];
const CHUNK: [u64; 3] = [4, 3, 2];

fn value(x: u64, y: u64, z: u64) -> u16 {
    (100 * z + 10 * y + x + 3) as u16
}

/// The samples of a box that starts at `lo`, stored with the axes in `order` (0 is x), the slowest
/// first; 9 beyond the end.
fn stored(lo: [u64; 3], size: [u64; 3], order: [usize; 3], big_endian: bool) -> Vec<u8> {
    let mut out = vec![];
    let [a, b, c] = order.map(|a| size[a]);
    for (i, j, k) in (0..a).flat_map(|i| (0..b).flat_map(move |j| (0..c).map(move |k| (i, j, k)))) {
        let mut at = lo;
        (at[order[0]], at[order[1]], at[order[2]]) = (lo[order[0]] + i, lo[order[1]] + j, lo[order[2]] + k);
        let inside = (0..3).all(|a| at[a] < DIMS[a]);
        let v = if inside { value(at[0], at[1], at[2]) } else { 9 };
        out.extend(if big_endian { v.to_be_bytes() } else { v.to_le_bytes() });
    }
    out
}

/// Writes the chunks of an array whose axes are `order`, by `name`, each encoded by `encode`.
fn chunks(
    folder: &Path,
    order: [usize; 3],
    stored_order: [usize; 3],
    big_endian: bool,
    name: impl Fn([u64; 3]) -> String,
    encode: impl Fn(Vec<u8>) -> Vec<u8>,
) {
    let grid: [u64; 3] = std::array::from_fn(|a| DIMS[a].div_ceil(CHUNK[a]));
    let mut at = [0; 3];
    loop {
        let lo = std::array::from_fn(|a| at[a] * CHUNK[a]);
        let file = folder.join(name(order.map(|a| at[a])));
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, encode(stored(lo, CHUNK, stored_order, big_endian))).unwrap();
        if !step(&mut at, grid) {
            return;
        }
    }
}

fn put(folder: &Path, name: &str, json: &Value) {
    fs::create_dir_all(folder).unwrap();
    fs::write(folder.join(name), json.to_string()).unwrap();
}

fn v2(order: [usize; 3], dtype: &str, layout: &str, compressor: Value) -> Value {
    json!({
        "zarr_format": 2, "shape": order.map(|a| DIMS[a]), "chunks": order.map(|a| CHUNK[a]), "dtype": dtype,
        "compressor": compressor, "fill_value": 4, "order": layout, "filters": null
    })
}

fn v3(codecs: Value) -> Value {
    json!({
        "zarr_format": 3, "node_type": "array", "shape": [6, 5, 7], "data_type": "uint16",
        "chunk_grid": { "name": "regular", "configuration": { "chunk_shape": [2, 3, 4] } },
        "chunk_key_encoding": { "name": "default", "configuration": { "separator": "/" } },
        "fill_value": 4, "codecs": codecs, "attributes": {}, "dimension_names": ["z", "y", "x"]
    })
}

const ZYX: [usize; 3] = [2, 1, 0];

fn dots(at: [u64; 3]) -> String {
    at.map(|n| n.to_string()).join(".")
}

fn slashes(at: [u64; 3]) -> String {
    format!("c/{}", at.map(|n| n.to_string()).join("/"))
}

/// All values, wherever the slabs lie.
fn values(source: VolumeSource) -> Result<(VolumeInfo, Vec<f32>)> {
    let (info, mut stream, mut bytes) = (source.info().clone(), source.into_stream(), vec![]);
    let whole = IndexBox::whole(info.dims);
    let (mut out, mut count) = (vec![f32::NAN; whole.len()], 0);
    while let Some(slab) = stream.next_slab(&mut bytes)? {
        let mut part = vec![0.0; slab.len()];
        convert_row(&bytes, info.field.scalar, false, 1.0, 0.0, None, &mut part);
        count += slab.len();
        for (i, row) in part.chunks_exact(slab.dims()[0] as usize).enumerate() {
            let (y, z) = (i as u64 % slab.dims()[1], i as u64 / slab.dims()[1]);
            let at = whole.offset([slab.lo[0], slab.lo[1] + y, slab.lo[2] + z]);
            out[at..at + row.len()].copy_from_slice(row);
        }
    }
    assert_eq!(count, whole.len(), "each sample once");
    Ok((info, out))
}

fn read(path: &Path, field: Option<&str>) -> Result<(VolumeInfo, Vec<f32>)> {
    let options = OpenOptions { field: field.map(str::to_string), ..OpenOptions::default() };
    read_with(path, &options)
}

fn read_with(path: &Path, options: &OpenOptions) -> Result<(VolumeInfo, Vec<f32>)> {
    open_volume(path, options).and_then(values)
}

fn expected() -> Vec<f32> {
    let [w, h, d] = DIMS;
    let all = (0..d).flat_map(|z| (0..h).flat_map(move |y| (0..w).map(move |x| (x, y, z))));
    all.map(|(x, y, z)| f32::from(value(x, y, z))).collect()
}

fn check(path: &Path) -> VolumeInfo {
    let (info, values) = read(path, None).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((info.dims, info.field.scalar), (DIMS, ScalarType::U16));
    assert_eq!(values, expected());
    info
}

fn refusal(path: &Path) -> String {
    let error = read(path, None).expect_err("refused");
    assert_eq!(error.exit_code(), 5, "{error}");
    error.to_string()
}

fn zlib(bytes: Vec<u8>) -> Vec<u8> {
    let mut z = flate2::write::ZlibEncoder::new(vec![], flate2::Compression::fast());
    std::io::Write::write_all(&mut z, &bytes).unwrap();
    z.finish().unwrap()
}

fn zstd(bytes: Vec<u8>) -> Vec<u8> {
    zstd::bulk::compress(&bytes, 1).unwrap()
}

fn lz4(bytes: Vec<u8>) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes()[..], &lz4_flex::block::compress(&bytes)].concat()
}

/// Blosc data of one block that is stored, unsplit, as 16-bit elements with shuffled bytes.
fn blosc(bytes: Vec<u8>) -> Vec<u8> {
    let shuffled: Vec<u8> =
        (0..2).flat_map(|b| bytes.iter().skip(b).step_by(2).copied().collect::<Vec<_>>()).collect();
    let lz4 = lz4_flex::block::compress(&shuffled);
    let n = bytes.len() as u32;
    let mut out = vec![2, 1, 1 | 16 | 1 << 5, 2];
    for number in [n, n, 24 + lz4.len() as u32, 20, lz4.len() as u32] {
        out.extend(number.to_le_bytes());
    }
    [out, lz4].concat()
}

#[test]
fn version_2_in_either_order_of_axes_and_samples() {
    for (order, names) in [
        (ZYX, None),
        (ZYX, Some(["z", "y", "x"])),
        ([0, 1, 2], Some(["x", "y", "z"])),
        ([1, 2, 0], Some(["y", "z", "x"])),
    ] {
        for (layout, big_endian) in [("C", false), ("F", false), ("C", true)] {
            let dir = tempfile::tempdir().unwrap();
            let dtype = if big_endian { ">u2" } else { "<u2" };
            put(dir.path(), ".zarray", &v2(order, dtype, layout, Value::Null));
            if let Some(names) = names {
                put(dir.path(), ".zattrs", &json!({ "_ARRAY_DIMENSIONS": names }));
            }
            let mut in_file = order;
            if layout == "F" {
                in_file.reverse();
            }
            chunks(dir.path(), order, in_file, big_endian, dots, |b| b);
            let info = check(dir.path());
            assert_eq!(info.files().len(), 1 + 2 * 2 * 3, "the metadata and the chunks");
        }
    }
}

#[test]
fn compressors_of_version_2() {
    type Encoder = fn(Vec<u8>) -> Vec<u8>;
    let encoders: [(Value, Encoder); 5] = [
        (json!({ "id": "gzip", "level": 1 }), |b| gzip(&b)),
        (json!({ "id": "zlib" }), zlib),
        (json!({ "id": "zstd" }), zstd),
        (json!({ "id": "lz4" }), lz4),
        (json!({ "id": "blosc", "cname": "lz4", "shuffle": 1 }), blosc),
    ];
    for (compressor, encode) in encoders {
        let dir = tempfile::tempdir().unwrap();
        put(dir.path(), ".zarray", &v2(ZYX, "<u2", "C", compressor));
        chunks(dir.path(), ZYX, ZYX, false, dots, encode);
        check(dir.path());
        // A chunk cut anywhere is refused, and so are bytes of another chunk size.
        let file = dir.path().join("1.0.0");
        let good = fs::read(&file).unwrap();
        for cut in 0..good.len() {
            fs::write(&file, &good[..cut]).unwrap();
            assert!(refusal(dir.path()).contains("1.0.0"));
        }
        for (at, flip) in (0..good.len()).flat_map(|at| [(at, 1), (at, 0x80), (at, 0xff)]) {
            let mut damaged = good.clone();
            damaged[at] ^= flip;
            fs::write(&file, &damaged).unwrap();
            if let Err(e) = read(dir.path(), None) {
                assert!(e.to_string().contains("1.0.0"), "{e}");
            }
        }
        fs::write(&file, encode(vec![0; 46])).unwrap();
        refusal(dir.path());
    }
}

#[test]
fn version_3_with_transposition_and_checksum() {
    let bytes = json!({ "name": "bytes", "configuration": { "endian": "big" } });
    let crc = |b: Vec<u8>| [&b[..], &crc32c::crc32c(&b).to_le_bytes()].concat();
    let dir = tempfile::tempdir().unwrap();
    // Stored axes: the array's 2, 0, 1, which are x, z, y.
    let transpose = json!({ "name": "transpose", "configuration": { "order": [2, 0, 1] } });
    let list = json!([transpose, bytes, { "name": "zstd", "configuration": {} }, { "name": "crc32c" }]);
    put(dir.path(), "zarr.json", &v3(list));
    chunks(dir.path(), ZYX, [0, 2, 1], true, slashes, |b| crc(zstd(b)));
    let info = check(dir.path());
    assert_eq!(info.format, "Zarr (version 3, zstd + CRC32C)");
    let file = dir.path().join("c/0/0/0");
    let mut damaged = fs::read(&file).unwrap();
    damaged[5] ^= 1;
    fs::write(&file, damaged).unwrap();
    assert!(refusal(dir.path()).contains("CRC32C"));
}

/// A shard of two chunks along each axis, `[4, 3, 2]` samples each along x, y, z.
fn shard(at: [u64; 3], at_end: bool) -> Vec<u8> {
    let count = 8;
    let (mut data, mut index) = (vec![], vec![]);
    let first = if at_end { 0 } else { 16 * count + 4 };
    for number in 0..count {
        let inner = [number % 2, number / 2 % 2, number / 4];
        let lo: [u64; 3] = std::array::from_fn(|a| (2 * at[a] + inner[a]) * CHUNK[a]);
        if (0..3).all(|a| lo[a] < DIMS[a]) {
            let chunk = gzip(&stored(lo, CHUNK, ZYX, false));
            index.extend([first + data.len() as u64, chunk.len() as u64].map(u64::to_le_bytes).concat());
            data.extend(chunk);
        } else {
            index.extend([0xff; 16]);
        }
    }
    index.extend(crc32c::crc32c(&index).to_le_bytes());
    if at_end { [data, index].concat() } else { [index, data].concat() }
}

#[test]
fn shards() {
    for at_end in [true, false] {
        let dir = tempfile::tempdir().unwrap();
        let inner = json!([{ "name": "bytes", "configuration": { "endian": "little" } }, { "name": "gzip" }]);
        let index =
            json!([{ "name": "bytes", "configuration": { "endian": "little" } }, { "name": "crc32c" }]);
        let location = if at_end { "end" } else { "start" };
        let sharding = json!([{ "name": "sharding_indexed", "configuration": {
            "chunk_shape": [2, 3, 4], "codecs": inner, "index_codecs": index, "index_location": location } }]);
        let mut meta = v3(sharding);
        meta["chunk_grid"]["configuration"]["chunk_shape"] = json!([4, 6, 8]);
        put(dir.path(), "zarr.json", &meta);
        for z in 0..2 {
            write_in(dir.path(), &format!("c/{z}/0/0"), &shard([0, 0, z], at_end));
        }
        assert_eq!(check(dir.path()).format, "Zarr (version 3, gzip, shards)");
        let (files, archives) = (files_in(dir.path()), tempfile::tempdir().unwrap());
        check(&zipped(&archives, "", &files, [false, true]));
        assert!(refusal(&zipped(&archives, "", &files, [true, false])).contains("a deflated one"));
        let good = shard([0, 0, 1], at_end);
        for cut in 1..good.len() {
            write_in(dir.path(), "c/1/0/0", &good[..cut]);
            assert!(refusal(dir.path()).contains("c/1/0/0"));
        }
        fs::remove_file(dir.path().join("c/1/0/0")).unwrap();
        let (_, values) = read(dir.path(), None).unwrap();
        assert_eq!((values[3 * 35], values[4 * 35]), (303.0, 4.0), "the fill value from slice 4 on");
    }
}

fn write_in(folder: &Path, name: &str, bytes: &[u8]) {
    let file = folder.join(name);
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(file, bytes).unwrap();
}

fn ome(folder: &Path) {
    put(folder, ".zgroup", &json!({ "zarr_format": 2 }));
    let level = |path: &str, s: f64| {
        json!({ "path": path, "coordinateTransformations": [
            { "type": "scale", "scale": [1.0, 4.0 * s, 3.0 * s, 2.0 * s] },
            { "type": "translation", "translation": [0.0, 30.0, 20.0, 10.0] } ] })
    };
    let axis = |n: &&str| match *n {
        "c" => json!({ "name": n }),
        _ => json!({ "name": n, "type": "space", "unit": "micrometer" }),
    };
    let axes: Vec<Value> = ["c", "z", "y", "x"].iter().map(axis).collect();
    let multiscales = json!([{ "axes": axes, "datasets": [level("0", 1.0), level("s1/image", 2.0)],
        "coordinateTransformations": [{ "type": "scale", "scale": [1.0, 10.0, 10.0, 10.0] }] }]);
    put(folder, ".zattrs", &json!({ "multiscales": multiscales }));
    for (name, fill) in [("0", json!(4)), ("s1/image", json!(5))] {
        let mut meta = v2(ZYX, "<u2", "C", Value::Null);
        (meta["shape"], meta["chunks"]) = (json!([1, 6, 5, 7]), json!([1, 2, 3, 4]));
        (meta["fill_value"], meta["dimension_separator"]) = (fill, json!("/"));
        put(&folder.join(name), ".zarray", &meta);
    }
    chunks(
        &folder.join("0"),
        ZYX,
        ZYX,
        false,
        |at| format!("0/{}", at.map(|n| n.to_string()).join("/")),
        |b| b,
    );
}

/// All files of a folder, with their names in it.
fn files_in(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let (mut files, mut folders) = (vec![], vec![folder.to_path_buf()]);
    while let Some(at) = folders.pop() {
        for entry in fs::read_dir(at).unwrap().map(|e| e.unwrap().path()) {
            if entry.is_dir() {
                folders.push(entry);
            } else {
                let name = entry.strip_prefix(folder).unwrap().to_str().unwrap().to_owned();
                files.push((name, fs::read(&entry).unwrap()));
            }
        }
    }
    files
}

/// The files of a folder in an archive, their names after `prefix`.
fn zipped(dir: &tempfile::TempDir, prefix: &str, files: &[(String, Vec<u8>)], kind: [bool; 2]) -> PathBuf {
    let names: Vec<String> = files.iter().map(|(name, _)| format!("{prefix}{name}")).collect();
    let members: Vec<_> =
        names.iter().map(String::as_str).zip(files.iter().map(|(_, b)| b.clone())).collect();
    write(dir, "a.zarr.zip", &zip(&members, kind[0], kind[1]))
}

#[test]
fn stores_in_archives() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("a.zarr");
    ome(&folder);
    let mut files = files_in(&folder);
    for kind in [[false, false], [true, false], [false, true], [true, true]] {
        let path = zipped(&dir, "", &files, kind);
        let info = check(&path);
        assert_eq!((info.geometry.spacing, info.fields.len()), ([20.0, 30.0, 40.0], 2));
        assert_eq!(info.data_files, std::slice::from_ref(&path));
        let scale = |scale: &str| OpenOptions { scale: Some(scale.into()), ..OpenOptions::default() };
        for wanted in ["1", "s1/image"] {
            let (info, values) = read_with(&path, &scale(wanted)).unwrap();
            assert_eq!(info.geometry.spacing, [40.0, 60.0, 80.0]);
            assert!(values.iter().all(|&v| v == 5.0));
            assert_eq!(read_with(&folder, &scale(wanted)).unwrap().0.field, info.field);
        }
        assert_eq!(read(&path.join("s1/image"), None).unwrap().0.geometry.spacing, [40.0, 60.0, 80.0]);
        let error = read_with(&path, &scale("2")).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("0 (1 x 6 x 5 x 7), s1/image (1 x 6 x 5 x 7)"), "{error}");
        let both = OpenOptions { field: Some("0".into()), ..scale("1") };
        assert_eq!(read_with(&path, &both).unwrap_err().exit_code(), 2);
        let help = refusal(&zipped(&dir, "a.zarr/", &files, kind));
        assert!(help.contains("at the top of the archive"), "{help}");
    }
    // A chunk that was written again lies there twice.
    let chunk = files.iter().position(|(name, _)| name == "0/0/0/0/0").unwrap();
    let (good, other) = (files[chunk].clone(), vec![1; files[chunk].1.len()]);
    files[chunk].1 = other;
    files.push(good);
    check(&zipped(&dir, "", &files, [true, false]));
}

#[test]
fn damaged_archives_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("a.zarr");
    put(&folder, ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
    chunks(&folder, ZYX, ZYX, false, dots, |b| b);
    let mut files = files_in(&folder);
    // The metadata and some chunks: others have the fill value.
    files.sort();
    for deflate in [false, true] {
        let file = fs::read(zipped(&dir, "", &files[..4], [deflate, false])).unwrap();
        let read = |bytes: &[u8]| read(&write(&dir, "a.zarr.zip", bytes), None);
        assert!(read(&file).is_ok());
        // The last two bytes are the archive's comment.
        for cut in 1..file.len() - 2 {
            assert!(read(&file[..cut]).is_err(), "cut to {cut} bytes");
        }
        for (at, flip) in (0..file.len()).flat_map(|at| [0x01, 0x10, 0x80, 0xff].map(|flip| (at, flip))) {
            let mut damaged = file.clone();
            damaged[at] ^= flip;
            if let Err(e) = read(&damaged) {
                assert!(!e.to_string().contains('\n'), "{e}");
            }
        }
    }
}

#[test]
fn levels_of_an_image() {
    let dir = tempfile::tempdir().unwrap();
    ome(dir.path());
    let info = check(dir.path());
    assert_eq!((info.geometry.spacing, info.geometry.origin), ([20.0, 30.0, 40.0], [100.0, 200.0, 300.0]));
    assert_eq!(info.fields.len(), 2);
    assert_eq!(info.units, Units::of_length(Unit::length("µm")));
    for wanted in ["s1", "s1/image", "scale1"] {
        let (info, values) = read(dir.path(), Some(wanted)).unwrap();
        assert_eq!((info.field.name.as_str(), info.geometry.spacing), ("s1/image", [40.0, 60.0, 80.0]));
        assert!(values.iter().all(|&v| v == 5.0), "a level without chunks is its fill value");
    }
    for folder in ["s1/image", "s1/image/"] {
        let (info, _) = read(&dir.path().join(folder), None).unwrap();
        assert_eq!(info.geometry.spacing, [40.0, 60.0, 80.0], "the group above tells where its levels are");
    }
    assert_eq!(read(dir.path(), Some("2")).unwrap_err().exit_code(), 2);
    fs::remove_dir_all(dir.path().join("s1")).unwrap();
    assert!(refusal(dir.path()).contains("s1/image"));
}

#[test]
fn metadata_that_are_not_read_are_named() {
    let with = |key: &str, value: Value| {
        let mut meta = v2(ZYX, "<u2", "C", Value::Null);
        meta[key] = value;
        meta
    };
    for (meta, message) in [
        (with("dtype", json!([["a", "<u2"]])), "dtype"),
        (with("compressor", json!({ "id": "bz2" })), "bz2"),
        (with("filters", json!([{ "id": "delta" }])), "delta"),
        (with("fill_value", json!(70000)), "fill_value"),
        (with("shape", json!([6, 5])), "chunks"),
        (with("shape", json!([0, 5, 7])), "shape"),
        (with("shape", json!([1_u64 << 40, 1_u64 << 40, 7])), "2^63"),
        (with("chunks", json!([1 << 20, 1 << 20, 1 << 20])), "1 GiB"),
        (with("zarr_format", json!(4)), "zarr_format"),
        (with("order", json!("A")), "order"),
        (json!({}), "zarr_format"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        put(dir.path(), ".zarray", &meta);
        let line = refusal(dir.path());
        assert!(line.contains(message) && line.contains(".zarray"), "{line}");
    }
    for (codecs, message) in [
        (json!([]), "bytes"),
        (json!([{ "name": "zstd" }]), "zstd"),
        (json!([{ "name": "bytes" }, { "name": "vlen-utf8" }]), "vlen-utf8"),
        (
            json!([{ "name": "transpose", "configuration": { "order": [0, 0, 1] } }, { "name": "bytes" }]),
            "all axes",
        ),
    ] {
        let dir = tempfile::tempdir().unwrap();
        put(dir.path(), "zarr.json", &v3(codecs));
        let line = refusal(dir.path());
        assert!(line.contains(message) && line.contains("zarr.json"), "{line}");
    }
    let dir = tempfile::tempdir().unwrap();
    write(&dir, ".zarray", b"{");
    assert!(refusal(dir.path()).contains("JSON"));
    put(dir.path(), ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
    put(dir.path(), ".zattrs", &json!({ "_ARRAY_DIMENSIONS": ["a", "y", "x"] }));
    check_fill(dir.path(), 4.0);
    // A file beside the array that is called like an axis is no array of coordinates.
    let around = tempfile::tempdir().unwrap();
    std::fs::write(around.path().join("y"), "a note").unwrap();
    let beside = around.path().join("array");
    std::fs::create_dir(&beside).unwrap();
    put(&beside, ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
    put(&beside, ".zattrs", &json!({ "_ARRAY_DIMENSIONS": ["z", "y", "x"] }));
    check_fill(&beside, 4.0);
    put(dir.path(), ".zattrs", &json!({ "_ARRAY_DIMENSIONS": ["t", "y", "x"] }));
    assert!(refusal(dir.path()).contains("three axes of space"));
}

#[test]
fn attributes_of_cf_are_followed() {
    let base64 = |v: f64| json!(BASE64_STANDARD.encode(v.to_le_bytes()));
    // By the names of both versions; NaN is missing anyway.
    for (fill, missing) in
        [(json!(7), Some(7.0)), (base64(7.0), Some(7.0)), (base64(f64::NAN), None), (json!("NaN"), None)]
    {
        let attributes = json!({ "scale_factor": 0.5, "add_offset": -3, "_FillValue": fill });
        let dir = tempfile::tempdir().unwrap();
        put(dir.path(), ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
        put(dir.path(), ".zattrs", &attributes);
        let info = read(dir.path(), None).unwrap().0;
        assert_eq!((info.slope, info.intercept, info.missing), (0.5, -3.0, missing));
        let dir = tempfile::tempdir().unwrap();
        let mut meta = v3(json!([{ "name": "bytes", "configuration": { "endian": "little" } }]));
        meta["attributes"] = attributes;
        put(dir.path(), "zarr.json", &meta);
        let info = read(dir.path(), None).unwrap().0;
        assert_eq!((info.slope, info.intercept, info.missing), (0.5, -3.0, missing));
    }
    for (bad, reason) in [
        (json!({ "_FillValue": [1, 2] }), "_FillValue: expected one number, got 2 values"),
        (json!({ "_FillValue": [{}] }), "_FillValue: expected numbers, got [{}]"),
        (json!({ "valid_range": [1] }), "valid_range: expected 2 number(s), got 1 of them"),
        (
            json!({ "scale_factor": 0 }),
            "scale_factor, add_offset: expected finite numbers, the first not 0, got 0 and 0",
        ),
    ] {
        let dir = tempfile::tempdir().unwrap();
        put(dir.path(), ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
        put(dir.path(), ".zattrs", &bad);
        let line = refusal(dir.path());
        assert!(line.contains(reason) && line.contains(".zattrs"), "{line}");
    }
}

#[test]
fn samples_outside_of_the_valid_range_are_missing() {
    // Of packed integers a range of floats is one of values.
    for attributes in [
        json!({ "valid_range": [100, 400], "scale_factor": 0.5, "missing_value": 203 }),
        json!({ "valid_min": 50.0, "valid_max": 200.0, "scale_factor": 0.5, "missing_value": [203] }),
    ] {
        let dir = tempfile::tempdir().unwrap();
        put(dir.path(), ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
        put(dir.path(), ".zattrs", &attributes);
        chunks(dir.path(), ZYX, ZYX, false, dots, |b| b);
        let (info, values) = read(dir.path(), None).unwrap();
        assert_eq!((info.field.scalar, info.slope, info.missing), (ScalarType::F64, 1.0, None));
        for (found, stored) in values.into_iter().zip(expected()) {
            let is_valid = (100.0..=400.0).contains(&stored) && stored != 203.0;
            assert!(if is_valid { found == 0.5 * stored } else { found.is_nan() }, "{found}, {stored}");
        }
    }
}

fn check_fill(path: &Path, fill: f32) {
    let (info, values) = read(path, None).unwrap();
    assert_eq!(info.dims, DIMS, "three axes without all names are z, y, x");
    assert!(values.iter().all(|v| v.to_bits() == fill.to_bits()));
}

#[test]
fn fill_values() {
    for (kind, fill, expected) in [
        ("float32", json!("NaN"), f32::NAN),
        ("float64", json!("-Infinity"), f32::NEG_INFINITY),
        ("float32", json!("0x40490fdb"), std::f32::consts::PI),
        ("uint8", json!(null), 0.0),
        ("int16", json!(-3.0), -3.0),
        ("bool", json!(true), 1.0),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let mut meta = v3(json!([{ "name": "bytes", "configuration": { "endian": "little" } }]));
        (meta["data_type"], meta["fill_value"]) = (json!(kind), fill);
        put(dir.path(), "zarr.json", &meta);
        check_fill(dir.path(), expected);
    }
}

/// 1000 samples of u16, 7 i / 3 mod 200, as numcodecs 0.16 (c-blosc 1.21) encodes them at level 9:
/// `Blosc(name, 9, shuffle)`.
const BLOSC: [(&str, &str); 8] = [
    (
        "blosclz, shuffle 1",
        "AgEBAtAHAADQBwAAEwQAABQAAADoAwAAAAIEBwkLDhASFRcZHB4gIyUnKiwuMTM1ODo8P0FDRkhKTU9RVFZYW11fYmRmaWttcHJ0\
        d3l7foCChYeJjI6Qk5WXmpyeoaOlqKqsr7Gztri6vb/BxMYAAwUHCgwOERMVGBocHyEjJigqLS8xNDY4Oz0/QkRGSUtNUFJUV1lb\
        XmBiZWdpbG5wc3V3enx+gYOFiIqMj5GTlpianZ+hpKaoq62vsrS2ubu9wMLExwEDBggKDQ8RFBYYGx0fIiQmKSstMDI0Nzk7PkBC\
        RUdJTE5QU1VXWlxeYWNlaGpsb3Fzdnh6fX+BhIaIi42PkpSWmZudoKKkp6mrrrCytbe5vL7Aw8XHAgQGCQsNEBIUFxkbHiAiJScp\
        LC4wMzU3Ojw+QUNFSEpMT1FTVlhaXV9hZGZoa21vcnR2eXt9gIKEh4mLjpCSlZeZnJ6go6WnqqyusbO1uLq8v8HDxgACBQcJDA4Q\
        ExUXGhweISMlKCosLzEzNjg6PT9BREZIS01PUlRWWVtdYGJkZ2lrbnBydXd5fH6Ag4WHioyOkZOVmJqcn6Gjpqiqra+xtLa4u72/\
        wsTGAQMFCAoMDxETFhgaHR8hJCYoKy0vMjQ2OTs9QEJER0lLTlBSVVdZXF5gY2VnamxucXN1eHp8f4GDhoiKjY+RlJaYm52foqSm\
        qautsLK0t7m7vsDCxccBBAYICw0PEhQWGRsdICIkJykrLjAyNTc5PD5AQ0VHSkxOUVNVWFpcX2FjZmhqbW9xdHZ4e31/goSGiYuN\
        kJKUl5mbnqCipaeprK6ws7W3ury+wcPFAAIEBwkLDhASFRcZHB4gIyUnKiwuMTM1ODo8P0FDRkhKTU9RVFZYW11fYmRmaWttcHJ0\
        d3l7foCChYeJjI6Qk5WXmpyeoaOlqKqsr7Gztri6vb/BxMYAAwUHCgwOERMVGBocHyEjJigqLS8xNDY4Oz0/QkRGSUtNUFJUV1lb\
        XmBiZWdpbG5wc3V3enx+gYOFiIqMj5GTlpianZ+hpKaoq62vsrS2ubu9wMLExwEDBggKDQ8RFBYYGx0fIiQmKSstMDI0Nzk7PkBC\
        RUdJTE5QU1VXWlxeYWNlaGpsb3Fzdnh6fX+BhIaIi42PkpSWmZudoKKkp6mrrrCytbe5vL7Aw8XHAgQGCQsNEBIUFxkbHiAiJScp\
        LC4wMzU3Ojw+QUNFSEpMT1FTVlhaXV9hZGZoa21vcnR2eXt9gIKEh4mLjpCSlZeZnJ6go6WnqqyusbO1uLq8v8HDxgACBQcJDA4Q\
        ExUXGhweISMlKCosLzEzNjg6PT9BREZIS01PUlRWWVtdYGJkZ2lrbnBydXd5fH6Agw8AAAAjAAAAAOD////bAwIAAAA=",
    ),
    (
        "blosclz, shuffle 2",
        "AgEEAtAHAADQBwAAfAEAABQAAABRAQAAJTiO4ziO4+BuBQJqpVbgcQICTDab4HECCnA4HI/H43A4HI8HwAgCx+OAgBEFx+NwOOBw\
        wCAAD8AIAo/HA6AyA8fjcMBgOwTH43A4HOAAKeAgSgqAP+AP+AN/wB/wB+AACAH8AKARA/yAPwBgGgb8gD/gD8AfoAgB+APgAAgB\
        fwBgGmAvAIDgKEoVAMD/DwD8fwDg/wcA8P8DgP8fAPj/AMARAv8/AKARAsD/D2AjB/8/APD/AwD4gBEC/H8AoBECgP8f4CpKHwAA\
        8P//fwAAADgAAAD8//8fAAAADwAAgP///wcAAMADHwAA4P///wAAAHAAAAD4//8/AAAAHAAAAP///w8AAIAHCgAAwP///wMAAOAA\
        4CtKAACAagE/AGAAAOCAVQAAgGoC/wMAYAAA/4CgAACAagEfAGAAAPCAoAAAgLUB/wBgAAGA/+AfSgEAwA8AAAAjAAAAAOD////b\
        AwIAAAA=",
    ),
    (
        "lz4, shuffle 1",
        "AgEhAtAHAADQBwAAkAIAABQAAABmAgAA////SwACBAcJCw4QEhUXGRweICMlJyosLjEzNTg6PD9BQ0ZISk1PUVRWWFtdX2JkZmlr\
        bXBydHd5e36AgoWHiYyOkJOVl5qcnqGjpaiqrK+xs7a4ur2/wcTGAAMFBwoMDhETFRgaHB8hIyYoKi0vMTQ2ODs9P0JERklLTVBS\
        VFdZW15gYmVnaWxucHN1d3p8foGDhYiKjI+Rk5aYmp2foaSmqKutr7K0trm7vcDCxMcBAwYICg0PERQWGBsdHyIkJikrLTAyNDc5\
        Oz5AQkVHSUxOUFNVV1pcXmFjZWhqbG9xc3Z4en1/gYSGiIuNj5KUlpmbnaCipKepq66wsrW3uby+wMPFxwIEBgkLDRASFBcZGx4g\
        IiUnKSwuMDM1Nzo8PkFDRUhKTE9RU1ZYWl1fYWRmaGttb3J0dnl7fYCChIeJi46QkpWXmZyeoKOlp6qsrrGztbi6vL/Bw8YAAgUH\
        CQwOEBMVFxocHiEjJSgqLC8xMzY4Oj0/QURGSEtNT1JUVllbXWBiZGdpa25wcnV3eXx+gIOFh4qMjpGTlZianJ+ho6aoqq2vsbS2\
        uLu9v8LExgEDBQgKDA8RExYYGh0fISQmKCstLzI0Njk7PUBCREdJS05QUlVXWVxeYGNlZ2psbnFzdXh6fH+Bg4aIio2PkZSWmJud\
        n6KkpqmrrbCytLe5u77AwsXHAQQGCAsNDxIUFhkbHSAiJCcpKy4wMjU3OTw+QENFR0pMTlFTVVhaXF9hY2Zoam1vcXR2eHt9f4KE\
        homLjZCSlJeZm56goqWnqayusLO1t7q8vsHDxVgC/3lQeXx+gIMOAAAAHwABAP///9JQAAAAAAA=",
    ),
    (
        "lz4, shuffle 2",
        "AgEkAtAHAADQBwAAegEAABQAAABQAQAAPziO4wMAZz9qpVYDAGc/TDabAwBnYHA4HI/H4wYAFAcJADLH44ASAAAGABDgGwAACQAl\
        HA8qACPHAzMAQcfjcMA8AAEhAAUqAA9LABa1gD/gD/gDf8Af8AcJACP8ABIAQfyAPwAbABD8JwAAJAABCQAl+AMJACN/ABIAMH/A\
        HyQAAQkAD0sAFvQHAMD/DwD8fwDg/wcA8P8DgP8fAPj/ABIAM/8/ABIAACcAACQAIP8/JwAAJAAAEgAz/H8AEgAAJwADEgAAJwAP\
        SwAU8SAAAPD//38AAAA4AAAA/P//HwAAAA8AAID///8HAADAAwAA4P///wAAAHAAAAD4/zIAcBwAAAD///8nAAAkADD///8nAA9L\
        ACISAGsAAFYAEgBrABEPCgAAawAAVgAAAgAS/6EAEgBrAAChAAJrAAChAAACABL8oQAPSwAXUAAAAADADgAAAB8AAQD////SUAAA\
        AAAA",
    ),
    (
        "zlib, shuffle 1",
        "AgFhAtAHAADQBwAAqQIAABQAAAB8AgAAeNpjYGJh5+TmExASFZeUkVNQVlXX0tEzNDa1sLKxd3R28/Dy9Q8MCYuIjo1PSknLzM4t\
        KCopr6yua2hqbe/s6Zsweer0WXPmLVy8dMWqNes3bt62Y9fe/QePHGNgZmXn4uETFBaVkJKRV1RW09DS1Tc0MbOwtrV3cnHz9PYN\
        CAoJj4yOS0hKTc/MySsoLi2vqqlrbG7t6Orpnzh52oxZc+cvXLJsxeq16zdt2bZz994Dh44cZ2Rm4+Di5RcUEZOQlpVXUlHT1NY1\
        MDIxt7S2c3Bydff08QsIDg2PiolLTE7NyMrJLywuq6iqrW9saevo7u2fNGXazNlzFyxasnzl6nUbNm3dvnPPvgOHjx5nYmHj5OYV\
        EBIRl5SWU1BSVdfU0TMwNjW3srFzdHb18PLxDwwOi4iKjU9MScvIzs0vKimrrK5taGpp7+zumzBp6vSZc+YtWLx0+ao16zZu3rpj\
        1579Bw8fY2BiZefk4RMQFhWXkpFTVFbV0NLRNzQ2s7CytXd0cfPw9vUPCgmLjI5NSEpJz8zOKygqLa+sqWtobm3v6umbOHnqjFlz\
        5i9cvGzFqrXrN27ZtmP33v2HjhxjZGbl4OLhFxQWk5CSlVdUUdPQ1tU3MjGztLZ1cHJx9/T2CwgKDY+MiUtITk3PyskrLC6tqKqp\
        b2xu6+jq7Z84ZdqM2XPnL1qybOXqtRs2bdm+c/e+A4eOHmdkYePg5uUXEhGTlJZVUFJR19TWMzAyNbe0sXNwdnX38vELDA6NiIqJ\
        T0xOy8jKzS8sKauorq1vamnr7O6dMGnK9Jmz5y1YtHT5yjXrNmzeun3Xnn0HDx9lGE1XgypdAQDWgH0vEQAAAHjaY2AYBaNgFAx3\
        AAAD6AAB",
    ),
    (
        "zlib, shuffle 2",
        "AgFkAtAHAADQBwAA+wAAABQAAADOAAAAeNrFjbGtwzAMRA9Q4VILGPAWH+q8QOoMkUobyBMkA6TOHuq8hgAv4FKFAIb6lNgrjQHR\
        eDg+H93zcJe9x+d+3bv9va973s2v/ajfqcN+bB28SypYNXejpo9qzuNV25psNiEu56RQ0GFb0SFZhWwUAoo2jFchkkUJSDThJLPR\
        gkzoCa1oSdVawlpPWGtJ1carwCJxBxxPId4DFiwS7xENWCTugOfJ9P/HzMNh1arDWLWfqiD7hklaIfvaCjkVhOqpRfCUVsgpGq/6\
        AkU5uCcRAAAAeNpjYBgFo2AUDHcAAAPoAAE=",
    ),
    (
        "zstd, shuffle 1",
        "AgGRAtAHAADQBwAAiQIAABQAAABxAgAAKLUv/WDQBj0TAKQlAAIEBwkLDhASFRcZHB4gIyUnKiwuMTM1ODo8P0FDRkhKTU9RVFZY\
        W11fYmRmaWttcHJ0d3l7foCChYeJjI6Qk5WXmpyeoaOlqKqsr7Gztri6vb/BxMYAAwUHCgwOERMVGBocHyEjJigqLS8xNDY4Oz0/\
        QkRGSUtNUFJUV1lbXmBiZWdpbG5wc3V3enx+gYOFiIqMj5GTlpianZ+hpKaoq62vsrS2ubu9wMLExwEDBggKDQ8RFBYYGx0fIiQm\
        KSstMDI0Nzk7PkBCRUdJTE5QU1VXWlxeYWNlaGpsb3Fzdnh6fX+BhIaIi42PkpSWmZudoKKkp6mrrrCytbe5vL7Aw8XHAgQGCQsN\
        EBIUFxkbHiAiJScpLC4wMzU3Ojw+QUNFSEpMT1FTVlhaXV9hZGZoa21vcnR2eXt9gIKEh4mLjpCSlZeZnJ6go6WnqqyusbO1uLq8\
        v8HDxgACBQcJDA4QExUXGhweISMlKCosLzEzNjg6PT9BREZIS01PUlRWWVtdYGJkZ2lrbnBydXd5fH6Ag4WHioyOkZOVmJqcn6Gj\
        pqiqra+xtLa4u72/wsTGAQMFCAoMDxETFhgaHR8hJCYoKy0vMjQ2OTs9QEJER0lLTlBSVVdZXF5gY2VnamxucXN1eHp8f4GDhoiK\
        jY+RlJaYm52foqSmqautsLK0t7m7vsDCxccBBAYICw0PEhQWGRsdICIkJykrLjAyNTc5PD5AQ0VHSkxOUVNVWFpcX2FjZmhqbW9x\
        dHZ4e31/goSGiYuNkJKUl5mbnqCipaeprK6ws7W3ury+wcPFAAACAOPdCsPSuEUVaQ==",
    ),
    (
        "zstd, shuffle 2",
        "AgGUAtAHAADQBwAA4AAAABQAAADIAAAAKLUv/WDQBvUFANLKGxuwN2PAxqB6AXhykBXAwRcSVIhlJQUWcfVQPgX3m/C4st99tm1v\
        2J+2P/CrFv7F39Z9tjdt2Z8ftfFP/2rfo7JXzL7TtuqFo7Ls29S94qdt1F4Jj1uxo3morYTHKba0I9NxzCzKAaQCCYQhIRYjBSig\
        oUzuhS2znnUDUEmUDuSJ6k5ijB6DHHYzZMeHAIYAohVdEU7BmfvjU3BP9WWiiYvKCEwWrcjOeFGxKpI6A4YYEBMz4E53T/o1jWQ=",
    ),
];

#[test]
fn blosc_data_of_the_reference() {
    use base64::Engine;
    let expected: Vec<u8> = (0..1000u16).flat_map(|i| (7 * i / 3 % 200).to_le_bytes()).collect();
    for (name, text) in BLOSC {
        let data = base64::engine::general_purpose::STANDARD.decode(text).unwrap();
        let mut out = vec![];
        blosc::decode(&data, 2000, &mut out).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(out == expected, "{name}");
        assert!(blosc::decode(&data, 1999, &mut out).is_err(), "a claim beyond the limit");
        for cut in 0..data.len() {
            assert!(blosc::decode(&data[..cut], 2000, &mut out).is_err(), "{name} cut to {cut}");
        }
        for (at, flip) in (0..data.len()).flat_map(|at| [(at, 1u8), (at, 0x10), (at, 0xff)]) {
            let mut damaged = data.clone();
            damaged[at] ^= flip;
            // Not every damage can be seen; none may panic.
            let _ = blosc::decode(&damaged, 2000, &mut out);
        }
    }
}

#[test]
#[ignore = "reads real data; tools/check runs it with ISOSPAN_SHARED_DATA"]
fn a_real_image() {
    let root = crate::formats::tests::shared_data();
    let path = root.join("volumes/mni152_f64.ome.zarr");
    for (path, field) in [(path.clone(), Some("scale2")), (path.join("scale2"), None)] {
        let (info, values) = read(&path, field).unwrap();
        assert_eq!((info.dims, info.field.scalar), ([51, 64, 53], ScalarType::F64));
        assert_eq!(info.geometry.spacing, [2.949852466583252; 3]);
        assert_eq!(info.geometry.origin, [-74.65634042024612, -109.65634042024612, -70.65634042024612]);
        let (lo, hi) = values.iter().fold((f32::MAX, f32::MIN), |(lo, hi), &v| (lo.min(v), hi.max(v)));
        assert!(lo == 0.0 && (hi - 84.6333).abs() < 1e-3, "{lo} {hi}");
    }
    let (info, values) = read(&path, None).unwrap();
    assert_eq!(
        (info.dims, values.iter().all(|&v| v == 0.0)),
        ([207, 256, 215], true),
        "no chunks: the fill value"
    );
}

#[test]
fn an_empty_group_has_no_field() {
    let dir = tempfile::tempdir().unwrap();
    put(dir.path(), ".zgroup", &json!({ "zarr_format": 2 }));
    assert!(refusal(dir.path()).contains("no field"));
    put(&dir.path().join("a"), ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
    put(&dir.path().join("b"), ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
    let error = read(dir.path(), None).unwrap_err().to_string();
    assert!(error.contains("a (uint16), b (uint16)"), "{error}");
}

/// Frames of an array whose chunks hold two of them: the first of four axes without names, and
/// OME-Zarr's "t".
/// The steps of an array, or of the image that it is of.
fn steps(path: &Path) -> Frames {
    crate::formats::open(path, &OpenOptions::default()).unwrap().steps(&OpenOptions::default()).unwrap()
}

#[test]
fn a_time_axis_gives_frames() {
    let dir = tempfile::tempdir().unwrap();
    let sample = |t: u64, at: [u64; 3]| (value(at[0], at[1], at[2]) as u64 + 1000 * t) as u16;
    let chunk_of = |t0: u64, at: [u64; 3]| -> Vec<u8> {
        let lo: [u64; 3] = std::array::from_fn(|a| at[a] * CHUNK[a]);
        let mut out = vec![];
        for (t, z) in (t0..t0 + 2).flat_map(|t| (0..CHUNK[2]).map(move |z| (t, z))) {
            for (y, x) in (0..CHUNK[1]).flat_map(|y| (0..CHUNK[0]).map(move |x| (y, x))) {
                out.extend(sample(t, [lo[0] + x, lo[1] + y, lo[2] + z]).to_le_bytes());
            }
        }
        out
    };
    let grid: [u64; 3] = std::array::from_fn(|a| DIMS[a].div_ceil(CHUNK[a]));
    let plain = dir.path().join("plain.zarr");
    let ome = dir.path().join("ome.zarr");
    let array = || {
        json!({
            "zarr_format": 2, "shape": [3, DIMS[2], DIMS[1], DIMS[0]], "chunks": [2, CHUNK[2], CHUNK[1], CHUNK[0]], "dtype": "<u2",
            "compressor": null, "fill_value": 4, "order": "C", "filters": null
        })
    };
    put(&plain, ".zarray", &array());
    put(&ome.join("0"), ".zarray", &array());
    let axes = ["t", "z", "y", "x"].map(|n| json!({ "name": n }));
    let moved = json!([{ "type": "scale", "scale": [0.5, 3.0, 2.0, 1.0] }, { "type": "translation", "translation": [10.0, 0.0, 0.0, 0.0] }]);
    let level = json!({ "path": "0", "coordinateTransformations": moved });
    put(&ome, ".zattrs", &json!({ "multiscales": [{ "axes": axes, "datasets": [level] }] }));
    for folder in [&plain, &ome.join("0")] {
        for t in 0..2 {
            let mut at = [0; 3];
            loop {
                let name = format!("{t}.{}.{}.{}", at[2], at[1], at[0]);
                fs::write(folder.join(name), chunk_of(2 * t, at)).unwrap();
                if !step(&mut at, grid) {
                    break;
                }
            }
        }
    }
    for (path, name, times) in
        [(&plain, "data", [None; 3]), (&ome, "0", [Some(10.0), Some(10.5), Some(11.0)])]
    {
        let found = steps(path);
        let expected_frames: Vec<_> = (0..3).map(|t| (format!("{name}:t{t}"), times[t])).collect();
        assert_eq!(found, expected_frames);
        for t in 0..3u64 {
            let (info, values) = read(path, Some(&format!("{name}:t{t}"))).unwrap();
            assert_eq!(info.dims, DIMS);
            let expected: Vec<f32> = expected().iter().map(|v| v + 1000.0 * t as f32).collect();
            assert_eq!(values, expected, "{name} {t}");
            assert_eq!(info.data_files.len(), 1 + grid.iter().product::<u64>() as usize);
        }
        assert!(read(path, None).unwrap_err().to_string().contains(":t1"), "a choice is asked for");
    }
    // The same as channels, which are no steps.
    let axes = json!([{ "axes": ["c", "z", "y", "x"], "datasets": [{ "path": "0" }] }]);
    for (labels, names) in
        [(["DAPI", "GFP", "a/b"], ["c0", "c1", "c2"]), (["DAPI", "GFP", "c1"], ["DAPI", "GFP", "c1"])]
    {
        let labels = labels.map(|label| json!({ "label": label }));
        put(&ome, ".zattrs", &json!({ "multiscales": axes, "omero": { "channels": labels } }));
        assert!(steps(&ome).is_empty());
        let error = read(&ome, None).unwrap_err().to_string();
        assert!(error.contains(&format!("{}; choose one with `channel=NAME`", names.join(", "))), "{error}");
        let options = |field: Option<&str>, channel: Option<&str>| {
            let [field, channel] = [field, channel].map(|text| text.map(str::to_owned));
            OpenOptions { field, channel, ..OpenOptions::default() }
        };
        let second = format!("0:{}", names[1]);
        for options in [
            options(None, Some(names[1])),
            options(None, Some("1")),
            options(Some("0"), Some("1")),
            options(Some(&second), None),
            options(Some(&second), Some(names[1])),
        ] {
            let (info, values) = read_with(&ome, &options).unwrap();
            assert_eq!((&*info.field.name, info.dims), (&*second, DIMS), "{options:?}");
            assert!(values.iter().zip(expected()).all(|(&v, of_first)| v == of_first + 1000.0));
        }
        for options in
            [options(None, Some("RFP")), options(Some(&second), Some("0")), options(None, Some("3"))]
        {
            let error = read_with(&ome, &options).unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains(names[2]), "{error}");
        }
    }
    let channel = OpenOptions { channel: Some("0".into()), ..OpenOptions::default() };
    assert!(read_with(&plain, &channel).unwrap_err().to_string().contains("without channels"));
}

#[test]
fn channels_may_have_frames() {
    let dir = tempfile::tempdir().unwrap();
    // An image of the first version: its axes are t, c, z, y, x.
    let array = json!({
        "zarr_format": 2, "shape": [2, 3, 2, 2, 2], "chunks": [1, 2, 2, 2, 2], "dtype": "|u1", "compressor": null,
        "fill_value": 0, "order": "C", "filters": null
    });
    put(&dir.path().join("0"), ".zarray", &array);
    put(dir.path(), ".zattrs", &json!({ "multiscales": [{ "datasets": [{ "path": "0" }] }] }));
    for (t, c) in (0..2).flat_map(|t| (0..2).map(move |c| (t, c))) {
        let chunk: Vec<u8> = (0..16).map(|i| 100 * t + 20 * c + i).collect();
        fs::write(dir.path().join(format!("0/{t}.{c}.0.0.0")), chunk).unwrap();
    }
    let options = OpenOptions { channel: Some("1".into()), ..OpenOptions::default() };
    let steps = crate::formats::steps_of(&[dir.path().to_owned()], &options).unwrap();
    let names: Vec<_> = steps.iter().map(|s| s.options.field.clone().unwrap()).collect();
    assert_eq!(names, ["0:c1:t0", "0:c1:t1"]);
    for (t, step) in steps.iter().enumerate() {
        let (_, values) = read_with(&step.path, &step.options).unwrap();
        assert_eq!(values, (8..16).map(|i| (100 * t + i) as f32).collect::<Vec<_>>());
    }
    let third = OpenOptions { field: Some("0:c2:t1".into()), ..OpenOptions::default() };
    assert_eq!(read_with(dir.path(), &third).unwrap().1, (120..128).map(|v| v as f32).collect::<Vec<_>>());
}

#[test]
fn arrays_of_xarray_have_coordinates_packing_and_times() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let array = |name: &str, shape: Value, dtype: &str, names: Value, more: Value, bytes: Vec<u8>| {
        let folder = d.join(name);
        let n = shape.as_array().unwrap().len();
        let meta = json!({ "zarr_format": 2, "shape": shape, "chunks": shape, "dtype": dtype, "compressor": null,
            "fill_value": 7, "order": "C", "filters": null });
        put(&folder, ".zarray", &meta);
        let mut attributes = json!({ "_ARRAY_DIMENSIONS": names });
        attributes.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        put(&folder, ".zattrs", &attributes);
        fs::write(folder.join(vec!["0"; n].join(".")), bytes).unwrap();
    };
    put(d, ".zgroup", &json!({ "zarr_format": 2 }));
    let doubles = |v: &[f64]| v.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let names = json!(["time", "lev", "lat", "lon"]);
    let all: Vec<u8> = (0..2 * 3 * 4 * 5u8).flat_map(|i| i16::from(i).to_le_bytes()).collect();
    array(
        "temp",
        json!([2, 3, 4, 5]),
        "<i2",
        names,
        json!({ "scale_factor": 0.5, "add_offset": 10.0, "units": "K" }),
        all,
    );
    let since = json!({ "units": "days since 2000-01-01" });
    array("time", json!([2]), "<f8", json!(["time"]), since, doubles(&[6.0, 18.0]));
    array("lev", json!([3]), "<f8", json!(["lev"]), json!({}), doubles(&[1000.0, 925.0, 700.0]));
    array("lat", json!([4]), "<f8", json!(["lat"]), json!({}), doubles(&[30.0, 20.0, 10.0, 0.0]));
    let named = |field: &str| OpenOptions { field: Some(field.into()), ..OpenOptions::default() };
    let steps = crate::formats::steps_of(&[d.to_path_buf()], &named("temp")).unwrap();
    assert_eq!(steps.iter().map(|s| s.time).collect::<Vec<_>>(), [Some(6.0), Some(18.0)]);
    let (_, values) = crate::formats::tests::read_all(open_volume(d, &named("temp:t0")).unwrap());
    assert_eq!((values[0], values[1], values[59]), (10.0, 10.5, 39.5));
    assert!(values[7].is_nan(), "the fill value of what is packed");
    let Some(GridCoordinates::Axes(axes)) = open_coordinates(d, &named("temp:t1")).unwrap() else {
        panic!("axes")
    };
    assert_eq!((&axes[1][..], &axes[2][..]), (&[30.0, 20.0, 10.0, 0.0][..], &[1000.0, 925.0, 700.0][..]));
    assert_eq!(axes[0], [0.0, 1.0, 2.0, 3.0, 4.0]);
    // A spacing of the user counts where it may replace that of the file.
    let refused = OpenOptions { spacing: Some([2.0, 3.0, 4.0]), ..named("temp:t1") };
    assert!(open_volume(d, &refused).err().unwrap().to_string().contains("tells its own spacing"));
    let moved = OpenOptions { replaces_place: true, ..refused };
    assert!(open_coordinates(d, &moved).unwrap().is_none());
    assert_eq!(open_volume(d, &moved).unwrap().info().geometry.spacing, [2.0, 3.0, 4.0]);
    assert!(open_coordinates(d, &OpenOptions { spacing: None, ..moved }).unwrap().is_some());
    // Regular levels are a spacing.
    array("lev", json!([3]), "<f8", json!(["lev"]), json!({}), doubles(&[10.0, 12.0, 14.0]));
    assert!(open_coordinates(d, &named("temp:t1")).unwrap().is_none());
    let (info, _) = read(d, Some("temp:t1")).unwrap();
    assert_eq!((info.geometry.spacing, info.geometry.origin), ([1.0, 10.0, 2.0], [0.0, 30.0, 10.0]));
    let units = || {
        let (info, _) = read(d, Some("temp:t1")).unwrap();
        [info.units.value, info.units.length, info.units.time].map(|unit| unit.map(|unit| unit.to_string()))
    };
    let text = |t: &str| Some(t.to_string());
    assert_eq!(units(), [text("K"), None, text("days since 2000-01-01")]);
    let metres = || json!({ "units": "m" });
    array("lev", json!([3]), "<f8", json!(["lev"]), metres(), doubles(&[10.0, 12.0, 14.0]));
    array("lat", json!([4]), "<f8", json!(["lat"]), metres(), doubles(&[30.0, 20.0, 10.0, 0.0]));
    assert_eq!(units()[1], None, "one axis has no coordinates");
    array("lon", json!([5]), "<f8", json!(["lon"]), metres(), doubles(&[0.0, 1.0, 2.0, 3.0, 4.0]));
    assert_eq!(units()[1], text("m"));
}

#[test]
fn a_short_last_axis_without_a_name_has_components() {
    let dir = tempfile::tempdir().unwrap();
    let meta = json!({ "zarr_format": 2, "shape": [6, 6, 6, 3], "chunks": [6, 6, 6, 3], "dtype": "<f4",
        "compressor": null, "fill_value": 0, "order": "C", "filters": null });
    put(dir.path(), ".zarray", &meta);
    let line = read(dir.path(), None).unwrap_err().to_string();
    assert!(line.contains("6 x 6 x 6 x 3") && line.contains("write one channel"), "{line}");
}

/// An OME-Zarr image of one level with these axes and transformations.
fn image(folder: &Path, units: [&str; 3], transformations: &Value) {
    put(folder, ".zgroup", &json!({ "zarr_format": 2 }));
    let axis = |(name, unit): (&str, &str)| json!({ "name": name, "type": "space", "unit": unit });
    let axes: Vec<Value> = ["z", "y", "x"].into_iter().zip(units).map(axis).collect();
    let datasets = json!([{ "path": "0", "coordinateTransformations": transformations }]);
    put(folder, ".zattrs", &json!({ "multiscales": [{ "axes": axes, "datasets": datasets }] }));
    put(&folder.join("0"), ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
}

#[test]
fn units_of_single_axes_become_one() {
    let dir = tempfile::tempdir().unwrap();
    let scale = json!([{ "type": "scale", "scale": [3.0, 2.0, 1.0] },
        { "type": "translation", "translation": [30.0, 20.0, 10.0] }]);
    image(dir.path(), ["micrometer", "nanometer", "nanometer"], &scale);
    let info = open_volume(dir.path(), &OpenOptions::default()).unwrap().info().clone();
    assert_eq!(info.geometry.spacing, [1.0, 2.0, 3000.0]);
    assert_eq!(info.geometry.origin, [10.0, 20.0, 30_000.0]);
    assert_eq!(info.units, Units::of_length(Unit::length("nm")));
    assert!(info.notes[0].contains("z from µm"), "{:?}", info.notes);
    image(dir.path(), ["micrometer", "cubit", "nanometer"], &scale);
    assert!(refusal(dir.path()).contains("cubit"));
}

#[test]
fn transformations_that_are_not_read_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    for (step, word) in [
        (json!({ "type": "scale", "path": "scales/0" }), "scales/0"),
        (json!({ "type": "translation", "path": "there" }), "a translation that is stored"),
        (json!({ "type": "affine", "affine": [[1, 0, 0, 0]] }), "affine"),
        (json!({ "type": "scale", "scale": [1.0, 2.0] }), "[1.0,2.0] for 3 axes"),
        (json!({ "type": "scale" }), "scale null"),
        (json!({ "type": "scale", "scale": [1.0, "2", 3.0] }), "for 3 axes"),
    ] {
        image(dir.path(), ["mm", "mm", "mm"], &json!([step]));
        let line = refusal(dir.path());
        assert!(line.contains("coordinateTransformations") && line.contains(word), "{line}");
    }
    image(dir.path(), ["mm", "mm", "mm"], &json!([{ "type": "identity" }]));
    assert_eq!(open_volume(dir.path(), &OpenOptions::default()).unwrap().info().geometry.spacing, [1.0; 3]);
}

#[test]
fn axes_of_an_image_are_what_their_types_say() {
    let dir = tempfile::tempdir().unwrap();
    for (kinds, is_read) in
        [(["space"; 3], true), (["channel", "space", "space"], false), (["time", "space", "space"], false)]
    {
        put(dir.path(), ".zgroup", &json!({ "zarr_format": 2 }));
        let axis = |(name, kind): (&str, &str)| json!({ "name": name, "type": kind });
        let axes: Vec<Value> = ["s", "y", "x"].into_iter().zip(kinds).map(axis).collect();
        let datasets = json!([{ "path": "0" }]);
        put(dir.path(), ".zattrs", &json!({ "multiscales": [{ "axes": axes, "datasets": datasets }] }));
        put(&dir.path().join("0"), ".zarray", &v2(ZYX, "<u2", "C", Value::Null));
        if is_read {
            check_fill(dir.path(), 4.0);
        } else {
            assert!(refusal(dir.path()).contains("three axes of space"), "{kinds:?}");
        }
    }
}
