//! `isospan render`: pictures of surfaces.

use super::figure::canvas::{Canvas, ticks};
use super::figure::publish;
use super::grammar::{self, Value};
use super::machine::Machine;
use super::output::Force;
use super::progress::Talk;
use super::step::StepArgs;
use super::text;
use isospan::compare::{CompareSettings, distances};
use isospan::exec::{CancelToken, Progress};
use isospan::formats::surface::{SurfaceFormat, load_surface};
use isospan::pipeline::{Step, SurfaceSettings, is_archive};
use isospan::render::{Camera, Image, Paint, RenderSettings, Subject, Up, View, render, scale_colour};
use isospan::surface::SurfaceSource;
use isospan::surface::check::CheckSettings;
use isospan::surface::weld::StoredSurface;
use isospan::{Archive, Error, Resources, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Draw surfaces, or isosurfaces of archives, as a PNG.
///
/// Each has a panel, and all are seen from the same place.
/// No graphics card is needed, and the same command gives the same bytes on every machine. With
/// --distance-to, colours show how far each surface is from another one.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan render scan.isospan --isovalue 600,1000 -o scan.png\n  isospan render full.ply small.ply -o two.png --distance-to full.ply"
)]
pub(crate) struct Args {
    /// Surfaces (.ply .stl .obj .vtp .glb) or archives, these also by address: s3://... or
    /// https://...
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// The picture to write: .png.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Isovalues of the archives, one panel each. 50% is half-way from the least value of the step
    /// to its largest.
    #[arg(
        long,
        short = 'i',
        value_name = "VALUE[,VALUE..]",
        value_delimiter = ',',
        allow_hyphen_values = true,
        value_parser = grammar::value
    )]
    isovalue: Vec<Value>,
    /// Text below a panel; give it once per panel. Without it, several panels show the names of
    /// their files.
    #[arg(long, value_name = "TEXT")]
    caption: Vec<String>,
    /// Number of panels in a row [default: all, up to 4].
    #[arg(long, value_name = "N", value_parser = grammar::whole_in(1..=1000usize))]
    columns: Option<usize>,
    /// Size of a panel in pixels.
    #[arg(long, value_name = "W,H", default_value = "800,800", value_parser = grammar::extent)]
    size: [u32; 2],
    /// Angle around the upward axis, in degrees.
    #[arg(
        long,
        value_name = "DEGREES",
        default_value = "30",
        value_parser = grammar::number,
        allow_negative_numbers = true,
        help_heading = "Camera"
    )]
    azimuth: f64,
    /// Angle above the horizon, in degrees.
    #[arg(
        long,
        value_name = "DEGREES",
        default_value = "20",
        value_parser = grammar::number,
        allow_negative_numbers = true,
        help_heading = "Camera"
    )]
    elevation: f64,
    /// Which way is up: x, y, z, -x, -y, -z.
    #[arg(long, value_name = "AXIS", default_value = "z", allow_hyphen_values = true, value_parser = grammar::up, help_heading = "Camera")]
    up: Up,
    /// Magnification; 1 fills the panel.
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = grammar::positive_number, help_heading = "Camera")]
    zoom: f64,
    /// Use parallel projection instead of perspective.
    #[arg(long, help_heading = "Camera")]
    orthographic: bool,
    /// Colour of the surface, #rrggbb or "normals": one for all, or one per panel.
    #[arg(long, value_name = "COLOUR[,COLOUR..]", value_delimiter = ',', default_value = "#d8cbb4", value_parser = grammar::paint)]
    colour: Vec<Paint>,
    /// Colour each point by its distance from this surface, and draw a scale.
    #[arg(long, value_name = "SURFACE")]
    distance_to: Option<PathBuf>,
    /// The distance at the end of the scale [default: the 99.5th percentile over the vertices].
    #[arg(long, value_name = "LENGTH", value_parser = grammar::number, requires = "distance_to")]
    distance_max: Option<f64>,
    /// Background colour: #rrggbb or "transparent".
    #[arg(long, value_name = "COLOUR", default_value = "#ffffff", value_parser = grammar::background)]
    background: [u8; 4],
    /// Shade triangles flat instead of smoothly.
    #[arg(long)]
    flat: bool,
    /// Samples along each side of a pixel, 1 to 8.
    #[arg(long, value_name = "N", default_value = "3", value_parser = grammar::whole_in(1..=8u32))]
    antialias: u32,
    /// Number of lights in the sky, whose shadows make soft light; 0 for light without shadows.
    #[arg(long, value_name = "N", default_value = "32", value_parser = grammar::whole::<u32>)]
    lights: u32,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    step: StepArgs,
    /// Folder for what does not fit in memory, and for the surfaces of archives
    /// [default: the system's temporary folder].
    #[arg(help_heading = "Resources", long, value_name = "FOLDER")]
    scratch: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
    /// Print what was drawn as JSON.
    #[arg(long)]
    json: bool,
}

/// What is in a panel.
struct Panel {
    name: String,
    isovalue: Option<f64>,
    surface: StoredSurface,
    /// The distance of each vertex, where they are asked for.
    distances: Vec<f32>,
}

/// What a panel shows, in numbers.
#[derive(Serialize)]
struct PanelReport {
    input: String,
    isovalue: Option<f64>,
    vertices: u64,
    triangles: u64,
    largest_distance: Option<f32>,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    if args.output.extension().is_none_or(|e| !e.eq_ignore_ascii_case("png")) {
        return Err(Error::usage(format!("{}: a picture's name ends in .png", args.output.display())));
    }
    args.force.check(&args.output, args.inputs.iter().chain(&args.distance_to))?;
    let memory = args.machine.memory(talk);
    let (cancel, bar) = (super::signals::cancel_token(), talk.progress());
    let job = Job { args, memory, scratch: args.scratch.clone().unwrap_or_else(std::env::temp_dir), cancel };
    let drawn = job.draw(&*bar);
    bar.end();
    let (canvas, panels) = drawn?;
    publish(&args.output, &canvas.png()).map_err(|e| Error::io("write", &args.output, e))?;
    if args.json {
        let report = serde_json::json!({ "file": args.output, "size": canvas.size, "panels": panels });
        return super::print_json("render", &report);
    }
    let [w, h] = canvas.size;
    let mut out = format!("{}: {w} x {h} pixels\n", args.output.display());
    for p in &panels {
        let isovalue = p.isovalue.map_or(String::new(), |v| format!(", isovalue {v}"));
        let far = p
            .largest_distance
            .map_or(String::new(), |d| format!(", at most {} world units away", text::number(f64::from(d))));
        out += &format!("  {}{isovalue}: {} triangles{far}\n", p.input, text::count(p.triangles));
    }
    super::print(&out)
}

struct Job<'a> {
    args: &'a Args,
    memory: u64,
    scratch: PathBuf,
    cancel: CancelToken,
}

impl Job<'_> {
    fn draw(&self, progress: &dyn Progress) -> Result<(Canvas, Vec<PanelReport>)> {
        let args = self.args;
        let mut panels = self.panels(progress)?;
        let layout = Layout::new(args, panels.len())?;
        let canvas = Canvas::new(layout.size, args.background);
        let captions = self.captions(&panels)?;
        captions.iter().try_for_each(|c| canvas.check(c))?;
        let range = self.measure(&mut panels, progress)?;
        let surfaces: Vec<&dyn SurfaceSource> =
            panels.iter().map(|p| &p.surface as &dyn SurfaceSource).collect();
        let camera = Camera {
            azimuth: args.azimuth,
            elevation: args.elevation,
            up: args.up,
            zoom: args.zoom,
            perspective: !args.orthographic,
        };
        let view = View::fit(&camera, &surfaces, args.size)?;
        let mut canvas = canvas;
        progress.begin("draw", panels.len() as u64, "panels");
        for (n, panel) in panels.iter().enumerate() {
            let paint = match range {
                Some(end) => Paint::Values([0.0, end]),
                None => args.colour[n % args.colour.len()],
            };
            let subject = Subject { surface: &panel.surface, paint, values: &panel.distances };
            let taken = layout.bytes();
            let drawn = render(&subject, &view, &self.settings(taken))
                .map_err(|e| self.whole(e.beside(taken), self.memory / 8 * 7))?;
            layout.put(&mut canvas, n, &drawn, captions.get(n));
            progress.advance(1);
        }
        let report = |p: &Panel| PanelReport {
            input: p.name.clone(),
            isovalue: p.isovalue,
            vertices: p.surface.vertex_count(),
            triangles: p.surface.triangle_count(),
            largest_distance: range.map(|_| p.distances.iter().copied().fold(0.0, f32::max)),
        };
        let reports: Vec<PanelReport> = panels.iter().map(report).collect();
        if let Some(end) = range {
            let largest = reports.iter().filter_map(|r| r.largest_distance).fold(0.0, f32::max);
            layout.scale(&mut canvas, end, largest);
        }
        Ok((canvas, reports))
    }

    fn settings(&self, taken: u64) -> RenderSettings {
        RenderSettings {
            resources: Resources::default()
                .with_threads(self.args.machine.threads)
                .with_memory((self.memory / 8 * 7).saturating_sub(taken))
                .with_scratch(self.scratch.clone())
                .with_cancel(self.cancel.clone()),
            samples: self.args.antialias,
            lights: self.args.lights,
            flat: self.args.flat,
            background: self.args.background,
        }
    }

    /// The error of work that was given a share of the memory.
    fn whole(&self, error: Error, share: u64) -> Error {
        error.of_share(share, self.memory)
    }

    /// Reads all surfaces, and extracts those of archives.
    fn panels(&self, progress: &dyn Progress) -> Result<Vec<Panel>> {
        let args = self.args;
        let archives = args.inputs.iter().filter(|i| is_archive(i)).count();
        if archives > 0 && args.isovalue.is_empty() {
            return Err(Error::usage(
                "an archive is drawn at an isovalue: give --isovalue (isospan info suggests some)",
            ));
        }
        if archives == 0 && !args.isovalue.is_empty() {
            return Err(Error::usage("--isovalue is for archives"));
        }
        let count = args.inputs.len() - archives + archives * args.isovalue.len();
        let check = CheckSettings { memory: self.memory / count as u64, scratch: self.scratch.clone() };
        let mut panels = vec![];
        for input in &args.inputs {
            let name = input.display().to_string();
            if !is_archive(input) {
                let surface = load_surface(input, &check).map_err(|e| self.whole(e, check.memory))?;
                panels.push(Panel { name, isovalue: None, surface, distances: vec![] });
                continue;
            }
            let step = Archive::open(input)?.keeping(0).at(args.step.choice())?;
            for isovalue in &args.isovalue {
                let isovalue = isovalue.of(step.value_range())?;
                let surface = self.extract(&step, isovalue, &check, progress)?;
                panels.push(Panel {
                    name: name.clone(),
                    isovalue: Some(isovalue),
                    surface,
                    distances: vec![],
                });
            }
        }
        Ok(panels)
    }

    /// An isosurface, by way of a file in the scratch folder.
    fn extract(
        &self,
        step: &Step,
        isovalue: f64,
        check: &CheckSettings,
        progress: &dyn Progress,
    ) -> Result<StoredSurface> {
        let folder = tempfile::tempdir_in(&self.scratch)
            .map_err(|e| Error::io("make a temporary folder in", &self.scratch, e))?;
        let file = folder.path().join("surface.ply");
        let settings = SurfaceSettings {
            resources: Resources::default()
                .with_threads(self.args.machine.threads)
                .with_memory(self.memory / 8 * 7)
                .with_cancel(self.cancel.clone()),
            ..SurfaceSettings::of(isovalue)
        };
        let found = step
            .write_surface(&settings, &file, SurfaceFormat::Ply, progress)
            .map_err(|e| self.whole(e, settings.resources.memory))?;
        if found.triangles == 0 {
            let archive = step.path().display();
            return Err(Error::usage(format!("{archive}: the isovalue {isovalue} gives no surface")));
        }
        load_surface(&file, check).map_err(|e| self.whole(e, check.memory))
    }

    fn captions(&self, panels: &[Panel]) -> Result<Vec<String>> {
        let given = &self.args.caption;
        if !given.is_empty() && given.len() != panels.len() {
            return Err(Error::usage(format!("{} captions for {} panels", given.len(), panels.len())));
        }
        if !given.is_empty() || panels.len() == 1 {
            return Ok(given.clone());
        }
        let name = |p: &Panel| {
            let stem = Path::new(&p.name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
            // A character that the font lacks is no reason to fail where no labels were asked for.
            let stem: String = stem.chars().map(|c| if c.is_ascii_graphic() { c } else { '_' }).collect();
            p.isovalue.map_or(stem.clone(), |v| format!("{stem}, {v}"))
        };
        Ok(panels.iter().map(name).collect())
    }

    /// Measures the distances of all vertices; returns the end of the scale.
    fn measure(&self, panels: &mut [Panel], progress: &dyn Progress) -> Result<Option<f32>> {
        let Some(target) = &self.args.distance_to else { return Ok(None) };
        let check = CheckSettings { memory: self.memory / 4, scratch: self.scratch.clone() };
        let target = load_surface(target, &check).map_err(|e| self.whole(e, check.memory))?;
        let settings = CompareSettings {
            resources: Resources::default()
                .with_threads(self.args.machine.threads)
                .with_memory(self.memory / 2)
                .with_scratch(self.scratch.clone())
                .with_cancel(self.cancel.clone()),
            ..CompareSettings::default()
        };
        progress.begin("distances", panels.len() as u64, "panels");
        let mut end = 0.0f32;
        for panel in panels {
            panel.distances = distances(&panel.surface, &target, &settings)
                .map_err(|e| self.whole(e, settings.resources.memory))?;
            let mut sorted = panel.distances.clone();
            let place = (sorted.len() as f64 * 0.995) as usize;
            let (_, at, _) =
                sorted.select_nth_unstable_by(place.min(panel.distances.len() - 1), f32::total_cmp);
            end = end.max(*at);
            progress.advance(1);
        }
        let end = self.args.distance_max.map_or(end, |most| most as f32);
        if end.is_finite() && end >= 0.0 {
            Ok(Some(end))
        } else {
            Err(Error::usage("--distance-max is a length"))
        }
    }
}

/// Where everything is on the canvas.
struct Layout {
    columns: usize,
    panel: [usize; 2],
    /// Height of a line of words, and of the letters in it; 0 without captions.
    line: usize,
    letters: f32,
    /// Where the scale begins.
    scale_top: usize,
    size: [usize; 2],
    ink: [u8; 3],
}

impl Layout {
    fn new(args: &Args, panels: usize) -> Result<Self> {
        let columns = args.columns.unwrap_or(panels.min(4)).clamp(1, panels);
        let panel = args.size.map(|s| s as usize);
        let letters = (panel[1] as f32 / 24.0).clamp(13.0, 48.0);
        let has_words = panels > 1 || !args.caption.is_empty();
        let line = if has_words { (letters * 2.0) as usize } else { 0 };
        let rows = panels.div_ceil(columns);
        let scale_top = rows * (panel[1] + line);
        let scale = if args.distance_to.is_some() { (letters * 4.6) as usize } else { 0 };
        let size = [columns * panel[0], scale_top + scale];
        if size[0] * size[1] > 1 << 28 {
            return Err(Error::usage(format!("a picture of {} x {} pixels is too large", size[0], size[1])));
        }
        let [r, g, b, opacity] = args.background;
        let dark = opacity > 127 && 2 * u32::from(r) + 5 * u32::from(g) + u32::from(b) < 8 * 110;
        let ink = if dark { [235; 3] } else { [30; 3] };
        Ok(Self { columns, panel, line, letters, scale_top, size, ink })
    }

    /// Bytes of the canvas, and of its file.
    fn bytes(&self) -> u64 {
        12 * (self.size[0] * self.size[1]) as u64
    }

    fn put(&self, canvas: &mut Canvas, n: usize, image: &Image, caption: Option<&String>) {
        let (left, top) = (n % self.columns * self.panel[0], n / self.columns * (self.panel[1] + self.line));
        canvas.paste(image, [left, top]);
        if let Some(words) = caption {
            // Letters that fit the panel.
            let fits = 0.96 * self.panel[0] as f32 / canvas.width(words, 1.0).max(0.01);
            let middle = left as f32 + self.panel[0] as f32 / 2.0;
            let baseline = (top + self.panel[1]) as f32 + 1.2 * self.letters;
            canvas.write(words, self.letters.min(fits), [middle, baseline], self.ink);
        }
    }

    /// The colours of distances, with numbers.
    fn scale(&self, canvas: &mut Canvas, end: f32, largest: f32) {
        let length = (self.size[0] as f32 * 0.6).min(1000.0).round() as usize;
        let (left, letters) = ((self.size[0] - length) / 2, self.letters * 0.85);
        let (top, height) = (self.scale_top + (1.6 * self.letters) as usize, (0.7 * self.letters) as usize);
        for x in 0..length {
            canvas.fill([left + x, top, 1, height], scale_colour((x as f32 + 0.5) / length as f32));
        }
        let title = format!("distance (largest {})", short(f64::from(largest)));
        let middle = self.size[0] as f32 / 2.0;
        canvas.write(&title, letters, [middle, top as f32 - 0.45 * self.letters], self.ink);
        for tick in ticks(0.0, f64::from(end)) {
            let at = if end > 0.0 { (tick as f32 / end).min(1.0) } else { 0.0 };
            let x = left + (at * (length - 1) as f32).round() as usize;
            canvas.fill([x, top + height, 1, (0.25 * self.letters) as usize], self.ink);
            let baseline = (top + height) as f32 + 1.25 * self.letters;
            canvas.write(&short(tick), letters, [x as f32, baseline], self.ink);
        }
    }
}

/// A number of a scale.
fn short(v: f64) -> String {
    text::value(text::figures(v, 3)).replace('-', "−")
}
