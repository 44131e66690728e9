//! Figures. [`canvas`] puts words on pictures; here a contour spectrum is drawn: three panels above
//! each other on one axis of isovalues, as SVG or PNG.
//!
//! The font (a subset of DejaVu Sans, `FONT-LICENSE.txt`) is part of the program: a figure is the
//! same on every machine. A PNG is drawn three times as large and averaged, for smooth lines.

pub(crate) mod canvas;
mod over_time;

pub(crate) use over_time::OverTime;

use isospan::pipeline::SpectrumReport;
use isospan::volume::units::{Unit, Units};
use isospan::{Error, Result};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use std::fs::File;
use std::io::Write as _;
use std::path::Path;

const WIDTH: u32 = 900;
const HEIGHT: u32 = 840;
/// How much larger a PNG is drawn.
const OVERSAMPLING: u32 = 3;
/// And how much larger than [`WIDTH`] it is in the end.
const PNG_SCALE: u32 = 2;
const FONT: &[u8] = include_bytes!("font.ttf");

const INK: RGBColor = RGBColor(40, 40, 40);
const COLOURS: [RGBColor; 3] = [RGBColor(0, 92, 163), RGBColor(190, 60, 20), RGBColor(20, 120, 70)];

/// What is written.
#[derive(Clone, Copy, Debug)]
pub(crate) enum FigureFormat {
    Svg,
    Png,
}

impl FigureFormat {
    /// By the ending of a file's name.
    pub(crate) fn of(file: &Path) -> Result<Self> {
        let ending = file.extension().unwrap_or_default().to_ascii_lowercase();
        match ending.to_str() {
            Some("svg") => Ok(Self::Svg),
            Some("png") => Ok(Self::Png),
            _ => Err(Error::usage(format!("{}: a figure's name ends in .svg or .png", file.display()))),
        }
    }
}

/// What is drawn, on any surface.
pub(crate) trait Figure {
    /// Draws; lengths are `scale` times what they are on a surface of usual size.
    fn draw<B: DrawingBackend>(
        &self,
        root: &DrawingArea<B, Shift>,
        scale: u32,
    ) -> std::result::Result<(), DrawingAreaErrorKind<B::ErrorType>>;
}

/// The curves of a spectrum.
struct Curves<'a> {
    report: &'a SpectrumReport,
    name: &'a str,
    units: &'a Units,
}

impl Figure for Curves<'_> {
    fn draw<B: DrawingBackend>(
        &self,
        root: &DrawingArea<B, Shift>,
        scale: u32,
    ) -> std::result::Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        draw(root, scale, self)
    }
}

/// Draws the curves of a spectrum into a file.
pub(crate) fn write(
    report: &SpectrumReport,
    name: &str,
    units: &Units,
    file: &Path,
    format: FigureFormat,
) -> Result<()> {
    write_figure(&Curves { report, name, units }, file, format)
}

/// A unit behind the title of an axis.
fn in_brackets(unit: Option<&Unit>) -> String {
    unit.map_or_else(String::new, |unit| canvas::drawable(&format!(" ({unit})")))
}

/// Draws a figure into a file.
pub(crate) fn write_figure(figure: &impl Figure, file: &Path, format: FigureFormat) -> Result<()> {
    // Registering again replaces the same font by itself.
    let registered = register_font("sans-serif", FontStyle::Normal, FONT).is_ok();
    assert!(registered, "the font is part of the program, and sound");
    let bytes = match format {
        FigureFormat::Svg => svg(figure),
        FigureFormat::Png => png(figure),
    };
    publish(file, |out| out.write_all(&bytes).map_err(|e| Error::io("write", file, e)))
}

/// Writes a file, which appears when it is complete.
pub(crate) fn publish(file: &Path, write: impl FnOnce(&mut File) -> Result<()>) -> Result<()> {
    let failed = |e| Error::io("write", file, e);
    let folder = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let made = tempfile::Builder::new().prefix(".figure-").make_in(folder, |p| File::create_new(p));
    let mut temporary = made.map_err(failed)?;
    write(temporary.as_file_mut())?;
    temporary.as_file().sync_all().map_err(failed)?;
    temporary.persist(file).map_err(|e| failed(e.error))?;
    Ok(())
}

fn svg(figure: &impl Figure) -> Vec<u8> {
    let mut text = String::new();
    let root = SVGBackend::with_string(&mut text, (WIDTH, HEIGHT)).into_drawing_area();
    figure.draw(&root, 1).expect("drawing into memory cannot fail");
    drop(root);
    text.into_bytes()
}

fn png(figure: &impl Figure) -> Vec<u8> {
    let scale = OVERSAMPLING * PNG_SCALE;
    let (w, h) = ((WIDTH * scale) as usize, (HEIGHT * scale) as usize);
    let mut pixels = vec![255u8; w * h * 3];
    let root = BitMapBackend::with_buffer(&mut pixels, (w as u32, h as u32)).into_drawing_area();
    figure.draw(&root, scale).expect("drawing into memory cannot fail");
    drop(root);
    let side = OVERSAMPLING as usize;
    let (w_out, h_out) = (w / side, h / side);
    let mut small = Vec::with_capacity(w_out * h_out * 3);
    for (y, x, channel) in
        (0..h_out).flat_map(|y| (0..w_out).flat_map(move |x| (0..3).map(move |c| (y, x, c))))
    {
        let inside =
            (0..side).flat_map(|j| (0..side).map(move |i| ((y * side + j) * w + x * side + i) * 3 + channel));
        small.push((inside.map(|at| usize::from(pixels[at])).sum::<usize>() / (side * side)) as u8);
    }
    let mut out = vec![];
    let mut encoder = png::Encoder::new(&mut out, w_out as u32, h_out as u32);
    encoder.set_color(png::ColorType::Rgb);
    let written = encoder.write_header().and_then(|mut w| w.write_image_data(&small));
    written.expect("encoding into memory cannot fail");
    out
}

/// One curve.
struct Panel<'a> {
    title: &'a str,
    /// What stands behind a number on the axis; may be empty.
    unit: String,
    points: Vec<(f64, f64)>,
    colour: RGBColor,
    /// Whether the marked isovalues are named.
    names: bool,
}

fn draw<B: DrawingBackend>(
    root: &DrawingArea<B, Shift>,
    scale: u32,
    &Curves { report, name, units }: &Curves<'_>,
) -> std::result::Result<(), DrawingAreaErrorKind<B::ErrorType>> {
    root.fill(&WHITE)?;
    let [lo, hi] = report.range.unwrap_or([0.0, 1.0]);
    let hi = if lo < hi { hi } else { lo + 1.0 };
    let curve = |y: fn(&isospan::pipeline::Knot) -> f64| {
        report.knots.iter().map(|k| (k.isovalue, y(k))).collect::<Vec<_>>()
    };
    let unit_of = |power| canvas::drawable(&super::text::unit_to_the(power, units.length.as_ref()));
    let panels = [
        ("active tetrahedra", String::new(), curve(|k| k.active_cells as f64)),
        ("area", unit_of(2), curve(|k| k.area)),
        ("enclosed volume", unit_of(3), curve(|k| k.volume)),
    ];
    let font = |size: u32| ("sans-serif", size * scale).into_font().color(&INK);
    let (head, rest) = root.split_vertically(40 * scale);
    let (body, foot) = rest.split_vertically(rest.dim_in_pixel().1 - 30 * scale);
    let middle = (foot.dim_in_pixel().0 / 2) as i32;
    let centred = font(16).pos(plotters::style::text_anchor::Pos::new(
        plotters::style::text_anchor::HPos::Center,
        plotters::style::text_anchor::VPos::Top,
    ));
    let title = TextStyle { font: ("sans-serif", 20 * scale).into_font(), ..centred.clone() };
    head.draw_text(&format!("Contour spectrum of {name}"), &title, (middle, 14 * scale as i32))?;
    let foot_text = format!("isovalue{}  (dashed: worth a look)", in_brackets(units.value.as_ref()));
    foot.draw_text(&foot_text, &centred, (middle, 0))?;
    for ((area, (title, unit, points)), colour) in body.split_evenly((3, 1)).iter().zip(panels).zip(COLOURS) {
        let names = colour == COLOURS[0];
        panel(area, scale, [lo, hi], &Panel { title, unit, points, colour, names }, report)?;
    }
    root.present()
}

fn panel<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    scale: u32,
    [lo, hi]: [f64; 2],
    panel: &Panel<'_>,
    report: &SpectrumReport,
) -> std::result::Result<(), DrawingAreaErrorKind<B::ErrorType>> {
    let most = panel.points.iter().map(|p| p.1).fold(0.0, f64::max);
    let most = if most > 0.0 && most.is_finite() { most } else { 1.0 };
    let (power, factor) = engineering(most, &panel.unit);
    let top = most / factor * 1.08;
    let font = |size: u32| ("sans-serif", size * scale).into_font().color(&INK);
    let mut chart = ChartBuilder::on(area)
        .margin_left(8 * scale)
        .margin_right(24 * scale)
        .margin_top(10 * scale)
        .x_label_area_size(26 * scale)
        .y_label_area_size(72 * scale)
        .build_cartesian_2d(lo..hi, 0.0..top)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(RGBColor(225, 225, 225).stroke_width(scale))
        .axis_style(INK.stroke_width(scale))
        .label_style(font(14))
        .axis_desc_style(font(15))
        .y_desc(format!("{}{power}", panel.title))
        .x_labels(10)
        .y_labels(5)
        .x_label_formatter(&|v| label(*v, hi - lo))
        .y_label_formatter(&|v| label(*v, top))
        .set_all_tick_mark_size(4 * scale)
        .draw()?;
    for s in &report.suggestions {
        let x = s.isovalue;
        let dashes = (0..25).map(|i| f64::from(i) * top / 25.0);
        chart.draw_series(dashes.map(|y| {
            PathElement::new(vec![(x, y), (x, y + top / 50.0)], RGBColor(120, 120, 120).stroke_width(scale))
        }))?;
    }
    if panel.names {
        let names = report.suggestions.iter().map(|s| (s.isovalue, s.isovalue.to_string()));
        let at = |(x, name): (f64, String)| Text::new(name, (x + 0.004 * (hi - lo), top), font(13));
        chart.draw_series(names.map(at))?;
    }
    let points = panel.points.iter().map(|&(x, y)| (x, if y.is_finite() { y / factor } else { 0.0 }));
    chart.draw_series(LineSeries::new(points, panel.colour.stroke_width(2 * scale)))?;
    Ok(())
}

/// The power of 1000 that a number is written with: as words behind an axis title, with its unit,
/// and as a factor.
fn engineering(most: f64, unit: &str) -> (String, f64) {
    let exponent = (most.log10() / 3.0).floor() as i32 * 3;
    if (0..3).contains(&exponent) {
        let unit = unit.trim_start();
        return (if unit.is_empty() { String::new() } else { format!("  ({unit})") }, 1.0);
    }
    let digits: String = exponent.to_string().chars().map(superscript).collect();
    (format!("  (10{digits}{unit})"), 10f64.powi(exponent))
}

fn superscript(c: char) -> char {
    match c {
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '0'..='9' => char::from_u32(0x2070 + c as u32 - '0' as u32).unwrap_or(c),
        _ => '⁻',
    }
}

/// A number on an axis of such a length: without the last bits that adding steps leaves.
fn label(v: f64, length: f64) -> String {
    let v = if v.abs() < length * 1e-9 { 0.0 } else { v };
    let text = format!("{v:.6e}").parse::<f64>().unwrap_or(v);
    super::text::value(text).replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_labelled_as_a_person_would() {
        let words = |most, unit| engineering(most, unit).0;
        assert_eq!(engineering(2_345_678.0, ""), ("  (10⁶)".into(), 1e6));
        assert_eq!((words(23.0, ""), words(2e-5, "")), (String::new(), "  (10⁻⁶)".into()));
        assert_eq!((&*words(23.0, " mm²"), &*words(2e4, " mm²")), ("  (mm²)", "  (10³ mm²)"));
        assert_eq!(
            (label(0.1 + 0.2, 1.0), label(1e-17, 1.0), label(-300.0, 1e3)),
            ("0.3".into(), "0".into(), "−300".into())
        );
    }

    #[test]
    fn a_figure_says_what_it_shows() {
        let knot = |i: u8| isospan::pipeline::Knot {
            isovalue: f64::from(i),
            active_cells: 10 * u64::from(i),
            area: f64::from(i * i) * 1e4,
            volume: 100.0 - f64::from(i),
            gradient: 1.0,
        };
        let report = SpectrumReport {
            range: Some([0.0, 9.0]),
            cells: 100,
            volume: 100.0,
            straight_edges: false,
            knots: (1..=9).map(knot).collect(),
            suggestions: vec![],
            bytes_read: 0,
        };
        let dir = tempfile::tempdir().unwrap();
        let files = ["a.svg", "a.png"].map(|f| dir.path().join(f));
        let units = Units { value: Unit::new("K"), ..Units::of_length(Unit::length("mm")) };
        files.iter().for_each(|f| write(&report, "tooth", &units, f, FigureFormat::of(f).unwrap()).unwrap());
        let svg = std::fs::read_to_string(&files[0]).unwrap();
        for words in [
            "Contour spectrum of tooth",
            "active tetrahedra",
            "area  (10³ mm²)",
            "enclosed volume",
            "isovalue (K)",
        ] {
            assert!(svg.contains(words), "{words}");
        }
        let png = std::fs::read(&files[1]).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&png)).read_info().unwrap();
        assert_eq!((reader.info().width, reader.info().height), (WIDTH * PNG_SCALE, HEIGHT * PNG_SCALE));
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        for colour in COLOURS {
            let curve = [colour.0, colour.1, colour.2];
            assert!(pixels.chunks_exact(3).filter(|p| **p == curve).count() > 200, "{colour:?}");
        }
        assert!(FigureFormat::of(Path::new("x.pdf")).is_err());
    }
}
