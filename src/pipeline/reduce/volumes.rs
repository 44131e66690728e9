//! The steps of a series of volumes: planned from their headers, opened when their turn comes.

use super::cached::need_with_caches;
use super::job::{Basis, Job};
use super::order::Order;
use super::series::{FieldOfSeries, PlannedSource, SeriesPlan, is_of_data};
use super::volume_fields::{shape, volume_of};
use crate::archive::manifest::{CorrectionRecord, Source, StepPlan, WaveletRecord};
use crate::archive::values::Quantiser;
use crate::density::Choice;
use crate::pipeline::inputs::{Errors, Reading, Sampled, Shift, copy_bytes, range_of};
use crate::pipeline::plan::{Attachments, Inputs, Plan, PlanFrame, count_of, parts, source_of};
use crate::pipeline::read::{OpenArchive, coordinate_hash, scale_of};
use crate::pipeline::settings::{Bound, CompleteSettings, DEFAULT_ERROR, Target};
use isospan_io::error::{Error, Result};
use isospan_io::formats::StepSource;
use isospan_io::grid::Geometry;
use isospan_io::volume::chunked::ChunkShape;
use isospan_io::volume::{VolumeInfo, VolumeSource};
use isospan_mesh::points::{PointSpec, SetKind};
use isospan_wavelet::{
    Accuracy, Box3, Pyramid, Sampling, Scale, Settings, choose_delay, compress, encode_labels,
};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

/// What all steps must agree on.
struct Common {
    step: u64,
    field: FieldOfSeries,
    dims: [u64; 3],
    geometry: Geometry,
    /// The hash of the coordinates of a grid that has its own.
    coordinates: Option<u128>,
}

impl Common {
    fn check(&self, info: &VolumeInfo, coordinates: Option<u128>) -> Result<()> {
        let bad = |at: &str, expected: String, got: String| {
            let expected = format!("{expected}, as step {} has", self.step);
            Err(Error::bad_input(&info.path, at, expected, got).with_help(
                "the steps of a series share one mesh; `keep_going=true` leaves out those that do not fit",
            ))
        };
        if info.dims != self.dims {
            return bad("dimensions", shape(self.dims), shape(info.dims));
        }
        if info.geometry != self.geometry {
            return bad("geometry", place(&self.geometry), place(&info.geometry));
        }
        if coordinates != self.coordinates {
            return bad("coordinates of the grid", "those".into(), "others".into());
        }
        Ok(())
    }
}

fn place(g: &Geometry) -> String {
    let list = |v: [f64; 3]| v.map(|x| x.to_string()).join(",");
    let turned = if g.direction == Geometry::default().direction { "" } else { ", turned" };
    format!("spacing {}, origin {}{turned}", list(g.spacing), list(g.origin))
}

/// Plans volumes as steps of an archive, new or old.
struct Planner<'a> {
    job: &'a Job<'a>,
    common: Option<Common>,
    plan: Option<Plan>,
    /// Where points are needed, from the steps examined so far.
    errors: Option<Errors<'a>>,
    attachments: Attachments,
    inputs: Inputs<'a>,
    /// The offset that is subtracted from the values of all steps, once it is known.
    offset: Option<f64>,
    /// The packed file that was read last to find the rounding.
    looked_into: Option<PathBuf>,
    /// How fine the coefficients of each field of a pyramid are, once a step that is not constant
    /// has decided that, and how its samples are corrected.
    wavelets: HashMap<String, (Option<f64>, CorrectionRecord)>,
    /// Whether memory and disk were checked.
    is_checked: bool,
    only_estimates: bool,
}

/// The most steps of a series that are read to find where points are needed: these, evenly spread.
const MOST_LOOKED_AT: usize = 8;

/// Plans all steps of a series. Reads headers, and fingerprints.
///
/// Where values are rounded, and for a pyramid, all samples are read, unless that was done before.
/// With [`CompleteSettings::adapt`] those of some steps are.
pub(super) fn plan_volumes(job: &Job<'_>, only_estimates: bool) -> Result<SeriesPlan> {
    let Job { sources, settings, run, .. } = *job;
    let archive = job.basis.archive();
    let mut planner = Planner::new(job, only_estimates);
    if let Some(archive) = archive {
        planner.join(archive)?;
    }
    let (mut steps, mut planned, mut skipped, mut first_error) = (vec![], vec![], vec![], None);
    let several = job.is_several();
    let every = sources.len().div_ceil(MOST_LOOKED_AT);
    for (i, (number, source)) in sources.iter().map(|(n, s)| (*n, s)).enumerate() {
        run.resources.cancel.check()?;
        // Of each field at least one.
        let name = |source: &StepSource| source.part().map(|part| part.name.clone());
        let begins_field = i > 0 && name(&sources[i - 1].1) != name(source);
        let step = planner
            .step(number, source, i % every == 0 || begins_field)
            .map_err(|e| if several { e.at_step(number) } else { e });
        match step {
            Ok((step, source)) => {
                steps.push(step);
                planned.push(source);
            }
            Err(e) if run.keep_going && several && is_of_data(&e) => {
                skipped.push((number, source, e.to_string()));
                first_error.get_or_insert(e);
            }
            Err(e) => return Err(e),
        }
    }
    planner.set_levels()?;
    let (attachments, watch) = (planner.attachments, planner.inputs.watch);
    let Some(plan) = planner.plan.filter(|_| !steps.is_empty()) else {
        return Err(first_error.unwrap_or_else(|| Error::usage("there is no step to reduce")));
    };
    let mut series = SeriesPlan {
        plan: Plan { steps, ..plan },
        sources: planned,
        skipped: vec![],
        order: Order::default(),
        is_there: false,
        keyframes: settings.keyframes,
        attachments,
        watch,
    };
    skipped.into_iter().for_each(|(number, source, reason)| series.skip(number, source, reason));
    share_copies(&mut series)?;
    series.share_units(job)?;
    series.arrange(job)?;
    Ok(series)
}

/// Steps that lie in one packed file are read from one copy of it: otherwise each would be decoded
/// from the beginning.
fn share_copies(series: &mut SeriesPlan) -> Result<()> {
    let runs = series.sources.chunk_by_mut(|a, b| a.source.path == b.source.path);
    for run in runs.filter(|run| run.len() > 1 && run[0].copied > 0) {
        if let Some(bytes) = run[0].source.packed_bytes()? {
            run.iter_mut().for_each(|s| (s.copied, s.shared_copy) = (0, bytes));
        }
    }
    Ok(())
}

/// Makes the points of a plan as dense as was chosen.
fn choose(
    plan: &mut Plan,
    attachments: &mut Attachments,
    choice: &Choice,
    frame: Option<&PlanFrame>,
) -> Result<()> {
    let levels = Arc::new(choice.levels.clone());
    plan.adapt(choice.n, &levels, frame)?;
    attachments.levels = Some(levels);
    Ok(())
}

/// How the samples of a step can be read.
fn planned(source: &StepSource, volume: &VolumeSource) -> PlannedSource {
    let chunks = match volume {
        VolumeSource::Chunked(chunks) => Some(ChunkShape::of(&**chunks)),
        _ => None,
    };
    let (copied, copying) = copy_bytes(volume);
    PlannedSource { chunks, copied, copying, ..PlannedSource::in_place(source.clone()) }
}

impl<'a> Planner<'a> {
    fn new(job: &'a Job<'a>, only_estimates: bool) -> Self {
        Self {
            job,
            common: None,
            plan: None,
            errors: None,
            attachments: Attachments::default(),
            inputs: job.basis.inputs(),
            offset: None,
            looked_into: None,
            wavelets: HashMap::new(),
            is_checked: false,
            only_estimates,
        }
    }

    /// Steps must be as those of an archive.
    fn join(&mut self, archive: &OpenArchive) -> Result<()> {
        let first = &archive.manifest.steps[0];
        self.common = Some(Common {
            step: first.number(),
            field: FieldOfSeries::new(first.number(), &first.plan.source.field),
            dims: first.plan.source.dims,
            geometry: first.plan.source.geometry,
            coordinates: archive.coordinates()?.map(|map| map.hash()).transpose()?,
        });
        self.offset = Some(first.plan.source.offset);
        for step in &archive.manifest.steps {
            if let Some(wavelet) = &step.plan.wavelet {
                let field = step.series.clone().unwrap_or_default();
                let is_constant = wavelet.range[0] == wavelet.range[1];
                let known = self.wavelets.entry(field).or_default();
                let step = (!is_constant).then_some(wavelet.step).or(known.0);
                *known = (step, wavelet.correction);
            }
        }
        self.plan = Some(Plan { mesh: archive.manifest.plan.clone(), steps: vec![] });
        self.attachments = Attachments::read(archive.path(), &archive.manifest.plan)?;
        Ok(())
    }

    /// Whether levels have to be found, and are not those of a plan or archive that is there.
    fn finds_levels(&self) -> bool {
        self.job.settings.adapt.is_some()
            && matches!(self.job.basis, Basis::New | Basis::Try(_) | Basis::Archive(_))
    }

    /// Makes points dense where that was found to be needed; or where it was when the plan was
    /// made.
    fn set_levels(&mut self) -> Result<()> {
        let Some(plan) = &mut self.plan else { return Ok(()) };
        if let Some(planned) = self.job.basis.plan()
            && (planned.mesh.levels.is_some() || !planned.mesh.stores_mesh())
            && planned.mesh.lattice.dims == plan.mesh.lattice.dims
        {
            self.attachments = Attachments::read(self.job.out, &planned.mesh)?;
            plan.mesh.clone_from(&planned.mesh);
        }
        if let Some(errors) = self.errors.take().map(Errors::finished) {
            let (target, dims) = (self.job.settings.target, plan.mesh.lattice.dims);
            let bound = target.and_then(Target::bound).map(|b| b.in_units(errors.range()));
            let choice = match target.zip(bound) {
                Some((Target::Rms(_), bound)) => errors.choice(errors.count_of_rms(bound)?)?,
                Some((Target::Max(_), bound)) => errors.choice_of_bound(bound, dims.iter().product())?,
                _ => errors.choice(count_of(self.job.settings, dims))?,
            };
            choose(plan, &mut self.attachments, &choice, None)?;
        }
        if let Some(round) = self.job.basis.round() {
            choose(plan, &mut self.attachments, &round.choice, round.frame.as_ref())?;
        }
        Ok(())
    }

    /// Adds the errors of a step to those that decide where points are needed.
    fn look_at(&mut self, source: &StepSource) -> Result<()> {
        let (Some(plan), Some(adapt)) = (&self.plan, &self.job.settings.adapt) else { return Ok(()) };
        if self.errors.is_none() {
            self.errors = Some(Errors::new(plan.mesh.lattice, adapt, self.job.run, self.job.has_fields())?);
        }
        let (volume, reading) = (volume_of(source, "the volume it was")?, self.reading());
        let field = source.part().map(|part| &*part.name);
        self.errors.as_mut().map_or(Ok(()), |errors| errors.add(volume, reading, field))
    }

    fn step(&mut self, number: u64, source: &StepSource, look: bool) -> Result<(StepPlan, PlannedSource)> {
        if !source.is_given() {
            // Before its head is read.
            self.inputs.watch.add_named(&source.path)?;
        }
        let volume = volume_of(source, "a volume, as other steps are")?;
        let info = volume.info().clone();
        let fingerprint =
            self.inputs.of_source(number, source, &info.files(), &self.job.run.resources.cancel)?;
        let coordinates = coordinate_hash(source, info.dims)?;
        match &self.common {
            Some(common) => {
                common.field.check(source, &info.field.name)?;
                common.check(&info, coordinates)?;
            }
            None => {
                self.plan = Some(Plan::of_volume(&info, self.job.settings, fingerprint.clone())?);
                let (dims, geometry) = (info.dims, info.geometry);
                let field = FieldOfSeries::new(number, &info.field.name);
                self.common = Some(Common { step: number, field, dims, geometry, coordinates });
            }
        }
        let shift = self.shift(number, source, &volume)?;
        self.offset = Some(shift.offset);
        if look && self.finds_levels() {
            self.look_at(source)?;
        }
        let planned = planned(source, &volume);
        let mut step = StepPlan {
            number,
            time: source.time,
            source: Source {
                offset: shift.offset,
                rounding: shift.rounding,
                units: source.units(&info.units),
                ..source_of(&info, fingerprint)
            },
            interpolation: self.job.settings.interpolation,
            values: self.job.settings.values,
            nan: self.job.settings.nan.to_string(),
            missing: self.job.settings.finite_missing(),
            quantiser: None,
            wavelet: None,
            keyframes: self.job.settings.keyframes,
            measured: self.job.settings.measure,
            base: None,
        };
        if self.stores_pyramid() {
            self.set_wavelet(&mut step, &planned, volume)?;
            return Ok((step, planned));
        }
        step.quantiser = self.quantiser(&step, &planned, volume)?;
        Ok((step, planned))
    }

    /// How the values of a step are rounded: as planned before, or by the range of its samples.
    fn quantiser(
        &mut self,
        step: &StepPlan,
        planned: &PlannedSource,
        volume: VolumeSource,
    ) -> Result<Option<Quantiser>> {
        Ok(match (self.job.basis.plan(), self.job.settings.value_bits) {
            (Some(plan), _) => plan.steps.iter().find(|s| s.number == step.number).and_then(|s| s.quantiser),
            (None, Some(bits)) if !self.only_estimates => {
                self.check_budget(step, planned)?;
                let range = range_of(volume, &self.reading(), &self.job.run.resources.cancel)?;
                Some(Quantiser::new(bits, range).of(step.values))
            }
            (None, _) => None,
        })
    }

    /// Whether all samples are kept, as a wavelet pyramid.
    fn stores_pyramid(&self) -> bool {
        self.plan.as_ref().is_some_and(|plan| plan.mesh.points.kind() == SetKind::Pyramid)
    }

    /// Whether samples are kept as labels.
    fn has_labels(&self) -> bool {
        self.plan.as_ref().is_some_and(|plan| plan.mesh.has_labels())
    }

    /// Finds out what the coefficients of a step stand for. The first step of a field that is not
    /// constant decides how fine they are, and that of the archive along which axes levels begin
    /// later.
    fn set_wavelet(
        &mut self,
        step: &mut StepPlan,
        planned: &PlannedSource,
        volume: VolumeSource,
    ) -> Result<()> {
        if let Some(plan) = self.job.basis.plan() {
            step.wavelet = plan.steps.iter().find(|s| s.number == step.number).and_then(|s| s.wavelet);
            return Ok(());
        }
        if self.only_estimates {
            return Ok(());
        }
        self.check_budget(step, planned)?;
        let found = Sampled::of(volume, &self.reading(), &self.job.run.resources.cancel)?;
        let range = found.range.unwrap_or_default().map(f64::from);
        let field = planned.source.part().map_or(String::new(), |part| part.name.clone());
        let is_constant = range[0] == range[1];
        let (known_step, known) = self.wavelets.get(&field).copied().unwrap_or_default();
        let correction = match known {
            _ if self.has_labels() => CorrectionRecord::Labels,
            CorrectionRecord::None if known_step.is_none() => correction_of(self.job.settings, range),
            known => known,
        };
        let wavelet_step = match known_step {
            Some(step) => step,
            // It has no coefficients. A step that is not constant decides.
            None if is_constant || correction == CorrectionRecord::Labels => 1.0,
            None => {
                let bound = rms_of(self.job.settings, correction, range);
                let refers = self.job.settings.keyframes > 1 && self.job.sources.len() > 1;
                // A bound of each sample is kept by corrections, whatever the step.
                let is_rms = correction == CorrectionRecord::None;
                let aim = if refers && is_rms { AIM_OF_SERIES } else { AIM };
                let chosen = wavelet_of(&found, range, [bound, aim], self.delay())?;
                if let (None, Some(plan)) = (self.delay(), &mut self.plan) {
                    plan.mesh.points = PointSpec::Pyramid { dims: step.source.dims, delay: chosen.delay };
                }
                chosen.step * self.job.settings.step_factor
            }
        };
        let decided = (!is_constant).then_some(wavelet_step).or(known_step);
        self.wavelets.insert(field, (decided, correction));
        let wavelet = WaveletRecord { range, step: wavelet_step, correction };
        scale_of(&wavelet).map_err(|e| {
            let path = planned.source.path.display();
            Error::usage(format!("{path}: the error that is asked for is below what f32 holds: {e}"))
        })?;
        step.wavelet = Some(wavelet);
        Ok(())
    }

    /// The delay of the pyramid, once a step has decided it.
    fn delay(&self) -> Option<[u8; 3]> {
        let is_decided =
            self.job.basis.archive().is_some() || self.wavelets.values().any(|(step, _)| step.is_some());
        match self.plan.as_ref()?.mesh.points {
            PointSpec::Pyramid { delay, .. } if is_decided => Some(delay),
            _ => None,
        }
    }

    /// Checks memory and disk for the first step, before all its samples are read: a header may
    /// claim any number of them.
    fn check_budget(&mut self, step: &StepPlan, source: &PlannedSource) -> Result<()> {
        let Some(plan) = self.plan.as_ref().filter(|_| !self.is_checked) else { return Ok(()) };
        self.is_checked = true;
        let plan = Plan { mesh: plan.mesh.clone(), steps: vec![step.clone()] };
        let (mesh, mut sources) = (parts(&plan.mesh, self.attachments.clone())?, [source.clone()]);
        let need = need_with_caches(&mut sources, &mesh, self.job.run);
        self.job.estimate(&plan, &need, &PlannedSource::copies(&sources))?.check()
    }

    /// How samples are read, once the offset is known.
    fn reading(&self) -> Reading {
        Reading::new(self.offset.unwrap_or(0.0), self.job.settings.missing, self.job.settings.nan)
    }

    /// How the values of a step are kept.
    fn shift(&mut self, number: u64, source: &StepSource, volume: &VolumeSource) -> Result<Shift> {
        if let Some(plan) = self.job.basis.plan() {
            return Ok(plan.steps.iter().find(|s| s.number == number).map_or_else(Shift::default, Shift::of));
        }
        let open = || volume_of(source, "the volume it was");
        if self.has_labels() {
            return Shift::of_labels(open, self.job.settings.missing, &self.job.run.resources.cancel);
        }
        // The first of several steps in one packed file stands for all: each costs a decoding, in a
        // stream with all before it.
        let is_packed = !matches!(volume, VolumeSource::Random(_));
        if let (Some(offset), true) =
            (self.offset, is_packed && self.looked_into.as_ref() == Some(&source.path))
        {
            return Ok(Shift { offset, rounding: 0.0 });
        }
        self.looked_into = is_packed.then(|| source.path.clone());
        Shift::of_volume(open, self.offset, self.job.settings.missing, &self.job.run.resources.cancel)
    }
}

/// How samples are corrected.
fn correction_of(settings: &CompleteSettings, range: [f64; 2]) -> CorrectionRecord {
    match settings.target {
        // A part of no range is no bound; and a constant has no error.
        Some(Target::Max(Bound::OfRange(_))) if range[0] == range[1] => CorrectionRecord::None,
        Some(Target::Max(bound)) => CorrectionRecord::Max(bound.in_units(range)),
        Some(Target::Lossless) => CorrectionRecord::Lossless,
        Some(Target::Labels) => CorrectionRecord::Labels,
        _ => CorrectionRecord::None,
    }
}

/// The RMS error that a pyramid is made for at first, before corrections.
fn rms_of(settings: &CompleteSettings, correction: CorrectionRecord, range: [f64; 2]) -> f64 {
    /// What a bound of each sample asks of the RMS error before corrections.
    const OF_MAX: f64 = 0.75;
    /// Of whole numbers.
    const OF_WHOLE: f64 = 0.4;
    match (correction, settings.target) {
        (CorrectionRecord::Max(bound), _) => OF_MAX * bound,
        (CorrectionRecord::Lossless | CorrectionRecord::Labels, _) => OF_WHOLE,
        (CorrectionRecord::None, Some(Target::Rms(bound))) => bound.in_units(range),
        (CorrectionRecord::None, _) => Bound::OfRange(DEFAULT_ERROR).in_units(range),
    }
}

/// Bytes of all steps of a pyramid, about: those of boxes of the first step, for all its samples.
pub(super) fn pyramid_bytes(job: &Job<'_>, plan: &Plan) -> Result<u64> {
    let (settings, step) = (job.settings, plan.first());
    let Some((_, source)) = job.sources.first() else { return Ok(0) };
    let reading = Reading::new(step.source.offset, settings.missing, settings.nan);
    let volume = volume_of(source, "the volume it was")?;
    let found = Sampled::of_boxes(volume, &reading, &job.run.resources.cancel)?;
    let range = found.range.unwrap_or_default().map(f64::from);
    let correction = correction_of(settings, range);
    let all =
        |bytes: usize, samples: usize| bytes as f64 * step.source.samples() as f64 / samples.max(1) as f64;
    if correction == CorrectionRecord::Labels {
        let each = found.boxes.iter().map(|(values, dims)| Ok([label_bytes(values, *dims)?, values.len()]));
        let sums =
            each.collect::<Result<Vec<_>>>()?.into_iter().fold([0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        return Ok((all(sums[0], sums[1]) * plan.steps.len() as f64) as u64 + OTHER_FILES);
    }
    let bound = rms_of(settings, correction, range);
    let chosen = wavelet_of(&found, range, [bound, AIM], None)?;
    let accuracy = match correction {
        CorrectionRecord::None => Accuracy::Step(chosen.step),
        CorrectionRecord::Max(bound) => Accuracy::Max(bound),
        CorrectionRecord::Lossless | CorrectionRecord::Labels => Accuracy::Lossless,
    };
    let refused = |e: isospan_wavelet::Error| Error::usage(format!("the error that is asked for: {e}"));
    let (mut bytes, mut samples) = (0, 0);
    for (values, dims) in &found.boxes {
        let made = compress(values, *dims, &Settings { accuracy, delay: Some(chosen.delay) });
        bytes += made.map_err(refused)?.len().saturating_sub(HEAD);
        samples += values.len();
    }
    let steps = plan.steps.iter().map(|step| if step.base.is_some() { OF_CHANGES } else { 1.0 });
    Ok((all(bytes, samples) * steps.sum::<f64>()) as u64 + OTHER_FILES)
}

/// Bytes of a box of labels.
fn label_bytes(values: &[f32], dims: [usize; 3]) -> Result<usize> {
    let (all, mut bytes) = (Pyramid::of_labels(dims), 0);
    let labels: Vec<i32> = values.iter().map(|v| *v as i32).collect();
    for id in all.label_tiles(&Box3::all(dims)) {
        let place = all.label_box(id.at);
        let made = encode_labels(&Box3::all(dims).values_of(&labels, &place), place.size);
        bytes += made.map_err(|e| Error::usage(format!("labels: {e}")))?.len();
    }
    Ok(bytes)
}

/// What a step takes that refers to another one, as a part of one that does not.
const OF_CHANGES: f64 = 0.7;

/// Bytes before the coefficients of a compressed array, and those of an archive's manifest.
const HEAD: usize = 56;
const OTHER_FILES: u64 = 2 << 10;

/// The part of a bound that is aimed at: the boxes are not all samples.
const AIM: f64 = 0.975;
/// The same for steps that may refer to others, whose errors are some percent larger.
const AIM_OF_SERIES: f64 = 0.94;

/// How fine the coefficients of a pyramid are, and which axes are split later.
struct Chosen {
    step: f64,
    delay: [u8; 3],
}

/// Tries coefficients on boxes of samples, for an RMS error of which a part is aimed at.
fn wavelet_of(
    found: &Sampled,
    range: [f64; 2],
    [bound, aim]: [f64; 2],
    delay: Option<[u8; 3]>,
) -> Result<Chosen> {
    if range[0] == range[1] {
        return Ok(Chosen { step: 1.0, delay: delay.unwrap_or_default() });
    }
    let refused = |e: isospan_wavelet::Error| Error::usage(format!("the error that is asked for: {e}"));
    // Errors count where samples are known, and those that stand for others have nearly none.
    let bound = bound * found.known.sqrt();
    let mut sampling = Sampling::new(&found.boxes, range, delay.unwrap_or_default()).map_err(refused)?;
    let mut step = sampling.step(bound).map_err(refused)?;
    let delay = match delay {
        Some(delay) => delay,
        None => {
            let scale = Scale::new(range, step).map_err(refused)?;
            let delay = choose_delay(&found.few_boxes(), &scale, found.samples).map_err(refused)?;
            if delay != [0; 3] {
                sampling = Sampling::new(&found.boxes, range, delay).map_err(refused)?;
                step = sampling.step(bound).map_err(refused)?;
            }
            delay
        }
    };
    let boxes = found.small_boxes();
    let is_whole = boxes.iter().map(|b| b.0.len()).sum::<usize>() == found.samples;
    let alone = if is_whole { 1.0 } else { ALONE };
    for _ in 0..ROUNDS {
        let excess = alone * sampling.excess(&boxes, step).map_err(refused)?;
        let before = std::mem::replace(&mut step, sampling.step(aim * bound / excess).map_err(refused)?);
        if (step / before - 1.0).abs() < FAR {
            break;
        }
    }
    Ok(Chosen { step, delay })
}

/// The RMS error of boxes among others, as a part of what they have alone: the mean of eleven
/// volumes at four errors. A transform has larger errors where it ends.
const ALONE: f64 = 0.98;
/// What boxes tell of a step holds for steps that differ by less. Others are tried, so many times.
const FAR: f64 = 0.15;
const ROUNDS: usize = 3;
