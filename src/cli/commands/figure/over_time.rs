//! Draws how the isosurfaces of a series change: the area as a map of time and isovalue.

use super::super::text::unit_to_the;
use super::canvas::drawable;
use super::{Figure, INK, TRANSPARENT, in_brackets, label};
use isospan::pipeline::StepSpectrum;
use isospan::volume::units::Units;
use plotters::coord::Shift;
use plotters::prelude::*;

/// Isovalues of the map.
const ROWS: usize = 128;

/// Colours from no area to the largest: viridis at five places.
const MAP: [[f64; 3]; 5] =
    [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [253.0, 231.0, 37.0]];

/// A map of a series.
pub(crate) struct OverTime<'a> {
    pub(crate) steps: &'a [StepSpectrum],
    pub(crate) name: &'a str,
    pub(crate) units: &'a Units,
}

impl Figure for OverTime<'_> {
    fn draw<B: DrawingBackend>(
        &self,
        root: &DrawingArea<B, Shift>,
        scale: u32,
    ) -> std::result::Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        root.fill(&WHITE)?;
        let times: Vec<f64> = self.steps.iter().map(|s| s.time).collect();
        let edges = edges(&times);
        let [lo, hi] = self.range();
        let most = self.steps.iter().flat_map(|s| &s.spectrum.knots).map(|k| k.area).fold(0.0, f64::max);
        let font = |size: u32| ("sans-serif", size * scale).into_font().color(&INK);
        let mut chart = ChartBuilder::on(root)
            .caption(format!("Area of the isosurfaces of {}", self.name), font(20))
            .margin(14 * scale)
            .x_label_area_size(56 * scale)
            .y_label_area_size(84 * scale)
            .build_cartesian_2d(edges[0]..edges[edges.len() - 1], lo..hi)?;
        let height = (hi - lo) / ROWS as f64;
        for (step, x) in self.steps.iter().zip(edges.windows(2)) {
            let cells = (0..ROWS).map(|row| {
                let y = lo + height * row as f64;
                let area = area_at(step, y + height / 2.0);
                // By the square root, so that small areas next to a large one are visible too.
                let colour = colour(if most > 0.0 { (area / most).sqrt() } else { 0.0 });
                Rectangle::new([(x[0], y), (x[1], y + height)], colour.filled())
            });
            chart.draw_series(cells)?;
        }
        let figures = super::super::text::figures(most, 4);
        let in_units = in_brackets(self.units.time.as_ref());
        let square = drawable(&unit_to_the(2, self.units.length.as_ref()));
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(TRANSPARENT)
            .axis_style(INK.stroke_width(scale))
            .label_style(font(14))
            .axis_desc_style(font(15))
            .x_desc(format!(
                "time{in_units}  (dark: no surface; yellow: area {figures}{square}; colours by the square root of the area)"
            ))
            .y_desc(format!("isovalue{}", in_brackets(self.units.value.as_ref())))
            .x_label_formatter(&|v| label(*v, edges[edges.len() - 1] - edges[0]))
            .y_label_formatter(&|v| label(*v, hi - lo))
            .set_all_tick_mark_size(4 * scale)
            .draw()?;
        root.present()
    }
}

impl OverTime<'_> {
    /// The range of the values of all steps.
    fn range(&self) -> [f64; 2] {
        let ranges = self.steps.iter().filter_map(|s| s.spectrum.range);
        let all = ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        let [lo, hi] = all.unwrap_or([0.0, 1.0]);
        if lo < hi { [lo, hi] } else { [lo, lo + 1.0] }
    }
}

/// Where the columns of steps begin and end: half way between two of them.
fn edges(times: &[f64]) -> Vec<f64> {
    let middle = |a: f64, b: f64| a + (b - a) / 2.0;
    let mut edges: Vec<f64> = times.windows(2).map(|t| middle(t[0], t[1])).collect();
    let (first, last) = (times[0], times[times.len() - 1]);
    let [before, after] = match edges[..] {
        [] => [first - 0.5, last + 0.5],
        _ => [first - (edges[0] - first), last + (last - edges[edges.len() - 1])],
    };
    edges.insert(0, before);
    edges.push(after);
    edges
}

/// The area at an isovalue, between knots by their line; none outside of the step's values.
fn area_at(step: &StepSpectrum, isovalue: f64) -> f64 {
    let Some([lo, hi]) = step.spectrum.range else { return 0.0 };
    if isovalue <= lo || isovalue > hi {
        return 0.0;
    }
    let knots = &step.spectrum.knots;
    let at = |k: usize| (knots[k].isovalue, knots[k].area);
    let after = knots.partition_point(|k| k.isovalue < isovalue);
    let (left, right) = (
        if after > 0 { at(after - 1) } else { (lo, 0.0) },
        if after < knots.len() { at(after) } else { (hi, 0.0) },
    );
    let share = if right.0 > left.0 { (isovalue - left.0) / (right.0 - left.0) } else { 0.0 };
    left.1 + (right.1 - left.1) * share
}

fn colour(share: f64) -> RGBColor {
    let x = share.clamp(0.0, 1.0) * (MAP.len() - 1) as f64;
    let cell = (x as usize).min(MAP.len() - 2);
    let t = x - cell as f64;
    let [r, g, b] = [0, 1, 2].map(|i| (MAP[cell][i] * (1.0 - t) + MAP[cell + 1][i] * t).round() as u8);
    RGBColor(r, g, b)
}

#[cfg(test)]
mod tests {
    use super::super::{FigureFormat, write_figure};
    use super::*;
    use isospan::pipeline::Knot;
    use isospan::pipeline::SpectrumReport;

    fn step(time: f64, area: f64) -> StepSpectrum {
        let knot = |i: u8| Knot { isovalue: f64::from(i), area: area * f64::from(i), ..Knot::default() };
        let spectrum = SpectrumReport {
            range: Some([0.0, 4.0]),
            cells: 1,
            volume: 1.0,
            straight_edges: false,
            knots: (1..4).map(knot).collect(),
            suggestions: vec![],
            bytes_read: 0,
        };
        StepSpectrum { step: 0, time, spectrum }
    }

    #[test]
    fn columns_and_areas() {
        assert_eq!(edges(&[1.0]), [0.5, 1.5]);
        assert_eq!(edges(&[0.0, 1.0, 4.0]), [-0.5, 0.5, 2.5, 5.5]);
        let step = step(0.0, 2.0);
        let areas = [-1.0, 0.5, 1.0, 2.5, 3.5, 4.5].map(|v| area_at(&step, v));
        assert_eq!(areas, [0.0, 1.0, 2.0, 5.0, 3.0, 0.0]);
        assert_eq!((colour(0.0), colour(2.0)), (RGBColor(68, 1, 84), RGBColor(253, 231, 37)));
    }

    #[test]
    fn a_map_says_what_it_shows() {
        let (dir, steps) = (tempfile::tempdir().unwrap(), [step(0.0, 1.0), step(0.5, 7.0)]);
        for name in ["a.svg", "a.png"] {
            let file = dir.path().join(name);
            let drawn = OverTime { steps: &steps, name: "waves", units: &Units::default() };
            write_figure(&drawn, &file, FigureFormat::of(&file).unwrap()).unwrap();
            assert!(std::fs::metadata(&file).unwrap().len() > 1000);
        }
        let svg = std::fs::read_to_string(dir.path().join("a.svg")).unwrap();
        for words in ["isosurfaces of waves", "isovalue", "area 21"] {
            assert!(svg.contains(words), "{words}");
        }
    }
}
