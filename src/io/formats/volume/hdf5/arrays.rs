//! The datasets of a file, by their paths.

use super::{attribute_text, damaged, open_file, scalar_of, values};
use crate::bytes::ByteSource;
use crate::cells::NumberStream;
use crate::error::{Error, Result};
use crate::formats::shared::arrays::{ArrayInfo, Arrays, MOST_TEXT, texts_of};
use crate::volume::ScalarType;
use hdf5_reader::messages::datatype::{Datatype, StringSize};
use hdf5_reader::{Dataset, Hdf5File, SliceInfo, SliceInfoElem};
use std::collections::{BTreeSet, HashSet};
use std::path::PathBuf;
use std::sync::Arc;

/// Most bytes of a chunk, as the library of NetCDF makes them unless it is told otherwise.
const MOST_AT_ONCE: u64 = 16 << 20;
/// Small chunks are read together up to this many bytes, since each read walks the index of chunks.
const PIECE: u64 = 4 << 20;

/// Opens the datasets of a file: those of the root group, and of groups up to `depth` below it,
/// each group once. A name is a path, without the first "/".
///
/// # Errors
/// [`Error::BadInput`] for a malformed file.
pub fn arrays(source: &Arc<ByteSource>, depth: usize) -> Result<Arc<dyn Arrays>> {
    let path = source.path();
    let file = open_file(path, source)?;
    let root = file.root_group().map_err(|e| damaged(path, "/", &e))?;
    let (mut names, mut left) = (BTreeSet::new(), vec![(String::new(), root, depth)]);
    let mut seen = HashSet::new();
    while let Some((prefix, group, depth)) = left.pop() {
        // Of many links to groups of many links there would be no end.
        if !seen.insert(group.address()) {
            continue;
        }
        let wrong = |e: hdf5_reader::error::Error| damaged(path, &format!("/{prefix}"), &e);
        let (groups, datasets) = group.member_names().map_err(wrong)?;
        names.extend(datasets.into_iter().map(|name| format!("{prefix}{name}")));
        for name in groups.into_iter().filter(|_| depth > 0) {
            let below = group.group(&name).map_err(wrong)?;
            left.push((format!("{prefix}{name}/"), below, depth - 1));
        }
    }
    Ok(Arc::new(Datasets { path: path.to_path_buf(), file, names }))
}

/// The type of a VTKHDF file; `None` of another file.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file.
pub fn vtk_kind(source: &Arc<ByteSource>) -> Result<Option<String>> {
    let path = source.path();
    let file = open_file(path, source)?;
    let kind = file.group("VTKHDF").ok().and_then(|group| group.attribute("Type").ok());
    Ok(kind.and_then(|kind| attribute_text(&kind)))
}

struct Datasets {
    path: PathBuf,
    file: Hdf5File,
    names: BTreeSet<String>,
}

impl Datasets {
    fn dataset(&self, name: &str) -> Result<Option<Dataset>> {
        if !self.names.contains(name) {
            return Ok(None);
        }
        self.file.dataset(name).map(Some).map_err(|e| damaged(&self.path, name, &e))
    }

    fn wrong(&self, name: &str, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(&self.path, name, expected, got)
    }
}

impl Arrays for Datasets {
    fn format(&self) -> String {
        "NetCDF-4".into()
    }

    fn names(&self) -> Vec<String> {
        self.names.iter().cloned().collect()
    }

    fn dimension(&self, name: &str) -> Option<u64> {
        self.dataset(name).ok()??.shape().first().copied()
    }

    fn array(&self, name: &str) -> Result<Option<ArrayInfo>> {
        let Some(dataset) = self.dataset(name)? else { return Ok(None) };
        let (scalar, _) = scalar_of(&self.path, name, &dataset)?;
        Ok(Some(ArrayInfo { shape: dataset.shape().to_vec(), scalar }))
    }

    fn attribute(&self, array: &str, name: &str) -> String {
        let found = self.dataset(array).ok().flatten().and_then(|d| d.attribute(name).ok());
        found.and_then(|a| attribute_text(&a)).unwrap_or_default()
    }

    fn is_text(&self, name: &str) -> bool {
        let dataset = self.dataset(name).ok().flatten();
        dataset.is_some_and(|d| matches!(d.dtype(), Datatype::String { .. }))
    }

    fn texts(&self, name: &str) -> Result<Option<Vec<String>>> {
        let Some(dataset) = self.dataset(name)? else { return Ok(None) };
        let Datatype::String { size: StringSize::Fixed(size), .. } = dataset.dtype() else {
            return Err(self.wrong(name, "text of a fixed length", super::kind(dataset.dtype())));
        };
        let bytes = dataset.raw_byte_len().map_err(|e| damaged(&self.path, name, &e))? as u64;
        if bytes > MOST_TEXT {
            return Err(self.wrong(name, format!("at most {MOST_TEXT} bytes of text"), bytes.to_string()));
        }
        let width = dataset.shape().iter().skip(1).product::<u64>() * u64::from(*size);
        let bytes = dataset.read_raw_bytes().map_err(|e| damaged(&self.path, name, &e))?;
        Ok(Some(texts_of(&bytes, width as usize)))
    }

    fn numbers(&self, name: &str, before: &[u64]) -> Result<Box<dyn NumberStream>> {
        let dataset = self.dataset(name)?.ok_or_else(|| self.wrong(name, "a dataset", "none"))?;
        let (scalar, _) = scalar_of(&self.path, name, &dataset)?;
        let shape = dataset.shape();
        if before.len() > shape.len() || before.iter().zip(shape).any(|(at, n)| at >= n) {
            return Err(self.wrong(name, format!("an entry {before:?}"), format!("{shape:?} of them")));
        }
        let rest = &shape[before.len()..];
        let rows = rest.first().copied().unwrap_or(1);
        let row = rest.iter().skip(1).try_fold(1u64, |n, &d| n.checked_mul(d));
        let chunk = dataset.chunks().and_then(|c| c.get(before.len()).copied()).unwrap_or(1);
        // Whole chunks, so that each is decoded once.
        let size = |rows: u64, bytes: u64| row.and_then(|row| row.checked_mul(rows)?.checked_mul(bytes));
        let bytes = scalar.bytes() as u64;
        let mut at_once = u64::from(chunk).max(1);
        // Numbers of one byte are eight times as large when they are loaded.
        while at_once < rows && size(2 * at_once, bytes.max(4)).is_some_and(|bytes| bytes <= PIECE) {
            at_once *= 2;
        }
        at_once = at_once.min(rows.max(1));
        if size(at_once, bytes).is_none_or(|bytes| bytes > MOST_AT_ONCE) {
            let got = format!("{shape:?} numbers in chunks of {:?}", dataset.chunks().unwrap_or_default());
            return Err(self
                .wrong(name, "chunks of at most 16 MiB", got)
                .with_help("write the dataset again in smaller chunks (nccopy -c)"));
        }
        Ok(Box::new(Rows {
            path: self.path.clone(),
            name: name.into(),
            dataset,
            scalar,
            before: before.to_vec(),
            rows,
            at_once,
            next: 0,
            loaded: vec![],
            used: 0,
        }))
    }
}

/// The numbers of a dataset, some rows of them at a time.
struct Rows {
    path: PathBuf,
    name: String,
    dataset: Dataset,
    scalar: ScalarType,
    before: Vec<u64>,
    rows: u64,
    at_once: u64,
    /// The first row that was not loaded yet.
    next: u64,
    loaded: Vec<f64>,
    used: usize,
}

impl Rows {
    fn load(&mut self) -> Result<()> {
        let end = self.next.saturating_add(self.at_once).min(self.rows);
        let range = |start, end| SliceInfoElem::Slice { start, end, step: 1 };
        let shape = self.dataset.shape();
        let rest = shape.iter().skip(self.before.len() + 1).map(|&n| range(0, n));
        let rows = (shape.len() > self.before.len()).then(|| range(self.next, end));
        let before = self.before.iter().map(|&at| range(at, at + 1));
        let selection = SliceInfo { selections: before.chain(rows).chain(rest).collect() };
        self.loaded.clear();
        self.used = 0;
        values(&self.dataset, self.scalar, &selection, &mut self.loaded)
            .map_err(|e| damaged(&self.path, &self.name, &e))?;
        self.next = end;
        Ok(())
    }
}

impl NumberStream for Rows {
    fn fill(&mut self, mut out: &mut [f64]) -> Result<()> {
        while !out.is_empty() {
            if self.used == self.loaded.len() {
                if self.next == self.rows {
                    return Err(Error::bad_input(&self.path, &self.name[..], "more numbers", "their end"));
                }
                self.load()?;
                continue;
            }
            let n = out.len().min(self.loaded.len() - self.used);
            let (now, later) = out.split_at_mut(n);
            now.copy_from_slice(&self.loaded[self.used..self.used + n]);
            self.used += n;
            out = later;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        if self.used == self.loaded.len() && self.next == self.rows {
            return Ok(());
        }
        Err(Error::bad_input(&self.path, &self.name[..], "the end of the numbers", "more"))
    }
}
