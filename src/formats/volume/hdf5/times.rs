//! The times of the steps in a file, and of a file that is one step.

use super::dialect::Dialect;
use super::{Field, Tree, all_f64, attribute_text, kind_of_line, open_file, scalar_of};
use crate::bytes::ByteSource;
use crate::error::Result;
use crate::formats::shared::{Frames, OpenOptions, cf};
use hdf5_reader::attribute_api::Attribute;
use hdf5_reader::{Dataset, Hdf5File};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// The frames of the dataset with four axes that is `wanted`, or of the file's only one, by the
/// names of their fields, and their times, where the first axis has a coordinate variable. None of
/// others.
///
/// # Errors
/// As [`super::open`].
pub(super) fn frames(path: &Path, options: &OpenOptions, wanted: Option<&str>) -> Result<Frames> {
    let source = Arc::new(ByteSource::open(path, options.io)?);
    let file = open_file(path, &source)?;
    let tree = Tree::of(path, &file, Dialect::of(path, &file)?)?;
    let named = OpenOptions { field: wanted.map(str::to_owned), ..options.clone() };
    let wanted = cf::with_channel(path, &named, tree.fields.iter().map(|f| &f.part))?;
    let number = match &wanted {
        Some(name) => tree.first_frame(&file, name),
        None => tree.fields.first().filter(|f| f.part.is_frame()).map(|_| 0),
    };
    let Some(first) = number.map(|n| &tree.fields[n]) else { return Ok(vec![]) };
    let parts = tree.fields.iter().map(|f| &f.part);
    Ok(cf::frames(parts, &first.part, wanted.is_some(), first.times(&tree)))
}

/// The time of the field that is read, or of all of them, where it is one time.
///
/// # Errors
/// As [`super::open`].
pub(super) fn time(path: &Path, options: &OpenOptions) -> Result<Option<f64>> {
    let source = Arc::new(ByteSource::open(path, options.io)?);
    let file = open_file(path, &source)?;
    let dialect = Dialect::of(path, &file)?;
    if dialect != Dialect::Plain {
        return Ok(None);
    }
    let mut tree = Tree::of(path, &file, dialect)?;
    if options.field.is_none() {
        return Ok(cf::common_time(tree.fields.iter(), |field| field.time(&tree, &file)));
    }
    let number = tree.pick(path, &file, dialect, options)?.number;
    Ok(tree.fields[number].time(&tree, &file))
}

/// The calendar of the times of the field that is read; "" where none is named.
///
/// # Errors
/// As [`super::open`].
pub(super) fn calendar(path: &Path, options: &OpenOptions) -> Result<String> {
    let source = Arc::new(ByteSource::open(path, options.io)?);
    let file = open_file(path, &source)?;
    let dialect = Dialect::of(path, &file)?;
    let mut tree = Tree::of(path, &file, dialect)?;
    let field = tree.pick(path, &file, dialect, options)?.number;
    let field = &tree.fields[field];
    let of = |time: &Dataset| time.attribute("calendar").ok().and_then(|a| attribute_text(&a));
    let found = match field.part.time {
        Some(axis) => tree.line_of(&field.part.array, &field.dataset, axis).and_then(|(_, time)| of(time)),
        None => field.single_time(&file).and_then(|(time, _)| of(&time)),
    };
    Ok(found.unwrap_or_default())
}

/// The times of frames by the names of their fields, where their datasets have them.
///
/// # Errors
/// As [`super::open`].
pub(super) fn times(path: &Path, options: &OpenOptions) -> Result<HashMap<String, f64>> {
    let source = Arc::new(ByteSource::open(path, options.io)?);
    let file = open_file(path, &source)?;
    let tree = Tree::of(path, &file, Dialect::of(path, &file)?)?;
    Ok(cf::times(tree.fields.iter(), |field| field.times(&tree)))
}

impl Field {
    /// The time of the field.
    fn time(&self, tree: &Tree, file: &Hdf5File) -> Option<f64> {
        match self.part.time {
            Some(axis) => self.line(axis, tree)?.get(self.part.entries[axis] as usize).copied(),
            None => self.single_time(file).map(|(_, time)| time),
        }
    }

    /// The dataset with the one time of a dataset that has no axis of time, and that time.
    pub(super) fn single_time(&self, file: &Hdf5File) -> Option<(Dataset, f64)> {
        let text = |a: Attribute| attribute_text(&a);
        let own = self.dataset.attribute("coordinates").ok().and_then(text);
        let all = file.root_group().ok().and_then(|root| root.attribute("coordinates").ok()).and_then(text);
        let coordinates = [own.unwrap_or_default(), all.unwrap_or_default()].join(" ");
        let group = self.part.array.rfind('/').map_or("", |at| &self.part.array[..=at]);
        cf::names_of_time(&coordinates).find_map(|(name, most_axes)| {
            let path = format!("{group}{name}");
            let found = file.dataset(&path).or_else(|_| file.dataset(name)).ok()?;
            let is_one = found.ndim() <= most_axes && found.num_elements().is_ok_and(|n| n == 1);
            let time = Some(found).filter(|found| is_one && kind_of_line(&path, found) == 't')?;
            let (scalar, _) = scalar_of(Path::new(""), "", &time).ok()?;
            let value = all_f64(&time, scalar).ok()?.first().copied()?;
            Some((time, value))
        })
    }
}
