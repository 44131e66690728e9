//! Makes the thesis's tables and figures again, with errors that it did not measure: `tools/reproduce` calls it.
//!
//! ```text
//!  thesis_data ─▶ Lab: reduce, extract, measure, each experiment once ─▶ tables, charts, pictures, claims ─▶ report/
//! ```

#[path = "../thesis_data/data/mod.rs"]
mod data;

mod claims;
mod distances;
mod document;
mod draw;
mod fields;
mod figures;
mod panels;
mod plots;
mod runs;
mod tables;
mod thesis;

use data::Dataset;
use document::{Block, Document};
use isospan::{Error, Result};
use runs::Lab;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

const HELP: &str = "\
usage: report FOLDER [--quick]
  FOLDER    where the report goes: index.html, index.md, conclusions.html, a CSV file a table, a PNG file a figure
  --quick   SPHERE and HEART only, 1/4 of the points and fewer, each time measured once
Real geometries of heart and torso are taken from the folder that ISOSPAN_SHARED_DATA names; without it, ellipsoids.";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (options, folders): (Vec<&String>, Vec<&String>) = args.iter().partition(|a| a.starts_with('-'));
    let quick = options.iter().any(|a| *a == "--quick");
    if folders.len() != 1 || options.len() != usize::from(quick) {
        eprintln!("{HELP}");
        let asked = args.iter().any(|a| a == "--help" || a == "-h");
        return ExitCode::from(if asked { 0 } else { 2 });
    }
    match run(Path::new(folders[0]), quick) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("report: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

fn run(folder: &Path, quick: bool) -> Result<()> {
    let started = Instant::now();
    std::fs::create_dir_all(folder).map_err(|e| Error::io("create the folder", folder, e))?;
    let work = tempfile::tempdir_in(folder).map_err(|e| Error::io("create a folder in", folder, e))?;
    let shared = std::env::var_os("ISOSPAN_SHARED_DATA").map(PathBuf::from);
    let datasets = if quick { vec![Dataset::Sphere, Dataset::Heart] } else { Dataset::ALL.to_vec() };
    let mut lab = Lab::new(work.path(), &datasets, shared.as_deref(), quick)?;
    let mut report = beginning(&lab);
    chapters(&mut lab, folder, &mut report)?;
    beyond(&mut lab, folder, &mut report)?;
    claims::conclusions(&mut lab)?.write(folder, "conclusions")?;
    report.text(format!("Made in {:.0} seconds.", started.elapsed().as_secs_f64()));
    report.write(folder, "index")?;
    eprintln!("report: {} experiments; see {}", lab.experiments(), folder.join("index.html").display());
    Ok(())
}

fn beginning(lab: &Lab) -> Document {
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
    report.text("conclusions.html says for each of the thesis's claims whether the figures bear it out.");
    report
}

/// Chapters 2 to 4.
fn chapters(lab: &mut Lab, folder: &Path, report: &mut Document) -> Result<()> {
    report.heading(2, "Chapter 2. Points");
    figures::points(folder)?.into_iter().for_each(|p| report.push(Block::Picture(p)));
    let mut pictures = panels::draw_all(lab, folder)?;
    pictures.extend(figures::times(lab, folder)?);
    // By number: 4.10 after 4.9.
    pictures.sort_by_key(|p| p.number.split('.').filter_map(|n| n.parse().ok()).collect::<Vec<u32>>());
    for (chapter, title) in [("3", "Chapter 3. Structured grids"), ("4", "Chapter 4. Unstructured grids")] {
        report.heading(2, title);
        let tables = match chapter {
            "3" => vec![
                tables::sizes(lab, "3.1", &tables::STRUCTURED),
                tables::interpolation(lab, "3.2", &tables::STRUCTURED, 4, thesis::TABLE_3_2)?,
                tables::structured_sets(lab)?,
                tables::subsampling(lab)?,
            ],
            _ => vec![
                tables::sizes(lab, "4.1", &tables::UNSTRUCTURED),
                tables::interpolation(lab, "4.2", &tables::UNSTRUCTURED, 2, thesis::TABLE_4_2)?,
                tables::unstructured_sets(lab)?,
            ],
        };
        tables.into_iter().for_each(|t| report.push(Block::Table(t)));
        let of_chapter = pictures.iter().filter(|p| p.number.starts_with(chapter));
        of_chapter.for_each(|p| report.push(Block::Picture(p.clone())));
    }
    Ok(())
}

/// What the thesis does not have.
fn beyond(lab: &mut Lab, folder: &Path, report: &mut Document) -> Result<()> {
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
