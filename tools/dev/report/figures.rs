//! The thesis's figures, and charts that it does not have.

use crate::data::Dataset;
use crate::document::Picture;
use crate::plots::{Chart, Line, write, write_points};
use crate::runs::{How, Lab, Outcome, Points, Times};
use crate::tables::{PARTS, STRUCTURED, UNSTRUCTURED};
use isospan::Result;
use isospan::points::PointSpec;
use std::path::Path;

fn name_of(number: &str) -> String {
    format!("figure-{number}.png")
}

/// Figures 2.1 to 2.3: points.
pub(crate) fn points(folder: &Path) -> Result<Vec<Picture>> {
    let sets = [
        ("2.1", "Hammersley", PointSpec::Hammersley { n: 500, shift: 0.0 }),
        ("2.2", "Halton", PointSpec::Halton { n: 500 }),
        (
            "2.3",
            "hyperbolic cross (m = 2, k = 2, r = 1)",
            PointSpec::HyperbolicCross { m: 2, k: 2, r: [1; 3] },
        ),
    ];
    let draw = |(number, name, spec): (&str, &str, PointSpec)| {
        let file = name_of(number);
        let n = write_points(spec, &folder.join(&file))?;
        let caption = format!("Three-dimensional {name} points. The total number of points is {n}.");
        Ok(Picture { number: number.into(), caption, file })
    };
    sets.into_iter().map(draw).collect()
}

/// Figures 3.10, 4.6 and 4.13: seconds of interpolation and extraction over the number of points.
pub(crate) fn times(lab: &mut Lab, folder: &Path) -> Result<Vec<Picture>> {
    let all = [
        ("3.10", &STRUCTURED[..], "Data reduction performance on data sets SPHERE and SEIS."),
        (
            "4.6",
            &UNSTRUCTURED[..],
            "Time spent in linear interpolation and extraction for different numbers of QMC points.",
        ),
        ("4.13", &UNSTRUCTURED[..], "Data reduction performance."),
    ];
    let mut out = vec![];
    for (number, datasets, caption) in all {
        let mut charts = vec![];
        for &dataset in datasets {
            let times = times_of_parts(lab, dataset)?;
            // Figure 4.13 has the part of the points on its axis.
            let part = number == "4.13";
            let original = lab.original(dataset).map_or(1.0, |o| o.size() as f64);
            let x = |t: &Times| if part { t.asked as f64 / original } else { t.points as f64 };
            let lines = vec![
                line("interpolation", &times, x, |t| t.sample),
                line("isosurface extraction", &times, x, |t| t.extract),
            ];
            let x = if part { "part of the original data" } else { "number of points" };
            charts.push(Chart {
                title: dataset.name().into(),
                x: x.into(),
                y: "seconds".into(),
                log: false,
                lines,
            });
        }
        out.extend(chart_of(number, caption, charts, folder)?);
    }
    Ok(out)
}

/// The outcomes of all parts, the fewest points first.
fn parts(lab: &mut Lab, dataset: Dataset, points: Points) -> Result<Vec<Outcome>> {
    let mut out = vec![];
    for part in PARTS.into_iter().rev() {
        out.extend(lab.part(dataset, points, part, How::Linear)?);
    }
    out.sort_by_key(|o| o.points);
    Ok(out)
}

/// Hammersley's times of all parts, the fewest points first.
fn times_of_parts(lab: &mut Lab, dataset: Dataset) -> Result<Vec<Times>> {
    let mut out = vec![];
    for part in PARTS.into_iter().rev() {
        out.extend(lab.times_of_part(dataset, Points::Hammersley, part, How::Linear)?);
    }
    Ok(out)
}

fn line<T>(name: &str, all: &[T], x: impl Fn(&T) -> f64, y: impl Fn(&T) -> f64) -> Line {
    Line { name: name.into(), points: all.iter().map(|o| (x(o), y(o))).collect(), dashed: false }
}

pub(crate) fn chart_of(
    number: &str,
    caption: &str,
    charts: Vec<Chart>,
    folder: &Path,
) -> Result<Option<Picture>> {
    let charts: Vec<Chart> =
        charts.into_iter().filter(|c| c.lines.iter().any(|l| !l.points.is_empty())).collect();
    if charts.is_empty() {
        return Ok(None);
    }
    let file = name_of(number);
    write(&charts, &folder.join(&file))?;
    Ok(Some(Picture { number: number.into(), caption: caption.into(), file }))
}

/// What is drawn over the number of points.
type Measure = (&'static str, &'static str, fn(&Outcome) -> f64);

/// Charts of ours, with logarithmic axes: times of the stages, and errors of all point sets.
pub(crate) fn slopes(lab: &mut Lab, folder: &Path) -> Result<Vec<Picture>> {
    let datasets: Vec<Dataset> = lab.datasets().collect();
    let mut charts = vec![];
    for &dataset in &datasets {
        charts.push(time_chart(lab, dataset)?);
    }
    let caption = "Seconds of the stages over the number of points, Hammersley, one thread.";
    let mut out: Vec<Picture> = chart_of("T.1", caption, charts, folder)?.into_iter().collect();
    let measures: [Measure; 3] = [
        ("E.1", "error of the field (% of the spread)", |o| 100.0 * o.field_error()),
        ("E.2", "Hausdorff distance (% of the diagonal)", |o| 100.0 * o.distances.hausdorff),
        ("E.3", "RMS deviation of normals (degrees)", |o| o.distances.normal),
    ];
    for (number, title, measure) in measures {
        let mut charts = vec![];
        for &dataset in &datasets {
            let mut lines = vec![];
            for points in Points::ALL {
                let outcomes = parts(lab, dataset, points)?;
                lines.push(line(points.name(), &outcomes, |o: &Outcome| o.points as f64, measure));
            }
            lines.retain(|l| !l.points.is_empty());
            charts.push(Chart {
                title: dataset.name().into(),
                x: "points".into(),
                y: title.into(),
                log: true,
                lines,
            });
        }
        let what = match number {
            "E.1" => {
                "Error of the field, RMS of SPHERE and SEIS, 95th percentile of the others, in % of the spread of the values"
            }
            "E.2" => "Hausdorff distance of the surface from the original's, in % of the diagonal",
            _ => "RMS deviation of the normals from those of the original's surface, in degrees",
        };
        out.extend(chart_of(number, &format!("{what}, over the number of points."), charts, folder)?);
    }
    Ok(out)
}

pub(crate) fn time_chart(lab: &mut Lab, dataset: Dataset) -> Result<Chart> {
    let times = times_of_parts(lab, dataset)?;
    let x = |t: &Times| t.points as f64;
    let lines = vec![
        line("mesh generation", &times, x, |t| t.mesh),
        line("interpolation", &times, x, |t| t.sample),
        line("extraction", &times, x, |t| t.extract),
    ];
    Ok(Chart { title: dataset.name().into(), x: "points".into(), y: "seconds".into(), log: true, lines })
}
