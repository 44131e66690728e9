//! From samples to pixels: light, colour, mean.

use super::colour::{encode, linear, scale_linear};
use super::light::Sky;
use super::samples::{Samples, VisiblePoint};
use super::{ColourMap, Look, Paint, View};
use isospan_io::geom::vec3::dot;
use rayon::prelude::*;

/// The share of a highlight that a surface reflects; a little, and wide.
const GLOSS: f32 = 0.05;
const KEY: [f32; 3] = [-0.543, 0.642, 0.543];

/// Less light than this behind the layers of a sample is not looked for.
const LEAST: f32 = 1.0 / 1024.0;

/// Bytes of a pixel at work.
pub(super) const BYTES: u64 = std::mem::size_of::<Pixel>() as u64;

/// The sum over the samples of a pixel.
#[derive(Clone, Copy, Default)]
struct Pixel {
    /// Light of the layers so far.
    light: [f32; 3],
    /// The share of the light behind that they stop, summed.
    solid: f32,
}

/// All pixels, row by row, layer added to layer.
pub(super) struct Picture {
    width: usize,
    background: [u8; 4],
    pixels: Vec<Pixel>,
}

impl Picture {
    pub(super) fn new(view: &View, background: [u8; 4]) -> Self {
        let [width, height] = view.size().map(|s| s as usize);
        Self { width, background, pixels: vec![Pixel::default(); width * height] }
    }

    /// Adds the layer that the samples show, and clears them for the next one. Returns whether
    /// there may be one.
    pub(super) fn add(&mut self, samples: &mut Samples, sky: &Sky, view: &View, looks: &[Look]) -> bool {
        let side = samples.side;
        let part = self.width * side * side;
        let shader = Shader { side, width: self.width, sky, view, looks };
        let Samples { depths, seen, orders, past, .. } = samples;
        let rows = self.pixels.par_chunks_mut(self.width).enumerate();
        let rows = rows.zip(depths.par_chunks(part).zip(seen.par_chunks(part)));
        if past.is_empty() {
            rows.for_each(|((y, row), (depths, seen))| shader.row(row, y, depths, seen, |_| 1.0));
            return false;
        }
        rows.zip(past.par_chunks(part)).for_each(|(((y, row), (depths, seen)), past)| {
            shader.row(row, y, depths, seen, |at| past[at].through);
        });
        let layer = depths.par_iter_mut().zip(seen).zip(orders.par_iter().zip(past));
        let more = layer.map(|((depth, seen), (&order, past))| {
            let is_covered = *depth > f32::NEG_INFINITY;
            if is_covered {
                past.through *= 1.0 - looks[seen.subject()].opacity;
                (past.depth, past.order) = (*depth, order);
            }
            let goes_on = is_covered && past.through >= LEAST;
            if !goes_on {
                past.end();
            }
            *depth = f32::NEG_INFINITY;
            goes_on
        });
        more.reduce(|| false, |a, b| a | b)
    }

    /// The colours of all pixels; a pixel has a square of samples.
    pub(super) fn pixels(&self, side: usize) -> Vec<[u8; 4]> {
        let [r, g, b, opacity] = self.background;
        let behind = linear([r, g, b]);
        let pixel = |p: &Pixel| {
            if p.solid == 0.0 {
                return self.background;
            }
            // The uncovered part shows the background, as much of it as is opaque.
            let (n, free) = (p.solid, ((side * side) as f32 - p.solid).max(0.0));
            let through = free * f32::from(opacity) / 255.0;
            let mixed: [f32; 3] = std::array::from_fn(|k| (p.light[k] + behind[k] * through) / (n + through));
            let [r, g, b] = mixed.map(encode);
            [r, g, b, ((n + through) / (n + free) * 255.0 + 0.5) as u8]
        };
        self.pixels.par_iter().map(pixel).collect()
    }
}

struct Shader<'a> {
    side: usize,
    width: usize,
    sky: &'a Sky,
    view: &'a View,
    looks: &'a [Look],
}

impl Shader<'_> {
    /// Adds a layer to a row of pixels; `through` says how much light passes the layers before.
    fn row(
        &self,
        row: &mut [Pixel],
        y: usize,
        depths: &[f32],
        seen: &[VisiblePoint],
        through: impl Fn(usize) -> f32,
    ) {
        let (side, width) = (self.side, self.width * self.side);
        let (mut arriving, mut covered) = (vec![], vec![]);
        for (x, pixel) in row.iter_mut().enumerate() {
            covered.clear();
            covered.extend((0..side * side).filter_map(|n| {
                let (i, j) = (x * side + n % side, n / side);
                let at = j * width + i;
                let place = || self.place(i, y * side + j, depths[at]);
                (depths[at] > f32::NEG_INFINITY).then(|| (n, place(), &seen[at], through(at)))
            }));
            // Light is let in at one place of the pixel, that of the sample nearest to its middle.
            let middle = |c: &&(usize, [f32; 3], &VisiblePoint, f32)| {
                let off = |i: usize| (2 * i + 1).abs_diff(side).pow(2);
                off(c.0 % side) + off(c.0 / side)
            };
            let is_lit = |c: &&(usize, [f32; 3], &VisiblePoint, f32)| self.looks[c.2.subject()].is_lit();
            if let Some(&(_, place, seen, _)) = covered.iter().filter(is_lit).min_by_key(middle) {
                self.sky.arriving(place, self.towards_us(seen, place), &mut arriving);
            }
            for &(_, place, seen, through) in &covered {
                let share = through * self.looks[seen.subject()].opacity;
                let colour = self.colour(seen, place, &arriving);
                pixel.light = std::array::from_fn(|k| pixel.light[k] + share * colour[k]);
                pixel.solid += share;
            }
        }
    }

    /// Where a sample's surface is, in camera space.
    fn place(&self, i: usize, j: usize, depth: f32) -> [f32; 3] {
        let side = self.side as f64;
        let at = [(i as f64 + 0.5) / side, (j as f64 + 0.5) / side];
        self.view.unproject(at, f64::from(depth))
    }

    /// The normal; where interpolation has turned it away from the viewer, the nearest that is not.
    fn towards_us(&self, seen: &VisiblePoint, place: [f32; 3]) -> [f32; 3] {
        let (n, v) = (seen.normal(), self.view.viewer_from(place));
        let away = dot(n, v).min(0.0);
        let bent = super::unit(std::array::from_fn(|k| n[k] - away * v[k]));
        if bent == [0.0; 3] { v } else { bent }
    }

    fn colour(&self, seen: &VisiblePoint, place: [f32; 3], arriving: &[([f32; 3], f32)]) -> [f32; 3] {
        let look = self.looks[seen.subject()];
        let normal = self.towards_us(seen, place);
        let light: f32 = arriving.iter().map(|&(to, strength)| strength * dot(to, normal).max(0.0)).sum();
        let mut albedo = match look.paint {
            Paint::Plain(colour) => linear(colour),
            Paint::Normals => linear(normal.map(|c| (127.5 * (c + 1.0)).round() as u8)),
            Paint::Values(range) => scale_linear(share_of(seen.value, range) as f32),
            Paint::Map(..) if seen.value.is_nan() => linear(ColourMap::NO_VALUE),
            Paint::Map(map, range) => linear(map.colour(share_of(seen.value, range))),
            Paint::Flat(map, range) => return linear(map.colour(share_of(seen.value, range))),
        };
        // The far side of what is opaque and open is darker.
        if seen.is_back() && look.opacity == 1.0 {
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

/// A value's place between the ends of a range; of an empty range, the lower end.
fn share_of(value: f32, [lo, hi]: [f32; 2]) -> f64 {
    if hi > lo { f64::from((value - lo) / (hi - lo)) } else { 0.0 }
}
