//! The samples of volumes, opened step by step.

use super::fields::Fields;
use super::series::{PlannedSource, SeriesPlan};
use crate::pipeline::chunk::{Field, GridField};
use crate::pipeline::inputs::{Reading, Scratch, random_access};
use crate::pipeline::settings::{CompleteSettings, RunSettings};
use isospan_io::error::{Error, Result};
use isospan_io::exec::Progress;
use isospan_io::formats::{Input, StepSource, UnpackedFrames};
use isospan_io::volume::unpacked::unpack;
use isospan_io::volume::{VolumeReader, VolumeSource};
use std::path::PathBuf;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};

/// The volume of a step, where it is one.
pub(super) fn volume_of(source: &StepSource, expected: &str) -> Result<VolumeSource> {
    match source.open()? {
        Input::Volume(volume) => Ok(volume),
        Input::Mesh(_) => Err(Error::bad_input(&source.path, "kind of file", expected, "a mesh")),
    }
}

pub(super) fn shape([x, y, z]: [u64; 3]) -> String {
    format!("{x} x {y} x {z}")
}

/// Opens volumes.
pub(super) struct VolumeFields<'a> {
    pub(super) settings: &'a CompleteSettings,
    pub(super) run: &'a RunSettings,
    pub(super) progress: &'a dyn Progress,
    /// Whether small copies are made in memory.
    in_memory: bool,
    unpacked: Mutex<Option<(PathBuf, Arc<UnpackedFrames>)>>,
}

impl<'a> VolumeFields<'a> {
    pub(super) fn new(
        settings: &'a CompleteSettings,
        run: &'a RunSettings,
        progress: &'a dyn Progress,
        in_memory: bool,
    ) -> Self {
        Self { settings, run, progress, in_memory, unpacked: Mutex::default() }
    }

    /// Opens a source that is read separately, with the copy that is made of it where one is
    /// needed.
    fn random_access(&self, planned: &PlannedSource) -> Result<(Box<dyn VolumeReader>, Option<Scratch>)> {
        match volume_of(&planned.source, "the volume it was")? {
            VolumeSource::Stream(stream) if self.in_memory && planned.is_small() => {
                Ok((Box::new(unpack(stream)?), None))
            }
            volume => random_access(volume, planned.cached, self.run, self.progress),
        }
    }

    /// The copy of a packed file: the one that was made last, or a new one.
    fn unpacked(&self, source: &StepSource) -> Result<Arc<UnpackedFrames>> {
        let mut last = self.unpacked.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, frames)) = last.as_ref().filter(|(path, _)| *path == source.path) {
            return Ok(Arc::clone(frames));
        }
        // The disk space of the last copy is freed before another one is made.
        *last = None;
        let resources = &self.run.resources;
        let frames = Arc::new(source.unpack(&resources.scratch_folder(), &resources.cancel)?);
        *last = Some((source.path.clone(), Arc::clone(&frames)));
        Ok(frames)
    }
}

impl Fields for VolumeFields<'_> {
    fn open<'a>(&'a self, series: &SeriesPlan, n: usize) -> Result<Field<'a>> {
        let (planned, step) = (&series.sources[n], &series.plan.steps[n]);
        let source = &planned.source;
        let (reader, scratch) = match planned.shared_copy {
            0 => self.random_access(planned)?,
            // Not opened separately, because a frame is found by decoding all frames before it.
            _ => (self.unpacked(source)?.open(&step.source.field)?, None),
        };
        if reader.info().dims != step.source.dims {
            let (expected, got) = (shape(step.source.dims), shape(reader.info().dims));
            return Err(Error::bad_input(&source.path, "dimensions", expected, got));
        }
        let reading = Reading::new(step.source.offset, self.settings.missing, self.settings.nan);
        Ok(Field::Grid(GridField {
            reader: reading.reader(reader),
            scratch,
            bricks: series.plan.mesh.bricks(),
            interpolation: step.interpolation,
            values: step.values,
            nan: self.settings.nan,
            stand_in: reading.stand_in(),
            missing: reading.missing(),
            released: AtomicU64::new(0),
        }))
    }
}
