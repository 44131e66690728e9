//! Answers the questions of the page by blocking work, as bytes that are streamed.

use super::archives::Archives;
use axum::body::Bytes;
use isospan::exec::Silent;
use isospan::formats::surface::SurfaceFormat;
use isospan::pipeline::{ProbeSettings, Roi, StepChoice, SurfaceSettings};
use isospan::{Error, Resources, Result};
use serde::{Deserialize, Serialize};
use std::io::Read as _;
use std::time::Instant;
use tokio::sync::mpsc::Sender;

/// Bytes of a piece of an answer.
const PIECE: usize = 256 << 10;
/// Isovalues of one request.
const MOST_ISOVALUES: usize = 16;
/// Samples along a side of a slice.
const MOST_SAMPLES: u32 = 1024;

/// The step that a request is about.
#[derive(Debug, Default, Deserialize)]
pub(super) struct StepQuery {
    step: Option<u64>,
}

impl StepQuery {
    pub(super) fn choice(&self) -> StepChoice {
        self.step.map_or(StepChoice::First, StepChoice::Number)
    }
}

/// Surfaces of a step. Numbers are those of the command line.
#[derive(Debug, Deserialize)]
pub(super) struct SurfaceQuery {
    /// `1,2.5`.
    isovalues: String,
    step: Option<u64>,
    /// As `--roi` has it.
    roi: Option<String>,
    #[serde(default)]
    cap: bool,
    /// Of an export: the ending of the file's name.
    format: Option<String>,
}

impl SurfaceQuery {
    pub(super) fn choice(&self) -> StepChoice {
        StepQuery { step: self.step }.choice()
    }

    fn settings(&self, resources: &Resources) -> Result<SurfaceSettings> {
        let wrong = |text: &str| Error::usage(format!("'{text}' is no isovalue"));
        let number = |text: &str| text.trim().parse::<f64>().map_err(|_| wrong(text));
        let isovalues = self.isovalues.split(',').map(number).collect::<Result<Vec<_>>>()?;
        if isovalues.len() > MOST_ISOVALUES {
            return Err(Error::usage(format!("a request has at most {MOST_ISOVALUES} isovalues")));
        }
        let roi = self.roi.as_deref().map(str::parse::<Roi>).transpose().map_err(Error::usage)?;
        Ok(SurfaceSettings {
            isovalues,
            roi,
            cap: self.cap,
            resources: resources.clone(),
            ..SurfaceSettings::default()
        })
    }
}

/// The field on a plane: the samples `origin + i u + j v`, in the world.
#[derive(Debug, Deserialize)]
pub(super) struct SliceQuery {
    step: Option<u64>,
    origin: String,
    u: String,
    v: String,
    /// Samples along `u` and `v`.
    size: String,
}

impl SliceQuery {
    pub(super) fn choice(&self) -> StepChoice {
        StepQuery { step: self.step }.choice()
    }

    fn points(&self) -> Result<([u32; 2], Vec<[f64; 3]>)> {
        fn numbers<T: std::str::FromStr, const N: usize>(text: &str, what: &str) -> Result<[T; N]> {
            let all: Option<Vec<T>> = text.split(',').map(|x| x.trim().parse().ok()).collect();
            let wrong = || Error::usage(format!("{what} '{text}': expected {N} numbers with commas"));
            all.and_then(|all| all.try_into().ok()).ok_or_else(wrong)
        }
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

/// Takes the bytes of an answer, and hands them on in pieces. Waits for a slow reader, holding
/// little.
pub(super) struct Sink {
    to: Sender<Result<Bytes>>,
    piece: Vec<u8>,
}

impl Sink {
    pub(super) fn new(to: Sender<Result<Bytes>>) -> Self {
        Self { to, piece: Vec::with_capacity(PIECE) }
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        bytes.chunks(PIECE).try_for_each(|part| {
            self.piece.extend_from_slice(part);
            if self.piece.len() >= PIECE { self.flush() } else { Ok(()) }
        })
    }

    /// # Errors
    /// [`Error::Cancelled`] when the reader is gone.
    fn flush(&mut self) -> Result<()> {
        let piece = std::mem::replace(&mut self.piece, Vec::with_capacity(PIECE));
        self.to.blocking_send(Ok(piece.into())).map_err(|_| Error::Cancelled)
    }

    /// A part of known length: its bytes in four, then the text.
    fn json(&mut self, value: &impl Serialize) -> Result<()> {
        let text = serde_json::to_vec(value)
            .map_err(|e| Error::io("write", "an answer", std::io::Error::other(e)))?;
        // Numbers that follow are at multiples of four.
        let spaces = text.len().next_multiple_of(4) - text.len();
        self.write(&((text.len() + spaces) as u32).to_le_bytes())?;
        self.write(&text)?;
        self.write(&b"   "[..spaces])
    }

    /// Ends the answer with an error, or with what is left of its bytes.
    pub(super) fn end(mut self, result: Result<()>) {
        let result = result.and_then(|()| if self.piece.is_empty() { Ok(()) } else { self.flush() });
        if let Err(e) = result {
            // A reader that is gone needs no error.
            let _ = self.to.blocking_send(Err(e));
        }
    }
}

/// A length and JSON with the counts; then of each surface its vertices (position and normal, 3 ×
/// f32 each) and its triangles (3 × u32).
pub(super) fn surface(
    archives: &Archives,
    archive: usize,
    query: &SurfaceQuery,
    resources: &Resources,
    sink: &mut Sink,
) -> Result<()> {
    let start = Instant::now();
    let settings = query.settings(resources)?;
    let archive = archives.at(archive, query.choice())?;
    let sink = std::cell::RefCell::new(sink);
    archive.stream_surfaces(
        &settings,
        |report| {
            let answer = serde_json::json!({
                "milliseconds": start.elapsed().as_secs_f64() * 1e3,
                "report": report,
            });
            sink.borrow_mut().json(&answer)?;
            // The page says what it waits for.
            sink.borrow_mut().flush()
        },
        |surface| {
            let mut sink = sink.borrow_mut();
            surface.vertices(&mut |batch| sink.write(bytemuck::cast_slice(batch)))?;
            surface.triangles(&mut |batch| sink.write(bytemuck::cast_slice(batch)))
        },
    )
}

/// The values of a slice: f32, NaN outside of the domain, `u` fastest.
pub(super) fn slice(
    archives: &Archives,
    archive: usize,
    query: &SliceQuery,
    resources: &Resources,
    sink: &mut Sink,
) -> Result<()> {
    let ([width, height], points) = query.points()?;
    let archive = archives.at(archive, query.choice())?;
    let settings = ProbeSettings { resources: resources.clone() };
    let values = archive.probe_with(&points, &settings)?;
    sink.json(&serde_json::json!({ "size": [width, height] }))?;
    values.iter().try_for_each(|&v| sink.write(&(v as f32).to_le_bytes()))
}

/// A surface file, as `isospan surface` writes it.
pub(super) fn export(
    archives: &Archives,
    archive: usize,
    query: &SurfaceQuery,
    resources: &Resources,
    sink: &mut Sink,
) -> Result<()> {
    let settings = query.settings(resources)?;
    let ending = query.format.as_deref().unwrap_or("glb");
    let format = SurfaceFormat::from_path(format!("surface.{ending}").as_ref())?;
    let archive = archives.at(archive, query.choice())?;
    let scratch = resources.scratch.clone().unwrap_or_else(std::env::temp_dir);
    let failed = |doing: &str, e| Error::io(doing, &scratch, e);
    let folder = tempfile::tempdir_in(&scratch).map_err(|e| failed("write to", e))?;
    let path = folder.path().join("surface");
    archive.write_surface(&settings, &path, format, &Silent)?;
    let mut file = std::fs::File::open(&path).map_err(|e| failed("read from", e))?;
    let mut piece = vec![0; PIECE];
    loop {
        let bytes = file.read(&mut piece).map_err(|e| failed("read from", e))?;
        if bytes == 0 {
            return Ok(());
        }
        sink.write(&piece[..bytes])?;
    }
}

/// The contour spectrum, as JSON.
pub(super) fn spectrum(
    archives: &Archives,
    archive: usize,
    query: &StepQuery,
    _resources: &Resources,
    sink: &mut Sink,
) -> Result<()> {
    json(&archives.at(archive, query.choice())?.spectrum()?, sink)
}

/// A value as JSON.
pub(super) fn json(value: &impl Serialize, sink: &mut Sink) -> Result<()> {
    let text =
        serde_json::to_vec(value).map_err(|e| Error::io("write", "an answer", std::io::Error::other(e)))?;
    sink.write(&text)
}
