//! Tables of the methods that the thesis reviews, next to our index, over the same cells.

use crate::data::{Content, Dataset, GRID};
use crate::document::{Cell, Table};
use crate::methods::volume::Volume;
use crate::methods::{Cells, Row, compare, few_and_many};
use crate::runs::Lab;
use isospan::Result;
use std::path::Path;

/// Samples along each axis of the large sphere.
const LARGE: usize = 160;
/// A volume of real measurements.
const REAL: &str = "volumes/tooth_ct_u16be/tooth.nhdr";

const NOTE: &str = "One thread; medians of so many queries of each of two isovalues in turn: of 63 over the range, the one with the fewest active \
    cells and that with the most. Memory: what is held beside values and corners; isospan's is on disk. Nothing is triangulated. All methods are tested to find \
    the same cells.";

/// All tables, numbered from R.1.
pub(crate) fn tables(lab: &Lab, shared: Option<&Path>, quick: bool) -> Result<Vec<Table>> {
    let repeats = if quick { 1 } else { 5 };
    let mut out = vec![];
    let mut add = |name: &str, cells: &Cells<'_>| -> Result<()> {
        let number = format!("R.{}", out.len() + 1);
        out.push(table(&number, name, cells, repeats)?);
        Ok(())
    };
    for dataset in [Dataset::Sphere, Dataset::Seis] {
        if let Some(Content::Grid { samples, .. }) = lab.original(dataset).map(|o| &o.made.content) {
            add(&format!("{}, cubes", dataset.name()), &Cells::Cubes { dims: [GRID; 3], samples })?;
        }
    }
    for dataset in [Dataset::Sphere, Dataset::Head].into_iter().filter(|_| !quick) {
        if let Some(original) = lab.original(dataset) {
            let (values, corners) = original.field.along_a_curve();
            let name = format!("{}, tetrahedra", dataset.name());
            add(&name, &Cells::Tets { values, corners: &corners })?;
        }
    }
    if !quick {
        for (words, noise) in [("", 0.0), (" and noise", 0.05)] {
            let Volume { dims, samples, .. } = Volume::sphere(LARGE, noise);
            add(
                &format!("SPHERE with {LARGE}³ samples{words}, cubes"),
                &Cells::Cubes { dims, samples: &samples },
            )?;
        }
        if let Some(shared) = shared {
            let Volume { dims, samples, .. } = Volume::read(&shared.join(REAL))?;
            add("CT of a tooth, cubes", &Cells::Cubes { dims, samples: &samples })?;
        }
    }
    Ok(out)
}

fn table(number: &str, name: &str, cells: &Cells<'_>, repeats: usize) -> Result<Table> {
    let isovalues = few_and_many(cells);
    let columns = ["Build, ms".to_owned(), "Bytes a cell".to_owned()]
        .into_iter()
        .chain(isovalues.map(|(isovalue, count)| format!("Query, ms: {count} active at {isovalue}")));
    let row = |row: Row| {
        let mut numbers = vec![1e3 * row.build_seconds, row.bytes as f64 / cells.len() as f64];
        numbers.extend(row.query_seconds.iter().map(|s| 1e3 * s));
        (row.name.to_owned(), numbers.into_iter().map(Cell::Number).collect())
    };
    Ok(Table {
        number: number.into(),
        title: format!("The reviewed methods on {name}: {} cells", cells.len()),
        columns: columns.collect(),
        rows: compare(cells, &isovalues, repeats)?.into_iter().map(row).collect(),
        note: NOTE.into(),
    })
}
