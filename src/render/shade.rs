//! From samples to pixels: light, colour, mean.

use super::colour::{encode, linear, scale_linear};
use super::light::Sky;
use super::samples::{Samples, Seen};
use super::{Paint, View};
use crate::geom::vec3::dot;
use rayon::prelude::*;

/// The share of a highlight that a surface reflects; a little, and wide.
const GLOSS: f32 = 0.05;
const KEY: [f32; 3] = [-0.543, 0.642, 0.543];

/// All pixels, row by row.
pub(super) fn shade(
    samples: &Samples,
    sky: &Sky,
    view: &View,
    paint: &Paint,
    background: [u8; 4],
) -> Vec<[u8; 4]> {
    let [width, height] = view.size().map(|s| s as usize);
    let shader = Shader { samples, sky, view, paint, background };
    let rows = (0..height).into_par_iter().map(|y| {
        let mut arriving = vec![];
        (0..width).map(|x| shader.pixel(x, y, &mut arriving)).collect::<Vec<_>>()
    });
    rows.collect::<Vec<_>>().concat()
}

struct Shader<'a> {
    samples: &'a Samples,
    sky: &'a Sky,
    view: &'a View,
    paint: &'a Paint,
    background: [u8; 4],
}

impl Shader<'_> {
    fn pixel(&self, x: usize, y: usize, arriving: &mut Vec<([f32; 3], f32)>) -> [u8; 4] {
        let side = self.samples.side;
        let all = (0..side * side).map(|n| (x * side + n % side, y * side + n / side));
        let covered: Vec<(usize, usize, f32, &Seen)> = all
            .filter_map(|(i, j)| self.samples.get(i, j).map(|(depth, seen)| (i, j, depth, seen)))
            .collect();
        let [r, g, b, opacity] = self.background;
        if covered.is_empty() {
            return self.background;
        }
        // Light is let in at one place of the pixel, that of the sample nearest to its middle.
        let middle = |c: &&(usize, usize, f32, &Seen)| {
            let off = |i: usize, p: usize| (2 * (i - p * side) + 1).abs_diff(side).pow(2);
            off(c.0, x) + off(c.1, y)
        };
        let &(i, j, depth, seen) = covered.iter().min_by_key(middle).expect("there is one");
        let place = self.place(i, j, depth);
        self.sky.arriving(place, self.towards_us(seen, place), arriving);
        let mut sum = [0.0f32; 3];
        for &(i, j, depth, seen) in &covered {
            let colour = self.colour(seen, self.place(i, j, depth), arriving);
            sum = std::array::from_fn(|k| sum[k] + colour[k]);
        }
        // The uncovered part shows the background, as much of it as is opaque.
        let (n, free) = (covered.len() as f32, (side * side - covered.len()) as f32);
        let through = free * f32::from(opacity) / 255.0;
        let behind = linear([r, g, b]);
        let mixed: [f32; 3] = std::array::from_fn(|k| (sum[k] + behind[k] * through) / (n + through));
        let [r, g, b] = mixed.map(encode);
        [r, g, b, ((n + through) / (n + free) * 255.0 + 0.5) as u8]
    }

    /// Where a sample's surface is, in camera space.
    fn place(&self, i: usize, j: usize, depth: f32) -> [f32; 3] {
        let side = self.samples.side as f64;
        let at = [(i as f64 + 0.5) / side, (j as f64 + 0.5) / side];
        self.view.unproject(at, f64::from(depth))
    }

    /// The normal; where interpolation has turned it away from the viewer, the nearest that is not.
    fn towards_us(&self, seen: &Seen, place: [f32; 3]) -> [f32; 3] {
        let (n, v) = (seen.normal(), self.view.viewer_from(place));
        let away = dot(n, v).min(0.0);
        let bent = super::unit(std::array::from_fn(|k| n[k] - away * v[k]));
        if bent == [0.0; 3] { v } else { bent }
    }

    fn colour(&self, seen: &Seen, place: [f32; 3], arriving: &[([f32; 3], f32)]) -> [f32; 3] {
        let normal = self.towards_us(seen, place);
        let light: f32 = arriving.iter().map(|&(to, strength)| strength * dot(to, normal).max(0.0)).sum();
        let mut albedo = match *self.paint {
            Paint::Plain(colour) => linear(colour),
            Paint::Normals => linear(normal.map(|c| (127.5 * (c + 1.0)).round() as u8)),
            Paint::Values([lo, hi]) => {
                scale_linear(if hi > lo { (seen.value - lo) / (hi - lo) } else { 0.0 })
            }
        };
        if seen.is_back() {
            albedo = albedo.map(|c| 0.55 * c);
        }
        let v = self.view.viewer_from(place);
        let half = super::unit(std::array::from_fn(|k| v[k] + KEY[k]));
        let shine = dot(normal, half).max(0.0);
        // The 14th power by products: how exact `powi` is differs from compiler to compiler.
        let (square, fourth) = (shine * shine, shine * shine * (shine * shine));
        let shine = GLOSS * (fourth * fourth * (fourth * square)) * light;
        albedo.map(|c| c * light + shine)
    }
}
