//! What a user chooses of a reduction: everything that decides the archive's bytes, besides the input.

use super::text;
use clap::ValueEnum;
use isospan::pipeline::{Adapt, Amount, Bound, NanPolicy, ReduceSettings, Target, ValueBits};
use isospan::points::{SetKind, SetSettings};
use isospan::sample::{Interpolation, Values};
use isospan::{Error, Result};

/// Point set, interpolation, missing values, sizes.
#[derive(clap::Args, Debug)]
pub(crate) struct Choices {
    /// The point set [default: lattice; of a mesh hammersley; with --adapt halton].
    #[arg(long, value_enum)]
    points: Option<Set>,
    /// Number of points as a fraction of the samples: 1/8, 0.125 or 12.5% [default: 1/8]; of a mesh, of its vertices, boundary included.
    /// At 1 a mesh is kept as it is: its own vertices and tetrahedra, with no error; not with other --points, --interp, or --adapt.
    #[arg(long, value_name = "FRACTION", value_parser = text::parse_fraction, conflicts_with = "count")]
    fraction: Option<f64>,
    /// Number of points (of a volume, boundary samples come on top). That of a mesh's vertices, or more, keeps the mesh as --fraction 1 does.
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// More points where the field needs them and fewer elsewhere, as many in all: the volume is read once more to find where (of a series up
    /// to eight steps; of a mesh the first one, and where its vertices lie and its boundary is tell too). For --points halton.
    #[arg(long)]
    adapt: bool,
    /// With --adapt or a target: the values that somebody will look at; what happens below LO and above HI does not count.
    #[arg(long, value_name = "LO:HI", value_parser = parse_focus, allow_hyphen_values = true)]
    focus: Option<[f64; 2]>,
    /// Instead of a number of points: the fewest with which the root mean square error at all samples is at most E (in units of the field, or
    /// N% of its range). Reduces several times; the error that was met is stored. Points are those of a lattice, whose bits of values are chosen too,
    /// unless --points, --adapt or --value-bits says otherwise. A mesh, and --focus, imply --adapt.
    #[arg(long, value_name = "E", value_parser = parse_bound, conflicts_with_all = ["fraction", "count", "no_measure"])]
    target_rms: Option<Bound>,
    /// As --target-rms, for the largest error at a sample, or at a vertex of a mesh.
    #[arg(long, value_name = "E", value_parser = parse_bound, conflicts_with_all = ["fraction", "count", "no_measure", "target_rms"])]
    target_max: Option<Bound>,
    /// Instead of a number of points: the least error in an archive of at most so many bytes, as in 50MiB. Reduces several times. Points are
    /// those of a lattice, and the bits of values are chosen, unless --points, --adapt or --value-bits says otherwise.
    #[arg(long, value_name = "BYTES", value_parser = text::parse_bytes, conflicts_with_all = ["fraction", "count", "target_rms", "target_max"])]
    size: Option<u64>,
    /// As --size, for 1/N of the bytes of the source: of its files or of its samples, whichever are fewer.
    #[arg(long, value_name = "N", conflicts_with_all = ["fraction", "count", "target_rms", "target_max", "size"])]
    ratio: Option<f64>,
    /// Hammersley: the shift t in (k + t)/n; 0 gives the classical set [default: 0.5].
    #[arg(long, value_name = "T")]
    shift: Option<f64>,
    /// Hyperbolic cross: the level m, instead of the one whose size is nearest to the wanted count. Needs --cross-k.
    #[arg(long, value_name = "M", conflicts_with_all = ["fraction", "count", "size", "ratio"], requires = "cross_k")]
    cross_m: Option<u32>,
    /// Hyperbolic cross: log2 of the cells of the coarsest grid, 2 to 5 [default: what brings the size nearest to the count].
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(2..=5))]
    cross_k: Option<u32>,
    /// Hyperbolic cross: regularity of the field along x, y and z [default: 1,1,1].
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_regularity)]
    cross_r: Option<[u32; 3]>,
    /// How values are interpolated between samples.
    #[arg(long, value_enum, default_value_t = Interp::Linear)]
    interp: Interp,
    /// "fit": values that bring the reduced field closer to all samples (of a mesh: to the values at its vertices), none beyond the samples around it,
    /// for 0.56 to 0.92 of the RMS error; "sample": the field at each point, as the thesis has it [default: fit; sample with --interp nearest, cubic-thesis, quadratic-thesis].
    #[arg(long, value_enum)]
    values: Option<Vertex>,
    /// Samples that are NaN, infinite or missing: "error", "mask" (leave a hole) or a value to use instead.
    #[arg(long, value_name = "error|mask|VALUE", default_value = "error", value_parser = parse_nan, allow_negative_numbers = true)]
    nan: NanPolicy,
    /// A value that means "no data here".
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true)]
    missing: Option<f64>,
    /// Of a series: store every N-th step without reference to the one before.
    #[arg(long, value_name = "N", default_value_t = ReduceSettings::KEYFRAMES)]
    keyframes: u64,
    /// Points meshed together; changes the archive's layout, not its mesh.
    #[arg(long, value_name = "N", default_value_t = ReduceSettings::CHUNK_POINTS)]
    chunk_points: u64,
    /// Round values to N bits (4 to 24) of the range of the source, which is read once more for that, or "exact".
    /// The largest error of rounding is told and stored. [default: 8 bits of the range of 99.8 % of the samples for
    /// the lattice of a volume, unless --interp is nearest; else exact]
    #[arg(long, value_name = "N|exact", value_parser = parse_bits)]
    value_bits: Option<ValueBits>,
    /// Do not measure the field against the samples of the source in the end.
    #[arg(long)]
    no_measure: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Set {
    Hammersley,
    Halton,
    HyperbolicCross,
    Regular,
    Lattice,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Interp {
    Linear,
    Cubic,
    CubicThesis,
    Nearest,
    /// Of tetrahedral meshes.
    Quadratic,
    /// Of tetrahedral meshes; the thesis's, which is linear.
    QuadraticThesis,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Vertex {
    Sample,
    Fit,
}

fn parse_nan(text: &str) -> std::result::Result<NanPolicy, String> {
    NanPolicy::parse(text).ok_or_else(|| format!("'{text}' is none of error, mask, or a finite number"))
}

fn parse_bits(text: &str) -> std::result::Result<ValueBits, String> {
    match text {
        "exact" => Ok(ValueBits::Exact),
        _ => text
            .parse()
            .map(ValueBits::Bits)
            .map_err(|_| format!("'{text}' is neither exact nor a number of bits")),
    }
}

fn parse_regularity(text: &str) -> std::result::Result<[u32; 3], String> {
    text::parse_triple(text, "a regularity")
}

fn parse_bound(text: &str) -> std::result::Result<Bound, String> {
    let number = |s: &str| s.trim().parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
    let bound = match text.strip_suffix('%') {
        Some(percent) => number(percent).map(|p| Bound::OfRange(p / 100.0)),
        None => number(text).map(Bound::Value),
    };
    bound.ok_or_else(|| format!("'{text}' is no error; write a number above 0, as in 2.5 or 1%"))
}

fn parse_focus(text: &str) -> std::result::Result<[f64; 2], String> {
    let numbers =
        text.split_once(':').and_then(|(lo, hi)| Some([lo.trim().parse().ok()?, hi.trim().parse().ok()?]));
    numbers.ok_or_else(|| format!("'{text}' is no range; write LO:HI, as in 300:900"))
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
    /// The settings that the flags say.
    ///
    /// # Errors
    /// When flags do not go together.
    pub(crate) fn settings(&self, of_mesh: bool) -> Result<ReduceSettings> {
        let error = self.target_rms.map(Target::Rms).or(self.target_max.map(Target::Max));
        let size = self.size.map(Target::Size).or(self.ratio.map(Target::Ratio));
        // Where no set is named, a target is met by a lattice, which takes the fewest bytes, and of a mesh by points that adapt.
        let adapts = of_mesh || self.focus.is_some() || self.points == Some(Set::Halton);
        let is_open = matches!(self.points, None | Some(Set::Halton));
        let adapt = self.adapt || error.is_some() && is_open && adapts;
        if self.focus.is_some() && !adapt {
            return Err(Error::usage("--focus tells --adapt where to look"));
        }
        let points = match (self.points, error.or(size)) {
            (None, Some(_)) if !adapt => Some(Set::Lattice),
            (None, _) if self.shift.is_some() && !adapt => Some(Set::Hammersley),
            (points, _) => points,
        };
        let kind = points.map(|points| match points {
            Set::Hammersley => SetKind::Hammersley,
            Set::Halton => SetKind::Halton,
            Set::HyperbolicCross => SetKind::HyperbolicCross,
            Set::Regular => SetKind::Regular,
            Set::Lattice => SetKind::Bcc,
        });
        let cross = self.cross_m.is_some() || self.cross_k.is_some() || self.cross_r.is_some();
        if cross && points != Some(Set::HyperbolicCross) {
            return Err(Error::usage("--cross-m, --cross-k and --cross-r are for --points hyperbolic-cross"));
        }
        if self.shift.is_some() && points != Some(Set::Hammersley) {
            return Err(Error::usage("--shift is for --points hammersley"));
        }
        let interpolation = self.interp.interpolation();
        let amount = match (self.count, self.fraction) {
            (Some(n), _) => Amount::Count(n),
            (None, fraction) => Amount::Fraction(fraction.unwrap_or(0.125)),
        };
        Ok(ReduceSettings {
            points: kind,
            set: SetSettings {
                spacing: None,
                shift: self.shift.unwrap_or(0.5),
                m: self.cross_m,
                k: self.cross_k,
                r: self.cross_r.unwrap_or([1; 3]),
            },
            amount,
            adapt: adapt.then_some(Adapt { focus: self.focus }),
            target: error.or(size),
            interpolation,
            values: match self.values {
                Some(Vertex::Sample) => Values::Sample,
                Some(Vertex::Fit) => Values::Fit,
                None => Values::usual(interpolation),
            },
            nan: self.nan,
            missing: self.missing,
            value_bits: self.value_bits.unwrap_or_default(),
            chunk_points: self.chunk_points,
            measure: !self.no_measure,
            keyframes: self.keyframes,
        })
    }
}
