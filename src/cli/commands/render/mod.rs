//! `isospan render`: pictures of surfaces and of the field on planes, and animations of them.
//!
//! [`scene`] makes the panels: surfaces are read, extracted and cut. [`plane`] samples the field on
//! planes. [`layout`] says where everything is on the canvas. [`film`] writes frames.

mod film;
mod layout;
mod plane;
mod scene;

use super::figure::canvas::{Canvas, drawable};
use super::figure::publish;
use super::grammar::{self, AXES, Plane, Range, Slab, Value};
use super::level::LevelArgs;
use super::machine::Machine;
use super::output::Force;
use super::progress::Talk;
use super::step::StepArgs;
use super::text;
use clap::Parser as _;
use film::{Film, FilmFormat, Pace};
use isospan::compare::{CompareSettings, distances};
use isospan::exec::{CancelToken, Progress};
use isospan::formats::surface::load_surface;
use isospan::pipeline::{StepRange, is_archive};
use isospan::render::{Camera, ColourMap, Image, Paint, RenderSettings, Subject, Up, View, render};
use isospan::surface::check::CheckSettings;
use isospan::surface::{SurfaceSource, TriMesh};
use isospan::volume::units::{Unit, common};
use isospan::{Error, Resources, Result};
use layout::{PanelLayout, Parts};
use scene::{Input, Panel, Shape};
use serde::Serialize;
use std::ffi::OsString;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Draw surfaces, isosurfaces and slices as pictures or animations.
///
/// Each has a panel, and all are seen from the same place.
/// No graphics card is needed, and the same command gives the same bytes on every machine. With
/// --distance-to, colours show how far each surface is from another one.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan render scan.isospan --isovalue 600,1000 -o scan.png\n  isospan render scan.isospan -i 600,1000 --together --opacity 0.3,1 -o both.png\n  isospan render scan.isospan -i 600 --clip y=50%: --slice y=50% -o cut.png\n  isospan render flow.isospan -i 0.1 --colour-by pressure -o flow.png\n  isospan render scan.isospan -i 600 --turntable 36 -o turn.gif\n  isospan render scan.isospan -i 600 --level 2 -o look.png\n  isospan render full.ply small.ply -o two.png --distance-to full.ply\n  isospan render full.ply small.ply -o both.png --distance-to small.ply --distance-to full.ply"
)]
pub struct Args {
    /// Surfaces (.ply .stl .obj .vtp .vtkhdf .glb) or archives, these also by address: s3://... or
    /// https://...
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// The file to write: .png for a picture, .gif or .apng for an animation. With --turntable, a
    /// .png is an animated PNG.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Isovalues of the archives, one panel each. 50% is half-way from the least value of the step
    /// to its largest; of several steps, of their values together.
    #[arg(
        long,
        short = 'i',
        value_name = "VALUE[,VALUE..]",
        value_delimiter = ',',
        allow_hyphen_values = true,
        value_parser = grammar::value
    )]
    isovalue: Vec<Value>,
    /// Draw all isovalues of an archive in one panel, with a legend. Without --colour, their
    /// colours are those of --colour-map.
    #[arg(long)]
    together: bool,
    /// Planes on which the field of the archives is shown: z=40 in world units, or x=50% of the
    /// domain. With --isovalue they stand among the surfaces; alone, each is a flat picture with
    /// axes. A grid with coordinates of its own has none.
    #[arg(long, value_name = "PLANE[,PLANE..]", allow_hyphen_values = true, value_delimiter = ',', value_parser = grammar::plane)]
    slice: Vec<Plane>,
    /// Colour the surfaces of the archives by another field, and draw a scale: by a field of the
    /// same archive (see reduce --fields), or by another archive in the same world. Planes of
    /// --slice show this field too. What has no value is grey.
    #[arg(long, visible_alias = "color-by", value_name = "FIELD|ARCHIVE", requires = "isovalue", conflicts_with_all = ["colour", "distance_to"])]
    colour_by: Option<PathBuf>,
    /// Colours of the field on planes, of --colour-by, and of the isovalues of --together: viridis,
    /// cividis, coolwarm or grey.
    #[arg(long, visible_alias = "color-map", value_name = "MAP", default_value = "viridis", allow_hyphen_values = true, value_parser = grammar::colour_map)]
    colour_map: ColourMap,
    /// Values at the ends of the colours of --slice and --colour-by: 300:900 or 10%:50%; an omitted
    /// end is that of the field [default: the range of the field, of all steps that are drawn].
    #[arg(long, visible_alias = "color-range", value_name = "LO:HI", allow_hyphen_values = true, value_parser = grammar::range)]
    colour_range: Option<Range>,
    /// Keep what lies in a range of an axis, and cut the rest of the surfaces away: x=40: keeps x
    /// from 40 on, x=:40 up to 40, y=10:20 what lies between. In world units, or in % of the
    /// domain. Planes of --slice are not cut.
    #[arg(long, value_name = "AXIS=LO:HI[,..]", allow_hyphen_values = true, value_delimiter = ',', value_parser = grammar::slab)]
    clip: Vec<Slab>,
    /// Text below a panel; give it once per panel. Without it, several panels, and the frames of a
    /// series, show what tells them apart: file, isovalue or plane, step or time.
    #[arg(long, value_name = "TEXT")]
    caption: Vec<String>,
    /// Draw a bar of a round length, in world units. In perspective, it is true at the depth of the
    /// middle of what is drawn.
    #[arg(long)]
    scale_bar: bool,
    /// Number of panels in a row [default: all, up to 4].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = grammar::whole_in(1..=1000usize))]
    columns: Option<usize>,
    /// Size of a panel in pixels.
    #[arg(long, value_name = "W,H", allow_hyphen_values = true, default_value = "800,800", value_parser = grammar::extent)]
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
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true, default_value = "1", value_parser = grammar::positive_number, help_heading = "Camera")]
    zoom: f64,
    /// Use parallel projection instead of perspective.
    #[arg(long, help_heading = "Camera")]
    orthographic: bool,
    /// Draw this many frames of one turn around the upward axis, in place of one picture.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = grammar::whole_in(2..=1000u32), help_heading = "Animation")]
    turntable: Option<u32>,
    /// Frames in a second [default: 15].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = grammar::frame_rate, help_heading = "Animation")]
    fps: Option<f64>,
    /// Colour of the surface, #rrggbb or "normals": one for all, one per isovalue, or one per
    /// surface [default: #d8cbb4].
    #[arg(long, value_name = "COLOUR[,COLOUR..]", allow_hyphen_values = true, value_delimiter = ',', value_parser = grammar::paint)]
    colour: Vec<Paint>,
    /// Opacity, 0.3 or 30%: one for all surfaces, one per isovalue, or one per surface. What is
    /// transparent throws no shadow [default: 1].
    #[arg(long, value_name = "O[,O..]", allow_hyphen_values = true, value_delimiter = ',', value_parser = grammar::opacity)]
    opacity: Vec<f32>,
    /// Colour each point by its distance from this surface, and draw a scale. Given once per panel,
    /// each has its own.
    #[arg(long, value_name = "SURFACE", conflicts_with_all = ["together", "slice", "steps", "all_steps"])]
    distance_to: Vec<PathBuf>,
    /// The distance at the end of the scale [default: the 99.5th percentile over the vertices].
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true, value_parser = grammar::number, requires = "distance_to")]
    distance_max: Option<f64>,
    /// Background colour: #rrggbb or "transparent".
    #[arg(long, value_name = "COLOUR", allow_hyphen_values = true, default_value = "#ffffff", value_parser = grammar::background)]
    background: [u8; 4],
    /// Shade triangles flat instead of smoothly.
    #[arg(long)]
    flat: bool,
    /// Samples along each side of a pixel, 1 to 8.
    #[arg(long, value_name = "N", allow_hyphen_values = true, default_value = "3", value_parser = grammar::whole_in(1..=8u32))]
    antialias: u32,
    /// Number of lights in the sky, whose shadows make soft light; 0 for light without shadows.
    #[arg(long, value_name = "N", allow_hyphen_values = true, default_value = "32", value_parser = grammar::whole::<u32>)]
    lights: u32,
    #[command(flatten)]
    level: LevelArgs,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    step: StepArgs,
    /// Draw all steps: each is a frame of a .gif or .apng, and a panel of a .png. With --turntable,
    /// each is a panel.
    #[arg(help_heading = "Series", long, conflicts_with_all = ["step", "time", "steps"])]
    all_steps: bool,
    /// As --all-steps, for the steps from one number to another; either end may be omitted.
    #[arg(help_heading = "Series", long, value_name = "FIRST:LAST", value_parser = grammar::steps, conflicts_with_all = ["step", "time"], allow_hyphen_values = true)]
    steps: Option<StepRange>,
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

impl Args {
    /// The steps that are drawn; none where it is a single one.
    fn step_range(&self) -> Option<StepRange> {
        self.steps.or(self.all_steps.then(StepRange::default))
    }
}

/// Frames in a second, unless said otherwise.
const FRAME_RATE: f64 = 15.0;

/// The colours of the field: a map, and the values at its ends.
struct Colours {
    map: ColourMap,
    range: [f64; 2],
}

impl Colours {
    /// A value's place between the ends; NaN for no value.
    fn share(&self, value: f64) -> f64 {
        let [lo, hi] = self.range;
        if value.is_nan() || hi > lo { (value - lo) / (hi - lo) } else { 0.0 }
    }

    fn of(&self, value: f64) -> [u8; 3] {
        self.map.colour(self.share(value))
    }
}

/// What a panel shows, in numbers.
#[derive(Serialize)]
struct PanelReport {
    input: String,
    step: Option<u64>,
    /// The level of a pyramid.
    level: Option<u32>,
    /// The unit of its isovalues.
    #[serde(skip)]
    unit: Option<Unit>,
    surfaces: Vec<ShapeReport>,
    slices: Vec<SliceReport>,
}

/// A surface in numbers.
#[derive(Serialize)]
struct ShapeReport {
    isovalue: Option<f64>,
    opacity: f32,
    vertices: u64,
    triangles: u64,
    largest_distance: Option<f32>,
    /// Vertices at which the field of --colour-by has no value.
    without_value: Option<u64>,
}

/// A plane on which the field is shown.
#[derive(Serialize)]
struct SliceReport {
    axis: &'static str,
    at: f64,
}

/// What was drawn.
#[derive(Serialize)]
struct Drawn {
    size: [usize; 2],
    frames: usize,
    /// The unit of lengths.
    length_unit: Option<Unit>,
    /// Values at the ends of the colours of a field.
    range: Option<[f64; 2]>,
    panels: Vec<PanelReport>,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let bar = talk.progress();
    let drawn = drawn(args, talk, super::signals::cancel_token(), &*bar);
    bar.end();
    let drawn = drawn?;
    match args.json {
        true => super::print_json("render", &report(args, &drawn)),
        false => super::print(&in_words(&args.output, &drawn)),
    }
}

/// Draws, and returns what `--json` prints.
///
/// # Errors
/// Those of the command.
pub fn draw(
    args: &Args,
    talk: &Talk,
    cancel: CancelToken,
    progress: &dyn Progress,
) -> Result<serde_json::Value> {
    Ok(report(args, &drawn(args, talk, cancel, progress)?))
}

fn drawn(args: &Args, talk: &Talk, cancel: CancelToken, progress: &dyn Progress) -> Result<Drawn> {
    let kind = FilmFormat::of(&args.output)?;
    args.force.check(&args.output, args.inputs.iter().chain(&args.distance_to))?;
    let memory = args.machine.memory(talk);
    let scratch = args.scratch.clone().unwrap_or_else(std::env::temp_dir);
    Job { args, memory, scratch, cancel }.draw(kind, progress)
}

fn report(args: &Args, drawn: &Drawn) -> serde_json::Value {
    serde_json::json!({
        "file": args.output,
        "size": drawn.size,
        "frames": drawn.frames,
        "range": drawn.range,
        "panels": drawn.panels,
    })
}

/// A picture of two surfaces side by side, each coloured by its distance from the other.
pub(crate) struct BothWays<'a> {
    pub(crate) surfaces: [&'a Path; 2],
    /// What they are called.
    pub(crate) names: [String; 2],
    pub(crate) out: &'a Path,
    pub(crate) memory: u64,
    pub(crate) threads: usize,
    pub(crate) scratch: &'a Path,
}

/// The flags of a picture, by themselves.
#[derive(clap::Parser)]
struct Alone {
    #[command(flatten)]
    args: Args,
}

impl BothWays<'_> {
    /// Refuses a name that is not one of a picture.
    pub(crate) fn check(out: &Path) -> Result<()> {
        match FilmFormat::of(out)? {
            FilmFormat::Png => Ok(()),
            _ => {
                Err(Error::usage(format!("{} is an animation: give a name that ends in .png", out.display())))
            }
        }
    }

    /// Draws it, in place of what is there.
    pub(crate) fn draw(&self, talk: &Talk) -> Result<()> {
        let ([a, b], [of_a, of_b]) = (self.surfaces, self.names.each_ref().map(|name| plain(name)));
        let captions = [format!("{of_a}: distance to {of_b}"), format!("{of_b}: distance to {of_a}")];
        let mut words: Vec<OsString> = ["render", "--force", "--output"].map(OsString::from).to_vec();
        words.push(self.out.into());
        for (target, caption) in [b, a].into_iter().zip(captions) {
            words.extend(["--distance-to".into(), target.into(), "--caption".into(), caption.into()]);
        }
        words.extend(["--memory".into(), self.memory.to_string().into()]);
        words.extend(["--threads".into(), self.threads.to_string().into()]);
        words.extend(["--scratch".into(), self.scratch.into(), "--".into(), a.into(), b.into()]);
        let alone = Alone::try_parse_from(words).map_err(|e| Error::usage(e.to_string()))?;
        let bar = talk.progress();
        let outcome = drawn(&alone.args, talk, super::signals::cancel_token(), &*bar);
        bar.end();
        outcome.map(|_| ())
    }
}

fn in_words(file: &Path, drawn: &Drawn) -> String {
    let [w, h] = drawn.size;
    let frames = if drawn.frames > 1 { format!(", {} frames", drawn.frames) } else { String::new() };
    let mut out = format!("{}: {w} x {h} pixels{frames}\n", file.display());
    for p in &drawn.panels {
        let step = p.step.map_or(String::new(), |n| format!(", step {n}"));
        let step = p.level.map_or(step.clone(), |n| format!("{step}, level {n}"));
        for s in &p.surfaces {
            let unit = text::unit(p.unit.as_ref());
            let isovalue = s.isovalue.map_or(String::new(), |v| format!(", isovalue {v}{unit}"));
            let far = s.largest_distance.map_or(String::new(), |d| {
                let length = drawn.length_unit.as_ref().map_or("world units", Unit::as_str);
                format!(", at most {} {length} away", text::number(f64::from(d)))
            });
            let triangles = text::plural(s.triangles, "triangle");
            let without = s.without_value.filter(|&n| n > 0).map_or(String::new(), |n| {
                format!(", {} of {} vertices without a value", text::count(n), text::count(s.vertices))
            });
            out += &format!("  {}{step}{isovalue}: {triangles}{far}{without}\n", p.input);
        }
        for s in &p.slices {
            let unit = text::unit(drawn.length_unit.as_ref());
            out += &format!("  {}{step}: the plane {} = {}{unit}\n", p.input, s.axis, text::number(s.at));
        }
    }
    out
}

/// A number in a caption.
fn words_of(v: f64) -> String {
    text::number(v).replace('-', "−")
}

/// A number in a caption, with its unit.
fn with_unit(v: f64, unit: Option<&Unit>) -> String {
    words_of(v) + &drawable(&text::unit(unit))
}

struct Job<'a> {
    args: &'a Args,
    memory: u64,
    scratch: PathBuf,
    cancel: CancelToken,
}

impl Job<'_> {
    fn draw(&self, kind: FilmFormat, progress: &dyn Progress) -> Result<Drawn> {
        let args = self.args;
        let inputs = self.open()?;
        let steps = args.step_range().is_some();
        let steps_are_frames = steps && kind.is_of_frames() && args.turntable.is_none();
        let frames = self.frames(&inputs, kind, steps_are_frames)?;
        let panels_of = |i: &Input| i.panels(args) * if steps_are_frames { 1 } else { i.moments() };
        let count: usize = inputs.iter().map(panels_of).sum();
        let flat = inputs.iter().all(|i| matches!(i, Input::Archive(_))) && args.isovalue.is_empty();
        if flat && args.turntable.is_some() {
            return Err(Error::usage("--turntable turns surfaces: give --isovalue too"));
        }
        if flat && args.scale_bar {
            return Err(Error::usage("--scale-bar is for surfaces: a flat slice has axes"));
        }
        let parts = Parts {
            panels: count,
            frames,
            captions: !args.caption.is_empty() || count > 1 || steps_are_frames,
            legends: args.together && args.isovalue.len() > 1 && args.colour_by.is_none(),
            bar: !args.distance_to.is_empty() || !args.slice.is_empty() || args.colour_by.is_some(),
            scale_bar: args.scale_bar,
        };
        let layout = PanelLayout::new(args, parts)?;
        self.check_captions(count)?;
        let colours = self.colours(&inputs)?;
        let mut panels = self.panels(&inputs, steps_are_frames, progress)?;
        let end = self.measure(&mut panels, progress)?;
        if let Some(colours) = colours.as_ref().filter(|_| args.colour_by.is_some()) {
            self.colour(&mut panels, colours, progress)?;
        }
        let views = self.views(&panels, args.turntable.map_or(1, |n| n as usize))?;
        let legend = colours.as_ref().map(|c| (bar_title(&inputs, args.colour_by.as_deref()), c));
        let length_unit = common(panels.iter().map(|panel| panel.length_unit().cloned()));
        let stage =
            Stage { job: self, layout, inputs: inputs.len(), panels, views, end, legend, length_unit };
        progress.begin("draw", (frames * count) as u64, "panels");
        publish(&args.output, |out| {
            let failed = |e| Error::io("write", &args.output, e);
            if frames == 1 && !kind.is_of_frames() {
                return out.write_all(&stage.frame(0, progress)?.png()).map_err(failed);
            }
            let pace = Pace { frames: frames as u32, rate: args.fps.unwrap_or(FRAME_RATE) };
            let opaque = args.background[3] == 255;
            let mut film = Film::begin(&args.output, out, kind, stage.layout.size, pace, opaque)?;
            for n in 0..frames {
                film.add(&stage.frame(n, progress)?)?;
            }
            film.end()
        })?;
        Ok(stage.report(frames))
    }

    /// How many frames there are; 1 of a picture.
    fn frames(&self, inputs: &[Input], kind: FilmFormat, steps_are_frames: bool) -> Result<usize> {
        let args = self.args;
        if let Some(n) = args.turntable {
            return Ok(n as usize);
        }
        if steps_are_frames {
            let mut counts = inputs.iter().filter(|i| matches!(i, Input::Archive(_))).map(Input::moments);
            let first = counts.next().unwrap_or(1);
            return match counts.find(|&n| n != first) {
                None => Ok(first),
                Some(other) => Err(Error::usage(format!(
                    "the archives have {first} and {other} steps: of an animation all have the same number"
                ))),
            };
        }
        if kind.is_of_frames() {
            let file = args.output.display();
            return Err(Error::usage(format!(
                "{file} is an animation: give --turntable, --all-steps or --steps, or a name that ends in .png"
            )));
        }
        if args.fps.is_some() {
            return Err(Error::usage(
                "--fps is for an animation: give --turntable, or a name that ends in .gif or .apng",
            ));
        }
        Ok(1)
    }

    /// The colours of the field on planes and surfaces, where there are some.
    fn colours(&self, inputs: &[Input]) -> Result<Option<Colours>> {
        if self.args.slice.is_empty() && self.args.colour_by.is_none() {
            return match self.args.colour_range {
                Some(_) => Err(Error::usage("--colour-range is for --slice and --colour-by")),
                None => Ok(None),
            };
        }
        let ranges = inputs.iter().filter_map(|i| match i {
            Input::Archive(opened) => opened.colour_range(),
            Input::Surface(_) => None,
        });
        let all = ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        let Some(whole) = all else {
            return Err(Error::usage("there is no field to show: no point has a value"));
        };
        let range = self.args.colour_range.map_or(Ok(whole), |range| range.within(all))?;
        Ok(Some(Colours { map: self.args.colour_map, range }))
    }

    /// Gives the surfaces of archives the values of the field that colours them.
    fn colour(&self, panels: &mut [Panel], colours: &Colours, progress: &dyn Progress) -> Result<()> {
        // Counted from the least one: large values that differ little are one f32.
        let [least, largest] = colours.range;
        let paint = Paint::Map(colours.map, [0.0, (largest - least) as f32]);
        progress.begin("colours", panels.len() as u64, "panels");
        for panel in panels {
            let Some(moment) = &panel.moment else { continue };
            for shape in &mut panel.shapes {
                let (Some(surface), Some(isovalue)) = (&shape.surface, shape.isovalue) else { continue };
                let found = moment.step.values_on(&moment.field, surface, isovalue, &self.resources(0));
                let found = found.map_err(|e| self.whole(e, self.memory / 8 * 7))?;
                shape.values = found.into_iter().map(|v| (v - least) as f32).collect();
                shape.paint = paint;
            }
            progress.advance(1);
        }
        Ok(())
    }

    /// The view of each frame, of one scale; none where all panels are flat.
    fn views(&self, panels: &[Panel], count: usize) -> Result<Vec<View>> {
        let args = self.args;
        let in_space = || panels.iter().filter(|p| !p.flat);
        let rectangles: Vec<TriMesh> =
            in_space().flat_map(|p| &p.slices).map(|slice| slice.rectangle()).collect();
        let mut drawn: Vec<&dyn SurfaceSource> =
            in_space().flat_map(|p| &p.shapes).filter_map(Shape::source).collect();
        drawn.extend(rectangles.iter().map(|r| r as &dyn SurfaceSource));
        if drawn.is_empty() {
            return Ok(vec![]);
        }
        let camera = |n: usize| Camera {
            azimuth: args.azimuth + 360.0 * n as f64 / count as f64,
            elevation: args.elevation,
            up: args.up,
            zoom: args.zoom,
            perspective: !args.orthographic,
        };
        let cameras: Vec<Camera> = (0..count).map(camera).collect();
        View::fit_all(&cameras, &drawn, args.size)
    }

    fn resources(&self, taken: u64) -> Resources {
        Resources::default()
            .with_threads(self.args.machine.threads)
            .with_memory((self.memory / 8 * 7).saturating_sub(taken))
            .with_scratch(self.scratch.clone())
            .with_cancel(self.cancel.clone())
    }

    fn settings(&self, taken: u64) -> RenderSettings {
        RenderSettings {
            resources: self.resources(taken),
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

    fn check_captions(&self, panels: usize) -> Result<()> {
        let given = &self.args.caption;
        if !given.is_empty() && given.len() != panels {
            return Err(Error::usage(format!("{} captions for {panels} panels", given.len())));
        }
        let canvas = Canvas::new([1, 1], self.args.background);
        given.iter().try_for_each(|c| canvas.check(c))
    }

    /// Measures the distances of all vertices; returns the end of the scale.
    fn measure(&self, panels: &mut [Panel], progress: &dyn Progress) -> Result<Option<f32>> {
        let targets = &self.args.distance_to;
        if targets.is_empty() {
            return Ok(None);
        }
        if targets.len() > 1 && targets.len() != panels.len() {
            let (given, wanted) = (targets.len(), panels.len());
            return Err(Error::usage(format!("{given} surfaces in --distance-to for {wanted} panels")));
        }
        let check = CheckSettings { memory: self.memory / 4, scratch: self.scratch.clone() };
        let load = |n: usize| load_surface(&targets[n], &check).map_err(|e| self.whole(e, check.memory));
        let mut target = load(0)?;
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
        let shapes =
            panels.iter_mut().enumerate().flat_map(|(n, p)| p.shapes.iter_mut().map(move |s| (n, s)));
        for (n, shape) in shapes {
            let Some(surface) = &shape.surface else { continue };
            if n > 0 && targets.len() > 1 {
                target = load(n)?;
            }
            shape.values = distances(surface, &target, &settings)
                .map_err(|e| self.whole(e, settings.resources.memory))?;
            let mut sorted = shape.values.clone();
            let place = (sorted.len() as f64 * 0.995) as usize;
            let last = sorted.len().saturating_sub(1);
            let (_, at, _) = sorted.select_nth_unstable_by(place.min(last), f32::total_cmp);
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

/// What the bar of colours is of, and its unit, where all archives have the same.
fn bar_title(inputs: &[Input], by: Option<&Path>) -> String {
    let units = inputs.iter().filter_map(|i| match i {
        Input::Archive(opened) => Some(opened.colour_unit()),
        Input::Surface(_) => None,
    });
    let unit = common(units).map_or_else(String::new, |unit| drawable(&format!(" ({unit})")));
    field_name(inputs, by) + &unit
}

/// What the bar of colours is of: the archive that colours are asked of, or the field of the
/// archives, if it has one name.
fn field_name(inputs: &[Input], by: Option<&Path>) -> String {
    if let Some(by) = by.filter(|by| is_archive(by)) {
        return plain(&by.file_stem().unwrap_or_default().to_string_lossy());
    }
    let mut names = inputs.iter().filter_map(|i| match i {
        Input::Archive(opened) => Some(opened.colour_field()),
        Input::Surface(_) => None,
    });
    match names.next() {
        Some(first) if !first.is_empty() && names.all(|n| n == first) => plain(first),
        _ => "value of the field".to_owned(),
    }
}

/// Words that were not typed: a character that the font lacks is no reason to fail.
fn plain(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_graphic() || c == ' ' { c } else { '_' }).collect()
}

/// All that frames are drawn from.
struct Stage<'a> {
    job: &'a Job<'a>,
    layout: PanelLayout,
    inputs: usize,
    panels: Vec<Panel>,
    views: Vec<View>,
    /// The end of the scale of distances.
    end: Option<f32>,
    /// What the bar of colours is of, and its colours.
    legend: Option<(String, &'a Colours)>,
    /// The unit of lengths, where all inputs have the same.
    length_unit: Option<Unit>,
}

impl Stage<'_> {
    fn frame(&self, frame: usize, progress: &dyn Progress) -> Result<Canvas> {
        let args = self.job.args;
        let mut canvas = Canvas::new(self.layout.size, args.background);
        let shown = self.panels.iter().filter(|p| p.frame.is_none_or(|n| n == frame));
        let words = self.layout.has_captions();
        for (n, panel) in shown.enumerate() {
            self.layout.put(&mut canvas, n, &self.picture(panel, frame)?);
            if words {
                let caption = args.caption.get(n).cloned().unwrap_or_else(|| self.caption(panel));
                self.layout.caption(&mut canvas, n, &caption);
            }
            if panel.shapes.len() > 1 {
                let unit = panel.value_unit();
                let entries = panel.shapes.iter().filter_map(|shape| entry(shape, unit));
                let entries: Vec<([u8; 3], String)> = entries.collect();
                self.layout.legend(&mut canvas, n, &entries);
            }
            progress.advance(1);
        }
        if args.scale_bar
            && let Some(view) = self.views.first()
        {
            self.layout.scale_bar(&mut canvas, view.pixel(), self.length_unit.as_ref());
        }
        if let Some((name, colours)) = &self.legend {
            self.layout.colours(&mut canvas, name, colours);
        }
        if let Some(end) = self.end {
            let all = self.panels.iter().flat_map(|p| &p.shapes).flat_map(|s| &s.values);
            let largest = all.copied().fold(0.0, f32::max);
            self.layout.distances(&mut canvas, end, largest, self.length_unit.as_ref());
        }
        Ok(canvas)
    }

    fn picture(&self, panel: &Panel, frame: usize) -> Result<Image> {
        let (job, share) = (self.job, self.job.memory / 8 * 7);
        let distances = |s: &Shape| 4 * s.values.len() as u64;
        let mut taken =
            self.layout.bytes() + self.panels.iter().flat_map(|p| &p.shapes).map(distances).sum::<u64>();
        let beside = |e: Error, taken: u64| job.whole(e.plus_held(taken), share);
        let shown = panel.moment.as_ref().zip(self.legend.as_ref());
        let shown = shown.map(|(moment, (_, colours))| moment.shown(colours));
        if let (true, Some(shown), [slice]) = (panel.flat, &shown, &panel.slices[..]) {
            let size = job.args.size.map(|s| s as usize);
            let unit = panel.length_unit();
            let drawn = slice.picture(shown, size, job.args.background, unit, &job.resources(taken));
            let canvas = drawn.map_err(|e| beside(e, taken))?;
            return Ok(Image { size: job.args.size, pixels: canvas.pixels });
        }
        let mut planes: Vec<(TriMesh, Vec<f32>)> = vec![];
        if let Some(shown) = &shown {
            for slice in &panel.slices {
                let made = slice.surface(shown, &job.resources(taken));
                let (mesh, shares) = made.map_err(|e| beside(e, taken))?;
                taken += 28 * mesh.vertices.len() as u64 + 12 * mesh.triangles.len() as u64;
                planes.push((mesh, shares));
            }
        }
        let paint = |shape: &Shape| self.end.map_or(shape.paint, |end| Paint::Values([0.0, end]));
        let mut subjects: Vec<Subject<'_>> = panel
            .shapes
            .iter()
            .filter_map(|s| {
                let (surface, values) = (s.source()?, &s.values[..]);
                Some(Subject { surface, paint: paint(s), opacity: s.opacity, values })
            })
            .collect();
        subjects.extend(planes.iter().map(|(mesh, shares)| Subject {
            surface: mesh,
            paint: Paint::Flat(job.args.colour_map, [0.0, 1.0]),
            opacity: 1.0,
            values: shares,
        }));
        let view = &self.views[frame % self.views.len()];
        render(&subjects, view, &job.settings(taken)).map_err(|e| beside(e, taken))
    }

    /// What tells a panel from the others.
    fn caption(&self, panel: &Panel) -> String {
        let stem = Path::new(&panel.name).file_stem().unwrap_or_default().to_string_lossy();
        let mut parts = vec![];
        if self.inputs > 1 {
            parts.push(plain(&stem));
        }
        if let ([Shape { isovalue: Some(v), .. }], false) = (&panel.shapes[..], self.job.args.together) {
            parts.push(format!("isovalue {}", with_unit(*v, panel.value_unit())));
        }
        if let (true, [slice]) = (panel.flat, &panel.slices[..]) {
            parts.push(slice.words(panel.length_unit()));
        }
        let name = panel.moment.as_ref().and_then(|moment| moment.name.as_ref());
        parts.extend(name.map(|(_, words)| words.clone()));
        if parts.is_empty() { plain(&stem) } else { parts.join(", ") }
    }

    fn report(&self, frames: usize) -> Drawn {
        let shape = |s: &Shape| ShapeReport {
            isovalue: s.isovalue,
            opacity: s.opacity,
            vertices: s.surface.as_ref().map_or(0, |s| s.vertex_count()),
            triangles: s.surface.as_ref().map_or(0, |s| s.triangle_count()),
            largest_distance: self.end.map(|_| s.values.iter().copied().fold(0.0, f32::max)),
            without_value: matches!(s.paint, Paint::Map(..))
                .then(|| s.values.iter().filter(|v| v.is_nan()).count() as u64),
        };
        let panel = |p: &Panel| PanelReport {
            input: p.name.clone(),
            step: p.moment.as_ref().and_then(|moment| moment.name.as_ref()).map(|(number, _)| *number),
            level: p.moment.as_ref().and_then(|moment| moment.level),
            unit: p.value_unit().cloned(),
            surfaces: p.shapes.iter().map(shape).collect(),
            slices: p.slices.iter().map(|s| SliceReport { axis: AXES[s.axis], at: s.at }).collect(),
        };
        Drawn {
            size: self.layout.size,
            frames,
            length_unit: self.length_unit.clone(),
            range: self.legend.as_ref().map(|(_, colours)| colours.range),
            panels: self.panels.iter().map(panel).collect(),
        }
    }
}

/// A surface in a legend.
fn entry(shape: &Shape, unit: Option<&Unit>) -> Option<([u8; 3], String)> {
    let colour = match shape.paint {
        Paint::Plain(colour) => colour,
        _ => return None,
    };
    Some((colour, with_unit(shape.isovalue?, unit)))
}
