//! How far is a surface from another one?

use serde::Serialize;

/// Distances of the vertices of a surface from another one, in world units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SurfaceDistance {
    /// The largest, and the place of that vertex in the world.
    pub max: f64,
    /// See `max`.
    pub max_at: [f64; 3],
    /// Mean over the area.
    pub mean: f64,
    /// Root mean square over the area.
    pub rms: f64,
    /// 95 % of the area is at most so far; no more than 1/1024 too large.
    pub p95: f64,
    /// 99 % of the area is at most so far; no more than 1/1024 too large.
    pub p99: f64,
}
