//! Answers the questions of the page by blocking work, as bytes that are streamed.
//!
//! The server of `isospan view` answers with these, and so does the page itself where there is no
//! server: `tools/viewer/core` compiles them to WebAssembly.

mod archives;

pub use archives::Archives;

use isospan::formats::surface::SurfaceFormat;
use isospan::pipeline::{LevelChoice, ProbeSettings, Roi, StepChoice, StreamedPart, SurfaceSink};
use isospan::render::ColourMap;
use isospan::surface::SurfaceSource;
use isospan::{Error, Resources, Result, Step, SurfaceQuery};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;

/// Isovalues of one request.
const MOST_ISOVALUES: usize = 16;
/// Samples along a side of a slice.
const MOST_SAMPLES: u32 = 1024;

/// The step that a request is about.
#[derive(Debug, Default, Deserialize)]
pub struct StepQuery {
    step: Option<u64>,
    field: Option<String>,
}

impl StepQuery {
    pub fn choice(&self) -> StepChoice {
        choice_of(self.step, self.field.as_ref())
    }
}

/// A step by its number, and by a field where each step has several.
fn choice_of(step: Option<u64>, field: Option<&String>) -> StepChoice {
    match (step, field.cloned()) {
        (None, None) => StepChoice::First,
        (None, Some(field)) => StepChoice::Field(field),
        (Some(number), None) => StepChoice::Number(number),
        (Some(number), Some(field)) => StepChoice::NumberOf(number, field),
    }
}

/// Surfaces of a step. Numbers are those of the command line.
#[derive(Debug, Deserialize)]
pub struct SurfaceRequest {
    /// `1,2.5`.
    isovalues: String,
    step: Option<u64>,
    field: Option<String>,
    /// As `--roi` has it.
    roi: Option<String>,
    #[serde(default)]
    cap: bool,
    /// Of a pyramid: the finest without.
    level: Option<u32>,
    /// The step whose field colours the surface, and which one where it has several.
    colour: Option<u64>,
    colour_field: Option<String>,
    /// Of an export: the ending of the file's name, the colour map, and the values at its ends.
    format: Option<String>,
    map: Option<String>,
    range: Option<String>,
}

impl SurfaceRequest {
    pub fn choice(&self) -> StepChoice {
        choice_of(self.step, self.field.as_ref())
    }

    /// The step whose field colours the surface.
    pub fn colour(&self) -> Option<StepChoice> {
        self.colour.map(|step| choice_of(Some(step), self.colour_field.as_ref()))
    }

    /// The question for a step that is asked.
    fn of(&self, step: &Step, resources: &Resources) -> Result<SurfaceQuery<'static>> {
        let wrong = |text: &str| Error::usage(format!("'{text}' is no isovalue"));
        let number = |text: &str| text.trim().parse::<f64>().map_err(|_| wrong(text));
        let isovalues = self.isovalues.split(',').map(number).collect::<Result<Vec<_>>>()?;
        if isovalues.len() > MOST_ISOVALUES {
            return Err(Error::usage(format!("a request has at most {MOST_ISOVALUES} isovalues")));
        }
        let roi = self.roi.as_deref().map(str::parse::<Roi>).transpose().map_err(Error::usage)?;
        let level = self.level.map(LevelChoice::Level);
        let query = step.query(isovalues).region(roi).cap(self.cap).level(level);
        Ok(query.resources(resources.clone()))
    }
}

/// Some numbers with commas.
pub fn numbers<T: std::str::FromStr, const N: usize>(text: &str, what: &str) -> Result<[T; N]> {
    let all: Option<Vec<T>> = text.split(',').map(|x| x.trim().parse().ok()).collect();
    let wrong = || Error::usage(format!("{what} '{text}': expected {N} numbers with commas"));
    all.and_then(|all| all.try_into().ok()).ok_or_else(wrong)
}

/// The field on a plane: the samples `origin + i u + j v`, in the world.
#[derive(Debug, Deserialize)]
pub struct SliceQuery {
    step: Option<u64>,
    field: Option<String>,
    origin: String,
    u: String,
    v: String,
    /// Samples along `u` and `v`.
    size: String,
}

impl SliceQuery {
    pub fn choice(&self) -> StepChoice {
        choice_of(self.step, self.field.as_ref())
    }

    fn points(&self) -> Result<([u32; 2], Vec<[f64; 3]>)> {
        let vector = |text: &str, what| {
            let v: [f64; 3] = numbers(text, what)?;
            let finite = v.iter().all(|x| x.is_finite());
            if finite { Ok(v) } else { Err(Error::usage(format!("{what} '{text}' is not finite"))) }
        };
        let [origin, u, v] = [vector(&self.origin, "origin")?, vector(&self.u, "u")?, vector(&self.v, "v")?];
        let size: [u32; 2] = numbers(&self.size, "size")?;
        if size.iter().any(|n| !(1..=MOST_SAMPLES).contains(n)) {
            return Err(Error::usage(format!("size '{}': each is 1 to {MOST_SAMPLES}", self.size)));
        }
        let at = |i: u32, j: u32| [0, 1, 2].map(|a| origin[a] + f64::from(i) * u[a] + f64::from(j) * v[a]);
        let points = (0..size[1]).flat_map(|j| (0..size[0]).map(move |i| at(i, j))).collect();
        Ok((size, points))
    }
}

/// Takes the bytes of an answer.
pub trait Sink: Send {
    /// Takes some of them.
    fn write(&mut self, bytes: &[u8]) -> Result<()>;

    /// Hands on what was taken so far.
    fn flush(&mut self) -> Result<()>;
}

/// A part of known length: its bytes in four, then the text.
fn json_part(value: &impl Serialize, sink: &mut dyn Sink) -> Result<()> {
    let text = text_of(value)?;
    // Numbers that follow are at multiples of four.
    let spaces = text.len().next_multiple_of(4) - text.len();
    sink.write(&((text.len() + spaces) as u32).to_le_bytes())?;
    sink.write(&text)?;
    sink.write(&b"   "[..spaces])
}

/// A value as JSON.
fn json(value: &impl Serialize, sink: &mut dyn Sink) -> Result<()> {
    sink.write(&text_of(value)?)
}

fn text_of(value: &impl Serialize) -> Result<Vec<u8>> {
    serde_json::to_vec(value).map_err(|e| Error::io("write", "an answer", std::io::Error::other(e)))
}

/// Parts, each with a length and JSON in front. A part of a surface has counts; then vertices
/// (position and normal, 3 × f32 each; positions count from `origin`), numbers of earlier vertices
/// that change (u32), what they become, and triangles (3 × u32). Parts of a preview come first
/// where the surface is cut or has holes; the first other one replaces them. The values of the
/// field that colours a surface (f64) are a part after its triangles. The last part has the report.
pub fn surface(
    archives: &Archives,
    archive: usize,
    query: &SurfaceRequest,
    resources: &Resources,
    sink: &mut dyn Sink,
) -> Result<()> {
    let start = archives.milliseconds();
    let field = query.colour().map(|choice| archives.at(archive, choice)).transpose()?;
    // Half is for the colours, where there are some.
    let share = resources.memory / if field.is_some() { 2 } else { 1 };
    let resources = resources.clone().with_memory(share);
    let step = archives.at(archive, query.choice())?;
    let asked = query.of(&step, &resources)?;
    let field = field.as_ref().map(|field| Colours { field, step: &step, resources: &resources });
    let mut parts = Parts { sink, isovalues: asked.isovalues(), field };
    let report = asked.stream(&mut parts)?;
    let milliseconds = archives.milliseconds() - start;
    json_part(&serde_json::json!({ "milliseconds": milliseconds, "report": report }), parts.sink)
}

/// The field that colours the surfaces of a step.
struct Colours<'a> {
    field: &'a Step,
    step: &'a Step,
    resources: &'a Resources,
}

/// Sends surfaces part by part, then the values that colour each.
struct Parts<'a> {
    sink: &'a mut dyn Sink,
    isovalues: &'a [f64],
    field: Option<Colours<'a>>,
}

impl SurfaceSink for Parts<'_> {
    fn part(&mut self, part: &StreamedPart<'_>) -> Result<()> {
        part_of_surface(part, self.sink)
    }

    fn whole(&mut self, n: usize, surface: &dyn SurfaceSource) -> Result<()> {
        let Some(Colours { field, step, resources }) = &self.field else { return Ok(()) };
        let values = step.values_on(field, surface, self.isovalues[n], resources)?;
        json_part(&serde_json::json!({ "surface": n, "values": values.len() }), self.sink)?;
        self.sink.write(bytemuck::cast_slice(&values))
    }
}

fn part_of_surface(part: &StreamedPart<'_>, sink: &mut dyn Sink) -> Result<()> {
    let head = serde_json::json!({
        "surface": part.isovalue,
        "vertices": part.added.vertex_count(),
        "changed": part.changed.len(),
        "triangles": part.added.triangle_count(),
        "chunks": part.chunks,
        "origin": part.added.origin(),
        "preview": part.is_preview,
    });
    json_part(&head, sink)?;
    part.added.vertices(&mut |batch| sink.write(bytemuck::cast_slice(batch)))?;
    part.changed.iter().try_for_each(|(number, _)| sink.write(&number.to_le_bytes()))?;
    part.changed.iter().try_for_each(|(_, vertex)| sink.write(bytemuck::bytes_of(vertex)))?;
    part.added.triangles(&mut |batch| sink.write(bytemuck::cast_slice(batch)))?;
    // The page shows it at once.
    sink.flush()
}

/// A part that ends an answer which has begun: what went wrong.
pub fn failed_part(text: &str, sink: &mut dyn Sink) -> Result<()> {
    json_part(&serde_json::json!({ "error": text }), sink)
}

/// A surface file, as `isospan surface` writes it.
pub fn export(
    archives: &Archives,
    archive: usize,
    query: &SurfaceRequest,
    resources: &Resources,
    sink: &mut dyn Sink,
) -> Result<()> {
    let step = archives.at(archive, query.choice())?;
    let mut asked = query.of(&step, resources)?;
    let ending = query.format.as_deref().unwrap_or("glb");
    let format = SurfaceFormat::from_path(format!("surface.{ending}").as_ref())?;
    // Triangles of STL have no colours.
    if let Some(choice) = query.colour().filter(|_| format != SurfaceFormat::Stl) {
        let map = query.map.as_deref().map_or(Ok(ColourMap::default()), str::parse)?;
        let mut colours = archives.at(archive, choice)?.colours(map);
        colours.range = query.range.as_deref().map(|text| numbers(text, "range")).transpose()?;
        asked = asked.colour_by(colours);
    }
    asked.write_to(&mut ToSink(sink), format).map(drop)
}

/// A sink as a writer of the standard library.
struct ToSink<'a>(&'a mut dyn Sink);

impl Write for ToSink<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.write(bytes).map(|()| bytes.len()).map_err(std::io::Error::other)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.0.flush().map_err(std::io::Error::other)
    }
}

/// The values of a slice: f64, NaN outside of the domain, `u` fastest.
pub fn slice(
    archives: &Archives,
    archive: usize,
    query: &SliceQuery,
    resources: &Resources,
    sink: &mut dyn Sink,
) -> Result<()> {
    let ([width, height], points) = query.points()?;
    let archive = archives.at(archive, query.choice())?;
    let settings = ProbeSettings { resources: resources.clone(), level: None };
    let values = archive.probe_with(&points, &settings)?;
    json_part(&serde_json::json!({ "size": [width, height] }), sink)?;
    values.iter().try_for_each(|v| sink.write(&v.to_le_bytes()))
}

/// The least box of the world that holds the domain, as JSON: two corners.
pub fn bounds(
    archives: &Archives,
    archive: usize,
    query: &StepQuery,
    resources: &Resources,
    sink: &mut dyn Sink,
) -> Result<()> {
    json(&archives.at(archive, query.choice())?.bounds(&resources.cancel)?, sink)
}

/// The contour spectrum, as JSON.
pub fn spectrum(
    archives: &Archives,
    archive: usize,
    query: &StepQuery,
    _resources: &Resources,
    sink: &mut dyn Sink,
) -> Result<()> {
    json(&archives.at(archive, query.choice())?.spectrum()?, sink)
}

/// The archives, as JSON.
pub fn archives(archives: &Archives, sink: &mut dyn Sink) -> Result<()> {
    json(&archives.describe()?, sink)
}

/// The colour maps, as JSON: name to 256 colours.
pub fn colours(sink: &mut dyn Sink) -> Result<()> {
    let table =
        |map: ColourMap| -> Vec<[u8; 3]> { (0..256).map(|n| map.colour(f64::from(n) / 255.0)).collect() };
    let all: BTreeMap<&str, _> = ColourMap::ALL.into_iter().map(|m| (m.name(), table(m))).collect();
    json(&all, sink)
}
