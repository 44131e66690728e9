//! Charts and point sets as PNG: drawn three times as large and averaged, for smooth lines.

use crate::document::short;
use isospan::geom::{Lattice, PointClass};
use isospan::points::{PointSet, PointSpec};
use isospan::{Error, Result};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use std::path::Path;

const FONT: &[u8] = include_bytes!("../../../src/cli/commands/figure/font.ttf");
const LARGER: u32 = 3;
/// Charts of more lines are taller.
const MANY: usize = 6;
const INK: RGBColor = RGBColor(40, 40, 40);
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 92, 163),
    RGBColor(196, 78, 20),
    RGBColor(20, 120, 70),
    RGBColor(150, 30, 120),
    RGBColor(120, 110, 0),
    RGBColor(200, 30, 60),
    RGBColor(110, 110, 110),
];

type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;
type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

/// A line of a chart.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Line {
    pub(crate) name: String,
    /// In ascending x.
    pub(crate) points: Vec<(f64, f64)>,
    pub(crate) dashed: bool,
}

/// A chart of lines.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Chart {
    pub(crate) title: String,
    pub(crate) x: String,
    pub(crate) y: String,
    /// Both axes logarithmic, and slopes in the legend.
    pub(crate) log: bool,
    pub(crate) lines: Vec<Line>,
}

impl Line {
    fn drawn(&self, log: bool) -> impl Iterator<Item = (f64, f64)> + Clone + '_ {
        let good =
            move |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite() && (!log || p.0 > 0.0 && p.1 > 0.0);
        self.points.iter().filter(good).copied()
    }

    /// The exponent b of y ~ x^b, by least squares of the logarithms.
    pub(crate) fn slope(&self) -> Option<f64> {
        let logs: Vec<(f64, f64)> = self.drawn(true).map(|(x, y)| (x.ln(), y.ln())).collect();
        if logs.len() < 2 {
            return None;
        }
        let n = logs.len() as f64;
        let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
        let (top, below) =
            logs.iter().fold((0.0, 0.0), |(t, b), (x, y)| (t + (x - mx) * (y - my), b + (x - mx) * (x - mx)));
        (below > 0.0).then(|| top / below)
    }

    fn label(&self, log: bool) -> String {
        match self.slope().filter(|_| log) {
            Some(slope) => format!("{}  (slope {slope:.2})", self.name),
            None => self.name.clone(),
        }
    }
}

/// Draws charts side by side into a file.
pub(crate) fn write(charts: &[Chart], file: &Path) -> Result<()> {
    let columns = charts.len().min(3) as u32;
    let rows = (charts.len() as u32).div_ceil(columns.max(1));
    let height = if charts.iter().any(|c| c.lines.len() > MANY) { 560 } else { 400 };
    picture((520 * columns, height * rows), file, |root| {
        let areas = root.split_evenly((rows as usize, columns as usize));
        areas.iter().zip(charts).try_for_each(|(area, chart)| draw(area, chart))
    })
}

/// Draws with `draw` into a PNG of a size.
fn picture(size: (u32, u32), file: &Path, draw: impl Fn(&Area<'_>) -> Drawn) -> Result<()> {
    let registered = register_font("sans-serif", FontStyle::Normal, FONT).is_ok();
    assert!(registered, "the font is part of the program, and sound");
    let large = (size.0 * LARGER, size.1 * LARGER);
    let mut pixels = vec![255u8; (large.0 * large.1 * 3) as usize];
    {
        let root = BitMapBackend::with_buffer(&mut pixels, large).into_drawing_area();
        root.fill(&WHITE).map_err(|e| drawing(file, &e))?;
        draw(&root).map_err(|e| drawing(file, &*e))?;
        root.present().map_err(|e| drawing(file, &e))?;
    }
    write_png(&shrink(&pixels, large, LARGER), size, file)
}

/// Writes words into a picture, each centred below its place.
pub(crate) fn captioned(pixels: &mut [u8], size: (u32, u32), words: &[(i32, i32, String)]) {
    use plotters::style::text_anchor::{HPos, Pos, VPos};
    let registered = register_font("sans-serif", FontStyle::Normal, FONT).is_ok();
    assert!(registered, "the font is part of the program, and sound");
    let root = BitMapBackend::with_buffer(pixels, size).into_drawing_area();
    let style = ("sans-serif", 15).into_font().color(&INK).pos(Pos::new(HPos::Center, VPos::Top));
    for (x, y, text) in words {
        root.draw_text(text, &style, (*x, *y)).expect("drawing into memory cannot fail");
    }
}

fn drawing(file: &Path, e: &dyn std::error::Error) -> Error {
    Error::io("draw", file, std::io::Error::other(e.to_string()))
}

/// Averages squares of pixels.
pub(crate) fn shrink(pixels: &[u8], (width, height): (u32, u32), by: u32) -> Vec<u8> {
    let (w, by) = (width as usize, by as usize);
    let mut out = vec![];
    for (y, x) in (0..height as usize / by).flat_map(|y| (0..w / by).map(move |x| (y, x))) {
        for channel in 0..3 {
            let inside = (0..by * by).map(|i| ((y * by + i / by) * w + x * by + i % by) * 3 + channel);
            let sum: usize = inside.map(|at| usize::from(pixels[at])).sum();
            out.push((sum / (by * by)) as u8);
        }
    }
    out
}

pub(crate) fn write_png(pixels: &[u8], (width, height): (u32, u32), file: &Path) -> Result<()> {
    let failed = |e: png::EncodingError| Error::io("write", file, std::io::Error::other(e));
    let out = std::fs::File::create(file).map_err(|e| Error::io("create", file, e))?;
    let mut encoder = png::Encoder::new(std::io::BufWriter::new(out), width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::High);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(pixels).map_err(failed)
}

fn draw(area: &Area<'_>, chart: &Chart) -> Drawn {
    let all: Vec<(f64, f64)> = chart.lines.iter().flat_map(|l| l.drawn(chart.log)).collect();
    let end = |pick: fn(f64, f64) -> f64, start: f64, of: fn(&(f64, f64)) -> f64| {
        all.iter().map(of).fold(start, pick)
    };
    let [x0, y0] = [|p: &(f64, f64)| p.0, |p: &(f64, f64)| p.1].map(|of| end(f64::min, f64::INFINITY, of));
    let [x1, y1] = [|p: &(f64, f64)| p.0, |p: &(f64, f64)| p.1].map(|of| end(f64::max, 0.0, of));
    if all.is_empty() {
        return Ok(());
    }
    // Room for the legend above the lines.
    let each = if chart.lines.len() > MANY { 0.065 } else { 0.11 };
    let room = 0.12 + each * chart.lines.len() as f64;
    if !chart.log {
        let axis = |hi: f64| PlotAxis { range: (0.0..hi).into(), ticks: None };
        return axes(area, chart, axis(x1 * 1.05), axis(y1 * (1.0 + room)));
    }
    let [x0, x1, y0, y1] = [x0, x1, y0, y1].map(f64::log10);
    let tall = (y1 - y0).max(0.3);
    let axis = |lo: f64, hi: f64| PlotAxis { range: (lo..hi).into(), ticks: Some(ticks(lo, hi)) };
    axes(area, chart, axis(x0 - 0.08, x1 + 0.08), axis(y0 - 0.08 * tall, y1 + room * tall))
}

/// Logarithms of 1, 2 and 5 times powers of ten, or of the powers alone where those are enough.
fn ticks(lo: f64, hi: f64) -> Vec<f64> {
    let of = |steps: &[f64]| -> Vec<f64> {
        let powers = lo.floor() as i32..=hi.ceil() as i32;
        let all = powers.flat_map(|p| steps.iter().map(move |s| f64::from(p) + s.log10()));
        all.filter(|t| (lo..=hi).contains(t)).collect()
    };
    let powers = of(&[1.0]);
    if powers.len() > 2 { powers } else { of(&[1.0, 2.0, 5.0]) }
}

/// An axis of numbers, or of logarithms with marks of its own.
struct PlotAxis {
    range: RangedCoordf64,
    ticks: Option<Vec<f64>>,
}

impl Ranged for PlotAxis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.range.map(value, limit)
    }

    fn key_points<H: KeyPointHint>(&self, hint: H) -> Vec<f64> {
        self.ticks.clone().unwrap_or_else(|| self.range.key_points(hint))
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.range.range()
    }
}

impl ValueFormatter<f64> for PlotAxis {
    fn format(value: &f64) -> String {
        short(*value)
    }
}

fn axes(area: &Area<'_>, chart: &Chart, x: PlotAxis, y: PlotAxis) -> Drawn {
    let font = |size: u32| ("sans-serif", size * LARGER).into_font().color(&INK);
    // Of a logarithmic axis, the number that is meant; without what rounding adds.
    let label =
        |v: f64| short(if chart.log { format!("{:.6e}", 10f64.powf(v)).parse().unwrap_or(v) } else { v });
    let mut plane = ChartBuilder::on(area)
        .caption(&chart.title, font(16))
        .margin(10 * LARGER)
        .x_label_area_size(38 * LARGER)
        .y_label_area_size(64 * LARGER)
        .build_cartesian_2d(x, y)?;
    plane
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(RGBColor(228, 228, 228).stroke_width(LARGER))
        .axis_style(INK.stroke_width(LARGER))
        .label_style(font(12))
        .axis_desc_style(font(13))
        .x_desc(&chart.x)
        .y_desc(&chart.y)
        .x_labels(6)
        .y_labels(6)
        .x_label_formatter(&|v| label(*v))
        .y_label_formatter(&|v| label(*v))
        .set_all_tick_mark_size(4 * LARGER)
        .draw()?;
    // A dashed line has the colour of the line before it.
    let mut colours = COLOURS.into_iter().cycle();
    let mut colour = INK;
    for line in &chart.lines {
        if !line.dashed {
            colour = colours.next().expect("colours come again");
        }
        let style = colour.stroke_width(2 * LARGER);
        let logs =
            line.drawn(chart.log).map(|(x, y)| if chart.log { (x.log10(), y.log10()) } else { (x, y) });
        let points: Vec<(f64, f64)> = logs.collect();
        let label = line.label(chart.log);
        let end = 18 * LARGER as i32;
        if line.dashed {
            let [dash, gap] = [6, 4].map(|n| n * LARGER);
            let series = DashedLineSeries::new(points.clone(), dash, gap, style);
            let legend = move |(x, y)| PathElement::new(vec![(x + end / 4, y), (x + end * 3 / 4, y)], style);
            plane.draw_series(series)?.label(label).legend(legend);
        } else {
            let legend = move |(x, y)| PathElement::new(vec![(x, y), (x + end, y)], style);
            plane.draw_series(LineSeries::new(points.clone(), style))?.label(label).legend(legend);
        }
        plane.draw_series(points.into_iter().map(|p| Circle::new(p, 3 * LARGER, colour.filled())))?;
    }
    plane
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .legend_area_size(22 * LARGER)
        .margin(4 * LARGER)
        .background_style(WHITE.mix(0.8))
        .label_font(font(12))
        .draw()?;
    Ok(())
}

/// Draws the interior points of a set in the unit cube, seen from the front, above and to the
/// right; far points are paler.
pub(crate) fn write_points(spec: PointSpec, file: &Path) -> Result<usize> {
    let lattice = Lattice::new([257; 3])?;
    let set = PointSet::new(spec, lattice)?;
    let mut sites = vec![];
    set.sites_in(&lattice.domain(), &mut sites);
    sites.retain(|s| s.id.class() == Some(PointClass::Interior));
    let unit = |p: [u32; 3]| p.map(|c| f64::from(c) / f64::from(1u32 << 24) - 0.5);
    let mut points: Vec<(f64, [f64; 2])> = sites.iter().map(|s| project(unit(s.pos))).collect();
    points.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let size = 620;
    picture((size, size), file, |root| {
        let at = |[x, y]: [f64; 2]| {
            let scale = f64::from(size * LARGER) / 1.75;
            let middle = f64::from(size * LARGER) / 2.0;
            ((middle + scale * x) as i32, (middle - scale * y) as i32)
        };
        let corner = |n: u32| [n & 1, n >> 1 & 1, n >> 2].map(|b| f64::from(b) - 0.5);
        for (a, b) in (0..8u32).flat_map(|a| [1, 2, 4].map(|b| (a, a | b))).filter(|(a, b)| a != b) {
            let line = vec![at(project(corner(a)).1), at(project(corner(b)).1)];
            root.draw(&PathElement::new(line, RGBColor(150, 150, 150).stroke_width(LARGER)))?;
        }
        for &(depth, p) in &points {
            // From 0 (far) to 1 (near).
            let near = (depth + 0.87) / 1.74;
            let shade = |ink: f64| (255.0 - (255.0 - ink) * (0.3 + 0.7 * near)) as u8;
            let colour = RGBColor(shade(0.0), shade(70.0), shade(140.0));
            root.draw(&Circle::new(at(p), (3.0 + 2.5 * near) * f64::from(LARGER), colour.filled()))?;
        }
        Ok(())
    })?;
    Ok(sites.len())
}

/// Depth towards the eye, and the place in the picture, of a point about the origin; z is up.
fn project([x, y, z]: [f64; 3]) -> (f64, [f64; 2]) {
    let (turn, lift) = (0.45f64, 0.4f64);
    let across = x * turn.cos() + y * turn.sin();
    let back = y * turn.cos() - x * turn.sin();
    (z * lift.sin() - back * lift.cos(), [across, z * lift.cos() + back * lift.sin()])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_exponents() {
        let points = (1..6).map(|i| (f64::from(i), 3.0 * f64::from(i * i))).collect();
        let line = Line { name: "square".into(), points, dashed: false };
        assert!((line.slope().unwrap() - 2.0).abs() < 1e-12);
        assert_eq!(line.label(true), "square  (slope 2.00)");
        assert_eq!(Line { points: vec![(1.0, 1.0)], ..line }.slope(), None);
    }

    #[test]
    fn ticks_are_round() {
        let back = |lo: f64, hi: f64| -> Vec<f64> {
            ticks(lo.log10(), hi.log10()).into_iter().map(|t| 10f64.powf(t).round()).collect()
        };
        assert_eq!(back(3.0, 60.0), [5.0, 10.0, 20.0, 50.0]);
        assert_eq!(back(3.0, 4000.0), [10.0, 100.0, 1000.0]);
    }

    #[test]
    fn pictures_are_drawn() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.png");
        let line = Line { name: "a".into(), points: vec![(1.0, 2.0), (10.0, 30.0)], dashed: true };
        let chart = Chart { log: true, lines: vec![line], title: "t".into(), x: "x".into(), y: "y".into() };
        write(&[chart.clone(), Chart { log: false, ..chart }], &file).unwrap();
        let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(&file).unwrap()));
        let info = decoder.read_info().unwrap();
        assert_eq!((info.info().width, info.info().height), (1040, 400));
        let cross = PointSpec::HyperbolicCross { m: 2, k: 2, r: [1; 3] };
        assert_eq!(write_points(cross, &folder.path().join("p.png")).unwrap(), 495);
    }
}
