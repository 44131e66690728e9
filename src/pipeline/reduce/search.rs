//! The search for the number of points that has a wanted error or size: which try comes next.
//!
//! ```text
//!  settings ─▶ next_settings ─▶ a reduction ─▶ its report ─▶ note ─▶ next_settings ─▶ … until it is over
//! ```
//!
//! It knows nothing of how a try is made: one process makes all ([`super::target`]), or shards do,
//! with a plan for each ([`super::plan_file`]), which stores the search between two tries.

use super::report::{ReduceReport, TargetReport};
use crate::archive::values::NodeCoder;
use crate::error::{Error, Result};
use crate::pipeline::plan::{Estimate, SearchEstimate};
use crate::pipeline::settings::{Amount, Bound, ReduceSettings, Target, ValueBits};
use crate::points::SetKind;
use crate::sample::Values;
use serde::{Deserialize, Serialize};

impl Target {
    /// The bound, in units of the field or in bytes: any try tells the range of the samples.
    pub(super) fn limit(self, report: &ReduceReport, source: Option<u64>) -> Result<f64> {
        match self {
            Self::Rms(bound) | Self::Max(bound) => {
                Ok(bound.in_units(source_range(report).unwrap_or_default()))
            }
            Self::Lossless => Ok(0.0),
            Self::Size(_) | Self::Ratio(_) => self.bytes(source),
        }
    }

    /// The bytes that an archive may have.
    pub(super) fn bytes(self, source: Option<u64>) -> Result<f64> {
        match (self, source) {
            (Self::Size(bytes), _) => Ok(bytes as f64),
            (Self::Ratio(ratio), Some(source)) => Ok(source as f64 / ratio),
            (Self::Ratio(_), None) => Err(Error::usage("the bytes of the source are not known: give a size")),
            (Self::Rms(_) | Self::Max(_) | Self::Lossless, _) => Ok(f64::INFINITY),
        }
    }

    /// What an archive came to that was made before, in no try of this run.
    pub(super) fn report_of(
        self,
        report: &ReduceReport,
        source: Option<u64>,
        full_cells: Option<[u64; 2]>,
    ) -> Result<TargetReport> {
        let bound = self.limit(report, source)?;
        let reached = match self.bound() {
            None if self != Self::Lossless => report.archive_bytes as f64,
            _ => self.reached(report),
        };
        let met = reached <= bound;
        Ok(TargetReport {
            target: self,
            bound,
            reached,
            met,
            tries: 0,
            of_ranges: self.bound().is_some() && report.of_fields,
            meshed_chunks: [0; 2],
            full_cells,
        })
    }

    /// The error or the size that an archive has; with several steps, that of the worst one.
    fn reached(self, report: &ReduceReport) -> f64 {
        match self {
            Self::Rms(_) | Self::Max(_) | Self::Lossless => error_of(self, report),
            Self::Size(_) | Self::Ratio(_) => (report.archive_bytes + RECORD) as f64,
        }
    }
}

impl ReduceReport {
    /// The report with what its steps have of an error that is wanted, which was no target of the
    /// run: of `append`, whose points are there already.
    pub fn judged_by(self, target: Target) -> Self {
        let target = target.report_of(&self, None, None).ok();
        let is_measured = self.steps.iter().any(|step| step.error.is_some());
        let judged = target.filter(|found| is_measured && found.target.bound().is_some());
        Self { target: judged.or(self.target), ..self }
    }
}

/// An archive has hardly ever fewer bytes: its manifest takes these.
const LEAST_BYTES: u64 = 4 << 10;
/// Bytes of the manifest that state the target, at most.
const RECORD: u64 = 64;

/// The range of the samples of all steps. Errors of several fields are parts of the range of each.
fn source_range(report: &ReduceReport) -> Option<[f64; 2]> {
    if report.of_fields { Some([0.0, 1.0]) } else { report.source_range }
}

/// Tries, at most.
const MOST_TRIES: u32 = 10;
/// The aim of a try, as a part of the bound; and the part that is good enough.
const AIM: f64 = 0.985;
const NEAR: f64 = 0.96;
/// Tries of most searches.
const USUAL_TRIES: u32 = 5;
/// A number of points that is this close to one that does not suffice is the least.
const LEAST_STEP: f64 = 1.03;

/// A try: the number of points, or of samples a point where a size is wanted, and the error or the
/// size with it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Try {
    amount: f64,
    reached: f64,
}

/// The tries so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Search {
    bound: f64,
    /// The amount is not less than the first of these, and not more than the second.
    limits: [f64; 2],
    /// The part of the bound that is good enough.
    near: f64,
    /// The bounded quantity is about the amount to the negative of this power.
    usual: f64,
    tries: Vec<Try>,
}

impl Search {
    /// The largest number that does not do, and the smallest that does.
    fn bracket(&self) -> [Option<Try>; 2] {
        let by_amount = |a: &&Try, b: &&Try| a.amount.total_cmp(&b.amount);
        let does = self.tries.iter().filter(|t| t.reached <= self.bound).min_by(by_amount).copied();
        let below = |t: &&Try| t.reached > self.bound && does.is_none_or(|d| t.amount < d.amount);
        [self.tries.iter().filter(below).max_by(by_amount).copied(), does]
    }

    /// The next amount; `None` when the best one is found.
    fn next(&self) -> Option<f64> {
        let [least, cap] = self.limits;
        let [low, high] = self.bracket();
        if self.tries.len() as u32 >= MOST_TRIES && (high.is_some() || low.is_some_and(|l| l.amount >= cap)) {
            return None;
        }
        let amount = match (low, high) {
            (_, Some(h)) if h.reached >= self.near * self.bound => return None,
            (Some(l), Some(h)) if h.amount <= LEAST_STEP * l.amount => return None,
            (Some(l), Some(h)) => {
                let step = libm::sqrt(LEAST_STEP);
                self.aimed(l).clamp(l.amount * step, (h.amount / step).max(l.amount * step))
            }
            (Some(l), None) if l.amount >= cap => return None,
            // After many tries all that is possible.
            (Some(l), None) if self.tries.len() as u32 + 1 >= MOST_TRIES => cap.max(l.amount),
            (Some(l), None) => self.aimed(l).clamp(l.amount * 1.05, l.amount * 8.0),
            (None, Some(h)) if h.amount <= least => return None,
            (None, Some(h)) => self.aimed(h).clamp(h.amount / 8.0, h.amount * 0.95),
            (None, None) => return None,
        };
        Some(amount.clamp(least, cap))
    }

    /// The amount at which the power law through a try has what is aimed at.
    fn aimed(&self, from: Try) -> f64 {
        let others = self.tries.iter().filter(|t| t.amount != from.amount && t.reached > 0.0);
        let distance = |t: &&Try| libm::fabs(libm::log(t.amount / from.amount));
        let nearest = others.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let power = nearest.map_or(self.usual, |t| {
            let power = -libm::log(t.reached / from.reached) / libm::log(t.amount / from.amount);
            if power.is_finite() { power.clamp(0.1, 2.0) } else { self.usual }
        });
        if from.reached <= 0.0 {
            return from.amount / 8.0;
        }
        from.amount * libm::pow(from.reached / (AIM * self.bound), 1.0 / power)
    }
}

/// The powers between errors and numbers of points, and between sizes and samples a point: archives
/// have a manifest besides.
const USUAL_POWERS: [f64; 2] = [0.5, 0.9];

/// The same of a pyramid: the powers between errors and finer steps, and sizes and coarser ones.
const USUAL_POWERS_OF_STEPS: [f64; 2] = [0.8, 0.9];
/// How many times coarser or finer the steps of a pyramid are than at first, at most.
const LIMITS_OF_FACTORS: [f64; 2] = [1e-5, 1e5];
/// A pyramid is made again only for more than this.
const NEAR_OF_PYRAMIDS: f64 = 0.93;

/// A lattice's values are rounded to a step of this many times the RMS error. Twice that is tried
/// where a value takes fewer than `FEW_BITS`: then most of them are as predicted, and less off than
/// a step has it.
const STEP: f64 = 1.4;
const FEW_BITS: f64 = 1.8;
/// They have this many bits while nothing is known about the error, and bits in this range
/// otherwise.
const USUAL_BITS: f64 = 6.0;
const BITS: [f64; 2] = [4.0, 16.0];
/// Points a sample where a size is wanted, at most.
const MOST_A_SAMPLE: f64 = 4.0;

/// The bits of values of the tries.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Rounding {
    /// Whether they are chosen here.
    is_chosen: bool,
    bits: ValueBits,
    /// Tries whose results have been used to choose the bits.
    learned: u32,
    /// Whether a bit less is tried, since a value took few.
    few: bool,
}

/// A lattice with a node at each sample is tried where fewer points do not meet an error, or take
/// more bits a sample than this: noise, which has no shape that fewer points could follow.
const MANY_BITS: f64 = 0.15;
/// The search for its step ends where it takes this many times more bytes than another archive.
const MANY_TIMES: f64 = 1.3;
/// Its error is this part of that of rounding alone, since predictions are nearer than that.
const OF_ROUNDING: f64 = 0.75;
/// The power between the error and the steps of the range.
const POWER_OF_STEPS: f64 = 0.9;

/// Whether a search is one for a lattice. Complete settings name another set, or adapt.
fn is_lattice(settings: &ReduceSettings) -> bool {
    settings.set_of(false) == SetKind::Bcc
}

/// Whether a search is one for a pyramid.
fn is_pyramid(settings: &ReduceSettings) -> bool {
    settings.set_of(false) == SetKind::Pyramid
}

impl Rounding {
    fn new(settings: &ReduceSettings, target: Target) -> Self {
        let is_chosen = is_lattice(settings) && settings.value_bits == ValueBits::Usual;
        let mut rounding = Self { is_chosen, bits: settings.value_bits, learned: 0, few: false };
        if is_chosen {
            rounding.bits = ValueBits::Bits(USUAL_BITS);
            if let Some(Bound::OfRange(part)) = target.bound() {
                rounding.choose(target, part);
            }
        }
        rounding
    }

    /// For an error of this part of the range.
    fn choose(&mut self, target: Target, part: f64) {
        // The largest error is several times the RMS error.
        let part = if let Target::Max(_) = target { part / 8.0 } else { part };
        if part > 0.0 && part.is_finite() {
            let fewer = if self.few { 1.0 } else { 0.0 };
            let bits = ((-libm::log2(STEP * part)).round() - fewer).clamp(BITS[0], BITS[1]);
            self.bits = ValueBits::Bits(bits);
        }
    }

    /// The steps of the range for a lattice with a node at each sample: the first to be tried, and
    /// the fewest and the most; none where values are to be exact.
    fn steps_for_nodes(&self, target: Target, bound: f64, report: &ReduceReport) -> Option<(f64, [f64; 2])> {
        let steps = |bits: f64| libm::exp2(bits) - 1.0;
        match self.bits {
            _ if self.is_chosen => {
                let [lo, hi] = source_range(report)?;
                // Rounding to a step is off by half of it at most, by 1/√12 of it as the RMS.
                let of_bound = if let Target::Max(_) = target { 2.0 } else { 12f64.sqrt() / OF_ROUNDING };
                let limits = [steps(NodeCoder::LEAST_BITS), steps(NodeCoder::MOST_BITS)];
                let first = (hi - lo) / (of_bound * bound);
                first.is_finite().then(|| (first.clamp(limits[0], limits[1]), limits))
            }
            ValueBits::Bits(bits) if bits <= NodeCoder::MOST_BITS => Some((steps(bits), [steps(bits); 2])),
            ValueBits::Bits(_) | ValueBits::Usual | ValueBits::Exact => None,
        }
    }

    /// Chooses the bits by the results of the first and the second try; where a size is wanted also
    /// of the first one with few bits a value. Returns whether they have changed: then earlier
    /// tries cannot be compared with later ones.
    fn learn(&mut self, target: Target, bound: f64, report: &ReduceReport) -> bool {
        let before = self.bits;
        let few = !self.few && target.bound().is_none() && bits_a_value(report) < FEW_BITS;
        let range = source_range(report).filter(|_| self.is_chosen && (few || self.learned < 2));
        if let Some([lo, hi]) = range {
            self.learned += 1;
            self.few |= few;
            let error = match target.bound() {
                Some(_) => bound,
                None => error_of(Target::Rms(Bound::Value(bound)), report),
            };
            self.choose(target, error / (hi - lo));
        }
        self.bits != before
    }

    /// Takes a bit less for an error of this part of the range; returns whether there is one less.
    fn take_fewer(&mut self, target: Target, part: f64) -> bool {
        let before = self.bits;
        self.few = true;
        self.choose(target, part);
        self.bits != before
    }
}

/// The bits that the files of values take for a value.
fn bits_a_value(report: &ReduceReport) -> f64 {
    let bytes = report.steps.iter().map(|s| s.value_bytes).sum::<u64>() as f64;
    8.0 * bytes / (report.points as f64 * report.steps.len() as f64)
}

/// The best try so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct BestTry {
    number: u32,
    made: Try,
    bytes: u64,
    bits_a_value: f64,
    settings: ReduceSettings,
}

/// A search between two tries: all that the next try follows from. One process makes all tries, or
/// shards do, with a plan for each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::pipeline) struct TargetSearch {
    target: Target,
    /// Bytes of the source, if known.
    source: Option<u64>,
    /// The settings that ask for the target.
    settings: ReduceSettings,
    rounding: Rounding,
    search: Option<Search>,
    /// Points of the next try; of the first they follow from the settings.
    count: Option<u64>,
    /// Tries that were made.
    tries: u32,
    /// Chunks of all these together.
    chunks: u64,
    best: Option<BestTry>,
    /// The search for the steps of the range of a lattice with a node at each sample, once fewer
    /// points have been tried.
    nodes: Option<Search>,
    /// Of a pyramid: how many times coarser its coefficients are in the next try.
    #[serde(default)]
    factor: Option<f64>,
    /// Whether each step has several fields.
    #[serde(default)]
    of_fields: bool,
}

impl TargetSearch {
    /// A search that begins. `source` is the number of bytes of the source, if known.
    ///
    /// # Errors
    /// [`Error::Usage`] for a target that cannot be one.
    pub(in crate::pipeline) fn new(
        settings: &ReduceSettings,
        target: Target,
        source: Option<u64>,
    ) -> Result<Self> {
        target.check(settings)?;
        Ok(Self {
            target,
            source,
            settings: settings.clone(),
            rounding: Rounding::new(settings, target),
            search: None,
            count: None,
            tries: 0,
            chunks: 0,
            best: None,
            nodes: None,
            factor: is_pyramid(settings).then_some(1.0),
            of_fields: false,
        })
    }

    /// The number of the next try: the first is 1.
    pub(in crate::pipeline) fn next_try(&self) -> u32 {
        self.tries + 1
    }

    /// About how many tries there will be.
    pub(in crate::pipeline) fn about(&self) -> u32 {
        self.next_try().max(if is_pyramid(&self.settings) { 1 } else { USUAL_TRIES })
    }

    /// What is known before the first try, which has this estimate; the source has so many samples,
    /// or vertices.
    pub(super) fn estimate(&self, first: &Estimate, samples: u64) -> Result<SearchEstimate> {
        let (target, tries) = (self.target, self.about());
        let archive_bytes = match target {
            Target::Size(_) | Target::Ratio(_) => [LEAST_BYTES, target.bytes(self.source)? as u64],
            Target::Rms(_) | Target::Max(_) | Target::Lossless => {
                let exact = is_lattice(&self.settings) && self.rounding.bits == ValueBits::Exact;
                let most = if exact { MOST_OF_LATTICE } else { 1.0 } * samples as f64;
                let points = most / first.points.max(1) as f64;
                [LEAST_BYTES, (first.archive_bytes as f64 * points.max(1.0)) as u64]
            }
        };
        let archive_bytes = [archive_bytes[0].min(archive_bytes[1]), archive_bytes[1]];
        Ok(SearchEstimate { target, tries, archive_bytes, seconds: first.seconds * f64::from(tries) })
    }

    /// The number of the try that a plan is of: the next one, or the best when the search is over.
    pub(in crate::pipeline) fn this_try(&self) -> u32 {
        self.best_try().filter(|_| self.is_over()).unwrap_or_else(|| self.next_try())
    }

    /// The number of the best try so far.
    pub(in crate::pipeline) fn best_try(&self) -> Option<u32> {
        self.best.as_ref().map(|best| best.number)
    }

    /// The settings of the best try so far.
    pub(in crate::pipeline) fn best_settings(&self) -> Option<&ReduceSettings> {
        self.best.as_ref().map(|best| &best.settings)
    }

    /// Whether the best try is what was searched for.
    pub(in crate::pipeline) fn is_over(&self) -> bool {
        self.best.is_some() && self.count.is_none() && self.factor.is_none()
    }

    /// Whether it began with the same question.
    pub(in crate::pipeline) fn asks_as(&self, other: &Self) -> bool {
        (self.target, self.source, &self.settings) == (other.target, other.source, &other.settings)
    }

    /// The settings of the next try.
    pub(in crate::pipeline) fn next_settings(&self) -> ReduceSettings {
        if is_pyramid(&self.settings) {
            return ReduceSettings { step_factor: self.factor.unwrap_or(1.0), ..self.settings.clone() };
        }
        // For adapted points, the number of points that an error asks for is predicted.
        let adapts = self.settings.adapt.is_some();
        let predicted = self.settings.target.filter(|t| adapts && t.bound().is_some());
        let values = if self.nodes.is_some() { Values::Nodes } else { self.settings.values };
        let settings = ReduceSettings { value_bits: self.rounding.bits, values, ..self.settings.clone() };
        match self.count {
            None => ReduceSettings { target: predicted, ..settings },
            Some(count) => ReduceSettings { target: None, amount: Amount::Count(count), ..settings },
        }
    }

    /// Notes the result of a try, and returns it. The try may be the best one now, and the last.
    ///
    /// # Errors
    /// [`Error::Usage`] where the bytes of the source must be known.
    pub(in crate::pipeline) fn note(&mut self, report: &ReduceReport) -> Result<TargetReport> {
        let bound = match &self.search {
            Some(search) => search.bound,
            None => self.target.limit(report, self.source)?,
        };
        self.of_fields = report.of_fields;
        let (settings, number) = (self.next_settings(), self.tries + 1);
        self.tries = number;
        self.chunks += report.chunks;
        let made = match self.nodes.take() {
            _ if is_pyramid(&self.settings) => self.note_factor(bound, report, settings),
            Some(nodes) => self.note_nodes(nodes, report, settings),
            None => self.note_points(bound, report, settings),
        };
        Ok(self.report(made, bound, None))
    }

    /// Notes a try with a number of points.
    fn note_points(&mut self, bound: f64, report: &ReduceReport, settings: ReduceSettings) -> Try {
        let (target, samples) = (self.target, report.samples as f64);
        let is_size = target.bound().is_none();
        let is_lattice = is_lattice(&self.settings) && !is_size;
        let most = if is_lattice && self.rounding.bits == ValueBits::Exact { MOST_OF_LATTICE } else { 1.0 };
        let limits = if is_size { [1.0 / MOST_A_SAMPLE, samples] } else { [1.0, most * samples] };
        let usual = USUAL_POWERS[usize::from(is_size)];
        let search =
            self.search.get_or_insert_with(|| Search { bound, limits, near: NEAR, usual, tries: vec![] });
        // This is the number that was asked for, because the resulting number is rounded: the limit
        // must be reached.
        let points = self.count.unwrap_or(report.inner_points).max(1) as f64;
        let amount = if is_size { samples / points } else { points };
        let made = Try { amount, reached: target.reached(report) };
        search.tries.push(made);
        let mut next = search.next();
        let changes = self.rounding.learn(target, bound, report);
        if changes {
            next = next.or(Some(amount));
            search.tries.clear();
            self.best = None;
        }
        let (meets, bytes) = (made.reached <= bound, report.archive_bytes);
        if let Some(best) = self.best.as_ref().filter(|_| self.rounding.few && !is_size)
            && bytes as f64 > if meets { MANY_TIMES } else { 1.0 } * best.bytes as f64
        {
            next = None;
        }
        // The try at the cap is all that is possible.
        let is_best = match &self.best {
            Some(best) if is_size => meets && made.amount < best.made.amount,
            Some(best) => meets && bytes < best.bytes,
            None => meets || next.is_none(),
        };
        if !changes && is_best {
            let bits_a_value = bits_a_value(report);
            self.best = Some(BestTry { number: self.tries, made, bytes, bits_a_value, settings });
        }
        if next.is_none() && !is_size {
            next = self.with_fewer_bits(bound, report);
        }
        self.count = next
            .map(|amount| if is_size { samples / amount } else { amount })
            .map(|count| count.round().max(1.0) as u64);
        let of_steps = samples * report.steps.len() as f64;
        let is_enough =
            |best: &BestTry| best.made.reached <= bound && 8.0 * best.bytes as f64 <= MANY_BITS * of_steps;
        if next.is_none()
            && is_lattice
            && !report.is_of_mesh
            && !self.best.as_ref().is_some_and(is_enough)
            && let Some((first, limits)) = self.rounding.steps_for_nodes(target, bound, report)
        {
            let nodes = Search { bound, limits, near: NEAR, usual: POWER_OF_STEPS, tries: vec![] };
            self.try_nodes(nodes, first, report.samples);
        }
        made
    }

    /// The number of points of the next try where the best one meets an error, and one with a bit
    /// less for each value may take fewer bytes.
    fn with_fewer_bits(&mut self, bound: f64, report: &ReduceReport) -> Option<f64> {
        let best = self.best.as_ref().filter(|best| best.made.reached <= bound)?;
        let rounding = &mut self.rounding;
        if !rounding.is_chosen || rounding.few || best.bits_a_value >= FEW_BITS {
            return None;
        }
        let [lo, hi] = source_range(report)?;
        let amount = best.made.amount;
        let search = self.search.as_mut().filter(|_| rounding.take_fewer(self.target, bound / (hi - lo)))?;
        search.tries.clear();
        Some(search.aimed(Try { amount, reached: bound }).min(search.limits[1]))
    }

    /// Makes a lattice with a node at each sample the next try, with so many steps of the range.
    fn try_nodes(&mut self, nodes: Search, steps: f64, samples: u64) {
        self.rounding.bits = ValueBits::Bits(libm::log2(steps + 1.0));
        (self.nodes, self.count) = (Some(nodes), Some(samples));
    }

    /// Notes a try of a pyramid. Corrections meet a bound of each sample in the first one.
    fn note_factor(&mut self, bound: f64, report: &ReduceReport, settings: ReduceSettings) -> Try {
        let is_size = matches!(self.target, Target::Size(_) | Target::Ratio(_));
        let factor = settings.step_factor;
        let amount = if is_size { factor } else { 1.0 / factor };
        let usual = USUAL_POWERS_OF_STEPS[usize::from(is_size)];
        let (limits, near) = (LIMITS_OF_FACTORS, NEAR_OF_PYRAMIDS);
        let search = self.search.get_or_insert_with(|| Search { bound, limits, near, usual, tries: vec![] });
        let made = Try { amount, reached: self.target.reached(report) };
        search.tries.push(made);
        let next = match self.target {
            Target::Max(_) | Target::Lossless => None,
            _ if search.tries.len() as u32 >= MOST_TRIES => None,
            // A constant has no error, however coarse it is.
            _ if made.reached == 0.0 => None,
            _ => search.next(),
        };
        let meets = made.reached <= bound;
        let is_best = match &self.best {
            Some(best) => meets && made.amount < best.made.amount,
            None => meets || next.is_none(),
        };
        if is_best {
            let (bytes, number) = (report.archive_bytes, self.tries);
            self.best = Some(BestTry { number, made, bytes, bits_a_value: bits_a_value(report), settings });
        }
        self.factor = next.map(|amount| if is_size { amount } else { 1.0 / amount });
        made
    }

    /// Notes a try with a node at each sample.
    fn note_nodes(&mut self, mut nodes: Search, report: &ReduceReport, settings: ReduceSettings) -> Try {
        let steps = match self.rounding.bits {
            ValueBits::Bits(bits) => libm::exp2(bits) - 1.0,
            ValueBits::Usual | ValueBits::Exact => unreachable!("values of nodes have bits"),
        };
        let made = Try { amount: steps, reached: self.target.reached(report) };
        nodes.tries.push(made);
        let (bytes, meets) = (report.archive_bytes, made.reached <= nodes.bound);
        let mut is_hopeless = false;
        let is_best = match &self.best {
            Some(best) if best.made.reached <= nodes.bound => {
                let times = if meets { MANY_TIMES } else { 1.0 };
                is_hopeless = bytes as f64 > times * best.bytes as f64;
                meets && bytes < best.bytes
            }
            Some(best) => made.reached < best.made.reached,
            None => true,
        };
        if is_best {
            let bits_a_value = bits_a_value(report);
            self.best = Some(BestTry { number: self.tries, made, bytes, bits_a_value, settings });
        }
        // Bits that the user gives leave one try.
        let has_others = nodes.limits[0] < nodes.limits[1];
        match nodes.next().filter(|_| has_others && !is_hopeless) {
            Some(steps) => self.try_nodes(nodes, steps, report.samples),
            None => self.count = None,
        }
        made
    }

    /// What one of the tries came to.
    fn report(&self, made: Try, bound: f64, full_cells: Option<[u64; 2]>) -> TargetReport {
        TargetReport {
            target: self.target,
            bound,
            reached: made.reached,
            met: made.reached <= bound,
            tries: self.tries,
            of_ranges: self.target.bound().is_some() && self.of_fields,
            meshed_chunks: [self.chunks; 2],
            full_cells,
        }
    }

    /// What the best try came to. `full_cells` are those of adapted points.
    pub(super) fn best_report(&self, full_cells: Option<[u64; 2]>) -> TargetReport {
        let (Some(BestTry { made, .. }), Some(search)) = (&self.best, &self.search) else {
            unreachable!("the last try is the best if no other is")
        };
        self.report(*made, search.bound, full_cells)
    }

    /// Whether its points adapt.
    pub(super) fn adapts(&self) -> bool {
        self.settings.adapt.is_some()
    }

    /// The settings that ask for the target.
    pub(super) fn settings(&self) -> &ReduceSettings {
        &self.settings
    }
}

/// Points a sample, at most, of a lattice with exact values: more than one with a node at each has.
const MOST_OF_LATTICE: f64 = 2.5;

/// The error of the worst step; of several fields as a part of the range of each.
pub(super) fn error_of(target: Target, report: &ReduceReport) -> f64 {
    let which = usize::from(matches!(target, Target::Max(_) | Target::Lossless));
    if report.of_fields {
        return report.shares.iter().map(|shares| shares[which]).fold(0.0, f64::max);
    }
    report.steps.iter().filter_map(|s| s.error).map(|e| e[which]).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many tries a field takes, and the number of points that is kept; the second is the least
    /// one.
    fn look(bound: f64, cap: f64, first: f64, error: impl Fn(f64) -> f64) -> (usize, Option<f64>) {
        let tries = vec![Try { amount: first, reached: error(first) }];
        let usual = USUAL_POWERS[0];
        let mut search = Search { bound, limits: [1.0, cap], near: NEAR, usual, tries };
        while let Some(n) = search.next() {
            search.tries.push(Try { amount: n.round(), reached: error(n.round()) });
        }
        (search.tries.len(), search.bracket()[1].map(|t| t.amount))
    }

    #[test]
    fn power_laws_are_met_by_the_third_try() {
        for power in [0.25, 0.5, 1.0, 1.4] {
            for first in [30.0, 1e4, 3e5] {
                let (tries, points) = look(0.01, 1e9, first, |n| n.powf(-power));
                let least = 0.01f64.powf(-1.0 / power);
                if least < 1e9 {
                    let points = points.unwrap();
                    assert!(
                        points >= least * 0.999 && points <= least * 1.2,
                        "{power} {first}: {points} {least}"
                    );
                    assert!(tries <= 9, "{power} {first}: {tries} tries");
                }
            }
        }
    }

    #[test]
    fn uneven_errors_end_as_well() {
        // Steps: there is no number of points near the bound.
        let (tries, points) = look(1.0, 1e6, 100.0, |n| if n < 5000.0 { 7.0 } else { 0.2 });
        assert!(tries <= 10 && points.is_some_and(|n| (5000.0..20_000.0).contains(&n)), "{tries} {points:?}");
        // Up and down.
        let (tries, points) = look(1.0, 1e6, 100.0, |n| (2e3 / n) * (1.0 + 0.3 * (n / 50.0).sin()));
        assert!(tries <= 10 && points.is_some_and(|n| n < 4000.0), "{tries} {points:?}");
    }

    #[test]
    fn what_cannot_be_met_ends_at_the_cap() {
        let (tries, points) = look(0.1, 5e4, 100.0, |_| 3.0);
        assert!(tries <= 10 && points.is_none(), "{tries} {points:?}");
        // And what is exact, with nearly no point.
        let (tries, points) = look(0.1, 5e4, 1e4, |_| 0.0);
        assert!(tries <= 10 && points.is_some_and(|n| n < 10.0), "{tries} {points:?}");
    }
}
