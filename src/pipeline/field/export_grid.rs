//! `export` of a pyramid: the nodes of a level, in a region, as a file of samples for other
//! programs.
//!
//! ```text
//!  region ─▶ box of nodes ─▶ parts, decoded side by side ─▶ rows, each to its place in the file
//! ```
//!
//! Memory: a part for each thread.

use crate::pipeline::read::{Roi, RoiSpace, StepView, WorldBox, world_box};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Clock, Progress, Resources, Threads, in_order};
use isospan_io::formats::samples::{
    Anatomy, GridMeta, GridPlace, SampleField, SampleFile, SampleFormat, limits,
};
use isospan_io::grid::{Geometry, IndexBox};
use isospan_io::volume::ScalarType;
use isospan_io::volume::units::common;
use serde::Serialize;
use std::path::Path;

/// What is exported of a pyramid.
#[derive(Clone, Debug, Default)]
pub struct GridSettings {
    /// The fields whose values are written, of those that the archive has at the moment of the
    /// step; that of the step alone where none is named.
    pub fields: Vec<String>,
    /// The level: 0 is the finest.
    pub level: usize,
    /// Only nodes in this box, ends included.
    pub roi: Option<Roi>,
    /// Compresses the samples.
    pub compress: bool,
    /// Threads, memory, scratch folder, and what stops it.
    pub resources: Resources,
}

/// What an export of a pyramid wrote and read.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct GridReport {
    /// The fields whose values were written.
    pub fields: Vec<String>,
    /// The types of their samples, as NumPy calls them.
    pub types: Vec<&'static str>,
    /// The level, or the finest one.
    pub level: usize,
    /// Levels that were written.
    pub levels: u64,
    /// Steps that were written.
    pub steps: u64,
    /// Samples of that level along x, y, z.
    pub dims: [u64; 3],
    /// The sample of the source that the first one is.
    pub first: [u64; 3],
    /// Samples of the source from one to the next.
    pub stride: [u64; 3],
    /// Samples without a value, of all fields: NaN.
    pub void: u64,
    /// What has no place in the file, or is converted, a line each.
    pub notices: Vec<String>,
    /// Bytes read of segments.
    pub bytes_read: u64,
    /// Bytes of the files written.
    pub file_bytes: u64,
    /// Seconds of wall time.
    pub seconds: f64,
}

/// Samples along each axis of a part that is decoded at a time.
const PART: [u64; 3] = [256, 64, 64];
/// Nodes around a part that are needed for it, along each axis.
const MARGIN: u64 = 20;
/// Bytes that a node of a part takes, with those of coarser levels.
const BYTES: u64 = 16;

/// Writes the nodes of a level of a pyramid to a file: see
/// [`Step::write_grid`](crate::pipeline::Step::write_grid).
pub(in crate::pipeline) fn export_grid(
    archive: &StepView,
    settings: &GridSettings,
    out: &Path,
    format: SampleFormat,
    progress: &dyn Progress,
) -> Result<GridReport> {
    let start = Clock::start();
    let views = Views::of(archive, &settings.fields)?;
    let read_before = archive.bytes_read();
    let grid = LevelGrid::of(archive, settings.level, settings.roi.as_ref(), &settings.resources)?;
    let fields = views.all().map(|view| field_of(view, settings.level)).collect();
    let meta = GridMeta { place: grid.place(archive)?, fields, ..meta_of(&views, grid.dims()) };
    let scratch = settings.resources.scratch.as_deref();
    let file = SampleFile::create(out, format, &meta, settings.compress, scratch)?;
    let total = meta.samples()?.saturating_mul(meta.fields.len() as u64);
    progress.begin("export", total, "samples");
    if meta.place == GridPlace::Points {
        grid.write_points(archive, &file, &settings.resources)?;
    }
    let mut void = 0;
    for (n, view) in views.all().enumerate() {
        let write = |first, row: &[f32]| file.write_field(n, first, row);
        void += grid.each_row(view, &settings.resources, progress, write)?;
    }
    let threads = Threads::new(settings.resources.threads)?;
    let file_bytes = file.publish(pool_of(&threads), &settings.resources.cancel)?;
    Ok(GridReport {
        types: meta.fields.iter().map(|field| field.scalar.name()).collect(),
        notices: format.notices(&meta),
        fields: meta.fields.into_iter().map(|field| field.name).collect(),
        level: settings.level,
        levels: 1,
        steps: 1,
        dims: grid.dims(),
        first: grid.first(),
        stride: grid.stride(),
        void,
        bytes_read: archive.bytes_read() - read_before + views.others_read(),
        file_bytes,
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// The pool of some threads; none of the calling one.
pub(super) fn pool_of(threads: &Threads) -> Option<&rayon::ThreadPool> {
    match threads {
        Threads::Calling => None,
        Threads::Pool(pool) => Some(pool),
    }
}

/// The fields that are asked for, at one moment.
pub(super) struct Views<'a> {
    /// That of the question itself, where it names none.
    own: Option<&'a StepView>,
    named: Vec<StepView>,
}

impl<'a> Views<'a> {
    pub(super) fn of(archive: &'a StepView, fields: &[String]) -> Result<Self> {
        if let Some(twice) = (1..fields.len()).find(|&n| fields[..n].contains(&fields[n])) {
            return Err(Error::usage(format!("the field {} is asked for twice", fields[twice])));
        }
        let named = fields.iter().map(|name| archive.in_field(name)).collect::<Result<Vec<_>>>()?;
        Ok(Self { own: fields.is_empty().then_some(archive), named })
    }

    pub(super) fn all(&self) -> impl Iterator<Item = &StepView> {
        self.own.into_iter().chain(&self.named)
    }

    pub(super) fn others_read(&self) -> u64 {
        self.named.iter().map(StepView::value_bytes_read).sum()
    }
}

/// A grid of samples at the origin, of what all fields have in common.
fn meta_of(views: &Views<'_>, dims: [u64; 3]) -> GridMeta {
    let sources = || views.all().map(|view| &view.step().plan.source);
    let mut anatomies = sources().map(|source| Anatomy::of_format(&source.format));
    let first = anatomies.next().unwrap_or_default();
    let mut units = sources().next().map(|source| source.units.clone()).unwrap_or_default();
    units.value = common(sources().map(|source| source.units.value.clone()));
    let anatomy = if anatomies.all(|other| other == first) { first } else { Anatomy::Unknown };
    GridMeta { dims, place: GridPlace::Even(Geometry::default()), fields: vec![], units, anatomy }
}

/// A field, as a file states it: samples that are kept without loss have the type of the source.
pub(super) fn field_of(view: &StepView, level: usize) -> SampleField {
    let step = view.step();
    let (name, source) = (step.field().to_owned(), &step.plan.source);
    let is_exact =
        step.plan.wavelet.is_some_and(|w| w.correction.is_exact()) && level == 0 && !view.is_between();
    let floats = SampleField { is_labels: view.has_labels(), ..SampleField::floats(&name, source.offset) };
    let Some([lo, hi]) = step.value_range.filter(|_| is_exact) else { return floats };
    if source.scalar.is_float() || step.void_points > 0 || source.offset.fract() != 0.0 {
        let scalar = if source.scalar == ScalarType::F64 { ScalarType::F64 } else { floats.scalar };
        return SampleField { scalar, ..floats };
    }
    // Values, which may be others than the numbers that are stored.
    let values = [lo, hi].map(|v| source.offset as i128 + v as i128);
    let others = [ScalarType::I16, ScalarType::I32, ScalarType::I64, ScalarType::U64];
    let holds = |scalar: &ScalarType| {
        limits(*scalar).is_some_and(|[least, most]| values.iter().all(|v| (least..=most).contains(v)))
    };
    let scalar = std::iter::once(source.scalar).chain(others).find(holds);
    SampleField { scalar: scalar.unwrap_or(floats.scalar), ..floats }
}

/// The nodes of a level that are written.
pub(super) struct LevelGrid {
    level: usize,
    nodes: IndexBox,
    /// Samples of the source from one node to the next.
    stride: [u64; 3],
}

impl LevelGrid {
    pub(super) fn of(
        archive: &StepView,
        level: usize,
        roi: Option<&Roi>,
        resources: &Resources,
    ) -> Result<Self> {
        archive.expect_level_of_labels(level)?;
        let pyramid = &archive.pyramid()?.pyramid;
        if level > pyramid.coarsest() {
            return Err(Error::usage(format!(
                "there is no level {level}: the archive has levels 0 (the finest) to {}",
                pyramid.coarsest()
            )));
        }
        let [all, stride] = [pyramid.nodes(level), pyramid.stride(level)].map(|list| list.map(|n| n as u64));
        let source = &archive.step().plan.source;
        let nodes = match roi {
            None => IndexBox::whole(all),
            Some(roi) => {
                in_index_space(archive, roi, resources)?.nodes(&source.geometry, source.dims, all, stride)?
            }
        };
        Ok(Self { level, nodes, stride })
    }

    pub(super) fn dims(&self) -> [u64; 3] {
        self.nodes.dims()
    }

    /// Samples of the source from one to the next.
    pub(super) fn stride(&self) -> [u64; 3] {
        self.stride
    }

    /// The sample of the source that the first one is.
    pub(super) fn first(&self) -> [u64; 3] {
        std::array::from_fn(|a| self.nodes.lo[a] * self.stride[a])
    }

    /// The sample that a node is.
    fn sample(&self, node: [u64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| (node[a] * self.stride[a]) as f64)
    }

    /// Where the nodes lie, of a volume with a spacing.
    pub(super) fn geometry(&self, archive: &StepView) -> Geometry {
        let of = &archive.step().plan.source.geometry;
        Geometry {
            origin: of.to_world(self.sample(self.nodes.lo)),
            spacing: std::array::from_fn(|a| of.spacing[a] * self.stride[a] as f64),
            direction: of.direction,
        }
    }

    fn place(&self, archive: &StepView) -> Result<GridPlace> {
        let Some(map) = archive.coordinates()? else { return Ok(GridPlace::Even(self.geometry(archive))) };
        let Some(axes) = map.axes() else { return Ok(GridPlace::Points) };
        let along = |a: usize| {
            let nodes = self.nodes.lo[a]..self.nodes.hi[a];
            nodes.map(|n| axes[a][(n * self.stride[a]) as usize]).collect()
        };
        Ok(GridPlace::Axes([0, 1, 2].map(along)))
    }

    /// The values of a box of the samples that are written.
    pub(super) fn nodes_in(&self, view: &StepView, part: &IndexBox) -> Result<Vec<f32>> {
        let moved = |at: [u64; 3]| std::array::from_fn(|a| at[a] + self.nodes.lo[a]);
        view.nodes(self.level, &IndexBox { lo: moved(part.lo), hi: moved(part.hi) })
    }

    /// Writes where the nodes of a curvilinear grid lie.
    fn write_points(&self, archive: &StepView, file: &SampleFile, resources: &Resources) -> Result<()> {
        let (Some(map), [nx, ny, nz]) = (archive.coordinates()?, self.dims()) else { return Ok(()) };
        let mut row = Vec::with_capacity(nx as usize);
        for (z, y) in (0..nz).flat_map(|z| (0..ny).map(move |y| (z, y))) {
            resources.cancel.check()?;
            row.clear();
            for x in 0..nx {
                let node = |a: usize| self.nodes.lo[a] + [x, y, z][a];
                row.push(map.sample(std::array::from_fn(|a| node(a) * self.stride[a]))?);
            }
            file.write_points((z * ny + y) * nx, &row)?;
        }
        Ok(())
    }

    /// Hands the rows of all parts on, from any thread in any order, each with the number of its
    /// first sample. Returns how many samples have no value.
    fn each_row(
        &self,
        view: &StepView,
        resources: &Resources,
        progress: &dyn Progress,
        write: impl Fn(u64, &[f32]) -> Result<()> + Sync,
    ) -> Result<u64> {
        let [nx, ny, _] = self.dims();
        self.each_part(view, PART, resources, |at| {
            let lo: [u64; 3] = std::array::from_fn(|a| at[a] * PART[a]);
            let hi = std::array::from_fn(|a| (lo[a] + PART[a]).min(self.dims()[a]));
            let part = IndexBox { lo, hi };
            let (values, [width, height, _]) = (self.nodes_in(view, &part)?, part.dims());
            for (i, row) in values.chunks(width as usize).enumerate() {
                let (y, z) = (lo[1] + i as u64 % height, lo[2] + i as u64 / height);
                write((z * ny + y) * nx + lo[0], row)?;
            }
            progress.advance(values.len() as u64);
            Ok(values.iter().filter(|v| v.is_nan()).count() as u64)
        })
    }

    /// Calls `make` with the places of all parts of a size, from any thread in any order. Returns
    /// the sum of what it counts.
    pub(super) fn each_part(
        &self,
        view: &StepView,
        size: [u64; 3],
        resources: &Resources,
        make: impl Fn([u64; 3]) -> Result<u64> + Sync,
    ) -> Result<u64> {
        let counts: [u64; 3] = std::array::from_fn(|a| self.dims()[a].div_ceil(size[a]));
        let part_bytes = BYTES * size.iter().map(|n| n + MARGIN).product::<u64>();
        let fitting = usize::try_from((resources.memory / 2 / part_bytes).max(1)).unwrap_or(usize::MAX);
        let threads = view.pools.lend(resources.worker_threads().min(fitting))?;
        let parts = usize::try_from(counts.iter().product::<u64>()).unwrap_or(usize::MAX);
        let make = |n: usize| {
            resources.cancel.check()?;
            let n = n as u64;
            make([n % counts[0], n / counts[0] % counts[1], n / counts[0] / counts[1]])
        };
        let mut sum = 0;
        in_order(&vec![0; parts], 0, &threads, make, |_, counted| {
            sum += counted;
            Ok(())
        })?;
        Ok(sum)
    }
}

/// A region, where it is one of samples.
fn in_index_space(archive: &StepView, roi: &Roi, resources: &Resources) -> Result<Roi> {
    if roi.space == RoiSpace::Index {
        return Ok(*roi);
    }
    match world_box(archive, roi, &resources.cancel)? {
        None => Ok(*roi),
        Some(WorldBox::Index(roi)) => Ok(roi),
        Some(WorldBox::HalfSpaces(_)) => Err(Error::usage(format!(
            "{}: a box of the world is no box of samples of a curvilinear grid: give the region in numbers of \
             samples, `roi=I0:I1,J0:J1,K0:K1`",
            archive.path().display()
        ))),
    }
}
