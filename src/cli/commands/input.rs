//! The flags that say how a volume is read; shared by all commands that read one.

use super::grammar;
use clap::ValueEnum;
use isospan::bytes::{ByteSource, IoMode};
use isospan::formats::raw::SampleType;
use isospan::formats::{OpenOptions, RawLayout};
use isospan::{Error, Result};
use std::path::{Path, PathBuf};

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Endian {
    Little,
    Big,
}

/// How to read the input.
#[derive(clap::Args, Debug)]
pub(crate) struct InputArgs {
    /// The field to read, if the file has several.
    #[arg(help_heading = "Input", long, value_name = "NAME")]
    pub(crate) field: Option<String>,
    /// The channel to read, if a Zarr, HDF5 or TIFF file has several: a label, or a number from 0.
    #[arg(help_heading = "Input", long, value_name = "NAME|N")]
    channel: Option<String>,
    /// The level of an OME-Zarr image, or of an archive, to read: its name, or a number from 0, the
    /// finest [default: 0].
    #[arg(help_heading = "Input", long, value_name = "NAME|N", allow_hyphen_values = true)]
    scale: Option<String>,
    /// A text file with one value per point, for meshes in .node and .ele, or .pts and .tet, files.
    #[arg(help_heading = "Input", long, value_name = "FILE")]
    value_file: Option<PathBuf>,
    /// The values of cells jump between points of one place, as those of two pieces or materials
    /// are. Without this, all cells around a place are averaged together.
    #[arg(help_heading = "Input", long)]
    jumps: bool,
    /// Number of samples along x (fastest), y and z.
    #[arg(long, value_name = "X,Y,Z", value_parser = grammar::whole_triple::<u64>, requires = "scalar_type", help_heading = "Raw files", allow_hyphen_values = true)]
    dims: Option<[u64; 3]>,
    /// Type of a sample, as NumPy names it: uint8 int8 uint16 int16 uint32 int32 uint64 int64
    /// float32 float64, or with the byte order in quotes, '<u2' or '>f4'.
    #[arg(long = "type", value_name = "TYPE", id = "scalar_type", value_parser = grammar::sample_type, allow_hyphen_values = true, requires = "dims", help_heading = "Raw files")]
    scalar_type: Option<SampleType>,
    /// Byte order, where the type does not tell it [default: little].
    #[arg(long, value_enum, requires = "dims", help_heading = "Raw files")]
    endian: Option<Endian>,
    /// Bytes before the first sample.
    #[arg(long, value_name = "BYTES", value_parser = grammar::whole::<u64>, requires = "dims", help_heading = "Raw files", allow_negative_numbers = true)]
    offset: Option<u64>,
    /// Edge lengths of a voxel along x, y and z, in world units, for files that do not have them:
    /// raw, TIFF, NPY, NPZ, and HDF5 and Zarr without coordinates [default: 1,1,1].
    #[arg(help_heading = "Input", long, value_name = "X,Y,Z", value_parser = grammar::triple, allow_hyphen_values = true)]
    spacing: Option<[f64; 3]>,
    /// World coordinates of the first sample, for such files [default: 0,0,0].
    #[arg(help_heading = "Input", long, value_name = "X,Y,Z", value_parser = grammar::triple, allow_hyphen_values = true)]
    origin: Option<[f64; 3]>,
    /// How files are read. "auto" maps local files and reads files on network file systems. The
    /// result is the same.
    #[arg(help_heading = "Input", long, value_enum, default_value_t = Io::Auto)]
    io: Io,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Io {
    Auto,
    Map,
    Read,
}

impl Io {
    fn mode(self) -> IoMode {
        match self {
            Self::Auto => IoMode::Auto,
            Self::Map => IoMode::Map,
            Self::Read => IoMode::Read,
        }
    }
}

impl InputArgs {
    /// "I/O: mapped" or "I/O: read", as far as the input is one file.
    pub(crate) fn io_text(&self, input: &Path) -> String {
        match ByteSource::open(input, self.io.mode()).map(|s| s.mode()) {
            Ok(IoMode::Read) => "I/O: read".into(),
            Ok(_) => "I/O: mapped".into(),
            Err(_) => "I/O: several files".into(),
        }
    }

    fn is_big_endian(&self, sample: SampleType) -> Result<bool> {
        let given = self.endian.map(|endian| matches!(endian, Endian::Big));
        match (given, sample.big_endian) {
            (Some(a), Some(b)) if a != b => {
                Err(Error::usage("`endian` and `type` tell different byte orders"))
            }
            _ => Ok(given.or(sample.big_endian).unwrap_or(false)),
        }
    }

    pub(crate) fn options(&self) -> Result<OpenOptions> {
        let raw = match (self.dims, self.scalar_type) {
            (Some(dims), Some(sample)) => Some(RawLayout {
                dims,
                scalar: sample.scalar,
                big_endian: self.is_big_endian(sample)?,
                offset: self.offset.unwrap_or(0),
            }),
            (None, None) => None,
            _ => return Err(Error::usage("`dims` and `type` go together")),
        };
        Ok(OpenOptions {
            field: self.field.clone(),
            channel: self.channel.clone(),
            scale: self.scale.clone(),
            raw,
            spacing: self.spacing,
            origin: self.origin,
            io: self.io.mode(),
            values: self.value_file.clone(),
            jumps: self.jumps,
            ..OpenOptions::default()
        })
    }
}
