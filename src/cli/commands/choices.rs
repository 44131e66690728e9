//! The choices of a user for a reduction: everything that decides the archive's bytes, besides the
//! input.

use super::grammar::{self, Range, Size, Value};
use clap::ValueEnum;
use isospan::pipeline::{Amount, Bound, Length, NanPolicy, ReduceSettings, SetChoice, SurfaceTarget, Target};
use isospan::points::SetKind;
use isospan::sample::{Interpolation, Values};
use isospan::{Error, Result};

/// The choices for one reduction, or for several tries that meet a target.
#[derive(clap::Args, Debug)]
pub struct Choices {
    #[command(flatten)]
    plan: PlanChoices,
    #[command(flatten)]
    targets: Targets,
    #[command(flatten)]
    surfaces: Surfaces,
}

/// Surfaces that are measured, and how far one may be from that of the samples.
#[derive(clap::Args, Debug)]
struct Surfaces {
    /// Also measure the surfaces of these isovalues against those of the samples, of a volume, as
    /// `measure` does: area, pieces, distances in world units, and where the largest is. N% is a
    /// place in the range of the samples. Of a series the worst step is told.
    #[arg(help_heading = "Error and size", long, short = 'i', value_name = "VALUE", value_delimiter = ',', allow_hyphen_values = true, value_parser = grammar::value)]
    isovalue: Vec<Value>,
    /// Keep the surface at --isovalue within this distance of that of the samples: 99 % of the area
    /// of each is at most so far from the other. In a unit, as 0.2mm, in world units, or as N% of
    /// the diagonal of the domain. Mostly two to four tries are made, and each is measured.
    #[arg(help_heading = "Error and size", long, value_name = "LENGTH", value_parser = grammar::length, requires = "isovalue", conflicts_with_all = ["fraction", "count", "cross_m", "no_measure", "target_rms", "target_max", "size", "ratio", "lossless", "labels"], allow_hyphen_values = true)]
    target_surface: Option<Length>,
}

/// An error or a size that is wanted.
#[derive(clap::Args, Debug)]
struct Targets {
    /// Keep the RMS error at all samples at or below E, in units of the field or as N% of its
    /// range. A volume takes one or two tries. Of points the fewest are used, in several tries; a
    /// mesh implies --adapt [default for volumes: 1%].
    #[arg(help_heading = "Error and size", long, value_name = "E", value_parser = grammar::error, conflicts_with_all = ["fraction", "count", "no_measure"], allow_hyphen_values = true)]
    target_rms: Option<Bound>,
    /// As --target-rms, for the largest error at a sample, or at a vertex of a mesh.
    #[arg(help_heading = "Error and size", long, value_name = "E", value_parser = grammar::error, conflicts_with_all = ["fraction", "count", "no_measure", "target_rms"], allow_hyphen_values = true)]
    target_max: Option<Bound>,
    /// Find the least error in an archive of at most this size: 50MiB, or 5% or 1/20 of the bytes
    /// of the source, which are those of its files or of its samples, whichever are fewer. This
    /// takes a few tries.
    #[arg(help_heading = "Error and size", long, value_name = "SIZE", value_parser = grammar::size, conflicts_with_all = ["fraction", "count", "cross_m", "target_rms", "target_max"], allow_hyphen_values = true)]
    size: Option<Size>,
    /// Find the least error in 1/N of the bytes of the source, as --size 1/N does: 20 for 5%.
    #[arg(help_heading = "Error and size", long, value_name = "N", value_parser = grammar::positive_number, conflicts_with_all = ["fraction", "count", "cross_m", "target_rms", "target_max", "size"], allow_negative_numbers = true)]
    ratio: Option<f64>,
    /// Store all samples of a volume without loss, where they are whole numbers.
    #[arg(help_heading = "Error and size", long, conflicts_with_all = ["fraction", "count", "no_measure", "target_rms", "target_max", "size", "ratio"])]
    lossless: bool,
    /// Store the samples of a volume as labels: whole numbers that are names, such as those of a
    /// segmentation. None is changed, none is mixed with another, and there are no coarser levels;
    /// far fewer bytes than --lossless takes [default for .seg.nrrd, and NIfTI with the intent
    /// "label"].
    #[arg(help_heading = "Error and size", long, conflicts_with_all = ["fraction", "count", "target_rms", "target_max", "size", "ratio", "lossless"])]
    labels: bool,
}

/// Point set, interpolation, missing values, numbers of points.
#[derive(clap::Args, Debug)]
struct PlanChoices {
    /// What is kept [default: pyramid; hammersley for meshes; halton with --adapt].
    #[arg(help_heading = "Points", long, value_enum)]
    points: Option<Set>,
    /// Number of points as a fraction of the number of samples: 1/8, 0.125 or 12.5% [default: 1/8].
    /// A volume needs --points with it. For a mesh, a fraction of its vertices, boundary included.
    /// With 1, a mesh is stored unchanged, with its own vertices and tetrahedra and no error;
    /// --points, --interp and --adapt must not be given then.
    #[arg(help_heading = "Points", long, value_name = "FRACTION", value_parser = grammar::share, conflicts_with = "count", allow_hyphen_values = true)]
    fraction: Option<f64>,
    /// Number of points. For a volume, samples of its boundary come on top. With as many as a mesh
    /// has vertices, or more, the mesh is stored unchanged, as with --fraction 1.
    #[arg(help_heading = "Points", long, value_name = "N", value_parser = grammar::natural, allow_negative_numbers = true)]
    count: Option<u64>,
    /// Place more points where the field needs them and fewer elsewhere; the total stays the same.
    /// The input is read once more for that: up to eight steps of a series of volumes, the first
    /// step of a series of meshes. Uses --points halton.
    #[arg(help_heading = "Points", long)]
    adapt: bool,
    /// The range of values that matters; implies --adapt. Errors outside LO to HI are ignored. 100%
    /// is the range of the values of the first step, which is read once more for it.
    #[arg(help_heading = "Points", long, value_name = "LO:HI", value_parser = grammar::range, allow_hyphen_values = true)]
    focus: Option<Range>,
    /// Hammersley: the shift t in (k + t)/n; 0 gives the classical set [default: 0.5].
    #[arg(help_heading = "Points", long, value_name = "T", value_parser = grammar::number, allow_negative_numbers = true)]
    shift: Option<f64>,
    /// Hyperbolic cross: the level m [default: the one whose size is nearest to the count]. Needs
    /// --cross-k.
    #[arg(help_heading = "Points", long, value_name = "M", value_parser = grammar::whole::<u32>, conflicts_with_all = ["fraction", "count"], requires = "cross_k", allow_negative_numbers = true)]
    cross_m: Option<u32>,
    /// Hyperbolic cross: log2 of the number of cells of the coarsest grid, 2 to 5 [default: the one
    /// that brings the size nearest to the count].
    #[arg(help_heading = "Points", long, value_name = "K", value_parser = grammar::whole_in(2..=5u32), allow_negative_numbers = true)]
    cross_k: Option<u32>,
    /// Hyperbolic cross: regularity of the field along x, y and z [default: 1,1,1].
    #[arg(help_heading = "Points", long, value_name = "X,Y,Z", value_parser = grammar::whole_triple::<u32>, allow_hyphen_values = true)]
    cross_r: Option<[u32; 3]>,
    /// How values are interpolated between samples.
    #[arg(help_heading = "Values", long, value_enum, default_value_t = Interp::Linear)]
    interp: Interp,
    /// "sample" takes the field at each point, as the thesis does. "fit" takes values that bring
    /// the reduced field closer to all samples; the RMS error is 0.56 to 0.92 times as large, and
    /// no value leaves the range of the samples around it [default: fit; sample with --interp
    /// nearest, cubic-thesis or quadratic-thesis].
    #[arg(help_heading = "Values", long, value_enum)]
    values: Option<Vertex>,
    /// What to do with samples that are NaN, infinite or missing: "error", "mask" (leave a hole),
    /// or a value to use instead.
    #[arg(help_heading = "Values", long, value_name = "error|mask|VALUE", default_value = "error", value_parser = grammar::nan, allow_negative_numbers = true)]
    nan: NanPolicy,
    /// A value that means "no data here".
    #[arg(help_heading = "Values", long, value_name = "VALUE", allow_negative_numbers = true, value_parser = grammar::number)]
    missing: Option<f64>,
    /// Store every N-th step without reference to the step before.
    #[arg(help_heading = "Series", long, value_name = "N", default_value_t = ReduceSettings::KEYFRAMES, value_parser = grammar::natural, allow_negative_numbers = true)]
    keyframes: u64,
    /// Number of points that are meshed together. Changes the layout of the archive, not its mesh.
    #[arg(help_heading = "Resources", long, value_name = "N", default_value_t = ReduceSettings::CHUNK_POINTS, value_parser = grammar::natural, allow_negative_numbers = true)]
    chunk_points: u64,
    /// Round the values of points to N bits (4 to 24; 6.5 is allowed) of the range of the source.
    /// Rounding reads the source once more; its largest error is reported and stored [default:
    /// values are exact].
    #[arg(help_heading = "Values", long, value_name = "N", value_parser = grammar::bits, allow_hyphen_values = true)]
    value_bits: Option<f64>,
    /// Skip the measurement of the error at the samples of the source.
    #[arg(help_heading = "Error and size", long)]
    no_measure: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Set {
    /// All samples of a volume, as a wavelet pyramid: the fewest bytes to an error, and coarser
    /// levels. Without a target its RMS error is 1 % of the range.
    Pyramid,
    Hammersley,
    Halton,
    HyperbolicCross,
    Regular,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Interp {
    Linear,
    Cubic,
    CubicThesis,
    Nearest,
    /// Tetrahedral meshes only.
    Quadratic,
    /// Tetrahedral meshes only; the thesis's variant, which is linear.
    QuadraticThesis,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Vertex {
    Sample,
    Fit,
}

impl Set {
    fn kind(self) -> SetKind {
        match self {
            Self::Pyramid => SetKind::Pyramid,
            Self::Hammersley => SetKind::Hammersley,
            Self::Halton => SetKind::Halton,
            Self::HyperbolicCross => SetKind::HyperbolicCross,
            Self::Regular => SetKind::Regular,
        }
    }
}

impl Interp {
    fn interpolation(self) -> Interpolation {
        match self {
            Self::Linear => Interpolation::Linear,
            Self::Cubic => Interpolation::Cubic,
            Self::CubicThesis => Interpolation::CubicThesis,
            Self::Nearest => Interpolation::Nearest,
            Self::Quadratic => Interpolation::Quadratic,
            Self::QuadraticThesis => Interpolation::QuadraticThesis,
        }
    }
}

impl Choices {
    /// The settings that the flags say; the library completes them.
    pub fn settings(&self) -> Result<ReduceSettings> {
        Ok(self.plan.settings(self.target()?))
    }

    /// The isovalues whose surfaces are measured.
    pub fn isovalues(&self) -> Vec<Value> {
        self.surfaces.isovalue.clone()
    }

    /// The error, the size or the distance that is wanted.
    pub(crate) fn target(&self) -> Result<Option<Target>> {
        match (self.surfaces.target_surface, &self.surfaces.isovalue[..]) {
            (None, _) => Ok(self.targets.target()),
            (Some(distance), &[isovalue]) => Ok(Some(Target::Surface(SurfaceTarget { isovalue, distance }))),
            _ => Err(Error::usage("`target_surface` is for the surface of one `isovalue`")),
        }
    }
}

impl Targets {
    fn target(&self) -> Option<Target> {
        let error = self.target_rms.map(Target::Rms).or(self.target_max.map(Target::Max));
        let size = self.size.map(|size| match size {
            Size::Bytes(bytes) => Target::Size(bytes),
            Size::OfSource(share) => Target::Ratio(1.0 / share),
        });
        let whole = self.lossless.then_some(Target::Lossless).or(self.labels.then_some(Target::Labels));
        error.or(size).or(self.ratio.map(Target::Ratio)).or(whole)
    }
}

impl PlanChoices {
    fn settings(&self, target: Option<Target>) -> ReduceSettings {
        ReduceSettings {
            points: self.points.map(Set::kind),
            set: SetChoice { shift: self.shift, m: self.cross_m, k: self.cross_k, r: self.cross_r },
            amount: match (self.count, self.fraction) {
                (Some(n), _) => Amount::Count(n),
                (None, fraction) => fraction.map_or(Amount::Usual, Amount::Fraction),
            },
            adapt: self.adapt,
            focus: self.focus.map(Range::focus),
            target,
            interpolation: self.interp.interpolation(),
            values: self.values.map(|values| match values {
                Vertex::Sample => Values::Sample,
                Vertex::Fit => Values::Fit,
            }),
            nan: self.nan,
            missing: self.missing,
            value_bits: self.value_bits,
            chunk_points: self.chunk_points,
            keyframes: self.keyframes,
            measure: !self.no_measure,
        }
    }
}
