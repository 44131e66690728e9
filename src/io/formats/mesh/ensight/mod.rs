//! EnSight Gold (`.case`): a text that lists files, and these, as C binary or as text.
//!
//! ```text
//! FORMAT
//! type: ensight gold
//! GEOMETRY
//! model: heart.geo
//! VARIABLE
//! scalar per node: 1 heat heart.heat.***          time set, name, file of each step
//! TIME
//! time set: 1
//! number of steps: 20
//! filename start number: 0
//! filename increment: 1
//! time values: 0 0.5 1 …
//! ```
//!
//! A geometry file has parts: the coordinates of all of its points, axis by axis, then for each
//! type of element (`tetra4`, `hexa8`, …) the points of each element, counted from 1 in the part. A
//! file of a variable has the same parts, and in each one array of `float32` for each component.
//!
//! **Parts** follow each other; a point on the border of two parts is stored, and counted, twice.
//! Flat elements (triangles, bars) and ghosts (`g_tetra4`) count as cells without a volume. Ids of
//! nodes and elements decide nothing. Structured blocks and polyhedra are refused.
//!
//! **Fields.** Parts without a variable have NaN, and so have numbers that a file calls undefined.
//! Of several steps, `heat:t0`, `heat:t1`, … are those of `heat`. Complex variables are passed
//! over.
//!
//! **Byte order** is not stored: the number of the first part, which is small, decides it.

mod case;
mod scan;

use crate::bytes::{ByteSource, IoMode};
use crate::cells::{
    BLOCK, CellBlock, CellField, CellFile, CellKind, CellMesh, CellStream, CellsInfo, Center, NumberStream,
};
use crate::error::{Error, Result};
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::mesh_file::MeshFile;
use crate::formats::shared::ranges::RangeNumbers;
use crate::formats::shared::{Frames, OpenOptions, known_times};
use crate::volume::ScalarType;
use case::{Case, Variable};
use scan::{EnsightEncoding, Geometry, Values};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

/// EnSight Gold.
pub(in crate::formats) struct EnSight;

static ABOUT: About =
    About { meshes: &["EnSight Gold"], suffixes: &[".case", ".encas"], ..About::named("an EnSight case") };

impl Format for EnSight {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let case = Case::read(head.file()?)?;
        Ok(Box::new(MeshFile::new(Mesh(Arc::new(open(head, case)?)))?))
    }
}

impl Dataset for MeshFile<Mesh> {
    fn is_mesh(&self) -> bool {
        true
    }

    fn files(&self) -> Vec<PathBuf> {
        // The others are opened when they are read.
        vec![self.file.0.geometry_file.clone()]
    }

    fn mesh(&self, options: &OpenOptions) -> Result<CellMesh> {
        self.of_field(options)
    }

    fn time(&self, _: &OpenOptions) -> Result<Option<f64>> {
        let mut times = self.file.0.variables.iter().filter(|v| v.steps.len() == 1).map(|v| v.steps[0].1);
        Ok(times.next().flatten())
    }

    fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        let found = match (&options.field, &self.file.0.variables[..]) {
            (Some(name), all) => all.iter().find(|v| v.name == *name),
            // The only variable needs no name.
            (None, [only]) => Some(only),
            _ => None,
        };
        Ok(found.filter(|v| v.steps.len() > 1).map(steps_of).unwrap_or_default())
    }

    fn times(&self, _: &OpenOptions) -> Result<HashMap<String, f64>> {
        Ok(known_times(self.file.0.variables.iter().flat_map(steps_of).collect()))
    }
}

/// The steps of a variable, and their times.
fn steps_of(variable: &Variable) -> Frames {
    (0..variable.steps.len()).map(|step| (name_of(variable, step), variable.steps[step].1)).collect()
}

/// The field of a step of a variable.
fn name_of(variable: &Variable, step: usize) -> String {
    if variable.steps.len() == 1 { variable.name.clone() } else { format!("{}:t{step}", variable.name) }
}

/// Most fields: steps of all variables.
const MOST_FIELDS: usize = 1 << 20;

fn open(head: &Head<'_>, case: Case) -> Result<Shared> {
    let (path, io) = (head.path, head.io);
    let source = Arc::new(ByteSource::open(&case.geometry, io)?);
    let geometry = scan::geometry(&source)?;
    let wrong = |expected: &str, got: &str| Error::bad_input(path, "parts and variables", expected, got);
    let total = |of: &dyn Fn(&scan::EnsightPart) -> u64| {
        geometry.parts.iter().try_fold(0u64, |sum, part| sum.checked_add(of(part)))
    };
    let points = total(&|part| part.points);
    let cells = total(&|part| part.groups.iter().map(|g| g.elements).sum());
    let (Some(points), Some(cells)) = (points, cells) else {
        return Err(wrong("numbers of 64 bits", "larger ones"));
    };
    if geometry.parts.is_empty() {
        return Err(Error::bad_input(source.path(), "parts", "at least one", "none"));
    }
    let encoding = match geometry.encoding {
        EnsightEncoding::Text => "ascii",
        EnsightEncoding::Binary { big_endian: false } => "C binary",
        EnsightEncoding::Binary { big_endian: true } => "C binary, big-endian",
    };
    let mut info = CellsInfo {
        path: path.to_path_buf(),
        format: format!("EnSight Gold ({encoding})"),
        points,
        cells,
        fields: vec![],
        active: None,
        data_files: vec![case.geometry.clone()],
    };
    if case.variables.iter().map(|v| v.steps.len()).sum::<usize>() > MOST_FIELDS {
        return Err(wrong("at most 2^20 steps of variables", "more"));
    }
    let (mut places, most) = (vec![], case.variables.iter().map(|v| v.steps.len()).max().unwrap_or(0));
    for step in 0..most {
        for (number, variable) in case.variables.iter().enumerate().filter(|(_, v)| step < v.steps.len()) {
            info.fields.push(CellField {
                name: name_of(variable, step),
                scalar: ScalarType::F32,
                components: variable.components,
                center: variable.center,
            });
            info.data_files.push(variable.steps[step].0.clone());
            places.push((number, step));
        }
    }
    let geometry_file = case.geometry;
    Ok(Shared { info, geometry_file, geometry, variables: case.variables, places, io })
}

/// A mesh, and where its numbers are.
struct Shared {
    info: CellsInfo,
    geometry_file: PathBuf,
    geometry: Geometry,
    variables: Vec<Variable>,
    /// The variable and the step of each field.
    places: Vec<(usize, usize)>,
    io: IoMode,
}

struct Mesh(Arc<Shared>);

impl CellFile for Mesh {
    fn info(&self) -> &CellsInfo {
        &self.0.info
    }

    fn points(&self) -> Result<Box<dyn NumberStream>> {
        let run = |part: &scan::EnsightPart| {
            let axes = part.axes.iter().map(|axis| axis.open(ScalarType::F32)).collect();
            (part.points, Some(axes), None)
        };
        let parts = self.0.geometry.parts.iter().map(run).collect();
        Ok(Box::new(Columns::new(parts, 3)))
    }

    fn cells(&self) -> Result<Box<dyn CellStream>> {
        Ok(Box::new(EnsightCells { shared: Arc::clone(&self.0), part: 0, group: 0, base: 0, open: None }))
    }

    fn field(&self, field: usize) -> Result<Box<dyn NumberStream>> {
        let (variable, step) = self.0.places[field];
        let variable = &self.0.variables[variable];
        let source = Arc::new(ByteSource::open(&variable.steps[step].0, self.0.io)?);
        let found = scan::values(&source, &self.0.geometry, variable.center, variable.components)?;
        let run = |part: usize, group: usize, count: u64| {
            let values = Values::of(&found, part, group);
            let open = |v: &Values| v.runs.iter().map(|run| run.open(ScalarType::F32)).collect();
            (count, values.map(open), values.and_then(|v| v.missing))
        };
        let parts = self.0.geometry.parts.iter().enumerate();
        let runs = match variable.center {
            Center::Point => parts.map(|(p, part)| run(p, 0, part.points)).collect(),
            Center::Cell => parts
                .flat_map(|(p, part)| {
                    part.groups.iter().enumerate().map(move |(g, group)| (p, g, group.elements))
                })
                .map(|(p, g, count)| run(p, g, count))
                .collect(),
        };
        Ok(Box::new(Columns::new(runs, variable.components as usize)))
    }
}

/// How many tuples there are, a stream for each component, and the number that means none.
type Stretch = (u64, Option<Vec<RangeNumbers>>, Option<f64>);

/// Tuples whose components are stored apart, one stretch of them after another.
struct Columns {
    stretches: std::vec::IntoIter<Stretch>,
    components: usize,
    open: Stretch,
    numbers: Vec<f64>,
}

impl Columns {
    fn new(stretches: Vec<Stretch>, components: usize) -> Self {
        Self { stretches: stretches.into_iter(), components, open: (0, None, None), numbers: vec![] }
    }
}

impl NumberStream for Columns {
    fn fill(&mut self, mut out: &mut [f64]) -> Result<()> {
        while !out.is_empty() {
            let (left, streams, missing) = &mut self.open;
            if *left == 0 {
                self.open = self.stretches.next().expect("as many are asked for as were counted");
                continue;
            }
            let n = (*left).min((out.len() / self.components) as u64) as usize;
            *left -= n as u64;
            let (now, later) = out.split_at_mut(n * self.components);
            match streams {
                None => now.fill(f64::NAN),
                Some(streams) => {
                    self.numbers.resize(n, 0.0);
                    for (c, stream) in streams.iter_mut().enumerate() {
                        stream.fill(&mut self.numbers)?;
                        let slots = now.iter_mut().skip(c).step_by(self.components);
                        let value = |v: f64| if *missing == Some(v) { f64::NAN } else { v };
                        slots.zip(&self.numbers).for_each(|(slot, &v)| *slot = value(v));
                    }
                }
            }
            out = later;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        // The files were gone through when they were opened.
        Ok(())
    }
}

/// The elements of all parts.
struct EnsightCells {
    shared: Arc<Shared>,
    part: usize,
    group: usize,
    /// Points of the parts before.
    base: u64,
    /// The nodes of this group, and its elements not read yet.
    open: Option<(RangeNumbers, u64)>,
}

impl CellStream for EnsightCells {
    fn next_block(&mut self, out: &mut CellBlock) -> Result<bool> {
        out.clear();
        let mut nodes = vec![];
        loop {
            let Some(part) = self.shared.geometry.parts.get(self.part) else { return Ok(false) };
            let Some(group) = part.groups.get(self.group) else {
                self.base += part.points;
                (self.part, self.group) = (self.part + 1, 0);
                continue;
            };
            let (stream, left) =
                self.open.get_or_insert_with(|| (group.nodes.open(ScalarType::I32), group.elements));
            if *left == 0 {
                (self.open, self.group) = (None, self.group + 1);
                continue;
            }
            let n = (*left).min(BLOCK as u64);
            let first = group.elements - *left + 1;
            *left -= n;
            if group.kind == CellKind::Flat {
                (0..n).for_each(|_| out.push(CellKind::Flat, &[]));
                return Ok(true);
            }
            let count = group.kind.vertices();
            stream.read_ids(n as usize * count, &mut nodes)?;
            for (i, element) in nodes.chunks_exact_mut(count).enumerate() {
                for node in &mut *element {
                    if *node == 0 || *node > part.points {
                        let (name, path) = (&group.name, &self.shared.info.data_files[0]);
                        let at = format!("part {}, {name} {}", part.number, first + i as u64);
                        let expected = format!("nodes from 1 to {}", part.points);
                        return Err(Error::bad_input(path, at, expected, (*node as i64).to_string()));
                    }
                    *node = *node - 1 + self.base;
                }
                out.push(group.kind, element);
            }
            return Ok(true);
        }
    }
}

#[cfg(test)]
mod tests;
