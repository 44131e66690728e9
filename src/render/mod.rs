//! Pictures of surfaces, without a graphics card or a window: the same bytes on every machine, for
//! any number of threads.
//!
//! ```text
//!  vertices ─▶ camera space ─▶ store        triangles, batch by batch ─┬─▶ samples of the image: depth, normal, value
//!  (once, beyond memory on disk)                                       └─▶ a depth map for each light of the sky
//!                                                         then: light of each pixel ─▶ mean of its samples ─▶ image
//! ```
//!
//! **Visibility** is a z-buffer of s × s samples a pixel. Corners are rounded to 1/256 of a sample
//! and edges tested in integers, with the top-left rule, so that triangles with a common edge leave
//! neither a gap nor an overlap; of equal depths the triangle that came first is seen. Rows are
//! shared out to threads, each of which takes the triangles in order.
//!
//! **Light** comes from a sky of about a hundred directions: brightest above the viewer's left
//! shoulder (the *key*), weaker from the right (the *fill*), even elsewhere. Each direction has a
//! depth map of the whole surface, and what lies behind another part gets no light from it: soft
//! shadows and ambient occlusion in one, of the scene and not of the screen (compare Tarini,
//! Cignoni and Montani, "Ambient occlusion and edge cueing for enhancing real time molecular
//! visualization", 2006). Colours are added up linearly and encoded as sRGB in the end.
//! Transparent surfaces, and those that show a colour map, throw no shadow.
//!
//! Normals are interpolated between vertices, turned to the viewer with their triangle; the far
//! side of an open surface is drawn darker.
//!
//! Cost: some microseconds a triangle (most of it for the maps), about a microsecond a pixel; of a
//! transparent picture, a microsecond a triangle and a pixel for each layer.
//! Memory ([`needed`]): samples and maps, for any surface; vertices that do not fit in the rest
//! wait on disk.

mod camera;
mod colour;
mod colour_map;
mod light;
mod samples;
mod shade;
#[cfg(test)]
mod tests;

pub use camera::{Camera, Up, View};
pub use colour::{Paint, SEQUENTIAL, parse_colour, scale_colour};
pub use colour_map::ColourMap;

use crate::surface::SurfaceSource;
use glam::{DVec3, Vec3};
use isospan_io::bytes::store::{Cached, Store};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Resources, pool};
use light::Sky;
use rayon::prelude::*;
use samples::{Corner, Samples};
use shade::Picture;

/// How a picture is made.
#[derive(Clone, Debug)]
pub struct RenderSettings {
    /// Samples along each side of a pixel.
    pub samples: u32,
    /// Directions of the sky; 0 for light without shadows.
    pub lights: u32,
    /// Whether triangles are flat: normals of triangles instead of those of vertices.
    pub flat: bool,
    /// Red, green, blue, opacity where there is no surface.
    pub background: [u8; 4],
    /// Threads, memory, scratch folder, and what stops it.
    pub resources: Resources,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self { samples: 3, lights: 128, flat: false, background: [255; 4], resources: Resources::default() }
    }
}

/// A picture: red, green, blue, opacity of each pixel, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels along x and y.
    pub size: [u32; 2],
    /// The pixels.
    pub pixels: Vec<[u8; 4]>,
}

/// What is drawn.
#[derive(Clone, Copy)]
pub struct Subject<'a> {
    /// The surface.
    pub surface: &'a dyn SurfaceSource,
    /// Its colour.
    pub paint: Paint,
    /// The share of the light behind it that it stops: above 0, and 1 for an opaque surface.
    pub opacity: f32,
    /// A number for each vertex, if colours show it; empty otherwise.
    pub values: &'a [f32],
}

/// A vertex in camera space.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct CameraVertex {
    position: [f32; 3],
    normal: [f32; 3],
    value: f32,
}

/// What the process needs besides samples and maps, triangles at work included.
const FIXED: u64 = 24 << 20;
/// Triangles that are drawn at a time.
const BATCH: usize = 1 << 14;

/// Subjects of a picture, at most.
const MOST: usize = samples::MOST_SUBJECTS;

/// The least memory for a picture of such a size, the picture itself included, without vertices; it
/// is the same for any surfaces, but more where one of them is transparent.
pub fn needed(size: [u32; 2], settings: &RenderSettings, transparent: bool) -> u64 {
    let pixels = u64::from(size[0]) * u64::from(size[1]);
    let sample = samples::BYTES + if transparent { samples::LAYER_BYTES } else { 0 };
    let each = sample * u64::from(settings.samples).pow(2) + shade::BYTES + 4;
    FIXED + pixels.saturating_mul(each) + light::bytes(settings.lights)
}

/// Draws surfaces into one picture.
///
/// # Errors
/// [`Error::Usage`] for settings or opacities that cannot be; [`Error::Budget`] when the memory
/// does not suffice: a surface without normals takes 12 bytes a vertex for them, unless triangles
/// are flat; those of reading the surfaces.
pub fn render(subjects: &[Subject<'_>], view: &View, settings: &RenderSettings) -> Result<Image> {
    if !(1..=8).contains(&settings.samples) || settings.lights > 1024 {
        return Err(Error::usage("a pixel has 1 to 8 samples a side, a sky at most 1024 lights"));
    }
    let transparent = check(subjects)?;
    let least = needed(view.size(), settings, transparent);
    let Some(rest) = settings.resources.memory.checked_sub(least) else {
        return Err(too_little(least, settings));
    };
    let rest = usize::try_from(rest).unwrap_or(usize::MAX);
    // Half for the vertices of all, half for the triangles at work.
    let each = rest / 2 / subjects.len().max(1);
    let scene: Vec<Scenery<'_>> =
        subjects.iter().map(|s| Scenery::new(s, view, [each, rest / 2], settings)).collect::<Result<_>>()?;
    let looks: Vec<Look> = subjects.iter().map(|s| Look { paint: s.paint, opacity: s.opacity }).collect();
    let pool = pool(settings.resources.threads)?;
    let mut sky = Sky::new(settings.lights);
    let mut samples = Samples::new(view, settings.samples, transparent);
    let mut picture = Picture::new(view, settings.background);
    for pass in 0.. {
        let mut first = 0;
        for (number, part) in (0u16..).zip(&scene) {
            part.each_batch(rest / 2, settings, |batch| {
                let (normals, throws_shadows) = (part.normals, looks[usize::from(number)].throws_shadows());
                pool.install(|| {
                    let corners: Vec<[Corner; 3]> =
                        batch.par_iter().map(|t| corners(t, view, &samples, normals)).collect();
                    samples.draw(&corners, number, first);
                    if pass == 0 && throws_shadows {
                        sky.draw(batch);
                    }
                });
                first = u32::wrapping_add(first, batch.len() as u32);
            })?;
        }
        settings.resources.cancel.check()?;
        if !pool.install(|| picture.add(&mut samples, &sky, view, &looks)) {
            break;
        }
    }
    let pixels = pool.install(|| picture.pixels(samples.side));
    Ok(Image { size: view.size(), pixels })
}

/// Checks the subjects; returns whether one of them is transparent.
fn check(subjects: &[Subject<'_>]) -> Result<bool> {
    if subjects.len() > MOST {
        return Err(Error::usage(format!("a picture has at most {MOST} surfaces")));
    }
    for s in subjects {
        if !s.values.is_empty() && s.values.len() as u64 != s.surface.vertex_count() {
            return Err(Error::usage("a value for each vertex, or none"));
        }
        if !(s.opacity > 0.0 && s.opacity <= 1.0) {
            return Err(Error::usage("an opacity is above 0, and at most 1"));
        }
    }
    let transparent = subjects.iter().any(|s| s.opacity < 1.0);
    let triangles: u64 = subjects.iter().map(|s| s.surface.triangle_count()).sum();
    if transparent && u32::try_from(triangles).is_err() {
        return Err(Error::usage("a picture with transparent surfaces has fewer than 2^32 triangles"));
    }
    Ok(transparent)
}

fn too_little(needed: u64, settings: &RenderSettings) -> Error {
    Error::memory("", needed, settings.resources.memory)
}

/// How a subject looks.
#[derive(Clone, Copy)]
struct Look {
    paint: Paint,
    opacity: f32,
}

impl Look {
    /// Whether light changes its colours.
    fn is_lit(self) -> bool {
        !matches!(self.paint, Paint::Flat(..))
    }

    fn throws_shadows(self) -> bool {
        self.opacity == 1.0 && self.is_lit()
    }
}

/// A subject in camera space.
struct Scenery<'a> {
    surface: &'a dyn SurfaceSource,
    vertices: Store<CameraVertex>,
    normals: Normals,
}

impl<'a> Scenery<'a> {
    /// Places a subject; `memory` is for its vertices, and for reading them.
    fn new(
        subject: &Subject<'a>,
        view: &View,
        [held, read]: [usize; 2],
        settings: &RenderSettings,
    ) -> Result<Self> {
        let surface = subject.surface;
        let flat = settings.flat || matches!(subject.paint, Paint::Flat(..));
        let given = !flat && has_normals(surface)?;
        let made = if given || flat { 0 } else { 12 * surface.vertex_count() };
        let Some(rest) = read.checked_sub(usize::try_from(made).unwrap_or(usize::MAX)) else {
            let missing = 2 * (made - read as u64);
            return Err(too_little(settings.resources.memory + missing, settings));
        };
        let mut vertices = place(subject, view, held, settings)?;
        let normals = if flat {
            Normals::OfTriangles
        } else if given && !normals_agree(surface, &vertices, read)? {
            Normals::Turned
        } else {
            Normals::Given
        };
        if !given && !flat {
            add_normals(surface, &mut vertices, rest)?;
        }
        Ok(Self { surface, vertices, normals })
    }

    /// Hands out all triangles, some at a time, with their vertices; those that name a vertex that
    /// there is not are left out.
    fn each_batch(
        &self,
        memory: usize,
        settings: &RenderSettings,
        mut each: impl FnMut(&[[CameraVertex; 3]]),
    ) -> Result<()> {
        let (vertices, surface) = (&self.vertices, self.surface);
        let mut cached = Cached::new(vertices, memory);
        let mut batch: Vec<[CameraVertex; 3]> = Vec::with_capacity(BATCH);
        surface.triangles(&mut |triangles| {
            for t in triangles.iter().filter(|t| t.iter().all(|&v| u64::from(v) < vertices.len())) {
                batch.push([cached.get(t[0].into())?, cached.get(t[1].into())?, cached.get(t[2].into())?]);
                if batch.len() == BATCH {
                    settings.resources.cancel.check()?;
                    each(&batch);
                    batch.clear();
                }
            }
            Ok(())
        })?;
        each(&batch);
        Ok(())
    }
}

fn has_normals(surface: &dyn SurfaceSource) -> Result<bool> {
    let mut any = false;
    surface.vertices(&mut |batch| {
        any |= batch.iter().any(|v| v.normal != [0.0; 3]);
        Ok(())
    })?;
    Ok(any)
}

/// All vertices, in camera space.
fn place(
    subject: &Subject<'_>,
    view: &View,
    memory: usize,
    settings: &RenderSettings,
) -> Result<Store<CameraVertex>> {
    let mut vertices = Store::new(memory, &settings.resources.scratch_folder());
    let (mut values, origin) = (subject.values.iter(), subject.surface.origin());
    subject.surface.vertices(&mut |batch| {
        for v in batch {
            let position = view.in_camera_space(DVec3::from_array(v.world(origin))).as_vec3();
            let value = values.next().copied().unwrap_or(0.0);
            vertices.push(CameraVertex {
                position: position.to_array(),
                normal: view.turn(v.normal),
                value,
            })?;
        }
        settings.resources.cancel.check()
    })?;
    Ok(vertices)
}

/// Gives each vertex the sum of its triangles' normals, weighted by area, added in the order of the
/// triangles.
fn add_normals(surface: &dyn SurfaceSource, vertices: &mut Store<CameraVertex>, memory: usize) -> Result<()> {
    let count = vertices.len();
    let mut normals = vec![Vec3::ZERO; count as usize];
    let mut cached = Cached::new(vertices, memory);
    surface.triangles(&mut |batch| {
        for t in batch.iter().filter(|t| t.iter().all(|&v| u64::from(v) < count)) {
            let [a, b, c] = [cached.get(t[0].into())?, cached.get(t[1].into())?, cached.get(t[2].into())?]
                .map(|v| Vec3::from_array(v.position));
            let normal = (b - a).cross(c - a);
            t.iter().for_each(|&v| normals[v as usize] += normal);
        }
        Ok(())
    })?;
    let mut first = 0u32;
    for part in normals.chunks(BATCH) {
        let patches: Vec<(u32, [f32; 3])> =
            (first..).zip(part).map(|(n, v)| (n, unit(v.to_array()))).collect();
        vertices.patch(&patches, |_, placed, normal| placed.normal = *normal)?;
        first += part.len() as u32;
    }
    Ok(())
}

/// Which normals are drawn.
#[derive(Clone, Copy)]
enum Normals {
    Given,
    /// The given normals, the other way round.
    Turned,
    OfTriangles,
}

/// Triangles that are asked whether normals agree with them.
const ASKED: usize = 1 << 16;

/// Whether the vertices' normals point to the side from which triangles are counter-clockwise: some
/// programs have it otherwise. By area, for in slivers they may differ.
fn normals_agree(surface: &dyn SurfaceSource, vertices: &Store<CameraVertex>, memory: usize) -> Result<bool> {
    let (mut cached, count) = (Cached::new(vertices, memory), vertices.len());
    let (mut asked, mut sum) = (0, 0.0f64);
    surface.triangles(&mut |batch| {
        let good = batch.iter().filter(|t| t.iter().all(|&v| u64::from(v) < count));
        for t in good.take(ASKED - asked) {
            let corners = [cached.get(t[0].into())?, cached.get(t[1].into())?, cached.get(t[2].into())?];
            let [a, b, c] = corners.map(|v| Vec3::from_array(v.position));
            let normal = corners.iter().fold(Vec3::ZERO, |sum, v| sum + Vec3::from_array(v.normal));
            sum += f64::from((b - a).cross(c - a).dot(normal));
            asked += 1;
        }
        Ok(())
    })?;
    Ok(sum >= 0.0)
}

/// The corners of a triangle on the image, their normals on the viewer's side of it.
fn corners(triangle: &[CameraVertex; 3], view: &View, samples: &Samples, normals: Normals) -> [Corner; 3] {
    let [a, b, c] = triangle.map(|v| Vec3::from_array(v.position));
    let plane = (b - a).cross(c - a);
    let faces_us = plane.dot(Vec3::from_array(view.viewer_from(a.to_array()))) >= 0.0;
    triangle.map(|v| {
        let (at, depth) = view.project(Vec3::from_array(v.position).as_dvec3());
        let normal = match normals {
            Normals::Given if v.normal != [0.0; 3] => Vec3::from_array(v.normal),
            Normals::Turned if v.normal != [0.0; 3] => -Vec3::from_array(v.normal),
            _ => plane,
        };
        let normal = if faces_us { normal } else { -normal };
        Corner {
            at: samples.snap(at),
            depth: depth as f32,
            normal: unit(normal.to_array()),
            value: v.value,
            is_back: !faces_us,
        }
    })
}

/// A vector of length 1, or none.
fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if length > 0.0 { v.map(|c| c / length) } else { [0.0; 3] }
}
