//! The plan of a reduction: everything that decides the bytes of the archive, and nothing else.
//!
//! Threads, memory, folders and restarts are not in it. It has two parts
//! ([`crate::archive::manifest`]): what decides the mesh, the same for all fields and steps, and
//! what decides the values of a step. Segments carry the hash of what they depend on, so a segment
//! of another plan is never used for this one.

mod attachments;
pub(super) mod estimate;
mod finding;
mod fingerprint;
mod layout;
mod shard;

use crate::archive::manifest::{
    BLOCK_TETS, FrameRecord, LONGEST_CHAIN, Manifest, MeshPlan, OwnRecord, Source, StepPlan,
};
use crate::archive::segment::PlanHash;
use crate::archive::tables::{ExplicitRecord, LevelsRecord};
use crate::archive::values::Quantiser;
use crate::pipeline::settings::{Amount, CompleteSettings, Target};
pub(super) use attachments::Attachments;
pub(super) use estimate::{
    ERROR_WINDOW, Halo, Held, MOST_SMALL_STEPS_AT_ONCE, MOST_STEPS_AT_ONCE, Need, Question, Shares,
    SurfaceShares, free_bytes, need_of, part_edge,
};
pub use estimate::{Estimate, SearchEstimate};
pub use finding::{Finding, Notice};
pub use fingerprint::fingerprint;
pub(super) use fingerprint::{Inputs, RecordedFile, Watch};
use isospan_io::error::{Error, Result};
use isospan_io::geom::curve::Order;
use isospan_io::geom::{Lattice, LatticeBox};
use isospan_io::grid::{BrickGrid, BrickId, ChunkGrid};
use isospan_io::volume::VolumeInfo;
use isospan_mesh::points::{ExplicitPoints, Levels, PointSet, PointSpec, SetKind};
use isospan_mesh::sample::{Interpolation, Values};
pub(super) use layout::{Layout, folder_bytes};
use serde::{Deserialize, Serialize};
pub use shard::Shard;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// The part of a plan that stays the same, so that its chunks do.
pub(super) struct PlanFrame {
    pub(super) brick_edge: [u64; 3],
    pub(super) order_bits: u32,
    pub(super) record: FrameRecord,
}

/// The plan of a reduction: the mesh, and what is sampled on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// What decides the mesh; the same for all fields and steps.
    pub mesh: MeshPlan,
    /// What decides the values of each step, by ascending numbers; at least one.
    pub steps: Vec<StepPlan>,
}

/// Points of a brick, about: few enough that a query enumerates little more than it needs, and
/// enough that the cost of starting an enumeration is negligible.
const BRICK_POINTS: f64 = 1024.0;
/// Tetrahedra for a point of a Delaunay mesh, about.
const TETS_A_POINT: u64 = 6;
/// Bricks of own vertices have at most this many times as many points, as long as they can be
/// halved.
const MOST_CROWD: f64 = 4.0;
/// A brick's samples (with a border) are held in memory while its points are interpolated.
const LARGEST_BRICK_EDGE: u64 = 64;

/// Refuses settings that no input can meet.
fn check_settings(settings: &CompleteSettings) -> Result<()> {
    if let Some(bits) = settings.value_bits.filter(|bits| !Quantiser::BITS.contains(bits)) {
        let (least, most) = Quantiser::BITS.into_inner();
        return Err(Error::usage(format!("values have {least} to {most} bits, not {bits}")));
    }
    if settings.values == Values::Fit && settings.interpolation == Interpolation::Nearest {
        return Err(Error::usage(
            "nearest gives points the very values of samples, and fitting gives them others: choose `values=sample`, or `interpolation=linear`",
        ));
    }
    if settings.chunk_points < 100 {
        return Err(Error::usage(
            "a chunk of fewer than 100 points is all halo: give `chunk_points` at least 100",
        ));
    }
    if !(1..=LONGEST_CHAIN + 1).contains(&settings.keyframes) {
        return Err(Error::usage(format!(
            "every 1st to {}th step can be a keyframe, not every {}th",
            LONGEST_CHAIN + 1,
            settings.keyframes
        )));
    }
    Ok(())
}

impl Plan {
    /// The plan of reducing a volume, whose files have this fingerprint.
    ///
    /// # Errors
    /// [`Error::Usage`] for settings that cannot be met; [`Error::BadInput`] for a volume without
    /// extent or place.
    pub(super) fn of_volume(
        info: &VolumeInfo,
        settings: &CompleteSettings,
        fingerprint: String,
    ) -> Result<Self> {
        let lattice = Lattice::new(info.dims).map_err(|e| {
            Error::bad_input(&info.path, "dimensions", "2 to 2^24 + 1 samples along each axis", e.to_string())
        })?;
        if !info.geometry.is_valid() {
            return Err(Error::bad_input(
                &info.path,
                "spacing, origin and direction",
                "finite numbers that give each axis a length and a direction of its own",
                format!("{:?}", info.geometry),
            ));
        }
        let count = count_of(settings, info.dims);
        if !settings.interpolation.is_of_volumes() {
            return Err(Error::usage(format!(
                "{} interpolation is for tetrahedral meshes; {} is a volume",
                settings.interpolation,
                info.path.display()
            )));
        }
        Self::on_lattice(lattice, count, source_of(info, fingerprint), settings)
    }

    /// A plan for a number of points on a lattice.
    pub(crate) fn on_lattice(
        lattice: Lattice,
        count: u64,
        source: Source,
        settings: &CompleteSettings,
    ) -> Result<Self> {
        check_settings(settings)?;
        let samples = lattice.dims.iter().map(|&d| d as f64).product::<f64>();
        let points = PointSpec::with_count(settings.points, &lattice, count, &settings.set)?;
        let total = PointSet::new(points, lattice)?.len();
        let edge = libm::cbrt(samples / total as f64 * BRICK_POINTS).round() as u64;
        let mut mesh = MeshPlan {
            lattice,
            points,
            order_bits: Order::for_count(total).bits,
            brick_edge: [edge.clamp(1, LARGEST_BRICK_EDGE); 3],
            chunk_target: settings.chunk_points,
            block_tets: BLOCK_TETS,
            explicit: None,
            own: None,
            levels: None,
            repeated: None,
            frame: None,
            stars: settings.values == Values::Fit,
        };
        if mesh.points.kind() == SetKind::Pyramid {
            (mesh.brick_edge, mesh.stars) = ([isospan_wavelet::CHUNK as u64; 3], false);
        }
        if settings.target == Some(Target::Labels) {
            mesh.points = PointSpec::Labels { dims: lattice.dims };
        }
        let step = StepPlan {
            number: 0,
            time: None,
            source,
            interpolation: settings.interpolation,
            values: settings.values,
            nan: settings.nan.to_string(),
            missing: settings.finite_missing(),
            quantiser: None,
            wavelet: None,
            keyframes: settings.keyframes,
            measured: false,
            base: None,
        };
        Ok(Self { mesh, steps: vec![step] })
    }

    /// Makes the points denser in some places than in others: n of them at level 0 in the whole
    /// domain, on the lattice of the levels; in the frame of an earlier plan.
    ///
    /// # Errors
    /// [`Error::Usage`] for more points than a set may have.
    pub(super) fn adapt(&mut self, n: u64, levels: &Arc<Levels>, frame: Option<&PlanFrame>) -> Result<()> {
        let (mesh, spec) = (&mut self.mesh, PointSpec::Halton { n });
        mesh.lattice = levels.cells().lattice;
        PointSet::graded(spec, mesh.lattice, Arc::clone(levels))?;
        mesh.points = spec;
        mesh.levels = Some(LevelsRecord::of(levels));
        mesh.frame = frame.map(|f| f.record.clone());
        (mesh.brick_edge, mesh.order_bits) = match frame {
            Some(frame) => (frame.brick_edge, frame.order_bits),
            None => (Self::brick_edge(mesh, levels), Order::for_count(n << levels.top()).bits),
        };
        Ok(())
    }

    /// Makes points and tetrahedra those of a mesh. Nothing is fitted: the values are those of the
    /// vertices.
    ///
    /// # Errors
    /// As [`PointSet::new`].
    pub(super) fn keep_own(&mut self, listed: &Arc<ExplicitPoints>, own: OwnRecord) -> Result<()> {
        let (mesh, spec) = (&mut self.mesh, PointSpec::Own { n: listed.len() });
        let points = PointSet::new(spec, mesh.lattice)?.with_explicit(Arc::clone(listed));
        mesh.points = spec;
        mesh.order_bits = Order::for_count(points.len()).bits;
        mesh.explicit = Some(ExplicitRecord::of(listed));
        mesh.own = Some(own);
        mesh.stars = false;
        let samples = mesh.lattice.dims.iter().map(|&d| d as f64).product::<f64>();
        let edge = libm::cbrt(samples / points.len() as f64 * BRICK_POINTS).round() as u64;
        mesh.brick_edge = [edge.clamp(1, LARGEST_BRICK_EDGE); 3];
        // Where vertices crowd in some places, smaller bricks.
        while mesh.brick_edge[0] > 1 && crowd(&mesh.bricks(), listed) > MOST_CROWD * BRICK_POINTS {
            mesh.brick_edge = mesh.brick_edge.map(|edge| edge.div_ceil(2));
        }
        self.steps.iter_mut().for_each(|step| step.values = Values::Sample);
        Ok(())
    }

    /// The edges of a brick of about a thousand points, as most points see them.
    pub(super) fn brick_edge(mesh: &MeshPlan, levels: &Levels) -> [u64; 3] {
        let (mut points, mut squares) = (0.0, 0.0);
        for (density, &voxels) in Self::densities(mesh, levels).into_iter().zip(&levels.voxels_by_level()) {
            points += density * voxels as f64;
            squares += density * density * voxels as f64;
        }
        let edge = libm::cbrt(BRICK_POINTS * points / squares);
        mesh.lattice.cube().map(|a| ((edge * a).round() as u64).clamp(1, LARGEST_BRICK_EDGE))
    }

    /// Points to a voxel at each level.
    pub(super) fn densities(mesh: &MeshPlan, levels: &Levels) -> Vec<f64> {
        let n = match mesh.points {
            PointSpec::Halton { n } => n as f64,
            _ => unreachable!("levels are those of a Halton set"),
        };
        let voxels = mesh.lattice.dims.iter().map(|&d| (d - 1) as f64).product::<f64>();
        (0..=levels.top()).map(|l| n / voxels * (1u64 << l) as f64).collect()
    }

    /// The first step, for what all steps have in common.
    pub fn first(&self) -> &StepPlan {
        self.steps.first().expect("a plan has a step")
    }

    /// The hash that mesh segments carry.
    pub fn mesh_hash(&self) -> PlanHash {
        self.mesh.hash()
    }

    /// The hash that the value and index segments of the `n`-th step of the plan carry.
    pub fn step_hash(&self, n: usize) -> PlanHash {
        self.steps[n].hash(self.mesh_hash())
    }

    /// The fingerprints of the sources, by the numbers of their steps.
    pub(in crate::pipeline) fn fingerprints(&self) -> BTreeMap<u64, &str> {
        self.steps.iter().map(|step| (step.number, &*step.source.fingerprint)).collect()
    }

    /// A hash of all steps.
    pub fn steps_hash(&self) -> PlanHash {
        let mesh = self.mesh_hash();
        let all: Vec<String> = self.steps.iter().map(|s| s.hash(mesh).to_string()).collect();
        PlanHash::of(all.concat().as_bytes())
    }

    /// Whether a manifest is that of this plan: the same mesh, the same steps.
    pub(super) fn is_of(&self, manifest: &Manifest) -> bool {
        manifest.plan_hash == self.mesh_hash() && manifest.steps.iter().map(|s| &s.plan).eq(&self.steps)
    }

    /// Whether a manifest is that of this plan, but for the units of its steps, on which no other
    /// file depends.
    pub(super) fn is_but_for_units(&self, manifest: &Manifest) -> bool {
        let mut unlike = self.clone();
        for (step, theirs) in unlike.steps.iter_mut().zip(&manifest.steps) {
            step.source.units.clone_from(&theirs.plan.source.units);
        }
        unlike.is_of(manifest)
    }
}

/// Points of a brick, as the mean point sees them.
fn crowd(bricks: &BrickGrid, listed: &ExplicitPoints) -> f64 {
    let mut counts: HashMap<BrickId, u64> = HashMap::new();
    for &p in listed.positions() {
        *counts.entry(bricks.id(bricks.brick_at(p))).or_default() += 1;
    }
    let squares: u128 = counts.values().map(|&n| u128::from(n) * u128::from(n)).sum();
    squares as f64 / listed.len() as f64
}

/// The number of interior points that is wanted of a volume.
pub(super) fn count_of(settings: &CompleteSettings, dims: [u64; 3]) -> u64 {
    match settings.amount {
        Amount::Count(n) => n,
        part => part.of(dims.iter().map(|&d| d as f64).product::<f64>()).round().max(1.0) as u64,
    }
}

/// The source, as far as it decides the bytes: its name without folders, and a fingerprint of its
/// content.
pub(super) fn source_of(info: &VolumeInfo, fingerprint: String) -> Source {
    Source {
        path: info.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
        fingerprint,
        format: info.format.clone(),
        dims: info.dims,
        scalar: info.field.scalar,
        field: info.field.name.clone(),
        geometry: info.geometry,
        slope: info.slope,
        intercept: info.intercept,
        missing: info.missing.filter(|m| m.is_finite()),
        offset: 0.0,
        rounding: 0.0,
        mesh: None,
        units: info.units.clone(),
    }
}

/// The most points of a brick, which are enumerated and meshed at once: four thousand times the
/// usual number.
const MOST_BRICK_POINTS: u128 = 1 << 22;

/// Whether the points of a brick can be enumerated: a set may crowd some bricks far above the mean.
///
/// # Errors
/// [`Error::Usage`] that states the number of points.
pub(crate) fn check_brick(points: &PointSet, brick: &LatticeBox) -> Result<()> {
    let n = points.count_in(brick);
    if u128::from(n) > MOST_BRICK_POINTS {
        return Err(Error::usage(format!(
            "a brick at {:?} has {n} points; at most {MOST_BRICK_POINTS} are possible: choose fewer points",
            brick.lo
        )));
    }
    Ok(())
}

/// The grids and the point set that a plan of a mesh describes.
pub(crate) struct MeshParts {
    pub(crate) points: PointSet,
    pub(crate) chunks: ChunkGrid,
    pub(crate) order: Order,
    pub(crate) halo: Halo,
    /// How many times more each point needs than in a Delaunay mesh: there are that many times more
    /// tetrahedra.
    pub(crate) times: u64,
}

/// Makes the parts of a plan, which may come from a file, and of what is stored with it.
///
/// # Errors
/// [`Error::Usage`] when a parameter is out of range.
pub(crate) fn parts(plan: &MeshPlan, attachments: Attachments) -> Result<MeshParts> {
    Lattice::new(plan.lattice.dims)?;
    if !plan.lattice.is_valid() {
        return Err(Error::usage("the lattice is not that of its dimensions"));
    }
    let is_pyramid = plan.points.kind() == SetKind::Pyramid;
    let right_edge = |e: &u64| match is_pyramid {
        true => *e == isospan_wavelet::CHUNK as u64,
        false => (1..=LARGEST_BRICK_EDGE).contains(e),
    };
    if !plan.brick_edge.iter().all(right_edge) {
        return Err(Error::usage(format!(
            "bricks of {:?} voxels; an edge is 1 to {LARGEST_BRICK_EDGE}",
            plan.brick_edge
        )));
    }
    if !(1..=Order::MOST_BITS).contains(&plan.order_bits) || plan.block_tets == 0 || plan.chunk_target == 0 {
        return Err(Error::usage("order bits, tetrahedra of a block or points of a chunk out of range"));
    }
    plan.points.check(&plan.lattice)?;
    let mut points = match attachments.levels {
        Some(levels) => PointSet::graded(plan.points, plan.lattice, levels)?,
        None => PointSet::new(plan.points, plan.lattice)?,
    };
    let listed = attachments.explicit.as_ref().map(|listed| listed.len());
    let own = match plan.points {
        PointSpec::Own { n } => Some(n),
        _ => None,
    };
    if own.is_some() != plan.own.is_some() || own.is_some() && (own != listed || plan.stars) {
        return Err(Error::usage("the plan of a mesh's own tetrahedra lacks its vertices, or has others"));
    }
    if let Some(explicit) = attachments.explicit {
        points = points.with_explicit(explicit);
    }
    if let Some(frame) = &plan.frame {
        points = points.ordered_by(frame.site_bits)?;
    }
    let bricks = plan.bricks().dims().iter().map(|&n| u128::from(n)).product::<u128>();
    if !is_pyramid && u128::from(points.len()) / MOST_BRICK_POINTS > bricks {
        return Err(Error::usage(format!(
            "{} points in {bricks} bricks: more than {MOST_BRICK_POINTS} a brick; choose fewer points",
            points.len()
        )));
    }
    let counter = points.clone();
    let chunks = match &plan.frame {
        Some(frame) => ChunkGrid::from_cuts(plan.bricks(), &frame.cuts)?,
        None if is_pyramid => ChunkGrid::of_bricks(plan.bricks())?,
        None => ChunkGrid::new(plan.bricks(), plan.chunk_target, move |b| counter.count_in(b))?,
    };
    let times =
        plan.own.map_or(1, |own| (own.tetrahedra / points.len().max(1)).div_ceil(TETS_A_POINT).max(1));
    let order = Order { bits: plan.order_bits };
    Ok(MeshParts { points, chunks, order, halo: Halo::of(plan), times })
}
