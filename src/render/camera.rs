//! From the world to the samples of an image.

use crate::surface::SurfaceSource;
use glam::DVec3;
use isospan_io::error::{Error, Result};
use std::str::FromStr;

/// Which way is up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Up {
    axis: usize,
    down: bool,
}

impl Up {
    /// The z axis, as in most scans.
    pub const Z: Self = Self { axis: 2, down: false };
}

impl FromStr for Up {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let (down, name) = text.strip_prefix('-').map_or((false, text), |rest| (true, rest));
        match ["x", "y", "z"].iter().position(|a| *a == name) {
            Some(axis) => Ok(Self { axis, down }),
            None => Err(Error::usage(format!("'{text}' is no direction: write x, y, z, -x, -y or -z"))),
        }
    }
}

/// Where a surface is seen from. The camera looks at the middle of what is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Degrees around the upward axis, counter-clockwise seen from above; at 0 the camera looks
    /// along the axis that follows the upward one (x for z).
    pub azimuth: f64,
    /// Degrees above the horizon, -90 to 90.
    pub elevation: f64,
    /// Which way is up.
    pub up: Up,
    /// 1 fills the image.
    pub zoom: f64,
    /// Far things are smaller; else all rays are parallel.
    pub perspective: bool,
}

impl Default for Camera {
    fn default() -> Self {
        Self { azimuth: 30.0, elevation: 20.0, up: Up::Z, zoom: 1.0, perspective: true }
    }
}

/// Distance of a perspective camera from the middle, in radii of the sphere around all.
const DISTANCE: f64 = 3.6;
/// The part of the image that is filled.
const FILLED: f64 = 0.94;

/// A camera in front of surfaces. In *camera space* x is to the right, y up, z to the viewer, and
/// the sphere around everything that it was made for has radius 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    axes: [DVec3; 3],
    centre: DVec3,
    radius: f64,
    perspective: bool,
    /// Pixels a unit of camera space, and the middle of what is seen, in pixels from the axis.
    scale: f64,
    shift: [f64; 2],
    size: [u32; 2],
}

impl View {
    /// The view in which some surfaces, together, fill an image of `size` pixels.
    ///
    /// # Errors
    /// Those of [`View::fit_all`].
    pub fn fit(camera: &Camera, surfaces: &[&dyn SurfaceSource], size: [u32; 2]) -> Result<Self> {
        Ok(Self::fit_all(&[*camera], surfaces, size)?[0])
    }

    /// Views from several places, of one scale and with one middle, as of a film: in none of them
    /// do the surfaces leave the image, unless they are magnified.
    ///
    /// # Errors
    /// [`Error::Usage`] for a camera or a size that cannot be, or surfaces without a vertex; those
    /// of reading them.
    pub fn fit_all(cameras: &[Camera], surfaces: &[&dyn SurfaceSource], size: [u32; 2]) -> Result<Vec<Self>> {
        let is_camera = |c: &Camera| {
            let angles = c.azimuth.is_finite() && (-90.0..=90.0).contains(&c.elevation);
            angles && c.zoom > 0.0 && c.zoom <= 1e6
        };
        if !cameras.iter().all(is_camera) {
            return Err(Error::usage(
                "a camera has an elevation of -90 to 90 degrees and a zoom above 0, at most 1e6",
            ));
        }
        if size.iter().any(|s| !(16..=16_384).contains(s)) {
            return Err(Error::usage("a picture is 16 to 16384 pixels wide and high"));
        }
        let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        each_vertex(surfaces, |p| (lo, hi) = (lo.min(p), hi.max(p)))?;
        if !(lo.is_finite() && hi.is_finite()) {
            return Err(Error::usage("there is nothing to draw: the surface has no vertex"));
        }
        let radius = (hi - lo).length() / 2.0;
        let view = |camera: &Camera| Self {
            axes: axes(camera),
            centre: (lo + hi) / 2.0,
            // Any radius does for a single point.
            radius: if radius > 0.0 { radius } else { 1.0 },
            perspective: camera.perspective,
            scale: 1.0,
            shift: [0.0; 2],
            size,
        };
        let mut views: Vec<Self> = cameras.iter().map(view).collect();
        let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        each_vertex(surfaces, |p| {
            for view in &views {
                let c = view.in_camera_space(p);
                let f = view.nearness(c.z);
                for (k, x) in [c.x * f, c.y * f].into_iter().enumerate() {
                    (lo[k], hi[k]) = (lo[k].min(x), hi[k].max(x));
                }
            }
        })?;
        let room = |k: usize| f64::from(size[k]) / (hi[k] - lo[k]).max(1e-9);
        for (view, camera) in views.iter_mut().zip(cameras) {
            view.scale = FILLED * room(0).min(room(1)) * camera.zoom;
            view.shift = [0, 1].map(|k| (lo[k] + hi[k]) / 2.0 * view.scale);
        }
        Ok(views)
    }

    /// The length in the world that a pixel shows; in perspective, at the depth of the middle of
    /// what is drawn.
    pub fn pixel(&self) -> f64 {
        self.radius / self.scale
    }

    /// Pixels along x and y.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// A world position in camera space.
    pub(super) fn in_camera_space(&self, p: DVec3) -> DVec3 {
        let d = (p - self.centre) / self.radius;
        DVec3::from_array(self.axes.map(|a| a.dot(d)))
    }

    /// A world direction in camera space.
    pub(super) fn turn(&self, d: [f32; 3]) -> [f32; 3] {
        let d = DVec3::from_array(d.map(f64::from));
        self.axes.map(|a| a.dot(d) as f32)
    }

    /// How much larger than in the middle a thing appears; in a parallel view 1.
    fn nearness(&self, z: f64) -> f64 {
        if self.perspective { DISTANCE / (DISTANCE - z) } else { 1.0 }
    }

    /// Pixels from the left and from the top, and a depth that is affine on the image and grows
    /// towards the viewer.
    pub(super) fn project(&self, c: DVec3) -> ([f64; 2], f64) {
        let f = self.nearness(c.z);
        let x = f64::from(self.size[0]) / 2.0 + c.x * f * self.scale - self.shift[0];
        let y = f64::from(self.size[1]) / 2.0 - (c.y * f * self.scale - self.shift[1]);
        ([x, y], if self.perspective { f } else { c.z })
    }

    /// The place in camera space of a projected position.
    pub(super) fn unproject(&self, [x, y]: [f64; 2], depth: f64) -> [f32; 3] {
        let (f, z) = if self.perspective { (depth, DISTANCE * (1.0 - 1.0 / depth)) } else { (1.0, depth) };
        let side = (x - f64::from(self.size[0]) / 2.0 + self.shift[0]) / (f * self.scale);
        let above = (f64::from(self.size[1]) / 2.0 - y + self.shift[1]) / (f * self.scale);
        [side as f32, above as f32, z as f32]
    }

    /// Whether far things are smaller.
    pub(super) fn is_perspective(&self) -> bool {
        self.perspective
    }

    /// The direction from a place in camera space to the viewer.
    pub(super) fn viewer_from(&self, p: [f32; 3]) -> [f32; 3] {
        if !self.perspective {
            return [0.0, 0.0, 1.0];
        }
        super::unit([-p[0], -p[1], DISTANCE as f32 - p[2]])
    }
}

/// Right, up and towards the viewer, in the world.
fn axes(camera: &Camera) -> [DVec3; 3] {
    let unit = |axis: usize| DVec3::from_array(std::array::from_fn(|k| f64::from(u8::from(k == axis % 3))));
    let sign = if camera.up.down { -1.0 } else { 1.0 };
    // Two axes that make a right-handed system with the upward one.
    let (up, side, ahead) =
        (unit(camera.up.axis) * sign, unit(camera.up.axis + 2) * sign, unit(camera.up.axis + 1));
    let (azimuth, elevation) = (camera.azimuth.to_radians(), camera.elevation.to_radians());
    // At 0 degrees the camera stands on the negative `ahead` axis.
    let around = ahead * -libm::cos(azimuth) + side * -libm::sin(azimuth);
    let back = around * libm::cos(elevation) + up * libm::sin(elevation);
    let above = up * libm::cos(elevation) - around * libm::sin(elevation);
    [above.cross(back), above, back]
}

fn each_vertex(surfaces: &[&dyn SurfaceSource], mut each: impl FnMut(DVec3)) -> Result<()> {
    for surface in surfaces {
        let origin = surface.origin();
        surface.vertices(&mut |batch| {
            batch.iter().for_each(|v| each(DVec3::from_array(v.world(origin))));
            Ok(())
        })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::{TriMesh, Vertex};

    fn box_of(hi: [f32; 3]) -> TriMesh {
        let corner = |n: u32| Vertex {
            position: std::array::from_fn(|a| if n >> a & 1 == 1 { hi[a] } else { 0.0 }),
            normal: [0.0; 3],
        };
        TriMesh { vertices: (0..8).map(corner).collect(), triangles: vec![], ..TriMesh::default() }
    }

    #[test]
    fn a_view_is_right_handed_and_filled_and_can_be_undone() {
        let mesh = box_of([4.0, 2.0, 1.0]);
        for up in ["x", "y", "z", "-x", "-y", "-z"] {
            for perspective in [false, true] {
                let camera = Camera { up: up.parse().unwrap(), perspective, ..Camera::default() };
                let view = View::fit(&camera, &[&mesh], [300, 200]).unwrap();
                let [x, y, z] = view.axes;
                assert!((x.cross(y) - z).length() < 1e-12 && (x.length() - 1.0).abs() < 1e-12);
                let (mut lo, mut hi) = ([f64::MAX; 2], [f64::MIN; 2]);
                for v in &mesh.vertices {
                    let c = view.in_camera_space(DVec3::from_array(v.position.map(f64::from)));
                    let (at, depth) = view.project(c);
                    for k in 0..2 {
                        (lo[k], hi[k]) = (lo[k].min(at[k]), hi[k].max(at[k]));
                    }
                    let back = view.unproject(at, depth);
                    assert!((DVec3::from_array(back.map(f64::from)) - c).length() < 1e-5);
                }
                let filled = ((hi[0] - lo[0]) / 300.0).max((hi[1] - lo[1]) / 200.0);
                assert!((filled - FILLED).abs() < 1e-9, "{filled}");
                assert!(
                    ((lo[0] + hi[0]) / 2.0 - 150.0).abs() < 1e-9
                        && ((lo[1] + hi[1]) / 2.0 - 100.0).abs() < 1e-9
                );
            }
        }
    }

    #[test]
    fn up_is_up_and_azimuth_turns_around_it() {
        let up = |text: &str| text.parse::<Up>().unwrap();
        let seen = |azimuth, elevation, text: &str| {
            axes(&Camera { azimuth, elevation, up: up(text), ..Camera::default() })
        };
        let near = |a: DVec3, b: [f64; 3]| assert!((a - DVec3::from_array(b)).length() < 1e-12, "{a} {b:?}");
        let [right, above, back] = seen(0.0, 0.0, "z");
        near(right, [0.0, -1.0, 0.0]);
        near(above, [0.0, 0.0, 1.0]);
        near(back, [-1.0, 0.0, 0.0]);
        near(seen(90.0, 0.0, "z")[2], [0.0, -1.0, 0.0]);
        near(seen(0.0, 90.0, "z")[2], [0.0, 0.0, 1.0]);
        near(seen(0.0, 0.0, "-y")[1], [0.0, -1.0, 0.0]);
        assert!("w".parse::<Up>().is_err());
    }

    #[test]
    fn what_cannot_be_seen_is_refused() {
        let mesh = box_of([1.0; 3]);
        let camera = Camera { zoom: 0.0, ..Camera::default() };
        assert_eq!(View::fit(&camera, &[&mesh], [100, 100]).unwrap_err().exit_code(), 2);
        let camera = Camera { elevation: 91.0, ..Camera::default() };
        assert!(View::fit(&camera, &[&mesh], [100, 100]).is_err());
        assert!(View::fit(&Camera::default(), &[&mesh], [0, 100]).is_err());
        assert!(View::fit(&Camera::default(), &[&TriMesh::default()], [100, 100]).is_err());
    }
}
