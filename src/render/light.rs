//! A sky of lights, and what each of them sees of the surface.

use super::CameraVertex;
use isospan_io::geom::vec3::{cross, dot};
use rayon::prelude::*;

/// Texels along each side of a light's depth map.
const SIDE: usize = 512;
/// Lights come from above this height, the viewer being at 1: what faces us gets nothing from
/// behind.
const LOWEST: f32 = -0.35;

/// Bytes of the maps.
pub(super) fn bytes(lights: u32) -> u64 {
    u64::from(lights) * (SIDE * SIDE * 4) as u64
}

struct Light {
    /// To the light, and two directions across.
    to: [f32; 3],
    across: [[f32; 3]; 2],
    /// Its strength; a surface that faces the key of an unhidden sky gets about 1 in all.
    strength: f32,
    /// For each texel how far towards the light the surface reaches.
    map: Vec<f32>,
}

/// All lights.
pub(super) struct Sky {
    lights: Vec<Light>,
    /// The lights of a sky without maps.
    open: Vec<([f32; 3], f32)>,
}

/// Directions, evenly on the part of the sphere above [`LOWEST`]: a Fibonacci lattice.
fn directions(count: u32) -> Vec<[f32; 3]> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let one = |i: u32| {
        let z = 1.0 - (f64::from(i) + 0.5) / f64::from(count) * (1.0 - f64::from(LOWEST));
        let (r, angle) = ((1.0 - z * z).sqrt(), golden * f64::from(i));
        [r * libm::cos(angle), r * libm::sin(angle), z].map(|c| c as f32)
    };
    (0..count).map(one).collect()
}

/// How bright the sky is in a direction: key, fill, and the rest, a little brighter above.
fn brightness(d: [f32; 3]) -> f32 {
    let lobe = |at: [f32; 3]| dot(d, super::unit(at)).max(0.0);
    let key = lobe([-0.55, 0.65, 0.55]);
    let fill = lobe([0.85, 0.05, 0.5]);
    0.2 + 0.14 * d[1].max(-0.8) + 3.6 * key * key * key * key * key + 0.4 * fill * fill
}

impl Sky {
    pub(super) fn new(lights: u32) -> Self {
        let all = directions(if lights == 0 { 96 } else { lights });
        // Normalised by what a surface gets that faces between key and viewer.
        let facing = super::unit([-0.3, 0.35, 0.9]);
        let whole: f32 = all.iter().map(|&d| brightness(d) * dot(d, facing).max(0.0)).sum();
        let strengths = all.iter().map(|&d| (d, brightness(d) / whole));
        if lights == 0 {
            return Self { lights: vec![], open: strengths.collect() };
        }
        let light = |(to, strength): ([f32; 3], f32)| {
            // Across: any two directions at right angles.
            let other = if to[0].abs() < 0.8 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
            let u = super::unit(cross(to, other));
            let map = vec![f32::NEG_INFINITY; SIDE * SIDE];
            Light { to, across: [u, cross(to, u)], strength, map }
        };
        Self { lights: strengths.map(light).collect(), open: vec![] }
    }

    /// Draws triangles into all maps.
    pub(super) fn draw(&mut self, triangles: &[[CameraVertex; 3]]) {
        self.lights.par_iter_mut().for_each(|light| triangles.iter().for_each(|t| light.draw(t)));
    }

    /// Adds up the light at a place, with a unit normal that all light is about: of each light its
    /// direction and what arrives.
    pub(super) fn arriving(&self, place: [f32; 3], normal: [f32; 3], out: &mut Vec<([f32; 3], f32)>) {
        out.clear();
        out.extend_from_slice(&self.open);
        out.extend(self.lights.iter().map(|l| (l.to, l.strength * l.visibility(place, normal))));
    }
}

/// A position across a light in texels; all is within the sphere of radius 1.
fn texel(c: f32) -> f32 {
    (c + 1.0) * (0.5 * SIDE as f32)
}

impl Light {
    fn draw(&mut self, triangle: &[CameraVertex; 3]) {
        let [u, v] = self.across;
        let [a, b, c] = triangle
            .map(|p| [texel(dot(u, p.position)), texel(dot(v, p.position)), dot(self.to, p.position)]);
        let side = |p: f32, q: f32, r: f32| {
            let (lo, hi) = (p.min(q).min(r), p.max(q).max(r));
            // Texels whose centres lie between.
            let first = (lo - 0.5).ceil().max(0.0) as usize;
            (first, ((hi - 0.5).floor().min(SIDE as f32 - 1.0) + 1.0).max(0.0) as usize)
        };
        let ((x0, x1), (y0, y1)) = (side(a[0], b[0], c[0]), side(a[1], b[1], c[1]));
        if x0 >= x1 || y0 >= y1 {
            return;
        }
        let edge = |p: [f32; 3], q: [f32; 3], x: f32, y: f32| {
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
        };
        let area = edge(a, b, c[0], c[1]);
        if area == 0.0 {
            return;
        }
        let inverse = 1.0 / area;
        for y in y0..y1 {
            for x in x0..x1 {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let w0 = edge(b, c, px, py) * inverse;
                let w1 = edge(c, a, px, py) * inverse;
                let w2 = 1.0 - w0 - w1;
                // A little beyond the edges: rounding must not leave gaps.
                if w0 >= -1e-4 && w1 >= -1e-4 && w2 >= -1e-4 {
                    let depth = w0 * a[2] + w1 * b[2] + w2 * c[2];
                    let texel = &mut self.map[y * SIDE + x];
                    *texel = texel.max(depth);
                }
            }
        }
    }

    /// The part of the light that reaches a place, 0 to 1: the share of the four texels around it
    /// that are not in front, by their nearness.
    fn visibility(&self, place: [f32; 3], normal: [f32; 3]) -> f32 {
        let facing = dot(normal, self.to);
        if facing <= 0.0 {
            return 0.0;
        }
        // Off the surface, the more so the more slanting the light: a texel is flat, the surface is
        // not.
        let step = 2.0 / SIDE as f32;
        let lift = step * (0.75 + 1.5 * (1.0 - facing));
        let p: [f32; 3] = std::array::from_fn(|k| place[k] + lift * normal[k]);
        let depth = dot(self.to, p) + step;
        let [x, y] = self.across.map(|a| texel(dot(a, p)) - 0.5);
        let (x, y) = (x.clamp(0.0, SIDE as f32 - 1.001), y.clamp(0.0, SIDE as f32 - 1.001));
        let (i, j) = (x as usize, y as usize);
        let (s, t) = (x - i as f32, y - j as f32);
        let free = |i: usize, j: usize| if self.map[j * SIDE + i] <= depth { 1.0 } else { 0.0 };
        let row = |j: usize| free(i, j) * (1.0 - s) + free(i + 1, j) * s;
        row(j) * (1.0 - t) + row(j + 1) * t
    }
}
