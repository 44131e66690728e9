//! Lists of points as text: CSV in, CSV or NPY out.
//!
//! A list is a table of numbers with a comma, a semicolon or a tab between them; the first line
//! shows which. With titles, the columns named x, y and z (in any case; or `Points:0`, `Points:1`,
//! `Points:2`, as ParaView writes them) are the coordinates; without titles, the first three
//! columns are. Lines that begin with `#` are skipped. The output has the columns of the input,
//! unchanged, and one more; NaN is written `nan`. Memory: that of a line. A table is read twice, so
//! it must be a file.

use crate::bytes::open_regular;
use crate::bytes::publish::Unpublished;
use crate::error::{Error, Result};
use crate::formats::shared::sink::resolve;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

/// The longest first line that is read to find what separates numbers.
const LONGEST_LINE: u64 = 1 << 20;

/// A table being read.
pub struct PointReader {
    records: csv::Reader<File>,
    record: csv::StringRecord,
    path: PathBuf,
    /// The columns of x, y and z.
    columns: [usize; 3],
    titles: Option<csv::StringRecord>,
    /// Whether `record` holds the first line, which is not a title, still to be handed out.
    waiting: bool,
    delimiter: u8,
}

impl PointReader {
    /// Opens a table and looks at its first line.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a table without coordinates; [`Error::Io`] when it cannot be read.
    pub fn open(path: &Path) -> Result<Self> {
        let delimiter = delimiter(path)?;
        let file = open_regular(path)?;
        let records = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .comment(Some(b'#'))
            .delimiter(delimiter)
            .trim(csv::Trim::All)
            .from_reader(file);
        let record = csv::StringRecord::new();
        let path = path.to_path_buf();
        let mut reader =
            Self { records, record, path, columns: [0, 1, 2], titles: None, waiting: false, delimiter };
        if !reader.read()? {
            return Err(reader.bad("the first line", "coordinates x, y, z", "an empty file"));
        }
        reader.waiting = true;
        if reader.coordinates(&reader.record).is_err() {
            reader.columns = reader.titled_columns()?;
            reader.titles = Some(reader.record.clone());
            reader.waiting = false;
        }
        Ok(reader)
    }

    fn bad(&self, at: &str, expected: &str, got: &str) -> Error {
        Error::bad_input(&self.path, at, expected, got)
    }

    fn titled_columns(&self) -> Result<[usize; 3]> {
        let find = |names: [&str; 2]| {
            self.record.iter().position(|title| names.iter().any(|name| title.eq_ignore_ascii_case(name)))
        };
        match (find(["x", "Points:0"]), find(["y", "Points:1"]), find(["z", "Points:2"])) {
            (Some(x), Some(y), Some(z)) => Ok([x, y, z]),
            _ => {
                let got = self.record.iter().collect::<Vec<_>>().join(",");
                let error = self.bad("the first line", "three numbers, or titles x, y and z", &got);
                Err(error.with_help("name the columns of the coordinates x, y and z"))
            }
        }
    }

    fn coordinates(&self, record: &csv::StringRecord) -> std::result::Result<[f64; 3], usize> {
        let mut point = [0.0; 3];
        for (x, &column) in point.iter_mut().zip(&self.columns) {
            let number = record.get(column).and_then(|text| text.parse().ok());
            *x = number.filter(|x: &f64| x.is_finite()).ok_or(column)?;
        }
        Ok(point)
    }

    fn read(&mut self) -> Result<bool> {
        if std::mem::take(&mut self.waiting) {
            return Ok(true);
        }
        self.records.read_record(&mut self.record).map_err(|e| {
            let line = e.position().map_or("a line".to_owned(), |p| format!("line {}", p.line()));
            match e.into_kind() {
                csv::ErrorKind::Io(e) => Error::io("read", &self.path, e),
                _ => Error::bad_input(&self.path, line, "text in UTF-8", "other bytes"),
            }
        })
    }

    /// The next point; `None` at the end.
    ///
    /// # Errors
    /// [`Error::BadInput`] naming the line that has no three finite numbers.
    pub fn next_point(&mut self) -> Result<Option<[f64; 3]>> {
        if !self.read()? {
            return Ok(None);
        }
        self.coordinates(&self.record).map(Some).map_err(|column| {
            let line = self.record.position().map_or(0, |p| p.line());
            let got = self.record.get(column).map_or("no such column".to_owned(), |text| format!("'{text}'"));
            self.bad(&format!("line {line}, column {}", column + 1), "a finite number", &got)
        })
    }
}

/// What separates the numbers of the first line that is not a comment.
fn delimiter(path: &Path) -> Result<u8> {
    let file = open_regular(path)?;
    let mut lines = BufReader::new(std::io::Read::take(file, LONGEST_LINE)).split(b'\n');
    let line = loop {
        match lines.next().transpose().map_err(|e| Error::io("read", path, e))? {
            Some(line) if line.starts_with(b"#") => {}
            Some(line) => break line,
            None => break vec![],
        }
    };
    let found = [b',', b';', b'\t'].into_iter().find(|d| line.contains(d));
    found.ok_or_else(|| {
        let got = String::from_utf8_lossy(&line).into_owned();
        Error::bad_input(path, "the first line", "numbers with commas, semicolons or tabs between", got)
    })
}

/// Writes the columns of a table, and next to them the values at its points.
pub struct PointWriter {
    input: PointReader,
    rows: csv::Writer<Vec<u8>>,
    out: Unpublished,
    bytes: u64,
}

/// Bytes of rows that wait.
const BUFFER: usize = 1 << 18;

impl PointWriter {
    /// Begins a table: that of `input`, with a column `field` more.
    ///
    /// # Errors
    /// Those of reading the input and of creating the file.
    pub fn create(path: &Path, input: &Path, field: &str) -> Result<Self> {
        let input = PointReader::open(input)?;
        let out = Unpublished::create(&resolve(path)?)?;
        let rows = csv::WriterBuilder::new().flexible(true).delimiter(input.delimiter).from_writer(vec![]);
        let mut writer = Self { input, rows, out, bytes: 0 };
        let mut titles = match &writer.input.titles {
            Some(titles) => titles.clone(),
            None => (0..writer.input.record.len())
                .map(|n| ["x", "y", "z"].get(n).map_or(format!("column{}", n + 1), |t| (*t).to_owned()))
                .collect::<Vec<_>>()
                .into(),
        };
        titles.push_field(field);
        writer.row(&titles)?;
        Ok(writer)
    }

    fn row(&mut self, row: &csv::StringRecord) -> Result<()> {
        self.rows.write_record(row).expect("a record goes to memory, and lengths may differ");
        if self.rows.get_ref().len() > BUFFER { self.hand_on() } else { Ok(()) }
    }

    fn hand_on(&mut self) -> Result<()> {
        self.rows.flush().expect("rows go to memory");
        let empty =
            csv::WriterBuilder::new().flexible(true).delimiter(self.input.delimiter).from_writer(vec![]);
        let rows = std::mem::replace(&mut self.rows, empty);
        let Ok(bytes) = rows.into_inner() else { unreachable!("a flushed writer to memory gives its bytes") };
        self.bytes += bytes.len() as u64;
        self.out.write(&bytes)
    }

    /// Writes the values of the next points of the input.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the input has become shorter; those of reading and writing.
    pub fn write(&mut self, values: &[f64]) -> Result<()> {
        for value in values {
            if !self.input.read()? {
                return Err(self.input.bad("the end", "the points that were there before", "fewer"));
            }
            let mut row = self.input.record.clone();
            // As Rust, Python and C read it.
            row.push_field(&if value.is_nan() { "nan".to_owned() } else { value.to_string() });
            self.row(&row)?;
        }
        Ok(())
    }

    /// Makes the file durable, then visible; returns its bytes.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn publish(mut self) -> Result<u64> {
        self.hand_on()?;
        self.out.publish()?;
        Ok(self.bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(text: &str) -> Result<Vec<[f64; 3]>> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("p.csv");
        std::fs::write(&path, text).unwrap();
        let mut reader = PointReader::open(&path)?;
        let mut all = vec![];
        while let Some(p) = reader.next_point()? {
            all.push(p);
        }
        Ok(all)
    }

    #[test]
    fn tables_with_and_without_titles() {
        let wanted = vec![[1.0, -2.5, 3e2], [4.0, 5.0, 6.0]];
        for text in [
            "1,-2.5,3e2\n4,5,6\n",
            "x,y,z\n1, -2.5 ,300\n4,5,6",
            "# a comment\nname;Z;Y;X\r\n\"a;b\";300;-2.5;1\r\nc;6;5;4\r\n",
            "Points:0\tPoints:1\tPoints:2\n1\t-2.5\t3e2\n4\t5\t6\n",
        ] {
            assert_eq!(points(text).unwrap(), wanted, "{text}");
        }
        assert_eq!(points("x,y,z\n").unwrap(), Vec::<[f64; 3]>::new());
    }

    #[test]
    fn a_bad_line_is_named() {
        for (text, place) in [
            ("", "first line"),
            ("hello\n", "first line"),
            ("a,b,c\n1,2,3\n", "first line"),
            ("1,2\n3,4,5\n", "first line"),
            ("1,2,3\n4,5\n", "line 2, column 3"),
            ("x,y,z\n1,2,3\n4,nan,5\n", "line 3, column 2"),
            ("1,2,3\n4,five,5\n", "line 2, column 2"),
        ] {
            let error = points(text).unwrap_err();
            assert!(error.exit_code() == 5 && error.to_string().contains(place), "{text}: {error}");
        }
    }

    #[test]
    fn columns_are_kept_and_one_is_added() {
        let dir = tempfile::tempdir().unwrap();
        let (input, output) = (dir.path().join("p.csv"), dir.path().join("q.csv"));
        for (text, wanted) in [
            ("id,x,y,z\na,1,2,3\nb,4,5,6\n", "id,x,y,z,density\na,1,2,3,0.5\nb,4,5,6,nan\n"),
            ("1,2,3,q\n4,5,6,r\n", "x,y,z,column4,density\n1,2,3,q,0.5\n4,5,6,r,nan\n"),
        ] {
            std::fs::write(&input, text).unwrap();
            let mut writer = PointWriter::create(&output, &input, "density").unwrap();
            writer.write(&[0.5]).unwrap();
            writer.write(&[f64::NAN]).unwrap();
            assert_eq!(writer.write(&[1.0]).unwrap_err().exit_code(), 5);
            assert_eq!(writer.publish().unwrap(), wanted.len() as u64);
            assert_eq!(std::fs::read_to_string(&output).unwrap(), wanted);
        }
    }
}
