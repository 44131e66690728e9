//! A series of steps: finds the file of each step, and the field in it.
//!
//! | what is named | steps |
//! |---|---|
//! | several files | one each, in the order given |
//! | a pattern, `"step_*.vti"`, `"run_?/out.vtu"` | the files that match, by the numbers in their names |
//! | `.pvd` (ParaView) | its data sets, with their times |
//! | `.series` (ParaView, JSON) | its files, with their times |
//! | a 4-D NIfTI, MetaImage or NRRD file; a four-dimensional dataset of an HDF5 or NetCDF file; a variable of an Exodus II or EnSight file; a Zarr array with a time axis; moments of a TIFF file (where there are several: named by `field`) | its frames, with their times |
//! | any file, and a pattern for its fields, `V_*` | the fields that match, by the numbers in their names |
//!
//! A pattern that matches TIFF files is one volume, whose slices they are. The time of a VTK file
//! is in its field data: `TimeValue`, or `TIME`.

use crate::bytes::read_whole;
use crate::bytes::remote::is_remote;
use crate::bytes::stamp::Stamp;
use crate::error::{Error, Place, Result};
use crate::exec::CancelToken;
use crate::formats::opened::{Input, Opened, OpenedFiles};
use crate::formats::shared::coordinates::{GridCoordinates, tables};
use crate::formats::shared::header::sibling;
use crate::formats::shared::packed::UnpackedFrames;
use crate::formats::shared::{Frames, OpenOptions, field_matches, has_suffix, is_pattern};
use crate::formats::volume::stack::{by_numbers, rise};
use crate::formats::volume::tiff;
use crate::volume::chunked::{ChunkSource, DecodeCount};
use crate::volume::dates::conversion;
use crate::volume::units::{Unit, Units};
use crate::volume::{SharedVolume, VolumeInfo, VolumeReader, VolumeSource};
use quick_xml::Reader;
use quick_xml::events::Event;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use xxhash_rust::xxh3::Xxh3;

/// One step of a series.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StepSource {
    /// Its file, folder or pattern.
    pub path: PathBuf,
    /// How that is read; the field, where several steps are in one file.
    pub options: OpenOptions,
    /// Its time, where it is known.
    pub time: Option<f64>,
    /// The time that the file states, which has the file's unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    stated: Option<f64>,
    /// Which of the several fields of a step it is, where each step has some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    part: Option<FieldOfStep>,
    /// The volume itself, where a program gives that and no file.
    #[serde(skip)]
    given: Option<Given>,
    /// How often the chunks of a source were decoded.
    #[serde(skip)]
    decodes: DecodeCount,
    /// The files that were opened last, of all steps of a series.
    #[serde(skip)]
    files: Arc<OpenedFiles>,
}

impl PartialEq for StepSource {
    fn eq(&self, other: &Self) -> bool {
        let is_same = self.path == other.path && self.options == other.options && self.part == other.part;
        is_same && self.time == other.time && self.given == other.given
    }
}

impl StepSource {
    /// A step that is alone.
    pub fn new(path: &Path, options: &OpenOptions) -> Self {
        let (path, options) = (path.to_path_buf(), options.clone());
        let (part, given, decodes) = (None, None, DecodeCount::default());
        Self { path, options, time: None, stated: None, part, given, decodes, files: Arc::default() }
    }

    /// The same file, opened with other options.
    #[must_use]
    pub fn with_options(&self, options: &OpenOptions) -> Self {
        let (part, files) = (self.part.clone(), Arc::clone(&self.files));
        Self { part, files, ..Self::new(&self.path, options) }
    }

    /// Steps that hold their open files together: what one has opened, another does not open again.
    pub fn holding_together(mut steps: Vec<Self>) -> Vec<Self> {
        if let Some(files) = steps.first().map(|step| Arc::clone(&step.files)) {
            steps.iter_mut().for_each(|step| step.files = Arc::clone(&files));
        }
        steps
    }

    /// The same as one of several fields of a step; `moment` counts the steps that have these
    /// fields, if there may be more than one.
    #[must_use]
    pub fn as_field(self, name: &str, moment: Option<u64>) -> Self {
        Self { part: Some(FieldOfStep { name: name.to_owned(), moment }), ..self }
    }

    /// Which of the several fields of a step it is, where each step has some.
    pub fn part(&self) -> Option<&FieldOfStep> {
        self.part.as_ref()
    }

    /// A volume that a program gives: samples in memory
    /// ([`volume_of`](crate::volume::memory::volume_of)), or anything that answers for boxes of
    /// them. `name` stands for it in messages and in the archive.
    pub fn given(name: &str, volume: Arc<dyn VolumeReader>) -> Self {
        let given = Given { volume: GivenVolume::Reader(volume), hash: Arc::default(), axes: None };
        Self { given: Some(given), ..Self::new(name.as_ref(), &OpenOptions::default()) }
    }

    /// A volume that a program gives, whose samples are those of a rectilinear grid: `axes` are
    /// their coordinates along x, y, z, in place of a spacing.
    ///
    /// # Errors
    /// [`Error::BadInput`] where they neither rise nor fall throughout; [`Error::Usage`] where an
    /// axis has not as many of them as samples.
    pub fn given_on_axes(name: &str, volume: Arc<dyn VolumeReader>, axes: [Vec<f64>; 3]) -> Result<Self> {
        let dims = volume.info().dims;
        for (axis, n) in axes.iter().zip(dims) {
            if axis.len() as u64 != n {
                let got = axis.len();
                return Err(Error::usage(format!(
                    "{name}: {n} coordinates expected along an axis, got {got}"
                )));
            }
        }
        let axes = Some(Arc::new(tables(Path::new(name), name, axes.map(Some), dims)?));
        let given = Given { volume: GivenVolume::Reader(volume), hash: Arc::default(), axes };
        Ok(Self { given: Some(given), ..Self::new(name.as_ref(), &OpenOptions::default()) })
    }

    /// A volume in chunks that a program gives, which `identity` stands for: the same text only
    /// where all samples are the same.
    pub fn given_in_chunks(
        name: &str,
        chunks: Arc<dyn ChunkSource>,
        identity: &str,
        time: Option<f64>,
    ) -> Self {
        let mut hash = Xxh3::new();
        hash.update(identity.as_bytes());
        let hash = Arc::new(OnceLock::from(format!("{:032x}", hash.digest128())));
        let given = Given { volume: GivenVolume::Chunks(chunks), hash, axes: None };
        let step = Self { given: Some(given), ..Self::new(name.as_ref(), &OpenOptions::default()) };
        step.at_stated(time, None)
    }

    /// The same step at a time, where that is known.
    #[must_use]
    pub fn at(self, time: Option<f64>) -> Self {
        Self { time, ..self }
    }

    /// The same step at the time that its file states, else at another one.
    fn at_stated(self, stated: Option<f64>, time: Option<f64>) -> Self {
        Self { stated, time: stated.or(time), ..self }
    }

    /// The same moment in another field of the file.
    pub fn in_field(&self, options: &OpenOptions) -> Self {
        let step = Self { stated: self.stated, time: self.time, ..self.with_options(options) };
        match self.time {
            Some(_) => step,
            // Several fields of a file need not have one time.
            None => {
                let time = step.file().and_then(|file| file.time(options)).ok().flatten();
                step.at_stated(time, None)
            }
        }
    }

    /// The units of the step: those that the user names, else those of its file. A time that the
    /// file does not state has no unit of the file.
    pub fn units(&self, of_file: &Units) -> Units {
        let time = of_file.time.clone().filter(|_| self.time == self.stated);
        let mut units = self.options.units.clone().or(Units { time, ..of_file.clone() });
        units.time = units.time.filter(|_| self.time.is_some());
        units
    }

    /// Opens the file, or the volume that was given.
    ///
    /// # Errors
    /// Those of [`open_input`](super::open_input).
    pub fn open(&self) -> Result<Input> {
        match &self.given {
            Some(given) => Ok(Input::Volume(given.source(&self.decodes))),
            None => Ok(match self.file()?.input(&self.options)? {
                Input::Volume(VolumeSource::Chunked(chunks)) => {
                    Input::Volume(VolumeSource::Chunked(self.decodes.counting(chunks)))
                }
                other => other,
            }),
        }
    }

    /// The file, which is opened if it is not open.
    fn file(&self) -> Result<Arc<Opened>> {
        self.files.open(&self.path, &self.options)
    }

    /// Whether it is a mesh, not a volume. No field of it need be chosen.
    ///
    /// # Errors
    /// Those of [`open`](super::open).
    pub fn is_mesh(&self) -> Result<bool> {
        if self.given.is_some() { Ok(false) } else { Ok(self.file()?.is_mesh()) }
    }

    /// The coordinates of its samples; `None` where the volume has a spacing.
    ///
    /// # Errors
    /// As [`StepSource::open`].
    pub fn coordinates(&self) -> Result<Option<GridCoordinates>> {
        match &self.given {
            Some(given) => Ok(given.axes.as_deref().cloned().map(GridCoordinates::Axes)),
            None => self.file()?.coordinates(&self.options),
        }
    }

    /// Bytes of all frames of its file, unpacked, where each frame would be decoded from the
    /// beginning of the file; `None` of others.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a malformed file.
    pub fn packed_bytes(&self) -> Result<Option<u64>> {
        if self.given.is_some() { Ok(None) } else { self.file()?.packed_bytes(&self.options) }
    }

    /// Unpacks such a file, into a nameless file in `folder`.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a malformed file; when the folder cannot be written.
    pub fn unpack(&self, folder: &Path, cancel: &CancelToken) -> Result<UnpackedFrames> {
        self.file()?.unpack(&self.options, folder, cancel)
    }

    /// Files on servers that were read to open it, and what was said of them then.
    ///
    /// # Errors
    /// Those of [`open`](super::open).
    pub fn read_from_servers(&self) -> Result<Vec<(PathBuf, Option<Stamp>)>> {
        if self.given.is_some() || !is_remote(&self.path) {
            return Ok(vec![]);
        }
        Ok(self.file()?.remote_files().map(|(file, stamp)| (file.to_path_buf(), stamp)).collect())
    }

    /// How its time is counted, where its file states that.
    fn counted(&self) -> Option<Counted> {
        if self.stated.is_none() || self.time != self.stated || self.options.units.time.is_some() {
            return None;
        }
        let file = self.file().ok()?;
        let unit = file.volume(&self.options).ok()?.info().units.time.clone()?;
        let calendar = file.calendar(&self.options).ok()?;
        Some(Counted { unit, calendar })
    }

    /// How often chunks of this source were decoded, by all its readers here.
    pub fn decodes(&self) -> &DecodeCount {
        &self.decodes
    }

    /// Whether it is a volume that a program gives.
    pub fn is_given(&self) -> bool {
        self.given.is_some()
    }

    /// A hash of the samples of a volume that a program gives; `None` of files.
    ///
    /// # Errors
    /// Those of reading the samples; [`Error::Cancelled`].
    pub fn given_hash(&self, cancel: &CancelToken) -> Result<Option<String>> {
        self.given.as_ref().map(|given| given.hash(cancel)).transpose()
    }
}

/// One of several fields of a step.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FieldOfStep {
    /// The name of the field.
    pub name: String,
    /// Which of the steps that have these fields it is; none where there is but one.
    pub moment: Option<u64>,
}

impl From<&Path> for StepSource {
    fn from(path: &Path) -> Self {
        Self::new(path, &OpenOptions::default())
    }
}

impl From<PathBuf> for StepSource {
    fn from(path: PathBuf) -> Self {
        path.as_path().into()
    }
}

impl From<&str> for StepSource {
    fn from(path: &str) -> Self {
        Path::new(path).into()
    }
}

/// A volume of the program, by the name that it has.
impl<V: VolumeReader + 'static> From<V> for StepSource {
    fn from(volume: V) -> Self {
        let name = volume.info().path.display().to_string();
        Self::given(&name, Arc::new(volume))
    }
}

/// A volume that a program gives, and the hash of its samples once that is known.
#[derive(Clone)]
struct Given {
    volume: GivenVolume,
    hash: Arc<OnceLock<String>>,
    /// The coordinates of a rectilinear grid along x, y, z.
    axes: Option<Arc<[Vec<f64>; 3]>>,
}

#[derive(Clone)]
enum GivenVolume {
    Reader(Arc<dyn VolumeReader>),
    /// The hash of these is known.
    Chunks(Arc<dyn ChunkSource>),
}

impl Given {
    fn source(&self, decodes: &DecodeCount) -> VolumeSource {
        match &self.volume {
            GivenVolume::Reader(volume) => VolumeSource::Random(Box::new(SharedVolume(Arc::clone(volume)))),
            GivenVolume::Chunks(chunks) => VolumeSource::Chunked(decodes.counting(Arc::clone(chunks))),
        }
    }

    fn info(&self) -> &VolumeInfo {
        match &self.volume {
            GivenVolume::Reader(volume) => volume.info(),
            GivenVolume::Chunks(chunks) => chunks.info(),
        }
    }

    /// XXH3 (128 bits), in hexadecimal, of the identity of the volume where it has one; else of its
    /// dimensions, type and stored samples. Coordinates of a grid follow.
    fn hash(&self, cancel: &CancelToken) -> Result<String> {
        if let Some(known) = self.hash.get() {
            return Ok(known.clone());
        }
        let mut hash = Xxh3::new();
        let identity = match &self.volume {
            GivenVolume::Reader(volume) => volume.identity(),
            GivenVolume::Chunks(_) => None,
        };
        match identity {
            Some(identity) => hash.update(identity.as_bytes()),
            None => {
                let mut slabs = self.source(&DecodeCount::default()).into_stream();
                let info = slabs.info();
                info.dims.iter().for_each(|n| hash.update(&n.to_le_bytes()));
                hash.update(info.field.scalar.name().as_bytes());
                let mut slab = vec![];
                while slabs.next_slab(&mut slab)?.is_some() {
                    cancel.check()?;
                    hash.update(&slab);
                }
            }
        }
        // The same samples at other places are another volume.
        for number in self.axes.iter().flat_map(|axes| axes.iter().flatten()) {
            hash.update(&number.to_le_bytes());
        }
        Ok(self.hash.get_or_init(|| format!("{:032x}", hash.digest128())).clone())
    }
}

impl PartialEq for Given {
    fn eq(&self, other: &Self) -> bool {
        let is_same = match (&self.volume, &other.volume) {
            (GivenVolume::Reader(a), GivenVolume::Reader(b)) => Arc::ptr_eq(a, b),
            (GivenVolume::Chunks(a), GivenVolume::Chunks(b)) => Arc::ptr_eq(a, b),
            _ => false,
        };
        is_same && self.axes == other.axes
    }
}

impl fmt::Debug for Given {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.info())
    }
}

/// The most bytes of a list of files.
const LARGEST_LIST: u64 = 64 << 20;

/// The steps that some inputs stand for, in order. The contents of the files are read only as far
/// as it takes to distinguish steps.
///
/// # Errors
/// [`Error::BadInput`] for a list of files that is malformed, or a pattern without files;
/// [`Error::Usage`] for a malformed pattern.
pub fn steps_of(inputs: &[PathBuf], options: &OpenOptions) -> Result<Vec<StepSource>> {
    let (mut steps, files) = (vec![], Arc::default());
    for input in inputs {
        for (path, time) in files_of(input)? {
            steps.extend(steps_in(&path, options, time, &files));
        }
    }
    Ok(counted_alike(steps))
}

/// Steps whose times all count from the date of the first one.
fn counted_alike(steps: Vec<StepSource>) -> Vec<StepSource> {
    let is_one = |steps: &[StepSource]| steps.windows(2).all(|pair| pair[0].path == pair[1].path);
    let Some(first) = steps.first().filter(|_| !is_one(&steps)).and_then(StepSource::counted) else {
        return steps;
    };
    counted_from(steps, &first.unit)
}

/// The same steps with times in a unit, where their files count from another date.
pub fn counted_from(steps: Vec<StepSource>, unit: &Unit) -> Vec<StepSource> {
    let mut last: Option<(PathBuf, Option<Counted>)> = None;
    let in_unit = |step: StepSource| {
        let known = last.take().filter(|(path, _)| *path == step.path);
        let (path, counted) = known.unwrap_or_else(|| (step.path.clone(), step.counted()));
        let found = counted.as_ref().filter(|counted| counted.unit != *unit);
        let by = found.and_then(|own| conversion(own.unit.as_str(), unit.as_str(), &own.calendar));
        last = Some((path, counted));
        match (by, step.time) {
            // The file's unit is not that of such a time.
            (Some([factor, summand]), Some(time)) if step.stated.is_some() => {
                StepSource { time: Some(factor * time + summand), stated: None, ..step }
            }
            _ => step,
        }
    };
    steps.into_iter().map(in_unit).collect()
}

/// How the times of a file are counted.
struct Counted {
    unit: Unit,
    calendar: String,
}

/// The steps that some inputs stand for, of each of several fields: all steps of the first field,
/// then those of the next. A field may be in all of the files, or in files of its own.
///
/// # Errors
/// Those of [`steps_of`]; [`Error::Usage`] for a file without any of the fields, and where fields
/// have not the same steps.
pub fn steps_of_fields(
    inputs: &[PathBuf],
    fields: &[String],
    options: &OpenOptions,
) -> Result<Vec<StepSource>> {
    if let Some(twice) = (1..fields.len()).find(|&n| fields[..n].contains(&fields[n])) {
        return Err(Error::usage(format!("`fields` names {} twice", fields[twice])));
    }
    let mut all: Vec<Vec<StepSource>> = vec![vec![]; fields.len()];
    let mut missing: Vec<Option<Error>> = fields.iter().map(|_| None).collect();
    let files = Arc::default();
    for input in inputs {
        for (path, time) in files_of(input)? {
            let mut is_used = false;
            for ((name, steps), missing) in fields.iter().zip(&mut all).zip(&mut missing) {
                let options = OpenOptions { field: Some(name.clone()), ..options.clone() };
                let found = steps_in(&path, &options, time, &files);
                match found.first().map_or(Ok(()), |step| expect_field(step, name)) {
                    Ok(()) => steps.extend(found),
                    Err(e) => {
                        missing.get_or_insert(e);
                        continue;
                    }
                }
                is_used = true;
            }
            if !is_used && let Some(error) = missing.iter_mut().find_map(Option::take) {
                return Err(error);
            }
        }
    }
    for (steps, missing) in all.iter().zip(missing) {
        if let (true, Some(error)) = (steps.is_empty(), missing) {
            return Err(error);
        }
    }
    together(all, fields)
}

/// The steps of fields, which are at the same times.
fn together(mut all: Vec<Vec<StepSource>>, fields: &[String]) -> Result<Vec<StepSource>> {
    let count = all[0].len();
    if let Some(n) = all.iter().position(|steps| steps.len() != count) {
        return Err(Error::usage(format!(
            "`fields`: {} has {count} steps, {} has {}: each step has all fields",
            fields[0],
            fields[n],
            all[n].len()
        )));
    }
    for moment in 0..count {
        let Some(first) = all.iter().position(|steps| steps[moment].time.is_some()) else { continue };
        let (time, stated) = (all[first][moment].time, all[first][moment].stated);
        for (n, steps) in all.iter_mut().enumerate() {
            let step = &mut steps[moment];
            if step.time.is_none() {
                (step.time, step.stated) = (time, stated);
            }
            if let (Some(own), Some(time)) = (step.time, time)
                && own != time
            {
                return Err(Error::usage(format!(
                    "{}: step {moment} of {} is at time {own}, of {} at {time}: each step has one time",
                    step.path.display(),
                    fields[n],
                    fields[first]
                )));
            }
        }
    }
    let as_field = |(name, steps): (&String, Vec<StepSource>)| {
        let part = |(moment, step): (u64, StepSource)| step.as_field(name, Some(moment));
        (0..).zip(steps).map(part).collect::<Vec<_>>()
    };
    Ok(fields.iter().zip(all).flat_map(as_field).collect())
}

/// Refuses a source that is read for another field than the one of a name.
fn expect_field(step: &StepSource, name: &str) -> Result<()> {
    let found = match step.open()? {
        Input::Volume(volume) => volume.info().field.name.clone(),
        Input::Mesh(mesh) => mesh.field()?.name.clone(),
    };
    if found == name || without_frame(&found) == name {
        return Ok(());
    }
    Err(Error::no_such(format!("{}: no field {name}; it has {found}", step.path.display())))
}

/// The field that a frame is one of: "temp" of "temp:t5".
pub fn without_frame(field: &str) -> &str {
    let is_frame = |end: &str| !end.is_empty() && end.bytes().all(|b| b.is_ascii_digit());
    field.rsplit_once(":t").filter(|(_, end)| is_frame(end)).map_or(field, |(name, _)| name)
}

/// The files that an input stands for, and their times.
fn files_of(input: &Path) -> Result<Vec<(PathBuf, Option<f64>)>> {
    if is_remote(input) {
        // An address is no pattern; its reader says so.
        return Ok(vec![(input.to_path_buf(), None)]);
    }
    if has_suffix(input, &[".pvd", ".series"]) {
        return listed_files(input).map(by_times);
    }
    let text = input.to_string_lossy();
    if !is_pattern(&text) || input.exists() {
        return Ok(vec![(input.to_path_buf(), None)]);
    }
    let bad = |e: glob::PatternError| Error::usage(format!("{text}: {e}"));
    let mut files = vec![];
    for found in glob::glob(&text).map_err(bad)? {
        files.push(found.map_err(|e| {
            let path = e.path().to_owned();
            Error::io("look at", &path, e.into())
        })?);
    }
    if files.is_empty() {
        return Err(Error::bad_input(input, "pattern", "files that match it", "none")
            .with_help("* stands for any characters, ? for one, [0-9] for one of these"));
    }
    if files.iter().all(|f| has_suffix(f, &tiff::SUFFIXES)) {
        return Ok(vec![(input.to_path_buf(), None)]);
    }
    sort_by_names(&mut files);
    Ok(files.into_iter().map(|f| (f, None)).collect())
}

/// Puts files in the order of those of a pattern: by the numbers in their names, then by the names.
pub fn sort_by_names(files: &mut [PathBuf]) {
    by_numbers(files, |file| file.to_string_lossy().into_owned());
}

/// The files that a list names, with their times: `.pvd`, or ParaView's `.series`.
///
/// # Errors
/// As [`steps_of`]; those of reading the list.
pub fn listed_files(list: &Path) -> Result<Vec<(PathBuf, Option<f64>)>> {
    if has_suffix(list, &[".pvd"]) { pvd(list) } else { json_series(list) }
}

/// A list in the order of its times, as ParaView plays it, not in the order in which files were
/// added to it.
fn by_times(mut files: Vec<(PathBuf, Option<f64>)>) -> Vec<(PathBuf, Option<f64>)> {
    let times: Option<Vec<f64>> = files.iter().map(|(_, time)| time.filter(|t| t.is_finite())).collect();
    if times.is_some() {
        files.sort_by(|(_, a), (_, b)| a.partial_cmp(b).expect("finite numbers have an order"));
    }
    files
}

/// A reason to doubt the order in which files were named, as a shell sorts them without regard to
/// numbers: their names differ in numbers alone, which do not rise, or their times fall. `None`
/// where there is none.
pub fn order_in_doubt(inputs: &[PathBuf], steps: &[StepSource]) -> Option<String> {
    let times: Option<Vec<f64>> = steps.iter().map(|s| s.time).collect();
    if let Some(times) = times.filter(|t| t.len() > 1) {
        let falls = times.windows(2).position(|t| t[1] < t[0])?;
        let text = format!("time {} comes after {}", times[falls + 1], times[falls]);
        return Some(format!("the times of the steps do not rise ({text})"));
    }
    let name = |p: &PathBuf| p.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let names: Vec<String> = inputs.iter().map(name).collect();
    let falls = names.windows(2).position(|pair| !rise(&pair[0], &pair[1]))?;
    let (before, after) = (&names[falls], &names[falls + 1]);
    Some(format!("the numbers in the names of the files do not rise ({after} comes after {before})"))
}

/// The steps in a file. A file that cannot be opened counts as a step: the error comes when it is
/// opened.
fn steps_in(
    path: &Path,
    options: &OpenOptions,
    time: Option<f64>,
    files: &Arc<OpenedFiles>,
) -> Vec<StepSource> {
    let step =
        |options: &OpenOptions| StepSource { files: Arc::clone(files), ..StepSource::new(path, options) };
    let Ok(file) = files.open(path, options) else { return vec![step(options).at(time)] };
    let pattern = options.field.as_deref().filter(|name| is_pattern(name));
    let fields = match pattern {
        Some(pattern) => matching_fields(&file, options, pattern),
        None => file.steps(options),
    };
    match fields {
        Ok(fields) if fields.len() > 1 || fields.len() == 1 && pattern.is_some() => fields
            .into_iter()
            .map(|(name, own)| {
                step(&OpenOptions { field: Some(name), ..options.clone() }).at_stated(own, time)
            })
            .collect(),
        _ => vec![match time {
            Some(_) => step(options).at(time),
            None => step(options).at_stated(file.time(options).ok().flatten(), None),
        }],
    }
}

/// The fields with one number a sample whose names match a pattern.
fn matching_fields(file: &Opened, options: &OpenOptions, pattern: &str) -> Result<Frames> {
    let mut names = file.scalar_fields(options)?;
    if names.iter().any(|n| n == pattern) {
        return Ok(vec![]);
    }
    names.retain(|n| field_matches(pattern, n));
    by_numbers(&mut names, Clone::clone);
    let times = file.times(options)?;
    Ok(names.into_iter().map(|n| (n.clone(), times.get(&n).copied())).collect())
}

fn list_text(path: &Path) -> Result<String> {
    String::from_utf8(read_whole(path, LARGEST_LIST)?)
        .map_err(|_| Error::bad_input(path, "list of files", "text in UTF-8", "other bytes"))
}

fn no_files(path: &Path) -> Error {
    Error::bad_input(path, "list of files", "at least one", "none")
}

/// A list as ParaView's JSON has it.
#[derive(Deserialize)]
struct FileSeries {
    files: Vec<FileOfSeries>,
}

#[derive(Deserialize)]
struct FileOfSeries {
    name: PathBuf,
    time: Option<f64>,
}

fn json_series(path: &Path) -> Result<Vec<(PathBuf, Option<f64>)>> {
    let list: FileSeries = serde_json::from_str(&list_text(path)?).map_err(|e| {
        let at = format!("line {} column {}", e.line(), e.column());
        Error::bad_input(path, at, "{\"files\": [{\"name\": …, \"time\": …}, …]}", e.to_string())
    })?;
    if list.files.is_empty() {
        return Err(no_files(path));
    }
    Ok(list.files.into_iter().map(|f| (sibling(path, &f.name), f.time)).collect())
}

/// `<VTKFile type="Collection"><Collection><DataSet timestep="0.5" part="0" file="a.vti"/>…`
fn pvd(path: &Path) -> Result<Vec<(PathBuf, Option<f64>)>> {
    let text = list_text(path)?;
    let mut reader = Reader::from_str(&text);
    let mut files: Vec<(PathBuf, Option<f64>)> = vec![];
    loop {
        let at = |reader: &Reader<&[u8]>| Place::byte(reader.buffer_position());
        match reader.read_event() {
            Ok(Event::Start(tag) | Event::Empty(tag)) if tag.name().as_ref() == "DataSet" => {
                let wrong = |e: String| Error::bad_input(path, at(&reader), "good XML", e);
                for attribute in tag.attributes() {
                    attribute.map_err(|e| wrong(e.to_string()))?;
                }
                let of = |name: &str| -> Result<Option<String>> {
                    let found = tag.try_get_attribute(name).map_err(|e| wrong(e.to_string()))?;
                    let text = found.map(|a| a.normalized_value(quick_xml::XmlVersion::Implicit1_0));
                    Ok(text.transpose().map_err(|e| wrong(e.to_string()))?.map(|t| t.into_owned()))
                };
                if of("part")?.is_some_and(|p| !p.is_empty() && p != "0") {
                    let expected = "one file a time step (part 0)";
                    return Err(Error::bad_input(path, at(&reader), expected, "another part")
                        .with_help("reduce the parts each by itself, or write each step to one file"));
                }
                let Some(file) = of("file")? else {
                    return Err(Error::bad_input(path, at(&reader), "a DataSet with a file", "none"));
                };
                let number = |t: String| t.trim().parse::<f64>().map_err(|_| t);
                let time = of("timestep")?.map(number).transpose();
                let time = time.map_err(|t| Error::bad_input(path, at(&reader), "timestep=\"NUMBER\"", t))?;
                files.push((sibling(path, Path::new(&file)), time));
            }
            Ok(Event::Eof) => break,
            Ok(_) => {}
            Err(e) => return Err(Error::bad_input(path, at(&reader), "good XML", e.to_string())),
        }
    }
    if files.is_empty() { Err(no_files(path)) } else { Ok(files) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::tests::write;

    fn names(steps: &[StepSource]) -> Vec<String> {
        let name = |s: &StepSource| s.path.file_name().unwrap().to_string_lossy().into_owned();
        steps.iter().map(name).collect()
    }

    fn of(path: &Path) -> Result<Vec<StepSource>> {
        steps_of(&[path.to_path_buf()], &OpenOptions::default())
    }

    #[test]
    fn a_volume_that_is_given_has_coordinates() {
        let volume = || Arc::new(crate::volume::memory::volume_of("v", [3, 2, 1], vec![0u8; 6]).unwrap());
        let axes = |x: [f64; 3]| [x.to_vec(), vec![5.0, 1.0], vec![7.0]];
        let step = StepSource::given_on_axes("v", volume(), axes([0.0, 1.0, 4.0])).unwrap();
        let Some(GridCoordinates::Axes(found)) = step.coordinates().unwrap() else { panic!("axes") };
        assert_eq!(found, axes([0.0, 1.0, 4.0]));
        let plain = StepSource::given("v", volume());
        assert!(plain.coordinates().unwrap().is_none());
        let moved = StepSource::given_on_axes("v", volume(), axes([0.0, 1.0, 5.0])).unwrap();
        let hashes = [&plain, &step, &moved].map(|s| s.given_hash(&CancelToken::new()).unwrap().unwrap());
        assert!(hashes[0] != hashes[1] && hashes[1] != hashes[2]);
        let refused = |axes| StepSource::given_on_axes("v", volume(), axes).unwrap_err().to_string();
        assert!(refused(axes([0.0, 2.0, 1.0])).contains("rise or fall"));
        let [x, y, _] = axes([0.0, 1.0, 2.0]);
        assert!(refused([x, y, vec![]]).contains("1 coordinates expected"));
    }

    #[test]
    fn patterns_follow_numbers_and_tiff_is_one_volume() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["s_10.vti", "s_9.vti", "s_11.vti", "t_1.tif", "t_2.tif"] {
            write(&dir, name, b"x");
        }
        let pattern = |p: &str| of(&dir.path().join(p));
        assert_eq!(names(&pattern("s_*.vti").unwrap()), ["s_9.vti", "s_10.vti", "s_11.vti"]);
        assert_eq!(names(&pattern("s_1[01].vti").unwrap()), ["s_10.vti", "s_11.vti"]);
        assert_eq!(names(&pattern("t_*.tif").unwrap()), ["t_*.tif"]);
        assert!(pattern("u_*.vti").unwrap_err().to_string().contains("files that match it, got none"));
        assert_eq!(pattern("u_[.vti").unwrap_err().exit_code(), 2);
        let two = [dir.path().join("s_9.vti"), dir.path().join("none.vti")];
        assert_eq!(steps_of(&two, &OpenOptions::default()).unwrap().len(), 2, "opening tells what is wrong");
    }

    #[test]
    fn lists_tell_times() {
        let dir = tempfile::tempdir().unwrap();
        let times = |steps: &[StepSource]| steps.iter().map(|s| s.time).collect::<Vec<_>>();
        let pvd = write(
            &dir,
            "a.pvd",
            br#"<?xml version="1.0"?><VTKFile type="Collection"><Collection>
            <DataSet timestep="0.5" group="" part="0" file="x &amp; y.vti"/><DataSet timestep="2e0" file="b.vti"></DataSet>
            </Collection></VTKFile>"#,
        );
        let steps = of(&pvd).unwrap();
        assert_eq!(
            (names(&steps), times(&steps)),
            (vec!["x & y.vti".into(), "b.vti".into()], vec![Some(0.5), Some(2.0)])
        );
        assert_eq!(steps[0].path, dir.path().join("x & y.vti"));
        let mixed = br#"<Collection><DataSet timestep="10" file="c"/><DataSet timestep="9" file="b"/><DataSet timestep="-1" file="a"/></Collection>"#;
        let steps = of(&write(&dir, "mixed.pvd", mixed)).unwrap();
        assert_eq!(names(&steps), ["a", "b", "c"]);
        let some = br#"{"files": [{"name": "b", "time": 1}, {"name": "a", "time": 0}, {"name": "c"}]}"#;
        let steps = of(&write(&dir, "some.series", some)).unwrap();
        assert_eq!(names(&steps), ["b", "a", "c"], "without all times, as they are listed");
        let json = write(
            &dir,
            "a.vti.series",
            br#"{"file-series-version": "1.0", "files": [{"name": "p.vti", "time": 0}, {"name": "q.vti"}]}"#,
        );
        let steps = of(&json).unwrap();
        assert_eq!(
            (names(&steps), times(&steps)),
            (vec!["p.vti".into(), "q.vti".into()], vec![Some(0.0), None])
        );
    }

    #[test]
    fn bad_lists_are_told_in_one_line() {
        let dir = tempfile::tempdir().unwrap();
        for (name, bytes) in [
            ("a.pvd", &b"<VTKFile><Collection></Collection></VTKFile>"[..]),
            ("b.pvd", b"<Collection><DataSet timestep=\"x\" file=\"a\"/></Collection>"),
            ("c.pvd", b"<Collection><DataSet part=\"1\" file=\"a\"/></Collection>"),
            ("d.pvd", b"<Collection><DataSet/></Collection>"),
            ("e.pvd", b"<Collection><DataSet file=\"a\" file=\"b\"/></Collection>"),
            ("a.series", b"{}"),
            ("b.series", b"{\"files\": []}"),
            ("c.series", b"{\"files\": [{\"time\": 1}]}"),
        ] {
            let error = of(&write(&dir, name, bytes)).unwrap_err();
            assert_eq!((error.exit_code(), error.to_string().contains('\n')), (5, false), "{name}: {error}");
        }
    }
}
