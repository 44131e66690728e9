//! The times of the steps in a file, and of a file that is one step.

use super::dialect::{self, Dialect};
use super::{Hdf5Field, Opened, all_f64, attribute_text, kind_of_line, scalar_of};
use crate::error::Result;
use crate::formats::shared::{Frames, OpenOptions, cf};
use hdf5_reader::attribute_api::Attribute;
use hdf5_reader::{Dataset, Hdf5File};
use std::collections::HashMap;
use std::path::Path;

impl Opened {
    /// The frames of the dataset with four axes that is `wanted`, or of the file's only one, by the
    /// names of their fields, and their times, where the axis of time has coordinates. None of
    /// others.
    pub(super) fn frames_of(&self, options: &OpenOptions) -> Result<Frames> {
        let tree = &self.tree;
        let wanted = cf::with_channel(self.source.path(), options, tree.fields.iter().map(|f| &f.part))?;
        let number = match &wanted {
            Some(name) => tree.first_frame(&self.file, name),
            None => tree.fields.first().filter(|f| f.part.is_frame()).map(|_| 0),
        };
        let Some(first) = number.map(|n| &tree.fields[n]) else { return Ok(vec![]) };
        let parts = tree.fields.iter().map(|f| &f.part);
        Ok(cf::frames(parts, &first.part, wanted.is_some(), self.times_of(first)))
    }

    /// The time of the field that is read, or of all of them, where it is one time.
    pub(super) fn one_time(&self, options: &OpenOptions) -> Result<Option<f64>> {
        if !matches!(self.dialect, Dialect::Plain | Dialect::Minc) {
            return Ok(None);
        }
        if options.field.is_none() {
            return Ok(cf::common_time(self.tree.fields.iter(), |field| self.time_of(field)));
        }
        let number = self.pick(options)?.number;
        Ok(self.time_of(&self.tree.fields[number]))
    }

    /// The calendar of the times of the field that is read; "" where none is named.
    pub(super) fn calendar_of(&self, options: &OpenOptions) -> Result<String> {
        let number = self.pick(options)?.number;
        let field = &self.tree.fields[number];
        let of = |time: &Dataset| time.attribute("calendar").ok().and_then(|a| attribute_text(&a));
        let found = match field.part.time {
            Some(axis) => {
                let line = self.tree.line_of(&field.part.array, &field.dataset, axis);
                line.and_then(|(_, time)| of(time))
            }
            None => field.single_time(&self.file).and_then(|(time, _)| of(&time)),
        };
        Ok(found.unwrap_or_default())
    }

    /// The times of frames by the names of their fields, where their datasets have them.
    pub(super) fn all_times(&self) -> HashMap<String, f64> {
        cf::times(self.tree.fields.iter(), |field| self.times_of(field))
    }

    /// The times of the frames of a field's dataset.
    fn times_of(&self, field: &Hdf5Field) -> Option<Vec<f64>> {
        self.line_of_time(field, field.part.frames?)
    }

    fn line_of_time(&self, field: &Hdf5Field, axis: usize) -> Option<Vec<f64>> {
        match self.dialect {
            Dialect::Minc => dialect::minc_times(self.source.path(), &self.file, field.dataset.shape()[axis]),
            _ => field.line(axis, &self.tree),
        }
    }

    /// The time of a field.
    fn time_of(&self, field: &Hdf5Field) -> Option<f64> {
        match field.part.time {
            Some(axis) => self.line_of_time(field, axis)?.get(field.part.entries[axis] as usize).copied(),
            None if self.dialect == Dialect::Plain => field.single_time(&self.file).map(|(_, time)| time),
            None => None,
        }
    }
}

impl Hdf5Field {
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
