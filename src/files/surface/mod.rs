//! Surface files, read and written: one interface for PLY, STL, OBJ, VTP, GLB, VTKHDF, 3MF and the
//! meshes of neuroglancer.
//!
//! **Writing** streams. A [`SurfaceSource`] knows its counts before its first vertex, so every
//! header is final when it is written, and the memory used is that of a buffer, for a surface of
//! any size. The bytes go to a temporary file next to the target, which is synced and then renamed.
//! So the target's name has either what was there before or a complete file, also after a crash.
//!
//! | format | stores | limit, refused before a byte is written |
//! |---|---|---|
//! | PLY, binary little-endian | vertices with normals, triangles | none here: counts are decimal text |
//! | STL, binary | triangles with facet normals; no sharing | 2³²-1 triangles |
//! | OBJ, text | vertices with normals, triangles | none |
//! | VTP, appended raw, 64-bit headers | vertices with normals, triangles, the isovalue | none |
//! | GLB (glTF 2.0) | vertices with normals, triangles, the isovalue | 4 GiB |
//! | VTKHDF, contiguous arrays | vertices with normals, triangles, the isovalue | none |
//! | 3MF, text in a zip archive | vertices, triangles; an object for each isovalue | none |
//! | neuroglancer, a folder | levels of detail; a mesh for each isovalue | a known unit |
//!
//! **Units and times.** PLY and OBJ name them in lines of comment, STL as far as its 80 bytes go.
//! VTP and VTKHDF have arrays `length_unit`, `value_unit`, `TimeValue` and `time_unit` of the
//! whole data set. GLB is in metres and y is up where the unit of length is known: its nodes have
//! the transform. 3MF has a unit of its own, neuroglancer nanometres. What is read keeps them
//! ([`StoredSurface::units`]).
//!
//! **Reading** ([`load_surface`], for the checker) streams too: what does not fit into a given
//! memory goes to a scratch folder. It reads the formats as we write them and as other programs do;
//! 3MF and neuroglancer's meshes are written only.
//! Polygons are cut into fans of triangles. Vertex normals are kept where the format stores them
//! with the vertices (PLY, VTP, GLB, VTKHDF) and are zero otherwise. Positions are stored as `f32`;
//! one that is not finite is an error.
//!
//! **Far from 0** `f32` does not tell the vertices of a small surface apart. Such a surface is in
//! memory as `f32` less an origin ([`SurfaceSource::origin`]). PLY, VTP and VTKHDF then have
//! doubles, OBJ decimals of more digits. GLB and 3MF have the origin in the transform of what they
//! place, neuroglancer in that of all meshes, STL in its comment alone: [`SurfaceFormat::shifts`].

pub mod glb;
pub mod neuroglancer;
pub mod obj;
mod parts;
pub mod ply;
pub mod stl;
pub mod threemf;
mod values;
pub mod vtkhdf;
mod vtkhdf_steps;
pub mod vtp;

use crate::files::labels::LabelStyle;
use crate::surface::check::CheckSettings;
use crate::surface::weld::{BuilderSettings, StoredSurface};
use crate::surface::{SurfaceSource, TriMesh, Vertex};
use isospan_io::bytes::ByteSource;
use isospan_io::bytes::publish::folder_of;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::error::{Error, Result};
use isospan_io::exec::Resources;
use isospan_io::formats::shared::format::is_hdf5;
use isospan_io::formats::shared::sink::Sink;
use isospan_io::volume::ScalarType;
use isospan_io::volume::shifted::shortest;
use isospan_io::volume::units::{Unit, Units};
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use glb::Compression;
pub use values::VertexValues;
pub use vtkhdf_steps::{SurfaceStep, write_surface_steps};

/// A format that surfaces are written in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SurfaceFormat {
    /// Polygon File Format (Stanford), binary little-endian.
    #[default]
    Ply,
    /// Stereolithography, binary.
    Stl,
    /// Wavefront OBJ, text.
    Obj,
    /// VTK XML PolyData, appended raw.
    Vtp,
    /// glTF 2.0, binary.
    Glb,
    /// VTK PolyData in HDF5.
    VtkHdf,
    /// 3D Manufacturing Format; it is written only.
    ThreeMf,
    /// Meshes of neuroglancer, of several resolutions: a folder, which is written only.
    Neuroglancer,
}

impl SurfaceFormat {
    /// All that are files.
    pub const ALL: [Self; 7] =
        [Self::Ply, Self::Stl, Self::Obj, Self::Vtp, Self::Glb, Self::VtkHdf, Self::ThreeMf];

    /// The file name extension, lower case, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Stl => "stl",
            Self::Obj => "obj",
            Self::Vtp => "vtp",
            Self::Glb => "glb",
            Self::VtkHdf => "vtkhdf",
            Self::ThreeMf => "3mf",
            Self::Neuroglancer => "precomputed",
        }
    }

    /// Whether surfaces are read from files of it.
    pub fn is_read(self) -> bool {
        !matches!(self, Self::ThreeMf | Self::Neuroglancer)
    }

    /// Whether it is a folder, not a file.
    pub fn is_folder(self) -> bool {
        self == Self::Neuroglancer
    }

    /// Whether a file tells several isovalues apart.
    pub fn has_parts(self) -> bool {
        self != Self::Stl
    }

    /// Whether positions in a file of a surface that has an origin are less that origin.
    pub fn shifts(self) -> bool {
        matches!(self, Self::Stl | Self::Glb)
    }

    /// Refuses a format that has no values at vertices.
    pub(crate) fn expect_colours(self) -> Result<()> {
        let what = match self {
            Self::Stl => "an STL file has",
            Self::Neuroglancer => "meshes of neuroglancer have",
            _ => return Ok(()),
        };
        Err(Error::usage(format!("{what} no colours: write .ply, .vtp, .vtkhdf, .glb, .3mf or .obj")))
    }

    /// The format that a file name asks for, by its extension in any case.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is no extension or it is none of ours.
    pub fn from_path(path: &Path) -> Result<Self> {
        let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        let found = Self::ALL
            .into_iter()
            .chain([Self::Neuroglancer])
            .find(|f| Some(f.extension()) == extension.as_deref());
        found.ok_or_else(|| {
            Error::usage(format!(
                "cannot tell the surface format of {}: end its name in .ply, .stl, .obj, .vtp, .vtkhdf, .glb, .3mf \
                 or .precomputed",
                path.display()
            ))
        })
    }
}

/// What a surface file says about itself besides the surface, and how it is written.
#[derive(Clone, Debug, Default)]
pub struct SurfaceMeta {
    /// The isovalue that the surface belongs to.
    pub isovalue: Option<f64>,
    /// Free text, a line each; characters that a format cannot hold in a comment are replaced.
    pub comments: Vec<String>,
    /// The parts of the surface, one after another, where it has several: PLY, VTP and VTKHDF then
    /// have an array `isovalue` or `label` of the vertices, OBJ has groups, GLB nodes, 3MF objects.
    /// Empty if it is one surface.
    pub parts: Vec<SurfacePart>,
    /// Values of a field at the vertices, where there are some: PLY, VTP, VTKHDF and GLB have an
    /// array of them, and PLY, OBJ, GLB and 3MF colours.
    pub values: Option<Arc<VertexValues>>,
    /// The units of coordinates, of the isovalue and of the time, as far as they are known.
    pub units: Units,
    /// The time of the step, where it has one.
    pub time: Option<f64>,
    /// Of GLB: how its arrays are made small.
    pub compress: Compression,
}

/// One of several surfaces in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfacePart {
    /// Its isovalue; of a label, the label.
    pub isovalue: f64,
    /// Its vertices.
    pub vertices: u64,
    /// Its triangles.
    pub triangles: u64,
    /// How the label is shown, where the parts are those of labels: the array is then `label`.
    pub label: Option<LabelStyle>,
}

impl SurfacePart {
    /// What it is called: a label's name, or its number, or the isovalue.
    pub(in crate::files) fn name(&self) -> String {
        match &self.label {
            None => format!("isovalue {}", self.isovalue),
            Some(label) if label.name.is_empty() => format!("label {}", self.isovalue),
            Some(label) => label.name.clone(),
        }
    }
}

impl SurfaceMeta {
    /// The isovalue, or those of the parts.
    pub(in crate::files) fn isovalues(&self) -> Vec<f64> {
        self.isovalue.into_iter().chain(self.parts.iter().map(|p| p.isovalue)).collect()
    }

    /// For each part, its end among the vertices and its isovalue.
    fn vertex_ends(&self) -> Vec<(u64, f64)> {
        let mut sum = 0;
        let end = |part: &SurfacePart| {
            sum += part.vertices;
            (sum, part.isovalue)
        };
        self.parts.iter().map(end).collect()
    }

    /// The name of the array that tells parts apart.
    pub(in crate::files) fn part_array(&self) -> &'static str {
        if self.are_labels() { "label" } else { "isovalue" }
    }

    /// Whether the parts are those of labels.
    pub(in crate::files) fn are_labels(&self) -> bool {
        self.parts.first().is_some_and(|part| part.label.is_some())
    }

    /// The type of what tells parts apart: `i32` for labels, else `f32`; `f64` where a number needs
    /// more.
    pub(in crate::files) fn part_scalar(&self) -> ScalarType {
        let mut isovalues = self.parts.iter().map(|p| p.isovalue);
        if self.are_labels() {
            let fits = |v: f64| f64::from(v as i32) == v;
            return if isovalues.all(fits) { ScalarType::I32 } else { ScalarType::F64 };
        }
        if isovalues.all(|v| shortest(v as f32) == v) { ScalarType::F32 } else { ScalarType::F64 }
    }

    /// Appends the isovalue, or the label, of a vertex of several parts.
    pub(in crate::files) fn put_isovalue(&self) -> impl Fn(u64, &mut Vec<u8>) + use<> {
        let (ends, scalar) = (self.vertex_ends(), self.part_scalar());
        move |vertex, out| {
            let at = ends.partition_point(|&(end, _)| end <= vertex);
            let isovalue = ends.get(at).map_or(f64::NAN, |part| part.1);
            match scalar {
                ScalarType::F32 => out.extend_from_slice(&(isovalue as f32).to_le_bytes()),
                ScalarType::I32 => out.extend_from_slice(&(isovalue as i32).to_le_bytes()),
                _ => out.extend_from_slice(&isovalue.to_le_bytes()),
            }
        }
    }

    /// Appends the colour of the label of a vertex.
    pub(in crate::files) fn label_colour(&self) -> impl Fn(u64) -> [u8; 3] + use<> {
        let ends: Vec<u64> = self.vertex_ends().iter().map(|part| part.0).collect();
        let colour = |part: &SurfacePart| {
            let [r, g, b, _] = part.label.as_ref().map_or([0; 4], |label| label.colour);
            [r, g, b]
        };
        let colours: Vec<[u8; 3]> = self.parts.iter().map(colour).collect();
        move |vertex| colours.get(ends.partition_point(|&end| end <= vertex)).copied().unwrap_or_default()
    }

    /// What the comments of a file say of labels: how many, and the names of the first thousand.
    fn label_lines(&self) -> Vec<String> {
        let named = |part: &SurfacePart| {
            let name = part.label.as_ref().map(|label| &label.name).filter(|name| !name.is_empty())?;
            Some(format!("label {} {name}", part.isovalue))
        };
        let names = self.parts.iter().filter_map(named).take(1000);
        std::iter::once(format!("labels {}", self.parts.len())).chain(names).collect()
    }

    /// The comment lines of a file: printable, one line each, the isovalue first.
    pub(in crate::files) fn lines(&self) -> Vec<String> {
        let clean = |line: &str| line.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        let isovalues: String = self.isovalues().iter().map(|v| format!(" {v}")).collect();
        let isovalue: Vec<String> = match self.are_labels() {
            true => self.label_lines().iter().map(|line| clean(line)).collect(),
            false if isovalues.is_empty() => vec![],
            false => vec![format!("isovalue{isovalues}")],
        };
        let texts = self.comments.iter().flat_map(|c| c.lines()).map(clean);
        let colours = self.values.iter().map(|values| clean(&values.line()));
        let named = self.named_units().map(|(name, unit)| format!("{name} {unit}"));
        let time = self.time.map(|time| format!("{TIME} {time}"));
        isovalue.into_iter().chain(named).chain(time).chain(texts).chain(colours).collect()
    }

    /// The units that are known, by the names that they have in files.
    pub(in crate::files) fn named_units(&self) -> impl Iterator<Item = (&'static str, &Unit)> {
        let Units { value, length, time } = &self.units;
        let all = [(LENGTH_UNIT, length), (VALUE_UNIT, value), (TIME_UNIT, time)];
        all.into_iter().filter_map(|(name, unit)| Some((name, unit.as_ref()?)))
    }
}

/// The names of units and of the time in files.
pub(in crate::files) const LENGTH_UNIT: &str = "length_unit";
pub(in crate::files) const VALUE_UNIT: &str = "value_unit";
pub(in crate::files) const TIME_UNIT: &str = "time_unit";
const TIME: &str = "time";
/// The array that has the time in VTK's formats.
pub(in crate::files) const TIME_VALUE: &str = "TimeValue";

/// A line of comment of ASCII alone. Signs of units have the letters that stand for them.
pub(in crate::files) fn ascii(line: &str) -> String {
    let mut out = String::with_capacity(line.len());
    for c in line.chars() {
        match c {
            'µ' | 'μ' => out.push('u'),
            'Å' | '\u{212b}' => out.push_str("angstrom"),
            '°' => out.push_str("deg"),
            '²' => out.push_str("^2"),
            '³' => out.push_str("^3"),
            _ => out.push(if c.is_ascii() { c } else { '?' }),
        }
    }
    out
}

/// Takes what a line of comment says of units and of the time, as [`SurfaceMeta::lines`] has it.
pub(in crate::files) fn take_line(out: &mut StoredSurface, line: &str) {
    let Some((name, text)) = line.trim().split_once(' ') else { return };
    match name {
        TIME => out.time = text.trim().parse().ok().filter(|time: &f64| time.is_finite()).or(out.time),
        // What had no letter in ASCII is not known.
        _ if !text.contains('?') => take_unit(out, name, text),
        _ => {}
    }
}

/// Takes a unit, by the name that it has in files.
pub(in crate::files) fn take_unit(out: &mut StoredSurface, name: &str, text: &str) {
    match name {
        LENGTH_UNIT => out.units.length = Unit::length(text),
        VALUE_UNIT => out.units.value = Unit::new(text),
        TIME_UNIT => out.units.time = Unit::time(text),
        _ => {}
    }
}

/// Writes a surface to `path` and returns the bytes of the file. An empty surface gives an empty,
/// valid file. What waits for its turn takes a part of the memory, and lies in the scratch folder
/// beyond it: that of the resources, or the folder of the file.
///
/// # Errors
/// [`Error::Usage`] when the target is a folder or lies in none, or the surface is beyond the
/// format's limits; [`Error::Io`] when the system refuses to write, or the source does not hold
/// what it announced; the source's own. After an error nothing new lies under `path`.
pub fn write_surface(
    source: &dyn SurfaceSource,
    path: &Path,
    format: SurfaceFormat,
    meta: &SurfaceMeta,
    resources: &Resources,
) -> Result<u64> {
    check_limits(source, format, meta)?;
    if format == SurfaceFormat::Neuroglancer {
        return neuroglancer::write(source, path, meta, resources);
    }
    let memory_bytes = usize::try_from(resources.memory / 16).unwrap_or(usize::MAX);
    let scratch = resources.scratch.clone().unwrap_or_else(|| folder_of(path).to_path_buf());
    write(source, Sink::create(path)?, format, meta, &BuilderSettings { memory_bytes, scratch })
}

/// Hands the bytes of the file that [`write_surface`] writes to `each`, and returns their number.
/// `scratch` is for what waits meanwhile, such as the positions of STL: the memory that it takes,
/// and the folder beyond it.
///
/// # Errors
/// [`Error::Usage`] when the surface is beyond the format's limits, before a byte; the source's
/// own, and those of `each`.
pub fn stream_surface(
    source: &dyn SurfaceSource,
    format: SurfaceFormat,
    meta: &SurfaceMeta,
    scratch: &BuilderSettings,
    each: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<u64> {
    check_limits(source, format, meta)?;
    if format.is_folder() {
        return Err(Error::usage(
            "meshes of neuroglancer are a folder, which is no stream: write it to a disk",
        ));
    }
    write(source, Sink::stream(each), format, meta, scratch)
}

/// Refuses what a format cannot hold, before a byte is written.
fn check_limits(source: &dyn SurfaceSource, format: SurfaceFormat, meta: &SurfaceMeta) -> Result<()> {
    // The source numbers vertices with 32 bits, so no format needs more; a store that announces
    // more is damaged.
    if source.vertex_count() > 1 << 32 {
        return Err(Error::usage(format!(
            "a surface has at most {} vertices, this one {}: extract it from an archive of fewer points",
            1u64 << 32,
            source.vertex_count()
        )));
    }
    if meta.values.is_some() {
        format.expect_colours()?;
    }
    if format == SurfaceFormat::Stl {
        stl::check_limits(source.triangle_count())?;
    }
    if meta.compress != Compression::None && format != SurfaceFormat::Glb {
        return Err(Error::usage(format!(
            "`compress` is for .glb, not for .{}: leave it out",
            format.extension()
        )));
    }
    if format == SurfaceFormat::Glb {
        glb::check_limits(source.vertex_count(), source.triangle_count(), meta)?;
    }
    if format == SurfaceFormat::Neuroglancer {
        neuroglancer::check(source, meta)?;
    }
    Ok(())
}

fn write(
    source: &dyn SurfaceSource,
    mut sink: Sink<'_>,
    format: SurfaceFormat,
    meta: &SurfaceMeta,
    scratch: &BuilderSettings,
) -> Result<u64> {
    match format {
        SurfaceFormat::Ply => ply::write(source, &mut sink, meta)?,
        SurfaceFormat::Stl => stl::write(source, &mut sink, meta, scratch)?,
        SurfaceFormat::Obj => obj::write(source, &mut sink, meta)?,
        SurfaceFormat::Vtp => vtp::write(source, &mut sink, meta)?,
        SurfaceFormat::Glb => glb::write(source, &mut sink, meta, scratch)?,
        SurfaceFormat::VtkHdf => vtkhdf::write(source, &mut sink, meta)?,
        SurfaceFormat::ThreeMf => threemf::write(source, &mut sink, meta, scratch)?,
        // A folder, of which no stream is written.
        SurfaceFormat::Neuroglancer => {}
    }
    sink.publish()
}

/// Reads a surface into memory, as a whole; see [`load_surface`].
///
/// # Errors
/// Those of [`load_surface`].
pub fn read_surface(path: &Path) -> Result<TriMesh> {
    TriMesh::from_source(&load_surface(path, &CheckSettings::default())?)
}

/// Reads a surface. Its format is found by the first bytes, then by the extension. Reading uses up
/// to half of the memory. The surface returned uses up to [`CheckSettings::of_source`]; the rest of
/// it is in a nameless file in the scratch folder.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file, or one that is no surface; [`Error::Io`] when it
/// cannot be read.
pub fn load_surface(path: &Path, settings: &CheckSettings) -> Result<StoredSurface> {
    let limits = ReadLimits::of(settings);
    let memory_bytes = settings.of_source();
    let mut surface =
        StoredSurface::new(&BuilderSettings { memory_bytes, scratch: settings.scratch.clone() });
    let out = &mut surface;
    let source = Arc::new(ByteSource::map(path)?);
    let bytes = source.slice(0..source.len())?;
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let read = match SurfaceFormat::from_path(path) {
        _ if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") => ply::read(path, bytes, out),
        _ if text.starts_with(b"<?xml") || text.starts_with(b"<VTKFile") => vtp::read(&source, out),
        _ if is_hdf5(bytes) => vtkhdf::read(&source, out),
        _ if glb::is_glb(bytes) => glb::read(path, bytes, &limits, out),
        _ if stl::is_binary(bytes) => stl::read(path, bytes, &limits, out),
        Ok(SurfaceFormat::Stl) => stl::read(path, bytes, &limits, out),
        Ok(SurfaceFormat::Obj) => obj::read(path, bytes, out),
        _ if text.starts_with(b"solid") => stl::read(path, bytes, &limits, out),
        Ok(SurfaceFormat::ThreeMf) => Err(Error::usage(format!(
            "{}: 3MF is written and not read: keep the surface as .ply or .glb, too",
            path.display()
        ))),
        _ => Err(Error::bad_input(
            path,
            "first bytes",
            "a PLY, STL, OBJ, VTP, GLB or VTKHDF surface",
            "something else",
        )
        .with_help("convert it, or give the file the extension of its format")),
    };
    source.check()?;
    read?;
    surface.settle()?;
    Ok(surface)
}

/// What a reader may use while it reads, in addition to the surface itself.
pub(in crate::files) struct ReadLimits {
    bytes: u64,
    scratch: PathBuf,
}

impl ReadLimits {
    pub(in crate::files) fn of(settings: &CheckSettings) -> Self {
        Self { bytes: settings.memory / 8 * 3, scratch: settings.scratch.clone() }
    }

    /// Refuses what needs more than the limits, naming the memory of the whole that has so much.
    pub(in crate::files) fn check(&self, purpose: &str, bytes: u64) -> Result<()> {
        if bytes <= self.bytes {
            return Ok(());
        }
        let whole = |limits: u64| limits.div_ceil(3).saturating_mul(8);
        Err(Error::memory(purpose, whole(bytes), whole(self.bytes)))
    }

    /// One of `count` sorters that share the limits.
    pub(in crate::files) fn sorter<R: bytemuck::Pod + Ord>(&self, count: u64) -> Sorter<R> {
        Sorter::new(usize::try_from(self.bytes / count).unwrap_or(usize::MAX), &self.scratch)
    }
}

/// Whether all three coordinates are finite.
pub(in crate::files) fn is_finite(p: &[f32; 3]) -> bool {
    p.iter().all(|c| c.is_finite())
}

/// Writes the value of every vertex.
pub(in crate::files) fn each_value(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    values: &VertexValues,
    mut each: impl FnMut(&mut Vec<u8>, f32),
) -> Result<()> {
    let (mut first, count) = (0, source.vertex_count());
    let (mut buffer, mut some) = (vec![], vec![]);
    while first < count {
        some.resize((count - first).min(RECORDS as u64) as usize, 0.0);
        values.read(first, &mut some)?;
        buffer.clear();
        some.iter().for_each(|&value| each(&mut buffer, value));
        sink.put(&buffer)?;
        first += some.len() as u64;
    }
    Ok(())
}

/// Writes a record for every vertex: `each` appends it to the buffer that it is given, and knows
/// the number of the vertex. There are exactly as many as announced, or it is an error.
pub(in crate::files) fn each_vertex(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    mut each: impl FnMut(&mut Vec<u8>, u64, &Vertex),
) -> Result<()> {
    each_vertex_with(source, sink, None, |buffer, number, vertex, _| each(buffer, number, vertex))
}

/// As [`each_vertex`], with the values at the vertices, where there are some.
pub(in crate::files) fn each_vertex_with(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    values: Option<&VertexValues>,
    mut each: impl FnMut(&mut Vec<u8>, u64, &Vertex, f32),
) -> Result<()> {
    let (mut count, announced) = (0u64, source.vertex_count());
    let (mut buffer, mut some) = (vec![], vec![]);
    source.vertices(&mut |batch| {
        if count + batch.len() as u64 > announced {
            return Err(sink.broken_source(format!("more than the {announced} vertices announced")));
        }
        for part in batch.chunks(RECORDS) {
            buffer.clear();
            some.clear();
            some.resize(part.len(), f32::NAN);
            if let Some(values) = values {
                values.read(count, &mut some)?;
            }
            for (vertex, &value) in part.iter().zip(&some) {
                each(&mut buffer, count, vertex, value);
                count += 1;
            }
            sink.put(&buffer)?;
        }
        Ok(())
    })?;
    if count != announced {
        return Err(sink.broken_source(format!("{count} vertices instead of the {announced} announced")));
    }
    Ok(())
}

/// Records that are made before they are written.
const RECORDS: usize = 1 << 14;

/// Writes a record for every triangle, as [`each_vertex`] does; all are of vertices that exist.
pub(in crate::files) fn each_triangle(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    mut each: impl FnMut(&mut Vec<u8>, u64, [u32; 3]) -> Result<()>,
) -> Result<()> {
    let (mut count, announced, vertices) = (0u64, source.triangle_count(), source.vertex_count());
    let mut buffer = vec![];
    source.triangles(&mut |batch| {
        if count + batch.len() as u64 > announced {
            return Err(sink.broken_source(format!("more than the {announced} triangles announced")));
        }
        for part in batch.chunks(RECORDS) {
            buffer.clear();
            for &t in part {
                if t.iter().any(|&v| u64::from(v) >= vertices) {
                    return Err(
                        sink.broken_source(format!("triangle {t:?} of a surface of {vertices} vertices"))
                    );
                }
                each(&mut buffer, count, t)?;
                count += 1;
            }
            sink.put(&buffer)?;
        }
        Ok(())
    })?;
    if count != announced {
        return Err(sink.broken_source(format!("{count} triangles instead of the {announced} announced")));
    }
    Ok(())
}

/// Appends the place of a vertex, as doubles where its surface has an origin.
pub(in crate::files) fn put_place(buffer: &mut Vec<u8>, v: &Vertex, origin: [f64; 3]) {
    if origin == [0.0; 3] {
        return put_floats(buffer, v.position);
    }
    v.world(origin).iter().for_each(|x| buffer.extend_from_slice(&x.to_le_bytes()));
}

/// Bytes of a coordinate of a surface, in formats that have doubles.
pub(in crate::files) fn coordinate_bytes(source: &dyn SurfaceSource) -> u64 {
    if source.origin() == [0.0; 3] { 4 } else { 8 }
}

/// What positions are less, in words; of a surface that has an origin.
pub(in crate::files) fn origin_line(source: &dyn SurfaceSource) -> Option<String> {
    let [x, y, z] = source.origin();
    (source.origin() != [0.0; 3]).then(|| format!("coordinates are less {x} {y} {z}"))
}

/// Appends numbers, little-endian.
pub(in crate::files) fn put_floats(buffer: &mut Vec<u8>, numbers: [f32; 3]) {
    let mut bytes = [0; 12];
    for (field, x) in bytes.chunks_exact_mut(4).zip(numbers) {
        field.copy_from_slice(&x.to_le_bytes());
    }
    buffer.extend_from_slice(&bytes);
}

/// A triangle fan over the corners of a polygon: (0, 1, 2), (0, 2, 3), …
#[derive(Default)]
pub(in crate::files) struct Fan {
    first: Option<u32>,
    last: Option<u32>,
}

impl Fan {
    /// Takes the next corner; from the third on each makes a triangle.
    pub(in crate::files) fn corner(&mut self, corner: u32) -> Option<[u32; 3]> {
        let Some(first) = self.first else {
            self.first = Some(corner);
            return None;
        };
        self.last.replace(corner).map(|last| [first, last, corner])
    }
}

#[cfg(test)]
pub(in crate::files) mod tests {
    use super::*;
    use crate::surface::check::check;

    /// The surface that a reader reads, in memory.
    pub(in crate::files) fn in_memory(
        read: impl FnOnce(&mut StoredSurface) -> Result<()>,
    ) -> Result<TriMesh> {
        let mut surface = StoredSurface::new(&BuilderSettings::default());
        read(&mut surface)?;
        surface.settle()?;
        TriMesh::from_source(&surface)
    }

    /// ReadLimits that holds anything, and limits that holds nothing.
    pub(in crate::files) fn rooms() -> [ReadLimits; 2] {
        [u64::MAX, 0].map(|bytes| ReadLimits { bytes, scratch: std::env::temp_dir() })
    }

    /// A surface in memory that hands itself out in batches of `batch`.
    pub(in crate::files) struct InMemory {
        pub(in crate::files) mesh: TriMesh,
        pub(in crate::files) batch: usize,
        /// Announced beyond the truth.
        pub(in crate::files) lie: [u64; 2],
    }

    impl SurfaceSource for InMemory {
        fn origin(&self) -> [f64; 3] {
            self.mesh.origin
        }
        fn vertex_count(&self) -> u64 {
            self.mesh.vertices.len() as u64 + self.lie[0]
        }
        fn triangle_count(&self) -> u64 {
            self.mesh.triangles.len() as u64 + self.lie[1]
        }
        fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()> {
            self.mesh.vertices.chunks(self.batch).try_for_each(each)
        }
        fn triangles(&self, each: &mut dyn FnMut(&[[u32; 3]]) -> Result<()>) -> Result<()> {
            self.mesh.triangles.chunks(self.batch).try_for_each(each)
        }
    }

    /// A tetrahedron whose coordinates are awkward as decimals; normals of unit length, nearly.
    pub(in crate::files) fn tetrahedron() -> TriMesh {
        let v = |position: [f32; 3]| {
            let length = position.iter().map(|c| c * c).sum::<f32>().sqrt();
            Vertex { position, normal: position.map(|c| c / length) }
        };
        let vertices = vec![
            v([0.1, 1.0 / 3.0, 1e-20]),
            v([16_777_216.0, 0.0, 1.5e10]),
            v([-0.0, 7.0, f32::MIN_POSITIVE]),
            v([3.4e38, -2.5, 1e-7]),
        ];
        TriMesh::new(vertices, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    }

    /// A small tetrahedron at coordinates of a map, which `f32` does not tell apart.
    pub(in crate::files) fn far_tetrahedron() -> TriMesh {
        let v = |position: [f32; 3]| Vertex { position, normal: [0.0, 0.0, 1.0] };
        let vertices = vec![
            v([0.125, 0.25, -0.5]),
            v([0.375, 0.0, 0.25]),
            v([-0.25, 0.375, 0.0]),
            v([0.0, -0.25, 0.375]),
        ];
        let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        TriMesh { vertices, triangles, origin: [448_262.5, -5_411_932.25, 310.0] }
    }

    pub(in crate::files) fn source(mesh: TriMesh) -> InMemory {
        InMemory { mesh, batch: 3, lie: [0, 0] }
    }

    fn meta() -> SurfaceMeta {
        SurfaceMeta {
            isovalue: Some(0.25),
            comments: vec!["a -- b\nsecond <line> ÿ".into()],
            ..SurfaceMeta::default()
        }
    }

    fn same_shape(a: &TriMesh, b: &TriMesh) {
        let corners = |m: &TriMesh| -> Vec<[[u32; 3]; 3]> {
            let bits = |v: u32| m.vertices[v as usize].position.map(|c| (c + 0.0).to_bits());
            m.triangles.iter().map(|t| t.map(bits)).collect()
        };
        assert_eq!(corners(a), corners(b));
    }

    #[test]
    fn every_format_comes_back() {
        let dir = tempfile::tempdir().unwrap();
        for format in SurfaceFormat::ALL {
            let path = dir.path().join("x").with_extension(format.extension());
            assert_eq!(SurfaceFormat::from_path(&path).unwrap(), format);
            for mesh in [tetrahedron(), TriMesh::default()] {
                let bytes =
                    write_surface(&source(mesh.clone()), &path, format, &meta(), &Resources::default())
                        .unwrap();
                assert_eq!(std::fs::metadata(&path).unwrap().len(), bytes);
                let mut streamed = vec![];
                for memory_bytes in [0, 1 << 20] {
                    streamed.clear();
                    let scratch = BuilderSettings { memory_bytes, scratch: dir.path().to_path_buf() };
                    let mut take = |bytes: &[u8]| {
                        streamed.extend_from_slice(bytes);
                        Ok(())
                    };
                    stream_surface(&source(mesh.clone()), format, &meta(), &scratch, &mut take).unwrap();
                    assert_eq!(streamed, std::fs::read(&path).unwrap(), "{format:?}");
                }
                if !format.is_read() {
                    assert_eq!(read_surface(&path).unwrap_err().exit_code(), 2);
                    continue;
                }
                let back = read_surface(&path).unwrap();
                same_shape(&mesh, &back);
                if !matches!(format, SurfaceFormat::Stl | SurfaceFormat::Obj) {
                    assert_eq!(mesh, back);
                }
            }
        }
        assert_eq!(
            std::fs::read_dir(dir.path()).unwrap().count(),
            SurfaceFormat::ALL.len(),
            "no temporary file is left"
        );
    }

    #[test]
    fn what_is_far_from_0_keeps_its_digits() {
        let dir = tempfile::tempdir().unwrap();
        let (mesh, report) = (far_tetrahedron(), check(&far_tetrahedron()));
        assert_eq!(report.zero_area_triangles, 0);
        for format in SurfaceFormat::ALL {
            let path = dir.path().join("far").with_extension(format.extension());
            write_surface(&source(mesh.clone()), &path, format, &meta(), &Resources::default()).unwrap();
            if !format.is_read() {
                continue;
            }
            let back = read_surface(&path).unwrap();
            let shift = if format == SurfaceFormat::Stl { mesh.origin } else { [0.0; 3] };
            let corners = |m: &TriMesh| -> Vec<[f64; 3]> {
                m.triangles.iter().flatten().map(|&v| m.vertices[v as usize].world(m.origin)).collect()
            };
            for (found, right) in corners(&back).iter().zip(corners(&mesh)) {
                let off = (0..3).map(|k| (found[k] - (right[k] - shift[k])).abs()).fold(0.0, f64::max);
                assert!(off < 1e-7, "{format:?}: {found:?} {right:?}");
            }
            let checked = check(&back);
            assert!((checked.area / report.area - 1.0).abs() < 1e-6, "{format:?}: {}", checked.area);
            assert_eq!((back.triangles.len(), checked.zero_area_triangles), (4, 0), "{format:?}");
        }
        let stl = std::fs::read(dir.path().join("far.stl")).unwrap();
        let header = String::from_utf8_lossy(&stl[..80]).into_owned();
        assert!(header.contains("less 448262.5 -5411932.25 310"), "{header}");
    }

    #[test]
    fn units_and_times_come_back() {
        let dir = tempfile::tempdir().unwrap();
        let units = Units { value: Unit::new("HU"), length: Unit::length("um"), time: Unit::time("seconds") };
        let meta = SurfaceMeta { units: units.clone(), time: Some(0.1), ..meta() };
        for (format, shift) in SurfaceFormat::ALL.iter().flat_map(|f| [(*f, false), (*f, true)]) {
            let path = dir.path().join("u").with_extension(format.extension());
            let mesh = if shift { far_tetrahedron() } else { tetrahedron() };
            write_surface(&source(mesh.clone()), &path, format, &meta, &Resources::default()).unwrap();
            if !format.is_read() {
                continue;
            }
            let back = load_surface(&path, &CheckSettings::default()).unwrap();
            // STL has 80 bytes for all that is said.
            if format == SurfaceFormat::Stl {
                assert_eq!(back.units.length, if shift { None } else { units.length.clone() });
            } else {
                assert_eq!((&back.units, back.time), (&units, Some(0.1)), "{format:?}");
            }
            if !matches!(format, SurfaceFormat::Stl | SurfaceFormat::Obj) {
                let back = TriMesh::from_source(&back).unwrap();
                assert_eq!(back.triangles, mesh.triangles);
                let all = back.vertices.iter().zip(&mesh.vertices);
                // In the coordinates of the world, whatever the file has.
                for (found, right) in all {
                    let [a, b] = [(found, back.origin), (right, mesh.origin)].map(|(v, o)| v.world(o));
                    assert!(
                        (0..3).all(|k| (a[k] - b[k]).abs() <= 1e-7 * b[k].abs()),
                        "{format:?} {a:?} {b:?}"
                    );
                }
            }
        }
        assert_eq!(ascii("µm Å 3 °C ≈"), "um angstrom 3 degC ?");
    }

    #[test]
    fn batches_do_not_show() {
        let dir = tempfile::tempdir().unwrap();
        for format in SurfaceFormat::ALL {
            let write = |batch: usize| {
                let path = dir.path().join(format!("{batch}.{}", format.extension()));
                let s = InMemory { mesh: tetrahedron(), batch, lie: [0, 0] };
                write_surface(&s, &path, format, &meta(), &Resources::default()).unwrap();
                std::fs::read(path).unwrap()
            };
            assert_eq!(write(1), write(100));
        }
    }

    #[test]
    fn a_source_that_lies_leaves_the_old_file() {
        let dir = tempfile::tempdir().unwrap();
        for format in SurfaceFormat::ALL {
            let path = dir.path().join("kept").with_extension(format.extension());
            std::fs::write(&path, "old").unwrap();
            let mut wrong_index = source(tetrahedron());
            wrong_index.mesh.triangles[2][1] = 4;
            let lies = [[1, 0], [0, 1]].map(|lie| InMemory { lie, ..source(tetrahedron()) });
            for s in lies.into_iter().chain([wrong_index]) {
                assert!(write_surface(&s, &path, format, &meta(), &Resources::default()).is_err());
                assert_eq!(std::fs::read(&path).unwrap(), b"old");
            }
        }
        assert_eq!(
            std::fs::read_dir(dir.path()).unwrap().count(),
            SurfaceFormat::ALL.len(),
            "no temporary file is left"
        );
    }

    #[test]
    fn impossible_targets_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let refused = |path: &Path| {
            let e = write_surface(
                &source(tetrahedron()),
                path,
                SurfaceFormat::Ply,
                &meta(),
                &Resources::default(),
            )
            .unwrap_err();
            assert_eq!(e.exit_code(), 2);
            e.to_string()
        };
        assert!(refused(dir.path()).contains("a folder"));
        assert!(refused(&dir.path().join("none/x.ply")).contains("no folder"));
        #[cfg(unix)]
        assert!(refused(Path::new("/dev/null")).contains("device"));
        assert!(SurfaceFormat::from_path(Path::new("x.nrrd")).is_err());
        assert!(SurfaceFormat::from_path(Path::new("ply")).is_err());
    }

    #[test]
    fn more_than_a_format_can_count_is_refused_before_it_is_written() {
        let dir = tempfile::tempdir().unwrap();
        for (lie, format) in [([1 << 32, 0], SurfaceFormat::Ply), ([0, 1 << 32], SurfaceFormat::Stl)] {
            let error = write_surface(
                &InMemory { lie, ..source(tetrahedron()) },
                &dir.path().join("x"),
                format,
                &meta(),
                &Resources::default(),
            );
            let error = error.unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains("at most"), "{error}");
        }
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_followed_and_the_file_is_readable_by_others() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let (real, link) = (dir.path().join("real.ply"), dir.path().join("link.ply"));
        std::fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        write_surface(&source(tetrahedron()), &link, SurfaceFormat::Ply, &meta(), &Resources::default())
            .unwrap();
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(std::fs::read(&real).unwrap().starts_with(b"ply"));
        let plain = dir.path().join("plain");
        std::fs::write(&plain, "").unwrap();
        let mode = |p: &Path| std::fs::metadata(p).unwrap().permissions().mode();
        assert_eq!(mode(&real), mode(&plain));
    }

    #[test]
    fn a_file_that_is_no_surface_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.dat");
        std::fs::write(&path, "# vtk DataFile Version 3.0\n").unwrap();
        assert_eq!(read_surface(&path).unwrap_err().exit_code(), 5);
    }
}
