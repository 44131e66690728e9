//! Our own bricked copies of volumes.

use crate::error::Result;
use crate::formats::shared::format::{Format, Head};
use crate::formats::shared::{OpenOptions, pick_field};
use crate::volume::bricked::{self, BrickedVolume};
use crate::volume::{VolumeReader, VolumeSource};
use std::path::Path;

/// A file of bricks.
pub(in crate::formats) struct Bricks;

impl Format for Bricks {
    fn name(&self) -> &'static str {
        "an isospan .bricks file"
    }

    fn suffixes(&self) -> &'static [&'static str] {
        &[".bricks"]
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        head.bytes.starts_with(&bricked::MAGIC)
    }

    fn volume(&self, path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
        let volume = BrickedVolume::open_with(path, options.io)?;
        pick_field(path, &volume.info().fields, options.field.as_deref())?;
        Ok(VolumeSource::Random(Box::new(volume)))
    }
}
