//! A structured volume in memory, whole: for comparisons only.

use isospan::exec::{CancelToken, Silent};
use isospan::formats::{OpenOptions, open_volume};
use isospan::grid::{Geometry, IndexBox};
use isospan::pipeline::brick;
use isospan::volume::VolumeSource;
use isospan::{Error, Result};
use std::path::Path;

/// Samples on a grid.
pub(crate) struct Volume {
    pub(crate) dims: [usize; 3],
    /// x fastest.
    pub(crate) samples: Vec<f32>,
    pub(crate) geometry: Geometry,
}

impl Volume {
    /// Reads a file of any format, by way of a bricked copy where it is compressed.
    ///
    /// # Errors
    /// Those of reading it; missing samples are refused.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let place = std::env::temp_dir();
        let folder = tempfile::tempdir().map_err(|e| Error::io("make a temporary folder in", &place, e))?;
        let reader = match open_volume(path, &OpenOptions::default())? {
            VolumeSource::Random(reader) => reader,
            packed => {
                let copy = folder.path().join("copy.bricks");
                brick(packed, &copy, 256 << 20, &CancelToken::new(), &Silent)?;
                match open_volume(&copy, &OpenOptions::default())? {
                    VolumeSource::Random(reader) => reader,
                    _ => unreachable!("bricks are read in any order"),
                }
            }
        };
        let info = reader.info();
        let whole = IndexBox::whole(info.dims);
        let mut samples = vec![0.0; whole.len()];
        reader.read_box(whole, &mut samples)?;
        if samples.iter().any(|v| !v.is_finite()) || info.dims.contains(&1) {
            return Err(Error::usage(format!("{}: only volumes without missing samples", path.display())));
        }
        Ok(Self { dims: info.dims.map(|d| d as usize), samples, geometry: info.geometry })
    }

    /// x² + y² + z² - 0.4² on [-½, ½]³, with noise of a size.
    pub(crate) fn sphere(side: usize, noise: f32) -> Self {
        let at = |i: usize| i as f32 / (side - 1) as f32 - 0.5;
        let mut state = 1u64;
        let mut random = || {
            // Knuth's linear congruential generator.
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
        };
        let value = |n: usize| {
            let [x, y, z] = super::coordinates([side; 3], n).map(at);
            x * x + y * y + z * z - 0.16 + noise * random()
        };
        let samples = (0..side.pow(3)).map(value).collect();
        Self { dims: [side; 3], samples, geometry: Geometry::default() }
    }
}
