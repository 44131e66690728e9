//! The manifest: what an archive is of, how it was made, and which segments it has. Written last.
//!
//! It is compressed JSON with a checksum ([`pack_manifest`]): a flipped bit is an error and not
//! another archive. A folder without a manifest is an unfinished archive.
//!
//! Members with their usual value are left out, and so are those of an error that follow from
//! others: `FORMAT.md` lists them. Of a small archive they would be half of all bytes.
//!
//! Two hashes tie the files together. The *plan hash* covers what decides the mesh (lattice,
//! points, cuts, block size): every mesh segment carries it. A *step hash* covers that and what
//! decides the values of a step (source, field, interpolation): the step's value and index segments
//! carry it. Neither covers the path of a source or its units, nor threads or memory.

mod files;
mod order;
mod packed;
mod plan;
mod record;

pub use self::files::{
    coarse_path, coordinates_path, index_path, is_coordinates, low_segment_path, mesh_folder,
    mesh_segment_path, ranges_segment_path, spectrum_path, step_prefix, steps_folder, sums_segment_path,
    values_segment_path,
};
pub use self::packed::{MANIFEST_DICTIONARY, pack_manifest};
pub use self::plan::{
    BLOCK_TETS, CHUNK_POINTS, Counts, FrameRecord, MOST_UNINDEXED, MOST_UNINDEXED_CHUNKS, MeshPlan, OwnRecord,
};

use self::record::{GeometryRecord, StepRecord};
use self::record::{is_default, is_one, is_usual_geometry, is_zero, one};
use crate::archive::segment::{
    FORMAT_VERSION, LABELS_FORMAT, OLDEST_FORMAT, OLDEST_READER, PlanHash, SegmentInfo,
};
use crate::archive::tables::CellCount;
use crate::archive::values::Quantiser;
use crate::measure::{FieldError, LevelError};
use isospan_io::bytes::plain::open_plain;
use isospan_io::bytes::publish::Unpublished;
use isospan_io::bytes::read_whole;
use isospan_io::bytes::remote::{is_remote, read_all};
use isospan_io::error::{Error, Fault, Result};
use isospan_io::grid::Geometry;
use isospan_io::volume::units::Units;
use isospan_io::volume::{ScalarType, shifted::shortest};
use isospan_mesh::sample::{Interpolation, Values};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Name of the manifest in the archive's folder.
pub const MANIFEST_NAME: &str = "manifest.zst";
/// Value of the manifest's first member.
pub const MANIFEST_FORMAT: &str = "isospan archive";
/// The most bytes of a manifest.
pub const LARGEST_MANIFEST: u64 = 1 << 30;

/// The most steps between a step and the keyframe that its values may go back to.
pub const LONGEST_CHAIN: u64 = 255;

/// The file that a step was sampled from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// Its path as it was given.
    pub path: String,
    /// A fingerprint of its contents.
    pub fingerprint: String,
    /// Its format, as a person would call it.
    pub format: String,
    /// Samples along x, y, z.
    pub dims: [u64; 3],
    /// Type of a stored sample.
    pub scalar: ScalarType,
    /// The field that was read.
    pub field: String,
    /// Index space to world.
    #[serde(default, with = "GeometryRecord", skip_serializing_if = "is_usual_geometry")]
    pub geometry: Geometry,
    /// A sample's value is `slope · stored + intercept`.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub slope: f64,
    /// See `slope`.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub intercept: f64,
    /// The stored value that the file declares to mean "no data"; a finite number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing: Option<f64>,
    /// All values of the archive are `f32`, and are those of the file less this; the same for all
    /// steps.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub offset: f64,
    /// The largest difference of a sample from the `f32` that stands for it, where that matters:
    /// more than 2^-20 of the range, or any difference for whole numbers. Errors include it.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub rounding: f64,
    /// The vertices and tetrahedra of a tetrahedral mesh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh: Option<MeshSource>,
    /// The units of values, lengths and times, as far as they are known. No other byte of an
    /// archive depends on them, so no hash covers them.
    #[serde(default, skip_serializing_if = "Units::are_unknown")]
    pub units: Units,
}

impl Source {
    /// The file's value of one of the archive, as a person writes it: 0.1, not 0.10000000149011612.
    pub fn in_file(&self, v: f32) -> f64 {
        self.offset + shortest(v)
    }

    /// What the samples lost when they became `f32`, at most, where that matters.
    pub fn notable_rounding(&self) -> Option<f64> {
        Some(self.rounding).filter(|lost| *lost > 0.0)
    }

    /// The archive's value for a value of the file.
    pub fn kept(&self, v: f64) -> f32 {
        (v - self.offset) as f32
    }

    /// Its samples; of a mesh its vertices.
    pub fn samples(&self) -> u64 {
        self.mesh.map_or_else(|| self.dims.iter().product(), |mesh| mesh.vertices)
    }
}

/// A tetrahedral mesh that a step was sampled from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeshSource {
    /// Its vertices.
    pub vertices: u64,
    /// Its tetrahedra.
    pub tetrahedra: u64,
    /// XXH3 (128 bits) of its points, x y z as f64: further steps must have them.
    pub point_hash: PlanHash,
    /// XXH3 (128 bits) of its cells: of each that has a volume its kind in a byte, and its vertices
    /// as u64.
    pub cell_hash: PlanHash,
}

/// What the coefficients of a step of a pyramid stand for. All is less the offset of the source.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WaveletRecord {
    /// Least and largest sample of the source.
    pub range: [f64; 2],
    /// What neighbouring values of a coefficient differ by.
    pub step: f64,
    /// How samples are corrected after they are decoded.
    #[serde(default, skip_serializing_if = "is_default")]
    pub correction: CorrectionRecord,
}

/// How samples of a pyramid are corrected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CorrectionRecord {
    /// Not at all.
    #[default]
    None,
    /// So that no sample is off by more than this.
    Max(f64),
    /// Whole numbers are exact.
    Lossless,
    /// They are labels: nothing is transformed, nor corrected.
    Labels,
}

impl CorrectionRecord {
    /// Whether whole numbers come back as they were.
    pub fn is_exact(self) -> bool {
        matches!(self, Self::Lossless | Self::Labels)
    }
}

/// Everything, besides the plan, that decides the bytes of a step's values and index.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepPlan {
    /// Number of the step's files, and of the step, unless that has a [`StoredStep::place`].
    pub number: u64,
    /// Its time, if the input gives one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<f64>,
    /// What was sampled.
    pub source: Source,
    /// How.
    #[serde(default, skip_serializing_if = "is_default")]
    pub interpolation: Interpolation,
    /// Whether the values are interpolated ones, or fitted to the samples.
    #[serde(
        rename = "vertex_values",
        default = "Values::sampled",
        skip_serializing_if = "Values::is_sample"
    )]
    pub values: Values,
    /// What was done with NaN and infinite samples, as on the command line: "error", "mask" or a
    /// number.
    #[serde(default = "usual_nan", skip_serializing_if = "is_usual_nan")]
    pub nan: String,
    /// The value that the user says means "no data", besides what the file declares; a finite
    /// number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing: Option<f64>,
    /// How values were rounded, if they were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quantiser: Option<Quantiser>,
    /// What the coefficients of a pyramid stand for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wavelet: Option<WaveletRecord>,
    /// Steps from one keyframe to the next, by number; further steps go on with it.
    #[serde(default = "usual_keyframes", skip_serializing_if = "is_usual_keyframes")]
    pub keyframes: u64,
    /// Whether the errors at the samples of a volume are stored chunk by chunk, next to the values.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub measured: bool,
    /// The step before, against which values may be coded; a keyframe has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<BaseStep>,
}

/// Steps from one keyframe to the next, unless the user chooses.
pub const KEYFRAMES: u64 = 16;

fn usual_keyframes() -> u64 {
    KEYFRAMES
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_usual_keyframes(keyframes: &u64) -> bool {
    *keyframes == KEYFRAMES
}

fn usual_nan() -> String {
    "error".into()
}

fn is_usual_nan(nan: &str) -> bool {
    nan == "error"
}

/// A step against whose values those of another may be coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BaseStep {
    /// Its number.
    pub number: u64,
    /// Its [`StepPlan::hash`].
    pub hash: PlanHash,
}

impl StepPlan {
    /// How values were rounded, as the file has values.
    pub fn file_quantiser(&self) -> Option<Quantiser> {
        self.quantiser.map(|q| Quantiser { origin: q.origin + self.source.offset, ..q })
    }

    /// The hash that the step's value and index segments carry. A copy of the source elsewhere
    /// gives the same.
    pub fn hash(&self, plan: PlanHash) -> PlanHash {
        let mut part = self.clone();
        part.source.path.clear();
        part.source.units = Units::default();
        let mut canonical = plan.to_string().into_bytes();
        canonical.extend(serde_json::to_vec(&part).expect("a step plan is plain data"));
        PlanHash::of(&canonical)
    }
}

/// A finished segment of a range of chunks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SegmentRecord {
    /// First chunk.
    #[serde(default, skip_serializing_if = "is_default")]
    pub first_chunk: u64,
    /// Number of chunks.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub chunks: u64,
    /// Length, blocks, content hash.
    #[serde(flatten)]
    pub info: SegmentInfo,
}

/// A finished step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StepRecord", into = "StepRecord")]
pub struct StoredStep {
    /// What it was made from, and how.
    pub plan: StepPlan,
    /// Number of the step, where that is not the one of its files: steps are in the order of their
    /// times, and files are in the order in which they were made.
    pub place: Option<u64>,
    /// The field that the step is one of, where each step of the archive has several.
    pub series: Option<String>,
    /// Smallest and largest value, less the offset of the source; none when every point is void.
    pub value_range: Option<[f32; 2]>,
    /// Points without a value.
    pub void_points: u64,
    /// Value segments, in chunk order; the n-th is `values-n.seg`.
    pub values: Vec<SegmentRecord>,
    /// Of a pyramid: the segments of ranges and corrections, in chunk order.
    pub ranges: Vec<SegmentRecord>,
    /// Of a pyramid: the coarse levels.
    pub coarse: Option<SegmentInfo>,
    /// The index; none in a small archive, where the summaries of its chunks say as much.
    pub index: Option<SegmentInfo>,
    /// The contour spectrum; none in a small archive, nor where every tetrahedron is void.
    pub spectrum: Option<SegmentInfo>,
    /// The coordinates, where the source is a rectilinear or curvilinear grid.
    pub coordinates: Option<CoordinateRecord>,
    /// How far the reduced field is from the samples of its source, where that was measured.
    pub error: Option<FieldError>,
    /// The errors of each level, where the density of points differs from place to place.
    pub level_errors: Vec<LevelError>,
    /// Of a pyramid whose error was measured: the RMS errors of levels 1, 2, … at the samples up to
    /// their last nodes, or in some rows of them.
    pub level_rms: Vec<f64>,
}

impl StoredStep {
    /// A step of a plan, of which no file is known yet.
    pub fn of(plan: StepPlan) -> Self {
        Self {
            plan,
            place: None,
            series: None,
            value_range: None,
            void_points: 0,
            values: vec![],
            ranges: vec![],
            coarse: None,
            index: None,
            spectrum: None,
            coordinates: None,
            error: None,
            level_errors: vec![],
            level_rms: vec![],
        }
    }

    /// Smallest and largest value, as the file has values.
    pub fn file_range(&self) -> Option<[f64; 2]> {
        self.value_range.map(|range| range.map(|v| self.plan.source.in_file(v)))
    }

    /// What the samples lost when they became `f32`, at most, where that matters.
    pub fn notable_rounding(&self) -> Option<f64> {
        self.plan.source.notable_rounding()
    }
}

/// The coordinates of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CoordinateRecord {
    /// Their segment.
    pub info: SegmentInfo,
    /// Cells of the grid that fold, or have no volume.
    pub cells: CellCount,
}

/// The manifest of an archive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    format: String,
    format_version: u16,
    /// The oldest format whose readers can read it, if it is not its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    oldest_reader: Option<u16>,
    /// Version of the program that wrote the archive.
    pub isospan_version: String,
    /// What decides the mesh.
    pub plan: MeshPlan,
    /// [`MeshPlan::hash`]; not written, as it follows.
    #[serde(skip)]
    pub plan_hash: PlanHash,
    /// Sizes.
    pub counts: Counts,
    /// Mesh segments, in chunk order; the n-th is `mesh/n.seg`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mesh: Vec<SegmentRecord>,
    /// Steps, in order of their numbers; where a step has several fields, field after field.
    pub steps: Vec<StoredStep>,
    /// Steps that others have replaced, and that remaining ones refer to.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bases: Vec<StoredStep>,
    /// XXH3 (128 bits) of the settings, if the archive was made for a wanted error, by several
    /// tries. By this hash the same call knows that it is done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<PlanHash>,
}

/// What a manifest of any version has.
#[derive(Deserialize)]
struct Version {
    format: String,
    format_version: u16,
    oldest_reader: Option<u16>,
}

impl Manifest {
    /// Version of the archive's format, which what it holds decides.
    pub fn format_version(&self) -> u16 {
        self.format_version
    }

    /// A manifest of this version of the program.
    pub fn new(plan: MeshPlan, counts: Counts, mesh: Vec<SegmentRecord>, steps: Vec<StoredStep>) -> Self {
        let manifest = Self {
            format: MANIFEST_FORMAT.into(),
            format_version: FORMAT_VERSION,
            oldest_reader: Some(OLDEST_READER).filter(|oldest| *oldest != FORMAT_VERSION),
            isospan_version: env!("CARGO_PKG_VERSION").into(),
            plan_hash: plan.hash(),
            plan,
            counts,
            mesh,
            steps,
            bases: vec![],
            target: None,
        };
        manifest.of_its_format()
    }

    /// The same with steps that others have replaced.
    #[must_use]
    pub fn with_bases(self, bases: Vec<StoredStep>) -> Self {
        Self { bases, ..self }.of_its_format()
    }

    /// Publishes the manifest in the archive's folder, replacing an older one. All segments are
    /// there already.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, archive: &Path) -> Result<()> {
        let mut out = Unpublished::create(&archive.join(MANIFEST_NAME))?;
        out.write(&self.to_bytes())?;
        out.publish()
    }

    /// The manifest's file.
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        pack_manifest(&self.to_json())
    }

    /// As JSON without spaces.
    ///
    /// # Panics
    /// Never: a manifest is plain data.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("a manifest is plain data")
    }

    /// Reads the manifest of an archive.
    ///
    /// # Errors
    /// When there is none, it is damaged or edited, or of a version that this program cannot read.
    pub fn read(archive: &Path) -> Result<Self> {
        let path = archive.join(MANIFEST_NAME);
        if is_remote(archive) {
            let manifest = Self::parse(&read_all(&path, LARGEST_MANIFEST)?, &path)?;
            manifest.check(&path)?;
            return Ok(manifest);
        }
        if archive.is_dir() && !path.exists() {
            return Err(without_manifest(archive));
        }
        let manifest = Self::parse(&read_whole(&path, LARGEST_MANIFEST)?, &path)?;
        manifest.check(&path)?;
        Ok(manifest)
    }

    /// As [`Manifest::read`], of an archive on this machine, with the bytes of the file. No link is
    /// followed.
    pub(crate) fn read_plain(archive: &Path) -> Result<(Self, Vec<u8>)> {
        let (path, mut bytes) = (archive.join(MANIFEST_NAME), vec![]);
        let read = open_plain(&path, File::options().read(true))
            .and_then(|file| file.take(LARGEST_MANIFEST).read_to_end(&mut bytes));
        read.map_err(|e| Error::io("read", &path, e))?;
        let manifest = Self::parse(&bytes, &path)?;
        manifest.check(&path)?;
        Ok((manifest, bytes))
    }

    fn parse(bytes: &[u8], path: &Path) -> Result<Self> {
        Self::of_json(&packed::unpack(bytes, path)?, path)
    }

    fn of_json(text: &[u8], path: &Path) -> Result<Self> {
        let json = |e: serde_json::Error| {
            let at = format!("line {} column {}", e.line(), e.column());
            Error::bad_input(path, at, "the manifest of an isospan archive", e.to_string())
        };
        let version: Version = serde_json::from_slice(text).map_err(json)?;
        if version.format != MANIFEST_FORMAT {
            return Err(Error::bad_input(path, "format", MANIFEST_FORMAT, version.format));
        }
        if version.format_version < OLDEST_FORMAT {
            let expected = format!("format {OLDEST_FORMAT} or later");
            return Err(Error::bad_input(
                path,
                "format_version",
                expected,
                version.format_version.to_string(),
            )
            .with_help(
                "an earlier isospan has made it: run the same reduction again, with another output name",
            ));
        }
        let oldest_reader = version.oldest_reader.unwrap_or(version.format_version);
        if oldest_reader > LABELS_FORMAT {
            return Err(Error::bad_input(
                path,
                "format_version",
                format!("a version that format {LABELS_FORMAT} programs can read"),
                format!("{}, for programs of format {} on", version.format_version, oldest_reader),
            )
            .with_help("use a newer isospan"));
        }
        let manifest: Self = serde_json::from_slice(text).map_err(json)?;
        Ok(Self { plan_hash: manifest.plan.hash(), ..manifest })
    }

    /// Invariants that the rest of the program relies on.
    fn check(&self, path: &Path) -> Result<()> {
        let bad = |at: &str, expected: String, got: String| Err(Error::bad_input(path, at, expected, got));
        let lattice = self.plan.lattice;
        if !lattice.is_valid() || self.plan.brick_edge.contains(&0) {
            return bad("plan", "a lattice and bricks".into(), format!("{:?}", lattice.dims));
        }
        // A mesh that follows by formula is not stored.
        let stored = if self.plan.stores_mesh() { self.counts.chunks } else { 0 };
        check_tiling(path, "mesh", &self.mesh, stored)?;
        let offset = self.steps.first().map_or(0.0, |step| step.plan.source.offset);
        if !self.all_steps().all(|s| s.plan.source.offset == offset && s.plan.source.rounding >= 0.0) {
            return bad("offset of a step", format!("{offset}, as of the first"), "another".into());
        }
        for step in self.all_steps() {
            check_tiling(path, "values of a step", &step.values, self.counts.chunks)?;
            if self.plan.is_pyramid() {
                check_tiling(path, "ranges of a step", &step.ranges, self.counts.chunks)?;
            }
            let (is_pyramid, has_labels) = (self.plan.is_pyramid(), self.plan.has_labels());
            let expected = [is_pyramid, is_pyramid && !has_labels];
            if [step.plan.wavelet.is_some(), step.coarse.is_some()] != expected {
                let expected = "a scale and coarse levels, those of a pyramid alone".into();
                return bad("wavelet and coarse of a step", expected, "others".into());
            }
            let of_labels = step.plan.wavelet.is_some_and(|w| w.correction == CorrectionRecord::Labels);
            if of_labels != has_labels || has_labels && step.plan.base.is_some() {
                let expected = "labels of a step alone, in an archive of labels".into();
                return bad("correction and base of a step", expected, "others".into());
            }
        }
        for step in &self.steps {
            if step.index.is_some() != self.counts.is_indexed(&self.plan) {
                let [expected, got] = [step.index.is_none(), step.index.is_some()]
                    .map(|has| if has { "one" } else { "none" }.into());
                return bad("index of a step", expected, got);
            }
            if step.spectrum.is_some() && step.index.is_none() {
                return bad("spectrum of a step", "none, in a small archive".into(), "one".into());
            }
        }
        self.check_order(path)?;
        self.check_bases(path)
    }
}

/// Segments cover the chunks, each once, in order.
fn check_tiling(path: &Path, at: &str, segments: &[SegmentRecord], chunks: u64) -> Result<()> {
    let mut next = Some(0u64);
    for s in segments {
        if next != Some(s.first_chunk) {
            let expected = format!("a segment from chunk {}", next.unwrap_or(u64::MAX));
            return Err(Error::bad_input(path, at, expected, format!("from chunk {}", s.first_chunk)));
        }
        next = s.first_chunk.checked_add(s.chunks);
    }
    if next != Some(chunks) {
        let got = format!("{}", next.unwrap_or(u64::MAX));
        return Err(Error::bad_input(path, at, format!("{chunks} chunks"), got));
    }
    Ok(())
}

/// The error for a folder without a manifest: an unfinished archive, or something else.
fn without_manifest(folder: &Path) -> Error {
    if mesh_folder(folder).is_dir() {
        return Error::bad_input(folder, MANIFEST_NAME, "a manifest", "none")
            .with_help("the archive is not finished: run the same reduction again");
    }
    let entries = std::fs::read_dir(folder).map_or(0, Iterator::count);
    let got = if entries == 0 { "an empty folder" } else { "a folder of other files" };
    Error::bad_input(folder, "archive", "a folder made by isospan reduce", got)
}

const TAIL_START: &str = ",\"checksum\":\"";

/// The end of a manifest whose text so far is `body`.
fn tail(body: &str) -> String {
    format!("{TAIL_START}{}\"}}\n", PlanHash::of(body.as_bytes()))
}

/// A record as JSON, with a checksum of all bytes before it as its last member. It has no spaces:
/// of a small archive they would be a tenth.
pub(crate) fn sealed_text(record: &impl Serialize) -> String {
    let json = serde_json::to_string(record).expect("a record is plain data");
    let body = json.strip_suffix('}').expect("an object ends with its brace");
    format!("{body}{}", tail(body))
}

/// Checks the last member of what [`sealed_text`] wrote.
pub(crate) fn check_sum(bytes: &[u8], path: &Path, help: &str) -> Result<()> {
    let text = String::from_utf8_lossy(bytes);
    let body = text.rfind(TAIL_START).map_or(&text[..], |at| &text[..at]);
    if text.strip_prefix(body) == Some(&tail(body)) && matches!(text, std::borrow::Cow::Borrowed(_)) {
        return Ok(());
    }
    Err(Error::bad_input(path, "checksum", PlanHash::of(body.as_bytes()).to_string(), "another or none")
        .of_fault(Fault::Checksum)
        .with_help(help))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::measure::{PERCENTILES, Percentile, Worst};
    use isospan_io::geom::Lattice;
    use isospan_mesh::points::PointSpec;

    pub(crate) fn plan() -> MeshPlan {
        MeshPlan {
            lattice: Lattice::new([103, 94, 161]).unwrap(),
            points: PointSpec::Hammersley { n: 1000, shift: 0.5 },
            order_bits: 9,
            brick_edge: [20; 3],
            chunk_target: CHUNK_POINTS,
            block_tets: 1000,
            explicit: None,
            own: None,
            levels: None,
            repeated: None,
            stars: false,
            frame: None,
        }
    }

    pub(crate) fn step_plan(number: u64) -> StepPlan {
        let source = Source {
            path: "tooth.nrrd".into(),
            fingerprint: "xxh3:00".into(),
            format: "NRRD (attached, raw)".into(),
            dims: [103, 94, 161],
            scalar: ScalarType::U8,
            field: "data".into(),
            geometry: Geometry { origin: [0.1, -1.0 / 3.0, 1e-300], ..Geometry::default() },
            slope: 1.0,
            intercept: 0.1 + 0.2,
            missing: None,
            offset: 0.0,
            rounding: 0.0,
            mesh: None,
            units: Units::default(),
        };
        let interpolation = Interpolation::Linear;
        StepPlan {
            number,
            time: Some(0.7 + number as f64),
            source,
            interpolation,
            values: Values::Sample,
            nan: "error".into(),
            missing: None,
            quantiser: None,
            wavelet: None,
            keyframes: KEYFRAMES,
            measured: false,
            base: None,
        }
    }

    fn example() -> Manifest {
        let info = SegmentInfo { bytes: 1000, blocks: 7, content_hash: u64::MAX - 5 };
        let record = |first_chunk, chunks| SegmentRecord { first_chunk, chunks, info };
        let step = |number| StoredStep {
            plan: step_plan(number),
            place: None,
            series: None,
            value_range: Some([-0.1, 1e30]),
            void_points: 0,
            values: vec![record(0, 5)],
            index: Some(info),
            spectrum: (number == 0).then_some(info),
            coordinates: None,
            error: None,
            level_errors: vec![],
            level_rms: vec![],
            ranges: vec![],
            coarse: None,
        };
        let counts = Counts { points: 1000, tetrahedra: 6000, chunks: 5, blocks: 12 };
        Manifest::new(plan(), counts, vec![record(0, 2), record(2, 3)], vec![step(0), step(3)])
    }

    #[test]
    fn it_comes_back_and_replaces_an_older_one() {
        let dir = tempfile::tempdir().unwrap();
        let m = example();
        m.write(dir.path()).unwrap();
        assert_eq!(Manifest::read(dir.path()).unwrap(), m);
        let mut fewer = m.clone();
        fewer.steps.pop();
        fewer.write(dir.path()).unwrap();
        assert_eq!(Manifest::read(dir.path()).unwrap(), fewer);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "no leftover");
        let file = std::fs::read(dir.path().join(MANIFEST_NAME)).unwrap();
        let json = packed::unpack(&file, dir.path()).unwrap();
        assert_eq!(String::from_utf8(json).unwrap(), fewer.to_json());
        assert!(4 * file.len() < fewer.to_json().len(), "{} bytes", file.len());
    }

    /// A step whose members are the usual ones, and an error whose counts and places follow.
    fn usual() -> Manifest {
        let mut m = example();
        m.steps.truncate(1);
        m.mesh.truncate(1);
        m.plan.block_tets = BLOCK_TETS;
        m.plan_hash = m.plan.hash();
        (m.counts.chunks, m.mesh[0].chunks) = (1, 1);
        let step = &mut m.steps[0];
        step.values[0].chunks = 1;
        (step.index, step.spectrum, step.value_range) = (None, None, Some([-0.5, 0.1]));
        step.plan.time = None;
        let source = &mut step.plan.source;
        (source.geometry, source.intercept) = (Geometry::default(), 0.0);
        let percentile = |(n, percent)| Percentile { percent, error: n as f64 / 8.0 };
        step.error = Some(FieldError {
            samples: 103 * 94 * 161,
            measured: 103 * 94 * 161,
            missing: 0,
            void: 0,
            outside: 0,
            source_range: Some([-0.5, 0.1f32.into()]),
            beyond: 0,
            max: (0.3f32 - 0.1).into(),
            rms: 0.125,
            mean: 0.0625,
            bias: -0.0625,
            percentiles: PERCENTILES.into_iter().enumerate().map(percentile).collect(),
            worst: Some(Worst {
                sample: 3 + 103 * (2 + 94),
                index: Some([3, 2, 1]),
                world: [3.0, 2.0, 1.0],
                original: 0.1,
                reduced: 0.3,
            }),
        });
        m
    }

    #[test]
    fn what_is_usual_or_follows_is_left_out() {
        let m = usual();
        let text = m.to_json();
        let plan = concat!(
            r#"{"lattice":{"dims":[103,94,161],"log2_steps":16},"#,
            r#""points":{"set":"hammersley","n":1000,"shift":0.5},"order_bits":9,"#,
            r#""brick_edge":[20,20,20]}"#
        );
        let step = concat!(
            r#"{"number":0,"source":{"path":"tooth.nrrd","fingerprint":"xxh3:00","#,
            r#""format":"NRRD (attached, raw)","dims":[103,94,161],"scalar":"u8","field":"data"}"#
        );
        let rest = concat!(
            r#","value_range":[-0.5,0.1],"#,
            r#""values":[{"bytes":1000,"blocks":7,"content_hash":"fffffffffffffffa"}],"#,
            r#""error":{"rms":0.125,"mean":0.0625,"bias":-0.0625,"#,
            r#""percentiles":[0.0,0.125,0.25,0.375,0.5,0.625],"#,
            r#""worst":{"sample":9891,"original":0.1,"reduced":0.3}}}]"#
        );
        let head = r#"{"format":"isospan archive","format_version":7,"isospan_version":"#;
        let counts = r#""counts":{"points":1000,"tetrahedra":6000,"blocks":12},"#;
        let mesh = r#""mesh":[{"bytes":1000,"blocks":7,"content_hash":"fffffffffffffffa"}],"#;
        assert_eq!(
            text,
            format!(r#"{head}"{}","plan":{plan},{counts}{mesh}"steps":[{step}{rest}}}"#, m.isospan_version,)
        );
        assert_eq!(Manifest::of_json(text.as_bytes(), Path::new("m")).unwrap(), m);
        assert_eq!(m.plan_hash, PlanHash::of(plan.as_bytes()));
        let hashed = format!("{}{step}}}", m.plan_hash).replace("tooth.nrrd", "");
        assert_eq!(m.steps[0].plan.hash(m.plan_hash), PlanHash::of(hashed.as_bytes()));
    }

    type Edit = fn(&mut Manifest);

    #[test]
    fn what_is_not_usual_comes_back() {
        let edits: &[(&str, Edit)] = &[
            ("\"chunk_target\":1", |m| m.plan.chunk_target = 1),
            ("\"block_tets\":1", |m| m.plan.block_tets = 1),
            ("\"chunks\":2", |m| m.counts.chunks = 2),
            ("\"stars\":true", |m| m.plan.stars = true),
            ("\"first_chunk\":7", |m| m.mesh[0].first_chunk = 7),
            ("\"chunks\":0,\"bytes\"", |m| m.mesh[0].chunks = 0),
            ("\"time\":0.0", |m| m.steps[0].plan.time = Some(0.0)),
            ("\"interpolation\":\"cubic\"", |m| m.steps[0].plan.interpolation = Interpolation::Cubic),
            ("\"nan\":\"mask\"", |m| m.steps[0].plan.nan = "mask".into()),
            ("\"void_points\":1", |m| m.steps[0].void_points = 1),
            ("\"value_range\":null", |m| m.steps[0].value_range = None),
            ("\"quantiser\":{", |m| {
                m.steps[0].plan.quantiser = Some(Quantiser::new(6.0, [0.0, 1.0]));
            }),
            ("\"geometry\":{\"origin\":[0.0,-0.0,0.0]}", |m| {
                m.steps[0].plan.source.geometry.origin[1] = -0.0;
            }),
            ("\"geometry\":{\"spacing\":[1.0,1.0,2.0]}", |m| {
                m.steps[0].plan.source.geometry.spacing[2] = 2.0;
            }),
            ("\"geometry\":{\"direction\":[[1.0,0.0,0.0],[0.0,-1.0,0.0],", |m| {
                m.steps[0].plan.source.geometry.direction[1][1] = -1.0;
            }),
            ("\"slope\":-1.0", |m| m.steps[0].plan.source.slope = -1.0),
            ("\"intercept\":-0.0", |m| m.steps[0].plan.source.intercept = -0.0),
            ("\"missing\":0.0", |m| m.steps[0].plan.source.missing = Some(0.0)),
            ("\"offset\":1.0", |m| m.steps[0].plan.source.offset = 1.0),
            ("\"samples\":4", |m| error_of(m).samples = 4),
            ("\"measured\":0", |m| error_of(m).measured = 0),
            ("\"missing\":3", |m| error_of(m).missing = 3),
            ("\"void\":3", |m| error_of(m).void = 3),
            ("\"outside\":3", |m| error_of(m).outside = 3),
            ("\"beyond\":3", |m| error_of(m).beyond = 3),
            ("\"source_range\":null", |m| error_of(m).source_range = None),
            ("\"source_range\":[0.0,1.0]", |m| error_of(m).source_range = Some([0.0, 1.0])),
            ("\"max\":7.0", |m| error_of(m).max = 7.0),
            ("\"index\":[4,2,1]", |m| worst_of(m).index = Some([4, 2, 1])),
            ("\"world\":[3.0,2.0,1.5]", |m| worst_of(m).world[2] = 1.5),
            ("\"index\":[0,0,161]", |m| {
                *worst_of(m) = Worst { sample: 103 * 94 * 161, index: Some([0, 0, 161]), ..*worst_of(m) }
            }),
            ("\"max\":0.0", |m| (error_of(m).max, error_of(m).worst) = (0.0, None)),
            ("\"world\":[3.0,2.0,1.0]", |m| {
                m.steps[0].plan.source.mesh = Some(MeshSource {
                    vertices: 103 * 94 * 161,
                    tetrahedra: 1,
                    point_hash: PlanHash::of(b""),
                    cell_hash: PlanHash::of(b""),
                });
                worst_of(m).index = None;
            }),
        ];
        let usual_text = usual().to_json();
        for (words, edit) in edits {
            let mut m = usual();
            edit(&mut m);
            m.plan_hash = m.plan.hash();
            let text = m.to_json();
            assert!(text.contains(words) && !usual_text.contains(words), "{words}: {text}");
            let back = Manifest::of_json(text.as_bytes(), Path::new("m")).unwrap();
            assert_eq!(back, m, "{words}");
            // Equal numbers may have different signs of zero.
            assert_eq!(back.to_json(), text);
            assert_eq!(back.steps[0].plan.hash(m.plan_hash), m.steps[0].plan.hash(m.plan_hash));
        }
    }

    fn error_of(m: &mut Manifest) -> &mut FieldError {
        m.steps[0].error.as_mut().unwrap()
    }

    fn worst_of(m: &mut Manifest) -> &mut Worst {
        error_of(m).worst.as_mut().unwrap()
    }

    #[test]
    fn members_of_other_types_and_those_that_do_not_follow_are_refused() {
        let good = usual().to_json();
        for (from, to, words) in [
            ("\"number\":0,", "\"number\":0,\"void_points\":-1,", "invalid value"),
            ("\"number\":0,", "\"number\":0,\"time\":\"noon\",", "invalid type"),
            ("\"number\":0,", "\"number\":0,\"interpolation\":null,", "null"),
            ("\"number\":0,", "\"number\":0,\"nan\":0,", "invalid type"),
            ("\"number\":0,", "\"number\":0,\"index\":7,", "invalid type"),
            ("\"field\":", "\"geometry\":{\"origin\":[0.0,1.0]},\"field\":", "invalid length 2"),
            ("\"field\":", "\"slope\":null,\"field\":", "invalid type"),
            ("\"field\":\"data\"", "\"fold\":\"data\"", "missing field `field`"),
            ("\"rms\":0.125,", "", "missing field `rms`"),
            ("0.5,0.625]", "0.5]", "invalid length 5"),
            ("0.5,0.625]", "0.5,0.625,1.0]", "trailing"),
            ("\"sample\":9891", "\"sample\":99999999", "without `world`"),
            ("\"reduced\":0.3", "\"reduced\":1e300", "without `max`"),
            ("\"dims\":[103,94,161],\"scalar", "\"dims\":[0,94,161],\"scalar", "without `world`"),
            ("[103,94,161],\"scalar", "[103,94,18446744073709551615],\"scalar", "without `samples`"),
            (",\"worst\":{\"sample\":9891,\"original\":0.1,\"reduced\":0.3}", "", "without `max`"),
        ] {
            let text = good.replacen(from, to, 1);
            assert_ne!(text, good, "{from}");
            let e = Manifest::of_json(text.as_bytes(), Path::new("m")).expect_err(to);
            assert!(e.to_string().contains(words), "{to}: {e}");
            assert!(!e.to_string().contains('\n') && e.exit_code() == 5, "{e}");
        }
    }

    #[test]
    fn every_flipped_byte_and_every_cut_is_found() {
        let path = Path::new(MANIFEST_NAME);
        let good = example().to_bytes();
        Manifest::parse(&good, path).unwrap();
        for i in 0..good.len() {
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[i] ^= 1 << bit;
                let e = Manifest::parse(&bad, path).expect_err("a flipped bit");
                assert!(e.exit_code() == 5 && !e.to_string().contains('\n'), "{e}");
            }
            assert!(Manifest::parse(&good[..i], path).is_err());
        }
        assert!(Manifest::parse(&[&good[..], b"0"].concat(), path).is_err(), "bytes behind it");
        // A kilobyte that would be a gigabyte.
        let large = pack_manifest(&" ".repeat(1 << 27));
        let e = Manifest::parse(&large, path).unwrap_err().to_string();
        assert!(e.contains("more than"), "{e}");
    }

    #[test]
    fn future_versions_and_other_files_are_refused_clearly() {
        let dir = tempfile::tempdir().unwrap();
        let refused = |words: &str| {
            let e = Manifest::read(dir.path()).unwrap_err().to_string();
            assert!(e.contains(words), "{e}");
        };
        refused("got an empty folder");
        std::fs::write(dir.path().join("notes.txt"), "mine").unwrap();
        refused("got a folder of other files");
        std::fs::create_dir(mesh_folder(dir.path())).unwrap();
        refused("not finished");
        let path = dir.path().join(MANIFEST_NAME);
        let write = |json: &str| std::fs::write(&path, pack_manifest(json)).unwrap();
        write(r#"{"format":"isospan archive","format_version":11,"oldest_reader":10,"new":[]}"#);
        let e = Manifest::read(dir.path()).unwrap_err().to_string();
        assert!(e.contains("got 11, for programs of format 10 on; use a newer isospan"), "{e}");
        write(r#"{"format":"isospan archive","format_version":5,"oldest_reader":5}"#);
        let e = Manifest::read(dir.path()).unwrap_err().to_string();
        assert!(e.contains("expected format 7 or later, got 5; an earlier isospan has made it"), "{e}");
        write("{}");
        refused("manifest of an isospan archive");
        std::fs::write(&path, "{}").unwrap();
        refused("manifest of an isospan archive");
    }

    #[test]
    fn hashes_cover_what_decides_the_bytes() {
        let (a, mut b) = (plan(), plan());
        b.block_tets += 1;
        assert_ne!(a.hash(), b.hash());
        let (s, mut moved) = (step_plan(0), step_plan(0));
        moved.source.path = "elsewhere".into();
        assert_eq!(s.hash(a.hash()), moved.hash(a.hash()));
        moved.source.fingerprint.push('1');
        assert_ne!(s.hash(a.hash()), moved.hash(a.hash()));
        assert_ne!(s.hash(a.hash()), s.hash(b.hash()));
        // Written archives depend on it: a change here is a change of the format.
        assert_eq!(a.hash().to_string(), "0119e72be6e68e0903ccf8d858f960c3");
    }

    #[test]
    fn bases_are_the_steps_before() {
        let path = Path::new("m");
        let mut m = example();
        let base = |m: &Manifest| BaseStep { number: 0, hash: m.steps[0].plan.hash(m.plan_hash) };
        m.steps[1].plan.base = Some(base(&m));
        m.check(path).unwrap();
        // Another base would give other values without any checksum being wrong.
        m.steps[0].plan.source.fingerprint.push('1');
        assert!(m.check(path).unwrap_err().to_string().contains("base of step 3"));
        m.steps[1].plan.base = Some(BaseStep { number: 1, ..base(&m) });
        assert!(m.check(path).is_err());
        m.steps[1].plan.base = None;
        m.steps[1].plan.time = Some(0.7);
        assert!(m.check(path).unwrap_err().to_string().contains("ascending times"));
    }

    #[test]
    fn chunks_must_be_covered_once() {
        let path = Path::new("m");
        let m = example();
        assert!(check_tiling(path, "mesh", &m.mesh, 5).is_ok());
        assert!(check_tiling(path, "mesh", &m.mesh, 6).is_err());
        assert!(check_tiling(path, "mesh", &m.mesh[1..], 5).is_err());
    }
}
