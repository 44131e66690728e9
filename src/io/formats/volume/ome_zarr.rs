//! Writes OME-Zarr images: all levels of a volume, for viewers that read what they show.
//!
//! ```text
//!  image.ome.zarr/  .zgroup  .zattrs     a group of Zarr 2; axes, units, scales (OME-NGFF 0.4)
//!    0/  .zarray  .zattrs                the finest level
//!      0/0/0  0/0/1  …                   chunks: [t/][c/]z/y/x, Blosc with zstd, bytes shuffled
//!    1/                                  the next level
//! ```
//!
//! These versions are those that napari, neuroglancer and ome-zarr-py all read. A chunk is written
//! when it is there, by any thread in any order. The folder gets its name when it is complete.
//!
//! The formats: <https://zarr-specs.readthedocs.io/en/latest/v2/v2.0.html>,
//! <https://ngff.openmicroscopy.org/0.4>.

use crate::bytes::StagedFolder;
use crate::error::{Error, Result};
use crate::formats::shared::codec::blosc;
use crate::formats::volume::samples::{numpy_type, push_samples};
use crate::volume::ScalarType;
use crate::volume::units::{Unit, Units};
use serde_json::{Value, json};
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// An image: what its metadata tell.
#[derive(Clone, Debug)]
pub struct ZarrImage {
    /// Its name.
    pub name: String,
    /// The type of all samples.
    pub scalar: ScalarType,
    /// What is added to values.
    pub offset: f64,
    /// The units of lengths, values and times.
    pub units: Units,
    /// The levels, the finest first.
    pub levels: Vec<ZarrLevel>,
    /// Samples of a chunk along each axis of space.
    pub chunk: u64,
    /// The steps, where there are several.
    pub times: Option<ZarrTimes>,
    /// The channels, where there are several: their names and ranges.
    pub channels: Vec<(String, [f64; 2])>,
}

/// A level: its samples along x, y, z, and where these lie.
#[derive(Clone, Debug)]
pub struct ZarrLevel {
    /// Samples along x, y, z.
    pub dims: [u64; 3],
    /// Their distances.
    pub scale: [f64; 3],
    /// Where the first one lies.
    pub translation: [f64; 3],
}

/// The steps of a series.
#[derive(Clone, Copy, Debug)]
pub struct ZarrTimes {
    /// The number of steps.
    pub count: u64,
    /// The time of the first one.
    pub start: f64,
    /// The time from each to the next.
    pub step: f64,
}

/// Units as OME-NGFF calls them.
const NAMES: [(&str, &str); 14] = [
    ("m", "meter"),
    ("km", "kilometer"),
    ("cm", "centimeter"),
    ("mm", "millimeter"),
    ("µm", "micrometer"),
    ("nm", "nanometer"),
    ("pm", "picometer"),
    ("Å", "angstrom"),
    ("s", "second"),
    ("ms", "millisecond"),
    ("µs", "microsecond"),
    ("ns", "nanosecond"),
    ("min", "minute"),
    ("h", "hour"),
];

/// The name of a unit; none of one that OME-NGFF has no name for.
pub fn unit_name(unit: &Unit) -> Option<&'static str> {
    NAMES.iter().find(|(own, _)| *own == unit.as_str()).map(|(_, name)| *name)
}

impl ZarrImage {
    /// Numbers for all axes, the slowest first, of those along time, and along x, y, z.
    fn along<T: Copy>(&self, time: T, channel: T, [x, y, z]: [T; 3]) -> Vec<T> {
        let of_time = self.times.is_some().then_some(time);
        let of_channel = (!self.channels.is_empty()).then_some(channel);
        of_time.into_iter().chain(of_channel).chain([z, y, x]).collect()
    }

    fn attributes(&self) -> Value {
        let axis = |name: &str, kind: &str, unit: Option<&Unit>| {
            let mut axis = json!({ "name": name, "type": kind });
            if let Some(unit) = unit.and_then(unit_name) {
                axis["unit"] = json!(unit);
            }
            axis
        };
        let length = self.units.length.as_ref();
        let time = self.times.is_some().then(|| axis("t", "time", self.units.time.as_ref()));
        let channel = (!self.channels.is_empty()).then(|| axis("c", "channel", None));
        let space = ["z", "y", "x"].map(|name| axis(name, "space", length));
        let axes: Vec<Value> = time.into_iter().chain(channel).chain(space).collect();
        let ZarrTimes { start, step, .. } =
            self.times.unwrap_or(ZarrTimes { count: 1, start: 0.0, step: 1.0 });
        let dataset = |(n, level): (usize, &ZarrLevel)| {
            json!({ "path": n.to_string(), "coordinateTransformations": [
                { "type": "scale", "scale": self.along(step, 1.0, level.scale) },
                { "type": "translation", "translation": self.along(start, 0.0, level.translation) },
            ] })
        };
        let datasets: Vec<Value> = self.levels.iter().enumerate().map(dataset).collect();
        let mut all = json!({ "multiscales": [
            { "version": "0.4", "name": self.name, "axes": axes, "datasets": datasets, "type": "wavelet" },
        ] });
        if !self.channels.is_empty() {
            let channel = |(label, [lo, hi]): &(String, [f64; 2])| {
                let window = json!({ "min": lo, "max": hi, "start": lo, "end": hi });
                json!({ "label": label, "color": "FFFFFF", "active": true, "window": window })
            };
            all["omero"] = json!({ "channels": self.channels.iter().map(channel).collect::<Vec<Value>>() });
        }
        all
    }

    fn chunk_dims(&self, level: usize) -> [u64; 3] {
        self.levels[level].dims.map(|n| n.min(self.chunk))
    }

    fn array(&self, level: usize) -> Value {
        let (times, channels) = (self.times.map_or(1, |times| times.count), self.channels.len() as u64);
        // Chunks that are not there would be of values that nothing has.
        let fill = if self.scalar.is_float() { json!("NaN") } else { json!(0) };
        let compressor = json!({ "id": "blosc", "cname": "zstd", "clevel": 3, "shuffle": 1, "blocksize": 0 });
        json!({
            "zarr_format": 2,
            "shape": self.along(times, channels, self.levels[level].dims),
            "chunks": self.along(1, 1, self.chunk_dims(level)),
            "dtype": numpy_type(self.scalar),
            "compressor": compressor,
            "fill_value": fill,
            "filters": null,
            "order": "C",
            "dimension_separator": "/",
        })
    }
}

/// An image while it is written.
pub struct ZarrFolder {
    stage: StagedFolder,
    image: ZarrImage,
    replace: bool,
    bytes: AtomicU64,
}

impl ZarrFolder {
    /// Begins an image that is to be called `path`. One that is there is replaced if that is
    /// wanted; any other folder or file is not.
    ///
    /// # Errors
    /// [`Error::Usage`] for what is not replaced; [`Error::Io`] when the system refuses to write.
    pub fn create(path: &Path, image: ZarrImage, replace: bool) -> Result<Self> {
        let refuse = |why: &str| Err(Error::usage(format!("cannot write {}: {why}", path.display())));
        let is_zarr = [".zgroup", ".zarray", "zarr.json"].iter().any(|name| path.join(name).is_file());
        match path.symlink_metadata() {
            Err(_) => {}
            Ok(_) if !replace => {
                return refuse("it exists; choose another name, or `replace=true` to replace it");
            }
            Ok(about) if about.is_dir() && is_zarr => {}
            Ok(_) => return refuse("it is there and no Zarr folder, which `replace=true` replaces"),
        }
        let replace = replace && path.exists();
        let folder = Self { stage: StagedFolder::begin(path)?, image, replace, bytes: AtomicU64::new(0) };
        folder.put(".zgroup", &text(&json!({ "zarr_format": 2 })))?;
        folder.put(".zattrs", &text(&folder.image.attributes()))?;
        for level in 0..folder.image.levels.len() {
            folder.put(&format!("{level}/.zarray"), &text(&folder.image.array(level)))?;
            let unit = folder.image.units.value.as_ref();
            let units = unit.map_or_else(|| json!({}), |unit| json!({ "units": unit.as_str() }));
            folder.put(&format!("{level}/.zattrs"), &text(&units))?;
        }
        Ok(folder)
    }

    /// Writes a file of the folder.
    fn put(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.stage.new_folder().join(name);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|e| Error::io("create the folder", folder, e))?;
        }
        let write = || {
            let mut file = File::create_new(&path)?;
            file.write_all(bytes)?;
            file.sync_all()
        };
        write().map_err(|e| Error::io("write", &path, e))?;
        self.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Ok(())
    }

    /// Samples of a chunk of a level.
    pub fn chunk_dims(&self, level: usize) -> [u64; 3] {
        self.image.chunk_dims(level)
    }

    /// Writes a chunk of a level, at a step and of a channel: the samples that lie in the volume,
    /// less the offset, x fastest.
    ///
    /// # Errors
    /// When the system refuses to write; [`Error::Usage`] for a value that the type does not have.
    pub fn write_chunk(
        &self,
        level: usize,
        [step, channel]: [u64; 2],
        at: [u64; 3],
        values: &[f32],
    ) -> Result<()> {
        let (image, chunk) = (&self.image, self.image.chunk_dims(level));
        let dims = image.levels[level].dims;
        let [w, h, d] = std::array::from_fn(|a| chunk[a].min(dims[a] - at[a] * chunk[a]) as usize);
        let [nx, ny, nz] = chunk.map(|n| n as usize);
        // Chunks at the end are whole ones, too.
        let mut bytes = Vec::with_capacity(nx * ny * nz * image.scalar.bytes());
        for z in 0..d {
            for y in 0..h {
                let row = &values[(z * h + y) * w..][..w];
                push_samples(&mut bytes, image.scalar, image.offset, row)?;
                bytes.resize((z * ny + y + 1) * nx * image.scalar.bytes(), 0);
            }
            bytes.resize((z + 1) * ny * nx * image.scalar.bytes(), 0);
        }
        bytes.resize(nz * ny * nx * image.scalar.bytes(), 0);
        let place: Vec<String> = image.along(step, channel, at).iter().map(u64::to_string).collect();
        let name = format!("{level}/{}", place.join("/"));
        let packed = blosc::encode(&bytes, image.scalar.bytes());
        let packed = packed.map_err(|e| Error::io("compress", self.stage.new_folder().join(&name), e))?;
        self.put(&name, &packed)
    }

    /// Gives the folder its name; returns the bytes of its files.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn publish(self) -> Result<u64> {
        self.stage.publish(self.replace)?;
        Ok(self.bytes.into_inner())
    }
}

fn text(value: &Value) -> Vec<u8> {
    format!("{value:#}\n").into_bytes()
}
