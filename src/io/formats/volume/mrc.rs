//! MRC and CCP4 maps (electron microscopy, crystallography): a binary header of 1024 bytes,
//! symmetry records or another extended header, then the samples, columns fastest.
//!
//! ```text
//!  | header, 1024 bytes | extended header, NSYMBT bytes | samples |        .mrc .map .ccp4 .rec; or all of it in .gz
//! ```
//!
//! | word, from 1 | | |
//! |---|---|---|
//! | 1 to 3 | NX, NY, NZ | columns, rows, sections |
//! | 4 | MODE | 0 `i8`, 1 `i16`, 2 `f32`, 6 `u16`, 12 `f16` |
//! | 5 to 7 | NXSTART … | number of the first column, row and section |
//! | 8 to 10 | MX, MY, MZ | samples along x, y, z of the cell |
//! | 11 to 16 | CELLA, CELLB | edges of the cell, in ångström; its angles, in degrees |
//! | 17 to 19 | MAPC, MAPR, MAPS | which axes columns, rows and sections lie along |
//! | 21 | DMAX | above 127: samples of MODE 0 are `u8`, as ITK writes them |
//! | 23 | ISPG | 0 images, 1 … a volume, 401 … a stack of volumes, MZ sections each |
//! | 24 | NSYMBT | |
//! | 39, 40 | IMOD's stamp and flags | without flag 1, its samples of MODE 0 are `u8` |
//! | 50 to 52 | ORIGIN | of x, y, z, in ångström; where all are 0, it follows from NXSTART … |
//! | 53, 54 | "MAP ", MACHST | byte order: 44 44 or 44 41 little-endian, 11 11 big-endian |
//!
//! Sample (i, j, k) is at `origin + i·c + j·r + k·s`, where c, r and s are the edges of the cell
//! along columns, rows and sections, divided by MX, MY or MZ. The cell may be oblique. MX, MY, MZ
//! and edges below 0 are errors, as for CCP-EM's mrcfile; those of 0 are not given. Where the
//! stamp names no byte order, that in which the mode is known counts. The volumes of a stack are
//! the fields `v0`, `v1`, …. Refused by name: complex numbers, samples of 4 bits, stacks of images.
//!
//! The format: Cheng et al., "MRC2014: Extensions to the MRC format header for electron cryo-
//! microscopy and tomography", J. Struct. Biol. 192 (2015). Unsigned bytes: IMOD's
//! `mrc_format.html`.

use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::header::geometry;
use crate::formats::shared::stream::{ByteSlabs, Codec, Tail, sample_bytes};
use crate::formats::shared::{OpenOptions, pick_field};
use crate::grid::Geometry;
use crate::volume::strided::StridedVolume;
use crate::volume::units::{Unit, Units};
use crate::volume::{Assumed, FieldInfo, ScalarType, VolumeInfo, VolumeSource};
use byteorder::{BE, ByteOrder, LE};
use std::io::Read;
use std::path::PathBuf;
use std::sync::Arc;

/// An MRC file or a CCP4 map.
pub(in crate::formats) struct Mrc;

static ABOUT: About = About {
    volumes: &["MRC"],
    suffixes: &[".mrc", ".mrc.gz", ".map", ".map.gz", ".ccp4", ".ccp4.gz", ".rec", ".mrcs"],
    on_servers: true,
    ..About::named("an MRC or CCP4 map")
};

impl Format for Mrc {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        has_magic(&head.bytes) || has_magic(&head.unzipped())
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let source = Arc::clone(head.file()?);
        let gzip = head.bytes.starts_with(&[0x1f, 0x8b]);
        let header = MrcHeader::read(&source, gzip)?;
        let (scalar, [dims, volumes]) = (header.scalar()?, header.dims()?);
        let count = volumes[2];
        let fields: Vec<FieldInfo> = match count {
            1 => vec![FieldInfo { name: "data".into(), scalar, components: 1 }],
            _ => (0..count).map(|n| FieldInfo { name: format!("v{n}"), scalar, components: 1 }).collect(),
        };
        Ok(Box::new(Map { source, gzip, header, dims, fields }))
    }
}

fn has_magic(head: &[u8]) -> bool {
    head.get(208..211) == Some(b"MAP") && head.get(211).is_some_and(|b| matches!(b, b' ' | 0))
}

/// Bytes of the header.
const HEADER: usize = 1024;
/// IMOD's stamp.
const IMOD: i32 = 1_146_047_817;

/// A map, or a stack of volumes.
struct Map {
    source: Arc<ByteSource>,
    gzip: bool,
    header: MrcHeader,
    dims: [u64; 3],
    /// The volumes.
    fields: Vec<FieldInfo>,
}

impl Dataset for Map {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let (path, header, dims) = (self.source.path(), &self.header, self.dims);
        let number = pick_field(path, &self.fields, options.field.as_deref())?;
        let field = self.fields[number].clone();
        let (scalar, bytes) = (field.scalar, sample_bytes(path, dims, field.scalar)?);
        let info = VolumeInfo {
            path: path.to_path_buf(),
            format: format!("MRC{}", if self.gzip { " (gzip)" } else { "" }),
            dims,
            field,
            fields: self.fields.clone(),
            geometry: header.geometry()?,
            slope: 1.0,
            intercept: 0.0,
            missing: None,
            units: Units::of_length(header.unit()),
            notes: vec![],
            data_files: vec![],
            assumed: Assumed::in_header([header.unit().is_none(); 3]),
            is_labels: false,
        };
        let offset = HEADER as u64 + header.extended()? + number as u64 * bytes;
        if self.gzip {
            let tail = if number + 1 == self.fields.len() { Tail::Nothing } else { Tail::Ignored };
            let range = 0..self.source.len();
            let slabs =
                ByteSlabs::new(info, &self.source, range, Codec::Gzip, offset, header.big_endian, tail)?;
            return Ok(VolumeSource::Stream(Box::new(slabs)));
        }
        let strides = StridedVolume::packed_strides(dims, scalar).expect("fewer than 2^63 bytes");
        let source = Arc::clone(&self.source);
        Ok(StridedVolume::new(info, source, offset, header.big_endian, strides)?.source())
    }
}

/// The header's bytes, and how to read them.
struct MrcHeader {
    path: PathBuf,
    bytes: Vec<u8>,
    big_endian: bool,
}

impl MrcHeader {
    fn read(source: &Arc<ByteSource>, gzip: bool) -> Result<Self> {
        let (path, mut bytes) = (source.path().to_path_buf(), vec![]);
        let reader: Box<dyn Read> = if gzip {
            Codec::Gzip.reader(source, 0..source.len())?
        } else {
            Box::new(source.reader(0..source.len())?)
        };
        let read = reader.take(HEADER as u64).read_to_end(&mut bytes);
        if bytes.len() < HEADER {
            let got = read.err().map_or_else(|| format!("{} bytes", bytes.len()), |e| e.to_string());
            return Err(Error::bad_input(path, "header", format!("{HEADER} bytes"), got)
                .with_help("the file is cut short or damaged"));
        }
        let big_endian = match [bytes[212], bytes[213]] {
            [0x44, 0x44 | 0x41] => false,
            [0x11, 0x11] => true,
            _ => !MODES.contains(&LE::read_i32(&bytes[12..])) && MODES.contains(&BE::read_i32(&bytes[12..])),
        };
        Ok(Self { path, bytes, big_endian })
    }

    /// The integer in a word, numbered from 1.
    fn integer(&self, word: usize) -> i32 {
        let bytes = &self.bytes[4 * (word - 1)..];
        if self.big_endian { BE::read_i32(bytes) } else { LE::read_i32(bytes) }
    }

    /// The number in a word.
    fn float(&self, word: usize) -> f64 {
        f64::from(f32::from_bits(self.integer(word) as u32))
    }

    fn integers(&self, word: usize) -> [i64; 3] {
        std::array::from_fn(|a| i64::from(self.integer(word + a)))
    }

    fn floats(&self, word: usize) -> [f64; 3] {
        std::array::from_fn(|a| self.float(word + a))
    }

    fn bad(&self, at: &str, expected: &str, got: impl Into<String>) -> Error {
        Error::bad_input(&self.path, at, expected, got)
    }

    fn scalar(&self) -> Result<ScalarType> {
        let mode = self.integer(4);
        let name = match mode {
            0 if self.is_unsigned() => return Ok(ScalarType::U8),
            0 => return Ok(ScalarType::I8),
            1 => return Ok(ScalarType::I16),
            2 => return Ok(ScalarType::F32),
            6 => return Ok(ScalarType::U16),
            12 => return Ok(ScalarType::F16),
            3 | 4 => "complex numbers",
            16 => "colours",
            101 => "samples of 4 bits",
            _ => "unknown",
        };
        let expected = "0 (int8), 1 (int16), 2 (float32), 6 (uint16) or 12 (float16)";
        Err(self
            .bad("MODE, byte 12", expected, format!("{mode} ({name})"))
            .with_help("write one number a sample"))
    }

    /// Whether bytes are from 0 to 255: IMOD says so, others by the largest sample.
    fn is_unsigned(&self) -> bool {
        match self.integer(39) {
            stamp if stamp == IMOD => self.integer(40) & 1 == 0,
            _ => self.floats(20)[1] > f64::from(i8::MAX),
        }
    }

    /// Columns, rows and sections of a volume, and how many there are along each: one, or several
    /// one after another along the sections.
    fn dims(&self) -> Result<[[u64; 3]; 2]> {
        let [nx, ny, nz] = self.integers(1);
        let list = |[x, y, z]: [i64; 3]| format!("{x} x {y} x {z}");
        let expected = "positive numbers of columns, rows and sections";
        let wrong = || self.bad("NX, NY, NZ, byte 0", expected, list([nx, ny, nz]));
        let mut dims = [0; 3];
        for (out, n) in dims.iter_mut().zip([nx, ny, nz]) {
            *out = u64::try_from(n).ok().filter(|&n| n > 0).ok_or_else(wrong)?;
        }
        let (group, mz) = (self.integer(23), i64::from(self.integer(10)));
        if group == 0 && mz == 1 && nz > 1 {
            return Err(self
                .bad("ISPG, byte 88", "a volume", "0, with one section a cell: a stack of images")
                .with_help("if it is a volume, mark it as one: set_volume() of Python's mrcfile"));
        }
        if !(401..=630).contains(&group) {
            return Ok([dims, [1; 3]]);
        }
        let each = u64::try_from(mz).ok().filter(|&mz| mz > 0 && dims[2] % mz == 0).ok_or_else(|| {
            let got = format!("{mz} for {nz} sections");
            self.bad("MZ, byte 36", "the sections of each volume of the stack", got)
        })?;
        Ok([[dims[0], dims[1], each], [1, 1, dims[2] / each]])
    }

    /// Bytes of the extended header.
    fn extended(&self) -> Result<u64> {
        let bytes = self.integer(24);
        u64::try_from(bytes).map_err(|_| self.bad("NSYMBT, byte 92", "a number of bytes", bytes.to_string()))
    }

    /// The axis of the world that columns, rows and sections lie along.
    fn axes(&self) -> Result<[usize; 3]> {
        let axes = self.integers(17);
        let mut sorted = axes;
        sorted.sort_unstable();
        match (axes, sorted) {
            // Old files leave them out.
            ([0, 0, 0], _) => Ok([0, 1, 2]),
            (_, [1, 2, 3]) => Ok(axes.map(|a| a as usize - 1)),
            _ => {
                let got = format!("{axes:?}");
                Err(self.bad("MAPC, MAPR, MAPS, byte 64", "1, 2 and 3 in any order", got))
            }
        }
    }

    /// MX, MY, MZ and the edges of the cell; 0 where they are not given.
    fn cell(&self) -> Result<([i64; 3], [f64; 3])> {
        let (samples, edges) = (self.integers(8), self.floats(11));
        let help = "correct the header, e.g. with voxel_size of Python's mrcfile";
        if let Some(n) = samples.into_iter().find(|&n| n < 0) {
            let error = self.bad("MX, MY, MZ, byte 28", "samples along a cell, not below 0", n.to_string());
            return Err(error.with_help(help));
        }
        if let Some(edge) = edges.into_iter().find(|edge| !(0.0..f64::INFINITY).contains(edge)) {
            let expected = "edges of a cell in ångström, not below 0";
            return Err(self.bad("CELLA, byte 40", expected, edge.to_string()).with_help(help));
        }
        Ok((samples, edges))
    }

    fn geometry(&self) -> Result<Geometry> {
        let (axes, (samples, edges)) = (self.axes()?, self.cell()?);
        let directions = self.directions()?;
        let spacing: [f64; 3] = std::array::from_fn(|a| match (samples[a], edges[a]) {
            // Not given.
            (0, _) | (_, 0.0) => 1.0,
            (n, edge) => edge / n as f64,
        });
        let columns = axes.map(|a| directions[a].map(|x| x * spacing[a]));
        let (mut origin, starts) = (self.floats(50), self.integers(5));
        if origin == [0.0; 3] {
            for (start, column) in starts.into_iter().zip(columns) {
                (0..3).for_each(|a| origin[a] += start as f64 * column[a]);
            }
        }
        geometry(&self.path, "the cell and its origin", origin, columns)
    }

    /// Ångström, where the header has the edges of the cell in them.
    fn unit(&self) -> Option<Unit> {
        let is_given =
            self.integers(8).into_iter().zip(self.floats(11)).all(|(n, edge)| n != 0 && edge != 0.0);
        is_given.then(|| Unit::length("Å")).flatten()
    }

    /// The directions of the edges of the cell.
    fn directions(&self) -> Result<[[f64; 3]; 3]> {
        let angles = self.floats(14);
        if angles.iter().all(|&a| a == 90.0 || a == 0.0) {
            return Ok([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        }
        let [alpha, beta, gamma] = angles.map(|a| a.to_radians());
        let (ca, cb, cg, sg) = (libm::cos(alpha), libm::cos(beta), libm::cos(gamma), libm::sin(gamma));
        let y = (ca - cb * cg) / sg;
        let z = (1.0 - cb * cb - y * y).sqrt();
        if angles.iter().all(|&a| 0.0 < a && a < 180.0) && z > 1e-6 {
            return Ok([[1.0, 0.0, 0.0], [cg, sg, 0.0], [cb, y, z]]);
        }
        let got = format!("{}, {}, {}", angles[0], angles[1], angles[2]);
        Err(self.bad("CELLB, byte 52", "angles of a cell, in degrees", got))
    }
}

/// Known modes.
const MODES: [i32; 9] = [0, 1, 2, 3, 4, 6, 12, 16, 101];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::open_volume;
    use crate::formats::tests::{read_all, torture, write};
    use std::io::Write as _;

    /// A map whose header has these words, and as many bytes of samples.
    fn map(big: bool, words: &[(usize, u32)], data: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; HEADER];
        let word = |n: u32| if big { n.to_be_bytes() } else { n.to_le_bytes() };
        let usual =
            [(1, 4), (2, 3), (3, 2), (4, 1), (8, 4), (9, 3), (10, 2), (17, 1), (18, 2), (19, 3), (23, 1)];
        for &(at, n) in usual.iter().chain(words) {
            bytes[4 * (at - 1)..4 * at].copy_from_slice(&word(n));
        }
        bytes[208..212].copy_from_slice(b"MAP ");
        bytes[212..214].copy_from_slice(if big { &[0x11; 2] } else { &[0x44; 2] });
        bytes.extend(data);
        bytes
    }

    fn shorts(big: bool) -> Vec<u8> {
        (0..24i16).flat_map(|i| if big { (i - 5).to_be_bytes() } else { (i - 5).to_le_bytes() }).collect()
    }

    fn float(x: f32) -> u32 {
        x.to_bits()
    }

    #[test]
    fn samples_of_both_byte_orders_mapped_and_packed() {
        let dir = tempfile::tempdir().unwrap();
        let expected: Vec<f32> = (0..24).map(|i| (i - 5) as f32).collect();
        for big in [false, true] {
            // Eight bytes of an extended header, and a stamp that says nothing.
            for (extra, stamp) in [(0, true), (8, false)] {
                let mut file = map(big, &[(24, extra)], &[vec![0; extra as usize], shorts(big)].concat());
                if !stamp {
                    file[212..214].fill(0);
                }
                let (info, values) =
                    read_all(open_volume(&write(&dir, "a.mrc", &file), &OpenOptions::default()).unwrap());
                assert_eq!((info.dims, info.field.scalar, &values), ([4, 3, 2], ScalarType::I16, &expected));
                let mut packed = flate2::write::GzEncoder::new(vec![], flate2::Compression::fast());
                packed.write_all(&file).unwrap();
                let path = write(&dir, "emd_1.map.gz", &packed.finish().unwrap());
                let (info, values) = read_all(open_volume(&path, &OpenOptions::default()).unwrap());
                assert_eq!((&*info.format, values), ("MRC (gzip)", expected.clone()));
            }
        }
    }

    #[test]
    fn every_mode() {
        let dir = tempfile::tempdir().unwrap();
        for (words, scalar, sample, value) in [
            (&[(4, 0)][..], ScalarType::I8, &[0xfe][..], -2.0),
            (&[(4, 0), (39, IMOD as u32)], ScalarType::U8, &[0xfe], 254.0),
            (&[(4, 0), (39, IMOD as u32), (40, 1)], ScalarType::I8, &[0xfe], -2.0),
            (&[(4, 0), (21, float(254.0))], ScalarType::U8, &[0xfe], 254.0),
            (&[(4, 0), (20, float(-2.0)), (21, float(127.0))], ScalarType::I8, &[0xfe], -2.0),
            (&[(4, 2)], ScalarType::F32, &[0, 0, 0x20, 0xc0], -2.5),
            (&[(4, 6)], ScalarType::U16, &[0xff, 0xff], 65535.0),
            (&[(4, 12)], ScalarType::F16, &[0, 0xc1], -2.5),
        ] {
            let file = map(false, words, &sample.repeat(24));
            let (info, values) =
                read_all(open_volume(&write(&dir, "a.mrc", &file), &OpenOptions::default()).unwrap());
            assert_eq!((info.field.scalar, values), (scalar, vec![value; 24]));
        }
    }

    #[test]
    fn cells_are_placed() {
        let dir = tempfile::tempdir().unwrap();
        let info = |words: &[(usize, u32)]| {
            let file = map(false, words, &shorts(false));
            open_volume(&write(&dir, "a.mrc", &file), &OpenOptions::default()).unwrap().info().clone()
        };
        let place = |words: &[(usize, u32)]| info(words).geometry;
        let cell = [
            (11, float(8.0)),
            (12, float(4.5)),
            (13, float(1.0)),
            (14, float(90.0)),
            (15, float(90.0)),
            (16, float(90.0)),
        ];
        let g = place(&cell);
        assert_eq!((g.spacing, g.origin), ([2.0, 1.5, 0.5], [0.0; 3]));
        assert_eq!(info(&cell).units, Units::of_length(Unit::length("Å")));
        assert_eq!(info(&[]).units, Units::default(), "there is no cell");
        // From the numbers of the first samples, unless there is an origin.
        let starts = [&cell[..], &[(5, 10), (6, -2i32 as u32), (7, 3)]].concat();
        assert_eq!(place(&starts).origin, [20.0, -3.0, 1.5]);
        let origin = [&starts[..], &[(50, float(7.0))]].concat();
        assert_eq!(place(&origin).origin, [7.0, 0.0, 0.0]);
        // Columns along z, rows along x, sections along y; starts are theirs.
        let turned = [&starts[..], &[(17, 3), (18, 1), (19, 2)]].concat();
        let g = place(&turned);
        assert_eq!((g.to_world([1.0, 0.0, 0.0])[2] - g.origin[2], g.spacing), (0.5, [0.5, 2.0, 1.5]));
        assert_eq!(g.origin, [-4.0, 4.5, 5.0]);
        // An oblique cell: γ of 120°, as in hexagonal crystals.
        let oblique = [&cell[..], &[(16, float(120.0))]].concat();
        let p = place(&oblique).to_world([0.0, 2.0, 0.0]);
        assert!((p[0] + 1.5).abs() < 1e-6 && (p[1] - 3.0 * 0.75f64.sqrt()).abs() < 1e-6, "{p:?}");
        // Nothing is said.
        assert_eq!(place(&[(8, 0), (9, 0), (10, 0), (17, 0), (18, 0), (19, 0)]).spacing, [1.0; 3]);
    }

    #[test]
    fn volumes_of_a_stack_are_fields() {
        let dir = tempfile::tempdir().unwrap();
        let file = map(false, &[(23, 401), (10, 1)], &shorts(false));
        let path = write(&dir, "a.mrc", &file);
        let choose = |name: &str| OpenOptions { field: Some(name.into()), ..OpenOptions::default() };
        let (info, values) = read_all(open_volume(&path, &choose("v1")).unwrap());
        assert_eq!((info.dims, values), ([4, 3, 1], (7..19).map(|i| i as f32).collect()));
        assert_eq!(open_volume(&path, &OpenOptions::default()).err().unwrap().exit_code(), 2);
        let bad = map(false, &[(23, 401), (10, 3)], &shorts(false));
        let error = open_volume(&write(&dir, "b.mrc", &bad), &OpenOptions::default()).err().unwrap();
        assert!(error.to_string().contains("3 for 2 sections"), "{error}");
    }

    #[test]
    fn what_is_not_read_is_named() {
        let dir = tempfile::tempdir().unwrap();
        for (words, message) in [
            (&[(4, 4)][..], "complex"),
            (&[(4, 101)], "4 bits"),
            (&[(4, 77)], "unknown"),
            (&[(1, 0)], "0 x 3 x 2"),
            (&[(3, -1i32 as u32)], "4 x 3 x -1"),
            (&[(1, 1 << 30), (2, 1 << 30)], "samples"),
            (&[(23, 0), (10, 1)], "a stack of images"),
            (&[(24, -8i32 as u32)], "NSYMBT"),
            (&[(24, 8)], "cut short"),
            (&[(17, 2)], "MAPC"),
            (
                &[(11, float(f32::NAN))],
                "CELLA, byte 40: expected edges of a cell in ångström, not below 0, got NaN",
            ),
            (&[(12, float(-4.5))], "CELLA, byte 40"),
            (&[(13, float(f32::INFINITY))], "CELLA, byte 40"),
            (&[(9, -3i32 as u32)], "MX, MY, MZ, byte 28"),
            (&[(14, float(10.0)), (15, float(100.0)), (16, float(20.0))], "CELLB"),
        ] {
            let error = open_volume(
                &write(&dir, "a.mrc", &map(false, words, &shorts(false))),
                &OpenOptions::default(),
            );
            let error = error.err().expect(message);
            assert!(error.to_string().contains(message) && error.exit_code() == 5, "{message}: {error}");
        }
        let file = map(false, &[], &shorts(false));
        torture("a.mrc", &file, file.len());
    }
}
