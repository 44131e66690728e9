//! Advice to the user, before work begins and after an unexpected end: one line each, with the flag
//! that helps.
//!
//! Nothing here changes what is made. [`look`] reads a bounded part of the samples (see
//! [`crate::pipeline::inputs::survey`]), for at most [`MOST_STEPS`] steps of a series. A source
//! that cannot be read is skipped: the work that follows refuses it.

use super::job::Job;
use super::meshes::keeps_own;
use super::report::ReduceReport;
use crate::pipeline::inputs::{Fill, Scan, Seen, Stretch, Survey, scan, survey_mesh, survey_volume, watched};
use crate::pipeline::plan::{Estimate, Finding, Notice, count_of};
use crate::pipeline::settings::{Amount, CompleteSettings, NanPolicy, Target};
use isospan_io::bytes::place;
use isospan_io::bytes::remote::is_remote;
use isospan_io::cells::CellMesh;
use isospan_io::error::{Result, bytes_text};
use isospan_io::formats::{Input, StepSource, passed_over};
use isospan_io::geom::Lattice;
use isospan_io::volume::{Assumed, VolumeInfo, VolumeSource};
use isospan_mesh::points::{PointSet, PointSpec, SetKind};
use isospan_mesh::sample::Interpolation;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The most steps of a series that are surveyed, evenly spread; all of them share the samples that
/// are read.
const MOST_STEPS: usize = 8;
/// The samples that are read in all these steps together.
const SAMPLES: u64 = 1 << 20;
/// Bytes of a point in an archive, as measured: 5 to 7, with values as they are; less what rounding
/// them saves; and of a further step.
const POINT_BYTES: f64 = 6.0;
const ROUNDED_POINT_BYTES: f64 = 3.0;
const STEP_BYTES: f64 = 2.0;
/// Bytes of a point with a value of a mesh: 6 to 10 as measured. Of an own vertex with its
/// tetrahedra, 7 to 15; and of a further step of those. Of any archive.
const MESH_POINT_BYTES: f64 = 9.0;
const OWN_BYTES: f64 = 15.0;
const OWN_STEP_BYTES: f64 = 4.0;
const LEAST_BYTES: f64 = 5000.0;
/// From this part of a mesh's vertices on, its own vertices take less than twice the bytes, and
/// have no error.
const NEARLY_ALL: f64 = 2.0 / 3.0;
/// An RMS error of a mesh from this part of the range on is worth a word, where the mesh itself
/// would have none.
const LARGE_ERROR: f64 = 0.05;
/// Smaller archives are not worth a word.
const SMALL: u64 = 256 << 10;

impl Notice {
    fn of_fill(path: &Path, fill: &Fill, seen: Seen, nan: NanPolicy) -> Self {
        let Fill { value, share, others: [lo, hi] } = *fill;
        let (v, mask) = (number(value), if nan == NanPolicy::Error { " `nan=mask`" } else { "" });
        let text = format!(
            "{} are exactly {v}, far from the others ({} .. {}): if that means \"no data\", give `missing={v}`{mask}",
            part(share, seen),
            number(lo),
            number(hi)
        );
        Self::new(path, Finding::Fill { value, share, others: fill.others }, &text)
    }

    /// What the reader of a volume says.
    fn of_reading(info: &VolumeInfo) -> impl Iterator<Item = Self> + '_ {
        info.notes.iter().map(|note| Self::new(&info.path, Finding::Reading, note))
    }

    /// That a file does not say how far its samples lie apart, if it does not.
    fn of_assumed(info: &VolumeInfo) -> Option<Self> {
        let Assumed { axes, can_be_given } = info.assumed;
        let named = ["x", "y", "z"].into_iter().zip(axes).filter(|(_, is_assumed)| *is_assumed);
        let named: Vec<&str> = named.map(|(name, _)| name).collect();
        let along = match named.len() {
            0 => return None,
            3 => String::new(),
            _ => format!(" along {}", named.join(" and ")),
        };
        let help = if can_be_given { "`spacing=X,Y,Z` gives another" } else { "write it into the file" };
        let text =
            format!("it does not say how far samples lie apart{along}: a spacing of 1 is assumed; {help}");
        Some(Self::new(&info.path, Finding::AssumedSpacing { axes }, &text))
    }

    fn of_stretch(path: &Path, found: &Stretch, nan: NanPolicy) -> Self {
        let Stretch { count, of, value, is_one_value, others } = *found;
        let [lo, hi] = others.map(number);
        let (v, mask) = (number(value), if nan == NanPolicy::Error { " `nan=mask`" } else { "" });
        let help = if is_one_value {
            format!(
                "if {v} means \"no data\", give `missing={v}`{mask}; else give errors in units of the field"
            )
        } else {
            "give errors in units of the field".into()
        };
        let verb = match (is_one_value, count) {
            (true, 1) => "is",
            (true, _) => "are",
            (false, _) => "reach",
        };
        let text = format!(
            "{} of {} samples {verb} {v}, the others {lo} .. {hi}: % and `value_bits` count from the whole range; {help}",
            grouped(count),
            grouped(of)
        );
        Self::new(path, Finding::Stretched { count, value, others }, &text)
    }

    /// That files of a folder are no part of the volume, if there are some.
    fn of_passed_over(info: &VolumeInfo) -> Option<Self> {
        const SHOWN: usize = 5;
        let mut files = passed_over(info);
        let count = files.len() as u64;
        files.truncate(SHOWN);
        let more = if count > SHOWN as u64 { ", …" } else { "" };
        let [noun, verb] = if count == 1 { ["file", "is no slice"] } else { ["files", "are no slices"] };
        let text = format!(
            "{} {noun} of the folder {verb}, and passed over: {}{more}",
            grouped(count),
            files.join(", ")
        );
        (count > 0).then(|| Self::new(&info.path, Finding::PassedOver { files, count }, &text))
    }

    /// That the own vertices of a mesh would be the better archive; `why` says so of the one that
    /// was asked for.
    fn of_own(path: &Path, points: u64, vertices: u64, own: u64, why: &str, rounded: bool) -> Self {
        let error = if rounded { "no error but that of `value_bits`" } else { "no error" };
        let text = format!(
            "{why}: `fraction=1` keeps the mesh itself, with {error}, in about {}",
            bytes_text(own, f64::round)
        );
        Self::new(path, Finding::OwnIsBetter { points, vertices, own }, &text)
    }

    /// The notice that an archive of `archive` bytes is larger than its source, if it is.
    pub(super) fn of_size(path: &Path, archive: u64, size: &SourceSize, target: bool) -> Option<Self> {
        let help = if target { "a larger error" } else { "fewer points (`fraction`)" };
        let text = format!(
            "the archive takes {}, more than its source, {}: {help} or `value_bits` makes it smaller",
            size.in_words(archive),
            size.in_words(size.bytes)
        );
        let finding = Finding::LargerThanSource { archive, source: size.bytes, estimated: false };
        (archive > size.bytes.max(SMALL)).then(|| Self::new(path, finding, &text))
    }
}

/// How large a source is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::pipeline) struct SourceSize {
    /// Its files, or its samples as they are stored, whichever is less.
    pub(in crate::pipeline) bytes: u64,
    /// Samples of all steps, or vertices.
    samples: u64,
    is_mesh: bool,
}

impl SourceSize {
    /// "1.8 MiB (45.8 bits a sample)".
    fn in_words(&self, bytes: u64) -> String {
        let bits = bytes as f64 * 8.0 / self.samples.max(1) as f64;
        let what = if self.is_mesh { "vertex" } else { "sample" };
        let digits = usize::from(bits < 99.95);
        format!("{} ({bits:.digits$} bits a {what})", bytes_text(bytes, f64::round))
    }
}

/// What is known about a job's sources before work begins.
#[derive(Debug, Default)]
pub(in crate::pipeline) struct Looked {
    pub(in crate::pipeline) notices: Vec<Notice>,
    pub(in crate::pipeline) size: Option<SourceSize>,
}

impl Looked {
    /// Adds what was found to an estimate.
    pub(in crate::pipeline) fn add_to(self, estimate: &mut Estimate) {
        estimate.source_bytes = self.size.map(|size| size.bytes);
        estimate.notices = self.notices;
    }

    /// The report of a whole archive with what was found before, and what its size shows.
    pub(super) fn complete(self, path: &Path, report: ReduceReport, job: &Job<'_>) -> ReduceReport {
        let Self { mut notices, size } = self;
        let target = job.settings.target.is_some();
        let larger = size.and_then(|size| Notice::of_size(path, report.archive_bytes, &size, target));
        let before = notices.len();
        notices.retain(|n| !matches!(n.finding, Finding::LargerThanSource { .. }));
        // A notice that was given before is not repeated; the report has the resulting bytes.
        if let Some(larger) = larger {
            if notices.len() == before {
                job.progress.notice(&larger.text);
            }
            notices.push(larger);
        }
        if let Some(better) = own_is_better(path, &report, &notices, job) {
            job.progress.notice(&better.text);
            notices.push(better);
        }
        ReduceReport { source_bytes: size.map(|s| s.bytes), notices, ..report }
    }
}

/// That a mesh was reduced with a large error, where it would have had none; unless something of
/// the kind was said before.
fn own_is_better(path: &Path, report: &ReduceReport, said: &[Notice], job: &Job<'_>) -> Option<Notice> {
    let is_said = said.iter().any(|n| matches!(n.finding, Finding::OwnIsBetter { .. }));
    let (error, vertices) = (report.error.as_ref()?, report.samples);
    let [lo, hi] = error.source_range?;
    let share = error.rms / (hi - lo);
    let could = report.mesh.is_some() && !report.own && could_keep_own(job.settings);
    if is_said || !could || report.points == 0 || share.is_nan() || share < LARGE_ERROR {
        return None;
    }
    let why = format!("the RMS error is {:.0} % of the range", 100.0 * share);
    let own = own_bytes(vertices, job.sources.len());
    let rounded = job.settings.value_bits.is_some();
    Some(Notice::of_own(path, report.inner_points, vertices, own, &why, rounded))
}

/// Bytes of an archive of a mesh's own vertices, about.
fn own_bytes(vertices: u64, steps: usize) -> u64 {
    (LEAST_BYTES + vertices as f64 * (OWN_BYTES + OWN_STEP_BYTES * steps.saturating_sub(1) as f64)) as u64
}

/// Whether all vertices of a mesh would be kept with these settings, were they asked for.
fn could_keep_own(settings: &CompleteSettings) -> bool {
    keeps_own(&CompleteSettings { amount: Amount::Fraction(1.0), ..settings.clone() }, 0)
}

/// Looks at the sources of a reduction, and reports what is found before work begins. Where steps
/// are added to an archive, points and interpolation are chosen already.
///
/// # Errors
/// [`Cancelled`](crate::Error::Cancelled) alone: a source that cannot be read is skipped here.
pub(in crate::pipeline) fn look(job: &Job<'_>) -> Result<Looked> {
    let looked = look_at(job)?;
    looked.notices.iter().for_each(|notice| job.progress.notice(&notice.text));
    Ok(looked)
}

fn look_at(job: &Job<'_>) -> Result<Looked> {
    let Job { sources, settings, run, .. } = *job;
    let further = job.basis.archive().is_some();
    let mut out = Looked::default();
    let every = sources.len().div_ceil(MOST_STEPS).max(1);
    let looked_at = sources.len().div_ceil(every) as u64;
    let (mut constants, mut seen) = (vec![], 0);
    for (n, (_, source)) in sources.iter().enumerate().step_by(every) {
        run.resources.cancel.check()?;
        let Ok(input) = source.open() else { continue };
        if matches!(&input, Input::Volume(volume) if Lattice::new(volume.info().dims).is_err()) {
            continue;
        }
        if out.size.is_none() {
            out.size = size_of(&input, source, sources);
            if let Some(size) = out.size.filter(|_| !further) {
                out.notices.extend(of_numbers(&input, source, sources.len(), settings, &size));
            }
        }
        if let Input::Volume(volume) = &input {
            let is_new = |n: &Notice| {
                // Of an archive that there is already, the spacing is known.
                let is_known = further && matches!(n.finding, Finding::AssumedSpacing { .. });
                !is_known && !out.notices.iter().any(|said| says_the_same(said, n))
            };
            let new: Vec<Notice> = header_notices(volume.info()).into_iter().filter(is_new).collect();
            out.notices.extend(new);
        }
        let found = match input {
            // Much is decoded for a few samples: in a stream, all before them.
            Input::Volume(VolumeSource::Stream(_) | VolumeSource::Chunked(_)) if n > 0 => continue,
            Input::Volume(volume) => survey_volume(volume, SAMPLES / looked_at),
            Input::Mesh(mesh) => survey_mesh(&mesh),
        };
        let Ok(survey) = found else { continue };
        seen += 1;
        for notice in of_survey(&source.path, survey, settings.missing, settings.nan) {
            match notice.finding {
                Finding::Constant { .. } => constants.push(notice),
                Finding::Labels { .. } if further || keeps_labels(settings) => {}
                _ if out.notices.iter().any(|n| is_same(&n.finding, &notice.finding)) => {}
                _ => out.notices.push(notice),
            }
        }
    }
    // A series may well begin with a constant field.
    if constants.len() == seen {
        out.notices.extend(constants.into_iter().next());
    }
    Ok(out)
}

/// Whether values are copied and never mixed, as was asked for.
fn keeps_labels(settings: &CompleteSettings) -> bool {
    settings.interpolation == Interpolation::Nearest || settings.target == Some(Target::Labels)
}

/// Whether two notices, of two steps, differ in nothing but the file.
fn says_the_same(a: &Notice, b: &Notice) -> bool {
    let after = |n: &Notice| n.text.strip_prefix(&n.path.display().to_string()).map(str::to_owned);
    a.finding == b.finding && after(a) == after(b)
}

/// Whether two findings, of two steps, are one.
fn is_same(a: &Finding, b: &Finding) -> bool {
    match (a, b) {
        (Finding::Fill { value: a, .. }, Finding::Fill { value: b, .. }) => a == b,
        _ => std::mem::discriminant(a) == std::mem::discriminant(b),
    }
}

/// What the samples of a field show.
fn of_survey(path: &Path, survey: Survey, missing: Option<f64>, nan: NanPolicy) -> Vec<Notice> {
    let seen = survey.seen;
    let found = survey.found(missing);
    let mut out: Vec<Notice> =
        found.fills.iter().map(|fill| Notice::of_fill(path, fill, seen, nan)).collect();
    if let Some(value) = found.constant {
        let others = if found.fills.is_empty() { "all samples" } else { "all other samples" };
        let looked = if seen == Seen::Spread { " that were looked at" } else { "" };
        let text = format!(
            "{others}{looked} are {}: no isovalue has a surface; is it the right field (`field`)?",
            number(value)
        );
        out.push(Notice::new(path, Finding::Constant { value }, &text));
    }
    out.extend(found.stretch.map(|stretch| Notice::of_stretch(path, &stretch, nan)));
    if let Some((values, range)) = found.labels {
        let text = format!(
            "the samples have {values} different values ({} .. {}), as labels do: `labels=true` keeps them, in the fewest bytes; so do `lossless=true`, and `interpolation=nearest` at points",
            number(range[0]),
            number(range[1])
        );
        out.push(Notice::new(path, Finding::Labels { values, range }, &text));
    }
    out
}

/// What the numbers of points and samples show: more points than samples, an archive larger than
/// its source.
fn of_numbers(
    input: &Input,
    source: &StepSource,
    steps: usize,
    settings: &CompleteSettings,
    size: &SourceSize,
) -> Vec<Notice> {
    // With a target, neither is known before it is met.
    if settings.target.is_some() {
        return vec![];
    }
    let (mut out, path) = (vec![], &source.path);
    let own = matches!(input, Input::Mesh(mesh) if keeps_own(settings, mesh.info().points));
    let (samples, asked, points) = match input {
        Input::Volume(volume) => {
            let dims = volume.info().dims;
            let asked = count_of(settings, dims);
            (dims.iter().product(), asked, points_of(dims, asked, settings))
        }
        Input::Mesh(mesh) => {
            let n = mesh.info().points;
            let asked = match settings.amount {
                Amount::Count(n) => n,
                part => part.of(n as f64).round() as u64,
            };
            (n, asked, asked)
        }
    };
    if asked > samples {
        let text = more_points(input, settings, asked, samples, own);
        out.push(Notice::new(path, Finding::MorePoints { points: asked, samples }, &text));
    }
    if settings.points == SetKind::Pyramid {
        // Its bytes follow from the samples, and are fewer than those.
        return out;
    }
    let bits = settings.value_bits;
    let point = match bits {
        Some(bits) => ROUNDED_POINT_BYTES + bits / 8.0,
        None => POINT_BYTES,
    };
    let each = point.min(POINT_BYTES) + STEP_BYTES * (steps - 1) as f64;
    let archive = if own { own_bytes(samples, steps) } else { (points as f64 * each) as u64 };
    if let Input::Mesh(_) = input
        && could_keep_own(settings)
    {
        out.extend(better_kept(path, asked, samples, own_bytes(samples, steps), bits.is_some()));
    }
    if archive > size.bytes.max(SMALL) {
        let flags = smaller(archive, size.bytes, settings, bits.is_some());
        let text = format!(
            "the archive takes about {}, more than its source, {}: {flags} makes it smaller",
            size.in_words(archive),
            size.in_words(size.bytes)
        );
        let finding = Finding::LargerThanSource { archive, source: size.bytes, estimated: true };
        out.push(Notice::new(path, finding, &text));
    }
    out
}

/// Says that the mesh itself takes hardly more bytes, `of_own`, than the points that are asked for.
fn better_kept(path: &Path, asked: u64, vertices: u64, of_own: u64, rounded: bool) -> Option<Notice> {
    let is_much = asked as f64 >= NEARLY_ALL * vertices as f64 || of_own <= SMALL;
    (asked < vertices && is_much).then(|| {
        let bytes = (LEAST_BYTES + asked as f64 * MESH_POINT_BYTES) as u64;
        let why = format!(
            "{} points of its {} vertices take about {}, and have an error",
            grouped(asked),
            grouped(vertices),
            bytes_text(bytes, f64::round)
        );
        Notice::of_own(path, asked, vertices, of_own, &why, rounded)
    })
}

/// Says that more points are asked for than there are samples; `own`: the mesh is kept as it is.
fn more_points(input: &Input, settings: &CompleteSettings, asked: u64, samples: u64, own: bool) -> String {
    let setting = match settings.amount {
        Amount::Count(n) => format!("`count={n}`"),
        Amount::Fraction(f) => format!("`fraction={f}`"),
        Amount::Usual => String::from("the default"),
    };
    let [what, help] = match input {
        Input::Volume(_) => ["samples", "`points=regular` `fraction=1` has a point at each sample"],
        Input::Mesh(_) if own => ["vertices", "the mesh itself is kept, as by `fraction=1`"],
        Input::Mesh(_) if could_keep_own(settings) => {
            ["vertices", "`fraction=1` keeps the mesh itself, with no error"]
        }
        Input::Mesh(_) => ["vertices", "`fraction=1` asks for as many as there are"],
    };
    let [asked, samples] = [asked, samples].map(grouped);
    format!("{setting} asks for {asked} points, more than its {samples} {what}: {help}")
}

/// Flags with which an archive is smaller than its source, as far as the number of points can
/// achieve that.
fn smaller(archive: u64, source: u64, settings: &CompleteSettings, rounded: bool) -> String {
    let bits = if rounded { "" } else { " or `value_bits`" };
    let times = archive as f64 / source.max(1) as f64;
    match settings.amount {
        Amount::Usual | Amount::Fraction(_) => {
            let least = times / settings.amount.of(1.0);
            let of = (0..10).map(|k| 1u32 << k).find(|&n| f64::from(n) >= least);
            match of {
                Some(n) if n > 1 => format!("`fraction=1/{n}`{bits}"),
                _ => format!("a smaller `fraction`{bits}"),
            }
        }
        Amount::Count(_) => format!("a smaller `count`{bits}"),
    }
}

/// Points of a set, boundary included; what was asked for where the settings are none.
fn points_of(dims: [u64; 3], asked: u64, settings: &CompleteSettings) -> u64 {
    let points = Lattice::new(dims).and_then(|lattice| {
        PointSet::new(PointSpec::with_count(settings.points, &lattice, asked, &settings.set)?, lattice)
    });
    points.map_or(asked, |points| points.len())
}

/// The lengths of files of which servers told when they were read.
fn told_of(source: &StepSource) -> Option<BTreeMap<PathBuf, u64>> {
    let files = source.read_from_servers().ok()?.into_iter();
    Some(files.filter_map(|(file, stamp)| Some((file, stamp?.len))).collect())
}

/// The size of all steps; `input` is the one that was opened, of `source`. `None` where the system,
/// or a server, does not say.
fn size_of(input: &Input, source: &StepSource, sources: &[(u64, StepSource)]) -> Option<SourceSize> {
    let steps = sources.len() as u64;
    let mut paths: Vec<PathBuf> = sources.iter().map(|(_, s)| s.path.clone()).collect();
    paths.sort_unstable();
    paths.dedup();
    let files = match input {
        Input::Volume(volume) => volume.info().files(),
        Input::Mesh(mesh) => mesh.info().files(),
    };
    // Chunks that are not there take no bytes.
    let told = told_of(source)?;
    let length = |files: &[PathBuf]| {
        let asked: Vec<PathBuf> = files.iter().filter(|file| !told.contains_key(*file)).cloned().collect();
        let lengths = place::lengths(&asked).ok()?;
        let on_servers = asked.iter().any(|file| is_remote(file));
        let rest = lengths.into_iter().map(|len| len.or(on_servers.then_some(0))).sum::<Option<u64>>()?;
        Some(rest + files.iter().filter_map(|file| told.get(file)).sum::<u64>())
    };
    let on_disk = if sources.iter().any(|(_, source)| source.is_given()) {
        u64::MAX
    } else if files.len() == 1 {
        length(&paths)?
    } else {
        length(&files)?.saturating_mul(paths.len() as u64)
    };
    let (samples, stored) = match input {
        Input::Volume(volume) => {
            let info = volume.info();
            let samples = info.dims.iter().product::<u64>().saturating_mul(steps);
            (samples, samples.saturating_mul(info.field.scalar.bytes() as u64))
        }
        Input::Mesh(mesh) => (mesh.info().points.saturating_mul(steps), u64::MAX),
    };
    Some(SourceSize { bytes: on_disk.min(stored), samples, is_mesh: matches!(input, Input::Mesh(_)) })
}

/// Reads a volume once, as [`scan`] does, and returns what a reduction of it should heed.
///
/// # Errors
/// Those of reading it.
pub fn scan_with_notices(source: VolumeSource) -> Result<(VolumeInfo, Scan, Vec<Notice>)> {
    let (source, watched) = watched(source)?;
    let (info, found) = scan(source)?;
    let mut notices = header_notices(&info);
    notices.extend(of_survey(&info.path, watched.survey(), None, NanPolicy::Error));
    Ok((info, found, notices))
}

/// What the header of a volume shows, without its samples.
pub fn header_notices(info: &VolumeInfo) -> Vec<Notice> {
    let files = Notice::of_passed_over(info).into_iter();
    files.chain(Notice::of_assumed(info)).chain(Notice::of_reading(info)).collect()
}

/// What a reduction of a mesh's field should heed.
///
/// # Errors
/// [`BadInput`](crate::Error::BadInput) when the field cannot be read, or none is chosen.
pub fn mesh_notices(mesh: &CellMesh) -> Result<Vec<Notice>> {
    Ok(of_survey(&mesh.info().path, survey_mesh(mesh)?, None, NanPolicy::Error))
}

/// "51 % of the samples".
fn part(share: f64, seen: Seen) -> String {
    let percent = 100.0 * share;
    let digits = if percent < 1.0 { 2 } else { usize::from(percent < 10.0) };
    match seen {
        Seen::All => format!("{percent:.digits$} % of the samples"),
        Seen::Spread => format!("about {percent:.digits$} % of the samples"),
        Seen::First(n) => format!("{percent:.digits$} % of the first {} samples", grouped(n)),
    }
}

/// A value for a person.
fn number(v: f64) -> String {
    if v != 0.0 && !(1e-4..1e9).contains(&v.abs()) { format!("{v:e}") } else { v.to_string() }
}

/// 1234567 as "1 234 567".
fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(c);
    }
    out
}
