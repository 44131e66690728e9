//! Reads the metadata of a Zarr array, versions 2 (`.zarray`) and 3 (`zarr.json`), into one
//! structure.

use super::codec::Codec;
use super::store::read_if_there;
use crate::error::{Error, Result};
use crate::formats::shared::cf::signed_as;
use crate::formats::shared::small::SmallFiles;
use crate::volume::ScalarType;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// What an array's metadata say.
#[derive(Clone, Debug)]
pub(super) struct ZarrArray {
    /// The array's folder.
    pub(super) folder: PathBuf,
    /// The file with the metadata.
    pub(super) file: PathBuf,
    /// 2 or 3.
    pub(super) version: u8,
    pub(super) shape: Vec<u64>,
    /// Samples of what one file holds.
    pub(super) chunk: Vec<u64>,
    pub(super) shard: Option<Shard>,
    pub(super) scalar: ScalarType,
    pub(super) big_endian: bool,
    /// The array's axes in the order in which they are stored, the slowest first.
    pub(super) order: Vec<usize>,
    /// From samples to stored bytes.
    pub(super) codecs: Vec<Codec>,
    /// One sample of what is not stored, little-endian.
    pub(super) fill: Vec<u8>,
    /// Names of the axes, where the metadata have them.
    pub(super) names: Option<Vec<String>>,
    /// What users and conventions say about it.
    pub(super) attributes: Value,
    key: Key,
}

/// A file of several chunks, each encoded separately, and an index of their places.
#[derive(Clone, Debug)]
pub(super) struct Shard {
    /// Samples of a chunk of the shard.
    pub(super) inner: Vec<u64>,
    pub(super) index_at_end: bool,
    /// Whether a CRC32C follows the index.
    pub(super) index_crc: bool,
}

#[derive(Clone, Debug)]
struct Key {
    /// Whether names start with "c" (version 3's default).
    prefix: bool,
    separator: char,
}

/// Metadata are small; a larger file is not metadata.
const MOST: u64 = 64 << 20;

/// The JSON of a metadata file, if there is one.
pub(super) fn json(small: &SmallFiles, file: &Path) -> Result<Option<Value>> {
    let Some(bytes) = small.get(file, || read_if_there(file, MOST))? else { return Ok(None) };
    let value = serde_json::from_slice(&bytes);
    value.map(Some).map_err(|e| Error::bad_input(file, "metadata", "JSON", e.to_string()))
}

/// The metadata of the array in a folder; `None` where there is no array.
pub(super) fn array(small: &SmallFiles, folder: &Path) -> Result<Option<ZarrArray>> {
    let mut array = stored_array(small, folder)?;
    if let Some(array) = &mut array {
        let unsigned = match &array.attributes["_Unsigned"] {
            Value::Bool(is_unsigned) => is_unsigned.to_string(),
            other => other.as_str().unwrap_or_default().to_string(),
        };
        array.scalar = signed_as(array.scalar, &unsigned);
    }
    Ok(array)
}

/// The same, with the type of the stored numbers.
fn stored_array(small: &SmallFiles, folder: &Path) -> Result<Option<ZarrArray>> {
    let file = folder.join("zarr.json");
    let of_3 = json(small, &file);
    if let Ok(Some(json)) = of_3 {
        let is_array = json["node_type"] == "array";
        return if is_array { Ok(Some(Parser { file: &file, json: &json }.v3(folder)?)) } else { Ok(None) };
    }
    let file = folder.join(".zarray");
    // A server that denies what is not there does not hide an array of version 2.
    let json = match (json(small, &file), of_3) {
        (Ok(Some(json)), Err(e)) if e.is_denied() => json,
        (found, of_3) => {
            of_3?;
            let Some(json) = found? else { return Ok(None) };
            json
        }
    };
    let mut array = Parser { file: &file, json: &json }.v2(folder)?;
    let attributes = self::json(small, &folder.join(".zattrs"))?.unwrap_or_default();
    array.names = strings(&attributes["_ARRAY_DIMENSIONS"]);
    array.attributes = attributes;
    Ok(Some(array))
}

fn strings(value: &Value) -> Option<Vec<String>> {
    value.as_array()?.iter().map(|v| v.as_str().map(str::to_string)).collect()
}

struct Parser<'a> {
    file: &'a Path,
    json: &'a Value,
}

impl Parser<'_> {
    fn wrong(&self, at: &str, expected: &str, got: &Value) -> Error {
        Error::bad_input(self.file, at, expected, got.to_string())
    }

    fn sizes(&self, at: &str, value: &Value, rank: Option<usize>) -> Result<Vec<u64>> {
        let list = value.as_array().and_then(|l| l.iter().map(Value::as_u64).collect::<Option<Vec<_>>>());
        let good = |l: &Vec<u64>| !l.contains(&0) && rank.is_none_or(|r| l.len() == r) && l.len() <= 16;
        list.filter(good).ok_or_else(|| self.wrong(at, "a size of at least 1 for each axis", value))
    }

    fn v2(&self, folder: &Path) -> Result<ZarrArray> {
        let json = self.json;
        if json["zarr_format"] != 2 {
            return Err(self.wrong("zarr_format", "2", &json["zarr_format"]));
        }
        let shape = self.sizes("shape", &json["shape"], None)?;
        let chunk = self.sizes("chunks", &json["chunks"], Some(shape.len()))?;
        let dtype = json["dtype"].as_str().unwrap_or_default();
        let (order, kind) = dtype.split_at_checked(1).unwrap_or_default();
        let scalar = match kind {
            "b1" => Some(ScalarType::U8),
            _ => ScalarType::from_code(kind),
        };
        let scalar = scalar
            .filter(|_| ["<", ">", "|"].contains(&order))
            .ok_or_else(|| self.wrong("dtype", "integers of 1 to 8 bytes, f4 or f8", &json["dtype"]))?;
        let mut order_of_axes: Vec<usize> = (0..shape.len()).collect();
        match json["order"].as_str() {
            Some("C") | None => {}
            Some("F") => order_of_axes.reverse(),
            _ => return Err(self.wrong("order", "C or F", &json["order"])),
        }
        let mut codecs = vec![];
        for filter in json["filters"].as_array().into_iter().flatten().chain([&json["compressor"]]) {
            if !filter.is_null() {
                codecs.push(self.codec("compressor or filter", &filter["id"], filter)?);
            }
        }
        let separator = json.get("dimension_separator").unwrap_or(&Value::Null);
        let key = Key { prefix: false, separator: self.separator(separator, '.')? };
        let fill = self.fill(scalar, &json["fill_value"])?;
        Ok(ZarrArray {
            folder: folder.into(),
            file: self.file.into(),
            version: 2,
            shape,
            chunk,
            shard: None,
            scalar,
            big_endian: order == ">",
            order: order_of_axes,
            codecs,
            fill,
            names: None,
            attributes: Value::Null,
            key,
        })
    }

    fn v3(&self, folder: &Path) -> Result<ZarrArray> {
        let json = self.json;
        if json["zarr_format"] != 3 {
            return Err(self.wrong("zarr_format", "3", &json["zarr_format"]));
        }
        let shape = self.sizes("shape", &json["shape"], None)?;
        let grid = &json["chunk_grid"];
        if grid["name"] != "regular" {
            return Err(self.wrong("chunk_grid", "a regular one", grid));
        }
        let chunk = self.sizes("chunk_shape", &grid["configuration"]["chunk_shape"], Some(shape.len()))?;
        let scalar = match json["data_type"].as_str().unwrap_or_default() {
            "bool" => Some(ScalarType::U8),
            name => ScalarType::from_name(name),
        };
        let scalar = scalar.ok_or_else(|| {
            self.wrong("data_type", "integers of 8 to 64 bits, float32 or float64", &json["data_type"])
        })?;
        if json["storage_transformers"].as_array().is_some_and(|l| !l.is_empty()) {
            return Err(self.wrong("storage_transformers", "none", &json["storage_transformers"]));
        }
        let encoding = &json["chunk_key_encoding"];
        let separator = &encoding["configuration"]["separator"];
        let key = match encoding["name"].as_str() {
            Some("default") => Key { prefix: true, separator: self.separator(separator, '/')? },
            Some("v2") => Key { prefix: false, separator: self.separator(separator, '.')? },
            _ => return Err(self.wrong("chunk_key_encoding", "default or v2", encoding)),
        };
        let fill = self.fill(scalar, &json["fill_value"])?;
        let mut array = ZarrArray {
            folder: folder.into(),
            file: self.file.into(),
            version: 3,
            order: (0..shape.len()).collect(),
            shape,
            chunk,
            shard: None,
            scalar,
            big_endian: false,
            codecs: vec![],
            fill,
            names: strings(&json["dimension_names"]),
            attributes: json["attributes"].clone(),
            key,
        };
        self.codecs(&json["codecs"], &mut array)?;
        Ok(array)
    }

    fn separator(&self, value: &Value, default: char) -> Result<char> {
        match value.as_str() {
            Some(".") => Ok('.'),
            Some("/") => Ok('/'),
            None if value.is_null() => Ok(default),
            _ => Err(self.wrong("separator", "\".\" or \"/\"", value)),
        }
    }

    /// Reads a list of version 3 codecs into `array`: transpositions, then bytes or a shard, then
    /// compressors.
    fn codecs(&self, list: &Value, array: &mut ZarrArray) -> Result<()> {
        let rank = array.shape.len();
        let list = list.as_array().ok_or_else(|| self.wrong("codecs", "a list", list))?;
        let mut bytes_seen = false;
        for codec in list {
            let config = &codec["configuration"];
            match codec["name"].as_str().unwrap_or_default() {
                "transpose" if !bytes_seen => {
                    let order =
                        config["order"].as_array().map(|l| l.iter().filter_map(Value::as_u64).collect());
                    let order: Vec<u64> = order.unwrap_or_default();
                    let mut sorted = order.clone();
                    sorted.sort_unstable();
                    if sorted != (0..rank as u64).collect::<Vec<_>>() {
                        return Err(self.wrong("transpose", "an order of all axes", config));
                    }
                    array.order = order.iter().map(|&i| array.order[i as usize]).collect();
                }
                "bytes" if !bytes_seen => {
                    bytes_seen = true;
                    array.big_endian = config["endian"] == "big";
                }
                "sharding_indexed" if list.len() == 1 && array.shard.is_none() => {
                    array.shard = Some(self.shard(config, &array.chunk)?);
                    return self.codecs(&config["codecs"], array);
                }
                _ if bytes_seen => array.codecs.push(self.codec("codecs", &codec["name"], config)?),
                _ => {
                    let expected = "transpose, then bytes or one sharding_indexed, then compressors";
                    return Err(self.wrong("codecs", expected, codec));
                }
            }
        }
        if bytes_seen { Ok(()) } else { Err(self.wrong("codecs", "bytes", &Value::Array(list.clone()))) }
    }

    fn shard(&self, config: &Value, shard: &[u64]) -> Result<Shard> {
        let inner = self.sizes("chunk_shape of a shard", &config["chunk_shape"], Some(shard.len()))?;
        if inner.iter().zip(shard).any(|(i, s)| s % i != 0) {
            return Err(self.wrong(
                "chunk_shape of a shard",
                "divisors of the shard",
                &config["chunk_shape"],
            ));
        }
        let codecs = config["index_codecs"].as_array().cloned().unwrap_or_default();
        let names: Vec<&str> = codecs.iter().filter_map(|c| c["name"].as_str()).collect();
        let little = codecs.first().is_some_and(|c| c["configuration"]["endian"] != "big");
        let index_crc = match (&names[..], little) {
            (["bytes"], true) => false,
            (["bytes", "crc32c"], true) => true,
            _ => {
                let expected = "little-endian bytes, with crc32c or not";
                return Err(self.wrong("index_codecs", expected, &config["index_codecs"]));
            }
        };
        Ok(Shard { inner, index_at_end: config["index_location"] != "start", index_crc })
    }

    fn codec(&self, at: &str, name: &Value, config: &Value) -> Result<Codec> {
        let name_text = name.as_str().unwrap_or_default();
        Ok(match name_text.strip_prefix("numcodecs.").unwrap_or(name_text) {
            "gzip" => Codec::Gzip,
            "zlib" => Codec::Zlib,
            "zstd" => Codec::Zstd,
            "lz4" => Codec::Lz4,
            "blosc" => Codec::Blosc,
            "crc32c" => Codec::Crc32c,
            "shuffle" => {
                let size = config["elementsize"].as_u64().filter(|s| (1..=16).contains(s));
                let size = size.ok_or_else(|| self.wrong("shuffle", "an elementsize up to 16", config))?;
                Codec::Shuffle(size as usize)
            }
            _ => {
                let expected = "blosc, gzip, zlib, zstd, lz4, shuffle or crc32c";
                return Err(self.wrong(at, expected, name).with_help("write it again with one of these"));
            }
        })
    }

    /// One sample of the fill value, little-endian.
    fn fill(&self, scalar: ScalarType, value: &Value) -> Result<Vec<u8>> {
        let wrong = || self.wrong("fill_value", &format!("a value of type {}", scalar.name()), value);
        let text = match value {
            // Undefined: zeros, as other readers give.
            Value::Null => "0".to_string(),
            Value::Bool(b) => u8::from(*b).to_string(),
            Value::String(s) => s.trim().to_string(),
            number => number.to_string(),
        };
        let mut out = vec![];
        if let Some(hex) = text.strip_prefix("0x") {
            let bits = u64::from_str_radix(hex, 16).map_err(|_| wrong())?;
            return Ok(bits.to_le_bytes()[..scalar.bytes()].to_vec());
        }
        // "0.0" for integers is what some writers give.
        let whole = text.strip_suffix(".0").unwrap_or(&text);
        let float = scalar.is_float();
        let pushed = crate::formats::shared::stream::push_number(
            if float { &text } else { whole }.as_bytes(),
            scalar,
            &mut out,
        );
        if pushed { Ok(out) } else { Err(wrong()) }
    }
}

impl ZarrArray {
    /// The file of a chunk (or shard) by its place in the grid.
    pub(super) fn chunk_file(&self, at: &[u64]) -> PathBuf {
        if at.is_empty() {
            return self.folder.join(if self.key.prefix { "c" } else { "0" });
        }
        let mut name = if self.key.prefix { format!("c{}", self.key.separator) } else { String::new() };
        let numbers: Vec<String> = at.iter().map(u64::to_string).collect();
        name.push_str(&numbers.join(&self.key.separator.to_string()));
        self.folder.join(name)
    }

    /// Samples of what is decoded at once.
    pub(super) fn unit(&self) -> &[u64] {
        self.shard.as_ref().map_or(&self.chunk, |s| &s.inner)
    }
}
