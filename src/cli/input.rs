//! The flags that say how a volume is read; shared by all commands that read one.

use super::text::parse_triple;
use clap::ValueEnum;
use isospan::bytes::{ByteSource, IoMode};
use isospan::formats::{OpenOptions, raw::RawLayout};
use isospan::volume::ScalarType;
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
    /// A text file with one value per point, for meshes in .node and .ele, or .pts and .tet, files.
    #[arg(help_heading = "Input", long, value_name = "FILE")]
    value_file: Option<PathBuf>,
    /// Number of samples along x (fastest), y and z.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_dims, requires = "scalar_type", help_heading = "Raw files")]
    dims: Option<[u64; 3]>,
    /// Type of a sample: u8 i8 u16 i16 u32 i32 u64 i64 f32 f64.
    #[arg(long = "type", value_name = "TYPE", id = "scalar_type", value_parser = parse_type, requires = "dims", help_heading = "Raw files")]
    scalar_type: Option<ScalarType>,
    /// Byte order.
    #[arg(long, value_enum, requires = "dims", help_heading = "Raw files")]
    endian: Option<Endian>,
    /// Bytes before the first sample.
    #[arg(long, value_name = "BYTES", requires = "dims", help_heading = "Raw files")]
    offset: Option<u64>,
    /// Edge lengths of a voxel along x, y and z, in world units.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_spacing, requires = "dims", help_heading = "Raw files")]
    spacing: Option<[f64; 3]>,
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

fn parse_dims(text: &str) -> std::result::Result<[u64; 3], String> {
    parse_triple(text, "a size")
}

fn parse_spacing(text: &str) -> std::result::Result<[f64; 3], String> {
    parse_triple(text, "a spacing")
}

fn parse_type(text: &str) -> std::result::Result<ScalarType, String> {
    ScalarType::from_name(text).ok_or_else(|| {
        let names: Vec<_> = ScalarType::ALL.iter().map(|t| t.name()).collect();
        format!("the types are {}", names.join(" "))
    })
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

    pub(crate) fn options(&self) -> Result<OpenOptions> {
        let raw = match (self.dims, self.scalar_type) {
            (Some(dims), Some(scalar)) => Some(RawLayout {
                dims,
                scalar,
                big_endian: matches!(self.endian, Some(Endian::Big)),
                offset: self.offset.unwrap_or(0),
                spacing: self.spacing.unwrap_or([1.0; 3]),
            }),
            (None, None) => None,
            _ => return Err(Error::usage("--dims and --type go together")),
        };
        Ok(OpenOptions {
            field: self.field.clone(),
            raw,
            io: self.io.mode(),
            values: self.value_file.clone(),
        })
    }
}
