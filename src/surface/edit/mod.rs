//! Changes to a finished surface.
//!
//! * [`clip`] cuts it at planes.
//! * [`components`] measures the connected components and keeps some.
//! * [`decimate`] makes do with fewer triangles, by the edges that `collapse` takes away.
//! * [`smooth`] moves vertices, within a distance.
//! * [`faces`] are those of the domain, on which caps lie.
//! * [`fans`] splits vertices at which a surface touches itself, where tetrahedra are missing.

pub mod clip;
mod collapse;
pub mod components;
pub mod decimate;
pub mod faces;
pub mod fans;
pub mod smooth;
