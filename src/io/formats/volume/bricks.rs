//! Our own bricked copies of volumes.

use crate::error::Result;
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::{OpenOptions, pick_field};
use crate::volume::bricked::{self, BrickedVolume};
use crate::volume::{SharedVolume, VolumeReader, VolumeSource};
use std::sync::Arc;

/// A file of bricks.
pub(in crate::formats) struct Bricks;

static ABOUT: About = About {
    volumes: &[".bricks"],
    suffixes: &[".bricks"],
    magic: &[&bricked::MAGIC],
    ..About::named("an isospan .bricks file")
};

impl Format for Bricks {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        Ok(Box::new(BricksFile(Arc::new(BrickedVolume::of(head.file()?)?))))
    }
}

struct BricksFile(Arc<BrickedVolume>);

impl Dataset for BricksFile {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let info = self.0.info();
        pick_field(&info.path, &info.fields, options.field.as_deref())?;
        let volume: Arc<dyn VolumeReader> = Arc::clone(&self.0) as Arc<dyn VolumeReader>;
        Ok(VolumeSource::Random(Box::new(SharedVolume(volume))))
    }
}
