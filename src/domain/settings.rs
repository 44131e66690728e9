//! How a mesh becomes files.

use isospan_io::exec::CancelToken;
use std::path::PathBuf;

/// How a value that is no finite number is treated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum BadValue {
    Refuse,
    Void,
    Use(f32),
}

/// How a mesh is read.
#[derive(Clone)]
pub(crate) struct StoreSettings {
    /// Bytes for sorting.
    pub(crate) memory: u64,
    /// Folder for the files.
    pub(crate) scratch: PathBuf,
    pub(crate) bad_value: BadValue,
    pub(crate) missing: Option<f64>,
    /// The offset subtracted from all values before they become `f32`; [`BadValue::Use`] is meant
    /// after that.
    pub(crate) offset: f64,
    pub(crate) cancel: CancelToken,
}
