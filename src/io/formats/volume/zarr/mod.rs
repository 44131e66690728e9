//! Zarr arrays, versions 2 and 3, and OME-Zarr images: folders of chunks, each a separately
//! compressed file.
//!
//! ```text
//!  image.ome.zarr/            a group; .zattrs (2) or zarr.json (3) tell the levels, axes, spacing
//!    0/                       an array, full resolution: .zarray (2) or zarr.json (3)
//!      0/0/0  0/0/1  …        chunks (2, by "/" or "."); c/0/0/0 … (3)
//!    1/                       the next level, coarser
//! ```
//!
//! On a server ([`crate::bytes::remote`]) a chunk is fetched in one request, or as a range of its
//! shard. Groups without OME-Zarr's metadata are listed, or have consolidated metadata. Where a
//! server denies a file, that is an error, unless the metadata of another version are there.
//!
//! The path is the group or an array in it (`image.ome.zarr/1`). In a group, `field` chooses one
//! array: by its path, the first part of that, or "scaleN" for level N. Without a choice an
//! OME-Zarr image gives its first level, which is the full image.
//!
//! Axes x, y, z are found by their names (OME-Zarr's `axes`, `dimension_names`,
//! `_ARRAY_DIMENSIONS`); without names the last axis is x, the one before y, then z. Two more axes
//! may have several entries. One has the frames of a series; it is named t or time, or is the first
//! of four without names. The frames are the fields `NAME:t0`, `NAME:t1`, …; their times are those
//! of OME-Zarr's `coordinateTransformations`. The other has channels; it is named c or channel.
//! They are the fields `NAME:LABEL`, with the labels of OME-Zarr's `omero`, or `NAME:c0`,
//! `NAME:c1`, …; their frames are `NAME:LABEL:t0`, …. All others must have one entry. Spacing and
//! origin are those of `coordinateTransformations`; else of the arrays next to the array that are
//! named like its axes (xarray), which make a rectilinear grid where they are not regular; else 1
//! and 0. Units of single axes become one, and a scale that is stored as another array is refused.
//! `scale_factor`, `add_offset`, `_FillValue` and `missing_value` are used. Four axes
//! without names are refused if the last has at most four entries: these are vectors, or colours. A
//! chunk of several frames is decoded for each of them.
//!
//! The reader knows these compressors: Blosc (with BloscLZ, LZ4, zlib, zstd; shuffled by bytes or
//! bits), gzip, zlib, zstd, LZ4; also shards with their index, CRC32C, `transpose`, order C or F.
//! Others are refused by name. A missing chunk reads as the fill value, as Zarr specifies.
//!
//! Chunks are decoded in their order, each once, or as they are asked for
//! ([`crate::volume::chunked`]). Memory: one chunk, stored and decoded (in a shard, one of its
//! chunks), and a slab of at most 4 MiB. Chunks of more than a gibibyte are refused.
//!
//! The reader is our own, because chunks are files with compressors that we have anyway, and only
//! one chunk is needed at a time. The formats: <https://zarr-specs.readthedocs.io>,
//! <https://ngff.openmicroscopy.org>.

mod codec;
mod meta;
mod store;

use crate::bytes::IoMode;
use crate::bytes::place::above;
use crate::bytes::remote::is_remote;
use crate::error::{Error, Fault, Result};
use crate::formats::shared::axes::{AxisLayout, layout};
use crate::formats::shared::cf::{
    self, AttributeNumbers, Attributes, Convert, Line, MOST_COORDINATES, Packing,
};
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::entries::{Channel, Entries, channels, field_name};
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::header::{geometry, given_geometry, plain_info, scaled_axes};
use crate::formats::shared::lengths::Lengths;
use crate::formats::shared::numbers::to_f64;
use crate::formats::shared::small::SmallFiles;
use crate::formats::shared::stream::sample_bytes;
use crate::formats::shared::{Frames, OpenOptions, known_times, pick_field};
use crate::grid::Geometry;
use crate::volume::chunked::{ChunkSlabs, ChunkSource, refuse_many_chunks};
use crate::volume::strided::swap_bytes;
use crate::volume::units::{Unit, Units, common};
use crate::volume::{FieldInfo, ScalarType, SlabStream, VolumeInfo, VolumeSource};
use base64::prelude::{BASE64_STANDARD, Engine};
use byteorder::{ByteOrder, LE};
use meta::ZarrArray;
use serde_json::Value;
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use store::{StorePart, Zip, folders_in, open_if_there, ranges_if_there};

/// A folder with a Zarr array or a group of them.
pub(in crate::formats) struct Zarr;

static ABOUT: About = About {
    volumes: &["Zarr"],
    on_servers: true,
    has_spacing: false,
    has_channels: true,
    has_scales: true,
    ..About::named("a Zarr array or group")
};

impl Format for Zarr {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        head.is_folder && (is_remote(head.path) || is_zarr(head.path, head.small()).is_ok_and(|found| found))
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let archive = store::held(head.path, head.io)?;
        let (small, io, numbers) = (Arc::clone(head.small()), head.io, Mutex::default());
        let store = Store { archive, small, io, numbers };
        let (image, arrays) = arrays(&store, head.path)?;
        let fields = fields(&store, image.as_ref(), &arrays)?;
        let path = head.path.to_path_buf();
        Ok(Box::new(Group { path, store, image, arrays, fields }))
    }
}

/// Where arrays are, and what was read there.
struct Store {
    /// The archive that they are in, which stays open.
    archive: Option<Arc<Zip>>,
    io: IoMode,
    /// The metadata.
    small: Arc<SmallFiles>,
    /// The numbers of arrays of one axis, by their folders.
    numbers: Mutex<BTreeMap<PathBuf, Arc<Vec<f64>>>>,
}

/// An array, or a group of some.
struct Group {
    path: PathBuf,
    store: Store,
    /// The image that the arrays are levels of.
    image: Option<Image>,
    arrays: Named,
    fields: Vec<ZarrField>,
}

impl Dataset for Group {
    fn files(&self) -> Vec<PathBuf> {
        match store::archive_in(&self.path) {
            Some((archive, _)) => vec![archive.to_path_buf()],
            None => self.store.small.paths(),
        }
    }

    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        self.open(options)
    }

    fn coordinates(&self, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
        self.coordinates_of(options)
    }

    fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        self.frames(options)
    }

    fn time(&self, options: &OpenOptions) -> Result<Option<f64>> {
        self.one_time(options)
    }

    fn calendar(&self, options: &OpenOptions) -> Result<String> {
        let field = &self.fields[self.choose(options)?];
        let axis = field.frame.map(|frame| frame.axis).or(field.record);
        let times = times_of(&self.store, &self.arrays[field.array].1, axis);
        Ok(times.map_or_else(String::new, |times| times.calendar))
    }

    fn times(&self, _: &OpenOptions) -> Result<HashMap<String, f64>> {
        self.frames_of(|_| true).map(known_times)
    }
}

/// Most bytes of a decoded chunk.
const MOST_CHUNK: u64 = 1 << 30;
/// Shards that are open at a time, and bytes of their indices, unless one has more.
const MOST_OPEN: u64 = 32;
const OPEN_INDICES: u64 = 4 << 20;
/// Most frames of all channels of an array.
const MOST_FRAMES: u64 = 1 << 16;
/// If an array has more chunk files than this, this many of them, evenly spread, stand for all in
/// [`VolumeInfo::data_files`].
const LISTED: u64 = 1 << 20;

/// Whether a folder is a Zarr array or group.
///
/// # Errors
/// When a server fails.
pub(in crate::formats) fn is_zarr(folder: &Path, small: &SmallFiles) -> Result<bool> {
    if let Some((archive, name)) = store::archive_in(folder) {
        for file in METADATA {
            if store::exists(&folder.join(file))? {
                return Ok(true);
            }
        }
        if name.as_os_str().is_empty() {
            store::refuse_folder(archive, &METADATA)?;
        }
        return Ok(false);
    }
    if !is_remote(folder) {
        return Ok(METADATA.iter().any(|f| folder.join(f).is_file()));
    }
    let mut denied = Ok(false);
    for file in METADATA {
        match meta::json(small, &folder.join(file)) {
            Ok(None) => {}
            Ok(Some(_)) => return Ok(true),
            // Another one may be readable: S3 denies what is not there, too.
            Err(e) if e.is_denied() => denied = denied.and(Err(e)),
            Err(e) => return Err(e),
        }
    }
    denied
}

/// Whether a path on this machine is an array or group in a zip archive.
pub(in crate::formats) fn is_in_archive(path: &Path, small: &SmallFiles) -> Result<bool> {
    Ok(!is_remote(path) && store::archive_in(path).is_some() && is_zarr(path, small)?)
}

/// Names of metadata: one of them is in each array and group.
const METADATA: [&str; 4] = ["zarr.json", ".zattrs", ".zarray", ".zgroup"];

impl Group {
    /// The volume of the field that is wanted.
    fn open(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let (path, store) = (&*self.path, &self.store);
        let field = &self.fields[self.choose(options)?];
        let ZarrField { array, axes, fixed, frame, record, .. } = field;
        let (array, axes) = (&self.arrays[*array].1, *axes);
        let image = self.image_of(array)?;
        let time = frame.map(|frame| frame.axis);
        let dims = axes.map(|a| a.map_or(1, |a| array.shape[a]));
        sample_bytes(&array.file, dims, array.scalar)?;
        check_chunks(array)?;
        refuse_many_chunks(&array.file, dims, axes.map(|a| a.map_or(1, |a| array.unit()[a])))?;
        let lines = lines(store, array, axes)?;
        if image.is_some() || lines.iter().any(Option::is_some) {
            options.refuse_other_geometry(path, "a Zarr array with coordinates")?;
        }
        let geometry = match &image {
            Some(image) => image.placed(array, axes)?,
            None => cf::placed(&array.file, &lines, [0, 1, 2], [1.0; 3])?,
        };
        let geometry = given_geometry(path, options, geometry)?;
        let mut info = plain_info(path, format_name(array, image.is_some()), dims, array.scalar, geometry);
        if image.is_none() {
            refuse_hyperspy(store, array)?;
            info.assumed = options.assumed([0, 1, 2].map(|a| lines[a].is_none()));
        }
        let convert = packing(array)?.into_info(&mut info);
        let lengths = match &image {
            Some(image) => image.lengths(axes)?,
            None => line_lengths(store, array, axes),
        };
        info.notes.extend(lengths.note.clone());
        info.units = match &image {
            Some(image) => image.units(array, &lengths, time),
            None => {
                let time = times_of(store, array, time.or(*record)).map(|times| times.unit);
                cf::units(text(array, "units"), &lengths, time)
            }
        };
        info.field = field.info.clone();
        if convert.is_some() {
            info.field.scalar = ScalarType::F64;
        }
        info.fields = self.fields.iter().map(|f| f.info.clone()).collect();
        info.data_files = match store::archive_in(path) {
            Some((archive, _)) => vec![archive.to_path_buf()],
            None => files(array, fixed),
        };
        let archive = store.archive.clone();
        let chunks = Chunks::new(info, array.clone(), axes, fixed.clone(), store.io);
        Ok(VolumeSource::Chunked(Arc::new(Chunks { archive, convert, ..chunks })))
    }

    /// The image that an array is a level of.
    fn image_of(&self, array: &ZarrArray) -> Result<Option<Image>> {
        match &self.image {
            Some(image) => Ok(Some(image.clone())),
            None => image_around(&self.store, &array.folder),
        }
    }
}

/// The format, as a person would call it.
fn format_name(array: &ZarrArray, of_image: bool) -> String {
    let compressor = array.codecs.iter().map(|c| c.name()).collect::<Vec<_>>().join(" + ");
    let compressor = if compressor.is_empty() { "raw" } else { &compressor };
    let sharded = if array.shard.is_some() { ", shards" } else { "" };
    let kind = if of_image { "OME-Zarr" } else { "Zarr" };
    format!("{kind} (version {}, {compressor}{sharded})", array.version)
}

/// Fails for an array of HyperSpy (.zspy), whose axes are groups beside it.
fn refuse_hyperspy(store: &Store, array: &ZarrArray) -> Result<()> {
    let axis = array.folder.parent().map(|group| group.join("axis-0"));
    let Some(axis) = axis.filter(|axis| !is_remote(axis)) else { return Ok(()) };
    let of_3 = meta::json(&store.small, &axis.join("zarr.json"))?.map(|json| json["attributes"].clone());
    let attributes = match of_3 {
        None => meta::json(&store.small, &axis.join(".zattrs"))?,
        found => found,
    };
    if attributes.is_none_or(|attributes| attributes.get("navigate").is_none()) {
        return Ok(());
    }
    let got = "an array of HyperSpy (.zspy), whose axes are the groups 'axis-0' and so on beside it";
    Err(Error::bad_input(&array.folder, "kind of Zarr array", "OME-Zarr, or coordinates of CF", got)
        .with_help("save it as .hspy"))
}

impl Group {
    /// The number of the field that is read.
    fn choose(&self, options: &OpenOptions) -> Result<usize> {
        let Self { path, image, arrays, fields, .. } = self;
        if let Some(wanted) = WantedField::of(path, options, image.as_ref(), arrays)? {
            if let Some(number) = fields.iter().position(|f| wanted.is(f)) {
                return Ok(number);
            }
            let of_array = fields.iter().filter(|f| f.array == wanted.array);
            let once = of_array.filter(|f| f.frame.is_none_or(|t| t.number == 0));
            let channels = once.filter_map(|f| f.channel.as_ref());
            if let Some(error) = wanted.entries.no_channel(path, options, channels) {
                return Err(error);
            }
        }
        let infos: Vec<FieldInfo> = fields.iter().map(|f| f.info.clone()).collect();
        pick_field(path, &infos, options.field.as_deref())
    }

    /// The frames of the array that is wanted, or that is read without a choice, by the names of
    /// their fields, and their times, where OME-Zarr states them. None where there is one volume.
    fn frames(&self, options: &OpenOptions) -> Result<Frames> {
        let wanted = WantedField::of(&self.path, options, self.image.as_ref(), &self.arrays)?;
        let wanted = wanted.filter(|wanted| wanted.entries.frame.is_none());
        wanted.map_or(Ok(vec![]), |wanted| self.frames_of(|f| wanted.is_series(f)))
    }

    /// The time of the array that is read, or of all of them, where it is one time. OME-Zarr states
    /// none for a single frame.
    fn one_time(&self, options: &OpenOptions) -> Result<Option<f64>> {
        if self.image.is_some() {
            return Ok(None);
        }
        let of_field = |field: &ZarrField| {
            let axis = field.frame.map(|frame| frame.axis).or(field.record);
            let times = times_of(&self.store, &self.arrays[field.array].1, axis)?;
            times.values.get(field.frame.map_or(0, |frame| frame.number) as usize).copied()
        };
        if options.field.is_some() {
            return Ok(of_field(&self.fields[self.choose(options)?]));
        }
        let times: Vec<Option<f64>> = self.fields.iter().map(of_field).collect();
        let is_series = self.fields.iter().any(|field| field.frame.is_some());
        Ok(common(times).filter(|_| !is_series))
    }

    fn frames_of(&self, taken: impl Fn(&ZarrField) -> bool) -> Result<Frames> {
        let mut out = vec![];
        for field in self.fields.iter().filter(|field| taken(field)) {
            let Some(frame) = field.frame else { continue };
            let array = &self.arrays[field.array].1;
            let time = match self.image_of(array)? {
                Some(image) => {
                    let (scale, shift) = image.scale_and_shift(array, frame.axis)?;
                    Some(shift + scale * frame.number as f64)
                }
                None => line(&self.store, array, frame.axis)?
                    .and_then(|line| line.values.get(frame.number as usize).copied()),
            };
            out.push((field.info.name.clone(), time.filter(|t| t.is_finite())));
        }
        Ok(out)
    }

    /// The coordinates along the axes of the array that is read, where those of one of them are not
    /// regular; else `None`.
    fn coordinates_of(&self, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
        if self.image.is_some() {
            return Ok(None);
        }
        let field = &self.fields[self.choose(options)?];
        let array = &self.arrays[field.array].1;
        let lines = lines(&self.store, array, field.axes)?;
        if image_around(&self.store, &array.folder)?.is_some() {
            return Ok(None);
        }
        let dims = field.axes.map(|a| a.map_or(1, |a| array.shape[a]));
        cf::grid_of(&self.path, &field.info.name, lines, [0, 1, 2], dims)
    }
}

/// The times of an array.
struct Times {
    values: Vec<f64>,
    unit: String,
    calendar: String,
}

/// The times along an axis, else the single one of an array beside it. None where it has no such
/// coordinates.
fn times_of(store: &Store, array: &ZarrArray, axis: Option<usize>) -> Option<Times> {
    let times = |own: ZarrArray| {
        let [unit, calendar] = ["units", "calendar"].map(|name| text(&own, name).to_owned());
        Some(Times { values: numbers(store, own).ok()?.to_vec(), unit, calendar })
    };
    if axis.is_some() {
        return times(line_array(store, array, axis?).ok()??);
    }
    let group = array.folder.parent()?;
    let names = cf::names_of_time(text(array, "coordinates")).filter(|(name, _)| is_inside(name));
    names.into_iter().find_map(|(name, most_axes)| {
        let own = meta::array(&store.small, &group.join(name)).ok()??;
        let kind = cf::kind_of_coordinate(name, text(&own, "axis"), text(&own, "units"));
        let is_one = own.shape.len() <= most_axes && own.shape.iter().all(|&n| n == 1);
        if kind == 't' && is_one { times(own) } else { None }
    })
}

/// The coordinates along x, y, z, where arrays next to the array have them, as xarray writes them.
fn lines(store: &Store, array: &ZarrArray, axes: Axes) -> Result<[Option<Line>; 3]> {
    let [x, y, z] = axes.map(|axis| axis.map_or(Ok(None), |axis| line(store, array, axis)));
    Ok(cf::in_one_unit([x?, y?, z?], &line_lengths(store, array, axes), [0, 1, 2]))
}

/// The lengths along x, y, z, by the units of these arrays.
fn line_lengths(store: &Store, array: &ZarrArray, axes: Axes) -> Lengths {
    cf::lengths(axes.map(|axis| line_unit(store, array, axis)), [0, 1, 2])
}

/// The numbers of the array of one axis that is named like an axis of an array, and lies next to
/// it. What is there but is no such array is ignored.
///
/// # Errors
/// When they cannot be read.
fn line(store: &Store, array: &ZarrArray, axis: usize) -> Result<Option<Line>> {
    match try_line(store, array, axis) {
        Err(e @ Error::Io { .. }) => Err(e),
        found => Ok(found.ok().flatten()),
    }
}

/// The array that is named like an axis of an array.
fn line_array(store: &Store, array: &ZarrArray, axis: usize) -> Result<Option<ZarrArray>> {
    let names = array.names.as_ref().filter(|n| n.len() == array.shape.len());
    let Some(name) = names.and_then(|n| n.get(axis)).filter(|name| is_inside(name)) else { return Ok(None) };
    let Some(folder) = array.folder.parent().map(|group| group.join(name)) else { return Ok(None) };
    let own = meta::array(&store.small, &folder)?;
    Ok(own.filter(|own| own.shape == [array.shape[axis]] && own.shape[0] <= MOST_COORDINATES))
}

fn try_line(store: &Store, array: &ZarrArray, axis: usize) -> Result<Option<Line>> {
    let Some(own) = line_array(store, array, axis)? else { return Ok(None) };
    let single = own.scalar == ScalarType::F32;
    Ok(Some(Line::new(numbers(store, own)?.to_vec(), single)))
}

/// The numbers of an array of at most one axis.
fn numbers(store: &Store, own: ZarrArray) -> Result<Arc<Vec<f64>>> {
    let mut known = store.numbers.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(numbers) = known.get(&own.folder) {
        return Ok(Arc::clone(numbers));
    }
    let folder = own.folder.clone();
    let numbers = Arc::new(read_numbers(own, store.io)?);
    known.insert(folder, Arc::clone(&numbers));
    Ok(numbers)
}

fn read_numbers(own: ZarrArray, io: IoMode) -> Result<Vec<f64>> {
    check_chunks(&own)?;
    let packing = packing(&own)?;
    let count = own.shape.first().copied().unwrap_or(1);
    let info = plain_info(&own.file, "Zarr", [count, 1, 1], own.scalar, Geometry::default());
    let (scalar, along) = (own.scalar, (!own.shape.is_empty()).then_some(0));
    let chunks = Chunks::new(info, own, [along, None, None], vec![], io);
    let (mut chunks, mut bytes, mut out) = (ChunkSlabs::new(Arc::new(chunks)), vec![], vec![]);
    while chunks.next_slab(&mut bytes)?.is_some() {
        let mut part = vec![0.0; bytes.len() / scalar.bytes()];
        to_f64(scalar, &bytes, &mut part);
        out.extend(part);
    }
    packing.unpack(&mut out);
    Ok(out)
}

/// An attribute that is text, else "".
fn text<'a>(array: &'a ZarrArray, name: &str) -> &'a str {
    array.attributes[name].as_str().unwrap_or_default()
}

/// The unit of the coordinates along an axis.
fn line_unit(store: &Store, array: &ZarrArray, axis: Option<usize>) -> Option<String> {
    let own = line_array(store, array, axis?).ok()??;
    Some(text(&own, "units").to_owned())
}

impl Attributes for ZarrArray {
    fn numbers(&self, name: &str) -> Result<Option<AttributeNumbers>> {
        let value = &self.attributes[name];
        let list = match value {
            Value::Null => return Ok(None),
            Value::Array(list) => &list[..],
            one => std::slice::from_ref(one),
        };
        let number = |value: &Value| match value {
            // In version 3 xarray writes floats as base64 of a little-endian f64.
            Value::String(text) => {
                let bytes = BASE64_STANDARD.decode(text).ok().and_then(|b| <[u8; 8]>::try_from(b).ok());
                bytes.map(f64::from_le_bytes).or_else(|| text.parse().ok())
            }
            value => value.as_f64(),
        };
        let values = list.iter().map(number).collect::<Option<Vec<f64>>>();
        let values = values.ok_or_else(|| self.wrong(name, "numbers", value.to_string()))?;
        Ok(Some(AttributeNumbers { values, are_floats: list.iter().any(|v| !v.is_i64() && !v.is_u64()) }))
    }

    fn text(&self, name: &str) -> String {
        match &self.attributes[name] {
            Value::Bool(word) => word.to_string(),
            other => other.as_str().unwrap_or_default().to_owned(),
        }
    }

    fn wrong(&self, names: &str, expected: &str, got: String) -> Error {
        Error::bad_input(attributes_file(self), names, expected, got)
    }
}

/// What CF's attributes say about stored numbers. A missing chunk reads as Zarr's own `fill_value`.
/// This value means "no data" where numbers are packed and no attribute names such a value, as
/// xarray writes them.
fn packing(array: &ZarrArray) -> Result<Packing> {
    Packing::of(array, array.scalar, |is_packed| {
        let mut fill = [0.0];
        to_f64(array.scalar, &array.fill, &mut fill);
        is_packed.then_some(fill[0])
    })
}

/// The file that has the attributes of an array.
fn attributes_file(array: &ZarrArray) -> PathBuf {
    match array.file.file_name() {
        Some(name) if name == ".zarray" => array.file.with_file_name(".zattrs"),
        _ => array.file.clone(),
    }
}

/// A volume that can be chosen: an array, or a channel or frame of one.
struct ZarrField {
    info: FieldInfo,
    /// The number of the array.
    array: usize,
    axes: Axes,
    channel: Option<Channel>,
    frame: Option<FixedEntry>,
    /// The axis of time, where it has one entry.
    record: Option<usize>,
    /// The entries of both.
    fixed: Vec<FixedEntry>,
}

/// An array's axes along x, y, z.
type Axes = [Option<usize>; 3];

/// One entry of an axis that is not of space.
#[derive(Clone, Copy, Debug)]
struct FixedEntry {
    axis: usize,
    number: u64,
}

/// All fields. An array whose axes are not understood is left out, unless it is the only one.
fn fields(store: &Store, image: Option<&Image>, arrays: &Named) -> Result<Vec<ZarrField>> {
    let (mut fields, mut refused) = (vec![], None);
    for (number, (name, array)) in arrays.iter().enumerate() {
        let around = match image {
            Some(_) => None,
            None => image_around(store, &array.folder)?,
        };
        let image = image.or(around.as_ref());
        let found = match image {
            None => cf::refuse_mesh(array, array.names.as_deref().unwrap_or_default()),
            Some(_) => Ok(()),
        };
        let AllAxes { space, time, record, channel } = match found.and_then(|()| axes(store, array, image)) {
            Ok(found) => found,
            Err(e) => {
                refused = refused.or(Some(e));
                continue;
            }
        };
        let entries = |axis: Option<usize>| -> Vec<Option<FixedEntry>> {
            let all =
                |axis: usize| (0..array.shape[axis]).map(move |number| Some(FixedEntry { axis, number }));
            axis.map_or_else(|| vec![None], |axis| all(axis).collect())
        };
        let labels = image.map_or(&[][..], |image| &image.channels);
        let all = channel.map(|axis| channels(labels, array.shape[axis]));
        for of_channel in entries(channel) {
            let channel = of_channel.zip(all.as_ref()).map(|(entry, all)| &all[entry.number as usize]);
            for frame in entries(time) {
                let name = field_name(name, channel, frame.map(|t| t.number));
                fields.push(ZarrField {
                    info: FieldInfo { name, scalar: array.scalar, components: 1 },
                    array: number,
                    axes: space,
                    fixed: of_channel.into_iter().chain(frame).collect(),
                    channel: channel.cloned(),
                    frame,
                    record,
                });
            }
        }
    }
    match refused {
        Some(e) if fields.is_empty() => Err(e),
        _ => Ok(fields),
    }
}

/// The field that a user means.
struct WantedField {
    array: usize,
    entries: Entries,
}

impl WantedField {
    /// That of a word: an array (itself, the one whose path starts with it, or "scaleN" the one at
    /// that level), and with colons its channel and frame. Without a word the first level of an
    /// image, or the only array.
    ///
    /// # Errors
    /// [`Error::Usage`] for a level that there is not.
    fn of(path: &Path, options: &OpenOptions, image: Option<&Image>, arrays: &Named) -> Result<Option<Self>> {
        let level = level(path, options, image, arrays)?;
        let Some(wanted) = &options.field else {
            let array = level.or((image.is_some() || arrays.len() == 1).then_some(0));
            return Ok(array.map(|array| Self { array, entries: Entries::of("", options) }));
        };
        let named = Self::named(wanted, options, arrays);
        match (&named, level) {
            (Some(field), Some(level)) if field.array != level => {
                Err(Error::usage("`field` is of another level than `scale`: leave out one of them"))
            }
            _ => Ok(named),
        }
    }

    fn named(wanted: &str, options: &OpenOptions, arrays: &Named) -> Option<Self> {
        let position = |is: &dyn Fn(&str) -> bool| arrays.iter().position(|(name, _)| is(name));
        let (word, rest) = match position(&|name| name == wanted) {
            Some(_) => (wanted, ""),
            None => wanted.split_once(':').unwrap_or((wanted, "")),
        };
        let level = || word.strip_prefix("scale")?.parse::<usize>().ok().filter(|n| *n < arrays.len());
        let starts = |name: &str| name.strip_prefix(word).is_some_and(|rest| rest.starts_with('/'));
        let array = position(&|name| name == word).or_else(|| position(&starts)).or_else(level)?;
        Some(Self { array, entries: Entries::of(rest, options) })
    }

    /// Whether it is this field.
    fn is(&self, field: &ZarrField) -> bool {
        self.is_series(field) && self.entries.frame == field.frame.map(|t| t.number)
    }

    /// Whether it is this field, or a series that it is a frame of.
    fn is_series(&self, field: &ZarrField) -> bool {
        self.array == field.array && self.entries.are_of(field.channel.as_ref())
    }
}

/// The number of the level that a user asks for.
fn level(path: &Path, options: &OpenOptions, image: Option<&Image>, arrays: &Named) -> Result<Option<usize>> {
    let Some(scale) = &options.scale else { return Ok(None) };
    if image.is_none() {
        options.refuse_scale(path)?;
    }
    let by_name = arrays.iter().position(|(name, _)| name == scale);
    let by_number = || scale.parse().ok().filter(|n| *n < arrays.len());
    if let Some(found) = by_name.or_else(by_number) {
        return Ok(Some(found));
    }
    let level = |(name, array): &(String, ZarrArray)| {
        let shape: Vec<String> = array.shape.iter().map(u64::to_string).collect();
        format!("{name} ({})", shape.join(" x "))
    };
    let levels: Vec<String> = arrays.iter().map(level).collect();
    let text = format!("there is no level '{scale}'; `scale` takes one of {}", levels.join(", "));
    Err(Error::usage(format!("{}: {text}", path.display())))
}

/// Where OME-Zarr says the place of samples.
const TRANSFORMATIONS: &str = "coordinateTransformations";

/// An image of an OME-Zarr group: its `multiscales` entry.
#[derive(Clone, Debug)]
struct Image {
    group: PathBuf,
    multiscale: Value,
    /// The labels of its channels.
    channels: Vec<String>,
}

/// The image that a group describes.
fn image(store: &Store, group: &Path) -> Result<Option<Image>> {
    let json = |name: &str| meta::json(&store.small, &group.join(name));
    let [v3, v2] = match (json("zarr.json"), json(".zattrs")) {
        // A server that denies what is not there does not hide a group of version 2.
        (Err(e), Ok(Some(v2))) if e.is_denied() => [None, Some(v2)],
        (Ok(Some(v3)), Err(e)) if e.is_denied() => [Some(v3), None],
        (v3, v2) => [v3?, v2?],
    }
    .map(Option::unwrap_or_default);
    let attributes = &v3["attributes"];
    let lists = [&attributes["ome"]["multiscales"], &attributes["multiscales"], &v2["multiscales"]];
    let multiscale = lists.into_iter().find_map(|l| l.get(0)).cloned();
    let omero = [&attributes["ome"]["omero"], &attributes["omero"], &v2["omero"]];
    let channels = omero.into_iter().find_map(|o| o["channels"].as_array()).into_iter().flatten();
    let channels = channels.map(|c| c["label"].as_str().unwrap_or_default().trim().to_owned()).collect();
    Ok(multiscale.map(|multiscale| Image { group: group.to_path_buf(), multiscale, channels }))
}

/// The image that an array belongs to: described by a folder above it.
fn image_around(store: &Store, folder: &Path) -> Result<Option<Image>> {
    for above in above(folder).take(3) {
        if (is_remote(above) || is_zarr(above, &store.small)?)
            && let Some(image) = image(store, above)?
            && image.levels().any(|l| above.join(path_of(l)) == folder)
        {
            return Ok(Some(image));
        }
    }
    Ok(None)
}

fn path_of(level: &Value) -> &str {
    level["path"].as_str().unwrap_or_default()
}

impl Image {
    fn levels(&self) -> impl Iterator<Item = &Value> {
        self.multiscale["datasets"].as_array().into_iter().flatten()
    }

    fn unit(&self, axis: usize) -> Option<&str> {
        self.multiscale["axes"][axis]["unit"].as_str()
    }

    /// The lengths along x, y, z. An axis that the image does not have is no obstacle.
    fn lengths(&self, space: Axes) -> Result<Lengths> {
        let first = space.into_iter().flatten().next();
        let units = space.map(|axis| self.unit(axis.or(first)?).and_then(Unit::length));
        Lengths::of_space(&self.group, "multiscales, units of the axes", units)
    }

    /// The units of the axes, and of values where the array has them.
    fn units(&self, array: &ZarrArray, lengths: &Lengths, time: Option<usize>) -> Units {
        Units {
            value: Unit::new(text(array, "units")),
            length: lengths.unit.clone(),
            time: time.and_then(|axis| self.unit(axis)).and_then(Unit::time),
        }
    }

    /// Scale and translation of an array's samples along x, y, z.
    fn placed(&self, array: &ZarrArray, axes: Axes) -> Result<Geometry> {
        let (mut spacing, mut origin) = ([1.0; 3], [0.0; 3]);
        for (a, axis) in axes.into_iter().enumerate() {
            if let Some(axis) = axis {
                (spacing[a], origin[a]) = self.scale_and_shift(array, axis)?;
            }
        }
        let lengths = self.lengths(axes)?;
        let (origin, spacing) = (lengths.of_vector(origin), lengths.of_vector(spacing));
        geometry(&self.group, TRANSFORMATIONS, origin, scaled_axes(spacing))
    }

    /// Scale and translation of an array's entries along one of its axes.
    fn scale_and_shift(&self, array: &ZarrArray, axis: usize) -> Result<(f64, f64)> {
        let level = self.levels().find(|l| self.group.join(path_of(l)) == array.folder);
        let lists = [level.map(|l| &l[TRANSFORMATIONS]), Some(&self.multiscale[TRANSFORMATIONS])];
        let (mut scale, mut shift) = (1.0, 0.0);
        for step in lists.into_iter().flatten().filter_map(Value::as_array).flatten() {
            let (by, then) = self.transformation(step, array.shape.len(), axis)?;
            (scale, shift) = (scale * by, shift * by + then);
        }
        Ok((scale, shift))
    }

    /// What one transformation does along an axis of `rank` axes.
    fn transformation(&self, step: &Value, rank: usize, axis: usize) -> Result<(f64, f64)> {
        let kind = step["type"].as_str().unwrap_or_default();
        let wrong = |got: String| {
            let expected = "the numbers of a scale or translation, one for each axis";
            Error::bad_input(&self.group, TRANSFORMATIONS, expected, got)
        };
        if let Some(path) = step["path"].as_str() {
            let got = format!("a {kind} that is stored as the array {path:?}");
            return Err(wrong(got).with_help("write its numbers into the metadata"));
        }
        if !matches!(kind, "" | "identity" | "scale" | "translation") {
            let got = format!("a transformation of the type {kind:?}");
            return Err(wrong(got).with_help("resample the image to a grid with scale and translation"));
        }
        let number = |key: &str| -> Result<Option<f64>> {
            let list = &step[key];
            if list.is_null() && kind != key {
                return Ok(None);
            }
            let number = list.as_array().filter(|l| l.len() == rank).and_then(|l| l[axis].as_f64());
            number.map(Some).ok_or_else(|| wrong(format!("{key} {list} for {rank} axes")))
        };
        Ok((number("scale")?.unwrap_or(1.0), number("translation")?.unwrap_or(0.0)))
    }
}

/// Arrays by name.
type Named = Vec<(String, ZarrArray)>;

/// The arrays that a path offers, and the image that they are levels of.
fn arrays(store: &Store, path: &Path) -> Result<(Option<Image>, Named)> {
    let array = |folder: &Path| meta::array(&store.small, folder);
    if let Some(array) = array(path)? {
        return Ok((None, vec![("data".into(), array)]));
    }
    if let Some(image) = image(store, path)? {
        let mut arrays = vec![];
        for level in image.levels() {
            let name = path_of(level);
            let found = if is_inside(name) { array(&path.join(name))? } else { None };
            let array = found.ok_or_else(|| {
                Error::bad_input(path, "multiscales", format!("an array at {name}"), "none")
                    .with_help("a level of the image is missing; name one that is there")
            })?;
            arrays.push((name.to_string(), array));
        }
        return Ok((Some(image), arrays));
    }
    let mut names = names_in(store, path)?;
    names.sort();
    let (mut arrays, mut refused) = (vec![], None);
    for name in names {
        match array(&path.join(&name)) {
            Ok(Some(array)) if array.shape.len() >= 3 => arrays.push((name, array)),
            Ok(_) => {}
            Err(e) => refused = refused.or(Some(e)),
        }
    }
    match refused {
        Some(e) if arrays.is_empty() => Err(e),
        _ => Ok((None, arrays)),
    }
}

/// The names of the folders in a group. A web server lists none: what the group's consolidated
/// metadata name is there.
fn names_in(store: &Store, group: &Path) -> Result<Vec<String>> {
    let listed = folders_in(group);
    if listed.is_ok() || !is_remote(group) {
        return listed;
    }
    let of_3 = meta::json(&store.small, &group.join("zarr.json"))?.unwrap_or_default();
    let of_2 = meta::json(&store.small, &group.join(".zmetadata"))?.unwrap_or_default();
    let of_3 = of_3["consolidated_metadata"]["metadata"].as_object().map(|all| all.keys());
    let of_2 = of_2["metadata"].as_object().map(|all| all.keys());
    let mut names: Vec<String> = match (of_3, of_2) {
        (None, None) => return listed,
        (Some(paths), _) => paths.filter(|path| !path.contains('/')).cloned().collect(),
        (None, Some(paths)) => {
            let arrays = paths.filter_map(|path| path.strip_suffix("/.zarray"));
            arrays.filter(|path| !path.contains('/')).map(str::to_owned).collect()
        }
    };
    names.retain(|name| is_inside(name));
    Ok(names)
}

/// Whether a path leads to what is in a group: another would read what the user did not name.
fn is_inside(path: &str) -> bool {
    Path::new(path).components().all(|c| matches!(c, std::path::Component::Normal(_)))
}

/// What the axes of an array are. Those of time and of channels have several entries.
struct AllAxes {
    space: Axes,
    time: Option<usize>,
    /// The axis of time, where it has one entry.
    record: Option<usize>,
    channel: Option<usize>,
}

/// What an axis is, by its name, else by the array of its coordinates where there is one: on a
/// server it costs requests to look for that.
fn kind_of(store: &Store, array: &ZarrArray, axis: usize, name: &str) -> char {
    match cf::kind_of_name(name) {
        '?' => line_array(store, array, axis)
            .ok()
            .flatten()
            .map_or('?', |line| cf::kind_of_coordinate(name, text(&line, "axis"), text(&line, "units"))),
        known => known,
    }
}

/// What each axis is, for [`layout`].
fn kinds(store: &Store, array: &ZarrArray, image: Option<&Image>, names: Option<&[String]>) -> Vec<char> {
    let Some(names) = names else { return vec!['?'; array.shape.len()] };
    let is_called = |name: &str, kind: char| name.eq_ignore_ascii_case(&kind.to_string());
    let kind = |axis: usize| {
        let name = &names[axis];
        let found = match image.map(|image| image.multiscale["axes"][axis]["type"].as_str()) {
            Some(Some("time")) => 't',
            Some(Some("channel")) => 'c',
            Some(_) => cf::kind_of_name(name),
            None => kind_of(store, array, axis, name),
        };
        // A name that is as short as this counts before those of coordinates.
        let is_taken = !is_called(name, found) && names.iter().any(|other| is_called(other, found));
        if is_taken { '?' } else { found }
    };
    (0..names.len()).map(kind).collect()
}

fn axes(store: &Store, array: &ZarrArray, image: Option<&Image>) -> Result<AllAxes> {
    let rank = array.shape.len();
    let of_image = image.and_then(|i| i.multiscale["axes"].as_array()).map(|axes| {
        axes.iter().map(|a| a["name"].as_str().or(a.as_str()).unwrap_or_default().to_string()).collect()
    });
    // Images of the first versions have no names, and always five axes.
    let first = || image.filter(|_| rank == 5).map(|_| ["t", "c", "z", "y", "x"].map(String::from).into());
    let names: Option<Vec<String>> = of_image.or_else(|| array.names.clone()).filter(|n| n.len() == rank);
    let names = names.or_else(first);
    let kinds = kinds(store, array, image, names.as_deref());
    let count = |axis: Option<usize>| axis.map_or(1, |axis| array.shape[axis]);
    let found = layout(&array.shape, &kinds).ok();
    let is_few = |of: &AxisLayout| {
        let all = count(of.series).checked_mul(count(of.channels));
        all.is_some_and(|n| n <= MOST_FRAMES)
    };
    if let Some(AxisLayout { space, series, channels }) = found.filter(is_few) {
        let by_name = ['x', 'y', 'z'].map(|kind| space.into_iter().find(|&axis| kinds[axis] == kind));
        let space = if by_name.iter().all(Option::is_some) { by_name } else { space.map(Some) };
        let record = (0..rank).find(|&axis| kinds[axis] == 't' && array.shape[axis] == 1);
        return Ok(AllAxes { space, time: series, record, channel: channels });
    }
    let shape: Vec<String> = array.shape.iter().map(u64::to_string).collect();
    let got = match &names {
        Some(names) => format!("{} ({})", shape.join(" x "), names.join(", ")),
        None => shape.join(" x "),
    };
    let expected = "three axes of space, one of time, one of channels (65536 frames of channels at most), others of one entry";
    Err(Error::bad_input(&array.file, "shape", expected, got)
        .with_help("write one channel, or the part that is wanted, to an array of its own; or name its axes"))
}

fn check_chunks(array: &ZarrArray) -> Result<()> {
    let size = array.scalar.bytes() as u64;
    let bytes = array.unit().iter().try_fold(size, |n, &d| n.checked_mul(d)).filter(|&n| n <= MOST_CHUNK);
    let places = array.shard.as_ref().map_or(Some(1), |s| {
        s.inner.iter().zip(&array.chunk).try_fold(1u64, |n, (i, c)| n.checked_mul(c / i))
    });
    if bytes.is_some() && places.is_some_and(|n| n <= MOST_CHUNK / 16) {
        return Ok(());
    }
    let got: Vec<String> = array.unit().iter().map(u64::to_string).collect();
    let got = format!("{} samples of {}", got.join(" x "), array.scalar.name());
    Err(Error::bad_input(&array.file, "chunks", "chunks of at most 1 GiB", got)
        .with_help("write the array again in smaller chunks"))
}

/// The metadata's file and the chunks' files that exist; evenly chosen ones if there are very many.
fn files(array: &ZarrArray, fixed: &[FixedEntry]) -> Vec<PathBuf> {
    let mut grid: Vec<u64> = array.shape.iter().zip(&array.chunk).map(|(s, c)| s.div_ceil(*c)).collect();
    fixed.iter().for_each(|f| grid[f.axis] = 1);
    let count = grid.iter().fold(1u64, |n, &g| n.saturating_mul(g));
    let place = |mut number: u64| {
        let mut at: Vec<u64> = vec![];
        for &g in grid.iter().rev() {
            at.push(number % g);
            number /= g;
        }
        at.reverse();
        fixed.iter().for_each(|f| at[f.axis] = f.number / array.chunk[f.axis]);
        array.chunk_file(&at)
    };
    let some = (0..count.min(LISTED))
        .map(|i| (u128::from(i) * u128::from(count) / u128::from(count.min(LISTED))) as u64);
    std::iter::once(array.file.clone()).chain(some.map(place)).collect()
}

/// The chunks of an array, or of one of its channels or frames.
struct Chunks {
    info: VolumeInfo,
    array: ZarrArray,
    axes: Axes,
    /// The entries of the axes of time and channels, if the array has them.
    fixed: Vec<FixedEntry>,
    io: IoMode,
    /// The archive that they are in, which stays open.
    #[allow(dead_code, reason = "what counts is that it is there")]
    archive: Option<Arc<Zip>>,
    /// How stored numbers become values, where `info` does not say that. Values are `f64` then.
    convert: Option<Convert>,
    /// Shards that were opened last, by their places in the grid of files.
    shards: Mutex<Vec<([u64; 3], Arc<OpenShard>)>>,
}

/// A shard's file and index; `None`: it is not there.
type OpenShard = Option<(StorePart, Vec<u8>)>;

impl Chunks {
    fn new(info: VolumeInfo, array: ZarrArray, axes: Axes, fixed: Vec<FixedEntry>, io: IoMode) -> Self {
        Self { info, array, axes, fixed, io, archive: None, convert: None, shards: Mutex::default() }
    }

    /// Sizes along x, y, z of a list along the array's axes.
    fn xyz(&self, sizes: &[u64]) -> [u64; 3] {
        self.axes.map(|a| a.map_or(1, |a| sizes[a]))
    }

    /// A place along the array's axes of one along x, y, z, and along others of `of_entry`.
    fn place(&self, xyz: [u64; 3], of_entry: impl Fn(FixedEntry) -> u64) -> Vec<u64> {
        let mut place = vec![0; self.array.shape.len()];
        for (axis, at) in self.axes.iter().zip(xyz) {
            if let Some(axis) = axis {
                place[*axis] = at;
            }
        }
        for &entry in &self.fixed {
            place[entry.axis] = of_entry(entry);
        }
        place
    }

    /// A chunk as it is stored, decoded; `None` where there is none.
    fn load(&self, file: [u64; 3], inner: [u64; 3]) -> Result<Option<Vec<u8>>> {
        let path = self.array.chunk_file(&self.place(file, |f| f.number / self.array.chunk[f.axis]));
        if self.array.shard.is_none() {
            // An empty file is damage, not a missing chunk.
            let Some(source) = open_if_there(&path, self.io, self.most_stored())? else { return Ok(None) };
            return self.decoded(&source, 0..source.len()).map(Some);
        }
        let shard = self.shard(file, &path)?;
        let Some((source, index)) = &*shard else { return Ok(None) };
        match self.range_in_shard(inner, source, index)? {
            Some(range) => self.decoded(source, range).map(Some),
            None => Ok(None),
        }
    }

    fn decoded(&self, source: &StorePart, range: Range<u64>) -> Result<Vec<u8>> {
        let needed = self.array.unit().iter().product::<u64>() * self.array.scalar.bytes() as u64;
        let mut buffer = vec![];
        let at = format!("chunk at byte {}", range.start);
        let stored = source.view(range, &mut buffer)?;
        let decoded = codec::decode(&self.array.codecs, stored, needed as usize);
        source.check()?;
        decoded.map_err(|got| {
            let names: Vec<&str> = self.array.codecs.iter().map(|c| c.name()).collect();
            let expected = format!("{needed} bytes of good {} data", names.join(" + "));
            Error::bad_input(source.path(), at, expected, got)
                .with_help("the chunk is damaged or cut short; fetch it again")
        })
    }

    /// The shard at a place of the grid of files, opened before or now.
    fn shard(&self, file: [u64; 3], path: &Path) -> Result<Arc<OpenShard>> {
        let mut open = self.shards.lock().unwrap_or_else(PoisonError::into_inner);
        let found = match open.iter().position(|(at, _)| *at == file) {
            Some(n) => open.remove(n).1,
            None => {
                open.truncate(self.open_shards().saturating_sub(1) as usize);
                Arc::new(self.open_shard(path)?)
            }
        };
        open.insert(0, (file, Arc::clone(&found)));
        Ok(found)
    }

    /// More bytes than a stored chunk has: compressors make nothing twice as large.
    fn most_stored(&self) -> u64 {
        let samples = self.array.unit().iter().fold(1u64, |n, &d| n.saturating_mul(d));
        samples.saturating_mul(2 * self.array.scalar.bytes() as u64).saturating_add(1 << 20)
    }

    /// Shards that are kept open, at most.
    fn open_shards(&self) -> u64 {
        (OPEN_INDICES / self.index_bytes().max(1)).clamp(1, MOST_OPEN)
    }

    /// Bytes of the index of a shard; 0 where there are no shards.
    fn index_bytes(&self) -> u64 {
        let all = |sizes: &[u64]| sizes.iter().fold(1u64, |n, &d| n.saturating_mul(d));
        let chunks = all(&self.array.chunk) / all(self.array.unit()).max(1);
        if self.array.shard.is_some() { chunks.saturating_mul(16) } else { 0 }
    }

    fn open_shard(&self, path: &Path) -> Result<OpenShard> {
        let Some(source) = ranges_if_there(path, self.io)? else { return Ok(None) };
        let shard = self.array.shard.as_ref().expect("called for shards");
        let count: u64 = shard.inner.iter().zip(&self.array.chunk).map(|(i, c)| c / i).product();
        let (bytes, crc) = (16 * count, if shard.index_crc { 4 } else { 0 });
        let at = if shard.index_at_end { source.len().saturating_sub(bytes + crc) } else { 0 };
        let mut index = vec![];
        index.extend_from_slice(source.view(at..at + bytes + crc, &mut vec![])?);
        source.check()?;
        let sum = index.split_off(bytes as usize);
        if shard.index_crc && crc32c::crc32c(&index).to_le_bytes()[..] != sum[..] {
            let got = "another one than that of the index";
            return Err(Error::bad_input(path, "index of the shard", "its CRC32C", got)
                .of_fault(Fault::Checksum)
                .with_help("the file is damaged or cut short; fetch it again"));
        }
        Ok(Some((source, index)))
    }

    /// Where a chunk is in its shard; `None` where it is not.
    fn range_in_shard(
        &self,
        inner: [u64; 3],
        source: &StorePart,
        index: &[u8],
    ) -> Result<Option<Range<u64>>> {
        let (chunk, unit) = (&self.array.chunk, self.array.unit());
        let place = self.place(inner, |f| f.number % chunk[f.axis] / unit[f.axis]);
        let number = place.iter().zip(chunk.iter().zip(unit)).fold(0, |n, (p, (c, u))| n * (c / u) + p);
        let entry = &index[16 * number as usize..][..16];
        let (at, length) = (LE::read_u64(entry), LE::read_u64(&entry[8..]));
        if (at, length) == (u64::MAX, u64::MAX) {
            return Ok(None);
        }
        let end = at.checked_add(length).filter(|&end| end <= source.len() && length > 0);
        let end = end.ok_or_else(|| {
            let got = format!("{length} bytes from byte {at} on, in a file of {} bytes", source.len());
            Error::bad_input(source.path(), "index of the shard", "chunks that lie in the file", got)
                .with_help("the file is damaged or cut short; fetch it again")
        })?;
        Ok(Some(at..end))
    }

    /// Where the channel's frame begins in a decoded chunk, and bytes a step along x, y, z.
    fn strides(&self) -> (usize, [usize; 3]) {
        let mut strides = vec![0; self.array.shape.len()];
        let mut step = self.array.scalar.bytes();
        for &axis in self.array.order.iter().rev() {
            strides[axis] = step;
            step *= self.array.unit()[axis] as usize;
        }
        let unit = self.array.unit();
        let begin = self.fixed.iter().map(|f| (f.number % unit[f.axis]) as usize * strides[f.axis]).sum();
        (begin, self.axes.map(|a| a.map_or(0, |a| strides[a])))
    }
}

impl ChunkSource for Chunks {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn chunk_dims(&self) -> [u64; 3] {
        self.xyz(self.array.unit())
    }

    fn together(&self) -> [u64; 3] {
        let (file, unit) = (self.xyz(&self.array.chunk), self.chunk_dims());
        std::array::from_fn(|a| file[a] / unit[a])
    }

    fn decoding_bytes(&self) -> u64 {
        let all = self.array.unit().iter().fold(1u64, |n, &d| n.saturating_mul(d));
        let decoded = all.saturating_mul(self.array.scalar.bytes() as u64);
        // Stored, between two codecs, decoded; the first two are gone when samples are given out.
        // And the indices of shards.
        let indices = self.index_bytes().saturating_mul(self.open_shards() + 1);
        // The values, if they are others.
        let values = if self.convert.is_some() { all.saturating_mul(16) } else { 0 };
        decoded.saturating_mul(3).saturating_add(indices).saturating_add(values)
    }

    fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        self.decode_stored(at, out)?;
        if let Some(convert) = &self.convert {
            let mut numbers = vec![0.0; out.len() / self.array.scalar.bytes()];
            to_f64(self.array.scalar, out, &mut numbers);
            out.clear();
            out.extend(numbers.into_iter().flat_map(|v| convert.value(v, [0, 0]).to_le_bytes()));
        }
        Ok(())
    }
}

impl Chunks {
    /// The samples of a chunk as they are stored, little-endian.
    fn decode_stored(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        out.clear();
        let (size, d, unit, together) =
            (self.array.scalar.bytes(), self.info.dims, self.chunk_dims(), self.together());
        let [w, h, depth] = std::array::from_fn(|a| unit[a].min(d[a].saturating_sub(at[a] * unit[a])));
        let file = std::array::from_fn(|a| at[a] / together[a]);
        let loaded = self.load(file, std::array::from_fn(|a| at[a] % together[a]))?;
        out.reserve((w * h * depth) as usize * size);
        let Some(bytes) = loaded else {
            let samples = (w * h * depth) as usize;
            out.extend(self.array.fill.iter().copied().cycle().take(samples * size));
            return Ok(());
        };
        let (begin, [sx, sy, sz]) = self.strides();
        for (z, y) in (0..depth).flat_map(|z| (0..h).map(move |y| (z, y))) {
            let at = begin + z as usize * sz + y as usize * sy;
            if sx == size {
                out.extend_from_slice(&bytes[at..at + w as usize * size]);
            } else {
                (0..w as usize).for_each(|x| out.extend_from_slice(&bytes[at + x * sx..][..size]));
            }
        }
        if self.array.big_endian {
            swap_bytes(out, size);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
