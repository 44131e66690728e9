//! The variables of a NetCDF-3 file, by their names.

use super::header::{NetcdfHeader, Variable};
use crate::bytes::ByteSource;
use crate::cells::NumberStream;
use crate::error::{Error, Result};
use crate::formats::shared::arrays::{ArrayInfo, Arrays, MOST_TEXT, by_name, texts_of};
use crate::formats::shared::ranges::RangeNumbers;
use std::collections::HashMap;
use std::sync::Arc;

/// Opens the variables of a file.
///
/// # Errors
/// [`Error::BadInput`] for a malformed header.
pub(in crate::formats) fn arrays(source: &Arc<ByteSource>) -> Result<Arc<dyn Arrays>> {
    let header = NetcdfHeader::parse(source.path(), source.head_from(0)?, source.len())?;
    source.check()?;
    let dims = by_name(header.dims.iter().map(|d| d.name.as_str()));
    let variables = by_name(header.variables.iter().map(|v| v.name.as_str()));
    Ok(Arc::new(Variables { source: Arc::clone(source), header, dims, variables }))
}

struct Variables {
    source: Arc<ByteSource>,
    header: NetcdfHeader,
    dims: HashMap<String, usize>,
    variables: HashMap<String, usize>,
}

impl Variables {
    fn variable(&self, name: &str) -> Option<&Variable> {
        self.variables.get(name).map(|&at| &self.header.variables[at])
    }

    fn wrong(&self, name: &str, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(self.source.path(), name, expected, got)
    }

    /// The bytes of an array at entries of its first axes, which lie one after another.
    fn range(&self, variable: &Variable, before: &[u64], bytes: u64) -> Result<(u64, u64)> {
        let (name, shape) = (&variable.name, self.header.shape(variable));
        if before.len() > shape.len() || before.iter().zip(&shape).any(|(at, n)| at >= n) {
            return Err(self.wrong(name, format!("an entry {before:?}"), format!("{shape:?} of them")));
        }
        let rest = &shape[before.len()..];
        if before.is_empty() && self.header.has_records(variable) && rest[0] > 1 {
            return Err(self.wrong(name, "a variable without records", "one with records"));
        }
        let steps = self.header.steps(self.source.path(), variable)?;
        let length = rest.iter().try_fold(bytes, |n, &d| n.checked_mul(d));
        let place = before.iter().zip(&steps).try_fold(variable.begin, |at, (&entry, &step)| {
            entry.checked_mul(step).and_then(|by| at.checked_add(by))
        });
        let range = place.zip(length).and_then(|(at, n)| Some((at, at.checked_add(n)?)));
        range.ok_or_else(|| {
            let got = "a number of more than 64 bits";
            self.wrong(name, "a place in the file", got).with_help("the header is damaged")
        })
    }
}

impl Arrays for Variables {
    fn format(&self) -> String {
        self.header.name().into()
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = self.variables.keys().cloned().collect();
        names.sort();
        names
    }

    fn dimension(&self, name: &str) -> Option<u64> {
        self.dims.get(name).map(|&dim| self.header.size(dim))
    }

    fn array(&self, name: &str) -> Result<Option<ArrayInfo>> {
        let Some(variable) = self.variable(name) else { return Ok(None) };
        let scalar = variable.scalar(self.source.path())?;
        Ok(Some(ArrayInfo { shape: self.header.shape(variable), scalar }))
    }

    fn attribute(&self, array: &str, name: &str) -> String {
        self.variable(array).map_or_else(String::new, |v| v.text(name))
    }

    fn is_text(&self, name: &str) -> bool {
        self.variable(name).is_some_and(Variable::is_text)
    }

    fn texts(&self, name: &str) -> Result<Option<Vec<String>>> {
        let Some(variable) = self.variable(name) else { return Ok(None) };
        if !variable.is_text() {
            return Err(self.wrong(name, "text", "numbers"));
        }
        let shape = self.header.shape(variable);
        let (start, end) = self.range(variable, &[], 1)?;
        let file = self.source.len();
        if end - start > MOST_TEXT || end > file {
            let expected = format!("at most {MOST_TEXT} bytes of text in a file of {file}");
            return Err(self.wrong(name, expected, format!("bytes {start} to {end}")));
        }
        let mut bytes = vec![0; (end - start) as usize];
        self.source.read_at(start, &mut bytes)?;
        let width = shape.iter().skip(1).product::<u64>() as usize;
        Ok(Some(texts_of(&bytes, width)))
    }

    fn numbers(&self, name: &str, before: &[u64]) -> Result<Box<dyn NumberStream>> {
        let variable = self.variable(name).ok_or_else(|| self.wrong(name, "a variable", "none"))?;
        let scalar = variable.scalar(self.source.path())?;
        let (start, end) = self.range(variable, before, scalar.bytes() as u64)?;
        Ok(Box::new(RangeNumbers::binary(&self.source, start..end, scalar, true)))
    }
}
