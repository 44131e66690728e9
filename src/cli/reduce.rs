//! `isospan reduce`: a volume becomes an archive.

use super::input::InputArgs;
use super::progress::Talk;
use super::{dry_run, text};
use clap::ValueEnum;
use isospan::pipeline::{Amount, NanPolicy, ReduceSettings, RunSettings, estimate, reduce};
use isospan::points::{SetKind, SetSettings};
use isospan::sample::Interpolation;
use isospan::{Error, Result};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Reduce a volume to an archive: sample it at quasi-Monte Carlo points, mesh them, index the mesh.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The volume: raw, NRRD, MetaImage, NPY, NIfTI, VTI, legacy VTK or .bricks.
    input: PathBuf,
    /// The archive to make, a folder NAME.isospan.
    #[arg(short, long, value_name = "ARCHIVE")]
    output: PathBuf,
    /// The point set.
    #[arg(long, value_enum, default_value_t = Set::Hammersley)]
    points: Set,
    /// Number of points as a fraction of the samples [default: 1/8].
    #[arg(long, value_name = "FRACTION", value_parser = text::parse_fraction, conflicts_with = "count")]
    fraction: Option<f64>,
    /// Number of points (boundary samples come on top).
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// Hammersley: the shift t in (k + t)/n; 0 gives the classical set.
    #[arg(long, value_name = "T", default_value_t = 0.5)]
    shift: f64,
    /// Hyperbolic cross: the level m, instead of the one whose size is nearest to the wanted count.
    #[arg(long, value_name = "M", conflicts_with_all = ["fraction", "count"], requires = "cross_k")]
    cross_m: Option<u32>,
    /// Hyperbolic cross: log2 of the cells of the coarsest grid, 2 to 5 [default: what brings the size nearest to the count].
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(2..=5))]
    cross_k: Option<u32>,
    /// Hyperbolic cross: regularity of the field along x, y and z.
    #[arg(long, value_name = "X,Y,Z", default_value = "1,1,1", value_parser = parse_regularity)]
    cross_r: [u32; 3],
    /// How values are interpolated between samples.
    #[arg(long, value_enum, default_value_t = Interp::Linear)]
    interp: Interp,
    /// Samples that are NaN, infinite or missing: "error", "mask" (leave a hole) or a value to use instead.
    #[arg(long, value_name = "error|mask|VALUE", default_value = "error", value_parser = parse_nan, allow_negative_numbers = true)]
    nan: NanPolicy,
    /// A value that means "no data here".
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true)]
    missing: Option<f64>,
    /// Points meshed together; changes the archive's layout, not its mesh.
    #[arg(long, value_name = "N", default_value_t = ReduceSettings::CHUNK_POINTS)]
    chunk_points: u64,
    /// Threads; 0 means as many as the process may use.
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Memory, kept: 4GiB, 500MB, 50% [default: half of what the process may use]. Pages of mapped files do not count.
    #[arg(long, value_name = "SIZE", value_parser = text::parse_bytes)]
    memory: Option<u64>,
    /// Round values to N bits (4 to 24) of the range of the source, which is read once more for that; the largest error is
    /// told and stored [default: lossless].
    #[arg(long, value_name = "N")]
    value_bits: Option<u8>,
    /// Folder for the uncompressed copy of a compressed input [default: the system's temporary folder].
    #[arg(long, value_name = "FOLDER")]
    scratch: Option<PathBuf>,
    /// Tell what the run needs (memory, disk, time) and make nothing; exit code 4 if there is not enough.
    #[arg(long)]
    dry_run: bool,
    /// Replace an archive that is already there.
    #[arg(long)]
    force: bool,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    read: InputArgs,
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

fn parse_nan(text: &str) -> std::result::Result<NanPolicy, String> {
    match text {
        "error" => Ok(NanPolicy::Error),
        "mask" => Ok(NanPolicy::Mask),
        value => value
            .parse::<f32>()
            .ok()
            .filter(|v| v.is_finite())
            .map(NanPolicy::Value)
            .ok_or_else(|| format!("'{value}' is none of error, mask, or a finite number")),
    }
}

fn parse_regularity(text: &str) -> std::result::Result<[u32; 3], String> {
    text::parse_triple(text, "a regularity")
}

impl Args {
    fn settings(&self) -> Result<ReduceSettings> {
        let kind = match self.points {
            Set::Hammersley => SetKind::Hammersley,
            Set::Halton => SetKind::Halton,
            Set::HyperbolicCross => SetKind::HyperbolicCross,
            Set::Regular => SetKind::Regular,
            Set::Lattice => SetKind::Bcc,
        };
        if (self.cross_m.is_some() || self.cross_k.is_some()) && self.points != Set::HyperbolicCross {
            return Err(Error::usage("--cross-m and --cross-k are for --points hyperbolic-cross"));
        }
        let amount = match (self.count, self.fraction) {
            (Some(n), _) => Amount::Count(n),
            (None, fraction) => Amount::Fraction(fraction.unwrap_or(0.125)),
        };
        Ok(ReduceSettings {
            points: kind,
            set: SetSettings { shift: self.shift, m: self.cross_m, k: self.cross_k, r: self.cross_r },
            amount,
            interpolation: match self.interp {
                Interp::Linear => Interpolation::Linear,
                Interp::Cubic => Interpolation::Cubic,
                Interp::CubicThesis => Interpolation::CubicThesis,
                Interp::Nearest => Interpolation::Nearest,
                Interp::Quadratic => Interpolation::Quadratic,
                Interp::QuadraticThesis => Interpolation::QuadraticThesis,
            },
            nan: self.nan,
            missing: self.missing,
            value_bits: self.value_bits,
            chunk_points: self.chunk_points,
        })
    }
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let run = RunSettings {
        threads: args.threads,
        memory: super::memory(args.memory, talk),
        scratch: args.scratch.clone(),
        replace: args.force,
        cancel: super::signals::cancel_token(),
    };
    if args.dry_run {
        let found = estimate(&args.input, &args.read.options()?, &args.settings()?, &args.output, &run)?;
        return dry_run::tell(&found, &args.output, args.json);
    }
    let threads = if run.threads == 0 { isospan::exec::available_threads() } else { run.threads };
    let io = args.read.io_text(&args.input);
    talk.detail(&format!("memory {}, {threads} threads, {io}", text::bytes(run.memory)));
    let bar = talk.progress();
    let report = reduce(&args.input, &args.read.options()?, &args.settings()?, &args.output, &run, &*bar);
    bar.end();
    let report = report?;
    talk.stages(&report.seconds);
    talk.detail(&format!(
        "{} chunks, {} halos had to be widened",
        text::count(report.chunks),
        text::count(report.halo_retries)
    ));
    if args.json {
        return super::print_json(&report);
    }
    let mut out = String::new();
    let per_point = report.archive_bytes as f64 / report.points.max(1) as f64;
    let _ = writeln!(out, "{}", args.output.display());
    let _ = writeln!(
        out,
        "  points      {} of {} samples",
        text::count(report.points),
        text::count(report.samples)
    );
    let _ = writeln!(
        out,
        "  tetrahedra  {} in {} chunks",
        text::count(report.tetrahedra),
        text::count(report.chunks)
    );
    if let Some(cells) = report.grid_cells {
        let _ = writeln!(out, "{}", text::grid_cells(&cells));
    }
    if let Some(mesh) = report.mesh {
        let _ = writeln!(out, "{}", text::mesh_census(&mesh));
    }
    if report.void_points > 0 {
        let _ = writeln!(out, "  void        {} points without a value", text::count(report.void_points));
    }
    if let Some([lo, hi]) = report.range {
        let _ = writeln!(out, "  range       {lo} .. {hi}");
    }
    if let Some(q) = &report.quantiser {
        let _ = writeln!(out, "  values      {} bits, within {:.3e}", q.bits, q.bound);
    }
    let _ =
        writeln!(out, "  archive     {} ({per_point:.2} bytes a point)", text::bytes(report.archive_bytes));
    for (stage, time) in &report.seconds {
        let _ = writeln!(out, "  {stage:<11} {}", text::duration(std::time::Duration::from_secs_f64(*time)));
    }
    super::print(&out)
}
