//! Makes the thesis's tables and figures again, with errors that it did not measure:
//! `tools/reproduce` calls it.
//!
//! ```text
//!  thesis_data ─▶ Lab: reduce, extract, measure, each experiment once ─▶ tables, charts, pictures, claims ─▶ report/
//! ```

#[path = "../thesis_data/data/mod.rs"]
mod data;
#[path = "../../../benches/reviewed_methods/methods/mod.rs"]
mod methods;

mod claims;
mod curves;
mod document;
mod fields;
mod figures;
mod panels;
mod plots;
mod reviewed;
mod roughness;
mod runs;
mod tables;
mod thesis;

use curves::Curves;
use data::Dataset;
use document::{Block, Document, Table};
use isospan::{Error, Result};
use runs::Lab;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

const HELP: &str = "\
usage: report FOLDER [--quick] [--vtk FILE]
  FOLDER    where the report goes: index.html, index.md, conclusions.html, a CSV file a table, a PNG file a figure
  --quick   SPHERE and HEART only, 1/4 of the points and fewer, each time measured once
  --vtk     VTK's times, as tools/dev/report/vtk_times.py prints them
Real geometries of heart and torso are taken from the folder that ISOSPAN_SHARED_DATA names; without it, ellipsoids.";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (mut folder, mut quick, mut vtk, mut is_good) = (None, false, None, true);
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => quick = true,
            "--vtk" => vtk = rest.next(),
            other if other.starts_with('-') || folder.is_some() => is_good = false,
            other => folder = Some(Path::new(other)),
        }
    }
    let Some(folder) = folder.filter(|_| is_good && (vtk.is_some() || !args.contains(&"--vtk".to_owned())))
    else {
        eprintln!("{HELP}");
        let asked = args.iter().any(|a| a == "--help" || a == "-h");
        return ExitCode::from(if asked { 0 } else { 2 });
    };
    match run(folder, quick, vtk.map(Path::new)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("report: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

fn run(folder: &Path, quick: bool, vtk: Option<&Path>) -> Result<()> {
    let started = Instant::now();
    std::fs::create_dir_all(folder).map_err(|e| Error::io("create the folder", folder, e))?;
    let work = tempfile::tempdir_in(folder).map_err(|e| Error::io("create a folder in", folder, e))?;
    let shared = std::env::var_os("ISOSPAN_SHARED_DATA").map(PathBuf::from);
    let datasets = if quick { vec![Dataset::Sphere, Dataset::Heart] } else { Dataset::ALL.to_vec() };
    let mut clock = Clock { started, last: started, words: vec![] };
    let mut lab = Lab::new(work.path(), &datasets, shared.as_deref(), quick)?;
    clock.lap("data");
    let mut report = beginning(&lab, shared.as_deref());
    chapters(&mut lab, folder, &mut report, &mut clock)?;
    report.heading(2, "Times of extraction");
    report.push(Block::Table(tables::extraction(&mut lab, "T", vtk)?));
    clock.lap("times of extraction");
    errors(&mut lab, folder, &mut report)?;
    clock.lap("errors");
    let curves = Curves::new(&lab, work.path(), shared.as_deref(), quick)?;
    curves_in(&curves, folder, &mut report)?;
    clock.lap("errors over points and bytes");
    report.heading(2, "The reviewed methods");
    let tables = reviewed::tables(&lab, shared.as_deref(), quick)?;
    tables.into_iter().for_each(|t| report.push(Block::Table(t)));
    clock.lap("reviewed methods");
    claims::conclusions(&mut lab, &curves)?.write(folder, "conclusions")?;
    if let Some(share) = lab.share_of_a_processor() {
        report.text(format!(
            "While times were taken, this process had {:.0} % of a processor. On a machine with nothing else to do it has about 100 %; times of a busy machine are too long.",
            100.0 * share
        ));
    }
    report.text(clock.words());
    report.write(folder, "index")?;
    eprintln!("report: {} experiments; see {}", lab.experiments(), folder.join("index.html").display());
    Ok(())
}

/// What took how long.
struct Clock {
    started: Instant,
    last: Instant,
    words: Vec<String>,
}

impl Clock {
    fn lap(&mut self, what: &str) {
        let words = format!("{what} {:.0}", self.last.elapsed().as_secs_f64());
        eprintln!("report: {words} s");
        self.words.push(words);
        self.last = Instant::now();
    }

    fn words(&self) -> String {
        format!("Made in {:.0} seconds: {}.", self.started.elapsed().as_secs_f64(), self.words.join(", "))
    }
}

fn beginning(lab: &Lab, shared: Option<&Path>) -> Document {
    let mut report = Document {
        title: "Fast Isosurface Extraction Using Quasi-Monte Carlo Methods, reproduced".into(),
        blocks: vec![],
    };
    let names: Vec<&str> = lab.datasets().map(Dataset::name).collect();
    report.text(format!(
        "The tables and figures of the thesis, made again by isospan {} on {}. In a table, \"30.23 → 0.0021 (14 400×)\" is the thesis's number, \
         ours, and the first over the second. All of ours are of this run; the thesis's are those it prints.",
        env!("CARGO_PKG_VERSION"),
        names.join(", ")
    ));
    report.text("The thesis's data are not to be had. SPHERE is its formula; the others are made by simulations of the same kind, which the data tables describe.");
    report.text(match shared {
        Some(_) => "Volumes of real measurements are those of the folder that ISOSPAN_SHARED_DATA names.",
        None => "ISOSPAN_SHARED_DATA is not set: there are no volumes of real measurements in this run, and no real geometries.",
    });
    report.text(
        "Times are medians of several runs on one thread, and nothing else of this report runs beside them. Errors and pictures are the same in every run.",
    );
    report.text("conclusions.html says for each of the thesis's claims whether the figures bear it out.");
    report
}

/// Chapters 2 to 4.
fn chapters(lab: &mut Lab, folder: &Path, report: &mut Document, clock: &mut Clock) -> Result<()> {
    report.heading(2, "Chapter 2. Points");
    figures::points(folder)?.into_iter().for_each(|p| report.push(Block::Picture(p)));
    // Times first: the experiments that are timed give their errors as well.
    let mut pictures = figures::times(lab, folder)?;
    let tables = [chapter_3(lab)?, chapter_4(lab)?];
    clock.lap("times");
    pictures.extend(panels::draw_all(lab, folder)?);
    clock.lap("pictures");
    // By number: 4.10 after 4.9.
    pictures.sort_by_key(|p| p.number.split('.').filter_map(|n| n.parse().ok()).collect::<Vec<u32>>());
    let titles = [("3", "Chapter 3. Structured grids"), ("4", "Chapter 4. Unstructured grids")];
    for ((chapter, title), tables) in titles.into_iter().zip(tables) {
        report.heading(2, title);
        tables.into_iter().for_each(|t| report.push(Block::Table(t)));
        let of_chapter = pictures.iter().filter(|p| p.number.starts_with(chapter));
        of_chapter.for_each(|p| report.push(Block::Picture(p.clone())));
    }
    Ok(())
}

fn chapter_3(lab: &mut Lab) -> Result<Vec<Table>> {
    Ok(vec![
        tables::sizes(lab, "3.1", &tables::STRUCTURED),
        tables::interpolation(lab, "3.2", &tables::STRUCTURED, 4, thesis::TABLE_3_2)?,
        tables::structured_sets(lab)?,
        tables::subsampling(lab)?,
    ])
}

fn chapter_4(lab: &mut Lab) -> Result<Vec<Table>> {
    Ok(vec![
        tables::sizes(lab, "4.1", &tables::UNSTRUCTURED),
        tables::interpolation(lab, "4.2", &tables::UNSTRUCTURED, 2, thesis::TABLE_4_2)?,
        tables::unstructured_sets(lab)?,
    ])
}

/// Errors, which the thesis does not have.
fn errors(lab: &mut Lab, folder: &Path, report: &mut Document) -> Result<()> {
    report.heading(2, "Errors");
    for (number, dataset) in lab.datasets().collect::<Vec<_>>().into_iter().enumerate() {
        let table = tables::errors(lab, &format!("E.{}", number + 1), dataset)?;
        report.push(Block::Table(table));
    }
    let table = tables::higher(lab, "E.6")?;
    report.push(Block::Table(table));
    let table = tables::cross(lab, "E.7")?;
    report.push(Block::Table(table));
    report.heading(2, "Slopes");
    figures::slopes(lab, folder)?.into_iter().for_each(|p| report.push(Block::Picture(p)));
    Ok(())
}

/// Errors over points and bytes.
fn curves_in(curves: &Curves, folder: &Path, report: &mut Document) -> Result<()> {
    report.heading(2, "Errors over points and bytes");
    report.text(format!("Of {}.", curves.names()));
    curves.pictures(folder)?.into_iter().for_each(|p| report.push(Block::Picture(p)));
    report.push(Block::Table(curves.table("P")));
    Ok(())
}
