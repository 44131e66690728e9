//! Writes a synthetic volume of any size, slice by slice, the same bytes on every machine.
//!
//! | field | f(x, y, z) | box | range |
//! |---|---|---|---|
//! | `sphere` | x² + y² + z² - 0.4² | [-½, ½]³ | -0.16 … 0.59 |
//! | `gyroid` | sin x cos y + sin y cos z + sin z cos x | [0, 2π·periods]³ | -1.5 … 1.5 |
//! | `marschner-lobb` | (1 - sin(πz/2) + α(1 + cos(2π f_M cos(πr/2)))) / 2(1 + α), r² = x² + y² | [-1, 1]³ | 0 … 1 |
//!
//! The sphere is the thesis's SPHERE (section 3.1, which does not print its box: the unit cube
//! about the centre holds the surface f = 0). Marschner and Lobb 1994, "An evaluation of
//! reconstruction filters for volume rendering": f_M = 6, α = ¼; their test samples it 40³. Samples
//! lie on the faces of the box, so spacing is its side over (dims - 1).
//!
//! f32 samples are the field's values; u8 and u16 map the range above to 0 … 255 or 65535, half up.
//! Sines come from the `libm` crate, because those of the standard library differ in the last bit
//! from machine to machine. Memory: a few numbers for each sample of one slice, of 64 slices for
//! Zarr. A file appears under its name when it is whole; the folders of TIFF (`.tifs`, a slice a
//! file) and Zarr (`.zarr`, version 3, zstd) fill as slices come.

mod folders;

use folders::Folder;
use isospan::{Error, Result};
use std::f64::consts::PI;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const HELP: &str = "\
usage: make_volume FIELD --dims X,Y,Z -o FILE.(nrrd|npy|raw|tifs|zarr) [options]
  FIELD                    sphere, gyroid or marschner-lobb
  --dims X,Y,Z             samples along each axis, at least 2
  -o FILE                  its ending chooses the format
  --type TYPE              type of a sample: float32, uint8 or uint16 [float32]
  --endian little|big      byte order of a sample [little]
  --periods N              periods of the gyroid along each axis [2]";

#[derive(Clone, Copy, Debug, PartialEq)]
enum Field {
    Sphere,
    Gyroid,
    MarschnerLobb,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum NumberType {
    F32,
    U8,
    U16,
}

impl NumberType {
    fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::U8 => 1,
            Self::U16 => 2,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Format {
    Nrrd,
    Npy,
    Raw,
    Tiffs,
    Zarr,
}

#[derive(Clone, Debug, PartialEq)]
struct Settings {
    field: Field,
    dims: [usize; 3],
    kind: NumberType,
    big_endian: bool,
    periods: u32,
    format: Format,
    out: PathBuf,
}

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if args.is_empty() || args.iter().any(|a| a == "--help" || a == "-h") {
        eprintln!("{HELP}");
        return ExitCode::from(if args.is_empty() { 2 } else { 0 });
    }
    match Settings::parse(&args).and_then(|s| s.write()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("make_volume: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

impl Settings {
    fn parse(args: &[String]) -> Result<Self> {
        let (mut field, mut dims, mut out) = (None, None, None);
        let (mut kind, mut big_endian, mut periods) = (NumberType::F32, false, 2);
        let mut args = args.iter();
        while let Some(arg) = args.next() {
            let mut value =
                || args.next().ok_or_else(|| Error::usage(format!("{arg} needs a value; see --help")));
            match arg.as_str() {
                "--dims" => dims = Some(parse_dims(value()?)?),
                "--type" => {
                    kind = one_of(
                        value()?,
                        &[
                            ("float32", NumberType::F32),
                            ("uint8", NumberType::U8),
                            ("uint16", NumberType::U16),
                        ],
                    )?;
                }
                "--endian" => big_endian = one_of(value()?, &[("little", false), ("big", true)])?,
                "--periods" => periods = parse_periods(value()?)?,
                "-o" => out = Some(PathBuf::from(value()?)),
                name if field.is_none() && !name.starts_with('-') => field = Some(parse_field(name)?),
                other => return Err(Error::usage(format!("{other:?} is not understood; see --help"))),
            }
        }
        let missing = |what: &str| Error::usage(format!("{what} is missing; see --help"));
        let out = out.ok_or_else(|| missing("-o FILE"))?;
        Ok(Self {
            field: field.ok_or_else(|| missing("FIELD"))?,
            dims: dims.ok_or_else(|| missing("--dims X,Y,Z"))?,
            kind,
            big_endian,
            periods,
            format: format_of(&out)?,
            out,
        })
    }

    fn write(&self) -> Result<()> {
        let mut folder = match self.format {
            Format::Tiffs => Folder::tiffs(&self.out)?,
            Format::Zarr => Folder::zarr(&self.out, self)?,
            _ => return self.write_file(),
        };
        self.samples(|bytes| folder.slice(self, bytes))
    }

    /// Writes the file under a temporary name in the same folder, then renames.
    fn write_file(&self) -> Result<()> {
        let folder = self.out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let failed = |e| Error::io("write", &self.out, e);
        let file = tempfile::Builder::new()
            .prefix(".make_volume-")
            .tempfile_in(folder)
            .map_err(|e| Error::io("create a file in", folder, e))?;
        let mut out = BufWriter::with_capacity(1 << 20, file);
        out.write_all(self.header().as_slice()).map_err(failed)?;
        self.samples(|bytes| out.write_all(bytes).map_err(failed))?;
        let file = out.into_inner().map_err(|e| failed(e.into_error()))?;
        file.persist(&self.out).map_err(|e| failed(e.error))?;
        readable_by_others(&self.out).map_err(failed)
    }

    /// Hands the stored samples of one slice after the other to `each`.
    fn samples(&self, mut each: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        let planes = Planes::new(self);
        let mut bytes = vec![];
        for z in 0..self.dims[2] {
            bytes.clear();
            for y in 0..self.dims[1] {
                (0..self.dims[0]).for_each(|x| self.push(planes.value([x, y, z]), &mut bytes));
            }
            each(&bytes)?;
        }
        Ok(())
    }

    /// Stores one sample.
    fn push(&self, value: f64, bytes: &mut Vec<u8>) {
        let (lo, hi) = self.range();
        let scaled = |max: f64| ((value - lo) / (hi - lo) * max + 0.5).clamp(0.0, max).floor();
        match (self.kind, self.big_endian) {
            (NumberType::F32, false) => bytes.extend((value as f32).to_le_bytes()),
            (NumberType::F32, true) => bytes.extend(swapped((value as f32).to_le_bytes())),
            (NumberType::U16, false) => bytes.extend((scaled(65535.0) as u16).to_le_bytes()),
            (NumberType::U16, true) => bytes.extend(swapped((scaled(65535.0) as u16).to_le_bytes())),
            (NumberType::U8, _) => bytes.push(scaled(255.0) as u8),
        }
    }

    /// Smallest and largest value in the box, those that u8 and u16 stretch over.
    fn range(&self) -> (f64, f64) {
        match self.field {
            Field::Sphere => (-0.16, 0.59),
            Field::Gyroid => (-1.5, 1.5),
            Field::MarschnerLobb => (0.0, 1.0),
        }
    }

    /// The box's lower corner and its side.
    fn domain(&self) -> (f64, f64) {
        match self.field {
            Field::Sphere => (-0.5, 1.0),
            Field::Gyroid => (0.0, 2.0 * PI * f64::from(self.periods)),
            Field::MarschnerLobb => (-1.0, 2.0),
        }
    }

    /// World coordinates of the samples along an axis.
    fn axis(&self, a: usize) -> Vec<f64> {
        let (lo, side) = self.domain();
        let last = (self.dims[a] - 1) as f64;
        (0..self.dims[a]).map(|i| lo + side * i as f64 / last).collect()
    }

    fn spacing(&self) -> [f64; 3] {
        self.dims.map(|d| self.domain().1 / (d - 1) as f64)
    }

    fn header(&self) -> Vec<u8> {
        match self.format {
            Format::Nrrd => self.nrrd_header(),
            Format::Npy => self.npy_header(),
            Format::Raw | Format::Tiffs | Format::Zarr => vec![],
        }
    }

    fn nrrd_header(&self) -> Vec<u8> {
        let ([x, y, z], [dx, dy, dz]) = (self.dims, self.spacing());
        let kind = match self.kind {
            NumberType::F32 => "float",
            NumberType::U8 => "uint8",
            NumberType::U16 => "uint16",
        };
        let (endian, lo) = (if self.big_endian { "big" } else { "little" }, self.domain().0);
        format!(
            "NRRD0004\n# {:?} by make_volume\ntype: {kind}\ndimension: 3\nspace dimension: 3\nsizes: {x} {y} {z}\n\
             space directions: ({dx},0,0) (0,{dy},0) (0,0,{dz})\nspace origin: ({lo},{lo},{lo})\n\
             endian: {endian}\nencoding: raw\n\n",
            self.field
        )
        .into_bytes()
    }

    /// NPY version 1.0: the dictionary is padded with blanks so that the data start at a multiple
    /// of 64.
    fn npy_header(&self) -> Vec<u8> {
        let [x, y, z] = self.dims;
        let descr = match (self.kind, self.big_endian) {
            (NumberType::U8, _) => "|u1",
            (NumberType::U16, false) => "<u2",
            (NumberType::U16, true) => ">u2",
            (NumberType::F32, false) => "<f4",
            (NumberType::F32, true) => ">f4",
        };
        let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({z}, {y}, {x}), }}");
        while (10 + text.len() + 1) % 64 != 0 {
            text.push(' ');
        }
        text.push('\n');
        let length = u16::try_from(text.len()).expect("three numbers are a short text");
        [b"\x93NUMPY\x01\x00".as_slice(), &length.to_le_bytes(), text.as_bytes()].concat()
    }
}

/// The field as terms of one axis or one plane, so that a sample costs no sine.
enum Planes {
    /// Squares along each axis.
    Sphere([Vec<f64>; 3]),
    /// Sine and cosine along each axis.
    Gyroid([Vec<(f64, f64)>; 3]),
    /// α(1 + ρ_r) over the plane, x fastest; 1 - sin(πz/2); samples along x.
    MarschnerLobb(Vec<f64>, Vec<f64>, usize),
}

impl Planes {
    const ALPHA: f64 = 0.25;
    const FREQUENCY: f64 = 6.0;

    fn new(s: &Settings) -> Self {
        let axes = [s.axis(0), s.axis(1), s.axis(2)];
        match s.field {
            Field::Sphere => Self::Sphere(axes.map(|a| a.iter().map(|x| x * x).collect())),
            Field::Gyroid => {
                Self::Gyroid(axes.map(|a| a.iter().map(|&x| (libm::sin(x), libm::cos(x))).collect()))
            }
            Field::MarschnerLobb => {
                let [x, y, z] = &axes;
                let radial = |r: f64| libm::cos(2.0 * PI * Self::FREQUENCY * libm::cos(PI * r / 2.0));
                let term = |x: f64, y: f64| Self::ALPHA * (1.0 + radial((x * x + y * y).sqrt()));
                let plane = y.iter().flat_map(|&y| x.iter().map(move |&x| term(x, y))).collect();
                let along_z = z.iter().map(|z| 1.0 - libm::sin(PI * z / 2.0)).collect();
                Self::MarschnerLobb(plane, along_z, x.len())
            }
        }
    }

    #[inline]
    fn value(&self, [x, y, z]: [usize; 3]) -> f64 {
        match self {
            Self::Sphere(sq) => sq[0][x] + sq[1][y] + sq[2][z] - 0.4 * 0.4,
            Self::Gyroid(t) => {
                let ((sx, cx), (sy, cy), (sz, cz)) = (t[0][x], t[1][y], t[2][z]);
                sx * cy + sy * cz + sz * cx
            }
            Self::MarschnerLobb(plane, along_z, row) => {
                (along_z[z] + plane[y * row + x]) / (2.0 * (1.0 + Self::ALPHA))
            }
        }
    }
}

fn swapped<const N: usize>(mut bytes: [u8; N]) -> [u8; N] {
    bytes.reverse();
    bytes
}

/// A temporary file is its owner's alone; a finished volume has the permissions of any new file.
fn readable_by_others(path: &Path) -> std::io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        File::open(path)?.set_permissions(std::fs::Permissions::from_mode(0o644))?;
    }
    #[cfg(not(unix))]
    let _ = File::open(path)?;
    Ok(())
}

fn one_of<T: Copy>(name: &str, table: &[(&str, T)]) -> Result<T> {
    table.iter().find(|(n, _)| *n == name).map(|(_, t)| *t).ok_or_else(|| {
        let names: Vec<_> = table.iter().map(|(n, _)| *n).collect();
        Error::usage(format!("{name:?} is none of {}", names.join(", ")))
    })
}

fn parse_field(name: &str) -> Result<Field> {
    let all =
        [("sphere", Field::Sphere), ("gyroid", Field::Gyroid), ("marschner-lobb", Field::MarschnerLobb)];
    one_of(name, &all)
}

fn format_of(out: &Path) -> Result<Format> {
    let ending = out.extension().and_then(|e| e.to_str()).unwrap_or("");
    let formats = [
        ("nrrd", Format::Nrrd),
        ("npy", Format::Npy),
        ("raw", Format::Raw),
        ("tifs", Format::Tiffs),
        ("zarr", Format::Zarr),
    ];
    one_of(ending, &formats).map_err(|e| Error::usage(format!("the ending of {}: {e}", out.display())))
}

fn parse_periods(text: &str) -> Result<u32> {
    text.parse()
        .ok()
        .filter(|n| (1..=1000).contains(n))
        .ok_or_else(|| Error::usage(format!("--periods {text}: expected a whole number from 1 to 1000")))
}

fn parse_dims(text: &str) -> Result<[usize; 3]> {
    let wrong = || {
        Error::usage(format!("--dims {text}: expected three whole numbers of at least 2, such as 64,64,64"))
    };
    let dims: Vec<usize> =
        text.split(',').map(|n| n.parse()).collect::<std::result::Result<_, _>>().map_err(|_| wrong())?;
    let dims: [usize; 3] = dims.try_into().map_err(|_| wrong())?;
    let bytes = dims.iter().try_fold(4usize, |product, &d| product.checked_mul(d));
    if dims.iter().any(|&d| d < 2) || bytes.is_none_or(|b| b > isize::MAX as usize) {
        return Err(wrong());
    }
    Ok(dims)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan::formats::{OpenOptions, open_volume};
    use isospan::grid::IndexBox;
    use isospan::volume::VolumeSource;

    fn settings(line: &str) -> Result<Settings> {
        Settings::parse(&line.split(' ').map(str::to_owned).collect::<Vec<_>>())
    }

    fn bytes(line: &str) -> Vec<u8> {
        let (s, mut all) = (settings(line).unwrap(), vec![]);
        s.samples(|slice| {
            all.extend(slice);
            Ok(())
        })
        .unwrap();
        all
    }

    fn floats(line: &str) -> Vec<f32> {
        bytes(line).chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
    }

    #[test]
    fn fields_have_their_known_values() {
        let s = floats("sphere --dims 5,3,7 -o a.raw");
        assert_eq!(s.len(), 105);
        assert_eq!((s[0], s[52]), (0.59, -0.16));
        // x = 0, the rest on the faces: the x axis runs fastest.
        assert_eq!(s[2], 0.34);
        let g = floats("gyroid --dims 9,9,9 --periods 1 -o a.raw");
        // (π/2, 0, 0): sin x cos y = 1, the rest 0.
        assert_eq!((g[0], g[2]), (0.0, 1.0));
        let m = floats("marschner-lobb --dims 3,3,3 -o a.raw");
        // z = -1 on the axis: (1 + 1 + ¼(1 + cos 12π)) / 2.5 = 1.
        assert_eq!((m[4], m[4 + 9]), (1.0, 0.6));
    }

    #[test]
    fn integers_cover_the_range_and_either_byte_order() {
        let u8s = bytes("sphere --dims 3,3,3 --type uint8 -o a.raw");
        assert_eq!((u8s[0], u8s[13]), (255, 0));
        let little = bytes("gyroid --dims 8,7,6 --type uint16 -o a.raw");
        let big = bytes("gyroid --dims 8,7,6 --type uint16 --endian big -o a.raw");
        assert_eq!(little.len(), 8 * 7 * 6 * 2);
        assert!(little.chunks(2).zip(big.chunks(2)).all(|(l, b)| [l[1], l[0]] == b));
    }

    #[test]
    fn bytes_are_the_same_on_every_machine() {
        // Checksums of a first run; another value means another libm, or another formula.
        for (field, expected) in [("sphere", SPHERE), ("gyroid", GYROID), ("marschner-lobb", LOBB)] {
            let got = crc32c::crc32c(&bytes(&format!("{field} --dims 41,40,39 -o a.raw")));
            assert_eq!(got, expected, "{field}: {got:#010x}");
        }
    }

    const SPHERE: u32 = 0xf3d7_4744;
    const GYROID: u32 = 0x63ac4990;
    const LOBB: u32 = 0x74c9817e;

    #[test]
    fn headers_tell_shape_type_and_place() {
        let nrrd = settings("gyroid --dims 4,5,6 --type uint16 --endian big -o a.nrrd").unwrap().header();
        let text = String::from_utf8(nrrd).unwrap();
        assert!(text.contains("sizes: 4 5 6\n") && text.contains("endian: big\n"), "{text}");
        assert!(text.ends_with("\n\n") && text.contains("type: uint16\n"), "{text}");
        let npy = settings("sphere --dims 4,5,6 -o a.npy").unwrap().header();
        assert_eq!(npy.len() % 64, 0);
        assert_eq!(usize::from(npy[8]) + 256 * usize::from(npy[9]) + 10, npy.len());
        assert!(String::from_utf8_lossy(&npy).contains("(6, 5, 4)"));
    }

    #[test]
    fn a_file_is_written_whole_under_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("s.nrrd");
        let s = settings(&format!("sphere --dims 8,7,6 --type uint8 -o {}", out.display())).unwrap();
        s.write().unwrap();
        let file = std::fs::read(&out).unwrap();
        assert_eq!(file.len(), s.header().len() + 8 * 7 * 6);
        assert!(file.ends_with(&bytes("sphere --dims 8,7,6 --type uint8 -o a.raw")));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        let nowhere = settings("sphere --dims 8,7,6 -o /nonexistent/folder/a.raw").unwrap();
        assert_eq!(nowhere.write().unwrap_err().exit_code(), 1);
    }

    #[test]
    fn the_library_reads_what_is_written() {
        let folder = tempfile::tempdir().unwrap();
        for (name, more) in
            [("a.nrrd", ""), ("b.nrrd", " --endian big"), ("c.npy", ""), ("d.npy", " --endian big")]
        {
            for kind in ["float32", "uint8", "uint16"] {
                let out = folder.path().join(name);
                let line =
                    format!("gyroid --dims 9,7,5 --periods 1 --type {kind}{more} -o {}", out.display());
                let s = settings(&line).unwrap();
                s.write().unwrap();
                let VolumeSource::Random(volume) = open_volume(&out, &OpenOptions::default()).unwrap() else {
                    panic!("{name} is not mapped");
                };
                assert_eq!(volume.info().dims, [9, 7, 5]);
                assert_eq!(volume.info().field.scalar.name(), kind);
                if s.format == Format::Nrrd {
                    let end = volume.info().geometry.to_world([8.0, 6.0, 4.0]);
                    assert!(end.iter().all(|x| (x - 2.0 * PI).abs() < 1e-9), "{end:?}");
                }
                let mut values = vec![0.0; 315];
                volume.read_box(IndexBox::whole([9, 7, 5]), &mut values).unwrap();
                let most = if kind == "uint8" { 255.0 } else { 65535.0 };
                let expected = floats("gyroid --dims 9,7,5 --periods 1 -o a.raw");
                for (v, e) in values.iter().zip(expected) {
                    let read = if kind == "float32" { *v } else { *v / most * 3.0 - 1.5 };
                    assert!((read - e).abs() <= if kind == "float32" { 0.0 } else { 1.51 / most }, "{line}");
                }
            }
        }
    }

    #[test]
    fn wrong_arguments_are_told() {
        for (line, told) in [
            ("cube --dims 4,4,4 -o a.raw", "sphere"),
            ("sphere --dims 4,4 -o a.raw", "three whole numbers"),
            ("sphere --dims 4,1,4 -o a.raw", "at least 2"),
            ("sphere --dims 4,4,4000000000000000000 -o a.raw", "three whole numbers"),
            ("sphere --dims 4,4,4 -o a.tif", "nrrd, npy, raw, tifs, zarr"),
            ("sphere --dims 4,4,4 --type i8 -o a.raw", "float32, uint8, uint16"),
            ("sphere --dims 4,4,4 --periods 0 -o a.raw", "1 to 1000"),
            ("sphere --dims 4,4,4 -o", "needs a value"),
            ("sphere --dims 4,4,4", "-o FILE is missing"),
            ("sphere gyroid --dims 4,4,4 -o a.raw", "not understood"),
        ] {
            let message = settings(line).unwrap_err().to_string();
            assert!(message.contains(told), "{line}: {message}");
        }
    }
}
