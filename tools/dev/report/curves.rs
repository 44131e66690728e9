//! The error over the number of points and over bytes, of real and of made data: each point set
//! with values sampled and fitted, against every k-th voxel.
//!
//! ```text
//!  volume ─▶ reduce ─▶ archive: bytes, error of the field ─▶ surface ─▶ distance from marching cubes on all samples
//!         ─▶ every k-th sample: bytes, trilinear error ─▶ marching cubes ─▶ the same
//! ```
//!
//! Bytes of every k-th voxel are those of its values alone, by the coder of an archive's values
//! (pco).

use crate::data::{Content, Dataset};
use crate::document::{Cell, Picture, Table};
use crate::figures::chart_of;
use crate::methods::volume::Volume;
use crate::methods::{coordinates, marching, sample_of};
use crate::plots::{Chart, Line};
use crate::runs::{Lab, Points, distances, is_grid};
use isospan::exec::Silent;
use isospan::formats::{OpenOptions, StepSource};
use isospan::measure::ErrorSums;
use isospan::pipeline::{Amount, ReduceSettings, RunSettings, reduce_series};
use isospan::points::SetKind;
use isospan::sample::Values;
use isospan::surface::TriMesh;
use isospan::{Archive, Error, Resources, Result};
use std::path::{Path, PathBuf};

/// Parts 1/n of the samples that are tried: those that every 2nd, 3rd and 4th voxel along each axis
/// have.
const PARTS: [u64; 3] = [8, 27, 64];
const STEPS: [usize; 3] = [2, 3, 4];

/// Volumes of the shared folder: name, file, isovalue.
const REAL: [(&str, &str, f32); 4] = [
    ("CT of a tooth", "volumes/tooth_ct_u16be/tooth.nhdr", 600.0),
    ("CT of a lung", "volumes/lung_ct_i16_zlib.mha", -500.0),
    ("MR angiography", "volumes/carotid_flow_f32be.vtk", 160.0),
    ("hurricane (simulation)", "volumes/isabel_wind_f64_t02.vti", 25.0),
];

/// A field with what reductions of it are measured against.
struct MeasuredField {
    name: String,
    input: PathBuf,
    isovalue: f32,
    /// `None` of a mesh.
    volume: Option<Volume>,
    size: u64,
    surface: TriMesh,
    diagonal: f64,
    /// The 95th percentile of the values less the 5th.
    spread: f64,
}

/// A way to reduce a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Way {
    Set(Points, Values),
    /// Halton points, dense where the field needs them.
    Adapted(Values),
    /// Every k-th voxel.
    Voxels,
}

/// A reduction in figures: errors in percent of the spread and of the diagonal, and degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Dot {
    points: f64,
    bytes: f64,
    field: f64,
    surface: f64,
    normal: f64,
}

/// All reductions of a field in one way, the fewest points first.
struct Curve {
    way: Way,
    dots: Vec<Dot>,
}

/// What was found of all fields.
pub(crate) struct Curves {
    fields: Vec<(String, Vec<Curve>)>,
}

/// What a name says of the values.
fn of_values(values: Values) -> &'static str {
    match values {
        Values::Sample => "",
        Values::Fit => ", fitted",
    }
}

impl Way {
    fn name(self) -> String {
        match self {
            Self::Set(points, values) => format!("{}{}", points.name(), of_values(values)),
            Self::Adapted(values) => format!("Halton, adapted{}", of_values(values)),
            Self::Voxels => "every k-th voxel".into(),
        }
    }

    /// How the library is to reduce; `None` of every k-th voxel.
    fn settings(self) -> Option<ReduceSettings> {
        let (points, adapt, values) = match self {
            Self::Set(points, values) => (points.kind()?, false, values),
            Self::Adapted(values) => (SetKind::Halton, true, values),
            Self::Voxels => return None,
        };
        Some(ReduceSettings { adapt, values: Some(values), ..ReduceSettings::exact(points) })
    }

    /// Those that a field can be reduced in.
    fn of(field: &MeasuredField, quick: bool) -> Vec<Self> {
        if quick {
            let [sampled, fitted] = [Values::Sample, Values::Fit].map(|v| Self::Set(Points::Hammersley, v));
            return vec![sampled, fitted, Self::Adapted(Values::Sample), Self::Voxels];
        }
        let sets = Points::ALL.into_iter().filter(|p| p.kind().is_some());
        let both = [Values::Sample, Values::Fit];
        let all = sets.flat_map(|p| both.map(|v| Self::Set(p, v))).chain(both.map(Self::Adapted));
        // A mesh has no voxels.
        all.chain(field.volume.is_some().then_some(Self::Voxels)).collect()
    }
}

impl MeasuredField {
    /// The fields of this run: of the lab, and real ones where there is a folder of them.
    fn all(lab: &Lab, shared: Option<&Path>, quick: bool) -> Result<Vec<Self>> {
        let mut out = vec![];
        let made = [Dataset::Sphere, Dataset::Seis, Dataset::Heart];
        for dataset in made.into_iter().filter(|d| !quick || is_grid(*d)) {
            let Some(original) = lab.original(dataset) else { continue };
            let (name, input, isovalue) =
                (dataset.name(), original.made.file.clone(), original.made.isovalue);
            out.push(match &original.made.content {
                Content::Grid { .. } => Self::of_volume(name, input, isovalue)?,
                Content::Mesh(_) => Self {
                    name: name.into(),
                    input,
                    isovalue,
                    volume: None,
                    size: original.size(),
                    surface: original.surface.clone(),
                    diagonal: original.diagonal,
                    spread: original.spread,
                },
            });
        }
        if let Some(shared) = shared.filter(|_| !quick) {
            for (name, file, isovalue) in REAL {
                out.push(Self::of_volume(name, shared.join(file), isovalue)?);
            }
        }
        Ok(out)
    }

    fn of_volume(name: &str, input: PathBuf, isovalue: f32) -> Result<Self> {
        let volume = Volume::read(&input)?;
        let Volume { dims, samples, geometry } = &volume;
        let surface = marching::surface(*dims, samples, geometry, isovalue);
        let side: [f64; 3] = std::array::from_fn(|a| geometry.spacing[a] * (dims[a] - 1) as f64);
        let at = |share| f64::from(crate::data::quantile(samples, share));
        Ok(Self {
            name: name.into(),
            input,
            isovalue,
            size: samples.len() as u64,
            surface,
            diagonal: side.iter().map(|s| s * s).sum::<f64>().sqrt(),
            spread: at(0.95) - at(0.05),
            volume: Some(volume),
        })
    }

    fn reduced(&self, settings: &ReduceSettings, part: u64, folder: &Path) -> Result<Dot> {
        let archive = folder.join("curve.isospan");
        let settings = ReduceSettings { amount: Amount::Count(self.size.div_ceil(part)), ..settings.clone() };
        let run = RunSettings {
            resources: Resources::default().with_scratch(Some(folder.into())),
            replace: true,
            ..RunSettings::default()
        };
        let report = reduce_series(
            &[StepSource::new(&self.input, &OpenOptions::default())],
            &settings,
            &archive,
            &run,
            &Silent,
        )?;
        let surface = Archive::open(&archive)?.surface(self.isovalue)?;
        let error = report.error.as_ref().expect("a reduction is measured");
        let of_95 = error.percentiles.iter().find(|p| p.percent == 95.0).map_or(f64::NAN, |p| p.error);
        // The cell of a mesh's dipole would outweigh all others.
        let error = if self.volume.is_some() { error.rms } else { of_95 };
        self.dot(report.points - report.void_points, report.archive_bytes, error, &surface)
    }

    fn every(&self, k: usize) -> Result<Dot> {
        let Volume { dims, samples, geometry } = self.volume.as_ref().expect("a mesh has no voxels");
        let few = dims.map(|d| (d - 1) / k + 1);
        let of = |n: usize| samples[sample_of(*dims, coordinates(few, n).map(|i| i * k))];
        let kept: Vec<f32> = (0..few.iter().product()).map(of).collect();
        let geometry =
            isospan::grid::Geometry { spacing: geometry.spacing.map(|s| s * k as f64), ..*geometry };
        let surface = marching::surface(few, &kept, &geometry, self.isovalue);
        let bytes = pco::standalone::simple_compress(&kept, &pco::ChunkConfig::default())
            .map_err(|e| Error::usage(format!("{}: its samples cannot be packed: {e}", self.name)))?;
        let mut sums = ErrorSums::default();
        // Samples behind the last kept one lie outside.
        let inside = few.map(|f| (f - 1) * k + 1);
        for n in 0..inside.iter().product() {
            let at = coordinates(inside, n);
            sums.add(samples[sample_of(*dims, at)], trilinear(few, &kept, at, k), || n as u64);
        }
        self.dot(kept.len() as u64, bytes.len() as u64, sums.rms(), &surface)
    }

    fn dot(&self, points: u64, bytes: u64, error: f64, surface: &TriMesh) -> Result<Dot> {
        let far = distances(surface, &self.surface, self.diagonal)?;
        Ok(Dot {
            points: points as f64,
            bytes: bytes as f64,
            field: 100.0 * error / self.spread,
            surface: 100.0 * far.rms,
            normal: far.normal,
        })
    }

    fn curve(&self, way: Way, folder: &Path) -> Result<Curve> {
        let dots: Result<Vec<Dot>> = match way.settings() {
            Some(settings) => PARTS.iter().rev().map(|&part| self.reduced(&settings, part, folder)).collect(),
            None => STEPS.iter().rev().map(|&k| self.every(k)).collect(),
        };
        let mut dots = dots?;
        // Sets that cannot have any number of points may have the same one twice.
        dots.dedup_by_key(|d| d.points);
        Ok(Curve { way, dots })
    }
}

/// The value at a sample's place of a grid of every k-th sample.
fn trilinear(few: [usize; 3], kept: &[f32], at: [usize; 3], k: usize) -> f32 {
    let lo: [usize; 3] = std::array::from_fn(|a| (at[a] / k).min(few[a] - 2));
    let t: [f64; 3] = std::array::from_fn(|a| (at[a] - lo[a] * k) as f64 / k as f64);
    let corner = |c: usize| {
        let bit = |a: usize| c >> a & 1;
        let weight: f64 = (0..3).map(|a| if bit(a) == 1 { t[a] } else { 1.0 - t[a] }).product();
        weight * f64::from(kept[sample_of(few, std::array::from_fn(|a| lo[a] + bit(a)))])
    };
    (0..8).map(corner).sum::<f64>() as f32
}

impl Curve {
    fn line(&self, x: fn(&Dot) -> f64, y: fn(&Dot) -> f64) -> Line {
        Line {
            name: self.way.name(),
            points: self.dots.iter().map(|d| (x(d), y(d))).collect(),
            dashed: matches!(self.way, Way::Set(_, Values::Fit) | Way::Adapted(Values::Fit)),
        }
    }

    /// The error at a size between two dots, on the line through them in the logarithms.
    fn at(&self, size: fn(&Dot) -> f64, error: fn(&Dot) -> f64, wanted: f64) -> Option<f64> {
        let pair = self.dots.windows(2).find(|p| (size(&p[0])..=size(&p[1])).contains(&wanted))?;
        let [x, y] = [size, error].map(|of| [of(&pair[0]).ln(), of(&pair[1]).ln()]);
        let part = (wanted.ln() - x[0]) / (x[1] - x[0]);
        Some((y[0] + part * (y[1] - y[0])).exp())
    }
}

/// What a size is counted in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Size {
    Points,
    Bytes,
}

/// A number of a dot that is drawn, with its title.
type Axis = (&'static str, fn(&Dot) -> f64);

const ERRORS: [Axis; 3] = [
    ("error of the field (% of the spread)", |d| d.field),
    ("RMS distance of the surface (% of the diagonal)", |d| d.surface),
    ("RMS deviation of normals (degrees)", |d| d.normal),
];
const SIZES: [Axis; 2] = [("points", |d| d.points), ("bytes", |d| d.bytes)];

/// With a capital letter.
fn upper(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

impl Curves {
    /// Reduces all fields in all ways.
    pub(crate) fn new(lab: &Lab, folder: &Path, shared: Option<&Path>, quick: bool) -> Result<Self> {
        let mut fields = vec![];
        for field in MeasuredField::all(lab, shared, quick)? {
            let curves = Way::of(&field, quick).into_iter().map(|way| field.curve(way, folder));
            fields.push((field.name.clone(), curves.collect::<Result<_>>()?));
        }
        Ok(Self { fields })
    }

    /// The names of all fields.
    pub(crate) fn names(&self) -> String {
        self.fields.iter().map(|f| f.0.as_str()).collect::<Vec<_>>().join(", ")
    }

    /// Each error over points and over bytes, a chart a field.
    pub(crate) fn pictures(&self, folder: &Path) -> Result<Vec<Picture>> {
        let mut out = vec![];
        for (size, error) in SIZES.iter().flat_map(|s| ERRORS.iter().map(move |e| (s, e))) {
            let number = format!("P.{}", out.len() + 1);
            let charts = self.fields.iter().map(|(name, curves)| Chart {
                title: name.clone(),
                x: size.0.into(),
                y: error.0.into(),
                log: true,
                lines: curves.iter().map(|c| c.line(size.1, error.1)).collect(),
            });
            let of_what = if error.0 == ERRORS[0].0 { ", RMS, of HEART the 95th percentile," } else { "" };
            let caption = format!(
                "{}{} over {}. Dashed: values fitted, in the colour of the same points with sampled values.",
                upper(error.0),
                of_what,
                size.0
            );
            out.extend(chart_of(&number, &caption, charts.collect(), folder)?);
        }
        Ok(out)
    }

    /// All figures.
    pub(crate) fn table(&self, number: &str) -> Table {
        let columns = SIZES.iter().chain(&ERRORS);
        let mut rows = vec![];
        for (name, curves) in &self.fields {
            for (curve, dot) in curves.iter().flat_map(|c| c.dots.iter().map(move |d| (c, d))) {
                let cells = SIZES.iter().chain(&ERRORS).map(|axis| Cell::Number(axis.1(dot)));
                rows.push((format!("{name}: {}", curve.way.name()), cells.collect()));
            }
        }
        Table {
            number: number.into(),
            title: "Errors over points and bytes".into(),
            columns: columns.map(|axis| axis.0.into()).collect(),
            rows,
            note: "Errors of the field: RMS, of HEART the 95th percentile. Points of 1/8, 1/27 and 1/64 of the samples, those of the boundary on top; every 2nd, 3rd, 4th voxel. Bytes of an archive: all of its files, index and \
                spectrum included; of every k-th voxel: its values, by the same coder as those of an archive. Surfaces are measured against marching \
                cubes on all samples (of a mesh: its cells)."
                .into(),
        }
    }

    /// Of each field and error: the error of a way, over that of another at its sizes. Values
    /// between two dots are read off the line through them in the logarithms; sizes beyond all dots
    /// are left out.
    pub(crate) fn ratios(&self, way: Way, against: Way, size: Size) -> Vec<(String, f64)> {
        let size = SIZES[size as usize].1;
        let mut out = vec![];
        for (name, curves) in &self.fields {
            let find = |way: Way| curves.iter().find(|c| c.way == way);
            let (Some(a), Some(b)) = (find(way), find(against)) else { continue };
            for (title, error) in ERRORS {
                for dot in &b.dots {
                    if let Some(ours) = a.at(size, error, size(dot)) {
                        let words = format!("{name}, {title}, at {:.0}", size(dot));
                        out.push((words, ours / error(dot)));
                    }
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_other_voxel_of_a_linear_field_is_enough() {
        let (few, k) = ([3, 2, 4], 3);
        let f = |[x, y, z]: [usize; 3]| x as f32 - 2.0 * y as f32 + 0.5 * z as f32;
        let kept: Vec<f32> = (0..24).map(|n| f(coordinates(few, n).map(|i| i * k))).collect();
        for n in 0..7 * 4 * 10 {
            let at = coordinates([7, 4, 10], n);
            assert!((trilinear(few, &kept, at, k) - f(at)).abs() < 1e-5, "{at:?}");
        }
    }

    #[test]
    fn errors_are_read_off_between_two_dots() {
        let dot =
            |points: f64, field: f64| Dot { points, bytes: 4.0 * points, field, surface: 1.0, normal: 1.0 };
        let curve =
            |way, scale: f64| Curve { way, dots: vec![dot(100.0, scale), dot(10_000.0, scale / 100.0)] };
        let set = Way::Set(Points::Halton, Values::Fit);
        let curves = Curves {
            fields: vec![(
                "a".into(),
                vec![curve(set, 1.0), Curve { way: Way::Voxels, dots: vec![dot(1_000.0, 0.2)] }],
            )],
        };
        let ratios = curves.ratios(set, Way::Voxels, Size::Bytes);
        assert!((ratios[0].1 - 0.5).abs() < 1e-9, "{ratios:?}");
        assert_eq!(curves.ratios(Way::Voxels, set, Size::Points), vec![]);
    }
}
