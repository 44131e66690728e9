//! HDF5 and NetCDF-4 (which is HDF5 with conventions): a file of groups and datasets.
//!
//! ```text
//!  \x89HDF\r\n\x1a\n …        superblock; then object headers, indices and samples anywhere in the file
//!  /group/name                a dataset: shape, type, layout (contiguous, compact, chunked), filters, attributes
//! ```
//!
//! The fields are the datasets of three axes (slowest first: z, y, x, as in NPY) and of one number
//! a sample, named by their path. In a dataset with more axes those of space are found by their
//! names, in any places, else they are the last three (see
//! [`layout`](crate::formats::shared::axes)). Each entry of an axis of time, or of the first of
//! four, is a field of its own. They are the steps `name:t0`, `name:t1`, …; `name` is all of them,
//! as a series. Entries of an axis of channels are the fields `name:c0`, `name:c1`, …, with frames
//! `name:c0:t0`. Other axes must have one entry. Links to one dataset are one field.
//!
//! **Axes with names** (dimension scales, `DIMENSION_LABELS`, `axistags`; CF's `axis` and `units`)
//! are what their names say: time, x, y, z in any order, channels. If the last of four axes without
//! names has at most four entries, it holds the components of vectors: such fields are listed, and
//! not read.
//!
//! These attributes are used: `scale_factor`, `add_offset`; `_FillValue`, `missing_value`,
//! `valid_range`, `valid_min`, `valid_max`, `_Unsigned`; `element_size_um` (z, y, x); coordinate
//! variables (`DIMENSION_LIST`, `axes` of NeXus, or what the module `axes` knows): where all are
//! regular to a thousandth of a step they are spacing and origin, else the dataset is a rectilinear
//! grid. Without any of these, the spacing is 1 and the origin is 0.
//!
//! Conventions of other programs: see the module `dialect`. Files of MATLAB 7.3 begin with a block
//! of text; the first index of their arrays is x.
//!
//! A contiguous dataset is mapped where it lies. Others are read chunk by chunk (deflate, shuffle,
//! Fletcher-32, scale-offset, N-bit, szip, and those of the module `filters`) as they are asked for
//! ([`crate::volume::chunked`]); small chunks are read together. Memory: one chunk, stored, decoded
//! and once more for output; chunks of more than 256 MiB are refused. Chunks that were never
//! written read as the fill value.
//!
//! # The crate behind it
//! Two crates were tried on files written by h5py and netCDF4 (HDF5 2.0; oldest and newest file
//! versions; ten types in both byte orders; each layout, chunk index and filter above):
//!
//! * `hdf5-reader` 0.12: pure Rust, for reading alone. It read all of them right, by boxes, in a
//!   few megabytes of memory, through our own access to the file, with bounds on what a header can
//!   make it allocate. We use it, without its own threads.
//! * `hdf5-pure` 0.47: pure Rust, also writes. It refuses layout version 5 (what HDF5 2.0 writes
//!   for filtered chunks of its newest file version) and chunks indexed by a version 2 B-tree; it
//!   reads whole slices only.
//!
//! `hdf5-metno` was not tried, because the first sufficed: it binds the C library, which would have
//! to be installed or built by CMake and allows one thread at a time.
//!
//! The format: "HDF5 File Format Specification Version 4.0", The HDF Group.

pub mod arrays;
mod axes;
mod chunks;
mod dialect;
mod filters;
mod times;

use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::formats::shared::cf::{
    self, AttributeNumbers, Attributes, Convert, Hyperslab, Line, MOST_COORDINATES, Packing,
    kind_of_coordinate, kind_of_name, signed_as,
};
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::format::{self, About, Format, Head};
use crate::formats::shared::header::{given_geometry, plain_info};
use crate::formats::shared::lengths::Lengths;
use crate::formats::shared::minc;
use crate::formats::shared::numbers::to_f64;
use crate::formats::shared::stream::sample_bytes;
use crate::formats::shared::{Frames, OpenOptions, has_suffix, pick_field};
use crate::grid::{Geometry, IndexBox};
use crate::volume::chunked::ChunkSource;
use crate::volume::strided::StridedVolume;
use crate::volume::units::{Unit, Units};
use crate::volume::{FieldInfo, ScalarType, VolumeInfo, VolumeSource};
pub use arrays::{arrays, vtk_kind};
use axes::Axes;
use chunks::Chunks;
use dialect::{Dialect, PlacedField};
use half::f16;
use hdf5_reader::attribute_api::Attribute;
use hdf5_reader::group::Group;
use hdf5_reader::io::Cursor;
use hdf5_reader::messages::HdfMessage;
use hdf5_reader::messages::layout::DataLayout;
use hdf5_reader::{
    ByteOrder, Dataset, Datatype, H5Type, Hdf5File, SliceInfo, SliceInfoElem, Storage, StorageBuffer,
};
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

/// HDF5 and NetCDF-4.
pub(in crate::formats) struct Hdf5;

static ABOUT: About = About {
    volumes: &["HDF5"],
    on_servers: true,
    has_spacing: false,
    has_channels: true,
    ..About::named("an HDF5 or NetCDF-4 file")
};

impl Format for Hdf5 {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        head.is_hdf5()
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn format::Dataset>> {
        Ok(Box::new(Opened::of(head.file()?)?))
    }
}

/// Most bytes of a decoded chunk.
const MOST_CHUNK: u64 = 256 << 20;
/// Small chunks are read together up to this many bytes; datasets without chunks are read in pieces
/// of this size.
const PIECE: u64 = 128 << 10;

impl format::Dataset for Opened {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let PlacedField { number, fields, field: info, geometry, convert, units, assumed } =
            self.pick(options)?;
        let Self { source, file, dialect, tree } = self;
        let (path, dialect, field) = (source.path(), *dialect, &tree.fields[number]);
        let has_place = dialect != Dialect::Plain || field.lines(tree).iter().any(Option::is_some);
        if has_place {
            options.refuse_other_geometry(path, "a file with coordinates")?;
        }
        let geometry = given_geometry(path, options, geometry)?;
        let is_netcdf = dialect == Dialect::Plain && is_netcdf(path, file);
        let format = match tree.axes_of(&field.part.array) {
            Some(axes) => axes.program,
            None if is_netcdf => "NetCDF-4",
            None => dialect.name(),
        };
        let mut info = field.volume_info(path, format, info, geometry)?;
        info.fields = fields;
        let convert = match dialect {
            Dialect::Plain => {
                info.notes.extend(field.lengths(tree).note);
                info.assumed = options.assumed(field.assumed(path, tree)?);
                info.units = field.units(tree, file);
                field.packing(path, is_netcdf)?.into_info(&mut info)
            }
            _ => {
                (info.assumed, info.units) = (assumed, units);
                convert
            }
        };
        let pieces =
            |info, convert| Ok(VolumeSource::Chunked(Arc::new(Hdf5Pieces::new(info, file, field, convert)?)));
        if convert.is_some() {
            return pieces(info, convert);
        }
        if let Some((at, strides)) = field.in_place(path, file)? {
            let volume = StridedVolume::new(info, Arc::clone(source), at, field.big_endian, strides)?;
            return Ok(volume.source());
        }
        pieces(info, None)
    }

    /// Where the coordinates along one of the axes are not regular.
    fn coordinates(&self, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
        if self.dialect != Dialect::Plain {
            return Ok(None);
        }
        let field = &self.tree.fields[self.pick(options)?.number];
        let Hyperslab { info, world, .. } = &field.part;
        cf::grid_of(self.source.path(), &info.name, field.lines(&self.tree), *world, field.dims())
    }

    fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        self.frames_of(options)
    }

    fn times(&self, _: &OpenOptions) -> Result<HashMap<String, f64>> {
        Ok(self.all_times())
    }

    fn time(&self, options: &OpenOptions) -> Result<Option<f64>> {
        self.one_time(options)
    }

    fn calendar(&self, options: &OpenOptions) -> Result<String> {
        self.calendar_of(options)
    }
}

/// Whether a file was written by the library of NetCDF, which says so, or is called that.
fn is_netcdf(path: &Path, file: &Hdf5File) -> bool {
    let says_so = || file.root_group().is_ok_and(|root| root.attribute("_NCProperties").is_ok());
    has_suffix(path, &[".nc", ".nc4"]) || says_so()
}

/// A file whose datasets were found.
struct Opened {
    source: Arc<ByteSource>,
    file: Hdf5File,
    dialect: Dialect,
    tree: Tree,
}

impl Opened {
    fn of(source: &Arc<ByteSource>) -> Result<Self> {
        let (path, file) = (source.path(), open_file(source.path(), source)?);
        let dialect = Dialect::of(path, &file)?;
        let tree = Tree::of(path, &file, dialect)?;
        Ok(Self { source: Arc::clone(source), file, dialect, tree })
    }

    /// Picks a field by the file's convention.
    fn pick(&self, options: &OpenOptions) -> Result<PlacedField> {
        self.tree.pick(self.source.path(), &self.file, self.dialect, options)
    }
}

fn open_file(path: &Path, source: &Arc<ByteSource>) -> Result<Hdf5File> {
    let limits = hdf5_reader::OpenOptions::default()
        .with_chunk_cache_bytes(0)
        .with_max_chunk_bytes(MOST_CHUNK as usize)
        .with_max_read_bytes(MOST_CHUNK as usize)
        .with_filter_registry(filters::registry(MOST_CHUNK));
    Hdf5File::from_storage_with_options(Arc::new(Bytes(source.clone())), limits)
        .map_err(|e| damaged(path, "superblock", &e))
}

/// Our file for the reader: checked, and followed when it shrinks.
struct Bytes(Arc<ByteSource>);

impl Storage for Bytes {
    fn len(&self) -> u64 {
        self.0.len()
    }

    fn read_range(&self, offset: u64, len: usize) -> hdf5_reader::error::Result<StorageBuffer> {
        let available = self.len().saturating_sub(offset);
        if len as u64 > available {
            let needed = len as u64;
            return Err(hdf5_reader::error::Error::UnexpectedEof { offset, needed, available });
        }
        let mut bytes = vec![0; len];
        self.0.read_at(offset, &mut bytes).map_err(std::io::Error::other)?;
        Ok(StorageBuffer::from_vec(bytes))
    }
}

/// What the reader found wrong, in one line.
fn damaged(path: &Path, at: &str, error: &hdf5_reader::error::Error) -> Error {
    let got: String =
        error.to_string().chars().map(|c| if c.is_control() { ' ' } else { c }).take(300).collect();
    if let hdf5_reader::error::Error::UnsupportedFilter(filter) = error {
        let number = filter.rsplit(' ').next().unwrap_or_default();
        let help =
            "write it anew with deflate: h5repack -f GZIP=1 OLD NEW, where the filter's plugin is installed";
        let got = format!("the filter {} ({filter})", filters::name_of_unread(number));
        return Error::bad_input(path, at, filters::READ, got).with_help(help);
    }
    if let Some(child) = got.strip_suffix("unsupported layout class 3") {
        return virtual_dataset(path, at, child);
    }
    // Not the file's fault, but of the disk or the server.
    if let hdf5_reader::error::Error::Io(failed) = error
        && failed.get_ref().is_some_and(|inner| matches!(inner.downcast_ref(), Some(Error::Io { .. })))
    {
        return Error::io("read", path, std::io::Error::other(got));
    }
    let help = "the file is damaged, cut short, or uses what is not read; try h5dump or h5repack on it";
    Error::bad_input(path, at, "good HDF5 or NetCDF-4", got).with_help(help)
}

/// Refuses a dataset without samples of its own. The reader tells which member of a group it is.
fn virtual_dataset(path: &Path, at: &str, child: &str) -> Error {
    let name = child.strip_prefix("child '").and_then(|rest| rest.split('\'').next()).unwrap_or_default();
    let at = format!("{at}{name}");
    let help = "a file that has one is not read: copy the samples into it (h5repack -l NAME:CONTI OLD NEW), \
                or name the files that they are in";
    Error::bad_input(path, at, "datasets with samples", "a virtual dataset, whose samples are elsewhere")
        .with_help(help)
}

/// The datasets of a file.
struct Tree {
    fields: Vec<Hdf5Field>,
    /// Datasets of one axis, by their paths: coordinates, maybe.
    lines: Vec<(String, Dataset)>,
    /// The axes of the datasets in groups that NeXus marks, by the paths of the groups.
    axes: HashMap<String, Vec<String>>,
    /// What other programs say of the axes of datasets, by the paths of their groups.
    described: HashMap<String, Axes>,
    /// Datasets of three axes or more that cannot be read, and why.
    refused: Vec<(String, Error)>,
}

impl Tree {
    fn of(path: &Path, file: &Hdf5File, dialect: Dialect) -> Result<Self> {
        let (axes, described) = (HashMap::new(), HashMap::new());
        let mut tree = Self { fields: vec![], lines: vec![], axes, described, refused: vec![] };
        let mut volumes = vec![];
        let root = file.root_group().map_err(|e| damaged(path, "/", &e))?;
        let (mut groups, mut seen) = (vec![(String::new(), root)], HashSet::new());
        while let Some((name, group)) = groups.pop() {
            if seen.insert(group.address()) {
                let below = tree.add(path, &name, &group, &mut seen, &mut volumes)?;
                groups.extend(below.into_iter().rev());
            }
        }
        for (name, dataset) in volumes.into_iter().filter(|(name, _)| dialect.has(name)) {
            match tree.fields_of(path, &name, &dataset, dialect) {
                Ok(fields) => tree.fields.extend(fields),
                Err(e) => tree.refused.push((name, e)),
            }
        }
        Ok(tree)
    }

    /// Adds a group's datasets; gives the groups in it.
    fn add(
        &mut self,
        path: &Path,
        prefix: &str,
        group: &Group,
        seen: &mut HashSet<u64>,
        volumes: &mut Vec<(String, Dataset)>,
    ) -> Result<Vec<(String, Group)>> {
        let (mut groups, mut datasets) =
            group.member_names().map_err(|e| damaged(path, &format!("/{prefix}"), &e))?;
        groups.sort();
        datasets.sort();
        if let Some(axes) = dialect::nexus_axes(path, group, &format!("/{prefix}"), &datasets)? {
            self.axes.insert(prefix.to_string(), axes);
        }
        let members = [groups, datasets];
        if let Some(axes) = Axes::of(path, &format!("/{prefix}"), group, &members)? {
            self.described.insert(prefix.to_string(), axes);
        }
        let [groups, datasets] = members;
        for short in datasets {
            let name = format!("{prefix}{short}");
            match group.dataset(&short) {
                Err(e) => self.refused.push((name.clone(), damaged(path, &name, &e))),
                Ok(dataset) if seen.insert(dataset.address()) => match dataset.ndim() {
                    0 | 2 => {}
                    1 => self.lines.push((name, dataset)),
                    _ => volumes.push((name, dataset)),
                },
                Ok(_) => {}
            }
        }
        let open = |short: String| match group.group(&short) {
            Ok(found) => Ok((format!("{prefix}{short}/"), found)),
            Err(e) => Err(damaged(path, &format!("/{prefix}{short}"), &e)),
        };
        groups.into_iter().map(open).collect()
    }

    /// The fields of a dataset with three axes or more.
    fn fields_of(
        &self,
        path: &Path,
        name: &str,
        dataset: &Dataset,
        dialect: Dialect,
    ) -> Result<Vec<Hdf5Field>> {
        if dialect == Dialect::Plain {
            let names = (0..dataset.ndim()).filter_map(|axis| self.line_of(name, dataset, axis));
            let names = names.map(|(path, _)| path.rsplit('/').next().unwrap_or(path).to_string());
            let names: Vec<String> = names.collect();
            cf::refuse_mesh(&Named { path, name, dataset }, &names)?;
            dialect::refuse_dataset(path, name, dataset, &names)?;
        }
        if let Some(axes) = self.axes_of(name) {
            axes.check(path, name, dataset)?;
        }
        let kinds = match dialect {
            Dialect::Minc => minc::kinds(&dialect::minc_axes(dataset), dataset.ndim()),
            _ => self.axis_kinds(name, dataset),
        };
        let (scalar, big_endian) = scalar_of(path, name, dataset)?;
        let name = dialect.name_of(name);
        let parts = cf::parts_of(path, name, dataset.shape(), &kinds, scalar, dialect.rules())?;
        Ok(parts.into_iter().map(|part| Hdf5Field { part, dataset: dataset.clone(), big_endian }).collect())
    }

    /// What each axis of a dataset is: x, y, z, t (time), c (channels, components), or '?'.
    fn axis_kinds(&self, name: &str, dataset: &Dataset) -> Vec<char> {
        let rank = dataset.ndim();
        if let Some(axes) = self.axes_of(name) {
            return (0..rank).map(|axis| axes.kind(axis)).collect();
        }
        let labels = dataset.attribute("DIMENSION_LABELS").ok().and_then(|a| a.read_strings().ok());
        let tags = dataset.attribute("axistags").ok().and_then(|a| attribute_text(&a));
        let tags: serde_json::Value = tags.and_then(|t| serde_json::from_str(&t).ok()).unwrap_or_default();
        let kind = |axis: usize| {
            let of_line = self.line_of(name, dataset, axis).map(|(path, line)| kind_of_line(path, line));
            let label = labels.as_ref().and_then(|l| l.get(axis)).map(|l| kind_of_name(l));
            let tag = tags["axes"][axis]["key"].as_str().map(kind_of_name);
            [of_line, label, tag].into_iter().flatten().find(|&k| k != '?').unwrap_or('?')
        };
        (0..rank).map(kind).collect()
    }

    /// The dataset of the coordinates along an axis of a dataset, or of its dimension's name alone.
    fn line_of(&self, name: &str, dataset: &Dataset, axis: usize) -> Option<(&str, &Dataset)> {
        let found = if let Ok(list) = dataset.attribute("DIMENSION_LIST") {
            let size = dataset.vlen_reference_size();
            let reference = list.raw_data.get(axis * size..(axis + 1) * size)?;
            let bytes = dataset.resolve_vlen_reference_bytes(reference, 8).ok()?;
            let address = u64::from_le_bytes(bytes.get(..8)?.try_into().ok()?);
            self.lines.iter().find(|(_, d)| d.address() == address)
        } else {
            let group = name.rfind('/').map_or("", |at| &name[..=at]);
            let axes = self.axes.get(group).filter(|a| a.len() == dataset.ndim())?;
            let path = format!("{group}{}", axes[axis]);
            self.lines.iter().find(|(p, _)| *p == path)
        };
        found.map(|(path, line)| (path.as_str(), line))
    }

    /// Picks a field by the file's convention.
    fn pick(
        &self,
        path: &Path,
        file: &Hdf5File,
        dialect: Dialect,
        options: &OpenOptions,
    ) -> Result<PlacedField> {
        let wanted = cf::with_channel(path, options, self.fields.iter().map(|f| &f.part))?;
        let wanted = wanted.map(|name| self.full_name(file, &name));
        if dialect != Dialect::Vtk {
            self.check_wanted(path, wanted.as_deref())?;
        }
        let wanted = wanted.as_deref();
        match dialect {
            Dialect::Vtk => return dialect::vtk(path, file, self, wanted),
            Dialect::Minc => return dialect::minc(path, file, self, wanted),
            Dialect::Itk => return dialect::itk(path, file, self, wanted),
            Dialect::Plain => {}
        }
        let fields: Vec<FieldInfo> = self.fields.iter().map(|f| f.part.info.clone()).collect();
        let number = pick_field(path, &fields, wanted)?;
        let geometry = self.fields[number].placed(path, self)?;
        Ok(PlacedField::plain(number, fields, geometry))
    }

    /// The first frame of the dataset with four axes that a user's word means.
    fn first_frame(&self, file: &Hdf5File, wanted: &str) -> Option<usize> {
        let first = self.full_name(file, &format!("{wanted}:t0"));
        self.fields.iter().position(|f| f.part.is_frame() && f.part.info.name == first)
    }

    /// The field that a user's word means: the path with or without its first "/", or that of
    /// another link to the dataset.
    fn full_name(&self, file: &Hdf5File, wanted: &str) -> String {
        let wanted = wanted.trim_start_matches('/');
        let (path, frame) = match wanted.rsplit_once(":t") {
            Some((path, frame)) => (path, Some(frame)),
            None => (wanted, None),
        };
        let known = |name: &str| self.fields.iter().any(|f| f.part.info.name == name);
        let linked = file.dataset(path).ok().filter(|_| !known(wanted)).map(|d| d.address());
        // The name of a dataset with frames is not the name of a frame.
        let found =
            self.fields.iter().filter(|f| Some(f.dataset.address()) == linked).find(|f| match frame {
                None => !f.part.is_frame() && !f.part.is_channel(),
                Some(frame) => f.part.info.name.rsplit_once(":t").is_some_and(|(_, t)| t == frame),
            });
        found.map_or_else(|| wanted.to_string(), |f| f.part.info.name.clone())
    }

    /// Fails with the reason why the wanted dataset, or the only one, cannot be read.
    fn check_wanted(&self, path: &Path, wanted: Option<&str>) -> Result<()> {
        let refused = match wanted {
            Some(wanted) => self.refused.iter().position(|(name, _)| name == wanted),
            None if self.fields.is_empty() && !self.refused.is_empty() => Some(0),
            None => None,
        };
        if let Some(number) = refused {
            return Err(self.refused[number].1.again());
        }
        if self.fields.is_empty() {
            return Err(Error::bad_input(path, "datasets", "a dataset with three axes", "none"));
        }
        Ok(())
    }
}

/// A dataset of three axes, or one frame of a dataset with more.
struct Hdf5Field {
    part: Hyperslab,
    dataset: Dataset,
    big_endian: bool,
}

impl AsRef<Hyperslab> for Hdf5Field {
    fn as_ref(&self) -> &Hyperslab {
        &self.part
    }
}

/// What an axis with a coordinate variable is.
fn kind_of_line(path: &str, line: &Dataset) -> char {
    let text = |name: &str| line.attribute(name).ok().and_then(|a| attribute_text(&a)).unwrap_or_default();
    kind_of_coordinate(path, &text("axis"), &text("units"))
}

/// The unit that a dataset names.
fn unit_of(dataset: &Dataset) -> Option<String> {
    dataset.attribute("units").ok().and_then(|a| attribute_text(&a))
}

/// A dataset's attributes.
struct Named<'a> {
    path: &'a Path,
    name: &'a str,
    dataset: &'a Dataset,
}

impl Attributes for Named<'_> {
    fn numbers(&self, name: &str) -> Result<Option<AttributeNumbers>> {
        let Ok(attribute) = self.dataset.attribute(name) else { return Ok(None) };
        let are_floats = matches!(attribute.datatype, Datatype::FloatingPoint { .. });
        match attribute_numbers(&attribute) {
            Some(values) => Ok(Some(AttributeNumbers { values, are_floats })),
            None => Err(self.wrong(name, "numbers", kind(&attribute.datatype).into())),
        }
    }

    fn text(&self, name: &str) -> String {
        self.dataset.attribute(name).ok().and_then(|a| attribute_text(&a)).unwrap_or_default()
    }

    fn wrong(&self, names: &str, expected: &str, got: String) -> Error {
        Error::bad_input(self.path, format!("{}, {names}", self.name), expected, got)
    }
}

/// The text of an attribute.
fn attribute_text(attribute: &Attribute) -> Option<String> {
    let one = attribute.read_string().ok();
    let text = one.or_else(|| attribute.read_strings().ok()?.into_iter().next())?;
    Some(text.trim_end_matches('\0').to_string())
}

/// The numbers of an attribute.
fn attribute_numbers(attribute: &Attribute) -> Option<Vec<f64>> {
    macro_rules! of {
        ($type:ty) => {
            attribute.read_1d::<$type>().ok()?.into_iter().map(|v| v as f64).collect()
        };
    }
    Some(match &attribute.datatype {
        Datatype::FloatingPoint { size: 4, .. } => of!(f32),
        Datatype::FloatingPoint { size: 8, .. } => of!(f64),
        Datatype::FixedPoint { size: 1, signed: true, .. } => of!(i8),
        Datatype::FixedPoint { size: 1, .. } => of!(u8),
        Datatype::FixedPoint { size: 2, signed: true, .. } => of!(i16),
        Datatype::FixedPoint { size: 2, .. } => of!(u16),
        Datatype::FixedPoint { size: 4, signed: true, .. } => of!(i32),
        Datatype::FixedPoint { size: 4, .. } => of!(u32),
        Datatype::FixedPoint { size: 8, signed: true, .. } => of!(i64),
        Datatype::FixedPoint { size: 8, .. } => of!(u64),
        _ => return None,
    })
}

/// Whether a dataset has a number that is not 0; one that cannot be read may have.
fn any_nonzero(dataset: &Dataset, scalar: ScalarType) -> bool {
    dataset.num_elements().map_or(true, |n| n > MOST_COORDINATES)
        || all_f64(dataset, scalar).map_or(true, |all| all.iter().any(|&v| v != 0.0))
}

/// The type of a dataset's samples, as `_Unsigned` says, and whether they are big-endian.
fn scalar_of(path: &Path, name: &str, dataset: &Dataset) -> Result<(ScalarType, bool)> {
    let (stored, big_endian) = stored_of(path, name, dataset)?;
    let unsigned = dataset.attribute("_Unsigned").ok().and_then(|a| attribute_text(&a));
    Ok((signed_as(stored, &unsigned.unwrap_or_default()), big_endian))
}

/// The type of a dataset's stored numbers, and whether they are big-endian.
fn stored_of(path: &Path, name: &str, dataset: &Dataset) -> Result<(ScalarType, bool)> {
    let refuse = |got: String| {
        Error::bad_input(path, name, "integers of 8 to 64 bits, or 16-, 32- or 64-bit IEEE floats", got)
            .with_help("write the numbers that are wanted to a dataset of such a type")
    };
    let (scalar, order) = match dataset.dtype() {
        Datatype::FixedPoint { size, signed, byte_order } => {
            (ScalarType::from_code(&format!("{}{size}", if *signed { "i" } else { "u" })), byte_order)
        }
        Datatype::FloatingPoint { size, byte_order } => {
            (ScalarType::from_code(&format!("f{size}")), byte_order)
        }
        other => return Err(refuse(kind(other).into())),
    };
    let raw = dataset.raw_datatype().map_err(|e| damaged(path, name, &e))?;
    let usual = scalar.filter(|&s| is_usual(s, &raw));
    let scalar =
        usual.ok_or_else(|| refuse(format!("numbers of {} bytes in another form", size(dataset))))?;
    Ok((scalar, *order == ByteOrder::BigEndian))
}

fn size(dataset: &Dataset) -> u8 {
    match dataset.dtype() {
        Datatype::FixedPoint { size, .. } | Datatype::FloatingPoint { size, .. } => *size,
        _ => 0,
    }
}

fn kind(datatype: &Datatype) -> &'static str {
    match datatype {
        Datatype::String { .. } => "text",
        Datatype::Compound { .. } => "records (compound or complex numbers)",
        Datatype::Array { .. } => "arrays (vectors)",
        Datatype::Enum { .. } => "an enumeration (or booleans)",
        Datatype::VarLen { .. } => "lists of variable length",
        Datatype::Opaque { .. } => "opaque bytes",
        Datatype::Reference { .. } => "references",
        _ => "bit fields or another type",
    }
}

/// Whether a datatype message describes the machine's form of a type: all bits used and, for
/// floats, the fields of IEEE 754.
fn is_usual(scalar: ScalarType, message: &[u8]) -> bool {
    let bits = 8 * scalar.bytes() as u8;
    let float: &[u8] = match scalar {
        ScalarType::F16 => &[10, 5, 0, 10, 15, 0, 0, 0],
        ScalarType::F32 => &[23, 8, 0, 23, 127, 0, 0, 0],
        ScalarType::F64 => &[52, 11, 0, 52, 255, 3, 0, 0],
        _ => &[],
    };
    // Class and version, flags, size; then the first bit and their number, and a float's fields.
    // Bit 6 of the flags, with bit 0, is the VAX order of bytes.
    let vax = !float.is_empty() && message.get(1).is_none_or(|flags| flags & 0x40 != 0);
    let expected = [&[0, 0, bits, 0][..], float].concat();
    !vax && message.get(8..8 + expected.len()) == Some(&expected[..])
}

impl Hdf5Field {
    /// Samples along x, y, z.
    fn dims(&self) -> [u64; 3] {
        self.part.dims(self.dataset.shape())
    }

    fn volume_info(
        &self,
        path: &Path,
        format: &str,
        field: FieldInfo,
        geometry: Geometry,
    ) -> Result<VolumeInfo> {
        let dims = self.dims();
        sample_bytes(path, dims, self.part.info.scalar)?;
        let mut info = plain_info(path, format, dims, self.part.info.scalar, geometry);
        if self.dataset.chunks().is_some() {
            info.format += " (chunked)";
        }
        info.field = field;
        Ok(info)
    }

    fn at(&self, what: &str) -> String {
        format!("{}, {what}", self.part.info.name)
    }

    /// What the attributes say about stored numbers.
    fn packing(&self, path: &Path, is_netcdf: bool) -> Result<Packing> {
        let named = Named { path, name: &self.part.info.name, dataset: &self.dataset };
        let (stored, _) = stored_of(path, named.name, &self.dataset)?;
        Packing::of(&named, stored, |_| if is_netcdf { cf::netcdf_fill(stored) } else { None })
    }

    /// The coordinates along x, y, z, where the file has them.
    fn lines(&self, tree: &Tree) -> [Option<Line>; 3] {
        let dims = self.dims();
        let lines = std::array::from_fn(|a| {
            let axis = self.part.axes[a];
            if let Some(line) = self.described_line(axis, tree) {
                return Some(line);
            }
            let (_, line) = tree.line_of(&self.part.array, &self.dataset, axis)?;
            let single = matches!(line.dtype(), Datatype::FloatingPoint { size: 4, .. });
            let values = self.line(axis, tree).filter(|l| l.len() as u64 == dims[a])?;
            Some(Line::new(values, single))
        });
        cf::in_one_unit(lines, &self.lengths(tree), self.part.world)
    }

    /// The lengths along the axes of the world.
    fn lengths(&self, tree: &Tree) -> Lengths {
        cf::lengths(self.part.axes.map(|axis| self.axis_unit(axis, tree)), self.part.world)
    }

    /// Spacing, origin and directions, from the coordinate variables, or from what other attributes
    /// say about the voxels.
    fn placed(&self, path: &Path, tree: &Tree) -> Result<Geometry> {
        let lines = self.lines(tree);
        let none = lines.iter().all(Option::is_none);
        let sizes = if none { self.voxel_sizes(path)? } else { [None; 3] };
        cf::placed(path, &lines, self.part.world, sizes.map(|size| size.unwrap_or(1.0)))
    }

    /// Axes whose spacing is not known.
    fn assumed(&self, path: &Path, tree: &Tree) -> Result<[bool; 3]> {
        let lines = self.lines(tree).map(|line| line.is_none());
        Ok(if lines == [true; 3] { self.voxel_sizes(path)?.map(|size| size.is_none()) } else { lines })
    }

    /// The sizes of voxels along x, y, z, where they are known: `element_size_um` of ilastik and
    /// Fiji, `axistags` of vigra.
    fn voxel_sizes(&self, path: &Path) -> Result<[Option<f64>; 3]> {
        if let Ok(attribute) = self.dataset.attribute("element_size_um") {
            let sizes = attribute_numbers(&attribute).unwrap_or_default();
            let good = sizes.len() >= 3 && sizes.iter().all(|s| s.is_finite() && *s > 0.0);
            if !good {
                let expected = "three positive numbers, of z, y, x";
                let at = self.at("element_size_um");
                return Err(Error::bad_input(path, at, expected, format!("{sizes:?}")));
            }
            return Ok(std::array::from_fn(|a| Some(sizes[sizes.len() - 1 - a])));
        }
        let tags = self.dataset.attribute("axistags").ok().and_then(|a| attribute_text(&a));
        let tags: serde_json::Value = tags.and_then(|t| serde_json::from_str(&t).ok()).unwrap_or_default();
        let size = |a: usize| tags["axes"][self.part.axes[a]]["resolution"].as_f64();
        Ok(std::array::from_fn(|a| size(a).filter(|s| s.is_finite() && *s > 0.0)))
    }

    /// The unit of the coordinates along an axis.
    fn axis_unit(&self, axis: usize, tree: &Tree) -> Option<String> {
        match tree.axes_of(&self.part.array) {
            Some(axes) => axes.unit(axis),
            None => unit_of(tree.line_of(&self.part.array, &self.dataset, axis)?.1),
        }
    }

    /// What the attributes say of units.
    fn units(&self, tree: &Tree, file: &Hdf5File) -> Units {
        let time = match self.part.time {
            Some(axis) => self.axis_unit(axis, tree),
            None => self.single_time(file).and_then(|(time, _)| unit_of(&time)),
        };
        let mut units = cf::units(&unit_of(&self.dataset).unwrap_or_default(), &self.lengths(tree), time);
        let has_lines = self.lines(tree).iter().any(Option::is_some);
        if !has_lines && self.dataset.attribute("element_size_um").is_ok() {
            units.length = Unit::length("µm");
        }
        units
    }

    /// The numbers of the coordinate variable of an axis.
    fn line(&self, axis: usize, tree: &Tree) -> Option<Vec<f64>> {
        if let Some(line) = self.described_line(axis, tree) {
            return Some(line.values);
        }
        let (path, line) = tree.line_of(&self.part.array, &self.dataset, axis)?;
        // A dimension without coordinates has a dataset too, of zeros.
        let name = line.attribute("NAME").ok().and_then(|a| a.read_string().ok()).unwrap_or_default();
        if name.starts_with("This is a netCDF dimension but not a netCDF variable") {
            return None;
        }
        line.num_elements().ok().filter(|&n| n <= MOST_COORDINATES)?;
        let (scalar, _) = scalar_of(Path::new(""), "", line).ok()?;
        let named = Named { path: Path::new(""), name: path, dataset: line };
        let packing = Packing::of(&named, scalar, |_| None).ok()?;
        let mut values = all_f64(line, scalar).ok()?;
        packing.unpack(&mut values);
        Some(values)
    }

    /// Byte of the first sample, and bytes a step, where the samples lie in the file as they are.
    fn in_place(&self, path: &Path, file: &Hdf5File) -> Result<Option<(u64, [i64; 3])>> {
        let header = file
            .get_or_parse_header(self.dataset.address())
            .map_err(|e| damaged(path, &self.part.info.name, &e))?;
        let elsewhere = header.messages.iter().any(|m| matches!(m, HdfMessage::ExternalFiles(_)));
        let layout = header.messages.iter().find_map(|m| match m {
            HdfMessage::DataLayout(message) => Some(&message.layout),
            _ => None,
        });
        sample_bytes(path, self.dims(), self.part.info.scalar)?;
        let Some(DataLayout::Contiguous { address, size }) = layout else { return Ok(None) };
        let (shape, bytes) = (self.dataset.shape(), self.part.info.scalar.bytes() as u64);
        let mut steps = vec![bytes; shape.len()];
        for axis in (1..shape.len()).rev() {
            steps[axis - 1] = steps[axis].saturating_mul(shape[axis]);
        }
        if elsewhere || steps[0].checked_mul(shape[0]) != Some(*size) {
            return Ok(None);
        }
        let begin = self.part.entries.iter().zip(&steps).map(|(entry, step)| entry * step).sum::<u64>();
        if Cursor::is_undefined_offset(*address, file.superblock().offset_size) {
            return Ok(None);
        }
        let at = file.superblock().base_address.checked_add(*address);
        let Some(at) = at.filter(|at| at.checked_add(*size).is_some()) else { return Ok(None) };
        let strides = self.part.axes.map(|axis| i64::try_from(steps[axis]));
        let [Ok(x), Ok(y), Ok(z)] = strides else { return Ok(None) };
        Ok(Some((at + begin, [x, y, z])))
    }
}

/// A half, as the reader of HDF5 decodes it.
#[derive(Clone)]
struct Half(f16);

impl H5Type for Half {
    fn hdf5_type() -> Datatype {
        Datatype::FloatingPoint { size: 2, byte_order: ByteOrder::LittleEndian }
    }

    fn from_bytes(bytes: &[u8], datatype: &Datatype) -> hdf5_reader::error::Result<Self> {
        let bits = <[u8; 2]>::try_from(bytes).map_err(|_| {
            hdf5_reader::error::Error::InvalidData(format!("a half of {} bytes", bytes.len()))
        })?;
        let is_big = matches!(datatype, Datatype::FloatingPoint { byte_order: ByteOrder::BigEndian, .. });
        Ok(Self(if is_big { f16::from_be_bytes(bits) } else { f16::from_le_bytes(bits) }))
    }

    fn element_size(_: &Datatype) -> usize {
        2
    }
}

/// All of a dataset as `f64`.
fn all_f64(dataset: &Dataset, scalar: ScalarType) -> hdf5_reader::error::Result<Vec<f64>> {
    let mut out = vec![];
    values(dataset, scalar, &SliceInfo::all(dataset.ndim()), &mut out)?;
    Ok(out)
}

/// Appends a box of a dataset as `f64`.
fn values(
    dataset: &Dataset,
    scalar: ScalarType,
    selection: &SliceInfo,
    out: &mut Vec<f64>,
) -> hdf5_reader::error::Result<()> {
    let mut bytes = vec![];
    little_endian(dataset, scalar, selection, &mut bytes)?;
    let first = out.len();
    out.resize(first + bytes.len() / scalar.bytes(), 0.0);
    to_f64(scalar, &bytes, &mut out[first..]);
    Ok(())
}

/// A box of a dataset as little-endian bytes, in `out`, which is empty.
fn little_endian(
    dataset: &Dataset,
    scalar: ScalarType,
    selection: &SliceInfo,
    out: &mut Vec<u8>,
) -> hdf5_reader::error::Result<()> {
    // The reader has the type of the file, which may stand for another.
    let stored = match dataset.dtype() {
        Datatype::FixedPoint { signed, .. } => signed_as(scalar, if *signed { "false" } else { "true" }),
        _ => scalar,
    };
    macro_rules! of {
        ($type:ty) => {
            out.extend(dataset.read_slice::<$type>(selection)?.iter().flat_map(|v| v.to_le_bytes()))
        };
    }
    match stored {
        ScalarType::U8 => of!(u8),
        ScalarType::I8 => of!(i8),
        ScalarType::U16 => of!(u16),
        ScalarType::I16 => of!(i16),
        ScalarType::U32 => of!(u32),
        ScalarType::I32 => of!(i32),
        ScalarType::U64 => of!(u64),
        ScalarType::I64 => of!(i64),
        ScalarType::F16 => {
            let samples = dataset.read_slice::<Half>(selection)?;
            out.extend(samples.iter().flat_map(|half| half.0.to_le_bytes()));
        }
        ScalarType::F32 => of!(f32),
        ScalarType::F64 => of!(f64),
    }
    Ok(())
}

/// The samples of a dataset in pieces: a chunk each, or some small ones.
struct Hdf5Pieces {
    info: VolumeInfo,
    dataset: Dataset,
    /// How it is stored, unless it is in one part.
    chunks: Option<Chunks>,
    /// The axes of the volume, the last one first, and the entry of each other axis.
    axes: [usize; 3],
    entries: Vec<u64>,
    /// Size of a piece: a multiple of the chunks', or all along an axis.
    piece: [u64; 3],
    /// The type in the file.
    scalar: ScalarType,
    /// How its numbers become values, where `info` does not say that. Values are `f64` then.
    convert: Option<Convert>,
}

impl Hdf5Pieces {
    fn new(
        mut info: VolumeInfo,
        file: &Hdf5File,
        field: &Hdf5Field,
        convert: Option<Convert>,
    ) -> Result<Self> {
        let scalar = info.field.scalar;
        let axes = field.part.axes;
        let chunks =
            Chunks::of(file, &field.dataset, axes, scalar.bytes(), field.big_endian).map_err(|e| {
                let expected = "chunks of the dataset's axes and at most 256 MiB";
                Error::bad_input(&info.path, &info.field.name, expected, e.to_string())
                    .with_help("write the dataset again in smaller chunks (h5repack -l)")
            })?;
        if convert.is_some() {
            info.field.scalar = ScalarType::F64;
        }
        let (dims, size) = (info.dims, info.field.scalar.bytes() as u64);
        let mut piece = chunks.as_ref().map_or([1; 3], Chunks::dims);
        for a in 0..3 {
            piece[a] = piece[a].min(dims[a]);
            // Either the whole axis, or doubled as often as there is room.
            while piece[a] < dims[a] && 2 * size * piece.iter().product::<u64>() <= PIECE {
                piece[a] = (2 * piece[a]).min(dims[a]);
            }
        }
        let (dataset, entries) = (field.dataset.clone(), field.part.entries.clone());
        Ok(Self { info, dataset, chunks, axes, entries, piece, scalar, convert })
    }

    /// The samples of a box as little-endian bytes of the type in the file.
    fn stored(&self, part: IndexBox, out: &mut Vec<u8>) -> hdf5_reader::error::Result<()> {
        if let Some(chunks) = &self.chunks {
            return chunks.read(&self.entries, part, out);
        }
        let range = |start, end| SliceInfoElem::Slice { start, end, step: 1 };
        let selection = |(axis, &at): (usize, &u64)| match self.axes.iter().position(|&a| a == axis) {
            Some(a) => range(part.lo[a], part.hi[a]),
            None => range(at, at + 1),
        };
        let selections = self.entries.iter().enumerate().map(selection).collect();
        little_endian(&self.dataset, self.scalar, &SliceInfo { selections }, out)
    }
}

impl ChunkSource for Hdf5Pieces {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn chunk_dims(&self) -> [u64; 3] {
        self.piece
    }

    fn decoding_bytes(&self) -> u64 {
        let size = self.info.field.scalar.bytes() as u64;
        let piece = self.piece.iter().fold(size, |n, &d| n.saturating_mul(d));
        self.chunks.as_ref().map_or(0, Chunks::chunk_bytes).max(piece).saturating_mul(3)
    }

    fn index_bytes(&self) -> u64 {
        self.chunks.as_ref().map_or(0, Chunks::index_bytes)
    }

    fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        let d = self.info.dims;
        let lo: [u64; 3] = std::array::from_fn(|a| at[a].saturating_mul(self.piece[a]).min(d[a]));
        let part =
            IndexBox { lo, hi: std::array::from_fn(|a| lo[a].saturating_add(self.piece[a]).min(d[a])) };
        out.clear();
        self.stored(part, out).map_err(|e| {
            damaged(&self.info.path, &format!("{}, samples from {lo:?} on", self.info.field.name), &e)
        })?;
        if let Some(convert) = &self.convert {
            let mut numbers = vec![0.0; part.len()];
            to_f64(self.scalar, out, &mut numbers);
            out.clear();
            convert.push_values(&numbers, part, out);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
