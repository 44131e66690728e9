//! The thesis's pictures of surfaces: panels side by side, all of a data set seen from the same
//! place.

use crate::data::Dataset;
use crate::document::Picture;
use crate::plots::{captioned, write_png};
use crate::runs::{How, Lab, Outcome, Points};
use crate::tables::{COMPARED, PARTS, STRUCTURED, UNSTRUCTURED, subsampled};
use isospan::Result;
use isospan::formats::surface::load_surface;
use isospan::render::{Camera, Paint, RenderSettings, Subject, View, render};
use isospan::surface::TriMesh;
use isospan::surface::check::CheckSettings;
use std::path::{Path, PathBuf};

/// Pixels of a panel's sides, and of the room for words below it.
const SIDE: u32 = 360;
const WORDS: u32 = 30;

/// A surface with its name.
struct Panel {
    words: String,
    dataset: Dataset,
    file: PathBuf,
}

/// A figure: its number, caption, panels in rows of so many.
struct Figure {
    number: &'static str,
    caption: String,
    columns: usize,
    panels: Vec<Panel>,
}

impl Panel {
    fn of(dataset: Dataset, words: &str, outcome: &Outcome) -> Self {
        Self { words: format!("{}: {words}", dataset.name()), dataset, file: outcome.file.clone() }
    }

    fn original(lab: &Lab, dataset: Dataset) -> Option<Self> {
        let original = lab.original(dataset)?;
        let words = format!("{}: original, isovalue {}", dataset.name(), original.made.isovalue);
        Some(Self { words, dataset, file: original.file.clone() })
    }
}

/// Draws the figures of surfaces, of the data sets that there are.
pub(crate) fn draw_all(lab: &mut Lab, folder: &Path) -> Result<Vec<Picture>> {
    let mut figures = vec![originals(lab, "3.1", &STRUCTURED), originals(lab, "4.1", &UNSTRUCTURED)];
    for (number, datasets, part, name) in [
        ("3.2", &STRUCTURED[..], 4, "cubic"),
        ("3.3", &STRUCTURED[..], 16, "cubic"),
        ("4.4", &UNSTRUCTURED[..], 2, "quadratic"),
        ("4.5", &UNSTRUCTURED[..], 16, "quadratic"),
    ] {
        figures.push(interpolations(lab, number, datasets, part, name)?);
    }
    let all = STRUCTURED.into_iter().chain(UNSTRUCTURED);
    for (dataset, number) in all.clone().zip(["3.4", "3.5", "4.7", "4.8", "4.9"]) {
        figures.push(sets(lab, number, dataset)?);
    }
    for (dataset, number) in STRUCTURED.into_iter().zip(["3.6", "3.7"]) {
        figures.push(cross(lab, number, dataset)?);
    }
    for (dataset, number) in all.zip(["3.8", "3.9", "4.10", "4.11", "4.12"]) {
        figures.push(reductions(lab, number, dataset)?);
    }
    let drawn = figures.iter().filter(|f| !f.panels.is_empty()).map(|f| f.draw(lab, folder));
    drawn.collect()
}

fn originals(lab: &Lab, number: &'static str, datasets: &[Dataset]) -> Figure {
    let panels: Vec<Panel> = datasets.iter().filter_map(|&d| Panel::original(lab, d)).collect();
    let kind = if number == "3.1" { "structured" } else { "unstructured" };
    Figure {
        number,
        caption: format!("Isosurfaces of some {kind} data sets."),
        columns: datasets.len(),
        panels,
    }
}

fn interpolations(
    lab: &mut Lab,
    number: &'static str,
    datasets: &[Dataset],
    part: u64,
    name: &str,
) -> Result<Figure> {
    let mut panels = vec![];
    for &dataset in datasets {
        for (words, how) in [("linear", How::Linear), (name, How::Higher)] {
            let outcome = lab.part(dataset, Points::Hammersley, part, how)?;
            panels.extend(outcome.map(|o| Panel::of(dataset, &format!("{words}, 1/{part}"), &o)));
        }
    }
    let caption =
        format!("Comparisons between linear and {name} interpolation, 1/{part} of the original data size.");
    Ok(Figure { number, caption, columns: 2, panels })
}

fn sets(lab: &mut Lab, number: &'static str, dataset: Dataset) -> Result<Figure> {
    let mut panels = vec![];
    for points in COMPARED {
        let outcome = lab.part(dataset, points, 8, How::Linear)?;
        panels.extend(
            outcome.map(|o| Panel::of(dataset, &format!("{}, {} points", points.name(), o.points), &o)),
        );
    }
    let caption = format!(
        "Comparison between QMC and regular points for {}: one-eighth of the original data size, and samples of the boundary.",
        dataset.name()
    );
    Ok(Figure { number, caption, columns: 2, panels })
}

fn cross(lab: &mut Lab, number: &'static str, dataset: Dataset) -> Result<Figure> {
    let mut panels = vec![];
    for points in [Points::Hyperbolic, Points::Hammersley, Points::Halton] {
        let how = if points == Points::Hyperbolic { "subsampling" } else { "interpolation" };
        let outcome = lab.run(subsampled(dataset, points))?;
        panels.extend(outcome.map(|o| Panel::of(dataset, &format!("{} ({how})", points.name()), &o)));
    }
    let caption = format!(
        "Comparison between subsampling (hyperbolic cross points) and interpolation (Hammersley and Halton points) for {}.",
        dataset.name()
    );
    Ok(Figure { number, caption, columns: 3, panels })
}

fn reductions(lab: &mut Lab, number: &'static str, dataset: Dataset) -> Result<Figure> {
    let mut panels: Vec<Panel> = Panel::original(lab, dataset).into_iter().collect();
    for part in PARTS {
        let outcome = lab.part(dataset, Points::Hammersley, part, How::Linear)?;
        panels.extend(outcome.map(|o| Panel::of(dataset, &format!("1/{part}, {} points", o.points), &o)));
    }
    let caption = format!("Data reduction comparisons for {}, Hammersley points.", dataset.name());
    Ok(Figure { number, caption, columns: 3, panels })
}

impl Figure {
    fn draw(&self, lab: &Lab, folder: &Path) -> Result<Picture> {
        let columns = self.columns.min(self.panels.len());
        let rows = self.panels.len().div_ceil(columns);
        let size = (SIDE * columns as u32, (SIDE + WORDS) * rows as u32);
        let mut pixels = vec![255u8; (size.0 * size.1 * 3) as usize];
        let mut words = vec![];
        for (n, panel) in self.panels.iter().enumerate() {
            let (x, y) = ((n % columns) as u32 * SIDE, (n / columns) as u32 * (SIDE + WORDS));
            let image = picture_of(lab, panel)?;
            for (row, line) in image.chunks((SIDE * 3) as usize).enumerate() {
                let at = (((y + row as u32) * size.0 + x) * 3) as usize;
                pixels[at..at + line.len()].copy_from_slice(line);
            }
            words.push(((x + SIDE / 2) as i32, (y + SIDE + 2) as i32, panel.words.clone()));
        }
        let file = format!("figure-{}.png", self.number);
        captioned(&mut pixels, size, &words);
        write_png(&pixels, size, &folder.join(&file))?;
        Ok(Picture { number: self.number.into(), caption: self.caption.clone(), file })
    }
}

/// Directions of light: enough for soft shadows in a small panel.
const LIGHTS: u32 = 24;
/// Samples along each side of a pixel.
const SAMPLES: u32 = 2;
const COLOUR: [u8; 3] = [222, 204, 172];

/// Red, green, blue of each pixel of a panel. Triangles are flat: that shows how smooth a surface
/// is, which normals from the field's gradient would hide.
fn picture_of(lab: &Lab, panel: &Panel) -> Result<Vec<u8>> {
    let original = lab.original(panel.dataset).expect("a panel is of a data set that was made");
    let (azimuth, elevation) = match panel.dataset {
        Dataset::Heart => (-60.0, 20.0),
        Dataset::Head => (-50.0, 40.0),
        _ => (-55.0, 25.0),
    };
    let camera = Camera { azimuth, elevation, perspective: false, ..Camera::default() };
    let view = View::fit(&camera, &[&original.surface], [SIDE; 2])?;
    let mut surface = TriMesh::from_source(&load_surface(&panel.file, &CheckSettings::default())?)?;
    // Where values grow towards the viewer, the side that is seen counts as the inner one, and
    // would be drawn darker.
    if !matches!(panel.dataset, Dataset::Heart | Dataset::Torso) {
        surface.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    let subject = Subject { surface: &surface, paint: Paint::Plain(COLOUR), opacity: 1.0, values: &[] };
    let settings =
        RenderSettings { flat: true, lights: LIGHTS, samples: SAMPLES, ..RenderSettings::default() };
    let image = render(&[subject], &view, &settings)?;
    Ok(image.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect())
}
