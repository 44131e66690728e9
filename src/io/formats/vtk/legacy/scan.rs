//! Scans a legacy VTK file from front to back, and finds where everything lies.

use crate::cells::Center;
use crate::error::{Error, Fault, Place, Result};
use crate::formats::shared::centers;
use crate::formats::shared::stream::{PushWord, push_color, push_number, sample_bytes};
use crate::formats::shared::text::Words;
use crate::volume::{FieldInfo, ScalarType};
use std::ops::Range;
use std::path::Path;

/// A type name of the format.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Type {
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
pub(super) struct LegacyArray {
    pub(super) name: String,
    pub(super) kind: Type,
    pub(super) components: u64,
    /// Whether it stood under SCALARS.
    pub(super) is_scalars: bool,
    pub(super) data: Range<u64>,
}

impl LegacyArray {
    /// Its description as a field of a volume; `None` where it has none.
    pub(super) fn field(&self) -> Option<FieldInfo> {
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
pub(super) struct Scanned {
    pub(super) dataset: Dataset,
    pub(super) binary: bool,
    pub(super) dims: [u64; 3],
    pub(super) origin: [f64; 3],
    pub(super) spacing: [f64; 3],
    /// The points of an unstructured or a curvilinear grid.
    pub(super) points: Option<LegacyArray>,
    /// The axes of a rectilinear grid, each with its number of samples.
    pub(super) axes: [Option<(u64, LegacyArray)>; 3],
    /// Number of those.
    pub(super) point_count: u64,
    pub(super) connectivity: Option<Connectivity>,
    /// VTK's numbers of the kinds of cells, `int` in a binary file, and how many.
    pub(super) types: Option<(u64, Range<u64>)>,
    /// Arrays of the point data.
    pub(super) arrays: Vec<LegacyArray>,
    /// Arrays of the cell data.
    pub(super) cell_arrays: Vec<LegacyArray>,
    /// The array of the field data that is its time.
    pub(super) time: Option<LegacyArray>,
    /// Where arrays of colours begin.
    colors: Vec<u64>,
}

impl Scanned {
    /// How an array's words stand for its numbers, in a text.
    pub(super) fn words_of(&self, data: &Range<u64>) -> PushWord {
        if self.colors.contains(&data.start) { push_color } else { push_number }
    }
}

/// The datasets that are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Dataset {
    #[default]
    StructuredPoints,
    RectilinearGrid,
    StructuredGrid,
    UnstructuredGrid,
}

impl Dataset {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::StructuredPoints => "STRUCTURED_POINTS",
            Self::RectilinearGrid => "RECTILINEAR_GRID",
            Self::StructuredGrid => "STRUCTURED_GRID",
            Self::UnstructuredGrid => "UNSTRUCTURED_GRID",
        }
    }
}

impl Dataset {
    /// Whether a section of numbers belongs to a dataset, besides its data.
    fn has(self, keyword: &str) -> bool {
        match keyword {
            "POINTS" => matches!(self, Self::UnstructuredGrid | Self::StructuredGrid),
            "CELLS" | "CELL_TYPES" => self == Self::UnstructuredGrid,
            "X_COORDINATES" | "Y_COORDINATES" | "Z_COORDINATES" => self == Self::RectilinearGrid,
            _ => false,
        }
    }
}

/// The vertices of the cells.
#[derive(Debug)]
pub(super) enum Connectivity {
    /// For each cell the number of its vertices, then these: `int` in a binary file.
    Counted { cells: u64, numbers: u64, data: Range<u64> },
    /// Since version 5.1: where each cell's vertices begin, and the end of the last; then the
    /// vertices.
    Offsets { offsets: u64, offset_array: LegacyArray, vertices: u64, vertex_array: LegacyArray },
}

impl Connectivity {
    /// Number of cells.
    pub(super) fn cells(&self) -> u64 {
        match self {
            Self::Counted { cells, .. } => *cells,
            Self::Offsets { offsets, .. } => offsets.saturating_sub(1),
        }
    }
}

/// The section to which the following arrays belong.
#[derive(Clone, Copy, PartialEq)]
enum Section {
    /// The file, before any data.
    File,
    Points(u64),
    Cells(u64),
}

/// Goes over a file from front to back.
pub(super) struct Scanner<'a> {
    path: &'a Path,
    words: Words<'a>,
    out: Scanned,
    section: Section,
}

impl<'a> Scanner<'a> {
    /// Reads the first four lines of a file that should hold one of the `wanted` datasets.
    pub(super) fn new(path: &'a Path, bytes: &'a [u8], wanted: &[Dataset]) -> Result<Self> {
        let names = wanted.iter().map(|d| d.name()).collect::<Vec<_>>().join(" or ");
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
            return Err(words.wrong(format!("DATASET {names}"), format!("'{word}'")));
        }
        let kind = words.word(&names)?;
        let Some(&dataset) = wanted.iter().find(|d| kind.eq_ignore_ascii_case(d.name())) else {
            return Err(words
                .wrong(format!("DATASET {names}"), format!("DATASET {kind}"))
                .with_help("resample or convert it first"));
        };
        let out = Scanned { dataset, binary, spacing: [1.0; 3], ..Scanned::default() };
        Ok(Self { path, words, out, section: Section::File })
    }

    pub(super) fn scan(mut self) -> Result<Scanned> {
        while let Some(word) = self.words.next() {
            let keyword = String::from_utf8_lossy(word).to_ascii_uppercase();
            match (keyword.as_str(), self.section) {
                (name, Section::File) if self.out.dataset.has(name) => {
                    self.topology(name)?;
                }
                ("DIMENSIONS", Section::File) => self.out.dims = self.three("a dimension")?,
                ("SPACING" | "ASPECT_RATIO", Section::File) => self.out.spacing = self.three("a spacing")?,
                ("ORIGIN", Section::File) => self.out.origin = self.three("a coordinate")?,
                ("POINT_DATA", _) => self.section = Section::Points(self.samples()?),
                ("CELL_DATA", _) => self.section = Section::Cells(self.cells()?),
                ("METADATA", _) => self.skip_metadata(),
                ("FIELD", _) => self.field()?,
                (name, Section::Points(n) | Section::Cells(n)) => self.attribute(name, n)?,
                (name, Section::File) => {
                    let expected = match self.out.dataset {
                        Dataset::RectilinearGrid => "DIMENSIONS, X_COORDINATES, POINT_DATA or CELL_DATA",
                        Dataset::StructuredGrid => "DIMENSIONS, POINTS, POINT_DATA or CELL_DATA",
                        Dataset::StructuredPoints => "DIMENSIONS, SPACING, ORIGIN, POINT_DATA or CELL_DATA",
                        Dataset::UnstructuredGrid => "POINTS, CELLS, CELL_TYPES, POINT_DATA or CELL_DATA",
                    };
                    return Err(self.wrong(expected, format!("'{name}'")));
                }
            }
        }
        if self.out.dataset != Dataset::UnstructuredGrid && self.out.dims == [0; 3] {
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
        if self.out.dataset == Dataset::UnstructuredGrid {
            return self.same(n, self.out.point_count, "POINT_DATA");
        }
        let d = self.out.dims;
        sample_bytes(self.path, d, ScalarType::U8)?;
        if n != d[0] * d[1] * d[2] {
            let expected = format!("POINT_DATA {} for {} x {} x {}", d[0] * d[1] * d[2], d[0], d[1], d[2]);
            return Err(self.words.wrong(expected, n.to_string()));
        }
        Ok(n)
    }

    /// The number after CELL_DATA.
    fn cells(&mut self) -> Result<u64> {
        let n: u64 = self.words.parse("a number of cells")?;
        match &self.out.connectivity {
            Some(cells) => self.same(n, cells.cells(), "CELL_DATA"),
            None => {
                sample_bytes(self.path, self.out.dims, ScalarType::U8)?;
                self.same(n, centers::samples(self.out.dims, Center::Cell).iter().product(), "CELL_DATA")
            }
        }
    }

    fn same(&self, n: u64, expected: u64, keyword: &str) -> Result<u64> {
        if n == expected {
            Ok(n)
        } else {
            Err(self.words.wrong(format!("{keyword} {expected}"), n.to_string()))
        }
    }

    /// POINTS, CELLS, CELL_TYPES, or an axis of a rectilinear grid.
    fn topology(&mut self, keyword: &str) -> Result<()> {
        let n: u64 = self.words.parse("a number")?;
        match keyword {
            "POINTS" => {
                let kind = self.kind()?;
                self.words.line();
                self.out.point_count = n;
                self.out.points = Some(self.place("points", kind, 3, n)?);
            }
            "CELLS" => {
                let numbers: u64 = self.words.parse("a number")?;
                self.words.line();
                self.out.connectivity = Some(self.connectivity(n, numbers)?);
            }
            "X_COORDINATES" | "Y_COORDINATES" | "Z_COORDINATES" => {
                let kind = self.kind()?;
                self.words.line();
                let axis = usize::from(keyword.as_bytes()[0] - b'X');
                self.out.axes[axis] = Some((n, self.place(keyword, kind, 1, n)?));
            }
            _ => {
                self.words.line();
                self.out.types = Some((n, self.data("cell types", Type::Number(ScalarType::I32), 1, n)?));
            }
        }
        Ok(())
    }

    fn connectivity(&mut self, n: u64, numbers: u64) -> Result<Connectivity> {
        if !self.words.rest().trim_ascii_start().starts_with(b"OFFSETS") {
            let data = self.data("cells", Type::Number(ScalarType::I32), 1, numbers)?;
            return Ok(Connectivity::Counted { cells: n, numbers, data });
        }
        let mut part = |name: &str, n: u64| {
            let word = self.words.word(name)?;
            if word != name {
                return Err(self.wrong(name, format!("'{word}'")));
            }
            let kind = self.kind()?;
            self.words.line();
            self.place(name, kind, 1, n)
        };
        let offset_array = part("OFFSETS", n)?;
        let vertex_array = part("CONNECTIVITY", numbers)?;
        Ok(Connectivity::Offsets { offsets: n, offset_array, vertices: numbers, vertex_array })
    }

    /// An array that begins here, of numbers.
    fn place(&mut self, name: &str, kind: Type, components: u64, n: u64) -> Result<LegacyArray> {
        let data = self.data(name, kind, components, n)?;
        Ok(LegacyArray { name: name.into(), kind, components, is_scalars: false, data })
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

    /// Bytes: in a text as parts of 255. VTK writes any scalars of bytes so.
    fn colors(&mut self, n: u64) -> Result<()> {
        let name = self.name()?;
        let components = self.words.parse("a number of components")?;
        self.words.line();
        self.out.colors.push(self.words.at() as u64);
        self.array(name, Type::Number(ScalarType::U8), components, n, n, false)
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

    /// Goes over the data of an array and notes it where it has a tuple for each of the `n` points
    /// or cells.
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
                self.out.arrays.push(LegacyArray { name, kind, components, is_scalars, data });
            }
            Section::Cells(_) if tuples == n && components > 0 => {
                self.out.cell_arrays.push(LegacyArray { name, kind, components, is_scalars, data });
            }
            Section::File if components == 1 && tuples == 1 && ["TIME", "TimeValue"].contains(&&name[..]) => {
                self.out.time = Some(LegacyArray { name, kind, components, is_scalars, data });
            }
            _ => {}
        }
        Ok(())
    }

    /// Skips the numbers that begin here, and returns where they lie.
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
            return Err(Error::bad_input(self.path, Place::byte(start), expected, "the end of the file")
                .of_fault(Fault::CutShort)
                .with_help("the file is cut short, or its header is wrong"));
        }
        Ok(start..self.words.at() as u64)
    }

    /// Skips a binary string: the two highest bits of its first byte give the width of its length.
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
            true => Error::bad_input(self.path, Place::byte(self.words.at() as u64), expected, got),
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
