//! Being written: opening one is refused until it is.
use crate::volume::*;
/// Being written.
pub const MAGIC: [u8; 8] = *b"\x89IspB\r\n\x1a";
/// Being written.
pub struct BrickedVolume(VolumeInfo);
impl BrickedVolume {
    /// Being written.
    pub fn open(path: &std::path::Path) -> Result<Self> {
        Err(crate::Error::bad_input(
            path,
            "kind of file",
            "an implemented format",
            "one that is not read yet",
        ))
    }
}
impl VolumeReader for BrickedVolume {
    fn info(&self) -> &VolumeInfo {
        &self.0
    }
    fn read_box(&self, _v: IndexBox, _o: &mut [f32]) -> Result<()> {
        Err(crate::Error::usage("x"))
    }
}
