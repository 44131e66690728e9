//! A long array in a nameless scratch file: written front to back, then mapped. A short one stays
//! in memory.

use bytemuck::Pod;
use isospan_io::bytes::{ByteSource, IoMode};
use isospan_io::error::{Error, Result};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Bytes of a column that stays in memory, at most.
const SHORT: usize = 1 << 16;

/// A column that is being written.
pub(crate) struct ColumnWriter<T> {
    /// All records, as long as they are few.
    short: Vec<T>,
    /// Made when they are more.
    out: Option<BufWriter<File>>,
    len: u64,
    scratch: PathBuf,
}

impl<T: Pod> ColumnWriter<T> {
    pub(crate) fn new(scratch: &Path) -> Result<Self> {
        Ok(Self { short: vec![], out: None, len: 0, scratch: scratch.to_path_buf() })
    }

    pub(crate) fn push(&mut self, record: &T) -> Result<()> {
        self.len += 1;
        if self.out.is_none() && size_of_val(&*self.short) + size_of::<T>() <= SHORT {
            self.short.push(*record);
            return Ok(());
        }
        let out = match &mut self.out {
            Some(out) => out,
            None => {
                let file = tempfile::tempfile_in(&self.scratch)
                    .map_err(|e| Error::io("make a temporary file in", &self.scratch, e))?;
                let out = self.out.insert(BufWriter::with_capacity(1 << 18, file));
                let short = std::mem::take(&mut self.short);
                out.write_all(bytemuck::cast_slice(&short)).map_err(|e| failed(&self.scratch, e))?;
                out
            }
        };
        out.write_all(bytemuck::bytes_of(record)).map_err(|e| failed(&self.scratch, e))
    }

    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    pub(crate) fn finish(self) -> Result<Column<T>> {
        let Some(out) = self.out else { return Ok(Column::Short(self.short)) };
        let scratch = self.scratch;
        let file = out.into_inner().map_err(|e| failed(&scratch, e.into_error()))?;
        Ok(Column::Long(ByteSource::of_file(&scratch, file, IoMode::Map)?))
    }
}

fn failed(scratch: &Path, e: std::io::Error) -> Error {
    Error::io("write a temporary file in", scratch, e)
}

/// A finished column.
pub(crate) enum Column<T> {
    Short(Vec<T>),
    /// Its file has no name, so no other process can change it.
    Long(ByteSource),
}

impl<T: Pod> Column<T> {
    /// All records, mapped or in memory.
    pub(crate) fn get(&self) -> Result<&[T]> {
        match self {
            Self::Short(all) => Ok(all),
            Self::Long(bytes) => {
                let all = bytes.slice(0..bytes.len())?;
                Ok(bytemuck::try_cast_slice(all).expect("a mapping is aligned and has whole records"))
            }
        }
    }
}
