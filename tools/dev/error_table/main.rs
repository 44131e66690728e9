//! How far reductions of volumes are off, and how many points an error takes: a table of any
//! volumes.
//!
//! ```text
//!  volume ─▶ 1/8, 1/16, 1/64 of its samples as points: sampled, fitted, dense where it is needed, both ─▶ RMS error, CPU time
//!         ─▶ as many voxels, evenly picked, trilinear between them                                     ─▶ RMS error
//!         ─▶ the error of the sampled ones as a target ─▶ points that it takes, and fewest even fitted points that meet it
//! ```
//!
//! Errors are those at all samples, in units of the field; points are all of an archive, those of
//! the boundary included. The fewest even fitted points are found by the secant rule: errors are
//! nearly a power of the number of points. CPU time is that of one thread, read off `/proc` where
//! the system has it.

use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource, open_volume};
use isospan::grid::IndexBox;
use isospan::pipeline::{
    Amount, Bound, NanPolicy, ReduceReport, ReduceSettings, RunSettings, Target, brick, reduce_series,
};
use isospan::points::SetKind;
use isospan::sample::Values;
use isospan::volume::{VolumeReader, VolumeSource};
use isospan::{Error, Resources, Result};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const HELP: &str = "\
usage: error_table OUT.csv VOLUME...
  OUT.csv   a row for each volume and each of 1/8, 1/16, 1/64 of its samples as points; rows appear as they are found
The folder for temporary files (TMPDIR) must hold an archive and an unpacked copy of a volume.";

/// Parts 1/n of the samples.
const PARTS: [u64; 3] = [8, 16, 64];
/// Tries of the secant rule, at most; and how near to the wanted error is near enough.
const TRIES: usize = 5;
const NEAR: f64 = 0.01;

const COLUMNS: [&str; 18] = [
    "volume",
    "part",
    "points",
    "sampled",
    "fitted",
    "voxels",
    "adapted_points",
    "adapted",
    "adapted_fitted",
    "fitted/sampled",
    "fitted/voxels",
    "even_fitted_points",
    "target_sampled_points",
    "target_fitted_points",
    "target_sampled/even_sampled",
    "target_fitted/even_sampled",
    "target_fitted/even_fitted",
    "cpu_fitted/cpu_sampled",
];

fn main() -> ExitCode {
    let args: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    if args.len() < 2 || args[0].extension().is_none_or(|e| e != "csv") {
        eprintln!("{HELP}");
        return ExitCode::from(2);
    }
    match table(&args[0], &args[1..]) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error_table: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

fn table(out: &Path, volumes: &[PathBuf]) -> Result<()> {
    let failed = |e| Error::io("write", out, e);
    let mut file = File::create(out).map_err(failed)?;
    writeln!(file, "{}", COLUMNS.join(",")).map_err(failed)?;
    for path in volumes {
        let volume = Volume::open(path)?;
        for part in PARTS {
            let row = Row::of(&volume, part)?;
            writeln!(file, "{}", row.text(&volume, part)).and_then(|()| file.flush()).map_err(failed)?;
        }
    }
    Ok(())
}

/// A volume, its samples within reach; and a folder for archives.
struct Volume {
    name: String,
    path: PathBuf,
    reader: Box<dyn VolumeReader>,
    folder: tempfile::TempDir,
}

/// What came of a reduction.
#[derive(Clone, Copy)]
struct Made {
    points: f64,
    rms: f64,
    seconds: f64,
}

impl Volume {
    /// A compressed volume is unpacked once.
    fn open(path: &Path) -> Result<Self> {
        let place = std::env::temp_dir();
        let folder = tempfile::tempdir().map_err(|e| Error::io("make a temporary folder in", &place, e))?;
        let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        let (mut path, mut source) = (path.to_path_buf(), open_volume(path, &OpenOptions::default())?);
        if !matches!(source, VolumeSource::Random(_)) {
            path = folder.path().join("copy.bricks");
            brick(source, &path, 256 << 20, &RunSettings::default().resources.cancel, &Silent)?;
            source = open_volume(&path, &OpenOptions::default())?;
        }
        match source {
            VolumeSource::Random(reader) => Ok(Self { name, path, reader, folder }),
            _ => unreachable!("bricks are read in any order"),
        }
    }

    fn dims(&self) -> [u64; 3] {
        self.reader.info().dims
    }

    fn reduce(&self, settings: ReduceSettings) -> Result<(ReduceReport, Made)> {
        let run = RunSettings {
            resources: Resources::default().with_threads(1).with_scratch(Some(self.folder.path().into())),
            replace: true,
            ..RunSettings::default()
        };
        let settings = ReduceSettings { nan: NanPolicy::Value(0.0), ..settings };
        let (out, before) = (self.folder.path().join("try.isospan"), cpu_seconds());
        let report = reduce_series(
            &[StepSource::new(&self.path, &OpenOptions::default())],
            &settings,
            &out,
            &run,
            &Silent,
        )?;
        let rms = report.error.as_ref().expect("a reduction is measured").rms;
        let made = Made { points: report.points as f64, rms, seconds: cpu_seconds() - before };
        Ok((report, made))
    }

    /// Points all over the volume.
    fn even(&self, count: f64, values: Values) -> Result<Made> {
        let amount = Amount::Count(count.round().max(1.0) as u64);
        let settings =
            ReduceSettings { amount, values: Some(values), ..ReduceSettings::exact(SetKind::Hammersley) };
        Ok(self.reduce(settings)?.1)
    }

    /// Points where the field needs them.
    fn adapted(&self, count: f64, values: Values) -> Result<Made> {
        let amount = Amount::Count(count.round().max(1.0) as u64);
        Ok(self.reduce(ReduceSettings { amount, ..dense(values) })?.1)
    }

    /// The fewest of those that meet an error; NaN when none do.
    fn to_target(&self, rms: f64, values: Values) -> Result<f64> {
        let target = Some(Target::Rms(Bound::Value(rms)));
        let (report, made) = self.reduce(ReduceSettings { target, ..dense(values) })?;
        let met = report.target.is_some_and(|t| t.met);
        Ok(if met { made.points } else { f64::NAN })
    }

    /// The number of even fitted points that has about an error, from a reduction that has less.
    fn even_fitted_for(&self, rms: f64, from: Made, count: f64) -> Result<f64> {
        // Points of the boundary come on top of those that are asked for.
        let (mut a, mut power) = ((count, from), 0.5);
        for _ in 0..TRIES {
            if (a.1.rms / rms).ln().abs() < NEAR {
                break;
            }
            let next = a.0 * (a.1.rms / rms).powf(1.0 / power);
            let b = (next, self.even(next, Values::Fit)?);
            power = (-(b.1.rms / a.1.rms).ln() / (b.0 / a.0).ln()).clamp(0.1, 2.0);
            a = b;
        }
        Ok(a.1.points * (a.1.rms / rms).powf(1.0 / power))
    }

    /// The error of trilinear interpolation between at most so many voxels, evenly picked, those of
    /// the faces included.
    fn voxels(&self, most: f64) -> Result<f64> {
        let dims = self.dims().map(|d| d as usize);
        let kept = |k: f64| dims.map(|d| (((d - 1) as f64 / k).round() as usize + 1).max(2));
        let count = |n: [usize; 3]| n.iter().product::<usize>() as f64;
        let (mut few, mut many) = (dims.map(|d| d as f64).into_iter().fold(2.0, f64::max), 1.0);
        while few - many > 1e-6 {
            let k = f64::midpoint(few, many);
            if count(kept(k)) > most { many = k } else { few = k }
        }
        let axes: Vec<KeptAxis> = kept(few).iter().zip(dims).map(|(&n, d)| KeptAxis::new(n, d)).collect();
        let slice = |z: usize| -> Result<Vec<f32>> {
            let mut out = vec![0.0; dims[0] * dims[1]];
            let z = z as u64;
            let window = IndexBox { lo: [0, 0, z], hi: [dims[0] as u64, dims[1] as u64, z + 1] };
            self.reader.read_box(window, &mut out)?;
            out.iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = 0.0);
            Ok(out)
        };
        let mut sum = 0.0;
        let (mut at, mut both) = (usize::MAX, [vec![], vec![]]);
        for z in 0..dims[2] {
            let (before, weight) = axes[2].between[z];
            if before != at {
                (at, both) = (before, [slice(axes[2].kept[before])?, slice(axes[2].kept[before + 1])?]);
            }
            sum += slice_error(&axes, &slice(z)?, &both, weight);
        }
        Ok((sum / dims.iter().map(|&d| d as f64).product::<f64>()).sqrt())
    }
}

/// Settings of points that adapt.
fn dense(values: Values) -> ReduceSettings {
    ReduceSettings {
        points: Some(SetKind::Halton),
        adapt: true,
        values: Some(values),
        ..ReduceSettings::default()
    }
}

/// The voxels of an axis that are kept, and where each voxel lies among them.
struct KeptAxis {
    kept: Vec<usize>,
    /// Number of the one before, and the weight of the one after.
    between: Vec<(usize, f64)>,
}

impl KeptAxis {
    fn new(n: usize, d: usize) -> Self {
        let last = (d - 1) as f64;
        let kept: Vec<usize> = (0..n).map(|i| (i as f64 * last / (n - 1) as f64).round() as usize).collect();
        let place = |v: usize| {
            let before = (kept.partition_point(|&k| k <= v) - 1).min(n - 2);
            let width = (kept[before + 1] - kept[before]).max(1);
            (before, (v - kept[before]) as f64 / width as f64)
        };
        let between = (0..d).map(place).collect();
        Self { kept, between }
    }
}

/// The squared errors of a slice between two that are kept.
fn slice_error(axes: &[KeptAxis], slice: &[f32], [below, above]: &[Vec<f32>; 2], weight: f64) -> f64 {
    let (nx, mut sum) = (axes[0].between.len(), 0.0);
    let mix = |a: f64, b: f64, w: f64| a + (b - a) * w;
    for (y, &(j, wy)) in axes[1].between.iter().enumerate() {
        let rows = [axes[1].kept[j], axes[1].kept[j + 1]].map(|y| y * nx);
        let at = |x: usize| {
            let of = |row: usize| mix(f64::from(below[row + x]), f64::from(above[row + x]), weight);
            mix(of(rows[0]), of(rows[1]), wy)
        };
        let few: Vec<f64> = axes[0].kept.iter().map(|&x| at(x)).collect();
        for (x, &(i, wx)) in axes[0].between.iter().enumerate() {
            sum += (mix(few[i], few[i + 1], wx) - f64::from(slice[y * nx + x])).powi(2);
        }
    }
    sum
}

/// CPU seconds of this process so far; NaN where the system does not report them.
fn cpu_seconds() -> f64 {
    // Fields 14 and 15, in hundredths of a second on all Linux systems; the second field may hold
    // blanks, and ends in a parenthesis.
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let rest = text.rsplit_once(')').map_or("", |(_, rest)| rest);
    let ticks: Vec<f64> = rest.split_whitespace().skip(11).take(2).filter_map(|t| t.parse().ok()).collect();
    if ticks.len() == 2 { (ticks[0] + ticks[1]) / 100.0 } else { f64::NAN }
}

/// All that is found of a volume at a number of points.
struct Row {
    sampled: Made,
    fitted: Made,
    voxels: f64,
    adapted: Made,
    adapted_fitted: Made,
    even_fitted: f64,
    targets: [f64; 2],
}

impl Row {
    fn of(volume: &Volume, part: u64) -> Result<Self> {
        let count = volume.dims().iter().map(|&d| d as f64).product::<f64>() / part as f64;
        let sampled = volume.even(count, Values::Sample)?;
        let fitted = volume.even(count, Values::Fit)?;
        let target = |values| volume.to_target(sampled.rms, values);
        Ok(Self {
            sampled,
            fitted,
            voxels: volume.voxels(sampled.points)?,
            adapted: volume.adapted(count, Values::Sample)?,
            adapted_fitted: volume.adapted(count, Values::Fit)?,
            even_fitted: volume.even_fitted_for(sampled.rms, fitted, count)?,
            targets: [target(Values::Sample)?, target(Values::Fit)?],
        })
    }

    fn text(&self, volume: &Volume, part: u64) -> String {
        let Self { sampled, fitted, adapted, targets: [by_samples, by_fit], .. } = *self;
        let head = format!("{},1/{part},{}", volume.name, sampled.points);
        let errors = [sampled.rms, fitted.rms, self.voxels].map(|e| format!("{e:.5e}")).join(",");
        let dense = [adapted.rms, self.adapted_fitted.rms].map(|e| format!("{e:.5e}")).join(",");
        let ratios = [
            by_samples / sampled.points,
            by_fit / sampled.points,
            by_fit / self.even_fitted,
            fitted.seconds / sampled.seconds,
        ];
        let ratios = ratios.map(|r| format!("{r:.3}")).join(",");
        let [of_sampled, of_voxels] = [sampled.rms, self.voxels].map(|e| format!("{:.3}", fitted.rms / e));
        let points = format!("{:.0},{by_samples},{by_fit}", self.even_fitted);
        format!("{head},{errors},{},{dense},{of_sampled},{of_voxels},{points},{ratios}", adapted.points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_linear_along_each_axis_has_no_error_between_voxels() {
        let axes = [KeptAxis::new(3, 8), KeptAxis::new(4, 5), KeptAxis::new(2, 3)];
        assert_eq!(axes[0].kept, [0, 4, 7]);
        let f = |x: usize, y: usize, z: usize| (x * 2 + y * 3 + x * y + z * 5) as f32;
        let slice = |z: usize| (0..40).map(|n| f(n % 8, n / 8, z)).collect::<Vec<_>>();
        let both = [slice(0), slice(2)];
        assert!(slice_error(&axes, &slice(1), &both, 0.5) < 1e-9);
        assert!(slice_error(&axes, &slice(2), &both, 0.5) > 1.0);
    }

    #[test]
    fn cpu_time_grows() {
        let before = cpu_seconds();
        if before.is_nan() {
            return;
        }
        let mut sum = 0u64;
        while cpu_seconds() <= before {
            sum = (0..100_000u64).fold(sum, |a, b| a.wrapping_mul(3).wrapping_add(b));
        }
        assert!(cpu_seconds() > before, "{sum}");
    }
}
