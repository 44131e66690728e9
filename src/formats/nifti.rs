//! Being written: opening one is refused until it is.
use super::*;
/// Being written.
pub fn open(path: &Path, _o: &OpenOptions) -> Result<VolumeSource> {
    Err(Error::bad_input(path, "kind of file", "an implemented format", "one that is not read yet"))
}
/// Being written.
pub fn has_magic(head: &[u8]) -> bool {
    head.len() >= 348 && matches!(&head[344..348], b"n+1\0" | b"ni1\0")
}
