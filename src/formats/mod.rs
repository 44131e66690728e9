//! Reads and writes other programs' files.
//!
//! [`open_volume`] finds the format of a file by its first bytes or, where they do not show it, by
//! its name. It hands the file to the module of that format. Each module parses a header, and
//! checks every number of it against the file's length. Uncompressed samples become a mapped
//! [`StridedVolume`](crate::volume::strided::StridedVolume); compressed samples and text become a
//! stream of slabs.
//!
//! World coordinates are the file's own: NRRD and MetaImage files usually say
//! left-posterior-superior, NIfTI right-anterior-superior. They are not converted into one another.

pub(crate) mod brick_map;
mod centers;
pub mod coordinates;
mod folder;
pub mod glb;
pub mod gmsh;
#[cfg(feature = "hdf5")]
pub mod hdf5;
mod header;
mod mesh;
pub mod metaimage;
pub mod nifti;
pub mod npy;
pub mod npz;
pub mod nrrd;
mod numbers;
pub mod obj;
pub mod ply;
pub mod point_list;
mod ranges;
pub mod raw;
pub mod samples;
mod series;
mod stack;
pub mod stl;
pub mod stream;
pub mod surface;
pub mod tetgen;
mod text;
pub mod tiff;
pub mod vtk_legacy;
pub mod vtk_xml;
pub mod vtp;
pub mod vtu;
pub mod zarr;

use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::volume::bricked::{self, BrickedVolume};
use crate::volume::{FieldInfo, VolumeSource};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stream::Codec;

pub use coordinates::open_coordinates;
pub use mesh::{Input, is_mesh, open_input, open_mesh};
pub use nifti::UnpackedFrames;
pub(crate) use series::listed_files;
pub use series::{StepSource, order_in_doubt, packed_frames, steps_of, unpack_frames};

/// How to open a volume.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct OpenOptions {
    /// The field to read, where the file has several.
    pub field: Option<String>,
    /// The layout of a headerless file; required for those, refused for others.
    pub raw: Option<raw::RawLayout>,
    /// World lengths of a voxel's edges along x, y and z, for a format without spacing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spacing: Option<[f64; 3]>,
    /// World coordinates of the first sample, for a format without an origin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<[f64; 3]>,
    /// Whether files are mapped or read. Does not change what is read.
    pub io: IoMode,
    /// A text file of one number a point, for meshes whose format keeps values apart: TetGen,
    /// points and tetrahedra as text.
    pub values: Option<PathBuf>,
}

impl OpenOptions {
    /// Refuses a spacing and an origin for a file that has its own.
    fn refuse_geometry(&self, path: &Path, what: &str) -> Result<()> {
        if self.spacing.is_none() && self.origin.is_none() {
            return Ok(());
        }
        let path = path.display();
        let help = "leave out --spacing and --origin";
        Err(Error::usage(format!("{path} is {what}, which tells its own spacing and origin: {help}")))
    }
}

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats) enum Kind {
    Bricks,
    Hdf5,
    MetaImage,
    Nifti,
    Npy,
    Npz,
    Nrrd,
    Tiff,
    VtkLegacy,
    VtkXml,
}

impl Kind {
    /// Whether its files say where their samples lie. An HDF5 file may.
    fn has_spacing(self) -> bool {
        !matches!(self, Self::Hdf5 | Self::Npy | Self::Npz | Self::Tiff)
    }

    fn name(self) -> &'static str {
        match self {
            Self::Bricks => "an isospan .bricks file",
            Self::Hdf5 => "an HDF5 or NetCDF-4 file",
            Self::MetaImage => "a MetaImage file",
            Self::Nifti => "a NIfTI file",
            Self::Npy => "an NPY file",
            Self::Npz => "an NPZ file",
            Self::Nrrd => "an NRRD file",
            Self::Tiff => "a TIFF file",
            Self::VtkLegacy => "a legacy VTK file",
            Self::VtkXml => "a VTK XML file",
        }
    }
}

/// Opens a volume of any format that is read: a file, a folder of slices, or a pattern for the
/// names of slices.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file or an unknown kind; [`Error::Usage`] when several
/// fields ask for a choice, when a headerless file comes without its layout, or another with one,
/// or a volume with a table of values.
pub fn open_volume(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    if options.values.is_some() {
        return Err(Error::usage(format!("{} is no mesh: leave out --value-file", path.display())));
    }
    if folder::is_several(path) {
        return folder::open(path, options);
    }
    let source = Arc::new(ByteSource::open(path, options.io)?);
    let kind = kind_of(&source);
    if let (Some(kind), Some(_)) = (kind, &options.raw) {
        return Err(Error::usage(format!(
            "{} is {}, which tells its own layout: leave out --dims, --type, --endian and --offset",
            path.display(),
            kind.name()
        )));
    }
    if let Some(kind) = kind.filter(|kind| kind.has_spacing()) {
        options.refuse_geometry(path, kind.name())?;
    }
    match kind {
        Some(Kind::Bricks) => {
            let volume = BrickedVolume::open_with(path, options.io)?;
            pick_field(path, &crate::volume::VolumeReader::info(&volume).fields, options.field.as_deref())?;
            Ok(VolumeSource::Random(Box::new(volume)))
        }
        Some(Kind::Hdf5) => open_hdf5(path, options),
        Some(Kind::MetaImage) => metaimage::open(path, options),
        Some(Kind::Nifti) => nifti::open(path, options),
        Some(Kind::Npy) => npy::open(path, options),
        Some(Kind::Npz) => npz::open(path, options),
        Some(Kind::Nrrd) => nrrd::open(path, options),
        Some(Kind::Tiff) => tiff::open(path, options),
        Some(Kind::VtkLegacy) => vtk_legacy::open(path, options),
        Some(Kind::VtkXml) => vtk_xml::open(path, options),
        None if options.raw.is_some() => raw::open(path, options),
        None if has_suffix(path, &[".raw", ".bin", ".dat", ".raw.gz"]) => Err(raw::no_layout(path)),
        None => Err(unknown_kind(&source)),
    }
}

#[cfg(feature = "hdf5")]
fn open_hdf5(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    hdf5::open(path, options)
}

#[cfg(not(feature = "hdf5"))]
fn open_hdf5(path: &Path, _: &OpenOptions) -> Result<VolumeSource> {
    let got = "an HDF5 or NetCDF-4 file, and a program built without the feature hdf5";
    Err(Error::bad_input(path, "kind of file", "a format that this program reads", got)
        .with_help("install it with `--features hdf5`"))
}

/// What a file is: by its first bytes, then by its name.
fn kind_of(source: &Arc<ByteSource>) -> Option<Kind> {
    let head = source.slice(0..source.len().min(512)).expect("within the file");
    let path = source.path();
    let magic = [
        (&b"NRRD000"[..], Kind::Nrrd),
        (b"\x93NUMPY", Kind::Npy),
        (b"PK\x03\x04", Kind::Npz),
        (b"\x89HDF\r\n\x1a\n", Kind::Hdf5),
        (b"# vtk DataFile", Kind::VtkLegacy),
        (b"<VTKFile", Kind::VtkXml),
        (&bricked::MAGIC, Kind::Bricks),
    ];
    let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head).trim_ascii_start();
    if let Some((_, kind)) = magic.into_iter().find(|(m, _)| head.starts_with(m)) {
        return Some(kind);
    }
    if text.starts_with(b"<?xml") || text.starts_with(b"<VTKFile") {
        return Some(Kind::VtkXml);
    }
    if tiff::has_magic(head) {
        return Some(Kind::Tiff);
    }
    if nifti::has_magic(head) || (head.starts_with(&[0x1f, 0x8b]) && nifti::has_magic(&unzipped_head(source)))
    {
        return Some(Kind::Nifti);
    }
    let by_name = [
        (&[".nrrd", ".nhdr"][..], Kind::Nrrd),
        (&[".mha", ".mhd"], Kind::MetaImage),
        (&[".nii", ".nii.gz", ".hdr", ".hdr.gz", ".img", ".img.gz"], Kind::Nifti),
        (&[".npy"], Kind::Npy),
        (&[".npz"], Kind::Npz),
        (&tiff::SUFFIXES, Kind::Tiff),
        (&[".vtk"], Kind::VtkLegacy),
        (&[".vti", ".vtr", ".vts"], Kind::VtkXml),
        (&[".bricks"], Kind::Bricks),
    ];
    by_name.into_iter().find(|(suffixes, _)| has_suffix(path, suffixes)).map(|(_, kind)| kind)
}

/// The first bytes of a gzip file, decoded; fewer where it is damaged, which its own reader will
/// report.
fn unzipped_head(source: &Arc<ByteSource>) -> Vec<u8> {
    let mut head = vec![];
    if let Ok(decoded) = Codec::Gzip.reader(source, 0..source.len()) {
        // The bytes decoded before an error suffice.
        let _ = std::io::Read::read_to_end(&mut std::io::Read::take(decoded, 512), &mut head);
    }
    head
}

fn unknown_kind(source: &ByteSource) -> Error {
    let head = source.slice(0..source.len().min(8)).expect("within the file");
    let shown: Vec<String> = head.iter().map(|b| format!("{b:02x}")).collect();
    let is_surface = has_suffix(source.path(), &[".ply", ".stl", ".obj", ".vtp", ".glb"]);
    let help = if is_surface {
        "of surfaces, isospan check tells what is in them"
    } else {
        "a headerless file needs --dims and --type; of other compressed files, unpack them first"
    };
    Error::bad_input(
        source.path(),
        "kind of file",
        "a volume (NRRD, MetaImage, NPY, NPZ, NIfTI, TIFF, HDF5, NetCDF-4, VTI, VTR, VTS, legacy VTK, .bricks, a \
         folder of slices or Zarr) or a mesh (VTU, PVTU, legacy VTK, Gmsh, TetGen, .pts and .tet)",
        if is_surface { "a surface".into() } else { format!("none of these: it begins with {}", shown.join(" ")) },
    )
    .with_help(help)
}

/// Whether the file's name ends in one of `suffixes`, in any case.
pub(crate) fn has_suffix(path: &Path, suffixes: &[&str]) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    suffixes.iter().any(|s| name.ends_with(s))
}

/// The index of the field to read: the one that is `wanted`, the first that a pattern matches, or
/// the only scalar one.
///
/// # Errors
/// [`Error::Usage`] listing the fields when `wanted` is not a scalar field of the file, or is
/// needed and not given; [`Error::BadInput`] when there is no scalar field at all.
pub fn pick_field(path: &Path, fields: &[FieldInfo], wanted: Option<&str>) -> Result<usize> {
    let scalar: Vec<usize> = (0..fields.len()).filter(|&i| fields[i].components == 1).collect();
    if scalar.is_empty() {
        let got = if fields.is_empty() { "no field".into() } else { list_fields(fields) };
        return Err(Error::bad_input(path, "fields", "a field with one number a sample", got)
            .with_help("write the component or the magnitude to a field of its own"));
    }
    match (wanted, &scalar[..]) {
        (None, &[only]) => Ok(only),
        (None, _) => Err(Error::usage(format!(
            "{}: several fields: {}; choose one with --field NAME, or steps of a series with --field PATTERN",
            path.display(),
            list_fields(fields)
        ))),
        (Some(name), _) => {
            let named = scalar.iter().find(|&&i| fields[i].name == name);
            let matching = || scalar.iter().find(|&&i| series::field_matches(name, &fields[i].name));
            named.or_else(matching).copied().ok_or_else(|| {
                let fields = list_fields(fields);
                Error::usage(format!("{}: no scalar field {name}; its fields: {fields}", path.display()))
            })
        }
    }
}

/// "speed (float32), velocity (3 x float32, not scalar)"; only the first if there are very many.
fn list_fields(fields: &[FieldInfo]) -> String {
    const MOST: usize = 40;
    let one = |f: &FieldInfo| match f.components {
        1 => format!("{} ({})", f.name, f.scalar.name()),
        n => format!("{} ({n} x {}, not scalar)", f.name, f.scalar.name()),
    };
    let mut list: Vec<String> = fields.iter().take(MOST).map(one).collect();
    if fields.len() > MOST {
        list.push(format!("… {} in all", fields.len()));
    }
    list.join(", ")
}

#[cfg(test)]
mod shared_data;

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::grid::IndexBox;
    use crate::volume::{ScalarType, VolumeInfo, strided::convert_row};
    use std::io::Write;

    /// The folder of real data sets, for tests that are ignored unless asked for.
    pub(crate) fn shared_data() -> PathBuf {
        PathBuf::from(
            std::env::var_os("ISOSPAN_SHARED_DATA").expect("ISOSPAN_SHARED_DATA names a folder of real data"),
        )
    }

    /// Writes a file in a temporary folder.
    pub(crate) fn write(dir: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
        let path = dir.path().join(name);
        // Some file systems flush a file that is cut and written again; a new one costs nothing.
        let _ = std::fs::remove_file(&path);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// The samples 1000, 1001, … of a 4 x 3 x 2 volume of u16.
    pub(crate) fn ramp(big_endian: bool) -> Vec<u8> {
        let sample = |i: u16| if big_endian { i.to_be_bytes() } else { i.to_le_bytes() };
        (1000..1024).flat_map(sample).collect()
    }

    pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut gz = flate2::write::GzEncoder::new(vec![], flate2::Compression::fast());
        gz.write_all(bytes).unwrap();
        gz.finish().unwrap()
    }

    /// All values of a source, x fastest; panics on an error.
    pub(crate) fn read_all(source: VolumeSource) -> (VolumeInfo, Vec<f32>) {
        let info = source.info().clone();
        (info, try_read_all(source).unwrap())
    }

    /// All values of a source, x fastest.
    pub(crate) fn try_read_all(source: VolumeSource) -> Result<Vec<f32>> {
        let info = source.info().clone();
        let whole = IndexBox::whole(info.dims);
        if let VolumeSource::Random(reader) = &source {
            let mut values = vec![0.0; whole.len()];
            reader.read_box(whole, &mut values)?;
            return Ok(values);
        }
        let (mut stream, mut bytes, mut values) = (source.into_stream(), vec![], vec![]);
        while let Some(slab) = stream.next_slab(&mut bytes)? {
            let mut part = vec![0.0; slab.len()];
            convert_row(
                &bytes,
                info.field.scalar,
                false,
                info.slope,
                info.intercept,
                info.missing,
                &mut part,
            );
            assert_eq!(whole.offset(slab.lo), values.len());
            values.extend(part);
        }
        assert_eq!(values.len(), whole.len());
        Ok(values)
    }

    /// Whether a damaged file is refused, or read whole, in an orderly way; panics are the test's
    /// failures.
    pub(crate) fn survives(path: &Path) -> bool {
        let opened = open_volume(path, &OpenOptions::default());
        match opened.and_then(try_read_all) {
            Ok(_) => true,
            Err(e) => {
                let (line, folder) = (e.to_string(), path.parent().expect("a folder").display().to_string());
                assert!(!line.contains('\n') && line.contains(&folder), "{line}");
                false
            }
        }
    }

    /// Cuts a small file at every length and flips bytes all over; every cut inside `needed` must
    /// be refused.
    pub(crate) fn torture(name: &str, bytes: &[u8], needed: usize) {
        let dir = tempfile::tempdir().unwrap();
        assert!(survives(&write(&dir, name, bytes)), "the undamaged file is read");
        for cut in 0..bytes.len() {
            let read = survives(&write(&dir, name, &bytes[..cut]));
            assert!(!(read && cut < needed), "{name} cut to {cut} bytes was read");
        }
        for at in 0..bytes.len().min(1500) {
            for flip in [0x01, 0x10, 0x80, 0xff] {
                let mut damaged = bytes.to_vec();
                damaged[at] ^= flip;
                survives(&write(&dir, name, &damaged));
            }
        }
    }

    fn field(name: &str, components: u32) -> FieldInfo {
        FieldInfo { name: name.into(), scalar: ScalarType::F32, components }
    }

    #[test]
    fn fields_are_picked_or_listed() {
        let path = Path::new("f.vti");
        let fields = [field("velocity", 3), field("speed", 1), field("heat", 1)];
        assert_eq!(pick_field(path, &fields[..2], None).unwrap(), 1);
        assert_eq!(pick_field(path, &fields, Some("heat")).unwrap(), 2);
        for wanted in [None, Some("velocity"), Some("none")] {
            let error = pick_field(path, &fields, wanted).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(
                error
                    .to_string()
                    .contains("velocity (3 x float32, not scalar), speed (float32), heat (float32)"),
                "{error}"
            );
        }
        assert_eq!(pick_field(path, &fields[..1], None).unwrap_err().exit_code(), 5);
        assert_eq!(pick_field(path, &[], None).unwrap_err().exit_code(), 5);
    }

    #[test]
    fn unknown_kinds_are_told_what_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let open = |name: &str, bytes: &[u8]| {
            open_volume(&write(&dir, name, bytes), &OpenOptions::default()).err().expect("refused")
        };
        assert!(open("a.png", b"\x89PNG").to_string().contains("MetaImage"));
        assert_eq!(open("a.raw", b"1234").exit_code(), 2);
        let layout = raw::RawLayout { dims: [2; 3], scalar: ScalarType::U8, big_endian: false, offset: 0 };
        let options = OpenOptions { raw: Some(layout), ..OpenOptions::default() };
        let nrrd = write(&dir, "a.nrrd", b"NRRD0004\n");
        let error = open_volume(&nrrd, &options).err().expect("refused");
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("an NRRD file"), "{error}");
    }
}
