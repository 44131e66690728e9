//! The `isospan` program as a library: what its binary, the Python package and the viewer's page
//! share. None of it is meant for other programs: they use the crate `isospan`.

#[doc(hidden)]
pub mod answers;
#[cfg(feature = "program")]
#[doc(hidden)]
pub mod commands;
