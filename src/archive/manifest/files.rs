//! Where the files of an archive lie in its folder.

use std::path::{Path, PathBuf};

/// Folder of the mesh.
pub fn mesh_folder(archive: &Path) -> PathBuf {
    archive.join("mesh")
}

/// Path of a mesh segment.
pub fn mesh_segment_path(archive: &Path, segment: u64) -> PathBuf {
    mesh_folder(archive).join(format!("{segment:06}.seg"))
}

/// Folder of the files of all steps.
pub fn steps_folder(archive: &Path) -> PathBuf {
    archive.join("steps")
}

/// The beginning of the names of a step's files.
pub fn step_prefix(step: u64) -> String {
    format!("{step:06}-")
}

fn of_step(archive: &Path, step: u64, name: &str) -> PathBuf {
    steps_folder(archive).join(step_prefix(step) + name)
}

/// Path of a value segment of a step.
pub fn values_segment_path(archive: &Path, step: u64, segment: u64) -> PathBuf {
    of_step(archive, step, &format!("values-{segment:06}.seg"))
}

/// Path of the sums of a segment of a step, which is there until the step is finished.
pub fn sums_segment_path(archive: &Path, step: u64, segment: u64) -> PathBuf {
    of_step(archive, step, &format!("sums-{segment:06}.seg"))
}

/// Path of the low coefficients of a segment of a pyramid's step, until the coarse levels are made.
pub fn low_segment_path(archive: &Path, step: u64, segment: u64) -> PathBuf {
    of_step(archive, step, &format!("low-{segment:06}.seg"))
}

/// Path of the coarse levels of a pyramid's step.
pub fn coarse_path(archive: &Path, step: u64) -> PathBuf {
    of_step(archive, step, "coarse.seg")
}

/// Path of the ranges and corrections of a segment of a pyramid's step.
pub fn ranges_segment_path(archive: &Path, step: u64, segment: u64) -> PathBuf {
    of_step(archive, step, &format!("ranges-{segment:06}.seg"))
}

/// Path of the index of a step.
pub fn index_path(archive: &Path, step: u64) -> PathBuf {
    of_step(archive, step, "index.seg")
}

/// Path of the contour spectrum of a step.
pub fn spectrum_path(archive: &Path, step: u64) -> PathBuf {
    of_step(archive, step, "spectrum.seg")
}

/// Path of the coordinates of a step's grid.
pub fn coordinates_path(archive: &Path, step: u64) -> PathBuf {
    of_step(archive, step, "coordinates.seg")
}

/// Whether a file of this name has the coordinates of a step's grid.
pub fn is_coordinates(name: &str) -> bool {
    name.ends_with("-coordinates.seg")
}
