//! A bounded look at the samples before work begins: fill values, a constant field, outliers that
//! stretch the range, labels.
//!
//! At most [`BUDGET`] samples are read. In a volume with random access they are pieces of rows
//! spread evenly over it (all of a small volume). In a stream they come from its beginning, unless
//! it is read to the end anyway. The choice depends on the volume's size alone, so the same input
//! always gives the same findings.

use half::f16;
use isospan_io::cells::{CellField, CellMesh, Center};
use isospan_io::error::Result;
use isospan_io::grid::IndexBox;
use isospan_io::volume::{ScalarType, SlabStream, VolumeInfo, VolumeReader, VolumeSource};
use std::sync::{Arc, Mutex, PoisonError};

/// The most samples that are kept.
const BUDGET: u64 = 1 << 20;
/// Pieces that they are read in, where that is not the whole volume: a seek each.
const PIECES: u64 = 64;
/// The most samples of a stream that are decoded for a survey.
const STREAM_SAMPLES: u64 = 1 << 23;
/// The samples that a chunk counts as, at least: each is a file, or a request.
const CHUNK_SAMPLES: u64 = 1 << 10;
/// The least part of the samples that a fill value has.
const FILL_SHARE: f64 = 0.001;
/// The most values of a field of labels; and the number of values up to which a field of whole
/// numbers is one of labels for any neighbours.
const MOST_LABELS: usize = 256;
const FEW: usize = 5;

/// Values that programs write where they have no data.
const USUAL_FILLS: [f64; 32] = [
    -999.0,
    -999.25,
    -999.9,
    -9999.0,
    9999.0,
    -99_999.0,
    99_999.0,
    -999_999.0,
    -32_768.0,
    -32_767.0,
    32_767.0,
    65_535.0,
    -2_147_483_648.0,
    -2_147_483_647.0,
    2_147_483_647.0,
    4_294_967_295.0,
    -1e15,
    1e15,
    -1e20,
    1e20,
    -1e30,
    1e30,
    -1e31,
    1e31,
    -1e34,
    1e34,
    -1e35,
    1e35,
    -9.969_209_968_386_869e36,
    9.969_209_968_386_869e36,
    -3.402_823_466_385_288_6e38,
    3.402_823_466_385_288_6e38,
];
/// Values that scanners write outside of their field of view.
const CT_PADDING: [f64; 4] = [-2000.0, -2048.0, -3024.0, -3072.0];

/// Which samples a survey has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::pipeline) enum Seen {
    /// All of them.
    All,
    /// Some, spread over the volume.
    Spread,
    /// This many samples from the beginning.
    First(u64),
}

/// A value that many samples have exactly, far from all others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::pipeline) struct Fill {
    pub(in crate::pipeline) value: f64,
    /// The part of the finite samples that have it.
    pub(in crate::pipeline) share: f64,
    /// Least and largest of the others.
    pub(in crate::pipeline) others: [f64; 2],
}

/// A few samples far from all others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::pipeline) struct Stretch {
    /// How many.
    pub(in crate::pipeline) count: u64,
    pub(in crate::pipeline) of: u64,
    /// Their value, where they have but one; else the farthest.
    pub(in crate::pipeline) value: f64,
    pub(in crate::pipeline) is_one_value: bool,
    /// Least and largest of the others.
    pub(in crate::pipeline) others: [f64; 2],
}

/// What the samples show.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::pipeline) struct Found {
    pub(in crate::pipeline) fills: Vec<Fill>,
    /// The value of all samples, fill values apart.
    pub(in crate::pipeline) constant: Option<f64>,
    pub(in crate::pipeline) stretch: Option<Stretch>,
    /// Number, least and largest of the values of labels.
    pub(in crate::pipeline) labels: Option<(u64, [f64; 2])>,
}

/// Some samples of a field.
#[derive(Debug)]
pub(in crate::pipeline) struct Survey {
    pub(in crate::pipeline) seen: Seen,
    /// Finite values.
    values: Vec<f64>,
    /// Whether they may be labels.
    is_grid: bool,
    /// Whether values are f32 when they are used.
    is_single: bool,
    /// Slope and intercept of the stored numbers.
    scaling: [f64; 2],
    /// Neighbours along a row that are both finite: equal ones, and those that differ by more than
    /// 1, by at most that.
    pairs: [u64; 3],
}

impl Survey {
    fn new(seen: Seen, is_grid: bool, is_single: bool) -> Self {
        Self { seen, values: vec![], is_grid, is_single, scaling: [1.0, 0.0], pairs: [0; 3] }
    }

    /// Of a volume.
    fn of(info: &VolumeInfo, budget: u64) -> Self {
        let scaling = [info.slope, info.intercept];
        let is_single =
            matches!(info.field.scalar, ScalarType::F16 | ScalarType::F32) || scaling != [1.0, 0.0];
        Self { scaling, ..Self::new(seen(info.dims, budget), true, is_single) }
    }

    /// Adds neighbouring samples of a row.
    fn add(&mut self, row: &[f64]) {
        for pair in row.windows(2) {
            let jump = (pair[1] - pair[0]).abs();
            if jump.is_finite() {
                self.pairs[if jump == 0.0 { 0 } else { 2 - usize::from(jump > 1.0) }] += 1;
            }
        }
        // Only one of two zeros of different sign is kept.
        self.values.extend(row.iter().filter(|v| v.is_finite()).map(|v| v + 0.0));
    }

    /// What the samples show, where the value `missing` means no data.
    pub(in crate::pipeline) fn found(self, missing: Option<f64>) -> Found {
        let is_single = self.is_single;
        // The shortest numbers that mean the same samples, as they are typed.
        let in_file = |v: f64| if is_single { (v as f32).to_string().parse().unwrap_or(v) } else { v };
        let found = self.found_exactly(missing);
        Found {
            fills: found
                .fills
                .into_iter()
                .map(|f| Fill { value: in_file(f.value), others: f.others.map(in_file), ..f })
                .collect(),
            constant: found.constant.map(in_file),
            stretch: found.stretch.map(|s| Stretch {
                value: in_file(s.value),
                others: s.others.map(in_file),
                ..s
            }),
            labels: found.labels,
        }
    }

    fn found_exactly(mut self, missing: Option<f64>) -> Found {
        // A reduction compares values as f32 too.
        let missing = missing.map(|m| m as f32);
        self.values.retain(|v| Some(*v as f32) != missing);
        self.values.sort_unstable_by(f64::total_cmp);
        let runs: Vec<Run> = self.values.chunk_by(|a, b| a == b).map(|c| (c[0], c.len() as u64)).collect();
        let mut rest = &runs[..];
        let mut found = Found::default();
        while found.fills.len() < 4
            && let Some((fill, others)) = self.fill(rest)
        {
            found.fills.push(fill);
            rest = others;
        }
        found.fills.iter_mut().for_each(|fill| fill.others = ends(rest));
        // The first samples of a stream say nothing about those that follow.
        if rest.is_empty() || matches!(self.seen, Seen::First(_)) {
            return found;
        }
        found.constant = (rest.len() == 1).then_some(rest[0].0);
        found.stretch = stretch(rest);
        if found.constant.is_none() && self.is_of_labels(rest) {
            found.labels = Some((rest.len() as u64, ends(rest)));
        }
        found
    }

    /// The least or the largest value, if it is a fill value, and the others.
    fn fill<'a>(&self, runs: &'a [Run]) -> Option<(Fill, &'a [Run])> {
        let (first, last) = (runs.split_first()?, runs.split_last()?);
        [first, last].into_iter().find_map(|(&(value, count), others)| {
            let share = count as f64 / self.values.len() as f64;
            let is_fill = !others.is_empty() && self.is_fill(value, share, others);
            is_fill.then(|| (Fill { value, share, others: ends(others) }, others))
        })
    }

    fn is_fill(&self, v: f64, share: f64, others: &[Run]) -> bool {
        if share < FILL_SHARE || share * (self.values.len() as f64) < 4.0 {
            return false;
        }
        let [lo, hi] = ends(others);
        let width = hi - lo;
        let gap = (lo - v).max(v - hi);
        let [slope, intercept] = self.scaling;
        let stored = (v - intercept) / slope;
        let is_near = |a: f64, b: f64| (a - b).abs() <= 1e-6 * b.abs();
        let is_one_of = |known: &[f64]| {
            known
                .iter()
                .any(|&k| v as f32 == k as f32 || (slope, intercept) != (1.0, 0.0) && is_near(stored, k))
        };
        let is_usual = is_one_of(&USUAL_FILLS) && gap >= 500.0 * slope.abs().min(1.0);
        // A peak at a usual value behind a gap is one; any other value must lie farther off than
        // data do.
        is_usual && (gap >= width / 2.0 || share >= 0.01 && gap >= width / 20.0)
            || is_one_of(&CT_PADDING) && share >= 0.01 && gap >= 200.0 && others.len() >= 200
            || others.len() >= 32 && gap >= 10.0 * width
    }

    /// Whether values are the names of parts: few whole numbers, in runs of equal ones, next to any
    /// others.
    fn is_of_labels(&self, runs: &[Run]) -> bool {
        let [equal, jumps, steps] = self.pairs;
        let is_whole = runs.len() <= MOST_LABELS && runs.iter().all(|(v, _)| v.fract() == 0.0);
        let different = jumps + steps;
        let [all, most] =
            [runs.iter().map(|r| r.1).sum::<u64>(), runs.iter().map(|r| r.1).max().unwrap_or(0)];
        // The noise of an image jumps too, but its runs are short, and so are those of few grey
        // levels.
        self.is_grid
            && is_whole
            && equal >= 4 * different
            // A few samples in an empty field are a source, not a part.
            && (all - most) * 1000 >= all
            && (runs.len() <= FEW || jumps > steps && different > 0)
    }
}

/// A value, and how many samples have it.
type Run = (f64, u64);

fn ends(runs: &[Run]) -> [f64; 2] {
    [runs[0].0, runs[runs.len() - 1].0]
}

/// Outliers: at most a thousandth of the samples, without which the range is less than a hundredth.
fn stretch(runs: &[Run]) -> Option<Stretch> {
    let width = |runs: &[Run]| ends(runs)[1] - ends(runs)[0];
    let number = |runs: &[Run]| runs.iter().map(|r| r.1).sum::<u64>();
    let of = number(runs);
    let (mut rest, mut out) = (runs, vec![]);
    // Outliers may lie on both sides.
    while out.len() < 4 && rest.len() > 1 {
        let gap = |i: &usize| rest[*i].0 - rest[*i - 1].0;
        let at = (1..rest.len()).max_by(|a, b| gap(a).total_cmp(&gap(b)))?;
        let (below, above) = rest.split_at(at);
        let (few, most) = if number(below) < number(above) { (below, above) } else { (above, below) };
        if gap(&at) < 0.25 * width(rest) || number(few) * 1000 > of.max(1000) {
            break;
        }
        out.push(few);
        rest = most;
    }
    let far = out.first()?;
    let is_stretched = rest.len() >= 16 && width(runs) >= 100.0 * width(rest);
    let is_above = far[0].0 > rest[0].0;
    is_stretched.then(|| Stretch {
        count: out.iter().map(|few| number(few)).sum(),
        of,
        value: ends(far)[usize::from(is_above)],
        is_one_value: out.len() == 1 && far.len() == 1,
        others: ends(rest),
    })
}

/// The boxes that are read in a volume of these dimensions: each is a piece of a row, a piece of a
/// slice, or whole slices.
fn pieces(dims: [u64; 3], budget: u64) -> Vec<IndexBox> {
    let [x, y, z] = dims;
    let slice = x.saturating_mul(y);
    if dims.contains(&0) {
        return vec![];
    }
    let total = slice.saturating_mul(z);
    if total <= budget {
        let slices = (BUDGET / PIECES / slice).max(1);
        let from = (0..z).step_by(slices as usize);
        return from.map(|a| IndexBox { lo: [0, 0, a], hi: [x, y, z.min(a + slices)] }).collect();
    }
    let each = (budget / PIECES).max(1);
    let size = [each.min(x), (each / x).clamp(1, y), (each / slice).clamp(1, z)];
    // Along z evenly; along y and x by the golden ratio and its square, which leave no large part
    // out.
    let golden = |i: u64, ratio: f64, room: u64| ((i as f64 * ratio).fract() * (room + 1) as f64) as u64;
    let mut out: Vec<IndexBox> = (0..PIECES)
        .map(|i| {
            let lo = [
                golden(i, 0.754_877_666_246_693, x - size[0]),
                golden(i, 0.618_033_988_749_895, y - size[1]),
                (u128::from(z - size[2]) * u128::from(i) / u128::from(PIECES - 1)) as u64,
            ];
            IndexBox { lo, hi: std::array::from_fn(|a| lo[a] + size[a]) }
        })
        .collect();
    out.dedup();
    out
}

/// How values are made from stored samples. They are `f64` here, because `f32` cannot distinguish
/// all samples of wide types.
#[derive(Clone, Copy, Debug)]
struct Stored {
    scalar: ScalarType,
    slope: f64,
    intercept: f64,
    missing: Option<f64>,
}

impl Stored {
    fn of(info: &VolumeInfo) -> Self {
        let VolumeInfo { slope, intercept, missing, .. } = *info;
        Self { scalar: info.field.scalar, slope, intercept, missing }
    }

    /// Puts the values of a row of little-endian samples into `out`; NaN where they are declared
    /// missing.
    fn values(&self, bytes: &[u8], out: &mut Vec<f64>) {
        let Self { scalar, slope, intercept, missing } = *self;
        let missing = missing.map(|m| scalar.rounded(m));
        out.clear();
        macro_rules! row {
            ($t:ty) => {
                row!($t, |v| v as f64)
            };
            ($t:ty, $number:expr) => {
                out.extend(bytes.as_chunks().0.iter().map(|b| {
                    let v: f64 = $number(<$t>::from_le_bytes(*b));
                    if Some(v) == missing { f64::NAN } else { slope * v + intercept }
                }))
            };
        }
        match scalar {
            ScalarType::U8 => row!(u8),
            ScalarType::I8 => row!(i8),
            ScalarType::U16 => row!(u16),
            ScalarType::I16 => row!(i16),
            ScalarType::U32 => row!(u32),
            ScalarType::I32 => row!(i32),
            ScalarType::U64 => row!(u64),
            ScalarType::I64 => row!(i64),
            ScalarType::F16 => row!(f16, f64::from),
            ScalarType::F32 => row!(f32),
            ScalarType::F64 => row!(f64),
        }
    }
}

fn seen(dims: [u64; 3], budget: u64) -> Seen {
    let total = dims.iter().fold(1u64, |n, &d| n.saturating_mul(d));
    if total <= budget { Seen::All } else { Seen::Spread }
}

/// Surveys at most `budget` samples of a volume, and at most [`BUDGET`]; a stream is decoded only
/// as far as needed.
///
/// # Errors
/// Those of reading them.
pub(in crate::pipeline) fn survey_volume(source: VolumeSource, budget: u64) -> Result<Survey> {
    let budget = budget.min(BUDGET);
    match source {
        VolumeSource::Random(reader) => survey_reader(&*reader, budget),
        other => {
            let chunk = match &other {
                VolumeSource::Chunked(chunks) => Some(chunks.chunk_dims()),
                _ => None,
            };
            let mut stream = other.into_stream();
            let mut watch = Watch::new(stream.info(), budget);
            let (mut bytes, mut done, mut work) = (vec![], 0, 0u64);
            while work < STREAM_SAMPLES
                && let Some(slab) = stream.next_slab(&mut bytes)?
            {
                let samples = slab.len() as u64;
                let chunks = chunk.map_or(0, |chunk| chunks_of(slab, chunk));
                done += samples;
                work = work.saturating_add(samples.max(chunks.saturating_mul(CHUNK_SAMPLES)));
                watch.see(slab, &bytes);
            }
            let total = stream.info().dims.iter().product::<u64>();
            if done < total {
                watch.survey.seen = Seen::First(done);
            }
            Ok(watch.survey)
        }
    }
}

/// How many chunks of a size a slab has.
fn chunks_of(slab: IndexBox, chunk: [u64; 3]) -> u64 {
    slab.dims().iter().zip(chunk).fold(1, |n, (&d, c)| n.saturating_mul(d.div_ceil(c.max(1))))
}

fn survey_reader(reader: &dyn VolumeReader, budget: u64) -> Result<Survey> {
    let info = reader.stored_info();
    let mut survey = Survey::of(&info, budget);
    let (stored, mut bytes, mut row) = (Stored::of(&info), vec![], vec![]);
    for piece in pieces(info.dims, budget) {
        bytes.resize(piece.len() * stored.scalar.bytes(), 0);
        reader.read_stored(piece, &mut bytes)?;
        for samples in bytes.chunks(piece.dims()[0] as usize * stored.scalar.bytes()) {
            stored.values(samples, &mut row);
            survey.add(&row);
        }
    }
    Ok(survey)
}

/// A volume that is read to its end, and the survey that is made meanwhile.
///
/// # Errors
/// Those of reading a volume with random access, which is looked at first.
pub(in crate::pipeline) fn watched(source: VolumeSource) -> Result<(VolumeSource, Watched)> {
    Ok(match source {
        VolumeSource::Random(reader) => {
            let survey = survey_reader(&*reader, BUDGET)?;
            (VolumeSource::Random(reader), Watched::Done(survey))
        }
        other => {
            let stream = other.into_stream();
            let watch = Arc::new(Mutex::new(Watch::new(stream.info(), BUDGET)));
            let seeing = Box::new(Seeing { stream, watch: Arc::clone(&watch) });
            (VolumeSource::Stream(seeing), Watched::Reading(watch))
        }
    })
}

/// The survey of a volume that is being read.
pub(in crate::pipeline) enum Watched {
    Done(Survey),
    Reading(Arc<Mutex<Watch>>),
}

impl Watched {
    /// The survey, when the volume was read.
    pub(in crate::pipeline) fn survey(self) -> Survey {
        match self {
            Self::Done(survey) => survey,
            Self::Reading(watch) => {
                let mut watch = watch.lock().unwrap_or_else(PoisonError::into_inner);
                let empty = Survey::new(Seen::All, false, false);
                std::mem::replace(&mut watch.survey, empty)
            }
        }
    }
}

/// What is kept from the slabs of a stream.
pub(in crate::pipeline) struct Watch {
    survey: Survey,
    pieces: Vec<IndexBox>,
    stored: Stored,
}

impl Watch {
    fn new(info: &VolumeInfo, budget: u64) -> Self {
        Self { survey: Survey::of(info, budget), pieces: pieces(info.dims, budget), stored: Stored::of(info) }
    }

    fn see(&mut self, slab: IndexBox, bytes: &[u8]) {
        let ([sx, sy, _], size) = (slab.dims(), self.stored.scalar.bytes());
        let mut row = vec![];
        for piece in &self.pieces {
            let lo: [u64; 3] = std::array::from_fn(|a| piece.lo[a].max(slab.lo[a]));
            let hi: [u64; 3] = std::array::from_fn(|a| piece.hi[a].min(slab.hi[a]));
            if (IndexBox { lo, hi }).is_empty() {
                continue;
            }
            let n = (hi[0] - lo[0]) as usize;
            for z in lo[2]..hi[2] {
                for y in lo[1]..hi[1] {
                    let at = ((z - slab.lo[2]) * sy + y - slab.lo[1]) * sx + lo[0] - slab.lo[0];
                    let from = at as usize * size;
                    self.stored.values(&bytes[from..from + n * size], &mut row);
                    self.survey.add(&row);
                }
            }
        }
    }
}

/// A stream that shows its slabs to a survey.
struct Seeing {
    stream: Box<dyn SlabStream>,
    watch: Arc<Mutex<Watch>>,
}

impl SlabStream for Seeing {
    fn info(&self) -> &VolumeInfo {
        self.stream.info()
    }

    fn working_bytes(&self) -> u64 {
        self.stream.working_bytes()
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        let slab = self.stream.next_slab(out)?;
        if let Some(slab) = slab {
            self.watch.lock().unwrap_or_else(PoisonError::into_inner).see(slab, out);
        }
        Ok(slab)
    }
}

/// Surveys the first values of a mesh's field, as they are stored: averages of cell data would hide
/// what is searched for.
///
/// # Errors
/// Those of [`CellMesh::field`]; when the file cannot be read.
pub(in crate::pipeline) fn survey_mesh(mesh: &CellMesh) -> Result<Survey> {
    let (info, field) = (mesh.info(), mesh.field()?);
    let mut survey = Survey::new(Seen::All, false, field.scalar == ScalarType::F32);
    let is_stored = |f: &CellField| f.center == field.center && f.name == field.name && f.components == 1;
    match info.fields.iter().position(is_stored) {
        Some(index) => {
            let (mut values, mut block) = (mesh.stored(index)?, vec![]);
            while !survey.is_full() && values.next_block(&mut block)? {
                survey.add(&block);
            }
        }
        // A component or a magnitude of cell data is not stored separately, and averaging needs all
        // cells.
        None if field.center == Center::Cell => {}
        None => {
            let (mut values, mut block) = (mesh.values(BUDGET, |_| false)?, vec![]);
            while !survey.is_full() && values.next_block(&mut block)? {
                survey.add(&block);
            }
        }
    }
    Ok(survey)
}

impl Survey {
    /// Whether a mesh's values are as many as are kept: the rest is not read.
    fn is_full(&mut self) -> bool {
        let n = self.values.len() as u64;
        if n >= BUDGET {
            self.seen = Seen::First(n);
        }
        n >= BUDGET
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan_io::formats::{OpenOptions, RawLayout};
    use isospan_io::volume::chunked::DecodeCount;

    /// What is found in rows that hold all samples.
    fn found(rows: &[Vec<f64>]) -> Found {
        let mut survey = Survey::new(Seen::All, true, false);
        rows.iter().for_each(|row| survey.add(row));
        survey.found(None)
    }

    /// Rows of a smooth field between two values.
    fn waves(lo: f64, hi: f64) -> Vec<Vec<f64>> {
        let wave = |i: usize| lo + (hi - lo) * (0.5 + 0.5 * (i as f64 * 0.01).sin());
        (0..40).map(|r| (0..200).map(|i| wave(r * 17 + i)).collect()).collect()
    }

    fn with(mut rows: Vec<Vec<f64>>, every: usize, value: f64) -> Vec<Vec<f64>> {
        rows.iter_mut().flatten().step_by(every).for_each(|v| *v = value);
        rows
    }

    #[test]
    fn ordinary_fields_are_silent() {
        assert_eq!(found(&waves(0.0, 1.0)), Found::default());
        // Air as 0; a clipped top; noise in whole numbers; a narrow peak.
        assert_eq!(found(&with(waves(0.0, 1300.0), 3, 0.0)), Found::default());
        assert_eq!(found(&with(waves(0.0, 4095.0), 5, 4095.0)), Found::default());
        let noise = |n: u32| (n.wrapping_mul(2_654_435_761) >> 20) as f64 % 100.0;
        assert_eq!(found(&[(0..5000).map(noise).collect()]), Found::default());
        let peak = |i: usize| (-((i as f64 - 2500.0) / 20.0).powi(2)).exp() * 1e6;
        assert_eq!(found(&[(0..5000).map(peak).collect()]), Found::default());
        // A background far below the masked data, as of a brain without its head.
        assert_eq!(found(&with(waves(200.0, 1000.0), 2, 0.0)), Found::default());
    }

    #[test]
    fn fill_values_are_found() {
        let values = [
            -1e34,
            1e20,
            9.969_209_968_386_869e36,
            -9999.0,
            -999.0,
            -32768.0,
            f32::MAX.into(),
            f32::MIN.into(),
        ];
        for value in values {
            let fills = found(&with(waves(-30.0, 40.0), 2, value)).fills;
            assert_eq!(fills.len(), 1, "{value}");
            assert_eq!((fills[0].value, fills[0].share), (value, 0.5), "{value}");
            assert!(fills[0].others[0] >= -30.0 && fills[0].others[1] <= 40.0, "{value}");
        }
        // No usual value, but far from all others.
        assert_eq!(found(&with(waves(101_300.0, 101_400.0), 9, 0.0)).fills[0].value, 0.0);
        assert_eq!(found(&with(waves(278.0, 298.0), 9, 0.0)).fills[0].value, 0.0);
        // Padding around a CT's field of view, below air.
        assert_eq!(found(&with(waves(-1024.0, 3071.0), 4, -2000.0)).fills[0].value, -2000.0);
        // Two of them.
        let both = with(with(waves(0.0, 1.0), 2, 1e20), 3, -9999.0);
        assert_eq!(found(&both).fills.iter().map(|f| f.value).collect::<Vec<_>>(), [1e20, -9999.0]);
        assert!(found(&both).fills.iter().all(|f| f.others[1] <= 1.0));
        // Samples that are equal only as f32 are no constant.
        assert_eq!(found(&waves(101_325_000.0, 101_325_003.0)), Found::default());
        // A value that is declared to be missing already.
        let mut survey = Survey::new(Seen::All, true, false);
        with(waves(0.0, 1.0), 2, 1e20).iter().for_each(|row| survey.add(row));
        assert_eq!(survey.found(Some(1e20)), Found::default());
        // Stored as -32768, of a scaled volume.
        let mut survey = Survey { scaling: [0.01, 5.0], ..Survey::new(Seen::All, true, true) };
        with(waves(-20.0, 30.0), 2, -322.68).iter().for_each(|row| survey.add(row));
        assert_eq!(survey.found(None).fills[0].value, -322.68);
    }

    #[test]
    fn constants_and_outliers_are_found() {
        assert_eq!(found(&[vec![5.0; 100]]).constant, Some(5.0));
        let mut rows = waves(0.0, 1.0);
        (rows[3][3], rows[7][9]) = (1e6, 1e6);
        let stretch = found(&rows).stretch.unwrap();
        assert_eq!((stretch.count, stretch.of, stretch.value, stretch.is_one_value), (2, 8000, 1e6, true));
        assert!(stretch.others[1] <= 1.0);
        // On both sides, with different values.
        (rows[3][3], rows[7][9]) = (1e6, -1e6);
        let stretch = found(&rows).stretch.unwrap();
        assert_eq!((stretch.count, stretch.is_one_value), (2, false));
    }

    #[test]
    fn labels_are_found() {
        let labels = |names: &[f64], run: usize| {
            let row: Vec<f64> = (0..3000).map(|i| names[i / run * 7 % names.len()]).collect();
            found(&[row])
        };
        assert_eq!(labels(&[0.0, 1.0], 50).labels, Some((2, [0.0, 1.0])));
        assert_eq!(labels(&[0.0, 1.0, 2.0, 3.0, 4.0], 20).labels, Some((5, [0.0, 4.0])));
        let many: Vec<f64> = (0..100).map(|i| (i * 11 % 2035) as f64).collect();
        assert_eq!(labels(&many, 12).labels.map(|l| l.0), Some(100));
        // Grey levels: runs, but steps of 1.
        let grey: Vec<f64> = (0..3000).map(|i| (i / 30) as f64).collect();
        assert_eq!(found(&[grey]), Found::default());
        assert_eq!(labels(&[0.0, 0.5, 1.0], 50).labels, None);
        let levels: Vec<f64> = (0..3000).map(|i| (i / 300) as f64).collect();
        assert_eq!(found(&[levels]), Found::default());
        let mut source = vec![0.0; 3000];
        source[1500] = 7.0;
        assert_eq!(found(&[source]), Found::default());
    }

    /// A stream that is read to its end shows the samples that random access has. Of any other
    /// stream, only the first samples are known.
    #[test]
    fn streams_show_the_same_samples() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("v.raw");
        for (dims, is_long) in [([90, 80, 70], false), ([200, 150, 100], false), ([200, 210, 250], true)] {
            let n = dims.iter().product::<u64>() as usize;
            std::fs::write(&path, (0..n).map(|i| (i / 777 % 251) as u8).collect::<Vec<_>>()).unwrap();
            let layout = RawLayout { dims, scalar: ScalarType::U8, big_endian: false, offset: 0 };
            let options = OpenOptions { raw: Some(layout), ..OpenOptions::default() };
            let open = || isospan_io::formats::open_volume(&path, &options).unwrap();
            let sorted = |mut s: Survey| {
                s.values.sort_unstable_by(f64::total_cmp);
                (s.values, s.pairs)
            };
            let random = survey_volume(open(), BUDGET).unwrap();
            assert_eq!(random.seen, if n as u64 <= BUDGET { Seen::All } else { Seen::Spread });
            let random = sorted(random);
            let (source, watch) = watched(VolumeSource::Stream(open().into_stream())).unwrap();
            super::super::scan(source).unwrap();
            assert!(sorted(watch.survey()) == random, "{dims:?}");
            let stream = survey_volume(VolumeSource::Stream(open().into_stream()), BUDGET).unwrap();
            match stream.seen {
                Seen::First(m) => assert!(is_long && m >= STREAM_SAMPLES && m < n as u64, "{m}"),
                _ => assert!(!is_long && sorted(stream) == random, "{dims:?}"),
            }
        }
    }

    /// Chunks of one sample each, of which there is no file: each is looked for.
    #[test]
    fn few_of_many_small_chunks_are_opened() {
        let dir = tempfile::tempdir().unwrap();
        let array = r#"{"zarr_format": 2, "shape": [1000, 1000, 1000], "chunks": [1, 1, 1], "dtype": "|u1",
            "compressor": null, "filters": null, "fill_value": 0, "order": "C"}"#;
        std::fs::write(dir.path().join(".zarray"), array).unwrap();
        let source = isospan_io::formats::open_volume(dir.path(), &OpenOptions::default()).unwrap();
        let VolumeSource::Chunked(chunks) = source else { panic!("chunks") };
        let count = DecodeCount::default();
        let survey = survey_volume(VolumeSource::Chunked(count.counting(chunks)), BUDGET).unwrap();
        let most = STREAM_SAMPLES / CHUNK_SAMPLES;
        assert!((1..=2 * most).contains(&count.decodes()), "{}", count.decodes());
        assert!(matches!(survey.seen, Seen::First(_)));
    }

    #[test]
    fn pieces_are_bounded_and_spread() {
        for dims in [[100, 100, 50], [512, 512, 512], [100_000, 9, 900], [2, 2, 10_000_000], [1 << 30, 1, 1]]
        {
            let boxes = pieces(dims, BUDGET);
            let total: u64 = boxes.iter().map(|b| b.len() as u64).sum();
            assert!(
                total <= BUDGET + (1 << 14) && total >= BUDGET.min(dims.iter().product()) / 2,
                "{dims:?}"
            );
            assert!(
                boxes.iter().all(|b| (0..3).all(|a| b.lo[a] < b.hi[a] && b.hi[a] <= dims[a])),
                "{dims:?}"
            );
            assert_eq!(boxes.iter().map(|b| b.hi[2]).max(), Some(dims[2]), "{dims:?}");
        }
        assert_eq!(pieces([0, 4, 4], BUDGET), []);
    }
}
