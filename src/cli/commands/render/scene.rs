//! What is drawn: inputs are opened, surfaces extracted and cut, and shared out to panels.

use super::super::grammar::{AXES, Plane, Slab};
use super::super::step::colour_fields;
use super::plane::{Hull, Shown, Slice};
use super::{Args, Colours, Job};
use isospan::exec::Progress;
use isospan::formats::surface::load_surface;
use isospan::pipeline::{ArchiveSummary, LevelChoice, Step, StepChoice, StepSummary, is_archive};
use isospan::render::Paint;
use isospan::surface::SurfaceSource;
use isospan::surface::check::CheckSettings;
use isospan::surface::edit::clip::{HalfSpace, clip};
use isospan::surface::weld::{BuilderSettings, StoredSurface};
use isospan::volume::units::{Unit, common};
use isospan::{Archive, Error, Resources, Result};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Surfaces of a picture or an animation, at most: each may have two files open.
const MOST_SURFACES: usize = 256;
/// Planes of a picture, at most.
const MOST_SLICES: usize = 16;

/// A surface of a panel.
pub(super) struct Shape {
    pub(super) isovalue: Option<f64>,
    /// None where there is no triangle.
    pub(super) surface: Option<StoredSurface>,
    /// The distance of each vertex, or its value of another field, where they are asked for.
    pub(super) values: Vec<f32>,
    pub(super) paint: Paint,
    pub(super) opacity: f32,
}

impl Shape {
    pub(super) fn source(&self) -> Option<&dyn SurfaceSource> {
        self.surface.as_ref().map(|s| s as &dyn SurfaceSource)
    }
}

/// What is in a panel.
pub(super) struct Panel {
    /// The input.
    pub(super) name: String,
    /// The frame that it is in; none where it is in all of them.
    pub(super) frame: Option<usize>,
    pub(super) shapes: Vec<Shape>,
    /// Planes on which the field is shown.
    pub(super) slices: Vec<Slice>,
    /// The step of an archive.
    pub(super) moment: Option<Moment>,
    /// The unit of lengths, where the file or the archive names one.
    pub(super) length: Option<Unit>,
    /// Whether it is a flat picture of a plane.
    pub(super) flat: bool,
}

impl Panel {
    /// The unit of the isovalues.
    pub(super) fn value_unit(&self) -> Option<&Unit> {
        self.moment.as_ref()?.step.units().value.as_ref()
    }

    /// The unit of lengths.
    pub(super) fn length_unit(&self) -> Option<&Unit> {
        self.length.as_ref()
    }
}

/// A step of an archive, and the field that colours show: its own, or another one.
#[derive(Clone)]
pub(super) struct Moment {
    pub(super) step: Rc<Step>,
    pub(super) field: Rc<Step>,
    /// The level of a pyramid that is drawn, where one is chosen.
    pub(super) level: Option<u32>,
    /// Which it is, where there are several: its number, and words.
    pub(super) name: Option<(u64, String)>,
}

impl Moment {
    /// What planes show: the field at its level, or another field at its finest one.
    pub(super) fn shown<'a>(&'a self, colours: &'a Colours) -> Shown<'a> {
        let level = self.level.filter(|_| Rc::ptr_eq(&self.step, &self.field));
        Shown { step: &self.field, level: level.map(LevelChoice::Level), colours }
    }
}

/// An input, opened.
pub(super) enum Input {
    Surface(PathBuf),
    Archive(Box<Opened>),
}

/// An archive, and what is asked of it.
pub(super) struct Opened {
    name: PathBuf,
    /// Steps or a time.
    moments: Vec<Moment>,
    isovalues: Vec<f64>,
    /// The box of the domain; none for a grid that has coordinates of its own.
    hull: Option<Hull>,
    slices: Vec<Slice>,
}

/// A moment that is asked for, and of a series its number and name.
type Chosen = (StepChoice, Option<(u64, String)>);

/// The steps of an archive that are drawn.
fn choices(path: &Path, args: &Args, about: &ArchiveSummary) -> Result<Vec<Chosen>> {
    let Some(range) = args.step_range() else { return Ok(vec![(args.step.choice()?, None)]) };
    let field = args.step.field();
    let of = |s: &StepSummary| {
        let choice = match &field {
            None => StepChoice::Number(s.number),
            Some(field) => StepChoice::NumberOf(s.number, field.clone()),
        };
        let words = match s.time {
            Some(time) => format!("time {}", super::with_unit(time, about.units.time.as_ref())),
            None => format!("step {}", s.number),
        };
        (choice, Some((s.number, words)))
    };
    let is_of_field = |s: &&StepSummary| field.as_ref().is_none_or(|field| *field == s.field);
    let found = about.steps.iter().filter(|s| range.contains(s.number)).filter(is_of_field);
    let choices: Vec<Chosen> = found.map(of).collect();
    if choices.is_empty() {
        let [first, last] = [about.steps.first(), about.steps.last()].map(|s| s.map_or(0, |s| s.number));
        let path = path.display();
        return Err(Error::usage(format!(
            "{path}: no step in that range; it has the steps {first} to {last}"
        )));
    }
    Ok(choices)
}

/// Where a plane cuts the domain of an archive.
fn slice_of(path: &Path, plane: &Plane, hull: Option<Hull>) -> Result<Slice> {
    let path = path.display();
    let hull = hull
        .ok_or_else(|| Error::usage(format!("{path}: --slice is not possible on a grid with coordinates")))?;
    let ends = [hull[0][plane.axis], hull[1][plane.axis]];
    let at = plane.at.of(Some(ends))?;
    if at < ends[0] || at > ends[1] {
        let axis = AXES[plane.axis];
        return Err(Error::usage(format!(
            "{path}: the plane {axis}={at} lies outside the domain, {axis} = {} to {}",
            super::words_of(ends[0]),
            super::words_of(ends[1])
        )));
    }
    // A middle that rounding moves off 0 is 0.
    let at = if at.abs() < 1e-12 * (ends[1] - ends[0]) { 0.0 } else { at };
    Ok(Slice { axis: plane.axis, at, hull })
}

impl Input {
    pub(super) fn open(path: &Path, args: &Args, resources: &Resources) -> Result<Self> {
        if !is_archive(path) {
            return Ok(Self::Surface(path.to_path_buf()));
        }
        let archive = Archive::open(path)?.keeping(0);
        let about = archive.info()?;
        let choices = choices(path, args, &about)?;
        let range = args.step.value_range(&archive, args.step_range())?;
        let isovalues: Vec<f64> = args.isovalue.iter().map(|v| v.of(range)).collect::<Result<_>>()?;
        if let Some(n) = (1..isovalues.len()).find(|&n| isovalues[..n].contains(&isovalues[n])) {
            let text = format!("{}: the isovalue {} is there twice", path.display(), isovalues[n]);
            return Err(Error::usage(text));
        }
        let hull = about.grid_cells.is_none().then(|| {
            let ends = about.dims.map(|d| d.saturating_sub(1) as f64);
            let corner = |n: usize| [0, 1, 2].map(|a| if n >> a & 1 == 1 { ends[a] } else { 0.0 });
            hull_of((0..8).map(|n| about.geometry.to_world(corner(n))))
        });
        let slices = args.slice.iter().map(|plane| slice_of(path, plane, hull));
        let slices = slices.collect::<Result<Vec<_>>>()?;
        let asked = choices.iter().map(|(choice, _)| choice.clone());
        let fields = args.colour_by.as_ref().map(|by| colour_fields(by, &archive, asked)).transpose()?;
        let mut fields = fields.into_iter().flatten().map(Rc::new);
        let moment = |(choice, name)| {
            let step = Rc::new(archive.at(choice)?);
            let field = fields.next().unwrap_or_else(|| step.clone());
            let query = step.query(&isovalues).level(args.level.choice()).resources(resources.clone());
            let level = args.level.choice().map(|_| query.chosen_level()).transpose()?;
            Ok(Moment { step, field, level, name })
        };
        let moments = choices.into_iter().map(moment).collect::<Result<_>>()?;
        let name = path.to_path_buf();
        Ok(Self::Archive(Box::new(Opened { name, moments, isovalues, hull, slices })))
    }

    /// How many steps of it are drawn.
    pub(super) fn moments(&self) -> usize {
        match self {
            Self::Surface(_) => 1,
            Self::Archive(opened) => opened.moments.len(),
        }
    }

    /// How many panels a step of it has.
    pub(super) fn panels(&self, args: &Args) -> usize {
        match self {
            Self::Surface(_) => 1,
            Self::Archive(_) if args.isovalue.is_empty() => args.slice.len(),
            Self::Archive(_) if args.together => 1,
            Self::Archive(_) => args.isovalue.len(),
        }
    }
}

impl Opened {
    /// The name of the field that colours show.
    pub(super) fn colour_field(&self) -> &str {
        self.moments[0].field.field()
    }

    /// The unit of the field that colours show, where all its steps have the same.
    pub(super) fn colour_unit(&self) -> Option<Unit> {
        common(self.moments.iter().map(|moment| moment.field.units().value.clone()))
    }

    /// Least and largest value of the field that colours show.
    pub(super) fn colour_range(&self) -> Option<[f64; 2]> {
        let ranges = self.moments.iter().filter_map(|moment| moment.field.value_range());
        ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
    }
}

fn hull_of(points: impl Iterator<Item = [f64; 3]>) -> Hull {
    let mut hull = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for p in points {
        for a in 0..3 {
            (hull[0][a], hull[1][a]) = (hull[0][a].min(p[a]), hull[1][a].max(p[a]));
        }
    }
    hull
}

/// How the surfaces of all panels look.
struct Looks<'a> {
    args: &'a Args,
    /// Number of the next surface; all of them.
    next: usize,
    count: usize,
}

impl Looks<'_> {
    /// The choice for the surface that comes next: one for all, one for each isovalue of an archive
    /// (`place` in them), or one for each surface.
    fn choice<T: Copy>(&self, all: &[T], place: Option<usize>, flag: &str) -> Result<Option<T>> {
        let isovalues = self.args.isovalue.len();
        match (all.len(), place) {
            (0, _) => Ok(None),
            (1, _) => Ok(Some(all[0])),
            (n, _) if n == self.count => Ok(Some(all[self.next])),
            (n, Some(place)) if n == isovalues => Ok(Some(all[place])),
            (n, None) if n == isovalues => Ok(Some(all[0])),
            (n, _) => Err(Error::usage(format!(
                "{n} values of {flag} for {} surfaces: give one for all, one for each isovalue, or one for each surface",
                self.count
            ))),
        }
    }

    fn take(&mut self, place: Option<usize>) -> Result<(Paint, f32)> {
        let paint = self.choice(&self.args.colour, place, "--colour")?;
        let opacity = self.choice(&self.args.opacity, place, "--opacity")?.unwrap_or(1.0);
        // Where surfaces share a panel, a colour map tells them apart.
        let last = self.args.isovalue.len().saturating_sub(1);
        let usual = match place {
            Some(place) if self.args.together && last > 0 => {
                Paint::Plain(self.args.colour_map.colour(place as f64 / last as f64))
            }
            _ => Paint::Plain([0xd8, 0xcb, 0xb4]),
        };
        self.next += 1;
        Ok((paint.unwrap_or(usual), opacity))
    }
}

impl Job<'_> {
    /// Opens all inputs, and refuses what does not go together.
    pub(super) fn open(&self) -> Result<Vec<Input>> {
        let args = self.args;
        let archives = args.inputs.iter().filter(|i| is_archive(i)).count();
        if archives > 0 && args.isovalue.is_empty() && args.slice.is_empty() {
            return Err(Error::usage(
                "an archive is drawn at an isovalue or on a plane: give --isovalue (isospan info suggests some) or --slice",
            ));
        }
        let series = args.step_range().is_some() || args.step.is_given();
        for (given, flag) in [
            (args.colour_by.is_some(), "--colour-by"),
            (!args.isovalue.is_empty(), "--isovalue"),
            (!args.slice.is_empty(), "--slice"),
            (args.together, "--together"),
            (series, "a step or a time"),
        ]
        .into_iter()
        .chain(args.level.given())
        {
            if archives == 0 && given {
                return Err(Error::usage(format!("{flag} is for archives")));
            }
        }
        if args.slice.len() > MOST_SLICES {
            return Err(Error::usage(format!(
                "{} planes are too many: at most {MOST_SLICES}",
                args.slice.len()
            )));
        }
        let resources = self.resources(0);
        let inputs =
            args.inputs.iter().map(|path| Input::open(path, args, &resources)).collect::<Result<Vec<_>>>()?;
        let surfaces = |i: &Input| match i {
            Input::Surface(_) => 1,
            Input::Archive(opened) => opened.moments.len() * opened.isovalues.len(),
        };
        let count: usize = inputs.iter().map(surfaces).sum();
        if count > MOST_SURFACES {
            return Err(Error::usage(format!(
                "{count} surfaces are too many for a picture: at most {MOST_SURFACES}; take fewer steps or isovalues"
            )));
        }
        Ok(inputs)
    }

    /// Reads all surfaces, and extracts those of archives.
    pub(super) fn panels(
        &self,
        inputs: &[Input],
        steps_are_frames: bool,
        progress: &dyn Progress,
    ) -> Result<Vec<Panel>> {
        let args = self.args;
        let isovalues = args.isovalue.len();
        let each = |i: &Input| match i {
            Input::Surface(_) => 1,
            Input::Archive(_) => isovalues,
        };
        let held: usize = inputs.iter().map(|i| i.moments() * each(i)).sum();
        let check = CheckSettings { memory: self.memory / held.max(1) as u64, scratch: self.scratch.clone() };
        let mut looks = Looks { args, next: 0, count: inputs.iter().map(each).sum() };
        let mut panels = vec![];
        for input in inputs {
            match input {
                Input::Surface(path) => panels.push(self.panel_of_file(path, &check, &mut looks)?),
                Input::Archive(opened) => {
                    let first = looks.next;
                    for (n, moment) in opened.moments.iter().enumerate() {
                        // Every step looks as the first does.
                        looks.next = first;
                        let shapes = self.extract(opened, moment, &check, &mut looks, progress)?;
                        panels.extend(self.panels_of(opened, moment, steps_are_frames.then_some(n), shapes));
                    }
                }
            }
        }
        let is_empty = |p: &Panel| p.slices.is_empty() && p.shapes.iter().all(|s| s.surface.is_none());
        if panels.iter().all(is_empty) {
            return Err(Error::usage("there is nothing to draw: no surface lies on the kept side of --clip"));
        }
        Ok(panels)
    }

    fn panel_of_file(&self, path: &Path, check: &CheckSettings, looks: &mut Looks<'_>) -> Result<Panel> {
        let surface = load_surface(path, check).map_err(|e| self.whole(e, check.memory))?;
        let length = surface.units().length.clone();
        let surface = self.cut(surface, None, check)?;
        let (paint, opacity) = looks.take(None)?;
        Ok(Panel {
            name: path.display().to_string(),
            moment: None,
            length,
            frame: None,
            shapes: vec![Shape { isovalue: None, surface, values: vec![], paint, opacity }],
            slices: vec![],
            flat: false,
        })
    }

    /// The panels of a step: its surfaces together or each alone, with the planes among them; or
    /// planes alone.
    fn panels_of(
        &self,
        opened: &Opened,
        moment: &Moment,
        frame: Option<usize>,
        shapes: Vec<Shape>,
    ) -> Vec<Panel> {
        let panel = |shapes, slices, flat| Panel {
            name: opened.name.display().to_string(),
            moment: Some(moment.clone()),
            length: moment.step.units().length.clone(),
            frame,
            shapes,
            slices,
            flat,
        };
        let slices = || opened.slices.clone();
        match shapes {
            none if none.is_empty() => opened.slices.iter().map(|s| panel(vec![], vec![*s], true)).collect(),
            all if self.args.together => vec![panel(all, slices(), false)],
            each => each.into_iter().map(|shape| panel(vec![shape], slices(), false)).collect(),
        }
    }

    /// The isosurfaces of a step, by way of files in the scratch folder.
    fn extract(
        &self,
        opened: &Opened,
        moment: &Moment,
        check: &CheckSettings,
        looks: &mut Looks<'_>,
        progress: &dyn Progress,
    ) -> Result<Vec<Shape>> {
        if opened.isovalues.is_empty() {
            return Ok(vec![]);
        }
        let folder = tempfile::tempdir_in(&self.scratch)
            .map_err(|e| Error::io("make a temporary folder in", &self.scratch, e))?;
        let memory = self.memory / 8 * 7;
        let resources = Resources::default()
            .with_threads(self.args.machine.threads)
            .with_memory(memory)
            .with_cancel(self.cancel.clone());
        let level = moment.level.map(LevelChoice::Level);
        let query = moment.step.query(&opened.isovalues).level(level).resources(resources);
        let report = query.progress(progress).write(folder.path().join("surface_{}.ply"));
        let report = report.map_err(|e| self.whole(e, memory))?;
        let several = opened.moments.len() > 1;
        let mut shapes = vec![];
        for (place, (found, &isovalue)) in report.surfaces.iter().zip(&opened.isovalues).enumerate() {
            let surface = if found.triangles > 0 {
                let surface = load_surface(&found.file, check).map_err(|e| self.whole(e, check.memory))?;
                self.cut(surface, Some(opened), check)?
            } else if several {
                // At another step there may be one.
                None
            } else {
                let archive = opened.name.display();
                return Err(Error::usage(format!("{archive}: the isovalue {isovalue} gives no surface")));
            };
            let (paint, opacity) = looks.take(Some(place))?;
            shapes.push(Shape { isovalue: Some(isovalue), surface, values: vec![], paint, opacity });
        }
        Ok(shapes)
    }

    /// Cuts a surface at the planes of `--clip`; none where nothing stays.
    fn cut(
        &self,
        surface: StoredSurface,
        of: Option<&Opened>,
        check: &CheckSettings,
    ) -> Result<Option<StoredSurface>> {
        let slabs = &self.args.clip;
        if slabs.is_empty() {
            return Ok(Some(surface));
        }
        let (mut own, origin) = ([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]], surface.origin());
        surface.vertices(&mut |batch| {
            let hull = hull_of(batch.iter().map(|v| v.world(origin)).chain(own));
            own = hull;
            Ok(())
        })?;
        let hull = of.map_or(Some(own), |opened| opened.hull);
        let scale = [0, 1, 2].map(|a| own.map(|corner| (corner[a] - origin[a]).abs()));
        let scale = scale.map(|[lo, hi]| lo.max(hi));
        let mut half_spaces = vec![];
        for slab in slabs {
            let Slab { axis, range } = *slab;
            if range.is_of_a_range() && hull.is_none() {
                return Err(Error::usage(
                    "--clip in % is not possible on a grid with coordinates: give places in world units",
                ));
            }
            let ends = range.of(hull.map(|h| [h[0][axis], h[1][axis]]))?;
            for (end, sign) in [(ends[0], 1.0), (ends[1], -1.0)] {
                if end.is_finite() {
                    let mut normal = [0.0; 3];
                    normal[axis] = sign;
                    half_spaces.push(HalfSpace::new(normal, sign * end, scale));
                }
            }
        }
        let settings = BuilderSettings {
            memory_bytes: usize::try_from(check.memory / 8).unwrap_or(usize::MAX),
            scratch: self.scratch.clone(),
        };
        let memory = self.memory / 2;
        let cut = clip(&surface, &half_spaces, &settings, memory).map_err(|e| self.whole(e, memory))?;
        Ok(Some(cut).filter(|s| s.triangle_count() > 0))
    }
}
