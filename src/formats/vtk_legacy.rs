//! Legacy VTK files (`.vtk`): structured points as volumes.
//!
//! ```text
//! # vtk DataFile Version 3.0
//! a title
//! BINARY                               or ASCII
//! DATASET STRUCTURED_POINTS
//! DIMENSIONS 76 49 45
//! SPACING 1 1 1                        ASPECT_RATIO in old files
//! ORIGIN 100 80 1
//! POINT_DATA 167580
//! SCALARS speed float                  name, type, number of components
//! LOOKUP_TABLE default
//! …                                    big-endian numbers, or text
//! VECTORS velocity float
//! …
//! FIELD attributes 1
//! pressure 1 167580 float              name, components, tuples, type
//! …
//! ```
//!
//! A file has no table of contents: to find an array, all before it are gone over, by their lengths in a binary file,
//! word by word in a text. Binary samples are then mapped where they lie; text is a stream of slabs. Keywords may be
//! in any case, names are percent-encoded.
//!
//! **Fields** are the arrays of the point data. Without `--field` the one array under `SCALARS` is read where there is
//! exactly one with one component (VTK's writer puts the active scalars there and all others under `FIELD`), else the
//! only array with one component.
//!
//! A `long` is taken to have 8 bytes, as on every 64-bit Unix; `char` is signed; a binary `vtkIdType` is stored in 4
//! bytes, whatever it has in memory. Arrays of bits and strings are passed over.

use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::formats::stream::{TextSlabs, sample_bytes};
use crate::formats::text::Words;
use crate::formats::{OpenOptions, header, pick_field};
use crate::volume::strided::StridedVolume;
use crate::volume::{FieldInfo, ScalarType, VolumeInfo, VolumeSource};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// Opens the structured points of a legacy VTK file.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file, another kind of dataset, cell data, bits;
/// [`Error::Usage`] when several fields ask for a choice.
pub fn open(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    open_source(&Arc::new(ByteSource::open(path, options.io)?), options.field.as_deref())
}

fn open_source(source: &Arc<ByteSource>, wanted: Option<&str>) -> Result<VolumeSource> {
    let path = source.path();
    let file = Scanner::new(path, source.slice(0..source.len())?)?.scan()?;
    let fields: Vec<FieldInfo> = file.arrays.iter().filter_map(Array::field).collect();
    let readable: Vec<&Array> = file.arrays.iter().filter(|a| a.field().is_some()).collect();
    let chosen = choose(path, &file, &readable, &fields, wanted)?;
    let info = VolumeInfo {
        path: path.to_path_buf(),
        format: format!("legacy VTK structured points ({})", if file.binary { "binary" } else { "ascii" }),
        dims: file.dims,
        field: fields[chosen].clone(),
        fields,
        geometry: header::geometry(path, "ORIGIN, SPACING", file.origin, header::scaled_axes(file.spacing))?,
        slope: 1.0,
        intercept: 0.0,
        missing: None,
        data_files: vec![],
    };
    let data = readable[chosen].data.clone();
    if !file.binary {
        return Ok(VolumeSource::Stream(Box::new(TextSlabs::new(info, Arc::clone(source), data)?)));
    }
    sample_bytes(path, info.dims, info.field.scalar)?;
    let strides = StridedVolume::packed_strides(info.dims, info.field.scalar);
    let strides = strides.expect("the size of the samples was checked");
    let volume = StridedVolume::new(info, Arc::clone(source), data.start, true, strides)?;
    Ok(VolumeSource::Random(Box::new(volume)))
}

/// The index of the field to read.
fn choose(
    path: &Path,
    file: &Scanned,
    readable: &[&Array],
    fields: &[FieldInfo],
    wanted: Option<&str>,
) -> Result<usize> {
    let refuse = |got: String, help: &str| {
        let expected = match wanted {
            Some(name) => format!("an array '{name}' of numbers"),
            None => "an array of numbers".into(),
        };
        Err(Error::bad_input(path, "POINT_DATA", expected, got).with_help(help))
    };
    let missing = |name: &str| !fields.iter().any(|f| f.name == name);
    if let Some(name) = wanted.filter(|name| missing(name)) {
        if file.arrays.iter().any(|a| a.name == name) {
            return refuse("one of bits or strings".into(), "write it as unsigned_char");
        }
        if file.cell_arrays.iter().any(|a| a == name) {
            return refuse("cell data of that name".into(), "convert cell data to point data first");
        }
    }
    if fields.is_empty() && !file.cell_arrays.is_empty() {
        let got = format!("cell data only: {}", file.cell_arrays.join(", "));
        return refuse(got, "convert cell data to point data first");
    }
    let active = |i: &usize| readable[*i].is_scalars && fields[*i].components == 1;
    let active: Vec<usize> = (0..fields.len()).filter(active).collect();
    match (wanted, &active[..]) {
        (None, &[only]) => Ok(only),
        _ => pick_field(path, fields, wanted),
    }
}

/// A type name of the format.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Type {
    Number(ScalarType),
    Bit,
    Text,
}

impl Type {
    fn from_name(name: &str, binary: bool) -> Option<Self> {
        use ScalarType::{F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
        Some(Self::Number(match name.to_ascii_lowercase().as_str() {
            "unsigned_char" => U8,
            "char" | "signed_char" => I8,
            "unsigned_short" => U16,
            "short" => I16,
            "unsigned_int" => U32,
            "int" => I32,
            // VTK writes binary ids as int; a text has them whole.
            "vtkidtype" if binary => I32,
            "vtkidtype" => I64,
            "unsigned_long" | "vtktypeuint64" => U64,
            "long" | "vtktypeint64" => I64,
            "float" => F32,
            "double" => F64,
            "bit" => return Some(Self::Bit),
            "string" | "utf8_string" => return Some(Self::Text),
            _ => return None,
        }))
    }
}

/// An array and the bytes where its data lie.
#[derive(Debug)]
struct Array {
    name: String,
    kind: Type,
    components: u64,
    /// Whether it stood under SCALARS.
    is_scalars: bool,
    data: Range<u64>,
}

impl Array {
    /// What a volume can tell of it.
    fn field(&self) -> Option<FieldInfo> {
        match self.kind {
            Type::Number(scalar) => {
                let components = u32::try_from(self.components).ok()?;
                Some(FieldInfo { name: self.name.clone(), scalar, components })
            }
            _ => None,
        }
    }
}

/// What a file holds.
#[derive(Debug, Default)]
struct Scanned {
    binary: bool,
    dims: [u64; 3],
    origin: [f64; 3],
    spacing: [f64; 3],
    /// Arrays of the point data.
    arrays: Vec<Array>,
    /// Names of arrays of the cell data.
    cell_arrays: Vec<String>,
}

/// What the arrays that follow belong to.
#[derive(Clone, Copy, PartialEq)]
enum Section {
    /// The file, before any data.
    File,
    Points(u64),
    Cells(u64),
}

/// Goes over a file from front to back.
struct Scanner<'a> {
    path: &'a Path,
    words: Words<'a>,
    out: Scanned,
    section: Section,
}

impl<'a> Scanner<'a> {
    /// Reads the first four lines.
    fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        let mut words = Words::new(path, bytes, 0);
        if !bytes.starts_with(b"# vtk DataFile Version") {
            let expected = "'# vtk DataFile Version' and a number";
            return Err(Error::bad_input(path, "line 1", expected, "something else"));
        }
        words.line();
        words.line();
        let binary = match words.word("ASCII or BINARY")?.to_ascii_lowercase().as_str() {
            "ascii" => false,
            "binary" => true,
            other => return Err(words.wrong("ASCII or BINARY", format!("'{other}'"))),
        };
        let word = words.word("DATASET")?;
        if !word.eq_ignore_ascii_case("DATASET") {
            return Err(words.wrong("DATASET STRUCTURED_POINTS", format!("'{word}'")));
        }
        let kind = words.word("STRUCTURED_POINTS")?;
        if !kind.eq_ignore_ascii_case("STRUCTURED_POINTS") {
            return Err(words
                .wrong("DATASET STRUCTURED_POINTS", format!("DATASET {kind}"))
                .with_help("only structured points are read as a volume: resample or convert it first"));
        }
        let out = Scanned { binary, spacing: [1.0; 3], ..Scanned::default() };
        Ok(Self { path, words, out, section: Section::File })
    }

    fn scan(mut self) -> Result<Scanned> {
        while let Some(word) = self.words.next() {
            let keyword = String::from_utf8_lossy(word).to_ascii_uppercase();
            match (keyword.as_str(), self.section) {
                ("DIMENSIONS", Section::File) => self.out.dims = self.three("a dimension")?,
                ("SPACING" | "ASPECT_RATIO", Section::File) => self.out.spacing = self.three("a spacing")?,
                ("ORIGIN", Section::File) => self.out.origin = self.three("a coordinate")?,
                ("POINT_DATA", _) => self.section = Section::Points(self.samples()?),
                ("CELL_DATA", _) => self.section = Section::Cells(self.words.parse("a number of cells")?),
                ("METADATA", _) => self.skip_metadata(),
                ("FIELD", _) => self.field()?,
                (name, Section::Points(n) | Section::Cells(n)) => self.attribute(name, n)?,
                (name, Section::File) => {
                    let expected = "DIMENSIONS, SPACING, ORIGIN, POINT_DATA or CELL_DATA";
                    return Err(self.wrong(expected, format!("'{name}'")));
                }
            }
        }
        if self.out.dims == [0; 3] {
            return Err(self.wrong("DIMENSIONS", "the end of the file".into()));
        }
        Ok(self.out)
    }

    fn three<T: std::str::FromStr + Copy + Default>(&mut self, what: &str) -> Result<[T; 3]> {
        let mut out = [T::default(); 3];
        for x in &mut out {
            *x = self.words.parse(what)?;
        }
        Ok(out)
    }

    /// The number after POINT_DATA, which is that of the samples.
    fn samples(&mut self) -> Result<u64> {
        let n: u64 = self.words.parse("a number of points")?;
        let d = self.out.dims;
        sample_bytes(self.path, d, ScalarType::U8)?;
        if n != d[0] * d[1] * d[2] {
            let expected = format!("POINT_DATA {} for {} x {} x {}", d[0] * d[1] * d[2], d[0], d[1], d[2]);
            return Err(self.words.wrong(expected, n.to_string()));
        }
        Ok(n)
    }

    /// Lines up to an empty one.
    fn skip_metadata(&mut self) {
        self.words.line();
        while self.words.line().is_some_and(|line| !line.trim().is_empty()) {}
    }

    /// An attribute of `n` points or cells.
    fn attribute(&mut self, keyword: &str, n: u64) -> Result<()> {
        match keyword {
            "SCALARS" => self.scalars(n),
            "COLOR_SCALARS" => self.colors(n),
            "LOOKUP_TABLE" => self.table(),
            "TEXTURE_COORDINATES" => {
                let name = self.name()?;
                let components = self.words.parse("a number of components")?;
                self.rest(name, components, n)
            }
            "VECTORS" | "NORMALS" => self.plain(3, n),
            "TENSORS" => self.plain(9, n),
            "TENSORS6" => self.plain(6, n),
            "GLOBAL_IDS" | "PEDIGREE_IDS" | "EDGE_FLAGS" => self.plain(1, n),
            other => Err(self.wrong("an attribute, such as SCALARS or FIELD", format!("'{other}'"))),
        }
    }

    fn name(&mut self) -> Result<String> {
        Ok(decode(self.words.word("a name")?))
    }

    fn kind(&mut self) -> Result<Type> {
        let name = self.words.word("a type")?;
        Type::from_name(name, self.out.binary).ok_or_else(|| {
            self.wrong("a type: unsigned_char, short, int, float, double, …", format!("'{name}'"))
        })
    }

    /// A name, a type, and the data of `n` tuples.
    fn plain(&mut self, components: u64, n: u64) -> Result<()> {
        let name = self.name()?;
        self.rest(name, components, n)
    }

    fn rest(&mut self, name: String, components: u64, n: u64) -> Result<()> {
        let kind = self.kind()?;
        self.words.line();
        self.array(name, kind, components, n, n, false)
    }

    fn scalars(&mut self, n: u64) -> Result<()> {
        let (name, kind) = (self.name()?, self.kind()?);
        let line = self.words.line().unwrap_or_default();
        let components = match line.trim() {
            "" => 1,
            text => match text.parse() {
                Ok(components) => components,
                Err(_) => return Err(self.wrong("a number of components", format!("'{text}'"))),
            },
        };
        let word = self.words.word("LOOKUP_TABLE and a name")?;
        if !word.eq_ignore_ascii_case("LOOKUP_TABLE") {
            return Err(self.wrong("LOOKUP_TABLE and a name", format!("'{word}'")));
        }
        self.words.line();
        self.array(name, kind, components, n, n, true)
    }

    /// Numbers from 0 to 1 in a text, bytes in a binary file.
    fn colors(&mut self, n: u64) -> Result<()> {
        let name = self.name()?;
        let components = self.words.parse("a number of components")?;
        self.words.line();
        let scalar = if self.out.binary { ScalarType::U8 } else { ScalarType::F32 };
        self.array(name, Type::Number(scalar), components, n, n, false)
    }

    /// A table of colours, four numbers each, which is no field.
    fn table(&mut self) -> Result<()> {
        let name = self.name()?;
        let colors: u64 = self.words.parse("a number of colours")?;
        self.words.line();
        self.data(&name, Type::Number(ScalarType::U8), 4, colors)?;
        Ok(())
    }

    /// Arrays of any length; those of a tuple for each point are fields.
    fn field(&mut self) -> Result<()> {
        self.words.word("a name")?;
        let arrays: u64 = self.words.parse("a number of arrays")?;
        for _ in 0..arrays {
            let mut name = self.words.word("the name of an array")?;
            // The METADATA of the array before.
            while name == "METADATA" {
                self.skip_metadata();
                name = self.words.word("the name of an array")?;
            }
            // VTK leaves out the rest of an array that it does not have.
            if name == "NULL_ARRAY" {
                continue;
            }
            let components = self.words.parse("a number of components")?;
            let tuples = self.words.parse("a number of tuples")?;
            let kind = self.kind()?;
            self.words.line();
            let n = match self.section {
                Section::File => 0,
                Section::Points(n) | Section::Cells(n) => n,
            };
            self.array(decode(name), kind, components, tuples, n, false)?;
        }
        Ok(())
    }

    /// Goes over the data of an array and notes it where it has a tuple for each of the `n` points or cells.
    fn array(
        &mut self,
        name: String,
        kind: Type,
        components: u64,
        tuples: u64,
        n: u64,
        is_scalars: bool,
    ) -> Result<()> {
        let data = self.data(&name, kind, components, tuples)?;
        match self.section {
            Section::Points(_) if tuples == n && components > 0 => {
                self.out.arrays.push(Array { name, kind, components, is_scalars, data });
            }
            Section::Cells(_) => self.out.cell_arrays.push(name),
            _ => {}
        }
        Ok(())
    }

    /// Goes over numbers that begin here, and tells where they lie.
    fn data(&mut self, name: &str, kind: Type, components: u64, tuples: u64) -> Result<Range<u64>> {
        let start = self.words.at() as u64;
        let count = components.checked_mul(tuples);
        let gone = count.and_then(|count| match (self.out.binary, kind) {
            (true, Type::Number(scalar)) => {
                self.words.take(count.checked_mul(scalar.bytes() as u64)?).map(drop)
            }
            (true, Type::Bit) => self.words.take(count.div_ceil(8)).map(drop),
            (true, Type::Text) => (0..count).try_for_each(|_| self.skip_string()),
            (false, Type::Text) => (0..count).try_for_each(|_| self.words.line().map(drop)),
            (false, _) => (0..count).try_for_each(|_| self.words.next().map(drop)),
        });
        if gone.is_none() {
            let expected = format!("{components} x {tuples} values of '{name}'");
            return Err(Error::bad_input(
                self.path,
                format!("byte {start}"),
                expected,
                "the end of the file",
            )
            .with_help("the file is cut short, or its header is wrong"));
        }
        Ok(start..self.words.at() as u64)
    }

    /// A binary string: the two highest bits of its first byte tell how wide its length is.
    fn skip_string(&mut self) -> Option<()> {
        let first = *self.words.rest().first()?;
        let width = [8, 4, 2, 1][usize::from(first >> 6)];
        let bytes = self.words.take(width)?;
        let length = bytes.iter().fold(0u64, |length, &b| length << 8 | u64::from(b));
        // The two highest bits of all are not the length's.
        let tag_bits = 8 * width as u32 - 2;
        self.words.take(length & ((1 << tag_bits) - 1)).map(drop)
    }

    /// An error at the last word, by line in a text and by byte in a binary file.
    fn wrong(&self, expected: &str, got: String) -> Error {
        match self.out.binary {
            true => Error::bad_input(self.path, format!("byte {}", self.words.at()), expected, got),
            false => self.words.wrong(expected, got),
        }
    }
}

/// Undoes the percent-encoding of a name.
fn decode(name: &str) -> String {
    let (bytes, mut out, mut at) = (name.as_bytes(), vec![], 0);
    while at < bytes.len() {
        let code = bytes.get(at + 1..at + 3).filter(|_| bytes[at] == b'%');
        let code =
            code.and_then(|c| std::str::from_utf8(c).ok()).and_then(|c| u8::from_str_radix(c, 16).ok());
        out.push(code.unwrap_or(bytes[at]));
        at += if code.is_some() { 3 } else { 1 };
    }
    String::from_utf8_lossy(&out).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::surface::tests::survive;
    use crate::formats::tests::{read_all, try_read_all};
    use crate::formats::vtk_xml::tests::{range, shared};

    const TEXT_HEAD: &str = "# vtk DataFile Version 4.2\ntitle BINARY\nASCII\nDATASET STRUCTURED_POINTS\n\
        FIELD FieldData 1\nTIME 1 1 double\n0.5\nDIMENSIONS 4 3 2\nSPACING 0.5 2 4\nORIGIN 1 2 3\n";

    /// 4 x 3 x 2 samples; x counts ones, y tens, z hundreds.
    fn expected() -> Vec<f32> {
        let value = |i: usize| (i % 4 + 10 * (i / 4 % 3) + 100 * (i / 12)) as f32;
        (0..24).map(value).collect()
    }

    /// A file of attributes of every kind: before, between and after the two arrays to read.
    struct Fixture {
        binary: bool,
        bytes: Vec<u8>,
    }

    impl Fixture {
        fn new(binary: bool) -> Self {
            let mut this = Self { binary, bytes: vec![] };
            let head = "# vtk DataFile Version 4.2\nti\u{e9}tle\nASCII\nDATASET STRUCTURED_POINTS\n";
            this.text(&if binary { head.replace("ASCII", "Binary") } else { head.into() });
            this.text("FIELD FieldData 2\nTIME 1 1 double\n");
            this.numbers(&[0.5], |v| v.to_be_bytes().to_vec());
            this.text("METADATA\nINFORMATION 0\n\nNULL_ARRAY\n");
            this.text("DIMENSIONS 4 3 2\nspacing 0.5 2 4\nORIGIN 1 2 3\n");
            this.text("CELL_DATA 6\nSCALARS cells short\nLOOKUP_TABLE default\n");
            this.numbers(&[7.0; 6], |v| (v as i16).to_be_bytes().to_vec());
            this.text("POINT_DATA 24\n");
            this
        }

        fn text(&mut self, text: &str) {
            self.bytes.extend(text.as_bytes());
        }

        fn numbers(&mut self, values: &[f64], stored: impl Fn(f64) -> Vec<u8>) {
            if self.binary {
                self.bytes.extend(values.iter().flat_map(|&v| stored(v)));
            } else {
                let words: Vec<String> = values.iter().map(ToString::to_string).collect();
                self.bytes.extend(words.join(" ").into_bytes());
            }
            self.bytes.push(b'\n');
        }

        fn floats(&mut self, values: &[f64]) {
            self.numbers(values, |v| (v as f32).to_be_bytes().to_vec());
        }

        fn bytes(&mut self, values: &[f64]) {
            self.numbers(values, |v| vec![v as u8]);
        }
    }

    fn rich(binary: bool) -> Vec<u8> {
        let mut f = Fixture::new(binary);
        let values: Vec<f64> = expected().into_iter().map(f64::from).collect();
        f.text("VECTORS v float\n");
        f.floats(&[1.25; 72]);
        f.text("METADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 0 1\n\n");
        f.text("SCALARS two%20w%25rds unsigned_short 1\nLOOKUP_TABLE mine\n");
        f.numbers(&values, |v| (v as u16).to_be_bytes().to_vec());
        f.text("LOOKUP_TABLE mine 2\n");
        f.bytes(&[0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0]);
        f.text("COLOR_SCALARS colors 2\n");
        f.bytes(&[1.0; 48]);
        f.text("TENSORS t double\n");
        f.numbers(&[3.0; 216], |v| v.to_be_bytes().to_vec());
        f.text("TEXTURE_COORDINATES uv 2 float\n");
        f.floats(&[0.5; 48]);
        f.text("NORMALS n float\n");
        f.floats(&[0.5; 72]);
        f.text("FIELD FieldData 4\nbits 1 24 bit\n");
        match binary {
            true => f.bytes(&[255.0; 3]),
            false => f.bytes(&[1.0; 24]),
        }
        f.text("short 1 3 int\n");
        f.numbers(&[1.0; 3], |v| (v as i32).to_be_bytes().to_vec());
        f.text("words 1 24 string\n");
        for i in 0..24 {
            let word = "x".repeat(if i == 5 { 100 } else { i });
            match (binary, word.len()) {
                (true, 100) => f.bytes.extend([0x80, 100]),
                (true, n) => f.bytes.push(0xc0 | n as u8),
                _ => {}
            }
            f.text(&word);
            if !binary {
                f.text("\n");
            }
        }
        f.text("\nlast 1 24 double\n");
        let eighths: Vec<f64> = values.iter().map(|v| v / 8.0).collect();
        f.numbers(&eighths, |v| v.to_be_bytes().to_vec());
        f.text("METADATA\nINFORMATION 0\n\n");
        f.bytes
    }

    fn open_bytes(bytes: &[u8], field: Option<&str>) -> Result<VolumeSource> {
        open_source(&Arc::new(ByteSource::from_vec("f.vtk", bytes.to_vec())), field)
    }

    #[test]
    fn every_attribute_is_gone_over() {
        for binary in [false, true] {
            let source = open_bytes(&rich(binary), None).unwrap();
            assert_eq!(matches!(source, VolumeSource::Random(_)), binary);
            let (info, values) = read_all(source);
            assert_eq!((info.dims, &info.field.name[..]), ([4, 3, 2], "two w%rds"));
            assert_eq!((values, info.field.scalar), (expected(), ScalarType::U16), "binary: {binary}");
            assert_eq!(info.geometry.to_world([1.0, 1.0, 1.0]), [1.5, 4.0, 7.0]);
            let names: Vec<(&str, u32)> = info.fields.iter().map(|f| (&f.name[..], f.components)).collect();
            let listed =
                [("v", 3), ("two w%rds", 1), ("colors", 2), ("t", 9), ("uv", 2), ("n", 3), ("last", 1)];
            assert_eq!(names, listed);
            let (_, last) = read_all(open_bytes(&rich(binary), Some("last")).unwrap());
            assert_eq!(last, expected().iter().map(|v| v / 8.0).collect::<Vec<_>>());
        }
    }

    #[test]
    fn every_type_is_read() {
        use ScalarType::{F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
        let be = |scalar: ScalarType, v: i64| match scalar {
            F32 => (v as f32).to_be_bytes().to_vec(),
            F64 => (v as f64).to_be_bytes().to_vec(),
            _ => v.to_be_bytes()[8 - scalar.bytes()..].to_vec(),
        };
        let check = |name: &str, scalar: ScalarType, binary: bool| {
            let low = if matches!(scalar, U8 | U16 | U32 | U64) { 1 } else { -2 };
            let mut f = Fixture::new(binary);
            f.text(&format!("SCALARS s {name}\nlookup_table default\n"));
            let values: Vec<f64> = (0..24).map(|i| f64::from(low + i)).collect();
            f.numbers(&values, |v| be(scalar, v as i64));
            let (info, found) = read_all(open_bytes(&f.bytes, None).unwrap());
            assert_eq!(info.field.scalar, scalar, "{name}");
            assert_eq!(found, values.iter().map(|&v| v as f32).collect::<Vec<_>>(), "{name}");
        };
        for (name, scalar) in [
            ("unsigned_char", U8),
            ("char", I8),
            ("signed_char", I8),
            ("unsigned_short", U16),
            ("short", I16),
            ("unsigned_int", U32),
            ("int", I32),
            ("unsigned_long", U64),
            ("long", I64),
            ("vtktypeuint64", U64),
            ("vtktypeint64", I64),
            ("float", F32),
            ("Double", F64),
        ] {
            check(name, scalar, false);
            check(name, scalar, true);
        }
        check("vtkIdType", I64, false);
        check("vtkIdType", I32, true);
    }

    fn refused(bytes: &[u8], field: Option<&str>) -> String {
        let error = open_bytes(bytes, field).and_then(try_read_all).expect_err("the file is refused");
        assert!(matches!(error.exit_code(), 2 | 5));
        error.to_string()
    }

    #[test]
    fn the_field_is_chosen_or_asked_for() {
        let text = String::from_utf8(rich(false)).unwrap();
        for (field, says) in
            [("cells", "cell data of that name"), ("bits", "bits or strings"), ("v", "no scalar field v")]
        {
            assert!(refused(text.as_bytes(), Some(field)).contains(says));
        }
        let several =
            text.replace("SCALARS two", "GLOBAL_IDS two").replace("short 1\nLOOKUP_TABLE mine", "short");
        assert!(refused(several.as_bytes(), None).contains("two w%rds (u16), colors (2 x f32"));
        let cells = Fixture::new(false).bytes;
        assert!(refused(&cells, None).contains("cell data only: cells"));
    }

    #[test]
    fn malformed_files_are_refused() {
        let good =
            format!("{TEXT_HEAD}POINT_DATA 24\nSCALARS s int\nLOOKUP_TABLE default\n{}", "7 ".repeat(24));
        assert!(open_bytes(good.as_bytes(), None).is_ok());
        for (from, to, says) in [
            ("# vtk", "# VTK", "line 1"),
            ("ASCII", "EBCDIC", "line 3: expected ASCII or BINARY"),
            ("DATASET", "DATA", "line 4"),
            ("STRUCTURED_POINTS", "STRUCTURED_GRID", "got DATASET STRUCTURED_GRID"),
            ("DATASET STRUCTURED_POINTS", "FIELD FieldData 1", "'FIELD'"),
            ("DIMENSIONS 4 3 2", "DIMENSIONS 4 3", "line 9: expected a dimension"),
            ("DIMENSIONS 4 3 2", "DIMENSIONS 4 3 0", "at least one sample"),
            ("DIMENSIONS 4 3 2", "DIMENSIONS 4 3 3", "POINT_DATA 36"),
            ("DIMENSIONS 4 3 2", "DIMENSIONS 9999999999 9999999999 2", "fewer than 2^63"),
            ("SPACING 0.5", "SPACING 0", "span space"),
            ("ORIGIN", "ORIGINAL", "'ORIGINAL'"),
            ("int", "quaternion", "'quaternion'"),
            ("int", "int x", "a number of components"),
            ("int", "int 2", "2 x 24 values of 's'"),
            ("LOOKUP_TABLE", "TABLE", "LOOKUP_TABLE and a name"),
            ("7 7", "7", "1 x 24 values"),
            ("7 7", "7 7 7", "an attribute"),
            ("7 7", "7 7.5", "a number of type i32"),
        ] {
            let bad = good.replacen(from, to, 1);
            assert_ne!(good, bad, "{from}");
            let error = refused(bad.as_bytes(), None);
            assert!(error.contains(says), "{says}: {error}");
        }
    }

    #[test]
    fn damage_does_not_panic() {
        for binary in [false, true] {
            survive(&rich(binary), |b| drop(open_bytes(b, None).and_then(try_read_all)));
        }
    }

    #[test]
    fn a_cut_within_the_data_is_an_error() {
        for binary in [false, true] {
            let bytes = rich(binary);
            let end = bytes.windows(14).rposition(|w| w == b"METADATA\nINFOR").unwrap() - 1;
            let read = |cut: usize| open_bytes(&bytes[..cut], Some("last")).and_then(try_read_all);
            // A text may end within its last number and still be one.
            let end = if binary { end } else { end - 8 };
            assert!((0..end).all(|cut| read(cut).is_err()), "binary: {binary}");
        }
    }

    #[test]
    fn real_files_have_the_published_dimensions_and_ranges() {
        for (name, field, dims, scalar, expected) in [
            ("volumes/carotid_flow_f32be.vtk", "scalars", [76, 49, 45], ScalarType::F32, (0.0, 580.0)),
            ("volumes/ironprot_u8.vtk", "scalars", [68, 68, 68], ScalarType::U8, (0.0, 255.0)),
            ("variants/vtkio/volume_complex.vtk", "volume_scalars", [3, 4, 6], ScalarType::I8, (0.0, 50.0)),
        ] {
            let Some(path) = shared(name) else { return };
            let (info, values) = read_all(open(&path, &OpenOptions::default()).unwrap());
            assert_eq!((info.dims, info.field.scalar, &info.field.name[..]), (dims, scalar, field));
            assert_eq!(range(&values), expected, "{name}");
        }
    }

    #[test]
    fn real_files_that_are_no_volume_are_refused_by_name() {
        let Some(folder) = shared("variants") else { return };
        let mut seen = 0;
        for entry in
            std::fs::read_dir(folder.join("vtkio")).unwrap().chain(std::fs::read_dir(folder).unwrap())
        {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.extension().is_some_and(|e| e == "vtk") && name != "volume_complex.vtk" {
                let error = open(&path, &OpenOptions::default()).err().unwrap();
                let line = error.to_string();
                assert!(error.exit_code() == 5 && line.contains("DATASET"), "{line}");
                seen += 1;
            }
        }
        assert!(seen > 20);
    }
}
