//! The thesis's tables with our figures next to its own, and tables of errors that it does not
//! have.

use crate::data::Dataset;
use crate::document::{Cell, Table};
use crate::runs::{How, Key, Lab, Outcome, Points, Times, is_grid};
use crate::thesis::{self, printed};
use isospan::{Error, Result};
use std::path::Path;

/// Parts of the points that are tried: 1/n.
pub(crate) const PARTS: [u64; 5] = [1, 2, 4, 8, 16];
pub(crate) const STRUCTURED: [Dataset; 2] = [Dataset::Sphere, Dataset::Seis];
pub(crate) const UNSTRUCTURED: [Dataset; 3] = [Dataset::Heart, Dataset::Torso, Dataset::Head];
/// Those that the thesis compares.
pub(crate) const COMPARED: [Points; 4] =
    [Points::Hammersley, Points::Halton, Points::Hyperbolic, Points::Regular];

/// A stage's seconds.
type Stage = fn(&Times) -> f64;

const SAMPLE: Stage = |o| o.sample;
const MESH: Stage = |o| o.mesh;
const EXTRACT: Stage = |o| o.extract;

fn compared(thesis: f64, ours: Option<f64>) -> Cell {
    Cell::Compared { thesis: printed(thesis), ours }
}

fn table(number: &str, title: &str, columns: &[&str], note: &str) -> Table {
    Table {
        number: number.into(),
        title: title.into(),
        columns: columns.iter().map(|c| (*c).into()).collect(),
        rows: vec![],
        note: note.into(),
    }
}

/// Tables 3.1 and 4.1.
pub(crate) fn sizes(lab: &Lab, number: &str, datasets: &[Dataset]) -> Table {
    let vertices = if is_grid(datasets[0]) { "Samples" } else { "Vertices" };
    let mut out = table(
        number,
        "Data sets",
        &[vertices, "Cells", "Isovalue", "Made how"],
        "Cells of samples: six tetrahedra a cube.",
    );
    for &dataset in datasets {
        let (points, cells) = thesis::sizes(dataset);
        let original = lab.original(dataset);
        let row = vec![
            compared(points, original.map(|o| o.size() as f64)),
            compared(cells, original.map(|o| o.field.tets.len() as f64)),
            original.map_or(Cell::Empty, |o| Cell::Number(f64::from(o.made.isovalue))),
            original.map_or(Cell::Empty, |o| Cell::Text(o.made.origin.clone())),
        ];
        out.rows.push((dataset.name().into(), row));
    }
    out
}

/// Tables 3.2 and 4.2: Hammersley points, 1/`part` of them.
pub(crate) fn interpolation(
    lab: &mut Lab,
    number: &str,
    datasets: &[Dataset],
    part: u64,
    times: &thesis::Times,
) -> Result<Table> {
    let names: Vec<&str> = datasets.iter().map(|d| d.name()).collect();
    let note = format!(
        "Seconds, one thread; Hammersley points, 1/{part} of the original. The thesis's: an IBM RS6000 with 512 MB. Extraction by the \
         archive's index, from opening it to the welded surface."
    );
    let mut out = table(number, "Interpolation performance", &names, &note);
    let stages = [(How::Linear, SAMPLE), (How::Higher, SAMPLE), (How::Linear, MESH), (How::Linear, EXTRACT)];
    for ((name, printed), (how, stage)) in times.iter().zip(stages) {
        let mut row = vec![];
        for (&dataset, &seconds) in datasets.iter().zip(*printed) {
            let times = lab.times_of_part(dataset, Points::Hammersley, part, how)?;
            row.push(compared(seconds, times.as_ref().map(stage)));
        }
        out.rows.push(((*name).into(), row));
    }
    Ok(out)
}

/// Table 3.3.
pub(crate) fn structured_sets(lab: &mut Lab) -> Result<Table> {
    let note = "Seconds, one thread; 1/8 of the original, 15 625 points (the thesis says 62 500, which is 1/2; its times are those of 1/8). \
                Regular points are samples: their values are read, not interpolated. Original: extraction from an archive of all samples.";
    let mut out = table("3.3", "Performance of QMC points", &SIX, note);
    for ((name, printed), points) in
        thesis::TABLE_3_3.iter().zip(COMPARED.map(Some).into_iter().chain([None]))
    {
        let of = |lab: &mut Lab, dataset| match points {
            Some(points) => lab.times_of_part(dataset, points, 8, How::Linear),
            None => lab.times_of_part(dataset, Points::Regular, 1, How::Linear),
        };
        let row = six(lab, printed, points.is_none(), of)?;
        out.rows.push(((*name).into(), row));
    }
    Ok(out)
}

/// Table 3.4.
pub(crate) fn subsampling(lab: &mut Lab) -> Result<Table> {
    let note = format!(
        "Seconds, one thread; {} points asked for. A hyperbolic cross has the number nearest to that which its formula allows; its points take the \
         value of the nearest sample (`--interp nearest`), which takes time but no arithmetic.",
        thesis::SUBSAMPLED
    );
    let mut out = table("3.4", "Performance of subsampling and interpolation", &SIX, &note);
    let sets = [Points::Hammersley, Points::Halton, Points::Hyperbolic];
    for ((name, printed), points) in thesis::TABLE_3_4.iter().zip(sets) {
        let row = six(lab, printed, false, |lab, dataset| lab.times(subsampled(dataset, points)))?;
        out.rows.push(((*name).into(), row));
    }
    Ok(out)
}

/// An experiment of section 3.3.2: the hyperbolic cross subsamples, the others interpolate.
pub(crate) fn subsampled(dataset: Dataset, points: Points) -> Key {
    let how = if points == Points::Hyperbolic { How::Nearest } else { How::Linear };
    Key { dataset, points, count: thesis::SUBSAMPLED, how }
}

/// Times of extraction over the number of points, all sets and data sets, with VTK's from all
/// samples, of a file that `vtk_times.py` wrote.
pub(crate) fn extraction(lab: &mut Lab, number: &str, vtk: Option<&Path>) -> Result<Table> {
    let columns = PARTS.map(|part| if part == 1 { "all".into() } else { format!("1/{part}") });
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let note = "Milliseconds, one thread, from opening the archive to the welded surface, nothing kept from before: as many points as samples or vertices, \
                and parts of them. VTK: vtkFlyingEdges3D of grids and vtkContour3DLinearGrid of meshes, from all samples in memory.";
    let mut out = table(number, "Times of extraction over points", &columns, note);
    let found = match vtk {
        Some(path) => std::fs::read_to_string(path).map_err(|e| Error::io("read", path, e))?,
        None => String::new(),
    };
    let of_vtk = |dataset: Dataset| {
        let line = found.lines().find_map(|line| line.strip_prefix(dataset.name())?.strip_prefix(','))?;
        line.split(',').next()?.parse::<f64>().ok()
    };
    for dataset in lab.datasets().collect::<Vec<_>>() {
        for points in COMPARED {
            let mut row = vec![];
            for part in PARTS {
                let times = lab.times_of_part(dataset, points, part, How::Linear)?;
                row.push(times.map_or(Cell::Empty, |times| Cell::Number(1e3 * times.extract)));
            }
            out.rows.push((format!("{}, {}", dataset.name(), points.name()), row));
        }
        let mut row = vec![of_vtk(dataset).map_or(Cell::Empty, Cell::Number)];
        row.resize(PARTS.len(), Cell::Empty);
        out.rows.push((format!("{}, VTK from all samples", dataset.name()), row));
    }
    Ok(out)
}

const SIX: [&str; 6] = [
    "Interpolation, SPHERE",
    "Interpolation, SEIS",
    "Mesh generation, SPHERE",
    "Mesh generation, SEIS",
    "Extraction, SPHERE",
    "Extraction, SEIS",
];

/// Three stages of the two structured sets; of the original, only the last.
fn six(
    lab: &mut Lab,
    printed: &[f64],
    extraction_only: bool,
    of: impl Fn(&mut Lab, Dataset) -> Result<Option<Times>>,
) -> Result<Vec<Cell>> {
    let mut row = vec![];
    for (stage, pair) in [SAMPLE, MESH, EXTRACT].iter().zip(printed.chunks(2)) {
        for (&dataset, &seconds) in STRUCTURED.iter().zip(pair) {
            let shown = !extraction_only || row.len() >= 4;
            let times = of(lab, dataset)?;
            row.push(if shown { compared(seconds, times.as_ref().map(stage)) } else { Cell::Empty });
        }
    }
    Ok(row)
}

/// Table 4.3.
pub(crate) fn unstructured_sets(lab: &mut Lab) -> Result<Table> {
    let names = COMPARED.map(Points::name);
    let mut out = table(
        "4.3",
        "Performance of QMC points",
        &names,
        "Seconds, one thread; 1/8 of the original's vertices.",
    );
    let stages = [SAMPLE, MESH, EXTRACT].into_iter().flat_map(|s| UNSTRUCTURED.map(|d| (s, d)));
    for ((name, printed), (stage, dataset)) in thesis::TABLE_4_3.iter().zip(stages) {
        let mut row = vec![];
        for (points, &seconds) in COMPARED.into_iter().zip(*printed) {
            let times = lab.times_of_part(dataset, points, 8, How::Linear)?;
            row.push(compared(seconds, times.as_ref().map(stage)));
        }
        out.rows.push(((*name).into(), row));
    }
    Ok(out)
}

const ERROR_COLUMNS: [&str; 9] = [
    "Points",
    "Tetrahedra",
    "Field RMS %",
    "Field 95 % below, %",
    "Hausdorff %",
    "Surface RMS %",
    "Normals °",
    "Roughness °",
    "Triangles",
];

const ERROR_NOTE: &str = "Field: the reduced field less the original at the original's samples, in percent of the spread of its values (5th to 95th \
     percentile). Surface: distances from the original's surface, both ways, in percent of the diagonal of the bounding box. Normals: RMS angle \
     between the planes of a triangle and of the nearest one of the other surface. Roughness: RMS angle between triangles that share an edge. All sets have as many points, those of \
     the boundary included, but for those that cannot have any number and take the nearest they can.";

fn error_row(o: &Outcome) -> Vec<Cell> {
    let percent = |x: f64| Cell::Number(100.0 * x);
    vec![
        Cell::Number(o.points as f64),
        Cell::Number(o.tetrahedra as f64),
        percent(o.field.rms),
        percent(o.field.most),
        percent(o.distances.hausdorff),
        percent(o.distances.rms),
        Cell::Number(o.distances.normal),
        Cell::Number(o.roughness),
        Cell::Number(o.triangles as f64),
    ]
}

/// Errors of all point sets and parts of a data set.
pub(crate) fn errors(lab: &mut Lab, number: &str, dataset: Dataset) -> Result<Table> {
    let title = format!("Errors of {}, linear interpolation", dataset.name());
    let mut out = table(number, &title, &ERROR_COLUMNS, ERROR_NOTE);
    if let Some(original) = lab.original(dataset) {
        let mut row =
            vec![Cell::Number(original.size() as f64), Cell::Number(original.field.tets.len() as f64)];
        row.extend(vec![Cell::Empty; 5]);
        row.push(Cell::Number(original.roughness));
        row.push(Cell::Number(original.surface.triangles.len() as f64));
        out.rows.push(("Original".into(), row));
    }
    for part in PARTS {
        for points in Points::ALL {
            if let Some(outcome) = lab.part(dataset, points, part, How::Linear)? {
                out.rows.push((format!("1/{part} {}", points.name()), error_row(&outcome)));
            }
        }
    }
    Ok(out)
}

/// Linear against higher interpolation, Hammersley points.
pub(crate) fn higher(lab: &mut Lab, number: &str) -> Result<Table> {
    let note = "Hammersley points. Cubic and quadratic as derived from Taylor's formula; \"as printed\" are the thesis's formulas: its second derivative is a \
                fourth difference, its quadratic function with means at the edges is linear.";
    let mut out = table(number, "Linear against higher interpolation", &ERROR_COLUMNS, note);
    let datasets: Vec<Dataset> = lab.datasets().collect();
    for dataset in datasets {
        let higher = if is_grid(dataset) { "cubic" } else { "quadratic" };
        let kinds = [
            ("linear".to_owned(), How::Linear),
            (higher.to_owned(), How::Higher),
            (format!("{higher} as printed"), How::HigherThesis),
        ];
        for (part, (name, how)) in PARTS.into_iter().flat_map(|p| kinds.iter().map(move |k| (p, k))) {
            if let Some(outcome) = lab.part(dataset, Points::Hammersley, part, *how)? {
                out.rows.push((format!("{} 1/{part} {name}", dataset.name()), error_row(&outcome)));
            }
        }
    }
    Ok(out)
}

/// The hyperbolic cross, subsampled and interpolated.
pub(crate) fn cross(lab: &mut Lab, number: &str) -> Result<Table> {
    let mut out = table(
        number,
        "Subsampling against interpolation, hyperbolic cross",
        &ERROR_COLUMNS,
        "Subsampled: the value of the nearest sample.",
    );
    for dataset in STRUCTURED {
        for part in PARTS {
            for (name, how) in [("subsampled", How::Nearest), ("interpolated", How::Linear)] {
                if let Some(outcome) = lab.part(dataset, Points::Hyperbolic, part, how)? {
                    out.rows.push((format!("{} 1/{part} {name}", dataset.name()), error_row(&outcome)));
                }
            }
        }
    }
    Ok(out)
}
