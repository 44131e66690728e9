//! The steps of a series of tetrahedral meshes: the mesh is read once, and each step has values on
//! it.
//!
//! ```text
//!  new     first file ─▶ store ─▶ plan, samples of the boundary ─▶ steps: hashes of points and cells, values
//!  further first file ─▶ store ─▶ both as in the archive?       ─▶ …
//! ```
//!
//! A file that stores points and cells by the very bytes of the one before
//! ([`CellMesh::stored_hash`]) has the same of both, and they are not decoded.
//!
//! The values of the first step decide which vertices are merged. An archive to which steps are
//! added has them recorded.

use super::job::Job;
use super::mesh_fields::{Listed, MeshInput};
use super::mesh_store::{check_job, open_mesh_of};
use super::order::Order;
use super::series::{FieldOfSeries, PlannedSource, SeriesPlan, is_of_data};
use crate::archive::manifest::{MeshPlan, MeshSource, OwnRecord, Source, StepPlan};
use crate::archive::segment::PlanHash;
use crate::archive::tables::{ExplicitRecord, RepeatedRecord};
use crate::archive::values::Quantiser;
use crate::domain::amount::{COUNTABLE, amount_between, next_amount, valued};
use crate::domain::boundary::BoundarySamples;
use crate::domain::column::Column;
use crate::domain::identity::Identity;
use crate::domain::own::OwnVertices;
use crate::domain::settings::StoreSettings;
use crate::domain::spacing::Spacing;
use crate::domain::store::CellStore;
use crate::pipeline::inputs::{MeshChoice, MeshCurves, Shift};
use crate::pipeline::plan::{Attachments, Inputs, Plan, Watch};
use crate::pipeline::read::OpenArchive;
use crate::pipeline::settings::{Amount, CompleteSettings};
use isospan_io::cells::CellMesh;
use isospan_io::error::{Error, Result};
use isospan_io::formats::StepSource;
use isospan_io::volume::units::Units;
use isospan_mesh::points::{ExplicitPoints, Levels, PointSet, PointSpec, SetKind, SetSettings};
use isospan_mesh::sample::Interpolation;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The mesh that all steps must have.
struct Common {
    identity: Identity,
    vertices: u64,
    /// The file from which it is known.
    name: String,
}

impl Common {
    fn of_store(mesh: &CellMesh, store: &CellStore) -> Self {
        let (identity, vertices) = (store.identity, store.census.vertices);
        Self { identity, vertices, name: mesh.info().path.display().to_string() }
    }

    /// The mesh of an archive.
    fn of_archive(archive: &OpenArchive) -> Self {
        let first = &archive.manifest.steps[0].plan;
        let source = &first.source;
        let mesh = source.mesh.expect("an archive of a mesh tells it");
        let identity = Identity { points: mesh.point_hash.0, cells: mesh.cell_hash.0 };
        let name = format!("{}, step {}", source.path, first.number);
        Self { identity, vertices: mesh.vertices, name }
    }

    /// Refuses many other meshes by their number of points, without reading them.
    fn check_number(&self, mesh: &CellMesh) -> Result<()> {
        match mesh.info().points {
            n if n == self.vertices => Ok(()),
            n => Err(self.other(mesh, "points", &self.vertices.to_string(), &n.to_string())),
        }
    }

    fn check(&self, mesh: &CellMesh, found: Identity) -> Result<()> {
        self.check_number(mesh)?;
        if found.points != self.identity.points {
            return Err(self.other(mesh, "points", "the positions", "others"));
        }
        if found.cells != self.identity.cells {
            return Err(self.other(mesh, "cells", "those", "others, or in another order"));
        }
        Ok(())
    }

    fn other(&self, mesh: &CellMesh, at: &str, expected: &str, got: &str) -> Error {
        let expected = format!("{expected} of {}", self.name);
        Error::bad_input(&mesh.info().path, at, expected, got).with_help(
            "the steps of a series share one mesh; `keep_going=true` leaves out those that do not fit",
        )
    }
}

/// What is subtracted from the values of all steps: as the archive or the plan has it, else as the
/// first source that can be opened asks for.
pub(super) fn offset_of(job: &Job<'_>) -> Result<f64> {
    let known = job.basis.archive().map(|archive| &archive.manifest.steps[0].plan);
    if let Some(step) = known.or_else(|| job.basis.plan().map(Plan::first)) {
        return Ok(step.source.offset);
    }
    let (memory, cancel) = (job.run.resources.memory / 4, &job.run.resources.cancel);
    let shift = first_usable(job, |source| {
        let mesh = open_mesh_of(source)?;
        check_job(job, &mesh)?;
        Shift::of_mesh(&mesh, None, job.settings.missing, memory, cancel)
    });
    Ok(shift?.offset)
}

/// What is found in the first source that can be used. One of several whose data are wrong is
/// passed over where the run keeps going.
fn first_usable<T>(job: &Job<'_>, mut find: impl FnMut(&StepSource) -> Result<T>) -> Result<T> {
    let mut first_error = None;
    for (number, source) in job.sources {
        match find(source).map_err(|e| if job.is_several() { e.at_step(*number) } else { e }) {
            Err(e) if job.run.keep_going && job.is_several() && is_of_data(&e) => {
                first_error.get_or_insert(e);
            }
            other => return other,
        }
    }
    Err(first_error.unwrap_or_else(|| Error::usage("there is no step to reduce")))
}

/// The mesh of a job on disk, of a source.
fn base_from(
    source: &StepSource,
    job: &Job<'_>,
    how: &StoreSettings,
    inputs: &mut Inputs<'_>,
) -> Result<(CellMesh, CellStore)> {
    inputs.watch.add_named(&source.path)?;
    let mesh = open_mesh_of(source)?;
    inputs.watch.add(&mesh.info().files())?;
    check_job(job, &mesh)?;
    let Some(archive) = job.basis.archive() else {
        let store = CellStore::build(&mesh, how)?;
        return Ok((mesh, store));
    };
    let common = Common::of_archive(archive);
    common.check_number(&mesh)?;
    let firsts = Attachments::repeated(archive.path(), &archive.manifest.plan, common.vertices, how)?;
    let store = CellStore::build_with(&mesh, Some(firsts), how)?;
    common.check(&mesh, store.identity)?;
    Ok((mesh, store))
}

/// Reads the mesh of a job and plans its steps. Returns the mesh, the plan, and how many points
/// with a value are wanted, boundary included.
pub(super) fn prepare(job: &Job<'_>, settings: StoreSettings) -> Result<(MeshInput, SeriesPlan, u64)> {
    let how = &settings;
    let mut inputs = job.basis.inputs();
    let (mesh, store) = first_usable(job, |source| base_from(source, job, how, &mut inputs))?;
    let path = &mesh.info().path;
    let wanted = wanted_of(job.settings, store.census.vertices).round().max(1.0) as u64;
    let own = is_own(job, store.census.vertices);
    let mut plan = match job.basis.archive() {
        None => {
            let points = if own { store.census.vertices + store.census.added } else { wanted };
            new_plan(&mesh, &store, points, job.settings, how.offset)?
        }
        Some(archive) => continued_plan(archive, job.settings),
    };
    let of_share = |e: Error| e.of_share(how.memory, job.run.resources.memory);
    let (dense, listed) = if own {
        let vertices = OwnVertices::new(&store, how, path).map_err(of_share)?;
        if job.basis.archive().is_none() {
            let record = OwnRecord::new(store.census.tetrahedra, vertices.volume6);
            plan.keep_own(&vertices.points, record)?;
        }
        (Dense { levels: None, wanted }, Listed::Own(vertices))
    } else {
        let (dense, boundary) = dense_enough(&mut plan, &store, wanted, job, how, path).map_err(of_share)?;
        (dense, Listed::Boundary(boundary))
    };
    let record = ExplicitRecord::of(listed.points());
    match job.basis.archive() {
        None => plan.mesh.explicit = Some(record),
        Some(archive) => expect_listed(archive, record)?,
    }
    let series = plan_steps(&mesh, &store, listed.points(), plan, job, how, inputs)?;
    let series =
        SeriesPlan { attachments: Attachments { levels: dense.levels, ..series.attachments }, ..series };
    Ok((MeshInput { store, listed, settings }, series, dense.wanted))
}

/// Whether a mesh of `vertices` vertices is kept as it is: as the archive or the plan has it, else
/// as the settings ask.
fn is_own(job: &Job<'_>, vertices: u64) -> bool {
    let known = job.basis.archive().map(|archive| &archive.manifest.plan);
    match known.or_else(|| job.basis.plan().map(|plan| &plan.mesh)) {
        Some(plan) => plan.own.is_some(),
        None => job.basis.round().is_none() && keeps_own(job.settings, vertices),
    }
}

/// Whether settings ask for a mesh as it is: for all of its vertices, and for no other points or
/// values.
pub(super) fn keeps_own(settings: &CompleteSettings, vertices: u64) -> bool {
    let all = match settings.amount {
        Amount::Usual => false,
        Amount::Fraction(f) => f == 1.0,
        Amount::Count(n) => n >= vertices,
    };
    all && settings.points == SetKind::Hammersley
        && settings.set == SetSettings::default()
        && settings.interpolation == Interpolation::Linear
        && settings.adapt.is_none()
        && settings.target.is_none()
}

/// How dense the points of a plan are.
struct Dense {
    levels: Option<Arc<Levels>>,
    /// Points that are wanted.
    wanted: u64,
}

/// Gives a plan as many points as are wanted, boundary included, denser in some places where that
/// is asked for; or the points of an archive, or of the plan of a shard. Returns the samples of the
/// boundary that belong to them.
fn dense_enough(
    plan: &mut Plan,
    store: &CellStore,
    wanted: u64,
    job: &Job<'_>,
    how: &StoreSettings,
    path: &Path,
) -> Result<(Dense, BoundarySamples)> {
    let known = |levels, plan: &Plan| {
        let boundary = boundary_of(plan.mesh.points, &levels, store, how, path)?;
        Ok((Dense { levels, wanted }, boundary))
    };
    if let Some(archive) = job.basis.archive() {
        return known(archive.points.levels().cloned(), plan);
    }
    if let Some(planned) = job.basis.plan()
        && planned.mesh.lattice == plan.mesh.lattice
    {
        plan.mesh.clone_from(&planned.mesh);
        return known(Attachments::read(job.out, &planned.mesh)?.levels, plan);
    }
    if let Some(round) = job.basis.round() {
        let levels = Arc::new(round.choice.levels.clone());
        plan.adapt(round.choice.n, &levels, round.frame.as_ref())?;
        return known(Some(levels), plan);
    }
    let Some(adapt) = &job.settings.adapt else {
        let (set, kind) = (&job.settings.set, job.settings.points);
        let (points, boundary) =
            PointSetSearch { store, how, path, wanted }.find(store.filled(), |count| {
                let points = PointSpec::with_count(kind, &plan.mesh.lattice, count, set)?;
                Ok((points, None, points))
            })?;
        let count = PointSet::new(points, plan.mesh.lattice)?.interior_len();
        let spaced = Plan::on_lattice(plan.mesh.lattice, count, plan.first().source.clone(), job.settings)?;
        plan.mesh = MeshPlan { points, repeated: plan.mesh.repeated, ..spaced.mesh };
        return Ok((Dense { levels: None, wanted }, boundary));
    };
    let curves = MeshCurves::new(store, how, adapt, job.run)?;
    let adapted = |plan: &mut Plan, choice: MeshChoice| {
        let levels = Arc::new(choice.choice.levels);
        plan.adapt(choice.choice.n, &levels, None)?;
        Ok((plan.mesh.points, levels))
    };
    if let Some(target) = job.settings.target {
        let choice = curves.choose(Some(target), wanted)?;
        let wanted = choice.count;
        let levels = Some(adapted(plan, choice)?.1);
        let boundary = boundary_of(plan.mesh.points, &levels, store, how, path)?;
        return Ok((Dense { levels, wanted }, boundary));
    }
    let (adapted, boundary) = PointSetSearch { store, how, path, wanted }.find(1.0, |count| {
        let mut plan = plan.clone();
        let (points, levels) = adapted(&mut plan, curves.choose(None, count)?)?;
        Ok((points, Some(Arc::clone(&levels)), (plan.mesh, levels)))
    })?;
    let (mesh, levels) = adapted;
    plan.mesh = mesh;
    Ok((Dense { levels: Some(levels), wanted }, boundary))
}

/// The samples of the boundary that belong to a set of points.
fn boundary_of(
    points: PointSpec,
    levels: &Option<Arc<Levels>>,
    store: &CellStore,
    how: &StoreSettings,
    path: &Path,
) -> Result<BoundarySamples> {
    let lattice = levels.as_ref().map_or(store.frame.lattice, |levels| levels.cells().lattice);
    BoundarySamples::new(store, &Spacing::of(points, lattice, levels.clone())?, how.memory, path)
}

/// Looks for the set with as many points as are wanted.
struct PointSetSearch<'a> {
    store: &'a CellStore,
    how: &'a StoreSettings,
    path: &'a Path,
    wanted: u64,
}

/// Tries, at most.
const TRIES: usize = 12;
/// A number of points is met within this part of it.
const MET: f64 = 0.005;

impl PointSetSearch<'_> {
    /// Searches the sets that `make` gives for a count. About the share `filled` of `count` points
    /// lies inside. Sets too large to be counted are judged by smaller ones.
    fn find<T>(
        &self,
        filled: f64,
        make: impl Fn(u64) -> Result<(PointSpec, Option<Arc<Levels>>, T)>,
    ) -> Result<(T, BoundarySamples)> {
        let (wanted, most) = (self.wanted as f64, COUNTABLE);
        let mut best: Option<(f64, u64)> = None;
        let (mut tried, mut ends) = (vec![], [None; 2]);
        let mut count = (wanted / filled).round().max(1.0);
        for _ in 0..TRIES {
            let asked = count as u64;
            if tried.contains(&asked) {
                break;
            }
            tried.push(asked);
            let (points, levels, _) = make(asked)?;
            let lattice = levels.as_ref().map_or(self.store.frame.lattice, |l| l.cells().lattice);
            let set = match &levels {
                Some(levels) => PointSet::graded(points, lattice, Arc::clone(levels))?,
                None => PointSet::new(points, lattice)?,
            };
            if set.len() > most {
                if best.is_some() {
                    // Extrapolated from the largest set that can be counted.
                    best = Some((0.0, asked));
                    break;
                }
                count = (count * most as f64 / set.len() as f64 * 0.9).floor().max(1.0);
                continue;
            }
            let boundary = boundary_of(points, &levels, self.store, self.how, self.path)?;
            let made = valued(self.store, &set, &boundary)? as f64;
            self.how.cancel.check()?;
            let off = (made - wanted).abs();
            if best.is_none_or(|(least, _)| off < least) {
                best = Some((off, asked));
            }
            if off <= MET * wanted {
                break;
            }
            let counted = (asked as f64, made);
            ends[usize::from(made > wanted)] = Some(counted);
            count = match ends {
                [Some(few), Some(many)] => amount_between(wanted, few, many),
                _ => next_amount(wanted, counted.0, made, filled),
            }
            .round();
        }
        let asked = best.map_or(count as u64, |(_, asked)| asked);
        let (points, levels, found) = make(asked)?;
        let boundary = boundary_of(points, &levels, self.store, self.how, self.path)?;
        Ok((found, boundary))
    }
}

/// Points that the settings ask for, in a mesh of `vertices` vertices.
fn wanted_of(settings: &CompleteSettings, vertices: u64) -> f64 {
    settings.amount.of(vertices as f64)
}

/// The plan of reducing a mesh, its steps and the samples of its boundary still missing.
fn new_plan(
    mesh: &CellMesh,
    store: &CellStore,
    wanted: u64,
    settings: &CompleteSettings,
    offset: f64,
) -> Result<Plan> {
    let (lattice, geometry) = (store.frame.lattice, store.frame.geometry);
    let summary = MeshSource {
        vertices: store.census.vertices,
        tetrahedra: store.census.tetrahedra,
        point_hash: PlanHash(store.identity.points),
        cell_hash: PlanHash(store.identity.cells),
    };
    let source = Source {
        dims: lattice.dims,
        geometry,
        offset,
        mesh: Some(summary),
        // Each step has its own fingerprint.
        ..source_of(mesh, String::new())?
    };
    let mut plan = Plan::on_lattice(lattice, wanted, source, settings)?;
    plan.mesh.repeated = RepeatedRecord::of(store.firsts.pairs()?);
    Ok(plan)
}

/// The plan of an archive, and its last step as an example.
fn continued_plan(archive: &OpenArchive, settings: &CompleteSettings) -> Plan {
    let last = &archive.manifest.steps.last().expect("an archive that was opened has a step").plan;
    let (missing, keyframes) = (settings.finite_missing(), settings.keyframes);
    let step = StepPlan { quantiser: None, base: None, missing, keyframes, ..last.clone() };
    Plan { mesh: archive.manifest.plan.clone(), steps: vec![step] }
}

/// The samples of the boundary, or the vertices, that were found must be those of an archive.
fn expect_listed(archive: &OpenArchive, found: ExplicitRecord) -> Result<()> {
    let text = |r: &ExplicitRecord| format!("{} of hash {}", r.count, r.hash);
    match archive.manifest.plan.explicit {
        Some(listed) if listed == found => Ok(()),
        other => {
            let expected = other.as_ref().map_or("none".into(), text);
            Err(Error::bad_input(archive.path(), "listed points", expected, text(&found)).with_help(
                "the archive is of another version of isospan: reduce all steps at once with this one",
            ))
        }
    }
}

/// Plans all steps: the mesh of each must be that of the first, point by point and cell by cell.
fn plan_steps(
    first: &CellMesh,
    store: &CellStore,
    listed: &Arc<ExplicitPoints>,
    plan: Plan,
    job: &Job<'_>,
    how: &StoreSettings,
    inputs: Inputs<'_>,
) -> Result<SeriesPlan> {
    let archive = job.basis.archive();
    let repeated = (store.firsts.repeated > 0).then(|| Arc::clone(&store.firsts));
    let mut planner = StepPlanner {
        common: archive.map_or_else(|| Common::of_store(first, store), Common::of_archive),
        field: archive.map(|archive| {
            let plan = &archive.manifest.steps[0].plan;
            FieldOfSeries::new(plan.number, &plan.source.field)
        }),
        template: plan.first().clone(),
        read: ReadMesh {
            path: first.info().path.clone(),
            identity: store.identity,
            stored: if job.is_several() { first.stored_hash()? } else { None },
        },
        store,
        job,
        how,
        inputs,
    };
    let mut series = SeriesPlan {
        plan: Plan { steps: vec![], ..plan },
        sources: vec![],
        skipped: vec![],
        order: Order::default(),
        is_there: false,
        keyframes: job.settings.keyframes,
        attachments: Attachments { explicit: Some(Arc::clone(listed)), levels: None, repeated },
        watch: Watch::default(),
    };
    let mut first_error = None;
    for (number, source) in job.sources {
        let at_step = |e: Error| if job.is_several() { e.at_step(*number) } else { e };
        match planner.step(*number, source).map_err(at_step) {
            Ok(step) => {
                series.plan.steps.push(step);
                let source = source.clone();
                series.sources.push(PlannedSource::in_place(source));
            }
            Err(e) if job.run.keep_going && job.is_several() && is_of_data(&e) => {
                series.skip(*number, source, e.to_string());
                first_error.get_or_insert(e);
            }
            Err(e) => return Err(e),
        }
    }
    if series.plan.steps.is_empty() {
        return Err(first_error.unwrap_or_else(|| Error::usage("there is no step to reduce")));
    }
    series.watch = planner.inputs.watch;
    series.share_units(job)?;
    series.arrange(job)?;
    Ok(series)
}

/// The file whose points and cells were read last, which may have many steps.
struct ReadMesh {
    path: PathBuf,
    identity: Identity,
    /// The hash of them as they are stored: another file that stores the same ones need not be read
    /// for them.
    stored: Option<u128>,
}

/// Plans one step after another.
struct StepPlanner<'a> {
    common: Common,
    field: Option<FieldOfSeries>,
    /// What all steps have in common.
    template: StepPlan,
    read: ReadMesh,
    store: &'a CellStore,
    job: &'a Job<'a>,
    how: &'a StoreSettings,
    inputs: Inputs<'a>,
}

impl StepPlanner<'_> {
    /// The rounding of the values of a step.
    fn rounding(&self, number: u64, mesh: &CellMesh) -> Result<f64> {
        if let Some(plan) = self.job.basis.plan() {
            return Ok(plan.steps.iter().find(|s| s.number == number).map_or(0.0, |s| s.source.rounding));
        }
        let (offset, missing) = (Some(self.how.offset), self.job.settings.missing);
        Ok(Shift::of_mesh(mesh, offset, missing, self.how.memory, &self.how.cancel)?.rounding)
    }

    fn step(&mut self, number: u64, source: &StepSource) -> Result<StepPlan> {
        // Before its head is read.
        self.inputs.watch.add_named(&source.path)?;
        let mesh = open_mesh_of(source)?;
        if self.read.path != mesh.info().path {
            self.common.check_number(&mesh)?;
            let stored = mesh.stored_hash()?;
            if stored.is_none() || stored != self.read.stored {
                self.read.identity = Identity::of(&mesh, &self.how.cancel)?;
            }
            (self.read.path, self.read.stored) = (mesh.info().path.clone(), stored);
        }
        self.common.check(&mesh, self.read.identity)?;
        let fingerprint = self.inputs.fingerprint(number, &mesh.info().files(), &self.how.cancel)?;
        let found = source_of(&mesh, fingerprint)?;
        let field = self.field.get_or_insert_with(|| FieldOfSeries::new(number, &found.field));
        field.check(source, &found.field)?;
        let source_record = Source {
            path: found.path,
            fingerprint: found.fingerprint,
            format: found.format,
            scalar: found.scalar,
            field: found.field,
            rounding: self.rounding(number, &mesh)?,
            units: source.units(&found.units),
            ..self.template.source.clone()
        };
        let settings = self.job.settings;
        let quantiser = match self.job.basis.plan() {
            Some(plan) => plan.steps.iter().find(|s| s.number == number).and_then(|s| s.quantiser),
            None => match settings.value_bits {
                Some(bits) => {
                    let values = self.store.values_of(&mesh, self.how)?;
                    Some(quantiser(&values, bits)?.of(self.template.values))
                }
                None => None,
            },
        };
        Ok(StepPlan { number, time: source.time, source: source_record, quantiser, ..self.template.clone() })
    }
}

/// Steps of the range of the vertices' values.
fn quantiser(values: &Column<f32>, bits: f64) -> Result<Quantiser> {
    let values = values.get()?.iter().filter(|v| !v.is_nan());
    let range = values.fold([f32::INFINITY, f32::NEG_INFINITY], |[lo, hi], &v| [lo.min(v), hi.max(v)]);
    let range = if range[0] <= range[1] { range.map(|v| v + 0.0) } else { Default::default() };
    Ok(Quantiser::new(bits, range))
}

/// What the file says; lattice and geometry follow when it has been read.
fn source_of(mesh: &CellMesh, fingerprint: String) -> Result<Source> {
    let (info, field) = (mesh.info(), mesh.field()?);
    Ok(Source {
        path: info.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
        fingerprint,
        format: info.format.clone(),
        dims: [2; 3],
        scalar: field.scalar,
        field: field.name.clone(),
        geometry: isospan_io::grid::Geometry::default(),
        slope: 1.0,
        intercept: 0.0,
        missing: None,
        offset: 0.0,
        rounding: 0.0,
        mesh: None,
        // Formats of meshes name none.
        units: Units::default(),
    })
}
