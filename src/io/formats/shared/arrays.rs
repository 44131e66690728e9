//! Named arrays in a file, as NetCDF and HDF5 have them, read front to back.

use crate::cells::NumberStream;
use crate::error::Result;
use crate::volume::ScalarType;
use std::collections::HashMap;

/// Most bytes of an array of text that is read.
pub(in crate::formats) const MOST_TEXT: u64 = 16 << 20;

/// An array of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct ArrayInfo {
    /// Entries along each axis, the slowest first.
    pub shape: Vec<u64>,
    /// Type of its numbers.
    pub(in crate::formats) scalar: ScalarType,
}

/// The arrays of a file.
pub trait Arrays: Send + Sync {
    /// The format, as a person would call it.
    fn format(&self) -> String;

    /// The names of all arrays, sorted.
    fn names(&self) -> Vec<String>;

    /// The size of a dimension; `None` where there is none of this name.
    fn dimension(&self, name: &str) -> Option<u64>;

    /// An array of numbers; `None` where there is no array of this name.
    ///
    /// # Errors
    /// [`Error::BadInput`](crate::Error::BadInput) for an array of something else.
    fn array(&self, name: &str) -> Result<Option<ArrayInfo>>;

    /// An attribute of an array that is text; empty where there is none.
    fn attribute(&self, array: &str, name: &str) -> String;

    /// Whether there is an array of this name, and it is text.
    fn is_text(&self, name: &str) -> bool;

    /// The rows of an array of characters; `None` where there is no array of this name.
    ///
    /// # Errors
    /// [`Error::BadInput`](crate::Error::BadInput) for an array of numbers, or of more than
    /// [`MOST_TEXT`] bytes.
    fn texts(&self, name: &str) -> Result<Option<Vec<String>>>;

    /// All numbers at the entries `before` of an array's first axes, in their order in the file.
    ///
    /// # Errors
    /// [`Error::BadInput`](crate::Error::BadInput) where there is no such array of numbers, or it
    /// has fewer entries.
    fn numbers(&self, name: &str, before: &[u64]) -> Result<Box<dyn NumberStream>>;
}

/// The texts in rows of bytes, without what fills them up.
pub(in crate::formats) fn texts_of(bytes: &[u8], width: usize) -> Vec<String> {
    let text = |row: &[u8]| {
        let end = row.iter().position(|&b| b == 0).unwrap_or(row.len());
        let text = String::from_utf8_lossy(&row[..end]);
        text.trim().chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
    };
    bytes.chunks_exact(width.max(1)).map(text).collect()
}

/// Finds what names stand for.
pub(in crate::formats) fn by_name<'a>(names: impl Iterator<Item = &'a str>) -> HashMap<String, usize> {
    names.enumerate().map(|(i, name)| (name.to_string(), i)).collect()
}
