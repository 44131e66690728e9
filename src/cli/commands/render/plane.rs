//! The field on a plane across an axis: samples of it, a surface that shows it, a flat picture.

use super::super::figure::canvas::{Canvas, drawable, ticks};
use super::super::grammar::AXES;
use super::super::text;
use super::Colours;
use isospan::pipeline::{LevelChoice, ProbeSettings, Step};
use isospan::surface::{TriMesh, Vertex, nearby_origin};
use isospan::volume::units::Unit;
use isospan::{Error, Resources, Result};

/// A box in the world: its least and its largest corner.
pub(super) type Hull = [[f64; 3]; 2];

/// A part of a plane across an axis of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Slice {
    /// The axis, and the place on it.
    pub(super) axis: usize,
    pub(super) at: f64,
    /// The box that it lies in.
    pub(super) hull: Hull,
}

/// The field that planes show.
pub(super) struct Shown<'a> {
    pub(super) step: &'a Step,
    /// The level of a pyramid; the finest if not given.
    pub(super) level: Option<LevelChoice>,
    pub(super) colours: &'a Colours,
}

/// Samples along the longer side of a slice in space.
const SIDE: usize = 512;
/// Samples that are asked for at a time.
const BATCH: usize = 1 << 17;

impl Slice {
    /// The axes of the world that lie to the right and upward on a picture of it.
    pub(super) fn across(&self) -> [usize; 2] {
        [[1, 2], [0, 2], [0, 1]][self.axis]
    }

    /// Its extent along both.
    fn sides(&self) -> [f64; 2] {
        self.across().map(|a| self.hull[1][a] - self.hull[0][a])
    }

    fn place(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        let mut p = [self.at; 3];
        for (a, share) in self.across().into_iter().zip([u, v]) {
            p[a] = self.hull[0][a] + share * (self.hull[1][a] - self.hull[0][a]);
        }
        p
    }

    /// `z = 40 mm`.
    pub(super) fn words(&self, unit: Option<&Unit>) -> String {
        format!("{} = {}", AXES[self.axis], super::with_unit(self.at, unit))
    }

    /// Its rectangle, as a surface.
    pub(super) fn rectangle(&self) -> TriMesh {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        self.mesh(corners.map(|c| self.vertex(c)).to_vec(), vec![[0, 1, 2], [0, 2, 3]])
    }

    /// What positions on it are counted from.
    fn origin(&self) -> [f64; 3] {
        nearby_origin(self.hull, [0.0; 3])
    }

    fn mesh(&self, vertices: Vec<Vertex>, triangles: Vec<[u32; 3]>) -> TriMesh {
        TriMesh { vertices, triangles, origin: self.origin() }
    }

    fn vertex(&self, share: [f64; 2]) -> Vertex {
        let (place, origin) = (self.place(share), self.origin());
        Vertex { position: std::array::from_fn(|k| (place[k] - origin[k]) as f32), normal: [0.0; 3] }
    }

    /// The values at shares of its sides.
    fn values(
        &self,
        shown: &Shown<'_>,
        count: usize,
        share: impl Fn(usize) -> [f64; 2],
        resources: &Resources,
    ) -> Result<Vec<f64>> {
        let settings = ProbeSettings { resources: resources.clone(), level: shown.level };
        let mut values = Vec::with_capacity(count);
        while values.len() < count {
            let batch = values.len()..count.min(values.len() + BATCH);
            let points: Vec<[f64; 3]> = batch.map(|n| self.place(share(n))).collect();
            values.extend(shown.step.probe_with(&points, &settings)?);
        }
        Ok(values)
    }

    /// The field on it, as a surface with a value for each vertex, 0 to 1 where colours have them;
    /// it has holes where there is no value.
    pub(super) fn surface(&self, shown: &Shown<'_>, resources: &Resources) -> Result<(TriMesh, Vec<f32>)> {
        let sides = self.sides();
        let longest = sides[0].max(sides[1]).max(f64::MIN_POSITIVE);
        let [w, h] = sides.map(|s| ((s / longest * SIDE as f64).ceil() as usize).clamp(1, SIDE));
        let share = |n: usize| {
            let (i, j) = (n % (w + 1), n / (w + 1));
            [i as f64 / w as f64, j as f64 / h as f64]
        };
        let count = (w + 1) * (h + 1);
        let values = self.values(shown, count, share, resources)?;
        let vertices = (0..count).map(|n| self.vertex(share(n))).collect();
        let shares: Vec<f32> = values.iter().map(|&v| shown.colours.share(v) as f32).collect();
        let cell = |n: usize| {
            let a = (n / w * (w + 1) + n % w) as u32;
            let (b, c) = (a + 1, a + w as u32 + 1);
            [[a, b, c + 1], [a, c + 1, c]]
        };
        let has_values = |t: &[u32; 3]| t.iter().all(|&v| !shares[v as usize].is_nan());
        let triangles = (0..w * h).flat_map(cell).filter(has_values).collect();
        Ok((self.mesh(vertices, triangles), shares))
    }

    /// A picture of the field on it, with axes in world units, which may have a name: so wide and
    /// high at most.
    pub(super) fn picture(
        &self,
        shown: &Shown<'_>,
        size: [usize; 2],
        background: [u8; 4],
        unit: Option<&Unit>,
        resources: &Resources,
    ) -> Result<Canvas> {
        let mut canvas = Canvas::new(size, background);
        let frame = PlotFrame::new(&canvas, self, size, unit)?;
        let [left, top, width, height] = frame.place;
        let middle = |n: usize, side: usize| (n as f64 + 0.5) / side as f64;
        let share = |n: usize| [middle(n % width, width), 1.0 - middle(n / width, height)];
        let values = self.values(shown, width * height, share, resources)?;
        for (n, &v) in values.iter().enumerate().filter(|(_, v)| !v.is_nan()) {
            let [r, g, b] = shown.colours.of(v);
            canvas.pixels[(top + n / width) * size[0] + left + n % width] = [r, g, b, 255];
        }
        frame.axes(&mut canvas, super::layout::ink(background));
        Ok(canvas)
    }
}

/// Where a flat picture lies on its panel, and its axes.
struct PlotFrame {
    /// Left, top, width, height.
    place: [usize; 4],
    letters: f32,
    /// The ends of both axes, their ticks and their names.
    ends: [[f64; 2]; 2],
    ticks: [Vec<f64>; 2],
    names: [String; 2],
}

impl PlotFrame {
    fn new(canvas: &Canvas, slice: &Slice, size: [usize; 2], unit: Option<&Unit>) -> Result<Self> {
        let across = slice.across();
        let ends = across.map(|a| [slice.hull[0][a], slice.hull[1][a]]);
        let least = size[0].min(size[1]) as f32;
        let letters = (least / 30.0).clamp(11.0, 40.0);
        let mut ticks = ends.map(|[lo, hi]| ticks(lo, hi));
        let label = |v: f64, axis: usize| canvas.width(&label(v, ends[axis]), letters);
        let widest = ticks[1].iter().map(|&v| label(v, 1)).fold(0.0, f32::max);
        let margin = (0.8 * letters).ceil();
        // Above the picture stands the name of the upward axis; to the right, half a label may be.
        let half = ticks[0].last().map_or(0.0, |&v| label(v, 0) / 2.0);
        let (left, right) = ((widest + 1.1 * letters).ceil(), margin.max(half.ceil() + 1.0));
        let (above, below) = ((1.7 * letters).ceil(), (2.9 * letters).ceil());
        let free = [size[0] as f32 - left - right, size[1] as f32 - above - below];
        if free[0] < 16.0 || free[1] < 16.0 {
            return Err(Error::usage(format!(
                "a panel of {} x {} pixels is too small for a slice with axes: give a larger --size",
                size[0], size[1]
            )));
        }
        let sides = slice.sides().map(|s| s.max(f64::MIN_POSITIVE));
        let scale = (f64::from(free[0]) / sides[0]).min(f64::from(free[1]) / sides[1]);
        let extent = |k: usize| ((sides[k] * scale).round() as usize).clamp(1, free[k] as usize);
        let [width, height] = [extent(0), extent(1)];
        // In the middle of the panel.
        let off = [(free[0] - width as f32) / 2.0, (free[1] - height as f32) / 2.0];
        let place = [(left + off[0]) as usize, (above + off[1]) as usize, width, height];
        // Labels that would touch are thinned out.
        while ticks[0].len() > 2
            && 1.25 * ticks[0].iter().map(|&v| label(v, 0) + letters).sum::<f32>() > width as f32
        {
            ticks[0] = ticks[0].iter().copied().step_by(2).collect();
        }
        while ticks[1].len() > 2 && ticks[1].len() as f32 * 1.4 * letters > height as f32 {
            ticks[1] = ticks[1].iter().copied().step_by(2).collect();
        }
        let unit = unit.map_or_else(String::new, |unit| drawable(&format!(" ({unit})")));
        Ok(Self { place, letters, ends, ticks, names: across.map(|a| format!("{}{unit}", AXES[a])) })
    }

    fn axes(&self, canvas: &mut Canvas, ink: [u8; 3]) {
        let ([left, top, width, height], letters) = (self.place, self.letters);
        let (mark, bottom) = ((0.35 * letters).round() as usize, top + height);
        canvas.fill([left - 1, bottom, width + 2, 1], ink);
        canvas.fill([left - 1, top, 1, height], ink);
        let share = |v: f64, [lo, hi]: [f64; 2]| if hi > lo { (v - lo) / (hi - lo) } else { 0.5 };
        for &v in &self.ticks[0] {
            let x = left + (share(v, self.ends[0]) * (width - 1) as f64).round() as usize;
            canvas.fill([x, bottom, 1, mark], ink);
            let at = [x as f32 + 0.5, bottom as f32 + mark as f32 + letters];
            canvas.write(&label(v, self.ends[0]), letters, at, ink);
        }
        for &v in &self.ticks[1] {
            let y = bottom - 1 - (share(v, self.ends[1]) * (height - 1) as f64).round() as usize;
            canvas.fill([left - 1 - mark, y, mark, 1], ink);
            let text = label(v, self.ends[1]);
            let middle = left as f32 - 1.0 - mark as f32 - 0.3 * letters - canvas.width(&text, letters) / 2.0;
            canvas.write(&text, letters, [middle, y as f32 + 0.5 + 0.35 * letters], ink);
        }
        let middle = left as f32 + width as f32 / 2.0;
        canvas.write(&self.names[0], letters, [middle, bottom as f32 + mark as f32 + 2.2 * letters], ink);
        // Its first letter stands above the axis.
        let name = &self.names[1];
        let shift = (canvas.width(name, letters) - canvas.width(&name[..1], letters)) / 2.0;
        canvas.write(name, letters, [left as f32 + shift, top as f32 - 0.6 * letters], ink);
    }
}

/// A number at a tick of an axis.
fn label(v: f64, ends: [f64; 2]) -> String {
    text::in_range(v, ends).replace('-', "−")
}
