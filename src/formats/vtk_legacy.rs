//! Being written: opening one is refused until it is.
use super::*;
/// Being written.
pub fn open(path: &Path, _o: &OpenOptions) -> Result<VolumeSource> {
    Err(Error::bad_input(path, "kind of file", "an implemented format", "one that is not read yet"))
}
