//! A long array in a nameless scratch file: written front to back, then mapped.

use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use bytemuck::Pod;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

/// A column that is being written.
pub(crate) struct ColumnWriter<T> {
    out: BufWriter<File>,
    len: u64,
    scratch: PathBuf,
    of: PhantomData<T>,
}

impl<T: Pod> ColumnWriter<T> {
    pub(crate) fn new(scratch: &Path) -> Result<Self> {
        let file =
            tempfile::tempfile_in(scratch).map_err(|e| Error::io("make a temporary file in", scratch, e))?;
        let out = BufWriter::with_capacity(1 << 18, file);
        Ok(Self { out, len: 0, scratch: scratch.to_path_buf(), of: PhantomData })
    }

    pub(crate) fn push(&mut self, record: &T) -> Result<()> {
        self.len += 1;
        self.out.write_all(bytemuck::bytes_of(record)).map_err(|e| self.failed(e))
    }

    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    fn failed(&self, e: std::io::Error) -> Error {
        Error::io("write a temporary file in", &self.scratch, e)
    }

    pub(crate) fn finish(mut self) -> Result<Column<T>> {
        self.out.flush().map_err(|e| self.failed(e))?;
        let scratch = self.scratch;
        let file = self
            .out
            .into_inner()
            .map_err(|e| Error::io("write a temporary file in", &scratch, e.into_error()))?;
        // Nothing can be mapped of an empty file.
        let bytes = (self.len > 0).then(|| ByteSource::of_file(&scratch, file, IoMode::Map)).transpose()?;
        Ok(Column { bytes, of: PhantomData })
    }
}

/// A finished column. Its file has no name, so nobody else can change it.
pub(crate) struct Column<T> {
    bytes: Option<ByteSource>,
    of: PhantomData<T>,
}

impl<T: Pod> Column<T> {
    /// All records, mapped.
    pub(crate) fn get(&self) -> Result<&[T]> {
        match &self.bytes {
            None => Ok(&[]),
            Some(bytes) => {
                let all = bytes.slice(0..bytes.len())?;
                Ok(bytemuck::try_cast_slice(all).expect("a mapping is aligned and has whole records"))
            }
        }
    }
}
